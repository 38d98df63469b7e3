"""Where the best constant tuning of a controller is sought: a box around its own tuning, by the kind of controller."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.controllers import (
    LQR,
    MPC,
    MPPI,
    CompiledController,
    Controller,
    KinematicMPC,
    PreviewLQR,
    PurePursuit,
    Stanley,
)
from adaptrack.errors import InvalidInput
from adaptrack.tuning.config import Search
from adaptrack.tuning.pso import SearchSpace

PUBLISHED = Search(Np=(5, 60), Nc=(1, 18), Q=(1.0, 1.0), R=(1e-3, 1e7), decades=True)
"""Of the paper's controller, whose best R/Q (m^2/rad^2) depends on the car: its table has 0.001, a car with lag, noise
and delay wants thousands, on a fast road more than 1e5."""


class Bounds(NamedTuple):
    """Of a tuning entry."""

    low: float
    high: float
    relative: bool = False
    """low and high are factors on the controller's own value; else they are values"""


FIXED = Bounds(1.0, 1.0, relative=True)
DECADES = Bounds(0.01, 100.0, relative=True)
LAWS: dict[type[CompiledController], dict[str, Bounds]] = {
    KinematicMPC: {
        **dict.fromkeys(("lateral_error", "heading_error", "steering_rate", "steering_acceleration"), FIXED),
        **dict.fromkeys(("heading_error_v2", "steering", "steering_v2", "lateral_jerk"), DECADES),
        **dict.fromkeys(("terminal_lateral_error", "terminal_heading_error", "cutoff"), FIXED),
    },
    LQR: {
        "q_e": DECADES,
        "q_heading": DECADES,
        "r": FIXED,
        "preview_time": Bounds(0.0, 0.6),
    },
    PreviewLQR: {"q_e": DECADES, "q_heading": DECADES, "r": FIXED},
    MPPI: {
        "temperature": Bounds(0.01, 100.0, relative=True),
        "spread": Bounds(0.1, 10.0, relative=True),
        "q_e": Bounds(1.0, 1.0, relative=True),
        "q_course": Bounds(0.01, 100.0, relative=True),
        "r": Bounds(0.01, 100.0, relative=True),
    },
    PurePursuit: {"lookahead_time": Bounds(0.1, 1.5), "lookahead_min": Bounds(1.0, 10.0)},
    Stanley: {
        "gain": Bounds(0.1, 10.0, relative=True),
        "softening": Bounds(0.1, 10.0, relative=True),
        "yaw_rate_gain": Bounds(0.0, 0.3),
        "dead_time": Bounds(0.0, 0.6),
    },
}
"""By law, its tuning entries. Of an LQR only the ratios to r count, and its gains are tabulated over two decades to
either side of its own; of the kinematic MPC those to the weight of the lateral error, of MPPI those to q_e."""


def at_bounds(space: SearchSpace, tuning: ArrayLike) -> list[str]:
    """The entries of a tuning (entries,) that lie at an end of a space: a better one may lie beyond."""
    rows = zip(space.names, np.asarray(tuning, dtype=float).tolist(), space.low, space.high, strict=True)
    return [
        name for name, value, low, high in rows if low < high and (_near(value, low) or _near(value, high))
    ]  # fmt: skip


def _near(value: float, end: float) -> bool:
    return math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9)


def search_space(controller: Controller) -> SearchSpace:
    """The space in which `tune_constant` seeks the tuning of a controller; relative bounds are searched by decades.

    An MPC's is `Search.around` its own tuning: Np 5-60, Nc 1-18, Q = 1, R/Q three decades to either side; the paper's
    controller has `PUBLISHED`. On roads with preview the best Nc is often 18: up to 36 the cost falls by 0.2 % more.

    Raises
    ------
    InvalidInput
        For a controller of another kind: give `tune_constant` a space.
    """
    if isinstance(controller, MPC):
        return (PUBLISHED if controller.is_published else Search.around(controller.tuning)).space()
    if type(controller) not in LAWS:
        raise InvalidInput(
            f"no search space is known for the controller {getattr(controller, 'name', controller)!r}: "
            "tune_constant(..., space=SearchSpace(...)) takes one."
        )
    assert isinstance(controller, CompiledController)
    own, bounds = controller.tuning, LAWS[type(controller)]
    scale = {name: own[name] if each.relative else 1.0 for name, each in bounds.items()}
    return SearchSpace(
        names=controller.tuning_names,
        low=tuple(bounds[name].low * scale[name] for name in controller.tuning_names),
        high=tuple(bounds[name].high * scale[name] for name in controller.tuning_names),
        decades=tuple(name for name in controller.tuning_names if bounds[name].relative and own[name] > 0.0),
    )
