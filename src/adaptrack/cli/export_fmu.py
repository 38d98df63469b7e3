"""`adaptrack export fmu`: export a controller and a simulated car as Functional Mock-up Units (FMUs)."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Annotated

from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.export import ExportedController


class Interface(StrEnum):
    """Versions of the Functional Mock-up Interface."""

    second = "2.0"
    third = "3.0"


@dataclass(frozen=True, kw_only=True)
class FMUOptions:
    """Options of `adaptrack export fmu`."""

    out: Annotated[Path, Option("--out", metavar="FOLDER", help="Folder for car.fmu and controller.fmu.")]
    exported: ExportedController
    fmi: Annotated[Interface, Option("--fmi", help="Version of the Functional Mock-up Interface.")] = Interface.third
    prescribed_speed: options.PrescribedSpeed = False
    as_json: options.Json = False


@options.grouped
def export_fmu(arguments: FMUOptions) -> None:
    """Export a controller and a car as two FMUs for co-simulation.

    The FMUs need neither Python nor adaptrack. You need no compiler for the export.
    """
    from adaptrack.drive.world import Driver
    from adaptrack.export.fmu import binaries, write_fmu
    from adaptrack.export.units import car_unit, controller_unit
    from adaptrack.scenario import RoadDrive
    from adaptrack.scenario.profile import load_profile

    car, plant = arguments.exported.car.load()
    world = load_profile(arguments.exported.profile)
    controller = arguments.exported.make(car, world)
    checked = arguments.exported.checked_road(car, world)
    route = RoadDrive(checked.road, checked.plan)
    speed = arguments.exported.make_speed_control(car)
    driver = speed or (None if arguments.prescribed_speed else Driver())
    units = (
        controller_unit(
            controller,
            checked.road,
            checked.plan,
            speed_preview=driver.preview if isinstance(driver, Driver) else None,
            speed=speed,
        ),
        car_unit(plant, route, profile=world, driver=driver, period=controller.period),  # type: ignore[arg-type]
    )
    systems = list(binaries())
    options.make_folder(arguments.out)
    files = [arguments.out / f"{unit.name}.fmu" for unit in units]
    with show.replacing(*files, aside=arguments.as_json):
        for unit, file in zip(units, files, strict=True):
            write_fmu(unit, file, arguments.fmi.value)
    if arguments.as_json:
        show.say_json(
            {
                "files": [str(file) for file in files],
                "fmi": arguments.fmi,
                "period": controller.period,
                "systems": systems,
            }
        )
        return
    show.say(f"FMI {arguments.fmi.value}, for {' and '.join(systems)}, a step is {controller.period:g} s")
    for unit, file in zip(units, files, strict=True):
        show.say(f"{file}: {unit.title}, {file.stat().st_size:,} bytes")
