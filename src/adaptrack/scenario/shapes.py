"""Named shapes: scalar functions of time that make up the signals of a scenario; friction and wind made of them.

A shape is a small immutable record:

- in Python, ``LaneChange(amplitude=3.5, start=2.0, duration=4.0)``;
- in a scenario file, ``{ shape = "lane-change", amplitude = 3.5, start = 2.0, duration = 4.0 }``.

A plain number means a `Constant`. Shapes can be added: ``Constant(value=5.0) + Gust(peak=10.0, start=3.0,
duration=2.0)``. Times are in seconds from the start of the scenario. Values have the unit of the signal.
"""

from __future__ import annotations

import itertools
import math
import re
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar, Literal, Self

import numpy as np
from numpy.typing import ArrayLike
from pydantic import BeforeValidator, Field, model_validator

from adaptrack.base.checked import real
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.base.files import LISTED, Record, build
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array

HIGHEST_FRICTION = 3.0
"""Largest accepted friction coefficient. Racing tyres stay below 2; larger inputs are usually percentages."""

Method = Literal["linear", "pchip", "cubic"]
"""Interpolation between the points of `Knots`."""

Time = Annotated[float, Field(description="s")]
PositiveTime = Annotated[float, Field(gt=0.0, description="s")]
Frequency = Annotated[float, Field(ge=0.0, description="Hz")]


class Shape(Record):
    """A scalar function of time, defined at every time.

    A subclass defines `kind` (its name in files) and `at`. The function is linear in the fields listed in `linear_in`.
    """

    kind: ClassVar[str]
    linear_in: ClassVar[tuple[str, ...]] = ()

    @abstractmethod
    def at(self, t: ArrayLike) -> Array:
        """Return the values at the times `t` (s) as an array of the shape of `t`; at a jump, the value after it."""

    def scaled(self, factor: float) -> Self:
        """Return the function of time multiplied by `factor`."""
        return self.replace(**{name: _product(factor, getattr(self, name)) for name in self.linear_in})

    def table(self) -> Any:
        """Return the table of a scenario file for this shape; `as_shape` converts it back."""
        return {"shape": self.kind} | self.model_dump(mode="json", exclude_defaults=True)

    def __add__(self, other: Shape | float) -> Sum:
        return Sum(terms=(self, as_shape(other)))


def as_shape(value: Any) -> Shape:
    """Convert a number (to a constant) or a table of a scenario file to a shape; a shape is returned as it is.

    Raises InvalidInput when the value describes no shape; the message suggests the most similar shape or key.
    """
    if isinstance(value, Shape):
        return value
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        return Constant(value=real("constant", "value", value))
    if not isinstance(value, Mapping):
        raise InvalidInput("give a number, or a table such as { shape = 'step', after = 2.0, time = 1.0 }.")
    kind = value.get("shape")
    if kind is None:
        raise InvalidInput(f"the table has no key 'shape'; give one of {', '.join(map(repr, SHAPE_TYPES))}.")
    if kind not in SHAPE_TYPES:
        raise UnknownName(f"unknown shape {kind!r}. {did_you_mean(str(kind), SHAPE_TYPES)}")
    return build(SHAPE_TYPES[kind], {key: entry for key, entry in value.items() if key != "shape"}, f"shape {kind!r}")


Signal = Annotated[Shape, BeforeValidator(as_shape)]
"""Type of a field that holds a shape and accepts every value that `as_shape` converts."""


class Constant(Shape):
    """Constant ``value`` at all times."""

    kind = "constant"
    linear_in = ("value",)

    value: float

    def at(self, t: ArrayLike) -> Array:
        return np.full(np.shape(t), self.value)

    def table(self) -> float:
        """Return the plain number that stands for this shape in a scenario file."""
        return self.value


@dataclass(frozen=True, eq=False)  # `Knots` hold it as a cache, which must not count when they are compared
class _Curve:
    """Points (n,) of `Knots` as arrays, and the slopes (n,) of a smooth curve at these points."""

    t: Array
    y: Array
    slope: Array


class Knots(Shape):
    """Curve through ``points = [[t, value], ...]``; constant before the first point and after the last.

    ``method`` is the interpolation between the points:

    * ``"linear"``: straight lines;
    * ``"pchip"``: monotone cubics with continuous slope, no overshoot (F. N. Fritsch, J. Butland, SIAM J. Sci. Stat.
      Comput. 5, 1984; end slopes after C. Moler, Numerical Computing with MATLAB, 2004, section 3.6);
    * ``"cubic"``: the natural cubic spline with continuous slope and curvature, and zero curvature at both ends (C. de
      Boor, A Practical Guide to Splines, 1978, chapter IV).
    """

    kind = "knots"

    points: Annotated[tuple[tuple[float, float], ...], LISTED]
    method: Method = "linear"

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        if not self.points:
            raise InvalidInput("'points' is empty; give at least one [t, value].")
        for k, ((earlier, _), (later, _)) in enumerate(itertools.pairwise(self.points)):
            if not later > earlier:
                raise InvalidInput(
                    f"points[{k + 1}] is at t = {later!r}, points[{k}] at t = {earlier!r}: the times must increase."
                )
        return self

    @cached_property
    def _curve(self) -> _Curve:
        t, y = np.array(self.points, dtype=np.float64).T.copy()
        if t.size == 1 or self.method == "linear":
            return _Curve(t, y, np.zeros(t.size))
        step = np.diff(t)
        slopes = _natural_slopes if self.method == "cubic" else _monotone_slopes
        return _Curve(t, y, slopes(step, np.diff(y) / step))

    def at(self, t: ArrayLike) -> Array:
        knot_times, y, slope = self._curve.t, self._curve.y, self._curve.slope
        inside: Array = np.clip(np.asarray(t, dtype=np.float64), knot_times[0], knot_times[-1])
        if self.method == "linear" or knot_times.size == 1:
            return np.asarray(np.interp(inside, knot_times, y))
        k = np.clip(np.searchsorted(knot_times, inside, side="right") - 1, 0, knot_times.size - 2)
        step = knot_times[k + 1] - knot_times[k]
        s = (inside - knot_times[k]) / step
        r = 1.0 - s
        return (
            r * r * (1.0 + 2.0 * s) * y[k]
            + s * s * (3.0 - 2.0 * s) * y[k + 1]
            + s * r * step * (r * slope[k] - s * slope[k + 1])
        )

    def scaled(self, factor: float) -> Self:
        """Return the curve with every value multiplied by `factor`."""
        return self.replace(points=tuple((t, _product(factor, value)) for t, value in self.points))


class Step(Shape):
    """Step from ``before`` to ``after`` at ``time`` (s)."""

    kind = "step"
    linear_in = ("before", "after")

    before: float = 0.0
    after: float
    time: Time

    def at(self, t: ArrayLike) -> Array:
        return np.where(np.asarray(t, dtype=np.float64) >= self.time, self.after, self.before)


QUINTIC_SLOPE, QUINTIC_PEAK = 15.0 / 8.0, 10.0 / math.sqrt(3.0)
"""Steepest slope and largest acceleration of a `LaneChange` of unit amplitude and duration."""


class LaneChange(Shape):
    """A smooth step from 0 to ``amplitude`` between ``start`` and ``start + duration``.

    The value is A s³(10 − 15 s + 6 s²), where s rises from 0 to 1 over the duration T. This quintic has zero slope and
    curvature at both ends and the least jerk (T. Flash, N. Hogan, J. Neuroscience 5, 1985). Its steepest slope is
    1.875 A/T at half time. Its largest acceleration is 10/√3 A/T² = 5.77 A/T².
    """

    kind = "lane-change"
    linear_in = ("amplitude",)

    amplitude: float
    start: Time
    duration: PositiveTime

    def at(self, t: ArrayLike) -> Array:
        s = _elapsed(t, self.start, self.duration)
        return self.amplitude * (s * s * s) * (10.0 + s * (6.0 * s - 15.0))


class TanhSteps(Shape):
    """Smooth steps of height A at t0: the sum of A/2 (1 + tanh((t − t0)/τ)) over ``steps = [[A, t0, tau], ...]``."""

    kind = "tanh-steps"

    steps: Annotated[
        tuple[tuple[float, float, PositiveTime], ...], LISTED, Field(min_length=1, description="[A, t0, tau]")
    ]

    def at(self, t: ArrayLike) -> Array:
        amplitude, centre, tau = np.array(self.steps, dtype=np.float64).T
        scaled_time = (np.asarray(t, dtype=np.float64)[..., np.newaxis] - centre) / tau
        return (0.5 * amplitude * (1.0 + portable.tanh(scaled_time))).sum(axis=-1)

    def scaled(self, factor: float) -> Self:
        """Return the steps with every height multiplied by `factor`."""
        return self.replace(steps=tuple((_product(factor, height), t0, tau) for height, t0, tau in self.steps))


class Sine(Shape):
    """``amplitude`` sin(2π ``frequency`` (t − ``start``) + ``phase``) from ``start`` on, 0 before; phase in radians."""

    kind = "sine"
    linear_in = ("amplitude",)

    amplitude: float
    frequency: Frequency
    phase: Annotated[float, Field(description="rad")] = 0.0
    start: Time = 0.0

    def at(self, t: ArrayLike) -> Array:
        elapsed = np.asarray(t, dtype=np.float64) - self.start
        wave = self.amplitude * portable.sin(math.tau * self.frequency * elapsed + self.phase)
        return np.where(elapsed >= 0.0, wave, 0.0)


class Gust(Shape):
    """One 1-cosine gust: ``peak``/2 (1 − cos(2π (t − ``start``)/``duration``)), 0 before and after.

    It is the discrete gust of the airworthiness rules (EASA CS-25.341), as a function of time instead of distance.
    """

    kind = "gust"
    linear_in = ("peak",)

    peak: float
    start: Time
    duration: PositiveTime

    def at(self, t: ArrayLike) -> Array:
        s = _elapsed(t, self.start, self.duration)
        return 0.5 * self.peak * (1.0 - portable.cos(math.tau * s))


def _as_terms(value: Any) -> Any:
    if not isinstance(value, list | tuple):
        raise InvalidInput("give a list of shapes.")
    return tuple(as_shape(term) for term in value)


class Sum(Shape):
    """The sum of its ``terms``, each a number or a shape."""

    kind = "sum"

    terms: Annotated[tuple[Shape, ...], BeforeValidator(_as_terms), Field(min_length=1)]

    def at(self, t: ArrayLike) -> Array:
        return np.sum([term.at(t) for term in self.terms], axis=0)

    def scaled(self, factor: float) -> Self:
        """Return the sum with every term multiplied by `factor`."""
        return self.replace(terms=tuple(term.scaled(factor) for term in self.terms))

    def table(self) -> Any:
        """Return the table of a scenario file, which lists the tables of the terms."""
        return {"shape": self.kind, "terms": [term.table() for term in self.terms]}


SHAPE_TYPES: dict[str, type[Shape]] = {
    shape.kind: shape for shape in (Constant, Knots, Step, LaneChange, TanhSteps, Sine, Gust, Sum)
}
"""The shapes by their names in scenario files."""


# -- friction and wind -----------------------------------------------------------------------------------------------
WHEELS = {
    "all": (0, 1, 2, 3),
    "left": (0, 2),
    "right": (1, 3),
    "front": (0, 1),
    "rear": (2, 3),
    "front-left": (0,),
    "front-right": (1,),
    "rear-left": (2,),
    "rear-right": (3,),
}
"""Columns of `Signals.friction` by name."""


class Wind(Record):
    """Wind velocity in the world frame (m/s): ``x`` along +X (forward at the start), ``y`` along +Y (left).

    Wind from the right has ``y`` > 0. The lateral wind v_w of the paper is ``y``.
    """

    x: Signal = Constant(value=0.0)
    y: Signal = Constant(value=0.0)

    def at(self, t: ArrayLike) -> Array:
        """Return the wind velocities (..., 2) in m/s at the times `t` (s)."""
        return np.stack([self.x.at(t), self.y.at(t)], axis=-1)

    def mirrored(self) -> Wind:
        """Return the wind with left and right exchanged."""
        return self.replace(y=self.y.scaled(-1.0))

    def table(self) -> Any:
        """Return the entry of a scenario file for this wind."""
        if self.x == Constant(value=0.0):
            return self.y.table()
        return {"x": self.x.table(), "y": self.y.table()}


def as_wind(value: Any) -> Wind:
    """Convert a lateral wind (number or shape), a pair [x, y] or a table {x, y} to a `Wind`."""
    if isinstance(value, Wind):
        return value
    if isinstance(value, Mapping) and "shape" not in value:
        return build(Wind, value, "wind")
    if isinstance(value, list | tuple):
        if len(value) != 2:
            raise InvalidInput("wind: give one lateral wind, or the pair [x, y].")
        return Wind(x=as_shape(value[0]), y=as_shape(value[1]))
    return Wind(y=as_shape(value))


def as_friction(value: Any) -> tuple[Shape, ...]:
    """Convert one friction for all wheels, [left, right] or one per wheel to a tuple of shapes."""
    if not isinstance(value, list | tuple):
        return (as_shape(value),)
    if len(value) not in (1, 2, 4):
        raise InvalidInput("give one value, [left, right], or [front-left, front-right, rear-left, rear-right].")
    return tuple(as_shape(shape) for shape in value)


class Patch(Record):
    """Different friction under the named ``wheels`` from time ``start`` until time ``end`` (s)."""

    start: Annotated[float, Field(description="s")]
    end: Annotated[float, Field(description="s")]
    friction: Annotated[float, Field(gt=0.0, le=HIGHEST_FRICTION)]
    wheels: Literal["all", "left", "right", "front", "rear", "front-left", "front-right", "rear-left", "rear-right"] = (
        "all"
    )

    @model_validator(mode="after")
    def _check_times(self) -> Self:
        if not self.end > self.start:
            raise InvalidInput(f"the patch ends at {self.end!r} s; it must end after its start at {self.start!r} s.")
        return self

    def mirrored(self) -> Patch:
        """Return the patch with left and right exchanged."""
        swap = {"left": "right", "right": "left"}
        return self.replace(wheels=re.sub("left|right", lambda side: swap[side[0]], self.wheels))


def as_patches(value: Any) -> tuple[Patch, ...]:
    """Convert a list of tables to a tuple of patches."""
    if not isinstance(value, list | tuple):
        raise InvalidInput("give a list of patches.")
    return tuple(patch if isinstance(patch, Patch) else build(Patch, patch, "patch") for patch in value)


# -- curves -----------------------------------------------------------------------------------------------------------
def _elapsed(t: ArrayLike, start: float, duration: float) -> Array:
    """Elapsed share of the time from `start` to `start + duration` at `t`, limited to 0 before and 1 after."""
    return np.clip((np.asarray(t, dtype=np.float64) - start) / duration, 0.0, 1.0)


def _product(factor: float, value: float) -> float:
    return factor * value + 0.0  # never -0.0


def _natural_slopes(step: Array, secant: Array) -> Array:
    """Slopes of the natural cubic spline at its n + 1 knots, from n interval lengths and secant slopes.

    The curvature is continuous at each inner knot and zero at both ends. This gives a tridiagonal system, solved by
    elimination.
    """
    n = step.size
    below = np.append(step[1:], 1.0)
    above = np.insert(step[:-1], 0, 1.0)
    diagonal = np.concatenate([[2.0], 2.0 * (step[:-1] + step[1:]), [2.0]])
    right = 3.0 * np.concatenate([secant[:1], step[1:] * secant[:-1] + step[:-1] * secant[1:], secant[-1:]])
    for k in range(1, n + 1):
        ratio = below[k - 1] / diagonal[k - 1]
        diagonal[k] -= ratio * above[k - 1]
        right[k] -= ratio * right[k - 1]
    slope = right / diagonal
    for k in range(n - 1, -1, -1):
        slope[k] -= above[k] * slope[k + 1] / diagonal[k]
    return slope


def _monotone_slopes(step: Array, secant: Array) -> Array:
    """Slopes for which each cubic is monotone between its knots: weighted harmonic means of adjacent secant slopes."""
    if step.size == 1:
        return np.repeat(secant, 2)
    left, right = secant[:-1], secant[1:]
    same_sign = left * right > 0.0
    weight_left, weight_right = step[:-1] + 2.0 * step[1:], 2.0 * step[:-1] + step[1:]
    safe_left, safe_right = np.where(same_sign, left, 1.0), np.where(same_sign, right, 1.0)
    mean = (weight_left + weight_right) / (weight_left / safe_left + weight_right / safe_right)
    ends = [_end_slope(*step[:2], *secant[:2]), _end_slope(*step[:-3:-1], *secant[:-3:-1])]
    return np.concatenate([ends[:1], np.where(same_sign, mean, 0.0), ends[1:]])


def _end_slope(h0: float, h1: float, secant0: float, secant1: float) -> float:
    """Three-point slope at an end knot, limited so that the curve stays monotone there."""
    slope = ((2.0 * h0 + h1) * secant0 - h0 * secant1) / (h0 + h1)
    if slope * secant0 <= 0.0:
        return 0.0
    if secant0 * secant1 <= 0.0 and abs(slope) > 3.0 * abs(secant0):
        return 3.0 * secant0
    return float(slope)
