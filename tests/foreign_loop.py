"""A loop that is not ours: the bicycle of the example, 20 Hz at best, its samples spoilt by sensors and networks."""

from __future__ import annotations

import importlib.util
import math
import sys
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from adaptrack.road import road_through
from adaptrack.road.road_ahead import foot_near

DT = 0.002
"""s, step of the bicycle."""
NOISE = (0.02, 0.02, 0.002, 0.0, 0.005)
"""Standard deviations of x, y (m), yaw (rad), speed and yaw rate (rad/s)."""


def example(name):
    """A file of examples/ as a module."""
    path = Path(__file__).resolve().parent.parent / "examples" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(f"example_{name}", path)
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up
    spec.loader.exec_module(module)
    return module


Bicycle = example("plain_simulator").Bicycle


def steady_turn(curvature, speed):
    """(v_y, yaw rate, wheel angle) of the bicycle on a circle: Rajamani, Vehicle Dynamics and Control, section 3.3."""
    car = Bicycle()
    length, r = car.lf + car.lr, speed * curvature
    pull = car.mass * speed * r / length
    drift = car.lr * r - pull * car.lf * speed / car.rear
    return drift, r, (drift + car.lf * r) / speed + pull * car.lr / car.front


def on_road(road, s=0.0, speed=15.0, offset=0.0):
    """The bicycle at a place of a road, in the steady turn there."""
    place = road.at(s)
    drift, rate, angle = steady_turn(float(place.curvature), speed) if speed > 2.0 else (0.0, 0.0, 0.0)
    yaw = float(place.heading) - (drift / speed if speed > 2.0 else 0.0)
    x, y = float(place.x) - offset * math.sin(yaw), float(place.y) + offset * math.cos(yaw)
    return Bicycle(x=x, y=y, yaw=yaw, speed=speed, vy=drift, yaw_rate=rate, angle=angle)


def window(road, s):
    """What a planner publishes at s: points a metre apart, from 10 m behind the car to 80 m ahead."""
    points = road.at(s - 10.0 + np.arange(91.0))
    return road_through(np.stack([points.x, points.y], axis=-1))


@dataclass
class Channel:
    """When the loop calls, and which sample arrives then."""

    jitter: tuple[float, float] | None = None  # s, range of the interval between calls
    period: float = 0.05  # s, otherwise
    missing: int = 0  # every so many calls do not happen
    late: float = 0.0  # s
    reorder: float = 0.0  # s, the lateness varies by +- that, so that samples overtake each other
    prompt_motion: bool = False  # speed and yaw rate come at once, the pose alone is late
    repeat: int = 0  # at every so many calls the sample before comes again
    wrapped: bool = False
    noise: tuple[float, ...] = NOISE
    speed: object = None  # t -> m/s
    seed: int = 1
    samples: list = field(default_factory=list)

    def __post_init__(self):
        self.rng = np.random.default_rng(self.seed)

    def interval(self):
        return self.rng.uniform(*self.jitter) if self.jitter else self.period

    def arriving(self, t, car, count):
        """The sample that is there now, None: no call."""
        own = np.array([car.x, car.y, car.yaw, car.speed, car.yaw_rate]) + self.noise * self.rng.normal(size=5)
        if self.wrapped:
            own[2] = math.remainder(own[2], 2.0 * math.pi)
        self.samples.append((t, *map(float, own)))
        late = self.late + self.reorder * self.rng.uniform(-1.0, 1.0)
        there = [each for each in self.samples[-12:] if each[0] <= t - late + 1e-9]
        if self.missing and count % self.missing == 0:
            return None
        if not there:
            return (math.nan,) * 4 + (car.speed, math.nan)
        is_repeated = self.repeat and count % self.repeat == 0 and len(there) > 1
        arrived = there[-2 if is_repeated else -1]
        return (*arrived[:4], *self.samples[-1][4:]) if self.prompt_motion else arrived


@dataclass
class Driven:
    """What a drive leaves."""

    offset: np.ndarray  # m, true, at 50 Hz
    calls: list  # (t, what the tracker gave)
    places: np.ndarray  # (n, 3) t, x, y at 50 Hz

    @property
    def rms(self):
        return float(np.sqrt(np.mean(self.offset[50:] ** 2)))

    @property
    def commands(self):
        return np.array([told.command for _, told in self.calls])

    @property
    def statuses(self):
        return Counter(told.status.value for _, told in self.calls)


def drive(tracker, road, seconds=30.0, car=None, before_call=None, wheel_angle=None, **channel):
    """Drive with a tracker; before_call(t, car, tracker) may do something with it first."""
    car, line = car or on_road(road), Channel(**channel)
    offset, calls, places, command, near, due, count = [], [], [], car.angle, None, 0.0, 0
    for k in range(round(seconds / DT)):
        t = k * DT
        if line.speed is not None:
            car.speed = line.speed(t)
        if t >= due - 1e-9:
            due, count = due + line.interval(), count + 1
            if before_call is not None:
                before_call(t, car, tracker)
            sample = line.arriving(t, car, count)
            if sample is not None:
                times = {"now": t, "motion_time": t} if line.prompt_motion else {"now": t}
                result = tracker.step(*sample, wheel_angle=wheel_angle if count == 1 else None, **times)
                calls.append((t, result))
                command = calls[-1][1].command
        car.step(command, DT)
        if k % 10 == 0:
            foot = road.project(car.x, car.y) if near is None else foot_near(road, car.x, car.y, near)
            near = float(foot.s)
            offset.append(float(foot.offset))
            places.append((t + DT, car.x, car.y))
    return Driven(np.array(offset), calls, np.array(places))
