"""CommonRoad's cars as plants: the single-track drift model and the 29-state multi-body model.

    --plugin commonroad_cars --plant commonroad-single-track-drift --vehicle commonroad-2.toml

The other plant is ``commonroad-multi-body``; ``commonroad_vehicle(2).to_toml("commonroad-2.toml")`` writes the file of
a car. M. Althoff and G. Würsching, *CommonRoad: Vehicle Models*, 2020; their own Python functions and parameters, from
the package commonroad-vehicle-models, are compiled at run time as they stand. `commonroad_kernel` adds our steering
actuator, the road's friction, wind and bank.
"""

from __future__ import annotations

import dataclasses
import importlib
import math
import os
import re
from collections.abc import Callable, Mapping
from functools import cache, lru_cache, partial
from importlib import metadata
from typing import Any

import numpy as np
from numpy.typing import NDArray

import commonroad_kernel as kernel
from adaptrack.base.checked import checked
from adaptrack.base.errors import ConfigError, InvalidInput, MissingExtra, UnknownName, did_you_mean
from adaptrack.base.files import read_toml
from adaptrack.cars.plant import UserPlant, flattened, register_plant
from adaptrack.cars.vehicle import Body, Tyre, Vehicle
from adaptrack.core.public import compiles, layout_of

Array = NDArray[np.float64]
Source = Any
"""A CommonRoad vehicle's number, a TOML file, nested tables, or the dataclass of their package."""

MODELS = ("single-track-drift", "multi-body")
CARS = {1: "Ford Escort", 2: "BMW 320i", 3: "VW Vanagon"}
"""The vehicles that have the parameters of both models."""
PACKAGE, DISTRIBUTION = "vehiclemodels", "commonroad-vehicle-models"
"""Their package as Python imports it, and as it is installed."""
PREFIX = "commonroad-"
"""Of the cars' names, before the number, and of the plants', before the model."""

_CHASSIS = (
    "m", "m_s", "m_uf", "m_ur", "a", "b", "I_Phi_s", "I_y_s", "I_z", "I_xz_s", "K_sf", "K_sdf", "K_sr", "K_sdr", "T_f",
    "T_r", "K_ras", "K_tsf", "K_tsr", "K_rad", "K_zt", "h_raf", "h_rar", "h_s", "I_uf", "I_ur", "I_y_w", "K_lt", "R_w",
    "T_sb", "T_se", "D_f", "D_r", "E_f", "E_r",
)  # fmt: skip
_STEERING = ("min", "max", "v_min", "v_max")
_LONGITUDINAL = ("v_min", "v_max", "v_switch", "a_max")
_TYRE = (
    "p_cx1", "p_dx1", "p_dx3", "p_ex1", "p_kx1", "p_hx1", "p_vx1", "r_bx1", "r_bx2", "r_cx1", "r_ex1", "r_hx1",
    "p_cy1", "p_dy1", "p_dy3", "p_ey1", "p_ky1", "p_hy1", "p_hy3", "p_vy1", "p_vy3", "r_by1", "r_by2", "r_by3", "r_cy1",
    "r_ey1", "r_hy1", "r_vy1", "r_vy3", "r_vy4", "r_vy5", "r_vy6",
)  # fmt: skip
_CAR = {
    **dict.fromkeys(_CHASSIS), "steering": dict.fromkeys(_STEERING), "longitudinal": dict.fromkeys(_LONGITUDINAL),
    "tire": dict.fromkeys(_TYRE),
}  # fmt: skip
_AIR = (
    "air_density", "frontal_area", "drag_coefficient", "side_force_slope", "yaw_moment_slope", "wind_angle_limit",
    "lf", "lr",
)  # fmt: skip
_LONGEST_STEP = {"single-track-drift": 1.5625e-3, "multi-body": 2.5e-3}
"""s; times the rate with which the slip of the wheels settles at most, 1,520 and 780 1/s, well below the 2.78 at which
the Runge-Kutta method becomes unstable."""


def commonroad_parameters(source: Source) -> dict[str, Any]:
    """The parameters of a car as nested tables, under CommonRoad's names: ``["m"]``, ``["tire"]["p_ky1"]``.

    source: the number of one of their vehicles, read from the installed package; a TOML file, or tables or their
    `VehicleParameters`, with their names. SI units, radians; what neither model reads is left out.

    Raises
    ------
    MissingExtra
        When a vehicle is given by its number and commonroad-vehicle-models is not installed.
    UnknownName
        When there is no vehicle of that number with the parameters of both models.
    ConfigError
        When a parameter is missing or no finite number; all of them are named.
    StorageError
        When the file cannot be read.
    """
    where, given = _read(source)
    flat = flattened(given)
    wrong = [f"{name} is missing" for name in flattened(_CAR) if flat.get(name) is None]
    for name in flattened(_CAR):
        value = flat.get(name)
        if value is not None and (isinstance(value, bool) or not isinstance(value, int | float | np.number)):
            wrong.append(f"{name} = {value!r} is no number")
        elif value is not None and not math.isfinite(value):
            wrong.append(f"{name} = {value!r} is not finite")
    if wrong:
        raise ConfigError(
            f"{where}: {', '.join(wrong)}. commonroad_parameters(2) shows a whole set, in SI units and radians."
        )
    return _selected(_CAR, given)


def commonroad_vehicle(source: Source) -> Vehicle:
    """The data sheet of a CommonRoad car, for the controller.

    Mass, yaw inertia, axle distances, tracks and outline are theirs, powers and forces follow from their largest
    acceleration. The cornering stiffness of a tyre is -p_ky1 F_z at its static load (their Magic Formula; K_y of
    Pacejka, *Tire and Vehicle Dynamics*, 3rd ed., eq. (4.E25), proportional to the load): roll, camber and compliance
    of the multi-body car are not in it. They say nothing of the air (the defaults of `Vehicle`) and of the lag of the
    steering (the profile's).

    Raises
    ------
    MissingExtra, UnknownName, ConfigError, StorageError
        As `commonroad_parameters`.
    """
    car = commonroad_parameters(source)
    where, given = _read(source)
    number = source if isinstance(source, int) else None
    loads = _loads(car)
    a_max = car["longitudinal"]["a_max"]
    outline = {"length": given.get("l"), "width": given.get("w")}
    return Vehicle(
        name=f"{PREFIX}{number}" if number else os.path.splitext(os.path.basename(where))[0],
        description=f"CommonRoad vehicle {number}, {CARS[number]}" if number else "a car with CommonRoad's parameters",
        mass=car["m"],
        yaw_inertia=car["I_z"],
        lf=car["a"],
        lr=car["b"],
        stiffness_front=-car["tire"]["p_ky1"] * loads[0],
        stiffness_rear=-car["tire"]["p_ky1"] * loads[1],
        track_front=car["T_f"],
        track_rear=car["T_r"],
        cg_height=car["h_s"],
        engine_power=car["m"] * a_max * car["longitudinal"]["v_switch"],
        traction_limit=car["m"] * a_max,
        brake_limit=car["m"] * a_max,
        drive_front=car["T_se"],
        brake_front=car["T_sb"],
        body=Body(**outline) if all(isinstance(value, float) for value in outline.values()) else None,
    )


def _loads(car: Mapping[str, Any]) -> tuple[float, float]:
    """Static load (N) of one front and one rear tyre."""
    each = 0.5 * car["m"] * 9.81 / (car["a"] + car["b"])
    return each * car["b"], each * car["a"]


@checked
def commonroad_plant(model: str, source: Source, air: Vehicle | None = None) -> UserPlant:
    """A CommonRoad model of a car as a plant.

    model: ``single-track-drift`` (8 states) or ``multi-body`` (28: theirs but the steering angle, which comes from the
    actuator); source: as in `commonroad_parameters`; air: whose drag, side force and yaw moment of the wind act, by
    default those of the data sheet. All four wheels have the mean friction.

    Raises
    ------
    UnknownName
        When there is no such model.
    MissingExtra
        When the compiler is not installed, or kernels are interpreted; else as `commonroad_parameters`.
    ConfigError, StorageError
        As `commonroad_parameters`.
    """
    if model not in MODELS:
        raise UnknownName(f"There is no CommonRoad model {model!r}. {did_you_mean(str(model), MODELS)}")
    if not compiles():
        raise MissingExtra("CommonRoad's models are compiled at run time: python -m pip install 'adaptrack[compile]'")
    car, sheet = commonroad_parameters(source), commonroad_vehicle(source)
    parameters = flattened({"car": car, "air": {name: getattr(air or sheet, name) for name in _AIR}})
    plant = UserPlant(
        _right_hand_side(model),
        parameters,
        mass=sheet.mass,
        own_states=kernel.DRIFT_STATES if model == MODELS[0] else kernel.MB_STATES,
        start=lambda motion: motion,  # replaced below: an equilibrium needs the plant's derivative
        steps=1,
        longest_step=_LONGEST_STEP[model],
        engine_power=sheet.engine_power,
        traction_limit=sheet.traction_limit,
        brake_limit=sheet.brake_limit,
        label=f"{PREFIX}{model}",
        tyres="CommonRoad",
        costly=True,
        version=metadata.version(DISTRIBUTION),
    )
    rough = _drift_rolling(car) if model == MODELS[0] else _mb_rolling(car)
    return dataclasses.replace(plant, start=_Rolling(plant, rough))


def plant_of_car(model: str, vehicle: Vehicle, tyre: Tyre | str | None = None) -> UserPlant:
    """The model of the CommonRoad car that has this data sheet, with the air of the sheet: what `get_plant` makes.

    Raises
    ------
    InvalidInput
        When the car is none of CommonRoad's, its body is another than theirs, or a tyre is given.
    """
    number = re.fullmatch(rf"{PREFIX}(\d+)", vehicle.name)
    if number is None:
        raise InvalidInput(
            f"plant {PREFIX}{model}: the car {vehicle.name!r} is none of CommonRoad's: take commonroad_vehicle(2), or "
            f"its file, {PREFIX}2.toml; commonroad_plant({model!r}, file) drives parameters of your own."
        )
    if tyre is not None:
        raise InvalidInput(f"plant {PREFIX}{model}: has CommonRoad's own tyres: leave the tyre out.")
    theirs = commonroad_vehicle(int(number[1]))
    for name in ("mass", "yaw_inertia", "lf", "lr"):
        if not math.isclose(getattr(vehicle, name), getattr(theirs, name), rel_tol=1e-9):
            raise InvalidInput(
                f"plant {PREFIX}{model}: the car's {name} = {getattr(vehicle, name)!r}, CommonRoad's vehicle "
                f"{number[1]} has {getattr(theirs, name)!r}: give the controller, not the plant, another car."
            )
    return commonroad_plant(model, int(number[1]), vehicle)


# -- parameters -------------------------------------------------------------------------------------------------------
def _read(source: Source) -> tuple[str, dict[str, Any]]:
    """How messages call a source, and its tables."""
    if isinstance(source, int):
        if isinstance(source, bool) or source not in CARS:
            raise UnknownName(
                f"there is no CommonRoad vehicle {source!r} with the parameters of both models. Known: "
                + ", ".join(f"{number} ({name})" for number, name in CARS.items())
            )
        return f"CommonRoad vehicle {source}", _shipped(source)
    if dataclasses.is_dataclass(source) and not isinstance(source, type):
        return "the parameters", dataclasses.asdict(source)
    if isinstance(source, Mapping):
        return "the parameters", dict(source)
    if isinstance(source, str | os.PathLike):
        return os.fspath(source), read_toml(source)
    raise InvalidInput(f"{source!r}: a CommonRoad car is given by its number (1, 2, 3), a TOML file or tables.")


@cache
def _shipped(number: int) -> dict[str, Any]:
    theirs = _package("vehicle_parameters")
    return dataclasses.asdict(theirs.setup_vehicle_parameters(number))


def _package(module: str) -> Any:
    """A module of commonroad-vehicle-models."""
    try:
        return importlib.import_module(f"{PACKAGE}.{module}")
    except ModuleNotFoundError:
        raise MissingExtra(f"CommonRoad's cars need {DISTRIBUTION}: python -m pip install {DISTRIBUTION}") from None


def _selected(wanted: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """The wanted parameters, in their order, as floats."""
    return {
        name: float(given[name]) if inner is None else _selected(inner, given[name]) for name, inner in wanted.items()
    }


@cache
def _right_hand_side(model: str) -> Callable[..., None]:
    """A model's right-hand side, the same for all cars."""
    tables = {"car": _CAR, "air": dict.fromkeys(_AIR)}
    names = list(flattened(tables))
    places = names.index("car.tire.p_dx1"), names.index("car.tire.p_dy1")
    if model == MODELS[0]:
        function, around = _package("vehicle_dynamics_std").vehicle_dynamics_std, kernel.drift_right_hand_side
    else:
        function, around = _package("vehicle_dynamics_mb").vehicle_dynamics_mb, kernel.mb_right_hand_side
    return around(function, layout_of(tables), places)


# -- rolling straight ahead -------------------------------------------------------------------------------------------
def _drift_rolling(car: dict[str, Any]) -> Callable[[Array], Array]:
    """Wheels that roll without slip, as CommonRoad's `init_std` has them."""
    return lambda motion: np.full(2, motion[3] / car["R_w"])


def _mb_rolling(car: dict[str, Any]) -> Callable[[Array], Array]:
    """Wheels that roll without slip under axles that carry the car's weight, as CommonRoad's `init_mb` has them."""
    weight = car["m_s"] * 9.81 / (car["a"] + car["b"])
    front = (weight * car["b"] + car["m_uf"] * 9.81) / (2.0 * car["K_zt"])
    rear = (weight * car["a"] + car["m_ur"] * 9.81) / (2.0 * car["K_zt"])

    def rough(motion: Array) -> Array:
        values = dict.fromkeys(kernel.MB_STATES, 0.0)
        values |= {"z_front": front, "z_rear": rear}
        values["vy_front"] = motion[4] + car["a"] * motion[5]
        values["vy_rear"] = motion[4] - car["b"] * motion[5]
        values |= dict.fromkeys([name for name in kernel.MB_STATES if name.startswith("wheel")], motion[3] / car["R_w"])
        return np.array(list(values.values()))

    return rough


class _Rolling:
    """Own states at the start: rough ones, and what straight driving at that speed differs from them.

    The tyres' shifts (p_hx1, p_vx1) let wheels roll with a little slip and pitch the body; the equilibrium is found by
    Newton's method over the states that move in a car that neither rolls nor slides: pitch, heights, wheel speeds.
    """

    def __init__(self, plant: UserPlant, rough: Callable[[Array], Array]) -> None:
        self.plant, self.rough = plant, rough
        self.beyond: Callable[[float], Array] = lru_cache(maxsize=4096)(self._beyond)
        self.moved, self.balanced = (_upright(plant.own_states, names) for names in (_POSITIONS, _RATES))

    def __call__(self, motion: Array) -> Array:
        return self.rough(motion) + self.beyond(float(motion[3]))

    def _beyond(self, speed: float) -> Array:
        motion = np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0])
        rough = self.rough(motion)
        change = np.zeros(len(self.moved))
        if speed < 1.0:
            return change @ self.moved

        def slope(change: Array) -> Array:
            own = rough + change @ self.moved
            return self.balanced @ self.plant.derivative(np.append(motion, own), [0.0, 0.0, 0.0], _DRY)[6:]

        for _ in range(20):
            error = slope(change)
            steps = _STEP * np.eye(len(change))
            jacobian = np.array([(slope(change + h) - slope(change - h)) / (2 * _STEP) for h in steps]).T
            correction = np.linalg.solve(jacobian, error)
            change -= correction
            if np.abs(correction).max() < 1e-12:
                break
        return change @ self.moved


_DRY = np.array([0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0])
_STEP = 1e-7


_POSITIONS = ("pitch", "z", "z_front", "z_rear")
_RATES = ("pitch_rate", "vz", "vz_front", "vz_rear")
"""Whose derivatives vanish when the positions are right."""


def _upright(states: tuple[str, ...], names: tuple[str, ...]) -> Array:
    """Rows that pick states by these names, and both wheels of an axle together: (rows, states)."""
    rows = [[name] for name in names if name in states]
    rows += [[name for name in states if name.startswith(f"wheel_speed_{axle}")] for axle in ("front", "rear")]
    return np.array([[float(name in row) for name in states] for row in rows])


for _model in MODELS:
    register_plant(f"{PREFIX}{_model}", partial(plant_of_car, _model))
