"""Detection of brakes without effect and of a drive that pulls without a request.

Over an exponential window the loss of speed is compared with the loss that air, rolling, slope, drive and the usual
disturbance explain; the difference is the effect of the brakes. Brakes fail if their effect is much less than
requested, or if a drive pulls against them. The drive sticks if the car is much faster than it would be without any
brakes. A slope that begins within the window and is unknown looks like a fault, so the margins exceed the effect of
10 %. Noise of the speed looks like one for single periods, so a fault must last for several.
"""

from __future__ import annotations

from .kernel import inlined
from .maths.exponential import exp
from .speed_learning import LEARNING_SPEED

NO_FAULT, BRAKES_FAIL, DRIVE_STICKS = range(3)
"""Faults."""
FAULT_WINDOW = 1.5
"""s, time constant of the window."""
DISTURBANCE_TIME, BRAKING_DISTURBANCE_TIME, LITTLE_BRAKING = 0.8, 2.5, 0.05
"""s, s, m/s: time constants of the usual disturbance behind the estimated one, with less and with more braking."""
LEAST_EFFECT, EFFECT_MARGIN, JUDGED_BRAKING = 0.35, 0.2, 0.8
"""-, m/s, m/s: brakes that work have this share of a requested effect, less the margin, where it is as large."""
JUDGED_DECELERATION = 1.0
"""m/s^2, requested: below it brakes may hold the car on a slope that is not known."""
RESTORED_EFFECT, RESTORED_BRAKING = 0.7, 1.0
"""-, m/s: share of a requested effect of at least so much, from which brakes work again."""
STICKING_MARGIN = 1.0
"""m/s, by which a drive that does not stick makes the car faster than expected."""
FAULT_PERIODS = 3
"""Periods in succession in which a fault must be suspected."""


@inlined
def forget_faults(speed, memory):
    """Restart the window at a speed (m/s)."""
    memory.mean_speed, memory.expected_loss, memory.braking = speed, 0.0, 0.0
    memory.watched_periods, memory.suspect_periods = 0.0, 0.0


@inlined
def watch_actuators(speed, resistance, drive, brakes, period, memory):
    """Update the window and the fault in a memory of the speed control.

    speed: m/s; resistance: m/s^2, of air, rolling and known slope; drive, brakes: `speed_learning.ActuatorBelief`.
    """
    if speed < LEARNING_SPEED:
        forget_faults(speed, memory)
        return
    disturbance = brakes.disturbance if brakes.acting > drive.acting else drive.disturbance
    if memory.fault == NO_FAULT:
        time = DISTURBANCE_TIME if memory.braking < LITTLE_BRAKING else BRAKING_DISTURBANCE_TIME
        memory.usual_disturbance += (disturbance - memory.usual_disturbance) * period / time
    memory.watched_periods += 1.0
    share = min(exp(-period / FAULT_WINDOW), 1.0 - 1.0 / memory.watched_periods)  # at first the mean of all speeds
    memory.mean_speed += (1.0 - share) * (speed - memory.mean_speed)
    free = resistance - memory.usual_disturbance - drive.ratio * drive.acting
    memory.expected_loss = share * (memory.expected_loss + period * free)
    memory.braking = share * (memory.braking + period * brakes.acting)
    effect = memory.mean_speed - speed - memory.expected_loss  # the first difference is the loss in the window
    is_judged = memory.braking > JUDGED_BRAKING and memory.acceleration < -JUDGED_DECELERATION
    suspect = NO_FAULT
    if effect < -STICKING_MARGIN:
        suspect = DRIVE_STICKS
    elif is_judged and effect < LEAST_EFFECT * memory.braking - EFFECT_MARGIN:
        suspect = BRAKES_FAIL
    memory.suspect_periods = memory.suspect_periods + 1.0 if suspect != NO_FAULT else 0.0
    if memory.suspect_periods >= FAULT_PERIODS:
        memory.fault = max(memory.fault, suspect)
    elif memory.fault == BRAKES_FAIL and effect > RESTORED_EFFECT * memory.braking > RESTORED_EFFECT * RESTORED_BRAKING:
        memory.fault = NO_FAULT
