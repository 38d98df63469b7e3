"""Environments in which an agent chooses the tuning of a car's MPC while the MPC drives, one car or many.

A belief consists of the steering parameters that an MPC assumes, or of the quantities that it learns while driving.
"""

from __future__ import annotations

from typing import Any, cast

import numpy as np
from gymnasium import spaces

from adaptrack.base.checked import reals, whole_number
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.control.controllers import MPC, Controller, get_controller
from adaptrack.core import public as core
from adaptrack.core.public import Array
from adaptrack.drive.batch import Batch
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.gym.environment import BELIEF_STATE, CLIP_DISTANCE, CarBlock, SingleCarEnv, VectorEnv, box, is_over
from adaptrack.gym.task import Episode, Task

TUNING_PERIODS = 10
"""Default number of control periods between two actions."""
VARIABLE_BOUNDS = {
    "speed": (0.0, 100.0), "y_ref": (-1000.0, 1000.0), "friction": (0.0, 2.0), "wind": (-100.0, 100.0),
    "change": (0.0, 1000.0), "acceleration": (0.0, 100.0), "offset": (-CLIP_DISTANCE, CLIP_DISTANCE),
}  # fmt: skip
"""Bounds of the scheduling variables of an MPC, SI units."""
BELIEF_BOUNDS = {"belief_lag": (0.0, 10.0), "belief_delay": (0.0, 10.0)}
"""Bounds of the steering lag and of the time until a command begins to act (s), as the controller assumes them."""
LEARNED_BOUNDS = (-100.0, 100.0)
"""Bounds of every learned quantity and standard deviation, SI units."""
RATIO_DECADES = 2.0
"""Largest difference between the log10 R/Q of an action and that of the controller's default tuning."""
ENVIRONMENT_CONTROLLERS = ("informed", "informed-learning", "as-written")
"""Controllers that an agent tunes; `as-written` is the published MPC."""


def make_mpc(kind: str, vehicle: Any, profile: Any, scheduler: Any = None) -> MPC:
    """Return an MPC of a car and a profile with preview of the road; scheduler: of the tuning; None: default tuning.

    kind: one of `ENVIRONMENT_CONTROLLERS`; raises UnknownName for any other.
    """
    if kind not in ENVIRONMENT_CONTROLLERS:
        raise UnknownName(f"no controller to tune is named {kind!r}. {did_you_mean(kind, ENVIRONMENT_CONTROLLERS)}")
    optional = {"period": profile.period, "preview": True, "scheduler": scheduler}
    return cast(MPC, get_controller(kind, vehicle, profile=profile, optional=optional))


class Tunings:
    """Conversion between tunings of an MPC and actions within +-1."""

    def __init__(self, mpc: MPC) -> None:
        log_ratio = core.portable.log10(mpc.tuning.R / mpc.tuning.Q)
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
        return np.concatenate([tunings[..., :2], ones, core.portable.power(10.0 * ones, tunings[..., 2:])], axis=-1)

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
        return {**VARIABLE_BOUNDS, **dict.fromkeys(core.BELIEF_NAMES, LEARNED_BOUNDS)}
    return {**VARIABLE_BOUNDS, **(BELIEF_BOUNDS if mpc.belief is not None else {})}


def initial_belief(mpc: Controller) -> tuple[float, ...]:
    """Return the initial values of the columns after the scheduling variables, see `variable_bounds`."""
    if mpc.learner is not None:
        return tuple(mpc.learner.fresh()[core.LEARNED : core.LEARNED + len(core.BELIEF_NAMES)].tolist())
    return () if mpc.belief is None else (mpc.belief.lag.value, mpc.belief.delay)


class AgentScheduler:
    """Scheduler that returns the tuning of the agent's last action."""

    name = "agent"

    def __init__(self) -> None:
        self.tuning: tuple[float, ...] = ()

    def __call__(self, variables: Any) -> tuple[float, ...]:
        return self.tuning


class _MPCTuning:
    """Spaces of an agent that tunes an MPC, and this MPC, for one car and for many."""

    task: Task
    names: tuple[str, ...]
    _scheduler: AgentScheduler | None = None

    def _set_agent(self, controller: str, every: int, task: dict[str, Any]) -> tuple[spaces.Box, spaces.Box]:
        """Set task, tunings and names of the columns; return the action and observation space of one car."""
        self.task, self.controller = Task(**task), controller
        self.every = whole_number("MPCTuning", "every", every)
        vehicle, _, profile = self.task.base_car()
        mpc = make_mpc(controller, vehicle, profile)
        bounds = variable_bounds(mpc)
        self.names, self.tunings = tuple(bounds), Tunings(mpc)
        return self.tunings.box, box(list(bounds.values()))

    def _controller(self, episode: Episode) -> MPC:
        return make_mpc(self.controller, episode.vehicle, episode.profile, self._scheduler)


class MPCTuningEnv(_MPCTuning, SingleCarEnv):
    """`adaptrack/MPCTuning-v0`: choose horizons and weights of a car's MPC at intervals of `every` periods.

    The MPC drives as in `adaptrack.simulate`; the agent takes the place of its scheduler. QP, prediction model and
    estimator stay those of the MPC.

    Action
    ------
    Box(3,), float64. Each entry is clipped to +-1; -1 stands for the lowest and 1 for the highest value of

    - the prediction horizon Np, 1 to 60 control periods,
    - the control horizon Nc, 1 to 20 control periods,
    - log10 R/Q, within two decades of the value of the MPC's default tuning.

    Np and Nc are rounded, and Nc is limited to Np. ``tunings.action(Np, Nc, log10_ratio)`` converts a tuning to an
    action, ``tunings.of(action)`` an action to a tuning.

    Observation
    -----------
    Box, float64, with the columns below (`names`), each clipped to its bounds. A missing value keeps its last value.

    ==================  ======  ==============================================================================
    name                unit    meaning, bounds
    ==================  ======  ==============================================================================
    speed               m/s     measured speed, 0 to 100
    y_ref               m       lateral reference at the present instant, +-1000
    friction            --      friction as perceived by the controller (`perception`), 0 to 2
    wind                m/s     side wind as perceived by the controller, +-100
    change              m       largest change of the reference over the next 3 s, 0 to 1000
    acceleration        m/s^2   largest lateral acceleration of reference and road over the next 3 s, 0 to 100
    offset              m       measured y minus y_ref, positive to the left, +-100
    belief_lag          s       only `informed`: assumed lag of the steering, 0 to 10
    belief_delay        s       only `informed`: assumed time until a command begins to act, 0 to 10
    ==================  ======  ==============================================================================

    With `informed-learning` the columns after `offset` are the learned quantities and their standard deviations, each
    within +-100. They have the names of the diagnostics of `MPC`. This controller takes its initial steering
    parameters from the car file, not from the profile. At every step info contains `belief_state`, a number of
    `BeliefState`. With `as-written`, the controller of the paper, the observation ends with `offset`.

    Reward
    ------
    The sum of the rewards (m^2) that `adaptrack/PathTracking-v0` gives for the control periods of the step.

    End
    ---
    As in `adaptrack/PathTracking-v0`. The last step of a road may have fewer control periods.

    Parameters
    ----------
    controller
        `informed`, `informed-learning` or `as-written`.
    every
        Number of control periods between two actions.
    task
        The fields of `Task`.

    Raises
    ------
    InvalidInput
        For invalid arguments, options or actions.
    """

    def __init__(
        self, *, controller: str = "informed", every: int = TUNING_PERIODS, render_mode: str | None = None, **task: Any
    ) -> None:
        super().__init__(self._set_agent(controller, every, task), render_mode)
        self._scheduler = AgentScheduler()

    def _controller(self, episode: Episode) -> MPC:
        self._mpc = super()._controller(episode)
        self._belief = initial_belief(self._mpc)
        return self._mpc

    def _drive(self, loop: ClosedLoop, action: Array) -> float:
        assert self._scheduler is not None
        self._scheduler.tuning = tuple(self.tunings.entries(action).tolist())
        cost = 0.0
        for _ in range(self.every):
            sensed = loop.sensed
            preview: dict[str, Any] = {} if loop.road is None else {"road": loop.road_ahead(sensed.speed)}
            command = self._mpc.step(sensed.measured, sensed.speed, sensed.reference, sensed.variables, **preview)
            self._belief = command.learned or self._belief
            cost += self._drive_period(loop, command.angle)
            if is_over(loop):
                break
        return cost

    @property
    def _belief_info(self) -> dict[str, Any]:
        """The state of the learned quantities for ``info``, empty if the controller does not learn."""
        return (
            {}
            if self._mpc.learner is None
            else {BELIEF_STATE: int(self._belief[core.BELIEF_NAMES.index(BELIEF_STATE)])}
        )

    def _write_observation(self, loop: ClosedLoop) -> None:
        variables = loop.sensed.variables
        inputs = np.array([*variables._replace(offset=-variables.offset), *self._belief])
        space, present = self.observation_space, np.isfinite(inputs)
        self._observation[:] = np.clip(np.where(present, inputs, self._observation), space.low, space.high)  # type: ignore[attr-defined]


class MPCTuningVectorEnv(_MPCTuning, VectorEnv):
    """`adaptrack/MPCTuning-v0` for many cars at once, compiled.

    Blocks, new episodes and the agreement with single-car runs are as in `PathTrackingVectorEnv`.

    Parameters
    ----------
    num_envs, threads
        As in `PathTrackingVectorEnv`.
    controller, every, task
        As in `MPCTuningEnv`, except that a user's plant must not be written in Python.

    Raises
    ------
    InvalidInput
        For invalid arguments, options or actions.
    """

    def __init__(
        self,
        num_envs: int = 64,
        *,
        threads: int = 1,
        controller: str = "informed",
        every: int = TUNING_PERIODS,
        **task: Any,
    ) -> None:
        super().__init__(num_envs, threads, self._set_agent(controller, every, task))
        self._longest_horizons = float(self.tunings.high[0]), float(self.tunings.high[1])
        if BELIEF_STATE not in self.names:
            self._step_columns = len(VARIABLE_BOUNDS)

    def _constant_columns(self, batch: Batch) -> tuple[float, ...]:
        return () if batch.controller.learner is not None else initial_belief(batch.controller)

    def _store_actions(self, actions: Array) -> None:
        tunings = self.tunings.entries(actions)
        for block in self._blocks:
            block.episodes.run.controller.tuning[:] = tunings[block.slots]

    def _drive(self, block: CarBlock) -> None:
        for _ in range(self.every):
            core.drive_on(block.resident)

    def _write_observations(self, block: CarBlock) -> None:
        core.write_variables(block.resident)
