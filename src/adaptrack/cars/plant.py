"""Plants: what the controller drives. Two built-in vehicles, and a user's own.

A plant is a right-hand side and a parameter record. The state begins with (X, Y, yaw, v_x, v_y, yaw rate); signs
are those of ISO 8855 (x forward, y left, yaw and steering positive to the left); SI units, radians.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import numbers
import sys
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Annotated, Any, Self, final

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Bound, Count, Positive, checked, real, reals
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import MAX_STEPS, check_limit
from adaptrack.base.registry import Contract, PluginCall, Registry, compile_function
from adaptrack.cars.vehicle import SteeringActuator, Tyre, Vehicle, VehicleArgument, load_tyre, pack_plant
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.member import MemberFunction
from adaptrack.core.models.car import POWERTRAIN
from adaptrack.core.plants import dual_track, single_track
from adaptrack.core.plants.contract import PLANT_INPUT, PLANT_INPUTS, PLANT_STATES
from adaptrack.core.plants.user import compile_plant, layout_of
from adaptrack.core.synthesis import plant as kernel

MOTION_STATES = ("X", "Y", "psi", "vx", "vy", "yaw_rate")
"""The states that every plant begins with: m, m, rad, m/s, m/s, rad/s."""


class _AnyPlant:
    """Common part of all plants: names for tables, and what the driver needs to know."""

    takes_grade = False
    """Whether its equations read the grade of the road."""
    costly = False
    """Whether driving takes so long that searches and learning run on the car's twin (`twin_of`), and only what they
    found is judged on the plant."""

    @property
    def name(self) -> str:
        """How tables call the plant."""
        return type(self).__name__

    @property
    def tyre_name(self) -> str:
        """How tables call its tyres."""
        return "own"

    @property
    def powertrain(self) -> dict[str, float]:
        """mass (kg), engine_power (W), traction_limit and brake_limit (N): what the driver may ask for."""
        return {field.name: getattr(self, field.name) for field in POWERTRAIN}

    @property
    def axles(self) -> dict[str, float]:
        """Entries of a simulation's `LoopSettings`: the axles, for the driver, and the steady turn, for the start.

        They are geometry (m), shares of the front axle and gradients (rad s^2/m). An unknown car has equal axles
        without load transfer, and no gradients (NaN).
        """
        unknown = {
            "lf": 1.0, "lr": 1.0, "cg_height": 0.0, "drive_front": 0.5, "brake_front": 0.5,
            "understeer_gradient": math.nan, "rear_slip_gradient": math.nan,
        }  # fmt: skip
        vehicle = getattr(self, "vehicle", None)
        return unknown if vehicle is None else {name: getattr(vehicle, name) for name in unknown}


@dataclass(frozen=True)
class Plant(_AnyPlant, ABC):
    """A vehicle that can be driven: right-hand side, parameters, integration step.

    Subclasses are the two built-in vehicles and `UserPlant`; `check_plant` tells whether one keeps the contract.
    """

    @property
    @abstractmethod
    def state_names(self) -> tuple[str, ...]:
        """The plant's own states, beginning with `MOTION_STATES`."""

    @property
    @abstractmethod
    def compiled(self) -> Any:
        """Compiled form for the kernels (`core.plants.contract.CompiledPlant`)."""

    def initial_state(self, motion: ArrayLike) -> Array:
        """All states (n,) in equilibrium with the first six, X (m), Y (m), yaw (rad), v_x, v_y (m/s), yaw rate (rad/s).

        What is not said otherwise starts at zero.
        """
        state = np.zeros(len(self.state_names))
        state[: len(MOTION_STATES)] = _vector("motion", motion, len(MOTION_STATES))
        return state

    @abstractmethod
    def packed(self) -> Array:
        """The parameters as the kernels expect them, the steering actuator's included."""

    @abstractmethod
    def with_steering(self, steering: SteeringActuator) -> Self:
        """A copy behind another steering actuator."""

    @abstractmethod
    def substeps(self, period: float, top_speed: float) -> int:
        """Runge-Kutta steps per control period (s) that integrate it accurately up to a speed (m/s)."""

    @abstractmethod
    def derivative(self, x: ArrayLike, u: ArrayLike, environment: ArrayLike) -> Array:
        """dx/dt at state x (n,), input u (3,) and environment (8,).

        u: steering angle of the front wheels (rad), longitudinal force demanded at the wheels (N), prescribed dv_x/dt
        (m/s^2), NaN, as when it is left out, for none; environment: friction front-left, front-right, rear-left,
        rear-right; wind along X and Y (m/s); the pull of a banked road to the left (m/s^2) and the grade dz/ds of the
        road, 0 when they are left out. The actuators of steering, drive and brakes are not part of it.
        """


@dataclass(frozen=True)
class _Car(Plant):
    """Common part of the two built-in vehicles.

    vehicle: body, air, powertrain; tyre: a `Tyre`, or a name or file for `load_tyre`, by default the vehicle's;
    steering: the actuator, None for the profile's; steps: Runge-Kutta steps per control period, None for as many
    as accuracy asks (see `substeps`).
    """

    vehicle: Vehicle
    tyre: Tyre = field(default=None)  # type: ignore[assignment]
    steering: SteeringActuator | None = None
    steps: int | None = None

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        tyre: Tyre | str | None = None,
        steering: SteeringActuator | None = None,
        steps: Count | None = None,
    ) -> None:
        if tyre is None:
            tyre = vehicle.tyre
        object.__setattr__(self, "vehicle", vehicle)
        object.__setattr__(self, "tyre", tyre if isinstance(tyre, Tyre) else load_tyre(tyre))
        object.__setattr__(self, "steering", steering)
        object.__setattr__(self, "steps", steps)

    @property
    def tyre_name(self) -> str:
        return self.tyre.name

    @property
    def powertrain(self) -> dict[str, float]:
        return {field.name: getattr(self.vehicle, field.name) for field in POWERTRAIN}

    @property
    def _law(self) -> int:
        return int(kernel.plant_law(self.tyre.numbers))

    def packed(self) -> Array:
        return pack_plant(self.vehicle, self.tyre, self.steering or SteeringActuator.ideal())

    def with_steering(self, steering: SteeringActuator) -> Self:
        return type(self)(self.vehicle, self.tyre, steering, self.steps)

    @cached_property
    def _with_ideal_steering(self) -> Array:
        return pack_plant(self.vehicle, self.tyre, SteeringActuator.ideal())

    takes_grade = True
    relaxes = False
    """Whether its tyres build up their force over a relaxation length."""

    def substeps(self, period: float, top_speed: float) -> int:
        """Steps of at most 12.5 ms that keep every mode well inside the stability region (h |lambda| <= 2.2).

        The fast modes are the tyres' relaxation, v/sigma, and, without relaxation, the lateral and yaw motion at
        the lowest speed of the slip angles (1 m/s). What remains, against steps 20 times finer, is below 0.25 mm in
        the closed loops of the paper's tests; in open loop (`integration_step.py` in the benchmarks of commit c623557)
        steering that jumps on saturating tyres with a short relaxation length leaves up to 31 mm after 5 s.
        """
        if self.steps is not None:
            return self.steps
        return int(kernel.plant_substeps(self.vehicle.numbers, self.tyre.numbers, self.relaxes, period, top_speed))

    def derivative(self, x: ArrayLike, u: ArrayLike, environment: ArrayLike) -> Array:
        n = len(self.state_names)
        state = np.zeros(PLANT_STATES)
        state[:n] = _vector("x", x, n)
        inputs = np.zeros(PLANT_INPUTS)
        inputs[[PLANT_INPUT.command, PLANT_INPUT.force, PLANT_INPUT.acceleration]] = _input(u)
        inputs[PLANT_INPUT.brake] = max(-inputs[PLANT_INPUT.force], 0.0)
        inputs[PLANT_INPUT.friction_front_left : PLANT_INPUT.grade + 1] = _environment(environment)
        slope = np.empty(PLANT_STATES)
        self.compiled.right_hand_side(state, inputs, self._with_ideal_steering, slope)
        return slope[:n]


@final
class SingleTrack(_Car):
    """Single-track vehicle, eqs. (1)-(5): lateral and yaw motion on two axles of two tyres each.

    Loads are static, slip angles act at once; the tyre may be linear (eqs. 2, 6) or the Magic Formula.
    """

    name = "single-track"
    state_names = MOTION_STATES

    @property
    def compiled(self) -> Any:
        return single_track.compiled(self._law)


@final
class DualTrack(_Car):
    """Dual-track vehicle: longitudinal, lateral and yaw motion on four tyres.

    Longitudinal and lateral load transfer, relaxation length, friction wheel by wheel, friction ellipse.
    """

    relaxes = True
    name = "dual-track"
    state_names = (
        *MOTION_STATES, "slip_front_left", "slip_front_right", "slip_rear_left", "slip_rear_right",
        "felt_ax", "felt_ay",
    )  # fmt: skip

    @property
    def compiled(self) -> Any:
        return dual_track.compiled(self._law)


@final
@checked
@dataclass(frozen=True)
class UserPlant(Plant):
    """A plant of one's own: one right-hand side and its parameters.

    right_hand_side(x, u, environment, p, dx) writes dx/dt into dx and returns nothing. It is a
    `CFunction`, or Python: compiled with ``adaptrack[compile]``, else called back, with the same bits; it may use
    floats, loops, `math` and array elements. x: (n,) beginning with `MOTION_STATES`; u: steering angle of the front
    wheels (rad), longitudinal force requested of the wheels (N), prescribed dv_x/dt (m/s^2); environment: friction
    front-left, front-right, rear-left, rear-right, wind along X and Y (m/s), pull of a banked road to the left (m/s^2);
    p: `parameters` as an array, in their order, or, where they are nested, as a record (``p.tyre.shape``). It must not
    write to x, u, environment or p. `check_plant` admits it.

    While the speed is prescribed, u[2] is a number, u[1] is 0 and the loop sets dv_x/dt to u[2], whatever dx[3] holds:
    a plant with wheels or a suspension drives and pitches them with it. While a force acts, u[2] is NaN.

    Raises
    ------
    InvalidInput
        When a parameter is not finite.
    ContractError
        When the right-hand side cannot be compiled; the message states file, line and remedy.
    """

    right_hand_side: MemberFunction
    parameters: Mapping[str, Any]
    """numbers, or tables of them to any depth, as a TOML file has them"""
    mass: Annotated[Positive, "kg"]
    """with which the driver turns acceleration into force"""
    own_states: tuple[str, ...] = ()
    """names of the states behind `MOTION_STATES`"""
    start: Callable[[Array], Any] | None = None
    """start(motion) -> the own states in equilibrium with the first six, such as speeds of rolling wheels; None: 0"""
    steps: Count = 20
    """Runge-Kutta steps per control period, at least"""
    longest_step: Annotated[Bound, "s"] = math.inf
    """longest integration step: in a longer control period there are as many more of them"""
    engine_power: Annotated[Positive, "W"] = 1e5
    traction_limit: Annotated[Positive, "N"] = 8000.0
    brake_limit: Annotated[Positive, "N"] = 15000.0
    steering: SteeringActuator | None = None
    label: str = "user"
    tyres: str = "own"
    costly: bool = False
    """as `Plant.costly`"""
    version: str = ""
    """of what else its motion depends on, such as a package: for the identity of what is tuned on it"""
    takes_grade: bool = False
    """whether the right-hand side reads the grade dz/ds of the road, positive uphill, as the eighth of environment"""
    vehicle: Vehicle | None = None
    """the data sheet of this car: its failure distance, and in environments the planned speed and the MPC"""

    def __post_init__(self) -> None:
        values, where = flattened(self.parameters), f"UserPlant {self.label!r}"
        invalid_values = [
            f"{key} = {value!r}" for key, value in values.items()
            if not (isinstance(value, numbers.Real) and math.isfinite(value))
        ]  # fmt: skip
        if invalid_values:
            raise InvalidInput(f"{where}: parameters must be finite numbers: {', '.join(invalid_values)}.")
        nested = any(isinstance(value, Mapping) for value in self.parameters.values())
        compiled = compile_function(
            where, lambda function: compile_plant(function, layout_of(self.parameters) if nested else None),
            self.right_hand_side, "right-hand side as f(x, u, environment, p, dx) on float64 arrays",
        )  # fmt: skip
        object.__setattr__(self, "_compiled", compiled)
        object.__setattr__(self, "_own", np.array(list(values.values()), dtype=float))

    @property
    def name(self) -> str:
        return self.label

    @property
    def tyre_name(self) -> str:
        return self.tyres

    @property
    def state_names(self) -> tuple[str, ...]:
        return (*MOTION_STATES, *self.own_states)

    @property
    def compiled(self) -> Any:
        return self._compiled  # type: ignore[attr-defined]

    def initial_state(self, motion: ArrayLike) -> Array:
        state = super().initial_state(motion)
        if self.start is not None:
            own_states = np.asarray(self.start(state[: len(MOTION_STATES)].copy()), dtype=np.float64)
            where = f"UserPlant {self.label!r}: start"
            state[len(MOTION_STATES) :] = _vector(where, own_states, len(self.own_states))
        return state

    def packed(self) -> Array:
        steering = self.steering or SteeringActuator.ideal()
        steering_row = (steering.lag, steering.rate, steering.limit, float(self.takes_grade))
        return np.array([*steering_row, *self._own])  # type: ignore[attr-defined]

    def with_steering(self, steering: SteeringActuator) -> Self:
        return replace(self, steering=steering)

    def substeps(self, period: float, top_speed: float) -> int:
        return max(self.steps, steps_in(period, self))

    def derivative(self, x: ArrayLike, u: ArrayLike, environment: ArrayLike) -> Array:
        n = len(self.state_names)
        slope = np.full(n, np.nan)
        # not copies: what the function writes to its arguments must be visible to `check_plant`
        state, inputs, around = _vector("x", x, n), _input(u), _environment(environment)[: 8 if self.takes_grade else 7]
        self.compiled.right_hand_side(state, inputs, around, self._own, slope)  # type: ignore[attr-defined]
        if math.isfinite(inputs[2]):
            slope[3] = inputs[2]
        return slope


class SteppedPlant(_AnyPlant, ABC):
    """A vehicle in Python that is moved step by step: any outside simulator. `simulate` drives it as it drives ours.

    The loop's steering actuator (the profile's, or `steering`) stands before it; compiled runs cannot take it.
    """

    steering: SteeringActuator | None = None
    """None for the profile's"""
    vehicle: Vehicle | None = None
    """as `UserPlant.vehicle`"""
    costly = True
    takes_grade: bool = False
    """whether `step` reads the grade dz/ds of the road, positive uphill, as an eighth entry of environment"""
    longest_step: float = 0.02
    """s, the loop never asks for a longer one"""
    mass: float = 1500.0
    """kg, with which a driver turns force into acceleration; likewise the following three (W, N, N)"""
    engine_power: float = 1e5
    traction_limit: float = 8000.0
    brake_limit: float = 15000.0

    @abstractmethod
    def reset(self, motion: Array) -> None:
        """Begin at X (m), Y (m), yaw (rad), v_x, v_y (m/s, body frame), yaw rate (rad/s), all else in equilibrium."""

    @abstractmethod
    def step(self, dt: float, steering: float, acceleration: float, environment: Array) -> Any:
        """Advance by dt (s) under inputs that are held; the new motion (6,), as in `reset`.

        steering: front-wheel angle (rad); acceleration: dv_x/dt that the speed control asks for (m/s^2); environment:
        friction front-left, front-right, rear-left, rear-right; wind along X and Y (m/s); pull of a banked road to the
        left (m/s^2).
        """


def steps_in(period: float, plant: UserPlant | SteppedPlant) -> int:
    """Equal integration steps of a control period (s), none longer than the plant's `longest_step`.

    Raises InvalidInput when that is no positive number, or they are more than `limits.MAX_STEPS`.
    """
    where = f"Plant {plant.name!r}"
    longest = real(where, "longest_step", plant.longest_step)
    if not longest > 0.0:
        raise InvalidInput(f"{where}: longest_step = {longest!r} s: must be positive.")
    steps = float(period) / longest
    check_limit(f"{where}: longest_step = {longest:g} s: steps in a control period of {period:g} s", steps, MAX_STEPS)
    return max(1, math.ceil(steps - 1e-9))


def _vector(name: str, values: ArrayLike, size: int) -> Array:
    """C-contiguous float64, as the kernels take it; the given array itself where it is that already."""
    array = np.ascontiguousarray(reals(name, values))
    if array.shape != (size,):
        raise InvalidInput(f"{name}: shape {array.shape}, expected ({size},).")
    return array


def flattened(parameters: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested parameters as one table: ``{"tyre": {"shape": 1.3}}`` as ``{"tyre.shape": 1.3}``."""
    entries: dict[str, Any] = {}
    for name, value in parameters.items():
        inner = flattened(value, f"{before}{name}.") if isinstance(value, Mapping) else {f"{before}{name}": value}
        entries |= inner
    return entries


def _input(values: ArrayLike) -> Array:
    """(3,); without a prescribed acceleration the force acts."""
    array = reals("u", values)
    return _vector("u", np.append(array, math.nan) if array.shape == (2,) else array, 3)


def _environment(values: ArrayLike) -> Array:
    """(8,); bank and grade that are left out are 0."""
    array = reals("environment", values)
    return _vector("environment", np.append(array, np.zeros(8 - array.size)) if array.size in (6, 7) else array, 8)


@checked
def check_plant(
    plant: Plant | SteppedPlant,
    speeds: Sequence[float] = (5.0, 15.0, 25.0),
    symmetric: bool = True,
    period: Annotated[Positive, "s"] = 0.1,
) -> None:
    """Test that a plant keeps the contract on which controllers and the loop rely.

    At each speed (m/s), on dry friction without wind: the states begin with `MOTION_STATES`; the right-hand side writes
    every entry, finite, without touching its arguments, and answers twice alike, under a force and under a prescribed
    acceleration; position and yaw obey kinematics, eq. (5); at zero steering the vehicle goes straight; steering to the
    left begins a turn to the left; mirrored steering gives the mirrored motion (unless `symmetric` is False: a car may
    be lopsided); one second of integration in control periods of `period` (s), at its own step, stays finite and near
    that of half the step.

    Raises
    ------
    ContractError
        Naming the clause that is broken, the evidence and, where there is one, the option that changes the test.
    """
    require = Contract(f"Plant {plant.name!r}").require
    if isinstance(plant, SteppedPlant):
        _check_stepped(plant, speeds, symmetric, period, require)
        return
    names, packed = plant.state_names, plant.packed()
    require(names[:6] == MOTION_STATES, f"its states must begin with {MOTION_STATES}", f"they are {names}")
    is_row = packed.ndim == 1 and not np.isnan(packed).any()
    require(is_row, "packed() must give one row of finite parameters", f"it gives {packed!r}")
    for speed in speeds:
        straight = plant.initial_state([0.0, 0.0, 0.0, speed, 0.0, 0.0])
        is_start = np.isfinite(straight).all() and straight[3] == speed
        evidence = f"{straight} at {speed} m/s"
        require(is_start, "initial_state() must be finite and begin with the motion given", evidence)
        _check_derivative(plant, straight, require)
        _check_driving(plant, straight, symmetric, period, require)


_DRY = np.array([0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0])
"""The environment of the checker: friction, wind, bank."""
_LOPSIDED = "a car that is lopsided on purpose passes with check_plant(..., symmetric=False)"


def _check_derivative(plant: Plant, straight: Array, require: Callable[..., None]) -> None:
    """The derivative straight ahead, in a turn under a force, and in a turn under a prescribed acceleration."""
    turning = straight.copy()
    turning[:6] = 3.0, -2.0, 0.1, straight[3], 0.1, 0.05
    place = f"at {straight[3]} m/s"
    for x, u in ((straight, [0.0, 0.0, math.nan]), (turning, [0.02, 300.0, math.nan]), (turning, [0.02, 0.0, 0.5])):
        arguments = [np.array(values, dtype=float) for values in (x, u, _DRY)]
        copies = [values.copy() for values in arguments]
        parameters = plant.packed()
        slope = plant.derivative(*arguments)
        missing = [name for name, value in zip(plant.state_names, slope, strict=True) if not np.isfinite(value)]
        under = "under a prescribed acceleration, u[2]" if math.isfinite(u[2]) else "under a force, u[2] being NaN"
        require(not missing, "every derivative must be written and finite", f"not so for {missing} {place} {under}")
        pairs = zip([*arguments, plant.packed()], [*copies, parameters], strict=True)
        unchanged = all(np.array_equal(a, b, equal_nan=True) for a, b in pairs)
        require(unchanged, "x, u, environment and p must not be written to", place)
        again = plant.derivative(*arguments)
        require((again == slope).all(), "the same arguments must give the same derivative", place)
        expected = (
            x[3] * portable.cos(x[2]) - x[4] * portable.sin(x[2]),
            x[3] * portable.sin(x[2]) + x[4] * portable.cos(x[2]),
            x[5],
        )
        obeys = np.allclose(slope[:3], expected, rtol=1e-6, atol=1e-9)
        evidence = f"{slope[:3]} instead of {expected} {place}"
        require(obeys, "position and yaw must obey kinematics, eq. (5)", evidence)


def _check_driving(
    plant: Plant, straight: Array, symmetric: bool, period: float, require: Callable[..., None]
) -> None:  # fmt: skip
    """A second of driving, straight ahead and under constant steering."""
    place = f"at {straight[3]} m/s"
    goes_straight = np.abs(plant.derivative(straight, [0.0, 0.0], _DRY)[4:6]).max() <= 1e-6 or not symmetric
    require(goes_straight, "at zero steering the vehicle must go straight", place, _LOPSIDED)
    left = _settled(plant, straight, 0.01, period, 0.05, refine=8)  # however long its own steps are
    turns_left = plant.derivative(left, [0.01, 0.0], _DRY)[5] > 0.0
    require(turns_left, "steering to the left (positive) must begin a turn to the left (positive yaw rate)", place)
    coarse, fine = (_settled(plant, straight, 0.02, period, 1.0, refine) for refine in (1, 2))
    if symmetric:
        right = _settled(plant, straight, -0.02, period, 1.0)
        mirrors = np.allclose(coarse[[0, 1, 2, 4, 5]] * [1, -1, -1, -1, -1], right[[0, 1, 2, 4, 5]], atol=1e-7)
        evidence = f"{coarse[:6]} and {right[:6]} {place}"
        require(mirrors, "the mirrored steering must give the mirrored motion", evidence, _LOPSIDED)
    is_accurate = np.isfinite(coarse).all() and np.allclose(coarse[:6], fine[:6], rtol=1e-3, atol=1e-3)
    require(
        is_accurate, "its steps must be small enough to integrate it",
        f"{coarse[:6]}, with half the step {fine[:6]} {place}, {plant.substeps(period, straight[3])} steps in a "
        f"control period of {period:g} s",
        "a UserPlant takes shorter ones with steps= or longest_step=, a shorter control period is tested with "
        "check_plant(..., period=)",
    )  # fmt: skip


def _settled(plant: Plant, x: Array, steering: float, period: float, duration: float, refine: int = 1) -> Array:
    """The state after `duration` (s) of constant steering, by RK4 at the plant's own step over `refine`."""
    h = period / (plant.substeps(period, x[3]) * refine)
    u = np.array([steering, 0.0, math.nan])
    for _ in range(max(1, round(duration / h))):
        k1 = plant.derivative(x, u, _DRY)
        k2 = plant.derivative(x + 0.5 * h * k1, u, _DRY)
        k3 = plant.derivative(x + 0.5 * h * k2, u, _DRY)
        k4 = plant.derivative(x + h * k3, u, _DRY)
        x = x + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def _check_stepped(
    plant: SteppedPlant, speeds: Sequence[float], symmetric: bool, period: float, require: Callable[..., None]
) -> None:
    """`check_plant` for a plant that is stepped: one second of driving, straight and under constant steering."""
    dt = period / steps_in(period, plant)
    call = PluginCall(f"Plant {plant.name!r}: step()", "six finite numbers")

    def drive_one_second(speed: float, steering: float) -> Array:
        plant.reset(np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0]))
        for _ in range(max(1, round(1.0 / dt))):
            environment = _DRY.copy()
            motion = np.asarray(call(plant.step, dt, steering, 0.0, environment), dtype=np.float64)
            is_motion = motion.shape == (6,) and np.isfinite(motion).all()
            require(is_motion, "step() must return six finite numbers", f"it returned {motion!r} at {speed} m/s")
            require((environment == _DRY).all(), "step() must not write to its arguments", f"at {speed} m/s")
        return motion

    for speed in speeds:
        place = f"at {speed} m/s"
        straight, left, right = (drive_one_second(speed, angle) for angle in (0.0, 0.02, -0.02))
        goes_straight = abs(straight[[1, 2, 4, 5]]).max() <= 1e-6 or not symmetric
        require(goes_straight, "at zero steering the vehicle must go straight", f"{straight} {place}", _LOPSIDED)
        follows = abs(straight[0] - speed) < 0.2 * speed
        require(follows, "position must follow the speed", f"X = {straight[0]:g} m after 1 s {place}")
        evidence = f"yaw {left[2]:g} rad {place}"
        require(left[2] > 0.0, "steering to the left (positive) must begin a turn to the left", evidence)
        mirrors = np.allclose(left * [1, -1, -1, 1, -1, -1], right, atol=1e-6) or not symmetric
        evidence = f"{left} and {right} {place}"
        require(mirrors, "the mirrored steering must give the mirrored motion", evidence, _LOPSIDED)
        repeats = (drive_one_second(speed, 0.02) == left).all()
        require(repeats, "after reset() the same steps must give the same motion", place)


def twin_of(car: Vehicle) -> DualTrack:
    """A built-in plant with the numbers that a controller knows of a car; tyres of that stiffness, with its grip.

    What searches and linear analysis use in place of a plant that is `costly` or has no linear model.
    """
    tyre = Tyre(
        name="as known", kind="magic-formula", stiffness_front=car.stiffness_front, stiffness_rear=car.stiffness_rear,
        nominal_load=max(car.static_loads),
    )  # fmt: skip
    return DualTrack(car, tyre)


def fingerprint(plant: Plant | SteppedPlant) -> str:
    """SHA-256 of what a plant's motion depends on, as far as this process can tell: results of another are not mixed.

    Its numbers, and the source of the module that its right-hand side or its class is defined in. What a stepped plant
    asks of another process, of a library or of its own state is not part of it.
    """
    equations = getattr(plant, "right_hand_side", type(plant))
    module = sys.modules.get(equations.__module__)
    try:
        source = inspect.getsource(module) if module is not None else ""
    except (OSError, TypeError):  # typed in at a prompt
        code = getattr(equations, "__code__", None)
        source = equations.__qualname__ if code is None else repr((code.co_code, code.co_names))
    numbers = plant.packed().tolist() if isinstance(plant, Plant) else []
    attributes = [repr(getattr(plant, name, None)) for name in ("steps", "longest_step", "version", "steering")]
    parts = [plant.name, plant.tyre_name, plant.powertrain, numbers, attributes, source]
    return hashlib.sha256(json.dumps(parts).encode()).hexdigest()


_registry: Registry[Plant | SteppedPlant] = Registry(
    "plant", "register_plant", {"single-track": SingleTrack, "dual-track": DualTrack}, ("vehicle", "tyre"),
    Plant | SteppedPlant,
)  # fmt: skip


list_plants = _registry.names


@checked
def register_plant(name: str, factory: Callable[..., Plant | SteppedPlant] | str) -> None:
    """Make ``get_plant(name, vehicle, tyre)`` call ``factory(vehicle, tyre)``.

    tyre: a `Tyre`, its name or file, or None for the vehicle's own.

    Raises `InvalidInput` for a name that is taken or empty, and a factory that is neither callable nor a text
    ``"package.module:name"``, or takes other arguments.
    """
    _registry.add(name, factory)


@checked
def get_plant(name: str, vehicle: Vehicle, tyre: Tyre | str | None = None) -> Plant | SteppedPlant:
    """A registered plant of a vehicle on a tyre, by default the vehicle's own.

    Raises
    ------
    UnknownName
        When no plant has this name.
    """
    return _registry.make(name, vehicle, tyre)
