"""Base classes of the environments: one car, or many cars in compiled batches."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from adaptrack.base.checked import reals, whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import Room
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.core import public as core
from adaptrack.core.public import Array
from adaptrack.drive.batch import Batch
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.failure import failure_of
from adaptrack.drive.world import World
from adaptrack.gym.task import Episode, Task

CLIP_DISTANCE = 100.0
"""m, bound of offsets and of the previewed reference in an observation."""
BELIEF_STATE = "belief_state"
"""Name of the state of the learned quantities (`BeliefState`), among the diagnostics of an MPC and in ``info``."""


def box(bounds: Sequence[tuple[float, float]]) -> spaces.Box:
    """Return a float64 box from (low, high) of each entry."""
    low, high = np.array(bounds, dtype=np.float64).T
    return spaces.Box(low.copy(), high.copy(), dtype=np.float64)


def check_action(action: Any, space: spaces.Box) -> Array:
    """Return an action as an array, clipped to the bounds of its space.

    Raises InvalidInput for an action that is not numeric, not finite or of a different shape than the space.
    """
    values = reals("action", action)
    if values.shape != space.shape:
        raise InvalidInput(f"action: shape {values.shape}, expected {space.shape}.")
    if not np.isfinite(values).all():
        raise InvalidInput(f"action = {values}: must be finite; look at what the policy computes.")
    return np.clip(values, space.low, space.high)


class SingleCarEnv(gymnasium.Env):
    """A car that an agent drives alone."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 - gymnasium's own form
    task: Task
    names: tuple[str, ...]
    """Names of the columns of an observation."""
    _loop: ClosedLoop | None = None
    """Simulated run of the episode, whose commands the environment sends."""

    def __init__(self, agent: tuple[spaces.Box, spaces.Box], render_mode: str | None) -> None:
        (self.action_space, self.observation_space), self.render_mode = agent, render_mode

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Array, dict[str, Any]]:
        """Start an episode, see `gymnasium.Env.reset`; options: `noise_seed`, `car_seed`, `road`."""
        super().reset(seed=seed)
        task, episode = self.task, self.task.draw(self.np_random, options)
        world = World.of(
            episode.plant, self._controller(episode), episode.profile, task.driver, task.perception, task.failure
        )  # fmt: skip
        self._loop = ClosedLoop(world, episode.drive, episode.noise_seed)
        self._failure_cost, self._total = task.cost_of_failure(world.failure.distance), 0.0
        self._observation = np.zeros(len(self.names))
        self._begin(episode)
        self._write_observation(self._loop)
        return self._observation.copy(), episode.info | self._belief_info

    def step(self, action: Any) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """Drive one step, see `gymnasium.Env.step`."""
        loop = self._loop
        if loop is None or is_over(loop):
            raise gymnasium.error.ResetNeeded("call reset() first: no run has begun, or it is over.")
        cost = self._drive(loop, check_action(action, self.action_space))  # type: ignore[arg-type]
        self._write_observation(loop)
        failed, over = loop.ended, is_over(loop)
        info = self._outcome(loop) if over else {}
        return self._observation.copy(), -cost, failed, over and not failed, info | self._belief_info

    def _drive_period(self, loop: ClosedLoop, command: float, speed_cost: float = 0.0) -> float:
        """Drive one control period with a command (rad) and return its cost e^2 + w (change of command)^2 (m^2).

        A failure adds the failure cost of every remaining instant. speed_cost: cost of speed and acceleration in this
        period (m^2), if the agent commands the acceleration.
        """
        loop.send(command)
        cost = speed_cost + loop.cost
        cost += (loop.signals.n - loop.instant) * self._failure_cost if loop.ended else 0.0
        self._total += cost
        return cost

    def _outcome(self, loop: ClosedLoop) -> dict[str, Any]:
        """The ``info`` of the last step: the reason of a failure and the cost J (m^2)."""
        reason, _ = loop.failure
        return {"failed": reason or "", "J": math.inf if reason else self._total / loop.signals.n}

    @abstractmethod
    def _controller(self, episode: Episode) -> Controller:
        """Return the controller of an episode's car; the environment calls it, or commands in its place."""

    @abstractmethod
    def _drive(self, loop: ClosedLoop, action: Array) -> float:
        """Drive one step with an action within its space, and return the cost (m^2)."""

    @abstractmethod
    def _write_observation(self, loop: ClosedLoop) -> None:
        """Write the observation into the environment's array, which holds the previous one."""

    def _begin(self, episode: Episode) -> None:
        """Begin an episode."""

    @property
    def _belief_info(self) -> dict[str, Any]:
        """The state of the learned quantities for ``info``, empty if the controller does not learn."""
        return {}


def is_over(loop: ClosedLoop) -> bool:
    """Whether the episode of a run has ended, by a failure or at the end of its drive."""
    return loop.ended or loop.instant == loop.signals.n


class CarBlock(NamedTuple):
    """Cars that one call of a kernel drives together."""

    slots: slice
    """Indices of the cars in the environment."""
    batch: Batch
    """Plant, controller, drives and profile of the cars."""
    vehicle: Vehicle
    """Data sheet of the cars."""
    episodes: Any
    """State of the episodes, a record `core.simulation.episode.Episodes`."""
    resident: Any
    """Packed form of `episodes` for kernels, `core.kernel.Resident`."""


class VectorEnv(gymnasium.vector.VectorEnv):
    """Cars in blocks of up to 32, each at its own instant of its episode.

    A car whose episode has ended starts a new episode in the next step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - gymnasium's own form
        "render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP,
    }  # fmt: skip

    task: Task
    distances = np.zeros(0)
    names: tuple[str, ...]
    """Names of the columns of an observation."""
    _longest_horizons = (1.0, 1.0)
    """Largest Np and Nc of an action, control periods."""

    def __init__(self, num_envs: int, threads: int, agent: tuple[spaces.Box, spaces.Box]) -> None:
        self.num_envs = whole_number("num_envs", "num_envs", num_envs)
        self.threads = whole_number("vector environment", "threads", threads)
        if isinstance(self.task.perception, FrictionWindEstimator):
            raise InvalidInput("perception: a FrictionWindEstimator needs Python at every step: one car at a time.")
        self.single_action_space, self.single_observation_space = agent
        self._step_columns = len(self.names)
        """Number of leading columns of an observation that change at every step; the others are constant."""
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._episode_states = core.EPISODE.new(self.num_envs)
        self._observations = np.zeros((self.num_envs, len(self.names)))
        self._rngs: list[np.random.Generator] = []
        self._blocks: list[CarBlock] = []
        self._pool = self._new_pool()

    def _new_pool(self) -> ThreadPoolExecutor | None:
        return ThreadPoolExecutor(self.threads) if self.threads > 1 else None

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_pool": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._pool = self._new_pool()
        self._blocks = [self._attached(block) for block in self._blocks]

    def _attached(self, block: CarBlock) -> CarBlock:
        """Return a block whose episode states and observations are views of the environment's arrays.

        Copying or unpickling an environment separates the arrays.
        """
        states, observations = self._episode_states[block.slots], self._observations[block.slots]
        episodes = block.episodes._replace(states=states, observations=observations)
        return block._replace(episodes=episodes, resident=core.Resident(episodes))

    @abstractmethod
    def _controller(self, episode: Episode) -> Controller:
        """Return the controller of the batch for an episode's car."""

    @abstractmethod
    def _store_actions(self, actions: Array) -> None:
        """Store the actions of all cars for the next step."""

    @abstractmethod
    def _drive(self, block: CarBlock) -> None:
        """Drive the cars of a block by one step with the stored actions."""

    @abstractmethod
    def _write_observations(self, block: CarBlock) -> None:
        """Write the observations of a block into the environment's array."""

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Start new episodes of all cars.

        Parameters
        ----------
        seed
            One seed for each car, or a number that stands for the seeds seed, seed + 1, ... as in
            `gymnasium.vector.SyncVectorEnv`. The single-car environment has the same run with the seed of a car.
        options
            Options of `reset` of the single-car environment, applied to every car.
        """
        if seed is not None or not self._rngs:
            if seed is None:
                self._rngs = list(self.np_random.spawn(self.num_envs))
            else:
                seeds = [seed + i for i in range(self.num_envs)] if isinstance(seed, int | np.integer) else list(seed)
                if len(seeds) != self.num_envs:
                    raise InvalidInput(f"reset: seed: need one, or one for each of {self.num_envs} cars.")
                self._rngs = [gymnasium.utils.seeding.np_random(seed)[0] for seed in seeds]
        infos = self._begin(np.arange(self.num_envs), options)
        self._apply_to_blocks(self._write_observations)
        return self._observations.copy(), infos | self._belief_info

    def step(self, actions: Any) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drive all cars by one step. A car whose episode had ended starts a new episode instead, with reward 0."""
        if not self._blocks:
            raise gymnasium.error.ResetNeeded("call reset() first: no run has begun.")
        self._store_actions(check_action(actions, self.action_space))  # type: ignore[arg-type]
        waiting = np.flatnonzero(self._episode_states["over"] != core.EPISODE_RUNS)
        self._episode_states["cost"] = 0.0
        self._apply_to_blocks(self._drive)
        self._episode_states["total"] += self._episode_states["cost"]
        rewards = -self._episode_states["cost"]
        outcomes = self._episode_states["over"].copy()
        outcomes[waiting] = core.EPISODE_RUNS
        infos = self._begin(waiting, None) if waiting.size else {}
        self._apply_to_blocks(self._write_observations)
        if outcomes.any():
            self._add_outcomes(np.flatnonzero(outcomes), infos)
        return (
            self._observations.copy(),
            rewards,
            outcomes == core.EPISODE_FAILED,
            outcomes == core.EPISODE_ARRIVED,
            infos | self._belief_info,
        )

    @property
    def _belief_info(self) -> dict[str, Any]:
        """The state of each car's learned quantities for ``infos``, empty if the controller does not learn."""
        if BELIEF_STATE not in self.names:
            return {}
        states = self._observations[:, self.names.index(BELIEF_STATE)].astype(np.int64)
        return {BELIEF_STATE: states, f"_{BELIEF_STATE}": np.ones(self.num_envs, bool)}

    def close_extras(self) -> None:
        """Stop the threads."""
        if self._pool is not None:
            self._pool.shutdown()

    def _apply_to_blocks(self, work: Callable[[CarBlock], None]) -> None:
        """Call a function for every block, in parallel if there are several threads."""
        if self._pool is None or len(self._blocks) == 1:
            for block in self._blocks:
                work(block)
        else:
            list(self._pool.map(work, self._blocks))

    # -- episodes -----------------------------------------------------------------------------------------------------
    def _begin(self, cars: NDArray[np.int64], options: dict[str, Any] | None) -> dict[str, Any]:
        """Draw and start new episodes of some cars; return their infos."""
        infos: dict[str, Any] = {}
        episodes = {int(car): self.task.draw(self._rngs[car], options) for car in cars}
        if not self._blocks:
            self._blocks = self._first_blocks(episodes[0])
        for i, block in enumerate(self._blocks):
            block_cars = [car for car in episodes if block.slots.start <= car < block.slots.stop]
            if block_cars and self.task.randomised:
                self._blocks[i] = block = self._block(block.slots, episodes[block_cars[0]])
            for car in block_cars:
                self._schedule_start(block, car, episodes[car])
            if block_cars:
                core.renew(block.resident)  # starts the scheduled episodes
                self._observations[block_cars, self._step_columns :] = self._constant_columns(block.batch)
        for car, episode in episodes.items():
            infos = self._add_info(infos, episode.info, car)
        return infos

    def _first_blocks(self, episode: Episode) -> list[CarBlock]:
        size = 1 if self.task.randomised else core.SLOTS
        slots = [slice(i, min(i + size, self.num_envs)) for i in range(0, self.num_envs, size)]
        return [self._block(slot, episode) for slot in slots]

    def _block(self, slots: slice, episode: Episode) -> CarBlock:
        """Return a block of cars with the plant and profile of an episode, which writes to the environment's arrays."""
        task, roads = self.task, range(len(self.task.roads))
        drives = [episode.drive] if task.randomised else [task.drive(i, episode.vehicle) for i in roads]
        batch = Batch(
            episode.plant, self._controller(episode), drives, episode.profile, task.driver, task.failure,  # type: ignore[arg-type]
            task.perception,
        )  # fmt: skip
        size, space = slots.stop - slots.start, self.single_observation_space
        run = batch.run_record(
            size, int(batch.substeps.max()), Room(*self._longest_horizons, residuals=False),
            asks=True, needs_variables=True, weight=batch.world.profile.move_weight,
        )  # fmt: skip
        episodes = core.Episodes(
            run, self._episode_states[slots],
            core.ObservationSpace(self.distances, space.low.copy(), space.high.copy()),  # type: ignore[attr-defined]
            self._observations[slots], task.cost_of_failure(batch.world.failure.distance),
        )  # fmt: skip
        return CarBlock(slots, batch, episode.vehicle, episodes, core.Resident(episodes))

    def _schedule_start(self, block: CarBlock, car: int, episode: Episode) -> None:
        """Set up a car of a block for a new episode, which the kernel `renew` then starts."""
        slot, run = car - block.slots.start, block.episodes.run
        road = 0 if self.task.randomised else episode.road
        run.inputs.scenario[slot], run.inputs.seeds[slot] = road, episode.noise_seed
        run.vehicles.start[slot], run.inputs.periods[slot] = block.batch.starts[road], block.batch.periods[road]
        self._episode_states["renewed"][car] = 1

    def _add_outcomes(self, cars: NDArray[np.int64], infos: dict[str, Any]) -> None:
        """Add failure and cost of the episodes of some cars, which have ended, to the infos."""
        for block in self._blocks:
            for car in cars[(cars >= block.slots.start) & (cars < block.slots.stop)]:
                run, slot = block.episodes.run, car - block.slots.start
                reason, _ = failure_of(int(run.memory.drives["ended"][slot]))
                cost = math.inf if reason else float(self._episode_states["total"][car] / run.inputs.periods[slot])
                self._add_info(infos, {"failed": reason or "", "J": cost}, int(car))

    def _constant_columns(self, batch: Batch) -> tuple[float, ...]:
        """Return the values of the constant columns at the end of an observation."""
        return ()
