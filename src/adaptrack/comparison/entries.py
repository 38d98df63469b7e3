"""Entries of a side-by-side: controllers by name, each made for any car and profile by the same rules.

All know the road ahead and the period. Those that know the car are told its file, and of the steering what the profile
says, which is the truth; they are told the noise of the sensors, not what it draws.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from adaptrack.controllers import MPC, Controller, get_controller, published_mpc
from adaptrack.controllers.belief import UNKNOWN
from adaptrack.controllers.learned import Learning
from adaptrack.data_sheet import vehicle_from_data_sheet
from adaptrack.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.plant import Plant, SteppedPlant
from adaptrack.profile import Profile
from adaptrack.scheduling import load_scheduler
from adaptrack.vehicle import Vehicle


@dataclass(frozen=True, eq=False)
class Setting:
    """What a controller is made for."""

    car: Vehicle
    plant: Plant | SteppedPlant
    profile: Profile


@dataclass(frozen=True)
class Entry:
    """A controller of a side-by-side."""

    name: str
    make: Callable[[Setting], Controller]
    """raises InvalidInput where it was made for another car or profile, with the reason"""
    words: str
    """what it is, for readers"""
    tunable: bool = True
    """whether its tuning is sought; a schedule brings its own"""
    compiled: bool = True
    """whether the kernels run it; in Python it is some hundred times slower"""
    step_time: float = 2e-5
    """s, of a control step with its plant in a batch, roughly: for estimates of time"""
    ours: bool = False


def _registered(name: str) -> Callable[[Setting], Controller]:
    def make(setting: Setting) -> Controller:
        profile = setting.profile
        return get_controller(name, setting.car, profile=profile, period=profile.period, preview=True)

    return make


def _learning(setting: Setting, sheet: bool) -> Controller:
    """Ours, learning; sheet: all that is known are mass and wheelbase of the car, and the sensors."""
    profile = setting.profile
    how: dict[str, Any] = {"profile": profile, "learning": Learning(), "period": profile.period, "preview": True}
    if not sheet:
        return MPC(setting.car, **how)
    car = vehicle_from_data_sheet(setting.car.name, setting.car.mass, setting.car.wheelbase)
    return MPC(car, belief=UNKNOWN, **how)


def _scheduled(scheduler: str, published: bool, setting: Setting) -> Controller:
    """A scheduler that ships with the package; refused where it was made for something else."""
    schedule, profile = load_scheduler(scheduler), setting.profile
    how: dict[str, Any] = {"period": profile.period, "preview": True}
    make: Any = published_mpc if published else partial(MPC, profile=profile)
    faults = make(setting.car, **how).mismatches(schedule, profile.name)
    if faults:
        raise InvalidInput(f"scheduler {scheduler!r} {'; it '.join(faults)}")
    return make(setting.car, scheduler=schedule, **how)


def _law(name: str, words: str) -> Entry:
    return Entry(name, _registered(name), words)


def _in_python(name: str, words: str) -> Entry:
    return Entry(name, _registered(name), words, tunable=False, compiled=False, step_time=4e-3)


_ENTRIES: dict[str, Entry] = {
    each.name: each
    for each in (
        Entry("informed", _registered("informed"), "MPC that knows its car", ours=True),
        Entry("informed-learning", partial(_learning, sheet=False), "the same, learning while it drives", ours=True),
        Entry(
            "informed-from-sheet", partial(_learning, sheet=True),
            "the same, told nothing but mass and wheelbase, learning while it drives", ours=True,
        ),
        Entry(
            "informed-nn", partial(_scheduled, "informed-road-nn", False), "the same, scheduled by networks",
            tunable=False, ours=True,
        ),
        Entry("as-written", _registered("as-written"), "MPC of the paper, as written"),
        Entry("as-released", _registered("as-released"), "MPC of the paper, as its authors released it"),
        Entry("nn", partial(_scheduled, "road-nn", True), "MPC of the paper, scheduled by networks", tunable=False),
        Entry("anfis", partial(_scheduled, "road-anfis", True), "MPC of the paper, scheduled by ANFIS", tunable=False),
        _law("pure-pursuit", "pure pursuit"),
        _law("stanley", "Stanley, with dead time"),
        _law("lqr", "LQR with curvature feed-forward"),
        _law("preview-lqr", "LQR with optimal preview of the curvature"),
        _law("kinematic-mpc", "kinematic MPC with lag and dead time, Autoware's formulation"),
        Entry("mppi", _registered("mppi"), "MPPI on the tyre's curve", step_time=7e-4),
        _in_python("nmpc", "NMPC on the tyre's curve, with our estimator"),
        _in_python("nmpc-as-measured", "the same without an estimator"),
    )
}  # fmt: skip


def register_entry(entry: Entry) -> None:
    """Give a side-by-side another controller.

    Raises
    ------
    InvalidInput
        When the name is taken.
    """
    if entry.name in _ENTRIES:
        raise InvalidInput(f"register_entry: {entry.name!r} is taken; choose another name.")
    _ENTRIES[entry.name] = entry


def list_entries() -> list[str]:
    """The names that `get_entry` knows."""
    return list(_ENTRIES)


def get_entry(name: str) -> Entry:
    """The entry of this name.

    Raises
    ------
    UnknownName
        When nothing has the name.
    """
    if name not in _ENTRIES:
        raise UnknownName(f"no contender is named {name!r}. {did_you_mean(name, _ENTRIES)}")
    return _ENTRIES[name]
