"""Arrays that the kernels of a checkout give on fixed work: the workloads of `against_release.py`.

    python benchmarks/answers.py --record FILE.npz NAME ...

Each workload is seeded, independent of the others, calls public functions only and gives arrays by name.
"""

from __future__ import annotations

import argparse
import math
import zlib
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from exported_answers import EXPORTED, numbers_of, padded, trace

Array = np.ndarray
Named = Iterator[tuple[str, Any]]

STEPS = 2_000
"""of a controller"""
AHEAD = 80
"""instants of the reference that it sees"""
HOSTILE = (math.nan, math.inf, -math.inf, 1e300, -1e160, 1e9, -3e4, 5e-324, -0.0)
"""What a broken sensor may say."""


# -- what is given ----------------------------------------------------------------------------------------------------
def random(name: str) -> np.random.Generator:
    """Random numbers of this name."""
    return np.random.default_rng(zlib.crc32(name.encode()))


class Inputs(NamedTuple):
    """Inputs of a controller, step by step."""

    states: Array
    """(n, 9) as `MPC.step` takes them"""
    speeds: Array
    """(n,) m/s"""
    references: Array
    """(n, AHEAD) m"""


@cache
def measurements(noise: float = 1.0) -> Inputs:
    """A car that weaves about its path, its samples noisy and at times late; in bursts missing, infinite or absurd.

    noise: factor on that of the sensors.
    """
    rng, t = random("measurements"), 0.05 * np.arange(STEPS + AHEAD)
    reference = 1.5 * np.sin(0.3 * t) + 3.5 * (np.sin(0.05 * t) > 0.0)
    spread = (0.3, 0.05, 0.1, 0.5, 0.05, 1.0, 0.0, 0.0, 0.002)
    states = noise * rng.normal(size=(STEPS, 9)) * spread
    states[:, 3] += reference[:STEPS]
    late = rng.random(STEPS) < 0.2
    states[late, 6], states[late, 7] = rng.uniform(0.0, 0.3, late.sum()), rng.uniform(0.0, 0.1, late.sum())
    speeds = np.round(16.0 + 15.0 * np.sin(0.02 * np.arange(STEPS)), 1)
    references = np.lib.stride_tricks.sliding_window_view(reference, AHEAD)[:STEPS].copy()
    for begin in np.flatnonzero(rng.random(STEPS) < 0.01):
        end = begin + int(rng.integers(1, 15))
        for rows, share in ((states[:, :6], 0.3), (references, 0.02), (speeds[:, None], 0.2)):
            piece = rows[begin:end]
            hit = rng.random(piece.shape) < share
            piece[hit] = rng.choice(HOSTILE, int(hit.sum()))
    speeds[1200:1220], speeds[1500:1505] = 0.0, -2.0
    return Inputs(states, speeds, references)


def answer_row(answer: Any) -> list[float]:
    """All numbers of a command."""
    diagnostics = answer.diagnostics
    values = diagnostics.values() if isinstance(diagnostics, dict) else diagnostics
    return [answer.angle, answer.move, answer.held, *answer.tuning, *values]


def commands(
    at: Any, controller: Any, width: int = 4, variables: Any = None, road: Any = None, *, noise: float = 1.0,
    disturbed: bool = True, anew: int = STEPS + 1,
) -> Array:  # fmt: skip
    """(STEPS, .) what a controller answers; NaN where it refuses.

    width: how many of the sensors it is given; variables, road: of each step; noise: as for `measurements`; disturbed:
    now and then the command applied was another, or the path changed; anew: after so many steps it is reset.
    """
    inputs, rows = measurements(noise), []
    for k in range(STEPS):
        if k % anew == anew - 1:
            controller.reset()
        if disturbed and k % 300 == 299:
            controller.applied(0.02)
        if disturbed and k % 500 == 499:
            controller.change_path(0.05, -0.4)
        more = {} if road is None else {"road": road(k)}
        if variables is not None:
            more["variables"] = variables[k]
        try:
            command = controller.step(inputs.states[k, :width], float(inputs.speeds[k]), inputs.references[k], **more)
            rows.append(answer_row(command))
        except at.InvalidInput:
            rows.append([])
    size = max(map(len, rows))
    return np.array([row if row else [math.nan] * size for row in rows])


def numbers(record: Any) -> Array:
    """The numeric fields of a dataclass or a named tuple, flat; text as the sum of its bytes."""
    fields = record._asdict() if hasattr(record, "_asdict") else vars(record)
    found: list[Array] = []
    for value in fields.values():
        if isinstance(value, Mapping):
            value = [np.asarray(each, dtype=float) for each in value.values()]
            found += [each.ravel() for each in value]
        elif isinstance(value, np.ndarray) and value.dtype == object:
            found.append(np.array([float(zlib.crc32(str(each).encode())) for each in value]))
        else:
            found.append(np.asarray(value, dtype=float).ravel())
    return np.concatenate(found) if found else np.zeros(0)


def paper(at: Any) -> Any:
    """The paper's car."""
    return at.load_vehicle("paper")


def own_road(at: Any) -> Any:
    """An open road of all kinds of elements."""
    from adaptrack.road import Arc, Clothoid, Cubic, Line

    elements = [
        Line(length=60.0), Clothoid(length=40.0, start_curvature=0.0, end_curvature=0.015),
        Arc(length=70.0, curvature=0.015), Clothoid(length=50.0, start_curvature=0.015, end_curvature=-0.02),
        Arc(length=60.0, curvature=-0.02), Cubic(x=(0.0, 50.0, 0.0, 0.0), y=(0.0, 0.0, 3.0, -2.0)), Line(length=80.0),
    ]  # fmt: skip
    return at.Road.from_segments(elements, name="elements")


def ring(at: Any) -> Any:
    """A closed road."""
    from adaptrack.road import Arc

    return at.Road.from_segments([Arc(length=120.0 * math.pi, curvature=1.0 / 60.0)], closed=True, name="ring")


def lane_change(at: Any, **options: Any) -> Any:
    """A lane change in a gust, 8 s."""
    return at.load_scenario("lane-change", **{"amplitude": 3.5, "speed": 18.0, "gust": 10.0, **options})


# -- what a user writes -----------------------------------------------------------------------------------------------
def bicycle(x: Any, u: Any, environment: Any, p: Any, dx: Any) -> None:
    """A linear car with a roll angle of its own that nothing feels."""
    speed = max(x[3], 1.0)
    front = 2.0 * p[4] * (u[0] - (x[4] + p[2] * x[5]) / speed)
    rear = -2.0 * p[5] * (x[4] - p[3] * x[5]) / speed
    dx[0] = x[3] * math.cos(x[2]) - x[4] * math.sin(x[2])
    dx[1] = x[3] * math.sin(x[2]) + x[4] * math.cos(x[2])
    dx[2] = x[5]
    dx[3] = u[1] / p[0] + x[4] * x[5]
    dx[4] = (front + rear) / p[0] - x[3] * x[5]
    dx[5] = (p[2] * front - p[3] * rear) / p[1]
    dx[6] = 5.0 * ((front + rear) / p[0] - x[6])


def kinematic(speed: float, period: float, p: Any, a: Any, b: Any, e: Any) -> None:
    """Yaw and offset of a car that does not slip."""
    way = speed * period
    a[0, 0], a[0, 1], a[1, 0], a[1, 1] = 1.0, 0.0, way, 1.0
    b[0], b[1] = way / p[0], 0.5 * way * way / p[0]
    e[0], e[1] = -period, -0.5 * way * period


def smoothed(
    speed: float, measured: Any, command: float, a: Any, b: Any, p: Any, memory: Any, x: Any, d: Any
) -> None:  # fmt: skip
    """The measured state, half of it what it was before."""
    for i in range(x.size):
        if math.isfinite(measured[i]) and abs(measured[i]) < 1e3:
            memory[i] += p[0] * (measured[i] - memory[i])
        x[i], d[i] = memory[i], 0.0


def proportional(
    situation: Any, reference: Any, road: Any, tuning: Any, parameters: Any, memory: Any, answer: Any
) -> None:  # fmt: skip
    """Steer by the offset and the yaw angle; memory counts the steps."""
    wanted = tuning[0] * (reference[0] - situation[3]) - tuning[1] * situation[1]
    last = situation[5]
    memory[0] += 1.0
    least, most = max(parameters[3], last + parameters[1]), min(parameters[4], last + parameters[2])
    answer[0] = min(max(wanted, least), most) if math.isfinite(wanted) else last
    answer[1] = memory[0]


@cache
def users_plant(at: Any) -> Any:
    """A plant of a user's."""
    parameters = {"m": 1575.0, "iz": 2875.0, "lf": 1.2, "lr": 1.6, "cf": 19000.0, "cr": 33000.0}
    return at.UserPlant(bicycle, parameters, mass=1575.0, own_states=("roll",), label="bicycle")


@cache
def users_law(at: Any) -> Any:
    """A steering law of a user's."""
    return at.UserController(
        proportional, tuning={"offset_gain": 0.05, "yaw_gain": 1.0}, memory_size=1, diagnostics=("steps",), period=0.05,
        label="proportional",
    )  # fmt: skip


@cache
def users_model(at: Any) -> Any:
    """A prediction model of a user's."""
    return at.UserModel(kinematic, ("yaw", "y"), parameters={"wheelbase": 2.8}, period=0.05, label="kinematic")


@cache
def users_estimator(at: Any) -> Any:
    """An estimator of a user's."""
    return at.UserEstimator(smoothed, parameters={"share": 0.5}, memory_size=4, label="smoothed")


def users_solver() -> Any:
    """A QP solver of a user's: the package's own, called from Python."""
    from adaptrack.control.qp import ActiveSet, QPSolver

    class Own(QPSolver):
        name = "own"

        def __init__(self) -> None:
            super().__init__()
            self.exact = ActiveSet()

        def attempt(self, qp: Any, warm_start: Any = None) -> Any:
            return self.exact.attempt(qp, warm_start)

    return Own()


# -- controllers, step by step ----------------------------------------------------------------------------------------
def qp_solvers() -> dict[str, Any]:
    """Every setting of our QP solvers."""
    from adaptrack.control.qp import ActiveSet, Hildreth

    return {
        "active-set": ActiveSet(), "active-set, 2 changes": ActiveSet(2),
        **{f"hildreth, {what}": Hildreth(on_uncertified=what) for what in ("exact", "apply", "hold")},
        "hildreth, 400 sweeps": Hildreth(400, 1e-12), "hildreth, 3 sweeps": Hildreth(3, 1e-7, "hold"),
        "from Python": users_solver(),
    }  # fmt: skip


def published_mpc(at: Any) -> Named:
    """The MPC of the paper in its variants; the plan that its last step predicts, and some of its QPs."""
    car, tight, calm = paper(at), at.Limits(move=(-0.01, 0.01), angle=(-0.1, 0.1)), at.Tuning(35, 8, 1.0, 300.0)
    soft = at.Limits(output=(-1.0, 3.0))
    laguerre = at.Moves.laguerre(0.8, 6)
    variants: dict[str, dict[str, Any]] = {
        "as written": {"tuning": at.Tuning()}, "with preview": {"preview": True}, "every 50 ms": {"period": 0.05},
        "tight limits": {"limits": tight}, "output limits": {"limits": soft}, "laguerre": {"moves": laguerre},
        "laguerre, output limits": {"moves": laguerre, "limits": soft, "preview": True},
        "ahead of the wheels": {"limits": at.Limits(ahead=0.05, error=0.5)}, "speed floor": {"speed_floor": 5.0},
        "long horizons": {"tuning": at.Tuning(120, 40, 1.0, 50.0), "preview": True},
        "one step": {"tuning": at.Tuning(1, 1, 1.0, 0.1)},
    }  # fmt: skip
    variants |= {f"solver {name}": {"solver": each, "limits": tight} for name, each in qp_solvers().items()}
    variants |= {
        f"solver {name}, output limits": {"solver": qp_solvers()[name], "limits": soft}
        for name in ("hildreth, exact", "from Python")
    }
    for name, options in variants.items():
        mpc = at.published_mpc(car, **{"tuning": calm, **options})
        yield name, commands(at, mpc, noise=0.05)
        mpc.reset()
        for k in range(3):
            told = mpc.step([0.1, 0.02, 0.1 * k, 0.5], 15.0, [3.0, 2.0, 1.0])
        yield f"{name}: plan", np.concatenate([*mpc.predicted_output(), answer_row(told)])
        qp = mpc.problem([0.1, 0.02, 0.1, 0.6], 15.0, [3.0, 2.0, 1.0])
        yield f"{name}: QP", np.concatenate([np.ravel(each) for each in (qp.E, qp.K, qp.M, qp.gamma)])
    released = at.get_controller("as-released", car)
    yield "as released", commands(at, released, noise=0.05)


def informed_mpc(at: Any) -> Named:
    """The MPC that knows its car, in three profiles and with other parts; it is given all sensors."""
    car = paper(at)
    for profile in ("paper", "road", "production"):
        yield profile, commands(at, at.MPC(car, profile=profile), 9)
    for name in at.list_vehicles():
        yield f"car {name}", commands(at, at.MPC(at.load_vehicle(name), profile="production"), 9)
    unsure = at.Uncertainty(lag=0.1, dead_time=0.05, stiffness=1.3)
    tolerant = at.KalmanFilter(at.SensorNoise(0.05, 0.01, 0.01, 0.1), at.Drifts(side=3.0, turn=6.0), distrust=math.inf)
    lagless, slow = at.PathModel(car, 0.05), at.PathModel(car, 0.05, 0.2, 0.17)
    variants: dict[str, dict[str, Any]] = {
        "four sensors only": {"profile": "road"},
        "unknown steering": {"profile": "road", "belief": "unknown", "learning": None},
        "unsure": {"profile": "road", "uncertainty": unsure}, "no preview": {"profile": "road", "preview": False},
        "laguerre": {"profile": "road", "moves": at.Moves.laguerre(0.7, 8)},
        "output limits": {"profile": "road", "limits": at.Limits(output=(-1.0, 3.0))},
        "hildreth": {"profile": "road", "solver": "hildreth"},
        "from Python": {"profile": "road", "solver": users_solver()},
        "own filter": {"profile": "road", "estimator": tolerant}, "own model": {"model": users_model(at)},
        "own model and filter": {"model": slow, "estimator": at.KalmanFilter()},
        "without lag": {"model": lagless, "estimator": at.KalmanFilter()},
        "without lag, deadbeat": {"model": lagless, "estimator": "deadbeat"},
        "own estimator": {"estimator": users_estimator(at), "period": 0.05},
    }  # fmt: skip
    for name, options in variants.items():
        yield name, commands(at, at.MPC(car, **options), 4 if name == "four sensors only" else 9, noise=0.2)


def learning_mpc(at: Any) -> Named:
    """The MPC that learns its car, and what it has learned."""
    car = paper(at)
    for name in ("road", "production"):
        mpc = at.MPC(car, profile=name, learning=at.Learning())
        yield name, commands(at, mpc, 9)
        learned = mpc.learned()
        yield f"{name}: learned", np.array([value for value in vars(learned).values() if isinstance(value, float)])
        mpc.restart()
        yield f"{name}: again", commands(at, mpc, 9, disturbed=False)
    start = at.MPC(car, profile="road", learning=at.Learning(start=learned))
    yield "from an earlier drive", commands(at, start, 9)


def scheduled_mpc(at: Any) -> Named:
    """MPCs with every scheduler that ships, and with one in Python, whose answers are no tunings at times."""
    rng = random("variables")
    rows = rng.uniform((2.0, -8.0, 0.2, -35.0, -4.0, -6.0, -3.0), (32.0, 8.0, 1.1, 35.0, 4.0, 6.0, 3.0), (STEPS, 7))
    rows[rng.random(rows.shape) < 0.005] = math.nan
    looked = [at.SchedulingVariables(*row) for row in rows.tolist()]
    car = paper(at)
    for name in at.list_schedulers():
        schedule = at.load_scheduler(name)
        mpc = (
            at.MPC(car, profile="road", scheduler=schedule) if name.startswith("informed")
            else at.published_mpc(car, scheduler=schedule, period=0.05, preview=True)
        )  # fmt: skip
        yield name, commands(at, mpc, 4, looked)
        yield f"{name}: counts", np.array(list(mpc.scheduler_counts.values()))

    def moody(variables: Any) -> tuple[float, ...]:
        return (20.4, 5.0, 1.0, 10.0) if variables.speed < 20.0 else (math.nan, 30.0, 1e300, -1.0)

    yield "in Python", commands(at, at.published_mpc(car, scheduler=moody), 4, looked, noise=0.05)


def steering_laws(at: Any) -> Named:
    """The laws beside the MPC, on a straight road and along one that bends."""
    car, road = paper(at), own_road(at)
    told = {"profile": "road"}
    laws: dict[str, Any] = {
        "lqr": at.LQR(car, period=0.05), "lqr, preview": at.LQR(car, period=0.05, preview=True, preview_time=0.3),
        "preview lqr": at.PreviewLQR(car, **told), "preview lqr, production": at.PreviewLQR(car, profile="production"),
        "pure pursuit": at.PurePursuit(car, period=0.05), "stanley": at.Stanley(car, period=0.05, preview=True),
        "kinematic mpc": at.KinematicMPC(car, stages=20, **told),
        "kinematic mpc, no filter": at.KinematicMPC(car, stages=10, step=0.15, cutoff=0.0, lateral_jerk=0.5),
        "a user's": users_law(at),
    }  # fmt: skip
    speeds = np.full(AHEAD, 15.0)

    def ahead(k: int) -> Any:
        return at.RoadAhead(road, 0.2 * k, speeds)

    for name, law in laws.items():
        yield name, commands(at, law, anew=200)
        law.reset()
        yield f"{name}, on a road", commands(at, law, road=ahead, anew=200)


def mpc_on_roads(at: Any) -> Named:
    """MPCs that see a road that bends."""
    car, road, speeds = paper(at), own_road(at), np.linspace(14.0, 18.0, AHEAD)

    def ahead(k: int) -> Any:
        return None if k % 97 == 96 else at.RoadAhead(road, 0.2 * k - 5.0, speeds)

    for name, mpc in {
        "published": at.published_mpc(car, at.Tuning(35, 8, 1.0, 300.0), period=0.05, preview=True),
        "informed": at.MPC(car, profile="road"),
        "learning": at.MPC(car, profile="production", learning=at.Learning()),
        "laguerre": at.MPC(car, profile="road", moves=at.Moves.laguerre(0.7, 6)),
        "own model": at.MPC(car, model=users_model(at), preview=True),
        "from Python": at.MPC(car, profile="road", solver=users_solver()),
    }.items():  # fmt: skip
        yield name, commands(at, mpc, 9 if name != "published" else 4, road=ahead, noise=0.2)


def trackers(at: Any) -> Named:
    """Controllers in a loop of one's own, on two roads: at times that stray, samples late, repeated, absurd."""
    rng, car = random("trackers"), paper(at)
    t = np.cumsum(rng.uniform(0.02, 0.09, STEPS))
    true = np.column_stack([60.0 * np.sin(0.2 * t), 60.0 * (1.0 - np.cos(0.2 * t)), 0.2 * t, np.full(STEPS, 12.0),
                            np.full(STEPS, 0.2)])  # fmt: skip
    rows = true + rng.normal(size=true.shape) * (0.05, 0.05, 0.01, 0.1, 0.01)
    rows[:, 2] = np.remainder(rows[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    hit = (rng.random(rows.shape) < 0.05) & (rng.random(STEPS) < 0.1)[:, None]
    rows[hit] = rng.choice(HOSTILE, int(hit.sum()))
    late = np.where(rng.random(STEPS) < 0.3, rng.uniform(0.0, 0.2, STEPS), 0.0)
    repeated = rng.random(STEPS) < 0.02
    makers: dict[str, Callable[[], Any]] = {
        "informed": lambda: at.MPC(car, profile="road"), "learning": lambda: at.MPC(car, learning=at.Learning()),
        "published": lambda: at.published_mpc(car, period=0.05), "lqr": lambda: at.LQR(car, period=0.05),
    }  # fmt: skip
    for name, make in makers.items():
        for where, road in (("ring", ring(at)), ("elements", own_road(at))):
            tracker, found = at.Tracker(make(), road), []
            for k in range(STEPS):
                now = t[k - 1] if repeated[k] and k else t[k]
                told = tracker.step(now - late[k], *rows[k].tolist(), lateral_velocity=0.01, now=now)
                found.append(numbers_of(told))
            yield f"{name} on {where}", padded(found)


# -- plants and closed loops ------------------------------------------------------------------------------------------
def plants(at: Any) -> list[Any]:
    """Both cars on every tyre that ships, every car that ships on its own, a user's plant."""
    made = [
        kind(paper(at), tyre) for kind in (at.SingleTrack, at.DualTrack) for tyre in at.list_tyres()
    ]  # fmt: skip
    made += [at.DualTrack(at.load_vehicle(name)) for name in at.list_vehicles()]
    return [*made, users_plant(at)]


def plant_name(plant: Any) -> str:
    """By kind, car and tyre."""
    return f"{plant.name}, {getattr(getattr(plant, 'vehicle', None), 'name', 'own')}, {plant.tyre_name}"


def right_hand_sides(at: Any) -> Named:
    """The derivatives of every plant at random states, some of them standing, spinning or not finite."""
    rng = random("states")
    for plant in plants(at):
        n = len(plant.state_names)
        x = rng.normal(size=(300, n)) * np.array([10.0, 10.0, 1.0, 8.0, 1.0, 0.5, *[0.05] * (n - 6)])
        x[:, 3] += 12.0
        x[:5, 3] = 0.0, 1e-9, -5.0, math.nan, 80.0
        u = rng.normal(size=(300, 3)) * (0.1, 3000.0, 1.0)
        u[::2, 2] = math.nan
        around = np.column_stack(
            [rng.uniform(0.1, 1.1, (300, 4)), 20.0 * rng.normal(size=(300, 2)), rng.normal(size=300)]
        )
        slopes = [plant.derivative(*each) for each in zip(x, u, around, strict=True)]
        yield plant_name(plant), np.hstack([x, u, around, np.array(slopes)])


def drivers(at: Any, profile: str) -> dict[str, Any]:
    """One controller of each kind that drives in a profile."""
    car = paper(at)
    period, preview = (0.1, False) if profile == "paper" else (0.05, True)
    own = {"profile": profile}
    made = {
        "informed": at.MPC(car, **own), "learning": at.MPC(car, learning=at.Learning(), **own),
        "preview lqr": at.PreviewLQR(car, **own), "kinematic mpc": at.KinematicMPC(car, **own),
    }  # fmt: skip
    if profile == "production":  # the others need the lateral velocity
        return made
    calm = at.Tuning(35, 8, 1.0, 0.05 if profile == "paper" else 3000.0)
    return {
        **made, "published": at.published_mpc(car, calm, period=period, preview=preview),
        "laguerre": at.published_mpc(car, at.Tuning(35, 8, 1.0, 500.0), period=period, moves=at.Moves.laguerre(0.8, 6)),
        "lqr": at.LQR(car, period=period, preview=preview), "pure pursuit": at.PurePursuit(car, period=period),
        "stanley": at.Stanley(car, period=period, preview=preview),
    }  # fmt: skip


def both_ways(at: Any, name: str, plant: Any, controller: Any, drive: Any, **options: Any) -> Named:
    """The traces of a drive from Python and compiled."""
    yield f"{name}, from Python", trace(at.simulate(plant, controller, drive, **options))
    yield f"{name}, compiled", trace(at.rollout(plant, controller, drive, **options))


def straight_runs(at: Any) -> Named:
    """Whole traces of lane changes and random drives, in three profiles, from Python and compiled."""
    plant = at.DualTrack(paper(at), "magic-formula")
    for profile in ("paper", "road", "production"):
        for name, controller in drivers(at, profile).items():
            yield from both_ways(at, f"{profile}, {name}", plant, controller, lane_change(at), profile=profile, seed=3)
        mpc, drive = at.MPC(paper(at), profile=profile), at.random_drive(9_500_001, 30.0)
        yield f"{profile}, random drive", trace(at.rollout(plant, mpc, drive, profile=profile, seed=5))
        yield from both_ways(
            at, f"{profile}, with a driver", plant, mpc, lane_change(at), profile=profile, driver=at.Driver()
        )
        lost = lane_change(at, amplitude=8.0, speed=28.0, friction=0.2)
        yield f"{profile}, lost", trace(at.rollout(at.SingleTrack(paper(at)), mpc, lost, profile=profile, seed=7))


def road_runs(at: Any) -> Named:
    """Whole traces along roads, in three profiles, from Python and compiled."""
    plant = at.DualTrack(paper(at), "magic-formula")
    for profile in ("paper", "road", "production"):
        for where, road, laps in (("elements", own_road(at), 1), ("ring", ring(at), 2)):
            drive = at.RoadDrive(road, at.plan_speed(road, paper(at), top_speed=14.0), laps=laps, wind=5.0)
            for name, controller in drivers(at, profile).items():
                options = {"profile": profile, "seed": 3}
                yield from both_ways(at, f"{profile}, {name} on {where}", plant, controller, drive, **options)


def runs_of_others(at: Any) -> Named:
    """Plants, laws, models and estimators of a user's, from Python and compiled; every kind of plant."""
    car = paper(at)
    tuning = at.Tuning(30, 4, 1.0, 300.0)
    informed = at.MPC(car, profile="road")
    cases: dict[str, tuple[Any, Any]] = {
        "plant": (users_plant(at), informed), "law": (at.DualTrack(car), users_law(at)),
        "model": (at.DualTrack(car), at.MPC(car, tuning, model=users_model(at), preview=True)),
        "estimator": (at.SingleTrack(car), at.MPC(car, tuning, estimator=users_estimator(at), period=0.05)),
        **{plant_name(plant): (plant, informed) for plant in plants(at)[:-1]},
    }  # fmt: skip
    for name, (plant, controller) in cases.items():
        yield from both_ways(at, name, plant, controller, lane_change(at), profile="road", seed=2)


def batches(at: Any) -> Named:
    """Many runs at once: with tunings, schedulers, noise, a driver, friction and wind known in all ways."""
    car, rng = paper(at), random("batches")
    plant = at.DualTrack(car, "magic-formula")
    draw = rng.uniform
    steps = [at.load_scenario("step", amplitude=draw(-15, 15), speed=draw(3, 27), friction=draw(0.5, 0.9),
                              wind=draw(-30, 30)) for _ in range(40)]  # fmt: skip
    which = np.repeat(np.arange(40), 10)
    tunings = np.column_stack(
        [rng.integers(1, 56, 400), rng.integers(1, 19, 400), draw(0.1, 10.0, 400), draw(0.001, 0.1, 400)]
    )
    for solver in ("active-set", "hildreth"):
        mpc = at.published_mpc(car, solver=solver)
        yield f"published, {solver}", numbers(at.rollout_batch(plant, mpc, steps, tunings, scenario_indices=which))
    changes = [lane_change(at, amplitude=draw(-7, 7), speed=draw(4, 27), friction=draw(0.3, 1.0)) for _ in range(40)]
    roads = [at.RoadDrive(own_road(at), 12.0), *(at.RoadDrive(ring(at), speed) for speed in (9.0, 15.0)), *changes[:3]]
    seeds = np.arange(40)
    for profile in ("paper", "road", "production"):
        for name, controller in drivers(at, profile).items():
            found = at.rollout_batch(plant, controller, changes, scenario_indices=seeds, profile=profile, seeds=seeds)
            yield f"{profile}, {name}", numbers(found)
            found = at.rollout_batch(plant, controller, roads, profile=profile, seeds=1, threads=2)
            yield f"{profile}, {name} on roads", numbers(found)
    scheduled = at.published_mpc(car, scheduler=at.load_scheduler("road-nn"), period=0.05, preview=True)
    perception = {
        "exactly": None, "estimated": at.FrictionWindEstimator.of(plant, "road"),
        "with errors": at.Perception(noise=0.2, bias=0.1, delay=0.5), "not": at.Perception(withheld=True),
    }  # fmt: skip
    options = {"scenario_indices": seeds, "profile": "road", "seeds": seeds}
    for name, known in perception.items():
        batch = at.rollout_batch(plant, scheduled, changes, perception=known, **options)
        yield f"friction known {name}", numbers(batch)
        run = at.simulate(plant, scheduled, changes[0], profile="road", seed=4, perception=known)
        yield f"friction known {name}, from Python", trace(run)
    for name, (driven, controller) in {
        "user's plant": (users_plant(at), at.MPC(car, profile="road")), "user's law": (plant, users_law(at)),
        "user's model": (plant, at.MPC(car, model=users_model(at))),
    }.items():  # fmt: skip
        yield name, numbers(at.rollout_batch(driven, controller, changes, **options))
    batch = at.rollout_batch(plant, at.MPC(car, profile="road"), changes, driver=at.Driver(), **options)
    yield "with a driver", numbers(batch)


# -- roads, models, quadratic programmes ------------------------------------------------------------------------------
def road_geometry(at: Any) -> Named:
    """Points, feet near and far, headings, and what lies ahead, of made, fitted and generated roads."""
    rng = random("roads")
    roads = {"elements": own_road(at), "ring": ring(at)}
    for name, road in roads.items():
        s = np.concatenate([np.linspace(-20.0, road.length + 20.0, 400), [0.0, road.length, 3.0 * road.length]])
        points = road.at(s)
        yield f"{name}: points", np.column_stack([s, *points])
        spread = rng.normal(size=(len(s), 2)) * np.where(rng.random((len(s), 1)) < 0.8, 2.0, 40.0)
        x, y = points.x + spread[:, 0], points.y + spread[:, 1]
        yield f"{name}: feet", np.column_stack(road.project(x, y))
        yield f"{name}: feet near", np.column_stack(road.project(x, y, s + rng.normal(size=len(s))))
        yield f"{name}: far feet", np.column_stack(road.project(1e3 * x, 1e3 * y))
        for k in range(8):
            ahead = at.RoadAhead(road, 40.0 * k - 30.0, rng.uniform(5.0, 25.0, 60))
            yield f"{name}: ahead {k}", ahead.bend(100, 12.0, 2.3, 0.05)
        yield f"{name}: plan", np.concatenate(at.plan_speed(road, paper(at)).motion(np.linspace(0.0, 20.0, 200)))


def quadratic_programmes(at: Any) -> Named:
    """A corpus of the controllers' problems through our solvers: solutions, multipliers, iterations, residuals."""
    from tools.qp_corpus import chunk

    from adaptrack.control.qp import ActiveSet, Hildreth

    problems = chunk(0)
    solvers = {
        "active set": ActiveSet(), "active set, 3 changes": ActiveSet(3), "hildreth": Hildreth(),
        "hildreth, long": Hildreth(2000, 1e-14, "hold"), "hildreth, applied": Hildreth(5, 1e-7, "apply"),
    }  # fmt: skip
    for name, solver in solvers.items():
        found, before = [], None
        for problem in problems:
            told = solver.solve(problem.qp)
            again = solver.solve(problem.qp, told if before is None else before)
            before = told
            for each in (told, again):
                found += [each.x, each.lam, [each.status, each.iterations], each.residuals]
        yield name, np.concatenate([np.asarray(each, dtype=float) for each in found])


WORKLOADS: Mapping[str, Callable[[Any], Named]] = {
    workload.__name__.replace("_", "-"): workload
    for workload in (
        published_mpc, informed_mpc, learning_mpc, scheduled_mpc, steering_laws, mpc_on_roads, trackers,
        right_hand_sides, straight_runs, road_runs, runs_of_others, batches, road_geometry, quadratic_programmes,
        *EXPORTED,
    )
}  # fmt: skip


def record(file: Path, names: Sequence[str]) -> None:
    """Do the workloads with the package of this interpreter and write their arrays."""
    import adaptrack as at

    np.savez_compressed(file, **{
        f"{name}|{key.replace('/', ' per ')}": np.asarray(values, dtype=float)
        for name in names for key, values in WORKLOADS[name](at)
    })  # fmt: skip


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("names", nargs="+", choices=WORKLOADS)
    parser.add_argument("--record", type=Path, required=True, metavar="FILE")
    options = parser.parse_args()
    record(options.record, options.names)
