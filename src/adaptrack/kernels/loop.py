"""One control period of the closed loop, piece by piece, in the order in which both drivers call them.

    judge -> sense -> (look -> schedule) -> control -> actuate -> observe -> advance

`simulate` calls them once per period from Python, around any controller; `rollout` inlines them in a compiled loop over
the slots of a batch.
"""

from __future__ import annotations

import math

from numba import types

from .abi import PART, SHARED_PART, Structure, columns, cube, float64, int64, njit, vector
from .maths.elementary import clip
from .maths.random import counted_normal
from .models.contract import MEASURED
from .plants.contract import ENVIRONMENT, INPUT, STATE, input_at, state_at
from .plants.forces import wheel_angle
from .variables import VARIABLES

SETTINGS = Structure(
    (
        "period",  # s
        "substeps",  # Runge-Kutta steps per period
        "prescribed_speed",  # 1: v_x follows the profile exactly, 0: the driver and the powertrain move the vehicle
        "delay",  # 1: a command takes effect one period after its measurement, 0: at once
        "noise_vy", "noise_yaw", "noise_yaw_rate", "noise_y",  # m/s, rad, rad/s, m, standard deviations
        "steering_lag", "steering_limit",  # s, rad, of the actuator
        "driver_preview",  # s, how far ahead the driver looks at the speed profile
        "driver_integral",  # 1/s^2, gain on the integral of the speed error
        "mass",  # kg, with which the driver turns acceleration into force
        "engine_power", "traction_limit", "brake_limit",  # W, N, N
        "failure_distance",  # m, a run has failed when |Y - y_ref| exceeds this after it has once been within
        "failure_sideslip",  # rad, or the sideslip angle this
    ),
    whole=("substeps", "prescribed_speed", "delay"),
)  # fmt: skip
"""The world around the controller, fixed over a run."""

MEMORY = Structure(
    (
        "command",  # rad, the controller's last one
        "integral",  # m, of the driver's speed error
        "arrived",  # 1 once the vehicle has been within the failure distance
        "ended",  # RUNNING, or why the run ended
        "ended_at",  # s
    ),
    whole=("arrived", "ended"),
)
"""What the loop remembers of each slot."""

RUNNING, OFF_ROAD, SPUN, NOT_FINITE, NEVER_ARRIVED, STOPPED = range(6)
"""Why a run ended: left its reference, spun, a state that is not finite, never came near; or too dear to go on."""
SLOW = 1.0
"""m/s: below it sideslip is ill-defined, and a vehicle is not said to spin."""

SIGNAL = columns(
    "y_ref", "speed", "friction_front_left", "friction_front_right", "friction_rear_left", "friction_rear_right",
    "wind_x", "wind_y", "known_friction", "known_wind", "change", "acceleration",
)  # fmt: skip
"""Rows of a scenario's samples. The last four are scheduling variables: friction and wind as they are known, and
the reference preview."""


# -- failure ----------------------------------------------------------------------------------------------------------
@njit(types.int64(float64, vector, int64, SETTINGS.type, types.boolean), **SHARED_PART)
def judge(y_ref, block, slot, settings, arrived):
    """Why a run has failed at this instant, RUNNING if it has not.

    Not finite: a state. Spun: a sideslip angle |atan2(v_y, v_x)| beyond the limit at 1 m/s or more. Off the road:
    |Y - y_ref| beyond the distance, once the vehicle has arrived within it.
    """
    for row in range(STATE.yaw_rate + 1):
        if not math.isfinite(block[state_at(row, slot)]):
            return NOT_FINITE
    if not math.isfinite(block[state_at(STATE.steering, slot)]):
        return NOT_FINITE
    vx, vy = block[state_at(STATE.vx, slot)], block[state_at(STATE.vy, slot)]
    if math.hypot(vx, vy) >= SLOW and abs(math.atan2(vy, vx)) > settings[0].failure_sideslip:
        return SPUN
    if arrived and not abs(block[state_at(STATE.y, slot)] - y_ref) <= settings[0].failure_distance:
        return OFF_ROAD
    return RUNNING


# -- the controller's side --------------------------------------------------------------------------------------------
@njit(types.void(int64, int64, vector, SETTINGS.type, int64, vector), **SHARED_PART)
def sense(k, slot, block, settings, seed, measured):
    """Write what the sensors of a slot's vehicle give at instant k, see `models.contract.MEASURED`."""
    world = settings[0]
    measured[MEASURED.vy] = block[state_at(STATE.vy, slot)]
    measured[MEASURED.yaw] = block[state_at(STATE.yaw, slot)]
    measured[MEASURED.yaw_rate] = block[state_at(STATE.yaw_rate, slot)]
    measured[MEASURED.y] = block[state_at(STATE.y, slot)]
    if world.noise_vy > 0.0:
        measured[MEASURED.vy] += world.noise_vy * counted_normal(seed, k, MEASURED.vy)
    if world.noise_yaw > 0.0:
        measured[MEASURED.yaw] += world.noise_yaw * counted_normal(seed, k, MEASURED.yaw)
    if world.noise_yaw_rate > 0.0:
        measured[MEASURED.yaw_rate] += world.noise_yaw_rate * counted_normal(seed, k, MEASURED.yaw_rate)
    if world.noise_y > 0.0:
        measured[MEASURED.y] += world.noise_y * counted_normal(seed, k, MEASURED.y)
    measured[MEASURED.wheel_angle] = wheel_angle(
        block[state_at(STATE.steering, slot)], block[input_at(INPUT.command, slot)],
        world.steering_lag, world.steering_limit,
    )  # fmt: skip


@njit(types.void(int64, float64, vector, cube, int64, vector), **SHARED_PART)
def look(k, speed, measured, signals, scenario, variables):
    """Write the scheduling variables (`VARIABLES`) at instant k; measured: see `sense`, speed: v_x (m/s)."""
    y_ref = signals[scenario, SIGNAL.y_ref, k]
    variables[VARIABLES.speed] = speed
    variables[VARIABLES.y_ref] = y_ref
    variables[VARIABLES.friction] = signals[scenario, SIGNAL.known_friction, k]
    variables[VARIABLES.wind] = signals[scenario, SIGNAL.known_wind, k]
    variables[VARIABLES.change] = signals[scenario, SIGNAL.change, k]
    variables[VARIABLES.acceleration] = signals[scenario, SIGNAL.acceleration, k]
    variables[VARIABLES.offset] = y_ref - measured[MEASURED.y]


# -- the vehicle's side -----------------------------------------------------------------------------------------------
@njit(**PART)
def _drive(k, speed, signals, scenario, settings, own):
    """Longitudinal force (N) of the driver: aims at the profile's speed a preview time ahead, with an integral.

    dv = (v_ref(t + T_p) - v_x)/T_p + K_i * integral of (v_ref - v_x); limited by engine power, traction and brakes,
    the integral standing still while a limit holds.
    """
    last = signals.shape[2] - 1
    ahead = settings.driver_preview / settings.period
    j = min(k + int(ahead), last)
    part = ahead - math.floor(ahead)
    near, far = signals[scenario, SIGNAL.speed, j], signals[scenario, SIGNAL.speed, min(j + 1, last)]
    target = near + part * (far - near)
    wanted = settings.mass * ((target - speed) / settings.driver_preview + settings.driver_integral * own.integral)
    strongest = min(settings.traction_limit, settings.engine_power / max(speed, 1.0))
    force = clip(wanted, -settings.brake_limit, strongest)
    if force == wanted:
        own.integral += (signals[scenario, SIGNAL.speed, k] - speed) * settings.period
    return force


@njit(types.void(int64, int64, float64, vector, SETTINGS.type, cube, int64, MEMORY.type), **SHARED_PART)
def actuate(k, slot, command, block, settings, signals, scenario, memory):
    """Write the inputs of a slot's vehicle for the period after instant k: steering, speed control, friction, wind.

    command: the controller's new one (rad); with computation delay, the one before acts.
    """
    world, own = settings[0], memory[slot]
    vx = block[state_at(STATE.vx, slot)]
    block[input_at(INPUT.command, slot)] = own.command if world.delay > 0 else command
    own.command = command
    if world.prescribed_speed > 0:
        following = signals[scenario, SIGNAL.speed, min(k + 1, signals.shape[2] - 1)]
        block[input_at(INPUT.force, slot)] = 0.0
        block[input_at(INPUT.acceleration, slot)] = (following - vx) / world.period
    else:
        block[input_at(INPUT.force, slot)] = _drive(k, vx, signals, scenario, world, own)
        block[input_at(INPUT.acceleration, slot)] = math.nan
    for j in range(ENVIRONMENT):
        block[input_at(INPUT.friction_front_left + j, slot)] = signals[scenario, SIGNAL.friction_front_left + j, k]
