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

The logarithms of the likelihoods of the innovations (bounded: `innovation_bound`) weigh the filters, with a slow
forgetting; what is learned is mean and variance of the mixture. Sources: D. T. Magill, Optimal adaptive
estimation of sampled stochastic processes, IEEE Trans. Automatic Control 10 (1965) (the bank); H. W. Sorenson, D. L.
Alspach, Recursive Bayesian estimation using Gaussian sums, Automatica 7 (1971) (the mixture); D. Simon, *Optimal State
Estimation* (2006), chapters 10.2 and 13; R. Rajamani, *Vehicle Dynamics and Control*, 2nd ed., chapter 2.

Evidence about the delay counts while the hypotheses differ in their wheel angles; a car that stands or creeps, samples
that are missing, repeated to the last bit or left out by the controller's filter teach nothing.

The belief is in one state at a time. A mean of the squared innovations over their variance, 1 or less for filters that
are right, above `CONTRADICTION_BEGIN` says that what is measured contradicts what is believed (the NIS test: Y.
Bar-Shalom, X. R. Li, T. Kirubarajan, *Estimation with Applications to Tracking and Navigation* (2001), section 5.4):
the variances of stiffness, balance and friction then grow to the prior's, and far from the grip that of the bias.
The delay has a test of its own, in excited driving far from the grip (`_test_delay`), and is not learned near the grip.
 A quantity whose mean is at the end of its
range is reported as uncertain as before the first sample, however small the variance of the filters.

The filters know neither the relaxation of the tyres nor longitudinal forces. At low speed a relaxing tyre responds as
late as a soft one, so without v_y stiffness, balance and friction are held below `least_tyre_speed`, and no
contradiction is sought. Under drive and brake forces all is learned: braking with 4 m/s^2 shifts the balance by up to
0.1 and the stiffness by up to 0.1 of their logarithms, less than is reported as uncertain except on low friction.

The noise of each sensor is that of third differences of its samples, E(x_k - 3 x_(k-1) + 3 x_(k-2) - x_(k-3))^2 =
20 sigma^2 for white noise: the motion of a car hardly shows in them. Samples whose ages vary are not evenly spaced:
divided differences replace these differences, and a filter moves on by the time between two samples.
"""

from __future__ import annotations

import math

from ..kernel import (
    Field,
    columns,
    exported,
    fields_of,
    float64,
    inlined,
    int64,
    local,
    record,
    size_of,
    vector,
    viewer,
    void,
)
from ..maths.bits import two_to, whole
from ..maths.exact import clip, floor, sqrt, square
from ..maths.exponential import exp, log
from ..maths.vectors import VECTOR_WIDTH
from ..models import path
from ..models.car import SINGLE_TRACK
from ..models.contract import MEASUREMENT, PERIOD_FIELD
from ..physics.forces import GRAVITY
from . import kalman
from .extended_kalman import IMPOSSIBLE_SIGNAL, bounded, carry, correct, scatter
from .learning_method import LearningMethod

LearnerParameters = record("LearnerParameters", (
    ("method", LearningMethod),  # its bias is the bound of |b|
    PERIOD_FIELD,
    Field("computation", "s", 0.0, "from a measurement until its command is given", "[0, 10]"),
    Field("lag", "s", 0.0, "of the steering, as given", "[0, 10]"),
    Field("hypotheses", "", 0, "how many"),
    Field("commands", "", 0, "commands that are remembered"),
    *SINGLE_TRACK,  # as known; stiffness of an axle
    "wind_turn",  # 1/m, yaw acceleration over lateral acceleration of side wind
    "rate",  # rad/s, of the steering; inf: no limit
    "drift_vy", "drift_yaw_rate", "drift_wind", "drift_bias", "drift_bank", "drift_stiffness", "drift_balance",
    "drift_friction", "drift_delay",  # variances that a period adds
    "drift_wheels",  # rad^2, variance that a period adds to the wheel angle in the controller's filter
    "wind_left", "bank_left", "friction_left",  # share of a deviation that is left after a period
    "usual_friction",  # ln mu to which friction returns
    *(Field(f"{end}_{name}", "s", 0.0, "as given", "[0, 10]")
      for name in ("lag", "dead_time") for end in ("least", "most")),
    "most_stiffness", "most_balance",  # bounds of |s| and |q|
    "prior_lag", "prior_dead_time", "prior_delay", "prior_stiffness", "prior_balance", "prior_bias",  # as given
    "delay_tolerance", "stiffness_tolerance",  # s, -: standard deviations that double R
    "evidence_share", "contradiction_share", "return_share", "doubt_share", "noise_share",  # of a period in each time
    "max_delay_step",  # s per period, by which the lag and the dead time in use change at most
    "max_stiffness_step", "max_bias_step",  # 1 and rad per period, likewise
    ("variance", (float64, kalman.SENSOR_COUNT)),  # of the sensors, as given; inf: none
    "change_share",  # of a period in the time over which the delay is tested
    "prior_friction",  # standard deviation of the logarithm of friction
))  # fmt: skip
"""The parameters."""
parameters_of = viewer(LearnerParameters)

LEARNED = columns(
    Field("lag", "s", 0.0, "lag of the steering", "[0, 10]"),
    Field("dead_time", "s", 0.0, "dead time of the steering", "[0, 10]"),
    Field("delay", "s", 0.0, "lag and dead time together"),
    Field("stiffness", "", 1.0, "stiffness/mass, relative to the car file", "(0, 100]"),
    Field("balance", "", 1.0, "front/rear stiffness, relative to the car file", "(0, 100]"),
    Field("bias", "rad", 0.0, "bias of the wheels", "[-1, 1]"),
    Field("bank", "m/s^2", 0.0, "acceleration by the bank"),
    Field("friction", "", 1.0, "friction"),
)
"""Learned quantities. Those with bounds have a range that is never left; of a factor, whose default is 1, the logarithm
has the standard deviation."""
QUANTITIES_BOUNDED = tuple(field.name for field in fields_of(LEARNED) if field.bounds)
LOGARITHMIC = tuple(field.name for field in fields_of(LEARNED) if field.default == 1.0)
BELIEF_NAMES = (
    *(f"belief_{name}{end}" for name in LEARNED._fields for end in ("", "_sigma")),
    "belief_noise",  # of the yaw rate, over what was given
    *(f"used_{name}" for name in QUANTITIES_BOUNDED), "used_caution",  # by the controller
    "belief_state", "belief_at_bound",  # `LEARNING_BELIEF`, ...; 0 or 1 + a place in `QUANTITIES_BOUNDED`
    "belief_change",  # 1: the innovations showed another delay, and it has not settled since
    "belief_grip_use",  # largest share of its grip that an axle uses
)  # fmt: skip
"""What is learned, and what the controller believes of it, at every step."""
LAG_BOUND, DEAD_TIME_BOUND, STIFFNESS_BOUND, BALANCE_BOUND, BIAS_BOUND = range(5)
"""Whose ranges have ends."""
LEARNING_BELIEF, SETTLED_BELIEF, AT_BOUND, CONTRADICTORY = range(4)
"""States of the belief; of those that apply the last one counts."""
CONTRADICTION_BEGIN, CONTRADICTION_END = 3.0, 1.5
"""Mean of squared innovations over their variance at which a contradiction begins, and ends."""
CERTAIN, UNCERTAIN = (0.015, 0.06), (0.0225, 0.09)
"""Standard deviations of the delay (s) and of s, in the filters, below both of which the belief settles, and above one
of which it does so no longer."""
KNOWN_DELAY_SIGMA = 0.035
"""s, standard deviation as it is reported, inflated: below it the delay is known well enough to drive at any speed."""
RIGID = 1.3
"""Logarithm of the factor on the stiffness from which on a car turns as if its tyres did not slip."""
BOUND_ENTRY_SHARE, BOUND_EXIT_SHARE = 0.01, 0.03
"""Shares of a range within which of its end a mean is at the bound, and beyond which no longer."""
BELIEF_COLUMNS, Beliefs = columns(*BELIEF_NAMES), record("Beliefs", BELIEF_NAMES)

LEARNER_STATES = 11
(
    LATERAL_VELOCITY, YAW_RATE, WIND_FORCE, BIAS, BANK, STIFFNESS_SCALE, BALANCE, FRICTION, STEERING_LAG, DEAD_TIME,
    OFFSET,
) = range(LEARNER_STATES)  # fmt: skip
"""Places in x; the dead time with the computation."""
_ROW = 2 * VECTOR_WIDTH
"""x and the rows of its covariance are padded to so many."""

DelayChange = record(
    "DelayChange", ("score_lag", "score_dead_time", "information_lag", "information_both", "information_dead_time")
)
"""Score (1/s) and information (1/s^2, a symmetric matrix) of an error of lag and dead time."""

Memory = record("Memory", (
    ("beliefs", Beliefs),
    "count",  # steps so far
    "slow",  # 1 while the car is too slow to learn from
    "age",  # s, of the motion in the hypotheses, at the present instant
    "step", "second_step", "third_step",  # s, between the last motion samples, the latest first
    "bias_before",  # rad, bias in the controller's filter
    "disagreement",  # mean of squared innovations over their variance
    "doubt",  # 0 to 1, of what is at a bound or contradicted: by which R is raised
    ("noise", (float64, kalman.SENSOR_COUNT)),  # variances of the sensors as learned
    ("noise_count", (float64, kalman.SENSOR_COUNT)),  # from so many samples
    *(Field(name, "", (math.nan,) * kalman.SENSOR_COUNT, "samples") for name in ("last", "second_last", "third_last")),
    ("change", DelayChange),  # over the last seconds of excited driving
    "excited",  # s, of excited driving so far
    "holds_tyres",  # 1 while the states of the tyres are not learned
))  # fmt: skip
"""What the memory begins with; the commands that were sent follow, then the hypotheses."""
memory_of = viewer(Memory)
BELIEFS_OFFSET = 0
"""Place in the memory of `BELIEF_NAMES`."""
_SENT = size_of(Memory)

Hypothesis = record("Hypothesis", (
    "wheels", "by_lag",  # rad, wheel angle; rad/s, its derivative over the lag
    "swept", "swept_by_lag",  # both integrated over the last period
    "disagreement",  # squared innovations over their variance, mean of the sensors at the last sample
    "evidence", "weight",  # logarithm of its likelihood; weight in the mixture
    Field("x", "", (0.0,) * _ROW, "the states, in SI units or as logarithms", "[-1000, 1000]"),
    ("covariance", (float64, LEARNER_STATES, _ROW)),
    "grip_use",  # largest share of its grip that an axle uses
    ("change", DelayChange),  # by the last samples
    ("gain", (float64, LEARNER_STATES)),  # information about a state (1 over its variance) that a second has added
))  # fmt: skip
"""A filter."""
_hypothesis, _HYPOTHESIS = viewer(Hypothesis), size_of(Hypothesis)

AxleForce = record("AxleForce", ("slip", "force", "by_slip", "by_friction"))
"""Slip angle (rad) of an axle, its force over the mass (m/s^2), and the force's derivatives over slip and ln mu."""

_states, _motion, _sensors = local(_ROW), local(2, _ROW), local(kalman.SENSOR_COUNT)
_TAKEN_IN = (MEASUREMENT.yaw_rate, MEASUREMENT.vy, MEASUREMENT.lateral_acceleration, MEASUREMENT.wheel_angle)
"""Sensors, in the order in which a hypothesis takes them in."""
SHORTEST_LAG = 0.02
"""s, a lag that makes no difference at a control period of 0.05 s: the least that is sought where nobody says more."""
SHORTEST_STEP, LONGEST_STEP, STEP_ERROR = 0.1, 2.0, 0.1
"""Control periods from one motion sample to the next: least and most; error up to which a sample is taken in."""
MIN_LEARNING_SPEED = 2.0
"""m/s, below which nothing is learned."""
UNKNOWN_MOTION_VARIANCE = 0.1
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
LEAST_DELAY_VARIANCE = 1e-9
"""s^2"""
RETURNING = (STIFFNESS_SCALE, BALANCE, FRICTION, BIAS)
"""What returns to its prior in a contradiction; the bias only far from the grip."""
OF_STEERING, OF_TYRES = (STEERING_LAG, DEAD_TIME), (STIFFNESS_SCALE, BALANCE, FRICTION)
"""States that are held where the model is wrong: near the grip; at low speed without v_y."""

LEARN = void(float64, vector, float64, int64, vector, vector)
"""``learn(speed, measured, command, excluded, parameters, memory)``: take in what was measured (`MEASUREMENT`) at a
speed (m/s) and the command (rad) of a period ago; excluded: 1 + a sensor not to be believed, 0: none."""

BELIEVE = void(vector, vector, vector, vector, vector)
"""``believe(parameters, memory, model, filter_parameters, remembered)``: let model and filter of the controller believe
what is learned; model: parameters of the path model; filter_parameters, remembered: parameters and memory of the
filter."""


def memory_size(commands: int, hypotheses: int) -> int:
    """Numbers that the learner remembers."""
    return _SENT + commands + _HYPOTHESIS * hypotheses


@inlined
def hypothesis(i, commands, memory):
    """The i-th hypothesis, behind so many commands."""
    return _hypothesis(memory, _SENT + whole(commands) + _HYPOTHESIS * i)


@inlined
def _steer(candidate, time, rate, command):
    """Let the wheels of a hypothesis follow a command for a time (s)."""
    lag, angle, slope = candidate.x[STEERING_LAG], candidate.wheels, candidate.by_lag
    gap = command - angle
    if abs(gap) > rate * lag:
        limited = min(time, abs(gap) / rate - lag)
        turned = math.copysign(rate * limited, gap)
        candidate.swept += limited * (angle + 0.5 * turned)
        candidate.swept_by_lag += limited * slope
        angle += turned
        gap -= turned
        time -= limited
    left = exp(-time / lag)
    after = left * (slope - gap * time / (lag * lag))
    candidate.swept += time * command - gap * lag * (1.0 - left)
    candidate.swept_by_lag += 0.5 * time * (slope + after)
    candidate.wheels, candidate.by_lag = command - gap * left, after


@inlined
def _follow(candidate, step, p, m, memory):
    """Move the wheels of a hypothesis over a time (s), up to the motion in it."""
    late, sent = max((candidate.x[DEAD_TIME] + m.age) / p.period, 0.0), memory[_SENT:]
    periods = min(whole(late + 1e-9), whole(p.commands) - 3)
    share = clip(late - periods, 0.0, 1.0)
    older = share + (step / p.period - 1.0)
    newer = 1.0 - share + min(older, 0.0)
    candidate.swept, candidate.swept_by_lag = 0.0, 0.0
    if older > 1.0:
        _steer(candidate, (older - 1.0) * p.period, p.rate, sent[periods + 2])
    if older > 0.0:
        _steer(candidate, min(older, 1.0) * p.period, p.rate, sent[periods + 1])
    if newer > 0.0:
        _steer(candidate, newer * p.period, p.rate, sent[periods])


@inlined
def _axle(slip, stiffness, most):
    """An axle at a slip angle; stiffness and largest force over the mass."""
    x = stiffness * slip / most
    root = 1.0 / sqrt(1.0 + x * x)
    force, by_slip = most * x * root, stiffness * root * root * root
    return AxleForce(slip, force, by_slip, force - by_slip * slip)


@inlined
def _axles(candidate, speed, angle, p):
    """Front and rear axle at a wheel angle (rad)."""
    x = candidate.x
    grip = GRAVITY * exp(x[FRICTION]) / (p.lf + p.lr)
    factor, balance = exp(x[STIFFNESS_SCALE]), exp(x[BALANCE])
    slip_front = angle + x[BIAS] - (x[LATERAL_VELOCITY] + p.lf * x[YAW_RATE]) / speed
    slip_rear = -(x[LATERAL_VELOCITY] - p.lr * x[YAW_RATE]) / speed
    front = _axle(slip_front, p.stiffness_front / p.mass * factor * balance, grip * p.lr)
    rear = _axle(slip_rear, p.stiffness_rear / p.mass * factor / balance, grip * p.lf)
    return front, rear


@inlined
def _accelerations(front, rear, p):
    """The parts of dv_y/dt and dr/dt from the axle forces over the mass."""
    return front + rear, p.mass / p.yaw_inertia * (p.lf * front - p.lr * rear)


@inlined
def _derive(front, rear, speed, by_lag, by_dead_time, p, of_front, of_rear):
    """Write the derivatives of both axles' forces over x; by_lag, by_dead_time: those of the wheel angle (rad/s)."""
    slope = front.by_slip
    of_front[LATERAL_VELOCITY], of_front[YAW_RATE], of_front[BIAS] = -slope / speed, -p.lf * slope / speed, slope
    of_front[STEERING_LAG], of_front[DEAD_TIME] = slope * by_lag, slope * by_dead_time
    of_front[STIFFNESS_SCALE], of_front[BALANCE] = slope * front.slip, slope * front.slip
    slope = rear.by_slip
    of_rear[LATERAL_VELOCITY], of_rear[YAW_RATE] = -slope / speed, p.lr * slope / speed
    of_rear[STIFFNESS_SCALE], of_rear[BALANCE] = slope * rear.slip, -slope * rear.slip
    of_front[FRICTION], of_rear[FRICTION] = front.by_friction, rear.by_friction


@inlined
def _times(a, b):
    """Product of two 2 x 2 matrices, by rows."""
    a_vv, a_vr, a_rv, a_rr = a
    b_vv, b_vr, b_rv, b_rr = b
    return (
        a_vv * b_vv + a_vr * b_rv, a_vv * b_vr + a_vr * b_rr, a_rv * b_vv + a_rr * b_rv, a_rv * b_vr + a_rr * b_rr,
    )  # fmt: skip


@inlined
def _identity_and(z, scale):
    """I + scale Z"""
    vv, vr, rv, rr = z
    return 1.0 + scale * vv, scale * vr, scale * rv, 1.0 + scale * rr


@inlined
def _phi1(vv, vr, rv, rr):
    """phi_1(Z) = sum_i Z^i/(i+1)! of a 2 x 2 matrix: Taylor series of Z/2^k, then phi_1(2Z) = phi_1(Z)(I + e^Z)/2."""
    norm, halvings = max(abs(vv) + abs(rv), abs(vr) + abs(rr)), 0
    while norm > 0.5 and halvings < 30:
        norm *= 0.5
        halvings += 1
    scale = two_to(-halvings)
    z, phi = (scale * vv, scale * vr, scale * rv, scale * rr), (1.0, 0.0, 0.0, 1.0)
    for i in range(_TERMS, 1, -1):
        phi = _identity_and(_times(z, phi), 1.0 / i)
    share = 0.5
    for _ in range(halvings):
        phi = _times(phi, _identity_and(_times(z, phi), share))
        share *= 2.0
    return phi


@inlined
def _predict_state(candidate, speed, by_dead_time, h, p, mixed):
    """x a time h (s) later, by the exponential Euler method, and F's rows of v_y and r; the axles' forces (m/s^2).

    With A = d(dv_y/dt, dr/dt)/dx, J its columns of v_y and r, dx = h phi_1(h J) (dv_y/dt, dr/dt) and
    F = [I 0] + h phi_1(h J) A. by_dead_time: derivative of the wheel angle (rad/s).
    """
    x, of_front, of_rear = candidate.x, _states(), _states()
    front, rear = _axles(candidate, speed, candidate.swept / h, p)
    _derive(front, rear, speed, candidate.swept_by_lag / h, by_dead_time, p, of_front, of_rear)
    pull, turn = _accelerations(front.force, rear.force, p)
    rate_vy, rate_r = pull - speed * x[YAW_RATE] + x[WIND_FORCE] + x[BANK], turn + p.wind_turn * x[WIND_FORCE]
    vy_by_vy, r_by_vy = _accelerations(of_front[LATERAL_VELOCITY], of_rear[LATERAL_VELOCITY], p)
    vy_by_r, r_by_r = _accelerations(of_front[YAW_RATE], of_rear[YAW_RATE], p)
    vv, vr, rv, rr = _phi1(h * vy_by_vy, h * (vy_by_r - speed), h * r_by_vy, h * r_by_r)
    more_vy, more_r = h * (vv * rate_vy + vr * rate_r), h * (rv * rate_vy + rr * rate_r)
    # stiffness acts on the force in the middle of the period
    middle_front = 0.5 * (of_front[LATERAL_VELOCITY] * more_vy + of_front[YAW_RATE] * more_r)
    middle_rear = 0.5 * (of_rear[LATERAL_VELOCITY] * more_vy + of_rear[YAW_RATE] * more_r)
    of_front[STIFFNESS_SCALE] += middle_front
    of_front[BALANCE] += middle_front
    of_rear[STIFFNESS_SCALE] += middle_rear
    of_rear[BALANCE] -= middle_rear
    mixed[LATERAL_VELOCITY, YAW_RATE], mixed[LATERAL_VELOCITY, WIND_FORCE] = -speed, 1.0
    mixed[YAW_RATE, WIND_FORCE], mixed[LATERAL_VELOCITY, BANK] = p.wind_turn, 1.0
    for state in range(LEARNER_STATES):
        pull, turn = _accelerations(of_front[state], of_rear[state], p)
        by_vy, by_r = mixed[LATERAL_VELOCITY, state] + pull, mixed[YAW_RATE, state] + turn
        mixed[LATERAL_VELOCITY, state] = h * (vv * by_vy + vr * by_r)
        mixed[YAW_RATE, state] = h * (rv * by_vy + rr * by_r)
    mixed[LATERAL_VELOCITY, LATERAL_VELOCITY] += 1.0
    mixed[YAW_RATE, YAW_RATE] += 1.0
    x[LATERAL_VELOCITY] += more_vy
    x[YAW_RATE] += more_r
    x[WIND_FORCE] *= p.wind_left
    x[BANK] *= p.bank_left
    x[FRICTION] = p.usual_friction + p.friction_left * (x[FRICTION] - p.usual_friction)
    return front.force, rear.force


@inlined
def _predict_covariance(candidate, mixed, f, g, step, p):
    """P = F P F' + drift over a time (s); f, g: forces of the axles over the mass (m/s^2)."""
    P, shares = candidate.covariance, _states()
    for state in range(LEARNER_STATES):
        shares[state] = 1.0
    shares[WIND_FORCE], shares[BANK], shares[FRICTION] = p.wind_left, p.bank_left, p.friction_left
    carry(mixed, shares, P, _motion())
    turning, weight = p.mass / p.yaw_inertia, GRAVITY / (p.lf + p.lr)
    candidate.grip_use = max(abs(f) / p.lr, abs(g) / p.lf) / (weight * exp(candidate.x[FRICTION]))
    front, rear = f * f / (weight * p.lr), g * g / (weight * p.lf)
    sliding, share = square(p.method.sliding) * step, step / p.period
    by_front, by_rear = sliding * front * front, sliding * rear * rear
    both = turning * (p.lf * by_front - p.lr * by_rear)
    P[LATERAL_VELOCITY, LATERAL_VELOCITY] += share * p.drift_vy + by_front + by_rear
    P[LATERAL_VELOCITY, YAW_RATE] += both
    P[YAW_RATE, LATERAL_VELOCITY] += both
    by_both = turning * turning * (p.lf * p.lf * by_front + p.lr * p.lr * by_rear)
    P[YAW_RATE, YAW_RATE] += share * p.drift_yaw_rate + by_both
    P[WIND_FORCE, WIND_FORCE] += p.drift_wind
    P[BANK, BANK] += p.drift_bank
    P[FRICTION, FRICTION] += p.drift_friction
    if abs(f + g) > LEAST_PULL:
        P[BIAS, BIAS] += p.drift_bias
        P[STIFFNESS_SCALE, STIFFNESS_SCALE] += p.drift_stiffness
        P[BALANCE, BALANCE] += p.drift_balance
        P[STEERING_LAG, STEERING_LAG] += p.drift_delay
        P[DEAD_TIME, DEAD_TIME] += p.drift_delay


@inlined
def _reading(sensor, candidate, speed, by_dead_time, p, h):
    """Reading of a sensor in x; h: its derivatives over x. by_dead_time: derivative of the wheel angle (rad/s)."""
    if sensor == MEASUREMENT.lateral_acceleration:  # F_f + F_r + w
        of_front, of_rear = _states(), _states()
        front, rear = _axles(candidate, speed, candidate.wheels, p)
        _derive(front, rear, speed, candidate.by_lag, by_dead_time, p, of_front, of_rear)
        for state in range(LEARNER_STATES):
            h[state] = of_front[state] + of_rear[state]
        h[WIND_FORCE] = 1.0
        return front.force + rear.force + candidate.x[WIND_FORCE]
    if sensor == MEASUREMENT.wheel_angle:  # delta + o
        h[STEERING_LAG], h[DEAD_TIME], h[OFFSET] = candidate.by_lag, by_dead_time, 1.0
        return candidate.wheels + candidate.x[OFFSET]
    state = LATERAL_VELOCITY if sensor == MEASUREMENT.vy else YAW_RATE
    h[state] = 1.0
    return candidate.x[state]


@inlined
def _add_score(innovation, variance, cross, candidate):
    """Add what an innovation of a variance says of an error of lag and dead time; cross: P h'.

    The slopes of the innovation over the two are P_dd^-1 (P h')_d, with P_dd their covariance.
    """
    P, change = candidate.covariance, candidate.change
    of_lag, both, of_dead_time = P[STEERING_LAG, STEERING_LAG], P[STEERING_LAG, DEAD_TIME], P[DEAD_TIME, DEAD_TIME]
    of_lag, of_dead_time = of_lag + LEAST_DELAY_VARIANCE, of_dead_time + LEAST_DELAY_VARIANCE
    determinant = of_lag * of_dead_time - both * both
    by_lag = (of_dead_time * cross[STEERING_LAG] - both * cross[DEAD_TIME]) / determinant
    by_dead_time = (of_lag * cross[DEAD_TIME] - both * cross[STEERING_LAG]) / determinant
    change.score_lag += by_lag * innovation / variance
    change.score_dead_time += by_dead_time * innovation / variance
    change.information_lag += by_lag * by_lag / variance
    change.information_both += by_lag * by_dead_time / variance
    change.information_dead_time += by_dead_time * by_dead_time / variance


@inlined
def _hold(states, before, cross, candidate):
    """Undo a correction of states and of their covariance, as for the considered states of a Schmidt filter."""
    for i in states:
        candidate.x[i] = before[i]
        for j in states:
            candidate.covariance[i, j] += cross[i] * cross[j]


@inlined
def _take_in(sensor, value, variance, candidate, speed, by_dead_time, p, m):
    """Correct x and P by a sensor of a variance; the log-likelihood of what it reads."""
    h, cross = _states(), _states()
    innovation = value - _reading(sensor, candidate, speed, by_dead_time, p, h)
    P = candidate.covariance
    variance = scatter(variance, h, P, cross)
    nu = bounded(innovation, variance, p.method.innovation_bound)
    before = _states()
    before[:] = candidate.x
    _add_score(nu, variance, cross, candidate)
    correct(nu, variance, cross, candidate.x, P)
    if candidate.grip_use > p.method.delay_grip_use:  # the model is wrong near the grip
        _hold(OF_STEERING, before, cross, candidate)
    if m.holds_tyres > 0.5:
        _hold(OF_TYRES, before, cross, candidate)
    surprise = min(square(innovation) / variance, square(p.method.innovation_bound))
    candidate.disagreement += surprise
    return -0.5 * (surprise + log(variance))


@inlined
def _bound(candidate, p):
    """Keep what is learned within what was given."""
    x = candidate.x
    x[STIFFNESS_SCALE] = clip(x[STIFFNESS_SCALE], -p.most_stiffness, p.most_stiffness)
    x[BALANCE] = clip(x[BALANCE], -p.most_balance, p.most_balance)
    x[BIAS] = clip(x[BIAS], -p.method.bias, p.method.bias)
    x[FRICTION] = clip(x[FRICTION], -2.5, 0.5)
    x[STEERING_LAG] = clip(x[STEERING_LAG], p.least_lag, p.most_lag)
    x[DEAD_TIME] = p.computation + clip(x[DEAD_TIME] - p.computation, p.least_dead_time, p.most_dead_time)


@inlined
def _is_usable(sensor, excluded, p, measured, m):
    """Whether a sensor gives a new sample that may be believed."""
    value, variance = measured[sensor], p.variance[sensor]
    stuck = kalman.is_repeated(sensor, m.last[sensor], variance, measured)
    return math.isfinite(value) and variance < math.inf and not stuck and excluded != sensor + 1


@inlined
def _squared_difference(value, last, second_last, third_last, m):
    """Square of the third divided difference of samples; its expectation is the variance of white noise."""
    a, b, c = m.step, m.second_step, m.third_step
    if a == b and b == c:
        difference = value - 3.0 * last + 3.0 * second_last - third_last
        return difference * difference / 20.0
    w, x = 1.0 / (a * (a + b) * (a + b + c)), -1.0 / (a * b * (b + c))
    y, z = 1.0 / ((a + b) * b * c), -1.0 / ((a + b + c) * (b + c) * c)
    return square(w * value + x * last + y * second_last + z * third_last) / (w * w + x * x + y * y + z * z)


@inlined
def _learn_noise(sensor, p, measured, m):
    """The variance of a sensor, by third differences of its samples."""
    declared, value = p.variance[sensor], measured[sensor]
    if not declared < math.inf:
        return
    last, second_last, third_last = m.last[sensor], m.second_last[sensor], m.third_last[sensor]
    squared = _squared_difference(value, last, second_last, third_last, m)
    if math.isfinite(squared) and value != last and last != second_last and second_last != third_last and m.slow < 0.5:
        m.noise_count[sensor] += 1.0
        count, noise = m.noise_count[sensor], m.noise[sensor]
        widening = p.method.noise_range * p.method.noise_range
        if count > SETTLED:
            squared = min(squared, LIVELY * LIVELY * noise)
        noise += max(1.0 / count, p.noise_share) * (squared - noise)
        least = max(declared / widening, square(kalman.LEAST_NOISE[sensor]))
        m.noise[sensor] = clip(noise, least, max(declared * widening, least))
    m.third_last[sensor], m.second_last[sensor], m.last[sensor] = second_last, last, value


@inlined
def _lose_motion(candidate):
    """Know no more of the motion of the car."""
    for state in range(WIND_FORCE):
        candidate.x[state] = 0.0
        candidate.covariance[state, :], candidate.covariance[:, state] = 0.0, 0.0
        candidate.covariance[state, state] = UNKNOWN_MOTION_VARIANCE


@inlined
def _begin(p, measured, command, m, memory):
    """From the first sample of a drive."""
    memory[_SENT : _SENT + whole(p.commands)] = command
    for sensor in range(kalman.SENSOR_COUNT):
        m.last[sensor], m.second_last[sensor], m.third_last[sensor] = measured[sensor], math.nan, math.nan
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        candidate.wheels, candidate.by_lag = command, 0.0
        _lose_motion(candidate)
        for state, sensor in ((LATERAL_VELOCITY, MEASUREMENT.vy), (YAW_RATE, MEASUREMENT.yaw_rate)):
            candidate.x[state] = measured[sensor] if math.isfinite(measured[sensor]) else 0.0


@inlined
def _creep(step, p, m, memory):
    """Move only the wheels of a car that stands or creeps; its motion is unknown afterwards."""
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        _follow(candidate, step, p, m, memory)
        _lose_motion(candidate)


@inlined
def _difference(p, memory):
    """Variance of the wheel angles of the hypotheses (rad^2)."""
    mean, square, count = 0.0, 0.0, whole(p.hypotheses)
    for i in range(count):
        angle = hypothesis(i, p.commands, memory).wheels
        mean += angle / count
        square += angle * angle / count
    return square - mean * mean


@inlined
def _weigh(p, memory):
    """The weights of the hypotheses."""
    best, total, count = -math.inf, 0.0, whole(p.hypotheses)
    for i in range(count):
        best = max(best, hypothesis(i, p.commands, memory).evidence)
    for i in range(count):
        candidate = hypothesis(i, p.commands, memory)
        candidate.evidence = max(candidate.evidence - best, LOWEST)
        candidate.weight = exp(candidate.evidence)
        total += candidate.weight
    for i in range(count):
        hypothesis(i, p.commands, memory).weight /= total


@inlined
def _mean(state, p, memory):
    """Mean of a state over the hypotheses."""
    mean = 0.0
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        mean += candidate.weight * candidate.x[state]
    return mean


@inlined
def _covariance(state, other, p, memory):
    """Covariance of two states: that of their means over the hypotheses, and the mean of that within each."""
    a, b = _mean(state, p, memory), _mean(other, p, memory)
    total = 0.0
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        between = (candidate.x[state] - a) * (candidate.x[other] - b)
        total += candidate.weight * (between + candidate.covariance[state, other])
    return total


@inlined
def _moments(state, p, memory):
    """Mean and variance of a state."""
    return _mean(state, p, memory), max(_covariance(state, state, p, memory), 0.0)


@inlined
def _toward(value, target, most):
    """A step from a number towards a wanted one, so much up or down at most."""
    return value + clip(target - value, -most, most)


@inlined
def _widened(variance, unmodelled, prior, bound, p, m):
    """A standard deviation as reported: not too small, not below the prior's at a bound, else not much above it."""
    sigma = sqrt(square(p.method.sigma_inflation) * variance + square(unmodelled))
    least = prior if m.beliefs.belief_at_bound == 1.0 + bound else 0.0
    return max(min(sigma, max(prior, sqrt(variance))), least)


@inlined
def _find_bound(p, m, memory):
    """1 + the quantity whose mean is at the end of its range, or 0; no delay at all and rigid tyres are no bounds."""
    was, bound = m.beliefs.belief_at_bound, 0.0
    least_lag = p.least_lag if p.least_lag > SHORTEST_LAG else -math.inf
    least_dead_time = p.least_dead_time if p.least_dead_time > 0.0 else -math.inf
    stiffness = _mean(STIFFNESS_SCALE, p, memory)
    stiffness = min(stiffness, 0.0) if p.most_stiffness > RIGID else stiffness
    for quantity, value, low, high in (
        (LAG_BOUND, _mean(STEERING_LAG, p, memory), least_lag, p.most_lag),
        (DEAD_TIME_BOUND, _mean(DEAD_TIME, p, memory) - p.computation, least_dead_time, p.most_dead_time),
        (STIFFNESS_BOUND, stiffness, -p.most_stiffness, p.most_stiffness),
        (BALANCE_BOUND, _mean(BALANCE, p, memory), -p.most_balance, p.most_balance),
        (BIAS_BOUND, _mean(BIAS, p, memory), -p.method.bias, p.method.bias),
    ):
        share = BOUND_EXIT_SHARE if was == 1.0 + quantity else BOUND_ENTRY_SHARE
        width = 2.0 * high if low == -math.inf else high - low
        at_end = min(value - low, high - value) < share * width
        if width > 0.0 and at_end and (bound == 0.0 or was == 1.0 + quantity):
            bound = 1.0 + quantity
    return bound


@inlined
def _find_state(p, m, memory):
    """The state of the belief, and the doubt at a bound."""
    b, was = m.beliefs, whole(m.beliefs.belief_state)
    b.belief_at_bound = _find_bound(p, m, memory)
    both = _covariance(STEERING_LAG, STEERING_LAG, p, memory) + _covariance(DEAD_TIME, DEAD_TIME, p, memory)
    delay = sqrt(max(both + 2.0 * _covariance(STEERING_LAG, DEAD_TIME, p, memory), 0.0))
    stiffness = sqrt(max(_covariance(STIFFNESS_SCALE, STIFFNESS_SCALE, p, memory), 0.0))
    most_delay, most_stiffness = CERTAIN if was == LEARNING_BELIEF else UNCERTAIN
    b.belief_change = 0.0 if was == SETTLED_BELIEF and delay < CERTAIN[0] else b.belief_change
    b.belief_state = SETTLED_BELIEF if delay < most_delay and stiffness < most_stiffness else LEARNING_BELIEF
    if b.belief_at_bound > 0.0:
        b.belief_state = AT_BOUND
    if m.disagreement > (CONTRADICTION_END if was == CONTRADICTORY else CONTRADICTION_BEGIN):
        b.belief_state = CONTRADICTORY
    m.doubt += p.doubt_share * ((1.0 if b.belief_state >= AT_BOUND else 0.0) - m.doubt)


@inlined
def _return_to_prior(p, memory):
    """In a contradiction the variances of what a slide contradicts grow to the prior's."""
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        _grow(STIFFNESS_SCALE, p.prior_stiffness, candidate, p)
        _grow(BALANCE, 0.5 * p.prior_balance, candidate, p)
        _grow(FRICTION, p.prior_friction, candidate, p)
        if candidate.grip_use < p.method.test_grip_use:
            _grow(BIAS, p.prior_bias, candidate, p)


@inlined
def _grow(state, prior, candidate, p):
    """Let a variance grow towards the prior's, not faster than driving like that of the last seconds reduces it.

    Of an information i per second, a variance P falls to a quarter, thus its standard deviation to half, in 3/(i P).
    """
    variance = candidate.covariance[state, state]
    share = min(p.return_share, candidate.gain[state] * variance / 3.0 * p.period)
    candidate.covariance[state, state] += share * max(square(prior) - variance, 0.0)


@inlined
def _write_beliefs(p, m, memory):
    """Write what is learned, and let what the controller believes follow it."""
    b, method = m.beliefs, p.method
    _find_state(p, m, memory)
    lag, of_lag = _moments(STEERING_LAG, p, memory)
    dead_time, of_dead_time = _moments(DEAD_TIME, p, memory)
    stiffness, of_stiffness = _moments(STIFFNESS_SCALE, p, memory)
    balance, of_balance = _moments(BALANCE, p, memory)
    bias, of_bias = _moments(BIAS, p, memory)
    bank, of_bank = _moments(BANK, p, memory)
    friction, of_friction = _moments(FRICTION, p, memory)
    both = _covariance(STEERING_LAG, DEAD_TIME, p, memory)
    variance = max(of_lag + of_dead_time + 2.0 * both, 1e-8)
    sigma, dead_time = sqrt(variance), dead_time - p.computation
    b.belief_lag, b.belief_dead_time, b.belief_delay = lag, dead_time, lag + dead_time
    b.belief_stiffness, b.belief_balance, b.belief_bias = exp(stiffness), exp(2.0 * balance), bias
    b.belief_bank, b.belief_friction = bank, exp(friction)
    b.belief_noise = sqrt(m.noise[MEASUREMENT.yaw_rate] / p.variance[MEASUREMENT.yaw_rate])
    b.belief_lag_sigma = _widened(of_lag, method.unmodelled_lag, p.prior_lag, LAG_BOUND, p, m)
    unmodelled, prior = method.unmodelled_dead_time, p.prior_dead_time
    b.belief_dead_time_sigma = _widened(of_dead_time, unmodelled, prior, DEAD_TIME_BOUND, p, m)
    b.belief_delay_sigma = _widened(variance, method.unmodelled_delay, p.prior_delay, LAG_BOUND, p, m)
    if b.belief_at_bound == 1.0 + DEAD_TIME_BOUND:
        b.belief_delay_sigma = max(b.belief_delay_sigma, p.prior_delay)
    unmodelled, prior = method.unmodelled_stiffness, p.prior_stiffness
    b.belief_stiffness_sigma = _widened(of_stiffness, unmodelled, prior, STIFFNESS_BOUND, p, m)
    b.belief_balance_sigma = _widened(4.0 * of_balance, method.unmodelled_balance, p.prior_balance, BALANCE_BOUND, p, m)
    b.belief_bias_sigma = _widened(of_bias, method.unmodelled_bias, p.prior_bias, BIAS_BOUND, p, m)
    b.belief_bank_sigma, b.belief_friction_sigma = sqrt(of_bank), sqrt(of_friction)

    later = method.delay_quantile / sigma
    wanted_lag = clip(lag + later * (of_lag + both), p.least_lag, p.most_lag)
    wanted_dead_time = clip(dead_time + later * (of_dead_time + both), p.least_dead_time, p.most_dead_time)
    b.used_lag = _toward(b.used_lag, wanted_lag, p.max_delay_step)
    b.used_dead_time = _toward(b.used_dead_time, wanted_dead_time, p.max_delay_step)
    b.used_stiffness = exp(_toward(log(b.used_stiffness), stiffness, p.max_stiffness_step))
    b.used_balance = exp(_toward(log(b.used_balance), 2.0 * balance, p.max_stiffness_step))
    b.used_bias = _toward(b.used_bias, bias, p.max_bias_step)
    caution = min(1.0 + variance / square(p.delay_tolerance), method.max_delay_caution)
    caution *= 1.0 + of_stiffness / square(p.stiffness_tolerance)
    b.used_caution = caution * (1.0 + m.doubt * (method.doubt_caution - 1.0))


@inlined
def _advance(candidate, speed, step, measured, variance, p, m, memory):
    """Move a hypothesis to the next motion sample and take it in; return the log-likelihood of the sample.

    step: s, since the last sample; variance: of the sensors, inf: not to be taken in.
    """
    before = candidate.wheels
    _follow(candidate, step, p, m, memory)
    mixed, by_dead_time = _motion(), (before - candidate.wheels) / step
    f, g = _predict_state(candidate, speed, by_dead_time, step, p, mixed)
    _predict_covariance(candidate, mixed, f, g, step, p)
    lag, dead_time, likelihood, taken_in = candidate.x[STEERING_LAG], candidate.x[DEAD_TIME], 0.0, 0.0
    candidate.disagreement = 0.0
    change = candidate.change
    change.score_lag, change.score_dead_time = 0.0, 0.0
    change.information_lag, change.information_both, change.information_dead_time = 0.0, 0.0, 0.0
    for state in RETURNING:
        candidate.gain[state] -= p.contradiction_share * (
            candidate.gain[state] + 1.0 / (p.period * candidate.covariance[state, state])
        )
    for sensor in _TAKEN_IN:
        if variance[sensor] < math.inf:
            taken_in += 1.0
            likelihood += _take_in(sensor, measured[sensor], variance[sensor], candidate, speed, by_dead_time, p, m)
    candidate.disagreement = candidate.disagreement / taken_in if taken_in > 0.0 else math.nan
    for state in RETURNING:
        candidate.gain[state] += p.contradiction_share / (p.period * candidate.covariance[state, state])
    _bound(candidate, p)
    candidate.wheels += candidate.by_lag * (candidate.x[STEERING_LAG] - lag) + by_dead_time * (
        candidate.x[DEAD_TIME] - dead_time
    )
    return likelihood


@inlined
def _judge(p, m, memory):
    """Compare what was measured with what was expected; in a contradiction, believe less."""
    surprise, information, grip_use = 0.0, 0.0, 0.0
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        surprise += candidate.weight * candidate.disagreement
        information += candidate.weight * candidate.change.information_dead_time
        grip_use += candidate.weight * candidate.grip_use
    surprise = 1.0 if m.holds_tyres > 0.5 else surprise
    if math.isfinite(surprise):
        m.disagreement += p.contradiction_share * (surprise - m.disagreement)
    if m.beliefs.belief_state == CONTRADICTORY:
        _return_to_prior(p, memory)
    if grip_use < p.method.test_grip_use and information > p.method.least_information * p.period:
        _test_delay(p, m, memory)
    m.beliefs.belief_grip_use = grip_use


@inlined
def _test_delay(p, m, memory):
    """Test whether the innovations of the last seconds of excited driving show another delay; if so, widen it.

    With score U and information I, the change is I^-1 U. Without one, U' I^-1 U has a chi^2 distribution of two
    degrees of freedom times the normalised innovations squared (score test: C. R. Rao, Proc. Cambridge Phil. Soc. 44
    (1948)).
    """
    c, left = m.change, 1.0 - p.change_share
    c.score_lag, c.score_dead_time = left * c.score_lag, left * c.score_dead_time
    c.information_lag, c.information_dead_time = left * c.information_lag, left * c.information_dead_time
    c.information_both = left * c.information_both
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        w, change = candidate.weight, candidate.change
        c.score_lag += w * change.score_lag
        c.score_dead_time += w * change.score_dead_time
        c.information_lag += w * change.information_lag
        c.information_both += w * change.information_both
        c.information_dead_time += w * change.information_dead_time
    weak = p.method.weak_information
    of_lag, of_dead_time = c.information_lag + weak, c.information_dead_time + weak
    determinant = of_lag * of_dead_time - square(c.information_both)
    lag = (of_dead_time * c.score_lag - c.information_both * c.score_dead_time) / determinant
    dead_time = (of_lag * c.score_dead_time - c.information_both * c.score_lag) / determinant
    evidence = lag * c.score_lag + dead_time * c.score_dead_time
    m.excited += p.period
    threshold = square(p.method.change_threshold) * max(m.disagreement, 1.0)
    is_large = square(lag) + square(dead_time) > square(p.method.least_change)
    if m.excited > p.method.change_begin and evidence > threshold and is_large:
        _widen_delay(lag, dead_time, p, m, memory)


@inlined
def _widen_delay(lag, dead_time, p, m, memory):
    """Widen the covariance of the delay by a change (s) of both its parts, and raise R at once."""
    for i in range(whole(p.hypotheses)):
        P = hypothesis(i, p.commands, memory).covariance
        P[STEERING_LAG, STEERING_LAG] += square(min(abs(lag), p.prior_lag, p.method.max_change))
        P[DEAD_TIME, DEAD_TIME] += square(min(abs(dead_time), p.prior_dead_time, p.method.max_change))
    c = m.change
    c.score_lag, c.score_dead_time = 0.0, 0.0
    c.information_lag, c.information_both, c.information_dead_time = 0.0, 0.0, 0.0
    m.disagreement = min(m.disagreement, CONTRADICTION_END)  # the change explains it
    m.doubt, m.beliefs.belief_change = 1.0, 1.0


@inlined
def _motion_age(measured, p, m):
    """Age (s) of the motion samples; without one that of the motion in the hypotheses."""
    age, is_measured = measured[MEASUREMENT.motion_age], False
    for sensor in _TAKEN_IN:
        is_measured = is_measured or math.isfinite(measured[sensor])
    if not is_measured:
        return m.age
    return max(age, -0.5 * p.period) if abs(age) < IMPOSSIBLE_SIGNAL else 0.0


@exported(LEARN, name="learn_car")
def learn(speed, measured, command, excluded, parameters, memory):
    """See `LEARN`."""
    p, m = parameters_of(parameters, 0), memory_of(memory, 0)
    age = _motion_age(measured, p, m)
    if m.count < 0.5:
        m.age, m.step, m.second_step = age, p.period, p.period
        _begin(p, measured, command, m, memory)
        m.count = 1.0
        return
    m.count += 1.0
    sent, latest = memory[_SENT:], command
    for i in range(whole(p.commands)):
        sent[i], latest = latest, sent[i]
    step = clip(p.period + (m.age - age), SHORTEST_STEP * p.period, LONGEST_STEP * p.period)
    m.age += p.period - step
    m.step, m.second_step, m.third_step = step, m.step, m.second_step
    in_time = abs(m.age - age) <= STEP_ERROR * p.period
    m.slow = 0.0 if abs(speed) >= MIN_LEARNING_SPEED and math.isfinite(speed) else 1.0
    measures_vy = p.variance[MEASUREMENT.vy] < math.inf
    m.holds_tyres = 1.0 if speed < p.method.least_tyre_speed and not measures_vy else 0.0
    variance = _sensors()
    for sensor in range(kalman.SENSOR_COUNT):
        usable = in_time and _is_usable(sensor, excluded, p, measured, m)
        _learn_noise(sensor, p, measured, m)
        variance[sensor] = m.noise[sensor] if usable else math.inf
    variance[MEASUREMENT.wheel_angle] += square(p.method.angle_error)
    if m.slow > 0.5:
        _creep(step, p, m, memory)
        return
    for i in range(whole(p.hypotheses)):
        candidate = hypothesis(i, p.commands, memory)
        candidate.weight = _advance(candidate, speed, step, measured, variance, p, m, memory)
    if _difference(p, memory) > LEAST_DIFFERENCE * LEAST_DIFFERENCE:
        for i in range(whole(p.hypotheses)):
            candidate = hypothesis(i, p.commands, memory)
            candidate.evidence = (1.0 - p.evidence_share) * candidate.evidence + p.method.tempering * candidate.weight
    _weigh(p, memory)
    _judge(p, m, memory)
    _write_beliefs(p, m, memory)


@exported(void(vector))
def begin_again(memory):
    """Before the first step of another drive: what has been learned stays."""
    memory_of(memory, 0).count = 0.0


@inlined
def delay_of(parameters, memory):
    """Periods from an instant until its command begins to act, as believed."""
    p = parameters_of(parameters, 0)
    return (memory_of(memory, 0).beliefs.used_dead_time + p.computation) / p.period


@inlined
def ahead_of(ahead, parameters, memory):
    """By how much (rad) the command may be ahead of the wheels; ahead: for the lag as given."""
    p = parameters_of(parameters, 0)
    return ahead * (memory_of(memory, 0).beliefs.used_lag + p.period) / (p.lag + p.period)


@exported(BELIEVE)
def believe(parameters, memory, model, filter_parameters, remembered):
    """See `BELIEVE`.

    The part of the disturbances that a change of the bias explains leaves them, so that no prediction jumps.
    """
    p, m = parameters_of(parameters, 0), memory_of(memory, 0)
    b = m.beliefs
    factor, balance = b.used_stiffness, sqrt(b.used_balance)
    front, rear = 0.5 * p.stiffness_front * factor * balance, 0.5 * p.stiffness_rear * factor / balance
    filtering = kalman.parameters_of(filter_parameters, 0)
    for parameters_row in (path.parameters_of(model, 0), filtering.model):
        parameters_row.stiffness_front, parameters_row.stiffness_rear, parameters_row.lag = front, rear, b.used_lag
    late = (b.used_dead_time + p.computation) / p.period
    periods = floor(late + 1e-9)
    filtering.periods, filtering.share = periods, late - periods if late - periods > 1e-9 else 0.0
    filtering.bias = b.used_bias
    if m.count > 1.5:
        change = filtering.bias - m.bias_before
        kalman.shift_bias(change, 2.0 * front / p.mass, 2.0 * front * p.lf / p.yaw_inertia, remembered)
    m.bias_before = filtering.bias
    for sensor in range(kalman.SENSOR_COUNT):
        declared = p.variance[sensor]
        filtering.variance[sensor] = m.noise[sensor] if declared < math.inf else declared
    unknown = p.method.wheel_drift_rate * b.belief_delay_sigma / p.method.sigma_inflation
    filtering.drift[kalman.FILTER_STATE.wheel_angle] = p.drift_wheels + unknown * unknown * p.period
    kalman.forget_speed(remembered)
