"""Samples of a scenario at the control instants: plain arrays for simulations and kernels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from adaptrack.base.checked import Positive, checked, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_GRADE, MAX_SPEED
from adaptrack.core.maths.portable import Array
from adaptrack.core.planning.drive import bank_pull, drive_instants
from adaptrack.scenario.shapes import HIGHEST_FRICTION

STEEPEST_BANK = 0.8
"""Largest accepted bank angle of a road, to either side (rad)."""


@checked
@dataclass(frozen=True, eq=False)
class Signals:
    """Samples of a scenario at the control instants t_k = k * period, k = 0..n: n control periods have n + 1 samples.

    Every array is a C-contiguous float64 copy of its input. Compiled kernels need writeable arrays, but do not change
    them.

    Raises
    ------
    InvalidInput
        When lengths differ, a value is NaN or infinite, the time does not advance by the period, a speed is negative
        or above 100 m/s, or a friction coefficient is outside (0, 3].
    """

    period: Annotated[Positive, "s"]
    t: Array  # (n + 1,) s
    y_ref: Array  # (n + 1,) m, lateral position to follow; on a road, offset from its centre line
    speed: Array  # (n + 1,) m/s, reference of the longitudinal speed
    friction: Array  # (n + 1, 4) coefficients: front-left, front-right, rear-left, rear-right
    wind: Array  # (n + 1, 2) m/s, velocity of the air along world X and Y
    bank: Array | float = 0.0  # (n + 1,) rad, bank angle of the road, positive if it pulls the car to the left
    station: Array | float = 0.0  # (n + 1,) m, planned arc length along the road
    curvature: Array | float = 0.0  # (n + 1,) 1/m, curvature of the road at the planned arc length
    grade: Array | float = 0.0  # (n + 1,) dz/ds of the road, positive uphill

    def __post_init__(self) -> None:
        for name in ("t", "y_ref", "speed", "friction", "wind"):
            object.__setattr__(self, name, np.array(reals(name, getattr(self, name)), order="C"))
        samples = self.t.size
        for name in ("bank", "station", "curvature", "grade"):
            values = np.broadcast_to(reals(name, getattr(self, name)), (samples,))
            object.__setattr__(self, name, np.array(values, order="C"))
        for name in ("t", "y_ref", "speed", "friction", "wind", "bank", "station", "curvature", "grade"):
            shape = (samples, *{"friction": (4,), "wind": (2,)}.get(name, ()))
            values = getattr(self, name)
            if values.shape != shape:
                raise InvalidInput(f"{name} has shape {values.shape}; with {samples} instants it must be {shape}.")
            self._refuse(~np.isfinite(values), name, "must be finite")
        if samples < 2:
            raise InvalidInput("signals need at least two samples: one control period.")
        drift = np.abs(self.t - self.period * np.arange(samples))
        if drift.max() > 1e-6 * self.period:
            k = int(drift.argmax())
            raise InvalidInput(f"t[{k}] = {float(self.t[k])!r} s; it must be {k} periods of {self.period!r} s.")
        self._refuse(self.speed < 0.0, "speed", "must be >= 0 m/s")
        self._refuse(self.speed > MAX_SPEED.most, "speed", f"must be at most {MAX_SPEED.most} m/s ({MAX_SPEED.reason})")
        self._refuse(self.friction <= 0.0, "friction", "must be > 0")
        self._refuse(self.friction > HIGHEST_FRICTION, "friction", "must be a coefficient such as 0.8, at most 3")
        self._refuse(np.abs(self.bank) > STEEPEST_BANK, "bank", f"must be within +-{STEEPEST_BANK} rad")
        self._refuse(
            np.abs(self.grade) > MAX_GRADE, "grade", f"must be dz/ds within +-{MAX_GRADE}; 5 per cent are 0.05"
        )

    def _refuse(self, violations: np.ndarray, name: str, rule: str) -> None:
        """Raise InvalidInput for the first sample in `violations`, a mask of the array `name`."""
        if violations.any():
            first = tuple(np.argwhere(violations)[0])
            value = float(getattr(self, name)[first])
            where = f"sample {first[0]}" if name == "t" else f"t = {float(self.t[first[0]]):g} s"
            raise InvalidInput(f"{name} is {value!r} at {where}: {rule}.")

    @property
    def bank_acceleration(self) -> Array:
        """(n + 1,) lateral acceleration g sin(bank) by the banked road (m/s^2), positive to the left."""
        assert isinstance(self.bank, np.ndarray)  # since __post_init__
        acceleration = self.bank.copy()
        bank_pull(acceleration)
        return acceleration

    @property
    def n(self) -> int:
        """Number of control periods, one less than the number of samples."""
        return self.t.size - 1


def instants(n: int, period: float) -> Array:
    """Return the control instants 0..n (s), k * period.

    If the frequency f = 1 / period is a whole number, instant k is k / f, rounded once (0.3 instead of
    0.30000000000000004).
    """
    times = np.empty(n + 1)
    drive_instants(period, times)
    return times
