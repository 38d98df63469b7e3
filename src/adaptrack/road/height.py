"""The grade of a road from the heights of its points: the slope of a penalised cubic spline near them.

The smoothing length is the one that cross-validation chooses, as for the line of the road (`fit`). The penalty leaves
parabolas alone, the vertical curves of road design. Waves shorter than `MIN_HEIGHT_SMOOTHING` count as noise, and so
do the stairs of rounded heights, which cross-validation would take for road.
"""

from __future__ import annotations

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_GRADE
from adaptrack.core.maths import portable
from adaptrack.road.segments import Array
from adaptrack.road.smoothing import Smoother

MIN_HEIGHT_SMOOTHING, MAX_HEIGHT_SMOOTHING = 10.0, 1000.0
"""m, the least and the largest smoothing length of heights; a shorter wave is roughness, not grade."""
STAIRS = 4.0
"""Smoothing length at least, over the median distance of two changes of the height."""
SMOOTHING_LENGTHS = 28
"""Smoothing lengths that cross-validation compares."""


def grade_of_heights(s: Array, height: Array, length: float, closed: bool) -> tuple[tuple[Array, Array], str]:
    """Arc lengths (m) along a road with the grade dz/ds there, from heights (n,) m at arc lengths s (n,) m; and a note.

    Raises
    ------
    InvalidInput
        When the heights rise or fall by more than `MAX_GRADE`.
    """
    places = np.mod(s, length) if closed else np.clip(s, 0.0, length)
    smoother = Smoother((height - height[0])[:, np.newaxis], places, length, closed, max(length / s.size, 0.5))
    shortest = max(MIN_HEIGHT_SMOOTHING, 0.5 * smoother.spacing, STAIRS * _stair_length(s, height))
    scales = portable.geomspace(shortest, max(min(0.25 * length, MAX_HEIGHT_SMOOTHING), shortest), SMOOTHING_LENGTHS)
    scale = float(scales[smoother.best_scale(scales)])
    powers = smoother.powers(scale)[:, 0]
    knot = length / len(powers)
    first = np.minimum((places / knot).astype(np.int64), len(powers) - 1)
    fitted = (powers[first] * np.vander(places / knot - first, 4, increasing=True)).sum(axis=1)
    deviation = float(np.sqrt(np.mean(portable.square(fitted - smoother.points[:, 0]))))
    slopes = [powers[:, 1], powers[:, 1] + powers[:, 2] + 0.75 * powers[:, 3]]  # at the knots, and between them
    last = powers[-1, 1] + 2.0 * powers[-1, 2] + 3.0 * powers[-1, 3]
    grade = np.append(np.stack(slopes, axis=-1), last) / knot
    stations = np.linspace(0.0, length, grade.size)
    k = int(np.abs(grade).argmax())
    if abs(grade[k]) > MAX_GRADE:
        raise InvalidInput(
            f"fit_road: the heights change by {grade[k]:.3g} m per metre at s = {stations[k]:.6g} m: at most "
            f"{MAX_GRADE} are possible; is z in m? Correct the heights, or leave them out."
        )
    return (stations, grade), (
        f"grade {100.0 * grade.min():.2g} to {100.0 * grade.max():.2g} % from heights; root mean square of their "
        f"deviation {deviation:.3g} m; smoothing length {scale:.3g} m"
    )


def _stair_length(s: Array, height: Array) -> float:
    """The median distance (m) of two changes of rounded heights; 0 where most heights differ from the one before."""
    changes = np.flatnonzero(np.diff(height))
    if changes.size < 2 or np.median(np.diff(changes)) < 2.0:
        return 0.0
    return float(np.median(np.abs(np.diff(s[changes]))))
