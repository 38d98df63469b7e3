"""How each contender of an adaptation is made: constants, look-up tables, learned schedules, the paper's recipe.

A recipe finds the contenders that it needs among those made before it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from adaptrack.analysis.feasibility import Feasibility
from adaptrack.analysis.stability import loop_map
from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Tuning
from adaptrack.control.controllers.made_for import INCREMENTAL
from adaptrack.control.scheduling import (
    ENTRIES,
    Constant,
    Guarded,
    Learned,
    Lookup,
    Schedule,
    SchedulingVariables,
    StabilityMap,
    Table,
)
from adaptrack.learning.adaptation.improve import Learnable, Surfaces, improve
from adaptrack.learning.adaptation.landscape import OUTPUTS
from adaptrack.learning.adaptation.method import Constants, Method
from adaptrack.learning.adaptation.splits import SetUp, Training, constants_noise, held_out_runs, training_runs
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.operating_points import NAMES
from adaptrack.paper.surfaces import FuzzySurface, NetworkSurface
from adaptrack.paper.training import Trained, train
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.pso import SearchSpace, SwarmSettings, minimise
from adaptrack.tuning.runs import Indices, RunSet

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]
"""Called with what is being done, and how many steps of how many are."""
Made = Mapping[str, Schedule]
"""The contenders made before."""

ANYWHERE = SchedulingVariables(15.0, 0.0, 0.7, 0.0)
"""Where a constant schedule is read."""


@dataclass(frozen=True, eq=False)
class Recipes:
    """The recipes of an adaptation; what takes long to prepare is prepared when first needed."""

    setup: SetUp
    dataset: DataSet
    """of its campaign"""
    show: Progress

    def all(self) -> dict[str, Callable[[Made], Schedule]]:
        """By contender, in an order in which each finds those that it needs."""
        inputs, tables = self.setup.config.learning.inputs, self.setup.method.look_up
        return {
            "best constant": partial(self.constant, 0),
            "best constant on drives": partial(self.constant, 1),
            "fallback": self.fallback,
            "speed look-up": partial(self.look_up, ["speed"], tables.speed_neighbours),
            "look-up": partial(self.look_up, NAMES, tables.neighbours),
            "speed only": partial(self.learned, "nn", ("speed",), "speed only"),
            "nn unguarded": partial(self.learned, "nn", inputs, "nn"),
            "nn": partial(self.guarded, "nn unguarded"),
            "anfis unguarded": partial(self.learned, "anfis", inputs, "anfis"),
            "anfis": partial(self.guarded, "anfis unguarded"),
            "paper recipe nn": partial(self.regression, "nn"),
            "paper recipe anfis": partial(self.regression, "anfis"),
        }

    @cached_property
    def training(self) -> Training:
        """Lane changes, drives, hard drives."""
        return training_runs(self.setup)

    @cached_property
    def held_out(self) -> list[RunSet]:
        """What chooses the round that is kept."""
        return held_out_runs(self.setup)

    @cached_property
    def stability(self) -> StabilityMap:
        """What the guard asks."""
        return stability_map(self.setup)

    def constant(self, part: int, made: Made) -> Schedule:
        """The best constant tuning of one part of the training runs."""
        constants, seed = self.setup.method.constants, self.setup.config.seed
        runs = [(self.training[part][0], constants.runs)]
        return Constant(as_tuning(best_constant(runs, method=self.setup.method, seed=seed)))

    def fallback(self, made: Made) -> Schedule:
        """A constant that keeps the car where others fail."""
        hard, noise = self.training[2][0], self.setup.method.seeds.fallback_noise
        return Constant(safe_constant(hard, self.stability, self.setup.method.constants, noise))

    def look_up(self, names: Sequence[str], neighbours: int, made: Made) -> Schedule:
        """A table over some numbers of an operating point."""
        tables, box = self.setup.method.look_up, self.setup.box
        nodes = {name: np.linspace(*box[name], getattr(tables, name)) for name in names}
        return neighbour_lookup(self.dataset, nodes, neighbours)

    def learned(self, model: str, inputs: tuple[str, ...], name: str, made: Made) -> Schedule:
        """What learns from the landscape."""
        config, seed = self.setup.config.learning, self.setup.config.seed
        surfaces = first_surfaces(self.setup, model, self.training, inputs)
        found = improve(
            Learnable(surfaces, inputs, config.box(inputs), name), self.training, self.held_out, rounds=config.rounds,
            seed=seed, method=self.setup.method, safe=safe_tuning(made),
            progress=lambda done, of: self.show(name, done, of),
        )  # fmt: skip
        return replace(found.schedule, provenance={"history": found.history})

    def guarded(self, bare: str, made: Made) -> Schedule:
        """A finished contender behind the guard."""
        guard, schedule = self.setup.method.guard, made[bare]
        limits = {
            "slack": guard.slack, "hold": guard.hold, "offset_limit": guard.offset_limit, "rates": guard.rates,
        }  # fmt: skip
        guarded = Guarded(schedule, safe_tuning(made), stability=self.stability, **limits)
        return replace(guarded, provenance=schedule.provenance)

    def regression(self, model: str, made: Made) -> Schedule:
        """The paper's recipe: regression on the tunings that the swarms found."""
        recipe = self.setup.method.recipe
        epochs = {"nn": recipe.nn_epochs, "anfis": recipe.anfis_epochs}[model]
        trained = train(self.dataset, model, "paper", holdout=recipe.holdout, seed=recipe.seed, epochs=epochs)
        return trained_schedule(trained, self.dataset)


# -- constants --------------------------------------------------------------------------------------------------------
def as_tuning(row: ArrayLike) -> Tuning:
    """Np, Nc, Q, R with whole horizons."""
    Np, Nc, Q, R = np.asarray(row, dtype=float).tolist()
    return Tuning(round(Np), round(Nc), Q, R)


def safe_tuning(made: Made) -> Tuning:
    """The fallback."""
    return as_tuning(made["fallback"](ANYWHERE))


def best_constant(
    training: Sequence[tuple[RunSet, int]], start: Sequence[float] | None = None, *, method: Method | None = None,
    seed: int = 0,
) -> Array:  # fmt: skip
    """(4,) the tuning with the lowest mean log cost over runs of the run sets: what one fixed tuning can do.

    The swarm of a campaign, each of its evaluations driving all the runs; each run set counts alike. start: a tuning
    that is tried too, by default the method's.
    """
    method = method or Method()
    law, noise = method.constants, constants_noise(method, seed)
    space = SearchSpace(
        names=("Np", "Nc", "R"), low=(law.Np[0], law.Nc[0], law.R[0]), high=(law.Np[1], law.Nc[1], law.R[1]),
        whole=("Np", "Nc"), decades=("R",), ordered=("Nc", "Np"), spread=2.0,
    )  # fmt: skip
    rng = np.random.default_rng((seed, 0xC057))
    picked = [(runs, np.sort(rng.choice(len(runs), min(count, len(runs)), replace=False))) for runs, count in training]

    def cost(tuning: ArrayLike) -> float:
        return float(np.mean([np.log(runs.costs(tuning, [noise], which)).mean() for runs, which in picked]))

    def costs(positions: Array) -> Array:
        return np.array([cost([p[0], p[1], 1.0, p[2]]) for p in np.atleast_2d(positions)])

    found = minimise(costs, space, SwarmSettings(generations=max(1, law.evaluations // 20)), seed=seed)
    given = np.asarray(law.start if start is None else start, dtype=float)
    return given if cost(given) < float(found.cost) else np.array([found.x[0], found.x[1], 1.0, found.x[2]])


def safe_constant(runs: RunSet, known: StabilityMap, law: Constants, noise: int) -> Tuning:
    """Of the map's tunings that are far from instability at every speed and friction, one with hardly a failure.

    On hard drives: of those with at most `fallback_failures` more than the fewest, the one that drives best.

    Raises
    ------
    InvalidInput
        As `safe_candidates`.
    """
    candidates = safe_candidates(known, law)

    def judged(rows: Array, count: int) -> tuple[Indices, Array]:
        """Failures and mean log cost of each tuning, on the first `count` runs."""
        costs = np.stack([runs.drive(row, [noise], np.arange(min(count, len(runs))))[:, 0] for row in rows])
        return np.isinf(costs).sum(axis=1), np.log(np.minimum(costs, runs.failed_cost)).mean(axis=1)

    failed, cost = judged(candidates, law.fallback_drives)
    best = candidates[np.lexsort((cost, failed))[: law.fallback_kept]]
    failed, cost = judged(best, len(runs))
    return as_tuning(best[np.argmin(np.where(failed <= failed.min() + law.fallback_failures, cost, np.inf))])


def safe_candidates(known: StabilityMap, law: Constants) -> Array:
    """(n, 4) of the map's tunings, those that are far from instability at every speed and friction.

    Raises
    ------
    InvalidInput
        When there is none: with the largest domain that one of them holds.
    """
    found = Feasibility.of_map(known.table.axes, 1.0 - known.table.values, law.fallback_margin)
    found = found.among(found.tunings[:, 3] >= 10.0**law.fallback_ratio)
    far = found.enough.all(axis=(0, 1))
    if far.any():
        return found.tunings[far]
    largest = found.constant
    raise InvalidInput(
        f"no constant tuning keeps the loop away from instability (modulus margin {found.least:g}) over the whole "
        f"domain of {found.whole}: "
        + (
            "nor at any point of it."
            if largest is None
            else f"the largest part of it that one can hold is {largest[1]}. Narrow the box of the campaign to that."
        )
    )


def stability_map(setup: SetUp) -> StabilityMap:
    """The map that the guard reads: how near to instability the loop is, driving straight, for every tuning.

    Straight: in a turn as hard as driving gets, good tunings are near to instability too, and to keep away from that
    costs more than it saves (see docs/adaptation.md). Slow loops count as nearer: loops change fastest there, and the
    map has few nodes. With prompt samples, which is a little kinder than late ones are.
    """
    speed, friction, guard = setup.box["speed"], setup.box["friction"], setup.method.guard
    prompt = load_profile(setup.profile).prompt
    axes, values = loop_map(setup.linear, setup.mpc, prompt, speed=speed, friction=friction, turn=None)
    values[axes[0] < guard.slow] += guard.slow_margin
    return StabilityMap(Table(axes, values), 1.0 - guard.margin)


# -- look-up tables ---------------------------------------------------------------------------------------------------
def neighbour_lookup(dataset: DataSet, nodes: Mapping[str, ArrayLike], neighbours: int = 12) -> Schedule:
    """A table of tunings: at each node that of the library with the lowest mean log cost over the nearest points.

    Averaging over neighbours takes out what is noise in each operating point's optimum, and whatever the table does not
    look at. nodes: along some or all of speed, y_ref, friction and wind; distances are in ranges of the data.
    """
    axes = {name: np.asarray(values, dtype=float) for name, values in nodes.items()}
    points = dataset.operating_points[:, [NAMES.index(name) for name in axes]]
    reach = np.ptp(points, axis=0)
    grid = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1)
    _, near = cKDTree(points / reach).query(
        grid.reshape(-1, len(axes)) / reach, k=np.arange(1, min(neighbours, len(points)) + 1)
    )
    costs = dataset.landscape.astype(np.float64)
    worst = np.nanmax(np.where(np.isfinite(costs), costs, np.nan))
    logs = np.log(np.where(np.isfinite(costs), costs, worst))
    best = dataset.library[np.argmin(logs[near].mean(axis=1), axis=1)]
    return Lookup(axes, best.reshape(*grid.shape[:-1], 4), name="look-up")


# -- learned ----------------------------------------------------------------------------------------------------------
def first_surfaces(setup: SetUp, model: str, training: Training, inputs: tuple[str, ...]) -> Surfaces:
    """Where the learning starts: the same tuning everywhere."""
    method, seed = setup.method, setup.config.seed
    starts = dict(zip(OUTPUTS, zip(method.improvement.start, method.improvement.span, strict=True), strict=True))
    domain = setup.config.learning.box(inputs)
    if model == "nn":
        law = method.network
        return {
            slot: NetworkSurface.start(domain, value, span, 10 * seed + i, law.hidden, epochs=law.epochs, rate=law.rate)
            for i, (slot, (value, span)) in enumerate(starts.items())
        }
    fuzzy = method.fuzzy
    columns = [SchedulingVariables._fields.index(name) for name in inputs]
    variables = np.concatenate(
        [runs.variables[:, :: fuzzy.stride].reshape(-1, len(SchedulingVariables._fields)) for runs, _ in training]
    )
    rng = np.random.default_rng((seed, 0xF522))
    rows = np.clip(variables[np.sort(rng.choice(len(variables), fuzzy.rows))][:, columns], *domain.T)
    made = FuzzySurface.start(
        rows, 0.0, setup.config.learning.rules, seed, restarts=fuzzy.restarts, neighbours=fuzzy.neighbours,
        width=fuzzy.width, hold=fuzzy.hold,
    )  # fmt: skip
    return {slot: made.level(value) for slot, (value, _) in starts.items()}


# -- regression on tuned operating points -----------------------------------------------------------------------------
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


def purpose_of(dataset: DataSet) -> dict[str, Any]:
    """The car, profile and controller that the tunings of a data set were sought for, as far as it tells.

    For the file of what was trained on it, see `Schedule.made_for`.
    """
    settings = dataset.provenance.get("settings", {})
    names = {"car": settings.get("vehicle"), "profile": settings.get("profile"), "tyre": settings.get("tyre")}
    known = {key: each["name"] if isinstance(each, Mapping) else each for key, each in names.items() if each}
    controller = settings.get("controller", "as-written")  # old data sets of the paper's controller do not name it
    model = INCREMENTAL if controller == "as-written" else controller
    return {**known, "controller": {"kind": "MPC", "model": model}} if settings else {}


def trained_schedule(
    trained: Trained, dataset: DataSet, clamps: Mapping[str, tuple[float, float]] | None = None
) -> Schedule:
    """The functions learned from a data set as a schedule, held within its search's bounds, or within `clamps`.

    A clamp that is infinite leaves the search's bound; log10 R/Q is held within what the bounds of both allow.
    """
    bounds = search_bounds(dataset)
    for slot, (low, high) in (clamps or {}).items():
        bounds[slot] = (
            low if math.isfinite(low) else bounds[slot][0],
            high if math.isfinite(high) else bounds[slot][1],
        )
    functions: dict[str, Any] = dict(trained.functions)
    if "log10_ratio" in functions:
        (q_low, q_high), (r_low, r_high) = bounds.pop("Q"), bounds["R"]
        bounds["R"] = (r_low / q_high, r_high / q_low)
    return Learned(functions, trained.inputs, trained.domain, bounds, trained.model, trained.provenance)
