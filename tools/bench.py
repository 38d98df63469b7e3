"""Timings of the package on the machine at hand.

    python -m tools.bench step [--count N]          # one control step called from Python
    python -m tools.bench rollout [--points N]      # the compiled batch of runs
    python -m tools.bench controllers [--count N]   # the controllers of the profiles, compiled and from Python
    python -m tools.bench tracker [--count N]       # a call of the tracker, and the controller's step inside it
    python -m tools.bench environments [--count N]  # environments of N cars beside `rollout_batch`

Nothing else should run on the machine. `--json` prints JSON.

The baseline of `step` and `rollout` is the textbook loop: matrices of eqs. (8)-(17) formed with NumPy and
`scipy.linalg.expm` at every step, the QP handed to DAQP's Python interface. Its vehicle is ours, compiled, so the ratio
is the controller's; BLAS is held to one thread, which is the fastest for matrices this small.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import os
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import adaptrack as at
from adaptrack.cars.plant import DualTrack, Plant
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, Controller, MPCCommand, Tuning, published_mpc
from adaptrack.control.models import SingleTrackModel
from adaptrack.control.qp import QPStatus
from adaptrack.control.scheduling import SchedulingVariables
from adaptrack.core.library import kernels_hash
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.simulate import simulate
from adaptrack.scenario import Constant, Scenario, Sine, load_scenario, random_drive

Array = NDArray[np.float64]

NP, NC, Q, R = (1, 55), (1, 18), (0.1, 10.0), (0.001, 0.1)
"""The authors' bounds of the particle swarm."""
SPEEDS, AMPLITUDES, FRICTIONS, WINDS = (3.0, 27.0), (-15.0, 15.0), (0.5, 0.9), (-30.0, 30.0)
"""The paper's operating domain: m/s, m, -, m/s."""
NEVER = FailureLimits(1000.0, math.inf)
"""No run is ended before its time: what is timed is always the same work."""


class PlainController(Controller):
    """The same MPC as a NumPy program: one dense matrix product per equation, DAQP for the QP."""

    name = "NumPy + DAQP"

    def __init__(self, vehicle: Vehicle, tuning: Tuning, period: float = 0.1) -> None:
        self.mpc = published_mpc(vehicle, tuning, period=period)  # for its limits and speed floor only
        self.vehicle, self.tuning, self.period = vehicle, tuning, period
        move, angle = np.eye(tuning.Nc), np.tri(tuning.Nc)
        self.rows = np.vstack([move, -move, angle, -angle])
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self.angle = 0.0
        self.previous: Array | None = None

    def describe(self) -> dict[str, Any]:
        """The configuration."""
        return self.mpc.describe()

    def step(
        self, state: Any, speed: float, reference: Any, variables: SchedulingVariables | None = None, road: Any = None
    ) -> MPCCommand:
        """One control step, as `MPC.step`."""
        import ctypes

        import daqp
        from scipy.linalg import expm

        t = self.tuning
        Np, Nc, q, r = t.Np, t.Nc, t.Q, t.R
        x = np.array(state, dtype=float)
        change = np.zeros(4) if self.previous is None else x - self.previous
        a, b, c = SingleTrackModel(self.vehicle, self.period).continuous(max(speed, self.mpc.speed_floor))
        block = np.zeros((5, 5))
        block[:4, :4], block[:4, 4:] = a, b
        block = expm(block * self.period)
        a, b = block[:4, :4], block[:4, 4:]
        a = np.block([[a, np.zeros((4, 1))], [c @ a, np.eye(1)]])
        b = np.vstack([b, c @ b])
        row = np.array([[0.0, 0.0, 0.0, 0.0, 1.0]])
        free, response = np.empty((Np, 5)), np.empty(Np)
        for i in range(Np):
            response[i] = (row @ b).item()
            row = row @ a
            free[i] = row
        phi = np.zeros((Np, Nc))
        for j in range(Nc):
            phi[j:, j] = response[: Np - j]
        error = np.full(Np, reference[0]) - free @ np.append(change, x[3])
        hessian = 2 * (q * phi.T @ phi + r * np.eye(Nc))
        gradient = -2 * q * phi.T @ error
        (low, high), (least, most) = self.mpc.limits.move, self.mpc.limits.angle
        bounds = np.repeat([high, -low, most - self.angle, self.angle - least], Nc)
        lower = np.full(bounds.size, -1e30)
        solution, _, flag, _ = daqp.solve(
            hessian, gradient, self.rows, bounds, lower, np.zeros(bounds.size, dtype=ctypes.c_int)
        )
        move = float(solution[0]) if flag > 0 else 0.0
        self.angle += move
        self.previous = x
        status = QPStatus.SOLVED if flag > 0 else QPStatus.CAPPED
        return MPCCommand(self.angle, move, flag <= 0, (Np, Nc, q, r), status, 0, float("nan"), 0)


def bench_step(count: int = 4000) -> dict[str, Any]:
    """Microseconds of one `MPC.step` at 35/8/10/0.01 and of `PlainController`: median, 99th percentile and longest.

    Limits are active half the time. The speed changes at every step, so that the model is discretised and the QP formed
    and factorised anew each time.
    """
    car = load_vehicle("paper")
    rng = np.random.default_rng(0)
    calm = np.arange(count) % 2 == 0
    states = rng.normal(size=(count, 4)) * [0.1, 0.02, 0.02, 0.0]
    references = np.where(calm, 0.01, rng.choice([-8.0, 8.0], size=count))
    speeds = rng.uniform(*SPEEDS, count)

    def timed(controller: Any, repeats: int) -> tuple[Array, float]:
        times, active = np.empty(repeats), 0
        for i in range(repeats):
            controller.reset() if isinstance(controller, PlainController) else _rest(controller)
            state, reference, speed = states[i], references[i : i + 1], float(speeds[i])
            begun = time.perf_counter_ns()
            command = controller.step(state, speed, reference)
            times[i] = time.perf_counter_ns() - begun
            active += command.iterations > 0
        return times / 1e3, active / repeats

    figures: dict[str, Any] = {}
    for name, controller in {"step": published_mpc(car), "python_daqp": PlainController(car, Tuning())}.items():
        repeats = min(count, max(200, count // 10)) if name == "python_daqp" else count
        with one_blas_thread():
            timed(controller, min(count, 50))
            times, active = timed(controller, repeats)
        for key, value in (("p50", np.median(times)), ("p99", np.percentile(times, 99)), ("max", times.max())):
            figures[f"{name}_us_{key}"] = float(value)
        if name == "step":
            figures["limits_active"] = active
    ratio = figures["python_daqp_us_p50"] / figures["step_us_p50"]
    return {**figures, "ratio_to_python_daqp": ratio, "steps": count, **_machine()}


def _rest(mpc: MPC) -> None:
    """Set the angle and the past back without forming the controller anew."""
    mpc._mpc.memory["started"], mpc._mpc.memory["command"] = 0, 0.0
    mpc._mpc.previous[:] = 0.0


def bench_rollout(conditions: int = 150, threads: int | None = None) -> dict[str, Any]:
    """Control steps per second of `rollout_batch`: dual track, Magic Formula, paper profile, 180 steps a run.

    20 random tunings within the swarm's bounds on each of `conditions` random operating points of the paper's domain;
    the same with a speed that varies, where every step has a model of its own; a sample of them by `PlainController`.
    """
    rng = np.random.default_rng(0)
    car = load_vehicle("paper")
    plant = DualTrack(car, "magic-formula")
    mpc = published_mpc(car)
    threads = threads or os.cpu_count() or 1

    def scenario(varying: bool) -> Scenario:
        speed: Any = float(rng.uniform(*SPEEDS))
        if varying:
            speed = Constant(value=max(speed, 5.0)) + Sine(amplitude=2.0, frequency=0.15)
        return load_scenario(
            "step", amplitude=float(rng.uniform(*AMPLITUDES)), speed=speed, friction=float(rng.uniform(*FRICTIONS)),
            wind=float(rng.uniform(*WINDS)),
        )  # fmt: skip

    which = np.repeat(np.arange(conditions), 20)
    tunings = np.column_stack(
        [
            rng.integers(*NP, which.size, endpoint=True),
            rng.integers(*NC, which.size, endpoint=True),
            rng.uniform(*Q, which.size),
            rng.uniform(*R, which.size),
        ]
    )
    tunings[:, 1] = np.minimum(tunings[:, 0], tunings[:, 1])

    def rate(varying: bool, workers: int) -> float:
        tests = [scenario(varying) for _ in range(conditions)]
        begun = time.perf_counter()
        done = rollout_batch(plant, mpc, tests, tunings, scenario_indices=which, threads=workers, failure=NEVER)
        return float(done.steps.sum() / (time.perf_counter() - begun))

    rate(False, threads)  # warm
    constant, varying, single = rate(False, threads), rate(True, threads), rate(False, 1)
    test = scenario(False)
    plain = _plain_rate([(plant, test, tunings[i]) for i in range(6)])
    return {
        "control_steps_per_s": constant, "control_steps_per_s_varying_speed": varying,
        "control_steps_per_s_one_thread": single, "runs_per_s": constant / 180, "python_daqp_steps_per_s": plain,
        "ratio_to_python_daqp": constant / plain, "threads": threads, "runs": int(which.size), "steps_a_run": 180,
        **_machine(),
    }  # fmt: skip


def one_blas_thread() -> Any:
    """A context in which BLAS runs on one thread (two on small matrices are slower, and far slower on a busy core)."""
    from threadpoolctl import threadpool_limits

    return threadpool_limits(limits=1, user_api="blas")


def _plain_rate(runs: Sequence[tuple[Plant, Scenario, Array]]) -> float:
    """Control steps per second of `PlainController`, of those that a run drives while its state is finite."""
    steps, car = 0, load_vehicle("paper")
    with one_blas_thread():
        PlainController(car, Tuning()).step(np.zeros(4), SPEEDS[1], np.zeros(1))  # warm: imports SciPy and DAQP
        begun = time.perf_counter()
        for plant, test, (Np, Nc, q, r) in runs:
            controller = PlainController(car, Tuning(int(Np), int(min(Nc, Np)), q, r))
            steps += int(np.isfinite(simulate(plant, controller, test, failure=NEVER).Y).sum())
        return steps / (time.perf_counter() - begun)


def _machine() -> dict[str, Any]:
    """What the figures were measured on."""
    from importlib.metadata import version

    cpu = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.partition(":")[2].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        cpu = names[0] if names else cpu
    return {
        "cpu": cpu, "cores": os.cpu_count() or 1, "kernels": kernels_hash(), "python": platform.python_version(),
        **{name: version(name) for name in ("adaptrack", "numpy", "daqp")},
    }  # fmt: skip


# -- controllers on random drives -------------------------------------------------------------------------------------
REPEATS = 5
"""of a drive; of each step the shortest time counts, so that other work on the machine does not"""
FIRST_DRIVE = 9_300_000


class RecordingMPC(MPC):
    """An MPC that keeps its inputs."""

    def reset(self) -> None:
        """Forget the past."""
        self.inputs: list[tuple[Any, ...]] = []
        super().reset()

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None, road: Any = None) -> Any:
        """As the MPC."""
        self.inputs.append((np.array(state), speed, np.array(reference[:64])))
        return super().step(state, speed, reference, variables)


def _published(kind: type, car: Vehicle) -> Any:
    """The paper's MPC as an object of this class."""
    paper = published_mpc(car)
    return kind(car, model=paper.model, estimator=paper.estimator)


MPCS: dict[str, tuple[str, Callable[[type, Vehicle], Any]]] = {
    "informed, road": ("road", lambda kind, car: kind(car, profile="road")),
    "informed, production": ("production", lambda kind, car: kind(car, profile="production")),
    "published, paper": ("paper", _published),
}
"""Profile and maker by name."""


def bench_controllers(drives: int = 20) -> dict[str, Any]:
    """Percentiles of the CPU microseconds of a step on random drives, compiled and called from Python."""
    car = load_vehicle("paper")
    figures: dict[str, Any] = {}
    for name, (profile, make) in MPCS.items():
        python, compiled = [], []
        for number in range(drives):
            recorder = make(RecordingMPC, car)
            simulate(DualTrack(car), recorder, random_drive(FIRST_DRIVE + number), profile=profile, seed=number)
            fresh = [make(MPC, car) for _ in range(2 * REPEATS)]
            inputs = recorder.inputs
            python.append(np.min([_cpu_us(mpc.step, inputs) for mpc in fresh[:REPEATS]], axis=0))
            steps = [_cpu_us(mpc._compiled_step(), inputs, mpc._take) for mpc in fresh[REPEATS:]]
            compiled.append(np.min(steps, axis=0))
        for where, times in (("python", np.concatenate(python)), ("compiled", np.concatenate(compiled))):
            for share in (50.0, 99.0, 99.9):
                figures[f"{name}, {where}_p{share:g}_us"] = round(float(np.percentile(times, share)), 2)
    return {**figures, "drives": drives, **_machine()}


def _cpu_us(step: Callable[..., Any], inputs: list[Any], write: Callable[..., None] | None = None) -> Array:
    """CPU microseconds of each call (calls,); write: takes the arguments before the clock starts."""
    times, clock = np.empty(len(inputs)), time.thread_time_ns
    empty = np.median([clock() - clock() for _ in range(2000)])
    gc.collect()
    gc.disable()
    for i, arguments in enumerate(inputs):
        if write is not None:
            write(*arguments, None, None)
            arguments = ()
        begun = clock()
        step(*arguments)
        times[i] = clock() - begun
    gc.enable()
    return (times + empty) / 1e3


# -- the tracker ------------------------------------------------------------------------------------------------------
def bench_tracker(calls: int = 20_000) -> dict[str, Any]:
    """Microseconds of a compiled tracker call and of `Tracker.step`, by controller: median and 99.9th percentile.

    Calls at 20 Hz along a country road with a planned speed and noise.
    """
    from adaptrack.control.tracker import tracking_of
    from adaptrack.core.kernel import direct
    from adaptrack.core.tracker.step import tracker_step

    car, road = load_vehicle("paper"), at.generate_road("country", seed=1, length=3000.0)
    plan = at.plan_speed(road, car)
    rows = _samples(road, plan, calls)
    controllers: dict[str, Callable[[], Any]] = {
        "informed": lambda: MPC(car, profile="road"),
        "informed, production": lambda: MPC(car, profile="production"),
        "learning": lambda: MPC(car, profile="road", learning=at.Learning()),
        "published": lambda: published_mpc(car, period=0.05),
        "LQR": lambda: at.LQR(car, period=0.05),
    }
    figures: dict[str, Any] = {}
    for name, make in controllers.items():
        controller = make()
        tracking = tracking_of(controller, road, plan)
        kernel = direct(tracker_step, tracking)
        sample, tracker = tracking.tracker.sample, at.Tracker(make(), road, plan=plan)
        compiled, python = np.empty(calls), np.empty(min(calls, 5000))
        for k in range(calls):
            sample[:10] = rows[k]
            begun = time.perf_counter_ns()
            kernel()
            compiled[k] = 1e-3 * (time.perf_counter_ns() - begun)
        for k, (t, now, x, y, yaw, speed, yaw_rate, *_) in enumerate(rows[: len(python)].tolist()):
            begun = time.perf_counter_ns()
            tracker.step(t, x, y, yaw, speed, yaw_rate, lateral_velocity=0.0, now=now)
            python[k] = 1e-3 * (time.perf_counter_ns() - begun)
        for where, times in (("compiled", compiled), ("python", python)):
            figures[f"{name}, {where}_p50_us"] = float(np.median(times))
            figures[f"{name}, {where}_p99.9_us"] = float(np.quantile(times, 0.999))
    return {**figures, "calls": calls, **_machine()}


def _samples(road: Any, plan: Any, calls: int) -> Array:
    """(calls, 10) t, now, x, y, yaw, speed, yaw rate, lateral velocity and acceleration, wheel angle."""
    rng, rows, s = np.random.default_rng(1), np.full((calls, 10), math.nan), 20.0
    for k in range(calls):
        speed, point = float(plan.at(s)), road.at(s)
        rows[k, :8] = 0.05 * k, 0.05 * k, point.x, point.y, point.heading, speed, speed * point.curvature, 0.0
        s += 0.05 * speed
        if s > road.length - 100.0:
            s = 20.0
    rows[:, 2:7] += rng.normal(size=(calls, 5)) * (0.02, 0.02, 0.002, 0.02, 0.005)
    return rows


# -- environments -----------------------------------------------------------------------------------------------------
TASK: dict[str, Any] = {"road": "country:1", "length": 1000.0}
GAINS = np.array([-0.03, -0.4, 0, 0, 0, 0, 0, *[0] * 5, 0, 0, 2.9, 0, 0])
"""of a steering law that stays on the road"""


def bench_environments(cars: int = 64) -> dict[str, Any]:
    """Control steps per second of environments of many cars on one thread, beside `rollout_batch`; medians of 5 rounds.

    Environments come back to Python at every step (`MPCTuning`: every 10 control periods). The policy is not timed.
    """
    from adaptrack.gym import MPCTuningVectorEnv, PathTrackingVectorEnv

    tuning = MPCTuningVectorEnv(cars, threads=1, **TASK)
    middle = 0.5 * (tuning.tunings.low[2] + tuning.tunings.high[2])
    actions = np.tile(tuning.tunings.action(30, 10, middle), (cars, 1))
    steering = PathTrackingVectorEnv(cars, threads=1, **TASK)
    random_cars = PathTrackingVectorEnv(cars, threads=1, random_cars=True, **TASK)

    def steer(observations: Array) -> Array:
        return (observations @ GAINS)[:, None]

    measures: dict[str, Callable[[], float]] = {
        "rollout_batch, informed": lambda: _rollout_rate("informed", cars),
        "rollout_batch, pure-pursuit": lambda: _rollout_rate("pure-pursuit", cars),
        "PathTracking": lambda: _environment_rate(steering, steer, 600, 1),
        "PathTracking, random cars": lambda: _environment_rate(random_cars, steer, 300, 1),
        "MPCTuning": lambda: _environment_rate(tuning, lambda observations: actions, 60, 10),
    }
    rounds = [{name: measure() for name, measure in measures.items()} for _ in range(6)][1:]  # the first one warms
    medians = {name: float(np.median([rates[name] for rates in rounds])) for name in measures}
    return {**medians, "cars": cars, **_machine()}


def _rollout_rate(controller: str, cars: int) -> float:
    """Control steps per second of whole runs without Python between the steps."""
    from adaptrack.gym import Task

    car = load_vehicle("paper")
    drive, plant = Task(**TASK).drive(0, car), at.get_plant("dual-track", car)
    law = at.get_controller(controller, car, profile="road", period=0.05, preview=True)
    begun = time.perf_counter()
    batch = rollout_batch(
        plant, law, drive, scenario_indices=np.zeros(cars, int), profile="road", seeds=np.arange(cars), threads=1
    )  # fmt: skip
    return float(batch.steps.sum() / (time.perf_counter() - begun))


def _environment_rate(environment: Any, policy: Callable[[Array], Any], steps: int, periods: int) -> float:
    """Control steps per second of an environment; periods: of control in each of its steps."""
    observations, seconds = environment.reset(seed=1)[0], 0.0
    for _ in range(steps):
        action = policy(observations)
        begun = time.perf_counter()
        observations, *_ = environment.step(action)
        seconds += time.perf_counter() - begun
    return environment.num_envs * steps * periods / seconds


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description="Time the package on this machine.")
    commands = parser.add_subparsers(required=True)
    for name, measure, help_text, count in (
        ("step", bench_step, "control steps to time", 4000),
        ("rollout", bench_rollout, "operating points to run, 20 tunings each", 150),
        ("controllers", bench_controllers, "random drives", 20),
        ("tracker", bench_tracker, "calls to time", 20_000),
        ("environments", bench_environments, "cars of an environment", 64),
    ):
        command = commands.add_parser(name, help=(measure.__doc__ or "").split("\n")[0])
        command.add_argument("--count", type=int, default=count, help=f"{help_text} (default {count})")
        command.add_argument("--json", action="store_true", dest="as_json", help="print JSON")
        command.set_defaults(measure=measure)
    options = parser.parse_args()
    figures = options.measure(options.count)
    if options.as_json:
        print(json.dumps(figures, indent=1))
    else:
        print(*(f"{name.replace('_', ' '):40} {value}" for name, value in figures.items()), sep="\n")


if __name__ == "__main__":
    main()
