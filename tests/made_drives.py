"""Drives made by hand: a car that follows a road's centre line at a given offset."""

import numpy as np

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.drive.trajectory import TRAJECTORY_COLUMNS, Trajectory
from adaptrack.results import Run
from adaptrack.results.record import DriveRecord
from adaptrack.road import Arc, Line, Road

SPEED, PERIOD = 10.0, 0.05


def blank_columns(n):
    """All columns of a trajectory of so many instants, zero."""
    return {
        column.name: np.zeros((n, len(column.parts)) if column.parts else n, column.dtype)
        for column in TRAJECTORY_COLUMNS
    }


def trajectory(columns, **fields):
    """A trajectory of these columns, all others 0, and of these other fields."""
    return Trajectory(**(blank_columns(columns["t"].size) | columns | fields))


def bend(**along):
    """A straight line of 60 m, a quarter of a circle of 40 m to the left, a straight line of 60 m."""
    return Road.from_segments(
        [Line(length=60.0), Arc(length=20.0 * np.pi, curvature=0.025), Line(length=60.0)], name="bend", **along
    )


def made_run(road=None, *, controller="informed", amplitude=0.3, seconds=None, predicted=None, **changes):
    """A run at 10 m/s, `amplitude` sin(s/10) from the centre line (m); `changes` replace fields of the trajectory."""
    road = road or bend()
    car = load_vehicle("midsize-sedan")
    time = PERIOD * np.arange(round((road.length / SPEED if seconds is None else seconds) / PERIOD))
    s = SPEED * time
    place, offset = road.at(s), amplitude * np.sin(s / 10.0)
    turned = np.arctan2(0.1 * amplitude * np.cos(s / 10.0), 1.0 - place.curvature * offset)
    wheels = np.arctan(car.wheelbase * place.curvature)
    columns = {
        "t": time, "X": place.x - offset * np.sin(place.heading), "Y": place.y + offset * np.cos(place.heading),
        "psi": place.heading + turned, "vx": np.full(s.size, SPEED), "v_ref": np.full(s.size, SPEED),
        "steering": wheels, "command": wheels, "lateral_acceleration": SPEED**2 * place.curvature,
        "friction": np.full((s.size, 4), 0.9),
    }  # fmt: skip
    on_road = {"station": s, "offset": offset, "heading_error": turned, "curvature": place.curvature}
    meta = {"scenario": road.name, "controller": controller, "vehicle": "midsize-sedan", "profile": "road"}
    run = trajectory(columns, **({"period": PERIOD, "road": on_road, "meta": meta} | changes))
    return Run(run, road=road, car=car, predicted=predicted)


def recorded(run):
    """A run beside its road."""
    return DriveRecord.from_trajectory(run.trajectory, run.road, run.car, run.predicted)


def made_drive(road=None, **settings):
    """`made_run` beside its road."""
    return recorded(made_run(road, **settings))
