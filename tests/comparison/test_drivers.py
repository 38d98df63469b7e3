"""Whole drivers compared: their names and options, measures of known motions, and runs without a rank."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

import adaptrack as at
from adaptrack.comparison import run as study
from adaptrack.comparison.config import ComparisonConfig
from adaptrack.comparison.run import run_comparison
from adaptrack.comparison.table import driver_rows
from adaptrack.core.public import GRAVITY
from adaptrack.drive import drivers
from adaptrack.drive.drivers import check_forces, list_drivers, make_driver, register_driver
from adaptrack.drive.speed_measures import STOP_DISTANCE, speed_measures
from adaptrack.drive.trajectory import TRAJECTORY_COLUMNS
from adaptrack.results.compare import DRIVER_COLUMNS, compare_drivers_result
from adaptrack.results.page import render_result
from adaptrack.road import Arc, Line, Stop
from adaptrack.road.speed import constant_speed

CAR = at.load_vehicle("midsize-sedan")
PERIOD = 0.05
TINY: dict[str, Any] = {
    "name": "tiny", "contenders": ["informed"], "cars": ["paper"], "profiles": ["road"], "training": ["country:101"],
    "roads": ["country:1"], "length": 200.0, "seeds": [0], "budget": 0, "entry_speeds": False,
}  # fmt: skip


# -- names and options ------------------------------------------------------------------------------------------------
def test_a_driver_is_made_by_its_name_with_its_options():
    assert make_driver("prescribed", CAR) is None
    assert make_driver("driver:guard=0.5", CAR) == at.Driver(guard=0.5)
    expected = at.SpeedControl(CAR, friction=(0.6, 0.9), governor=0.8)
    assert make_driver("speed-control:friction=0.6:0.9,governor=0.8", CAR) == expected


@pytest.mark.parametrize(("changes", "words"), [
    ({"drivers": ["speedcontrol"]}, "Did you mean 'speed-control'"),
    ({"drivers": ["driver:gard=0.5"]}, "'gard'; options, as in friction=0.6:0.9: preview, integral, guard"),
    ({"drivers": ["driver:guard=high"]}, "driver 'driver:guard=high': guard = 'high': must be a number, or two"),
    ({"drivers": ["speed-control:friction=0.9:0.6"]}, r"friction = \(0.9, 0.6\)"),
    ({"drivers": ["driver"], "budget": 50}, "need budget = 0"),
    ({"frictions": [0.0]}, "greater than 0"),
    ({"planner": "delay=soon"}, "planner 'delay=soon': delay = 'soon': must be a finite number >= 0."),
    ({"planner": "delay=0.1", "budget": 50}, "planner: needs budget = 0"),
    ({"planner": "delay=0.1", "drivers": ["speed-control", "driver"]}, "planner: does not drive with 'driver'"),
])  # fmt: skip
def test_a_driver_that_is_not_possible_is_refused_with_the_reason(changes: dict[str, Any], words: str):
    with pytest.raises(at.AdaptrackError, match=words):
        ComparisonConfig(**{**TINY, **changes})


def test_controllers_behind_a_planner_are_compared_with_equal_noise():
    task = ComparisonConfig(**TINY | {"contenders": ["informed", "stanley"]}, planner="delay=0.1")
    columns = run_comparison(task).columns
    assert not columns["failed"].any()
    assert columns["contender"].tolist() == ["informed", "stanley"]
    assert (columns["rms_error"] < 0.5).all()
    with pytest.raises(at.InvalidInput, match="has no road along which to plan"):
        run_comparison(ComparisonConfig(**TINY | {"roads": ["random-drive:1"]}, planner="delay=0.1"))


def test_drivers_need_a_road_and_a_plant_that_forces_move(monkeypatch: pytest.MonkeyPatch):
    with pytest.raises(at.InvalidInput, match="need roads, not scenarios"):
        run_comparison(ComparisonConfig(**{**TINY, "drivers": ["driver"], "roads": ["random-drive:1"]}))
    check_forces(at.DualTrack(CAR))
    check_forces(at.SingleTrack(CAR))
    monkeypatch.setattr(at.SingleTrack, "derivative", lambda plant, x, u, environment: np.zeros(6))
    with pytest.raises(at.InvalidInput, match="'single-track': its right-hand side ignores the force"):
        check_forces(at.SingleTrack(CAR))


# -- measures ---------------------------------------------------------------------------------------------------------
def motion(speed: np.ndarray, **changes: Any) -> at.Trajectory:
    """A run along a road with a speed at each control instant (m/s)."""
    n = len(speed)
    shapes = {column.name: (n, len(column.parts)) if column.parts else (n,) for column in TRAJECTORY_COLUMNS}
    arrays = {column.name: np.zeros(shapes[column.name], column.dtype) for column in TRAJECTORY_COLUMNS}
    station = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * PERIOD)])
    arrays |= {"t": PERIOD * np.arange(n), "vx": speed} | changes
    zeros = np.zeros(n)
    return at.Trajectory(**arrays, period=PERIOD, road={"station": station, "offset": zeros, "heading_error": zeros})


def test_a_car_that_is_a_tenth_slower_than_its_plan_loses_a_tenth_of_the_way_and_of_the_time():
    road = at.Road.from_segments([Line(length=1000.0)], name="straight")
    drive = at.RoadDrive(road, constant_speed(road, 20.0))
    measures = speed_measures(motion(np.full(801, 18.0)), drive.road, drive.plan)
    assert measures["way_driven"] == pytest.approx(0.9)
    assert measures["time_lost"] == pytest.approx(40.0 - 40.0 * 0.9)
    assert measures["speed_error"] == pytest.approx(2.0)
    assert measures["longitudinal_jerk"] == pytest.approx(0.0, abs=1e-9)
    assert measures["used_grip"] == pytest.approx(0.0, abs=1e-9)
    assert measures["stop_error"] is None


def test_the_used_grip_on_a_circle_is_the_acceleration_over_the_true_friction():
    road = at.Road.from_segments([Arc(length=300.0, curvature=0.01)], name="bend").replace(friction=0.6)
    drive = at.RoadDrive(road, constant_speed(road, 15.0))
    t = PERIOD * np.arange(200)
    run = motion(15.0 + 0.5 * t, lateral_acceleration=np.full(200, 3.0))
    used_grip = speed_measures(run, drive.road, drive.plan)["used_grip"]
    assert used_grip == pytest.approx(math.hypot(0.5, 3.0) / (0.6 * GRAVITY))


@pytest.mark.parametrize(("distance", "error"), [(96.0, 4.0), (101.5, 1.5), (150.0, STOP_DISTANCE)])
def test_the_stop_error_is_where_the_car_stood_and_a_stop_that_was_passed_counts_fully(distance: float, error: float):
    road = at.Road.from_segments([Line(length=300.0)], name="straight")
    drive = at.RoadDrive(road, at.plan_speed(road, CAR, stops=[Stop(100.0, 2.0)], top_speed=10.0))
    braking = 10.0 - 2.0 * PERIOD * np.arange(101)
    speed = np.concatenate([np.full(round((distance - 25.0) / 10.0 / PERIOD) + 1, 10.0), braking[1:], np.zeros(40)])
    assert speed_measures(motion(speed), drive.road, drive.plan)["stop_error"] == pytest.approx(error, abs=0.01)


# -- driven -----------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_drivers_are_compared_on_the_same_runs_without_a_rank_and_continue_where_they_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(drivers._registry, "factories", dict(drivers._registry.factories))
    register_driver("mine", lambda car, gain=2.0: at.SpeedControl(car, gain=gain))
    assert "mine" in list_drivers()
    names = ["prescribed", "driver", "speed-control", "mine:gain=2"]
    task = ComparisonConfig(**TINY, drivers=names, stops=[120.0], frictions=[0.9, 0.7])
    comparison = run_comparison(task, tmp_path)
    monkeypatch.setattr(study, "run_cell", None)  # all cells are stored
    assert run_comparison(task, tmp_path).cells == comparison.cells
    assert list(comparison.profile_comparisons) == ["road, friction 0.9", "road, friction 0.7"]
    rows = driver_rows(comparison.profile_comparisons["road, friction 0.9"])
    assert [row["driver"] for row in rows] == names
    measures = [[row[column.name] for column in DRIVER_COLUMNS] for row in rows]
    assert measures[2] == measures[3]  # the same driver by another name
    assert measures[0] != measures[1] != measures[2]
    assert max(row["stop_error"] for row in rows) < 0.5
    assert not any("rank" in row for row in rows)
    result = compare_drivers_result(comparison)
    assert "speed-control" in render_result(result)
    assert {len(table.rows) for table in result.tables if table.brief} == {len(names)}


@pytest.mark.compiled
def test_the_prescribed_driver_drives_as_a_comparison_with_prescribed_speeds():
    plain = run_comparison(ComparisonConfig(**TINY, prescribed_speed=True)).columns
    with_driver = run_comparison(ComparisonConfig(**TINY, drivers=["prescribed"])).columns
    for name in set(plain) - {"contender"}:
        np.testing.assert_array_equal(with_driver[name], plain[name], err_msg=name)
