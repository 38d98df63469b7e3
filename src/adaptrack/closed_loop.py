"""Schedulers that learn from driving: improved where they stand, on the closed loop itself.

`learning.landscape` says how a scheduler's outputs should move, given what each stretch of driving costs with the
outputs as they are and shifted a little. Here are the runs that tell these costs (`Course`), and the loop around both
(`improve`). Sensor noise is drawn anew in every round, and some runs are held out to choose the round that is kept.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.controllers import MPC, Tuning
from adaptrack.errors import InvalidInput, whole
from adaptrack.estimation import FrictionWindEstimator, Perception
from adaptrack.learning.landscape import OUTPUTS, SHIFT, Surface, check_inputs, preferred_moves
from adaptrack.plant import Plant
from adaptrack.profile import load_profile
from adaptrack.scenario import Scenario
from adaptrack.scheduling import Learned, Schedule, SchedulingVariables
from adaptrack.simulate import Batch

Array = NDArray[np.float64]

LOST_BEYOND = 5.0
"""m, a run is lost when |Y - y_ref| exceeds this."""
SPIN_BEYOND = 1.0
"""or |v_y/v_x| this: 45 degrees of sideslip."""
LOST_COST = LOST_BEYOND**2
"""m^2, what a lost run counts as costing."""
WORST_STRETCH = 5.0
"""A stretch is not counted as worth more than this many times its whole run."""
REVISITED = 16
"""One in so many runs of a round is one that was lost before, as far as there are such."""
AVERAGED = 8
"""Over how many of the latest rounds the parameters of what is kept are averaged."""
RESCUES = (0.25, 0.5, 1.0)
"""How far towards a safe tuning a lost run is driven again."""
BEFORE_LOSS = 2
"""In how many stretches before the one in which a run was lost the cause may lie."""
BOUNDS = {"Np": (10.0, 60.0), "Nc": (1.0, 20.0), "R": (10.0, 1e6)}
"""What learned tunings of the road profile are held within; Q is 1."""
_LOWEST, _HIGHEST = np.array([10.0, 1.0, 1.0]), np.array([60.0, 20.0, 6.0])

Policy = Schedule | Tuning | ArrayLike
"""What drives: a schedule, one tuning, or one tuning (Np, Nc, Q, R) for each run."""


@dataclass(frozen=True)
class Rescue:
    """The way from a schedule to a tuning that is safe everywhere."""

    schedule: Callable[[float], Schedule]
    """the schedule a share of the way, 0..1"""
    way: Callable[[Array], Array]
    """(m, 3) the whole way of each output at conditions (m, SchedulingVariables)"""


class Course:
    """Runs of equal length to learn from or to be judged by; costs are J = mean e^2 + price mean (change of command)^2.

    stretch, lead, stride: in how long stretches (control periods) cost is attributed, how long before a stretch the
    causes may lie, and how often in it the inputs are looked at; told: see `Batch`.
    """

    told: Perception | FrictionWindEstimator | None = None

    def __init__(
        self, plant: Plant, mpc: MPC, scenarios: Sequence[Scenario], profile: str = "road", *,
        stretch: int | None = None, lead: int = 0, stride: int = 20,
        told: Perception | FrictionWindEstimator | None = None,
    ) -> None:  # fmt: skip
        self.told = told
        self.batch = Batch(plant, mpc, scenarios, profile, None, LOST_BEYOND, told, SPIN_BEYOND)
        self.price = load_profile(profile).move_weight
        self.periods = self.batch.signals[0].n
        self.stretch, self.lead, self.stride = stretch or self.periods, lead, stride
        from adaptrack.kernels import loop

        rows = self.batch.samples[:, :, :-1]
        columns = [rows[:, loop.SPEED], rows[:, loop.Y_REF], *(rows[:, loop.TOLD + i] for i in range(4))]
        self.seen = np.stack([*columns, np.zeros_like(columns[0])], axis=-1)
        """(runs, periods, SchedulingVariables); the offset, which depends on the driving, is left zero."""

    def __len__(self) -> int:
        return len(self.batch.signals)

    def drive(self, policy: Policy, seeds: Sequence[int], which: NDArray[np.int64] | None = None) -> Array:
        """(runs, seeds) cost of each run of `which` with each noise seed; inf where it was lost.

        Of a policy (runs, 4), row i drives the run which[i].
        """
        return np.stack([self._run(policy, int(seed), which, False)[0] for seed in seeds], axis=1)

    def counts(self, policy: Schedule, seed: int) -> Array:
        """(runs, COUNTS) what the schedule counted, see `kernels.guard.COUNTS`."""
        return self._run(policy, seed, None, False)[2]

    def costs(self, policy: Policy, seeds: Sequence[int], which: NDArray[np.int64] | None = None) -> Array:
        """(runs,) mean cost over the noise seeds; a lost run counts as `LOST_COST`."""
        return np.where(np.isfinite(found := self.drive(policy, seeds, which)), found, LOST_COST).mean(axis=1)

    def stretches(self, policy: Policy, seed: int, which: NDArray[np.int64]) -> Array:
        """(runs, stretches) cost of each stretch (sum, m^2); inf in the one where a run was lost, NaN after it."""
        return self._run(policy, seed, which, True)[1]

    def _run(
        self, policy: Policy, seed: int, which: NDArray[np.int64] | None, divided: bool
    ) -> tuple[Array, Array, Array]:
        from adaptrack.kernels import loop

        which = np.arange(len(self)) if which is None else which
        tuning = self.batch.mpc.tuning.as_array()
        self.batch.scheduler = None
        if isinstance(policy, Schedule):
            self.batch.scheduler = policy
        else:
            tuning = policy.as_array() if isinstance(policy, Tuning) else np.asarray(policy, dtype=float)
        result, _, counts, stretches = self.batch.run(
            which, np.broadcast_to(tuning, (len(which), 4)).copy(), np.full(len(which), seed, np.int64),
            os.cpu_count() or 1, stretch=self.stretch if divided else 0, price=self.price,
        )  # fmt: skip
        cost = (result[:, loop.SQUARED_ERROR] + self.price * result[:, loop.SQUARED_MOVE]) / self.periods
        return np.where(result[:, loop.RUN_LOST] > 0.5, np.inf, cost), stretches, counts

    def landscape(
        self, make: Callable[[Array], Schedule], seed: int, which: NDArray[np.int64], rescue: Rescue | None = None
    ) -> tuple[Array, Array, Array]:
        """What the landscape around a schedule says: inputs (m, SchedulingVariables), moves (m, 3) and weights (m, 3).

        make: the schedule with its outputs shifted by (3,); rescue: what lost runs are driven with again.

        Raises
        ------
        InvalidInput
            When an estimator tells friction and wind: what it tells is not known before driving.
        """
        if isinstance(self.told, FrictionWindEstimator):
            raise InvalidInput("a course told by an estimator cannot be learned from: learn from the truth.")
        base = self.stretches(make(np.zeros(3)), seed, which)
        total = np.nansum(np.where(np.isfinite(base), base, 0.0), axis=1)
        lost = np.isinf(base).any(axis=1)
        usual = np.median(total[~lost]) if not lost.all() else LOST_COST * self.periods
        total = np.where(lost, usual, total)[:, None]

        def relative(cost: Array) -> Array:
            return np.minimum(cost / total, WORST_STRETCH)

        trials = []
        for sign in (1.0, -1.0):
            shifts = sign * np.diag(SHIFT)
            trials.append(np.stack([relative(self.stretches(make(by), seed, which)) for by in shifts], axis=-1))
        here = relative(base)
        share = np.clip(np.nan_to_num(here), 0.0, 1.0) + 1e-3
        moves, weights = preferred_moves(
            here.ravel(), trials[0].reshape(-1, 3), trials[1].reshape(-1, 3), share.ravel()
        )
        shape = (*base.shape, 3)
        moves, weights = moves.reshape(shape), weights.reshape(shape)
        shares = np.zeros(base.shape) if rescue is None else self._saved(base, rescue, seed, which)
        rows, to, how_much = [], [], []
        for i in range(base.shape[1]):
            first = max(0, i * self.stretch - self.lead)
            seen = self.seen[which, first : (i + 1) * self.stretch : self.stride]
            count = seen.shape[1]
            rows.append(seen.reshape(-1, seen.shape[2]))
            to.append(np.repeat(moves[:, i], count, axis=0))
            how_much.append(np.repeat(weights[:, i], count, axis=0) / count)
            part = np.repeat(shares[:, i], count)
            if rescue is not None and (saved := part > 0.0).any():
                way = part[saved, None] * rescue.way(rows[-1][saved])
                to[-1][saved] = way
                how_much[-1][saved] = 2.0 * WORST_STRETCH / np.maximum(np.abs(way), SHIFT) ** 2 / count
        return np.concatenate(rows), np.concatenate(to), np.concatenate(how_much) / len(which)

    def _saved(self, base: Array, rescue: Rescue, seed: int, which: NDArray[np.int64]) -> Array:
        """(runs, stretches) the least share of `RESCUES` that saves a lost run, in the stretches up to its loss."""
        shares = np.zeros(base.shape)
        lost = np.flatnonzero(np.isinf(base).any(axis=1))
        for share in RESCUES:
            if not lost.size:
                break
            saved = np.isfinite(self.stretches(rescue.schedule(share), seed, which[lost])).all(axis=1)
            for i in lost[saved]:
                last = int(np.argmax(np.isinf(base[i])))
                shares[i, max(0, last - BEFORE_LOSS) : last + 1] = share
            lost = lost[~saved]
        return shares


@dataclass(frozen=True, eq=False)
class Improvement:
    """A schedule that learned, and how."""

    schedule: Schedule
    surfaces: Mapping[str, Surface]
    history: list[dict[str, float]] = field(default_factory=list)
    """after each check: round, score (mean log cost of the held-out runs), lost (of them)"""


def geometric_mean(costs: ArrayLike) -> float:
    """exp of the mean logarithm."""
    return float(np.exp(np.mean(np.log(costs))))


def improve(
    surfaces: Mapping[str, Surface],
    inputs: Sequence[str],
    domain: Array,
    courses: Sequence[tuple[Course, int]],
    held_out: Sequence[Course],
    *,
    rounds: int = 60,
    seed: int = 0,
    check: int = 5,
    safe: Tuning | None = None,
    name: str = "learned",
    progress: Callable[[int, int], None] | None = None,
) -> Improvement:
    """Move a scheduler's three outputs towards what the landscape of its own closed loop prefers, `rounds` times.

    surfaces: for Np, Nc and log10_ratio (R/Q, Q = 1); inputs, domain: see `Schedule`; courses: each with the number of
    its runs that a round drives, drawn anew; held_out: after every `check` rounds the schedule, its parameters averaged
    over the latest rounds, is scored on them by the mean log cost, each course alike, and the best one is returned;
    safe: a tuning towards which lost runs are driven again, so that what saves them is learned, too.

    Raises
    ------
    InvalidInput
        When a surface is missing, or an input cannot be known before driving.
    """
    if set(surfaces) != set(OUTPUTS):
        raise InvalidInput(f"improve: need a surface for each of {', '.join(OUTPUTS)}.")
    if "offset" in inputs:
        raise InvalidInput("improve: the offset depends on the driving itself; it cannot be an input here.")
    columns = check_inputs(inputs, SchedulingVariables._fields)
    for _, count in courses:
        whole("improve", "count", count)
    rng = np.random.default_rng((seed, 0xADA))
    now = dict(surfaces)  # `made` and `outputs` look at the present ones
    lost: list[set[int]] = [set() for _ in courses]

    def chosen(course: Course, count: int, once_lost: set[int]) -> NDArray[np.int64]:
        """Runs of a round: some that were lost before, and others at random."""
        count = min(count, len(course))
        known = rng.permutation(sorted(once_lost))[: count // REVISITED].astype(np.int64)
        others = np.setdiff1d(np.arange(len(course)), known)
        return np.sort(np.concatenate([known, rng.choice(others, count - len(known), replace=False)]))

    def learned(functions: Sequence[Any]) -> Schedule:
        return Learned(dict(zip(OUTPUTS, functions, strict=True)), inputs, domain, BOUNDS, name=name)

    def made(by: Array) -> Schedule:
        return learned([now[slot].function().shifted(float(shift)) for slot, shift in zip(OUTPUTS, by, strict=True)])

    def outputs(rows: Array) -> Array:
        return np.stack([now[slot].predict(np.clip(rows[:, columns], *domain.T)) for slot in OUTPUTS], axis=1)

    rescue = None
    if safe is not None:
        goal = [safe.Np, safe.Nc, math.log10(safe.R / safe.Q)]
        rescue = Rescue(
            lambda share: learned(
                [now[slot].function().blended(share, value) for slot, value in zip(OUTPUTS, goal, strict=True)]
            ),
            lambda rows: goal - outputs(rows),
        )

    history: list[dict[str, float]] = []

    def scored(k: int, surfaces: Mapping[str, Surface]) -> tuple[float, Improvement]:
        schedule = learned([surfaces[slot].function() for slot in OUTPUTS])
        scores = [course.costs(schedule, [seed * 100_000 + 900]) for course in held_out]
        score = float(np.mean([np.log(each).mean() for each in scores]))
        history.append({"round": k, "score": score, "lost": float(sum((s >= LOST_COST).sum() for s in scores))})
        return score, Improvement(schedule, surfaces)

    latest: list[dict[str, Surface]] = []
    best_score, best = scored(0, now)
    for k in range(rounds):
        if progress is not None:
            progress(k, rounds)
        left = 1.0 - k / rounds
        noise = seed * 100_000 + 1000 + k
        if k % check == 0:
            for (course, _), once_lost in zip(courses, lost, strict=True):
                once_lost |= set(np.flatnonzero(~np.isfinite(course.drive(made(np.zeros(3)), [noise])[:, 0])).tolist())
        told = [
            course.landscape(made, noise, chosen(course, count, once_lost), rescue)
            for (course, count), once_lost in zip(courses, lost, strict=True)
        ]
        rows, moves, weights = (np.concatenate(parts) for parts in zip(*told, strict=True))
        damping = 0.7 * (0.3 + 0.7 * left)
        targets = np.clip(outputs(rows) + damping * moves, _LOWEST, _HIGHEST)
        x = np.clip(rows[:, columns], *domain.T)
        effort = 0.2 + 0.8 * math.sqrt(left)
        with ThreadPoolExecutor() as pool:
            fits = [
                pool.submit(now[slot].fit, x, target, weight, effort)
                for slot, target, weight in zip(OUTPUTS, targets.T, weights.T, strict=True)
            ]
            now = {slot: fit.result() for slot, fit in zip(OUTPUTS, fits, strict=True)}
        latest = [*latest[1 - AVERAGED :], now]
        if (k + 1) % check == 0 or k == rounds - 1:
            mean = {slot: now[slot].average([each[slot] for each in latest[:-1]]) for slot in OUTPUTS}
            score, found = scored(k + 1, mean)
            if score < best_score:
                best_score, best = score, found
    return Improvement(best.schedule, best.surfaces, history)
