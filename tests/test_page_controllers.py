"""Copies and kernels alone make the numbers that `MPC`, `DualTrack` and `World` hold: what a page in a browser does."""

from __future__ import annotations

import math
import random
import tomllib

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.files import SHIPPED
from adaptrack.cars.data_sheet import vehicle_from_data_sheet
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import list_vehicles, load_tyre, load_vehicle
from adaptrack.control.controllers import LQR, Learning, PurePursuit, Stanley, published_mpc
from adaptrack.core.controllers.mpc import Settings
from adaptrack.core.estimators import kalman, learning
from adaptrack.core.kernel import INTERPRETED, size_of
from adaptrack.core.plants.parameters import PLANT_PARAMETERS
from adaptrack.core.synthesis import car as cars
from adaptrack.core.synthesis import filter, informed, laws, plant, published
from adaptrack.drive.world import World
from adaptrack.export.page_controllers import MADE_BY, controller_numbers, world_numbers
from adaptrack.export.page_inputs import car_fields, tyre_numbers

PROFILES = ("paper", "road", "production")
KERNELS = {"pure_pursuit_parameters": laws.pure_pursuit_parameters, "stanley_parameters": laws.stanley_parameters}


# -- what the program does: rows by name, and kernels ------------------------------------------------------------------
def row(kind, numbers, **more):
    """A row of a record: a number for each of its fields by name, NaN (0 of a whole one) where there is none."""
    made = kind.new(1)[0]
    laid(made, kind, {**numbers, **more})
    return made


def laid(made, kind, numbers):
    for name, of in kind.kinds.items():
        value = numbers.get(name)
        if hasattr(of, "kinds"):
            laid(made[name], of, value or {})
        elif value is not None:
            made[name] = value
        elif not isinstance(of, tuple):
            made[name] = math.nan if of.name == "float64" else 0


def car_of_file(name):
    """A car file as a program reads it: keys and sections, defaults for what is left out."""
    text = (SHIPPED / "vehicles" / f"{name}.toml").read_text(encoding="utf-8")
    return with_defaults(tomllib.loads(text))


def car_of_sheet(mass, wheelbase, load, truck, **known):
    car, within = row(cars.Car, {"mass": mass, **known}), row(cars.KnownWithin, {})
    assert cars.complete_car(wheelbase, load, truck, car, within) == cars.COMPLETE
    numbers = dict(zip(cars.Car._fields, car.tolist(), strict=True))
    spreads = dict(zip(cars.KnownWithin._fields, within.tolist(), strict=True))
    return with_defaults({**numbers, "known_within": spreads})


def with_defaults(read):
    fields = car_fields()["sections"]
    made = {each["key"]: each["default"] for each in fields[""] if each["default"] is not None} | read
    made["domain"] = {each["key"]: each["default"] for each in fields["domain"]} | read.get("domain", {})
    return made


class Program:
    """All constants of a drive by kernels; car: numbers by name, tyre likewise."""

    def __init__(self, car, profile, kind, preview=None, belief=None):
        self.car, self.world = car, world_numbers(profile)
        self.given = controller_numbers(kind, profile, preview)
        self.tyre = row(plant.Tyre, tyre_numbers(load_tyre(car["tyre"])))
        self.chassis = row(plant.Chassis, car)
        self.steering = row(cars.Steering, car.get("steering", {}))
        known = car.get("known_within")
        self.known = {} if known is None else {**known, "said": 1}
        self.belief = belief or {}

    def plant(self):
        found, actuator = np.zeros(len(PLANT_PARAMETERS)), row(plant.Actuator, self.world["actuator"])
        plant.plant_parameters(self.chassis, self.tyre, actuator, found)
        return found

    def settings(self, top_speed):
        """`core.loop.Settings` by name."""
        world, actuator = self.world, self.world["actuator"]
        found = dict(world["settings"])
        found["substeps"] = plant.plant_substeps(self.chassis, self.tyre, 1, world["period"], top_speed)
        found["dead_whole"], found["dead_share"] = plant.dead_periods(
            world["delay"], actuator["dead_time"], world["period"]
        )
        found |= {f"steering_{name}": actuator[name] for name in ("lag", "limit", "bias")}
        found |= {name: self.car[name] for name in ("mass", "engine_power", "traction_limit", "brake_limit")}
        return found | {"failure_distance": self.car["domain"]["failure_distance"]}

    def informed(self):
        """`Constants`, and the sizes of both memories."""
        order = row(
            informed.Order, self.given["order"], car=self.car, within=self.known, file=self.car.get("steering", {}),
            given=self.belief,
        )  # fmt: skip
        parts = informed.Parts.new(1)
        usual = np.zeros(size_of(filter.Filter))
        filter.usual_filter(usual)
        parts["filter"] = usual.view(filter.Filter.dtype)[0]
        assert informed.informed_parts(order, parts[0]) == informed.FINE
        states, filtered, learned = informed.informed_sizes(order, parts[0])
        made = constants(self.given["settings"], states, learned)
        assert informed.informed_constants(order, parts[0], made) == informed.FINE
        return made, (filtered, learned)

    def published(self):
        made = constants(self.given["settings"], 4, 0)
        car = row(cars.Car, self.car)
        assert published.published_constants(car, self.world["period"], made) == informed.FINE
        return made

    def law(self):
        """Parameters and tuning."""
        given, car = self.given, row(cars.Car, self.car)
        common, found = row(laws.Common, given["common"]), np.zeros(given["size"])
        tuning = [laws.steering_delay(self.steering) if math.isnan(x) else x for x in given["tuning"].values()]
        if given["made_by"] == "lqr_parameters":
            assert laws.lqr_parameters(car, common, np.array(tuning[:3]), found) == 1
        else:
            KERNELS[given["made_by"]](car, common, found)
        return found, np.array(tuning)


def constants(settings, states, learned):
    numbers = size_of(learning.Numbers) if learned else 0
    return informed.Constants(
        settings=Settings.new(1, **settings), tuning=np.zeros(4), model=np.zeros(7), states=np.zeros(states, np.int64),
        turning=np.zeros(7), estimator=np.zeros(size_of(kalman.Numbers)), learner=np.zeros(numbers),
        fresh=np.zeros(learned),
    )  # fmt: skip


# -- what the package holds -------------------------------------------------------------------------------------------
def sheets():
    rng = random.Random(28)
    for i in range(20):
        known = {"lf": 1.2} if i % 5 == 0 else {"stiffness_front": 6e4, "cg_height": 0.6} if i % 5 == 1 else {}
        yield i, (rng.uniform(900, 3000), rng.uniform(2.3, 3.6), rng.choice((0.0, 75.0, 136.0)), i % 2), known


CARS = [pytest.param(name, id=name) for name in list_vehicles()]
CARS += [pytest.param(given, id=f"sheet-{i}") for i, *given in sheets()]


def both(which):
    """A car as the program has it, and as the package has it."""
    if isinstance(which, str):
        return car_of_file(which), load_vehicle(which)
    (mass, wheelbase, load, truck), known = which
    style = "truck" if truck else "car"
    made = vehicle_from_data_sheet("sheet", mass, wheelbase, load=load, body_style=style, **known)
    return car_of_sheet(mass, wheelbase, load, truck, **known), made


def same(found, expected):
    found, expected = np.asarray(found, float), np.asarray(expected, float)
    assert found.shape == expected.shape
    assert found.tobytes() == expected.tobytes()


def same_mpc(made, mpc, own):
    names = [name for name in Settings._fields if name not in ("curved", "feeds_forward")]
    held = mpc._mpc.settings
    same([made.settings[0][name] for name in names], [getattr(held, name) for name in names])
    same(made.tuning, mpc.tuning.as_array())
    same(made.model[: own.parameters.size], own.parameters)
    same(made.states, own.states)


@pytest.mark.parametrize("which", CARS)
def test_plant_and_loop_are_those_of_the_package(which):
    mine, car = both(which)
    for profile in PROFILES:
        program, expected = Program(mine, profile, "published"), at.load_profile(profile)
        driven = DualTrack(car, steering=expected.steering)
        same(program.plant(), driven.packed())
        names = program.world["plants"][plant.plant_law(program.tyre)]
        if not INTERPRETED:  # there functions have no names of the library
            assert names["advance"] == driven.compiled.advance.name
        world = World.of(DualTrack(car), at.MPC(car, profile=profile), profile, None, None, None)
        for speed in (3.0, 26.5):
            assert program.settings(speed) == world.settings(world.substeps(speed))._asdict()


@pytest.mark.parametrize("which", CARS)
def test_the_outline_is_that_of_the_package(which):
    mine, car = both(which)
    found, body = row(plant.Outline, {}), row(plant.Body, mine.get("body", {}))
    assert plant.outline_of(body, row(plant.Chassis, mine), found) == plant.HOLDS
    same(found.tolist(), [car.outline.front, car.outline.rear, car.outline.width])
    assert cars.car_flaw(row(cars.Car, mine))[0] == cars.ONE_CAR


@pytest.mark.parametrize("kind", ["informed", "learning"])
@pytest.mark.parametrize("profile", PROFILES)
@pytest.mark.parametrize("which", CARS)
def test_an_informed_controller_is_that_of_the_package(which, profile, kind):
    mine, car = both(which)
    how = Learning() if kind == "learning" else "auto"
    for belief in ({}, {"lag": 0.1, "dead_time": 0.04})[: 2 if isinstance(which, str) else 1]:
        steering = at.Steering(**belief) if belief else None
        mpc = at.MPC(car, profile=profile, learning=how, preview=True, belief=steering)
        made, (filtered, learned) = Program(mine, profile, kind, True, belief).informed()
        own = mpc._mpc
        same_mpc(made, mpc, own)
        same(made.turning, own.feed.turning)
        same(made.estimator, own.informed.estimator)
        same(made.learner, own.informed.learner)
        same(made.fresh, own.informed.fresh)
        assert (filtered, learned) == (own.informed.estimates.shape[1], own.informed.learned.shape[1])


@pytest.mark.parametrize("which", CARS)
def test_the_published_controller_is_that_of_the_package(which):
    mine, car = both(which)
    for profile in PROFILES:
        period = at.load_profile(profile).period
        mpc = published_mpc(car, period=period, preview=True)
        same_mpc(Program(mine, profile, "published", True).published(), mpc, mpc._mpc)


@pytest.mark.parametrize("kind", list(MADE_BY))
@pytest.mark.parametrize("which", CARS)
def test_a_law_is_that_of_the_package(which, kind):
    mine, car = both(which)
    law = {"pure-pursuit": PurePursuit, "stanley": Stanley, "lqr": LQR}[kind]
    for profile in PROFILES[: 1 if kind == "lqr" else None]:
        own = law(car, period=at.load_profile(profile).period, preview=True)
        program = Program(mine, profile, kind, True)
        parameters, tuning = program.law()
        same(parameters, own.parameters())
        same(tuning, own.packed_tuning())
        assert INTERPRETED or program.given["function"] == own.function.name
        assert (program.given["memory"], program.given["diagnostics"]) == (own.memory_size, list(own.diagnostic_names))
