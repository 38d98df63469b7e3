"""Search for the constant tuning of a controller that has the lowest mean cost on a set of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers import Controller
from adaptrack.control.controllers.base import Policy
from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmResult, SwarmSettings
from adaptrack.tuning.runs import RunSet
from adaptrack.tuning.spaces import at_bounds, search_space

MIN_TUNINGS = 10
"""Smallest number of tunings that a search must try."""


def tune_constant(
    runs: RunSet, swarm: SwarmSettings | None = None, *, noise_seeds: Sequence[int] = (0,), seed: int = 0,
    controller: Controller | None = None, space: SearchSpace | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SwarmResult:  # fmt: skip
    """Search with one swarm for the constant tuning with the lowest mean cost over a set of runs.

    The cost is the mean of J (m^2, see `adaptrack.tuning.runs`) over the runs and the noise seeds. A failed run costs
    `RunSet.failed_cost`.

    Parameters
    ----------
    runs
        Runs, which may differ in length.
    swarm
        Settings of the swarm.
    noise_seeds
        Seeds of the sensor noise; each run is driven once with each seed.
    seed
        Seed of the swarm.
    controller
        Tuned controller; None for the MPC of the run set.
    space
        Bounds of its tuning; None for `search_space` of the controller.
    progress
        Function called with (generations done, generations in all).

    Returns
    -------
    SwarmResult
        `x` is the tuning in the order of the controller's `tuning_names`, `cost` its mean cost (m^2).

    Raises
    ------
    InvalidInput
        For an empty list of noise seeds, or a controller without a search space.
    """
    if not noise_seeds:
        raise InvalidInput("tune_constant: noise_seeds: give at least one.")
    controller = runs.mpc if controller is None else controller
    search = Swarm(space or search_space(controller), swarm, seed=seed)
    while not search.is_done:
        if progress is not None:
            progress(search.generation, search.settings.generations)
        search.tell(mean_costs(runs, controller, search.ask(), noise_seeds))
    return search.result()


@dataclass(frozen=True)
class ConstantSearch:
    """Result of `search_constant`."""

    tuning: dict[str, float]
    """The better one of the searched and the default tuning, by entry name."""
    default: dict[str, float]
    """Default tuning of the controller, by entry name."""
    cost: float
    """Mean cost of `tuning` (m^2), see `tune_constant`."""
    default_cost: float
    """Mean cost of `default` (m^2)."""
    at_bounds: list[str]
    """Names of the entries of `tuning` that lie at a bound of the search space; a better value may lie outside."""

    @property
    def better(self) -> bool:
        """Whether the search found a better tuning than the default."""
        return self.cost < self.default_cost


def search_constant(
    runs: RunSet, controller: Controller, swarm: SwarmSettings, *, noise_seeds: Sequence[int], seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> ConstantSearch:  # fmt: skip
    """Return the better one of the result of `tune_constant` and the default tuning, on the same runs and noise.

    The arguments are those of `tune_constant`.
    """
    space = search_space(controller)
    result = tune_constant(
        runs, swarm, noise_seeds=noise_seeds, seed=seed, controller=controller, space=space, progress=progress
    )
    default = controller.packed_tuning()
    default_cost = float(mean_costs(runs, controller, default[None], noise_seeds)[0])
    is_better = result.cost < default_cost
    return ConstantSearch(
        tuning=dict(zip(space.names, (result.x if is_better else default).tolist(), strict=True)),
        default=dict(zip(space.names, default.tolist(), strict=True)),
        cost=min(result.cost, default_cost),
        default_cost=default_cost,
        at_bounds=at_bounds(space, result.x) if is_better else [],
    )


def swarm_within(runs: int, runs_per_tuning: int) -> SwarmSettings:
    """Return the settings of a swarm with a limited number of closed-loop runs.

    Parameters
    ----------
    runs
        Largest number of closed-loop runs.
    runs_per_tuning
        Number of runs that evaluate one tuning.

    Raises
    ------
    InvalidInput
        When the runs suffice for fewer than `MIN_TUNINGS` tunings.
    """
    tunings = runs // runs_per_tuning
    if tunings < MIN_TUNINGS:
        raise InvalidInput(
            f"{runs:,} runs are too few: a tuning takes {runs_per_tuning} (roads times noise seeds); give at least "
            f"{MIN_TUNINGS * runs_per_tuning:,}."
        )
    particles = min(SwarmSettings().particles, tunings)
    return SwarmSettings(particles=particles, generations=tunings // particles)


def mean_costs(
    runs: RunSet, controller: Controller, tunings: NDArray[np.float64], noise_seeds: Sequence[int]
) -> NDArray[np.float64]:
    """Return the mean cost over a set of runs and noise seeds (m^2), (n,), of each of n tunings (n, entries)."""
    indices = np.tile(np.arange(len(runs)), len(tunings))
    costs = runs.costs(Policy(controller, np.repeat(tunings, len(runs), axis=0)), noise_seeds, indices)
    return costs.reshape(len(tunings), len(runs)).mean(axis=1)
