"""Independent references for roads: quadrature of the heading, and a search for the nearest point by millimetres."""

import itertools
import math

import numpy as np
from scipy.integrate import quad
from scipy.special import fresnel


def end_of(k0, k1, length):
    """(x, y) where a curve of curvature k0 + k1 s ends that begins at the origin along x, by adaptive quadrature."""
    parts = np.linspace(0.0, length, 21)

    def integral(part):
        pieces = [quad(lambda s: part((k0 + 0.5 * k1 * s) * s), *ends)[0] for ends in itertools.pairwise(parts)]
        return math.fsum(pieces)

    return integral(math.cos), integral(math.sin)


def exact_points(segment, s):
    """x, y, heading and curvature of a line, arc or clothoid: Fresnel's integrals, or the chord of an arc."""
    k0, k_end = segment.curvatures
    k1 = (k_end - k0) / segment.length
    heading, curvature = k0 * s + 0.5 * k1 * s * s, k0 + k1 * s
    if k1 == 0.0:
        place = s * np.sinc(0.5 * heading / np.pi) * np.exp(0.5j * heading)
    else:
        scale = np.sqrt(np.pi / abs(k1))
        (s1, c1), (s0, c0) = fresnel((s + k0 / k1) / scale), fresnel(k0 / k1 / scale)
        place = scale * ((c1 - c0) + 1j * np.sign(k1) * (s1 - s0)) * np.exp(-0.5j * k0 * k0 / k1)
    return place.real, place.imag, heading, curvature


def coarse_samples(road, spacing=0.5):
    """Arc lengths and points of a road, (n,) each, at most `spacing` apart: for many searches."""
    s = np.linspace(0.0, road.length, math.ceil(road.length / spacing) + 1)
    return s, *road.at(s)[:2]


def nearest_by_search(road, x, y, step=1e-3, samples=None):
    """(arc length, distance) of the nearest of points `step` apart on a road, found without missing any.

    The nearest point lies within half a spacing of a coarse sample, so only samples that are farther than the nearest
    one by no more than that can have it beside them.
    """
    s, px, py = coarse_samples(road) if samples is None else samples
    spacing = s[1]
    distance = np.hypot(px - x, py - y)
    near = s[distance <= distance.min() + 0.5 * spacing]
    ticks = np.unique((near[:, np.newaxis] + np.arange(-0.5 * spacing, 0.5 * spacing + step, step)).ravel() // step)
    fine = np.clip(ticks * step, 0.0, road.length)
    points = road.at(fine)
    gap = np.hypot(points.x - x, points.y - y)
    k = int(gap.argmin())
    return float(fine[k]), float(gap[k])


def feet_by_search(road, x, y, near, reach=400.0, step=0.25):
    """The arc lengths, nearest to `near`, at which the distance of points has a minimum, (n,); NaN: none within reach.

    Minima lie where the slope of the distance changes its sign between samples; two between the same are not seen.
    """
    s = np.arange(near.min() - reach, near.max() + reach + step, step)
    p = road.at(s)
    cos, sin = np.cos(p.heading), np.sin(p.heading)
    slope = p.x * cos + p.y * sin - np.outer(x, cos) - np.outer(y, sin)
    minimum = (slope[:, :-1] <= 0.0) & (slope[:, 1:] > 0.0)
    distance = np.where(minimum, np.abs(s[:-1] + 0.5 * step - near[:, np.newaxis]), np.inf)
    nearest = np.argsort(distance, axis=1)[:, :2]  # either may be the nearer one in the end
    some = np.isfinite(np.take_along_axis(distance, nearest, axis=1))
    low, high = s[nearest], s[nearest + 1]
    for _ in range(45):
        middle = 0.5 * (low + high)
        p = road.at(middle)
        up = (p.x - x[:, np.newaxis]) * np.cos(p.heading) + (p.y - y[:, np.newaxis]) * np.sin(p.heading) > 0.0
        low, high = np.where(up, low, middle), np.where(up, middle, high)
    gone = np.where(some, np.abs(low - near[:, np.newaxis]), np.inf)
    best = gone.argmin(axis=1)[:, np.newaxis]
    foot, gone = (np.take_along_axis(column, best, axis=1)[:, 0] for column in (low, gone))
    return np.where(gone <= reach, foot, np.nan)


def beside(road, s, offset):
    """Points at lateral offsets from a road."""
    p = road.at(s)
    return p.x - offset * np.sin(p.heading), p.y + offset * np.cos(p.heading)


def figure_of_eight(arc, line, radius=30.0):
    """Elements of a closed road that crosses itself at a right angle."""
    turn = 1.5 * math.pi * radius
    return [
        arc(length=turn, curvature=1.0 / radius), line(length=2.0 * radius),
        arc(length=turn, curvature=-1.0 / radius), line(length=2.0 * radius),
    ]  # fmt: skip
