"""The improvement of a schedule on the closed loop: its outputs follow the moves that lower the cost of its own runs.

The tuning with the lowest cost on an operating point is noisy and not unique; the slope of the cost is neither. So the
three outputs of a schedule (Np, Nc, log10 R/Q) are shifted a little up and down, and a parabola through the three costs
of a segment of driving gives the move of the output there and its weight. Moves and weights of all segments are one
weighted regression; repeated, it is Newton's method on the mean log cost.

Every round has new sensor noise and other runs. Some runs are held out to choose the best round.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from adaptrack.base.checked import whole_number
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.progress import reports_progress
from adaptrack.control.controllers import Tuning
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.control.scheduling import Function, Learned, Schedule, SchedulingVariables
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.paper.surfaces import Surface
from adaptrack.tuning.runs import Indices, RunSet

# -- the landscape around a schedule ----------------------------------------------------------------------------------
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

    schedule: the schedule with its outputs shifted by (3,); seed: of the noise; rescue: for runs that fail. Raises
    InvalidInput when the runs estimate friction and wind: the estimates are unknown before driving.
    """
    if isinstance(runs.perception, FrictionWindEstimator):
        raise InvalidInput("runs with estimated friction and wind cannot be learned from: use the exact values.")

    base = runs.segments(schedule(np.zeros(3)), seed, indices)
    scale = _run_costs(base, runs)

    def relative_cost(shift: Array) -> Array:
        return np.minimum(runs.segments(schedule(shift), seed, indices) / scale, MAX_SEGMENT_COST)

    relative = np.minimum(base / scale, MAX_SEGMENT_COST)
    up, down = (
        np.stack([relative_cost(sign * shift) for shift in np.diag(OUTPUT_SHIFT)], axis=-1) for sign in (1.0, -1.0)
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


# -- the rounds -------------------------------------------------------------------------------------------------------
Surfaces = Mapping[str, Surface]
"""One for each of `LEARNED_OUTPUTS`."""
Training = Sequence[tuple[RunSet, int]]
"""Run sets to learn from, each with the number of its runs that a round drives."""

LEARNING_ROUNDS = 32
"""After 25 rounds the cost of the held-out runs of the shipped schedules fell by less than 1 % more."""
CHECK_INTERVAL = 5
"""Rounds between two scores on the held-out runs."""
AVERAGED_ROUNDS = 8
"""Latest rounds whose parameters are averaged for a score: each round has other roads and other noise."""
REVISITED = 16
"""One in so many runs of a round has failed before, if any has: failures are too rare to be drawn by chance."""
DAMPING, FINAL_DAMPING = 0.7, 0.3
"""Share of a move that the first round takes, and the share of that damping that is left in the end (linear)."""
FINAL_EFFORT = 0.2
"""Share of the work of a fit that is left in the end (square root): late rounds only average noise."""
TUNING_BOUNDS = {"Np": (10.0, 60.0), "Nc": (1.0, 20.0), "R": (10.0, 1e6)}
"""Range of learned tunings: periods, periods, 1/rad^2 with Q = 1 per m^2. An MPC forms 60 and 20 periods by default."""
OUTPUT_BOUNDS = np.array([TUNING_BOUNDS["Np"], TUNING_BOUNDS["Nc"], portable.log10(TUNING_BOUNDS["R"])])
"""(3, 2) of the outputs."""
NOISE_BLOCK, HELD_OUT_NOISE, TRAINING_NOISE = 100_000, 900, 1_000
"""Noise seeds: a block for each seed, in it those of the held-out runs and of round 0, from which they count up."""


@dataclass(frozen=True, eq=False)
class Learnable:
    """A schedule whose outputs can learn."""

    surfaces: Surfaces
    """of Np, Nc and log10_ratio (R/Q, Q = 1)"""
    inputs: Sequence[str]
    """scheduling variables, in the order of the surfaces' inputs"""
    domain: Array
    """(inputs, 2) low and high, see `Schedule`"""
    name: str = "learned"


@dataclass(frozen=True, eq=False)
class Improvement:
    """A learned schedule, and the course of its learning."""

    schedule: Schedule
    surfaces: Surfaces
    history: list[dict[str, float]]
    """after each check: round, score (mean log cost of the held-out runs), failed (number of them)"""


@reports_progress("improve")
def improve(
    start: Learnable, training: Training, held_out: Sequence[RunSet], *, rounds: int = LEARNING_ROUNDS, seed: int = 0,
    safe: Tuning | None = None, progress: Callable[[int, int], None] | None = None,
) -> Improvement:  # fmt: skip
    """Move the three outputs of a schedule `rounds` times towards lower costs of its own closed loop.

    start: the schedule before the first round; training: a round drives some runs of each set, drawn anew; held_out:
    after every few rounds the schedule, its parameters averaged over the latest rounds (Polyak and Juditsky, 1992), is
    scored on them by the mean log cost, each run set alike, and the best one is returned; safe: a tuning towards which
    failed runs are repeated, so that the learning includes the moves that save them.

    Raises
    ------
    InvalidInput
        When a surface is missing, or an input is unknown before driving.
    """
    learner = _Learner.of(start, training, safe)
    rng = np.random.default_rng((seed, 0xADA))
    surfaces: Surfaces = dict(start.surfaces)
    latest: list[Surfaces] = []
    failures: list[set[int]] = [set() for _ in training]
    checks = [learner.check(surfaces, held_out, seed, 0)]
    for k in range(rounds):
        if progress is not None:
            progress(k, rounds)
        noise = NOISE_BLOCK * seed + TRAINING_NOISE + k
        if k % CHECK_INTERVAL == 0:
            schedule = learner.schedule(surfaces)
            for (runs, _), failed in zip(training, failures, strict=True):
                failed |= set(np.flatnonzero(~np.isfinite(runs.drive(schedule, [noise])[:, 0])).tolist())
        drawn = [
            _draw_runs(rng, len(runs), count, failed) for (runs, count), failed in zip(training, failures, strict=True)
        ]
        surfaces = learner.step(surfaces, learner.moves(surfaces, training, drawn, noise), 1.0 - k / rounds)
        latest = [*latest[1 - AVERAGED_ROUNDS :], surfaces]
        if (k + 1) % CHECK_INTERVAL == 0 or k == rounds - 1:
            averaged = {
                slot: surfaces[slot].average([earlier[slot] for earlier in latest[:-1]]) for slot in LEARNED_OUTPUTS
            }
            checks.append(learner.check(averaged, held_out, seed, k + 1))
    best = min(checks, key=lambda check: check.history[0]["score"])
    return replace(best, history=[entry for check in checks for entry in check.history])


def _draw_runs(rng: np.random.Generator, runs: int, count: int, failed: set[int]) -> Indices:
    """Runs of a round: some that failed before, and others at random."""
    count = min(count, runs)
    revisited = rng.permutation(sorted(failed))[: count // REVISITED].astype(np.int64)
    untried = np.setdiff1d(np.arange(runs), revisited)
    return np.sort(np.concatenate([revisited, rng.choice(untried, count - len(revisited), replace=False)]))


@dataclass(frozen=True, eq=False)
class _Learner:
    """The fixed part of a learning: from surfaces to a schedule, and the steps of the surfaces."""

    start: Learnable
    goal: Array | None
    """(3,) outputs of the safe tuning"""

    @classmethod
    def of(cls, start: Learnable, training: Training, safe: Tuning | None) -> _Learner:
        if set(start.surfaces) != set(LEARNED_OUTPUTS):
            raise InvalidInput(f"improve: need a surface for each of {', '.join(LEARNED_OUTPUTS)}.")
        for name in start.inputs:
            if name not in SchedulingVariables._fields:
                raise InvalidInput(
                    f"improve: unknown input {name!r}. {did_you_mean(name, SchedulingVariables._fields)}"
                )
        if "offset" in start.inputs:
            raise InvalidInput("improve: the input 'offset' depends on the driving itself: leave it out.")
        for _, count in training:
            whole_number("improve", "count", count)
        goal = None if safe is None else np.array([safe.Np, safe.Nc, portable.log10(safe.R / safe.Q)])
        return cls(start, goal)

    def schedule(self, surfaces: Surfaces) -> Schedule:
        """The schedule of the surfaces."""
        return self._learned([surfaces[slot].function() for slot in LEARNED_OUTPUTS])

    def _learned(self, functions: Sequence[Function]) -> Schedule:
        by_slot, start = dict(zip(LEARNED_OUTPUTS, functions, strict=True)), self.start
        return Learned(by_slot, tuple(start.inputs), start.domain, TUNING_BOUNDS, name=start.name)

    def _inputs(self, variables: Array) -> Array:
        columns = [SchedulingVariables._fields.index(name) for name in self.start.inputs]
        return np.clip(variables[:, columns], *self.start.domain.T)

    def _outputs(self, surfaces: Surfaces, variables: Array) -> Array:
        return np.stack([surfaces[slot].predict(self._inputs(variables)) for slot in LEARNED_OUTPUTS], axis=1)

    def check(self, surfaces: Surfaces, held_out: Sequence[RunSet], seed: int, k: int) -> Improvement:
        """The schedule of surfaces after round k, and its score on the held-out runs as the entry of a history."""
        schedule, noise = self.schedule(surfaces), NOISE_BLOCK * seed + HELD_OUT_NOISE
        costs = [runs.costs(schedule, [noise]) for runs in held_out]
        score = float(np.mean([portable.log(values).mean() for values in costs]))
        failed = sum((values >= runs.failed_cost).sum() for values, runs in zip(costs, held_out, strict=True))
        return Improvement(schedule, surfaces, [{"round": k, "score": score, "failed": float(failed)}])

    def moves(self, surfaces: Surfaces, training: Training, drawn: Sequence[Indices], noise: int) -> WeightedMoves:
        """The moves that lower the costs of the drawn runs."""
        functions = [surfaces[slot].function() for slot in LEARNED_OUTPUTS]

        def shifted(shift: Array) -> Schedule:
            return self._learned([f.shifted(float(by)) for f, by in zip(functions, shift, strict=True)])

        rescue = self._rescue(surfaces, functions)
        parts = [
            explore_landscape(runs, shifted, noise, indices, rescue)
            for (runs, _), indices in zip(training, drawn, strict=True)
        ]
        return WeightedMoves(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _rescue(self, surfaces: Surfaces, functions: Sequence[Function]) -> Rescue | None:
        if self.goal is None:
            return None
        goal = self.goal

        def blended(share: float) -> Schedule:
            return self._learned([f.blended(share, float(value)) for f, value in zip(functions, goal, strict=True)])

        return Rescue(blended, lambda variables: goal - self._outputs(surfaces, variables))

    def step(self, surfaces: Surfaces, moves: WeightedMoves, left: float) -> Surfaces:
        """The surfaces after a damped step of the weighted regression; left: share of the rounds still to come."""
        damping = DAMPING * (FINAL_DAMPING + (1.0 - FINAL_DAMPING) * left)
        effort = FINAL_EFFORT + (1.0 - FINAL_EFFORT) * math.sqrt(left)
        targets = np.clip(self._outputs(surfaces, moves.variables) + damping * moves.moves, *OUTPUT_BOUNDS.T)
        x = self._inputs(moves.variables)
        with ThreadPoolExecutor() as pool:
            fits = [
                pool.submit(surfaces[slot].fit, x, target, weight, effort)
                for slot, target, weight in zip(LEARNED_OUTPUTS, targets.T, moves.weights.T, strict=True)
            ]
            return {slot: fit.result() for slot, fit in zip(LEARNED_OUTPUTS, fits, strict=True)}
