"""What Python writes into the page: how the kernels' records lie in memory, and what is data, never a formula."""

from __future__ import annotations

from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.core import rollout
from adaptrack.core.controllers import mpc, mpc_step
from adaptrack.core.period import Span
from adaptrack.drive.batch import Batch
from adaptrack.export.page_layout import calls, image, layouts
from adaptrack.scenario import RoadDrive

RECORDS = (rollout.Run, Span, mpc_step.Step)
CALLED = ("begin_runs", "sense_one", "send_one", "move_one", "close_one", "mpc_step", "bend_of", "points_at")


def page_data() -> dict[str, Any]:
    """All of it, as plain data for JSON."""
    return {"layouts": layouts(RECORDS), "calls": calls(CALLED), "first": _first()}


def _first() -> dict[str, Any]:
    """A drive, made here."""
    car, road = at.load_vehicle("paper"), at.load_road("mountain")
    batch = Batch(at.DualTrack(car), at.MPC(car, profile="road"), [RoadDrive(road, 15.0)], "road")
    settings = batch.mpc_settings(np.inf, np.inf, residuals=True)
    run = batch.arena(1, int(batch.substeps[0]), settings)
    run.vehicles.start[:], run.tuning[:] = batch.starts[0], batch.tuning
    s = np.arange(0.0, road.length, 2.0)
    points, (left, right) = road.at(s), road.edges(s)
    outline = car.outline
    return {
        "run": image(run),
        "periods": int(batch.periods[0]),
        "shown": {
            "road": {"x": points.x.tolist(), "y": points.y.tolist(), "left_x": left[:, 0].tolist(),
                     "left_y": left[:, 1].tolist(), "right_x": right[:, 0].tolist(), "right_y": right[:, 1].tolist(),
                     "name": road.name, "closed": road.closed, "length": road.length},
            "outline": {"front": outline.front, "rear": outline.rear, "width": outline.width, "lf": car.lf,
                        "lr": car.lr, "track_front": car.track_front, "track_rear": car.track_rear},
        },
        "answer": [*mpc.ANSWER._fields],
    }  # fmt: skip
