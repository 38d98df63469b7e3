"""A car of the simulated world as an FMU: driven by FMPy, it is that of `simulate`, to the bit."""

import math
import shutil
import subprocess
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
import adaptrack.export
from adaptrack.export.fmu import write_fmu
from adaptrack.export.units import car_unit
from exported import STRICT, compiler
from fmus import Instance, Signals, needed

pytestmark = [pytest.mark.compiled, needed]
SOURCES = Path(adaptrack.export.__file__).parent
TRUE = ("x", "y", "yaw", "vx", "vy", "yaw_rate")
MEASURED = (
    "measured_vy", "measured_heading_error", "measured_yaw_rate", "measured_offset", "measured_wheel_angle",
    "measured_lateral_acceleration", "measured_pose_age", "measured_motion_age",
)  # fmt: skip
CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR)


@cache
def country():
    road = at.load_road("country", seed=3, length=300.0)
    return at.RoadDrive(road, at.plan_speed(road, CAR), wind=4.0)


@cache
def lane_change():
    return at.load_scenario("lane-change")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fmus")


def car(folder, version="3.0", route=None, profile="road", driver=None, period=None, plant=PLANT):
    name = f"car-{version[0]}-{getattr(route, 'name', 'none')}-{profile}-{plant.name}-{driver is not None}-{period}"
    path = folder / f"{name}.fmu"
    if not path.exists():
        write_fmu(car_unit(plant, route, profile=profile, driver=driver, period=period), path, version)
    return path


def same(a, b):
    return np.array(a, float).tobytes() == np.array(b, float).tobytes()


def differing(instance, plant, controller, route, profile, driver, seed, late=0):
    """Instants at which the FMU differs from `simulate` under its commands: in the true state, or as measured.

    late: periods by which the commands come later.
    """
    driven = at.simulate(plant, controller, route, profile=profile, driver=driver, seed=seed)
    assert driven.failed is None
    given = Signals(plant, controller, route, profile, driver)
    loop, found = given.loop(seed), 0
    states = np.stack([driven.X, driven.Y, driven.psi, driven.vx, driven.vy, driven.yaw_rate], axis=-1)
    for k in range(given.signals.n):
        now = loop.sense()
        sensed = [*now.measured[:8], now.speed]
        found += not (same(instance.get(*TRUE), states[k]) and same(instance.get(*MEASURED, "measured_speed"), sensed))
        command = driven.command[k - late] if k >= late else 0.0
        instance.step(command=command, **given.at(k, instance.get("station")))
        loop.send(float(driven.command[k]))
        loop.advance()
    return found, given.signals.n


@pytest.mark.parametrize(
    ("controller", "profile", "driver", "route"),
    [
        (lambda: at.published_mpc(CAR), "paper", None, lane_change),
        (lambda: at.MPC(CAR, profile="road", preview=True), "road", at.Driver(), lane_change),
        (lambda: at.MPC(CAR, profile="production", learning=at.Learning()), "production", None, country),
        (lambda: at.Stanley(CAR, period=0.05), "road", at.Driver(), country),
    ],
    ids=["published", "informed", "learning", "stanley"],
)
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_loop_over_fmpys_calls_is_a_drive_of_simulate_to_the_bit(version, controller, profile, driver, route, folder):
    made = controller()
    path = car(folder, version, route(), profile, driver, made.period)
    instance = Instance(path, folder, seed=11)
    assert differing(instance, PLANT, made, route(), profile, driver, 11)[0] == 0
    instance.free()
