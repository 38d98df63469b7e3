"""The point of the car that is measured, by how positions move sideways where the car turns."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exponential import hypot
from ..maths.trigonometric import sin
from .frames import GENTLE
from .record import COMPARED, MISTAKES, POSITION, SUBJECTS, TICKS, T, is_reported, report
from .regression import compare


@inlined
def compare_sideways(aside, far, time, rate, sideways_speed, memory, settings):
    """Compare how positions moved sideways in a window of a time (s): over a way (m), in a direction off the yaw (rad).

    rate: rad/s, of the car; sideways_speed: m/s, mean v_y, NaN where it is not known.
    """
    speed = far / time
    last = memory.ticks[TICKS - 1]
    if abs(rate) < 0.02 and abs(aside) < 0.1:
        memory.straight += 1
        memory.mounting += (aside - memory.mounting) / min(memory.straight, 100)
    wrong = (
        is_reported(memory, SUBJECTS.speed)
        or is_reported(memory, SUBJECTS.course)
        or is_reported(memory, SUBJECTS.yaw_rate)
    )
    if settings.known == 0.0 or memory.straight < 10 or wrong or not abs(rate * speed) < GENTLE or memory.sliding > 0:
        return
    sideways = speed * sin(aside - memory.mounting)
    noise = hypot(POSITION / time, 0.004 * speed)
    to_rear, to_front = settings.lr * rate, settings.lf * rate
    if math.isfinite(sideways_speed):
        label = compare(memory, COMPARED.lateral, sideways_speed, to_rear, to_front, sideways, noise, last[T.time])
    else:
        slip = -settings.slip * rate * speed * speed
        label = compare(memory, COMPARED.point, to_rear, to_front, slip, sideways, noise, last[T.time])
    if label == 1 + MISTAKES.lateral_velocity_sign:
        report(memory, SUBJECTS.lateral, label - 1, 0.0, 0.0, 0.0)
    elif label > 0:
        report(memory, SUBJECTS.point, label - 1, settings.lr, settings.lf, 0.0)
