"""The landscape: how the cost of driving changes around a schedule, and the moves of its outputs that it prefers.

The tuning with the lowest cost on an operating point is noisy and not unique; how the cost changes with the tuning is
neither. So the three outputs of a schedule (Np, Nc, log10 R/Q) are shifted a little up and down, the cost of every
segment of driving is found for each shift, and a parabola through the three costs says how far each output should move
there and how much that matters. Moves and weights of all segments are one weighted regression; repeated, it is Newton's
method on the mean log cost, averaged over everything that the inputs cannot tell apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.control.scheduling import Schedule
from adaptrack.learning.adaptation.method import Landscape
from adaptrack.tuning.runs import Indices, RunSet

Array = NDArray[np.float64]

OUTPUTS = ("Np", "Nc", "log10_ratio")
"""What a learned schedule has functions for; Q is 1."""


class Wishes(NamedTuple):
    """What the landscape asks of a schedule, a row for each look at the scheduling variables."""

    variables: Array
    """(m, SchedulingVariables) the scheduling variables that occurred"""
    moves: Array
    """(m, 3) how far each output should move there"""
    weights: Array
    """(m, 3) how much that matters"""


@dataclass(frozen=True)
class Rescue:
    """The way from a schedule to a tuning that is safe everywhere."""

    schedule: Callable[[float], Schedule]
    """the schedule a share of the way, 0..1"""
    way: Callable[[Array], Array]
    """(m, 3) the whole way of each output at scheduling variables (m, SchedulingVariables)"""


def preferred_moves(
    base: Array, up: Array, down: Array, share: Array, method: Landscape | None = None
) -> tuple[Array, Array]:
    """How far each output should move, and the weight of that, from the costs at three points along it.

    base (n,), up and down (n, 3): cost of n segments with the outputs as they are, and with each output shifted by
    `method.shift`, all relative to the cost of the whole run; share (n,): the segment's part of that cost. Where a cost
    is not finite nothing is known: weight zero. Returns moves and weights (n, 3); a move is at most two shifts long.
    """
    method = method or Landscape()
    shift, least_curvature = np.array(method.shift), np.array(method.least_curvature)
    known = np.isfinite(up) & np.isfinite(down) & np.isfinite(base)[:, None]
    base, up, down = (np.where(known, costs, 0.0) for costs in (base[:, None], up, down))
    slope = (up - down) / (2.0 * shift)
    curvature = (up + down - 2.0 * base) / shift**2
    weight = np.maximum(curvature, least_curvature * share[:, None])
    weight = np.maximum(weight, np.abs(slope) / (2.0 * shift))
    moves = np.divide(-slope, weight, out=np.zeros_like(slope), where=weight > 0.0)
    return moves, np.where(known, weight, 0.0)


def landscape(
    runs: RunSet, schedule: Callable[[Array], Schedule], seed: int, which: Indices, method: Landscape,
    rescue: Rescue | None = None,
) -> Wishes:  # fmt: skip
    """What the landscape around a schedule asks for, on some runs with one noise seed.

    schedule: makes it with its outputs shifted by (3,); rescue: what failed runs are driven with again.

    Raises
    ------
    InvalidInput
        When an estimator says what friction and wind are: what it says is not known before driving.
    """
    if isinstance(runs.known_as, FrictionWindEstimator):
        raise InvalidInput("runs known by an estimator cannot be learned from: learn from the exact values.")

    def costs(by: Array) -> Array:
        return runs.segments(schedule(by), seed, which)

    base = costs(np.zeros(3))
    scale = _run_costs(base, runs)
    here = _relative(base, scale, method)
    up, down = (
        np.stack([_relative(costs(sign * by), scale, method) for by in np.diag(method.shift)], axis=-1)
        for sign in (1.0, -1.0)
    )
    share = np.clip(np.nan_to_num(here), 0.0, 1.0) + method.least_share
    moves, weights = preferred_moves(here.ravel(), up.reshape(-1, 3), down.reshape(-1, 3), share.ravel(), method)
    per_segment = Wishes(base, moves.reshape(*base.shape, 3), weights.reshape(*base.shape, 3))
    shares = np.zeros(base.shape) if rescue is None else _saving_shares(runs, base, rescue, seed, which, method)
    looks = [_looks(runs, i, which, per_segment, shares[:, i], rescue, method) for i in range(base.shape[1])]
    variables, moves, weights = (np.concatenate(parts) for parts in zip(*looks, strict=True))
    return Wishes(variables, moves, weights / len(which))


def _run_costs(base: Array, runs: RunSet) -> Array:
    """(runs, 1) cost of each run; of a failed one, the median of the others."""
    total = np.nansum(np.where(np.isfinite(base), base, 0.0), axis=1)
    failed = np.isinf(base).any(axis=1)
    usual = np.median(total[~failed]) if not failed.all() else runs.failed_cost * runs.periods
    return np.where(failed, usual, total)[:, None]


def _relative(costs: Array, scale: Array, method: Landscape) -> Array:
    return np.minimum(costs / scale, method.worst_segment)


def _looks(
    runs: RunSet, i: int, which: Indices, per_segment: Wishes, shares: Array, rescue: Rescue | None, method: Landscape
) -> Wishes:
    """The wishes of segment i of each run, put down to the scheduling variables in it and shortly before it."""
    first = max(0, i * runs.segment - runs.before)
    near = runs.variables[which, first : (i + 1) * runs.segment : runs.stride]
    count = near.shape[1]
    variables = near.reshape(-1, near.shape[2])
    moves = np.repeat(per_segment.moves[:, i], count, axis=0)
    weights = np.repeat(per_segment.weights[:, i], count, axis=0) / count
    part = np.repeat(shares, count)
    if rescue is not None and (saved := part > 0.0).any():
        way = part[saved, None] * rescue.way(variables[saved])
        moves[saved] = way
        weights[saved] = 2.0 * method.worst_segment / np.maximum(np.abs(way), np.array(method.shift)) ** 2 / count
    return Wishes(variables, moves, weights)


def _saving_shares(runs: RunSet, base: Array, rescue: Rescue, seed: int, which: Indices, method: Landscape) -> Array:
    """(runs, segments) the least share of the way that saves a failed run, in the segments up to its failure."""
    shares = np.zeros(base.shape)
    failed = np.flatnonzero(np.isinf(base).any(axis=1))
    for share in method.rescues:
        if not failed.size:
            break
        saved = np.isfinite(runs.segments(rescue.schedule(share), seed, which[failed])).all(axis=1)
        for i in failed[saved]:
            last = int(np.argmax(np.isinf(base[i])))
            shares[i, max(0, last - method.before_failure) : last + 1] = share
        failed = failed[~saved]
    return shares
