"""`adaptrack export page`: export the interactive simulation as one HTML file."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.next_step import next_line


@dataclass(frozen=True, kw_only=True)
class PageOptions:
    """Options of `adaptrack export page`: the file and the initial settings of the page."""

    out: Annotated[Path, Option("--out", metavar="FILE", help="HTML file of the page.")]
    vehicle: options.VehicleOption = "midsize-sedan"
    road: Annotated[
        str,
        Option(
            "--road",
            metavar="ROAD",
            help="motorway, country, town, mountain, lap, oval, or a file: .csv of x, y (m), .toml, .xodr, .xml.",
        ),
    ] = "mountain"
    speed: options.Speed = None
    lateral_acceleration: options.LateralAcceleration = None
    profile: Annotated[str, Option("--profile", metavar="NAME", help="paper, road, production or production-bus.")] = (
        "road"
    )
    controller: Annotated[
        list[str] | None,
        Option(
            "--controller",
            metavar="NAME",
            help="One or two of informed, learning, published, lqr, ...; default: informed.",
        ),
    ] = None
    seed: Annotated[int, Option("--seed", hidden=True, help="Seed of the sensor noise.")] = 0
    as_json: options.Json = False


@options.grouped
def export_page(arguments: PageOptions) -> None:
    """Export an interactive simulation as one HTML file.

    The page runs the kernels of adaptrack in the browser, without Python and without a network connection. The options
    are the initial settings; you can change all of them on the page.
    """
    from adaptrack.export.page_file import export_page as export

    options.make_place(arguments.out)
    with show.replacing(arguments.out, aside=arguments.as_json):
        page = export(
            arguments.out, vehicle=arguments.vehicle, road=arguments.road, speed=arguments.speed,
            lateral_acceleration=arguments.lateral_acceleration, profile=arguments.profile,
            controllers=arguments.controller or ["informed"], seed=arguments.seed,
        )  # fmt: skip
    size = page.stat().st_size
    if arguments.as_json:
        show.say_json({"file": str(page), "bytes": size})
        return
    show.say(f"{page}: {size:,} bytes")
    show.say(next_line("to drive, open it in a browser", shlex.quote(str(page))))
