"""MPPI: its model, its estimate of the optimum, its contract, and that it drives."""

from __future__ import annotations

import math

import numpy as np
import pytest

import adaptrack as at
import mppi
import mppi_kernel as kernel
from adaptrack.road import Arc, Line
from mppi import MPPI

pytestmark = pytest.mark.slow

CAR = at.load_vehicle("paper")
LANE_CHANGE = at.load_scenario("lane-change", amplitude=2.0, speed=10.0, friction=0.9, duration=3.0)
HAIRPIN = at.Road.from_segments(
    [Line(length=40.0), Arc(length=15.0 * math.pi, curvature=1 / 15), Line(length=40.0)], name="hairpin"
)
WIDE = at.Limits(move=(-1.0, 1.0), angle=(-1.5, 1.5))
SMALL = {"samples": 64, "horizon": 0.5}
step_of, moved = kernel.step_of, kernel.moved


def states_under(controller: MPPI, state: kernel.State, commands: list[float], speed: float) -> list[kernel.State]:
    """The model's states after each period under its commands (rad)."""
    p, states = kernel.Parameters(*controller.parameters()), [state]
    step = step_of(controller.period, speed, p)
    for command in commands:
        states.append(kernel.State(*moved(states[-1], command, step, p, True)))
    return states[1:]


# -- the model --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("tyre", ["magic-formula", "constant-stiffness"])
def test_the_model_is_the_single_track_on_its_tyre(tyre):
    """Against the plant's right-hand side in steps of 0.1 ms; on the linear tyre halving a step quarters the error."""
    calm = CAR.replace(side_force_slope=0.0, yaw_moment_slope=0.0)
    plant, speed, command = at.SingleTrack(calm, at.load_tyre(tyre)), 18.0, 0.06
    x, h, u, environment = (
        np.array([0.0, 0.2, 0.05, speed, 0.1, 0.05]), 1e-4, [command, 0.0, 0.0], [1.0] * 4 + [0.0] * 3,
    )  # fmt: skip
    for _ in range(5000):
        x = x + h * plant.derivative(x + 0.5 * h * plant.derivative(x, u, environment), u, environment)
    start, errors = kernel.State(0.0, 0.2, 0.05, 0.1, 0.05, command), []
    for period in (0.1, 0.05, 0.025):
        controller = MPPI(calm, tyre=tyre, profile="paper", period=period, **SMALL)
        last = states_under(controller, start, [command] * round(0.5 / period), speed)[-1]
        errors.append(np.abs(np.array(last[:5]) - x[[0, 1, 2, 4, 5]]).max())
    assert errors[1] < 1e-3
    if tyre == "constant-stiffness":
        assert 3.5 < errors[0] / errors[1] < 4.5
        assert 3.5 < errors[1] / errors[2] < 4.5


def test_the_wheels_follow_as_a_first_order_lag_within_its_rate():
    slow = MPPI(CAR, profile="paper", belief=at.Steering(lag=0.2, dead_time=0.0, rate=0.5), period=0.05, **SMALL)
    straight = kernel.State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    near = [s.wheels for s in states_under(slow, straight, [0.05] * 10, 10.0)]
    np.testing.assert_allclose(near, 0.05 * (1.0 - np.exp(-0.05 * np.arange(1, 11) / 0.2)), rtol=1e-12)
    wheels = [s.wheels for s in states_under(slow, straight, [0.5] * 4, 10.0)]
    np.testing.assert_allclose(wheels, 0.5 * 0.05 * np.arange(1, 5), rtol=1e-12)


def test_at_walking_pace_the_model_stays_stable():
    controller = MPPI(CAR, profile="paper", period=0.1, **SMALL)
    last = states_under(controller, kernel.State(0.0, 0.0, 0.0, 0.0, 0.0, 0.0), [0.1] * 200, 1.0)[-1]
    assert last.r == pytest.approx(0.1 / CAR.wheelbase, rel=0.05)  # that of a bicycle without slip


# -- the plan ---------------------------------------------------------------------------------------------------------
def test_one_round_moves_the_plan_to_the_mean_that_the_theory_gives():
    """Where the cost is S = c + g'e + e'He/2 and e ~ N(0, s^2 I), exp(-S/lambda) has the mean -(I/s^2 + H/l)^-1 g/l."""
    speed, state, spread, temperature = 12.0, [0.0, 0.0, 0.0, 0.02], 0.05, 1e-5
    options = {"q_course": 1.0, "r": 0.01, "horizon": 0.3, "period": 0.1, "limits": WIDE}
    controller = MPPI(
        CAR, profile="paper", temperature=temperature, spread=spread, samples=16_384, preview=True, **options
    )
    step = controller.step(state, speed, np.zeros(10))

    def cost(moves):
        before, total = kernel.State(0.0, 0.02, 0.0, 0.0, 0.0, 0.0), 0.0
        for new, move in zip(states_under(controller, before, np.cumsum(moves).tolist(), speed), moves, strict=True):
            course = (new.y - before.y) / (speed * 0.1)
            total += 0.1 * (new.y**2 + 1.0 * course**2 + 0.01 * (move / 0.1) ** 2)
            before = new
        return total

    h = 1e-3 * np.eye(3)
    g = np.array([(cost(h[i]) - cost(-h[i])) / 2e-3 for i in range(3)])
    H = np.array([[(cost(a + b) - cost(a - b) - cost(b - a) + cost(-a - b)) / 4e-6 for a in h] for b in h])
    s = spread * 0.1
    mean = -np.linalg.solve(np.eye(3) / s**2 + H / temperature, g / temperature)
    covariance = np.linalg.inv(np.eye(3) / s**2 + H / temperature)
    noise = math.sqrt(covariance[0, 0] / step.diagnostics["effective"])
    assert abs(mean[0]) > 20.0 * noise  # a claim that can fail
    assert step.angle == pytest.approx(mean[0], abs=5.0 * noise)


def test_commands_on_their_way_are_driven_through_by_the_model():
    """Two periods late is where a car without dead time is two periods on."""
    late = MPPI(CAR, profile="paper", belief=at.Steering(lag=0.1, dead_time=0.2), preview=True, **SMALL)
    prompt = MPPI(CAR, profile="paper", belief=at.Steering(lag=0.1, dead_time=0.0), preview=True, **SMALL)
    speed, (vy, yaw, rate, y) = 15.0, (0.05, 0.02, 0.03, 0.4)
    after = states_under(prompt, kernel.State(0.0, y, yaw, vy, rate, 0.0), [0.0, 0.0], speed)[-1]
    angle = late.step([vy, yaw, rate, y], speed, np.zeros(40)).angle
    then = prompt.step([after.vy, after.yaw, after.r, after.y], speed, np.zeros(40)).angle
    assert angle == pytest.approx(then, rel=1e-9)
    assert angle != 0.0


# -- the contract -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("profile", ["paper", "road", "production"])
@pytest.mark.parametrize("car", ["paper", "van"])
def test_it_keeps_the_contract_of_controllers(car, profile):
    at.check_controller(MPPI(at.load_vehicle(car), profile=profile, rounds=2, **SMALL))


def test_it_drives_alike_from_python_and_compiled_and_the_same_with_the_same_seed():
    runs = [
        at.simulate(at.DualTrack(CAR), MPPI(CAR, profile="road", seed=seed), LANE_CHANGE, profile="road")
        for seed in (5, 6)
    ]
    again = at.rollout(
        at.DualTrack(CAR), at.get_controller("mppi", CAR, profile="road", seed=5), LANE_CHANGE, profile="road"
    )
    assert np.array_equal(runs[0].command, again.command)
    assert np.array_equal(runs[0].Y, again.Y)
    assert not np.array_equal(runs[0].command, runs[1].command)


@pytest.mark.parametrize("profile", ["paper", "road"])
def test_it_follows_a_hairpin(profile):
    controller = MPPI(CAR, profile=profile, period=0.05, preview=True)
    run = at.rollout(at.DualTrack(CAR), controller, at.RoadDrive(HAIRPIN, 6.0), profile=profile)
    assert run.failed is None
    assert np.abs(run.error).max() < 0.3


def test_a_situation_that_is_not_finite_leaves_the_plan_as_it_is():
    controller = MPPI(CAR, profile="paper", preview=True, **SMALL)
    controller.step([0.0, 0.0, 0.0, 0.5], 10.0, np.zeros(40))
    step = controller.step([0.0, math.nan, 0.0, 0.5], 10.0, np.zeros(40))
    assert step.held
    assert step.move == 0.0
    assert np.isfinite(controller.own_part.law.memory).all()


@pytest.mark.parametrize(
    ("option", "value"), [("samples", 100), ("horizon", 0.01), ("rounds", 0), ("friction", 0.0), ("temperature", -1.0)]
)
def test_nonsense_is_refused_by_name(option, value):
    with pytest.raises(at.InvalidInput, match=option):
        MPPI(CAR, **{option: value})


def test_without_a_compiler_the_remedy_is_named(monkeypatch):
    mppi._compiled_law.cache_clear()
    monkeypatch.setattr(mppi, "compiles", lambda: False)
    with pytest.raises(at.MissingExtra, match=r"pip install 'adaptrack\[compile\]'"):
        MPPI(CAR)
