"""What of a drive is shown: a row of numbers a control period, the path that the MPC predicts, the moves that it plans.

A run whose `show` is the address of `show_period` has these of its last instants in `frames` (`run.Frames`).
"""

from __future__ import annotations

import math

from ..controllers import mpc
from ..controllers.part import COMMON_ANSWER
from ..controllers.receding import plan_moves, predict_path
from ..kernel import columns, exported, inlined
from ..maths.bits import whole
from ..maths.exact import sqrt
from ..maths.trigonometric import cos, sin
from ..planning.drive import instant
from ..plants.contract import PLANT_STATE, input_of, state_at, state_of
from ..speed.speed_control import cell_at
from .run import SHOW, TRACE_SIGNALS, write_trace_signals
from .world import SIGNAL

_DRIVEN = PLANT_STATE._fields[: PLANT_STATE.yaw_rate + 1]
FRAME = columns(
    *TRACE_SIGNALS._fields,
    *_DRIVEN,
    "time",  # s
    "command",  # rad
    "error",  # m, of the offset against its reference
    "y_ref",  # m
    "v_ref",  # m/s
    "speed",  # m/s, as measured
    "friction",  # under the car, mean of its wheels
    "wind",  # m/s, across the car, positive to the left
    "guard",  # steps in which the guard of a schedule has limited its tuning, made it give way or replaced it, so far
)
"""Of an instant, its command known, the car not yet moved: `run.TRACE_SIGNALS`, the first entries of
`plants.STATE`, then these. Behind them is the answer of the controller without its command; control laws add the
tuning."""

SPEED_FRAME = columns(
    "planned_speed",  # m/s, of the plan where the car is
    "governed_speed",  # m/s, there, that friction, comfort and steering allow
    "target_speed",  # m/s, where the request acts
    "grip_used",  # -, see `core.speed.speed_control.SPEED_MEMORY`
    "requested_acceleration",  # m/s^2
    "requested_force",  # N, at the wheels, less the hold of the brakes
    "speed_state", "limited_by",  # numbers of `core.speed.speed_control`
    "friction_low", "friction_high",  # -, -: ends of the interval of the friction, as narrowed so far
    "friction_age",  # m, since the tyres last showed the friction
)  # fmt: skip
"""Of an instant behind a speed control: the last numbers of its row."""


@inlined
def _guarded(slot, run):
    """How often the guard has stepped in."""
    if not run.features.variables:
        return 0
    guard_memory = run.controller.schedule.memory[slot]
    return guard_memory.rate_limited + guard_memory.unstable + guard_memory.fallback


@inlined
def _write_numbers(k, slot, run, row):
    """A frame; k: the instant."""
    drive, block, signals = run.memory.drives[slot], run.vehicles.block, run.inputs.signals
    answer = run.controller.answer[slot]
    scenario, sample = run.inputs.scenario[slot], drive.sample - 1
    write_trace_signals(slot, run, row[: len(TRACE_SIGNALS)])
    for j in range(PLANT_STATE.yaw_rate + 1):
        row[FRAME.x + j] = block[state_at(j, slot)]
    row[FRAME.time], row[FRAME.command] = instant(k, run.settings.period), answer[COMMON_ANSWER.command]
    row[FRAME.error] = drive.error
    row[FRAME.y_ref] = signals[scenario, SIGNAL.y_ref, sample]
    row[FRAME.v_ref] = signals[scenario, SIGNAL.speed, sample]
    row[FRAME.speed] = drive.speed
    around, yaw = input_of(block, slot), row[FRAME.yaw]
    front = around.friction_front_left + around.friction_front_right
    rear = around.friction_rear_left + around.friction_rear_right
    row[FRAME.friction] = 0.25 * (front + rear)
    row[FRAME.wind] = around.wind_y * cos(yaw) - around.wind_x * sin(yaw)
    row[FRAME.guard] = _guarded(slot, run)
    behind, n_answers = row[len(FRAME) :], answer.size - 1
    behind[:n_answers] = answer[1:]
    behind[n_answers:] = run.controller.tuning[slot, : behind.size - n_answers]


@inlined
def _write_path(slot, run, speeds, points):
    """The predicted path: x and y (m) in turn."""
    roads, road = run.inputs.roads, run.inputs.roads.of[run.inputs.scenario[slot]]
    station = run.memory.drives[slot].station_estimate if road >= 0 else state_of(run.vehicles.block, slot).x
    count, _ = predict_path(slot, station, speeds, road, roads, run.controller.mpc, points)
    points[2 * count :] = math.nan


@inlined
def _write_plan(slot, run, speeds, points, moves):
    """Write the planned moves of an MPC; NaN where there is no plan at this instant. speeds: m/s, from now on."""
    controller = run.controller
    if controller.plans == 0 or controller.answer[slot, COMMON_ANSWER.held] > 0.5:
        points[:], moves[:] = math.nan, math.nan
        return
    count = whole(controller.answer[slot, mpc.MPC_ANSWER.Nc])
    _write_path(slot, run, speeds, points)
    plan_moves(slot, controller.mpc, moves[:count])
    moves[count:] = math.nan


@inlined
def _write_speed_numbers(longitudinal, row):
    """Write SPEED_FRAME."""
    memory, path = longitudinal.memory[0], longitudinal.path
    row[SPEED_FRAME.planned_speed] = sqrt(path.square[cell_at(memory.station, path)])
    row[SPEED_FRAME.governed_speed] = sqrt(longitudinal.ahead[0])
    row[SPEED_FRAME.target_speed], row[SPEED_FRAME.grip_used] = memory.target_speed, memory.grip_used
    row[SPEED_FRAME.requested_acceleration] = memory.acceleration
    row[SPEED_FRAME.requested_force] = memory.force - memory.hold
    row[SPEED_FRAME.speed_state], row[SPEED_FRAME.limited_by] = memory.speed_state, memory.limited_by
    friction = longitudinal.friction.memory[0]
    row[SPEED_FRAME.friction_low], row[SPEED_FRAME.friction_high] = friction.low, friction.high
    row[SPEED_FRAME.friction_age] = friction.age


@exported(SHOW)
def show_period(slot, run):
    """Write what is shown of a period, its command known, the car not yet moved; see `run.Frames`.

    numbers: see FRAME; behind a speed control the rows end with SPEED_FRAME. predicted: x and y (m) in turn of where
    the car will be 1, 2, ..., Np periods after the dead time. moves: rad, changes of the command that are planned,
    those for the road included. Both are NaN behind the horizons, of control laws, and where a step found no solution.
    """
    frames, k = run.frames, run.memory.drives[slot].instant - 1
    place = k % len(frames.numbers)
    row, width = frames.numbers[place], frames.numbers.shape[1]
    if run.longitudinal.sample.size > 0:
        width -= len(SPEED_FRAME)
        _write_speed_numbers(run.longitudinal, row[width:])
    _write_numbers(k, slot, run, row[:width])
    planned = run.inputs.signals[run.inputs.scenario[slot], SIGNAL.speed, k:]
    speeds = run.speeds if run.speeds.size > 0 else planned
    _write_plan(slot, run, speeds, frames.predicted[place], frames.moves[place])
