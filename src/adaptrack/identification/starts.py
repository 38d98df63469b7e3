"""Where the fit of a log starts: the optima of its likelihood.

A short delay with soft tyres predicts nearly what a long delay with stiff ones does, so a fit that starts at one of
them may stay there. Fits of the few quantities that matter most, from several starts, find both.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.identification.likelihood import NEARLY, Likelihood
from adaptrack.identification.quantities import INDEX, QUANTITIES, shift_from_zero

Array = NDArray[np.float64]

START_DELAYS, START_LATENESSES = (0.12, 0.25, 0.45), (0.0, 0.2)
"""s, from which the fit of a log with a command starts; s, where only the wheel angle is logged."""
START_STIFFNESS = 2.0
"""Factor on the stiffness of both axles in one more start."""
ROUGH_QUANTITIES = (
    "delay", "lag_share", "lateness", "gain", "offset", "front", "rear", "gyro_offset", "wind_spread",
    "noise_yaw_rate", "jolt",
)  # fmt: skip
"""Quantities that are free in a rough fit."""
MAX_ROUGH_GAP, MAX_RIVAL_GAP = 60.0, 15.0
"""Differences of the objective: of rough fits that are continued, and of optima that count as equally likely."""
MAX_AXLE_GAP = 0.25
"""Difference of the logarithm of an axle's stiffness up to which two optima are one."""


class Optima(NamedTuple):
    """Points z at which a likelihood has an optimum."""

    best: Array
    rivals: tuple[Array, ...]
    """as likely, within `MAX_RIVAL_GAP`"""


def find_optima(likelihood: Likelihood, tell: Callable[[int], None] = lambda step: None) -> Optima:
    """The best of the nearby optima of a likelihood, and those that are as likely.

    tell: called with the number of fits that are done, 9 at most.
    """
    starts = _starting_points(likelihood)
    optima = [likelihood.fit(min(starts[:-1], key=likelihood.objective), NEARLY)[0]]
    refined: list[Array] = list(optima)
    rough: list[Array] = []
    for z in starts:
        tell(1 + len(rough))
        if math.isfinite(likelihood.objective(z)):
            rough.append(_fit_roughly(likelihood, z))
    rough.sort(key=likelihood.objective)
    limit = min(map(likelihood.objective, rough), default=math.inf) + MAX_ROUGH_GAP
    for i, z in enumerate(rough):
        tell(1 + len(starts) + i)
        if likelihood.objective(z) <= limit and not any(_have_equal_axles(likelihood, z, other) for other in refined):
            optima.append(likelihood.fit(z, NEARLY)[0])
            refined.append(z)
    objectives = [likelihood.objective(z) for z in optima]
    best = optima[int(np.argmin(objectives))]
    rivals = [
        z for z, objective in zip(optima, objectives, strict=True)
        if objective <= min(objectives) + MAX_RIVAL_GAP and not _have_equal_axles(likelihood, z, best)
    ]  # fmt: skip
    return Optima(best, tuple(rivals))


def _starting_points(likelihood: Likelihood) -> list[Array]:
    """Starting points z: delays with the believed stiffness, then one with stiffer axles."""
    name, values = ("delay", START_DELAYS) if likelihood.log.commanded else ("lateness", START_LATENESSES)
    starts = []
    for value, factor in (*((value, 1.0) for value in values), (values[1], START_STIFFNESS)):
        z = np.zeros(len(QUANTITIES))
        for axle in ("front", "rear"):
            z[INDEX[axle]] = _scale_shift(likelihood, axle, portable.log(factor))
        median = float(likelihood.median[INDEX[name]])
        z[INDEX[name]] = _scale_shift(
            likelihood, name, shift_from_zero(value / median) if name == "delay" else value - median
        )
        starts.append(z)
    return starts


def _scale_shift(likelihood: Likelihood, name: str, shift: float) -> float:
    """A shift of a quantity (of its logarithm where it is positive) in spreads; 0 where it is not estimated."""
    place = INDEX[name]
    return shift / float(likelihood.spread[place]) if place in likelihood.free else 0.0


def _fit_roughly(likelihood: Likelihood, z: Array) -> Array:
    """The optimum over the quantities of `ROUGH_QUANTITIES` from a start."""
    every = likelihood.free
    likelihood.free = np.array([place for place in every if QUANTITIES[place].name in ROUGH_QUANTITIES])
    try:
        return likelihood.fit(z, NEARLY)[0]
    finally:
        likelihood.free = every


def _have_equal_axles(likelihood: Likelihood, z: Array, other: Array) -> bool:
    """Whether two points have nearly the same axles."""
    axles = [INDEX["front"], INDEX["rear"]]
    return bool(np.all(np.abs((z - other)[axles]) * likelihood.spread[axles] < MAX_AXLE_GAP))
