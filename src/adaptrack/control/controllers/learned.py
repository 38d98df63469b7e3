"""Learning while driving: what a controller may learn of its car, how, and what it has learned, for the next drive."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.base.checked import Count, Finite, Hint, NotNegative, Positive, checked
from adaptrack.base.files import Record, build, read_toml
from adaptrack.cars.vehicle import SteeringActuator, Tyre, Vehicle
from adaptrack.control.controllers.belief import Uncertainty
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PathModel
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.estimators.learning import Numbers, memory_of
from adaptrack.core.kernel import size_of
from adaptrack.core.synthesis import learner as synthesis
from adaptrack.core.synthesis.rows import row_of

Array = NDArray[np.float64]

UNKNOWN_CAR, MIDDLE, LEAST_LAG = Uncertainty(*synthesis.UNKNOWN_CAR), synthesis.MIDDLE, synthesis.LEAST_LAG
"""How far the belief may be wrong where nobody says; lag and dead time in the middle of published values, and the
shortest lag (s), see `core.synthesis.learner`."""
_UNMODELLED = ("lag", "dead_time", "delay", "stiffness", "balance", "bias")
_USUAL = synthesis.USUAL


class BeliefState(IntEnum):
    """States of what is believed; one at a time, the last of those that apply (`core.estimators.learning`)."""

    LEARNING = kernel.LEARNING
    """the delay or the stiffness is not yet known well"""
    SETTLED = kernel.SETTLED_BELIEF
    AT_BOUND = kernel.AT_BOUND
    """a quantity is at the end of its range: R is raised"""
    CONTRADICTORY = kernel.CONTRADICTORY
    """the car does not do what is believed: what is believed becomes as uncertain as before the first sample"""

    def words(self, at_bound: str | None = None) -> str:
        """As sentences say it; at_bound: the quantity that is at its bound."""
        if self is not BeliefState.AT_BOUND:
            return self.name.lower()
        return "at a bound" if at_bound is None else f"at a bound ({at_bound.replace('_', ' ')})"


WITHIN = 1.645
"""Standard deviations to either side that hold 90 % of a normal distribution."""


def bounded_quantity(at_bound: float) -> str | None:
    """The quantity that the diagnostic `belief_at_bound` names; None: none is at a bound."""
    return kernel.QUANTITIES_BOUNDED[int(at_bound) - 1] if at_bound >= 1.0 else None


class LearnedNumber(NamedTuple):
    """A number that was learned, and between which two it is with 90 %."""

    quantity: str
    value: float
    low: float
    high: float
    unit: str


class LearnedCar(Record):
    """What has been learned of a car, each with its standard deviation: for the next drive, see `Learning.start`."""

    car: str = Field(default="", description="whose model the factors belong to")
    lag: float = Field(ge=0, le=10, description="s, of the steering")
    lag_sigma: float = Field(ge=0, le=10, description="s")
    dead_time: float = Field(ge=0, le=10, description="s, of the steering, without the computation")
    dead_time_sigma: float = Field(ge=0, le=10, description="s")
    delay_sigma: float = Field(ge=0, le=10, description="s, of lag and dead time together")
    stiffness: float = Field(gt=0, le=100, description="-, cornering stiffness over mass, factor on what is known")
    stiffness_sigma: float = Field(ge=0, le=10, description="-, of its logarithm")
    balance: float = Field(default=1.0, gt=0, le=100, description="-, factor on front over rear stiffness")
    balance_sigma: float = Field(default=0.1, ge=0, le=10, description="-, of its logarithm")
    bias: float = Field(default=0.0, ge=-1, le=1, description="rad, by which the wheels turn beyond the command")
    bias_sigma: float = Field(default=0.0, ge=0, le=1, description="rad")
    at_bound: str = Field(default="", description="which of these is at the end of its range: it may lie beyond")
    seconds: float = Field(default=0.0, ge=0, description="s, for which it was learned")

    @property
    def intervals(self) -> tuple[LearnedNumber, ...]:
        """What has been learned, each number with its interval of 90 %."""
        lag, dead, bias = WITHIN * self.lag_sigma, WITHIN * self.dead_time_sigma, WITHIN * self.bias_sigma
        both, late = self.lag + self.dead_time, WITHIN * self.delay_sigma
        stiffness, balance = math.exp(WITHIN * self.stiffness_sigma), math.exp(WITHIN * self.balance_sigma)
        return (
            LearnedNumber("lag of the steering", self.lag, max(self.lag - lag, 0.0), self.lag + lag, "s"),
            LearnedNumber(
                "dead time of the steering", self.dead_time, max(self.dead_time - dead, 0.0), self.dead_time + dead, "s"
            ),
            LearnedNumber("lag and dead time together", both, max(both - late, 0.0), both + late, "s"),
            LearnedNumber(
                "stiffness over mass, times what is known", self.stiffness, self.stiffness / stiffness,
                self.stiffness * stiffness, "-",
            ),
            LearnedNumber(
                "front over rear stiffness, times what is known", self.balance, self.balance / balance,
                self.balance * balance, "-",
            ),
            LearnedNumber("bias of the wheels", self.bias, self.bias - bias, self.bias + bias, "rad"),
        )  # fmt: skip

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write it as TOML, each value with its meaning and unit behind it.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        super().to_toml(path)


@checked
def load_learned_car(path: str | os.PathLike[str]) -> LearnedCar:
    """What `LearnedCar.to_toml` has written.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not TOML, or holds an unknown, missing or impossible value; all of them are in the message.
    """
    return build(LearnedCar, read_toml(path), Path(path))


_Factor = Annotated[Finite, Field(ge=1.0)]
_Hypotheses = Annotated[Count, Field(le=12)]


@checked
@dataclass(frozen=True)
class Learning:
    """How a controller learns its car while it drives; what it may learn within says its `Uncertainty`.

    start: what an earlier drive has learned, None: nothing; lags, dead_times: hypotheses of each, evenly within the
    range. The other numbers are the method; see `core.estimators.learning` for the filters.
    """

    start: Annotated[LearnedCar, Hint("load_learned_car(file) gives one")] | None = None
    lags: _Hypotheses = _USUAL.lags
    dead_times: _Hypotheses = _USUAL.dead_times
    bias: Annotated[NotNegative, "rad"] | None = None
    """bias of the steering to either side; None: nobody says, as `core.synthesis.learner` has it"""
    balance: _Factor | None = None
    """factor by which front over rear stiffness may be larger or smaller; None: likewise"""
    rearward: NotNegative = _USUAL.rearward
    """share of what a car's file leaves open of its centre of mass, by which that is believed further back: a car that
    is believed too heavy in front leaves the road where it oversteers, the other error costs little"""
    bank: Annotated[NotNegative, "m/s^2"] = _USUAL.bank
    """standard deviation of the pull of a banked road"""
    wind: Annotated[NotNegative, "m/s^2"] = _USUAL.wind
    """by which side wind changes in a second, for the data sheet's car of `core.synthesis.learner.WINDY` kg"""
    wind_time: Annotated[Positive, "s"] = _USUAL.wind_time
    """in which a gust is over"""
    bank_time: Annotated[Positive, "s"] = _USUAL.bank_time
    """in which a bank is over"""
    friction: Positive = _USUAL.friction
    """usual friction"""
    friction_spread: NotNegative = _USUAL.friction_spread
    """standard deviation of the logarithm of friction"""
    friction_time: Annotated[Positive, "s"] = _USUAL.friction_time
    """in which friction is the usual one again"""
    drift_vy: Annotated[NotNegative, "m/s"] = _USUAL.drift_vy
    """after a second, of v_y beside the model"""
    drift_yaw_rate: Annotated[NotNegative, "rad/s"] = _USUAL.drift_yaw_rate
    """after a second, of the yaw rate beside the model"""
    drift_stiffness: NotNegative = _USUAL.drift_stiffness
    """after a second, of the logarithm of the stiffness"""
    drift_balance: NotNegative = _USUAL.drift_balance
    """after a second, of half the logarithm of the balance"""
    drift_bias: Annotated[NotNegative, "rad"] = _USUAL.drift_bias
    """after a second"""
    drift_delay: Annotated[NotNegative, "s"] = _USUAL.drift_delay
    """after a second, of lag and dead time"""
    sliding: Annotated[NotNegative, "s^0.5"] = _USUAL.sliding
    """as in `kalman.Drifts`"""
    angle_error: Annotated[NotNegative, "rad"] = _USUAL.angle_error
    """by which measured wheels and the model of the steering differ beside the sensor's noise"""
    bound: Positive = _USUAL.bound
    """standard deviations up to which an innovation counts"""
    memory: Positive = _USUAL.memory
    """s of exciting driving after which evidence about the delay is forgotten"""
    tempering: Positive = _USUAL.tempering
    """share of a log-likelihood that counts, for successive innovations are not independent"""
    modest: _Factor = _USUAL.modest
    """factor on the standard deviations of the filters, which know nothing of relaxation and load of the tyres"""
    cautious: NotNegative = _USUAL.cautious
    """standard deviations of the delay by which the controller believes it longer than its mean"""
    tolerated: Annotated[Positive, "s"] | None = None
    """standard deviation of the delay that doubles R; None: `core.synthesis.learner.TOLERATED`"""
    most_caution: _Factor = _USUAL.most_caution
    """largest factor on R for the delay"""
    tolerated_stiffness: Positive | None = None
    """likewise of the logarithm of the stiffness"""
    doubting_caution: _Factor = _USUAL.doubting_caution
    """factor on R while a quantity is at the end of its range, or what is measured contradicts what is believed"""
    unmodelled: tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative] = (
        _USUAL.unmodelled_lag, _USUAL.unmodelled_dead_time, _USUAL.unmodelled_delay, _USUAL.unmodelled_stiffness,
        _USUAL.unmodelled_balance, _USUAL.unmodelled_bias,
    )  # fmt: skip
    """standard deviations of what no amount of driving tells, for the filters know nothing of the tyres' relaxation nor
    of the centre of mass: of lag, dead time and both together (s), of the logarithms of stiffness and balance, of the
    bias (rad)"""
    window: Annotated[Positive, "s"] = _USUAL.window
    """over which squared innovations are averaged to find a contradiction"""
    returning: Annotated[Positive, "s"] = _USUAL.returning
    """time constant of the way back to the prior's variances in a contradiction"""
    doubting: Annotated[Positive, "s"] = _USUAL.doubting
    """time constant of `doubting_caution`"""
    longer: Annotated[NotNegative, "s per s"] = _USUAL.longer
    """by which lag or dead time are believed longer at most"""
    shorter: Annotated[NotNegative, "s per s"] = _USUAL.shorter
    """likewise shorter"""
    stiffer: Annotated[NotNegative, "1/s"] = _USUAL.stiffer
    """by which the logarithm of the believed stiffness changes at most"""
    turning: Annotated[NotNegative, "rad/s"] = _USUAL.turning
    """by which the believed bias changes at most"""
    wandering: Annotated[NotNegative, "rad/s"] = _USUAL.wandering
    """by which the wheels may be elsewhere for every second of uncertain delay, after a second"""
    noise: _Factor = _USUAL.noise
    """factor within which the noise of a sensor may differ from what is believed"""
    noise_time: Annotated[Positive, "s"] = _USUAL.noise_time
    """over which the noise of a sensor is averaged"""

    @property
    def numbers(self) -> Any:
        """A row of `core.synthesis.learner.Method`."""
        unmodelled = {f"unmodelled_{name}": value for name, value in zip(_UNMODELLED, self.unmodelled, strict=True)}
        return row_of(synthesis.Method, self, **unmodelled)

    @property
    def first(self) -> Any:
        """Where it begins: a row of `core.synthesis.learner.Start`."""
        return row_of(synthesis.Start, self.start)


class Ranges(NamedTuple):
    """Within which lag and dead time of the steering are (s)."""

    lag: tuple[float, float]
    dead_time: tuple[float, float]

    @classmethod
    def of(cls, *ends: float) -> Ranges:
        """From the ends of both."""
        least_lag, most_lag, least_dead_time, most_dead_time = map(float, ends)
        return cls((least_lag, most_lag), (least_dead_time, most_dead_time))


class Learner:
    """`Learning` of a car: the numbers of the compiled learner.

    car: as in its file; sensing: the filter, with its sensors; row: of `core.synthesis.learner.Learner`.
    """

    def __init__(self, own: Learning, car: Vehicle, sensing: KalmanFilter, row: Any) -> None:
        self.own, self.sensing = own, sensing
        self._row = np.array([row], synthesis.Learner.dtype)
        self.period, self.computation = float(row.period), float(row.computation)
        self.ranges = Ranges.of(row.least_lag, row.most_lag, row.least_dead_time, row.most_dead_time)
        """at first"""
        self.limits = Ranges.of(row.lag_end, row.lag_limit, row.dead_time_end, row.dead_time_limit)
        """never left"""
        self.stiffness, self.stiffness_spread = float(row.stiffness), float(row.stiffness_spread)
        self.longest, self.kept = float(row.longest), int(row.kept)
        self.car = car.replace(lf=float(row.car.lf), lr=float(row.car.lr))

    def parameters(self) -> Array:
        """As `core.estimators.learning.Numbers` has them."""
        found = np.zeros(size_of(Numbers))
        synthesis.learner_numbers(self._row[0], self.own.numbers, self.sensing.numbers, found)
        return found

    def fresh(self) -> Array:
        """The learner's memory before the first sample."""
        row = self._row[0]
        memory = np.zeros(synthesis.learner_size(row))
        synthesis.learner_memory(row, self.own.numbers, self.own.first, self.sensing.numbers, memory)
        return memory

    def model(self) -> PathModel:
        """The model that the controller begins with."""
        beliefs = memory_of(self.fresh(), 0).beliefs
        dead_time = float(beliefs.used_dead_time) + self.computation
        return PathModel(self.car, self.period, float(beliefs.used_lag), dead_time)

    def delay(self, memory: Array) -> float:
        """Periods from an instant until its command begins to act, as a memory believes."""
        # added and divided as the kernel does
        return (float(memory_of(memory, 0).beliefs.used_dead_time) + self.computation) / self.period

    def truth(self, steering: SteeringActuator, plant: Any) -> dict[str, float]:
        """What there is to be learned in a simulated world, by the names of `LearnedCar`: of a plant with its own tyre.

        Stiffness and balance are those of the tyres at the static loads over the mass.
        """
        found = {"lag": steering.lag, "dead_time": steering.dead_time, "bias": steering.bias}
        car, tyre = getattr(plant, "vehicle", None), getattr(plant, "tyre", None)
        if isinstance(car, Vehicle) and isinstance(tyre, Tyre):
            front, rear = (
                stiffness / car.mass / (believed / self.car.mass)
                for stiffness, believed in zip(
                    tyre.stiffness_at(*car.static_loads), (self.car.stiffness_front, self.car.stiffness_rear),
                    strict=True,
                )
            )  # fmt: skip
            found |= {"stiffness": math.sqrt(front * rear), "balance": front / rear}
        return {**found, "delay": steering.lag + steering.dead_time}

    def again(self, memory: Array) -> Array:
        """A memory before the first step of another drive."""
        fresh = memory.copy()
        kernel.begin_again(fresh)
        return fresh

    def learned(self, memory: Array) -> LearnedCar:
        """What a memory holds."""
        found = kernel.memory_of(memory, 0)
        known: dict[str, Any] = {name.removeprefix("belief_"): float(found.beliefs[name]) for name in kernel.BELIEFS}
        known["dead_time"] = max(known["dead_time"], 0.0)  # less the computation it may round below
        kept = {name: known[name] for name in LearnedCar.model_fields if name in known}
        seconds = self.period * float(found.count)
        seconds += 0.0 if self.own.start is None else self.own.start.seconds
        at_bound = ("", *kernel.QUANTITIES_BOUNDED)[int(known["at_bound"])]
        return LearnedCar(car=self.car.name, **{**kept, "at_bound": at_bound}, seconds=seconds)
