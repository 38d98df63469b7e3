"""The elements of a centre line: straight line, circular arc, clothoid and parametric cubic.

An element begins at its own origin and heads along its own x axis (a cubic where its coefficients say); y points to
the left. Lengths in m, curvatures in 1/m, positive to the left. Where a road is made of elements, each is laid at the
end of the one before it, or at its own `start`.
"""

from __future__ import annotations

from typing import Annotated, Literal, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from adaptrack.base.files import Record
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array, product

MIN_ELEMENT_LENGTH, MAX_ELEMENT_LENGTH = 1e-15, 1e6
"""m, of one element."""
Length = Annotated[float, Field(ge=MIN_ELEMENT_LENGTH, le=MAX_ELEMENT_LENGTH, description="m, along the centre line")]
Curvature = Annotated[float, Field(ge=-10.0, le=10.0, description="1/m, positive to the left")]
MAX_COORDINATE = 1e8
"""m, the largest coordinate: all digits down to a micrometre."""

_HALF = np.array(
    [[0.09501250983763744, 0.1894506104550685], [0.2816035507792589, 0.18260341504492358],
     [0.45801677765722737, 0.16915651939500254], [0.6178762444026438, 0.14959598881657674],
     [0.755404408355003, 0.12462897125553388], [0.8656312023878318, 0.09515851168249279],
     [0.9445750230732326, 0.062253523938647894], [0.9894009349916499, 0.027152459411754095]]
)  # fmt: skip
NODES, WEIGHTS = np.concatenate([-_HALF[::-1, 0], _HALF[:, 0]]), np.concatenate([_HALF[::-1, 1], _HALF[:, 1]])
"""Of the quadrature of Gauss and Legendre on [-1, 1], degree 31."""


class Points(NamedTuple):
    """Points of a curve, one entry or array each."""

    x: Array
    """x coordinates (m)."""
    y: Array
    """y coordinates (m)."""
    heading: Array
    """rad, of the tangent; continuous along the curve"""
    curvature: Array
    """1/m, positive to the left"""


class Pose(NamedTuple):
    """Where an element begins."""

    x: float = 0.0
    """x of its start (m)."""
    y: float = 0.0
    """y of its start (m)."""
    heading: float = 0.0
    """Heading at its start (rad)."""


class Placed(Record):
    """Start pose that an element may state."""

    start: tuple[float, float, float] | None = Field(
        default=None, description="x, y (m) and heading (rad) of its origin and axis; none: at the end of the last one"
    )

    @property
    def pose(self) -> Pose | None:
        """Its `start`."""
        return None if self.start is None else Pose(*self.start)


class Line(Placed):
    """A straight line."""

    kind: Literal["line"] = "line"
    length: Length

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvature at the start and at the end (1/m)."""
        return 0.0, 0.0


class Arc(Placed):
    """A circular arc."""

    kind: Literal["arc"] = "arc"
    length: Length
    curvature: Curvature

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvature at the start and at the end (1/m)."""
        return self.curvature, self.curvature


class Clothoid(Placed):
    """A clothoid: its curvature changes in proportion to the arc length."""

    kind: Literal["clothoid"] = "clothoid"
    length: Length
    start_curvature: Curvature
    end_curvature: Curvature

    @property
    def curvatures(self) -> tuple[float, float]:
        """Curvature at the start and at the end (1/m)."""
        return self.start_curvature, self.end_curvature


class Cubic(Placed):
    """A parametric cubic, OpenDRIVE's paramPoly3: x(p), y(p) with four coefficients each, from p = 0 to p = `end`.

    OpenDRIVE's poly3, y(x), is the one with x = p.
    """

    kind: Literal["cubic"] = "cubic"
    x: tuple[float, float, float, float] = Field(description="coefficients of 1, p, p^2, p^3, m")
    y: tuple[float, float, float, float] = Field(description="likewise")
    end: float = Field(default=1.0, gt=0.0, description="the parameter at the end")

    @model_validator(mode="after")
    def _is_no_longer_than_others(self) -> Self:
        """The curve is no longer than the polygon of its control points (Bézier)."""
        p = self.end
        slopes = [(b, b + c * p, b + 2.0 * c * p + 3.0 * d * p * p) for _, b, c, d in (self.x, self.y)]
        reach = sum(p * portable.hypot(dx, dy) / 3.0 for dx, dy in zip(*slopes, strict=True))  # of its three sides
        if not reach <= MAX_ELEMENT_LENGTH:
            raise ValueError(
                f"its control points are {reach:.3g} m apart in all: at most {MAX_ELEMENT_LENGTH:g} m are allowed."
            )
        return self

    @property
    def powers(self) -> Array:
        """(2, 4) m, the coefficients of x and y over a parameter from 0 to 1."""
        return np.array([self.x, self.y]) * np.vander([self.end], 4, increasing=True)


Segment = Annotated[Line | Arc | Clothoid | Cubic, Field(discriminator="kind")]


def heading_integral(k0: ArrayLike, k1: ArrayLike, s: ArrayLike) -> NDArray[np.complex128]:
    """x + i y = integral of exp(i (k0 r + k1 r^2/2)) dr from 0 to s; all three broadcast.

    Gauss-Legendre with 16 nodes on panels that turn by at most 1 rad each: exact to rounding.
    """
    k0, k1, s = np.broadcast_arrays(*(np.asarray(value, dtype=np.float64) for value in (k0, k1, s)))
    turn = np.abs(s) * np.maximum(np.abs(k0), np.abs(k0 + k1 * s))
    panels = max(1, int(np.ceil(turn.max(initial=0.0))))
    total = np.zeros(s.shape, dtype=np.complex128)
    width = s / panels
    for panel in range(panels):
        r = (width * (panel + 0.5))[..., np.newaxis] + 0.5 * width[..., np.newaxis] * NODES
        heading = (k0[..., np.newaxis] + 0.5 * k1[..., np.newaxis] * r) * r
        total.real += 0.5 * width * product(portable.cos(heading), WEIGHTS)
        total.imag += 0.5 * width * product(portable.sin(heading), WEIGHTS)
    return total
