"""A tracker in a loop that is not ours: time stamps, hand-over, statuses, paths that change under way."""

import copy
import logging
import math
import pickle
from dataclasses import replace

import numpy as np
import pytest

import adaptrack as at
from adaptrack.road import Arc, Clothoid, Line
from foreign_loop import drive, on_road, steady_turn, window
from tracker_calls import calls

CAR = at.load_vehicle("paper")
ROAD = at.generate_road("country", seed=1, length=1500.0)
CIRCLE = at.Road.from_segments([Arc(length=120.0 * math.pi, curvature=1 / 60)], closed=True, name="circle")
SHORT = at.Road.from_segments([Line(length=60.0)], name="short")
STEERING = at.Steering(lag=0.15, dead_time=0.05, rate=0.5)
"""Of the bicycle."""
EXACT = (0.0,) * 5
SPOILT = {
    "jitter": {"jitter": (0.02, 0.09)}, "every seventh missing": {"missing": 7}, "wrap": {"wrapped": True},
    "late": {"late": 0.1}, "late pose, prompt motion": {"late": 0.1, "prompt_motion": True},
    "late and reordered": {"late": 0.1, "reorder": 0.05}, "repeated": {"repeat": 5},
}  # fmt: skip


def informed(oldest=0.25):
    sensors = replace(at.KalmanFilter.from_profile(at.load_profile("road")), oldest=oldest)
    return at.MPC(CAR, profile="road", computation=0.0, estimator=sensors, belief=STEERING)


def at_rest(tracker, path=SHORT, t=0.0, speed=0.0, **options):
    """A sample at the start of a path."""
    place = path.at(0.0)
    return tracker.step(t, float(place.x), float(place.y), float(place.heading), speed, 0.0, **options)


# -- samples as they come ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("channel", [*SPOILT.values(), {"period": 0.01}], ids=[*SPOILT, "100 Hz"])
def test_without_noise_no_time_stamp_moves_the_car(channel):
    """Whatever arrives when, each sample is the truth at its time; a millimetre would be an instant mistaken."""
    assert drive(at.Tracker(informed(), ROAD), ROAD, 15.0, noise=EXACT, **channel).rms < 0.001


@pytest.fixture(scope="module")
def exact_rms():
    return rms_of({})


def rms_of(channel):
    """Over two seeds of the noise."""
    return math.hypot(*(drive(at.Tracker(informed(), ROAD), ROAD, seed=seed, **channel).rms for seed in (2, 3)))


@pytest.mark.parametrize("channel", SPOILT.values(), ids=SPOILT)
def test_spoilt_samples_cost_half_at_most(channel, exact_rms):
    assert exact_rms < 0.02
    assert rms_of(channel) <= 1.5 * exact_rms


def test_all_of_it_together_still_drives():
    everything = {name: value for channel in SPOILT.values() for name, value in channel.items()}
    assert np.abs(drive(at.Tracker(informed(0.35), ROAD), ROAD, **everything).offset).max() < 0.1


def test_a_filter_that_takes_nothing_late_is_told_of(caplog):
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        run = drive(at.Tracker(informed(0.0), ROAD), ROAD, 10.0, late=0.1)
    assert [record.message.count("0.1 s late") for record in caplog.records] == [1]
    assert np.abs(run.offset).max() < 0.1


def test_a_pose_that_is_late_alone_gives_the_errors_and_the_command_of_the_prompt_car():
    """On a circle the late pose, moved on by the prompt motion, is the present one but for the chord of its arc."""
    rate, speed, late = 0.15, 0.15 * (60.0 - 0.3), 0.1
    trackers = [at.Tracker(at.LQR(CAR), CIRCLE), at.Tracker(at.LQR(CAR), CIRCLE)]
    for k in range(1, 40):
        t = 0.05 * k
        answers = []
        for tracker, age in zip(trackers, (0.0, late), strict=True):
            place = CIRCLE.at(1.0 + 60.0 * rate * (t - age))
            x = float(place.x) - 0.3 * math.sin(place.heading)
            y = float(place.y) + 0.3 * math.cos(place.heading)
            yaw = float(place.heading)
            answers.append(tracker.step(t - age, x, y, yaw, speed, rate, now=t, motion_time=t))
        np.testing.assert_allclose(answers[1][2:5], answers[0][2:5], atol=1e-5)
        assert answers[1].command == pytest.approx(answers[0].command, abs=1e-5)


@pytest.mark.parametrize("kind", [at.PurePursuit, at.Stanley, at.LQR, at.PreviewLQR, at.KinematicMPC])
def test_every_law_follows_a_path_whether_it_assumes_a_steering_or_not(kind):
    run = drive(at.Tracker(kind(CAR, period=0.05), ROAD), ROAD, 10.0, noise=EXACT)
    assert np.abs(run.offset).max() < 1.0


@pytest.mark.parametrize("name", ["informed", "LQR"])
def test_the_time_of_the_pose_as_that_of_the_motion_changes_no_bit(name, rng):
    first, other = (at.Tracker(informed() if name == "informed" else at.LQR(CAR), ROAD) for _ in range(2))
    for row in calls(rng, 150, ROAD):
        t, call_time = row[:2]
        if not math.isfinite(t):
            continue
        options = {"now": call_time if math.isfinite(call_time) else None, "lateral_acceleration": row[8]}
        assert repr(first.step(t, *row[2:7], **options)) == repr(other.step(t, *row[2:7], **options, motion_time=t))


def test_what_is_not_measured_may_be_left_out():
    """The yaw rate is then that of the path, the speed the last one that was told."""
    tracker = at.Tracker(informed(), CIRCLE)
    car, offset = on_road(CIRCLE, speed=10.0), []
    tracker.engage(car.angle)
    for k in range(200):
        step = tracker.step(0.05 * k, car.x, car.y, car.yaw, 10.0 if k % 3 == 0 else math.nan)
        offset.append(step.offset)
        for _ in range(25):
            car.step(step.command, 0.002)
    assert np.abs(offset).max() < 0.02


# -- standing, starting, engaging -------------------------------------------------------------------------------------
def speed_of(t):
    """15 m/s, and from 9 to 16 s a stop."""
    return float(np.clip(max(15.0 - 3.0 * (t - 4.0), 3.0 * (t - 16.0)), 0.0, 15.0))


def test_a_stop_and_a_restart_cost_nothing(exact_rms):
    tracker = at.Tracker(informed(), ROAD)
    run = drive(tracker, ROAD, speed=speed_of, seed=2)
    standing = [step for t, step in run.calls if speed_of(t) == 0.0]
    assert {step.status for step in standing} == {at.Status.STANDING}
    assert len({step.command for step in standing}) == 1
    assert run.rms <= 1.5 * exact_rms / math.sqrt(2.0)


def test_a_parked_car_keeps_its_wheels():
    run = drive(at.Tracker(informed(), ROAD), ROAD, 5.0, speed=lambda t: 0.0, wheel_angle=0.1)
    assert set(run.commands) == {0.1}
    assert run.statuses == {"standing": 100}


def test_engaging_in_a_bend_makes_no_bump():
    car = on_road(CIRCLE, speed=10.0)
    angle = steady_turn(1 / 60, 10.0)[2]
    run = drive(at.Tracker(informed(), CIRCLE), CIRCLE, 10.0, car=car, wheel_angle=angle, noise=EXACT)
    assert abs(run.commands[0] - angle) < STEERING.rate * 0.05
    assert np.abs(run.commands - angle).max() < 0.01
    assert np.abs(run.offset).max() < 0.01


def test_a_lap_has_no_seam():
    car = on_road(CIRCLE, speed=12.0)
    run = drive(at.Tracker(informed(), CIRCLE), CIRCLE, 40.0, car=car, wheel_angle=car.angle, noise=EXACT, wrapped=True)
    assert run.calls[-1][1].station == pytest.approx(CIRCLE.length + 103.0, abs=3.0)
    assert np.abs(np.diff(run.commands)).max() < 0.003


def test_a_wheel_angle_is_taken_over_before_the_first_position():
    step = at.Tracker(informed(), SHORT).step(0.0, math.nan, math.nan, math.nan, 10.0, wheel_angle=0.2)
    assert step[:2] == (0.2, at.Status.HELD)
    assert math.isnan(step.offset)


@pytest.mark.parametrize("make", [informed, lambda: at.LQR(CAR)], ids=["MPC", "LQR"])
def test_a_reset_of_the_controller_before_engaging_is_as_a_new_one(make):
    drive(used := at.Tracker(make(), SHORT), SHORT, 1.0)
    used.controller.reset()
    new = at.Tracker(make(), SHORT)
    for tracker in (new, used):
        tracker.engage(0.2)
    assert new.controller.angle == used.controller.angle == 0.2
    assert at_rest(new, speed=10.0).command == at_rest(used, t=5.0, speed=10.0).command


# -- delays of the loop -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("options", "seconds", "contradicts"), [
    ({}, 0.0, False), ({}, 0.04, True), ({"computation": 0.05}, 0.04, False), ({"computation": 0.05}, 0.0, True),
    ({"profile": "road"}, 0.0, True),
])  # fmt: skip
def test_a_tracker_says_once_that_its_calls_contradict_the_computation_time(
    options, seconds, contradicts, caplog, monkeypatch
):
    clock = iter(seconds * k for k in range(10_000))
    monkeypatch.setattr("adaptrack.control.tracker.time.perf_counter", lambda: next(clock))
    tracker = at.Tracker(at.MPC(CAR, belief=STEERING, **options), ROAD)
    with caplog.at_level(logging.WARNING, "adaptrack"):
        drive(tracker, ROAD, 6.0, noise=EXACT, late=0.02)
    assert tracker.timing.sample_age == pytest.approx(0.05)  # samples are taken every 0.05 s
    assert tracker.timing.computation == pytest.approx(seconds)
    assert caplog.text.count("assumes a computation time") == contradicts


# -- statuses ---------------------------------------------------------------------------------------------------------
def test_reverse_is_refused_and_leaves_the_wheels():
    run = drive(at.Tracker(informed(), ROAD), ROAD, 3.0, speed=lambda t: -3.0, wheel_angle=0.05)
    assert run.statuses == {"reverse": 60}
    assert set(run.commands) == {0.05}


def test_beyond_the_end_it_goes_on_straight_and_says_so():
    run = drive(at.Tracker(informed(), SHORT), SHORT, 6.0, noise=EXACT)
    statuses = [step.status for _, step in run.calls]
    assert statuses == [at.Status.OK] * statuses.count(at.Status.OK) + [at.Status.END] * statuses.count(at.Status.END)
    assert statuses.count(at.Status.OK) == pytest.approx(60.0 / 15.0 / 0.05, abs=1)
    assert np.abs(run.offset).max() < 0.001


def test_far_from_the_path_is_said_until_the_car_is_back():
    tracker = at.Tracker(informed(), ROAD, furthest=1.0)
    run = drive(tracker, ROAD, 20.0, car=on_road(ROAD, offset=1.5))
    assert run.calls[0][1].status is at.Status.OFF_PATH
    assert run.calls[-1][1].status is at.Status.OK


def test_where_no_foot_is_about_the_last_one_the_car_is_off_the_path_until_it_begins_anew():
    """Beyond the centre of a circle the nearest foot is half a lap away."""
    circle = at.Road.from_segments([Arc(length=400.0 * math.pi, curvature=1 / 200)], closed=True)
    tracker = at.Tracker(at.Stanley(CAR, period=0.05), circle, furthest=1000.0)
    steps = [tracker.step(0.05 * k, 0.2, 189.5 + k, math.pi / 2, 20.0, 0.0) for k in range(20)]
    assert {step.status for step in steps[:11]} == {at.Status.OK}
    assert {step.status for step in steps[11:]} == {at.Status.OFF_PATH}
    assert np.isnan([step[2:5] for step in steps[11:]]).all()
    assert np.isfinite([step.command for step in steps]).all()
    tracker.engage()
    again = tracker.step(1.0, 0.2, 209.0, math.pi / 2, 20.0, 0.0)
    assert again.status is at.Status.OK
    assert again.station == pytest.approx(200.0 * math.pi, abs=10.0)


def test_a_car_that_lies_exactly_on_a_circle_is_steered_as_one_a_nanometre_beside():
    """Its offset and heading error are then the same to the bit at every step; they are new all the same."""
    commands = []
    for distance in (0.0, 1e-9):
        tracker, way = at.Tracker(informed(), CIRCLE), CIRCLE.at(0.5 * np.arange(80.0))
        for k in range(80):
            x, y, yaw = (float(column[k]) for column in way[:3])
            step = tracker.step(0.05 * k, x, y + distance * (-1.0) ** k, yaw, 10.0, 10.0 / 60.0)
        commands.append(step.command)
    assert commands[0] == pytest.approx(commands[1], abs=1e-5)


def test_a_position_that_stays_while_the_car_moves_is_none_under_any_time_stamp():
    tracker = at.Tracker(informed(), CIRCLE)
    statuses = []
    for k in range(120):
        place = CIRCLE.at(0.5 * min(k, 20))
        sample = float(place.x), float(place.y), float(place.heading)
        statuses.append(tracker.step(0.05 * k, *sample, 10.0, 10.0 / 60.0).status)
    assert statuses[:21] == [at.Status.OK] * 21
    assert statuses[21:80] == [at.Status.ESTIMATED] * 59
    assert statuses[85:] == [at.Status.HELD] * 35


def test_a_call_at_the_same_time_or_an_earlier_one_repeats_the_command():
    tracker = at.Tracker(informed(), SHORT)
    tracker.step(5.0, 0.0, 0.2, 0.0, 10.0, 0.0)
    first = tracker.step(5.05, 0.5, 0.2, 0.0, 10.0, 0.0)
    for t in (5.05, 5.0, 4.0):
        assert tracker.step(t, 50.0, 9.0, 1.0, 3.0, 0.0) == first._replace(status=at.Status.REPEATED)


@pytest.mark.parametrize("then", [0.0, 60.0])
def test_a_clock_that_jumps_begins_anew_from_the_command(then):
    """A simulator that was reset, or a loop that stood still."""
    tracker = at.Tracker(informed(), CIRCLE)
    before = drive(tracker, CIRCLE, 5.0, car=on_road(CIRCLE, speed=10.0), noise=EXACT).commands[-1]
    car = on_road(CIRCLE, s=200.0, speed=10.0)
    step = tracker.step(then, car.x, car.y, car.yaw, car.speed, car.yaw_rate)
    assert step.status is at.Status.OK
    assert step.station == pytest.approx(200.0, abs=0.01)
    assert abs(step.command - before) < STEERING.rate * 0.05


def test_positions_that_jump_are_left_out_until_they_stay():
    tracker = at.Tracker(informed(), CIRCLE)

    def moved(t, car, tracker):
        if 5.0 <= t < 5.04:
            car.x += 40.0
        elif 5.04 <= t < 5.09:
            car.x -= 40.0

    car = on_road(CIRCLE, speed=10.0)
    outlier = drive(tracker, CIRCLE, 6.0, car=car, wheel_angle=car.angle, before_call=moved, noise=EXACT)
    assert outlier.statuses == {"ok": 119, "estimated": 1}
    assert np.abs(np.diff(outlier.commands[90:])).max() < 0.001

    tracker.engage()
    for k in range(6):  # at 10 m/s along the circle, from its other side on after three calls
        place = CIRCLE.at(0.5 * k + (180.0 if k >= 3 else 0.0))
        step = tracker.step(0.05 * k, float(place.x), float(place.y), float(place.heading), 10.0, 10.0 / 60.0)
        assert step.status is (at.Status.ESTIMATED if k in (3, 4) else at.Status.OK)
    assert step.station == pytest.approx(182.5, abs=0.01)


# -- paths ------------------------------------------------------------------------------------------------------------
def test_the_same_path_from_another_start_leaves_the_commands_as_they_are():
    half = at.Road.from_segments(
        [Arc(length=120.0 * math.pi, curvature=1 / 60)], start=tuple(map(float, CIRCLE.at(130.0)[:3])), closed=True
    )

    def change(t, car, tracker):
        if abs(t - 3.0) < 1e-9:
            tracker.follow(half)

    runs = [
        drive(
            at.Tracker(informed(), CIRCLE), CIRCLE, 6.0, car=on_road(CIRCLE, speed=10.0), late=0.1, before_call=action
        )
        for action in (None, change)
    ]
    np.testing.assert_allclose(runs[1].commands, runs[0].commands, rtol=0, atol=1e-6)
    assert runs[1].calls[-1][1].station != pytest.approx(runs[0].calls[-1][1].station, abs=1.0)


def test_a_path_beside_the_other_is_approached_without_a_bump():
    parallel = at.Road.from_segments([Line(length=400.0)], start=(0.0, 0.5, 0.0))
    straight = at.Road.from_segments([Line(length=400.0)])

    def change(t, car, tracker):
        if abs(t - 3.0) < 1e-9:
            tracker.follow(parallel)

    run = drive(
        at.Tracker(informed(), straight), parallel, 10.0, car=on_road(straight), before_call=change, noise=EXACT
    )
    assert run.offset[:150] == pytest.approx(-0.5, abs=1e-6)
    assert run.offset.max() < 0.02  # no overshoot to speak of
    assert np.abs(run.offset[-50:]).max() < 0.005


def test_a_path_that_is_planned_anew_every_tenth_of_a_second_is_followed_as_well():
    def plan(t, car, tracker):
        if round(t / 0.05) % 2 == 0:
            tracker.follow(window(ROAD, float(ROAD.project(car.x, car.y, near=15.0 * t + 10.0).s)))

    runs = [
        drive(at.Tracker(informed(), path), ROAD, 12.0, car=on_road(ROAD, s=10.0), before_call=action, seed=2).rms
        for path, action in ((ROAD, None), (window(ROAD, 10.0), plan))
    ]
    assert runs[1] <= 1.5 * runs[0]


def test_on_a_path_that_crosses_itself_the_car_begins_on_its_branch():
    loop = at.Road.from_segments(
        [Line(length=100.0), Arc(length=45.0 * math.pi, curvature=1 / 30), Line(length=100.0)], name="loop"
    )
    crossing = 100.0 - 30.0  # the last line runs down through y = 0 at x = 100 - 30
    for heading, s in ((0.0, crossing), (-math.pi / 2, 100.0 + 45.0 * math.pi + 30.0)):
        tracker = at.Tracker(informed(), loop)
        assert tracker.step(0.0, crossing, 0.2, heading, 10.0, 0.0).station == pytest.approx(s, abs=0.5)


def test_the_prediction_in_a_steady_bend_is_what_is_driven():
    tracker = at.Tracker(informed(), CIRCLE)
    run = drive(tracker, CIRCLE, 6.0, car=on_road(CIRCLE, speed=10.0), noise=EXACT)
    predicted, instant = tracker.predicted_path(), run.calls[-1][0]
    time, _ = tracker.controller.predicted_output()
    run = drive(tracker, CIRCLE, 9.0, car=on_road(CIRCLE, speed=10.0), noise=EXACT)
    places = np.stack([np.interp(instant + time, run.places[:, 0], run.places[:, k]) for k in (1, 2)], axis=-1)
    assert predicted.shape == (tracker.controller.tuning.Np, 2)
    assert np.abs(predicted - places).max() < 0.03


@pytest.mark.parametrize("road", [at.Road.from_segments([Line(length=400.0)], start=(3.0, -2.0, 0.5)), CIRCLE])
def test_a_car_on_its_path_is_predicted_there_a_period_of_driving_from_point_to_point(road):
    """At 10 m/s: on the straight, and on the circle all at one distance from its centre, (delay + 1) T, ... ahead."""
    tracker = at.Tracker(informed(), road)
    run = drive(tracker, road, 6.0, car=on_road(road, speed=10.0), noise=EXACT)
    time, _ = tracker.controller.predicted_output()
    ahead = road.at(run.calls[-1][1].station + 10.0 * time)
    assert np.diff(time) == pytest.approx(tracker.period)
    assert tracker.predicted_path() == pytest.approx(np.stack([ahead.x, ahead.y], axis=-1), abs=0.001)


def test_a_path_is_predicted_from_the_first_step_on_it():
    tracker = at.Tracker(informed(), SHORT)
    assert tracker.predicted_path().shape == (0, 2)
    at_rest(tracker, speed=10.0)
    assert tracker.predicted_path().shape == (30, 2)
    tracker.follow(ROAD)
    assert tracker.predicted_path().shape == (0, 2)


def test_a_plan_tells_of_the_speeds_to_come():
    """Braking into a bend that a constant 15 m/s would meet earlier."""
    easing = Clothoid(length=20.0, start_curvature=0.0, end_curvature=1 / 25)
    bend = at.Road.from_segments([Line(length=60.0), easing, Arc(length=60.0, curvature=1 / 25)])
    plan = at.plan_speed(bend, CAR, start=15.0)
    runs = []
    for speed_plan in (plan, None):
        car = on_road(bend)

        def brake(t, car, tracker):
            car.speed = float(plan.motion(t)[1])

        tracker = at.Tracker(informed(), bend, plan=speed_plan)
        runs.append(drive(tracker, bend, 6.0, car=car, before_call=brake, noise=EXACT).rms)
    assert runs[0] < runs[1] < 0.05


# -- other controllers ------------------------------------------------------------------------------------------------
def slow_published_mpc(car, period):
    """The published controller, which does not know its steering and must be slow."""
    return at.published_mpc(car, at.Tuning(35, 8, 1.0, 3000.0), period=period)


@pytest.mark.parametrize(
    ("make", "most"), [(at.LQR, 0.03), (at.Stanley, 0.03), (at.PurePursuit, 0.2), (slow_published_mpc, 1.0)]
)
def test_other_controllers_drive_as_well(make, most):
    run = drive(at.Tracker(make(CAR, period=0.05), ROAD), ROAD, 20.0, jitter=(0.02, 0.09), missing=7, wrapped=True)
    assert run.rms < most
    assert run.statuses.keys() == {"ok"}


def test_a_law_without_positions_holds():
    tracker = at.Tracker(at.LQR(CAR, period=0.05), SHORT)
    at_rest(tracker, speed=10.0)
    statuses = [tracker.step(0.05 * k, *(math.nan,) * 3, 10.0).status for k in range(1, 60)]
    assert statuses[0] is at.Status.ESTIMATED
    assert statuses[-1] is at.Status.HELD


# -- what is refused --------------------------------------------------------------------------------------------------
MEASURED = ("t", "x", "y", "yaw", "speed", "yaw_rate", "lateral_velocity", "lateral_acceleration", "grade")


@pytest.mark.parametrize(("call", "message"), [
    (lambda mpc: at.Tracker("informed", SHORT), "must be a Controller"),
    (lambda mpc: at.Tracker(at.published_mpc(CAR, scheduler=lambda _: (10, 2, 1.0, 1.0)), SHORT), "has a scheduler"),
    (lambda mpc: at.Tracker(mpc, [(0.0, 0.0), (1.0, 0.0)]), "must be a Road"),
    (lambda mpc: at.Tracker(mpc, SHORT, plan=at.plan_speed(ROAD)), "must be a SpeedPlan of this path"),
    (lambda mpc: at.Tracker(mpc, SHORT, furthest=0.0), "furthest"),
    (lambda mpc: at.Tracker(at.Stanley(CAR), SHORT).predicted_path(), "Stanley does not predict: give an MPC"),
    (lambda mpc: at.Tracker(mpc, SHORT).step(math.nan, 0.0, 0.0, 0.0, 10.0), "the time of the call"),
    (lambda mpc: at.Tracker(mpc, SHORT).step(0.0, "0", 0.0, 0.0, 10.0), "must be a number"),
    (lambda mpc: at.Tracker(mpc, SHORT).step(None, 0.0, 0.0, 0.0, 10.0), "t = None: must be a number[.]"),
    *((lambda mpc, name=name: at.Tracker(mpc, SHORT).step(**dict.fromkeys(MEASURED, 0.0) | {name: None}),
       f"{name} = None: must be a number \\(NaN if it was not measured\\)") for name in MEASURED[1:]),
    (lambda mpc: at.Tracker(mpc, SHORT).engage(math.nan), "finite"),
    (lambda mpc: at.yaw_of((0.0,) * 4), "four finite numbers"),
    (lambda mpc: at.yaw_of((1.0, 0.0, 0.0)), "four finite numbers"),
    (lambda mpc: at.yaw_of((math.nan, 0.0, 0.0, 1.0)), "four finite numbers"),
])  # fmt: skip
def test_nonsense_is_refused(call, message):
    with pytest.raises(at.InvalidInput, match=message):
        call(informed())


@pytest.mark.parametrize("yaw", [-3.0, -0.5, 0.0, 2.0, math.pi])
def test_a_quaternion_of_any_length_gives_its_yaw(yaw):
    for length in (1.0, -3.0):  # q and -q turn alike
        quaternion = length * np.array([0.0, 0.0, math.sin(0.5 * yaw), math.cos(0.5 * yaw)])
        assert math.remainder(at.yaw_of(quaternion) - yaw, 2.0 * math.pi) == pytest.approx(0.0, abs=1e-12)


def test_the_yaw_of_a_pitched_car_is_that_of_its_axis():
    """Yaw, then pitch: (0, s, 0, c) behind (0, 0, s, c)."""
    yaw, pitch = 0.7, 0.3
    a, b, c, d = math.sin(0.5 * yaw), math.cos(0.5 * yaw), math.sin(0.5 * pitch), math.cos(0.5 * pitch)
    assert at.yaw_of([-a * c, b * c, a * d, b * d]) == pytest.approx(yaw)


def test_a_tracker_whose_controller_another_one_uses_refuses_to_go_on():
    mpc, road = at.MPC(CAR, profile="road"), at.Road.from_segments([Line(length=200.0)])
    first, second = at.Tracker(mpc, road), at.Tracker(mpc, road)
    with pytest.raises(at.InvalidInput, match="a newer tracker or simulation uses this controller"):
        first.step(0.0, 0.0, 0.5, 0.0, 10.0)
    for sharing in (copy.deepcopy(second), pickle.loads(pickle.dumps(second)), at.Tracker(copy.copy(mpc), road)):
        assert sharing.step(0.0, 0.0, 0.5, 0.0, 10.0).command == second.step(0.0, 0.0, 0.5, 0.0, 10.0).command
    first.engage()
    first.step(0.0, 0.0, 0.5, 0.0, 10.0)
    with pytest.raises(at.InvalidInput, match="a newer tracker or simulation uses this controller"):
        second.step(0.1, 1.0, 0.5, 0.0, 10.0)


@pytest.mark.parametrize("driver", ["x", None, 2, 0.5, [True]])
def test_whether_a_driver_uses_the_pedals_is_true_or_false(driver):
    tracker = at.Tracker(at.MPC(CAR, profile="road"), at.Road.from_segments([Line(length=200.0)]))
    with pytest.raises(at.InvalidInput, match=r"Tracker.step: driver = .*: must be True or False"):
        tracker.step(0.0, 0.0, 0.5, 0.0, 10.0, driver=driver)
