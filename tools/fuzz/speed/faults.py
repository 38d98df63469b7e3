"""Three lists of faults of sensors: visible at once, visible against a second signal, visible to nobody.

A fault changes the sample of a call in place, for as long as it lasts.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

from tools.fuzz.inputs import HOSTILE, Rng, choose

Sample = dict[str, float]
"""A call: the fields of `adaptrack_sample` by name."""
POSE = ("x", "y", "yaw")
MOTION = ("speed", "yaw_rate", "lateral_acceleration", "longitudinal_acceleration")
TIMES = ("t", "now", "motion_time")
SPOILED_SHARE = 0.3
"""Of the calls, in which a number is not finite, absurd, or a time that is none."""
ABSURD = (1e3, -1e3, 1e4, -3e5, 1e9, 1e18, 1e300, -1e300)
JUMPS = (-1e9, -3600.0, -5.0, -1.5, -0.3, 0.3, 1.0, 5.0, 3600.0, 1e9)
"""s, by which a clock jumps."""
STRANGE_TIMES = (*HOSTILE, 0.0, -1.0, 1.7e18, 1.7e12, 1e10)
"""s, of a stamp that is none."""


@dataclass
class Spoiler:
    """A fault at work: its size, the first sample that it met, and its random numbers."""

    size: float
    rng: Rng
    held: Sample = field(default_factory=dict)


Effect = Callable[[Sample, Spoiler], None]


class SensorFault(NamedTuple):
    """A fault: its effect, the sizes to draw from, and whether it lasts for the whole drive."""

    effect: Effect
    sizes: tuple[float, ...] = (1.0,)
    lasts: bool = False


def _hold(*names: str) -> Effect:
    """Repeat the signals that the first sample had, the time stamps among them."""

    def effect(sample: Sample, spoiler: Spoiler) -> None:
        sample.update({name: spoiler.held[name] for name in names})

    return effect


def _hold_motion_stamped(sample: Sample, spoiler: Spoiler) -> None:
    held = spoiler.held
    sample.update({name: held[name] for name in MOTION})
    sample["motion_time"] = held["t"] if math.isnan(held["motion_time"]) else held["motion_time"]


def _hold_pose_stamped(sample: Sample, spoiler: Spoiler) -> None:
    if math.isnan(sample["motion_time"]):
        sample["motion_time"] = sample["t"]
    sample.update({name: spoiler.held[name] for name in ("t", *POSE)})


def _lose(*names: str) -> Effect:
    def effect(sample: Sample, spoiler: Spoiler) -> None:
        sample.update(dict.fromkeys(names, math.nan))

    return effect


def _spoil(names: tuple[str, ...], values: tuple[float, ...]) -> Effect:
    """Give some of the signals, in some of the calls, one of the values."""

    def effect(sample: Sample, spoiler: Spoiler) -> None:
        for name in names:
            if spoiler.rng.random() < SPOILED_SHARE:
                sample[name] = choose(spoiler.rng, values)

    return effect


def _shift_clock(sample: Sample, spoiler: Spoiler) -> None:
    for name in TIMES:
        sample[name] += spoiler.size


def _stick_clock(sample: Sample, spoiler: Spoiler) -> None:
    sample.update({name: spoiler.held[name] for name in TIMES})


def _scale(name: str) -> Effect:
    def effect(sample: Sample, spoiler: Spoiler) -> None:
        sample[name] *= spoiler.size

    return effect


def _offset_speed(sample: Sample, spoiler: Spoiler) -> None:
    sample["speed"] += spoiler.size


def _zero_speed(sample: Sample, spoiler: Spoiler) -> None:
    sample["speed"] = 0.0


def _swap(first: str, second: str) -> Effect:
    def effect(sample: Sample, spoiler: Spoiler) -> None:
        sample[first], sample[second] = sample[second], sample[first]

    return effect


def _move(sample: Sample, spoiler: Spoiler) -> None:
    """Move the position along the car by the size (m)."""
    sample["x"] += spoiler.size * math.cos(sample["yaw"])
    sample["y"] += spoiler.size * math.sin(sample["yaw"])


def _drift(sample: Sample, spoiler: Spoiler) -> None:
    """Let the position run away along the car with the size (m/s)."""
    way = spoiler.size * (sample["t"] - spoiler.held["t"])
    sample["x"] += way * math.cos(sample["yaw"])
    sample["y"] += way * math.sin(sample["yaw"])


def _hold_pose_noisy(sample: Sample, spoiler: Spoiler) -> None:
    for name, sigma in zip(POSE, (0.02, 0.02, 0.002), strict=True):
        sample[name] = spoiler.held[name] + sigma * float(spoiler.rng.normal())


def _shift_stamps(sample: Sample, spoiler: Spoiler) -> None:
    """Stamp the samples by the size (s) wrong; none of them is newer than its call."""
    sample["t"] = min(sample["t"] + spoiler.size, sample["now"])


def _tilt(sample: Sample, spoiler: Spoiler) -> None:
    sample["grade"] = (0.0 if math.isnan(sample["grade"]) else sample["grade"]) + spoiler.size


def _hold_standing(sample: Sample, spoiler: Spoiler) -> None:
    """Once the car stands, hold pose and speed of that moment; their noise goes on."""
    if "stood" not in spoiler.held:
        if abs(sample["speed"]) > 0.1:
            return
        spoiler.held.update(sample, stood=1.0)
    _hold_pose_noisy(sample, spoiler)
    sample["speed"], sample["yaw_rate"] = 0.02 * float(spoiler.rng.normal()), 0.0


def _turn_sign(name: str) -> Effect:
    def effect(sample: Sample, spoiler: Spoiler) -> None:
        sample[name] = -sample[name]

    return effect


def _degrees(sample: Sample, spoiler: Spoiler) -> None:
    sample["yaw"] = math.degrees(sample["yaw"])


VISIBLE: dict[str, SensorFault] = {
    "motion frozen, old stamp": SensorFault(_hold_motion_stamped),
    "pose frozen, old stamp": SensorFault(_hold_pose_stamped),
    "all frozen, old stamp": SensorFault(_hold("t", "motion_time", *POSE, *MOTION)),
    "speed missing": SensorFault(_lose("speed")),
    "pose missing": SensorFault(_lose(*POSE)),
    "all missing": SensorFault(_lose(*POSE, *MOTION)),
    "not finite": SensorFault(_spoil((*POSE, *MOTION, "grade"), (math.nan, math.inf, -math.inf))),
    "absurd numbers": SensorFault(_spoil((*POSE, *MOTION, "grade"), ABSURD)),
    "absurd speed": SensorFault(_spoil(("speed",), ABSURD)),
    "absurd stamps": SensorFault(_spoil(TIMES, STRANGE_TIMES)),
    "absurd motion stamp": SensorFault(_spoil(("motion_time",), STRANGE_TIMES)),
    "clock jumps": SensorFault(_shift_clock, JUMPS),
    "clock sticks": SensorFault(_stick_clock),
}
"""Faults that a sample shows by itself, or by its time stamp."""

CROSS: dict[str, SensorFault] = {
    "speed frozen, new stamp": SensorFault(_hold("speed")),
    "speed zero": SensorFault(_zero_speed),
    "pose frozen, new stamp": SensorFault(_hold(*POSE)),
    "pose frozen, with noise": SensorFault(_hold_pose_noisy),
    "speed scale": SensorFault(_scale("speed"), (0.2778, 0.447, 0.5, 0.7, 0.8, 1.25, 1.5, 2.237, 3.6)),
    "speed offset": SensorFault(_offset_speed, (-4.0, -2.0, 2.0, 4.0)),
    "speed sign": SensorFault(_turn_sign("speed")),
    "speed and yaw rate swapped": SensorFault(_swap("speed", "yaw_rate")),
    "x and y swapped": SensorFault(_swap("x", "y")),
    "yaw in degrees": SensorFault(_degrees),
    "yaw sign": SensorFault(_turn_sign("yaw")),
    "yaw rate sign": SensorFault(_turn_sign("yaw_rate")),
    "place jumps": SensorFault(_move, (-30.0, -8.0, -3.0, 3.0, 8.0, 30.0)),
    "place drifts fast": SensorFault(_drift, (-4.0, -2.0, 2.0, 4.0)),
    "acceleration sign": SensorFault(_turn_sign("longitudinal_acceleration")),
    "acceleration in g": SensorFault(_scale("longitudinal_acceleration"), (1.0 / 9.81,)),
}
"""Faults that a second signal contradicts."""

HIDDEN: dict[str, SensorFault] = {
    "speed scale within 8 %": SensorFault(_scale("speed"), (0.92, 0.96, 1.04, 1.08), lasts=True),
    "stamps off by 0.05 s": SensorFault(_shift_stamps, (-0.05, 0.05), lasts=True),
    "place off": SensorFault(_move, (-3.0, -1.0, 1.0, 3.0), lasts=True),
    "place drifts slowly": SensorFault(_drift, (-0.1, -0.03, 0.03, 0.1)),
    "grade measured wrong": SensorFault(_tilt, (-0.1, -0.05, 0.05, 0.1), lasts=True),
    "all of a standing car frozen": SensorFault(_hold_standing),
}
"""Faults that no signal contradicts; `all of a standing car frozen` is contradicted by the requests alone."""
LISTS = {"visible": VISIBLE, "cross": CROSS, "hidden": HIDDEN}
