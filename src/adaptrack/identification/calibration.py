"""How much wider intervals are than the likelihood says.

A standard error s is replaced by sqrt((factor s)^2 + floor^2 + (share |value|)^2). Floors and shares are what a longer
log does not make smaller: the time between samples and its steps, and the shape of the tyres' curve, of which only one
number is fitted (a brush tyre at a quarter of its grip is 8 % softer than its slope at the origin, Pacejka,
*Tire and Vehicle Dynamics*, 3rd ed., section 3.2). They grow with the square of the wheels' angle in tight bends:
there driving and braking forces, which no log of this kind holds, turn the car, too.

The factors are such that 90 % intervals held the truth in 90 % of training logs: of a foreign plant
(`identifying_foreign.py` in the benchmarks of commit c623557, seeds from 40000), and for the steering offset and the
understeer gradient our windy drives (`identifying.py` there, seeds 1300 to 1359). Drive and brakes have floors alone,
for what slopes, bends and wheels that slip add to the speed. docs/identify.md says how well intervals hold on other
kinds of logs.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from adaptrack.core.maths import portable


class Correction(NamedTuple):
    """Correction of a standard error."""

    factor: float = 1.0
    floor: float = 0.0
    """in the unit of the quantity"""
    share: float = 0.0
    """of the value"""
    floor_in_bends: float = 0.0
    """in the unit of the quantity per rad^2 of the wheels"""
    share_in_bends: float = 0.0
    """of the value per rad^2 of the wheels"""


CORRECTIONS: Mapping[str, Correction] = {
    "delay": Correction(1.2, 0.003, floor_in_bends=0.05),
    "lag": Correction(1.2, 0.003, floor_in_bends=0.1),
    "dead_time": Correction(1.2, 0.003, floor_in_bends=0.1),
    "lateness": Correction(1.2, 0.003),
    "understeer_gradient": Correction(1.15, 1e-4, 0.05, 1e-3),
    "front": Correction(1.15, share=0.06, share_in_bends=2.0),
    "rear": Correction(1.15, share=0.06, share_in_bends=2.0),
    "offset": Correction(1.3),
    "vy_ahead": Correction(1.4),
    "relaxation": Correction(2.0, share_in_bends=6.0),
    "rate": Correction(share=0.03),
    "ratio": Correction(share=0.002),
    "angle_scale": Correction(share=0.02),
    "drive_lag": Correction(floor=0.005),
    "drive_dead_time": Correction(floor=0.005),
    "drive_gain": Correction(share=0.02),
    "brake_lag": Correction(floor=0.005),
    "brake_dead_time": Correction(floor=0.005),
    "brake_gain": Correction(share=0.02),
    "drag": Correction(share=0.05),
    "rolling": Correction(floor=0.01),
}
"""By the names of the estimates; those of the others are kept."""


def corrected(name: str, spread: float, value: float, positive: bool, before: float, wheels: float = 0.0) -> float:
    """The corrected standard error, at most what was believed before.

    spread, before: of a value, or of its logarithm where it is positive; wheels: rad, their angle in tight bends.
    """
    correction = CORRECTIONS.get(name, Correction())
    floor = correction.floor + correction.floor_in_bends * (wheels * wheels)
    share = correction.share + correction.share_in_bends * (wheels * wheels)
    unit = 1.0 / value if positive else 1.0
    return min(portable.hypot(correction.factor * spread, floor * unit, share * value * unit), max(before, spread))
