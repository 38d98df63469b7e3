"""The one tuning that is best on a whole set of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Controller
from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmResult, SwarmSettings
from adaptrack.tuning.runs import Retuned, RunSet
from adaptrack.tuning.spaces import at_bounds, search_space

LEAST_TUNINGS = 10
"""That a search must be able to try."""


def tune_constant(
    runs: RunSet, swarm: SwarmSettings | None = None, *, noise_seeds: Sequence[int] = (0,), seed: int = 0,
    controller: Controller | None = None, space: SearchSpace | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SwarmResult:  # fmt: skip
    """The tuning of a controller with the lowest mean cost over a set of runs, found by one swarm.

    The cost is the mean of J (m^2, see `adaptrack.runs`) over the runs and the noise seeds; a failed run counts as
    `RunSet.failed_cost`. Runs may differ in length, such as drives along roads. controller: a compiled one, by default
    the run set's MPC; space: of its tuning entries, by default its `search_space`; progress: called with (generations
    done, generations).

    Returns
    -------
    SwarmResult
        `x` is the tuning, in the order of the controller's `tuning_names`, `cost` its cost.

    Raises
    ------
    InvalidInput
        When no noise seed is given, or no space is known for the controller.
    """
    if not noise_seeds:
        raise InvalidInput("tune_constant: noise_seeds: give at least one.")
    tuned = runs.mpc if controller is None else controller
    search = Swarm(space or search_space(tuned), swarm, seed=seed)
    while not search.is_done:
        if progress is not None:
            progress(search.generation, search.settings.generations)
        search.tell(mean_costs(runs, tuned, search.ask(), noise_seeds))
    return search.result()


@dataclass(frozen=True)
class Sought:
    """A controller's tuning after a search, which keeps its own where nothing better was found; entries by name."""

    tuning: dict[str, float]
    default: dict[str, float]
    """the controller's own"""
    cost: float
    """m^2, of the tuning, see `tune_constant`"""
    default_cost: float
    at_bounds: list[str]
    """entries of the tuning at an end of the space: a better value may lie beyond"""

    @property
    def better(self) -> bool:
        """Whether the search found something better than the default."""
        return self.cost < self.default_cost


def seek_constant(
    runs: RunSet, controller: Controller, swarm: SwarmSettings, *, noise_seeds: Sequence[int], seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Sought:  # fmt: skip
    """`tune_constant` in the controller's `search_space`, held against its own tuning on the same runs and noise."""
    space = search_space(controller)
    result = tune_constant(
        runs, swarm, noise_seeds=noise_seeds, seed=seed, controller=controller, space=space, progress=progress
    )
    default = controller.packed_tuning()
    before = float(mean_costs(runs, controller, default[None], noise_seeds)[0])
    better = result.cost < before
    return Sought(
        tuning=dict(zip(space.names, (result.x if better else default).tolist(), strict=True)),
        default=dict(zip(space.names, default.tolist(), strict=True)),
        cost=min(result.cost, before),
        default_cost=before,
        at_bounds=at_bounds(space, result.x) if better else [],
    )


def swarm_within(runs: int, runs_per_tuning: int) -> SwarmSettings:
    """A swarm of up to 20 particles that spends at most so many closed-loop runs; a tuning takes `each` of them.

    Raises
    ------
    InvalidInput
        When they are too few for ten tunings.
    """
    tunings = runs // runs_per_tuning
    if tunings < LEAST_TUNINGS:
        raise InvalidInput(
            f"{runs:,} runs are too few: a tuning takes {runs_per_tuning} (roads times noise seeds); give at least "
            f"{LEAST_TUNINGS * runs_per_tuning:,}."
        )
    particles = min(SwarmSettings().particles, tunings)
    return SwarmSettings(particles=particles, generations=tunings // particles)


def mean_costs(
    runs: RunSet, controller: Controller, tunings: NDArray[np.float64], noise_seeds: Sequence[int]
) -> NDArray[np.float64]:
    """(tunings,) m^2, mean cost over a set of runs and noise seeds with each of the tunings (tunings, entries)."""
    indices = np.tile(np.arange(len(runs)), len(tunings))
    costs = runs.costs(Retuned(controller, np.repeat(tunings, len(runs), axis=0)), noise_seeds, indices)
    return costs.reshape(len(tunings), len(runs)).mean(axis=1)
