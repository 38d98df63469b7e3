"""Operating points as rows (speed, y_ref, friction, wind): grids, Sobol samples, left-right twins.

The paper's section III varies the operating point of a run. Here it is a row of an array of shape (n, 4), float64;
`POINT_COORDINATES` names and explains the columns. The number of a row is the point's number.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated, NamedTuple

import numpy as np
import pydantic
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import Count, Natural, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.core.kernel import Field

Array = NDArray[np.float64]
IntegerArray = NDArray[np.int64]


POINT_COORDINATES = (
    Field("speed", "m/s", math.nan, "forward speed", "[1, 100]"),
    Field("y_ref", "m", math.nan, "lateral reference, from y = 0; positive to the left", "[-1000, 1000]"),
    Field("friction", "", math.nan, "friction of road and tyre", "[0.05, 2]"),
    Field("wind", "m/s", math.nan, "side wind: velocity of the air along +Y", "[-100, 100]"),
)
"""The columns of every array of operating points; their bounds are the values that make sense."""

POINT_NAMES = tuple(column.name for column in POINT_COORDINATES)

PAPER_GRID: dict[str, tuple[float, ...]] = {
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

    Raises
    ------
    InvalidInput
        For another shape, no row at all, or a value that is not finite or makes no sense; the message names it.
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


def grid(*, speed: Sequence[float], y_ref: Sequence[float], friction: Sequence[float], wind: Sequence[float]) -> Array:
    """All combinations of the given levels, (n, 4).

    Counted like the authors' data: y_ref changes slowest, then speed, friction, and wind fastest.

    Raises
    ------
    InvalidInput
        For a quantity without levels, a level given twice, or a value that makes no sense.
    """
    axes = {"y_ref": y_ref, "speed": speed, "friction": friction, "wind": wind}
    levels: dict[str, Array] = {}
    for name, values in axes.items():
        try:
            levels[name] = np.array(values, dtype=np.float64)
        except (TypeError, ValueError):
            raise InvalidInput(f"grid: {name}: need a list of numbers.") from None
        if levels[name].ndim != 1 or not levels[name].size:
            raise InvalidInput(f"grid: {name}: need a list of one level or more.")
        if np.unique(levels[name]).size < levels[name].size:
            raise InvalidInput(f"grid: {name}: a level is given twice.")
    if math.prod(axis.size for axis in levels.values()) > MAX_POINTS:
        raise InvalidInput(f"grid: more than {MAX_POINTS:,} operating points; use fewer levels.")
    mesh = dict(zip(levels, np.meshgrid(*levels.values(), indexing="ij"), strict=True))
    return check_operating_points(np.column_stack([mesh[name].ravel() for name in POINT_NAMES]))


def paper_grid() -> Array:
    """The 6,435 operating points of the authors' published data, (6435, 4), see `PAPER_GRID`."""
    return grid(**PAPER_GRID)


def check_box(box: Mapping[str, Sequence[float]]) -> Array:
    """A box of operating points as an array (4, 2) of lowest and highest value, rows as in `POINT_COORDINATES`.

    Raises
    ------
    InvalidInput
        Unless it has one pair low <= high for each of speed, y_ref, friction and wind, within what makes sense.
    """
    if set(box) != set(POINT_NAMES):
        missing, unknown = sorted(set(POINT_NAMES) - set(box)), sorted(set(box) - set(POINT_NAMES))
        difference = "; ".join(
            f"{word} {', '.join(names)}" for word, names in (("missing:", missing), ("unknown:", unknown)) if names
        )
        raise InvalidInput(f"box: need a pair [low, high] for each of {', '.join(POINT_NAMES)}; {difference}.")
    bounds = np.empty((len(POINT_COORDINATES), 2))
    for row, column in zip(bounds, POINT_COORDINATES, strict=True):
        pair = box[column.name]
        if len(pair) != 2:
            raise InvalidInput(f"box: {column.name} = {list(pair)!r}: need a pair [low, high].")
        row[:] = pair
        if not row[0] <= row[1]:
            raise InvalidInput(f"box: {column.name} = [{row[0]:g}, {row[1]:g}] is empty: need low <= high.")
        low, high = column.ends
        if not low <= row[0] <= row[1] <= high:
            raise InvalidInput(f"box: {column.name} = [{row[0]:g}, {row[1]:g}]: must be within {_range(column)}.")
    return bounds


@checked
def sobol(
    n: Annotated[Count, pydantic.Field(le=MAX_POINTS)], box: Mapping[str, Sequence[float]], seed: Natural = 0
) -> Array:
    """The first n points of a scrambled Sobol sequence in a box, (n, 4).

    box: a pair [low, high] for each of speed, y_ref, friction, wind; seed: of the scrambling. The points fill the box
    more evenly than random ones, best when n is a power of two; the first points of a longer sample are the same.

    Source: A. B. Owen, *Scrambling Sobol' and Niederreiter-Xing points*, J. Complexity 14 (1998), by `scipy.stats.qmc`.

    Raises
    ------
    InvalidInput
        For an empty box, or one that makes no sense.
    """
    bounds = check_box(box)
    return check_operating_points(
        bounds[:, 0] + unit_sobol(n, len(POINT_COORDINATES), seed) * (bounds[:, 1] - bounds[:, 0])
    )


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
    sign: IntegerArray
    """(n,) 1 when it equals its representative, -1 when it is the mirror image"""


def fold(points: ArrayLike) -> Fold:
    """Find the operating points that are left-right twins (or equal): the first of each family represents it.

    With reps = points[representatives]: points[i] is reps[family[i]] where sign[i] is 1, and
    mirrored(reps)[family[i]] where it is -1. Twins are found by equality, bit for bit: in a grid they are as common as
    its levels are symmetric (2,860 of the paper's 6,435 operating points have one), in a Sobol sample there are none.
    """
    rows = check_operating_points(points)
    _, first, by_value = np.unique(canonical(rows), axis=0, return_index=True, return_inverse=True)
    # np.unique numbers families by their values; we number them by their first member.
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    representatives, family = first[order], rank[by_value.reshape(-1)]
    equal = (rows == rows[representatives[family]]).all(axis=1)
    return Fold(representatives.astype(np.int64), family.astype(np.int64), np.where(equal, 1, -1).astype(np.int64))


def canonical(points: ArrayLike) -> Array:
    """(n, 4): of each operating point and its mirror image the one that lies to the left (y_ref > 0, or wind >= 0)."""
    rows = check_operating_points(points)
    y_ref, wind = rows[:, POINT_NAMES.index("y_ref")], rows[:, POINT_NAMES.index("wind")]
    left = (y_ref > 0.0) | ((y_ref == 0.0) & (wind >= 0.0))
    return np.where(left[:, np.newaxis], rows, mirrored(rows))


def _range(column: Field) -> str:
    return f"{column.bounds}{' ' * bool(column.unit)}{column.unit} ({column.meaning})"
