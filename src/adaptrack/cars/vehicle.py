"""Vehicles, tyres and steering actuators: frozen, validated sets of parameters in SI units and radians.

ISO 8855 axes: x forward, y left, z up; steering and yaw are positive to the left. A stiffness is that of *one* tyre.
Each set is one TOML file, see `load_vehicle`; `pack_plant` turns three of them into the record that a plant takes.
"""

from __future__ import annotations

import itertools
import math
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, ValidationInfo, field_validator, model_validator

from adaptrack.base import files
from adaptrack.base.checked import Hint, checked
from adaptrack.base.errors import InvalidInput, UnknownName, did_you_mean
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.cars.outline import Outline
from adaptrack.core.kernel import OK, row_of
from adaptrack.core.models.car import (
    ACTUATOR,
    CAR,
    FORCE_ACTUATOR,
    OUTLINE,
    PLANT_PARAMETERS,
    STEERING,
    STEERING_WHEEL_RATIO,
    CarRow,
)
from adaptrack.core.physics.forces import GRAVITY as GRAVITY
from adaptrack.core.synthesis import car
from adaptrack.core.synthesis import plant as kernel
from adaptrack.core.synthesis.car import INERTIAS, STIFFNESSES
from adaptrack.core.synthesis.filter import split_periods as split_periods

FASTEST_RATE = 10.0
"""rad/s, of road wheels, beyond which a rate is in another unit: a model car's servo has some 10 at its own lever."""


class Tyre(files.Record):
    """The tyre of the plant: lateral force of slip angle, vertical load and friction; the same on both sides.

    With q = F_z/nominal_load, the cornering stiffness of one tyre (N/rad) is

    ============  ==========================================================================================
    constant      C(F_z) = C
    linear        C(F_z) = C q
    digressive    C(F_z) = C (1 + 1/p^2) q/(1 + q^2/p^2), which peaks at q = p: the law C sin(2 atan(q/p)) of
                  Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., eq. (4.E25), scaled to C at the nominal load
    ============  ==========================================================================================

    where C is `stiffness_front` or `stiffness_rear` and p is `digressive_load_ratio`. The force is

    =============  =========================================================================================
    linear         F_y = C(F_z) mu alpha, without limit
    magic-formula  F_y = D sin(C atan(B alpha - E (B alpha - atan(B alpha)))), D = mu F_z (1 - d (q - 1)),
                   with shape C, curvature E, friction_load_sensitivity d and B = C(F_z)/(C D), so that the
                   slope at the origin is the cornering stiffness (Pacejka, eqs. (4.E19)-(4.E30) without
                   shifts and camber)
    =============  =========================================================================================
    """

    name: str = Field(min_length=1, description="how lists and tables call the tyre")
    description: str = Field(default="", description="one sentence for lists")
    kind: Literal["magic-formula", "linear"] = Field(description="law of the lateral force")
    stiffness_front: float = Field(gt=0, le=1e7, description="N/rad, one front tyre at the nominal load")
    stiffness_rear: float = Field(gt=0, le=1e7, description="N/rad, one rear tyre at the nominal load")
    nominal_load: float = Field(gt=0, le=1e6, description="N, vertical load that the stiffness belongs to")
    stiffness_load: Literal["constant", "linear", "digressive"] = Field(
        default="constant", description="how the stiffness depends on the vertical load"
    )
    digressive_load_ratio: float | None = Field(
        default=None,
        gt=0,
        le=100,
        validate_default=True,
        description="-, load over nominal load at which a digressive stiffness peaks",
    )
    shape: float = Field(default=1.35, ge=0.5, le=2, description="-, shape factor C of the Magic Formula")
    curvature: float = Field(default=0.0, ge=-20, le=1, description="-, curvature factor E of the Magic Formula")
    friction_load_sensitivity: float = Field(
        default=0.0, ge=0, le=1, description="-, d: friction falls by this share when the load doubles from nominal"
    )
    relaxation_length: float = Field(
        default=0.0, ge=0, le=10, description="m, rolling distance over which a force builds up; 0: at once"
    )

    @field_validator("digressive_load_ratio")
    @classmethod
    def _ratio_belongs_to_the_digressive_law(cls, ratio: float | None, info: ValidationInfo) -> float | None:
        law = info.data.get("stiffness_load", "digressive" if ratio else "constant")
        if law == "digressive" and ratio is None:
            raise ValueError("a digressive stiffness needs the load ratio at which it peaks (2 for many car tyres).")
        if law != "digressive" and ratio is not None:
            raise ValueError(f"only stiffness_load = 'digressive' has a use for it, not {law!r}: leave it out.")
        return ratio

    def stiffness_at(self, front_load: float, rear_load: float) -> tuple[float, float]:
        """Cornering stiffness (N/rad) of one front and one rear tyre at their vertical loads (N)."""
        front, rear = kernel.tyre_stiffness(self.numbers, front_load, rear_load)
        return front, rear

    @property
    def numbers(self) -> Any:
        """Kernel record of the tyre, `core.synthesis.plant.TyreRow`."""
        return row_of(
            kernel.TyreRow, self, linear=self.kind == "linear", stiffness_load=_LOAD_LAWS[self.stiffness_load],
            shape_factor=self.shape,
        )  # fmt: skip


_LOAD_LAWS = {
    "constant": kernel.CONSTANT_STIFFNESS, "linear": kernel.LINEAR_STIFFNESS, "digressive": kernel.DIGRESSIVE_STIFFNESS,
}  # fmt: skip


class SteeringActuator(files.FieldRecord, fields=ACTUATOR):
    """The steering actuator of the plant: first-order lag behind a rate limit and an angle limit, at the road wheels.

    d(delta)/dt = (command + bias - delta)/lag, clipped to +-rate, with the command of a dead time ago, clipped to
    +-limit. With a lag of 0 the wheels are where the command is.
    """

    @field_validator("rate")
    @classmethod
    def _rate_acts_behind_a_lag(cls, rate: float, info: ValidationInfo) -> float:
        if info.data.get("lag", 1.0) == 0.0 and math.isfinite(rate):
            raise ValueError("a rate limit acts on the lag: give lag > 0 (0.05 s, for instance), or rate = inf.")
        return rate

    @classmethod
    def ideal(cls) -> Self:
        """The wheels follow the command at once and without limit (the MPC's own limits remain)."""
        return cls()


class ForceActuatorRecord(files.FieldRecord, fields=FORCE_ACTUATOR):
    """Drive or brakes between a requested force and the wheels: gain, dead time, first-order lag behind a rate limit.

    dF/dt = clip((gain request - F)/lag, +-rate m), with the request of a dead time ago and the mass m of the car.
    """


class BrakeActuator(ForceActuatorRecord):
    """The brakes of the simulated car: the section ``[brakes]`` of a profile or a car file."""


class DriveActuator(ForceActuatorRecord):
    """The drive of the simulated car: the section ``[drive]`` of a profile or a car file."""

    creep: float = Field(
        default=0.0, ge=0, le=5, description="m/s^2, that the drive gives at standstill unasked; faded out at 2 m/s"
    )


class Steering(files.FieldRecord, fields=(*STEERING, STEERING_WHEEL_RATIO), optional=True):
    """Steering parameters: the section ``[steering]`` of a car file. Omitted values are unknown.

    All angles are those of the road wheels. The simulated actuator is a profile's, see `SteeringActuator`.
    """

    @field_validator("rate")
    @classmethod
    def _rate_is_in_radians_at_the_road_wheels(cls, rate: float | None) -> float | None:
        if rate is not None and rate > FASTEST_RATE:
            raise ValueError(
                f"no road wheels turn at {rate:g} rad/s; cars have 0.3 to 1. Of degrees per second give "
                f"{math.radians(rate):.2g}; of a rate at the steering wheel, that over the ratio."
            )
        return rate


class Body(files.FieldRecord, fields=OUTLINE, optional=True):
    """Outline parameters: the section ``[body]`` of a car file. Omitted values are estimated."""

    def overhangs(self, wheelbase: float) -> tuple[float, float]:
        """Front and rear overhang (m) over a wheelbase (m), estimated where they are not known.

        Raises
        ------
        ValueError
            When the length leaves no room for an axle, or is not wheelbase and overhangs.
        """
        status, front, rear = kernel.overhangs(self.numbers, wheelbase)
        if status == kernel.AXLE_OUTSIDE:
            raise ValueError(f"length {self.length} m does not hold wheelbase ({wheelbase:g} m) and overhangs.")
        if status == kernel.LENGTH_DISAGREES:
            total = f"{front:g} + {wheelbase:g} + {rear:g} m"
            raise ValueError(f"length {self.length} m is not overhang, wheelbase and overhang, {total}: leave one out.")
        return front, rear

    @property
    def numbers(self) -> Any:
        """A row of `core.synthesis.plant.BodyRow`."""
        return row_of(kernel.BodyRow, self)


COASTING_SHARE = 0.01
"""Of the largest brake force: up to so far below the force of the coasting car, a request presses no pedal."""
Numbers = Annotated[tuple[float, ...], files.LISTED]
"""Values at the points of a table; a list in TOML."""


class PedalMap(files.Record):
    """Static map between pedals and forces at the wheels: the section ``[pedals]`` of a car file.

    Forces are those of drive and brakes alone, without air drag, rolling resistance and slope. Between its points the
    map is linear; beyond them it is constant. Lag and dead time are those of the sections ``[drive]`` and ``[brakes]``.
    """

    speed: Numbers = Field(description="m/s, of the rows of force")
    throttle: Numbers = Field(description="-, pedal positions of the columns of force, from 0 to at most 1")
    force: Annotated[tuple[Numbers, ...], files.LISTED] = Field(
        description="N, at the wheels, a row for each speed; at throttle 0 creep (> 0) or engine braking (< 0)"
    )
    brake: Numbers = Field(description="-, pedal positions of brake_force, from 0 to at most 1")
    brake_force: Numbers = Field(description="N, at the wheels, from 0")

    @model_validator(mode="after")
    def _force_rises_with_the_pedals(self) -> Self:
        for name in ("speed", "throttle", "brake"):
            points = getattr(self, name)
            if not points or points[0] < 0.0 or any(after <= before for before, after in itertools.pairwise(points)):
                raise ValueError(f"{name} must begin with a value of at least 0 and rise from value to value.")
            if name != "speed" and not 0.0 == points[0] < points[-1] <= 1.0:
                raise ValueError(f"{name} must begin with 0 and end at most at 1; divide per cent by 100.")
        if len(self.force) != len(self.speed) or self.brake_force[:1] != (0.0,):
            raise ValueError("force must have a row for each speed, and brake_force must begin with 0.")
        rows = [(f"force at {speed:g} m/s", row, "throttle") for speed, row in zip(self.speed, self.force, strict=True)]
        for name, forces, pedal in (*rows, ("brake_force", self.brake_force, "brake")):
            falls = any(after < before for before, after in itertools.pairwise(forces))
            if len(forces) != len(getattr(self, pedal)) or falls or forces[0] >= forces[-1]:
                raise ValueError(
                    f"{name} is {', '.join(f'{force:g}' for force in forces)} N: give a value for each position of "
                    f"{pedal}, none below the one before it, and the last above the first."
                )
        return self

    def drive_forces(self, speed: float) -> NDArray[np.float64]:
        """Return the forces (N) at the points of the throttle, at a speed (m/s)."""
        return np.array([np.interp(speed, self.speed, column) for column in zip(*self.force, strict=True)])

    def force_at(self, throttle: float, brake: float, speed: float) -> float:
        """Return the force (N) at the wheels, positive forward, of throttle and brake (0 to 1) at a speed (m/s)."""
        driving = np.interp(throttle, self.throttle, self.drive_forces(speed))
        return float(driving - np.interp(brake, self.brake, self.brake_force))

    def positions(self, force: float, speed: float, hold: float = 0.0) -> tuple[float, float]:
        """Return throttle and brake (0 to 1) that give a force (N) at a speed (m/s).

        A force above that of the coasting car needs the throttle, a force below it the brakes. They begin to act
        `COASTING_SHARE` below it, and act fully from twice that on, so that the pedals do not alternate.

        hold: N, of the brakes in addition
        """
        drive_forces = self.drive_forces(speed)
        missing = float(drive_forces[0]) - force
        throttle = float(np.interp(force, drive_forces, self.throttle)) if missing < 0.0 else 0.0
        braking = hold + max(min(missing, 2.0 * (missing - COASTING_SHARE * self.brake_force[-1])), 0.0)
        return throttle, float(np.interp(braking, self.brake_force, self.brake)) if braking > 0.0 else 0.0


FACTOR = "-, factor"
"""How the description of a key begins whose uncertainty is a factor; that of another begins with its unit."""
_MARGINS = {
    "lf": 5.0, "track_front": 5.0, "track_rear": 5.0, "cg_height": 5.0, "drive_front": 1.0, "brake_front": 1.0,
    "length": 10.0, "width": 5.0, "front_overhang": 5.0, "rear_overhang": 5.0, "steering_lag": 1.0,
    "steering_dead_time": 1.0,
}  # fmt: skip
"""Largest margins; the other tolerances are factors."""


def _tolerance(name: str, field: Any) -> Any:
    """The field of the tolerance of a number."""
    margin = _MARGINS.get(name)
    if margin is None:
        meaning = f"factor by which it may be larger or smaller: {field.meaning}"
        return field._replace(name=name, unit="", default=math.nan, meaning=meaning, bounds="[1, 10]")
    meaning = f"by which it may differ to either side: {field.meaning}"
    return field._replace(name=name, default=math.nan, meaning=meaning, bounds=f"[0, {margin:g}]")


_CAR = tuple(_tolerance(field.name, field) for field in (*CAR, *OUTLINE) if field.name != "lr")
_STEERING = tuple(_tolerance(f"steering_{field.name}", field) for field in (*STEERING, STEERING_WHEEL_RATIO))


class KnownWithin(files.FieldRecord, fields=(*_CAR, *_STEERING), optional=True):
    """How far the numbers of a car may be off: the section ``[known_within]`` of a car file.

    A factor f says that the true value lies between value/f and f value; a margin d, between value - d and value + d.
    Keys are those of the car, of its ``[steering]`` with ``steering_`` in front. What is left out is not said.
    """

    @classmethod
    def is_factor(cls, name: str) -> bool:
        """Whether the uncertainty of a key is a factor, not a margin."""
        return (cls.model_fields[name].description or "").startswith(FACTOR)

    def clause(self, name: str) -> str:
        """A factor as "x/÷ 1.3", a margin as "± 0.05 m"; empty where nothing is said."""
        value = getattr(self, name, None)
        if value is None:
            return ""
        if self.is_factor(name):
            return f"x/÷ {value:.3g}"
        unit = (type(self).model_fields[name].description or "").split(",")[0]
        return f"± {value:.3g}" + ("" if unit == "-" else f" {unit}")


MAX_DOMAIN = {"speed": 100.0, "friction": 2.0}
"""m/s, -: the ranges of a domain end there at the latest."""
Range = Annotated[tuple[float, float], files.LISTED]
"""Lowest and highest value; a list in TOML."""


class Domain(files.Record):
    """Where a car is at home: the section ``[domain]`` of a car file. Random drives are drawn in it.

    The defaults are those of a passenger car on public roads. `failure_distance` is when a run of the car has failed,
    unless the caller says otherwise.
    """

    speed: Range = Field(default=(4.0, 27.0), description="m/s, lowest and highest")
    friction: Range = Field(default=(0.3, 1.0), description="-, lowest and highest coefficient")
    wind: float = Field(default=30.0, ge=0, le=100, description="m/s, strongest lateral wind")
    lane_width: float = Field(default=3.5, gt=0, le=20, description="m; lane changes are 2/7 to 12/7 of it")
    failure_distance: float = Field(
        default=5.0, gt=0, le=100, description="m from the reference, beyond which the car is off the road"
    )

    @model_validator(mode="after")
    def _ranges_rise(self) -> Self:
        for name, most in MAX_DOMAIN.items():
            low, high = getattr(self, name)
            if not 0.0 < low <= high <= most:
                raise ValueError(f"{name} = [{low:g}, {high:g}]: need 0 < lowest <= highest <= {most:g}.")
        return self

    @property
    def drive_options(self) -> dict[str, Any]:
        """Options of `scenario.random_drive` that draw a drive in the domain."""
        return {name: getattr(self, name) for name in ("speed", "friction", "wind", "lane_width")}


class Vehicle(files.FieldRecord, fields=CAR, after="tyre"):
    """Body, air resistance and powertrain of a car, and the tyre stiffness that the controller's model believes in.

    `mass`, `yaw_inertia`, `lf`, `lr`, `stiffness_front` and `stiffness_rear` are the single-track model of the
    prediction (the paper's table II). The plant uses the same body but its own `Tyre`; `matched_to` makes both agree.
    """

    name: str = Field(min_length=1, description="how lists and tables call the car")
    description: str = Field(default="", description="one sentence for lists")
    tyre: str = Field(default="passenger-car", description="tyre of the plant: a name, or a .toml file beside this one")

    estimated: Annotated[tuple[str, ...], files.LISTED] = Field(
        default=(), description="keys whose numbers no source gives for this car: estimated from others"
    )

    steering: Steering | None = Field(default=None, description="what is known of the steering, see `Steering`")
    drive: DriveActuator | None = Field(
        default=None, description="how the driving force follows a request, see `DriveActuator`; None: as the profile"
    )
    brakes: BrakeActuator | None = Field(
        default=None, description="how the braking force follows a request, see `BrakeActuator`; None: as the profile"
    )
    pedals: PedalMap | None = Field(default=None, description="force at the wheels by pedals, see `PedalMap`")
    body: Body | None = Field(default=None, description="what is known of the outline, see `Body`")
    known_within: KnownWithin | None = Field(
        default=None, description="how far the numbers may be off, see `KnownWithin`"
    )
    domain: Domain = Field(default_factory=Domain, description="where the car is driven, see `Domain`")

    if TYPE_CHECKING:

        def __init__(self, **values: Any) -> None: ...

    @field_validator("tyre")
    @classmethod
    def _tyre_is_known_or_a_file(cls, tyre: str) -> str:
        if is_path(tyre):
            if not Path(tyre).is_file():
                raise ValueError("no such file.")
        elif tyre not in list_tyres():
            raise ValueError(f"unknown tyre. {did_you_mean(tyre, list_tyres())} A file is given by its .toml path.")
        return tyre

    @field_validator("estimated")
    @classmethod
    def _estimates_are_numbers_of_the_car(cls, estimated: tuple[str, ...]) -> tuple[str, ...]:
        numbers = [name for name, field in cls.model_fields.items() if field.annotation is float]
        for name in estimated:
            if name not in numbers:
                raise ValueError(f"{name!r} is no number of a car. {did_you_mean(name, numbers)}")
        return estimated

    @field_validator("body")
    @classmethod
    def _body_holds_both_axles(cls, body: Body | None, info: ValidationInfo) -> Body | None:
        if body is not None and {"lf", "lr"} <= set(info.data):
            body.overhangs(info.data["lf"] + info.data["lr"])
        return body

    @model_validator(mode="after")
    def _numbers_are_of_one_car(self) -> Self:
        """Refuse a number in another unit than the others, such as a mass in tonnes or a stiffness per degree."""
        flaw, ratio = car.car_flaw(self.numbers)
        if flaw == car.INERTIA_ODD:
            raise ValueError(
                f"yaw_inertia = {self.yaw_inertia:g} kg m^2 and mass = {self.mass:g} kg do not belong together: "
                f"yaw_inertia/(mass lf lr) = {ratio:.3g}, where cars have about 1 ({INERTIAS[0]:g} to {INERTIAS[1]:g} "
                "is allowed). Give the mass in kg, lengths in m, the inertia in kg m^2; with another mass the inertia "
                "changes too."
            )
        if flaw != OK:
            axle, load = ("front", "rear")[flaw - car.FRONT_ODD], self.static_loads[flaw - car.FRONT_ODD]
            raise ValueError(
                f"stiffness_{axle} = {getattr(self, f'stiffness_{axle}'):g} N/rad is {ratio:.3g} times the load of its "
                f"wheel, {load:.0f} N; tyres have 5 to 30 ({STIFFNESSES[0]:g} to {STIFFNESSES[1]:g} is allowed). Give "
                "it in N/rad for one tyre: N/deg times 57.3, kN/rad times 1000."
            )
        return self

    @property
    def outline(self) -> Outline:
        """The body from above; what the car file does not say is estimated from wheelbase and track, and named."""
        body, row = self.body or Body(), row_of(kernel.OutlineRow)
        kernel.outline_of(body.numbers, self.numbers, row)
        is_specified = {
            "length": body.length is not None or None not in (body.front_overhang, body.rear_overhang),
            "front_overhang": body.front_overhang is not None or None not in (body.length, body.rear_overhang),
            "width": body.width is not None,
        }
        front, rear, width = row.tolist()
        return Outline(front, rear, width, tuple(name for name, entry in is_specified.items() if not entry))

    @property
    def wheelbase(self) -> float:
        """l_f + l_r (m)."""
        return self.lf + self.lr

    @property
    def numbers(self) -> Any:
        """Kernel record of the car, `core.models.car.CarRow`."""
        return row_of(CarRow, self)

    @property
    def static_loads(self) -> tuple[float, float]:
        """Vertical load (N) of one front and one rear wheel of the car at rest."""
        front, rear = car.static_loads(self.numbers)
        return front, rear

    @property
    def understeer_gradient(self) -> float:
        """K (rad s^2/m) of the prediction model: delta = L/R + K a_y in a steady turn; negative means oversteer.

        K = m (l_r/(2 C_f) - l_f/(2 C_r))/L (Rajamani, *Vehicle Dynamics and Control*, 2nd ed., section 3.3).
        """
        return float(car.understeer_gradient(self.numbers))

    @property
    def rear_slip_gradient(self) -> float:
        """W (rad s^2/m) of the prediction model: slip angle of the rear tyres per lateral acceleration."""
        return float(car.rear_slip_gradient(self.numbers))

    @property
    def understeer_range(self) -> tuple[float, float]:
        """Lowest and highest understeer gradient (rad s^2/m) that `known_within` leaves possible."""
        tolerances = self.known_within or KnownWithin()
        gradients = []
        for signs in itertools.product((-1.0, 1.0), repeat=4):
            mass, front, rear = (
                getattr(self, name) * (factor if sign > 0.0 else 1.0 / factor)
                for name, sign in zip(("mass", "stiffness_front", "stiffness_rear"), signs, strict=False)
                for factor in [getattr(tolerances, name) or 1.0]
            )
            lf = min(max(self.lf + signs[3] * (tolerances.lf or 0.0), 0.0), self.wheelbase)
            gradients.append(mass / self.wheelbase * ((self.wheelbase - lf) / (2 * front) - lf / (2 * rear)))
        return min(gradients), max(gradients)

    @property
    def characteristic_speed(self) -> float:
        """Speed (m/s) with the largest yaw gain, sqrt(L/K); infinite unless the car understeers (K > 0)."""
        gradient = self.understeer_gradient
        return math.sqrt(self.wheelbase / gradient) if gradient > 0 else math.inf

    @property
    def critical_speed(self) -> float:
        """Speed (m/s) from which the car is unstable, sqrt(-L/K); infinite unless the car oversteers (K < 0)."""
        gradient = self.understeer_gradient
        return math.sqrt(-self.wheelbase / gradient) if gradient < 0 else math.inf

    def steady_state_yaw_gain(self, vx: float) -> float:
        """Yaw rate per steering angle (1/s) in a steady turn at speed vx (m/s): vx/(L + K vx^2).

        The steady state of the paper's eq. (6) (Rajamani, section 3.3).

        Raises
        ------
        InvalidInput
            When vx is not a finite speed >= 0 below the critical speed: no steady turn exists there.
        """
        if not 0.0 <= vx < math.inf or vx >= self.critical_speed:
            raise InvalidInput(
                f"steady_state_yaw_gain: vx = {vx!r}: must be a finite speed >= 0 m/s, "
                f"below the critical speed ({self.critical_speed:.4g} m/s)."
            )
        return vx / (self.wheelbase + self.understeer_gradient * (vx * vx))

    def to_toml(self, path: str | os.PathLike[str], head: Sequence[str] = ()) -> None:
        """Write the car as TOML, each value with its meaning and unit behind it; the new car has the file's name.

        A tyre file is named relative to the car's. head: comments at the beginning of the file

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        data = self.replace(name=Path(path).stem).model_dump()
        if is_path(self.tyre):
            data["tyre"] = os.path.relpath(self.tyre, Path(path).parent)
        comments = "".join(f"# {line}\n" for line in head) + "\n" * bool(head)
        files.write_atomically(path, (comments + files.dump_toml(data, files.meanings(self))).encode())

    def plot(self) -> Any:
        """The car from above, to scale, as a matplotlib figure."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """The car in a notebook: its numbers and its picture."""
        return html_of(self)

    def matched_to(self, tyre: Tyre) -> Self:
        """A copy whose prediction model has the stiffness of `tyre` at the car's static wheel loads."""
        front, rear = tyre.stiffness_at(*self.static_loads)
        return self.replace(stiffness_front=front, stiffness_rear=rear)

    def stiffness_factors(self, tyre: Tyre) -> tuple[float, float]:
        """Stiffness of `tyre` at the static wheel loads over that of the prediction model, front and rear."""
        matched = self.matched_to(tyre)
        return matched.stiffness_front / self.stiffness_front, matched.stiffness_rear / self.stiffness_rear


def pack_plant(vehicle: Vehicle, tyre: Tyre, actuator: SteeringActuator) -> NDArray[np.float64]:
    """The plant's parameters as one array, shape (len(PLANT_PARAMETERS),), in the order that the kernels expect."""
    parameters = np.zeros(len(PLANT_PARAMETERS))
    kernel.plant_parameters(vehicle.numbers, tyre.numbers, row_of(kernel.Actuator, actuator), parameters)
    return parameters


def list_vehicles() -> list[str]:
    """The names that `load_vehicle` knows, sorted."""
    return list_data("vehicles")


def list_tyres() -> list[str]:
    """The names that `load_tyre` knows, sorted."""
    return list_data("tyres")


VehicleArgument = Annotated[Vehicle, Hint("load_vehicle(name) gives one")]
"""The type of an argument."""


@checked
def load_vehicle(name_or_path: str | os.PathLike[str]) -> Vehicle:
    """The named vehicle, or the one that a TOML file describes (keys: the fields of `Vehicle`).

    Text is a path when it ends in ``.toml`` or holds a directory; without the key ``name``, the file's own name is
    taken. A tyre file that the vehicle names is looked for beside the vehicle's file.

    Raises
    ------
    UnknownName
        When no vehicle has this name.
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not TOML, or holds an unknown, missing or impossible value; all of them are in the message.
    """
    path = find_data("vehicles", name_or_path)
    data = {"name": path.stem, **files.read_toml(path)}
    tyre = data.get("tyre")
    if isinstance(tyre, str) and is_path(tyre):
        data["tyre"] = str(path.parent / tyre)
    return files.build(Vehicle, data, path)


@checked
def load_tyre(name_or_path: str | os.PathLike[str]) -> Tyre:
    """The named tyre, or the one that a TOML file describes (keys: the fields of `Tyre`); see `load_vehicle`."""
    path = find_data("tyres", name_or_path)
    return files.build(Tyre, {"name": path.stem, **files.read_toml(path)}, path)


def list_data(folder: str, ending: str = ".toml") -> list[str]:
    """The names of the shipped files of one folder (vehicles, tyres, profiles, ...), sorted."""
    return sorted(path.stem for path in (files.SHIPPED / folder).glob(f"*{ending}"))


def find_data(folder: str, name_or_path: str | os.PathLike[str], ending: str = ".toml") -> Path:
    """The file that a name (of a shipped one in the folder) or a path means.

    Raises UnknownName when nothing has this name, and InvalidInput for what is neither text nor a path.
    """
    if isinstance(name_or_path, os.PathLike) or is_path(name_or_path, ending):
        return Path(name_or_path)
    if not isinstance(name_or_path, str):
        raise InvalidInput(f"a {folder[:-1]} is given by its name or by the path of its file, not by {name_or_path!r}.")
    names = list_data(folder, ending)
    if name_or_path not in names:
        hint = did_you_mean(name_or_path, names)
        raise UnknownName(f"no {folder[:-1]} is named {name_or_path!r}. {hint} A file is given by its {ending} path.")
    return files.SHIPPED / folder / f"{name_or_path}{ending}"


def is_path(text: Any, ending: str = ".toml") -> bool:
    """Whether a text means a file rather than a name: it has the ending or holds a directory."""
    return str(text).endswith(ending) or any(mark in str(text) for mark in (os.sep, os.altsep) if mark)
