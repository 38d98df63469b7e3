"""Wrong signs and units of a log, found by how its signals fit together.

In slow bends yaw rate and road-wheel angle obey r = v delta/(L + K v^2) (R. Rajamani, *Vehicle Dynamics and Control*,
2nd ed., section 3.3), lateral acceleration a_y = v r. What multiplies the right-hand sides tells the unit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
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
_DEGREE = math.pi / 180.0


class _Slope(NamedTuple):
    factor: float
    correlation: float


def check_positions(values: Mapping[str, Array]) -> None:
    """Refuse raw columns (SI units, (n,) each) whose positions do not fit their speed.

    Raises
    ------
    InvalidInput
        Naming the option that mends it.
    """
    if not {"time", "speed", "x", "y"} <= values.keys():
        return
    known = np.isfinite(values["time"]) & np.isfinite(values["x"]) & np.isfinite(values["y"])
    time, first = np.unique(values["time"][known], return_index=True)
    speed = values["speed"]
    drives = np.isfinite(values["time"]) & np.isfinite(speed) & (np.abs(speed) > 3.0)
    if time.size < LEAST_BOTH or drives.sum() < LEAST_BOTH:
        return
    x, y = values["x"][known][first], values["y"][known][first]
    at = values["time"][drives]
    x, y = (np.interp(at + WINDOW, time, each) - np.interp(at - WINDOW, time, each) for each in (x, y))
    factor = float(np.median(np.hypot(x, y) / (2.0 * WINDOW * np.abs(speed[drives]))))
    if 0.7 <= factor <= 1.4:
        return
    remedy = "check their units (--units)"
    if 0.2 <= factor <= 0.35:
        remedy = "a speed in km/h: --units speed=km/h"
    elif 0.4 <= factor <= 0.5:
        remedy = "a speed in mph: --units speed=mph"
    elif factor < 1e-3:
        remedy = "x and y are degrees of latitude and longitude, or another column: --columns x=NAME,y=NAME"
    raise InvalidInput(f"log: the positions move at {factor:.3g} times the speed: {remedy}.")


def check_conventions(log: Log, wheelbase: float) -> None:
    """Refuse a log whose signs or units do not fit together.

    Raises
    ------
    InvalidInput
        Naming what is wrong and the option that mends it.
    """
    fastest = float(np.percentile(log.speed, 99))
    if fastest > 75.0:
        raise InvalidInput(f"log: a speed of {fastest:.0f} m/s: if it is in km/h, say --units speed=km/h.")
    steered = "command" if log.commanded else "wheel"
    turning = _turning(log, wheelbase)
    felt = _felt(log)
    if abs(felt.correlation) >= CLEAR:
        _refuse_felt(felt, turning)
    _check_clocks(log, wheelbase, steered)
    if abs(turning.correlation) < CLEAR:
        return
    if turning.factor < 0.0:
        raise InvalidInput(
            f"log: yaw rate and {steered} have opposite signs. Both must be positive to the left: "
            f"--flip {steered} or --flip yaw_rate, whichever is positive to the right in the log."
        )
    remedy = _remedy(turning.factor, steered, float(np.percentile(np.abs(log.yaw_rate[np.isfinite(log.yaw_rate)]), 99)))
    if remedy:
        raise InvalidInput(
            f"log: the yaw rate is {turning.factor:.3g} times what the steering angle makes of a wheelbase of "
            f"{wheelbase:g} m: {remedy}"
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
    if not abs(slope.correlation) >= CLEAR:
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


def _remedy(factor: float, steered: str, turn: float) -> str:
    """What explains a factor between yaw rate and steering; empty where nothing is wrong."""
    ratio = f"--steering-ratio {1.0 / factor:.0f}" if factor < 0.5 else ""
    if turn > 3.0:  # rad/s: no car turns so fast for long
        both = f" --steering-ratio {1.0 / factor:.0f}" if factor < 0.12 else ""
        return f"angles in degrees: --units deg{both}"
    if 0.35 <= factor <= 3.5:
        return ""
    if 0.2 <= factor < 0.35:
        return "a speed in km/h: --units speed=km/h"
    if 0.035 <= factor <= 0.13:
        return f"{steered} is the angle of the steering wheel: {ratio}, or --steering-ratio fit"
    if 0.008 <= factor < 0.035:
        return f"{steered} in degrees: --units {steered}=deg"
    if 0.0004 <= factor < 0.003:
        options = f"--units {steered}=deg --steering-ratio {_DEGREE / factor:.0f} (or fit)"
        return f"{steered} is the angle of the steering wheel in degrees: {options}"
    if 25.0 <= factor <= 130.0:
        return "a yaw rate in degrees per second: --units yaw_rate=deg/s"
    return f"check the units (--units) and the wheelbase, or give {ratio or 'the steering ratio'}."


def _refuse_felt(felt: _Slope, turning: _Slope) -> None:
    """Lateral acceleration against speed times yaw rate."""
    if felt.factor < 0.0:
        which = "yaw_rate" if turning.factor < 0.0 and abs(turning.correlation) >= CLEAR else "acceleration"
        raise InvalidInput(
            "log: lateral acceleration and yaw rate have opposite signs. Both must be positive to the left: "
            f"--flip {which}."
        )
    if 0.2 <= felt.factor <= 0.4:
        raise InvalidInput("log: speed times yaw rate is 3.6 times the lateral acceleration: --units speed=km/h.")
    if 0.07 <= felt.factor <= 0.15:
        raise InvalidInput("log: the lateral acceleration is in g: --units acceleration=g.")
    if 0.01 <= felt.factor <= 0.03:
        raise InvalidInput("log: the yaw rate is in degrees per second: --units yaw_rate=deg/s.")


def _check_clocks(log: Log, wheelbase: float, steered: str) -> None:
    """The yaw rate against the yaw, and the steering that it cannot run ahead of."""
    both = np.isfinite(log.yaw) & np.isfinite(log.yaw_rate) & ~log.begins
    if both.sum() >= LEAST_BOTH:
        rate = np.gradient(log.yaw[both], log.time[both])
        found = _lateness(log.time[both], smoothed(log.time[both], rate), log.yaw_rate[both])
        if abs(found.factor) > LATE:
            _refuse_clock("yaw_rate", "yaw", found.factor)
    ahead, behind = (_turning(log, wheelbase, delays, QUICK) for delays in (LEADS, FOLLOWS))
    if ahead.correlation >= CLEAR and 1.0 - ahead.correlation < AHEAD * (1.0 - abs(behind.correlation)):
        raise InvalidInput(
            f"log: the yaw rate runs ahead of {steered}: their clocks differ. Name the column of its own times, "
            f"--clock {steered}=COLUMN, or by how much it is late: --late {steered}=0.3 (s)."
        )


def _lateness(time: Array, true: Array, late: Array) -> _Slope:
    """s by which the second signal of a motion is later than the first, smoothed, one; their correlation there.

    0 where no shift explains much more than none does.
    """
    begins = np.append(0, np.flatnonzero(np.diff(time) > 1.0) + 1)
    if begins.size > 1:  # the longest stretch
        ends = np.append(begins[1:], time.size)
        part = slice(*max(zip(begins, ends, strict=True), key=lambda each: time[each[1] - 1] - time[each[0]]))
        time, true, late = time[part], true[part], late[part]
    if time.size < LEAST_BOTH or time[-1] - time[0] < 10.0:
        return _Slope(0.0, 0.0)
    late = smoothed(time, late)
    inside = (time > time[0] + 1.0) & (time < time[-1] - 1.0)
    fits = [_slope(true[inside], np.interp(time[inside] + shift, time, late)).correlation for shift in SHIFTS]
    best, none = int(np.argmax(fits)), int(np.argmin(np.abs(SHIFTS)))
    if fits[best] < 0.9 or 1.0 - fits[best] > MENDED * (1.0 - fits[none]):
        return _Slope(0.0, fits[none])
    return _Slope(float(SHIFTS[best]), fits[best])


def _refuse_clock(name: str, other: str, late: float) -> None:
    raise InvalidInput(
        f"log: {name} is {abs(late):.2f} s {'later' if late > 0.0 else 'earlier'} than {other} says: their clocks "
        "differ, or one is filtered. Name the column of its own times (--clock {name}=COLUMN) or mend it: "
        f"--late {name}={late:.2f} (s), or --late {other}={-late:.2f}."
    )


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
        turn = log.speed / np.maximum(wheelbase + gradient * log.speed**2, 0.3 * wheelbase)
        slopes = [_slope((turn * (angle - np.median(angle)))[present], yaw_rate) for angle in late]
        slope = max(slopes, key=lambda each: abs(each.correlation))
        if 1.0 - abs(slope.correlation) < BETTER * (1.0 - abs(best.correlation)):
            best = slope
    return best


def _felt(log: Log) -> _Slope:
    both = np.isfinite(log.acceleration) & np.isfinite(log.yaw_rate)
    if both.sum() < LEAST_BOTH:
        return _Slope(math.nan, 0.0)
    yaw_rate, acceleration = (smoothed(log.time[both], each[both]) for each in (log.yaw_rate, log.acceleration))
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
    sizes = math.sqrt(float(x @ x)), math.sqrt(float(y @ y))
    if min(sizes) <= 0.0:
        return _Slope(math.nan, 0.0)
    correlation = float(x @ y) / (sizes[0] * sizes[1])
    return _Slope(math.copysign(sizes[1] / sizes[0], correlation), correlation)
