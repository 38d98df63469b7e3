"""What a unit of co-simulation is: one vector of values, by place, and two functions.

A unit is a record that begins with its values, what each of them is (`adaptrack.export.fmu`), and the range of each
parameter and input. The values begin with `HEAD`; then come parameters, inputs and outputs. ``begin(unit)`` reads the
parameters and writes the outputs of the first instant; ``step(unit)`` reads the inputs, goes on by a period and writes
the outputs of the next instant. Both answer a status.
"""

from __future__ import annotations

from ..kernel import OK, columns, inlined

HEAD = columns("time", "period")
"""Every unit's values begin with these (s, s): time since its first instant, and how much a step adds to it."""

UNIT_FAILED, NO_DELAY, REFUSED = range(1, 4)
"""Status: done; the state is not finite; there is no period of delay that a parallel exchange could stand for; done,
but a trajectory is impossible. Below 0: a value that is not finite or out of its range, -1 - its place."""


@inlined
def outside(first, end, values, least, most):
    """The status of the first value between two places that is not within its range, `OK` without one."""
    for i in range(first, end):
        if not (values[i] >= least[i] and values[i] <= most[i]):
            return -1 - i
    return OK
