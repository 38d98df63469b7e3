"""The moves that a curved road asks for, from which the MPC's free moves are counted."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.controllers.feed_forward import FeedForward, bend_size, road_moves
from adaptrack.core.layout import allocate
from adaptrack.road import Arc, Clothoid, Line

pytestmark = pytest.mark.kernels

CAR, SEDAN = at.load_vehicle("paper"), at.load_vehicle("midsize-sedan")
PERIOD = 0.05
STRAIGHT = at.Road.from_segments([Line(length=500.0)], name="straight")


def winding(count):
    """y (m) in the frame of its tangent of a road that asks for 2 m/s^2 to either side every 6 s."""
    accelerations = 2.0 * np.sin(2.0 * math.pi * PERIOD * np.arange(count) / 6.0)
    y = np.zeros(count)
    for i in range(1, count - 1):
        y[i + 1] = 2.0 * y[i] - y[i - 1] + PERIOD**2 * accelerations[i]
    return y


def turning_of(model, tyres=(0.0, 0.0)):
    return np.array([*model.turning(), *tyres])


def moves_of(model, speed, bend, count, most=1.0, tyres=(0.0, 0.0)):
    settings = at.MPC(model.vehicle, period=model.period).settings()._replace(move_min=-most, move_max=most)
    turning = turning_of(model, tyres)
    feed = allocate(FeedForward, {"turning": turning.size, "road_moves": count + 1})
    feed.turning[:] = turning
    road_moves(count, speed, settings, bend, feed)
    return np.array([feed.expected[:count], feed.moves[:count]]) if tyres[0] else feed.expected[:count]


@pytest.mark.parametrize("car", [CAR, SEDAN], ids=lambda car: car.name)
@pytest.mark.parametrize("speed", [5.0, 12.0, 25.0])
@pytest.mark.parametrize("lag", [0.0, 0.2])
def test_a_car_that_obeys_the_model_and_is_steered_by_them_alone_follows_the_road(car, speed, lag):
    """In lateral acceleration, to first order in its rate: after the beginning, within 5 % of the largest."""
    model, count = at.PathModel(car, PERIOD, lag), 160
    bend = winding(bend_size(count, PERIOD, len(turning_of(model)), lag))
    a, b, c = model.discrete(speed)
    x, command, y = np.zeros(model.n), 0.0, [0.0]
    for move in moves_of(model, speed, bend, count):
        command += move
        x = a @ x + b[:, 0] * command
        y.append((c @ x).item())
    expected, accelerations = np.diff(bend[: count + 1], 2) / PERIOD**2, np.diff(y, 2) / PERIOD**2
    shift = accelerations[40:].mean() - expected[40:].mean()  # the angle before the first move
    np.testing.assert_allclose(accelerations[40:] - shift, expected[40:], atol=0.1)


def test_a_clothoid_asks_for_the_steady_angle_of_its_growing_curvature():
    """dkappa/ds = 1e-4 1/m^2: the angle (L + K v^2) kappa grows by (L + K v^2) 1e-4 v T a period."""
    road = at.Road.from_segments([Clothoid(length=400.0, start_curvature=0.0, end_curvature=0.04)], name="clothoid")
    speed, model = 10.0, at.PathModel(CAR, PERIOD, 0.1)
    bend = at.RoadAhead(road, 100.0, [speed]).bend(60, speed, 0.0, PERIOD)
    wheelbase, understeer = model.turning()[:2]
    growth = (wheelbase + understeer * speed**2) * 1e-4 * speed * PERIOD
    np.testing.assert_allclose(moves_of(model, speed, bend, 20).mean(), growth, rtol=0.02)


def test_the_steady_angle_is_that_of_the_model():
    """y'' of the model in a steady turn at one radian is v^2/(L + K v^2)."""
    for speed in (3.0, 15.0, 30.0):
        model = at.PathModel(SEDAN, 0.01)
        a, b, c = model.discrete(speed)
        x, y = np.zeros(model.n), []
        for _ in range(1000):
            x = a @ x + b[:, 0]
            y.append((c @ x).item())
        wheelbase, understeer = model.turning()[:2]
        steady = np.diff(y[-3:], 2).item() / 0.01**2
        assert steady == pytest.approx(speed**2 / (wheelbase + understeer * speed**2), rel=1e-6)


def test_tyres_that_slide_ask_for_more_angle():
    """The Magic Formula with E = 0 in a steady turn at f = a/(mu g): K a C tan(asin(f)/C)/f instead of K a."""
    road = at.Road.from_segments([Line(length=20.0), Arc(length=200.0, curvature=0.02)], name="bend")
    speed, friction, shape, model = 17.0, 0.9, 1.3, at.PathModel(CAR, PERIOD)
    bend = at.RoadAhead(road, 10.0, [speed]).bend(70, speed, 0.0, PERIOD)
    linear, sliding = moves_of(model, speed, bend, 55, tyres=(friction, shape)).sum(axis=1)
    share = 0.02 * speed**2 / (friction * 9.80665)
    extra = model.turning()[1] * 0.02 * speed**2 * (shape * math.tan(math.asin(share) / shape) / share - 1.0)
    assert sliding - linear == pytest.approx(extra, rel=1e-3)
    assert extra > 0.01


def test_none_is_faster_than_the_steering_may_move_and_fast_turns_begin_early():
    """A step of the wheels in the middle becomes a ramp about it, with the same sum."""
    t = PERIOD * np.arange(80)
    bend = np.where(t > 1.5, 0.5 * 3.0 * (t - 1.5) ** 2, 0.0)  # from straight to 3 m/s^2
    model = at.PathModel(CAR, PERIOD)
    free, slow = (moves_of(model, 10.0, bend, 60, most=limit) for limit in (1.0, 0.005))
    assert np.abs(slow).max() <= 0.005 + 1e-12
    assert slow.sum() == pytest.approx(free.sum(), rel=1e-9)
    assert (np.arange(60) @ slow) / slow.sum() == pytest.approx((np.arange(60) @ free) / free.sum(), abs=0.5)
    assert np.flatnonzero(slow)[0] < np.flatnonzero(free)[0]


def test_a_straight_road_gives_the_problem_of_none():
    state, reference = [0.1, 0.01, 0.02, 0.3, 0.01], np.linspace(0.0, 1.0, 40)
    plain = at.MPC(CAR, profile="road").problem(state, 15.0, reference)
    there = at.MPC(CAR, profile="road").problem(state, 15.0, reference, road=at.RoadAhead(STRAIGHT, 100.0, [15.0]))
    for name in ("E", "K", "M", "gamma"):
        assert (getattr(plain, name) == getattr(there, name)).all(), name


def test_limits_hold_for_the_whole_move_of_a_bend():
    """The free moves get what the road's leave of the limits."""
    mpc = at.MPC(CAR, profile="road")
    ahead = at.RoadAhead(
        at.Road.from_segments([Line(length=5.0), Arc(length=60.0, curvature=0.08)], name="bend"), 0.0, [8.0]
    )
    state = [0.0, 0.0, 0.0, 0.0, 0.0]
    problem = mpc.problem(state, 8.0, [0.0], road=ahead)
    mpc.step(state, 8.0, [0.0], road=ahead)
    feed = mpc._mpc.feed.moves
    most = mpc.limits.move[1]
    assert abs(feed[:30]).max() > 0.0
    np.testing.assert_allclose(problem.gamma[4::4], most - feed[1 : problem.gamma.size // 4], atol=1e-12)
    np.testing.assert_allclose(problem.gamma[5::4], most + feed[1 : problem.gamma.size // 4], atol=1e-12)
    room = mpc.limits.angle[1] - np.cumsum(feed[: problem.gamma.size // 4])
    np.testing.assert_allclose(problem.gamma[2::4], room, atol=1e-12)


@pytest.mark.compiled
def test_a_long_horizon_with_few_free_moves_does_not_cut_bends(monkeypatch):
    road = at.Road.from_segments(
        [
            Line(length=60.0), Clothoid(length=20.0, start_curvature=0.0, end_curvature=0.04),
            Arc(length=40.0, curvature=0.04), Clothoid(length=20.0, start_curvature=0.04, end_curvature=0.0),
            Line(length=60.0),
        ], name="bend",
    )  # fmt: skip

    def largest_error():
        mpc = at.MPC(CAR, profile="paper", period=PERIOD, tuning=at.Tuning(60, 3, 1.0, 1.0), preview=True)
        return np.abs(at.rollout(at.SingleTrack(CAR, "constant-stiffness"), mpc, at.RoadDrive(road, 9.0)).error).max()

    knowing = largest_error()
    monkeypatch.setattr(at.PathModel, "turning", lambda self: np.zeros(0))
    assert knowing < 0.15 * largest_error()
