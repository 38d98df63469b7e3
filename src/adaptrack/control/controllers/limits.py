"""Limits on moves, angle and output, and how a sequence of moves is parametrised."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Self

from adaptrack.base.errors import InvalidInput, real, whole
from adaptrack.base.limits import LAGUERRE_TERMS, check_limit


@dataclass(frozen=True)
class Limits:
    """Bounds (low, high) of eqs. (13)-(15); the defaults are the paper's table.

    Raises
    ------
    InvalidInput
        When a pair is not low <= high, a move or an angle of 0 is not allowed, or the weight or the error is not
        positive: limits that contain 0 always leave a feasible move.
    """

    move: tuple[float, float] = (-math.pi / 12, math.pi / 12)
    """rad per control period, eq. (13)"""
    angle: tuple[float, float] = (-math.pi / 6, math.pi / 6)
    """rad, eq. (14)"""
    output: tuple[float, float] = (-math.inf, math.inf)
    """m, eq. (15); soft: one slack variable, its square weighed, so that the QP stays feasible"""
    output_weight: float = 1e4
    """1/m^2, weight of the squared violation of `output`"""
    ahead: float = 0.0
    """rad; a first move may exceed `move` while the command is not further than this ahead of the wheels, whose angle
    an estimator knows by the model: an actuator with a lag follows so far without its rate limit"""
    error: float = math.inf
    """m, of a larger lateral error the QP is asked to correct so much at once: the reference is moved towards the car.
    Without preview it is larger by what the reference moves in 1 s"""

    def __post_init__(self) -> None:
        for name, unit in (("move", "rad"), ("angle", "rad"), ("output", "m")):
            pair = getattr(self, name)
            if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
                raise InvalidInput(f"Limits: {name} = {pair!r}: must be a pair (low, high) in {unit}.")
            low, high = (real("Limits", name, value) for value in pair)
            if not low <= high:
                raise InvalidInput(f"Limits: {name} = ({low!r}, {high!r}) {unit}: need low <= high, none of them NaN.")
            if name != "output" and not (low <= 0.0 <= high and math.isfinite(low) and math.isfinite(high)):
                raise InvalidInput(
                    f"Limits: {name} = ({low!r}, {high!r}) {unit}: must be finite and contain 0, "
                    "or some step has no feasible move."
                )
        if not 0.0 <= real("Limits", "ahead", self.ahead) < math.inf:
            raise InvalidInput(f"Limits: ahead = {self.ahead!r} rad: must not be negative, and finite.")
        if not real("Limits", "error", self.error) > 0.0:
            raise InvalidInput(f"Limits: error = {self.error!r} m: must be positive; inf: no limit.")
        if not 0.0 < real("Limits", "output_weight", self.output_weight) < math.inf:
            raise InvalidInput(f"Limits: output_weight = {self.output_weight!r}: must be finite and positive.")


@dataclass(frozen=True)
class Moves:
    """How the sequence of moves is parametrised: dU = L eta.

    "pulse": L = identity, eq. (10): Nc free moves, then none. "laguerre": L = the first `terms` discrete Laguerre
    functions with `pole`, over the whole prediction horizon, as in the authors' published controller; R then weighs
    the coefficients eta and Nc is the number of samples on which the limits are imposed.

    Raises
    ------
    InvalidInput
        For an unknown kind, a pole outside [0, 1), or no terms.
    """

    kind: str = "pulse"
    pole: float = 0.95
    terms: int = 10

    def __post_init__(self) -> None:
        if self.kind not in ("pulse", "laguerre"):
            raise InvalidInput(f"Moves: kind = {self.kind!r}: must be 'pulse' or 'laguerre'.")
        if not 0.0 <= real("Moves", "pole", self.pole) < 1.0:
            raise InvalidInput(f"Moves: pole = {self.pole!r}: must be in [0, 1).")
        check_limit("Moves: terms", whole("Moves", "terms", self.terms), LAGUERRE_TERMS)

    @classmethod
    def pulses(cls) -> Self:
        """Free moves, eq. (10)."""
        return cls("pulse")

    @classmethod
    def laguerre(cls, pole: float = 0.95, terms: int = 10) -> Self:
        """Laguerre functions."""
        return cls("laguerre", pole, terms)
