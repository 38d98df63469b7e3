"""Controllers of a simulated drive that are given the samples of a tracker."""

from __future__ import annotations

import math
from abc import abstractmethod
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.control.controllers import Controller
from adaptrack.core.maths import portable
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.road.road_ahead import RoadAhead

Array = NDArray[np.float64]


class SampledController(Controller):
    """Base of controllers that answer samples of a tracker: pose in the plane, motion, and the times of both."""

    period: float
    sees_all_sensors = True
    instant = 0
    """Index of the next control instant."""

    @abstractmethod
    def answer(self, sample: Array) -> Any:
        """Return the answer to a sample (`core.tracker.signals.TRACKER_SAMPLE`), as `Controller.step` does."""

    def step(
        self, state: Any, speed: float, reference: Any, variables: Any = None, road: RoadAhead | None = None
    ) -> Any:
        time, measured = self.instant * self.period, np.asarray(state, dtype=float)
        assert road is not None
        age = float(measured[MEASUREMENT.pose_age])
        age = age if math.isfinite(age) else 0.0
        foot = road.road.at(road.station - age * speed)
        offset, yaw = float(measured[MEASUREMENT.y]), float(foot.heading) + float(measured[MEASUREMENT.yaw])
        x, y = float(foot.x) - offset * portable.sin(foot.heading), float(foot.y) + offset * portable.cos(foot.heading)
        signals = [float(measured[i]) for i in (MEASUREMENT.yaw_rate, MEASUREMENT.vy, MEASUREMENT.lateral_acceleration)]
        sample = np.full(len(TRACKER_SAMPLE), math.nan)
        sample[: TRACKER_SAMPLE.friction] = (
            time - age, time, x, y, yaw, speed, *signals, measured[MEASUREMENT.wheel_angle],
        )  # fmt: skip
        motion_age = float(measured[MEASUREMENT.motion_age])
        sample[TRACKER_SAMPLE.motion_time] = time - (motion_age if math.isfinite(motion_age) else 0.0)
        self.instant += 1
        return self.answer(sample)
