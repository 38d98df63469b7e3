"""Equations of motion: single-track and dual-track vehicles, side wind, powertrain, steering actuator.

Axes and signs (ISO 8855): x forward, y left, z up; yaw, steering and slip angles positive to the left.
The wind is the velocity of the air in the ground frame.

A plant's state is a tuple of `STATES` floats, the same for both plants (what a plant does not use stays zero):

    0 X, 1 Y (m), 2 yaw (rad), 3 v_x, 4 v_y (m/s, body frame), 5 yaw rate (rad/s),
    6..9 relaxed slip angles of the tyres front-left, front-right, rear-left, rear-right (rad),
    10, 11 longitudinal and lateral acceleration as the wheel loads feel it (m/s^2), 12 steering angle (rad)
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from numba import types

from .abi import INLINE, PLANT_PARAMETERS, ROUTINE, fma, int64, njit, record, vector
from .maths.elementary import arctangent_of_ratio, clip, cosine, sine
from .tyre import LEAST_LOAD, LINEAR, friction_ellipse, lateral_force, tyre_law

GRAVITY = 9.80665
"""Standard acceleration of free fall (m/s^2)."""
SLIP_SPEED_FLOOR = 1.0
"""Slip angles are formed with at least this speed (m/s): tan(gamma) of eq. (4) is singular at standstill."""

STATES = 13
INPUTS = 9
"""Rows of an input: steering command (rad), longitudinal force (N), prescribed acceleration (m/s^2; NaN: none, the
force acts), friction of the four wheels, wind along X and Y (m/s)."""

SINGLE_TRACK, DUAL_TRACK, CUSTOM = 0, 1, 2

PLANT_SIGNATURE = types.void(vector, vector, vector, vector, vector)
"""A user's plant: ``derivative(x, u, environment, p, dx)`` writes dx/dt.

x: at least (X, Y, yaw, v_x, v_y, yaw rate), then the plant's own states; u: steering angle of the front wheels
(rad), longitudinal force demanded at the wheels (N); environment: friction of the four wheels, wind along X and Y;
p: the plant's own parameters.
"""
PLANT_FUNCTION = types.FunctionType(PLANT_SIGNATURE)

PlantParameters = record("PlantParameters", PLANT_PARAMETERS)


@njit(**INLINE)
def unpack(p):
    """The packed parameters by name, in the order of `abi.PLANT_PARAMETERS`."""
    return PlantParameters(
        p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], p[8], p[9], p[10], p[11],
        p[12], p[13], p[14], p[15], p[16], p[17], p[18], p[19], p[20], p[21], p[22], p[23],
        p[24], p[25], p[26], p[27], p[28], p[29], p[30], p[31], p[32], p[33],
    )  # fmt: skip


@njit(**INLINE)
def wind_load(yaw, vx, vy, wind_x, wind_y, c):
    """Side force (N), yaw moment (N m) and drag (N) of the air on the body.

    With the velocity of the vehicle relative to the air, V_rel, and its angle beta: q = rho A V_rel^2/2,
    side force q C_s(beta), yaw moment q L C_ym(beta), both coefficients proportional to beta up to
    `wind_angle_limit`, constant beyond, and odd: the mirrored wind gives the mirrored load. From behind, beta is
    measured from the tail. Drag q C_d along x.
    """
    s, co = sine(yaw), cosine(yaw)
    ux = vx - (co * wind_x + s * wind_y)
    uy = vy - (co * wind_y - s * wind_x)
    pressure = 0.5 * c.air_density * c.frontal_area * (ux * ux + uy * uy)
    angle = clip(arctangent_of_ratio(-uy, max(abs(ux), 1e-6)), -c.wind_angle_limit, c.wind_angle_limit)
    side = pressure * c.side_force_slope * angle
    moment = pressure * (c.lf + c.lr) * c.yaw_moment_slope * angle
    drag = 0.5 * c.air_density * c.frontal_area * c.drag_coefficient * ux * abs(ux)
    return side, moment, drag


@njit(**INLINE)
def resistance(vx, drag, c):
    """Drag and rolling resistance (N), against the motion; rolling fades in over the first 0.5 m/s."""
    return drag + c.rolling_resistance * c.mass * GRAVITY * clip(2.0 * vx, -1.0, 1.0)


@njit(**INLINE)
def steering_rate(angle, command, c):
    """First-order lag with a rate limit (rad/s); without lag the wheels follow the rate limit alone."""
    target = clip(command, -c.steering_limit, c.steering_limit)
    return clip((target - angle) * (1.0 / max(c.steering_lag, 1e-9)), -c.steering_rate, c.steering_rate)


@njit(**INLINE)
def single_track(x, u, c, law):
    """Right-hand side of the single-track vehicle: eqs. (1), (3), (4), (5), with two tyres on each axle.

    The tyre is the linear one of eq. (2) or the Magic Formula, at the static load and the axle's mean friction.
    v_x follows the prescribed acceleration where there is one, else m(dv_x/dt - v_y r) = F_x - drag.
    """
    _, _, yaw, vx, vy, r, _, _, _, _, _, _, angle = x
    command, force, acceleration, mu0, mu1, mu2, mu3, wind_x, wind_y = u
    ideal = c.steering_lag <= 0.0
    delta = clip(command, -c.steering_limit, c.steering_limit) if ideal else angle
    weight = 0.5 * c.mass * GRAVITY / (c.lf + c.lr)
    speed = max(vx, SLIP_SPEED_FLOOR)
    slip_f = delta - arctangent_of_ratio(fma(c.lf, r, vy), speed)
    slip_r = -arctangent_of_ratio(fma(-c.lr, r, vy), speed)
    front = lateral_force(slip_f, weight * c.lr, 0.5 * (mu0 + mu1), c.stiffness_front, c, law)
    rear = lateral_force(slip_r, weight * c.lf, 0.5 * (mu2 + mu3), c.stiffness_rear, c, law)
    side, moment, drag = wind_load(yaw, vx, vy, wind_x, wind_y, c)
    lateral = (2.0 * front + 2.0 * rear + side) * (1.0 / c.mass)
    yawing = (2.0 * c.lf * front - 2.0 * c.lr * rear + moment) * (1.0 / c.yaw_inertia)
    free = (force - resistance(vx, drag, c)) * (1.0 / c.mass) + vy * r
    dvx = free if acceleration != acceleration else acceleration
    s, co = sine(yaw), cosine(yaw)
    return (
        vx * co - vy * s,
        vx * s + vy * co,
        r,
        dvx,
        lateral - vx * r,
        yawing,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0 if ideal else steering_rate(angle, command, c),
    )


@njit(**INLINE)
def dual_track(x, u, c, law):
    """Right-hand side of the dual-track vehicle: longitudinal, lateral and yaw motion on four tyres.

    Loads: static, plus the transfer by height of the centre of gravity under the accelerations that the
    suspension has passed on (first-order lag `load_transfer_time`, which also opens the algebraic loop
    force -> acceleration -> load -> force). Slip angles relax over the length sigma:
    d(alpha')/dt = |v_x|(alpha - alpha')/sigma. Driving and braking forces share the friction ellipse with the
    lateral ones. A prescribed acceleration moves v_x without longitudinal tyre force.
    """
    _, _, yaw, vx, vy, r, s_fl, s_fr, s_rl, s_rr, ax, ay, angle = x
    command, force, acceleration, mu_fl, mu_fr, mu_rl, mu_rr, wind_x, wind_y = u
    ideal = c.steering_lag <= 0.0
    delta = clip(command, -c.steering_limit, c.steering_limit) if ideal else angle

    # vertical loads
    wheelbase = c.lf + c.lr
    pitch = (0.5 * c.mass * c.cg_height / wheelbase) * ax
    front_static = 0.5 * c.mass * GRAVITY * c.lr / wheelbase - pitch
    rear_static = 0.5 * c.mass * GRAVITY * c.lf / wheelbase + pitch
    roll = (c.mass * c.cg_height / wheelbase) * ay
    roll_front = roll * (c.lr / c.track_front)
    roll_rear = roll * (c.lf / c.track_rear)
    z_fl = max(front_static - roll_front, LEAST_LOAD)
    z_fr = max(front_static + roll_front, LEAST_LOAD)
    z_rl = max(rear_static - roll_rear, LEAST_LOAD)
    z_rr = max(rear_static + roll_rear, LEAST_LOAD)

    # slip angles, eqs. (3) and (4) at each wheel
    spread_f = 0.5 * c.track_front * r
    spread_r = 0.5 * c.track_rear * r
    side_f = fma(c.lf, r, vy)
    side_r = fma(-c.lr, r, vy)
    a_fl = delta - arctangent_of_ratio(side_f, max(vx - spread_f, SLIP_SPEED_FLOOR))
    a_fr = delta - arctangent_of_ratio(side_f, max(vx + spread_f, SLIP_SPEED_FLOOR))
    a_rl = -arctangent_of_ratio(side_r, max(vx - spread_r, SLIP_SPEED_FLOOR))
    a_rr = -arctangent_of_ratio(side_r, max(vx + spread_r, SLIP_SPEED_FLOOR))
    relaxed = c.relaxation_length > 0.0
    rate = max(abs(vx), SLIP_SPEED_FLOOR) * (1.0 / max(c.relaxation_length, 1e-9))
    b_fl, b_fr = (s_fl if relaxed else a_fl), (s_fr if relaxed else a_fr)
    b_rl, b_rr = (s_rl if relaxed else a_rl), (s_rr if relaxed else a_rr)

    # tyre forces in wheel axes
    y_fl = lateral_force(b_fl, z_fl, mu_fl, c.stiffness_front, c, law)
    y_fr = lateral_force(b_fr, z_fr, mu_fr, c.stiffness_front, c, law)
    y_rl = lateral_force(b_rl, z_rl, mu_rl, c.stiffness_rear, c, law)
    y_rr = lateral_force(b_rr, z_rr, mu_rr, c.stiffness_rear, c, law)
    sd, cd = sine(delta), cosine(delta)
    side, moment, drag = wind_load(yaw, vx, vy, wind_x, wind_y, c)
    driven = acceleration != acceleration
    demand = force if driven else 0.0
    share = c.drive_front if demand >= 0.0 else c.brake_front
    front_half, rear_half = 0.5 * share * demand, 0.5 * (1.0 - share) * demand
    x_fl = clip(front_half, -mu_fl * z_fl, mu_fl * z_fl)
    x_fr = clip(front_half, -mu_fr * z_fr, mu_fr * z_fr)
    x_rl = clip(rear_half, -mu_rl * z_rl, mu_rl * z_rl)
    x_rr = clip(rear_half, -mu_rr * z_rr, mu_rr * z_rr)
    if law != LINEAR:
        y_fl *= friction_ellipse(x_fl, z_fl, mu_fl)
        y_fr *= friction_ellipse(x_fr, z_fr, mu_fr)
        y_rl *= friction_ellipse(x_rl, z_rl, mu_rl)
        y_rr *= friction_ellipse(x_rr, z_rr, mu_rr)

    # forces of each wheel in body axes, then Newton and Euler
    bx_fl, bx_fr = x_fl * cd - y_fl * sd, x_fr * cd - y_fr * sd
    by_fl, by_fr = x_fl * sd + y_fl * cd, x_fr * sd + y_fr * cd
    lateral = (by_fl + by_fr + y_rl + y_rr + side) * (1.0 / c.mass)
    yawing = (
        c.lf * (by_fl + by_fr)
        - c.lr * (y_rl + y_rr)
        + 0.5 * c.track_front * (bx_fr - bx_fl)
        + 0.5 * c.track_rear * (x_rr - x_rl)
        + moment
    ) * (1.0 / c.yaw_inertia)
    free = (bx_fl + bx_fr + x_rl + x_rr - resistance(vx, drag, c)) * (1.0 / c.mass) + vy * r
    dvx = free if driven else acceleration
    s, co = sine(yaw), cosine(yaw)
    return (
        vx * co - vy * s,
        vx * s + vy * co,
        r,
        dvx,
        lateral - vx * r,
        yawing,
        rate * (a_fl - s_fl) if relaxed else 0.0,
        rate * (a_fr - s_fr) if relaxed else 0.0,
        rate * (a_rl - s_rl) if relaxed else 0.0,
        rate * (a_rr - s_rr) if relaxed else 0.0,
        (dvx - vy * r - ax) * (1.0 / c.load_transfer_time),
        (lateral - ay) * (1.0 / c.load_transfer_time),
        0.0 if ideal else steering_rate(angle, command, c),
    )


@njit(types.void(int64, vector, vector, vector, vector), **ROUTINE)
def derivative(kind, x, u, p, dx):
    """Write dx/dt (STATES,) of a built-in plant at state x (STATES,) and input u (INPUTS,)."""
    c = unpack(p)
    state = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], x[8], x[9], x[10], x[11], x[12])
    inputs = (u[0], u[1], u[2], u[3], u[4], u[5], u[6], u[7], u[8])
    law = tyre_law(c)
    if kind == SINGLE_TRACK:
        slope = single_track(state, inputs, c, law)
    else:
        slope = dual_track(state, inputs, c, law)
    dx[0], dx[1], dx[2], dx[3], dx[4], dx[5], dx[6] = slope[0:7]
    dx[7], dx[8], dx[9], dx[10], dx[11], dx[12] = slope[7:13]


@njit(PLANT_SIGNATURE, **ROUTINE)
def no_plant(x, u, environment, p, dx):
    """Stands where a user's plant would: the built-in ones do not call it."""


@lru_cache(maxsize=64)
def compile_plant(function: Any) -> Any:
    """A user's right-hand side, compiled for `PLANT_SIGNATURE`; numba's own error when it cannot be."""
    plain = getattr(function, "py_func", function)
    return njit(PLANT_SIGNATURE, nogil=True, error_model="numpy")(plain)
