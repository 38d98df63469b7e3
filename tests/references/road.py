"""Independent references for roads: quadrature of the heading, and a search for the nearest point by millimetres."""

import itertools
import math

import numpy as np
from scipy.integrate import quad


def end_of(k0, k1, length):
    """(x, y) where a curve of the curvature k0 + k1 s ends that begins at the origin along x, by adaptive quadrature."""
    parts = np.linspace(0.0, length, 21)

    def integral(part):
        pieces = [quad(lambda s: part((k0 + 0.5 * k1 * s) * s), *ends)[0] for ends in itertools.pairwise(parts)]
        return math.fsum(pieces)

    return integral(math.cos), integral(math.sin)


def nearest_by_search(road, x, y, step=1e-3, coarse=0.5):
    """(arc length, distance) of the nearest of points `step` apart on a road, found without missing any.

    Of samples `coarse` apart only those can have the nearest point beside them that are at most `coarse` farther than
    the nearest sample.
    """
    s = np.linspace(0.0, road.length, math.ceil(road.length / coarse) + 1)
    points = road.at(s)
    best = (math.nan, math.inf)
    distance = np.hypot(points.x - x, points.y - y)
    spacing = s[1]
    for candidate in s[distance <= distance.min() + spacing]:
        fine = np.arange(max(candidate - spacing, 0.0), min(candidate + spacing, road.length) + step, step)
        near = road.at(np.minimum(fine, road.length))
        away = np.hypot(near.x - x, near.y - y)
        k = int(away.argmin())
        if away[k] < best[1]:
            best = (float(min(fine[k], road.length)), float(away[k]))
    return best


def beside(road, s, offset):
    """Points at lateral offsets from a road."""
    p = road.at(s)
    return p.x - offset * np.sin(p.heading), p.y + offset * np.cos(p.heading)


def figure_of_eight(arc, line, radius=30.0):
    """Elements of a closed road that crosses itself at a right angle."""
    turn = 1.5 * math.pi * radius
    return [
        arc(length=turn, curvature=1.0 / radius),
        line(length=2.0 * radius),
        arc(length=turn, curvature=-1.0 / radius),
        line(length=2.0 * radius),
    ]
