"""Learning while driving: what a controller may learn of its car, how, and what it has learned, for the next drive."""

from __future__ import annotations

import math
from enum import IntEnum
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field

from adaptrack.base.checked import Hint
from adaptrack.base.files import FieldRecord
from adaptrack.cars.vehicle import SteeringActuator, Tyre, Vehicle
from adaptrack.control.controllers.belief import Uncertainty
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.settings import RecordSettings
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.estimators.learning import memory_of
from adaptrack.core.estimators.learning_method import LearningMethod
from adaptrack.core.kernel import Field as KernelField
from adaptrack.core.kernel import fields_of
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.models.car import LEARNED_CAR
from adaptrack.core.synthesis import learner as synthesis

STEERING_QUANTITIES = tuple(name for name in kernel.LEARNED._fields if name in SteeringActuator.model_fields)
"""Learned quantities of the steering, as in `SteeringActuator`: lag, dead time and bias."""
UNKNOWN_CAR = Uncertainty(*synthesis.UNKNOWN_CAR_ROW)
"""Default uncertainty of a car."""


class BeliefState(IntEnum):
    """States of the belief; one at a time, the last that applies (`core.estimators.learning`)."""

    LEARNING = kernel.LEARNING_BELIEF
    """the delay or the stiffness is not yet known well"""
    SETTLED = kernel.SETTLED_BELIEF
    AT_BOUND = kernel.AT_BOUND
    """a quantity is at the end of its range: R is raised"""
    CONTRADICTORY = kernel.CONTRADICTORY
    """the car contradicts the belief: all but the delay becomes more uncertain"""

    def words(self, at_bound: str | None = None) -> str:
        """The state in words; at_bound: the quantity that is at its bound."""
        if self is not BeliefState.AT_BOUND:
            return self.name.lower()
        return "at a bound" if at_bound is None else f"at a bound ({at_bound.replace('_', ' ')})"


WITHIN = 1.645
"""Standard deviations to either side that hold 90 % of a normal distribution."""


def bounded_quantity(at_bound: float) -> str | None:
    """The quantity that the diagnostic `belief_at_bound` names; None: none is at a bound."""
    return kernel.QUANTITIES_BOUNDED[int(at_bound) - 1] if at_bound >= 1.0 else None


class LearnedNumber(NamedTuple):
    """A learned number and its interval of 90 %."""

    quantity: str
    value: float
    low: float
    high: float
    unit: str


class LearnedCar(FieldRecord, fields=LEARNED_CAR, after="car"):
    """A learned car, each number with its standard deviation: for the next drive, see `Learning.start`."""

    car: str = Field(default="", description="whose model the factors belong to")
    at_bound: str = Field(default="", description="which of these is at the end of its range: it may lie beyond")
    seconds: float = Field(default=0.0, ge=0, description="s, for which it was learned")

    if TYPE_CHECKING:

        def __init__(self, **values: Any) -> None: ...

    @property
    def intervals(self) -> tuple[LearnedNumber, ...]:
        """The learned numbers, each with its interval of 90 %."""
        values = self.model_dump() | {"delay": self.lag + self.dead_time}
        learned = [field for field in fields_of(kernel.LEARNED) if f"{field.name}_sigma" in values]
        return tuple(_interval(field, values[field.name], values[f"{field.name}_sigma"]) for field in learned)


def _interval(field: KernelField, value: float, sigma: float) -> LearnedNumber:
    if field.name in kernel.LOGARITHMIC:
        factor = portable.exp(WITHIN * sigma)
        return LearnedNumber(field.meaning, value, value / factor, value * factor, "-")
    least = 0.0 if field.unit == "s" else -math.inf
    return LearnedNumber(field.meaning, value, max(value - WITHIN * sigma, least), value + WITHIN * sigma, field.unit)


load_learned_car = LearnedCar.from_toml


class Learning(RecordSettings, record=LearningMethod):
    """How a controller learns its car while it drives; its `Uncertainty` bounds what it may learn.

    start: what an earlier drive has learned, None: nothing. `core.estimators.learning_method` holds the constants of
    the method, `core.estimators.learning` the filters.
    """

    start: Annotated[LearnedCar, Hint("load_learned_car(file) gives one")] | None = None


class Ranges(NamedTuple):
    """Ranges (s) of lag and dead time of the steering."""

    lag: tuple[float, float]
    dead_time: tuple[float, float]


class Learner:
    """`Learning` of a car: the numbers of the compiled learner.

    car: as in its file; sensing: the filter, with its sensors; row: of `core.synthesis.learner.LearnerRow`.
    """

    def __init__(self, learning: Learning, car: Vehicle, sensing: KalmanFilter, row: Any) -> None:
        self.learning, self.sensing = learning, sensing
        self._row = np.array([row], synthesis.LearnerRow.dtype)
        parameters = row.parameters
        self.period, self.computation = float(parameters.period), float(parameters.computation)
        delays = row.lag, row.dead_time
        self.ranges = Ranges(*((float(delay.low), float(delay.high)) for delay in delays))
        """at first"""
        self.limits = Ranges(*((float(delay.least), float(delay.most)) for delay in delays))
        """never left"""
        self.stiffness, self.stiffness_spread = float(parameters.most_stiffness), float(parameters.prior_stiffness)
        self.longest, self.commands = float(row.longest), int(row.commands)
        self.car = car.replace(lf=float(row.car.lf), lr=float(row.car.lr))

    @property
    def first_top_speed(self) -> float:
        """m/s, above which a drive should not begin, see `core.synthesis.learner.first_top_speed`; inf: no limit."""
        return float(synthesis.first_top_speed(self._row[0]))

    def parameters(self) -> Array:
        """As `core.estimators.learning.LearnerParameters` has them."""
        return np.array([self._row[0].parameters]).view(np.float64)

    def fresh(self) -> Array:
        """The learner's memory before the first sample."""
        row = self._row[0]
        memory = np.zeros(synthesis.learner_size(row))
        synthesis.learner_memory(row, self.sensing.row, memory)
        return memory

    def delay(self, memory: Array) -> float:
        """Periods from an instant until its command begins to act, as a memory believes."""
        # added and divided as the kernel does
        return (float(memory_of(memory, 0).beliefs.used_dead_time) + self.computation) / self.period

    def truth(self, steering: SteeringActuator, plant: Any) -> dict[str, float]:
        """The true values in a simulated world, by the names of `LearnedCar`: of a plant with its own tyre.

        Stiffness and balance are those of the tyres at the static loads over the mass.
        """
        values = {name: getattr(steering, name) for name in STEERING_QUANTITIES}
        car, tyre = getattr(plant, "vehicle", None), getattr(plant, "tyre", None)
        if isinstance(car, Vehicle) and isinstance(tyre, Tyre):
            front, rear = (
                stiffness / car.mass / (assumed / self.car.mass)
                for stiffness, assumed in zip(
                    tyre.stiffness_at(*car.static_loads), (self.car.stiffness_front, self.car.stiffness_rear),
                    strict=True,
                )
            )  # fmt: skip
            values |= {"stiffness": math.sqrt(front * rear), "balance": front / rear}
        return {**values, "delay": steering.lag + steering.dead_time}

    def restart_memory(self, memory: Array) -> Array:
        """A memory before the first step of another drive."""
        fresh = memory.copy()
        kernel.begin_again(fresh)
        return fresh

    def learned(self, memory: Array) -> LearnedCar:
        """The learned car of a memory."""
        m, start = memory_of(memory, 0), self.learning.start
        names = [name for name in LearnedCar.model_fields if f"belief_{name}" in kernel.BELIEF_NAMES]
        values: dict[str, Any] = {name: float(m.beliefs[f"belief_{name}"]) for name in names}
        values["dead_time"] = max(values["dead_time"], 0.0)  # less the computation it may round below
        values["at_bound"] = ("", *kernel.QUANTITIES_BOUNDED)[int(m.beliefs.belief_at_bound)]
        seconds = self.period * float(m.count) + (0.0 if start is None else start.seconds)
        return LearnedCar(car=self.car.name, **values, seconds=seconds)
