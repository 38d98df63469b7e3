"""The guard: what stands between a scheduler's output and the MPC.

untrusted input or off the reference -> the fallback, for a while
else                                 -> limit the change -> give way where the stability margin is too small
"""

from __future__ import annotations

import math

from ..kernel import Row, boolean, columns, exported, float64, inlined, int_vector, record, vector, void
from ..maths.exact import clip, floor
from ..maths.exponential import log10, power
from .functions import VARIABLE_COLUMNS, multilinear

MAX_ENTRIES = 8
"""Entries of a controller's tuning, at most."""
NP_ENTRY, NC_ENTRY, Q_ENTRY, R_ENTRY = range(4)
"""The MPC's entries."""
MAP_AXIS = columns("speed", "friction", "Np", "Nc", "log10_ratio")
"""Of the stability map."""
MAP_AXES = len(MAP_AXIS)
FALLBACK_STAGES = 5
"""In how many stages a tuning gives way to the fallback."""

GUARD = record(
    "Guard",
    (
        "used",
        "hold",  # steps that a fallback lasts, the last one with its cause included
        ("fallback", (float64, 4)), ("rates", (float64, 2)),  # largest change of Np and of Nc per step
        "ratio_rate",  # and of log10 R/Q
        "slack",  # how far outside the domain an input may lie, in widths of it
        "offset_limit",  # m, the largest |offset| over the friction; inf: none
        "mapped",  # whether there is a stability map: a table of 1 - modulus margin
        "integers", "numbers",  # where it begins
        "limit",  # the largest value of the map that is allowed
    ),
    integers=("used", "hold", "mapped", "integers", "numbers"),
)  # fmt: skip
COUNTS = ("steps", "clipped", "broken", "rate_limited", "outside", "off_reference", "unstable", "fallback")
"""Counts of steps: all; with an input clipped to the domain; with an input or output that is not a number; with the
change of tuning limited; with inputs far outside; too far off the reference; with too small a stability margin; on the
fallback."""
MEMORY = record(
    "Memory",
    (
        *COUNTS,
        "left",  # steps of fallback still to go
        "holding", ("last", (float64, MAX_ENTRIES)),  # whether there is a last tuning; that
    ),
    integers=(*COUNTS, "left", "holding"),
)  # fmt: skip
"""What a schedule remembers of a run."""


@exported(boolean(vector, vector, Row(GUARD), int_vector, vector, vector, vector))
def too_near_instability(variables, tuning, guard, integers, numbers, point, work):
    """Whether the map says that the loop of a tuning has too small a margin at this speed and friction.

    point (MAP_AXES,), work: scratch.
    """
    if guard.mapped == 0:
        return False
    point[MAP_AXIS.speed] = variables[VARIABLE_COLUMNS.speed]
    point[MAP_AXIS.friction] = variables[VARIABLE_COLUMNS.friction]
    point[MAP_AXIS.Np], point[MAP_AXIS.Nc] = tuning[NP_ENTRY], tuning[NC_ENTRY]
    point[MAP_AXIS.log10_ratio] = log10(tuning[R_ENTRY] / tuning[Q_ENTRY]) if tuning[Q_ENTRY] > 0.0 else math.inf
    # not <=: a value that is no number is too near
    return not multilinear(point, integers[guard.integers :], numbers[guard.numbers :], work) <= guard.limit


@inlined
def _take_fallback(guard, memory, tuning):
    memory.fallback += 1
    tuning[:4] = guard.fallback


@inlined
def _limit_change(guard, memory, tuning):
    """Limit the change since the last tuning. R/Q moves by R alone: Q is taken as scheduled."""
    limited = False
    for s in range(2):
        bounded = clip(tuning[s], memory.last[s] - guard.rates[s], memory.last[s] + guard.rates[s])
        limited = limited or bounded != tuning[s]
        tuning[s] = floor(bounded + 0.5)
    tuning[NC_ENTRY] = min(tuning[NC_ENTRY], tuning[NP_ENTRY])
    if tuning[Q_ENTRY] > 0.0 and memory.last[Q_ENTRY] > 0.0:
        factor = power(10.0, guard.ratio_rate)
        last, ratio = memory.last[R_ENTRY] / memory.last[Q_ENTRY], tuning[R_ENTRY] / tuning[Q_ENTRY]
        bounded = clip(ratio, last / factor, last * factor)
        if bounded != ratio:
            limited = True
            tuning[R_ENTRY] = bounded * tuning[Q_ENTRY]
    if limited:
        memory.rate_limited += 1


@inlined
def _give_way(share, fallback, tuning):
    """Move a tuning a share of the way to the fallback: whole horizons, R/Q by its logarithm, Q as scheduled."""
    for s in range(2):
        tuning[s] = floor(tuning[s] + share * (fallback[s] - tuning[s]) + 0.5)
    tuning[NC_ENTRY] = min(tuning[NC_ENTRY], tuning[NP_ENTRY])
    if tuning[Q_ENTRY] > 0.0 and fallback[Q_ENTRY] > 0.0:
        ratio = tuning[R_ENTRY] / tuning[Q_ENTRY]
        tuning[R_ENTRY] = tuning[Q_ENTRY] * ratio * power(fallback[R_ENTRY] / fallback[Q_ENTRY] / ratio, share)


@exported(void(vector, vector, boolean, Row(GUARD), Row(MEMORY), int_vector, vector, vector))
def supervise(variables, tuning, untrusted, guard, memory, integers, numbers, scratch):
    """Replace a tuning (4,) of the MPC by what may be trusted.

    If an input is `untrusted` (far outside the domain, or no number) or the tracking error too large, the fallback is
    used for `hold` steps. Else the change since the last tuning is limited, and a tuning whose loop has too small a
    stability margin gives way towards the fallback, as far as it must.

    own: the run's memory; integers, numbers: where the stability map is packed; scratch: MAP_AXES reals, then those of
    `multilinear`.
    """
    off_reference = guard.offset_limit < math.inf and not (
        abs(variables[VARIABLE_COLUMNS.offset]) <= guard.offset_limit * variables[VARIABLE_COLUMNS.friction]
    )
    if untrusted:
        memory.outside += 1
    if off_reference:
        memory.off_reference += 1
    if untrusted or off_reference:
        memory.left = guard.hold
    if memory.left > 0:
        memory.left -= 1
        _take_fallback(guard, memory, tuning)
        return
    if memory.holding == 1:
        _limit_change(guard, memory, tuning)
    point, work = scratch[:MAP_AXES], scratch[MAP_AXES:]
    if too_near_instability(variables, tuning, guard, integers, numbers, point, work):
        memory.unstable += 1
        for k in range(FALLBACK_STAGES):
            _give_way(1.0 / (FALLBACK_STAGES - k), guard.fallback, tuning)
            if not too_near_instability(variables, tuning, guard, integers, numbers, point, work):
                return
        _take_fallback(guard, memory, tuning)
