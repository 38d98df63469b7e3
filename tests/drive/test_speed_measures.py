"""What a drive records of its speed: planned at the place of the car, requests with their reasons, stops and delay."""

import dataclasses

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.speed_control import SpeedLimit, SpeedState
from adaptrack.drive.speed_measures import measure_stops, speed_measures
from adaptrack.results.record import REPLAYED_SIGNALS, DriveRecord
from adaptrack.road import Arc, Stop
from adaptrack.road.speed import constant_speed
from made_drives import made_run

CAR = at.load_vehicle("midsize-sedan")
STOP = Stop(150.0, 3.0)


@pytest.fixture(scope="module")
def drive():
    road = at.generate_road("country", seed=1, length=300.0)
    return at.RoadDrive(road, at.plan_speed(road, CAR, start=0.0, stops=[STOP]))


@pytest.fixture(scope="module")
def run(drive):
    control = at.SpeedControl(CAR, friction=(0.6, 1.0))
    return at.simulate(at.DualTrack(CAR), at.MPC(CAR, profile="road"), drive, profile="road", driver=control)


@pytest.mark.compiled
@pytest.mark.parametrize("driver", [None, "driver", "speed control"])
def test_the_planned_speed_is_that_of_the_place_and_not_of_the_time(drive, run, driver):
    if driver != "speed control":
        moved_by = None if driver is None else at.Driver()
        run = at.rollout(at.DualTrack(CAR), at.MPC(CAR, profile="road"), drive, profile="road", driver=moved_by)
    planned, station = run.road["planned_speed"], run.road["station"]
    assert planned == pytest.approx(drive.plan.at(station), abs=1e-12)
    if driver is not None:
        assert np.abs(planned - run.v_ref).max() > 1.0  # it is late behind the stop
    record = DriveRecord.from_trajectory(run, drive.road)
    station = record.run.road["station"]
    assert REPLAYED_SIGNALS["planned_speed"][0](record.run) == pytest.approx(drive.plan.at(station), abs=1e-12)


@pytest.mark.compiled
def test_the_file_of_a_drive_with_speed_control_holds_its_signals_with_units(drive, run, tmp_path):
    run.save(tmp_path / "run.parquet")
    loaded = at.Trajectory.load(tmp_path / "run.parquet")
    signals, driven = loaded.diagnostics, np.isfinite(loaded.command)
    units = {name: loaded.units[f"diagnostics.{name}"] for name in signals}
    assert units["governed_speed"] == units["target_speed"] == loaded.units["road.planned_speed"] == "m/s"
    assert units["longitudinal_acceleration"] == "m/s^2"
    cell = [drive.plan.at(loaded.road["station"] + step) for step in np.linspace(-1.5, 1.5, 13)]  # m
    assert (signals["governed_speed"] <= np.max(cell, axis=0) + 0.02)[driven].all()
    low, high, true = signals["friction_low"], signals["friction_high"], loaded.friction.mean(axis=1)
    assert ((low <= true) & (true <= high))[driven].all()
    moved = np.concatenate([[0.0], np.cumsum(signals["longitudinal_acceleration"])]) * loaded.period
    assert moved[:-1] == pytest.approx(loaded.vx - loaded.vx[0], abs=0.3)
    stopped = signals["speed_state"] == list(SpeedState).index(SpeedState.STOPPED)
    at_stop = signals["limited_by"] == list(SpeedLimit).index(SpeedLimit.STOP)
    assert stopped.sum() * loaded.period == pytest.approx(STOP.seconds, abs=0.2)
    assert at_stop[loaded.vx < 0.01][20:-20].any()


@pytest.mark.compiled
def test_a_stop_is_measured_where_and_as_long_as_the_car_stood(drive, run):
    (stop,) = measure_stops(run, drive.plan)
    standing = (run.vx < 0.01) & (run.road["station"] > 100.0)
    assert (stop.place, stop.seconds) == (STOP.s, STOP.seconds)
    assert stop.error == pytest.approx(run.road["station"][standing][0] - STOP.s, abs=0.05)
    assert STOP.seconds <= stop.stood <= STOP.seconds + 1.5


def test_stops_and_delay_count_over_all_laps():
    radius, speed, period = 50.0, 10.0, 0.05
    lap = 2.0 * np.pi * radius
    road = at.Road.from_segments([Arc(length=lap, curvature=1.0 / radius)], closed=True, name="circle")
    constant = constant_speed(road, speed)
    plan = at.plan_speed(road, CAR, stops=[Stop(100.0)])
    n = round(2.5 * lap / (0.9 * speed) / period)
    time = period * np.arange(n)
    zeros, station = np.zeros(n), 0.9 * speed * time
    signals = {"station": station, "offset": zeros, "heading_error": zeros}
    made = made_run(road, seconds=n * period).trajectory
    run = dataclasses.replace(made, vx=zeros + 0.9 * speed, lateral_acceleration=zeros, road=dict(made.road) | signals)
    assert speed_measures(run, road, constant)["time_lost"] == pytest.approx(0.1 * run.t[-1])
    assert [stop.place for stop in measure_stops(run, plan)] == pytest.approx([100.0, 100.0 + lap, 100.0 + 2.0 * lap])
    assert all(np.isnan(stop.error) for stop in measure_stops(run, plan))
