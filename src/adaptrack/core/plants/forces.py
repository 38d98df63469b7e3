"""What all built-in plants share: wind load, driving resistance, the steering actuator."""

from __future__ import annotations

from ..kernel import inlined
from ..maths.exact import clip
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine, fast_sine

GRAVITY = 9.80665
"""Standard acceleration of free fall (m/s^2)."""
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
def resistance(vx, drag, c):
    """Drag and rolling resistance (N), against the motion; rolling fades in over the first 0.5 m/s."""
    return drag + c.rolling_resistance * c.mass * GRAVITY * clip(2.0 * vx, -1.0, 1.0)


@inlined
def steering_rate(angle, command, c):
    """First-order lag with a rate limit (rad/s); without lag the wheels follow the rate limit alone."""
    target = clip(command, -c.steering_limit, c.steering_limit)
    return clip((target - angle) * (1.0 / max(c.steering_lag, 1e-9)), -c.steering_rate, c.steering_rate)


@inlined
def wheel_angle(steering, command, lag, limit):
    """Angle of the front wheels (rad): the actuator's state, or the command where there is no lag."""
    return steering if lag > 0.0 else clip(command, -limit, limit)
