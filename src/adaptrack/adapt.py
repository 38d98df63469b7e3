"""From a configuration to schedulers that can be deployed: tune, learn, guard, certify, evaluate.

Every stage leaves its file in the folder; a chain that was interrupted goes on with the first stage that is missing.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from adaptrack.closed_loop import LOST_COST, Course, Policy, improve
from adaptrack.controllers import MPC, Tuning
from adaptrack.dataset import DataSet, load_dataset
from adaptrack.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.evaluate.ladder import EVALUATION_SEEDS, Ladder, best_constant, climb, optimum, per_run_best
from adaptrack.evaluate.paper import scheduler
from adaptrack.evaluate.road import (
    FIRST_EVALUATION_DRIVE,
    FIRST_HELD_OUT_DRIVE,
    FIRST_TRAINING_DRIVE,
    HARD,
    START,
    condition_course,
    controller,
    drive_course,
    neighbour_lookup,
    objective,
    paper_test,
    told,
)
from adaptrack.files import Record, build, read_toml, safe_name
from adaptrack.learning.landscape import FuzzySurface, NetworkSurface, Surface
from adaptrack.learning.training import train
from adaptrack.metrics import PUBLISHED
from adaptrack.plant import DualTrack, SingleTrack
from adaptrack.scheduling import (
    Constant,
    Guarded,
    Schedule,
    SchedulingVariables,
    StabilityMap,
    Table,
    list_schedulers,
    load_scheduler,
)
from adaptrack.stability import loop_map
from adaptrack.tuning.campaign import Progress as CampaignProgress
from adaptrack.tuning.campaign import run_campaign
from adaptrack.tuning.config import Box, CampaignConfig, Pair, Plan, Sobol, load_campaign
from adaptrack.tuning.operating_points import NAMES, sobol

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

_DATA = Path(__file__).parent / "data" / "adaptations"
_STEPS = {"Np": (29.0, 10.0), "Nc": (5.0, 5.0), "log10_ratio": (3.6, 0.5)}
"""Where each output starts, and the scale of its changes."""
HELD_OUT_CONDITIONS, HELD_OUT_DRIVES = 512, 512
KNOWLEDGE = ("exact", "noisy", "lagged", "biased high", "biased low", "estimated", "withheld")
"""The ways of knowing friction and wind that are evaluated."""
TOLD_RUNGS = ("best constant", "nn", "anfis")
"""The rungs that are driven when friction and wind are not known exactly."""
NEARNESS, FALLBACK_NEARNESS, SLACK, OFFSET_LIMIT, HOLD = 0.95, 0.9, 1.0, 0.065, 30
"""How near to instability a guarded loop may be, and its fallback anywhere in the domain; how far outside the domain an
input may be, in its widths; how far the car may stray (s^2, see `Guard`); how many steps a fallback lasts."""
SLOW, SLOW_MARGIN = 6.0, 0.05
"""m/s, below which the map counts every loop as this much nearer: loops change fastest there, and its nodes are few."""
_NODES = {"speed": 10, "y_ref": 7, "friction": 5, "wind": 5}
"""Nodes of a look-up table along each of its axes."""
NEIGHBOURS, SPEED_NEIGHBOURS = 12, 320
"""Over how many of the nearest conditions a node of the look-up tables averages: in four dimensions, and in one."""
_SEEDS, FIRST_EVALUATION_SEED = (100, 200), 10_000
"""Of the conditions to learn from and to hold out, to which the configuration's seed is added, and of an evaluation."""
_METHOD = [
    HELD_OUT_CONDITIONS, HELD_OUT_DRIVES, NEARNESS, FALLBACK_NEARNESS, SLACK, OFFSET_LIMIT, HOLD, SLOW, SLOW_MARGIN,
    list(_NODES.items()), NEIGHBOURS, SPEED_NEIGHBOURS,
]  # fmt: skip
"""What results depend on beside the configuration."""
_ANYWHERE = SchedulingVariables(15.0, 0.0, 0.7, 0.0)


def _tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


class Learning(Record):
    """How the network and the fuzzy systems learn."""

    inputs: Annotated[tuple[str, ...], BeforeValidator(_tuples)] = Field(
        min_length=1, description="scheduling variables"
    )
    domain: dict[str, Pair] = Field(description="lowest and highest value of each input")
    rounds: int = Field(default=60, ge=1, description="of improvement")
    conditions: int = Field(default=2048, ge=16, description="lane changes in a gust to learn from")
    drives: int = Field(default=1024, ge=8, description="random drives of 30 s")
    hard_drives: int = Field(default=1024, ge=8, description="fast ones near the limit")
    rules: int = Field(default=20, ge=2, description="of each fuzzy system")

    @model_validator(mode="after")
    def _has_a_domain(self) -> Self:
        known = SchedulingVariables._fields[:-1]
        for what, names in (("inputs", self.inputs), ("domain", self.domain)):
            for name in names:
                if name not in known:
                    raise ValueError(f"{what}: {name!r} cannot be one. {did_you_mean(name, known)}")
        if len(set(self.inputs)) < len(self.inputs):
            raise ValueError(f"inputs: {', '.join(self.inputs)}: one is given twice.")
        for name in ("speed", *self.inputs):  # there is a schedule of the speed alone, too
            if name not in self.domain:
                raise ValueError(f"domain: the lowest and highest value of {name!r} are missing.")
        for name, (low, high) in self.domain.items():
            if not low < high:
                raise ValueError(f"domain: {name} = [{low:g}, {high:g}]: need low < high.")
        return self

    def box(self, inputs: Sequence[str]) -> Array:
        """(D, 2) domain of some of the inputs, in their order."""
        return np.array([self.domain[name] for name in inputs])


class Evaluation(Record):
    """What the schedulers are judged by."""

    conditions: int = Field(default=2000, ge=8)
    drives: int = Field(default=1000, ge=8)
    seed: int = Field(default=7, ge=0, description="of the conditions, and which drives")


class AdaptationConfig(Record):
    """The whole chain."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", description="what the files are called")
    description: str = ""
    campaign: str = Field(description="name, or .toml file beside this one; its conditions must be a Sobol sample")
    seed: int = Field(default=0, ge=0, description="of the learning")
    learning: Learning
    evaluation: Evaluation = Evaluation()


def list_adaptations() -> dict[str, str]:
    """The configurations that `load_adaptation` knows by name, each with one line of description."""
    return {path.stem: str(read_toml(path).get("description", "")) for path in sorted(_DATA.glob("*.toml"))}


def load_adaptation(name_or_path: str | os.PathLike[str]) -> AdaptationConfig:
    """The named configuration, or the one in a TOML file (keys: the fields of `AdaptationConfig`).

    Raises
    ------
    UnknownName
        When nothing has this name.
    StorageError
        When the file cannot be read.
    ConfigError
        When it holds an unknown, missing or impossible value.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = _DATA / f"{name_or_path}.toml"
        if not path.exists():
            raise UnknownName(
                f"no adaptation is named {str(name_or_path)!r}. {did_you_mean(str(name_or_path), list_adaptations())} "
                "A file is given by its .toml path."
            )
    data = {"name": path.stem, **read_toml(path)}
    if str(data.get("campaign", "")).endswith(".toml"):
        data["campaign"] = str(path.parent / data["campaign"])
    return build(AdaptationConfig, data, path)


@dataclass(frozen=True, eq=False)
class Adapted:
    """What the chain made."""

    schedules: Mapping[str, Schedule]
    """by rung, see `_Bench.rungs`"""
    histories: Mapping[str, list[dict[str, float]]]
    conditions: Mapping[str, Ladder]
    """by how friction and wind are known, "exact" first"""
    drives: Mapping[str, Ladder]
    tests: Mapping[str, Ladder]
    """the paper's two"""


@dataclass(frozen=True, eq=False)
class Workshop:
    """Everything that the stages share."""

    config: AdaptationConfig
    campaign: CampaignConfig
    plan: Plan
    """of the campaign"""
    plant: SingleTrack | DualTrack
    mpc: MPC

    @classmethod
    def of(cls, config: AdaptationConfig) -> Workshop:
        """The workshop of a configuration.

        Raises
        ------
        InvalidInput
            When the campaign's conditions are not a Sobol sample of a box, or it tunes on other runs than lane changes
            of the usual length and price, which are what is learned from and judged by.
        """
        campaign = load_campaign(config.campaign)
        if not isinstance(campaign.operating_points, Sobol):
            raise InvalidInput(f"campaign {campaign.name!r}: its conditions must be a Sobol sample of a box.")
        usual = campaign.replace(scenario="lane-change", duration=None, move_price=None).settled()
        for key in ("scenario", "duration", "move_price"):
            if getattr(campaign.settled(), key) != getattr(usual, key):
                raise InvalidInput(
                    f"campaign {campaign.name!r}: {key} = {getattr(campaign.settled(), key)!r}: must be "
                    f"{getattr(usual, key)!r}, as in what schedulers learn from and are judged by."
                )
        plan = Plan.of(campaign)
        setup = plan.setup
        body = SingleTrack if campaign.plant == "single-track" else DualTrack
        plant = body(setup.vehicle, setup.tyre)
        return cls(config, campaign, plan, plant, controller(setup.vehicle, campaign.profile))

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """The operating domain."""
        conditions = self.campaign.operating_points
        assert isinstance(conditions, Sobol)
        box: Box = conditions.box
        return {"speed": box.speed, "y_ref": box.y_ref, "friction": box.friction, "wind": box.wind}

    def identity(self, stage: str) -> str:
        """What a stage's result depends on."""
        settings = self.config.model_dump(mode="json", include={"seed", "learning"})
        text = json.dumps([stage, settings, self.plan.identity, _METHOD])
        return hashlib.sha256(text.encode()).hexdigest()

    def unseen(self, count: int, seed: int) -> Array:
        """(count, 4) the conditions of an evaluation.

        Raises
        ------
        InvalidInput
            When the seed makes them conditions that something was tuned on or learned from.
        """
        conditions = self.campaign.operating_points
        assert isinstance(conditions, Sobol)
        if FIRST_EVALUATION_SEED + seed in (conditions.seed, *(first + self.config.seed for first in _SEEDS)):
            raise InvalidInput(f"seed = {seed}: these conditions were learned from: choose another.")
        return sobol(count, self.box, seed=FIRST_EVALUATION_SEED + seed)

    # -- what is learned from, and what it is judged by
    def courses(self) -> list[tuple[Course, int]]:
        """Lane changes, drives and hard drives, each with how many of them a round of learning drives."""
        asked, profile, first = self.config.learning, self.campaign.profile, FIRST_TRAINING_DRIVE
        conditions = sobol(asked.conditions, self.box, seed=_SEEDS[0] + self.config.seed)
        lane_changes = condition_course(self.plant, self.mpc, conditions, profile)
        drives = drive_course(self.plant, self.mpc, first, asked.drives, 30.0, profile)
        hard = drive_course(self.plant, self.mpc, first + 500_000, asked.hard_drives, 30.0, profile, options=HARD)
        return [
            (lane_changes, min(512, asked.conditions)),
            (drives, min(256, asked.drives)),
            (hard, min(128, asked.hard_drives)),
        ]

    def held_out(self) -> list[Course]:
        """Lane changes and drives that choose which round of the learning is kept."""
        conditions = sobol(HELD_OUT_CONDITIONS, self.box, seed=_SEEDS[1] + self.config.seed)
        return [
            condition_course(self.plant, self.mpc, conditions, self.campaign.profile),
            drive_course(self.plant, self.mpc, FIRST_HELD_OUT_DRIVE, HELD_OUT_DRIVES, 60.0, self.campaign.profile),
        ]

    def surfaces(self, model: str, courses: list[tuple[Course, int]], inputs: tuple[str, ...]) -> dict[str, Surface]:
        """Where the learning starts: the same tuning everywhere."""
        domain = self.config.learning.box(inputs)
        seed = self.config.seed
        if model == "nn":
            return {
                slot: NetworkSurface.start(domain, value, span, seed=10 * seed + i)
                for i, (slot, (value, span)) in enumerate(_STEPS.items())
            }
        columns = [SchedulingVariables._fields.index(name) for name in inputs]
        seen = np.concatenate(
            [course.seen[:, ::40].reshape(-1, len(SchedulingVariables._fields)) for course, _ in courses]
        )
        rng = np.random.default_rng((seed, 0xF522))
        rows = np.clip(seen[np.sort(rng.choice(len(seen), 6000))][:, columns], *domain.T)
        made = FuzzySurface.start(rows, 0.0, self.config.learning.rules, seed)
        return {slot: made.level(value) for slot, (value, _) in _STEPS.items()}


def adapt(
    config: AdaptationConfig,
    out: str | os.PathLike[str],
    *,
    workers: int | None = None,
    progress: Progress | None = None,
) -> Adapted:
    """Run the whole chain in a folder.

    Raises
    ------
    InvalidInput
        When the configuration makes no sense, see `Workshop.of`.
    StorageError
        When the folder cannot be written, or holds something damaged.
    """
    folder = Path(out)
    shop = Workshop.of(config)
    shop.unseen(1, config.evaluation.seed)  # before any work
    schedules, histories = learn(shop, folder, workers=workers, progress=progress)
    asked = config.evaluation
    return Adapted(
        schedules,
        histories,
        condition_ladder(shop, schedules, asked.conditions, asked.seed, knowledge=KNOWLEDGE, progress=progress),
        drive_ladder(shop, schedules, asked.drives, asked.seed, knowledge=KNOWLEDGE, progress=progress),
        test_ladders(shop, schedules),
    )


def shipped(name: str) -> dict[str, Schedule]:
    """The schedulers of an adaptation that ship with the package, by rung."""
    found = {each: load_scheduler(each) for each in list_schedulers() if each.startswith(f"{name}-")}
    return {each.name: each for file, each in found.items() if file == _file_name(name, each.name)}


def _file_name(adaptation: str, rung: str) -> str:
    return safe_name(f"{adaptation}-{rung.replace(' ', '-')}")


def learn(
    shop: Workshop, folder: Path, *, workers: int | None = None, progress: Progress | None = None
) -> tuple[dict[str, Schedule], dict[str, list[dict[str, float]]]]:
    """Every rung of the ladder but the optimum, each in its file under `schedulers`, and the learning's histories."""
    show = progress or (lambda what, done, of: None)
    bench = _Bench(shop, _campaign(shop, folder, workers, show), show)
    place = folder / "schedulers"
    place.mkdir(parents=True, exist_ok=True)
    for rung, make in bench.rungs().items():
        file = place / f"{_file_name(shop.config.name, rung)}.json"
        identity = shop.identity(rung)
        if not file.exists() or load_scheduler(file).provenance.get("stage") != identity:
            show(rung, 0, 1)
            made = make()
            replace(made, name=rung, provenance={**made.provenance, "stage": identity}).save(file)
        bench.made[rung] = load_scheduler(file)
    histories = {
        rung: list(each.provenance["history"]) for rung, each in bench.made.items() if "history" in each.provenance
    }
    return bench.made, histories


@dataclass(eq=False)
class _Bench:
    """Where the rungs are made, one after the other; what takes long to prepare is prepared when first asked for."""

    shop: Workshop
    dataset: DataSet
    show: Progress
    made: dict[str, Schedule] = field(default_factory=dict)
    """finished rungs"""

    @cached_property
    def courses(self) -> list[tuple[Course, int]]:
        return self.shop.courses()

    @cached_property
    def held_out(self) -> list[Course]:
        return self.shop.held_out()

    @cached_property
    def stability(self) -> StabilityMap:
        return stability_map(self.shop)

    @property
    def safe(self) -> Tuning:
        """The fallback."""
        return _tuning(np.array(self.made["fallback"](_ANYWHERE)))

    def rungs(self) -> dict[str, Callable[[], Schedule]]:
        """How each rung is made, in an order in which each finds those that it needs."""
        learned = self.shop.config.learning.inputs
        return {
            "best constant": partial(self.constant, 0),
            "best constant on drives": partial(self.constant, 1),
            "fallback": lambda: Constant(_safe_constant(self.courses[2][0], self.stability)),
            "speed look-up": partial(self.look_up, ["speed"], SPEED_NEIGHBOURS),
            "look-up": partial(self.look_up, NAMES, NEIGHBOURS),
            "speed only": partial(self.learned, "nn", ("speed",), "speed only"),
            "nn unguarded": partial(self.learned, "nn", learned, "nn"),
            "nn": partial(self.guarded, "nn unguarded"),
            "anfis unguarded": partial(self.learned, "anfis", learned, "anfis"),
            "anfis": partial(self.guarded, "anfis unguarded"),
            "paper recipe nn": lambda: scheduler(train(self.dataset, "nn", "paper"), self.dataset),
            "paper recipe anfis": lambda: scheduler(train(self.dataset, "anfis", "paper"), self.dataset),
        }

    def constant(self, course: int) -> Schedule:
        """The best constant tuning of one of the courses."""
        start = START.as_array().tolist()
        return Constant(_tuning(best_constant([(self.courses[course][0], 512)], start, seed=self.shop.config.seed)))

    def look_up(self, names: Sequence[str], neighbours: int) -> Schedule:
        """A table over some entries of the condition."""
        nodes = {name: np.linspace(*self.shop.box[name], _NODES[name]) for name in names}
        return neighbour_lookup(self.dataset, nodes, neighbours)

    def learned(self, model: str, inputs: tuple[str, ...], name: str) -> Schedule:
        """What learns from the landscape."""
        asked, seed = self.shop.config.learning, self.shop.config.seed
        made = improve(
            self.shop.surfaces(model, self.courses, inputs), inputs, asked.box(inputs), self.courses, self.held_out,
            rounds=asked.rounds, seed=seed, safe=self.safe, name=name,
            progress=lambda done, of: self.show(name, done, of),
        )  # fmt: skip
        return replace(made.schedule, provenance={"history": made.history})

    def guarded(self, bare: str) -> Schedule:
        """A finished rung behind the guard."""
        limits = {"slack": SLACK, "hold": HOLD, "offset_limit": OFFSET_LIMIT}
        schedule = self.made[bare]
        return replace(Guarded(schedule, self.safe, stability=self.stability, **limits), provenance=schedule.provenance)


def _campaign(shop: Workshop, folder: Path, workers: int | None, show: Progress) -> DataSet:
    place = folder / "campaign"
    finished = place / "dataset.parquet"
    if finished.exists():
        found = load_dataset(finished)
        if found.provenance.get("identity") == shop.plan.identity:
            return found

    def told_of(at: CampaignProgress) -> None:
        show("campaign", at.done, at.total)

    return load_dataset(run_campaign(shop.campaign, place, resume=place.exists(), workers=workers, progress=told_of))


def stability_map(shop: Workshop) -> StabilityMap:
    """The map that the guard asks: how near to instability the loop is, driving straight, with all that may be asked.

    Straight: in a turn as hard as driving gets, good tunings are near to instability too, and to keep away from that
    costs more than it saves (see docs/adaptation.md).
    """
    speed, friction = shop.box["speed"], shop.box["friction"]
    axes, values = loop_map(
        shop.plant, shop.mpc, shop.campaign.profile, speed=speed, friction=friction, turn=lambda v, mu: 0.0
    )
    values[axes[0] < SLOW] += SLOW_MARGIN
    return StabilityMap(Table(axes, values), NEARNESS)


def _safe_constant(course: Course, known: StabilityMap) -> Tuning:
    """Of the map's tunings that are far from instability at every speed and friction, one that loses hardly a drive.

    On hard drives: of those that lose at most one more than the fewest, the one that drives best.
    """
    nodes = np.meshgrid(*known.table.axes[2:], indexing="ij")
    far = known.table.values.max(axis=(0, 1)) <= FALLBACK_NEARNESS
    far &= (nodes[1] <= nodes[0]) & (nodes[2] >= 2.0)
    if not far.any():
        raise InvalidInput("no constant tuning keeps the loop away from instability over the whole domain.")
    candidates = np.column_stack([nodes[0][far], nodes[1][far], np.ones(far.sum()), 10.0 ** nodes[2][far]])

    def judged(rows: Array, count: int) -> tuple[NDArray[np.int64], Array]:
        """Lost drives and mean log cost of each tuning, on the first `count` drives."""
        costs = np.stack([course.drive(row, [1], np.arange(min(count, len(course))))[:, 0] for row in rows])
        return np.isinf(costs).sum(axis=1), np.log(np.minimum(costs, LOST_COST)).mean(axis=1)

    lost, cost = judged(candidates, 128)
    best = candidates[np.lexsort((cost, lost))[:16]]
    lost, cost = judged(best, len(course))
    return _tuning(best[np.argmin(np.where(lost <= lost.min() + 1, cost, np.inf))])


def _tuning(row: Array) -> Tuning:
    return Tuning(round(float(row[0])), round(float(row[1])), float(row[2]), float(row[3]))


def rungs_for(schedules: Mapping[str, Schedule], conditions: Array | None = None) -> dict[str, Policy]:
    """The rungs as they are driven; on `conditions`, what was learned from such is asked once, for the condition.

    There are two best constants, one for conditions and one for drives: on drives the latter is "best constant", and
    the former is driven too.
    """
    rungs: dict[str, Policy] = {"standard": Tuning(), **schedules}
    rungs.pop("fallback", None)
    on_drives = rungs.pop("best constant on drives", None)
    if conditions is not None:
        for rung in ("look-up", "paper recipe nn", "paper recipe anfis"):
            if rung in schedules:
                rungs[rung] = schedules[rung].batch(conditions)
    elif on_drives is not None:
        of_conditions = rungs.pop("best constant", None)
        if of_conditions is not None:
            rungs["best constant of conditions"] = of_conditions
        rungs["best constant"] = on_drives
    return rungs


def condition_ladder(
    shop: Workshop, schedules: Mapping[str, Schedule], count: int, seed: int, *, knowledge: Sequence[str] = ("exact",),
    progress: Progress | None = None,
) -> dict[str, Ladder]:  # fmt: skip
    """The ladder on `count` unseen conditions, for each way of knowing friction and wind (see `evaluate.road.told`).

    Sobol points of the campaign's box; every cost is the mean over eight noise seeds that nothing was tuned on.
    """
    profile, plant, mpc = shop.campaign.profile, shop.plant, shop.mpc
    rows = shop.unseen(count, seed)
    known_as = {name: told(name, plant, profile) for name in knowledge}
    constants = [schedules[rung](_ANYWHERE) for rung in ("best constant", "fallback") if rung in schedules]
    best = optimum(
        lambda seeds: objective(plant, mpc, seeds, profile), rows, shop.campaign.search.space(),
        swarm=shop.campaign.swarm, known=np.reshape(constants, (-1, 4)), seed=seed, progress=progress,
    )  # fmt: skip
    ladders = {}
    for name, known in known_as.items():
        course = condition_course(plant, mpc, rows, profile, known)
        rungs: dict[str, Policy] = {**rungs_for(schedules, rows), "optimum": best}
        if name != "exact":  # the others do not know what is told otherwise
            rungs = {rung: rungs[rung] for rung in (*TOLD_RUNGS, "optimum") if rung in rungs}
        ladders[name] = climb(course, rungs, EVALUATION_SEEDS, "optimum", rows, progress)
    return ladders


def drive_ladder(
    shop: Workshop, schedules: Mapping[str, Schedule], count: int, seed: int, *, knowledge: Sequence[str] = ("exact",),
    progress: Progress | None = None,
) -> dict[str, Ladder]:  # fmt: skip
    """The ladder on `count` random drives of 60 s that nothing was trained on; regret is to the best constant."""
    profile, plant, mpc, noise = shop.campaign.profile, shop.plant, shop.mpc, EVALUATION_SEEDS[:1]
    first = FIRST_EVALUATION_DRIVE + 10_000 * seed
    known_as = {name: told(name, plant, profile) for name in knowledge}
    _needs_constants(schedules)
    ladders = {}
    for name, known in known_as.items():
        course = drive_course(plant, mpc, first, count, 60.0, profile, known)
        rungs = rungs_for(schedules)
        if name == "exact":
            rungs["per-drive constant"] = per_run_best(course, _candidates(schedules), noise)
        else:  # the others do not know what is told otherwise
            rungs = {rung: rungs[rung] for rung in TOLD_RUNGS if rung in rungs}
        numbers = np.arange(first, first + count, dtype=float)[:, None]
        ladders[name] = climb(course, rungs, noise, "best constant", numbers, progress)
    return ladders


def test_ladders(shop: Workshop, schedules: Mapping[str, Schedule]) -> dict[str, Ladder]:
    """The ladder on the paper's two tests, in the campaign's profile."""
    _needs_constants(schedules)
    return {
        name: climb(
            paper_test(shop.plant, shop.mpc, name, shop.campaign.profile), rungs_for(schedules), EVALUATION_SEEDS,
            "best constant", np.zeros((1, 1)),
        )
        for name in PUBLISHED
    }  # fmt: skip


def _needs_constants(schedules: Mapping[str, Schedule]) -> None:
    if "best constant on drives" not in schedules:
        raise InvalidInput(
            "the best constant on drives, to which all is compared, is not among the schedulers: those of one's own "
            "configuration are files of `adaptrack adapt --out DIR`, given as --schedulers DIR/schedulers/*.json."
        )


def _candidates(schedules: Mapping[str, Schedule]) -> Array:
    """Tunings around the best constant on drives, for hindsight."""
    centre = np.array(schedules["best constant on drives"](_ANYWHERE))
    rows = [centre]
    for Np in (25.0, 30.0, 36.0, 44.0):
        for Nc in (3.0, 5.0, 8.0, 12.0):
            for ratio in (1e3, 2e3, 4e3, 8e3, 16e3, 32e3):
                rows.append(np.array([Np, Nc, 1.0, ratio]))
    return np.array(rows)
