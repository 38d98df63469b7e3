"""Friction of the road as an interval: a bank of Kalman filters of the lateral motion.

Each hypothesis is the single-track vehicle with a coefficient of friction and a shape of the tyres' curve:

    dv_y/dt = (F_f + F_r)/m + wind + bank - v_x r,   dr/dt = (l_f F_f - l_r F_r)/I_z + turn wind

The largest force of an axle is its load times the largest steady lateral acceleration over g, which load transfer
lowers; what it does to the curve is a part of the unknown shape. Drive and brake forces leave less, by the friction
circle. The filter estimates [v_y, r, steering bias, ln stiffness, ln balance, wind, bank] from the yaw rate and, where
they are measured, lateral acceleration and velocity. The wheels follow the commands behind dead time, lag and rate
limit; a sample is compared with the motion at its own time. The score of a hypothesis sums the likelihoods of its
innovations; a friction has the score of its better shape. A filter that is refuted follows the best one.

Friction shows only where the tyres are near their limit. The low end rises only there; without excitation the interval
returns with the distance to the given one, in which the frictions begin with equal weights. It returns at once where
the samples of the last half second show that the friction has fallen (a generalised likelihood ratio). The acceleration
that the tyres certainly use is a lower bound.
"""

from __future__ import annotations

import math

from ..estimators.extended_kalman import bounded, carry, correct, scatter, step_motion
from ..estimators.friction_wind import steered
from ..estimators.learning import LEARNING_BELIEF, memory_of
from ..kernel import columns, exported, fields_of, float64, inlined, local, record, rows, vector, void
from ..maths.bits import whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.exponential import exp, log
from ..maths.fast import fast_arctangent_of_ratio
from ..maths.vectors import VECTOR_WIDTH
from ..models.car import LearnedRow, unpack
from ..models.contract import MEASUREMENT, PERIOD_FIELD
from ..physics.forces import GRAVITY, SLIP_SPEED_FLOOR, wind_load
from ..physics.tyre import BRUSH_SHAPE, LEAST_LOAD, curve, force_and_slope, friction_ellipse
from ..synthesis.car import usable_friction
from ..tracker.signals import TRACKER_SAMPLE
from .learning import mean_of_bank
from .speed_control import cell_at

_Z = columns(
    "vy", "yaw_rate",  # m/s, rad/s
    "bias",  # rad, of the steering, against what is known
    "stiffness", "balance",  # -, -: logarithms, against what is known
    "wind", "bank",  # m/s^2, of the air, which an accelerometer feels, and of the road, which it does not
)  # fmt: skip
"""State of a filter."""
_COUNT = len(_Z)

FRICTION_HYPOTHESIS = record(
    "FrictionHypothesis",
    (
        "friction", "grip",  # -, -: of the tyres; largest steady lateral acceleration over g
        "tyre_shape",  # of the tyre's curve, see `physics.tyre.TyreCurve`
        "score", "evidence",  # logarithm of the weight, and of the likelihood of the last sample
        "recent",  # logarithm of the likelihood of the samples of `RECENT_TIME`, over that of the best
        ("x", (float64, VECTOR_WIDTH)), ("covariance", (float64, _COUNT, VECTOR_WIDTH)),
    ),
)  # fmt: skip
"""A coefficient of friction and a shape of the tyre's curve with their filter."""
LateralMotion = record(
    "LateralMotion",
    (
        "speed", "force", "pull",  # m/s; N, of drive and brakes; m/s^2, of a banked road
        "along",  # m/s^2, acceleration that has moved the load
        ("knowledge", LearnedRow),
    ),
)  # fmt: skip
"""What all hypotheses share in a period."""
FrictionSample = record(
    "FrictionSample",
    (
        *fields_of(TRACKER_SAMPLE)[TRACKER_SAMPLE.speed : TRACKER_SAMPLE.wheel_angle],
        "age",  # s, of the motion
        "command",  # rad, of the steering, sent in the last period
    ),
)  # fmt: skip
"""What is known at a control instant; the lateral acceleration does not feel the pull of a bank."""
FRICTION_MEMORY = record(
    "FrictionMemory",
    (
        "running",  # 1 while the filters follow the motion
        "friction", "low", "high",  # -, mean and ends of the interval; the low one as largest steady a_y over g
        "least",  # -, low end as friction of the tyres, of which `low` is what a bend can use
        "surprise",  # -, mean of the squared innovations over what is assumed of them, of the best filter
        "age",  # m, since the tyres were last excited, at most `RETURN_DISTANCE`
        "used",  # -, friction that the tyres certainly use at present
        "angle", "sample_age",  # rad, s: wheels and age of the last sample
        "yaw_rate", "along",  # rad/s, last measured; m/s^2, acceleration that has moved the load
        "pull",  # m/s^2, used acceleration over a moment
        "lateral_velocity",  # m/s, mean of the filters
    ),
)  # fmt: skip
"""What a friction estimate remembers besides its hypotheses, and its answer."""

FrictionEstimate = record(
    "FrictionEstimate",
    (
        ("memory", rows(FRICTION_MEMORY)), ("bank", rows(FRICTION_HYPOTHESIS)), ("commands", vector), ("car", vector),
        PERIOD_FIELD, ("variances", vector), ("low", float64), ("high", float64), ("shape", float64),
        ("reserve", float64), ("knowledge", LearnedRow),
    ),
)  # fmt: skip
"""An estimate: hypotheses, ascending, none of a friction that is certain; commands that were sent (rad), the latest
first; `PLANT_PARAMETERS`; s; variances of the sensors: of lateral velocity, yaw rate and lateral acceleration, inf:
none; ends of the interval at the start; steering and tyres where none are learned."""

SUBSTEPS = 2
"""Of a control period."""
LEAST_SPEED = 4.0
"""m/s, below which the filters wait."""
TAIL = 0.05
"""Probability outside either end of the interval."""
MODEL_ERROR = 0.03
"""Of the friction, by which the model of the car widens the interval to either side."""
RETURN_DISTANCE, EXCITED_SHARE, TELLING_SHARE = 300.0, 0.7, 0.4
"""m without excitation, over which the interval returns to what was told; -, used shares of the low end: that excites;
from which on samples tell frictions apart."""
LEAST_SCORE = -6.0
"""Of a hypothesis, so that a friction that falls is noticed soon."""
RISE_DISTANCE = 25.0
"""m, over which the low end rises."""
WIDTH_CAUTION, LARGEST_CAUTION = 0.35, 0.15
"""Share of the low end that bends ahead and drive forces do not use, over the width of the interval relative to its
high end; at most. Brakes use the low end."""
CERTAIN_RESERVE = 0.1
"""Share of a friction that is certain which bends ahead and drive forces do not use while the steering is learned, or
the driven axle is assumed."""
EVIDENCE_SHARE = 0.2
"""Of the log-likelihood of a sample: errors of the model last for some samples."""
RECENT_TIME, LEAST_RECENT, FALL_EVIDENCE, FALL_SHARE = 0.5, -2.5, 0.4, 0.75
"""s, over which evidence counts as recent, and its least logarithm. The friction has fallen where a lower one explains
recent samples better by this logarithm than the low end and all above, and the tyres use this share of it."""
SURPRISE_TIME, LEAST_SURPRISE = 5.0, 0.3
"""s, over which larger innovations than assumed are noticed: samples then count less."""
FRICTION_INNOVATION_BOUND = 3.0
"""Standard deviations up to which an innovation counts."""
VELOCITY_ERROR, YAW_RATE_ERROR, ACCELERATION_ERROR = 0.05, 0.01, 0.2
"""m/s, rad/s, m/s^2: standard deviations of the model's own errors, besides the noise of the sensors."""
DRIFT_VELOCITY, DRIFT_YAW_RATE = 0.05, 0.01
"""m/s and rad/s after a second: random walks besides the model."""
TYRE_ERROR = 0.02
"""s^0.5, white noise on the force of an axle, over that force."""
WIND_SIGMA, BANK_SIGMA, SIDE_TIME, KNOWLEDGE_TIME = 0.5, 0.3, 5.0, 30.0
"""m/s^2, m/s^2 and s, of side wind and unmapped bank; s, of stiffness, balance and bias against what is known."""
FIRST_VARIANCE = 0.25
"""(m/s)^2, of a lateral velocity that is not known."""
LARGEST_VARIANCE, LARGEST_YAW_ERROR, LARGEST_DEVIATION = 4.0, 0.5, 3.0
"""(m/s)^2 and rad/s, beyond which a filter is lost; standard deviations from what is known."""
USED_TIME, USED_SIGMAS, USED_ERROR, USED_SCALE = 0.3, 1.64, 0.15, 0.03
"""s, over which the used acceleration is averaged. It counts less so many standard deviations of wind and bank, an
error of the sensor (m/s^2), and a share for the scale of the speed and a peak that is no steady one."""
PESSIMISTIC_SHAPE = 1.9
"""Of an unknown curve that softens late: with it, a softening that is seen means the least friction."""

_states, _motion = local(VECTOR_WIDTH), local(2, VECTOR_WIDTH)


@inlined
def _axle(slip, load, along, stiffness, h, c):
    """Lateral force (N) of an axle and its derivative by the slip angle; along: N, its drive or brake force.

    stiffness: N/rad, of one tyre at the nominal load.
    """
    load = max(load, LEAST_LOAD)
    q = 0.5 * load / c.nominal_load
    stiffness *= 2.0 * (c.stiffness_load_0 + c.stiffness_load_1 * q) / (1.0 + c.stiffness_load_2 * q * q)
    left = friction_ellipse(clip(along, -h.grip * load, h.grip * load), load, h.grip)
    force, slope = force_and_slope(slip, curve(load, stiffness, h.grip, h.tyre_shape))
    return left * force, left * slope


@inlined
def _accelerations(h, angle, motion, c, slopes):
    """Acceleration of the tyres (m/s^2), yaw acceleration (rad/s^2) and both axle forces (N) of a hypothesis.

    Derivatives of the first two by the state are written to slopes (2, 8).
    """
    x, wheelbase, knowledge, speed, force = h.x, c.lf + c.lr, motion.knowledge, motion.speed, motion.force
    factor = knowledge.stiffness * exp(x[_Z.stiffness])
    balance = knowledge.balance * exp(x[_Z.balance])
    wheel = angle + knowledge.bias + x[_Z.bias]
    pitch = c.mass * c.cg_height / wheelbase * motion.along
    front_share = c.drive_front if force > 0.0 else c.brake_front
    side_f, side_r = x[_Z.vy] + c.lf * x[_Z.yaw_rate], x[_Z.vy] - c.lr * x[_Z.yaw_rate]
    slip_f = wheel - fast_arctangent_of_ratio(side_f, speed)
    slip_r = -fast_arctangent_of_ratio(side_r, speed)
    weight = c.mass * GRAVITY / wheelbase
    front, by_front = _axle(
        slip_f, weight * c.lr - pitch, front_share * force, factor * sqrt(balance) * c.stiffness_front, h, c
    )
    rear, by_rear = _axle(
        slip_r, weight * c.lf + pitch, (1.0 - front_share) * force, factor / sqrt(balance) * c.stiffness_rear, h, c
    )
    of_front, of_rear = _states(), _states()
    of_front[_Z.vy] = -by_front * speed / (speed * speed + side_f * side_f)
    of_rear[_Z.vy] = -by_rear * speed / (speed * speed + side_r * side_r)
    of_front[_Z.yaw_rate], of_rear[_Z.yaw_rate] = c.lf * of_front[_Z.vy], -c.lr * of_rear[_Z.vy]
    of_front[_Z.bias] = by_front
    of_front[_Z.stiffness], of_rear[_Z.stiffness] = by_front * slip_f, by_rear * slip_r
    of_front[_Z.balance], of_rear[_Z.balance] = 0.5 * of_front[_Z.stiffness], -0.5 * of_rear[_Z.stiffness]
    by_mass, by_inertia = 1.0 / c.mass, 1.0 / c.yaw_inertia
    air, twist, _ = wind_load(0.0, speed, x[_Z.vy], 0.0, 0.0, c)
    for j in range(_COUNT):
        slopes[_Z.vy, j] = (of_front[j] + of_rear[j]) * by_mass
        slopes[_Z.yaw_rate, j] = (c.lf * of_front[j] - c.lr * of_rear[j]) * by_inertia
    turned = front_share * force * wheel  # N, of the force along the front wheels
    yawing = c.lf * (front + turned) - c.lr * rear + twist
    return (front + rear + turned + air) * by_mass, yawing * by_inertia, front, rear


@inlined
def _sigmas(knowledge):
    """Standard deviations of the states from the steering bias on."""
    return knowledge.bias_sigma, knowledge.stiffness_sigma, knowledge.balance_sigma, WIND_SIGMA, BANK_SIGMA


@inlined
def _predict(h, angle, turning, step, motion, c):
    """Carry a filter over a step (s) by the linearised trapezoidal rule; turning: rad/s, of the wheels."""
    x, P, slopes, mixed = h.x, h.covariance, _motion(), _motion()
    speed, knowledge = motion.speed, motion.knowledge
    lateral, yawing, front, rear = _accelerations(h, angle, motion, c, slopes)
    push, twist = slopes[_Z.vy, _Z.bias], slopes[_Z.yaw_rate, _Z.bias]
    turn = 0.0  # rad/s^2 over m/s^2, of the wind
    if c.side_force_slope > 0.0:
        turn = (c.lf + c.lr) * c.yaw_moment_slope * c.mass / (c.side_force_slope * c.yaw_inertia)
    slopes[_Z.vy, _Z.yaw_rate] -= speed
    slopes[_Z.vy, _Z.wind], slopes[_Z.vy, _Z.bank], slopes[_Z.yaw_rate, _Z.wind] = 1.0, 1.0, turn
    lateral += motion.pull + x[_Z.wind] + x[_Z.bank]
    yawing += turn * x[_Z.wind]
    step_motion(lateral - speed * x[_Z.yaw_rate], yawing, step, slopes, _COUNT, x, mixed)
    shares, sigmas = _states(), _sigmas(knowledge)
    for j in range(_Z.bias, _COUNT):
        shares[j] = exp(-step / (SIDE_TIME if j >= _Z.wind else KNOWLEDGE_TIME))
    carry(mixed, shares, P, _motion())
    for j in range(_Z.bias, _COUNT):
        x[j] *= shares[j]
        P[j, j] += square(sigmas[j - _Z.bias]) * (1.0 - square(shares[j]))
    front, rear = TYRE_ERROR * front, TYRE_ERROR * rear
    late = turning * knowledge.delay_sigma  # rad, error of the wheels by that of the delay, which lasts a step
    pushed, twisted = step * late * push, step * late * twist
    slides = (front * front + rear * rear) / square(c.mass)
    P[_Z.vy, _Z.vy] += step * (square(DRIFT_VELOCITY) + slides) + pushed * pushed
    both = step * (c.lf * front * front - c.lr * rear * rear) / (c.mass * c.yaw_inertia) + pushed * twisted
    P[_Z.vy, _Z.yaw_rate] += both
    P[_Z.yaw_rate, _Z.vy] += both
    turns = (square(c.lf * front) + square(c.lr * rear)) / square(c.yaw_inertia)
    P[_Z.yaw_rate, _Z.yaw_rate] += step * (square(DRIFT_YAW_RATE) + turns) + twisted * twisted


@inlined
def _take_in(value, reading, variance, slope, h):
    """Correct a filter by a sensor; return the log-likelihood, at a spread that all hypotheses share.

    slope: derivatives of its reading by the state.
    """
    if value != value or not variance < math.inf:
        return 0.0
    cross, innovation = _states(), value - reading
    spread = scatter(variance, slope, h.covariance, cross)
    surprise = min(square(innovation) / variance, square(FRICTION_INNOVATION_BOUND))
    correct(bounded(innovation, spread, FRICTION_INNOVATION_BOUND), spread, cross, h.x, h.covariance)
    return -0.5 * surprise


@inlined
def _correct(h, angle, sample, motion, variances, c):
    """Take in the sensors of a sample; return the log-likelihood."""
    slope = _states()
    of_velocity, of_yaw_rate = variances[0] + square(VELOCITY_ERROR), variances[1] + square(YAW_RATE_ERROR)
    of_acceleration = variances[2] + square(ACCELERATION_ERROR)
    slope[_Z.yaw_rate] = 1.0
    evidence = _take_in(sample.yaw_rate, h.x[_Z.yaw_rate], of_yaw_rate, slope, h)
    slope[_Z.yaw_rate], slope[_Z.vy] = 0.0, 1.0
    evidence += _take_in(sample.lateral_velocity, h.x[_Z.vy], of_velocity, slope, h)
    if sample.lateral_acceleration == sample.lateral_acceleration:
        slopes = _motion()
        lateral, _, _, _ = _accelerations(h, angle, motion, c, slopes)
        for j in range(_COUNT):
            slope[j] = slopes[_Z.vy, j]
        slope[_Z.wind] = 1.0
        evidence += _take_in(sample.lateral_acceleration, lateral + h.x[_Z.wind], of_acceleration, slope, h)
    return evidence


@inlined
def _begin_filter(h, yaw_rate, knowledge):
    """Begin a filter at a yaw rate (rad/s)."""
    for i in range(_COUNT):
        h.x[i] = 0.0
        for j in range(_COUNT):
            h.covariance[i, j] = 0.0
    h.x[_Z.yaw_rate] = yaw_rate
    h.covariance[_Z.vy, _Z.vy], h.covariance[_Z.yaw_rate, _Z.yaw_rate] = FIRST_VARIANCE, square(YAW_RATE_ERROR)
    sigmas = _sigmas(knowledge)
    for i in range(_Z.bias, _COUNT):
        h.covariance[i, i] = square(sigmas[i - _Z.bias])


@inlined
def _bound(h, speed, yaw_rate, knowledge):
    """Keep the state of a filter within what a car can do; one that is lost begins again."""
    x = h.x
    if not h.covariance[_Z.vy, _Z.vy] < LARGEST_VARIANCE or not abs(x[_Z.yaw_rate]) < math.inf:
        _begin_filter(h, yaw_rate, knowledge)
    x[_Z.vy] = clip(x[_Z.vy], -0.5 * speed, 0.5 * speed)
    x[_Z.yaw_rate] = clip(x[_Z.yaw_rate], yaw_rate - LARGEST_YAW_ERROR, yaw_rate + LARGEST_YAW_ERROR)
    sigmas = _sigmas(knowledge)
    for i in range(_Z.bias, _COUNT):
        limit = LARGEST_DEVIATION * sigmas[i - _Z.bias]
        x[i] = clip(x[i], -limit, limit)


@inlined
def _follow(best, h):
    """Give a filter the state of the best one, so that it is right at once when its friction comes."""
    for i in range(_COUNT):
        h.x[i] = best.x[i]
        for j in range(_COUNT):
            h.covariance[i, j] = best.covariance[i, j]


@inlined
def _weigh(distance, memory, estimate):
    """Turn scores into weights of the frictions, each with the best of its shapes, and find the interval."""
    bank, per = estimate.bank, _shapes(estimate)
    count, best, total, likeliest = bank.size // per, -math.inf, 0.0, 0
    for i in range(bank.size):
        if bank[i].grip < memory.used:
            bank[i].score -= distance  # less than what the tyres use
        if bank[i].score > best:
            best, likeliest = bank[i].score, i
    for i in range(count):
        total += exp(_best_score(i * per, per, bank) - best)
    mass, mean = 0.0, 0.0
    first, last = bank[0].friction, bank[bank.size - 1].friction
    spacing, low, high = (last - first) / max(count - 1, 1), first, last
    for h in bank:
        h.score -= best + log(total)
        if h.score < LEAST_SCORE:
            h.score = LEAST_SCORE
            _follow(bank[likeliest], h)
    for i in range(count):
        friction, weight = bank[i * per].friction, exp(_best_score(i * per, per, bank))
        if mass < TAIL <= mass + weight:
            low = friction + spacing * ((TAIL - mass) / weight - 0.5)
        if mass < 1.0 - TAIL <= mass + weight:
            high = friction + spacing * ((1.0 - TAIL - mass) / weight - 0.5)
        mass += weight
        mean += weight * friction
    low, high = clip((1.0 - MODEL_ERROR) * low, first, last), clip((1.0 + MODEL_ERROR) * high, first, last)
    left = clip(1.0 - memory.age / RETURN_DISTANCE, 0.0, 1.0)
    if left == 0.0:
        _forget(estimate)
    low, high = first + left * (low - first), last + left * (high - last)
    rising = clip(distance / RISE_DISTANCE, 0.0, 1.0) if memory.age == 0.0 else 0.0
    memory.least += (low - memory.least) * (rising if low > memory.least else 1.0)
    memory.friction, memory.high = clip(mean / mass, memory.least, high), max(high, memory.least)
    slope = (bank[bank.size - 1].grip - bank[0].grip) / (last - first)
    memory.low = max(first, bank[0].grip + slope * (memory.least - first))


@inlined
def _shapes(estimate):
    """Number of shapes of the tyre's curve that are compared."""
    return 2 if estimate.shape == 0.0 else 1


@inlined
def _best_score(first, count, bank):
    """Largest of some scores."""
    best = bank[first].score
    for i in range(first + 1, first + count):
        best = max(best, bank[i].score)
    return best


@inlined
def _forget(estimate):
    """Let all hypotheses count the same."""
    for h in estimate.bank:
        h.score = -log(float(estimate.bank.size // _shapes(estimate)))


@inlined
def _has_fallen(memory, estimate):
    """Whether recent samples speak for less friction than the low end: a generalised likelihood ratio."""
    bank, unchanged, fallen = estimate.bank, -math.inf, -math.inf
    spacing = (bank[bank.size - 1].friction - bank[0].friction) / max(bank.size // _shapes(estimate) - 1, 1)
    for h in bank:
        if h.friction >= memory.least - 0.25 * spacing:
            unchanged = max(unchanged, h.recent)
        elif memory.used <= h.grip and FALL_SHARE * GRAVITY * h.friction <= abs(memory.pull):
            fallen = max(fallen, h.recent)
    return fallen - unchanged > FALL_EVIDENCE


@exported(void(FrictionSample, LearnedRow, float64, float64, FrictionEstimate))
def estimate_friction(sample, knowledge, force, pull, estimate):
    """Take in a sample (`FrictionSample`) at a control instant; write the ends of the interval to the memory.

    knowledge: `LearnedRow`; force: N, of drive and brakes; pull: m/s^2, of a banked road. A single hypothesis
    is certain.
    """
    memory, bank, commands, period = estimate.memory[0], estimate.bank, estimate.commands, estimate.period
    for j in range(commands.size - 1, 0, -1):
        commands[j] = commands[j - 1]
    commands[0] = sample.command
    c = unpack(estimate.car)
    if bank.size < 2 or c.tyre_linear > 0.5 or sample.speed != sample.speed:
        return
    step = clip(period + memory.sample_age - sample.age, 0.1 * period, 2.0 * period)
    memory.sample_age = sample.age
    rate = c.steering_rate
    reach = commands.size - 1
    substep = step / SUBSTEPS
    speed = max(sample.speed, SLIP_SPEED_FLOOR)
    runs = sample.speed > LEAST_SPEED
    yaw_rate = sample.yaw_rate if sample.yaw_rate == sample.yaw_rate else memory.yaw_rate
    memory.yaw_rate = yaw_rate
    left = exp(-step / max(c.load_transfer_time, 1e-3))
    wheels = _Steering(knowledge.lag + c.relaxation_length / speed, rate, c.steering_limit)
    memory.along = force / c.mass + left * (memory.along - force / c.mass)
    motion = LateralMotion(speed, force, pull, memory.along, knowledge)
    for i in range(SUBSTEPS):
        back = (step - (i + 0.5) * substep + sample.age + knowledge.dead_time) / period
        place = min(max(whole(floor(back)), 0), reach)
        before = memory.angle
        middle = steered(before, commands[place], 0.5 * substep, wheels)
        memory.angle = steered(before, commands[place], substep, wheels)
        if runs and memory.running > 0.5:
            turning = (memory.angle - before) / substep
            for h in bank:
                _predict(h, middle, turning, substep, motion, c)
    if not runs:
        memory.running = 0.0
        return
    distance = speed * step
    share = 1.0 - exp(-step / USED_TIME)
    slide = memory.lateral_velocity
    felt = sample.lateral_acceleration == sample.lateral_acceleration
    memory.lateral_velocity, side, variance, total = 0.0, 0.0, 0.0, 0.0
    for h in bank:
        weight = exp(h.score)
        total += weight
        memory.lateral_velocity += weight * h.x[_Z.vy]
        side += weight * abs(h.x[_Z.wind] if felt else h.x[_Z.wind] + h.x[_Z.bank])
        variance += weight * (h.covariance[_Z.wind, _Z.wind] + (0.0 if felt else h.covariance[_Z.bank, _Z.bank]))
    memory.lateral_velocity /= total
    used = sample.lateral_acceleration if felt else speed * yaw_rate + (memory.lateral_velocity - slide) / step - pull
    memory.pull += share * (used - memory.pull)
    sure = (1.0 - USED_SCALE) * abs(memory.pull) - side / total - USED_SIGMAS * sqrt(variance / total) - USED_ERROR
    memory.used = max(sure / GRAVITY, 0.0)
    is_excited = abs(memory.pull) > EXCITED_SHARE * memory.least * GRAVITY
    memory.age = 0.0 if is_excited else min(memory.age + distance, RETURN_DISTANCE)
    best = -math.inf
    for h in bank:
        if memory.running < 0.5:
            _begin_filter(h, yaw_rate, knowledge)
            h.evidence, h.recent = 0.0, 0.0
        else:
            h.evidence = _correct(h, memory.angle, sample, motion, estimate.variances, c)
            _bound(h, speed, yaw_rate, knowledge)
        best = max(best, h.evidence)
    memory.surprise += step / SURPRISE_TIME * (-2.0 * best - memory.surprise)
    telling = 0.0
    if abs(memory.pull) > TELLING_SHARE * memory.least * GRAVITY:
        telling = 1.0 / max(memory.surprise, LEAST_SURPRISE)
    fading = exp(-step / RECENT_TIME)
    for h in bank:
        h.score += EVIDENCE_SHARE * telling * h.evidence
        h.recent = max(fading * h.recent + telling * (h.evidence - best), LEAST_RECENT)
    if _has_fallen(memory, estimate):
        _forget(estimate)
    memory.running = 1.0
    _weigh(distance, memory, estimate)


_Steering = record("Steering", ("steering_lag", "steering_rate", "steering_limit"))


@exported(void(FrictionEstimate))
def begin_friction(estimate):
    """Begin an estimate within its interval: hypotheses evenly from end to end."""
    memory, bank, low, high = estimate.memory[0], estimate.bank, estimate.low, estimate.high
    memory.running, memory.used, memory.pull, memory.surprise, memory.age = 0.0, 0.0, 0.0, 1.0, RETURN_DISTANCE
    memory.friction, memory.low, memory.high, memory.least = 0.5 * (low + high), low, high, low
    memory.angle, memory.sample_age, memory.yaw_rate, memory.along, memory.lateral_velocity = 0.0, 0.0, 0.0, 0.0, 0.0
    per = _shapes(estimate)
    for i in range(bank.size):
        bank[i].friction = low + (high - low) * (i // per) / max(bank.size // per - 1, 1)
        bank[i].grip = usable_friction(estimate.car, unpack(estimate.car).steering_limit, bank[i].friction)
        bank[i].tyre_shape = estimate.shape if per == 1 else (PESSIMISTIC_SHAPE if i % 2 == 0 else BRUSH_SHAPE)
    if bank.size > 1:
        _forget(estimate)


@inlined
def _knowledge(learned, estimate):
    """Steering and tyres by the memory of a learner, or as the estimate assumes them where the memory is empty."""
    if learned.size == 0:
        return estimate.knowledge
    b = memory_of(learned, 0).beliefs
    return LearnedRow(
        b.belief_lag, b.belief_lag_sigma, b.belief_dead_time, b.belief_dead_time_sigma, b.belief_delay_sigma,
        b.belief_stiffness, b.belief_stiffness_sigma, b.belief_balance, b.belief_balance_sigma, b.belief_bias,
        b.belief_bias_sigma,
    )  # fmt: skip


@inlined
def narrow_friction(measured, speed, command, learned, longitudinal):
    """Narrow the friction of a speed control (`tracker.longitudinal.Longitudinal`) within that of its settings.

    measured: `MEASUREMENT` at a speed (m/s); command: rad, sent in the last period; learned: memory of a learner, empty
    without one. A friction that is certain stays, with a reserve while a learner's steering is not known.
    """
    estimate, settings, control = longitudinal.friction, longitudinal.settings, longitudinal.memory[0]
    memory, hypotheses = estimate.memory[0], estimate.bank
    if not estimate.low < estimate.high:
        is_learning = learned.size > 0 and memory_of(learned, 0).beliefs.belief_state == LEARNING_BELIEF
        reserve = CERTAIN_RESERVE if is_learning else estimate.reserve
        control.cautious_friction = (1.0 - reserve) * settings.friction
        return
    if hypotheses.size < 2:
        return
    first, last = hypotheses[0].friction, hypotheses[hypotheses.size - 1].friction
    age = measured[MEASUREMENT.motion_age]
    sample = FrictionSample(
        speed, measured[MEASUREMENT.yaw_rate], measured[MEASUREMENT.vy], measured[MEASUREMENT.lateral_acceleration],
        age if math.isfinite(age) else 0.0, command,
    )  # fmt: skip
    drive, brakes = mean_of_bank(longitudinal.banks.drive), mean_of_bank(longitudinal.banks.brakes)
    force = settings.mass * (drive.ratio * drive.acting - brakes.ratio * brakes.acting)
    bank = longitudinal.path.bank[cell_at(control.station, longitudinal.path)]
    estimate_friction(sample, _knowledge(learned, estimate), force, bank, estimate)
    slope = (settings.friction_high - settings.friction) / (last - first)
    caution = 1.0 - min(WIDTH_CAUTION * (memory.high - memory.least) / memory.high, LARGEST_CAUTION)
    control.friction = settings.friction + slope * (memory.least - first)
    control.cautious_friction = caution * control.friction
    control.friction_high = settings.friction + slope * (memory.high - first)
