"""A drive along the trajectories of a planner, by an exported tracker and by Python's: replans, silence, clocks."""

import dataclasses
import math
import struct

import numpy as np

import adaptrack as at
from adaptrack.control.following import DRIVERS, VERDICTS, Following
from adaptrack.control.speed_control import SpeedLimit, SpeedState
from adaptrack.control.tracker import Status
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.road import Comfort
from adaptrack.road.planned_trajectory import PlannedTrajectory

CAR = at.load_vehicle("midsize-sedan")
ALONG = np.arange(0.0, 600.0, 5.0)
PATH_POINTS = np.stack([ALONG, 32.0 * (1.0 - np.cos(ALONG / 45.0))], axis=-1)
PATH = at.road_through(PATH_POINTS)
PERIOD, SPEED = 0.05, 10.0
FOLLOWING = Following(comfort=Comfort(brake=2.5))
CONTROLS = {"steering": None, "speed": at.SpeedControl(CAR, (0.5, 0.9))}


def cut(station, time, *, stamp=None, aside=0.0, noise=None, speeds=None, urgent=False):
    """What a planner sends: the path from a station (m) on; speeds: (n,) m/s every 0.1 s."""
    speeds = np.full(40, SPEED) if speeds is None else speeds
    t = 0.1 * np.arange(speeds.size)
    s = station + np.concatenate([[0.0], np.cumsum(0.05 * (speeds[1:] + speeds[:-1]))])
    place = PATH.at(s)
    x, y = place.x - aside * np.sin(place.heading), place.y + aside * np.cos(place.heading)
    if noise is not None:
        x, y = x + 0.05 * noise.normal(size=t.size), y + 0.05 * noise.normal(size=t.size)
    stamp = time if stamp is None else stamp
    return PlannedTrajectory(t, x, y, speed=speeds, stamp=stamp, urgent=urgent)


def braking(speed, deceleration=3.0):
    """Speeds (m/s) down to a rest, every 0.1 s."""
    return np.append(np.arange(speed, 0.0, -0.1 * deceleration), 0.0)


def halting(k):
    """Speeds (m/s) with two seconds at rest that come nearer with each call."""
    t = 0.1 * np.arange(60) + 0.05 * k
    return np.interp(t, [0.0, 2.0, 5.0, 7.0, 9.0], [SPEED, SPEED, 0.0, 0.0, 6.0])


def sent(k, station, rng):
    """Trajectory and fallback of a call of the long drive; None: silence."""
    time, fallback = PERIOD * k, None
    if k % 2 or 130 <= k < 137 or 180 <= k < 216 or 340 <= k < 400:
        return None, None
    if k < 280:
        fallback = cut(station - 0.3, time, speeds=braking(SPEED))
    if k % 50 == 6:
        return PlannedTrajectory([], [], []), None
    if k % 50 == 8:  # the planner of 0.4 s ago, and one of 3 s ago
        return cut(station - 4.0, time, stamp=time - (0.4 if k % 100 == 8 else 3.0)), fallback
    if k % 50 == 10:
        return cut(station, time, stamp=time + 0.5), fallback
    late = 0.02 * rng.random()
    if 240 <= k < 300:
        late -= 1000.0  # another clock
    if k >= 420:
        return cut(station, time, stamp=time - late, speeds=halting(k - 420)), fallback
    aside = 0.15 if k % 4 else -0.15  # two planners in turn
    noise = rng if k < 80 else None
    return cut(station - 10.0 * late * (late > 0), time, stamp=time - late, aside=aside * (k < 100),
               noise=noise, urgent=k == 100), fallback  # fmt: skip


class Car:
    """A car without slip that follows commands and requests."""

    def __init__(self):
        self.x, self.y, self.yaw, self.speed, self.turn = 1.0, 0.2, 0.0, SPEED, 0.0

    def move(self, command, force, target):
        if force is None:
            change = max(target, 0.0) - self.speed if math.isfinite(target) else -0.15
            self.speed = max(self.speed + min(max(change, -0.15), 0.1), 0.0)
        else:
            self.speed = max(self.speed + PERIOD * force / CAR.mass, 0.0)
        self.turn = self.speed * math.tan(command) / CAR.wheelbase
        self.x += PERIOD * self.speed * math.cos(self.yaw)
        self.y += PERIOD * self.speed * math.sin(self.yaw)
        self.yaw += PERIOD * self.turn


def python_row(answer):
    """An answer of Python as C has it, by the names of the members."""
    row = {"command": answer.command, "status": float(list(Status).index(answer.status)), "offset": answer.offset,
           "heading_error": answer.heading_error, "station": answer.station, "late": answer.late,
           "driven_by": float(DRIVERS.index(answer.driven_by))}  # fmt: skip
    if answer.longitudinal is None:
        return row | {"target_speed": answer.target_speed}
    requests = answer.longitudinal._asdict() | {
        "state": float(list(SpeedState).index(answer.longitudinal.state)),
        "limited_by": float(list(SpeedLimit).index(answer.longitudinal.limited_by)),
    }
    names = {"speed_state": "state"}
    return row | {name: requests[names.get(name, name)] for name in SPEED_REQUEST._fields}


def differs(answer, row):
    return [
        name for name, value in row.items()
        if (number := float(getattr(answer, name))) == number or value == value
        if struct.pack("d", number) != struct.pack("d", value)
    ]  # fmt: skip


def drive(call, twin, calls, seed=1):
    """Drive a car along `sent`; answers of an exported tracker that differ from Python's, verdicts and drivers.

    call(time, trajectory, fallback, pose, speed, turn): follow a trajectory unless it is None, then step; the answer by
    names, and the number of the verdict. twin: the tracker in Python. The car follows the commands of the former.
    """
    car, rng = Car(), np.random.default_rng(seed)
    differences, verdicts, drivers, station, before = [], [], [], 0.0, None
    for k in range(calls):
        time = PERIOD * k
        trajectory, fallback = sent(k, station, rng)
        if k % 50 == 14 and trajectory is not None:  # the one before, with a new stamp
            trajectory = dataclasses.replace(before, stamp=before.stamp + 0.1)
        noise = 0.03 * rng.normal(size=2)
        pose = (car.x + noise[0], car.y + noise[1], car.yaw) if rng.random() > 0.05 else (math.nan,) * 3
        answer, verdict = call(time, trajectory, fallback, pose, car.speed, car.turn)
        if trajectory is not None:
            before, expected = trajectory, twin.follow(trajectory, now=time, fallback=fallback)
            verdicts.append(VERDICTS[int(verdict)])
            differences += [(k, expected, verdicts[-1])] if verdicts[-1] is not expected else []
        row = python_row(twin.step(time, *pose, car.speed, car.turn, now=time))
        differences += [(k, names) for names in [differs(answer, row)] if names]
        drivers.append(DRIVERS[int(answer.driven_by)])
        has_speed = hasattr(answer, "force")
        car.move(answer.command, answer.force - answer.hold if has_speed else None, answer.target_speed)
        station = float(PATH.project(car.x, car.y, near=station + PERIOD * car.speed).s)
    return differences, verdicts, drivers
