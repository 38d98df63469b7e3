"""Nonlinear MPC: its limit is the linear one, its contract, and that it drives. Needs CasADi."""

import math
import sys
from importlib.util import find_spec

import numpy as np
import pytest

import adaptrack as at
from adaptrack.road import Arc, Line

CAR = at.load_vehicle("paper")
HAIRPIN = at.Road.from_segments(
    [Line(length=15.0), Arc(length=15.0 * math.pi, curvature=1 / 15), Line(length=15.0)], name="hairpin"
)
needs_casadi = pytest.mark.skipif(not find_spec("casadi"), reason="needs CasADi: pip install casadi")
pytestmark = pytest.mark.slow


def make_controller(name="nmpc", car=CAR, **options):
    return at.get_controller(name, car, **options)


def test_without_casadi_the_message_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(at.MissingExtra, match="pip install casadi"):
        make_controller()


@needs_casadi
@pytest.mark.parametrize("lag", [0.0, 0.15])
def test_for_small_errors_its_first_move_is_that_of_the_linear_mpc(lag):
    """min sum y^2 + R sum move^2 of the path model, as a least-squares problem; at a large error the two part."""
    car, period, n, R, speed = CAR.matched_to(at.load_tyre(CAR.tyre)), 0.05, 20, 30.0, 15.0
    A, B, C = at.PathModel(car, period, lag).discrete(speed)
    phi, free, power = np.zeros((n, n)), np.zeros((n, A.shape[0])), np.eye(A.shape[0])
    step, height = [], 0.0
    for i in range(n):
        height += (C @ power @ B).item()
        step.append(height)
        power = A @ power
        free[i] = (C @ power)[0]
    for i in range(n):
        phi[i, : i + 1] = step[i::-1]

    def moves(x):
        return np.linalg.solve(phi.T @ phi + R * np.eye(n), -phi.T @ free @ x)

    gaps = []
    for scale in (1e-4, 1.0):
        controller = make_controller(
            "nmpc-as-measured", car, profile="paper", belief=at.Steering(lag=lag, dead_time=0.0), period=period,
            horizon=n * period, R=R, iterations=20, preview=True, limits=at.Limits(move=(-1.0, 1.0), angle=(-1.5, 1.5)),
        )  # fmt: skip
        vy, yaw, rate, y = scale * np.array([0.3, 0.1, 0.2, 0.8])
        state = np.array([vy, yaw, rate, *([0.0] if lag else []), y])
        answer = controller.step([vy, yaw, rate, y], speed, np.zeros(40))
        gaps.append(abs(answer.angle / moves(state)[0] - 1.0))
    assert gaps[0] < 2e-4
    assert gaps[1] > 0.01


@needs_casadi
def test_the_solution_meets_its_limits_and_converges():
    controller = make_controller("nmpc-as-measured", profile="road", iterations=30)
    step = controller.step([0.0, 0.0, 0.0, -2.0], 15.0, np.zeros(80))
    assert step.angle == pytest.approx(controller.limits.move[1], abs=1e-9)
    assert step.diagnostics["change"] < 1e-7
    assert step.diagnostics["iterations"] < 30


@needs_casadi
def test_commands_on_their_way_are_driven_through_by_the_model():
    """Three periods late is where a car without dead time is three periods on."""
    options = {"profile": "paper", "preview": True, "period": 0.05, "iterations": 20}
    steering = [at.Steering(lag=0.1, dead_time=time) for time in (0.15, 0.0)]
    late, prompt = (make_controller("nmpc-as-measured", belief=belief, **options) for belief in steering)
    x = np.array([0.05, 0.03, 0.02, 0.4, 0.0])  # v_y, r, psi, e, delta
    after = x
    for _ in range(3):
        after = prompt._drive(after, 0.0, np.array([15.0, 0.0, 0.0, 0.0]), 0.05)
    angle = late.step([x[0], x[2], x[1], x[3]], 15.0, np.zeros(80)).angle
    then = prompt.step([after[0], after[2], after[1], after[3]], 15.0, np.zeros(80)).angle
    assert angle == pytest.approx(then, rel=1e-5)
    assert angle != 0.0


@needs_casadi
@pytest.mark.parametrize("name", ["nmpc", "nmpc-as-measured"])
def test_it_follows_a_hairpin_on_the_ideal_car(name):
    controller = make_controller(name, profile="paper", period=0.05, preview=True)
    run = at.simulate(at.DualTrack(CAR), controller, at.RoadDrive(HAIRPIN, 6.0), profile="paper")
    assert run.failed is None
    assert np.abs(run.error).max() < 0.1


@needs_casadi
def test_its_estimator_takes_out_a_push_that_stays():
    """Side wind: what the measurements do not say ends as an offset without an estimator."""
    blown = at.load_scenario("lane-change", amplitude=0.0, speed=15.0, friction=1.0, gust=12.0, duration=6.0)
    offsets = []
    for name in ("nmpc", "nmpc-as-measured"):
        run = at.simulate(at.SingleTrack(CAR), make_controller(name, profile="paper", period=0.05, preview=True), blown)
        assert run.failed is None
        offsets.append(abs(float(run.error[-20:].mean())))
    assert offsets[0] < 0.003
    assert offsets[1] > 3.0 * offsets[0]


@needs_casadi
@pytest.mark.parametrize(("name", "profile"), [("nmpc", "road"), ("nmpc-as-measured", "paper")])
def test_it_keeps_the_contract_of_controllers(name, profile):
    at.check_controller(make_controller(name, profile=profile, horizon=0.5))


@needs_casadi
@pytest.mark.parametrize(("option", "value"), [("horizon", 0.0), ("R", 0.0), ("iterations", 0), ("friction", -1.0)])
def test_nonsense_is_refused_by_name(option, value):
    with pytest.raises(at.InvalidInput, match=option):
        make_controller(**{option: value})
