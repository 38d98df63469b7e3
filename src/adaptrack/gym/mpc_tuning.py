"""Environment in which an agent chooses the tuning of a car's MPC while the MPC drives."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import whole_number
from adaptrack.core.public import BELIEF_NAMES
from adaptrack.gym.episode_run import EpisodeRun, require_running
from adaptrack.gym.spaces import BELIEF_STATE, Tunings, box, check_action, initial_belief, make_mpc, variable_bounds
from adaptrack.gym.task import Task

Array = NDArray[np.float64]
TUNING_PERIODS = 10
"""Default number of control periods between two actions."""


class AgentScheduler:
    """Scheduler that returns the tuning of the agent's last action."""

    name = "agent"

    def __init__(self) -> None:
        self.tuning: tuple[float, ...] = ()

    def __call__(self, variables: Any) -> tuple[float, ...]:
        return self.tuning


class MPCTuningEnv(gymnasium.Env):
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

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(
        self, *, controller: str = "informed", every: int = TUNING_PERIODS, render_mode: str | None = None, **task: Any
    ) -> None:
        self.task, self.controller, self.render_mode = Task(**task), controller, render_mode
        self.every = whole_number("MPCTuning", "every", every)
        vehicle, _, profile = self.task.base_car()
        mpc = make_mpc(controller, vehicle, profile)
        bounds = variable_bounds(mpc)
        self.names = tuple(bounds)
        self.tunings = Tunings(mpc)
        self.action_space, self.observation_space = self.tunings.box, box(list(bounds.values()))
        self._run: EpisodeRun | None = None
        self._scheduler = AgentScheduler()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode, see `gymnasium.Env.reset`; options: `noise_seed`, `car_seed`, `road`."""
        super().reset(seed=seed)
        episode = self.task.draw(self.np_random, options)
        self._mpc = make_mpc(self.controller, episode.vehicle, episode.profile, self._scheduler)
        self._run = EpisodeRun(self.task, episode, self._mpc)
        self._belief = initial_belief(self._mpc)
        self._observation = np.zeros(len(self.names))
        return self._observe(self._run), episode.info | self._belief_info

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive `every` control periods with a tuning, see `gymnasium.Env.step`."""
        run = require_running(self._run)
        self._scheduler.tuning = tuple(self.tunings.entries(check_action(action, self.tunings.box)).tolist())
        loop, cost = run.loop, 0.0
        for _ in range(self.every):
            sensed = loop.sensed
            preview: dict[str, Any] = {} if loop.road is None else {"road": loop.road_ahead(sensed.speed)}
            command = self._mpc.step(sensed.measured, sensed.speed, sensed.reference, sensed.variables, **preview)
            self._belief = command.learned or self._belief
            cost += run.drive_period(command.angle)
            if run.over:
                break
        return self._observe(run), -cost, run.terminated, run.truncated, run.info | self._belief_info

    @property
    def _belief_info(self) -> dict[str, Any]:
        """The state of the learned quantities for ``info``, empty if the controller does not learn."""
        return {} if self._mpc.learner is None else {BELIEF_STATE: int(self._belief[BELIEF_NAMES.index(BELIEF_STATE)])}

    def _observe(self, run: EpisodeRun) -> Array:
        variables = run.loop.sensed.variables
        inputs = np.array([*variables._replace(offset=-variables.offset), *self._belief])
        space, present = self.observation_space, np.isfinite(inputs)
        self._observation = np.clip(np.where(present, inputs, self._observation), space.low, space.high)  # type: ignore[attr-defined]
        return self._observation.copy()
