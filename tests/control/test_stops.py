"""Stops, standstill and starts of the speed control: what lies ahead is served once, and the car never rolls away."""

from __future__ import annotations

import math
import multiprocessing
import warnings
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from adaptrack import PurePursuit, SpeedControl, Tracker, load_vehicle
from adaptrack.control.speed_control import SpeedController
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.speed.speed_control import slope_of
from adaptrack.road import Arc, Comfort, Line, Road, SpeedPlan, Stop, plan_speed
from small_controllers import Scripted

CAR = load_vehicle("midsize-sedan")
PERIOD, SUBSTEPS = 0.05, 5
RADIUS = 20.0
"""m, of the lap."""
LAP, LAP_STOP = 2.0 * math.pi * RADIUS, 60.0
STEEP_HOLD = CAR.mass * slope_of(0.25)
"""N, brake force that holds the car of the file on a slope of 25 %."""


class Row(NamedTuple):
    """A control period: time (s), arc length over all laps (m), speed (m/s), requests of the speed control."""

    time: float
    s: float
    v: float
    request: Any


class World:
    """A car on a road along which a tracker drives it; brakes with a lag and a dead time only oppose its motion."""

    def __init__(
        self, tracker: Any, *, s: float = 0.0, v: float = 0.0, grade: float = 0.0, mass: float = 1.0,
        brakes: float = 1.0, drive_delay: tuple[float, float] = (0.2, 0.1), brake_delay: float = 0.1,
    ) -> None:  # fmt: skip
        self.tracker, self.s, self.v, self.time = tracker, s, v, 0.0
        self._mass, self._brakes, self._slope = mass * CAR.mass, brakes, slope_of(grade)
        self._step, self._forces = PERIOD / SUBSTEPS, [0.0, 0.0]
        lags, dead_times = (drive_delay[0], brake_delay), (drive_delay[1], brake_delay)
        self._shares = [1.0 - math.exp(-self._step / lag) for lag in lags]
        self._queues = [[0.0] * round(dead_time / self._step) for dead_time in dead_times]
        self._is_lap = isinstance(tracker, Tracker) and tracker.path.closed

    def pose(self) -> tuple[float, float, float]:
        """Return x, y (m) and yaw (rad)."""
        if not self._is_lap:
            return self.s, 0.0, 0.0
        angle = self.s / RADIUS
        return RADIUS * math.sin(angle), RADIUS * (1.0 - math.cos(angle)), angle

    def call(
        self, *, driver: bool = False, has_position: bool = True, is_signed: bool = True, noise: float = 0.0,
        **times: float,
    ) -> Any:  # fmt: skip
        """Call the tracker, or a speed control alone, with the present sample; return the requests."""
        speed = self.v if is_signed else abs(self.v)
        if not isinstance(self.tracker, Tracker):
            return self.tracker.step(self.s + noise, speed, 0.0, driver=driver)
        x, y, yaw = self.pose() if has_position else (math.nan,) * 3
        yaw_rate = speed / RADIUS if self._is_lap else 0.0
        sample = {"t": self.time, **times}
        return self.tracker.step(
            sample.pop("t"), x + noise, y, yaw, speed, yaw_rate, driver=driver, **sample
        ).longitudinal  # fmt: skip

    def run(self, seconds: float, *, noises: Any = None, **options: Any) -> list[Row]:
        """Drive for a time (s); noises: m, of the positions, one for each period."""
        rows = []
        for k in range(round(seconds / PERIOD)):
            request = self.call(noise=0.0 if noises is None else float(noises[k]), **options)
            rows.append(Row(self.time, self.s, self.v, request))
            self._move(request)
        return rows

    def carry(
        self, speed: float, seconds: float, *, driver: bool = True, is_called: bool = True, **options: Any
    ) -> None:
        """Move the car at a speed (m/s), whatever is requested."""
        self.v = speed
        for _ in range(round(seconds / PERIOD)):
            if is_called:
                self.call(driver=driver, **options)
            self.s, self.time = self.s + PERIOD * speed, self.time + PERIOD

    def _move(self, request: Any) -> None:
        requests = (max(request.force, 0.0), self._brakes * (max(-request.force, 0.0) + request.hold))
        for _ in range(SUBSTEPS):
            for i in range(2):
                self._queues[i].append(requests[i])
                self._forces[i] += self._shares[i] * (self._queues[i].pop(0) - self._forces[i])
            push = self._forces[0] / self._mass - self._slope
            resistance = self._forces[1] / self._mass + 0.01 * GRAVITY
            if self.v != 0.0 or abs(push) > resistance:
                direction = math.copysign(1.0, self.v if self.v != 0.0 else push)
                speed = self.v + self._step * (push - direction * resistance)
                speed = 0.0 if speed * self.v < 0.0 else speed
                self.s += 0.5 * self._step * (self.v + speed)
                self.v = speed
        self.time += PERIOD


def _straight(length: float = 150.0, origin: float = 0.0, grade: float = 0.0, offset: float = 0.0) -> Road:
    return Road.from_segments([Line(length=length)], start=(origin, offset, 0.0), grade=grade)


def _plan(road: Road, stops: list[Stop], *, accelerate: float = 2.0, **options: Any) -> SpeedPlan:
    return plan_speed(road, CAR, Comfort(accelerate=accelerate), stops=stops, **{"top_speed": 8.0, **options})


def _tracker(road: Road, stops: list[Stop] | None = None, **options: Any) -> Tracker:
    plan = _plan(road, stops or [], **options)
    return Tracker(Scripted(lambda t: 0.0, PERIOD), road, plan=plan, speed=SpeedControl(CAR))


def _stands(rows: list[Row]) -> list[float]:
    """Return the places (m) at which the car stood in the state "stopped", each once."""
    places: list[float] = []
    for row in rows:
        if row.request.state == "stopped" and row.v == 0.0 and not (places and abs(row.s - places[-1]) < 1.0):
            places.append(row.s)
    return places


def _time_at(rows: list[Row], place: float) -> float:
    """Return how long (s) the car stood within 1 m of a place (m)."""
    return PERIOD * sum(row.v == 0.0 and abs(row.s - place) < 1.0 for row in rows)


def _rolled_back(rows: list[Row]) -> float:
    """Return the longest way (m) backwards."""
    places = np.array([row.s for row in rows])
    return float((np.maximum.accumulate(places) - places).max())


# -- what lies ahead is ahead -----------------------------------------------------------------------------------------
def _lap_tracker() -> Tracker:
    road = Road.from_segments([Arc(length=LAP, curvature=1.0 / RADIUS)], closed=True)
    return _tracker(road, [Stop(LAP_STOP, 1.0)])


@pytest.mark.parametrize("event", ["none", "gap", "engage", "follow", "driver", "missing"])
def test_a_car_serves_the_stop_of_a_lap_on_each_lap_whatever_happens_between(event) -> None:
    world = World(_lap_tracker(), s=40.0)
    rows = world.run(35.0)  # stands on laps 1 and 2, and drives on
    assert LAP + LAP_STOP + 5.0 < world.s < 2.0 * LAP
    if event == "gap":
        world.carry(world.v, 3.0, is_called=False)
    elif event == "engage":
        world.tracker.engage()
    elif event == "follow":
        world.tracker.follow(world.tracker.path, world.tracker.plan)
    elif event == "driver":
        world.carry(8.0, 2.0)
    elif event == "missing":
        rows += world.run(0.4, has_position=False)
    rows += world.run(26.0)
    expected = [LAP_STOP + LAP * lap for lap in range(3)]
    assert _stands(rows) == pytest.approx(expected, abs=0.3)


@pytest.mark.parametrize("way", ["back", "blind", "lap"])
def test_a_stop_that_a_driver_passed_is_served_once_the_car_is_before_it_again(way) -> None:
    if way == "lap":
        world, place = World(_lap_tracker()), LAP_STOP + LAP
        world.carry(8.0, LAP_STOP / 8.0 + 2.0)
    else:
        world, place = World(_tracker(_straight(), [Stop(60.0, 2.0)])), 60.0
        world.carry(8.0, 12.0, has_position=way == "back")
        if way == "back":
            world.carry(-8.0, 12.0)
        world.s = 0.0
    world.carry(0.0, 1.0)
    rows = world.run(35.0)
    assert _stands(rows)[0] == pytest.approx(place, abs=0.3)
    assert rows[-1].s > place + 2.0


def test_a_stop_that_a_car_has_served_is_served_again_only_when_a_driver_has_brought_it_back_before_it() -> None:
    for back, is_served in ((2.0, False), (12.0, True)):
        world = World(_tracker(_straight(), [Stop(40.0, 1.0)]))
        rows = world.run(14.0)
        assert world.s > 41.0
        assert _stands(rows) == pytest.approx([40.0], abs=0.3)
        world.carry(-1.0, world.s - 40.0 + back)
        world.carry(0.0, 1.0)
        rows = world.run(14.0)
        assert bool(_stands(rows)) == is_served, back
        assert world.s > 45.0


@pytest.mark.parametrize("seed", range(4))
def test_noise_of_the_position_asks_for_no_second_stop(seed) -> None:
    road = _straight()
    controller = SpeedController(SpeedControl(CAR), road, _plan(road, [Stop(40.0, 1.0)]), PERIOD)
    world = World(controller, v=6.0)
    rows = world.run(26.0, noises=0.4 * np.random.default_rng(seed).standard_normal(600))
    assert world.s > 60.0
    stops = np.flatnonzero(np.diff([float(row.request.state == "stopped") for row in rows]) > 0.0)
    assert stops.size == 1


def _stop_after_a_far_time(field: str, value: float) -> None:
    """Let a driver drive a lap, with one call at a far time without a position; demand that the car serves its stop."""
    world = World(_lap_tracker())
    world.carry(8.0, 2.0)
    world.call(driver=True, has_position=False, **{field: value})
    world.time += PERIOD
    world.carry(8.0, 1.0)
    rows = world.run(20.0)
    assert _stands(rows)[0] == pytest.approx(LAP_STOP, abs=0.3)
    assert all(math.isfinite(row.request.force) and math.isfinite(row.request.acceleration) for row in rows)


@pytest.mark.parametrize("field", ["t", "motion_time"])
@pytest.mark.parametrize("value", [3600.0, -3600.0, 1e8])
def test_a_stop_ahead_survives_a_call_at_a_far_time(field, value) -> None:
    _stop_after_a_far_time(field, value)


@pytest.mark.compiled
@pytest.mark.parametrize(("field", "value"), [("t", 1.7e18), ("motion_time", 1.7e18), ("motion_time", 1e300)])
def test_a_time_stamp_in_nanoseconds_neither_hangs_the_speed_control_nor_hides_a_stop(field, value) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # of a fork beside threads
        process = multiprocessing.get_context("fork").Process(target=_stop_after_a_far_time, args=(field, value))
        process.start()
    process.join(30.0)  # s; nothing but the end of its process interrupts a kernel that never returns
    is_hanging = process.exitcode is None
    if is_hanging:
        process.kill()
        process.join()
    assert not is_hanging
    assert process.exitcode == 0


@pytest.mark.parametrize("shift", [3600.0, -3600.0, 1.7e9])
def test_a_clock_that_is_set_while_the_car_drives_hides_no_stop(shift) -> None:
    world = World(_lap_tracker())
    rows = world.run(6.0)
    world.time += shift
    rows += world.run(60.0)
    assert _stands(rows)[:2] == pytest.approx([LAP_STOP, LAP_STOP + LAP], abs=0.3)


# -- the end ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("seconds", [2.0, math.inf])
@pytest.mark.parametrize("stop_at_end", [False, True])
def test_a_car_stays_at_a_stop_at_the_very_end_of_its_path_if_it_is_to_stay_at_the_end(seconds, stop_at_end) -> None:
    road = _straight(50.0)
    plan = SimpleNamespace(
        s=np.array([0.0, 50.0]), speed=np.array([6.0, 6.0]), stops=[Stop(50.0, seconds)], comfort=Comfort()
    )
    world = World(SpeedController(SpeedControl(CAR), road, plan, PERIOD, stop_at_end=stop_at_end), v=6.0)
    rows = world.run(30.0)
    assert _stands(rows)[0] == pytest.approx(50.0, abs=0.3)
    if stop_at_end or math.isinf(seconds):
        assert rows[-1].s == pytest.approx(50.0, abs=0.3)
        assert rows[-1].request.state == "stopped"
    else:  # it leaves the stop, and stands beyond the end
        assert sum(row.request.state == "stopped" for row in rows) * PERIOD == pytest.approx(seconds, abs=0.1)
        assert (rows[-1].v, rows[-1].request.state) == (0.0, "stopping")


@pytest.mark.parametrize(("beyond", "speed"), [(0.2, 0.0), (1.0, 3.0), (5.0, 0.0), (30.0, 6.0), (120.0, 0.0)])
def test_a_car_that_a_driver_hands_over_beyond_the_end_stops_and_stays(beyond, speed) -> None:
    world = World(_tracker(_straight(60.0)), s=60.0 + beyond - speed, v=speed)
    world.carry(speed, 1.0)
    rows = world.run(12.0)
    assert rows[-1].v == 0.0
    assert rows[-1].s - rows[0].s < 0.1 + speed + speed**2 / (2.0 * 2.0)  # m: 1 s of delays, braking with 2 m/s^2
    assert {row.request.state for row in rows[-40:]} == {"stopped"}


# -- another plan under way -------------------------------------------------------------------------------------------
@pytest.mark.parametrize("shift", [0.0, 10.0])
def test_a_planner_that_sends_its_plan_twice_a_second_holds_the_car_for_the_time_of_the_stop_alone(shift) -> None:
    roads = [_straight(150.0 - origin, origin, offset=0.02 * origin) for origin in (0.0, shift)]
    plans = [_plan(road, [Stop(40.0 - origin, 2.0)]) for road, origin in zip(roads, (0.0, shift), strict=True)]
    world = World(Tracker(Scripted(lambda t: 0.0, PERIOD), roads[0], plan=plans[0], speed=SpeedControl(CAR)), s=12.0)
    rows = []
    for k in range(50):
        rows += world.run(0.5)
        world.tracker.follow(roads[k % 2], plans[k % 2])
    assert _time_at(rows, 40.0) == pytest.approx(2.0, abs=1.0)
    assert max(row.s for row in rows) > 60.0


def _standing_world(seconds: float = 30.0) -> tuple[World, list[Row]]:
    """Return a car that has just begun to stand at its stop at 40 m, and its drive."""
    world = World(_tracker(_straight(), [Stop(40.0, seconds)]), s=20.0)
    rows = world.run(5.0)
    while rows[-1].request.state != "stopped" or world.v != 0.0:
        rows += world.run(PERIOD)
        assert world.time < 20.0
    return world, rows


def test_the_time_stood_counts_after_a_plan_with_another_time_at_the_stop() -> None:
    for seconds, remaining in ((6.0, 3.0), (2.0, 0.0)):
        world, _ = _standing_world()
        world.run(3.0)
        world.tracker.follow(world.tracker.path, _plan(world.tracker.path, [Stop(40.0, seconds)]))
        rows = world.run(6.0)
        assert _time_at(rows, 40.0) == pytest.approx(remaining, abs=1.0)


def test_a_stop_that_the_next_plan_no_longer_has_releases_the_car_and_a_new_one_is_served() -> None:
    world, _ = _standing_world()
    world.tracker.follow(world.tracker.path, _plan(world.tracker.path, [Stop(48.0, 1.0)]))
    rows = world.run(12.0)
    assert _time_at(rows, 40.0) < 1.5
    assert _stands(rows)[-1] == pytest.approx(48.0, abs=0.3)
    assert rows[-1].s > 50.0


def test_a_served_stop_in_the_next_plan_is_not_served_again_just_behind_or_before_it() -> None:
    for jitter in (-0.3, 0.0, 0.3):
        world, _ = _standing_world(seconds=1.0)
        rows = []
        for _ in range(12):
            rows += world.run(0.5)
            road = _straight(150.0, origin=jitter)
            world.tracker.follow(road, _plan(road, [Stop(40.0 - jitter + 0.5 * jitter, 1.0)]))
        assert _time_at(rows, 40.0) < 2.0
        assert rows[-1].s > 46.0


# -- release ----------------------------------------------------------------------------------------------------------
def test_release_lets_a_car_leave_a_stop_whatever_its_time_and_no_stop_to_come() -> None:
    world = World(_tracker(_straight(), [Stop(20.0, 60.0), Stop(40.0, 60.0)]), s=5.0)
    world.tracker.release()  # the car does not stand at a stop
    rows = world.run(12.0)
    assert _stands(rows) == pytest.approx([20.0], abs=0.3)
    assert world.v == 0.0
    world.tracker.release()
    rows = world.run(14.0)
    assert _stands(rows)[-1] == pytest.approx(40.0, abs=0.3)
    assert rows[-1].v == 0.0


def test_a_car_stands_at_a_stop_until_released_until_it_is_released() -> None:
    world, _ = _standing_world(seconds=math.inf)
    assert world.run(20.0)[-1].s == pytest.approx(40.0, abs=0.3)
    world.tracker.release()
    assert world.run(5.0)[-1].s > 42.0


def test_release_leaves_no_end_of_a_path() -> None:
    world = World(_tracker(_straight(40.0)), s=20.0)
    world.run(12.0)
    world.tracker.release()
    rows = world.run(5.0)
    assert rows[-1].s == pytest.approx(40.0, abs=0.3)
    assert rows[-1].v == 0.0


# -- near stops -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("dead_time", [0.05, 0.25])
@pytest.mark.parametrize("distance", [0.2, 0.3, 0.4, 0.5, 0.7, 1.0])
def test_a_standing_car_moves_to_a_stop_just_ahead_and_ends_within_a_tenth_of_a_metre(distance, dead_time) -> None:
    world = World(_tracker(_straight(), [Stop(20.0 + distance, 60.0)]), s=20.0, drive_delay=(0.3, dead_time))
    rows = world.run(15.0)
    assert max(row.s for row in rows) <= 20.0 + distance + 0.1
    assert rows[-1].s >= 20.0 + distance - 0.1
    assert (rows[-1].v, rows[-1].request.state) == (0.0, "stopped")


@pytest.mark.parametrize("distance", [0.0, 0.05, 0.14])
def test_a_standing_car_has_reached_a_stop_that_is_nearer_than_fifteen_centimetres(distance) -> None:
    world = World(_tracker(_straight(), [Stop(20.0 + distance, 2.0)]), s=20.0)
    rows = world.run(1.5)
    assert rows[-1].s == 20.0
    assert rows[-1].request.state == "stopped"
    assert world.run(6.0)[-1].s > 21.0


# -- hold and slopes --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("map_grade", [-0.2, 0.0, 0.1])
def test_at_rest_the_hold_never_is_below_what_holds_the_car_on_a_slope_of_a_quarter(map_grade) -> None:
    world = World(_tracker(_straight(grade=map_grade), [Stop(40.0, 3.0)]), s=20.0, grade=0.05)
    rows = world.run(18.0)
    resting = [row.request for row in rows if row.request.state == "stopped" and row.v == 0.0][10:-1]
    assert len(resting) > 20
    assert all(request.hold >= STEEP_HOLD and request.force <= 0.0 for request in resting)
    assert world.s > 45.0
    world.carry(0.0, 1.0)
    assert world.call(driver=True).hold >= STEEP_HOLD  # the driver may take the foot off the brake


def test_the_hold_reaches_as_far_as_the_brakes() -> None:
    car = CAR.replace(brake_limit=0.7 * STEEP_HOLD)
    road = _straight()
    control = SpeedController(SpeedControl(car), road, _plan(road, [Stop(20.0, 60.0)], top_speed=2.0), PERIOD)
    rows = World(control, s=10.0, v=2.0).run(12.0)
    assert rows[-1].v == 0.0
    assert rows[-1].request.hold == pytest.approx(car.brake_limit)
    assert all(row.request.hold - min(row.request.force, 0.0) <= car.brake_limit * (1.0 + 1e-9) for row in rows)


@pytest.mark.parametrize("grade", [-0.2, -0.05, 0.05, 0.2])
def test_the_hold_is_no_negative_number_and_no_brake_force_meets_a_car_that_rolls_back(grade) -> None:
    world = World(_tracker(_straight(), [Stop(30.0, 2.0)]), s=10.0, grade=grade)
    rows = world.run(20.0)
    rows += world.run(6.0, has_position=False)
    for row in rows:
        assert row.request.hold >= 0.0
        assert math.isfinite(row.request.force)
        assert row.request.force >= 0.0 or row.v > -0.1


@pytest.mark.parametrize("accelerate", [0.1, 0.3, 2.0])
@pytest.mark.parametrize(
    ("map_grade", "grade"), [(0.06, 0.06), (0.2, 0.2), (0.0, 0.12), (0.0, 0.2), (-0.1, 0.1), (0.2, 0.02)]
)
def test_a_car_starts_by_any_plan_that_rises_on_any_ascent(map_grade, grade, accelerate) -> None:
    world = World(_tracker(_straight(grade=map_grade), accelerate=accelerate, start=0.0), grade=grade)
    world.carry(0.0, 0.5)
    rows = world.run(20.0)
    assert rows[-1].s > 2.0
    assert _rolled_back(rows) <= (0.1 if grade <= 0.12 else 0.5)


@pytest.mark.parametrize("is_signed", [True, False])
@pytest.mark.parametrize("grade", [0.1, 0.18, 0.25])
def test_a_car_that_begins_to_roll_on_an_ascent_that_no_map_has_drives_up_it(grade, is_signed) -> None:
    world = World(_tracker(_straight(), start=0.0), grade=grade)  # at first nothing holds it
    rows = world.run(20.0, is_signed=is_signed)
    assert _rolled_back(rows) < 2.0
    assert all(row.request.state != "driving" for row in rows if row.v < -1.0)
    assert rows[-1].s > 5.0


@pytest.mark.parametrize("is_signed", [True, False])
@pytest.mark.parametrize("grade", [-0.25, -0.12, 0.1, 0.25])
def test_a_car_that_loses_its_position_stands_on_a_slope_that_no_map_has_and_does_not_start(grade, is_signed) -> None:
    road = _straight()
    tracker = Tracker(PurePursuit(CAR, period=PERIOD), road, plan=_plan(road, []), speed=SpeedControl(CAR))
    world = World(tracker, s=20.0, v=6.0, grade=grade, mass=1.2, brakes=0.9)
    rows = world.run(3.0, is_signed=is_signed) + world.run(15.0, has_position=False, is_signed=is_signed)
    first = next(i for i, row in enumerate(rows) if i > 60 and row.v <= 0.0)
    assert max(abs(row.s - rows[first].s) for row in rows[first:]) < 1.0
    assert rows[-1].v == 0.0


@pytest.mark.parametrize("is_signed", [True, False])
@pytest.mark.parametrize(
    ("grade", "mass", "brakes"), [(0.12, 1.3, 0.85), (0.25, 1.3, 0.85), (-0.25, 1.3, 0.85), (0.25, 0.8, 1.1)]
)
def test_a_car_stands_where_it_stopped_on_a_slope_that_no_map_has(grade, mass, brakes, is_signed) -> None:
    tracker = _tracker(_straight(), [Stop(40.0, 40.0)], top_speed=5.0)
    world = World(tracker, s=10.0, v=5.0, grade=grade, mass=mass, brakes=brakes)
    rows = world.run(20.0, is_signed=is_signed)
    first = next(i for i, row in enumerate(rows) if i > 60 and row.v <= 0.0)
    target = 1.0 if not is_signed else 0.1 if abs(grade) <= 0.12 else 0.5
    assert max(abs(row.s - rows[first].s) for row in rows[first:]) <= target
    assert rows[-1].v == 0.0
    if grade > 0.0:  # down a steep slope weak brakes may look like failed ones
        assert rows[first].s == pytest.approx(40.0, abs=0.25)
        assert rows[-1].request.state == "stopped"
    rows = world.run(10.0, has_position=False, is_signed=is_signed)
    assert max(abs(row.s - rows[0].s) for row in rows) <= 0.1
    assert rows[-1].v == 0.0


def test_no_car_starts_from_rest_without_a_position() -> None:
    world, _ = _standing_world(seconds=3.0)
    world.run(1.0)
    place = world.s
    rows = world.run(12.0, has_position=False)
    assert max(abs(row.s - place) for row in rows) < 0.02
    assert all(row.request.hold >= STEEP_HOLD for row in rows)
    assert world.run(8.0)[-1].s > 42.0  # it starts once the position is back


# -- what is learned --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("map_grade", "grade"), [(-0.1, -0.1), (0.0, -0.1), (0.0, 0.2)])
def test_a_car_that_was_held_on_a_slope_learns_the_gain_of_its_drive_and_not_of_its_brakes(map_grade, grade) -> None:
    world = World(_tracker(_straight(400.0, grade=map_grade)), grade=grade, mass=1.1)
    world.run(12.0)
    drive = world.tracker._speed.learned["drive"]
    assert drive.ratio == pytest.approx(1.0 / 1.1, abs=0.15)
    assert drive.disturbance == pytest.approx(slope_of(map_grade) - slope_of(grade), abs=0.4)


def test_a_car_that_has_rolled_back_before_starts_with_all_its_drive() -> None:
    """A push beyond what the drive has is not waited for."""
    world = World(_tracker(_straight(grade=0.1)), grade=0.1)
    world.run(PERIOD)
    world.tracker._speed.record.memory[0].rolled = 20.0
    assert world.run(12.0)[-1].s > 5.0


def test_the_time_at_a_stop_is_the_time_that_passes_though_the_loop_engages_anew() -> None:
    world, rows = _standing_world(5.0)
    for _ in range(3):
        rows += world.run(1.0)
        world.tracker.engage(0.0)
    rows += world.run(6.0)
    assert _time_at(rows, 40.0) == pytest.approx(5.0, abs=1.5)


def test_a_car_beside_a_tight_lap_is_not_taken_for_one_with_a_wrong_speed() -> None:
    world = World(_lap_tracker(), v=5.0)
    radius = RADIUS + 6.0  # m: 30 % more way than the lap has

    def pose_beside() -> tuple[float, float, float]:
        angle = world.s / radius
        return radius * math.sin(angle), RADIUS - radius * math.cos(angle), angle

    world.pose = pose_beside  # type: ignore[method-assign]
    rows = world.run(14.0)
    assert "fault" not in {row.request.limited_by for row in rows}
