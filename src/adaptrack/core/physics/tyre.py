"""Tyre forces: the Magic Formula, the linear tyre, their dependence on load and friction.

Plants and speed plans have the tyre of the car file, `lateral_force`. Estimators, prediction and identification have a
`TyreCurve`; the learner has its own (`estimators.learning`). Guard and governor have none: what an axle that is at its
limit sideways has left along the road is the friction ellipse (`physics.forces.axle_force_limit`).

Slip angles and forces are positive to the left (ISO 8855): a wheel turned left of its velocity pushes left.
"""

from __future__ import annotations

import math

from ..kernel import inlined, record
from ..maths.exact import sqrt
from ..maths.exponential import power
from ..maths.fast import fast_arctangent_of_ratio, fast_cosine, fast_sine
from ..maths.trigonometric import asin, tan

LEAST_LOAD = 1.0
"""A wheel never carries less than this (N): a lifted wheel keeps a harmless force instead of a division by zero."""


LINEAR_TYRE, MAGIC_FORMULA, CURVED_MAGIC_FORMULA = 0, 1, 2
"""Tyre laws: linear; Magic Formula with E = 0, which saves an arctangent; Magic Formula."""
TYRE_NAMES = {LINEAR_TYRE: "linear", MAGIC_FORMULA: "magic", CURVED_MAGIC_FORMULA: "curved"}


@inlined
def tyre_law(linear: bool, curvature: float) -> int:
    """The law that a tyre's parameters ask for."""
    if linear:
        return LINEAR_TYRE
    return MAGIC_FORMULA if curvature == 0.0 else CURVED_MAGIC_FORMULA


@inlined
def lateral_force(slip, load, friction, stiffness, c, law):
    """Lateral force (N) of one tyre at a slip angle (rad), a vertical load (N) and a friction coefficient.

    Cornering stiffness at a load, q = F_z/F_z,nominal: C_alpha = C (s0 + s1 q)/(1 + s2 q^2). (1, 0, 0) is constant,
    (0, 1, 0) proportional, (0, 1 + 1/p^2, 1/p^2) Pacejka's digressive law C sin(2 atan(q/p)), normalised to C at
    q = 1 (Tire and Vehicle Dynamics, 3rd ed., eq. 4.E25).

    Linear (the authors' released plant): F = C_alpha mu alpha.
    Magic Formula (Pacejka, eq. 4.E19 without shifts): F = D sin(C atan(B a - E (B a - atan B a))),
    D = mu F_z (1 - d (q - 1)), B = C_alpha/(C D): the slope at the origin is the cornering stiffness. The load
    takes at most nine tenths of the friction.
    """
    q = load * (1.0 / c.nominal_load)
    rise = stiffness * (c.stiffness_load_0 + c.stiffness_load_1 * q)
    fall = 1.0 + c.stiffness_load_2 * q * q
    if law == LINEAR_TYRE:
        return rise / fall * friction * slip
    peak = friction * load * max(1.0 - c.friction_load_sensitivity * (q - 1.0), 0.1)
    # B alpha stays the ratio reach/scale: the arctangent divides once, and nothing else does
    scale = c.shape * max(peak, 1e-3) * fall
    reach = rise * slip
    if law == CURVED_MAGIC_FORMULA:
        reach = reach - c.curvature * (reach - scale * fast_arctangent_of_ratio(reach, scale))
    return peak * fast_sine(c.shape * fast_arctangent_of_ratio(reach, scale))


@inlined
def friction_ellipse(longitudinal: float, load: float, friction: float) -> float:
    """Share of the lateral force that is left beside a longitudinal force: sqrt(1 - (F_x/(mu F_z))^2), >= 0.1."""
    used = longitudinal / max(friction * load, 1e-3)
    return sqrt(max(1.0 - used * used, 0.01))


BRUSH_SHAPE = -1.0
"""Shape of a brush tyre's curve; a Magic Formula has its C, above 1."""
TyreCurve = record("TyreCurve", ("peak", "stiffness", "shape"))
"""Lateral force over slip angle, of a tyre or an axle: largest force (N), slope at no slip (N/rad), shape."""


@inlined
def curve(load, stiffness, friction, shape):
    """`TyreCurve` of a tyre or an axle at a load (N); stiffness: N/rad, at this load."""
    return TyreCurve(max(friction * load, 1e-3), stiffness, shape)


@inlined
def force_and_slope(slip, tyre):
    """Lateral force (N) at a slip angle (rad) on a `TyreCurve`, and its derivative by the slip angle (N/rad).

    Magic Formula: F = D sin(C atan x), x = stiffness slip/(C D). Brush: F = D (1 - (1 - z)^3), z = C x/3.
    """
    reach = tyre.stiffness * slip
    if tyre.shape < 0.0:
        left = max(1.0 - abs(reach) / (3.0 * tyre.peak), 0.0)
        return math.copysign(tyre.peak * (1.0 - left * left * left), slip), tyre.stiffness * left * left
    scale = tyre.shape * tyre.peak
    angle = tyre.shape * fast_arctangent_of_ratio(reach, scale)
    slope = tyre.stiffness * fast_cosine(angle) * (scale * scale / (scale * scale + reach * reach))
    return tyre.peak * fast_sine(angle), slope


@inlined
def reach_at(used, shape):
    """Slip angle times stiffness, over the largest force, where a Magic Formula pulls a share of that force.

    used: -, below 1. It is the inverse of `force_and_slope` up to the peak.
    """
    return shape * tan(asin(used) / shape)


@inlined
def brush_slope(used: float) -> float:
    """Slope of a brush tyre's curve over that at no slip, at a used share of its grip: (1 - s)^(2/3), 0 from s = 1 on.

    With z a third of stiffness times slip over friction times load, F = friction load (1 - (1 - z)^3), so that the
    slope is (1 - z)^2 (Pacejka, Tire and Vehicle Dynamics, 3rd ed., eq. 3.7). The Magic Formula of a car's tyre lies
    above it up to about 0.8 of the grip.
    """
    return power(max(1.0 - abs(used), 0.0), 2.0 / 3.0)
