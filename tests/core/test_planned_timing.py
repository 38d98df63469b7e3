"""The time of a planned trajectory: places and times are inverse, and a car keeps time without ever being hurried."""

import math

import numpy as np
import pytest

from adaptrack.core.layout import empty
from adaptrack.core.planned.records import FALLBACK, NOBODY, PLANNER, STOP, Planned, PlannedSpeeds
from adaptrack.core.planned.timing import DEAD_ZONE, MAX_CATCH_UP, keep_time, place_at, time_at
from adaptrack.core.speed.speed_control import SPEED_MEMORY, SPEED_SAMPLE
from adaptrack.core.tracker import longitudinal
from planned_speeds import GAIN, PERIOD, planned, speeds_of

pytestmark = pytest.mark.kernels


def memory_after(planner, time, station, speed=0.0):
    keep_time(time, station, speed, planner)
    return planner.memory[0].copy()


def drive(planner, station, seconds, start=0.0):
    """Times, places, and speeds of a car that has the target speed at each period."""
    rows = []
    for k in range(round(seconds / PERIOD)):
        time = start + k * PERIOD
        m = memory_after(planner, time, station, rows[-1][2] if rows else 0.0)
        rows.append((time, station, m.target_speed, m.late, m.debt))
        station += PERIOD * m.target_speed
    return np.array(rows).T


STOP_AND_GO = speeds_of([(2.0, 0.0), (4.0, -2.5), (3.0, None), (5.0, 2.0), (1.0, 0.0)], 10.0, start=7.0)
"""10 m/s, braked to rest at 40 m from 9 s to 13 s, where it stands until 16 s."""
CRUISE = speeds_of([(60.0, 0.0)], 10.0)
AT_ONCE = speeds_of([(2.5, -6.0)], 15.0)


# -- place and time ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("speeds", [STOP_AND_GO, CRUISE, AT_ONCE])
def test_the_time_at_a_place_is_the_inverse_of_the_place_at_a_time(speeds):
    for place in np.linspace(speeds.s[0], speeds.s[-1], 501)[1:-1]:
        assert place_at(time_at(place, speeds), speeds)[0] == pytest.approx(place, abs=1e-9)


def test_the_place_is_the_integral_of_the_speed_through_rests_and_beyond_both_ends():
    times = np.linspace(5.0, 26.0, 210001)
    places, speeds = np.array([place_at(time, STOP_AND_GO) for time in times[::10]]).T
    expected = np.interp(times, [7.0, 9.0, 13.0, 16.0, 21.0, 22.0], [10.0, 10.0, 0.0, 0.0, 10.0, 10.0])
    np.testing.assert_allclose(speeds, expected[::10], atol=1e-9)
    way = np.concatenate([[0.0], np.cumsum(0.5 * np.diff(times) * (expected[1:] + expected[:-1]))])
    np.testing.assert_allclose(places, way[::10] - 20.0, atol=1e-6)


def test_at_a_place_of_rest_the_time_is_that_of_the_arrival_and_an_end_at_rest_is_never_left():
    assert time_at(40.0, STOP_AND_GO) == 13.0
    assert time_at(40.0 + 1e-9, STOP_AND_GO) > 16.0
    assert place_at(14.0, STOP_AND_GO) == (40.0, 0.0)
    assert place_at(1e6, AT_ONCE) == (18.75, 0.0)
    assert time_at(30.0, AT_ONCE) == 2.5
    assert memory_after(planned(AT_ONCE), 1e6, 18.75).is_leaving == 0


def test_a_car_behind_a_trajectory_that_creeps_to_its_rest_is_not_late_by_the_time_of_creeping_there():
    speeds = speeds_of([(0.01, -2.0)], 0.02, start=5.0)
    assert time_at(-0.4, speeds) == 5.0
    assert place_at(4.0, speeds) == (0.0, 0.0)
    assert memory_after(planned(speeds), 5.0, -0.4).late == 0.0


# -- the law ----------------------------------------------------------------------------------------------------------
def test_a_car_on_time_is_not_corrected():
    for time in np.linspace(5.0, 25.0, 401):
        m = memory_after(planned(STOP_AND_GO), time, place_at(time, STOP_AND_GO)[0])
        assert m.correction == 0.0
        assert m.late == pytest.approx(0.0, abs=1e-6)
        assert m.debt == pytest.approx(0.0, abs=1e-6)


def test_a_car_that_is_two_seconds_late_closes_the_way_exponentially_below_its_limit():
    planner = planned(CRUISE, speed_limit=12.0)
    times, places, speeds, late, _ = drive(planner, -20.0, 40.0)
    assert late[0] == pytest.approx(2.0)
    assert speeds.max() == pytest.approx(11.5)  # 15 %
    gaps = 10.0 * times - places - DEAD_ZONE
    is_free = (gaps < 1.4 / GAIN) & (gaps > 1e-6)
    rates = np.diff(np.log(gaps[is_free])) / PERIOD
    np.testing.assert_allclose(rates, math.log(1.0 - GAIN * PERIOD) / PERIOD, rtol=1e-3)  # of the sampled car
    assert abs(late[-1]) < 0.03


@pytest.mark.parametrize(("limit", "top"), [(10.5, 10.5), (math.nan, 10.0), (8.0, 10.0)])
def test_catching_up_never_exceeds_the_limit_nor_by_default_the_largest_planned_speed_nearby(limit, top):
    planner = planned(CRUISE, speed_limit=limit)
    assert drive(planner, -20.0, 5.0)[2].max() == top
    assert memory_after(planner, 0.0, 5.0).correction < 0.0  # an early car waits all the same


def test_by_default_a_car_catches_up_where_the_trajectory_is_faster_within_two_seconds():
    speeds = speeds_of([(5.0, 0.0), (1.0, -2.0), (10.0, 0.0)], 10.0)
    tops = [memory_after(planned(speeds), 0.0, station).top_speed for station in (20.0, 59.0 + 15.9, 59.0 + 16.1)]
    assert tops[:2] == pytest.approx([10.0, 8.0], abs=0.2)
    assert tops[2] == 8.0


@pytest.mark.parametrize("lateness", [-8.0, -0.5, 0.7, 2.9, 3.5, 20.0])
def test_lateness_is_the_shift_of_the_times_and_beyond_three_seconds_leaves_no_debt(lateness):
    planner = planned(CRUISE, speed_limit=11.5)
    m = memory_after(planner, 20.0 + lateness, 200.0)
    assert m.late == pytest.approx(lateness)
    assert m.debt == pytest.approx(max(lateness - MAX_CATCH_UP, 0.0))
    times, _, _, late, debt = drive(planner, 200.0, 90.0, start=20.0 + lateness)
    assert late[-1] - debt[-1] == pytest.approx(0.0, abs=0.03)
    assert late[-1] == pytest.approx(max(lateness - MAX_CATCH_UP, 0.0), abs=0.03)
    fresh = planner._replace(speeds=speeds_of([(60.0, 0.0)], 10.0, start=times[-1]))  # from where the car is
    m = memory_after(fresh, times[-1], 0.0)
    assert (m.late, m.debt, m.correction) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize("gap", [-0.15, 0.15])
def test_a_creeping_car_is_corrected_beyond_a_tenth_of_a_second(gap):
    creep = speeds_of([(100.0, 0.0)], 0.3)
    _, places, _, _, _ = drive(planned(creep, speed_limit=1.0), 15.0 - gap, 20.0, start=50.0)
    assert abs(places[-1] - place_at(70.0 - PERIOD, creep)[0]) == pytest.approx(0.03, abs=0.005)


def test_without_a_gain_lateness_is_reported_and_not_made_up_for():
    m = memory_after(planned(CRUISE, catch_up=0.0, speed_limit=12.0), 22.0, 200.0)
    assert (m.late, m.correction) == (pytest.approx(2.0), 0.0)


# -- places of rest ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("short", [-0.1, 0.0, 0.05, 0.2])
def test_a_car_that_stands_just_short_of_a_place_of_rest_has_arrived_and_leaves_by_the_time(short):
    for time, is_leaving in ((13.5, 0), (15.99, 0), (16.0, 1)):
        m = memory_after(planned(STOP_AND_GO), time, 40.0 - short)
        assert (m.late, m.is_leaving) == (0.0, is_leaving)
        assert m.rest_time == pytest.approx(16.0 - time)
        assert m.correction == pytest.approx(0.0, abs=1e-12)
    assert m.target_speed > 0.3


def test_a_car_that_stopped_five_centimetres_short_arrives():
    speeds = speeds_of([(4.0, -2.5)], 10.0)
    _, places, _, _, _ = drive(planned(speeds), 19.95, 3.0, start=4.0)
    assert places[-1] == pytest.approx(20.0, abs=0.02)


@pytest.mark.parametrize("late", [0.0, 1.0, 2.9, 5.0])
def test_a_late_car_is_not_pulled_beyond_a_place_of_rest_and_waits_there_for_the_time(late):
    times, places, _, lateness, debt = drive(planned(STOP_AND_GO, speed_limit=14.0), 0.0, 40.0, start=7.0 + late)
    waiting = times < 16.0 - PERIOD
    assert places[waiting].max() < 40.02
    arrival = times[np.argmax(places > 39.75)]
    if arrival < 16.0:
        assert places[times < 16.0][-1] > 39.9
    assert lateness[-1] - debt[-1] < 0.1
    assert debt[-1] <= max(late - MAX_CATCH_UP, 0.0)


def test_the_time_up_to_a_departure_is_zero_without_a_rest_and_infinite_at_an_end_at_rest():
    assert memory_after(planned(STOP_AND_GO), 12.0, 37.0).rest_time == 0.0
    assert memory_after(planned(STOP_AND_GO), 20.0, 45.0).rest_time == 0.0
    assert memory_after(planned(AT_ONCE), 5.0, 18.75).rest_time == math.inf


def test_a_rest_takes_up_lateness():
    m = memory_after(planned(STOP_AND_GO), 14.0, 15.0)
    assert m.late > 5.0
    assert memory_after(planned(STOP_AND_GO), 15.0, 40.0).late == 0.0


def test_a_car_whose_trajectory_stands_where_it_began_starts_by_the_time():
    speeds = speeds_of([(2.0, None), (5.0, 1.0)], 0.0)
    times, places, _, late, _ = drive(planned(speeds), 0.0, 6.0)
    assert places[times < 2.0].max() == 0.0
    assert places[times > 2.2][0] > 0.0
    assert abs(late[-1]) < 0.2


# -- hostile numbers --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("speeds", [STOP_AND_GO, PlannedSpeeds(*np.zeros((4, 0))), PlannedSpeeds(*np.zeros((4, 1)))])
def test_a_place_or_a_time_that_is_unknown_corrects_nothing(speeds):
    values = math.nan, math.inf, -math.inf, 1e300
    for time in (*values, 8.0):
        for station in (*values, 5.0):
            for speed in (math.nan, 5.0):
                m = memory_after(planned(speeds), time, station, speed)
                assert math.isfinite(m.correction)
                assert not m.target_speed < 0.0
                if speeds.s.size == 0 or not (math.isfinite(time) and math.isfinite(station)):
                    assert math.isnan(m.late)
                    assert (m.correction, m.is_leaving) == (0.0, 0)


@pytest.mark.compiled
def test_compiled_kernels_give_the_bits_of_plain_python(rng):
    for speeds in (STOP_AND_GO, CRUISE, AT_ONCE):
        planners = planned(speeds), planned(speeds)
        for time, station, speed in rng.uniform([0.0, -30.0, 0.0], [40.0, 120.0, 20.0], (200, 3)).tolist():
            assert place_at(time, speeds) == place_at.function(time, speeds)
            assert time_at(station, speeds) == time_at.function(station, speeds)
            keep_time(time, station, speed, planners[0])
            keep_time.function(time, station, speed, planners[1])
            assert planners[0].memory.tobytes() == planners[1].memory.tobytes()


# -- what the speed control takes from it ------------------------------------------------------------------------------
@pytest.mark.parametrize("driver", [NOBODY, PLANNER, FALLBACK, STOP])
def test_the_speed_control_keeps_the_time_of_a_planner_and_its_fallback_and_stops_without_both(driver):
    planner, sample, memory = planned(STOP_AND_GO, speed_limit=12.0), SPEED_SAMPLE.new(1)[0], SPEED_MEMORY.new(1)[0]
    planner.memory["driven_by"], sample.is_guided = driver, 1.0
    keep_time(8.0, 5.0, 10.0, planner)
    longitudinal._keep_planned_time(planner, sample, memory)
    is_followed = driver in (PLANNER, FALLBACK)
    assert sample.is_guided == (driver != STOP)
    assert sample.is_timed == is_followed
    assert sample.correction == pytest.approx(1.5 if is_followed else 0.0)
    assert sample.correction_limit == 12.0
    assert sample.rest_time == 0.0
    assert memory.is_released == 0
    keep_time(15.5, 40.0, 0.0, planner)
    longitudinal._keep_planned_time(planner, sample, memory)
    assert (sample.rest_time, memory.is_released) == (0.5 if is_followed else 0.0, 0)
    keep_time(16.5, 40.0, 0.0, planner)
    longitudinal._keep_planned_time(planner, sample, memory)
    assert memory.is_released == is_followed


def test_without_a_planner_the_speed_control_is_given_nothing():
    sample, memory = SPEED_SAMPLE.new(1, is_guided=1.0), SPEED_MEMORY.new(1)
    before = sample.tobytes(), memory.tobytes()
    longitudinal._keep_planned_time(empty(Planned), sample[0], memory[0])
    assert (sample.tobytes(), memory.tobytes()) == before
