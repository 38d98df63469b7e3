"""What could have been had with hindsight: the best tuning of each operating point, the best constant of each drive."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.learning.adaptation.config import Evaluation
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.pso import SearchSpace, SwarmSettings
from adaptrack.tuning.runs import RunSet

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]


class SwarmSearch(NamedTuple):
    """A swarm's search for the best tuning."""

    space: SearchSpace
    swarm: SwarmSettings | None = None
    """by default the improved swarm's"""
    seed: int = 0
    """of its random numbers; further swarms count up from it"""


def optimum(
    objective: Callable[[Sequence[int]], Objective],
    points: Array,
    search: SwarmSearch,
    *,
    evaluation: Evaluation | None = None,
    known: Array | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Array:
    """(n, 4) the best tuning of each operating point (n, 4), by three times the budget of a campaign's search.

    Three swarms on three noise seeds each; of what they find, and of `known` tunings (k, 4), the best on eight further
    seeds (these are the numbers of `evaluation`). objective: makes the cost for given noise seeds.
    """
    law = evaluation or Evaluation()
    parts = [objective(seeds) for seeds in law.search_seeds]
    judge = objective(law.choice_seeds)
    others = np.empty((0, 4)) if known is None else np.asarray(known, dtype=float)

    def best(i: int) -> Array:
        found = [
            part.tune(points[i], search.swarm, seed=search.seed + s, stream=i, space=search.space).tuning
            for s, part in enumerate(parts)
        ]
        candidates = np.vstack([*found, others])
        return np.asarray(candidates[np.argmin(judge.costs(points[i], candidates))])

    rows = []
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        for i, row in enumerate(pool.map(best, range(len(points)))):
            rows.append(row)
            if progress is not None and i % 16 == 0:
                progress("optimum", i, len(points))
    return np.array(rows)


def per_run_best(runs: RunSet, candidates: Array, seeds: Sequence[int]) -> Array:
    """(runs, 4) of the candidate tunings (k, 4) the one that is best on each run: a constant chosen with hindsight."""
    costs = np.stack([runs.costs(row, seeds) for row in candidates], axis=1)
    return np.asarray(candidates[np.argmin(costs, axis=1)])
