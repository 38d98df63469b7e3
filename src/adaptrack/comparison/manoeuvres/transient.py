"""Lateral transient response, after ISO 7401: a step of the steering, and continuous sines of it.

The standard has no limits to pass. Its contents and scope were read, not its text; response time, peak time and
overshoot are defined as the literature quotes them from it, levels and rise by memory.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.cars.vehicle import Vehicle
from adaptrack.comparison.manoeuvres.open_loop import (
    DEGREE,
    STANDARD_SPEED,
    Motion,
    Surroundings,
    drive_open_loop,
    find_turns,
)

Array = NDArray[np.float64]

LATERAL_ACCELERATION = 4.0
"""m/s^2, steady, that the steering angle is chosen for: the standard's level for cars."""
RISE = 0.1
"""s, in which the angle rises, in a straight line."""
BEFORE, AFTER = 0.5, 7.0
"""s, driven straight before the step, and recorded after it."""
SETTLED = 1.0
"""s, at the end of the record, whose mean is the steady value."""
FREQUENCIES = (0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.2, 1.5, 2.0, 2.5, 3.0)
"""Hz"""
CYCLES, TRANSIENT = 4, 3.0
"""Periods that are evaluated, after so many seconds."""


@dataclass(frozen=True)
class Response:
    """How one quantity answers to the step; times from the instant at which half of the angle is reached."""

    steady: float
    """rad/s or m/s^2"""
    gain: float
    """steady value over the steady wheel angle, 1/s or m/s^2 per rad"""
    response_time: float
    """s, until 90 % of the steady value"""
    peak_time: float
    """s, until the largest value; NaN when none is above the steady one"""
    overshoot: float
    """(largest - steady)/steady, 0 when none is above"""


@dataclass(frozen=True, eq=False)
class StepSteer:
    """The answer to a step of the steering."""

    speed: float
    """m/s"""
    wheel_angle: float
    """rad, steady"""
    yaw_rate: Response
    lateral_acceleration: Response
    sideslip: float
    """rad, steady"""
    motion: Motion

    def summary(self) -> dict[str, Any]:
        """The characteristic values by name: angles in degrees, times in s."""
        yaw, side = self.yaw_rate, self.lateral_acceleration
        return {
            "speed": self.speed,
            "wheel_angle": self.wheel_angle / DEGREE,
            "lateral_acceleration": side.steady,
            "yaw_rate": yaw.steady / DEGREE,
            "sideslip": self.sideslip / DEGREE,
            "yaw_rate_gain": yaw.gain,
            "yaw_response_time": yaw.response_time,
            "yaw_peak_time": yaw.peak_time,
            "yaw_overshoot": yaw.overshoot,
            "acceleration_response_time": side.response_time,
            "acceleration_peak_time": side.peak_time,
            "acceleration_overshoot": side.overshoot,
            "tb": abs(self.sideslip) / DEGREE * yaw.peak_time,
        }


def step_steer(
    car: Vehicle,
    plant: Plant | SteppedPlant,
    *,
    speed: float = STANDARD_SPEED,
    lateral_acceleration: float = LATERAL_ACCELERATION,
    surroundings: Surroundings | None = None,
) -> StepSteer:
    """A step of the wheel angle to the left, at constant speed (m/s), to a steady lateral acceleration (m/s^2).

    Raises
    ------
    InvalidInput
        When the plant has no such steady turn.
    """
    given = surroundings or Surroundings()
    angle = _angle_for(car, plant, speed, lateral_acceleration, given)

    def steer(t: Array) -> Array:
        return angle * np.clip((t - BEFORE) / RISE, 0.0, 1.0)

    motion = drive_open_loop(plant, steer, speed, BEFORE + AFTER, given)
    start = BEFORE + 0.5 * RISE
    last = motion.t >= motion.t[-1] - SETTLED
    return StepSteer(
        speed,
        angle,
        _response(motion.t - start, motion.yaw_rate[0], last, angle),
        _response(motion.t - start, motion.lateral_acceleration[0], last, angle),
        float(np.mean(motion.sideslip[0, last])),
        motion,
    )


def _angle_for(
    car: Vehicle, plant: Plant | SteppedPlant, speed: float, lateral_acceleration: float, given: Surroundings
) -> float:
    """The wheel angle (rad) of a steady lateral acceleration (m/s^2) at a speed (m/s)."""
    for name, value in (("speed", speed), ("lateral_acceleration", lateral_acceleration)):
        if not 0.0 < real("manoeuvre", name, value) < math.inf:
            raise InvalidInput(f"{name} = {value!r}: must be positive and finite.")
    turns = find_turns(car, plant, speed, lateral_acceleration, given)
    if math.isnan(turns.wheel_angle[0]):
        raise InvalidInput(
            f"lateral_acceleration = {lateral_acceleration:g} m/s^2: the plant has no such steady turn at "
            f"{speed:.4g} m/s; ask for less."
        )
    return float(turns.wheel_angle[0])


def _response(t: Array, values: Array, last: NDArray[np.bool_], angle: float) -> Response:
    steady = float(np.mean(values[last]))
    share = values / steady
    first = int(np.argmax(share >= 0.9))  # the first sample beyond; the instant lies before it
    response = float(np.interp(0.9, share[first - 1 : first + 1], t[first - 1 : first + 1]))
    k = int(np.argmax(share))
    over = float(share[k]) - 1.0
    peaked = over > 1e-4 and not last[k]
    return Response(
        steady, steady / angle, response, _peak(t, share, k) if peaked else math.nan, over if peaked else 0.0
    )


def _peak(t: Array, values: Array, k: int) -> float:
    """The time of the largest value, by the parabola through it and its neighbours."""
    before, here, after = values[k - 1 : k + 2]
    bend = before - 2.0 * here + after
    return float(t[k] + (0.5 * (before - after) / bend * (t[k + 1] - t[k]) if bend < 0.0 else 0.0))


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """Gains and phases of yaw rate and lateral acceleration over the wheel angle, (m,) each."""

    speed: float
    """m/s"""
    wheel_angle: float
    """rad, amplitude"""
    frequency: Array
    """Hz"""
    yaw_rate: NDArray[np.complex128]
    """1/s"""
    lateral_acceleration: NDArray[np.complex128]
    """m/s^2 per rad"""

    def rows(self) -> list[dict[str, Any]]:
        """One frequency each; phases in degrees, negative behind the wheel angle."""
        found = {}
        for name, values in (("yaw_rate", self.yaw_rate), ("acceleration", self.lateral_acceleration)):
            found[f"{name}_gain"] = np.abs(values)
            found[f"{name}_phase"] = np.unwrap(np.angle(values)) / DEGREE
        return [
            {"frequency": float(f), **{name: float(values[k]) for name, values in found.items()}}
            for k, f in enumerate(self.frequency)
        ]

    def summary(self) -> dict[str, Any]:
        """Bandwidth and resonance of the yaw rate, its delay at 1 Hz."""
        gain = np.abs(self.yaw_rate) / abs(self.yaw_rate[0])
        k = int(np.argmax(gain))
        phase = np.unwrap(np.angle(self.yaw_rate))
        inside = self.frequency[0] <= 1.0 <= self.frequency[-1]
        return {
            "speed": self.speed,
            "wheel_angle": self.wheel_angle / DEGREE,
            "yaw_bandwidth": _first_below(self.frequency, gain, math.sqrt(0.5)),
            "yaw_resonance": float(self.frequency[k]) if k else math.nan,
            "yaw_resonance_gain": float(gain[k]),
            "yaw_delay_1hz": float(-np.interp(1.0, self.frequency, phase) / (2.0 * math.pi)) if inside else math.nan,
        }


def _first_below(frequency: Array, gain: Array, level: float) -> float:
    """Hz, where the gain first falls to a level, by straight lines; NaN when it does not."""
    below = np.flatnonzero(gain < level)
    if not below.size or below[0] == 0:
        return math.nan
    k = int(below[0])
    return float(np.interp(level, gain[[k, k - 1]], frequency[[k, k - 1]]))


def frequency_response(
    car: Vehicle,
    plant: Plant | SteppedPlant,
    *,
    speed: float = STANDARD_SPEED,
    lateral_acceleration: float = LATERAL_ACCELERATION,
    frequencies: Sequence[float] = FREQUENCIES,
    surroundings: Surroundings | None = None,
) -> FrequencyResponse:
    """Continuous sines of the wheel angle at constant speed (m/s), each at one frequency (Hz).

    The amplitude is the angle of a steady lateral acceleration (m/s^2). Gains and phases are those of the fundamental
    wave, by least squares over the last four periods.

    Raises
    ------
    InvalidInput
        When the plant has no such steady turn, or frequencies do not increase from above 0 to at most 10 Hz.
    """
    f = np.asarray(frequencies, dtype=np.float64)
    if f.ndim != 1 or f.size < 2 or not (np.diff(f) > 0.0).all() or not 0.0 < f[0] <= f[-1] <= 10.0:
        raise InvalidInput(f"frequencies = {frequencies!r} Hz: must be two or more, increasing, above 0, at most 10.")
    given = surroundings or Surroundings()
    angle = _angle_for(car, plant, speed, lateral_acceleration, given)

    def steer(t: Array) -> Array:
        return angle * np.sin(2.0 * np.pi * f[:, None] * t)

    motion = drive_open_loop(plant, steer, speed, TRANSIENT + CYCLES / float(f[0]), given)
    yaw, side = (
        np.array([_wave(motion.t, values[k], f[k]) / angle for k in range(f.size)])
        for values in (motion.yaw_rate, motion.lateral_acceleration)
    )
    return FrequencyResponse(speed, angle, f, yaw, side)


def _wave(t: Array, values: Array, frequency: float) -> complex:
    """Amplitude and phase of the fundamental wave, against a sine of this frequency (Hz)."""
    last = t >= t[-1] - CYCLES / frequency - 1e-9
    angle = 2.0 * np.pi * frequency * t[last]
    basis = np.stack([np.sin(angle), np.cos(angle), np.ones(angle.size)], axis=1)
    sine, cosine, _ = np.linalg.lstsq(basis, values[last], rcond=None)[0]
    return complex(sine, cosine)
