"""Schedules that learn on the closed loop: campaign, constants, look-up table, networks and fuzzy systems, guard.

Each schedule is one file in a folder. A repeated run keeps the files that the same campaign, effort and software made.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from adaptrack.analysis.feasibility import Feasibility
from adaptrack.analysis.stability import loop_map
from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.progress import ProgressCall
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import (
    Constant,
    Guarded,
    Lookup,
    Schedule,
    SchedulingVariables,
    StabilityMap,
    Table,
    load_scheduler,
    made_for,
)
from adaptrack.core.maths import portable
from adaptrack.paper.campaign import run_campaign, software_versions
from adaptrack.paper.campaign_config import CampaignConfig
from adaptrack.paper.data_set import DataSet, load_dataset
from adaptrack.paper.improvement import Learnable, Surfaces, Training, improve
from adaptrack.paper.landscape import LEARNED_OUTPUTS
from adaptrack.paper.learning_task import LEARNED_INPUTS, LEARNING_SEED, START, Effort, LearningTask
from adaptrack.paper.operating_points import POINT_NAMES
from adaptrack.paper.surfaces import FuzzySurface, NetworkSurface
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.pso import SearchSpace, SwarmSettings, minimise
from adaptrack.tuning.runs import Indices, RunSet

Array = NDArray[np.float64]
Schedules = Mapping[str, Schedule]
"""By contender, see `CONTENDER_NAMES`; schedules of other origin by another name."""

CONTENDER_NAMES = ("fallback", "best constant", "best constant on drives", "look-up", "nn", "anfis")
"""The schedules of an adaptation, in the order in which they are made: a domain without a fallback is refused first."""
ANYWHERE = SchedulingVariables(15.0, 0.0, 0.7, 0.0)
"""A constant schedule has the same tuning everywhere."""

# The search for a constant
CONSTANT_RUNS = 512
"""Runs that each tuning of the search drives."""
CONSTANT_NOISE = 700_000 + LEARNING_SEED
CONSTANT_SPACE = SearchSpace(
    names=("Np", "Nc", "R"), low=(10.0, 1.0, 10.0), high=(60.0, 18.0, 1e6),
    integers=("Np", "Nc"), decades=("R",), ordered=("Nc", "Np"), spread=2.0,
)  # fmt: skip

# The fallback of the guard: a constant that is slow and steady
FALLBACK_MARGIN = 0.1
"""Smallest modulus margin over the domain: twice that of a schedule."""
FALLBACK_RATIO = 2.0
"""Smallest log10 R/Q."""
FALLBACK_DRIVES, FALLBACK_FINALISTS = 128, 16
"""Hard drives that judge all candidates, and the number of those that then drive all hard drives."""
FALLBACK_FAILURES = 1
"""Failures above the fewest that are tolerated for a lower cost."""
FALLBACK_NOISE = 1

# The look-up table
LOOKUP_NODES = {"speed": 10, "y_ref": 7, "friction": 5, "wind": 5}
LOOKUP_NEIGHBOURS = 12
"""Operating points that are averaged at a node, so that the noise of each optimum averages out."""

# Networks and fuzzy systems before the first round: the same tuning everywhere
SPANS = {"Np": (29.0, 10.0), "Nc": (5.0, 5.0), "log10_ratio": (3.6, 0.5)}
"""First value of each output, and the scale of its changes."""
FUZZY_RULES = 20
CLUSTERED_INPUTS, CLUSTER_STRIDE = 6000, 40
"""Inputs that are clustered for the centres of the rules, and the periods between two of them in a run."""

# The guard
GUARD_MARGIN = 0.05
"""Smallest modulus margin: with 0.03 scrambled weights failed in 4 of 1,800 drives, with 0.05 in none of 1,200; 0.08
costs 6 % on operating points."""
SLOW_SPEED, SLOW_MARGIN = 6.0, 0.05
"""m/s, below which the margin must be larger by that: loops change fastest there, and the map has few nodes."""
GUARD_OPTIONS: dict[str, Any] = {"slack": 1.0, "hold": 30, "offset_limit": 0.065, "rates": (5.0, 2.0, 0.3)}
"""Widths of the domain, periods, s^2, change in a period, see `Guarded`. Of 3,000 fast drives on slippery roads the
networks failed in 35 without the offset limit and in 8 with 0.06 s^2, at the same cost."""


@checked
def adapt(
    campaign: CampaignConfig, out: str | os.PathLike[str], *, workers: int | None = None, effort: Effort | None = None,
    progress: ProgressCall | None = None,
) -> dict[str, Schedule]:  # fmt: skip
    """Run a campaign and learn its schedules in a folder, or resume there; by contender, see `CONTENDER_NAMES`.

    The folder then holds the campaign and, in `schedulers`, one file for each contender.

    Raises
    ------
    InvalidInput
        When schedules cannot learn from the campaign, see `LearningTask.of`, or no constant tuning holds its domain.
    StorageError
        When the folder cannot be written, or holds something damaged.
    """
    folder, task = Path(out), LearningTask.of(campaign, effort)
    makers = Makers(task, folder / "campaign", workers, progress or (lambda work, steps, total: None))
    schedules: dict[str, Schedule] = {}
    for contender in CONTENDER_NAMES:
        file = folder / "schedulers" / f"{contender.replace(' ', '-')}.json"
        identity = identity_of(task, contender)
        schedule = _load_schedule(file, identity)
        if schedule is None:
            makers.show(contender, 0, 1)
            _save_schedule(makers.make(contender, schedules), file, task, identity)
            schedule = load_scheduler(file)
        schedules[contender] = schedule
    return schedules


# -- files ------------------------------------------------------------------------------------------------------------
def shipped_schedules() -> dict[str, Schedule]:
    """The schedules that ship with the package (campaign road-sobol), by contender."""
    return {contender: load_scheduler(f"road-{contender.replace(' ', '-')}") for contender in CONTENDER_NAMES}


def read_schedules(folder: str | os.PathLike[str]) -> dict[str, Schedule]:
    """The schedules in the folder of an `adapt`, by contender.

    Raises
    ------
    StorageError
        When one is missing or cannot be read.
    """
    place = Path(folder) / "schedulers"
    return {contender: load_scheduler(place / f"{contender.replace(' ', '-')}.json") for contender in CONTENDER_NAMES}


def identity_of(task: LearningTask, contender: str) -> str:
    """SHA-256 of everything on which a schedule depends: its campaign, the effort, the method and the software."""
    method = [(Path(__file__).parent / f"{name}.py").read_text(encoding="utf-8") for name in METHOD]
    settings = [contender, task.plan.identity, task.effort, method, software(task)]
    return hashlib.sha256(json.dumps(settings).encode()).hexdigest()


METHOD = ("adaptation", "improvement", "landscape", "learning_task", "surfaces")
"""Files of this room that hold the method with its constants."""


def software(task: LearningTask) -> dict[str, str]:
    """Versions of the software on which the numbers depend."""
    return software_versions(task.plan.setup) | {"scikit-learn": version("scikit-learn")}


def _load_schedule(file: Path, identity: str) -> Schedule | None:
    """The schedule in a file; None if there is none of this identity."""
    if not file.exists():
        return None
    schedule = load_scheduler(file)
    return schedule if schedule.provenance.get("identity") == identity else None


def _save_schedule(schedule: Schedule, file: Path, task: LearningTask, identity: str) -> None:
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{file.parent}: cannot be made: {error.strerror or error}.") from error
    twin = ", learned on its twin" if task.evaluated_plant.costly else ""
    purpose = made_for(task.mpc, task.profile)
    purpose |= {"plant": f"{task.plan.config.plant}{twin}", "tyre": task.plant.tyre_name}
    record = {"identity": identity, "campaign": task.plan.identity, "effort": task.effort._asdict()}
    provenance = {**schedule.provenance, **record, "software": software(task)}
    replace(schedule, provenance=provenance, made_for=purpose).save(file)


# -- makers -----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Makers:
    """The makers of the contenders; campaign, runs and map are prepared on first use."""

    task: LearningTask
    folder: Path
    """of the campaign"""
    workers: int | None
    show: ProgressCall

    def make(self, contender: str, schedules: Schedules) -> Schedule:
        """The schedule of a contender; schedules: those before it in `CONTENDER_NAMES`."""
        if contender in ("nn", "anfis"):
            return self.learned(contender, as_tuning(schedules["fallback"](ANYWHERE)))
        if contender == "look-up":
            return self.look_up()
        if contender == "fallback":
            return Constant(safe_constant(self.training[2][0], self.stability))
        runs, _ = self.training[1 if contender == "best constant on drives" else 0]
        return Constant(as_tuning(best_constant(runs, self.task.effort.constant_tunings)))

    @cached_property
    def dataset(self) -> DataSet:
        """The data set of the campaign."""
        return load_dataset(run_campaign(self.task.plan.config, self.folder, workers=self.workers, progress=self.show))

    @cached_property
    def training(self) -> Training:
        """Lane changes, drives, hard drives."""
        return self.task.training()

    @cached_property
    def held_out(self) -> list[RunSet]:
        """Runs that choose the best round."""
        return self.task.held_out()

    @cached_property
    def stability(self) -> StabilityMap:
        """The map of the guard."""
        return stability_map(self.task)

    def look_up(self) -> Schedule:
        """A table over the operating point, as it is made in practice."""
        nodes = {name: np.linspace(*self.task.box[name], count) for name, count in LOOKUP_NODES.items()}
        return neighbour_lookup(self.dataset, nodes)

    def learned(self, model: str, safe: Tuning) -> Schedule:
        """Networks or fuzzy systems, learned on the closed loop, behind the guard with its fallback."""
        start = Learnable(self._first_surfaces(model), LEARNED_INPUTS, self.task.domain, model)
        improvement = improve(
            start, self.training, self.held_out, rounds=self.task.effort.rounds, seed=LEARNING_SEED, safe=safe,
            progress=lambda steps, total: self.show(model, steps, total),
        )  # fmt: skip
        guarded = Guarded(improvement.schedule, safe, stability=self.stability, **GUARD_OPTIONS)
        return replace(guarded, provenance={"history": improvement.history})

    def _first_surfaces(self, model: str) -> Surfaces:
        """Surfaces with the same tuning everywhere."""
        domain = self.task.domain
        if model == "nn":
            return {
                slot: NetworkSurface.start(domain, value, span, 10 * LEARNING_SEED + i)
                for i, (slot, (value, span)) in enumerate(SPANS.items())
            }
        columns = [SchedulingVariables._fields.index(name) for name in LEARNED_INPUTS]
        variables = np.concatenate([
            runs.variables[:, ::CLUSTER_STRIDE].reshape(-1, len(SchedulingVariables._fields))
            for runs, _ in self.training
        ])  # fmt: skip
        rng = np.random.default_rng((LEARNING_SEED, 0xF522))
        rows = np.sort(rng.choice(len(variables), CLUSTERED_INPUTS))
        surface = FuzzySurface.start(np.clip(variables[rows][:, columns], *domain.T), 0.0, FUZZY_RULES, LEARNING_SEED)
        return {slot: surface.level(SPANS[slot][0]) for slot in LEARNED_OUTPUTS}


# -- constants --------------------------------------------------------------------------------------------------------
def as_tuning(row: ArrayLike) -> Tuning:
    """Np, Nc, Q, R with whole horizons."""
    Np, Nc, Q, R = np.asarray(row, dtype=float).tolist()
    return Tuning(round(Np), round(Nc), Q, R)


def best_constant(runs: RunSet, tunings: int = Effort().constant_tunings) -> Array:
    """(4,) the tuning with the lowest mean log cost over `CONSTANT_RUNS` of the runs, by a swarm of so many tunings."""
    rng = np.random.default_rng((LEARNING_SEED, 0xC057))
    indices = np.sort(rng.choice(len(runs), min(CONSTANT_RUNS, len(runs)), replace=False))

    def cost(tuning: ArrayLike) -> float:
        return float(portable.log(runs.costs(tuning, [CONSTANT_NOISE], indices)).mean())

    def costs(positions: Array) -> Array:
        return np.array([cost([Np, Nc, 1.0, R]) for Np, Nc, R in np.atleast_2d(positions)])

    swarm = minimise(costs, CONSTANT_SPACE, SwarmSettings(generations=max(1, tunings // 20)), seed=LEARNING_SEED)
    start = START.as_array()
    return start if cost(start) < float(swarm.cost) else np.array([swarm.x[0], swarm.x[1], 1.0, swarm.x[2]])


def safe_constant(runs: RunSet, stability: StabilityMap) -> Tuning:
    """The cheapest of the map's tunings far from instability that fail in hardly any of the hard drives.

    Raises
    ------
    InvalidInput
        As `safe_candidates`.
    """

    def judge(rows: Array, count: int) -> tuple[Indices, Array]:
        """Failures and mean log cost of each tuning, on the first `count` runs."""
        indices = np.arange(min(count, len(runs)))
        costs = np.stack([runs.drive(row, [FALLBACK_NOISE], indices)[:, 0] for row in rows])
        return np.isinf(costs).sum(axis=1), portable.log(np.minimum(costs, runs.failed_cost)).mean(axis=1)

    candidates = safe_candidates(stability)
    failures, cost = judge(candidates, FALLBACK_DRIVES)
    finalists = candidates[np.lexsort((cost, failures))[:FALLBACK_FINALISTS]]
    failures, cost = judge(finalists, len(runs))
    return as_tuning(finalists[np.argmin(np.where(failures <= failures.min() + FALLBACK_FAILURES, cost, np.inf))])


def safe_candidates(stability: StabilityMap) -> Array:
    """(n, 4) the map's tunings that are far from instability at every speed and friction.

    Raises
    ------
    InvalidInput
        When there is none, with the largest domain that one of them holds.
    """
    loops = Feasibility.from_map(stability.table.axes, 1.0 - stability.table.values, FALLBACK_MARGIN)
    loops = loops.among(loops.tunings[:, 3] >= portable.power(10.0, FALLBACK_RATIO))
    is_safe = loops.enough.all(axis=(0, 1))
    if is_safe.any():
        return loops.tunings[is_safe]
    message = (
        f"no constant tuning keeps the loop away from instability (modulus margin {loops.least:g}) over the whole "
        f"domain of {loops.requested}"
    )
    if loops.constant is None:
        raise InvalidInput(f"{message}, nor at any point of it: choose another car or profile.")
    raise InvalidInput(
        f"{message}: the largest part of it that one can hold is {loops.constant[1]}. Narrow the box of the campaign "
        "to that."
    )


def stability_map(task: LearningTask) -> StabilityMap:
    """The map of the guard: the modulus margin of the loop over speed, friction and tuning, driving straight.

    Good tunings are near to instability in a hard turn, so a map of turns costs more than it saves. Samples count as
    prompt, which is a little kinder than late ones.
    """
    prompt = load_profile(task.profile).without_sample_ages
    box = task.box
    axes, values = loop_map(task.linear, task.mpc, prompt, speed=box["speed"], friction=box["friction"], turn=None)
    values[axes[0] < SLOW_SPEED] += SLOW_MARGIN
    return StabilityMap(Table(axes, values), 1.0 - GUARD_MARGIN)


# -- look-up table ----------------------------------------------------------------------------------------------------
def neighbour_lookup(dataset: DataSet, nodes: Mapping[str, ArrayLike]) -> Schedule:
    """A table with the tuning of the library that has the lowest mean log cost near each node.

    nodes: along some or all of speed, y_ref, friction and wind. The mean is over the `LOOKUP_NEIGHBOURS` nearest
    operating points; distances are in ranges of the data.
    """
    axes = {name: np.asarray(values, dtype=float) for name, values in nodes.items()}
    points = dataset.operating_points[:, [POINT_NAMES.index(name) for name in axes]]
    ranges = np.ptp(points, axis=0)
    grid = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1)
    _, neighbours = cKDTree(points / ranges).query(
        grid.reshape(-1, len(axes)) / ranges, k=np.arange(1, min(LOOKUP_NEIGHBOURS, len(points)) + 1)
    )
    costs = dataset.landscape.astype(np.float64)
    worst = np.nanmax(np.where(np.isfinite(costs), costs, np.nan))
    logs = portable.log(np.where(np.isfinite(costs), costs, worst))
    best = dataset.library[np.argmin(logs[neighbours].mean(axis=1), axis=1)]
    return Lookup(axes, best.reshape(*grid.shape[:-1], 4), name="look-up")
