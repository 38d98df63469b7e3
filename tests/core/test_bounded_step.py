"""A step's work and memory are bounded: changes of the active set, allocations in kernels and in Python."""

import gc
import tracemalloc

import numpy as np
import pytest
from tools.qp_corpus import chunk

import adaptrack as at
from adaptrack.control.qp import ActiveSet, QPStatus
from adaptrack.core.qp.problem import CHANGES
from adaptrack.road import Line

CAR = at.load_vehicle("paper")
compiled = pytest.mark.compiled


def capped_mpc(most):
    """An MPC that may change its active set so many times."""
    limits = at.Limits(move=(-0.02, 0.02), angle=(-0.1, 0.1))
    return at.published_mpc(CAR, at.Tuning(30, 15, 1.0, 0.01), period=0.05, limits=limits, solver=ActiveSet(most))


def test_a_step_beyond_its_changes_follows_the_last_plan_and_says_so():
    mpc = capped_mpc(3)
    reply = mpc.step([0.0, 0.0, 0.0, 0.001], 15.0, [0.0])
    assert reply.status is QPStatus.SOLVED
    planned = mpc._mpc.plan[0, 1]
    held_step = mpc.step([0.3, 0.05, 0.1, 3.0], 15.0, [0.0])
    assert (held_step.status, held_step.held) == (QPStatus.CAPPED, True)
    assert held_step.iterations <= 4
    assert held_step.move == pytest.approx(np.clip(planned, -0.02, 0.02), abs=1e-15)
    assert capped_mpc(None).step([0.3, 0.05, 0.1, 3.0], 15.0, [0.0]).status is QPStatus.SOLVED


@compiled
def test_problems_of_closed_loops_stay_far_below_the_limit_on_changes():
    solver = ActiveSet()
    share = [solver.solve(p.qp).iterations / (CHANGES * (p.qp.n + p.qp.m)) for p in chunk(0)]
    assert 0.0 < max(share) < 0.5


# -- memory -----------------------------------------------------------------------------------------------------------
CONTROLLERS = {
    "published": lambda: at.published_mpc(CAR, at.Tuning(35, 8, 1.0, 3000.0), period=0.05),
    "informed": lambda: at.MPC(CAR, profile="road"),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
}


@pytest.mark.slow
@pytest.mark.parametrize("make", CONTROLLERS.values(), ids=CONTROLLERS)
@compiled
def test_a_tracker_keeps_nothing_of_its_calls(make):
    tracker = at.Tracker(make(), at.Road.from_segments([Line(length=1000.0)]))

    def calls(first, count):
        for k in range(first, first + count):
            tracker.step(0.05 * k, 0.25 * k, 0.1 * (k % 3), 0.0, 5.0, 0.0)
        gc.collect()

    calls(0, 100)
    tracemalloc.start()
    try:
        calls(100, 3000)
        memory = tracemalloc.get_traced_memory()[0]
    finally:
        tracemalloc.stop()
    assert memory < 60_000  # bytes, of NumPy's caches; one float (24) of each call would be 72,000
