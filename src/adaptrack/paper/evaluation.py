"""Evaluation of schedules on operating points, drives and the paper's tests that no schedule has learned from.

Regret is the cost of a run over the cost of the reference on the same run: the optimum of an operating point, on drives
the best constant.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.comparison.compare import Contender, compare
from adaptrack.comparison.table import Comparison
from adaptrack.core.maths.portable import Array
from adaptrack.drive.metrics import PAPER_MSE
from adaptrack.paper import adaptation
from adaptrack.paper.adaptation import FAILURE, LearningTask, Schedules
from adaptrack.paper.operating_points import sobol
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.runs import make_perception, operating_point_runs, paper_test_runs, random_drive_runs

BEST_CONSTANT, DRIVE_CONSTANT, POINT_OPTIMUM = "best constant", "best constant on drives", "optimum"
PERCEIVING = (BEST_CONSTANT, "nn", "anfis", POINT_OPTIMUM)
"""Contenders that are repeated where friction and wind are not known exactly, with those they are compared with."""

EVALUATION_SEED = 7
"""Default of the evaluations: it selects the operating points and drives."""
FIRST_POINTS, FIRST_DRIVE, DRIVE_BLOCK = 10_000, 3_000_000, 10_000
"""Sobol seed and number of the first drive of the evaluation with seed 0, and drives for each seed."""
EVALUATED_DURATION = 60.0
"""s, of a drive"""
EVALUATION_NOISE = tuple(range(900_001, 900_009))
"""Noise seeds of every evaluation; drives take the first."""
SEARCH_NOISE = ((800_001, 800_002, 800_003), (800_004, 800_005, 800_006), (800_007, 800_008, 800_009))
"""Noise seeds of each swarm that searches for the optimum: three times the effort of a campaign."""
CHOICE_NOISE = tuple(range(810_001, 810_009))
"""Noise seeds that choose the best of what the swarms found, so that none of them is favoured by its own noise."""


def evaluate_on_operating_points(
    task: LearningTask, schedules: Schedules, count: int, seed: int = EVALUATION_SEED, *,
    perception: Sequence[str] = ("exact",), progress: ProgressCall | None = None,
) -> dict[str, Comparison]:  # fmt: skip
    """On `count` Sobol points of the campaign's box, for each way of knowing friction and wind (see `perception`).

    The reference is the optimum of each point, on a plant that takes long the best constant.

    Raises
    ------
    InvalidInput
        When the points of this seed were learned from, or a way of knowing is unknown.
    """
    points = evaluation_points(task, count, seed)
    contenders = _point_contenders(schedules, points)
    reference, plant = BEST_CONSTANT, task.evaluated_plant
    if not isinstance(plant, SteppedPlant) and not plant.costly:
        constants = np.array([schedules[name](adaptation.ANYWHERE) for name in (BEST_CONSTANT, "fallback")])
        tunings = find_optimum(task, plant, points, seed, constants, progress)
        contenders.append(Contender(POINT_OPTIMUM, tunings, hindsight=True))
        reference = POINT_OPTIMUM
    return {
        name: compare(
            operating_point_runs(
                plant, task.mpc, points, task.profile, failure=FAILURE,
                perception=make_perception(name, task.estimated, task.profile),
            ),
            _select_contenders(contenders, name), EVALUATION_NOISE, reference, points, progress,
        )
        for name in perception
    }  # fmt: skip


def evaluate_on_drives(
    task: LearningTask, schedules: Schedules, count: int, seed: int = EVALUATION_SEED, *,
    perception: Sequence[str] = ("exact",), progress: ProgressCall | None = None,
) -> dict[str, Comparison]:  # fmt: skip
    """On `count` random drives, for each way of knowing friction and wind; the reference is the best constant."""
    first = FIRST_DRIVE + DRIVE_BLOCK * seed
    numbers = range(first, first + count)
    roads, where = task.plan.setup.vehicle.domain.drive_options, np.array(numbers, dtype=float)[:, None]
    return {
        name: compare(
            random_drive_runs(
                task.evaluated_plant, task.mpc, numbers, EVALUATED_DURATION, task.profile, drive_options=roads,
                segment_seconds=adaptation.SEGMENT, perception=make_perception(name, task.estimated, task.profile),
                failure=FAILURE,
            ),
            _select_contenders(_moving_contenders(schedules), name), EVALUATION_NOISE[:1], BEST_CONSTANT, where,
            progress,
        )
        for name in perception
    }  # fmt: skip


def evaluate_on_tests(task: LearningTask, schedules: Schedules) -> dict[str, Comparison]:
    """On the paper's two tests, in the campaign's profile; the reference is the best constant."""
    return {
        name: compare(
            paper_test_runs(task.evaluated_plant, task.mpc, name, task.profile, failure=FAILURE),
            _moving_contenders(schedules), EVALUATION_NOISE, BEST_CONSTANT, np.zeros((1, 1)),
        )
        for name in PAPER_MSE
    }  # fmt: skip


def evaluation_points(task: LearningTask, count: int, seed: int) -> Array:
    """(count, 4) the operating points of an evaluation.

    Raises InvalidInput when something was tuned on them or learned from them.
    """
    first = FIRST_POINTS + seed
    used = adaptation.TRAINING_POINTS, adaptation.HELD_OUT_POINTS
    if first in (getattr(task.plan.config.operating_points, "seed", None), *used):
        raise InvalidInput(f"seed = {seed}: these operating points were learned from: choose another seed.")
    return sobol(count, task.box, seed=first)


def _point_contenders(schedules: Schedules, points: Array) -> list[Contender]:
    """The contenders on operating points; the look-up table is made from such, and takes the point as its input."""
    names = [name for name in schedules if name not in (DRIVE_CONSTANT, "fallback")]
    return [Contender(name, schedules[name].batch(points) if name == "look-up" else schedules[name]) for name in names]


def _moving_contenders(schedules: Schedules) -> list[Contender]:
    """The contenders on drives and tests: the best constant is the one that was tuned on drives."""
    names = [name for name in schedules if name not in (BEST_CONSTANT, DRIVE_CONSTANT, "fallback")]
    return [
        Contender(BEST_CONSTANT, schedules[DRIVE_CONSTANT]), *(Contender(name, schedules[name]) for name in names)
    ]  # fmt: skip


def _select_contenders(contenders: Sequence[Contender], perception: str) -> list[Contender]:
    """All contenders where friction and wind are known exactly, otherwise `PERCEIVING`."""
    return [contender for contender in contenders if perception == "exact" or contender.name in PERCEIVING]


def find_optimum(
    task: LearningTask, plant: Plant, points: Array, seed: int, constants: Array, progress: ProgressCall | None = None
) -> Array:
    """(n, 4) the best tuning of each operating point (n, 4).

    A swarm for each of `SEARCH_NOISE`; of its results and the constants (k, 4) the best on `CHOICE_NOISE`.
    """
    config = task.plan.config
    searches = [_objective(task, plant, noise) for noise in SEARCH_NOISE]
    judge, space = _objective(task, plant, CHOICE_NOISE), config.search.space()

    def best_tuning(i: int) -> Array:
        swarms = [
            search.tune(points[i], config.swarm, seed=seed + s, stream=i, space=space).tuning
            for s, search in enumerate(searches)
        ]
        candidates = np.vstack([*swarms, constants])
        return np.asarray(candidates[np.argmin(judge.costs(points[i], candidates))])

    rows = []
    with ThreadPoolExecutor(os.cpu_count() or 1) as pool:
        for i, row in enumerate(pool.map(best_tuning, range(len(points)))):
            rows.append(row)
            if progress is not None and i % 16 == 0:
                progress(POINT_OPTIMUM, i, len(points))
    return np.array(rows)


def _objective(task: LearningTask, plant: Plant, noise: tuple[int, ...]) -> Objective:
    """The cost of a tuning on an operating point; a run fails by the rule of the evaluation."""
    return Objective(plant, task.mpc, "lane-change", task.profile, noise, failure=FAILURE)
