"""`adaptrack evaluate`: compare controllers on roads, or schedulers on what nobody tuned or trained on."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import DRIVES, OPERATING_POINTS, SEED, check_limit
from adaptrack.cli import comparison, on_roads, options, show
from adaptrack.cli.road import RoadOptions

if TYPE_CHECKING:
    from adaptrack.control.scheduling import Schedule
    from adaptrack.learning.adaptation.splits import SetUp

USUAL = "sobol:2000"
"""The operating points when nothing is asked for."""


@options.grouped
def evaluate(
    asked: RoadOptions,
    car: on_roads.CarOptions,
    road: on_roads.Roads = None,
    tuning: Annotated[
        list[Path] | None, Option("--tuning", metavar="FILE", help="On roads: tuning that `tune ROAD` found.")
    ] = None,
    schedulers: Annotated[
        list[str] | None,
        Option(metavar="NAME", help="Names (see `schedulers`), files or folders, beside those that ship."),
    ] = None,
    contender: Annotated[
        list[str] | None,
        Option(
            "--contender", metavar="NAME",
            help="Name of a registered contender, driven beside the schedulers; on roads instead of the usual ones "
            "(informed, published, lqr, pure-pursuit, stanley).",
        ),
    ] = None,
    operating_points: Annotated[
        str | None,
        Option(
            "--operating-points", "--conditions", hidden=True, metavar="sobol:N",
            help=f"So many unseen operating points, {OPERATING_POINTS.range} (also: --conditions).",
        ),
    ] = None,
    drives: Annotated[
        int | None, Option(callback=options.at_most(DRIVES), help=f"So many random drives of 60 s, {DRIVES.range}.")
    ] = None,
    tests: Annotated[bool, Option("--tests", hidden=True, help="The paper's two tests.")] = False,
    config: Annotated[
        str | None,
        Option(
            hidden=True,
            help="Whose vehicle, controller, profile and domain: name (road, informed-road, ...) or .toml file; by "
            "default what ships for controller and profile."
        ),
    ] = None,
    controller: options.Tuned = None,
    profile: options.OtherProfile = None,
    plant: Annotated[
        str | None, Option("--plant", hidden=True, help="A registered plant to drive instead of the configuration's.")
    ] = None,
    plugin: options.Plugin = None,
    known_as: Annotated[
        list[str] | None,
        Option(
            "--known-as", "--told", hidden=True,
            help="How friction and wind are known: exact, noisy, lagged, estimated, withheld, ... (also: --told).",
        ),
    ] = None,
    seed: Annotated[
        int,
        Option(
            "--seed",
            callback=options.at_most(SEED, least=0),
            help="Which operating points and drives; on roads the first noise seed.",
        ),
    ] = 7,
    out: options.Page = None,
    as_json: options.Json = False,
) -> None:  # fmt: skip
    """Compare controllers, tunings and schedulers on given roads: the same speed, car and noise for all.

    Without a road: compare schedulers with the best constant and the optimum of each operating point, where none was
    trained.

    A plant that is stepped in Python is driven run by run; no optimum is searched for on it. Failed runs are part of
    the result: they are counted for each contender, and the exit code is 0.
    """
    from adaptrack.comparison.contenders import check_contender
    from adaptrack.comparison.evaluate import on_drives, on_operating_points, on_tests
    from adaptrack.learning.adaptation.splits import SetUp
    from adaptrack.studies.adapt import Adapted
    from adaptrack.tuning.runs import perception

    options.load_plugins(plugin)
    if road:
        other = {"--operating-points": operating_points, "--drives": drives, "--tests": tests, "--config": config,
                 "--controller": controller, "--known-as": known_as}  # fmt: skip
        on_roads.refuse([name for name, value in other.items() if value], "on roads")
        options.make_page_folder(out)
        setting = on_roads.Setting.of(road, asked, car, profile, plant or "dual-track", as_json)
        entered = on_roads.Entered(contender or (), tuning or (), _all_files(schedulers or []))
        on_roads.evaluate(setting, entered, range(seed, seed + (car.noise_seeds or 5)), out, as_json)
        return
    own = {**vars(car), "tuning": tuning}
    on_roads.refuse([*asked.named, *(f"--{name.replace('_', '-')}" for name, value in own.items() if value)],
                    "without a road")  # fmt: skip
    settings = comparison.study(config, controller, profile)
    setup = SetUp.of(settings)
    if plant is not None:
        setup = setup.driving(plant)
    compared, more = schedules(setup, schedulers or []), contender or []
    if operating_points is None and drives is None and not tests:
        operating_points = USUAL
    count = 0 if operating_points is None else _sample_size(operating_points)
    ways = tuple(dict.fromkeys(["exact", *(known_as or [])]))
    for way in ways:
        perception(way, setup.believed, setup.profile)  # an unknown one is refused before any work
    for name in more:
        check_contender(name)
    if out is not None:
        options.make_folder(out)
    with show.progress("evaluate") as advance:
        how: dict[str, Any] = {"known_as": ways, "more": more, "progress": advance}
        made = Adapted(
            compared,
            {},
            on_operating_points(setup, compared, count, seed, **how) if count else {},
            on_drives(setup, compared, drives, seed, **how) if drives else {},
            on_tests(setup, compared, more=more) if tests else {},
        )
    if out is not None:
        show.say(f"Report: {comparison.write_page(out, made)}", aside=as_json)
    comparison.print_comparison(made, as_json)


def schedules(setup: SetUp, given: Sequence[str]) -> dict[str, Schedule]:
    """What ships for an adaptation, and the schedulers given by name or file; a name that recurs says whose it is.

    Raises
    ------
    InvalidInput
        When one of them was made for another controller, car or profile.
    """
    from adaptrack.comparison.contenders import reserved
    from adaptrack.control.scheduling import check_scheduler, load_scheduler
    from adaptrack.scenario.profile import load_profile
    from adaptrack.studies.adapt import contender_of, shipped

    found = shipped(setup.config.name)
    world, files = load_profile(setup.profile).name, {each.name for each in found.values()}
    for name in _all_files(given):
        schedule = load_scheduler(name)
        check_scheduler(schedule)
        faults = setup.mpc.mismatches(schedule, world)
        if faults:
            raise InvalidInput(f"scheduler {schedule.name!r} {'; it '.join(faults)}.")
        kind = contender_of(schedule.name, [setup.config.name])
        if kind is not None and kind not in found:  # of a chain of one's own
            found[kind] = schedule
            continue
        if schedule.name in files | reserved():
            schedule = replace(schedule, name=f"{schedule.name} ({name})")
        files.add(schedule.name)
        found[schedule.name] = schedule
    return found


def _all_files(given: Sequence[str]) -> list[str]:
    """Of names, files and folders."""
    return list(itertools.chain.from_iterable(map(_files, given)))


def _files(given: str) -> list[str]:
    """The schedulers in a folder, else what is given."""
    folder = Path(given)
    if not folder.is_dir():
        return [given]
    found = sorted(str(path) for path in folder.glob("*.json"))
    if not found:
        raise InvalidInput(f"--schedulers {given}: there is no scheduler (*.json) in this folder.")
    return found


def _sample_size(text: str) -> int:
    """The N of `sobol:N`."""
    kind, _, digits = text.partition(":")
    if kind != "sobol" or not digits.isdecimal() or not digits.strip("0"):
        raise InvalidInput(f"--operating-points {text[:40]!r}: write sobol:N, for instance {USUAL}.")
    count = int(digits[:20])  # of more digits it is too large in any case
    check_limit("--operating-points", count, OPERATING_POINTS)
    return count
