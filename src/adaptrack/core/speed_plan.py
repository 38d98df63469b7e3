"""The speed of a plan along a road: between its places the square of the speed is straight."""

from __future__ import annotations

import math

from .kernel import exported, float64, inlined, vector, void
from .maths.exact import floor, sqrt, square


@inlined
def cell_from(place, k, s):
    """The last of ascending places s[k] <= `place` < s[n - 1]: strides that double from k on, then halves."""
    step = 1
    while k + step < s.size - 1 and s[k + step] <= place:
        k += step
        step *= 2
    while step > 1:
        step //= 2
        if k + step < s.size - 1 and s[k + step] <= place:
            k += step
    return k


@exported(void(float64, vector, vector, vector))
def planned_speeds(lap, s, speed, places):
    """Replace arc lengths (m) by the speeds (m/s) that a plan has there; what is no number stays as it is.

    lap: m, of a closed road, which goes on lap after lap; 0: of an open one, constant beyond its ends.
    """
    last, k, before = s.size - 1, 0, math.inf
    for i in range(places.size):
        place = places[i]
        if lap > 0.0:
            place -= floor(place / lap) * lap
        if place <= s[0]:
            places[i] = sqrt(square(speed[0]))
        elif place >= s[last]:
            places[i] = sqrt(square(speed[last]))
        elif place == place:
            k = cell_from(place, k if place >= before else 0, s)
            before = place
            low, high = square(speed[k]), square(speed[k + 1])
            places[i] = sqrt((high - low) / (s[k + 1] - s[k]) * (place - s[k]) + low)
