"""Failures of a run: off the road, spun or not finite. Compiled and recorded runs use the same limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Bound, Hint, checked
from adaptrack.core.maths import portable
from adaptrack.core.simulation import world as kernel
from adaptrack.drive.trajectory import Trajectory

DISTANCE = 5.0
"""Largest distance from the reference (m). A vehicle that was nearer before and is farther away is off the road."""

SIDESLIP = math.pi / 4
"""Largest sideslip angle (rad); beyond it, a vehicle has spun. Drivers rarely catch a car beyond 10 to 15°."""

MIN_JUDGED_SPEED = 1.0
"""Lowest speed (m/s) at which sideslip and heading error are evaluated; they are ill-defined near standstill."""


class Reason(StrEnum):
    """Reason of a failure."""

    OFF_ROAD = "off-road"
    SPUN = "spun"
    NOT_FINITE = "not-finite"


_REASONS = {
    kernel.OFF_ROAD: Reason.OFF_ROAD.value, kernel.NEVER_ARRIVED: Reason.OFF_ROAD.value,
    kernel.SPUN: Reason.SPUN.value, kernel.STATE_NOT_FINITE: Reason.NOT_FINITE.value,
}  # fmt: skip


def failure_of(ended: int, at: float = math.nan) -> tuple[str | None, float]:
    """Return the reason and time (s) of the failure that the kernels report as `ended`.

    They are None and NaN for a run that is complete or was stopped at a limit of its cost. A car that never came near
    its reference has also failed.
    """
    reason = _REASONS.get(ended)
    return reason, at if reason is not None else math.nan


@checked
@dataclass(frozen=True)
class FailureLimits:
    """Limits beyond which a run counts as failed; infinity disables a limit."""

    distance: Annotated[Bound, "m", Hint("inf: no limit")] = DISTANCE
    """Largest distance from the reference (m). It counts from the first instant at which the vehicle is nearer."""
    sideslip: Annotated[Bound, "rad", Hint("inf: no limit")] = SIDESLIP
    """Largest sideslip angle (rad), evaluated at 1 m/s or more."""

    @classmethod
    def of(cls, plant: Any) -> Self:
        """Return the limits for a plant: the failure distance of its car's domain, or the default without a car."""
        domain = getattr(getattr(plant, "vehicle", None), "domain", None)
        return cls() if domain is None else cls(distance=domain.failure_distance)


@dataclass(frozen=True)
class Failed:
    """Time and reason of a failure."""

    step: int
    """Index of the first control instant at which the run has failed."""
    time: float
    """Time of this instant (s)."""
    reason: str
    """A `Reason`, or the reason in a trajectory of a different program."""
    clause: str
    """Reason with numbers; completes a sentence that starts with "the vehicle"."""


@checked
def find_failure(trajectory: Trajectory, rule: FailureLimits | None = None) -> Failed | None:
    """Return the time and reason of a run's failure; None if it did not fail.

    The earliest of these events is the failure:

    * a state or a command is not finite;
    * |e| exceeds `rule.distance` after it was smaller. A run that starts outside this distance is checked once it has
      arrived; if it never arrives, it has failed from its start;
    * the sideslip angle |atan2(v_y, v_x)| exceeds `rule.sideslip` at 1 m/s or more;
    * the simulation ended the run (`Trajectory.failed`).

    Parameters
    ----------
    trajectory
        The run.
    rule
        Limits; by default those of the car (`Trajectory.meta`: ``failure_distance``), otherwise `FailureLimits()`.
    """
    rule = rule or FailureLimits(distance=trajectory.meta.get("failure_distance", DISTANCE))
    not_finite = ~state_is_finite(trajectory)
    with np.errstate(invalid="ignore", over="ignore"):
        inside = np.abs(trajectory.error) <= rule.distance
        outside = ~inside & (np.arange(inside.size) >= np.argmax(inside))  # argmax is 0 when it never arrives
        sideslip = np.abs(portable.atan2(trajectory.vy, trajectory.vx))
        spinning = (portable.hypot(trajectory.vx, trajectory.vy) >= MIN_JUDGED_SPEED) & (sideslip > rule.sideslip)
    left = f"left the road (more than {rule.distance:g} m from the reference)"
    never = f"never came within {rule.distance:g} m of the reference"
    clauses = {
        Reason.NOT_FINITE: "reached a state that is not finite",
        Reason.SPUN: f"spun (sideslip beyond {math.degrees(rule.sideslip):.0f}°)",
        Reason.OFF_ROAD: left if inside.any() else never,
    }
    ended = np.zeros(len(trajectory), bool)
    if trajectory.failed is not None:  # may lie after the last recorded instant
        ended = trajectory.t >= trajectory.failed_at - 1e-6 * trajectory.period
        ended[-1] = True
    events: tuple[tuple[NDArray[np.bool_], str], ...] = (  # at the same instant, the first in this order is the failure
        (ended, trajectory.failed or ""),
        (not_finite, Reason.NOT_FINITE),
        (spinning, Reason.SPUN),
        (outside, Reason.OFF_ROAD),
    )
    occurrences = [(int(np.argmax(event)), reason) for event, reason in events if event.any()]
    if not occurrences:
        return None
    step, reason = min(occurrences, key=lambda item: item[0])
    known_clauses = {str(known_reason): text for known_reason, text in clauses.items()}
    clause = known_clauses.get(str(reason), f"was stopped by its simulation: {reason}")
    return Failed(step, float(trajectory.t[step]), reason, clause)


def state_is_finite(trajectory: Trajectory) -> NDArray[np.bool_]:
    """Whether pose, velocities, steering, command and reference are all finite at each instant, (n,)."""
    names = ("X", "Y", "psi", "vx", "vy", "yaw_rate", "steering", "command", "y_ref")
    return np.isfinite(np.stack([getattr(trajectory, name) for name in names])).all(axis=0)
