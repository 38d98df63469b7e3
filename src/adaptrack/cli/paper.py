"""`adaptrack paper`: the commands that repeat and extend the experiment of the paper."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import typer

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import DRIVES, MAX_SEED, OPERATING_POINTS, WORKERS, RequestLimit, check_limit
from adaptrack.cli import note_progress, options, show
from adaptrack.cli.next_step import add_command, next_line, say_next
from adaptrack.cli.options import argument, flag, json_flag, option
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.paper.adaptation import LearningTask

app = typer.Typer(help="Repeat the paper's experiment, step by step.", no_args_is_help=True, rich_markup_mode=None)


def at_most(limit: RequestLimit, least: int = 1) -> Callable[[typer.CallbackParam, int | None], int | None]:
    """Return an option callback that raises InvalidInput for counts outside `least` to the limit."""

    def check(option: typer.CallbackParam, value: int | None) -> int | None:
        if value is not None:
            name = max(option.opts, key=len)
            if value < least:
                raise InvalidInput(f"{name} = {value}: must be a whole number, at least {least}.")
            check_limit(name, value, limit)
        return value

    return check


learning_seed_option = partial(option, None, "Seed of the held-out set and the initial weights.", 0, min=0)
profile_option = partial(option, "NAME", "Profile; default: that of the campaign.")
workers_option = partial(
    option, "N", "Worker processes; default: one per core.", hidden=True, callback=at_most(WORKERS)
)


# -- reproduce --------------------------------------------------------------------------------------------------------
@app.command()
@options.grouped
def reproduce(
    *,
    out: Path = options.page_option(...),
    quick: bool = flag("Train for fewer epochs on fewer operating points."),
    data: str = option("NAME", "Data set for training; its points must form a complete grid.", "paper-grid"),
    seed: int = learning_seed_option(),
    as_json: bool = json_flag(),
) -> None:
    """Repeat the paper's experiment.

    Failed runs are part of the result: they are counted, and the exit code is 0.
    """
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.paper.reproduce import reproduce as repeat_experiment
    from adaptrack.results.reproduce import reproduction_result

    dataset = load_dataset(data)
    options.make_page_folder(out)
    with show.progress("reproduce") as advance:
        reproduction = repeat_experiment(dataset, quick=quick, seed=seed, progress=advance)
    result = add_command(reproduction_result(reproduction), "paper reproduce", quick=quick, out=out)
    show.say_result(result, as_json, out)


# -- campaign ---------------------------------------------------------------------------------------------------------
@app.command()
@options.grouped
def campaign(
    *,
    name: str = argument(
        "CAMPAIGN",
        "With --out: paper-grid, road-sobol, or a .toml file. Without: a data set (name, file or folder).",
        ...,
    ),
    out: Path | None = option("DIR", "Folder of the campaign; without it, no tuning."),
    workers: int | None = workers_option(),
    cluster: str | None = option("ADDRESS", "Address of a Dask scheduler, tcp://HOST:PORT; its workers compute."),
    as_json: bool = json_flag(),
) -> None:
    """Tune the MPC at the operating points of a campaign.

    With --out, the command runs the campaign in this folder, or continues an interrupted campaign. It then writes a
    page about the data set. Without --out, it only describes an existing data set.
    """
    from adaptrack.paper.campaign import run_campaign
    from adaptrack.paper.campaign_config import load_campaign
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.results.dataset import dataset_result

    data: str | Path = name
    if out is not None:
        config = load_campaign(name)
        note_progress(f"Finished parts are in {out}: run the command again to continue.")
        with show.progress("campaign") as advance:
            data = run_campaign(config, out, workers=workers, cluster=cluster, progress=advance)
    next_step = next_line("paper campaign", data=out or name)
    show.say_result(replace(dataset_result(load_dataset(data)), next_step=next_step), as_json, out)


# -- train ------------------------------------------------------------------------------------------------------------
QUALITY_COLUMNS = (
    Column("slot", "target"),
    Column("r2", "R²\nheld out", "", 3),
    Column("ceiling_r2", "R²\nof trees", "", 3),
    Column("rmse", "RMSE\nheld out", "", 3),
    Column("ceiling_rmse", "RMSE\nof trees", "", 3),
    Column("dead_share", "dead", "%", "percent"),
    Column("parameters", "parameters"),
    Column("seconds", "time", "s", 3),
)


@app.command()
@options.grouped
def train(
    *,
    data: str = option("NAME", "Data set: paper-grid, road-sobol, a file, or the folder of a campaign.", ...),
    model: Literal["nn", "anfis"] = option(None, "nn: neural networks (4-16-8-1); anfis: fuzzy systems.", ...),
    out: Path = option("FILE", "File for the schedule (.json).", ...),
    targets: Literal["paper", "ratio"] = option(
        None, "Learned quantities. paper: Np, Nc, Q and R; ratio: Np, Nc and log10 R/Q.", "paper"
    ),
    seed: int = learning_seed_option(),
    as_json: bool = json_flag(),
) -> None:
    """Train a schedule on a data set.

    The quality is measured on held-out operating points. Boosted trees show the best quality that can be expected.
    """
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.paper.training import purpose_of, trained_schedule
    from adaptrack.paper.training import train as train_models

    dataset = load_dataset(data)
    options.make_place(out, ".json")
    with show.progress("train") as advance:
        trained = train_models(dataset, model, targets, seed=seed, progress=advance)
        schedule = replace(trained_schedule(trained, dataset), made_for=purpose_of(dataset))
        at.check_scheduler(schedule)
    schedule.save(out)
    note_progress(f"The schedule is in {out}.")
    rows = trained.quality
    if as_json:
        show.say_json({"scheduler": str(out), "data": dataset.name, "model": model, "targets": targets, "rows": rows})
        return
    held_out = f"{rows[0]['n_holdout']} of {len(dataset)} operating points held out"
    show.table(f"{model} from {dataset.name}, {held_out}; RMSE in the unit of the target", QUALITY_COLUMNS, rows)
    show.say(f"Schedule: {out}")
    purpose = {f"--{key}": schedule.made_for.get(name) for key, name in (("vehicle", "car"), ("profile", "profile"))}
    words = [word for option, value in purpose.items() if value for word in (option, value)]
    say_next("paper train", schedule=out, purpose=words)


# -- adapt ------------------------------------------------------------------------------------------------------------
ROUND_COLUMNS = (
    Column("contender", "schedule"),
    Column("round", "best\nround", "", "whole"),
    Column("score", "log cost\nheld out", "", 4),
    Column("failed", "runs\nfailed", "", "whole"),
)


@app.command()
@options.grouped
def adapt(
    *,
    campaign: str = argument("CAMPAIGN", "Campaign with a Sobol sample: road-sobol, or a .toml file.", "road-sobol"),
    out: Path = option("DIR", "Folder for campaign and schedules; a repeated command continues in it.", ...),
    profile: str | None = profile_option(),
    workers: int | None = workers_option(),
    as_json: bool = json_flag(),
) -> None:
    """Run a campaign and train schedules on it.

    The schedules are constants, a look-up table, neural networks and ANFIS (fuzzy systems).

    Failed runs are part of the result: they are counted, and the exit code is 0.
    """
    from adaptrack.paper.adaptation import adapt as learn
    from adaptrack.paper.campaign_config import load_campaign

    config = load_campaign(campaign).with_profile(profile)
    options.make_folder(out)
    note_progress(f"Finished parts and schedules are in {out}: run the command again to continue.")
    with show.progress("adapt") as advance:
        schedules = learn(config, out, workers=workers, progress=advance)
    rows = [
        {"contender": name, **min(schedule.provenance["history"], key=lambda entry: entry["score"])}
        for name, schedule in schedules.items()
        if "history" in schedule.provenance
    ]
    if as_json:
        show.say_json({"schedulers": str(out / "schedulers"), "rows": rows})
        return
    show.table("Schedules trained in closed loop", ROUND_COLUMNS, rows)
    show.say(f"Schedules: {out / 'schedulers'}")
    words = None if profile is None else ["--profile", profile]
    say_next("paper adapt", folder=out, campaign=campaign, profile=words)


# -- evaluate ---------------------------------------------------------------------------------------------------------
DEFAULT_POINTS = 2000
"""Default number of operating points without drives and tests."""


@app.command()
@options.grouped
def evaluate(
    *,
    folder: Path | None = argument("[DIR]", "Folder of `paper adapt`; default: the shipped schedules."),
    scheduler: list[str] | None = option("NAME", "Further schedule: see `list schedules`, or a .json file."),
    operating_points: int | None = option(
        "N",
        f"Number of operating points, {OPERATING_POINTS.range}; default without --drives: {DEFAULT_POINTS}.",
        callback=at_most(OPERATING_POINTS),
    ),
    drives: int | None = option("N", f"Number of drives of 60 s, {DRIVES.range}.", callback=at_most(DRIVES)),
    tests: bool = flag("Also drive the paper's two tests."),
    campaign: str = option("NAME", "Campaign of the schedules: name or .toml file.", "road-sobol", hidden=True),
    profile: str | None = profile_option(),
    perception: list[str] | None = option(
        "WAY",
        "Friction and wind that schedules get, besides exact: noisy, lagged, estimated, withheld, ...",
        hidden=True,
    ),
    seed: int = option(None, "Seed of operating points and drives.", 7, callback=at_most(MAX_SEED, least=0)),
    out: Path | None = options.page_option(),
    as_json: bool = json_flag(),
) -> None:
    """Compare schedules with the best constant and the optimum.

    Failed runs are part of the result: they are counted for each contender, and the exit code is 0.
    """
    from adaptrack.paper.adaptation import LearningTask, read_schedules, shipped_schedules
    from adaptrack.paper.campaign_config import load_campaign
    from adaptrack.paper.evaluation import evaluate_on_drives, evaluate_on_operating_points, evaluate_on_tests
    from adaptrack.results.evaluation import evaluation_result
    from adaptrack.tuning.runs import make_perception

    task = LearningTask.of(load_campaign(campaign).with_profile(profile))
    schedules = shipped_schedules() if folder is None else read_schedules(folder)
    schedules = _add_schedules(task, schedules, scheduler or [])
    for way in perception or []:
        make_perception(way, task.estimated, task.profile)  # raises InvalidInput for unknown names
    options.make_page_folder(out)
    points = DEFAULT_POINTS if operating_points is None and drives is None and not tests else operating_points
    ways = tuple(dict.fromkeys(["exact", *(perception or [])]))
    with show.progress("evaluate") as advance:
        settings: dict[str, Any] = {"perception": ways, "progress": advance}
        views = {
            "operating points": evaluate_on_operating_points(task, schedules, points, seed, **settings)
            if points
            else {},
            "drives": evaluate_on_drives(task, schedules, drives, seed, **settings) if drives else {},
            "tests": evaluate_on_tests(task, schedules) if tests else {},
        }
    result = add_command(evaluation_result(views, schedules), "paper evaluate", has_no_drives=not drives)
    show.say_result(result, as_json, out)


def _add_schedules(
    task: LearningTask, schedules: dict[str, at.Schedule], names: Sequence[str]
) -> dict[str, at.Schedule]:
    """Add schedules by name or file; refuse equal names, and schedules for a different controller, car or profile."""
    profile, checked = at.load_profile(task.profile).name, dict(schedules)
    for name in names:
        schedule = at.load_scheduler(name)
        at.check_scheduler(schedule)
        if schedule.name in (*checked, "optimum"):
            raise InvalidInput(f"--scheduler {name}: a schedule with this name exists already: rename the file.")
        checked[schedule.name] = schedule
    for name, schedule in checked.items():
        faults = task.mpc.mismatches(schedule, profile)
        if faults:
            raise InvalidInput(f"schedule {name!r} {'; it '.join(faults)}.")
    return checked
