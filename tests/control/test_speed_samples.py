"""Speed control behind samples that are late, repeated, overtaken, slow or wrong: place, scale and stops by the truth.

The car is a point mass on a straight road behind a lag of 0.15 s that the speed control does not know. Times of the
sensors are ticks of 10 ms; the loop calls every five of them with the message that its sensors have sent last.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from adaptrack import MPC, SpeedControl, Tracker, load_vehicle, plan_speed, road_through
from adaptrack.road import Stop

CAR = load_vehicle("midsize-sedan")
TICK, LOOP = 0.01, 5
"""s; ticks between two calls."""
DECAY = math.exp(-TICK / 0.15)
"""Of the force of drive and brakes in a tick."""


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """Calls of a drive, an array of each quantity, and the reports at its end."""

    x: Any
    v: Any
    """m, m/s: the truth"""
    station: Any
    sigma: Any
    """m: place that the speed control assumes, with its standard deviation"""
    scale: Any
    """-, estimated true speed over the measured one, less 1"""
    force: Any
    state: Any
    suspect: tuple[str, ...]

    @property
    def standing(self) -> list[float]:
        """Places (m) at which the car came to stand, the start left out."""
        stands = np.flatnonzero((self.v[1:] == 0.0) & (self.v[:-1] > 0.0)) + 1
        return [float(x) for x in self.x[stands] if x > 1.0]


def latest(tick: int) -> int:
    """Return the tick of a sample without an age."""
    return tick


def every(ticks: int, age: int = 0) -> Callable[[int], int]:
    """Return the tick of the newest sample of a sensor with a period and an age in ticks."""
    return lambda tick: (tick - age) - (tick - age) % ticks


def drive(
    pose: Callable[[int], int] = latest, motion: Callable[[int], int] | None = None, *, top_speed: float = 8.0,
    length: float = 200.0, stops: tuple[float, ...] = (), seconds: float = 50.0, noise: float = 0.02,
    position: Callable[[float, float], float] = lambda t, x: x, speed: Callable[[float, float], float] = lambda t, v: v,
    scale: float = 1.0,
) -> Run:  # fmt: skip
    """Drive to the end of a straight road.

    pose, motion: tick of the sample that a call at a tick passes; without motion both have one stamp. position, speed:
    measurement at a time (s) for the true x (m) and v (m/s). noise: of x (m). scale: true over measured speed.
    """
    road = road_through(np.column_stack([np.arange(0.0, length + 1.0, 4.0), np.zeros(int(length / 4) + 1)]))
    plan = plan_speed(road, CAR, top_speed=top_speed, start=0.0, end=0.0, stops=[Stop(s, 2.0) for s in stops])
    control = SpeedControl(CAR, friction=0.9)
    tracker = Tracker(MPC(CAR, profile="road", computation=0.0), road, plan=plan, speed=control)
    tracker.engage(wheel_angle=0.0)
    rng = np.random.default_rng(1)
    x = v = force = 0.0
    history, messages, rows = [(0.0, 0.0)], {}, []

    def message(tick: int, sensor: str) -> tuple[float, float]:
        sample_tick = max(tick, 0)
        if (sample_tick, sensor) not in messages:
            true_x, true_v = history[sample_tick]
            first, second = rng.standard_normal(2)
            measured_speed = speed(sample_tick * TICK, true_v) / scale + 0.02 * second * (true_v > 0.0)
            messages[sample_tick, sensor] = position(sample_tick * TICK, true_x) + noise * first, measured_speed
        return messages[sample_tick, sensor]

    for tick in range(round(seconds / TICK)):
        if tick % LOOP == 0:
            pose_tick, motion_tick = pose(tick), (motion or pose)(tick)
            measured_x, _ = message(pose_tick, "pose")
            _, measured_speed = message(motion_tick, "motion" if motion else "pose")
            out = tracker.step(
                max(pose_tick, 0) * TICK, measured_x, 0.0, 0.0, measured_speed, 0.0, now=tick * TICK,
                motion_time=max(motion_tick, 0) * TICK,
            )  # fmt: skip
            requests, memory = out.longitudinal, tracker._speed.record.memory[0]
            rows.append(
                (x, v, memory.station, math.sqrt(memory.p_station), memory.scale, requests.force, requests.state)
            )
        force = requests.force + (force - requests.force) * DECAY
        push, brakes = max(force, 0.0), max(-force, 0.0) + requests.hold
        v = max(0.0, v + TICK * (push - brakes) / CAR.mass) if v > 0.0 or push > brakes else 0.0
        x += TICK * v
        history.append((x, v))
    return Run(*(np.array(column) for column in zip(*rows, strict=True)), out.suspect)


def assert_stops(run: Run, *stops: float, beyond: float = 0.25, short: float = 0.35) -> None:
    """Assert that the car stood at each stop, and nowhere else, within the distances (m)."""
    errors = np.subtract(run.standing, stops) if len(run.standing) == len(stops) else np.array([np.inf])
    assert np.all((errors <= beyond) & (errors >= -short)), f"stood at {run.standing}, not at {stops}"


def random_ticks(choose: Callable[[int, Any], int]) -> Callable[[int], int]:
    """Return a sensor that draws the tick of its sample anew at each call, from a fixed seed."""
    rng = np.random.default_rng(7)
    return lambda tick: choose(tick, rng)


def repeated_between(start: float, end: float, is_repeated: Callable[[int], bool]) -> Callable[[int], int]:
    """Return a sensor that repeats the sample of the call before in some calls of a time (s)."""
    return lambda tick: tick - LOOP if start <= tick * TICK < end and is_repeated(tick // LOOP) else tick


SENSORS = {
    "10 Hz": (every(10), None), "5 Hz": (every(20), None), "10 Hz, 0.1 s old": (every(10, 10), None),
    "position at 5 Hz, speed at 20 Hz": (every(20), latest), "position at 20 Hz, speed at 10 Hz": (latest, every(10)),
    "0.05 to 0.15 s old": (random_ticks(lambda tick, rng: tick - int(rng.integers(5, 16))), None),
    "half of the samples repeated": (random_ticks(lambda tick, rng: tick - LOOP * int(rng.integers(0, 2))), None),
}  # fmt: skip
"""Samples with honest stamps: sensors of the pose, and of the motion where it has a different one."""


@pytest.mark.parametrize("sensors", SENSORS.values(), ids=SENSORS)
def test_slow_and_repeated_samples_leave_the_scale_of_the_speed_within_two_percent(sensors) -> None:
    run = drive(*sensors, length=300.0)
    assert abs(run.scale[-1]) < 0.02


@pytest.mark.parametrize("sensors", SENSORS.values(), ids=SENSORS)
def test_slow_and_repeated_samples_leave_the_stops_where_they_are(sensors) -> None:
    run = drive(*sensors, stops=(100.0,))
    assert_stops(run, 100.0, 200.0)


def test_the_place_is_within_three_of_its_standard_deviations() -> None:
    run = drive(every(10), length=300.0, noise=0.1)
    moving = run.v > 0.5
    assert np.mean(np.abs(run.station - run.x)[moving] < 3.0 * run.sigma[moving]) > 0.95


@pytest.mark.parametrize("age", [5, 10, 15])
def test_a_speed_is_carried_over_its_age(age) -> None:
    run = drive(every(1, age), stops=(100.0,))
    assert_stops(run, 100.0, 200.0, beyond=0.15, short=0.15)


@pytest.mark.parametrize("scale", [0.93, 1.07])
def test_the_scale_of_a_speed_sensor_is_learned_from_late_positions(scale) -> None:
    run = drive(every(10, 10), length=300.0, scale=scale)
    assert run.scale[-1] == pytest.approx(scale - 1.0, abs=0.02)
    assert any("speed" in sentence for sentence in run.suspect)


BAD_POSITIONS = {
    "half of the samples repeated": (repeated_between(12.0, 17.0, lambda call: call * 7 % 4 < 2), lambda t, x: x),
    "each second sample repeated": (repeated_between(12.0, 17.0, lambda call: call % 2 == 1), lambda t, x: x),
    "one sample for 5 s": (lambda tick: 1200 if 1200 <= tick < 1700 and tick // LOOP % 2 else tick, lambda t, x: x),
    "3 m ahead": (latest, lambda t, x: x + 3.0 * (12.0 <= t < 17.0)),
    "3 m behind": (latest, lambda t, x: x - 3.0 * (12.0 <= t < 17.0)),
    "swing by 2 m": (latest, lambda t, x: x + (12.0 <= t < 17.0) * math.copysign(2.0, math.sin(math.tau * t))),
}
"""Positions that are bad for 5 s: the sensor and the measured x."""


@pytest.mark.parametrize(("sensor", "position"), BAD_POSITIONS.values(), ids=BAD_POSITIONS)
def test_a_place_recovers_from_some_seconds_of_bad_positions(sensor, position) -> None:
    run = drive(sensor, position=position, top_speed=4.0, length=120.0)
    assert run.v[-1] == 0.0
    assert run.x[-1] == pytest.approx(120.0, abs=0.3)


def freeze_at(time: float) -> tuple[Callable[[int], int], Callable[[int], int]]:
    """Return sensors of pose and motion; the motion keeps its message from a time (s) on."""
    return latest, lambda tick: min(tick, round(time / TICK))


def test_a_speed_that_has_become_old_is_no_speed() -> None:
    run = drive(*freeze_at(3.0), top_speed=12.0, length=400.0)
    assert run.v.max() < 13.0
    assert run.v[-1] == 0.0


@pytest.mark.parametrize("measured", [lambda t, v: min(v, 6.0), lambda t, v: 0.5 * v], ids=["at most 6 m/s", "half"])
def test_a_speed_that_contradicts_the_positions_is_no_speed(measured) -> None:
    run = drive(speed=measured, top_speed=12.0, length=600.0)
    assert np.count_nonzero(run.v > 13.0) * LOOP * TICK < 2.0
    assert run.v[-1] == 0.0


@pytest.mark.parametrize("seconds", [0.3, 0.6, 1.0])
def test_a_gap_of_the_position_is_no_emergency(seconds) -> None:
    run = drive(position=lambda t, x: math.nan if 10.0 <= t < 10.0 + seconds else x, top_speed=10.0)
    assert "emergency" not in run.state
    assert_stops(run, 200.0)


ODD_NUMBERS = (1e300, -1e300, 1e18, -5.0, 3.0, math.nan, math.inf)


@pytest.mark.parametrize("field", ["motion_time", "longitudinal_acceleration", "grade", "speed", "yaw_rate", "x", "t"])
@pytest.mark.parametrize("odd", ODD_NUMBERS)
def test_one_odd_number_leaves_all_later_requests_finite_and_within_the_car(field, odd) -> None:
    road = road_through(np.column_stack([np.arange(0.0, 201.0, 4.0), np.zeros(51)]))
    plan = plan_speed(road, CAR, top_speed=8.0, start=0.0, end=0.0)
    tracker = Tracker(MPC(CAR, profile="road", computation=0.0), road, plan=plan, speed=SpeedControl(CAR))
    tracker.engage(wheel_angle=0.0)
    for k in range(20):
        call_time = 0.05 * k
        row = {
            "t": call_time, "x": 4.0 * call_time, "y": 0.0, "yaw": 0.0, "speed": 4.0, "yaw_rate": 0.0,
            "now": call_time,
        }  # fmt: skip
        request = tracker.step(**(row | {field: odd} if k == 8 else row)).longitudinal
        assert math.isfinite(request.acceleration)
        assert -CAR.brake_limit <= request.force <= CAR.traction_limit
        assert 0.0 <= request.hold <= CAR.brake_limit
    assert request.state == "driving"


def test_positions_of_5_hz_find_a_speed_that_reads_zero_on_the_way() -> None:
    run = drive(every(20), latest, speed=lambda t, v: 0.0 if t > 12.0 else v, stops=(), seconds=25.0)
    calls = np.arange(run.v.size) * LOOP * TICK
    assert run.v[calls > 12.0].max() < run.v[calls <= 12.0].max() + 1.0
    assert run.v[calls > 22.0].max() == 0.0


def test_a_jump_of_the_measured_speed_teaches_nothing_about_drive_and_slope() -> None:
    """A sensor that reads 0.8 of the speed from a time on, and the truth again a second later."""
    wrong_speed = lambda t, v: 0.8 * v if 14.0 < t < 15.0 else v  # noqa: E731
    run = drive(speed=wrong_speed, top_speed=10.0, length=400.0, stops=(300.0,), seconds=75.0)
    assert_stops(run, 300.0, 400.0)
    assert np.abs(run.force[int(20.0 / (LOOP * TICK)) : int(25.0 / (LOOP * TICK))]).max() < 0.3 * CAR.mass


@pytest.mark.parametrize("calls_per_sample", [1, 10, 50])
def test_calls_at_one_time_keep_the_requests_as_long_as_they_are_usual_and_brake_once_the_time_sticks(
    calls_per_sample,
) -> None:
    road = road_through(np.column_stack([np.arange(0.0, 401.0, 4.0), np.zeros(101)]))
    plan = plan_speed(road, CAR, top_speed=8.0, start=8.0)
    tracker = Tracker(MPC(CAR, profile="road", computation=0.0), road, plan=plan, speed=SpeedControl(CAR, friction=0.9))
    for k in range(40):
        for _ in range(calls_per_sample):
            usual = tracker.step(0.05 * k, 8.0 * 0.05 * k, 0.0, 0.0, 8.0, 0.0).longitudinal
        assert usual.limited_by != "fault"
    answers = [
        tracker.step(0.05 * 39, 8.0 * 0.05 * 39, 0.0, 0.0, 8.0, 0.0).longitudinal for _ in range(14 * calls_per_sample)
    ]
    grace = round(0.5 / 0.05) * calls_per_sample
    assert all(answer == usual for answer in answers[: grace - calls_per_sample - 1])
    assert answers[-1].limited_by == "fault"
    assert answers[-1].acceleration < -1.0
