"""The paper's MPC, eqs. (8) to (17): it predicts from the last increment of the measured state, Y = F [dx; y].

That is the free response under the disturbance that explains the last measurement whole, found dead-beat:
d(k) = x(k) - A x(k-1) - B u(k-1). Moves are pulses or Laguerre functions, the QP is solved by the active set or by
Hildreth's procedure. On a curved road state and output count from the path.
"""

from __future__ import annotations

from ..kernel import inlined
from ..models.contract import MEASUREMENT
from ..qp import problem as qp
from . import prediction
from .mpc import MPC_ANSWER


@inlined
def _turn_previous(slot, mpc):
    """Count the state of the last step from the tangent of the path at the present foot."""
    turned, previous = mpc.measured[MEASUREMENT.turned], mpc.previous[slot]
    for i in range(mpc.states.size):
        if mpc.states[i] == MEASUREMENT.yaw:
            previous[i] -= turned
        elif mpc.states[i] == MEASUREMENT.y:
            previous[i] += 0.5 * mpc.memory[slot].speed * mpc.settings.period * turned


@inlined
def _increment(slot, mpc):
    """Write x(k) - x(k-1), zero at the first step; the measured y (m)."""
    started, command = mpc.memory[slot].started > 0, 0.0
    if mpc.settings.curved > 0:
        _turn_previous(slot, mpc)
    for i in range(mpc.states.size):
        command = mpc.measured[mpc.states[i]]
        mpc.ws.change[i] = command - mpc.previous[slot, i] if started else 0.0 * command
    return command  # the last state is the output


@inlined
def form_published(slot, speed, reference, tuning, mpc, functions):
    """The QP of eq. (17); see `mpc_step.form_qp`."""
    settings, memory = mpc.settings, mpc.memory[slot]
    mpc.answer[slot, MPC_ANSWER.dead_reckoning] = 0.0
    status, n, m = prediction.take_tuning(slot, tuning, 1.0, mpc)
    if status != qp.SOLVED:
        return status, n, m
    speed = max(speed, settings.speed_floor)
    if not prediction.is_formed(slot, speed, mpc):
        prediction.form_model(slot, speed, False, mpc, functions)
    prediction.compare(slot, _increment(slot, mpc), reference, mpc)
    prediction.limit_moves(slot, mpc)
    prediction.complete(slot, speed, n, mpc)
    return memory.factor_status, n, m
