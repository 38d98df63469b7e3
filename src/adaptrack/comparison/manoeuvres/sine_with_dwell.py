"""The sine with dwell of UN Regulation No. 140 and FMVSS 126: is a car directionally stable, and does it answer?

The steering wheel turns by a slowly increasing angle at 80 km/h, for the angle A at 0.3 g; then, coasting from 80 km/h,
by one period of a sine of 0.7 Hz that rests for 500 ms at its second peak, of 1.5 A and more in steps of 0.5 A. The
plants have no stability control: the regulation asks for one, and a car without it may fail.

Read: parts of 49 CFR 571.126, and the same test in a translated Chinese standard (stability control of light vehicles,
2015), which like UN R140 and UN R13-H follows Global Technical Regulation No. 8; the text of UN R140 itself was not.
Not done as there: signals without noise are not filtered, and loads and tyres are the car's as its file says.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import cumulative_trapezoid

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.cars.vehicle import GRAVITY, Vehicle
from adaptrack.comparison.manoeuvres.open_loop import (
    DEGREE,
    STANDARD_SPEED,
    Motion,
    Surroundings,
    drive_open_loop,
    steering_ratio_of,
)
from adaptrack.drive.failure import SIDESLIP

Array = NDArray[np.float64]

FREQUENCY, DWELL = 0.7, 0.5
"""Hz, s"""
SLOW_RATE = 13.5 * DEGREE
"""rad/s, of the steering wheel, slowly increasing"""
LEVEL = 0.3 * GRAVITY
"""m/s^2, at which A is taken"""
REGRESSION = (0.1 * GRAVITY, 0.375 * GRAVITY)
"""m/s^2, range of the straight line that gives A: that of the test laboratories' procedure, by memory"""
FIRST, STEP, LAST = 1.5, 0.5, 6.5
"""Amplitudes over A."""
LEAST_LAST, LARGEST = 270.0 * DEGREE, 300.0 * DEGREE
"""rad, at the steering wheel: the last amplitude is the larger of 6.5 A and 270 degrees, at most 300 degrees"""
RESPONSIVE = 5.0
"""Over A, amplitude from which the displacement counts."""
YAW_LIMITS = ((1.0, 0.35), (1.75, 0.20))
"""(s after the completion of steer, largest share of the second yaw-rate peak)"""
DISPLACEMENT_TIME = 1.07
"""s, from the beginning of steer"""
HEAVY = 3500.0
"""kg; displacements of lighter cars must reach 1.83 m, of heavier ones 1.52 m"""
BEGINNING = 5.0 * DEGREE
"""rad, at the steering wheel, at which steering counts as begun"""
BEFORE = 0.2
"""s, driven straight"""


@dataclass(frozen=True)
class DwellRun:
    """One sine with dwell."""

    amplitude: float
    """rad, at the steering wheel; positive: to the left first"""
    multiple: float
    """of A"""
    peak_yaw_rate: float
    """rad/s, the second peak"""
    yaw_ratio_1: float
    """yaw rate 1 s after the completion of steer over the second peak; infinite when it is not finite"""
    yaw_ratio_2: float
    """the same after 1.75 s"""
    displacement: float
    """m, to the side of the first steering, 1.07 s after its beginning"""
    spun: bool
    """whether the sideslip passed 45 degrees"""
    stable: bool
    """whether both ratios are within 35 and 20 per cent"""
    responsive: bool | None
    """whether the displacement is large enough; None where it does not count"""

    @property
    def passed(self) -> bool:
        """Both, as far as they count."""
        return self.stable and self.responsive is not False


@dataclass(frozen=True, eq=False)
class SineWithDwell:
    """All runs of the test, to the left and to the right first."""

    ratio: float
    """steering wheel over road wheels"""
    angle: float
    """rad, A at the steering wheel"""
    runs: tuple[DwellRun, ...]
    motion: Motion

    @property
    def passed(self) -> bool:
        """Whether all runs meet the criteria of UN R140 and FMVSS 126."""
        return all(run.passed for run in self.runs)

    def rows(self) -> list[dict[str, Any]]:
        """One run each; angles in degrees at the steering wheel, ratios in per cent."""
        return [
            {
                "amplitude": run.amplitude / DEGREE,
                "multiple": run.multiple,
                "peak_yaw_rate": run.peak_yaw_rate / DEGREE,
                "yaw_ratio_1": 100.0 * run.yaw_ratio_1,
                "yaw_ratio_2": 100.0 * run.yaw_ratio_2,
                "displacement": run.displacement,
                "spun": run.spun,
                "passed": run.passed,
            }
            for run in self.runs
        ]

    def summary(self) -> dict[str, Any]:
        """A (degrees), how many runs, how many passed."""
        return {
            "steering_ratio": self.ratio,
            "angle": self.angle / DEGREE,
            "runs": len(self.runs),
            "passed_runs": sum(run.passed for run in self.runs),
            "passed": self.passed,
        }


def sine_with_dwell(
    car: Vehicle,
    plant: Plant | SteppedPlant,
    *,
    surroundings: Surroundings | None = None,
) -> SineWithDwell:
    """The whole test: A from a slowly increasing steer, then all amplitudes to both sides.

    car: its steering ratio (15 where its file has none) and its mass count.

    Raises
    ------
    InvalidInput
        When the plant does not reach 0.375 g under the slowly increasing steer.
    """
    given = replace(surroundings or Surroundings(), hold_speed=True)
    ratio = steering_ratio_of(car)
    angle = reference_angle(plant, ratio, given)
    sizes = amplitudes(angle)
    both = np.concatenate([sizes, -sizes])

    def steer(t: Array) -> Array:
        return both[:, None] * sine_with_dwell_shape(t - BEFORE) / ratio

    end = BEFORE + 1.0 / FREQUENCY + DWELL
    motion = drive_open_loop(
        plant, steer, STANDARD_SPEED, end + YAW_LIMITS[-1][0] + 0.1, replace(given, hold_speed=False)
    )
    least = 1.83 if car.mass <= HEAVY else 1.52
    runs = tuple(_judge(motion, k, float(size), angle, least) for k, size in enumerate(both))
    return SineWithDwell(ratio, angle, runs, motion)


def sine_with_dwell_shape(t: Array) -> Array:
    """The steering over its amplitude at times (n,) s from its beginning: a sine of 0.7 Hz, held at its second peak."""
    peak = 0.75 / FREQUENCY
    phase = np.where(t <= peak, t, np.where(t <= peak + DWELL, peak, t - DWELL))
    return np.where((t >= 0.0) & (phase <= 1.0 / FREQUENCY), np.sin(2.0 * np.pi * FREQUENCY * phase), 0.0)


def amplitudes(angle: float) -> Array:
    """The steering-wheel amplitudes (rad) of a series for A (rad): 1.5 A in steps of 0.5 A to the last one."""
    last = max(LAST * angle, LEAST_LAST) if LAST * angle <= LARGEST else LARGEST
    series = angle * np.arange(FIRST, last / angle + 1e-9, STEP)
    return np.append(series[series < last * (1.0 - 1e-9)], last)


def reference_angle(plant: Plant | SteppedPlant, ratio: float, given: Surroundings) -> float:
    """A (rad): the steering-wheel angle at 0.3 g of a slowly increasing steer at 80 km/h, to a tenth of a degree.

    By a straight line through the angles between 0.1 and 0.375 g; the mean of both sides.

    Raises
    ------
    InvalidInput
        When the plant does not reach 0.375 g within 300 degrees.
    """
    sides = np.array([1.0, -1.0])

    def steer(t: Array) -> Array:
        return sides[:, None] * SLOW_RATE * t / ratio

    motion = drive_open_loop(plant, steer, STANDARD_SPEED, LARGEST / SLOW_RATE, given)
    found = []
    for side, wheel, felt in zip(sides, motion.wheel_angle, motion.lateral_acceleration, strict=True):
        reached = side * felt > REGRESSION[1]
        if not reached.any():
            raise InvalidInput("sine_with_dwell: the plant does not reach 0.375 g at 80 km/h within 300 degrees.")
        used = slice(int(np.argmax(side * felt > REGRESSION[0])), int(np.argmax(reached)))
        slope, start = np.polyfit(side * felt[used], side * wheel[used] * ratio, 1)
        found.append(slope * LEVEL + start)
    return round(float(np.mean(found)) / DEGREE, 1) * DEGREE


def _judge(motion: Motion, k: int, amplitude: float, angle: float, least: float) -> DwellRun:
    """The measures of one run, against the criteria."""
    t, side = motion.t, math.copysign(1.0, amplitude)
    yaw_rate, felt = -side * motion.yaw_rate[k], side * motion.lateral_acceleration[k]
    reversal, completion = BEFORE + 0.5 / FREQUENCY, BEFORE + 1.0 / FREQUENCY + DWELL
    peak = _first_peak(yaw_rate[t >= reversal])
    shares = [float(np.interp(completion + later, t, yaw_rate)) / peak for later, _ in YAW_LIMITS]
    ratios = [share if math.isfinite(share) else math.inf for share in shares]
    begun = BEFORE + math.asin(min(1.0, BEGINNING / abs(amplitude))) / (2.0 * math.pi * FREQUENCY)
    after = t >= begun
    moved = cumulative_trapezoid(cumulative_trapezoid(felt[after], t[after], initial=0.0), t[after], initial=0.0)
    displacement = float(np.interp(begun + DISPLACEMENT_TIME, t[after], moved))
    slip = np.abs(motion.sideslip[k])
    counts = abs(amplitude) >= RESPONSIVE * angle * (1.0 - 1e-9)
    return DwellRun(
        amplitude=amplitude,
        multiple=abs(amplitude) / angle,
        peak_yaw_rate=peak,
        yaw_ratio_1=ratios[0],
        yaw_ratio_2=ratios[1],
        displacement=displacement,
        spun=not bool((slip <= SIDESLIP).all()),
        stable=all(ratio <= limit for ratio, (_, limit) in zip(ratios, YAW_LIMITS, strict=True)),
        responsive=displacement >= least if counts else None,
    )


def _first_peak(values: Array) -> float:
    """The first local maximum above zero; the largest value when there is none."""
    inner = values[1:-1]
    peaks = np.flatnonzero((inner > 0.0) & (inner >= values[:-2]) & (inner > values[2:]))
    return float(inner[peaks[0]]) if peaks.size else float(np.max(values))
