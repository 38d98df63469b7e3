"""Sets of runs, and what a policy costs on them.

A `RunSet` holds scenarios, or drives along roads, the plant that drives them and the MPC whose tuning a policy chooses.
The cost of a run of n control periods, with the weight w of steering activity, is

    J = (1/n) sum e^2 + w (1/n) sum (change of command)^2.

Schedules, tunings and compiled controllers run in batches; any other controller, and every controller of a stepped
plant, is driven by `simulate`, run by run.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple, TypeGuard

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.domain import Domain
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant
from adaptrack.control.controllers import MPC, CompiledController, Controller, Tuning
from adaptrack.control.estimation import FrictionWindEstimator, Perception
from adaptrack.control.scheduling import Schedule
from adaptrack.core.loop import SIGNAL
from adaptrack.drive.batch import Batch, interpreted_functions, sampled
from adaptrack.drive.failure import Failure
from adaptrack.drive.metrics import PAPER_MSE
from adaptrack.drive.simulate import rollouts, simulate
from adaptrack.drive.trajectory import Trajectory
from adaptrack.drive.world import Driver, KnownAs, World
from adaptrack.road import Comfort, Road, plan_speed
from adaptrack.road.speed import DEFAULT_COMFORT
from adaptrack.scenario import RoadDrive, Scenario, load_scenario, random_drive
from adaptrack.scenario.profile import Profile, load_profile

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


class Retuned(NamedTuple):
    """A controller with tunings instead of its own."""

    controller: Controller
    tunings: ArrayLike
    """(entries,) or (runs, entries) in the order of its `tuning_names`"""


Policy = Schedule | Tuning | Controller | Retuned | ArrayLike
"""What drives: a schedule, one tuning, one tuning (Np, Nc, Q, R) for each run, or a controller of its own, `Retuned`
or as it is."""

PERCEPTIONS: dict[str, Perception] = {
    "noisy": Perception(noise=0.1),
    "lagged": Perception(delay=1.0),
    "biased high": Perception(bias=0.2),
    "biased low": Perception(bias=-0.2),
    "withheld": Perception(withheld=True),
}
"""Ways of knowing friction and wind by name, beside "exact" and "estimated"."""


class Outcome(NamedTuple):
    """Results of the runs with one noise seed."""

    costs: Array
    """(runs,) m^2, J; inf where the run failed"""
    segments: Array
    """(runs, segments) m^2, see `RunSet.segments`; (runs, 0) where they were not requested"""
    counts: dict[str, NDArray[np.int64]]
    """schedule counters by name, (runs,); empty without a schedule"""


class RunSet:
    """Scenarios and drives along roads, driven by one plant in one profile; adaptation needs equally long ones.

    segment: length of the segments that cost is attributed to (control periods), by default the whole run; before: how
    long before a segment its causes may lie (periods); stride: every how many periods its inputs are looked at;
    known_as: how schedulers know friction and wind; failure: when a run has failed; driver: None where the planned
    speed is followed exactly.
    """

    known_as: KnownAs = None
    failure = Failure()
    controller = "mpc"
    """name of the tuned MPC in tables: "informed" for an MPC with a belief"""
    _latest: Batch | None = None

    def __init__(
        self, plant: Plant | SteppedPlant, mpc: MPC, scenarios: Sequence[Scenario | RoadDrive],
        profile: str | Profile = "road", *, segment: int | None = None, before: int = 0, stride: int = 20,
        known_as: KnownAs = None, failure: Failure | None = None, driver: Driver | None = None,
    ) -> None:  # fmt: skip
        self.plant, self.mpc, self.scenarios, self.profile, self.driver = plant, mpc, list(scenarios), profile, driver
        self.known_as, self.failure = known_as, failure or Failure.of(plant)
        self.controller = "mpc" if mpc.belief is None else "informed"
        self.weight = load_profile(profile).move_weight
        self.signals, samples = sampled(World.of(plant, mpc, profile, driver, known_as, failure), self.scenarios)
        self.lengths = np.array([signals.n for signals in self.signals])
        """(runs,) control periods"""
        self.periods = int(self.lengths.max())
        self.segment, self.before, self.stride = segment or self.periods, before, stride
        self.variables = _scheduling_variables(samples)
        """(runs, periods, SchedulingVariables) what a scheduler looks at; the offset, unknown before driving, zero.
        A run that is shorter goes on with its last row."""

    @cached_property
    def _mpc_batch(self) -> Batch:
        """The batch of the MPC."""
        return self._batch(self.mpc)

    def _batch(self, controller: Controller) -> Batch:
        assert not isinstance(self.plant, SteppedPlant)
        return Batch(
            self.plant, controller, self.scenarios, self.profile, self.driver, self.failure, self.known_as
        )  # fmt: skip

    def _batch_of(self, controller: Controller) -> Batch:
        """The batch of a controller of its own; that of the last one is kept."""
        if self._latest is None or self._latest.controller is not controller:
            self._latest = self._batch(controller)
        return self._latest

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def failed_cost(self) -> float:
        """m^2, what a failed run counts as costing: the square of the distance at which it leaves the road."""
        return self.failure.distance**2

    def drive(self, policy: Policy, seeds: Sequence[int], indices: Indices | None = None) -> Array:
        """(runs, seeds) m^2, J of each run of `which` with each noise seed; inf where it failed.

        Of a policy (runs, 4), row i drives the run which[i].
        """
        indices = np.arange(len(self)) if indices is None else indices
        if not self._compiles(policy):
            rows = list(enumerate(indices.tolist()))
            return np.array([[self._simulated_cost(policy, k, i, int(seed)) for seed in seeds] for k, i in rows])
        return np.stack([self._run(policy, int(seed), indices).costs for seed in seeds], axis=1)

    def costs(self, policy: Policy, seeds: Sequence[int], indices: Indices | None = None) -> Array:
        """(runs,) m^2, mean of J over the noise seeds; a failed run counts as `failed_cost`."""
        costs = self.drive(policy, seeds, indices)
        return np.where(np.isfinite(costs), costs, self.failed_cost).mean(axis=1)

    def trajectories(self, policy: Schedule | Tuning | Controller, seeds: Sequence[int]) -> list[list[Trajectory]]:
        """Each run (outer list) with each noise seed (inner list): what `drive` gives the costs of."""
        if self._compiles(policy):
            return rollouts(self._batch(self.controller_of(policy, 0)), [int(seed) for seed in seeds])
        return [[self._simulated(policy, i, i, int(seed)) for seed in seeds] for i in range(len(self))]

    def segments(self, policy: Policy, seed: int, indices: Indices) -> Array:
        """(runs, segments) m^2, cost of each segment (sum); inf in the one where a run failed, NaN after it.

        Raises
        ------
        InvalidInput
            When the runs do not last equally long.
        """
        if (self.lengths != self.periods).any():
            raise InvalidInput("runs: segments of the cost need runs that last equally long.")
        if not self._compiles(policy):
            return np.array([self._simulated_segments(policy, k, i, seed) for k, i in enumerate(indices.tolist())])
        return self._run(policy, seed, indices, segmented=True).segments

    def counts(self, schedule: Schedule, seed: int) -> dict[str, NDArray[np.int64]]:
        """(runs,) how many steps a schedule counted of each kind, by name: "steps", "clipped", ..."""
        if self._compiles(schedule):
            return self._run(schedule, seed, np.arange(len(self))).counts
        counts = []
        for i in range(len(self)):
            mpc = self.controller_of(schedule, i)
            self._simulated_cost(mpc, i, i, seed)
            counts.append(mpc.scheduler_counts)
        return {name: np.array([count[name] for count in counts]) for name in counts[0]}

    def _run(self, policy: Policy, seed: int, indices: Indices, segmented: bool = False) -> Outcome:
        controller = policy.controller if isinstance(policy, Retuned) else policy
        batch = self._batch_of(controller) if _is_controller(controller) else self._mpc_batch
        tuning, scheduler = batch.tuning, batch.scheduler
        if isinstance(policy, Schedule):
            self._warn_of(policy)
            scheduler = policy
        elif not _is_controller(policy):
            scheduler = None
            tuning = _rows(policy)
        outcome = batch.run(
            indices, np.broadcast_to(tuning, (len(indices), tuning.shape[-1])).copy(),
            np.full(len(indices), seed, np.int64), os.cpu_count() or 1,
            segment=self.segment if segmented else 0, weight=self.weight, scheduler=scheduler,
        )  # fmt: skip
        costs = (outcome.result["squared_error"] + self.weight * outcome.result["squared_move"]) / self.lengths[indices]
        return Outcome(np.where(outcome.has_failed, np.inf, costs), outcome.segments, outcome.counts)

    def _warn_of(self, schedule: Schedule) -> None:
        self.mpc.warn_of(schedule, load_profile(self.profile).name, self.plant)

    def _compiles(self, policy: Policy) -> bool:
        policy = policy.controller if isinstance(policy, Retuned) else policy
        controller = policy if _is_controller(policy) else self.mpc
        if isinstance(self.plant, SteppedPlant) or interpreted_functions(self.plant, controller):
            return False
        return not _is_controller(policy) or _compiles(policy)

    def controller_of(self, policy: Policy, k: int = 0) -> Controller:
        """Return the controller of the k-th run: the policy itself, or the MPC with a schedule or its k-th tuning."""
        if _is_controller(policy):
            return policy
        if isinstance(policy, Schedule):
            self._warn_of(policy)
            mpc = copy.copy(self.mpc)
            mpc.scheduler = policy
            mpc.reset()
            return mpc
        controller = policy.controller if isinstance(policy, Retuned) else self.mpc
        row = dict(zip(controller.tuning_names, _row(policy, k).tolist(), strict=True))
        if isinstance(controller, MPC):
            row["Np"] = min(max(round(row["Np"]), 1), controller.longest_horizon)
            row["Nc"] = min(max(round(row["Nc"]), 1), row["Np"], controller.most_moves)
        return controller.with_tuning(row)

    def _simulated_cost(self, policy: Policy, k: int, i: int, seed: int) -> float:
        run = self._simulated(policy, k, i, seed)
        if run.failed is not None:
            return math.inf
        return float((run.error**2).mean() + self.weight * (run.command_change**2).mean())

    def _simulated_segments(self, policy: Policy, k: int, i: int, seed: int) -> Array:
        """(segments,) m^2 of one run, as `core.period` counts them."""
        run = self._simulated(policy, k, i, seed)
        step_costs = run.error**2 + self.weight * run.command_change**2
        segments = np.add.reduceat(step_costs, np.arange(0, self.periods, self.segment))
        if run.failed is not None:
            first = max(round(run.failed_at / run.period) - 1, 0) // self.segment
            segments[first], segments[first + 1 :] = math.inf, math.nan
        return segments

    def _simulated(self, policy: Policy, k: int, i: int, seed: int) -> Trajectory:
        controller, known_as = self.controller_of(policy, k), self.known_as
        if isinstance(known_as, Perception):  # with the errors that the run has in the batch
            known_as = replace(known_as, seed=known_as.seed + i)
        return simulate(
            self.plant, controller, self.scenarios[i], profile=self.profile, driver=self.driver, seed=seed,
            known_as=known_as, failure=self.failure,
        )  # fmt: skip


def _rows(policy: Policy) -> Array:
    """The tunings of a policy that gives some."""
    tunings = policy.tunings if isinstance(policy, Retuned) else policy
    return tunings.as_array() if isinstance(tunings, Tuning) else np.asarray(tunings, dtype=float)


def _row(policy: Policy, k: int) -> Array:
    """The k-th of them; the last one where there are fewer."""
    rows = np.atleast_2d(_rows(policy))
    return np.asarray(rows[min(k, len(rows) - 1)])


def _is_controller(policy: Any) -> TypeGuard[Controller]:
    return isinstance(policy, Controller)


def _compiles(controller: Controller) -> bool:
    """Whether the kernels can run it: a compiled law, or an MPC with a solver and a scheduler of theirs."""
    if isinstance(controller, CompiledController):
        return True
    scheduled = isinstance(controller, MPC) and not isinstance(controller.scheduler, Schedule | None)
    return isinstance(controller, MPC) and controller.runs_in_kernel and not scheduled


def _scheduling_variables(samples: Array) -> Array:
    """Return the scheduler's inputs in every period of each run, with an offset of zero."""
    rows = samples[:, :, :-1]
    names = ("speed", "y_ref", "known_friction", "known_wind", "change", "acceleration")
    columns = [rows[:, getattr(SIGNAL, name)] for name in names]
    return np.stack([*columns, np.zeros_like(columns[0])], axis=-1)


# -- makers -----------------------------------------------------------------------------------------------------------
def operating_point_runs(
    plant: Plant | SteppedPlant, mpc: MPC, points: ArrayLike, profile: str | Profile = "road", **options: Any
) -> RunSet:
    """One smooth lane change in a gust for each operating point: speed m/s, y_ref m, friction, wind m/s (n, 4).

    options: of `RunSet`.

    Raises
    ------
    InvalidInput
        When the points are no such rows.
    """
    rows = np.asarray(points, dtype=np.float64) + 0.0  # no negative zeros: equal points are equal bit for bit
    if rows.ndim != 2 or rows.shape[1] != 4 or not len(rows):
        raise InvalidInput(f"operating points: need rows of speed, y_ref, friction, wind; got the shape {rows.shape}.")
    runs = [load_scenario("lane-change", speed=v, amplitude=y, friction=mu, gust=w) for v, y, mu, w in rows.tolist()]
    return RunSet(plant, mpc, runs, profile, **{"stride": 8, **options})


def random_drive_runs(
    plant: Plant | SteppedPlant, mpc: MPC, numbers: Iterable[int], duration: float = 60.0,
    profile: str | Profile = "road", *, roads: Mapping[str, Any] | None = None, segment_seconds: float = 2.0,
    **options: Any,
) -> RunSet:  # fmt: skip
    """The random drives of these numbers; cost is attributed to segments, and to inputs up to one segment older.

    duration: s; roads: other options of `random_drive`, by default the domain of the plant's car; options: of `RunSet`.
    """
    domain = getattr(getattr(plant, "vehicle", None), "domain", Domain()).drive_options
    drives = [random_drive(number, duration, **(domain | dict(roads or {}))) for number in numbers]
    segment = round(segment_seconds / mpc.period)
    return RunSet(plant, mpc, drives, profile, **{"segment": segment, "before": segment, **options})


def road_runs(
    plant: SingleTrack | DualTrack, mpc: MPC, roads: Iterable[Road], comfort: Comfort = DEFAULT_COMFORT,
    profile: str | Profile = "road", **options: Any,
) -> RunSet:  # fmt: skip
    """One drive along each road, at the speed that `plan_speed` gives the plant's vehicle.

    options: of `RunSet`.

    Raises
    ------
    InvalidInput
        When a road cannot be planned, or there is none.
    """
    drives = [RoadDrive(road, plan_speed(road, plant.vehicle, comfort)) for road in roads]
    return RunSet(plant, mpc, drives, profile, **options)


def paper_test_runs(
    plant: Plant | SteppedPlant, mpc: MPC, name: str, profile: str | Profile = "road", **options: Any
) -> RunSet:
    """One of the paper's two tests.

    Raises
    ------
    InvalidInput
        When it is neither.
    """
    if name not in PAPER_MSE:
        raise InvalidInput(f"test = {name!r}: must be one of {', '.join(PAPER_MSE)}.")
    return RunSet(plant, mpc, [load_scenario(name)], profile, **options)


def perception(name: str, plant: SingleTrack | DualTrack, profile: str | Profile = "road") -> KnownAs:
    """How friction and wind are known, by name: exact, estimated, or one of `PERCEPTIONS`.

    Raises
    ------
    InvalidInput
        For another name.
    """
    if name == "exact":
        return None
    if name == "estimated":
        return FrictionWindEstimator.of(plant, profile)
    if name not in PERCEPTIONS:
        raise InvalidInput(f"known_as = {name!r}: must be exact, estimated, {', '.join(PERCEPTIONS)}.")
    return PERCEPTIONS[name]
