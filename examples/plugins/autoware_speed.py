"""Longitudinal controller in the structure of Autoware's, as a driver of `simulate`: `driver=AutowareSpeed(car)`.

In comparisons its name is `autoware`: `adaptrack compare --plugin autoware_speed --driver autoware`.

Four states: in ``driving`` a PID on the speed at the predicted place, with the planned acceleration as feed-forward;
in ``stopping`` a sequence of constant decelerations ("smooth stop"); in ``stopped`` the brakes hold; in ``emergency``
a fixed deceleration, when the stop is overrun. A delay is compensated by prediction, a slope by its gravity.

Source: the documentation of `autoware_pid_longitudinal_controller` and its published parameters, which are the defaults
here (github.com/autowarefoundation/autoware.universe, control/autoware_pid_longitudinal_controller, README and
config; Apache 2.0). Written from that description; no code is copied. Two parts belong to other modules there: the
planner, which lets a car that has stood long enough go on, and the map from acceleration to pedals, which is here mass
and resistance of the car file.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass
from typing import Annotated

import numpy as np

from adaptrack.base.checked import NotNegative, Positive, Share, checked
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.speed_control import SpeedCommand, SpeedLimit, SpeedState
from adaptrack.core.public import GRAVITY
from adaptrack.drive.drivers import register_driver
from adaptrack.road import Road, SpeedPlan, Stop

DEPARTURE = 0.3
"""m, ahead of a stop that is left, at which the plan is read: planners begin above speed 0 there."""
STEP = 0.5
"""m, over which the planned acceleration is taken."""
SPEED_HISTORY = 0.5
"""s, of the speeds from which the time until the car stands is predicted."""
MAX_PITCH = 0.1
"""rad, of a slope that is compensated."""


@checked
@dataclass(frozen=True)
class AutowareSpeed:
    """Longitudinal controller in Autoware's structure: parameters with their published names and values.

    car: mass and resistance, for the force.
    """

    car: Vehicle
    delay_compensation_time: Annotated[NotNegative, "s"] = 0.17
    kp: Annotated[NotNegative, "1/s"] = 1.0
    ki: Annotated[NotNegative, "1/s^2"] = 0.1
    max_out: Annotated[Positive, "m/s^2"] = 1.0
    """of the PID, to either side"""
    max_i_effort: Annotated[NotNegative, "m/s^2"] = 0.3
    lpf_vel_error_gain: Share = 0.9
    max_acc: Annotated[Positive, "m/s^2"] = 3.0
    min_acc: float = -5.0
    max_jerk: Annotated[Positive, "m/s^3"] = 2.0
    min_jerk: float = -5.0
    stopping_state_stop_dist: Annotated[NotNegative, "m"] = 0.5
    stopped_state_entry_vel: Annotated[Positive, "m/s"] = 0.01
    stopped_state_entry_duration_time: Annotated[NotNegative, "s"] = 0.1
    emergency_state_overshoot_stop_dist: Annotated[Positive, "m"] = 1.5
    current_vel_threshold_pid_integration: Annotated[NotNegative, "m/s"] = 0.5
    max_strong_acc: float = -0.5
    min_strong_acc: float = -0.8
    weak_acc: float = -0.3
    weak_stop_acc: float = -0.8
    strong_stop_acc: float = -3.4
    max_fast_vel: Annotated[NotNegative, "m/s"] = 0.5
    weak_stop_time: Annotated[NotNegative, "s"] = 0.8
    weak_stop_dist: float = -0.3
    strong_stop_dist: float = -0.5
    stopped_acc: float = -3.4
    stopped_jerk: float = -5.0
    emergency_acc: float = -5.0
    emergency_jerk: float = -3.0

    def begin(self, path: Road, plan: SpeedPlan, period: float) -> AutowareFollower:
        """Begin a run, see `adaptrack.drive.world.SpeedDriver`."""
        return AutowareFollower(self, path, plan, period)


class AutowareFollower:
    """The controller on its way along a path; arguments as `AutowareSpeed.begin`."""

    def __init__(self, settings: AutowareSpeed, path: Road, plan: SpeedPlan, period: float) -> None:
        self.settings, self._path, self._plan, self._period = settings, path, plan, period
        self._stops = [*plan.stops]
        if not plan.closed and plan.speed[-1] == 0.0:
            self._stops.append(Stop(path.length, math.inf))
        self._state, self._left_at = SpeedState.DRIVING, -math.inf
        self._acceleration = 0.0
        self._integral = self._error = self._standing = self._still = 0.0
        self._strong_acc = settings.max_strong_acc
        periods = max(math.ceil(settings.delay_compensation_time / period - 1e-9), 1)
        self._sent: deque[float] = deque([0.0] * periods, maxlen=periods)
        self._speeds: deque[float] = deque(maxlen=max(round(SPEED_HISTORY / period), 2))

    def step(self, station: float, speed: float, yaw_rate: float) -> SpeedCommand:
        """Return the requests for the present period, see `adaptrack.drive.world.SpeedFollower`."""
        p, car, lap = self.settings, self.settings.car, self._path.length
        distance = self._stops[0].s - station if self._stops else math.inf
        self._standing = self._standing + self._period if speed < p.stopped_state_entry_vel else 0.0
        self._speeds.append(speed)
        self._change_state(distance, speed)
        target, limits = 0.0, (p.min_jerk, p.max_jerk)
        if self._state == SpeedState.DRIVING:
            target, wanted = self._follow(station, distance, speed)
        elif self._state == SpeedState.STOPPING:
            wanted = self._stop_smoothly(distance, speed)
        elif self._state == SpeedState.STOPPED:
            wanted, limits = p.stopped_acc, (p.stopped_jerk, p.max_jerk)
        else:
            wanted, limits = p.emergency_acc, (p.emergency_jerk, p.max_jerk)
        low, high = (self._acceleration + limit * self._period for limit in limits)
        self._acceleration = min(max(wanted, low, p.min_acc), max(high, low), p.max_acc)
        self._sent.append(self._acceleration)
        pitch = math.atan(float(self._path.along("grade", [station % lap if self._plan.closed else station])[0]))
        drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient * speed**2 / car.mass
        resistance = drag + (car.rolling_resistance * GRAVITY if speed > p.stopped_state_entry_vel else 0.0)
        slope = GRAVITY * math.sin(min(max(pitch, -MAX_PITCH), MAX_PITCH))
        force = car.mass * (self._acceleration + resistance + slope)
        cause = SpeedLimit.PLAN if self._state == SpeedState.DRIVING else SpeedLimit.STOP
        return SpeedCommand(self._acceleration, force, 0.0, target, math.nan, self._state, cause)

    def _change_state(self, distance: float, speed: float) -> None:
        """Go on to the state that the distance to the stop (m) and the speed (m/s) ask for."""
        p = self.settings
        stands = self._standing >= p.stopped_state_entry_duration_time
        if self._state == SpeedState.STOPPED:
            if self._standing >= self._stops[0].seconds:
                stop = self._stops.pop(0)
                if self._plan.closed:
                    self._stops.append(Stop(stop.s + self._path.length, stop.seconds))  # in the next lap
                self._state, self._left_at, self._integral, self._error = SpeedState.DRIVING, stop.s, 0.0, 0.0
        elif stands and (distance < p.stopping_state_stop_dist or self._state == SpeedState.EMERGENCY):
            self._state = SpeedState.STOPPED
        elif distance < -p.emergency_state_overshoot_stop_dist:
            self._state = SpeedState.EMERGENCY
        elif self._state == SpeedState.DRIVING and distance < p.stopping_state_stop_dist:
            self._state, self._still = SpeedState.STOPPING, 0.0
            later = max(speed + p.delay_compensation_time * float(np.mean(self._sent)), 0.0)
            left = distance - 0.5 * (speed + later) * p.delay_compensation_time
            needed = -(later**2) / (2.0 * max(left, 0.01))
            self._strong_acc = min(max(needed, p.min_strong_acc), p.max_strong_acc)

    def _follow(self, station: float, distance: float, speed: float) -> tuple[float, float]:
        """Planned speed (m/s) where a request acts, and acceleration (m/s^2): feed-forward and PID."""
        p = self.settings
        delay = p.delay_compensation_time
        predicted = max(speed + delay * float(np.mean(self._sent)), 0.0)
        stop = station + distance
        place = min(max(station + 0.5 * (speed + predicted) * delay, self._left_at + DEPARTURE, 0.5 * DEPARTURE), stop)
        first = min(place, stop - STEP)
        target, before, after = self._plan.at([place, first, first + STEP]).tolist()
        error = target - predicted
        self._error = p.lpf_vel_error_gain * self._error + (1.0 - p.lpf_vel_error_gain) * error
        if speed > p.current_vel_threshold_pid_integration and p.ki > 0.0:
            most = p.max_i_effort / p.ki
            self._integral = min(max(self._integral + self._error * self._period, -most), most)
        feedback = min(max(p.kp * self._error, -p.max_out), p.max_out) + p.ki * self._integral
        feed_forward = (after**2 - before**2) / (2.0 * STEP)
        if speed < p.stopped_state_entry_vel:
            feed_forward = max(feed_forward, 0.0)  # a planner plans from the present speed
        return target, min(max(feed_forward + min(max(feedback, -p.max_out), p.max_out), p.min_acc), p.max_acc)

    def _stop_smoothly(self, distance: float, speed: float) -> float:
        """Deceleration (m/s^2) of the last half metre: strong, weak once the car stands within the delay, then hard.

        The time until the car stands follows from the straight line through its last speeds.
        """
        p = self.settings
        if distance < p.strong_stop_dist:
            return p.strong_stop_acc
        if distance < p.weak_stop_dist:
            return p.weak_stop_acc
        if speed < p.stopped_state_entry_vel:
            self._still += self._period
            return p.weak_acc if self._still < p.weak_stop_time else p.strong_stop_acc
        self._still = 0.0
        count = len(self._speeds)
        slope = np.polyfit(self._period * np.arange(count), self._speeds, 1)[0] if count > 1 else 0.0
        is_far = -speed / slope > p.delay_compensation_time if slope < 0.0 else speed > p.max_fast_vel
        return self._strong_acc if is_far else p.weak_acc


register_driver("autoware", AutowareSpeed)
