"""What of a drive is shown: a row of numbers a control period, the path that the MPC predicts, the moves that it plans.

A program that shows a drive lets it go on by `drive_and_show`, a few periods at a time.
"""

from __future__ import annotations

import math

from ..controllers import mpc
from ..controllers.part import COMMON_ANSWER
from ..controllers.receding import plan_moves, predict_outputs
from ..estimators.learning import BELIEF_COLUMNS, KNOWN_DELAY_SIGMA
from ..kernel import Place, columns, exported, inlined, int64, matrix, vector
from ..maths.bits import whole
from ..maths.exact import sqrt
from ..maths.trigonometric import cos, sin
from ..models.contract import MEASUREMENT
from ..planning.drive import instant
from ..plants.contract import PLANT_INPUT, PLANT_STATE, input_at, state_at
from ..roads.road import line_of, points_ahead
from ..speed.speed_control import cell_at, governed_speeds
from ..tracker.longitudinal import Longitudinal, narrow_friction_step, speed_control_step
from .period import TRACE_SIGNALS, RunSpan, before_control, move, write_trace_signals
from .rollout import RunRecord, answer_instant, close_all, control_along, control_slot, end_slot
from .world import RUNNING, SIGNAL

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
"""Of an instant, its command known, the car not yet moved: `period.TRACE_SIGNALS`, the first entries of
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
    front = (
        block[input_at(PLANT_INPUT.friction_front_left, slot)] + block[input_at(PLANT_INPUT.friction_front_right, slot)]
    )
    rear = (
        block[input_at(PLANT_INPUT.friction_rear_left, slot)] + block[input_at(PLANT_INPUT.friction_rear_right, slot)]
    )
    row[FRAME.friction] = 0.25 * (front + rear)
    wind_x, wind_y = block[input_at(PLANT_INPUT.wind_x, slot)], block[input_at(PLANT_INPUT.wind_y, slot)]
    yaw = row[FRAME.yaw]
    row[FRAME.wind] = wind_y * cos(yaw) - wind_x * sin(yaw)
    row[FRAME.guard] = _guarded(slot, run)
    behind, n_answers = row[len(FRAME) :], answer.size - 1
    for j in range(n_answers):
        behind[j] = answer[1 + j]
    for j in range(behind.size - n_answers):
        behind[n_answers + j] = run.controller.tuning[slot, j]


@inlined
def _write_path(slot, run, speeds, points):
    """The predicted path: x and y (m) in turn; on a curved road by the offsets from it that are predicted."""
    drive, inputs, model = run.memory.drives[slot], run.inputs, run.controller.mpc
    scenario = inputs.scenario[slot]
    horizon, most = whole(model.answer[slot, mpc.MPC_ANSWER.Np]), points.size // 2
    offsets = points[most : most + horizon]
    predict_outputs(slot, model, offsets)
    road = inputs.roads.of[scenario]
    if road >= 0 and model.settings.curved > 0:
        for j in range(horizon):
            offsets[j] -= model.bend[j + 1]
    station = drive.station_estimate if road >= 0 else run.vehicles.block[state_at(PLANT_STATE.x, slot)]
    speed = max(drive.speed, model.settings.speed_floor)
    points_ahead(
        station, speeds, speed, mpc.delay_of(slot, model), model.settings.period,
        line_of(road, inputs.roads), offsets, points,
    )  # fmt: skip
    for j in range(2 * horizon, points.size):
        points[j] = math.nan


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
def _control_speed(run, longitudinal, speeds):
    """Step the speed control at the present instant; write its requests, and the governed speeds (m/s) from now on."""
    drive, sample, memory = run.memory.drives[0], longitudinal.sample[0], longitudinal.memory[0]
    narrow_friction_step(run.measured, drive.speed, drive.command, run.controller.mpc.informed.learned[0], longitudinal)
    sample.station, sample.speed, sample.is_guided, sample.periods = drive.station_estimate, drive.speed, 1.0, 1.0
    sample.yaw_rate = run.measured[MEASUREMENT.yaw_rate]
    speed_control_step(longitudinal)
    drive.requested_force, drive.requested_hold = memory.force, memory.hold
    governed_speeds(
        drive.speed, longitudinal.settings.period, longitudinal.path.spacing, longitudinal.ahead, speeds
    )  # fmt: skip


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


@inlined
def _control(k, run, longitudinal, speeds):
    """The controllers at instant k: of the speed, where there is one, then of the steering; speeds: see there."""
    if longitudinal.memory.size == 0:
        control_slot(0, run)
        return
    _control_speed(run, longitudinal, speeds)
    control_along(0, k, speeds, run)
    controller = run.controller
    sigma = controller.beliefs + BELIEF_COLUMNS.belief_delay_sigma
    if controller.beliefs > 0 and controller.answer[0, sigma] < KNOWN_DELAY_SIGMA:
        longitudinal.sample[0].top_speed = math.inf


@exported(int64(int64, RunSpan, Place(RunRecord), Place(Longitudinal), vector, matrix, matrix, matrix))
def drive_and_show(count, span, run, longitudinal, speeds, numbers, predicted, moves):
    """`rollout.roll_on` of a run of one slot, with a row for each period driven: how many.

    longitudinal: a speed control, which requests the forces of the run (`loop.EXTERNAL_FORCES`); empty: none. It
    limits the speed to `sample.top_speed` until the controller knows the delay of its steering. speeds: (n,) m/s, room
    for the governed speeds that the controller is given.
    numbers: (count, .) see FRAME; behind a speed control the rows end with SPEED_FRAME. predicted: (count, 2 longest
    horizon) x and y (m) in turn of where the car will be 1, 2, ..., Np periods after the dead time. moves: (count, most
    moves) rad, changes of the command that are planned, those for the road included. Both are NaN behind the horizons,
    of control laws, and where a step found no solution. No row is written of the instant at which a run fails.
    """
    drive, periods = run.memory.drives[0], 0
    has_speed_control = longitudinal.memory.size > 0
    width = numbers.shape[1] - (len(SPEED_FRAME) if has_speed_control else 0)
    while periods < count and drive.ended == RUNNING and drive.instant < span.periods:
        k, row = drive.instant, numbers[periods]
        before_control(0, span, run)
        if drive.ended == RUNNING:
            _control(k, run, longitudinal, speeds)
            answer_instant(k, 0, span, run)
        if drive.ended != RUNNING:
            end_slot(k, 0, span, run)
            break
        _write_numbers(k, 0, run, row[:width])
        if has_speed_control:
            _write_speed_numbers(longitudinal, row[width:])
        planned = run.inputs.signals[run.inputs.scenario[0], SIGNAL.speed, k:]
        _write_plan(0, run, speeds if has_speed_control else planned, predicted[periods], moves[periods])
        move(span.slots, run)
        periods += 1
    close_all(span, run)
    return periods
