"""A tracker around a compiled controller, and a speed control behind it: whole calls."""

from __future__ import annotations

import math

from ..controllers.part import COMMON_ANSWER, ControllerPart, apply_requests, control
from ..estimators.learning import BELIEF_COLUMNS
from ..kernel import Caller, Place, exported, inlined, int64, local, record, vector, void
from ..loop import period_of
from ..maths.bits import whole
from ..scheduling.functions import VARIABLE_COLUMNS
from .instant import begin_instant, conclude_instant
from .longitudinal import Longitudinal
from .records import CONTROLLER_ANSWER, INSTANT, TrackerRecord
from .signals import NO_BELIEF, TRACKER_SAMPLE
from .take_call import tracker_take

Tracking = record(
    "Tracking",
    (
        ("tracker", TrackerRecord),
        ("controller", ControllerPart),
        ("narrow_friction", int64),  # address of `longitudinal.narrow_tracked_friction`; 0: the friction stays
        ("control_speed", int64),  # address of `longitudinal.longitudinal_step`; 0: there is no speed control
        ("longitudinal", Longitudinal),  # empty without a speed control
    ),
)
"""A tracker with its controller, and with a speed control where it has one."""
_narrow_friction = Caller(void(Place(TrackerRecord), vector, Place(Longitudinal)))
_control_speed = Caller(void(Place(TrackerRecord), Place(Longitudinal)))
_reference = local(1)


@inlined
def _arrive(slot, tracking):
    """At the next control instant of a call; False at its end."""
    return begin_instant(tracking.tracker)


@inlined
def _apply_requests(slot, tracking):
    apply_requests(slot, tracking.tracker.request, tracking.controller)


@inlined
def _prepare(slot, tracking):
    """Do what is asked of the controller, and narrow the friction."""
    _apply_requests(slot, tracking)
    if tracking.narrow_friction != 0:
        learned = tracking.controller.mpc.informed.learned[slot]
        _narrow_friction(tracking.narrow_friction, tracking.tracker, learned, tracking.longitudinal)
    return True


@inlined
def _depart(slot, tracking):
    """Take in the answer: the caller has it at the end of the call."""
    conclude_instant(tracking.tracker)


@inlined
def _write_variables(tracker):
    """Write what a schedule goes by; friction that is not known is the nominal one, such wind none."""
    sample, variables = tracker.sample, tracker.variables
    friction, wind = sample[TRACKER_SAMPLE.friction], sample[TRACKER_SAMPLE.wind]
    variables[VARIABLE_COLUMNS.speed], variables[VARIABLE_COLUMNS.y_ref] = tracker.ahead[INSTANT.speed], 0.0
    variables[VARIABLE_COLUMNS.friction] = friction if math.isfinite(friction) else tracker.settings[0].nominal_friction
    variables[VARIABLE_COLUMNS.wind] = wind if math.isfinite(wind) else 0.0
    variables[VARIABLE_COLUMNS.change] = variables[VARIABLE_COLUMNS.acceleration] = 0.0
    variables[VARIABLE_COLUMNS.offset] = -tracker.memory[0].offset


@inlined
def _control(slot, tracking):
    """The controller's step."""
    tracker, controller = tracking.tracker, tracking.controller
    ahead, answer = tracker.ahead, tracker.answer
    _write_variables(tracker)
    control(
        slot, tracker.variables, ahead[INSTANT.speed], tracker.memory[0].command, ahead[INSTANT.station], 0,
        tracker.measured, _reference(), tracker.speeds[: whole(ahead[INSTANT.count])], tracker.path, controller,
    )  # fmt: skip
    output = controller.answer[slot]
    answer[CONTROLLER_ANSWER.command] = output[COMMON_ANSWER.command]
    answer[CONTROLLER_ANSWER.held] = output[COMMON_ANSWER.held]
    if controller.beliefs > 0:
        learned = output[controller.beliefs :]
        answer[CONTROLLER_ANSWER.belief_state] = learned[BELIEF_COLUMNS.belief_state]
        answer[CONTROLLER_ANSWER.belief_at_bound] = learned[BELIEF_COLUMNS.belief_at_bound]
        answer[CONTROLLER_ANSWER.delay_sigma] = learned[BELIEF_COLUMNS.belief_delay_sigma]
    else:
        answer[CONTROLLER_ANSWER.belief_state] = answer[CONTROLLER_ANSWER.belief_at_bound] = NO_BELIEF
        answer[CONTROLLER_ANSWER.delay_sigma] = 0.0


_drive_period = period_of(_arrive, _prepare, _control, _depart)


@exported(void(Place(Tracking)))
def tracker_step(tracking):
    """A call: the sample in `tracker.sample`, the answer in `tracker.tracked` and `longitudinal.memory`.

    It goes through all control instants since the last one; the speed control acts at the end.
    """
    tracker_take(tracking.tracker)
    while _drive_period(0, tracking):
        pass
    _apply_requests(0, tracking)
    if tracking.control_speed != 0:
        _control_speed(tracking.control_speed, tracking.tracker, tracking.longitudinal)


@exported(void(Place(Tracking)))
def tracker_apply(tracking):
    """Do at once what a tracker asks of its controller; else its next call does it."""
    _apply_requests(0, tracking)
