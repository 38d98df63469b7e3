"""`adaptrack tune`: the constant tuning of a controller that is best on given roads."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, on_roads, options, show
from adaptrack.cli.next_step import say_next
from adaptrack.cli.road import RoadOptions

if TYPE_CHECKING:
    from adaptrack.control.controllers import Controller
    from adaptrack.tuning.constant import Sought

FIRST_SEED = 1000
"""Noise seeds of a search count up from here, those of a judgement from 0: no tuning is judged on its own noise."""


@dataclass(frozen=True, kw_only=True)
class TuneOptions:
    """Options of `adaptrack tune`."""

    road: on_roads.Roads = None
    controller: Annotated[
        str,
        Option("--controller", metavar="NAME", help="Whose tuning is sought: any that `compare --list` calls tuned."),
    ] = "informed"
    car: options.CarAndPlant
    profile: options.Profile = "road"
    route: RoadOptions
    runs: Annotated[
        int | None,
        Option("--runs", metavar="N", min=1, help="Closed loops that the search may spend; by default 300 tunings."),
    ] = None
    noise_seeds: Annotated[
        int, Option("--noise-seeds", metavar="N", hidden=True, min=1, max=1000, help="Noise seeds of each road.")
    ] = 2
    seed: Annotated[int, Option("--seed", hidden=True, min=0, help="Of the search.")] = 0
    out: Annotated[Path, Option("--out", metavar="FILE", help="File of the tuning.")] = Path("tuning.toml")
    config: Annotated[str | None, Option("--config", hidden=True, help="Gone: see `paper campaign`.")] = None
    as_json: options.Json = False


@options.grouped
def tune(given: TuneOptions) -> None:
    """Seek the best tuning of a controller on given roads.

    It is written for `drive --tuning`. Default and tuned are then driven with noise that the search did not see. Runs
    that fail are counted; the exit code is 0. Campaigns over operating points: `adaptrack paper campaign`.
    """
    if given.config is not None:
        raise InvalidInput(
            f"tune --config: a campaign has its own command: adaptrack paper campaign {given.config} --out DIR."
        )
    roads = on_roads.named("tune", given.road, "for operating points: adaptrack paper campaign NAME --out DIR")
    options.make_place(given.out)
    setting = on_roads.RoadSetting.of(roads, given.route, given.car, given.profile, given.as_json)
    _tune(given, setting, _tunable(setting, given.controller))


def _tunable(setting: on_roads.RoadSetting, name: str) -> Controller:
    """The controller, with its own tuning; refused where none is sought."""
    from adaptrack.control.controllers import about_controller, list_controllers
    from adaptrack.tuning.spaces import search_space

    if not about_controller(name).tunable:
        others = ", ".join(each for each in list_controllers() if about_controller(each).tunable)
        raise InvalidInput(f"--controller {name}: its tuning is fixed; that of these can be sought: {others}.")
    own = setting.controller(name)
    search_space(own)  # one that says no bounds is refused before any work
    return own


def _tune(given: TuneOptions, setting: on_roads.RoadSetting, own: Controller) -> None:
    """Search, write the file, and judge it beside the controller's own tuning with other noise."""
    from adaptrack.comparison.contenders import Contender
    from adaptrack.comparison.table import finite
    from adaptrack.comparison.views import road_rows
    from adaptrack.results.comparison_answers import of_tuning
    from adaptrack.results.console import print_tables
    from adaptrack.results.road_comparison import console_tables
    from adaptrack.tuning.constant import seek_constant, swarm_within
    from adaptrack.tuning.pso import SwarmSettings

    name, runs = given.controller, setting.runs
    seeds = range(FIRST_SEED, FIRST_SEED + given.noise_seeds)
    each = len(runs) * len(seeds)
    swarm = SwarmSettings() if given.runs is None else swarm_within(given.runs, each)
    spent, begun = swarm.evaluations * each, time.perf_counter()
    show.say(f"adaptrack: {swarm.evaluations} tunings of {name}, {spent:,} runs; {setting.title}", aside=True)
    interrupt.kept("A search that is interrupted leaves nothing.")
    with show.progress(f"tune {name}") as advance:
        tell = partial(advance, f"tune {name}")
        found = seek_constant(runs, own, swarm, noise_seeds=seeds, seed=given.seed, progress=tell)
    seconds = time.perf_counter() - begun
    _keep(given, setting, (found, own), seeds)
    pair = [Contender("default", own), Contender("tuned", own.with_tuning(found.tuning))]
    judged = setting.compare(pair, range(max(3, given.noise_seeds)), "default")
    if given.as_json:
        about = {"tuning": str(given.out), "controller": name, "entries": found.tuning, "better": found.better}
        about |= {"belief": own.belief_at_first}
        said = {key: value for key, value in vars(found).items() if key != "tuning"}
        show.say_json(about | said | {"runs": spent, "seconds": seconds, "rows": finite(road_rows(judged))})
        return
    over = judged.ratio("tuned", "default")
    show.say(of_tuning(name, over, found.better))
    title = f"{name}, {setting.title}; {len(judged.seeds)} noise seeds that the search did not see"
    print_tables(console_tables(judged, road_rows(judged), title))
    if found.at_bounds:
        show.say(f"At the end of what was searched: {', '.join(found.at_bounds)}.")
    entries = ", ".join(f"{entry} {value:.4g}" for entry, value in found.tuning.items())
    show.say(f"Tuning: {entries}\nFile: {given.out} ({seconds:,.0f} s)")
    if own.belief is not None:
        show.say(f"Belief: {own.belief_at_first}.")
    say_next(*_next(given, found.better and over.verdict == "cheaper"))


def _next(given: TuneOptions, gained: bool) -> tuple[str, str]:
    """What to do with the tuning; or, where it gained nothing for sure, how to look further."""
    where = on_roads.typed(given.road or (), given.route, given.car, given.profile)
    if gained:
        return "drive with it", f"adaptrack drive ROAD{where.car} --tuning {given.out}"
    more = f"adaptrack tune {where.roads} OTHER-ROAD{where.car} --controller {given.controller}"
    return "more roads may decide it", more


def _keep(
    given: TuneOptions, setting: on_roads.RoadSetting, result: tuple[Sought, Controller], seeds: Sequence[int]
) -> None:
    """Write a tuning's file."""
    from adaptrack.tuning.constant_file import ConstantTuning

    found, own = result
    ConstantTuning(
        controller=given.controller, belief=own.belief_at_first, vehicle=setting.car.name, profile=setting.profile.name,
        period=setting.profile.period, roads=tuple(str(drive.name) for drive in setting.runs.scenarios),
        noise_seeds=tuple(seeds), command=options.command_line(), tuning=found.tuning,
    ).holding(setting.car, setting.profile).to_toml(given.out)  # fmt: skip
