"""`adaptrack paper`: the commands of the paper's experiment, in its order."""

from __future__ import annotations

import typer

from adaptrack.cli import campaign, paper_adapt, paper_evaluate, reproduce, train

app = typer.Typer(help="The paper's experiment, in its order.", no_args_is_help=True, rich_markup_mode=None)
for command in (
    reproduce.reproduce, campaign.campaign, train.train, paper_adapt.adapt, paper_evaluate.evaluate,
):  # fmt: skip
    app.command()(command)
