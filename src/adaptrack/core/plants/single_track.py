"""The single-track vehicle: lateral and yaw motion on two axles of two tyres each, eqs. (1)-(5)."""

from __future__ import annotations

from ..kernel import fma, inlined
from ..maths.exact import clip
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine, fast_sine
from ..physics import forces
from ..physics.forces import GRAVITY, SLIP_SPEED_FLOOR
from ..physics.tyre import lateral_force
from .contract import PlantState
from .runge_kutta import plants_on_tyres


@inlined
def right_hand_side(x, u, c, law):
    """Right-hand side of the single-track vehicle: eqs. (1), (3), (4), (5), with two tyres on each axle.

    The tyre is the linear one of eq. (2) or the Magic Formula, at the static load and the axle's mean friction.
    v_x follows the prescribed acceleration where there is one, else m(dv_x/dt - v_y r) = F_x - drag - m g sin(slope).
    """
    yaw, vx, vy, r = x.yaw, x.vx, x.vy, x.yaw_rate
    ideal = c.steering_lag <= 0.0
    delta = clip(u.command, -c.steering_limit, c.steering_limit) if ideal else x.steering
    sine, cosine = forces.slope_sine_and_cosine(u.grade)
    weight = 0.5 * c.mass * GRAVITY / (c.lf + c.lr) * cosine
    speed = max(vx, SLIP_SPEED_FLOOR)
    slip_f = delta - fast_arctangent_of_ratio(fma(c.lf, r, vy), speed)
    slip_r = -fast_arctangent_of_ratio(fma(-c.lr, r, vy), speed)
    mu_f = 0.5 * (u.friction_front_left + u.friction_front_right)
    mu_r = 0.5 * (u.friction_rear_left + u.friction_rear_right)
    front = lateral_force(slip_f, weight * c.lr, mu_f, c.stiffness_front, c, law)
    rear = lateral_force(slip_r, weight * c.lf, mu_r, c.stiffness_rear, c, law)
    side, moment, drag = forces.wind_load(yaw, vx, vy, u.wind_x, u.wind_y, c)
    lateral = (2.0 * front + 2.0 * rear + side) * (1.0 / c.mass)
    yawing = (2.0 * c.lf * front - 2.0 * c.lr * rear + moment) * (1.0 / c.yaw_inertia)
    pedals_act = u.acceleration != u.acceleration
    force = u.force + u.brake - u.brake * forces.brake_direction(vx, u, sine, c)
    free = (force - forces.resistance(vx, drag, cosine, c)) * (1.0 / c.mass) + vy * r - GRAVITY * sine
    stands = pedals_act and vx == 0.0 and forces.holding_reserve(u, sine, cosine, c) >= 0.0
    dvx = (0.0 if stands else free) if pedals_act else u.acceleration
    s, co = fast_sine(yaw), fast_cosine(yaw)
    return PlantState(
        x=vx * co - vy * s,
        y=vx * s + vy * co,
        yaw=r,
        vx=dvx,
        vy=0.0 if stands else lateral + u.bank - vx * r,
        yaw_rate=0.0 if stands else yawing,
        slip_front_left=0.0,
        slip_front_right=0.0,
        slip_rear_left=0.0,
        slip_rear_right=0.0,
        felt_ax=0.0,
        felt_ay=0.0,
        steering=0.0 if ideal else forces.steering_rate(x.steering, u.command, c),
    )


compiled = plants_on_tyres("single_track", right_hand_side)
