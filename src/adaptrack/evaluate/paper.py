"""The paper's section V run again: its controllers and the comparators that it left out, on both of its tests.

Two configurations answer two questions. `released` is what the authors published: a single track with the tyre of
constant stiffness, Laguerre moves with the pole 0.95 for the standard MPC and 0.75 for the adaptive ones, and their
clamps on what the learned functions say. `same-moves` is what the paper describes: the dual track on the Magic Formula
tyre and the moves of eq. (10) for everybody, so that the controllers differ in their tuning only.

The ablation then tells the pole's part of the gain from adaptation's.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.controllers import MPC, Moves, Tuning
from adaptrack.dataset import DataSet, load_dataset
from adaptrack.errors import InvalidInput
from adaptrack.learning.mlp import MLP
from adaptrack.learning.training import Trained, train
from adaptrack.metrics import PUBLISHED, compute_metrics, published_mse
from adaptrack.plant import DualTrack, Plant, SingleTrack
from adaptrack.scenario import Scenario, load_scenario
from adaptrack.scheduling import ENTRIES, Learned, Lookup, Schedule, SchedulingVariables
from adaptrack.simulate import rollout, rollout_batch, simulate
from adaptrack.trajectory import Trajectory
from adaptrack.tuning.operating_points import NAMES
from adaptrack.vehicle import load_vehicle

Array = NDArray[np.float64]
Row = dict[str, Any]
Progress = Callable[[str, int, int], None]
"""Called with what is being done, and how many steps of how many are."""

TESTS = tuple(PUBLISHED)
"""The scenarios for which the paper gives mean square errors."""

LEARNED = ("nn", "anfis")

TABLE = Tuning()
"""The paper's table, 35/8/10/0.01."""

SLOW, FAST, PULSES = Moves.laguerre(0.95), Moves.laguerre(0.75), Moves.pulses()
"""What the authors' standard and adaptive controllers move by, and eq. (10)."""

CLAMPS: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "nn": {"Nc": (5, math.inf), "Np": (9, math.inf), "Q": (0.75, 10.0), "R": (0.01, 0.5)},
    "anfis": {"Nc": (1, 25), "Np": (20, 55), "Q": (0.75, 20.0), "R": (0.005, 0.8)},
}
"""Bounds that the authors' programs put on the outputs of each model; infinite where they put none."""

QUICK: Mapping[str, Mapping[str, Any]] = {"nn": {"epochs": 100}, "anfis": {"epochs": 5}}
QUICK_ROWS = 1500
"""A quick run trains for fewer epochs, and on fewer conditions."""


@dataclass(frozen=True)
class BestConstant:
    """The one tuning of a data set's library that is best on average."""

    tuning: Tuning
    cost: float
    """m², geometric mean of its cost over the conditions"""
    standard_cost: float
    """m², likewise for the paper's table"""
    swarm_cost: float
    """m², likewise for the best tuning that a swarm found on each condition: what perfect adaptation would cost"""
    lost: int
    """conditions on which it lost the car; the means are over those where none of the three did"""
    candidates: int
    runs: int
    """closed-loop runs behind the choice"""
    swarm_runs: int
    """closed-loop runs of the swarms"""


@dataclass(frozen=True, eq=False)
class Contender:
    """A controller of the comparison."""

    name: str
    moves: Moves
    tuning: Tuning = TABLE
    schedule: Schedule | None = None
    stands_for: str = ""
    """the controller of the paper that it repeats: standard, nn or anfis; empty for none"""

    def mpc(self, preview: bool) -> MPC:
        """The controller itself, at the start of a run."""
        most = 20 if self.schedule is None else max(20, self.schedule.largest[1])
        return MPC(
            load_vehicle("paper"), self.tuning, moves=self.moves, preview=preview, scheduler=self.schedule,
            most_moves=most,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Configuration:
    """A plant and what is compared on it."""

    name: str
    plant: Plant
    contenders: tuple[Contender, ...]


@dataclass(frozen=True, eq=False)
class Reproduction:
    """All that `reproduce` measured; the lists are rows of plain JSON values, None for what is not finite or absent."""

    rows: list[Row]
    """a closed-loop run each: configuration, scenario, controller, preview, moves, paper_mse, ratio (to the paper),
    clipped_share (of the steps, with a scheduler's input outside its domain), and all of `Metrics`"""
    ablation: list[Row]
    """scenario, moves, controller, adapts, mse, failed, constants_better (tunings of the library with a lower MSE)"""
    shares: list[Row]
    """scenario, controller, gain (standard MSE over its own), pole, adaptation (factors of the gain), pole_share,
    adaptation_share (of its logarithm)"""
    swaps: list[Row]
    """scenario, changed, table, constant (its value there), mse: the paper's table with one
    number of the best constant, where all have the same moves"""
    learning: list[Row]
    """a learned function each: see `learning.training.Trained.quality`"""
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
    """conditions behind the learned functions, those held out included"""
    conditions: int
    """of the data set"""
    quick: bool
    seconds: float
    training_seconds: float

    def as_json(self) -> Row:
        """Everything but the trajectories."""
        told = {field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name != "runs"}
        return told | {"constant": dataclasses.asdict(self.constant)}


# -- what a data set gives --------------------------------------------------------------------------------------
def search_bounds(dataset: DataSet) -> dict[str, tuple[float, float]]:
    """(low, high) of each slot in the search behind a data set.

    Raises
    ------
    InvalidInput
        When the provenance does not tell.
    """
    search = dataset.provenance.get("settings", {}).get("search", {})
    if not set(ENTRIES) <= set(search):
        raise InvalidInput(f"data set {dataset.name!r}: its provenance does not tell the bounds of its search.")
    return {slot: (float(search[slot][0]), float(search[slot][1])) for slot in ENTRIES}


def scheduler(trained: Trained, dataset: DataSet, clamps: Mapping[str, tuple[float, float]] | None = None) -> Schedule:
    """The functions learned from a data set as a schedule, held within its search's bounds, or within `clamps`.

    A clamp that is infinite leaves the search's bound; log10 R/Q is held within what the bounds of both allow.
    """
    bounds = search_bounds(dataset)
    for slot, (low, high) in (clamps or {}).items():
        bounds[slot] = (
            low if math.isfinite(low) else bounds[slot][0],
            high if math.isfinite(high) else bounds[slot][1],
        )
    functions: dict[str, Any] = {
        slot: each.network_ if isinstance(each, MLP) else each.system_ for slot, each in trained.estimators.items()
    }
    if "log10_ratio" in functions:
        (q_low, q_high), (r_low, r_high) = bounds.pop("Q"), bounds["R"]
        bounds["R"] = (r_low / q_high, r_high / q_low)
    return Learned(functions, trained.inputs, trained.domain, bounds, trained.model, trained.provenance)


def quality(trained: Trained) -> list[Row]:
    """`Trained.quality` with the size of each function, and the share of rows at which a network's output is dead."""
    rows = []
    for row in trained.quality:
        each = trained.estimators[row["slot"]]
        if isinstance(each, MLP):
            more = {"parameters": each.network_.n_parameters, "rules": None, "dead_share": float(each.dead_share_)}
        else:
            more = {"parameters": each.n_parameters_, "rules": each.n_rules_, "dead_share": None}
        rows.append({**row, **more})
    return rows


def best_constant(dataset: DataSet) -> BestConstant:
    """The tuning of the library with the lowest geometric mean of its cost over all conditions.

    One that loses the car on fewer conditions always comes first.
    """
    landscape = dataset.landscape.astype(np.float64)
    kept = np.isfinite(landscape)
    with np.errstate(divide="ignore"):
        mean_log = np.where(kept, np.log(landscape), 0.0).sum(axis=0) / np.maximum(kept.sum(axis=0), 1)
    best = int(np.lexsort((mean_log, -kept.sum(axis=0)))[0])
    Np, Nc, Q, R = dataset.library[best].tolist()
    costs = np.column_stack((landscape[:, best], dataset.standard_costs, dataset.costs))
    cost, standard, swarm = np.exp(np.log(costs[np.isfinite(costs).all(axis=1)]).mean(axis=0)).tolist()
    computed = int(dataset.computed.sum())
    return BestConstant(
        tuning=Tuning(int(Np), int(Nc), Q, R),
        cost=cost,
        standard_cost=standard,
        swarm_cost=swarm,
        lost=int((~kept[:, best]).sum()),
        candidates=len(dataset.library),
        runs=computed * len(dataset.library),
        swarm_runs=int(dataset.evaluations[dataset.computed].sum()),
    )


def lookup(dataset: DataSet) -> Schedule:
    """A table of the best tunings found, interpolated between the conditions, which must fill a grid.

    Raises
    ------
    InvalidInput
        When they do not.
    """
    nodes, places = zip(*(np.unique(column, return_inverse=True) for column in dataset.operating_points.T), strict=True)
    sizes = tuple(map(len, nodes))
    if not len(dataset) == math.prod(sizes) == np.unique(np.ravel_multi_index(places, sizes)).size:
        raise InvalidInput(
            f"data set {dataset.name!r}: its {len(dataset)} conditions do not fill a grid, which a look-up table needs."
        )
    tunings = np.empty((*sizes, len(ENTRIES)))
    tunings[places] = dataset.tunings
    return Lookup(dict(zip(NAMES, nodes, strict=True)), tunings)


# -- the experiment ---------------------------------------------------------------------------------------------------
def reproduce(
    dataset: DataSet | None = None, *, quick: bool = False, seed: int = 0, progress: Progress | None = None
) -> Reproduction:
    """Train both models on a data set, drive both tests with every controller, take the gain apart.

    dataset: by default `paper-grid`; its conditions must fill a grid; quick: train less, see `QUICK`; seed: of the
    hold-out and of the models; progress: see `Progress`.

    Raises
    ------
    InvalidInput
        When the data set does not fit, see `lookup` and `search_bounds`.
    """
    begun = time.perf_counter()
    tell = progress or (lambda *_: None)
    dataset = load_dataset("paper-grid") if dataset is None else dataset
    search_bounds(dataset)
    constant, table = best_constant(dataset), lookup(dataset)
    source = dataset
    if quick and len(dataset) > QUICK_ROWS:
        source = dataset.rows(np.sort(np.random.default_rng(seed).permutation(len(dataset))[:QUICK_ROWS]))
    models: dict[str, Trained] = {}
    for i, model in enumerate(LEARNED):
        tell(f"training {model}", i, 5)
        models[model] = train(source, model, "paper", seed=seed, **(QUICK[model] if quick else {}))
    trained = time.perf_counter()

    free = {model: scheduler(made, dataset) for model, made in models.items()}
    clamped = {model: scheduler(made, dataset, CLAMPS[model]) for model, made in models.items()}
    released, same = configurations(constant.tuning, table, clamped, free)
    scenarios = [load_scenario(name) for name in TESTS]
    tell("driving both configurations", 2, 5)
    rows = [
        measure(configuration, contender, scenario, preview)
        for configuration in (released, same)
        for scenario in scenarios
        for contender in configuration.contenders
        for preview in (False, True)
    ]
    tell("taking the gain apart", 3, 5)
    parts = ablation(released.plant, scenarios, constant.tuning, clamped, dataset.library)
    swapped = swaps(same.plant, scenarios, constant.tuning)
    tell("timing steps", 4, 5)
    runs = [
        (contender.stands_for, drive(released.plant, contender, scenario, timed=True))
        for scenario in scenarios
        for contender in released.contenders
        if contender.stands_for
    ]
    tell("done", 5, 5)
    return Reproduction(
        rows=rows,
        ablation=parts,
        shares=shares(parts),
        swaps=swapped,
        learning=[row for made in models.values() for row in quality(made)],
        domain=[
            {"scenario": run.name_of("scenario"), **outside(run, free["nn"])} for name, run in runs if name == "nn"
        ],
        constant=constant,
        runs=runs,
        data=dataset.name,
        data_test=str(dataset.provenance["settings"].get("scenario", "")),
        learned_from=len(source),
        conditions=len(dataset),
        quick=quick,
        seconds=time.perf_counter() - begun,
        training_seconds=trained - begun,
    )


def configurations(
    constant: Tuning, table: Schedule, clamped: Mapping[str, Schedule], free: Mapping[str, Schedule]
) -> tuple[Configuration, Configuration]:
    """`released` and `same-moves`; clamped, free: the learned schedules with and without the authors' clamps."""
    car = load_vehicle("paper")
    released = Configuration(
        "released",
        SingleTrack(car, "constant-stiffness"),
        (
            Contender("standard-as-released", SLOW, stands_for="standard"),
            Contender("standard-as-written", PULSES),
            Contender("best-constant", FAST, constant),
            Contender("lookup", FAST, schedule=table),
            *(Contender(model, FAST, schedule=clamped[model], stands_for=model) for model in LEARNED),
        ),
    )
    same = Configuration(
        "same-moves",
        DualTrack(car, "magic-formula"),
        (
            Contender("standard-as-released", SLOW),
            Contender("standard-as-written", PULSES, stands_for="standard"),
            Contender("best-constant", PULSES, constant),
            Contender("lookup", PULSES, schedule=table),
            *(Contender(model, PULSES, schedule=free[model], stands_for=model) for model in LEARNED),
        ),
    )
    return released, same


def drive(
    plant: Plant, contender: Contender, scenario: Scenario, preview: bool = False, timed: bool = False
) -> Trajectory:
    """One run, in the paper profile at exactly the scenario's speed; timed: from Python, with its step times."""
    run = (simulate if timed else rollout)(plant, contender.mpc(preview), scenario)
    name = f"{contender.stands_for or contender.name} ({describe_moves(contender.moves)})"
    return dataclasses.replace(run, meta={**run.meta, "controller": name})


def describe_moves(moves: Moves) -> str:
    """How tables call them: pulse, laguerre 0.95."""
    return "pulse" if moves.kind == "pulse" else f"laguerre {moves.pole:g}"


def measure(configuration: Configuration, contender: Contender, scenario: Scenario, preview: bool) -> Row:
    """A run as a row, see `Reproduction.rows`."""
    run = drive(configuration.plant, contender, scenario, preview)
    measures = compute_metrics(run)
    published = published_mse(run)
    schedule = contender.schedule
    return {
        "configuration": configuration.name,
        "scenario": scenario.name,
        "controller": contender.name,
        "preview": preview,
        "moves": describe_moves(contender.moves),
        "paper_mse": published,
        "ratio": None if published is None else _finite(measures.mse / published),
        "clipped_share": None if schedule is None else outside(run, schedule)["any"],
        **measures.as_row(),
    }


def outside(run: Trajectory, schedule: Schedule) -> dict[str, float]:
    """Share of the driven steps at which each input of `schedule` is outside its domain, by name; `any` of them."""
    conditions = dict(
        zip(SchedulingVariables._fields, (run.vx, run.y_ref, run.friction.mean(axis=1), run.wind[:, 1]), strict=False)
    )
    inputs = np.column_stack([conditions[name] for name in schedule.inputs])[np.isfinite(run.command)]
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
        for moves in (SLOW, FAST, PULSES):
            contenders = [
                Contender("table-constant", moves),
                Contender("best-constant", moves, constant),
                *(Contender(name, moves, schedule=schedule) for name, schedule in schedules.items()),
            ]
            by_constants = rollout_batch(plant, contenders[0].mpc(preview=False), scenario, library).mse
            told = [
                (contender.name, contender.schedule is not None, compute_metrics(drive(plant, contender, scenario)))
                for contender in contenders
            ]
            rows += [
                {
                    "scenario": scenario.name,
                    "moves": describe_moves(moves),
                    "controller": name,
                    "adapts": adapts,
                    "mse": _finite(measures.mse),
                    "failed": measures.failed,
                    "constants_better": int((by_constants < measures.mse).sum()),
                }
                for name, adapts, measures in told
            ]
            rows.append(
                {
                    "scenario": scenario.name,
                    "moves": describe_moves(moves),
                    "controller": "best-in-hindsight",
                    "adapts": False,
                    "mse": _finite(float(by_constants.min())),
                    "failed": not math.isfinite(by_constants.min()),
                    "constants_better": 0,
                }
            )
    return rows


def swaps(plant: Plant, scenarios: Iterable[Scenario], constant: Tuning) -> list[Row]:
    """Which number of `constant` makes it track unlike the paper's table, see `Reproduction.swaps`."""
    ratio, best = TABLE.R / TABLE.Q, constant.R / constant.Q
    changes = {
        "Np": (TABLE.Np, constant.Np, dataclasses.replace(TABLE, Np=max(constant.Np, TABLE.Nc))),
        "Nc": (TABLE.Nc, constant.Nc, dataclasses.replace(TABLE, Nc=min(constant.Nc, TABLE.Np))),
        "R/Q": (ratio, best, dataclasses.replace(TABLE, R=best * TABLE.Q)),
    }
    return [
        {
            "scenario": scenario.name,
            "changed": name,
            "table": table,
            "constant": value,
            "mse": _finite(compute_metrics(drive(plant, Contender(name, PULSES, tuning), scenario)).mse),
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
    slow, fast = describe_moves(SLOW), describe_moves(FAST)
    rows: list[Row] = []
    for scenario in dict.fromkeys(row["scenario"] for row in ablation):
        mse = {(row["moves"], row["controller"]): row["mse"] for row in ablation if row["scenario"] == scenario}
        for name in LEARNED:
            corners = [mse[slow, "table-constant"], mse[fast, "table-constant"], mse[slow, name], mse[fast, name]]
            row: Row = {"scenario": scenario, "controller": name}
            if any(not corner for corner in corners):  # a run that ended early has no MSE
                parts = dict.fromkeys(("gain", "pole", "adaptation", "pole_share", "adaptation_share"))
            else:
                standard, pole_only, adapted_only, both = map(math.log, corners)
                pole = (standard - pole_only + adapted_only - both) / 2.0
                adaptation = (standard - adapted_only + pole_only - both) / 2.0
                gain = pole + adaptation
                parts = {
                    "gain": math.exp(gain),
                    "pole": math.exp(pole),
                    "adaptation": math.exp(adaptation),
                    "pole_share": pole / gain if gain else None,
                    "adaptation_share": adaptation / gain if gain else None,
                }
            rows.append(row | parts)
    return rows


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None
