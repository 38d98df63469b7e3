"""Many steps of one MPC on inputs at hand: a long search for inputs that break it."""

from __future__ import annotations

from ..kernel import exported, matrix, vector, void
from .mpc import MPC, Functions, step_with


@exported(void(matrix, vector, matrix, matrix, MPC, Functions, matrix))
def steps(states, speeds, references, tunings, mpc, functions, answers):
    """Step k of slot 0 of the MPC with rows k.

    They are measured quantities (k, MEASURED), speed (k,), y_ref (k, .), tuning (k, 4).
    answers: (k, .) what each step answered, as `mpc.ANSWER` and what is learned.
    """
    for k in range(speeds.size):
        for i in range(mpc.measured.size):
            mpc.measured[i] = states[k, i]
        step_with(0, speeds[k], references[k], tunings[k], mpc, functions)
        for i in range(answers.shape[1]):
            answers[k, i] = mpc.answer[0, i]
