"""`adaptrack paper`: the commands of the paper's experiment, in its order."""

from __future__ import annotations

import typer

from adaptrack.cli import adaptation, campaign, evaluate_schedules, reproduce, train

app = typer.Typer(
    help="The paper's experiment: reproduce it, or repeat it on your own car.", no_args_is_help=True,
    rich_markup_mode=None,
)  # fmt: skip

for name, command in {
    "reproduce": reproduce.reproduce,
    "campaign": campaign.campaign,
    "train": train.train,
    "adapt": adaptation.adaptation,
    "evaluate": evaluate_schedules.evaluate_schedules,
}.items():
    app.command(name)(command)
