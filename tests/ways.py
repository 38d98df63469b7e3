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
from adaptrack.drive.simulate import rollout

preview_lqr.GAIN_SPEEDS = preview_lqr.GAIN_SPEEDS[
    ::10
]  # fewer gains: in plain Python a Riccati equation takes milliseconds


def controllers():
    """Every shipped controller, by name."""
    car = at.load_vehicle("midsize-sedan")
    yield "published", at.published_mpc(car)
    yield "laguerre", at.published_mpc(car, moves=at.Moves(kind="laguerre", pole=0.5))
    yield "bounded output", at.published_mpc(car, limits=at.Limits(output=(-0.5, 0.5)))
    yield "informed", at.MPC(car, profile="road")
    yield "learning", at.MPC(car, profile="road", learning=at.Learning())
    for name in ("pure-pursuit", "stanley", "lqr", "preview-lqr", "kinematic-mpc"):
        yield name, at.get_controller(name, car)


def steps(controller, count, rng):
    """What a controller answers to random states."""
    states, speeds = rng.normal(size=(count, 4)) * [0.3, 0.05, 0.1, 1.0], rng.uniform(5.0, 25.0, count).tolist()
    answers = []
    for state, speed in zip(states, speeds, strict=True):
        answer = controller.step(state, speed, np.zeros(1))
        answers.append([answer.angle, answer.move])
    return np.array(answers)


def main(file, count, runs, seconds):
    rng = np.random.default_rng(1)
    slow = {"kinematic-mpc": 10}  # times as long a step as the others
    results = {name: steps(controller, max(count // slow.get(name, 1), 2), rng) for name, controller in controllers()}
    car = at.load_vehicle("midsize-sedan")
    for i in range(runs):
        for profile in ("paper", "road", "production"):
            drive = at.random_drive(i, seconds)
            run = rollout(at.DualTrack(car), at.MPC(car, profile=profile), drive, profile=profile, seed=i)
            results |= {f"{profile} {i} {name}": values for name, values in run.columns().items()}
    np.savez(file, **results)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:4]), float(sys.argv[4]))
