"""A car of CARLA, driven by adaptrack; a CARLA server runs on this machine.

    python drive.py record --out drive.csv      # weave along the lane with steps of the pedals; how to identify the car
    python drive.py follow --car my-car.toml    # follow the lane, and stop on it, with the car that was identified

All that is computed is in conversion.py and loop.py, which need no CARLA.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import carla
from conversion import lane_ahead, origin_ahead, wheelbase_of, woven
from loop import PERIOD, Car, columns_of, follow, measured_full_steer, tracker_of, write_log

import adaptrack as at
from adaptrack.road import Stop

FLAT = ((0.0, 1.0), (150.0, 1.0))
"""A steering curve that leaves the steer as it is at every speed (its unit differs between versions)."""


@contextmanager
def spawned(options: argparse.Namespace) -> Iterator[tuple[Any, Any]]:
    """A synchronous world and a vehicle in it, both as before afterwards."""
    client = carla.Client(options.host, options.port)
    client.set_timeout(20.0)
    world = client.get_world()
    before = world.get_settings()
    settings = world.get_settings()
    settings.synchronous_mode, settings.fixed_delta_seconds = True, PERIOD
    world.apply_settings(settings)
    vehicle = None
    try:
        blueprint = world.get_blueprint_library().filter(options.blueprint)[0]
        vehicle = world.spawn_actor(blueprint, world.get_map().get_spawn_points()[options.spawn])
        for _ in range(20):  # it falls onto the road
            world.tick()
        yield world, vehicle
    finally:
        if vehicle is not None:
            vehicle.destroy()
        world.apply_settings(before)


def prepared(world: Any, vehicle: Any, options: argparse.Namespace) -> Car:
    """The vehicle with a flat steering curve, and with what is known of it."""
    physics = vehicle.get_physics_control()
    physics.steering_curve = [carla.Vector2D(*point) for point in FLAT]
    vehicle.apply_physics_control(physics)
    front = carla.VehicleWheelLocation.FL_Wheel, carla.VehicleWheelLocation.FR_Wheel
    car = Car(vehicle, carla.VehicleControl, front, math.radians(physics.wheels[0].max_steer_angle), options.ahead)
    if options.full_steer is None:
        car.full_steer = measured_full_steer(world, car)
    else:
        car.full_steer = math.radians(options.full_steer)
    print(f"full steer: {math.degrees(car.full_steer):.1f} degrees")
    return car


def main() -> None:
    """Record or follow."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["record", "follow"])
    parser.add_argument("--car", default="midsize-sedan", help="a car of adaptrack, or a file of `adaptrack identify`")
    parser.add_argument("--out", default="drive.csv", help="where `record` writes its log")
    parser.add_argument("--ahead", type=float, default=0.0, help="m, origin ahead of the centre of mass: see record")
    parser.add_argument("--full-steer", type=float, help="degrees of the wheels at a steer of 1, instead of measuring")
    parser.add_argument("--speed", type=float, default=10.0, help="m/s")
    parser.add_argument("--length", type=float, default=800.0, help="m of lane")
    parser.add_argument("--blueprint", default="vehicle.tesla.model3")
    parser.add_argument("--spawn", type=int, default=0)
    parser.add_argument("--host", default="localhost")
    parser.add_argument("--port", type=int, default=2000)
    options = parser.parse_args()
    with spawned(options) as (world, vehicle):
        car, known = prepared(world, vehicle, options), at.load_vehicle(options.car)
        road = lane_ahead(world.get_map(), vehicle.get_location(), options.length)
        path = woven(road) if options.what == "record" else road
        stops = [] if options.what == "record" else [Stop(0.5 * path.length, 2.0)]
        plan = at.plan_speed(path, known, end=0.0, stops=stops, top_speed=options.speed)
        tracker = tracker_of(known, path, plan, is_known=options.what == "follow")
        answers, rows = zip(*follow(world, car, tracker), strict=True)
        physics = vehicle.get_physics_control()
    print(f"{len(rows) * PERIOD:.0f} s, largest offset {max(abs(each.offset) for each in answers):.2f} m")
    if options.what == "record":
        log = columns_of(list(rows))
        write_log(log, options.out)
        print(f"the origin lies {origin_ahead(log):.2f} m ahead of the centre of mass: --ahead")
        sizes = f"--mass {physics.mass:.0f} --wheelbase {wheelbase_of(physics):.2f}"
        print(f"now: adaptrack identify {options.out} {sizes} --out my-car.toml")


if __name__ == "__main__":
    main()
