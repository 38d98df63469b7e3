"""When a run has failed: off the road, spun, or not finite. One rule, for compiled runs and for recorded ones."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Bound, Hint, checked
from adaptrack.drive.trajectory import Trajectory

DISTANCE = 5.0
"""m, the distance from the reference beyond which a vehicle that has arrived there is off the road."""

SIDESLIP = math.pi / 4
"""rad, the sideslip angle beyond which a vehicle has spun; passenger cars are hard to catch beyond 10-15°."""

MIN_JUDGED_SPEED = 1.0
"""m/s: below it sideslip and path heading are ill-defined, and samples are not judged by them."""


class Reason(StrEnum):
    """Why a run failed."""

    OFF_ROAD = "off-road"
    SPUN = "spun"
    NOT_FINITE = "not-finite"

    @property
    def sentence(self) -> str:
        """The failure in a sentence."""
        return {
            Reason.OFF_ROAD: "The vehicle left the road, or never came to its reference.",
            Reason.SPUN: "The vehicle spun: it slid more sideways than a driver can catch.",
            Reason.NOT_FINITE: "The vehicle reached a state, or the controller gave a command, that is not finite.",
        }[self]


@checked
@dataclass(frozen=True)
class Failure:
    """The rule by which a run has failed; infinity switches a part of it off."""

    distance: Annotated[Bound, "m", Hint("inf: no limit")] = DISTANCE
    """from the reference, once it was that near."""
    sideslip: Annotated[Bound, "rad", Hint("inf: no limit")] = SIDESLIP
    """at 1 m/s or more."""

    @classmethod
    def of(cls, plant: Any) -> Self:
        """The rule of the car that is driven: the failure distance of its domain; the default where no car is known."""
        domain = getattr(getattr(plant, "vehicle", None), "domain", None)
        return cls() if domain is None else cls(distance=domain.failure_distance)


@dataclass(frozen=True)
class Failed:
    """When and why a run failed."""

    step: int
    """Index of the first control instant at which it had."""
    time: float
    """s, that instant."""
    reason: str
    """A `Reason`, or what the loop that drove it said."""
    clause: str
    """The reason with its numbers, to complete "the vehicle ..."."""


@checked
def find_failure(trajectory: Trajectory, rule: Failure | None = None) -> Failed | None:
    """When and why a run failed by `rule`; None when it did not.

    Without a rule it is that of the car that was driven (`Trajectory.meta`: ``failure_distance``), else `Failure()`.
    The first of these decides:

    * a state or a command is not finite;
    * |e| > `rule.distance` [m] at an instant that follows one with |e| <= `rule.distance`: a run that starts further
      away (a large step) is judged once it has arrived, and has failed from its start when it never arrives;
    * the sideslip angle |atan2(v_y, v_x)| exceeds `rule.sideslip` [rad] at 1 m/s or more;
    * the loop that drove it ended it (`Trajectory.failed`).
    """
    rule = rule or Failure(distance=trajectory.meta.get("failure_distance", DISTANCE))
    broken = ~state_is_finite(trajectory)
    with np.errstate(invalid="ignore", over="ignore"):
        inside = np.abs(trajectory.error) <= rule.distance
        outside = ~inside & (np.arange(inside.size) >= np.argmax(inside))  # argmax is 0 when it never arrives
        sideslip = np.abs(np.arctan2(trajectory.vy, trajectory.vx))
        spinning = (np.hypot(trajectory.vx, trajectory.vy) >= MIN_JUDGED_SPEED) & (sideslip > rule.sideslip)
    left = f"left the road (more than {rule.distance:g} m from the reference)"
    never = f"never came within {rule.distance:g} m of the reference"
    clauses = {
        Reason.NOT_FINITE: "reached a state that is not finite",
        Reason.SPUN: f"spun (sideslip beyond {math.degrees(rule.sideslip):.0f}°)",
        Reason.OFF_ROAD: left if inside.any() else never,
    }
    ended = np.zeros(len(trajectory), bool)
    if trajectory.failed is not None:  # at the end of a period, when the next instant was not recorded any more
        ended = trajectory.t >= trajectory.failed_at - 1e-6 * trajectory.period
        ended[-1] = True
    events: tuple[tuple[NDArray[np.bool_], str], ...] = (  # in the order that decides at the same instant
        (ended, trajectory.failed or ""),
        (broken, Reason.NOT_FINITE),
        (spinning, Reason.SPUN),
        (outside, Reason.OFF_ROAD),
    )
    occurrences = [(int(np.argmax(event)), reason) for event, reason in events if event.any()]
    if not occurrences:
        return None
    step, reason = min(occurrences, key=lambda item: item[0])
    clause = next((text for known_reason, text in clauses.items() if known_reason == reason), f"was given up: {reason}")
    return Failed(step, float(trajectory.t[step]), reason, clause)


def state_is_finite(trajectory: Trajectory) -> NDArray[np.bool_]:
    """(n,) whether pose, velocities, steering, command and reference are all finite at each instant."""
    names = ("X", "Y", "psi", "vx", "vy", "yaw_rate", "steering", "command", "y_ref")
    return np.isfinite(np.stack([getattr(trajectory, name) for name in names])).all(axis=0)
