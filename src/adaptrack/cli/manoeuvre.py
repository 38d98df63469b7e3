"""`adaptrack manoeuvre`: tests of the standards on a plant, and those that a controller drives (`closed_loop`)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.next_step import again, command, say_next
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.cars.plant import Plant, SteppedPlant
    from adaptrack.cars.vehicle import Vehicle
    from adaptrack.comparison.manoeuvres import Surroundings

NOT_PASSED = 1
"""The exit code when the criteria of a standard are not met."""


class Name(StrEnum):
    """Manoeuvres: open loop, and those that a controller drives."""

    steady_circle = "steady-circle"
    step_steer = "step-steer"
    frequency_response = "frequency-response"
    sine_with_dwell = "sine-with-dwell"
    double_lane_change = "double-lane-change"
    obstacle_avoidance = "obstacle-avoidance"
    curvature_step = "curvature-step"
    lane_drift = "lane-drift"
    lane_recovery = "lane-recovery"


TITLES = {
    Name.steady_circle: "Steady circular driving, after ISO 4138",
    Name.step_steer: "Step of the steering, after ISO 7401",
    Name.frequency_response: "Continuous sines of the steering, after ISO 7401",
    Name.sine_with_dwell: "Sine with dwell, UN R140 and FMVSS 126",
}
COLUMNS = {
    Name.steady_circle: (
        Column("lateral_acceleration", "lat. acc.", "m/s²", 3),
        Column("speed", "speed", "m/s"),
        Column("wheel_angle", "wheels", "°"),
        Column("sideslip", "sideslip", "°", 3),
        Column("yaw_rate", "yaw rate", "°/s"),
        Column("understeer_gradient", "understeer", "°/g", 3),
    ),
    Name.frequency_response: (
        Column("frequency", "frequency", "Hz"),
        Column("yaw_rate_gain", "yaw rate", "1/s"),
        Column("yaw_rate_phase", "phase", "°", 3),
        Column("acceleration_gain", "lat. acc.", "m/s²/rad"),
        Column("acceleration_phase", "phase", "°", 3),
    ),
    Name.sine_with_dwell: (
        Column("amplitude", "amplitude", "°"),
        Column("multiple", "of A", "", 3),
        Column("peak_yaw_rate", "peak", "°/s", 3),
        Column("yaw_ratio_1", "after 1 s", "%", "whole"),
        Column("yaw_ratio_2", "after 1.75 s", "%", "whole"),
        Column("displacement", "aside", "m", 3),
        Column("result", "result"),
    ),
}
UNITS = {
    "speed": "m/s", "wheel_angle": "°", "lateral_acceleration": "m/s²", "yaw_rate": "°/s", "sideslip": "°",
    "yaw_rate_gain": "1/s", "yaw_response_time": "s", "yaw_peak_time": "s", "yaw_overshoot": "",
    "acceleration_response_time": "s", "acceleration_peak_time": "s", "acceleration_overshoot": "", "tb": "° s",
    "yaw_bandwidth": "Hz", "yaw_resonance": "Hz", "yaw_resonance_gain": "", "yaw_delay_1hz": "s",
    "understeer_gradient_2": "°/g", "understeer_gradient_4": "°/g", "highest_lateral_acceleration": "m/s²",
    "steering_ratio": "", "angle": "°", "runs": "", "passed_runs": "", "passed": "",
}  # fmt: skip
"""Of the characteristic values, by name."""


KNOWN = {
    Name.steady_circle: {"speed", "radius"},
    Name.step_steer: {"speed", "lateral-acceleration"},
    Name.frequency_response: {"speed", "lateral-acceleration"},
    Name.sine_with_dwell: set[str](),
    Name.double_lane_change: {"controller", "profile", "tune", "out"},
    Name.obstacle_avoidance: {"controller", "profile", "tune", "out"},
    Name.curvature_step: {"controller", "profile", "speed", "radius"},
    Name.lane_drift: {"controller", "profile", "speed"},
    Name.lane_recovery: {"controller", "profile", "speed"},
}
"""The options that a manoeuvre takes, beside those of all."""
OPEN_LOOP = (Name.steady_circle, Name.step_steer, Name.frequency_response, Name.sine_with_dwell)


@dataclass(frozen=True, kw_only=True)
class ManoeuvreOptions:
    """Options of `adaptrack manoeuvre`."""

    name: Annotated[Name, typer.Argument(metavar="NAME", show_choices=False, help="Which one, see above.")]
    vehicle: Annotated[
        list[str] | None,
        Option(
            "--vehicle",
            metavar="CAR",
            help="Name (see `vehicles`) or .toml file, by default paper; several with a controller.",
        ),
    ] = None
    controller: Annotated[
        list[str] | None,
        Option(
            "--controller",
            metavar="NAME",
            help="Closed loop: informed, lqr, pure-pursuit, stanley [default: all four], ...",
        ),
    ] = None
    profile: Annotated[
        str | None, Option("--profile", metavar="NAME", help="Closed loop: by default road; or a .toml file.")
    ] = None
    tune: Annotated[
        bool | None,
        Option("--tune/--no-tune", help="Lane changes: also with a tuning searched on the track [default]."),
    ] = None
    speed: Annotated[
        float | None, Option("--speed", metavar="V", help="m/s; open loop by default 80 km/h; not of the lane changes.")
    ] = None
    radius: Annotated[
        float | None, Option("--radius", metavar="M", help="steady-circle, by default 100; curvature-step, 50.")
    ] = None
    lateral_acceleration: Annotated[
        float | None,
        Option("--lateral-acceleration", metavar="A", help="step-steer, frequency-response: m/s², by default 4."),
    ] = None
    friction: Annotated[float | None, Option("--friction", metavar="MU", help="Of all wheels, by default 0.9.")] = None
    plant: options.Plant = "dual-track"
    tyre: options.Tyre = None
    plugin: options.Plugin = None
    out: Annotated[
        Path | None, Option("--out", metavar="FOLDER", help="Lane changes: folder for a picture of each car.")
    ] = None
    as_json: options.Json = False

    @property
    def particular(self) -> dict[str, Any]:
        """The options that only some manoeuvres take, of those that are given."""
        known = {option for each in KNOWN.values() for option in each}
        values = {option: getattr(self, option.replace("-", "_")) for option in sorted(known)}
        return {option: value for option, value in values.items() if value is not None}


@options.grouped
def manoeuvre(given: ManoeuvreOptions) -> None:
    """Drive a test of a standard, or one of ours.

    Open loop: steady-circle, step-steer, frequency-response, sine-with-dwell; the plants have no stability control,
    without which cars may fail the last. With controllers: double-lane-change and obstacle-avoidance (highest clean
    entry speed; no criterion), curvature-step, lane-drift, lane-recovery. Exit code 1 when criteria are not met.
    """
    options.load_plugins(given.plugin)
    name, particular = given.name, given.particular
    for option in sorted(set(particular) - KNOWN[name]):
        raise InvalidInput(f"--{option} has no meaning for {name}: leave it out.")
    names = dict.fromkeys(given.vehicle or ["paper"])
    cars = [options.car_and_plant(each, given.plant, given.tyre) for each in names]
    if name in OPEN_LOOP:
        if len(cars) > 1:
            raise InvalidInput(f"--vehicle: {name} drives one car; name it once.")
        numbers = {key.replace("-", "_"): value for key, value in particular.items()}
        passed = _open_loop(name, *cars[0], numbers, given.friction, given.as_json)
    else:
        passed = _closed_loop(name, cars, particular, given.friction, given.as_json)
    if not given.as_json:
        say_next(*_next_step(given))
    if not passed:
        raise typer.Exit(NOT_PASSED)


def _next_step(given: ManoeuvreOptions) -> tuple[str, str]:
    """What to do after a manoeuvre, and the command."""
    if given.name in (Name.double_lane_change, Name.obstacle_avoidance):
        if given.out is None:
            return "to see the fastest clean runs as pictures", again("--out", str(given.name))
        return "to drive a road", command("drive", "country", "--vehicle", (given.vehicle or ["paper"])[0])
    cars = [word for each in given.vehicle or ["paper"] for word in ("--vehicle", each)]
    return "to see how fast controllers enter a lane change", command("manoeuvre", "obstacle-avoidance", *cars)


def _open_loop(
    name: Name, car: Vehicle, plant: Plant | SteppedPlant, given: dict[str, float], friction: float | None,
    as_json: bool,
) -> bool:  # fmt: skip
    """Drive and print; whether its criteria are met."""
    from adaptrack.comparison.manoeuvres import Surroundings
    from adaptrack.results.answers import of_open_loop

    around = None if friction is None else Surroundings(friction=friction)
    summary, rows = _drive(name, car, plant, given, around)
    if as_json:
        about = {"manoeuvre": str(name), "vehicle": car.name, "plant": plant.name, "tyre": plant.tyre_name}
        show.say_json(about | {key: _strict(value) for key, value in summary.items()} | {"rows": _plain(rows)})
    else:
        show.say(of_open_loop(name, summary))
        _print(name, f"{car.name}, {plant.name}", summary, rows)
    return bool(summary.get("passed", True))


def _closed_loop(
    name: Name, cars: list[tuple[Vehicle, Plant | SteppedPlant]], given: dict[str, Any], friction: float | None,
    as_json: bool,
) -> bool:  # fmt: skip
    """Drive and print; whether its criteria are met."""
    from adaptrack.cars.plant import Plant as Compiled
    from adaptrack.cli import closed_loop
    from adaptrack.scenario.profile import load_profile

    compiled = [(car, plant) for car, plant in cars if isinstance(plant, Compiled)]
    if len(compiled) < len(cars):
        raise InvalidInput(f"--plant: {name} is driven compiled; a plant in Python has no place in it.")
    driven = closed_loop.ManoeuvreSettings(
        compiled, given.get("controller", closed_loop.CONTROLLERS), load_profile(given.get("profile", "road")),
        friction, bool(given.get("tune", True)), given.get("out"),
    )  # fmt: skip
    if name in (Name.double_lane_change, Name.obstacle_avoidance):
        closed_loop.drive_lane_change(str(name), driven, as_json)
        return True
    return closed_loop.drive_start(str(name), driven, given, as_json)


def _drive(
    name: Name, car: Vehicle, plant: Plant | SteppedPlant, given: dict[str, float], around: Surroundings | None
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The characteristic values and the rows of a manoeuvre."""
    from adaptrack.comparison import manoeuvres

    drive: Any = getattr(manoeuvres, name.name)
    found = drive(car, plant, surroundings=around, **given)
    return found.summary(), found.rows() if name in COLUMNS else []


def _strict(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: _strict(value) for key, value in row.items()} for row in rows]


def _print(name: Name, driven: str, summary: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    if rows:
        shown = [
            {**row, "result": "spun" if row.get("spun") else "passed" if row.get("passed") else "failed"}
            for row in _plain(rows)
        ]
        show.table(f"{TITLES[name]}: {driven}", COLUMNS[name], shown)
    listed = [
        {"what": key.replace("_", " "), "value": _strict(value), "unit": UNITS[key]} for key, value in summary.items()
    ]
    show.table(
        f"{TITLES[name]}: {driven}" if not rows else "Characteristic values",
        (Column("what", "what"), Column("value", "value"), Column("unit", "unit")),
        listed,
    )
