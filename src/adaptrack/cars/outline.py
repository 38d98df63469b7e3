"""The outline of a car's body from above: a rectangle about the centre of mass, and where its corners are.

ISO 8855 axes: x forward, y left. The corners come in the order front left, front right, rear left, rear right.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Positive, checked, reals
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array


@checked
@dataclass(frozen=True, repr=False)
class Outline:
    """The rectangle that the body fills in plan view."""

    front: Annotated[Positive, "m"]
    """centre of mass to the front end"""
    rear: Annotated[Positive, "m"]
    """centre of mass to the rear end"""
    width: Annotated[Positive, "m"]
    """without mirrors"""
    estimated: tuple[str, ...] = ()
    """which of length, front_overhang and width no source gave"""

    def __repr__(self) -> str:
        dimensions = f"front={self.front:.3f} m, rear={self.rear:.3f} m, width={self.width:.3f} m"
        guess = f"; estimated from wheelbase and track: {', '.join(self.estimated)}" if self.estimated else ""
        return f"Outline({dimensions}{guess})"

    @property
    def length(self) -> float:
        """Overall length (m)."""
        return self.front + self.rear

    @property
    def corners(self) -> Array:
        """(4, 2) m, in body axes."""
        half = 0.5 * self.width
        return np.array([[self.front, half], [self.front, -half], [-self.rear, half], [-self.rear, -half]])

    def corners_at(self, x: ArrayLike, y: ArrayLike, yaw: ArrayLike) -> Array:
        """The corners in the world, (..., 4, 2) m, of a centre of mass at x, y (m) with a yaw angle (rad)."""
        x, y, yaw = np.broadcast_arrays(*(reals("corners_at", coordinate) for coordinate in (x, y, yaw)))
        ahead, left = self.corners.T
        sine, cosine = portable.sin(yaw)[..., None], portable.cos(yaw)[..., None]
        return np.stack(
            [x[..., None] + ahead * cosine - left * sine, y[..., None] + ahead * sine + left * cosine], axis=-1
        )

    def corner_offsets(self, offset: ArrayLike, heading_error: ArrayLike, curvature: ArrayLike = 0.0) -> Array:
        """Lateral offsets of the corners from a path, (..., 4) m, positive to the left.

        offset: m, of the centre of mass; heading_error: rad, yaw less the heading of the path at its foot; curvature:
        1/m, of the path there. With a and b the corner's distances along and across the path from the foot, the offset
        from the circle of curvature k is (2 b - k (a^2 + b^2))/(1 + sqrt((k a)^2 + (1 - k b)^2)): exact on straight
        lines and arcs, off by the change of curvature within half a car length elsewhere.
        """
        e, turn, k = (reals("corner_offsets", values)[..., None] for values in (offset, heading_error, curvature))
        ahead, left = self.corners.T
        along = ahead * portable.cos(turn) - left * portable.sin(turn)
        across = e + ahead * portable.sin(turn) + left * portable.cos(turn)
        return (2.0 * across - k * (along * along + across * across)) / (
            1.0 + portable.hypot(k * along, 1.0 - k * across)
        )
