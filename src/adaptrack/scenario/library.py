"""Scenarios by name.

The two tests of the paper are data files (`adaptrack/data/scenarios`). The other manoeuvres are functions; the
parameters of a function are the options of its scenario. ``load_scenario(name).to_toml(path)`` writes any of them to a
file.
"""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.checked import checked, real
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean, format_value
from adaptrack.base.files import SHIPPED, read_toml
from adaptrack.cars.vehicle import Domain
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.scenario import random_drives
from adaptrack.scenario.random_drives import PASSENGER_CAR_DOMAIN
from adaptrack.scenario.scenario import Scenario
from adaptrack.scenario.shapes import QUINTIC_PEAK, QUINTIC_SLOPE, Gust, LaneChange, Shape, Sine, as_friction, as_shape

MAX_SCENARIO_HEADING = 0.25
"""Largest heading of a reference (rad) for which the prediction model's small-angle approximation is accurate."""

SignalLike = Shape | Mapping[str, Any] | float
"""Values that `as_shape` converts."""

COMMON_OPTIONS = (
    "duration", "window", "mirrored", "reference", "speed", "friction", "friction_patches", "wind", "wind_gain",
    "start_y", "start_heading",
)  # fmt: skip
"""The options of every scenario: fields of `Scenario`, one of its windows, and whether left and right are exchanged."""

DESCRIPTIONS = {
    "step": "A step of the lateral reference under constant conditions, as in the tuning of the published MPC.",
    "lane-change": "One smooth lane change, sized to the friction, and one side gust.",
    "double-lane-change": "Out of the lane and back within the lengths of ISO 3888-1, at constant speed.",
    "sine": "A sinusoidal lateral reference: weaving, for the frequency response.",
    "random-drive": random_drives.DESCRIPTION,
}
"""One-line descriptions of the manoeuvres. They are not docstrings because ``python -OO`` removes docstrings."""

_DATA = SHIPPED / "scenarios"


def _manoeuvre(name: str, **fields: Any) -> Scenario:
    """Return the scenario of a manoeuvre, which begins at y = 0."""
    return Scenario(name=name, description=DESCRIPTIONS[name], start_y=0.0, **fields)


def step(
    amplitude: float = 2.0, speed: SignalLike = 15.0, friction: Any = 0.9, wind: Any = 0.0, duration: float = 18.0
) -> Scenario:
    """A step of the lateral reference under constant conditions, as in the tuning of the published MPC."""
    return _manoeuvre(
        "step",
        source="Fitness of the paper's particle swarm (section III), 18 s; constant y_ref, speed, friction and wind.",
        duration=duration,
        reference=amplitude,
        speed=speed,
        friction=friction,
        wind=wind,
    )


def lane_change(
    amplitude: float = 3.5,
    speed: SignalLike = 20.0,
    friction: Any = 0.9,
    gust: float = 10.0,
    start: float = 1.0,
    change_time: float | None = None,
    gust_start: float = 4.0,
    gust_duration: float = 2.0,
    duration: float = 8.0,
) -> Scenario:
    """One smooth lane change, sized to the friction, and one side gust.

    Parameters
    ----------
    amplitude : float
        Lateral shift, m, positive to the left.
    gust : float
        Peak of the lateral 1-cosine gust, m/s.
    change_time : float, optional
        Duration of the lane change, s. By default it is the shortest duration that meets three conditions:

        - it lasts at least 2 s;
        - it uses at most 35 % of the lowest friction μ: sqrt(5.77 |amplitude| / (0.35 μ g));
        - its heading is at most 0.25 rad at the lowest speed v, at least 1 m/s: 1.875 |amplitude| / (0.25 v).
    """
    if change_time is None:
        times = np.linspace(0.0, duration, 1001)
        lowest = min(float(wheel.at(times).min()) for wheel in as_friction(friction))
        if not lowest > 0.0:
            raise InvalidInput(f"friction = {lowest!r}: must be > 0.")
        slowest = max(1.0, float(as_shape(speed).at(times).min()))
        change_time = max(
            2.0,
            math.sqrt(QUINTIC_PEAK * abs(amplitude) / (0.35 * lowest * GRAVITY)),
            QUINTIC_SLOPE * abs(amplitude) / (MAX_SCENARIO_HEADING * slowest),
        )
    return _manoeuvre(
        "lane-change",
        source="Quintic change (least jerk) that uses 35 % of the friction; 1-cosine gust as in EASA CS-25.341.",
        duration=duration,
        reference=LaneChange(amplitude=amplitude, start=start, duration=change_time),
        speed=speed,
        friction=friction,
        wind=Gust(peak=gust, start=gust_start, duration=gust_duration),
    )


def double_lane_change(
    amplitude: float = 3.5,
    speed: float = 14.0,
    friction: Any = 0.9,
    wind: Any = 0.0,
    approach: float = 1.0,
    duration: float | None = None,
) -> Scenario:
    """Out of the lane and back within the lengths of ISO 3888-1, at constant speed.

    The sections of ISO 3888-1 are 15, 30, 25, 25, 15 and 15 m long. The second section leads to a lane 3.5 m to the
    side, the fourth leads back. The reference is a smooth centre line: one quintic `LaneChange` in each of these two
    sections. A driver may cut corners within the lanes; the centre line does not. It would need 16 m/s^2 at 80 km/h.
    The default speed is therefore 14 m/s = 50 km/h, at which it needs 6.3 m/s^2.

    Parameters
    ----------
    amplitude : float
        Shift between the lanes, m, positive to the left.
    speed : float
        Constant speed, m/s; it converts the section lengths into times.
    approach : float
        Time before the first section, s.
    duration : float, optional
        Duration of the run, s; by default the time for all sections plus 2 s.
    """
    if not _is_number(speed) or not speed > 0.0:
        raise InvalidInput(f"speed = {speed!r}: the double lane change needs one constant speed > 0 m/s.")
    entry, departure, second_lane, back, end = (length / speed for length in (15.0, 30.0, 25.0, 25.0, 30.0))
    first_change = approach + entry
    second_change = first_change + departure + second_lane
    return _manoeuvre(
        "double-lane-change",
        source="Section lengths and lane offset of ISO 3888-1 (passenger cars, double lane change); quintic centre.",
        duration=second_change + back + end + 2.0 if duration is None else duration,
        reference=LaneChange(amplitude=amplitude, start=first_change, duration=departure)
        + LaneChange(amplitude=-amplitude, start=second_change, duration=back),
        speed=speed,
        friction=friction,
        wind=wind,
    )


def sine(
    amplitude: float = 2.0,
    frequency: float = 0.2,
    speed: SignalLike = 15.0,
    friction: Any = 0.9,
    wind: Any = 0.0,
    start: float = 1.0,
    duration: float = 20.0,
) -> Scenario:
    """A sinusoidal lateral reference: weaving, for the frequency response.

    Parameters
    ----------
    amplitude : float
        Lateral amplitude, m; the peak acceleration is amplitude (2π frequency)².
    frequency : float
        Frequency, Hz.
    start : float
        Time at which the weaving begins, s.
    """
    return _manoeuvre(
        "sine",
        duration=duration,
        reference=Sine(amplitude=amplitude, frequency=frequency, start=start),
        speed=speed,
        friction=friction,
        wind=wind,
    )


def random_drive(seed: float = 0, duration: float = 60.0, domain: Domain = PASSENGER_CAR_DOMAIN) -> Scenario:
    """Mixed driving: changing speed and friction, curves, lane changes, wind and gusts.

    This is `adaptrack.scenario.random_drive` with the speed, friction and wind ranges of a car's domain.

    Parameters
    ----------
    seed : float
        Seed of the random numbers; a whole number.
    """
    if not float(seed).is_integer():
        raise InvalidInput(f"seed = {seed!r}: must be a whole number.")
    return random_drives.random_drive(int(seed), duration, **domain.drive_options)


def _is_number(value: Any) -> bool:
    try:
        return math.isfinite(real("option", "value", value))
    except InvalidInput:
        return False


_MANOEUVRES: dict[str, Callable[..., Scenario]] = {
    "step": step,
    "lane-change": lane_change,
    "double-lane-change": double_lane_change,
    "sine": sine,
    "random-drive": random_drive,
}


def _files() -> dict[str, Path]:
    return {path.stem: path for path in sorted(_DATA.glob("*.toml"), reverse=True)}


def list_scenarios() -> dict[str, str]:
    """Return a one-line description of each named scenario, the scenarios of the paper first."""
    described = {name: str(read_toml(path)["description"]) for name, path in _files().items()}
    return described | DESCRIPTIONS


def scenario_options(name: str) -> dict[str, Any]:
    """Return the options of the scenario `name` with their defaults; they extend or replace `COMMON_OPTIONS`."""
    if name not in _MANOEUVRES:
        return {}
    arguments = inspect.signature(_MANOEUVRES[name]).parameters.items()
    return {key: option.default for key, option in arguments if key != "domain"}


@checked
def load_scenario(name_or_path: str | os.PathLike[str], *, domain: Domain | None = None, **options: Any) -> Scenario:
    """Load a scenario by its name or from a TOML or CSV file, and apply options.

    Parameters
    ----------
    name_or_path : str or path
        A name from `list_scenarios`, or a file that ends in ``.toml`` or ``.csv``.
    domain : Domain, optional
        Domain of the car that will drive the scenario; it sets the ranges of ``random-drive``.
    **options
        Options from `COMMON_OPTIONS`, and from `scenario_options` for a named scenario. ``None`` changes nothing.

    Raises
    ------
    UnknownName
        For a scenario or an option that does not exist; the message suggests the most similar name.
    InvalidInput
        For a value that is not allowed.
    StorageError, ConfigError
        For a file that cannot be read or used.
    """
    options = {key: value for key, value in options.items() if value is not None}
    name, files = os.fspath(name_or_path), _files()
    own_options = scenario_options(name)
    for key in options:
        if key not in own_options and key not in COMMON_OPTIONS:
            option_names = [*own_options, *COMMON_OPTIONS]
            raise UnknownName(f"scenario {name!r} has no option {key!r}. {did_you_mean(key, option_names)}")
        if key not in COMMON_OPTIONS:
            if not _is_number(options[key]):
                raise InvalidInput(f"{key} = {format_value(options[key])}: must be a finite number.")
            options[key] = float(options[key])
    if not isinstance(options.get("mirrored", False), bool):
        raise InvalidInput(f"mirrored = {options['mirrored']!r}: must be true or false.")
    if "window" in options and "duration" in options:
        raise InvalidInput("window and duration are both given: give only one of them.")
    if name in _MANOEUVRES:
        chosen = {key: options.pop(key) for key in own_options if key in options}
        if name == "random-drive" and domain is not None:
            chosen["domain"] = domain
        scenario = _MANOEUVRES[name](**chosen)
    elif name in files:
        scenario = Scenario.from_toml(files[name])
    elif name.lower().endswith(".csv"):
        scenario = Scenario.from_csv(name)
    elif name.lower().endswith(".toml"):
        scenario = Scenario.from_toml(name)
    else:
        option_names = [*files, *_MANOEUVRES]
        raise UnknownName(
            f"unknown scenario {name!r}. {did_you_mean(name, option_names)} Or give a .toml or .csv file."
        )
    window, mirrored = options.pop("window", None), options.pop("mirrored", False)
    scenario = scenario.replace(**options) if options else scenario
    scenario = scenario.with_window(window) if window else scenario
    return scenario.mirrored() if mirrored else scenario
