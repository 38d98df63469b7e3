"""Drives made by hand: a car that follows a road's centre line, a given offset beside it."""

import numpy as np

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.results.record import SIGNALS, DrawnCar, DriveRecord
from adaptrack.road import Arc, Line, Road

SPEED, PERIOD = 10.0, 0.05


def bend(**along):
    """A straight line of 60 m, a quarter of a circle of 40 m to the left, a straight line of 60 m."""
    return Road.from_segments(
        [Line(length=60.0), Arc(length=20.0 * np.pi, curvature=0.025), Line(length=60.0)], name="bend", **along
    )


def made_drive(road=None, *, amplitude=0.3, seconds=None, **more):
    """A drive at 10 m/s, `amplitude` sin(s/10) beside the centre line (m)."""
    road = road or bend()
    car = load_vehicle("midsize-sedan")
    time = np.arange(0.0, road.length / SPEED if seconds is None else seconds, PERIOD)
    s = SPEED * time
    place, offset = road.at(s), amplitude * np.sin(s / 10.0)
    turned = np.arctan2(0.1 * amplitude * np.cos(s / 10.0), 1.0 - place.curvature * offset)
    wheels = np.arctan(car.wheelbase * place.curvature)
    values = {
        "time": time, "station": s, "speed": np.full(s.size, SPEED), "offset": offset, "heading_error": turned,
        "x": place.x - offset * np.sin(place.heading), "y": place.y + offset * np.cos(place.heading),
        "yaw": place.heading + turned, "steering": wheels, "command": wheels,
        "lateral_acceleration": SPEED**2 * place.curvature,
    }  # fmt: skip
    assert set(values) == set(SIGNALS)
    return DriveRecord(road=road, shape=DrawnCar.of(car), **(values | more))
