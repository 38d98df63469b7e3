"""Search spaces of tunings: bounds of an MPC's tuning, and the box around a controller's default tuning."""

from __future__ import annotations

import math
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, model_validator

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import Record
from adaptrack.control.controllers import MPC, Controller, Tuning, TuningBounds
from adaptrack.tuning.pso import SearchSpace


def as_tuples(value: Any) -> Any:
    """Nested lists as tuples, as immutable records hold them."""
    return tuple(as_tuples(entry) for entry in value) if isinstance(value, list | tuple) else value


Pair = Annotated[tuple[float, float], BeforeValidator(as_tuples)]


class SearchBounds(Record):
    """Bounds of the tunings; the defaults are those of the authors' programs. Horizons are whole, and Nc <= Np."""

    Np: Annotated[tuple[int, int], BeforeValidator(as_tuples)] = Field(default=(1, 55), description="control periods")
    Nc: Annotated[tuple[int, int], BeforeValidator(as_tuples)] = Field(default=(1, 18), description="control periods")
    Q: Pair = Field(default=(0.1, 10.0), description="1/m^2")
    R: Pair = Field(default=(0.001, 0.1), description="1/rad^2")
    decades: bool = Field(default=False, description="search Q and R by decades; wide bounds ask for it")

    @model_validator(mode="after")
    def _holds_a_tuning(self) -> Self:
        for name in ("Np", "Nc", "Q", "R"):
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] is empty: need low <= high.")
            if not (low >= 1 if name in ("Np", "Nc") else low > 0):
                raise ValueError(f"{name} = [{low:g}, {high:g}]: must be {'>= 1' if name in ('Np', 'Nc') else '> 0'}.")
        if self.Nc[0] > self.Np[0]:
            raise ValueError(
                f"Nc from {self.Nc[0]} and Np from {self.Np[0]}: Nc <= Np cannot hold at the lower bounds; "
                "raise that of Np or lower that of Nc."
            )
        if self.Np[1] > 500 or self.Nc[1] > 100:
            raise ValueError(f"Np up to {self.Np[1]}, Nc up to {self.Nc[1]}: must not exceed 500 and 100.")
        return self

    @classmethod
    def around(cls, constant: Tuning) -> Self:
        """Six decades of R/Q around a constant tuning, and its horizons; Q is 1: only R/Q changes the control law."""
        ratio, Np, Nc = constant.R / constant.Q, max(60, constant.Np), max(18, constant.Nc)
        return cls(Np=(5, Np), Nc=(1, Nc), Q=(1.0, 1.0), R=(1e-3 * ratio, 1e3 * ratio), decades=True)

    def space(self) -> SearchSpace:
        """Return the search space for the swarm, whose first draw has Np >= 2 Nc as in the authors' programs."""
        bounds = [tuple(float(end) for end in pair) for pair in (self.Np, self.Nc, self.Q, self.R)]
        return SearchSpace(
            names=("Np", "Nc", "Q", "R"),
            low=tuple(low for low, _ in bounds),
            high=tuple(high for _, high in bounds),
            integers=("Np", "Nc"),
            decades=("Q", "R") if self.decades else (),
            ordered=("Nc", "Np"),
            spread=2.0,
        )


PUBLISHED_BOUNDS = SearchBounds(Np=(5, 60), Nc=(1, 18), Q=(1.0, 1.0), R=(1e-3, 1e7), decades=True)
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
    is_complete = bool(bounds) and set(bounds) == set(controller.tuning_names)
    return controller.scheduler is None and (is_complete or isinstance(controller, MPC))


def search_space(controller: Controller) -> SearchSpace:
    """The space in which `tune_constant` seeks the tuning of a controller; relative bounds are searched by decades.

    The space of an MPC is `SearchBounds.around` its tuning: Np 5-60, Nc 1-18, Q = 1, R/Q three decades to either side.
    The space of the paper's controller is `PUBLISHED_BOUNDS`, of any other controller its `tuning_bounds`. On roads
    with preview the best Nc is often 18: up to 36 the cost falls by 0.2 % more.

    Raises
    ------
    InvalidInput
        For a controller that says none: give `tune_constant` a space.
    """
    if isinstance(controller, MPC):
        return (PUBLISHED_BOUNDS if controller.is_published else SearchBounds.around(controller.tuning)).space()
    if not is_tunable(controller):
        raise InvalidInput(
            f"the controller {controller.name!r} has no search space: set `tuning_bounds` on its class, (low, high) "
            "for each name in `tuning`; or, in Python, call tune_constant(..., space=SearchSpace(...))."
        )
    tuning, bounds = controller.tuning, {name: TuningBounds(*pair) for name, pair in controller.tuning_bounds.items()}
    scale = {name: tuning[name] if limits.relative else 1.0 for name, limits in bounds.items()}
    return SearchSpace(
        names=controller.tuning_names,
        low=tuple(bounds[name].low * scale[name] for name in controller.tuning_names),
        high=tuple(bounds[name].high * scale[name] for name in controller.tuning_names),
        decades=tuple(name for name in controller.tuning_names if bounds[name].relative and tuning[name] > 0.0),
    )
