"""What `tune` and `evaluate` share: one car, one profile, the same roads for everybody."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.road import ROADS, RoadOptions

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.comparison.contenders import Contender
    from adaptrack.comparison.table import Comparison
    from adaptrack.control.controllers import Controller
    from adaptrack.scenario.profile import Profile
    from adaptrack.tuning.runs import RunSet

Roads = Annotated[list[str] | None, typer.Argument(metavar="ROAD", help=f"Roads: {ROADS}", show_default=False)]


def named(command: str, roads: list[str] | None, instead: str) -> list[str]:
    """The roads that a command is given; instead: what needs none, with its command.

    Raises
    ------
    InvalidInput
        When there are none.
    """
    if not roads:
        raise InvalidInput(f"{command}: name one or more roads: {ROADS[:-1]}; or, {instead}.")
    return roads


class Typed(NamedTuple):
    """Parts of a command line about the same roads and car."""

    roads: str
    """with the options that say which they are"""
    car: str
    """options of car, plant and profile, where they are not the usual ones"""


def typed(roads: Sequence[str], route: RoadOptions, car: options.CarAndPlant, profile: str) -> Typed:
    """How one types the same roads, car and profile again."""
    given = [value for value in vars(route).values() if value is not None]
    about = [each for name, value in zip(route.named, given, strict=True) for each in _spelt(name, value)]
    own = (("--vehicle", car.vehicle, "paper"), ("--plant", car.plant, "dual-track"), ("--profile", profile, "road"))
    about_car = [each for name, value, usual in own if value != usual for each in _spelt(name, value)]
    about_car += [*_spelt("--tyre", car.tyre or []), *_spelt("--plugin", car.plugin or [])]
    return Typed(" ".join([*map(shlex.quote, roads), *about]), "".join(f" {each}" for each in about_car))


def _spelt(option: str, value: Any) -> list[str]:
    """An option with its value, once for each of several."""
    if isinstance(value, list):
        return [each for one in value for each in _spelt(option, one)]
    if isinstance(value, bool):
        return ["--closed" if value else "--open"]
    return [option, f"{value:g}" if isinstance(value, float) else shlex.quote(str(value))]


@dataclass(frozen=True, eq=False)
class RoadSetting:
    """A car, a profile and roads."""

    car: Vehicle
    profile: Profile
    runs: RunSet

    @classmethod
    def of(
        cls, names: Sequence[str], route: RoadOptions, car: options.CarAndPlant, profile: str, aside: bool
    ) -> RoadSetting:
        """Load the roads, plan the speeds, say what cannot be driven."""
        from adaptrack.control.controllers import MPC
        from adaptrack.scenario import RoadDrive
        from adaptrack.scenario.profile import load_profile
        from adaptrack.tuning.runs import RunSet

        vehicle, plant = car.load()
        world = load_profile(profile)
        drives = []
        pairs = [(each, name) for each in route.each for name in dict.fromkeys(names)]
        with show.progress("plan the speeds", len(pairs)) as advance:
            for each, name in pairs:
                advance(f"plan the speed, {name}", 0, 1)
                planned = each.look(name, vehicle, world)
                planned.warn(aside)
                drives.append(RoadDrive(planned.road, planned.plan))
                advance(f"plan the speed, {name}", 1, 1)
        mpc = MPC(vehicle, profile=world, preview=True)
        return cls(vehicle, world, RunSet(plant, mpc, drives, profile))

    @property
    def title(self) -> str:
        """For tables."""
        from adaptrack.scenario import RoadDrive

        drives = self.runs.scenarios
        length = sum(each.length for each in drives if isinstance(each, RoadDrive)) / 1000.0
        roads = f"{len(drives)} roads" if len(drives) > 1 else str(drives[0].name)
        return f"car {self.car.name}, profile {self.profile.name}, {roads}, {length:.3g} km"

    def controller(self, name: str) -> Controller:
        """A registered controller for this car and profile, with its own tuning."""
        from adaptrack.control.controllers import get_controller

        offered = {"period": self.profile.period, "preview": True}
        return get_controller(name, self.car, profile=self.profile, offered=offered)

    def compare(self, contenders: Sequence[Contender], seeds: Sequence[int], reference: str) -> Comparison:
        """Drive them all."""
        from adaptrack.comparison.compare import compare

        with show.progress("drive") as advance:
            return compare(self.runs, contenders, seeds, reference, progress=advance, outline=self.car.outline)
