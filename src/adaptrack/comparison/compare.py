"""Comparison of the costs and failures of contenders on the same runs with the same sensor noise.

The regret of a run is its cost divided by the cost of the reference contender on the same run. At operating points the
reference is the optimum that a search found for each of them. All costs, including those of the optimum, are measured
with noise seeds that the search did not use.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.outline import Outline
from adaptrack.comparison.table import Comparison, ContenderRole, check_names
from adaptrack.control.controllers.base import Policy
from adaptrack.drive.metrics import PathRecord, compute_metrics, path_metrics
from adaptrack.drive.speed_measures import speed_measures
from adaptrack.drive.trajectory import Trajectory
from adaptrack.drive.world import World
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import PolicyArgument, RunSet, policy_of


# -- contenders -------------------------------------------------------------------------------------------------------
@checked
@dataclass(frozen=True, eq=False)
class Contender:
    """A policy with the name under which it is compared.

    Raises
    ------
    InvalidInput
        For an empty name or an invalid policy.
    """

    name: Annotated[str, Field(min_length=1)]
    policy: PolicyArgument
    """Schedule, tuning, tunings (runs, 4), or controller with `step`, `reset`, `period` and `name`."""
    hindsight: bool = False
    """Whether the policy was optimised for the very runs of the comparison."""

    def __post_init__(self) -> None:
        self.as_policy()

    def as_policy(self) -> Policy:
        """Return the record of the policy."""
        return policy_of(self.policy, f"contender {self.name!r}")

    @property
    def controller(self) -> str:
        """The name of the controller; "mpc" if the policy is a schedule or tuning for the MPC of the runs."""
        controller = self.as_policy().controller
        return "mpc" if controller is None else str(controller.name)

    @property
    def adapts(self) -> bool:
        """Whether the tuning changes between or during runs, without `hindsight`."""
        return not self.hindsight and self.as_policy().adapts


def compare(
    runs: RunSet, contenders: Iterable[Contender], seeds: Sequence[int], reference: str, where: ArrayLike | None = None,
    progress: ProgressCall | None = None, *, outline: Outline | None = None,
) -> Comparison:  # fmt: skip
    """Drive every contender over the runs with each of the noise seeds.

    Parameters
    ----------
    runs
        Runs of the comparison.
    contenders
        Contenders with different names.
    seeds
        Seeds of the sensor noise.
    reference
        Name of the contender that ratios refer to.
    where
        Coordinates of the runs, such as operating points, (runs, k); None for their indices.
    progress
        Function called with (contender, contenders done, contenders in all).
    outline
        Outline of the car. With it all measures of `RUN` are computed, which takes longer; without it only
        costs and failures. Intervals resample the runs. With an outline and a single run they resample its noise seeds
        and apply to that run only.

    Raises
    ------
    InvalidInput
        For an unknown reference or equal names. With an outline also for a contender that cannot drive in the profile
        of the runs, or that has a tuning for each run.
    """
    contenders = list(contenders)
    check_names([contender.name for contender in contenders], reference)
    if outline is not None:
        for contender in contenders:
            check_fits(contender, runs)
    cells, overall, roles = {}, {}, {}
    for k, contender in enumerate(contenders):
        if progress is not None:
            progress(contender.name, k, len(contenders))
        if outline is None:
            cells[contender.name], overall[contender.name] = _costs(runs, contender, seeds)
        else:
            cells[contender.name] = as_cells(measure_runs(runs, contender.policy, seeds, outline))
        roles[contender.name] = ContenderRole(_controller(contender, runs), contender.adapts, contender.hindsight)
    is_one_run = outline is not None and len(runs) == 1
    return Comparison.from_runs(
        cells, reference, roads=[str(drive.name) for drive in getattr(runs, "scenarios", [])] or None, seeds=seeds,
        where=where, overall=overall, failure=runs.failure, over=("seed",) if is_one_run else ("road",), roles=roles,
    )  # fmt: skip


def check_fits(contender: Contender, runs: RunSet) -> None:
    """Raise `InvalidInput` if a contender cannot drive in the profile of the runs, or has a tuning for each run."""
    if np.ndim(contender.as_policy().tunings) == 2:
        raise InvalidInput(f"contender {contender.name!r}: has a tuning for each run; on roads give one controller.")
    try:
        World.of(runs.plant, runs.controller_of(contender.policy), load_profile(runs.profile), None, None, runs.failure)
    except InvalidInput as error:
        raise InvalidInput(f"contender {contender.name!r}: {error}") from None


def _costs(
    runs: RunSet, contender: Contender, seeds: Sequence[int]
) -> tuple[dict[str, NDArray[Any]], dict[str, float]]:
    """Return cost and failure of each run and seed, and the counters of a schedule as shares of all control steps."""
    costs = runs.drive(contender.policy, seeds)
    failed = ~np.isfinite(costs)
    cells = {"cost": np.where(failed, runs.failed_cost, costs), "failed": failed.astype(float)}
    scheduler = contender.as_policy().scheduler
    if scheduler is None:
        return cells, {}
    total = {name: float(count.sum()) for name, count in runs.counts(scheduler, int(seeds[0])).items()}
    return cells, {name: count / total["steps"] for name, count in total.items() if name != "steps"}


def _controller(contender: Contender, runs: RunSet) -> str:
    """Return the name of the contender's controller, or of the MPC of the runs that it tunes."""
    return runs.controller if contender.as_policy().controller is None else contender.controller


# -- measures of runs -------------------------------------------------------------------------------------------------
RUN = {
    "rms_error": ("rms_error", "m"), "p95_error": ("p95_error", "m"), "max_error": ("max_abs_error", "m"),
    "max_corner": ("max_corner_error", "m"), "steering_rate": ("steering_rate_rms", "rad/s"),
    "acceleration": ("lateral_acceleration_r79", "m/s^2"), "jerk": ("jerk_r79", "m/s^3"), "duration": ("duration", "s"),
}  # fmt: skip
"""Measures of a run up to its end or failure, with the name of each in `Metrics` and `path_metrics`, and its unit."""


def measure_runs(
    runs: RunSet, policy: PolicyArgument, seeds: Sequence[int], outline: Outline, *, with_driver: bool = False
) -> list[list[dict[str, Any]]]:
    """Drive every run with every noise seed, as `RunSet.trajectories` does, and return all measures.

    These are for each run and seed `cost` (m^2), `failed`, `reason`, `failed_at` (s) and the measures of `RUN`; None
    for a measure that does not exist. outline: of the car, whose corners are measured; with_driver: whether to add
    `speed_measures`, which need drives along roads.
    """
    return [
        [_run_measures(run, runs, outline, drive if with_driver else None) for run in road]
        for drive, road in zip(runs.scenarios, runs.trajectories(policy, seeds), strict=True)
    ]


def _run_measures(
    run: Trajectory, runs: RunSet, outline: Outline, drive: Scenario | RoadDrive | None
) -> dict[str, Any]:
    metrics, record = compute_metrics(run, failure=runs.failure), PathRecord.from_trajectory(run)
    path = None if record is None else path_metrics(record, outline).as_row()
    return {
        "cost": runs.failed_cost if metrics.failed else metrics.cost,
        "failed": metrics.failed,
        "reason": metrics.failed_reason or "",
        "failed_at": float(metrics.failed_at) if metrics.failed else None,
        **{name: None if path is None else path[key] for name, (key, _) in RUN.items()},
        **(speed_measures(run, drive.road, drive.plan) if isinstance(drive, RoadDrive) else {}),
    }


def as_cells(rows: Sequence[Sequence[dict[str, Any]]]) -> dict[str, NDArray[Any]]:
    """Return the result of `measure_runs` as an array (runs, seeds) for each measure, with NaN for None."""
    return {name: as_column([row[name] for road in rows for row in road]).reshape(len(rows), -1) for name in rows[0][0]}


def as_column(values: Sequence[Any]) -> NDArray[Any]:
    """Return values as an array of text, or of numbers with NaN for None."""
    if isinstance(values[0], str):
        return np.array(values)
    return np.array([np.nan if value is None else value for value in values], dtype=float)
