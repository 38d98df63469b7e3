"""`adaptrack paper`: the commands that repeat and extend the experiment of the paper, in their order."""

from __future__ import annotations

import typer

from adaptrack.cli import campaign, paper_adapt, paper_evaluate, reproduce, train

app = typer.Typer(help="Repeat the paper's experiment, step by step.", no_args_is_help=True, rich_markup_mode=None)
for command in (
    reproduce.reproduce, campaign.campaign, train.train, paper_adapt.adapt, paper_evaluate.evaluate,
):  # fmt: skip
    app.command()(command)
