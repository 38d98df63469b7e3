"""Controllers by name: whoever is registered drives everywhere. A name costs nothing until it is used."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.registry import Registry
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers.base import Controller
from adaptrack.scenario.profile import Profile

Factory = Callable[..., Controller]
SLOW_STEP = 4e-3
"""s, of a control step in Python, roughly."""


@dataclass(frozen=True)
class About:
    """Description of a registered controller, available before one is made."""

    words: str = ""
    """Description for readers."""
    tunable: bool = True
    """whether its tuning is sought, as far as its `Controller.tuning_bounds` say where"""
    compiled: bool = True
    """whether the kernels run it; one that needs Python at every step is some hundred times slower"""
    step_time: float = 2e-5
    """s, of a control step with its plant in a batch, roughly: for estimates of time"""
    ours: bool = False


_SHIPPED: dict[str, tuple[str, About]] = {
    "informed": ("mpc:MPC", About("informed MPC, with steering model", ours=True)),
    "informed-learning": ("presets:learning", About("informed MPC, learning while it drives", ours=True)),
    "informed-from-sheet": (
        "presets:learning_from_sheet",
        About("informed MPC from mass and wheelbase, learning while it drives", ours=True),
    ),
    "as-written": ("presets:published_mpc", About("MPC of the paper, as written")),
    "as-released": ("presets:released_mpc", About("MPC of the paper, as its authors released it")),
    "nn": ("presets:nn", About("MPC of the paper, scheduled by networks", tunable=False)),
    "anfis": ("presets:anfis", About("MPC of the paper, scheduled by ANFIS", tunable=False)),
    "published": ("presets:published", About("MPC of the paper, with its best constant on drives", tunable=False)),
    "published-nn": ("presets:published_nn", About("published MPC, scheduled by networks", tunable=False)),
    "pure-pursuit": ("laws:PurePursuit", About("pure pursuit")),
    "stanley": ("laws:Stanley", About("Stanley, with dead time")),
    "lqr": ("laws:LQR", About("LQR with curvature feed-forward")),
    "preview-lqr": ("preview_lqr:PreviewLQR", About("LQR with optimal preview of the curvature")),
    "kinematic-mpc": (
        "kinematic_mpc:KinematicMPC",
        About("kinematic MPC with lag and dead time, Autoware's formulation"),
    ),
}
"""By name: the factory, "module:name" in `control.controllers`, and its description."""
_descriptions: dict[str, About] = {name: description for name, (_, description) in _SHIPPED.items()}
_registry: Registry[Controller] = Registry(
    "controller", "register_controller", {name: f"{__package__}.{place}" for name, (place, _) in _SHIPPED.items()},
    ("vehicle",), Controller,
)  # fmt: skip


@checked
def register_controller(name: str, factory: Factory | str, *, words: str = "", compiled: bool = False) -> None:
    """Give a controller a name for everything that takes one: `drive`, `tune`, `compare`.

    factory: a callable, or ``"package.module:name"``, imported on first use: ``factory(vehicle)`` makes the controller.
    Where it has arguments called ``profile``, ``period`` (s) or ``preview``, it is given those of the runs at hand.
    words: what it is, for tables; compiled: whether it is a `UserController`, which the kernels run.
    `check_controller` tells whether what it makes keeps the contract.

    Raises
    ------
    InvalidInput
        For a name that is taken or empty, or a factory that takes no vehicle.
    """
    _registry.add(name, factory)
    _descriptions[name] = About(words) if compiled else About(words, compiled=False, step_time=SLOW_STEP)


@checked
def get_controller(
    name: str,
    vehicle: Vehicle | str,
    *,
    profile: str | Profile | None = None,
    optional: Mapping[str, Any] | None = None,
    **options: Any,
) -> Controller:
    """A new controller for a vehicle (or its name or file); ``options`` go to its factory.

    profile: what the controller runs on; goes to a factory that has an argument of this name; optional: likewise, what
    else it may take, by name; None is not passed on.

    Raises
    ------
    UnknownName
        When no controller has this name; the message holds the nearest that is known.
    ContractError
        When its factory returns no controller.
    """
    factory = _registry.factory(name)
    parameters = inspect.signature(factory).parameters
    if profile is not None and "profile" in parameters:
        options["profile"] = profile
    anything = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    values = {key: value for key, value in (optional or {}).items() if value is not None}
    arguments = {key: value for key, value in values.items() if key in parameters or anything}
    car = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
    return _registry.make(name, car, **arguments, **options)


def about_controller(name: str) -> About:
    """Return the description of a registered controller.

    Raises UnknownName, with the most similar registered name, when no controller has this name.
    """
    _registry.check_name(name)
    return _descriptions[name]


list_controllers = _registry.names
