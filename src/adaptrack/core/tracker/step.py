"""A tracker around a compiled controller, and a speed control behind it: whole calls."""

from __future__ import annotations

import math

from ..controllers.part import COMMON_ANSWER, ControllerPart, apply_requests, control
from ..estimators.learning import Beliefs
from ..kernel import Caller, Place, exported, inlined, int64, local, record, vector, viewer, void
from ..loop import period_of
from ..scheduling.functions import VARIABLE_COLUMNS
from .instant import begin_instant, conclude_instant, expect_speeds
from .longitudinal import Longitudinal
from .pose import forward
from .records import TrackerRecord
from .signals import NO_BELIEF, sample_of
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
_reference, _beliefs_at = local(1), viewer(Beliefs)


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
    """Take in the answer, with what is learned: the caller has it at the end of the call."""
    m, answer, beliefs = tracking.tracker.memory[0], tracking.controller.answer[slot], tracking.controller.beliefs
    m.belief_state, m.belief_at_bound, m.delay_sigma = NO_BELIEF, NO_BELIEF, 0.0
    if beliefs > 0:
        learned = _beliefs_at(answer, beliefs)
        m.belief_state, m.belief_at_bound = learned.belief_state, learned.belief_at_bound
        m.delay_sigma = learned.belief_delay_sigma
    conclude_instant(tracking.tracker, answer[COMMON_ANSWER.command], answer[COMMON_ANSWER.held] > 0.5)


@inlined
def _write_variables(tracker):
    """Write what a schedule goes by; friction that is not known is the nominal one, such wind none."""
    sample, variables, m = sample_of(tracker.sample, 0), tracker.variables, tracker.memory[0]
    nominal = tracker.settings[0].nominal_friction
    variables[VARIABLE_COLUMNS.speed], variables[VARIABLE_COLUMNS.y_ref] = forward(m), 0.0
    variables[VARIABLE_COLUMNS.friction] = sample.friction if math.isfinite(sample.friction) else nominal
    variables[VARIABLE_COLUMNS.wind] = sample.wind if math.isfinite(sample.wind) else 0.0
    variables[VARIABLE_COLUMNS.change] = variables[VARIABLE_COLUMNS.acceleration] = 0.0
    variables[VARIABLE_COLUMNS.offset] = -m.offset


@inlined
def _control(slot, tracking):
    """The controller's step."""
    tracker, m = tracking.tracker, tracking.tracker.memory[0]
    _write_variables(tracker)
    control(
        slot, tracker.variables, forward(m), m.command, m.station, 0, tracker.measured, _reference(),
        tracker.speeds[: expect_speeds(tracker, m)], tracker.path, tracking.controller,
    )  # fmt: skip


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
