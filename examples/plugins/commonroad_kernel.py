"""Right-hand sides around CommonRoad's vehicle models: their functions between our states, inputs and wind.

Theirs: Althoff and Würsching, *CommonRoad: Vehicle Models*, 2020; functions ``f(x, (steering rate, acceleration), p)``
on records of their parameters. What is added: the steering angle comes from outside, behind our actuator (its rate
counts in their kinematic model only, below some 0.3 m/s, and is left out); air as of our own plants; a bank; and
the road's friction, which replaces the peak friction p_dy1 of their tyre, p_dx1 in proportion: stiffness stays, as
with the scaling factor lambda_mu of the Magic Formula (Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., section 4.3).
Their functions take one tyre: the friction is the mean of the four wheels.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from adaptrack.core.public import (
    MOTION_STATES,
    PLANT_INPUT,
    PlantState,
    atan2,
    clip,
    columns,
    cos,
    inlined,
    sin,
    sqrt,
    wind_load,
)

AROUND = columns("front_left", "front_right", "rear_left", "rear_right", "wind_x", "wind_y", "bank")
"""Entries of an environment."""
SLOWEST_WHEELS = 8.0
"""m/s: below it wheels are spun up more slowly, in proportion to the speed. The rate with which their slip settles,
stiffness times R^2/(inertia times speed), then stays what it is there, 400 to 1,500 1/s, and the step may stay too."""

DRIFT_STATES = ("wheel_speed_front", "wheel_speed_rear")
"""rad/s, the drift model's states behind X, Y, yaw, v_x, v_y and yaw rate."""
MB_STATES = (
    "roll", "roll_rate", "pitch", "pitch_rate", "z", "vz",
    "roll_front", "roll_rate_front", "vy_front", "z_front", "vz_front",
    "roll_rear", "roll_rate_rear", "vy_rear", "z_rear", "vz_rear",
    "wheel_speed_front_left", "wheel_speed_front_right", "wheel_speed_rear_left", "wheel_speed_rear_right",
    "joint_front", "joint_rear",
)  # fmt: skip
"""The multi-body model's states behind those six: rad, m and s; z downwards; joints: lateral, m."""
_MOTION = PlantState._fields[:MOTION_STATES]
OWN = columns(*_MOTION, *DRIFT_STATES)
"""Our states of the drift model, the first ones of both."""
STD = columns("x", "y", "steering", "speed", "yaw", "yaw_rate", "sideslip", *DRIFT_STATES)
MB = columns("x", "y", "steering", "vx", "yaw", "yaw_rate", *MB_STATES[:4], "vy", *MB_STATES[4:])
"""Their states of the drift and of the multi-body model, by the names of their functions."""
MB_PLACES = tuple(getattr(MB, name) for name in (*_MOTION, *MB_STATES))
"""Where each of our states stands among theirs; their steering angle is none of ours."""


def _dynamics(function, layout):
    """One of their models on vectors, p the parameters in the order of the layout."""

    def dynamics(x, acceleration, p, f):
        slopes = function(x, (0.0, acceleration), p.view(layout)[0].car)
        for i in range(f.size):
            f[i] = slopes[i]

    return dynamics


@inlined
def _set_friction(environment, own, places):
    """Give a copy of the parameters the mean friction of the wheels; places: of p_dx1 and p_dy1."""
    along, across = places
    front = environment[AROUND.front_left] + environment[AROUND.front_right]
    friction = 0.25 * (front + environment[AROUND.rear_left] + environment[AROUND.rear_right])
    own[along] *= friction / own[across]
    own[across] = friction


@inlined
def _requested(u, mass):
    """The acceleration (m/s^2) that is prescribed, or that the force is for."""
    prescribed = u[PLANT_INPUT.acceleration]
    return prescribed if prescribed == prescribed else u[PLANT_INPUT.force] / mass


@inlined
def _spin_up(speed):
    """Share of a wheel's angular acceleration at this speed (m/s), see `SLOWEST_WHEELS`."""
    return clip(speed / SLOWEST_WHEELS, 0.0, 1.0)


def drift_right_hand_side(function: Any, layout: Any, places: tuple[int, int]) -> Any:
    """The right-hand side (`core.plants.user.RIGHT_HAND_SIDE`, to be compiled) around their drift model, compiled.

    layout: of the parameters, a record `car` of theirs and a record `air` as `wind_load` takes it; places: of
    p_dx1 and p_dy1 in the vector of the parameters.
    """
    theirs, n, count = _dynamics(function, layout), len(STD), layout.itemsize // 8

    def right_hand_side(x, u, environment, p, dx):
        own, z, f = np.empty(count), np.empty(n), np.empty(n)
        own[:] = p
        _set_friction(environment, own, places)
        given = own.view(layout)[0]
        yaw, vx, vy, mass = x[OWN.yaw], x[OWN.vx], x[OWN.vy], given.car.m
        speed, sideslip = sqrt(vx * vx + vy * vy), atan2(vy, vx)
        z[STD.x], z[STD.y], z[STD.steering] = x[OWN.x], x[OWN.y], u[PLANT_INPUT.steering]
        z[STD.speed], z[STD.yaw], z[STD.yaw_rate] = speed, yaw, x[OWN.yaw_rate]
        z[STD.sideslip] = sideslip
        z[STD.wheel_speed_front], z[STD.wheel_speed_rear] = x[OWN.wheel_speed_front], x[OWN.wheel_speed_rear]
        theirs(z, _requested(u, mass), own, f)
        wind_x, wind_y = environment[AROUND.wind_x], environment[AROUND.wind_y]
        side, moment, drag = wind_load(yaw, vx, vy, wind_x, wind_y, given.air)
        c, s = cos(sideslip), sin(sideslip)
        dx[OWN.x], dx[OWN.y], dx[OWN.yaw] = f[STD.x], f[STD.y], f[STD.yaw]
        dx[OWN.vx] = c * f[STD.speed] - s * speed * f[STD.sideslip] - drag / mass
        dx[OWN.vy] = s * f[STD.speed] + c * speed * f[STD.sideslip] + side / mass + environment[AROUND.bank]
        dx[OWN.yaw_rate] = f[STD.yaw_rate] + moment / given.car.I_z
        dx[OWN.wheel_speed_front] = _spin_up(vx) * f[STD.wheel_speed_front]
        dx[OWN.wheel_speed_rear] = _spin_up(vx) * f[STD.wheel_speed_rear]

    return right_hand_side


def mb_right_hand_side(function: Any, layout: Any, places: tuple[int, int]) -> Any:
    """The right-hand side around their multi-body model; arguments as for `drift_right_hand_side`."""
    theirs, where, ours, n = _dynamics(function, layout), np.array(MB_PLACES), len(MB_PLACES), len(MB)
    count = layout.itemsize // 8

    def right_hand_side(x, u, environment, p, dx):
        own, z, f = np.empty(count), np.empty(n), np.empty(n)
        own[:] = p
        _set_friction(environment, own, places)
        given = own.view(layout)[0]
        car = given.car
        z[MB.steering] = u[PLANT_INPUT.steering]
        for i in range(ours):
            z[where[i]] = x[i]
        theirs(z, _requested(u, car.m), own, f)
        wind_x, wind_y, bank = environment[AROUND.wind_x], environment[AROUND.wind_y], environment[AROUND.bank]
        side, moment, drag = wind_load(x[OWN.yaw], x[OWN.vx], x[OWN.vy], wind_x, wind_y, given.air)
        f[MB.vx] -= drag / car.m
        f[MB.yaw_rate] += moment / (car.I_z - car.I_xz_s * car.I_xz_s / car.I_Phi_s)
        f[MB.roll_rate] += car.I_xz_s * moment / (car.I_z * car.I_Phi_s - car.I_xz_s * car.I_xz_s)
        f[MB.vy] += side / car.m_s + bank
        f[MB.vy_front] += bank
        f[MB.vy_rear] += bank
        for wheel in range(MB.wheel_speed_front_left, MB.wheel_speed_rear_right + 1):
            f[wheel] *= _spin_up(x[OWN.vx])
        for i in range(ours):
            dx[i] = f[where[i]]

    return right_hand_side
