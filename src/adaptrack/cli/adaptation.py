"""`adaptrack adaptation`: the whole chain by a configuration: tune, learn, guard, evaluate."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from adaptrack.cli import comparison, interrupt, options, show
from adaptrack.cli.next_step import command, say_next


@dataclass(frozen=True, kw_only=True)
class AdaptationOptions:
    """Options of `adaptrack adaptation`."""

    config: Annotated[str, typer.Argument(metavar="ADAPTATION", help="Name (road) or .toml file.")] = "road"
    out: Annotated[Path, Option("--out", metavar="DIR", help="Folder of the chain; one that was interrupted goes on.")]
    profile: options.OtherProfile = None
    workers: options.Workers = None
    as_json: options.Json = False


@options.grouped
def adaptation(given: AdaptationOptions) -> None:
    """Run the whole chain of a configuration.

    Tune, learn schedulers, guard them, evaluate them where none was trained. Failed runs are part of the result: they
    are counted for each contender, and the exit code is 0.
    """
    from adaptrack.learning.adaptation.config import load_adaptation
    from adaptrack.studies.adapt import adapt

    settings = load_adaptation(given.config, profile=given.profile)
    options.make_folder(given.out)
    interrupt.kept(f"Finished chunks and schedulers are kept in {given.out}: run the command again to go on.")
    with show.progress("adapt") as advance:
        made = adapt(settings, given.out, workers=given.workers, progress=advance)
    page = comparison.write_page(given.out, made)
    if not given.as_json:
        show.say(comparison.answer(made))
    comparison.print_comparison(made, given.as_json)
    show.say(f"Schedulers: {given.out / 'schedulers'}\nPage: {page}", aside=given.as_json)
    if not given.as_json:
        file = given.out / "schedulers" / f"{settings.name}-nn.json"
        say_next("see with which margins its networks drive", command("certify", file))
