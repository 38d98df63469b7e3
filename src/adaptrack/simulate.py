"""One closed-loop run, from Python or compiled.

`simulate` loops in Python, so any controller, plant, scheduler or QP back-end can take part. `rollout` runs the same
control periods inside the kernels, as `batch.rollout_batch` does for many runs. All call the same pieces
(`kernels.loop`) in the same order and give the same trajectory.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.batch import Batch, BatchRuns
from adaptrack.controllers import MPC, CompiledController, Controller
from adaptrack.errors import InvalidInput, whole
from adaptrack.estimation import FrictionWindEstimator
from adaptrack.failure import DISTANCE, Failure
from adaptrack.plant import Plant, SteppedPlant
from adaptrack.profile import Profile
from adaptrack.road import Road
from adaptrack.road.ahead import RoadAhead, pack_roads
from adaptrack.scenario import RoadDrive, Scenario, Signals
from adaptrack.scheduling.variables import SchedulingVariables
from adaptrack.trajectory import Origin, Trajectory, provenance
from adaptrack.world import Driver, KnownAs, World, reason_of

Array = NDArray[np.float64]


def _refuse_nonsense(scenario: Scenario | RoadDrive, seed: int) -> None:
    if not isinstance(scenario, Scenario | RoadDrive):
        raise InvalidInput(
            f"scenario = {scenario!r}: must be a Scenario or a RoadDrive; load_scenario(name) and "
            "RoadDrive(load_road(file), speed) give one."
        )
    if whole("simulate", "seed", seed, least=0) >= 2**63:
        raise InvalidInput(f"seed = {seed!r}: must be below 2^63.")


LONGEST_PREVIEW = 400
"""Control instants for which a controller in Python is told the speed ahead."""


class _CompiledVehicle:
    """A compiled plant in slot 0 of a block."""

    def __init__(self, world: World, settings: Any, start: Array) -> None:
        from adaptrack.kernels.plants.contract import place, vehicle_batch

        assert isinstance(world.plant, Plant)
        self._compiled = world.plant.compiled
        self._arrays = vehicle_batch(world.plant.packed(), start[None])
        self.block = self._arrays.block
        place(1, self._arrays.start, self.block, self._arrays.states)

    def observe(self, seen: Array) -> None:
        """Write lateral acceleration and front-wheel angle under the present input."""
        v = self._arrays
        self._compiled.observe(v.parameters, v.block, v.states, v.work, 0, seen)

    def advance(self, steps: int, h: float) -> None:
        """Move on by so many steps of h (s)."""
        v = self._arrays
        self._compiled.advance(v.parameters, v.block, v.states, v.work, 1, steps, h)


class _SteppedVehicle:
    """A stepped plant behind the loop's steering actuator; its motion is kept in slot 0 of a block."""

    def __init__(self, world: World, settings: Any, start: Array) -> None:
        from adaptrack.kernels.plants import contract

        assert isinstance(world.plant, SteppedPlant)
        self._plant, self._steering = world.plant, world.steering
        self._mass = world.plant.powertrain["mass"]
        self._contract = contract
        self.block = np.zeros(contract.BLOCK)
        self._state = self.block[: contract.STATES * contract.SLOTS : contract.SLOTS]
        self._input = self.block[contract.STATES * contract.SLOTS :: contract.SLOTS]
        self._lateral = 0.0
        self._state[:6] = start
        world.plant.reset(start.copy())

    def observe(self, seen: Array) -> None:
        """Lateral acceleration over the last steps, and the front-wheel angle under the present input."""
        seen[0], seen[1] = self._lateral, self._angle(0.0)

    def _angle(self, time: float) -> float:
        """The front-wheel angle (rad) after a time (s) under the present command."""
        command = float(np.clip(self._input[0], -self._steering.limit, self._steering.limit))
        angle = float(self._state[self._contract.STATE.steering])
        if self._steering.lag <= 0.0:
            return command
        gap, limited = command - angle, 0.0
        if abs(gap) > self._steering.rate * self._steering.lag:  # at the rate limit until the gap is small enough
            limited = min(time, abs(gap) / self._steering.rate - self._steering.lag)
            gap -= math.copysign(self._steering.rate * limited, gap)
        return command - gap * math.exp((limited - time) / self._steering.lag)

    def advance(self, steps: int, h: float) -> None:
        """Move on by so many steps of h (s)."""
        names = self._contract.INPUT
        force, acceleration = self._input[names.force], self._input[names.acceleration]
        wanted = force / self._mass if math.isnan(acceleration) else acceleration
        environment = self._input[names.friction_front_left :].copy()
        before = self._state[:6].copy()
        for _ in range(steps):
            middle, after = self._angle(0.5 * h), self._angle(h)
            motion = np.asarray(self._plant.step(h, middle, float(wanted), environment), dtype=np.float64)
            if motion.shape != (6,):
                raise InvalidInput(f"plant {self._plant.name!r}: step() gave {motion!r}: must be six numbers.")
            self._state[:6] = motion
            self._state[self._contract.STATE.steering] = after if self._steering.lag > 0.0 else 0.0
        turn = 0.5 * (before[3] * before[5] + self._state[3] * self._state[5])
        self._lateral = (self._state[4] - before[4]) / (steps * h) + turn - self._input[names.bank]


class _Recorder:
    """What one run leaves: a row for each control instant."""

    def __init__(self, n: int, controller: Controller) -> None:
        from adaptrack.kernels.plants.contract import STATES

        self.tuning_names = tuple(getattr(controller, "tuning_names", ()))
        self.diagnostic_names = tuple(getattr(controller, "diagnostic_names", ()))
        self.state = np.full((n, STATES), np.nan)
        self.command = np.full((n, 3), np.nan)  # command, its change, held
        self.tuning = np.full((n, len(self.tuning_names)), np.nan)
        self.diagnostics = np.full((n, len(self.diagnostic_names)), np.nan)
        self.seen = np.full((n, 5), np.nan)  # as in `kernels.rollout.Trace`
        self.times = np.full(n, np.nan)
        self.failed: str | None = None
        self.failed_at = math.nan
        self.counted: dict[str, int] = {}

    def take(self, k: int, answer: Any, before: float) -> float:
        """Keep the answer of step k; its command (rad). before: the last command (rad)."""
        angle = float(getattr(answer, "angle", answer))
        self.command[k] = angle, angle - before, bool(getattr(answer, "held", False))
        tuning, diagnostics = getattr(answer, "tuning", ()), getattr(answer, "diagnostics", ())
        if isinstance(diagnostics, dict):
            diagnostics = [diagnostics.get(name, math.nan) for name in self.diagnostic_names]
        if len(self.tuning_names):
            self.tuning[k] = tuning
        if len(self.diagnostic_names):
            self.diagnostics[k] = diagnostics
        return angle


def simulate(
    plant: Plant | SteppedPlant,
    controller: Controller,
    scenario: Scenario | RoadDrive,
    *,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seed: int = 0,
    known_as: KnownAs = None,
    failure: Failure | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Drive a scenario, or along a road, with a controller.

    profile: `paper` (ideal), `road` (steering actuator, noise, delay) or one's own; driver: None to follow the speed
    profile exactly, else the longitudinal driver that moves the vehicle with its powertrain; seed: of the sensor
    noise; known_as: how a scheduler knows friction and wind; failure: when the run has failed, by default as the
    driven car's domain says (`Failure.of`): it ends there, its rest NaN, `Trajectory.failed` and `failed_at` say why
    and when; progress: called now and then with (periods done, periods in all).

    Raises
    ------
    InvalidInput
        When an argument does not fit the others.
    """
    from adaptrack.kernels import loop
    from adaptrack.kernels.models.contract import MEASURED
    from adaptrack.kernels.plants.contract import SLOTS, STATES
    from adaptrack.kernels.variables import VARIABLES

    world = World.of(plant, controller, profile, driver, known_as, failure)
    _refuse_nonsense(scenario, seed)
    signals = scenario.sample(controller.period)
    samples = world.samples(signals, 0)
    rows = samples[None]
    settings = world.settings(world.substeps(float(signals.speed.max())))
    vehicle = (_SteppedVehicle if isinstance(world.plant, SteppedPlant) else _CompiledVehicle)(
        world, settings, world.start(scenario, signals)
    )
    record, memory = _Recorder(signals.n, controller), world.memory(1)
    block, own = vehicle.block, memory.own[0]
    measured, look = np.zeros(len(MEASURED)), np.zeros(len(VARIABLES))
    felt = np.zeros(2)
    before, after = loop.substeps_around_change(settings)
    share = float(settings[0].dead_share)
    seen = measured if getattr(controller, "sees_all_sensors", False) else measured[:4]
    estimator = known_as if isinstance(known_as, FrictionWindEstimator) else None
    if estimator is not None:
        estimator.reset()
    controller.reset()
    road = getattr(scenario, "road", None)
    roads = pack_roads([road])
    for k in range(signals.n):
        if progress is not None and k % 64 == 0:
            progress(k, signals.n)
        record.state[k] = block[: STATES * SLOTS : SLOTS]
        loop.locate(0, block, settings, rows, 0, roads, memory)
        error = own.offset - samples[0, k]
        own.arrived = own.arrived or abs(error) <= world.failure.distance
        own.ended = loop.judge(error, block, 0, settings, bool(own.arrived))
        if own.ended != loop.RUNNING:
            own.ended_at = k * signals.period
            break
        if settings[0].noise_lateral_acceleration < math.inf:
            vehicle.observe(felt)
            measured[MEASURED.lateral_acceleration] = felt[0]
        speed = float(loop.sense(k, 0, block, settings, seed, memory, measured))
        loop.look(k, speed, measured, rows, 0, look)
        if estimator is not None:
            found = estimator.step(measured[:4], speed, own.command)
            look[VARIABLES.friction], look[VARIABLES.wind] = found.friction, found.wind
        if isinstance(controller, CompiledController) and math.isinf(world.profile.noise_vy):
            measured[MEASURED.vy] = 0.0  # a car without a sensor of it
        variables = SchedulingVariables(*look.tolist())
        begun = time.perf_counter()
        ahead: dict[str, Any] = {}
        if road is not None:
            ahead["road"] = _seen_ahead(road, own.station, speed, signals.speed[k:])
        answer = controller.step(seen, speed, samples[0, k:], variables, **ahead)
        record.times[k] = time.perf_counter() - begun
        command = record.take(k, answer, float(own.command))
        if not math.isfinite(command):
            own.ended, own.ended_at = loop.NOT_FINITE, k * signals.period
            break
        loop.actuate(k, 0, command, block, settings, rows, 0, memory)
        vehicle.observe(record.seen[k])
        record.seen[k, 2:] = own.station, own.offset, own.heading_error
        if before:
            vehicle.advance(before, share * signals.period / before)
            loop.change_command(1, block, settings, memory)
        vehicle.advance(after, (1.0 - share) * signals.period / after)
    if progress is not None:
        progress(signals.n, signals.n)
    if not own.arrived:
        own.ended, own.ended_at = loop.NEVER_ARRIVED, 0.0
    record.failed, record.failed_at = _failure_of(int(own.ended), float(own.ended_at))
    record.counted = dict(getattr(controller, "scheduler_counts", {}))
    return _trajectory(world, controller, scenario, signals, seed, record)


def _seen_ahead(road: Road, station: float, speed: float, planned: Array) -> RoadAhead:
    """The road ahead of a car that passes it as planned, from its present speed (m/s) on."""
    speeds = planned[:LONGEST_PREVIEW] + (speed - planned[0])
    return RoadAhead(road, float(station), np.maximum(speeds, 0.0))


def _failure_of(ended: int, at: float) -> tuple[str | None, float]:
    reason = reason_of(ended)
    return reason, at if reason is not None else math.nan


def rollout(
    plant: Plant,
    controller: Controller,
    scenario: Scenario | RoadDrive,
    *,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seed: int = 0,
    known_as: KnownAs = None,
    failure: Failure | None = None,
) -> Trajectory:
    """`simulate`, compiled: the same trajectory, without the step times.

    Raises
    ------
    InvalidInput
        When a part needs Python at every step: a stepped plant, a controller, a scheduler or a QP back-end outside the
        kernels.
    """
    _refuse_nonsense(scenario, seed)
    return rollouts(Batch(plant, controller, [scenario], profile, driver, failure, known_as), (seed,), threads=1)[0][0]


def rollouts(batch: Batch, seeds: Sequence[int], threads: int | None = None) -> list[list[Trajectory]]:
    """`rollout` of each scenario of a batch (outer list) with each noise seed (inner list), vectorised.

    threads: None for all cores.
    """
    count = len(batch.signals)
    which = np.repeat(np.arange(count), len(seeds))
    seeded = np.tile(np.array(seeds, dtype=np.int64), count)
    tunings = np.repeat(batch.tuning[None], len(which), axis=0)
    runs = batch.run(
        which, tunings, seeded, threads or os.cpu_count() or 1, traced=True, scheduler=batch.scheduler
    )  # fmt: skip
    each = [_traced(batch, runs, i, int(k), int(seed)) for i, (k, seed) in enumerate(zip(which, seeded, strict=True))]
    return [each[first : first + len(seeds)] for first in range(0, len(each), len(seeds))]


def _traced(batch: Batch, runs: BatchRuns, i: int, k: int, seed: int) -> Trajectory:
    """The i-th of the runs, of scenario k."""
    controller, n = batch.controller, batch.signals[k].n
    record = _Recorder(n, controller)
    found, T = runs.result[i], len(record.tuning_names)
    trace = runs.trace
    record.state[:], record.seen[:], answer = trace.state[i, :n], trace.seen[i, :n], trace.answer[i, :n]
    record.command[:] = answer[:, :3]
    if isinstance(controller, MPC):
        record.tuning[:], record.diagnostics[:] = answer[:, 3 : 3 + T], answer[:, 3 + T :]
    else:
        D = len(record.diagnostic_names)
        record.diagnostics[:], record.tuning[:] = answer[:, 3 : 3 + D], answer[:, 3 + D :]
    record.failed, record.failed_at = _failure_of(int(found.ended), float(found.ended_at))
    record.counted = {name: int(values[i]) for name, values in runs.counts.items()}
    return _trajectory(batch.world, controller, batch.scenarios[k], batch.signals[k], seed, record)


# -- the trajectory ---------------------------------------------------------------------------------------------------
_WHOLE = {"Np", "Nc", "qp_status", "qp_iterations", "at_limit"}
_UNITS = {
    "tuning.Q": "1/m^2", "tuning.R": "1/rad^2", "diagnostics.dead_reckoning": "s", "road.station": "m",
    "road.offset": "m", "road.heading_error": "rad", "road.curvature": "1/m",
    **{f"diagnostics.{name}{end}": unit for end in ("", "_sigma") for name, unit in (
        ("belief_lag", "s"), ("belief_dead_time", "s"), ("belief_delay", "s"), ("belief_bias", "rad"),
        ("belief_bank", "m/s^2"), ("used_lag", "s"), ("used_dead_time", "s"), ("used_bias", "rad"),
    )},
}  # fmt: skip


def _named(names: tuple[str, ...], columns: Array, driven: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
    """The columns by name; of quantities that are whole numbers as such, the QP's status where nothing was driven
    being that of data that are not finite.
    """
    found: dict[str, NDArray[Any]] = {}
    for name, values in zip(names, columns.T, strict=True):
        found[name] = np.nan_to_num(values, nan=0.0).astype(np.int64) if name in _WHOLE else values.copy()
        if name == "qp_status" and not driven.all():
            from adaptrack.qp import QPStatus

            found[name][~driven] = QPStatus.NON_FINITE
    return found


def _learned(world: World, controller: Controller) -> dict[str, Any]:
    """What a controller that learns was there to learn (`Learner.truth`)."""
    learner = getattr(controller, "learner", None)
    return {} if learner is None else {"truth": learner.truth(world.steering, world.plant)}


def _trajectory(
    world: World, controller: Controller, scenario: Scenario | RoadDrive, signals: Signals, seed: int, record: _Recorder
) -> Trajectory:
    from adaptrack.kernels.plants.contract import STATE

    n, state, plant = signals.n, record.state, world.plant
    driven = np.isfinite(record.command[:, 0])
    described = controller.describe()
    road = {}
    if isinstance(scenario, RoadDrive):
        road = dict(zip(("station", "offset", "heading_error"), record.seen[:, 2:].T, strict=True))
        road["curvature"] = scenario.road.at(np.nan_to_num(road["station"])).curvature
    groups = {"tuning": record.tuning_names, "diagnostics": record.diagnostic_names, "road": road}
    held = {f"{group}.{name}" for group, names in groups.items() for name in names}
    return Trajectory(
        t=signals.t[:n],
        X=state[:, STATE.x],
        Y=state[:, STATE.y],
        psi=state[:, STATE.yaw],
        vx=state[:, STATE.vx],
        vy=state[:, STATE.vy],
        yaw_rate=state[:, STATE.yaw_rate],
        steering=record.seen[:, 1],
        command=record.command[:, 0],
        command_change=record.command[:, 1],
        y_ref=signals.y_ref[:n],
        v_ref=signals.speed[:n],
        friction=signals.friction[:n],
        wind=signals.wind[:n],
        lateral_acceleration=record.seen[:, 0],
        held=np.nan_to_num(record.command[:, 2], nan=1.0) > 0.5,
        step_time=record.times,
        period=signals.period,
        tuning=_named(record.tuning_names, record.tuning, driven),
        diagnostics=_named(record.diagnostic_names, record.diagnostics, driven),
        road=road,
        units={key: unit for key, unit in _UNITS.items() if key in held},
        failed=record.failed,
        failed_at=record.failed_at,
        meta=provenance(
            Origin(
                scenario=scenario.name,
                plant=plant.name,
                tyre=plant.tyre_name,
                vehicle=getattr(getattr(plant, "vehicle", None), "name", plant.name),
                profile=world.profile.name,
                seed=seed,
                preview=bool(described.get("preview", False)),
                controller=controller.name,
                tuning=described.get("tuning", {}),
            ),
            datetime.now(UTC),
            move_weight=world.profile.move_weight,
            control=described,
            speed="profile" if world.driver is None else "driver",
            scheduler_counts=record.counted,
            **_failure_distance(plant),
            **_learned(world, controller),
        ),
    )


def _failure_distance(plant: Plant | SteppedPlant) -> dict[str, float]:
    """What a record says of the car's own failure distance (m), where it is not the usual one."""
    own = Failure.of(plant).distance
    return {} if own == DISTANCE else {"failure_distance": own}
