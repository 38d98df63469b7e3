"""What a controller is, and the compiled ones: one law of `core.controllers.contract` with its numbers."""

from __future__ import annotations

import copy
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.controllers.inputs import change_of_path, number, road_ahead, vector, wheel_angle
from adaptrack.controllers.limits import Limits
from adaptrack.errors import InvalidInput, real
from adaptrack.road.ahead import RoadAhead, straight
from adaptrack.vehicle import Vehicle

Array = NDArray[np.float64]

STEERING_DELAY = 0.2
"""s, lag and dead time together of a steering of which nothing is known: published values are 0.1 to 0.5 s."""
MOST_STEERING_DELAY = 0.35
"""s, the same at its upper end: with a control period of computation what opendbc lists for series cars, 0.1 to 0.4 s
(`steerActuatorDelay`). The MPC believes it, because too short a delay loses the car and too long a one costs little."""
LEAST_STEERING_RATE = 0.4
"""rad/s at the road wheels, the lowest of published rate limits (CommonRoad vehicle models, vehicle 2)."""


class Command(NamedTuple):
    """What one step of a compiled controller gives."""

    angle: float
    """rad, steering angle to apply, u(k)"""
    move: float
    """rad, u(k) - u(k-1)"""
    held: bool
    """the law had no answer to its input: the previous angle is held"""
    tuning: tuple[float, ...]
    """as used, in the order of `tuning_names`"""
    diagnostics: Mapping[str, float]
    """what the law says of itself, by name; NaN where it has nothing to say"""


class Controller(Protocol):
    """What `simulate` drives with: ours, or one's own, compiled or in Python. `check_controller` admits it.

    One with a true attribute ``sees_all_sensors`` is given all that is measured, as the MPC is, not four numbers only.
    """

    @property
    def name(self) -> str:
        """How tables call it."""

    @property
    def period(self) -> float:
        """Control period (s)."""

    def reset(self) -> None:
        """Forget the past: the next step is the first, from steering angle 0."""

    def step(self, state: ArrayLike, speed: float, reference: ArrayLike, variables: Any = None) -> Any:
        """One control step, see `CompiledController.step`; the answer has `angle` and `move` (rad) at least.

        One that drives curved roads takes ``road=`` besides, see `road.ahead.RoadAhead`.
        """

    def describe(self) -> dict[str, Any]:
        """The configuration, for provenance."""


class CompiledController(ABC):
    """A controller whose law is compiled, see `core.controllers.contract`: `simulate` and batches call the same.

    tuning: named numbers that a search or a scheduler may change; period: control period (s); limits: on angle and
    move; preview: whether the law sees the reference ahead or its present value only.

    A controller drives one vehicle and remembers its past: for several at once, in threads or not, take a copy each.

    Raises
    ------
    InvalidInput
        When the tuning is not finite numbers >= 0, or the period is not positive.
    """

    tuning_names: tuple[str, ...]
    """What may be tuned."""
    diagnostic_names: tuple[str, ...]
    """What an answer holds behind the command."""
    memory_size: int
    """Numbers that the law remembers from step to step."""

    def __init__(
        self, tuning: Mapping[str, float], *, period: float = 0.1, limits: Limits | None = None, preview: bool = False
    ) -> None:
        where = type(self).__name__
        self.tuning = {name: real(where, name, tuning[name]) for name in self.tuning_names}
        for name, value in self.tuning.items():
            if not 0.0 <= value < math.inf:
                raise InvalidInput(f"{where}: {name} = {value!r}: must be finite and not negative.")
        self.period = real(where, "period", period)
        if not 0.0 < self.period < math.inf:
            raise InvalidInput(f"{where}: period = {period!r} s: must be positive and finite.")
        self.limits = Limits() if limits is None else limits
        if not isinstance(self.limits, Limits):
            raise InvalidInput(f"{where}: limits = {limits!r}: must be Limits(move=(low, high), angle=(low, high)).")
        self.preview = bool(preview)
        self.reset()

    @property
    @abstractmethod
    def name(self) -> str:
        """How tables call the controller."""

    @property
    @abstractmethod
    def function(self) -> Any:
        """The compiled law."""

    @abstractmethod
    def own_parameters(self) -> Sequence[float] | Array:
        """What the law's parameters hold behind `core.controllers.contract.COMMON`."""

    def parameters(self) -> Array:
        """The law's constant numbers."""
        return np.array([self.period, *self.limits.move, *self.limits.angle, *self.own_parameters()], dtype=float)

    def packed_tuning(self) -> Array:
        """The tuning in the order of `tuning_names`."""
        return np.array([self.tuning[name] for name in self.tuning_names], dtype=float)

    def reset(self) -> None:
        """Forget the past: the next step is the first, from steering angle 0."""
        self._parameters = self.parameters()
        self._tuning = self.packed_tuning()
        self._memory = np.zeros(self.memory_size)
        self._answer = np.zeros(1 + len(self.diagnostic_names))
        self._angle = 0.0

    @property
    def angle(self) -> float:
        """The last command (rad)."""
        return self._angle

    def applied(self, angle: float) -> None:
        """Say which angle (rad) was asked of the wheels in place of the last command: the next step goes on from it.

        Raises
        ------
        InvalidInput
            When no road wheel can have it.
        """
        self._angle = wheel_angle("applied: angle", angle)

    def change_path(self, heading: float, offset: float) -> None:
        """Say that another path lies under the car, by how much (rad, m) heading and offset have grown against it."""
        change_of_path(heading, offset)

    def step(
        self,
        state: ArrayLike,
        speed: float,
        reference: ArrayLike,
        variables: Any = None,
        road: RoadAhead | None = None,
    ) -> Command:
        """One control step.

        state: measured x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]; speed: v_x (m/s); reference: y_ref (m)
        now and, for preview, at the instants that follow (beyond its end it goes straight on); variables: what a
        scheduler would look at, not used; road: a curved one from the car's foot on, against which yaw, y and y_ref
        then count.

        What is not finite gives no exception but a command that holds the previous angle: a controller in a running
        vehicle must answer.

        Raises
        ------
        InvalidInput
            When an argument is not made of numbers or has a wrong shape.
        """
        situation = np.empty(6)
        situation[:4] = vector("state", state, 4)
        situation[4] = number("speed", speed)
        situation[5] = self._angle
        ahead = vector("reference", reference)
        if not self.preview:
            ahead = ahead[:1]
        curved = road_ahead(road)
        path = straight() if curved is None else curved.packed
        self.function(situation, ahead, path, self._tuning, self._parameters, self._memory, self._answer)
        angle, *said = self._answer.tolist()
        diagnostics = dict(zip(self.diagnostic_names, said, strict=True))
        held = not math.isfinite(angle) or diagnostics.get("held", 0.0) > 0.5
        angle = angle if math.isfinite(angle) else self._angle
        move, self._angle = angle - self._angle, angle
        return Command(angle, move, held, tuple(self.tuning.values()), diagnostics)

    def describe(self) -> dict[str, Any]:
        """The controller's configuration, for provenance."""
        return {
            "tuning": dict(self.tuning),
            "period": self.period,
            "limits": {"move": list(self.limits.move), "angle": list(self.limits.angle)},
            "preview": self.preview,
        }

    def __copy__(self) -> Self:
        """A controller of its own: memories are never shared."""
        return copy.deepcopy(self)


def known_vehicle(where: str, vehicle: Vehicle) -> Vehicle:
    """The vehicle; `InvalidInput` unless it is one."""
    if not isinstance(vehicle, Vehicle):
        raise InvalidInput(f"{where}: vehicle = {vehicle!r}: must be a Vehicle; load_vehicle(name) gives one.")
    return vehicle


def steering_delay(vehicle: Vehicle) -> float:
    """Lag and dead time (s) of a car's steering as far as they are known, else `STEERING_DELAY`."""
    steering = vehicle.steering
    if steering is None or (steering.lag is None and steering.dead_time is None):
        return STEERING_DELAY
    return (steering.lag or 0.0) + (steering.dead_time or 0.0)
