"""A tracker that follows a planner: joined lines, clocks, silence, and plans that hide the error."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.following import DrivenBy, Following, Verdict
from adaptrack.road.planned_trajectory import PlannedTrajectory
from foreign_loop import drive, on_road

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("paper")
ROAD = at.generate_road("country", seed=1, length=1500.0)
STEERING = at.Steering(lag=0.15, dead_time=0.0, rate=0.5)
SPEED = 15.0


def make_tracker(path=None, **options):
    return at.Tracker(at.MPC(CAR, profile="road", computation=0.0, belief=STEERING), path, **options)


def road_plan(station, stamp, *, offset=0.0, noise=None):
    """A trajectory of 4 s along the road from a station on, with an offset (m) to the left and noise."""
    t = np.arange(0.0, 4.0, 0.1)
    place = ROAD.at(station + SPEED * t)
    x, y = place.x - offset * np.sin(place.heading), place.y + offset * np.cos(place.heading)
    if noise is not None:
        x, y = x + noise.normal(scale=0.05, size=t.size), y + noise.normal(scale=0.05, size=t.size)
    return PlannedTrajectory(t, x, y, speed=np.full(t.size, SPEED), stamp=stamp)


def straight_plan(start, stamp=0.0, y=0.0, urgent=False):
    """A trajectory of 4 s at 10 m/s, parallel to the x axis."""
    t = np.arange(0.0, 4.05, 0.1)
    return PlannedTrajectory(t, start + 10.0 * t, 0.0 * t + y, speed=0.0 * t + 10.0, stamp=stamp, urgent=urgent)


def stopping_plan(start, y=0.0):
    """A trajectory from 10 m/s to rest at 3 m/s^2, parallel to the x axis."""
    t = np.linspace(0.0, 10.0 / 3.0, 30)
    return PlannedTrajectory(t, start + 10.0 * t - 1.5 * t**2, np.full(t.size, y), speed=10.0 - 3.0 * t)


def drive_straight(tracker, calls, start=0, plan=None, y=0.0, speed=10.0):
    """Results of calls every 0.05 s along the x axis; plan(t, x): trajectory before a call, or None."""
    results = []
    for k in range(start, start + calls):
        t = 0.05 * k
        if plan is not None and (trajectory := plan(t, speed * t)) is not None:
            tracker.follow(trajectory, now=t)
        results.append(tracker.step(t, speed * t, y, 0.0, speed, 0.0))
    return results


def drive_road(plan=None):
    """A drive of 20 s along the road, with a trajectory plan(t, station) every 0.1 s; None: along the road as path."""

    def follow(t, car, tracker):
        if plan is not None and round(t / 0.05) % 2 == 0:
            station = ROAD.project(car.x, car.y, near=10.0 + SPEED * t).s
            tracker.follow(plan(t, float(station)), now=t)

    tracker = make_tracker(ROAD if plan is None else None)
    return drive(tracker, ROAD, 20.0, car=on_road(ROAD, s=10.0), seed=1, before_call=follow)


# -- lines ------------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_plans_cut_from_one_line_are_driven_like_that_line():
    replanned_drive = drive_road(lambda t, s: road_plan(s, t))
    assert np.abs(replanned_drive.commands - drive_road().commands).max() < 1e-4


@pytest.mark.compiled
def test_noise_of_points_that_come_anew_each_tenth_of_a_second_hardly_moves_the_car():
    noise = np.random.default_rng(5)
    assert drive_road(lambda t, s: road_plan(s, t, noise=noise)).rms < 1.5 * drive_road().rms


@pytest.mark.compiled
def test_two_planners_in_turn_are_driven_in_the_middle():
    offsets = iter(np.tile([0.15, -0.15], 200))
    path_drive, planner_drive = drive_road(), drive_road(lambda t, s: road_plan(s, t, offset=next(offsets)))
    assert abs(planner_drive.offset[100:].mean()) < 0.02
    assert np.diff(planner_drive.commands[60:]).std() < 1.5 * np.diff(path_drive.commands[60:]).std()


def test_a_line_within_the_noise_of_the_position_is_the_line_before():
    tracker = make_tracker()
    drive_straight(tracker, 1, plan=lambda t, x: straight_plan(x, t))
    tracker.follow(straight_plan(0.5, 0.05, y=0.04), now=0.05)
    s = np.arange(0.0, 8.0, 1.0) + float(tracker.path.project(0.0, 0.0).s)
    assert np.abs(tracker.path.at(s).y).max() < 1e-3
    assert tracker.path.at(tracker.path.length).y == pytest.approx(0.04, abs=1e-6)


@pytest.mark.parametrize(("offset", "urgent", "reference"), [(0.5, False, 0.5), (0.5, True, 0.0), (1.5, False, 0.0)])
def test_the_reference_moves_gradually_to_a_parallel_line_and_at_once_to_a_far_or_urgent_one(offset, urgent, reference):
    tracker = make_tracker()
    drive_straight(tracker, 10, plan=lambda t, x: straight_plan(x, t) if t == 0.0 else None)
    tracker.follow(straight_plan(5.0, 0.5, y=-offset, urgent=urgent), now=0.5)
    assert tracker._kernel.memory[0].aside == pytest.approx(reference, abs=1e-6)
    assert drive_straight(tracker, 1, start=10)[-1].offset == pytest.approx(offset, abs=1e-3)


def test_a_line_that_begins_ahead_of_the_car_is_extended_back_along_its_tangent():
    tracker = make_tracker()
    tracker.follow(straight_plan(8.0), now=0.0)
    out = drive_straight(tracker, 5, y=0.2)[-1]
    assert out.status == "ok"
    assert out.offset == pytest.approx(0.2, abs=1e-9)


def test_a_mirrored_planner_is_followed_by_mirrored_commands():
    commands = []
    for side in (1.0, -1.0):
        tracker = make_tracker()
        drive_straight(tracker, 4, y=0.1 * side, plan=lambda t, x, y=0.2 * side: straight_plan(x, t, y=y * (t > 0.1)))
        commands.append(drive_straight(tracker, 4, start=4, y=0.1 * side)[-1].command)
    assert commands[0] != 0.0
    assert commands[1] == pytest.approx(-commands[0], abs=1e-9)


# -- clocks -----------------------------------------------------------------------------------------------------------
def test_late_repeated_and_future_trajectories_are_refused_with_a_reason():
    tracker = make_tracker()
    drive_straight(tracker, 1)
    assert tracker.follow(straight_plan(0.0, 5.0), now=5.0) is Verdict.TAKEN
    assert tracker.follow(straight_plan(0.0, 5.1), now=5.1) is Verdict.SAME
    assert tracker.follow(straight_plan(0.3, 5.0), now=5.2) is Verdict.OLDER
    assert tracker.follow(straight_plan(0.4, 4.0), now=5.3) is Verdict.STALE
    assert tracker.follow(straight_plan(0.5, 5.6), now=5.4) is Verdict.EARLY
    assert tracker.follow(PlannedTrajectory([], [], []), now=5.5) is Verdict.SILENT
    assert tracker.follow(straight_plan(0.6), now=5.6) is Verdict.TAKEN


def test_a_different_clock_is_accepted_at_its_third_stamp_with_the_least_delay_as_offset():
    tracker = make_tracker()
    drive_straight(tracker, 1)
    verdicts = [
        tracker.follow(straight_plan(0.1 * k, 1000.0 + 0.1 * k), now=5.0 + 0.1 * k + delay)
        for k, delay in enumerate((0.05, 0.03, 0.06, 0.01, 0.04))
    ]
    assert verdicts == [Verdict.EARLY] * 2 + [Verdict.TAKEN] * 3
    assert tracker._kernel.planned.memory[0].clock_offset == pytest.approx(-995.0 + 0.01, abs=1e-3)


def test_a_clock_that_restarts_is_accepted_at_its_third_stamp():
    tracker = make_tracker()
    drive_straight(tracker, 1)
    assert tracker.follow(straight_plan(0.0, 5.0), now=5.0) is Verdict.TAKEN
    verdicts = [tracker.follow(straight_plan(0.1 * k, 1.0 + 0.1 * k), now=5.1 + 0.1 * k) for k in range(1, 4)]
    assert verdicts == [Verdict.STALE, Verdict.STALE, Verdict.TAKEN]


def test_a_stamp_of_0_stands_for_the_time_of_arrival():
    tracker = make_tracker()
    drive_straight(tracker, 20, plan=lambda t, x: straight_plan(x) if round(t / 0.05) % 2 == 0 else None)
    assert tracker._answer(1.0).late == pytest.approx(0.0, abs=0.02)


# -- silence ----------------------------------------------------------------------------------------------------------
def test_half_a_second_of_silence_changes_nothing():
    tracker = make_tracker()
    results = drive_straight(tracker, 20, plan=lambda t, x: straight_plan(x, t) if t <= 0.5 else None)
    assert {result.driven_by for result in results} == {DrivenBy.PLANNER}


def test_a_silent_planner_leaves_the_car_to_its_fallback_and_returns_after_three_trajectories():
    tracker = make_tracker()
    drive_straight(tracker, 1)
    for k in range(4):
        tracker.follow(straight_plan(1.0 * k, 0.1 * k), fallback=stopping_plan(1.0 * k + 0.5), now=0.1 * k)
        drive_straight(tracker, 2, start=1 + 2 * k)
    results = drive_straight(tracker, 14, start=9)
    assert results[-1].driven_by is DrivenBy.FALLBACK
    assert tracker.path.at(tracker.path.length).x == pytest.approx(3.5 + 100.0 / 6.0, abs=1e-3)
    verdicts = [tracker.follow(straight_plan(10.0 * t, t), now=t) for t in (1.1, 1.2, 1.3)]
    assert verdicts == [Verdict.WAITING, Verdict.WAITING, Verdict.TAKEN]


@pytest.mark.parametrize("fallback", [None, "far", "stale"])
def test_without_a_fallback_that_fits_the_car_stops(fallback):
    tracker = make_tracker(following=Following(fallback_age=0.1 if fallback == "stale" else 3.0))
    drive_straight(tracker, 1)
    trajectory = None if fallback is None else stopping_plan(0.0, y=2.0 if fallback == "far" else 0.0)
    tracker.follow(straight_plan(0.0), fallback=trajectory, now=0.0)
    assert drive_straight(tracker, 16, start=1)[-1].driven_by is DrivenBy.STOP


def test_a_fallback_that_does_not_end_at_rest_is_refused():
    tracker = make_tracker()
    with pytest.raises(at.InvalidInput, match="must end at rest"):
        tracker.follow(straight_plan(0.0), fallback=straight_plan(0.0), now=0.0)


def test_a_fallback_beyond_the_friction_is_not_followed():
    t = np.linspace(0.0, 3.0, 31)
    angle = (12.0 * t - 2.0 * t**2) / 10.0  # rad, on a circle of 10 m: 14.4 m/s^2
    circle = PlannedTrajectory(t, 10.0 * np.sin(angle), 10.0 * (1.0 - np.cos(angle)), speed=12.0 - 4.0 * t)
    tracker = make_tracker(speed=at.SpeedControl(CAR))
    tracker.follow(straight_plan(0.0), fallback=circle, now=0.0)
    assert drive_straight(tracker, 16)[-1].driven_by is DrivenBy.STOP


def test_engage_leaves_the_planner_the_time_of_a_silence_to_send_again():
    for sends, driver in ((False, DrivenBy.STOP), (True, DrivenBy.PLANNER)):
        tracker = make_tracker(speed=at.SpeedControl(CAR))
        drive_straight(tracker, 20, plan=lambda t, x: straight_plan(x, t))
        tracker.engage()
        results = drive_straight(tracker, 10, start=20)
        assert {(result.driven_by, result.target_speed) for result in results} == {(DrivenBy.PLANNER, 10.0)}
        assert not sends or tracker.follow(straight_plan(15.0, 1.5), now=1.5) is Verdict.TAKEN
        assert drive_straight(tracker, 3, start=30)[-1].driven_by is driver


@pytest.mark.parametrize(("path", "options"), [(ROAD, {}), (ROAD, {"now": 0.1}), (straight_plan(1.0), {"near": 3.0})])
def test_a_refused_path_leaves_the_car_with_its_planner(path, options):
    tracker = make_tracker(speed=at.SpeedControl(CAR))
    drive_straight(tracker, 2, plan=lambda t, x: straight_plan(x, t))
    with pytest.raises(at.InvalidInput, match=r"follows a plan|belong to a"):
        tracker.follow(path, **options)
    assert drive_straight(tracker, 1, start=2)[-1].driven_by is DrivenBy.PLANNER


# -- a plan that begins at the car ------------------------------------------------------------------------------------
def suspected_trajectories(y, line, speed=10.0):
    """Sentences of `suspect` on trajectories for a car that stays at y (m); line(seconds, k): y of the k-th one."""

    def plan(t, x):
        seconds = np.arange(0.0, 4.0, 0.1)
        plan = PlannedTrajectory(seconds, x + speed * seconds, line(seconds, round(t / 0.1)) + 0.0 * seconds, stamp=t)
        return plan if round(t / 0.05) % 2 == 0 else None

    last = drive_straight(make_tracker(), 240, y=y, plan=plan, speed=speed)[-1]
    return [sentence for sentence in last.suspect if "trajectories" in sentence]


@pytest.mark.compiled
def test_a_planner_that_hides_an_offset_is_reported_and_one_that_shows_it_is_not():
    assert len(suspected_trajectories(0.3, lambda t, k: 0.3 * np.maximum(1.0 - t / 2.0, 0.0) ** 3)) == 1
    assert not suspected_trajectories(0.3, lambda t, k: 0.0)
    assert not suspected_trajectories(0.05, lambda t, k: 0.05 * np.maximum(1.0 - t / 2.0, 0.0) ** 3)


@pytest.mark.compiled
def test_two_slow_planners_in_turn_hide_no_offset():
    """At 5 m/s every second trajectory is a step of `FAR_STEP` on: the places are all those of one planner."""
    assert not suspected_trajectories(0.0, lambda t, k: 0.2 * (-1.0) ** k, speed=5.0)


# -- points of the car ------------------------------------------------------------------------------------------------
def test_samples_of_the_rear_axle_are_those_of_the_centre_of_mass_moved_back():
    commands = []
    for point, arm in (("centre of mass", 0.0), ("rear axle", -CAR.lr), ("front axle", CAR.lf)):
        tracker = make_tracker(ROAD, sample_point=point)
        for k in range(20):
            place = ROAD.at(20.0 + 0.75 * k)
            x, y = place.x + arm * np.cos(place.heading + 0.01), place.y + arm * np.sin(place.heading + 0.01)
            out = tracker.step(0.05 * k, float(x), float(y), float(place.heading) + 0.01, SPEED, 0.0)
        commands.append((out.command, out.offset))
    np.testing.assert_allclose(commands[1:], [commands[0]] * 2, rtol=0.0, atol=1e-9)


def test_a_trajectory_of_the_rear_axle_on_a_circle_leads_the_centre_of_mass_outside():
    radius, t = 6.0, np.arange(0.0, 6.0, 0.1)
    angle = 2.0 * t / radius
    x, y = radius * np.sin(angle), radius * (1.0 - np.cos(angle))
    circle = PlannedTrajectory(t, x, y, yaw=angle, speed=0.0 * t + 2.0)
    tracker = make_tracker(following=Following(tracked_point="rear axle"))
    tracker.follow(circle, now=0.0)
    foot = tracker.path.at(np.linspace(8.0, 12.0, 9))
    np.testing.assert_allclose(np.hypot(foot.x, foot.y - radius), np.hypot(radius, CAR.lr), atol=2e-3)
    assert np.hypot(radius, CAR.lr) - radius == pytest.approx(CAR.lr**2 / (2.0 * radius), rel=0.05)
