"""Optimal preview control: its gains, its steady turn, its dead time, and what preview is worth."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import solve_discrete_are

import adaptrack as at
from adaptrack.control.controllers.laws import GAIN_SPEEDS
from adaptrack.control.controllers.preview_lqr import steady_turn
from adaptrack.road import Arc, Clothoid, Line
from adaptrack.road.road_ahead import straight
from references.dense_mpc import preview_gains_at

pytestmark = pytest.mark.kernels

SEDAN, PAPER = at.load_vehicle("midsize-sedan"), at.load_vehicle("paper")
WIDE = at.Limits(move=(-1.5, 1.5), angle=(-1.5, 1.5))
every_car = pytest.mark.parametrize("car", [PAPER, SEDAN], ids=lambda car: car.name)
every_lag = pytest.mark.parametrize("lag", [0.0, 0.2])


def make_controller(car=SEDAN, lag: float = 0.2, dead_time: float = 0.0, **options) -> at.PreviewLQR:
    belief = at.Steering(lag=lag, dead_time=dead_time)
    return at.PreviewLQR(car, **{"profile": "paper", "period": 0.05, "belief": belief, "limits": WIDE, **options})


def model_of(car, lag: float, speed: float):
    """A, B and E of the path model."""
    model = at.PathModel(car, 0.05, lag)
    n = model.n
    A, B, E = np.zeros((n, n)), np.zeros(n), np.zeros(n)
    model.function(speed, model.period, model.parameters(), A, B, E)
    return A, B, E


# -- the gains ---------------------------------------------------------------------------------------------------------
@every_car
@every_lag
@pytest.mark.parametrize("speed", [2.0, 8.0, 30.0])
def test_the_gains_are_those_of_the_riccati_equation_with_the_preview_as_states(car, lag, speed):
    controller = make_controller(car, lag, ahead=0.5, q_e=2.0, q_heading=30.0, r=200.0)
    A, B, _ = model_of(car, lag, speed)
    n, count = len(A), controller.previewed
    X, _ = steady_turn(car, speed, n)
    F = np.zeros((n + count, n + count))  # the changes of w shift towards the first, which acts now
    F[:n, :n], F[:n, n], F[n:-1, n + 1 :] = A, -X, np.eye(count - 1)
    G = np.concatenate([B, np.zeros(count)])[:, None]
    Q = np.zeros_like(F)
    Q[1, 1], Q[n - 1, n - 1] = 30.0, 2.0
    P = solve_discrete_are(F, G, Q, np.array([[200.0]]))
    expected = -np.linalg.solve(200.0 + G.T @ P @ G, G.T @ P @ F)[0]
    np.testing.assert_allclose(
        preview_gains_at(controller, speed), expected, rtol=1e-7, atol=1e-9 * np.abs(expected).max()
    )


@every_car
@every_lag
@pytest.mark.parametrize("speed", [2.0, 8.0, 30.0])
def test_the_steady_turn_is_a_fixed_point_of_the_path_model(car, lag, speed):
    A, B, E = model_of(car, lag, speed)
    X, U = steady_turn(car, speed, len(A))
    np.testing.assert_allclose(A @ X + B * U + E, X, atol=1e-12)


def applied_gain(controller: at.PreviewLQR, speed: float) -> np.ndarray:
    """The gain on v_y, psi, r and y that the compiled law applies on a straight path."""
    small, answer, gain = 1e-6, np.zeros(1 + len(controller.diagnostic_names)), []
    for state in np.eye(4):
        controller.function(
            np.array([*(small * state), speed, 0.0]), np.zeros(1), straight(), controller.packed_tuning(),
            controller.parameters(), np.zeros(controller.memory_size), answer,
        )  # fmt: skip
        gain.append(answer[0] / small)
    return np.array(gain)


@pytest.mark.parametrize(
    ("speeds", "tolerance"), [(GAIN_SPEEDS[[3, 12, 19]], 1e-7), (np.sqrt(GAIN_SPEEDS[3:5].prod()), 0.02)]
)
def test_the_law_applies_the_gains_at_the_nodes_of_its_table_and_nearly_so_between(speeds, tolerance):
    controller = make_controller()
    for speed in np.atleast_1d(speeds):
        expected = preview_gains_at(controller, speed)[[0, 1, 2, 4]]
        np.testing.assert_allclose(applied_gain(controller, speed), expected, rtol=tolerance)


@pytest.mark.parametrize("factor", [0.03, 0.5, 30.0])
def test_weights_that_change_change_the_gains_as_weights_given_at_the_start(factor):
    controller, expected = make_controller(), make_controller(q_e=factor)
    controller.own_part.tuning[0, 0] = factor
    answers = [law.step([0.0, 0.0, 0.0, 0.01], 12.0, np.zeros(1)).angle for law in (controller, expected)]
    assert answers[0] == pytest.approx(answers[1], rel=0.06)


@every_lag
def test_rolling_through_the_dead_time_is_the_optimum_with_the_commands_on_their_way_as_states(lag, rng):
    speed, late = GAIN_SPEEDS[12], 3
    controller = make_controller(lag=lag, dead_time=late * 0.05)
    A, B, _ = model_of(SEDAN, lag, speed)
    n = len(A)
    F = np.zeros((n + late, n + late))  # behind the state the commands, the one that acts next first
    F[:n, :n], F[:n, n], F[n:-1, n + 1 :] = A, B, np.eye(late - 1)
    G = np.eye(n + late)[:, -1:]
    Q = np.zeros_like(F)
    Q[1, 1], Q[n - 1, n - 1] = 100.0, 1.0
    P = solve_discrete_are(F, G, Q, np.array([[100.0]]))
    K = np.linalg.solve(100.0 + G.T @ P @ G, G.T @ P @ F)[0]
    wheels, waiting = 0.0, [0.0] * late
    for _ in range(10):
        vy, yaw, rate, y = rng.normal(0.0, (0.1, 0.02, 0.05, 0.1))
        state = [vy, yaw, rate, wheels, y] if lag else [vy, yaw, rate, y]
        expected = -K @ np.array([*state, *waiting])
        answer = controller.step([vy, yaw, rate, y], speed, np.zeros(1))
        assert answer.angle == pytest.approx(expected, abs=1e-8)
        wheels = waiting[0] + (wheels - waiting[0]) * math.exp(-0.05 / lag) if lag else waiting[0]
        waiting = [*waiting[1:], answer.angle]


# -- bends -------------------------------------------------------------------------------------------------------------
@every_car
@every_lag
@pytest.mark.parametrize("speed", [4.0, 15.0])
def test_in_the_steady_turn_of_the_linear_car_it_keeps_its_angle(car, lag, speed):
    radius = 60.0
    ring = at.Road.from_segments([Arc(length=radius * 2.0 * math.pi, curvature=1.0 / radius)], name="ring", closed=True)
    controller = make_controller(car, lag, dead_time=0.12)
    X, U = steady_turn(car, speed, 4)
    w = speed / radius
    controller.applied(U * w)
    state = X[[0, 1, 2, 3]] * w
    for _ in range(5):
        answer = controller.step(state, speed, np.zeros(1), road=at.RoadAhead(ring, 30.0, [speed]))
        assert answer.angle == pytest.approx(U * w, abs=1e-9)
        assert answer.diagnostics["feed_forward"] == pytest.approx(U * w, rel=1e-9)


WINDING = at.Road.from_segments(
    [
        Line(length=60.0),
        Clothoid(length=40.0, start_curvature=0.0, end_curvature=0.02),
        Arc(length=40.0, curvature=0.02),
        Clothoid(length=60.0, start_curvature=0.02, end_curvature=-0.015),
        Clothoid(length=40.0, start_curvature=-0.015, end_curvature=0.0),
        Line(length=40.0),
    ],
    name="winding",
)


WEIGHTS = {"q_e": 1.0, "q_heading": 100.0, "r": 100.0}


def driven_cost(controller, lag: float) -> float:
    """Cost of `WEIGHTS` for the linear car with a steering lag on clothoids, at 10 m/s."""
    speed, s = 10.0, 0.0
    A, B, E = model_of(SEDAN, lag, speed)
    n = len(A)
    X, U = steady_turn(SEDAN, speed, n)
    x, cost = np.zeros(n), 0.0
    controller.reset()
    for _ in range(560):
        answer = controller.step(x[[0, 1, 2, n - 1]], speed, np.zeros(1), road=at.RoadAhead(WINDING, s, [speed]))
        w = speed * float(WINDING.at(min(s + 0.25, WINDING.length)).curvature)
        cost += x[-1] ** 2 + 100.0 * (x[1] - X[1] * w) ** 2 + 100.0 * (answer.angle - U * w) ** 2
        x, s = A @ x + B * answer.angle + E * w, s + 0.5
    return cost


@pytest.mark.compiled
@every_lag
def test_on_clothoids_no_lqr_without_preview_has_a_lower_cost(lag):
    cost = driven_cost(make_controller(lag=lag, **WEIGHTS), lag)
    for time in (0.0, 0.1, 0.2, 0.3):
        without = at.LQR(SEDAN, **WEIGHTS, period=0.05, limits=WIDE, preview_time=time)
        assert cost < 0.99 * driven_cost(without, lag)


@pytest.mark.compiled
def test_the_further_it_sees_the_lower_its_cost_until_all_that_counts_is_seen():
    costs = [driven_cost(make_controller(ahead=ahead), 0.2) for ahead in (0.1, 0.3, 1.0, 3.0, 5.0)]
    assert costs[:4] == sorted(costs[:4], reverse=True)
    assert costs[0] > 1.2 * costs[2]
    assert costs[4] == pytest.approx(costs[3], rel=1e-3)


def test_a_pose_of_known_age_is_moved_on_with_the_present_motion():
    """On a circle, without a dead time: the pose of 0.1 s ago and the motion of now, against the pose of now."""
    speed, rate, age = 10.0, 0.1, 0.1
    late = at.PreviewLQR(SEDAN, profile=at.load_profile("production"), belief=at.Steering(lag=0.0), limits=WIDE)
    prompt = at.PreviewLQR(
        SEDAN, profile=at.load_profile("production").replace(pose_age=0.0, pose_age_spread=0.0),
        belief=at.Steering(lag=0.0), limits=WIDE,
    )  # fmt: skip
    yaw, y = 0.02, 0.1
    current = yaw + age * rate, y + age * speed * (yaw + 0.5 * age * rate)
    first = late.step([0.0, yaw, rate, y], speed, np.zeros(1)).angle
    assert first == pytest.approx(prompt.step([0.0, current[0], rate, current[1]], speed, np.zeros(1)).angle, abs=1e-12)
