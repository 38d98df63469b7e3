"""Scenarios and roads on the command line: tell them apart, and load them with a profile."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import adaptrack as at
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cli import options, show
from adaptrack.cli import road as roads
from adaptrack.cli.options import option_words

if TYPE_CHECKING:
    from adaptrack.road.holdable_speed import HoldableSpeed

BEYOND_DOMAIN = 1.25
"""Factor on the highest speed of a car's domain; faster scenarios cause a warning."""


@dataclass(frozen=True)
class DrivenPlaces:
    """Scenarios, or one drive along a road, with their profile."""

    drives: Sequence[at.Scenario | at.RoadDrive]
    profile: at.Profile
    road: roads.CheckedRoad | None = None

    def warn(self, car: at.Vehicle) -> None:
        """Warn of places that the car cannot drive, and of scenarios much faster than the car's domain."""
        if self.road is not None:
            self.road.warn()
            return
        for scenario in self.drives:
            fastest, highest = float(scenario.sample(0.1).speed.max()), car.domain.speed[1]
            if fastest > BEYOND_DOMAIN * highest:
                show.say(
                    f"Warning, {scenario.name}: reaches {fastest:.3g} m/s; the domain of car {car.name!r} ends at "
                    f"{highest:g} m/s (--option speed=...).",
                    aside=True,
                )


@options.option_group
class PlaceOptions:
    """Options for the scenarios or the road, and for the profile."""

    names: list[str] = options.argument(
        "SCENARIO|ROAD...", f"Scenarios (see `list scenarios`, .toml, .csv), or one road: {roads.ROADS_HELP}", ...
    )
    profile: str | None = options.option(
        "NAME", "paper: ideal, default for scenarios; road: lag, noise, delay, default for roads; or a .toml file."
    )
    option: list[str] | None = options.option(
        "KEY=VALUE", "Option of a scenario, such as speed=20.", names=["--option", "-o"]
    )
    route: roads.RoadOptions
    laps: int | None = options.option("N", "Number of laps on a closed road.", min=1)
    wind: float | None = options.option("V", "On a road: wind along the world y axis (m/s).", hidden=True)
    start_offset: float | None = options.option(
        "M", "On a road: initial offset from the centre line, to the left (m).", hidden=True
    )

    def load(self, car: at.Vehicle, holdable: HoldableSpeed | None = None) -> DrivenPlaces:
        """Load several scenarios or one road; holdable: speeds with sufficient margins, to limit the speed plan.

        Raises InvalidInput for other combinations, and for options that do not apply.
        """
        are_roads = [is_road(name) for name in self.names]
        if any(are_roads) and len(are_roads) > 1:
            raise InvalidInput("drive: give several scenarios or one road; `compare` drives several roads.")
        profile = at.load_profile(self.profile or ("road" if are_roads[0] else "paper"))
        if not are_roads[0]:
            self._refuse(self._road_words, "a scenario", "roads; a scenario takes --option speed=20")
            scenario_values = scenario_options(self.option or [])
            return DrivenPlaces(
                [at.load_scenario(name, domain=car.domain, **scenario_values) for name in self.names], profile
            )
        self._refuse(["--option"] if self.option else [], "a road", "scenarios; a road takes --speed")
        checked = self.route.look(self.names[0], car, profile, holdable)
        drive = at.RoadDrive(
            checked.road, checked.plan, laps=self.laps or 1, wind=self.wind or 0.0,
            start_offset=self.start_offset or 0.0,
        )  # fmt: skip
        return DrivenPlaces([drive], profile, checked)

    @property
    def _road_words(self) -> list[str]:
        """Options on the command line that apply only to roads."""
        values = {"--laps": self.laps, "--wind": self.wind, "--start-offset": self.start_offset}
        flags = [word for word in option_words(self.route) if word.startswith("--")]
        return [*flags, *(name for name, value in values.items() if value is not None)]

    def _refuse(self, words: Sequence[str], kind: str, owner: str) -> None:
        if words:
            raise InvalidInput(f"{self.names[0]} is {kind}: {words[0]} is an option of {owner}.")


def is_road(name: str) -> bool:
    """Whether a name or file is a road; otherwise it is a scenario.

    Raises UnknownName for a name of neither, and InvalidInput for a name or file that may be both.
    """
    from adaptrack.road.generate import ROAD_KINDS
    from adaptrack.road.load import ROAD_ENDINGS

    ending = Path(name).suffix.lower()
    if ending in (".csv", ".toml") and Path(name).is_file():
        marks = _csv_marks(Path(name)) if ending == ".csv" else _toml_marks(Path(name))
        if all(marks):
            raise InvalidInput(
                f"{name}: has {' and '.join(marks[0])}, as a scenario, and {' and '.join(marks[1])}, as a road: "
                "remove one of the two."
            )
        return not marks[0]
    if ending in ROAD_ENDINGS:
        return True
    scenarios = list(at.list_scenarios())
    if name in scenarios and name in ROAD_KINDS:
        raise InvalidInput(f"{name}: is the name of both a scenario and a road; write the one you mean to a file.")
    if name not in scenarios and name not in ROAD_KINDS:
        hint = did_you_mean(name, [*scenarios, *ROAD_KINDS])
        raise UnknownName(f"no scenario or road is named {name!r}. {hint} A file ends in {', '.join(ROAD_ENDINGS)}.")
    return name in ROAD_KINDS


def _toml_marks(file: Path) -> tuple[list[str], list[str]]:
    """Return the keys of a file that only scenarios have, and those that only roads have."""
    from adaptrack.base.files import read_toml
    from adaptrack.road.toml import RoadFile

    keys, scenario, road = set(read_toml(file)), set(at.Scenario.model_fields), set(RoadFile.model_fields)
    return sorted(keys & (scenario - road)), sorted(keys & (road - scenario))


def _csv_marks(file: Path) -> tuple[list[str], list[str]]:
    """Return the columns of a file that mark a scenario (t and y_ref), and those that mark a road."""
    from adaptrack.base.files import read_bytes, table_lines

    lines, _ = table_lines(str(file), read_bytes(file), "replace")
    columns = [word.strip().lower() for word in (lines[0][1] if lines else "").replace(";", ",").split(",")]
    scenario = ["t", "y_ref"] if {"t", "y_ref"} <= set(columns) else []
    return scenario, [name for name in ("x", "y", "x_m", "y_m") if name in columns]


def scenario_options(words: Sequence[str]) -> dict[str, Any]:
    """Parse options such as `speed=20`, `friction=[0.9, 0.5]` or `window=full`; values are TOML or plain text."""
    import tomllib

    chosen: dict[str, Any] = {}
    for text in words:
        key, sign, value = text.partition("=")
        if not sign:
            raise InvalidInput(f"--option {text}: write KEY=VALUE, for instance speed=20.")
        try:
            chosen[key.strip()] = tomllib.loads(f"value = {value}")["value"]
        except (tomllib.TOMLDecodeError, RecursionError, ValueError):
            chosen[key.strip()] = value.strip()
    return chosen
