"""The settings of a campaign: one validated TOML file, its operating points and its library of tunings."""

from __future__ import annotations

import hashlib
import importlib.util
import json
import logging
import math
import os
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, field_validator, model_validator

from adaptrack.base.checked import checked
from adaptrack.base.errors import UnknownName, did_you_mean
from adaptrack.base.files import LISTED, Record, build, printable, read_toml
from adaptrack.base.limits import LANDSCAPE_COSTS, NOISE_SEEDS, check_limit
from adaptrack.base.registry import import_plugin
from adaptrack.cars.plant import DualTrack, Plant, SingleTrack, SteppedPlant, fingerprint, get_plant, twin_of
from adaptrack.cars.vehicle import Tyre, Vehicle, find_data, is_path, list_data, load_tyre, load_vehicle
from adaptrack.control.controllers import Tuning
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.drive.failure import DISTANCE, SIDESLIP, FailureLimits
from adaptrack.paper.operating_points import Fold, OperatingPoints, Seed, fold, unit_sobol
from adaptrack.scenario.profile import list_profiles, load_profile
from adaptrack.tuning.pso import SearchBounds, SwarmSettings

_log = logging.getLogger("adaptrack")

STANDARD_ROW = tuple(Tuning().as_array().tolist())
"""The paper's table: Np 35, Nc 8, Q 10, R 0.01."""


# -- tunings ----------------------------------------------------------------------------------------------------------
class TuningLibrary(Record):
    """The common library: tunings whose cost is found at every operating point (the landscape)."""

    size: int = Field(default=200, ge=1, le=10_000, description="how many tunings, the standard one included")
    seed: Seed = Field(default=0, description="of the scrambled Sobol sequence")
    tunings: Annotated[tuple[tuple[float, float, float, float], ...], LISTED] = Field(
        default=(), description="rows of Np, Nc, Q, R: this library, instead of one of the given size"
    )

    @model_validator(mode="after")
    def _are_tunings(self) -> Self:
        for number, (Np, Nc, Q, R) in enumerate(self.tunings):
            if not (float(Np).is_integer() and float(Nc).is_integer() and 1 <= Nc <= Np and Q > 0 and R > 0):
                raise ValueError(
                    f"tunings[{number}] = {[Np, Nc, Q, R]}: need whole numbers 1 <= Nc <= Np, and positive Q and R."
                )
        if len(set(self.tunings)) < len(self.tunings):
            raise ValueError("tunings: one is given twice.")
        if self.tunings and {"size", "seed"} & self.model_fields_set:
            raise ValueError("size and seed have no use beside explicit tunings: leave them out.")
        return self

    def rows(self, search: SearchBounds) -> Array:
        """The tunings, (T, 4) of Np, Nc, Q, R; the first is the paper's table, unless they are explicit."""
        return np.array(self.tunings) if self.tunings else spread_tunings(self.size, search, self.seed)


def spread_tunings(size: int, search: SearchBounds, seed: int = 0) -> Array:
    """`size` tunings that cover a search space evenly, (size, 4) of Np, Nc, Q, R; the first is the paper's table.

    The others are a scrambled Sobol sequence in (Np, Nc, log R/Q). Only R/Q changes the control law, so Q and R of each
    ratio are put in the middle (of their logarithms) of what the bounds leave, and no tuning is spent on repeating it.
    """
    u = unit_sobol(max(size - 1, 1), 3, seed)[: size - 1]
    Np = search.Np[0] + np.floor(u[:, 0] * (search.Np[1] - search.Np[0] + 1))
    most = np.minimum(search.Nc[1], Np)
    Nc = search.Nc[0] + np.floor(u[:, 1] * (most - search.Nc[0] + 1))
    (q_low, q_high), (r_low, r_high) = portable.log(search.Q), portable.log(search.R)
    ratio = (r_low - q_high) + u[:, 2] * ((r_high - q_low) - (r_low - q_high))
    q = (np.maximum(q_low, r_low - ratio) + np.minimum(q_high, r_high - ratio)) / 2.0
    return np.vstack([STANDARD_ROW, np.column_stack([Np, Nc, portable.exp(q), portable.exp(q + ratio)])])


# -- failure ----------------------------------------------------------------------------------------------------------
class FailureRule(Record):
    """When a run has failed and its cost is infinite, see `failure.FailureLimits`; `inf` switches a limit off."""

    distance: float = Field(default=DISTANCE, gt=0, allow_inf_nan=True, description="m off the reference")
    sideslip: float = Field(default=SIDESLIP, gt=0, allow_inf_nan=True, description="rad, at 1 m/s or more")

    @property
    def rule(self) -> FailureLimits:
        """The rule by which runs are judged."""
        return FailureLimits(self.distance, self.sideslip)


# -- the file ---------------------------------------------------------------------------------------------------------
class CampaignConfig(Record):
    """A campaign: at every operating point one particle swarm, and the cost of every tuning of a common library."""

    name: str = Field(
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", description="letters, digits, . _ -; the data set is called so"
    )
    description: str = Field(default="", description="one sentence for lists")
    vehicle: str = Field(default="paper", description="name, or .toml file beside this one")
    plant: str = Field(
        default="dual-track", min_length=1, description="what is driven: single-track, dual-track, or a registered one"
    )
    plugin: Annotated[tuple[str, ...], LISTED] = Field(
        default=(), description="Python modules that are imported first, here and by workers: they register plants"
    )
    tyre: str | None = Field(default=None, description="name, or .toml file beside this one; by default the vehicle's")
    profile: str = Field(
        description="name, or .toml file beside this one; paper: ideal; road, production: steering lag, noise, delay"
    )
    scenario: Literal["step", "lane-change"] = Field(
        description="step: constant reference y_ref and wind; lane-change: smooth, with a gust"
    )
    duration: float | None = Field(default=None, gt=0, le=600, description="s; 18 for step, 8 for lane-change")
    move_weight: float | None = Field(
        default=None, ge=0, le=1e6, description="m^2/rad^2, weight of steering activity; by default the profile's"
    )
    noise_seeds: Annotated[tuple[Seed, ...], LISTED] | None = Field(
        default=None, description="each cost is the mean over these; by default [0], with sensor noise [0, 1, 2, 3]"
    )
    seed: Seed = Field(default=0, description="of the swarms")
    mirror: bool | None = Field(
        default=None, description="compute only one of two left-right twins; by default without sensor noise only"
    )
    chunk: int = Field(default=32, ge=1, le=100_000, description="points per chunk: what a kill can cost at most")
    operating_points: OperatingPoints = Field(description="where to tune")
    failure: FailureRule = Field(default_factory=FailureRule, description="when a run has failed")
    search: SearchBounds = Field(default_factory=SearchBounds, description="bounds of the tunings")
    swarm: SwarmSettings = Field(default_factory=SwarmSettings, description="how a swarm searches")
    library: TuningLibrary = Field(
        default_factory=TuningLibrary, description="tunings whose cost is found at every operating point"
    )

    @field_validator("profile")
    @classmethod
    def _is_a_profile(cls, value: str) -> str:
        if not is_path(value) and value not in list_profiles():
            raise ValueError(f"no profile is named {value!r}. {did_you_mean(value, list_profiles())}")
        return value

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        if self.noise_seeds is not None:
            if not self.noise_seeds:
                raise ValueError("noise_seeds: give one seed at least.")
            check_limit("noise_seeds", len(self.noise_seeds), NOISE_SEEDS)
            if len(set(self.noise_seeds)) < len(self.noise_seeds):
                raise ValueError("noise_seeds: one is given twice.")
            if len(self.noise_seeds) > 1 and not self.noisy:
                raise ValueError(
                    f"noise_seeds: profile {self.profile!r} has no noise, every seed gives the same; leave them out."
                )
        return self

    @property
    def noisy(self) -> bool:
        """Whether the profile has sensor noise."""
        return any(load_profile(self.profile).noise)

    def with_profile(self, profile: str | None = None) -> Self:
        """Return a copy of the campaign in a profile, whose name it appends; None keeps its profile."""
        if profile in (None, self.profile):
            return self
        values = {key: value for key, value in self if key in self.model_fields_set}
        return type(self)(**{**values, "profile": profile, "name": f"{self.name}-{Path(str(profile)).stem}"})

    def settled(self) -> Self:
        """A copy in which every value that may be left out has been given."""
        return self.replace(
            duration=self.duration or {"step": 18.0, "lane-change": 8.0}[self.scenario],
            move_weight=load_profile(self.profile).move_weight if self.move_weight is None else self.move_weight,
            noise_seeds=self.noise_seeds or ((0, 1, 2, 3) if self.noisy else (0,)),
            mirror=not self.noisy if self.mirror is None else self.mirror,
        )


def list_campaigns() -> dict[str, str]:
    """The campaigns that `load_campaign` knows by name, each with one line of description."""
    names = list_data("campaigns")
    return {name: str(read_toml(find_data("campaigns", name)).get("description", "")) for name in names}


@checked
def load_campaign(name_or_path: str | os.PathLike[str]) -> CampaignConfig:
    """The named campaign, or the one that a TOML file describes (keys: the fields of `CampaignConfig`).

    Text is a path when it ends in ``.toml`` or holds a directory; without the key ``name``, the file's own name is
    taken. The files of a vehicle, a tyre and a profile are looked for beside it.

    Raises
    ------
    UnknownName
        When no campaign has this name.
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not TOML, or holds an unknown, missing or impossible value; all of them are in the message.
    """
    path = find_data("campaigns", name_or_path)
    data = {"name": path.stem, **read_toml(path)}
    for key in ("vehicle", "tyre", "profile"):
        if isinstance(data.get(key), str) and is_path(data[key]):
            data[key] = str(path.parent / data[key])
    return build(CampaignConfig, data, path)


# -- ready to run ---------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Setup:
    """Everything that decides the cost of a tuning: what a worker needs to build the objective."""

    config: CampaignConfig
    """the campaign with its optional values filled in"""
    vehicle: Vehicle
    tyre: Tyre

    def plant(self) -> Plant | SteppedPlant:
        """The campaign's plant of the car, on the campaign's tyre where it names one; made once.

        Raises UnknownName when no plant has this name in this process, or there is no such module.
        """
        return _plant(self)

    @property
    def searched_on(self) -> Plant | SteppedPlant:
        """The plant for tuning and learning: the campaign's, or its car's twin if that one is costly."""
        plant = self.plant()
        return twin_of(self.vehicle) if plant.costly else plant


@lru_cache(maxsize=8)
def _plant(setup: Setup) -> Plant | SteppedPlant:
    """`Setup.plant`, made once, since its maker may start a simulator; plug-ins that register plants come first."""
    for module in setup.config.plugin:
        missing = (
            f"plugin {module!r}: there is no such module in the Python path of {socket.gethostname()}: install it "
            "there, or add its folder to PYTHONPATH."
        )
        import_plugin(module, UnknownName(missing), _announce)
    try:
        return get_plant(setup.config.plant, setup.vehicle, setup.tyre if setup.config.tyre is not None else None)
    except UnknownName as error:
        raise UnknownName(
            f"{error} A plant of one's own is registered by a Python module that every worker can import: name it in "
            "the campaign's key plugin."
        ) from None


def _announce(module: str) -> None:
    """Say which code a campaign's file is about to run."""
    spec = importlib.util.find_spec(module.partition(".")[0])  # of a part of a package Python would run the package
    if spec is not None:
        where = spec.origin or ", ".join(spec.submodule_search_locations or ())
        _log.warning("adaptrack: the campaign's key plugin runs the module %s: %s", module, printable(where))


@dataclass(frozen=True, eq=False)
class CampaignPlan:
    """A campaign ready to run: its files read, its operating points and tunings counted.

    Raises
    ------
    InvalidInput
        When a vehicle or tyre does not exist or cannot be read, as `load_vehicle` and `load_tyre` say, the plant is not
        known or none of this car, or the landscape is larger than `limits.LANDSCAPE_COSTS`.
    """

    setup: Setup
    operating_points: Array
    """(n, 4)"""
    fold: Fold
    """which of them are computed"""
    library: Array
    """(T, 4)"""

    @classmethod
    def of(cls, config: CampaignConfig) -> Self:
        """The plan of a configuration."""
        config = config.settled()
        vehicle = load_vehicle(config.vehicle)
        tyre = load_tyre(config.tyre or vehicle.tyre)
        rows, library = config.operating_points.rows(), config.library.rows(config.search)
        check_limit("landscape", len(rows) * len(library), LANDSCAPE_COSTS)
        numbers = np.arange(len(rows))
        twins = fold(rows) if config.mirror else Fold(numbers, numbers)
        setup = Setup(config, vehicle, tyre)
        setup.plant()  # one that is not known, or none of this car, is refused before any work
        return cls(setup, rows, twins, library)

    @property
    def config(self) -> CampaignConfig:
        """The settled configuration."""
        return self.setup.config

    @cached_property
    def settings(self) -> dict[str, Any]:
        """The configuration as plain JSON, names of files replaced by what is in them.

        All that the data depend on, and nothing else: no chunk size, no description, no path.
        """
        values = self.config.model_dump(mode="json", exclude={"description", "chunk", "plugin"})
        plant = self.setup.searched_on
        if not isinstance(plant, SingleTrack | DualTrack):
            values["plant_fingerprint"] = fingerprint(plant)
        unused = {"description", "tyre", "body", "domain", "estimated", "steering", "known_within"}
        unused |= {"drive", "brakes", "pedals"}
        values["vehicle"] = self.setup.vehicle.model_dump(mode="json", exclude=unused)
        values["tyre"] = self.setup.tyre.model_dump(mode="json", exclude={"description"})
        if self.config.profile not in list_profiles():
            values["profile"] = load_profile(self.config.profile).model_dump(mode="json", exclude={"description"})
        return _plain(values)

    @cached_property
    def identity(self) -> str:
        """SHA-256 of the settings: equal for equal data only."""
        return hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).hexdigest()


def _plain(value: Any) -> Any:
    """`value` with text for what JSON has no number for, so that any JSON reader can read it."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, float) and not math.isfinite(value):
        return repr(value)
    return value
