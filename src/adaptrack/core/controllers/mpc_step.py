"""A step of an MPC, the published or the informed one: as a controller of `part`, and for Python."""

from __future__ import annotations

from typing import Any

from ..kernel import Place, columns, exported, float64, inlined, int64, matrix, record, several, vector, void
from ..maths.bits import whole
from ..qp import problem as qp
from ..roads.road import bend_ahead
from . import mpc as batch
from .contract import STANDSTILL_SPEED
from .informed import form_informed
from .mpc import MPC_PLACE, Functions, Mpc
from .part import APPLY, BEGIN, REQUEST, STEP, controller_part
from .published import form_published
from .receding import move_on, stand

STEP_INPUT = columns("speed", "count")
"""What a step is given: v_x (m/s), and how many numbers of y_ref count."""
MPCStep = record(
    "MPCStep", (("mpc", Mpc), ("functions", Functions), ("now", vector), ("reference", vector), ("tuning", vector))
)
"""A step of the MPC in slot 0: now (NOW,), y_ref (m) and the tuning as requested. Its caller writes to these arrays and
to mpc.measured, so nothing is converted and no address found for a step."""


@inlined
def step_with(slot, speed, reference, tuning, mpc, functions):
    """One step of a slot: form the QP, solve it, take the first move. Arguments as for `form_qp`."""
    status, n, m = form_qp(slot, speed, reference, tuning, mpc, functions)
    if status == qp.SOLVED and mpc.settings.informed > 0 and abs(speed) < STANDSTILL_SPEED:
        stand(slot, mpc)
    else:
        move_on(slot, status, n, m, mpc)


@exported(BEGIN)
def begin_mpc(slot, command, controller):
    """Let an MPC forget everything but the command (rad)."""
    batch.forget(slot, command, controller.mpc)


@exported(APPLY)
def request_of_mpc(slot, request, controller):
    """Do what a tracker asks of an MPC."""
    if request[REQUEST.restart] > 0.5:
        batch.restart(slot, controller.mpc)
    if request[REQUEST.change] > 0.5:
        turned, shifted = request[REQUEST.turned], request[REQUEST.shifted]
        batch.change_path(slot, turned, shifted, controller.takes_late, controller.mpc)


@exported(STEP)
def step_mpc(slot, speed, command, station, road, measured, reference, speeds, roads, controller):
    """One control period of an MPC, which sees the road ahead where it is made for curved roads."""
    mpc, settings = controller.mpc, controller.mpc.settings
    mpc.memory[slot].command = command
    mpc.measured[:] = measured
    if settings.curved > 0 and road >= 0:
        bend_ahead(
            station, speeds, max(speed, settings.speed_floor), batch.delay_of(slot, mpc), settings.period, road, roads,
            mpc.bend,
        )  # fmt: skip
    elif settings.curved > 0:
        mpc.bend[:] = 0.0
    step_with(slot, speed, reference, controller.tuning[slot], mpc, controller.functions)
    controller.answer[slot, :] = mpc.answer[slot]


def mpc_controller(controller: Any, mpc: Any) -> Any:
    """A `part.ControllerPart` of an `MPC` with the record of a batch (`mpc.batch`), before its first step."""
    beliefs = len(batch.MPC_ANSWER) if mpc.settings.learns else 0
    return controller_part(
        controller, len(mpc.memory), {"answer": mpc.answer.shape[1]}, controller.packed_tuning(), begin=begin_mpc,
        request=request_of_mpc, step=step_mpc, beliefs=beliefs, plans=1, mpc=mpc, functions=controller.functions,
    )  # fmt: skip


@exported(void(Place(MPCStep)), name="mpc_step")
def step(inputs):
    """One step of the MPC; see `form_qp`."""
    current, reference = inputs.now, inputs.reference[: whole(inputs.now[STEP_INPUT.count])]
    step_with(0, current[STEP_INPUT.speed], reference, inputs.tuning, inputs.mpc, inputs.functions)


@exported(void(matrix, vector, matrix, matrix, MPC_PLACE, Functions, matrix))
def steps(states, speeds, references, tunings, mpc, functions, answers):
    """Many steps of slot 0 on inputs at hand, step k with rows k: a long search for inputs that break it.

    They are measured quantities (k, MEASURED), speed (k,), y_ref (k, .), tuning (k, 4).
    answers: (k, .) what each step answered, as `mpc.MPC_ANSWER` and what is learned.
    """
    for k in range(speeds.size):
        mpc.measured[:] = states[k]
        step_with(0, speeds[k], references[k], tunings[k], mpc, functions)
        answers[k, :] = mpc.answer[0]


@exported(several(int64, int64, int64)(int64, float64, vector, vector, MPC_PLACE, Functions))
def form_qp(slot, speed, reference, tuning, mpc, functions):
    """The QP of eq. (17) for a slot of the MPCs, for back-ends that are not kernels; `receding.apply_move` is the rest.

    Returns its status so far, its variables n and its rows m. Takes the measurement from mpc.measured. speed: v_x
    (m/s); reference: y_ref (m) now and at the instants that follow; R_s holds its values from the next instant on with
    preview (the last one repeated as needed), its present value without. tuning: Np, Nc, Q, R as requested, the
    horizons rounded and clamped so that 1 <= Nc <= Np <= longest_horizon. The model, E and its factor are formed again
    when speed or tuning has changed by even one bit, and not otherwise.
    """
    if mpc.settings.informed > 0:
        return form_informed(slot, speed, reference, tuning, mpc, functions)
    return form_published(slot, speed, reference, tuning, mpc, functions)
