"""A step of one schedule for Python."""

from __future__ import annotations

from ..kernel import Place, exported, vector, void
from .schedule import ScheduleRecord, schedule


@exported(void(vector, Place(ScheduleRecord), vector))
def schedule_step(variables, plan, tuning):
    """`schedule.schedule` for the only slot of a schedule."""
    schedule(0, variables, plan, tuning)
