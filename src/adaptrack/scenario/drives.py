"""Random drives: minutes of mixed driving on roads that nobody tuned or trained on, and that a car can follow.

Speed, friction, curves, lane changes and wind are drawn one after the other, each from random numbers of its own. A
manoeuvre is sized by what the drive leaves it: the lowest friction and speed that it will meet, less what the curve
under it takes. So a controller that loses a drive does so by its own fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import RISING, Hint, Natural, NotNegative, Positive, checked
from adaptrack.cars.domain import Domain
from adaptrack.core.plants.forces import GRAVITY
from adaptrack.scenario.scenario import Scenario
from adaptrack.scenario.shapes import QUINTIC_PEAK, QUINTIC_SLOPE, Constant, Gust, Knots, LaneChange, Shape, Step, Sum
from adaptrack.scenario.signals import HIGHEST_FRICTION
from adaptrack.scenario.surroundings import Wind

Array = NDArray[np.float64]

DESCRIPTION = "Mixed driving: changing speed and friction, curves, lane changes, wind and gusts."

LONGEST_DRIVE = 86_400.0
"""s"""

MAX_TRACTION, MAX_BRAKING = 2.0, 3.0
"""Largest acceleration and deceleration along the road, m/s^2."""

GRIP_ALONG = 0.5
"""Largest share of the friction that changes of speed ask for."""

DRY_SHARE = 0.25
"""Share of the drives whose friction keeps to the highest 30 % of its range."""

PASSENGER_CAR_DOMAIN = Domain()
"""Speeds, friction, wind and lanes of the roads that passenger cars drive."""

CHANGE_WIDTH = (2.0, 12.0)
"""Amplitudes of lane changes, in sevenths of the width of a lane: 1 to 6 m where it is 3.5 m."""

SHORTEST_CHANGE, LONGEST_CHANGE = 2.0, 12.0
"""Durations of lane changes, s; one that would need longer is not driven."""

CURVE_TIME = (5.0, 14.0)
"""Durations of curves, s."""

CURVE_HEADING = (0.3, 0.8)
"""Shares of the largest heading that curves may take; the rest is for the lane changes in them."""

EDGE = 0.5
"""How long before and after a step of friction the lower side counts, s."""

_SMOOTHSTEP_SLOPE = 1.5  # steepest slope of a cubic between two level stretches, of unit height and duration
_STEP = 0.05  # s, between the instants at which a drive is known while it is made
_FRICTION, _SPEED, _CURVES, _CHANGES, _WIND = range(5)  # what random numbers are for


_Friction = Annotated[Positive, Field(le=HIGHEST_FRICTION)]
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

    A seed gives the same drive on every machine. Drives of one duration have equally many samples. The reference is
    twice continuously differentiable.

    Parameters
    ----------
    seed : int
        Which drive.
    duration : float
        A longer drive is another drive, not the continuation of a shorter one.
    speed : (float, float)
        Lowest and highest speed. It changes smoothly between level stretches, by at most 2 m/s^2 up, 3 m/s^2 down
        and half the friction.
    friction : (float, float)
        Lowest and highest coefficient. It steps every 10 s on average; a quarter of the drives are dry: they keep to
        the highest 30 % of the range.
    wind : float
        Largest lateral wind: a steady one of at most a third of it, and gusts to either side.
    demand : (float, float)
        Every curve and lane change draws a share from this range. Its lateral acceleration d²y_ref/dt², for a lane
        change together with that of the curves under it, never exceeds this share of what the lowest friction during
        the manoeuvre allows.
    heading : float
        Largest heading of the reference, asin(dy_ref/dt / speed).
    lane_width : float
        Lane changes are 2/7 to 12/7 of it.

    A car's own ranges: ``random_drive(7, **car.domain.drive_options)``.
    """
    options: dict[str, Any] = {"speed": speed, "friction": friction, "wind": wind, "demand": demand, "heading": heading}
    if lane_width != PASSENGER_CAR_DOMAIN.lane_width:
        options["lane_width"] = lane_width
    drive = _Drive(seed, duration, demand, (heading, lane_width))
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


class _Drive:
    """A drive in the making: what is known of it at the instants k·_STEP, and what the manoeuvres may still claim."""

    def __init__(
        self, seed: int, duration: float, demand: tuple[float, float], room: tuple[float, float]
    ) -> None:  # fmt: skip
        """room: largest heading (rad), width of a lane (m)."""
        self.seed, self.duration, self.demand, self.slope = seed, duration, demand, math.sin(room[0])
        self.widths = tuple(sevenths * room[1] / 7.0 for sevenths in CHANGE_WIDTH)
        self.t = _STEP * np.arange(math.ceil(duration / _STEP) + 1)
        self.friction, self.speed = np.empty_like(self.t), np.empty_like(self.t)
        self.curve_acceleration, self.curve_rate = np.zeros_like(self.t), np.zeros_like(self.t)

    def random(self, purpose: int) -> np.random.Generator:
        """The random numbers for one purpose: other options elsewhere do not shift them."""
        return np.random.default_rng((self.seed, purpose))

    def grip(self, start: float, span: float) -> float:
        """The acceleration that the lowest friction between `start` and `start + span` allows, m/s^2."""
        return GRAVITY * float(self.friction[_window(start - EDGE, span + 2.0 * EDGE)].min())

    def draw_friction(self, low: float, high: float) -> Shape:
        """Friction in steps, under all wheels."""
        rng = self.random(_FRICTION)
        if rng.random() < DRY_SHARE:
            low = high - 0.3 * (high - low)
        level = _between(rng, low, high)
        terms: list[Shape] = [Constant(value=level)]
        start = _between(rng, 2.0, 14.0)
        while start < self.duration:
            then = _between(rng, low, high)
            terms.append(Step(after=round(then - level, 6), time=start))
            level, start = then, round(start + _between(rng, 4.0, 16.0), 2)
        steps = Sum(terms=tuple(terms))
        self.friction[:] = steps.at(self.t)
        return steps

    def draw_speed(self, low: float, high: float) -> Shape:
        """Level stretches, joined by cubics."""
        rng = self.random(_SPEED)
        speed = _between(rng, low, high)
        t, start, points = 0.0, _between(rng, 1.0, 6.0), [(0.0, speed)]
        while start < self.duration:
            then, strength = _between(rng, low, high), rng.uniform(0.5, 1.0)
            most = strength * (MAX_TRACTION if then > speed else MAX_BRAKING)
            t = round(start + _shortest(self.speed_time, 2.0, math.inf, start, abs(then - speed), most), 2)
            points += [(start, speed), (t, then)]
            speed, start = then, round(t + _between(rng, 1.0, 6.0), 2)
        curve = Knots(points=(*points, (t + 1.0, speed)), method="pchip")
        self.speed[:] = curve.at(self.t)
        return curve

    def speed_time(self, span: float, start: float, change: float, most: float) -> float:
        """How long a change of speed must last when it meets what lies within `span`, s."""
        return _SMOOTHSTEP_SLOPE * change / min(most, GRIP_ALONG * self.grip(start, span))

    def draw_curves(self) -> list[LaneChange]:
        """The road turns aside and back again: wide lane changes, as far as friction and heading allow."""
        rng = self.random(_CURVES)
        curves: list[LaneChange] = []
        start = _between(rng, 1.0, 8.0)
        while start < self.duration:
            span, share = _between(rng, *CURVE_TIME), rng.uniform(*self.demand)
            turn, side = rng.uniform(*CURVE_HEADING), _side(rng)
            during = _window(start, span)
            width = min(
                share * self.grip(start, span) * span**2 / QUINTIC_PEAK,
                turn * self.slope * float(self.speed[during].min()) * span / QUINTIC_SLOPE,
            )
            width = math.floor(100.0 * width) / 100.0
            curves.append(LaneChange(amplitude=side * width, start=start, duration=span))
            self.curve_acceleration[during] = QUINTIC_PEAK * width / span**2
            self.curve_rate[during] = QUINTIC_SLOPE * width / span
            start = round(start + span + _between(rng, 1.0, 12.0), 2)
        return curves

    def draw_lane_changes(self) -> list[LaneChange]:
        """Lane changes in what the curves leave of friction and heading; where that is too little, there is none."""
        rng = self.random(_CHANGES)
        changes: list[LaneChange] = []
        start = _between(rng, 1.0, 6.0)
        while start < self.duration:
            width, share, side = _between(rng, *self.widths), rng.uniform(*self.demand), _side(rng)
            span = _shortest(self.lane_change_time, SHORTEST_CHANGE, LONGEST_CHANGE, start, width, share)
            if span <= LONGEST_CHANGE:
                changes.append(LaneChange(amplitude=side * width, start=start, duration=span))
                start += span
            start = round(start + _between(rng, 1.0, 8.0), 2)
        return changes

    def lane_change_time(self, span: float, start: float, width: float, share: float) -> float:
        """How long a lane change must last when it meets what lies within `span`, s."""
        during = _window(start, span)
        acceleration = share * self.grip(start, span) - self.curve_acceleration[during].max()
        rate = self.slope * self.speed[during].min() - self.curve_rate[during].max()
        if min(acceleration, rate) <= 0.0:
            return math.inf
        return max(math.sqrt(QUINTIC_PEAK * width / acceleration), QUINTIC_SLOPE * width / rate)

    def draw_wind(self, limit: float) -> Shape:
        """A steady lateral wind and gusts; the wind at the peak of a gust is up to `limit` to either side."""
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
    """A number between two, with two decimals unless one of the two has more."""
    return min(max(round(rng.uniform(low, high), 2), low), high)


def _side(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _window(start: float, span: float) -> slice:
    """The known instants from the last one before `start` to the first one after `start + span`."""
    return slice(max(0, math.floor(start / _STEP)), math.ceil((start + span) / _STEP) + 1)


def _shortest(needed: Callable[..., float], least: float, most: float, *arguments: float) -> float:
    """The shortest time in whole 0.01 s, at least `least`, that is as long as it needs to be; or one above `most`.

    What is ``needed(time, *arguments)`` grows with the time, for a longer manoeuvre meets lower friction.
    """
    span = least
    while span <= most and (needed_span := needed(span, *arguments)) > span:
        span = math.ceil(100.0 * needed_span) / 100.0 if needed_span < most else math.inf
    return span
