"""The experiment of the paper's section V: its controllers and further comparators on both of its tests.

Two configurations answer two questions. `released` is what the authors published: a single track with the tyre of
constant stiffness, Laguerre moves with the pole 0.95 for the standard MPC and 0.75 for the adaptive ones, and their
clamps on what the learned functions say. `same-moves` is what the paper describes: the dual track on the Magic Formula
tyre and the moves of eq. (10) for everybody, so that the controllers differ in their tuning only.

The ablation separates the pole's part of the gain from adaptation's; `informed` adds an MPC with a model of its
steering.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.base.result import strict
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC, Moves, Tuning, published_mpc
from adaptrack.control.scheduling import ENTRIES, Lookup, Schedule, SchedulingVariables, load_scheduler
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.metrics import PAPER_MSE, compute_metrics, published_mse
from adaptrack.drive.simulate import rollout, simulate
from adaptrack.drive.trajectory import Trajectory
from adaptrack.paper.data_set import DataSet, load_dataset
from adaptrack.paper.operating_points import POINT_NAMES
from adaptrack.paper.training import search_bounds, train, trained_schedule
from adaptrack.scenario import Scenario, load_scenario
from adaptrack.scenario.profile import load_profile

Row = dict[str, Any]

PAPER_TESTS = tuple(PAPER_MSE)
"""The scenarios for which the paper gives mean square errors."""

DRIVEN_ON = FailureLimits(distance=1000.0, sideslip=math.inf)
"""The paper's runs end only where nothing is left to drive; whether one failed is judged afterwards, as everywhere."""

RELATIVE_TIE = 1e-9
"""Relative: MSEs that differ by less are equal; a tuning of the library may be the one that it is held against."""
LEARNED_MODELS = ("nn", "anfis")

PAPER_TABLE = Tuning()
"""The paper's table, 35/8/10/0.01."""

STANDARD_MOVES, ADAPTIVE_MOVES, PULSE_MOVES = Moves.laguerre(0.95), Moves.laguerre(0.75), Moves.pulses()
"""What the authors' standard and adaptive controllers move by, and eq. (10)."""

CLAMPS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "nn": dict(zip(ENTRIES, ((9, math.inf), (5, math.inf), (0.75, 10.0), (0.01, 0.5)), strict=True)),
    "anfis": dict(zip(ENTRIES, ((20, 55), (1, 25), (0.75, 20.0), (0.005, 0.8)), strict=True)),
}
"""Bounds that the authors' programs put on the outputs of each model; infinite where they put none."""

INFORMED_PROFILES = ("paper", "road")
"""Profiles in which the informed MPC is compared: ideal; with steering lag, rate limit, sensor noise and delay."""
REPRODUCE_SEEDS = range(10)
"""Noise seeds, in a profile with sensor noise."""
ROAD_CONSTANT = Tuning(28, 6, 1.0, 3476.378659166587)
"""The best constant tuning of the paper's MPC on random drives in profile `road`."""
ROAD_SCHEDULE = "road-nn"
"""The shipped schedule of the paper's MPC that was learned in profile `road`."""

EXPERIMENT_STAGES = (
    "training nn", "training anfis", "driving both configurations", "splitting the gain",
    "driving the informed controller", "timing steps",
)  # fmt: skip

QUICK_OPTIONS: Mapping[str, Mapping[str, Any]] = {"nn": {"epochs": 100}, "anfis": {"epochs": 5}}
QUICK_ROWS = 1500
"""A quick run trains for fewer epochs, and on fewer operating points, chosen at random."""


@dataclass(frozen=True)
class BestConstant:
    """The one tuning of a data set's library that is best on average."""

    tuning: Tuning
    cost: float
    """m², geometric mean of its cost over the operating points"""
    standard_cost: float
    """m², likewise for the paper's table"""
    swarm_cost: float
    """m², likewise for the best tuning that a swarm found on each of them: what perfect adaptation would cost"""
    failed: int
    """operating points on which it fails; the means are over those where none of the three does"""
    candidates: int
    runs: int
    """closed-loop runs behind the choice"""
    swarm_runs: int
    """closed-loop runs of the swarms"""


@dataclass(frozen=True, eq=False)
class PaperController:
    """A controller of the paper's comparison: a tuning or a schedule, and how it moves."""

    name: str
    moves: Moves
    tuning: Tuning = PAPER_TABLE
    schedule: Schedule | None = None
    stands_for: str = ""
    """the controller of the paper that it repeats: standard, nn or anfis; empty for none"""

    def mpc(self, preview: bool, period: float = 0.1) -> MPC:
        """The controller itself, at the start of a run; period: s."""
        most = 20 if self.schedule is None else max(20, self.schedule.largest[1])
        return published_mpc(
            load_vehicle("paper"), self.tuning, period=period, moves=self.moves, preview=preview,
            scheduler=self.schedule, most_moves=most,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Configuration:
    """A plant and what is compared on it."""

    name: str
    plant: Plant
    controllers: tuple[PaperController, ...]


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All that `reproduce` measured; the lists are rows of plain JSON values, None for what is not finite or absent."""

    rows: list[Row]
    """a closed-loop run each: configuration, scenario, controller, plant, vehicle, profile, seed, preview, moves,
    paper_mse, ratio (to the paper), clipped_share (of the steps, with a scheduler's input outside its domain), and all
    of `Metrics`"""
    ablation: list[Row]
    """scenario, moves, controller, adapts, mse, failed, constants_better (tunings of the library with a lower MSE)"""
    shares: list[Row]
    """scenario, controller, gain (standard MSE over its own), pole, adaptation (factors of the gain), pole_share,
    adaptation_share (of its logarithm)"""
    swaps: list[Row]
    """scenario, changed, table, constant (its value there), mse: the paper's table with one
    number of the best constant, where all have the same moves"""
    knowing: list[Row]
    """the informed MPC beside the paper's controllers, see `drive_informed`"""
    learning: list[Row]
    """a learned function each: see `training.Trained.quality`"""
    domain: list[Row]
    """scenario, then the share of the steps at which each input is outside the domain of the data"""
    constant: BestConstant
    runs: list[tuple[str, Trajectory]]
    """standard, nn and anfis with their step times: the released configuration without preview"""
    data: str
    """name of the data set"""
    data_test: str
    """the scenario on which its tunings were judged"""
    learned_from: int
    """operating points behind the learned functions, those held out included"""
    operating_points: int
    """of the data set"""
    quick: bool
    seconds: float
    training_seconds: float

    def as_json(self) -> Row:
        """Everything but the trajectories."""
        values = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "runs"}
        return values | {"constant": dataclasses.asdict(self.constant)}


# -- comparators from the data set -----------------------------------------------------------------------------------
def best_of_library(dataset: DataSet) -> BestConstant:
    """The tuning of the library with the lowest geometric mean of its cost over all operating points.

    One that fails on fewer of them always comes first.
    """
    landscape = dataset.landscape.astype(np.float64)
    is_finite = np.isfinite(landscape)
    with np.errstate(divide="ignore"):
        mean_log = np.where(is_finite, portable.log(landscape), 0.0).sum(axis=0) / np.maximum(is_finite.sum(axis=0), 1)
    best = int(np.lexsort((mean_log, -is_finite.sum(axis=0)))[0])
    Np, Nc, Q, R = dataset.library[best].tolist()
    costs = np.column_stack((landscape[:, best], dataset.standard_costs, dataset.costs))
    cost, standard, swarm = portable.exp(portable.log(costs[np.isfinite(costs).all(axis=1)]).mean(axis=0)).tolist()
    computed = int(dataset.computed.sum())
    return BestConstant(
        tuning=Tuning(int(Np), int(Nc), Q, R),
        cost=cost,
        standard_cost=standard,
        swarm_cost=swarm,
        failed=int((~is_finite[:, best]).sum()),
        candidates=len(dataset.library),
        runs=computed * len(dataset.library),
        swarm_runs=int(dataset.evaluations[dataset.computed].sum()),
    )


def grid_lookup(dataset: DataSet) -> Schedule:
    """A table of the best tunings found, between the operating points; `InvalidInput` where these fill no grid."""
    nodes, places = zip(*(np.unique(column, return_inverse=True) for column in dataset.operating_points.T), strict=True)
    sizes = tuple(map(len, nodes))
    if not len(dataset) == math.prod(sizes) == np.unique(np.ravel_multi_index(places, sizes)).size:
        raise InvalidInput(
            f"data set {dataset.name!r}: its {len(dataset)} operating points do not fill a grid, which a look-up table "
            "needs."
        )
    tunings = np.empty((*sizes, len(ENTRIES)))
    tunings[places] = dataset.tunings
    return Lookup(dict(zip(POINT_NAMES, nodes, strict=True)), tunings)


# -- the experiment ---------------------------------------------------------------------------------------------------
@reports_progress("reproduce")
def reproduce(
    dataset: DataSet | None = None, *, quick: bool = False, seed: int = 0, progress: ProgressCall | None = None
) -> Reproduction:
    """Train both models on a data set, drive both tests with every controller, split the gain into its parts.

    dataset: by default `paper-grid`; its operating points must fill a grid; quick: train less, see `QUICK_OPTIONS`;
    seed: of the hold-out and of the models; progress: called with (stage, stages done, stages).

    Raises
    ------
    InvalidInput
        When the data set does not fit, see `grid_lookup` and `search_bounds`.
    """
    begun = time.perf_counter()
    dataset = load_dataset("paper-grid") if dataset is None else dataset
    search_bounds(dataset)
    constant, table = best_of_library(dataset), grid_lookup(dataset)
    source = dataset
    if quick and len(dataset) > QUICK_ROWS:
        source = dataset.rows(np.sort(np.random.default_rng(seed).permutation(len(dataset))[:QUICK_ROWS]))

    def enter(stage: int) -> None:
        if progress is not None:
            progress(EXPERIMENT_STAGES[stage], stage, len(EXPERIMENT_STAGES))

    free, learning = {}, []
    for stage, model in enumerate(LEARNED_MODELS):
        enter(stage)
        trained = train(source, model, "paper", seed=seed, **(QUICK_OPTIONS[model] if quick else {}))
        free[model] = trained_schedule(trained, dataset)
        learning += trained.quality
    training_seconds = time.perf_counter() - begun
    clamped = {model: _within(schedule, CLAMPS[model]) for model, schedule in free.items()}
    scenarios = [load_scenario(name) for name in PAPER_TESTS]
    released, same_moves = configurations(constant.tuning, table, clamped, free)
    enter(2)
    rows = [
        measure(configuration, controller, scenario, preview)
        for configuration in (released, same_moves)
        for scenario in scenarios
        for controller in configuration.controllers
        for preview in (False, True)
    ]
    enter(3)
    parts = ablation(released.plant, scenarios, constant.tuning, clamped, dataset.library)
    swapped = swaps(same_moves.plant, scenarios, constant.tuning)
    enter(4)
    informed = drive_informed(scenarios, clamped)
    enter(5)
    runs = [
        (controller.stands_for, drive(released.plant, controller, scenario, timed=True))
        for scenario in scenarios
        for controller in released.controllers
        if controller.stands_for
    ]
    return Reproduction(
        rows=rows,
        ablation=parts,
        shares=shares(parts),
        swaps=swapped,
        knowing=informed,
        learning=learning,
        domain=[
            {"scenario": run.name_of("scenario"), **outside(run, free["nn"])} for name, run in runs if name == "nn"
        ],
        constant=constant,
        runs=runs,
        data=dataset.name,
        data_test=str(dataset.provenance["settings"].get("scenario", "")),
        learned_from=len(source),
        operating_points=len(dataset),
        quick=quick,
        seconds=time.perf_counter() - begun,
        training_seconds=training_seconds,
    )


def _within(schedule: Schedule, clamps: Mapping[str, tuple[float, float]]) -> Schedule:
    entries = dict(schedule.tuning)
    for name, (low, high) in clamps.items():
        entry = entries[name]
        entries[name] = dataclasses.replace(
            entry, low=low if math.isfinite(low) else entry.low, high=high if math.isfinite(high) else entry.high
        )
    return dataclasses.replace(schedule, tuning=entries)


def configurations(
    constant: Tuning, table: Schedule, clamped: Mapping[str, Schedule], free: Mapping[str, Schedule]
) -> tuple[Configuration, Configuration]:
    """`released` and `same-moves`; clamped, free: the learned schedules with and without the authors' clamps."""

    def compared(standard: str, moves: Moves, schedules: Mapping[str, Schedule]) -> tuple[PaperController, ...]:
        standards = {"standard-as-released": STANDARD_MOVES, "standard-as-written": PULSE_MOVES}
        return (
            *(
                PaperController(name, standard_moves, stands_for="standard" if name == standard else "")
                for name, standard_moves in standards.items()
            ),
            PaperController("best-constant", moves, constant),
            PaperController("lookup", moves, schedule=table),
            *(PaperController(model, moves, schedule=schedules[model], stands_for=model) for model in LEARNED_MODELS),
        )

    car = load_vehicle("paper")
    as_released = compared("standard-as-released", ADAPTIVE_MOVES, clamped)
    as_written = compared("standard-as-written", PULSE_MOVES, free)
    return (
        Configuration("released", SingleTrack(car, "constant-stiffness"), as_released),
        Configuration("same-moves", DualTrack(car, "magic-formula"), as_written),
    )


def drive(
    plant: Plant, controller: PaperController, scenario: Scenario, preview: bool = False, timed: bool = False
) -> Trajectory:
    """One run, in the paper profile at exactly the scenario's speed; timed: from Python, with its step times."""
    run = (simulate if timed else rollout)(plant, controller.mpc(preview), scenario, failure=DRIVEN_ON)
    name = f"{controller.stands_for or controller.name} ({describe_moves(controller.moves)})"
    return dataclasses.replace(run, meta={**run.meta, "controller": name})


def describe_moves(moves: Moves) -> str:
    """How tables call them: pulse, laguerre 0.95."""
    return "pulse" if moves.kind == "pulse" else f"laguerre {moves.pole:g}"


def measure(configuration: Configuration, controller: PaperController, scenario: Scenario, preview: bool) -> Row:
    """A run as a row, see `Reproduction.rows`."""
    run = drive(configuration.plant, controller, scenario, preview)
    measures = compute_metrics(run)
    published = published_mse(run)
    schedule = controller.schedule
    return {
        "configuration": configuration.name,
        "scenario": scenario.name,
        "controller": controller.name,
        "plant": run.name_of("plant"),
        "vehicle": run.name_of("vehicle"),
        "profile": run.meta["profile"],
        "seed": run.meta["seed"],
        "preview": preview,
        "moves": describe_moves(controller.moves),
        "paper_mse": published,
        "ratio": None if published is None else strict(measures.mse / published),
        "clipped_share": None if schedule is None else outside(run, schedule)["any"],
        **measures.as_row(),
    }


def outside(run: Trajectory, schedule: Schedule) -> dict[str, float]:
    """Share of the driven steps at which each input of `schedule` is outside its domain, by name; `any` of them."""
    variables = dict(
        zip(SchedulingVariables._fields, (run.vx, run.y_ref, run.friction.mean(axis=1), run.wind[:, 1]), strict=False)
    )
    inputs = np.column_stack([variables[name] for name in schedule.inputs])[np.isfinite(run.command)]
    clipped = (inputs < schedule.domain[:, 0]) | (inputs > schedule.domain[:, 1])
    by_input = dict(zip(schedule.inputs, clipped.mean(axis=0).tolist(), strict=True))
    return by_input | {"any": float(clipped.any(axis=1).mean())}


def ablation(
    plant: Plant, scenarios: Iterable[Scenario], constant: Tuning, schedules: Mapping[str, Schedule], library: Array
) -> list[Row]:
    """Every kind of moves with every way to tune, without preview; see `Reproduction.ablation`.

    `best-in-hindsight` is the tuning of the library (T, 4) that happens to be the best on that very run.
    """
    rows: list[Row] = []
    for scenario in scenarios:
        for moves in (STANDARD_MOVES, ADAPTIVE_MOVES, PULSE_MOVES):
            controllers = [
                PaperController("table-constant", moves),
                PaperController("best-constant", moves, constant),
                *(PaperController(name, moves, schedule=schedule) for name, schedule in schedules.items()),
            ]
            mpc = controllers[0].mpc(preview=False)
            by_constants = rollout_batch(plant, mpc, scenario, library, failure=DRIVEN_ON).mse
            results = [compute_metrics(drive(plant, controller, scenario)) for controller in controllers]
            outcomes = [
                (controller.name, controller.schedule is not None, measures.mse, measures.failed)
                for controller, measures in zip(controllers, results, strict=True)
            ]
            hindsight = float(by_constants.min())
            rows += [
                {
                    "scenario": scenario.name,
                    "moves": describe_moves(moves),
                    "controller": name,
                    "adapts": adapts,
                    "mse": strict(mse),
                    "failed": failed,
                    "constants_better": int((by_constants < (1.0 - RELATIVE_TIE) * mse).sum()),
                }
                for name, adapts, mse, failed in [
                    *outcomes, ("best-in-hindsight", False, hindsight, not math.isfinite(hindsight)),
                ]
            ]  # fmt: skip
    return rows


def swaps(plant: Plant, scenarios: Iterable[Scenario], constant: Tuning) -> list[Row]:
    """Which number of `constant` makes it track unlike the paper's table, see `Reproduction.swaps`."""
    ratio, best = PAPER_TABLE.R / PAPER_TABLE.Q, constant.R / constant.Q
    changes = {
        "Np": (PAPER_TABLE.Np, constant.Np, dataclasses.replace(PAPER_TABLE, Np=max(constant.Np, PAPER_TABLE.Nc))),
        "Nc": (PAPER_TABLE.Nc, constant.Nc, dataclasses.replace(PAPER_TABLE, Nc=min(constant.Nc, PAPER_TABLE.Np))),
        "R/Q": (ratio, best, dataclasses.replace(PAPER_TABLE, R=best * PAPER_TABLE.Q)),
    }
    return [
        {
            "scenario": scenario.name,
            "changed": name,
            "table": table,
            "constant": value,
            "mse": strict(compute_metrics(drive(plant, PaperController(name, PULSE_MOVES, tuning), scenario)).mse),
        }
        for scenario in scenarios
        for name, (table, value, tuning) in changes.items()
    ]


def shares(ablation: Sequence[Row]) -> list[Row]:
    """How the gain of each learned controller over the standard MPC splits into pole and adaptation.

    From pole 0.95 with the table's constants to pole 0.75 with adaptation there are two ways: the pole first, or
    adaptation first. Each factor is the geometric mean of what its step brings on the two ways; so pole times
    adaptation is the gain, and the shares of its logarithm add up to one.
    """
    slow, fast = describe_moves(STANDARD_MOVES), describe_moves(ADAPTIVE_MOVES)
    rows: list[Row] = []
    for scenario in dict.fromkeys(row["scenario"] for row in ablation):
        mse = {(row["moves"], row["controller"]): row["mse"] for row in ablation if row["scenario"] == scenario}
        for name in LEARNED_MODELS:
            corners = [mse[slow, "table-constant"], mse[fast, "table-constant"], mse[slow, name], mse[fast, name]]
            row: Row = {"scenario": scenario, "controller": name}
            if any(not corner for corner in corners):  # a run that ended early has no MSE
                parts = dict.fromkeys(("gain", "pole", "adaptation", "pole_share", "adaptation_share"))
            else:
                standard, pole_only, adapted_only, both = map(portable.log, corners)
                pole = (standard - pole_only + adapted_only - both) / 2.0
                adaptation = (standard - adapted_only + pole_only - both) / 2.0
                gain = pole + adaptation
                parts = {
                    "gain": portable.exp(gain),
                    "pole": portable.exp(pole),
                    "adaptation": portable.exp(adaptation),
                    "pole_share": pole / gain if gain else None,
                    "adaptation_share": adaptation / gain if gain else None,
                }
            rows.append(row | parts)
    return rows


def drive_informed(scenarios: Iterable[Scenario], schedules: Mapping[str, Schedule]) -> list[Row]:
    """The MPC with a model of its steering and an estimator beside the paper's controllers, on both tests.

    The car is the one that the paper describes, in each of `INFORMED_PROFILES`; each controller runs at the period and
    with the preview of the profile. schedules: of the paper's models, as released.

    A row for each profile, test and controller: profile, scenario, controller, period (s), preview; runs (one, or one
    for each noise seed), failed (number of runs), mse (m^2, mean over the runs that did not fail, None if all failed)
    and rms_rate (rad/s, of the command, likewise).
    """
    rows: list[Row] = []
    car = load_vehicle("paper")
    plant = DualTrack(car, "magic-formula")
    for profile in map(load_profile, INFORMED_PROFILES):
        seeds = np.array(REPRODUCE_SEEDS if any(profile.noise) else REPRODUCE_SEEDS[:1])
        controllers = [
            PaperController("standard-as-written", PULSE_MOVES),
            PaperController("standard-as-released", STANDARD_MOVES),
            *(PaperController(name, ADAPTIVE_MOVES, schedule=schedule) for name, schedule in schedules.items()),
        ]
        if profile.name == "road":
            controllers.append(PaperController("road-constant", PULSE_MOVES, ROAD_CONSTANT))
            controllers.append(PaperController("road-nn", PULSE_MOVES, schedule=load_scheduler(ROAD_SCHEDULE)))
        by_name = {controller.name: controller.mpc(profile.preview, profile.period) for controller in controllers}
        by_name["informed"] = MPC(car, profile=profile)
        for scenario in scenarios:
            for name, mpc in by_name.items():
                indices = np.zeros(len(seeds), int)
                runs = rollout_batch(plant, mpc, scenario, scenario_indices=indices, profile=profile, seeds=seeds)
                ended = np.array([reason is None for reason in runs.failed])
                rows.append({
                    "profile": profile.name,
                    "scenario": scenario.name,
                    "controller": name,
                    "period": mpc.period,
                    "preview": mpc.preview,
                    "runs": len(seeds),
                    "failed": int((~ended).sum()),
                    "mse": float(runs.mse[ended].mean()) if ended.any() else None,
                    "rms_rate": math.sqrt(runs.mean_squared_move[ended].mean()) / mpc.period if ended.any() else None,
                })  # fmt: skip
    return rows
