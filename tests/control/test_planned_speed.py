"""The speed control along a planner's trajectory: on time, within its limits, and with the trajectory's own braking."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from adaptrack import SpeedControl, load_vehicle
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator
from adaptrack.control.speed_control import SpeedController
from adaptrack.core.planned.timing import keep_time, place_at, time_at
from adaptrack.core.speed.speed_control import slope_of
from adaptrack.road import Comfort, Line, Road
from planned_speeds import planned, speeds_of
from point_mass import PERIOD, PointMass

pytestmark = pytest.mark.compiled
CAR = load_vehicle("midsize-sedan")
COMFORT = Comfort(accelerate=1.5, brake=2.0)
DRIVE, BRAKES = DriveActuator(lag=0.2, dead_time=0.1), BrakeActuator(lag=0.15, dead_time=0.1)
CRUISE = speeds_of([(60.0, 0.0)], 10.0)
AT_ONCE = speeds_of([(2.5, -6.0)], 15.0)
STOP_AND_GO = speeds_of([(2.0, 0.0), (5.0, -2.0), (4.0, None), (10.0, 1.0), (5.0, 0.0), (5.0, -2.0)], 10.0)
"""A rest at 45 m from 7 s to 11 s, and the end at rest at 170 m at 31 s."""


class Drive:
    """Drive of a point mass along planned speeds: one row a control period in arrays."""

    def __init__(
        self, speeds: Any, seconds: float, *, speed: float | None = None, start: float = 0.0, place: float = 0.0,
        control: SpeedControl | None = None, is_timed: bool = True, grade: float = 0.0,
        replans: dict[float, Any] | None = None, **settings: float,
    ) -> None:  # fmt: skip
        rests = [s for s, arrive, leave in list(zip(*speeds[:1], *speeds[2:], strict=True))[1:-1] if leave > arrive]
        plan = SimpleNamespace(s=speeds.s, speed=speeds.speed, stops=[(s, math.inf) for s in rests], comfort=COMFORT)
        control = control or SpeedControl(CAR, drive=DRIVE, brakes=BRAKES)
        road = Road.from_segments([Line(length=float(speeds.s[-1]))], grade=grade)
        controller, planner = (
            SpeedController(control, road, plan, PERIOD, stop_at_end=True),
            planned(speeds, **settings),
        )
        car = PointMass(float(speeds.speed[0]) if speed is None else speed, CAR.mass, DRIVE, BRAKES, slope_of(grade))
        car.s, rows, self.requests = place, [], []
        sample, memory, state = controller.record.sample[0], controller.record.memory[0], planner.memory[0]
        for k in range(round(seconds / PERIOD)):
            time = start + k * PERIOD
            planner = planner._replace(speeds=(replans or {}).get(time, planner.speeds))
            keep_time(time, car.s, car.v, planner)
            if is_timed:
                sample.is_timed, sample.correction, sample.correction_limit = 1.0, state.correction, state.top_speed
                sample.rest_time = state.rest_time
                memory.is_released = max(memory.is_released, state.is_leaving)
            self.requests.append(controller.step(car.s, car.v, 0.0))
            rows.append((time, car.s, car.v, state.late, state.correction, self.requests[-1].acceleration))
            car.move(self.requests[-1].force, self.requests[-1].hold)
        self.time, self.place, self.speed, self.late, self.correction, self.acceleration = np.array(rows).T


# -- on time ----------------------------------------------------------------------------------------------------------
def test_a_car_that_is_two_seconds_late_catches_up_exponentially_and_never_exceeds_the_limit() -> None:
    # gap'' / gain + gap' + k gap = 0: the speed follows its target within 1 / gain
    slow_root = SpeedControl(CAR).gain * (math.sqrt(1.0 - 4.0 * 0.4 / SpeedControl(CAR).gain) - 1.0) / 2.0
    drive = Drive(CRUISE, 35.0, start=2.0, speed_limit=12.0)
    gap = 10.0 * drive.time - drive.place - 0.2
    assert gap[0] == pytest.approx(19.8)
    assert drive.speed.max() < 11.6  # 15 %
    is_free = (gap < 2.0) & (gap > 0.1)
    rate = np.polyfit(drive.time[is_free], np.log(gap[is_free]), 1)[0]
    assert rate == pytest.approx(slow_root, rel=0.1)
    assert abs(drive.late[-1]) < 0.03


@pytest.mark.parametrize("limit", [math.nan, 10.5])
def test_catching_up_stays_below_the_limit_and_by_default_below_the_planned_speed(limit: float) -> None:
    drive = Drive(CRUISE, 20.0, start=2.0, speed_limit=limit)
    assert drive.speed.max() < (10.0 if math.isnan(limit) else limit) + 0.08  # the offset of the speed control itself


def test_an_early_car_waits_with_at_most_the_braking_of_comfort() -> None:
    drive = Drive(CRUISE, 35.0, start=-2.0)
    assert drive.acceleration.min() >= -1.2 * COMFORT.brake - 1e-9
    assert drive.speed.min() > 8.4
    assert abs(drive.late[-1]) < 0.03


@pytest.mark.parametrize("late", [0.0, 1.5, 6.0])
def test_a_car_arrives_and_leaves_by_the_time_and_recovers_the_time_of_its_start(late: float) -> None:
    drive = Drive(STOP_AND_GO, 38.0, start=late, speed_limit=12.0)
    stands = drive.place[(drive.speed < 0.01) & (drive.place < 60.0)]
    assert np.ptp(stands) < 0.05
    assert stands[0] == pytest.approx(45.0, abs=0.1)
    arrival, departure = drive.time[drive.place > 44.75][0], drive.time[drive.place > 45.1][0]
    assert -0.1 < arrival - time_at(44.75, STOP_AND_GO) < late + 0.3
    assert departure > 11.0
    if late < 3.0:
        assert departure < 12.6
        assert drive.time[drive.place > 169.75][0] == pytest.approx(time_at(169.75, STOP_AND_GO), abs=0.3)
    assert drive.place[-1] == pytest.approx(170.0, abs=0.1)


@pytest.mark.parametrize("grade", [-0.08, 0.0, 0.08])
@pytest.mark.parametrize("control", [None, SpeedControl(CAR)])
def test_a_car_leaves_a_rest_within_half_a_second_of_its_time_and_never_before(grade, control) -> None:
    drive = Drive(STOP_AND_GO, 14.0, grade=grade, control=control)
    rests = (drive.time > 9.5) & (drive.time <= 11.0)
    assert np.ptp(drive.place[rests]) == 0.0
    assert 11.0 < drive.time[(drive.time > 9.5) & (drive.speed > 0.02)][0] < 11.5


@pytest.mark.parametrize("grade", [-0.08, 0.0, 0.08])
def test_a_car_whose_trajectory_begins_with_a_rest_waits_for_its_time(grade: float) -> None:
    drive = Drive(speeds_of([(3.0, None), (5.0, 1.0), (5.0, -1.0)], 0.0), 6.0, grade=grade)
    assert np.ptp(drive.place[(drive.time > 0.5) & (drive.time <= 3.0)]) == 0.0  # its brakes hold from then on
    assert np.abs(drive.place[drive.time <= 3.0]).max() < 0.05
    assert 3.0 < drive.time[(drive.time > 0.5) & (drive.speed > 0.02)][0] < 3.5


def test_a_car_whose_rest_is_prolonged_while_its_drive_pushes_stays() -> None:
    first, later = (speeds_of([(3.0, None), (5.0, 1.0), (5.0, -1.0)], 0.0, start=begin) for begin in (0.0, 2.0))
    drive = Drive(first, 6.0, replans={2.5: later})
    assert drive.requests[49].force > 0.0
    assert np.ptp(drive.place[drive.time <= 5.0]) == 0.0
    assert drive.speed[-1] > 0.1


def test_a_car_that_stands_five_centimetres_short_of_a_rest_leaves_it_and_arrives_at_the_end() -> None:
    drive = Drive(STOP_AND_GO, 32.0, speed=0.0, place=44.95, start=8.0)
    assert drive.place[drive.time < 11.0].max() < 45.1
    assert drive.place[-1] == pytest.approx(170.0, abs=0.1)


# -- the trajectory's own braking -------------------------------------------------------------------------------------
@pytest.mark.parametrize("brake", [2.0, 3.5])
def test_a_trajectory_that_brakes_at_once_is_followed_within_its_way_and_a_dead_time(brake, monkeypatch) -> None:
    monkeypatch.setitem(globals(), "COMFORT", Comfort(accelerate=1.5, brake=brake))
    drive = Drive(AT_ONCE, 5.0)
    assert drive.acceleration[0] < -6.0
    assert drive.place[-1] < 1.1 * (15.0**2 / (2.0 * 6.0) + 15.0 * BRAKES.dead_time)
    assert drive.speed[-1] == 0.0
    untimed = Drive(AT_ONCE, 8.0, is_timed=False)
    assert drive.place[-1] < untimed.place[-1] - 1.0


@pytest.mark.parametrize("deceleration", [3.0, 4.5, 6.0])
def test_a_trajectory_that_brakes_late_and_hard_is_neither_anticipated_nor_weakened(deceleration: float) -> None:
    speeds = speeds_of([(3.0, 0.0), (15.0 / deceleration, -deceleration)], 15.0)
    drive = Drive(speeds, 12.0)
    assert drive.speed[drive.time <= 2.9].min() > 14.9
    is_braking = (drive.time > 3.4) & (drive.speed > 5.0)
    errors = [place - place_at(time, speeds)[0] for time, place in zip(drive.time, drive.place, strict=True)]
    assert np.abs(np.array(errors)[is_braking]).max() < 0.25
    assert drive.place[-1] == pytest.approx(float(speeds.s[-1]), abs=0.15)


def test_comfort_bounds_the_correction_where_the_trajectory_does_not_brake_itself() -> None:
    drive = Drive(speeds_of([(3.0, 0.0), (1.5, -6.0), (10.0, 0.0)], 15.0), 6.0, speed=17.0)
    assert drive.acceleration[drive.time < 2.5].min() >= -1.2 * COMFORT.brake - 1e-9
    assert drive.acceleration.min() < -5.5


def test_the_end_of_a_trajectory_that_is_not_at_rest_is_a_stop_of_comfort() -> None:
    drive = Drive(speeds_of([(6.0, 0.0)], 10.0), 14.0)
    assert drive.acceleration.min() > -1.1 * COMFORT.brake
    assert drive.place[-1] == pytest.approx(60.0, abs=0.1)


def test_a_trajectory_that_hesitates_is_followed_without_a_stop() -> None:
    speeds = speeds_of([(2.0, 0.0), (4.85, -2.0), (4.0, 0.0), (4.85, 2.0), (5.0, 0.0)], 10.0)
    drive = Drive(speeds, 14.0)
    assert 0.25 < drive.speed.min() < 0.5
    assert {str(request.state) for request in drive.requests} == {"driving"}


@pytest.mark.parametrize("late", [-1.0, 0.0, 1.0])
def test_a_car_recovers_the_time_of_a_trajectory_that_creeps_while_it_creeps(late: float) -> None:
    speeds = speeds_of([(2.0, 0.0), (4.85, -2.0), (12.0, 0.0), (4.85, 2.0), (5.0, 0.0)], 10.0)
    drive = Drive(speeds, 24.0, start=late)
    assert drive.speed[drive.time > 8.0].min() > 0.25
    assert abs(drive.late[np.argmax(drive.time > 20.0)]) < 0.15
