"""`adaptrack export page`: the page on which one drives, as one file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.next_step import next_line


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Options of `adaptrack export page`: all but the file are what the page begins with."""

    out: Annotated[Path, Option("--out", metavar="FILE", help="The page, an .html file.")]
    vehicle: options.Vehicle = "midsize-sedan"
    road: Annotated[
        str,
        Option("--road", metavar="ROAD", help="motorway, country, town, mountain, lap, or a .csv file of x, y (m)."),
    ] = "mountain"
    speed: options.Speed = None
    lateral_acceleration: options.LateralAcceleration = None
    profile: Annotated[str, Option("--profile", metavar="NAME", help="paper, road or production.")] = "road"
    controller: Annotated[
        list[str] | None,
        Option("--controller", metavar="NAME", help="informed [default], learning, published, lqr, ...; at most two."),
    ] = None
    seed: Annotated[int, Option("--seed", hidden=True, help="Of the sensor noise.")] = 0
    as_json: options.Json = False


@options.grouped
def export_page(given: PageOptions) -> None:
    """A page on which one drives: one file that needs neither Python nor a network.

    The kernels of this package run in it, with the same bits. What is given here it begins with; all of it can be
    changed on the page.
    """
    from adaptrack.export.page_file import export_page as export

    options.make_place(given.out)
    made = export(
        given.out, vehicle=given.vehicle, road=given.road, speed=given.speed,
        lateral_acceleration=given.lateral_acceleration, profile=given.profile,
        controllers=given.controller or ["informed"], seed=given.seed,
    )  # fmt: skip
    size = made.stat().st_size
    if given.as_json:
        show.say_json({"file": str(made), "bytes": size})
        return
    show.say(f"{made}: {size:,} bytes")
    show.say(next_line("to drive, open it in a browser", str(made)))
