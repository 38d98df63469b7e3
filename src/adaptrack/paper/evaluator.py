"""What a campaign tunes: the protocol that it relies on, and the compiled closed loop that keeps it."""

from __future__ import annotations

from collections.abc import Mapping
from importlib.metadata import version
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.plant import DualTrack, SingleTrack, fingerprint
from adaptrack.control.controllers import MPC, Tuning, published_mpc
from adaptrack.core.library import kernels_hash
from adaptrack.paper.campaign_config import Setup
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.objective import Objective

Array = NDArray[np.float64]


def tuned_mpc(setup: Setup, tuning: Tuning | None = None, **options: Any) -> MPC:
    """The paper's MPC for a campaign's car and profile, by default with the paper's tuning.

    options: of `MPC`.
    """
    profile = load_profile(setup.config.profile)
    return published_mpc(setup.vehicle, tuning, period=profile.period, preview=profile.preview, **options)


class SwarmFinding(Protocol):
    """What one swarm found."""

    @property
    def tuning(self) -> Array:
        """(4,) Np, Nc, Q, R"""

    @property
    def cost(self) -> float:
        """of that tuning, m^2; inf when the run failed with every one"""

    @property
    def trace(self) -> Array:
        """(generations,) lowest cost up to and including each generation"""

    @property
    def evaluations(self) -> int:
        """tunings evaluated"""

    @property
    def control_steps(self) -> int:
        """control periods simulated"""


class Evaluator(Protocol):
    """What a campaign needs of the loop that it tunes.

    An answer depends on its arguments only, not on earlier calls; several threads call at once.
    """

    def versions(self) -> Mapping[str, str]:
        """The software on which the last digit of an answer may depend."""

    def tune(self, point: Array, seed: int, stream: int) -> SwarmFinding:
        """A whole swarm on one operating point (4,); its random numbers depend on seed and stream only."""

    def landscape(self, point: Array, library: Array) -> Array:
        """(T,) cost of each tuning of the library (T, 4); inf where the run fails."""


class EvaluatedLoop:
    """The closed loop of a setup: plant or its twin, profile, the MPC with free moves, see `Objective`."""

    def __init__(self, setup: Setup) -> None:
        config = setup.config
        profile = load_profile(config.profile)
        self._swarm, self._space = config.swarm, config.search.space()
        self.objective = Objective(
            plant=setup.searched_on,
            mpc=tuned_mpc(
                setup,
                longest_horizon=max(60, config.search.Np[1]),
                most_moves=max(20, config.search.Nc[1]),
            ),
            test=config.scenario,
            profile=profile,
            noise_seeds=config.noise_seeds or (0,),
            move_weight=config.move_weight,
            duration=config.duration,
            failure=config.failure.rule,
        )

    def versions(self) -> dict[str, str]:
        """The kernels' own hash, and the libraries that have a say in the numbers."""
        plant = self.objective.plant
        own = {} if isinstance(plant, SingleTrack | DualTrack) else {"plant": fingerprint(plant)}
        return {
            **own,
            "kernels": kernels_hash(),
            "numpy": version("numpy"),
        }

    def tune(self, point: Array, seed: int, stream: int) -> SwarmFinding:
        return self.objective.tune(point.tolist(), self._swarm, seed, stream, self._space)

    def landscape(self, point: Array, library: Array) -> Array:
        return self.objective.landscape(point.tolist(), library)
