"""`adaptrack scenarios`, `vehicles`, `schedulers`: what has a name."""

from __future__ import annotations

from adaptrack.cli import options, show


def scenarios(as_json: options.Json = False) -> None:
    """List the scenarios that have a name, and their options."""
    from adaptrack.scenario import list_scenarios, scenario_options

    rows = [
        {"scenario": name, "what it is": text, "options": ", ".join(scenario_options(name))}
        for name, text in list_scenarios().items()
    ]
    show.listing("Scenarios", rows, as_json)


def vehicles(as_json: options.Json = False) -> None:
    """List the vehicles and tyres that have a name."""
    from adaptrack.vehicle import list_tyres, list_vehicles, load_tyre, load_vehicle

    cars = [(name, load_vehicle(name)) for name in list_vehicles()]
    rows = [{"kind": "vehicle", "name": name, "what it is": car.description, "tyre": car.tyre} for name, car in cars]
    rows += [
        {"kind": "tyre", "name": name, "what it is": load_tyre(name).description, "tyre": ""} for name in list_tyres()
    ]
    show.listing("Vehicles and tyres", rows, as_json)


def schedulers(as_json: options.Json = False) -> None:
    """List the schedulers that ship with the package."""
    from adaptrack.scheduling import list_schedulers, load_scheduler

    loaded = [(name, load_scheduler(name)) for name in list_schedulers()]
    rows = [{"name": name, "contender": each.name, "inputs": ", ".join(each.inputs)} for name, each in loaded]
    show.listing("Schedulers", rows, as_json)
