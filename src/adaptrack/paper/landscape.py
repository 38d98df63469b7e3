"""The landscape around a schedule: how its closed-loop cost changes with its outputs, and the moves that lower it.

The tuning with the lowest cost on an operating point is noisy and not unique; the slope of the cost is neither. So the
three outputs of a schedule (Np, Nc, log10 R/Q) are shifted a little up and down, and a parabola through the three costs
of a segment of driving gives the move of the output there and its weight. Moves and weights of all segments are one
weighted regression; repeated, it is Newton's method on the mean log cost.
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
from adaptrack.core.maths import portable
from adaptrack.tuning.runs import Indices, RunSet

Array = NDArray[np.float64]

LEARNED_OUTPUTS = ("Np", "Nc", "log10_ratio")
"""Entries that a learned schedule has functions for. Only R/Q changes the control law; Q is 1."""
OUTPUT_SHIFT = np.array([3.0, 1.5, 0.15])
"""Shift of each output. Horizons are whole, so smaller ones are lost in rounding; larger ones leave the parabola."""
MIN_CURVATURE = np.array([0.002, 0.005, 0.3])
"""Curvature of the relative cost per squared unit that flatter segments count as: flat segments keep their tuning."""
MIN_SHARE = 1e-3
"""Share of a run's cost that is added to the share of every segment for `MIN_CURVATURE`, so that no weight is zero."""
MAX_SEGMENT_COST = 5.0
"""Largest cost of a segment, in costs of its run: one failure must not outweigh all other segments."""
RESCUE_SHARES = (0.25, 0.5, 1.0)
"""Shares of the way to the fallback at which a failed run is repeated, the smallest first."""
SEGMENTS_BEFORE_FAILURE = 2
"""Segments before a failure that share its cause: a car leaves the road some seconds after the mistake."""


class WeightedMoves(NamedTuple):
    """Moves of the outputs that lower the cost, one row for each sample of the scheduling variables."""

    variables: Array
    """(m, SchedulingVariables)"""
    moves: Array
    """(m, 3) of the outputs"""
    weights: Array
    """(m, 3) curvature of the relative cost"""


@dataclass(frozen=True)
class Rescue:
    """The way from a schedule to a tuning that keeps the car on the road."""

    schedule: Callable[[float], Schedule]
    """the schedule a share of the way, 0..1"""
    way: Callable[[Array], Array]
    """(m, 3) whole way of the outputs at scheduling variables (m, SchedulingVariables)"""


def preferred_moves(base: Array, up: Array, down: Array, share: Array) -> tuple[Array, Array]:
    """Moves of the outputs to the minimum of a parabola through three costs, and their weights, each (n, 3).

    base (n,), up and down (n, 3): costs of n segments with the outputs unchanged, and with one output shifted by
    `OUTPUT_SHIFT`, all relative to the cost of the run; share (n,): the segment's part of that cost. A cost that is
    not finite gives weight zero. A move is at most two shifts long.
    """
    finite = np.isfinite(up) & np.isfinite(down) & np.isfinite(base)[:, None]
    base, up, down = (np.where(finite, costs, 0.0) for costs in (base[:, None], up, down))
    slope = (up - down) / (2.0 * OUTPUT_SHIFT)
    curvature = (up + down - 2.0 * base) / (OUTPUT_SHIFT * OUTPUT_SHIFT)
    weight = np.maximum(curvature, MIN_CURVATURE * share[:, None])
    weight = np.maximum(weight, np.abs(slope) / (2.0 * OUTPUT_SHIFT))
    moves = np.divide(-slope, weight, out=np.zeros_like(slope), where=weight > 0.0)
    return moves, np.where(finite, weight, 0.0)


def explore_landscape(
    runs: RunSet, schedule: Callable[[Array], Schedule], seed: int, indices: Indices, rescue: Rescue | None = None
) -> WeightedMoves:
    """Drive some runs with every output shifted up and down, and return the moves that lower their cost.

    schedule: the schedule with its outputs shifted by (3,); seed: of the noise; rescue: for runs that fail.

    Raises
    ------
    InvalidInput
        When the runs estimate friction and wind: the estimates are unknown before driving.
    """
    if isinstance(runs.perception, FrictionWindEstimator):
        raise InvalidInput("runs with estimated friction and wind cannot be learned from: use the exact values.")

    def costs(shift: Array) -> Array:
        return runs.segments(schedule(shift), seed, indices)

    base = costs(np.zeros(3))
    scale = _run_costs(base, runs)
    relative = _relative(base, scale)
    up, down = (
        np.stack([_relative(costs(sign * shift), scale) for shift in np.diag(OUTPUT_SHIFT)], axis=-1)
        for sign in (1.0, -1.0)
    )
    share = np.clip(np.nan_to_num(relative), 0.0, 1.0) + MIN_SHARE
    moves, weights = preferred_moves(relative.ravel(), up.reshape(-1, 3), down.reshape(-1, 3), share.ravel())
    segments = WeightedMoves(base, moves.reshape(*base.shape, 3), weights.reshape(*base.shape, 3))
    shares = np.zeros(base.shape) if rescue is None else _rescue_shares(runs, base, rescue, seed, indices)
    parts = [_sample_segment(runs, i, indices, segments, shares[:, i], rescue) for i in range(base.shape[1])]
    variables, moves, weights = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    return WeightedMoves(variables, moves, weights / len(indices))


def _run_costs(base: Array, runs: RunSet) -> Array:
    """(runs, 1) cost of each run; the median of the others for a failed one."""
    total = np.nansum(np.where(np.isfinite(base), base, 0.0), axis=1)
    failed = np.isinf(base).any(axis=1)
    median = np.median(total[~failed]) if not failed.all() else runs.failed_cost * runs.periods
    return np.where(failed, median, total)[:, None]


def _relative(costs: Array, scale: Array) -> Array:
    return np.minimum(costs / scale, MAX_SEGMENT_COST)


def _sample_segment(
    runs: RunSet, i: int, indices: Indices, segments: WeightedMoves, shares: Array, rescue: Rescue | None
) -> WeightedMoves:
    """Assign the moves of segment i of each run to the scheduling variables in it and shortly before it."""
    first = max(0, i * runs.segment - runs.before)
    samples = runs.variables[indices, first : (i + 1) * runs.segment : runs.stride]
    count = samples.shape[1]
    variables = samples.reshape(-1, samples.shape[2])
    moves = np.repeat(segments.moves[:, i], count, axis=0)
    weights = np.repeat(segments.weights[:, i], count, axis=0) / count
    part = np.repeat(shares, count)
    if rescue is not None and (rescued := part > 0.0).any():
        way = part[rescued, None] * rescue.way(variables[rescued])
        moves[rescued] = way
        weights[rescued] = 2.0 * MAX_SEGMENT_COST / portable.square(np.maximum(np.abs(way), OUTPUT_SHIFT)) / count
    return WeightedMoves(variables, moves, weights)


def _rescue_shares(runs: RunSet, base: Array, rescue: Rescue, seed: int, indices: Indices) -> Array:
    """(runs, segments) smallest share of the way that saves a failed run, in the segments up to its failure."""
    shares = np.zeros(base.shape)
    failed = np.flatnonzero(np.isinf(base).any(axis=1))
    for share in RESCUE_SHARES:
        if not failed.size:
            break
        rescued = np.isfinite(runs.segments(rescue.schedule(share), seed, indices[failed])).all(axis=1)
        for i in failed[rescued]:
            last = int(np.argmax(np.isinf(base[i])))
            shares[i, max(0, last - SEGMENTS_BEFORE_FAILURE) : last + 1] = share
        failed = failed[~rescued]
    return shares
