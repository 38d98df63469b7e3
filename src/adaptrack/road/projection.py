"""The foot of points on a road, as arrays: the readable form of `adaptrack.core.road`, equal to it to 1e-10.

g(s) = (c(s) - p) . t(s) is half the slope of the squared distance from p; its derivative is 1 - kappa(s) e(s) with the
offset e = (p - c) . n. A foot is a zero of g at which g grows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.road.road import Projection, Road
from adaptrack.road.segments import Array, Points

Mask = NDArray[np.bool_]

STRIDE = 1.0
"""m, the longest step of a search."""
STEPS = 400
"""The most steps of a walk downhill."""
REACH = 400.0
"""m of arc length, within which a foot is looked for."""
HALVINGS = 50
"""Of a stride, in the search for the turning point of g."""
CLOSE, ROUNDING = 1e-13, 2.0**-51
"""Tolerance of the foot: m, and as a share of the coordinates."""
FLAT, SAME = 1e-9, 1e-9
"""A slope of g that is 0 but for rounding; m, and as a share of the way, the difference of feet that are one."""


def feet_near(road: Road, x: ArrayLike, y: ArrayLike, near: ArrayLike) -> Projection:
    """The foot nearest in arc length to `near` (m), for points x, y (m), (n,) each, within `REACH`.

    The offset is NaN, and the arc length `near`, where there is none. Downhill in distance lies a foot; where g may
    fall on the way or as far to the other side, strides to both sides are searched for a nearer one.
    """
    x, y, near = (np.asarray(each, dtype=np.float64) for each in (x, y, near))
    endless = np.full(near.shape, np.inf)
    s, reached = _downhill(road, x, y, near, -endless, endless)
    _, slope, offset = _deviation(road.at(s), x, y)
    gone = np.abs(s - near)
    is_foot = reached & (slope > -FLAT)
    unsure = np.flatnonzero(~is_foot | ((np.abs(offset) + 2.0 * gone) * road.table.most_curvature >= 1.0))
    reach = np.where(is_foot, (1.0 - SAME) * gone - SAME, REACH)[unsure]
    other = _feet_about(road, x[unsure], y[unsure], near[unsure], reach)
    s[unsure] = np.where(np.isnan(other), np.where(is_foot[unsure], s[unsure], near[unsure]), other)
    is_foot[unsure] |= ~np.isnan(other)
    points = road.at(s)
    offset = np.where(is_foot, _deviation(points, x, y)[2], np.nan)
    return Projection(s, offset, points.heading, points.curvature)


def _downhill(road: Road, x: Array, y: Array, near: Array, low: Array, high: Array) -> tuple[Array, Mask]:
    """The first foot downhill from arc lengths, between others, and whether it was reached.

    Newton's steps, at most `STRIDE` long; where g changes its sign they are kept between the two places.
    """
    s, low, high = np.array(near), np.array(low), np.array(high)
    active = np.arange(s.size)
    for _ in range(STEPS):
        here, px, py = s[active], x[active], y[active]
        ahead, slope, _ = _deviation(road.at(here), px, py)
        low[active] = np.where(ahead > 0.0, low[active], here)
        high[active] = np.where(ahead > 0.0, here, high[active])
        first, last = low[active], high[active]
        step = -ahead / np.where(slope > 0.1, slope, 1.0)
        target = here + np.clip(step, -STRIDE, STRIDE)
        halved = (target <= first) | (target >= last) | ((slope <= 0.1) & (last - first < STRIDE))
        target[halved] = 0.5 * (first + last)[halved]
        tolerance = CLOSE + ROUNDING * (np.abs(here) + np.abs(px) + np.abs(py))
        going = (np.abs(ahead) > tolerance) & (last - first > tolerance) & (target != here) & np.isfinite(target)
        s[active[going]] = target[going]
        active = active[going]
        if not active.size:
            break
    reached = np.ones(s.shape, dtype=bool)
    reached[active] = False
    return s, reached


def _feet_about(road: Road, x: Array, y: Array, near: Array, reach: Array) -> Array:
    """The foot nearest to arc lengths within `reach` (m) to both sides, stride by stride; NaN: none."""
    found, reach = np.full(near.shape, np.nan), np.array(reach)
    for side in (1.0, -1.0):
        active = np.flatnonzero(reach > 0.0)
        k = 0
        while active.size:
            px, py, most = x[active], y[active], reach[active]
            ends = near[active] + side * np.minimum([[k * STRIDE], [(k + 1) * STRIDE]], most)
            low, high, grows = _brackets(road, ends.min(axis=0), ends.max(axis=0), px, py)
            hit = active[grows]
            foot, reached = _downhill(road, x[hit], y[hit], 0.5 * (low + high)[grows], low[grows], high[grows])
            nearer = reached & (np.abs(foot - near[hit]) <= reach[hit])
            found[hit[nearer]] = foot[nearer]
            reach[hit[nearer]] = np.abs(foot - near[hit])[nearer]
            k += 1
            active = active[~grows & (k * STRIDE < most)]
    return found


def _brackets(road: Road, low: Array, high: Array, x: Array, y: Array) -> tuple[Array, Array, Mask]:
    """Arc lengths within strides between which g grows through 0, and whether there are any.

    Where g has one sign at both ends but turns back between them, its turning point is looked for.
    """
    low, high = np.array(low), np.array(high)
    (before, rising, _), (after, still, _) = (_deviation(road.at(s), x, y) for s in (low, high))
    grows = (before <= 0.0) & (after > 0.0)
    hill = (before <= 0.0) & (after <= 0.0) & (rising > 0.0) & (still < 0.0)
    valley = (before > 0.0) & (after > 0.0) & (rising < 0.0) & (still > 0.0)
    first, last = low.copy(), high.copy()
    active = np.flatnonzero(hill | valley)
    for _ in range(HALVINGS if active.size else 0):
        middle = 0.5 * (first + last)[active]
        g, slope, _ = _deviation(road.at(middle), x[active], y[active])
        beyond = np.where(hill[active], g > 0.0, g <= 0.0)
        done, up = active[beyond], hill[active[beyond]]
        grows[done] = True
        high[done[up]], low[done[~up]] = middle[beyond][up], middle[beyond][~up]
        onward = (slope > 0.0) == hill[active]
        first[active[onward]], last[active[~onward]] = middle[onward], middle[~onward]
        active = active[~beyond]
    return low, high, grows


def _deviation(points: Points, x: Array, y: Array) -> tuple[Array, Array, Array]:
    """g (m), its derivative and the offset e (m) at points of a road."""
    cos, sin = np.cos(points.heading), np.sin(points.heading)
    offset = (y - points.y) * cos - (x - points.x) * sin
    return (points.x - x) * cos + (points.y - y) * sin, 1.0 - points.curvature * offset, offset


def nearest_feet(road: Road, x: ArrayLike, y: ArrayLike) -> Projection:
    """The nearest foot of the whole road for points x, y (m), (n,) each.

    The nearest point lies within half a stride of one of the samples, so a sample that is farther than the nearest one
    by more than that is not next to it. Beyond the ends of an open road the foot is on its straight continuation.
    """
    x, y = (np.asarray(each, dtype=np.float64) for each in (x, y))
    samples = np.linspace(0.0, road.length, int(np.ceil(road.length / STRIDE)) + 1)
    points = road.at(samples)
    found = np.empty(x.size)
    for i in range(x.size):
        distance = np.hypot(points.x - x[i], points.y - y[i])
        near = samples[distance <= distance.min() + 0.5 * STRIDE]
        if not road.closed:
            ahead = _deviation(road.at(near), x[i], y[i])[0]
            beyond = ((near == 0.0) & (ahead > 0.0)) | ((near == road.length) & (ahead < 0.0))
            near = near - np.where(beyond, ahead, 0.0)
        feet = feet_near(road, np.full(near.size, x[i]), np.full(near.size, y[i]), near).s
        place = road.at(feet if road.closed else np.clip(feet, 0.0, road.length))
        found[i] = feet[np.hypot(place.x - x[i], place.y - y[i]).argmin()]
    if road.closed:
        found -= np.floor(found / road.length) * road.length
        found[road.length - found <= SAME] = 0.0  # the seam is the road's beginning
    return feet_near(road, x, y, found)
