"""`KalmanFilter` by the book: matrices, SciPy's matrix exponential, Joseph's form, an equation a method.

The oracle of the compiled filter. Source: D. Simon, *Optimal State Estimation* (2006), sections 5.1 and 10.2.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.linalg import expm

from adaptrack.cars.vehicle import split_periods
from adaptrack.control.kalman import SENSORS
from adaptrack.core.estimators.kalman import (
    LEAST_NOISE,
    MAX_OUTLIER_DISTANCE,
    MAX_OUTLIER_TURN,
    RESTART_OUTLIERS,
    UNKNOWN_VARIANCE,
)
from adaptrack.core.models.path import MIN_SLIP_SPEED, MOST_SHARE
from adaptrack.core.physics.forces import GRAVITY

POSE = ("yaw", "y")


class TextbookFilter:
    """``step(speed, measured, command)`` gives (x, d) as `core.estimators.extended_kalman.ESTIMATE` says.

    z = [x, d_y, d_r] and, where it is estimated, the yaw-rate sensor's offset; P: its covariance.
    """

    def __init__(self, estimator, model):
        self.own, self.model, self.n, self.late = estimator, model, model.n, estimator.late(model)
        self.whole, self.share = split_periods(model.dead_time, model.period)
        offsets = ("offset",) if estimator.noise.yaw_rate_offset > 0.0 else ()
        self.names = (*model.states, "side", "turn", *offsets)
        self.size = len(self.names)
        self.variances = dict(zip(SENSORS, estimator.variances(), strict=True))
        self.Q = np.diag([getattr(estimator.drifts, name, 0.0) ** 2 for name in self.names])
        car = model.vehicle  # side wind C_s pushes, and turns by the arm C_ym L/C_s
        arm = car.wheelbase * car.yaw_moment_slope / car.side_force_slope if car.side_force_slope > 0.0 else 0.0
        wind = estimator.drifts.wind * np.array([1.0, arm * car.mass / car.yaw_inertia])
        self.Q[self.n : self.n + 2, self.n : self.n + 2] += np.outer(wind, wind)
        if offsets:
            self.Q[-1, -1] = estimator.drifts.yaw_rate_offset**2
        self.Q *= model.period
        self.turned, self.z, self.far = [0.0] * (self.late + 1), None, 0

    def row(self, **entries):
        """(size,) a vector with entries by the names of the states."""
        return np.array([entries.get(name, 0.0) for name in self.names])

    def matrices(self, speed, time):
        """F (size, size) and B (size,) over a time (s): F = e^(A t), B = int e^(A s) ds b."""
        a, inputs = self.model.continuous(speed)
        n, size = self.n, self.size
        block = np.zeros((size + 1, size + 1))
        block[:n, :n], block[:n, n : n + 2], block[:n, size] = a, inputs[:, 1:3], inputs[:, 0]
        exponential = expm(block * time)
        return exponential[:size, :size], exponential[:size, size]

    def begin(self, measured, command):
        """z and P from the first sample."""
        settings, offset = self.own, self.own.noise.yaw_rate_offset
        side, turn = settings.spread
        initial = {
            name: measured[SENSORS.index(name)]
            for name in ("vy", "yaw", "yaw_rate", "y")
            if math.isfinite(self.variances[name]) and math.isfinite(measured[SENSORS.index(name)])
        }
        variances = dict.fromkeys(self.model.states, UNKNOWN_VARIANCE) | {
            name: self.variances[name] for name in initial
        }
        variances |= {"wheel_angle": settings.drifts.wheel_angle**2 * self.model.period, "offset": offset**2}
        variances |= {"side": side**2, "turn": turn**2, "yaw_rate": variances["yaw_rate"] + offset**2}
        self.z, self.P = self.row(**initial, wheel_angle=command), np.diag(self.row(**variances))
        self.past = self.z.copy(), self.P.copy()
        self.sent, self.turned = [command] * (self.whole + self.late + 2), [0.0] * (self.late + 1)
        self.samples, self.earlier = [{} for _ in self.turned], [0.0 for _ in self.turned]
        self.advances = [0.0 for _ in self.turned]
        self.last = dict(zip(SENSORS, measured, strict=False))
        self.offsets, self.disagreement = dict.fromkeys(SENSORS, 0.0), dict.fromkeys(SENSORS, 0.0)
        self.left_out, self.steps, self.blind, self.far = None, 0, 0, 0

    def is_far_off(self, measured):
        """Whether position or heading have been elsewhere for so long that bounded innovations would not help."""
        y, yaw = measured[SENSORS.index("y")], measured[SENSORS.index("yaw")]
        if self.z is not None and math.isfinite(y) and math.isfinite(yaw):
            is_far = abs(y - self.z[self.n - 1]) > MAX_OUTLIER_DISTANCE or abs(yaw - self.z[1]) > MAX_OUTLIER_TURN
            self.far = self.far + 1 if is_far else 0
        return self.far >= RESTART_OUTLIERS

    def sort_in(self, measured):
        """Give each sample to the instant at which it was taken: value, and how much earlier (s) than that."""
        *values, pose_age, motion_age, turned = measured
        self.samples, self.earlier = [{}, *self.samples[:-1]], [0.0, *self.earlier[:-1]]
        self.turned, self.advances = [turned, *self.turned[:-1]], [0.0, *self.advances[:-1]]
        self.blind += 1
        motion_periods = (motion_age if math.isfinite(motion_age) else 0.0) / self.model.period
        self.arrival = max(math.floor(motion_periods + 1e-9), 0)
        for name, value, least in zip(SENSORS, values, LEAST_NOISE, strict=True):
            variance, age = self.variances[name], pose_age if name in POSE else motion_age
            age = age if math.isfinite(age) else 0.0
            moved = name in POSE and turned != 0.0
            repeated = value == self.last[name] and variance > least**2 and not moved
            self.last[name] = value
            instant = math.floor(age / self.model.period + 0.5) if name in POSE else self.arrival
            if not (math.isfinite(value) and math.isfinite(variance) and 0 <= instant <= self.late):
                continue
            if not repeated:
                self.samples[instant][name] = value
                if name in POSE:
                    self.earlier[instant] = age - instant * self.model.period
                else:
                    self.advances[instant] = age - instant * self.model.period
            agrees = abs(value - self.z[self.n - 1]) <= self.own.bound * math.sqrt(variance)
            if name == "y" and (agrees or not repeated):
                self.blind = 0

    def predict(self, speed, instant=0):
        """z = F z + B u over both parts of the period, each with the command that acts; P = F P F' + Q."""
        period, drifts, vehicle = self.model.period, self.own.drifts, self.model.vehicle
        older, newer = self.sent[self.whole + instant + 1], self.sent[self.whole + instant]
        saturation = self.row(side=self.saturation(speed, instant))
        f, b = self.matrices(speed, self.share * period)
        self.z = f @ (self.z + saturation) + b * older
        f, b = self.matrices(speed, (1.0 - self.share) * period)
        self.z = f @ self.z + b * newer - saturation
        turned = self.turned[instant]  # heading and offset count from the path, which turns evenly
        self.z -= self.row(yaw=turned, y=0.5 * speed * period * turned)
        f, _ = self.matrices(speed, period)
        forces, errors = self.forces(speed, newer), self.sliding(speed, newer)
        self.P = f @ self.P @ f.T + self.Q + period * errors
        self.spare = max(drifts.least_spare, drifts.grip - abs(forces.sum()) / vehicle.mass)
        self.felt_error = errors[0, 0] / (2.0 * drifts.sliding_time)

    def saturation(self, speed, instant=0):
        """m/s^2, what tyres pull less in a bend than linear ones at the same slip, by the Magic Formula with E = 0:

        an axle that pulls the share f of mu F_z slides under the angle at which a linear tyre would pull
        mu F_z C tan(asin(f)/C).
        """
        turn, most = speed * self.turned[instant] / self.model.period, self.own.friction * GRAVITY
        share, shape = min(abs(turn) / most, MOST_SHARE), self.own.shape_factor
        return -math.copysign(most * (shape * math.tan(math.asin(share) / shape) - share), turn)

    def forces(self, speed, command):
        """(2,) N, of the axles in the model."""
        v, speed, z = self.model.vehicle, max(speed, MIN_SLIP_SPEED), dict(zip(self.names, self.z, strict=True))
        vy, r = z["vy"], z["yaw_rate"]
        slips = np.array([z.get("wheel_angle", command) - (vy + v.lf * r) / speed, -(vy - v.lr * r) / speed])
        return 2.0 * np.array([v.stiffness_front, v.stiffness_rear]) * slips

    def sliding(self, speed, command):
        """(size, size) what a second adds to P for the sliding of the tyres, F^2/F_z of each axle's force."""
        v = self.model.vehicle
        loads = v.mass * GRAVITY / (v.lf + v.lr) * np.array([v.lr, v.lf])
        slid = np.minimum(np.abs(self.forces(speed, command)), loads) ** 2 / loads
        front = self.row(vy=1.0 / v.mass, yaw_rate=v.lf / v.yaw_inertia)
        rear = self.row(vy=1.0 / v.mass, yaw_rate=-v.lr / v.yaw_inertia)
        by_force = self.own.drifts.sliding * np.column_stack([front, rear]) * slid
        return by_force @ by_force.T

    def reading(self, name, instant, tau, speed):
        """h (size,) of a sensor tau (s) before an instant, so many ago, and what it reads beside h z."""
        turning = self.turned[instant] / self.model.period
        if name == "lateral_acceleration":
            a, inputs = self.model.continuous(speed)
            slope = dict(zip(self.model.states, a[0], strict=True))
            h = self.row(**{**slope, "yaw_rate": slope["yaw_rate"] + speed}, side=1.0)
            return h, inputs[0, 0] * self.sent[self.whole + instant] + self.saturation(speed, instant)
        if name == "yaw":
            return self.row(yaw=1.0, yaw_rate=-tau), tau * turning
        if name == "y":
            h = self.row(y=1.0, vy=-tau, yaw=-tau * speed, yaw_rate=0.5 * tau**2 * speed)
            return h, -0.5 * tau**2 * speed * turning
        return self.row(**{name: 1.0}, offset=float(name == "yaw_rate")), 0.0

    def correct(self, h, value, variance):
        """z += K nu, P = (I - K h') P (I - K h')' + K R K', K = P h/(h' P h + R); nu bounded."""
        scatter = h @ self.P @ h + variance
        gain, reach = self.P @ h / scatter, self.own.bound * math.sqrt(scatter)
        innovation = np.clip(value - h @ self.z, -reach, reach)
        left = np.eye(self.size) - np.outer(gain, h)
        self.z = self.z + gain * innovation
        self.P = left @ self.P @ left.T + variance * np.outer(gain, gain)
        return float(innovation)

    def take_in(self, instant, speed):
        """The samples of an instant, so many periods ago; the latest move the offsets of their sensors."""
        for name in SENSORS:
            if name not in self.samples[instant] or (name == "wheel_angle" and name not in self.names):
                continue
            h, noise = self.reading(name, instant, self.earlier[instant], speed)
            value = self.samples[instant][name] - noise - self.offsets[name]
            if name not in POSE:
                value += self.advances[instant] / self.model.period * (h @ self.change)
            variance = self.variances[name]
            if name == "lateral_acceleration":
                variance = variance * (1.0 + self.arrival) ** 2 + self.felt_error
            if instant == self.late:  # every sample once
                self.judge(name, (value - h @ self.z) ** 2 / (h @ self.P @ h + variance))
            if name == self.left_out:
                continue
            innovation = self.correct(h, value, variance)
            if instant == self.arrival and name in ("lateral_acceleration", "wheel_angle"):
                self.offsets[name] += min(1.0, self.model.period / self.own.settling) * innovation

    def judge(self, name, innovations):
        """Average the squared innovation of a sensor over its variance."""
        share = min(1.0, self.model.period / self.own.window[name == self.left_out])
        self.disagreement[name] += share * (min(innovations, 2.0 * self.own.bound**2) - self.disagreement[name])

    def choose_left_out(self):
        """The redundant sensor that disagrees the most, beyond the bound, until it agrees again.

        Where the model is wrong the gyro disagrees at least as much; where the gyro is, the heading disagrees with it.
        A sensor without noise of its own is never left out: it is the model that is wrong.
        """
        if self.left_out is not None:
            self.left_out = None if self.disagreement[self.left_out] < self.own.trust else self.left_out
            return
        disagreeing = {
            name: value for name, value in self.disagreement.items() if value >= self.disagreement["yaw_rate"]
        }
        disagreeing["yaw_rate"] = self.disagreement["yaw"]
        noisy = {name for name, least in zip(SENSORS, LEAST_NOISE, strict=True) if self.variances[name] > least**2}
        disagreeing = {name: disagreeing.get(name, 0.0) for name in SENSORS if name in noisy and name not in POSE}
        worst = max(disagreeing, key=disagreeing.get, default=None)
        self.left_out = worst if worst and disagreeing[worst] > self.own.distrust else None

    def go_on(self, speed):
        """From z of `late` periods before the last instant to the present one, with all samples since then."""
        if self.late:
            self.z, self.P = self.past
        for instant in range(min(self.late, self.steps - 1), -1, -1):
            before = self.z.copy()
            self.predict(speed, instant)
            self.change = self.z - before
            self.take_in(instant, speed)
            self.z = self.z.copy()  # a push is no larger than what the tyres can still answer
            self.z[self.n : self.n + 2] *= self.spare / max(abs(self.z[self.n]), self.spare)
            if instant == self.late:
                self.past = self.z, self.P
        self.choose_left_out()

    def ahead(self, speed):
        """z at the time when the next command begins to act, through the commands already sent."""
        z, period = self.z + self.row(side=self.saturation(speed)), self.model.period
        for time, command in [(self.share * period, self.sent[self.whole])] + [
            (period, self.sent[j]) for j in range(self.whole - 1, -1, -1)
        ]:
            f, b = self.matrices(speed, time)
            z = f @ z + b * command
        return z

    def step(self, speed, measured, command):
        """One control instant; command: the one given a period ago (rad)."""
        sample = np.append(np.full(len(SENSORS) + 2, math.nan), 0.0)
        sample[: len(measured)] = measured
        if self.is_far_off(sample):
            self.z = None
        if self.z is None:
            self.begin(sample, command)
        else:
            self.sent = [command, *self.sent[:-1]]
            self.sort_in(sample)
            self.go_on(speed)
        self.steps += 1
        f, _ = self.matrices(speed, self.model.period)
        is_known = self.blind <= self.own.patience / self.model.period
        pushes = (self.z + self.row(side=self.saturation(speed)))[self.n : self.n + 2]
        x = self.ahead(speed)[: self.n] if is_known else np.full(self.n, math.nan)
        return x, f[: self.n, self.n : self.n + 2] @ pushes
