"""From a configuration to schedulers that can be deployed: tune, learn, guard, certify, evaluate.

Every stage leaves its file in the folder; a chain that was interrupted goes on with the first stage that is missing.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from adaptrack.closed_loop import Course, Policy, improve
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
from adaptrack.learning.landscape import FuzzySurface, NetworkSurface, Surface
from adaptrack.learning.training import train
from adaptrack.metrics import PUBLISHED
from adaptrack.mpc import MPC, Condition, Tuning
from adaptrack.plant import DualTrack, SingleTrack
from adaptrack.schedule import Constant, Guarded, Schedule, StabilityMap, Table, list_schedulers, load_scheduler
from adaptrack.stability import loop_map
from adaptrack.toml_files import Record, build, read_toml
from adaptrack.tuning.campaign import Progress as CampaignProgress
from adaptrack.tuning.campaign import run_campaign
from adaptrack.tuning.conditions import sobol
from adaptrack.tuning.config import Box, CampaignConfig, Pair, Plan, Sobol, load_campaign

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

_DATA = Path(__file__).parent / "data" / "adaptations"
_STEPS = {"Np": (29.0, 10.0), "Nc": (5.0, 5.0), "log10_ratio": (3.6, 0.5)}
"""Where each output starts, and the scale of its changes."""
HELD_OUT_CONDITIONS, HELD_OUT_DRIVES = 512, 200
KNOWLEDGE = ("exact", "noisy", "lagged", "biased high", "biased low", "estimated", "withheld")
"""The ways of knowing friction and wind that are evaluated."""
NEARNESS, FALLBACK_NEARNESS, SLACK, HOLD = 0.97, 0.9, 1.0, 10
"""How near to instability a guarded loop may be, and its fallback anywhere in the domain; how far outside the domain an
input may be, in its widths; how many steps a fallback lasts."""
SLOW, SLOW_MARGIN = 6.0, 0.05
"""m/s, below which the map counts every loop as this much nearer: loops change fastest there, and its nodes are few."""
_ANYWHERE = Condition(15.0, 0.0, 0.7, 0.0)


def _tuples(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


class Learning(Record):
    """How the network and the fuzzy systems learn."""

    inputs: Annotated[tuple[str, ...], BeforeValidator(_tuples)] = Field(min_length=1, description="of `Condition`")
    domain: dict[str, Pair] = Field(description="lowest and highest value of each input")
    rounds: int = Field(default=60, ge=1, description="of improvement")
    conditions: int = Field(default=2048, ge=16, description="lane changes in a gust to learn from")
    drives: int = Field(default=1024, ge=8, description="random drives of 30 s")
    hard_drives: int = Field(default=1024, ge=8, description="fast ones near the limit")
    rules: int = Field(default=20, ge=2, description="of each fuzzy system")

    @model_validator(mode="after")
    def _has_a_domain(self) -> Self:
        for name in self.inputs:
            if name not in Condition._fields or name == "offset":
                raise ValueError(f"inputs: {name!r} cannot be one. {did_you_mean(name, Condition._fields[:-1])}")
            if name not in self.domain:
                raise ValueError(f"domain: the lowest and highest value of {name!r} are missing.")
            low, high = self.domain[name]
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
    """by rung: best constant, speed only, look-up, nn, anfis, paper recipe nn, paper recipe anfis"""
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
            When the campaign's conditions are not a Sobol sample of a box.
        """
        campaign = load_campaign(config.campaign)
        if not isinstance(campaign.conditions, Sobol):
            raise InvalidInput(f"campaign {campaign.name!r}: its conditions must be a Sobol sample of a box.")
        plan = Plan.of(campaign)
        setup = plan.setup
        body = SingleTrack if campaign.plant == "single-track" else DualTrack
        plant = body(setup.vehicle, setup.tyre)
        return cls(config, campaign, plan, plant, controller(setup.vehicle, campaign.profile))

    @property
    def box(self) -> dict[str, tuple[float, float]]:
        """The operating domain."""
        conditions = self.campaign.conditions
        assert isinstance(conditions, Sobol)
        box: Box = conditions.box
        return {"speed": box.speed, "y_ref": box.y_ref, "friction": box.friction, "wind": box.wind}

    def identity(self, stage: str) -> str:
        """What a stage's result depends on."""
        settings = self.config.model_dump(mode="json", exclude={"evaluation"})
        text = json.dumps([stage, settings, self.plan.identity])
        return hashlib.sha256(text.encode()).hexdigest()

    # -- what is learned from, and what it is judged by
    def courses(self) -> list[tuple[Course, int]]:
        """Lane changes, drives and hard drives, each with how many of them a round of learning drives."""
        asked, profile, first = self.config.learning, self.campaign.profile, FIRST_TRAINING_DRIVE
        conditions = sobol(asked.conditions, self.box, seed=100 + self.config.seed)
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
        conditions = sobol(HELD_OUT_CONDITIONS, self.box, seed=200 + self.config.seed)
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
        columns = [Condition._fields.index(name) for name in inputs]
        seen = np.concatenate([course.seen[:, ::40].reshape(-1, len(Condition._fields)) for course, _ in courses])
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
    found = [load_scheduler(each) for each in list_schedulers() if each.startswith(f"{name}-")]
    return {each.name: each for each in found}


def learn(
    shop: Workshop, folder: Path, *, workers: int | None = None, progress: Progress | None = None
) -> tuple[dict[str, Schedule], dict[str, list[dict[str, float]]]]:
    """Every rung of the ladder but the optimum, each in its file under `schedulers`, and the learning's histories."""
    show = progress or (lambda what, done, of: None)
    place = folder / "schedulers"
    place.mkdir(parents=True, exist_ok=True)
    dataset = _campaign(shop, folder, workers, show)
    courses: list[tuple[Course, int]] = []
    maps: list[StabilityMap] = []
    schedules: dict[str, Schedule] = {}

    def kept(rung: str, make: Callable[[], Schedule]) -> Schedule:
        file = place / f"{shop.config.name}-{rung.replace(' ', '-')}.json"
        identity = shop.identity(rung)
        if file.exists() and (found := load_scheduler(file)).provenance.get("identity") == identity:
            schedules[rung] = found
            return found
        made = make()
        made = replace(made, name=rung, provenance={**made.provenance, "identity": identity})
        made.save(file)
        schedules[rung] = made
        return made

    def all_courses() -> list[tuple[Course, int]]:
        if not courses:
            courses.extend(shop.courses())
        return courses

    def constant(on: Sequence[int], count: int = 512) -> Schedule:
        show("best constant", 0, 1)
        runs = [(all_courses()[i][0], count) for i in on]
        start = START.as_array().tolist()
        return Constant(_tuning(best_constant(runs, start, seed=shop.config.seed)))

    kept("best constant", lambda: constant([0]))
    kept("best constant on drives", lambda: constant([1]))

    def learned(model: str, inputs: tuple[str, ...], rung: str) -> Schedule:
        domain = shop.config.learning.box(inputs)
        made = improve(
            shop.surfaces(model, all_courses(), inputs), inputs, domain, all_courses(), shop.held_out(),
            rounds=shop.config.learning.rounds, seed=shop.config.seed, name=rung,
            progress=lambda done, of: show(rung, done, of),
        )  # fmt: skip
        return replace(made.schedule, provenance={"history": made.history})

    def guarded(made: Schedule) -> Schedule:
        if not maps:
            show("stability map", 0, 1)
            maps.append(stability_map(shop))
        safe = kept("fallback", lambda: Constant(_safe_constant(all_courses()[2][0], maps[0])))
        return replace(
            Guarded(made, _tuning(np.array(safe(_ANYWHERE))), stability=maps[0], slack=SLACK, hold=HOLD),
            provenance=made.provenance,
        )

    inputs = shop.config.learning.inputs
    kept("speed only", lambda: learned("nn", ("speed",), "speed only"))
    kept("look-up", lambda: neighbour_lookup(dataset, _nodes(shop.box)))
    for model in ("nn", "anfis"):
        bare = kept(f"{model} unguarded", lambda model=model: learned(model, inputs, model))  # type: ignore[misc]
        kept(model, lambda bare=bare: guarded(bare))  # type: ignore[misc]
    for model in ("nn", "anfis"):
        kept(f"paper recipe {model}", lambda model=model: scheduler(train(dataset, model, "paper"), dataset))  # type: ignore[misc]
    histories = {
        rung: list(each.provenance["history"]) for rung, each in schedules.items() if "history" in each.provenance
    }
    return schedules, histories


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
    """Of the map's tunings that are far from instability at every speed and friction, the one that drives best.

    On hard drives; to lose one is worse than any cost.
    """
    nodes = np.meshgrid(*known.table.axes[2:], indexing="ij")
    far = known.table.values.max(axis=(0, 1)) <= FALLBACK_NEARNESS
    far &= (nodes[1] <= nodes[0]) & (nodes[2] >= 2.0)
    if not far.any():
        raise InvalidInput("no constant tuning keeps the loop away from instability over the whole domain.")
    candidates = np.column_stack([nodes[0][far], nodes[1][far], np.ones(far.sum()), 10.0 ** nodes[2][far]])
    which = np.arange(min(256, len(course)))
    found = [course.drive(row, [1], which)[:, 0] for row in candidates]
    scores = [np.log(np.where(np.isfinite(costs), costs, 1e9)).mean() for costs in found]
    return _tuning(candidates[int(np.argmin(scores))])


def _tuning(row: Array) -> Tuning:
    return Tuning(round(float(row[0])), round(float(row[1])), float(row[2]), float(row[3]))


def _nodes(box: Mapping[str, tuple[float, float]]) -> dict[str, Any]:
    counts = {"speed": 10, "y_ref": 7, "friction": 5, "wind": 5}
    return {name: np.linspace(*box[name], count) for name, count in counts.items()}


def rungs_for(schedules: Mapping[str, Schedule], conditions: Array | None = None) -> dict[str, Policy]:
    """The rungs as they are driven; on `conditions`, what was learned from such is asked once, for the condition."""
    asked_once = ("look-up", "paper recipe nn", "paper recipe anfis")
    rungs: dict[str, Policy] = {"standard": Tuning()}
    for rung, schedule in schedules.items():
        if rung in ("best constant on drives", "fallback"):
            continue
        rungs[rung] = schedule
        if conditions is not None and rung in asked_once:
            rungs[rung] = schedule.batch(conditions)
    if conditions is None and "best constant on drives" in schedules:
        rungs["best constant"] = schedules["best constant on drives"]
    return rungs


def condition_ladder(
    shop: Workshop, schedules: Mapping[str, Schedule], count: int, seed: int, *, knowledge: Sequence[str] = ("exact",),
    progress: Progress | None = None,
) -> dict[str, Ladder]:  # fmt: skip
    """The ladder on `count` unseen conditions, for each way of knowing friction and wind (see `evaluate.road.told`).

    Sobol points of the campaign's box; every cost is the mean over eight noise seeds that nothing was tuned on.
    """
    profile, plant, mpc = shop.campaign.profile, shop.plant, shop.mpc
    rows = sobol(count, shop.box, seed=10_000 + seed)
    constant = [schedule(_ANYWHERE) for rung, schedule in schedules.items() if rung == "best constant"]
    best = optimum(
        lambda seeds: objective(plant, mpc, seeds, profile), rows, shop.campaign.search.space(),
        swarm=shop.campaign.swarm, known=np.reshape(constant, (-1, 4)), seed=seed, progress=progress,
    )  # fmt: skip
    ladders = {}
    for name in knowledge:
        course = condition_course(plant, mpc, rows, profile, told(name, plant, profile))
        rungs: dict[str, Policy] = {**rungs_for(schedules, rows), "optimum": best}
        if name != "exact":  # the others do not know what is told otherwise
            rungs = {rung: rungs[rung] for rung in ("best constant", "nn", "anfis", "optimum") if rung in rungs}
        ladders[name] = climb(course, rungs, EVALUATION_SEEDS, "optimum", rows, progress)
    return ladders


def drive_ladder(
    shop: Workshop, schedules: Mapping[str, Schedule], count: int, seed: int, *, knowledge: Sequence[str] = ("exact",),
    progress: Progress | None = None,
) -> dict[str, Ladder]:  # fmt: skip
    """The ladder on `count` random drives of 60 s that nothing was trained on; regret is to the best constant."""
    profile, plant, mpc, noise = shop.campaign.profile, shop.plant, shop.mpc, EVALUATION_SEEDS[:1]
    first = FIRST_EVALUATION_DRIVE + 10_000 * seed
    ladders = {}
    for name in knowledge:
        course = drive_course(plant, mpc, first, count, 60.0, profile, told(name, plant, profile))
        rungs = rungs_for(schedules)
        if name == "exact":
            rungs["per-drive constant"] = per_run_best(course, _candidates(schedules), noise)
        numbers = np.arange(first, first + count, dtype=float)[:, None]
        ladders[name] = climb(course, rungs, noise, "best constant", numbers, progress)
    return ladders


def test_ladders(shop: Workshop, schedules: Mapping[str, Schedule]) -> dict[str, Ladder]:
    """The ladder on the paper's two tests, in the campaign's profile."""
    return {
        name: climb(
            paper_test(shop.plant, shop.mpc, name, shop.campaign.profile), rungs_for(schedules), EVALUATION_SEEDS,
            "best constant", np.zeros((1, 1)),
        )
        for name in PUBLISHED
    }  # fmt: skip


def _candidates(schedules: Mapping[str, Schedule]) -> Array:
    """Tunings around the best constant on drives, for hindsight."""
    centre = np.array(schedules["best constant on drives"](_ANYWHERE))
    rows = [centre]
    for Np in (25.0, 30.0, 36.0, 44.0):
        for Nc in (3.0, 5.0, 8.0, 12.0):
            for ratio in (1e3, 2e3, 4e3, 8e3, 16e3, 32e3):
                rows.append(np.array([Np, Nc, 1.0, ratio]))
    return np.array(rows)
