"""Bounds of the sizes, counts and numbers of an exported controller, as tables for `c/adaptrack_bounds.c`."""

from __future__ import annotations

import math
import zlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from adaptrack.core.controllers import lqr, mpc
from adaptrack.core.controllers.constraints import SAMPLE_ROWS
from adaptrack.core.estimators import kalman, learning
from adaptrack.core.input_check.record import Settings as CheckSettings
from adaptrack.core.kernel import Scalar, int64, size_of
from adaptrack.core.layout import arrays_of
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.models.path import Turning
from adaptrack.core.scheduling import functions, guard, schedule
from adaptrack.core.scheduling.functions import VARIABLE_COLUMNS
from adaptrack.core.tracker.records import MEMORY, TRACKER_SETTINGS
from adaptrack.core.tracker.step import Tracking
from adaptrack.export.block import ArrayLayout, ArrayRole, Block

LONGEST_LAG = 10
"""s, of a steering in constants."""
UNKNOWN_DELAYS = ("drive_lag", "drive_dead_time", "brake_lag", "brake_dead_time")
"""Numbers of a speed control that are NaN where they are learned."""
NAN_WORD = int(np.array(math.nan).view(np.uint64))
_FLAG, _PLACE = (0, 1), (0, 2**31 - 1)
NUMBER_BOUNDS: dict[str, tuple[float, float]] = {
    "laguerre": _FLAG, "preview": _FLAG, "informed": _FLAG, "curved": (1, 1), "feeds_forward": _FLAG, "learns": _FLAG,
    "residuals": _FLAG, "terms": (1, 1000), "longest_horizon": (1, 1000), "most_moves": (1, 1000), "solver": (0, 3),
    "max_sweeps": (0, 10_000), "max_changes": (0, 100_000), "period": (1e-4, 10.0), "delay": (0.0, 1000.0),
    "speed_floor": (0.01, 100.0), "late": (0, 1000), "filtered": _FLAG,
    "takes_late": (-1, 1000), "beliefs": (0, len(mpc.MPC_ANSWER)),
    "n_inputs": (0, len(VARIABLE_COLUMNS)), "n_entries": (0, guard.MAX_ENTRIES), "tunes_mpc": _FLAG,
    "place": (0, len(VARIABLE_COLUMNS) - 1), "kind": (0, functions.MULTILINEAR), "log10": _FLAG, "horizon": _FLAG,
    **dict.fromkeys(UNKNOWN_DELAYS, (0.0, LONGEST_LAG)),
    "integers": _PLACE, "numbers": _PLACE, "used": _FLAG, "mapped": _FLAG, "hold": (0, 10**9),
}  # fmt: skip
"""Bounds of numbers of the record and its rows, by name; other doubles are free, other whole numbers as exported."""
STEERING_TIMES = ("computation", "lag", "least_lag", "most_lag", "least_dead_time", "most_dead_time")
"""Numbers of a learner that are times (s) of the steering."""
_WITH_NAN = ("controller.mpc.informed.fresh", "controller.schedule.numbers")
"""Arrays of numbers that may be NaN: samples that were missing, cells of a map without a margin."""
_OPEN = ("controller.mpc.", "controller.answer", "controller.schedule.")
"""Arrays of an MPC and of a schedule whose sizes follow from numbers: the C source checks them against those."""
_CLOSED = ("controller.schedule.settings",)
ARRAY_PLACES = {
    "settings": "tracker.settings", "schedule": "controller.schedule.settings", "counts": "controller.schedule.memory",
    "integers": "controller.schedule.integers", "numbers": "controller.schedule.numbers",
    "scratch": "controller.schedule.scratch", "first": "controller.first_tuning",
    "tuning": "controller.tuning",
}  # fmt: skip
"""Arrays that the C source asks for, by the names that it has for them."""
MPC_PLACES = {
    "mpc": "controller.mpc.model.a", "answer": "controller.answer", "states": "controller.mpc.states",
    "parameters": "controller.mpc.parameters", "turning": "controller.mpc.feed.turning",
    "estimator": "controller.mpc.informed.estimator",
    "estimates": "controller.mpc.informed.estimates", "learner": "controller.mpc.informed.learner",
    "fresh": "controller.mpc.informed.fresh", "learned": "controller.mpc.informed.learned",
    "memory": "controller.mpc.memory", "mpc_answer": "controller.mpc.answer", "moves": "controller.mpc.ws.moves",
    "rows": "controller.mpc.ws.rows",
}  # fmt: skip


def _place(kind: Any, *names: str) -> int:
    """The word of a field in a row of a record of numbers."""
    at, dtype = 0, kind.dtype
    for name in names:
        dtype, offset = dtype.fields[name][:2]
        at += offset
    return at // 8


CHECK_PLACES = {f"CAR_{name.upper()}": _place(CheckSettings, name) for name in ("known", "lf", "lr", "length", "slip")}
"""Numbers of the check of inputs that the C source compares with those of the tracker."""


def _is_of_numbers(array: ArrayLayout) -> bool:
    """Return whether an array holds doubles of which none may be NaN."""
    return array.kind == "f" and array.name not in _WITH_NAN


def _has_mpc(block: Block) -> bool:
    return "step_mpc" in block.functions


def _is_open(name: str, block: Block) -> bool:
    """Whether the sizes of an array follow from numbers; those of a law are as they were exported."""
    is_fixed = name in _CLOSED or (not _has_mpc(block) and not name.startswith("controller.schedule."))
    return name.startswith(_OPEN) and not is_fixed


# -- numbers ----------------------------------------------------------------------------------------------------------
def places(block: Block) -> dict[str, int]:
    """Numbers that the C source calls by name, less their prefix."""
    at = {array.name: i for i, array in enumerate(block.arrays)}
    tunes_mpc = _has_mpc(block)
    names = ARRAY_PLACES | (MPC_PLACES if tunes_mpc else {})
    numbers = {f"AT_{name.upper()}": at[array] for name, array in names.items()}
    numbers |= {
        "ARRAYS": len(at), "LINKS": len(block.links), "RECORD_WORDS": block.header.record, "OF_MPC": int(tunes_mpc),
        "BOUNDS": len(list(_bounds(block))), "INITIALS": len(list(_initials(block))),
        "EQUALS": len(list(_equals(block))),
        "AT_CAR": at["tracker.check.settings"], **CHECK_PLACES,
        **{name.upper(): _place(TRACKER_SETTINGS, name)
           for name in ("drift_load", "drift_stiffness", "angle_min", "angle_max")},
        "PERIOD_AT": _place(TRACKER_SETTINGS, "period"), "LATE_AT": _place(TRACKER_SETTINGS, "late"),
        "FILTERED_AT": _place(TRACKER_SETTINGS, "filtered"),
        "SCHEDULE_N_INPUTS": _place(schedule.SCHEDULE_SETTINGS, "n_inputs"),
        "SCHEDULE_N_ENTRIES": _place(schedule.SCHEDULE_SETTINGS, "n_entries"),
        "SCHEDULE_OF_MPC": _place(schedule.SCHEDULE_SETTINGS, "tunes_mpc"),
        "SCHEDULE_ENTRIES": _place(schedule.SCHEDULE_SETTINGS, "entries"), "ENTRY_WORDS": size_of(schedule.ENTRY),
        "SCHEDULE_SCRATCH": schedule.SCHEDULE_SCRATCH - guard.MAP_AXES, "MAP_AXES": guard.MAP_AXES,
        **{f"GUARD_{name.upper()}": _place(schedule.SCHEDULE_SETTINGS, "guard", name)
           for name in ("used", "mapped", "integers", "numbers")},
        **{name: getattr(functions, name) for name in ("NUMBER", "NETWORK", "SUGENO", "MULTILINEAR")},
    }  # fmt: skip
    return numbers | (_mpc_places(block) if tunes_mpc else {})


def _mpc_places(block: Block) -> dict[str, int]:
    return {
        "MPC_SETTINGS": len(mpc.MPCSettings._fields), "MPC_SETTINGS_AT": block.words["controller.mpc.settings.period"],
        "MPC_COUNTS": len(mpc.MPCSizes._fields), "MPC_ARRAYS": arrays_of(mpc.Mpc), "MEASURED": len(MEASUREMENT),
        "LONGEST_LAG": LONGEST_LAG, "ROWS": SAMPLE_ROWS, "MPC_ANSWER": len(mpc.MPC_ANSWER),
        **{f"{name.upper()}_AT": block.words[f"controller.{name}"] for name in ("takes_late", "beliefs")},
        **{f"MPC_{name.upper()}": block.words[f"controller.mpc.settings.{name}"]
           for name in ("laguerre", "terms", "longest_horizon", "most_moves")},
        "RESET_AT": _place(mpc.MEMORY, "speed"), "TURNING_LAG": _place(Turning, "lag"),
        **{f"ESTIMATOR_{name.upper()}": _place(kalman.FilterParameters, name)
           for name in ("periods", "share", "longest", "late")},
        **{f"LEARNER_{name.upper()}": _place(learning.LearnerParameters, name) for name in ("commands", "hypotheses")},
        "ESTIMATES_LEAST": kalman.memory_size(0, 0),
        "ESTIMATES_LONGEST": kalman.memory_size(1, 0) - kalman.memory_size(0, 0),
        "ESTIMATES_LATE": kalman.memory_size(0, 1) - kalman.memory_size(0, 0),
        "LEARNED_STATE": _place(learning.Memory, "beliefs", "belief_state"),
        "LEARNED_AT_BOUND": _place(learning.Memory, "beliefs", "belief_at_bound"),
        "HYPOTHESIS_DEAD_TIME": _place(learning.Hypothesis, "x") + learning.DEAD_TIME,
        "MOST_STATE": learning.CONTRADICTORY, "MOST_BOUND": len(learning.QUANTITIES_BOUNDED),
        "LEARNED_LEAST": learning.memory_size(0, 0),
        "LEARNED_HYPOTHESIS": learning.memory_size(0, 1) - learning.memory_size(0, 0),
    }  # fmt: skip


# -- tables -----------------------------------------------------------------------------------------------------------
def tables(block: Block) -> list[str]:
    """Lines of C: arrays, bounds, words of the first state and links."""
    arrays = [
        f"    {{{array.word}, {len(array.sizes)}, {array.entry}, {int(array.role)}, {int(not _is_of_numbers(array))}, "
        f"{int(_is_open(array.name, block))}, {{{', '.join(map(str, array.sizes))}}}}},"
        for array in block.arrays
    ]
    bounds = [
        f"    {{{array}, {word}, {int(is_int)}, {_number(least)}, {_number(most)}}},"
        for array, word, is_int, least, most in _bounds(block)
    ]
    initials = [f"    {{{array}, {word}, UINT64_C({value:#x})}}," for array, word, value in _initials(block)]
    equals = [f"    {{{', '.join(map(str, words))}}}," for words in _equals(block)]
    links = [f"    {word}, {zlib.crc32(name.encode()):#010x}u," for word, name in block.links.items()]
    return [
        "const adaptrack_array adaptrack_arrays[] = {", *arrays, "};",
        "const adaptrack_bound adaptrack_bounds[] = {", *bounds, "};",
        "const adaptrack_initial adaptrack_initials[] = {", *initials, "};",
        "const adaptrack_equal adaptrack_equals[] = {", *equals, "};",
        "const uint32_t adaptrack_links[] = {", *links, "};",
    ]  # fmt: skip


def numbers_of(block: Block) -> Iterator[tuple[str, int]]:
    """Name and word of every constant that is a double."""
    yield from ((name, word) for name, word, is_int in _numbers_of("", Tracking, block.words) if not is_int)
    for array in block.arrays:
        first = block.words[array.name]
        if array.role is ArrayRole.KEPT or array.kind == "i":
            continue
        if array.kind == "f":
            yield from ((f"{array.name}[{k}]", first + k) for k in range(array.values.size))
        else:
            fields = _fields_of(_rows_of(array.name).dtype, 0)
            yield from ((f"{array.name}.{name}", first + word) for name, word, is_int in fields if not is_int)


def _number(value: float) -> str:
    return f"{'-' if value < 0 else ''}HUGE_VAL" if math.isinf(value) else repr(float(value))


def _bounds(block: Block) -> Iterator[tuple[int, int, int, float, float]]:
    """Array, word, whether it is a whole number, and the bounds of each number of the record and of its rows."""
    links, absent = set(block.links), _absent_words(block)
    for name, word, is_int in _numbers_of("", Tracking, block.words):
        if word in absent:
            yield len(block.arrays), word, int(is_int), 0.0, 0.0
        elif word not in links:
            yield len(block.arrays), word, *_bounds_of(name, is_int, block.record[word])
    for i, array in enumerate(block.arrays):
        if array.kind == "V" and array.role is not ArrayRole.KEPT:
            for name, word, number in _fields_of(_rows_of(array.name).dtype, 0):
                yield i, word, *_bounds_of(name, number, int(array.values[word]))
        elif _has_mpc(block) and array.name == MPC_PLACES["learner"]:
            for name in STEERING_TIMES:
                yield i, _place(learning.LearnerParameters, name), 0, 0.0, LONGEST_LAG
        elif array.name == "controller.law.parameters" and "lqr" in block.functions:
            for word in map(lqr.PARAMETERS.index, ("speeds", "weights")):  # of its grid of gains
                count = float(array.values.view(np.float64)[word])
                yield i, word, 0, count, count


def _equals(block: Block) -> Iterator[tuple[int, int, int, int]]:
    """Array and word of each number that a block holds twice, and of its other place.

    Behind the last array comes the record itself.
    """
    at = {array.name: i for i, array in enumerate(block.arrays)}
    settings = {
        name: _place(TRACKER_SETTINGS, name) for name in ("period", "angle_min", "angle_max", "move", "drift_arm")
    }
    pairs = [("period", "tracker.check.settings", 0), ("drift_arm", "tracker.check.settings", CHECK_PLACES["CAR_LR"])]
    if _has_mpc(block):
        records = {"estimator": kalman.FilterParameters, "learner": learning.LearnerParameters}
        pairs += [("period", MPC_PLACES[name], _place(record, "period")) for name, record in records.items()]
        for name, field in (*((name, name) for name in ("period", "angle_min", "angle_max")), ("move", "move_max")):
            yield at["tracker.settings"], settings[name], len(at), block.words[f"controller.mpc.settings.{field}"]
    else:
        pairs += [("period", "controller.law.parameters", 0), ("move", "controller.law.parameters", 2)]
        pairs += [("angle_min", "controller.law.parameters", 3), ("angle_max", "controller.law.parameters", 4)]
    if has_speed_control(block):
        for part in ("settings", "friction"):
            word = block.words[f"longitudinal.{part}.period"]
            yield at["tracker.settings"], settings["period"], len(at), word
    for name, array, word in pairs:
        yield at["tracker.settings"], settings[name], at[array], word
    tuning = at[ARRAY_PLACES["tuning"]]
    for word in range(block.arrays[tuning].sizes[1]):
        yield at[ARRAY_PLACES["first"]], word, tuning, word


def has_speed_control(block: Block) -> bool:
    """Whether a speed control is behind the tracker."""
    return "longitudinal_step" in block.functions


def _absent_words(block: Block) -> set[int]:
    """Words of the record for the numbers of parts that it does not have: an MPC, a speed control."""
    parts = [] if _has_mpc(block) else ["controller.mpc."]
    parts += [] if has_speed_control(block) else ["longitudinal."]
    return {word for name, word in block.words.items() if name.startswith(tuple(parts))}


def _rows_of(name: str) -> Any:
    """The record of an array of rows."""
    return TRACKER_SETTINGS if name == "tracker.settings" else schedule.SCHEDULE_SETTINGS


def _bounds_of(name: str, is_int: bool, value: int) -> tuple[int, float, float]:
    """Return the kind of a number (1 whole, 2 NaN, otherwise 0) and its bounds; value: its word in this block."""
    if is_int:
        return 1, *NUMBER_BOUNDS.get(name, (value, value))
    if name in UNKNOWN_DELAYS and value % 2**64 == NAN_WORD:
        return 2, 0.0, 0.0
    return 0, *NUMBER_BOUNDS.get(name, (-math.inf, math.inf))


def _numbers_of(before: str, kind: Any, words: Mapping[str, int]) -> Iterator[tuple[str, int, bool]]:
    """Name, word and whether it is whole, of every number of a record."""
    for name, field in kind.kinds.items():
        if isinstance(field, Scalar):
            yield name, words[f"{before}{name}"], field == int64
        elif hasattr(field, "kinds"):
            yield from _numbers_of(f"{before}{name}.", field, words)


def _fields_of(dtype: Any, at: int) -> Iterator[tuple[str, int, bool]]:
    """Name, word and whether it is whole, of every number of a row."""
    for name in dtype.names:
        field, offset = dtype.fields[name][:2]
        count, field = (math.prod(field.shape), field.base) if field.shape else (1, field)
        for k in range(count):
            word = at + (offset + k * field.itemsize) // 8
            if field.names is None:
                yield name, word, field.kind == "i"
            else:
                yield from _fields_of(field, word)


def _initials(block: Block) -> Iterator[tuple[int, int, int]]:
    """Array, word and value of every word of the state that is not zero at first; value 0: the period."""
    between = _place(MEMORY, "between")
    for i, array in enumerate(block.arrays):
        if array.role is ArrayRole.KEPT and array.name != MPC_PLACES["learned"]:
            for word in np.flatnonzero(array.values):
                period = array.name == "tracker.memory" and word == between
                yield i, int(word), 0 if period else int(array.values[word])
