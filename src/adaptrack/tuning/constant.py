"""Constant tuning of a controller: the search for the lowest mean cost on a set of runs, and the file of the result."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, model_validator

from adaptrack.analysis.holdable import holdable_speed
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import LISTED, Record
from adaptrack.cars.vehicle import Vehicle
from adaptrack.control.controllers import Controller, about_controller, get_controller
from adaptrack.road.holdable_speed import HoldableSpeed
from adaptrack.scenario.profile import Profile
from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmResult, SwarmSettings, at_bounds, search_space
from adaptrack.tuning.runs import RunSet

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
    return search.run(lambda tunings: runs.costs_of(tunings, noise_seeds, controller).mean(axis=1), progress)


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
    default_cost = float(runs.costs_of(default[None], noise_seeds, controller).mean())
    is_better = result.cost < default_cost
    return ConstantSearch(
        tuning=dict(zip(space.names, (result.x if is_better else default).tolist(), strict=True)),
        default=dict(zip(space.names, default.tolist(), strict=True)),
        cost=min(result.cost, default_cost),
        default_cost=default_cost,
        at_bounds=at_bounds(space, result.x) if is_better else [],
    )


def swarm_within(runs: int, runs_per_tuning: int) -> SwarmSettings:
    """Return the settings of a swarm of at most `runs` closed-loop runs, `runs_per_tuning` for each tuning.

    Raises InvalidInput when the runs suffice for fewer than `MIN_TUNINGS` tunings.
    """
    tunings = runs // runs_per_tuning
    if tunings < MIN_TUNINGS:
        raise InvalidInput(
            f"{runs:,} runs are too few: a tuning takes {runs_per_tuning} (roads times noise seeds); give at least "
            f"{MIN_TUNINGS * runs_per_tuning:,}."
        )
    particles = min(SwarmSettings().particles, tunings)
    return SwarmSettings(particles=particles, generations=tunings // particles)


# -- the file of a constant tuning -------------------------------------------------------------------------------------
class ConstantTuning(Record):
    """Constant tuning of a controller, with the car, profile and roads of the search.

    Raises
    ------
    InvalidInput
        For an invalid value; the message names the key and the accepted values.
    """

    controller: str = Field(description="registered name of the controller")
    vehicle: str = Field(min_length=1, description="name of the car in the search")
    profile: str = Field(min_length=1, description="name of the profile in the search")
    period: float = Field(gt=0, le=10, description="s, control period in the search; horizons are in periods")
    roads: Annotated[tuple[str, ...], LISTED] = Field(default=(), description="names of the roads in the search")
    noise_seeds: Annotated[tuple[int, ...], LISTED] = Field(
        default=(), description="noise seeds of the search; a comparison needs different ones"
    )
    command: str = Field(default="", description="command line that wrote the file")
    belief: str = Field(default="", description="steering parameters that the controller assumed in the search")
    tuning: dict[str, float] = Field(description="tuning entries of the controller")
    holds: HoldableSpeed | None = Field(
        default=None, description="largest braking (m/s^2) at which the stability margins suffice, see `HoldableSpeed`"
    )

    @model_validator(mode="after")
    def _is_known(self) -> ConstantTuning:
        about_controller(self.controller)
        return self

    def make(
        self, car: Vehicle, profile: Profile, period: float, preview: bool, computation: float | None = None
    ) -> Controller:
        """Return the controller with this tuning.

        Parameters
        ----------
        car, profile
            Car and profile for which the controller is built.
        period
            Control period (s).
        preview
            Whether the controller receives the road ahead.
        computation
            Computation time (s), as for `MPC`.

        Raises
        ------
        InvalidInput
            When the entries are not those of the controller, or it does not accept their values.
        """
        optional = {"period": period, "preview": preview, "computation": computation}
        controller = get_controller(self.controller, car, profile=profile, optional=optional)
        if set(self.tuning) != set(controller.tuning_names):
            entries, names = ", ".join(self.tuning), ", ".join(controller.tuning_names)
            raise InvalidInput(f"tuning of {self.controller!r}: entries {entries}: must be {names}.")
        return controller.with_tuning(self.tuning)

    def with_holdable_speed(self, car: Vehicle, profile: Profile) -> ConstantTuning:
        """Return a copy with the largest braking `holds`, which takes some seconds.

        If the controller is no `MPC`, or has a scheduler, the result is this object itself.
        """
        controller: Any = self.make(car, profile, self.period, profile.preview)
        if not controller.has_horizons or controller.scheduler is not None:
            return self
        return self.replace(holds=holdable_speed(car, controller, profile))

    def label(self, path: str | os.PathLike[str]) -> str:
        """Return the label in tables of the tuning that was read from a file."""
        return f"{self.controller}, {Path(path).stem}"

    def mismatches(self, car: str, profile: str, period: float) -> list[str]:
        """Return a clause for each of car, profile and control period (s) that differs from the file."""
        clauses = [
            f"was found for the {key} {file_name!r}, not {name!r}"
            for key, file_name, name in (("car", self.vehicle, car), ("profile", self.profile, profile))
            if file_name != name
        ]
        if self.period != period:
            clauses.append(f"was found for a control period of {self.period:g} s, not {period:g} s")
        return clauses


load_tuning = ConstantTuning.from_toml
