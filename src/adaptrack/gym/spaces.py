"""What is observed and what may be done, as boxes; what the steps of both environments share."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from adaptrack.base.checked import reals
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.control.controllers import MPC, Learning, published_mpc
from adaptrack.control.controllers.setup import LoopSetup
from adaptrack.core.public import BELIEF_NAMES, LEARNED
from adaptrack.gym.task import Task

Array = NDArray[np.float64]

CLIP_DISTANCE = 100.0
"""m, to which offsets and the reference ahead are clipped."""
OBSERVED_WITHIN = {
    "offset": (-CLIP_DISTANCE, CLIP_DISTANCE), "heading_error": (-math.pi, math.pi), "yaw_rate": (-10.0, 10.0),
    "speed": (0.0, 100.0), "wheel_angle": (-math.pi / 2, math.pi / 2), "command": (-math.pi / 2, math.pi / 2),
    "pose_age": (0.0, 600.0),
}  # fmt: skip
"""Bounds of what sensors give, `core.observation.OBSERVATION`."""
AHEAD_WITHIN, CURVATURE_WITHIN = (-CLIP_DISTANCE, CLIP_DISTANCE), (-1.0, 1.0)
"""m, 1/m"""
VARIABLES_WITHIN = {
    "speed": (0.0, 100.0), "y_ref": (-1000.0, 1000.0), "friction": (0.0, 2.0), "wind": (-100.0, 100.0),
    "change": (0.0, 1000.0), "acceleration": (0.0, 100.0), "offset": (-CLIP_DISTANCE, CLIP_DISTANCE),
}  # fmt: skip
BELIEF_WITHIN = {"belief_lag": (0.0, 10.0), "belief_delay": (0.0, 10.0)}
"""s, lag of the steering and time until a command begins to act, as the controller believes them."""
LEARNED_WITHIN = (-100.0, 100.0)
BELIEF_STATE = "belief_state"
"""Of what is learned, and what ``info`` calls it."""
RATIO_DECADES = 2.0
"""By which log10 R/Q may lie to either side of the controller's own."""
DISTANCES = (0.0, 5.0, 10.0, 20.0, 40.0)
"""m, at which one looks ahead."""


def box(bounds: Sequence[tuple[float, float]]) -> spaces.Box:
    """A box of float64 with these bounds."""
    low, high = np.array(bounds, dtype=np.float64).T
    return spaces.Box(low.copy(), high.copy(), dtype=np.float64)


def checked_distances(distances: Sequence[float]) -> Array:
    """Distances (m) at which one looks ahead."""
    metres = np.atleast_1d(reals("distances", distances)).copy()
    if not (np.isfinite(metres).all() and (metres >= 0.0).all()):
        raise InvalidInput(f"distances = {metres.tolist()!r} m: must be finite and not negative.")
    return metres


def observation_box(distances: Array) -> spaces.Box:
    """Observation space of a steering agent."""
    count = len(distances)
    return box([*OBSERVED_WITHIN.values(), *[AHEAD_WITHIN] * count, *[CURVATURE_WITHIN] * count])


def observation_names(distances: Array) -> tuple[str, ...]:
    """The names of its columns."""
    ahead = [f"{signal}_{distance:g}m" for signal in ("reference", "curvature") for distance in distances]
    return (*OBSERVED_WITHIN, *ahead)


def command_box(task: Task) -> spaces.Box:
    """The steering commands (rad) that the other controllers may give as well."""
    vehicle, _, profile = task.known_car()
    return box([LoopSetup.of("PathTracking", vehicle, profile, None, None, None, None).limits.angle])


def checked_action(action: Any, space: spaces.Box) -> Array:
    """A finite action of the shape of the space, clipped to its bounds.

    Raises
    ------
    InvalidInput
        When it is not made of numbers, has another shape or is not finite.
    """
    values = reals("action", action)
    if values.shape != space.shape:
        raise InvalidInput(f"action: shape {values.shape}, expected {space.shape}.")
    if not np.isfinite(values).all():
        raise InvalidInput(f"action = {values}: must be finite; look at what the policy computes.")
    return np.clip(values, space.low, space.high)


# -- the MPC that is tuned --------------------------------------------------------------------------------------------
ENVIRONMENT_CONTROLLERS = ("informed", "informed-learning", "as-written")


def make_mpc(kind: str, vehicle: Any, profile: Any, scheduler: Any = None) -> MPC:
    """The MPC of a car in a profile, by its name among `ENVIRONMENT_CONTROLLERS`; it knows the road ahead.

    Raises
    ------
    UnknownName
        When there is no such controller.
    """
    arguments: dict[str, Any] = {"period": profile.period, "preview": True, "scheduler": scheduler}
    if kind == "as-written":
        return published_mpc(vehicle, **arguments)
    if kind not in ENVIRONMENT_CONTROLLERS:
        raise UnknownName(f"no controller to tune is named {kind!r}. {did_you_mean(kind, ENVIRONMENT_CONTROLLERS)}")
    return MPC(vehicle, profile=profile, learning=Learning() if kind == "informed-learning" else None, **arguments)


class Tunings:
    """The tunings that may be chosen, and the actions within +-1 that stand for them."""

    def __init__(self, mpc: MPC) -> None:
        log_ratio = math.log10(mpc.tuning.R / mpc.tuning.Q)
        self.low = np.array([1.0, 1.0, log_ratio - RATIO_DECADES])
        self.high = np.array([mpc.longest_horizon, mpc.most_moves, log_ratio + RATIO_DECADES])
        self.box = box([(-1.0, 1.0)] * 3)

    def of(self, actions: Array) -> Array:
        """(..., 3) Np, Nc and log10 R/Q of actions (..., 3)."""
        return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)

    def entries(self, actions: Array) -> Array:
        """(..., 4) Np, Nc, Q and R of actions (..., 3), the same to the bit for one action and for many."""
        chosen = self.of(actions)
        ones = np.ones_like(chosen[..., 2:])
        return np.concatenate([chosen[..., :2], ones, np.power(10.0 * ones, chosen[..., 2:])], axis=-1)

    def action(self, Np: float, Nc: float, ratio: float) -> Array:
        """The action (3,) that stands for Np, Nc and log10 R/Q.

        Raises
        ------
        InvalidInput
            When they may not be chosen.
        """
        chosen = reals("Np, Nc, log10 R/Q", [Np, Nc, ratio])
        if not ((chosen >= self.low) & (chosen <= self.high)).all():
            raise InvalidInput(f"Np, Nc, log10 R/Q = {chosen}: must lie between {self.low} and {self.high}.")
        return 2.0 * (chosen - self.low) / (self.high - self.low) - 1.0


def variables_within(mpc: MPC) -> dict[str, tuple[float, float]]:
    """By name, the bounds of what an agent that tunes observes: scheduling variables, then what the MPC believes."""
    if mpc.learner is not None:
        return {**VARIABLES_WITHIN, **dict.fromkeys(BELIEF_NAMES, LEARNED_WITHIN)}
    return {**VARIABLES_WITHIN, **(BELIEF_WITHIN if mpc.belief is not None else {})}


def first_belief(mpc: MPC) -> tuple[float, ...]:
    """Initial belief of an MPC, which follows the scheduling variables in an observation."""
    if mpc.learner is not None:
        return tuple(mpc.learner.fresh()[LEARNED : LEARNED + len(BELIEF_NAMES)].tolist())
    return () if mpc.belief is None else (mpc.belief.lag.value, mpc.belief.delay)
