"""The measures of a drive equal their definitions by hand; a broken run is a clear result, never a crash."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.cars.vehicle import Body, load_vehicle
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.metrics import PathRecord, compute_metrics, path_metrics, published_mse
from adaptrack.drive.trajectory import TRAJECTORY_COLUMNS, Trajectory
from adaptrack.road import Arc, Line
from adaptrack.road.road import Road

NAN, INF = float("nan"), float("inf")
BOX = Outline(front=2.0, rear=2.5, width=1.8)
T = np.arange(0.0, 60.0, 0.05)


def record(n=8, period=0.1, **changes):
    """A car at 10 m/s on a straight reference, nothing measured; `changes` replace arrays (scalars fill them)."""
    arrays = {}
    for column in TRAJECTORY_COLUMNS:
        shape = (n, len(column.parts)) if column.parts else (n,)
        arrays[column.name] = np.zeros(shape, dtype=column.dtype)
    arrays |= {"t": period * np.arange(n), "vx": np.full(n, 10.0), "step_time": np.full(n, NAN)}
    zeros = np.zeros(n, np.int64)
    diagnostics = {"qp_status": zeros, "qp_iterations": zeros, "qp_residual": np.zeros(n), "at_limit": zeros}
    diagnostics |= {key: np.broadcast_to(value, (n,)) for key, value in changes.items() if key in diagnostics}
    arrays |= {key: np.broadcast_to(value, arrays[key].shape) for key, value in changes.items() if key in arrays}
    options = {key: value for key, value in changes.items() if key not in diagnostics and key not in arrays}
    return Trajectory(**arrays, period=period, **({"diagnostics": diagnostics} | options))


def test_tracking_measures_are_those_of_a_hand_calculation():
    metrics = compute_metrics(record(n=4, Y=[1.0, -2.0, 3.0, 0.0], y_ref=[0.0, 0.0, 1.0, 1.0]))
    assert metrics.mse == pytest.approx((1 + 4 + 4 + 1) / 4)
    assert metrics.rms_error == pytest.approx(math.sqrt(2.5))
    assert metrics.max_abs_error == 2.0
    assert not metrics.failed
    assert math.isnan(metrics.failed_at)


def test_a_sine_has_the_rms_of_a_sine():
    t = 0.1 * np.arange(1000)
    sine, cosine = np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)
    run = record(n=1000, command=0.2 * sine, command_change=0.01 * cosine, lateral_acceleration=3.0 * sine)
    metrics = compute_metrics(run)
    assert metrics.steering_rms == pytest.approx(0.2 / math.sqrt(2))
    assert metrics.steering_rate_rms == pytest.approx(0.1 / math.sqrt(2))
    assert metrics.steering_activity == pytest.approx(0.01**2 / 2)
    assert metrics.lateral_acceleration_rms == pytest.approx(3.0 / math.sqrt(2))
    chord = 2 * 3.0 * math.sin(math.pi * 0.1) / 0.1  # amplitude of the differences of a sine
    assert metrics.jerk_rms == pytest.approx(chord / math.sqrt(2), rel=1e-3)


def test_the_papers_cost_is_the_mse_and_the_road_charges_activity():
    run = record(Y=0.5, command_change=0.1)
    assert compute_metrics(run).cost == compute_metrics(run).mse == 0.25
    assert compute_metrics(run, move_weight=2.0).cost == pytest.approx(0.25 + 2.0 * 0.01)
    road = record(Y=0.5, command_change=0.1, meta={"profile": "road", "move_weight": 3.0})
    assert compute_metrics(road).cost == pytest.approx(0.25 + 3.0 * 0.01)


def test_heading_is_judged_only_at_one_metre_per_second_or_more():
    metrics = compute_metrics(record(n=4, vx=[0.5, 0.99, 1.0, 5.0], psi=[3.0, 2.0, 0.3, -0.4]))
    assert metrics.heading_max == pytest.approx(0.4)
    assert metrics.heading_rms == pytest.approx(math.sqrt((0.09 + 0.16) / 2))
    assert math.isnan(compute_metrics(record(vx=0.0)).heading_rms)


def test_limits_qps_and_held_angles_are_counted_up_to_the_end_of_the_run():
    command = np.append(np.zeros(8), [NAN, NAN])
    run = record(
        n=10, command=command, at_limit=[0, 1, 2, 3, 4, 5, 0, 0, 7, 7], qp_status=[0, 0, 0, 1, 2, 3, 4, 9, 0, 0],
        held=[0, 0, 0, 1, 1, 1, 1, 1, 1, 1], qp_residual=[1e-12, NAN, 1e-9, 1e-3, 7.0, 7.0, 7.0, 7.0, 7.0, 7.0],
        step_time=1e-6 * np.arange(10),
    )  # fmt: skip
    metrics = compute_metrics(run)
    assert (metrics.steps, metrics.driven) == (10, 8)
    assert (metrics.at_change_limit, metrics.at_angle_limit, metrics.at_output_limit) == (3 / 8, 2 / 8, 2 / 8)
    assert metrics.at_any_limit == 5 / 8
    assert (metrics.qp_solved, metrics.qp_capped, metrics.qp_failed, metrics.held) == (3, 1, 4, 5)
    assert metrics.qp_residual_max == 1e-3
    assert (metrics.step_us_p50, metrics.step_us_max) == (pytest.approx(4.5), pytest.approx(9.0))
    reckoned = {**run.diagnostics, "dead_reckoning": 0.1 * np.arange(10.0)}
    blind = compute_metrics(dataclasses.replace(run, diagnostics=reckoned))
    assert (blind.dead_reckoning, blind.dead_reckoning_max) == (2, pytest.approx(0.7))


def test_what_a_controller_does_not_record_is_unknown():
    metrics = compute_metrics(record(Y=1.0, diagnostics={}))
    assert (metrics.qp_solved, metrics.qp_capped, metrics.qp_failed, metrics.dead_reckoning) == (0, 0, 0, 0)
    for name in ("qp_residual_max", "qp_iterations_mean", "at_any_limit", "dead_reckoning_max", "step_us_p50"):
        assert math.isnan(getattr(metrics, name)), name
    assert (metrics.mse, metrics.failed) == (1.0, False)


@pytest.mark.parametrize("name", ["X", "Y", "psi", "vx", "vy", "yaw_rate", "steering", "command"])
@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_a_state_that_is_not_finite_is_a_failed_run_of_infinite_cost(name, value):
    values = np.full(8, 10.0 if name == "vx" else 0.0)
    values[5:] = value
    metrics = compute_metrics(record(**{name: values}), move_weight=3.0)
    assert metrics.failed
    assert metrics.failed_at == pytest.approx(0.5)
    assert "not finite" in metrics.failed_because
    assert metrics.failed_reason == "not-finite"
    assert metrics.mse == metrics.rms_error == metrics.max_abs_error == metrics.cost == INF


def test_a_row_is_strict_json_even_for_a_failed_run():
    row = compute_metrics(record(Y=NAN)).as_row()
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    assert (row["mse"], row["failed"]) == (None, True)


def test_a_run_fails_by_the_rule_that_is_chosen_and_one_that_diverges_gives_numbers_not_warnings():
    off = record(Y=[0.0] * 7 + [6.0])
    assert compute_metrics(off).failed
    assert not compute_metrics(off, failure=FailureLimits(distance=7.0)).failed
    huge = compute_metrics(record(Y=np.geomspace(1.0, 1e300, 8), lateral_acceleration=np.geomspace(1, 1e308, 8)))
    assert (huge.failed, huge.mse) == (True, INF)


@given(st.lists(st.floats(-4.9, 4.9), min_size=2, max_size=30))
def test_mirrored_runs_have_the_same_measures(errors):
    values = np.array(errors)
    signals = {"Y": values, "psi": values / 9, "command": values / 8, "lateral_acceleration": values}
    left = compute_metrics(record(n=values.size, **signals))
    right = compute_metrics(record(n=values.size, **{key: -value for key, value in signals.items()}))
    assert left.as_row() == pytest.approx(right.as_row())


PAPER_RUN = {"scenario": "triple-lane-change", "profile": "paper", "preview": False, "controller": "standard"}


@pytest.mark.parametrize(
    ("changes", "n", "expected"),
    [
        ({}, 280, 0.0318),
        ({"controller": "NN-MPC"}, 280, 0.0051),
        ({"controller": "standard MPC (laguerre 0.95)"}, 280, 0.0318),
        ({"controller": "scheduled MPC (pulse)"}, 280, None),
        ({"controller": {"name": "anfis", "rules": 50}}, 280, 0.0062),
        ({"scenario": {"name": "general-trajectory"}}, 2000, 0.5896),
        ({"controller": "best-constant"}, 280, None),
        ({"preview": True}, 280, None),
        ({"profile": "road"}, 280, None),
        ({}, 460, None),
        ({"scenario": "step"}, 280, None),
    ],
)
def test_the_papers_mse_stands_only_beside_runs_that_compare(changes, n, expected):
    assert published_mse(record(n=n, meta=PAPER_RUN | changes)) == expected


# -- drives as arrays, corners ----------------------------------------------------------------------------------------
def path_record(**changes):
    """A minute on the path at 20 m/s; `changes` replace arrays."""
    still = {"offset": 0.0, "heading_error": 0.0, "speed": 20.0, "lateral_acceleration": 0.0, "wheel_angle": 0.0}
    return PathRecord(T, **(still | changes))


def test_the_corners_of_a_car_beside_a_straight_path_are_those_by_hand():
    left = BOX.corner_offsets(0.3, 0.0)
    assert left == pytest.approx([0.3 + 0.9, 0.3 - 0.9, 0.3 + 0.9, 0.3 - 0.9])
    turned = BOX.corner_offsets(0.0, math.radians(30))  # sin 30 = 1/2, cos 30 = sqrt(3)/2
    half = 0.9 * math.sqrt(3) / 2
    assert turned == pytest.approx([1.0 + half, 1.0 - half, -1.25 + half, -1.25 - half])


@given(radius=st.floats(8.0, 500.0), side=st.sampled_from([1, -1]), e=st.floats(-2, 2), turn=st.floats(-0.5, 0.5))
def test_on_an_arc_they_are_the_distances_from_its_circle(radius, side, e, turn):
    curvature, centre = side / radius, np.array([0.0, side * radius])  # the foot is the origin, heading along x
    corners = BOX.corners_at(0.0, e, turn)
    expected = side * (radius - np.hypot(*(corners - centre).T))
    assert BOX.corner_offsets(e, turn, curvature) == pytest.approx(expected, abs=1e-9)


def test_on_a_road_they_are_its_projection_of_the_corners():
    road = Road.from_segments([Line(length=30.0), Arc(length=60.0, curvature=0.05)])
    x, y, yaw = 60.0, 14.0, 1.2
    foot = road.project(x, y)
    corners = BOX.corners_at(x, y, yaw)
    projected = road.project(corners[:, 0], corners[:, 1]).offset
    offsets = BOX.corner_offsets(foot.offset, yaw - foot.heading, foot.curvature)
    assert offsets == pytest.approx(projected, abs=1e-9)


def test_what_a_car_file_leaves_out_is_estimated_and_named():
    car = load_vehicle("paper").replace(body=None)
    assert car.outline.length == pytest.approx(1.65 * car.wheelbase)
    assert car.outline.width == pytest.approx(car.track_front + 0.24)
    assert "estimated from wheelbase and track: length, front_overhang, width" in repr(car.outline)
    outline = car.replace(body=Body(length=4.5, width=1.7, rear_overhang=0.9)).outline
    assert (outline.length, outline.rear, outline.estimated) == (pytest.approx(4.5), pytest.approx(1.6 + 0.9), ())


def test_errors_of_arrays_are_those_of_a_hand_calculation():
    metrics = path_metrics(path_record(offset=0.1 + 0.2 * np.sin(2 * np.pi * T / 10)), BOX)
    assert metrics.mean_error == pytest.approx(0.1)
    assert metrics.rms_error == pytest.approx(math.hypot(0.1, 0.2 / math.sqrt(2)))
    assert metrics.max_abs_error == pytest.approx(0.3)
    assert metrics.max_corner_error == pytest.approx(0.3)
    assert metrics.max_corner == pytest.approx(0.3 + 0.9)
    assert metrics.distance == pytest.approx(20.0 * T[-1])
    assert not metrics.failed
    assert math.isnan(metrics.at_any_limit)


def test_the_share_in_the_lane_is_that_of_the_whole_outline():
    # |e| + 0.9 <= 1.75 while |sin| <= 0.85: the share of an arcsine
    weaving = path_record(offset=np.sin(2 * np.pi * T / 10))
    assert path_metrics(weaving, BOX).in_lane == pytest.approx(math.asin(0.85) / (0.5 * math.pi), abs=0.01)
    assert path_metrics(weaving, BOX, lane_width=4.0).in_lane == 1.0


def test_heading_errors_of_arrays_are_counted_within_a_turn_and_while_the_car_moves():
    turns = np.where(T < 30, 2 * np.pi + 0.1, -0.2)
    metrics = path_metrics(path_record(heading_error=turns, speed=np.where(T < 30, 5.0, 0.0)), BOX)
    assert metrics.heading_max == pytest.approx(0.1)
    assert metrics.heading_rms == pytest.approx(0.1)


def test_arrays_that_end_in_nan_have_infinite_measures():
    broken = np.where(T < 30, 0.0, np.nan)
    metrics = path_metrics(path_record(offset=broken, lateral_acceleration=broken, wheel_angle=broken), BOX)
    for name in ("rms_error", "p95_corner", "max_corner_error", "jerk_r79", "reversals", "mean_error"):
        assert getattr(metrics, name) == math.inf
    assert metrics.in_lane == pytest.approx(0.5)


def test_a_run_with_an_outline_has_the_measures_of_its_arrays_before_the_first_that_is_not_finite():
    offset = np.append(0.3 * np.sin(np.arange(60.0)), [NAN] * 4)
    run = record(n=64, Y=offset)
    metrics, part = compute_metrics(run, outline=BOX), path_metrics(PathRecord.from_trajectory(run), BOX)
    assert metrics.mse == INF
    for name in ("duration", "p95_error", "max_corner", "in_lane", "reversals", "jerk_r79"):
        assert getattr(metrics, name) == getattr(part, name), name
    assert part.steps == 60
    assert set(compute_metrics(run).as_row()) < set(metrics.as_row())


def test_the_steering_wheel_turns_by_the_ratio():
    angle = math.radians(0.15) * np.sin(2 * np.pi * 0.2 * T)
    assert path_metrics(path_record(wheel_angle=angle), BOX, steering_ratio=15).reversals > 20
    assert path_metrics(path_record(wheel_angle=angle), BOX, steering_ratio=5).reversals == 0


def test_known_measures_have_a_line_with_title_and_unit():
    lines = str(path_metrics(path_record(), BOX)).splitlines()
    assert any(line.split() == ["RMS", "error", "0", "m"] for line in lines)
    assert not any("nan" in line for line in lines)
    assert max(map(len, lines)) <= 80


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: path_record(offset=np.zeros(3)), r"offset has the shape \(3,\)"),
        (lambda: PathRecord(np.zeros(5), *[0.0] * 5), "increasing times"),
        (lambda: path_metrics(path_record(), BOX, lane_width=0), "lane_width = 0"),
        (lambda: compute_metrics(record(), move_weight=-1.0), "move_weight = -1"),
        (lambda: compute_metrics(record(), move_weight=NAN), "move_weight = nan"),
        (lambda: load_vehicle("paper").replace(body=Body(length=2.5)), "does not hold wheelbase"),
        (lambda: load_vehicle("paper").replace(body=Body(length=4.5, front_overhang=1.0, rear_overhang=1.5)),
         "leave one out"),
    ],
)  # fmt: skip
def test_arguments_that_make_no_sense_are_refused(make, words):
    with pytest.raises(InvalidInput, match=words):
        make()
