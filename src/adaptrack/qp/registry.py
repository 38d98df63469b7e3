"""QP solvers by name. A name costs nothing until it is asked for."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

from adaptrack.errors import InvalidInput, MissingExtra, UnknownName, did_you_mean
from adaptrack.qp.solver import QPSolver

Factory = Callable[..., QPSolver]

_factories: dict[str, Factory | str] = {
    "active-set": "adaptrack.qp.active_set:ActiveSet",
    "hildreth": "adaptrack.qp.hildreth:Hildreth",
    "daqp": "adaptrack.qp.daqp:Daqp",
    "osqp": "adaptrack.qp.osqp:Osqp",
    "piqp": "adaptrack.qp.piqp:Piqp",
    "clarabel": "adaptrack.qp.clarabel:Clarabel",
}

DEFAULT = "active-set"


def register_qp_solver(name: str, factory: Factory | str) -> None:
    """Make ``get_qp_solver(name)`` call ``factory``: a callable, or ``"package.module:name"`` imported on first use.

    Raises `InvalidInput` for a name that is taken. `check_qp_solver` tells whether the solver keeps the contract.
    """
    if not name or not isinstance(name, str):
        raise InvalidInput(f"A QP solver needs a name, not {name!r}.")
    if name in _factories:
        raise InvalidInput(f"There is a QP solver {name!r} already: choose another name.")
    if not callable(factory) and not (isinstance(factory, str) and factory.count(":") == 1):
        raise InvalidInput(f"The factory of {name!r} must be callable or 'package.module:name', not {factory!r}.")
    _factories[name] = factory


def get_qp_solver(name: str = DEFAULT, **options: Any) -> QPSolver:
    """A new solver; ``options`` go to its factory.

    Raises `UnknownName` (with the nearest known one), or `MissingExtra` when its library is not installed.
    """
    try:
        factory = _factories[name]
    except (KeyError, TypeError):
        raise UnknownName(f"There is no QP solver {name!r}. {did_you_mean(str(name), _factories)}") from None
    if isinstance(factory, str):
        module, attribute = factory.split(":")
        factory = getattr(importlib.import_module(module), attribute)
    assert callable(factory)
    return factory(**options)


def list_qp_solvers() -> list[str]:
    """The known names, sorted. Some may need an extra to be installed."""
    return sorted(_factories)


def require(package: str, solver: str) -> Any:
    """Import the library behind a back-end, or say how to install it."""
    try:
        return importlib.import_module(package)
    except ImportError as error:
        raise MissingExtra(
            f"The QP solver {solver!r} needs the package {package!r}: pip install 'adaptrack[solvers]'"
        ) from error
