"""`adaptrack reproduce`: the paper's experiment again."""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli.show import Column

COLUMNS = (
    Column("controller", "controller"),
    Column("moves", "moves"),
    Column("mse", "MSE", "m²"),
    Column("paper_mse", "paper", "m²"),
    Column("ratio", "ratio", "", show.digits(3)),
    Column("failed_at", "failed at", "s", show.digits(4)),
)

GROUP = itemgetter("configuration", "scenario", "preview")
"""What the rows of one table have in common."""


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Options of `adaptrack reproduce`."""

    out: Annotated[Path, Option("--out", metavar="FOLDER", help="Folder for the page and its pictures.")]
    quick: Annotated[bool, Option("--quick", help="Learn for fewer epochs, from fewer operating points.")] = False
    data: Annotated[
        str, Option("--data", metavar="NAME", help="Data set to learn from; its points must fill a grid.")
    ] = "paper-grid"
    seed: options.LearningSeed = 0
    as_json: options.Json = False


@options.grouped
def reproduce(given: ReproduceOptions) -> None:
    """Run the paper's experiment again, and write the page about it.

    Failed runs are part of the result: they are counted, and the exit code is 0.
    """
    from adaptrack.results.reproduce import write_reproduction
    from adaptrack.studies.reproduce import reproduce as run_again
    from adaptrack.tuning.dataset import load_dataset

    out = given.out
    dataset = load_dataset(given.data)
    options.make_folder(out)
    interrupt.kept(f"Finished stages are kept in {out}: run the command again to go on.")
    with show.progress("reproduce") as advance:
        made = run_again(dataset, quick=given.quick, seed=given.seed, folder=out, progress=advance)
    with show.progress("write the page"):
        page = write_reproduction(out, made, command=options.command_line())
    show.say(f"Report: {page}", aside=given.as_json)
    if given.as_json:
        show.say_json(made.as_json())
        return
    for configuration, scenario, preview in dict.fromkeys(map(GROUP, made.rows)):
        rows = [row for row in made.rows if GROUP(row) == (configuration, scenario, preview)]
        show.table(f"{configuration}, {scenario}, with{'' if preview else 'out'} preview", COLUMNS, rows)
    failed = sum(row["failed"] for row in made.rows)
    show.say(f"{failed or 'none'} of the {len(made.rows)} runs failed")
    show.say(f"{made.seconds:.0f} s, of which {made.training_seconds:.0f} s learning")
