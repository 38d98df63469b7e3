"""`adaptrack evaluate`: controllers and tunings on given roads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import SEED
from adaptrack.cli import on_roads, options, show
from adaptrack.cli.next_step import command, next_line
from adaptrack.cli.road import RoadOptions

if TYPE_CHECKING:
    from adaptrack.comparison.contenders import Contender
    from adaptrack.comparison.table import Comparison

USUAL = ("informed", "published", "lqr", "pure-pursuit", "stanley")
"""The contenders unless some are named."""


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Options of `adaptrack evaluate`."""

    road: on_roads.Roads = None
    contender: Annotated[
        list[str] | None,
        Option(
            "--contender", metavar="NAME",
            help="A registered controller, see `compare --list`; may be repeated. By default informed, published, lqr, "
            "pure-pursuit and stanley.",
        ),
    ] = None  # fmt: skip
    tuning: Annotated[
        list[Path] | None, Option("--tuning", metavar="FILE", help="Tuning that `tune` found; may be repeated.")
    ] = None
    car: options.CarAndPlant
    profile: options.Profile = "road"
    route: RoadOptions
    noise_seeds: Annotated[
        int,
        Option("--noise-seeds", metavar="N", hidden=True, min=1, max=1000, help="Runs of each road, with other noise."),
    ] = 5
    seed: Annotated[
        int, Option("--seed", hidden=True, callback=options.at_most(SEED, least=0), help="The first noise seed.")
    ] = 7
    out: options.Page = None
    as_json: options.Json = False


@options.grouped
def evaluate(given: EvaluateOptions) -> None:
    """Compare controllers and tunings on given roads.

    The same speed, car and noise for all. Failed runs are part of the result: they are
    counted for each contender, and the exit code is 0. Schedulers where none was trained: `adaptrack
    evaluate-schedules`.
    """
    from adaptrack.results.page import write_result
    from adaptrack.results.road_comparison import road_comparison_result

    roads = on_roads.named("evaluate", given.road, "schedulers on unseen drives: adaptrack evaluate-schedules")
    options.make_page_folder(given.out)
    setting = on_roads.RoadSetting.of(roads, given.route, given.car, given.profile, given.as_json)
    seeds = range(given.seed, given.seed + given.noise_seeds)
    contenders, left_out = _contenders(given, setting, seeds)
    names = [each.name for each in contenders]
    reference = "informed" if "informed" in names else names[0]
    made = setting.compare(contenders, seeds, reference)
    result = road_comparison_result(
        made, title=setting.title, notes=[f"left out, {words}" for words in left_out.values()],
        record={"vehicle": setting.car.name, "profile": setting.profile.name, "roads": list(made.roads),
                "seeds": list(made.seeds), "reference": reference, "left_out": left_out},
        command=options.command_line(), next_step=next_line(*_next(given, made)),
    )  # fmt: skip
    page = None if given.out is None else write_result(given.out, result)
    if given.as_json:
        for words in left_out.values():
            show.say(f"Left out, {words}", aside=True)
    show.say_result(result, given.as_json, page)


def _next(given: EvaluateOptions, made: Comparison) -> tuple[str, str]:
    """Tune the best where it can be and is not; else look whether it holds on other cars and roads."""
    from adaptrack.control.controllers import about_controller, list_controllers

    where, best = on_roads.typed(given.road or (), given.route, given.car, given.profile), made.best[0]
    if best in list_controllers() and about_controller(best).tunable and not given.tuning:
        return "tune the best", f"adaptrack tune {where.roads}{where.car} --controller {best}"
    return "other cars and roads, all tuned with the same effort", command("compare", "--out", "compared")


def _contenders(
    given: EvaluateOptions, setting: on_roads.RoadSetting, seeds: Sequence[int]
) -> tuple[list[Contender], dict[str, str]]:
    """Those that are named, or the usual ones that fit; and why others do not."""
    from adaptrack.comparison.compare import check_fits
    from adaptrack.comparison.contenders import Contender, check_contender, get_contender
    from adaptrack.tuning.constant_file import load_tuning

    chosen: list[Contender] = []
    left_out: dict[str, str] = {}
    for name in given.contender or USUAL:
        check_contender(name)
    for name in dict.fromkeys(given.contender or USUAL):
        contender = get_contender(name, setting.runs)
        try:
            check_fits(contender, setting.runs)
        except InvalidInput as error:
            if given.contender:
                raise
            left_out[name] = str(error)
            continue
        chosen.append(contender)
    for file in dict.fromkeys(given.tuning or ()):
        kept = load_tuning(file)
        faults = kept.mismatches(setting.car.name, setting.profile.name, setting.profile.period)
        if set(kept.noise_seeds) & set(seeds):
            faults.append("was found with some of these noise seeds: choose another --seed")
        if faults:
            raise InvalidInput(f"--tuning {file}: {'; '.join(faults)}.")
        tuned = kept.make(setting.car, setting.profile, setting.profile.period, preview=True)
        chosen.append(Contender(kept.label(file), tuned))
    return chosen, left_out
