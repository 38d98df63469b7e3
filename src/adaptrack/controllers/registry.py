"""Controllers by name. A name costs nothing until it is asked for."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from typing import Any

from adaptrack.controllers.base import Controller
from adaptrack.profile import Profile
from adaptrack.registry import Registry
from adaptrack.vehicle import Vehicle, load_vehicle

Factory = Callable[..., Controller]

_registry: Registry[Controller] = Registry(
    "controller",
    "register_controller",
    {
        "informed": "adaptrack.controllers.mpc:MPC",
        "as-written": "adaptrack.controllers.published:published_mpc",
        "as-released": "adaptrack.controllers.published:released_mpc",
        "kinematic-mpc": "adaptrack.controllers.kinematic_mpc:KinematicMPC",
        "lqr": "adaptrack.controllers.lqr:LQR",
        "preview-lqr": "adaptrack.controllers.preview_lqr:PreviewLQR",
        "mppi": "adaptrack.controllers.mppi:MPPI",
        "nmpc": "adaptrack.controllers.nmpc:NMPC",
        "nmpc-as-measured": "adaptrack.controllers.nmpc:as_measured",
        "pure-pursuit": "adaptrack.controllers.pure_pursuit:PurePursuit",
        "stanley": "adaptrack.controllers.stanley:Stanley",
    },
)


def register_controller(name: str, factory: Factory | str) -> None:
    """Make ``get_controller(name, vehicle)`` call ``factory(vehicle, **options)``.

    factory: a callable, or ``"package.module:name"``, imported on first use. `check_controller` tells whether what it
    makes keeps the contract.

    Raises
    ------
    InvalidInput
        For a name that is taken or empty, or a factory that is neither.
    """
    _registry.add(name, factory)


def get_controller(
    name: str, vehicle: Vehicle | str, *, profile: str | Profile | None = None, **options: Any
) -> Controller:
    """A new controller for a vehicle (or its name or file); ``options`` go to its factory.

    profile: what the controller runs on; goes to a factory that has an argument of this name.

    Raises
    ------
    UnknownName
        When no controller has this name; the message holds the nearest that is known.
    """
    factory = _registry.factory(name)
    if profile is not None and "profile" in inspect.signature(factory).parameters:
        options["profile"] = profile
    return factory(vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle), **options)


def list_controllers() -> list[str]:
    """The known names, sorted."""
    return _registry.names()
