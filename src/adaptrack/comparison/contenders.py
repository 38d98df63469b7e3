"""Contenders: what is compared on the same runs.

A contender is a schedule, a tuning, a tuning for each run, or a controller of its own, compiled or in Python. Every
registered controller is one by its name, made for the runs at hand: it must know its car and its period.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.control.controllers import Controller, Tuning, get_controller, list_controllers
from adaptrack.control.scheduling import Number, Schedule, list_schedulers, load_scheduler
from adaptrack.tuning.runs import Policy, Retuned, RunSet

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


# -- by name ----------------------------------------------------------------------------------------------------------
STANDARD = "standard"
"""The MPC of the runs with the tuning of the paper's table."""


def list_contenders() -> list[str]:
    """The names that `get_contender` knows: every registered controller, and the schedulers that ship."""
    return sorted({STANDARD, *list_controllers(), *list_schedulers()})


def check_contender(name: str) -> None:
    """Refuse a name that `get_contender` would not know.

    Raises
    ------
    UnknownName
        With the nearest names that it knows.
    """
    if not name.endswith(".json") and name not in list_contenders():
        raise UnknownName(
            f"no contender is named {name!r}. {did_you_mean(name, list_contenders())} "
            "A scheduler's file is given by its .json path."
        )


@checked
def get_contender(name: str, runs: RunSet) -> Contender:
    """The contender of this name; a path to a scheduler's .json file is one, too.

    A controller is made for the car, the profile, the period and the preview of the runs; a scheduler tunes their MPC.

    Raises
    ------
    UnknownName
        When nothing has the name.
    StorageError
        When a scheduler's file cannot be read.
    InvalidInput
        When the controller cannot be made for the runs.
    """
    check_contender(name)
    if name == STANDARD:
        return Contender(name, Tuning())
    if name not in list_controllers():
        schedule = load_scheduler(name)
        return Contender(schedule.name, schedule)
    vehicle = getattr(runs.mpc.model, "vehicle", None) or getattr(runs.plant, "vehicle", None)
    if vehicle is None:
        raise InvalidInput(f"contender {name!r}: neither the MPC's model nor the plant of the runs has a vehicle.")
    offered = {"period": runs.mpc.period, "preview": runs.mpc.preview}
    made = get_controller(name, vehicle, profile=runs.profile, offered=offered)
    return Contender(name, made)
