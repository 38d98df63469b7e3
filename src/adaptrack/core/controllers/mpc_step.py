"""A step of one MPC for Python."""

from __future__ import annotations

from ..kernel import Place, exported, float64, int64, record, vector, void
from .mpc import Functions, Mpc, step_with

Step = record("Step", (("mpc", Mpc), ("functions", Functions), ("reference", vector), ("tuning", vector)))
"""What a step of the MPC in slot 0 is given, beside the speed: y_ref (m), whose first `count` numbers count, and the
tuning as asked. Python writes to these arrays, and no address has to be found for a step."""


@exported(void(float64, int64, Place(Step)), name="mpc_step")
def step(speed, count, given):
    """One step of the MPC; see `mpc_parts.form_qp`."""
    step_with(0, speed, given.reference[:count], given.tuning, given.mpc, given.functions)
