"""The Kalman filter of the MPC: state, disturbances and dead time of the path model from noisy, patchy measurements.

`KalmanFilter` is what a controller is given; it runs compiled (`kernels.estimators.kalman`). `ReadableFilter` is the
same filter in NumPy, one equation per method; a test demands that both agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import expm

from adaptrack.errors import InvalidInput, real
from adaptrack.estimation import Estimator
from adaptrack.models import MEASURED, PathModel, PredictionModel
from adaptrack.profile import Profile
from adaptrack.vehicle import GRAVITY, Vehicle

Array = NDArray[np.float64]

LEAST_NOISE = (0.005, 0.0002, 0.001, 0.002, 0.0005)
"""Of vy, yaw, yaw_rate, y, wheel_angle: with better sensors than these the model's own errors limit the filter."""


@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of what is measured; infinity: there is no such sensor.

    The defaults are those of the profile ``road``.
    """

    vy: float = 0.05
    """m/s"""
    yaw: float = 0.003
    """rad"""
    yaw_rate: float = 0.01
    """rad/s"""
    y: float = 0.03
    """m"""
    wheel_angle: float = math.inf
    """rad"""

    def __post_init__(self) -> None:
        for each in fields(self):
            if not real("SensorNoise", each.name, getattr(self, each.name)) >= 0.0:
                raise InvalidInput(f"SensorNoise: {each.name} must not be negative; inf: no such sensor.")
        if math.isinf(self.y):
            raise InvalidInput("SensorNoise: y = inf: without a measured lateral position there is no path tracking.")


@dataclass(frozen=True)
class Drifts:
    """How fast what the filter estimates may change beside the model: standard deviations after one second.

    They are random walks: after t seconds the deviation is sqrt(t) times that.
    """

    vy: float = 0.015
    """m/s"""
    yaw: float = 0.001
    """rad"""
    yaw_rate: float = 0.007
    """rad/s"""
    y: float = 0.01
    """m"""
    wheel_angle: float = 0.01
    """rad"""
    side: float = 0.02
    """m/s^2, of the lateral disturbance d_y: side wind, bank, a steering bias"""
    turn: float = 0.035
    """rad/s^2, of the yaw disturbance d_r"""
    wind: float = 0.3
    """m/s^2, of what side wind adds to d_y; it adds to d_r as well, in the proportion of the car's body"""
    sliding: float = 0.2
    """s^0.5, of the force of an axle: its impulse deviates by `sliding` F^2/F_z after a second, F being its force in
    the model and F_z its load. In the brush model of a tyre F^2/(3 mu F_z) is lost to sliding (Pacejka, Tire and
    Vehicle Dynamics, 3rd ed., section 3.2), and mu is not known."""

    def __post_init__(self) -> None:
        for each in fields(self):
            if not 0.0 <= real("Drifts", each.name, getattr(self, each.name)) < math.inf:
                raise InvalidInput(f"Drifts: {each.name} must not be negative, and finite.")


@final
@dataclass(frozen=True)
class KalmanFilter(Estimator):
    """State and disturbances of a `PathModel`, carried over its dead time with the commands already sent.

    noise: of the sensors; drifts: of what is estimated; bound: an innovation counts up to so many of its own standard
    deviations, so that an outlier moves the estimate by no more; spread: standard deviations of d_y (m/s^2) and d_r
    (rad/s^2) before the first sample.

    Raises
    ------
    InvalidInput
        When a number is not allowed.
    """

    noise: SensorNoise = SensorNoise()
    drifts: Drifts = Drifts()
    bound: float = 5.0
    spread: tuple[float, float] = (0.3, 0.3)
    name = "kalman"

    def __post_init__(self) -> None:
        if not real("KalmanFilter", "bound", self.bound) > 0.0:
            raise InvalidInput(f"KalmanFilter: bound = {self.bound!r}: must be positive; inf: no bound.")
        if not all(0.0 <= real("KalmanFilter", "spread", each) < math.inf for each in self.spread):
            raise InvalidInput(f"KalmanFilter: spread = {self.spread!r}: must not be negative, and finite.")

    @classmethod
    def of_profile(cls, profile: Profile, drifts: Drifts | None = None) -> KalmanFilter:
        """For the sensors of a profile."""
        vy, yaw, yaw_rate, y = profile.noise
        return cls(SensorNoise(vy, yaw, yaw_rate, y), drifts or Drifts())

    @property
    def function(self) -> Any:
        from adaptrack.kernels.estimators.kalman import kalman

        return kalman

    def check_fits(self, model: PredictionModel) -> None:
        if not isinstance(model, PathModel):
            raise InvalidInput(f"estimator 'kalman': needs the path model, and model {model.name!r} is another one.")

    def memory_size(self, model: PredictionModel) -> int:
        from adaptrack.kernels.estimators.kalman import memory_size

        return int(memory_size(_periods(model)[0]))

    def variances(self) -> Array:
        """(5,) of what the sensors of `MEASURED` give; inf: none."""
        noise = [getattr(self.noise, name) for name in MEASURED]
        return np.maximum(noise, LEAST_NOISE) ** 2

    def disturbance_drift(self, model: PathModel) -> Array:
        """(2, 2) variances and covariance that a second adds to d_y and d_r."""
        side_wind = self.drifts.wind * np.array([1.0, wind_turn(model.vehicle)])
        return np.diag([self.drifts.side**2, self.drifts.turn**2]) + np.outer(side_wind, side_wind)

    def parameters(self, model: PredictionModel) -> Array:
        whole, share = _periods(model)
        assert isinstance(model, PathModel)
        drifts = [getattr(self.drifts, name) ** 2 * model.period for name in MEASURED]
        together = self.disturbance_drift(model) * model.period
        drifts += [together[0, 0], together[1, 1], together[0, 1]]
        spread = [each**2 for each in self.spread]
        spread.append(self.drifts.sliding)
        own = [model.period, whole, share, self.bound, *self.variances(), *drifts, *spread]
        return np.concatenate([own, model.parameters()])


def wind_turn(vehicle: Vehicle) -> float:
    """d_r over d_y (1/m) of side wind: L C_ym m/(C_s I_z), 0 for a body that feels none."""
    if vehicle.side_force_slope == 0.0:
        return 0.0
    arm = (vehicle.lf + vehicle.lr) * vehicle.yaw_moment_slope / vehicle.side_force_slope
    return arm * vehicle.mass / vehicle.yaw_inertia


def _periods(model: PredictionModel) -> tuple[int, float]:
    """The dead time of a model in periods: whole ones and the share of one more."""
    periods = model.dead_time / model.period
    whole = math.floor(periods + 1e-9)
    share = periods - whole
    return whole, share if share > 1e-9 else 0.0


class ReadableFilter:
    """`KalmanFilter` in NumPy, for reading and testing: ``step(speed, measured, command)`` gives (x, d).

    z = [x, d_y, d_r]; F = [[A, G], [0, I]] over a period.
    """

    def __init__(self, estimator: KalmanFilter, model: PathModel) -> None:
        self.own, self.model, self.n = estimator, model, model.n
        self.whole, self.share = _periods(model)
        self.Q = np.zeros((model.n + 2, model.n + 2))  # covariance that a period adds
        self.Q[: model.n, : model.n] = np.diag([getattr(estimator.drifts, name) ** 2 for name in model.states])
        self.Q[model.n :, model.n :] = estimator.disturbance_drift(model)
        self.Q *= model.period
        self.z: Array | None = None

    def matrices(self, speed: float, time: float) -> tuple[Array, Array]:
        """F (n+2, n+2) and B (n+2,) over a time (s), by one matrix exponential."""
        a, inputs = self.model.continuous(speed)
        n = self.n
        block = np.zeros((n + 3, n + 3))
        block[:n, :n], block[:n, n : n + 2], block[:n, n + 2] = a, inputs[:, 1:3], inputs[:, 0]
        whole = expm(block * time)
        return whole[: n + 2, : n + 2], whole[: n + 2, n + 2]

    def begin(self, measured: Array, command: float) -> None:
        """z and its covariance from the first sample."""
        from adaptrack.kernels.estimators.kalman import UNKNOWN

        self.sent = [command] * (self.whole + 2)
        self.z, variance = np.zeros(self.n + 2), np.full(self.n + 2, UNKNOWN)
        if "wheel_angle" in self.model.states:
            self.z[3], variance[3] = command, self.Q[3, 3]
        for i, value, noise in self.sensors(measured):
            self.z[i], variance[i] = value, noise
        variance[self.n :] = np.square(self.own.spread)
        self.P = np.diag(variance)

    def predict(self, speed: float) -> None:
        """z(k) = F z(k-1) + B u, where in a period first the older, then the newer command acts; P = F P F' + Q."""
        period, old, new = self.model.period, self.sent[self.whole + 1], self.sent[self.whole]
        assert self.z is not None
        for time, command in ((self.share * period, old), ((1.0 - self.share) * period, new)):
            f, b = self.matrices(speed, time)
            self.z = f @ self.z + b * command
        f, _ = self.matrices(speed, period)
        self.P = f @ self.P @ f.T + self.Q + self.sliding(speed, new)

    def axles(self, speed: float, command: float) -> list[tuple[float, float, float]]:
        """Slip angle (rad) of either axle at the state, its stiffness (N/rad) and its load (N)."""
        from adaptrack.kernels.estimators.kalman import SLOWEST

        assert self.z is not None
        car, pace = self.model.vehicle, max(speed, SLOWEST)
        vy, yaw_rate = self.z[0], self.z[2]
        angle = self.z[3] if "wheel_angle" in self.model.states else command
        weight = car.mass * GRAVITY / (car.lf + car.lr)
        return [
            (angle - (vy + car.lf * yaw_rate) / pace, 2.0 * car.stiffness_front, weight * car.lr),
            (-(vy - car.lr * yaw_rate) / pace, 2.0 * car.stiffness_rear, weight * car.lf),
        ]

    def sliding(self, speed: float, command: float) -> Array:
        """(n+2, n+2) what a period adds for the sliding of the tyres: (sliding F^2/F_z)^2 T on the impulse of an axle."""
        car, found = self.model.vehicle, np.zeros_like(self.Q)
        for (slip, stiffness, load), arm in zip(self.axles(speed, command), (car.lf, -car.lr), strict=True):
            force = min(stiffness * abs(slip), load)
            of_impulse = np.zeros(self.n + 2)
            of_impulse[[0, 2]] = 1.0 / car.mass, arm / car.yaw_inertia
            variance = (self.own.drifts.sliding * force**2 / load) ** 2 * self.model.period
            found += variance * np.outer(of_impulse, of_impulse)
        return found

    def sensors(self, measured: Array) -> list[tuple[int, float, float]]:
        """State, value and variance of every sensor that gave a sample."""
        found = []
        for place, (name, variance) in enumerate(zip(MEASURED, self.own.variances(), strict=True)):
            if name in self.model.states and math.isfinite(variance) and math.isfinite(measured[place]):
                found.append((self.model.states.index(name), float(measured[place]), float(variance)))
        return found

    def correct(self, i: int, value: float, variance: float) -> None:
        """z += K nu, P -= K P_i with K = P_i/(P_ii + R): one sensor of state i, its innovation nu bounded."""
        assert self.z is not None
        scatter = self.P[i, i] + variance
        reach = self.own.bound * math.sqrt(scatter)
        innovation = float(np.clip(value - self.z[i], -reach, reach))
        gain = self.P[i] / scatter
        self.z, self.P = self.z + gain * innovation, self.P - np.outer(gain, self.P[i])

    def ahead(self, speed: float) -> Array:
        """z at the time when the next command begins to act, through the commands already sent."""
        assert self.z is not None
        z, period = self.z, self.model.period
        for time, command in [(self.share * period, self.sent[self.whole])] + [
            (period, self.sent[j]) for j in range(self.whole - 1, -1, -1)
        ]:
            f, b = self.matrices(speed, time)
            z = f @ z + b * command
        return z

    def step(self, speed: float, measured: ArrayLike, command: float) -> tuple[Array, Array]:
        """One control instant; command: the one given a period ago (rad)."""
        seen = np.asarray(measured, dtype=float)
        if self.z is None:
            self.begin(seen, command)
        else:
            self.sent = [command, *self.sent[:-1]]
            self.predict(speed)
        for sensor in self.sensors(seen):
            self.correct(*sensor)
        assert self.z is not None
        f, _ = self.matrices(speed, self.model.period)
        return self.ahead(speed)[: self.n], f[: self.n, self.n :] @ self.z[self.n :]
