"""Traction guard: what the axles of a car can take along the road in addition to their lateral forces."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import sqrt, square

LARGEST_BEND_SHARE, LEAST_BRAKING = 0.98, 0.5
"""-, share of the grip that a bend asks for at most; m/s^2, that the guard always leaves to the brakes."""


@inlined
def axle_force_limit(share, load, lateral, transfer, friction):
    """Largest force (N) along the car of which an axle can take a share beside its lateral force (N); inf: none.

    The axle carries load + transfer F (N) under a force F: F is the smallest positive root of the quadratic equation
    (share F)^2 + lateral^2 = friction^2 (load + transfer F)^2.
    """
    constant = lateral * lateral - square(friction * load)
    if constant >= 0.0:
        return 0.0
    half_slope = -square(friction) * load * transfer
    discriminant = half_slope * half_slope - (square(share) - square(friction * transfer)) * constant
    if discriminant < 0.0:
        return math.inf
    denominator = half_slope + sqrt(discriminant)
    return -constant / denominator if denominator > 0.0 else math.inf


@inlined
def axle_limits(friction, weight, lateral, car):
    """Largest driving and braking force (N) that both axles leave at a lateral acceleration (m/s^2) of the tyres.

    weight: N, on the road; car: mass, `lf`, `lr`, `cg_height`, `drive_front`, `brake_front`. The force itself moves
    load between the axles.
    """
    wheelbase = car.lf + car.lr
    front, rear, transfer = car.lr / wheelbase, car.lf / wheelbase, car.cg_height / wheelbase
    side = car.mass * lateral
    driving = min(
        axle_force_limit(car.drive_front, weight * front, side * front, -transfer, friction),
        axle_force_limit(1.0 - car.drive_front, weight * rear, side * rear, transfer, friction),
    )
    braking = min(
        axle_force_limit(car.brake_front, weight * front, side * front, transfer, friction),
        axle_force_limit(1.0 - car.brake_front, weight * rear, side * rear, -transfer, friction),
    )
    return driving, braking
