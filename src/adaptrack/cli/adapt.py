"""`adaptrack adapt`: the whole chain."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from adaptrack.cli import comparison, interrupt, options, show
from adaptrack.errors import InvalidInput


def adapt(
    out: Annotated[Path, Option(help="Folder of the chain; one that was interrupted goes on.")],
    road: Annotated[list[str] | None, Argument(metavar="ROAD", hidden=True)] = None,
    config: Annotated[
        str | None,
        Option(help="Name (road, informed-road, ...) or .toml file; by default what ships for controller and profile."),
    ] = None,
    controller: options.Tuned = None,
    profile: options.OtherProfile = None,
    workers: options.Workers = None,
    as_json: options.Json = False,
) -> None:
    """The whole chain: tune, learn schedulers, guard them, evaluate them on roads nobody trained on.

    Failed runs are part of the result: they are counted for each contender, and the exit code is 0.
    """
    from adaptrack.studies.adapt import adapt as run

    if road:
        raise InvalidInput(
            f"adapt {' '.join(road)}: schedulers are learned on random drives, not on given roads. For roads seek one "
            f"tuning: adaptrack tune {' '.join(road)} --out tuning.toml; and compare, a scheduler too: adaptrack "
            f"evaluate {' '.join(road)} --tuning tuning.toml --schedulers NAME."
        )
    settings = comparison.study(config, controller, profile)
    options.make_folder(out)
    interrupt.kept(f"Finished chunks and schedulers are kept in {out}: run the command again to go on.")
    with show.progress("adapt") as advance:
        made = run(settings, out, workers=workers, progress=advance)
    page = comparison.write_page(out, made)
    show.say(f"Schedulers: {out / 'schedulers'}\nReport: {page}", aside=as_json)
    comparison.print_comparison(made, as_json)
