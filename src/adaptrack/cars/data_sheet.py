"""A car from its data sheet: mass and wheelbase, and estimates from published measurements of real cars for the rest.

Every estimate has a spread, in `Vehicle.known_within`, and its key stands in `Vehicle.estimated`.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from adaptrack.base.checked import Finite, Hint, NotNegative, checked, real, within
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cars.vehicle import KnownWithin, Vehicle
from adaptrack.core.kernel import row_of
from adaptrack.core.models.car import CarRow
from adaptrack.core.synthesis import car as kernel
from adaptrack.core.synthesis.car import MASSES, WHEELBASES

DRIVER = 75.0
"""kg, driver in the mass in running order (Regulation (EU) No 1230/2012)."""
DRIVER_AND_LUGGAGE = 136.0
"""kg, what opendbc (commaai) adds to a kerb mass for driver, luggage and fuel, `STD_CARGO_KG`."""
DRIVEN_AXLES = {"front": 1.0, "rear": 0.0, "all": 0.5}
"""Driven axles: share of the driving force on the front axle, `Vehicle.drive_front`."""
BODY_STYLES = ("car", "truck")
"""Passenger cars; pickups, vans and sport utility vehicles."""
_ESTIMATED = ("lf", "lr", *kernel.ESTIMATED_NUMBERS)
_MEASURED = Hint("the estimates are of such cars; of another, give all six numbers in a car file")


@checked
def vehicle_from_data_sheet(
    name: str,
    mass: Annotated[Finite, within(*MASSES), "kg", _MEASURED],
    wheelbase: Annotated[Finite, within(*WHEELBASES), "m", _MEASURED],
    *,
    load: Annotated[NotNegative, "kg"] = 0.0,
    body_style: str = "car",
    driven_axle: Literal["front", "rear", "all"] | None = None,
    **entries: Any,
) -> Vehicle:
    """A car of which little is known; every other number is estimated, marked and given a spread.

    mass: kg, of the car as it stands in the data sheet; wheelbase: m; load: kg of people and luggage beside it (a kerb
    mass without driver: `DRIVER`, or `DRIVER_AND_LUGGAGE`), taken to sit at the centre of gravity, so that the yaw
    inertia is that of the car alone; body_style: one of `BODY_STYLES`, "car" or "truck" (pickup, van, SUV);
    driven_axle: sets `Vehicle.drive_front` (1, 0 or 0.5); None: front drive is assumed, and marked as estimated; known:
    any other key of `Vehicle` that the data sheet has, such as lf, yaw_inertia, stiffness_front, track_front, body.

    The estimates, with m of the car alone, L the wheelbase and F_z the axle's load:

        l_f = 0.42 L +- 0.06 L,   I_z = 1.09 m l_f l_r  x/÷ 1.15,   2 C_f = 13.8 F_zf,  2 C_r = 21.9 F_zr  x/÷ 1.62,
        track = 1.229 m + 1.97e-4 m/kg m +- 0.06 m,   height 0.548 m +- 0.05 m

    (`core.synthesis.car` names the sources.) Air and powertrain keep the defaults of
    `Vehicle`, marked as estimated as well, without a spread. The tyre of the plant stays
    "passenger-car", whose stiffness at 2 to 5 kN lies within that factor.

    Raises
    ------
    UnknownName
        For another body style.
    InvalidInput
        When the load is more than the car, lf and lr do not make the wheelbase, or driven_axle and drive_front are both
        given.
    """
    if body_style not in BODY_STYLES:
        hint = did_you_mean(str(body_style), BODY_STYLES)
        raise UnknownName(f"vehicle_from_data_sheet: body_style = {body_style!r}: unknown. {hint}")
    if driven_axle is not None:
        if "drive_front" in entries:
            raise InvalidInput("vehicle_from_data_sheet: driven_axle and drive_front: give only one of them.")
        entries["drive_front"] = DRIVEN_AXLES[driven_axle]
    arms = {key: real("vehicle_from_data_sheet", key, entries.pop(key)) for key in ("lf", "lr") if key in entries}
    car_row, within = row_of(CarRow, mass=mass, **arms), row_of(kernel.KnownWithinRow)
    status = kernel.complete_car(wheelbase, load, BODY_STYLES.index(body_style), car_row, within)
    if status == kernel.TOO_MUCH_LOAD:
        raise InvalidInput(f"vehicle_from_data_sheet: load = {load:g} kg: must not be more than the car itself.")
    if status == kernel.AXLES_DISAGREE:
        lengths = " and ".join(f"{key} = {value:g} m" for key, value in arms.items())
        raise InvalidInput(
            f"vehicle_from_data_sheet: lf and lr do not make the wheelbase of {wheelbase:g} m with {lengths}: give one "
            "of them, or neither."
        )
    estimates = {key: float(car_row[key]) for key in _ESTIMATED}
    entries |= {key: estimates[key] for key in ("lf", "lr") if arms}
    guessed = [key for key in estimates if key not in entries]
    spreads = {key: float(within[key]) for key in guessed if key in kernel.KnownWithinRow._fields and key != "lr"}
    entries.setdefault("known_within", KnownWithin(**spreads))
    entries.setdefault("description", f"estimated from {mass:g} kg and {wheelbase:g} m of wheelbase")
    guessed += [
        key for key, field in Vehicle.model_fields.items()
        if field.annotation is float and key not in entries and key not in estimates and key != "mass"
    ]  # fmt: skip
    return Vehicle(name=name, mass=float(car_row.mass), **(estimates | entries), estimated=tuple(guessed))
