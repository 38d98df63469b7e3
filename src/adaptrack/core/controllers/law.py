"""A control law as a part of a loop: the function of `contract` as a controller of `part`."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..kernel import address_of, exported
from ..models.contract import MEASUREMENT
from ..roads.road import RoadAheadRecord, line_of
from .contract import Situation, call_law, write_situation
from .part import APPLY, BEGIN, COMMON_ANSWER, REQUEST, STEP, controller_part

_COMMAND = 0
"""Where a law answers its command; its diagnostics are behind."""


@exported(BEGIN)
def begin_law(slot, command, controller):
    """Let a law forget everything; it is told the command at every step."""
    controller.law.memory[slot, :] = 0.0


@exported(APPLY)
def request_of_law(slot, request, controller):
    """Restart a law, which knows of the path only what a step tells it."""
    if request[REQUEST.restart] > 0.5:
        controller.law.memory[slot, :] = 0.0


@exported(STEP)
def step_law(slot, speed, command, station, road, measured, reference, speeds, roads, controller):
    """One control period of a law; a command that is not finite holds the last one."""
    law, out, answer = controller.law, controller.answer[slot], controller.law.answer
    vy = measured[MEASUREMENT.vy] if law.has_vy > 0 else 0.0
    yaw, yaw_rate, y = measured[MEASUREMENT.yaw], measured[MEASUREMENT.yaw_rate], measured[MEASUREMENT.y]
    write_situation(law.situation, 0, Situation(vy, yaw, yaw_rate, y, speed, command))
    ahead = reference if law.preview > 0 else reference[:1]
    road_ahead = RoadAheadRecord(line_of(road, roads), station, speeds)
    call_law(
        law.function, law.situation, ahead, road_ahead, controller.tuning[slot], law.parameters, law.memory[slot],
        answer,
    )  # fmt: skip
    usable = math.isfinite(answer[_COMMAND])
    out[COMMON_ANSWER.command] = answer[_COMMAND] if usable else command
    out[COMMON_ANSWER.command_change] = out[COMMON_ANSWER.command] - command
    out[COMMON_ANSWER.held] = 1.0 if not usable or (law.held > 0 and answer[law.held] > 0.5) else 0.0
    diagnostics, recorded = answer[_COMMAND + 1 :], out[len(COMMON_ANSWER) :]
    for i in range(recorded.size):
        recorded[i] = diagnostics[i]


def law_controller(slots: int, law: Any, has_vy: bool = True) -> Any:
    """A `part.ControllerPart` of a `CompiledController` for `slots` slots, before its first step."""
    diagnostics, parameters = law.diagnostic_names, np.array(law.parameters(), float)
    sizes = {
        "answer": len(COMMON_ANSWER) + len(diagnostics), "law_parameters": parameters.size,
        "law_memory": law.memory_size, "law_answer": 1 + len(diagnostics),
    }  # fmt: skip
    part = controller_part(
        law, slots, sizes, law.packed_tuning(), begin=begin_law, request=request_of_law, step=step_law
    )
    part.law.parameters[:] = parameters
    held = 1 + diagnostics.index("held") if "held" in diagnostics else 0
    own = {"function": address_of(law.function), "held": held, "preview": int(law.preview), "has_vy": int(has_vy)}
    return part._replace(law=part.law._replace(**own))
