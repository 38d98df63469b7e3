"""`adaptrack adaptation`: the whole chain by a configuration: tune, learn, guard, evaluate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Option

from adaptrack.cli import comparison, interrupt, options, show
from adaptrack.cli.next_step import command, say_next

if TYPE_CHECKING:
    from adaptrack.learning.adaptation.config import AdaptationConfig
    from adaptrack.studies.adapt import Adapted


@dataclass(frozen=True, kw_only=True)
class AdaptationOptions:
    """Options of `adaptrack adaptation`."""

    config: Annotated[
        str | None,
        typer.Argument(
            metavar="ADAPTATION", show_default=False,
            help="Name (road, informed-road, ...) or .toml file; by default what ships for controller and profile.",
        ),
    ] = None  # fmt: skip
    out: Annotated[Path, Option("--out", metavar="DIR", help="Folder of the chain; one that was interrupted goes on.")]
    controller: options.Tuned = None
    profile: options.OtherProfile = None
    workers: options.Workers = None
    as_json: options.Json = False


@options.grouped
def adaptation(given: AdaptationOptions) -> None:
    """Run the whole chain of a configuration.

    Tune, learn schedulers, guard them, evaluate them where none was trained. Failed runs are part of the result: they
    are counted for each contender, and the exit code is 0. For a car of your own: `adaptrack adapt CAR`.
    """
    settings = comparison.study(given.config, given.controller, given.profile)
    options.make_folder(given.out)
    made, page = run_chain(settings, given.out, given.workers)
    if not given.as_json:
        show.say(comparison.answer(made))
    comparison.print_comparison(made, given.as_json)
    show.say(f"Schedulers: {given.out / 'schedulers'}\nPage: {page}", aside=given.as_json)
    if not given.as_json:
        file = given.out / "schedulers" / f"{settings.name}-nn.json"
        say_next("see with which margins its networks drive", command("certify", file))


def run_chain(settings: AdaptationConfig, out: Path, workers: int | None) -> tuple[Adapted, Path]:
    """Run the chain of a configuration in a folder, and write its page; what it made, and the page."""
    from adaptrack.studies.adapt import adapt as run

    interrupt.kept(f"Finished chunks and schedulers are kept in {out}: run the command again to go on.")
    with show.progress("adapt") as advance:
        made = run(settings, out, workers=workers, progress=advance)
    return made, comparison.write_page(out, made)
