"""After the controller: its command, and what the instant was."""

from __future__ import annotations

import math

from ..kernel import Place, exported, inlined, void
from .pose import hold, is_beyond
from .records import CONTROLLER_ANSWER, STANDSTILL_SPEED, TrackerRecord
from .signals import BEYOND_END, ESTIMATED, FOLLOWING, HELD, OFF_PATH, STANDS


@exported(void(Place(TrackerRecord)))
def tracker_conclude(tracker):
    """Take in the controller's answer (`tracker.answer`) at an instant; nothing where none is waited for.

    A command that is no number holds the last one.
    """
    m, answer = tracker.memory[0], tracker.answer
    if m.waiting == 0:
        return
    m.waiting, previous = 0, m.command
    usable = math.isfinite(answer[CONTROLLER_ANSWER.command])
    m.command = answer[CONTROLLER_ANSWER.command] if usable else previous
    m.belief_state, m.belief_at_bound = (
        answer[CONTROLLER_ANSWER.belief_state],
        answer[CONTROLLER_ANSWER.belief_at_bound],
    )
    m.status, m.answered = _status(tracker, m, not usable or answer[CONTROLLER_ANSWER.held] > 0.5), 1
    m.due -= 1
    if m.due > 0:  # at an instant without a call nothing was sent
        hold(tracker, m, previous)


@inlined
def _status(tracker, m, is_held):
    """The status of an instant, one of `STATUS`."""
    if m.offset != m.offset:
        return OFF_PATH
    if is_held:
        return HELD
    if m.speed < STANDSTILL_SPEED:
        return STANDS
    if not abs(m.offset) <= tracker.settings[0].furthest:
        return OFF_PATH
    if is_beyond(tracker, m.station):
        return BEYOND_END
    return FOLLOWING if m.fresh > 0 else ESTIMATED
