"""What all built-in plants share: wind load, driving resistance, slope, standstill, the steering actuator; and what the
axles of a car can take along the road beside their lateral forces.
"""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exact import clip, sqrt, square
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine, fast_sine

GRAVITY = 9.80665
"""Standard acceleration of free fall (m/s^2)."""
STANDING_SPEED = 0.05
"""m/s, below which a car counts as standing."""
SLIP_SPEED_FLOOR = 1.0
"""Slip angles are formed with at least this speed (m/s): tan(gamma) of eq. (4) is singular at standstill."""


@inlined
def wind_load(yaw, vx, vy, wind_x, wind_y, c):
    """Side force (N), yaw moment (N m) and drag (N) of the air on the body.

    With the velocity of the vehicle relative to the air, V_rel, and its angle beta: q = rho A V_rel^2/2,
    side force q C_s(beta), yaw moment q L C_ym(beta), both coefficients proportional to beta up to
    `wind_angle_limit`, constant beyond, and odd: the mirrored wind gives the mirrored load. From behind, beta is
    measured from the tail. Drag q C_d along x.
    """
    s, co = fast_sine(yaw), fast_cosine(yaw)
    ux = vx - (co * wind_x + s * wind_y)
    uy = vy - (co * wind_y - s * wind_x)
    pressure = 0.5 * c.air_density * c.frontal_area * (ux * ux + uy * uy)
    angle = clip(fast_arctangent_of_ratio(-uy, max(abs(ux), 1e-6)), -c.wind_angle_limit, c.wind_angle_limit)
    side = pressure * c.side_force_slope * angle
    moment = pressure * (c.lf + c.lr) * c.yaw_moment_slope * angle
    drag = 0.5 * c.air_density * c.frontal_area * c.drag_coefficient * ux * abs(ux)
    return side, moment, drag


@inlined
def slope_sine_and_cosine(grade):
    """Sine and cosine of the slope of a road with a grade dz/ds."""
    cosine = 1.0 / sqrt(1.0 + grade * grade)
    return grade * cosine, cosine


@inlined
def resistance(vx, drag, cosine, c):
    """Drag and rolling resistance (N), against the motion; rolling fades in over the first 0.5 m/s.

    cosine: of the slope.
    """
    return drag + c.rolling_resistance * c.mass * GRAVITY * clip(2.0 * vx, -1.0, 1.0) * cosine


@inlined
def holding_reserve(u, sine, cosine, c):
    """Force (N) by which brakes and rolling resistance exceed what drive and slope exert on a car; below 0 it moves.

    The brakes hold with their force, at most with the friction of all wheels: the stick condition of dry friction.
    """
    weight = c.mass * GRAVITY
    friction = 0.25 * (u.friction_front_left + u.friction_front_right + u.friction_rear_left + u.friction_rear_right)
    holding_force = min(u.brake, friction * weight * cosine) + c.rolling_resistance * weight * cosine
    return holding_force - abs(u.force + u.brake - weight * sine)


@inlined
def brake_direction(vx, u, sine, c):
    """Direction in which a car rolls, 1 forward or -1: the brakes act against it; at rest that of the slope's pull."""
    forward = vx > 0.0 or (vx == 0.0 and u.force + u.brake >= c.mass * GRAVITY * sine)
    return 1.0 if forward else -1.0


@inlined
def stops(vx_before, vx_after, h, u, c):
    """Whether a car comes to rest within a step of h (s) from one speed (m/s) to another under its drive and brakes.

    A step that reverses the motion, or whose reserve of holding force does, ends at rest; a prescribed speed is kept.
    """
    sine, cosine = slope_sine_and_cosine(u.grade)
    reserve = holding_reserve(u, sine, cosine, c)
    reverses = vx_before * vx_after <= 0.0 or c.mass * abs(vx_before) <= reserve * h
    return u.acceleration != u.acceleration and reserve >= 0.0 and reverses


@inlined
def steering_rate(angle, command, c):
    """First-order lag with a rate limit (rad/s); without lag the wheels follow the rate limit alone."""
    target = clip(command, -c.steering_limit, c.steering_limit)
    return clip((target - angle) * (1.0 / max(c.steering_lag, 1e-9)), -c.steering_rate, c.steering_rate)


@inlined
def wheel_angle(steering, command, lag, limit):
    """Angle of the front wheels (rad): the actuator's state, or the command where there is no lag."""
    return steering if lag > 0.0 else clip(command, -limit, limit)


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
