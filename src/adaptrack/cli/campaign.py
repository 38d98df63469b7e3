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
            help="With --out: paper-grid, road-sobol, or a .toml file. Without: a data set (name, file or folder).",
        ),
    ]
    out: Annotated[
        Path | None, Option("--out", metavar="DIR", help="Folder of the campaign; without it, no tuning.")
    ] = None
    workers: options.Workers = None
    cluster: Annotated[
        str | None,
        Option(
            "--cluster", metavar="ADDRESS", help="Address of a Dask scheduler, tcp://HOST:PORT; its workers compute."
        ),
    ] = None
    as_json: options.Json = False


@options.grouped
def campaign(arguments: CampaignOptions) -> None:
    """Tune the MPC at the operating points of a campaign.

    With --out, the command runs the campaign in this folder, or continues an interrupted campaign. It then writes a
    page about the data set. Without --out, it only describes an existing data set.
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
        interrupt.note_progress(f"Finished parts are in {arguments.out}: run the command again to continue.")
        with show.progress("campaign") as advance:
            file = run_campaign(
                config, arguments.out, workers=arguments.workers, cluster=arguments.cluster, progress=advance
            )
        result = dataset_result(load_dataset(file))
        with show.progress("write the page"):
            page = write_result(arguments.out, result)
    learn = command("paper", "train", "--data", arguments.out or arguments.name, "--model", "nn", "--out", "nn.json")
    show.say_result(
        replace(result, next_step=next_line("to train a schedule on this data set", learn)), arguments.as_json, page
    )
