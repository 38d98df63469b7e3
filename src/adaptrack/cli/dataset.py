"""`adaptrack dataset describe` and `list`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import typer

from adaptrack.cli import options, show
from adaptrack.cli.next_step import again, command, say_next

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
    from adaptrack.results.answers import of_dataset
    from adaptrack.tuning.dataset import describe, load_dataset

    out, as_json = given.out, given.as_json
    dataset = load_dataset(given.name)
    if out is not None:
        options.make_folder(out)
    with show.progress("describe") as advance:
        found = describe(dataset, explained_shares(dataset, advance))
    if out is not None:
        from adaptrack.results import write_dataset_report

        with show.progress("write the page"):
            page = write_dataset_report(out, dataset, summary=found)
    if as_json:
        show.say_json(found)
    else:
        show.say(of_dataset(found))
        _print(found)
    if out is not None:
        show.say(f"Report: {page}", aside=as_json)
    if not as_json:
        if out is None:
            say_next("to see it on a page", again("--out", "data-page"))
        else:
            learn = command("train", "--data", given.name, "--model", "nn", "--out", "nn.json")
            say_next("to learn a scheduler from it", learn)


def _print(found: Mapping[str, Any]) -> None:
    plain = {key: value for key, value in found.items() if not isinstance(value, dict | list)}
    show.flat(found["name"], plain, False)
    for key, value in found.items():
        if isinstance(value, dict):
            value = [{"what": what.replace("_", " "), "value": entry} for what, entry in value.items()]
        if isinstance(value, list) and value and isinstance(value[0], dict):
            show.listing(key.replace("_", " "), value, False)


@app.command("list")
def datasets(as_json: options.Json = False) -> None:
    """List the data sets that ship with the package."""
    from adaptrack.tuning.dataset import list_datasets

    rows = [{"name": name} for name in list_datasets()]
    show.listing(f"{len(rows)} data sets", rows, as_json)
    if not as_json:
        say_next("to see what is in one", command("dataset", "describe", rows[0]["name"]))
