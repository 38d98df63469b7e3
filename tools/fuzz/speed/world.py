"""The car that is driven: a point on its path with steering, drive and brakes, and the sensors on it.

Drive and brakes are lags of first order behind dead times. Brake force, hold and rolling resistance oppose the motion
and never move a standing car. The place is kept in coordinates of the path (station, offset, heading error).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adaptrack.core.physics.forces import GRAVITY
from tools.fuzz.speed.drives import Drive
from tools.fuzz.speed.faults import Sample

SUBSTEP = 0.01
"""s."""
SPACING = 0.5
"""m, of the table of the path."""
STEERING_LAG, STEERING_DEAD_TIME = 0.12, 0.04
"""s."""
SLIPPING_SPEED = 4.0
"""m/s, from which the tyres slip sideways."""
REST = 1e-3
"""m/s, below which friction holds a car."""
DRIVER_BRAKE, DRIVER_DRIVE = 4.0, 2.0
"""m/s^2, largest of a driver."""


class Row(NamedTuple):
    """The car at a substep."""

    t: float
    station: float
    offset: float
    heading_error: float
    speed: float
    yaw_rate: float
    acceleration: float


def _usable(request: float) -> float:
    """The request, or 0 where it is not finite."""
    return request if math.isfinite(request) else 0.0


class World:
    """The true car and road of a drive."""

    def __init__(self, drive: Drive) -> None:
        road, car, true = drive.routes[0].road, drive.car, drive.true_car
        self.drive, self.length, self.closed = drive, float(road.length), road.closed
        places = np.arange(0.0, self.length + SPACING, SPACING)
        table = road.at(np.minimum(places, self.length - 1e-9))
        self._x, self._y, self._heading, self._curvature = (np.asarray(column).tolist() for column in table)
        self._grade = np.interp(places, *drive.grade).tolist()
        self.elapsed, self.station, self.speed = 0.0, *drive.start
        self.offset = self.heading_error = self.yaw_rate = self.acceleration = 0.0
        self._wheel = math.atan(car.wheelbase * self._curvature[self._cell(self.station)])
        self._push, self._brake = 0.0, 0.0 if self.speed > 0.0 else car.mass * 3.0
        self._forces: list[float] = []
        self._holds: list[float] = []
        self._commands: list[float] = []
        self.driver_target = math.nan
        self._requests = (0.0, self._brake, self._wheel)
        self._delays = [
            max(round(time / SUBSTEP), 0)
            for time in (true.drive_dead_time, true.brake_dead_time, STEERING_DEAD_TIME)
        ]  # fmt: skip
        self.rows: list[Row] = [Row(0.0, *drive.start[:1], 0.0, 0.0, self.speed, 0.0, 0.0)]
        self._noise = np.random.default_rng([drive.seed, drive.number, 1])
        self._sampled, self._substeps = -math.inf, 0
        self._last: Sample = {}
        self._arm, self._wheelbase, self._lateral = car.lr, car.wheelbase, 0.0  # m, m, m/s
        self._front, self._rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
        self._inertia = car.yaw_inertia * true.mass / car.mass
        self._drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient

    # -- the road -----------------------------------------------------------------------------------------------------
    def _cell(self, station: float) -> int:
        if self.closed:
            return int((station % self.length) / SPACING)
        return min(max(int(station / SPACING), 0), len(self._x) - 2)

    def grade(self, station: float) -> float:
        """dz/ds of the true road."""
        return self._grade[self._cell(station)]

    def pose(self, station: float, offset: float, heading_error: float) -> tuple[float, float, float]:
        """x, y (m) and yaw (rad) in the plane."""
        inside, i = station % self.length if self.closed else station, self._cell(station)
        i = min(i, len(self._x) - 2)
        share = (inside - i * SPACING) / SPACING
        heading = self._heading[i] + min(max(share, 0.0), 1.0) * (self._heading[i + 1] - self._heading[i])
        if not self.closed and not 0.0 <= station <= self.length:
            end = len(self._x) - 1 if station > self.length else 0
            beyond, heading = station - (self.length if end else 0.0), self._heading[end]
            x, y = self._x[end] + beyond * math.cos(heading), self._y[end] + beyond * math.sin(heading)
        else:
            x = self._x[i] + share * (self._x[i + 1] - self._x[i])
            y = self._y[i] + share * (self._y[i + 1] - self._y[i])
        yaw = math.remainder(heading + heading_error, 2.0 * math.pi)
        return x - offset * math.sin(heading), y + offset * math.cos(heading), yaw

    # -- the car ------------------------------------------------------------------------------------------------------
    def request(self, force: float, hold: float, command: float) -> None:
        """Take the requests of a call, in force from now on; a number that is none counts as zero."""
        self._requests = _usable(force), _usable(hold), _usable(command)

    def advance(self, until: float) -> None:
        """Drive up to a time (s)."""
        car, true, dt = self.drive.car, self.drive.true_car, SUBSTEP
        forces, holds, commands = self._forces, self._holds, self._commands
        drive_delay, brake_delay, steering_delay = self._delays
        drive_share, brake_share = (min(dt / (lag + 1e-3), 1.0) for lag in (true.drive_lag, true.brake_lag))
        count = max(round((until - self.elapsed) / dt), 0)
        for values, value in zip((forces, holds, commands), self._requests, strict=True):
            values.extend([value] * count)
        first = len(forces) - count
        for i in range(first, len(forces)):
            push = true.drive_gain * min(max(forces[max(i - drive_delay, 0)], 0.0), car.traction_limit)
            late = max(i - brake_delay, 0)
            brake = true.brake_gain * min(max(-forces[late], 0.0) + holds[late], car.brake_limit)
            self._push += drive_share * (push - self._push)
            self._brake += brake_share * (brake - self._brake)
            self._wheel += dt / STEERING_LAG * (commands[max(i - steering_delay, 0)] - self._wheel)
            before, cell = self.speed, self._cell(self.station)
            if math.isnan(self.driver_target):
                self._roll(self._grade[cell], dt)
            else:
                wish = 2.0 * (self.driver_target - before)
                self.speed += dt * min(max(wish, -DRIVER_BRAKE), DRIVER_DRIVE)
            v = 0.5 * (before + self.speed)
            self.acceleration = (self.speed - before) / dt
            self.elapsed = (self._substeps + i - first + 1) * dt
            if v != 0.0:
                slip = self._steer(v, dt)
                course = self.heading_error + slip
                curvature = self._curvature[cell] if self.closed or 0.0 <= self.station <= self.length else 0.0
                way = v * math.cos(course) / max(1.0 - curvature * self.offset, 0.3) * dt
                self.offset += v * math.sin(course) * dt
                self.station += way
                turned = self.heading_error + self.yaw_rate * dt - curvature * way
                self.heading_error = math.remainder(turned, 2.0 * math.pi)
            self.rows.append(
                Row(self.elapsed, self.station, self.offset, self.heading_error, self.speed, self.yaw_rate,
                    self.acceleration)
            )  # fmt: skip
        self._substeps += count

    def _steer(self, v: float, dt: float) -> float:
        """Change the yaw rate by the steering at a speed (m/s): a linear single track; the sideslip (rad)."""
        wheel, arm, wheelbase = self._wheel, self._arm, self._wheelbase
        if abs(v) < SLIPPING_SPEED:
            slip = math.atan(arm * math.tan(wheel) / wheelbase)
            self.yaw_rate = v * math.tan(wheel) * math.cos(slip) / wheelbase
            self._lateral = v * math.tan(slip)
            return slip
        rate, lateral = self.yaw_rate, self._lateral
        front = self._front * (wheel - (lateral + (wheelbase - arm) * rate) / v)
        rear = -self._rear * (lateral - arm * rate) / v
        self._lateral += dt * ((front + rear) / self.drive.true_car.mass - v * rate)
        self.yaw_rate += dt * ((wheelbase - arm) * front - arm * rear) / self._inertia
        return math.atan(self._lateral / v)

    def _roll(self, grade: float, dt: float) -> None:
        """Change the speed by drive, brakes, slope and resistance."""
        car, true, v = self.drive.car, self.drive.true_car, self.speed
        weight = true.mass * GRAVITY / math.sqrt(1.0 + grade * grade)  # N, on the road
        grip, size = true.friction * weight, abs(v)
        push = min(self._push, grip, car.engine_power / max(size, 1.0)) - weight * grade - self._drag * v * size
        resistance = min(self._brake, grip) + car.rolling_resistance * weight
        if size < REST and abs(push) <= resistance:
            self.speed = 0.0
            return
        sign = math.copysign(1.0, v if size >= REST else push)
        after = v + dt * (push - sign * resistance) / true.mass
        self.speed = 0.0 if after * v < 0.0 and abs(push) <= resistance else after

    # -- the sensors --------------------------------------------------------------------------------------------------
    def sample(self, driver: bool) -> Sample:
        """What the sensors say in a call now, before any fault."""
        sensors, noise, drive = self.drive.sensors, self._noise, self.drive
        age = sensors.age + (abs(sensors.jitter) * float(noise.random()) if sensors.age > 0.0 else 0.0)
        newest = len(self.rows) - 1 - round(age / SUBSTEP)
        if sensors.period > 0.0:
            newest -= newest % round(sensors.period / SUBSTEP)
        row = self.rows[max(newest, 0)]
        if row.t == self._sampled:
            sample = dict(self._last)
        else:
            sample = self._measure(row)
            self._sampled, self._last = row.t, dict(sample)
        sample["now"] = drive.clock + self.elapsed
        sample["driver"] = float(driver)
        return sample

    def _measure(self, row: Row) -> Sample:
        """Measure a row, with noise."""
        sensors = self.drive.sensors
        e = self._noise.normal(size=8).tolist()
        x, y, yaw = self.pose(row.station, row.offset, row.heading_error)
        speed = row.speed + 0.02 * e[3]
        grade = self.grade(row.station) + 0.005 * e[5] if sensors.has_grade else math.nan
        acceleration = row.acceleration + 0.1 * e[6] if sensors.has_acceleration else math.nan
        nan = math.nan
        return {
            "t": self.drive.clock + row.t, "now": nan, "x": x + sensors.noise * e[0], "y": y + sensors.noise * e[1],
            "yaw": yaw + 0.003 * e[2], "speed": speed if sensors.is_signed else abs(speed),
            "yaw_rate": row.yaw_rate + 0.003 * e[4], "lateral_velocity": nan,
            "lateral_acceleration": row.speed * row.yaw_rate + 0.1 * e[7], "wheel_angle": nan, "friction": nan,
            "wind": nan, "motion_time": nan, "longitudinal_acceleration": acceleration, "driver": 0.0, "grade": grade,
        }  # fmt: skip
