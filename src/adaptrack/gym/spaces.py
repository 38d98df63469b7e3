"""Action and observation spaces of the environments, their bounds, and the MPC that an agent tunes.

A belief consists of the steering parameters that an MPC assumes, or of the quantities that it learns while driving.
The controller `as-written` is the published MPC.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from adaptrack.base.checked import reals
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.control.controllers import MPC, Controller, Learning, published_mpc
from adaptrack.control.controllers.setup import LoopSetup
from adaptrack.core.public import BELIEF_NAMES, portable
from adaptrack.core.public import LEARNED as BELIEFS_OFFSET
from adaptrack.gym.task import Task

Array = NDArray[np.float64]

CLIP_DISTANCE = 100.0
"""m, bound of offsets and of the previewed reference in an observation."""
OBSERVATION_BOUNDS = {
    "offset": (-CLIP_DISTANCE, CLIP_DISTANCE), "heading_error": (-math.pi, math.pi), "yaw_rate": (-10.0, 10.0),
    "speed": (0.0, 100.0), "wheel_angle": (-math.pi / 2, math.pi / 2), "command": (-math.pi / 2, math.pi / 2),
    "pose_age": (0.0, 600.0),
}  # fmt: skip
"""Bounds of the columns of `core.simulation.observation.OBSERVATION`, SI units."""
PREVIEW_REFERENCE_BOUNDS, PREVIEW_CURVATURE_BOUNDS = (-CLIP_DISTANCE, CLIP_DISTANCE), (-1.0, 1.0)
"""Bounds of a previewed reference (m) and of a previewed curvature (1/m)."""
VARIABLE_BOUNDS = {
    "speed": (0.0, 100.0), "y_ref": (-1000.0, 1000.0), "friction": (0.0, 2.0), "wind": (-100.0, 100.0),
    "change": (0.0, 1000.0), "acceleration": (0.0, 100.0), "offset": (-CLIP_DISTANCE, CLIP_DISTANCE),
}  # fmt: skip
"""Bounds of the scheduling variables of an MPC, SI units."""
BELIEF_BOUNDS = {"belief_lag": (0.0, 10.0), "belief_delay": (0.0, 10.0)}
"""Bounds of the steering lag and of the time until a command begins to act (s), as the controller assumes them."""
LEARNED_BOUNDS = (-100.0, 100.0)
"""Bounds of every learned quantity and standard deviation, SI units."""
BELIEF_STATE = "belief_state"
"""Name of the state of the learned quantities (`BeliefState`), among the diagnostics of an MPC and in ``info``."""
RATIO_DECADES = 2.0
"""Largest difference between the log10 R/Q of an action and that of the controller's default tuning."""
DISTANCES = (0.0, 5.0, 10.0, 20.0, 40.0)
"""Default preview distances (m)."""


def box(bounds: Sequence[tuple[float, float]]) -> spaces.Box:
    """Return a float64 box from (low, high) of each entry."""
    low, high = np.array(bounds, dtype=np.float64).T
    return spaces.Box(low.copy(), high.copy(), dtype=np.float64)


def check_distances(distances: Sequence[float]) -> Array:
    """Return the preview distances (m) as an array; `InvalidInput` unless they are finite and not negative."""
    metres = np.atleast_1d(reals("distances", distances)).copy()
    if not (np.isfinite(metres).all() and (metres >= 0.0).all()):
        raise InvalidInput(f"distances = {metres.tolist()!r} m: must be finite and not negative.")
    return metres


def observation_bounds(distances: Array) -> list[tuple[float, float]]:
    """Return the bounds of the columns of an agent that steers, for its preview distances (m)."""
    count = len(distances)
    return [*OBSERVATION_BOUNDS.values(), *[PREVIEW_REFERENCE_BOUNDS] * count, *[PREVIEW_CURVATURE_BOUNDS] * count]


def observation_names(distances: Array) -> tuple[str, ...]:
    """Return the names of the columns of `observation_bounds`."""
    preview = [f"{signal}_{distance:g}m" for signal in ("reference", "curvature") for distance in distances]
    return (*OBSERVATION_BOUNDS, *preview)


def command_bounds(task: Task) -> tuple[float, float]:
    """Return the limits that all controllers have for steering commands (rad)."""
    vehicle, _, profile = task.base_car()
    return LoopSetup.of("PathTracking", vehicle, profile, None, None, None, None).limits.angle


def check_action(action: Any, space: spaces.Box) -> Array:
    """Return an action as an array, clipped to the bounds of its space.

    Raises
    ------
    InvalidInput
        For an action that is not numeric, not finite or of a different shape than the space.
    """
    values = reals("action", action)
    if values.shape != space.shape:
        raise InvalidInput(f"action: shape {values.shape}, expected {space.shape}.")
    if not np.isfinite(values).all():
        raise InvalidInput(f"action = {values}: must be finite; look at what the policy computes.")
    return np.clip(values, space.low, space.high)


# -- the MPC that an agent tunes --------------------------------------------------------------------------------------
ENVIRONMENT_CONTROLLERS = ("informed", "informed-learning", "as-written")


def make_mpc(kind: str, vehicle: Any, profile: Any, scheduler: Any = None) -> MPC:
    """Return an MPC with preview of the road.

    Parameters
    ----------
    kind
        One of `ENVIRONMENT_CONTROLLERS`.
    vehicle, profile
        Car and profile for which the MPC is built.
    scheduler
        Scheduler of the tuning; None for the default tuning.

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
    """Conversion between tunings of an MPC and actions within +-1."""

    def __init__(self, mpc: MPC) -> None:
        log_ratio = portable.log10(mpc.tuning.R / mpc.tuning.Q)
        self.low = np.array([1.0, 1.0, log_ratio - RATIO_DECADES])
        self.high = np.array([mpc.longest_horizon, mpc.most_moves, log_ratio + RATIO_DECADES])
        self.box = box([(-1.0, 1.0)] * 3)

    def of(self, actions: Array) -> Array:
        """Return Np, Nc and log10 R/Q (..., 3) of actions (..., 3)."""
        return self.low + 0.5 * (actions + 1.0) * (self.high - self.low)

    def entries(self, actions: Array) -> Array:
        """Return Np, Nc, Q and R (..., 4) of actions (..., 3), the same bits for one action as for many."""
        tunings = self.of(actions)
        ones = np.ones_like(tunings[..., 2:])
        return np.concatenate([tunings[..., :2], ones, portable.power(10.0 * ones, tunings[..., 2:])], axis=-1)

    def action(self, Np: float, Nc: float, ratio: float) -> Array:
        """Return the action (3,) for Np and Nc (control periods) and ratio = log10 R/Q.

        Raises
        ------
        InvalidInput
            For values outside the bounds `low` and `high`.
        """
        tuning = reals("Np, Nc, log10 R/Q", [Np, Nc, ratio])
        if not ((tuning >= self.low) & (tuning <= self.high)).all():
            raise InvalidInput(f"Np, Nc, log10 R/Q = {tuning}: must lie between {self.low} and {self.high}.")
        return 2.0 * (tuning - self.low) / (self.high - self.low) - 1.0


def variable_bounds(mpc: MPC) -> dict[str, tuple[float, float]]:
    """Return the observation bounds of an agent that tunes an MPC, by column name.

    The scheduling variables come first, then the learned or assumed quantities of the MPC.
    """
    if mpc.learner is not None:
        return {**VARIABLE_BOUNDS, **dict.fromkeys(BELIEF_NAMES, LEARNED_BOUNDS)}
    return {**VARIABLE_BOUNDS, **(BELIEF_BOUNDS if mpc.belief is not None else {})}


def initial_belief(mpc: Controller) -> tuple[float, ...]:
    """Return the initial values of the columns after the scheduling variables, see `variable_bounds`."""
    if mpc.learner is not None:
        return tuple(mpc.learner.fresh()[BELIEFS_OFFSET : BELIEFS_OFFSET + len(BELIEF_NAMES)].tolist())
    return () if mpc.belief is None else (mpc.belief.lag.value, mpc.belief.delay)
