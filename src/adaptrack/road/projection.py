"""The foot of points on a road, as arrays: the readable form of `adaptrack.kernels.road`, equal to it to 1e-10.

g(s) = (c(s) - p) . t(s) is half the slope of the squared distance from p; its derivative is 1 - kappa(s) e(s) with the
offset e = (p - c) . n. A foot is a zero of g at which g grows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.road.road import Projection, Road
from adaptrack.road.segments import Array

STRIDE = 1.0
"""m, the longest step of a search."""
STEPS = 400
"""The most steps of a search."""
CLOSE, ROUNDING = 1e-13, 2.0**-51
"""Tolerance of the foot: m, and as a share of the coordinates."""


def feet_near(road: Road, x: ArrayLike, y: ArrayLike, near: ArrayLike) -> Projection:
    """The first foot downhill in distance from the arc lengths `near` (m), for points x, y (m), (n,) each.

    Newton's steps, at most `STRIDE` long; where g changes its sign they are kept between the two places. The offset is
    NaN when there is no foot within `STEPS` of them.
    """
    x, y, near = (np.asarray(each, dtype=np.float64) for each in (x, y, near))
    s = np.array(near)
    low, high = np.full(s.shape, -np.inf), np.full(s.shape, np.inf)
    active = np.arange(s.size)
    for _ in range(STEPS):
        ahead, offset, curvature = _deviation(road, s[active], x[active], y[active])
        low[active] = np.where(ahead > 0.0, low[active], s[active])
        high[active] = np.where(ahead > 0.0, s[active], high[active])
        slope = 1.0 - curvature * offset
        step = -ahead / np.where(slope > 0.1, slope, 1.0)
        target = s[active] + np.clip(step, -STRIDE, STRIDE)
        outside = (target <= low[active]) | (target >= high[active])
        target[outside] = 0.5 * (low[active] + high[active])[outside]
        tolerance = CLOSE + ROUNDING * (np.abs(s[active]) + np.abs(x[active]) + np.abs(y[active]))
        going = (np.abs(ahead) > tolerance) & (high[active] - low[active] > tolerance) & (target != s[active])
        s[active[going]] = target[going]
        active = active[going]
        if not active.size:
            break
    points = road.at(s)
    _, offset, curvature = _deviation(road, s, x, y)
    offset[active] = np.nan
    return Projection(s, offset, points.heading, curvature)


def _deviation(road: Road, s: Array, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """g (m), the offset e (m) and the curvature (1/m) at s."""
    points = road.at(s)
    cos, sin = np.cos(points.heading), np.sin(points.heading)
    ahead = (points.x - x) * cos + (points.y - y) * sin
    return ahead, (y - points.y) * cos - (x - points.x) * sin, points.curvature


def nearest_feet(road: Road, x: ArrayLike, y: ArrayLike) -> Projection:
    """The nearest foot of the whole road for points x, y (m), (n,) each.

    The nearest point lies within half a stride of one of the samples, so a sample that is farther than the nearest one
    by more than that cannot lead to it.
    """
    x, y = (np.asarray(each, dtype=np.float64) for each in (x, y))
    samples = np.linspace(0.0, road.length, int(np.ceil(road.length / STRIDE)) + 1)
    points = road.at(samples)
    found = np.empty(x.size)
    for i in range(x.size):
        distance = np.hypot(points.x - x[i], points.y - y[i])
        near = samples[distance <= distance.min() + 0.5 * STRIDE]
        feet = feet_near(road, np.full(near.size, x[i]), np.full(near.size, y[i]), near).s
        place = road.at(feet if road.closed else np.clip(feet, 0.0, road.length))
        found[i] = feet[np.hypot(place.x - x[i], place.y - y[i]).argmin()]
    if road.closed:
        found -= np.floor(found / road.length) * road.length
    return feet_near(road, x, y, found)
