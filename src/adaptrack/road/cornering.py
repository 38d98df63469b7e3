"""How hard a car can corner: the steady turn in which a tyre is at its peak, or the wheels at their limit."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.cars.vehicle import SteeringActuator, Vehicle, load_tyre, pack_plant
from adaptrack.core.planning import cornering as kernel
from adaptrack.core.planning.cornering import STEERING_LIMIT as STEERING_LIMIT
from adaptrack.road.segments import Array


def steering_limit(car: Vehicle) -> float:
    """rad, of the road wheels; where the car file does not say, the limit of the paper's table."""
    limit = car.steering.limit if car.steering is not None else None
    return STEERING_LIMIT if limit is None else limit


def cornering_limit(car: Vehicle, curvature: ArrayLike, friction: ArrayLike) -> Array:
    """The largest steady lateral acceleration (m/s^2) on bends, on a level road, see `adaptrack.core.planning`.

    curvature: (n,) 1/m; friction: (n,). The limit is 0 where the wheels cannot be turned far enough even at a crawl.
    """
    bends, frictions = np.broadcast_arrays(np.asarray(curvature, float), np.asarray(friction, float))
    accelerations = np.empty(bends.shape)
    for mu in np.unique(frictions):
        rows = frictions == mu
        limits = bends[rows]
        kernel.cornering_along(*_limits(car, float(mu)), limits)
        accelerations[rows] = limits
    return accelerations


@lru_cache(maxsize=64)
def packed(car: Vehicle) -> Array:
    """The car on its own tyre as kernels read it, `PLANT_PARAMETERS`; without an actuator."""
    return pack_plant(car, load_tyre(car.tyre), SteeringActuator.ideal())


@lru_cache(maxsize=64)
def _limits(car: Vehicle, friction: float) -> tuple[float, Array]:
    """The tightest curvature (1/m) that the wheels allow, and the limit at even ones up to it."""
    limits = np.empty(kernel.BENDS)
    return kernel.cornering_limits(packed(car), steering_limit(car), friction, limits), limits
