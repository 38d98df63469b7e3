"""Many steps of one MPC on inputs at hand: a long search for inputs that break it."""

from __future__ import annotations

from numba import types

from ..abi import ROUTINE, int64, matrix, njit, vector
from .mpc import FUNCTIONS, read_mpc, step_with


@njit(types.void(matrix, vector, matrix, matrix, int64, FUNCTIONS, matrix), **ROUTINE)
def steps(states, speeds, references, tunings, address, functions, answers):
    """Step k of slot 0 of the MPC at an address (`stored.Resident` of `mpc.Mpc`) with rows k.

    They are measured quantities (k, MEASURED), speed (k,), y_ref (k, .), tuning (k, 4).
    answers: (k, .) what each step answered, as `mpc.ANSWER` and what is learned.
    """
    mpc = read_mpc(address)
    for k in range(speeds.size):
        for i in range(mpc.measured.size):
            mpc.measured[i] = states[k, i]
        step_with(0, speeds[k], references[k], tunings[k], mpc, functions)
        for i in range(answers.shape[1]):
            answers[k, i] = mpc.answer[0, i]
