"""Comparison of the costs and failures of contenders on the same runs with the same sensor noise.

The regret of a run is its cost divided by the cost of the reference contender on the same run. At operating points the
reference is the optimum that a search found for each of them. All costs, including those of the optimum, are measured
with noise seeds that the search did not use.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.outline import Outline
from adaptrack.comparison.contenders import Contender
from adaptrack.comparison.measures import as_cells, measure_runs
from adaptrack.comparison.table import Comparison, ContenderRole, check_names
from adaptrack.drive.world import World
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import RunSet


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
        Outline of the car. With it all measures of `measures.RUN` are computed, which takes longer; without it only
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
    """Refuse a contender that cannot drive in the profile of the runs, or that has a tuning for each run.

    Raises
    ------
    InvalidInput
        The message gives the reason.
    """
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
