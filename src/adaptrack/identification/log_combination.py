"""Several logs of one car: what belongs to the car is shared, the rest is each log's own.

Each log's posterior is freed of the prior, which they share, and what remains is added in information form: with
means m_k and covariances C_k of the shared entries of z, whose prior is standard normal,

    C^-1 = I + sum(C_k^-1 - I),    C^-1 m = sum(C_k^-1 m_k)

(the logs are independent given the car). Once more at the common point, which mends what is not linear. Each log's own
entries follow as they do in its Gaussian posterior.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import product
from adaptrack.identification.likelihood import Likelihood
from adaptrack.identification.quantities import QUANTITIES

Array = NDArray[np.float64]

CAR_QUANTITIES = (
    "delay", "lag_share", "rate", "gain", "front", "rear", "mass", "yaw_inertia", "front_share", "relaxation",
)  # fmt: skip
"""Quantities that logs of one car share."""


class Fitted(Protocol):
    """A log's most likely point."""

    @property
    def likelihood(self) -> Likelihood: ...
    @property
    def z(self) -> Array: ...
    @property
    def covariance(self) -> Array: ...


def shared_by(likelihood: Likelihood) -> list[int]:
    """Entries of z that belong to the car and are free."""
    return [int(i) for i in likelihood.free if QUANTITIES[i].name in CAR_QUANTITIES]


def combined(fits: Sequence[Fitted], agree: bool) -> list[tuple[Array, Array]]:
    """For each log the point z and the covariance of its free entries, given all logs.

    agree: whether they do; those that do not are granted the scatter of their means as an error of their own (random
    effects; R. DerSimonian and N. Laird, Controlled Clinical Trials 7 (1986) 177-188).
    """
    posteriors = [(fit.z, fit.covariance) for fit in fits] if agree else _parted(fits)
    mean, information = _added(fits, posteriors)
    return [_condition(fit, *posterior, mean, information) for fit, posterior in zip(fits, posteriors, strict=True)]


def _parted(fits: Sequence[Fitted]) -> list[tuple[Array, Array]]:
    """Posteriors wider by the scatter of the logs' means."""
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
        wider.append((fit.z, covariance))
    return wider


def _places(likelihood: Likelihood) -> tuple[list[int], list[int]]:
    """Rows of the shared entries among the free ones, and among `CAR_QUANTITIES`."""
    shared = shared_by(likelihood)
    names = [QUANTITIES[i].name for i in shared]
    return list(np.searchsorted(likelihood.free, shared)), [CAR_QUANTITIES.index(name) for name in names]


def _added(fits: Sequence[Fitted], posteriors: Sequence[tuple[Array, Array]]) -> tuple[Array, Array]:
    """Mean and information of `CAR_QUANTITIES` given all logs."""
    information, toward = np.eye(len(CAR_QUANTITIES)), np.zeros(len(CAR_QUANTITIES))
    for fit, (z, covariance) in zip(fits, posteriors, strict=True):
        rows, places = _places(fit.likelihood)
        precision = portable.inverse(covariance[np.ix_(rows, rows)])
        values, vectors = portable.eigen(precision - np.eye(len(rows)))
        added = product(vectors * np.maximum(values, 0.0), vectors.T)
        mean = z[fit.likelihood.free][rows]
        freed = product(portable.pseudo_inverse(added), product(precision, mean))
        information[np.ix_(places, places)] += added
        toward[places] += product(added, freed)
    return portable.solve(information, toward), information


def _condition(
    fit: Fitted, z: Array, covariance: Array, mean: Array, information: Array
) -> tuple[Array, Array]:  # fmt: skip
    """A log's point and covariance, where the shared entries are as all logs have them."""
    free = fit.likelihood.free
    rows, places = _places(fit.likelihood)
    common = portable.inverse(information)[np.ix_(places, places)]
    follow = product(covariance[:, rows], portable.inverse(covariance[np.ix_(rows, rows)]))
    there = z.copy()
    there[free] += product(follow, mean[places] - z[free][rows])
    return there, covariance + product(product(follow, common - covariance[np.ix_(rows, rows)]), follow.T)
