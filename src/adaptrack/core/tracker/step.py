"""A tracker around a compiled controller: whole calls, an MPC's and a control law's, with a schedule or without."""

from __future__ import annotations

import math

from ..controllers import mpc
from ..controllers.contract import SITUATION, call_law
from ..controllers.mpc import MPC_ANSWER as MPC_ANSWER
from ..controllers.mpc_step import step_with
from ..estimators import learning
from ..kernel import Place, columns, exported, inlined, local, void
from ..maths.bits import whole
from ..models.contract import MEASUREMENT
from ..road import RoadAheadRecord, bend_ahead
from ..rollout import COMMAND
from ..schedule import schedule
from ..variables import VARIABLE_COLUMNS
from .conclude_instant import tracker_conclude
from .longitudinal import Longitudinal, longitudinal_step, narrow_tracked_friction
from .pose import line
from .prepare_instant import tracker_prepare
from .records import CONTROLLER_ANSWER, INSTANT, NO_BELIEF, REQUEST, TRACKER_SAMPLE, LawTracking, Tracking
from .take_call import tracker_take

PLACE = columns(*SITUATION)
_reference = local(1)


@exported(void(Place(Tracking)))
def tracker_step(tracking):
    """A call of a tracker with an MPC: the sample in `tracker.sample`, the answer in `tracker.tracked`."""
    tracker = tracking.tracker
    tracker_take(tracker)
    while tracker_prepare(tracker) > 0:
        _apply_requests(tracking)
        tracker_control(tracking)
        tracker_conclude(tracker)
    _apply_requests(tracking)


@exported(void(Place(LawTracking)))
def tracker_step_law(tracking):
    """`tracker_step`, with a control law."""
    tracker = tracking.tracker
    tracker_take(tracker)
    while tracker_prepare(tracker) > 0:
        _apply_requests_law(tracking)
        _control_law(tracking)
        tracker_conclude(tracker)
    _apply_requests_law(tracking)


@exported(void(Place(Tracking), Place(Longitudinal)))
def driver_step(tracking, longitudinal):
    """A call of a tracker with an MPC and of the speed control behind it, see `tracker_step` and `longitudinal_step`.

    The friction is narrowed at each control instant.
    """
    tracker = tracking.tracker
    tracker_take(tracker)
    while tracker_prepare(tracker) > 0:
        _apply_requests(tracking)
        narrow_tracked_friction(tracker, tracking.step.mpc.informed.learned[0], longitudinal)
        tracker_control(tracking)
        tracker_conclude(tracker)
    _apply_requests(tracking)
    longitudinal_step(tracker, longitudinal)


@exported(void(Place(LawTracking), Place(Longitudinal)))
def driver_step_law(tracking, longitudinal):
    """`driver_step`, with a control law, which knows no steering from which friction could be estimated."""
    tracker_step_law(tracking)
    longitudinal_step(tracking.tracker, longitudinal)


# -- an MPC -----------------------------------------------------------------------------------------------------------
@inlined
def _apply_requests(tracking):
    """Do what the tracker asks of the MPC."""
    request, mpc_record, settings = tracking.tracker.request, tracking.step.mpc, tracking.tracker.settings[0]
    if request[REQUEST.restart] > 0.5:
        mpc.restart(0, mpc_record)
        _begin_schedule(tracking.scheduling, tracking.step.tuning)
    if request[REQUEST.change] > 0.5:
        late = settings.late if settings.filtered > 0 else -1
        mpc.change_path(0, request[REQUEST.turned], request[REQUEST.shifted], late, mpc_record)
    if request[REQUEST.apply] > 0.5:
        mpc_record.memory[0].command = tracking.tracker.memory[0].command
    request[REQUEST.restart] = request[REQUEST.change] = request[REQUEST.apply] = 0.0


@exported(void(Place(Tracking)))
def tracker_control(tracking):
    """The MPC's step at an instant."""
    tracker, mpc_step, mpc_record = tracking.tracker, tracking.step, tracking.step.mpc
    ahead, answer = tracker.ahead, tracker.answer
    for i in range(mpc_record.measured.size):
        mpc_record.measured[i] = tracker.measured[i]
    speed, count = ahead[INSTANT.speed], whole(ahead[INSTANT.count])
    if tracking.scheduling.schedule.settings[0].n_entries > 0:
        _schedule(tracker, tracking.scheduling, mpc_step.tuning)
    bend_ahead(
        ahead[INSTANT.station], tracker.speeds[:count], max(speed, mpc_record.settings.speed_floor),
        mpc.delay_of(0, mpc_record), mpc_record.settings.period, 0, tracker.path, mpc_record.bend,
    )  # fmt: skip
    mpc_step.reference[0] = 0.0
    step_with(0, speed, mpc_step.reference[:1], mpc_step.tuning, mpc_record, mpc_step.functions)
    output = mpc_record.answer[0]
    answer[CONTROLLER_ANSWER.command], answer[CONTROLLER_ANSWER.held] = (
        output[MPC_ANSWER.command],
        output[MPC_ANSWER.held],
    )
    if mpc_record.settings.learns > 0:
        learned = output[len(MPC_ANSWER) :]
        answer[CONTROLLER_ANSWER.belief_state] = learned[learning.BELIEF_COLUMNS.belief_state]
        answer[CONTROLLER_ANSWER.belief_at_bound] = learned[learning.BELIEF_COLUMNS.belief_at_bound]
        answer[CONTROLLER_ANSWER.delay_sigma] = learned[learning.BELIEF_COLUMNS.belief_delay_sigma]
    else:
        answer[CONTROLLER_ANSWER.belief_state] = answer[CONTROLLER_ANSWER.belief_at_bound] = NO_BELIEF
        answer[CONTROLLER_ANSWER.delay_sigma] = 0.0


# -- a law ------------------------------------------------------------------------------------------------------------
@inlined
def _apply_requests_law(tracking):
    """Do what the tracker asks of the law, which knows of its own command only what it is given."""
    request = tracking.tracker.request
    if request[REQUEST.restart] > 0.5:
        tracking.law.memory[0, :] = 0.0
        _begin_schedule(tracking.scheduling, tracking.tuning)
    request[REQUEST.restart] = request[REQUEST.change] = request[REQUEST.apply] = 0.0


@inlined
def _control_law(tracking):
    """The law's step at an instant."""
    tracker, law, tuning = tracking.tracker, tracking.law, tracking.tuning
    ahead, answer, situation, measured = tracker.ahead, tracker.answer, law.situation, tracker.measured
    road = RoadAheadRecord(line(tracker), ahead[INSTANT.station], tracker.speeds[: whole(ahead[INSTANT.count])])
    situation[PLACE.vy], situation[PLACE.yaw] = measured[MEASUREMENT.vy], measured[MEASUREMENT.yaw]
    situation[PLACE.yaw_rate], situation[PLACE.y] = measured[MEASUREMENT.yaw_rate], measured[MEASUREMENT.y]
    situation[PLACE.speed], situation[PLACE.command] = ahead[INSTANT.speed], tracker.memory[0].command
    if tracking.scheduling.schedule.settings[0].n_entries > 0:
        _schedule(tracker, tracking.scheduling, tuning)
    output = law.law_answer
    call_law(law.function, situation, _reference(), road, tuning, law.parameters, law.memory[0], output)
    answer[CONTROLLER_ANSWER.command] = output[COMMAND]
    answer[CONTROLLER_ANSWER.held] = 1.0 if law.held > 0 and output[law.held] > 0.5 else 0.0
    answer[CONTROLLER_ANSWER.belief_state] = answer[CONTROLLER_ANSWER.belief_at_bound] = NO_BELIEF
    answer[CONTROLLER_ANSWER.delay_sigma] = 0.0


# -- a schedule -------------------------------------------------------------------------------------------------------
@inlined
def _begin_schedule(scheduling, tuning):
    """Before the first step: the tuning is that before the schedule speaks, which remembers nothing."""
    for i in range(scheduling.first.size):
        tuning[i] = scheduling.first[i]
    for i in range(len(scheduling.schedule.memory)):
        row = scheduling.schedule.memory[i]
        row.steps, row.clipped, row.broken, row.rate_limited, row.outside = 0, 0, 0, 0, 0
        row.off_reference, row.unstable, row.fallback, row.left, row.holding = 0, 0, 0, 0, 0


@inlined
def _schedule(tracker, scheduling, tuning):
    """Let the schedule choose the tuning; friction that is not known is the nominal one, such wind none."""
    sample, variables = tracker.sample, scheduling.variables
    friction, wind = sample[TRACKER_SAMPLE.friction], sample[TRACKER_SAMPLE.wind]
    variables[VARIABLE_COLUMNS.speed], variables[VARIABLE_COLUMNS.y_ref] = tracker.ahead[INSTANT.speed], 0.0
    variables[VARIABLE_COLUMNS.friction] = friction if math.isfinite(friction) else tracker.settings[0].nominal_friction
    variables[VARIABLE_COLUMNS.wind] = wind if math.isfinite(wind) else 0.0
    variables[VARIABLE_COLUMNS.change] = variables[VARIABLE_COLUMNS.acceleration] = 0.0
    variables[VARIABLE_COLUMNS.offset] = -tracker.memory[0].offset
    schedule(0, variables, scheduling.schedule, tuning)
