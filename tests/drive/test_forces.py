"""Drive, brakes, slope and standstill of the simulated car, against mechanics that can be written down."""

from __future__ import annotations

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack import (
    MPC,
    DualTrack,
    Perception,
    RoadDrive,
    SingleTrack,
    SpeedControl,
    UserPlant,
    load_vehicle,
    simulate,
)
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator
from adaptrack.core.physics import force_actuator
from adaptrack.core.physics.forces import GRAVITY, axle_force_limit
from adaptrack.core.plants.contract import PLANT_INPUT, PLANT_STATE, input_at, place, state_at, vehicle_batch
from adaptrack.road import Arc, Clothoid, Comfort, Line, Stop

SALOON = load_vehicle("midsize-sedan").replace(drag_coefficient=0.0, rolling_resistance=0.0)
STEP = 0.01
"""s, of the integration"""


def _states(plant: at.Plant, inputs: dict[str, float], speed: float, seconds: float) -> np.ndarray:
    """x (m), v_x (m/s) of a car under constant inputs, at every step."""
    start = plant.initial_state([0.0, 0.0, 0.0, speed, 0.0, 0.0])
    vehicles = vehicle_batch(plant.compiled, plant.packed(), start[None])
    place(1, vehicles.start, vehicles.block, vehicles.states)
    for name, value in {"acceleration": math.nan, "command": 0.0, **inputs}.items():
        vehicles.block[input_at(getattr(PLANT_INPUT, name), 0)] = value
    rows = []
    for _ in range(round(seconds / STEP)):
        plant.compiled.advance(0, vehicles.parameters, vehicles.block, vehicles.states, vehicles.work, 1, 1, STEP)
        rows.append([vehicles.block[state_at(row, 0)] for row in (PLANT_STATE.x, PLANT_STATE.vx)])
    return np.array(rows)


def _dry(friction: float = 0.9) -> dict[str, float]:
    wheels = ("front_left", "front_right", "rear_left", "rear_right")
    return {f"friction_{wheel}": friction for wheel in wheels}


PLANTS = pytest.mark.parametrize("plant", [SingleTrack(SALOON), DualTrack(SALOON)], ids=["single-track", "dual-track"])


@PLANTS
@pytest.mark.parametrize("grade", [0.12, -0.12])
def test_brakes_hold_a_car_on_a_slope_up_to_their_force_and_not_beyond(plant: at.Plant, grade: float) -> None:
    pull = SALOON.mass * GRAVITY * math.sin(math.atan(grade))
    held_states = _states(
        plant, {**_dry(), "grade": grade, "force": -1.01 * abs(pull), "brake": 1.01 * abs(pull)}, 0.0, 2.0
    )
    slides = _states(plant, {**_dry(), "grade": grade, "force": -0.9 * abs(pull), "brake": 0.9 * abs(pull)}, 0.0, 2.0)
    assert (held_states == 0.0).all()
    assert slides[-1, 1] == pytest.approx(-0.1 * pull / SALOON.mass * 2.0, rel=1e-3)


@PLANTS
def test_friction_bounds_what_brakes_hold_on_a_slope(plant: at.Plant) -> None:
    steep, brake = {"grade": 0.3}, {"force": -30000.0, "brake": 30000.0}
    assert (_states(plant, {**_dry(0.31), **steep, **brake}, 0.0, 1.0) == 0.0).all()
    assert _states(plant, {**_dry(0.29), **steep, **brake}, 0.0, 1.0)[-1, 1] < 0.0


@PLANTS
def test_a_braked_car_stops_after_v2_over_2a_and_never_rolls_backwards(plant: at.Plant) -> None:
    x, vx = _states(plant, {**_dry(), "force": -5.0 * SALOON.mass, "brake": 5.0 * SALOON.mass}, 10.0, 4.0).T
    assert (vx >= 0.0).all()
    assert vx[-1] == 0.0
    assert x[-1] == pytest.approx(10.0, abs=2.0 * STEP)


@PLANTS
def test_a_coasting_car_gains_what_the_slope_gives(plant: at.Plant) -> None:
    _, vx = _states(plant, {**_dry(), "grade": -0.05}, 10.0, 3.0).T
    assert vx[-1] == pytest.approx(10.0 + GRAVITY * math.sin(math.atan(0.05)) * 3.0, rel=1e-9)


def _step_response(actuator: tuple[float, ...], periods: int, period: float) -> list[float]:
    """Mean forces (N) of each period after a step of the request from 0 to 1000 N."""
    record = force_actuator.ForceActuator(*actuator)
    requests, force, means = np.zeros(record.dead_whole + 2), 0.0, []
    for _ in range(periods):
        requests[1:] = requests[:-1].copy()
        requests[0] = 1000.0
        force, mean = force_actuator.actuator_step(force, 0.0, requests, period, record)
        means.append(mean)
    return means


def test_an_actuator_delivers_the_impulse_of_its_dead_time_gain_and_lag() -> None:
    lag, dead_time, gain, period = 0.3, 0.13, 0.9, 0.05
    means = _step_response((2, 0.6, lag, math.inf, gain, 1e4), 20, period)
    acting = 20 * period - dead_time
    impulse = gain * 1000.0 * (acting - lag * (1.0 - math.exp(-acting / lag)))
    assert sum(means) * period == pytest.approx(impulse, rel=1e-9)


def test_a_rate_limit_makes_a_ramp_and_a_limit_ends_it() -> None:
    means = _step_response((0, 0.0, 0.0, 2000.0, 1.0, 600.0), 10, 0.05)
    assert sum(means) * 0.05 == pytest.approx(0.5 * 600.0 * 0.3 + 600.0 * 0.2, rel=1e-9)


def test_at_the_limit_of_the_guard_an_axle_is_on_its_friction_circle(rng: np.random.Generator) -> None:
    for _ in range(200):
        share, transfer, friction = rng.uniform(0, 1), rng.uniform(-0.3, 0.3), rng.uniform(0.2, 1.1)
        load = rng.uniform(3000, 9000)
        side = rng.uniform(0, 0.99) * friction * load
        limit = axle_force_limit(share, load, side, transfer, friction)
        forces = np.linspace(0.0, min(limit, 1e5), 50)
        used = np.hypot(share * forces, side) / (friction * (load + transfer * forces))
        assert (used[:-1] < 1.0 + 1e-9).all()
        if math.isfinite(limit):
            assert np.hypot(share * limit, side) == pytest.approx(abs(friction * (load + transfer * limit)), rel=1e-6)


def test_a_car_stops_where_its_plan_stops_waits_and_drives_on() -> None:
    car = load_vehicle("midsize-sedan").replace(
        drive=DriveActuator(lag=0.2, dead_time=0.1, creep=0.5), brakes=BrakeActuator(lag=0.1, dead_time=0.1)
    )
    road = at.Road.from_segments([Line(length=300.0)], name="straight")
    plan = at.plan_speed(road, car, Comfort(), stops=[Stop(150.0, 4.0)])
    run = simulate(DualTrack(car), MPC(car, profile="road"), RoadDrive(road, plan), profile="road", driver=at.Driver())
    stands = run.vx < 0.01
    assert run.road["station"][stands] == pytest.approx(150.0, abs=0.5)
    assert 3.5 <= np.count_nonzero(stands) * run.period <= 7.0
    assert run.road["station"][-1] > 250.0
    assert (run.vx > -1e-9).all()


def _climb(grade: float) -> at.Road:
    """A straight road that is level for 100 m, and then climbs."""
    road = at.Road.from_segments([Line(length=400.0)], name="climb")
    return road.replace(grade=([0.0, 100.0, 110.0, 400.0], [0.0, 0.0, grade, grade]))


@pytest.mark.parametrize("grade", [0.1, -0.1])
def test_a_driver_keeps_its_speed_on_a_slope_and_holds_the_car_at_a_stop(grade: float) -> None:
    car = load_vehicle("midsize-sedan")
    road = _climb(grade)
    plan = at.plan_speed(road, car, Comfort(), stops=[Stop(250.0, 3.0)], top_speed=12.0)
    run = simulate(DualTrack(car), MPC(car, profile="road"), RoadDrive(road, plan), profile="road", driver=at.Driver())
    climbing = (run.road["station"] > 150.0) & (run.road["station"] < 200.0)
    stands = run.vx == 0.0
    assert run.vx[climbing] == pytest.approx(plan.at(run.road["station"][climbing]), abs=0.4)
    assert np.ptp(run.road["station"][stands]) == 0.0
    assert np.count_nonzero(stands) * run.period >= 2.5
    assert run.vx.min() >= 0.0


@pytest.mark.compiled
def test_behind_a_stop_of_a_speed_control_the_car_is_on_the_slope_of_its_place() -> None:
    car, grade = SALOON, 0.08
    road = at.Road.from_segments([Line(length=90.0)], name="straight")
    road = road.replace(grade=([0.0, 30.0, 35.0, 90.0], [0.0, 0.0, grade, grade]))
    plan = at.plan_speed(road, car, Comfort(accelerate=1.5, brake=2.0), stops=[Stop(20.0, 0.5)], top_speed=8.0)
    run = simulate(
        DualTrack(car), MPC(car, profile="road"), RoadDrive(road, plan), profile="road", driver=SpeedControl(car)
    )
    on_slope = (run.road["station"] > 60.0) & (run.road["station"] < 80.0)
    surplus = run.diagnostics["requested_force"] / car.mass - np.gradient(run.vx, run.period)
    assert float(np.mean(surplus[on_slope])) == pytest.approx(GRAVITY * math.sin(math.atan(grade)), rel=0.15)


def test_a_plant_that_does_not_take_the_grade_is_refused_by_name_on_a_slope() -> None:
    def level(x, u, environment, p, dx):
        dx[:] = 0.0
        dx[0] = x[3]

    plant = UserPlant(level, {}, mass=1000.0, label="flat earth")
    road, car = _climb(0.05), load_vehicle("midsize-sedan")
    drive = RoadDrive(road, at.plan_speed(road, car))
    with pytest.raises(at.InvalidInput, match=r"plant 'flat earth' does not take the grade of a road"):
        simulate(plant, MPC(car, profile="road"), drive, profile="road")
    assert simulate(plant, MPC(car, profile="road"), drive.replace(road=road.replace(grade=0.0)), profile="road").t.size


def test_a_plan_for_an_assumed_friction_asks_no_more_than_that_of_the_tyres() -> None:
    car = load_vehicle("midsize-sedan")
    road = at.Road.from_segments(
        [
            Line(length=100.0),
            Clothoid(length=40.0, start_curvature=0.0, end_curvature=0.02),
            Arc(length=100.0, curvature=0.02),
        ],
        name="bend",
    )
    plan = at.plan_speed(road.replace(friction=0.4), car, Comfort(lateral=9.0))
    drive = RoadDrive(road, plan)
    run = simulate(
        DualTrack(car), MPC(car, profile="road"), drive, profile="road", driver=at.Driver(),
        perception=Perception(friction=0.4),
    )  # fmt: skip
    assert run.failed is None
    in_arc = (run.road["station"] > 150.0) & (run.road["station"] < 220.0)
    assert 0.3 * GRAVITY < run.lateral_acceleration[in_arc].mean() < 0.4 * GRAVITY
