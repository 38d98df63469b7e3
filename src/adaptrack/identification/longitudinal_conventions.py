"""Signs and units of commands and measurements along the road, by the change of speed over the whole log.

Over windows of a second, dv/dt is compared with the command of a delay ago, with resistance c_0 + c_2 v^2 removed from
both, and with the measured longitudinal acceleration. A factor between them tells the wrong unit. An accelerometer
reads gravity on a slope; a slow difference from dv/dt is a possible sign of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.plants.forces import GRAVITY
from adaptrack.identification.conventions import CLEAR, LEAST_BOTH, WINDOW, Agreement, find_meaning, smoothed

Array = NDArray[np.float64]

LONGITUDINAL_DELAYS = np.arange(0.0, 1.21, 0.1)
"""s, between a command and the change of speed."""
LEAST_LONGITUDINAL_SPEED = 2.0
"""m/s, below which nothing is compared: the car creeps or is held."""
LEAST_SPREAD = 0.1
"""m/s^2, standard deviation of dv/dt below which the car keeps its speed."""
SLOPE_WINDOW, LEAST_SLOPE = 2.5, 0.12
"""s to either side of the mean of a difference that a slope makes; m/s^2, its standard deviation."""
_PEDAL = "a pedal, in per cent; translate it into m/s^2 by the map of the car's pedals"
COMMAND_FACTORS = (
    (0.0, 0.2, f"it is {_PEDAL}"), (0.2, 0.35, "check its unit (--units)"), (0.35, 2.4, ""),
    (2.4, 30.0, "it is in g: --units acceleration_command=g; or a pedal of 0 to 1, to be translated into m/s^2"),
    (30.0, math.inf, "check its unit (--units)"),
)  # fmt: skip
"""Factors of dv/dt over the acceleration command."""
FORCE_FACTORS = (
    (0.0, 0.25, "check its unit (--units) and the mass of the car"), (0.25, 4.0, ""),
    (4.0, 300.0, f"it is {_PEDAL}"),
    (300.0, math.inf, "it is in kN: --units force_command=kN; or an acceleration: --columns acceleration_command=NAME"),
)  # fmt: skip
"""Factors of dv/dt over the force command over the mass."""
MEASURED_FACTORS = (
    (0.0, 0.04, "check its unit (--units)"),
    (0.04, 0.25, "it is in g: --units longitudinal_acceleration=g"), (0.25, 3.0, ""),
    (3.0, math.inf, "check its unit (--units)"),
)  # fmt: skip
"""Factors of the measured longitudinal acceleration over dv/dt."""


def compare_longitudinal(values: Mapping[str, Array], mass: float) -> list[Agreement]:
    """Compare commands of acceleration or force, and the measured longitudinal acceleration, with the speed.

    values: raw columns (SI units, (n,) each); mass: kg, for a force
    """
    return [
        _compare_command("acceleration_command", values, 1.0, COMMAND_FACTORS),
        _compare_command("force_command", values, mass, FORCE_FACTORS),
        _compare_measured(values),
    ]


def _compare_command(
    name: str, values: Mapping[str, Array], scale: float, factors: tuple[tuple[float, float, str], ...]
) -> Agreement:
    """Compare a command with the change of speed at the delay where they agree best."""
    compared = f"{name.replace('_', ' ')} and speed, whole log"
    motion = _motion(values, name)
    if motion is None:
        return Agreement(compared, False, "")
    time, speed, command, change, is_used = motion
    fits = []
    for delay in LONGITUDINAL_DELAYS:
        late = command[np.maximum(np.searchsorted(time, time - delay + 1e-9, side="right") - 1, 0)]
        regressors = np.column_stack([np.ones(time.size), speed**2, smoothed(time, late) / scale])
        fits.append(_partial_slope(regressors[is_used], change[is_used]))
    factor, correlation = max(fits, key=lambda fit: abs(fit[1]))
    if float(np.std(change[is_used])) < LEAST_SPREAD:
        return Agreement(compared, False, "")
    return _judge(compared, name, factor, correlation, "the speed changes at {0:.3g} times the command", factors)


def _compare_measured(values: Mapping[str, Array]) -> Agreement:
    """Compare the measured longitudinal acceleration with the change of speed."""
    name, compared = "longitudinal_acceleration", "longitudinal acceleration and speed, whole log"
    motion = _motion(values, name)
    if motion is None:
        return Agreement(compared, False, "")
    time, _, acceleration, change, is_used = motion
    measured = smoothed(time, acceleration)
    agreement, factor = Agreement(compared, False, ""), 1.0
    if float(np.std(change[is_used])) >= LEAST_SPREAD:
        regressors = np.column_stack([np.ones(time.size), change])[is_used]
        factor, correlation = _partial_slope(regressors, measured[is_used])
        agreement = _judge(
            compared, name, factor, correlation, "it is {0:.3g} times the change of speed", MEASURED_FACTORS
        )
    slow = smoothed(time[is_used], (measured - factor * change)[is_used], SLOPE_WINDOW)
    if agreement.contradiction or float(np.std(slow)) < LEAST_SLOPE:
        return agreement
    return agreement._replace(
        possibility=f"{name} slowly departs from the change of speed by {float(np.std(slow)):.2g} m/s^2 (standard "
        f"deviation), as gravity on slopes of {100.0 * float(np.std(slow)) / GRAVITY:.1g} % does: possibly it contains "
        "gravity; remove it, or do not use it as dv/dt."
    )


def _judge(
    compared: str, name: str, factor: float, correlation: float, observation: str,
    factors: tuple[tuple[float, float, str], ...],
) -> Agreement:  # fmt: skip
    """Agreement of a signal with the change of speed."""
    if abs(correlation) < CLEAR:
        return Agreement(compared, False, "")
    if factor < 0.0:
        return Agreement(compared, True, f"{name}: its sign is inverted; it must be positive forward: --flip {name}.")
    meaning = find_meaning(factor, factors)
    sentence = f"{name}: {observation.format(factor)}: {meaning}." if meaning else ""
    return Agreement(compared, True, sentence)


def _motion(values: Mapping[str, Array], name: str) -> tuple[Array, Array, Array, Array, NDArray[np.bool_]] | None:
    """Time, speed, a signal, dv/dt (m/s^2) over windows, and which samples are compared; None where they are few."""
    if not {"time", "speed", name} <= values.keys():
        return None
    rows = np.flatnonzero(np.isfinite(values["time"]) & np.isfinite(values["speed"]) & np.isfinite(values[name]))
    if rows.size < LEAST_BOTH:
        return None
    time, first = np.unique(values["time"][rows], return_index=True)
    speed, signal = (values[column][rows[first]] for column in ("speed", name))
    even = smoothed(time, speed, 0.1)
    after, before = (np.interp(time + shift, time, even) for shift in (WINDOW, -WINDOW))
    change = (after - before) / (2.0 * WINDOW)
    is_used = np.minimum(after, before) > LEAST_LONGITUDINAL_SPEED
    is_used &= (time > time[0] + LONGITUDINAL_DELAYS[-1] + WINDOW) & (time < time[-1] - WINDOW)
    if is_used.sum() < LEAST_BOTH:
        return None
    return time, speed, signal, change, is_used


def _partial_slope(regressors: Array, target: Array) -> tuple[float, float]:
    """Slope of a target over the last regressor, and their correlation, with the others removed from both."""
    others = regressors[:, :-1]
    x, y = (signal - others @ np.linalg.lstsq(others, signal, rcond=None)[0] for signal in (regressors[:, -1], target))
    size = math.sqrt(float(x @ x) * float(y @ y))
    return (float(x @ y) / float(x @ x), float(x @ y) / size) if size > 0.0 else (math.nan, 0.0)
