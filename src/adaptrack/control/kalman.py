"""The Kalman filter of the MPC: state, disturbances and dead time of the path model from noisy, patchy measurements.

`KalmanFilter` is what a controller is given; it runs compiled (`core.estimators.kalman`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Annotated, Any, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Bound, Finite, Hint, NotNegative, Number, Positive, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle, in_periods
from adaptrack.control.estimation import Estimator
from adaptrack.control.models import MEASURED, PathModel, PredictionModel
from adaptrack.core.estimators.kalman import LEAST_NOISE, STATE, Numbers, kalman, memory_of, memory_size, move_path
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]

SENSORS = (*MEASURED, "lateral_acceleration")
"""What the filter takes in."""


OLDEST = 2.0
"""s, of a sample that is still taken in."""
LONGEST = 5.0
"""s, of a dead time that may be learned."""
_Noise = Annotated[Number, Field(ge=0.0), Hint("inf: no such sensor")]


@checked
@dataclass(frozen=True)
class SensorNoise:
    """Standard deviations of what is measured; infinity: there is no such sensor.

    The defaults are those of the profile ``road``.
    """

    vy: Annotated[_Noise, "m/s"] = 0.05
    yaw: Annotated[_Noise, "rad"] = 0.003
    yaw_rate: Annotated[_Noise, "rad/s"] = 0.01
    y: Annotated[NotNegative, "m", Hint("without a measured lateral position there is no path tracking")] = 0.03
    wheel_angle: Annotated[_Noise, "rad"] = math.inf
    lateral_acceleration: Annotated[_Noise, "m/s^2"] = math.inf
    """of an accelerometer at the centre of gravity"""
    yaw_rate_offset: Annotated[_Noise, "rad/s"] = 0.0
    """of an error of the yaw rate that stays; 0: there is none to be estimated"""


@checked
@dataclass(frozen=True)
class Drifts:
    """How fast what the filter estimates may change beside the model: standard deviations after one second.

    They are random walks: after t seconds the deviation is sqrt(t) times that. Behind them stands what is known of the
    tyres, which says how much of what the model cannot explain is a disturbance.
    """

    vy: Annotated[NotNegative, "m/s"] = 0.03
    yaw: Annotated[NotNegative, "rad"] = 0.001
    yaw_rate: Annotated[NotNegative, "rad/s"] = 0.015
    y: Annotated[NotNegative, "m"] = 0.01
    wheel_angle: Annotated[NotNegative, "rad"] = 0.01
    side: Annotated[NotNegative, "m/s^2"] = 0.03
    """of the lateral disturbance d_y: side wind, bank, a steering bias"""
    turn: Annotated[NotNegative, "rad/s^2"] = 0.05
    """of the yaw disturbance d_r"""
    wind: Annotated[NotNegative, "m/s^2"] = 0.35
    """of what side wind adds to d_y; it adds to d_r as well, in the proportion of the car's body"""
    yaw_rate_offset: Annotated[NotNegative, "rad/s"] = 0.0002
    """of the yaw-rate sensor's offset"""
    sliding: Annotated[NotNegative, "s^0.5"] = 0.2
    """of the force of an axle: its impulse deviates by `sliding` F^2/F_z after a second, F being its force in
    the model and F_z its load. In the brush model of a tyre sliding takes F^2/(3 mu F_z) away (Pacejka, Tire and
    Vehicle Dynamics, 3rd ed., section 3.2), and mu is not known."""
    sliding_time: Annotated[Positive, "s"] = 0.3
    """how long such a deviation lasts: by it an accelerometer is off by sliding F^2/F_z/(m sqrt(2 sliding_time))"""
    grip: Annotated[NotNegative, "m/s^2"] = 7.0
    """what the tyres can pull at most: a disturbance is no larger than that less what they pull in the model,"""
    least_spare: Annotated[Positive, "m/s^2"] = 0.5
    """but may always be this large"""


@final
@checked
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
    given while driving.

    Raises
    ------
    InvalidInput
        When `trust` is above `distrust`.
    """

    noise: SensorNoise = SensorNoise()
    drifts: Drifts = Drifts()
    bound: Annotated[Bound, Hint("inf: no bound")] = 5.0
    spread: tuple[NotNegative, NotNegative] = (0.3, 0.3)
    oldest: Annotated[Finite, within(0.0, OLDEST), "s"] = 0.0
    patience: Annotated[Number, Field(ge=0.0), "s", Hint("inf: for ever")] = 3.0
    settling: Annotated[Bound, "s", Hint("inf: no averaging")] = 10.0
    distrust: Annotated[Bound, Hint("inf: no sensor is left out")] = 10.0
    trust: Bound = 2.0
    window: Annotated[tuple[Positive, Positive], "s"] = (0.5, 5.0)
    friction: Positive = 0.9
    shape: Annotated[Finite, Field(gt=1.0, lt=2.0)] = 1.3
    longest: Annotated[Finite, within(0.0, LONGEST), "s"] = 0.0
    name = "kalman"

    def __post_init__(self) -> None:
        if self.trust > self.distrust:
            raise InvalidInput(
                f"KalmanFilter: trust = {self.trust!r}, distrust = {self.distrust!r}: distrust must be no less."
            )

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
        return kalman

    def check_fits(self, model: PredictionModel) -> None:
        if not isinstance(model, PathModel):
            raise InvalidInput(f"estimator 'kalman': needs the path model, and model {model.name!r} is another one.")

    def memory_size(self, model: PredictionModel) -> int:
        return int(memory_size(self._longest(model), self.late(model)))

    def change_path(self, model: PredictionModel, memory: Array, heading: float, offset: float) -> None:
        move_path(memory, self.late(model), heading, offset)

    def left_out(self, memory: Array) -> str | None:
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
