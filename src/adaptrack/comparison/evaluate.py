"""Contenders on operating points, drives and tests that nobody trained on."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.comparison.compare import compare
from adaptrack.comparison.contenders import Contender, contenders_of, get_contender
from adaptrack.comparison.hindsight import SwarmSearch, optimum, per_run_best
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import Schedule
from adaptrack.drive.metrics import PUBLISHED
from adaptrack.drive.world import KnownAs
from adaptrack.learning.adaptation.recipes import ANYWHERE
from adaptrack.learning.adaptation.splits import SetUp, evaluation_drives, evaluation_points
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.runs import (
    RunSet,
    operating_point_runs,
    paper_test_runs,
    perception,
    random_drive_runs,
)

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
More = Sequence[Contender | str]
"""Contenders beside the schedules, the registered ones by name."""

PERCEIVING = ("best constant", "nn", "anfis")
"""The kinds of contenders that are driven when friction and wind are not known exactly."""


def on_operating_points(
    setup: SetUp, schedules: Mapping[str, Schedule], count: int, seed: int, *, known_as: Sequence[str] = ("exact",),
    more: More = (), progress: Progress | None = None,
) -> dict[str, Comparison]:  # fmt: skip
    """On `count` unseen operating points, for each way of knowing friction and wind (see `runs.perception`).

    Sobol points of the campaign's box; every cost is the mean over noise seeds that nothing was tuned on; regret is to
    the optimum of each point, or to the best constant where the plant is costly (`Plant.costly`): to search there would
    take long.
    """
    points = evaluation_points(setup, count, seed)
    ways = {name: perception(name, setup.believed, setup.profile) for name in known_as}
    best, reference, plant = None, "optimum", _searchable(setup)
    if plant is None:
        reference = _needs_a_constant(schedules)
    else:
        search = SwarmSearch(setup.campaign.search.space(), setup.campaign.swarm, seed)
        best = optimum(
            _objective(setup, plant), points, search, evaluation=setup.evaluation,
            known=_constants(schedules), progress=progress,
        )  # fmt: skip
    found = {}
    for name, known in ways.items():
        runs = operating_point_runs(
            setup.driven, setup.mpc, points, setup.profile, known_as=known, failure=setup.method.runs.failure
        )
        contenders = contenders_of(schedules, points, _made(more, runs))
        if best is not None:
            contenders["optimum"] = Contender("optimum", best, hindsight=True, kind="optimum")
        chosen = _driven(contenders, name, (*PERCEIVING, "optimum"))
        found[name] = compare(runs, chosen, setup.evaluation.noise_seeds, reference, points, progress)
    return found


def on_drives(
    setup: SetUp, schedules: Mapping[str, Schedule], count: int, seed: int, *, known_as: Sequence[str] = ("exact",),
    more: More = (), progress: Progress | None = None,
) -> dict[str, Comparison]:  # fmt: skip
    """On `count` random drives that nothing was trained on; regret is to the best constant.

    The best constant of each drive, with hindsight, is left out where the plant is costly.
    """
    ways = {name: perception(name, setup.believed, setup.profile) for name in known_as}
    reference = _needs_a_constant(schedules)
    numbers, noise = evaluation_drives(setup.evaluation, count, seed), setup.evaluation.noise_seeds[:1]
    found = {}
    for name, known in ways.items():
        runs = drive_runs(setup, numbers, known)
        contenders = contenders_of(schedules, more=_made(more, runs))
        if name == "exact" and _searchable(setup) is not None:
            best = per_run_best(runs, _hindsight(setup, schedules), noise)
            contenders["per-drive constant"] = Contender(
                "per-drive constant", best, hindsight=True, kind="per-drive constant"
            )
        chosen = _driven(contenders, name, PERCEIVING)
        found[name] = compare(runs, chosen, noise, reference, np.array(numbers, dtype=float)[:, None], progress)
    return found


def on_tests(setup: SetUp, schedules: Mapping[str, Schedule], *, more: More = ()) -> dict[str, Comparison]:
    """On the paper's two tests, in the campaign's profile."""
    reference = _needs_a_constant(schedules)
    found = {}
    for name in PUBLISHED:
        runs = paper_test_runs(setup.driven, setup.mpc, name, setup.profile, failure=setup.method.runs.failure)
        contenders = contenders_of(schedules, more=_made(more, runs))
        found[name] = compare(runs, contenders.values(), setup.evaluation.noise_seeds, reference, np.zeros((1, 1)))
    return found


def _searchable(setup: SetUp) -> Plant | None:
    """The plant that judges, where many tunings can be driven on it."""
    driven = setup.driven
    return None if isinstance(driven, SteppedPlant) or driven.costly else driven


def drive_runs(setup: SetUp, numbers: range, known: KnownAs = None) -> RunSet:
    """Random drives as an evaluation drives them."""
    runs = setup.method.runs
    return random_drive_runs(
        setup.driven, setup.mpc, numbers, setup.evaluation.duration, setup.profile, roads=setup.roads,
        segment_seconds=runs.segment, known_as=known, failure=runs.failure,
    )  # fmt: skip


def _made(more: More, runs: RunSet) -> list[Contender]:
    return [get_contender(each, runs) if isinstance(each, str) else each for each in more]


def _driven(contenders: Mapping[str, Contender], known_as: str, perceiving: Sequence[str]) -> list[Contender]:
    """All contenders where friction and wind are known exactly; else those for which it matters."""
    if known_as == "exact":
        return list(contenders.values())
    return [each for kind in perceiving for each in contenders.values() if each.kind == kind]


def _objective(setup: SetUp, plant: Plant) -> Callable[[Sequence[int]], Objective]:
    """The cost of a tuning on an operating point; a run fails when it does in a `RunSet`."""
    return lambda noise_seeds: Objective(
        plant, setup.mpc, "lane-change", setup.profile, tuple(noise_seeds), failure=setup.method.runs.failure
    )


def _constants(schedules: Mapping[str, Schedule]) -> Array:
    rows = [schedules[name](ANYWHERE) for name in ("best constant", "fallback") if name in schedules]
    return np.reshape(rows, (-1, 4))


def _needs_a_constant(schedules: Mapping[str, Schedule]) -> str:
    """The constant that regret is measured against."""
    if "best constant on drives" in schedules:
        return "best constant"
    raise InvalidInput(
        "the best constant on drives, to which all is compared, is not among the schedulers: those of one's own "
        "configuration are files of `adaptrack adaptation --out DIR`, given as --schedulers DIR/schedulers."
    )


def _hindsight(setup: SetUp, schedules: Mapping[str, Schedule]) -> Array:
    """Tunings around the best constant on drives, for hindsight."""
    law = setup.evaluation
    grid = [(Np, Nc, 1.0, ratio) for Np in law.hindsight_Np for Nc in law.hindsight_Nc for ratio in law.hindsight_R]
    first = [schedules[kind](ANYWHERE) for kind in ("best constant on drives",) if kind in schedules]
    return np.array([*first, *grid])
