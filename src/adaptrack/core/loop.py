"""The control period: the order of its parts, once for all loops.

    arrive ──> prepare ──> control ──> depart

A loop states each of them as a function of a slot and of the loop's record:

    arrive      at a control instant: where the car is, what is measured; whether there is one
    prepare     what precedes the controller: what is asked of it between two steps, the friction, a speed control;
                whether the controller is to answer now
    control     the controller's step
    depart      its answer goes to the car, and what the instant was is noted

A simulated car is a part that moves between two periods (`simulation.run`). The car of a tracker is its caller: a call
brings the samples with which it arrives, and takes the command with which it departs (`tracker.step`).
"""

from __future__ import annotations

from typing import Any

from .kernel import inlined


def period_of(arrive: Any, prepare: Any, control: Any, depart: Any) -> Any:
    """An inlined function ``drive_period(slot, loop)``: one control period, and whether the controller answered."""

    def drive_period(slot, loop):
        if not arrive(slot, loop) or not prepare(slot, loop):
            return False
        control(slot, loop)
        depart(slot, loop)
        return True

    return inlined(drive_period)
