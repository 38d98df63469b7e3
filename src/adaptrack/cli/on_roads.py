"""What `tune` and `evaluate` do when roads are given: one car, one profile, the same roads for everybody."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, options, show
from adaptrack.cli.road import ROADS, RoadOptions
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.comparison.contenders import Contender
    from adaptrack.comparison.table import Comparison
    from adaptrack.control.controllers import Controller
    from adaptrack.scenario.profile import Profile
    from adaptrack.tuning.constant import Sought
    from adaptrack.tuning.runs import RunSet

USUAL = ("informed", "published", "lqr", "pure-pursuit", "stanley")
"""The contenders on roads unless some are named."""
FIRST_SEARCH_SEED = 1000
"""Noise seeds of a search count up from here, those of a judgement from 0: no tuning is judged on its own noise."""
LEAST_ROADS = 6
"""Fewer than that say little about other roads."""

COLUMNS = (
    Column("contender", "contender"),
    Column("cost_mean", "mean J", "m²", show.digits(3)),
    Column("cost_geomean", "geomean", "m²", show.digits(3)),
    Column("regret_geomean", "ratio", "", show.digits(3)),
    Column("interval", "95 %\ninterval"),
    Column("rms_error", "RMS e", "m", show.digits(3)),
    Column("p95_error", "p95 |e|", "m", show.digits(3)),
    Column("max_corner_error", "corner |e|", "m", show.digits(3)),
    Column("failures", "runs\nfailed"),
)

Roads = Annotated[list[str] | None, typer.Argument(metavar="ROAD", help=f"Roads: {ROADS}", show_default=False)]


@dataclass(frozen=True)
class CarOptions:
    """Which car is driven along roads."""

    vehicle: Annotated[
        str | None,
        Option("--vehicle", metavar="CAR", help="On roads: name or .toml file, by default paper."),
    ] = None
    tyre: Annotated[
        str | None, Option("--tyre", hidden=True, help="On roads: name or .toml file; by default the vehicle's.")
    ] = None
    noise_seeds: Annotated[
        int | None,
        Option("--noise-seeds", hidden=True, min=1, max=1000, help="On roads: runs of each road, with other noise."),
    ] = None


def refuse(given: Sequence[str], on: str) -> None:
    """Refuse options that have no meaning here.

    Raises
    ------
    InvalidInput
        When there are any.
    """
    if given:
        raise InvalidInput(f"{', '.join(given)}: no meaning {on}; leave out.")


@dataclass(frozen=True, eq=False)
class Setting:
    """A car, a profile and roads."""

    car: Vehicle
    profile: Profile
    runs: RunSet

    @classmethod
    def of(
        cls, names: Sequence[str], asked: RoadOptions, car: CarOptions, profile: str | None, plant: str, aside: bool
    ) -> Setting:
        """Load the roads, plan the speeds, say what cannot be driven."""
        from adaptrack.control.controllers import MPC
        from adaptrack.scenario import RoadDrive
        from adaptrack.scenario.profile import load_profile
        from adaptrack.tuning.runs import RunSet

        vehicle, body = options.car_and_plant(car.vehicle or "paper", plant, car.tyre)
        world = load_profile(profile or "road")
        trips = []
        pairs = [(each, name) for each in asked.each for name in dict.fromkeys(names)]
        with show.progress("plan the speeds", len(pairs)) as advance:
            for each, name in pairs:
                advance(f"plan the speed, {name}", 0, 1)
                seen = each.look(name, vehicle)
                seen.warn(aside)
                trips.append(RoadDrive(seen.road, seen.plan))
                advance(f"plan the speed, {name}", 1, 1)
        mpc = MPC(vehicle, profile=world, preview=True)
        return cls(vehicle, world, RunSet(body, mpc, trips, profile or "road"))

    @property
    def title(self) -> str:
        """For tables."""
        from adaptrack.scenario import RoadDrive

        trips = self.runs.scenarios
        length = sum(each.length for each in trips if isinstance(each, RoadDrive)) / 1000.0
        roads = f"{len(trips)} roads" if len(trips) > 1 else str(trips[0].name)
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


# -- tune -------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SearchOptions:
    """How `tune` searches on roads."""

    runs: Annotated[
        int | None,
        Option("--runs", min=1, help="On roads: closed-loop runs that the search may spend; by default 300 tunings."),
    ] = None
    seed: Annotated[int, Option("--seed", hidden=True, min=0, help="On roads: of the search.")] = 0


def tune(setting: Setting, name: str, search: SearchOptions, noise_seeds: int, out: Path, as_json: bool) -> None:
    """Seek the constant of a controller, write its file, and judge it beside the controller's own with other noise."""
    from adaptrack.comparison.contenders import Contender
    from adaptrack.comparison.views import road_rows
    from adaptrack.control.controllers import about_controller, list_controllers
    from adaptrack.tuning.constant import seek_constant, swarm_within
    from adaptrack.tuning.pso import SwarmSettings

    if not about_controller(name).tunable:
        others = ", ".join(each for each in list_controllers() if about_controller(each).tunable)
        raise InvalidInput(f"--controller {name}: its tuning is fixed; that of these can be sought: {others}.")
    own, runs = setting.controller(name), setting.runs
    seeds = range(FIRST_SEARCH_SEED, FIRST_SEARCH_SEED + noise_seeds)
    each = len(runs) * len(seeds)
    swarm = SwarmSettings() if search.runs is None else swarm_within(search.runs, each)
    spent, begun = swarm.evaluations * each, time.perf_counter()
    show.say(f"adaptrack: {swarm.evaluations} tunings of {name}, {spent:,} runs; {setting.title}", aside=True)
    interrupt.kept("A search that is interrupted leaves nothing.")
    with show.progress(f"tune {name}") as advance:
        tell = partial(advance, f"tune {name}")
        found = seek_constant(runs, own, swarm, noise_seeds=seeds, seed=search.seed, progress=tell)
    seconds = time.perf_counter() - begun
    _keep(setting, name, found, seeds, out)
    pair = [Contender("default", own), Contender("tuned", own.with_tuning(found.tuning))]
    judged = setting.compare(pair, range(max(3, noise_seeds)), "default")
    if as_json:
        about = {"tuning": str(out), "controller": name, "entries": found.tuning, "better": found.better}
        told = {key: value for key, value in vars(found).items() if key != "tuning"}
        show.say_json(about | told | {"runs": spent, "seconds": seconds, "rows": road_rows(judged)})
        return
    print_rows(f"{name}, {setting.title}; {len(judged.seeds)} noise seeds that the search did not see", judged)
    if not found.better:
        show.say("The search found nothing better than the default, which is kept.")
    if found.at_bounds:
        show.say(f"At the end of what was searched: {', '.join(found.at_bounds)}.")
    entries = ", ".join(f"{entry} {value:.4g}" for entry, value in found.tuning.items())
    show.say(f"Tuning: {entries}\nFile: {out} ({seconds:,.0f} s); drive with it: adaptrack drive ROAD --tuning {out}")


def _keep(setting: Setting, name: str, found: Sought, seeds: Sequence[int], out: Path) -> None:
    """Write a tuning's file."""
    from adaptrack.tuning.constant_file import ConstantTuning

    ConstantTuning(
        controller=name, vehicle=setting.car.name, profile=setting.profile.name, period=setting.profile.period,
        roads=tuple(str(trip.name) for trip in setting.runs.scenarios), noise_seeds=tuple(seeds),
        command=options.command_line(), tuning=found.tuning,
    ).to_toml(out)  # fmt: skip


# -- evaluate ---------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Entered:
    """Who drives, as the options say."""

    contenders: Sequence[str]
    tunings: Sequence[Path]
    schedulers: Sequence[str]


def evaluate(setting: Setting, entered: Entered, seeds: Sequence[int], out: Path | None, as_json: bool) -> None:
    """Compare contenders on the roads, print and write the result."""
    contenders, left_out = _contenders(setting, entered, seeds)
    names = [each.name for each in contenders]
    reference = "informed" if "informed" in names else names[0]
    for why in left_out.values():
        show.say(f"Left out, {why}", aside=as_json)
    made = setting.compare(contenders, seeds, reference)
    if out is not None:
        from adaptrack.results.roads_compared import write_road_comparison

        page = write_road_comparison(out, made, title=setting.title, command=options.command_line())
        show.say(f"Page: {page}", aside=as_json)
    if as_json:
        from adaptrack.comparison.table import finite
        from adaptrack.comparison.views import road_rows

        show.say_json({
            "vehicle": setting.car.name, "profile": setting.profile.name, "roads": list(made.roads),
            "seeds": list(made.seeds), "reference": reference, "left_out": left_out, "rows": finite(road_rows(made)),
        })  # fmt: skip
        return
    print_rows(f"{setting.title}, {len(seeds)} noise seeds; ratio to {reference}", made)


def _contenders(setting: Setting, entered: Entered, seeds: Sequence[int]) -> tuple[list[Contender], dict[str, str]]:
    """Those that are asked for, or the usual ones that fit; and why others do not."""
    from adaptrack.comparison.compare import check_fits
    from adaptrack.comparison.contenders import Contender, check_contender, get_contender
    from adaptrack.tuning.constant_file import load_tuning

    chosen: list[Contender] = []
    left_out: dict[str, str] = {}
    for name in [*(entered.contenders or USUAL), *entered.schedulers]:
        check_contender(name)
    for name in dict.fromkeys(entered.contenders or USUAL):
        contender = get_contender(name, setting.runs)
        try:
            check_fits(contender, setting.runs)
        except InvalidInput as error:
            if entered.contenders:
                raise
            left_out[name] = str(error)
            continue
        chosen.append(contender)
    for file in dict.fromkeys(entered.tunings):
        kept = load_tuning(file)
        faults = kept.mismatches(setting.car.name, setting.profile.name, setting.profile.period)
        if set(kept.noise_seeds) & set(seeds):
            faults.append("was found with some of these noise seeds: choose another --seed")
        if faults:
            raise InvalidInput(f"--tuning {file}: {'; '.join(faults)}.")
        chosen.append(
            Contender(kept.label(file), kept.make(setting.car, setting.profile, setting.profile.period, preview=True))
        )
    chosen += [_scheduled(name, setting) for name in dict.fromkeys(entered.schedulers)]
    return chosen, left_out


def _scheduled(name: str, setting: Setting) -> Contender:
    """A scheduler on the informed MPC; one that was made for something else is refused."""
    from adaptrack.comparison.contenders import Contender
    from adaptrack.control.scheduling import check_scheduler, load_scheduler

    schedule = load_scheduler(name)
    check_scheduler(schedule)
    faults = setting.runs.mpc.mismatches(schedule, setting.profile.name)
    if faults:
        raise InvalidInput(f"scheduler {schedule.name!r} {'; it '.join(faults)}.")
    return Contender(schedule.name, schedule)


def print_rows(title: str, made: Comparison) -> None:
    """The table of a comparison, and who failed where."""
    from adaptrack.comparison.views import road_rows

    rows: list[dict[str, Any]] = road_rows(made)
    for row in rows:
        row["interval"] = f"{row['regret_low']:.3g}-{row['regret_high']:.3g}"
    show.table(title, COLUMNS, rows)
    count = len(made.table(made.reference))
    if len(made.roads) == 1:
        show.say(f"Interval: bootstrap over the {count} noise seeds of this one road; it says nothing about others.")
    else:
        few = "; they are few" if count < LEAST_ROADS else ""
        show.say(f"Interval: bootstrap over the {count} roads{few}.")
    for row in rows:
        for each in row["failed"][:MOST_TOLD]:
            where = f"{row['contender']}, {each['road']}, seed {each['seed']}"
            show.say_failed(f"{where}: at {each['at']:.1f} s the vehicle {each['because']}.")
        if len(row["failed"]) > MOST_TOLD:
            show.say(f"{row['contender']}: {len(row['failed']) - MOST_TOLD} more runs failed.")


MOST_TOLD = 3
"""Failed runs of a contender that are told one by one; --json has all."""
