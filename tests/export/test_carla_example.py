"""The CARLA example: axes and units are turned, and a car in a stand-in of CARLA's world is identified and driven."""

import ast
import importlib
import inspect
import math
import sys
from pathlib import Path
from types import SimpleNamespace as Record

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars.vehicle import PedalMap
from adaptrack.identification import identify_drive
from adaptrack.road import Stop
from pedal_cars import DRIVE_LAG, PedalCar
from ros_messages import package_module

FOLDER = Path(__file__).resolve().parents[2] / "examples" / "carla"
sys.path.insert(0, str(FOLDER))
conversion, loop = importlib.import_module("conversion"), importlib.import_module("loop")
sys.path.remove(str(FOLDER))
StandInCar = package_module("stand_in").StandInCar
FULL = math.radians(70.0)
DEAD = package_module("stand_in").STEP  # s, of the stand-in's steering at a delay of 0


def vector(x=0.0, y=0.0, z=0.0):
    return Record(x=x, y=y, z=z)


def transform(x, y, yaw):
    return Record(location=vector(x, y), rotation=Record(yaw=yaw, pitch=0.0, roll=0.0))


def vehicle(place, velocity, turning=0.0):
    """As much of a carla.Vehicle as is asked for its motion."""
    return Record(
        get_transform=lambda: place, get_velocity=lambda: velocity, get_angular_velocity=lambda: vector(z=turning)
    )


class Lane:
    """A waypoint of a map: a lane that bends to the right, radius 80 m, behind 40 m of straight."""

    def __init__(self, s, end=300.0):
        self.s, self.end = s, end
        a = max(0.0, s - 40.0) / 80.0
        x, y = min(s, 40.0) + 80.0 * math.sin(a), 80.0 * (1.0 - math.cos(a))
        self.transform = transform(x, y, math.degrees(a))

    def next(self, way):
        return [Lane(self.s + way, self.end)] if self.s + way <= self.end else []


class World:
    """A synchronous world with one vehicle: adaptrack's dual track, told of and steered as CARLA does.

    ahead: m, of the vehicle's origin ahead of the centre of mass.
    """

    def __init__(self, ahead=0.0, lag=0.1):
        self.car, self.ahead, self.ticks, self.applied = StandInCar(delay=0.0, lag=lag, rate=2.0), ahead, 0, {}
        self.car.place(2.0, 0.0, 0.0, 0.0)
        self.pedals = PedalCar(self.car.car, DEAD)
        self.car._demand = lambda: self.pedals.acceleration(
            self.applied.get("throttle", 0.0), self.applied.get("brake", 0.0), float(self.car.state[3])
        )

    def tick(self):
        angle = -self.applied.get("steer", 0.0) * FULL
        self.car.obey(Record(steering_angle=angle, speed=0.0, acceleration=0.0))
        self.car.advance(loop.PERIOD)
        self.ticks += 1

    def get_snapshot(self):
        return Record(timestamp=Record(elapsed_seconds=7.0 + self.ticks * loop.PERIOD))

    def get_map(self):
        return Record(get_waypoint=lambda location: Lane(0.0))

    # -- its vehicle --------------------------------------------------------------------------------------------------
    def apply_control(self, control):
        assert all(0.0 <= control.get(pedal, 0.0) <= 1.0 for pedal in ("throttle", "brake"))
        assert -1.0 <= control["steer"] <= 1.0
        self.applied = control

    def get_transform(self):
        x, y, yaw = self.car.state[:3]
        x, y = x + self.ahead * math.cos(yaw), y + self.ahead * math.sin(yaw)
        return transform(x, -y, math.degrees(-math.remainder(yaw, 2.0 * math.pi)))

    def get_velocity(self):
        yaw, vx, vy = self.car.state[2:5]
        return vector(vx * math.cos(yaw) - vy * math.sin(yaw), -(vx * math.sin(yaw) + vy * math.cos(yaw)))

    def get_angular_velocity(self):
        return vector(z=-math.degrees(self.car.state[5]))

    def get_wheel_steer_angle(self, location):
        return -math.degrees(self.car.angle)


def car_of(world, **options):
    return loop.Car(world, dict, ("left", "right"), **{"full_steer": FULL, **options})


# -- axes, units, pedals ----------------------------------------------------------------------------------------------
def test_what_computes_needs_no_carla():
    assert "carla" not in sys.modules


def test_what_is_to_the_right_in_carla_is_negative_here():
    """Heading 90 degrees clockwise, driving along +y of CARLA and sliding along its -x, which is to the right."""
    sample = conversion.sample_of(2.0, vehicle(transform(5.0, 7.0, 90.0), vector(-0.5, 8.0), 10.0), 0.0)
    assert sample == pytest.approx((2.0, 5.0, -7.0, -math.pi / 2, 8.0, -math.radians(10.0), -0.5))


@pytest.mark.parametrize(("angle", "steer"), [(0.5 * FULL, -0.5), (-0.1 * FULL, 0.1), (2.0, -1.0)])
def test_a_wheel_to_the_left_is_a_negative_steer(angle, steer):
    assert conversion.steer_of(angle, FULL) == pytest.approx(steer)
    assert abs(steer) == 1.0 or conversion.angle_of(steer, FULL) == pytest.approx(angle)


def test_a_recording_never_presses_both_pedals_and_brakes_where_the_car_is_too_fast():
    steps = loop.PedalSteps()
    pressed = [steps.pedals(0.05 * k, 4.0 + 3.0 * math.sin(0.01 * k), 8.0) for k in range(2000)]
    assert all(throttle * brake == 0.0 for throttle, brake in pressed)
    assert {throttle for throttle, _ in pressed} == {0.0, *loop.LEVELS}
    assert steps.pedals(200.0, 11.0, 8.0)[1] > 0.0


def test_a_lane_that_bends_to_the_right_has_a_negative_curvature():
    road = conversion.lane_ahead(World().get_map(), None)
    assert road.length == pytest.approx(300.0, rel=1e-3)
    assert float(road.at(170.0).curvature) == pytest.approx(-1 / 80, rel=1e-3)


# -- the loop ---------------------------------------------------------------------------------------------------------
def test_full_steer_is_measured_on_the_standing_car():
    world = World()
    assert loop.measured_full_steer(world, car_of(world, full_steer=1.0)) == pytest.approx(FULL, rel=1e-3)
    world.get_wheel_steer_angle = lambda location: 0.0  # as versions do that do not know it
    assert loop.measured_full_steer(world, car_of(world, full_steer=1.0)) == 1.0


@pytest.fixture(scope="module")
def recorded():
    """A drive along the woven lane by a controller that knows nothing of the steering; told, and the log."""
    world = World(ahead=0.35)
    road = conversion.woven(conversion.lane_ahead(world.get_map(), None))
    car = at.load_vehicle("midsize-sedan")
    plan = at.plan_speed(road, car, end=0.0, top_speed=9.0)
    tracker = loop.tracker_of(car, road, plan, is_known=False)
    steps, rows = zip(*loop.follow(world, car_of(world), tracker, 3000), strict=True)
    return steps, loop.columns_of(list(rows)), road


@pytest.mark.compiled
def test_the_car_follows_its_lane_to_the_end_and_stands(recorded):
    steps, log, road = recorded
    assert max(abs(step.offset) for step in steps[60:]) < 0.2
    assert steps[-1].station == pytest.approx(road.length, abs=8.0)
    assert log["speed"][-1] < 0.1
    assert log["speed"].max() > 8.0


@pytest.mark.compiled
def test_the_log_tells_where_the_centre_of_mass_is(recorded):
    assert conversion.origin_ahead(recorded[1]) == pytest.approx(0.35, abs=0.03)


def followed(car):
    """Drive with a stop at 150 m by a car with known steering: answers, stops (m), RMS error of the speed (m/s)."""
    world = World(ahead=0.35)
    car = car.replace(steering=at.Steering(lag=0.1, dead_time=0.0, rate=2.0))
    road = conversion.lane_ahead(world.get_map(), None)
    plan = at.plan_speed(road, car, end=0.0, top_speed=9.0, stops=[Stop(150.0, 2.0)])
    tracker = loop.tracker_of(car, road, plan, is_known=True)
    steps, rows = zip(*loop.follow(world, car_of(world, ahead=0.35), tracker, 1500), strict=True)
    stations, speeds = np.array([step.station for step in steps]), np.array([row["speed"] for row in rows])
    planned = plan.at(stations)
    moves = (planned > 1.0) & (stations > 40.0)
    stands = [*stations[(speeds < 0.01) & (stations > 40.0)], math.inf]
    return steps, (stands[0], stations[-1] - road.length), math.sqrt(np.mean(np.square(speeds - planned)[moves]))


@pytest.mark.compiled
def test_by_the_pedal_map_that_its_log_gives_the_car_follows_lane_and_plan_and_stops(recorded):
    car = at.load_vehicle("midsize-sedan")
    log = {name: values for name, values in recorded[1].items() if name in ("time", "throttle", "brake", "speed")}
    steps, stands, error = followed(identify_drive(log, car).car)
    linear = PedalMap(speed=[0.0], throttle=[0.0, 1.0], force=[[0.0, 8000.0]], brake=[0.0, 1.0], brake_force=[0, 15000])
    *_, linear_error = followed(car.replace(pedals=linear))
    assert max(abs(step.offset) for step in steps) < 0.1
    assert stands == pytest.approx((150.0, 0.0), abs=0.15)
    assert error < 0.2
    assert linear_error > 1.5 * error


def test_a_car_without_a_pedal_map_is_refused():
    with pytest.raises(at.InvalidInput, match=r"has no \[pedals\]"):
        loop.tracker_of(at.load_vehicle("midsize-sedan"), None, None, is_known=True)


@pytest.mark.slow
@pytest.mark.compiled
def test_the_log_identifies_the_car(recorded, tmp_path):
    """As it stands: lag and dead time are those of the steering and the drive behind the stand-in."""
    loop.write_log(recorded[1], tmp_path / "drive.csv")
    true = at.load_vehicle("midsize-sedan")
    identification = at.identify(tmp_path / "drive.csv", mass=true.mass, wheelbase=true.wheelbase)
    assert identification["lag"].value == pytest.approx(0.1, abs=0.02)
    assert identification["delay"].value == pytest.approx(0.1 + DEAD, abs=0.02)
    assert identification.car.drive.lag == pytest.approx(DRIVE_LAG, abs=0.05)
    assert identification.car.pedals is not None


# -- the script -------------------------------------------------------------------------------------------------------
def test_the_script_calls_what_there_is():
    """It needs CARLA and is not run: its calls of our functions have the right number of arguments."""
    tree = ast.parse((FOLDER / "drive.py").read_text())
    ours = {
        name.name: getattr(importlib.import_module(node.module), name.name)
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module in ("conversion", "loop")
        for name in node.names
    }
    called = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and getattr(node.func, "id", "") in ours]
    assert len(called) > 5
    for call in called:
        inspect.signature(ours[call.func.id]).bind(*call.args, **{keyword.arg: None for keyword in call.keywords})
