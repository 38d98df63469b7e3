"""A car from its data sheet: mass and wheelbase, and estimates from published measurements of real cars for the rest.

Every estimate has a spread, in `Vehicle.known_within`, and its key stands in `Vehicle.estimated`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from adaptrack.base.checked import Finite, Hint, NotNegative, checked, real, within
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.cars.known_within import KnownWithin
from adaptrack.cars.vehicle import GRAVITY, Vehicle

DRIVER = 75.0
"""kg, driver in the mass in running order (Regulation (EU) No 1230/2012)."""
DRIVER_AND_LUGGAGE = 136.0
"""kg, what opendbc (commaai) adds to a kerb mass for driver, luggage and fuel, `STD_CARGO_KG`."""

MASSES, WHEELBASES = (600.0, 3500.0), (1.7, 5.0)
"""kg, m: beyond these the measurements say nothing."""
FRONT_DISTANCE, FRONT_DISTANCE_SPREAD = 0.42, 0.06
"""-, l_f over the wheelbase: mean 0.416, 5 to 95 % from 0.39 to 0.50 in 42 cars of opendbc, `centerToFrontRatio`."""
AXLE_COEFFICIENTS = (13.8, 21.9)
"""1/rad, cornering stiffness of the front and the rear axle over its load: that of a Honda Civic in opendbc (192.15 and
202.5 kN/rad at 1462 kg, l_f at 0.4 of the wheelbase) times 0.62, the middle (geometric) of its `tireStiffnessFactor`,
0.385 to 1, of 79 cars."""
STIFFNESS_FACTOR = 1.62
"""-, by which that factor differs to either side. The axles of three cars of N. Kapania's published programs
(nkapania/Wolverine: 15.8 to 18.7 in front, 21.5 to 28.7 behind) and of an Acura TSX (kktse.github.io, 2019: 6.7 and
3.1 deg/g, thus 8.6 and 18.5) lie within."""


@dataclass(frozen=True)
class BodyStyle:
    """What measured cars of a kind have in common; each value with its spread."""

    dynamic_index: tuple[float, float]
    """-, I_z/(m l_f l_r), and the factor that covers 5 to 95 % of the cars"""
    cg_height: tuple[float, float]
    """m, and the margin"""
    track: tuple[float, float, float]
    """m at 0 kg, m/kg, and the margin (m)"""
    frontal_area: float
    """m^2; ours"""


BODY_STYLES = {
    "car": BodyStyle((1.09, 1.15), (0.548, 0.05), (1.229, 1.97e-4, 0.06), 2.1),
    "truck": BodyStyle((1.00, 1.15), (0.667, 0.12), (1.229, 1.97e-4, 0.15), 2.7),
}
"""Passenger cars; pickups, vans and sport utility vehicles.

Dynamic index: 73 cars and 131 trucks of NHTSA's Light Vehicle Inertial Parameter Database of 1998 (Heydinger, Bixel,
Garrott, Pyne, Howe, Guenther: Measured Vehicle Inertial Parameters, SAE 1999-01-1336): mean 1.091 and 1.002, 5 to 95 %
from 0.946 to 1.194 and from 0.870 to 1.145. Height of the centre of gravity: 357 cars of 2001 to 2020 of NHTSA's
rollover rating (Walz, Trends in the Static Stability Factor, HS-809 868, and later years, as collected at
kktse.github.io), mean 0.548 m, 5 to 95 % within 0.05 m; of trucks, the database of 1998. Track: a line through the same
357 cars over mass, standard error 0.035 m, 5 to 95 % within 0.06 m; trucks lie about it.
"""


_MEASURED = Hint("the estimates are of such cars; of another, give all six numbers in a car file")


@checked
def vehicle_from_data_sheet(
    name: str,
    mass: Annotated[Finite, within(*MASSES), "kg", _MEASURED],
    wheelbase: Annotated[Finite, within(*WHEELBASES), "m", _MEASURED],
    *,
    load: Annotated[NotNegative, "kg"] = 0.0,
    body_style: str = "car",
    **known: Any,
) -> Vehicle:
    """A car of which little is known; every other number is estimated, marked and given a spread.

    mass: kg, of the car as it stands in the data sheet; wheelbase: m; load: kg of people and luggage beside it (a kerb
    mass without driver: `DRIVER`, or `DRIVER_AND_LUGGAGE`), taken to sit at the centre of gravity, so that the yaw
    inertia is that of the car alone; body_style: one of `BODY_STYLES`, "car" or "truck" (pickup, van, SUV); known: any
    other key of `Vehicle` that the data sheet has, such as lf, yaw_inertia, stiffness_front, track_front, body.

    The estimates, with m of the car alone, L the wheelbase and F_z the axle's load:

        l_f = 0.42 L +- 0.06 L,   I_z = 1.09 m l_f l_r  x/÷ 1.15,   2 C_f = 13.8 F_zf,  2 C_r = 21.9 F_zr  x/÷ 1.62,
        track = 1.229 m + 1.97e-4 m/kg m +- 0.06 m,   height 0.548 m +- 0.05 m

    (`BODY_STYLES`, `FRONT_DISTANCE` and `AXLE_COEFFICIENTS` name the sources.) Air and powertrain keep the defaults of
    `Vehicle`, marked as estimated as well, without a spread. The tyre of the plant stays
    "passenger-car", whose stiffness at 2 to 5 kN lies within that factor.

    Raises
    ------
    UnknownName
        For another body style.
    InvalidInput
        When the load is more than the car, or lf and lr do not make the wheelbase.
    """
    style = BODY_STYLES.get(body_style)
    if style is None:
        hint = did_you_mean(str(body_style), BODY_STYLES)
        raise UnknownName(f"vehicle_from_data_sheet: body_style = {body_style!r}: unknown. {hint}")
    if load > mass:
        raise InvalidInput(f"vehicle_from_data_sheet: load = {load:g} kg: must not be more than the car itself.")
    lf, lr = _axles(wheelbase, known)
    estimates = _estimates(style, (mass, load), (lf, lr))
    guessed = [key for key in estimates if key not in known]
    known.setdefault("known_within", _spreads(style, wheelbase, guessed))
    known.setdefault("description", f"estimated from {mass:g} kg and {wheelbase:g} m of wheelbase")
    guessed += [
        key for key, field in Vehicle.model_fields.items()
        if field.annotation is float and key not in known and key not in estimates and key != "mass"
    ]  # fmt: skip
    return Vehicle(name=name, mass=float(mass + load), **(estimates | known), estimated=tuple(guessed))


def _estimates(style: BodyStyle, masses: tuple[float, float], arms: tuple[float, float]) -> dict[str, float]:
    """The estimates by key; masses: of the car and its load (kg); arms: l_f, l_r (m)."""
    (mass, load), (lf, lr) = masses, arms
    front, rear = (0.5 * (mass + load) * GRAVITY * arm / (lf + lr) for arm in (lr, lf))  # N, load of a wheel
    track = style.track[0] + style.track[1] * mass
    rounded = {
        "yaw_inertia": style.dynamic_index[0] * mass * lf * lr,
        "stiffness_front": AXLE_COEFFICIENTS[0] * front,
        "stiffness_rear": AXLE_COEFFICIENTS[1] * rear,
        "track_front": track,
        "track_rear": track,
    }
    exact = {"lf": lf, "lr": lr, "cg_height": style.cg_height[0], "frontal_area": style.frontal_area}
    return exact | {key: float(f"{value:.4g}") for key, value in rounded.items()}


def _axles(wheelbase: float, known: dict[str, Any]) -> tuple[float, float]:
    """l_f and l_r (m), those that are known taken out of `known`."""
    given = {key: real("vehicle_from_data_sheet", key, known.pop(key)) for key in ("lf", "lr") if key in known}
    lf = given.get("lf", wheelbase - given["lr"] if "lr" in given else round(FRONT_DISTANCE * wheelbase, 4))
    lr = given.get("lr", round(wheelbase - lf, 6))
    if not (0.0 < lf < wheelbase and abs(lf + lr - wheelbase) < 0.005):
        raise InvalidInput(
            f"vehicle_from_data_sheet: lf = {lf:g} m and lr = {lr:g} m do not make the wheelbase of {wheelbase:g} m: "
            "give one of them, or neither."
        )
    if given:
        known |= {"lf": lf, "lr": lr}
    return lf, lr


def _spreads(style: BodyStyle, wheelbase: float, guessed: list[str]) -> KnownWithin:
    spreads = {
        "yaw_inertia": style.dynamic_index[1],
        "lf": round(FRONT_DISTANCE_SPREAD * wheelbase, 3),
        "stiffness_front": STIFFNESS_FACTOR,
        "stiffness_rear": STIFFNESS_FACTOR,
        "track_front": style.track[2],
        "track_rear": style.track[2],
        "cg_height": style.cg_height[1],
        "frontal_area": 1.25,
    }
    return KnownWithin(**{key: spread for key, spread in spreads.items() if key in guessed})
