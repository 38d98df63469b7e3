"""Operating points as rows (speed, y_ref, friction, wind): grids, Sobol samples, left-right twins.

The paper's section III varies the operating point of a run. Here it is a row of an array of shape (n, 4), float64;
`POINT_COORDINATES` names and explains the columns. The number of a row is the point's number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal, NamedTuple, Self

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import Count, Natural, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record
from adaptrack.core.kernel import Field
from adaptrack.core.maths.portable import Array
from adaptrack.tuning.pso import Pair

IntegerArray = NDArray[np.int64]


POINT_COORDINATES = (
    Field("speed", "m/s", math.nan, "forward speed", "[1, 100]"),
    Field("y_ref", "m", math.nan, "lateral reference, from y = 0; positive to the left", "[-1000, 1000]"),
    Field("friction", "", math.nan, "friction of road and tyre", "[0.05, 2]"),
    Field("wind", "m/s", math.nan, "side wind: velocity of the air along +Y", "[-100, 100]"),
)
"""The columns of every array of operating points; their bounds are the values that make sense."""

POINT_NAMES = tuple(column.name for column in POINT_COORDINATES)

PAPER_GRID: dict[str, Any] = {
    "y_ref": (-14.0, -10.0, -6.0, -2.0, 2.0, 5.0, 8.0, 11.0, 14.0),
    "speed": tuple(float(v) for v in range(3, 28, 2)),
    "friction": (0.5, 0.6, 0.7, 0.8, 0.9),
    "wind": tuple(float(v) for v in range(-30, 31, 6)),
}
"""Levels of the authors' published data: 9 x 13 x 5 x 11 = 6,435 operating points."""

MAX_POINTS = 10_000_000
"""Operating points that one array may hold: more is a mistake in the configuration."""


def check_operating_points(points: ArrayLike) -> Array:
    """`points` as an array of shape (n, 4), columns as in `POINT_COORDINATES`.

    Raises InvalidInput for another shape, no row at all, or a value that is not finite or makes no sense; the message
    names it.
    """
    try:
        rows = np.array(points, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInput(f"operating points: need numbers, rows of {', '.join(POINT_NAMES)}.") from None
    if rows.ndim != 2 or rows.shape[1] != len(POINT_COORDINATES) or not len(rows):
        raise InvalidInput(
            f"operating points: need rows of {', '.join(POINT_NAMES)}, at least one; got the shape {rows.shape}."
        )
    for column, values in zip(POINT_COORDINATES, rows.T, strict=True):
        low, high = column.ends
        invalid = ~((values >= low) & (values <= high))  # NaN is invalid, too
        if invalid.any():
            first = int(np.flatnonzero(invalid)[0])
            raise InvalidInput(
                f"operating points: {column.name} = {values[first]:g} in row {first}: must be in {_range(column)}."
            )
    return rows + 0.0  # no negative zeros: equal points are equal bit for bit


# -- sets of operating points, as in the file of a campaign ------------------------------------------------------------
Levels = Annotated[tuple[float, ...], LISTED, pydantic.Field(min_length=1)]
Seed = Annotated[int, pydantic.Field(ge=0, le=2**63 - 1)]


class Grid(Record):
    """All combinations of the given levels, counted like the authors' data.

    y_ref changes slowest, then speed, friction, and wind fastest.
    """

    kind: Literal["grid"] = "grid"
    speed: Levels = pydantic.Field(description="m/s")
    y_ref: Levels = pydantic.Field(description="m")
    friction: Levels = pydantic.Field(description="-")
    wind: Levels = pydantic.Field(description="m/s")

    @pydantic.model_validator(mode="after")
    def _can_be_counted(self) -> Self:
        self.rows()
        return self

    def rows(self) -> Array:
        """The operating points, (n, 4)."""
        levels = {name: getattr(self, name) for name in ("y_ref", "speed", "friction", "wind")}
        for name, values in levels.items():
            if len(set(values)) < len(values):
                raise InvalidInput(f"grid: {name}: a level is given twice.")
        if math.prod(map(len, levels.values())) > MAX_POINTS:
            raise InvalidInput(f"grid: more than {MAX_POINTS:,} operating points; use fewer levels.")
        mesh = dict(zip(levels, np.meshgrid(*levels.values(), indexing="ij"), strict=True))
        return check_operating_points(np.column_stack([mesh[name].ravel() for name in POINT_NAMES]))


class PaperGrid(Record):
    """The 6,435 operating points of the authors' published data, see `PAPER_GRID`."""

    kind: Literal["paper-grid"] = "paper-grid"

    def rows(self) -> Array:
        """The operating points, (6435, 4)."""
        return Grid(**PAPER_GRID).rows()


class Box(Record):
    """Lowest and highest value of each quantity."""

    speed: Pair = pydantic.Field(description="m/s")
    y_ref: Pair = pydantic.Field(description="m")
    friction: Pair = pydantic.Field(description="-")
    wind: Pair = pydantic.Field(description="m/s")

    @pydantic.model_validator(mode="after")
    def _is_a_box(self) -> Self:
        for column in POINT_COORDINATES:
            low, high = getattr(self, column.name)
            if low > high:
                raise ValueError(f"box: {column.name} = [{low:g}, {high:g}] is empty: need low <= high.")
            if not column.ends[0] <= low <= high <= column.ends[1]:
                raise ValueError(f"box: {column.name} = [{low:g}, {high:g}]: must be within {_range(column)}.")
        return self


class Sobol(Record):
    """Points of a scrambled Sobol sequence in a box, see `sobol`."""

    kind: Literal["sobol"] = "sobol"
    n: int = pydantic.Field(ge=1, le=MAX_POINTS, description="how many operating points")
    seed: Seed = pydantic.Field(default=0, description="of the scrambling")
    box: Box = pydantic.Field(description="lowest and highest value of each quantity")

    def rows(self) -> Array:
        """The operating points, (n, 4)."""
        return sobol(self.n, dict(self.box), self.seed)


OperatingPoints = Annotated[PaperGrid | Grid | Sobol, pydantic.Field(discriminator="kind")]


@checked
def sobol(n: Annotated[Count, pydantic.Field(le=MAX_POINTS)], box: Mapping[str, Any], seed: Natural = 0) -> Array:
    """The first n points of a scrambled Sobol sequence in a box, (n, 4).

    box: values of a `Box` by name; seed: of the scrambling. The points fill the box more evenly than random ones, best
    when n is a power of two; the first points of a longer sample are the same. Raises InvalidInput for an empty box, or
    one that makes no sense.

    Source: A. B. Owen, *Scrambling Sobol' and Niederreiter-Xing points*, J. Complexity 14 (1998), by `scipy.stats.qmc`.
    """
    low, high = np.array([pair for _, pair in Box(**box)]).T
    return check_operating_points(low + unit_sobol(n, len(POINT_COORDINATES), seed) * (high - low))


@checked
def unit_sobol(n: int, dimensions: int, seed: Natural) -> Array:
    """The first n points of a scrambled Sobol sequence in the unit cube, (n, dimensions), in [0, 1)."""
    from scipy.stats import qmc

    # Whole powers of two keep the sequence balanced (and scipy quiet); the rest is cut off.
    sequence = qmc.Sobol(dimensions, scramble=True, seed=np.random.default_rng(seed))
    return sequence.random_base2(max(0, (n - 1).bit_length()))[:n]


def mirrored(points: ArrayLike) -> Array:
    """The operating points with left and right exchanged: (speed, -y_ref, friction, -wind).

    A plant that is symmetric answers the mirrored operating point with the mirrored motion: at the same cost.
    """
    rows = check_operating_points(points)
    return rows * [1.0, -1.0, 1.0, -1.0] + 0.0


class Fold(NamedTuple):
    """Operating points of which one may stand for another, see `fold`."""

    representatives: IntegerArray
    """(m,) numbers of the operating points to compute, ascending"""
    family: IntegerArray
    """(n,) operating point i is represented by `representatives[family[i]]`"""


def fold(points: ArrayLike) -> Fold:
    """Find the operating points that are left-right twins (or equal): the first of each family represents it.

    Twins are found by equality, bit for bit: in a grid they are as common as its levels are symmetric (2,860 of the
    paper's 6,435 operating points have one), in a Sobol sample there are none.
    """
    rows = check_operating_points(points)
    _, first, by_value = np.unique(canonical(rows), axis=0, return_index=True, return_inverse=True)
    # np.unique numbers families by their values; we number them by their first member.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    representatives, family = first[order], rank[by_value.reshape(-1)]
    return Fold(representatives.astype(np.int64), family.astype(np.int64))


def canonical(points: ArrayLike) -> Array:
    """(n, 4): of each operating point and its mirror image the one that lies to the left (y_ref > 0, or wind >= 0)."""
    rows = check_operating_points(points)
    y_ref, wind = rows[:, POINT_NAMES.index("y_ref")], rows[:, POINT_NAMES.index("wind")]
    left = (y_ref > 0.0) | ((y_ref == 0.0) & (wind >= 0.0))
    return np.where(left[:, np.newaxis], rows, mirrored(rows))


def _range(column: Field) -> str:
    return f"{column.bounds}{' ' * bool(column.unit)}{column.unit} ({column.meaning})"
