"""Simulation of one closed-loop run.

`simulate` accepts any controller, plant, scheduler and QP solver: the kernels of a run (`core.simulation.run`) call the
controller back. `rollout` accepts compiled parts only, as `batch.rollout_batch` does for many runs, and returns the
same trajectory.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping, Sequence
from datetime import UTC, datetime
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Hint, Natural, checked
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import CalledController, Command
from adaptrack.control.qp import QPStatus
from adaptrack.control.speed_control import SpeedCommand, SpeedController, SpeedLimit, SpeedState
from adaptrack.core.controllers.part import COMMON_ANSWER
from adaptrack.core.maths.portable import Array
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.simulation.run import TRACE_SIGNALS
from adaptrack.drive.batch import Batch, BatchPlant, BatchRuns
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.failure import DISTANCE, FailureLimits, failure_of
from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.drive.trajectory import Trajectory, provenance
from adaptrack.drive.world import Driver, LongitudinalDriver, PerceptionSource, RequestedForces, World, warn_once
from adaptrack.scenario import RoadDrive, Scenario, Signals
from adaptrack.scenario.profile import Profile

PROGRESS_PERIODS = 64
"""Control periods between two reports of progress."""


DriveArgument = Annotated[
    Scenario | RoadDrive, Hint("such as load_scenario(name) or RoadDrive(load_road(file), speed)")
]
"""Scenario or road drive to simulate."""


class _Recorder:
    """Record of one run with a row for each control instant.

    state, signals, answer: see `core.simulation.run.Trace`.
    """

    def __init__(self, n: int, controller: Controller, state: Array, signals: Array, answer: Array) -> None:
        self.state, self.signals = state, signals
        self.tuning_names, self.diagnostic_names = controller.tuning_names, controller.diagnostic_names
        self.command = answer[:, : len(COMMON_ANSWER)]  # command, its change, held
        self.fixed_tuning = controller.packed_tuning()
        self.tuning = np.full((n, len(self.tuning_names)), np.nan)
        self.diagnostics = np.full((n, len(self.diagnostic_names)), np.nan)
        self.requests = np.full((n, len(_REQUEST_UNITS)), np.nan)  # of a speed controller
        self.times = np.full(n, np.nan)
        self.failed: str | None = None
        self.failed_at = math.nan
        self.counted: dict[str, int] = {}

    def record(self, k: int, answer: Command) -> None:
        """Record tuning and diagnostics of the controller's answer in step k."""
        tuning, diagnostics = answer.tuning, answer.diagnostics
        if len(self.tuning_names):
            self.tuning[k] = tuning if len(tuning) else self.fixed_tuning
        if len(self.diagnostic_names):
            is_mapping = isinstance(diagnostics, Mapping)
            self.diagnostics[k] = (
                [diagnostics.get(name, math.nan) for name in self.diagnostic_names] if is_mapping else diagnostics
            )


@checked
def simulate(
    plant: Plant | SteppedPlant,
    controller: Controller,
    scenario: DriveArgument,
    *,
    profile: str | Profile = "paper",
    driver: LongitudinalDriver = None,
    seed: Annotated[Natural, Field(lt=2**63)] = 0,
    perception: PerceptionSource = None,
    failure: FailureLimits | None = None,
    predicted: PredictedPaths | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Simulate a drive through a scenario or along a road with a controller.

    Parameters
    ----------
    plant
        Simulated car.
    controller
        Controller; it is reset before the run. One that `requests_forces` also moves the car, without a ``driver``.
    scenario
        Scenario or road drive.
    profile
        Steering, sensors and computation time: ``"paper"`` (ideal), ``"road"`` (steering actuator, noise, delay), a
        TOML file or a `Profile`.
    driver
        Longitudinal driver, `SpeedControl`, or your own `SpeedDriver`, which moves the car by its powertrain; None to
        follow the speed reference exactly.
    seed
        Seed of the sensor noise.
    perception
        Friction and wind that a scheduler receives, see `PerceptionSource`.
    failure
        Limits beyond which the run fails; by default those of the car (`FailureLimits.of`). A failure ends the run:
        later samples are NaN, and `Trajectory.failed` and `Trajectory.failed_at` have its reason and time.
    predicted
        Recorder of the paths that an MPC predicts along a road.
    progress
        Function that is called every `PROGRESS_PERIODS` periods with the numbers of completed and of all periods.

    Raises
    ------
    InvalidInput
        When arguments do not match each other.
    """
    mover = RequestedForces() if controller.requests_forces else driver
    world = World.of(plant, controller, profile, mover, perception, failure)
    has_no_vy = not controller.replaces_vy and math.isinf(world.profile.noise_vy)
    controller.reset()
    controller.begin(scenario)
    controller.user = object()  # a tracker with this controller refuses to go on
    called = CalledController(controller)

    def step() -> None:
        """Step the controller at an instant."""
        k, instant = loop.instant, loop.sensed
        if has_no_vy:
            instant.measured[MEASUREMENT.vy] = 0.0  # the car has no sensor for the lateral velocity
        before = loop.command
        start_time = time.perf_counter()
        uses_road = loop.road is not None and controller.sees_road
        road_ahead: dict[str, Any] = {"road": loop.road_ahead(instant.speed)} if uses_road else {}
        answered = called.step(
            before, instant.measured, instant.speed, instant.reference, instant.variables, **road_ahead
        )
        record.times[k] = time.perf_counter() - start_time
        answer = called.write(answered, before, loop.answer)
        record.record(k, answer)
        if controller.requests_forces:
            loop.request_forces(answered.longitudinal)
        if loop.request is not None:
            record.requests[k] = _request_row(loop.request, loop.speed_control)
        if predicted is not None and not answer.held:
            predicted.record(k * world.period, controller, road_ahead.get("road"))
        if not math.isfinite(answer.angle):
            warn_once(f"adaptrack: the run ends: {called.call.refusal(answered)}")

    loop = ClosedLoop(world, scenario, seed, controller, step, traced=True)
    signals, trace = loop.signals, loop.run.trace
    record = _Recorder(signals.n, controller, trace.state[0], trace.signals[0], trace.answer[0])
    for k in range(0, signals.n, PROGRESS_PERIODS):
        if progress is not None:
            progress(k, signals.n)
        loop.roll_on(PROGRESS_PERIODS)
        if loop.ended:
            break
    if progress is not None:
        progress(signals.n, signals.n)
    record.failed, record.failed_at = loop.failure
    record.counted = dict(controller.scheduler_counts)
    return _trajectory(world, controller, scenario, signals, seed, record)


@checked
def rollout(
    plant: BatchPlant,
    controller: Controller,
    scenario: DriveArgument,
    *,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seed: Annotated[Natural, Field(lt=2**63)] = 0,
    perception: PerceptionSource = None,
    failure: FailureLimits | None = None,
) -> Trajectory:
    """Simulate one run in the compiled kernels.

    Arguments and result are those of `simulate`, but the trajectory has no computation times.

    Raises
    ------
    InvalidInput
        When a component needs Python at every step, such as a `SteppedPlant`, or a controller, scheduler or QP solver
        outside the kernels.
    """
    batch = Batch(plant, controller, [scenario], profile, driver, failure, perception)
    return rollouts(batch, (seed,), threads=1)[0][0]


def rollouts(batch: Batch, seeds: Sequence[int], threads: int | None = None) -> list[list[Trajectory]]:
    """Simulate each scenario of a batch with each noise seed, as `rollout` does, in parallel.

    The result has one list per scenario with one trajectory per seed. threads: None for one per core.
    """
    count = len(batch.signals)
    scenario_indices = np.repeat(np.arange(count), len(seeds))
    run_seeds = np.tile(np.array(seeds, dtype=np.int64), count)
    tunings = np.repeat(batch.tuning[None], len(scenario_indices), axis=0)
    runs = batch.run(scenario_indices, tunings, run_seeds, threads, traced=True, scheduler=batch.scheduler)
    trajectories = [
        _batch_trajectory(batch, runs, i, int(k), int(seed))
        for i, (k, seed) in enumerate(zip(scenario_indices, run_seeds, strict=True))
    ]
    return [trajectories[first : first + len(seeds)] for first in range(0, len(trajectories), len(seeds))]


def _batch_trajectory(batch: Batch, runs: BatchRuns, i: int, k: int, seed: int) -> Trajectory:
    """Return the trajectory of run i of a batch, which drives scenario k."""
    controller, n = batch.controller, batch.signals[k].n
    trace = runs.trace
    result, answer = runs.result[i], trace.answer[i, :n]
    state, signals = trace.state[i, :n].copy(), trace.signals[i, :n].copy()
    record = _Recorder(n, controller, state, signals, answer)
    columns = dict(zip(controller.answer_columns, answer[:, 3:].T, strict=True))
    for j, name in enumerate(record.tuning_names):
        record.tuning[:, j] = columns["tuning", name]
    for j, name in enumerate(record.diagnostic_names):
        record.diagnostics[:, j] = columns["diagnostics", name]
    record.failed, record.failed_at = failure_of(int(result.ended), float(result.ended_at))
    record.counted = {name: int(values[i]) for name, values in runs.counts.items()}
    return _trajectory(batch.world, controller, batch.scenarios[k], batch.signals[k], seed, record)


# -- the trajectory ---------------------------------------------------------------------------------------------------
_REQUEST_UNITS = {
    "requested_acceleration": "m/s^2", "requested_force": "N", "target_speed": "m/s", "governed_speed": "m/s",
    "grip_used": "-", "speed_state": "-", "limited_by": "-", "friction_low": "-", "friction_high": "-",
    "friction_age": "m",
}  # fmt: skip
"""Signals of a speed controller by their names in `Trajectory.diagnostics`, with their units."""
_MOTION = ("X", "Y", "psi", "vx", "vy", "yaw_rate")
"""The first entries of `core.plants.contract.PLANT_STATE` by their names in `Trajectory`."""
_STATES, _LIMITS = tuple(SpeedState), tuple(SpeedLimit)
_WHOLE = {"Np", "Nc", "qp_status", "qp_iterations", "at_limit"}
_UNITS = {
    "tuning.Q": "1/m^2", "tuning.R": "1/rad^2", "diagnostics.dead_reckoning": "s", "road.station": "m",
    "road.offset": "m", "road.heading_error": "rad", "road.curvature": "1/m", "road.planned_speed": "m/s",
    "diagnostics.longitudinal_acceleration": "m/s^2", "diagnostics.late": "s",
    **{f"diagnostics.{name}": unit for name, unit in _REQUEST_UNITS.items()},
    **{f"diagnostics.{name}{end}": unit for end in ("", "_sigma") for name, unit in (
        ("belief_lag", "s"), ("belief_dead_time", "s"), ("belief_delay", "s"), ("belief_bias", "rad"),
        ("belief_bank", "m/s^2"), ("used_lag", "s"), ("used_dead_time", "s"), ("used_bias", "rad"),
    )},
}  # fmt: skip


def _request_row(request: SpeedCommand, control: SpeedController | None) -> tuple[float, ...]:
    """Return the values of `_REQUEST_UNITS`; control: that of `SpeedControl`, None for a driver of your own."""
    return (
        request.acceleration, request.force - request.hold, request.target_speed,
        math.nan if control is None else control.governed_speed, request.grip_used, _place(_STATES, request.state),
        _place(_LIMITS, request.limited_by), request.friction_low, request.friction_high, request.friction_age,
    )  # fmt: skip


def _place(members: Sequence[object], member: object) -> float:
    """Return the place of a member; NaN if it is none."""
    return float(members.index(member)) if member in members else math.nan


def _columns_by_name(names: tuple[str, ...], columns: Array, is_driven: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """Return the columns by name, whole-number quantities as integers.

    At instants without a command, the QP status is `QPStatus.NON_FINITE`.
    """
    columns_by_name: dict[str, NDArray[Any]] = {}
    for name, values in zip(names, columns.T, strict=True):
        columns_by_name[name] = np.nan_to_num(values, nan=0.0).astype(np.int64) if name in _WHOLE else values.copy()
        if name == "qp_status" and not is_driven.all():
            columns_by_name[name][~is_driven] = QPStatus.NON_FINITE
    return columns_by_name


def _true_values(world: World, controller: Controller) -> dict[str, Any]:
    """Return the true values of the quantities that a learning controller estimates (`Learner.truth`)."""
    learner, steering = controller.learner, world.steering
    if learner is None:
        return {}
    dead_time = sum(world.dead_periods) * world.period - learner.computation  # s, without computation
    return {"truth": learner.truth(steering.replace(dead_time=max(dead_time, 0.0)), world.plant)}


def _trajectory(
    world: World, controller: Controller, scenario: Scenario | RoadDrive, signals: Signals, seed: int, record: _Recorder
) -> Trajectory:
    n, plant, motion = signals.n, world.plant, dict(zip(_MOTION, record.state.T, strict=False))
    is_driven = np.isfinite(record.command[:, 0])
    description, failure_distance = controller.describe(), FailureLimits.of(plant).distance
    road = {}
    if isinstance(scenario, RoadDrive):
        first = TRACE_SIGNALS.station
        road = dict(zip(TRACE_SIGNALS._fields[first:], record.signals[:, first:].T, strict=True))
        place = np.nan_to_num(road["station"])
        road["curvature"] = scenario.road.at(place).curvature
        road["planned_speed"] = np.where(np.isfinite(road["station"]), scenario.plan.at(place), np.nan)
    diagnostics = _columns_by_name(record.diagnostic_names, record.diagnostics, is_driven)
    if np.isfinite(record.requests).any():
        diagnostics |= dict(zip(_REQUEST_UNITS, record.requests.T, strict=True))
        change = np.gradient(motion["vx"], signals.period) if n > 1 else np.zeros(n)
        diagnostics["longitudinal_acceleration"] = change - motion["vy"] * motion["yaw_rate"]
    groups = {"tuning": record.tuning_names, "diagnostics": diagnostics, "road": road}
    recorded = {f"{group}.{name}" for group, names in groups.items() for name in names}
    return Trajectory(
        t=signals.t[:n],
        **motion,
        steering=record.signals[:, 1],
        command=record.command[:, 0],
        command_change=record.command[:, 1],
        y_ref=signals.y_ref[:n],
        v_ref=signals.speed[:n],
        friction=signals.friction[:n],
        wind=signals.wind[:n],
        lateral_acceleration=record.signals[:, 0],
        held=np.nan_to_num(record.command[:, 2], nan=1.0) > 0.5,
        step_time=record.times,
        period=signals.period,
        tuning=_columns_by_name(record.tuning_names, record.tuning, is_driven),
        diagnostics=diagnostics,
        road=road,
        units={key: unit for key, unit in _UNITS.items() if key in recorded},
        failed=record.failed,
        failed_at=record.failed_at,
        meta=provenance(
            datetime.now(UTC),
            scenario=scenario.name,
            plant=plant.name,
            tyre=plant.tyre_name,
            vehicle=getattr(getattr(plant, "vehicle", None), "name", plant.name),
            profile=world.profile.name,
            seed=seed,
            preview=bool(description.get("preview", False)),
            controller=controller.name,
            tuning=description.get("tuning", {}),
            move_weight=world.profile.move_weight,
            control=description,
            speed="driver" if world.has_driver(scenario) else "profile",
            scheduler_counts=record.counted,
            **({} if failure_distance == DISTANCE else {"failure_distance": failure_distance}),
            **_true_values(world, controller),
        ),
    )
