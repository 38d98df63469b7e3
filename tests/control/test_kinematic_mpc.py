"""The kinematic MPC: its quadratic programme, its steady turn, its filter, its dead time."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.signal import butter, lfilter

import adaptrack as at
from adaptrack.control.controllers.kinematic_mpc import AUTOWARE_WEIGHTS
from adaptrack.core.controllers import kinematic_mpc as kernel
from adaptrack.core.controllers.contract import planned_speed
from adaptrack.road import Arc, Clothoid, Line
from adaptrack.road.road_ahead import straight
from references.daqp import Daqp
from references.dense_mpc import kinematic_model, kinematic_problem
from references.kinematic_mpc import cost, derivatives

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("midsize-sedan")
LAGGING = at.Steering(lag=0.2, dead_time=0.12)
WIDE = at.Limits(move=(-1.0, 1.0), angle=(-1.0, 1.0))
TIGHT = at.Limits(move=(-0.01, 0.008), angle=(-0.05, 0.06))
ODD = {name: 0.3 + 0.2 * i for i, name in enumerate(AUTOWARE_WEIGHTS)} | {
    "steering_acceleration": 1e-4,
    "steering_rate": 0.02,
}
BENDING = at.Road.from_segments(
    [
        Line(length=20.0),
        Clothoid(length=30.0, start_curvature=0.0, end_curvature=0.02),
        Arc(length=200.0, curvature=0.02),
    ],
    name="bend",
)


def make_controller(**options) -> at.KinematicMPC:
    return at.KinematicMPC(CAR, **{"period": 0.05, "belief": LAGGING, "limits": WIDE, "cutoff": 0.0, **options})


# -- the quadratic programme -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("weights", [{}, ODD], ids=["as shipped", "all different"])
def test_the_dense_problem_is_the_cost_of_a_simulation(weights, rng):
    controller = make_controller(stages=5, step=0.1, **weights)
    state, last = np.array([0.4, -0.03, 0.05]), (0.02, -0.01)
    road = rng.uniform(5.0, 15.0, 5), rng.uniform(-0.03, 0.03, 5)
    problem = kinematic_problem(controller, state, *road, last)
    E, K = derivatives(
        lambda u: cost(u, state, road, (0.1, 0.05), (CAR.wheelbase, 0.2), {**AUTOWARE_WEIGHTS, **weights}, last), 5
    )
    np.testing.assert_allclose(problem.E, E, atol=1e-7 * np.abs(E).max())
    np.testing.assert_allclose(problem.K, K, atol=1e-7 * np.abs(E).max())


def test_the_limits_of_the_dense_problem_are_those_of_angle_and_rate(rng):
    controller = make_controller(stages=5, step=0.1, limits=TIGHT)
    problem = kinematic_problem(controller, [0.0, 0.0, 0.0], np.full(5, 10.0), np.zeros(5), (0.01, 0.0))
    for _ in range(200):
        u = rng.uniform(-0.08, 0.08, 5) * rng.choice([0.2, 1.0])
        changes = np.diff(np.concatenate([[0.01], u]))
        most = np.array([1.0, 2.0, 2.0, 2.0, 2.0])  # control periods in a change
        is_within = np.all((u >= -0.05) & (u <= 0.06) & (changes >= -0.01 * most) & (changes <= 0.008 * most))
        assert is_within == np.all(problem.M @ u <= problem.gamma)


def roll_through_dead_time(controller: at.KinematicMPC, pose, commands: list[float], road) -> np.ndarray:
    """The state at the end of the dead time; commands: all given so far; road: of speed and curvature, by time (s)."""
    period, late, lag = controller.period, controller.belief.delay, controller.belief.lag.value
    start = -controller.pose_age
    begins = period * (np.arange(len(commands)) - len(commands)) + late  # when each command begins to act
    delta = commands[0]
    for begin, end, u in zip(begins, [*begins[1:], late], commands, strict=True):
        delta = u + (delta - u) * math.exp(-max(min(end, start) - begin, 0.0) / lag) if begin < start else delta
    state = np.array([*pose, delta])
    for begin, end, u in zip(begins, [*begins[1:], late], commands, strict=True):
        if end > start + 1e-12:
            begin = max(begin, start)
            A, B, w, _ = kinematic_model(CAR.wheelbase, lag, *road(begin, end), end - begin, controller.limits.angle)
            state = A @ state + B * u + w
    return state


@pytest.mark.parametrize("limits", [WIDE, TIGHT], ids=["wide", "tight"])
@pytest.mark.parametrize("profile", [None, "production"], ids=["prompt pose", "late pose"])
def test_the_law_applies_the_first_input_of_the_dense_problem(limits, profile, rng):
    controller = make_controller(profile=profile, limits=limits, stages=30, preview=True, **ODD)
    commands, speed, n = [0.0] * 8, 12.0, controller.stages
    for _ in range(25):
        yaw, y = rng.normal(0.0, (0.03, 0.2))
        start = y - CAR.lr * math.sin(yaw), yaw
        state = roll_through_dead_time(controller, start, commands, lambda begin, end: (speed, 0.0))
        problem = kinematic_problem(controller, state, np.full(n, speed), np.zeros(n), (commands[-1], commands[-2]))
        expected = Daqp().solve(problem)
        answer = controller.step([0.0, yaw, 0.0, y], speed, np.zeros(100))
        assert answer.diagnostics["qp_status"] == 0
        assert answer.angle == pytest.approx(expected.x[0], abs=1e-6)
        commands.append(answer.angle)
    assert (limits is WIDE) == (max(np.abs(np.diff(commands))) > 0.0101)


def test_on_a_bend_every_stage_has_its_own_curvature_and_planned_speed():
    controller = make_controller(stages=30, step=0.1, preview=True, profile=None)
    speeds = np.linspace(9.0, 14.0, 200)
    pose, station, speed = (0.02, 0.3), 12.0, 10.0
    at_time = lambda t: max(speeds[min(max(int(t / 0.05 + 1e-9), 0), 199)] - speeds[0] + speed, 1.0)  # noqa: E731
    curvature = lambda s: float(BENDING.at(station + s).curvature)  # noqa: E731
    place = [-CAR.lr]  # of the rear axle, at the beginning of each piece

    def along(begin, end):
        v = at_time(begin)
        result = v, curvature(place[0] + 0.5 * v * (end - begin))
        place[0] += v * (end - begin)
        return result

    theta = pose[0] + CAR.lr * curvature(-0.5 * CAR.lr)
    state = roll_through_dead_time(controller, (pose[1] - CAR.lr * math.sin(theta), theta), [0.0] * 6, along)
    stages = [at_time(controller.belief.delay + 0.1 * i) for i in range(30)]
    places = place[0] + 0.1 * np.concatenate([[0.0], np.cumsum(stages)[:-1]])
    problem = kinematic_problem(controller, state, np.array(stages), np.array([curvature(s) for s in places]))
    expected = np.linalg.solve(problem.E, -problem.K)
    ahead = at.RoadAhead(BENDING, station, speeds)
    answer = controller.step([0.0, pose[0], 0.0, pose[1]], speed, np.zeros(100), road=ahead)
    assert np.all(problem.M @ expected < problem.gamma)
    assert answer.angle == pytest.approx(expected[0], abs=1e-8)


def test_the_speeds_of_a_plan_are_shifted_to_the_present_one_and_its_last_one_holds():
    find, road = planned_speed, at.RoadAhead(BENDING, 0.0, np.array([10.0, 12.0, 8.0])).packed
    assert [find(road, t, 11.0, 0.1) for t in (-0.2, 0.0, 0.15, 0.2, 5.0)] == [11.0, 11.0, 13.0, 9.0, 9.0]
    assert find(road, 0.2, 2.0, 0.1) == 1.0  # no slower than walking
    assert find(straight(), 5.0, 7.0, 0.1) == 7.0


# -- truths ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("lag", [0.0, 0.2])
@pytest.mark.parametrize("radius", [20.0, -50.0])
def test_in_the_kinematic_turn_it_keeps_the_ackermann_angle(radius, lag):
    """The centre of mass on the circle, the car turned against its tangent by l_r/R: nothing is left to correct."""
    ring = at.Road.from_segments(
        [Arc(length=abs(radius) * 2.0 * math.pi, curvature=1.0 / radius)], name="ring", closed=True
    )
    controller = make_controller(belief=at.Steering(lag=lag, dead_time=0.12), preview=True, limits=None, cutoff=3.0)
    angle = math.atan(CAR.wheelbase / radius)
    controller.applied(angle)
    for _ in range(5):
        answer = controller.step(
            [0.0, -CAR.lr / radius, 0.0, 0.0], 6.0, np.zeros(1), road=at.RoadAhead(ring, 40.0, [6.0])
        )
        assert answer.angle == pytest.approx(angle, abs=1e-9)


@pytest.mark.compiled
def test_told_of_the_dead_time_it_damps_a_car_that_it_cannot_hold_without():
    """On its own model, lag 0.3 s behind 0.5 s of dead time, with strong weights: settled or swinging."""

    def last_errors(dead_time: float) -> float:
        controller = make_controller(
            belief=at.Steering(lag=0.3, dead_time=dead_time), profile="paper", steering=0.05, steering_v2=0.005,
            lateral_jerk=0.0,
        )  # fmt: skip
        state, commands, errors = np.array([0.5, 0.0, 0.0]), [0.0] * 10, []
        for _ in range(200):
            y = state[0] + CAR.lr * math.sin(state[1])
            commands.append(controller.step([0.0, state[1], 0.0, y], 15.0, np.zeros(1)).angle)
            A, B, w, _ = kinematic_model(CAR.wheelbase, 0.3, 15.0, 0.0, 0.05, (-1.0, 1.0))
            state = A @ state + B * commands[-11] + w
            errors.append(abs(state[0]))
        return max(errors[-40:])

    assert last_errors(0.5) < 1e-3
    assert last_errors(0.0) > 0.3


@pytest.mark.parametrize("share", [0.01, 0.15, 0.4])
def test_the_filter_is_the_butterworth_filter_of_second_order(share, rng):
    command = rng.normal(size=60)
    expected = lfilter(*butter(2, 2.0 * share), command)
    run, state = kernel.filtered, [0.0, 0.0]
    padded = [0.0, 0.0, *command.tolist()]
    for k in range(2, len(padded)):
        state.append(run(padded[k], padded[k - 1], padded[k - 2], state[-1], state[-2], share))
    np.testing.assert_allclose(state[2:], expected, atol=1e-10)
    assert run(3.0, 1.0, 2.0, 4.0, 5.0, 0.0) == run(3.0, 1.0, 2.0, 4.0, 5.0, 0.5) == 3.0


def test_it_goes_on_from_an_angle_that_somebody_else_asked_for():
    """As one that began with it: neither the filter nor the limits remember what was not applied."""
    limits = at.Limits(move=(-0.02, 0.02), angle=(-0.5, 0.5))
    late, early = (
        make_controller(limits=limits, cutoff=3.0, belief=at.Steering(lag=0.0), profile="paper") for _ in range(2)
    )
    late.step([0.0, 0.0, 0.0, 0.1], 10.0, np.zeros(1))
    for controller in (late, early):
        controller.applied(0.3)
    answers = [controller.step([0.0, 0.0, 0.0, 0.1], 10.0, np.zeros(1)).angle for controller in (late, early)]
    assert answers[0] == answers[1] < 0.3


def test_a_gap_of_the_pose_holds_the_command_and_keeps_the_wheel_angle_going():
    """After the gap it answers as a controller that held the same commands and saw the same pose."""
    sighted, blind = make_controller(), make_controller()
    for controller in (sighted, blind):
        controller.step([0.0, 0.01, 0.0, 0.2], 10.0, np.zeros(1))
    angle = blind.angle
    for _ in range(5):
        assert blind.step([0.0, math.nan, 0.0, math.nan], 10.0, np.zeros(1)).held
        sighted.step([0.0, 0.0, 0.0, 0.0], 10.0, np.zeros(1))
        sighted.applied(angle)
    pose = [0.0, 0.01, 0.0, 0.1]
    assert blind.step(pose, 10.0, np.zeros(1)).angle == pytest.approx(
        sighted.step(pose, 10.0, np.zeros(1)).angle, abs=1e-9
    )
