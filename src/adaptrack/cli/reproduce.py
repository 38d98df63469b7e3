"""`adaptrack reproduce`: the paper's experiment again."""

from __future__ import annotations

from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, say_next
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.studies.reproduce import Reproduction

COLUMNS = (
    Column("controller", "controller"),
    Column("moves", "moves"),
    Column("mse", "MSE", "m²"),
    Column("paper_mse", "paper", "m²"),
    Column("ratio", "ratio", "", show.digits(3)),
    Column("failed_at", "failed at", "s", show.digits(4)),
)

NEAR = 2.0
"""Factor between an error and the paper's, up to which they are called near."""

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
    if given.as_json:
        show.say(f"Report: {page}", aside=True)
        show.say_json(made.as_json())
        return
    show.say(_answer(made))
    for configuration, scenario, preview in dict.fromkeys(map(GROUP, made.rows)):
        rows = [row for row in made.rows if GROUP(row) == (configuration, scenario, preview)]
        show.table(f"{configuration}, {scenario}, with{'' if preview else 'out'} preview", COLUMNS, rows)
    show.say(f"{made.seconds:.0f} s, of which {made.training_seconds:.0f} s learning")
    show.say(f"Report: {page}")
    if given.quick:
        say_next("to learn as long as the paper did", command("reproduce", "--out", f"{out}-whole"))
    else:
        say_next("to drive the controller that knows its car on a road", command("drive", "country", "--out", "drive"))


def _answer(made: Reproduction) -> str:
    """How many runs come near the paper's, and how many failed."""
    known = [row["ratio"] for row in made.rows if row["ratio"] is not None and not row["failed"]]
    near = sum(1.0 / NEAR <= ratio <= NEAR for ratio in known)
    failed = sum(row["failed"] for row in made.rows)
    return (
        f"{near} of {len(known)} runs that the paper reports come within a factor of {NEAR:g} of its error; "
        f"{failed or 'none'} of all {len(made.rows)} runs failed."
    )
