"""Starts of a controller that learns: bounded moves, and the speed below which a drive should begin."""

import logging
import math

import pytest

from adaptrack import MPC, Learning, Tracker, load_vehicle
from adaptrack.core.controllers.part import COMMON_ANSWER
from adaptrack.core.estimators.learning import BELIEF_COLUMNS
from adaptrack.core.synthesis.belief import LEAST_STEERING_RATE
from adaptrack.core.synthesis.learner import MAX_BIAS_PULL
from adaptrack.road import Line, Road
from tracker_calls import called_back

STRAIGHT = Road.from_segments([Line(length=300.0)])


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


def drive(tracker: Tracker, speed: float, calls: int = 3) -> list[float]:
    """Top speeds (m/s) that a tracker gives a car on a straight."""
    return [tracker.step(0.05 * k, 0.05 * k * speed, 0.0, 0.0, speed, 0.0).first_top_speed for k in range(calls)]


@pytest.mark.parametrize(("beyond", "warnings"), [(-1.0, 0), (1.0, 1)])
def test_a_tracker_gives_the_first_top_speed_and_warns_once_above_it(
    beyond: float, warnings: int, caplog: pytest.LogCaptureFixture
) -> None:
    mpc = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    assert mpc.learner is not None
    top = mpc.learner.first_top_speed
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        assert drive(Tracker(mpc, STRAIGHT), top + beyond) == [top] * 3
    assert sum("before the controller has learned it" in record.message for record in caplog.records) == warnings


class StatedTracker(Tracker):
    """A tracker whose learner states the standard deviation of its delay."""

    delay_sigma = 0.1
    """s"""

    def _control(self, *words) -> None:
        super()._control()
        self._python.answer[0, len(COMMON_ANSWER) + BELIEF_COLUMNS.belief_delay_sigma] = self.delay_sigma


def test_the_first_top_speed_ends_when_the_delay_is_learned_and_does_not_come_back() -> None:
    learning = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    tracker = StatedTracker(called_back(learning), STRAIGHT)
    assert max(drive(tracker, 30.0)) < math.inf
    tracker.delay_sigma = 0.01
    tracker.engage()
    assert drive(tracker, 30.0) == [math.inf] * 3
    tracker.delay_sigma = 0.1
    tracker.engage()
    assert drive(tracker, 30.0) == [math.inf] * 3


def test_without_learning_there_is_no_first_top_speed() -> None:
    assert drive(Tracker(MPC(load_vehicle("midsize-sedan"), learning=None), STRAIGHT), 30.0) == [math.inf] * 3
