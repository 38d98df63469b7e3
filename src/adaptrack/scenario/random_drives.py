"""Random drives: mixed driving for tests, on roads that no controller was tuned or trained on.

Speed, friction, curves, lane changes and wind are drawn in this order, each from its own random stream. The lowest
friction and the lowest speed during a manoeuvre limit its size. A lane change in a curve uses only the acceleration and
heading that the curve leaves unused. A suitable controller can therefore complete every drive.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from adaptrack.base.checked import RISING, Hint, Natural, NotNegative, Positive, checked
from adaptrack.cars.vehicle import Domain
from adaptrack.core.maths import portable
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.scenario import shapes
from adaptrack.scenario.scenario import Scenario
from adaptrack.scenario.shapes import Constant, Gust, Knots, LaneChange, Shape, Step, Sum, Wind

DESCRIPTION = "Mixed driving: changing speed and friction, curves, lane changes, wind and gusts."

LONGEST_DRIVE = 86_400.0
"""Longest allowed duration of a random drive (s)."""

MAX_TRACTION, MAX_BRAKING = 2.0, 3.0
"""Largest longitudinal acceleration and deceleration (m/s^2)."""

MAX_LONGITUDINAL_SHARE = 0.5
"""Largest share of the friction limit that a change of speed may use."""

DRY_SHARE = 0.25
"""Share of the drives that stay in the highest 30 % of the friction range."""

PASSENGER_CAR_DOMAIN = Domain()
"""Ranges of speed, friction, wind and lane width for passenger cars."""

LANE_CHANGE_SEVENTHS = (2.0, 12.0)
"""Smallest and largest amplitude of a lane change, in sevenths of the lane width (1 m and 6 m for a 3.5 m lane)."""

SHORTEST_LANE_CHANGE, LONGEST_LANE_CHANGE = 2.0, 12.0
"""Shortest and longest duration of a lane change (s); a change that would need longer is left out."""

CURVE_TIME = (5.0, 14.0)
"""Shortest and longest duration of a curve (s)."""

CURVE_HEADING_SHARE = (0.3, 0.8)
"""Range of the share of the heading limit that a curve uses; lane changes in the curve use the rest."""

FRICTION_MARGIN = 0.5
"""Time before and after a friction step during which the lower friction is assumed (s)."""

_SMOOTHSTEP_SLOPE = 1.5  # steepest slope of a smoothstep cubic with unit height and duration
_STEP = 0.05  # s, sampling time of the arrays in `_DriveGenerator`
_FRICTION, _SPEED, _CURVES, _CHANGES, _WIND = range(5)  # numbers of the random streams


_Friction = Annotated[Positive, Field(le=shapes.HIGHEST_FRICTION)]
_PositiveShare = Annotated[Positive, Field(le=1.0)]


@checked
def random_drive(
    seed: Natural,
    duration: Annotated[Positive, Field(le=LONGEST_DRIVE), "s"] = 60.0,
    *,
    speed: Annotated[tuple[Positive, Positive], RISING, "m/s"] = PASSENGER_CAR_DOMAIN.speed,
    friction: Annotated[tuple[_Friction, _Friction], RISING] = PASSENGER_CAR_DOMAIN.friction,
    wind: Annotated[NotNegative, "m/s"] = PASSENGER_CAR_DOMAIN.wind,
    demand: Annotated[tuple[_PositiveShare, _PositiveShare], RISING] = (0.1, 0.35),
    heading: Annotated[Positive, Field(le=0.5), "rad", Hint("a small angle")] = 0.25,
    lane_width: Annotated[Positive, "m"] = PASSENGER_CAR_DOMAIN.lane_width,
) -> Scenario:
    """Mixed driving: changing speed and friction, curves, lane changes, wind and gusts.

    A seed gives the same drive on every machine. Drives with equal durations have equally many samples. The reference
    is twice continuously differentiable.

    Parameters
    ----------
    seed : int
        Seed of the random numbers.
    duration : float
        Duration (s). A longer drive with the same seed is a different drive, not a continuation.
    speed : (float, float)
        Lowest and highest speed (m/s). The speed changes smoothly between stretches of constant speed. It rises by at
        most 2 m/s^2, falls by at most 3 m/s^2, and uses at most half of the friction limit.
    friction : (float, float)
        Lowest and highest friction coefficient. The friction steps every 10 s on average. A quarter of the drives are
        dry: they stay in the highest 30 % of the range.
    wind : float
        Largest lateral wind speed (m/s). The steady part is at most a third of it; gusts blow to either side.
    demand : (float, float)
        Range of the share of the friction limit that a manoeuvre may use. Each curve and each lane change draws its
        share. The lateral acceleration d²y_ref/dt², including that of a curve during a lane change, never exceeds this
        share of the limit at the lowest friction during the manoeuvre.
    heading : float
        Largest heading of the reference (rad), asin(dy_ref/dt / speed).
    lane_width : float
        Lane width (m). Lane changes have amplitudes of 2/7 to 12/7 of it.

    Examples
    --------
    The ranges of a car: ``random_drive(7, **car.domain.drive_options)``.
    """
    options: dict[str, Any] = {"speed": speed, "friction": friction, "wind": wind, "demand": demand, "heading": heading}
    if lane_width != PASSENGER_CAR_DOMAIN.lane_width:
        options["lane_width"] = lane_width
    drive = _DriveGenerator(seed, duration, demand, heading, lane_width)
    drawn_friction, drawn_speed = drive.draw_friction(*friction), drive.draw_speed(*speed)
    manoeuvres = (*drive.draw_curves(), *drive.draw_lane_changes())
    return Scenario(
        name="random-drive",
        description=DESCRIPTION,
        source=f"random_drive({seed}, {duration!r}, {', '.join(f'{k}={v!r}' for k, v in options.items())})",
        duration=duration,
        reference=Sum(terms=manoeuvres) if manoeuvres else 0.0,
        speed=drawn_speed,
        friction=drawn_friction,
        wind=Wind(y=drive.draw_wind(wind)),
    )


class _DriveGenerator:
    """Generator of the signals of one random drive; its arrays hold the signals drawn so far at the instants k * _STEP.

    Draw friction and speed first, then curves, then lane changes: each manoeuvre depends on the signals before it.
    """

    def __init__(
        self, seed: int, duration: float, demand: tuple[float, float], max_heading: float, lane_width: float
    ) -> None:  # fmt: skip
        """Take the arguments of `random_drive` in s, rad and m."""
        self.seed, self.duration, self.demand, self.slope = seed, duration, demand, portable.sin(max_heading)
        self.widths = tuple(sevenths * lane_width / 7.0 for sevenths in LANE_CHANGE_SEVENTHS)
        self.t = _STEP * np.arange(math.ceil(duration / _STEP) + 1)
        self.friction, self.speed = np.empty_like(self.t), np.empty_like(self.t)
        # lateral acceleration and lateral velocity in curves
        self.curve_acceleration, self.curve_velocity = np.zeros_like(self.t), np.zeros_like(self.t)

    def random(self, purpose: int) -> np.random.Generator:
        """Return the random stream of one signal; the options of other signals do not change its numbers."""
        return np.random.default_rng((self.seed, purpose))

    def grip(self, start: float, span: float) -> float:
        """Acceleration limit (m/s^2) of the lowest friction between `start` and `start + span` (s)."""
        return GRAVITY * float(self.friction[_window(start - FRICTION_MARGIN, span + 2.0 * FRICTION_MARGIN)].min())

    def draw_friction(self, low: float, high: float) -> Shape:
        """Draw the friction, which changes in steps and is equal under all wheels."""
        rng = self.random(_FRICTION)
        if rng.random() < DRY_SHARE:
            low = high - 0.3 * (high - low)
        level = _between(rng, low, high)
        terms: list[Shape] = [Constant(value=level)]
        start = _between(rng, 2.0, 14.0)
        while start < self.duration:
            next_level = _between(rng, low, high)
            terms.append(Step(after=round(next_level - level, 6), time=start))
            level, start = next_level, round(start + _between(rng, 4.0, 16.0), 2)
        steps = Sum(terms=tuple(terms))
        self.friction[:] = steps.at(self.t)
        return steps

    def draw_speed(self, low: float, high: float) -> Shape:
        """Draw the speed: constant stretches joined by cubics."""
        rng = self.random(_SPEED)
        speed = _between(rng, low, high)
        t, start, points = 0.0, _between(rng, 1.0, 6.0), [(0.0, speed)]
        while start < self.duration:
            next_speed, strength = _between(rng, low, high), rng.uniform(0.5, 1.0)
            limit = strength * (MAX_TRACTION if next_speed > speed else MAX_BRAKING)
            span = _shortest_span(self.speed_change_time, 2.0, math.inf, start, abs(next_speed - speed), limit)
            t = round(start + span, 2)
            points += [(start, speed), (t, next_speed)]
            speed, start = next_speed, round(t + _between(rng, 1.0, 6.0), 2)
        curve = Knots(points=(*points, (t + 1.0, speed)), method="pchip")
        self.speed[:] = curve.at(self.t)
        return curve

    def speed_change_time(self, span: float, start: float, change: float, limit: float) -> float:
        """Duration (s) that a speed change (m/s) needs, given the lowest friction within `span` (s); limit: m/s^2."""
        return _SMOOTHSTEP_SLOPE * change / min(limit, MAX_LONGITUDINAL_SHARE * self.grip(start, span))

    def draw_curves(self) -> list[LaneChange]:
        """Draw curves: lateral moves like lane changes but wider, within friction and heading."""
        rng = self.random(_CURVES)
        curves: list[LaneChange] = []
        start = _between(rng, 1.0, 8.0)
        while start < self.duration:
            span, share = _between(rng, *CURVE_TIME), rng.uniform(*self.demand)
            heading_share, side = rng.uniform(*CURVE_HEADING_SHARE), _side(rng)
            during = _window(start, span)
            width = min(
                share * self.grip(start, span) * (span * span) / shapes.QUINTIC_PEAK,
                heading_share * self.slope * float(self.speed[during].min()) * span / shapes.QUINTIC_SLOPE,
            )
            width = math.floor(100.0 * width) / 100.0
            curves.append(LaneChange(amplitude=side * width, start=start, duration=span))
            self.curve_acceleration[during] = shapes.QUINTIC_PEAK * width / (span * span)
            self.curve_velocity[during] = shapes.QUINTIC_SLOPE * width / span
            start = round(start + span + _between(rng, 1.0, 12.0), 2)
        return curves

    def draw_lane_changes(self) -> list[LaneChange]:
        """Draw the lane changes that fit into the friction and heading left by the curves."""
        rng = self.random(_CHANGES)
        changes: list[LaneChange] = []
        start = _between(rng, 1.0, 6.0)
        while start < self.duration:
            width, share, side = _between(rng, *self.widths), rng.uniform(*self.demand), _side(rng)
            span = _shortest_span(self.lane_change_time, SHORTEST_LANE_CHANGE, LONGEST_LANE_CHANGE, start, width, share)
            if span <= LONGEST_LANE_CHANGE:
                changes.append(LaneChange(amplitude=side * width, start=start, duration=span))
                start += span
            start = round(start + _between(rng, 1.0, 8.0), 2)
        return changes

    def lane_change_time(self, span: float, start: float, width: float, share: float) -> float:
        """Duration (s) that a lane change of `width` (m) needs, given friction, speed and curves within `span` (s)."""
        during = _window(start, span)
        acceleration = share * self.grip(start, span) - self.curve_acceleration[during].max()
        rate = self.slope * self.speed[during].min() - self.curve_velocity[during].max()
        if min(acceleration, rate) <= 0.0:
            return math.inf
        return max(math.sqrt(shapes.QUINTIC_PEAK * width / acceleration), shapes.QUINTIC_SLOPE * width / rate)

    def draw_wind(self, limit: float) -> Shape:
        """Draw a steady lateral wind and gusts; the total wind never exceeds `limit` (m/s) to either side."""
        rng = self.random(_WIND)
        steady = _between(rng, -limit / 3.0, limit / 3.0)
        terms: list[Shape] = [Constant(value=steady)]
        start = _between(rng, 1.0, 10.0)
        while start < self.duration and limit > 0.0:
            span, peak = _between(rng, 1.0, 4.0), _side(rng) * _between(rng, 0.3 * limit, limit)
            terms.append(Gust(peak=round(peak - steady, 6), start=start, duration=span))
            start = round(start + span + _between(rng, 2.0, 12.0), 2)
        return Sum(terms=tuple(terms))


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a number between `low` and `high`, rounded to two decimals and clamped to the limits."""
    return min(max(round(rng.uniform(low, high), 2), low), high)


def _side(rng: np.random.Generator) -> float:
    """Draw a side: 1 for left or -1 for right."""
    return 1.0 if rng.random() < 0.5 else -1.0


def _window(start: float, span: float) -> slice:
    """Indices from the last instant before `start` to the first instant after `start + span` (s)."""
    return slice(max(0, math.floor(start / _STEP)), math.ceil((start + span) / _STEP) + 1)


def _shortest_span(needed: Callable[..., float], shortest: float, longest: float, *arguments: float) -> float:
    """Shortest duration (s), in steps of 0.01 s from `shortest`, that is at least ``needed(duration, *arguments)``.

    A longer manoeuvre may meet lower friction, and then needs even more time. The search therefore repeats until the
    tried duration is at least the needed one. A result above `longest` means that no duration is long enough.
    """
    span = shortest
    while span <= longest and (needed_span := needed(span, *arguments)) > span:
        span = math.ceil(100.0 * needed_span) / 100.0 if needed_span < longest else math.inf
    return span
