"""How hard a car can corner: the steady turn in which a tyre is at its peak, or the wheels at their limit."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.cars.vehicle import GRAVITY, Tyre, Vehicle, load_tyre
from adaptrack.road.segments import Array

STEERING_LIMIT = math.pi / 6
"""rad, of the road wheels, where the car file does not say: the limit of the paper's table."""

_SLIPS = np.linspace(0.0, 0.8, 401)
"""rad, of the tyres that are tried"""
_SHARES = np.linspace(0.0, 1.2, 241)
"""Of mu g, that are tried."""


def steering_limit(car: Vehicle) -> float:
    """rad, of the road wheels."""
    known = car.steering.limit if car.steering is not None else None
    return STEERING_LIMIT if known is None else known


def cornering_limit(car: Vehicle, curvature: ArrayLike, friction: ArrayLike) -> Array:
    """The largest steady lateral acceleration (m/s^2) on bends, on a level road.

    Each axle carries its share of the car: m a l_r/L and m a l_f/L. Its two tyres pull at one slip angle under the
    loads that roll leaves them, by the Magic Formula of the car's tyre (`Tyre`); the front wheels, turned by delta =
    atan(L kappa) + alpha_f - alpha_r, push sideways with cos(delta) of their force.

    curvature: (n,) 1/m; friction: (n,). The limit is 0 where the wheels cannot be turned far enough even at a crawl.
    """
    bends, frictions = np.broadcast_arrays(np.abs(np.asarray(curvature, float)), np.asarray(friction, float))
    found = np.empty(bends.shape)
    for mu in np.unique(frictions):
        here = frictions == mu
        tightest, limits = _limits(car, float(mu))
        found[here] = np.where(bends[here] > tightest[-1], 0.0, np.interp(bends[here], tightest, limits))
    return found


@lru_cache(maxsize=64)
def _limits(car: Vehicle, friction: float) -> tuple[Array, Array]:
    """Curvatures (k,) up to the tightest that the wheels allow, and the limit at each."""
    tightest = math.tan(min(steering_limit(car), 1.5)) / car.wheelbase
    bends = np.linspace(0.0, tightest, 25)
    return bends, np.array([_limit(car, friction, bend) for bend in bends])


def _limit(car: Vehicle, friction: float, bend: float) -> float:
    tyre, most = load_tyre(car.tyre), steering_limit(car)
    turned = math.atan(car.wheelbase * bend)
    reached = 0.0
    for acceleration in _SHARES * friction * GRAVITY:
        rear = _slip(car, tyre, friction, acceleration, None)
        front = _slip(car, tyre, friction, acceleration, turned - rear)
        if not turned + front - rear <= most:  # NaN: a tyre is beyond its peak
            return reached
        reached = float(acceleration)
    return reached


def _slip(car: Vehicle, tyre: Tyre, friction: float, acceleration: float, turned: float | None) -> float:
    """Slip angle (rad) at which an axle pulls its share; NaN where it cannot.

    turned: rad, of the front wheels less their slip angle; None for the rear axle.
    """
    load = car.static_loads[1 if turned is None else 0]
    stiffness, track = tyre.stiffness_front, car.track_front
    if turned is None:
        stiffness, track = tyre.stiffness_rear, car.track_rear
    share = 2.0 * load / GRAVITY * acceleration
    moved = min(share * car.cg_height / track, 0.99 * load)
    pull = _force(tyre, stiffness, load + moved, friction) + _force(tyre, stiffness, load - moved, friction)
    if turned is not None:
        pull = pull * np.cos(turned + _SLIPS)
    peak = int(np.argmax(pull))
    if not pull[peak] >= share:
        return math.nan
    return float(np.interp(share, pull[: peak + 1], _SLIPS[: peak + 1]))


def _force(tyre: Tyre, stiffness: float, load: float, friction: float) -> Array:
    """Lateral force (N) of a tyre at `_SLIPS`, see `Tyre`."""
    s0, s1, s2 = tyre.stiffness_load_coefficients
    q = load / tyre.nominal_load
    rise = stiffness * (s0 + s1 * q) / (1.0 + s2 * q * q)
    if tyre.kind == "linear":
        return rise * friction * _SLIPS
    peak = friction * load * max(1.0 - tyre.friction_load_sensitivity * (q - 1.0), 0.1)
    b = rise / (tyre.shape * peak) * _SLIPS
    b = b - tyre.curvature * (b - np.arctan(b))
    return peak * np.sin(tyre.shape * np.arctan(b))
