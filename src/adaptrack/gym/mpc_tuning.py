"""Choose the tuning of a car's MPC while it drives."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import whole_number
from adaptrack.core.public import BELIEF_NAMES
from adaptrack.gym.single_car import Driven, needs_reset
from adaptrack.gym.spaces import BELIEF_STATE, Tunings, box, checked_action, first_belief, make_mpc, variables_within
from adaptrack.gym.task import Task

Array = NDArray[np.float64]
TUNING_PERIODS = 10
"""Control periods between two tunings."""


class Chosen:
    """A scheduler that gives what was chosen last."""

    name = "chosen"

    def __init__(self) -> None:
        self.tuning: tuple[float, ...] = ()

    def __call__(self, variables: Any) -> tuple[float, ...]:
        return self.tuning


class MPCTuningEnv(gymnasium.Env):
    """`adaptrack/MPCTuning-v0`: choose horizons and weights of a car's MPC every so many control periods.

    The MPC drives as in `adaptrack.simulate` with a scheduler; its QP, model and estimator are its own.

    Action
    ------
    Box(3,), float64, +-1, beyond is clipped: prediction horizon Np (1 to 60) and control horizon Nc (1 to 20), both in
    control periods, rounded and clamped to Nc <= Np, and log10 R/Q, two decades to either side of the controller's own.
    -1 is the lowest, 1 the highest of each; ``tunings.action(Np, Nc, log10_ratio)`` gives the action of a tuning and
    ``tunings.of(action)`` the other way.

    Observation
    -----------
    Box, float64, in this order (`names`), each clipped to its bounds; what is missing keeps its last value.

    ==================  ======  ==============================================================================
    name                unit    meaning, bounds
    ==================  ======  ==============================================================================
    speed               m/s     measured, 0 to 100
    y_ref               m       lateral reference now, +-1000
    friction            --      as known (`known_as`), 0 to 2
    wind                m/s     side wind as known, +-100
    change              m       largest change of the reference over the next 3 s, 0 to 1000
    acceleration        m/s^2   largest lateral acceleration that reference and road ask for, likewise, 0 to 100
    offset              m       y_ref less measured y, +-100
    belief_lag          s       informed: lag of the steering as believed, 0 to 10
    belief_delay        s       informed: time until a command begins to act as believed, 0 to 10
    ==================  ======  ==============================================================================

    `informed-learning` has in place of the last two what it has learned with its standard deviations, by the names of
    the diagnostics of `MPC`, +-100; it knows of the steering what the car's file says, not the profile's. info has the
    state of that belief at every step: `belief_state`, a number of `BeliefState`. `as-written` believes nothing.

    Reward
    ------
    The sum of -(e^2 + w du^2) in m^2 over the control periods of the step, as in `adaptrack/PathTracking-v0`, the cost
    of a failure included.

    End
    ---
    As in `adaptrack/PathTracking-v0`; the last step of a road may have fewer periods.

    Arguments
    ---------
    The fields of `Task`; controller: `informed`, `informed-learning` or `as-written`; every: control periods of a step.

    Raises
    ------
    InvalidInput
        For arguments, options or actions that are not allowed.
    """

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form

    def __init__(
        self, *, controller: str = "informed", every: int = TUNING_PERIODS, render_mode: str | None = None, **task: Any
    ) -> None:
        self.task, self.controller, self.render_mode = Task(**task), controller, render_mode
        self.every = whole_number("MPCTuning", "every", every)
        vehicle, _, profile = self.task.known_car()
        mpc = make_mpc(controller, vehicle, profile)
        within = variables_within(mpc)
        self.names = tuple(within)
        self.tunings = Tunings(mpc)
        self.action_space, self.observation_space = self.tunings.box, box(list(within.values()))
        self._driven: Driven | None = None
        self._chosen = Chosen()

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Begin an episode, see `gymnasium.Env.reset`; options: `noise_seed`, `car_seed`, `road`."""
        super().reset(seed=seed)
        episode = self.task.draw(self.np_random, options)
        self._mpc = make_mpc(self.controller, episode.vehicle, episode.profile, self._chosen)
        self._driven = Driven(self.task, episode, self._mpc)
        self._belief = first_belief(self._mpc)
        self._observed = np.zeros(len(self.names))
        return self._observe(self._driven), episode.info | self._belief_info

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive `every` control periods with a tuning, see `gymnasium.Env.step`."""
        drive = needs_reset(self._driven)
        self._chosen.tuning = tuple(self.tunings.entries(checked_action(action, self.tunings.box)).tolist())
        loop, cost = drive.loop, 0.0
        for _ in range(self.every):
            sensed = drive.sensed
            ahead: dict[str, Any] = {} if loop.road is None else {"road": loop.road_ahead(sensed.speed)}
            answer = self._mpc.step(sensed.measured, sensed.speed, sensed.reference, sensed.variables, **ahead)
            self._belief = answer.learned or self._belief
            cost += drive.drive(answer.angle)
            if drive.over:
                break
        return self._observe(drive), -cost, drive.terminated, drive.truncated, drive.info | self._belief_info

    @property
    def _belief_info(self) -> dict[str, Any]:
        """Return the learned quantities for ``info``."""
        return {} if self._mpc.learner is None else {BELIEF_STATE: int(self._belief[BELIEF_NAMES.index(BELIEF_STATE)])}

    def _observe(self, drive: Driven) -> Array:
        inputs = np.array([*drive.sensed.variables, *self._belief])
        space = self.observation_space
        self._observed = np.clip(np.where(np.isfinite(inputs), inputs, self._observed), space.low, space.high)  # type: ignore[attr-defined]
        return self._observed.copy()
