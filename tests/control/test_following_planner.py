"""A tracker that follows a planner: lines that are joined, clocks, silence, and plans that hide the error."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.following import DrivenBy, Following, Verdict
from adaptrack.control.tracker import Tracker
from adaptrack.road.planned_trajectory import PlannedTrajectory
from foreign_loop import drive, on_road

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("paper")
ROAD = at.generate_road("country", seed=1, length=1500.0)
STEERING = at.Steering(lag=0.15, dead_time=0.0, rate=0.5)
SPEED = 15.0
POSITION_NOISE = 0.03


def make_tracker(path=None, **options):
    return Tracker(at.MPC(CAR, profile="road", computation=0.0, belief=STEERING), path, **options)


def ahead(station, stamp, *, aside=0.0, noise=None, seconds=4.0, mirrored=1.0):
    """What a planner sends: the road from a station on, so far aside (m, a number or one for each point)."""
    t = np.arange(0.0, seconds, 0.1)
    place = ROAD.at(station + SPEED * t)
    x, y = place.x - aside * np.sin(place.heading), place.y + aside * np.cos(place.heading)
    if noise is not None:
        x, y = x + noise.normal(scale=0.05, size=t.size), y + noise.normal(scale=0.05, size=t.size)
    return PlannedTrajectory(t, x, mirrored * y, speed=np.full(t.size, SPEED), stamp=stamp)


def straight(start, stamp=0.0, y=0.0, speed=10.0, seconds=4.0, **more):
    t = np.arange(0.0, seconds + 0.05, 0.1)
    return PlannedTrajectory(
        t, start + speed * t, np.full(t.size, y), speed=np.full(t.size, speed), stamp=stamp, **more
    )


def stopping(start, y=0.0, speed=10.0, braking=3.0):
    t = np.linspace(0.0, speed / braking, 30)
    x = start + speed * t - 0.5 * braking * t**2
    return PlannedTrajectory(t, x, np.full(t.size, y), speed=speed - braking * t)


def on_straight(tracker, calls, start=0, speed=10.0, trajectory=None, y=0.0):
    """Call a tracker every 0.05 s on the x axis; trajectory(t, x): what arrives before a call, or None."""
    answers = []
    for k in range(start, start + calls):
        t = 0.05 * k
        if trajectory is not None and (sent := trajectory(t, speed * t)) is not None:
            tracker.follow(sent, now=t)
        answers.append(tracker.step(t, speed * t, y, 0.0, speed, 0.0))
    return answers


def replanned(seconds, plan, path=None, seed=1, tracker=None):
    """A drive along the road in which a plan arrives every 0.1 s."""
    tracker = make_tracker(path) if tracker is None else tracker

    def follow(t, car, tracker):
        if path is None and round(t / 0.05) % 2 == 0:
            foot = ROAD.project(car.x, car.y, near=10.0 + SPEED * t)
            tracker.follow(plan(t, float(foot.s), float(foot.offset)), now=t)

    return drive(tracker, ROAD, seconds, car=on_road(ROAD, s=10.0), seed=seed, before_call=follow)


# -- lines ------------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_plans_cut_from_one_line_are_driven_like_that_line():
    fixed = replanned(20.0, None, ROAD)
    cut = replanned(20.0, lambda t, s, offset: ahead(s, t))
    assert np.abs(cut.commands - fixed.commands).max() < 1e-4


@pytest.mark.compiled
def test_noise_of_points_that_come_anew_each_tenth_of_a_second_hardly_moves_the_car():
    noise = np.random.default_rng(5)
    fixed = replanned(20.0, None, ROAD)
    noisy = replanned(20.0, lambda t, s, offset: ahead(s, t, noise=noise))
    assert noisy.rms < 1.5 * fixed.rms


@pytest.mark.compiled
def test_two_planners_in_turn_are_driven_in_the_middle():
    side = iter(np.tile([0.15, -0.15], 200))
    fixed = replanned(20.0, None, ROAD)
    driven = replanned(20.0, lambda t, s, offset: ahead(s, t, aside=next(side)))
    assert abs(driven.offset[100:].mean()) < 0.02
    assert np.diff(driven.commands[60:]).std() < 1.5 * np.diff(fixed.commands[60:]).std()


def test_a_line_within_the_noise_of_the_position_is_the_line_before():
    tracker = make_tracker()
    on_straight(tracker, 1, trajectory=lambda t, x: straight(x, t))
    tracker.follow(straight(0.5, 0.05, y=0.04), now=0.05)
    s = np.arange(0.0, 8.0, 1.0) + float(tracker.path.project(0.0, 0.0).s)
    assert np.abs(tracker.path.at(s).y).max() < 1e-3
    assert tracker.path.at(tracker.path.length).y == pytest.approx(0.04, abs=1e-6)


def test_a_line_aside_is_come_to_gradually_and_a_far_or_urgent_one_at_once():
    for aside, urgent, expected in ((0.5, False, 0.5), (0.5, True, 0.0), (1.5, False, 0.0)):
        tracker = make_tracker()
        on_straight(tracker, 10, trajectory=lambda t, x: straight(x, t) if t == 0.0 else None)
        tracker.follow(straight(5.0, 0.5, y=-aside, urgent=urgent), now=0.5)
        assert tracker._kernel.memory[0].aside == pytest.approx(expected, abs=1e-6)
        out = on_straight(tracker, 1, start=10)[-1]
        assert out.offset == pytest.approx(aside, abs=1e-3)


def test_a_line_that_begins_ahead_of_the_car_goes_back_along_its_tangent():
    tracker = make_tracker()
    tracker.follow(straight(8.0), now=0.0)
    out = on_straight(tracker, 5, y=0.2)[-1]
    assert out.status == "ok"
    assert out.offset == pytest.approx(0.2, abs=1e-9)


def test_a_mirrored_planner_is_followed_by_mirrored_commands():
    commands = []
    for side in (1.0, -1.0):
        tracker = make_tracker()
        on_straight(
            tracker, 4, y=0.1 * side, trajectory=lambda t, x, side=side: straight(x, t, y=0.2 * side * (t > 0.1))
        )
        commands.append(on_straight(tracker, 4, start=4, y=0.1 * side)[-1].command)
    assert commands[0] != 0.0
    assert commands[1] == pytest.approx(-commands[0], abs=1e-9)


# -- clocks -----------------------------------------------------------------------------------------------------------
def test_what_comes_late_twice_or_from_the_future_is_refused_with_its_reason():
    tracker = make_tracker()
    on_straight(tracker, 1)
    assert tracker.follow(straight(0.0, 5.0), now=5.0) is Verdict.TAKEN
    assert tracker.follow(straight(0.0, 5.1), now=5.1) is Verdict.SAME
    assert tracker.follow(straight(0.3, 5.0), now=5.2) is Verdict.OLDER
    assert tracker.follow(straight(0.4, 4.0), now=5.3) is Verdict.STALE
    assert tracker.follow(straight(0.5, 5.6), now=5.4) is Verdict.EARLY
    assert tracker.follow(PlannedTrajectory([], [], []), now=5.5) is Verdict.SILENT
    assert tracker.follow(straight(0.6), now=5.6) is Verdict.TAKEN


def test_another_clock_is_believed_at_its_third_stamp_and_its_offset_is_the_least_delay():
    tracker = make_tracker()
    on_straight(tracker, 1)
    verdicts = [
        tracker.follow(straight(0.1 * k, 1000.0 + 0.1 * k), now=5.0 + 0.1 * k + delay)
        for k, delay in enumerate((0.05, 0.03, 0.06, 0.01, 0.04))
    ]
    assert verdicts == [Verdict.EARLY] * 2 + [Verdict.TAKEN] * 3
    assert tracker._kernel.planned.memory[0].clock_offset == pytest.approx(-995.0 + 0.01, abs=1e-3)


def test_a_planner_that_begins_its_clock_anew_is_believed_after_three_stamps_or_an_engagement():
    tracker = make_tracker()
    on_straight(tracker, 1)
    assert tracker.follow(straight(0.0, 5.0), now=5.0) is Verdict.TAKEN
    verdicts = [tracker.follow(straight(0.1 * k, 1.0 + 0.1 * k), now=5.1 + 0.1 * k) for k in range(1, 4)]
    assert verdicts == [Verdict.STALE, Verdict.STALE, Verdict.TAKEN]


def test_a_stamp_of_nothing_is_that_of_the_arrival():
    tracker = make_tracker()
    on_straight(tracker, 20, trajectory=lambda t, x: straight(x) if round(t / 0.05) % 2 == 0 else None)
    assert tracker._answer(1.0).late == pytest.approx(0.0, abs=0.02)


# -- silence ----------------------------------------------------------------------------------------------------------
def test_half_a_second_of_silence_changes_nothing():
    tracker = make_tracker()
    answers = on_straight(tracker, 20, trajectory=lambda t, x: straight(x, t) if t <= 0.5 else None)
    assert {answer.driven_by for answer in answers} == {DrivenBy.PLANNER}


def test_a_silent_planner_leaves_the_car_to_its_fallback_and_returns_after_three_trajectories():
    tracker = make_tracker()
    on_straight(tracker, 1)
    for k in range(4):
        tracker.follow(straight(1.0 * k, 0.1 * k), fallback=stopping(1.0 * k + 0.5), now=0.1 * k)
        on_straight(tracker, 2, start=1 + 2 * k)
    answers = on_straight(tracker, 14, start=9)
    assert answers[-1].driven_by is DrivenBy.FALLBACK
    assert tracker.path.at(tracker.path.length).x == pytest.approx(3.5 + 100.0 / 6.0, abs=1e-3)
    now = 0.05 * 22
    verdicts = [tracker.follow(straight(10.0 * (now + 0.1 * k), now + 0.1 * k), now=now + 0.1 * k) for k in range(3)]
    assert verdicts == [Verdict.WAITING, Verdict.WAITING, Verdict.TAKEN]


@pytest.mark.parametrize("fallback", [None, "aside", "stale"])
def test_without_a_fallback_that_fits_the_car_stops(fallback):
    tracker = make_tracker(following=Following(fallback_age=0.1 if fallback == "stale" else 3.0))
    on_straight(tracker, 1)
    left = None if fallback is None else stopping(0.0, y=2.0 if fallback == "aside" else 0.0)
    tracker.follow(straight(0.0), fallback=left, now=0.0)
    assert on_straight(tracker, 16, start=1)[-1].driven_by is DrivenBy.STOP


def test_a_fallback_that_does_not_end_at_rest_is_refused():
    tracker = make_tracker()
    with pytest.raises(at.InvalidInput, match="must end at rest"):
        tracker.follow(straight(0.0), fallback=straight(0.0), now=0.0)


def test_a_fallback_beyond_the_friction_is_not_followed():
    t = np.linspace(0.0, 3.0, 31)
    angle = (12.0 * t - 2.0 * t**2) / 10.0  # rad, on a circle of 10 m: 14.4 m/s^2
    circle = PlannedTrajectory(t, 10.0 * np.sin(angle), 10.0 * (1.0 - np.cos(angle)), speed=12.0 - 4.0 * t)
    tracker = make_tracker(speed=at.SpeedControl(CAR))
    tracker.follow(straight(0.0), fallback=circle, now=0.0)
    assert on_straight(tracker, 16)[-1].driven_by is DrivenBy.STOP


# -- a plan that begins at the car ------------------------------------------------------------------------------------
def hidden_offset(aside, begins_at_car):
    """Sentences on inputs, where a car stays so far (m) beside the x axis; trajectories come back to it in 2 s."""
    tracker = make_tracker()

    def send(t, x):
        seconds = np.arange(0.0, 4.0, 0.1)
        y = aside * np.maximum(1.0 - seconds / 2.0, 0.0) ** 3 if begins_at_car else np.zeros(seconds.size)
        return PlannedTrajectory(seconds, x + 10.0 * seconds, y, speed=np.full(seconds.size, 10.0), stamp=t)

    answers = on_straight(tracker, 200, y=aside, trajectory=send)
    return [sentence for sentence in answers[-1].suspect if "trajectories" in sentence]


@pytest.mark.compiled
def test_a_planner_that_hides_an_offset_is_reported_and_one_that_shows_it_is_not():
    assert len(hidden_offset(0.3, begins_at_car=True)) == 1
    assert not hidden_offset(0.3, begins_at_car=False)
    assert not hidden_offset(0.05, begins_at_car=True)


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
    circle = PlannedTrajectory(
        t, radius * np.sin(angle), radius * (1.0 - np.cos(angle)), yaw=angle, speed=0.0 * t + 2.0
    )
    tracker = make_tracker(following=Following(tracked_point="rear axle"))
    tracker.follow(circle, now=0.0)
    foot = tracker.path.at(np.linspace(8.0, 12.0, 9))
    distance = np.hypot(foot.x, foot.y - radius)
    np.testing.assert_allclose(distance, np.hypot(radius, CAR.lr), atol=2e-3)
    assert np.hypot(radius, CAR.lr) - radius == pytest.approx(CAR.lr**2 / (2.0 * radius), rel=0.05)
