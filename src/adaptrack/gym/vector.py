"""Many cars at once on the compiled batches: the environments of this room as `gymnasium.vector.VectorEnv`."""

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
from adaptrack.control.controllers import MPC, Controller
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.core.public import (
    EPISODE,
    EPISODE_ARRIVED,
    EPISODE_FAILED,
    EPISODE_RUNS,
    MEASUREMENT,
    SLOTS,
    Episodes,
    ObservationSpace,
    Resident,
    arrive,
    control,
    renew,
    steer,
    write_observations,
    write_variables,
)
from adaptrack.drive.batch import Batch
from adaptrack.drive.world import reason_of
from adaptrack.gym.mpc_tuning import TUNING_PERIODS
from adaptrack.gym.spaces import (
    BELIEF_STATE,
    DISTANCES,
    Tunings,
    box,
    checked_action,
    checked_distances,
    command_box,
    first_belief,
    make_mpc,
    observation_box,
    observation_names,
    variables_within,
)
from adaptrack.gym.task import Episode, Outside, Task

Array = NDArray[np.float64]


class CarBlock(NamedTuple):
    """Cars that are driven together, and where they stand among all."""

    slots: slice
    batch: Batch
    episodes: Any
    """Packed episodes, a record `core.episode.Episodes`."""
    resident: Any
    """The episodes resident in memory, `core.kernel.Resident`."""


class _VectorEnv(VectorEnv):
    """Cars in blocks of up to 32, each at its own instant. A car that is over begins anew in the next step."""

    metadata: dict[str, Any] = {  # noqa: RUF012 - gymnasium's own form
        "render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP,
    }  # fmt: skip

    def __init__(self, num_envs: int, threads: int, task: Task) -> None:
        self.num_envs, self.task = whole_number("num_envs", "num_envs", num_envs), task
        self.threads = whole_number("vector environment", "threads", threads)
        if isinstance(task.known_as, FrictionWindEstimator):
            raise InvalidInput("known_as: a FrictionWindEstimator needs Python at every step: one car at a time.")
        self._set_spaces()
        self.action_space = batch_space(self.single_action_space, self.num_envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self._own = EPISODE.new(self.num_envs)
        self._observed = np.zeros((self.num_envs, len(self.names)))
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
        """A block of a copy, its episodes and observations again rows of the environment's arrays."""
        own_states, observations = self._own[block.slots], self._observed[block.slots]
        episodes = block.episodes._replace(own=own_states, observations=observations)
        return block._replace(episodes=episodes, resident=Resident(episodes))

    names: tuple[str, ...]
    """of the columns of an observation"""

    @abstractmethod
    def _set_spaces(self) -> None:
        """Set the spaces of one car, and the names."""

    @abstractmethod
    def _controller(self, episode: Episode) -> Controller:
        """Return the controller of the batch for an episode's car."""

    @abstractmethod
    def _take(self, actions: Array) -> None:
        """Take in what is to be done."""

    @abstractmethod
    def _drive(self, block: CarBlock) -> None:
        """Drive a block."""

    @abstractmethod
    def _look(self, block: CarBlock) -> None:
        """Write the observations of a block."""

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """Begin all episodes; seed: car i has seed + i, as in `gymnasium.vector.SyncVectorEnv`; or one for each.

        A car has the run that the environment of one car has with its seed. options: as there, for all cars alike.
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
        self._apply_to_blocks(self._look)
        return self._observed.copy(), infos | self._belief_info

    def step(self, actions: Any) -> tuple[Array, Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Drive all cars by a step; one whose episode was over begins its next one, with reward 0."""
        if not self._blocks:
            raise gymnasium.error.ResetNeeded("call reset() first: no run has begun.")
        self._take(checked_action(actions, self.action_space))  # type: ignore[arg-type]
        waiting = np.flatnonzero(self._own["over"] != EPISODE_RUNS)
        self._own["cost"] = 0.0
        self._apply_to_blocks(self._drive)
        self._own["total"] += self._own["cost"]
        rewards = -self._own["cost"]
        over = self._own["over"].copy()
        over[waiting] = EPISODE_RUNS
        infos = self._begin(waiting, None) if waiting.size else {}
        self._apply_to_blocks(self._look)
        if over.any():
            self._say_how(np.flatnonzero(over), infos)
        return (
            self._observed.copy(),
            rewards,
            over == EPISODE_FAILED,
            over == EPISODE_ARRIVED,
            infos | self._belief_info,
        )

    @property
    def _belief_info(self) -> dict[str, Any]:
        """Return the learned quantities of each car's controller for ``infos``."""
        if BELIEF_STATE not in self.names:
            return {}
        states = self._observed[:, self.names.index(BELIEF_STATE)].astype(np.int64)
        return {BELIEF_STATE: states, f"_{BELIEF_STATE}": np.ones(self.num_envs, bool)}

    def close_extras(self) -> None:
        """Let the threads go."""
        if self._pool is not None:
            self._pool.shutdown()

    def _apply_to_blocks(self, work: Callable[[CarBlock], None]) -> None:
        """Do the same to every block."""
        if self._pool is None or len(self._blocks) == 1:
            for block in self._blocks:
                work(block)
        else:
            list(self._pool.map(work, self._blocks))

    # -- episodes -----------------------------------------------------------------------------------------------------
    def _begin(self, cars: NDArray[np.int64], options: dict[str, Any] | None) -> dict[str, Any]:
        """Draw the next episodes of some cars and begin them."""
        infos: dict[str, Any] = {}
        drawn = {int(car): self.task.draw(self._rngs[car], options) for car in cars}
        if not self._blocks:
            self._blocks = self._first_blocks(drawn[0])
        for i, block in enumerate(self._blocks):
            block_cars = [car for car in drawn if block.slots.start <= car < block.slots.stop]
            if block_cars and self.task.randomised:
                self._blocks[i] = block = self._block(block.slots, drawn[block_cars[0]])
            for car in block_cars:
                self._place(block, car, drawn[car])
            if block_cars:
                renew(block.resident)
                arrive(block.resident)
                self._observed[block_cars, self._own_columns :] = self._constant(block.batch)
        for car, episode in drawn.items():
            infos = self._add_info(infos, episode.info, car)
        return infos

    def _first_blocks(self, episode: Episode) -> list[CarBlock]:
        size = 1 if self.task.randomised else SLOTS
        slots = [slice(i, min(i + size, self.num_envs)) for i in range(0, self.num_envs, size)]
        return [self._block(slot, episode) for slot in slots]

    def _block(self, slots: slice, episode: Episode) -> CarBlock:
        """A block of cars of an episode's kind; what it measures lies in the arrays of the environment."""
        task = self.task
        roads = range(len(task.roads))
        drives = [episode.drive] if task.randomised else [task.drive(i, episode.vehicle) for i in roads]
        batch = Batch(
            episode.plant, self._controller(episode), drives, episode.profile, task.driver, task.failure,  # type: ignore[arg-type]
            task.known_as,
        )  # fmt: skip
        size, space = slots.stop - slots.start, self.single_observation_space
        settings = batch.mpc_settings(*self._longest, residuals=False)
        run = batch.run_record(size, int(batch.substeps.max()), settings)
        world = batch.world
        episodes = Episodes(
            run, self._own[slots], np.zeros((size, len(MEASUREMENT))),
            ObservationSpace(self._distances, space.low.copy(), space.high.copy()),  # type: ignore[attr-defined]
            self._observed[slots],
            world.profile.move_weight, task.cost_of_failure(world.failure.distance),
        )  # fmt: skip
        return CarBlock(slots, batch, episodes, Resident(episodes))

    def _place(self, block: CarBlock, car: int, episode: Episode) -> None:
        """Mark a car as renewed in its block, at the start of its episode."""
        slot, run = car - block.slots.start, block.episodes.run
        road = 0 if self.task.randomised else episode.road
        run.given.scenario[slot], run.given.seeds[slot] = road, episode.noise_seed
        run.vehicles.start[slot] = block.batch.starts[road]
        self._own["last"][car], self._own["renewed"][car] = block.batch.periods[road], 1

    def _say_how(self, cars: NDArray[np.int64], infos: dict[str, Any]) -> None:
        """How the episodes of some cars have ended."""
        for block in self._blocks:
            for car in cars[(cars >= block.slots.start) & (cars < block.slots.stop)]:
                reason = reason_of(int(block.episodes.run.memory.own["ended"][car - block.slots.start]))
                cost = math.inf if reason else float(self._own["total"][car] / self._own["last"][car])
                self._add_info(infos, {"failed": reason or "", "J": cost}, int(car))

    _distances = np.zeros(0)
    _longest = (1.0, 1.0)
    """Np and Nc that may be chosen"""
    _own_columns = 0
    """Columns of an observation that are written at every step; those behind stay as they are."""

    def _constant(self, batch: Batch) -> tuple[float, ...]:
        """Constant columns at the end of an observation."""
        return ()


class PathTrackingVectorEnv(_VectorEnv):
    """`adaptrack/PathTracking-v0` for many cars at once, compiled; spaces, rewards and ends are those of one car.

    Car i has the run, to the bit, of `PathTrackingEnv` with its seed. Several roads share the integration steps of the
    fastest, and each has errors of perception of its own (`known_as`): with them the runs agree on one road only.

    num_envs: cars; threads: over which blocks of 32 cars are spread;
    distances, task: as there. With random cars each car is a block of its own, which takes longer. A user's plant in
    Python cannot take part.

    A car whose episode is over begins its next one in the next step, whose action is not used and whose reward is 0
    (`AutoresetMode.NEXT_STEP`).

    Raises
    ------
    InvalidInput
        For arguments, options or actions that are not allowed.
    """

    def __init__(
        self, num_envs: int = 64, *, threads: int = 1, distances: Sequence[float] = DISTANCES, **task: Any
    ) -> None:
        self._distances = checked_distances(distances)
        super().__init__(num_envs, threads, Task(**task))
        self._commands = np.zeros(self.num_envs)

    def _set_spaces(self) -> None:
        self.names = observation_names(self._distances)
        self.single_action_space = command_box(self.task)
        self.single_observation_space = observation_box(self._distances)
        self._own_columns = len(self.names)

    def _controller(self, episode: Episode) -> Controller:
        return Outside(episode.profile.period)

    def _take(self, actions: Array) -> None:
        self._commands[:] = actions[:, 0]

    def _drive(self, block: CarBlock) -> None:
        steer(self._commands[block.slots], block.resident)
        arrive(block.resident)

    def _look(self, block: CarBlock) -> None:
        write_observations(block.resident)


class MPCTuningVectorEnv(_VectorEnv):
    """`adaptrack/MPCTuning-v0` for many cars at once, compiled; the rest as in `PathTrackingVectorEnv`.

    controller, every: as in `MPCTuningEnv`.

    Raises
    ------
    InvalidInput
        For arguments, options or actions that are not allowed.
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
        vehicle, _, profile = self.task.known_car()
        mpc = make_mpc(self.controller, vehicle, profile)
        within = variables_within(mpc)
        self.names = tuple(within)
        self.tunings = Tunings(mpc)
        self.single_action_space = self.tunings.box
        self.single_observation_space = box(list(within.values()))
        self._longest = float(self.tunings.high[0]), float(self.tunings.high[1])
        self._own_columns = len(within) - (0 if mpc.learner is not None else len(first_belief(mpc)))

    def _controller(self, episode: Episode) -> Controller:
        return make_mpc(self.controller, episode.vehicle, episode.profile)

    def _constant(self, batch: Batch) -> tuple[float, ...]:
        mpc = batch.controller
        assert isinstance(mpc, MPC)
        return () if mpc.learner is not None else first_belief(mpc)

    def _take(self, actions: Array) -> None:
        tunings = self.tunings.entries(actions)
        for block in self._blocks:
            block.episodes.run.tuning[:] = tunings[block.slots]

    def _drive(self, block: CarBlock) -> None:
        for _ in range(self.every):
            control(block.resident)
            arrive(block.resident)

    def _look(self, block: CarBlock) -> None:
        write_variables(block.resident)
