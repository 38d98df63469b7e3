"""Controllers in Python as parts of compiled loops."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.control.controllers.base import Command, Controller, command_of, step_call
from adaptrack.core.controllers.part import COMMON_ANSWER, controller_part
from adaptrack.core.estimators.learning import BELIEF_NAMES
from adaptrack.core.member import CallBack

Array = NDArray[np.float64]


def python_part(controller: Controller | None, step: CallBack | None, request: CallBack | None = None) -> Any:
    """A controller in Python as a part of compiled loops (`core.controllers.part.ControllerPart`), for one slot.

    Its answer says what it has learned, if it learns. controller, step: None if the caller of the loop is the
    controller.
    """
    learns = controller is not None and controller.learner is not None
    part = controller_part(
        controller, 1, {"answer": len(COMMON_ANSWER) + (len(BELIEF_NAMES) if learns else 0)},
        request=request, step=step, beliefs=len(COMMON_ANSWER) if learns else 0,
    )  # fmt: skip
    if controller is None:
        return part
    informed = part.mpc.informed._replace(learned=controller.learner_memory[None])
    return part._replace(mpc=part.mpc._replace(informed=informed))


class CalledController:
    """A controller in Python, as a compiled loop calls it."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.call = controller, step_call(controller)
        self._answered = math.nan  # rad, its last command; NaN before its first

    def restart(self) -> None:
        """Let the controller begin anew; what it has learned stays."""
        self.controller.restart()
        self._answered = math.nan

    def step(self, before: float, measured: Array, speed: float, reference: Array, *variables: Any, **road: Any) -> Any:
        """One step of the controller, which is told the command in force (rad) where that is not its own."""
        controller: Any = self.controller
        if before != self._answered:
            controller.applied(before)
        state = measured if controller.sees_all_sensors else measured[:4]  # wheel angle and accelerometer
        return self.call(controller.step, state, speed, reference, *variables, **road)

    def write(self, answered: Any, before: float, row: Array) -> Command:
        """Write what the controller answered to the row of its part, and return it as a command."""
        command = command_of(answered, before, self.call)
        row[: len(COMMON_ANSWER)] = command.angle, command.angle - before, command.held
        if self.controller.learner is not None:
            row[len(COMMON_ANSWER) :] = getattr(answered, "learned", math.nan)
        self._answered = command.angle
        return command
