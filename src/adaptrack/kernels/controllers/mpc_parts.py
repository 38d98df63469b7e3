"""The parts of an MPC step for Python: for QP back-ends that are not kernels."""

from __future__ import annotations

from numba import types

from ..abi import ROUTINE, float64, int64, njit, vector
from .mpc import FUNCTIONS, call_apply_move, call_form_qp, read_mpc


@njit(types.UniTuple(int64, 3)(int64, float64, vector, vector, int64, FUNCTIONS), **ROUTINE)
def form_qp(slot, speed, reference, tuning, address, functions):
    """The QP of eq. (17) for a slot of the MPCs at an address (`stored.Resident` of `mpc.Mpc`).

    Returns its status so far, its variables n and its rows m. Takes the measurement from mpc.measured. speed: v_x
    (m/s); reference: y_ref (m) now and at the instants that follow; R_s holds its values from the next instant on with
    preview (the last one repeated as needed), its present value without. tuning: Np, Nc, Q, R as asked, the horizons
    rounded and clamped so that 1 <= Nc <= Np <= longest_horizon. The model, E and its factor are formed again when
    speed or tuning has changed by even one bit, and not otherwise.
    """
    return call_form_qp(functions.form_qp, slot, speed, reference, tuning, read_mpc(address), functions)


@njit(types.void(int64, int64, int64, types.UniTuple(int64, 2), int64, FUNCTIONS), **ROUTINE)
def apply_move(slot, status, iterations, size, address, functions):
    """Take the first move of the solution in the workspace, or what stands in for it; write the answer of the step.

    size: (n, m) of the QP. A move is taken when its QP is solved, or capped under HILDRETH_APPLIED; a capped one is
    clipped to its limits. Where nothing solves, the next move of the last plan is taken, none when the data are not
    finite, and the answer says `held`.
    """
    call_apply_move(functions.apply_move, slot, status, iterations, size, read_mpc(address))
