"""Feasible speeds and frictions: those at which some tuning gives a stable loop with a sufficient margin.

The linear closed loops of a grid of tunings show this in seconds, before any simulation or search.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from adaptrack.analysis.linearisation import Mismatch, SampleAges, Turn, linear_plants
from adaptrack.analysis.stability import COARSE_ANGLES, hard_turn, margin_map, speed_nodes
from adaptrack.base.checked import RISING, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_SPEED
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.cars.plant import Plant
from adaptrack.control.controllers import ENTRIES, MPC, Tuning
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.scenario.profile import Profile

MARGIN = 0.1
"""Sufficient modulus margin of a loop.

Each of 116 constant tunings with a larger margin at every speed and friction drove 100 drives without a failure
(docs/certify.md).
"""
TUNINGS = ((10.0, 20.0, 36.0, 60.0), (1.0, 4.0, 16.0), np.linspace(-3.0, 6.0, 16))
"""Grid of tunings: Np and Nc (control periods), log10 R/Q (R/Q in m^2/rad^2)."""


class FeasibleRanges(NamedTuple):
    """Ranges of speed and friction."""

    speed: tuple[float, float]
    """Lowest and highest speed (m/s)."""
    friction: tuple[float, float]
    """Lowest and highest friction coefficient."""

    def __str__(self) -> str:
        return f"{_range(*self.speed)} m/s on friction {_range(*self.friction)}"


@dataclass(frozen=True, eq=False)
class Feasibility:
    """Margins of n tunings on a grid of speeds and frictions.

    A point is feasible if the modulus margin of some tuning is at least `least`.
    """

    speeds: Array
    """Speeds of the grid (m/s), shape (v,)."""
    frictions: Array
    """Friction coefficients of the grid."""
    tunings: Array
    """Np, Nc, Q and R of each tuning, (n, 4)."""
    margins: Array
    """Modulus margins, (speeds, frictions, n), see `stability.modulus_margin`."""
    least: float = MARGIN
    """Sufficient modulus margin."""

    @classmethod
    def from_map(cls, axes: Sequence[Array], margins: Array, least: float = MARGIN) -> Self:
        """Return the feasibility from axes and margins of `stability.margin_map`, without the nodes with Nc > Np."""
        Np, Nc, ratio = (axis.ravel() for axis in np.meshgrid(*axes[2:], indexing="ij"))
        tunings = np.column_stack([Np, Nc, np.ones_like(ratio), portable.power(10.0, ratio)])
        fits = Nc <= Np
        by_tuning = margins.reshape(len(axes[0]), len(axes[1]), -1)
        return cls(axes[0], axes[1], tunings[fits], by_tuning[:, :, fits], least)

    def among(self, allowed: NDArray[np.bool_]) -> Self:
        """Return the feasibility with the allowed tunings only; allowed: (n,)."""
        return replace(self, tunings=self.tunings[allowed], margins=self.margins[:, :, allowed])

    @property
    def enough(self) -> NDArray[np.bool_]:
        """Whether the margin of each tuning is sufficient, (speeds, frictions, n)."""
        return np.asarray(self.margins >= self.least - 1e-9)

    @property
    def is_feasible(self) -> NDArray[np.bool_]:
        """Whether each point is feasible, (speeds, frictions)."""
        return np.asarray(self.enough.any(axis=2))

    @property
    def infeasible(self) -> list[tuple[float, float]]:
        """The infeasible points as (speed (m/s), friction)."""
        return [(float(self.speeds[i]), float(self.frictions[j])) for i, j in np.argwhere(~self.is_feasible)]

    @property
    def domain(self) -> FeasibleRanges | None:
        """The feasible domain with the most grid points, if each point may have a different tuning; None if empty."""
        box = largest_box(self.is_feasible[:, :, None])
        return None if box is None else self._domain(box)

    @property
    def constant(self) -> tuple[Tuning, FeasibleRanges] | None:
        """The tuning with sufficient margins in the domain with the most grid points, and this domain; None if empty.

        Among several such tunings it is the one with the largest margin.
        """
        box = largest_box(self.enough)
        if box is None:
            return None
        rows, columns = box
        Np, Nc, Q, R = self.tunings[np.argmax(self.margins[rows, columns].min(axis=(0, 1)))].tolist()
        return Tuning(int(Np), int(Nc), Q, R), self._domain(box)

    def _domain(self, box: tuple[slice, slice]) -> FeasibleRanges:
        speeds, frictions = self.speeds[box[0]], self.frictions[box[1]]
        return FeasibleRanges((float(speeds[0]), float(speeds[-1])), (float(frictions[0]), float(frictions[-1])))

    @property
    def requested(self) -> FeasibleRanges:
        """The requested domain, which the grid spans."""
        return self._domain((slice(None), slice(None)))

    @property
    def passed(self) -> bool:
        """Whether every point is feasible."""
        return bool(self.is_feasible.all())

    @property
    def verdict(self) -> str:
        """The infeasible points and the largest feasible domains in words."""
        demand = f"with a modulus margin of {self.least:g}"
        if self.domain is None:
            return f"Infeasible: no tuning holds the loop {demand} at any point of {self.requested}."
        if self.passed:
            first = f"Feasible: at every point of {self.requested} some tuning holds the loop {demand}."
        else:
            first = (
                f"Infeasible: no tuning holds the loop {demand} at {len(self.infeasible)} of {self.is_feasible.size} "
                f"points of {self.requested}: {self._infeasible_in_words()}. "
                f"The largest domain that can be held is {self.domain}."
            )
        assert self.constant is not None
        tuning, domain = self.constant
        reach = "all of it" if domain == self.requested else f"no more than {domain}"
        return f"{first} One constant (Np {tuning.Np}, Nc {tuning.Nc}, R/Q {tuning.R / tuning.Q:.3g}) holds {reach}."

    def _infeasible_in_words(self) -> str:
        """Return the infeasible speeds for each friction in words, with ranges of neighbouring grid points."""
        return "; ".join(
            f"{', '.join(_ranges(self.speeds, ~self.is_feasible[:, j]))} m/s on friction {mu:.3g}"
            for j, mu in enumerate(self.frictions.tolist())
            if not self.is_feasible[:, j].all()
        )

    def summary(self) -> dict[str, Any]:
        """Return verdict, domains and the best tuning at each point, for JSON."""
        best, constant = self.margins.argmax(axis=2), self.constant
        rows = [
            {"speed": speed, "friction": friction, "held": bool(self.is_feasible[i, j]),
             "modulus_margin": float(self.margins[i, j, best[i, j]]),
             **dict(zip(ENTRIES, self.tunings[best[i, j]].tolist(), strict=True))}
            for i, speed in enumerate(self.speeds.tolist()) for j, friction in enumerate(self.frictions.tolist())
        ]  # fmt: skip
        return {
            "verdict": self.verdict,
            "passed": self.passed,
            "margin": self.least,
            "domain": self.domain and self.domain._asdict(),
            "constant": constant and {**dict(zip(ENTRIES, constant[0].as_array().tolist(), strict=True)),
                                      **constant[1]._asdict()},
            "rows": rows,
        }  # fmt: skip


def largest_box(ok: NDArray[np.bool_]) -> tuple[slice, slice] | None:
    """Return rows and columns of the largest box in which one layer of ok (rows, columns, layers) is true throughout.

    The result is None if ok is nowhere true, and the first box among those of equal size.
    """
    most, largest = 0, None
    for left in range(ok.shape[1]):
        for right in range(left, ok.shape[1]):
            run = np.zeros(ok.shape[2], dtype=np.int64)
            for i in range(len(ok)):
                run = np.where(ok[i, left : right + 1].all(axis=0), run + 1, 0)
                size = int(run.max(initial=0)) * (right - left + 1)
                if size > most:
                    most, largest = size, (slice(i + 1 - int(run.max()), i + 1), slice(left, right + 1))
    return largest


def _ranges(values: Array, chosen: NDArray[np.bool_]) -> list[str]:
    """Return the chosen values in words, with neighbours as "low to high"."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], chosen, [False]])))
    return [_range(float(values[first]), float(values[past - 1])) for first, past in edges.reshape(-1, 2)]


def _range(low: float, high: float) -> str:
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"


_Speed = Annotated[Positive, MAX_SPEED]


@reports_progress("feasible")
@checked
def feasibility(
    plant: Plant,
    mpc: MPC,
    profile: str | Profile = "road",
    *,
    speed: Annotated[tuple[_Speed, _Speed], RISING, "m/s"] = (3.0, 30.0),
    friction: Annotated[tuple[Positive, Positive], RISING] = (0.3, 1.0),
    margin: Annotated[Positive, Field(lt=1.0)] = MARGIN,
    nodes: Sequence[ArrayLike] = TUNINGS,
    turn: Turn | None = hard_turn,
    mismatches: Sequence[Mismatch] = (),
    progress: ProgressCall | None = None,
) -> Feasibility:
    """Find the speeds and frictions at which some tuning of a controller has a sufficient modulus margin.

    The grid has speeds at most 2 m/s apart and three frictions. The margin of a tuning at a point is the smallest one
    of straight driving, the turn and all mismatches.

    Parameters
    ----------
    plant, profile
        The true car, its true steering, dead time and sensors, and the mean ages of its samples.
    mpc
        Controller; its own tuning and scheduler are ignored.
    speed, friction
        Lowest and highest speed (m/s) and friction coefficient.
    margin
        Sufficient modulus margin.
    nodes
        Values of Np and Nc (control periods) and of log10 R/Q (R/Q in m^2/rad^2) of the tunings. Values beyond the
        MPC's longest horizons are left out.
    turn
        Function that returns the lateral acceleration (m/s^2) of the turn for a speed (m/s) and a friction. None for
        straight driving only.
    mismatches
        Differences between the true car and `plant` and `profile`. The margin must also be sufficient with each of
        them in straight driving.
    progress
        Function called with (stage, steps done, steps in all).

    Raises
    ------
    InvalidInput
        When no tuning is left, or the plant cannot drive the turn.
    """
    allowed = (
        _up_to(nodes[0], mpc.longest_horizon), _up_to(nodes[1], mpc.most_moves), np.asarray(nodes[2], dtype=float)
    )  # fmt: skip
    if min(len(axis) for axis in allowed) == 0 or allowed[1].min() > allowed[0].max():
        raise InvalidInput(f"feasibility: nodes = {nodes!r}: no tuning with 1 <= Nc <= Np within the MPC's horizons.")
    slowest = max(speed[0], mpc.speed_floor)
    axes = (
        speed_nodes(slowest, max(slowest, speed[1])),
        np.linspace(*friction, 3 if friction[1] > friction[0] else 1),
        *allowed,
    )
    plants = linear_plants(plant, mpc.period, profile, turn, mismatches)
    margins = margin_map(mpc, plants, axes, COARSE_ANGLES, SampleAges.of(profile), progress)
    return Feasibility.from_map(axes, margins, margin)


def _up_to(axis: ArrayLike, most: int) -> Array:
    values = np.asarray(axis, dtype=float)
    return values[(values >= 1.0) & (values <= most)]
