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

from adaptrack.controllers import Controller, Tuning, get_controller, published_mpc
from adaptrack.errors import ContractError, InvalidInput, UnknownName, did_you_mean
from adaptrack.runs import Policy, Retuned, RunSet
from adaptrack.scheduling import Number, Schedule, list_schedulers, load_scheduler
from adaptrack.vehicle import Vehicle

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
    kind: str = ""
    """what it is among the contenders of an adaptation: "nn", "look-up", "best constant", ...; empty: none of them"""

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name:
            raise InvalidInput(f"Contender: name = {self.name!r}: must be text.")
        if not isinstance(self.policy, Schedule | Tuning | Retuned) and not hasattr(self.policy, "step"):
            _check_tunings(self.name, self.policy)

    @property
    def controller(self) -> str:
        """The name of the controller: "mpc" where the policy only tunes that of the runs."""
        return str(getattr(self.policy, "name", "mpc")) if hasattr(self.policy, "step") else "mpc"

    @property
    def adapts(self) -> bool:
        """Whether its tuning changes from run to run or while driving, and not by hindsight."""
        if self.hindsight or isinstance(self.policy, Tuning | Retuned):
            return False
        if isinstance(self.policy, Schedule):
            return not _is_constant(self.policy)
        if hasattr(self.policy, "step"):
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


# -- the registry -----------------------------------------------------------------------------------------------------
Maker = Callable[[RunSet], Policy]
"""Makes a policy for the runs at hand, from their plant, MPC (vehicle, period) and profile."""


PUBLISHED_CONTENDERS = ("published", "published, road-nn")
"""The paper's controller beside another, with its best constant and with its networks."""


def _vehicle_of(name: str, runs: RunSet) -> Vehicle:
    vehicle = getattr(runs.mpc.model, "vehicle", None) or getattr(runs.plant, "vehicle", None)
    if vehicle is None:
        raise InvalidInput(f"contender {name!r}: neither the MPC's model nor the plant of the runs has a vehicle.")
    return vehicle


def _by_name(name: str) -> Maker:
    """Makes a registered controller with its default tuning, for the car, period and preview of the runs' MPC."""

    def make(runs: RunSet) -> Controller:
        vehicle = _vehicle_of(name, runs)
        return get_controller(name, vehicle, profile=runs.profile, period=runs.mpc.period, preview=runs.mpc.preview)

    return make


def _published(scheduler: str) -> Maker:
    """Makes the paper's controller with a scheduler that ships for it, made for the paper's car in profile `road`."""

    def make(runs: RunSet) -> Controller:
        car, mpc, schedule = _vehicle_of("published", runs), runs.mpc, load_scheduler(scheduler)
        timing: dict[str, Any] = {"period": mpc.period, "preview": mpc.preview}
        if not _is_constant(schedule):
            return published_mpc(car, scheduler=schedule, **timing)
        Np, Nc, Q, R = (entry.low for entry in schedule.tuning.values())
        return published_mpc(car, Tuning(round(Np), round(Nc), Q, R), **timing)

    return make


_MAKERS: dict[str, Maker] = {
    "standard": lambda runs: Tuning(),
    "published": _published("road-best-constant-on-drives"),
    "published, road-nn": _published("road-nn"),
    **{
        name: _by_name(name)
        for name in ("informed", "lqr", "mppi", "nmpc", "nmpc-as-measured", "pure-pursuit", "stanley")
    },
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
        return Contender(name, _MAKERS[name](runs), kind=name)
    schedule = load_scheduler(name)
    return Contender(schedule.name, schedule)


# -- of an adaptation -------------------------------------------------------------------------------------------------
ONCE = ("look-up", "paper recipe nn", "paper recipe anfis")
"""Learned from operating points: on such they are asked once, for the operating point itself."""
CONSTANTS = ("best constant", "best constant on drives", "fallback")
"""Called by what they are; the others are called as their files."""


RESERVED = frozenset(
    {
        *_MAKERS,
        *CONSTANTS, *ONCE, "default constant", "best constant of operating points", "optimum", "per-drive constant",
        "nn", "anfis", "nn unguarded", "anfis unguarded", "speed only", "speed look-up",
    }
)  # fmt: skip
"""Names that stand for what an adaptation makes: a file of one's own is never called so."""


def contenders_of(
    schedules: Mapping[str, Any], points: Array | None = None, more: Sequence[Contender] = (), *,
    own: Tuning | None = None,
) -> dict[str, Contender]:  # fmt: skip
    """The schedules of an adaptation (by kind) as they are driven, by name, beside a constant and `more`.

    own: the constant of a controller that has one of its own; without it the constant is that of the paper's table.
    There are two best constants, one for operating points and one for drives: on drives the latter is "best constant",
    and the former is driven too.
    """
    first: dict[str, Policy] = {"standard": Tuning()} if own is None else {"default constant": own}
    policies: dict[str, Policy] = {**first, **schedules}
    policies.pop("fallback", None)
    on_drives = policies.pop("best constant on drives", None)
    if points is not None:
        policies.update({kind: schedules[kind].batch(points) for kind in ONCE if kind in schedules})
    elif on_drives is not None:
        of_points = policies.pop("best constant", None)
        if of_points is not None:
            policies["best constant of operating points"] = of_points
        policies["best constant"] = on_drives
    known = [
        Contender(shown_as(kind, schedules), policy, kind=kind if kind in RESERVED | set(_MAKERS) else "")
        for kind, policy in policies.items()
    ]
    return {each.name: each for each in (*known, *more)}


def shown_as(kind: str, schedules: Mapping[str, Any]) -> str:
    """How tables call a contender of an adaptation: by its file's name, constants by what they are."""
    named = kind in schedules and kind not in CONSTANTS
    return str(schedules[kind].name) if named else kind
