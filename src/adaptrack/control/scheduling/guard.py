"""What makes a scheduler's output safe to use: domain, rate, tracking error and stability are checked at every step."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Self

from adaptrack.base.checked import Count, NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling.functions import Pool, Table, load_function, save_function
from adaptrack.core.physics.forces import GRAVITY


@checked
@dataclass(frozen=True, eq=False)
class StabilityMap:
    """1 - modulus margin of the loop over speed (m/s), friction, Np, Nc and log10 R/Q; see `stability.loop_map`.

    Raises
    ------
    InvalidInput
        When the table has not these five axes.
    """

    table: Table
    """above 1 the loop is unstable"""
    limit: Positive = 0.92
    """the largest value that is allowed: 1 - the least modulus margin"""

    def __post_init__(self) -> None:
        if not isinstance(self.table, Table) or len(self.table.axes) != 5 or self.table.method != "multilinear":
            raise InvalidInput("StabilityMap: needs a multilinear table over speed, friction, Np, Nc and log10 R/Q.")

    def pack(self, row: Any, pool: Pool) -> None:
        """Write it to a guard's record (`core.scheduling.guard.GUARD`) and the packed functions."""
        row.mapped, row.limit = True, self.limit
        pool.add(self.table, row)


@checked
@dataclass(frozen=True, eq=False)
class Guard:
    """Supervision of a scheduler's output before it reaches the MPC.

    Raises
    ------
    InvalidInput
        When a rate of the horizons is not whole.
    """

    fallback: Tuning
    """used while the output is not trusted"""
    rates: tuple[Positive, Positive, Positive] = (5.0, 2.0, 0.3)
    """largest change of Np, of Nc (both whole numbers) and of log10 R/Q from one step to the next"""
    slack: NotNegative = 0.25
    """how far outside the domain an input may lie, in widths of the domain, before the fallback is used"""
    hold: Count = 20
    """steps that a fallback lasts, the last one with its cause included"""
    stability: StabilityMap | None = None
    """without it the loop's stability is not looked at"""
    offset_limit: Annotated[Positive, "s^2"] | None = None
    """the largest |offset| over friction times g, before the fallback is used; without it any offset is allowed

    A tuning that is stable near the reference may not be so where the tyres saturate: an error too large for the grip
    to take back in time is the first sign of it."""

    def __post_init__(self) -> None:
        if any(rate != round(rate) for rate in self.rates[:2]):
            raise InvalidInput(f"Guard: rates = {self.rates!r}: those of Np and Nc must be whole numbers.")

    def pack(self, row: Any, pool: Pool) -> None:
        """Write it to its record in a packed schedule (`core.scheduling.guard.GUARD`)."""
        row.used, row.hold, row.slack = True, self.hold, self.slack
        row.fallback[:] = self.fallback.as_array()
        row.rates[:], row.ratio_rate = self.rates[:2], self.rates[2]
        row.offset_limit = math.inf if self.offset_limit is None else self.offset_limit * GRAVITY
        if self.stability is not None:
            self.stability.pack(row, pool)

    def saved(self) -> dict[str, Any]:
        """Return the content of the guard's file (text, numbers, lists), which `loaded` reads back to the bit."""
        stability = self.stability
        return {
            "fallback": self.fallback.as_array().tolist(),
            "rates": list(self.rates),
            "slack": self.slack,
            "hold": self.hold,
            "offset_limit": self.offset_limit,
            "stability": stability and {"limit": stability.limit, "table": save_function(stability.table)},
        }

    @classmethod
    def loaded(cls, saved: Mapping[str, Any]) -> Self:
        """The guard that was `saved`; raises `KeyError`, `TypeError`, `ValueError` or `InvalidInput` if it is none."""
        Np, Nc, Q, R = saved["fallback"]
        stability = saved["stability"]
        if stability is not None:
            table = load_function(stability["table"])
            if not isinstance(table, Table):
                raise InvalidInput("the guard's stability map is no table")
            stability = StabilityMap(table, stability["limit"])
        return cls(
            Tuning(int(Np), int(Nc), Q, R), tuple(saved["rates"]), saved["slack"], saved["hold"], stability,
            saved["offset_limit"],
        )  # fmt: skip
