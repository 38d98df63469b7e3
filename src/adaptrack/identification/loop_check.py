"""Contradictions between the columns of a log, by the checks of a tracker and by comparisons over the whole log."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.input_check import InputCheck
from adaptrack.core.input_check.hypotheses import MISTAKES
from adaptrack.identification.hypotheses import Evidence, cleaned_log, compare
from adaptrack.identification.log import check_times, require_columns
from adaptrack.identification.reading import Columns

SIGNALS = ("speed", "yaw_rate", "vy", "acceleration", "wheel", "command", "longitudinal_acceleration")
USUAL_WHEELBASE = 2.8
"""m, of a car that is not given."""
USUAL_MASS = 1600.0
"""kg, of a car that is not given."""
LEAST = 2.0
"""s, from which on a comparison of windows tells something."""


class ComparedSignals(NamedTuple):
    """One comparison of signals of a log."""

    compared: str
    seconds: float
    """of driving in which both could be compared"""
    verdict: Literal["contradictory", "consistent", "unknown"]


class LoopCheck(NamedTuple):
    """Result of a check of the columns of a log."""

    contradictions: tuple[str, ...]
    """sentences: column, measured contradiction, remedy; those of the whole log first, each mistake once"""
    possibilities: tuple[str, ...]
    """sentences on mistakes that are possible, but not certain"""
    comparisons: tuple[ComparedSignals, ...]
    """of windows of half a second, then of the whole log"""
    seconds: float
    """from the first sample to the last, on the log's clock"""
    sliding: float
    """s, for which the car slid"""
    limit: str
    """why the whole log could not be compared; empty where it was"""

    @property
    def compared(self) -> int:
        """How many comparisons tell something."""
        return sum(comparison.verdict != "unknown" for comparison in self.comparisons)


def check_loop(columns: Columns, vehicle: Vehicle | None = None) -> LoopCheck:
    """Compare the columns of a log.

    vehicle: the car, for the size of its turning and the place of its centre of mass; without one only gross errors of
    the former are recognised. Raises InvalidInput when there is no time, or no speed, or the times cannot be in s.
    """
    values = columns.values
    require_columns(values, "time", "speed")
    instants = np.unique(values["time"][np.isfinite(values["time"])])
    if instants.size > 1:
        check_times(instants)
    check, sliding = _run_check(columns, vehicle)
    wheelbase, mass = (vehicle.wheelbase, vehicle.mass) if vehicle else (USUAL_WHEELBASE, USUAL_MASS)
    evidence, limit = Evidence(values, wheelbase, mass), ""
    try:
        evidence = replace(evidence, cleaned=cleaned_log(columns, wheelbase))
    except InvalidInput as error:
        limit = str(error).removeprefix("log: ")
    agreements, seconds = compare(evidence, "positions", "signals", "speed"), float(np.ptp(instants))
    comparisons = [_compared(*numbers, LEAST) for numbers in check.compared]
    comparisons += [
        _compared(agreement.compared, seconds * agreement.clear, bool(agreement.contradiction))
        for agreement in agreements
    ]
    reported = {MISTAKES._fields[mistake]: mistake for mistake in check.mistakes}
    sentences: dict[str, str] = {}  # by the mistake, or the compared signals
    for agreement in agreements:
        if agreement.contradiction:
            sentences.setdefault(agreement.mistake or agreement.compared, agreement.contradiction)
    for name, mistake in reported.items():
        sentences.setdefault(name, check.sentence(mistake, for_log=True, steered=evidence.steered))
    possibilities = [
        agreement.possibility for agreement in agreements if agreement.possibility and agreement.mistake not in reported
    ]
    return LoopCheck(tuple(sentences.values()), tuple(possibilities), tuple(comparisons), seconds, sliding, limit)


def _compared(signals: str, seconds: float, contradicts: bool, least: float = 0.0) -> ComparedSignals:
    """Return a comparison that tells something from more than `least` (s) on."""
    return ComparedSignals(
        signals, seconds, "contradictory" if contradicts else "consistent" if seconds > least else "unknown"
    )


def _run_check(columns: Columns, vehicle: Vehicle | None) -> tuple[InputCheck, float]:
    """The check of a tracker over a log, and the seconds for which the car slid."""
    time = columns.values["time"]
    missing = np.full(time.size, math.nan)
    signals = {name: columns.values.get(name, missing) for name in SIGNALS}
    if columns.ratio_unknown:
        signals["command"] = missing
    if not np.isfinite(signals["command"]).any():
        signals["command"], signals["wheel"] = signals["wheel"], missing
    pose = np.stack([columns.values.get(name, missing) for name in ("x", "y", "yaw")], axis=-1)
    check, sliding, before = InputCheck(vehicle), 0.0, math.nan
    rows = np.column_stack([time, pose, *signals.values()])[np.isfinite(time)]
    for t, x, y, yaw, *rest in rows.tolist():
        check.add(t, t, (x, y, yaw), *rest)
        sliding += t - before if check.sliding and 0.0 < t - before < 1.0 else 0.0
        before = t
    return check, sliding
