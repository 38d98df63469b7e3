"""How well the car follows its plan and stops where samples are late, slow, noisy or missing.

    python benchmarks/late_samples.py late --drives 300 --seed 1 --jobs 2      late, slow and noisy samples
    python benchmarks/late_samples.py hills --drives 100 --seed 1 --jobs 2     changes between throttle and brake
    python benchmarks/late_samples.py gaps --drives 60 --seed 1 --jobs 2       gaps of the position of 0.3 to 1 s
    python benchmarks/late_samples.py losses --drives 500 --seed 1 --jobs 2    the position is lost for good

A car of its own (a point mass along the road, a kinematic single track across it) drives country roads through
`Tracker` with the default MPC and a `SpeedControl` that knows neither actuators nor mass nor slope: lag and dead time
as in `DELAYS`, gains of 0.85 to 1.1, 0.85 to 1.4 times the mass of the car file, 4 % of slope. The controller knows the
noise of the position and the largest age of a sample; the steering has the lag of its profile. Drive i of a seed S
draws everything from (S, i); ``--first I --drives 1`` repeats drive I alone.

late: a pose and a motion message, each at 5, 10 or 20 Hz, arrive 0.05 to 0.15 s after they were taken; a loop of 20 Hz
passes the message that arrived last. Messages are thus repeated, skipped and overtaken. Each drive is repeated with
prompt samples. In further drives the noise is correlated over 20 s; their stops are judged by the measured position.
hills: grades of up to 8 %, half of them in the map, prompt samples. gaps, losses: at `Tracker.blind_top_speed`.
"""

from __future__ import annotations

import argparse
import heapq
import logging
import math
import sys
import time
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.control.speed_control import SpeedState
from adaptrack.road import Road, SpeedPlan, Stop

KINDS = ("late", "hills", "gaps", "losses")
CARS = ("compact-ev", "midsize-sedan", "small-car", "sports-car", "van")
PERIOD, STEP = 0.05, 0.0125
"""s, of the loop and the longest of the car."""
PLACE_FIELDS = ("station", "p_station", "surprise", "scale")
"""Of the memory of the speed control."""
START = 0.5
"""s, time of the first call."""
CELL, RUN_OUT = 0.25, 150.0
"""m: spacing of the table of the road, and its straights before and after the road."""
GRAVITY, FRICTION = 9.81, 0.95
SETTLED = 20.0
"""s, after which the error of the speed counts."""
NEAR_STOP, WITHIN, SCALE_WITHIN, LEARNED_WAY = 8.0, 0.15, 0.02, 1000.0
"""m: distance within which a standing car stands at a stop; m, -: errors that are counted; m: way to learn the scale.
"""
CHANGE_FORCE = 0.02
"""Of the weight: a change is a crossing of the requested force from this share to its negative, or back."""
CORRELATION_TIME = 20.0
"""s, of the correlated noise."""
DELAYS = ((0.1, 0.45), (0.05, 0.25)), ((0.06, 0.25), (0.05, 0.2))
"""s, ranges of lag and dead time of drive and brakes."""
LOST = 4.0
"""m from the path, where a drive ends."""


# -- the car ----------------------------------------------------------------------------------------------------------
class Actuator:
    """A lag behind a dead time (s, s), with a gain and a largest rate."""

    def __init__(self, lag: float, dead_time: float, gain: float = 1.0, rate: float = math.inf) -> None:
        self.lag, self.dead_time, self.gain, self.rate = max(lag, 0.01), dead_time, gain, rate
        self.value, self._target = 0.0, 0.0
        self._pending: deque[tuple[float, float]] = deque()

    def send(self, t: float, request: float) -> None:
        """Take a request at a time (s)."""
        self._pending.append((t + self.dead_time - 1e-9, request))

    def step(self, t: float, h: float) -> float:
        """Return the output after a step h (s) from a time (s) on."""
        while self._pending and self._pending[0][0] <= t:
            self._target = self._pending.popleft()[1]
        change = (self._target * self.gain - self.value) * (1.0 - math.exp(-h / self.lag))
        self.value += max(min(change, self.rate * h), -self.rate * h)
        return self.value


class Line:
    """Table of a road: x, y (m), heading (rad), curvature (1/m) and the true grade, with a straight at both ends."""

    def __init__(self, road: Road, grade: Callable[[np.ndarray], np.ndarray]) -> None:
        s = np.arange(-RUN_OUT, road.length + RUN_OUT, CELL)
        place = road.at(np.clip(s, 0.0, road.length))
        beyond = s - np.clip(s, 0.0, road.length)
        self.x = (place.x + beyond * np.cos(place.heading)).tolist()
        self.y = (place.y + beyond * np.sin(place.heading)).tolist()
        self.heading = np.unwrap(place.heading).tolist()
        self.curvature = np.where(beyond == 0.0, place.curvature, 0.0).tolist()
        self.grade = grade(s).tolist()

    def pose(self, s: float, offset: float) -> tuple[float, float, float]:
        """Return x, y (m) and the heading of the road (rad) at an offset (m) from a station (m)."""
        place = (s + RUN_OUT) / CELL
        i = int(place)
        share = place - i
        heading = self.heading[i] + share * (self.heading[i + 1] - self.heading[i])
        x = self.x[i] + share * (self.x[i + 1] - self.x[i]) - offset * math.sin(heading)
        y = self.y[i] + share * (self.y[i + 1] - self.y[i]) + offset * math.cos(heading)
        return x, y, heading


class Plant:
    """A car on its line: station and offset (m), angle from the road (rad), forward speed (m/s)."""

    def __init__(self, car: at.Vehicle, line: Line, mass: float, actuators: Sequence[Actuator], bias: float) -> None:
        self.car, self.line, self.mass, self.bias = car, line, mass, bias
        self.drive, self.brakes, self.steering = actuators
        self.t = self.s = self.offset = self.angle = self.v = self.yaw_rate = 0.0
        self._air = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient
        self._rolling, self._rear = car.rolling_resistance * GRAVITY, car.lr

    def send(self, force: float, hold: float, wheel_angle: float) -> None:
        """Take the requests (N, N, rad) of a call."""
        self.drive.send(self.t, max(force, 0.0))
        self.brakes.send(self.t, max(-force, 0.0) + hold)
        self.steering.send(self.t, wheel_angle)

    def steps_to(self, until: float) -> Iterator[None]:
        """Advance to a time (s), in equal steps."""
        count = max(1, math.ceil((until - self.t) / STEP - 1e-6))
        h = (until - self.t) / count
        for _ in range(count):
            self._step(h)
            yield

    def _step(self, h: float) -> None:
        line, i = self.line, int((self.s + RUN_OUT) / CELL)
        drive, brakes = self.drive.step(self.t, h), self.brakes.step(self.t, h)
        wheels = self.steering.step(self.t, h) + self.bias
        push = (drive - self._air * self.v * abs(self.v)) / self.mass - GRAVITY * line.grade[i]
        resistance = min(brakes / self.mass, FRICTION * GRAVITY) + self._rolling
        speed = self.v
        if speed == 0.0:
            self.v = 0.0 if abs(push) <= resistance else h * (push - math.copysign(resistance, push))
        else:
            self.v = speed + h * (push - math.copysign(resistance, speed))
            if self.v * speed < 0.0 and abs(push) <= resistance:
                self.v = 0.0
        speed = 0.5 * (speed + self.v)
        self.yaw_rate = speed * math.tan(wheels) / self.car.wheelbase
        lateral = self._rear * self.yaw_rate
        cos, sin, curvature = math.cos(self.angle), math.sin(self.angle), line.curvature[i]
        rate = (speed * cos - lateral * sin) / (1.0 - curvature * self.offset)
        self.offset += h * (speed * sin + lateral * cos)
        self.angle += h * (self.yaw_rate - curvature * rate)
        self.s += h * rate
        self.t += h


# -- its sensors ------------------------------------------------------------------------------------------------------
class Sensors(NamedTuple):
    """Sensors of a drive, as its seed draws them."""

    pose_rate: int
    motion_rate: int
    """Hz"""
    has_one_message: bool
    """pose and motion have one time stamp"""
    age: float
    age_spread: float
    """s: mean age of a message at its arrival, and its largest less its smallest age"""
    noise: float
    """m, standard deviation of x and of y"""
    is_correlated: bool
    scale: float
    """-, true speed over the measured one"""
    stamp_error: float
    """s, of all time stamps"""
    loop_jitter: float
    """s, largest deviation of a call from its time"""

    @property
    def prompt(self) -> Sensors:
        """The sensors with a new sample at each call, without an age."""
        return self._replace(
            pose_rate=20, motion_rate=20, has_one_message=True, age=0.0, age_spread=0.0, stamp_error=0.0,
            loop_jitter=0.0,
        )  # fmt: skip

    @property
    def oldest(self) -> float:
        """s, largest age of a message that a call passes."""
        if self.age == 0.0:
            return 0.0
        slower = min(self.pose_rate, self.motion_rate)
        return self.age + 0.5 * self.age_spread + 1.0 / slower + self.loop_jitter


class Message(NamedTuple):
    """A measured pose (m, m, rad) or motion (m/s, rad/s), and the time (s) at which it was taken."""

    t: float
    values: tuple[float, ...]


class Stream:
    """A sensor that takes a message every period (s); messages arrive later, possibly in a different order."""

    def __init__(self, rate: int, sensors: Sensors, measure: Callable[[], tuple[float, ...]], rng: Any) -> None:
        self._period, self._measure, self._rng = 1.0 / rate, measure, rng
        self._ages = sensors.age - 0.5 * sensors.age_spread, sensors.age + 0.5 * sensors.age_spread
        self._due = float(rng.uniform(0.0, self._period))
        self._under_way: list[tuple[float, Message]] = []
        self.latest: Message | None = None

    def watch(self, t: float) -> None:
        """Take a message where one is due at a time (s)."""
        if t >= self._due:
            self._due += self._period
            heapq.heappush(self._under_way, (t + self._rng.uniform(*self._ages), Message(t, self._measure())))

    def receive(self, t: float) -> Message | None:
        """Return the message that arrived last."""
        while self._under_way and self._under_way[0][0] <= t:
            self.latest = heapq.heappop(self._under_way)[1]
        return self.latest


class Measurement:
    """Noisy measurements of a car."""

    def __init__(self, plant: Plant, sensors: Sensors, rng: Any) -> None:
        self._plant, self._sensors, self._rng = plant, sensors, rng
        self._wander, self._wandered = rng.standard_normal(2) * sensors.noise, 0.0

    def pose(self) -> tuple[float, ...]:
        """Return x, y (m) and yaw (rad)."""
        plant, rng, noise = self._plant, self._rng, self._sensors.noise
        x, y, heading = plant.line.pose(plant.s, plant.offset)
        if self._sensors.is_correlated:
            (bias_x, bias_y), noise = self._drift(), 0.02
            x, y = x + bias_x, y + bias_y
        first, second, third = rng.standard_normal(3).tolist()
        return x + noise * first, y + noise * second, heading + plant.angle + 0.003 * third

    def _drift(self) -> tuple[float, float]:
        decay = math.exp(-(self._plant.t - self._wandered) / CORRELATION_TIME)
        spread = self._sensors.noise * math.sqrt(1.0 - decay * decay)
        self._wander, self._wandered = decay * self._wander + spread * self._rng.standard_normal(2), self._plant.t
        return tuple(self._wander.tolist())

    def along(self) -> float:
        """Return the correlated error of the position along the road (m)."""
        if not self._sensors.is_correlated:
            return 0.0
        _, _, heading = self._plant.line.pose(self._plant.s, 0.0)
        return float(self._wander[0] * math.cos(heading) + self._wander[1] * math.sin(heading))

    def motion(self) -> tuple[float, ...]:
        """Return speed (m/s) and yaw rate (rad/s); a wheel that stands still has no noise."""
        v = self._plant.v
        noise = (0.02 + 0.005 * abs(v)) * min(abs(v) / 0.2, 1.0)
        first, second = self._rng.standard_normal(2).tolist()
        return v / self._sensors.scale + noise * first, self._plant.yaw_rate + 0.004 * second


# -- a drive ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Case:
    """A drive before it begins."""

    kind: str
    index: int
    seed: tuple[int, ...]
    car: at.Vehicle
    road: Road
    line: Line
    """the true road; the map of a hilly road may be flat"""
    sensors: Sensors
    mass: float
    delays: tuple[tuple[float, float, float], ...]
    """lag (s), dead time (s) and gain of drive and brakes"""
    top_speed: float
    stops: tuple[float, ...]
    friction: float | tuple[float, float] = 0.9
    has_map: bool = False
    """whether the controller knows the slope"""


def draw_sensors(kind: str, is_correlated: bool, rng: Any) -> Sensors:
    """Draw the sensors of a drive."""
    rates = (5, 10, 20)
    pose_rate = int(rng.choice(rates))
    has_one_message = bool(rng.random() < 0.5)
    motion_rate = pose_rate if has_one_message else int(rng.choice(rates))
    spread = float(rng.choice((0.0, 0.05, 0.1)))
    sensors = Sensors(
        pose_rate, motion_rate, has_one_message, 0.1 + (0.05 - 0.5 * spread) * float(rng.uniform(-1.0, 1.0)), spread,
        float(math.exp(rng.uniform(math.log(0.02), math.log(0.2)))), is_correlated, float(rng.uniform(0.93, 1.07)),
        float(rng.choice((0.0, 0.0, 0.05, -0.05))), float(rng.choice((0.0, 0.01, 0.02))),
    )  # fmt: skip
    if kind == "late":
        return sensors
    if kind == "hills":
        return sensors.prompt._replace(noise=0.03, scale=1.0)
    is_prompt = rng.random() < 0.5
    sensors = sensors._replace(noise=min(sensors.noise, 0.1), stamp_error=0.0, scale=1.0)
    return sensors.prompt if is_prompt else sensors._replace(pose_rate=20, motion_rate=20)


def draw_grade(kind: str, length: float, rng: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Draw the true grade (dz/ds) along a road: waves of hills, or one slope from about 250 m on."""
    if kind != "hills":
        slope, begin = float(rng.uniform(-0.04, 0.04)), float(rng.uniform(200.0, 300.0))
        return lambda s: slope * np.clip((s - begin) / 30.0, 0.0, 1.0)
    sizes, waves, phases = rng.uniform(0.01, 0.04, 2), rng.uniform(80.0, 400.0, 2), rng.uniform(0.0, math.tau, 2)

    def grade(s: np.ndarray) -> np.ndarray:
        hills = sum(size * np.sin(math.tau * s / wave + phase)
                    for size, wave, phase in zip(sizes, waves, phases, strict=True))  # fmt: skip
        return np.asarray(hills) * np.clip(s / 40.0, 0.0, 1.0) * np.clip((length - s) / 40.0, 0.0, 1.0)

    return grade


def draw_case(kind: str, seed: int, index: int, is_correlated: bool = False) -> Case:
    """Draw a drive."""
    seeds = (seed, KINDS.index(kind), index, int(is_correlated))
    rng = np.random.default_rng(seeds)
    car = at.load_vehicle(str(rng.choice(CARS)))
    road = at.generate_road("country", int(rng.integers(1_000_000)), length=1100.0)
    grade = draw_grade(kind, road.length, rng)
    delays = tuple(
        (rng.uniform(*lags), rng.uniform(*dead_times), rng.uniform(0.85, 1.1)) for lags, dead_times in DELAYS
    )
    stops = tuple(rng.uniform(-80.0, 80.0) + place for place in (350.0, 720.0))
    line = Line(road, grade)
    has_map = kind == "hills" and rng.random() < 0.5
    if has_map:
        places = np.arange(0.0, road.length, 5.0)
        road = road.replace(grade=(places.tolist(), grade(places).tolist()))
    friction: float | tuple[float, float] = 0.9
    if kind in ("gaps", "losses"):
        stops = (80.0,)
        friction = 0.9 if rng.random() < 0.5 else (0.65, 0.9)
    return Case(
        kind, index, seeds, car, road, line, draw_sensors(kind, is_correlated, rng), car.mass * rng.uniform(0.85, 1.4),
        delays, float(rng.uniform(7.0, 14.0)), stops, friction, has_map,
    )  # fmt: skip


class Row(NamedTuple):
    """A call of a drive: true motion, requests, and the place that the speed control assumes."""

    t: float
    s: float
    v: float
    offset: float
    along: float
    """m, correlated error of the measured position"""
    force: float
    acceleration: float
    state: str
    cause: str
    status: str
    estimate: float
    variance: float
    """m, m^2: station of the place filter"""
    nis: float
    """normalised innovation squared; NaN without an innovation"""
    scale: float
    pose_time: float
    """s, at which the latest position was taken; NaN: it is missing"""


class Drive:
    """A tracker that drives a case."""

    def __init__(self, case: Case, sensors: Sensors) -> None:
        self.case, self.sensors = case, sensors
        rng = np.random.default_rng((*case.seed, 1 + (sensors.age > 0.0)))
        steering = Actuator(0.15, 0.05, rate=0.5)
        drive, brakes = (Actuator(*delay) for delay in case.delays)
        self.plant = Plant(case.car, case.line, case.mass, (drive, brakes, steering), float(rng.uniform(-0.01, 0.01)))
        measurement = self._measurement = Measurement(self.plant, sensors, rng)
        self._streams = [Stream(sensors.motion_rate, sensors, measurement.motion, rng)]
        if sensors.has_one_message:
            self._streams = [
                Stream(sensors.pose_rate, sensors, lambda: (*measurement.pose(), *measurement.motion()), rng)
            ]
        else:
            self._streams.append(Stream(sensors.pose_rate, sensors, measurement.pose, rng))
        self._rng = rng
        self.plan = self.plan_to(case.top_speed, case.stops)
        profile = at.load_profile("road").replace(noise_y=sensors.noise, noise_station=sensors.noise)
        estimator = replace(at.KalmanFilter.from_profile(profile), oldest=sensors.oldest)
        controller = at.MPC(case.car, profile=profile, estimator=estimator, computation=0.0)
        control = at.SpeedControl(case.car, friction=case.friction)
        self.tracker = at.Tracker(controller, case.road, plan=self.plan, speed=control)
        self.tracker.engage(wheel_angle=0.0)
        self.rows: list[Row] = []
        self.suspects: tuple[str, ...] = ()
        self._now = START

    def plan_to(self, top_speed: float, stops: Sequence[float]) -> SpeedPlan:
        """Return a plan from standstill with these stops (m) and one at the end."""
        halts = [Stop(place, 2.0) for place in stops]
        return at.plan_speed(self.case.road, self.case.car, top_speed=top_speed, start=0.0, end=0.0, stops=halts)

    def call(self, has_position: bool = True) -> Row:
        """Advance to the next call, and make it."""
        now = self._now + float(self._rng.uniform(-1.0, 1.0)) * self.sensors.loop_jitter
        self._now += PERIOD
        for _ in self.plant.steps_to(now):
            for stream in self._streams:
                stream.watch(self.plant.t)
        pose, motion = self._messages(now)
        if not has_position:
            pose = Message(pose.t, (math.nan, math.nan, math.nan))
        shift = self.sensors.stamp_error
        out = self.tracker.step(
            pose.t + shift, *pose.values, *motion.values, now=now,
            motion_time=None if pose.t == motion.t else motion.t + shift,
        )  # fmt: skip
        request, (station, variance, surprise, scale) = out.longitudinal, self._place()
        self.plant.send(request.force, request.hold, out.command)
        self.suspects = out.suspect
        innovation = math.nan
        if self.plant.v > 0.5 and math.isfinite(self.tracker._speed.record.sample[0].station):
            innovation = surprise
        plant = self.plant
        row = Row(
            now, plant.s, plant.v, plant.offset, self._measurement.along(), request.force, request.acceleration,
            str(request.state), str(request.limited_by), str(out.status), station, variance, innovation, scale,
            pose.t if has_position else math.nan,
        )  # fmt: skip
        self.rows.append(row)
        return row

    def _place(self) -> tuple[float, ...]:
        """Return station (m), its variance (m^2), its normalised innovation squared, and the scale of the speed."""
        memory = self.tracker._speed.record.memory
        numbers = memory.item()
        return tuple(numbers[memory.dtype.names.index(name)] for name in PLACE_FIELDS)

    def _messages(self, now: float) -> tuple[Message, Message]:
        """Return the latest pose and motion."""
        if self.sensors.age == 0.0:
            return Message(now, self._measurement.pose()), Message(now, self._measurement.motion())
        messages = [stream.receive(now) for stream in self._streams]
        nothing = Message(now, (math.nan,) * 5)
        if self.sensors.has_one_message:
            t, values = messages[0] or nothing
            return Message(t, values[:3]), Message(t, values[3:])
        motion, pose = (message or nothing for message in messages)
        return Message(pose.t, pose.values[:3]), Message(motion.t, motion.values[:2])

    def is_over(self) -> bool:
        """Whether the car has left its path, passed its end, or stood for too long."""
        road, rows = self.case.road, self.rows
        row = rows[-1]
        if abs(row.offset) > LOST or row.s > road.length + 20.0 or row.s < -20.0:
            return True
        count = 50 if row.s > road.length - NEAR_STOP else 200
        return len(rows) > 2 * count and all(back.v == 0.0 for back in rows[-count::10])


class Figures(NamedTuple):
    """Figures of a drive."""

    stops: list[float]
    """m beyond each stop; inf: the car passed it, -inf: it did not come there"""
    speed_error: float
    measured_speed_error: float
    """m/s, RMS, of the true speed, and of the speed as its sensor would show it without noise"""
    scale_error: float
    """-, after `LEARNED_WAY`; NaN: it did not drive so far"""
    nis: float
    nees: float
    """mean normalised squares of the innovation and of the true error of the place"""
    busy_seconds: float
    """share of the seconds with more than one change between throttle and brake"""
    jerk: float
    """m/s^3, RMS of the requested force over the mass"""
    states: frozenset[str]
    causes: frozenset[str]
    largest_offset: float
    suspects: tuple[str, ...]


def count_changes(t: np.ndarray, force: np.ndarray, weight: float) -> np.ndarray:
    """Return how many changes between throttle and brake each second has."""
    side = np.where(force > CHANGE_FORCE * weight, 1, np.where(force < -CHANGE_FORCE * weight, -1, 0))
    acting = np.flatnonzero(side)
    changes = acting[1:][side[acting[1:]] != side[acting[:-1]]]
    return np.bincount((t[changes] - t[0]).astype(int), minlength=int(t[-1] - t[0]) + 1)


def stop_errors(drive: Drive) -> list[float]:
    """Return how far beyond each stop (m) the car stood; inf where it passed, -inf where it did not come there."""
    rows, case = drive.rows, drive.case
    s, v = np.array([row.s + row.along for row in rows]), np.array([row.v for row in rows])
    errors = []
    for place in (*case.stops, case.road.length):
        stands = np.flatnonzero((np.abs(v) < 0.005) & (np.abs(s - place) < NEAR_STOP))
        if stands.size:
            breaks = np.flatnonzero(np.diff(stands) > 1)
            errors.append(float(s[stands[breaks[-1] + 1 if breaks.size else 0]] - place))
        else:
            errors.append(math.inf if s.max() > place else -math.inf)
    return errors


def figures_of(drive: Drive) -> Figures:
    """Return the figures of a complete drive."""
    rows, case = drive.rows, drive.case
    t, s, v, force = (np.array([getattr(row, name) for row in rows]) for name in ("t", "s", "v", "force"))
    planned = drive.plan.at(np.clip(s, 0.0, case.road.length))
    counted = (t > SETTLED) & (planned > 1.0)
    scale = drive.sensors.scale
    far = np.flatnonzero(s - s[0] > LEARNED_WAY)
    moving = [row for row in rows if row.v > 0.5 and row.variance > 0.0]
    nis = np.array([row.nis for row in moving])
    nees = np.array([(row.estimate - row.s - row.along) ** 2 / row.variance for row in moving])
    changes = count_changes(t, force, case.car.mass * GRAVITY)
    return Figures(
        stop_errors(drive),
        float(np.sqrt(np.mean((v - planned)[counted] ** 2))),
        float(np.sqrt(np.mean((v / scale - planned)[counted] ** 2))),
        abs(rows[far[0]].scale - (scale - 1.0)) if far.size else math.nan,
        float(np.nanmean(nis)) if np.isfinite(nis).any() else math.nan, float(np.mean(nees)) if moving else math.nan,
        float(np.mean(changes > 1)), float(np.sqrt(np.mean((np.diff(force) / np.diff(t) / case.car.mass) ** 2))),
        frozenset(row.state for row in rows), frozenset(row.cause for row in rows),
        max(abs(row.offset) for row in rows), drive.suspects,
    )  # fmt: skip


def drive_whole(case: Case, sensors: Sensors) -> Figures:
    """Drive a case to its end."""
    drive = Drive(case, sensors)
    drive.call()
    while not drive.is_over():
        drive.call()
    return figures_of(drive)


class Pair(NamedTuple):
    """A case with its figures, and those of the same drive with prompt samples."""

    case: Case
    figures: Figures
    prompt: Figures


def drive_pair(kind: str, seed: int, numbered: tuple[int, bool]) -> Pair:
    """Draw and drive a case."""
    case = draw_case(kind, seed, *numbered)
    figures = drive_whole(case, case.sensors)
    return Pair(case, figures, drive_whole(case, case.sensors.prompt) if kind == "late" else figures)


# -- missing positions ------------------------------------------------------------------------------------------------
class Gap(NamedTuple):
    """A gap of the position, with the requests of the speed control until 1 s after it."""

    seconds: float
    speed: float
    braking: float
    """m/s^2, largest requested deceleration"""
    comfort: float
    """m/s^2, of the plan"""
    states: frozenset[str]


class Loss(NamedTuple):
    """A position that is lost for good."""

    index: int
    speed: float
    stood: float
    """s, from the last position to standstill; infinity: never"""
    held: float
    """s, from the last position to the end of the estimate of the steering"""
    way: float
    """m, since the last position"""
    largest_offset: float
    states: frozenset[str]


def begin_at_blind_top_speed(case: Case) -> tuple[Drive, float] | None:
    """Drive to the first stop, and set off for the speed at which a position may be lost; None: it did not stop."""
    drive = Drive(case, case.sensors)
    while drive.call().state != SpeedState.STOPPED:
        if drive.is_over():
            return None
    for _ in range(20):
        drive.call()
    top_speed = drive.tracker.blind_top_speed
    drive.plan = drive.plan_to(top_speed, ())
    drive.tracker.follow(case.road, drive.plan)
    while drive.call().v < 0.95 * top_speed and drive.plant.s < case.road.length - 150.0 and not drive.is_over():
        pass
    return drive, top_speed


def drive_gaps(kind: str, seed: int, numbered: tuple[int, bool]) -> list[Gap]:
    """Drive a case with a gap every 5 s."""
    case = draw_case(kind, seed, *numbered)
    begun = begin_at_blind_top_speed(case)
    gaps: list[Gap] = []
    if begun is None:
        return gaps
    drive, _ = begun
    rng = np.random.default_rng((*case.seed, 9))
    while drive.plant.s < case.road.length - 150.0 and not drive.is_over():
        seconds, speed = float(rng.uniform(0.3, 1.0)), drive.plant.v
        rows = [drive.call(has_position=False) for _ in range(round(seconds / PERIOD))]
        rows += [drive.call() for _ in range(20)]
        gaps.append(
            Gap(
                seconds, speed, max(-row.acceleration for row in rows), drive.plan.comfort.brake,
                frozenset(row.state for row in rows),
            )
        )  # fmt: skip
        for _ in range(80):
            drive.call()
    return gaps


def drive_loss(kind: str, seed: int, numbered: tuple[int, bool]) -> Loss | None:
    """Drive a case until its position is lost for good, and on until the car stands."""
    case = draw_case(kind, seed, *numbered)
    begun = begin_at_blind_top_speed(case)
    if begun is None:
        return None
    drive, top_speed = begun
    count = int(np.random.default_rng((*case.seed, 9)).integers(0, 100))
    while count > 0 or drive.plant.v < 0.95 * top_speed:
        count -= 1
        if drive.call().s > case.road.length - 100.0:
            return None
    last = drive.rows[-1]
    rows = [drive.call(has_position=False) for _ in range(200)]
    stands = [row.t for row in rows if row.v == 0.0]
    held = [row.t for row in rows if row.status == "held"]
    moving = [row for row in rows if row.v > 0.0]
    return Loss(
        case.index, last.v, min(stands, default=math.inf) - last.pose_time,
        min(held, default=math.inf) - last.pose_time, moving[-1].s - last.s, max(abs(row.offset) for row in rows),
        frozenset(row.state for row in rows),
    )  # fmt: skip


# -- tables -----------------------------------------------------------------------------------------------------------
def share(condition: np.ndarray) -> str:
    """Return how often a condition holds (%)."""
    return f"{100.0 * np.mean(condition):.1f} %" if condition.size else "-"


def largest(errors: np.ndarray) -> float:
    """Return the largest finite error; 0 where none is above 0."""
    return float(max((error for error in errors.tolist() if math.isfinite(error)), default=0.0))


def values(drives: Sequence[Figures], name: str) -> np.ndarray:
    """Return a figure of all drives where it is finite, at least one NaN; of the stops all."""
    if name == "stops":
        return np.array([error for drive in drives for error in drive.stops])
    numbers = np.array([getattr(drive, name) for drive in drives])
    finite = numbers[np.isfinite(numbers)]
    return finite if finite.size else np.full(1, math.nan)


def print_stops(title: str, drives: Sequence[Figures]) -> None:
    """Print how near the car stood to its stops."""
    errors = values(drives, "stops")
    sizes = np.abs(errors)
    print(f"{title}: {errors.size} stops; beyond by at most {WITHIN} m {share(errors <= WITHIN)}, by at most 0.25 m "
          f"{share(errors <= 0.25)}, largest {largest(errors):.2f} m; short by at most {WITHIN} m "
          f"{share(errors >= -WITHIN)}, by at most 0.35 m {share(errors >= -0.35)}, largest {largest(-errors):.2f} m; "
          f"median {np.median(errors):+.3f} m, 90 % {np.quantile(sizes, 0.9, method='higher'):.3f} m; passed "
          f"{np.sum(errors == math.inf)}, not reached {np.sum(errors == -math.inf)}")  # fmt: skip


def speed_ratios(pairs: Sequence[Pair]) -> np.ndarray:
    """RMS errors of the speed over those with prompt samples, as the sensor shows the speed, of complete drives."""
    return np.array([
        pair.figures.measured_speed_error / pair.prompt.measured_speed_error
        for pair in pairs if math.isfinite(pair.figures.stops[-1])
    ])  # fmt: skip


def print_speed(pairs: Sequence[Pair]) -> None:
    """Print the errors of the speed, and of the place filter."""
    complete, ratios = [pair for pair in pairs if math.isfinite(pair.figures.stops[-1])], speed_ratios(pairs)
    for title, name in (("as measured", "measured_speed_error"), ("true", "speed_error")):
        late, prompt = (values([getattr(pair, part) for pair in complete], name) for part in ("figures", "prompt"))
        print(
            f"speed RMS, {title} (m/s): mean {late.mean():.3f}, largest {late.max():.3f}; with prompt samples "
            f"{prompt.mean():.3f}, {prompt.max():.3f}; ratio of the means {late.mean() / prompt.mean():.2f}"
        )
    print(f"speed RMS over that of the same drive with prompt samples, {ratios.size} complete drives: median "
          f"{np.median(ratios):.2f}, 90 % {np.quantile(ratios, 0.9):.2f}, largest {ratios.max():.2f}, at most 1.2 in "
          f"{share(ratios <= 1.2)}")  # fmt: skip
    for title, part in (("late", "figures"), ("prompt", "prompt")):
        drives = [getattr(pair, part) for pair in pairs]
        scales, nis, nees = (values(drives, name) for name in ("scale_error", "nis", "nees"))
        print(f"place filter, {title}: error of the scale after 1 km median {np.median(scales):.3f}, 90 % "
              f"{np.quantile(scales, 0.9):.3f}, largest {scales.max():.3f}, within {SCALE_WITHIN} in "
              f"{share(scales <= SCALE_WITHIN)} of {scales.size}; NIS of a drive median {np.median(nis):.2f}, 0.5 to 2 "
              f"in {share((nis >= 0.5) & (nis <= 2.0))}; true error squared over its variance median "
              f"{np.median(nees):.1f}, 0.5 to 2 in {share((nees >= 0.5) & (nees <= 2.0))}")  # fmt: skip


def print_calm(title: str, drives: Sequence[Figures]) -> None:
    """Print how often throttle and brake take turns."""
    busy, jerk, speed = (values(drives, name) for name in ("busy_seconds", "jerk", "measured_speed_error"))
    errors = np.abs(values(drives, "stops"))
    print(f"{title}: seconds with more than one change {100 * busy.mean():.2f} %, worst drive {100 * busy.max():.1f} %;"
          f" RMS jerk of the request {np.sqrt(np.mean(jerk**2)):.2f} m/s^3; speed RMS {speed.mean():.3f} m/s; 90 % "
          f"stop error {np.quantile(errors, 0.9, method='higher'):.3f} m")  # fmt: skip


def print_reports(drives: Sequence[Figures]) -> None:
    """Print suspects, emergencies, faults and drives that left the path."""
    suspects = Counter(sentence for drive in drives for sentence in {" ".join(s.split()[:5]) for s in drive.suspects})
    faults = Counter(cause for drive in drives for cause in drive.causes if "fault" in cause)
    print(f"suspects in {sum(bool(drive.suspects) for drive in drives)} of {len(drives)} drives: {dict(suspects)}; "
          f"emergency in {sum('emergency' in drive.states for drive in drives)}; faults {dict(faults)}; farther than "
          f"{LOST} m from the path {sum(drive.largest_offset > LOST for drive in drives)}")  # fmt: skip


FACTORS: dict[str, Callable[[Case], str]] = {
    "pose Hz, motion Hz": lambda case: f"{case.sensors.pose_rate}, {case.sensors.motion_rate}",
    "messages": lambda case: "one" if case.sensors.has_one_message else "two",
    "mean age (s)": lambda case: "to 0.1" if case.sensors.age <= 0.1 else "above 0.1",
    "age spread (s)": lambda case: f"{case.sensors.age_spread:g}",
    "noise (m)": lambda case: next(f"to {top}" for top in (0.05, 0.1, 0.2001) if case.sensors.noise <= top),
    "scale": lambda case: next(f"off by {top}" for top in (0.02, 0.05, 0.0701) if abs(case.sensors.scale - 1) <= top),
    "stamp error (s)": lambda case: f"{case.sensors.stamp_error:+g}",
    "loop jitter (s)": lambda case: f"{case.sensors.loop_jitter:g}",
    "car": lambda case: case.car.name,
}
"""Factors by which the table groups the drives."""


def print_factors(pairs: Sequence[Pair]) -> None:
    """Print the figures by factor."""
    print("| factor | value | drives | beyond at most 0.15 m | largest | short at most 0.15 m | largest | speed ratio "
          "| scale within 0.02 | NIS | suspects |\n" + "|---" * 11 + "|")  # fmt: skip
    for factor, value_of in FACTORS.items():
        for value in sorted({value_of(pair.case) for pair in pairs}):
            group = [pair for pair in pairs if value_of(pair.case) == value]
            drives = [pair.figures for pair in group]
            errors, scales, nis = (values(drives, name) for name in ("stops", "scale_error", "nis"))
            print(f"| {factor} | {value} | {len(group)} | {share(errors <= WITHIN)} | {largest(errors):.2f} | "
                  f"{share(errors >= -WITHIN)} | {largest(-errors):.2f} | {np.median(speed_ratios(group)):.2f} | "
                  f"{share(scales <= SCALE_WITHIN)} | {np.median(nis):.2f} | "
                  f"{sum(bool(drive.suspects) for drive in drives)} |")  # fmt: skip


def print_worst(pairs: Sequence[Pair]) -> None:
    """Print the drives with the largest errors of a stop."""

    def size(pair: Pair) -> float:
        return max(abs(error) for error in pair.figures.stops)

    for pair in sorted(pairs, key=size, reverse=True)[:6]:
        print(f"drive {pair.case.index}{', correlated' if pair.case.sensors.is_correlated else ''}: stops "
              f"{np.round(pair.figures.stops, 2).tolist()}, prompt {np.round(pair.prompt.stops, 2).tolist()}; "
              f"{pair.case.sensors}")  # fmt: skip


def print_late(pairs: Sequence[Pair]) -> None:
    """Print the figures of late samples."""
    white = [pair for pair in pairs if not pair.case.sensors.is_correlated]
    correlated = [pair for pair in pairs if pair.case.sensors.is_correlated]
    for title, group in (("white noise", white), ("noise correlated over 20 s, by the measured position", correlated)):
        if not group:
            continue
        drives, prompt = [pair.figures for pair in group], [pair.prompt for pair in group]
        print(f"\n{title}, {len(group)} drives")
        print_stops("late", drives)
        print_stops("prompt", prompt)
        print_speed(group)
        print_calm("throttle and brake, late", drives)
        print_calm("throttle and brake, prompt", prompt)
        print_reports(drives)
    print()
    print_factors(white)
    print()
    print_worst(pairs)


def print_hills(pairs: Sequence[Pair]) -> None:
    """Print the figures of hilly roads."""
    for title, has_map in (("hills in the map", True), ("hills on a flat map", False)):
        drives = [pair.figures for pair in pairs if pair.case.has_map is has_map]
        if drives:
            print(f"\n{title}, {len(drives)} drives")
            print_stops("stops", drives)
            print_calm("throttle and brake", drives)
            print_reports(drives)


def print_gaps(drives: Sequence[list[Gap]]) -> None:
    """Print the requests of the speed control in gaps."""
    gaps = [gap for drive in drives for gap in drive]
    excess = np.array([gap.braking - gap.comfort for gap in gaps])
    emergency = np.array(["emergency" in gap.states for gap in gaps])
    seconds, speeds = np.array([gap.seconds for gap in gaps]), np.array([gap.speed for gap in gaps])
    print(f"\n{len(gaps)} gaps at {speeds.min():.1f} to {speeds.max():.1f} m/s")
    for low, high in ((0.3, 0.5), (0.5, 0.75), (0.75, 1.01)):
        group = (seconds >= low) & (seconds < high)
        print(f"gaps of {low} to {high:.3g} s: {group.sum()}; emergency in {share(emergency[group])}; braking beyond "
              f"that of the plan (m/s^2) median {np.median(excess[group]):+.2f}, largest {excess[group].max():+.2f}, "
              f"by more than 0.6 in {share(excess[group] > 0.6)}")  # fmt: skip


def print_losses(results: Sequence[Loss | None]) -> None:
    """Print whether cars without a position stand before the steering loses its estimate."""
    losses = [loss for loss in results if loss is not None]
    stood, held, offsets, speeds = (np.array([getattr(loss, name) for loss in losses]) for name in
                                    ("stood", "held", "largest_offset", "speed"))  # fmt: skip
    print(f"\n{len(losses)} losses at {speeds.min():.1f} to {speeds.max():.1f} m/s ({len(results) - len(losses)} "
          f"drives did not reach the speed); standstill after median {np.median(stood):.2f} s, 99 % "
          f"{np.quantile(stood, 0.99):.2f} s, latest {stood.max():.2f} s; the steering held from {held.min():.2f} s "
          f"on, later than that stood {np.sum(stood > held)} cars; offset median {np.median(offsets):.2f} m, 99 % "
          f"{np.quantile(offsets, 0.99):.2f} m, largest {offsets.max():.2f} m")  # fmt: skip
    for loss in sorted(losses, key=lambda loss: loss.held - loss.stood)[:6]:
        print(loss)


RUNS: dict[str, tuple[Callable[..., Any], Callable[[Any], None]]] = {
    "late": (drive_pair, print_late), "hills": (drive_pair, print_hills), "gaps": (drive_gaps, print_gaps),
    "losses": (drive_loss, print_losses),
}  # fmt: skip


def run_all(function: Callable[[tuple[int, bool]], Any], numbers: Sequence[tuple[int, bool]], jobs: int) -> list[Any]:
    """Return a result for each number, in their order; print how far the work is, and the time that is left."""
    begin, results = time.monotonic(), []
    with ProcessPoolExecutor(jobs, initializer=logging.disable) as pool:
        for result in pool.map(function, numbers):
            results.append(result)
            left = (time.monotonic() - begin) / len(results) * (len(numbers) - len(results))
            print(f"\r{len(results)} of {len(numbers)} drives, {left:.0f} s left ", end="", file=sys.stderr)
    print(file=sys.stderr)
    return results


def main() -> None:
    """Drive the cars and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=KINDS)
    parser.add_argument("--drives", type=int, default=300)
    parser.add_argument("--correlated", type=int, help="further drives with correlated noise; default: a fifth (late)")
    parser.add_argument("--first", type=int, default=0, help="number of the first drive")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1)
    arguments = parser.parse_args()
    correlated = arguments.correlated
    if correlated is None:
        correlated = arguments.drives // 5 if arguments.kind == "late" else 0
    numbers = [(arguments.first + i, False) for i in range(arguments.drives)]
    numbers += [(arguments.first + i, True) for i in range(correlated)]
    drive, print_results = RUNS[arguments.kind]
    results = run_all(partial(drive, arguments.kind, arguments.seed), numbers, arguments.jobs)
    print(f"{arguments.kind}: drives {arguments.first} to {arguments.first + arguments.drives - 1} of seed "
          f"{arguments.seed}, {correlated} with correlated noise")  # fmt: skip
    print_results(results)


if __name__ == "__main__":
    main()
