"""Work for kernels however they are run: ``python tests/ways.py FILE STEPS RUNS SECONDS`` keeps every number of it."""

import ctypes.util
import sys

import numpy as np

from adaptrack.core import kernel

if kernel.INTERPRETED:
    exact_fma = ctypes.CDLL(ctypes.util.find_library("m")).fma  # Python's own rounds twice
    exact_fma.argtypes, exact_fma.restype = [ctypes.c_double] * 3, ctypes.c_double
    kernel.fma = exact_fma  # before any kernel takes it from there
    from adaptrack.core.maths import vectors

    def fma8(a, b, c):
        return np.array([exact_fma(*factors) for factors in zip(a.tolist(), b.tolist(), c.tolist(), strict=True)])

    vectors.fma8 = fma8

import adaptrack as at
from adaptrack.control.controllers import preview_lqr
from adaptrack.core.controllers import informed, mpc_step
from adaptrack.core.layout import empty
from adaptrack.core.tracker import longitudinal
from adaptrack.core.units import controller as unit
from adaptrack.drive.simulate import rollout
from adaptrack.export.units import controller_unit
from adaptrack.road import Arc, Line, Road

preview_lqr.GAIN_SPEEDS = preview_lqr.GAIN_SPEEDS[
    ::10
]  # fewer gains: in plain Python a Riccati equation takes milliseconds


def controllers(has_lqr=True):
    """Every shipped controller, by name."""
    car = at.load_vehicle("midsize-sedan")
    yield "published", at.published_mpc(car)
    yield "laguerre", at.published_mpc(car, moves=at.Moves(kind="laguerre", pole=0.5))
    yield "bounded output", at.published_mpc(car, limits=at.Limits(output=(-0.5, 0.5)))
    yield "informed", at.MPC(car, profile="road")
    yield "learning", at.MPC(car, profile="road", learning=at.Learning())
    for name in ("pure-pursuit", "stanley", *(["lqr"] if has_lqr else []), "preview-lqr", "kinematic-mpc"):
        yield name, at.get_controller(name, car)


def steps(controller, count, rng):
    """What a controller answers to random states."""
    states, speeds = rng.normal(size=(count, 4)) * [0.3, 0.05, 0.1, 1.0], rng.uniform(5.0, 25.0, count).tolist()
    answers = []
    for state, speed in zip(states, speeds, strict=True):
        answer = controller.step(state, speed, np.zeros(1))
        answers.append([answer.angle, answer.move])
    return np.array(answers)


def numbers(values):
    """Every number of a record, or of a list of arrays; no addresses."""
    arrays = [value for value in values if isinstance(value, np.ndarray)]
    flat = [array.view(np.float64) if array.dtype.names else array.astype(float).ravel() for array in arrays]
    inner = [numbers(value) for value in values if isinstance(value, tuple)]
    return np.concatenate([*flat, *inner, [value for value in values if type(value) is float]])


def mpc_kernels(controller, count, rng):
    """`steps` of an MPC at unknown states, speeds and tunings, too; and its estimator without a QP."""
    mpc, functions = controller._mpc, controller.functions
    states = rng.normal(scale=0.2, size=(count, mpc.measured.size))
    states[:, 4:] = np.nan
    speeds, answers = rng.uniform(1.0, 25.0, count), np.zeros((count, mpc.answer.shape[1]))
    tunings = np.column_stack([rng.integers(8, 20, count), rng.integers(1, 5, count), rng.uniform(1, 20, (count, 2))])
    states[1, 0] = speeds[2] = tunings[-1, 0] = np.nan
    record = kernel.Resident(mpc)
    mpc_step.steps(states, speeds, rng.normal(scale=0.2, size=(count, 1)), tunings, record, functions, answers)
    yield numbers([answers, *mpc.model, mpc.memory, *mpc.informed])
    for _ in range(count if mpc.settings.informed > 0 else 0):
        mpc.measured[:] = rng.normal(scale=0.1, size=mpc.measured.size)
        informed._estimate_alone(0, float(rng.uniform(1.0, 30.0)), record, functions)
        yield numbers([*mpc.model, mpc.memory, *mpc.informed])


def other_kernels(controller, car, count, rng):
    """The beginning of a controller as a unit, and the end of a fault of the speed control."""
    road = Road.from_segments([Line(length=80.0), Arc(length=60.0, curvature=0.01)])
    record = controller_unit(controller, road, at.plan_speed(road, car)).record
    for angle in [np.nan, *rng.normal(scale=0.3, size=count)]:
        record.values[unit.STEERING_VALUE.start_wheel_angle] = angle
        yield np.array([unit.steering_begin(kernel.Resident(record)), *numbers(record)])
        speed_control = empty(longitudinal.Longitudinal)
        speed_control = speed_control._replace(memory=np.zeros(1, speed_control.memory.dtype))
        memory = speed_control.memory.view(np.float64)
        memory[:] = rng.normal(size=memory.size)
        longitudinal.longitudinal_acknowledge(kernel.Resident(speed_control))
        yield memory


def main(file, count, runs, seconds):
    rng = np.random.default_rng(1)
    slow = {"kinematic-mpc": 10}  # times as long a step as the others
    all_laws = controllers(has_lqr=count > 10)  # its grid of gains takes the interpreter seconds
    results = {name: steps(controller, max(count // slow.get(name, 1), 2), rng) for name, controller in all_laws}
    car = at.load_vehicle("midsize-sedan")
    for name, controller in controllers(has_lqr=False):
        if isinstance(controller, at.MPC):
            results |= {f"{name} alone {i}": values for i, values in enumerate(mpc_kernels(controller, 4, rng))}
            results |= {f"{name} unit {i}": values for i, values in enumerate(other_kernels(controller, car, 2, rng))}
    for i in range(runs):
        for profile in ("paper", "road", "production"):
            drive = at.random_drive(i, seconds)
            run = rollout(at.DualTrack(car), at.MPC(car, profile=profile), drive, profile=profile, seed=i)
            results |= {f"{profile} {i} {name}": values for name, values in run.columns().items()}
    np.savez(file, **results)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:4]), float(sys.argv[4]))
