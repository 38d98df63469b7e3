"""Two ways to the speed control: the exported C library, compiled by gcc -O2, and `adaptrack.Tracker`."""

from __future__ import annotations

import ctypes
import math
import re
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.control.speed_control import SpeedLimit, SpeedState
from adaptrack.control.tracker import Status, Tracker
from adaptrack.core.tracker.signals import STATUS
from adaptrack.export.c_library import export_c
from adaptrack.export.kernel_sources import EXACT_OPTIONS
from adaptrack.export.tracking import speed_part, tracking_memory
from tools.fuzz.speed.drives import TOP_SPEED, Drive, Route, Variant
from tools.fuzz.speed.faults import Sample

TRACKER_ARGUMENTS = ("t", "x", "y", "yaw", "speed", "yaw_rate")
TRACKER_OPTIONS = ("lateral_velocity", "lateral_acceleration", "longitudinal_acceleration", "grade")
STATES, LIMITS, STATUSES = tuple(SpeedState), tuple(SpeedLimit), tuple(Status)
NUMBERS = ("command", "station", "acceleration", "force", "hold", "target_speed", "grip_used")


class Answer(NamedTuple):
    """Result of a call."""

    command: float
    station: float
    acceleration: float
    force: float
    hold: float
    target_speed: float
    grip_used: float
    status: int
    state: int
    limited_by: int

    @property
    def words(self) -> str:
        """Status, state and limit in words."""
        return f"{STATUS._fields[self.status]}, {STATES[self.state]}, {LIMITS[self.limited_by]}"

    @property
    def bits(self) -> bytes:
        """All numbers as bytes, any NaN as one."""
        numbers = [math.nan if value != value else value for value in self[:7]]
        return struct.pack("7d3i", *numbers, *self[7:])


NO_ANSWER = Answer(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0, 0, 0)


class TrackerWay:
    """Drive through `adaptrack.Tracker`."""

    def __init__(self, drive: Drive) -> None:
        self._routes, route = drive.routes, drive.routes[0]
        self._tracker = Tracker(drive.controller(), route.road, plan=route.plan, speed=drive.speed_control)
        self._answer = NO_ANSWER

    def engage(self, angle: float) -> None:
        """Begin anew."""
        self._tracker.engage(angle)

    def follow(self, number: int) -> None:
        """Follow a route by its number."""
        self._tracker.follow(self._routes[number].road, self._routes[number].plan)

    def release(self) -> bool:
        """Release the car from its stop; whether this way can."""
        release = getattr(self._tracker, "release", None)
        if release is not None:
            release()
        return release is not None

    def step(self, sample: Sample) -> Answer:
        """Return the requests after a sample."""
        now, motion_time = sample["now"], sample["motion_time"]
        has_now = math.isfinite(now)
        if not has_now and not math.isfinite(sample["t"]):
            return self._answer._replace(status=STATUSES.index(Status.REPEATED))
        out = self._tracker.step(
            *(sample[name] for name in TRACKER_ARGUMENTS), **{name: sample[name] for name in TRACKER_OPTIONS},
            now=now if has_now else None, motion_time=None if math.isnan(motion_time) else motion_time,
            driver=sample["driver"] > 0.5,
        )  # fmt: skip
        requests = out.longitudinal
        assert requests is not None
        self._answer = Answer(
            out.command, out.station, *requests[:5], STATUSES.index(out.status), STATES.index(requests.state),
            LIMITS.index(requests.limited_by),
        )  # fmt: skip
        return self._answer


# -- the C library ----------------------------------------------------------------------------------------------------
KINDS = {"double": ctypes.c_double, "uint64_t": ctypes.c_uint64}


def _structure(header: str, name: str) -> Any:
    """A structure of the header by its name."""
    body = re.search(r"typedef struct \{((?:(?!typedef struct).)*?)\} " + name + ";", header, re.DOTALL)
    assert body is not None, name
    text = re.sub(r"^#if [^\n]*!ADAPTRACK_SPEED_CONTROL$.*?^#endif$", "", body[1], flags=re.DOTALL | re.MULTILINE)
    text = re.sub(r"/\*.*?\*/|^#.*?$", "", text, flags=re.DOTALL | re.MULTILINE)
    fields = []
    for declaration in filter(None, (part.split() for part in text.split(";"))):
        kind = KINDS.get(declaration[0], ctypes.c_int)
        fields += [(field.strip(), kind) for field in " ".join(declaration[1:]).split(",")]
    return type(name, (ctypes.Structure,), {"_fields_": fields})


class _Along(ctypes.Structure):
    _fields_ = (("s", ctypes.c_void_p), ("value", ctypes.c_void_p), ("count", ctypes.c_size_t))


class _Speeds(ctypes.Structure):
    _fields_ = (
        ("s", ctypes.c_void_p), ("speed", ctypes.c_void_p), ("count", ctypes.c_size_t), ("grade", _Along),
        ("bank", _Along), ("stops", ctypes.c_void_p), ("seconds", ctypes.c_void_p), ("stop_count", ctypes.c_size_t),
        ("stays_at_end", ctypes.c_int),
    )  # fmt: skip


def link_optimised(folder: Path) -> Path:
    """Compile an export by gcc -O2 into a shared library."""
    program = folder / "tracker.so"
    options = ["-std=c99", "-O2", *EXACT_OPTIONS, "-shared", "-fPIC", f"-I{folder}/include"]
    command = ["gcc", *options, *map(str, sorted((folder / "src").glob("*.c"))), "-o"]
    run = subprocess.run([*command, str(program)], capture_output=True, text=True)
    if run.returncode != 0:
        raise InvalidInput(f"gcc does not link {folder}: {run.stderr}")
    return program


class Library:
    """The exported library of a variant, loaded into this process."""

    def __init__(self, drive: Drive, folder: Path, link: Callable[[Path], Path]) -> None:
        route = drive.routes[0]
        export_c(drive.controller(), folder, plan=None, speed=drive.speed_control)
        program = link(folder)
        assert route.plan.speed.max() <= TOP_SPEED
        header = (folder / "include" / "adaptrack.h").read_text()
        self.sample, self.answer = _structure(header, "adaptrack_sample"), _structure(header, "adaptrack_answer")
        self.c = ctypes.CDLL(str(program))
        for name in ("size", "path_size", "speed_plan_size", "state_size"):
            getattr(self.c, f"adaptrack_{name}").restype = ctypes.c_size_t
        self.c.adaptrack_error_name.restype = ctypes.c_char_p


def place_of(array: Any) -> ctypes.c_void_p:
    """Address of an array."""
    return ctypes.c_void_p(array.ctypes.data)


class Libraries:
    """The libraries of all variants, each made when it is first needed."""

    def __init__(self, folder: Path, link: Callable[[Path], Path] = link_optimised) -> None:
        self._folder, self._libraries, self._link = folder, dict[Variant, Library](), link

    def library(self, drive: Drive) -> Library:
        """The library that takes the constants of a drive."""
        if drive.variant not in self._libraries:
            self._libraries[drive.variant] = Library(drive, self._folder / f"export{len(self._libraries)}", self._link)
        return self._libraries[drive.variant]


class CWay:
    """Drive through the exported C library."""

    def __init__(self, drive: Drive, library: Library) -> None:
        self._library, self._c = library, library.c
        controller, part_plan = drive.controller(), drive.routes[0].plan
        part = speed_part(drive.speed_control, controller, part_plan, TOP_SPEED)
        constants = tracking_memory(controller, None, 10.0, part).content
        size = ctypes.c_size_t(len(constants))
        count = self._c.adaptrack_size(constants, size)
        self._memory = np.zeros(count // 8 + 8, np.uint64)
        self._tracker = place_of(self._memory)
        self._check(self._c.adaptrack_init(self._tracker, ctypes.c_size_t(count), constants, size), "init")
        self._routes = [self._lay(route) for route in drive.routes]
        self._sample, self._answer = library.sample(), library.answer()
        self._names = [name for name, _ in library.sample._fields_]
        self._places = ctypes.byref(self._sample), ctypes.byref(self._answer)
        self.follow(0)

    def _check(self, error: int, name: str) -> None:
        if error != 0:
            raise InvalidInput(f"adaptrack_{name}: {self._c.adaptrack_error_name(error).decode()}")

    def _lay(self, route: Route) -> tuple[Any, ...]:
        """Lay a path and its plan into memory."""
        points, road = np.ascontiguousarray(route.points), route.road
        count, closed = ctypes.c_size_t(len(points)), int(road.closed)
        size = self._c.adaptrack_path_size(place_of(points), count, closed)
        path = np.zeros(size // 8 + 1)
        self._check(
            self._c.adaptrack_path(place_of(points), count, closed, place_of(path), ctypes.c_size_t(size), None), "path"
        )
        stops = np.array(route.plan.stops, float).reshape(-1, 2)
        columns = [
            np.ascontiguousarray(column, float)
            for column in (route.plan.s, route.plan.speed, road.grade.s, road.grade.value, stops[:, 0], stops[:, 1])
        ]
        s, speed, grade_s, grade, places, seconds = (column.ctypes.data for column in columns)
        speeds = _Speeds(
            s, speed, columns[0].size, _Along(grade_s, grade, columns[2].size), _Along(), places, seconds, len(stops), 1
        )
        size = self._c.adaptrack_speed_plan_size(place_of(path), ctypes.byref(speeds))
        plan = np.zeros(size // 8 + 1)
        self._check(
            self._c.adaptrack_speed_plan(
                place_of(path), ctypes.byref(speeds), place_of(plan), ctypes.c_size_t(size), None
            ),
            "speed_plan",
        )
        return path, plan

    def engage(self, angle: float) -> None:
        """Begin anew."""
        self._check(
            self._c.adaptrack_engage(self._tracker, ctypes.c_double(angle), ctypes.c_double(math.nan)), "engage"
        )

    def follow(self, number: int) -> None:
        """Follow a route by its number."""
        path, plan = self._routes[number]
        near = ctypes.c_double(math.nan)
        self._check(self._c.adaptrack_follow_plan(self._tracker, place_of(path), near, place_of(plan)), "follow_plan")

    def release(self) -> bool:
        """Release the car from its stop; whether this way can."""
        release = getattr(self._c, "adaptrack_release", None)
        if release is not None:
            self._check(release(self._tracker), "release")
        return release is not None

    def step(self, sample: Sample) -> Answer:
        """Return the requests after a sample."""
        row, answer = self._sample, self._answer
        for name in self._names:
            setattr(row, name, sample.get(name, math.nan))
        self._check(self._c.adaptrack_step(self._tracker, *self._places), "step")
        return Answer(
            *(getattr(answer, name) for name in NUMBERS), answer.status, answer.speed_state, answer.limited_by
        )


class BothWays:
    """Drive through the C library, and count the calls in which `Tracker` differs in any bit."""

    def __init__(self, drive: Drive, library: Library) -> None:
        self._ways, self.differences = (CWay(drive, library), TrackerWay(drive)), 0

    def engage(self, angle: float) -> None:
        """Begin anew."""
        for way in self._ways:
            way.engage(angle)

    def follow(self, number: int) -> None:
        """Follow a route by its number."""
        for way in self._ways:
            way.follow(number)

    def release(self) -> bool:
        """Release the car from its stop; whether both ways can."""
        return all([way.release() for way in self._ways])

    def step(self, sample: Sample) -> Answer:
        """Return the requests of the C library."""
        answer, twin = (way.step(sample) for way in self._ways)
        is_timeless = STATUS._fields[answer.status] == "no_time"
        self.differences += not is_timeless and answer.bits != twin.bits
        return answer
