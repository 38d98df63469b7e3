"""Open-loop tests against the linear single track, whose answers are known; tracks and margins by hand."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lsim

from adaptrack import cli
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.outline import Outline
from adaptrack.cars.plant import SingleTrack, SteppedPlant, get_plant
from adaptrack.cars.vehicle import GRAVITY, Tyre, load_vehicle
from adaptrack.cli import closed_loop
from adaptrack.comparison.manoeuvres import (
    Gate,
    LaneChangeTest,
    Surroundings,
    Track,
    clearance,
    coasting_plan,
    curvature_step,
    curvature_step_start,
    drive_lane_start,
    drive_open_loop,
    driven_line,
    entry_speed,
    frequency_response,
    highest_clean_speed,
    iso_3888_1,
    iso_3888_2,
    lane_drift,
    lane_recovery,
    sine_with_dwell,
    steady_circle,
    step_steer,
    track_road,
    tune_for_track,
)
from adaptrack.comparison.manoeuvres.entry_speed import TUNING_SEEDS, refined_poses, tunings_to_try
from adaptrack.comparison.manoeuvres.lane_runs import crossing, last_offset, settling_time
from adaptrack.comparison.manoeuvres.sine_with_dwell import amplitudes, reference_angle, sine_with_dwell_shape
from adaptrack.control.controllers import get_controller
from adaptrack.drive.path_metrics import PathRecord
from adaptrack.drive.simulate import rollout
from adaptrack.road import Line, Road
from adaptrack.scenario.profile import load_profile

GRIP = Surroundings(friction=1.0)
DEGREE = math.pi / 180
V = 80 / 3.6


@pytest.fixture(scope="module")
def linear():
    """A car on linear tyres without side force of the air, and its plant: what the linear model describes."""
    car = load_vehicle("compact-ev").replace(side_force_slope=0.0, yaw_moment_slope=0.0)
    tyre = Tyre(
        name="linear", kind="linear", stiffness_front=car.stiffness_front, stiffness_rear=car.stiffness_rear,
        nominal_load=4000.0,
    )  # fmt: skip
    return car, SingleTrack(car, tyre)


def lateral_model(car, v):
    """d/dt (v_y, r) = A (v_y, r) + B delta, with axle stiffnesses (Rajamani, section 2.3)."""
    m, inertia, lf, lr = car.mass, car.yaw_inertia, car.lf, car.lr
    cf, cr = 2 * car.stiffness_front, 2 * car.stiffness_rear
    A = [
        [-(cf + cr) / (m * v), -v - (cf * lf - cr * lr) / (m * v)],
        [-(cf * lf - cr * lr) / (inertia * v), -(cf * lf**2 + cr * lr**2) / (inertia * v)],
    ]
    return np.array(A), np.array([[cf / m], [cf * lf / inertia]])


@pytest.mark.compiled
class TestOpenLoop:
    def test_a_coasting_car_slows_down_by_drag_and_rolling_resistance(self, linear):
        car, plant = linear
        motion = drive_open_loop(plant, lambda t: 0.0 * t, 30.0, 5.0, Surroundings(hold_speed=False))
        roll = car.rolling_resistance * GRAVITY
        drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
        root = math.sqrt(roll / drag)  # dv/dt = -roll - drag v^2
        expected = root * np.tan(np.arctan(30.0 / root) - math.sqrt(roll * drag) * motion.t)
        assert motion.vx[0] == pytest.approx(expected, rel=1e-9)
        assert np.abs(motion.y).max() == 0.0

    def test_runs_side_by_side_are_those_alone(self):
        plant = get_plant("dual-track", load_vehicle("van"))
        sizes = np.linspace(0.01, 0.05, 40)  # more than a block holds
        together = drive_open_loop(plant, lambda t: sizes[:, None] * np.sin(t), V, 0.3)
        alone = drive_open_loop(plant, lambda t: sizes[35] * np.sin(t), V, 0.3)
        assert np.array_equal(together.yaw_rate[35], alone.yaw_rate[0])

    def test_a_stepped_plant_is_driven_as_well(self):
        class Turntable(SteppedPlant):
            longest_step = 0.002

            def reset(self, motion):
                self.motion = motion

            def step(self, dt, steering, acceleration, environment):
                x, y, yaw, v, _, _ = self.motion
                r = v * steering / 2.5
                self.motion = np.array([x + dt * v * np.cos(yaw), y + dt * v * np.sin(yaw), yaw + dt * r, v, 0.0, r])
                return self.motion

        motion = drive_open_loop(Turntable(), lambda t: 0.05 + 0.0 * t, 10.0, 1.0)
        assert motion.yaw[0, -1] == pytest.approx(0.2)
        assert motion.lateral_acceleration[0, 10:] == pytest.approx(10.0 * 0.2)

    def test_a_stepped_plant_that_takes_any_step_takes_one_of_a_period(self):
        class Cart(SteppedPlant):
            longest_step = math.inf

            def reset(self, motion):
                self.motion = motion

            def step(self, dt, steering, acceleration, environment):
                self.motion[0] += dt * self.motion[3]
                return self.motion

        motion = drive_open_loop(Cart(), lambda t: 0.0 * t, 10.0, 1.0)
        assert motion.x[0, -1] == pytest.approx(10.0)

    @pytest.mark.parametrize(
        ("speed", "duration", "steer"), [(0.0, 1.0, 0.0), (10.0, -1.0, 0.0), (10.0, 1.0, math.nan), (1e9, 1.0, 0.0)]
    )
    def test_what_cannot_be_driven_is_refused(self, linear, speed, duration, steer):
        with pytest.raises(InvalidInput):
            drive_open_loop(linear[1], lambda t: steer + 0.0 * t, speed, duration)
        with pytest.raises(InvalidInput, match="friction"):
            Surroundings(friction=0.0)


@pytest.mark.compiled
class TestSteadyCircle:
    def test_linear_tyres_have_the_understeer_gradient_of_their_axles(self, linear):
        car, plant = linear
        front, rear = 2 * car.stiffness_front, 2 * car.stiffness_rear
        known = car.mass / car.wheelbase * (car.lr / front - car.lf / rear)
        for held in ({"radius": 400.0}, {"speed": 30.0}):
            found = steady_circle(car, plant, step=2.0, surroundings=Surroundings(1.0, period=0.01), **held)
            assert found.gradient_at(2.0) == pytest.approx(known, rel=0.01)

    def test_the_wheels_turn_by_the_ackermann_angle_and_the_gradient_times_the_acceleration(self, linear):
        car, plant = linear
        turns = steady_circle(car, plant, radius=400.0, step=2.0, surroundings=GRIP).turns
        expected = car.wheelbase / 400.0 + car.understeer_gradient * turns.lateral_acceleration
        assert turns.wheel_angle == pytest.approx(expected, rel=0.01)
        assert 1.0 / turns.curvature == pytest.approx(400.0, rel=1e-4)

    def test_saturating_tyres_end_it_below_the_friction(self):
        car = load_vehicle("compact-ev")
        found = steady_circle(car, get_plant("dual-track", car), step=1.5)
        assert 6.0 <= found.highest < 0.9 * GRAVITY
        assert found.gradient_at(found.highest) > 3 * found.gradient_at(1.5)
        assert math.isnan(found.gradient_at(20.0))

    def test_a_radius_and_a_speed_together_are_refused(self, linear):
        with pytest.raises(InvalidInput, match="not both"):
            steady_circle(*linear, radius=100.0, speed=20.0)


@pytest.mark.compiled
class TestTransient:
    def test_a_step_is_answered_as_the_linear_model_does(self, linear):
        car, plant = linear
        found = step_steer(car, plant, lateral_acceleration=0.5, surroundings=GRIP)
        t = np.arange(0.0, 7.5, 0.001)
        A, B = lateral_model(car, V)
        ramp = np.clip((t - 0.5) / 0.1, 0.0, 1.0)
        _, answer, _ = lsim((A, B, np.eye(2), np.zeros((2, 1))), ramp, t)
        r = answer[:, 1]
        steady = car.steady_state_yaw_gain(V)
        assert found.yaw_rate.gain == pytest.approx(steady, rel=1e-3)
        assert found.yaw_rate.overshoot == pytest.approx(r.max() / steady - 1.0, abs=1e-3)
        assert found.yaw_rate.peak_time == pytest.approx(t[r.argmax()] - 0.55, abs=2e-3)
        assert found.yaw_rate.response_time == pytest.approx(t[np.argmax(r >= 0.9 * steady)] - 0.55, abs=2e-3)
        assert found.lateral_acceleration.steady == pytest.approx(0.5, rel=1e-3)

    def test_gains_and_phases_are_those_of_the_transfer_function(self, linear):
        car, plant = linear
        found = frequency_response(car, plant, lateral_acceleration=0.5, frequencies=(0.5, 1.0, 2.0), surroundings=GRIP)
        A, B = lateral_model(car, V)
        for k, f in enumerate(found.frequency):
            s = 2j * np.pi * f
            vy, r = np.linalg.solve(s * np.eye(2) - A, B[:, 0])
            assert found.yaw_rate[k] == pytest.approx(r, rel=2e-3)
            assert found.lateral_acceleration[k] == pytest.approx(s * vy + V * r, rel=5e-3)

    def test_more_than_the_tyres_hold_is_refused_with_the_remedy(self):
        car = load_vehicle("paper")
        with pytest.raises(InvalidInput, match=r"no such steady turn at 22\.22 m/s; ask for less"):
            step_steer(car, get_plant("single-track", car), lateral_acceleration=9.5)
        with pytest.raises(InvalidInput, match="no such steady turn at 1e-300 m/s"):
            step_steer(car, get_plant("single-track", car), speed=1e-300)


@pytest.mark.compiled
class TestSineWithDwell:
    def test_the_steering_is_one_period_that_rests_half_a_second_at_its_second_peak(self):
        t = np.arange(-0.5, 3.0, 0.001)
        shape = sine_with_dwell_shape(t)
        assert t[shape != 0.0].max() == pytest.approx(1 / 0.7 + 0.5, abs=2e-3)
        assert np.count_nonzero(shape < -1 + 1e-12) * 0.001 == pytest.approx(0.5, abs=0.01)
        assert (shape.max(), shape.min()) == (pytest.approx(1.0), -1.0)

    @pytest.mark.parametrize(("angle", "last", "count"), [(30.0, 270.0, 16), (45.0, 292.5, 11), (60.0, 300.0, 8)])
    def test_amplitudes_end_at_six_and_a_half_times_a_or_270_degrees_and_never_beyond_300(self, angle, last, count):
        series = amplitudes(angle * DEGREE) / DEGREE
        assert (series[0], series[-1], len(series)) == (pytest.approx(1.5 * angle), pytest.approx(last), count)
        assert np.diff(series)[:-1] == pytest.approx(0.5 * angle)

    def test_a_of_linear_tyres_is_the_steady_angle_at_three_tenths_of_g(self, linear):
        car, plant = linear
        steady = 0.3 * GRAVITY * (car.wheelbase / V**2 + car.understeer_gradient)
        lag = 0.15 * 13.5 * DEGREE  # the answer comes about 0.15 s behind the rising angle
        assert reference_angle(plant, 15.0, GRIP) == pytest.approx(15.0 * steady + lag, abs=0.5 * DEGREE)

    def test_linear_tyres_pass_to_both_sides_alike(self, linear):
        car, plant = linear
        found = sine_with_dwell(car, plant, surroundings=GRIP)
        half = len(found.runs) // 2
        assert found.passed
        for left, right in zip(found.runs[:half], found.runs[half:], strict=True):
            assert left.displacement == pytest.approx(right.displacement, rel=1e-9)
            assert left.amplitude == -right.amplitude
        assert {run.responsive for run in found.runs if run.multiple < 4.9} == {None}

    def test_a_car_without_stability_control_spins_and_fails(self):
        car = load_vehicle("midsize-sedan")
        found = sine_with_dwell(car, get_plant("dual-track", car))
        worst = found.runs[len(found.runs) // 4]
        assert not found.passed
        assert worst.spun
        assert worst.yaw_ratio_1 > 0.35
        assert found.runs[0].passed


BOX = Outline(front=2.0, rear=2.0, width=1.8)
LANE = Track("lane", (Gate(0.0, 10.0, -1.5, 1.5),))


def straight(y, heading=0.0):
    x = np.linspace(-10.0, 20.0, 61)
    return x, y + (x - 5.0) * math.tan(heading), np.full(x.size, heading)


class TestLaneChange:
    def test_the_tracks_have_the_lengths_and_widths_of_the_standard(self):
        one, two = iso_3888_1(1.8), iso_3888_2(1.8)
        assert (one.length, two.length) == (125.0, 61.0)
        assert [gate.width for gate in one.gates] == pytest.approx([2.23, 2.41, 2.59])
        assert [gate.width for gate in two.gates] == pytest.approx([2.23, 2.8, 3.0])
        assert two.gates[1].right - two.gates[0].left == pytest.approx(1.0)
        assert one.gates[1].right - one.gates[0].right == pytest.approx(3.5)
        assert iso_3888_2(2.4).gates[2].width == pytest.approx(1.3 * 2.4 + 0.25)
        assert one.cones.shape == (12, 2)

    def test_beside_the_middle_of_a_lane_the_margin_is_what_is_left(self):
        assert clearance(LANE, BOX, *straight(0.0)).least == pytest.approx(0.6)
        assert clearance(LANE, BOX, *straight(0.4)).least == pytest.approx(0.2)
        beyond = clearance(LANE, BOX, *straight(-0.7))
        assert beyond.least == pytest.approx(-0.1)
        assert not beyond.clean

    def test_a_straight_line_across_a_lane_passes_its_cones_at_their_distance_from_the_side(self):
        heading = 0.2
        cone = 1.5 * math.cos(heading) - 5.0 * math.sin(heading)  # (10, 1.5) from the line through (5, 0)
        assert clearance(LANE, BOX, *straight(0.0, heading)).least == pytest.approx(cone - 0.9, abs=0.01)

    def test_a_cone_between_the_corners_is_hit_by_the_side(self):
        short = Track("short", (Gate(0.0, 1.0, -1.5, 1.5),))  # all corners are beyond it while the car turns
        x, heading = np.array([-10.0, 0.4, 0.5, 0.6, 20.0]), math.radians(30)
        found = clearance(short, BOX, x, np.zeros(5), np.array([0.0, 0.0, heading, 0.0, 0.0]))
        side = 1.5 * math.cos(heading) - 0.5 * math.sin(heading) - 0.9
        assert found.least == pytest.approx(side, abs=0.01)
        assert found.place == pytest.approx(0.5, abs=0.06)

    def test_a_lane_that_is_not_driven_through_has_no_margin(self):
        x, y, yaw = straight(0.0)
        short = x < 8.0
        assert clearance(LANE, BOX, x[short], y[short], yaw[short]).least == -math.inf
        assert clearance(LANE, BOX, np.where(short, x, np.nan), y, yaw).margins == (-math.inf,)
        with pytest.raises(InvalidInput, match="n >= 2"):
            clearance(LANE, BOX, x, y, yaw[:3])

    @pytest.mark.parametrize("make", [iso_3888_1, iso_3888_2])
    @pytest.mark.parametrize("car", ["compact-ev", "van"])
    def test_along_its_road_the_body_passes_all_gates_with_the_room_asked_for(self, make, car):
        outline = load_vehicle(car).outline
        track = make(outline.width)
        road = track_road(track, outline, room=0.1)
        s = np.linspace(0.0, road.length, 1500)
        line = road.at(s)
        found = clearance(track, outline, line.x, line.y, line.heading)
        assert found.clean
        assert min(found.margins) == pytest.approx(0.1, abs=0.04)
        assert np.abs(line.curvature).max() < (0.01 if make is iso_3888_1 else 0.04)
        assert np.abs(line.heading[line.x < -1.0]).max() < 0.03  # it enters straight
        inside = (line.x > 1.0) & (line.x < track.gates[0].end - 1.0)
        left = line.y[inside] + road.along("width_left", s[inside])
        assert left == pytest.approx(track.gates[0].left, abs=1e-3)

    def test_off_the_throttle_the_planned_speed_falls_as_that_of_a_plant(self):
        car = load_vehicle("van")
        track = iso_3888_2(car.outline.width)
        road = Road.from_segments([Line(length=150.0)], start=(-50.0, 0.0, 0.0))
        plan = coasting_plan(track, road, car, 20.0)
        assert plan.at([0.0, 49.0]) == pytest.approx(20.0)
        roll = car.rolling_resistance * GRAVITY
        drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
        v, step = 20.0, 0.001
        for _ in range(100_000):  # dv/ds = -(roll + drag v^2)/v over 100 m
            v -= step * (roll + drag * v * v) / v
        assert plan.speed[-1] == pytest.approx(v, rel=1e-4)
        with pytest.raises(InvalidInput, match="stands before the end"):
            coasting_plan(track, road, car, 3.0)

    def test_a_body_that_is_too_wide_for_the_track_is_refused(self):
        with pytest.raises(InvalidInput, match="does not fit through iso-3888-2"):
            track_road(iso_3888_2(1.5), BOX)
        with pytest.raises(InvalidInput, match="width = 0"):
            iso_3888_1(0)

    @pytest.mark.parametrize("car", ["compact-ev", "van"])
    def test_a_line_for_a_speed_leaves_more_room_the_slower_and_bends_less_the_faster(self, car):
        car = load_vehicle(car)
        track = iso_3888_2(car.outline.width)
        found = {}
        for speed in (10.0, 14.0, 20.0):
            road = driven_line(track, car, speed)
            line = road.at(np.linspace(0.0, road.length, 2000))
            slip = car.lr - car.mass * car.lf * speed**2 / (2.0 * car.stiffness_rear * car.wheelbase)
            body = clearance(track, car.outline, line.x, line.y, line.heading - slip * line.curvature)
            found[speed] = body.least, np.abs(line.curvature).max()
        assert found[10.0][0] > found[14.0][0] > found[20.0][0] - 0.01
        assert found[10.0][1] > found[14.0][1]
        assert all(0.02 < room < 0.16 for room, _ in found.values())

    def test_a_bend_that_allows_it_leaves_all_the_room_asked_for(self):
        track = iso_3888_2(1.8)
        wide = track_road(track, BOX, 0.15, bend=10.0)
        line = wide.at(np.linspace(0.0, wide.length, 2000))
        assert clearance(track, BOX, line.x, line.y, line.heading).least == pytest.approx(0.15, abs=0.04)
        with pytest.raises(InvalidInput, match="bend = 0"):
            track_road(track, BOX, bend=0)

    def test_a_scan_tells_the_speeds_up_to_which_all_are_clean_from_those_that_are_by_luck(self):
        driven = []

        def drive(speed):
            driven.append(speed)
            return straight(0.0 if speed == 64.0 else 0.01 * speed)  # 0.6 m are used up at 60 m/s

        found = highest_clean_speed(drive, LANE, BOX, np.arange(50.0, 100.0, 2.0))
        assert (found.speed, found.failing, found.highest) == (pytest.approx(60.0, abs=2.0), found.speed + 2.0, 64.0)
        assert driven == sorted(found.tried)
        assert max(driven) < 98.0  # the cars that are lost for good are not driven on
        assert math.isnan(highest_clean_speed(drive, LANE, BOX, [70.0, 80.0]).highest)
        assert math.isnan(highest_clean_speed(drive, LANE, BOX, [10.0, 20.0]).failing)
        with pytest.raises(InvalidInput, match="must increase"):
            highest_clean_speed(drive, LANE, BOX, [2.0, 1.0])

    def test_between_the_instants_the_car_is_on_the_arc_that_it_drives(self):
        t, v, r = np.arange(0.0, 2.0, 0.1)[:, None], 15.0, 0.5
        circle = np.hstack([v / r * np.sin(r * t), v / r * (1 - np.cos(r * t)), r * t, v + 0 * t, 0 * t, r + 0 * t])
        x, y, yaw = refined_poses(circle, 0.1).T
        assert len(x) == 19 * 5 + 1
        assert np.hypot(x, y - v / r) == pytest.approx(v / r, abs=1e-6)
        assert yaw == pytest.approx(np.arctan2(x, v / r - y), abs=1e-6)


@pytest.fixture(scope="module")
def obstacle():
    car = load_vehicle("compact-ev")
    profile = load_profile("road")
    track = iso_3888_2(car.outline.width)
    return LaneChangeTest(car, get_plant("dual-track", car), track, profile)


def driver_of(test, name):
    return get_controller(name, test.car, profile=test.profile, period=test.profile.period, preview=True)


@pytest.mark.compiled
class TestEntrySpeed:
    def test_the_informed_mpc_passes_at_40_km_h_and_fails_well_beyond_the_grip(self, obstacle):
        found = entry_speed(obstacle, "informed", driver_of(obstacle, "informed"), [40 / 3.6, 80 / 3.6])
        assert found.row["clean"] == pytest.approx(40.0)
        assert found.row["failing"] == pytest.approx(80.0)
        assert 0.0 < found.row["margin"] < 0.2
        assert clearance(obstacle.track, obstacle.car.outline, *found.poses[0].T).clean

    def test_many_tunings_at_once_are_driven_as_each_alone(self, obstacle):
        stanley = driver_of(obstacle, "stanley")
        tunings = np.array([[0.5 + 0.1 * k, 1.0, 0.05, 0.2] for k in range(20)])  # more than a block holds
        together = obstacle.drive(stanley, 12.0, tunings, (0, 1))
        alone = obstacle.drive(stanley, 12.0, tunings[17:18], (1,))
        assert np.array_equal(together[17, 1], alone[0, 0], equal_nan=True)
        slow = rollout(obstacle.plant, stanley, obstacle.entering_at(12.0), profile=obstacle.profile, seed=1)
        own = obstacle.drive(stanley, 12.0, stanley.packed_tuning()[None], (1,))[0, 0]
        assert np.array_equal(own[::5, 1], slow.Y)

    def test_a_tuning_that_was_searched_is_no_worse_than_the_own_one_where_it_was_searched(self, obstacle):
        law = driver_of(obstacle, "lqr")
        tuning, margin = tune_for_track(obstacle, "lqr", law, 12.0)
        (own,) = obstacle.margins(law, 12.0, law.packed_tuning()[None], TUNING_SEEDS)
        assert margin.least > own.least + 0.05
        assert any(np.array_equal(tuning, each) for each in tunings_to_try("lqr", law))
        with pytest.raises(InvalidInput, match="no search"):
            tune_for_track(obstacle, "mine", law, 12.0)


@pytest.mark.compiled
class TestLaneRuns:
    @pytest.mark.parametrize("name", ["informed", "stanley"])
    def test_a_car_comes_back_from_beside_its_path_and_stays(self, obstacle, name):
        start = lane_recovery(obstacle.car.outline)
        run = drive_lane_start(start, obstacle.plant, driver_of(obstacle, name), obstacle.car.outline, obstacle.profile)
        assert run.passed
        assert run.largest_offset >= 1.0
        assert 1.0 < run.settling_time < 10.0
        assert abs(run.last_offset) < 0.1
        assert run.row["metrics"]["max_corner"] == run.largest_corner

    def test_a_limit_that_the_start_already_breaks_is_not_passed(self, obstacle):
        start = replace(lane_drift(obstacle.car.outline, 0.5), limit=1.7)
        law = driver_of(obstacle, "stanley")
        run = drive_lane_start(start, obstacle.plant, law, obstacle.car.outline, obstacle.profile, (0,))
        assert not run.passed
        assert run.largest_corner >= 1.75
        assert run.failed is None

    def test_settling_and_crossing_of_a_decaying_oscillation_are_those_of_its_formula(self):
        t = np.arange(0.0, 10.0, 0.001)
        e = np.exp(-0.5 * t) * np.cos(np.pi * t)
        record = PathRecord(t, e, 0.0 * t, 10.0 + 0 * t, 0.0 * t, 0.0 * t)
        dip = t[np.argmin(e)]
        assert crossing(record) == pytest.approx(math.exp(-0.5 * dip) * -math.cos(math.pi * dip))
        assert settling_time(record) == pytest.approx(t[np.flatnonzero(np.abs(e) > 0.1)[-1] + 1])
        assert last_offset(record, 1e-9) == e[-1]
        assert math.isnan(settling_time(PathRecord(t, 1.0 + 0 * t, 0 * t, 10 + 0 * t, 0 * t, 0 * t)))

    def test_a_step_of_curvature_is_met_at_3_m_per_s2_unless_a_speed_is_given(self):
        start = curvature_step_start(75.0)
        assert start.speed == pytest.approx(15.0)
        assert (start.offset, start.heading_error, start.limit) == (0.0, 0.0, 1.75)
        with pytest.raises(InvalidInput, match="speed"):
            curvature_step_start(75.0, speed=0.0)


class TestStartStates:
    def test_a_drift_begins_with_the_front_corner_on_the_edge_of_the_lane(self):
        drift = lane_drift(BOX, 0.5)
        corners = BOX.corners_at(*drift.start)
        assert corners[:, 1].max() == pytest.approx(1.75)
        assert drift.speed * math.sin(drift.heading_error) == pytest.approx(0.5)
        assert drift.limit == pytest.approx(1.75 + 0.3)
        with pytest.raises(InvalidInput, match="lane_width"):
            lane_drift(BOX, 0.5, lane_width=1.8)

    def test_a_recovery_begins_beside_the_path_pointing_away(self):
        recovery = lane_recovery(BOX)
        assert recovery.start == pytest.approx((0.0, 1.0, math.radians(20)))

    def test_a_step_of_curvature_is_a_line_and_an_arc(self):
        road = curvature_step(40.0, left=False)
        (jump,) = road.curvature_jumps()
        assert jump == pytest.approx((50.0, 0.0, -1 / 40))
        with pytest.raises(InvalidInput, match="radius"):
            curvature_step(0.0)


@pytest.mark.compiled
class TestCommand:
    @pytest.fixture
    def command(self, monkeypatch, capsys):
        def run(*arguments):
            monkeypatch.setattr(sys, "argv", ["adaptrack", "manoeuvre", *arguments])
            monkeypatch.setenv("COLUMNS", "80")
            code = cli.main()
            return code, *capsys.readouterr()

        return run

    def test_it_prints_the_characteristic_values_within_80_columns(self, command):
        code, out, _ = command("step-steer", "--vehicle", "compact-ev")
        assert code == 0
        assert "yaw response time" in out
        assert max(map(len, out.splitlines()[1:-1])) <= 80  # between the answer and the next step

    def test_a_car_that_spins_ends_with_exit_code_1_and_valid_json(self, command):
        code, out, _ = command("sine-with-dwell", "--vehicle", "midsize-sedan", "--json")
        found = json.loads(out)
        assert (code, found["passed"], found["vehicle"]) == (1, False, "midsize-sedan")
        assert len(found["rows"]) == found["runs"]

    def test_an_option_of_another_manoeuvre_is_refused(self, command):
        code, _, told = command("step-steer", "--radius", "100")
        assert code == 2
        assert "--radius has no meaning for step-steer" in told

    def test_controllers_drive_a_step_of_curvature_within_80_columns_and_all_pass(self, command):
        code, out, _ = command("curvature-step", "--vehicle", "compact-ev", "--controller", "informed",
                               "--controller", "stanley")  # fmt: skip
        assert code == 0
        assert out.startswith("2 of 2 passed; ")
        assert max(map(len, out.splitlines()[1:-1])) <= 80

    def test_a_lane_change_gives_a_table_of_80_columns_and_a_picture(self, command, monkeypatch, tmp_path):
        track = ("iso-3888-2", np.array([30.0, 35.0, 80.0]), 40.0)
        monkeypatch.setitem(closed_loop.LANE_CHANGES, "obstacle-avoidance", track)
        asked = ("obstacle-avoidance", "--vehicle", "compact-ev", "--controller", "pure-pursuit")
        code, out, _ = command(*asked, "--out", str(tmp_path))
        assert code == 0
        assert max(map(len, out.replace(str(tmp_path), "").splitlines()[1:-1])) <= 80
        assert (tmp_path / "obstacle-avoidance-compact-ev.png").read_bytes().startswith(b"\x89PNG")
        code, out, _ = command(*asked, "--no-tune", "--json")
        (row,) = json.loads(out)["rows"]
        assert (row["vehicle"], row["controller"], row["tuned"]) == ("compact-ev", "pure-pursuit", False)
        assert len(row["margins"]) == 3

    def test_options_of_the_other_kind_of_manoeuvre_are_refused(self, command):
        assert command("step-steer", "--controller", "lqr")[0] == 2
        assert command("step-steer", "--vehicle", "van", "--vehicle", "paper")[0] == 2
        assert command("lane-drift", "--radius", "100")[0] == 2
