"""`adaptrack manoeuvre`: open-loop tests of the standards on a plant."""

from __future__ import annotations

import math
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer import Option

from adaptrack.cli import options, show
from adaptrack.cli.show import Column
from adaptrack.errors import InvalidInput

if TYPE_CHECKING:
    from adaptrack.manoeuvres import Surroundings
    from adaptrack.plant import Plant, SteppedPlant
    from adaptrack.vehicle import Vehicle

NOT_PASSED = 1
"""The exit code when the criteria of a standard are not met."""


class Name(StrEnum):
    """Manoeuvres that can be driven without a controller."""

    steady_circle = "steady-circle"
    step_steer = "step-steer"
    frequency_response = "frequency-response"
    sine_with_dwell = "sine-with-dwell"


TITLES = {
    Name.steady_circle: "Steady circular driving, after ISO 4138",
    Name.step_steer: "Step of the steering, after ISO 7401",
    Name.frequency_response: "Continuous sines of the steering, after ISO 7401",
    Name.sine_with_dwell: "Sine with dwell, UN R140 and FMVSS 126",
}
COLUMNS = {
    Name.steady_circle: (
        Column("lateral_acceleration", "lat. acc.", "m/s²", show.digits(3)),
        Column("speed", "speed", "m/s"),
        Column("wheel_angle", "wheels", "°"),
        Column("sideslip", "sideslip", "°", show.digits(3)),
        Column("yaw_rate", "yaw rate", "°/s"),
        Column("understeer_gradient", "understeer", "°/g", show.digits(3)),
    ),
    Name.frequency_response: (
        Column("frequency", "frequency", "Hz"),
        Column("yaw_rate_gain", "yaw rate", "1/s"),
        Column("yaw_rate_phase", "phase", "°", show.digits(3)),
        Column("acceleration_gain", "lat. acc.", "m/s²/rad"),
        Column("acceleration_phase", "phase", "°", show.digits(3)),
    ),
    Name.sine_with_dwell: (
        Column("amplitude", "amplitude", "°"),
        Column("multiple", "of A", "", show.digits(3)),
        Column("peak_yaw_rate", "peak", "°/s", show.digits(3)),
        Column("yaw_ratio_1", "after 1 s", "%", show.whole),
        Column("yaw_ratio_2", "after 1.75 s", "%", show.whole),
        Column("displacement", "aside", "m", show.digits(3)),
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


def manoeuvre(
    name: Annotated[Name, typer.Argument(help="Which one.")],
    vehicle: options.Vehicle = "paper",
    plant: options.Plant = "dual-track",
    tyre: options.Tyre = None,
    speed: Annotated[
        float | None, Option("--speed", help="m/s; by default 80 km/h; steady-circle: instead of a constant radius.")
    ] = None,
    radius: Annotated[float | None, Option("--radius", help="steady-circle: m, by default 100.")] = None,
    lateral_acceleration: Annotated[
        float | None,
        Option("--lateral-acceleration", metavar="A", help="step-steer, frequency-response: m/s², by default 4."),
    ] = None,
    friction: Annotated[float | None, Option("--friction", help="Of all wheels, by default 0.9.")] = None,
    plugin: options.Plugin = None,
    as_json: options.Json = False,
) -> None:
    """Drive an open-loop test of a standard; sine-with-dwell: exit code 1 when its criteria are not met.

    The plants have no stability control, without which cars may fail the sine with dwell.
    """
    from adaptrack.manoeuvres import Surroundings

    options.load_plugins(plugin)
    car, body = options.car_and_plant(vehicle, plant, tyre)
    asked = {"speed": speed, "radius": radius, "lateral_acceleration": lateral_acceleration}
    given = {key: value for key, value in asked.items() if value is not None}
    around = None if friction is None else Surroundings(friction=friction)
    summary, rows = _drive(name, car, body, given, around)
    passed = bool(summary.get("passed", True))
    if as_json:
        about = {"manoeuvre": str(name), "vehicle": car.name, "plant": body.name, "tyre": body.tyre_name}
        show.say_json(about | {key: _strict(value) for key, value in summary.items()} | {"rows": _plain(rows)})
    else:
        _print(name, f"{car.name}, {body.name}", summary, rows)
    if not passed:
        raise typer.Exit(NOT_PASSED)


def _drive(
    name: Name, car: Vehicle, plant: Plant | SteppedPlant, given: dict[str, float], around: Surroundings | None
) -> tuple[dict[str, Any], list[dict[str, Any]]]:
    """The characteristic values and the rows of a manoeuvre."""
    from adaptrack import manoeuvres

    known = {
        Name.steady_circle: {"speed", "radius"},
        Name.step_steer: {"speed", "lateral_acceleration"},
        Name.frequency_response: {"speed", "lateral_acceleration"},
        Name.sine_with_dwell: set(),
    }
    for option in sorted(set(given) - known[name]):
        raise InvalidInput(f"--{option.replace('_', '-')} has no meaning for {name}: leave it out.")
    drive: Any = getattr(manoeuvres, name.name)
    found = drive(car, plant, surroundings=around, **given)
    return found.summary(), found.rows() if name in COLUMNS else []


def _strict(value: Any) -> Any:
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _plain(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [{key: _strict(value) for key, value in row.items()} for row in rows]


def _print(name: Name, who: str, summary: dict[str, Any], rows: list[dict[str, Any]]) -> None:
    if rows:
        told = [
            {**row, "result": "spun" if row.get("spun") else "passed" if row.get("passed") else "failed"}
            for row in _plain(rows)
        ]
        show.table(f"{TITLES[name]}: {who}", COLUMNS[name], told)
    listed = [
        {"what": key.replace("_", " "), "value": _strict(value), "unit": UNITS[key]} for key, value in summary.items()
    ]
    show.table(
        f"{TITLES[name]}: {who}" if not rows else "Characteristic values",
        (Column("what", "what"), Column("value", "value"), Column("unit", "unit")),
        listed,
    )
