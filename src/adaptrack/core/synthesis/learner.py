"""The numbers of the learner (`estimators.learning`), and what it remembers before its first step."""

from __future__ import annotations

import math

from ..estimators import learning
from ..estimators.learning_method import LearningMethod
from ..kernel import Row, copier, default_setter, exported, float64, inlined, int64, record, vector, void
from ..maths.bits import whole
from ..maths.exact import ceil, clip, sqrt, square
from ..maths.exponential import exp, hypot, log, log1p
from ..models.car import SIDE_FORCE_SLOPE, CarRow, SingleTrackCar
from .belief import SLOW_ASSUMED, UncertaintyRow, is_unknown, uncertainty_of_car
from .car import PASSENGER_BODY, given_or, wind_turn
from .filter import DEFAULT_DRIFTS, Filter, sensor_variances

DelayRange = record(
    "DelayRange",
    (
        "low", "high",  # s, at first
        "least", "most",  # s, never left
        "middle", "half",  # s: the hypotheses lie evenly within middle +- half
        "count",  # hypotheses
    ),
    integers=("count",),
)  # fmt: skip
"""The range of the lag, or of the dead time, of the steering."""
LearnerRow = record(
    "LearnerRow",
    (
        ("parameters", learning.LearnerParameters),
        ("car", CarRow),  # as assumed
        ("lag", DelayRange), ("dead_time", DelayRange),
        "wind",  # m/s^2, change of side wind in a second
        ("first", learning.Beliefs),  # before the first sample
        "start_stiffness", "start_balance",  # of the filters: logarithm, half the logarithm
        "longest",  # s, of dead time and computation
        "commands",  # commands that are remembered
    ),
    integers=("commands",),
)  # fmt: skip
"""What a learner may learn, and where it begins."""
UNKNOWN_CAR_ROW = UncertaintyRow(lag=0.19, dead_time=0.175, stiffness=2.0, mass=0.3)
"""Default uncertainty of a car: published delays are 0.05 to 0.6 s. A car file with ``[known_within]`` replaces the
values of stiffness and mass."""
UNKNOWN_BALANCE, UNKNOWN_BIAS = 2.0, 0.035
"""Default ranges, as a factor on front over rear stiffness and in rad: K from -0.5 to 5 deg/g about a data sheet's 1.5,
see `car.AXLE_COEFFICIENTS`; a wheel that is off by two degrees."""
PUBLISHED_MEDIAN = (0.21, 0.175)
"""s, lag and dead time in the middle of published values, assumed where they are unknown."""
MOST_LAG, MOST_DEAD_TIME = 0.6, 0.5
"""s, to which a default range may widen: the longest published delay, see `UNKNOWN_CAR_ROW`."""
MAX_STIFFNESS_RANGE, MAX_BALANCE_RANGE, MAX_BIAS_RANGE = 4.0, 4.0, 0.07
"""Factors and rad, to which a default range may widen: axles of 5 to 60 1/rad over their load, beyond any data sheet;
4 degrees."""
GRAIN = 0.4
"""Standard deviation within a hypothesis over the distance of two: together they are nearly even."""
MIN_DELAY_SIGMA, MIN_STIFFNESS_SIGMA = 0.02, 0.05
"""Least standard deviations of what an earlier drive has learned: s, of lag and dead time; of the log stiffness."""
UNIFORM_SIGMA = 1.0 / math.sqrt(3.0)
"""Standard deviation of a uniform distribution from -1 to 1."""
LEAST_VARIANCE = 1e-8
"""s^2, of lag and dead time together."""
WINDY = 1500.0
"""kg, mass of the car for which `LearningMethod.wind` holds; wind acts by area and side-force slope over the mass."""
LEAST_WINDY, MOST_WINDY = 0.5, 4.0
"""Smallest and largest factor on `LearningMethod.wind`."""
_BEFORE = learning.memory_size(0, 0)
_HYPOTHESIS = learning.memory_size(0, 1) - _BEFORE
_USUAL_SIDE = SIDE_FORCE_SLOPE * PASSENGER_BODY.frontal_area
_set_defaults = default_setter(LearningMethod)
_copy_car, _copy_single_track = copier(CarRow), copier(SingleTrackCar)
_copy_method, _copy_beliefs = copier(LearningMethod), copier(learning.Beliefs)


@exported(void(Row(LearningMethod)))
def usual_method(method):
    """Write the default values to a method of learning."""
    _set_defaults(method)


@inlined
def _set_ends(delay, half, shortest, longest, by_caller, ends):
    """Write the ends of the range of a delay (s); shortest, longest: of any car, for a default range."""
    ends.low, ends.high = max(delay - half, shortest), max(delay + half, shortest)
    ends.least = ends.low if by_caller > 0 else shortest
    ends.most = ends.high if by_caller > 0 else max(longest, ends.high)


@inlined
def _set_hypotheses(count, learned, sigma, delays):
    """Place the hypotheses of a delay (s) in its range; learned, sigma: of an earlier drive, or NaN."""
    low, high = delays.low, delays.high
    if math.isnan(learned):
        delays.middle, delays.half = 0.5 * (low + high), 0.5 * (high - low)
    else:
        delays.middle = clip(learned, low, high)
        delays.half = max(sigma, MIN_DELAY_SIGMA) / UNIFORM_SIGMA if high > low else 0.0
    delays.count = whole(count) if delays.half > 0.0 else 1


@inlined
def _set_ranges(belief, uncertainty, by_caller, learner):
    """Write the ranges of lag and dead time: about the assumed values, or about the middle of published ones."""
    steering, source = belief.steering, belief.source
    lag = PUBLISHED_MEDIAN[0] if is_unknown(source.lag) else steering.lag
    dead_time = PUBLISHED_MEDIAN[1] if is_unknown(source.dead_time) else steering.dead_time
    _set_ends(lag, uncertainty.lag, learning.SHORTEST_LAG, MOST_LAG, by_caller, learner.lag)
    _set_ends(dead_time, uncertainty.dead_time, 0.0, MOST_DEAD_TIME, by_caller, learner.dead_time)


@inlined
def _copy_car_with_moved_cg(car, share, within, target):
    """Copy a car, its centre of mass moved rearward by a share of what the car's file leaves open."""
    _copy_car(car, target)
    if within.is_given > 0 and within.lf > 0.0 and share != 0.0:
        target.lf = car.lf + share * within.lf
        target.lr = car.lf + car.lr - target.lf


@inlined
def begin_learner(order, mpc):
    """Write what a controller may learn of a car, and where it begins.

    order, mpc: `mpc.Order`, `mpc.MPCNumbers` with its filter. An uncertainty that the caller gives is never left; the
    default one of an unknown car is written to `mpc.unsure`.
    """
    method, start, car, within, belief = order.method, order.start, order.car, order.within, mpc.belief
    uncertainty, learner, p, period = mpc.unsure, mpc.learner, mpc.learner.parameters, order.world.period
    _copy_method(method, p.method)
    p.method.bias = given_or(method.bias, MAX_BIAS_RANGE)
    p.method.balance = given_or(method.balance, MAX_BALANCE_RANGE)
    _copy_car_with_moved_cg(car, method.rearward_share, within, learner.car)
    if order.unsure_given == 0:
        uncertainty.stiffness, uncertainty.mass = UNKNOWN_CAR_ROW.stiffness, UNKNOWN_CAR_ROW.mass
        if within.is_given > 0:
            uncertainty_of_car(within, belief, uncertainty)
        uncertainty.lag, uncertainty.dead_time = UNKNOWN_CAR_ROW.lag, UNKNOWN_CAR_ROW.dead_time
    _set_ranges(belief, uncertainty, order.unsure_given, learner)
    _set_hypotheses(method.lags, start.lag, start.lag_sigma, learner.lag)
    _set_hypotheses(method.dead_times, start.dead_time, start.dead_time_sigma, learner.dead_time)
    learner.longest = learner.dead_time.most + belief.computation
    learner.commands = whole(ceil((learner.longest + mpc.filter.oldest) / period)) + 4
    gust_ratio = car.frontal_area * car.side_force_slope / _USUAL_SIDE * WINDY / car.mass
    learner.wind = method.wind * clip(gust_ratio, LEAST_WINDY, MOST_WINDY)
    p.period, p.computation, p.lag = period, belief.computation, belief.steering.lag
    p.rate = math.inf if belief.source.rate == SLOW_ASSUMED else belief.steering.rate
    stiffness, mass = log(uncertainty.stiffness), log1p(uncertainty.mass)
    p.most_stiffness = stiffness + mass
    if order.unsure_given == 0:
        p.most_stiffness = max(p.most_stiffness, log(MAX_STIFFNESS_RANGE))
    p.prior_stiffness = UNIFORM_SIGMA * hypot(stiffness, mass)
    p.prior_balance = 2.0 * (UNIFORM_SIGMA * 0.5 * log(given_or(method.balance, UNKNOWN_BALANCE)))
    p.prior_bias = UNIFORM_SIGMA * given_or(method.bias, UNKNOWN_BIAS)
    measures_vy = mpc.filter.noise.vy < math.inf
    p.delay_tolerance = method.delay_tolerance if measures_vy else method.delay_tolerance_blind
    p.stiffness_tolerance = method.stiffness_tolerance if measures_vy else method.stiffness_tolerance_blind
    sensor_variances(mpc.filter.noise, p.variance)
    _set_first_belief(learner, start)
    _write_parameters(learner, p)


@inlined
def _hypothesis_delay(i, delays, middle, half):
    """Middle (s) of the i-th equal part of middle +- half, clipped to the range."""
    return clip(middle + half * ((2.0 * i + 1.0) / delays.count - 1.0), delays.low, delays.high)


@inlined
def _grain(delays, half):
    """Standard deviation of a delay (s) within a hypothesis."""
    return GRAIN * 2.0 * half / delays.count


@inlined
def _mean_and_variance(delays, middle, half):
    """Mean and variance of a delay (s) over equally likely hypotheses within middle +- half."""
    mean, variance = 0.0, 0.0
    for i in range(delays.count):
        mean += _hypothesis_delay(i, delays, middle, half)
    mean /= delays.count
    for i in range(delays.count):
        variance += square(_hypothesis_delay(i, delays, middle, half) - mean)
    return mean, variance / delays.count + square(_grain(delays, half))


@inlined
def _set_first_belief(learner, start):
    """Write the belief before the first sample."""
    lags, dead_times, b, p = learner.lag, learner.dead_time, learner.first, learner.parameters
    method = p.method
    lag, lag_variance = _mean_and_variance(lags, lags.middle, lags.half)
    dead_time, dead_variance = _mean_and_variance(dead_times, dead_times.middle, dead_times.half)
    sigma = sqrt(max(lag_variance + dead_variance, LEAST_VARIANCE))
    stiffness, stiffness_sigma = 0.0, p.prior_stiffness
    balance, balance_sigma = 0.0, 0.5 * p.prior_balance
    bias, bias_sigma = 0.0, p.prior_bias
    if not math.isnan(start.lag):
        stiffness = log(start.stiffness)
        stiffness_sigma = min(start.stiffness_sigma + MIN_STIFFNESS_SIGMA, stiffness_sigma)
        balance, balance_sigma = 0.5 * log(start.balance), min(start.balance_sigma, balance_sigma)
        bias, bias_sigma = start.bias, min(start.bias_sigma, bias_sigma)
    learner.start_stiffness, learner.start_balance = stiffness, balance
    b.belief_lag, b.belief_lag_sigma = lag, sqrt(lag_variance)
    b.belief_dead_time, b.belief_dead_time_sigma = dead_time, sqrt(dead_variance)
    b.belief_delay, b.belief_delay_sigma = lag + dead_time, sigma
    b.belief_stiffness, b.belief_stiffness_sigma = exp(stiffness), stiffness_sigma
    b.belief_balance, b.belief_balance_sigma = exp(2.0 * balance), 2.0 * balance_sigma
    b.belief_bias, b.belief_bias_sigma = bias, bias_sigma
    b.belief_bank, b.belief_bank_sigma = 0.0, method.bank
    b.belief_friction, b.belief_friction_sigma = method.friction, method.friction_sigma
    b.belief_change, b.belief_grip_use = 0.0, 0.0
    b.belief_noise, b.belief_state, b.belief_at_bound = 1.0, float(learning.LEARNING_BELIEF), 0.0
    later = method.delay_quantile / sigma
    b.used_lag = clip(lag + later * lag_variance, lags.least, lags.most)
    b.used_dead_time = clip(dead_time + later * dead_variance, dead_times.least, dead_times.most)
    b.used_stiffness, b.used_balance, b.used_bias = b.belief_stiffness, b.belief_balance, bias
    caution = min(1.0 + square(sigma / p.delay_tolerance), method.max_delay_caution)
    b.used_caution = caution * (1.0 + square(stiffness_sigma / p.stiffness_tolerance))


@exported(int64(Row(LearnerRow)))
def learner_size(learner):
    """Numbers that the learner remembers."""
    return _BEFORE + learner.commands + _HYPOTHESIS * learner.lag.count * learner.dead_time.count


@inlined
def _write_variances(learner, covariance):
    """Write the variances of a filter before the first sample."""
    method, first = learner.parameters.method, learner.first
    for state, sigma in (
        (learning.LATERAL_VELOCITY, 0.3), (learning.YAW_RATE, 0.1), (learning.OFFSET, 0.05),
        (learning.WIND_FORCE, learner.wind * sqrt(0.5 * method.wind_time)), (learning.BANK, method.bank),
        (learning.BIAS, first.belief_bias_sigma), (learning.STIFFNESS_SCALE, first.belief_stiffness_sigma),
        (learning.BALANCE, 0.5 * first.belief_balance_sigma), (learning.FRICTION, method.friction_sigma),
        (learning.STEERING_LAG, _grain(learner.lag, learner.lag.half)),
        (learning.DEAD_TIME, _grain(learner.dead_time, learner.dead_time.half)),
    ):  # fmt: skip
        covariance[state, state] = square(sigma)


@exported(void(Row(LearnerRow), Row(Filter), vector))
def learner_memory(learner, sensing, memory):
    """Write what is remembered before the first sample, `learner_size` numbers."""
    memory[:] = 0.0
    m, lags, dead_times = learning.memory_of(memory, 0), learner.lag, learner.dead_time
    _copy_beliefs(learner.first, m.beliefs)
    sensor_variances(sensing.noise, m.noise)
    for i in range(m.noise.size):
        m.noise[i] = m.noise[i] if m.noise[i] < math.inf else 0.0
    for i in range(lags.count):
        for j in range(dead_times.count):
            hypothesis = learning.hypothesis(i * dead_times.count + j, learner.commands, memory)
            x, dead_time = hypothesis.x, _hypothesis_delay(j, dead_times, dead_times.middle, dead_times.half)
            x[learning.STEERING_LAG] = _hypothesis_delay(i, lags, lags.middle, lags.half)
            x[learning.DEAD_TIME] = dead_time + learner.parameters.computation
            x[learning.FRICTION], x[learning.BIAS] = log(learner.parameters.method.friction), learner.first.belief_bias
            x[learning.STIFFNESS_SCALE], x[learning.BALANCE] = learner.start_stiffness, learner.start_balance
            _write_variances(learner, hypothesis.covariance)


@inlined
def _gauss_markov_drift(sigma, time):
    """Drift in a second of a Gauss-Markov process of a standard deviation and a correlation time (s)."""
    return sigma * sqrt(2.0 / time)


@inlined
def _first_variance(delays):
    """Variance of a delay (s) over its whole range."""
    _, variance = _mean_and_variance(delays, 0.5 * (delays.low + delays.high), 0.5 * (delays.high - delays.low))
    return variance


@inlined
def _write_drifts(learner, p):
    """Write the variances that a period adds, and the shares of a deviation that remain after it."""
    method, period = p.method, p.period
    p.drift_vy, p.drift_yaw_rate = square(method.drift_vy) * period, square(method.drift_yaw_rate) * period
    p.drift_wind, p.drift_bias = square(learner.wind) * period, square(method.drift_bias) * period
    p.drift_bank = square(_gauss_markov_drift(method.bank, method.bank_time)) * period
    p.drift_stiffness, p.drift_balance = square(method.drift_stiffness) * period, square(method.drift_balance) * period
    p.drift_friction = square(_gauss_markov_drift(method.friction_sigma, method.friction_time)) * period
    p.drift_delay, p.drift_wheels = square(method.drift_delay) * period, square(DEFAULT_DRIFTS.wheel_angle) * period
    p.wind_left, p.bank_left = exp(-period / method.wind_time), exp(-period / method.bank_time)
    p.friction_left, p.usual_friction = exp(-period / method.friction_time), log(method.friction)


@inlined
def _write_parameters(learner, p):
    """Write what follows from the ranges, the car and the method; the priors are those of the first drive."""
    car, method, period = learner.car, p.method, p.period
    lag, dead_time = _first_variance(learner.lag), _first_variance(learner.dead_time)
    p.prior_lag, p.prior_dead_time = sqrt(lag), sqrt(dead_time)
    p.prior_delay = sqrt(max(lag + dead_time, LEAST_VARIANCE))
    p.prior_friction = method.friction_sigma
    _write_drifts(learner, p)
    p.commands, p.hypotheses = float(learner.commands), float(learner.lag.count * learner.dead_time.count)
    _copy_single_track(car, p)
    p.stiffness_front, p.stiffness_rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    p.wind_turn = wind_turn(car)
    p.least_lag, p.most_lag = learner.lag.least, learner.lag.most
    p.least_dead_time, p.most_dead_time = learner.dead_time.least, learner.dead_time.most
    p.most_balance = 0.5 * log(method.balance)
    p.evidence_share = min(1.0, period / method.evidence_time)
    p.contradiction_share = min(1.0, period / method.contradiction_time)
    p.return_share, p.doubt_share = min(1.0, period / method.return_time), min(1.0, period / method.doubt_time)
    p.noise_share, p.change_share = min(1.0, period / method.noise_time), min(1.0, period / method.change_time)
    p.max_delay_step, p.max_stiffness_step = method.max_delay_rate * period, method.max_stiffness_rate * period
    p.max_bias_step = method.max_bias_rate * period


MAX_BIAS_PULL = 5.5
"""m/s^2, pull of an unknown steering bias with which a drive may begin: chosen on 1,990 unknown cars that began at 20
to 30 m/s, of which 14 of 1,095 above `first_top_speed` were lost and 0 of 895 below. Four times R loses these 14 as
well, R raised up to 30 times 10 of them and five others."""


@exported(float64(Row(LearnerRow)))
def first_top_speed(learner):
    """m/s, above which a drive should not begin; inf: no limit.

    There the largest steering bias of the prior pulls the assumed car by b v^2/(L + K v^2) = `MAX_BIAS_PULL`
    (Rajamani, Vehicle Dynamics and Control, 2nd ed., eq. (3.12)) before it is learned.
    """
    car, bias = learner.car, learner.first.belief_bias_sigma / UNIFORM_SIGMA
    length = car.lf + car.lr
    understeer = car.mass / (2.0 * length) * (car.lr / car.stiffness_front - car.lf / car.stiffness_rear)
    spare = bias - MAX_BIAS_PULL * understeer
    return sqrt(MAX_BIAS_PULL * length / spare) if spare > 0.0 else math.inf
