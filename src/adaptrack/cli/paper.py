"""`adaptrack paper`: the paper's experiment."""

from __future__ import annotations

import typer

from adaptrack.cli import paper_adapt, paper_evaluate

app = typer.Typer(help="The paper's experiment.", no_args_is_help=True, rich_markup_mode=None)
for command in (paper_adapt.adapt, paper_evaluate.evaluate):
    app.command()(command)
