"""Contenders on the same runs with the same noise: what each costs, and who fails how often.

Regret is the cost over that of the reference on the same run. The reference of operating points is their optimum, which
a search finds with noise of its own; all costs, the optimum's too, are then measured with fresh noise.
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
from adaptrack.control.controllers import Controller, Tuning
from adaptrack.control.scheduling import Schedule
from adaptrack.drive.world import World
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import Retuned, RunSet


def compare(
    runs: RunSet, contenders: Iterable[Contender], seeds: Sequence[int], reference: str, where: ArrayLike | None = None,
    progress: ProgressCall | None = None, *, outline: Outline | None = None,
) -> Comparison:  # fmt: skip
    """Drive every contender over the runs with each of the noise seeds.

    where: (runs, k) what tells the runs apart, by default their number; outline: of the car: with it every run is
    measured in full (`measures.RUN`), not its cost alone, which keeps its trajectory and takes longer. An interval
    draws the runs; of one run that is measured in full its noise seeds: it is then about that run.

    Raises
    ------
    InvalidInput
        When the reference is not among the contenders, or two have one name; measured in full also when one does not
        fit, or gives a tuning for each run.
    """
    entered = list(contenders)
    check_names([contender.name for contender in entered], reference)
    if outline is not None:
        for contender in entered:
            check_fits(contender, runs)
    measured, overall = {}, {}
    for k, contender in enumerate(entered):
        if progress is not None:
            progress(contender.name, k, len(entered))
        if outline is None:
            measured[contender.name], overall[contender.name] = _costs(runs, contender, seeds)
        else:
            measured[contender.name] = as_cells(measure_runs(runs, contender.policy, seeds, outline))
    is_one_run = outline is not None and len(runs) == 1
    return Comparison.from_runs(
        measured, reference, roads=[str(drive.name) for drive in getattr(runs, "scenarios", [])] or None, seeds=seeds,
        where=where, overall=overall, failure=runs.failure, over=("seed",) if is_one_run else ("road",),
        roles={entry.name: ContenderRole(_controller(entry, runs), entry.adapts, entry.hindsight) for entry in entered},
    )  # fmt: skip


def check_fits(contender: Contender, runs: RunSet) -> None:
    """Refuse a contender that cannot drive in the profile of the runs, or gives a tuning for each of them.

    Raises
    ------
    InvalidInput
        With what is missing.
    """
    if not isinstance(contender.policy, Schedule | Tuning | Retuned | Controller):
        raise InvalidInput(f"contender {contender.name!r}: a tuning for each run: on roads give one controller.")
    try:
        World.of(runs.plant, runs.controller_of(contender.policy), load_profile(runs.profile), None, None, runs.failure)
    except InvalidInput as error:
        raise InvalidInput(f"contender {contender.name!r}: {error}") from None


def _costs(
    runs: RunSet, contender: Contender, seeds: Sequence[int]
) -> tuple[dict[str, NDArray[Any]], dict[str, float]]:
    """Cost and failure of each run and seed, and the shares of the steps that a schedule counts."""
    costs = runs.drive(contender.policy, seeds)
    failed = ~np.isfinite(costs)
    cells = {"cost": np.where(failed, runs.failed_cost, costs), "failed": failed.astype(float)}
    if not isinstance(contender.policy, Schedule):
        return cells, {}
    total = {name: float(count.sum()) for name, count in runs.counts(contender.policy, int(seeds[0])).items()}
    return cells, {name: count / total["steps"] for name, count in total.items() if name != "steps"}


def _controller(contender: Contender, runs: RunSet) -> str:
    """Name of the driving controller: of the contender or, without one, of the runs."""
    return contender.controller if isinstance(contender.policy, Controller) else runs.controller
