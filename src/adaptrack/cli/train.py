"""`adaptrack paper train`: train a schedule on a data set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, say_next
from adaptrack.cli.show import Column

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


@dataclass(frozen=True, kw_only=True)
class TrainOptions:
    """Options of `adaptrack paper train`."""

    data: options.Data
    model: Annotated[options.ModelName, Option("--model", help="nn: neural networks (4-16-8-1); anfis: fuzzy systems.")]
    out: Annotated[Path, Option("--out", metavar="FILE", help="File for the schedule (.json).")]
    targets: Annotated[
        options.TargetsName,
        Option("--targets", help="Learned quantities. paper: Np, Nc, Q and R; ratio: Np, Nc and log10 R/Q."),
    ] = options.TargetsName.paper
    seed: options.LearningSeed = 0
    as_json: options.Json = False


@options.grouped
def train(arguments: TrainOptions) -> None:
    """Train a schedule on a data set.

    The quality is measured on held-out operating points. Boosted trees show the best quality that can be expected.
    """
    from adaptrack.control.scheduling import check_scheduler
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.paper.training import purpose_of, trained_schedule
    from adaptrack.paper.training import train as train_models

    out, model, targets = arguments.out, str(arguments.model), str(arguments.targets)
    if out.suffix != ".json":
        raise InvalidInput(f"--out {out}: give a file name that ends in .json.")
    dataset = load_dataset(arguments.data)
    options.make_place(out)
    with show.progress("train") as advance:
        trained = train_models(dataset, model, targets, seed=arguments.seed, progress=advance)
        schedule = replace(trained_schedule(trained, dataset), made_for=purpose_of(dataset))
        check_scheduler(schedule)
    schedule.save(out)
    interrupt.note_progress(f"The schedule is in {out}.")
    rows = trained.quality
    if arguments.as_json:
        show.say_json({"scheduler": str(out), "data": dataset.name, "model": model, "targets": targets, "rows": rows})
        return
    held_out = f"{rows[0]['n_holdout']} of {len(dataset)} operating points held out"
    show.table(f"{model} from {dataset.name}, {held_out}; RMSE in the unit of the target", QUALITY_COLUMNS, rows)
    show.say(f"Schedule: {out}")
    purpose = {f"--{key}": schedule.made_for.get(name) for key, name in (("vehicle", "car"), ("profile", "profile"))}
    words = [word for option, value in purpose.items() if value for word in (option, value)]
    say_next("to see whether its loops are stable", command("certify", out, *words))
