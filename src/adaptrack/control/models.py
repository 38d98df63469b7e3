"""The prediction models of the MPC: names of their states, parameters, and functions, which are kernels or a user's."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, final

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.checked import Finite, NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import Contract, Registry, compile_function
from adaptrack.cars.vehicle import Vehicle, VehicleArgument
from adaptrack.core.controllers import condensing
from adaptrack.core.kernel import size_of
from adaptrack.core.maths.portable import Array, product
from adaptrack.core.member import MemberFunction
from adaptrack.core.models import path, single_track
from adaptrack.core.models.car import SingleTrackCar
from adaptrack.core.models.contract import MEASUREMENT, compile_model

MEASURED_STATES = MEASUREMENT._fields[: MEASUREMENT.lateral_acceleration]
"""What is measured, and what a model's states may be: m/s, rad, rad/s, m, rad."""


def _check_speed(speed: float, matrices: str = "a model") -> None:
    """Refuse a speed at which a model has no matrices."""
    if not 0.0 < speed < np.inf:
        raise InvalidInput(
            f"speed = {speed!r} m/s: must be positive and finite, {matrices} is singular at standstill; "
            "the controller floors the speed (MPC(speed_floor=...))."
        )


class PredictionModel(ABC):
    """x(k+1) = A x(k) + B u(k) + E w(k), y(k) = C x(k), re-discretised at each speed.

    u: steering command (rad); w: known input, curvature of the road times speed (rad/s), zero on a straight road. A
    model says its states by the measured quantities that they are (`MEASURED_STATES`); the output is the last one, y.
    The number of states is its own: nothing else knows it. `check_model` admits it.
    """

    @property
    @abstractmethod
    def name(self) -> str:
        """How tables call the model."""

    period: float
    """s, control period"""
    states: tuple[str, ...]
    """of `MEASURED_STATES`; the last one is the output"""
    dead_time: float = 0.0
    """s, from an instant until its command begins to act; the estimator and the controller take it out"""

    @abstractmethod
    def parameters(self) -> Array:
        """The constant numbers of its function."""

    @property
    @abstractmethod
    def function(self) -> Any:
        """The compiled ``discretise(speed, period, parameters, a, b, e)``, see `core.models.contract`."""

    def turning(self) -> Array:
        """Steering coefficients on curved roads, those of `core.models.path.Turning` but for the tyres; or (0,).

        Without it the moves of the MPC are counted from none, and a horizon much longer than the free moves cuts bends.
        """
        return np.zeros(0)

    @property
    def n(self) -> int:
        """How many states."""
        return len(self.states)

    @property
    def output(self) -> Array:
        """C (n,)."""
        return np.eye(self.n)[-1]

    def measured_places(self) -> NDArray[np.int64]:
        """(n,) places of the states in `MEASURED_STATES`."""
        return np.array([MEASURED_STATES.index(name) for name in self.states], dtype=np.int64)

    def discrete(self, speed: float) -> tuple[Array, Array, Array]:
        """Eq. (8): A_k (n, n), B (n, 1), C (1, n) over the period at a speed (m/s).

        Raises
        ------
        InvalidInput
            When the speed is not positive and finite.
        """
        _check_speed(speed)
        a, b, e = np.zeros((self.n, self.n)), np.zeros(self.n), np.zeros(self.n)
        self.function(float(speed), self.period, self.parameters(), a, b, e)
        return a, b[:, None], self.output[None]

    def responses(self, speed: float, horizon: int, of_next: bool = False) -> tuple[Array, Array]:
        """F of eq. (10), transposed (n+1, horizon), and the response to a unit move C~ A~^j B~ (horizon,); compiled.

        of_next: F of the next increment of the state, which an estimator gives, not of the last one.
        """
        a, b, c = self.discrete(speed)
        free, step = np.ones((self.n + 1, horizon)), np.empty(horizon)
        model = condensing.discrete(a, b[:, 0].copy(), c[0].copy())
        condensing.responses(horizon, of_next, model, free, step)
        return free, step


@final
@checked
@dataclass(frozen=True)
class SingleTrackModel(PredictionModel):
    """The paper's model: linear single track in x_c = [v_y, yaw, yaw rate, y].

    vehicle: mass, inertia, axle distances and cornering stiffness per tyre; period: control period Ts (s).
    Heading is taken as small: dy/dt = v_y + v_x yaw (the paper's A_c), while the plant uses eq. (5).

    Raises
    ------
    InvalidInput
        From its methods, when a speed or a horizon is not positive and finite.
    """

    vehicle: VehicleArgument
    period: Annotated[Positive, "s"] = 0.1
    states = MEASURED_STATES[:4]
    name, function = "single-track", staticmethod(single_track.discretise)

    def parameters(self) -> Array:
        return np.array([getattr(self.vehicle, name) for name in SingleTrackCar._fields], dtype=float)

    def continuous(self, speed: float) -> tuple[Array, Array, Array]:
        """Eq. (7): A_c (4, 4), B_c (4, 1), C_c (1, 4) at a longitudinal speed (m/s)."""
        _check_speed(speed, "A_c of eq. (7)")
        a, inputs = PathModel(self.vehicle, self.period).continuous(speed)  # without lag, and the path straight
        return a, inputs[:, :1], self.output[None]


@final
@checked
@dataclass(frozen=True)
class PathModel(PredictionModel):
    """The single track that knows its steering: x = [v_y, psi, r, delta, y] along a path, see `core.models.path`.

    psi and y: heading and lateral offset against the path; delta: wheel angle behind the lag, left out when `lag` is 0.
    vehicle: mass, inertia, axle distances and cornering stiffness per tyre; period: control period (s); lag: time
    constant of the steering (s); dead_time: from an instant until its command begins to act (s), the computer's time
    included.
    """

    vehicle: VehicleArgument
    period: Annotated[Positive, "s"] = 0.1
    lag: Annotated[NotNegative, "s"] = 0.0
    dead_time: Annotated[NotNegative, "s"] = 0.0

    name, function = "path", staticmethod(path.discretise)

    @property
    def states(self) -> tuple[str, ...]:  # type: ignore[override]
        return ("vy", "yaw", "yaw_rate", *(("wheel_angle",) if self.lag > 0.0 else ()), "y")

    def parameters(self) -> Array:
        numbers = [getattr(self.vehicle, name) for name in SingleTrackCar._fields]
        return np.array([*numbers, self.lag], dtype=float)

    def with_rear_slope(self, slope: float) -> PathModel:
        """Return the model with rear tyres whose stiffness is multiplied by `slope`."""
        return replace(self, vehicle=self.vehicle.replace(stiffness_rear=slope * self.vehicle.stiffness_rear))

    def turning(self) -> Array:
        numbers = np.zeros(size_of(path.Turning))
        path.write_turning(self.parameters(), numbers)
        return numbers[:-2]

    def continuous(self, speed: float) -> tuple[Array, Array]:
        """A_c (n, n) and the columns (n, 4) of u, d_y, d_r and of the path's curvature times speed."""
        _check_speed(speed)
        v = self.vehicle
        cf, cr = 2 * v.stiffness_front, 2 * v.stiffness_rear
        turn = cf * v.lf - cr * v.lr
        side = [-(cf + cr) / (v.mass * speed), 0, -speed - turn / (v.mass * speed), cf / v.mass, 0]
        yawing = [
            -turn / (v.yaw_inertia * speed), 0, -(cf * (v.lf * v.lf) + cr * (v.lr * v.lr)) / (v.yaw_inertia * speed),
            cf * v.lf / v.yaw_inertia, 0,
        ]  # fmt: skip
        a = np.array([side, [0, 0, 1, 0, 0], yawing, [0, 0, 0, 0, 0], [1, speed, 0, 0, 0]], dtype=float)
        inputs = np.zeros((5, 4))
        inputs[0, 1] = inputs[2, 2] = 1.0  # d_y, d_r
        inputs[1, 3] = -1.0  # the path turns away
        if self.lag > 0.0:
            a[3, 3], inputs[3, 0] = -1.0 / self.lag, 1.0 / self.lag
            return a, inputs
        inputs[:, 0] = a[:, 3]
        keep = [0, 1, 2, 4]
        return a[np.ix_(keep, keep)], inputs[keep]


@final
class UserModel(PredictionModel):
    """A model of one's own: one function and its numbers. `check_model` admits it.

    discretise(speed, period, parameters, a, b, e) writes A (n, n), B (n,) and E (n,) over one period (s) at a speed
    (m/s, > 0) and returns nothing; for how it is called see `UserPlant`. states: the measured quantities
    (`MEASURED_STATES`) that its states are, the last one being y; parameters: name -> number, an array in their order;
    period: control period (s).

    Raises
    ------
    InvalidInput
        For states that are not measured.
    ContractError
        When the function cannot be compiled; the message states file, line and remedy.
    """

    name, function = "user", None

    @checked
    def __init__(
        self,
        discretise: MemberFunction,
        states: Sequence[str],
        *,
        parameters: Mapping[str, Finite] | None = None,
        period: Annotated[Positive, "s"] = 0.1,
        label: str = "user",
    ) -> None:
        self.name = self.label = label
        self.states = tuple(states)
        where = f"UserModel {label!r}"
        unknown = [name for name in self.states if name not in MEASURED_STATES]
        if unknown or len(set(self.states)) < len(self.states) or self.states[-1:] != ("y",):
            raise InvalidInput(
                f"{where}: states = {self.states!r}: must be different ones of "
                f"{', '.join(MEASURED_STATES)}, with y as the last."
            )
        self.period, self.numbers = period, dict(parameters or {})
        form = "function as f(speed, period, parameters, a, b, e) on float64 numbers and arrays"
        self.function = compile_function(where, compile_model, discretise, form)

    def parameters(self) -> Array:
        return np.array(list(self.numbers.values()), dtype=float)


_registry: Registry[PredictionModel] = Registry(
    "prediction model", "register_model", {"single-track": SingleTrackModel, "path": PathModel},
    ("vehicle", "period"), PredictionModel,
)  # fmt: skip


list_models = _registry.names


@checked
def register_model(name: str, factory: Callable[..., PredictionModel] | str) -> None:
    """Make ``get_model(name, vehicle, period)`` call ``factory(vehicle, period)``.

    Raises `InvalidInput` for a name that is taken or empty, and a factory that is neither callable nor a text
    ``"package.module:name"``, or takes other arguments.
    """
    _registry.add(name, factory)


@checked
def get_model(name: str, vehicle: Vehicle, period: float = 0.1) -> PredictionModel:
    """A registered prediction model of a vehicle.

    Raises
    ------
    UnknownName
        When no model has this name.
    """
    return _registry.make(name, vehicle, period)


@checked
def check_model(model: PredictionModel, speeds: Sequence[float] = (2.0, 10.0, 30.0)) -> None:
    """Test that a prediction model keeps the contract on which the controller relies.

    At each speed (m/s): the function writes every entry of A, B and E, finite, leaves its parameters alone and answers
    twice alike; a steady shift of y stays where it is (A C' = C'), for the lateral position has no dynamics of its own;
    and over some periods a steering angle to the left moves y to the left.

    Raises
    ------
    ContractError
        Naming the clause that is broken and the evidence.
    """

    require, n = Contract(f"prediction model {model.name!r}").require, model.n
    for speed in speeds:
        place, parameters = f"at {speed:g} m/s", model.parameters()
        answers = []
        for empty in (np.nan, 7.0):
            a, b, e = np.full((n, n), empty), np.full(n, empty), np.full(n, empty)
            model.function(float(speed), model.period, parameters, a, b, e)
            answers.append(np.column_stack([a, b, e]))
        require(np.isfinite(answers[0]).all(), "A, B and E must be written and finite", place)
        require((answers[0] == answers[1]).all(), "the same arguments must give the same matrices", place)
        require((parameters == model.parameters()).all(), "the parameters must not be written to", place)
        a, b = answers[0][:, :n], answers[0][:, n]
        shifted = product(a, model.output)
        holds = np.allclose(shifted, model.output, atol=1e-9)
        require(holds, "a steady shift of y must stay where it is", f"A C' = {shifted} {place}")
        x = np.zeros(n)
        for _ in range(max(10, math.ceil(1.0 / model.period))):
            x = product(a, x) + b * 0.01
        y = product(x, model.output)
        require(y > 0.0, "steering to the left must move y to the left", f"y = {y:g} m after 0.01 rad {place}")


def laguerre_basis(Np: int, terms: int, pole: float) -> Array:
    """L (Np, terms): the first discrete Laguerre functions with `pole` in [0, 1), one in each column."""
    rows = np.zeros((terms, Np))
    condensing.laguerre_moves(Np, terms, pole, rows)
    return rows.T.copy()
