"""`adaptrack paper adapt`: run a campaign and train schedules in closed loop on its operating points."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli.next_step import command, say_next
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.control.scheduling import Schedule

ROUND_COLUMNS = (
    Column("contender", "schedule"),
    Column("round", "best\nround", "", "whole"),
    Column("score", "log cost\nheld out", "", 4),
    Column("failed", "runs\nfailed", "", "whole"),
)


@dataclass(frozen=True, kw_only=True)
class AdaptOptions:
    """Options of `adaptrack paper adapt`."""

    campaign: Annotated[
        str, typer.Argument(metavar="CAMPAIGN", help="Campaign with a Sobol sample: road-sobol, or a .toml file.")
    ] = "road-sobol"
    out: Annotated[
        Path,
        Option("--out", metavar="DIR", help="Folder for campaign and schedules; a repeated command continues in it."),
    ]
    profile: options.OtherProfile = None
    workers: options.Workers = None
    as_json: options.Json = False


@options.grouped
def adapt(arguments: AdaptOptions) -> None:
    """Run a campaign and train schedules on it.

    The schedules are constants, a look-up table, neural networks and ANFIS (fuzzy systems).

    Failed runs are part of the result: they are counted, and the exit code is 0.
    """
    from adaptrack.paper.adaptation import adapt as learn
    from adaptrack.paper.campaign_config import load_campaign

    campaign = load_campaign(arguments.campaign).with_profile(arguments.profile)
    options.make_folder(arguments.out)
    interrupt.note_progress(f"Finished parts and schedules are in {arguments.out}: run the command again to continue.")
    with show.progress("adapt") as advance:
        schedules = learn(campaign, arguments.out, workers=arguments.workers, progress=advance)
    rows = [_best_round(name, schedule) for name, schedule in schedules.items() if "history" in schedule.provenance]
    if arguments.as_json:
        show.say_json({"schedulers": str(arguments.out / "schedulers"), "rows": rows})
        return
    show.table("Schedules trained in closed loop", ROUND_COLUMNS, rows)
    show.say(f"Schedules: {arguments.out / 'schedulers'}")
    line = command("paper", "evaluate", arguments.out, "--campaign", arguments.campaign, "--profile", arguments.profile)
    say_next("to evaluate them on new runs", line)


def _best_round(contender: str, schedule: Schedule) -> dict[str, object]:
    best = min(schedule.provenance["history"], key=lambda entry: entry["score"])
    return {"contender": contender, **best}
