"""Contenders: what is compared on the same runs, and the registry of those that have a name.

A contender is a schedule, a tuning, a tuning for each run, or a controller of its own, compiled or in Python. A
registered one is made for the runs at hand, since a controller must know its car and its period.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.controllers import Controller, Tuning, get_controller
from adaptrack.errors import ContractError, InvalidInput, UnknownName, did_you_mean
from adaptrack.runs import Policy, RunSet
from adaptrack.scheduling import Number, Schedule, list_schedulers, load_scheduler

Array = NDArray[np.float64]


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
        if not isinstance(self.policy, Schedule | Tuning) and not hasattr(self.policy, "step"):
            _check_tunings(self.name, self.policy)

    @property
    def controller(self) -> str:
        """The name of the controller: "mpc" where the policy only tunes that of the runs."""
        return str(getattr(self.policy, "name", "mpc")) if hasattr(self.policy, "step") else "mpc"

    @property
    def adapts(self) -> bool:
        """Whether its tuning changes from run to run or while driving, and not by hindsight."""
        if self.hindsight or isinstance(self.policy, Tuning):
            return False
        if isinstance(self.policy, Schedule):
            return any(not isinstance(entry.function, Number) for entry in self.policy.tuning.values())
        if hasattr(self.policy, "step"):
            return getattr(self.policy, "scheduler", None) is not None
        return np.ndim(self.policy) == 2 and len(np.asarray(self.policy)) > 1


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


# -- the registry -----------------------------------------------------------------------------------------------------
Maker = Callable[[RunSet], Policy]
"""Makes a policy for the runs at hand, from their plant, MPC (vehicle, period) and profile."""


def _by_name(name: str) -> Maker:
    """Makes a registered controller with its default tuning, for the car, period and preview of the runs' MPC."""

    def make(runs: RunSet) -> Controller:
        vehicle = getattr(runs.mpc.model, "vehicle", None) or getattr(runs.plant, "vehicle", None)
        if vehicle is None:
            raise InvalidInput(f"contender {name!r}: neither the MPC's model nor the plant of the runs has a vehicle.")
        return get_controller(name, vehicle, profile=runs.profile, period=runs.mpc.period, preview=runs.mpc.preview)

    return make


_MAKERS: dict[str, Maker] = {
    "standard": lambda runs: Tuning(),
    **{name: _by_name(name) for name in ("informed", "lqr", "pure-pursuit", "stanley")},
}


def register_contender(name: str, make: Maker) -> None:
    """Give a contender a name for `get_contender` and `evaluate`; make: makes its policy for the runs at hand.

    Raises
    ------
    ContractError
        When the name is no text or taken, or `make` cannot be called.
    """
    if not isinstance(name, str) or not name:
        raise ContractError(f"register_contender: name = {name!r}: must be text.")
    if name in list_contenders():
        raise ContractError(f"register_contender: {name!r} is taken; choose another name.")
    if not callable(make):
        raise ContractError(f"register_contender: {name!r}: make = {make!r}: must be callable, run set -> policy.")
    _MAKERS[name] = make


def list_contenders() -> list[str]:
    """The names that `get_contender` knows: registered contenders, and the schedulers that ship with the package."""
    return sorted({*_MAKERS, *list_schedulers()})


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


def get_contender(name: str, runs: RunSet) -> Contender:
    """The contender of this name, made for the runs at hand; a path to a scheduler's .json file is one, too.

    Raises
    ------
    UnknownName
        When nothing has the name.
    StorageError
        When a scheduler's file cannot be read.
    InvalidInput
        When what was made is no policy.
    """
    check_contender(name)
    if name in _MAKERS:
        return Contender(name, _MAKERS[name](runs))
    schedule = load_scheduler(name)
    return Contender(schedule.name, schedule)


# -- of an adaptation -------------------------------------------------------------------------------------------------
ONCE = ("look-up", "paper recipe nn", "paper recipe anfis")
"""Learned from operating points: on such they are asked once, for the operating point itself."""


def contenders_of(
    schedules: Mapping[str, Any], points: Array | None = None, more: Sequence[Contender] = ()
) -> dict[str, Contender]:
    """The schedules of an adaptation as they are driven, beside the standard tuning and `more`.

    There are two best constants, one for operating points and one for drives: on drives the latter is "best constant",
    and the former is driven too.
    """
    policies: dict[str, Policy] = {"standard": Tuning(), **schedules}
    policies.pop("fallback", None)
    on_drives = policies.pop("best constant on drives", None)
    if points is not None:
        policies.update({name: schedules[name].batch(points) for name in ONCE if name in schedules})
    elif on_drives is not None:
        of_points = policies.pop("best constant", None)
        if of_points is not None:
            policies["best constant of operating points"] = of_points
        policies["best constant"] = on_drives
    made = {name: Contender(name, policy) for name, policy in policies.items()}
    return made | {each.name: each for each in more}
