"""The single-track vehicle: lateral and yaw motion on two axles of two tyres each, eqs. (1)-(5)."""

from __future__ import annotations

from functools import cache

from ..kernel import exported, fma, inlined, vector, void
from ..maths.exact import clip
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine, fast_sine
from .contract import ADVANCE, OBSERVE, CompiledPlant
from .forces import GRAVITY, SLIP_SPEED_FLOOR, resistance, steering_rate, wind_load
from .runge_kutta import advance_all, observe_one, slope_of
from .tyre import TYRE_NAMES, lateral_force


@inlined
def right_hand_side(x, u, c, law):
    """Right-hand side of the single-track vehicle: eqs. (1), (3), (4), (5), with two tyres on each axle.

    The tyre is the linear one of eq. (2) or the Magic Formula, at the static load and the axle's mean friction.
    v_x follows the prescribed acceleration where there is one, else m(dv_x/dt - v_y r) = F_x - drag.
    """
    _, _, yaw, vx, vy, r, _, _, _, _, _, _, angle = x
    command, force, acceleration, mu0, mu1, mu2, mu3, wind_x, wind_y, bank = u
    ideal = c.steering_lag <= 0.0
    delta = clip(command, -c.steering_limit, c.steering_limit) if ideal else angle
    weight = 0.5 * c.mass * GRAVITY / (c.lf + c.lr)
    speed = max(vx, SLIP_SPEED_FLOOR)
    slip_f = delta - fast_arctangent_of_ratio(fma(c.lf, r, vy), speed)
    slip_r = -fast_arctangent_of_ratio(fma(-c.lr, r, vy), speed)
    front = lateral_force(slip_f, weight * c.lr, 0.5 * (mu0 + mu1), c.stiffness_front, c, law)
    rear = lateral_force(slip_r, weight * c.lf, 0.5 * (mu2 + mu3), c.stiffness_rear, c, law)
    side, moment, drag = wind_load(yaw, vx, vy, wind_x, wind_y, c)
    lateral = (2.0 * front + 2.0 * rear + side) * (1.0 / c.mass)
    yawing = (2.0 * c.lf * front - 2.0 * c.lr * rear + moment) * (1.0 / c.yaw_inertia)
    free = (force - resistance(vx, drag, c)) * (1.0 / c.mass) + vy * r
    dvx = free if acceleration != acceleration else acceleration
    s, co = fast_sine(yaw), fast_cosine(yaw)
    return (
        vx * co - vy * s,
        vx * s + vy * co,
        r,
        dvx,
        lateral + bank - vx * r,
        yawing,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0 if ideal else steering_rate(angle, command, c),
    )


@cache
def compiled(law: int) -> CompiledPlant:
    """The plant on tyres that follow a law, see `tyre`."""

    @exported(void(vector, vector, vector, vector), name=f"single_track_{TYRE_NAMES[law]}_derivative")
    def derivative(x, u, parameters, dx):
        slope_of(right_hand_side, x, u, parameters, dx, law)

    @exported(ADVANCE, name=f"single_track_{TYRE_NAMES[law]}_advance")
    def advance(member, parameters, block, states, work, slots, substeps, h):
        advance_all(right_hand_side, parameters, block, slots, (substeps, h), law)

    @exported(OBSERVE, name=f"single_track_{TYRE_NAMES[law]}_observe")
    def observe(member, parameters, block, states, work, slot, seen):
        observe_one(right_hand_side, parameters, block, slot, seen, law)

    return CompiledPlant(derivative, advance, observe)


for _law in TYRE_NAMES:
    compiled(_law)
