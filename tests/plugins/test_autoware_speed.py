"""Autoware's longitudinal structure as a driver: what its documentation promises of an ideal car."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import adaptrack as at
from adaptrack import MPC, DualTrack, RoadDrive, load_vehicle, simulate
from adaptrack.control.speed_control import SpeedState
from adaptrack.road import Arc, Comfort, Line, Stop
from autoware_speed import AutowareSpeed

CAR = load_vehicle("midsize-sedan")
PERIOD = 0.05


def _straight(**along: object) -> at.Road:
    return at.Road.from_segments([Line(length=300.0)], name="straight").replace(**along)


def _plan(road: at.Road):
    return at.plan_speed(
        road, CAR, Comfort(accelerate=1.0, brake=1.0, jerk=1.0), stops=[Stop(150.0, 2.0)], top_speed=10.0
    )


def test_an_ideal_car_follows_the_plan_stands_at_the_stop_and_goes_on() -> None:
    road = _straight()
    plan = _plan(road)
    follower = AutowareSpeed(CAR, delay_compensation_time=0.0).begin(road, plan, PERIOD)
    s, v, states, errors, stand = 0.0, 0.0, set(), [], []
    for _ in range(1200):
        request = follower.step(s, v, 0.0)
        states.add(request.state)
        v = max(v + PERIOD * request.acceleration, 0.0)
        s += PERIOD * v
        if v == 0.0 and s > 100.0:
            stand.append(s)
        if request.state == SpeedState.DRIVING and 80.0 < s < 140.0:
            errors.append(v - float(plan.at(s)))
    assert max(map(abs, errors)) < 0.5
    assert abs(stand[0] - 150.0) < 0.3
    assert len(stand) * PERIOD >= 2.0
    assert s > 250.0
    assert states >= {SpeedState.DRIVING, SpeedState.STOPPING, SpeedState.STOPPED}


def test_a_slope_changes_the_force_by_its_gravity_and_not_the_acceleration() -> None:
    flat, steep = (_straight(grade=grade) for grade in (0.0, 0.05))
    level, uphill = (AutowareSpeed(CAR).begin(road, _plan(flat), PERIOD).step(50.0, 8.0, 0.0) for road in (flat, steep))
    assert uphill.acceleration == level.acceleration
    expected = CAR.mass * 9.80665 * np.sin(np.arctan(0.05))
    assert uphill.force - level.force == pytest.approx(expected, rel=1e-3)


def test_a_car_that_overruns_its_stop_brakes_as_in_an_emergency_until_it_stands() -> None:
    follower = AutowareSpeed(CAR).begin(_straight(), _plan(_straight()), PERIOD)
    requests = [follower.step(152.0, 6.0, 0.0) for _ in range(40)]
    assert requests[0].state == SpeedState.EMERGENCY
    assert np.diff([request.acceleration for request in requests]).min() >= -3.0 * PERIOD - 1e-9
    assert requests[-1].acceleration == -5.0


def test_a_stop_of_a_closed_road_that_is_left_comes_again_a_lap_later() -> None:
    ring = at.Road.from_segments([Arc(length=300.0, curvature=2.0 * np.pi / 300.0)], name="ring", closed=True)
    follower = AutowareSpeed(CAR).begin(ring, _plan(ring), PERIOD)
    for _ in range(60):
        follower.step(150.0, 0.0, 0.0)
    assert follower.step(155.0, 5.0, 0.0).state == SpeedState.DRIVING
    assert follower.step(449.8, 0.5, 0.0).state == SpeedState.STOPPING


def test_it_drives_a_simulated_car_whose_requests_are_recorded() -> None:
    road = at.Road.from_segments([Line(length=80.0)], name="short")
    plan = at.plan_speed(road, CAR, Comfort(accelerate=1.5, brake=1.5), top_speed=8.0)
    run = simulate(DualTrack(CAR), MPC(CAR, profile="road"), RoadDrive(road, plan), driver=AutowareSpeed(CAR))
    assert run.failed is None
    moving = run.vx > 3.0
    assert np.sqrt(np.mean((run.vx - plan.at(run.road["station"]))[moving] ** 2)) < 0.5
    assert np.isfinite(run.diagnostics["requested_force"][moving]).all()


def test_a_driver_of_your_own_needs_a_road_and_finite_forces() -> None:
    controller = MPC(CAR, profile="road")
    with pytest.raises(at.InvalidInput, match="AutowareSpeed follows a plan along a road"):
        simulate(DualTrack(CAR), controller, at.load_scenario("double-lane-change"), driver=AutowareSpeed(CAR))
    wild = SimpleNamespace(force=float("nan"), hold=0.0)
    driver = SimpleNamespace(begin=lambda path, plan, period: SimpleNamespace(step=lambda *_: wild))
    road = _straight()
    with pytest.raises(at.ContractError, match="the force must be finite"):
        simulate(DualTrack(CAR), controller, RoadDrive(road, _plan(road)), driver=driver)
