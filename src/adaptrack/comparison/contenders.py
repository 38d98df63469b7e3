"""Contenders of a comparison: schedules, tunings or controllers with a name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Controller, Tuning
from adaptrack.control.scheduling import Number, Schedule
from adaptrack.tuning.runs import ControllerTunings, Policy

Array = NDArray[np.float64]


@checked
@dataclass(frozen=True, eq=False)
class Contender:
    """A policy with the name under which it is compared.

    Raises
    ------
    InvalidInput
        For an empty name or an invalid policy.
    """

    name: str
    policy: Policy
    """Schedule, tuning, tunings (runs, 4), or controller with `step`, `reset`, `period` and `name`."""
    hindsight: bool = False
    """Whether the policy was optimised for the very runs of the comparison."""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InvalidInput(f"Contender: name = {self.name!r}: must be text.")
        if not isinstance(self.policy, Schedule | Tuning | ControllerTunings | Controller):
            _check_tunings(self.name, self.policy)

    @property
    def controller(self) -> str:
        """The name of the controller; "mpc" if the policy is a schedule or tuning for the MPC of the runs."""
        return str(getattr(self.policy, "name", "mpc")) if isinstance(self.policy, Controller) else "mpc"

    @property
    def adapts(self) -> bool:
        """Whether the tuning changes between or during runs, without `hindsight`."""
        if self.hindsight or isinstance(self.policy, Tuning | ControllerTunings):
            return False
        if isinstance(self.policy, Schedule):
            return not _is_constant(self.policy)
        if isinstance(self.policy, Controller):
            return getattr(self.policy, "scheduler", None) is not None
        return np.ndim(self.policy) == 2 and len(np.asarray(self.policy)) > 1


def _is_constant(schedule: Schedule) -> bool:
    return all(isinstance(entry.function, Number) for entry in schedule.tuning.values())


def _check_tunings(name: str, policy: ArrayLike) -> None:
    try:
        rows = np.atleast_2d(np.asarray(policy, dtype=float))
    except (TypeError, ValueError):
        rows = np.empty((0, 0))
    if rows.ndim != 2 or rows.shape[1] != 4 or not np.isfinite(rows).all():
        raise InvalidInput(
            f"contender {name!r}: {policy!r}: must be a schedule, a tuning, finite rows of Np, Nc, Q, R, or a "
            "controller with a method `step`."
        )
