"""Which point of the car positions are of, by how they move sideways where the car turns."""

from __future__ import annotations

import math

from ..kernel import inlined
from ..maths.exponential import hypot
from ..maths.trigonometric import sin
from .frames import GENTLE
from .record import COMPARED, MISTAKES, POSITION, SUBJECTS, TICKS, T, named, say
from .regression import EVIDENCE, compare


@inlined
def compare_sideways(aside, far, time, rate, sideways_speed, own, settings):
    """Of a window of a time (s): the way (m) that positions moved, so far (rad) beside the yaw.

    rate: rad/s, of the car; sideways_speed: m/s, mean v_y, NaN where it is not known.
    """
    speed = far / time
    last = own.ticks[TICKS - 1]
    if abs(rate) < 0.02 and abs(aside) < 0.1:
        own.straight += 1
        own.mounting += (aside - own.mounting) / min(own.straight, 100)
    wrong = named(own, SUBJECTS.speed) or named(own, SUBJECTS.course) or named(own, SUBJECTS.yaw_rate)
    if settings.known == 0.0 or own.straight < 10 or wrong or not abs(rate * speed) < GENTLE or own.sliding > 0:
        return
    sideways = speed * sin(aside - own.mounting)
    noise = hypot(POSITION / time, 0.004 * speed)
    to_rear, to_front = settings.lr * rate, settings.lf * rate
    if math.isfinite(sideways_speed):
        label = compare(
            own, COMPARED.lateral, sideways_speed, to_rear, to_front, sideways, noise, last[T.time], 4.0, 0.0, EVIDENCE
        )
    else:
        slip = -settings.slip * rate * speed * speed
        label = compare(own, COMPARED.point, to_rear, to_front, slip, sideways, noise, last[T.time], 4.0, 0.0, EVIDENCE)
    if label == 1 + MISTAKES.lateral_velocity_sign:
        say(own, SUBJECTS.lateral, label - 1, 0.0, 0.0, 0.0)
    elif label > 0:
        say(own, SUBJECTS.point, label - 1, settings.lr, settings.lf, 0.0)
