"""Starts of a controller that learns: bounded moves, and the speed below which a drive should begin."""

import math

import pytest

from adaptrack import MPC, Learning, load_vehicle
from adaptrack.control.controllers.learned_car import MAX_BIAS_PULL
from adaptrack.core.synthesis.belief import LEAST_STEERING_RATE


def test_at_the_first_top_speed_the_largest_bias_pulls_the_steady_car_by_the_limit() -> None:
    mpc = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    assert mpc.learner is not None
    car, speed = mpc.learner.car, mpc.learner.first_top_speed
    front, rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    length = car.lf + car.lr
    # moment balance of a steady turn: each axle carries its share of m v r
    understeer = car.mass / length * (car.lr / front - car.lf / rear)
    assert 0.035 * speed**2 / (length + understeer * speed**2) == pytest.approx(MAX_BIAS_PULL, rel=1e-9)
    assert f"drive below {speed:.3g} m/s first" in mpc.learns


def test_a_narrower_bias_lets_a_drive_begin_faster() -> None:
    car = load_vehicle("midsize-sedan")
    learners = [MPC(car, belief="unknown", learning=Learning(bias=bias)).learner for bias in (0.035, 0.02, 0.01)]
    speeds = [learner.first_top_speed for learner in learners if learner is not None]
    assert len(speeds) == 3
    assert speeds[0] < speeds[1] < speeds[2]


def test_a_car_that_understeers_enough_may_begin_at_any_speed() -> None:
    mpc = MPC(load_vehicle("paper"), belief="unknown", learning=Learning())
    assert mpc.learner is not None
    assert mpc.learner.first_top_speed == math.inf
    assert "drive below" not in mpc.learns


def test_commands_of_a_learner_turn_no_faster_than_the_slowest_published_steering() -> None:
    learning = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    assert learning.limits.move[1] == pytest.approx(LEAST_STEERING_RATE * learning.period)
    fixed = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=None)
    assert fixed.limits.move[1] == pytest.approx(math.pi / 12)
