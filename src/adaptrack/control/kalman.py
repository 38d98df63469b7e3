"""The Kalman filter of the MPC: state, disturbances and dead time of the path model from noisy, patchy measurements.

`KalmanFilter` is what a controller is given; it runs compiled (`core.estimators.kalman`).
"""

from __future__ import annotations

from typing import final

import numpy as np

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.control.estimation import Estimator
from adaptrack.control.models import MEASURED_STATES, PathModel, PredictionModel
from adaptrack.control.settings import RecordSettings
from adaptrack.core.estimators.kalman import FilterParameters, kalman, memory_of, move_path
from adaptrack.core.kernel import row_of
from adaptrack.core.maths.portable import Array
from adaptrack.core.synthesis import filter as kernel
from adaptrack.scenario.profile import Profile

SENSORS = (*MEASURED_STATES, "lateral_acceleration")
"""What the filter takes in."""


class SensorNoise(RecordSettings, record=kernel.Noise):
    """Standard deviations of what is measured; infinity: there is no such sensor.

    The defaults are those of the profile ``road``.
    """


class Drifts(RecordSettings, record=kernel.DriftsRow):
    """How fast the estimates of the filter may change beyond the model: standard deviations after one second.

    They are random walks: after t seconds the deviation is sqrt(t) times as large. The terms of the tyres tell how much
    of what the model cannot explain is a disturbance.
    """


@final
class KalmanFilter(RecordSettings, Estimator, record=kernel.Filter):
    """State and disturbances of a `PathModel`, carried over its dead time with the commands already sent.

    noise: of the sensors; drifts: of the estimates.

    Raises
    ------
    InvalidInput
        When `trust` is above `distrust`.
    """

    noise: SensorNoise = SensorNoise()
    drifts: Drifts = Drifts()
    name, function = "kalman", staticmethod(kalman)

    def __post_init__(self) -> None:
        if self.trust > self.distrust:
            raise InvalidInput(
                f"KalmanFilter: trust = {self.trust!r}, distrust = {self.distrust!r}: distrust must be no less."
            )

    @classmethod
    @checked
    def from_profile(cls, profile: Profile, drifts: Drifts | None = None) -> KalmanFilter:
        """For the sensors of a profile, see `core.synthesis.filter.sensor_noise`."""
        noise = row_of(kernel.Noise)
        kernel.sensor_noise(profile.controller_world(profile.period), noise)
        return cls(SensorNoise.from_row(noise), drifts or Drifts(), oldest=profile.oldest)

    def check_fits(self, model: PredictionModel) -> None:
        if not isinstance(model, PathModel):
            raise InvalidInput(f"estimator 'kalman': needs the path model, and model {model.name!r} is another one.")

    def memory_size(self, model: PredictionModel) -> int:
        return int(kernel.filter_size(*kernel.filter_periods(self.row, model.period, model.dead_time)))

    def change_path(self, model: PredictionModel, memory: Array, heading: float, offset: float) -> None:
        move_path(memory, self.late(model), heading, offset)

    def left_out(self, memory: Array) -> str | None:
        out = int(memory_of(memory, 0).excluded)
        return SENSORS[out - 1] if out else None

    def late(self, model: PredictionModel) -> int:
        """Periods that are gone through anew at every step, for the samples that come late."""
        return int(kernel.filter_periods(self.row, model.period, model.dead_time)[1])

    def variances(self) -> Array:
        """(6,) of what `SENSORS` give; inf: none."""
        variances = np.empty(len(SENSORS))
        kernel.sensor_variances(self.noise.row, variances)
        return variances

    @property
    def tyres(self) -> tuple[float, float]:
        return self.friction, self.shape_factor

    def parameters(self, model: PredictionModel) -> Array:
        assert isinstance(model, PathModel)
        rows = FilterParameters.new(1)
        kernel.filter_numbers(self.row, model.vehicle.numbers, model.period, model.lag, model.dead_time, rows[0])
        return rows.view(np.float64)
