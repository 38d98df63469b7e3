"""Closed-loop runs: one at a time from Python, or thousands compiled.

`simulate` loops in Python, so any controller, plant, scheduler or QP back-end can take part. `rollout` and
`rollout_batch` run the same control periods inside the kernels. Both call the same pieces (`kernels.loop`) in the same
order and give the same trajectory.
"""

from __future__ import annotations

import math
import os
import queue
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.controllers import MPC, CompiledController, CompiledScheduler, Controller
from adaptrack.errors import InvalidInput, whole
from adaptrack.estimation import FrictionWindEstimator, Perception
from adaptrack.failure import Failure, Reason
from adaptrack.plant import Plant, SteppedPlant
from adaptrack.profile import Profile, load_profile
from adaptrack.scenario import Scenario, Signals
from adaptrack.scheduling.variables import SchedulingVariables, reference_preview
from adaptrack.trajectory import Trajectory, provenance
from adaptrack.vehicle import SteeringActuator

Array = NDArray[np.float64]
KnownAs = Perception | FrictionWindEstimator | None
"""How a scheduler knows friction and wind: exactly (None), with errors, or as an estimator finds them."""


@dataclass(frozen=True)
class Driver:
    """Longitudinal driver: asks for the acceleration that reaches the profile's speed a preview time ahead.

    dv = (v_ref(t + preview) - v_x)/preview + integral * (integral of v_ref - v_x), times the mass, within engine
    power, traction and brakes.
    """

    preview: float = 0.5
    """s"""
    integral: float = 0.2
    """1/s^2"""

    def __post_init__(self) -> None:
        if not 0.0 < self.preview < math.inf or not 0.0 <= self.integral < math.inf:
            raise InvalidInput(f"Driver: preview = {self.preview!r} s must be positive, integral not negative.")


# -- what both drivers share ------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class World:
    """Everything around the controller that all runs of a batch share."""

    plant: Plant | SteppedPlant
    """behind its steering"""
    profile: Profile
    period: float
    """s, of the controller"""
    driver: Driver | None
    known_as: KnownAs
    failure: Failure

    @classmethod
    def of(
        cls, plant: Plant | SteppedPlant, controller: Controller, profile: str | Profile, driver: Driver | None,
        known_as: KnownAs, failure: Failure | None,
    ) -> World:  # fmt: skip
        """The world of a controller.

        Raises
        ------
        InvalidInput
            When the parts do not fit each other.
        """
        if not isinstance(plant, Plant | SteppedPlant):
            raise InvalidInput(f"plant = {plant!r}: must be a Plant, such as DualTrack(load_vehicle('paper')).")
        if not callable(getattr(controller, "step", None)):
            raise InvalidInput(
                f"controller = {controller!r}: must be a controller, such as MPC(load_vehicle('paper'))."
            )
        profile = load_profile(profile)
        if isinstance(plant, Plant) and getattr(plant, "steering", None) is None:
            plant = plant.with_steering(profile.steering)
        if failure is not None and not isinstance(failure, Failure):
            raise InvalidInput(f"failure = {failure!r}: must be a Failure(distance=..., sideslip=...).")
        if isinstance(known_as, FrictionWindEstimator) and not math.isclose(known_as.period, controller.period):
            raise InvalidInput(
                f"known_as: the estimator's period is {known_as.period!r} s, the controller's {controller.period!r} s: "
                "both run at the same instants."
            )
        return cls(plant, profile, controller.period, driver, known_as, failure or Failure())

    @property
    def steering(self) -> SteeringActuator:
        """The actuator between command and wheels."""
        return getattr(self.plant, "steering", None) or self.profile.steering

    def substeps(self, top_speed: float) -> int:
        """Integration steps per control period up to a speed (m/s)."""
        if isinstance(self.plant, SteppedPlant):
            return math.ceil(self.period / self.plant.longest_step - 1e-9)
        return self.plant.substeps(self.period, top_speed)

    def settings(self, substeps: int) -> Any:
        """`kernels.loop.SETTINGS`; without a driver the speed follows its profile exactly."""
        from adaptrack.kernels import loop

        profile, driver, steering = self.profile, self.driver, self.steering
        return loop.SETTINGS.new(
            period=self.period,
            substeps=substeps,
            prescribed_speed=driver is None,
            delay=profile.delay,
            noise_vy=profile.noise_vy,
            noise_yaw=profile.noise_yaw,
            noise_yaw_rate=profile.noise_yaw_rate,
            noise_y=profile.noise_y,
            steering_lag=steering.lag,
            steering_limit=steering.limit,
            driver_preview=driver.preview if driver else 1.0,
            driver_integral=driver.integral if driver else 0.0,
            **self.plant.powertrain,  # type: ignore[arg-type]
            failure_distance=self.failure.distance,
            failure_sideslip=self.failure.sideslip,
        )

    def samples(self, signals: Signals, number: int) -> Array:
        """A scenario's samples as the kernels read them, (`kernels.loop.SIGNAL`, n + 1).

        number: of the scenario in its batch, from which errors of perception are drawn.
        """
        known = (signals.friction.mean(axis=1), signals.wind[:, 1])
        if isinstance(self.known_as, Perception):
            known = self.known_as.known(*known, signals.period, number)
        ahead = reference_preview(signals.y_ref, signals.period, len(signals.y_ref))
        return np.ascontiguousarray(
            np.vstack([signals.y_ref, signals.speed, signals.friction.T, signals.wind.T, *known, *ahead])
        )

    def start(self, scenario: Scenario, signals: Signals) -> Array:
        """All states of the plant at the start (n,): in equilibrium at the speed of the scenario."""
        motion = np.array([0.0, scenario.initial_y, scenario.start_heading, signals.speed[0], 0.0, 0.0])
        return motion if isinstance(self.plant, SteppedPlant) else self.plant.initial_state(motion)


def _refuse_nonsense(scenario: Scenario, seed: int) -> None:
    if not isinstance(scenario, Scenario):
        raise InvalidInput(f"scenario = {scenario!r}: must be a Scenario; load_scenario(name) gives one.")
    if whole("simulate", "seed", seed, least=0) >= 2**63:
        raise InvalidInput(f"seed = {seed!r}: must be below 2^63.")


def _reason(ended: int) -> str | None:
    """The name of what ended a run early; None for a run that came to its end, or that was stopped for its cost."""
    from adaptrack.kernels import loop

    return {
        loop.OFF_ROAD: Reason.OFF_ROAD.value,
        loop.NEVER_ARRIVED: Reason.OFF_ROAD.value,
        loop.SPUN: Reason.SPUN.value,
        loop.NOT_FINITE: Reason.NOT_FINITE.value,
    }.get(ended)


# -- one run, from Python ---------------------------------------------------------------------------------------------
class _CompiledVehicle:
    """A compiled plant in slot 0 of a block."""

    def __init__(self, world: World, settings: Any, start: Array) -> None:
        from adaptrack.kernels.plants.contract import place, vehicle_batch

        assert isinstance(world.plant, Plant)
        self._compiled, self._steps = world.plant.compiled, int(settings[0].substeps)
        self._h = world.period / self._steps
        self._arrays = vehicle_batch(world.plant.packed(), start[None])
        self.block = self._arrays.block
        place(1, self._arrays.start, self.block, self._arrays.states)

    def observe(self, seen: Array) -> None:
        """Write lateral acceleration and front-wheel angle under the present input."""
        v = self._arrays
        self._compiled.observe(v.parameters, v.block, v.states, v.work, 0, seen)

    def advance(self) -> None:
        """Move on by one control period."""
        v = self._arrays
        self._compiled.advance(v.parameters, v.block, v.states, v.work, 1, self._steps, self._h)


class _SteppedVehicle:
    """A stepped plant behind the loop's steering actuator; its motion is kept in slot 0 of a block."""

    def __init__(self, world: World, settings: Any, start: Array) -> None:
        from adaptrack.kernels.plants import contract

        assert isinstance(world.plant, SteppedPlant)
        self._plant, self._steering, self._period = world.plant, world.steering, world.period
        self._steps = int(settings[0].substeps)
        self._mass = world.plant.powertrain["mass"]
        self._contract = contract
        self.block = np.zeros(contract.BLOCK)
        self._state = self.block[: contract.STATES * contract.SLOTS : contract.SLOTS]
        self._input = self.block[contract.STATES * contract.SLOTS :: contract.SLOTS]
        self._lateral = 0.0
        self._state[:6] = start
        world.plant.reset(start.copy())

    def observe(self, seen: Array) -> None:
        """Lateral acceleration over the last period, and the front-wheel angle under the present input."""
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

    def advance(self) -> None:
        """Move on by one control period."""
        names, h = self._contract.INPUT, self._period / self._steps
        force, acceleration = self._input[names.force], self._input[names.acceleration]
        wanted = force / self._mass if math.isnan(acceleration) else acceleration
        environment = self._input[names.friction_front_left :].copy()
        before = self._state[:6].copy()
        for _ in range(self._steps):
            middle, after = self._angle(0.5 * h), self._angle(h)
            motion = np.asarray(self._plant.step(h, middle, float(wanted), environment), dtype=np.float64)
            if motion.shape != (6,):
                raise InvalidInput(f"plant {self._plant.name!r}: step() gave {motion!r}: must be six numbers.")
            self._state[:6] = motion
            self._state[self._contract.STATE.steering] = after if self._steering.lag > 0.0 else 0.0
        turn = 0.5 * (before[3] * before[5] + self._state[3] * self._state[5])
        self._lateral = (self._state[4] - before[4]) / self._period + turn


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
        self.seen = np.full((n, 2), np.nan)
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
    scenario: Scenario,
    *,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seed: int = 0,
    known_as: KnownAs = None,
    failure: Failure | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Drive a scenario with a controller.

    profile: `paper` (ideal), `road` (steering actuator, noise, delay) or one's own; driver: None to follow the speed
    profile exactly, else the longitudinal driver that moves the vehicle with its powertrain; seed: of the sensor
    noise; known_as: how a scheduler knows friction and wind; failure: when the run has failed, by default `Failure()`:
    it ends there, its rest NaN, `Trajectory.failed` and `failed_at` say why and when; progress: called now and then
    with (periods done, periods in all).

    Raises
    ------
    InvalidInput
        When an argument does not fit the others.
    """
    from adaptrack.kernels import guard, loop
    from adaptrack.kernels.models.contract import MEASURED
    from adaptrack.kernels.plants.contract import SLOTS, STATE, STATES

    world = World.of(plant, controller, profile, driver, known_as, failure)
    _refuse_nonsense(scenario, seed)
    signals = scenario.sample(controller.period)
    samples = world.samples(signals, 0)
    rows = samples[None]
    settings = world.settings(world.substeps(float(signals.speed.max())))
    vehicle = (_SteppedVehicle if isinstance(world.plant, SteppedPlant) else _CompiledVehicle)(
        world, settings, world.start(scenario, signals)
    )
    record, memory = _Recorder(signals.n, controller), loop.MEMORY.new()
    block, own = vehicle.block, memory[0]
    measured, look = np.zeros(len(MEASURED)), np.zeros(len(guard.VARIABLES))
    seen = measured if isinstance(controller, MPC) else measured[:4]  # its model or estimator may use the wheel angle
    estimator = known_as if isinstance(known_as, FrictionWindEstimator) else None
    if estimator is not None:
        estimator.reset()
    controller.reset()
    for k in range(signals.n):
        if progress is not None and k % 64 == 0:
            progress(k, signals.n)
        record.state[k] = block[: STATES * SLOTS : SLOTS]
        speed, error = float(block[STATE.vx * SLOTS]), block[STATE.y * SLOTS] - samples[0, k]
        own.arrived = own.arrived or abs(error) <= world.failure.distance
        own.ended = loop.judge(samples[0, k], block, 0, settings, bool(own.arrived))
        if own.ended != loop.RUNNING:
            own.ended_at = k * signals.period
            break
        loop.sense(k, 0, block, settings, seed, measured)
        loop.look(k, speed, measured, rows, 0, look)
        if estimator is not None:
            found = estimator.step(measured[:4], speed, own.command)
            look[guard.FRICTION], look[guard.WIND] = found.friction, found.wind
        variables = SchedulingVariables(*look.tolist())
        begun = time.perf_counter()
        answer = controller.step(seen, speed, samples[0, k:], variables)
        record.times[k] = time.perf_counter() - begun
        command = record.take(k, answer, float(own.command))
        if not math.isfinite(command):
            own.ended, own.ended_at = loop.NOT_FINITE, k * signals.period
            break
        loop.actuate(k, 0, command, block, settings, rows, 0, memory)
        vehicle.observe(record.seen[k])
        vehicle.advance()
    if progress is not None:
        progress(signals.n, signals.n)
    if not own.arrived:
        own.ended, own.ended_at = loop.NEVER_ARRIVED, 0.0
    record.failed, record.failed_at = _failure_of(int(own.ended), float(own.ended_at))
    record.counted = dict(getattr(controller, "scheduler_counts", {}))
    return _trajectory(world, controller, scenario, signals, seed, record)


def _failure_of(ended: int, at: float) -> tuple[str | None, float]:
    reason = _reason(ended)
    return reason, at if reason is not None else math.nan


def rollout(
    plant: Plant,
    controller: Controller,
    scenario: Scenario,
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
    batch = Batch(plant, controller, [scenario], profile, driver, failure, known_as)
    first = np.zeros(1, np.int64)
    runs = batch.run(first, batch.tuning[None], np.array([seed]), 1, traced=True, scheduler=batch.scheduler)
    record = _Recorder(batch.signals[0].n, controller)
    found, T = runs.result[0], len(record.tuning_names)
    record.state[:], record.seen[:], answer = runs.trace.state[0], runs.trace.seen[0], runs.trace.answer[0]
    record.command[:] = answer[:, :3]
    if isinstance(controller, MPC):
        record.tuning[:], record.diagnostics[:] = answer[:, 3 : 3 + T], answer[:, 3 + T :]
    else:
        D = len(record.diagnostic_names)
        record.diagnostics[:], record.tuning[:] = answer[:, 3 : 3 + D], answer[:, 3 + D :]
    record.failed, record.failed_at = _failure_of(int(found.ended), float(found.ended_at))
    record.counted = {name: int(values[0]) for name, values in runs.counts.items()}
    return _trajectory(batch.world, controller, scenario, batch.signals[0], seed, record)


# -- many runs, compiled ----------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class BatchResult:
    """What `rollout_batch` measured, an entry per run; arrays of shape (runs,)."""

    mse: Array
    """m^2, mean over the control instants of (Y - y_ref)^2; inf when the run has failed"""
    mean_squared_move: Array
    """rad^2, mean of the squared changes of the command"""
    max_abs_error: Array
    """m"""
    failed: NDArray[np.object_]
    """why a run failed (`failure.Reason`), None where it did not"""
    failed_at: Array
    """s, NaN where it did not"""
    steps: NDArray[np.int64]
    """control steps done"""
    qp_capped: NDArray[np.int64]
    """steps whose QP stopped at its cap"""
    qp_failed: NDArray[np.int64]
    """steps whose QP had no solution (infeasible, not finite, not convex)"""
    held: NDArray[np.int64]
    """steps without a new answer: the last plan was followed, or the angle held"""
    limited: NDArray[np.int64]
    """steps at a limit"""
    qp_iterations: NDArray[np.int64]
    """of the QP solver, in all steps"""
    scheduler: dict[str, NDArray[np.int64]]
    """what the scheduler counted, by name, see `kernels.guard.COUNTS`; empty without one"""

    def cost(self, move_weight: float = 0.0) -> Array:
        """J = mean e^2 + move_weight * mean (change of command)^2, the cost that tuning minimises; inf when failed."""
        return self.mse + move_weight * self.mean_squared_move


def rollout_batch(
    plant: Plant,
    controller: Controller,
    scenarios: Scenario | Sequence[Scenario],
    tunings: ArrayLike | None = None,
    *,
    which: ArrayLike | None = None,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seeds: ArrayLike = 0,
    known_as: KnownAs = None,
    failure: Failure | None = None,
    threads: int | None = None,
) -> BatchResult:
    """Many runs at once, compiled and vectorised: run i drives scenario which[i] with tunings[i] and seeds[i].

    controller: an `MPC`, or any compiled controller; tunings: (runs, entries) of its named tuning entries (Np, Nc, Q, R
    of an MPC, the horizons rounded and clamped to 1 <= Nc <= Np <= longest_horizon and most_moves); without them every
    run has the MPC's scheduler, or the controller's tuning; which: (runs,) indices into `scenarios`, by default 0,
    without tunings one run for each; seeds: noise seeds, one or one per run; threads: None for all cores. A run's
    result does not depend on the others, nor on the number of threads. The scenarios must last equally long.

    Raises
    ------
    InvalidInput
        When shapes do not fit, a tuning is not finite, tunings meet a scheduler, or a part needs Python at every step.
    """
    several = [scenarios] if isinstance(scenarios, Scenario) else scenarios
    batch = Batch(plant, controller, several, profile, driver, failure, known_as)
    if tunings is None:
        which = np.arange(len(batch.signals)) if which is None else which
        tunings = np.repeat(batch.tuning[None], np.size(which), axis=0)
    elif batch.scheduler is not None:
        raise InvalidInput("tunings: this MPC has a scheduler, which chooses them; leave them out.")
    asked = batch.checked_tunings(tunings)
    runs = len(asked)
    index = np.zeros(runs, np.int64) if which is None else np.array(which)
    if index.dtype.kind not in "iu":
        raise InvalidInput("which: must be whole numbers.")
    index = index.astype(np.int64)
    if index.shape != (runs,) or (runs and not (index.min() >= 0 and index.max() < len(batch.signals))):
        raise InvalidInput(f"which: need {runs} indices into {len(batch.signals)} scenarios.")
    seeded = np.array(seeds, dtype=np.int64)
    if seeded.shape not in ((), (runs,)):
        raise InvalidInput(f"seeds: need one, or one for each of the {runs} runs; got shape {seeded.shape}.")
    found = batch.run(
        index, asked, np.broadcast_to(seeded, (runs,)).copy(), threads or os.cpu_count() or 1, scheduler=batch.scheduler
    )
    return found.measured()


@dataclass(frozen=True, eq=False)
class BatchRuns:
    """What `Batch.run` gives."""

    result: Any
    """(runs,) `kernels.rollout.RESULT`"""
    trace: Any
    """`kernels.rollout.Trace`, empty unless asked for"""
    counts: dict[str, NDArray[np.int64]]
    """what the scheduler counted, (runs,) by name; empty without one"""
    segments: Array
    """(runs, segments) cost of each segment: sum of squared error plus weight times squared move; inf where a run ended
    early, NaN after that; (runs, 0) unless asked for"""

    @property
    def failed(self) -> NDArray[np.bool_]:
        """(runs,) whether the run failed."""
        return np.asarray(self.result["ended"] != 0)

    def measured(self) -> BatchResult:
        """By name, as means."""
        found = self.result
        steps = np.maximum(found["instants"], 1)
        reasons = [_reason(int(ended)) for ended in found["ended"]]
        return BatchResult(
            mse=found["squared_error"] / steps,
            mean_squared_move=found["squared_move"] / steps,
            max_abs_error=found["largest_error"].copy(),
            failed=np.array(reasons, dtype=object),
            failed_at=np.where(self.failed, found["ended_at"], np.nan),
            steps=found["instants"].copy(),
            qp_capped=found["capped"].copy(),
            qp_failed=found["unsolved"].copy(),
            held=found["held"].copy(),
            limited=found["limited"].copy(),
            qp_iterations=found["iterations"].copy(),
            scheduler=self.counts,
        )


class Batch:
    """What all runs of a batch share, packed for the kernels; arguments as for `rollout_batch`."""

    def __init__(
        self,
        plant: Plant,
        controller: Controller,
        scenarios: Sequence[Scenario],
        profile: str | Profile = "paper",
        driver: Driver | None = None,
        failure: Failure | None = None,
        known_as: KnownAs = None,
    ) -> None:
        self.world = World.of(plant, controller, profile, driver, known_as, failure)
        self.controller, self.scheduler = controller, getattr(controller, "scheduler", None)
        self._refuse_python()
        self.signals = [scenario.sample(controller.period) for scenario in scenarios]
        if not self.signals:
            raise InvalidInput("scenarios: none given.")
        if len({signals.n for signals in self.signals}) > 1:
            raise InvalidInput(
                "scenarios: must last equally long; run those of different length in batches of their own."
            )
        world = self.world
        self.samples = np.ascontiguousarray([world.samples(s, i) for i, s in enumerate(self.signals)])
        self.starts = np.array([world.start(scenario, s) for scenario, s in zip(scenarios, self.signals, strict=True)])
        self.substeps = np.array([world.substeps(float(s.speed.max())) for s in self.signals])
        self.settings = {int(steps): world.settings(int(steps)) for steps in np.unique(self.substeps)}

    def _refuse_python(self) -> None:
        controller = self.controller
        fit = isinstance(controller, CompiledController) or (isinstance(controller, MPC) and controller.in_kernel)
        scheduled = self.scheduler is None or isinstance(self.scheduler, CompiledScheduler)
        if not (fit and scheduled and isinstance(self.world.plant, Plant)):
            raise InvalidInput(
                "compiled runs need a compiled plant, an MPC or a compiled controller, a scheduler of "
                "adaptrack.scheduling, or none, and a QP solver of the kernels ('active-set', 'hildreth'); "
                "use simulate(...) for this one."
            )

    @property
    def tuning(self) -> Array:
        """(entries,) the controller's own tuning."""
        own = self.controller
        return own.packed_tuning() if isinstance(own, CompiledController) else own.tuning.as_array()  # type: ignore[attr-defined]

    def checked_tunings(self, tunings: ArrayLike) -> Array:
        """(runs, entries) tunings that a controller may have.

        Raises
        ------
        InvalidInput
            When they are none.
        """
        names = self.controller.tuning_names  # type: ignore[attr-defined]
        asked = np.array(tunings, dtype=np.float64, ndmin=2)
        if asked.ndim != 2 or asked.shape[1] != len(names) or not np.isfinite(asked).all():
            raise InvalidInput(
                f"tunings: need finite (runs, {len(names)}) of {', '.join(names)}; got shape {asked.shape}."
            )
        if isinstance(self.controller, MPC) and ((asked[:, 2] < 0.0).any() or (asked[:, 3] <= 0.0).any()):
            raise InvalidInput("tunings: every Q must be >= 0 and every R > 0.")
        return asked

    def mpc_settings(self, longest: float, most: float, residuals: bool) -> Any:
        """The MPC's settings with a workspace no larger than horizons up to these need; tiny for other controllers."""
        if isinstance(self.controller, MPC):
            return self.controller.settings(longest, most, residuals)
        from adaptrack.kernels.controllers.mpc import SETTINGS

        return SETTINGS.new(period=self.world.period, longest_horizon=1, most_moves=1, output_min=-np.inf,
                            output_max=np.inf)  # fmt: skip

    def arena(
        self, slots: int, steps: int, mpc_settings: Any, segments: int = 0, periods: int = 0,
        scheduler: CompiledScheduler | None = None,
    ) -> Any:  # fmt: skip
        """The kernels' arrays for up to `slots` runs that integrate `steps` times a period (`kernels.rollout.Run`).

        segments: of each run; periods: to trace, 0 for no trace.
        """
        from adaptrack.kernels import guard, loop, rollout
        from adaptrack.kernels.controllers import mpc as kernel
        from adaptrack.kernels.estimators.friction_wind import MEMORY as KNOWING
        from adaptrack.kernels.plants.contract import STATES, vehicle_batch
        from adaptrack.kernels.schedule import no_schedule

        own, known = self.controller, self.world.known_as
        assert isinstance(self.world.plant, Plant)
        if isinstance(own, CompiledController):
            mpc = kernel.batch(slots, mpc_settings, (np.zeros(6), np.arange(4), np.zeros(4)), (np.zeros(0), 0))
            law = rollout.law_batch(slots, own.parameters(), own.memory_size, own.diagnostic_names, own.preview)
            width = law.answer.shape[1] + len(own.tuning_names)
        else:
            assert isinstance(own, MPC)
            mpc, law = own.batch(slots, mpc_settings), rollout.no_law_batch()
            width = len(kernel.ANSWER)
        none = np.zeros(0)
        perceiving = rollout.Perceiving(none, none, np.zeros((0, 0)))
        if isinstance(known, FrictionWindEstimator):
            perceiving = rollout.Perceiving(known.packed(), known.settings(), np.zeros((slots, KNOWING)))
        traced = slots if periods else 0
        return rollout.Run(
            settings=self.settings[steps],
            vehicles=vehicle_batch(self.world.plant.packed(), np.zeros((slots, self.starts.shape[1]))),
            road=rollout.Road(self.samples, np.zeros(slots, np.int64), np.zeros(slots, np.int64)),
            mpc=mpc,
            law=law,
            schedule=no_schedule() if scheduler is None else scheduler.plan(slots),
            perceiving=perceiving,
            tuning=np.zeros((slots, len(self.tuning))),
            variables=np.zeros(len(guard.VARIABLES)),
            memory=loop.MEMORY.new(slots),
            result=rollout.RESULT.new(slots),
            ceiling=np.full(slots, np.inf),
            segments=np.zeros((slots, segments)),
            trace=rollout.Trace(
                np.full((traced, periods, STATES), np.nan), np.full((traced, periods, width), np.nan),
                np.full((traced, periods, 2), np.nan),
            ),
        )  # fmt: skip

    @property
    def members(self) -> tuple[Any, ...]:
        """`kernels.rollout.MEMBERS`."""
        from adaptrack.kernels.controllers.contract import no_law
        from adaptrack.kernels.estimators.contract import no_estimate
        from adaptrack.kernels.models.single_track import discretise

        assert isinstance(self.world.plant, Plant)
        plant, own = self.world.plant.compiled, self.controller
        if isinstance(own, MPC):
            return plant.advance, plant.observe, own.model.function, own.estimator.function or no_estimate, no_law
        return plant.advance, plant.observe, discretise, no_estimate, own.function  # type: ignore[attr-defined]

    def chunks(self, which: NDArray[np.int64]) -> list[NDArray[np.int64]]:
        """Runs that are driven together: the slots of one batch integrate with the same number of steps."""
        from adaptrack.kernels.plants.contract import SLOTS

        found = []
        for steps in self.settings:
            members = np.flatnonzero(self.substeps[which] == steps)
            found += [members[first : first + SLOTS] for first in range(0, len(members), SLOTS)]
        return found

    def longest(self, tunings: Array, scheduler: CompiledScheduler | None) -> tuple[float, float]:
        """The longest Np and Nc that runs with these tunings or this scheduler may ask for."""
        if not isinstance(self.controller, MPC):
            return 1.0, 1.0
        longest, most = tunings[:, 0].max(initial=1), tunings[:, 1].max(initial=1)
        if scheduler is not None:
            longest, most = max(longest, scheduler.largest[0]), max(most, scheduler.largest[1])
        return float(longest), float(most)

    def run(
        self, which: NDArray[np.int64], tunings: Array, seeds: NDArray[np.int64], threads: int, traced: bool = False,
        segment: int = 0, weight: float = 0.0, scheduler: CompiledScheduler | None = None,
    ) -> BatchRuns:  # fmt: skip
        """Drive run i with scenario which[i], tunings[i] and seeds[i]; a scheduler begins with the tuning.

        segment: periods of a segment whose cost is asked for, with `weight` (m^2/rad^2) on the squared moves; 0: none.
        """
        from adaptrack.kernels import guard, rollout

        runs, n = len(which), self.signals[0].n
        plan = _Plan(which, tunings, seeds, segment, weight, n if traced else 0, scheduler)
        longest = (math.inf, math.inf) if traced else self.longest(tunings, scheduler)
        settings = self.mpc_settings(*longest, residuals=traced)
        result, counts = rollout.RESULT.new(runs), np.zeros((len(guard.COUNTS), runs), np.int64)
        segments = np.zeros((runs, math.ceil(n / segment) if segment else 0))
        traces: dict[int, Any] = {}
        waiting: queue.SimpleQueue[NDArray[np.int64]] = queue.SimpleQueue()
        chunks = self.chunks(which)
        for chunk in chunks:
            waiting.put(chunk)

        def work() -> None:
            while True:
                try:
                    chunk = waiting.get_nowait()
                except queue.Empty:
                    return
                done = self._drive(chunk, plan, settings)
                result[chunk], segments[chunk] = done.result, done.segments
                if traced:
                    traces[int(chunk[0])] = done.trace
                if scheduler is not None:
                    counts[:, chunk] = [done.schedule.memory[name] for name in guard.COUNTS]

        workers = max(1, min(threads, len(chunks)))
        if workers == 1:
            work()
        else:
            with ThreadPoolExecutor(workers) as pool:
                for future in [pool.submit(work) for _ in range(workers)]:
                    future.result()
        named = {} if scheduler is None else dict(zip(guard.COUNTS, counts, strict=True))
        return BatchRuns(result, traces.get(0, rollout.no_trace()), named, segments)

    def _drive(self, chunk: NDArray[np.int64], plan: _Plan, mpc_settings: Any) -> Any:
        """Drive the runs of one chunk; the `kernels.rollout.Run` that they leave."""
        from adaptrack.kernels import rollout

        which, size, n = plan.which[chunk], len(chunk), self.signals[0].n
        segments = math.ceil(n / plan.segment) if plan.segment else 0
        run = self.arena(size, int(self.substeps[which[0]]), mpc_settings, segments, plan.traced, plan.scheduler)
        run.road.scenario[:], run.road.seeds[:] = which, plan.seeds[chunk]
        run.vehicles.start[:], run.tuning[:] = self.starts[which], plan.tunings[chunk]
        rollout.begin(size, run)
        rollout.rollout(n, size, (plan.weight, float(max(plan.segment, 1))), run, self.members)
        return run


@dataclass(frozen=True, eq=False)
class _Plan:
    """What the runs of `Batch.run` differ in."""

    which: NDArray[np.int64]
    tunings: Array
    seeds: NDArray[np.int64]
    segment: int
    weight: float
    traced: int
    """periods to trace, 0 for no trace"""
    scheduler: CompiledScheduler | None


# -- the trajectory ---------------------------------------------------------------------------------------------------
_WHOLE = {"Np", "Nc", "qp_status", "qp_iterations", "at_limit"}
_UNITS = {"tuning.Q": "1/m^2", "tuning.R": "1/rad^2"}


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


def _trajectory(
    world: World, controller: Controller, scenario: Scenario, signals: Signals, seed: int, record: _Recorder
) -> Trajectory:
    from adaptrack.kernels.plants.contract import STATE

    n, state, plant = signals.n, record.state, world.plant
    driven = np.isfinite(record.command[:, 0])
    described = controller.describe()
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
        units={key: unit for key, unit in _UNITS.items() if key.partition(".")[2] in record.tuning_names},
        failed=record.failed,
        failed_at=record.failed_at,
        meta=provenance(
            scenario=scenario.name,
            plant=plant.name,
            tyre=plant.tyre_name,
            vehicle=getattr(getattr(plant, "vehicle", None), "name", plant.name),
            profile=world.profile.name,
            move_weight=world.profile.move_weight,
            seed=seed,
            preview=bool(described.get("preview", False)),
            controller=controller.name,
            tuning=described.get("tuning", {}),
            created=datetime.now(UTC),
            control=described,
            speed="profile" if world.driver is None else "driver",
            scheduler_counts=record.counted,
        ),
    )
