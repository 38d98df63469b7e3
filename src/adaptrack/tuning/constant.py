"""The one tuning that is best on a whole set of runs."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from adaptrack.errors import InvalidInput
from adaptrack.runs import RunSet
from adaptrack.tuning.pso import Result, SearchSpace, SwarmSettings, minimise


def tune_constant(
    runs: RunSet, swarm: SwarmSettings | None = None, *, noise_seeds: Sequence[int] = (0,), seed: int = 0,
    space: SearchSpace | None = None,
) -> Result:  # fmt: skip
    """The tuning (Np, Nc, Q, R) of a run set's MPC with the lowest mean cost over its runs, found by one swarm.

    The cost is the mean of J (m^2, see `adaptrack.runs`) over the runs and the noise seeds; a failed run counts as
    `RunSet.failed_cost`. Runs may differ in length, such as drives along roads. space: by default the paper's, whose R
    is for its controller; the one that knows its car wants another, such as R from 0.1 to 100 by decades.

    Returns
    -------
    Result
        `x` is the tuning (4,), `cost` its cost.

    Raises
    ------
    InvalidInput
        When no noise seed is given.
    """
    if not noise_seeds:
        raise InvalidInput("tune_constant: noise_seeds: give at least one.")

    def costs(tunings: NDArray[np.float64]) -> NDArray[np.float64]:
        which = np.tile(np.arange(len(runs)), len(tunings))
        found = runs.costs(np.repeat(tunings, len(runs), axis=0), noise_seeds, which)
        return found.reshape(len(tunings), len(runs)).mean(axis=1)

    return minimise(costs, space or SearchSpace.tuning(), swarm, seed)
