"""Search spaces of tunings, for an MPC and for other controllers with `tuning_bounds`."""

from __future__ import annotations

import math
from typing import Annotated, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record
from adaptrack.control.controllers import ENTRIES, Controller, Tuning, TuningBounds
from adaptrack.control.controllers.tuning import HORIZONS
from adaptrack.tuning.pso import SearchSpace

Pair = Annotated[tuple[float, float], LISTED]


class SearchBounds(Record):
    """Bounds of the tuning of an MPC: whole Np and Nc with Nc <= Np, Q and R.

    The defaults are the bounds in the programs of the paper's authors.
    """

    Np: Annotated[tuple[int, int], LISTED] = Field(default=(1, 55), description="control periods")
    Nc: Annotated[tuple[int, int], LISTED] = Field(default=(1, 18), description="control periods")
    Q: Pair = Field(default=(0.1, 10.0), description="1/m^2")
    R: Pair = Field(default=(0.001, 0.1), description="1/rad^2")
    decades: bool = Field(default=False, description="whether log10 Q and log10 R are searched")

    @model_validator(mode="after")
    def _holds_a_tuning(self) -> Self:
        for name in ENTRIES:
            low, high = getattr(self, name)
            if not low <= high:
                raise ValueError(f"{name} = [{low:g}, {high:g}] is empty: need low <= high.")
            if not (low >= 1 if name in HORIZONS else low > 0):
                raise ValueError(f"{name} = [{low:g}, {high:g}]: must be {'>= 1' if name in HORIZONS else '> 0'}.")
        if self.Nc[0] > self.Np[0]:
            raise ValueError(
                f"Nc from {self.Nc[0]} and Np from {self.Np[0]}: the lower bounds violate Nc <= Np; "
                "raise the lower bound of Np, or reduce that of Nc."
            )
        if self.Np[1] > 500 or self.Nc[1] > 100:
            raise ValueError(f"Np up to {self.Np[1]}, Nc up to {self.Nc[1]}: must not exceed 500 and 100.")
        return self

    @classmethod
    def around(cls, constant: Tuning) -> Self:
        """Return the bounds of a search around a constant tuning: three decades of R/Q to either side.

        Np goes up to 60 and Nc up to 18, or to those of the tuning if they are larger. Q is 1, since only the ratio R/Q
        changes the control law.
        """
        ratio = constant.R / constant.Q
        return cls.up_to(max(60, constant.Np), max(18, constant.Nc), (1e-3 * ratio, 1e3 * ratio))

    @classmethod
    def up_to(cls, longest: int, most_moves: int, ratio: tuple[float, float]) -> Self:
        """Return the bounds of horizons up to these numbers of control periods, and of R, in decades, for Q = 1."""
        return cls(**dict(zip(ENTRIES, ((5, longest), (1, most_moves), (1.0, 1.0), ratio), strict=True)), decades=True)

    def space(self) -> SearchSpace:
        """Return the search space for a swarm. Its initial positions have Np >= 2 Nc, as in the authors' programs."""
        bounds = [tuple(float(end) for end in pair) for pair in (getattr(self, name) for name in ENTRIES)]
        return SearchSpace(
            names=ENTRIES,
            low=tuple(low for low, _ in bounds),
            high=tuple(high for _, high in bounds),
            integers=HORIZONS,
            decades=("Q", "R") if self.decades else (),
            ordered=("Nc", "Np"),
            spread=2.0,
        )


PUBLISHED_BOUNDS = SearchBounds.up_to(60, 18, (1e-3, 1e7))
"""Bounds for the controller of the paper.

Its best R/Q (m^2/rad^2) depends on car and road: 0.001 in the paper's table, thousands for a car with steering lag,
noise and delay, and more than 1e5 on a fast road.
"""


def at_bounds(space: SearchSpace, tuning: ArrayLike) -> list[str]:
    """Return the names of the entries of a tuning (entries,) that lie at a bound of a space."""
    rows = zip(space.names, np.asarray(tuning, dtype=float).tolist(), space.low, space.high, strict=True)
    return [
        name for name, value, low, high in rows if low < high and (_near(value, low) or _near(value, high))
    ]  # fmt: skip


def _near(value: float, end: float) -> bool:
    return math.isclose(value, end, rel_tol=1e-6, abs_tol=1e-9)


def is_tunable(controller: Controller) -> bool:
    """Whether a controller has a search space: it has no scheduler, and is an MPC or has `tuning_bounds`."""
    bounds = controller.tuning_bounds
    is_complete = bool(bounds) and set(bounds) == set(controller.tuning_names)
    return controller.scheduler is None and (is_complete or controller.has_horizons)


def search_space(controller: Controller) -> SearchSpace:
    """Return the default search space of a controller's tuning.

    - For the controller of the paper it is `PUBLISHED_BOUNDS`.
    - For any other MPC it is `SearchBounds.around` its tuning. On roads with preview the best Nc is often at the bound
      of 18; with a bound of 36 the cost falls by 0.2 %.
    - For other controllers it is given by their `tuning_bounds`. Entries with relative bounds are searched in log10.

    Raises
    ------
    InvalidInput
        For a controller without `tuning_bounds`; pass a space to `tune_constant` instead.
    """
    if controller.has_horizons:
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
