"""Measures of a drive along a path: corners by hand, filters by their transfer functions, reversals by counting."""

import dataclasses
import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Body, load_vehicle
from adaptrack.control.controllers import MPC, Tuning, published_mpc
from adaptrack.control.models import PathModel
from adaptrack.drive.metrics import compute_metrics
from adaptrack.drive.path_metrics import PathRecord, path_metrics, r79, r79_signals, reversal_rate
from adaptrack.drive.prediction import prediction_error, run_prediction_error
from adaptrack.drive.simulate import rollout
from adaptrack.road import Arc, Line
from adaptrack.road.road import Road
from adaptrack.scenario import RoadDrive

BOX = Outline(front=2.0, rear=2.5, width=1.8)
T = np.arange(0.0, 60.0, 0.05)


def record(**changes):
    """A minute on the path at 20 m/s, nothing else; `changes` replace arrays."""
    still = {"offset": 0.0, "heading_error": 0.0, "speed": 20.0, "lateral_acceleration": 0.0, "wheel_angle": 0.0}
    return PathRecord(T, **(still | changes))


class TestOutline:
    def test_the_corners_of_a_car_beside_a_straight_path_are_those_by_hand(self):
        left = BOX.corner_offsets(0.3, 0.0)
        assert left == pytest.approx([0.3 + 0.9, 0.3 - 0.9, 0.3 + 0.9, 0.3 - 0.9])
        turned = BOX.corner_offsets(0.0, math.radians(30))  # sin 30 = 1/2, cos 30 = sqrt(3)/2
        half = 0.9 * math.sqrt(3) / 2
        assert turned == pytest.approx([1.0 + half, 1.0 - half, -1.25 + half, -1.25 - half])

    @given(radius=st.floats(8.0, 500.0), side=st.sampled_from([1, -1]), e=st.floats(-2, 2), turn=st.floats(-0.5, 0.5))
    def test_on_an_arc_they_are_the_distances_from_its_circle(self, radius, side, e, turn):
        curvature, centre = side / radius, np.array([0.0, side * radius])  # the foot is the origin, heading along x
        corners = BOX.corners_at(0.0, e, turn)
        expected = side * (radius - np.hypot(*(corners - centre).T))
        assert BOX.corner_offsets(e, turn, curvature) == pytest.approx(expected, abs=1e-9)

    def test_on_a_road_they_are_its_projection_of_the_corners(self):
        road = Road.from_segments([Line(length=30.0), Arc(length=60.0, curvature=0.05)])
        x, y, yaw = 60.0, 14.0, 1.2
        foot = road.project(x, y)
        corners = BOX.corners_at(x, y, yaw)
        projected = road.project(corners[:, 0], corners[:, 1]).offset
        found = BOX.corner_offsets(foot.offset, yaw - foot.heading, foot.curvature)
        assert found == pytest.approx(projected, abs=1e-9)

    def test_what_a_car_file_leaves_out_is_estimated_and_named(self):
        car = load_vehicle("paper").replace(body=None)
        assert car.outline.length == pytest.approx(1.65 * car.wheelbase)
        assert car.outline.width == pytest.approx(car.track_front + 0.24)
        assert "estimated from wheelbase and track: length, front_overhang, width" in repr(car.outline)
        whole = car.replace(body=Body(length=4.5, width=1.7, rear_overhang=0.9)).outline
        assert (whole.length, whole.rear, whole.estimated) == (pytest.approx(4.5), pytest.approx(1.6 + 0.9), ())

    def test_a_body_that_does_not_hold_both_axles_is_refused(self):
        car = load_vehicle("paper")
        with pytest.raises(InvalidInput, match="does not hold wheelbase"):
            car.replace(body=Body(length=2.5))
        with pytest.raises(InvalidInput, match="leave one out"):
            car.replace(body=Body(length=4.5, front_overhang=1.0, rear_overhang=1.5))


class TestMeasures:
    def test_offsets_are_those_of_a_hand_calculation(self):
        found = path_metrics(record(offset=0.1 + 0.2 * np.sin(2 * np.pi * T / 10)), BOX)
        assert found.mean_offset == pytest.approx(0.1)
        assert found.rms_offset == pytest.approx(math.hypot(0.1, 0.2 / math.sqrt(2)))
        assert found.max_offset == pytest.approx(0.3)
        assert found.max_corner == pytest.approx(0.3 + 0.9)
        assert found.max_corner_error == pytest.approx(found.max_offset)
        assert found.distance == pytest.approx(20.0 * T[-1])

    def test_the_share_in_the_lane_is_that_of_the_whole_outline(self):
        # |e| + 0.9 <= 1.75 while |sin| <= 0.85: the share of an arcsine
        found = path_metrics(record(offset=np.sin(2 * np.pi * T / 10)), BOX)
        assert found.in_lane == pytest.approx(math.asin(0.85) / (0.5 * math.pi), abs=0.01)
        assert path_metrics(record(offset=np.sin(2 * np.pi * T / 10)), BOX, lane_width=4.0).in_lane == 1.0

    def test_heading_errors_are_counted_within_a_turn_and_while_the_car_moves(self):
        turns = np.where(T < 30, 2 * np.pi + 0.1, -0.2)
        found = path_metrics(record(heading_error=turns, speed=np.where(T < 30, 5.0, 0.0)), BOX)
        assert found.max_heading == pytest.approx(0.1)
        assert found.rms_heading == pytest.approx(0.1)

    def test_a_drive_that_ended_in_nan_never_looks_good(self):
        broken = np.where(T < 30, 0.0, np.nan)
        found = path_metrics(record(offset=broken, lateral_acceleration=broken, wheel_angle=broken), BOX)
        for name in ("rms_offset", "p95_corner", "max_corner_error", "max_jerk_r79", "reversals", "mean_offset"):
            assert getattr(found, name) == math.inf
        assert found.in_lane == pytest.approx(0.5)
        assert json.loads(json.dumps(found.to_dict(), allow_nan=False))["rms_offset"] is None

    def test_every_measure_has_a_row_with_a_unit_in_text_and_html(self):
        found = path_metrics(record(), BOX)
        names = [each.name for each in dataclasses.fields(found)]
        assert [row[0] for row in found.rows()] == names
        assert all(name in str(found) and name in found._repr_html_() for name in names)
        assert max(map(len, str(found).splitlines())) <= 80

    def test_arrays_of_other_lengths_and_times_that_stand_are_refused(self):
        with pytest.raises(InvalidInput, match=r"offset has the shape \(3,\)"):
            record(offset=np.zeros(3))
        with pytest.raises(InvalidInput, match="increasing times"):
            PathRecord(np.zeros(5), *[0.0] * 5)
        with pytest.raises(InvalidInput, match="lane_width = 0"):
            path_metrics(record(), BOX, lane_width=0)


class TestComfort:
    @pytest.mark.parametrize("frequency", [0.1, 0.25, 0.5, 1.0])
    def test_a_sine_is_weakened_as_a_butterworth_of_fourth_order_does(self, frequency):
        t = np.arange(0, 60, 0.01)
        filtered, jerk = r79_signals(t, 2.0 * np.sin(2 * np.pi * frequency * t))
        gain = 2.0 / math.sqrt(1 + (frequency / 0.5) ** 8)
        assert np.abs(filtered[3000:]).max() == pytest.approx(gain, rel=2e-3)
        mean_of_slope = 2 * math.sin(math.pi * frequency * 0.5) / 0.5  # of a unit sine over 0.5 s
        assert np.abs(jerk[3000:]).max() == pytest.approx(gain * mean_of_slope, rel=2e-3)

    def test_a_steady_acceleration_has_no_jerk_and_a_ramp_its_slope(self):
        assert r79(T, np.full(T.size, 3.0)) == pytest.approx((3.0, 0.0), abs=1e-9)
        _, jerk = r79_signals(T, 0.5 * T)
        assert jerk[-1] == pytest.approx(0.5, rel=1e-6)

    def test_the_sampling_of_the_record_hardly_matters(self):
        slow, fast = (np.arange(0, 30, step) for step in (0.05, 0.01))
        assert r79(slow, np.sin(slow)) == pytest.approx(r79(fast, np.sin(fast)), rel=2e-3)


class TestReversals:
    @pytest.mark.parametrize(("amplitude", "counted"), [(1.4, 0.0), (1.6, 24.0)])
    def test_a_sine_reverses_twice_a_cycle_when_it_swings_by_more_than_the_gap(self, amplitude, counted):
        angle = math.radians(amplitude) * np.sin(2 * np.pi * 0.2 * np.arange(0, 300, 0.05))
        found = reversal_rate(np.arange(0, 300, 0.05), angle)  # peak to peak 2.8 and 3.2 degrees, gap 3
        assert found == pytest.approx(counted, abs=0.3)

    def test_what_is_faster_than_the_filter_is_not_steering(self):
        slow = math.radians(5) * np.sin(2 * np.pi * 0.1 * T)
        fast = math.radians(5) * np.sin(2 * np.pi * 5.0 * T)
        assert reversal_rate(T, slow + fast) == reversal_rate(T, slow)
        assert reversal_rate(T, fast) == 0.0

    def test_the_steering_wheel_turns_by_the_ratio(self):
        angle = math.radians(0.15) * np.sin(2 * np.pi * 0.2 * T)
        assert path_metrics(record(wheel_angle=angle), BOX, steering_ratio=15).reversals > 20
        assert path_metrics(record(wheel_angle=angle), BOX, steering_ratio=5).reversals == 0

    def test_a_cut_off_beyond_half_the_sampling_is_refused(self):
        with pytest.raises(InvalidInput, match="below half of the sampling"):
            reversal_rate(T, T, cut_off=20.0)


class TestPrediction:
    MODEL = PathModel(load_vehicle("midsize-sedan"), period=0.05, lag=0.2, dead_time=0.1)

    def drive(self, rng, n=200, late=2):
        """A drive of the model itself along a bend, its commands acting `late` periods later."""
        v, u, x = np.linspace(15, 20, n), 0.02 * rng.standard_normal(n), np.zeros((n, self.MODEL.n))
        for k in range(n - 1):
            a, b, e = (np.zeros(shape) for shape in ((self.MODEL.n, self.MODEL.n), self.MODEL.n, self.MODEL.n))
            self.MODEL.function(v[k], 0.05, self.MODEL.parameters(), a, b, e)
            x[k + 1] = a @ x[k] + b * (u[k - late] if k >= late else 0.0) + e * 0.01 * v[k]
        return x, u, v

    def test_a_model_foretells_itself(self, rng):
        x, u, v = self.drive(rng)
        found = prediction_error(self.MODEL, x, u, v, curvatures=0.01)
        assert found == {0.5: pytest.approx(0.0, abs=1e-12), 1.0: pytest.approx(0.0, abs=1e-12)}
        assert prediction_error(self.MODEL, x, u, v)[1.0] > 0.5  # a bend that is not told

    def test_an_output_that_is_off_is_off_by_as_much(self, rng):
        x, u, v = self.drive(rng)
        found = prediction_error(self.MODEL, x, u, v, curvatures=0.01, outputs=x @ self.MODEL.output + 0.3)
        assert found[0.5] == pytest.approx(0.3)

    def test_a_time_beyond_the_record_is_refused(self, rng):
        x, u, v = self.drive(rng, n=20)
        with pytest.raises(InvalidInput, match="within the record"):
            prediction_error(self.MODEL, x, u, v)
        with pytest.raises(InvalidInput, match="states"):
            prediction_error(self.MODEL, x[:, :2], u, v)

    @pytest.mark.parametrize("model", ["path", "single-track"])
    def test_a_model_foretells_a_gentle_drive_along_a_bend_far_better_than_not_turning_would(self, model):
        car = load_vehicle("midsize-sedan")
        road = Road.from_segments([Arc(length=300.0, curvature=0.005)], name="bend")
        mpc = (
            MPC(car, profile="paper")
            if model == "path"
            else published_mpc(car, Tuning(30, 10, 1.0, 100.0), preview=True)
        )
        run = rollout(DualTrack(car), mpc, RoadDrive(road, 15.0))
        found = run_prediction_error(run, mpc.model)
        turned_away = 0.5 * 0.005 * 15.0**2  # m, of a car that goes straight on for 1 s
        assert 0.0 < found[0.5] < found[1.0] < 0.15 * turned_away
        assert compute_metrics(run, model=mpc.model).prediction_error_one == found[1.0]
        assert math.isnan(compute_metrics(run).prediction_error_one)
        short = run_prediction_error(run.between(0.0, 0.8), mpc.model)
        assert math.isfinite(short[0.5])
        assert math.isnan(short[1.0])
