"""Learning while driving: what a controller may learn of its car, how, and what it has learned, for the next drive."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from adaptrack.controllers.belief import Belief, Uncertainty
from adaptrack.errors import InvalidInput, real, whole
from adaptrack.files import Record, build, read_toml
from adaptrack.kalman import SENSORS, Drifts, KalmanFilter, wind_turn
from adaptrack.models import PathModel
from adaptrack.vehicle import Vehicle

Array = NDArray[np.float64]

UNTOLD = Uncertainty(lag=0.15, dead_time=0.125, stiffness=2.0, mass=0.3)
"""How far the belief may be wrong where nobody says: published delays are 0.05 to 0.6 s."""
MIDDLE = (0.2, 0.125)
"""s, lag and dead time in the middle of published values, believed where nobody says."""
LEAST_LAG = 0.02
"""s, of a steering that is learned: shorter ones make no difference at a control period of 0.05 s."""
GRAIN = 0.4
"""Standard deviation within a hypothesis over the distance of two: together they are nearly even."""
SPREAD = 1.0 / math.sqrt(3.0)
"""Standard deviation of what may be anywhere within +-1."""


class Learned(Record):
    """What has been learned of a car, each with its standard deviation: for the next drive, see `Learning.start`.

    Raises
    ------
    InvalidInput
        When a value is not allowed.
    """

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
    seconds: float = Field(default=0.0, ge=0, description="s, for which it was learned")

    def to_toml(self, path: str | os.PathLike[str]) -> None:
        """Write it as TOML, each value with its meaning and unit behind it.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        super().to_toml(path)


def load_learned(path: str | os.PathLike[str]) -> Learned:
    """What `Learned.to_toml` has written.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is not TOML, or holds an unknown, missing or impossible value; all of them are in the message.
    """
    return build(Learned, read_toml(path), Path(path))


@dataclass(frozen=True)
class Learning:
    """How a controller learns its car while it drives; what it may learn within says its `Uncertainty`.

    start: what an earlier drive has learned, None: nothing; lags, dead_times: hypotheses of each, evenly within the
    range. The other numbers are the method; see `kernels.estimators.learning` for the filters.

    Raises
    ------
    InvalidInput
        When a number is not allowed.
    """

    start: Learned | None = None
    lags: int = 3
    dead_times: int = 3
    bias: float = 0.02
    """rad, bias of the steering to either side"""
    balance: float = 1.18
    """-, factor by which front over rear stiffness may be larger or smaller"""
    bank: float = 0.2
    """m/s^2, standard deviation of the pull of a banked road"""
    wind: float = 0.35
    """m/s^2, by which side wind changes in a second"""
    wind_time: float = 3.0
    """s, in which a gust is over"""
    bank_time: float = 20.0
    """s, in which a bank is over"""
    friction: float = 0.7
    """-, usual friction"""
    friction_spread: float = 0.4
    """-, standard deviation of the logarithm of friction"""
    friction_time: float = 15.0
    """s, in which friction is the usual one again"""
    drift_vy: float = 0.03
    """m/s, after a second, of v_y beside the model"""
    drift_yaw_rate: float = 0.02
    """rad/s, after a second, of the yaw rate beside the model"""
    drift_stiffness: float = 0.003
    """-, after a second, of the logarithm of the stiffness"""
    drift_balance: float = 0.0005
    """-, after a second, of half the logarithm of the balance"""
    drift_bias: float = 0.00003
    """rad, after a second"""
    drift_delay: float = 0.0005
    """s, after a second, of lag and dead time"""
    sliding: float = 0.1
    """s^0.5, as in `kalman.Drifts`"""
    angle_error: float = 0.002
    """rad, by which measured wheels and the model of the steering differ beside the sensor's noise"""
    bound: float = 5.0
    """standard deviations up to which an innovation counts"""
    memory: float = 120.0
    """s of exciting driving after which evidence about the delay is forgotten"""
    tempering: float = 0.5
    """-, share of a log-likelihood that counts, for successive innovations are not independent"""
    cautious: float = 0.5
    """-, standard deviations of the delay by which the controller believes it longer than its mean"""
    tolerated: float = 0.03
    """s, standard deviation of the delay that doubles R"""
    most_caution: float = 16.0
    """-, largest factor on R for the delay"""
    tolerated_stiffness: float = 0.3
    """-, standard deviation of the logarithm of the stiffness that doubles R"""
    longer: float = 0.2
    """s per s, by which lag or dead time are believed longer at most"""
    shorter: float = 0.1
    """s per s, likewise shorter"""
    stiffer: float = 0.5
    """1/s, by which the logarithm of the believed stiffness changes at most"""
    turning: float = 0.1
    """rad/s, by which the believed bias changes at most"""
    wandering: float = 0.2
    """rad/s, by which the wheels may be elsewhere for every second of uncertain delay, after a second"""
    noise: float = 4.0
    """-, factor within which the noise of a sensor may differ from what was told"""
    noise_time: float = 20.0
    """s, over which the noise of a sensor is averaged"""

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if each.name == "start":
                if not isinstance(value, Learned | None):
                    raise InvalidInput(f"Learning: start = {value!r}: must be a Learned; load_learned(file) gives one.")
            elif each.name in ("lags", "dead_times"):
                if not 1 <= whole("Learning", each.name, value) <= 12:
                    raise InvalidInput(f"Learning: {each.name} = {value!r}: must be from 1 to 12.")
            elif not 0.0 <= real("Learning", each.name, value) < math.inf:
                raise InvalidInput(f"Learning: {each.name} = {value!r}: must not be negative, and finite.")
        for name in (
            "wind_time", "bank_time", "friction", "friction_time", "bound", "memory", "tempering", "tolerated",
            "tolerated_stiffness", "noise_time",
        ):  # fmt: skip
            if not getattr(self, name) > 0.0:
                raise InvalidInput(f"Learning: {name} = {getattr(self, name)!r}: must be positive.")
        for name in ("balance", "most_caution", "noise"):
            if not getattr(self, name) >= 1.0:
                raise InvalidInput(f"Learning: {name} = {getattr(self, name)!r}: must be at least 1.")


class Ranges(NamedTuple):
    """Within which lag and dead time of the steering are (s)."""

    lag: tuple[float, float]
    dead_time: tuple[float, float]

    @classmethod
    def of(cls, belief: Belief, unsure: Uncertainty) -> Ranges:
        """What was told of a steering; the middle of published values where nothing was."""
        said = {"lag": belief.lag.value, "dead_time": belief.dead_time.value}
        if belief.is_cautious:
            said |= {name: MIDDLE[i] for i, name in enumerate(said) if name in belief.assumed}
        lag = said["lag"] - unsure.lag, said["lag"] + unsure.lag
        dead = said["dead_time"] - unsure.dead_time, said["dead_time"] + unsure.dead_time
        return cls((max(lag[0], LEAST_LAG), max(lag[1], LEAST_LAG)), (max(dead[0], 0.0), dead[1]))


class Learner:
    """`Learning` of a car: the numbers of the compiled learner.

    car: as believed; ranges: of its steering; unsure: how far stiffness and mass may be wrong.
    """

    def __init__(self, own: Learning, car: Vehicle, belief: Belief, unsure: Uncertainty, sensing: KalmanFilter,
                 period: float) -> None:  # fmt: skip
        self.own, self.car, self.period, self.sensing = own, car, period, sensing
        self.ranges = Ranges.of(belief, unsure)
        self.computation, self.rate = belief.computation.value, belief.rate.value
        self.stiffness = math.log(unsure.stiffness) + math.log1p(unsure.mass)
        self.stiffness_spread = SPREAD * math.hypot(math.log(unsure.stiffness), math.log1p(unsure.mass))
        if "rate" in belief.assumed:
            self.rate = math.inf
        # the oldest sample is compared with wheels that moved by a command of its age before
        longest = self.ranges.dead_time[1] + self.computation
        self.longest = longest
        self.kept = math.ceil((longest + sensing.oldest) / period) + 3

    @property
    def lags(self) -> Array:
        """(lags,) s."""
        low, high = self.ranges.lag
        return _middles(low, high, self.own.lags)

    @property
    def dead_times(self) -> Array:
        """(dead_times,) s."""
        low, high = self.ranges.dead_time
        return _middles(low, high, self.own.dead_times)

    @property
    def hypotheses(self) -> Array:
        """(n, 2) lag and dead time (s)."""
        return np.array([(lag, dead) for lag in self.lags for dead in self.dead_times])

    @property
    def grains(self) -> tuple[float, float]:
        """Standard deviation of lag and dead time (s) within a hypothesis."""
        low, high = np.array(self.ranges).T
        counts = np.array([self.own.lags, self.own.dead_times])
        lag, dead_time = GRAIN * (high - low) / counts
        return float(lag), float(dead_time)

    def parameters(self) -> Array:
        """In the order of `kernels.estimators.learning.NUMBERS`."""
        from adaptrack.kernels.estimators.learning import NUMBERS

        own, car, period = self.own, self.car, self.period
        drifts = {
            "drift_wind": own.wind, "drift_bias": own.drift_bias, "drift_stiffness": own.drift_stiffness,
            "drift_balance": own.drift_balance, "drift_vy": own.drift_vy, "drift_yaw_rate": own.drift_yaw_rate,
            "drift_bank": own.bank * math.sqrt(2.0 / own.bank_time),
            "drift_friction": own.friction_spread * math.sqrt(2.0 / own.friction_time),
            "drift_lag": own.drift_delay, "drift_dead_time": own.drift_delay, "drift_wheels": Drifts().wheel_angle,
        }  # fmt: skip
        given = {name: value**2 * period for name, value in drifts.items()}
        given |= {name: math.exp(-period / time) for name, time in (
            ("wind_left", own.wind_time), ("bank_left", own.bank_time), ("friction_left", own.friction_time))}  # fmt: skip
        (least_lag, most_lag), (least_dead, most_dead) = self.ranges
        variances = dict(zip((f"variance_{name}" for name in SENSORS), self.sensing.variances(), strict=True))
        given |= {
            "period": period, "computation": self.computation, "hypotheses": len(self.hypotheses), "kept": self.kept,
            "mass": car.mass, "yaw_inertia": car.yaw_inertia, "lf": car.lf, "lr": car.lr,
            "stiffness_front": 2.0 * car.stiffness_front, "stiffness_rear": 2.0 * car.stiffness_rear,
            "wind_turn": wind_turn(car), "rate": self.rate, "bound": own.bound,
            "forgetting": min(1.0, period / own.memory), "tempering": own.tempering,
            "usual_friction": math.log(own.friction), "sliding": own.sliding**2, "angle_error": own.angle_error**2,
            "least_lag": least_lag, "most_lag": most_lag, "least_dead_time": least_dead, "most_dead_time": most_dead,
            "most_stiffness": self.stiffness, "most_balance": 0.5 * math.log(own.balance), "most_bias": 1.5 * own.bias,
            "cautious": own.cautious, "tolerated": own.tolerated, "most_caution": own.most_caution,
            "tolerated_stiffness": own.tolerated_stiffness,
            "longer": own.longer * period, "shorter": own.shorter * period, "stiffer": own.stiffer * period,
            "turning": own.turning * period, "wandering": own.wandering,
            "noise_share": min(1.0, period / own.noise_time), "noise_range": own.noise, **variances,
        }  # fmt: skip
        return np.array([given[name] for name in NUMBERS], dtype=float)

    def fresh(self) -> Array:
        """The learner's memory before the first sample."""
        from adaptrack.kernels.estimators import learning as kernel

        pairs, start, own = self.hypotheses, self.own.start, self.own
        memory = np.zeros(kernel.memory_size(self.kept, len(pairs)))
        variances = self.sensing.variances()
        memory[kernel.NOISE : kernel.NOISE + len(SENSORS)] = np.where(np.isfinite(variances), variances, 0.0)
        spread = np.zeros(kernel.STATES)
        spread[kernel.VY], spread[kernel.RATE] = 0.3, 0.1
        spread[kernel.WIND] = own.wind * math.sqrt(0.5 * own.wind_time)
        spread[kernel.BIAS], spread[kernel.BANK] = SPREAD * own.bias, own.bank
        spread[kernel.STIFFNESS], spread[kernel.BALANCE] = self.stiffness_spread, SPREAD * 0.5 * math.log(own.balance)
        spread[kernel.FRICTION] = own.friction_spread
        spread[kernel.LAG], spread[kernel.DEAD_TIME] = self.grains
        spread[kernel.OFFSET] = 0.05
        x = np.zeros(kernel.STATES)
        x[kernel.FRICTION] = math.log(own.friction)
        prior = np.zeros(len(pairs))
        if start is not None:
            x[kernel.STIFFNESS], spread[kernel.STIFFNESS] = math.log(start.stiffness), start.stiffness_sigma
            x[kernel.BALANCE], spread[kernel.BALANCE] = 0.5 * math.log(start.balance), 0.5 * start.balance_sigma
            x[kernel.BIAS], spread[kernel.BIAS] = start.bias, start.bias_sigma
            prior = self._prior_of(start, pairs)
        first = kernel.blocks_at(self.kept)
        for i, (lag, dead) in enumerate(pairs):
            at = first + kernel.BLOCK * i
            x[kernel.LAG], x[kernel.DEAD_TIME] = lag, dead + self.computation
            memory[at + kernel.PRIOR] = prior[i]
            memory[at + kernel.X : at + kernel.X + kernel.STATES] = x
            for state in range(kernel.STATES):
                memory[at + kernel.P + (kernel.ROW + 1) * state] = spread[state] ** 2
        self._tell(memory, pairs, np.exp(prior - prior.max()), x, spread)
        return memory

    def _prior_of(self, start: Learned, pairs: Array) -> Array:
        """(n,) log-weights of the hypotheses by what was learned before: normal in lag and dead time."""
        of_lag, of_dead = start.lag_sigma**2, start.dead_time_sigma**2
        both = 0.5 * (start.delay_sigma**2 - start.lag_sigma**2 - start.dead_time_sigma**2)
        limit = 0.95 * math.sqrt(of_lag * of_dead)
        both = min(max(both, -limit), limit)
        gap = pairs - (start.lag, start.dead_time)
        if not (of_lag > 0.0 and of_dead > 0.0):
            return np.zeros(len(pairs))
        inverse = np.linalg.inv([[of_lag, both], [both, of_dead]])
        return np.asarray(np.maximum(-0.5 * np.einsum("ij,jk,ik->i", gap, inverse, gap), -20.0))

    def _tell(self, memory: Array, pairs: Array, weights: Array, x: Array, spread: Array) -> None:
        """The belief before the first sample."""
        from adaptrack.kernels.estimators import learning as kernel

        weights = weights / weights.sum()
        lag, dead = weights @ pairs
        grains = np.diag(np.square(self.grains))
        cov = (pairs - (lag, dead)).T @ (weights[:, None] * (pairs - (lag, dead))) + grains
        sigma = math.sqrt(max(float(cov.sum()), 1e-8))
        later = self.own.cautious / sigma * cov.sum(axis=1)
        (least_lag, most_lag), (least_dead, most_dead) = self.ranges
        stiffness, balance, unsure = x[kernel.STIFFNESS], x[kernel.BALANCE], spread[kernel.STIFFNESS]
        caution = min(1.0 + (sigma / self.own.tolerated) ** 2, self.own.most_caution)
        told = {
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
            "used_caution": caution * (1.0 + (unsure / self.own.tolerated_stiffness) ** 2),
        }  # fmt: skip
        for name, value in told.items():
            memory[kernel.ANSWER + kernel.BELIEFS.index(name)] = value

    def model(self) -> PathModel:
        """The model that the controller begins with."""
        from adaptrack.kernels.estimators import learning as kernel

        answer = self.fresh()[kernel.ANSWER :]
        lag, dead = answer[kernel.BELIEF.used_lag], answer[kernel.BELIEF.used_dead_time]
        return PathModel(self.car, self.period, float(lag), float(dead) + self.computation)

    def dead_time(self, memory: Array) -> float:
        """From an instant until its command begins to act (s), as a memory believes."""
        from adaptrack.kernels.estimators.learning import ANSWER, BELIEF

        # added and divided as the kernel does
        lead = (float(memory[ANSWER + BELIEF.used_dead_time]) + self.computation) / self.period
        return lead * self.period

    def learned(self, memory: Array) -> Learned:
        """What a memory holds."""
        from adaptrack.kernels.estimators import learning as kernel

        answer = memory[kernel.ANSWER : kernel.ANSWER + len(kernel.BELIEFS)]
        known: dict[str, Any] = {
            name.removeprefix("belief_"): float(value) for name, value in zip(kernel.BELIEFS, answer, strict=True)
        }
        kept = {name: known[name] for name in Learned.model_fields if name in known}
        seconds = self.period * float(memory[kernel.COUNT])
        seconds += 0.0 if self.own.start is None else self.own.start.seconds
        return Learned(car=self.car.name, **kept, seconds=seconds)


def _middles(low: float, high: float, count: int) -> Array:
    """(count,) middles of equal parts of a range; of one that is a point, that point."""
    return low + (high - low) * (np.arange(count) + 0.5) / count if high > low else np.array([low])
