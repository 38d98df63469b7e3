"""What makes a scheduler's output safe to use: domain, rate, tracking error and stability are checked at every step."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

from adaptrack.base.errors import InvalidInput, real, whole
from adaptrack.cars.vehicle import GRAVITY
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling.functions import Table
from adaptrack.control.scheduling.schedule import Pool, Schedule


@dataclass(frozen=True, eq=False)
class StabilityMap:
    """1 - modulus margin of the loop over speed (m/s), friction, Np, Nc and log10 R/Q; see `stability.loop_map`.

    Raises
    ------
    InvalidInput
        When the table has not these five axes, or the limit is not positive.
    """

    table: Table
    """above 1 the loop is unstable"""
    limit: float = 0.92
    """the largest value that is allowed: 1 - the least modulus margin"""

    def __post_init__(self) -> None:
        if not isinstance(self.table, Table) or len(self.table.axes) != 5 or self.table.method != "multilinear":
            raise InvalidInput("StabilityMap: needs a multilinear table over speed, friction, Np, Nc and log10 R/Q.")
        if not 0.0 < real("StabilityMap", "limit", self.limit) < math.inf:
            raise InvalidInput(f"StabilityMap: limit = {self.limit!r}: must be positive and finite.")

    def pack(self, row: Any, pool: Pool) -> None:
        """Write it to a guard's record (`core.guard.GUARD`) and the packed functions."""
        row.mapped, row.limit = True, self.limit
        pool.add(self.table, row)


@dataclass(frozen=True, eq=False)
class Guard:
    """What stands between a scheduler's output and the MPC.

    Raises
    ------
    InvalidInput
        When a limit is not positive, or a rate of the horizons not whole.
    """

    fallback: Tuning
    """used while the output is not trusted"""
    rates: tuple[float, float, float] = (5.0, 2.0, 0.3)
    """largest change of Np, of Nc (both whole numbers) and of log10 R/Q from one step to the next"""
    slack: float = 0.25
    """how far outside the domain an input may lie, in widths of the domain, before the fallback is used"""
    hold: int = 20
    """steps that a fallback lasts, the last one with its cause included"""
    stability: StabilityMap | None = None
    """without it the loop's stability is not looked at"""
    offset_limit: float | None = None
    """s^2, the largest |offset| over friction times g, before the fallback is used; without it any offset is allowed

    A tuning that is stable near the reference may not be so where the tyres saturate: an error too large for the grip
    to take back in time is the first sign of it."""

    def __post_init__(self) -> None:
        if not isinstance(self.fallback, Tuning):
            raise InvalidInput(f"Guard: fallback = {self.fallback!r}: must be a Tuning.")
        rates = [real("Guard", "rates", rate) for rate in self.rates]
        if len(rates) != 3 or not all(0.0 < rate < math.inf for rate in rates):
            raise InvalidInput(f"Guard: rates = {self.rates!r}: must be three positive numbers.")
        if any(rate != round(rate) for rate in rates[:2]):
            raise InvalidInput(f"Guard: rates = {self.rates!r}: those of Np and Nc must be whole numbers.")
        if not 0.0 <= real("Guard", "slack", self.slack) < math.inf:
            raise InvalidInput(f"Guard: slack = {self.slack!r}: must be finite and not negative.")
        if self.offset_limit is not None and not 0.0 < real("Guard", "offset_limit", self.offset_limit) < math.inf:
            raise InvalidInput(f"Guard: offset_limit = {self.offset_limit!r}: must be positive and finite.")
        whole("Guard", "hold", self.hold)

    def pack(self, row: Any, pool: Pool) -> None:
        """Write it to its record in a packed schedule (`core.guard.GUARD`)."""
        row.used, row.hold, row.slack = True, self.hold, self.slack
        row.fallback[:] = self.fallback.as_array()
        row.rates[:], row.ratio_rate = self.rates[:2], self.rates[2]
        row.offset_limit = math.inf if self.offset_limit is None else self.offset_limit * GRAVITY
        if self.stability is not None:
            self.stability.pack(row, pool)


def Guarded(schedule: Schedule, fallback: Tuning, *, stability: StabilityMap | None = None, **limits: Any) -> Schedule:
    """`schedule` behind a `Guard`: domain, rate, tracking error and stability are checked at every step."""
    guard = Guard(fallback, stability=stability, **limits)
    if not isinstance(schedule, Schedule):
        raise InvalidInput(f"Guarded: {schedule!r}: must be a Schedule; a plain function cannot be guarded.")
    return replace(schedule, guard=guard, name=f"{schedule.name} (guarded)")
