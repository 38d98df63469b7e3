"""Pure pursuit: steer the circular arc that leads the rear axle to a point of the path ahead."""

from __future__ import annotations

import math

from ..kernel import exported, record, unpacker, viewer
from ..maths.exponential import hypot
from ..maths.trigonometric import atan2, cos, sin
from . import contract

PURSUIT_TUNING = ("lookahead_time", "lookahead_min")
PARAMETERS = (
    *contract.COMMON_PARAMETERS,
    "wheelbase",  # m
    "lr",  # m, centre of gravity to rear axle
)
PURSUIT_DIAGNOSTICS = (
    "held",  # 1: the last command is held
    "distance",  # m, from the rear axle to the target
    "alpha",  # rad, angle from the car's axis to the target, positive to the left
)
answer_of = viewer(record("Answer", ("command", *PURSUIT_DIAGNOSTICS)))
MEMORY = 0

Tuning = record("Tuning", PURSUIT_TUNING)
Parameters = record("Parameters", PARAMETERS)
read_tuning, read_parameters = unpacker(Tuning), unpacker(Parameters)


@exported(contract.LAW_SIGNATURE)
def pure_pursuit(situation, reference, road, tuning, parameters, memory, answer):
    """delta = atan(2 L sin(alpha)/l_d), with the target l_d away from the rear axle under the angle alpha.

    The target is the point of the path that lies max(lookahead_time v, lookahead_min) ahead of the centre of gravity.
    """
    s, t, p = contract.read_situation(situation), read_tuning(tuning), read_parameters(parameters)
    angle = distance = alpha = math.nan
    if contract.all_finite(situation) and contract.all_finite(tuning):
        v = max(s.speed, contract.MIN_LAW_SPEED)
        ahead = max(t.lookahead_time * v, t.lookahead_min)
        target = contract.path_at(reference, road, ahead / v, v, p.period)
        x = target.x + p.lr * cos(s.yaw)
        y = target.y - s.y + p.lr * sin(s.yaw)
        forward = x * cos(s.yaw) + y * sin(s.yaw)
        sideways = y * cos(s.yaw) - x * sin(s.yaw)
        distance = hypot(forward, sideways)
        alpha = atan2(sideways, forward)
        angle = atan2(2.0 * p.wheelbase * sin(alpha), distance)
    out = answer_of(answer, 0)
    out.command, out.held = contract.limited(angle, s, p)
    out.distance, out.alpha = distance, alpha
