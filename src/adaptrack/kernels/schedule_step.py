"""A step of one schedule for Python."""

from __future__ import annotations

from numba import types

from .abi import ROUTINE, int64, njit, vector
from .schedule import read_schedule, schedule


@njit(types.void(vector, int64, vector), **ROUTINE)
def schedule_step(variables, address, tuning):
    """`schedule.schedule` for the schedule at an address (`stored.Resident` of `schedule.Schedule`), its only slot."""
    schedule(0, variables, read_schedule(address), tuning)
