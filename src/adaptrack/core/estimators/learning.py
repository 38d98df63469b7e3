"""What a car does not say of itself, learned while it drives: steering delay, stiffness, steering bias, bank, friction.

A bank of extended Kalman filters, each beginning with a hypothesis of the steering's lag tau and dead time T_d. The
wheel angle delta(t) follows from the commands that were sent (rate limit included), and a filter estimates

    x = [v_y (m/s), r (rad/s), w (m/s^2), b (rad), p (m/s^2), s, q, ln mu, tau (s), T_d (s), o (rad)]

    ddelta/dt = (u(t - T_d) - delta)/tau,   S = ddelta/dtau: dS/dt = -(S + ddelta/dt)/tau,   ddelta/dT_d = -ddelta/dt

    dv_y/dt = F_f + F_r - v r + w + p,     dr/dt = m/I_z (l_f F_f - l_r F_r) + c_w w      F: force of an axle over m
    F_i = D_i g(C_i alpha_i/D_i),  g(x) = x/sqrt(1 + x^2),  D_i = mu g (share of the load)
    C_f/m = known exp(s + q),  C_r/m = known exp(s - q),  alpha_f = delta + b - (v_y + l_f r)/v,
    alpha_r = -(v_y - l_r r)/v

from yaw rate, lateral velocity and acceleration, as far as they are measured. w: side wind, c_w: the turn that goes
with it; b: steering bias; p: pull of a banked road; s: logarithm of the stiffness over the mass, in units of what is
known of it; q: half of that of front over rear; mu: friction. Wind, bank and friction return to nothing, nothing and
the usual friction (first-order Gauss-Markov), the others stay. A wheel-angle sensor reads delta + o. g keeps the slope
C at small slip and the limit D; a Magic Formula with shape 1.35 lies within 7 % of it up to x = 1.

The logarithms of the likelihoods of the innovations (each counted up to `bound` standard deviations) weigh the filters,
with a slow forgetting; what is learned is mean and variance of the mixture. Sources: D. T. Magill, Optimal adaptive
estimation of sampled stochastic processes, IEEE Trans. Automatic Control 10 (1965) (the bank); H. W. Sorenson, D. L.
Alspach, Recursive Bayesian estimation using Gaussian sums, Automatica 7 (1971) (the mixture); D. Simon, *Optimal State
Estimation* (2006), chapters 10.2 and 13; R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., chapter 2.

Evidence about the delay counts while the hypotheses differ in their wheel angles; a car that stands or creeps, samples
that are missing, repeated to the last bit or left out by the controller's filter teach nothing.

The noise of each sensor is that of third differences of its samples, E(x_k - 3 x_(k-1) + 3 x_(k-2) - x_(k-3))^2 =
20 sigma^2 for white noise: the motion of a car hardly shows in them.
"""

from __future__ import annotations

import math

from ..kernel import columns, exported, float64, inlined, int64, record, unpacker, vector, void
from ..maths.bits import two_to, whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.exponential import exp, log
from ..maths.vectors import WIDTH, fma8, load, mul, padded, splat, spread, store, sub, zeros
from ..models import path
from ..models.contract import MEASURED
from ..plants.forces import GRAVITY
from . import kalman
from .contract import ABSURD

NUMBERS = (
    "period",  # s
    "computation",  # s, from a measurement until its command is given
    "lag",  # s, of the steering, as told
    "hypotheses",  # how many
    "kept",  # commands that are remembered
    "mass", "yaw_inertia", "lf", "lr", "stiffness_front", "stiffness_rear",  # as known; stiffness of an axle
    "wind_turn",  # 1/m, yaw acceleration over lateral acceleration of side wind
    "rate",  # rad/s, of the steering; inf: no limit
    "bound",  # standard deviations up to which an innovation counts
    "forgetting",  # share of the evidence that an exciting period takes away
    "tempering",  # share of a log-likelihood that counts: successive innovations are not independent
    "drift_vy", "drift_yaw_rate", "drift_wind", "drift_bias", "drift_bank", "drift_stiffness", "drift_balance",
    "drift_friction", "drift_lag", "drift_dead_time",  # variances that a period adds
    "wind_left", "bank_left", "friction_left",  # share of a deviation that is left after a period
    "usual_friction",  # ln mu to which friction returns
    "sliding",  # s, variance of an axle's impulse in a second over the square of F^2/D, by which tyres deviate
    "angle_error",  # rad^2, variance by which a wheel angle deviates from its model, beside the sensor's noise
    "least_lag", "most_lag", "least_dead_time", "most_dead_time",  # s, what was told
    "most_stiffness", "most_balance", "most_bias",  # bounds of |s|, |q| and |b|
    "modest",  # factor on the standard deviations of the filters: what they leave out makes them too small
    "prior_lag", "prior_dead_time", "prior_delay", "prior_stiffness", "prior_balance", "prior_bias",  # what was told
    "cautious",  # standard deviations of the delay that are added to its mean
    "tolerated", "most_caution",  # s, standard deviation that doubles R; largest factor on R
    "tolerated_stiffness",  # the same of s
    "longer", "shorter",  # s per period, by which what is believed of lag and dead time changes at most
    "stiffer",  # likewise of s
    "turning",  # rad per period, likewise of the bias
    "wandering",  # rad/s, steering rate by which the wheels are elsewhere for every second of uncertain delay
    "drift_wheels",  # rad^2, variance that a period adds to the wheel angle in the controller's filter
    "noise_share", "noise_range",  # least share of a new sample in the noise; factor within which it may be
    "variance_vy", "variance_yaw", "variance_yaw_rate", "variance_y", "variance_wheel_angle",
    "variance_lateral_acceleration",  # of the sensors, as told; inf: none
)  # fmt: skip
Numbers = record("Numbers", NUMBERS)
_unpack = unpacker(Numbers)
_VARIANCE = NUMBERS.index("variance_vy")

BELIEFS = (
    "belief_lag", "belief_lag_sigma", "belief_dead_time", "belief_dead_time_sigma",  # s
    "belief_delay", "belief_delay_sigma",  # s, lag and dead time together
    "belief_stiffness", "belief_stiffness_sigma",  # factor on what is known, sigma of its logarithm
    "belief_balance", "belief_balance_sigma",  # front over rear, likewise
    "belief_bias", "belief_bias_sigma",  # rad
    "belief_bank", "belief_bank_sigma",  # m/s^2
    "belief_friction", "belief_friction_sigma",  # sigma of its logarithm
    "belief_noise",  # of the yaw rate, over what was told
    "used_lag", "used_dead_time", "used_stiffness", "used_balance", "used_bias", "used_caution",  # by the controller
)  # fmt: skip
"""What is learned, and what the controller believes of it, at every step."""
BELIEF = columns(*BELIEFS)
STATES = 11
ROW = 2 * WIDTH
"""Numbers between the rows of a covariance."""
COUNT = 0
"""Place in the memory of the steps so far."""
_SLOW = 1  # 1 while the car is too slow to learn from
_BIAS_BEFORE = 2  # rad, bias in the controller's filter
ANSWER = WIDTH
"""Place in the memory where `BELIEFS` begin."""
NOISE = ANSWER + 4 * WIDTH
"""Place in the memory of the variances of the sensors as learned."""
_NOISE_COUNT = NOISE + WIDTH
_SEEN = _NOISE_COUNT + WIDTH  # the last samples of each sensor, the latest first: three rows
_SCRATCH = _SEEN + 3 * WIDTH  # two rows of F; h
SENT = _SCRATCH + 4 * ROW
"""Place in the memory of the commands that were sent, the latest first."""
WHEELS, BY_LAG, SWEPT, SWEPT_BY_LAG, EVIDENCE, WEIGHT = range(6)
X, P = WIDTH, WIDTH + ROW
BLOCK = P + ROW * STATES
"""Numbers of a filter: wheel angle (rad), its slope over the lag (rad/s), both integrated over a period, log of its
likelihood, weight; x; P by rows."""
VY, RATE, WIND, BIAS, BANK, STIFFNESS, BALANCE, FRICTION, LAG, DEAD_TIME, OFFSET = range(STATES)
"""States; the dead time with the computation."""
SLOWEST = 2.0
"""m/s, below which nothing is learned."""
UNKNOWN = 0.1
"""(m/s)^2 and (rad/s)^2, variances of a motion that is not known."""
LEAST_DIFFERENCE = 5e-4
"""rad, root mean square by which wheel angles of hypotheses differ where their evidence counts."""
LEAST_PULL = 0.3
"""m/s^2, that tyres pull at least where the stiffness may have drifted."""
LOWEST = -40.0
"""Log-likelihood of the least likely hypothesis against the best: it can come back."""
LIVELY, SETTLED = 3.0, 8
"""A third difference counts up to so many standard deviations, so that a jump is no noise; after so many samples."""
_TERMS = 7

LEARN = void(float64, vector, float64, int64, vector, vector)
"""``learn(speed, measured, command, left_out, parameters, memory)``: take in what was measured (`MEASURED`) at a speed
(m/s) and the command (rad) of a period ago; left_out: 1 + a sensor not to be believed, 0: none."""

BELIEVE = void(vector, vector, vector, vector, vector)
"""``believe(parameters, memory, model, own, remembered)``: let model and filter of the controller believe what is
learned; model: parameters of the path model; own, remembered: parameters and memory of the filter."""


def blocks_at(kept: int) -> int:
    """Place in the memory of the first hypothesis."""
    return SENT + int(padded(kept))


def memory_size(kept: int, hypotheses: int) -> int:
    """Numbers that the learner remembers."""
    return blocks_at(kept) + BLOCK * hypotheses


@inlined
def _steer(at, time, rate, command, memory):
    """Let the wheels of a filter follow a command for a time (s)."""
    lag, angle, slope = memory[at + X + LAG], memory[at + WHEELS], memory[at + BY_LAG]
    gap = command - angle
    if abs(gap) > rate * lag:
        limited = min(time, abs(gap) / rate - lag)
        turned = math.copysign(rate * limited, gap)
        memory[at + SWEPT] += limited * (angle + 0.5 * turned)
        memory[at + SWEPT_BY_LAG] += limited * slope
        angle += turned
        gap -= turned
        time -= limited
    left = exp(-time / lag)
    after = left * (slope - gap * time / (lag * lag))
    memory[at + SWEPT] += time * command - gap * lag * (1.0 - left)
    memory[at + SWEPT_BY_LAG] += 0.5 * time * (slope + after)
    memory[at + WHEELS], memory[at + BY_LAG] = command - gap * left, after


@inlined
def _follow(at, age, p, memory):
    """The wheels of a filter over the period before the sample, so old (s)."""
    late = (memory[at + X + DEAD_TIME] + age) / p.period
    periods = min(whole(late + 1e-9), whole(p.kept) - 2)
    share = clip(late - periods, 0.0, 1.0)
    memory[at + SWEPT], memory[at + SWEPT_BY_LAG] = 0.0, 0.0
    if share > 0.0:
        _steer(at, share * p.period, p.rate, memory[SENT + periods + 1], memory)
    if share < 1.0:
        _steer(at, (1.0 - share) * p.period, p.rate, memory[SENT + periods], memory)


@inlined
def _axle(slip, stiffness, most):
    """Force of an axle, its slope over the slip, and its slope over ln mu; all over the mass."""
    x = stiffness * slip / most
    root = 1.0 / sqrt(1.0 + x * x)
    force, slope = most * x * root, stiffness * root * root * root
    return force, slope, force - slope * slip


@inlined
def _forces(at, speed, angle, p, memory):
    """Slips, forces and their slopes of both axles at a wheel angle (rad)."""
    x = at + X
    vy, r, s, q = memory[x + VY], memory[x + RATE], memory[x + STIFFNESS], memory[x + BALANCE]
    grip = GRAVITY * exp(memory[x + FRICTION]) / (p.lf + p.lr)
    factor, balance = exp(s), exp(q)
    slip_front = angle + memory[x + BIAS] - (vy + p.lf * r) / speed
    slip_rear = -(vy - p.lr * r) / speed
    front = _axle(slip_front, p.stiffness_front / p.mass * factor * balance, grip * p.lr)
    rear = _axle(slip_rear, p.stiffness_rear / p.mass * factor / balance, grip * p.lf)
    return slip_front, slip_rear, front, rear


@inlined
def _times(a, b):
    """Product of two 2 x 2 matrices, by rows."""
    return (
        a[0] * b[0] + a[1] * b[2], a[0] * b[1] + a[1] * b[3], a[2] * b[0] + a[3] * b[2], a[2] * b[1] + a[3] * b[3],
    )  # fmt: skip


@inlined
def _phi1(z):
    """phi_1(Z) = sum_i Z^i/(i+1)! of a 2 x 2 matrix: Taylor series of Z/2^k, then phi_1(2Z) = phi_1(Z)(I + e^Z)/2."""
    norm = max(abs(z[0]) + abs(z[2]), abs(z[1]) + abs(z[3]))
    halvings = 0
    while norm > 0.5 and halvings < 30:
        norm *= 0.5
        halvings += 1
    scale = two_to(-halvings)
    z = (scale * z[0], scale * z[1], scale * z[2], scale * z[3])
    f = (1.0, 0.0, 0.0, 1.0)
    for i in range(_TERMS, 1, -1):
        g = _times(z, f)
        f = (1.0 + g[0] / i, g[1] / i, g[2] / i, 1.0 + g[3] / i)
    for _ in range(halvings):
        e = _times(z, f)
        g = _times(f, (0.5 * e[0] + 1.0, 0.5 * e[1], 0.5 * e[2], 0.5 * e[3] + 1.0))
        f = g
        z = (2.0 * z[0], 2.0 * z[1], 2.0 * z[2], 2.0 * z[3])
    return f


@inlined
def _predict_state(at, speed, before, p, memory):
    """x a period later, by the exponential Euler method; rows of F in the scratch; what the tyres pull (m/s^2).

    before: wheel angle (rad) a period ago.
    """
    x, turning = at + X, p.mass / p.yaw_inertia
    angle = memory[at + SWEPT] / p.period
    slip_front, slip_rear, front, rear = _forces(at, speed, angle, p, memory)
    f, sf, mf = front
    g, sr, mr = rear
    lf, lr = p.lf, p.lr
    wind, bank, r = memory[x + WIND], memory[x + BANK], memory[x + RATE]
    rate_vy = f + g - speed * r + wind + bank
    rate_r = turning * (lf * f - lr * g) + p.wind_turn * wind
    jacobian = (
        -(sf + sr) / speed, (lr * sr - lf * sf) / speed - speed,
        turning * (lr * sr - lf * sf) / speed, -turning * (lf * lf * sf + lr * lr * sr) / speed,
    )  # fmt: skip
    h = p.period
    phi = _phi1((h * jacobian[0], h * jacobian[1], h * jacobian[2], h * jacobian[3]))
    e = _times(phi, jacobian)
    f0, f1 = _SCRATCH, _SCRATCH + ROW
    by_lag, by_dead_time = memory[at + SWEPT_BY_LAG] / h, (before - memory[at + WHEELS]) / h
    more_vy, more_r = h * (phi[0] * rate_vy + phi[1] * rate_r), h * (phi[2] * rate_vy + phi[3] * rate_r)
    # stiffness acts on the slip in the middle of the period
    of_front = sf * (slip_front - 0.5 * (more_vy + lf * more_r) / speed)
    of_rear = sr * (slip_rear - 0.5 * (more_vy - lr * more_r) / speed)
    memory[f0 + VY], memory[f0 + RATE] = 1.0 + h * e[0], h * e[1]
    memory[f1 + VY], memory[f1 + RATE] = h * e[2], 1.0 + h * e[3]
    for state in range(WIND, OFFSET):
        by_vy, by_r = 1.0, 0.0  # the pull of a bank
        if state == WIND:
            by_r = p.wind_turn
        elif state == BIAS:
            by_vy, by_r = sf, turning * lf * sf
        elif state == STIFFNESS:
            by_vy, by_r = of_front + of_rear, turning * (lf * of_front - lr * of_rear)
        elif state == BALANCE:
            by_vy, by_r = of_front - of_rear, turning * (lf * of_front + lr * of_rear)
        elif state == FRICTION:
            by_vy, by_r = mf + mr, turning * (lf * mf - lr * mr)
        elif state == LAG:
            by_vy, by_r = sf * by_lag, turning * lf * sf * by_lag
        elif state == DEAD_TIME:
            by_vy, by_r = sf * by_dead_time, turning * lf * sf * by_dead_time
        memory[f0 + state] = h * (phi[0] * by_vy + phi[1] * by_r)
        memory[f1 + state] = h * (phi[2] * by_vy + phi[3] * by_r)
    memory[f0 + OFFSET], memory[f1 + OFFSET] = 0.0, 0.0
    memory[x + VY] += more_vy
    memory[x + RATE] += more_r
    memory[x + WIND] *= p.wind_left
    memory[x + BANK] *= p.bank_left
    memory[x + FRICTION] = p.usual_friction + p.friction_left * (memory[x + FRICTION] - p.usual_friction)
    return f, g


@inlined
def _dot(a, b, memory):
    total = 0.0
    for j in range(STATES):
        total += memory[a + j] * memory[b + j]
    return total


@inlined
def _project(at, h, target, memory):
    """Write h P to the scratch."""
    low, high = zeros(), zeros()
    for k in range(STATES):
        row = at + P + ROW * k
        low = fma8(spread(memory, h + k), load(memory, row), low)
        high = fma8(spread(memory, h + k), load(memory, row + WIDTH), high)
    store(memory, target, low)
    store(memory, target + WIDTH, high)


@inlined
def _leave(state, left, first, memory):
    """Let the deviation of a state shrink to a share."""
    for j in range(WIND, STATES):
        memory[first + ROW * state + j] *= left
        memory[first + ROW * j + state] *= left


@inlined
def _predict_covariance(at, f, g, p, memory):
    """P = F P F' + drift; f, g: forces of the axles over the mass (m/s^2)."""
    first, f0, f1, r0, r1 = at + P, _SCRATCH, _SCRATCH + ROW, _SCRATCH + 2 * ROW, _SCRATCH + 3 * ROW
    _project(at, f0, r0, memory)
    _project(at, f1, r1, memory)
    p00, p01, p11 = _dot(r0, f0, memory), _dot(r0, f1, memory), _dot(r1, f1, memory)
    for row in (r0, r1):
        memory[row + WIND] *= p.wind_left
        memory[row + BANK] *= p.bank_left
        memory[row + FRICTION] *= p.friction_left
    _leave(WIND, p.wind_left, first, memory)
    _leave(BANK, p.bank_left, first, memory)
    _leave(FRICTION, p.friction_left, first, memory)
    for j in range(WIND, STATES):
        memory[first + j], memory[first + ROW * j] = memory[r0 + j], memory[r0 + j]
        memory[first + ROW + j], memory[first + ROW * j + 1] = memory[r1 + j], memory[r1 + j]
    turning, weight = p.mass / p.yaw_inertia, GRAVITY / (p.lf + p.lr)
    front, rear = f * f / (weight * p.lr), g * g / (weight * p.lf)
    by_front, by_rear = p.sliding * p.period * front * front, p.sliding * p.period * rear * rear
    both = turning * (p.lf * by_front - p.lr * by_rear)
    memory[first] = p00 + p.drift_vy + by_front + by_rear
    memory[first + 1], memory[first + ROW] = p01 + both, p01 + both
    memory[first + ROW + 1] = (
        p11 + p.drift_yaw_rate + turning * turning * (p.lf * p.lf * by_front + p.lr * p.lr * by_rear)
    )
    memory[first + (ROW + 1) * WIND] += p.drift_wind
    memory[first + (ROW + 1) * BANK] += p.drift_bank
    memory[first + (ROW + 1) * FRICTION] += p.drift_friction
    if abs(f + g) > LEAST_PULL:
        memory[first + (ROW + 1) * BIAS] += p.drift_bias
        memory[first + (ROW + 1) * STIFFNESS] += p.drift_stiffness
        memory[first + (ROW + 1) * BALANCE] += p.drift_balance
        memory[first + (ROW + 1) * LAG] += p.drift_lag
        memory[first + (ROW + 1) * DEAD_TIME] += p.drift_dead_time


@inlined
def _take_in(at, innovation, row, variance, p, memory):
    """x += K nu, P -= K h P with row = h P in the scratch at `row`; the log-likelihood of nu."""
    scatter = variance
    ratio = innovation * innovation / scatter
    kept = clip(innovation, -p.bound * sqrt(scatter), p.bound * sqrt(scatter))
    low, high, scale = load(memory, row), load(memory, row + WIDTH), splat(1.0 / scatter)
    gains_low, gains_high, x = mul(scale, low), mul(scale, high), at + X
    store(memory, x, fma8(splat(kept), gains_low, load(memory, x)))
    store(memory, x + WIDTH, fma8(splat(kept), gains_high, load(memory, x + WIDTH)))
    store(memory, _SCRATCH, gains_low)
    store(memory, _SCRATCH + WIDTH, gains_high)
    for j in range(STATES):
        line, gain = at + P + ROW * j, spread(memory, _SCRATCH + j)
        store(memory, line, sub(load(memory, line), mul(gain, low)))
        store(memory, line + WIDTH, sub(load(memory, line + WIDTH), mul(gain, high)))
    return -0.5 * (min(ratio, p.bound * p.bound) + log(scatter))


@inlined
def _correct_state(at, state, value, variance, p, memory):
    """Take in a measured state."""
    row, line = _SCRATCH + 2 * ROW, at + P + ROW * state
    store(memory, row, load(memory, line))
    store(memory, row + WIDTH, load(memory, line + WIDTH))
    return _take_in(at, value - memory[at + X + state], row, memory[line + state] + variance, p, memory)


@inlined
def _correct_acceleration(at, speed, slope, value, variance, p, memory):
    """Take in the lateral acceleration, F_f + F_r + w; slope: of the wheel angle over the dead time (rad/s)."""
    slip_front, slip_rear, front, rear = _forces(at, speed, memory[at + WHEELS], p, memory)
    f, sf, mf = front
    g, sr, mr = rear
    h, row = _SCRATCH + 3 * ROW, _SCRATCH + 2 * ROW
    memory[h + VY], memory[h + RATE] = -(sf + sr) / speed, (p.lr * sr - p.lf * sf) / speed
    memory[h + WIND], memory[h + BIAS], memory[h + BANK] = 1.0, sf, 0.0
    memory[h + STIFFNESS] = sf * slip_front + sr * slip_rear
    memory[h + BALANCE], memory[h + FRICTION] = sf * slip_front - sr * slip_rear, mf + mr
    memory[h + LAG], memory[h + DEAD_TIME], memory[h + OFFSET] = sf * memory[at + BY_LAG], sf * slope, 0.0
    _project(at, h, row, memory)
    innovation = value - (f + g + memory[at + X + WIND])
    return _take_in(at, innovation, row, variance + _dot(h, row, memory), p, memory)


@inlined
def _correct_angle(at, slope, value, variance, p, memory):
    """Take in the wheel-angle sensor, delta + o; slope: of the wheel angle over the dead time (rad/s)."""
    h, row = _SCRATCH + 3 * ROW, _SCRATCH + 2 * ROW
    for state in range(LAG):
        memory[h + state] = 0.0
    memory[h + LAG], memory[h + DEAD_TIME], memory[h + OFFSET] = memory[at + BY_LAG], slope, 1.0
    _project(at, h, row, memory)
    innovation = value - memory[at + WHEELS] - memory[at + X + OFFSET]
    return _take_in(at, innovation, row, variance + _dot(h, row, memory), p, memory)


@inlined
def _bound(at, p, memory):
    """Keep what is learned within what was told."""
    x = at + X
    memory[x + STIFFNESS] = clip(memory[x + STIFFNESS], -p.most_stiffness, p.most_stiffness)
    memory[x + BALANCE] = clip(memory[x + BALANCE], -p.most_balance, p.most_balance)
    memory[x + BIAS] = clip(memory[x + BIAS], -p.most_bias, p.most_bias)
    memory[x + FRICTION] = clip(memory[x + FRICTION], -2.5, 0.5)
    memory[x + LAG] = clip(memory[x + LAG], p.least_lag, p.most_lag)
    late = memory[x + DEAD_TIME] - p.computation
    memory[x + DEAD_TIME] = p.computation + clip(late, p.least_dead_time, p.most_dead_time)


@inlined
def _is_usable(sensor, left_out, p, parameters, measured, memory):
    """Whether a sensor gives a new sample that may be believed."""
    value, variance = measured[sensor], parameters[_VARIANCE + sensor]
    stuck = kalman.is_repeated(sensor, memory[_SEEN + sensor], variance, measured)
    return math.isfinite(value) and variance < math.inf and not stuck and left_out != sensor + 1


@inlined
def _hear_noise(p, parameters, measured, memory):
    """The variance of each sensor, by third differences of its samples."""
    for sensor in range(kalman.SENSORS):
        told, value, seen = parameters[_VARIANCE + sensor], measured[sensor], _SEEN + sensor
        if not told < math.inf:
            continue
        one, two, three = memory[seen], memory[seen + WIDTH], memory[seen + 2 * WIDTH]
        difference = value - 3.0 * one + 3.0 * two - three
        if math.isfinite(difference) and value != one and one != two and two != three and memory[_SLOW] < 0.5:
            memory[_NOISE_COUNT + sensor] += 1.0
            count, found = memory[_NOISE_COUNT + sensor], memory[NOISE + sensor]
            squared, wide = difference * difference / 20.0, p.noise_range * p.noise_range
            if count > SETTLED:
                squared = min(squared, LIVELY * LIVELY * found)
            found += max(1.0 / count, p.noise_share) * (squared - found)
            least = max(told / wide, square(kalman.LEAST_NOISE[sensor]))
            memory[NOISE + sensor] = clip(found, least, max(told * wide, least))
        memory[seen + 2 * WIDTH], memory[seen + WIDTH], memory[seen] = two, one, value


@inlined
def _lose_motion(at, memory):
    """Know no more of the motion of the car."""
    for state in range(2):
        memory[at + X + state] = 0.0
        for j in range(STATES):
            memory[at + P + ROW * state + j], memory[at + P + ROW * j + state] = 0.0, 0.0
        memory[at + P + (ROW + 1) * state] = UNKNOWN


@inlined
def _begin(first, count, p, measured, command, memory):
    """From the first sample of a drive."""
    for i in range(whole(p.kept)):
        memory[SENT + i] = command
    for sensor in range(kalman.SENSORS):
        memory[_SEEN + sensor] = measured[sensor]
        memory[_SEEN + WIDTH + sensor], memory[_SEEN + 2 * WIDTH + sensor] = math.nan, math.nan
    for i in range(count):
        at = first + BLOCK * i
        memory[at + WHEELS], memory[at + BY_LAG] = command, 0.0
        _lose_motion(at, memory)
        for state, sensor in ((VY, MEASURED.vy), (RATE, MEASURED.yaw_rate)):
            value = measured[sensor]
            memory[at + X + state] = value if math.isfinite(value) else 0.0


@inlined
def _creep(first, count, age, p, memory):
    """Of a car that stands or creeps only the wheels move; its motion is unknown after."""
    for i in range(count):
        at = first + BLOCK * i
        _follow(at, age, p, memory)
        _lose_motion(at, memory)


@inlined
def _difference(first, count, memory):
    """Variance of the wheel angles of the hypotheses (rad^2)."""
    mean, square = 0.0, 0.0
    for i in range(count):
        angle = memory[first + BLOCK * i + WHEELS]
        mean += angle / count
        square += angle * angle / count
    return square - mean * mean


@inlined
def _weigh(first, count, memory):
    """The weights of the hypotheses."""
    best, total = -math.inf, 0.0
    for i in range(count):
        best = max(best, memory[first + BLOCK * i + EVIDENCE])
    for i in range(count):
        at = first + BLOCK * i
        memory[at + EVIDENCE] = max(memory[at + EVIDENCE] - best, LOWEST)
        memory[at + WEIGHT] = exp(memory[at + EVIDENCE])
        total += memory[at + WEIGHT]
    for i in range(count):
        memory[first + BLOCK * i + WEIGHT] /= total


@inlined
def _mixture(first, count, place, memory):
    """Mean of an entry over the hypotheses."""
    mean = 0.0
    for i in range(count):
        at = first + BLOCK * i
        mean += memory[at + WEIGHT] * memory[at + place]
    return mean


@inlined
def _covariance(first, count, one, other, memory):
    """Covariance of two states: that of their means over the filters, and the mean of that within each."""
    a, b = _mixture(first, count, X + one, memory), _mixture(first, count, X + other, memory)
    total = 0.0
    for i in range(count):
        at = first + BLOCK * i
        between = (memory[at + X + one] - a) * (memory[at + X + other] - b)
        total += memory[at + WEIGHT] * (between + memory[at + P + ROW * one + other])
    return total


@inlined
def _tell_state(first, count, state, place, memory):
    """Write mean and standard deviation of a state to the answer."""
    memory[ANSWER + place] = _mixture(first, count, X + state, memory)
    memory[ANSWER + place + 1] = sqrt(max(_covariance(first, count, state, state, memory), 0.0))


@inlined
def _toward(now, wanted, more, less):
    """A step from a number towards a wanted one, so much up or down at most."""
    return now + clip(wanted - now, -less, more)


@inlined
def _widen(place, prior, p, memory):
    """Tell a standard deviation that is not too small, nor larger than what was told."""
    memory[ANSWER + place] = min(p.modest * memory[ANSWER + place], max(prior, memory[ANSWER + place]))


@inlined
def _tell(first, count, p, parameters, memory):
    """Write what is learned, and let what the controller believes follow it."""
    out = ANSWER
    lag, dead = _mixture(first, count, X + LAG, memory), _mixture(first, count, X + DEAD_TIME, memory)
    of_lag = max(_covariance(first, count, LAG, LAG, memory), 0.0)
    of_dead = max(_covariance(first, count, DEAD_TIME, DEAD_TIME, memory), 0.0)
    both = _covariance(first, count, LAG, DEAD_TIME, memory)
    variance = max(of_lag + of_dead + 2.0 * both, 1e-8)
    sigma = sqrt(variance)
    memory[out + BELIEF.belief_lag], memory[out + BELIEF.belief_lag_sigma] = lag, sqrt(of_lag)
    dead_time = dead - p.computation
    memory[out + BELIEF.belief_dead_time] = dead_time
    memory[out + BELIEF.belief_dead_time_sigma] = sqrt(of_dead)
    memory[out + BELIEF.belief_delay], memory[out + BELIEF.belief_delay_sigma] = lag + dead_time, sigma
    _tell_state(first, count, STIFFNESS, BELIEF.belief_stiffness, memory)
    _tell_state(first, count, BALANCE, BELIEF.belief_balance, memory)
    _tell_state(first, count, BIAS, BELIEF.belief_bias, memory)
    _tell_state(first, count, BANK, BELIEF.belief_bank, memory)
    _tell_state(first, count, FRICTION, BELIEF.belief_friction, memory)
    stiffness, balance = memory[out + BELIEF.belief_stiffness], memory[out + BELIEF.belief_balance]
    unsure = memory[out + BELIEF.belief_stiffness_sigma]
    memory[out + BELIEF.belief_stiffness] = exp(stiffness)
    memory[out + BELIEF.belief_balance] = exp(2.0 * balance)
    memory[out + BELIEF.belief_balance_sigma] *= 2.0
    memory[out + BELIEF.belief_friction] = exp(memory[out + BELIEF.belief_friction])
    noise = memory[NOISE + MEASURED.yaw_rate] / parameters[_VARIANCE + MEASURED.yaw_rate]
    memory[out + BELIEF.belief_noise] = sqrt(noise)
    later = p.cautious / sigma
    wanted_lag = clip(lag + later * (of_lag + both), p.least_lag, p.most_lag)
    wanted_dead = clip(dead_time + later * (of_dead + both), p.least_dead_time, p.most_dead_time)
    used = memory[out + BELIEF.used_lag]
    memory[out + BELIEF.used_lag] = _toward(used, wanted_lag, p.longer, p.shorter)
    used = memory[out + BELIEF.used_dead_time]
    memory[out + BELIEF.used_dead_time] = _toward(used, wanted_dead, p.longer, p.shorter)
    used = log(memory[out + BELIEF.used_stiffness])
    memory[out + BELIEF.used_stiffness] = exp(_toward(used, stiffness, p.stiffer, p.stiffer))
    used = log(memory[out + BELIEF.used_balance])
    memory[out + BELIEF.used_balance] = exp(_toward(used, 2.0 * balance, p.stiffer, p.stiffer))
    used = memory[out + BELIEF.used_bias]
    memory[out + BELIEF.used_bias] = _toward(used, memory[out + BELIEF.belief_bias], p.turning, p.turning)
    caution = min(1.0 + variance / (p.tolerated * p.tolerated), p.most_caution)
    memory[out + BELIEF.used_caution] = caution * (1.0 + square(unsure / p.tolerated_stiffness))
    _widen(BELIEF.belief_lag_sigma, p.prior_lag, p, memory)
    _widen(BELIEF.belief_dead_time_sigma, p.prior_dead_time, p, memory)
    _widen(BELIEF.belief_delay_sigma, p.prior_delay, p, memory)
    _widen(BELIEF.belief_stiffness_sigma, p.prior_stiffness, p, memory)
    _widen(BELIEF.belief_balance_sigma, p.prior_balance, p, memory)
    _widen(BELIEF.belief_bias_sigma, p.prior_bias, p, memory)


@exported(LEARN, name="learn_car")
def learn(speed, measured, command, left_out, parameters, memory):
    """See `LEARN`."""
    p = _unpack(parameters)
    first, count = SENT + padded(whole(p.kept)), whole(p.hypotheses)
    if memory[COUNT] < 0.5:
        _begin(first, count, p, measured, command, memory)
        memory[COUNT] = 1.0
        return
    memory[COUNT] += 1.0
    for i in range(whole(p.kept) - 1, 0, -1):
        memory[SENT + i] = memory[SENT + i - 1]
    memory[SENT] = command
    age = measured[MEASURED.motion_age]
    age = age if 0.0 < age < ABSURD else 0.0
    memory[_SLOW] = 0.0 if abs(speed) >= SLOWEST and math.isfinite(speed) else 1.0
    if memory[_SLOW] > 0.5:
        _creep(first, count, age, p, memory)
        _hear_noise(p, parameters, measured, memory)
        return
    use_vy = _is_usable(MEASURED.vy, left_out, p, parameters, measured, memory)
    use_rate = _is_usable(MEASURED.yaw_rate, left_out, p, parameters, measured, memory)
    use_felt = _is_usable(MEASURED.lateral_acceleration, left_out, p, parameters, measured, memory)
    use_angle = _is_usable(MEASURED.wheel_angle, left_out, p, parameters, measured, memory)
    _hear_noise(p, parameters, measured, memory)
    for i in range(count):
        at = first + BLOCK * i
        before = memory[at + WHEELS]
        _follow(at, age, p, memory)
        f, g = _predict_state(at, speed, before, p, memory)
        _predict_covariance(at, f, g, p, memory)
        slope = (before - memory[at + WHEELS]) / p.period
        lag, dead_time, found = memory[at + X + LAG], memory[at + X + DEAD_TIME], 0.0
        if use_rate:
            value, variance = measured[MEASURED.yaw_rate], memory[NOISE + MEASURED.yaw_rate]
            found += _correct_state(at, RATE, value, variance, p, memory)
        if use_vy:
            found += _correct_state(at, VY, measured[MEASURED.vy], memory[NOISE + MEASURED.vy], p, memory)
        if use_felt:
            value, variance = measured[MEASURED.lateral_acceleration], memory[NOISE + MEASURED.lateral_acceleration]
            found += _correct_acceleration(at, speed, slope, value, variance, p, memory)
        if use_angle:
            value, variance = measured[MEASURED.wheel_angle], memory[NOISE + MEASURED.wheel_angle]
            found += _correct_angle(at, slope, value, variance + p.angle_error, p, memory)
        _bound(at, p, memory)
        memory[at + WHEELS] += memory[at + BY_LAG] * (memory[at + X + LAG] - lag)
        memory[at + WHEELS] += slope * (memory[at + X + DEAD_TIME] - dead_time)
        memory[at + WEIGHT] = found
    if _difference(first, count, memory) > LEAST_DIFFERENCE * LEAST_DIFFERENCE:
        for i in range(count):
            at = first + BLOCK * i
            memory[at + EVIDENCE] = (1.0 - p.forgetting) * memory[at + EVIDENCE] + p.tempering * memory[at + WEIGHT]
    _weigh(first, count, memory)
    _tell(first, count, p, parameters, memory)


@inlined
def lead_of(parameters, memory):
    """Periods from an instant until its command begins to act, as believed."""
    p = _unpack(parameters)
    return (memory[ANSWER + BELIEF.used_dead_time] + p.computation) / p.period


@inlined
def ahead_of(ahead, parameters, memory):
    """By how much (rad) the command may be ahead of the wheels; ahead: for the lag as told."""
    p = _unpack(parameters)
    return ahead * (memory[ANSWER + BELIEF.used_lag] + p.period) / (p.lag + p.period)


@exported(BELIEVE)
def believe(parameters, memory, model, own, remembered):
    """See `BELIEVE`.

    The part of the disturbances that a change of the bias explains leaves them, so that no prediction jumps.
    """
    p, out = _unpack(parameters), ANSWER
    factor, balance = memory[out + BELIEF.used_stiffness], sqrt(memory[out + BELIEF.used_balance])
    front, rear = 0.5 * p.stiffness_front * factor * balance, 0.5 * p.stiffness_rear * factor / balance
    lag = memory[out + BELIEF.used_lag]
    for target, at in ((model, 0), (own, len(kalman.NUMBERS))):
        target[at + path.STIFFNESS_FRONT], target[at + path.STIFFNESS_REAR] = front, rear
        target[at + path.LAG] = lag
    late = (memory[out + BELIEF.used_dead_time] + p.computation) / p.period
    periods = floor(late + 1e-9)
    own[kalman.WHOLE], own[kalman.SHARE] = periods, late - periods if late - periods > 1e-9 else 0.0
    own[kalman.BIAS] = memory[out + BELIEF.used_bias]
    if memory[COUNT] > 1.5:
        more = own[kalman.BIAS] - memory[_BIAS_BEFORE]
        kalman.shift_bias(more, 2.0 * front / p.mass, 2.0 * front * p.lf / p.yaw_inertia, remembered)
    memory[_BIAS_BEFORE] = own[kalman.BIAS]
    for sensor in range(kalman.SENSORS):
        told = parameters[_VARIANCE + sensor]
        own[kalman.VARIANCE + sensor] = memory[NOISE + sensor] if told < math.inf else told
    unknown = p.wandering * memory[out + BELIEF.belief_delay_sigma] / p.modest
    own[kalman.DRIFT_WHEELS] = p.drift_wheels + unknown * unknown * p.period
    kalman.forget_speed(remembered)
