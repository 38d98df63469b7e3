"""Columns of a log that are computed from other columns, or constant, instead of measured.

An acceleration that is v r, a wheel that is the delayed command and a heading that is the sum of the yaw rate agree
with their source to the rounding of the table. A sensor deviates more, by its noise and by effects that the formula
neglects. Identification must not take such a column for a measurement: a_y = v r would state with certainty that the
lateral velocity is constant, so that the rear axle does not slip.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product

Array = NDArray[np.float64]

EXACT = 1e-3
"""Difference of two equal signals, over their spread. The lateral velocity changes a_y from v r by 1 % or more."""
MOST_ROUNDING = 0.02
"""Largest rounding of a table that allows a conclusion, over the spread of the signal."""
LONGEST_DELAY = 0.6
"""s, of a wheel column that is the delayed command."""
LEAST_ROWS = 100
OPTIONAL = ("vy", "acceleration", "yaw", "wheel")
"""Signals that may be missing in a log."""


def drop_computed_columns(values: dict[str, Array], wheelbase: float) -> tuple[dict[str, Array], tuple[str, ...]]:
    """Return the measured signals of a log, and a note on each computed one.

    values: raw columns in SI units by their signals, (n,) each.

    Raises
    ------
    InvalidInput
        When the yaw rate is computed from steering and speed: nothing was measured.
    """
    values = {name: np.asarray(column, dtype=np.float64) for name, column in values.items()}
    steering = "command" if "command" in values else "wheel"
    if not {"time", "speed", "yaw_rate", steering} <= values.keys():
        return values, ()
    _refuse_computed_yaw_rate(values, steering, wheelbase)
    reasons = {name: reason for name in OPTIONAL if name in values and (reason := _explain(name, values))}
    if steering == "wheel":
        reasons.pop("wheel", None)
    measured = {name: column for name, column in values.items() if name not in reasons}
    return measured, tuple(f"{name} {reason}: it is left out" for name, reason in reasons.items())


def _explain(name: str, values: dict[str, Array]) -> str:
    """Return how a signal is computed; empty if it is measured."""
    x = values[name]
    finite = x[np.isfinite(x)]
    if finite.size and float(np.ptp(finite)) <= 1e-9 * max(1.0, float(np.abs(finite).max())):
        return f"is {finite[0]:.4g} in every row"
    speed, yaw_rate = values["speed"], values["yaw_rate"]
    rounding = portable.hypot(_rounding(yaw_rate) * _size(speed), _rounding(speed) * _size(yaw_rate))
    if name == "acceleration":
        if any(_are_equal(x, _delay(speed * yaw_rate, rows), rounding) for rows in (0, 1, -1)):
            return "is speed times yaw rate to its rounding: it is computed, not measured"
    elif name == "vy":
        if _are_equal(x, yaw_rate, _rounding(yaw_rate), scaled=True):
            return "is the yaw rate times a constant: it is computed, not measured"
        for steering in ("command", "wheel"):
            if steering in values and _are_equal(x, speed * values[steering], 0.0, scaled=True):
                return f"is speed times {steering} times a constant: it is computed, not measured"
    elif name == "yaw":
        if _sums_up(values["time"], x, yaw_rate):
            return "is the sum of the yaw rate, or the yaw rate its derivative: they are one measurement"
    elif "command" in values:
        return _explain_wheel(values["time"], x, values["command"])
    return ""


def _explain_wheel(time: Array, wheel: Array, command: Array) -> str:
    """Return by how much a wheel is the scaled command, delayed; empty if it is measured."""
    period = float(np.nanmedian(np.diff(time)))
    for rows in range(round(LONGEST_DELAY / period) + 1):
        if _are_equal(wheel, _delay(command, rows), _rounding(command), scaled=True):
            late = f", {rows * period:.3g} s later" if rows else ""
            return f"is the command{late}: it is computed, not measured"
    return ""


def _sums_up(time: Array, yaw: Array, yaw_rate: Array) -> bool:
    """Return whether steps of the yaw are the yaw rate times steps of time, by any common difference formula."""
    measured = np.isfinite(yaw)
    heading = np.full(yaw.size, np.nan)
    heading[measured] = np.unwrap(yaw[measured])
    step, span = np.diff(heading), np.diff(time)
    rounding = _rounding(heading)
    sums = (yaw_rate[:-1] * span, yaw_rate[1:] * span, 0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * span)
    sum_rounding = float(portable.hypot(rounding, _rounding(yaw_rate) * float(np.nanmedian(span))))
    if any(_are_equal(step, angle, sum_rounding) for angle in sums):
        return True
    return _are_equal(step[1:] + step[:-1], yaw_rate[1:-1] * (span[1:] + span[:-1]), rounding)


def _refuse_computed_yaw_rate(values: dict[str, Array], steering: str, wheelbase: float) -> None:
    """Refuse a yaw rate that is that of the kinematic model, v tan(delta)/L."""
    model = values["speed"] * portable.tan(np.clip(values[steering], -1.5, 1.5)) / wheelbase
    if any(_are_equal(values["yaw_rate"], _delay(model, rows), 0.0, scaled=True) for rows in (0, 1)):
        raise InvalidInput(
            f"log: the yaw rate is speed times the tangent of {steering} over a length, to its rounding: it is "
            "computed, not measured, and tells nothing of the car. Name a column that a gyro measured: "
            "--columns yaw_rate=NAME."
        )


def _delay(x: Array, rows: int) -> Array:
    """Return a signal delayed by a number of rows."""
    out = np.full(x.size, np.nan)
    if rows >= 0:
        out[rows:] = x[: x.size - rows]
    else:
        out[:rows] = x[-rows:]
    return out


def _are_equal(x: Array, y: Array, rounding: float, scaled: bool = False) -> bool:
    """Return whether x is y (scaled: a multiple of y) plus a constant, to their rounding; rounding: of y."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < LEAST_ROWS:
        return False
    x, y = x[both], y[both]
    x, y = x - np.median(x), y - np.median(y)
    spread = float(np.std(x))
    if scaled:
        power = float(product(y, y))
        factor = float(product(x, y)) / power if power > 0.0 else 0.0
        y, rounding = factor * y, abs(factor) * rounding
    allowed = portable.hypot(_rounding(x), rounding) / math.sqrt(12.0)
    allowed = min(allowed, MOST_ROUNDING * spread) + EXACT * spread
    return spread > 0.0 and float(np.quantile(np.abs(x - y), 0.9)) <= 1.645 * allowed


def _rounding(x: Array) -> float:
    """Return the least step between the values of a signal."""
    levels = np.unique(np.round(x[np.isfinite(x)], 12))
    return float(np.diff(levels).min()) if levels.size > 1 else 0.0


def _size(x: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.nanmean(x * x)))
