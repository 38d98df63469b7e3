"""`adaptrack scenarios`, `vehicles`, `schedulers`: what has a name."""

from __future__ import annotations

from adaptrack.cli import options, show
from adaptrack.cli.next_step import command, say_next


def scenarios(as_json: options.Json = False) -> None:
    """List the scenarios that have a name."""
    from adaptrack.scenario import list_scenarios, scenario_options

    rows = [
        {"scenario": name, "what it is": text, "options": ", ".join(scenario_options(name))}
        for name, text in list_scenarios().items()
    ]
    show.listing(f"{len(rows)} scenarios", rows, as_json)
    _say_next("to drive one", rows, as_json, "drive", "scenario")


def vehicles(as_json: options.Json = False) -> None:
    """List the vehicles and tyres that have a name."""
    from adaptrack.cars.vehicle import list_tyres, list_vehicles, load_tyre, load_vehicle

    cars = [(name, load_vehicle(name)) for name in list_vehicles()]
    rows = [{"kind": "vehicle", "name": name, "what it is": car.description, "tyre": car.tyre} for name, car in cars]
    rows += [
        {"kind": "tyre", "name": name, "what it is": load_tyre(name).description, "tyre": ""} for name in list_tyres()
    ]
    show.listing(f"{len(cars)} vehicles, {len(rows) - len(cars)} tyres", rows, as_json)
    _say_next("to see the numbers of a car", rows, as_json, "car", "name")


def schedulers(as_json: options.Json = False) -> None:
    """List the schedulers that ship with the package."""
    from adaptrack.control.scheduling import list_schedulers, load_scheduler

    rows = [
        {
            "name": name,
            "car": each.made_for.get("car", ""),
            "profile": each.made_for.get("profile", ""),
            "inputs": ", ".join(each.inputs),
        }
        for name, each in ((name, load_scheduler(name)) for name in list_schedulers())
    ]
    show.listing(f"{len(rows)} schedulers", rows, as_json)
    _say_next("to certify one", rows, as_json, "certify", "name")


def _say_next(why: str, rows: show.Rows, as_json: bool, word: str, column: str) -> None:
    """What to do with the first of a list."""
    if rows and not as_json:
        say_next(why, command(word, rows[0][column]))
