"""A step of one MPC for Python."""

from __future__ import annotations

from numba import types

from ..abi import ROUTINE, float64, int64, njit, vector
from .mpc import FUNCTIONS, read_mpc, step_with


@njit(types.void(float64, vector, vector, int64, FUNCTIONS), **ROUTINE)
def step(speed, reference, tuning, address, functions):
    """One step of the MPC at an address (`stored.Resident` of `mpc.Mpc`), its only slot; see `mpc_parts.form_qp`."""
    step_with(0, speed, reference, tuning, read_mpc(address), functions)
