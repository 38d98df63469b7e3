"""`adaptrack paper evaluate`: evaluate schedules on operating points, drives and tests outside their training set."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import DRIVES, MAX_SEED, OPERATING_POINTS
from adaptrack.cli import options, show
from adaptrack.cli.next_step import next_line, replace_option

if TYPE_CHECKING:
    from adaptrack.control.scheduling import Schedule
    from adaptrack.paper.adaptation import LearningTask
    from adaptrack.results.evaluation import Views

DEFAULT_POINTS = 2000
"""Default number of operating points without drives and tests."""


@dataclass(frozen=True, kw_only=True)
class EvaluateOptions:
    """Options of `adaptrack paper evaluate`."""

    folder: Annotated[
        Path | None, typer.Argument(metavar="[DIR]", help="Folder of `paper adapt`; default: the shipped schedules.")
    ] = None
    scheduler: Annotated[
        list[str] | None,
        Option("--scheduler", metavar="NAME", help="Further schedule: see `list schedules`, or a .json file."),
    ] = None
    operating_points: Annotated[
        int | None,
        Option(
            "--operating-points", metavar="N", callback=options.at_most(OPERATING_POINTS),
            help=f"Number of operating points, {OPERATING_POINTS.range}; default without --drives: {DEFAULT_POINTS}.",
        ),
    ] = None  # fmt: skip
    drives: Annotated[
        int | None,
        Option(
            "--drives", metavar="N", callback=options.at_most(DRIVES), help=f"Number of drives of 60 s, {DRIVES.range}."
        ),
    ] = None
    tests: Annotated[bool, Option("--tests", help="Also drive the paper's two tests.")] = False
    campaign: Annotated[
        str, Option("--campaign", metavar="NAME", hidden=True, help="Campaign of the schedules: name or .toml file.")
    ] = "road-sobol"
    profile: options.OtherProfile = None
    perception: Annotated[
        list[str] | None,
        Option(
            "--perception", metavar="WAY", hidden=True,
            help="Friction and wind that schedules get, besides exact: noisy, lagged, estimated, withheld, ...",
        ),
    ] = None  # fmt: skip
    seed: Annotated[
        int, Option("--seed", callback=options.at_most(MAX_SEED, least=0), help="Seed of operating points and drives.")
    ] = 7
    out: options.Page = None
    as_json: options.Json = False


@options.grouped
def evaluate(arguments: EvaluateOptions) -> None:
    """Compare schedules with the best constant and the optimum.

    Failed runs are part of the result: they are counted for each contender, and the exit code is 0.
    """
    from adaptrack.paper.adaptation import LearningTask, read_schedules, shipped_schedules
    from adaptrack.paper.campaign_config import load_campaign
    from adaptrack.results.evaluation import evaluation_result
    from adaptrack.results.page import write_result
    from adaptrack.tuning.runs import make_perception

    task = LearningTask.of(load_campaign(arguments.campaign).with_profile(arguments.profile))
    schedules = shipped_schedules() if arguments.folder is None else read_schedules(arguments.folder)
    schedules = check_schedules(task, schedules, arguments.scheduler or [])
    for way in arguments.perception or []:
        make_perception(way, task.estimated, task.profile)  # raises InvalidInput for unknown names
    if arguments.out is not None:
        options.make_page_folder(arguments.out)
    with show.progress("evaluate") as advance:
        views = _views(arguments, task, schedules, advance)
    result = evaluation_result(views, schedules, command=options.command_line())
    if not views["drives"]:
        step = next_line("to evaluate them on long drives", replace_option("--drives", 200))
        result = replace(result, next_step=step)
    page = None
    if arguments.out is not None:
        with show.progress("write the page"):
            page = write_result(arguments.out, result)
    show.say_result(result, arguments.as_json, page)


def _views(arguments: EvaluateOptions, task: LearningTask, schedules: dict[str, Schedule], progress: Any) -> Views:
    from adaptrack.paper.evaluation import evaluate_on_drives, evaluate_on_operating_points, evaluate_on_tests

    points, drives, seed = arguments.operating_points, arguments.drives, arguments.seed
    if points is None and drives is None and not arguments.tests:
        points = DEFAULT_POINTS
    ways = tuple(dict.fromkeys(["exact", *(arguments.perception or [])]))
    settings: dict[str, Any] = {"perception": ways, "progress": progress}
    return {
        "operating points": evaluate_on_operating_points(task, schedules, points, seed, **settings) if points else {},
        "drives": evaluate_on_drives(task, schedules, drives, seed, **settings) if drives else {},
        "tests": evaluate_on_tests(task, schedules) if arguments.tests else {},
    }


def check_schedules(task: LearningTask, schedules: dict[str, Schedule], names: Sequence[str]) -> dict[str, Schedule]:
    """Add schedules by name or file, and check that all schedules were made for the task.

    Raises
    ------
    InvalidInput
        When a schedule was made for a different controller, car or profile, or when two have the same name.
    """
    from adaptrack.control.scheduling import check_scheduler, load_scheduler
    from adaptrack.scenario.profile import load_profile

    profile, checked = load_profile(task.profile).name, dict(schedules)
    for name in names:
        schedule = load_scheduler(name)
        check_scheduler(schedule)
        if schedule.name in (*checked, "optimum"):
            raise InvalidInput(f"--scheduler {name}: a schedule with this name exists already: rename the file.")
        checked[schedule.name] = schedule
    for name, schedule in checked.items():
        faults = task.mpc.mismatches(schedule, profile)
        if faults:
            raise InvalidInput(f"schedule {name!r} {'; it '.join(faults)}.")
    return checked
