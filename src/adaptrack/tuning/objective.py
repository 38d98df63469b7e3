"""Cost of a tuning at an operating point, and the best tuning that a swarm finds there, with compiled runs.

An operating point is (speed m/s, y_ref m, friction, wind m/s), constant during the run. Random numbers depend on a seed
and a stream number only, so a result depends on its own arguments only.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.control.controllers import MPC
from adaptrack.control.controllers.base import Room
from adaptrack.core.kernel import Resident
from adaptrack.core.maths.portable import Array
from adaptrack.core.plants.contract import SLOTS
from adaptrack.core.tuning import tune as kernel
from adaptrack.drive.batch import Batch
from adaptrack.drive.failure import FailureLimits
from adaptrack.scenario import Scenario, load_scenario
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmSettings
from adaptrack.tuning.runs import RunSet

_Trial = Callable[[Array, Array], tuple[Array, int]]
"""From tunings (n, 4), and the cost (n,) at which each may be stopped, to J (n,) and the control steps simulated."""


@dataclass(frozen=True, eq=False)
class PointTuning:
    """Best tuning that a swarm found at one operating point."""

    tuning: Array
    """Np, Nc, Q and R, (4,)."""
    cost: float
    """Its cost J (m^2), infinite if every run failed."""
    trace: Array
    """Lowest cost up to each generation (m^2), (generations,)."""
    evaluations: int
    """Number of tunings that were evaluated."""
    control_steps: int
    """Number of simulated control steps. A run stops once it cannot improve on the best cost of its particle."""


@checked
@dataclass(frozen=True, eq=False)
class Objective:
    """Cost J = mean e^2 + move_weight * mean (change of command)^2 (m^2) of a test run at an operating point.

    Raises
    ------
    InvalidInput
        For an unknown profile, an empty list of noise seeds, or an MPC that does not run compiled.
    """

    plant: Plant | SteppedPlant
    """Simulated plant. A plant that is stepped in Python is driven one run at a time, in one thread."""
    mpc: MPC
    """Controller; its tuning is ignored."""
    test: Literal["step", "lane-change"] = "step"
    """Test: "step" (constant y_ref from y = 0) or "lane-change" (smooth, with a gust of the point's wind speed)."""
    profile: str | Profile = "paper"
    """Steering actuator, sensors and control period, or the name of a profile."""
    noise_seeds: tuple[int, ...] = (0,)
    """Seeds of the sensor noise; J is the mean over them."""
    move_weight: float | None = None
    """Weight of the command changes (m^2/rad^2); None for the weight of the profile."""
    duration: float | None = None
    """Duration of the test (s); None for 18 s (step) or 8 s (lane change)."""
    failure: FailureLimits | None = None
    """Rule by which a run fails; None for the rule of the domain of the plant's car."""

    def __post_init__(self) -> None:
        if not self.noise_seeds:
            raise InvalidInput("noise_seeds: give at least one.")
        object.__setattr__(self, "profile", load_profile(self.profile))
        object.__setattr__(self, "_single_thread", threading.Lock())

    @property
    def weight(self) -> float:
        """The weight of the command changes in J (m^2/rad^2)."""
        assert isinstance(self.profile, Profile)
        return self.profile.move_weight if self.move_weight is None else self.move_weight

    def scenario(self, point: ArrayLike) -> Scenario:
        """Return the scenario of the test at an operating point (4,)."""
        speed, y_ref, friction, wind = np.asarray(point, dtype=float).tolist()
        if self.test == "step":
            duration = self.duration or 18.0
            return load_scenario("step", amplitude=y_ref, speed=speed, friction=friction, wind=wind, duration=duration)
        return load_scenario(
            "lane-change", amplitude=y_ref, speed=speed, friction=friction, gust=wind, duration=self.duration or 8.0
        )

    def costs(self, point: ArrayLike, tunings: ArrayLike) -> Array:
        """Return J (n,) of each tuning (n, 4) at an operating point (4,), infinite if a run failed."""
        rows = np.array(tunings, dtype=np.float64, ndmin=2)
        costs, _ = self._trial(point, len(rows), *rows.max(axis=0)[:2])(rows, np.full(len(rows), np.inf))
        return costs

    def tune(
        self,
        point: ArrayLike,
        swarm: SwarmSettings | None = None,
        seed: int = 0,
        stream: int = 0,
        space: SearchSpace | None = None,
    ) -> PointTuning:
        """Return the best tuning that one swarm finds at an operating point.

        Parameters
        ----------
        point
            Operating point, (4,).
        swarm
            Settings of the swarm.
        seed, stream
            Seed and stream number of its random numbers.
        space
            Bounds of the tuning; None for `SearchSpace.tuning`.
        """
        search = Swarm(space or SearchSpace.tuning(), swarm, seed=seed, stream=stream)
        trial, steps = self._trial(point, search.settings.particles, *search.space.high[:2]), 0
        while not search.is_done:
            costs, simulated_steps = trial(search.ask(), search.best_costs)
            search.tell(costs)
            steps += simulated_steps
        result = search.result()
        return PointTuning(result.x, result.cost, result.trace, result.evaluations, steps)

    def _trial(self, point: ArrayLike, count: int, max_Np: float, max_Nc: float) -> _Trial:
        """Return the trial of `count` tunings at an operating point, with horizons of up to max_Np and max_Nc."""
        if isinstance(self.plant, SteppedPlant):
            return partial(self._simulated_trial, point)
        batch = Batch(self.plant, self.mpc, [self.scenario(point)], self.profile, failure=self.failure)
        slots, room = min(count, SLOTS), Room(max_Np, max_Nc, residuals=False)
        run = batch.run_record(slots, int(batch.substeps[0]), room, weight=self.weight)
        run.vehicles.start[:] = batch.starts
        record = Resident(kernel.Trial(run, np.array(self.noise_seeds, dtype=np.int64)))

        def trial(tunings: Array, cost_limits: Array) -> tuple[Array, int]:
            costs = np.empty(len(tunings))
            evaluation = kernel.TuningCosts(np.ascontiguousarray(tunings), cost_limits, costs)
            groups = range(0, count, slots)
            return costs, sum(kernel.evaluate(first, min(slots, count - first), evaluation, record) for first in groups)

        return trial

    def _simulated_trial(self, point: ArrayLike, tunings: Array, cost_limits: Array) -> tuple[Array, int]:
        """Try tunings with `simulate`, one run at a time; every run is driven to its end."""
        with self._single_thread:  # type: ignore[attr-defined]
            runs = RunSet(self.plant, self.mpc, [self.scenario(point)], self.profile, failure=self.failure)
            runs.weight = self.weight
            costs = runs.drive(tunings, self.noise_seeds, np.zeros(len(tunings), np.int64)).mean(axis=1)
        return costs, len(tunings) * len(self.noise_seeds) * runs.periods
