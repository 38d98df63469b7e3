"""Fitting the plant's tyre law to lateral forces, and saying how far it is from them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Tyre
from adaptrack.core.kernel import row_of
from adaptrack.core.models.car import PLANT_PARAMETERS, CarRow
from adaptrack.core.synthesis import plant as kernel

Array = NDArray[np.float64]

SHAPE_BOUNDS, CURVATURE_BOUNDS, FRICTION_BOUNDS = (1.0, 1.99), (-20.0, 0.99), (0.05, 3.0)
"""Bounds of what is fitted."""


class TyreSamples(NamedTuple):
    """Lateral forces of one tyre; arrays (n,)."""

    slip: Array
    """rad, positive to the left"""
    load: Array
    """Vertical load (N)."""
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
    """Sentences on data that were dropped or assumed."""

    def __str__(self) -> str:
        return (
            f"force off by at most {100.0 * self.deviation:.1f} % of its peak (at {self.where[0]:.3f} rad, "
            f"{self.where[1]:.0f} N), over {self.slips[0]:.3g} to {self.slips[1]:.3g} rad and {self.loads[0]:.0f} to "
            f"{self.loads[1]:.0f} N; peak friction {self.friction:.3g} at the nominal load, which is the road's"
        )


def lateral_force(tyre: Tyre, slip: ArrayLike, load: ArrayLike, friction: float, rear: ArrayLike = False) -> Array:
    """Lateral force (N) of one tyre of the plant: slip (rad), vertical load (N), rear or front tyre."""
    wheels = np.stack(np.broadcast_arrays(slip, load, rear), axis=-1).astype(np.float64)
    parameters, forces = np.zeros(len(PLANT_PARAMETERS)), np.empty(wheels.shape[:-1])
    kernel.plant_parameters(row_of(CarRow), tyre.numbers, row_of(kernel.Actuator), parameters)
    kernel.tyre_forces(parameters, friction, wheels.reshape(-1, 3), forces.reshape(-1))
    return forces


FREE = ("load sensitivity", "load ratio", "stiffness", "offsets")
"""What may be fitted beside shape, curvature and friction: how the friction falls with load; the load ratio of a
digressive stiffness; the stiffness of both axles, within a factor of four; slips at which an axle has no force."""


class _Fitted(NamedTuple):
    """The numbers of a fit in their order, each with its bounds, its scale and what frees it."""

    low: float
    high: float
    scale: float
    freed_by: str


_NUMBERS = (
    _Fitted(*SHAPE_BOUNDS, 0.3, ""), _Fitted(*CURVATURE_BOUNDS, 1.0, ""), _Fitted(*FRICTION_BOUNDS, 0.3, ""),
    _Fitted(0.0, 1.0, 0.1, FREE[0]), _Fitted(0.3, 50.0, 1.0, FREE[1]),
    _Fitted(0.25, 4.0, 0.1, FREE[2]), _Fitted(0.25, 4.0, 0.1, FREE[2]),
    _Fitted(-0.1, 0.1, 0.005, FREE[3]), _Fitted(-0.1, 0.1, 0.005, FREE[3]),
)  # fmt: skip


def fit_law(
    tyre: Tyre, samples: TyreSamples, friction: float, free: Collection[str] = ()
) -> tuple[Tyre, float, tuple[float, float]]:
    """The tyre, its friction and the offsets of the slip (rad) that are nearest to samples.

    Least squares of force over load, from `tyre` and `friction` on; free: of `FREE`, what is fitted beside shape,
    curvature and friction.

    Raises
    ------
    InvalidInput
        When nothing fits.
    """
    from scipy.optimize import least_squares

    low, high, scale = (np.array(column) for column in list(zip(*_NUMBERS, strict=True))[:3])
    moves = np.array([not number.freed_by or number.freed_by in free for number in _NUMBERS])
    start = np.array([1.35, 0.0, friction, tyre.friction_load_sensitivity, tyre.digressive_load_ratio or 2.0,
                      1.0, 1.0, 0.0, 0.0])  # fmt: skip
    if "load sensitivity" in free:
        start[3] = 0.1

    def residual(x: Array, law_parameters: Array) -> Array:
        law_parameters[moves] = x
        candidate, mu = _changed(tyre, law_parameters)
        slip = samples.slip - np.where(samples.rear, law_parameters[8], law_parameters[7])
        return (lateral_force(candidate, slip, samples.load, mu, samples.rear) - samples.force) / samples.load

    best = None
    for shape, curvature in ((1.35, -2.0), (1.35, 0.0), (1.6, 0.5), (1.2, -0.5)):
        parameters = start.copy()
        parameters[:2] = shape, curvature
        parameters = np.clip(parameters, low + 1e-6, high - 1e-6)
        solution = least_squares(
            residual,
            parameters[moves],
            bounds=(low[moves], high[moves]),
            x_scale=scale[moves],
            args=(parameters.copy(),),
        )
        if np.isfinite(solution.cost) and (best is None or solution.cost < best[0]):
            parameters[moves] = solution.x
            best = solution.cost, parameters
    if best is None:
        raise InvalidInput("the tyre law fits no such forces: they hold values beyond any tyre's.")
    fitted, mu = _changed(tyre, best[1])
    return tyre.replace(**{name: _short(getattr(fitted, name)) for name in _changes(tyre)}), _short(mu), (
        float(best[1][7]), float(best[1][8]),
    )  # fmt: skip


def _changes(tyre: Tyre) -> list[str]:
    """The keys that a fit changes."""
    changed_names = ["shape", "curvature", "friction_load_sensitivity", "stiffness_front", "stiffness_rear"]
    return changed_names if tyre.digressive_load_ratio is None else [*changed_names, "digressive_load_ratio"]


def _changed(tyre: Tyre, x: Array) -> tuple[Tyre, float]:
    """A tyre with the numbers of a fit, and its friction; bounded, hence not validated at every step."""
    values = {
        "shape": float(x[0]), "curvature": float(x[1]), "friction_load_sensitivity": float(x[3]),
        "digressive_load_ratio": float(x[4]), "stiffness_front": tyre.stiffness_front * float(x[5]),
        "stiffness_rear": tyre.stiffness_rear * float(x[6]),
    }  # fmt: skip
    return tyre.model_copy(update={name: values[name] for name in _changes(tyre)}), float(x[2])


def assess_fit(tyre: Tyre, samples: TyreSamples, friction: float, notes: tuple[str, ...] = ()) -> TyreFit:
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
