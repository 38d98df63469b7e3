"""Benchmarks of random cars: what they tell, learn and judge."""

from __future__ import annotations

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import odeint

import adaptrack as at
from adaptrack.identification.random_cars import CarRanges, random_car


def _benchmark(name):
    path = Path(__file__).resolve().parent.parent / "benchmarks" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"benchmark_{name}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


population, learned_belief = _benchmark("population"), _benchmark("learned_belief")


def test_a_car_known_exactly_is_told_as_it_is_and_a_car_unknown_as_the_middle_of_the_ranges():
    car = random_car(5)
    exactly, unknown = population.told(car, 0.0), population.told(car, 1.0)
    assert exactly.vehicle.mass == pytest.approx(car.vehicle.mass)
    assert exactly.steering.lag == pytest.approx(car.profile.steering.lag)
    assert exactly.uncertainty.caution == pytest.approx(1.0)
    base, (low, high) = at.load_vehicle(car.base), CarRanges().mass
    assert unknown.vehicle.mass == pytest.approx(base.mass * math.sqrt(low * high))
    assert unknown.steering.lag == pytest.approx(sum(CarRanges().lag) / 2)


@pytest.mark.parametrize("share", [0.25, 0.6, 1.0])
def test_the_true_car_lies_within_what_is_told(share):
    balance = math.sqrt(1.18) ** share  # not told
    for number in range(60):
        car = random_car(number)
        told, steering = population.told(car, share), car.profile.steering
        assert abs(steering.lag - told.steering.lag) <= told.uncertainty.lag + 1e-12
        assert abs(steering.dead_time - told.steering.dead_time) <= told.uncertainty.dead_time + 1e-12
        assert abs(math.log(car.vehicle.mass / told.vehicle.mass)) <= math.log1p(told.uncertainty.mass) + 1e-12
        factor = abs(math.log(car.vehicle.stiffness_front / told.vehicle.stiffness_front))
        assert factor <= math.log(told.uncertainty.stiffness * balance) + 0.05  # that of the shipped tyre to its model


def _made_up(cars=80):
    """Cars whose best weight is the square of their yaw gain, with horizons that matter to none."""
    rng = np.random.default_rng(3)
    features = rng.normal(size=(cars, len(population.FEATURES)))
    features[:, population.YAW_GAIN] *= 0.25
    best = 2.0 * features[:, population.YAW_GAIN]
    cost = (population.WEIGHTS - best[:, None]) ** 2
    cost = np.repeat(cost[:, None], len(population.PAIRS), axis=1)
    return population.Cars(cost, cost.copy(), features, np.zeros(cars), np.full(cars, np.nan))


def test_the_judging_finds_a_rule_where_there_is_one():
    regret = {name: each.mean() for name, each in population.judged(_made_up()).items()}
    assert regret["... times yaw gain^2"] < 0.05
    assert regret["linear, of the best"] < 0.1 * regret["one constant for all"]
    assert regret["network, of the best"] < 0.5 * regret["one constant for all"]


def _signals(seconds=20.0, period=0.05, speed=18.0, factor=1.0, delay=0.4):
    """Drives of one linear single-track car behind a lag and a dead time of half the delay each, by scipy."""
    m, inertia, lf, lr, cf, cr = own = np.array([1500.0, 2500.0, 1.2, 1.5, 9e4, 1.1e5])
    cf, cr = factor * cf, factor * cr
    t = np.arange(0.0, seconds, period)
    command = 0.02 * np.sin(1.1 * t) + 0.01 * np.sin(3.7 * t + 1.0)

    def slope(now, x):
        vy, rate, angle = x
        sent = command[max(int((now - delay / 2) / period + 1e-9), 0)] if now >= delay / 2 else 0.0
        front, rear = cf * (angle - (vy + lf * rate) / speed), cr * (lr * rate - vy) / speed
        return [(front + rear) / m - speed * rate, (lf * front - lr * rear) / inertia, (sent - angle) / (delay / 2)]

    x = odeint(slope, np.zeros(3), t, tfirst=True, hmax=0.01, rtol=1e-7, atol=1e-9).T
    return learned_belief.Drives(
        command=command[None], speed=np.full((1, len(t)), speed), measured=np.array([[x[1], x[0]]]),
        noise=np.array([[1e-3, 1e-2]]), car=own[None], truth=np.zeros((1, 10, 3)), filters=np.zeros((1, 10, 3)),
        number=np.zeros(1, int),
    )  # fmt: skip


def test_a_hypothesis_answers_a_constant_command_with_the_steady_yaw_gain():
    drives = _signals()
    drives = drives._replace(command=np.full_like(drives.command, 0.01))
    m, _, lf, lr, cf, cr = drives.car[0]
    for factor, answer in zip(
        learned_belief.STIFFNESS, learned_belief.answers(drives, 0.05, True)[0, 0, :, 3, -1], strict=True
    ):
        understeer = m * (lr * cr - lf * cf) / ((lf + lr) * cf * cr * factor)
        assert answer == pytest.approx(0.01 * 18.0 / (lf + lr + understeer * 18.0**2), rel=1e-3)


@pytest.mark.parametrize("place", [(1, 2), (2, 6), (3, 10)])
def test_the_hypothesis_that_made_the_signals_explains_them_best(place):
    factor, delay = learned_belief.STIFFNESS[place[0]], learned_belief.DELAYS[place[1]]
    drives = _signals(factor=factor, delay=delay)
    residual, _ = learned_belief.moments(drives, 0.05, True)
    error = residual[0].sum(axis=0)[..., 1]  # (sensors, stiffness, delays)
    joint = (error / error.min(axis=(1, 2), keepdims=True)).sum(axis=0)
    found = np.unravel_index(joint.argmin(), joint.shape)
    assert found[0] == place[0]
    assert abs(found[1] - place[1]) <= 1
