"""Controllers by name. A name costs nothing until it is asked for."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from adaptrack.controllers.base import Controller
from adaptrack.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.vehicle import Vehicle, load_vehicle

Factory = Callable[..., Controller]

_factories: dict[str, Factory | str] = {
    "mpc": "adaptrack.controllers.mpc:MPC",
    "informed": "adaptrack.controllers.informed:informed_mpc",
    "lqr": "adaptrack.controllers.lqr:LQR",
    "pure-pursuit": "adaptrack.controllers.pure_pursuit:PurePursuit",
    "stanley": "adaptrack.controllers.stanley:Stanley",
}


def register_controller(name: str, factory: Factory | str) -> None:
    """Make ``get_controller(name, vehicle)`` call ``factory(vehicle, **options)``.

    factory: a callable, or ``"package.module:name"``, imported on first use. `check_controller` tells whether what it
    makes keeps the contract.

    Raises
    ------
    InvalidInput
        For a name that is taken or empty, or a factory that is neither.
    """
    if not name or not isinstance(name, str):
        raise InvalidInput(f"A controller needs a name, not {name!r}.")
    if name in _factories:
        raise InvalidInput(f"There is a controller {name!r} already: choose another name.")
    if not callable(factory) and not (isinstance(factory, str) and factory.count(":") == 1):
        raise InvalidInput(f"The factory of {name!r} must be callable or 'package.module:name', not {factory!r}.")
    _factories[name] = factory


def get_controller(name: str, vehicle: Vehicle | str, **options: Any) -> Controller:
    """A new controller for a vehicle (or its name or file); ``options`` go to its factory.

    Raises
    ------
    UnknownName
        When no controller has this name; the message holds the nearest that is known.
    """
    try:
        factory = _factories[name]
    except (KeyError, TypeError):
        raise UnknownName(f"There is no controller {name!r}. {did_you_mean(str(name), _factories)}") from None
    if isinstance(factory, str):
        module, attribute = factory.split(":")
        factory = getattr(importlib.import_module(module), attribute)
    assert callable(factory)
    return factory(vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle), **options)


def list_controllers() -> list[str]:
    """The known names, sorted."""
    return sorted(_factories)
