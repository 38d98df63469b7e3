"""Timings of the package on the machine at hand, beside a plain NumPy + DAQP controller in the same run.

    python -m tools.bench step [--count N]          # one control step called from Python
    python -m tools.bench rollout [--points N]      # the compiled batch of runs
    python -m tools.bench campaign [--points N]     # swarms and landscape on a sample of the paper's campaign

Nothing else should run on the machine. `--json` prints JSON.

The baseline is the textbook loop: matrices of eqs. (8)-(17) formed with NumPy and `scipy.linalg.expm` at every step,
the QP handed to DAQP's Python interface. Its vehicle is ours, compiled, so the ratio is the controller's; BLAS is held
to one thread, which is the fastest for matrices this small.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.plant import DualTrack, Plant
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, Controller, MPCCommand, Tuning, published_mpc
from adaptrack.control.models import SingleTrackModel, limit_bounds, limit_matrix
from adaptrack.control.qp import QPStatus
from adaptrack.control.scheduling import ENTRIES, VARIABLES, Learned, Network, Schedule, SchedulingVariables, Sugeno
from adaptrack.core.library import kernels_hash
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.failure import Failure
from adaptrack.drive.simulate import simulate
from adaptrack.scenario import Constant, Scenario, Sine, load_scenario

Array = NDArray[np.float64]

NP, NC, Q, R = (1, 55), (1, 18), (0.1, 10.0), (0.001, 0.1)
SEARCH: dict[str, tuple[float, float]] = {"Np": NP, "Nc": NC, "Q": Q, "R": R}
"""The authors' bounds of the particle swarm."""
SPEEDS, AMPLITUDES, FRICTIONS, WINDS = (3.0, 27.0), (-15.0, 15.0), (0.5, 0.9), (-30.0, 30.0)
"""The paper's operating domain: m/s, m, -, m/s."""
NEVER = Failure(1000.0, math.inf)
"""No run is ended before its time: what is timed is always the same work."""
RULES = 50
"""of a fuzzy system that is timed; clustering makes 44 to 60 of the authors' data"""


class PlainController(Controller):
    """The same MPC as a NumPy program: one dense matrix product per equation, DAQP for the QP."""

    name = "NumPy + DAQP"

    def __init__(self, vehicle: Vehicle, tuning: Tuning, period: float = 0.1) -> None:
        self.mpc = published_mpc(vehicle, tuning, period=period)  # for its limits and speed floor only
        self.vehicle, self.tuning, self.period = vehicle, tuning, period
        self.rows = limit_matrix(tuning.Nc)
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
        bounds = limit_bounds(Nc, self.angle, self.mpc.limits)
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
    """Median, 99th percentile and longest (microseconds) of one `MPC.step`, limits active half the time.

    `step`: at 35/8/10/0.01; `nn`: scheduled by four 4-16-8-1 networks; `anfis`: by four fuzzy systems of `RULES` rules
    on the four inputs, all of them with random numbers; `python_daqp`: `PlainController` at 35/8/10/0.01. Speed and
    scheduling variables change at every step, so that the schedule is asked, the model discretised and the QP formed
    and factorised anew each time. `nn_kernel`, `anfis_kernel`: the schedule alone, compiled.
    """
    car = load_vehicle("paper")
    rng = np.random.default_rng(0)
    calm = np.arange(count) % 2 == 0
    states = rng.normal(size=(count, 4)) * [0.1, 0.02, 0.02, 0.0]
    references = np.where(calm, 0.01, rng.choice([-8.0, 8.0], size=count))
    low, high = np.array([SPEEDS, AMPLITUDES, FRICTIONS, WINDS]).T
    rows = rng.uniform(low, high, (count, 4))
    rows[:, 1] = references
    looks = [SchedulingVariables(*row) for row in rows.tolist()]
    schedules = {"nn": _networks(rng), "anfis": _fuzzy_systems(rng)}
    scheduled = {name: published_mpc(car, Tuning(), scheduler=schedule) for name, schedule in schedules.items()}

    def timed(controller: Any, repeats: int) -> tuple[Array, float]:
        times, active = np.empty(repeats), 0
        for i in range(repeats):
            controller.reset() if isinstance(controller, PlainController) else _rest(controller)
            state, reference, variables = states[i], references[i : i + 1], looks[i]
            begun = time.perf_counter_ns()
            command = controller.step(state, variables.speed, reference, variables)
            times[i] = time.perf_counter_ns() - begun
            active += command.iterations > 0
        return times / 1e3, active / repeats

    found: dict[str, Any] = {}
    plain = PlainController(car, Tuning())
    for name, controller in {"step": published_mpc(car), **scheduled, "python_daqp": plain}.items():
        repeats = min(count, max(200, count // 10)) if name == "python_daqp" else count
        with one_blas_thread():
            timed(controller, min(count, 50))
            times, active = timed(controller, repeats)
        for key, value in (("p50", np.median(times)), ("p99", np.percentile(times, 99)), ("max", times.max())):
            found[f"{name}_us_{key}"] = float(value)
        if name == "step":
            found["limits_active"] = active
    for name, schedule in schedules.items():
        found[f"{name}_kernel_us"] = _schedule_us(schedule, rng.uniform(low, high, (10_000, 4)))
    for name, key in (("step", ""), ("nn", "nn_"), ("anfis", "anfis_")):
        found[f"{key}ratio_to_python_daqp"] = found["python_daqp_us_p50"] / found[f"{name}_us_p50"]
    return {**found, "steps": count, "np": 35, "nc": 8, "rules": RULES, **_machine()}


def _networks(rng: np.random.Generator) -> Schedule:
    """Four networks of the paper's size, their outputs all over the bounds of the swarm."""
    domain = np.array([SPEEDS, AMPLITUDES, FRICTIONS, WINDS])
    bottom, top = domain.T

    def network(low: float, high: float) -> Network:
        weights = [3.0 * rng.normal(size=size) / np.sqrt(size[0]) for size in ((4, 16), (16, 8), (8, 1))]
        biases = [rng.normal(size=16), rng.normal(size=8), np.zeros(1)]
        raw = Network(bottom, top, tuple(weights), tuple(biases), 0.0, 1.0, relu=False)
        least, most = np.quantile(raw.predict(rng.uniform(bottom, top, (500, 4))), (0.05, 0.95))
        weights[2], biases[2] = weights[2] / (most - least), np.array([-least / (most - least)])
        return Network(bottom, top, tuple(weights), tuple(biases), low, high)

    return _learned({slot: network(*bounds) for slot, bounds in SEARCH.items()}, domain)


def _fuzzy_systems(rng: np.random.Generator) -> Schedule:
    """Four fuzzy systems of rules that share no membership function, as subtractive clustering makes them."""
    domain = np.array([SPEEDS, AMPLITUDES, FRICTIONS, WINDS])
    width = domain[:, 1] - domain[:, 0]

    def system(low: float, high: float) -> Sugeno:
        centres = rng.uniform(domain[:, 0], domain[:, 1], (RULES, 4)).ravel()
        premises = np.column_stack((np.tile(0.5 / np.sqrt(8.0) * width, RULES), np.ones(4 * RULES), centres))
        consequents = np.column_stack((rng.normal(size=(RULES, 4)) / width, rng.uniform(0.0, 1.0, RULES)))
        consequents *= high - low
        consequents[:, -1] += low
        owner, rules = np.tile(np.arange(4), RULES), np.arange(4 * RULES).reshape(RULES, 4)
        return Sugeno(owner, np.zeros(4 * RULES, bool), premises, rules, consequents, np.ones(RULES))

    return _learned({slot: system(*bounds) for slot, bounds in SEARCH.items()}, domain)


def _learned(functions: Mapping[str, Network | Sugeno], domain: Array) -> Schedule:
    return Learned(functions, ("speed", "y_ref", "friction", "wind"), domain, SEARCH)


def _schedule_us(schedule: Schedule, variables: Array, pieces: int = 100) -> float:
    """Microseconds that the kernel of a schedule takes for a row of variables: all in `pieces` calls, the median."""
    from adaptrack.core import schedule as kernel

    rows = np.zeros((len(variables), len(VARIABLES)))
    rows[:, : variables.shape[1]] = variables
    plan, times = schedule.plan(1), []
    for piece in np.array_split(rows, pieces):
        tunings = np.empty((len(piece), len(ENTRIES)))
        begun = time.perf_counter()
        kernel.schedule_all(piece, plan, tunings)
        times.append((time.perf_counter() - begun) / len(piece))
    return 1e6 * float(np.median(times))


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
            "step",
            amplitude=float(rng.uniform(*AMPLITUDES)),
            speed=speed,
            friction=float(rng.uniform(*FRICTIONS)),
            wind=float(rng.uniform(*WINDS)),
        )

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
        done = rollout_batch(plant, mpc, tests, tunings, which=which, threads=workers, failure=NEVER)
        return float(done.steps.sum() / (time.perf_counter() - begun))

    rate(False, threads)  # warm
    constant, varying, single = rate(False, threads), rate(True, threads), rate(False, 1)
    test = scenario(False)
    plain = _plain_rate([(plant, test, tunings[i]) for i in range(6)])
    return {
        "control_steps_per_s": constant,
        "control_steps_per_s_varying_speed": varying,
        "control_steps_per_s_one_thread": single,
        "runs_per_s": constant / 180,
        "python_daqp_steps_per_s": plain,
        "ratio_to_python_daqp": constant / plain,
        "threads": threads,
        "runs": int(which.size),
        "steps_a_run": 180,
        **_machine(),
    }


def bench_campaign(conditions: int = 48, threads: int | None = None) -> dict[str, Any]:
    """Swarms (20 particles, 15 generations) and a landscape of 160 tunings on a sample of the paper's grid.

    control_steps_per_s counts the steps simulated; a swarm's runs that cannot improve any more are stopped, so
    `nominal_steps_per_s`, the steps that whole runs would have had, is higher. `ratio_to_python_daqp`: nominal rate
    over that of `PlainController` at the same operating points; `ratio_to_scalar`: over one run at a time on one
    thread, the same kernels with a single slot.
    """
    from adaptrack.paper.campaign_config import load_campaign
    from adaptrack.paper.operating_points import paper_grid
    from adaptrack.tuning.objective import Objective

    threads = threads or os.cpu_count() or 1
    car = load_vehicle("paper")
    driven = DualTrack(car, "magic-formula")
    objective = Objective(driven, published_mpc(car), failure=NEVER)
    campaign = load_campaign("paper-grid")
    library = campaign.library.rows(campaign.search)
    grid = paper_grid()
    sample = grid[np.random.default_rng(0).choice(len(grid), conditions, replace=False)]

    def swarms() -> tuple[int, int]:
        with ThreadPoolExecutor(threads) as pool:
            found = list(pool.map(lambda i: objective.tune(sample[i], campaign.swarm, 1, i), range(conditions)))
        return sum(one.control_steps for one in found), sum(one.evaluations for one in found)

    def landscapes() -> int:
        with ThreadPoolExecutor(threads) as pool:
            return sum(costs.size for costs in pool.map(lambda c: objective.landscape(c, library), sample))

    objective.tune(sample[0])  # warm
    begun = time.perf_counter()
    steps, runs = swarms()
    swarm_time = time.perf_counter() - begun
    begun = time.perf_counter()
    rows = landscapes()
    landscape_time = time.perf_counter() - begun
    nominal = (runs + rows) * 180 / (swarm_time + landscape_time)

    begun = time.perf_counter()
    few = library[:: max(1, len(library) // 24)]
    for tuning in few:
        objective.costs(sample[0], tuning[None])
    scalar = len(few) * 180 / (time.perf_counter() - begun)
    sampled = zip(sample[:6], few, strict=False)
    plain = _plain_rate([(driven, objective.scenario(point), tuning) for point, tuning in sampled])
    return {
        "control_steps_per_s": (steps + rows * 180) / (swarm_time + landscape_time),
        "nominal_steps_per_s": nominal,
        "swarm_nominal_steps_per_s": runs * 180 / swarm_time,
        "landscape_steps_per_s": rows * 180 / landscape_time,
        "runs_per_s": (runs + rows) / (swarm_time + landscape_time),
        "ratio_to_python_daqp": nominal / plain,
        "ratio_to_scalar": nominal / scalar,
        "step_ns_per_core": 1e9 * threads * (swarm_time + landscape_time) / (steps + rows * 180),
        "of_which_plant_ns": _plant_ns(driven, sample),
        "python_daqp_steps_per_s": plain,
        "scalar_steps_per_s": scalar,
        "conditions": conditions,
        "threads": threads,
        **_machine(),
    }


def _plant_ns(plant: Plant, points: Array) -> float:
    """Nanoseconds that a full batch's integration takes per vehicle and control period, mean over the points."""
    from adaptrack.core.plants.contract import INPUT, SLOTS, STATE, STATES, vehicle_batch

    period, advance = 0.1, plant.compiled.advance
    start = np.zeros((SLOTS, len(plant.state_names)))
    vehicles = vehicle_batch(plant.compiled, plant.packed(), start)
    rows = vehicles.block.reshape(-1, SLOTS)
    times = []
    for speed in points[:, 0]:
        steps = plant.substeps(period, float(speed))
        rows[:] = 0.0
        rows[STATE.vx], rows[STATES + INPUT.command] = speed, 0.02
        rows[STATES + INPUT.friction_front_left : STATES + INPUT.wind_x] = 0.7
        begun = time.perf_counter()
        for _ in range(20):
            v = vehicles
            advance(v.member, v.parameters, v.block, v.states, v.work, SLOTS, steps, period / steps)
        times.append((time.perf_counter() - begun) / 20)
    return 1e9 * float(np.median(times)) / SLOTS


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
        "cpu": cpu,
        "cores": os.cpu_count() or 1,
        "kernels": kernels_hash(),
        "python": platform.python_version(),
        **{name: version(name) for name in ("adaptrack", "numpy", "daqp")},
    }


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench", description="Time the package on this machine.")
    commands = parser.add_subparsers(required=True)
    for name, measure, what, count in (
        ("step", bench_step, "control steps to time", ("--count", 4000)),
        ("rollout", bench_rollout, "operating points to run, 20 tunings each", ("--points", 150)),
        ("campaign", bench_campaign, "operating points of the paper's grid to tune", ("--points", 48)),
    ):
        command = commands.add_parser(name, help=(measure.__doc__ or "").split("\n")[0])
        option, default = count
        command.add_argument(option, type=int, default=default, dest="count", help=f"{what} (default {default})")
        command.add_argument("--json", action="store_true", dest="as_json", help="print JSON")
        command.set_defaults(measure=measure)
    chosen = parser.parse_args()
    found = chosen.measure(chosen.count)
    if chosen.as_json:
        print(json.dumps(found, indent=1))
    else:
        print(*(f"{name.replace('_', ' '):40} {value}" for name, value in found.items()), sep="\n")


if __name__ == "__main__":
    main()
