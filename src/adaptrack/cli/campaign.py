"""`adaptrack paper campaign`: tune the MPC at every operating point of a campaign."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, next_line


@dataclass(frozen=True, kw_only=True)
class CampaignOptions:
    """Options of `adaptrack paper campaign`."""

    name: Annotated[
        str,
        typer.Argument(
            metavar="CAMPAIGN",
            help="Campaign: paper-grid, road-sobol, or a .toml file. Without --out, a data set: name, file or folder.",
        ),
    ]
    out: Annotated[
        Path | None, Option("--out", metavar="DIR", help="Folder of the campaign; without it, nothing is tuned.")
    ] = None
    workers: options.Workers = None
    cluster: Annotated[
        str | None,
        Option("--cluster", metavar="ADDRESS", help="Dask scheduler whose workers compute, tcp://HOST:PORT."),
    ] = None
    as_json: options.Json = False


@options.grouped
def campaign(arguments: CampaignOptions) -> None:
    """Tune the MPC at the operating points of a campaign.

    With --out: run the campaign in that folder, or continue one that was interrupted, and write a page on its data set.
    Without --out: describe the data set that ships under this name, or that lies in this file or folder.
    """
    from adaptrack.paper.campaign import run_campaign
    from adaptrack.paper.campaign_config import load_campaign
    from adaptrack.paper.data_set import load_dataset
    from adaptrack.results.dataset import dataset_result
    from adaptrack.results.page import write_result

    if arguments.out is None:
        result, page = dataset_result(load_dataset(arguments.name)), None
    else:
        config = load_campaign(arguments.name)
        interrupt.note_progress(f"Finished parts are kept in {arguments.out}: run the command again to continue.")
        with show.progress("campaign") as advance:
            file = run_campaign(
                config, arguments.out, workers=arguments.workers, cluster=arguments.cluster, progress=advance
            )
        result = dataset_result(load_dataset(file))
        with show.progress("write the page"):
            page = write_result(arguments.out, result)
    learn = command("paper", "train", "--data", arguments.out or arguments.name, "--model", "nn", "--out", "nn.json")
    show.say_result(replace(result, next_step=next_line("to learn a schedule from it", learn)), arguments.as_json, page)
