"""Right-hand sides around CommonRoad's vehicle models: their functions between our states, inputs and wind.

Theirs: Althoff and Würsching, *CommonRoad: Vehicle Models*, 2020; functions ``f(x, (steering rate, acceleration), p)``
on records of their parameters. What is added: the steering angle comes from outside, behind our actuator (its rate
counts in their kinematic model only, below some 0.3 m/s, and is left out); air as of our own plants; a bank; and
the road's friction, which replaces the peak friction p_dy1 of their tyre, p_dx1 in proportion: stiffness stays, as
with the scaling factor lambda_mu of the Magic Formula (Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., section 4.3).
Their functions take one tyre: the friction is the mean of the four wheels.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from ..kernel import Caller, address_of, columns, float64, inlined, vector, void
from ..maths.exact import clip, sqrt
from ..maths.trigonometric import atan2, cos, sin
from .forces import wind_load
from .user import U

AROUND = columns("front_left", "front_right", "rear_left", "rear_right", "wind_x", "wind_y", "bank")
"""Entries of an environment."""
SLOWEST_WHEELS = 8.0
"""m/s: below it wheels are spun up more slowly, in proportion to the speed. The rate with which their slip settles,
stiffness times R^2/(inertia times speed), then stays what it is there, 400 to 1,500 1/s, and the step may stay too."""

_X, _Y, _DELTA, _VX, _YAW, _R = range(
    6
)  # states that both of their models begin with; _VX: the speed of the drift model
_BETA, _OMEGA_FRONT, _OMEGA_REAR = 6, 7, 8  # of the drift model
_ROLL_RATE, _VY, _VY_FRONT, _VY_REAR, _OMEGA = 7, 10, 15, 20, 23  # of the multi-body model
DRIFT_STATES = ("wheel_speed_front", "wheel_speed_rear")
"""rad/s, the drift model's states behind X, Y, yaw, v_x, v_y and yaw rate."""
BODY_STATES = (
    "roll", "roll_rate", "pitch", "pitch_rate", "z", "vz",
    "roll_front", "roll_rate_front", "vy_front", "z_front", "vz_front",
    "roll_rear", "roll_rate_rear", "vy_rear", "z_rear", "vz_rear",
    "wheel_speed_front_left", "wheel_speed_front_right", "wheel_speed_rear_left", "wheel_speed_rear_right",
    "joint_front", "joint_rear",
)  # fmt: skip
"""The multi-body model's states behind those six: rad, m and s; z downwards; joints: lateral, m."""
BODY_PLACES = (_X, _Y, _YAW, _VX, _VY, _R, 6, 7, 8, 9, *range(11, 29))
"""Where each of our states stands among theirs; their steering angle is none of ours."""


DYNAMICS = void(vector, float64, vector, vector)
"""``dynamics(x, acceleration, p, f)``: one of their models on vectors, p the parameters in the order of the layout."""
_call = Caller(DYNAMICS)


@inlined
def _as_it_is(car):
    return car


def _plain(car):
    """A NumPy record as a namespace: some parameters are called as methods of records are, min and max."""
    return SimpleNamespace(
        **{name: _plain(car[name]) if car[name].dtype.names else float(car[name]) for name in car.dtype.names}
    )


def _dynamics(function, layout):
    """One of their models (`DYNAMICS`) by its address, as it is long: what calls it need not be compiled with it."""
    from ..member import compiles, member

    given = _as_it_is if compiles() else _plain

    def dynamics(x, acceleration, p, f):
        slopes = function(x, (0.0, acceleration), given(p.view(layout)[0].car))
        for i in range(f.size):
            f[i] = slopes[i]

    return address_of(member(dynamics, DYNAMICS)) if compiles() else dynamics


@inlined
def _set_friction(environment, own, places):
    """Give a copy of the parameters the mean friction of the wheels; places: of p_dx1 and p_dy1."""
    along, across = places
    friction = 0.25 * (environment[0] + environment[1] + environment[2] + environment[3])
    own[along] *= friction / own[across]
    own[across] = friction


@inlined
def _asked(u, mass):
    """The acceleration (m/s^2) that is prescribed, or that the force is for."""
    return u[U.acceleration] if u[U.acceleration] == u[U.acceleration] else u[U.force] / mass


@inlined
def _spin_up(speed):
    """Share of a wheel's angular acceleration at this speed (m/s), see `SLOWEST_WHEELS`."""
    return clip(speed / SLOWEST_WHEELS, 0.0, 1.0)


def drift_right_hand_side(function: Any, layout: Any, places: tuple[int, int]) -> Any:
    """The right-hand side (`user.RIGHT_HAND_SIDE`, to be compiled) around their drift model, compiled.

    layout: of the parameters, a record `car` of theirs and a record `air` as `forces.wind_load` takes it; places: of
    p_dx1 and p_dy1 in the vector of the parameters.
    """
    theirs = _dynamics(function, layout)

    def right_hand_side(x, u, environment, p, dx):
        own, z, f = p.copy(), np.empty(9), np.empty(9)
        _set_friction(environment, own, places)
        given = own.view(layout)[0]
        yaw, vx, vy, mass = x[2], x[3], x[4], given.car.m
        speed, beta = sqrt(vx * vx + vy * vy), atan2(vy, vx)
        z[_X], z[_Y], z[_DELTA], z[_VX], z[_YAW] = x[0], x[1], u[U.steering], speed, yaw
        z[_R], z[_BETA], z[_OMEGA_FRONT], z[_OMEGA_REAR] = x[5], beta, x[6], x[7]
        _call(theirs, z, _asked(u, mass), own, f)
        wind_x, wind_y = environment[AROUND.wind_x], environment[AROUND.wind_y]
        side, moment, drag = wind_load(yaw, vx, vy, wind_x, wind_y, given.air)
        c, s = cos(beta), sin(beta)
        dx[0], dx[1], dx[2] = f[_X], f[_Y], f[_YAW]
        dx[3] = c * f[_VX] - s * speed * f[_BETA] - drag / mass
        dx[4] = s * f[_VX] + c * speed * f[_BETA] + side / mass + environment[AROUND.bank]
        dx[5] = f[_R] + moment / given.car.I_z
        dx[6], dx[7] = _spin_up(vx) * f[_OMEGA_FRONT], _spin_up(vx) * f[_OMEGA_REAR]

    return right_hand_side


def body_right_hand_side(function: Any, layout: Any, places: tuple[int, int]) -> Any:
    """The right-hand side around their multi-body model; arguments as for `drift_right_hand_side`."""
    theirs, where, ours = _dynamics(function, layout), np.array(BODY_PLACES), len(BODY_PLACES)

    def right_hand_side(x, u, environment, p, dx):
        own, z, f = p.copy(), np.empty(29), np.empty(29)
        _set_friction(environment, own, places)
        given = own.view(layout)[0]
        car = given.car
        z[_DELTA] = u[U.steering]
        for i in range(ours):
            z[where[i]] = x[i]
        _call(theirs, z, _asked(u, car.m), own, f)
        wind_x, wind_y, bank = environment[AROUND.wind_x], environment[AROUND.wind_y], environment[AROUND.bank]
        side, moment, drag = wind_load(x[2], x[3], x[4], wind_x, wind_y, given.air)
        f[_VX] -= drag / car.m
        f[_R] += moment / (car.I_z - car.I_xz_s * car.I_xz_s / car.I_Phi_s)
        f[_ROLL_RATE] += car.I_xz_s * moment / (car.I_z * car.I_Phi_s - car.I_xz_s * car.I_xz_s)
        f[_VY] += side / car.m_s + bank
        f[_VY_FRONT] += bank
        f[_VY_REAR] += bank
        for wheel in range(_OMEGA, _OMEGA + 4):
            f[wheel] *= _spin_up(x[3])
        for i in range(ours):
            dx[i] = f[where[i]]

    return right_hand_side
