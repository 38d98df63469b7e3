"""The Stanley law: heading error, offset of the front axle and yaw damping, predicted over the steering's dead time."""

from __future__ import annotations

import math

from ..kernel import exported, inlined, record, unpacker, viewer
from ..maths.trigonometric import atan2, cos, sin
from . import contract

STANLEY_TUNING = ("gain", "softening", "yaw_rate_gain", "dead_time")
PARAMETERS = (
    *contract.COMMON_PARAMETERS,
    "lf",  # m, centre of gravity to front axle
    "front_slip",  # rad s^2/m, slip angle of the front tyres per lateral acceleration: m lr/(2 C_f L)
)
STANLEY_DIAGNOSTICS = (
    "held",  # 1: the last command is held
    "offset",  # m, from the front axle to the path after the dead time, positive when the path is on the left
    "heading_error",  # rad, heading of the path less the car's, after the dead time
    "curvature",  # 1/m, of the path there
)
answer_of = viewer(record("Answer", ("command", *STANLEY_DIAGNOSTICS)))
MEMORY = 1
"""The heading of the path, for when the car stands."""

Tuning = record("Tuning", STANLEY_TUNING)
Parameters = record("Parameters", PARAMETERS)
read_tuning, read_parameters = unpacker(Tuning), unpacker(Parameters)


@inlined
def predicted(s, time):
    """Yaw (rad) and y (m) after `time` (s) of the present motion: constant v_x, v_y and yaw rate."""
    middle = s.yaw + 0.5 * time * s.yaw_rate
    return s.yaw + time * s.yaw_rate, s.y + time * (s.speed * sin(middle) + s.vy * cos(middle))


@exported(contract.LAW_SIGNATURE)
def stanley(situation, reference, road, tuning, parameters, memory, answer):
    """delta = psi_e + front_slip a_y + atan(gain e/(softening + v)) + yaw_rate_gain (r_path - r).

    psi_e and e (positive to the left) are the errors of heading and of the front axle after the dead time,
    r_path = v kappa and a_y = v^2 kappa are those of the path there.
    """
    s, t, p = contract.read_situation(situation), read_tuning(tuning), read_parameters(parameters)
    angle = offset = heading_error = curvature = math.nan
    if contract.all_finite(situation) and contract.all_finite(tuning):
        v = max(s.speed, contract.MIN_LAW_SPEED)
        dead_time = max(t.dead_time, 0.0)
        yaw, y = predicted(s, dead_time)
        path = contract.path_ahead(reference, road, dead_time + p.lf / v, s.speed, p.period, memory)
        curvature = path.curvature
        offset = (path.y - y - p.lf * sin(yaw)) * cos(path.heading)
        if road.line.start.size > 0:  # the front axle is not where the point of the path is taken
            x = dead_time * s.speed * cos(s.yaw) + p.lf * cos(yaw)
            offset = contract.left_of(path, x, y + p.lf * sin(yaw))
        heading_error = contract.wrapped(path.heading - yaw)
        angle = (
            heading_error
            + p.front_slip * v * v * curvature
            + atan2(t.gain * offset, max(t.softening, 0.0) + v)
            + t.yaw_rate_gain * (v * curvature - s.yaw_rate)
        )
    out = answer_of(answer, 0)
    out.command, out.held = contract.limited(angle, s, p)
    out.offset, out.heading_error, out.curvature = offset, heading_error, curvature
