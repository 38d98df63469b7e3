"""The improvement of a schedule on the closed loop: its outputs follow what the landscape of their own driving prefers.

Sensor noise is drawn anew in every round, and some runs are held out to choose the round that is kept.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import whole
from adaptrack.base.errors import InvalidInput, did_you_mean
from adaptrack.base.progress import tells
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Function, Learned, Schedule, SchedulingVariables
from adaptrack.learning.adaptation.landscape import OUTPUTS, Rescue, Wishes, landscape
from adaptrack.learning.adaptation.method import Method
from adaptrack.learning.adaptation.splits import Training, held_out_noise, training_noise
from adaptrack.paper.surfaces import Surface
from adaptrack.tuning.runs import Indices, RunSet

Array = NDArray[np.float64]
Surfaces = Mapping[str, Surface]
"""One for each of `OUTPUTS`."""


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
    """A schedule that learned, and how."""

    schedule: Schedule
    surfaces: Surfaces
    history: list[dict[str, float]]
    """after each check: round, score (mean log cost of the held-out runs), failed (of them)"""


@tells("improve")
def improve(
    start: Learnable,
    training: Training,
    held_out: Sequence[RunSet],
    *,
    rounds: int = 60,
    seed: int = 0,
    method: Method | None = None,
    safe: Tuning | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Improvement:
    """Move a schedule's three outputs towards what the landscape of its own closed loop prefers, `rounds` times.

    start: the schedule before the first round; training: run sets, each with the number of its runs that a round
    drives, drawn anew; held_out: after every few rounds the schedule, its parameters averaged over the latest rounds
    (Polyak and Juditsky, 1992), is scored on them by the mean log cost, each run set alike, and the best one is
    returned; safe: a tuning towards which failed runs are driven again, so that what saves them is learned, too.

    Raises
    ------
    InvalidInput
        When a surface is missing, or an input cannot be known before driving.
    """
    learner = _Learner.of(start, training, method or Method(), safe)
    rng = np.random.default_rng((seed, 0xADA))
    state = _State(dict(start.surfaces), [set() for _ in training])
    state.keep_if_best(*learner.judged(start.surfaces, held_out, seed, k=0))
    for k in range(rounds):
        if progress is not None:
            progress(k, rounds)
        noise, left = training_noise(learner.method, seed, k), 1.0 - k / rounds
        if k % learner.check == 0:
            state.note_failures(training, learner.schedule(state.surfaces), noise)
        chosen = [
            _chosen(rng, len(runs), count, failed, learner.method.improvement.revisited)
            for (runs, count), failed in zip(training, state.failed, strict=True)
        ]
        wishes = learner.wishes(state.surfaces, training, chosen, noise)
        state.follow(learner.step(state.surfaces, wishes, left), learner.method.improvement.averaged)
        if (k + 1) % learner.check == 0 or k == rounds - 1:
            state.keep_if_best(*learner.judged(state.averaged(), held_out, seed, k + 1))
    assert state.best is not None
    return Improvement(state.best[0], state.best[1], state.history)


@dataclass(eq=False)
class _State:
    """What changes from round to round."""

    surfaces: Surfaces
    failed: list[set[int]]
    """of each run set, the runs that were found to fail"""
    latest: list[Surfaces] = field(default_factory=list)
    """of the latest rounds"""
    best: tuple[Schedule, Surfaces] | None = None
    best_score: float = math.inf
    history: list[dict[str, float]] = field(default_factory=list)

    def note_failures(self, training: Training, schedule: Schedule, noise: int) -> None:
        """Drive all training runs and remember those that fail."""
        for (runs, _), failed in zip(training, self.failed, strict=True):
            failed |= set(np.flatnonzero(~np.isfinite(runs.drive(schedule, [noise])[:, 0])).tolist())

    def follow(self, surfaces: Surfaces, averaged: int) -> None:
        """The surfaces of the next round."""
        self.surfaces = surfaces
        self.latest = [*self.latest[1 - averaged :], surfaces] if averaged > 1 else [surfaces]

    def averaged(self) -> Surfaces:
        """The surfaces with the mean of the parameters of the latest rounds."""
        others = self.latest[:-1]
        return {slot: self.surfaces[slot].average([each[slot] for each in others]) for slot in OUTPUTS}

    def keep_if_best(self, schedule: Schedule, surfaces: Surfaces, entry: dict[str, float]) -> None:
        """Note a score, and its schedule if none was better."""
        self.history.append(entry)
        if self.best is None or entry["score"] < self.best_score:
            self.best, self.best_score = (schedule, surfaces), entry["score"]


@dataclass(frozen=True, eq=False)
class _Learner:
    """What stays: how surfaces become a schedule, and how they take a step."""

    inputs: tuple[str, ...]
    columns: list[int]
    """of the inputs, among the scheduling variables"""
    domain: Array
    method: Method
    goal: Array | None
    """(3,) outputs of the safe tuning"""
    name: str

    @classmethod
    def of(cls, start: Learnable, training: Training, method: Method, safe: Tuning | None) -> _Learner:
        inputs = tuple(start.inputs)
        if set(start.surfaces) != set(OUTPUTS):
            raise InvalidInput(f"improve: need a surface for each of {', '.join(OUTPUTS)}.")
        for each in inputs:
            if each not in SchedulingVariables._fields:
                raise InvalidInput(
                    f"improve: unknown input {each!r}. {did_you_mean(each, SchedulingVariables._fields)}"
                )
        if "offset" in inputs:
            raise InvalidInput("improve: the offset depends on the driving itself; it cannot be an input here.")
        for _, count in training:
            whole("improve", "count", count)
        goal = None if safe is None else np.array([safe.Np, safe.Nc, math.log10(safe.R / safe.Q)])
        columns = [SchedulingVariables._fields.index(each) for each in inputs]
        return cls(inputs, columns, start.domain, method, goal, start.name)

    @property
    def check(self) -> int:
        return self.method.improvement.check

    def schedule(self, surfaces: Surfaces) -> Schedule:
        """What runs."""
        return self._learned([surfaces[slot].function() for slot in OUTPUTS])

    def _learned(self, functions: Sequence[Function]) -> Schedule:
        bounds = self.method.improvement.bounds
        return Learned(dict(zip(OUTPUTS, functions, strict=True)), self.inputs, self.domain, bounds, name=self.name)

    def _inputs(self, variables: Array) -> Array:
        return np.clip(variables[:, self.columns], *self.domain.T)

    def _outputs(self, surfaces: Surfaces, variables: Array) -> Array:
        return np.stack([surfaces[slot].predict(self._inputs(variables)) for slot in OUTPUTS], axis=1)

    def judged(
        self, surfaces: Surfaces, held_out: Sequence[RunSet], seed: int, k: int
    ) -> tuple[Schedule, Surfaces, dict[str, float]]:
        """The schedule, its surfaces, and the entry of the history: how it does on the runs held out."""
        schedule, noise = self.schedule(surfaces), held_out_noise(self.method, seed)
        costs = [runs.costs(schedule, [noise]) for runs in held_out]
        score = float(np.mean([np.log(each).mean() for each in costs]))
        failed = sum((each >= runs.failed_cost).sum() for each, runs in zip(costs, held_out, strict=True))
        return schedule, surfaces, {"round": k, "score": score, "failed": float(failed)}

    def wishes(self, surfaces: Surfaces, training: Training, chosen: Sequence[Indices], noise: int) -> Wishes:
        """What the landscapes of the chosen runs ask for."""

        def around(by: Array) -> Schedule:
            functions = [surfaces[slot].function() for slot in OUTPUTS]
            return self._learned([each.shifted(float(shift)) for each, shift in zip(functions, by, strict=True)])

        rescue = self._rescue(surfaces)
        found = [
            landscape(runs, around, noise, which, self.method.landscape, rescue)
            for (runs, _), which in zip(training, chosen, strict=True)
        ]
        return Wishes(*(np.concatenate(parts) for parts in zip(*found, strict=True)))

    def _rescue(self, surfaces: Surfaces) -> Rescue | None:
        if self.goal is None:
            return None
        goal = self.goal

        def schedule(share: float) -> Schedule:
            functions = [surfaces[slot].function() for slot in OUTPUTS]
            return self._learned(
                [each.blended(share, float(value)) for each, value in zip(functions, goal, strict=True)]
            )

        return Rescue(schedule, lambda variables: goal - self._outputs(surfaces, variables))

    def step(self, surfaces: Surfaces, wishes: Wishes, left: float) -> Surfaces:
        """The surfaces after a damped step of the weighted regression; left: share of the rounds still to come."""
        law = self.method.improvement
        damping = law.damping * (law.damping_end + (1.0 - law.damping_end) * left)
        effort = law.effort_end + (1.0 - law.effort_end) * math.sqrt(left)
        targets = np.clip(self._outputs(surfaces, wishes.variables) + damping * wishes.moves, *law.limits.T)
        x = self._inputs(wishes.variables)
        with ThreadPoolExecutor() as pool:
            fits = [
                pool.submit(surfaces[slot].fit, x, target, weight, effort)
                for slot, target, weight in zip(OUTPUTS, targets.T, wishes.weights.T, strict=True)
            ]
            return {slot: fit.result() for slot, fit in zip(OUTPUTS, fits, strict=True)}


def _chosen(rng: np.random.Generator, runs: int, count: int, failed: set[int], revisited: int) -> Indices:
    """Runs of a round: some that failed before, and others at random."""
    count = min(count, runs)
    known = rng.permutation(sorted(failed))[: count // revisited].astype(np.int64)
    others = np.setdiff1d(np.arange(runs), known)
    return np.sort(np.concatenate([known, rng.choice(others, count - len(known), replace=False)]))
