"""`adaptrack evaluate-schedules`: schedulers on operating points, drives and tests that nobody trained on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Annotated, Any

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import DRIVES, OPERATING_POINTS, SEED, check_limit
from adaptrack.cli import comparison, options, show
from adaptrack.cli.next_step import again, command, say_next

if TYPE_CHECKING:
    from adaptrack.control.scheduling import Schedule
    from adaptrack.learning.adaptation.splits import SetUp
    from adaptrack.studies.adapt import Adapted

USUAL = "sobol:2000"
"""The operating points when none are given."""


@dataclass(frozen=True, kw_only=True)
class EvaluateSchedulesOptions:
    """Options of `adaptrack evaluate-schedules`."""

    schedulers: Annotated[
        list[str] | None,
        Option(
            "--schedulers", metavar="NAME", help="Names (see `schedulers`), files or folders, beside those that ship."
        ),
    ] = None
    contender: Annotated[
        list[str] | None,
        Option("--contender", metavar="NAME", help="A registered controller (`compare --list`) beside them."),
    ] = None
    drives: Annotated[
        int | None,
        Option(
            "--drives", metavar="N", callback=options.at_most(DRIVES), help=f"Random drives of 60 s, {DRIVES.range}."
        ),
    ] = None
    operating_points: Annotated[
        str | None,
        Option(
            "--operating-points", "--conditions", metavar="sobol:N",
            help=f"So many unseen operating points, {OPERATING_POINTS.range} [default: {USUAL}].",
        ),
    ] = None  # fmt: skip
    tests: Annotated[bool, Option("--tests", help="The paper's two tests.")] = False
    config: Annotated[
        str,
        Option(
            "--config", metavar="NAME", hidden=True,
            help="Adaptation whose vehicle, profile and domain are used: name (road) or .toml file.",
        ),
    ] = "road"  # fmt: skip
    profile: options.OtherProfile = None
    plant: Annotated[
        str | None,
        Option("--plant", metavar="NAME", hidden=True, help="A registered plant instead of the configuration's."),
    ] = None
    plugin: options.Plugin = None
    known_as: Annotated[
        list[str] | None,
        Option(
            "--known-as", "--told", metavar="HOW", hidden=True,
            help="How friction and wind are known: exact, noisy, lagged, estimated, withheld, ...",
        ),
    ] = None  # fmt: skip
    seed: Annotated[
        int, Option("--seed", callback=options.at_most(SEED, least=0), help="Which operating points and drives.")
    ] = 7
    out: options.Page = None
    as_json: options.Json = False


@options.grouped
def evaluate_schedules(given: EvaluateSchedulesOptions) -> None:
    """Compare schedulers where none of them was trained.

    Against the best constant, and the optimum of each operating point. A plant that is stepped in Python is driven run
    by run; no optimum is searched for on it. Failed runs are part of the result: they are counted for each contender,
    and the exit code is 0.
    """
    from adaptrack.comparison.contenders import check_contender
    from adaptrack.comparison.evaluate import on_drives, on_operating_points, on_tests
    from adaptrack.learning.adaptation.config import load_adaptation
    from adaptrack.learning.adaptation.splits import SetUp
    from adaptrack.studies.adapt import Adapted
    from adaptrack.tuning.runs import perception

    options.load_plugins(given.plugin)
    setup = SetUp.of(load_adaptation(given.config, profile=given.profile))
    if given.plant is not None:
        setup = setup.driving(given.plant)
    compared, more = schedules(setup, given.schedulers or []), given.contender or []
    points = given.operating_points
    if points is None and given.drives is None and not given.tests:
        points = USUAL
    count = 0 if points is None else _sample_size(points)
    ways = tuple(dict.fromkeys(["exact", *(given.known_as or [])]))
    for way in ways:
        perception(way, setup.believed, setup.profile)  # an unknown one is refused before any work
    for name in more:
        check_contender(name)
    if given.out is not None:
        options.make_folder(given.out)
    with show.progress("evaluate") as advance:
        how: dict[str, Any] = {"known_as": ways, "more": more, "progress": advance}
        made = Adapted(
            compared,
            {},
            on_operating_points(setup, compared, count, given.seed, **how) if count else {},
            on_drives(setup, compared, given.drives, given.seed, **how) if given.drives else {},
            on_tests(setup, compared, more=more) if given.tests else {},
        )
    page = None if given.out is None else comparison.write_page(given.out, made)
    if not given.as_json:
        show.say(comparison.answer(made))
    comparison.print_comparison(made, given.as_json)
    if page is not None:
        show.say(f"Page: {page}", aside=given.as_json)
    if not given.as_json:
        say_next(*_next(made))


def _next(made: Adapted) -> tuple[str, str]:
    """The same on drives where only points were driven; else the best schedule, or the constant, on roads."""
    if not made.drives:
        return "long drives, on which a schedule has to hold", again("--drives", 200)
    worthy = comparison.worthy_schedule(made)
    if worthy is None:
        return "keep the constant", command("drive", "ROAD")
    return "see with which margins", command("certify", worthy)


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
    for name in comparison.scheduler_files(given):
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


def _sample_size(text: str) -> int:
    """The N of `sobol:N`."""
    kind, _, digits = text.partition(":")
    if kind != "sobol" or not digits.isdecimal() or not digits.strip("0"):
        raise InvalidInput(f"--operating-points {text[:40]!r}: write sobol:N, for instance {USUAL}.")
    count = int(digits[:20])  # of more digits it is too large in any case
    check_limit("--operating-points", count, OPERATING_POINTS)
    return count
