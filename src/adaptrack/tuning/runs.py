"""Sets of runs, and the cost of tunings, schedules and controllers on them.

A `RunSet` combines scenarios or drives along roads with a plant and an MPC. A policy is a tuning or a schedule of this
MPC, or a controller that replaces it. The cost of a run of n control periods, with the weight w of command changes, is

    J = (1/n) sum e^2 + w (1/n) sum (change of command)^2.

Compiled controllers run in batches. `simulate` drives the runs of other controllers, and all runs of a plant or a speed
control that is stepped in Python, one at a time.
"""

from __future__ import annotations

import copy
import math
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant
from adaptrack.cars.vehicle import Domain
from adaptrack.control.controllers import MPC, Controller, Tuning
from adaptrack.control.controllers.base import Policy
from adaptrack.control.controllers.tuning import ENTRIES
from adaptrack.control.estimation import FrictionWindEstimator, Perception
from adaptrack.control.scheduling import Schedule
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.simulation.world import SIGNAL
from adaptrack.drive.batch import Batch, interpreted_functions, sampled
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.metrics import PAPER_MSE
from adaptrack.drive.simulate import rollouts, simulate
from adaptrack.drive.trajectory import Trajectory
from adaptrack.drive.world import Driver, LongitudinalDriver, PerceptionSource, World
from adaptrack.scenario import RoadDrive, Scenario, load_scenario, random_drive
from adaptrack.scenario.profile import Profile, load_profile

Indices = NDArray[np.int64]

PolicyArgument = Schedule | Tuning | Controller | Policy | ArrayLike
"""Way to drive a set of runs, one of

- a schedule of the set's MPC;
- a tuning of the set's MPC for all runs, or an array (runs, 4) with Np, Nc, Q and R for each run;
- a controller, with its tuning or with others (`Policy`).
"""

PERCEPTIONS: dict[str, Perception] = {
    "noisy": Perception(noise=0.1),
    "lagged": Perception(delay=1.0),
    "biased high": Perception(bias=0.2),
    "biased low": Perception(bias=-0.2),
    "withheld": Perception(withheld=True),
}
"""Perception errors of friction and wind by name. `perception` also accepts "exact" and "estimated"."""


class Outcome(NamedTuple):
    """Results of several runs with one noise seed."""

    costs: Array
    """J of each run (m^2), (runs,), infinite if it failed."""
    segments: Array
    """Costs of the segments of each run (m^2), (runs, segments), see `RunSet.segments`; (runs, 0) if not requested."""
    counts: dict[str, NDArray[np.int64]]
    """Counters of the schedule by name, (runs,); empty without a schedule."""


class RunSet:
    """Runs of one plant in one profile.

    When schedulers are trained, each run is divided into segments. The cost of a segment is attributed to the inputs of
    the scheduler within the segment and shortly before it. This needs runs of equal length.

    Parameters
    ----------
    plant
        Simulated plant.
    mpc
        Controller whose tuning or schedule is compared.
    scenarios
        Scenarios or drives along roads, one for each run.
    profile
        Steering actuator, sensors and control period, or the name of a profile.
    segment
        Length of a segment (control periods); None for the whole run.
    before
        Time before a segment (control periods) in which inputs of the scheduler may influence the cost of the segment.
    stride
        Every how many control periods the inputs of the scheduler are used for training.
    perception
        How schedulers perceive friction and wind; None for the true values.
    failure
        Rule by which a run fails; None for the rule of the domain of the plant's car.
    driver
        Driver of the cars on roads; None where the planned speed is followed exactly.
    """

    perception: PerceptionSource = None
    failure = FailureLimits()
    controller = "mpc"
    """Label of the MPC in tables: "informed" for an MPC with a belief, otherwise "mpc"."""
    _last_batch: Batch | None = None

    def __init__(
        self, plant: Plant | SteppedPlant, mpc: MPC, scenarios: Sequence[Scenario | RoadDrive],
        profile: str | Profile = "road", *, segment: int | None = None, before: int = 0, stride: int = 20,
        perception: PerceptionSource = None, failure: FailureLimits | None = None, driver: LongitudinalDriver = None,
    ) -> None:  # fmt: skip
        self.plant, self.mpc, self.scenarios, self.profile, self.driver = plant, mpc, list(scenarios), profile, driver
        self.perception, self.failure = perception, failure or FailureLimits.of(plant)
        self.controller = "mpc" if mpc.belief is None else "informed"
        self.weight = load_profile(profile).move_weight
        self.signals, samples = sampled(World.of(plant, mpc, profile, driver, perception, failure), self.scenarios)
        self.lengths = np.array([signals.n for signals in self.signals])
        """Number of control periods of each run, (runs,)."""
        self.periods = int(self.lengths.max())
        self.segment, self.before, self.stride = segment or self.periods, before, stride
        names = ("speed", "y_ref", "known_friction", "known_wind", "change", "acceleration")
        columns = [samples[:, getattr(SIGNAL, name), :-1] for name in names]
        self.variables = np.stack([*columns, np.zeros_like(columns[0])], axis=-1)
        """Inputs of a scheduler, (runs, periods, `SchedulingVariables`).

        The offset is zero, since it is unknown before the run. A shorter run is continued with its last row.
        """

    @cached_property
    def _mpc_batch(self) -> Batch:
        """The batch of the set's MPC."""
        return self._batch(self.mpc)

    def _batch(self, controller: Controller) -> Batch:
        assert not isinstance(self.plant, SteppedPlant)
        assert isinstance(self.driver, Driver | None)
        return Batch(
            self.plant, controller, self.scenarios, self.profile, self.driver, self.failure, self.perception
        )  # fmt: skip

    def __len__(self) -> int:
        return len(self.signals)

    @property
    def failed_cost(self) -> float:
        """The cost that is assigned to a failed run (m^2): the square of the failure distance."""
        return portable.square(self.failure.distance)

    def drive(self, policy: PolicyArgument, seeds: Sequence[int], indices: Indices | None = None) -> Array:
        """Return J (m^2) of each run with each noise seed, (runs, seeds), infinite if it failed.

        Parameters
        ----------
        policy
            Way to drive. If it has a tuning for each run, row k is the tuning of run indices[k].
        seeds
            Seeds of the sensor noise.
        indices
            Indices of the runs, also repeated ones; None for all runs of the set.
        """
        indices = np.arange(len(self)) if indices is None else indices
        if not self._runs_compiled(policy):
            runs = list(enumerate(indices.tolist()))
            return np.array([[self._simulated_cost(policy, row, i, int(seed)) for seed in seeds] for row, i in runs])
        return np.stack([self._run(policy, int(seed), indices).costs for seed in seeds], axis=1)

    def costs(self, policy: PolicyArgument, seeds: Sequence[int], indices: Indices | None = None) -> Array:
        """Return the mean of J over the noise seeds (m^2), (runs,). A failed run costs `failed_cost`."""
        costs = self.drive(policy, seeds, indices)
        return np.where(np.isfinite(costs), costs, self.failed_cost).mean(axis=1)

    def costs_of(self, tunings: Array, seeds: Sequence[int], controller: Controller | None = None) -> Array:
        """Return `costs` of every run with every tuning (m^2), (tunings, runs); None: tunings of the set's MPC."""
        indices = np.tile(np.arange(len(self)), len(tunings))
        costs = self.costs(Policy(controller, np.repeat(tunings, len(self), axis=0)), seeds, indices)
        return costs.reshape(len(tunings), len(self))

    def trajectories(self, policy: PolicyArgument, seeds: Sequence[int]) -> list[list[Trajectory]]:
        """Return the trajectories of the runs that `drive` evaluates: for each run a list with each noise seed."""
        if self._runs_compiled(policy):
            return rollouts(self._batch(self.controller_of(policy, 0)), [int(seed) for seed in seeds])
        return [[self._simulated(policy, i, i, int(seed)) for seed in seeds] for i in range(len(self))]

    def segments(self, policy: PolicyArgument, seed: int, indices: Indices) -> Array:
        """Return the cost of each segment (m^2), (runs, segments): the sum of e^2 + w (change of command)^2.

        It is infinite in the segment in which a run failed, and NaN in later ones. The arguments are those of `drive`.

        Raises
        ------
        InvalidInput
            When the runs differ in length.
        """
        if (self.lengths != self.periods).any():
            raise InvalidInput("runs: costs of segments need runs of equal length.")
        if not self._runs_compiled(policy):
            runs = enumerate(indices.tolist())
            return np.array([self._simulated_segments(policy, row, i, seed) for row, i in runs])
        return self._run(policy, seed, indices, segmented=True).segments

    def counts(self, schedule: Schedule, seed: int) -> dict[str, NDArray[np.int64]]:
        """Return the counters of a schedule by name ("steps", "clipped", ...), each (runs,)."""
        if self._runs_compiled(schedule):
            return self._run(schedule, seed, np.arange(len(self))).counts
        counts = []
        for i in range(len(self)):
            mpc = self.controller_of(schedule, i)
            self._simulated_cost(mpc, i, i, seed)
            counts.append(mpc.scheduler_counts)
        return {name: np.array([count[name] for count in counts]) for name in counts[0]}

    def _run(self, policy: PolicyArgument, seed: int, indices: Indices, segmented: bool = False) -> Outcome:
        controller, tunings, scheduler = policy_of(policy)
        if controller is None:
            batch = self._mpc_batch
        elif self._last_batch is not None and self._last_batch.controller is controller:
            batch = self._last_batch
        else:
            batch = self._last_batch = self._batch(controller)
        if scheduler is not None:
            self._warn_of(scheduler)
        elif tunings is None:
            scheduler = batch.scheduler
        tuning = batch.tuning if tunings is None else np.asarray(tunings, dtype=float)
        outcome = batch.run(
            indices, np.broadcast_to(tuning, (len(indices), tuning.shape[-1])).copy(),
            np.full(len(indices), seed, np.int64), os.cpu_count() or 1,
            segment=self.segment if segmented else 0, weight=self.weight, scheduler=scheduler,
        )  # fmt: skip
        costs = (outcome.result["squared_error"] + self.weight * outcome.result["squared_move"]) / self.lengths[indices]
        return Outcome(np.where(outcome.has_failed, np.inf, costs), outcome.segments, outcome.counts)

    def _warn_of(self, schedule: Schedule) -> None:
        self.mpc.warn_of(schedule, load_profile(self.profile).name, self.plant)

    def _controller(self, policy: Policy) -> Controller:
        """Return the controller that a policy drives with or whose tuning it replaces."""
        return self.mpc if policy.controller is None else policy.controller

    def _runs_compiled(self, policy: PolicyArgument) -> bool:
        """Whether plant, driver and policy run in compiled batches, without calls of Python functions."""
        if isinstance(self.plant, SteppedPlant) or not isinstance(self.driver, Driver | None):
            return False
        controller = self._controller(policy_of(policy))
        has_compiled_scheduler = isinstance(controller.scheduler, Schedule | None)
        return (
            controller.runs_in_kernel and has_compiled_scheduler and not interpreted_functions(self.plant, controller)
        )

    def controller_of(self, policy: PolicyArgument, row: int = 0) -> Controller:
        """Return the controller of a policy: a controller itself, or the MPC with a schedule or a tuning.

        If the policy has a tuning for each run, `row` selects one.
        """
        record = policy_of(policy)
        controller, tunings, scheduler = self._controller(record), record.tunings, record.scheduler
        if scheduler is not None:
            self._warn_of(scheduler)
            controller = copy.copy(controller)
            controller.scheduler = scheduler
            controller.reset()
        if tunings is None:
            return controller
        rows = np.atleast_2d(np.asarray(tunings, dtype=float))
        tuning = dict(zip(controller.tuning_names, rows[min(row, len(rows) - 1)].tolist(), strict=True))
        return controller.with_tuning(controller.nearest_tuning(tuning))

    def _simulated_cost(self, policy: PolicyArgument, row: int, i: int, seed: int) -> float:
        """Return J (m^2) of run i of the set with one noise seed; `row` as for `controller_of`."""
        run = self._simulated(policy, row, i, seed)
        if run.failed is not None:
            return math.inf
        return float(portable.square(run.error).mean() + self.weight * portable.square(run.command_change).mean())

    def _simulated_segments(self, policy: PolicyArgument, row: int, i: int, seed: int) -> Array:
        """Return the costs of the segments of run i (m^2), (segments,), as the compiled kernels compute them."""
        run = self._simulated(policy, row, i, seed)
        step_costs = portable.square(run.error) + self.weight * portable.square(run.command_change)
        segments = np.add.reduceat(step_costs, np.arange(0, self.periods, self.segment))
        if run.failed is not None:
            first = max(round(run.failed_at / run.period) - 1, 0) // self.segment
            segments[first], segments[first + 1 :] = math.inf, math.nan
        return segments

    def _simulated(self, policy: PolicyArgument, row: int, i: int, seed: int) -> Trajectory:
        """Return the trajectory of run i of the set with one noise seed; `row` as for `controller_of`."""
        controller, perception = self.controller_of(policy, row), self.perception
        if isinstance(perception, Perception):  # the same perception errors as in a compiled batch
            perception = replace(perception, seed=perception.seed + i)
        return simulate(
            self.plant, controller, self.scenarios[i], profile=self.profile, driver=self.driver, seed=seed,
            perception=perception, failure=self.failure,
        )  # fmt: skip


def policy_of(policy: Any, where: str = "policy") -> Policy:
    """Return the record of any `PolicyArgument`.

    Raises InvalidInput, beginning with `where`, for anything that cannot drive.
    """
    if hasattr(policy, "as_policy"):
        record: Policy = policy.as_policy()
        return record
    try:
        rows = np.asarray(policy, dtype=float)
    except (TypeError, ValueError):
        rows = np.empty(0)
    if rows.ndim not in (1, 2) or rows.shape[-1] != len(ENTRIES) or not np.isfinite(rows).all():
        raise InvalidInput(
            f"{where}: {policy!r}: must be a schedule, a tuning, finite rows of Np, Nc, Q, R, or a controller with a "
            "method `step`."
        )
    return Policy(tunings=rows)


# -- sets of runs for training and tests ------------------------------------------------------------------------------
def operating_point_runs(
    plant: Plant | SteppedPlant, mpc: MPC, points: ArrayLike, profile: str | Profile = "road", **options: Any
) -> RunSet:
    """Return a set with one smooth lane change in a gust for each operating point.

    Parameters
    ----------
    plant, mpc, profile
        As for `RunSet`.
    points
        Speed (m/s), y_ref (m), friction and wind (m/s) of each operating point, (n, 4).
    options
        Further arguments of `RunSet`.

    Raises
    ------
    InvalidInput
        For points of a different shape.
    """
    rows = np.asarray(points, dtype=np.float64) + 0.0  # no negative zeros: equal points are equal bit for bit
    if rows.ndim != 2 or rows.shape[1] != 4 or not len(rows):
        raise InvalidInput(f"operating points: need rows of speed, y_ref, friction, wind; got the shape {rows.shape}.")
    runs = [load_scenario("lane-change", speed=v, amplitude=y, friction=mu, gust=w) for v, y, mu, w in rows.tolist()]
    return RunSet(plant, mpc, runs, profile, **{"stride": 8, **options})


def random_drive_runs(
    plant: Plant | SteppedPlant, mpc: MPC, numbers: Iterable[int], duration: float = 60.0,
    profile: str | Profile = "road", *, drive_options: Mapping[str, Any] | None = None, segment_seconds: float = 2.0,
    **options: Any,
) -> RunSet:  # fmt: skip
    """Return a set of random drives.

    Parameters
    ----------
    plant, mpc, profile
        As for `RunSet`.
    numbers
        Numbers (seeds) of the random drives.
    duration
        Duration of each drive (s).
    drive_options
        Further arguments of `random_drive`, in addition to those of the domain of the plant's car.
    segment_seconds
        Length of a segment (s), and time before a segment in which inputs may influence its cost.
    options
        Further arguments of `RunSet`.
    """
    domain = getattr(getattr(plant, "vehicle", None), "domain", Domain()).drive_options
    drives = [random_drive(number, duration, **(domain | dict(drive_options or {}))) for number in numbers]
    segment = round(segment_seconds / mpc.period)
    return RunSet(plant, mpc, drives, profile, **{"segment": segment, "before": segment, **options})


def paper_test_runs(
    plant: Plant | SteppedPlant, mpc: MPC, name: str, profile: str | Profile = "road", **options: Any
) -> RunSet:
    """Return a set with one of the two tests of the paper, by name; InvalidInput for an unknown name."""
    if name not in PAPER_MSE:
        raise InvalidInput(f"test = {name!r}: must be one of {', '.join(PAPER_MSE)}.")
    return RunSet(plant, mpc, [load_scenario(name)], profile, **options)


def make_perception(name: str, plant: SingleTrack | DualTrack, profile: str | Profile = "road") -> PerceptionSource:
    """Return the argument `perception` for a perception of friction and wind by name.

    The names are "exact" (true values), "estimated" (`FrictionWindEstimator`) and those of `PERCEPTIONS`. Raises
    InvalidInput for an unknown name.
    """
    if name == "exact":
        return None
    if name == "estimated":
        return FrictionWindEstimator.of(plant, profile)
    if name not in PERCEPTIONS:
        raise InvalidInput(f"perception = {name!r}: must be exact, estimated, {', '.join(PERCEPTIONS)}.")
    return PERCEPTIONS[name]
