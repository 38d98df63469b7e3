"""Friction of the road as an interval: a bank of Kalman filters of the lateral motion, one for each coefficient.

Each hypothesis is the single-track vehicle on the tyres of the car with its coefficient mu:

    dv_y/dt = (F_f + F_r)/m + bank + side - v_x r,   dr/dt = (l_f F_f - l_r F_r)/I_z

An axle has two wheels: load transfer by lateral and longitudinal acceleration, and the friction circle with the drive
and brake forces, change what they can carry. The filter estimates [v_y, r, steering bias, ln stiffness, ln balance,
side] from the yaw rate and, where they are measured, lateral acceleration and velocity. The wheels follow the commands
behind dead time, lag and rate limit; a sample is compared with the motion at its own time. The weight of a hypothesis
follows from the likelihood of its innovations.

Friction shows only where the tyres are near their limit. On a straight the weights return slowly, with the distance, to
the prior, which is uniform within the given interval. The force that the tyres have used is a lower bound.
"""

from __future__ import annotations

import math

from ..estimators.extended_kalman import bounded, carry, correct, scatter, step_motion
from ..estimators.friction_wind import steered
from ..estimators.learning import memory_of
from ..kernel import columns, exported, fields_of, float64, inlined, local, record, rows, vector, void
from ..maths.bits import whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.exponential import exp, log
from ..maths.fast import fast_arctangent_of_ratio
from ..maths.vectors import VECTOR_WIDTH
from ..models.car import LearnedRow, unpack
from ..models.contract import MEASUREMENT, PERIOD_FIELD
from ..physics.forces import GRAVITY, SLIP_SPEED_FLOOR, wind_load
from ..physics.tyre import CURVED_MAGIC_FORMULA, LEAST_LOAD, MAGIC_FORMULA, friction_ellipse, lateral_force
from ..tracker.signals import TRACKER_SAMPLE
from .learning import mean_of_bank
from .speed_control import cell_at

_Z = columns(
    "vy", "yaw_rate",  # m/s, rad/s
    "bias",  # rad, of the steering, against what is known
    "stiffness", "balance",  # -, -: logarithms, against what is known
    "side",  # m/s^2, of wind and bank
)  # fmt: skip
"""State of a filter."""
_COUNT = len(_Z)

FRICTION_HYPOTHESIS = record(
    "FrictionHypothesis",
    (
        "friction",  # -
        "score",  # logarithm of the weight
        ("x", (float64, VECTOR_WIDTH)), ("covariance", (float64, _COUNT, VECTOR_WIDTH)),
    ),
)  # fmt: skip
"""A coefficient of friction with its filter."""
LateralMotion = record(
    "LateralMotion",
    (
        "speed", "force", "pull",  # m/s; N, of drive and brakes; m/s^2, of a banked road
        "along", "lateral",  # m/s^2, accelerations that have moved the load
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
        "friction", "low", "high",  # -, mean and ends of the interval
        "used",  # -, friction that the tyres have used, over a moment, lowered with the distance
        "angle", "age",  # rad, s: wheels and age of the last sample
        "lateral", "along",  # m/s^2, accelerations that have moved the load
        "pull",  # m/s^2, used acceleration over a moment
        "lateral_velocity",  # m/s, mean of the filters
    ),
)  # fmt: skip
"""What a friction estimate remembers besides its hypotheses, and its answer."""

FrictionEstimate = record(
    "FrictionEstimate",
    (
        ("memory", rows(FRICTION_MEMORY)), ("bank", rows(FRICTION_HYPOTHESIS)), ("commands", vector), ("car", vector),
        PERIOD_FIELD, ("variances", vector), ("low", float64), ("high", float64),
        ("knowledge", LearnedRow),
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
MODEL_ERROR = 0.05
"""Of the friction, by which the model of the car widens the interval to either side."""
RETURN_DISTANCE = 1500.0
"""m, after which the weights have returned to the prior by 1 - 1/e where nothing is observed."""
LEAST_WEIGHT = 1e-3
"""Of a hypothesis, so that a friction that falls is noticed soon."""
RISE_DISTANCE = 80.0
"""m, over which the low end rises."""
WIDTH_CAUTION, LARGEST_CAUTION = 0.35, 0.15
"""Share of the low end that bends ahead and drive forces do not use, over the width of the interval relative to its
high end; at most. Brakes use the low end."""
EVIDENCE_SHARE = 0.3
"""Of the log-likelihood of a sample: errors of the model last for some samples."""
FRICTION_INNOVATION_BOUND = 3.0
"""Standard deviations up to which an innovation counts."""
VELOCITY_ERROR, YAW_RATE_ERROR, ACCELERATION_ERROR = 0.05, 0.01, 0.2
"""m/s, rad/s, m/s^2: standard deviations of the model's own errors, besides the noise of the sensors."""
DRIFT_VELOCITY, DRIFT_YAW_RATE = 0.05, 0.01
"""m/s and rad/s after a second: random walks besides the model."""
TYRE_ERROR = 0.02
"""s^0.5, white noise on the force of an axle, over that force."""
SIDE_SIGMA, SIDE_TIME, KNOWLEDGE_TIME = 0.2, 5.0, 30.0
"""m/s^2 and s, of side wind and bank; s, of stiffness, balance and bias against what is known of them."""
FIRST_VARIANCE = 0.25
"""(m/s)^2, of a lateral velocity that is not known."""
LARGEST_VARIANCE, LARGEST_YAW_ERROR, LARGEST_DEVIATION = 4.0, 0.5, 3.0
"""(m/s)^2 and rad/s, beyond which a filter is lost; standard deviations from what is known."""
USED_TIME, USED_MARGIN = 0.3, 0.95
"""s, over which used friction is averaged; share that counts."""

_states, _motion = local(VECTOR_WIDTH), local(2, VECTOR_WIDTH)
_SLIP_STEP = 1e-5  # rad, of a difference that stands for a derivative


@inlined
def _axle(slip, load, shift, along, friction, stiffness, c, law):
    """Lateral force (N) of an axle and its derivative by the slip angle; shift: N, load that moved to the outer wheel.

    along: N, drive or brake force of the axle.
    """
    force, by_slip = 0.0, 0.0
    for side in (-1.0, 1.0):
        carried = max(0.5 * load + side * shift, LEAST_LOAD)
        left = friction_ellipse(clip(0.5 * along, -friction * carried, friction * carried), carried, friction)
        above = lateral_force(slip + _SLIP_STEP, carried, friction, stiffness, c, law)
        below = lateral_force(slip - _SLIP_STEP, carried, friction, stiffness, c, law)
        force += 0.5 * left * (above + below)
        by_slip += left * (above - below) * (0.5 / _SLIP_STEP)
    return force, by_slip


@inlined
def _accelerations(h, angle, motion, c, law, slopes):
    """Acceleration of the tyres (m/s^2), yaw acceleration (rad/s^2) and both axle forces (N) of a hypothesis.

    Derivatives of the first two by the state are written to slopes (2, 8).
    """
    x, wheelbase, knowledge, speed, force = h.x, c.lf + c.lr, motion.knowledge, motion.speed, motion.force
    factor = knowledge.stiffness * exp(x[_Z.stiffness])
    balance = knowledge.balance * exp(x[_Z.balance])
    wheel = angle + knowledge.bias + x[_Z.bias]
    moved = c.mass * c.cg_height / wheelbase
    pitch, roll = moved * motion.along, moved * motion.lateral
    front_share = c.drive_front if force > 0.0 else c.brake_front
    side_f, side_r = x[_Z.vy] + c.lf * x[_Z.yaw_rate], x[_Z.vy] - c.lr * x[_Z.yaw_rate]
    slip_f = wheel - fast_arctangent_of_ratio(side_f, speed)
    slip_r = -fast_arctangent_of_ratio(side_r, speed)
    front, by_front = _axle(
        slip_f, c.mass * GRAVITY * c.lr / wheelbase - pitch, roll * c.lr / c.track_front, front_share * force,
        h.friction, factor * sqrt(balance) * c.stiffness_front, c, law,
    )  # fmt: skip
    rear, by_rear = _axle(
        slip_r, c.mass * GRAVITY * c.lf / wheelbase + pitch, roll * c.lf / c.track_rear, (1.0 - front_share) * force,
        h.friction, factor / sqrt(balance) * c.stiffness_rear, c, law,
    )  # fmt: skip
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
    return knowledge.bias_sigma, knowledge.stiffness_sigma, knowledge.balance_sigma, SIDE_SIGMA


@inlined
def _predict(h, angle, turning, step, motion, c, law):
    """Carry a filter over a step (s) by the linearised trapezoidal rule; turning: rad/s, of the wheels."""
    x, P, slopes, mixed = h.x, h.covariance, _motion(), _motion()
    speed, knowledge = motion.speed, motion.knowledge
    lateral, yawing, front, rear = _accelerations(h, angle, motion, c, law, slopes)
    push, twist = slopes[_Z.vy, _Z.bias], slopes[_Z.yaw_rate, _Z.bias]
    slopes[_Z.vy, _Z.yaw_rate] -= speed
    slopes[_Z.vy, _Z.side] += 1.0
    step_motion(lateral + motion.pull + x[_Z.side] - speed * x[_Z.yaw_rate], yawing, step, slopes, _COUNT, x, mixed)
    shares, sigmas = _states(), _sigmas(knowledge)
    for j in range(_Z.bias, _COUNT):
        shares[j] = exp(-step / (SIDE_TIME if j == _Z.side else KNOWLEDGE_TIME))
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
    """Correct a filter by a sensor; return the log-likelihood. slope: derivatives of its reading by the state."""
    if value != value or not variance < math.inf:
        return 0.0
    cross, innovation = _states(), value - reading
    spread = scatter(variance, slope, h.covariance, cross)
    surprise = min(square(innovation) / spread, square(FRICTION_INNOVATION_BOUND))
    correct(bounded(innovation, spread, FRICTION_INNOVATION_BOUND), spread, cross, h.x, h.covariance)
    return -0.5 * (surprise + log(spread))


@inlined
def _correct(h, angle, sample, motion, variances, c, law):
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
        lateral, _, _, _ = _accelerations(h, angle, motion, c, law, slopes)
        for j in range(_COUNT):
            slope[j] = slopes[_Z.vy, j]
        slope[_Z.side] = 1.0
        evidence += _take_in(sample.lateral_acceleration, lateral + h.x[_Z.side], of_acceleration, slope, h)
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
def _weigh(distance, memory, bank):
    """Turn scores into weights that have returned to the prior by a distance (m), and find the interval."""
    best, total = -math.inf, 0.0
    for h in bank:
        if h.friction < USED_MARGIN * memory.used:
            h.score -= distance  # less than what the tyres have used
        best = max(best, h.score)
    for h in bank:
        total += exp(h.score - best)
    mixed, mass, mean = min(distance / RETURN_DISTANCE, 1.0), 0.0, 0.0
    spacing = bank[1].friction - bank[0].friction
    low, high = bank[0].friction, bank[bank.size - 1].friction
    for h in bank:
        weight = (1.0 - mixed) * exp(h.score - best) / total + mixed / bank.size
        weight = max(weight, LEAST_WEIGHT)
        h.score = log(weight)
        if mass < TAIL <= mass + weight:
            low = h.friction + spacing * ((TAIL - mass) / weight - 0.5)
        if mass < 1.0 - TAIL <= mass + weight:
            high = h.friction + spacing * ((1.0 - TAIL - mass) / weight - 0.5)
        mass += weight
        mean += weight * h.friction
    first, last = bank[0].friction, bank[bank.size - 1].friction
    low, high = clip((1.0 - MODEL_ERROR) * low, first, last), clip((1.0 + MODEL_ERROR) * high, first, last)
    rising = clip(distance / RISE_DISTANCE, 0.0, 1.0)
    memory.low += (low - memory.low) * (rising if low > memory.low else 1.0)
    memory.friction, memory.high = mean, max(high, memory.low)


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
    step = clip(period + memory.age - sample.age, 0.1 * period, 2.0 * period)
    memory.age = sample.age
    rate = c.steering_rate
    reach = commands.size - 1
    substep = step / SUBSTEPS
    law = MAGIC_FORMULA if c.curvature == 0.0 else CURVED_MAGIC_FORMULA
    speed = max(sample.speed, SLIP_SPEED_FLOOR)
    runs = sample.speed > LEAST_SPEED
    yaw_rate = sample.yaw_rate if sample.yaw_rate == sample.yaw_rate else memory.lateral / speed
    left = exp(-step / max(c.load_transfer_time, 1e-3))
    wheels = _Steering(knowledge.lag + c.relaxation_length / speed, rate, c.steering_limit)
    memory.lateral = speed * yaw_rate - pull + left * (memory.lateral - speed * yaw_rate + pull)
    memory.along = force / c.mass + left * (memory.along - force / c.mass)
    motion = LateralMotion(speed, force, pull, memory.along, memory.lateral, knowledge)
    for i in range(SUBSTEPS):
        back = (step - (i + 0.5) * substep + sample.age + knowledge.dead_time) / period
        place = min(max(whole(floor(back)), 0), reach)
        before = memory.angle
        middle = steered(before, commands[place], 0.5 * substep, wheels)
        memory.angle = steered(before, commands[place], substep, wheels)
        if runs and memory.running > 0.5:
            turning = (memory.angle - before) / substep
            for h in bank:
                _predict(h, middle, turning, substep, motion, c, law)
    if not runs:
        memory.running = 0.0
        return
    distance = speed * step
    share = 1.0 - exp(-step / USED_TIME)
    slide = memory.lateral_velocity
    memory.lateral_velocity = 0.0
    for h in bank:
        memory.lateral_velocity += exp(h.score) * h.x[_Z.vy]
    used = sample.lateral_acceleration
    if used != used:
        used = speed * yaw_rate + (memory.lateral_velocity - slide) / step - pull
    memory.pull += share * (sqrt(square(used) + square(force / c.mass)) - memory.pull)
    memory.used = max(memory.pull / GRAVITY, memory.used * (1.0 - distance / RETURN_DISTANCE))
    for h in bank:
        if memory.running < 0.5:
            _begin_filter(h, yaw_rate, knowledge)
        else:
            h.score += EVIDENCE_SHARE * _correct(h, memory.angle, sample, motion, estimate.variances, c, law)
            _bound(h, speed, yaw_rate, knowledge)
    memory.running = 1.0
    _weigh(distance, memory, bank)


_Steering = record("Steering", ("steering_lag", "steering_rate", "steering_limit"))


@exported(void(FrictionEstimate))
def begin_friction(estimate):
    """Begin an estimate within its interval: hypotheses evenly from end to end."""
    memory, bank, low, high = estimate.memory[0], estimate.bank, estimate.low, estimate.high
    memory.running, memory.used, memory.pull = 0.0, 0.0, 0.0
    memory.friction, memory.low, memory.high = 0.5 * (low + high), low, high
    memory.angle, memory.age, memory.lateral, memory.along, memory.lateral_velocity = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(bank.size):
        bank[i].friction = low + (high - low) * i / max(bank.size - 1, 1)
        bank[i].score = -log(float(bank.size))


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
    without one. A friction that is certain stays.
    """
    estimate, settings, control = longitudinal.friction, longitudinal.settings, longitudinal.memory[0]
    memory, hypotheses = estimate.memory[0], estimate.bank
    if hypotheses.size < 2:
        return
    first, last = hypotheses[0].friction, hypotheses[hypotheses.size - 1].friction
    if not first < last:
        return
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
    caution = 1.0 - min(WIDTH_CAUTION * (memory.high - memory.low) / memory.high, LARGEST_CAUTION)
    control.friction = settings.friction + slope * (memory.low - first)
    control.cautious_friction = caution * control.friction
    control.friction_high = settings.friction + slope * (memory.high - first)
