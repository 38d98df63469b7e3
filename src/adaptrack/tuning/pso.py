"""Improved particle swarm of the paper (section III, eqs. (18)-(20)), which minimises any function.

    best = minimise(function, space, seed=1)          # function: positions (n, dims) -> costs (n,)

A caller that computes the costs itself passes them one generation at a time:

    swarm = Swarm(space, settings, seed=1)
    while not swarm.is_done:
        swarm.tell(evaluate(swarm.ask()))

`adaptrack.core.tuning.swarm` contains the algorithm. This module adds validated settings, the spaces of the tunings of
an MPC and of other controllers, and a state that can be saved and restored without any change of the result.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from adaptrack.base.checked import Natural, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record
from adaptrack.control.controllers import ENTRIES, Controller, Tuning, TuningBounds
from adaptrack.control.controllers.tuning import HORIZONS
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.tuning import swarm as kernel
from adaptrack.core.tuning.swarm import decode

_Number = Annotated[Natural, Field(lt=2**63)]
_LARGEST_WHOLE = 2**53  # every integer up to here is a double
_CLASSIC_ACCELERATION = 1.49618


class SearchSpace(Record):
    """Box with named dimensions in which a swarm searches.

    - A dimension with `low` = `high` is fixed.
    - Dimensions in `integers` have whole values.
    - In a dimension of `decades` the swarm moves in the decimal logarithm. Bounds and positions are still plain values.
    - The first dimension of `ordered` is at most the second.
    """

    names: Annotated[tuple[str, ...], LISTED] = Field(min_length=1, description="names of the dimensions")
    low: Annotated[tuple[float, ...], LISTED] = Field(description="lower bound of each dimension")
    high: Annotated[tuple[float, ...], LISTED] = Field(description="upper bound of each dimension")
    integers: Annotated[tuple[str, ...], LISTED] = Field(
        default=(), description="names of the dimensions with whole values"
    )
    decades: Annotated[tuple[str, ...], LISTED] = Field(
        default=(), description="names of the dimensions that are searched in log10"
    )
    ordered: Annotated[tuple[str, str] | None, LISTED] = Field(
        default=None, description="names of a smaller and a larger dimension; they may be equal in value"
    )
    spread: float = Field(
        default=1.0,
        ge=1,
        le=1e6,
        description="in an initial position the larger of `ordered` is at least this many times the smaller",
    )

    @model_validator(mode="after")
    def _is_a_space(self) -> Self:
        if len(set(self.names)) < len(self.names):
            raise ValueError(f"names = {list(self.names)}: each dimension needs a name of its own.")
        for key in ("low", "high"):
            if len(getattr(self, key)) != self.dims:
                raise ValueError(
                    f"{key} has {len(getattr(self, key))} values for {self.dims} names: give one for each."
                )
        for word in (*self.integers, *self.decades, *(self.ordered or ())):
            if word not in self.names:
                raise ValueError(f"{word!r} is not one of the names, {list(self.names)}.")
        for name, low, high in zip(self.names, self.low, self.high, strict=True):
            if not low <= high:
                raise ValueError(f"{name}: low = {low:g} > high = {high:g}: the space is empty.")
            if name in self.decades and not low > 0.0:
                raise ValueError(f"{name}: low = {low:g} must be positive to be searched by decades.")
            if name in self.decades and name in (*self.integers, *(self.ordered or ())):
                raise ValueError(f"{name}: a dimension of `decades` must be neither in `integers` nor in `ordered`.")
            if not math.isfinite(high - low):
                raise ValueError(f"{name}: the range from {low:g} to {high:g} is not a finite number.")
            if name in self.integers and not (low.is_integer() and high.is_integer()):
                raise ValueError(f"{name}: low = {low:g} and high = {high:g} must be whole, like the dimension.")
            if name in self.integers and max(abs(low), abs(high)) > _LARGEST_WHOLE:
                raise ValueError(f"{name}: whole numbers beyond 2^53 cannot be distinguished.")
        if self.ordered is None:
            if self.spread != 1.0:
                raise ValueError(f"spread = {self.spread:g}: name the two dimensions that it applies to in `ordered`.")
            return self
        smaller, larger = self.ordered
        i, j = self.names.index(smaller), self.names.index(larger)
        if i == j or (smaller in self.integers) != (larger in self.integers):
            raise ValueError(
                f"ordered = {list(self.ordered)}: give two dimensions, both of whole or both of real numbers."
            )
        if self.low[i] > self.low[j]:
            raise ValueError(
                f"{smaller} <= {larger} cannot hold where {larger} < {self.low[i]:g}: raise the lower bound of "
                f"{larger} to that of {smaller}."
            )
        if self.spread > 1.0 and self.low[i] < 0.0:
            raise ValueError(f"spread = {self.spread:g}: needs a lower bound of {smaller} that is not negative.")
        return self

    @staticmethod
    def tuning() -> SearchSpace:
        """Return the space of Np, Nc, Q and R in the paper, with the bounds in its authors' programs."""
        return SearchBounds().space()

    @property
    def dims(self) -> int:
        """The number of dimensions."""
        return len(self.names)

    def packed(self) -> Array:
        """Return the space for the kernels, (4, dims), with the rows of `adaptrack.core.tuning.swarm.SPACE`."""
        scale = [portable.log10 if name in self.decades else float for name in self.names]
        bounds = [[f(end) for f, end in zip(scale, ends, strict=True)] for ends in (self.low, self.high)]
        marks = [[float(name in marked) for name in self.names] for marked in (self.integers, self.decades)]
        return np.array([*bounds, *marks])

    def values(self, x: Array) -> Array:
        """Return the values (..., dims) of internal positions of the swarm, which are logarithms for `decades`."""
        rows = np.ascontiguousarray(x, dtype=float).reshape(-1, self.dims)
        values = np.empty_like(rows)
        decode(len(rows), self.packed(), rows, values)
        return values.reshape(x.shape)

    def contains(self, x: ArrayLike) -> NDArray[np.bool_]:
        """Whether each position of x (..., dims) lies in the bounds, is whole in `integers`, and is ordered."""
        x = np.asarray(x, dtype=float)
        low, high = np.array(self.low), np.array(self.high)
        is_integer = self.packed()[2]
        slack = np.array([1e-12 if name in self.decades else 0.0 for name in self.names])  # error of 10**log10(x)
        is_within = (x >= low * (1 - slack)) & (x <= high * (1 + slack))
        inside = (is_within & ((is_integer < 0.5) | (x == np.round(x)))).all(axis=-1)
        if self.ordered is not None:
            smaller, larger = (self.names.index(name) for name in self.ordered)
            inside &= x[..., smaller] <= x[..., larger]
        return np.asarray(inside)


# -- spaces of tunings ------------------------------------------------------------------------------------------------
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
        low, high = (tuple(float(getattr(self, name)[end]) for name in ENTRIES) for end in (0, 1))
        decades = ("Q", "R") if self.decades else ()
        return SearchSpace(
            names=ENTRIES, low=low, high=high, integers=HORIZONS, decades=decades, ordered=("Nc", "Np"), spread=2.0
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
    names, tuning = controller.tuning_names, controller.tuning
    bounds = {name: TuningBounds(*controller.tuning_bounds[name]) for name in names}
    scale = {name: tuning[name] if limits.relative else 1.0 for name, limits in bounds.items()}
    low, high = (tuple(getattr(bounds[name], end) * scale[name] for name in names) for end in ("low", "high"))
    decades = tuple(name for name in names if bounds[name].relative and tuning[name] > 0.0)
    return SearchSpace(names=names, low=low, high=high, decades=decades)


# -- the swarm --------------------------------------------------------------------------------------------------------
class SwarmSettings(Record):
    """Settings of a swarm; the defaults are those of the paper's table.

    The inertia w and the accelerations c1 and c2 follow eqs. (19) and (20) if `kind` is "improved". They are constant
    if it is "classic". The defaults of the classic swarm are the constriction coefficients of Clerc & Kennedy (2002):
    w = 0.7298, c1 = c2 = 1.49618.
    """

    particles: int = Field(default=20, ge=1, le=100_000, description="number of positions in each generation")
    generations: int = Field(
        default=15, ge=1, le=1_000_000, description="number of generations, including the initial positions"
    )
    kind: Literal["improved", "classic"] = Field(default="improved", description="rule for w, c1 and c2")
    w_max: float = Field(
        default=0.99, ge=0, le=10, description="eq. (19); the initial inertia is w_min + (e^w_max)/lambda2"
    )
    w_min: float = Field(default=0.1, ge=0, le=10, description="eq. (19), inertia of late generations")
    lambda1: float = Field(default=30.0, ge=0, le=1e6, description="eq. (19), rate at which the inertia falls")
    lambda2: float = Field(default=3.0, gt=0, le=1e6, description="eq. (19), divisor of the exponential")
    w: float = Field(default=0.7298, ge=0, le=10, description="inertia of the classic swarm")
    c1: float = Field(
        default=2.0, ge=0, le=10, description="cognitive acceleration; initial value for the improved swarm"
    )
    c2: float = Field(default=2.0, ge=0, le=10, description="social acceleration; initial value for the improved swarm")
    steps: Annotated[tuple[float, float, float, float], LISTED] = Field(
        default=(0.05, 0.02, -0.035, -0.0015),
        description="eq. (20), change of c1 per generation in the first 20 %, to 35 %, to 75 % and in the rest",
    )
    velocity_clamp: float = Field(
        default=0.2, gt=0, le=1, description="largest velocity as a share of the range of the dimension"
    )

    @model_validator(mode="before")
    @classmethod
    def _classic_accelerations(cls, values: Any) -> Any:
        if isinstance(values, Mapping) and values.get("kind") == "classic":
            return {"c1": _CLASSIC_ACCELERATION, "c2": _CLASSIC_ACCELERATION, **values}
        return values

    @model_validator(mode="after")
    def _has_falling_inertia(self) -> Self:
        if self.w_min > self.w_max:
            raise ValueError(f"w_min = {self.w_min:g} > w_max = {self.w_max:g}: w_min must be at most w_max.")
        return self

    @classmethod
    def classic(cls, **changes: Any) -> Self:
        """Return settings of the classic swarm, with constant inertia and accelerations."""
        return cls(**{"kind": "classic", **changes})

    @property
    def evaluations(self) -> int:
        """The number of positions that a complete search evaluates."""
        return self.particles * self.generations

    def packed(self, space: SearchSpace) -> Array:
        """Return the settings for the kernels, in the order of `adaptrack.core.tuning.swarm.SWARM_SETTING`."""
        smaller, larger = (-1, -1) if space.ordered is None else (space.names.index(name) for name in space.ordered)
        return np.array(
            [
                self.generations, self.kind == "improved", self.w, self.w_max, self.w_min, self.lambda1, self.lambda2,
                self.c1, self.c2, *self.steps, self.velocity_clamp, smaller, larger, space.spread,
            ],
            dtype=float,
        )  # fmt: skip

    def schedule(self) -> Array:
        """Return w, c1 and c2 of each move between generations, (generations - 1, 3), by eqs. (19) and (20).

        The first w has no effect, since the initial velocities are zero. The steps of eq. (20) are added in each
        generation. With more than 150 generations the steps of the paper make c2 negative.
        """
        moves, is_classic = np.empty((self.generations - 1, 3)), self.kind == "classic"
        c1, c2, steps = self.c1, self.c2, np.array(self.steps)
        for g in range(self.generations - 1):
            coefficients = (self.w_max, self.w_min, self.lambda1, self.lambda2)
            moves[g] = self.w if is_classic else kernel.inertia(g, self.generations, *coefficients), c1, c2
            if not is_classic:
                c1, c2 = kernel.accelerations(g, self.generations, c1, c2, steps)
        return moves


class Best(NamedTuple):
    """Best position up to the present generation."""

    x: Array
    """Position, (dims,)."""
    cost: float
    """Its cost, infinite before the first finite cost."""


@dataclass(frozen=True, eq=False)
class SwarmResult:
    """Result of a search with a swarm."""

    x: Array
    """Best position, (dims,)."""
    cost: float
    """Its cost, infinite if no position had a finite cost."""
    trace: Array
    """Lowest cost up to and including each generation, (generations,)."""
    evaluations: int
    """Number of positions that were evaluated."""


class Swarm:
    """Swarm that receives the costs of its positions one generation at a time.

    Only the order of the costs matters, not their size. NaN counts as infinity. A particle without a finite cost so far
    is attracted to its initial position. A pickled swarm continues equal to the bit.

    Parameters
    ----------
    space
        Bounds of the positions.
    settings
        Settings of the swarm; None for the defaults.
    seed, stream
        Seed and stream number of the random numbers. Streams of one seed are independent.
    """

    @checked
    def __init__(
        self, space: SearchSpace, settings: SwarmSettings | None = None, *, seed: _Number = 0, stream: _Number = 0
    ) -> None:
        self.space = space
        self.settings = settings or SwarmSettings()
        self.seed, self.stream = seed, stream
        self.generation = 0
        """Index of the generation that `ask` returns; after the last one, the number of generations."""
        self._space, self._settings = space.packed(), self.settings.packed(space)
        self._swarm = kernel.particles(self.settings.particles, space.dims)
        self._trace = np.full(self.settings.generations, np.nan)
        kernel.begin(self.seed, self.stream, self._settings, self._space, self._swarm)

    @property
    def is_done(self) -> bool:
        """Whether the swarm has received the costs of all generations."""
        return self.generation >= self.settings.generations

    @property
    def best(self) -> Best:
        """The best position up to the present generation, and its cost."""
        return Best(self.space.values(self._swarm.leader), float(self._swarm.progress[kernel.PROGRESS.leader_cost]))

    @property
    def best_costs(self) -> Array:
        """The lowest cost of each particle so far, (particles,), infinite at first; a higher one changes nothing."""
        return self._swarm.best_costs.copy()

    @property
    def trace(self) -> Array:
        """The lowest cost up to and including each finished generation, (finished generations,)."""
        return self._trace[: self.generation].copy()

    def ask(self) -> Array:
        """Return the positions to evaluate, (particles, dims); they change when `tell` receives their costs.

        Raises
        ------
        InvalidInput
            After the last generation.
        """
        self._refuse_when_done()
        return self.space.values(self._swarm.x)

    def tell(self, costs: ArrayLike) -> None:
        """Store the costs (particles,) of the positions that `ask` returned, and compute the next generation.

        Raises
        ------
        InvalidInput
            After the last generation, or when `costs` is not one number for each particle.
        """
        self._refuse_when_done()
        try:
            values = np.ascontiguousarray(costs, dtype=float)
        except (TypeError, ValueError) as error:
            raise InvalidInput(f"costs are not numbers: {error}.") from None
        if values.shape != (self.settings.particles,):
            raise InvalidInput(
                f"costs have shape {values.shape}: give one number for each of {self.settings.particles} particles, "
                f"shape ({self.settings.particles},)."
            )
        kernel.learn(values, self._swarm)
        self._trace[self.generation] = self._swarm.progress[kernel.PROGRESS.leader_cost]
        if self.generation < self.settings.generations - 1:
            kernel.move(self.generation, self.seed, self.stream, self._settings, self._space, self._swarm)
        self.generation += 1

    def run(
        self, costs: Callable[[Array], ArrayLike], progress: Callable[[int, int], None] | None = None
    ) -> SwarmResult:
        """Evaluate the remaining generations and return the result.

        Parameters
        ----------
        costs
            Returns the costs (particles,) of positions (particles, dims); called once per generation.
        progress
            Function called with (generations done, generations in all).
        """
        while not self.is_done:
            if progress is not None:
                progress(self.generation, self.settings.generations)
            self.tell(costs(self.ask()))
        return self.result()

    def result(self) -> SwarmResult:
        """Return the result up to the present generation."""
        return SwarmResult(*self.best, self.trace, self.settings.particles * self.generation)

    def _refuse_when_done(self) -> None:
        if self.is_done:
            raise InvalidInput(f"The swarm is done: it has the costs of all {self.settings.generations} generations.")


@checked
def minimise(
    function: Callable[[Array], ArrayLike],
    space: SearchSpace,
    settings: SwarmSettings | None = None,
    seed: int = 0,
    stream: int = 0,
) -> SwarmResult:
    """Minimise a function with one swarm.

    Parameters
    ----------
    function
        Returns the costs (particles,) of positions (particles, dims); called once per generation.
    space, settings, seed, stream
        As for `Swarm`.

    Raises
    ------
    InvalidInput
        When `function` does not return one number for each particle.
    """
    return Swarm(space, settings, seed=seed, stream=stream).run(function)
