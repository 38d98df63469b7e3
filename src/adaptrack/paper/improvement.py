"""The improvement of a schedule on the closed loop: its outputs follow the moves that lower the cost of its own runs.

Every round has new sensor noise and other runs. Some runs are held out to choose the best round.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import whole_number
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.progress import reports_progress
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Function, Learned, Schedule, SchedulingVariables
from adaptrack.core.maths import portable
from adaptrack.paper.landscape import LEARNED_OUTPUTS, Rescue, WeightedMoves, explore_landscape
from adaptrack.paper.surfaces import Surface
from adaptrack.tuning.runs import Indices, RunSet

Array = NDArray[np.float64]
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
    course = _Course(dict(start.surfaces), [set() for _ in training])
    course.note_score(*learner.score(start.surfaces, held_out, seed, 0))
    for k in range(rounds):
        if progress is not None:
            progress(k, rounds)
        noise = NOISE_BLOCK * seed + TRAINING_NOISE + k
        if k % CHECK_INTERVAL == 0:
            course.note_failures(training, learner.schedule(course.surfaces), noise)
        drawn = [
            _draw_runs(rng, len(runs), count, failed)
            for (runs, count), failed in zip(training, course.failed, strict=True)
        ]
        moves = learner.moves(course.surfaces, training, drawn, noise)
        course.advance(learner.step(course.surfaces, moves, 1.0 - k / rounds))
        if (k + 1) % CHECK_INTERVAL == 0 or k == rounds - 1:
            course.note_score(*learner.score(course.averaged(), held_out, seed, k + 1))
    assert course.best is not None
    return Improvement(*course.best, course.history)


def _draw_runs(rng: np.random.Generator, runs: int, count: int, failed: set[int]) -> Indices:
    """Runs of a round: some that failed before, and others at random."""
    count = min(count, runs)
    revisited = rng.permutation(sorted(failed))[: count // REVISITED].astype(np.int64)
    untried = np.setdiff1d(np.arange(runs), revisited)
    return np.sort(np.concatenate([revisited, rng.choice(untried, count - len(revisited), replace=False)]))


@dataclass(eq=False)
class _Course:
    """The part of a learning that changes from round to round."""

    surfaces: Surfaces
    failed: list[set[int]]
    """runs of each run set that have failed at some time"""
    latest: list[Surfaces] = field(default_factory=list)
    """of the latest rounds"""
    best: tuple[Schedule, Surfaces] | None = None
    best_score: float = math.inf
    history: list[dict[str, float]] = field(default_factory=list)

    def note_failures(self, training: Training, schedule: Schedule, noise: int) -> None:
        """Drive all training runs and remember those that fail."""
        for (runs, _), failed in zip(training, self.failed, strict=True):
            failed |= set(np.flatnonzero(~np.isfinite(runs.drive(schedule, [noise])[:, 0])).tolist())

    def advance(self, surfaces: Surfaces) -> None:
        """Take the surfaces of the next round."""
        self.surfaces = surfaces
        self.latest = [*self.latest[1 - AVERAGED_ROUNDS :], surfaces]

    def averaged(self) -> Surfaces:
        """The surfaces with the mean of the parameters of the latest rounds."""
        earlier = self.latest[:-1]
        return {slot: self.surfaces[slot].average([surfaces[slot] for surfaces in earlier]) for slot in LEARNED_OUTPUTS}

    def note_score(self, schedule: Schedule, surfaces: Surfaces, entry: dict[str, float]) -> None:
        """Note a score, and its schedule if it is the best."""
        self.history.append(entry)
        if self.best is None or entry["score"] < self.best_score:
            self.best, self.best_score = (schedule, surfaces), entry["score"]


@dataclass(frozen=True, eq=False)
class _Learner:
    """The fixed part of a learning: from surfaces to a schedule, and the steps of the surfaces."""

    inputs: tuple[str, ...]
    columns: list[int]
    """of the inputs, among the scheduling variables"""
    domain: Array
    goal: Array | None
    """(3,) outputs of the safe tuning"""
    name: str

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
        columns = [SchedulingVariables._fields.index(name) for name in start.inputs]
        return cls(tuple(start.inputs), columns, start.domain, goal, start.name)

    def schedule(self, surfaces: Surfaces) -> Schedule:
        """The schedule of the surfaces."""
        return self._learned([surfaces[slot].function() for slot in LEARNED_OUTPUTS])

    def _learned(self, functions: Sequence[Function]) -> Schedule:
        return Learned(
            dict(zip(LEARNED_OUTPUTS, functions, strict=True)), self.inputs, self.domain, TUNING_BOUNDS, name=self.name
        )

    def _inputs(self, variables: Array) -> Array:
        return np.clip(variables[:, self.columns], *self.domain.T)

    def _outputs(self, surfaces: Surfaces, variables: Array) -> Array:
        return np.stack([surfaces[slot].predict(self._inputs(variables)) for slot in LEARNED_OUTPUTS], axis=1)

    def score(
        self, surfaces: Surfaces, held_out: Sequence[RunSet], seed: int, k: int
    ) -> tuple[Schedule, Surfaces, dict[str, float]]:
        """The schedule, its surfaces, and the entry of the history: its score on the held-out runs after round k."""
        schedule, noise = self.schedule(surfaces), NOISE_BLOCK * seed + HELD_OUT_NOISE
        costs = [runs.costs(schedule, [noise]) for runs in held_out]
        score = float(np.mean([portable.log(values).mean() for values in costs]))
        failed = sum((values >= runs.failed_cost).sum() for values, runs in zip(costs, held_out, strict=True))
        return schedule, surfaces, {"round": k, "score": score, "failed": float(failed)}

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
