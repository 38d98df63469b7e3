"""`adaptrack warm-up`: compile beforehand what commands need, for images and continuous integration."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Annotated, Any

from typer import Option

from adaptrack.cli import interrupt, options, show
from adaptrack.cli.show import Column
from adaptrack.errors import InvalidInput, UnknownName, did_you_mean

COLUMNS = (
    Column("part", "part"),
    Column("seconds", "time", "s", show.digits(3)),
)


def _one_run(name: str = "informed", **options: Any) -> None:
    """A controller over a short step, on the default car, plant and tyre."""
    from adaptrack.controllers import get_controller
    from adaptrack.plant import DualTrack
    from adaptrack.scenario import load_scenario
    from adaptrack.simulate import simulate
    from adaptrack.vehicle import load_vehicle

    car = load_vehicle("paper")
    controller = get_controller(name, car, profile="road", **options)
    simulate(DualTrack(car), controller, load_scenario("step"), profile="road")


def _one_drive() -> None:
    """The informed controller along a short curved road."""
    from adaptrack.controllers import MPC
    from adaptrack.plant import DualTrack
    from adaptrack.road import load_road, plan_speed
    from adaptrack.scenario import RoadDrive
    from adaptrack.simulate import simulate
    from adaptrack.vehicle import load_vehicle

    car = load_vehicle("paper")
    road = load_road("country", length=300.0, seed=1)
    trip = RoadDrive(road, plan_speed(road, car))
    simulate(DualTrack(car), MPC(car, profile="road"), trip, profile="road")


def _learning() -> None:
    from adaptrack.controllers import Learning

    _one_run(learning=Learning())


def _laws() -> None:
    """The paper's MPC, and the laws that are compiled but for `mppi`, which only `compare --full` drives."""
    for name in ("as-written", "lqr", "preview-lqr", "pure-pursuit", "stanley", "kinematic-mpc"):
        _one_run(name)


def _schedule() -> None:
    """A shipped schedule, of fuzzy systems, with its guard."""
    from adaptrack.scheduling import load_scheduler

    _one_run(scheduler=load_scheduler("informed-road-anfis"))


def _batch() -> None:
    """Whole runs, compiled."""
    from adaptrack.batch import rollout_batch
    from adaptrack.controllers import MPC, published_mpc
    from adaptrack.plant import DualTrack
    from adaptrack.scenario import load_scenario
    from adaptrack.vehicle import load_vehicle

    car = load_vehicle("paper")
    for each in (MPC(car, profile="road"), published_mpc(car, period=0.05)):
        rollout_batch(DualTrack(car), each, load_scenario("step"), profile="road", threads=1)


def _swarm() -> None:
    from adaptrack.kernels.tune import evaluate, tune

    for each in (evaluate, tune):
        _make_ready(each)


def _identification() -> None:
    from adaptrack.kernels import identification

    for each in vars(identification).values():
        _make_ready(each)


def _everything() -> None:
    """Every routine of the kernels, for every tyre law."""
    import importlib
    import pkgutil

    import adaptrack.kernels as room
    from adaptrack.kernels.plants import dual_track, single_track
    from adaptrack.kernels.plants.tyre import CURVED_MAGIC_FORMULA, LINEAR, MAGIC_FORMULA

    for module in pkgutil.walk_packages(room.__path__, f"{room.__name__}."):
        for each in list(vars(importlib.import_module(module.name)).values()):
            _make_ready(each)
    for law in (LINEAR, MAGIC_FORMULA, CURVED_MAGIC_FORMULA):
        for plant in (single_track, dual_track):
            for each in plant.compiled(law):
                _make_ready(each)


def _make_ready(thing: Any) -> None:
    ready = getattr(thing, "ready", None)
    if ready is not None and getattr(thing, "kept", False):
        ready()


PARTS: dict[str, Callable[[], None]] = {
    "run": _one_run,
    "road": _one_drive,
    "learning": _learning,
    "controllers": _laws,
    "schedules": _schedule,
    "batches": _batch,
    "swarm": _swarm,
    "identification": _identification,
    "everything": _everything,
}
"""What can be compiled by itself, and a small piece of work that needs it; what two share is compiled once."""

NEEDED: dict[str, tuple[str, ...]] = {
    "simulate": ("run",),
    "drive": ("run", "road"),
    "learn": ("run", "road", "learning"),
    "manoeuvre": ("run", "controllers", "batches"),
    "identify": ("run", "identification"),
    "tune": ("run", "batches", "swarm"),
    "adapt": ("run", "schedules", "batches", "swarm"),
    "certify": ("run",),
    "evaluate": ("run", "schedules", "batches"),
    "compare": ("run", "road", "controllers", "batches"),
    "reproduce": ("run", "controllers", "schedules", "batches"),
}
"""The parts that commands need with their default options; learn: `drive --learn`."""


def warm_up(
    for_: Annotated[
        str | None, Option("--for", metavar="COMMANDS", help=f"Separated by commas, of {', '.join(NEEDED)}.")
    ] = None,
    all_: Annotated[bool, Option("--all", help="Every kernel, for every option.")] = False,
    as_json: options.Json = False,
) -> None:
    """Compile beforehand what commands need, by default `simulate` and `drive`; print how long each part took.

    What is compiled is kept in $NUMBA_CACHE_DIR, else in $XDG_CACHE_HOME or ~/.cache: a later process loads it, on the
    same kind of processor. What is there already takes no time.
    """
    from adaptrack.kernels.abi import cache_base

    if all_ and for_ is not None:
        raise InvalidInput("--all: compiles everything; leave --for out.")
    parts = tuple(PARTS) if all_ else _asked("simulate,drive" if for_ is None else for_)
    rows = []
    with show.progress("warm-up", len(parts)) as advance:
        for part in parts:
            advance(part, 0, 1)
            begun = time.perf_counter()
            PARTS[part]()
            rows.append({"part": part, "seconds": time.perf_counter() - begun})
            advance(part, 1, 1)
            interrupt.kept("What was compiled is kept: the same command goes on.")
    if as_json:
        show.say_json({"folder": str(cache_base()), "rows": rows})
        return
    show.table("Compiled", COLUMNS, rows)
    show.say(f"Kept in {cache_base()}")


def _asked(text: str) -> tuple[str, ...]:
    """The parts that commands need, each once.

    Raises
    ------
    UnknownName
        For a command that compiles nothing of its own, or none at all.
    """
    parts: dict[str, None] = {}
    for name in filter(None, (each.strip() for each in text.split(","))):
        if name not in NEEDED:
            raise UnknownName(f"--for {text}: {name!r} is not one of them. {did_you_mean(name, NEEDED)}")
        parts |= dict.fromkeys(NEEDED[name])
    if not parts:
        raise InvalidInput(f"--for {text!r}: names no command; of {', '.join(NEEDED)}.")
    return tuple(parts)
