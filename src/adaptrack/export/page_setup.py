"""Setups of the page, and its ready-made roads.

A setup is plain data for JSON:

    car          {name} of ours | {sheet: {mass, wheelbase, ...}} | {file: a car file as the page has read it}
    road         {name} of `PAGE_ROADS` | {points: [[x, y], ...], closed, name} | {test} of `PAPER_ROADS`
    speed        {constant: m/s} | {lateral: m/s^2}, planned; a test has its own
    profile      name; what the controllers are made for
    truth        {lag, dead_time, bias, noise, friction, wind, brake_lag, slope, mass} where the world differs, else
                 null; noise and mass: factors; slope: dz/ds of a road, which a speed control knows
    seed         of the noise
    planner      {period, delay, noise, start} of a `drive.planner.SimulatedPlanner` that the cars follow, or null; they
                 then have a speed control. The noise of its points comes from other random numbers
    controllers  one or two {kind, tuning: null | {Np, Nc, Q, R}, belief: null | {lag, dead_time}}; with knows: "sheet"
                 one knows mass and wheelbase of the car, no more; with speed_control: {friction} a speed control that
                 assumes this friction, or [low, high], drives and brakes the car, on roads, otherwise the speed is
                 kept exactly
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from adaptrack.road import Arc, Clothoid, Line, Road, generate_road, road_through

PAPER_ROADS = ("triple-lane-change", "general-trajectory")
"""The paper's."""


def _oval() -> Road:
    radius, into = 80.0, 60.0
    bend: list[Any] = [Clothoid(length=into, start_curvature=0.0, end_curvature=1.0 / radius),
            Arc(length=math.pi * radius - into, curvature=1.0 / radius),
            Clothoid(length=into, start_curvature=1.0 / radius, end_curvature=0.0)]  # fmt: skip
    return Road.from_segments([Line(length=200.0), *bend] * 2, closed=True, name="oval", speed_limit=40.0)


GENERATED = {"mountain": 1500.0, "country": 2500.0, "town": 1200.0, "motorway": 4000.0, "lap": 1500.0}
"""Kinds of `generate_road` and how long (m) they are on the page."""
PAGE_ROADS = (*GENERATED, "oval")
"""The ready-made roads: level, of one width and speed limit each."""


@cache
def page_road(name: str) -> Road:
    """A ready-made road of the page."""
    road = generate_road(name, length=GENERATED[name]) if name in GENERATED else _oval()
    return road.replace(name=name)


def road_of(setup: Mapping[str, Any]) -> Road:
    """The road of a setup."""
    if "name" in setup and "points" not in setup:
        return page_road(setup["name"])
    return road_through(np.array(setup["points"], float), closed=bool(setup.get("closed")))
