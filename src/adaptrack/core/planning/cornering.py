"""How hard a car can corner: the steady turn in which a tyre is at its peak, or the wheels at their limit.

Each axle carries its share of the car: m a l_r/L and m a l_f/L. Its two tyres pull at one slip angle under the loads
that roll leaves them, by the plant's tyre (`physics.tyre`); the front wheels, turned by delta = atan(L kappa) + alpha_f
- alpha_r, push sideways with cos(delta) of their force.
"""

from __future__ import annotations

import math

from ..kernel import exported, float64, inlined, record, vector, void
from ..maths.bits import whole
from ..maths.trigonometric import atan, cos, tan
from ..models.car import unpack
from ..physics.forces import GRAVITY
from ..physics.tyre import CURVED_MAGIC_FORMULA, LINEAR_TYRE, lateral_force

STEERING_LIMIT = math.pi / 6
"""rad, of the road wheels, where nobody says: the limit of the paper's table."""
BENDS = 25
"""Curvatures, evenly from 0 to the tightest that the wheels allow, at which the limit is looked for."""
_SLIPS, _LARGEST_SLIP = 401, 0.8
"""rad, of the tyres that are tried."""
_SHARES, _LARGEST_SHARE = 241, 1.2
"""Of mu g, that are tried."""
_STEEPEST = 1.5
"""rad, of the road wheels, that counts as a right angle."""

AxleLoads = record("AxleLoads", ("stiffness", "outer", "inner", "turned", "steered", "friction"))
"""N/rad; N, the loads of its tyres; rad, by which steered wheels are turned beyond their slip angle; 1 or 0; -."""


@inlined
def _slip_of(k):
    """The slip angle (rad) of this number."""
    return k * (_LARGEST_SLIP / (_SLIPS - 1))


@inlined
def _pull(k, axle, car):
    """Force (N) of an axle to the side at the slip angle of this number."""
    law, slip = LINEAR_TYRE if car.tyre_linear > 0.5 else CURVED_MAGIC_FORMULA, _slip_of(k)
    outer = lateral_force(slip, axle.outer, axle.friction, axle.stiffness, car, law)
    inner = lateral_force(slip, axle.inner, axle.friction, axle.stiffness, car, law)
    return (outer + inner) * cos(axle.steered * (axle.turned + slip))


@inlined
def _slip_for(share, axle, car):
    """The slip angle (rad) at which an axle pulls its share (N), up to its only peak; NaN where it cannot."""
    low, high = 0, _SLIPS - 1
    while high > low:
        middle = (low + high) // 2
        if _pull(middle + 1, axle, car) > _pull(middle, axle, car):
            low = middle + 1
        else:
            high = middle
    most = _pull(high, axle, car)
    if not most >= share:
        return math.nan
    if most == share:
        return _slip_of(high)
    low = 0
    while high - low > 1:
        middle = (low + high) // 2
        if _pull(middle, axle, car) <= share:
            low = middle
        else:
            high = middle
    near, high_pull = _pull(low, axle, car), _pull(high, axle, car)
    return _slip_of(low) + (_slip_of(high) - _slip_of(low)) / (high_pull - near) * (share - near)


@inlined
def _axle(acceleration, load, track, turned, steered, friction, car):
    """An axle in a turn, of a load (N) for each wheel at rest, and the share (N) that it must pull."""
    share = 2.0 * load / GRAVITY * acceleration
    moved = min(share * car.cg_height / track, 0.99 * load)
    stiffness = car.stiffness_front if steered > 0.0 else car.stiffness_rear
    return share, AxleLoads(stiffness, load + moved, load - moved, turned, steered, friction)


@inlined
def _is_held(acceleration, bend, most, friction, car):
    """Whether a car goes steadily round a bend (1/m) with wheels turned by `most` (rad) at most."""
    length = car.lf + car.lr
    per_length, turned = 0.5 * car.mass * GRAVITY / length, atan(length * bend)
    share, axle = _axle(acceleration, per_length * car.lf, car.track_rear, 0.0, 0.0, friction, car)
    rear = _slip_for(share, axle, car)
    share, axle = _axle(acceleration, per_length * car.lr, car.track_front, turned - rear, 1.0, friction, car)
    return turned + _slip_for(share, axle, car) - rear <= most  # NaN: a tyre is beyond its peak


@exported(float64(vector, float64, float64, vector))
def cornering_limits(plant, steering_limit, friction, limits):
    """Write the largest steady lateral acceleration (m/s^2) at `BENDS` curvatures evenly up to the tightest.

    The tightest (1/m) is the answer. plant: `PLANT_PARAMETERS`; steering_limit: rad, NaN: `STEERING_LIMIT`. What is
    held at an acceleration is held at a smaller one. A limit is 0 where the wheels cannot be turned so far at a crawl.
    """
    car = unpack(plant)
    most = STEERING_LIMIT if math.isnan(steering_limit) else steering_limit
    tightest = tan(min(most, _STEEPEST)) / (car.lf + car.lr)
    for j in range(BENDS):
        feasible, failed = 0, _SHARES
        while failed - feasible > 1:
            i = (feasible + failed) // 2
            acceleration = i * (_LARGEST_SHARE / (_SHARES - 1)) * friction * GRAVITY
            if _is_held(acceleration, tightest / (BENDS - 1) * j, most, friction, car):
                feasible = i
            else:
                failed = i
        limits[j] = feasible * (_LARGEST_SHARE / (_SHARES - 1)) * friction * GRAVITY
    return tightest


@inlined
def cornering_at(curvature, tightest, limits):
    """The limit (m/s^2) at a curvature (1/m), between those of `cornering_limits`; 0 beyond the tightest."""
    bend, step = abs(curvature), tightest / (BENDS - 1)
    if not bend <= tightest:
        return 0.0
    k = min(whole(bend / step), BENDS - 2)
    return (limits[k + 1] - limits[k]) / step * (bend - k * step) + limits[k]


@exported(void(float64, vector, vector))
def cornering_along(tightest, limits, curvatures):
    """Replace curvatures (1/m) by the limits there (m/s^2), of what `cornering_limits` gave."""
    for i in range(curvatures.size):
        curvatures[i] = cornering_at(curvatures[i], tightest, limits)
