"""A tracker as kernels: whole calls with a compiled controller, what hostile calls give, hints, schedules."""

import math
from dataclasses import replace

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.tracker import packed_plan, tracking_of
from adaptrack.core.kernel import direct, fields_of
from adaptrack.core.tracker.signals import FOLLOWING, HELD, NO_TIME, REPEATED, TRACKED, TRACKER_SAMPLE
from adaptrack.core.tracker.step import tracker_predict, tracker_step
from adaptrack.core.tracker.take_call import tracker_engage, tracker_follow, tracker_take
from adaptrack.road import Arc, Line
from adaptrack.road.road_ahead import pack_roads, stacked
from tracker_calls import called_back, calls, in_python

pytestmark = pytest.mark.kernels
CAR = at.load_vehicle("paper")
ROAD = at.generate_road("country", seed=1, length=800.0)
PLAN = at.plan_speed(ROAD, CAR)
CIRCLE = at.Road.from_segments([Arc(length=200.0 * math.pi, curvature=1 / 100)], closed=True)
TWICE_AROUND = at.Road.from_segments([Arc(length=800.0 * math.pi, curvature=1 / 200)])
"""Two laps as an open road: each place of it comes twice."""
MAKERS = {
    "informed": lambda: at.MPC(CAR, profile="road"),
    "informed, late samples": lambda: at.MPC(CAR, profile="production"),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "published": lambda: at.published_mpc(CAR, at.Tuning(35, 8, 1.0, 3000.0), period=0.05),
    "LQR": lambda: at.LQR(CAR, period=0.05), "Stanley": lambda: at.Stanley(CAR, period=0.05),
    "pure pursuit": lambda: at.PurePursuit(CAR, period=0.05),
}  # fmt: skip


def stepper(tracking):
    """What steps a tracker with a compiled controller."""
    return direct(tracker_step, tracking)


def compiled(controller, path=ROAD, plan=None):
    """A tracker with a compiled controller, and what steps it."""
    tracking = tracking_of(controller, path, plan)
    return tracking, stepper(tracking)


def call(tracking, step, *numbers):
    """A call: t, now, x, y, ... in the order of `SAMPLE`, missing ones NaN; what it gives."""
    sample = tracking.tracker.sample
    sample[:] = math.nan
    sample[: len(numbers)] = numbers
    step()
    return tracking.tracker.tracked.tolist()


# -- the same as the class --------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
def test_a_whole_call_in_a_kernel_gives_what_the_class_gives_to_the_bit(make, rng):
    tracker, tracking = at.Tracker(called_back(make()), ROAD, plan=PLAN), tracking_of(make(), ROAD, PLAN)
    step = stepper(tracking)
    for k, row in enumerate(calls(rng, 400, ROAD)):
        if not (math.isfinite(row[0]) or math.isfinite(row[1])):  # the class needs a time
            continue
        if k == 120:
            tracker.engage(0.05)
            tracker_engage(0.05, math.nan, tracking.tracker)
        if k == 300:
            tracker.follow(CIRCLE)
            other = tracking.tracker._replace(path=stacked(CIRCLE), plan=packed_plan(None))
            tracking = tracking._replace(tracker=other)
            step = stepper(tracking)
            tracker_follow(math.nan, other)
        expected = in_python(tracker, row)
        np.testing.assert_array_equal(call(tracking, step, *row)[:5], expected)
    assert math.isfinite(expected[0])


@pytest.mark.parametrize("name", ["informed", "learning", "Stanley"])
def test_a_kernel_predicts_the_path_of_the_class_to_the_bit_where_it_fits(name):
    tracker, (tracking, step) = at.Tracker(MAKERS[name](), ROAD, plan=PLAN), compiled(MAKERS[name](), plan=PLAN)
    points = np.full(61, 5.0)
    assert tracker_predict(tracking, points)[0] == 0
    for k in range(3):
        sample = (0.05 * k, 2.0 + 0.5 * k, 0.3, 0.0, 10.0, 0.01)
        tracker.step(*sample)
        call(tracking, step, sample[0], *sample)
    if name == "Stanley":
        assert tracker_predict(tracking, points)[0] == 0
        return
    assert tracker_predict(tracking, points[:59])[0] == 30
    assert (points == 5.0).all()
    count, first = tracker_predict(tracking, points)
    assert (count, first, points[60]) == (30, tracker.controller.predicted_output()[0][0], 5.0)
    np.testing.assert_array_equal(points[:60].reshape(-1, 2), tracker.predicted_path())


# -- hostile calls ----------------------------------------------------------------------------------------------------


def test_a_call_without_a_time_is_left_out():
    tracking, step = compiled(MAKERS["LQR"]())
    first = call(tracking, step, 0.0, 0.0, 0.0, 0.2, 0.0, 10.0)
    for time in (math.nan, math.inf):
        answer = call(tracking, step, time, time, 50.0, 9.0, 1.0, 3.0)
        assert answer[TRACKED.status] == NO_TIME
        np.testing.assert_array_equal(answer[:1] + answer[2:], first[:1] + first[2:])
    assert call(tracking, step, 0.0, math.nan, 0.0, 0.0, 0.0, 10.0)[TRACKED.status] == REPEATED


@pytest.mark.parametrize("field", [field for field in fields_of(TRACKER_SAMPLE) if field.bounds], ids=lambda f: f.name)
def test_a_value_beyond_its_bounds_counts_as_not_measured(field):
    tracking, _ = compiled(MAKERS["LQR"]())
    sample, place, (_, high) = tracking.tracker.sample, TRACKER_SAMPLE._fields.index(field.name), field.ends
    for value, is_measured in ((0.99 * high, True), (high, field.bounds.endswith("]")), (1.01 * high, False)):
        for signed in (value, -value):
            sample[:] = math.nan
            sample[TRACKER_SAMPLE.t], sample[place] = 0.0, signed
            tracker_take(tracking.tracker)
            assert bool(sample[place] == signed) == is_measured


def test_an_angle_that_is_no_number_engages_nothing():
    tracking, step = compiled(MAKERS["LQR"]())
    call(tracking, step, 0.0, 0.0, 0.0, 0.2, 0.0, 10.0)
    before = tracking.tracker.memory.copy()
    assert tracker_engage(math.nan, math.nan, tracking.tracker) == 0
    assert tracking.tracker.memory.tobytes() == before.tobytes()
    assert tracker_engage(9.0, math.nan, tracking.tracker) == 1
    assert tracking.tracker.tracked[TRACKED.command] == MAKERS["LQR"]().limits.angle[1]


def test_without_a_path_the_command_is_held():
    tracking, step = compiled(MAKERS["LQR"]())
    bare = tracking._replace(tracker=tracking.tracker._replace(path=pack_roads([])))
    assert call(bare, stepper(bare), 0.0, 0.0, 0.0, 0.2, 0.0, 10.0)[TRACKED.status] == HELD
    assert call(tracking, step, 0.1, 0.1, 0.0, 0.2, 0.0, 10.0)[TRACKED.status] == FOLLOWING


# -- where the car begins ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("near", "lap"), [(300.0, 0), (1500.0, 1), (None, 0)])
def test_a_hint_says_on_which_lap_the_car_is(near, lap):
    tracker = at.Tracker(at.Stanley(CAR, period=0.05), TWICE_AROUND)
    tracker.engage(near=near)
    place = TWICE_AROUND.at(150.0)
    step = tracker.step(0.0, float(place.x), float(place.y), float(place.heading), 10.0)
    assert step.station == pytest.approx(150.0 + lap * 400.0 * math.pi, abs=0.01)
    tracker.follow(TWICE_AROUND, near=1300.0 - 1e-3)
    place = TWICE_AROUND.at(150.5)
    step = tracker.step(0.05, float(place.x), float(place.y), float(place.heading), 10.0)
    assert step.station == pytest.approx(150.5 + 400.0 * math.pi, abs=0.01)


def test_a_car_that_is_not_about_the_hint_is_off_its_path():
    straight = at.Road.from_segments([Line(length=2000.0)])
    tracker = at.Tracker(at.Stanley(CAR, period=0.05), straight)
    tracker.engage(near=1900.0)
    assert tracker.step(0.0, 100.0, 0.0, 0.0, 10.0).status is at.Status.OFF_PATH
    tracker.engage(near=450.0)
    assert tracker.step(0.1, 100.0, 0.0, 0.0, 10.0).station == pytest.approx(100.0)


# -- schedules --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("conditions", "friction", "wind"), [((0.5, 6.0), 0.5, 6.0), ((math.nan, math.nan), 0.65, 0.0)]
)
def test_a_schedule_is_asked_for_what_is_known_of_friction_and_wind(conditions, friction, wind):
    scheduler = replace(at.load_scheduler("road-nn"), guard=None)
    tracking, step = compiled(at.published_mpc(CAR, scheduler=scheduler, period=0.05))
    answer = call(tracking, step, 0.0, 0.0, 0.0, 0.2, 0.0, 15.0, 0.0, 0.0, math.nan, math.nan, *conditions)
    expected = scheduler(at.SchedulingVariables(15.0, 0.0, friction, wind, offset=-answer[TRACKED.offset]))
    assert tracking.controller.tuning[0].tolist() == pytest.approx(list(expected), rel=1e-12)


# -- the plan of the speed --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("closed", [False, True])
def test_between_the_places_of_a_plan_the_square_of_the_speed_is_straight(closed, rng):
    plan = at.plan_speed(CIRCLE, CAR, stops=[100.0]) if closed else PLAN
    s = np.concatenate([rng.uniform(-500.0, 2000.0, 200), plan.s[:5], plan.s[-5:], [math.nan, 1e9, -1e9]])
    inside = s - np.floor(s / plan.s[-1]) * plan.s[-1] if closed else s
    np.testing.assert_allclose(plan.at(s), np.sqrt(np.interp(inside, plan.s, plan.speed**2)), rtol=1e-15, atol=0.0)
    assert plan.at(3.0).shape == ()
    assert plan.at(np.zeros((2, 3))).shape == (2, 3)
