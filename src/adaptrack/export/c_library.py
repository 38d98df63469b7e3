"""`export_c`: a folder from which a controller drives without Python, and the proof that it does so alike."""

from __future__ import annotations

import os
import re
import struct
import textwrap
import zlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack import __version__
from adaptrack.base.checked import checked
from adaptrack.base.errors import StorageError
from adaptrack.base.files import keep_replaced, write_atomically
from adaptrack.cars.plant import DualTrack, Plant, SteppedPlant
from adaptrack.control.controllers import Controller
from adaptrack.control.following import DRIVERS, WHO_DRIVES, Following
from adaptrack.control.speed_control import SPEED_ACTIONS, SpeedControl, SpeedLimit, SpeedState
from adaptrack.core import library
from adaptrack.core.input_check.hypotheses import MISTAKES
from adaptrack.core.kernel import Field, fields_of
from adaptrack.core.planned.clock import VERDICT
from adaptrack.core.planned.records import POINT
from adaptrack.core.roads import path, road
from adaptrack.core.speed.path import PLACE_SPACING, speed_path_words
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.core.tracker.followed import BAD_FALLBACK, FLAW
from adaptrack.core.tracker.planner import PARTS
from adaptrack.core.tracker.signals import STATUS, TRACKED, TRACKER_SAMPLE
from adaptrack.export.kernel_sources import EXACT_OPTIONS, kernel_sources
from adaptrack.export.memory import CMemory, kernels_number
from adaptrack.export.recorded_drive import Recorded, record_drive
from adaptrack.export.tracking import SpeedPart, refuse, speed_part, tracking_memory, trajectory_words
from adaptrack.road import Road, SpeedPlan, load_road, plan_speed
from adaptrack.scenario.profile import Profile, load_profile

C_SOURCES = Path(__file__).parent / "c"
FOLDERS = {
    "include": ("adaptrack.h", "adaptrack.hpp", "adaptrack_error.h"),
    "src": ("adaptrack.c", "adaptrack_memory.c", "adaptrack_memory.h"),
    ".": ("main.c", "times.c", "adaptrack_replay.h", "Makefile", "CMakeLists.txt", "README.md", "LICENSE"),
}
"""Where the files that are the same for all go."""
CALLED = ("tracker_step", "tracker_engage", "tracker_follow", "tracker_predict", "path_words", "path_through")
"""Kernels that `adaptrack.c` calls; with a speed control also `SPEED_CALLED`."""
PREPARE_MPC = "mpc_prepare"
"""Kernel that it calls for an MPC."""
SPEED_CALLED = ("longitudinal_begin", "longitudinal_follow", "longitudinal_release", "longitudinal_acknowledge",
                "speed_path_words", "write_speed_path", "horizon_cells")  # fmt: skip
PLANNER_CALLED = "join_trajectory", "trajectory_step", "trajectory_predict", "leave_planner"
"""Kernels that it calls for a planner's trajectories."""
TRAJECTORY_POINTS = 256
"""Points of a trajectory at most."""
CONSTANTS_FILE = "constants.bin"
MAX_C_POINTS = 100_000
"""Of a path or a plan."""
C_TYPES = {"status": "adaptrack_status", "suspect": "uint64_t", "speed_state": "adaptrack_speed_state",
           "limited_by": "adaptrack_speed_limit"}  # fmt: skip
"""Types of whole numbers that are not int."""
MEMBER_NAMES = {"belief_state": "belief", "belief_at_bound": "at_bound"}
"""Names of members that differ from those of the signals."""
WRITTEN = "/* adaptrack: written by adaptrack.export. */"
C_WIDTH = 120
"""Characters in a line of C."""


@dataclass(frozen=True)
class CExport:
    """Files and sizes of an export to C."""

    folder: Path
    constants_size: int
    """Size of the constants (bytes)."""
    memory_size: int
    """bytes of a tracker"""
    state_size: int
    """bytes of a saved state"""
    steps: int
    """of the recorded drive"""
    failed: str = ""
    """when and why its car failed, in words: it proves equality all the same; empty where it did not"""
    backups: tuple[Path, ...] = ()
    """Files with the previous content of an earlier export, ``NAME.bak``, where it differed."""


@checked
def export_c(
    controller: Controller,
    folder: str | os.PathLike[str],
    *,
    road: Road | str = "country",
    plan: SpeedPlan | None = None,
    plant: Plant | SteppedPlant | None = None,
    profile: str | Profile = "road",
    furthest: float = 10.0,
    room: tuple[int, int] | None = None,
    speed: SpeedControl | None = None,
    following: Following | None = None,
) -> CExport:
    """Write the C sources of a controller with its tracker, its constants, and a recorded minute that shows that the
    compiled library drives as the controller does here.

    The folder needs neither this package nor Python. What the controller has learned so far travels along.

    Parameters
    ----------
    controller : Controller
        Informed, learning, the paper's with their schedules, LQR, Stanley, pure pursuit.
    folder : path
        New or empty, or an earlier export.
    road, plan, plant, profile
        What the recorded minute is driven on: a road or its name, the speed along it, the car (by default the
        controller's, dual track), sensors.
    furthest : float
        m, from the path, beyond which a status says so.
    room : (int, int), optional
        Of an MPC: the largest Np and Nc that constants which are loaded later may have; by default its own.
    speed : SpeedControl, optional
        Speed control behind the tracker. Its comfort is that of `following`, or else of the plan. It follows plans up
        to the highest speed of the plan or of the car's domain, the larger of the two.
    following : Following, optional
        How a planner's trajectories are followed; without it the library follows paths alone.

    Raises
    ------
    InvalidInput
        When the controller cannot be exported; before anything is written.
    StorageError
        When something cannot be written.
    """
    refuse(controller)
    world = load_profile(profile)
    way = load_road(road) if isinstance(road, str) else road
    speed_plan = plan_speed(way, controller.vehicle) if plan is None else plan
    part = None if speed is None else speed_part(speed, controller, speed_plan, speed.car.domain.speed[1], following)
    memory = tracking_memory(controller, room, furthest, part, following)
    driven_car = DualTrack(controller.vehicle) if plant is None else plant
    recorded = record_drive(controller, driven_car, way, speed_plan, world, furthest=furthest, speed=part)
    texts = _texts(controller, memory, recorded, part)
    target = Path(folder)
    contents = {target / place: content for place, content in {**texts, CONSTANTS_FILE: memory.content}.items()}
    with keep_replaced(*contents) as backups:
        for file, content in contents.items():
            _write(file, content)
    return CExport(
        target, len(memory.content), memory.size, memory.state_size, len(recorded.samples),
        recorded.failed, tuple(backups),
    )  # fmt: skip


# -- texts ------------------------------------------------------------------------------------------------------------
def _texts(controller: Controller, memory: CMemory, recorded: Recorded, speed: SpeedPart | None) -> dict[str, bytes]:
    """The files that are text, by their places in the folder."""
    words = {
        "VERSION": __version__, "CONTROLLER": repr(controller),
        "CONSTANTS_SIZE": f"{len(memory.content):,}", "SIZE": f"{memory.size:,}",
        "STATE_SIZE": f"{memory.state_size:,}", "PERIOD": f"{controller.period:g}",
        "STEPS": f"{len(recorded.samples):,}", "KERNELS": library.kernels_hash(), "ACTIONS": _actions(),
        "WHO_DRIVES": _driver_table(), "POINT": _members(fields_of(POINT), "double"),
        "EXACT": " ".join(EXACT_OPTIONS), "ERROR_NAMES": _error_names(), **signal_texts(),
    }  # fmt: skip
    prepare = (PREPARE_MPC,) if controller.has_horizons else ()
    follows = PLANNER_CALLED if memory.record.tracker.planned.settings.size else ()
    called = (*CALLED, *(SPEED_CALLED if speed else ()), *follows, *prepare, *memory.functions)
    texts = {f"src/{name}": text for name, text in kernel_sources(called).items()}
    for folder, names in FOLDERS.items():
        for name in names:
            texts[f"{folder}/{name}"] = _filled((C_SOURCES / name).read_text(encoding="utf-8"), words)
    texts["include/adaptrack_config.h"] = _config(controller, memory, speed)
    texts["src/adaptrack_layout.h"] = _layout_header(memory)
    texts["src/adaptrack_layout.c"] = f'{WRITTEN}\n#include "adaptrack_layout.h"\n\n{memory.connections()}'
    texts["src/adaptrack_constants.c"] = _constants(memory)
    texts["adaptrack_recorded.h"] = _recorded(recorded, speed)
    return {name: text.encode() for name, text in texts.items()}


def _actions() -> str:
    """The table of the header: actions of the speed control by status."""
    rows = {"status": ("with a position", "without one")} | SPEED_ACTIONS
    return "\n".join(f"   {status:<12}{located:<16}{blind}" for status, (located, blind) in rows.items())


def _driver_table() -> str:
    """The table of the header: who drives when a planner falls silent."""
    rows = (("event", "fallback", "driven_by", "how it ends"), *WHO_DRIVES)
    return "\n".join(f"   {event:<25}{fallback:<20}{driver:<11}{end}" for event, fallback, driver, end in rows)


def _error_names() -> str:
    """The cases of a switch over the errors of the header: their names."""
    header = (C_SOURCES / "adaptrack_error.h").read_text(encoding="utf-8")
    return "\n".join(f'        case {name}: return "{name}";' for name in re.findall(r"(ADAPTRACK_\w+) = \d", header))


def _filled(text: str, words: Mapping[str, str]) -> str:
    for name, value in words.items():
        text = text.replace(f"@{name}@", value)
    return text


def _config(controller: Controller, memory: CMemory, speed: SpeedPart | None) -> str:
    suspects = "\n".join(
        f"#define ADAPTRACK_SUSPECT_{name.upper()} (UINT64_C(1) << {bit})" for bit, name in enumerate(MISTAKES._fields)
    )
    return f"""\
/* adaptrack: what was exported. {_printable(repr(controller))} */
#ifndef ADAPTRACK_CONFIG_H
#define ADAPTRACK_CONFIG_H
#include <stdint.h>

#define ADAPTRACK_VERSION "{__version__} kernels {library.kernels_hash()}"
#define ADAPTRACK_PERIOD {controller.period!r} /* s, from one control instant to the next */
#define ADAPTRACK_REAR_AXLE {controller.vehicle.lr!r} /* m, from the centre of mass back to the rear axle */
#define ADAPTRACK_HORIZON {_horizon(memory)} /* points of a predicted path, at most */
#define ADAPTRACK_SIZE {memory.size} /* bytes of a tracker with these constants */
#define ADAPTRACK_STATE_SIZE {memory.state_size} /* bytes of its saved state */
#define ADAPTRACK_CONSTANTS_SIZE {len(memory.content)} /* bytes */
#define ADAPTRACK_MOST_POINTS {MAX_C_POINTS} /* of a path, and of a plan */

/* Bits of adaptrack_answer.suspect: what an input seems to be. */
{suspects}
{_speed_config(speed)}{_planner_config(memory)}
#ifdef __cplusplus
extern "C" {{
#endif
extern const void *const adaptrack_constants; /* of this export */
#ifdef __cplusplus
}}
#endif
#endif
"""


def _horizon(memory: CMemory) -> int:
    """The largest Np of the controller; 0 of one that does not predict."""
    part = memory.record.controller
    return int(part.plans * part.mpc.settings.longest_horizon)


def _speed_config(speed: SpeedPart | None) -> str:
    """Names of states and limits of the speed control; nothing without one."""
    if speed is None:
        return ""
    states = ",\n".join(f"    ADAPTRACK_SPEED_{state.name} = {i}" for i, state in enumerate(SpeedState))
    limits = ",\n".join(f"    ADAPTRACK_LIMIT_{limit.name} = {i}" for i, limit in enumerate(SpeedLimit))
    return f"""
#define ADAPTRACK_SPEED_CONTROL 1 /* {_printable(f"assumed friction {speed.control.friction!r}")} */
#define ADAPTRACK_MASS {speed.control.car.mass!r} /* kg, that the requested force is for */
#define ADAPTRACK_TOP_SPEED {speed.start.top_speed!r} /* m/s, of a plan at most */
typedef enum {{
{states}
}} adaptrack_speed_state;
/* What limits the requested speed or acceleration. */
typedef enum {{
{limits}
}} adaptrack_speed_limit;
"""


def _planner_config(memory: CMemory) -> str:
    """Verdicts, drivers and sizes for a planner's trajectories; nothing without one."""
    if not memory.record.tracker.planned.settings.size:
        return ""
    drivers = ", ".join(f"ADAPTRACK_DRIVEN_BY_{driver.name} = {i}" for i, driver in enumerate(DRIVERS))
    has_speed = bool(memory.record.longitudinal.ahead.size)
    words = 96 + len(POINT) * TRAJECTORY_POINTS + 2 * sum(trajectory_words(TRAJECTORY_POINTS, has_speed))
    return f"""
#define ADAPTRACK_PLANNER 1
#define ADAPTRACK_TRAJECTORY_POINTS {TRAJECTORY_POINTS} /* at most */
#define ADAPTRACK_PLANNER_SIZE {8 * words} /* bytes of the memory for trajectories */
enum {{ {drivers} }};
/* What becomes of a trajectory. */
typedef enum {{
{_enumerators("VERDICT", VERDICT)}
}} adaptrack_verdict;
"""


def _printable(text: str) -> str:
    return text.encode("ascii", "replace").decode().replace("*/", "* /")


def _layout_header(memory: CMemory) -> str:
    """The structs of memory and constants, and numbers of the kernels that the interface needs."""
    record = memory.record
    has_speed = bool(record.longitudinal.ahead.size)
    numbers: dict[str, object] = {
        "ROAD_LENGTH": road.LENGTH, "ROAD_SPACING": road.HEADING_SPACING, "ROAD_COUNT": road.COUNT,
        "ROAD_NUMBERS": len(road.LINE_NUMBERS),
        "PIECE_COLUMNS": road.PIECE_COLUMNS, "PATH_TOO_SMALL": path.TOO_SMALL,
        "PLAN_SPACING": f"{PLACE_SPACING!r} /* m */",
        "PLANS": record.controller.plans, "LEARNS": int(record.controller.mpc.informed.fresh.size > 0),
        "KERNELS": f"{kernels_number():#x}u", "LAYOUT": f"{memory.layout:#x}u",
        "LONGITUDINAL_CELLS": record.longitudinal.ahead.size,
    }  # fmt: skip
    if record.tracker.planned.settings.size:
        words, plan_words = trajectory_words(TRAJECTORY_POINTS, has_speed)
        numbers |= {
            "TRAJECTORY_WORDS": words, "TRAJECTORY_PLAN_WORDS": plan_words, "PARTS": len(PARTS),
            "FLAW_TOO_LONG": FLAW.too_long, "FLAW_TOO_FAST": FLAW.too_fast, "BAD_FALLBACK_VERDICT": BAD_FALLBACK,
            **{f"PART_{name.upper()}": place for place, name in enumerate(PARTS._fields)},
        }  # fmt: skip
    lines = [f"#define ADAPTRACK_{name} {value}" for name, value in numbers.items()]
    return "\n".join(
        [
            WRITTEN, "#ifndef ADAPTRACK_LAYOUT_H", "#define ADAPTRACK_LAYOUT_H", '#include "adaptrack_memory.h"',
            '#include "records.h"', "", *lines, "", memory.structs(), "",
            "/* What each word of constants may be. */", "extern const adaptrack_bounds adaptrack_words[];",
            "/* Give the record its arrays and its kernels. */", "void adaptrack_connect(struct adaptrack_memory *);",
            "/* Give it the numbers of the constants, and let what follows from them begin as they say. */",
            "void adaptrack_renew(struct adaptrack_memory *);", "#endif", "",
        ]
    )  # fmt: skip


def _constants(memory: CMemory) -> str:
    return "\n".join(
        [
            WRITTEN, '#include "adaptrack_config.h"', '#include "adaptrack_layout.h"', "", "#include <math.h>", "",
            "/* The constants, as in constants.bin; units stand at the structs. */", memory.initialiser(),
            "const void *const adaptrack_constants = &CONSTANTS;", "", memory.bounds(), "",
        ]
    )  # fmt: skip


# -- sample, status and answer ----------------------------------------------------------------------------------------
def signal_texts() -> dict[str, str]:
    """Return the texts of the C sources that follow from the signals, by their marks."""
    tracked, requests = fields_of(TRACKED), fields_of(SPEED_REQUEST)
    first, later = tracked[: TRACKED.first_top_speed], tracked[TRACKED.first_top_speed :]
    return {
        "SAMPLE": _members(fields_of(TRACKER_SAMPLE), "double"),
        "UNKNOWN": ", ".join(["NAN"] * len(TRACKER_SAMPLE)),
        "STATUSES": _enumerators("STATUS", STATUS),
        "ANSWER": _members([*sorted(first, key=_is_whole), *later]),  # an order that programs rely on
        "REQUESTS": _members(requests),
        "READ_ANSWER": "\n".join(
            f"    answer->{_name(field)} = {_tracked(i, field)};" for i, field in enumerate(tracked)
        ),
        "READ_REQUESTS": "\n".join(
            f"    answer->{field.name} = {_requested(i, field)};" for i, field in enumerate(requests)
        ),
        "ANSWER_NUMBERS": _answer_numbers(tracked),
        "REQUEST_NUMBERS": _answer_numbers(requests),
    }


def _is_whole(field: Field) -> bool:
    return isinstance(field.default, int)


def _name(field: Field) -> str:
    return MEMBER_NAMES.get(field.name, field.name)


def _type(field: Field) -> str:
    return C_TYPES.get(field.name, "int" if _is_whole(field) else "double")


def _members(fields: Iterable[Field], kind: str = "") -> str:
    return _remarked((f"{kind or _type(field)} {_name(field)};", field) for field in fields)


def _enumerators(name: str, kinds: Any) -> str:
    """Lines of an enum of C: a field each."""
    commas = [","] * (len(kinds) - 1) + [""]
    names = (f"ADAPTRACK_{name}_{field.name.upper()} = {i}{commas[i]}" for i, field in enumerate(fields_of(kinds)))
    return _remarked(zip(names, fields_of(kinds), strict=True))


def _remarked(lines: Iterable[tuple[str, Field]]) -> str:
    """Lines of C, each with unit and meaning of a field behind it; these remarks begin in one column."""
    lines, texts = list(lines), []
    begin = 5 + max(len(code) for code, _ in lines)
    for code, field in lines:
        remark = ", ".join(filter(None, (field.unit, field.meaning)))
        rows = textwrap.wrap(f"{remark} */", C_WIDTH - begin - 3)
        texts.append(f"    {code}".ljust(begin) + "/* " + ("\n" + " " * (begin + 3)).join(rows))
    return "\n".join(texts)


def _tracked(i: int, field: Field) -> str:
    """A number of the kernel's row `tracked` as a member."""
    if not _is_whole(field):
        return f"tracked[{i}]"
    return f"bits(tracked[{i}])" if _type(field) == "uint64_t" else f"({_type(field)})small(tracked[{i}])"


def _requested(i: int, field: Field) -> str:
    """A request as a member: of the memory of the speed control, or of that of the friction."""
    if i >= SPEED_REQUEST.friction_low:
        return f"friction->{field.name.removeprefix('friction_')}"
    return f"{f'({_type(field)})' if _is_whole(field) else ''}memory->{field.name}"


def _answer_numbers(fields: Iterable[Field]) -> str:
    """The members of an answer as numbers of an array."""
    values = (f"{'(double)' * _is_whole(field)}answer->{_name(field)}," for field in fields)
    return textwrap.indent(textwrap.fill(" ".join(values), C_WIDTH - 8), " " * 8)


# -- the recorded minute ----------------------------------------------------------------------------------------------
def _recorded(recorded: Recorded, speed: SpeedPart | None) -> str:
    points = ",\n    ".join(f"{x!r}, {y!r}" for x, y in recorded.points.tolist())
    rows = [
        ", ".join(f"{word:#x}u" for word in [*_canonical(sample), fingerprint(answer)])
        for sample, answer in zip(recorded.samples, recorded.answers, strict=True)
    ]
    size = 64 + 8 * path.path_words(np.ascontiguousarray(recorded.points), False)
    sets = "},\n    {".join(rows)
    return f"""\
/* adaptrack: a recorded drive. Written by adaptrack.export. */
#include <stdint.h>

enum {{
    ADAPTRACK_RECORDED_POINTS = {len(recorded.points)},
    ADAPTRACK_RECORDED_PATH_SIZE = {size}, /* bytes, of adaptrack_path_size */
    ADAPTRACK_RECORDED_PLAN = {recorded.plan.s.size},
    ADAPTRACK_RECORDED_STEPS = {len(rows)},
    ADAPTRACK_RECORDED_DRIVEN = {recorded.driven_calls} /* of the simulated drive, the first ones */
}};
/* m: x, y of the path */
static const double adaptrack_recorded_points[] = {{
    {points}}};
static const double adaptrack_recorded_plan_s[] = {{ /* m */
    {_numbers(recorded.plan.s)}}};
static const double adaptrack_recorded_plan_speed[] = {{ /* m/s */
    {_numbers(recorded.plan.speed)}}};
{_recorded_speeds(recorded, speed)}
/* For each call the bits of an adaptrack_sample, then the CRC-32 of what Python answered. */
static const uint64_t adaptrack_recorded[][{len(TRACKER_SAMPLE) + 1}] = {{
    {{{sets}}}}};
"""


def _recorded_speeds(recorded: Recorded, speed: SpeedPart | None) -> str:
    """Grade and stops of the recorded drive; nothing without a speed control."""
    if speed is None:
        return ""
    grade, (stops, seconds) = recorded.path.grade, zip(*recorded.plan.stops, strict=True)
    length = recorded.path.length
    words = speed_path_words(length, 0, len(stops)) + 2 * recorded.plan.s.size
    return f"""
enum {{
    ADAPTRACK_RECORDED_GRADES = {len(grade.s)}, ADAPTRACK_RECORDED_STOPS = {len(stops)},
    ADAPTRACK_RECORDED_STAYS = {int(speed.control.stop_at_end)},
    ADAPTRACK_RECORDED_SPEED_PLAN_SIZE = {64 + 8 * words} /* bytes, of adaptrack_speed_plan_size */
}};
static const double adaptrack_recorded_grade_s[] = {{{_numbers(grade.s)}}}; /* m */
static const double adaptrack_recorded_grade[] = {{{_numbers(grade.value)}}};
static const double adaptrack_recorded_stops[] = {{{_numbers(stops)}}}; /* m */
static const double adaptrack_recorded_seconds[] = {{{_numbers(seconds)}}}; /* s */
"""


def _numbers(values: Any) -> str:
    return ",\n    ".join(repr(float(value)) for value in values)


def _canonical(values: Any) -> list[int]:
    """The bits of numbers; any NaN is one."""
    array = np.array(values, dtype=float)
    array[np.isnan(array)] = np.nan
    return [int(word) for word in array.view(np.uint64)]


def fingerprint(answer: Any) -> int:
    """CRC-32 of an answer, a row of `export.tracking.Twin.call`, as main.c makes it."""
    return zlib.crc32(struct.pack(f"<{len(answer)}Q", *_canonical(answer)))


def _write(file: Path, content: bytes) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{file.parent}: cannot be made: {error.strerror}.") from error
    write_atomically(file, content)
