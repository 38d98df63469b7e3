"""Where the best constant tuning of a controller is sought: a box around its own tuning, by the kind of controller."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import MPC, Bounds, Controller
from adaptrack.tuning.config import Search
from adaptrack.tuning.pso import SearchSpace

PUBLISHED = Search(Np=(5, 60), Nc=(1, 18), Q=(1.0, 1.0), R=(1e-3, 1e7), decades=True)
"""Of the paper's controller, whose best R/Q (m^2/rad^2) depends on the car: its table has 0.001, a car with lag, noise
and delay wants thousands, on a fast road more than 1e5."""


def at_bounds(space: SearchSpace, tuning: ArrayLike) -> list[str]:
    """The entries of a tuning (entries,) that lie at an end of a space: a better one may lie beyond."""
    rows = zip(space.names, np.asarray(tuning, dtype=float).tolist(), space.low, space.high, strict=True)
    return [
        name for name, value, low, high in rows if low < high and (_near(value, low) or _near(value, high))
    ]  # fmt: skip


def _near(value: float, end: float) -> bool:
    return math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9)


def is_tunable(controller: Controller) -> bool:
    """Whether there is a space in which its constant is sought: it has no scheduler, and says where."""
    bounds = controller.tuning_bounds
    named = bool(bounds) and set(bounds) == set(controller.tuning_names)
    return controller.scheduler is None and (named or isinstance(controller, MPC))


def search_space(controller: Controller) -> SearchSpace:
    """The space in which `tune_constant` seeks the tuning of a controller; relative bounds are searched by decades.

    An MPC's is `Search.around` its own tuning: Np 5-60, Nc 1-18, Q = 1, R/Q three decades to either side; the paper's
    controller has `PUBLISHED`. On roads with preview the best Nc is often 18: up to 36 the cost falls by 0.2 % more. Of
    any other controller it is what its `tuning_bounds` say.

    Raises
    ------
    InvalidInput
        For a controller that says none: give `tune_constant` a space.
    """
    if isinstance(controller, MPC):
        return (PUBLISHED if controller.is_published else Search.around(controller.tuning)).space()
    if not is_tunable(controller):
        raise InvalidInput(
            f"the controller {controller.name!r} has no search space: set `tuning_bounds` on its class, (low, high) "
            "for each name in `tuning`; or, in Python, call tune_constant(..., space=SearchSpace(...))."
        )
    own, bounds = controller.tuning, {name: Bounds(*each) for name, each in controller.tuning_bounds.items()}
    scale = {name: own[name] if each.relative else 1.0 for name, each in bounds.items()}
    return SearchSpace(
        names=controller.tuning_names,
        low=tuple(bounds[name].low * scale[name] for name in controller.tuning_names),
        high=tuple(bounds[name].high * scale[name] for name in controller.tuning_names),
        decades=tuple(name for name in controller.tuning_names if bounds[name].relative and own[name] > 0.0),
    )
