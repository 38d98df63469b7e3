"""The Kalman filter of the MPC: state, disturbances and dead time of the path model from noisy, patchy measurements.

`KalmanFilter` is what a controller is given; it runs compiled (`core.estimators.kalman`). `ReadableFilter` is the
same filter in NumPy, one equation per method; a test demands that both agree.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, final

import numpy as np
import scipy  # loads its parts when they are first used
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput, real
from adaptrack.estimation import Estimator
from adaptrack.models import MEASURED, PathModel, PredictionModel
from adaptrack.profile import Profile
from adaptrack.vehicle import GRAVITY, Vehicle, in_periods

Array = NDArray[np.float64]

SENSORS = (*MEASURED, "lateral_acceleration")
"""What the filter takes in."""


OLDEST = 2.0
"""s, of a sample that is still taken in."""
LONGEST = 5.0
"""s, of a dead time that may be learned."""


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
    lateral_acceleration: float = math.inf
    """m/s^2, of an accelerometer at the centre of gravity"""
    yaw_rate_offset: float = 0.0
    """rad/s, of an error of the yaw rate that stays; 0: there is none to be estimated"""

    def __post_init__(self) -> None:
        for each in fields(self):
            if not real("SensorNoise", each.name, getattr(self, each.name)) >= 0.0:
                raise InvalidInput(f"SensorNoise: {each.name} must not be negative; inf: no such sensor.")
        if math.isinf(self.y):
            raise InvalidInput("SensorNoise: y = inf: without a measured lateral position there is no path tracking.")


@dataclass(frozen=True)
class Drifts:
    """How fast what the filter estimates may change beside the model: standard deviations after one second.

    They are random walks: after t seconds the deviation is sqrt(t) times that. Behind them stands what is known of the
    tyres, which says how much of what the model cannot explain is a disturbance.
    """

    vy: float = 0.03
    """m/s"""
    yaw: float = 0.001
    """rad"""
    yaw_rate: float = 0.015
    """rad/s"""
    y: float = 0.01
    """m"""
    wheel_angle: float = 0.01
    """rad"""
    side: float = 0.03
    """m/s^2, of the lateral disturbance d_y: side wind, bank, a steering bias"""
    turn: float = 0.05
    """rad/s^2, of the yaw disturbance d_r"""
    wind: float = 0.35
    """m/s^2, of what side wind adds to d_y; it adds to d_r as well, in the proportion of the car's body"""
    yaw_rate_offset: float = 0.0002
    """rad/s, of the yaw-rate sensor's offset"""
    sliding: float = 0.2
    """s^0.5, of the force of an axle: its impulse deviates by `sliding` F^2/F_z after a second, F being its force in
    the model and F_z its load. In the brush model of a tyre F^2/(3 mu F_z) is lost to sliding (Pacejka, Tire and
    Vehicle Dynamics, 3rd ed., section 3.2), and mu is not known."""
    sliding_time: float = 0.3
    """s, how long such a deviation lasts: by it an accelerometer is off by sliding F^2/F_z/(m sqrt(2 sliding_time))"""
    grip: float = 7.0
    """m/s^2, what the tyres can pull at most: a disturbance is no larger than that less what they pull in the model,"""
    least_spare: float = 0.5
    """m/s^2, but may always be this large"""

    def __post_init__(self) -> None:
        for each in fields(self):
            if not 0.0 <= real("Drifts", each.name, getattr(self, each.name)) < math.inf:
                raise InvalidInput(f"Drifts: {each.name} must not be negative, and finite.")
        for name in ("sliding_time", "least_spare"):
            if not getattr(self, name) > 0.0:
                raise InvalidInput(f"Drifts: {name} = {getattr(self, name)!r}: must be positive.")


@final
@dataclass(frozen=True)
class KalmanFilter(Estimator):
    """State and disturbances of a `PathModel`, carried over its dead time with the commands already sent.

    noise: of the sensors; drifts: of what is estimated; bound: an innovation counts up to so many of its own standard
    deviations, so that an outlier moves the estimate by no more; spread: standard deviations of d_y (m/s^2) and d_r
    (rad/s^2) before the first sample; oldest: samples up to this age (s) are taken in where they belong, older ones
    left out; patience: how long the estimate goes on by the model without a measured position (s), before the
    controller holds; settling: time (s) over which the offsets of accelerometer and wheel-angle sensor are averaged.

    distrust: a sensor other than the pose is left out when the mean of its squared innovations over their variance, 1
    for a filter that is right, exceeds that; inf: never; trust: it is taken in again below that; window: times (s) over
    which that mean is taken, of a sensor that is taken in and of one that is left out.

    friction, shape: coefficient, and shape factor C of the Magic Formula, of tyres as they are thought to be: in the
    bends of a road they pull less than the model's linear ones, which is known beforehand. Passenger-car tyres have C
    near 1.3 (Pacejka, Tire and Vehicle Dynamics, 3rd ed., section 4.3). longest: dead time (s) that the model may be
    told to have while driving.

    Raises
    ------
    InvalidInput
        When a number is not allowed.
    """

    noise: SensorNoise = SensorNoise()
    drifts: Drifts = Drifts()
    bound: float = 5.0
    spread: tuple[float, float] = (0.3, 0.3)
    oldest: float = 0.0
    patience: float = 3.0
    settling: float = 10.0
    distrust: float = 10.0
    trust: float = 2.0
    window: tuple[float, float] = (0.5, 5.0)
    friction: float = 0.9
    shape: float = 1.3
    longest: float = 0.0
    name = "kalman"

    def __post_init__(self) -> None:
        if not real("KalmanFilter", "bound", self.bound) > 0.0:
            raise InvalidInput(f"KalmanFilter: bound = {self.bound!r}: must be positive; inf: no bound.")
        if not all(0.0 <= real("KalmanFilter", "spread", each) < math.inf for each in self.spread):
            raise InvalidInput(f"KalmanFilter: spread = {self.spread!r}: must not be negative, and finite.")
        if not 0.0 <= real("KalmanFilter", "oldest", self.oldest) <= OLDEST:
            raise InvalidInput(f"KalmanFilter: oldest = {self.oldest!r} s: must be within 0 .. {OLDEST:g}.")
        if not real("KalmanFilter", "patience", self.patience) >= 0.0:
            raise InvalidInput(f"KalmanFilter: patience = {self.patience!r} s: must not be negative; inf: for ever.")
        if not real("KalmanFilter", "settling", self.settling) > 0.0:
            raise InvalidInput(f"KalmanFilter: settling = {self.settling!r} s: must be positive; inf: no averaging.")
        if not 0.0 < real("KalmanFilter", "trust", self.trust) <= real("KalmanFilter", "distrust", self.distrust):
            raise InvalidInput(
                f"KalmanFilter: trust = {self.trust!r}, distrust = {self.distrust!r}: trust must be positive, distrust "
                "no less; distrust = inf: no sensor is left out."
            )
        if not 0.0 < real("KalmanFilter", "friction", self.friction) < math.inf:
            raise InvalidInput(f"KalmanFilter: friction = {self.friction!r}: must be positive.")
        if not 1.0 < real("KalmanFilter", "shape", self.shape) < 2.0:
            raise InvalidInput(f"KalmanFilter: shape = {self.shape!r}: must be between 1 and 2.")
        if not 0.0 <= real("KalmanFilter", "longest", self.longest) <= LONGEST:
            raise InvalidInput(f"KalmanFilter: longest = {self.longest!r} s: must be within 0 .. {LONGEST:g}.")
        if not all(0.0 < real("KalmanFilter", "window", each) < math.inf for each in self.window):
            raise InvalidInput(f"KalmanFilter: window = {self.window!r} s: must be positive and finite.")

    @classmethod
    def of_profile(cls, profile: Profile, drifts: Drifts | None = None) -> KalmanFilter:
        """For the sensors of a profile."""
        names = [each.name for each in fields(SensorNoise) if each.name != "yaw_rate_offset"]
        noise = {name: getattr(profile, f"noise_{name}") for name in names}
        if profile.bias_wheel_angle > 0.0 or profile.noise_wheel_angle == 0.0:
            noise["wheel_angle"] = math.inf  # the model knows the angle better than a sensor that is off, or as well
        offset = profile.bias_yaw_rate / math.sqrt(3.0)  # standard deviation of a uniform error
        return cls(SensorNoise(**noise, yaw_rate_offset=offset), drifts or Drifts(), oldest=profile.oldest)

    @property
    def function(self) -> Any:
        from adaptrack.core.estimators.kalman import kalman

        return kalman

    def check_fits(self, model: PredictionModel) -> None:
        if not isinstance(model, PathModel):
            raise InvalidInput(f"estimator 'kalman': needs the path model, and model {model.name!r} is another one.")

    def memory_size(self, model: PredictionModel) -> int:
        from adaptrack.core.estimators.kalman import memory_size

        return int(memory_size(self._longest(model), self.late(model)))

    def change_path(self, model: PredictionModel, memory: Array, heading: float, offset: float) -> None:
        from adaptrack.core.estimators.kalman import move_path

        move_path(memory, model.n, self.late(model), heading, offset)

    def left_out(self, memory: Array) -> str | None:
        from adaptrack.core.estimators.kalman import LEFT_OUT

        out = int(memory[LEFT_OUT])
        return SENSORS[out - 1] if out else None

    def _longest(self, model: PredictionModel) -> int:
        """Whole periods of the longest dead time."""
        return max(_periods(model)[0], in_periods(self.longest, model.period)[0])

    def late(self, model: PredictionModel) -> int:
        """Periods that are gone through anew at every step, for the samples that come late."""
        return math.floor(self.oldest / model.period + 0.5)

    def variances(self) -> Array:
        """(6,) of what `SENSORS` give; inf: none."""
        from adaptrack.core.estimators.kalman import LEAST_NOISE

        noise = [getattr(self.noise, name) for name in SENSORS]
        return np.maximum(noise, LEAST_NOISE) ** 2

    def shares(self, period: float) -> tuple[float, float]:
        """By which the mean of the squared innovations moves with a sample that is taken in, and with one left out."""
        taken_in, left_out = self.window
        return min(1.0, period / taken_in), min(1.0, period / left_out)

    def disturbance_drift(self, model: PathModel) -> Array:
        """(2, 2) variances and covariance that a second adds to d_y and d_r."""
        side_wind = self.drifts.wind * np.array([1.0, wind_turn(model.vehicle)])
        return np.diag([self.drifts.side**2, self.drifts.turn**2]) + np.outer(side_wind, side_wind)

    @property
    def tyres(self) -> tuple[float, float]:
        return self.friction, self.shape

    def parameters(self, model: PredictionModel) -> Array:
        whole, share = _periods(model)
        assert isinstance(model, PathModel)
        drifts = [getattr(self.drifts, name) ** 2 * model.period for name in MEASURED]
        together = self.disturbance_drift(model) * model.period
        drifts += [together[0, 0], together[1, 1], together[0, 1]]
        drifts += [self.drifts.yaw_rate_offset**2 * model.period, self.drifts.sliding**2]
        drifts += [self.drifts.sliding_time, self.drifts.grip, self.drifts.least_spare]
        spread = [each**2 for each in (*self.spread, self.noise.yaw_rate_offset)]
        own = [model.period, whole, share, self._longest(model), self.late(model), 0.0, self.bound]
        own += [self.patience / model.period]
        own += [self.distrust, self.trust, *self.shares(model.period)]
        spread = [self.friction, self.shape, *spread]
        own += [min(1.0, model.period / self.settling), *self.variances(), *drifts, *spread]
        return np.concatenate([own, model.parameters()])


def wind_turn(vehicle: Vehicle) -> float:
    """d_r over d_y (1/m) of side wind: L C_ym m/(C_s I_z), 0 for a body that feels none."""
    if vehicle.side_force_slope == 0.0:
        return 0.0
    arm = (vehicle.lf + vehicle.lr) * vehicle.yaw_moment_slope / vehicle.side_force_slope
    return arm * vehicle.mass / vehicle.yaw_inertia


def _periods(model: PredictionModel) -> tuple[int, float]:
    """The dead time of a model in periods: whole ones and the share of one more."""
    return in_periods(model.dead_time, model.period)


class ReadableFilter:
    """`KalmanFilter` in NumPy, for reading and testing: ``step(speed, measured, command)`` gives (x, d).

    z = [x, d_y, d_r] and, where it is estimated, the yaw-rate sensor's offset; F = [[A, G], [0, I]] over a period.
    """

    def __init__(self, estimator: KalmanFilter, model: PathModel) -> None:
        self.own, self.model, self.n = estimator, model, model.n
        self.whole, self.share = _periods(model)
        self.late = estimator.late(model)
        self.offset_known = estimator.noise.yaw_rate_offset == 0.0
        self.size = model.n + 2 + (not self.offset_known)
        self.Q = np.zeros((self.size, self.size))  # covariance that a period adds
        self.Q[: model.n, : model.n] = np.diag([getattr(estimator.drifts, name) ** 2 for name in model.states])
        self.Q[model.n : model.n + 2, model.n : model.n + 2] = estimator.disturbance_drift(model)
        if not self.offset_known:
            self.Q[-1, -1] = estimator.drifts.yaw_rate_offset**2
        self.Q *= model.period
        self.unit_side = np.eye(self.size)[model.n]
        self.turned = [0.0] * (self.late + 1)
        self.z: Array | None = None
        self.astray = 0

    def matrices(self, speed: float, time: float) -> tuple[Array, Array]:
        """F (size, size) and B (size,) over a time (s), by one matrix exponential."""
        a, inputs = self.model.continuous(speed)
        n, size = self.n, self.size
        block = np.zeros((size + 1, size + 1))
        block[:n, :n], block[:n, n : n + 2], block[:n, size] = a, inputs[:, 1:3], inputs[:, 0]
        whole = scipy.linalg.expm(block * time)
        return whole[:size, :size], whole[:size, size]

    def begin(self, measured: Array, command: float) -> None:
        """z and its covariance from the first sample."""
        from adaptrack.core.estimators.kalman import UNKNOWN

        n, own = self.n, self.own
        self.sent = [command] * (self.whole + self.late + 2)
        self.z, variance = np.zeros(self.size), np.full(self.size, UNKNOWN)
        for name, noise in zip(MEASURED, own.variances(), strict=False):
            if name in self.model.states and name != "wheel_angle":
                value = measured[MEASURED.index(name)]
                if math.isfinite(noise) and math.isfinite(value):
                    i = self.model.states.index(name)
                    self.z[i], variance[i] = value, noise
        if "wheel_angle" in self.model.states:
            self.z[3], variance[3] = command, self.Q[3, 3]
        variance[n:] = np.square([*own.spread, own.noise.yaw_rate_offset][: self.size - n])
        if not self.offset_known:
            variance[2] += own.noise.yaw_rate_offset**2
        self.P = np.diag(variance)
        self.past = self.z.copy(), self.P.copy()
        self.ring: list[dict[str, float]] = [{} for _ in range(self.late + 1)]
        self.turned = [0.0] * (self.late + 1)
        self.last, self.offsets = np.array(measured[: len(SENSORS)]), np.zeros(len(SENSORS))
        self.disagreement: dict[str, float] = dict.fromkeys(SENSORS, 0.0)
        self.left_out: str | None = None
        self.steps, self.blind, self.astray = 0, 0, 0

    def is_astray(self, measured: Array) -> bool:
        """Whether positions or headings have been elsewhere for so long that bounded innovations would not help."""
        from adaptrack.core.estimators.kalman import ASTRAY, FAR, FAR_TURNED

        y, yaw = measured[MEASURED.index("y")], measured[MEASURED.index("yaw")]
        if self.z is not None and math.isfinite(y) and math.isfinite(yaw):
            far = abs(y - self.z[self.n - 1]) > FAR or abs(yaw - self.z[1]) > FAR_TURNED
            self.astray = self.astray + 1 if far else 0
        return self.astray >= ASTRAY

    def sort_in(self, measured: Array) -> None:
        """Give each sample to the instant at which it was taken: value, and how much earlier (s) than that."""
        from adaptrack.core.estimators.kalman import LEAST_NOISE

        self.ring = [{}, *self.ring[:-1]]
        self.turned = [float(measured[-1]), *self.turned[:-1]]
        self.blind += 1
        pose_age, motion_age = (each if math.isfinite(each) else 0.0 for each in measured[len(SENSORS) : -1])
        for i, (name, variance) in enumerate(zip(SENSORS, self.own.variances(), strict=True)):
            value, age = float(measured[i]), pose_age if name in ("yaw", "y") else motion_age
            moved = name in ("yaw", "y") and self.turned[0] != 0.0
            repeated = value == self.last[i] and variance > LEAST_NOISE[i] ** 2 and not moved
            self.last[i] = value
            instants = math.floor(age / self.model.period + 0.5)
            if not (math.isfinite(value) and math.isfinite(variance) and 0 <= instants <= self.late):
                continue
            if not repeated:
                self.ring[instants][name] = value
                if name in ("yaw", "y"):
                    self.ring[instants]["tau"] = age - instants * self.model.period
            if name == "y" and (not repeated or self.agrees(value, variance)):
                self.blind = 0

    def agrees(self, value: float, variance: float) -> bool:
        """Whether a position is where the estimate is, by the noise of its sensor."""
        assert self.z is not None
        return bool(abs(value - self.z[self.n - 1]) <= self.own.bound * math.sqrt(variance))

    def predict(self, speed: float, instant: int = 0) -> None:
        """z(k) = F z(k-1) + B u, where in a period first the older, then the newer command acts; P = F P F' + Q."""
        period, tyres = self.model.period, self.own.drifts
        old, new = self.sent[self.whole + instant + 1], self.sent[self.whole + instant]
        assert self.z is not None
        lost = self.lost(speed, instant) * self.unit_side
        for time, command in ((self.share * period, old), ((1.0 - self.share) * period, new)):
            f, b = self.matrices(speed, time)
            self.z = f @ (self.z + lost) + b * command - lost
        self.z[1] -= self.turned[instant]  # heading and offset count from the path, which turns evenly
        self.z[self.n - 1] -= 0.5 * speed * period * self.turned[instant]
        f, _ = self.matrices(speed, period)
        self.P = f @ self.P @ f.T + self.Q
        places = np.ix_([0, 2], [0, 2])
        errors = self.sliding(speed, new)
        self.P[places] += period * errors
        front, rear = self.forces(speed, new)
        self.spare = max(tyres.least_spare, tyres.grip - abs(front + rear) / self.model.vehicle.mass)
        self.felt_error = errors[0, 0] / (2.0 * tyres.sliding_time)

    def lost(self, speed: float, instant: int = 0) -> float:
        """m/s^2, what tyres pull less in the bend of an instant than linear ones at the same slip: to the outside.

        By the Magic Formula with E = 0 an axle that pulls the share f of mu F_z slides under the angle at which a
        linear tyre would pull mu F_z C tan(asin(f)/C).
        """
        from adaptrack.core.models.path import MOST_SHARE

        turn, most = speed * self.turned[instant] / self.model.period, self.own.friction * GRAVITY
        share, shape = min(abs(turn) / most, MOST_SHARE), self.own.shape
        return -math.copysign(most * (shape * math.tan(math.asin(share) / shape) - share), turn)

    def forces(self, speed: float, command: float) -> Array:
        """(2,) N, of the axles in the model."""
        from adaptrack.core.models.path import SLOWEST

        assert self.z is not None
        v, pace = self.model.vehicle, max(speed, SLOWEST)
        angle = self.z[3] if "wheel_angle" in self.model.states else command
        slips = np.array([angle - (self.z[0] + v.lf * self.z[2]) / pace, -(self.z[0] - v.lr * self.z[2]) / pace])
        return 2.0 * np.array([v.stiffness_front, v.stiffness_rear]) * slips

    def sliding(self, speed: float, command: float) -> Array:
        """(2, 2) what a second adds to the variances of v_y and r for the sliding of the tyres."""
        v = self.model.vehicle
        weight = v.mass * GRAVITY / (v.lf + v.lr)
        loads = np.array([weight * v.lr, weight * v.lf])
        forces = np.minimum(np.abs(self.forces(speed, command)), loads)
        by_force = np.array([[1 / v.mass, 1 / v.mass], [v.lf / v.yaw_inertia, -v.lr / v.yaw_inertia]])
        return self.own.drifts.sliding**2 * by_force @ np.diag((forces**2 / loads) ** 2) @ by_force.T

    def reading(self, name: str, instant: int, tau: float, speed: float) -> tuple[Array, float]:
        """h (size,) of a sensor tau (s) before an instant, so many ago, and what it reads beside h z."""
        h, states = np.zeros(self.size), self.model.states
        if name == "lateral_acceleration":
            a, inputs = self.model.continuous(speed)
            h[: self.n] = a[0]
            h[2] += speed
            h[self.n] = 1.0
            return h, float(inputs[0, 0]) * self.sent[self.whole + instant] + self.lost(speed, instant)
        h[states.index(name)] = 1.0
        turning = self.turned[instant] / self.model.period
        if name == "yaw":
            h[2] = -tau
            return h, tau * turning
        if name == "y":
            h[:3] = -tau, -tau * speed, 0.5 * tau**2 * speed
            return h, -0.5 * tau**2 * speed * turning
        if name == "yaw_rate" and not self.offset_known:
            h[-1] = 1.0
        return h, 0.0

    def correct(self, h: Array, value: float, variance: float) -> float:
        """z += K nu, P -= K h'P with K = P h/(h'P h + R): one sensor that reads h z, its innovation nu bounded."""
        assert self.z is not None
        scatter = h @ self.P @ h + variance
        reach = self.own.bound * math.sqrt(scatter)
        innovation = float(np.clip(value - h @ self.z, -reach, reach))
        gain = self.P @ h / scatter
        self.z, self.P = self.z + gain * innovation, self.P - np.outer(gain, h @ self.P)
        return innovation

    def take_in(self, instant: int, speed: float) -> None:
        """The samples of an instant, so many periods ago; the latest move the offsets of their sensors."""
        period, variances = self.model.period, self.own.variances()
        tau = self.ring[instant].get("tau", 0.0)
        for i, name in enumerate(SENSORS):
            if name not in self.ring[instant] or (name == "wheel_angle" and name not in self.model.states):
                continue
            h, beside = self.reading(name, instant, tau, speed)
            value = self.ring[instant][name] - beside - self.offsets[i]
            more = self.felt_error if name == "lateral_acceleration" else 0.0
            self.judge(name, instant, h, value, float(variances[i]) + more)
            if name == self.left_out:
                continue
            innovation = self.correct(h, value, float(variances[i]) + more)
            if instant == 0 and name in ("lateral_acceleration", "wheel_angle"):
                self.offsets[i] += min(1.0, period / self.own.settling) * innovation

    def judge(self, name: str, instant: int, h: Array, value: float, variance: float) -> None:
        """Average the squared innovation of a sensor over its variance, every sample once."""
        assert self.z is not None
        if instant == self.late:
            found = float((value - h @ self.z) ** 2 / (h @ self.P @ h + variance))
            share = self.own.shares(self.model.period)[name == self.left_out]
            self.disagreement[name] += share * (min(found, 2.0 * self.own.bound**2) - self.disagreement[name])

    def choose_left_out(self) -> None:
        """The redundant sensor that disagrees the most, beyond the bound, until it agrees again.

        Where the model is wrong the gyro disagrees at least as much; where the gyro is, the heading disagrees with it.
        A sensor without noise of its own is never left out: it is the model that is wrong.
        """
        from adaptrack.core.estimators.kalman import LEAST_NOISE

        if self.left_out is not None:
            if self.disagreement[self.left_out] < self.own.trust:
                self.left_out = None
            return
        found = {name: each for name, each in self.disagreement.items() if each >= self.disagreement["yaw_rate"]}
        found = {name: found.get(name, 0.0) for name in SENSORS if name not in ("yaw", "y")}
        found["yaw_rate"] = self.disagreement["yaw"]
        for name, variance, least in zip(SENSORS, self.own.variances(), LEAST_NOISE, strict=True):
            if variance <= least**2:
                found[name] = 0.0
        worst = max(found, key=lambda name: found[name])
        self.left_out = worst if found[worst] > self.own.distrust else None

    def go_on(self, speed: float) -> None:
        """From z of `late` periods before the last instant to the present one, with all samples since then."""
        if self.late:
            self.z, self.P = self.past
        for instant in range(min(self.late, self.steps - 1), -1, -1):
            self.predict(speed, instant)
            self.take_in(instant, speed)
            self.bound_disturbance()
            if instant == self.late:
                assert self.z is not None
                self.past = self.z, self.P
        self.choose_left_out()

    def bound_disturbance(self) -> None:
        """A push is no larger than what the tyres can still answer."""
        assert self.z is not None
        n = self.n
        z = self.z.copy()
        z[n : n + 2] *= self.spare / max(abs(z[n]), self.spare)
        self.z = z

    def ahead(self, speed: float) -> Array:
        """z at the time when the next command begins to act, through the commands already sent."""
        assert self.z is not None
        z, period = self.z + self.lost(speed) * self.unit_side, self.model.period
        for time, command in [(self.share * period, self.sent[self.whole])] + [
            (period, self.sent[j]) for j in range(self.whole - 1, -1, -1)
        ]:
            f, b = self.matrices(speed, time)
            z = f @ z + b * command
        return z

    def step(self, speed: float, measured: ArrayLike, command: float) -> tuple[Array, Array]:
        """One control instant; command: the one given a period ago (rad)."""
        seen = np.array([math.nan] * (len(SENSORS) + 2) + [0.0])
        given = np.asarray(measured, dtype=float)
        seen[: given.size] = given
        if self.is_astray(seen):
            self.z = None
        if self.z is None:
            self.begin(seen, command)
        else:
            self.sent = [command, *self.sent[:-1]]
            self.sort_in(seen)
            self.go_on(speed)
        self.steps += 1
        assert self.z is not None
        f, _ = self.matrices(speed, self.model.period)
        x = self.ahead(speed)[: self.n]
        known = self.blind <= self.own.patience / self.model.period
        pushes = (self.z + self.lost(speed) * self.unit_side)[self.n : self.n + 2]
        return x if known else np.full(self.n, math.nan), f[: self.n, self.n : self.n + 2] @ pushes
