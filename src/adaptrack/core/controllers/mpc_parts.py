"""The parts of an MPC step for Python: for QP back-ends that are not kernels."""

from __future__ import annotations

from ..kernel import exported, float64, int64, several, vector, void
from .mpc import MPC, Functions, _apply_move, _form_qp


@exported(several(int64, int64, int64)(int64, float64, vector, vector, MPC, Functions))
def form_qp(slot, speed, reference, tuning, mpc, functions):
    """The QP of eq. (17) for a slot of the MPCs.

    Returns its status so far, its variables n and its rows m. Takes the measurement from mpc.measured. speed: v_x
    (m/s); reference: y_ref (m) now and at the instants that follow; R_s holds its values from the next instant on with
    preview (the last one repeated as needed), its present value without. tuning: Np, Nc, Q, R as asked, the horizons
    rounded and clamped so that 1 <= Nc <= Np <= longest_horizon. The model, E and its factor are formed again when
    speed or tuning has changed by even one bit, and not otherwise.
    """
    return _form_qp(slot, speed, reference, tuning, mpc, functions)


@exported(void(int64, int64, int64, int64, int64, MPC))
def apply_move(slot, status, iterations, n, m, mpc):
    """Take the first move of the solution in the workspace, or what stands in for it; write the answer of the step.

    n, m: sizes of the QP. A move is taken when its QP is solved, or capped under HILDRETH_APPLIED; a capped one is
    clipped to its limits. Where nothing solves, the next move of the last plan is taken, none when the data are not
    finite, and the answer says `held`.
    """
    _apply_move(slot, status, iterations, n, m, mpc)
