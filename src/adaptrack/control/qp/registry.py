"""QP solvers by name. A name costs nothing until it is used."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from adaptrack.base.checked import checked
from adaptrack.base.registry import Registry
from adaptrack.control.qp.solver import EXACT, QPSolver

Factory = Callable[..., QPSolver]

_registry: Registry[QPSolver] = Registry(
    "QP solver",
    "register_qp_solver",
    {
        EXACT: "adaptrack.control.qp.active_set:ActiveSet",
        "hildreth": "adaptrack.control.qp.hildreth:Hildreth",
        "daqp": "adaptrack.control.qp.daqp:Daqp",
        "osqp": "adaptrack.control.qp.osqp:Osqp",
        "piqp": "adaptrack.control.qp.piqp:Piqp",
        "clarabel": "adaptrack.control.qp.clarabel:Clarabel",
    },
)

DEFAULT = EXACT


@checked
def register_qp_solver(name: str, factory: Factory | str) -> None:
    """Make ``get_qp_solver(name)`` call ``factory``: a callable, or ``"package.module:name"`` imported on first use.

    Raises `InvalidInput` for a name that is taken. `check_qp_solver` tells whether the solver keeps the contract.
    """
    _registry.add(name, factory)


@checked
def get_qp_solver(name: str = DEFAULT, **options: Any) -> QPSolver:
    """A new solver; ``options`` go to its factory.

    Raises `UnknownName` (with the nearest known one), or `MissingExtra` when its library is not installed.
    """
    return _registry.make(name, **options)


def list_qp_solvers() -> list[str]:
    """The known names, sorted. Some may need an extra to be installed."""
    return _registry.names()
