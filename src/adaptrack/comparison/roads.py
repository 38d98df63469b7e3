"""Contenders on the same roads, with the same noise: what they cost, how far off they were, who failed where."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.shown import figure_of, html_of
from adaptrack.cars.outline import Outline
from adaptrack.comparison.compare import Comparison, Role
from adaptrack.comparison.contenders import Contender
from adaptrack.control.controllers import Controller, Tuning
from adaptrack.control.scheduling import Schedule
from adaptrack.drive.metrics import Metrics, compute_metrics
from adaptrack.drive.path_metrics import PathRecord, path_metrics
from adaptrack.drive.trajectory import Trajectory
from adaptrack.drive.world import World
from adaptrack.tuning.runs import Retuned, RunSet

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]


class FailedRun(NamedTuple):
    """A run that failed."""

    road: str
    seed: int
    """of the noise"""
    reason: str
    """a `failure.Reason`"""
    at: float
    """s"""
    because: str
    """to complete "the vehicle ..." """


@dataclass(frozen=True)
class Tracking:
    """What a contender cost on all roads, and how well it followed them until the end of a run or its failure."""

    cost_mean: float
    """m^2, mean J over roads and noise seeds: what `tune_constant` minimises; a failed run counts as 25 m^2"""
    rms_error: float
    """m, of the centre of mass"""
    p95_error: float
    """m, 95th percentile of |e|"""
    max_abs_error: float
    """m"""
    max_corner_error: float
    """m, largest distance of the outermost corner less half the width, see `path_metrics`"""
    failed: tuple[FailedRun, ...]


@dataclass(frozen=True, eq=False)
class RoadComparison:
    """Contenders on the same roads."""

    comparison: Comparison
    """a row of `where` is a road, costs being means over the noise seeds; with one road, a noise seed"""
    tracking: dict[str, Tracking]
    """by contender"""
    roads: tuple[str, ...]
    seeds: tuple[int, ...]

    @property
    def runs(self) -> int:
        """How many each contender drove."""
        return len(self.roads) * len(self.seeds)

    def rows(self) -> list[dict[str, Any]]:
        """One row for each contender: the cost and its ratio to the reference (95 % interval), errors, failures."""
        kept = ("contender", "controller", "cost_geomean", "regret_geomean", "regret_low", "regret_high")
        rows = []
        for row in self.comparison.rows():
            errors = vars(self.tracking[row["contender"]]) | {"runs": self.runs}
            failed = [each._asdict() for each in errors.pop("failed")]
            rows.append({name: row[name] for name in kept} | errors | {"failures": len(failed), "failed": failed})
        return rows

    def __repr__(self) -> str:
        return f"<RoadComparison of {len(self.tracking)} contenders on {len(self.roads)} roads, {self.runs} runs each>"

    def plot(self) -> Any:
        """Each contender's cost over the reference's with its 95 % interval, as a matplotlib figure."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """The comparison in a notebook."""
        return html_of(self)


def check_fits(contender: Contender, runs: RunSet) -> None:
    """Refuse a contender that cannot drive in the profile of the runs.

    Raises
    ------
    InvalidInput
        With what is missing.
    """
    try:
        World.of(runs.plant, runs.controller_of(_alone(contender)), runs.profile, None, None, runs.failure)
    except InvalidInput as error:
        raise InvalidInput(f"contender {contender.name!r}: {error}") from None


def on_roads(
    runs: RunSet, contenders: Sequence[Contender], seeds: Sequence[int], outline: Outline, reference: str,
    progress: Progress | None = None,
) -> RoadComparison:  # fmt: skip
    """Drive every contender along every road of a run set with every noise seed.

    outline: the car's; reference: the contender whose cost the others' are divided by. The bootstrap draws roads, or,
    where there is one road only, noise seeds: its interval is then about that road.

    Raises
    ------
    InvalidInput
        When a contender does not fit, gives a tuning for each run, or the reference is not among them.
    """
    names = [each.name for each in contenders]
    if reference not in names or len(set(names)) < len(names):
        raise InvalidInput(
            f"contenders {', '.join(names)}: need different names, the reference {reference!r} among them."
        )
    for each in contenders:
        check_fits(each, runs)
    costs, failures, tracking = {}, {}, {}
    for k, each in enumerate(contenders):
        if progress is not None:
            progress(each.name, k, len(contenders))
        found = runs.trajectories(_alone(each), seeds)
        measured = [[compute_metrics(run, failure=runs.failure) for run in road] for road in found]
        cost = np.array([[runs.failed_cost if m.failed else m.cost for m in road] for road in measured])
        failed = np.array([[m.failed for m in road] for road in measured], dtype=float)
        if len(runs) == 1:
            costs[each.name], failures[each.name] = cost[0], failed[0]
        else:
            costs[each.name], failures[each.name] = cost.mean(axis=1), failed.mean(axis=1)
        tracking[each.name] = _tracking(found, measured, cost, outline, runs, seeds)
    roles = {
        each.name: Role(each.controller if isinstance(each.policy, Controller) else runs.controller, each.adapts)
        for each in contenders
    }
    where = np.array(seeds, dtype=float) if len(runs) == 1 else np.arange(len(runs), dtype=float)
    comparison = Comparison(costs, failures, {}, reference, where[:, None], roles, runs.failure)
    roads = tuple(str(each.name) for each in runs.scenarios)
    return RoadComparison(comparison, tracking, roads, tuple(int(seed) for seed in seeds))


def _alone(contender: Contender) -> Any:
    """A policy that is the same for all runs."""
    policy = contender.policy
    if isinstance(policy, Schedule | Tuning | Retuned | Controller):
        return policy
    raise InvalidInput(f"contender {contender.name!r}: a tuning for each run: on roads give one controller.")


def _tracking(
    found: Sequence[Sequence[Trajectory]], measured: Sequence[Sequence[Metrics]], cost: Array, outline: Outline,
    runs: RunSet, seeds: Sequence[int],
) -> Tracking:  # fmt: skip
    errors, corners, failed = [], [], []
    for scenario, road, measures in zip(runs.scenarios, found, measured, strict=True):
        for seed, run, measure in zip(seeds, road, measures, strict=True):
            if measure.failed:
                reason, clause = measure.failed_reason, measure.failed_because
                failed.append(FailedRun(str(scenario.name), int(seed), reason, measure.failed_at, clause))
            record = PathRecord.from_trajectory(run)
            if record is not None:
                errors.append(np.abs(record.offset))
                corners.append(path_metrics(record, outline).max_corner_error)
    e = np.concatenate(errors) if errors else np.array([np.inf])
    return Tracking(
        cost_mean=float(np.mean(cost)),
        rms_error=float(np.sqrt(np.mean(e**2))),
        p95_error=float(np.percentile(e, 95.0)),
        max_abs_error=float(e.max()),
        max_corner_error=max(corners, default=np.inf),
        failed=tuple(failed),
    )
