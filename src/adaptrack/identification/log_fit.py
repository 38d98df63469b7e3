"""The most likely car of a log, and of several logs of one car.

A short delay with soft tyres predicts nearly what a long delay with stiff ones does, so a fit that starts at one of
them may stay there. Fits of the few quantities that matter most, from several starts, find both.

Of several logs, what belongs to the car is shared, the rest is each log's own. Each log's posterior is freed of the
prior, which they share, and what remains is added in information form: with means m_k and covariances C_k of the shared
entries of z, whose prior is standard normal,

    C^-1 = I + sum(C_k^-1 - I),    C^-1 m = sum(C_k^-1 m_k)

(the logs are independent given the car). Once more at the common point, which mends what is not linear. Each log's own
entries follow as they do in its Gaussian posterior.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.identification.estimates import slopes_at
from adaptrack.identification.likelihood import NEARLY, Fit, Likelihood, Scored
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
FIT_STEPS = 11
"""Steps of about equal duration in the fit of a log; its validation takes as long as one of them."""
MAX_SCALE_CORRELATION = 0.97
"""Of the scale of the steering angle with the understeer gradient, above which a log does not tell them apart."""
THIRDS, LEAST_THIRDS = 3, 50.0
"""Stretches of a log that are compared; s of driving from which they are."""
CAR_QUANTITIES = (
    "delay", "lag_share", "rate", "gain", "front", "rear", "mass", "yaw_inertia", "front_share", "relaxation",
)  # fmt: skip
"""Quantities that logs of one car share."""


def fit_log(likelihood: Likelihood, tell: Callable[[int], None] = lambda step: None) -> Fit[Likelihood]:
    """The most likely point z of a log, the covariance of its free entries, and the points that are as likely.

    First all gusts are alike; then their spread follows the log; then it is widened, see `Likelihood.widen_gusts`. A
    scale of the steering angle that the log does not tell from understeer keeps its prior. Of several points that are
    as likely, which lie along a ridge, it returns one between them, and widens the covariance by their scatter. No
    variance is larger than that of the prior.

    tell: called with how many of `FIT_STEPS` are done
    """
    z, rivals = _find_optima(likelihood, tell)
    likelihood.follow_gusts(z)
    z, _ = likelihood.fit(z, NEARLY)
    tell(FIT_STEPS - 1)
    z, at = likelihood.fit(likelihood.widen_gusts(z))
    covariance, free, moving = _covariance(likelihood, z, at), likelihood.free, INDEX.keys() - {"rear"}
    if abs(_scale_correlation(likelihood, z, at)) > MAX_SCALE_CORRELATION:
        place = int(np.flatnonzero(free == INDEX["gain"])[0])
        follow = covariance[place] / covariance[place, place]
        covariance += (1.0 - covariance[place, place]) * np.outer(follow, follow)
        z[free] -= z[INDEX["gain"]] * follow
        z, moving = likelihood.fit_over(INDEX.keys() - {"gain"}, z), moving - {"gain"}
    if rivals:
        likely = np.array([z, *rivals])
        likely[:, INDEX["gain"]] = likely[:, INDEX["gain"]] if "gain" in moving else z[INDEX["gain"]]
        z[free] = likely[:, free].mean(axis=0)
        z, rivals = likelihood.fit_over(moving, z), tuple(likely)
        gaps = (likely - z)[:, free]
        covariance += product(gaps.T, gaps) / len(likely)
    largest = np.maximum(np.sqrt(np.diag(covariance)), 1.0)
    return Fit(likelihood, z, covariance / np.outer(largest, largest), rivals)


# -- optima -----------------------------------------------------------------------------------------------------------
def _find_optima(likelihood: Likelihood, tell: Callable[[int], None]) -> tuple[Array, tuple[Array, ...]]:
    """The best of the nearby optima of a likelihood, and those that are as likely, within `MAX_RIVAL_GAP`.

    tell: called with the number of fits that are done, 9 at most.
    """
    name, values = ("delay", START_DELAYS) if likelihood.log.commanded else ("lateness", START_LATENESSES)
    starts = [starting_point(likelihood, name, value) for value in values]
    starts.append(starting_point(likelihood, name, values[1], START_STIFFNESS))
    optima = [likelihood.fit(min(starts[:-1], key=likelihood.objective), NEARLY)[0]]
    refined: list[Array] = list(optima)
    rough: list[Array] = []
    for z in starts:
        tell(1 + len(rough))
        if math.isfinite(likelihood.objective(z)):
            rough.append(likelihood.fit_over(ROUGH_QUANTITIES, z))
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
    return best, tuple(rivals)


def starting_point(likelihood: Likelihood, name: str, value: float, stiffness: float = 1.0) -> Array:
    """Starting point z with a delay or lateness (s), and a factor on the believed stiffness of both axles.

    Entries that are not estimated are 0.
    """
    median = float(likelihood.median[INDEX[name]])
    shifts = dict.fromkeys(("front", "rear"), portable.log(stiffness))
    shifts[name] = shift_from_zero(value / median) if name == "delay" else value - median
    z = np.zeros(len(QUANTITIES))
    for quantity, shift in shifts.items():
        if (place := INDEX[quantity]) in likelihood.free:
            z[place] = shift / float(likelihood.spread[place])
    return z


def _have_equal_axles(likelihood: Likelihood, z: Array, other: Array) -> bool:
    """Whether two points have nearly the same axles."""
    axles = [INDEX["front"], INDEX["rear"]]
    return bool(np.all(np.abs((z - other)[axles]) * likelihood.spread[axles] < MAX_AXLE_GAP))


# -- covariance -------------------------------------------------------------------------------------------------------
def _covariance(likelihood: Likelihood, z: Array, at: Scored) -> Array:
    """Covariance of z where it is free, in which the understeer gradient is widened instead of the rear axle.

    Both axles are known less well than their balance; widened one by one they would blur it.
    """
    slopes, is_rear = np.eye(likelihood.free.size), likelihood.free == INDEX["rear"]
    if is_rear.any():
        slopes[is_rear] = _understeer_slopes(likelihood, z)
    return likelihood.covariance(at, slopes)


def _scale_correlation(likelihood: Likelihood, z: Array, at: Scored) -> float:
    """Correlation of the scale of the steering angle and the understeer gradient, by the information of the log."""
    place = np.flatnonzero(likelihood.free == INDEX["gain"])
    if not place.size or likelihood.log.ratio_unknown:
        return 0.0
    inverse, slopes = portable.inverse(at.information), _understeer_slopes(likelihood, z)
    along = product(inverse, slopes)
    variances = inverse[place[0], place[0]] * product(slopes, along)
    return float(along[place[0]] / math.sqrt(variances))


def _understeer_slopes(likelihood: Likelihood, z: Array) -> Array:
    """Derivatives of the understeer gradient over the free entries of z."""
    return slopes_at(likelihood, [row for row in likelihood.reported if row.name == "understeer_gradient"], z)[0]


def fit_thirds(fit: Fit[Likelihood]) -> list[Fit[Likelihood]]:
    """Fits of thirds of a long log, each from the point of the whole log; none of a short one."""
    log, parts = fit.likelihood.log, []
    ends = np.linspace(0, log.samples, THIRDS + 1).astype(int)
    for first, last in pairwise(ends) if log.driven_time >= LEAST_THIRDS else ():
        part = fit.likelihood.part(slice(first, last))
        z, at = part.fit(fit.z, NEARLY)
        parts.append(Fit(part, z, _covariance(part, z, at)))
    return parts


# -- several logs -----------------------------------------------------------------------------------------------------
def shared_places(likelihood: Likelihood) -> list[int]:
    """Entries of z that belong to the car and are free."""
    return [int(i) for i in likelihood.free if QUANTITIES[i].name in CAR_QUANTITIES]


def combine(fits: Sequence[Fit[Likelihood]], agree: bool) -> list[Fit[Likelihood]]:
    """The fit of each log, given all logs.

    agree: whether they do; those that do not are granted the scatter of their means as an error of their own (random
    effects; R. DerSimonian and N. Laird, Controlled Clinical Trials 7 (1986) 177-188).
    """
    fits = fits if agree else _widen(fits)
    mean, information = _add(fits)
    return [_condition(fit, mean, information) for fit in fits]


def _widen(fits: Sequence[Fit[Likelihood]]) -> list[Fit[Likelihood]]:
    """Fits with posteriors wider by the scatter of the logs' means."""
    means = np.full((len(fits), len(CAR_QUANTITIES)), np.nan)
    for row, fit in zip(means, fits, strict=True):
        rows, places = _places(fit.likelihood)
        row[places] = fit.z[fit.likelihood.free][rows]
    is_known = np.isfinite(means)
    mean = np.where(is_known, means, 0.0).sum(axis=0) / np.maximum(is_known.sum(axis=0), 1)
    scatter = np.where(is_known, means - mean, 0.0)
    between = (scatter * scatter).sum(axis=0) / np.maximum(is_known.sum(axis=0) - 1, 1)
    wider = []
    for fit in fits:
        rows, places = _places(fit.likelihood)
        covariance = fit.covariance.copy()
        covariance[rows, rows] += between[places]
        wider.append(fit._replace(covariance=covariance))
    return wider


def _places(likelihood: Likelihood) -> tuple[list[int], list[int]]:
    """Rows of the shared entries among the free ones, and among `CAR_QUANTITIES`."""
    shared = shared_places(likelihood)
    names = [QUANTITIES[i].name for i in shared]
    return list(np.searchsorted(likelihood.free, shared)), [CAR_QUANTITIES.index(name) for name in names]


def _add(fits: Sequence[Fit[Likelihood]]) -> tuple[Array, Array]:
    """Mean and information of `CAR_QUANTITIES` given all logs."""
    information, toward = np.eye(len(CAR_QUANTITIES)), np.zeros(len(CAR_QUANTITIES))
    for fit in fits:
        rows, places = _places(fit.likelihood)
        precision = portable.inverse(fit.covariance[np.ix_(rows, rows)])
        values, vectors = portable.eigen(precision - np.eye(len(rows)))
        added = product(vectors * np.maximum(values, 0.0), vectors.T)
        mean = fit.z[fit.likelihood.free][rows]
        freed = product(portable.pseudo_inverse(added), product(precision, mean))
        information[np.ix_(places, places)] += added
        toward[places] += product(added, freed)
    return portable.solve(information, toward), information


def _condition(fit: Fit[Likelihood], mean: Array, information: Array) -> Fit[Likelihood]:
    """A log's fit, where the shared entries are as all logs have them."""
    free, covariance = fit.likelihood.free, fit.covariance
    rows, places = _places(fit.likelihood)
    common = portable.inverse(information)[np.ix_(places, places)]
    shared_block = covariance[np.ix_(rows, rows)]
    follow = product(covariance[:, rows], portable.inverse(shared_block))
    z = fit.z.copy()
    z[free] += product(follow, mean[places] - z[free][rows])
    return fit._replace(z=z, covariance=covariance + product(product(follow, common - shared_block), follow.T))
