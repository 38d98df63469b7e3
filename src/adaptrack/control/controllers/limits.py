"""Limits on moves, angle and output, and how a sequence of moves is parametrised."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, Field

from adaptrack.base.checked import RISING, Bound, Count, Finite, Hint, NotNegative, Number, Positive, checked
from adaptrack.base.limits import LAGUERRE_TERMS
from adaptrack.core.synthesis.belief import ANGLE, MOVE


def _holds_zero(pair: tuple[float, float]) -> tuple[float, float]:
    if not pair[0] <= 0.0 <= pair[1]:
        raise ValueError("must be (low, high) and contain 0, or some step has no feasible move.")
    return pair


_AboutZero = Annotated[tuple[Finite, Finite], AfterValidator(_holds_zero), Hint("(low, high)")]


@checked
@dataclass(frozen=True)
class Limits:
    """Bounds (low, high) of eqs. (13)-(15); the defaults are the paper's table.

    A move and an angle of 0 are always allowed: so some move is feasible at every step.
    """

    move: Annotated[_AboutZero, "rad"] = (-MOVE, MOVE)
    """per control period, eq. (13)"""
    angle: Annotated[_AboutZero, "rad"] = (-ANGLE, ANGLE)
    """eq. (14)"""
    output: Annotated[tuple[Number, Number], RISING, "m", Hint("(low, high)")] = (-math.inf, math.inf)
    """eq. (15); soft: one slack variable, its square weighed, so that the QP stays feasible"""
    output_weight: Annotated[Positive, "1/m^2"] = 1e4
    """weight of the squared violation of `output`"""
    ahead: Annotated[NotNegative, "rad"] = 0.0
    """a first move may exceed `move` while the command is not further than this ahead of the wheels, whose angle
    an estimator knows by the model: an actuator with a lag follows so far without its rate limit"""
    error: Annotated[Bound, "m", Hint("inf: no limit")] = math.inf
    """of a larger lateral error the QP corrects so much at once: the reference is moved towards the car.
    Without preview it is larger by what the reference moves in 1 s"""


@checked
@dataclass(frozen=True)
class Moves:
    """How the sequence of moves is parametrised: dU = L eta.

    "pulse": L = identity, eq. (10): Nc free moves, then none. "laguerre": L = the first `terms` discrete Laguerre
    functions with `pole`, over the whole prediction horizon, as in the authors' published controller; R then weighs
    the coefficients eta and Nc is the number of samples on which the limits are imposed.
    """

    kind: Literal["pulse", "laguerre"] = "pulse"
    pole: Annotated[NotNegative, Field(lt=1.0)] = 0.95
    terms: Annotated[Count, LAGUERRE_TERMS] = 10

    @classmethod
    def pulses(cls) -> Self:
        """Free moves, eq. (10)."""
        return cls("pulse")

    @classmethod
    def laguerre(cls, pole: float = 0.95, terms: int = 10) -> Self:
        """Laguerre functions."""
        return cls("laguerre", pole, terms)


LimitsArgument = Annotated[Limits, Hint("Limits(move=(low, high), angle=(low, high))")]
"""The type of an argument."""
