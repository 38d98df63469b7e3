"""A car of CARLA follows its lane: python examples/carla_follow.py, with a CARLA server on this machine.

CARLA's axes are left-handed: x forward, y to the right, angles in degrees, positive clockwise. `position`, `sample` and
`steer` turn that into SI units, y and yaw to the left, and back; they need no CARLA and are tested without it.
"""

from __future__ import annotations

import math
from typing import Any

import adaptrack as at

PERIOD = 0.05  # s
SPEED = 10.0  # m/s


def position(location: Any) -> tuple[float, float]:
    """x, y (m) of a carla.Location."""
    return location.x, -location.y


def sample(t: float, transform: Any, velocity: Any, turning: Any) -> tuple[float, float, float, float, float, float]:
    """What `Tracker.step` takes.

    t: s; transform, velocity (m/s) and turning (degrees/s): what get_transform, get_velocity and get_angular_velocity
    of a vehicle give, in the axes of the world.
    """
    yaw = math.radians(transform.rotation.yaw)
    speed = velocity.x * math.cos(yaw) + velocity.y * math.sin(yaw)
    return t, *position(transform.location), -yaw, speed, -math.radians(turning.z)


def steer(angle: float, most: float) -> float:
    """The steer of a carla.VehicleControl for an angle (rad) of the road wheels; most: degrees at a steer of 1."""
    return min(1.0, max(-1.0, -math.degrees(angle) / most))


def lane_ahead(world_map: Any, location: Any, length: float = 400.0) -> at.Road:
    """The lane from a location on."""
    waypoints = [world_map.get_waypoint(location)]
    while len(waypoints) < length / 2.0 and (following := waypoints[-1].next(2.0)):
        waypoints.append(following[0])
    return at.Road.through([position(each.transform.location) for each in waypoints])


def main() -> None:
    """Drive to the end of the lane."""
    import carla

    world = carla.Client("localhost", 2000).get_world()
    settings = world.get_settings()
    settings.synchronous_mode, settings.fixed_delta_seconds = True, PERIOD
    world.apply_settings(settings)
    blueprint = world.get_blueprint_library().filter("vehicle.tesla.model3")[0]
    car = world.spawn_actor(blueprint, world.get_map().get_spawn_points()[0])
    world.tick()
    try:
        most = car.get_physics_control().wheels[0].max_steer_angle
        tracker = at.Tracker(at.MPC(at.load_vehicle("midsize-sedan")), lane_ahead(world.get_map(), car.get_location()))
        told = None
        while told is None or told.status is not at.Status.END:
            world.tick()
            t = world.get_snapshot().timestamp.elapsed_seconds
            given = sample(t, car.get_transform(), car.get_velocity(), car.get_angular_velocity())
            told = tracker.step(*given)
            throttle = min(0.8, max(0.0, 0.5 * (SPEED - given[4])))
            car.apply_control(carla.VehicleControl(throttle=throttle, steer=steer(told.command, most)))
    finally:
        car.destroy()
        settings.synchronous_mode, settings.fixed_delta_seconds = False, None
        world.apply_settings(settings)


if __name__ == "__main__":
    main()
