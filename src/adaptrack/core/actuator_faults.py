"""Detection of brakes without effect and of a drive that pulls without a request.

Two filters predict the speed: one with brakes that work, one without brakes. Each estimates the acceleration that its
prediction does not explain, such as that of an unknown slope. This acceleration changes slowly, forces of brakes and
drive quickly. Brakes fail once the speeds are clearly more likely without brakes; the drive sticks once both filters
are overtaken. Both are cumulative sums of the logarithm of a likelihood ratio (E. S. Page, Continuous inspection
schemes, Biometrika 41, 1954).
"""

from __future__ import annotations

from .kernel import inlined
from .maths.exact import square
from .maths.exponential import exp
from .speed_learning import LEARNING_SPEED, SPEED_NOISE_SHARE

NO_FAULT, BRAKES_FAIL, DRIVE_STICKS = range(3)
"""Faults."""
DISTURBANCE_TIME = 0.4
"""s, time constant of both filters."""
SETTLING_TIME = 1.2
"""s after a restart, in which nothing is judged."""
PREDICTION_NOISE = 0.06
"""m/s, standard deviation of a predicted speed, in addition to the share of the speed."""
JUDGED_BRAKING, ACTING_SPREAD = 0.5, 1.0
"""m/s^2, -: braking from which brakes are judged; standard deviations by which it may be less than its mean."""
STICKING_SHIFT = 2.0
"""Standard deviations by which a drive that sticks shifts the errors of the predictions."""
BRAKE_EVIDENCE, DRIVE_EVIDENCE = 8.5, 12.0
"""Logarithms of the likelihood ratios of a fault, chosen on 354 drives of a point mass."""
LARGEST_DISTURBANCE = 1.8
"""m/s^2, of an unknown slope and wind."""
RESTORED_EFFECT = 0.7
"""Share of the expected effect from which brakes work again."""


@inlined
def forget_faults(speed, disturbance, memory):
    """Restart both filters at a speed (m/s) and a disturbance (m/s^2)."""
    memory.working_speed, memory.brakeless_speed = speed, speed
    memory.working_disturbance, memory.brakeless_disturbance = disturbance, disturbance
    memory.brake_evidence, memory.drive_evidence, memory.watched_time = 0.0, 0.0, 0.0


@inlined
def watch_actuators(speed, resistance, drive, brakes, period, memory):
    """Update the filters and the fault in a memory of the speed control.

    speed: m/s; resistance: m/s^2, of air, rolling and known slope; drive, brakes: `speed_learning.ActuatorBelief`.
    """
    if speed < LEARNING_SPEED:
        forget_faults(speed, brakes.disturbance if brakes.acting > drive.acting else drive.disturbance, memory)
        return
    free = drive.ratio * drive.acting - resistance
    effect = brakes.ratio * max(brakes.acting - ACTING_SPREAD * brakes.acting_sigma, 0.0)
    working = memory.working_speed + period * (free - effect + memory.working_disturbance)
    brakeless = memory.brakeless_speed + period * (free + memory.brakeless_disturbance)
    noise = PREDICTION_NOISE + SPEED_NOISE_SHARE * speed
    working_error, brakeless_error = (speed - working) / noise, (speed - brakeless) / noise
    share = exp(-period / DISTURBANCE_TIME)  # critically damped: both poles of the filter
    memory.working_speed = working + (1.0 - share * share) * noise * working_error
    memory.brakeless_speed = brakeless + (1.0 - share * share) * noise * brakeless_error
    memory.working_disturbance += square(1.0 - share) / period * noise * working_error
    memory.brakeless_disturbance += square(1.0 - share) / period * noise * brakeless_error
    shift = STICKING_SHIFT * (min(working_error, brakeless_error) - 0.5 * STICKING_SHIFT)
    memory.drive_evidence = max(memory.drive_evidence + shift, 0.0)
    ratio = 0.5 * (square(working_error) - square(brakeless_error))
    memory.brake_evidence = max(memory.brake_evidence + ratio, 0.0) if brakes.acting > JUDGED_BRAKING else 0.0
    memory.watched_time += period
    if memory.watched_time < SETTLING_TIME:
        memory.brake_evidence = memory.drive_evidence = 0.0
        return
    restored_effect = max(RESTORED_EFFECT * brakes.ratio * brakes.acting, LARGEST_DISTURBANCE)
    if memory.drive_evidence > DRIVE_EVIDENCE:
        memory.fault = DRIVE_STICKS
    elif memory.fault == BRAKES_FAIL and memory.brakeless_disturbance < -restored_effect:
        memory.fault, memory.brake_evidence, memory.working_disturbance = NO_FAULT, 0.0, 0.0
    elif memory.brake_evidence > BRAKE_EVIDENCE or memory.working_disturbance > LARGEST_DISTURBANCE:
        memory.fault = max(memory.fault, BRAKES_FAIL)
