"""The page on which one drives, as one HTML file that loads nothing: markup, scripts, kernels and data inside it.

The scripts of the page stand in it as they are written. The engine, which runs in a worker, the kernels as a module of
WebAssembly, and the data are compressed (gzip) and written as base64; `page/start.js` unpacks them.
"""

from __future__ import annotations

import base64
import contextlib
import gzip
import json
import logging
import math
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.base.files import write_atomically
from adaptrack.base.presentation import content_policy
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Vehicle, list_vehicles, load_vehicle
from adaptrack.control.speed_control import SpeedControl
from adaptrack.core import library
from adaptrack.drive.planner import PlannedController, SimulatedPlanner
from adaptrack.drive.world import World
from adaptrack.export.page_data import CONTROLLER_KINDS, INPUTS, page_controller, page_data
from adaptrack.export.page_inputs import MAX_PAGE_POINTS, page_car
from adaptrack.export.page_setup import PAGE_ROADS, road_of
from adaptrack.road import Comfort, check_road, load_road, plan_speed
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import list_profiles, load_profile

PAGE_SOURCES = Path(__file__).parent / "page"
ENGINE = ("memory.js", "inputs.js", "makers.js", "planner.js", "engine.js")
"""Files of the worker, in the order in which they stand in its script; all other scripts are the page's."""
FIRST_SCRIPTS, LAST_SCRIPTS = ("start.js",), ("app.js",)
"""Of the page's: they stand before and behind the others."""
ROAD_SPACING = 2.0
"""m, between the points of a road from a file"""
SPEED_WORDS = {"constant": "speed (m/s)", "lateral": "lateral_acceleration (m/s^2)"}


MOST_CONTROLLERS = 2
PLANNER_SETTINGS = ("period", "delay", "noise", "start")
"""Of a `SimulatedPlanner`, on the page."""


@checked
def export_page(
    file: str | os.PathLike[str],
    *,
    vehicle: str | os.PathLike[str] | Vehicle = "midsize-sedan",
    road: str | os.PathLike[str] | ArrayLike = "mountain",
    speed: float | None = None,
    lateral_acceleration: float | None = None,
    profile: str = "road",
    controllers: Sequence[str] = ("informed",),
    seed: int = 0,
    planner: SimulatedPlanner | None = None,
) -> Path:
    """Write the page on which one drives: one HTML file, at most 3 MB, that needs neither Python nor a network.

    The kernels of this package run in it, with the same bits as here. Everything that is given here can be changed on
    the page, which begins with it.

    Parameters
    ----------
    file : path
        The page; it is overwritten.
    vehicle : str or Vehicle
        The car: a name, a file, or itself.
    road : str or (N, 2) array
        A kind of `generate_road`, a file that `load_road` reads, or points (m). The page drives the course of a file's
        road, level and without its widths and speed limits.
    speed : float, optional
        m/s, kept along the road; by default a speed is planned.
    lateral_acceleration : float, optional
        m/s^2, of the planned speed; by default 3.
    profile : str
        Of the simulated world: "paper", "road", "production", "production-bus".
    controllers : names
        One, or two side by side: "informed", "learning", "published", "published-nn", "published-anfis",
        "pure-pursuit", "stanley", "lqr".
    seed : int
        Of the sensors' noise.
    planner : SimulatedPlanner, optional
        Planner between the road and the cars, which then have a speed control. The page has its settings `period`,
        `delay`, `noise` and `start`.

    Raises
    ------
    InvalidInput
        When the page cannot drive one of these, also where the car cannot drive the road, or the kernels for
        WebAssembly are not there.
    StorageError
        When a file cannot be read or written.
    """
    if speed is not None and lateral_acceleration is not None:
        raise InvalidInput("export_page: give either speed or lateral_acceleration.")
    if not 1 <= len(controllers) <= MOST_CONTROLLERS:
        raise InvalidInput(f"export_page: {len(controllers)} controllers; the page drives one or two.")
    car = vehicle if isinstance(vehicle, Vehicle) else load_vehicle(vehicle)
    setup: dict[str, Any] = {
        "car": {"name": vehicle}
        if isinstance(vehicle, str) and vehicle in list_vehicles()
        else {"file": page_car(car)},
        "road": _road(road),
        "speed": {"lateral": 3.0 if lateral_acceleration is None else lateral_acceleration}
        if speed is None
        else {"constant": speed},
        "profile": _check_name("profile", profile, list_profiles()),
        "seed": seed,
        "controllers": [
            {"kind": _check_name("controller", controller, CONTROLLER_KINDS)} for controller in controllers
        ],
    }
    _refuse_undrivable(setup, car, planner)
    if planner is not None:
        setup["planner"] = _planner_settings(planner)
        for controller in setup["controllers"]:
            controller["speed_control"] = {"friction": SpeedControl(car).friction}
    return write_page(file, setup)


def _planner_settings(planner: SimulatedPlanner) -> dict[str, Any]:
    """The planner of a setup; raises `InvalidInput` for settings that the page has not."""
    settings = {name: getattr(planner, name) for name in PLANNER_SETTINGS}
    if planner != SimulatedPlanner(**settings):
        raise InvalidInput(f"export_page: planner: the page has {', '.join(PLANNER_SETTINGS)}; leave out the others.")
    for name in PLANNER_SETTINGS[:-1]:
        low, high = INPUTS.field_settings[f"planner_{name}"].ends
        if not low <= settings[name] <= high:
            raise InvalidInput(f"export_page: planner: {name} = {settings[name]!r}: the page has {low:g} to {high:g}.")
    return settings


def _road(road: str | os.PathLike[str] | ArrayLike) -> dict[str, Any]:
    """The road of a setup: a name, the points, or a file: points of the road that is fitted to it."""
    if isinstance(road, str | os.PathLike):
        if not os.path.splitext(road)[1]:
            return {"name": _check_name("road", os.fspath(road), PAGE_ROADS)}
        fitted = load_road(road)
        steps = min(math.ceil(fitted.length / ROAD_SPACING), MAX_PAGE_POINTS - 1)
        place = fitted.at(np.linspace(0.0, fitted.length, steps + 1)[: steps if fitted.closed else None])
        points, name, closed = np.round(np.stack([place.x, place.y], axis=-1), 6), fitted.name, fitted.closed
    else:
        points, name, closed = np.asarray(road, dtype=float), "points", False
    if points.ndim != 2 or points.shape[1] != 2:
        raise InvalidInput(f"export_page: road has the shape {points.shape}; needs (N, 2): x and y of each point (m).")
    return {"points": points.tolist(), "closed": closed, "name": name}


def _refuse_undrivable(setup: Mapping[str, Any], car: Vehicle, planner: SimulatedPlanner | None) -> None:
    """Refuse speed, road and controllers that the page would refuse; planner: which these follow.

    Raises InvalidInput, saying where, when one of them does not fit the car or the profile.
    """
    ((kind, speed),) = setup["speed"].items()
    low, high = INPUTS.field_settings[kind].ends
    if not low <= speed <= high:
        raise InvalidInput(f"export_page: {SPEED_WORDS[kind]} = {speed!r}: the page drives {low:g} to {high:g}.")
    profile = load_profile(setup["profile"])
    road = road_of(setup["road"])
    plan = RoadDrive(road, speed if kind == "constant" else plan_speed(road, car, Comfort(lateral=speed))).plan
    for finding in check_road(road, car, plan):
        if not finding.drivable:
            place = f"{setup['road']['name']}, s = {finding.start:.0f} to {finding.end:.0f} m"
            raise InvalidInput(f"export_page: {place}: {finding.text}. Choose another road, car or speed.")
    with _quiet():
        for controller in setup["controllers"]:
            steering = page_controller(controller["kind"], car, profile)
            World.of(DualTrack(car), steering, profile, None, None, None)
            if planner is not None:
                PlannedController(steering, SpeedControl(car), planner).make_tracker()


def _check_name(kind: str, name: str, names: Iterable[str]) -> str:
    if name not in names:
        raise UnknownName(f"export_page: the page has no {kind} {name!r}. {did_you_mean(name, names)}")
    return name


def page_kernels() -> bytes:
    """Return the module, compiled now where it is not there; InvalidInput when that fails."""
    try:
        return library.page_module().read_bytes()
    except library.UNUSABLE as error:
        raise InvalidInput(
            f"the kernels for WebAssembly are not there ({error}): install the compiler (pip install ziglang) and run "
            f"{library.BUILD} {library.PAGE}."
        ) from None


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Without warnings: the page has every controller in every profile, also where one was made for another."""
    log = logging.getLogger("adaptrack")
    before = log.level
    log.setLevel(logging.ERROR)
    try:
        yield
    finally:
        log.setLevel(before)


def write_page(path: str | os.PathLike[str], setup: Mapping[str, Any] | None = None) -> Path:
    """Write the page; setup: what it begins with, see `export_page`.

    Raises InvalidInput where the kernels for WebAssembly are not there, and StorageError when the page cannot be
    written.
    """
    write_atomically(path, page_html(setup).encode())
    return Path(path)


def page_html(setup: Mapping[str, Any] | None = None) -> str:
    """The page as text; setup: what it begins with.

    Its Content-Security-Policy lets this script, its worker and its kernels run, and nothing be loaded from anywhere.
    Raises InvalidInput where the kernels for WebAssembly are not there.
    """
    remaining = {path.name for path in PAGE_SOURCES.glob("*.js")} - {*ENGINE, *FIRST_SCRIPTS, *LAST_SCRIPTS}
    script = _together((*FIRST_SCRIPTS, *sorted(remaining), *LAST_SCRIPTS))
    css = _text("viewer.css") + _text("page.css")
    with _quiet():
        data = page_data() | ({} if setup is None else {"setup": dict(setup)})
    parts = {
        "engine": _together(ENGINE).encode(), "kernels": page_kernels(),
        "data": json.dumps(data, separators=(",", ":"), allow_nan=False).encode(),
    }  # fmt: skip
    carried = "".join(
        f'<script type="application/gzip" id="part-{name}">'
        f"{base64.b64encode(gzip.compress(content, 9, mtime=0)).decode()}</script>\n"
        for name, content in parts.items()
    )
    policy = content_policy([script], "'wasm-unsafe-eval'", "worker-src blob:")
    head = f'<head>\n<meta http-equiv="Content-Security-Policy" content="{policy}">'
    html = _once(_text("page.html"), "<head>", head)
    html = _once(html, "</head>", f"<style>\n{css}</style>\n</head>")
    return _once(html, "</body>", f"{carried}<script>{script}</script>\n</body>")


def _text(name: str) -> str:
    return (PAGE_SOURCES / name).read_text(encoding="utf-8")


def _together(names: tuple[str, ...]) -> str:
    """One script of several files, which share one scope of their own."""
    files = "\n".join(f"// -- {name}\n{_text(name)}" for name in names)
    return f'\n(() => {{\n"use strict";\n{files}}})();\n'


def _once(text: str, marker: str, put: str) -> str:
    """The text with the one place of a tag written anew."""
    before, _, behind = text.partition(marker)
    return f"{before}{put}{behind}"
