"""The command line application with all its commands."""

from __future__ import annotations

from typing import Annotated, Any

import typer
import typer.core

from adaptrack import __version__
from adaptrack.cli import car, certify, compare, drive, export, list_names, logs, paper, road, tune

PANELS: dict[str, tuple[str, ...]] = {
    "Drive": ("drive",),
    "Your car": ("car", "identify", "shadow", "check-loop", "tune"),
    "Your road": ("road",),
    "Compare": ("compare", "certify", "list"),
    "Export": ("export",),
    "The paper": ("paper",),
}
"""Commands in each section of the help."""


class PanelGroup(typer.core.TyperGroup):
    """Group of commands whose help lists them in the sections of `PANELS`."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write one section for each panel."""
        width = max(map(len, self.commands))
        for panel, names in PANELS.items():
            with formatter.section(panel):
                limit = formatter.width - formatter.current_indent - width - 2
                formatter.write_dl(
                    [(name.ljust(width), self.commands[name].get_short_help_str(limit)) for name in names]
                )


app = typer.Typer(
    name="adaptrack",
    cls=PanelGroup,
    help="Auto-tuned, auto-adaptive model predictive control for path tracking.",
    epilog="Begin with: adaptrack drive country --out drive. docs/guide.md helps you to choose a controller and a "
    "profile, and lists what to measure first. Exit codes: 0 done; 1 unstable loop, or road that the car cannot "
    "drive; 2 error; 3 failed run, inconsistent logs, implausible estimates, or contradictory inputs; 130 Ctrl-C.",
    no_args_is_help=True,
    rich_markup_mode=None,
    add_completion=False,
    pretty_exceptions_enable=False,
)


def _version(is_requested: bool) -> None:
    if is_requested:
        from adaptrack.core.library import description

        typer.echo(f"adaptrack {__version__}\n{description()}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Show the version.")
    ] = False,
) -> None:
    """Auto-tuned, auto-adaptive model predictive control for path tracking."""


for command in (
    drive.drive, logs.identify, logs.shadow, logs.check_loop, car.car, tune.tune, certify.certify, compare.compare,
):  # fmt: skip
    app.command()(command)
app.command("list")(list_names.list_names)
app.add_typer(paper.app, name="paper")
app.add_typer(export.app, name="export")
app.add_typer(road.app, name="road")
