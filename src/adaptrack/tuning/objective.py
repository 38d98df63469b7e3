"""The cost of a tuning on an operating point, and the best tuning that a swarm finds there, by compiled runs.

An operating point is (speed m/s, y_ref m, friction, wind m/s), held over the run. Random numbers are counted by seed
and stream, never shared, so a result depends on its own arguments only.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import Plant, SteppedPlant
from adaptrack.control.controllers import MPC
from adaptrack.core import swarm as rules
from adaptrack.core import tune as kernels
from adaptrack.core.kernel import Resident
from adaptrack.core.period import RunSpan
from adaptrack.core.plants.contract import SLOTS
from adaptrack.drive.batch import Batch
from adaptrack.drive.failure import Failure
from adaptrack.scenario import Scenario, load_scenario
from adaptrack.scenario.profile import Profile, load_profile
from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmSettings
from adaptrack.tuning.runs import RunSet

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Tuned:
    """Result of a swarm on one operating point."""

    tuning: Array
    """(4,) Np, Nc, Q, R"""
    cost: float
    """m^2, inf when every run failed"""
    trace: Array
    """(generations,) m^2, the best cost after each"""
    evaluations: int
    control_steps: int
    """control steps simulated; runs that could not improve any more were stopped"""


@checked
@dataclass(frozen=True, eq=False)
class Objective:
    """J = mean e^2 + move_weight * mean (change of command)^2 of a run on an operating point.

    plant, mpc: what is driven, by which controller (its tuning is ignored); a plant that is stepped in Python is driven
    run by run, one thread at a time; test: `step` (the paper: constant y_ref
    from y = 0) or `lane-change` (smooth, with one gust of the operating point's wind); profile: with its noise, J is
    the mean over `noise_seeds`; move_weight: m^2/rad^2, None for the profile's; duration: s, None for 18 (step) or 8.

    Raises
    ------
    InvalidInput
        For an unknown profile, no noise seed, or an MPC that does not run compiled.
    """

    plant: Plant | SteppedPlant
    mpc: MPC
    test: Literal["step", "lane-change"] = "step"
    profile: str | Profile = "paper"
    noise_seeds: tuple[int, ...] = (0,)
    move_weight: float | None = None
    duration: float | None = None
    failure: Failure | None = None
    """when a run has failed, by default as the driven car's domain says"""

    def __post_init__(self) -> None:
        if not self.noise_seeds:
            raise InvalidInput("noise_seeds: give at least one.")
        object.__setattr__(self, "profile", load_profile(self.profile))
        object.__setattr__(self, "_alone", threading.Lock())

    @property
    def weight(self) -> float:
        """The weight of steering activity in use (m^2/rad^2)."""
        assert isinstance(self.profile, Profile)
        return self.profile.move_weight if self.move_weight is None else self.move_weight

    def scenario(self, point: ArrayLike) -> Scenario:
        """The run on an operating point."""
        speed, y_ref, friction, wind = np.asarray(point, dtype=float).tolist()
        if self.test == "step":
            duration = self.duration or 18.0
            return load_scenario("step", amplitude=y_ref, speed=speed, friction=friction, wind=wind, duration=duration)
        return load_scenario(
            "lane-change", amplitude=y_ref, speed=speed, friction=friction, gust=wind, duration=self.duration or 8.0
        )

    def costs(self, point: ArrayLike, tunings: ArrayLike) -> Array:
        """J of each of the tunings (n, 4) on one operating point, (n,); inf where a run failed."""
        rows = np.array(tunings, dtype=np.float64, ndmin=2)
        if isinstance(self.plant, SteppedPlant):
            return self._simulated_costs(point, rows)
        costs = np.empty(len(rows))
        run, trial = self._trial(point, min(len(rows), SLOTS), rows[:, 0].max(), rows[:, 1].max())
        evaluation = kernels.Judged(np.ascontiguousarray(rows), np.full(len(rows), np.inf), costs)
        for first in range(0, len(rows), SLOTS):
            run.mpc.memory["speed"] = np.nan  # nothing is formed yet
            kernels.evaluate(first, min(SLOTS, len(rows) - first), evaluation, trial)
        return costs

    landscape = costs
    """J of a common library of tunings on one operating point: the same numbers under the name that campaigns use."""

    def tune(
        self,
        point: ArrayLike,
        swarm: SwarmSettings | None = None,
        seed: int = 0,
        stream: int = 0,
        space: SearchSpace | None = None,
    ) -> Tuned:
        """The best tuning that one swarm finds on an operating point; its random numbers are those of its stream."""
        swarm, space = swarm or SwarmSettings(), space or SearchSpace.tuning()
        if isinstance(self.plant, SteppedPlant):
            return self._searched(point, Swarm(space, swarm, seed=seed, stream=stream))
        slots, count = min(swarm.particles, SLOTS), swarm.particles
        _, trial = self._trial(point, slots, space.high[0], space.high[1])
        evaluation = kernels.Judged(np.zeros((count, 4)), np.empty(count), np.empty(count))
        search = kernels.SearchRecord(
            seed, stream, swarm.packed(space), space.packed(), rules.particles(count, 4), evaluation,
            np.empty(swarm.generations),
        )  # fmt: skip
        evaluations, steps = kernels.tune(search, trial)
        best = search.swarm
        return Tuned(
            space.values(best.leader), float(best.progress[rules.LEADER_COST]), search.best, evaluations, steps
        )

    def _simulated_costs(self, point: ArrayLike, tunings: Array) -> Array:
        """`costs` by `simulate`, one run after the other."""
        with self._alone:  # type: ignore[attr-defined]
            runs = RunSet(self.plant, self.mpc, [self.scenario(point)], self.profile, failure=self.failure)
            runs.weight = self.weight
            return runs.drive(tunings, self.noise_seeds, np.zeros(len(tunings), np.int64)).mean(axis=1)

    def _searched(self, point: ArrayLike, swarm: Swarm) -> Tuned:
        """`tune` by `costs`: the same answer, every run driven to its end."""
        while not swarm.is_done:
            swarm.tell(self.costs(point, swarm.ask()))
        result, runs = swarm.result(), swarm.settings.evaluations * len(self.noise_seeds)
        steps = runs * self.scenario(point).sample(self.mpc.period).n
        return Tuned(result.x, result.cost, result.trace, result.evaluations, steps)

    def _trial(self, point: ArrayLike, slots: int, longest: float, most: float) -> tuple[Any, Any]:
        """`core.tune.Trial` for up to `slots` tunings with horizons up to these; before it, its runs."""
        assert isinstance(self.plant, Plant)
        batch = Batch(self.plant, self.mpc, [self.scenario(point)], self.profile, failure=self.failure)
        run = batch.run_record(slots, int(batch.substeps[0]), batch.mpc_settings(longest, most, residuals=False))
        run.vehicles.start[:] = batch.starts
        noise = np.array(self.noise_seeds, dtype=np.int64)
        span = RunSpan(batch.signals[0].n, slots, 0, self.weight)
        return run, Resident(kernels.Trial(run, span, noise))
