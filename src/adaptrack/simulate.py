"""Closed-loop runs: one at a time from Python, or thousands compiled.

`simulate` loops in Python, so any controller, plant, scheduler or QP back-end can take part. `rollout` and
`rollout_batch` run the same control periods inside the kernels. Both give the same trajectory.
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

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput, real, whole
from adaptrack.estimation import FrictionWindEstimator, Perception
from adaptrack.mpc import MPC, CompiledScheduler, Condition, Controller, Scheduler, demand
from adaptrack.plant import Plant, Profile, load_profile
from adaptrack.scenario import Scenario, Signals
from adaptrack.trajectory import Trajectory, provenance

Array = NDArray[np.float64]


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


def _loop_settings(
    plant: Plant,
    profile: Profile,
    driver: Driver | None,
    substeps: int,
    lost_beyond: float,
    spin_beyond: float = math.inf,
) -> Array:
    """`kernels.loop.LOOP_SETTINGS`; without a driver the speed follows its profile exactly."""
    from adaptrack.kernels import loop

    values = {
        "plant": plant.kind,
        "substeps": substeps,
        "prescribed_speed": driver is None,
        "delay": profile.delay,
        "noise_vy": profile.noise_vy,
        "noise_yaw": profile.noise_yaw,
        "noise_yaw_rate": profile.noise_yaw_rate,
        "noise_y": profile.noise_y,
        "driver_preview": driver.preview if driver else 1.0,
        "driver_integral": driver.integral if driver else 0.0,
        **plant.powertrain,
        "lost_beyond": lost_beyond,
        "spin_beyond": spin_beyond,
    }
    return np.array([values[name] for name in loop.LOOP_SETTINGS], dtype=float)


def _rows(signals: Signals, perception: Perception | None = None, number: int = 0) -> Array:
    """A scenario's samples as the kernels read them, (`kernels.loop.SIGNALS`, n + 1)."""
    told = (signals.friction.mean(axis=1), signals.wind[:, 1])
    if perception is not None:
        told = perception.told(*told, signals.period, number)
    ahead = demand(signals.y_ref, signals.period, len(signals.y_ref))
    return np.ascontiguousarray(
        np.vstack([signals.y_ref, signals.speed, signals.friction.T, signals.wind.T, *told, *ahead])
    )


def _start(scenario: Scenario, signals: Signals) -> Array:
    """X, Y, yaw, v_x, v_y, yaw rate at the start."""
    return np.array([0.0, scenario.initial_y, scenario.start_heading, signals.speed[0], 0.0, 0.0])


def vehicle_arrays(plant: Plant) -> tuple[Array, Array, Array]:
    """What the kernels need to move a block of vehicles: the block, a user's plant's own states, scratch."""
    from adaptrack.kernels import integrate
    from adaptrack.kernels.dynamics import STATES

    n = len(plant.state_names)
    return np.zeros(integrate.BLOCK), np.zeros((integrate.LANES, n)), np.zeros((7, max(n, STATES)))


def _outfit(plant: Plant, profile: str | Profile) -> tuple[Plant, Profile]:
    """The plant behind the profile's steering, unless it has its own."""
    if not isinstance(plant, Plant):
        raise InvalidInput(f"plant = {plant!r}: must be a Plant, such as DualTrack(load_vehicle('paper')).")
    profile = load_profile(profile)
    if getattr(plant, "steering", None) is None:
        plant = plant.with_steering(profile.steering)
    return plant, profile


def _refuse_nonsense(scenario: Scenario, seed: int, lost_beyond: float) -> None:
    if not isinstance(scenario, Scenario):
        raise InvalidInput(f"scenario = {scenario!r}: must be a Scenario; load_scenario(name) gives one.")
    if whole("simulate", "seed", seed, least=0) >= 2**63:
        raise InvalidInput(f"seed = {seed!r}: must be below 2^63.")
    if not real("simulate", "lost_beyond", lost_beyond) > 0.0:
        raise InvalidInput(f"lost_beyond = {lost_beyond!r} m: must be positive.")


def simulate(
    plant: Plant,
    controller: Controller,
    scenario: Scenario,
    *,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seed: int = 0,
    lost_beyond: float = 1000.0,
    progress: Callable[[int, int], None] | None = None,
) -> Trajectory:
    """Drive a scenario with a controller.

    profile: `paper` (ideal), `road` (steering actuator, noise, delay) or one's own; driver: None to follow the speed
    profile exactly, else the longitudinal driver that moves the vehicle with its powertrain; seed: of the sensor
    noise; lost_beyond: the run ends, its rest NaN, when |Y - y_ref| (m) exceeds this or the state is not finite;
    progress: called now and then with (periods done, periods in all).

    Raises
    ------
    InvalidInput
        When an argument does not fit the others.
    """
    from adaptrack.kernels import integrate, loop
    from adaptrack.kernels.dynamics import STATES

    plant, profile = _outfit(plant, profile)
    _refuse_nonsense(scenario, seed, lost_beyond)
    signals = scenario.sample(controller.period)
    n = signals.n
    samples = _rows(signals)
    rows = samples.reshape(1, *samples.shape)
    substeps = plant.substeps(controller.period, float(signals.speed.max()))
    lap = _loop_settings(plant, profile, driver, substeps, lost_beyond)
    block, own, work = vehicle_arrays(plant)
    seen, measured, look = np.zeros(2), np.zeros(4), np.zeros(len(Condition._fields))
    memory = loop.memory(1)
    packed, function, kind = plant.packed(), plant.function, plant.kind
    lanes = block.reshape(-1, integrate.LANES)
    trace = np.full((n, loop.TRACE), np.nan)
    times = np.full(n, np.nan)

    controller.reset()
    loop.place(1, _start(scenario, signals)[None], block, own)
    waiting = 0.0
    for k in range(n):
        if progress is not None and k % 64 == 0:
            progress(k, n)
        trace[k, :STATES] = lanes[:STATES, 0]
        loop.sense(k, 0, block, lap, seed, measured)
        speed = float(lanes[3, 0])
        loop.look(k, speed, measured, rows, 0, look)
        condition = Condition(*look.tolist())
        begun = time.perf_counter()
        command = controller.step(measured, speed, samples[0, k:], condition)
        times[k] = time.perf_counter() - begun
        loop.actuate(k, 0, waiting if profile.delay else command.angle, block, controller.period, lap, rows, 0, memory)
        waiting = command.angle
        loop.observe(0, kind, function, packed, block, own, work, seen)
        trace[k, STATES:] = (*command[:7], *command.tuning, *seen)
        loop.move_vehicles(1, kind, function, packed, block, own, work, controller.period, lap)
        error = lanes[1, 0] - samples[0, k + 1]
        if not (abs(error) <= lost_beyond and math.isfinite(lanes[5, 0])):
            break
    if progress is not None:
        progress(n, n)
    counted = controller.scheduler_counts if isinstance(controller, MPC) else {}
    return _trajectory(plant, controller, scenario, signals, profile, driver, seed, trace, times, counted)


def rollout(
    plant: Plant,
    mpc: MPC,
    scenario: Scenario,
    *,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seed: int = 0,
    lost_beyond: float = 1000.0,
) -> Trajectory:
    """`simulate`, compiled: the same trajectory, without the step times.

    Raises
    ------
    InvalidInput
        When the MPC needs Python at every step: a scheduler or a QP back-end outside the kernels.
    """
    from adaptrack.kernels import inference

    _refuse_nonsense(scenario, seed, lost_beyond)
    batch = Batch(plant, mpc, [scenario], profile, driver, lost_beyond)
    first = np.zeros(1, np.int64)
    _, trace, counts, _ = batch.run(first, mpc.tuning.as_array()[None], np.array([seed]), 1, traced=True)
    times = np.full(len(trace[0]), np.nan)
    counted = dict(zip(inference.COUNTS, counts[0].astype(int).tolist(), strict=False))
    return _trajectory(
        batch.plant, mpc, scenario, batch.signals[0], batch.profile, driver, seed, trace[0], times, counted
    )


@dataclass(frozen=True, eq=False)
class BatchResult:
    """What `rollout_batch` measured, an entry per run; arrays of shape (runs,)."""

    mse: Array
    """m^2, mean over the control instants of (Y - y_ref)^2; inf when the run was lost"""
    mean_squared_move: Array
    """rad^2, mean of the squared changes of the command"""
    max_abs_error: Array
    """m"""
    lost: NDArray[np.bool_]
    """|Y - y_ref| exceeded `lost_beyond`, or the state was no longer finite"""
    steps: NDArray[np.int64]
    """control steps done"""
    qp_capped: NDArray[np.int64]
    """steps whose QP stopped at its cap"""
    qp_failed: NDArray[np.int64]
    """steps whose QP had no solution (infeasible, not finite, not convex)"""
    held: NDArray[np.int64]
    """steps that held the previous angle"""
    limited: NDArray[np.int64]
    """steps at a limit"""
    qp_iterations: NDArray[np.int64]
    """of the QP solver, in all steps"""
    scheduler: dict[str, NDArray[np.int64]]
    """what the scheduler counted, by name, see `kernels.inference.COUNTS`; empty without one"""

    def cost(self, move_price: float = 0.0) -> Array:
        """J = mean e^2 + move_price * mean (change of command)^2, the cost that tuning minimises; inf when lost."""
        return self.mse + move_price * self.mean_squared_move


def rollout_batch(
    plant: Plant,
    mpc: MPC,
    scenarios: Scenario | Sequence[Scenario],
    tunings: ArrayLike | None = None,
    *,
    which: ArrayLike | None = None,
    profile: str | Profile = "paper",
    driver: Driver | None = None,
    seeds: ArrayLike = 0,
    lost_beyond: float = 1000.0,
    threads: int | None = None,
) -> BatchResult:
    """Many runs at once, compiled and vectorised: run i drives scenario which[i] with tunings[i] and seeds[i].

    tunings: (runs, 4) of Np, Nc, Q, R, the horizons rounded and clamped to 1 <= Nc <= Np <= mpc.longest_horizon and
    mpc.most_moves; without them every run has the MPC's scheduler, or its tuning; which: (runs,) indices into
    `scenarios`, by default 0, without tunings one run for each; seeds: noise seeds, one or one per run; threads: None
    for all cores. A run's result does not depend on the others, nor on the number of threads. The scenarios must last
    equally long.

    Raises
    ------
    InvalidInput
        When shapes do not fit, a tuning is not finite, tunings meet a scheduler, or the MPC needs Python at every step.
    """
    batch = Batch(
        plant, mpc, [scenarios] if isinstance(scenarios, Scenario) else scenarios, profile, driver, lost_beyond
    )
    if tunings is None:
        which = np.arange(len(batch.signals)) if which is None else which
        tunings = np.repeat(mpc.tuning.as_array()[None], np.size(which), axis=0)
    elif mpc.scheduler is not None:
        raise InvalidInput("tunings: this MPC has a scheduler, which chooses them; leave them out.")
    asked = np.array(tunings, dtype=np.float64, ndmin=2)
    if asked.ndim != 2 or asked.shape[1] != 4 or not np.isfinite(asked).all():
        raise InvalidInput(f"tunings: need finite (runs, 4) of Np, Nc, Q, R; got shape {asked.shape}.")
    if (asked[:, 2] < 0.0).any() or (asked[:, 3] <= 0.0).any():
        raise InvalidInput("tunings: every Q must be >= 0 and every R > 0.")
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
    seeded = np.broadcast_to(seeded, (runs,)).copy()
    result, _, counts, _ = batch.run(index, asked, seeded, threads or os.cpu_count() or 1)
    return batch_result(result, counts)


def batch_result(result: Array, counts: Array) -> BatchResult:
    """What `Batch.run` gave, by name."""
    from adaptrack.kernels import inference, loop

    steps = np.maximum(result[:, loop.INSTANTS], 1.0)
    return BatchResult(
        mse=result[:, loop.SQUARED_ERROR] / steps,
        mean_squared_move=result[:, loop.SQUARED_MOVE] / steps,
        max_abs_error=result[:, loop.LARGEST_ERROR],
        lost=result[:, loop.RUN_LOST] > 0.5,
        steps=result[:, loop.INSTANTS].astype(np.int64),
        qp_capped=result[:, loop.CAPPED].astype(np.int64),
        qp_failed=result[:, loop.FAILED].astype(np.int64),
        held=result[:, loop.RUN_HELD].astype(np.int64),
        limited=result[:, loop.LIMITED].astype(np.int64),
        qp_iterations=result[:, loop.RUN_ITERATIONS].astype(np.int64),
        scheduler={
            name: counts[:, i].astype(np.int64) for i, name in enumerate(inference.COUNTS) if counts.shape[1] > 0
        },
    )


class Batch:
    """The arguments that all runs of a batch share, packed for the kernels.

    told: how a scheduler knows friction and wind: None exactly, else as a `Perception` or an estimator tells them;
    spin_beyond: |v_y/v_x| beyond which a run counts as lost.
    """

    def __init__(
        self,
        plant: Plant,
        mpc: MPC,
        scenarios: Sequence[Scenario],
        profile: str | Profile = "paper",
        driver: Driver | None = None,
        lost_beyond: float = 1000.0,
        told: Perception | FrictionWindEstimator | None = None,
        spin_beyond: float = math.inf,
    ) -> None:
        self.told = told
        if isinstance(told, FrictionWindEstimator) and not math.isclose(told.period, mpc.period):
            raise InvalidInput(f"told: the estimator's period is {told.period!r} s, the controller's {mpc.period!r} s.")
        self.scheduler = mpc.scheduler
        if not (self.scheduler is None or isinstance(self.scheduler, CompiledScheduler)) or not mpc.in_kernel:
            raise InvalidInput(
                "compiled runs need a scheduler of adaptrack.schedule, or none, and a QP solver of the kernels "
                "('active-set', 'hildreth'); use simulate(...) for this MPC."
            )
        self.plant, self.profile = _outfit(plant, profile)
        self.mpc = mpc
        self.signals = [scenario.sample(mpc.period) for scenario in scenarios]
        if not self.signals:
            raise InvalidInput("scenarios: none given.")
        if len({signals.n for signals in self.signals}) > 1:
            raise InvalidInput(
                "scenarios: must last equally long; run those of different length in batches of their own."
            )
        perception = told if isinstance(told, Perception) else None
        self.samples = np.ascontiguousarray([_rows(s, perception, i) for i, s in enumerate(self.signals)])
        self.starts = np.array([_start(scenario, s) for scenario, s in zip(scenarios, self.signals, strict=True)])
        self.substeps = np.array([self.plant.substeps(mpc.period, float(s.speed.max())) for s in self.signals])
        self.loops = {
            int(steps): _loop_settings(self.plant, self.profile, driver, int(steps), lost_beyond, spin_beyond)
            for steps in np.unique(self.substeps)
        }
        self.settings = mpc.settings()
        self.model = mpc.model.packed()
        self.packed, self.function = self.plant.packed(), self.plant.function

    def sized(self, longest: float, most: float) -> Array:
        """The MPC's settings with a workspace no larger than horizons up to these need, and no residuals."""
        from adaptrack.kernels import loop

        settings = self.settings.copy()
        settings[loop.RESIDUALS] = 0.0
        for place, value in ((loop.LONGEST_HORIZON, longest), (loop.MOST_MOVES, most)):
            settings[place] = min(settings[place], max(1.0, math.floor(value + 0.5)))
        return settings

    def run(
        self, which: NDArray[np.int64], tunings: Array, seeds: NDArray[np.int64], threads: int, traced: bool = False,
        stretch: int = 0, price: float = 0.0, scheduler: Scheduler | None = None,
    ) -> tuple[Array, Array, Array, Array]:  # fmt: skip
        """Results (runs, RESULT), traces (runs, periods or 0, TRACE), the scheduler's counts (runs, COUNTS or 0).

        Fourth, when asked for, the cost of each stretch of `stretch` periods (runs, stretches): the sum of squared
        error plus `price` times squared move; inf where a run was lost, NaN after that.

        With a scheduler, by default the MPC's, `tunings` are what it begins with.
        """
        from adaptrack.kernels import estimation, inference, integrate, loop

        runs, n = len(which), self.signals[0].n
        result = np.empty((runs, len(loop.RESULT)))
        trace = np.full((runs, n if traced else 0, loop.TRACE), np.nan)
        scheduler = self.scheduler if scheduler is None else scheduler
        counts = np.zeros((runs, 0 if scheduler is None else len(inference.COUNTS)))
        stretches = np.zeros((runs, math.ceil(n / stretch) if stretch else 0))
        longest, most = tunings[:, 0].max(initial=1), tunings[:, 1].max(initial=1)
        if isinstance(scheduler, CompiledScheduler):
            longest, most = max(longest, scheduler.largest[0]), max(most, scheduler.largest[1])
        settings = self.settings if traced else self.sized(longest, most)
        # Lanes of one block integrate with the same number of steps.
        chunks: queue.SimpleQueue[NDArray[np.int64]] = queue.SimpleQueue()
        count = 0
        for steps in self.loops:
            members = np.flatnonzero(self.substeps[which] == steps)
            for first in range(0, len(members), integrate.LANES):
                chunks.put(members[first : first + integrate.LANES])
                count += 1

        def work() -> None:
            lanes = min(integrate.LANES, runs)
            ws = loop.workspace(lanes, settings)
            block, own, scratch = vehicle_arrays(self.plant)
            while True:
                try:
                    chunk = chunks.get_nowait()
                except queue.Empty:
                    return
                size = len(chunk)
                part = np.zeros((size, len(loop.RESULT)))
                part_trace = np.full((size, trace.shape[1], loop.TRACE), np.nan)
                part_stretches = np.zeros((size, stretches.shape[1]))
                plan = scheduler.plan(size) if isinstance(scheduler, CompiledScheduler) else inference.no_schedule()
                if isinstance(self.told, FrictionWindEstimator):
                    plan = plan._replace(
                        believed=self.told.packed(), estimating=self.told.settings(),
                        estimates=np.zeros((size, estimation.MEMORY)),
                    )  # fmt: skip
                loop.rollout(
                    n, size, self.function, self.packed, block, own, scratch, self.model, settings,
                    self.loops[int(self.substeps[which[chunk[0]]])], self.samples, which[chunk],
                    np.ascontiguousarray(tunings[chunk]), seeds[chunk], loop.memory(size),
                    np.zeros((size, len(loop.RECORD))), ws, plan, np.zeros((size if traced else 0, 2)),
                    self.starts[which[chunk]], np.full(size, np.inf), price, max(stretch, 1),
                    part_stretches, part, part_trace,
                )  # fmt: skip
                result[chunk] = part
                trace[chunk] = part_trace
                stretches[chunk] = part_stretches
                if scheduler is not None:
                    counts[chunk] = plan.state[:, : counts.shape[1]]

        workers = max(1, min(threads, count))
        if workers == 1:
            work()
        else:
            with ThreadPoolExecutor(workers) as pool:
                for future in [pool.submit(work) for _ in range(workers)]:
                    future.result()
        return result, trace, counts, stretches


def _trajectory(
    plant: Plant,
    controller: Controller,
    scenario: Scenario,
    signals: Signals,
    profile: Profile,
    driver: Driver | None,
    seed: int,
    trace: Array,
    times: Array,
    counted: dict[str, int],
) -> Trajectory:
    from adaptrack.kernels import loop
    from adaptrack.kernels.dynamics import STATES

    n = signals.n
    record = {name: trace[:, STATES + i] for i, name in enumerate(loop.RECORD)}

    def whole(name: str) -> NDArray[np.int64]:
        return np.nan_to_num(record[name], nan=0.0).astype(np.int64)

    status = whole("qp_status")
    ended = ~np.isfinite(record["command"])  # the run was lost before these steps
    if ended.any():
        from adaptrack.qp import QPStatus

        status[ended] = QPStatus.NON_FINITE
    described = controller.describe()
    return Trajectory(
        t=signals.t[:n],
        X=trace[:, 0],
        Y=trace[:, 1],
        psi=trace[:, 2],
        vx=trace[:, 3],
        vy=trace[:, 4],
        yaw_rate=trace[:, 5],
        steering=trace[:, loop.STEERING],
        command=record["command"],
        command_change=record["command_change"],
        y_ref=signals.y_ref[:n],
        v_ref=signals.speed[:n],
        friction=signals.friction[:n],
        wind=signals.wind[:n],
        lateral_acceleration=trace[:, loop.LATERAL_ACCELERATION],
        Np=whole("Np"),
        Nc=whole("Nc"),
        Q=record["Q"],
        R=record["R"],
        qp_status=status,
        qp_iterations=whole("qp_iterations"),
        qp_residual=record["qp_residual"],
        at_limit=whole("at_limit"),
        held=np.nan_to_num(record["held"], nan=1.0) > 0.5,
        step_time=times,
        period=signals.period,
        meta=provenance(
            scenario=scenario.name,
            plant=plant.name,
            tyre=plant.tyre_name,
            vehicle=getattr(getattr(plant, "vehicle", None), "name", plant.name),
            profile=profile.name,
            seed=seed,
            preview=bool(described.get("preview", False)),
            controller=controller.name,
            tuning=described.get("tuning", {}),
            created=datetime.now(UTC),
            control=described,
            speed="profile" if driver is None else "driver",
            scheduler_counts=counted,
        ),
    )
