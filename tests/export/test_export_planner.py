"""An exported tracker follows a planner as it does in Python, to the bit: replans, silence, clocks, refusals."""

import copy
import ctypes
import dataclasses
import math
import re
import struct
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
import exported
from adaptrack.control.following import DRIVERS, VERDICTS, WHO_DRIVES, DrivenBy, Following, Verdict
from adaptrack.control.speed_control import SpeedLimit, SpeedState
from adaptrack.control.tracker import Status
from adaptrack.core.kernel import INTERPRETED, fields_of
from adaptrack.core.planned.records import POINT
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.core.tracker.signals import TRACKED
from adaptrack.export.c_library import MEMBER_NAMES, export_c
from adaptrack.road import Comfort
from adaptrack.road.planned_trajectory import PlannedTrajectory
from exported import CPath, CTracker, Exported, Sample

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="what is exported is compiled")]
CAR = at.load_vehicle("midsize-sedan")
ALONG = np.arange(0.0, 600.0, 5.0)
PATH_POINTS = np.stack([ALONG, 32.0 * (1.0 - np.cos(ALONG / 45.0))], axis=-1)
PATH = at.road_through(PATH_POINTS)
PERIOD, SPEED = 0.05, 10.0
FOLLOWING = Following(comfort=Comfort(brake=2.5))
CONTROLS = {"steering": None, "speed": at.SpeedControl(CAR, (0.5, 0.9))}
BAD_TRAJECTORY, BAD_FALLBACK = 15, 16


class CTrajectory(ctypes.Structure):
    """A trajectory as C takes it: rows of `POINT`."""

    _fields_ = (("points", ctypes.c_void_p), ("count", ctypes.c_size_t), ("stamp", ctypes.c_double),
                ("now", ctypes.c_double), ("is_urgent", ctypes.c_int))  # fmt: skip

    def __init__(self, rows, stamp=0.0, time=math.nan, urgent=False):
        self.rows = np.ascontiguousarray(rows, float)
        super().__init__(self.rows.ctypes.data, len(rows), stamp, time, int(urgent))


def answer_of(has_speed):
    """The structure of an answer: whole numbers behind the others, as in the header."""
    tracked = [(MEMBER_NAMES.get(field.name, field.name), field) for field in fields_of(TRACKED)]
    first, later = tracked[: TRACKED.first_top_speed], tracked[TRACKED.first_top_speed :]
    first.sort(key=lambda row: isinstance(row[1].default, int))
    rows = [*first, *later, *((field.name, field) for field in fields_of(SPEED_REQUEST) if has_speed)]
    kinds = {"suspect": ctypes.c_uint64}
    fields = [
        (name, kinds.get(name, ctypes.c_int if isinstance(field.default, int) else ctypes.c_double))
        for name, field in rows
    ]
    target = [] if has_speed else [("target_speed", ctypes.c_double)]
    return type("Answer", (ctypes.Structure,), {"_fields_": (*fields, *target)})


class CPlannerTracker(CTracker):
    """A tracker in C with memory for trajectories, which nothing else may write to."""

    def __init__(self, library):
        super().__init__(library)
        config = (library.folder / "include" / "adaptrack_config.h").read_text()
        self.planner_size = int(re.search(r"ADAPTRACK_PLANNER_SIZE (\d+)", config)[1])
        self.memory = np.full(self.planner_size // 8 + 2 * self.MARGIN, 0xA5A5A5A5A5A5A5A5, np.uint64)
        self.has_speed = "ADAPTRACK_SPEED_CONTROL" in config
        self.Answer = answer_of(self.has_speed)

    def give_memory(self, size=None):
        place = ctypes.c_void_p(self.memory[self.MARGIN :].ctypes.data)
        return self.c.adaptrack_planner(self.place, place, ctypes.c_size_t(size or self.planner_size))

    def follow_trajectory(self, trajectory, fallback=None):
        """Error, verdict and the number of the impossible point."""
        verdict, flaw = ctypes.c_int(-1), ctypes.c_size_t(99)
        spare = None if fallback is None else ctypes.byref(fallback)
        error = self.c.adaptrack_follow_trajectory(
            self.place, ctypes.byref(trajectory), spare, ctypes.byref(verdict), ctypes.byref(flaw)
        )
        return error, verdict.value, flaw.value

    def step(self, *sample):
        answer = self.Answer(math.nan)
        row = Sample(*sample, *[math.nan] * (len(Sample._fields_) - len(sample)))
        assert self.c.adaptrack_step(self.place, ctypes.byref(row), ctypes.byref(answer)) == exported.OK
        return answer

    @property
    def untouched(self):
        margins = self.memory[: self.MARGIN], self.memory[-self.MARGIN :]
        return super().untouched and all((margin == 0xA5A5A5A5A5A5A5A5).all() for margin in margins)


@pytest.fixture(scope="module", params=CONTROLS)
def library(request, tmp_path_factory):
    folder, controller = tmp_path_factory.mktemp(request.param), at.MPC(CAR, profile="road")
    export_c(controller, folder, road="country", speed=CONTROLS[request.param], following=FOLLOWING)
    exported_library = Exported(folder, controller)
    exported_library.control = CONTROLS[request.param]
    return exported_library


def start_tracker(library):
    tracker = CPlannerTracker(library)
    assert (tracker.error, tracker.give_memory()) == (exported.OK, exported.OK)
    return tracker


def python_tracker(library):
    return at.Tracker(copy.deepcopy(library.controller), speed=library.control, following=FOLLOWING)


# -- trajectories -----------------------------------------------------------------------------------------------------
def cut(station, time, *, stamp=None, aside=0.0, noise=None, speeds=None, urgent=False):
    """What a planner sends: the path from a station (m) on; speeds: (n,) m/s every 0.1 s."""
    speeds = np.full(40, SPEED) if speeds is None else speeds
    t = 0.1 * np.arange(speeds.size)
    s = station + np.concatenate([[0.0], np.cumsum(0.05 * (speeds[1:] + speeds[:-1]))])
    place = PATH.at(s)
    x, y = place.x - aside * np.sin(place.heading), place.y + aside * np.cos(place.heading)
    if noise is not None:
        x, y = x + 0.05 * noise.normal(size=t.size), y + 0.05 * noise.normal(size=t.size)
    stamp = time if stamp is None else stamp
    return PlannedTrajectory(t, x, y, speed=speeds, stamp=stamp, urgent=urgent)


def braking(speed, deceleration=3.0):
    """Speeds (m/s) down to a rest, every 0.1 s."""
    return np.append(np.arange(speed, 0.0, -0.1 * deceleration), 0.0)


def halting(k):
    """Speeds (m/s) with two seconds at rest that come nearer with each call."""
    t = 0.1 * np.arange(60) + 0.05 * k
    return np.interp(t, [0.0, 2.0, 5.0, 7.0, 9.0], [SPEED, SPEED, 0.0, 0.0, 6.0])


def sent(k, station, rng):
    """Trajectory and fallback of a call of the long drive; None: silence."""
    time, fallback = PERIOD * k, None
    if k % 2 or 130 <= k < 137 or 180 <= k < 216 or 340 <= k < 400:
        return None, None
    if k < 280:
        fallback = cut(station - 0.3, time, speeds=braking(SPEED))
    if k % 50 == 6:
        return PlannedTrajectory([], [], []), None
    if k % 50 == 8:  # the planner of 0.4 s ago, and one of 3 s ago
        return cut(station - 4.0, time, stamp=time - (0.4 if k % 100 == 8 else 3.0)), fallback
    if k % 50 == 10:
        return cut(station, time, stamp=time + 0.5), fallback
    late = 0.02 * rng.random()
    if 240 <= k < 300:
        late -= 1000.0  # another clock
    if k >= 420:
        return cut(station, time, stamp=time - late, speeds=halting(k - 420)), fallback
    aside = 0.15 if k % 4 else -0.15  # two planners in turn
    noise = rng if k < 80 else None
    return cut(station - 10.0 * late * (late > 0), time, stamp=time - late, aside=aside * (k < 100),
               noise=noise, urgent=k == 100), fallback  # fmt: skip


class Car:
    """A car without slip that follows commands and requests."""

    def __init__(self):
        self.x, self.y, self.yaw, self.speed, self.turn = 1.0, 0.2, 0.0, SPEED, 0.0

    def move(self, command, force, target):
        if force is None:
            change = max(target, 0.0) - self.speed if math.isfinite(target) else -0.15
            self.speed = max(self.speed + min(max(change, -0.15), 0.1), 0.0)
        else:
            self.speed = max(self.speed + PERIOD * force / CAR.mass, 0.0)
        self.turn = self.speed * math.tan(command) / CAR.wheelbase
        self.x += PERIOD * self.speed * math.cos(self.yaw)
        self.y += PERIOD * self.speed * math.sin(self.yaw)
        self.yaw += PERIOD * self.turn


def python_row(answer):
    """An answer of Python as C has it, by the names of the members."""
    row = {"command": answer.command, "status": float(list(Status).index(answer.status)), "offset": answer.offset,
           "heading_error": answer.heading_error, "station": answer.station, "late": answer.late,
           "driven_by": float(DRIVERS.index(answer.driven_by))}  # fmt: skip
    if answer.longitudinal is None:
        return row | {"target_speed": answer.target_speed}
    requests = answer.longitudinal._asdict() | {
        "state": float(list(SpeedState).index(answer.longitudinal.state)),
        "limited_by": float(list(SpeedLimit).index(answer.longitudinal.limited_by)),
    }
    names = {"speed_state": "state"}
    return row | {name: requests[names.get(name, name)] for name in SPEED_REQUEST._fields}


def differs(answer, row):
    return [
        name for name, value in row.items()
        if (number := float(getattr(answer, name))) == number or value == value
        if struct.pack("d", number) != struct.pack("d", value)
    ]  # fmt: skip


def as_c(trajectory, time=math.nan):
    return CTrajectory(trajectory.points, trajectory.stamp, time, trajectory.urgent)


def drive(library, calls, seed=1):
    """Drive a car by the commands of C along `sent`; answers that differ from Python's, verdicts and drivers."""
    tracker, twin, car, rng = start_tracker(library), python_tracker(library), Car(), np.random.default_rng(seed)
    differences, verdicts, drivers, station, before = [], [], [], 0.0, None
    for k in range(calls):
        time = PERIOD * k
        trajectory, fallback = sent(k, station, rng)
        if k % 50 == 14 and trajectory is not None:  # the one before, with a new stamp
            trajectory = dataclasses.replace(before, stamp=before.stamp + 0.1)
        if trajectory is not None:
            before = trajectory
            expected = twin.follow(trajectory, now=time, fallback=fallback)
            error, verdict, _ = tracker.follow_trajectory(
                as_c(trajectory, time), None if fallback is None else as_c(fallback)
            )
            assert error == exported.OK
            verdicts.append(VERDICTS[verdict])
            differences += [(k, expected, VERDICTS[verdict])] if verdicts[-1] is not expected else []
        noise = 0.03 * rng.normal(size=2)
        pose = (car.x + noise[0], car.y + noise[1], car.yaw) if rng.random() > 0.05 else (math.nan,) * 3
        sample = (time, time, *pose, car.speed, car.turn)
        answer = tracker.step(*sample)
        row = python_row(twin.step(sample[0], *sample[2:], now=time))
        differences += [(k, names) for names in [differs(answer, row)] if names]
        drivers.append(DRIVERS[answer.driven_by])
        car.move(answer.command, answer.force - answer.hold if tracker.has_speed else None, answer.target_speed)
        station = float(PATH.project(car.x, car.y, near=station + PERIOD * car.speed).s)
    assert tracker.untouched
    return differences, verdicts, drivers


def test_a_replanned_drive_is_that_of_python_to_the_bit(library, caplog):
    differences, verdicts, drivers = drive(library, 520)
    assert differences == []
    assert set(verdicts) == set(Verdict) - {Verdict.UNFIT}
    assert set(drivers) == set(DrivenBy) - {DrivenBy.NOBODY}


def test_a_path_in_between_ends_the_trajectory_and_its_clock(library):
    if library.control is not None:
        pytest.skip("its path needs a plan")
    tracker, twin = start_tracker(library), python_tracker(library)
    path = CPath(library.c, PATH_POINTS)
    assert path.error == exported.OK

    def compare(first, count):
        for k in range(first, first + count):
            place = PATH.at(SPEED * PERIOD * k)
            sample = (PERIOD * k, float(place.x), float(place.y) + 0.1, float(place.heading), SPEED, 0.0)
            row = python_row(twin.step(*sample))
            assert differs(tracker.step(sample[0], sample[0], *sample[1:]), row) == []
        return DRIVERS[int(row["driven_by"])]

    def send(k):
        trajectory = cut(SPEED * PERIOD * k, PERIOD * k, stamp=1000.0 + PERIOD * k)
        verdict = twin.follow(trajectory, now=PERIOD * k)
        assert tracker.follow_trajectory(as_c(trajectory, PERIOD * k))[:2] == (exported.OK, VERDICTS.index(verdict))
        return verdict

    assert [send(0), send(1), send(2)] == [Verdict.EARLY, Verdict.EARLY, Verdict.TAKEN]
    assert compare(3, 5) is DrivenBy.PLANNER
    twin.follow(at.road_through(PATH_POINTS))
    assert tracker.follow(path) == exported.OK
    assert compare(8, 20) is DrivenBy.NOBODY
    assert [send(28), send(29), send(30)] == [Verdict.EARLY, Verdict.EARLY, Verdict.TAKEN]
    assert compare(31, 5) is DrivenBy.PLANNER


# -- errors, states and the header ------------------------------------------------------------------------------------
def with_entry(trajectory, row, column, value):
    rows = trajectory.points.copy()
    rows[row, column] = value
    return CTrajectory(rows, trajectory.stamp)


def test_an_impossible_trajectory_is_refused_by_its_point_and_the_car_goes_on_as_before(library):
    tracker, twin, first = start_tracker(library), start_tracker(library), cut(0.0, 0.0)
    for follower in (tracker, twin):
        assert follower.follow_trajectory(as_c(first, 0.0))[:2] == (exported.OK, 0)
    refused = [
        (with_entry(cut(1.0, 0.1), 7, POINT.t, 0.0), (BAD_TRAJECTORY, 7)),
        (with_entry(cut(1.0, 0.1), 5, POINT.x, math.inf), (BAD_TRAJECTORY, 5)),
        (with_entry(cut(1.0, 0.1), 9, POINT.y, 80.0), (BAD_TRAJECTORY, 9)),
        (CTrajectory(np.zeros((257, len(POINT)))), (exported.TOO_SMALL, 99)),
    ]
    for impossible, expected in refused:
        impossible.now = 0.1
        error, _, flaw = tracker.follow_trajectory(impossible)
        assert (error, flaw) == expected
    fallbacks = [
        (as_c(cut(1.0, 0.1)), (BAD_FALLBACK, 39)), (CTrajectory(np.zeros((0, len(POINT)))), (BAD_FALLBACK, 0)),
        (with_entry(cut(1.0, 0.1, speeds=braking(SPEED)), 4, POINT.t, math.nan), (BAD_FALLBACK, 4)),
    ]  # fmt: skip
    for impossible, expected in fallbacks:
        error, _, flaw = tracker.follow_trajectory(as_c(cut(1.0, 0.1), 0.1), impossible)
        assert (error, flaw) == expected
    for k in range(40):
        sample = PERIOD * k, PERIOD * k, SPEED * PERIOD * k, 0.1, 0.0, SPEED, 0.0
        assert bytes(tracker.step(*sample)) == bytes(twin.step(*sample))
    assert tracker.untouched


def test_a_planner_needs_its_memory_and_a_time(library):
    tracker = CPlannerTracker(library)
    trajectory = as_c(cut(0.0, 0.0))
    assert tracker.follow_trajectory(trajectory)[0] == exported.OUT_OF_ORDER
    assert tracker.give_memory(tracker.planner_size // 2) == exported.TOO_SMALL
    assert tracker.give_memory() == exported.OK
    assert tracker.follow_trajectory(trajectory)[0] == exported.OUT_OF_ORDER  # neither `time` nor a call
    trajectory.now = 0.0
    assert tracker.follow_trajectory(trajectory)[:2] == (exported.OK, 0)
    assert tracker.give_memory() == exported.OUT_OF_ORDER
    tracker.step(0.0, 0.0, 0.0, 0.0, 0.0, SPEED, 0.0)
    tracker.memory[tracker.MARGIN] = 0
    row = Sample(0.05, *[math.nan] * (len(Sample._fields_) - 1))
    answer = tracker.Answer()
    assert library.c.adaptrack_step(tracker.place, ctypes.byref(row), ctypes.byref(answer)) == exported.BAD_PATH


def test_a_restored_tracker_on_the_same_trajectory_goes_on_as_the_saved_one(library):
    first, other = start_tracker(library), start_tracker(library)

    def call(tracker, k):
        if k % 4 == 0 and k >= 100:
            assert tracker.follow_trajectory(as_c(cut(0.5 * k, PERIOD * k), PERIOD * k))[0] == exported.OK
        place = PATH.at(0.5 * k)
        pose = float(place.x), float(place.y) + 0.1, float(place.heading)
        return bytes(tracker.step(PERIOD * k, PERIOD * k, *pose, SPEED, 0.0))

    long = cut(0.0, 0.0, speeds=np.full(120, SPEED))
    assert first.follow_trajectory(as_c(long, 0.0))[0] == exported.OK
    for k in range(8):
        call(first, k)
    state = first.save()
    assert other.restore(state) == exported.OTHER_PATH
    assert other.follow_trajectory(as_c(cut(0.0, 0.0), 0.0))[0] == exported.OK
    assert other.restore(state) == exported.OTHER_PATH
    assert other.init(other.constants) == other.give_memory() == exported.OK
    assert other.follow_trajectory(as_c(long, 0.0))[0] == exported.OK
    assert other.restore(state) == exported.OK
    assert [call(first, k) for k in range(8, 10)] == [call(other, k) for k in range(8, 10)]
    assert [call(first, k) for k in range(100, 140)] == [call(other, k) for k in range(100, 140)]


def test_header_and_docs_have_the_table_of_who_drives_and_the_library_passes_its_own_check(library):
    header = (library.folder / "include" / "adaptrack.h").read_text().splitlines()
    page = (Path(__file__).parents[2] / "docs" / "planner.md").read_text().splitlines()
    for row in WHO_DRIVES:
        assert any(line.split() == " ".join(row).split() for line in header)
        assert f"| {' | '.join(row)} |" in page
    assert " steps, 0 differ" in library.make("check", "build/times")


def test_cpp_follows_a_trajectory(library, tmp_path):
    text = (
        '#include "adaptrack.hpp"\n'
        "static adaptrack::Tracker tracker;\nstatic adaptrack::Planner planner;\n"
        "int main() {\n    adaptrack::Point points[40];\n"
        "    for (int i = 0; i < 40; i++) { points[i].t = 0.1 * i; points[i].x = 1.0 * i; points[i].y = 0.0; }\n"
        "    adaptrack::Trajectory trajectory{points, 40, 0.0, 0.0, 0};\n"
        "    adaptrack::Verdict verdict; adaptrack::Sample sample; adaptrack::Answer answer{};\n"
        "    sample.t = 0.0; sample.x = 0.0; sample.y = 0.2; sample.yaw = 0.0; sample.speed = 10.0;\n"
        "    if (tracker.ready() || tracker.give(planner)) return 1;\n"
        "    if (tracker.follow(trajectory, verdict) || verdict != ADAPTRACK_VERDICT_TAKEN) return 2;\n"
        "    if (tracker.step(sample, answer)) return 3;\n"
        "    return answer.driven_by == ADAPTRACK_DRIVEN_BY_PLANNER && answer.command < 0.0 ? 0 : 4;\n}\n"
    )
    exported.run_cpp(library, text, tmp_path)
