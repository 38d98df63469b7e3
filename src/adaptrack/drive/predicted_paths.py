"""Paths that an MPC predicts while it drives along a road, recorded at intervals for the replay on a page."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Positive, checked
from adaptrack.core.maths.portable import Array
from adaptrack.road.road_ahead import RoadAhead


class PredictedPaths:
    """Recorder of predicted paths for `simulate`.

    It records nothing for controllers without predictions and for instants without a solution.

    Parameters
    ----------
    every
        Time between two recorded paths (s).
    points
        Number of points per path, evenly distributed over the horizon including its end.
    """

    @checked
    def __init__(self, every: Annotated[Positive, "s"] = 0.25, points: Annotated[int, Field(ge=2)] = 8) -> None:
        self.every, self.count = every, points
        self._time: list[float] = []
        self._points: list[Array] = []

    def __len__(self) -> int:
        """Number m of recorded paths."""
        return len(self._time)

    @property
    def time(self) -> Array:
        """Times of the predictions (s), (m,)."""
        return np.array(self._time)

    @property
    def points(self) -> Array:
        """Predicted positions x, y (m), (m, points, 2)."""
        return np.array(self._points).reshape(-1, self.count, 2)

    def record(self, time: float, controller: Any, road_ahead: RoadAhead | None) -> None:
        """Record the prediction of a controller's last step at `time` (s), unless the last record is too recent."""
        is_due = not self._time or time > self._time[-1] + self.every - 1e-6
        if road_ahead is None or not is_due:
            return
        path = controller.predicted_path(road_ahead)
        if not path.size:
            return
        self._time.append(time)
        self._points.append(path[np.rint(np.linspace(0, len(path) - 1, self.count)).astype(int)])
