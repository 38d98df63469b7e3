"""Columns that no sensor measured: computed from others of the log, or a constant.

An acceleration that is v r, a wheel that is the delayed command and a heading that is the sum of the yaw rate agree
with their source to the rounding of the table. A sensor does not: its own noise, and what the formula leaves out, are
larger. Taken for a measurement, such a column says with certainty what is only assumed: a_y = v r that the lateral
velocity never changes, so that the rear axle does not slip.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput

Array = NDArray[np.float64]

EXACT = 1e-3
"""Of a signal's spread: two that differ less are one. Lateral velocity alone parts a_y from v r by 1 % and more."""
MOST_ROUNDING = 0.02
"""Of a signal's spread, of the rounding that may explain a difference: from a coarser table nothing is concluded."""
LONGEST_DELAY = 0.6
"""s, of a wheel that is the delayed command."""
LEAST_ROWS = 100
OPTIONAL = ("vy", "acceleration", "yaw", "wheel")
"""Signals that a log can do without."""


def without_computed(values: dict[str, Array], wheelbase: float) -> tuple[dict[str, Array], tuple[str, ...]]:
    """The signals of a log without those that are computed from others, and what is said of each.

    values: raw columns in SI units by their signals, (n,) each.

    Raises
    ------
    InvalidInput
        When the yaw rate is computed from steering and speed: nothing was measured.
    """
    values = {name: np.asarray(each, dtype=np.float64) for name, each in values.items()}
    steered = "command" if "command" in values else "wheel"
    if not {"time", "speed", "yaw_rate", steered} <= values.keys():
        return values, ()
    _refuse_computed_yaw_rate(values, steered, wheelbase)
    why = {name: said for name in OPTIONAL if name in values and (said := _said_of(name, values))}
    if steered == "wheel":
        why.pop("wheel", None)
    kept = {name: each for name, each in values.items() if name not in why}
    return kept, tuple(f"{name} {said}: it is left out" for name, said in why.items())


def _said_of(name: str, values: dict[str, Array]) -> str:
    """How a signal is computed; empty where it is measured."""
    x = values[name]
    known = x[np.isfinite(x)]
    if known.size and float(np.ptp(known)) <= 1e-9 * max(1.0, float(np.abs(known).max())):
        return f"is {known[0]:.4g} in every row"
    speed, yaw_rate = values["speed"], values["yaw_rate"]
    rounding = np.hypot(_rounding(yaw_rate) * _size(speed), _rounding(speed) * _size(yaw_rate))
    if name == "acceleration":
        if any(_is(x, _moved(speed * yaw_rate, rows), rounding) for rows in (0, 1, -1)):
            return "is speed times yaw rate to its rounding: it is computed, not measured"
    elif name == "vy":
        if _is(x, yaw_rate, _rounding(yaw_rate), scaled=True):
            return "is the yaw rate times a constant: it is computed, not measured"
        for steering in ("command", "wheel"):
            if steering in values and _is(x, speed * values[steering], 0.0, scaled=True):
                return f"is speed times {steering} times a constant: it is computed, not measured"
    elif name == "yaw":
        if _sums_up(values["time"], x, yaw_rate):
            return "is the sum of the yaw rate, or the yaw rate its derivative: they are one measurement"
    elif "command" in values:
        return _of_command(values["time"], x, values["command"])
    return ""


def _of_command(time: Array, wheel: Array, command: Array) -> str:
    """Whether a wheel is the command, scaled and delayed."""
    period = float(np.nanmedian(np.diff(time)))
    for rows in range(round(LONGEST_DELAY / period) + 1):
        if _is(wheel, _moved(command, rows), _rounding(command), scaled=True):
            late = f", {rows * period:.3g} s later" if rows else ""
            return f"is the command{late}: it is computed, not measured"
    return ""


def _sums_up(time: Array, yaw: Array, yaw_rate: Array) -> bool:
    """Whether steps of the yaw are the yaw rate times those of time, in any of the usual differences."""
    known = np.isfinite(yaw)
    turned = np.full(yaw.size, np.nan)
    turned[known] = np.unwrap(yaw[known])
    step, span = np.diff(turned), np.diff(time)
    rounding = _rounding(turned)
    sums = (yaw_rate[:-1] * span, yaw_rate[1:] * span, 0.5 * (yaw_rate[1:] + yaw_rate[:-1]) * span)
    if any(_is(step, each, np.hypot(rounding, _rounding(yaw_rate) * float(np.nanmedian(span)))) for each in sums):
        return True
    return _is(step[1:] + step[:-1], yaw_rate[1:-1] * (span[1:] + span[:-1]), rounding)


def _refuse_computed_yaw_rate(values: dict[str, Array], steered: str, wheelbase: float) -> None:
    """A yaw rate that is v tan(delta)/L is the kinematic model's."""
    steering = np.clip(values[steered], -1.5, 1.5)
    model = values["speed"] * np.tan(steering) / wheelbase
    if any(_is(values["yaw_rate"], _moved(model, rows), 0.0, scaled=True) for rows in (0, 1)):
        raise InvalidInput(
            f"log: the yaw rate is speed times the tangent of {steered} over a length, to its rounding: it is "
            "computed, not measured, and tells nothing of the car. Name a column that a gyro measured: "
            "--columns yaw_rate=NAME."
        )


def _moved(x: Array, rows: int) -> Array:
    """A signal so many rows later."""
    out = np.full(x.size, np.nan)
    if rows >= 0:
        out[rows:] = x[: x.size - rows]
    else:
        out[:rows] = x[-rows:]
    return out


def _is(x: Array, y: Array, rounding: float, scaled: bool = False) -> bool:
    """Whether x is y (scaled: a multiple of it) and a constant, to their rounding; rounding: of y."""
    both = np.isfinite(x) & np.isfinite(y)
    if both.sum() < LEAST_ROWS:
        return False
    x, y = x[both], y[both]
    x, y = x - np.median(x), y - np.median(y)
    spread = float(np.std(x))
    if scaled:
        power = float(y @ y)
        factor = float(x @ y) / power if power > 0.0 else 0.0
        y, rounding = factor * y, abs(factor) * rounding
    allowed = math.hypot(_rounding(x), rounding) / math.sqrt(12.0)
    allowed = min(allowed, MOST_ROUNDING * spread) + EXACT * spread
    return spread > 0.0 and float(np.quantile(np.abs(x - y), 0.9)) <= 1.645 * allowed


def _rounding(x: Array) -> float:
    """Least step between the values of a signal."""
    levels = np.unique(np.round(x[np.isfinite(x)], 12))
    return float(np.diff(levels).min()) if levels.size > 1 else 0.0


def _size(x: Array) -> float:
    """Root mean square."""
    return float(np.sqrt(np.nanmean(x**2)))
