"""Learning while driving: what a controller may learn of its car, how, and what it has learned, for the next drive."""

from __future__ import annotations

import copy
import math
import os
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, InstanceOf

from adaptrack.base.checked import Count, Finite, Hint, NotNegative, Positive, checked
from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import Record, build, read_toml
from adaptrack.cars.data_sheet import BODY_STYLES
from adaptrack.cars.vehicle import SteeringActuator, Tyre, Vehicle
from adaptrack.control.controllers.belief import Belief, Uncertainty
from adaptrack.control.kalman import Drifts, KalmanFilter, wind_turn
from adaptrack.control.models import PathModel
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.estimators.learning import Numbers, memory_of

Array = NDArray[np.float64]

UNKNOWN_CAR = Uncertainty(lag=0.19, dead_time=0.175, stiffness=2.0, mass=0.3)
"""How far the belief may be wrong where nobody says: published delays are 0.05 to 0.6 s. Stiffness and mass of a car
whose file says how well it is known (``[known_within]``) are taken from there."""
UNKNOWN_BALANCE, UNKNOWN_BIAS = 2.0, 0.035
"""Factor of front over rear stiffness, and rad, likewise: K from -0.5 to 5 deg/g about a data sheet's 1.5, see
`data_sheet.AXLE_COEFFICIENTS`; a wheel that is two degrees off."""
MIDDLE = (0.21, 0.175)
"""s, lag and dead time in the middle of published values, believed where nobody says."""
MOST_LAG, MOST_DEAD_TIME = 0.6, 0.5
"""s, to which a range that nobody gave widens: the longest delay that is published, see `UNKNOWN_CAR`."""
MOST_STIFFNESS, MOST_BALANCE, MOST_BIAS = 4.0, 4.0, 0.07
"""Factors and rad, likewise: axles of 5 to 60 1/rad over their load, beyond what `data_sheet` names; 4 degrees."""
_REPORTED = ("lag", "dead_time", "delay", "stiffness", "balance", "bias")
LEAST_LAG = kernel.SHORTEST_LAG
GRAIN = 0.4
"""Standard deviation within a hypothesis over the distance of two: together they are nearly even."""
LEAST_UNSURE, LEAST_CHANGED = 0.02, 0.05
"""s, by which lag and dead time of an earlier drive may be off; -, likewise the logarithm of its stiffness."""
SPREAD = 1.0 / math.sqrt(3.0)
"""Standard deviation of what may be anywhere within +-1."""


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

    start: Annotated[InstanceOf[LearnedCar], Hint("load_learned_car(file) gives one")] | None = None
    lags: _Hypotheses = 2
    dead_times: _Hypotheses = 2
    bias: Annotated[NotNegative, "rad"] | None = None
    """bias of the steering to either side; None: nobody says, `UNKNOWN_BIAS` at first and up to `MOST_BIAS`"""
    balance: _Factor | None = None
    """factor by which front over rear stiffness may be larger or smaller; None: likewise"""
    rearward: NotNegative = 1.0
    """share of what a car's file leaves open of its centre of mass, by which that is believed further back: a car that
    is believed too heavy in front leaves the road where it oversteers, the other error costs little"""
    bank: Annotated[NotNegative, "m/s^2"] = 0.2
    """standard deviation of the pull of a banked road"""
    wind: Annotated[NotNegative, "m/s^2"] = 0.35
    """by which side wind changes in a second, for the data sheet's car of `WINDY` kg"""
    wind_time: Annotated[Positive, "s"] = 3.0
    """in which a gust is over"""
    bank_time: Annotated[Positive, "s"] = 20.0
    """in which a bank is over"""
    friction: Positive = 0.7
    """usual friction"""
    friction_spread: NotNegative = 0.4
    """standard deviation of the logarithm of friction"""
    friction_time: Annotated[Positive, "s"] = 15.0
    """in which friction is the usual one again"""
    drift_vy: Annotated[NotNegative, "m/s"] = 0.03
    """after a second, of v_y beside the model"""
    drift_yaw_rate: Annotated[NotNegative, "rad/s"] = 0.02
    """after a second, of the yaw rate beside the model"""
    drift_stiffness: NotNegative = 0.003
    """after a second, of the logarithm of the stiffness"""
    drift_balance: NotNegative = 0.0005
    """after a second, of half the logarithm of the balance"""
    drift_bias: Annotated[NotNegative, "rad"] = 0.00003
    """after a second"""
    drift_delay: Annotated[NotNegative, "s"] = 0.0005
    """after a second, of lag and dead time"""
    sliding: Annotated[NotNegative, "s^0.5"] = 0.1
    """as in `kalman.Drifts`"""
    angle_error: Annotated[NotNegative, "rad"] = 0.002
    """by which measured wheels and the model of the steering differ beside the sensor's noise"""
    bound: Positive = 5.0
    """standard deviations up to which an innovation counts"""
    memory: Positive = 120.0
    """s of exciting driving after which evidence about the delay is forgotten"""
    tempering: Positive = 0.5
    """share of a log-likelihood that counts, for successive innovations are not independent"""
    modest: _Factor = 2.0
    """factor on the standard deviations of the filters, which know nothing of relaxation and load of the tyres"""
    cautious: NotNegative = 0.5
    """standard deviations of the delay by which the controller believes it longer than its mean"""
    tolerated: Annotated[Positive, "s"] | None = None
    """standard deviation of the delay that doubles R; None: `TOLERATED`"""
    most_caution: _Factor = 16.0
    """largest factor on R for the delay"""
    tolerated_stiffness: Positive | None = None
    """likewise of the logarithm of the stiffness"""
    doubting_caution: _Factor = 4.0
    """factor on R while a quantity is at the end of its range, or what is measured contradicts what is believed"""
    unmodelled: tuple[NotNegative, NotNegative, NotNegative, NotNegative, NotNegative, NotNegative] = (
        0.03,
        0.02,
        0.015,
        0.1,
        0.3,
        0.0015,
    )
    """standard deviations of what no amount of driving tells, for the filters know nothing of the tyres' relaxation nor
    of the centre of mass: of lag, dead time and both together (s), of the logarithms of stiffness and balance, of the
    bias (rad)"""
    window: Annotated[Positive, "s"] = 3.0
    """over which squared innovations are averaged to find a contradiction"""
    returning: Annotated[Positive, "s"] = 3.0
    """time constant of the way back to the prior's variances in a contradiction"""
    doubting: Annotated[Positive, "s"] = 1.0
    """time constant of `doubting_caution`"""
    longer: Annotated[NotNegative, "s per s"] = 2.0
    """by which lag or dead time are believed longer at most"""
    shorter: Annotated[NotNegative, "s per s"] = 2.0
    """likewise shorter"""
    stiffer: Annotated[NotNegative, "1/s"] = 5.0
    """by which the logarithm of the believed stiffness changes at most"""
    turning: Annotated[NotNegative, "rad/s"] = 0.1
    """by which the believed bias changes at most"""
    wandering: Annotated[NotNegative, "rad/s"] = 0.05
    """by which the wheels may be elsewhere for every second of uncertain delay, after a second"""
    noise: _Factor = 4.0
    """factor within which the noise of a sensor may differ from what is believed"""
    noise_time: Annotated[Positive, "s"] = 20.0
    """over which the noise of a sensor is averaged"""


class Ranges(NamedTuple):
    """Within which lag and dead time of the steering are (s)."""

    lag: tuple[float, float]
    dead_time: tuple[float, float]

    @classmethod
    def of(cls, belief: Belief, unsure: Uncertainty) -> Ranges:
        """Around what is believed of a steering; around the middle of published values where nobody says."""
        said = {"lag": belief.lag.value, "dead_time": belief.dead_time.value}
        if belief.is_cautious:
            said |= {name: MIDDLE[i] for i, name in enumerate(said) if name in belief.assumed}
        lag = said["lag"] - unsure.lag, said["lag"] + unsure.lag
        dead = said["dead_time"] - unsure.dead_time, said["dead_time"] + unsure.dead_time
        return cls((max(lag[0], LEAST_LAG), max(lag[1], LEAST_LAG)), (max(dead[0], 0.0), dead[1]))

    def widened(self) -> Ranges:
        """To the limits of what is published."""
        return Ranges((LEAST_LAG, max(MOST_LAG, self.lag[1])), (0.0, max(MOST_DEAD_TIME, self.dead_time[1])))


def _rear_heavy(car: Vehicle, share: float) -> Vehicle:
    """A car whose centre of mass is so much of what its file leaves open further back."""
    open_to = None if car.known_within is None else car.known_within.lf
    if not open_to or share == 0.0:
        return car
    lf = car.lf + share * open_to
    return car.replace(lf=lf, lr=car.lf + car.lr - lf)


def _unknown(car: Vehicle, belief: Belief) -> Uncertainty:
    """How far the belief may be wrong where the caller does not say."""
    if car.known_within is None:
        return UNKNOWN_CAR
    said = Uncertainty.of_car(car, belief)
    return replace(UNKNOWN_CAR, stiffness=said.stiffness, mass=said.mass)


TOLERATED = {True: (0.12, 0.6), False: (0.3, 2.0)}
"""Standard deviations of the delay (s) and of the logarithm of the stiffness that double R, where the lateral velocity
is measured, and where it is not: there R is larger already (`informed.UNSEEN`)."""
WINDY = 1500.0
"""kg, of a car whose wind `Learning.wind` is: it acts on a car by area and slope of the side force over the mass."""
LEAST_WINDY, MOST_WINDY = 0.5, 4.0
"""Factors on it."""


class Learner:
    """`Learning` of a car: the numbers of the compiled learner.

    car: as believed; belief: of its steering; unsure: how far both may be wrong, never to be left, None: nobody says;
    sensing: the filter, with its sensors; period: control period (s).

    Raises
    ------
    InvalidInput
        When what was learned before is of another car.
    """

    def __init__(self, own: Learning, car: Vehicle, belief: Belief, unsure: Uncertainty | None, sensing: KalmanFilter,
                 period: float) -> None:  # fmt: skip
        self.own, self.period, self.sensing = own, period, sensing
        self.car = _rear_heavy(car, own.rearward)
        if own.start is not None and own.start.car not in ("", car.name):
            raise InvalidInput(
                f"Learning: start: learned of car {own.start.car!r}, and the controller's is {car.name!r}: begin "
                "without it, or give it as LearnedCar(..., car='') if it is the same."
            )
        given = unsure is not None
        unsure = _unknown(car, belief) if unsure is None else unsure
        self.ranges = Ranges.of(belief, unsure)
        """at first"""
        self.limits = self.ranges if given else self.ranges.widened()
        """never left"""
        self.computation, self.rate, self.lag = belief.computation.value, belief.rate.value, belief.lag.value
        self.stiffness = math.log(unsure.stiffness) + math.log1p(unsure.mass)
        if not given:
            self.stiffness = max(self.stiffness, math.log(MOST_STIFFNESS))
        self.balance = UNKNOWN_BALANCE if own.balance is None else own.balance
        self.bias = UNKNOWN_BIAS if own.bias is None else own.bias
        self.stiffness_spread = SPREAD * math.hypot(math.log(unsure.stiffness), math.log1p(unsure.mass))
        if "rate" in belief.assumed:
            self.rate = math.inf
        self.longest = self.limits.dead_time[1] + self.computation
        self.kept = math.ceil((self.longest + sensing.oldest) / period) + 3

    @property
    def tolerated(self) -> tuple[float, float]:
        """Standard deviations of delay (s) and logarithm of the stiffness that double R."""
        usual = TOLERATED[math.isfinite(self.sensing.noise.vy)]
        given = self.own.tolerated, self.own.tolerated_stiffness
        delay, stiffness = (b if a is None else a for a, b in zip(given, usual, strict=True))
        return delay, stiffness

    @property
    def wind(self) -> float:
        """m/s^2, by which side wind changes in a second."""
        car, usual = self.car, Vehicle.model_fields["side_force_slope"].default * BODY_STYLES["car"].frontal_area
        found = car.frontal_area * car.side_force_slope / usual * WINDY / car.mass
        return self.own.wind * min(max(found, LEAST_WINDY), MOST_WINDY)

    @property
    def spread(self) -> tuple[Array, Array]:
        """Middle, and half the width, of what lag and dead time (s) may be at first, (2,) each."""
        low, high = np.array(self.ranges).T
        start = self.own.start
        if start is None:
            return 0.5 * (low + high), 0.5 * (high - low)
        unsure = np.maximum([start.lag_sigma, start.dead_time_sigma], LEAST_UNSURE)
        middle = np.clip([start.lag, start.dead_time], low, high)
        return middle, np.where(high > low, unsure / SPREAD, 0.0)

    @property
    def hypotheses(self) -> Array:
        """(n, 2) lag and dead time (s) at which the filters begin: middles of equal parts of what they may be."""
        middle, half = self.spread
        low, high = np.array(self.ranges).T
        counts = (self.own.lags, self.own.dead_times)
        lags, dead_times = (
            np.clip(m + h * _middles(n if h > 0.0 else 1), a, b)
            for m, h, n, a, b in zip(middle, half, counts, low, high, strict=True)
        )
        return np.array([(lag, dead_time) for lag in lags for dead_time in dead_times])

    @property
    def grains(self) -> Array:
        """(2,) standard deviation of lag and dead time (s) within a hypothesis."""
        return GRAIN * 2.0 * self.spread[1] / (self.own.lags, self.own.dead_times)

    def parameters(self) -> Array:
        """As `core.estimators.learning.Numbers` has them."""
        own, car, period = self.own, self.car, self.period
        drifts = {
            "drift_wind": self.wind, "drift_bias": own.drift_bias, "drift_stiffness": own.drift_stiffness,
            "drift_balance": own.drift_balance, "drift_vy": own.drift_vy, "drift_yaw_rate": own.drift_yaw_rate,
            "drift_bank": own.bank * math.sqrt(2.0 / own.bank_time),
            "drift_friction": own.friction_spread * math.sqrt(2.0 / own.friction_time),
            "drift_lag": own.drift_delay, "drift_dead_time": own.drift_delay, "drift_wheels": Drifts().wheel_angle,
        }  # fmt: skip
        given: dict[str, Any] = {name: value**2 * period for name, value in drifts.items()}
        times = {"wind_left": own.wind_time, "bank_left": own.bank_time, "friction_left": own.friction_time}
        given |= {name: math.exp(-period / time) for name, time in times.items()}
        (least_lag, most_lag), (least_dead, most_dead) = self.limits
        given |= {f"unmodelled_{name}": value for name, value in zip(_REPORTED, own.unmodelled, strict=True)}
        given |= {name: min(1.0, period / getattr(own, name)) for name in ("window", "returning", "doubting")}
        given |= {
            "period": period, "computation": self.computation, "lag": self.lag,
            "hypotheses": len(self.hypotheses), "kept": self.kept,
            "mass": car.mass, "yaw_inertia": car.yaw_inertia, "lf": car.lf, "lr": car.lr,
            "stiffness_front": 2.0 * car.stiffness_front, "stiffness_rear": 2.0 * car.stiffness_rear,
            "wind_turn": wind_turn(car), "rate": self.rate, "bound": own.bound,
            "forgetting": min(1.0, period / own.memory), "tempering": own.tempering,
            "usual_friction": math.log(own.friction), "sliding": own.sliding**2, "angle_error": own.angle_error**2,
            "least_lag": least_lag, "most_lag": most_lag, "least_dead_time": least_dead, "most_dead_time": most_dead,
            "most_stiffness": self.stiffness,
            "most_balance": 0.5 * math.log(MOST_BALANCE if own.balance is None else own.balance),
            "most_bias": MOST_BIAS if own.bias is None else own.bias,
            "modest": own.modest, **self._priors(),
            "cautious": own.cautious, "tolerated": self.tolerated[0], "most_caution": own.most_caution,
            "tolerated_stiffness": self.tolerated[1], "doubting_caution": own.doubting_caution,
            "longer": own.longer * period, "shorter": own.shorter * period, "stiffer": own.stiffer * period,
            "turning": own.turning * period, "wandering": own.wandering,
            "noise_share": min(1.0, period / own.noise_time), "noise_range": own.noise,
            "variance": self.sensing.variances(),
        }  # fmt: skip
        return np.array([tuple(given[name] for name in Numbers._fields)], Numbers.dtype).view(float)

    def _priors(self) -> dict[str, float]:
        """Standard deviations before the first sample of the first drive."""
        first = copy.copy(self)
        first.own = replace(self.own, start=None)
        beliefs = memory_of(first.fresh(), 0).beliefs
        return {f"prior_{name}": float(beliefs[f"belief_{name}_sigma"]) for name in _REPORTED}

    def fresh(self) -> Array:
        """The learner's memory before the first sample."""
        pairs, start, own = self.hypotheses, self.own.start, self.own
        memory = np.zeros(kernel.memory_size(self.kept, len(pairs)))
        variances = self.sensing.variances()
        kernel.memory_of(memory, 0).noise[:] = np.where(np.isfinite(variances), variances, 0.0)
        spread = np.zeros(kernel.STATES)
        spread[kernel.VY], spread[kernel.RATE] = 0.3, 0.1
        spread[kernel.WIND] = self.wind * math.sqrt(0.5 * own.wind_time)
        spread[kernel.BIAS], spread[kernel.BANK] = SPREAD * self.bias, own.bank
        spread[kernel.STIFFNESS], spread[kernel.BALANCE] = self.stiffness_spread, SPREAD * 0.5 * math.log(self.balance)
        spread[kernel.FRICTION] = own.friction_spread
        spread[kernel.LAG], spread[kernel.DEAD_TIME] = self.grains
        spread[kernel.OFFSET] = 0.05
        x = np.zeros(kernel.STATES)
        x[kernel.FRICTION] = math.log(own.friction)
        if start is not None:
            x[kernel.STIFFNESS], x[kernel.BALANCE] = math.log(start.stiffness), 0.5 * math.log(start.balance)
            x[kernel.BIAS] = start.bias
            spread[kernel.STIFFNESS] = min(start.stiffness_sigma + LEAST_CHANGED, spread[kernel.STIFFNESS])
            spread[kernel.BALANCE] = min(start.balance_sigma, spread[kernel.BALANCE])
            spread[kernel.BIAS] = min(start.bias_sigma, spread[kernel.BIAS])
        for i, (lag, dead) in enumerate(pairs):
            each = kernel.hypothesis(i, self.kept, memory)
            x[kernel.LAG], x[kernel.DEAD_TIME] = lag, dead + self.computation
            each.x[: kernel.STATES] = x
            np.fill_diagonal(each.covariance, spread**2)
        self._write_beliefs(memory, x, spread)
        return memory

    def _write_beliefs(self, memory: Array, x: Array, spread: Array) -> None:
        """The belief before the first sample."""
        pairs = self.hypotheses
        lag, dead = pairs.mean(axis=0)
        cov = np.cov(pairs.T, ddof=0) + np.diag(np.square(self.grains))
        sigma = math.sqrt(max(float(cov.sum()), 1e-8))
        later = self.own.cautious / sigma * cov.sum(axis=1)
        (least_lag, most_lag), (least_dead, most_dead) = self.limits
        stiffness, balance, unsure = x[kernel.STIFFNESS], x[kernel.BALANCE], spread[kernel.STIFFNESS]
        tolerated, tolerated_stiffness = self.tolerated
        caution = min(1.0 + (sigma / tolerated) ** 2, self.own.most_caution)
        believed = {
            "belief_lag": lag, "belief_lag_sigma": math.sqrt(cov[0, 0]), "belief_dead_time": dead,
            "belief_dead_time_sigma": math.sqrt(cov[1, 1]), "belief_delay": lag + dead, "belief_delay_sigma": sigma,
            "belief_stiffness": math.exp(stiffness), "belief_stiffness_sigma": unsure,
            "belief_balance": math.exp(2.0 * balance), "belief_balance_sigma": 2.0 * spread[kernel.BALANCE],
            "belief_bias": x[kernel.BIAS], "belief_bias_sigma": spread[kernel.BIAS],
            "belief_bank": 0.0, "belief_bank_sigma": spread[kernel.BANK],
            "belief_friction": self.own.friction, "belief_friction_sigma": spread[kernel.FRICTION],
            "belief_noise": 1.0,
            "used_lag": min(max(lag + later[0], least_lag), most_lag),
            "used_dead_time": min(max(dead + later[1], least_dead), most_dead),
            "used_stiffness": math.exp(stiffness), "used_balance": math.exp(2.0 * balance),
            "used_bias": x[kernel.BIAS],
            "used_caution": caution * (1.0 + (unsure / tolerated_stiffness) ** 2),
            "belief_state": BeliefState.LEARNING, "belief_at_bound": 0.0,
        }  # fmt: skip
        memory[: len(kernel.BELIEFS)] = [believed[name] for name in kernel.BELIEFS]

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


def _middles(count: int) -> Array:
    """(count,) middles of equal parts of -1..1."""
    return (2.0 * np.arange(count) + 1.0) / count - 1.0
