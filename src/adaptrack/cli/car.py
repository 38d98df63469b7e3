"""`adaptrack car`: show the parameters of a car, or make a car from a data sheet, a tyre file or a table."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cli import options, show
from adaptrack.cli.next_step import say_next
from adaptrack.cli.options import argument, json_flag, option, option_group
from adaptrack.cli.show import Column

if TYPE_CHECKING:
    from adaptrack.cars.tyre_fit import TyreFit


PARAMETER_COLUMNS = (
    Column("key", "parameter"), Column("value", "value", "", 5), Column("unit", "unit"),
    Column("within", "tolerance"), Column("from", "source"),
)  # fmt: skip
DERIVED = (Column("what", "derived quantity"), Column("value", "value"), Column("unit", "unit"))


@option_group
class NewCar:
    """The data sheet of a new car."""

    mass: float | None = option("KG", "Mass of a new car (kg); needs --wheelbase.")
    wheelbase: float | None = option("M", "Wheelbase of a new car (m); needs --mass.")
    load: float | None = option("KG", "Mass of people and luggage (kg): 75 for a driver, 136 with luggage.")
    body_style: Literal["car", "truck"] = option(None, "Body of a new car; truck: pickup, van or SUV.", "car")
    drive: Literal["front", "rear", "all"] | None = option(
        None, "Driven axle of a new car; by default front drive is assumed."
    )
    yaw_inertia: float | None = option("I", "Yaw inertia (kg m^2), if known.", hidden=True)
    lf: float | None = option("M", "Centre of gravity to front axle, if known.", hidden=True)
    stiffness_front: float | None = option("C", "Stiffness of one front tyre (N/rad), if known.", hidden=True)
    stiffness_rear: float | None = option("C", "Stiffness of one rear tyre (N/rad), if known.", hidden=True)

    def estimate(self, name: str) -> at.Vehicle | None:
        """Estimate a car from its data sheet, which needs mass and wheelbase; None without any value."""
        values = {key: getattr(self, key) for key in ("yaw_inertia", "lf", "stiffness_front", "stiffness_rear")}
        values = {key: value for key, value in values.items() if value is not None}
        if self.mass is None and self.wheelbase is None:
            if values or self.load is not None or self.drive is not None:
                raise InvalidInput("a new car needs --mass and --wheelbase.")
            return None
        if self.mass is None or self.wheelbase is None:
            missing = "mass" if self.mass is None else "wheelbase"
            raise InvalidInput(f"a new car needs --mass and --wheelbase: --{missing} is missing.")
        return at.vehicle_from_data_sheet(
            name, self.mass, self.wheelbase, load=self.load or 0.0, body_style=self.body_style,
            driven_axle=self.drive, **values,
        )  # fmt: skip


@options.grouped
def car(
    *,
    name: str | None = argument("[CAR]", "Car to show: see `list cars`, or a .toml file."),
    new: NewCar,
    tir: Path | None = option("FILE", "Tyre property file in format MF 5.2, 6.1, 6.2 or PAC2002."),
    tyre_table: Path | None = option(
        "FILE", ".csv file of axle forces with columns slip_rad, force_front_N, force_rear_N."
    ),
    out: Path | None = option("FILE", "Car file to write (.toml); a tyre file is written to the same folder."),
    as_json: bool = json_flag(),
) -> None:
    """Show a car, or make a car file.

    A new car needs --mass and --wheelbase. All other values are estimated from published measurements, and the car file
    lists them as estimated. Without a car, --tir makes only a tyre file.
    """
    if tir is not None and tyre_table is not None:
        raise InvalidInput("--tir and --tyre-table: give only one of them.")
    if name is not None and new != NewCar(body_style=new.body_style):
        raise InvalidInput(
            f"{name} is an existing car: leave out --mass, --wheelbase and the other options of a new car."
        )
    vehicle = new.estimate("new-car" if out is None else out.stem) if name is None else at.load_vehicle(name)
    if vehicle is None and tir is None:
        raise InvalidInput("no car: name a car, or give --mass and --wheelbase, or --tir.")
    fit = _fit(tir, tyre_table, vehicle)
    options.make_place(out, ".toml")
    vehicle, written = _write(vehicle, fit, out, as_json)
    _say(vehicle, fit, written, as_json)
    if vehicle is None or as_json:
        return
    is_changed = name is None or tir is not None or tyre_table is not None
    say_next("car", is_unsaved=out is None and is_changed, is_estimated=vehicle.estimated, car=out or name)


def _write(
    vehicle: at.Vehicle | None, fit: TyreFit | None, out: Path | None, as_json: bool
) -> tuple[at.Vehicle | None, list[Path]]:
    """Write the files of a car and a tyre; return the car with the tyre, and the files."""
    written: list[Path] = []
    with show.replacing(*([] if out is None else [out, out.with_name(f"{out.stem}-tyre.toml")]), aside=as_json):
        if fit is not None and out is not None:
            tyre_file = out if vehicle is None else out.with_name(f"{out.stem}-tyre.toml")
            fit.tyre.replace(name=tyre_file.stem).to_toml(tyre_file)
            written.append(tyre_file)
        if vehicle is not None:
            vehicle = _with_tyre(vehicle, fit, written)
            if out is not None:
                vehicle.to_toml(out)
                written.append(out)
    return vehicle, written


def _fit(tir: Path | None, table: Path | None, vehicle: at.Vehicle | None) -> TyreFit | None:
    """Fit a tyre to a file or a table; None without either."""
    if tir is not None:
        return at.read_tyre_file(tir).to_tyre()
    if table is not None:
        return at.tyre_from_table(table, None if vehicle is None else vehicle.static_loads)
    return None


def _with_tyre(vehicle: at.Vehicle, fit: TyreFit | None, written: list[Path]) -> at.Vehicle:
    """Return the car with a new tyre and its stiffness."""
    if fit is None:
        return vehicle
    guesses = tuple(key for key in vehicle.estimated if key not in ("stiffness_front", "stiffness_rear"))
    front, rear = (float(f"{stiffness:.5g}") for stiffness in fit.tyre.stiffness_at(*vehicle.static_loads))
    changed = vehicle.replace(stiffness_front=front, stiffness_rear=rear, estimated=guesses)
    return changed.replace(tyre=str(written[0])) if written else changed


# -- output ----------------------------------------------------------------------------------------------------
def _say(vehicle: at.Vehicle | None, fit: TyreFit | None, written: list[Path], as_json: bool) -> None:
    if as_json:
        from adaptrack.export.page_inputs import page_car

        show.say_json({
            "page_car": None if vehicle is None else page_car(vehicle, None if fit is None else fit.tyre),
            "car": None if vehicle is None else vehicle.model_dump(mode="json"),
            "derived": [] if vehicle is None else derived(vehicle, fit),
            "tyre": None if fit is None else {
                **asdict(fit), "tyre": fit.tyre.model_dump(mode="json"), "notes": list(fit.notes),
            },
            "written": list(map(str, written)),
        })  # fmt: skip
        return
    if vehicle is not None:
        show.say(car_answer(vehicle))
        title = vehicle.name if not vehicle.description else f"{vehicle.name}: {vehicle.description}"
        show.table(title, PARAMETER_COLUMNS, numbers(vehicle))
        show.table("Steady-state cornering of the model", DERIVED, derived(vehicle, fit))
        if "drive_front" in vehicle.estimated:
            show.say(
                "The driven axle is unknown; front drive is assumed. It limits the drive force in\nbends: give --drive "
                "rear or --drive all, or set drive_front in the car file."
            )
        domain = vehicle.domain
        show.say(
            f"Domain: {domain.speed[0]:g} to {domain.speed[1]:g} m/s, friction {domain.friction[0]:g} to "
            f"{domain.friction[1]:g}, wind to {domain.wind:g} m/s, lanes of {domain.lane_width:g} m,\n"
            f"a drive fails beyond {domain.failure_distance:g} m from the reference."
        )
    if fit is not None:
        _say_fit(fit)
    for path in written:
        show.say(f"Written: {path}")


def car_answer(vehicle: at.Vehicle) -> str:
    """Mass, wheelbase and understeer gradient of a car, and the number of estimated values."""
    from adaptrack.core.physics.forces import GRAVITY

    gradient = math.degrees(1.0) * GRAVITY * vehicle.understeer_gradient
    kind = f"understeers by {gradient:.2g} °/g"
    if gradient < 0.0:
        kind = f"oversteers by {-gradient:.2g} °/g, unstable from {vehicle.critical_speed:.3g} m/s on"
    guesses = len(vehicle.estimated)
    estimated = f"; {guesses} of its numbers are estimated" if guesses else ""
    return f"{vehicle.name}: {vehicle.mass:.5g} kg, wheelbase {vehicle.wheelbase:.3g} m, {kind}{estimated}."


def _say_fit(fit: TyreFit) -> None:
    import textwrap

    tyre = fit.tyre
    show.say(
        f"Tyre {tyre.name}: {tyre.stiffness_front:.0f} and {tyre.stiffness_rear:.0f} N/rad (front, rear) at "
        f"{tyre.nominal_load:.0f} N."
    )
    for sentence in (f"Fit: {fit}.", *fit.notes):
        show.say("\n".join(textwrap.wrap(sentence, 78, initial_indent="- ", subsequent_indent="  ")))


def numbers(vehicle: at.Vehicle) -> list[dict[str, Any]]:
    """Return a row for each parameter of a car."""
    tolerances = vehicle.known_within or at.KnownWithin()
    rows = []
    for section, record in (("", vehicle), ("steering", vehicle.steering), ("body", vehicle.body)):
        for key, field in () if record is None else type(record).model_fields.items():
            value = getattr(record, key)
            if not isinstance(value, float):
                continue
            rows.append({
                "key": f"{section} {key}".strip().replace("_", " "), "value": value,
                "unit": (field.description or "").split(",")[0],
                "within": tolerances.clause(f"steering_{key}" if section == "steering" else key),
                "from": _source(vehicle, section, key),
            })  # fmt: skip
    return rows


def _source(vehicle: at.Vehicle, section: str, key: str) -> str:
    if key in vehicle.estimated:
        return "estimated"
    is_default = not section and type(vehicle).model_fields[key].default == getattr(vehicle, key)
    return "default" if is_default and key not in vehicle.model_fields_set else "given"


def derived(vehicle: at.Vehicle, fit: TyreFit | None = None) -> list[dict[str, Any]]:
    """Return the quantities that follow from the car's parameters, a row each."""
    per_g = math.degrees(1.0) * 9.80665
    low, high = (per_g * gradient_end for gradient_end in vehicle.understeer_range)
    gradient = f"{per_g * vehicle.understeer_gradient:.2f}"
    if low < high:
        gradient += f" ({low:.2f} to {high:.2f})"
    speeds = sorted({vehicle.domain.speed[0], sum(vehicle.domain.speed) / 2, vehicle.domain.speed[1]})
    rows = [
        ("weight on the front axle", f"{100 * vehicle.lr / vehicle.wheelbase:.1f}", "%"),
        ("wheel load (front, rear)", "{:.4g}, {:.4g}".format(*vehicle.static_loads), "N"),
        ("yaw inertia/(mass lf lr)", f"{vehicle.yaw_inertia / (vehicle.mass * vehicle.lf * vehicle.lr):.3f}", "-"),
        ("understeer gradient", gradient, "°/g"),
        ("characteristic speed", _speed(vehicle.characteristic_speed), "m/s"),
        ("critical speed", _speed(vehicle.critical_speed), "m/s"),
    ]
    for speed in speeds:
        stable = speed < vehicle.critical_speed
        gain = f"{vehicle.steady_state_yaw_gain(speed):.2f}" if stable else "unstable"
        rows.append((f"yaw gain at {speed:.3g} m/s", gain, "1/s"))
    tyre = at.load_tyre(vehicle.tyre) if fit is None else fit.tyre
    front, rear = vehicle.stiffness_factors(tyre)
    rows.append((f"stiffness of tyre {tyre.name}/model", f"{front:.2f}, {rear:.2f}", "-"))
    return [dict(zip(("what", "value", "unit"), row, strict=True)) for row in rows]


def _speed(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "none"
