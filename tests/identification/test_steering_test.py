"""The steering test measures lag and dead time of a first-order lag behind a dead time, whose response is analytic."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.errors import InvalidInput

CAR = at.load_vehicle("midsize-sedan").replace(steering=None)
PERIOD, LAG, DEAD_TIME = 0.05, 0.18, 0.13
WITHIN = 1.645


class Wheels:
    """Wheels behind a first-order lag and a dead time: step c at t_0 turns by c (1 - exp((t_0 + T_d - t)/lag))."""

    def __init__(self, lag, dead_time, gain=1.0):
        self.lag, self.dead_time, self.gain = lag, dead_time, gain
        self.steps, self.command = [], 0.0

    def send(self, time, command):
        if command != self.command:
            self.steps.append((time, command - self.command))
            self.command = command

    def angle(self, time):
        since = [(time - start - self.dead_time, step) for start, step in self.steps]
        return self.gain * sum(step * -math.expm1(-span / self.lag) for span, step in since if span > 0.0)


def steering_test(
    wheels: Wheels, speed: float, noise: float = 0.0, seed: int = 0, age: float = 0.0, wheel: bool = False
):
    """A test that is driven to its end: a yaw rate v tan(delta)/L, or a wheel angle, with white noise."""
    rng, test = np.random.default_rng(seed), at.SteeringTest(CAR)
    for k in itertools.count():
        sampled = k * PERIOD
        angle = wheels.angle(sampled)
        yaw_rate = speed * math.tan(angle) / CAR.wheelbase + noise * rng.normal()
        signals = {"wheel_angle": angle + noise * rng.normal()} if wheel else {"yaw_rate": yaw_rate}
        command = test.step(sampled, speed, **signals, command_time=sampled + age)
        wheels.send(sampled + age, command)
        if test.is_complete:
            return test


@pytest.mark.parametrize("age", [0.0, 0.02])
@pytest.mark.parametrize(("lag", "dead_time"), [(LAG, DEAD_TIME), (0.05, 0.03), (0.35, 0.3)])
def test_a_wheel_sensor_of_a_standing_car_gives_the_exact_delay(lag, dead_time, age):
    fit = steering_test(Wheels(lag, dead_time), 0.0, wheel=True, age=age).fit()
    assert (fit.lag, fit.dead_time) == pytest.approx((lag, dead_time), abs=1e-3)


def test_the_intervals_hold_the_delay_that_a_noisy_yaw_rate_shows_at_walking_speed():
    cars = [steering_test(Wheels(LAG, DEAD_TIME), 2.0, 0.003, seed).estimate() for seed in range(10)]
    for car in cars:
        assert abs(car.lag - LAG) < WITHIN * car.lag_sigma < 0.1
        assert abs(car.dead_time - DEAD_TIME) < WITHIN * car.dead_time_sigma < 0.1
        assert min(car.lag_sigma, car.dead_time_sigma, car.delay_sigma) >= 0.03


def test_the_covariance_is_the_scatter_over_repeated_noise():
    fits = [steering_test(Wheels(LAG, DEAD_TIME), 0.0, 0.002, seed, wheel=True).fit() for seed in range(12)]
    deviations = np.array([(fit.lag - LAG, fit.dead_time - DEAD_TIME) for fit in fits])
    squared = [e @ np.linalg.solve(fit.covariance, e) for fit, e in zip(fits, deviations, strict=True)]
    assert 0.7 < np.mean(squared) < 4.0  # chi^2 of two degrees of freedom: its mean over 12 is 2 +- 0.58


def test_a_test_stays_within_its_way_and_its_angle():
    for speed in (1.5, 3.0):
        test, wheels = at.SteeringTest(CAR, angle=0.15), Wheels(LAG, DEAD_TIME)
        way = time = 0.0
        while not test.is_complete:
            wheels.send(time, test.step(time, speed, wheels.angle(time)))
            assert abs(wheels.command) <= 0.15
            time, way = time + PERIOD, way + PERIOD * speed
        assert not test.fault
        assert way <= 10.0 + 2.0 * PERIOD * speed
        assert wheels.command == 0.0


def test_the_estimate_is_the_delay_with_which_a_learning_controller_begins():
    car = steering_test(Wheels(LAG, DEAD_TIME), 0.0, wheel=True).estimate()
    prior = at.MPC(CAR, learning=at.Learning()).learned()
    start = at.MPC(CAR, learning=at.Learning(start=car)).learned()
    assert (start.lag, start.dead_time) == pytest.approx((LAG, DEAD_TIME), abs=2e-3)
    assert start.delay_sigma < 0.5 * prior.delay_sigma
    for name in ("stiffness", "stiffness_sigma", "balance", "balance_sigma", "bias", "bias_sigma"):
        assert getattr(start, name) == pytest.approx(getattr(prior, name))


@pytest.mark.parametrize(("speed", "signals", "sentence"), [
    (3.5, {"yaw_rate": 0.0}, "speed = 3.5 m/s at t = 0.000 s: drive 1.5 to 3 m/s"),
    (0.0, {"yaw_rate": 0.0}, "speed = 0 m/s and no wheel angle measured"),
    (2.0, {}, "neither wheel angle nor yaw rate measured"),
    (math.nan, {"wheel_angle": 0.0}, "speed = nan m/s"),
])  # fmt: skip
def test_a_sample_that_shows_no_steering_ends_the_test_with_a_sentence(speed, signals, sentence):
    test = at.SteeringTest(CAR)
    assert test.step(0.0, speed, **signals) == 0.0
    assert test.is_complete
    assert sentence in test.fault
    with pytest.raises(InvalidInput, match=r"yaw_rate = None: must be a number \(NaN if it was not measured\)"):
        test.step(0.0, 5.0, None)
    with pytest.raises(InvalidInput, match="SteeringTest: speed"):
        test.estimate()


def test_a_test_without_response_without_samples_or_without_end_is_refused():
    test = at.SteeringTest(CAR)
    test.step(0.0, 2.0, 0.0)
    still, inverted = (steering_test(Wheels(LAG, DEAD_TIME, gain), 2.0, 0.003) for gain in (0.0, -1.0))
    for words, call in (
        ("the wheels do not follow the commands", still.estimate),
        ("the wheels do not follow the commands", inverted.estimate),
        ("not complete", test.estimate),
        ("must be later than the last sample", lambda: test.step(0.0, 2.0, 0.0)),
    ):
        with pytest.raises(InvalidInput, match=words):
            call()
    assert test.step(1.0, 2.0, 0.0) == 0.0
    assert "no sample for 1 s" in test.fault
