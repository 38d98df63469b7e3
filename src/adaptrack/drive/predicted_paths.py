"""The paths that an MPC predicts while it drives along a road, kept now and then for a page to draw."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Positive, checked
from adaptrack.control.controllers import MPC, Controller
from adaptrack.road.road_ahead import RoadAhead

Array = NDArray[np.float64]


class PredictedPaths:
    """Recorder of predicted paths for `simulate`: one path every so many seconds, a few points of each.

    every: s, between two paths; points: of a path, evenly over the horizon, its end among them. Controllers that
    predict no path, and instants without a solution, leave nothing.
    """

    @checked
    def __init__(self, every: Annotated[Positive, "s"] = 0.25, points: Annotated[int, Field(ge=2)] = 8) -> None:
        self.every, self.count = every, points
        self._time: list[float] = []
        self._points: list[Array] = []

    def __len__(self) -> int:
        """The number m of paths."""
        return len(self._time)

    @property
    def time(self) -> Array:
        """(m,) s, when each was predicted."""
        return np.array(self._time)

    @property
    def points(self) -> Array:
        """(m, points, 2) m, where the car was then expected."""
        return np.array(self._points).reshape(-1, self.count, 2)

    def take(self, time: float, controller: Controller, ahead: RoadAhead | None) -> None:
        """Keep what the last step of a controller predicts, if it is due; time: s, of that step."""
        due = not self._time or time > self._time[-1] + self.every - 1e-6
        if ahead is None or not due or not isinstance(controller, MPC):
            return
        path = controller.predicted_path(ahead)
        self._time.append(time)
        self._points.append(path[np.rint(np.linspace(0, len(path) - 1, self.count)).astype(int)])
