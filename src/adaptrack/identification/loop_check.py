"""Which columns of a log contradict each other, by the checks that a tracker makes while it drives."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.input_check import Finding, InputCheck
from adaptrack.identification.log import check_times
from adaptrack.identification.reading import Columns

SIGNALS = ("speed", "yaw_rate", "vy", "acceleration", "wheel", "command")


class LoopCheck(NamedTuple):
    """What a log says of its own columns."""

    contradictions: tuple[str, ...]
    """sentences: the column, what is measured, the remedy"""
    found: tuple[Finding, ...]
    seconds: float
    """from the first sample to the last, on the log's clock"""
    sliding: float
    """s, for which the car slid"""


def check_loop(columns: Columns, vehicle: Vehicle | None = None) -> LoopCheck:
    """Compare the columns of a log.

    vehicle: the car, for the size of its turning and the place of its centre of mass; without one neither is compared.

    Raises
    ------
    InvalidInput
        When there is no time, or no speed, or the times cannot be in s.
    """
    values = columns.values
    for name in ("time", "speed"):
        if name not in values or not np.isfinite(values[name]).any():
            raise InvalidInput(f"log: no column for {name}: name it, --columns {name}=NAME.")
    time = values["time"]
    instants = np.unique(time[np.isfinite(time)])
    if instants.size > 1:
        check_times(instants)
    missing = np.full(time.size, math.nan)
    signals = {name: values.get(name, missing) for name in SIGNALS}
    if not np.isfinite(signals["command"]).any():
        signals["command"], signals["wheel"] = signals["wheel"], missing
    place = np.stack([values.get(name, missing) for name in ("x", "y", "yaw")], axis=-1)
    check, sliding, before = InputCheck(vehicle), 0.0, math.nan
    rows = np.column_stack([time, place, *signals.values()])[np.isfinite(time)]
    for t, x, y, yaw, *rest in rows.tolist():
        check.add(t, t, (x, y, yaw), *rest)
        sliding += t - before if check.sliding and 0.0 < t - before < 1.0 else 0.0
        before = t
    return LoopCheck(check.suspect, check.findings, float(np.ptp(rows[:, 0])), sliding)
