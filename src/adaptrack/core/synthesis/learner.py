"""The numbers of the learner (`estimators.learning`), and what it remembers before its first step."""

from __future__ import annotations

import math

from ..estimators import learning
from ..kernel import Row, exported, float64, inlined, int64, record, several, vector, void
from ..maths.bits import whole
from ..maths.exact import ceil, clip, sqrt, square
from ..maths.exponential import exp, hypot, log, log1p
from .belief import ASSUMED, Belief, Uncertainty, nobody_says, uncertainty_of_car
from .car import PASSENGER_CAR, SIDE_FORCE_SLOPE, Car, KnownWithin, given_or, wind_turn
from .filter import USUAL_DRIFTS, Filter, sensor_variances

Method = record(
    "Method",
    (
        "lags", "dead_times",  # hypotheses of each
        "bias", "balance",  # rad, factor: to either side; NaN: nobody says
        "rearward",
        "bank", "wind", "wind_time", "bank_time",  # m/s^2, m/s^2, s, s
        "friction", "friction_spread", "friction_time",  # -, -, s
        "drift_vy", "drift_yaw_rate", "drift_stiffness", "drift_balance", "drift_bias", "drift_delay",
        "sliding", "angle_error", "bound",  # s^0.5, rad, standard deviations
        "memory", "tempering", "modest", "cautious",
        "tolerated", "most_caution", "tolerated_stiffness", "doubting_caution",  # s, -, -, -; NaN: `TOLERATED`
        "unmodelled_lag", "unmodelled_dead_time", "unmodelled_delay",  # s
        "unmodelled_stiffness", "unmodelled_balance", "unmodelled_bias",  # -, -, rad
        "window", "returning", "doubting",  # s
        "longer", "shorter", "stiffer", "turning", "wandering",
        "noise", "noise_time",  # -, s
    ),
)  # fmt: skip
"""How a car is learned; `adaptrack.control.controllers.Learning` says what each number is."""
USUAL = Method(
    lags=2, dead_times=2, bias=math.nan, balance=math.nan, rearward=1.0, bank=0.2, wind=0.35, wind_time=3.0,
    bank_time=20.0, friction=0.7, friction_spread=0.4, friction_time=15.0, drift_vy=0.03, drift_yaw_rate=0.02,
    drift_stiffness=0.003, drift_balance=0.0005, drift_bias=0.00003, drift_delay=0.0005, sliding=0.1, angle_error=0.002,
    bound=5.0, memory=120.0, tempering=0.5, modest=2.0, cautious=0.5, tolerated=math.nan, most_caution=16.0,
    tolerated_stiffness=math.nan, doubting_caution=4.0, unmodelled_lag=0.03, unmodelled_dead_time=0.02,
    unmodelled_delay=0.015, unmodelled_stiffness=0.1, unmodelled_balance=0.3, unmodelled_bias=0.0015, window=3.0,
    returning=3.0, doubting=1.0, longer=2.0, shorter=2.0, stiffer=5.0, turning=0.1, wandering=0.05, noise=4.0,
    noise_time=20.0,
)  # fmt: skip
_USUAL = tuple(map(float, USUAL))
Start = record(
    "Start", ("lag", "lag_sigma", "dead_time", "dead_time_sigma", "stiffness", "stiffness_sigma", "balance",
              "balance_sigma", "bias", "bias_sigma"),
)  # fmt: skip
"""What an earlier drive has learned, each with its standard deviation; a lag of NaN: there was none."""
Learner = record(
    "Learner",
    (
        ("car", Car),  # as believed
        "period", "computation", "rate", "lag",  # s, s, rad/s, s: as believed
        "least_lag", "most_lag", "least_dead_time", "most_dead_time",  # s, at first
        "lag_end", "lag_limit", "dead_time_end", "dead_time_limit",  # s, never left
        "lag_middle", "lag_half", "dead_time_middle", "dead_time_half",  # s, what they may be at first: middle +- half
        "lags", "dead_times",  # hypotheses
        "stiffness", "balance", "bias",  # ln and factor, likewise never left; rad
        "stiffness_spread",  # standard deviation of the logarithm at first
        "wind",  # m/s^2, by which side wind changes in a second
        "tolerated", "tolerated_stiffness",
        "longest",  # s, of dead time and computation
        "kept",  # commands that are remembered
    ),
    integers=("lags", "dead_times", "kept"),
)  # fmt: skip
"""What a learner may learn, and where it begins."""
First = record(
    "First",
    (
        "lag", "lag_sigma", "dead_time", "dead_time_sigma", "delay_sigma", "stiffness", "stiffness_sigma", "balance",
        "balance_sigma", "bias", "bias_sigma", "used_lag", "used_dead_time", "used_caution",
    ),
)  # fmt: skip
"""The belief before the first sample; logarithms of stiffness and half of balance as the filters have them."""

UNKNOWN_CAR = Uncertainty(lag=0.19, dead_time=0.175, stiffness=2.0, mass=0.3)
"""How far the belief may be wrong where nobody says: published delays are 0.05 to 0.6 s. Stiffness and mass of a car
whose file says how well it is known (``[known_within]``) are taken from there."""
UNKNOWN_BALANCE, UNKNOWN_BIAS = 2.0, 0.035
"""Factor of front over rear stiffness, and rad, likewise: K from -0.5 to 5 deg/g about a data sheet's 1.5, see
`car.AXLE_COEFFICIENTS`; a wheel that is two degrees off."""
MIDDLE = (0.21, 0.175)
"""s, lag and dead time in the middle of published values, believed where nobody says."""
MOST_LAG, MOST_DEAD_TIME = 0.6, 0.5
"""s, to which a range that nobody gave widens: the longest delay that is published, see `UNKNOWN_CAR`."""
MOST_STIFFNESS, MOST_BALANCE, MOST_BIAS = 4.0, 4.0, 0.07
"""Factors and rad, likewise: axles of 5 to 60 1/rad over their load, beyond what a data sheet names; 4 degrees."""
LEAST_LAG = learning.SHORTEST_LAG
GRAIN = 0.4
"""Standard deviation within a hypothesis over the distance of two: together they are nearly even."""
LEAST_UNSURE, LEAST_CHANGED = 0.02, 0.05
"""s, by which lag and dead time of an earlier drive may be off; -, likewise the logarithm of its stiffness."""
SPREAD = 1.0 / math.sqrt(3.0)
"""Standard deviation of what may be anywhere within +-1."""
TOLERATED_WITH_VY, TOLERATED = (0.12, 0.6), (0.3, 2.0)
"""Standard deviations of the delay (s) and of the logarithm of the stiffness that double R, where the lateral velocity
is measured, and where it is not: there R is larger already (`tuning.UNSEEN`)."""
LEAST_VARIANCE = 1e-8
"""s^2, of lag and dead time together."""
WINDY = 1500.0
"""kg, of a car whose wind `Method.wind` is: it acts on a car by area and slope of the side force over the mass."""
LEAST_WINDY, MOST_WINDY = 0.5, 4.0
"""Factors on it."""
_BEFORE = learning.memory_size(0, 0)
_HYPOTHESIS = learning.memory_size(0, 1) - _BEFORE
_USUAL_SIDE = SIDE_FORCE_SLOPE * PASSENGER_CAR.frontal_area


@exported(void(vector))
def usual_method(numbers):
    """Write `USUAL` to the numbers of a `Method`."""
    for i in range(len(_USUAL)):
        numbers[i] = _USUAL[i]


@inlined
def _place(low, high, learned, sigma):
    """Middle, and half the width, of what a delay (s) may be at first; learned, sigma: in an earlier drive, or NaN."""
    if math.isnan(learned):
        return 0.5 * (low + high), 0.5 * (high - low)
    return clip(learned, low, high), max(sigma, LEAST_UNSURE) / SPREAD if high > low else 0.0


@inlined
def _ranges(belief, unsure, given, own):
    """Within which lag and dead time are: around what is believed, or the middle of published values."""
    lag = MIDDLE[0] if nobody_says(belief.lag_source) else belief.lag
    dead = MIDDLE[1] if nobody_says(belief.dead_time_source) else belief.dead_time
    own.least_lag, own.most_lag = max(lag - unsure.lag, LEAST_LAG), max(lag + unsure.lag, LEAST_LAG)
    own.least_dead_time, own.most_dead_time = max(dead - unsure.dead_time, 0.0), dead + unsure.dead_time
    if given > 0:
        own.lag_end, own.lag_limit = own.least_lag, own.most_lag
        own.dead_time_end, own.dead_time_limit = own.least_dead_time, own.most_dead_time
    else:
        own.lag_end, own.lag_limit = LEAST_LAG, max(MOST_LAG, own.most_lag)
        own.dead_time_end, own.dead_time_limit = 0.0, max(MOST_DEAD_TIME, own.most_dead_time)


@inlined
def _be(car, rearward, within, own):
    """The car with so much of what is open of its centre of mass further back."""
    own.mass, own.yaw_inertia = car.mass, car.yaw_inertia
    own.stiffness_front, own.stiffness_rear = car.stiffness_front, car.stiffness_rear
    own.frontal_area, own.cg_height = car.frontal_area, car.cg_height
    own.track_front, own.track_rear = car.track_front, car.track_rear
    own.side_force_slope, own.yaw_moment_slope = car.side_force_slope, car.yaw_moment_slope
    own.lf, own.lr = car.lf, car.lr
    if within.said > 0 and within.lf > 0.0 and rearward != 0.0:
        own.lf = car.lf + rearward * within.lf
        own.lr = car.lf + car.lr - own.lf


@exported(
    void(
        Row(Method), Row(Start), Row(Car), Row(KnownWithin), Row(Belief), Row(Uncertainty), int64, Row(Filter), float64,
        Row(Learner),
    )
)  # fmt: skip
def begin_learner(method, start, car, within, belief, unsure, given, sensing, period, own):
    """Write what a controller may learn of a car, and where it begins.

    unsure: how far car and belief may be wrong; given: 1: by the caller, so never to be left, 0: nobody says, and what
    is taken instead is written there. sensing: the filter, with its sensors; period: s.
    """
    _be(car, method.rearward, within, own.car)
    if given == 0:
        unsure.stiffness, unsure.mass = UNKNOWN_CAR.stiffness, UNKNOWN_CAR.mass
        if within.said > 0:
            uncertainty_of_car(within, belief, unsure)
        unsure.lag, unsure.dead_time = UNKNOWN_CAR.lag, UNKNOWN_CAR.dead_time
    _ranges(belief, unsure, given, own)
    own.lag_middle, own.lag_half = _place(own.least_lag, own.most_lag, start.lag, start.lag_sigma)
    own.dead_time_middle, own.dead_time_half = _place(
        own.least_dead_time, own.most_dead_time, start.dead_time, start.dead_time_sigma
    )
    own.lags = whole(method.lags) if own.lag_half > 0.0 else 1
    own.dead_times = whole(method.dead_times) if own.dead_time_half > 0.0 else 1
    own.period, own.computation, own.lag = period, belief.computation, belief.lag
    own.rate = math.inf if belief.rate_source == ASSUMED else belief.rate
    stiffness, mass = log(unsure.stiffness), log1p(unsure.mass)
    own.stiffness = stiffness + mass if given > 0 else max(stiffness + mass, log(MOST_STIFFNESS))
    own.stiffness_spread = SPREAD * hypot(stiffness, mass)
    own.balance, own.bias = given_or(method.balance, UNKNOWN_BALANCE), given_or(method.bias, UNKNOWN_BIAS)
    found = car.frontal_area * car.side_force_slope / _USUAL_SIDE * WINDY / car.mass
    own.wind = method.wind * clip(found, LEAST_WINDY, MOST_WINDY)
    delay, stiff = TOLERATED_WITH_VY if sensing.noise.vy < math.inf else TOLERATED
    own.tolerated = given_or(method.tolerated, delay)
    own.tolerated_stiffness = given_or(method.tolerated_stiffness, stiff)
    own.longest = own.dead_time_limit + own.computation
    own.kept = whole(ceil((own.longest + sensing.oldest) / period)) + 3


@inlined
def _at(i, count, middle, half, low, high):
    """Middle (s) of the i-th of so many equal parts of middle +- half, within what it may be."""
    return clip(middle + half * ((2.0 * i + 1.0) / count - 1.0), low, high)


@inlined
def _grain(count, half):
    """Standard deviation of a delay (s) within a hypothesis."""
    return GRAIN * 2.0 * half / count


@inlined
def _mean_and_variance(count, middle, half, low, high):
    """Of a delay (s) over hypotheses that are as likely as each other."""
    mean, variance = 0.0, 0.0
    for i in range(count):
        mean += _at(i, count, middle, half, low, high)
    mean /= count
    for i in range(count):
        variance += square(_at(i, count, middle, half, low, high) - mean)
    return mean, variance / count + square(_grain(count, half))


@inlined
def _first(own, method, start):
    """The belief before the first sample."""
    lag, lag_variance = _mean_and_variance(own.lags, own.lag_middle, own.lag_half, own.least_lag, own.most_lag)
    dead, dead_variance = _mean_and_variance(
        own.dead_times, own.dead_time_middle, own.dead_time_half, own.least_dead_time, own.most_dead_time
    )
    sigma = sqrt(max(lag_variance + dead_variance, LEAST_VARIANCE))
    later = method.cautious / sigma
    stiffness, unsure = 0.0, own.stiffness_spread
    balance, uneven = 0.0, SPREAD * 0.5 * log(own.balance)
    bias, off = 0.0, SPREAD * own.bias
    if not math.isnan(start.lag):
        stiffness, unsure = log(start.stiffness), min(start.stiffness_sigma + LEAST_CHANGED, unsure)
        balance, uneven = 0.5 * log(start.balance), min(start.balance_sigma, uneven)
        bias, off = start.bias, min(start.bias_sigma, off)
    caution = min(1.0 + square(sigma / own.tolerated), method.most_caution)
    return First(
        lag, sqrt(lag_variance), dead, sqrt(dead_variance), sigma, stiffness, unsure, balance, uneven, bias, off,
        clip(lag + later * lag_variance, own.lag_end, own.lag_limit),
        clip(dead + later * dead_variance, own.dead_time_end, own.dead_time_limit),
        caution * (1.0 + square(unsure / own.tolerated_stiffness)),
    )  # fmt: skip


@exported(several(float64, float64, float64)(Row(Learner), Row(Method), Row(Start)))
def first_delay(own, method, start):
    """Lag and dead time (s) that the controller begins with, and the standard deviation of both together."""
    first = _first(own, method, start)
    return first.used_lag, first.used_dead_time, first.delay_sigma


@exported(int64(Row(Learner)))
def learner_size(own):
    """Numbers that the learner remembers."""
    return _BEFORE + own.kept + _HYPOTHESIS * own.lags * own.dead_times


@inlined
def _spread(p, state, deviation):
    p[state, state] = square(deviation)


@inlined
def _write_spread(own, method, first, p):
    """Variances of a filter before the first sample."""
    _spread(p, learning.VY, 0.3)
    _spread(p, learning.RATE, 0.1)
    _spread(p, learning.WIND, own.wind * sqrt(0.5 * method.wind_time))
    _spread(p, learning.BIAS, first.bias_sigma)
    _spread(p, learning.BANK, method.bank)
    _spread(p, learning.STIFFNESS, first.stiffness_sigma)
    _spread(p, learning.BALANCE, first.balance_sigma)
    _spread(p, learning.FRICTION, method.friction_spread)
    _spread(p, learning.LAG, _grain(own.lags, own.lag_half))
    _spread(p, learning.DEAD_TIME, _grain(own.dead_times, own.dead_time_half))
    _spread(p, learning.OFFSET, 0.05)


@exported(void(Row(Learner), Row(Method), Row(Start), Row(Filter), vector))
def learner_memory(own, method, start, sensing, memory):
    """Write what is remembered before the first sample, `learner_size` numbers."""
    memory[:] = 0.0
    m, first = learning.memory_of(memory, 0), _first(own, method, start)
    sensor_variances(sensing.noise, m.noise)
    for i in range(m.noise.size):
        m.noise[i] = m.noise[i] if m.noise[i] < math.inf else 0.0
    for i in range(own.lags):
        lag = _at(i, own.lags, own.lag_middle, own.lag_half, own.least_lag, own.most_lag)
        for j in range(own.dead_times):
            dead = _at(
                j, own.dead_times, own.dead_time_middle, own.dead_time_half, own.least_dead_time, own.most_dead_time
            )
            each = learning.hypothesis(i * own.dead_times + j, own.kept, memory)
            each.x[learning.LAG], each.x[learning.DEAD_TIME] = lag, dead + own.computation
            each.x[learning.FRICTION], each.x[learning.BIAS] = log(method.friction), first.bias
            each.x[learning.STIFFNESS], each.x[learning.BALANCE] = first.stiffness, first.balance
            _write_spread(own, method, first, each.covariance)
    b = m.beliefs
    b.belief_lag, b.belief_lag_sigma = first.lag, first.lag_sigma
    b.belief_dead_time, b.belief_dead_time_sigma = first.dead_time, first.dead_time_sigma
    b.belief_delay, b.belief_delay_sigma = first.lag + first.dead_time, first.delay_sigma
    b.belief_stiffness, b.belief_stiffness_sigma = exp(first.stiffness), first.stiffness_sigma
    b.belief_balance, b.belief_balance_sigma = exp(2.0 * first.balance), 2.0 * first.balance_sigma
    b.belief_bias, b.belief_bias_sigma = first.bias, first.bias_sigma
    b.belief_bank_sigma = method.bank
    b.belief_friction, b.belief_friction_sigma = method.friction, method.friction_spread
    b.belief_noise = 1.0
    b.used_lag, b.used_dead_time = first.used_lag, first.used_dead_time
    b.used_stiffness, b.used_balance, b.used_bias = b.belief_stiffness, b.belief_balance, first.bias
    b.used_caution, b.belief_state = first.used_caution, float(learning.LEARNING)


@inlined
def _gauss_markov(spread, time):
    """What a process of a standard deviation, over in a time (s), drifts by in a second."""
    return spread * sqrt(2.0 / time)


@inlined
def _write_priors(own, p):
    """Standard deviations before the first sample of the first drive."""
    low, high = own.least_lag, own.most_lag
    _, lag = _mean_and_variance(own.lags, 0.5 * (low + high), 0.5 * (high - low), low, high)
    low, high = own.least_dead_time, own.most_dead_time
    _, dead = _mean_and_variance(own.dead_times, 0.5 * (low + high), 0.5 * (high - low), low, high)
    p.prior_lag, p.prior_dead_time, p.prior_delay = sqrt(lag), sqrt(dead), sqrt(max(lag + dead, LEAST_VARIANCE))
    p.prior_stiffness, p.prior_bias = own.stiffness_spread, SPREAD * own.bias
    p.prior_balance = 2.0 * (SPREAD * 0.5 * log(own.balance))


@exported(void(Row(Learner), Row(Method), Row(Filter), vector))
def learner_numbers(own, method, sensing, numbers):
    """Write `learning.Numbers`; its priors are those before the first sample of the first drive."""
    p, car, period = learning.parameters_of(numbers, 0), own.car, own.period
    _write_priors(own, p)
    p.period, p.computation, p.lag, p.kept = period, own.computation, own.lag, float(own.kept)
    p.hypotheses = float(own.lags * own.dead_times)
    p.mass, p.yaw_inertia, p.lf, p.lr = car.mass, car.yaw_inertia, car.lf, car.lr
    p.stiffness_front, p.stiffness_rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    p.wind_turn, p.rate = wind_turn(car), own.rate
    p.bound, p.tempering, p.forgetting = method.bound, method.tempering, min(1.0, period / method.memory)
    p.drift_vy, p.drift_yaw_rate = square(method.drift_vy) * period, square(method.drift_yaw_rate) * period
    p.drift_wind, p.drift_bias = square(own.wind) * period, square(method.drift_bias) * period
    p.drift_bank = square(_gauss_markov(method.bank, method.bank_time)) * period
    p.drift_stiffness, p.drift_balance = square(method.drift_stiffness) * period, square(method.drift_balance) * period
    p.drift_friction = square(_gauss_markov(method.friction_spread, method.friction_time)) * period
    p.drift_lag = p.drift_dead_time = square(method.drift_delay) * period
    p.drift_wheels = square(USUAL_DRIFTS.wheel_angle) * period
    p.wind_left, p.bank_left = exp(-period / method.wind_time), exp(-period / method.bank_time)
    p.friction_left, p.usual_friction = exp(-period / method.friction_time), log(method.friction)
    p.sliding, p.angle_error = square(method.sliding), square(method.angle_error)
    p.least_lag, p.most_lag = own.lag_end, own.lag_limit
    p.least_dead_time, p.most_dead_time = own.dead_time_end, own.dead_time_limit
    p.most_stiffness, p.most_balance = own.stiffness, 0.5 * log(given_or(method.balance, MOST_BALANCE))
    p.most_bias = given_or(method.bias, MOST_BIAS)
    p.modest, p.cautious, p.most_caution = method.modest, method.cautious, method.most_caution
    p.tolerated, p.tolerated_stiffness = own.tolerated, own.tolerated_stiffness
    p.doubting_caution = method.doubting_caution
    p.unmodelled_lag, p.unmodelled_dead_time = method.unmodelled_lag, method.unmodelled_dead_time
    p.unmodelled_delay, p.unmodelled_stiffness = method.unmodelled_delay, method.unmodelled_stiffness
    p.unmodelled_balance, p.unmodelled_bias = method.unmodelled_balance, method.unmodelled_bias
    p.window, p.returning = min(1.0, period / method.window), min(1.0, period / method.returning)
    p.doubting = min(1.0, period / method.doubting)
    p.longer, p.shorter = method.longer * period, method.shorter * period
    p.stiffer, p.turning, p.wandering = method.stiffer * period, method.turning * period, method.wandering
    p.noise_share, p.noise_range = min(1.0, period / method.noise_time), method.noise
    sensor_variances(sensing.noise, p.variance)
