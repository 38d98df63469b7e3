"""Friction as an interval: what a car in a bend, on a straight and with a certain friction makes of it."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack import MPC, DualTrack, RoadDrive, load_vehicle
from adaptrack.cars.vehicle import pack_plant
from adaptrack.control.controllers import command_of
from adaptrack.control.speed_control import SpeedCommand, SpeedController, friction_estimate
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.speed import friction as kernel
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import World
from adaptrack.road import Arc, Comfort, Line

CAR = load_vehicle("midsize-sedan")
LOW, HIGH, PERIOD = 0.4, 1.0, 0.05
KNOWLEDGE = kernel.LearnedRow(
    lag=0.1, lag_sigma=0.0, dead_time=0.05, dead_time_sigma=0.0, delay_sigma=0.01, stiffness=1.0, stiffness_sigma=0.1,
    balance=1.0, balance_sigma=0.05, bias=0.0, bias_sigma=0.005,
)  # fmt: skip


def _estimate(low: float, high: float) -> kernel.FrictionEstimate:
    actuator = at.SteeringActuator(lag=0.1, rate=1.0, limit=0.5)
    estimate = kernel.FrictionEstimate(
        kernel.FRICTION_MEMORY.new(1), kernel.FRICTION_HYPOTHESIS.new(7), np.zeros(8),
        pack_plant(CAR, at.load_tyre(CAR.tyre), actuator), PERIOD,
        np.array([math.inf, 1e-5, 0.01]), low, high, KNOWLEDGE,
    )  # fmt: skip
    kernel.begin_friction(estimate)
    return estimate


def _take_in(estimate: kernel.FrictionEstimate, **motion: float) -> tuple[float, float]:
    """Ends of the interval after a sample of an unforced car at 20 m/s on a flat road."""
    values = {name: math.nan for name in kernel.FrictionSample._fields} | {"speed": 20.0, "age": 0.0, "command": 0.0}
    kernel.estimate_friction(kernel.FrictionSample(**{**values, **motion}), KNOWLEDGE, 0.0, 0.0, estimate)
    return float(estimate.memory[0].low), float(estimate.memory[0].high)


def _drive(friction: float, control: at.SpeedControl, seconds: float) -> SpeedController:
    """The speed controller of a drive near the limit of the road for some seconds."""
    road = at.generate_road("lap", 11, 1000.0).replace(speed_limit=None, friction=friction)
    plan = at.plan_speed(road, CAR, Comfort(lateral=20.0, grip_share=0.95))
    controller = MPC(CAR, profile="production")
    world = World.of(DualTrack(CAR), controller, "production", control, None, None)
    controller.reset()
    loop = ClosedLoop(world, RoadDrive(road, plan), 1, controller)
    for _ in range(round(seconds / PERIOD)):
        sensed = loop.sensed
        assert not loop.ended
        sensed.measured[MEASUREMENT.vy] = 0.0
        ahead = loop.road_ahead(sensed.speed)
        answer = controller.step(sensed.measured, sensed.speed, sensed.reference, sensed.variables, road=ahead)
        loop.send(command_of(answer, loop.command).angle)
    assert loop.speed_control is not None
    return loop.speed_control


@pytest.mark.compiled
def test_cars_near_their_limit_without_lateral_velocity_tell_slippery_from_dry_roads() -> None:
    intervals = []
    for friction in (0.5, 0.9):
        command = _drive(friction, at.SpeedControl(CAR, friction=(LOW, HIGH)), 20.0).command
        assert command.friction_low <= friction <= command.friction_high
        intervals.append((command.friction_low, command.friction_high))
    slippery, dry = np.array(intervals)
    assert slippery[1] < HIGH - 0.2
    assert dry[0] > LOW + 0.05
    assert dry.mean() > slippery.mean() + 0.15


@pytest.mark.compiled
def test_a_certain_friction_stays() -> None:
    controller = _drive(0.9, at.SpeedControl(CAR, friction=0.6), 10.0)
    assert controller.command.friction_low == controller.command.friction_high == 0.6
    memory, settings = controller.record.memory[0], controller.record.settings
    assert memory.friction == memory.friction_high == memory.cautious_friction == settings.friction


def test_caution_lowers_drive_forces_in_bends_and_spares_the_brakes() -> None:
    road = at.Road.from_segments([Line(length=300.0)], name="straight")
    plan, low = at.plan_speed(road, CAR, Comfort(), top_speed=14.0), 0.3

    def force(speed: float, cautious: float, lateral: float = 0.0) -> float:
        controller = SpeedController(at.SpeedControl(CAR, friction=(low, 1.0)), road, plan, PERIOD)
        memory = controller.record.memory[0]
        memory.friction, memory.friction_high, memory.cautious_friction, memory.lateral = low, 1.0, cautious, lateral
        return controller.step(20.0, speed, lateral / speed).force

    within_low_end = -low * GRAVITY * CAR.mass
    assert within_low_end < force(15.4, 0.2) == force(15.4, low) < 0.7 * within_low_end  # as hard as comfort
    assert force(25.0, 0.2) < within_low_end  # harder: up to the middle of the interval
    assert 0.0 < force(5.0, 0.2, lateral=1.2) < 0.9 * force(5.0, low, lateral=1.2)
    assert force(5.0, 0.2) == force(5.0, low)


def test_a_car_that_slides_gets_no_drive_force_and_is_slower_in_the_bends_of_the_next_seconds() -> None:
    road = at.Road.from_segments([Arc(length=1000.0, curvature=0.01)], name="bend")
    friction, speed = 0.6, 22.0
    controller = SpeedController(
        at.SpeedControl(CAR, friction=friction), road, at.plan_speed(road, CAR, Comfort()), PERIOD
    )
    controller.record.path.square[:] = 30.0**2

    stations = itertools.count(20.0, speed * PERIOD)

    def drive(lateral: float, seconds: float) -> list[SpeedCommand]:
        return [controller.step(next(stations), speed, lateral / speed) for _ in range(round(seconds / PERIOD))]

    steady = drive(speed**2 * 0.01, 1.0)[-1]
    assert steady.force > 0.0
    assert steady.target_speed == pytest.approx(math.sqrt(0.9 * friction * GRAVITY / 0.01), rel=1e-3)
    slide = drive(1.3 * friction * GRAVITY, 1.0)
    assert slide[-1].force <= 0.0
    assert slide[-1].target_speed < 0.95 * steady.target_speed
    targets = [command.target_speed for command in drive(speed**2 * 0.01, 30.0)]
    assert targets == sorted(targets)
    assert targets[-1] == pytest.approx(steady.target_speed, rel=0.01)


def test_a_car_that_sways_on_a_straight_accelerates_less_until_it_has_calmed() -> None:
    road = at.Road.from_segments([Line(length=300.0)], name="straight")
    plan = at.plan_speed(road, CAR, Comfort(), top_speed=16.0)
    laterals = {"straight": [0.0] * 240, "sways": [0.0] * 20 + [4.0, -4.0] * 10 + [0.0] * 200}
    forces: dict[str, list[float]] = {name: [] for name in laterals}
    for name, values in laterals.items():
        controller, station, speed = SpeedController(at.SpeedControl(CAR, friction=0.6), road, plan, PERIOD), 20.0, 10.0
        for lateral in values:
            forces[name].append(controller.step(station, speed, lateral / speed).force)
            station, speed = station + PERIOD * speed, speed + PERIOD * forces[name][-1] / CAR.mass
    assert 0.0 <= max(forces["sways"][35:40]) < 0.7 * min(forces["straight"][35:40])
    assert forces["sways"][-1] == pytest.approx(forces["straight"][-1], abs=0.02 * CAR.mass)


def test_a_straight_leaves_the_interval() -> None:
    estimate = _estimate(LOW, HIGH)
    for _ in range(60):
        low, high = _take_in(estimate, yaw_rate=0.0, lateral_acceleration=0.0)
    spacing = (HIGH - LOW) / 6
    assert (low, high) == pytest.approx((LOW, HIGH), abs=0.3 * spacing)


def test_the_force_that_the_tyres_have_used_is_a_lower_bound() -> None:
    estimate, used = _estimate(LOW, HIGH), 0.8
    for _ in range(300):
        low, _ = _take_in(estimate, lateral_acceleration=used * GRAVITY)
    assert low > kernel.USED_MARGIN * used - (HIGH - LOW) / 6


def test_an_interval_that_has_narrowed_widens_slowly_on_a_straight() -> None:
    estimate = _estimate(LOW, HIGH)
    for _ in range(300):
        narrow, _ = _take_in(estimate, lateral_acceleration=0.8 * GRAVITY)
    after = [_take_in(estimate, yaw_rate=0.0, lateral_acceleration=0.0)[0] for _ in range(600)]
    assert after[50] > narrow - 0.03
    assert after[-1] < narrow - 0.05


def test_a_rate_limit_of_the_car_does_not_act_on_steering_without_lag():
    """As without a limit: the wheels are where the command is."""
    free = CAR.replace(steering=CAR.steering.replace(rate=None))
    estimates = [friction_estimate((LOW, HIGH), car, PERIOD, MPC(car, profile="paper")) for car in (CAR, free)]
    assert math.isfinite(CAR.steering.rate)
    np.testing.assert_array_equal(estimates[0].car, estimates[1].car)
