"""Fitting the plant's tyre law to lateral forces, and saying how far it is from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput
from adaptrack.vehicle import Tyre

Array = NDArray[np.float64]

SHAPES, CURVATURES, FRICTIONS = (1.0, 1.99), (-20.0, 0.99), (0.05, 3.0)
"""Bounds of what is fitted."""


class Samples(NamedTuple):
    """Lateral forces of one tyre; arrays (n,)."""

    slip: Array
    """rad, positive to the left"""
    load: Array
    """N"""
    force: Array
    """N, positive to the left"""
    rear: NDArray[np.bool_]
    """whether it is a rear tyre"""


@dataclass(frozen=True)
class TyreFit:
    """A tyre of the plant that stands for another, and how well."""

    tyre: Tyre
    friction: float
    """-, peak of what was fitted over its nominal load; the plant's is the road's: drive it on roads with this one"""
    deviation: float
    """-, largest deviation of the force over the peak force at the same load"""
    where: tuple[float, float]
    """rad, N: slip and load of that deviation"""
    slips: tuple[float, float]
    """rad, range of what was fitted"""
    loads: tuple[float, float]
    """N, of a tyre, likewise"""
    notes: tuple[str, ...] = ()
    """what was left out, assumed or found, a sentence each"""

    def __str__(self) -> str:
        return (
            f"force off by at most {100.0 * self.deviation:.1f} % of its peak (at {self.where[0]:.3f} rad, "
            f"{self.where[1]:.0f} N), over {self.slips[0]:.3g} to {self.slips[1]:.3g} rad and {self.loads[0]:.0f} to "
            f"{self.loads[1]:.0f} N; peak friction {self.friction:.3g} at the nominal load, which is the road's"
        )


def lateral_force(tyre: Tyre, slip: ArrayLike, load: ArrayLike, friction: float, rear: ArrayLike = False) -> Array:
    """Lateral force (N) of one tyre, the law of `Tyre` in NumPy: slip (rad), vertical load (N), rear or front tyre."""
    slip, load = np.asarray(slip, dtype=float), np.asarray(load, dtype=float)
    q = load / tyre.nominal_load
    s0, s1, s2 = tyre.stiffness_load_coefficients
    stiffness = np.where(rear, tyre.stiffness_rear, tyre.stiffness_front) * (s0 + s1 * q) / (1.0 + s2 * q**2)
    if tyre.kind == "linear":
        return np.asarray(stiffness * friction * slip)
    peak = friction * load * np.maximum(1.0 - tyre.friction_load_sensitivity * (q - 1.0), 0.1)
    b = stiffness / (tyre.shape * peak) * slip
    return np.asarray(peak * np.sin(tyre.shape * np.arctan(b - tyre.curvature * (b - np.arctan(b)))))


def fit_saturation(
    tyre: Tyre, samples: Samples, friction: float, *, loads_differ: bool = True, stiffness: bool = False
) -> tuple[Tyre, float]:
    """Shape, curvature, load sensitivity of the friction, and friction, by least squares of force over load.

    loads_differ: else the load sensitivity stays as it is; stiffness: whether that of both axles is fitted as well,
    within a quarter.

    Raises
    ------
    InvalidInput
        When nothing fits.
    """
    from scipy.optimize import least_squares

    def changed(x: Array) -> tuple[Tyre, float]:
        values = {"shape": float(x[0]), "curvature": float(x[1])}
        values["friction_load_sensitivity"] = float(x[3]) if loads_differ else tyre.friction_load_sensitivity
        values["stiffness_front"] = tyre.stiffness_front * (float(x[4]) if stiffness else 1.0)
        values["stiffness_rear"] = tyre.stiffness_rear * (float(x[5]) if stiffness else 1.0)
        return tyre.model_copy(update=values), float(x[2])  # bounded below: no need to validate at every step

    def residual(x: Array) -> Array:
        candidate, mu = changed(x)
        return (lateral_force(candidate, samples.slip, samples.load, mu, samples.rear) - samples.force) / samples.load

    low = np.array([SHAPES[0], CURVATURES[0], FRICTIONS[0], 0.0, 0.75, 0.75])
    high = np.array([SHAPES[1], CURVATURES[1], FRICTIONS[1], 1.0, 1.25, 1.25])
    best = None
    for curvature in (-2.0, 0.0, 0.5):
        start = np.clip([1.35, curvature, friction, 0.1, 1.0, 1.0], low + 1e-6, high - 1e-6)
        found = least_squares(residual, start, bounds=(low, high), x_scale=[0.3, 1.0, 0.3, 0.1, 0.1, 0.1])
        if np.isfinite(found.cost) and (best is None or found.cost < best.cost):
            best = found
    if best is None:
        raise InvalidInput("the tyre law fits no such forces: they hold values beyond any tyre's.")
    fitted, mu = changed(best.x)
    names = ("stiffness_front", "stiffness_rear", "shape", "curvature", "friction_load_sensitivity")
    return tyre.replace(**{name: _short(getattr(fitted, name)) for name in names}), _short(mu)


def judged(tyre: Tyre, samples: Samples, friction: float, notes: tuple[str, ...] = ()) -> TyreFit:
    """How far a tyre is from samples."""
    off = np.abs(lateral_force(tyre, samples.slip, samples.load, friction, samples.rear) - samples.force)
    q = samples.load / tyre.nominal_load
    peak = friction * samples.load * np.maximum(1.0 - tyre.friction_load_sensitivity * (q - 1.0), 0.1)
    share = off / peak
    worst = int(share.argmax())
    return TyreFit(
        tyre, friction, float(share[worst]), (float(samples.slip[worst]), float(samples.load[worst])),
        (float(samples.slip.min()), float(samples.slip.max())), (float(samples.load.min()), float(samples.load.max())),
        notes,
    )  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.5g}")
