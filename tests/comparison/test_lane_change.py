"""Lane changes of ISO 3888: tracks and margins by hand, entry speeds and the command in closed loop."""

import json
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars.outline import Outline
from adaptrack.comparison import entry_speed, lane_change
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road import Line

BOX = Outline(front=2.0, rear=2.0, width=1.8)
LANE = lane_change.Track("lane", (lane_change.Gate(0.0, 10.0, -1.5, 1.5),))
ROAD = at.Road.from_segments([Line(length=150.0)], start=(-50.0, 0.0, 0.0))


def straight(y, heading=0.0):
    x = np.linspace(-10.0, 20.0, 61)
    return x, y + (x - 5.0) * math.tan(heading), np.full(x.size, heading)


class TestLaneChange:
    def test_the_tracks_have_the_lengths_and_widths_of_the_standard(self):
        first, second = lane_change.iso_3888_1(1.8), lane_change.iso_3888_2(1.8)
        assert (first.length, second.length) == (125.0, 61.0)
        assert [gate.width for gate in first.gates] == pytest.approx([2.23, 2.41, 2.59])
        assert [gate.width for gate in second.gates] == pytest.approx([2.23, 2.8, 3.0])
        assert second.gates[1].right - second.gates[0].left == pytest.approx(1.0)
        assert first.gates[1].right - first.gates[0].right == pytest.approx(3.5)
        assert lane_change.iso_3888_2(2.4).gates[2].width == pytest.approx(1.3 * 2.4 + 0.25)
        assert first.cones.shape == (12, 2)

    def test_beside_the_middle_of_a_lane_the_margin_is_what_is_left(self):
        for y, margin in ((0.0, 0.6), (0.4, 0.2), (-0.7, -0.1)):
            result = lane_change.clearance(LANE, BOX, *straight(y))
            assert result.least == pytest.approx(margin)
            assert result.clean == (margin > 0.0)

    def test_a_straight_line_across_a_lane_passes_its_cones_at_their_distance_from_the_side(self):
        heading = 0.2
        cone = 1.5 * math.cos(heading) - 5.0 * math.sin(heading)  # (10, 1.5) from the line through (5, 0)
        assert lane_change.clearance(LANE, BOX, *straight(0.0, heading)).least == pytest.approx(cone - 0.9, abs=0.01)

    def test_a_cone_between_the_corners_is_hit_by_the_side(self):
        short = lane_change.Track(
            "short", (lane_change.Gate(0.0, 1.0, -1.5, 1.5),)
        )  # all corners are beyond it while the car turns
        x, heading = np.array([-10.0, 0.4, 0.5, 0.6, 20.0]), math.radians(30)
        result = lane_change.clearance(short, BOX, x, np.zeros(5), np.array([0.0, 0.0, heading, 0.0, 0.0]))
        side = 1.5 * math.cos(heading) - 0.5 * math.sin(heading) - 0.9
        assert result.least == pytest.approx(side, abs=0.01)
        assert result.place == pytest.approx(0.5, abs=0.06)

    def test_a_lane_that_is_not_driven_through_has_no_margin(self):
        x, y, yaw = straight(0.0)
        short = x < 8.0
        assert lane_change.clearance(LANE, BOX, x[short], y[short], yaw[short]).least == -math.inf
        assert lane_change.clearance(LANE, BOX, np.where(short, x, np.nan), y, yaw).margins == (-math.inf,)

    @pytest.mark.parametrize("make", [lane_change.iso_3888_1, lane_change.iso_3888_2])
    @pytest.mark.parametrize("car", ["compact-ev", "van"])
    def test_along_its_road_the_body_passes_all_gates_with_the_room_asked_for(self, make, car):
        outline = at.load_vehicle(car).outline
        track = make(outline.width)
        road = lane_change.track_road(track, outline, room=0.1)
        s = np.linspace(0.0, road.length, 1500)
        line = road.at(s)
        result = lane_change.clearance(track, outline, line.x, line.y, line.heading)
        assert result.clean
        assert min(result.margins) == pytest.approx(0.1, abs=0.04)
        assert np.abs(line.curvature).max() < (0.01 if make is lane_change.iso_3888_1 else 0.04)
        assert np.abs(line.heading[line.x < -1.0]).max() < 0.03  # it enters straight
        inside = (line.x > 1.0) & (line.x < track.gates[0].end - 1.0)
        left = line.y[inside] + road.along("width_left", s[inside])
        assert left == pytest.approx(track.gates[0].left, abs=1e-3)

    def test_off_the_throttle_the_planned_speed_falls_as_that_of_a_plant(self):
        car = at.load_vehicle("van")
        track = lane_change.iso_3888_2(car.outline.width)
        plan = lane_change.coasting_plan(track, ROAD, car, 20.0)
        assert plan.at([0.0, 49.0]) == pytest.approx(20.0)
        roll = car.rolling_resistance * GRAVITY
        drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient / car.mass
        v, step = 20.0, 0.001
        for _ in range(100_000):  # dv/ds = -(roll + drag v^2)/v over 100 m
            v -= step * (roll + drag * v * v) / v
        assert plan.speed[-1] == pytest.approx(v, rel=1e-4)

    @pytest.mark.parametrize(("make", "words"), [
        (lambda: lane_change.track_road(lane_change.iso_3888_2(1.5), BOX), "does not fit through iso-3888-2"),
        (lambda: lane_change.track_road(lane_change.iso_3888_2(1.8), BOX, bend=0), "bend = 0"),
        (lambda: lane_change.iso_3888_1(0), "width = 0"),
        (lambda: lane_change.scan_speeds(lambda speed: None, [2.0, 1.0]), "must increase"),
        (lambda: lane_change.clearance(LANE, BOX, *straight(0.0)[:2], [0.0]), "n >= 2"),
        (lambda: lane_change.coasting_plan(LANE, ROAD, at.load_vehicle("van"), 3.0), "stops before the end"),
        (lambda: entry_speed.tune_for_track(None, "mine", None, 12.0), "no search"),
    ])  # fmt: skip
    def test_impossible_input_is_refused(self, make, words):
        with pytest.raises(at.InvalidInput, match=words):
            make()

    @pytest.mark.parametrize("car", ["compact-ev", "van"])
    def test_a_line_for_a_speed_leaves_more_room_the_slower_and_bends_less_the_faster(self, car):
        car = at.load_vehicle(car)
        track = lane_change.iso_3888_2(car.outline.width)
        result = {}
        for speed in (10.0, 14.0, 20.0):
            road = lane_change.driven_line(track, car, speed)
            line = road.at(np.linspace(0.0, road.length, 2000))
            slip = car.lr - car.mass * car.lf * speed**2 / (2.0 * car.stiffness_rear * car.wheelbase)
            body = lane_change.clearance(track, car.outline, line.x, line.y, line.heading - slip * line.curvature)
            result[speed] = body.least, np.abs(line.curvature).max()
        assert result[10.0][0] > result[14.0][0] > result[20.0][0] - 0.01
        assert result[10.0][1] > result[14.0][1]
        assert all(0.02 < room < 0.16 for room, _ in result.values())

    def test_a_bend_that_allows_it_leaves_all_the_room_asked_for(self):
        track = lane_change.iso_3888_2(1.8)
        road = lane_change.track_road(track, BOX, 0.15, bend=10.0)
        line = road.at(np.linspace(0.0, road.length, 2000))
        assert lane_change.clearance(track, BOX, line.x, line.y, line.heading).least == pytest.approx(0.15, abs=0.04)

    def test_a_scan_tells_the_speeds_up_to_which_all_are_clean_from_those_that_are_by_luck(self):
        def judge(speed):  # 0.6 m are used up at 60 m/s
            return lane_change.clearance(LANE, BOX, *straight(0.0 if speed == 64.0 else 0.01 * speed))

        result = lane_change.scan_speeds(judge, np.arange(50.0, 100.0, 2.0))
        assert (result.speed, result.failing) == (pytest.approx(60.0, abs=2.0), result.speed + 2.0)
        assert result.highest == 64.0
        assert max(result.clearances) < 98.0  # faster speeds are not driven after eight failures in a row
        assert math.isnan(lane_change.scan_speeds(judge, [70.0, 80.0]).highest)
        assert math.isnan(lane_change.scan_speeds(judge, [10.0, 20.0]).failing)

    def test_between_the_instants_the_car_is_on_the_arc_that_it_drives(self):
        t, v, r = np.arange(0.0, 2.0, 0.1)[:, None], 15.0, 0.5
        circle = np.hstack([v / r * np.sin(r * t), v / r * (1 - np.cos(r * t)), r * t, v + 0 * t, 0 * t, r + 0 * t])
        x, y, yaw = entry_speed.refined_poses(circle, 0.1).T
        assert len(x) == 19 * 5 + 1
        assert np.hypot(x, y - v / r) == pytest.approx(v / r, abs=1e-6)
        assert yaw == pytest.approx(np.arctan2(x, v / r - y), abs=1e-6)


@pytest.fixture(scope="module")
def obstacle():
    car = at.load_vehicle("compact-ev")
    profile = at.load_profile("road")
    track = lane_change.iso_3888_2(car.outline.width)
    return entry_speed.LaneChangeTest(car, at.get_plant("dual-track", car), track, profile)


def driver_of(test, name):
    return at.get_controller(name, test.car, profile=test.profile, period=test.profile.period, preview=True)


@pytest.mark.compiled
class TestEntrySpeed:
    def test_the_informed_mpc_passes_at_40_km_h_and_fails_well_beyond_the_grip(self, obstacle):
        result = entry_speed.entry_speed(obstacle, "informed", driver_of(obstacle, "informed"), [40 / 3.6, 80 / 3.6])
        assert result.row["clean"] == pytest.approx(40.0)
        assert result.row["failing"] == pytest.approx(80.0)
        assert 0.0 < result.row["margin"] < 0.2
        assert lane_change.clearance(obstacle.track, obstacle.car.outline, *result.poses[0].T).clean

    def test_many_tunings_at_once_are_driven_as_each_alone(self, obstacle):
        stanley = driver_of(obstacle, "stanley")
        tunings = np.array([[0.5 + 0.1 * k, 1.0, 0.05, 0.2] for k in range(20)])  # more than a block holds
        together = obstacle.drive(stanley, 12.0, tunings, (0, 1))
        alone = obstacle.drive(stanley, 12.0, tunings[17:18], (1,))
        assert np.array_equal(together[17, 1], alone[0, 0], equal_nan=True)
        slow = at.rollout(obstacle.plant, stanley, obstacle.entering_at(12.0), profile=obstacle.profile, seed=1)
        default = obstacle.drive(stanley, 12.0, stanley.packed_tuning()[None], (1,))[0, 0]
        assert np.array_equal(default[::5, 1], slow.Y)

    def test_a_tuning_that_was_searched_is_no_worse_than_the_own_one_where_it_was_searched(self, obstacle):
        law = driver_of(obstacle, "lqr")
        tuning, margin = entry_speed.tune_for_track(obstacle, "lqr", law, 12.0)
        (default,) = obstacle.margins(law, 12.0, law.packed_tuning()[None], entry_speed.TUNING_SEEDS)
        assert margin.least > default.least + 0.05
        assert any(np.array_equal(tuning, candidate) for candidate in entry_speed.tunings_to_try("lqr", law))


@pytest.mark.compiled
def test_the_command_gives_a_table_and_a_page(run_command, monkeypatch, tmp_path):
    grid = entry_speed.LANE_CHANGES["iso3888-2"]._replace(speeds=(30.0, 35.0, 80.0), tuned_at=40.0)
    monkeypatch.setitem(entry_speed.LANE_CHANGES, "iso3888-2", grid)
    command = ["compare", "--lane-change", "iso3888-2", "--vehicle", "compact-ev", "--controller", "pure-pursuit"]
    code, out, err = run_command(*command, "--out", tmp_path)
    assert code == 0, err
    assert "Highest clean entry speed" in out
    assert (tmp_path / "compact-ev-road.png").read_bytes().startswith(b"\x89PNG")
    (row,) = json.loads(run_command(*command, "--budget", "0", "--json")[1])["rows"]
    assert (row["vehicle"], row["controller"], row["tuned"]) == ("compact-ev", "pure-pursuit", False)
    assert len(row["margins"]) == 3
