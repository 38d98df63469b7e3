"""`adaptrack dataset describe` and `list`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import typer

from adaptrack.cli import options, show
from adaptrack.cli.next_step import again, command, next_line, say_next

app = typer.Typer(help="Data sets of tuned operating points.", no_args_is_help=True, rich_markup_mode=None)


@dataclass(frozen=True, kw_only=True)
class DescribeOptions:
    """Options of `adaptrack dataset describe`."""

    name: options.DataSetName
    out: options.Page = None
    as_json: options.Json = False


@app.command("describe")
@options.grouped
def describe_dataset(given: DescribeOptions) -> None:
    """Ranges and optima of a data set, and how much of them can be learned."""
    from adaptrack.learning.boosting import explained_shares
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.paper.data_set_summary import describe
    from adaptrack.results.dataset import dataset_result

    out, as_json = given.out, given.as_json
    dataset = load_dataset(given.name)
    if out is not None:
        options.make_folder(out)
    with show.progress("describe") as advance:
        found = describe(dataset, explained_shares(dataset, advance))
    learn = command("train", "--data", given.name, "--model", "nn", "--out", "nn.json")
    next_step = (
        next_line("to see it on a page", again("--out", "data-page")) if out is None
        else next_line("to learn a scheduler from it", learn)
    )  # fmt: skip
    result, page = replace(dataset_result(dataset, found), next_step=next_step), None
    if out is not None:
        from adaptrack.results.page import write_result

        with show.progress("write the page"):
            page = write_result(out, result)
    show.say_result(result, as_json, page)


@app.command("list")
def datasets(as_json: options.Json = False) -> None:
    """List the data sets that ship with the package."""
    from adaptrack.paper.data_set import list_datasets

    rows = [{"name": name} for name in list_datasets()]
    show.listing(f"{len(rows)} data sets", rows, as_json)
    if not as_json:
        say_next("to see what is in one", command("dataset", "describe", rows[0]["name"]))
