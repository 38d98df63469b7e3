"""Schedules that learn on the closed loop: campaign, constants, look-up table, networks and fuzzy systems, guard.

Each schedule is one file in a folder. A repeated run keeps the files that the same campaign, effort and software made.
No run and no noise seed is in two of these parts: learning, choice of the round (held out), evaluation.
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
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from adaptrack.analysis.feasibility import Feasibility
from adaptrack.analysis.stability import linear_twin, loop_map
from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import make_folder
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant
from adaptrack.control import scheduling
from adaptrack.control.controllers import MPC, Tuning
from adaptrack.control.scheduling import Schedule, SchedulingVariables, StabilityMap, load_scheduler
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.drive.failure import FailureLimits
from adaptrack.paper.campaign import run_campaign, software_versions, tuned_mpc
from adaptrack.paper.campaign_config import CampaignConfig, CampaignPlan
from adaptrack.paper.data_set import DataSet, load_dataset
from adaptrack.paper.improvement import LEARNED_OUTPUTS, LEARNING_ROUNDS, Learnable, Surfaces, Training, improve
from adaptrack.paper.operating_points import POINT_NAMES, Sobol, sobol
from adaptrack.paper.surfaces import FuzzySurface, NetworkSurface
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.pso import SearchSpace, SwarmSettings, minimise
from adaptrack.tuning.runs import Indices, RunSet, operating_point_runs, random_drive_runs

# -- the task: car, plant and controller of a campaign, and the runs to learn from ------------------------------------
LEARNING_SEED = 1
"""Of all random numbers of the learning; the shipped schedules have it."""
LEARNED_INPUTS = ("speed", "change", "acceleration", "friction")
"""Scheduling variables of the learned schedules. The wind gains nothing on drives, and cars do not measure it."""
CHANGE, ACCELERATION = (0.0, 12.0), (0.0, 3.5)
"""Domain of the reference preview: m, m/s^2. That of speed and friction is the campaign's box."""
START = Tuning(29, 5, 1.0, 4000.0)
"""Tuning before the first round: it fails in few runs, and a failed run shows no slope."""

TRAINING_POINTS, HELD_OUT_POINTS = 100 + LEARNING_SEED, 200 + LEARNING_SEED
"""Seeds of the Sobol points to learn from and held out; those of evaluations begin at 10,000."""
TRAINING_DRIVES, HARD_DRIVES, HELD_OUT_DRIVES = 1_000_000, 1_500_000, 2_000_000
"""Number of the first drive of each part; those of evaluations begin at 3,000,000."""
TRAINING_DURATION, HELD_OUT_DURATION = 30.0, 60.0
"""s, of a drive. Long drives are held out because evaluations drive 60 s."""
HARD_DRIVE_SPEED, HARD_DRIVE_DEMAND = (17.0, 29.0), (0.2, 0.35)
"""m/s and share of the grip of the hard drives, on which a car is lost if the tuning is wrong."""
SEGMENT = 2.0
"""s, length of the segments of a drive, and how long before a segment the cause of its cost may lie."""
DRIVE_STRIDE, POINT_STRIDE = 20, 8
"""Periods between two samples of the inputs, on drives and on lane changes (8 s)."""
FAILURE = FailureLimits(5.0, 0.7853981633974483)
"""A run fails 5 m off the reference or with 45 degrees of sideslip."""


class Effort(NamedTuple):
    """Numbers of runs and rounds; the shipped schedules have the defaults."""

    rounds: int = LEARNING_ROUNDS
    operating_points: int = 2048
    """lane changes in a gust to learn from"""
    drives: int = 1024
    hard_drives: int = 4096
    held_out_points: int = 512
    held_out_drives: int = 512
    round_runs: tuple[int, int, int] = (512, 256, 128)
    """lane changes, drives and hard drives of one round"""
    constant_tunings: int = 300
    """tunings that the search for a constant tries"""


@dataclass(frozen=True, eq=False)
class LearningTask:
    """Car, plant and controller for which schedules are learned and evaluated."""

    plan: CampaignPlan
    """of the campaign"""
    plant: Plant | SteppedPlant
    """plant to learn on: the campaign's, or the car's twin if that one is costly"""
    mpc: MPC
    """the paper's controller; schedules choose its tuning"""
    box: dict[str, tuple[float, float]]
    """operating domain of the campaign"""
    effort: Effort

    @classmethod
    def of(cls, campaign: CampaignConfig, effort: Effort | None = None) -> LearningTask:
        """The task of a campaign.

        Raises
        ------
        InvalidInput
            When the operating points are not a Sobol sample of a box, or the campaign's runs are not lane changes of
            the usual length and weight, from which schedules learn.
        """
        points = campaign.operating_points
        if not isinstance(points, Sobol):
            raise InvalidInput(
                f"campaign {campaign.name!r}: schedules are learned on a Sobol sample of a box: "
                'give operating_points the kind "sobol".'
            )
        _check_runs(campaign)
        plan = CampaignPlan.of(campaign)
        setup = plan.setup
        return cls(plan, setup.searched_on, tuned_mpc(setup, START), dict(points.box), effort or Effort())

    @property
    def evaluated_plant(self) -> Plant | SteppedPlant:
        """The plant of evaluations: the campaign's."""
        return self.plan.setup.plant()

    @property
    def profile(self) -> str:
        """The name of the profile, or its file."""
        return self.plan.config.profile

    @property
    def estimated(self) -> SingleTrack | DualTrack:
        """The car model in an estimator of friction and wind."""
        setup = self.plan.setup
        return self.plant if isinstance(self.plant, SingleTrack | DualTrack) else DualTrack(setup.vehicle, setup.tyre)

    @property
    def linear(self) -> Plant:
        """The plant in linear analysis, see `stability.linear_twin`."""
        car = self.plan.setup.vehicle
        domain = car.domain.replace(speed=self.box["speed"], friction=self.box["friction"])
        return linear_twin(self.plant, car, domain)

    @property
    def domain(self) -> Array:
        """(inputs, 2) lowest and highest value of each of `LEARNED_INPUTS`."""
        ranges = {**self.box, "change": CHANGE, "acceleration": ACCELERATION}
        return np.array([ranges[name] for name in LEARNED_INPUTS])

    # -- runs ---------------------------------------------------------------------------------------------------------
    def training(self) -> Training:
        """Lane changes, drives and hard drives to learn from, each with the number that a round drives."""
        effort = self.effort
        points = sobol(effort.operating_points, self.box, seed=TRAINING_POINTS)
        hard = {"speed": HARD_DRIVE_SPEED, "demand": HARD_DRIVE_DEMAND}
        sets = (
            self.lane_changes(points),
            self._drives(TRAINING_DRIVES, effort.drives, TRAINING_DURATION),
            self._drives(HARD_DRIVES, effort.hard_drives, TRAINING_DURATION, hard),
        )
        return [(runs, min(count, len(runs))) for runs, count in zip(sets, effort.round_runs, strict=True)]

    def held_out(self) -> list[RunSet]:
        """Lane changes and drives that choose the best round."""
        points = sobol(self.effort.held_out_points, self.box, seed=HELD_OUT_POINTS)
        drives = self._drives(HELD_OUT_DRIVES, self.effort.held_out_drives, HELD_OUT_DURATION)
        return [self.lane_changes(points), drives]

    def lane_changes(self, points: Array) -> RunSet:
        """A lane change in a gust on each operating point (n, 4)."""
        return operating_point_runs(self.plant, self.mpc, points, self.profile, stride=POINT_STRIDE, failure=FAILURE)

    def _drives(
        self, first: int, count: int, duration: float, roads: dict[str, tuple[float, float]] | None = None
    ) -> RunSet:
        domain: dict[str, Any] = self.plan.setup.vehicle.domain.drive_options
        return random_drive_runs(
            self.plant, self.mpc, range(first, first + count), duration, self.profile,
            drive_options=domain | (roads or {}), segment_seconds=SEGMENT, stride=DRIVE_STRIDE, failure=FAILURE,
        )  # fmt: skip


def _check_runs(campaign: CampaignConfig) -> None:
    default = campaign.replace(scenario="lane-change", duration=None, move_weight=None).settled()
    settled = campaign.settled()
    for key in ("scenario", "duration", "move_weight"):
        if getattr(settled, key) != getattr(default, key):
            raise InvalidInput(
                f"campaign {campaign.name!r}: {key} = {getattr(settled, key)!r}: must be {getattr(default, key)!r}, as "
                "in the runs from which schedules learn."
            )


# -- the schedules of a campaign --------------------------------------------------------------------------------------
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
        file, identity = _file(folder, contender), identity_of(task, contender)
        if not file.exists() or load_scheduler(file).provenance.get("identity") != identity:
            makers.show(contender, 0, 1)
            _save_schedule(makers.make(contender, schedules), file, task, identity)
        schedules[contender] = load_scheduler(file)
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
    return {contender: load_scheduler(_file(folder, contender)) for contender in CONTENDER_NAMES}


def _file(folder: str | os.PathLike[str], contender: str) -> Path:
    return Path(folder) / "schedulers" / f"{contender.replace(' ', '-')}.json"


def identity_of(task: LearningTask, contender: str) -> str:
    """SHA-256 of everything on which a schedule depends: its campaign, the effort, the method and the software."""
    method = [(Path(__file__).parent / f"{name}.py").read_text(encoding="utf-8") for name in METHOD]
    settings = [contender, task.plan.identity, task.effort, method, software(task)]
    return hashlib.sha256(json.dumps(settings).encode()).hexdigest()


METHOD = ("adaptation", "improvement", "surfaces")
"""Files of this room that hold the method with its constants."""


def software(task: LearningTask) -> dict[str, str]:
    """Versions of the software on which the numbers depend."""
    return software_versions(task.plan.setup) | {"scikit-learn": version("scikit-learn")}


def _save_schedule(schedule: Schedule, file: Path, task: LearningTask, identity: str) -> None:
    make_folder(file.parent)
    twin = ", learned on its twin" if task.evaluated_plant.costly else ""
    purpose = scheduling.made_for(task.mpc, task.profile)
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
            nodes = {name: np.linspace(*self.task.box[name], count) for name, count in LOOKUP_NODES.items()}
            return neighbour_lookup(self.dataset, nodes)
        if contender == "fallback":
            return scheduling.Constant(safe_constant(self.training[2][0], self.stability))
        runs, _ = self.training[1 if contender == "best constant on drives" else 0]
        return scheduling.Constant(as_tuning(best_constant(runs, self.task.effort.constant_tunings)))

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

    def learned(self, model: str, safe: Tuning) -> Schedule:
        """Networks or fuzzy systems, learned on the closed loop, behind the guard with its fallback."""
        start = Learnable(self._first_surfaces(model), LEARNED_INPUTS, self.task.domain, model)
        improvement = improve(
            start, self.training, self.held_out, rounds=self.task.effort.rounds, seed=LEARNING_SEED, safe=safe,
            progress=lambda steps, total: self.show(model, steps, total),
        )  # fmt: skip
        guarded = scheduling.Guarded(improvement.schedule, safe, stability=self.stability, **GUARD_OPTIONS)
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
    """The cheapest of the `safe_candidates` that fail in hardly any of the hard drives; errors as those."""

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

    Raises InvalidInput, with the largest domain that one of them holds, when there is none.
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
    return StabilityMap(scheduling.Table(axes, values), 1.0 - GUARD_MARGIN)


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
    return scheduling.Lookup(axes, best.reshape(*grid.shape[:-1], 4), name="look-up")
