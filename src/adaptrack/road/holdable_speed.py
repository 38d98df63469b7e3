"""How fast, and how hard braking, a car can be held on a bend by its controller: a table that a plan asks."""

from __future__ import annotations

from functools import cached_property
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field, model_validator

from adaptrack.base.files import LISTED, Record
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.physics.forces import GRAVITY

_Axis = Annotated[tuple[float, ...], LISTED, Field(min_length=2)]
BEND_SPEEDS = 96
"""Speeds at which a bend is looked at."""
MAX_BRAKING_SLOPE = 3.0
"""By which braking falls with the lateral acceleration where the reserve of the cornering begins."""


class HoldableSpeed(Record):
    """Up to which braking the margins of a controller hold, by speed, lateral acceleration and friction.

    Lateral accelerations are shares of what the car can corner with (`road.speed`), decelerations of mu g.
    `adaptrack.analysis.holdable` makes it; `plan_speed` keeps it. Between its nodes it is linear, beyond them constant.
    """

    vehicle: str = Field(min_length=1, description="name of the car")
    profile: str = Field(min_length=1, description="name of the profile")
    steering: str = Field(default="", description="of the car, as it was analysed")
    reserve: float = Field(default=0.0, ge=0.0, description="m/s^2, that a bend leaves of the cornering at least")
    longest: float = Field(gt=0.0, description="s, for which an instability counts at most, as braking ends")
    speeds: _Axis = Field(description="m/s")
    sideways: _Axis = Field(description="-, lateral acceleration that the tyres feel, over the largest of the car")
    frictions: _Axis = Field(description="-")
    cornering: _Axis = Field(description="m/s^2, the largest lateral acceleration of the car, by friction")
    braking: Annotated[tuple[tuple[tuple[float, ...], ...], ...], LISTED] = Field(
        description="-, deceleration over mu g up to which the margins hold, by friction, speed and sideways; "
        "below 0: not without braking either"
    )

    @model_validator(mode="after")
    def _has_a_value_at_every_node(self) -> HoldableSpeed:
        for name in ("speeds", "sideways", "frictions", "cornering"):
            if not (np.diff(getattr(self, name)) > 0.0).all():
                raise ValueError(f"{name}: must rise.")
        shape = (len(self.frictions), len(self.speeds), len(self.sideways))
        if len(self.cornering) != shape[0]:
            raise ValueError(f"cornering: must have {shape[0]} values.")
        if {len(self.braking), *(len(plane) for plane in self.braking)} - {shape[0], shape[1]} or any(
            len(row) != shape[2] for plane in self.braking for row in plane
        ):
            raise ValueError(f"braking: must have {shape[0]} x {shape[1]} x {shape[2]} values.")
        return self

    @cached_property
    def _table(self) -> Array:
        return np.array(self.braking)

    def deceleration(self, speed: ArrayLike, lateral: ArrayLike, friction: ArrayLike) -> Array:
        """Deceleration (m/s^2) up to which the margins hold; below 0: not without braking either.

        speed: m/s; lateral: m/s^2, that the tyres feel; friction: -; of shapes that fit each other.
        """
        v, a, mu = np.broadcast_arrays(*(np.asarray(values, float) for values in (speed, np.abs(lateral), friction)))
        most = np.interp(mu, self.frictions, self.cornering)
        (i, p), (j, q), (k, r) = (
            _place(axis, x) for axis, x in ((self.frictions, mu), (self.speeds, v), (self.sideways, a / most))
        )
        decelerations = np.zeros(v.shape)
        for di, wi in ((0, 1.0 - p), (1, p)):
            for dj, wj in ((0, 1.0 - q), (1, q)):
                for dk, wk in ((0, 1.0 - r), (1, r)):
                    decelerations += wi * wj * wk * self._table[i + di, j + dj, k + dk]
        return np.minimum(decelerations * mu * GRAVITY, MAX_BRAKING_SLOPE * (most - self.reserve - a))

    def along(self, curvature: ArrayLike, bank: ArrayLike, friction: ArrayLike) -> tuple[Array, Array]:
        """Squared speeds (m,), and at each of them the deceleration (n, m) that is held at n places.

        curvature: (n,) 1/m; bank: (n,) rad; friction: (n,). No more is held at a higher speed than at a lower one.
        """
        k, tilt, mu = (np.atleast_1d(np.asarray(values, float))[:, None] for values in (curvature, bank, friction))
        w = portable.square(np.linspace(0.0, self.speeds[-1], BEND_SPEEDS))
        felt = w * k - GRAVITY * portable.sin(tilt)
        return w, np.minimum.accumulate(self.deceleration(np.sqrt(w), felt, mu), axis=1)

    def speed(self, curvature: ArrayLike, bank: ArrayLike = 0.0, friction: ArrayLike = 0.9) -> Array:
        """The highest speed (n,) in m/s up to which the margins hold without braking; inf: at all that were looked at.

        curvature: (n,) 1/m; bank: (n,) rad, positive where gravity pushes to the left; friction: (n,).
        """
        conditions = np.broadcast_arrays(
            *(np.atleast_1d(np.asarray(values, float)) for values in (curvature, bank, friction))
        )
        return np.sqrt(highest(*self.along(*conditions)))


def highest(w: Array, deceleration: Array) -> Array:
    """(n,) squared speed up to which a `deceleration` (n, m), falling with w (m,), is not below zero."""
    first = np.argmax(deceleration < 0.0, axis=1)
    row = np.arange(len(deceleration))
    before = np.maximum(first - 1, 0)
    fall = np.maximum(deceleration[row, before] - deceleration[row, first], 1e-12)
    crossing = w[before] + (w[first] - w[before]) * np.clip(deceleration[row, before] / fall, 0.0, 1.0)
    return np.where((deceleration >= 0.0).all(axis=1), np.inf, crossing)


def _place(axis: tuple[float, ...], x: Array) -> tuple[np.ndarray, Array]:
    """The node below x, and the share of the way to the next one."""
    nodes = np.array(axis)
    i = np.clip(np.searchsorted(nodes, x, side="right") - 1, 0, nodes.size - 2)
    return i, np.clip((x - nodes[i]) / (nodes[i + 1] - nodes[i]), 0.0, 1.0)


load_holdable = HoldableSpeed.from_toml
