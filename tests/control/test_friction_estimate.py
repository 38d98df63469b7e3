"""Friction as an interval: what a car in a bend, on a straight and with a certain friction makes of it."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import adaptrack as at
from adaptrack import MPC, DualTrack, RoadDrive, load_vehicle
from adaptrack.cars.vehicle import pack_plant
from adaptrack.control.controllers import command_of
from adaptrack.control.speed_control import SpeedCommand, SpeedController, friction_estimate
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics import tyre
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


def _estimate(low: float, high: float, shape: float = 0.0) -> kernel.FrictionEstimate:
    actuator = at.SteeringActuator(lag=0.1, rate=1.0, limit=0.5)
    estimate = kernel.FrictionEstimate(
        kernel.FRICTION_MEMORY.new(1), kernel.FRICTION_HYPOTHESIS.new(14), np.zeros(8),
        pack_plant(CAR, at.load_tyre(CAR.tyre), actuator), PERIOD,
        np.array([math.inf, 1e-5, 0.01]), low, high, shape, 0.0, KNOWLEDGE,
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
        command = _drive(friction, at.SpeedControl(CAR, friction=(LOW, HIGH), tyre_shape="file"), 20.0).command
        assert command.friction_low <= friction <= command.friction_high
        intervals.append((command.friction_low, command.friction_high))
    slippery, dry = np.array(intervals)
    assert slippery[1] < HIGH - 0.05
    assert dry[0] > LOW + 0.05
    assert dry.mean() > slippery.mean() + 0.05


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


def test_the_acceleration_that_the_tyres_use_is_a_lower_bound_less_wind_and_errors_of_the_sensor() -> None:
    estimate, used = _estimate(LOW, HIGH), 0.8
    for _ in range(300):
        low, _ = _take_in(estimate, lateral_acceleration=used * GRAVITY)
    assert LOW + 0.1 < low < used


def test_low_end_and_high_end_return_to_what_was_told_over_the_stated_way() -> None:
    estimate, bend = _estimate(LOW, HIGH), 0.8 * GRAVITY
    for _ in range(300):
        narrow, _ = _take_in(estimate, lateral_acceleration=bend, yaw_rate=bend / 20.0)
    memory, step = estimate.memory[0], 20.0 * PERIOD
    assert memory.age == 0.0
    for left in np.linspace(0.9, 0.0, 10):  # a friction that falls looks like a bend that ends at once
        _take_in(estimate, lateral_acceleration=left * bend, yaw_rate=left * bend / 20.0)
    periods = math.ceil(kernel.RETURN_DISTANCE / step) + 20  # the filter of the used acceleration takes some
    straight = [_take_in(estimate, yaw_rate=0.0, lateral_acceleration=0.0) for _ in range(periods)]
    assert straight[20][0] > narrow - 0.1
    assert straight[-1] == (LOW, HIGH)
    assert memory.age == kernel.RETURN_DISTANCE


def test_a_rate_limit_of_the_car_does_not_act_on_steering_without_lag():
    """As without a limit: the wheels are where the command is."""
    free = CAR.replace(steering=CAR.steering.replace(rate=None))
    controls = [at.SpeedControl(car, friction=(LOW, HIGH)) for car in (CAR, free)]
    estimates = [friction_estimate(control, PERIOD, MPC(control.car, profile="paper")) for control in controls]
    assert math.isfinite(CAR.steering.rate)
    np.testing.assert_array_equal(estimates[0].car, estimates[1].car)


# -- tyres with other curves -------------------------------------------------------------------------------------------
CURVES: dict[str, Callable[[float], float]] = {
    "tanh": math.tanh,
    "brush": lambda x: math.copysign(1.0 - max(1.0 - abs(x) / 3.0, 0.0) ** 3, x),
    "late": lambda x: math.sin(1.9 * math.atan(x / 1.9)),
}
"""Lateral force over friction times load; x: stiffness times slip over friction times load."""


def _flattened(x: float) -> float:
    """A wave with flat tops."""
    return min(max(2.0 * x, -1.0), 1.0)


def _weave(
    friction: float, curve: Callable[[float], float], estimate: kernel.FrictionEstimate, share: float,
    fallen: float | None = None,
) -> Any:  # fmt: skip
    """Ends of the interval in bends to both sides, at a share of the grip, on tyres whose load does not move.

    fallen: friction from half of the time on.
    """
    wheels, vy, r, speed, step, weight = 0.0, 0.0, 0.0, 20.0, PERIOD / 25.0, CAR.mass * GRAVITY / CAR.wheelbase
    front, rear = (2.0 * stiffness for stiffness in (CAR.stiffness_front, CAR.stiffness_rear))
    grip, random = friction * GRAVITY, np.random.default_rng(1)
    sent, ends = [0.0] * 2, []
    for k in range(1200):
        if k == 600 and fallen is not None:
            friction, grip = fallen, fallen * GRAVITY
        demand = share * grip / speed * _flattened(math.sin(2.0 * math.pi * k / 160.0))
        sent = [0.2 * (demand - r) + demand * CAR.wheelbase / speed, sent[0]]
        for _ in range(25):
            wheels += step / KNOWLEDGE.lag * (sent[1] - wheels)
            slips = wheels - (vy + CAR.lf * r) / speed, -(vy - CAR.lr * r) / speed
            loads = friction * weight * CAR.lr, friction * weight * CAR.lf
            sides = [load * curve(stiffness * slip / load)
                     for load, stiffness, slip in zip(loads, (front, rear), slips, strict=True)]  # fmt: skip
            lateral = sum(sides) / CAR.mass
            vy += step * (lateral - speed * r)
            r += step * (CAR.lf * sides[0] - CAR.lr * sides[1]) / CAR.yaw_inertia
        noise = random.standard_normal(2)
        ends.append(
            _take_in(
                estimate, command=sent[0], yaw_rate=r + 0.003 * noise[0], lateral_acceleration=lateral + 0.1 * noise[1]
            )
        )  # fmt: skip
    return np.array(ends)


@pytest.mark.compiled
@pytest.mark.parametrize("friction", [0.55, 0.75])
@pytest.mark.parametrize("curve", CURVES)
def test_the_friction_is_not_overestimated_on_tyres_of_another_curve(curve: str, friction: float) -> None:
    ends = _weave(friction, CURVES[curve], _estimate(LOW, HIGH), 0.9)
    assert ends[:, 0].max() <= friction + 0.02
    assert ends[:, 0].max() > LOW + 0.02
    assert ends[:, 1].min() >= friction


@pytest.mark.compiled
@pytest.mark.parametrize("curve", ["brush", "late"])
def test_a_friction_that_falls_is_noticed_within_two_bends(curve: str) -> None:
    ends = _weave(0.9, CURVES[curve], _estimate(LOW, HIGH), 0.9, fallen=0.55)
    assert ends[599, 0] > 0.6
    assert ends[600 + 2 * 80, 0] < 0.55
    steady = _weave(0.9, CURVES[curve], _estimate(LOW, HIGH), 0.9)
    assert steady[600 + 2 * 80, 0] > 0.6


@pytest.mark.compiled
def test_a_known_shape_narrows_the_interval() -> None:
    without, with_shape = (_weave(0.75, CURVES["tanh"], _estimate(LOW, HIGH, shape), 0.9)[-1] for shape in (0.0, 1.35))
    assert with_shape[1] - with_shape[0] < without[1] - without[0]


@pytest.mark.parametrize("shape", ["round", 1.0, 2.5])
def test_a_shape_that_no_curve_has_is_refused(shape: Any) -> None:
    with pytest.raises(at.InvalidInput, match="tyre_shape"):
        at.SpeedControl(CAR, friction=(LOW, HIGH), tyre_shape=shape)


@pytest.mark.kernels
def test_the_curves_of_tyres_begin_with_their_stiffness_and_their_slope_is_the_derivative() -> None:
    for shape in (tyre.BRUSH_SHAPE, 1.2, 1.9):
        law = tyre.curve(4000.0, 1e5, 0.8, shape)
        for slip in (-0.12, -0.02, 0.0, 0.01, 0.05, 0.2):
            force, slope = tyre.force_and_slope(slip, law)
            above, below = (tyre.force_and_slope(slip + step, law)[0] for step in (1e-6, -1e-6))
            assert slope == pytest.approx((above - below) / 2e-6, abs=2.0)
            assert abs(force) <= 0.8 * 4000.0
        assert tyre.force_and_slope(0.0, law) == (0.0, 1e5)


def test_the_slope_of_a_brush_is_that_of_its_curve_at_the_used_share() -> None:
    law = tyre.curve(4000.0, 1e5, 0.8, tyre.BRUSH_SHAPE)
    for slip in (0.0, 0.01, 0.05, 0.09):
        force, slope = tyre.force_and_slope(slip, law)
        assert tyre.brush_slope(force / 3200.0) == pytest.approx(slope / 1e5, abs=1e-9)


@pytest.mark.compiled
def test_a_certain_friction_keeps_a_reserve_while_the_steering_is_learned_or_the_driven_axle_is_assumed() -> None:
    control = at.SpeedControl(CAR, friction=0.6)
    assumed = at.SpeedControl(CAR.replace(estimated=(*CAR.estimated, "drive_front")), friction=0.6)
    for speed_control, expected in ((control, 0.0), (assumed, kernel.CERTAIN_RESERVE)):
        controller = _drive(0.9, speed_control, 1.0)
        memory, friction = controller.record.memory[0], controller.record.settings.friction
        assert memory.cautious_friction == pytest.approx((1.0 - expected) * friction, rel=1e-12)
        assert memory.friction == friction
