"""The dual-track vehicle: longitudinal, lateral and yaw motion on four tyres."""

from __future__ import annotations

from ..kernel import fma, inlined
from ..maths.exact import clip
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine, fast_sine
from ..physics import forces
from ..physics.forces import GRAVITY, SLIP_SPEED_FLOOR
from ..physics.tyre import LEAST_LOAD, LINEAR_TYRE, friction_ellipse, lateral_force
from .contract import PlantState
from .runge_kutta import plants_on_tyres


@inlined
def right_hand_side(x, u, c, law):
    """Right-hand side of the dual-track vehicle: longitudinal, lateral and yaw motion on four tyres.

    Loads: static, plus the transfer by height of the centre of gravity under the accelerations that the
    suspension has passed on (first-order lag `load_transfer_time`, which also opens the algebraic loop
    force -> acceleration -> load -> force); the slope of the road counts as an acceleration. Slip angles relax over
    the length sigma: d(alpha')/dt = |v_x|(alpha - alpha')/sigma. Driving and braking forces share the friction ellipse
    with the lateral ones. A prescribed acceleration moves v_x without longitudinal tyre force. A car at rest stays so
    as long as its brakes hold it.
    """
    yaw, vx, vy, r = x.yaw, x.vx, x.vy, x.yaw_rate
    mu_fl, mu_fr = u.friction_front_left, u.friction_front_right
    mu_rl, mu_rr = u.friction_rear_left, u.friction_rear_right
    ideal = c.steering_lag <= 0.0
    delta = clip(u.command, -c.steering_limit, c.steering_limit) if ideal else x.steering

    # vertical loads
    sine, cosine = forces.slope_sine_and_cosine(u.grade)
    wheelbase = c.lf + c.lr
    pitch = (0.5 * c.mass * c.cg_height / wheelbase) * x.felt_ax
    front_static = 0.5 * c.mass * GRAVITY * c.lr / wheelbase * cosine - pitch
    rear_static = 0.5 * c.mass * GRAVITY * c.lf / wheelbase * cosine + pitch
    roll = (c.mass * c.cg_height / wheelbase) * x.felt_ay
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
    a_fl = delta - fast_arctangent_of_ratio(side_f, max(vx - spread_f, SLIP_SPEED_FLOOR))
    a_fr = delta - fast_arctangent_of_ratio(side_f, max(vx + spread_f, SLIP_SPEED_FLOOR))
    a_rl = -fast_arctangent_of_ratio(side_r, max(vx - spread_r, SLIP_SPEED_FLOOR))
    a_rr = -fast_arctangent_of_ratio(side_r, max(vx + spread_r, SLIP_SPEED_FLOOR))
    relaxed = c.relaxation_length > 0.0
    rate = max(abs(vx), SLIP_SPEED_FLOOR) * (1.0 / max(c.relaxation_length, 1e-9))
    b_fl, b_fr = (x.slip_front_left if relaxed else a_fl), (x.slip_front_right if relaxed else a_fr)
    b_rl, b_rr = (x.slip_rear_left if relaxed else a_rl), (x.slip_rear_right if relaxed else a_rr)

    # tyre forces in wheel axes
    y_fl = lateral_force(b_fl, z_fl, mu_fl, c.stiffness_front, c, law)
    y_fr = lateral_force(b_fr, z_fr, mu_fr, c.stiffness_front, c, law)
    y_rl = lateral_force(b_rl, z_rl, mu_rl, c.stiffness_rear, c, law)
    y_rr = lateral_force(b_rr, z_rr, mu_rr, c.stiffness_rear, c, law)
    sd, cd = fast_sine(delta), fast_cosine(delta)
    side, moment, drag = forces.wind_load(yaw, vx, vy, u.wind_x, u.wind_y, c)
    pedals_act = u.acceleration != u.acceleration
    drive = u.force + u.brake if pedals_act else 0.0
    brake = u.brake * forces.brake_direction(vx, u, sine, c) if pedals_act else 0.0
    front_half = 0.5 * (c.drive_front * drive - c.brake_front * brake)
    rear_half = 0.5 * ((1.0 - c.drive_front) * drive - (1.0 - c.brake_front) * brake)
    x_fl = clip(front_half, -mu_fl * z_fl, mu_fl * z_fl)
    x_fr = clip(front_half, -mu_fr * z_fr, mu_fr * z_fr)
    x_rl = clip(rear_half, -mu_rl * z_rl, mu_rl * z_rl)
    x_rr = clip(rear_half, -mu_rr * z_rr, mu_rr * z_rr)
    if law != LINEAR_TYRE:
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
    along = bx_fl + bx_fr + x_rl + x_rr - forces.resistance(vx, drag, cosine, c)
    free = along * (1.0 / c.mass) + vy * r - GRAVITY * sine
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
        slip_front_left=rate * (a_fl - x.slip_front_left) if relaxed else 0.0,
        slip_front_right=rate * (a_fr - x.slip_front_right) if relaxed else 0.0,
        slip_rear_left=rate * (a_rl - x.slip_rear_left) if relaxed else 0.0,
        slip_rear_right=rate * (a_rr - x.slip_rear_right) if relaxed else 0.0,
        felt_ax=(dvx - vy * r + GRAVITY * sine - x.felt_ax) * (1.0 / c.load_transfer_time),
        felt_ay=(lateral - x.felt_ay) * (1.0 / c.load_transfer_time),
        steering=0.0 if ideal else forces.steering_rate(x.steering, u.command, c),
    )


compiled = plants_on_tyres("dual_track", right_hand_side)
