"""The Kalman filter of the MPC: state, disturbances and dead time of the path model from noisy, patchy measurements.

`KalmanFilter` is what a controller is given; it runs compiled (`core.estimators.kalman`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput, real
from adaptrack.cars.vehicle import Vehicle, in_periods
from adaptrack.control.estimation import Estimator
from adaptrack.control.models import MEASURED, PathModel, PredictionModel
from adaptrack.scenario.profile import Profile

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

        move_path(memory, self.late(model), heading, offset)

    def left_out(self, memory: Array) -> str | None:
        from adaptrack.core.estimators.kalman import memory_of

        out = int(memory_of(memory, 0).left_out)
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
        from adaptrack.core.estimators.kalman import STATE, Numbers

        assert isinstance(model, PathModel)
        whole, share = _periods(model)
        forgetting, regaining = self.shares(model.period)
        spread_side, spread_turn, spread_offset = (each**2 for each in (*self.spread, self.noise.yaw_rate_offset))
        drifts, together = self.drifts, self.disturbance_drift(model)
        drift = {name: getattr(drifts, name) ** 2 for name in model.states}
        drift |= {"side": together[0, 0], "turn": together[1, 1]}
        if self.noise.yaw_rate_offset > 0.0:
            drift["offset"] = drifts.yaw_rate_offset**2
        read = [name in (*model.states, "lateral_acceleration") for name in SENSORS]
        numbers = Numbers.new(
            period=model.period, whole=whole, share=share, longest=self._longest(model), late=self.late(model),
            bound=self.bound, patience=self.patience / model.period, distrust=self.distrust, trust=self.trust,
            forgetting=forgetting, regaining=regaining, settling=min(1.0, model.period / self.settling),
            variance=np.where(read, self.variances(), math.inf),
            drift=[drift.get(name, 0.0) * model.period for name in STATE._fields],
            drift_both=together[0, 1] * model.period,
            sliding=drifts.sliding**2, sliding_time=drifts.sliding_time,
            grip=drifts.grip, least_spare=drifts.least_spare, friction=self.friction, shape_factor=self.shape,
            spread_side=spread_side, spread_turn=spread_turn, spread_offset=spread_offset,
            model=tuple(model.parameters()),
        )  # fmt: skip
        return np.asarray(numbers.view(float))


def wind_turn(vehicle: Vehicle) -> float:
    """d_r over d_y (1/m) of side wind: L C_ym m/(C_s I_z), 0 for a body that feels none."""
    if vehicle.side_force_slope == 0.0:
        return 0.0
    arm = (vehicle.lf + vehicle.lr) * vehicle.yaw_moment_slope / vehicle.side_force_slope
    return arm * vehicle.mass / vehicle.yaw_inertia


def _periods(model: PredictionModel) -> tuple[int, float]:
    """The dead time of a model in periods: whole ones and the share of one more."""
    return in_periods(model.dead_time, model.period)
