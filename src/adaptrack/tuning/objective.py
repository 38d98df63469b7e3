"""The cost of a tuning on a condition, and the best tuning that a swarm finds there: compiled closed-loop runs.

A condition is (speed m/s, y_ref m, friction, wind m/s), held over the run. Random numbers are counted by seed and
stream, never shared, so a result depends on its own arguments only.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput
from adaptrack.controllers import MPC
from adaptrack.plant import Plant
from adaptrack.profile import Profile, load_profile
from adaptrack.scenario import Scenario, load_scenario
from adaptrack.simulate import Batch, vehicle_arrays
from adaptrack.tuning.pso import SearchSpace, SwarmSettings

Array = NDArray[np.float64]

CONDITION = ("speed", "y_ref", "friction", "wind")
"""The entries of a condition: m/s, m, -, m/s along +Y."""


@dataclass(frozen=True, eq=False)
class Tuned:
    """What a swarm found on one condition."""

    tuning: Array
    """(4,) Np, Nc, Q, R"""
    cost: float
    """m^2, inf when every run was lost"""
    trace: Array
    """(generations,) m^2, the best cost after each"""
    evaluations: int
    control_steps: int
    """control steps simulated; runs that could not improve any more were stopped"""


@dataclass(frozen=True, eq=False)
class Objective:
    """J = mean e^2 + move_price * mean (change of command)^2 of a run under a condition.

    plant, mpc: what is driven, by which controller (its tuning is ignored); test: `step` (the paper: constant y_ref
    from y = 0) or `lane-change` (smooth, with one gust of the condition's wind); profile: with its noise, J is the
    mean over `noise_seeds`; move_price: m^2/rad^2, None for the profile's; duration: s, None for 18 (step) or 8.

    Raises
    ------
    InvalidInput
        For an unknown test or profile, no noise seed, or an MPC that does not run compiled.
    """

    plant: Plant
    mpc: MPC
    test: Literal["step", "lane-change"] = "step"
    profile: str | Profile = "paper"
    noise_seeds: tuple[int, ...] = (0,)
    move_price: float | None = None
    duration: float | None = None
    lost_beyond: float = 1000.0
    """m, a run is lost when |Y - y_ref| exceeds this"""
    spin_beyond: float = math.inf
    """or |v_y/v_x| this"""

    def __post_init__(self) -> None:
        if self.test not in ("step", "lane-change"):
            raise InvalidInput(f"test = {self.test!r}: must be 'step' or 'lane-change'.")
        if not self.noise_seeds:
            raise InvalidInput("noise_seeds: give at least one.")
        object.__setattr__(self, "profile", load_profile(self.profile))

    @property
    def price(self) -> float:
        """The price of steering activity in use (m^2/rad^2)."""
        assert isinstance(self.profile, Profile)
        return self.profile.move_weight if self.move_price is None else self.move_price

    def scenario(self, condition: ArrayLike) -> Scenario:
        """The run under a condition."""
        speed, y_ref, friction, wind = np.asarray(condition, dtype=float).tolist()
        if self.test == "step":
            duration = self.duration or 18.0
            return load_scenario("step", amplitude=y_ref, speed=speed, friction=friction, wind=wind, duration=duration)
        return load_scenario(
            "lane-change", amplitude=y_ref, speed=speed, friction=friction, gust=wind, duration=self.duration or 8.0
        )

    def costs(self, condition: ArrayLike, tunings: ArrayLike) -> Array:
        """J of each of the tunings (n, 4) on one condition, (n,); inf where a run was lost."""
        from adaptrack.kernels import tuning as kernels
        from adaptrack.kernels.integrate import LANES

        asked = np.array(tunings, dtype=np.float64, ndmin=2)
        costs = np.empty(len(asked))
        arena = _Arena(self, condition, min(len(asked), LANES), asked[:, 0].max(), asked[:, 1].max())
        for first in range(0, len(asked), LANES):
            part = np.ascontiguousarray(asked[first : first + LANES])
            found = np.empty(len(part))
            never = np.full(len(part), np.inf)
            arena.memory[:, arena.key] = np.nan
            kernels.evaluate(part, never, arena.noise, self.price, found, *arena.arguments(len(part)))
            costs[first : first + LANES] = found
        return costs

    landscape = costs
    """J of a common library of tunings on one condition: the same numbers under the name that campaigns use."""

    def tune(
        self,
        condition: ArrayLike,
        swarm: SwarmSettings | None = None,
        seed: int = 0,
        stream: int = 0,
        space: SearchSpace | None = None,
    ) -> Tuned:
        """The best tuning that one swarm finds on a condition; the swarm's random numbers are those of its stream."""
        from adaptrack.kernels import swarm as rules
        from adaptrack.kernels import tuning as kernels
        from adaptrack.kernels.integrate import LANES

        swarm, space = swarm or SwarmSettings(), space or SearchSpace.tuning()
        lanes = min(swarm.particles, LANES)
        arena = _Arena(self, condition, lanes, space.high[0], space.high[1])
        particles = rules.particles(swarm.particles, 4)
        trace = np.empty(swarm.generations)
        evaluations, steps = kernels.tune(
            seed, stream, swarm.packed(space), space.packed(), particles, np.zeros((swarm.particles, 4)), trace,
            np.empty(swarm.particles),
            arena.noise, self.price, *arena.arguments(lanes),
        )  # fmt: skip
        return Tuned(
            space.values(particles.leader), float(particles.progress[rules.LEADER_COST]), trace, evaluations, steps
        )


class _Arena:
    """The kernels' arrays for runs of one condition."""

    def __init__(self, objective: Objective, condition: ArrayLike, lanes: int, longest: float, most: float) -> None:
        from adaptrack.kernels import loop

        batch = Batch(
            objective.plant, objective.mpc, [objective.scenario(condition)], objective.profile,
            lost_beyond=objective.lost_beyond, spin_beyond=objective.spin_beyond,
        )  # fmt: skip
        settings = batch.sized(longest, most)
        block, own, scratch = vehicle_arrays(batch.plant)
        self.key = loop.KEY
        self.noise = np.array(objective.noise_seeds, dtype=np.int64)
        self.memory = loop.memory(lanes)
        self._fixed: tuple[Any, ...] = (
            batch.function, batch.packed, block, own, scratch, batch.model, settings,
            batch.loops[int(batch.substeps[0])], batch.samples,
            np.zeros(lanes, np.int64), np.zeros(lanes, np.int64), self.memory, np.zeros((lanes, len(loop.RECORD))),
            loop.workspace(lanes, settings), loop.scheduling(), np.zeros((0, 2)),
            np.repeat(batch.starts, lanes, axis=0), np.zeros(lanes), np.zeros((lanes, 0)),
            np.zeros((lanes, len(loop.RESULT))), np.zeros((lanes, 0, loop.TRACE)),
        )  # fmt: skip
        self._periods = batch.signals[0].n

    def arguments(self, lanes: int) -> tuple[Any, ...]:
        """The arguments of `kernels.tuning.evaluate` and `tune` that stay the same."""
        return (self._periods, lanes, *self._fixed)
