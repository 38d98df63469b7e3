"""`adaptrack list`: list the names of cars, roads, controllers and other arguments of commands."""

from __future__ import annotations

from collections.abc import Callable

import adaptrack as at
from adaptrack.base.errors import UnknownName, did_you_mean
from adaptrack.cli import options, show
from adaptrack.cli.next_step import say_next
from adaptrack.cli.options import argument, json_flag

Descriptions = dict[str, str]
"""Descriptions by name."""


def _roads() -> Descriptions:
    from adaptrack.road import ROAD_KINDS

    return dict.fromkeys(ROAD_KINDS, "generated; country:3 is the country road with seed 3")


def _scenarios() -> Descriptions:
    from adaptrack.scenario import scenario_options

    texts = at.list_scenarios().items()
    return {name: f"{text} Options: {', '.join(scenario_options(name)) or 'none'}." for name, text in texts}


def _controllers() -> Descriptions:
    from adaptrack.control.controllers import about_controller

    entries = {name: about_controller(name) for name in at.list_controllers()}
    return {name: f"{entry.words}{'' if entry.tunable else '; fixed tuning'}" for name, entry in entries.items()}


def _drivers() -> Descriptions:
    from adaptrack.drive.drivers import list_drivers

    return list_drivers()


def _schedules() -> Descriptions:
    schedules = {name: at.load_scheduler(name) for name in at.list_schedulers()}
    return {
        name: f"for the car {schedule.made_for.get('car')}, inputs {', '.join(schedule.inputs)}"
        for name, schedule in schedules.items()
    }


def _comparisons() -> Descriptions:
    from adaptrack.comparison.config import list_comparisons

    return list_comparisons()


COMMANDS: dict[str, tuple[Callable[[], Descriptions], str]] = {
    "cars": (lambda: {name: at.load_vehicle(name).description for name in at.list_vehicles()}, "car"),
    "tyres": (lambda: {name: at.load_tyre(name).description for name in at.list_tyres()}, "drive country --tyre"),
    "roads": (_roads, "drive"),
    "scenarios": (_scenarios, "drive"),
    "profiles": (
        lambda: {name: at.load_profile(name).description for name in at.list_profiles()},
        "drive country --profile",
    ),
    "controllers": (_controllers, "drive country --controller"),
    "drivers": (_drivers, "compare --driver"),
    "schedules": (_schedules, "certify"),
    "comparisons": (_comparisons, "compare --out compared --config"),
}
"""For each kind of names: the function that describes them, and a command that uses one."""


@options.grouped
def list_names(
    *,
    kind: str | None = argument("KIND", f"{', '.join(COMMANDS)}; default: all kinds."),
    plugin: list[str] | None = options.plugin_option(),
    as_json: bool = json_flag(),
) -> None:
    """List the names of cars, roads, controllers and other arguments."""
    options.load_plugins(plugin)
    if kind is None:
        rows = [{"kind": kind, "names": ", ".join(describe())} for kind, (describe, _) in COMMANDS.items()]
        show.listing("Names", rows, as_json)
        return
    if kind not in COMMANDS:
        raise UnknownName(f"list: there is no kind {kind!r}. {did_you_mean(kind, COMMANDS)}")
    describe, words = COMMANDS[kind]
    rows = [{"name": name, "description": text} for name, text in describe().items()]
    show.listing(f"{len(rows)} {kind}", rows, as_json)
    if not as_json:
        plugins = [word for module in plugin or () for word in ("--plugin", module)]
        say_next("list", command=words.split(), name=rows[0]["name"] if rows else "", plugins=plugins)
