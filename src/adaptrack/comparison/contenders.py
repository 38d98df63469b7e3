"""Contenders: a schedule, a tuning, a tuning for each run, or a controller, to be compared on the same runs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Controller, Tuning
from adaptrack.control.scheduling import Number, Schedule
from adaptrack.tuning.runs import Policy, Retuned

Array = NDArray[np.float64]


@checked
@dataclass(frozen=True, eq=False)
class Contender:
    """A name, and what drives under it.

    Raises
    ------
    InvalidInput
        When the name is empty, or the policy is none.
    """

    name: str
    policy: Policy
    """a schedule, a tuning, tunings (runs, 4), or a controller (`step`, `reset`, `period`, `name`)"""
    hindsight: bool = False
    """whether it was chosen knowing the runs"""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InvalidInput(f"Contender: name = {self.name!r}: must be text.")
        if not isinstance(self.policy, Schedule | Tuning | Retuned | Controller):
            _check_tunings(self.name, self.policy)

    @property
    def controller(self) -> str:
        """The name of the controller: "mpc" where the policy only tunes that of the runs."""
        return str(getattr(self.policy, "name", "mpc")) if isinstance(self.policy, Controller) else "mpc"

    @property
    def adapts(self) -> bool:
        """Whether its tuning changes from run to run or while driving, and not by hindsight."""
        if self.hindsight or isinstance(self.policy, Tuning | Retuned):
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
