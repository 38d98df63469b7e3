"""Signs and units of commands and measurements along the road, by the change of speed over the whole log.

Over windows of a second, dv/dt is compared with the signal of a delay ago, with resistance c_0 + c_2 v^2 removed from
both. A factor between them tells the wrong unit. An accelerometer reads gravity on a slope: a slow difference from
dv/dt is a possible sign of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.identification.conventions import CLEAR, LEAST_BOTH, WINDOW, Agreement, find_meaning, smoothed

Array = NDArray[np.float64]

LONGITUDINAL_DELAYS = np.arange(0.0, 1.21, 0.1)
"""s, between a command and the change of speed."""
LEAST_LONGITUDINAL_SPEED = 2.0
"""m/s, below which nothing is compared: the car creeps or is held."""
LEAST_SPEED_CHANGE = 0.1
"""m/s^2, standard deviation of dv/dt below which the car keeps its speed."""
SLOPE_WINDOW, LEAST_SLOPE = 2.5, 0.12
"""s to either side of the mean of a difference that a slope makes; m/s^2, its standard deviation."""
_PEDAL = "it is a pedal in per cent: translate it by the map of the car's pedals"
_UNIT = "check its unit (--units)"
LONGITUDINAL_FACTORS = {
    "acceleration_command": (
        (0.0, 0.2, _PEDAL), (0.2, 0.35, _UNIT), (0.35, 2.4, ""),
        (2.4, 30.0, "it is in g: --units acceleration_command=g; or a pedal of 0 to 1, to be translated by its map"),
        (30.0, math.inf, _UNIT),
    ),
    "force_command": (
        (0.0, 0.25, f"{_UNIT} and the mass of the car"), (0.25, 4.0, ""), (4.0, 300.0, _PEDAL),
        (300.0, math.inf, "it is in kN: --units force_command=kN; or an acceleration: --columns "
         "acceleration_command=NAME"),
    ),
    "longitudinal_acceleration": (
        (0.0, 0.2, _UNIT), (0.2, 3.5, ""), (3.5, 30.0, "it is in g: --units longitudinal_acceleration=g"),
        (30.0, math.inf, _UNIT),
    ),
}  # fmt: skip
"""Factors of dv/dt over a signal (a force: over the mass): from, to, and what it means; empty where both agree."""


def compare_longitudinal(values: Mapping[str, Array], mass: float) -> list[Agreement]:
    """Compare commands of acceleration or force, and the measured longitudinal acceleration, with the speed.

    values: raw columns (SI units, (n,) each); mass: kg, for a force
    """
    return [
        _compare_with_speed(name, values, mass if name == "force_command" else 1.0)
        for name in LONGITUDINAL_FACTORS
        if {"time", "speed", name} <= values.keys()
    ]


def _compare_with_speed(name: str, values: Mapping[str, Array], scale: float) -> Agreement:
    """Compare a signal over a scale with the change of speed, a command at the delay where they agree best."""
    unknown = Agreement(f"{name.replace('_', ' ')} and speed, whole log", False, "")
    rows = np.flatnonzero(np.all([np.isfinite(values[column]) for column in ("time", "speed", name)], axis=0))
    if rows.size < LEAST_BOTH:
        return unknown
    time, first = np.unique(values["time"][rows], return_index=True)
    speed, signal = smoothed(time, values["speed"][rows[first]], 0.1), values[name][rows[first]] / scale
    after, before = (np.interp(time + shift, time, speed) for shift in (WINDOW, -WINDOW))
    change = (after - before) / (2.0 * WINDOW)
    compared = np.minimum(after, before) > LEAST_LONGITUDINAL_SPEED
    compared &= (time > time[0] + LONGITUDINAL_DELAYS[-1] + WINDOW) & (time < time[-1] - WINDOW)
    if compared.sum() < LEAST_BOTH:
        return unknown
    is_measured, factor, correlation = name == "longitudinal_acceleration", 1.0, 0.0
    if float(np.std(change[compared])) >= LEAST_SPEED_CHANGE:
        for delay in LONGITUDINAL_DELAYS[: 1 if is_measured else None]:
            late = smoothed(time, signal[np.maximum(np.searchsorted(time, time - delay + 1e-9, side="right") - 1, 0)])
            nuisance = np.column_stack([np.ones(time.size), speed * speed])
            fit = _partial_slope(late[compared], change[compared], nuisance[compared])
            factor, correlation = max((factor, correlation), fit, key=lambda fit: abs(fit[1]))
    is_clear, contradiction, possibility = abs(correlation) >= CLEAR, "", ""
    if is_clear and factor < 0.0:
        contradiction = f"{name}: its sign is inverted; it must be positive forward: --flip {name}."
    elif is_clear and (meaning := find_meaning(factor, LONGITUDINAL_FACTORS[name])):
        contradiction = f"{name}: the speed changes at {factor:.3g} times the signal: {meaning}."
    elif is_measured:
        difference = smoothed(time[compared], (smoothed(time, signal) - change)[compared], SLOPE_WINDOW)
        slow = float(np.std(difference))
        if slow >= LEAST_SLOPE:
            possibility = (
                f"{name} slowly departs from the change of speed, by {slow:.2g} m/s^2, as gravity on slopes of "
                f"{100.0 * slow / GRAVITY:.1g} % does: possibly it contains gravity; do not use it as dv/dt."
            )
    return unknown._replace(clear=is_clear, contradiction=contradiction, possibility=possibility)


def _partial_slope(x: Array, y: Array, nuisance: Array) -> tuple[float, float]:
    """Slope of y over x, and their correlation, with other regressors (columns) removed from both."""
    x, y = (signal - product(nuisance, portable.least_squares(nuisance, signal)) for signal in (x, y))
    size = math.sqrt(float(product(x, x)) * float(product(y, y)))
    return (float(product(x, y)) / float(product(x, x)), float(product(x, y)) / size) if size > 0.0 else (1.0, 0.0)
