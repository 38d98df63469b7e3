"""Calls of a tracker as they come from a car: late, lost, doubled, broken."""

import math

import numpy as np

from adaptrack.control.tracker import Status


def called_back(controller):
    """A compiled controller as one in Python, which the kernels of a tracker call back."""
    kind = type(controller)
    controller.__class__ = type(kind.__name__, (kind,), {"own_part": None})
    return controller


def calls(rng, count, path):
    """A car that weaves along a path, its samples noisy, late, lost, doubled, broken; clock and position jump."""
    s, t, speed = 2.0, 0.0, 12.0
    for k in range(count):
        t += rng.choice([0.05, 0.05, 0.05, 0.02, 0.1, 0.2])
        speed = float(np.clip(speed + rng.normal() * 0.3, 0.0, 20.0)) if k % 400 > 20 else 0.0
        s += 0.05 * speed
        if s > path.length + 20.0:
            s = 2.0
        foot = path.at(min(s, path.length))
        offset = 0.4 * math.sin(s / 17.0) + 0.03 * rng.normal()
        x = float(foot.x) - offset * math.sin(foot.heading) + max(s - path.length, 0.0)
        y = float(foot.y) + offset * math.cos(foot.heading)
        yaw = float(foot.heading) + 0.02 * math.cos(s / 17.0) + 0.01 * rng.normal()
        yaw_rate = speed * float(foot.curvature) + 0.02 * rng.normal()
        now_time = t + rng.choice([0.0, 0.0, 0.0, 0.03, 0.15, 0.4])
        sample = [t, now_time, x, y, yaw, speed, yaw_rate, 0.02 * rng.normal(), speed * yaw_rate, 0.02 * rng.normal()]
        for i in np.flatnonzero(rng.uniform(size=10) < 0.01):
            sample[i] = rng.choice([math.nan, math.inf, 1e300, -1e9])
        if rng.uniform() < 0.004:
            sample[2] += rng.choice([-40.0, 25.0])
        if rng.uniform() < 0.004:
            sample[:2] = [t + 5.0, t + 5.0]
        if rng.uniform() < 0.004:
            sample[:2] = [t - 4.0, t - 4.0]
        motion_time = rng.choice([math.nan, now_time, 0.5 * (t + now_time), t - 0.07])
        yield [*sample, math.nan, math.nan, motion_time]


STATUSES = [status.value for status in Status]


def in_python(tracker, sample):
    """A call of the class."""
    t, clock, x, y, yaw, speed, yaw_rate, vy, pull, wheel, _, _, motion_time = sample
    answer = tracker.step(t, x, y, yaw, speed, yaw_rate, now=clock if math.isfinite(clock) else None,
                          lateral_velocity=vy, lateral_acceleration=pull, wheel_angle=wheel,
                          motion_time=None if math.isnan(motion_time) else motion_time)  # fmt: skip
    status = STATUSES.index(answer.status)
    return answer.command, float(status), answer.offset, answer.heading_error, answer.station
