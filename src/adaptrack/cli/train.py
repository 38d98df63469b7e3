"""`adaptrack train`: learn a scheduler from a data set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, instead, say_next
from adaptrack.cli.show import Column

COLUMNS = (
    Column("slot", "learned"),
    Column("r2", "R²\nheld out", "", 3),
    Column("ceiling_r2", "R²\nof trees", "", 3),
    Column("rmse", "RMSE\nheld out", "", 3),
    Column("ceiling_rmse", "RMSE\nof trees", "", 3),
    Column("dead_share", "dead", "%", "percent"),
    Column("parameters", "parameters"),
    Column("seconds", "time", "s", 3),
)


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Options of `adaptrack train`."""

    data: options.Data
    model: Annotated[options.ModelName, Option("--model", help="nn: 4-16-8-1 networks; anfis: fuzzy systems.")]
    out: Annotated[Path, Option("--out", metavar="FILE", help="File of the scheduler, *.json.")]
    targets: Annotated[
        options.TargetsName,
        Option("--targets", help="paper: Np, Nc, Q and R; ratio: log10 R/Q in place of the two weights."),
    ] = options.TargetsName.paper
    seed: options.LearningSeed = 0
    as_json: options.Json = False


@options.grouped
def train(given: TrainOptions) -> None:
    """Learn a scheduler from a data set.

    It is judged on operating points held out, beside boosted trees.
    """
    from adaptrack.control.scheduling import check_scheduler
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.paper.schedules import purpose_of, trained_schedule
    from adaptrack.paper.training import train as learn
    from adaptrack.results.answers import behind_trees, of_training

    out, model, targets = given.out, str(given.model), str(given.targets)
    if out.suffix != ".json":
        raise InvalidInput(f"--out {out}: a scheduler's file is called *.json.")
    dataset = load_dataset(given.data)
    options.make_place(out)
    with show.progress("train") as advance:
        trained = learn(dataset, model, targets, seed=given.seed, progress=advance)
        schedule = replace(trained_schedule(trained, dataset), made_for=purpose_of(dataset))
        check_scheduler(schedule)
    schedule.save(out)
    interrupt.kept(f"The scheduler is in {out}.")
    rows = trained.quality
    if given.as_json:
        about = {"scheduler": str(out), "data": dataset.name, "model": model, "targets": targets}
        show.say_json({**about, "rows": rows})
        return
    show.say(of_training(model, rows))
    held_out = f"{rows[0]['n_holdout']} of {len(dataset)} operating points held out"
    show.table(f"{dataset.name}, {held_out}; RMSE in the unit of what is learned", COLUMNS, rows)
    show.say(f"Scheduler: {out}")
    if model == "nn" and behind_trees(rows):
        say_next("to see whether anfis learns more", instead("--model", "anfis"))
        return
    known = {f"--{key}": schedule.made_for.get(name) for key, name in (("vehicle", "car"), ("profile", "profile"))}
    words = [word for option, value in known.items() if value for word in (option, value)]
    say_next("to see whether its loops are stable", command("certify", out, *words))
