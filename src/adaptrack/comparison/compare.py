"""A comparison: the costs of contenders on the same runs, their regret to a reference, and who fails how often.

Regret is the cost over that of the reference on the same run. The reference of operating points is their optimum, which
a search finds with noise of its own; all costs, the optimum's too, are then measured with fresh noise.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.shown import figure_of, html_of
from adaptrack.comparison.contenders import Contender
from adaptrack.comparison.statistics import Ratio, geometric_mean, ratio, regret_percentiles, resamples
from adaptrack.control.controllers import Controller
from adaptrack.control.scheduling import Schedule
from adaptrack.drive.failure import Failure
from adaptrack.learning.adaptation.config import Evaluation
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.pso import SearchSpace, SwarmSettings
from adaptrack.tuning.runs import RunSet

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Role:
    """What a contender is, for tables and sentences."""

    controller: str = "mpc"
    adapts: bool = True
    hindsight: bool = False
    kind: str = ""
    """see `Contender.kind`"""


@dataclass(frozen=True, eq=False)
class Comparison:
    """Costs of every contender on the same runs."""

    costs: Mapping[str, Array]
    """by contender, (runs,) m^2, mean J over the noise seeds, a failed run counting as `RunSet.failed_cost`"""
    failures: Mapping[str, Array]
    """by contender, (runs,) share of the noise seeds with which the run failed"""
    counts: Mapping[str, Mapping[str, float]]
    """by contender, shares of the steps in which a schedule's inputs were clipped, its guard stepped in, ..."""
    reference: str
    """the contender that regret is measured against"""
    where: Array
    """(runs, k) what tells the runs apart: the operating points, or the numbers of the drives"""
    roles: Mapping[str, Role] = field(default_factory=dict)
    """by contender"""
    failure: Failure = field(default_factory=Failure)
    """when a run has failed"""

    def regret(self, name: str) -> Array:
        """(runs,) cost over the reference's."""
        return self.costs[name] / self.costs[self.reference]

    def ratio(self, name: str, other: str, seed: int = 0) -> Ratio:
        """The geometric mean of a contender's cost over another's, and its 95 % interval; `rows` hold the same."""
        known: dict[tuple[str, str, int], Ratio] = self.__dict__.setdefault("_ratios", {})
        if (name, other, seed) not in known:
            known[name, other, seed] = ratio(self.costs[name], self.costs[other], self._generator(name, seed))
        return known[name, other, seed]

    def mean_ratio(self, name: str, other: str) -> float:
        """The same without the interval."""
        return geometric_mean(self.costs[name] / self.costs[other])

    def role(self, name: str) -> Role:
        """What a contender is."""
        return self.roles.get(name, Role())

    def of_kind(self, *kinds: str) -> list[str]:
        """The contenders of some kinds, in the order of the kinds."""
        return [name for kind in kinds for name in self.costs if self.role(name).kind == kind]

    @property
    def adaptive(self) -> list[str]:
        """The contenders whose tuning changes, and not by hindsight."""
        return [name for name in self.costs if self.role(name).adapts and not self.role(name).hindsight]

    def rows(self, seed: int = 0) -> list[dict[str, Any]]:
        """One row for each contender: cost, regret and its spread, a 95 % bootstrap interval of its mean, failures.

        constant_...: likewise over the best constant, or, where that is the reference or missing, the controller's own.
        """
        made = []
        for name, costs in self.costs.items():
            over = self.ratio(name, self.reference, seed)
            made.append(
                {
                    "contender": name,
                    "kind": self.role(name).kind,
                    "controller": self.role(name).controller,
                    "runs": len(costs),
                    "cost_geomean": geometric_mean(costs),
                    "regret_geomean": over.mean,
                    "regret_low": over.low,
                    "regret_high": over.high,
                    **self._over_constant(name, seed),
                    **{f"regret_{key}": value for key, value in regret_percentiles(self.regret(name)).items()},
                    "failures": int((self.failures[name] > 0.0).sum()),
                    **self.counts.get(name, {}),
                }
            )
        return made

    def __repr__(self) -> str:
        return f"<Comparison of {len(self.costs)} contenders on {len(self.costs[self.reference])} runs>"

    def plot(self) -> Any:
        """Each contender's cost over the reference's with its 95 % interval, as a matplotlib figure."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """The comparison in a notebook."""
        return html_of(self)

    def _over_constant(self, name: str, seed: int) -> dict[str, float]:
        """The cost over that of the first constant that is not the reference."""
        constants = [each for each in self.of_kind("best constant", "default constant") if each != self.reference]
        if not constants:
            return {}
        over = self.ratio(name, constants[0], seed)
        return {"constant_geomean": over.mean, "constant_low": over.low, "constant_high": over.high}

    def _generator(self, name: str, seed: int) -> np.random.Generator:
        """The random numbers of a contender's resamples, which follow those of the contenders before it."""
        states: dict[int, dict[str, Any]] = self.__dict__.setdefault("_states", {})
        if seed not in states:
            rng, runs = np.random.default_rng((seed, 0xB007)), len(self.costs[self.reference])
            states[seed] = {}
            for each in self.costs:
                states[seed][each] = rng.bit_generator.state
                resamples(rng, runs)
        rng = np.random.default_rng()
        rng.bit_generator.state = states[seed][name]
        return rng

    def as_json(self) -> dict[str, Any]:
        """Everything, as plain JSON."""
        return {
            "costs": {name: each.tolist() for name, each in self.costs.items()},
            "failures": {name: each.tolist() for name, each in self.failures.items()},
            "counts": {name: dict(each) for name, each in self.counts.items()},
            "reference": self.reference,
            "where": self.where.tolist(),
            "roles": {name: vars(each) for name, each in self.roles.items()},
            "failure": vars(self.failure),
        }

    @classmethod
    def from_json(cls, content: Mapping[str, Any]) -> Comparison:
        """What `as_json` gave, to the bit."""
        costs, failures = (
            {name: np.array(each, dtype=float) for name, each in content[key].items()} for key in ("costs", "failures")
        )
        roles = {name: Role(**each) for name, each in content["roles"].items()}
        where = np.array(content["where"], dtype=float)
        failure = Failure(**content["failure"])
        return cls(costs, failures, content["counts"], content["reference"], where, roles, failure)


def compare(
    runs: RunSet, contenders: Iterable[Contender], seeds: Sequence[int], reference: str, where: ArrayLike | None = None,
    progress: Progress | None = None,
) -> Comparison:  # fmt: skip
    """Drive every contender over the runs with each of the noise seeds.

    where: (runs, k) what tells the runs apart, by default their number.

    Raises
    ------
    InvalidInput
        When the reference is not among the contenders, or two have one name.
    """
    entered = list(contenders)
    names = [each.name for each in entered]
    if reference not in names:
        raise InvalidInput(f"reference: {reference!r} is not among the contenders {', '.join(names)}.")
    if len(set(names)) < len(names):
        raise InvalidInput(f"contenders: {', '.join(names)}: two have the same name.")
    costs, failures, counts = {}, {}, {}
    for k, each in enumerate(entered):
        if progress is not None:
            progress(each.name, k, len(entered))
        found = runs.drive(each.policy, seeds)
        failed = ~np.isfinite(found)
        costs[each.name] = np.where(failed, runs.failed_cost, found).mean(axis=1)
        failures[each.name] = failed.mean(axis=1)
        if isinstance(each.policy, Schedule):
            counts[each.name] = _shares(runs.counts(each.policy, int(seeds[0])))
    roles = {each.name: Role(_controller(each, runs), each.adapts, each.hindsight, each.kind) for each in entered}
    rows = np.arange(len(runs), dtype=float)[:, None] if where is None else np.asarray(where, dtype=float)
    return Comparison(costs, failures, counts, reference, rows, roles, runs.failure)


def _controller(contender: Contender, runs: RunSet) -> str:
    """What drives: a controller of the contender's own, or that of the runs."""
    return contender.controller if isinstance(contender.policy, Controller) else runs.controller


def _shares(counts: Mapping[str, NDArray[np.int64]]) -> dict[str, float]:
    total = {name: float(each.sum()) for name, each in counts.items()}
    return {name: each / total["steps"] for name, each in total.items() if name != "steps"}


# -- hindsight --------------------------------------------------------------------------------------------------------
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


def finite(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows ready for strict JSON."""
    return [{k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in row.items()} for row in rows]
