"""Measurement of the steering delay before a drive: the car creeps or stands, and its wheels make a few steps.

The likelihood of `identify` is fitted to the samples of the test. Only lag, dead time, rate limit, gain and the errors
of the sensors are open, as the tyres hardly slip at walking speed. A yaw rate shows the wheels through relaxing tyres
(Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., section 7.2). The likelihood models them; their uncertainty is part of
the interval.
"""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np

from adaptrack.base.checked import Finite, checked, real, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import LearnedCar
from adaptrack.core.estimators.learning import LEARNED, QUANTITIES_BOUNDED, STIFFNESS_BOUND
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.synthesis.learner import MAX_BALANCE_RANGE, MAX_BIAS_RANGE, MAX_STIFFNESS_RANGE, UNIFORM_SIGMA
from adaptrack.identification.estimates import slopes_at, values_at
from adaptrack.identification.likelihood import Likelihood
from adaptrack.identification.log import LONGEST_PERIOD, Log
from adaptrack.identification.log_identification import START_DELAYS, starting_point
from adaptrack.identification.quantities import QUANTITIES, Prior, beliefs_of, report_delay

MIN_TEST_SPEED, MAX_TEST_SPEED = 1.5, 3.0
"""m/s, between which the yaw rate shows the wheels; with a wheel-angle sensor the car may also be slower, or stand."""
ACCEPTED_SPEEDS = (0.9 * MIN_TEST_SPEED, 1.1 * MAX_TEST_SPEED)
"""m/s, between which a measured speed, with its noise, may lie."""
TEST_DISTANCE, TEST_DURATION = 10.0, 6.0
"""m and s, after the earlier of which the test is complete."""
MAX_TEST_ANGLE = 0.15
"""rad, largest step of the road wheels."""
TEST_STEPS = (0.0, 1.0, -1.0, 0.0)
"""Command in each quarter of the test, over its largest angle."""
MIN_TEST_SIGMA = 0.03
"""s, least standard deviation that is reported for lag, dead time and their sum: a steering that is loaded at speed
differs from one at walking speed."""
MIN_EXPLAINED = 0.7
"""Share of a sensor's variance that the commands must explain."""
FREE_QUANTITIES = (
    "delay", "lag_share", "rate", "gain", "offset", "lateness", "relaxation", "gyro_offset", "wheel_offset", "jolt",
    "noise_yaw_rate", "noise_wheel",
)  # fmt: skip
"""Quantities that are fitted; the others keep their prior median."""
GAIN_PRIOR = Prior(1.0, 0.3)
"""Of the road wheels over the command: the steering ratio may be wrong."""
TIME_GRID = 1e-4
"""s, to which times are rounded."""


class SteeringFit(NamedTuple):
    """Steering delay of a test, with the covariance that the sensor noise gives it."""

    lag: float
    """Time constant of the lag (s)"""
    dead_time: float
    """Time from a command until the wheels begin to move (s)"""
    covariance: Array
    """(2, 2) s^2, of lag and dead time"""


class SteeringTest:
    """Test that measures lag and dead time of the steering before a drive.

    In each control period call `step` with the latest sample and send the command that it returns. The wheels turn to
    `angle`, to -`angle` and back, within 10 m and 6 s. The car leaves its line by about 0.25 m, a biased steering by up
    to 1 m. With a wheel-angle sensor the car may stand. Otherwise it must drive at 1.5 to 3 m/s, and the delay includes
    that of the gyro. Begin with straight wheels::

        test = SteeringTest(car)
        while not test.is_complete:
            send(test.step(t, speed, yaw_rate, wheel_angle=wheel_angle))
        mpc = MPC(car, learning=Learning(start=test.estimate()))

    car: its geometry; the steering of its file is a prior; angle: largest angle of the road wheels.
    """

    @checked
    def __init__(self, car: Vehicle, angle: Annotated[Finite, within(0.02, MAX_TEST_ANGLE), "rad"] = 0.1) -> None:
        self.car, self.angle = car, angle
        self._rows: list[tuple[float, ...]] = []
        self._way = 0.0
        self.is_complete = False
        """whether no further step is needed; true after a fault as well"""
        self.fault = ""
        """sentence on what ended the test early; empty: nothing did"""

    def step(
        self,
        t: float,
        speed: float,
        yaw_rate: float = math.nan,
        *,
        wheel_angle: float = math.nan,
        command_time: float | None = None,
    ) -> float:
        """Process one sample and return the angle of the road wheels (rad) to command now.

        t: s, when the sample was taken; speed: m/s; yaw_rate: rad/s; wheel_angle: rad, of the road wheels;
        command_time: s, on the same clock, when the command is sent, if later than t. NaN: not measured. A sample that
        the test cannot use ends it with a `fault`, and the command is 0.

        Raises
        ------
        InvalidInput
            When an argument is no number, or a time is not finite or not later than the one before.
        """
        sample = {"t": t, "speed": speed, "yaw_rate": yaw_rate, "wheel_angle": wheel_angle}
        time, v, r, wheel = (real("SteeringTest.step", name, value, name != "t") for name, value in sample.items())
        sent = time if command_time is None else real("SteeringTest.step", "command_time", command_time)
        if not (math.isfinite(time) and math.isfinite(sent) and sent >= time):
            raise InvalidInput(
                f"SteeringTest.step: t = {t!r}, command_time = {command_time!r}: give finite s, t first."
            )
        if self.is_complete:
            return 0.0
        if self._rows and time <= self._rows[-1][0]:
            raise InvalidInput(f"SteeringTest.step: t = {t!r} s: must be later than the last sample.")
        if fault := self._find_fault(time, v, r, wheel):
            self.fault, self.is_complete = fault, True
            return 0.0
        start, last_time = (self._rows[0][0], self._rows[-1][0]) if self._rows else (time, time)
        self._way += v * (time - last_time)
        progress = max((time - start) / TEST_DURATION, self._way / TEST_DISTANCE)
        self.is_complete = progress >= 1.0
        command = self.angle * TEST_STEPS[min(int(len(TEST_STEPS) * progress), len(TEST_STEPS) - 1)]
        # steered wheels do not turn a car that hardly rolls
        self._rows.append((time, sent, command, v, r if v >= ACCEPTED_SPEEDS[0] else math.nan, wheel))
        return command

    def _find_fault(self, time: float, speed: float, yaw_rate: float, wheel: float) -> str:
        """Sentence on a sample that the test cannot use; empty: none."""
        remedy = f"drive {MIN_TEST_SPEED:g} to {MAX_TEST_SPEED:g} m/s, or measure the wheel angle and stand"
        slowest, fastest = ACCEPTED_SPEEDS
        if not math.isfinite(speed) or speed > fastest or speed < -0.1:
            return f"speed = {speed:.3g} m/s at t = {time:.3f} s: {remedy}."
        if not math.isfinite(wheel) and (speed < slowest or not math.isfinite(yaw_rate)):
            why = "no wheel angle" if math.isfinite(yaw_rate) else "neither wheel angle nor yaw rate"
            return f"speed = {speed:.3g} m/s and {why} measured at t = {time:.3f} s: {remedy}."
        if self._rows and time - self._rows[-1][0] > 2.0 * LONGEST_PERIOD:
            gap, rate = time - self._rows[-1][0], 1.0 / LONGEST_PERIOD
            return f"no sample for {gap:.2g} s before t = {time:.3f} s: give samples at {rate:.0f} Hz or more."
        return ""

    def fit(self) -> SteeringFit:
        """Fit lag and dead time to the samples.

        Raises
        ------
        InvalidInput
            When the test is not complete, was ended by a fault, or the wheels did not follow the commands.
        """
        if self.fault or not self.is_complete:
            raise InvalidInput(f"SteeringTest: {self.fault or 'not complete: call step until is_complete is true.'}")
        log = _log_of(np.array(self._rows))
        priors = {
            name: prior if name in FREE_QUANTITIES else Prior(prior.median, 0.0)
            for name, prior in beliefs_of(self.car).items()
        }
        priors |= {"gain": GAIN_PRIOR, "wind_mean": Prior(0.0, 0.0)}
        likelihood = Likelihood(log, self.car, priors)
        z, scored = likelihood.fit_best(starting_point(likelihood, "delay", delay) for delay in START_DELAYS)
        share = _explained(likelihood.using(log.begins.astype(float)), z)
        if not share >= MIN_EXPLAINED:
            raise InvalidInput(
                f"SteeringTest: the wheels do not follow the commands, which explain {max(share, 0.0):.0%} of the "
                "response: check that the commands reach the steering, their sign, and the sensor's unit."
            )
        rows, covariance = report_delay(QUANTITIES, is_positive=False), portable.inverse(scored.information)
        slopes, (lag, dead_time) = slopes_at(likelihood, rows, z), values_at(likelihood, rows, z)
        covariance = portable.product(portable.product(slopes, covariance), slopes.T)
        return SteeringFit(float(lag), float(dead_time), covariance)

    def estimate(self) -> LearnedCar:
        """Return the steering delay as a prior for `Learning(start=...)`; the rest of the car stays unknown.

        Standard deviations are at least `MIN_TEST_SIGMA`. Raises errors as `fit` does.
        """
        fit = self.fit()
        lag, dead_time = (max(math.sqrt(variance), MIN_TEST_SIGMA) for variance in np.diag(fit.covariance))
        ranges = portable.log(MAX_STIFFNESS_RANGE), portable.log(MAX_BALANCE_RANGE), MAX_BIAS_RANGE
        unknown: dict[str, Any] = {}
        for name, spread in zip(QUANTITIES_BOUNDED[STIFFNESS_BOUND:], ranges, strict=True):
            unknown |= {name: LEARNED.field_settings[name].default, f"{name}_sigma": UNIFORM_SIGMA * spread}
        return LearnedCar(
            car=self.car.name, lag=fit.lag, lag_sigma=lag, dead_time=fit.dead_time, dead_time_sigma=dead_time,
            delay_sigma=max(math.sqrt(fit.covariance.sum()), MIN_TEST_SIGMA),
            seconds=self._rows[-1][0] - self._rows[0][0], **unknown,
        )  # fmt: skip


def _log_of(rows: Array) -> Log:
    """A log with a row for each sample and for each command, of which each has its own time."""
    sampled, sent = (np.round((times - rows[0, 0]) / TIME_GRID) * TIME_GRID for times in (rows[:, 0], rows[:, 1]))
    time, sent = np.union1d(sampled, sent), np.maximum.accumulate(sent)
    latest = np.searchsorted(sent, time, side="right") - 1
    command = np.where(latest >= 0, rows[latest, 2], 0.0)
    yaw_rate, wheel = np.full(time.size, np.nan), np.full(time.size, np.nan)
    place = np.searchsorted(time, sampled)
    yaw_rate[place], wheel[place] = rows[:, 4], rows[:, 5]
    unmeasured, begins = np.full(time.size, np.nan), np.arange(time.size) == 0
    return Log(
        time=time, command=command, speed=np.interp(time, sampled, rows[:, 3]), yaw_rate=yaw_rate, vy=unmeasured,
        acceleration=unmeasured, yaw=unmeasured, wheel=wheel, begins=begins, ratio_unknown=True,
    )  # fmt: skip


def _explained(simulation: Likelihood, z: Array) -> float:
    """Share of the variance of the wheel angle, or else of the yaw rate, that the commands explain at a point z."""
    output, signal = (4, "wheel") if simulation.present["wheel"] else (0, "yaw_rate")
    error, measured = simulation.innovations(z)[0][output], getattr(simulation.log, signal)
    return float(1.0 - np.nanvar(error) / max(float(np.nanvar(measured)), 1e-12))
