"""Between CARLA and adaptrack: axes, units, steering. Needs no CARLA; any object with its attributes will do.

CARLA: left-handed, x forward, y to the right, degrees, yaw positive clockwise from above. Here (ISO 8855): y and
angles to the left, radians. `steer` is a share of the largest angle of the front wheels, positive to the right.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import adaptrack as at


class Sample(NamedTuple):
    """What `Tracker.step` takes, of the centre of mass: s, m, m, rad, m/s, rad/s, m/s."""

    t: float
    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float
    lateral_velocity: float


def position(location: Any) -> tuple[float, float]:
    """x, y (m) of a carla.Location."""
    return location.x, -location.y


def sample_of(t: float, vehicle: Any, ahead: float) -> Sample:
    """The motion of a carla.Vehicle at t (s), whose origin lies `ahead` (m) of its centre of mass.

    Location and velocity are those of the world's axes; the velocity is that of the centre of mass (PhysX).
    """
    transform, velocity = vehicle.get_transform(), vehicle.get_velocity()
    yaw = -math.radians(transform.rotation.yaw)
    x, y = position(transform.location)
    x, y = x - ahead * math.cos(yaw), y - ahead * math.sin(yaw)
    along = velocity.x * math.cos(yaw) - velocity.y * math.sin(yaw)
    across = -velocity.x * math.sin(yaw) - velocity.y * math.cos(yaw)
    return Sample(t, x, y, yaw, along, -math.radians(vehicle.get_angular_velocity().z), across)


def steer_of(angle: float, full_steer: float) -> float:
    """The `steer` of a carla.VehicleControl for an angle (rad) of the road wheels; full_steer: rad at a steer of 1."""
    return min(1.0, max(-1.0, -angle / full_steer))


def angle_of(steer: float, full_steer: float) -> float:
    """rad, of the road wheels, that a steer asks for."""
    return -steer * full_steer


def wheelbase_of(physics: Any) -> float:
    """m, from a carla.VehiclePhysicsControl, whose wheels (front left, front right, rear left, ...) are given in cm.

    Raises
    ------
    adaptrack.InvalidInput
        When that is no car's, as in versions that tell the wheels' places otherwise.
    """
    front, rear = physics.wheels[0].position, physics.wheels[2].position
    found = 0.01 * math.hypot(front.x - rear.x, front.y - rear.y)
    if not 1.0 < found < 10.0:
        raise at.InvalidInput(f"the wheels are {found:.3g} m apart in this version of CARLA: measure the wheelbase.")
    return found


def lane_ahead(world_map: Any, location: Any, length: float = 400.0) -> at.Road:
    """The lane from a carla.Location on, for so many m or to its end; where it forks, the first branch."""
    waypoints = [world_map.get_waypoint(location)]
    while len(waypoints) < length / 2.0 and (following := waypoints[-1].next(2.0)):
        waypoints.append(following[0])
    return at.road_through([position(each.transform.location) for each in waypoints])


def woven(road: at.Road, swing: float = 0.3) -> at.Road:
    """A path that weaves about a lane by +- swing (m), in waves of 60 m at its start and of 20 m at its end.

    To identify a car it must be steered, slowly and fast.
    """
    s = np.arange(0.0, road.length, 1.0)
    turns = s / 60.0 + (1 / 20.0 - 1 / 60.0) * s**2 / (2.0 * road.length)
    aside = swing * np.minimum(1.0, s / 40.0) * np.sin(2.0 * math.pi * turns)
    lane = road.at(s)
    return at.road_through(
        np.stack([lane.x - aside * np.sin(lane.heading), lane.y + aside * np.cos(lane.heading)], axis=-1)
    )


def origin_ahead(log: dict[str, NDArray[np.float64]]) -> float:
    """m, how far the vehicle's origin lies ahead of its centre of mass, from a log of `loop.follow`.

    The origin's way between two ticks gives its lateral velocity, that of the centre of mass is measured; they differ
    by the yaw rate times the distance. Least squares.

    Raises
    ------
    adaptrack.InvalidInput
        When the car hardly turned.
    """
    middle = {name: 0.5 * (values[1:] + values[:-1]) for name, values in log.items()}
    yaw, rate = np.unwrap(log["yaw"]), middle["yaw_rate"]
    yaw = 0.5 * (yaw[1:] + yaw[:-1])
    step = np.diff(log["time"])
    across = (np.diff(log["y"]) * np.cos(yaw) - np.diff(log["x"]) * np.sin(yaw)) / step
    turned = float(rate @ rate)
    if not turned > 1e-3 * rate.size:
        raise at.InvalidInput("the log hardly turns: drive bends, or weave, to find the centre of mass.")
    return float(rate @ (across - middle["vy"])) / turned
