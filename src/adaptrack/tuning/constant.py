"""The one tuning that is best on a whole set of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from adaptrack.controllers import Controller
from adaptrack.errors import InvalidInput
from adaptrack.runs import Retuned, RunSet
from adaptrack.tuning.pso import Result, SearchSpace, Swarm, SwarmSettings
from adaptrack.tuning.spaces import search_space

LEAST_TUNINGS = 10
"""That a search must be able to try."""


def tune_constant(
    runs: RunSet, swarm: SwarmSettings | None = None, *, noise_seeds: Sequence[int] = (0,), seed: int = 0,
    controller: Controller | None = None, space: SearchSpace | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Result:  # fmt: skip
    """The tuning of a controller with the lowest mean cost over a set of runs, found by one swarm.

    The cost is the mean of J (m^2, see `adaptrack.runs`) over the runs and the noise seeds; a failed run counts as
    `RunSet.failed_cost`. Runs may differ in length, such as drives along roads. controller: a compiled one, by default
    the run set's MPC; space: of its tuning entries, by default its `search_space`; progress: called with (generations
    done, generations).

    Returns
    -------
    Result
        `x` is the tuning, in the order of the controller's `tuning_names`, `cost` its cost.

    Raises
    ------
    InvalidInput
        When no noise seed is given, or no space is known for the controller.
    """
    if not noise_seeds:
        raise InvalidInput("tune_constant: noise_seeds: give at least one.")
    driven = runs.mpc if controller is None else controller
    search = Swarm(space or search_space(driven), swarm, seed=seed)
    while not search.done:
        if progress is not None:
            progress(search.generation, search.settings.generations)
        search.tell(mean_costs(runs, driven, search.ask(), noise_seeds))
    return search.result()


def swarm_within(runs: int, each: int) -> SwarmSettings:
    """A swarm of up to 20 particles that spends at most so many closed-loop runs; a tuning takes `each` of them.

    Raises
    ------
    InvalidInput
        When they are too few for ten tunings.
    """
    tunings = runs // each
    if tunings < LEAST_TUNINGS:
        raise InvalidInput(
            f"{runs:,} runs are too few: a tuning takes {each} (roads times noise seeds); give at least "
            f"{LEAST_TUNINGS * each:,}."
        )
    particles = min(SwarmSettings().particles, tunings)
    return SwarmSettings(particles=particles, generations=tunings // particles)


def mean_costs(
    runs: RunSet, controller: Controller, tunings: NDArray[np.float64], noise_seeds: Sequence[int]
) -> NDArray[np.float64]:
    """(tunings,) m^2, mean cost over a set of runs and noise seeds with each of the tunings (tunings, entries)."""
    which = np.tile(np.arange(len(runs)), len(tunings))
    found = runs.costs(Retuned(controller, np.repeat(tunings, len(runs), axis=0)), noise_seeds, which)
    return found.reshape(len(tunings), len(runs)).mean(axis=1)
