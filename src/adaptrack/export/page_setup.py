"""What is set up on the page, driven by Python: the same drives to the last bit.

A setup is plain data for JSON:

    car          {name} of ours | {sheet: {mass, wheelbase, ...}} | {file: a car file as the page has read it}
    road         {name} of `PAGE_ROADS` | {points: [[x, y], ...], closed, name} | {test} of `PAPER_ROADS`
    speed        {constant: m/s} | {lateral: m/s^2}, planned; a test has its own
    profile      name; what the controllers are made for
    truth        {lag, dead_time, bias, noise, friction, wind, brake_lag, slope, mass} where the world differs, else
                 null; noise and mass: factors; slope: dz/ds of a road, which a speed control knows
    seed         of the noise
    controllers  one or two {kind, tuning: null | {Np, Nc, Q, R}, belief: null | {lag, dead_time}}; with knows: "sheet"
                 one knows mass and wheelbase of the car, no more; with speed_control: {friction} a speed control that
                 assumes this friction, or [low, high], drives and brakes the car, on roads, otherwise the speed is
                 kept exactly
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import LQR, MPC, Controller, Learning, PurePursuit, Stanley, Tuning, published_mpc
from adaptrack.control.controllers.learned_car import STEERING_QUANTITIES
from adaptrack.control.scheduling import load_scheduler
from adaptrack.control.speed_control import SpeedControl
from adaptrack.drive.batch import Batch
from adaptrack.drive.simulate import rollouts, simulate
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import Arc, Clothoid, Comfort, Line, Road, generate_road, plan_speed, road_through
from adaptrack.scenario import RoadDrive, Scenario
from adaptrack.scenario.profile import Profile, load_profile

CLOSED_ROAD_DURATION = 3600.0
"""s, for which a closed road is driven."""
PAPER_ROADS = ("triple-lane-change", "general-trajectory")
"""The paper's."""


def _oval() -> Road:
    radius, into = 80.0, 60.0
    bend: list[Any] = [Clothoid(length=into, start_curvature=0.0, end_curvature=1.0 / radius),
            Arc(length=math.pi * radius - into, curvature=1.0 / radius),
            Clothoid(length=into, start_curvature=1.0 / radius, end_curvature=0.0)]  # fmt: skip
    return Road.from_segments([Line(length=200.0), *bend] * 2, closed=True, name="oval", speed_limit=40.0)


GENERATED = {"mountain": 1500.0, "country": 2500.0, "town": 1200.0, "motorway": 4000.0, "lap": 1500.0}
"""Kinds of `generate_road` and how long (m) they are on the page."""
PAGE_ROADS = (*GENERATED, "oval")
"""The ready-made roads: level, of one width and speed limit each."""


@cache
def page_road(name: str) -> Road:
    """A ready-made road of the page."""
    road = generate_road(name, length=GENERATED[name]) if name in GENERATED else _oval()
    return road.replace(name=name)


def simulate_setup(setup: Mapping[str, Any]) -> list[Trajectory]:
    """The drives of a setup, one for each controller."""
    car, profile = car_of(setup["car"]), load_profile(setup["profile"])
    drive, world = drive_of(setup, car), world_of(profile, setup.get("truth") or {})
    mass = (setup.get("truth") or {}).get("mass")
    plant = DualTrack(car if mass is None else car.replace(mass=car.mass * mass))
    runs = []
    for controller in setup["controllers"]:
        model_car = (
            at.vehicle_from_data_sheet(car.name, car.mass, car.wheelbase) if controller.get("knows") == "sheet" else car
        )
        steering_controller, seed = controller_of(controller, model_car, profile), int(setup.get("seed", 0))
        if speed_control := controller.get("speed_control"):
            driver = SpeedControl(model_car, **speed_control)
            runs.append(simulate(plant, steering_controller, drive, profile=world, driver=driver, seed=seed))
        else:
            runs += rollouts(Batch(plant, steering_controller, [drive], world), (seed,), threads=1)[0]
    return runs


def car_of(setup: Mapping[str, Any]) -> Vehicle:
    """The car of a setup."""
    if "name" in setup:
        return at.load_vehicle(setup["name"])
    if "sheet" in setup:
        return at.vehicle_from_data_sheet("sheet", **setup["sheet"])
    file = setup["file"]
    sections = {key: file.get(key) for key in ("steering", "body", "known_within", "domain") if file.get(key)}
    return Vehicle(name=file.get("name", "file"), tyre=file["tyre"]["name"], **file["numbers"], **sections)


def road_of(setup: Mapping[str, Any]) -> Road:
    """The road of a setup."""
    if "name" in setup and "points" not in setup:
        return page_road(setup["name"])
    return road_through(np.array(setup["points"], float), closed=bool(setup.get("closed")))


def drive_of(setup: Mapping[str, Any], car: Vehicle) -> RoadDrive | Scenario:
    """Return the drive of a page's setup: a road at a speed or a test of the paper, with true friction and wind."""
    truth, road_setup = setup.get("truth") or {}, setup["road"]
    friction, wind = truth.get("friction"), truth.get("wind")
    if "test" in road_setup:
        scenario = at.load_scenario(road_setup["test"])
        changes: dict[str, Any] = {} if friction is None else {"friction": friction}
        changes |= {} if wind is None else {"wind": wind, "wind_gain": 1.0}
        return scenario.replace(**changes) if changes else scenario
    road, speed = road_of(road_setup), setup["speed"]
    plan = speed["constant"] if "constant" in speed else plan_speed(road, car, Comfort(lateral=speed["lateral"]))
    surface = {"friction": friction, "grade": truth.get("slope")}
    true_road = road.replace(**{name: value for name, value in surface.items() if value is not None})
    drive = RoadDrive(true_road, plan, wind=wind or 0.0)
    return drive.replace(laps=max(1, math.floor(CLOSED_ROAD_DURATION / drive.duration))) if road.closed else drive


def world_of(profile: Profile, truth: Mapping[str, Any]) -> Profile:
    """The simulated world: the profile with another steering and with so many times its noise."""
    steering = {name: truth[name] for name in STEERING_QUANTITIES if truth.get(name) is not None}
    if steering.get("lag", profile.steering.lag) == 0.0:
        steering["rate"] = math.inf  # a rate limit acts on a lag
    factor = 1.0 if truth.get("noise") is None else float(truth["noise"])
    noises = {name: getattr(profile, name) for name in type(profile).model_fields if name.startswith("noise_")}
    changed = {name: value * factor for name, value in noises.items() if math.isfinite(value)}
    if (brake_lag := truth.get("brake_lag")) is not None:
        changed["brakes"] = profile.brakes.replace(lag=brake_lag)
    return profile.replace(steering=profile.steering.replace(**steering), **changed)


def controller_of(setup: Mapping[str, Any], car: Vehicle, profile: Profile) -> Controller:
    """A controller of a setup, for a car in a profile."""
    kind, loop = setup["kind"], {"period": profile.period, "preview": profile.preview}
    entries, believed = setup.get("tuning"), setup.get("belief")
    tuning = None if entries is None else Tuning(**{**entries, "Np": int(entries["Np"]), "Nc": int(entries["Nc"])})
    laws = {"pure-pursuit": PurePursuit, "stanley": Stanley, "lqr": LQR}
    if kind in laws:
        return laws[kind](car, **loop)
    scheduled = kind.partition("-")[2]
    if kind.startswith("published"):
        scheduler = load_scheduler(f"road-{scheduled}") if scheduled else None
        return published_mpc(car, tuning, scheduler=scheduler, **loop)
    steering = {name: value for name, value in (believed or {}).items() if value is not None}
    options: dict[str, Any] = {"belief": at.Steering(**steering)} if steering else {}
    if kind == "learning":
        options["learning"] = Learning()
    elif kind != "informed":
        raise InvalidInput(f"controller {kind!r}: there is none of this kind.")
    return MPC(car, tuning, profile=profile, **options)
