"""What an estimator is to the controller: from measurements to the state of the prediction model and a disturbance.

The paper's controller needs none: its increments of the measured state are the *deadbeat* estimator, whose disturbance
explains the last measurement whole, d(k) = x(k) - A x(k-1) - B u(k-1), with A and B at the present speed. The MPC keeps
that form as it is; any other estimator gives x and d, and the MPC predicts from them: Y = F [x(k+1) - x(k); y] with
x(k+1) = A x + B u + d, F being that of the next increment (`condensing.responses`). The deadbeat one needs the whole
state measured.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from ..kernel import Caller, float64, matrix, vector
from ..member import member

IMPOSSIBLE_SIGNAL, IMPOSSIBLE_SPEED = 1e5, 1e3
"""No signal of a car is as large as this, in SI units: what is counts as missing. And no speed, m/s."""

ESTIMATE = float64(float64, vector, float64, matrix, vector, vector, vector, vector, vector)
"""``estimate(speed, measured, command, a, b, parameters, memory, x, d)``: the time (s) of dead reckoning, for which no
position has been taken in, 0 for a new one. It writes the state x (n,) and the disturbance d (n,), what every period
adds to it, from the speed (m/s), the measured quantities (`models.contract.MEASURED`), the
command given a period ago (rad), and A, B of the model at the present speed. x is the state at the time when the next
command begins to act: behind the dead time, for a model that has one. memory: the estimator's own numbers of this run,
zero before its first step. A measurement that is not finite is one that is missing."""
call_estimate = Caller(ESTIMATE)


@lru_cache(maxsize=64)
def compile_estimator(function: Any) -> Any:
    """A user's function as a member of `ESTIMATE`. It may return nothing: 0 s."""
    return member(function, ESTIMATE)
