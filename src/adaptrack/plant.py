"""Plants: what the controller drives. Two built-in vehicles, and a user's own.

A plant is a right-hand side and a parameter record. The state begins with (X, Y, yaw, v_x, v_y, yaw rate); signs
are those of ISO 8855 (x forward, y left, yaw and steering positive to the left); SI units, radians.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self, final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import ContractError, InvalidInput, real, whole
from adaptrack.registry import Registry
from adaptrack.vehicle import SteeringActuator, Tyre, Vehicle, load_tyre, pack_plant

Array = NDArray[np.float64]

MOTION = ("X", "Y", "psi", "vx", "vy", "yaw_rate")
"""The states that every plant begins with: m, m, rad, m/s, m/s, rad/s."""


@dataclass(frozen=True)
class Plant(ABC):
    """A vehicle that can be driven: right-hand side, parameters, integration step.

    Subclasses are the two built-in vehicles and `UserPlant`; `check_plant` tells whether one keeps the contract.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """How tables call the plant."""

    @property
    @abstractmethod
    def tyre_name(self) -> str:
        """How tables call its tyres."""

    @property
    @abstractmethod
    def state_names(self) -> tuple[str, ...]:
        """The plant's own states, beginning with `MOTION`."""

    @property
    @abstractmethod
    def powertrain(self) -> dict[str, float]:
        """mass (kg), engine_power (W), traction_limit and brake_limit (N): what the driver may ask for."""

    @property
    @abstractmethod
    def compiled(self) -> Any:
        """What the kernels call (`kernels.plants.contract.CompiledPlant`)."""

    def initial_state(self, motion: ArrayLike) -> Array:
        """All states (n,) in equilibrium with the first six, X (m), Y (m), yaw (rad), v_x, v_y (m/s), yaw rate (rad/s).

        What is not said otherwise starts at zero.
        """
        state = np.zeros(len(self.state_names))
        state[: len(MOTION)] = _vector("motion", motion, len(MOTION))
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
        """dx/dt at state x (n,), input u (steering angle, longitudinal force) and environment (7,).

        environment: friction front-left, front-right, rear-left, rear-right; wind along X and Y (m/s); the pull of a
        banked road to the left (m/s^2), 0 when it is left out.
        The steering actuator and the prescribed speed are not part of it.
        """


@dataclass(frozen=True)
class _Car(Plant):
    """What the two built-in vehicles share.

    vehicle: body, air, powertrain; tyre: a `Tyre`, or a name or file for `load_tyre`, by default the vehicle's;
    steering: the actuator, None for the profile's; steps: Runge-Kutta steps per control period, None for as many
    as accuracy asks (see `substeps`).
    """

    vehicle: Vehicle
    tyre: Tyre = field(default=None)  # type: ignore[assignment]
    steering: SteeringActuator | None = None
    steps: int | None = None

    def __init__(
        self,
        vehicle: Vehicle,
        tyre: Tyre | str | None = None,
        steering: SteeringActuator | None = None,
        steps: int | None = None,
    ) -> None:
        if tyre is None:
            tyre = vehicle.tyre
        object.__setattr__(self, "vehicle", vehicle)
        object.__setattr__(self, "tyre", tyre if isinstance(tyre, Tyre) else load_tyre(tyre))
        object.__setattr__(self, "steering", steering)
        object.__setattr__(self, "steps", steps)
        if steps is not None and not (isinstance(steps, int) and steps >= 1):
            raise InvalidInput(f"steps = {steps!r}: must be a positive integer, or None to have it chosen.")

    @property
    def tyre_name(self) -> str:
        return self.tyre.name

    @property
    def powertrain(self) -> dict[str, float]:
        return {key: getattr(self.vehicle, key) for key in ("mass", "engine_power", "traction_limit", "brake_limit")}

    @property
    def _law(self) -> int:
        from adaptrack.kernels.plants.tyre import tyre_law

        return tyre_law(self.tyre.kind == "linear", self.tyre.curvature)

    def packed(self) -> Array:
        return pack_plant(self.vehicle, self.tyre, self.steering or SteeringActuator.ideal())

    def with_steering(self, steering: SteeringActuator) -> Self:
        return type(self)(self.vehicle, self.tyre, steering, self.steps)

    @property
    def _relaxation(self) -> float:
        return 0.0

    def substeps(self, period: float, top_speed: float) -> int:
        """Steps of at most 12.5 ms that keep every mode well inside the stability region (h |lambda| <= 2.2).

        The fast modes are the tyres' relaxation, v/sigma, and, without relaxation, the lateral and yaw motion at
        the lowest speed of the slip angles (1 m/s). What remains, against steps 20 times finer, is below 0.25 mm in
        the closed loops of the paper's tests; `benchmarks/integration_step.py` measures it open loop, where
        steering that jumps on saturating tyres with a short relaxation length leaves up to 31 mm after 5 s.
        """
        if self.steps is not None:
            return self.steps
        car, tyre = self.vehicle, self.tyre
        if self._relaxation > 0.0:
            rate = max(top_speed, 1.0) / self._relaxation
        else:
            front, rear = (2.0 * c for c in tyre.stiffness_at(*car.static_loads))
            rate = max((front + rear) / car.mass, (front * car.lf**2 + rear * car.lr**2) / car.yaw_inertia)
        return max(1, math.ceil(period / 0.0125 - 1e-9), math.ceil(period * rate / 2.2 - 1e-9))

    def derivative(self, x: ArrayLike, u: ArrayLike, environment: ArrayLike) -> Array:
        from adaptrack.kernels.plants.contract import INPUT, INPUTS, STATES

        n = len(self.state_names)
        state = np.zeros(STATES)
        state[:n] = _vector("x", x, n)
        steering, force = _vector("u", u, 2)
        inputs = np.zeros(INPUTS)
        inputs[INPUT.command], inputs[INPUT.force], inputs[INPUT.acceleration] = steering, force, math.nan
        inputs[INPUT.friction_front_left :] = _environment(environment)
        slope = np.empty(STATES)
        packed = self.with_steering(SteeringActuator.ideal()).packed()
        self.compiled.right_hand_side(state, inputs, packed, slope)
        return slope[:n]


@final
class SingleTrack(_Car):
    """Single-track vehicle, eqs. (1)-(5): lateral and yaw motion on two axles of two tyres each.

    Loads are static, slip angles act at once; the tyre may be linear (eqs. 2, 6) or the Magic Formula.
    """

    @property
    def name(self) -> str:
        return "single-track"

    @property
    def compiled(self) -> Any:
        from adaptrack.kernels.plants import single_track

        return single_track.compiled(self._law)

    @property
    def state_names(self) -> tuple[str, ...]:
        return MOTION


@final
class DualTrack(_Car):
    """Dual-track vehicle: longitudinal, lateral and yaw motion on four tyres.

    Longitudinal and lateral load transfer, relaxation length, friction wheel by wheel, friction ellipse.
    """

    @property
    def name(self) -> str:
        return "dual-track"

    @property
    def compiled(self) -> Any:
        from adaptrack.kernels.plants import dual_track

        return dual_track.compiled(self._law)

    @property
    def state_names(self) -> tuple[str, ...]:
        slips = tuple(f"slip_{wheel}" for wheel in ("front_left", "front_right", "rear_left", "rear_right"))
        return (*MOTION, *slips, "felt_ax", "felt_ay")

    @property
    def _relaxation(self) -> float:
        return self.tyre.relaxation_length


@final
@dataclass(frozen=True)
class UserPlant(Plant):
    """A plant of one's own: one right-hand side and its parameters.

    right_hand_side(x, u, environment, p, dx) writes dx/dt into dx and returns nothing; it is compiled by numba, so
    it may use floats, loops, `math` and array elements. x: (n,) beginning with `MOTION`; u: steering angle of the
    front wheels (rad), longitudinal force asked of the wheels (N); environment: friction front-left, front-right,
    rear-left, rear-right, wind along X and Y (m/s), pull of a banked road to the left (m/s^2); p: `parameters` as an
    array, in their order. It must not write to x, u, environment or p. `check_plant` admits it.
    """

    right_hand_side: Callable[..., None]
    parameters: dict[str, float]
    mass: float
    """kg, with which the driver turns acceleration into force"""
    own_states: tuple[str, ...] = ()
    """names of the states behind `MOTION`"""
    start: Callable[[Array], Any] | None = None
    """start(motion) -> the own states in equilibrium with the first six, such as speeds of rolling wheels; None: 0"""
    steps: int = 20
    """Runge-Kutta steps per control period"""
    engine_power: float = 1e5
    """W"""
    traction_limit: float = 8000.0
    """N"""
    brake_limit: float = 15000.0
    """N"""
    steering: SteeringActuator | None = None
    label: str = "user"
    tyres: str = "own"

    def __post_init__(self) -> None:
        from adaptrack.kernels.plants.user import compile_plant

        bad = [f"{key} = {value!r}" for key, value in self.parameters.items() if not math.isfinite(value)]
        if bad:
            raise InvalidInput(f"UserPlant {self.label!r}: parameters must be finite numbers: {', '.join(bad)}.")
        whole(f"UserPlant {self.label!r}", "steps", self.steps)
        for name, value in self.powertrain.items():
            if not 0.0 < real(f"UserPlant {self.label!r}", name, value) < math.inf:
                raise InvalidInput(f"UserPlant {self.label!r}: {name} = {value!r}: must be positive and finite.")
        try:
            compiled = compile_plant(self.right_hand_side)
        except Exception as error:
            raise ContractError(
                f"UserPlant {self.label!r}: numba cannot compile its right-hand side as "
                f"f(x, u, environment, p, dx) on float64 arrays: {error}"
            ) from error
        object.__setattr__(self, "_compiled", compiled)
        object.__setattr__(self, "_own", np.array(list(self.parameters.values()), dtype=float))

    @property
    def name(self) -> str:
        return self.label

    @property
    def tyre_name(self) -> str:
        return self.tyres

    @property
    def state_names(self) -> tuple[str, ...]:
        return (*MOTION, *self.own_states)

    @property
    def powertrain(self) -> dict[str, float]:
        return {key: getattr(self, key) for key in ("mass", "engine_power", "traction_limit", "brake_limit")}

    @property
    def compiled(self) -> Any:
        return self._compiled  # type: ignore[attr-defined]

    def initial_state(self, motion: ArrayLike) -> Array:
        state = super().initial_state(motion)
        if self.start is not None:
            own = np.asarray(self.start(state[: len(MOTION)].copy()), dtype=np.float64)
            where = f"UserPlant {self.label!r}: start"
            state[len(MOTION) :] = _vector(where, own, len(self.own_states))
        return state

    def packed(self) -> Array:
        steering = self.steering or SteeringActuator.ideal()
        return np.array([steering.lag, steering.rate, steering.limit, *self._own])  # type: ignore[attr-defined]

    def with_steering(self, steering: SteeringActuator) -> Self:
        return replace(self, steering=steering)

    def substeps(self, period: float, top_speed: float) -> int:
        return self.steps

    def derivative(self, x: ArrayLike, u: ArrayLike, environment: ArrayLike) -> Array:
        n = len(self.state_names)
        slope = np.full(n, np.nan)
        # not copies: what the function writes to its arguments must be seen by `check_plant`
        state, inputs, around = _vector("x", x, n), _vector("u", u, 2), _environment(environment)
        self.compiled.right_hand_side(state, inputs, around, self._own, slope)  # type: ignore[attr-defined]
        return slope


class SteppedPlant(ABC):
    """A vehicle in Python that moves by being told to: any outside simulator. `simulate` drives it as it drives ours.

    The loop's steering actuator (the profile's, or `steering`) stands before it; compiled runs cannot take it.
    """

    steering: SteeringActuator | None = None
    """None for the profile's"""
    longest_step: float = 0.02
    """s, the loop never asks for a longer one"""
    mass: float = 1500.0
    """kg, with which a driver turns force into acceleration; likewise the following three (W, N, N)"""
    engine_power: float = 1e5
    traction_limit: float = 8000.0
    brake_limit: float = 15000.0

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
        return {key: getattr(self, key) for key in ("mass", "engine_power", "traction_limit", "brake_limit")}

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


def _vector(name: str, values: ArrayLike, size: int) -> Array:
    """C-contiguous float64, as the kernels take it; the given array itself where it is that already."""
    array = np.ascontiguousarray(values, dtype=np.float64)
    if array.shape != (size,):
        raise InvalidInput(f"{name}: shape {array.shape}, expected ({size},).")
    return array


def _environment(values: ArrayLike) -> Array:
    """(7,); a bank that is left out is none."""
    given = np.asarray(values, dtype=np.float64)
    return _vector("environment", np.append(given, 0.0) if given.shape == (6,) else given, 7)


def check_plant(
    plant: Plant | SteppedPlant, speeds: Sequence[float] = (5.0, 15.0, 25.0), symmetric: bool = True
) -> None:
    """Test that a plant keeps the contract on which controllers and the loop rely.

    At each speed (m/s), on dry friction without wind: the states begin with `MOTION`; the right-hand side writes
    every entry, finite, without touching its arguments, and answers twice alike; position and yaw obey kinematics,
    eq. (5); at zero steering the vehicle goes straight; steering to the left begins a turn to the left; mirrored
    steering gives the mirrored motion (unless `symmetric` is False: a car may be lopsided); one second of
    integration at its own step stays finite and near that of half the step.

    Raises
    ------
    ContractError
        Naming the clause that is broken and the evidence.
    """

    if isinstance(plant, SteppedPlant):
        _check_stepped(plant, speeds, symmetric)
        return

    def fail(clause: str, evidence: str) -> None:
        raise ContractError(f"Plant {plant.name!r}: {clause}: {evidence}.")

    if plant.state_names[:6] != MOTION:
        fail(f"its states must begin with {MOTION}", f"they are {plant.state_names}")
    if plant.packed().ndim != 1 or np.isnan(plant.packed()).any():
        fail("packed() must give one row of finite parameters", f"it gives {plant.packed()!r}")
    road = np.array([0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0])
    for speed in speeds:
        straight = plant.initial_state([0.0, 0.0, 0.0, speed, 0.0, 0.0])
        if not np.isfinite(straight).all() or straight[3] != speed:
            fail("initial_state() must be finite and begin with the motion given", f"{straight} at {speed} m/s")
        turning = straight.copy()
        turning[:6] = 3.0, -2.0, 0.1, speed, 0.1, 0.05
        here = f"at {speed} m/s"
        for x, u in ((straight, [0.0, 0.0]), (turning, [0.02, 300.0])):
            given = [np.array(values, dtype=float) for values in (x, u, road)]
            kept = [values.copy() for values in given]
            parameters = plant.packed()
            slope = plant.derivative(*given)
            if not np.isfinite(slope).all():
                missing = [name for name, value in zip(plant.state_names, slope, strict=True) if not np.isfinite(value)]
                fail("every derivative must be written and finite", f"not so for {missing} {here}")
            if any((a != b).any() for a, b in zip([*given, plant.packed()], [*kept, parameters], strict=True)):
                fail("x, u, environment and p must not be written to", here)
            if (plant.derivative(*given) != slope).any():
                fail("the same arguments must give the same derivative", here)
            expected = (
                x[3] * math.cos(x[2]) - x[4] * math.sin(x[2]),
                x[3] * math.sin(x[2]) + x[4] * math.cos(x[2]),
                x[5],
            )
            if not np.allclose(slope[:3], expected, rtol=1e-6, atol=1e-9):
                fail("position and yaw must obey kinematics, eq. (5)", f"{slope[:3]} instead of {expected} {here}")
        if np.abs(plant.derivative(straight, [0.0, 0.0], road)[4:6]).max() > 1e-6 and symmetric:
            fail("at zero steering the vehicle must go straight", here)
        if not plant.derivative(_settled(plant, straight, 0.01, road, 0.05), [0.01, 0.0], road)[5] > 0.0:
            fail("steering to the left (positive) must begin a turn to the left (positive yaw rate)", here)
        if symmetric:
            left = _settled(plant, straight, 0.02, road, 1.0)
            right = _settled(plant, straight, -0.02, road, 1.0)
            if not np.allclose(left[[0, 1, 2, 4, 5]] * [1, -1, -1, -1, -1], right[[0, 1, 2, 4, 5]], atol=1e-7):
                fail("the mirrored steering must give the mirrored motion", f"{left[:6]} and {right[:6]} {here}")
        coarse = _settled(plant, straight, 0.02, road, 1.0)
        fine = _settled(plant, straight, 0.02, road, 1.0, refine=2)
        if not np.isfinite(coarse).all() or not np.allclose(coarse[:6], fine[:6], rtol=1e-3, atol=1e-3):
            fail(
                "its steps must be small enough to integrate it", f"{coarse[:6]}, with half the step {fine[:6]} {here}"
            )


def _settled(plant: Plant, x: Array, steering: float, road: Array, duration: float, refine: int = 1) -> Array:
    """The state after `duration` (s) of constant steering, by RK4 at the plant's own step over `refine`."""
    period = 0.1
    h = period / (plant.substeps(period, x[3]) * refine)
    u = np.array([steering, 0.0])
    for _ in range(max(1, round(duration / h))):
        k1 = plant.derivative(x, u, road)
        k2 = plant.derivative(x + 0.5 * h * k1, u, road)
        k3 = plant.derivative(x + 0.5 * h * k2, u, road)
        k4 = plant.derivative(x + h * k3, u, road)
        x = x + h / 6.0 * (k1 + 2 * k2 + 2 * k3 + k4)
    return x


def _check_stepped(plant: SteppedPlant, speeds: Sequence[float], symmetric: bool) -> None:
    """`check_plant` for a plant that is stepped: one second of driving, straight and under constant steering."""

    def fail(clause: str, evidence: str) -> None:
        raise ContractError(f"Plant {plant.name!r}: {clause}: {evidence}.")

    road = np.array([0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0])

    def driven(speed: float, steering: float) -> Array:
        plant.reset(np.array([0.0, 0.0, 0.0, speed, 0.0, 0.0]))
        for _ in range(max(1, round(1.0 / plant.longest_step))):
            given = road.copy()
            motion = np.asarray(plant.step(plant.longest_step, steering, 0.0, given), dtype=np.float64)
            if motion.shape != (6,) or not np.isfinite(motion).all():
                fail("step() must return six finite numbers", f"it returned {motion!r} at {speed} m/s")
            if (given != road).any():
                fail("step() must not write to its arguments", f"at {speed} m/s")
        return motion

    for speed in speeds:
        straight, left, right = (driven(speed, angle) for angle in (0.0, 0.02, -0.02))
        if symmetric and abs(straight[[1, 2, 4, 5]]).max() > 1e-6:
            fail("at zero steering the vehicle must go straight", f"{straight} at {speed} m/s")
        if not abs(straight[0] - speed) < 0.2 * speed:
            fail("position must follow the speed", f"X = {straight[0]:g} m after 1 s at {speed} m/s")
        if not left[2] > 0.0:
            fail("steering to the left (positive) must begin a turn to the left", f"yaw {left[2]:g} rad at {speed} m/s")
        if symmetric and not np.allclose(left * [1, -1, -1, 1, -1, -1], right, atol=1e-6):
            fail("the mirrored steering must give the mirrored motion", f"{left} and {right} at {speed} m/s")
        if (driven(speed, 0.02) != left).any():
            fail("after reset() the same steps must give the same motion", f"at {speed} m/s")


_registry: Registry[Plant | SteppedPlant] = Registry(
    "plant", "register_plant", {"single-track": SingleTrack, "dual-track": DualTrack}
)


def register_plant(name: str, factory: Callable[..., Plant | SteppedPlant] | str) -> None:
    """Make ``get_plant(name, vehicle, tyre)`` call ``factory(vehicle, tyre)``.

    Raises
    ------
    InvalidInput
        For a name that is taken or empty, or a factory that is neither callable nor ``"package.module:name"``.
    """
    _registry.add(name, factory)


def get_plant(name: str, vehicle: Vehicle, tyre: Tyre | str | None = None) -> Plant | SteppedPlant:
    """A registered plant of a vehicle on a tyre, by default the vehicle's own.

    Raises
    ------
    UnknownName
        When no plant has this name.
    """
    return _registry.make(name, vehicle, tyre)


def list_plants() -> list[str]:
    """The known names, sorted."""
    return _registry.names()
