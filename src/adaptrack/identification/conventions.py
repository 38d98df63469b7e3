"""Signs, units and clocks of a log, by how its signals fit together over the whole log.

In slow bends yaw rate and road-wheel angle obey r = v delta/(L + K v^2) (R. Rajamani, *Vehicle Dynamics and Control*,
2nd ed., section 3.3), lateral acceleration a_y = v r. A factor between both sides tells the wrong unit. The check of a
loop (`core.input_check`) compares half seconds; here the mean of many bends also shows it without positions and a car.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.identification.log import Log

Array = NDArray[np.float64]

DELAYS = np.arange(0.0, 1.01, 0.1)
GRADIENTS = (0.003, 0.002, 0.005, 0.001, 0.0, 0.008, -0.001, -0.002, 0.012, 0.018, 0.026, 0.036, 0.05)
"""s, between command and yaw rate; rad s^2/m, understeer: all that are tried, usual ones first."""
BETTER = 0.9
"""Share of what a more usual gradient leaves unexplained that another may leave: at an even speed all fit alike."""
WINDOW = 0.5
"""s to either side, over which signals are averaged before they are compared."""
LEAST_BOTH = 100
"""Samples in which two signals must be measured before they are compared."""
LARGEST_RATIO = 100.0
"""-, of steering wheel over road wheels."""
CLEAR = 0.6
"""Least correlation of two signals from which anything is concluded."""
LEADS, FOLLOWS, QUICK = np.arange(-0.5, -0.09, 0.05), np.arange(0.0, 1.01, 0.05), 0.15
"""s, by which a yaw rate is tried to run ahead of the steering, and behind; to either side, over which signals are
smoothed for it."""
SHIFTS = np.arange(-1.0, 1.01, 0.02)
"""s, between two signals of one motion."""
AHEAD = 0.85
"""Share of what is unexplained behind the steering that a yaw rate ahead of it must leave at most."""
LATE = 0.08
"""s, from which the yaw rate does not belong to the yaw. Lateral acceleration shows no clock: what the lateral velocity
adds parts it from v r by up to 0.3 s."""
MENDED = 0.5
"""Share of what is unexplained that a shift of clocks must leave at most."""
FASTEST_CAR, FASTEST_TURN = 75.0, 3.0
"""m/s, rad/s: no car drives or turns so fast for long."""

_KM_H, _MPH = "a speed in km/h: --units speed=km/h", "a speed in mph: --units speed=mph"
_DEGREES_PER_SECOND = "a yaw rate in degrees per second: --units yaw_rate=deg/s"
POSITIONS = (
    (0.0, 1e-3, "x and y are degrees of latitude and longitude, or another column: --columns x=NAME,y=NAME"),
    (0.2, 0.35, _KM_H), (0.4, 0.5, _MPH), (0.7, 1.4, ""), (0.0, math.inf, "check their units (--units)"),
)  # fmt: skip
"""Factors of the way of positions over that by the speed: from, to, and what it means; empty where both agree."""
ACCELERATIONS = (
    (0.01, 0.03, _DEGREES_PER_SECOND), (0.07, 0.15, "a lateral acceleration in g: --units acceleration=g"),
    (0.2, 0.35, _KM_H), (0.4, 0.5, _MPH), (0.0, math.inf, ""),
)  # fmt: skip
"""Factors of the lateral acceleration over speed times yaw rate."""
TURNINGS = (
    (4e-4, 3e-3, "{steered} is the angle of the steering wheel in degrees: --units {steered}=deg --steering-ratio "
     "{in_degrees:.0f} (or fit)"),
    (0.008, 0.035, "{steered} in degrees: --units {steered}=deg"),
    (0.035, 0.13, "{steered} is the angle of the steering wheel: --steering-ratio {ratio:.0f}, or --steering-ratio "
     "fit"),
    (0.15, 0.35, _KM_H), (0.35, 3.5, ""), (25.0, 130.0, _DEGREES_PER_SECOND),
    (0.0, 0.5, "check the units (--units) and the wheelbase, or give --steering-ratio {ratio:.0f}."),
    (0.0, math.inf, "check the units (--units) and the wheelbase, or give the steering ratio."),
)  # fmt: skip
"""Factors of the yaw rate over that of a steady turn."""


class Agreement(NamedTuple):
    """How two signals of a log fit together."""

    compared: str
    clear: bool
    """whether they are correlated enough to conclude anything"""
    contradiction: str
    """a sentence that names the mistake and the option that mends it; empty where they agree"""
    possibility: str = ""
    """a sentence on a mistake that is possible, but not certain"""


class _Slope(NamedTuple):
    factor: float
    correlation: float

    @property
    def clear(self) -> bool:
        return abs(self.correlation) >= CLEAR


def check_positions(values: Mapping[str, Array]) -> None:
    """Refuse raw columns (SI units, (n,) each) whose positions do not fit their speed; see `check_conventions`."""
    refuse_contradictions([compare_positions(values)])


def check_conventions(log: Log, wheelbase: float) -> None:
    """Refuse a log whose signs or units do not fit together.

    Raises
    ------
    InvalidInput
        Naming what is wrong and the option that mends it.
    """
    refuse_contradictions(compare_signals(log, wheelbase))


def refuse_contradictions(agreements: list[Agreement]) -> None:
    """Raise `InvalidInput` with the first contradiction."""
    for agreement in agreements:
        if agreement.contradiction:
            raise InvalidInput(f"log: {agreement.contradiction}")


def compare_positions(values: Mapping[str, Array]) -> Agreement:
    """Compare the way of positions with that by the speed, in raw columns (SI units, (n,) each)."""
    compared = "positions and speed, whole log"
    if not {"time", "speed", "x", "y"} <= values.keys():
        return Agreement(compared, False, "")
    present = np.isfinite(values["time"]) & np.isfinite(values["x"]) & np.isfinite(values["y"])
    time, first = np.unique(values["time"][present], return_index=True)
    speed = values["speed"]
    drives = np.isfinite(values["time"]) & np.isfinite(speed) & (np.abs(speed) > 3.0)
    if time.size < LEAST_BOTH or drives.sum() < LEAST_BOTH:
        return Agreement(compared, False, "")
    instants = values["time"][drives]
    x, y = (
        np.interp(instants + WINDOW, time, place) - np.interp(instants - WINDOW, time, place)
        for place in (values["x"][present][first], values["y"][present][first])
    )
    factor = float(np.median(portable.hypot(x, y) / (2.0 * WINDOW * np.abs(speed[drives]))))
    meaning = find_meaning(factor, POSITIONS)
    sentence = f"the positions move at {factor:.3g} times the speed: {meaning}." if meaning else ""
    return Agreement(compared, True, sentence)


def compare_signals(log: Log, wheelbase: float) -> list[Agreement]:
    """Compare speed, steering, yaw rate, yaw and lateral acceleration of a log."""
    turning, felt = _turning(log, wheelbase), _felt(log)
    turned = _explain_fastest(log) or _explain_turning(log, turning, wheelbase)
    return [
        Agreement("lateral acceleration and yaw rate, whole log", felt.clear, _explain_felt(felt, turning)),
        Agreement("yaw and yaw rate, whole log", *_compare_yaw(log)),
        Agreement("clocks of steering and yaw rate", turning.clear, _explain_lead(log, wheelbase)),
        Agreement("steering and yaw rate, whole log", turning.clear, turned),
    ]


def _steered(log: Log) -> str:
    """The name of the steering column."""
    return "command" if log.commanded else "wheel"


def find_meaning(factor: float, table: tuple[tuple[float, float, str], ...]) -> str:
    """The meaning of a factor: that of the first range in which it lies."""
    return next(meaning for low, high, meaning in table if low <= factor <= high)


def _explain_fastest(log: Log) -> str:
    """A contradiction of the speed and what cars drive."""
    fastest = float(np.percentile(log.speed, 99))
    return f"a speed of {fastest:.0f} m/s: if it is in km/h, say --units speed=km/h." if fastest > FASTEST_CAR else ""


def _explain_felt(felt: _Slope, turning: _Slope) -> str:
    """A contradiction of lateral acceleration and speed times yaw rate."""
    if not felt.clear:
        return ""
    if felt.factor < 0.0:
        which = "yaw_rate" if turning.factor < 0.0 and turning.clear else "acceleration"
        return (
            f"lateral acceleration and yaw rate have opposite signs. Both must be positive to the left: --flip {which}."
        )
    meaning = find_meaning(felt.factor, ACCELERATIONS)
    return f"the lateral acceleration is {felt.factor:.3g} times speed times yaw rate: {meaning}." if meaning else ""


def _explain_turning(log: Log, turning: _Slope, wheelbase: float) -> str:
    """A contradiction of the yaw rate and that of a steady turn."""
    if not turning.clear:
        return ""
    steered = _steered(log)
    if turning.factor < 0.0:
        return (
            f"yaw rate and {steered} have opposite signs. Both must be positive to the left: "
            f"--flip {steered} or --flip yaw_rate, whichever is positive to the right in the log."
        )
    ratio = 1.0 / turning.factor
    if float(np.percentile(np.abs(log.yaw_rate[np.isfinite(log.yaw_rate)]), 99)) > FASTEST_TURN:
        meaning = "angles in degrees: --units deg" + (f" --steering-ratio {ratio:.0f}" if ratio > 8.0 else "")
    else:
        meaning = find_meaning(turning.factor, TURNINGS)
    if not meaning:
        return ""
    meaning = meaning.format(steered=steered, ratio=ratio, in_degrees=math.radians(ratio))
    return (
        f"the yaw rate is {turning.factor:.3g} times what the steering angle makes of a wheelbase of {wheelbase:g} m: "
        f"{meaning}"
    )


def _explain_lead(log: Log, wheelbase: float) -> str:
    """A contradiction of clocks: a yaw rate that runs ahead of the steering."""
    ahead, behind = (_turning(log, wheelbase, delays, QUICK) for delays in (LEADS, FOLLOWS))
    if ahead.correlation < CLEAR or 1.0 - ahead.correlation >= AHEAD * (1.0 - abs(behind.correlation)):
        return ""
    steered = _steered(log)
    return (
        f"the yaw rate runs ahead of {steered}: their clocks differ. Name the column of its own times, "
        f"--clock {steered}=COLUMN, or by how much it is late: --late {steered}=0.3 (s)."
    )


def _compare_yaw(log: Log) -> tuple[bool, str]:
    """Whether the yaw rate can be compared with the yaw, and a contradiction of their clocks."""
    both = np.isfinite(log.yaw) & np.isfinite(log.yaw_rate) & ~log.begins
    if both.sum() < LEAST_BOTH:
        return False, ""
    rate = np.gradient(log.yaw[both], log.time[both])
    late, correlation = _lateness(log.time[both], smoothed(log.time[both], rate), log.yaw_rate[both])
    if abs(late) <= LATE:
        return correlation >= CLEAR, ""
    return True, (
        f"yaw_rate is {abs(late):.2f} s {'later' if late > 0.0 else 'earlier'} than yaw says: their clocks differ, or "
        "one is filtered. Name the column of its own times (--clock yaw_rate=COLUMN) or mend it: "
        f"--late yaw_rate={late:.2f} (s), or --late yaw={-late:.2f}."
    )


def guessed_ratio(log: Log, wheelbase: float) -> float:
    """First guess of the steering ratio (-) of a log whose `command` is an angle of the steering wheel.

    It is the slope over the measured angle of the road wheels, or what yaw rate and speed make of it.

    Raises
    ------
    InvalidInput
        When neither follows the steering, or the angle is in degrees.
    """
    both = np.isfinite(log.wheel)
    if both.sum() >= LEAST_BOTH:
        slope = _slope(smoothed(log.time, log.command)[both], smoothed(log.time[both], log.wheel[both]))
    else:
        slope = _turning(log, wheelbase)
    if not slope.clear:
        raise InvalidInput(
            "log: the steering ratio cannot be found: neither yaw rate nor road wheels follow the steering wheel. Give "
            "it, --steering-ratio R, or drive slow bends."
        )
    ratio = 1.0 / abs(slope.factor)
    if ratio > LARGEST_RATIO:
        raise InvalidInput(
            f"log: the steering wheel turns {ratio:.0f} times as far as the road wheels: if it is in degrees, say "
            "--units steering_wheel=deg (or command=deg)."
        )
    return ratio


def _lateness(time: Array, reference: Array, signal: Array) -> _Slope:
    """s by which a signal of a motion is later than a smoothed reference, and their correlation there.

    0 where no shift explains much more than none does.
    """
    begins = np.append(0, np.flatnonzero(np.diff(time) > 1.0) + 1)
    if begins.size > 1:  # the longest stretch
        ends = np.append(begins[1:], time.size)
        part = slice(*max(zip(begins, ends, strict=True), key=lambda ends: time[ends[1] - 1] - time[ends[0]]))
        time, reference, signal = time[part], reference[part], signal[part]
    if time.size < LEAST_BOTH or time[-1] - time[0] < 10.0:
        return _Slope(0.0, 0.0)
    signal = smoothed(time, signal)
    inside = (time > time[0] + 1.0) & (time < time[-1] - 1.0)
    fits = [
        _slope(reference[inside], np.interp(time[inside] + shift, time, signal)).correlation for shift in SHIFTS
    ]  # fmt: skip
    best, none = int(np.argmax(fits)), int(np.argmin(np.abs(SHIFTS)))
    if fits[best] < 0.9 or 1.0 - fits[best] > MENDED * (1.0 - fits[none]):
        return _Slope(0.0, fits[none])
    return _Slope(float(SHIFTS[best]), fits[best])


def _turning(log: Log, wheelbase: float, delays: Array = DELAYS, half: float = WINDOW) -> _Slope:
    """Yaw rate against v delta/(L + K v^2), at the delay (s) and gradient where they agree best."""
    present = np.isfinite(log.yaw_rate)
    if present.sum() < LEAST_BOTH:
        return _Slope(math.nan, 0.0)
    yaw_rate = smoothed(log.time[present], log.yaw_rate[present], half)
    steering = smoothed(log.time, log.command, half)
    steps = np.unique(np.round(delays / log.period).astype(int))
    late = [steering[np.clip(np.arange(steering.size) - step, 0, steering.size - 1)] for step in steps]
    best = _Slope(math.nan, 0.0)
    for gradient in GRADIENTS:
        turn = log.speed / np.maximum(wheelbase + gradient * portable.square(log.speed), 0.3 * wheelbase)
        slopes = [_slope((turn * (angle - np.median(angle)))[present], yaw_rate) for angle in late]
        slope = max(slopes, key=lambda slope: abs(slope.correlation))
        if 1.0 - abs(slope.correlation) < BETTER * (1.0 - abs(best.correlation)):
            best = slope
    return best


def _felt(log: Log) -> _Slope:
    """Lateral acceleration against speed times yaw rate."""
    both = np.isfinite(log.acceleration) & np.isfinite(log.yaw_rate)
    if both.sum() < LEAST_BOTH:
        return _Slope(math.nan, 0.0)
    yaw_rate, acceleration = (
        smoothed(log.time[both], signal[both]) for signal in (log.yaw_rate, log.acceleration)
    )  # fmt: skip
    return _slope(log.speed[both] * yaw_rate, acceleration)


def smoothed(time: Array, values: Array, half: float = WINDOW) -> Array:
    """(n,) mean within +-half (s) of each sample."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    low = np.searchsorted(time, time - half)
    high = np.searchsorted(time, time + half, side="right")
    return (total[high] - total[low]) / (high - low)


def _slope(x: Array, y: Array) -> _Slope:
    """y over x: the geometric mean of both regressions, so that noise in either does not flatten it."""
    x, y = x - x.mean(), y - y.mean()
    sizes = math.sqrt(float(product(x, x))), math.sqrt(float(product(y, y)))
    if min(sizes) <= 0.0:
        return _Slope(math.nan, 0.0)
    correlation = float(product(x, y)) / (sizes[0] * sizes[1])
    return _Slope(math.copysign(sizes[1] / sizes[0], correlation), correlation)
