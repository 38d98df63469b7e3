"""`adaptrack paper reproduce`: repeat the paper's experiment."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.next_step import command, next_line, option_words


@dataclass(frozen=True, kw_only=True)
class ReproduceOptions:
    """Options of `adaptrack paper reproduce`."""

    out: Annotated[Path, Option("--out", metavar="FOLDER", help="Folder for the page and its pictures.")]
    quick: Annotated[bool, Option("--quick", help="Train for fewer epochs on fewer operating points.")] = False
    data: Annotated[
        str, Option("--data", metavar="NAME", help="Data set for training; its points must form a complete grid.")
    ] = "paper-grid"
    seed: options.LearningSeed = 0
    as_json: options.Json = False


@options.grouped
def reproduce(arguments: ReproduceOptions) -> None:
    """Repeat the paper's experiment.

    Failed runs are part of the result: they are counted, and the exit code is 0.
    """
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.paper.reproduce import reproduce as repeat_experiment
    from adaptrack.results.page import write_result
    from adaptrack.results.reproduce import reproduction_result

    dataset = load_dataset(arguments.data)
    options.make_page_folder(arguments.out)
    with show.progress("reproduce") as advance:
        reproduction = repeat_experiment(dataset, quick=arguments.quick, seed=arguments.seed, progress=advance)
    longer = option_words(replace(arguments, out=Path(f"{arguments.out}-whole"), quick=False, as_json=False))
    next_step = (
        next_line("to train as long as the paper", command("paper", "reproduce", *longer))
        if arguments.quick else next_line("to drive a road", command("drive", "country", "--out", "drive"))
    )  # fmt: skip
    result = replace(reproduction_result(reproduction, options.command_line()), next_step=next_step)
    with show.progress("write the page"):
        page = write_result(arguments.out, result)
    show.say_result(result, arguments.as_json, page)
