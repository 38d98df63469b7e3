"""What an adaptation is: one validated TOML file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from adaptrack.base.checked import checked
from adaptrack.base.errors import UnknownName, did_you_mean
from adaptrack.base.files import LISTED, SHIPPED, Record, build, read_toml
from adaptrack.control.scheduling import SchedulingVariables
from adaptrack.learning.adaptation.method import Method
from adaptrack.paper.campaign_config import CampaignConfig, Pair, load_campaign

Array = NDArray[np.float64]

_DATA = SHIPPED / "adaptations"


class TrainingSettings(Record):
    """What the network and the fuzzy systems look at, and how much they learn from."""

    inputs: Annotated[tuple[str, ...], LISTED] = Field(min_length=1, description="scheduling variables")
    domain: dict[str, Pair] = Field(description="lowest and highest value of each input")
    rounds: int = Field(default=60, ge=1, description="of improvement")
    operating_points: int = Field(default=2048, ge=16, description="lane changes in a gust to learn from")
    drives: int = Field(default=1024, ge=8, description="random drives to learn from")
    hard_drives: int = Field(default=1024, ge=8, description="fast ones near the limit")
    rules: int = Field(default=20, ge=2, description="of each fuzzy system")

    @model_validator(mode="after")
    def _has_a_domain(self) -> TrainingSettings:
        known = SchedulingVariables._fields[:-1]
        for what, names in (("inputs", self.inputs), ("domain", self.domain)):
            for name in names:
                if name not in known:
                    raise ValueError(f"{what}: {name!r} cannot be one. {did_you_mean(name, known)}")
        if len(set(self.inputs)) < len(self.inputs):
            raise ValueError(f"inputs: {', '.join(self.inputs)}: one is given twice.")
        for name in ("speed", *self.inputs):  # there is a schedule of the speed alone, too
            if name not in self.domain:
                raise ValueError(f"domain: the lowest and highest value of {name!r} are missing.")
        for name, (low, high) in self.domain.items():
            if not low < high:
                raise ValueError(f"domain: {name} = [{low:g}, {high:g}]: need low < high.")
        return self

    def box(self, inputs: Sequence[str]) -> Array:
        """(D, 2) domain of some of the inputs, in their order."""
        return np.array([self.domain[name] for name in inputs])


class Evaluation(Record):
    """What the schedulers are judged by; nothing that is learned depends on it."""

    operating_points: int = Field(default=2000, ge=8, description="unseen Sobol points of the campaign's box")
    drives: int = Field(default=1000, ge=8, description="unseen random drives")
    seed: int = Field(default=7, ge=0, description="of the operating points, and which drives")
    duration: float = Field(default=60.0, gt=0, description="s, of a drive")
    first_points: int = Field(default=10_000, ge=0, description="of the Sobol points, plus `seed`")
    first_drive: int = Field(default=3_000_000, ge=0, description="number of the first drive of seed 0")
    drive_block: int = Field(default=10_000, ge=1, description="drives set aside for each `seed`")
    first_noise: int = Field(default=900_001, ge=0, description="noise of every comparison; nothing is tuned on it")
    noises: int = Field(default=8, ge=1, description="noise seeds of a comparison on operating points and tests")
    first_search_noise: int = Field(default=800_001, ge=0, description="noise of the search for the optimum")
    swarms: int = Field(default=3, ge=1, description="of that search, each with noise of its own")
    swarm_noises: int = Field(default=3, ge=1, description="noise seeds of each swarm")
    first_choice_noise: int = Field(default=810_001, ge=0, description="noise of the choice among what was found")
    choice_noises: int = Field(default=8, ge=1, description="noise seeds of that choice")
    hindsight_Np: Annotated[tuple[float, ...], LISTED] = Field(
        default=(25.0, 30.0, 36.0, 44.0), description="periods, of the constants that hindsight chooses from"
    )
    hindsight_Nc: Annotated[tuple[float, ...], LISTED] = Field(
        default=(3.0, 5.0, 8.0, 12.0), description="periods, likewise"
    )
    hindsight_R: Annotated[tuple[float, ...], LISTED] = Field(
        default=(1e3, 2e3, 4e3, 8e3, 16e3, 32e3), description="1/rad^2, likewise; Q is 1 per m^2"
    )
    known_as: Annotated[tuple[str, ...], LISTED] = Field(
        default=("exact", "noisy", "lagged", "biased high", "biased low", "estimated", "withheld"),
        description="how schedulers know friction and wind; exact is the first",
    )

    @property
    def noise_seeds(self) -> tuple[int, ...]:
        """Noise of every comparison."""
        return _count_from(self.first_noise, self.noises)

    @property
    def search_seeds(self) -> tuple[tuple[int, ...], ...]:
        """Noise of each swarm that looks for the optimum."""
        firsts = range(self.first_search_noise, self.first_search_noise + self.swarms * self.swarm_noises)
        return tuple(_count_from(first, self.swarm_noises) for first in firsts[:: self.swarm_noises])

    @property
    def choice_seeds(self) -> tuple[int, ...]:
        """Noise on which the optimum is chosen."""
        return _count_from(self.first_choice_noise, self.choice_noises)


def _count_from(first: int, count: int) -> tuple[int, ...]:
    return tuple(range(first, first + count))


class AdaptationConfig(Record):
    """A whole adaptation."""

    name: str = Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$", description="what the files are called")
    description: str = ""
    campaign: str = Field(
        description="name, or .toml file beside this one; its operating points must be a Sobol sample"
    )
    profile: str | None = Field(
        default=None, description="instead of the campaign's: name, or .toml file beside this one"
    )
    seed: int = Field(default=0, ge=0, description="of the learning")
    learning: TrainingSettings
    method: Method = Field(default_factory=Method, description="every number that the learning depends on")
    evaluation: Evaluation = Field(default_factory=Evaluation, description="what the schedulers are judged by")

    @property
    def settings(self) -> dict[str, Any]:
        """All that the learned schedulers depend on beside the campaign, as plain JSON."""
        return self.model_dump(mode="json", include={"seed", "learning", "method"})


def campaign_of(config: AdaptationConfig) -> CampaignConfig:
    """The campaign of an adaptation, in its profile.

    Raises
    ------
    AdaptrackError
        As `load_campaign`.
    """
    return load_campaign(config.campaign).in_profile(config.profile)


def list_adaptations() -> dict[str, str]:
    """The configurations that `load_adaptation` knows by name, each with one line of description."""
    return {path.stem: str(read_toml(path).get("description", "")) for path in sorted(_DATA.glob("*.toml"))}


@checked
def load_adaptation(name_or_path: str | os.PathLike[str], *, profile: str | None = None) -> AdaptationConfig:
    """The named configuration, or the one in a TOML file (keys: the fields of `AdaptationConfig`).

    profile: instead of the one that it names; the name of the configuration then contains it.

    Raises
    ------
    UnknownName
        When nothing has this name.
    StorageError
        When the file cannot be read.
    ConfigError
        When it holds an unknown, missing or impossible value.
    """
    path = Path(name_or_path)
    if path.suffix != ".toml":
        path = _DATA / f"{name_or_path}.toml"
        if not path.exists():
            raise UnknownName(
                f"no adaptation is named {str(name_or_path)!r}. {did_you_mean(str(name_or_path), list_adaptations())} "
                "A file is given by its .toml path."
            )
    data = {"name": path.stem, **read_toml(path)}
    for key in ("campaign", "profile"):
        if str(data.get(key, "")).endswith(".toml"):
            data[key] = str(path.parent / data[key])
    config = build(AdaptationConfig, data, path)
    if profile in (None, campaign_of(config).profile):
        return config
    data |= {"profile": profile, "name": f"{config.name}-{Path(str(profile)).stem}"}
    return build(AdaptationConfig, data, path)
