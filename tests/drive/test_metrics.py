"""The measures of a drive equal their definitions by hand; a broken run is a clear result, never a crash."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import adaptrack as at
from adaptrack.cars.outline import Outline
from adaptrack.drive.failure import Reason, find_failure
from adaptrack.drive.metrics import published_mse
from adaptrack.drive.prediction import prediction_error, run_prediction_error
from adaptrack.drive.signal_statistics import r79, r79_signals, reversal_rate
from adaptrack.road import Arc, Line
from made_drives import blank_columns

NAN, INF = float("nan"), float("inf")
BOX = Outline(front=2.0, rear=2.5, width=1.8)
T = np.arange(0.0, 60.0, 0.05)


def record(n=8, period=0.1, **changes):
    """A car at 10 m/s on a straight reference, nothing measured; `changes` replace arrays (scalars fill them)."""
    arrays = blank_columns(n) | {"t": period * np.arange(n), "vx": np.full(n, 10.0), "step_time": np.full(n, NAN)}
    zeros = np.zeros(n, np.int64)
    diagnostics = {"qp_status": zeros, "qp_iterations": zeros, "qp_residual": np.zeros(n), "at_limit": zeros}
    diagnostics |= {key: np.broadcast_to(value, (n,)) for key, value in changes.items() if key in diagnostics}
    arrays |= {key: np.broadcast_to(value, arrays[key].shape) for key, value in changes.items() if key in arrays}
    options = {key: value for key, value in changes.items() if key not in diagnostics and key not in arrays}
    return at.Trajectory(**arrays, period=period, **({"diagnostics": diagnostics} | options))


def test_tracking_measures_are_those_of_a_hand_calculation():
    metrics = at.compute_metrics(record(n=4, Y=[1.0, -2.0, 3.0, 0.0], y_ref=[0.0, 0.0, 1.0, 1.0]))
    assert metrics.mse == pytest.approx((1 + 4 + 4 + 1) / 4)
    assert metrics.rms_error == pytest.approx(math.sqrt(2.5))
    assert metrics.max_abs_error == 2.0
    assert not metrics.failed
    assert math.isnan(metrics.failed_at)


def test_a_sine_has_the_rms_of_a_sine():
    t = 0.1 * np.arange(1000)
    sine, cosine = np.sin(2 * np.pi * t), np.cos(2 * np.pi * t)
    run = record(n=1000, command=0.2 * sine, command_change=0.01 * cosine, lateral_acceleration=3.0 * sine)
    metrics = at.compute_metrics(run)
    assert metrics.steering_rms == pytest.approx(0.2 / math.sqrt(2))
    assert metrics.steering_rate_rms == pytest.approx(0.1 / math.sqrt(2))
    assert metrics.steering_activity == pytest.approx(0.01**2 / 2)
    assert metrics.lateral_acceleration_rms == pytest.approx(3.0 / math.sqrt(2))
    chord = 2 * 3.0 * math.sin(math.pi * 0.1) / 0.1  # amplitude of the differences of a sine
    assert metrics.jerk_rms == pytest.approx(chord / math.sqrt(2), rel=1e-3)


def test_the_papers_cost_is_the_mse_and_the_road_charges_activity():
    run = record(Y=0.5, command_change=0.1)
    assert at.compute_metrics(run).cost == at.compute_metrics(run).mse == 0.25
    assert at.compute_metrics(run, move_weight=2.0).cost == pytest.approx(0.25 + 2.0 * 0.01)
    road = record(Y=0.5, command_change=0.1, meta={"profile": "road", "move_weight": 3.0})
    assert at.compute_metrics(road).cost == pytest.approx(0.25 + 3.0 * 0.01)


def test_heading_is_judged_only_at_one_metre_per_second_or_more():
    metrics = at.compute_metrics(record(n=4, vx=[0.5, 0.99, 1.0, 5.0], psi=[3.0, 2.0, 0.3, -0.4]))
    assert metrics.heading_max == pytest.approx(0.4)
    assert metrics.heading_rms == pytest.approx(math.sqrt((0.09 + 0.16) / 2))
    assert math.isnan(at.compute_metrics(record(vx=0.0)).heading_rms)


def test_limits_qps_and_held_angles_are_counted_up_to_the_end_of_the_run():
    command = np.append(np.zeros(8), [NAN, NAN])
    run = record(
        n=10, command=command, at_limit=[0, 1, 2, 3, 4, 5, 0, 0, 7, 7], qp_status=[0, 0, 0, 1, 2, 3, 4, 9, 0, 0],
        held=[0, 0, 0, 1, 1, 1, 1, 1, 1, 1], qp_residual=[1e-12, NAN, 1e-9, 1e-3, 7.0, 7.0, 7.0, 7.0, 7.0, 7.0],
        step_time=1e-6 * np.arange(10),
    )  # fmt: skip
    metrics = at.compute_metrics(run)
    assert (metrics.steps, metrics.driven) == (10, 8)
    assert (metrics.at_change_limit, metrics.at_angle_limit, metrics.at_output_limit) == (3 / 8, 2 / 8, 2 / 8)
    assert metrics.at_any_limit == 5 / 8
    assert (metrics.qp_solved, metrics.qp_capped, metrics.qp_failed, metrics.held) == (3, 1, 4, 5)
    assert metrics.qp_residual_max == 1e-3
    assert (metrics.step_us_p50, metrics.step_us_max) == (pytest.approx(4.5), pytest.approx(9.0))
    reckoned = {**run.diagnostics, "dead_reckoning": 0.1 * np.arange(10.0)}
    blind = at.compute_metrics(dataclasses.replace(run, diagnostics=reckoned))
    assert (blind.dead_reckoning, blind.dead_reckoning_max) == (2, pytest.approx(0.7))


def test_what_a_controller_does_not_record_is_unknown():
    metrics = at.compute_metrics(record(Y=1.0, diagnostics={}))
    assert (metrics.qp_solved, metrics.qp_capped, metrics.qp_failed, metrics.dead_reckoning) == (0, 0, 0, 0)
    for name in ("qp_residual_max", "qp_iterations_mean", "at_any_limit", "dead_reckoning_max", "step_us_p50"):
        assert math.isnan(getattr(metrics, name)), name
    assert (metrics.mse, metrics.failed) == (1.0, False)


@pytest.mark.parametrize("name", ["X", "Y", "psi", "vx", "vy", "yaw_rate", "steering", "command"])
@pytest.mark.parametrize("value", [NAN, INF, -INF])
def test_a_state_that_is_not_finite_is_a_failed_run_of_infinite_cost(name, value):
    values = np.full(8, 10.0 if name == "vx" else 0.0)
    values[5:] = value
    metrics = at.compute_metrics(record(**{name: values}), move_weight=3.0)
    assert metrics.failed
    assert metrics.failed_at == pytest.approx(0.5)
    assert "not finite" in metrics.failed_because
    assert metrics.failed_reason == "not-finite"
    assert metrics.mse == metrics.rms_error == metrics.max_abs_error == metrics.cost == INF


def test_a_row_is_strict_json_even_for_a_failed_run():
    row = at.compute_metrics(record(Y=NAN)).as_row()
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    assert (row["mse"], row["failed"]) == (None, True)


def test_a_run_fails_by_the_rule_that_is_chosen_and_one_that_diverges_gives_numbers_not_warnings():
    off = record(Y=[0.0] * 7 + [6.0])
    assert at.compute_metrics(off).failed
    assert not at.compute_metrics(off, failure=at.FailureLimits(distance=7.0)).failed
    huge = at.compute_metrics(record(Y=np.geomspace(1.0, 1e300, 8), lateral_acceleration=np.geomspace(1, 1e308, 8)))
    assert (huge.failed, huge.mse) == (True, INF)


@given(st.lists(st.floats(-4.9, 4.9), min_size=2, max_size=30))
def test_mirrored_runs_have_the_same_measures(errors):
    values = np.array(errors)
    signals = {"Y": values, "psi": values / 9, "command": values / 8, "lateral_acceleration": values}
    left = at.compute_metrics(record(n=values.size, **signals))
    right = at.compute_metrics(record(n=values.size, **{key: -value for key, value in signals.items()}))
    assert left.as_row() == pytest.approx(right.as_row())


PAPER_RUN = {"scenario": "triple-lane-change", "profile": "paper", "preview": False, "controller": "standard"}


@pytest.mark.parametrize(("changes", "n", "expected"), [
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
])  # fmt: skip
def test_the_papers_mse_stands_only_beside_runs_that_compare(changes, n, expected):
    assert published_mse(record(n=n, meta=PAPER_RUN | changes)) == expected


# -- drives as arrays, corners ----------------------------------------------------------------------------------------
def path_record(**changes):
    """A minute on the path at 20 m/s; `changes` replace arrays."""
    still = {"offset": 0.0, "heading_error": 0.0, "speed": 20.0, "lateral_acceleration": 0.0, "wheel_angle": 0.0}
    return at.PathRecord(T, **(still | changes))


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
    road = at.Road.from_segments([Line(length=30.0), Arc(length=60.0, curvature=0.05)])
    x, y, yaw = 60.0, 14.0, 1.2
    foot = road.project(x, y)
    corners = BOX.corners_at(x, y, yaw)
    projected = road.project(corners[:, 0], corners[:, 1]).offset
    offsets = BOX.corner_offsets(foot.offset, yaw - foot.heading, foot.curvature)
    assert offsets == pytest.approx(projected, abs=1e-9)


def test_what_a_car_file_leaves_out_is_estimated_and_named():
    car = at.load_vehicle("paper").replace(body=None)
    assert car.outline.length == pytest.approx(1.65 * car.wheelbase)
    assert car.outline.width == pytest.approx(car.track_front + 0.24)
    assert "estimated from wheelbase and track: length, front_overhang, width" in repr(car.outline)
    outline = car.replace(body=at.Body(length=4.5, width=1.7, rear_overhang=0.9)).outline
    assert (outline.length, outline.rear, outline.estimated) == (pytest.approx(4.5), pytest.approx(1.6 + 0.9), ())


def test_errors_of_arrays_are_those_of_a_hand_calculation():
    metrics = at.path_metrics(path_record(offset=0.1 + 0.2 * np.sin(2 * np.pi * T / 10)), BOX)
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
    assert at.path_metrics(weaving, BOX).in_lane == pytest.approx(math.asin(0.85) / (0.5 * math.pi), abs=0.01)
    assert at.path_metrics(weaving, BOX, lane_width=4.0).in_lane == 1.0


def test_heading_errors_of_arrays_are_counted_within_a_turn_and_while_the_car_moves():
    turns = np.where(T < 30, 2 * np.pi + 0.1, -0.2)
    metrics = at.path_metrics(path_record(heading_error=turns, speed=np.where(T < 30, 5.0, 0.0)), BOX)
    assert metrics.heading_max == pytest.approx(0.1)
    assert metrics.heading_rms == pytest.approx(0.1)


def test_arrays_that_end_in_nan_have_infinite_measures():
    broken = np.where(T < 30, 0.0, np.nan)
    metrics = at.path_metrics(path_record(offset=broken, lateral_acceleration=broken, wheel_angle=broken), BOX)
    for name in ("rms_error", "p95_corner", "max_corner_error", "jerk_r79", "reversals", "mean_error"):
        assert getattr(metrics, name) == math.inf
    assert metrics.in_lane == pytest.approx(0.5)


def test_a_run_with_an_outline_has_the_measures_of_its_arrays_before_the_first_that_is_not_finite():
    offset = np.append(0.3 * np.sin(np.arange(60.0)), [NAN] * 4)
    run = record(n=64, Y=offset)
    metrics, part = at.compute_metrics(run, outline=BOX), at.path_metrics(at.PathRecord.from_trajectory(run), BOX)
    assert metrics.mse == INF
    for name in ("duration", "p95_error", "max_corner", "in_lane", "reversals", "jerk_r79"):
        assert getattr(metrics, name) == getattr(part, name), name
    assert part.steps == 60
    assert set(at.compute_metrics(run).as_row()) < set(metrics.as_row())


def test_the_steering_wheel_turns_by_the_ratio():
    angle = math.radians(0.15) * np.sin(2 * np.pi * 0.2 * T)
    assert at.path_metrics(path_record(wheel_angle=angle), BOX, steering_ratio=15).reversals > 20
    assert at.path_metrics(path_record(wheel_angle=angle), BOX, steering_ratio=5).reversals == 0


def test_known_measures_have_a_line_with_title_and_unit():
    lines = str(at.path_metrics(path_record(), BOX)).splitlines()
    assert any(line.split() == ["RMS", "error", "0", "m"] for line in lines)
    assert not any("nan" in line for line in lines)
    assert max(map(len, lines)) <= 80


# -- failures ---------------------------------------------------------------------------------------------------------
def test_a_run_has_failed_beyond_the_limit_not_on_it():
    assert find_failure(record(Y=5.0)) is None
    left = np.array([0.0, 1.0, 4.0, 5.1, 6.0, 0.0, 0.0, 0.0])
    failed = find_failure(record(Y=left))
    assert (failed.step, failed.time) == (3, pytest.approx(0.3))
    assert failed.clause == "left the road (more than 5 m from the reference)"
    assert find_failure(record(Y=left), at.FailureLimits(distance=7.0)) is None


def test_a_large_step_is_judged_once_it_has_arrived_and_has_failed_from_its_start_if_never():
    approach = np.array([0.0, 2.0, 6.0, 9.5, 12.0, 14.0, 14.5, 14.0])
    assert find_failure(record(Y=approach, y_ref=14.0)) is None
    runaway = np.array([0.0, 2.0, 6.0, 9.5, 12.0, 14.0, 18.0, 19.5])
    assert find_failure(record(Y=runaway, y_ref=14.0)).step == 7
    failed = find_failure(record(Y=0.0, y_ref=14.0))
    assert (failed.step, failed.clause) == (0, "never came within 5 m of the reference")


def test_a_spin_is_a_failure_at_driving_speed_only_and_the_first_event_gives_the_reason():
    sideways = np.array([0.0, 0.0, 9.0, 11.0, 11.0, 11.0, 11.0, 11.0])
    first = record(vy=[0, 0, 20, 20, NAN, NAN, NAN, NAN], Y=[0, 0, 0, 6, 7, 8, 9, 10])
    for run, step in ((record(vy=sideways), 3), (record(vy=-sideways), 3), (first, 2)):
        failed = find_failure(run)
        assert failed.step == step
        assert failed.clause.startswith("spun")
    assert find_failure(record(vx=0.05, vy=0.5)) is None
    assert find_failure(record(vx=-10.0)).step == 0  # going backwards


def test_what_the_loop_knew_counts_when_it_came_first():
    Y = np.array([0.0, 1.0, 3.0, 4.0, NAN, NAN, NAN, NAN])  # the loop saw 5.2 m at the end of the fourth period
    failed = find_failure(record(Y=Y, failed="off-road", failed_at=0.4))
    assert (failed.step, failed.reason) == (4, Reason.OFF_ROAD)
    late = find_failure(record(Y=[0, 0, 6, 6, 6, 6, 6, 6], failed="spun", failed_at=0.5))
    assert (late.step, late.reason) == (2, Reason.OFF_ROAD)
    failure = find_failure(record(failed="battery empty", failed_at=0.8))
    assert (failure.step, failure.clause) == (7, "was stopped by its simulation: battery empty")


# -- statistics of signals --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("frequency", [0.1, 0.25, 0.5, 1.0])
def test_a_sine_is_weakened_as_a_butterworth_of_fourth_order_does(frequency):
    t = np.arange(0, 60, 0.01)
    filtered, jerk = r79_signals(t, 2.0 * np.sin(2 * np.pi * frequency * t))
    gain = 2.0 / math.sqrt(1 + (frequency / 0.5) ** 8)
    assert np.abs(filtered[3000:]).max() == pytest.approx(gain, rel=2e-3)
    mean_of_slope = 2 * math.sin(math.pi * frequency * 0.5) / 0.5  # of a unit sine over 0.5 s
    assert np.abs(jerk[3000:]).max() == pytest.approx(gain * mean_of_slope, rel=2e-3)


def test_a_steady_acceleration_has_no_jerk_and_a_ramp_its_slope():
    assert r79(T, np.full(T.size, 3.0)) == pytest.approx((3.0, 0.0), abs=1e-9)
    _, jerk = r79_signals(T, 0.5 * T)
    assert jerk[-1] == pytest.approx(0.5, rel=1e-6)


def test_the_sampling_of_the_record_hardly_matters():
    slow, fast = (np.arange(0, 30, step) for step in (0.05, 0.01))
    assert r79(slow, np.sin(slow)) == pytest.approx(r79(fast, np.sin(fast)), rel=2e-3)


@pytest.mark.parametrize(("amplitude", "counted"), [(1.4, 0.0), (1.6, 24.0)])
def test_a_sine_reverses_twice_a_cycle_when_it_swings_by_more_than_the_gap(amplitude, counted):
    angle = math.radians(amplitude) * np.sin(2 * np.pi * 0.2 * np.arange(0, 300, 0.05))
    rates = reversal_rate(np.arange(0, 300, 0.05), angle)  # peak to peak 2.8 and 3.2 degrees, gap 3
    assert rates == pytest.approx(counted, abs=0.3)


def test_what_is_faster_than_the_filter_is_not_steering():
    slow = math.radians(5) * np.sin(2 * np.pi * 0.1 * T)
    fast = math.radians(5) * np.sin(2 * np.pi * 5.0 * T)
    assert reversal_rate(T, slow + fast) == reversal_rate(T, slow)
    assert reversal_rate(T, fast) == 0.0


# -- open-loop errors of a prediction model ---------------------------------------------------------------------------
MODEL = at.PathModel(at.load_vehicle("midsize-sedan"), period=0.05, lag=0.2, dead_time=0.1)


def drive(rng, n=200, late=2):
    """A drive of the model itself along a bend, its commands acting `late` periods later."""
    v, u, x = np.linspace(15, 20, n), 0.02 * rng.standard_normal(n), np.zeros((n, MODEL.n))
    for k in range(n - 1):
        a, b, e = (np.zeros(shape) for shape in ((MODEL.n, MODEL.n), MODEL.n, MODEL.n))
        MODEL.function(v[k], 0.05, MODEL.parameters(), a, b, e)
        x[k + 1] = a @ x[k] + b * (u[k - late] if k >= late else 0.0) + e * 0.01 * v[k]
    return x, u, v


def test_a_model_foretells_itself_and_an_output_that_is_off_is_off_by_as_much(rng):
    x, u, v = drive(rng)
    errors = prediction_error(MODEL, x, u, v, curvatures=0.01)
    assert errors == {0.5: pytest.approx(0.0, abs=1e-12), 1.0: pytest.approx(0.0, abs=1e-12)}
    assert prediction_error(MODEL, x, u, v)[1.0] > 0.5  # a bend that is not told
    shifted = prediction_error(MODEL, x, u, v, curvatures=0.01, outputs=x @ MODEL.output + 0.3)
    assert shifted[0.5] == pytest.approx(0.3)


@pytest.mark.parametrize("model", ["path", "single-track"])
def test_a_model_foretells_a_gentle_drive_along_a_bend_far_better_than_not_turning_would(model):
    car = at.load_vehicle("midsize-sedan")
    road = at.Road.from_segments([Arc(length=300.0, curvature=0.005)], name="bend")
    mpc = (
        at.MPC(car, profile="paper")
        if model == "path"
        else at.published_mpc(car, at.Tuning(30, 10, 1.0, 100.0), preview=True)
    )
    run = at.rollout(at.DualTrack(car), mpc, at.RoadDrive(road, 15.0))
    errors = run_prediction_error(run, mpc.model)
    turned_away = 0.5 * 0.005 * 15.0**2  # m, of a car that goes straight on for 1 s
    assert 0.0 < errors[0.5] < errors[1.0] < 0.15 * turned_away
    assert at.compute_metrics(run, model=mpc.model).prediction_error_one == errors[1.0]
    assert math.isnan(at.compute_metrics(run).prediction_error_one)
    short = run_prediction_error(run.between(0.0, 0.8), mpc.model)
    assert math.isfinite(short[0.5])
    assert math.isnan(short[1.0])


# -- what is refused --------------------------------------------------------------------------------------------------
STANDING = np.zeros((200, MODEL.n)), np.zeros(200), np.full(200, 15.0)


@pytest.mark.parametrize(("call", "words"), [
    (lambda: path_record(offset=np.zeros(3)), r"offset has the shape \(3,\)"),
    (lambda: at.PathRecord(np.zeros(5), *[0.0] * 5), "increasing times"),
    (lambda: at.load_vehicle("paper").replace(body=at.Body(length=2.5)), "does not hold wheelbase"),
    (lambda: at.load_vehicle("paper").replace(body=at.Body(length=4.5, front_overhang=1.0, rear_overhang=1.5)),
     "leave one out"),
    (lambda: at.FailureLimits(distance=0.0), "FailureLimits: "),
    (lambda: at.FailureLimits(distance=NAN), "FailureLimits: "),
    (lambda: at.FailureLimits(sideslip=-1.0), "FailureLimits: "),
    (lambda: at.FailureLimits(sideslip="wide"), "FailureLimits: "),
    (lambda: reversal_rate(T, T, cut_off=20.0), "below half the rate"),
    (lambda: prediction_error(MODEL, *(values[:20] for values in STANDING)), "within the record"),
    (lambda: prediction_error(MODEL, STANDING[0][:, :2], *STANDING[1:]), "states"),
])  # fmt: skip
def test_arguments_that_make_no_sense_are_refused(call, words):
    with pytest.raises(at.InvalidInput, match=words):
        call()
