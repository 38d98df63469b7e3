"""`adaptrack list`: the names that other commands take."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from typing import Annotated, Any

import typer

from adaptrack.cli import options, show
from adaptrack.cli.next_step import command, say_next

Rows = list[dict[str, Any]]


class Kind(StrEnum):
    """Kinds of names."""

    cars = "cars"
    tyres = "tyres"
    roads = "roads"
    scenarios = "scenarios"
    profiles = "profiles"
    controllers = "controllers"
    schedules = "schedules"
    comparisons = "comparisons"


def _cars() -> Rows:
    from adaptrack.cars.vehicle import list_vehicles, load_vehicle

    cars = [load_vehicle(name) for name in list_vehicles()]
    return [{"name": car.name, "description": car.description, "tyre": car.tyre} for car in cars]


def _tyres() -> Rows:
    from adaptrack.cars.vehicle import list_tyres, load_tyre

    return [{"name": name, "description": load_tyre(name).description} for name in list_tyres()]


def _roads() -> Rows:
    from adaptrack.road import KINDS

    return [{"name": kind, "description": "generated; country:3 is the one with seed 3"} for kind in KINDS]


def _scenarios() -> Rows:
    from adaptrack.scenario import list_scenarios, scenario_options

    return [
        {"name": name, "description": text, "options": ", ".join(scenario_options(name))}
        for name, text in list_scenarios().items()
    ]


def _profiles() -> Rows:
    from adaptrack.scenario.profile import list_profiles, load_profile

    profiles = [load_profile(name) for name in list_profiles()]
    return [{"name": profile.name, "description": f"period {profile.period:g} s"} for profile in profiles]


def _controllers() -> Rows:
    from adaptrack.control.controllers import about_controller, list_controllers

    about = {name: about_controller(name) for name in list_controllers()}
    return [
        {"name": name, "description": entry.words, "tunable": entry.tunable, "compiled": entry.compiled}
        for name, entry in about.items()
    ]


def _schedules() -> Rows:
    from adaptrack.control.scheduling import list_schedulers, load_scheduler

    schedules = {name: load_scheduler(name) for name in list_schedulers()}
    return [
        {
            "name": name, "car": schedule.made_for.get("car", ""), "profile": schedule.made_for.get("profile", ""),
            "inputs": ", ".join(schedule.inputs),
        }
        for name, schedule in schedules.items()
    ]  # fmt: skip


def _comparisons() -> Rows:
    from adaptrack.comparison.config import list_comparisons

    return [{"name": name, "description": text} for name, text in list_comparisons().items()]


NAMES: dict[Kind, tuple[Callable[[], Rows], str, tuple[str, ...]]] = {
    Kind.cars: (_cars, "see the numbers of a car", ("car",)),
    Kind.tyres: (_tyres, "drive on one", ("drive", "country", "--tyre")),
    Kind.roads: (_roads, "drive along one", ("drive",)),
    Kind.scenarios: (_scenarios, "drive one", ("drive",)),
    Kind.profiles: (_profiles, "drive in one", ("drive", "country", "--profile")),
    Kind.controllers: (_controllers, "drive with one", ("drive", "country", "--controller")),
    Kind.schedules: (_schedules, "certify one", ("certify",)),
    Kind.comparisons: (_comparisons, "run one", ("compare", "--out", "compared", "--config")),
}
"""By kind: its rows, and the command that takes a name."""


@options.grouped
def list_names(
    kind: Annotated[
        Kind | None, typer.Argument(metavar="KIND", help=f"{', '.join(Kind)}; by default the names of all kinds.")
    ] = None,
    plugin: options.Plugin = None,
    as_json: options.Json = False,
) -> None:
    """List the names of cars, roads, controllers."""
    options.load_plugins(plugin)
    if kind is None:
        rows = [{"kind": str(kind), "names": ", ".join(row["name"] for row in NAMES[kind][0]())} for kind in Kind]
        show.listing("Names", rows, as_json)
    else:
        make_rows, purpose, words = NAMES[kind]
        rows = make_rows()
        show.listing(f"{len(rows)} {kind}", rows, as_json)
        if rows and not as_json:
            say_next(purpose, command(*words, rows[0]["name"]))
