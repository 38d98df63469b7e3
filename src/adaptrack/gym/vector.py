"""Vector environments (`gymnasium.vector.VectorEnv`) that drive many cars at once in compiled batches."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from adaptrack.base.checked import whole_number
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import Room
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.core.public import (
    EPISODE,
    EPISODE_ARRIVED,
    EPISODE_FAILED,
    EPISODE_RUNS,
    SLOTS,
    Episodes,
    ObservationSpace,
    Resident,
    drive_on,
    renew,
    write_observations,
    write_variables,
)
from adaptrack.drive.batch import Batch
from adaptrack.drive.world import reason_of
from adaptrack.gym.acceleration import ACCELERATION_WEIGHT, SPEED_WEIGHT, AccelerationInput, task_of
from adaptrack.gym.mpc_tuning import TUNING_PERIODS
from adaptrack.gym.path_tracking import joint_spaces
from adaptrack.gym.spaces import (
    BELIEF_STATE,
    DISTANCES,
    Tunings,
    box,
    check_action,
    check_distances,
    initial_belief,
    make_mpc,
    variable_bounds,
)
from adaptrack.gym.task import Episode, ExternalCommands, Task

Array = NDArray[np.float64]


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


class _VectorEnv(VectorEnv):
    """Cars in blocks of up to 32, each at its own instant of its episode.

    A car whose episode has ended starts a new episode in the next step.
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - gymnasium's own form
        "render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP,
    }  # fmt: skip

    def __init__(self, num_envs: int, threads: int, task: Task) -> None:
        self.num_envs, self.task = whole_number("num_envs", "num_envs", num_envs), task
        self.threads = whole_number("vector environment", "threads", threads)
        if isinstance(task.perception, FrictionWindEstimator):
            raise InvalidInput("perception: a FrictionWindEstimator needs Python at every step: one car at a time.")
        self._set_spaces()
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._episode_states = EPISODE.new(self.num_envs)
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
        return block._replace(episodes=episodes, resident=Resident(episodes))

    names: tuple[str, ...]
    """Names of the columns of an observation."""

    @abstractmethod
    def _set_spaces(self) -> None:
        """Set the action and observation space of one car, and the names of the columns."""

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
        waiting = np.flatnonzero(self._episode_states["over"] != EPISODE_RUNS)
        self._episode_states["cost"] = 0.0
        self._apply_to_blocks(self._drive)
        self._episode_states["total"] += self._episode_states["cost"]
        rewards = -self._episode_states["cost"]
        outcomes = self._episode_states["over"].copy()
        outcomes[waiting] = EPISODE_RUNS
        infos = self._begin(waiting, None) if waiting.size else {}
        self._apply_to_blocks(self._write_observations)
        if outcomes.any():
            self._add_outcomes(np.flatnonzero(outcomes), infos)
        return (
            self._observations.copy(),
            rewards,
            outcomes == EPISODE_FAILED,
            outcomes == EPISODE_ARRIVED,
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
                renew(block.resident)  # starts the scheduled episodes
                self._observations[block_cars, self._step_columns :] = self._constant_columns(block.batch)
        for car, episode in episodes.items():
            infos = self._add_info(infos, episode.info, car)
        return infos

    def _first_blocks(self, episode: Episode) -> list[CarBlock]:
        size = 1 if self.task.randomised else SLOTS
        slots = [slice(i, min(i + size, self.num_envs)) for i in range(0, self.num_envs, size)]
        return [self._block(slot, episode) for slot in slots]

    def _block(self, slots: slice, episode: Episode) -> CarBlock:
        """Return a block of cars with the plant and profile of an episode, which writes to the environment's arrays."""
        task = self.task
        roads = range(len(task.roads))
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
        episodes = Episodes(
            run, self._episode_states[slots],
            ObservationSpace(self._distances, space.low.copy(), space.high.copy()),  # type: ignore[attr-defined]
            self._observations[slots], task.cost_of_failure(batch.world.failure.distance),
        )  # fmt: skip
        return CarBlock(slots, batch, episode.vehicle, episodes, Resident(episodes))

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
                reason = reason_of(int(run.memory.drives["ended"][slot]))
                cost = math.inf if reason else float(self._episode_states["total"][car] / run.inputs.periods[slot])
                self._add_info(infos, {"failed": reason or "", "J": cost}, int(car))

    _distances = np.zeros(0)
    _longest_horizons = (1.0, 1.0)
    """Largest Np and Nc of an action, control periods."""
    _step_columns = 0
    """Number of leading columns of an observation that change at every step; the others are constant."""

    def _constant_columns(self, batch: Batch) -> tuple[float, ...]:
        """Return the values of the constant columns at the end of an observation."""
        return ()


class PathTrackingVectorEnv(_VectorEnv):
    """`adaptrack/PathTracking-v0` for many cars at once, compiled. Each car is specified as in `PathTrackingEnv`.

    On a single road, car i has the same run, to the bit, as `PathTrackingEnv` with its seed. With several roads, runs
    may differ from those of `PathTrackingEnv` for two reasons:

    - The road with the highest speed determines the number of integration steps on all roads.
    - Each road has its own perception errors of friction and wind (`perception`).

    A car whose episode has ended starts a new episode in the next step. That step ignores its action and gives reward 0
    (`AutoresetMode.NEXT_STEP`).

    Parameters
    ----------
    num_envs
        Number of cars.
    threads
        Number of threads that share the blocks of 32 cars. With random cars each block contains one car only, which
        takes longer.
    distances, acceleration, speed_weight, acceleration_weight, task
        As in `PathTrackingEnv`, except that a user's plant must not be written in Python.

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
        distances: Sequence[float] = DISTANCES,
        acceleration: bool = False,
        speed_weight: float = SPEED_WEIGHT,
        acceleration_weight: float = ACCELERATION_WEIGHT,
        **task: Any,
    ) -> None:
        self._distances = check_distances(distances)
        speed = AccelerationInput(self._distances, speed_weight, acceleration_weight)
        self._speed = speed if acceleration else None
        super().__init__(num_envs, threads, task_of(acceleration, task))
        self._actions = np.zeros((self.num_envs, *self.single_action_space.shape))  # type: ignore[misc]
        self._accelerations = np.zeros(self.num_envs)

    def _set_spaces(self) -> None:
        self.single_action_space, self.single_observation_space, self.names = joint_spaces(
            self.task, self._distances, self._speed
        )
        self._step_columns = len(self.names)

    def _controller(self, episode: Episode) -> Controller:
        return ExternalCommands(episode.profile.period)

    def _schedule_start(self, block: CarBlock, car: int, episode: Episode) -> None:
        super()._schedule_start(block, car, episode)
        self._accelerations[car] = 0.0

    def _store_actions(self, actions: Array) -> None:
        self._actions[:] = actions

    def _drive(self, block: CarBlock) -> None:
        if self._speed is not None:
            states, last = self._episode_states[block.slots], self._accelerations[block.slots]
            cost = self._speed.request(self._actions[block.slots, 1], last, block.vehicle, block.episodes.run)
            states["cost"] += np.where(states["over"] == EPISODE_RUNS, cost, 0.0)
        block.episodes.run.controller.answer[:, 0] = self._actions[block.slots, 0]
        drive_on(block.resident)

    def _write_observations(self, block: CarBlock) -> None:
        write_observations(block.resident)
        if self._speed is not None:
            run, last = block.episodes.run, self._accelerations[block.slots]
            self._speed.observe(last, run, self._observations[block.slots])


class MPCTuningVectorEnv(_VectorEnv):
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
        self.controller, self.every = controller, whole_number("MPCTuning", "every", every)
        super().__init__(num_envs, threads, Task(**task))

    def _set_spaces(self) -> None:
        vehicle, _, profile = self.task.base_car()
        mpc = make_mpc(self.controller, vehicle, profile)
        bounds = variable_bounds(mpc)
        self.names = tuple(bounds)
        self.tunings = Tunings(mpc)
        self.single_action_space = self.tunings.box
        self.single_observation_space = box(list(bounds.values()))
        self._longest_horizons = float(self.tunings.high[0]), float(self.tunings.high[1])
        self._step_columns = len(bounds) - (0 if mpc.learner is not None else len(initial_belief(mpc)))

    def _controller(self, episode: Episode) -> Controller:
        return make_mpc(self.controller, episode.vehicle, episode.profile)

    def _constant_columns(self, batch: Batch) -> tuple[float, ...]:
        return () if batch.controller.learner is not None else initial_belief(batch.controller)

    def _store_actions(self, actions: Array) -> None:
        tunings = self.tunings.entries(actions)
        for block in self._blocks:
            block.episodes.run.controller.tuning[:] = tunings[block.slots]

    def _drive(self, block: CarBlock) -> None:
        for _ in range(self.every):
            drive_on(block.resident)

    def _write_observations(self, block: CarBlock) -> None:
        write_variables(block.resident)
