"""The ladder of comparators on conditions and drives that nobody trained on: cost, regret and failures of every rung.

Regret is the cost over that of the per-condition optimum, which a search finds on noise seeds of its own; all costs,
the optimum's too, are then measured on fresh ones.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.closed_loop import LOST_COST, Course, Policy
from adaptrack.errors import InvalidInput
from adaptrack.scheduling import Schedule
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.pso import SearchSpace, SwarmSettings

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

EVALUATION_SEEDS = tuple(range(900_001, 900_009))
"""Noise seeds of every evaluation; no tuning or learning draws them."""
SEARCH_SEEDS = tuple(range(800_001, 800_010))
"""Those of the search for the per-condition optimum: three for each of three swarms."""
CHOICE_SEEDS = tuple(range(810_001, 810_009))
"""Those on which the optimum is chosen among what the swarms found."""
RESAMPLES = 2000


@dataclass(frozen=True, eq=False)
class Ladder:
    """Costs of every rung on the same runs; lost runs are inf."""

    costs: Mapping[str, Array]
    """by rung, (runs,) mean J over the noise seeds, a lost run counting as `LOST_COST`"""
    failures: Mapping[str, Array]
    """by rung, (runs,) share of the noise seeds with which the run was lost"""
    counts: Mapping[str, Mapping[str, float]]
    """by rung, shares of the steps in which a scheduler's inputs were clipped, the guard stepped in, ..."""
    reference: str
    """the rung that regret is measured against"""
    where: Array
    """(runs, k) what tells the runs apart: the conditions, or the numbers of the drives"""

    def regret(self, rung: str) -> Array:
        """(runs,) cost over the reference's."""
        return self.costs[rung] / self.costs[self.reference]

    def rows(self, seed: int = 0) -> list[dict[str, Any]]:
        """One row for each rung: cost, regret and its spread, a 95 % bootstrap interval of its mean, failures."""
        rng = np.random.default_rng((seed, 0xB007))
        made = []
        for rung, costs in self.costs.items():
            logs = np.log(self.regret(rung))
            draws = rng.integers(0, len(logs), size=(RESAMPLES, len(logs)))
            low, high = np.percentile(np.exp(logs[draws].mean(axis=1)), [2.5, 97.5])
            p50, p90, p99 = np.exp(np.percentile(logs, [50, 90, 99]))
            made.append(
                {
                    "scheduler": rung,
                    "runs": len(logs),
                    "cost_geomean": float(np.exp(np.log(costs).mean())),
                    "regret_geomean": float(np.exp(logs.mean())),
                    "regret_low": float(low),
                    "regret_high": float(high),
                    "regret_p50": float(p50),
                    "regret_p90": float(p90),
                    "regret_p99": float(p99),
                    "regret_worst": float(np.exp(logs.max())),
                    "failures": int((self.failures[rung] > 0.0).sum()),
                    **self.counts.get(rung, {}),
                }
            )
        return made


def climb(
    course: Course, rungs: Mapping[str, Policy], seeds: Sequence[int], reference: str, where: Array,
    progress: Progress | None = None,
) -> Ladder:  # fmt: skip
    """Drive every rung over a course with each of the noise seeds.

    Raises
    ------
    InvalidInput
        When the reference is not among the rungs.
    """
    if reference not in rungs:
        raise InvalidInput(f"reference: {reference!r} is not among the rungs {', '.join(rungs)}.")
    costs, failures, counts = {}, {}, {}
    for k, (rung, policy) in enumerate(rungs.items()):
        if progress is not None:
            progress(rung, k, len(rungs))
        found = course.drive(policy, seeds)
        lost = ~np.isfinite(found)
        costs[rung] = np.where(lost, LOST_COST, found).mean(axis=1)
        failures[rung] = lost.mean(axis=1)
        if isinstance(policy, Schedule):
            counts[rung] = _shares(course.counts(policy, int(seeds[0])))
    return Ladder(costs, failures, counts, reference, where)


def _shares(counts: Array) -> dict[str, float]:
    from adaptrack.kernels import guard

    total = counts.sum(axis=0)
    return {name: float(total[i] / total[0]) for i, name in enumerate(guard.COUNTS) if i > 0}


def optimum(
    objective: Callable[[Sequence[int]], Objective],
    conditions: Array,
    space: SearchSpace,
    *,
    swarm: SwarmSettings | None = None,
    known: Array | None = None,
    seed: int = 0,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Array:
    """(n, 4) the best tuning of each condition, by three times the budget of a campaign's search.

    Three swarms on three noise seeds each; of what they find, and of `known` tunings (k, 4), the best on eight further
    seeds. objective: makes the cost for given noise seeds.
    """
    thirds = [objective(SEARCH_SEEDS[i : i + 3]) for i in (0, 3, 6)]
    judge = objective(CHOICE_SEEDS)
    others = np.empty((0, 4)) if known is None else np.asarray(known, dtype=float)

    def best(i: int) -> Array:
        found = [
            third.tune(conditions[i], swarm, seed=seed + s, stream=i, space=space).tuning
            for s, third in enumerate(thirds)
        ]
        candidates = np.vstack([*found, others])
        return np.asarray(candidates[np.argmin(judge.costs(conditions[i], candidates))])

    rows = []
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        for i, row in enumerate(pool.map(best, range(len(conditions)))):
            rows.append(row)
            if progress is not None and i % 16 == 0:
                progress("optimum", i, len(conditions))
    return np.array(rows)


def best_constant(
    courses: Sequence[tuple[Course, int]], start: Sequence[float], *, evaluations: int = 300, seed: int = 0
) -> Array:
    """(4,) the tuning with the lowest mean log cost over runs of the courses: what one fixed tuning can do.

    The swarm of a campaign's condition (`SwarmSettings`, 300 evaluations), each evaluation driving all the runs; each
    course counts alike. start: a tuning that is tried too.
    """
    from adaptrack.tuning.pso import minimise

    space = SearchSpace(
        names=("Np", "Nc", "R"), low=(10.0, 1.0, 10.0), high=(60.0, 18.0, 1e6), whole=("Np", "Nc"), decades=("R",),
        ordered=("Nc", "Np"), spread=2.0,
    )  # fmt: skip
    rng = np.random.default_rng((seed, 0xC057))
    picked = [
        (course, np.sort(rng.choice(len(course), min(count, len(course)), replace=False))) for course, count in courses
    ]

    def cost(positions: Array) -> Array:
        return np.array([_score(picked, [p[0], p[1], 1.0, p[2]], seed) for p in np.atleast_2d(positions)])

    found = minimise(cost, space, SwarmSettings(generations=max(1, evaluations // 20)), seed=seed)
    tuning = np.array([found.x[0], found.x[1], 1.0, found.x[2]])
    given = np.asarray(start, dtype=float)
    return given if _score(picked, given, seed) < float(found.cost) else tuning


def _score(picked: Sequence[tuple[Course, NDArray[np.int64]]], tuning: Any, seed: int) -> float:
    logs = []
    for course, which in picked:
        logs.append(np.log(course.costs(tuning, [700_000 + seed % 100_000], which)).mean())
    return float(np.mean(logs))


def per_run_best(course: Course, candidates: Array, seeds: Sequence[int]) -> Array:
    """(runs, 4) of the candidate tunings (k, 4) the one that is best on each run: a constant chosen with hindsight."""
    costs = np.stack([course.costs(row, seeds) for row in candidates], axis=1)
    return np.asarray(candidates[np.argmin(costs, axis=1)])


def finite(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows ready for strict JSON."""
    return [{k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()} for row in rows]
