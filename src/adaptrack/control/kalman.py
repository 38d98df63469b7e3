"""The Kalman filter of the MPC: state, disturbances and dead time of the path model from noisy, patchy measurements.

`KalmanFilter` is what a controller is given; it runs compiled (`core.estimators.kalman`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Bound, Finite, Hint, NotNegative, Number, Positive, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.estimation import Estimator
from adaptrack.control.models import MEASURED, PathModel, PredictionModel
from adaptrack.core.estimators.kalman import Numbers, kalman, memory_of, move_path
from adaptrack.core.kernel import size_of
from adaptrack.core.synthesis import car
from adaptrack.core.synthesis import filter as kernel
from adaptrack.core.synthesis.rows import row_of
from adaptrack.scenario.profile import Profile

Array = NDArray[np.float64]

SENSORS = (*MEASURED, "lateral_acceleration")
"""What the filter takes in."""
_NOISE, _DRIFTS, _USUAL = kernel.USUAL_NOISE, kernel.USUAL_DRIFTS, kernel.USUAL

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

    vy: Annotated[_Noise, "m/s"] = _NOISE.vy
    yaw: Annotated[_Noise, "rad"] = _NOISE.yaw
    yaw_rate: Annotated[_Noise, "rad/s"] = _NOISE.yaw_rate
    y: Annotated[NotNegative, "m", Hint("without a measured lateral position there is no path tracking")] = _NOISE.y
    wheel_angle: Annotated[_Noise, "rad"] = _NOISE.wheel_angle
    lateral_acceleration: Annotated[_Noise, "m/s^2"] = _NOISE.lateral_acceleration
    """of an accelerometer at the centre of gravity"""
    yaw_rate_offset: Annotated[_Noise, "rad/s"] = _NOISE.yaw_rate_offset
    """of an error of the yaw rate that stays; 0: there is none to be estimated"""


@checked
@dataclass(frozen=True)
class Drifts:
    """How fast what the filter estimates may change beside the model: standard deviations after one second.

    They are random walks: after t seconds the deviation is sqrt(t) times that. Behind them stands what is known of the
    tyres, which says how much of what the model cannot explain is a disturbance.
    """

    vy: Annotated[NotNegative, "m/s"] = _DRIFTS.vy
    yaw: Annotated[NotNegative, "rad"] = _DRIFTS.yaw
    yaw_rate: Annotated[NotNegative, "rad/s"] = _DRIFTS.yaw_rate
    y: Annotated[NotNegative, "m"] = _DRIFTS.y
    wheel_angle: Annotated[NotNegative, "rad"] = _DRIFTS.wheel_angle
    side: Annotated[NotNegative, "m/s^2"] = _DRIFTS.side
    """of the lateral disturbance d_y: side wind, bank, a steering bias"""
    turn: Annotated[NotNegative, "rad/s^2"] = _DRIFTS.turn
    """of the yaw disturbance d_r"""
    wind: Annotated[NotNegative, "m/s^2"] = _DRIFTS.wind
    """of what side wind adds to d_y; it adds to d_r as well, in the proportion of the car's body"""
    yaw_rate_offset: Annotated[NotNegative, "rad/s"] = _DRIFTS.yaw_rate_offset
    """of the yaw-rate sensor's offset"""
    sliding: Annotated[NotNegative, "s^0.5"] = _DRIFTS.sliding
    """of the force of an axle: its impulse deviates by `sliding` F^2/F_z after a second, F being its force in
    the model and F_z its load. In the brush model of a tyre sliding takes F^2/(3 mu F_z) away (Pacejka, Tire and
    Vehicle Dynamics, 3rd ed., section 3.2), and mu is not known."""
    sliding_time: Annotated[Positive, "s"] = _DRIFTS.sliding_time
    """how long such a deviation lasts: by it an accelerometer is off by sliding F^2/F_z/(m sqrt(2 sliding_time))"""
    grip: Annotated[NotNegative, "m/s^2"] = _DRIFTS.grip
    """what the tyres can pull at most: a disturbance is no larger than that less what they pull in the model,"""
    least_spare: Annotated[Positive, "m/s^2"] = _DRIFTS.least_spare
    """but may always be this large"""

    @property
    def numbers(self) -> Any:
        """A row of `core.synthesis.filter.Drifts`."""
        return row_of(kernel.Drifts, self)

    @classmethod
    def of(cls, row: Any) -> Self:
        """The drifts of such a row."""
        return cls(*row.tolist())


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
    bound: Annotated[Bound, Hint("inf: no bound")] = _USUAL.bound
    spread: tuple[NotNegative, NotNegative] = (_USUAL.spread_side, _USUAL.spread_turn)
    oldest: Annotated[Finite, within(0.0, OLDEST), "s"] = _USUAL.oldest
    patience: Annotated[Number, Field(ge=0.0), "s", Hint("inf: for ever")] = _USUAL.patience
    settling: Annotated[Bound, "s", Hint("inf: no averaging")] = _USUAL.settling
    distrust: Annotated[Bound, Hint("inf: no sensor is left out")] = _USUAL.distrust
    trust: Bound = _USUAL.trust
    window: Annotated[tuple[Positive, Positive], "s"] = (_USUAL.window_taken_in, _USUAL.window_left_out)
    friction: Positive = _USUAL.friction
    shape: Annotated[Finite, Field(gt=1.0, lt=2.0)] = _USUAL.shape_factor
    longest: Annotated[Finite, within(0.0, LONGEST), "s"] = _USUAL.longest
    name = "kalman"

    def __post_init__(self) -> None:
        if self.trust > self.distrust:
            raise InvalidInput(
                f"KalmanFilter: trust = {self.trust!r}, distrust = {self.distrust!r}: distrust must be no less."
            )

    @classmethod
    @checked
    def of_profile(cls, profile: Profile, drifts: Drifts | None = None) -> KalmanFilter:
        """For the sensors of a profile, see `core.synthesis.filter.sensor_noise`."""
        noise = row_of(kernel.Noise)
        kernel.sensor_noise(profile.numbers(profile.period), noise)
        return cls(SensorNoise(*noise.tolist()), drifts or Drifts(), oldest=profile.oldest)

    @property
    def numbers(self) -> Any:
        """A row of `core.synthesis.filter.Filter`."""
        made = kernel.Filter.new(1)
        spread_side, spread_turn = self.spread
        taken_in, left_out = self.window
        own = (
            self.bound, spread_side, spread_turn, self.oldest, self.patience, self.settling, self.distrust, self.trust,
            taken_in, left_out, self.friction, self.shape, self.longest,
        )  # fmt: skip
        made.view(float)[:] = [*row_of(kernel.Noise, self.noise).tolist(), *self.drifts.numbers.tolist(), *own]
        return made[0]

    @classmethod
    def of(cls, row: Any) -> KalmanFilter:
        """The filter of such a row."""
        noise, drifts, bound, side, turn, oldest, patience, settling, distrust, trust, *rest = row.tolist()
        taken_in, left_out, friction, shape, longest = rest
        return cls(
            SensorNoise(*noise), Drifts(*drifts), bound, (side, turn), oldest, patience, settling, distrust, trust,
            (taken_in, left_out), friction, shape, longest,
        )  # fmt: skip

    @property
    def function(self) -> Any:
        return kalman

    def check_fits(self, model: PredictionModel) -> None:
        if not isinstance(model, PathModel):
            raise InvalidInput(f"estimator 'kalman': needs the path model, and model {model.name!r} is another one.")

    def memory_size(self, model: PredictionModel) -> int:
        return int(kernel.filter_size(*kernel.filter_periods(self.numbers, model.period, model.dead_time)))

    def change_path(self, model: PredictionModel, memory: Array, heading: float, offset: float) -> None:
        move_path(memory, self.late(model), heading, offset)

    def left_out(self, memory: Array) -> str | None:
        out = int(memory_of(memory, 0).left_out)
        return SENSORS[out - 1] if out else None

    def late(self, model: PredictionModel) -> int:
        """Periods that are gone through anew at every step, for the samples that come late."""
        return int(kernel.filter_periods(self.numbers, model.period, model.dead_time)[1])

    def variances(self) -> Array:
        """(6,) of what `SENSORS` give; inf: none."""
        found = np.empty(len(SENSORS))
        kernel.sensor_variances(row_of(kernel.Noise, self.noise), found)
        return found

    @property
    def tyres(self) -> tuple[float, float]:
        return self.friction, self.shape

    def parameters(self, model: PredictionModel) -> Array:
        assert isinstance(model, PathModel)
        found = np.zeros(size_of(Numbers))
        kernel.filter_numbers(self.numbers, model.vehicle.numbers, model.period, model.lag, model.dead_time, found)
        return found


def wind_turn(vehicle: Vehicle) -> float:
    """d_r over d_y (1/m) of side wind, see `core.synthesis.car.wind_turn`."""
    return float(car.wind_turn(vehicle.numbers))
