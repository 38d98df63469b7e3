"""The MPC that knows its car: it predicts from the state x and the disturbance d that an estimator gives.

    Y = F [x(k+1) - x(k); y],   x(k+1) = A x + B u + d,   F: that of the next increment (`condensing.responses`)

Samples that no car gives count as missing, a standing car's wheels stay at rest. It may learn what the car does not say
of itself (`estimators.learning`), and its command may be ahead of the wheels.
"""

from __future__ import annotations

import math

from ..estimators import kalman, learning
from ..estimators.extended_kalman import IMPOSSIBLE_SIGNAL, IMPOSSIBLE_SPEED, call_estimate
from ..kernel import exported, float64, inlined, int64, void
from ..maths.bits import whole
from ..maths.exact import clip, floor, sqrt
from ..maths.exponential import exp
from ..models import path
from ..models.contract import MEASUREMENT
from ..physics.forces import GRAVITY
from ..physics.tyre import brush_slope
from ..qp import problem as qp
from . import prediction
from .constraints import sample_at
from .mpc import MPC_ANSWER, MPC_PLACE, Functions, begin_learning

LEAST_REAR_SLOPE = 0.3
"""Of the rear tyres in the prediction, over that of the car file at no slip; below it moves grow and errors do not."""
BEND_WINDOW = 0.5
"""s, of the road behind the dead time, over which the lateral acceleration is averaged."""
SHARE_STEPS = 64.0
"""The share of the grip is rounded down to 1/64: on straights the prediction has the slope at no slip."""
MAX_SLOPE_RATE = 1.0
"""1/s, of the slope over that at no slip: a friction that jumps moves the wheels gently."""


@inlined
def _leave_out_absurd(speed, measured):
    """Let samples that no car gives be missing; the speed, NaN where it is one of them."""
    for sensor in range(kalman.SENSOR_COUNT):
        if not abs(measured[sensor]) < IMPOSSIBLE_SIGNAL:
            measured[sensor] = math.nan
    if not abs(measured[MEASUREMENT.turned]) < math.pi:
        measured[MEASUREMENT.turned] = 0.0
    return speed if abs(speed) < IMPOSSIBLE_SPEED else math.nan


@inlined
def _learn(slot, speed, mpc):
    """Learn from what is measured, and let model and estimator of the slot believe it; the factor on R."""
    informed, out = mpc.informed, mpc.answer[slot]
    learned, command = informed.learned[slot], mpc.memory[slot].command
    excluded = whole(kalman.memory_of(informed.estimates[slot], 0).excluded)
    learning.learn(speed, mpc.measured, command, excluded, informed.learner, learned)
    for i in range(len(learning.BELIEF_NAMES)):
        if not math.isfinite(learned[learning.BELIEFS_OFFSET + i]):
            begin_learning(slot, informed)
    for i in range(len(learning.BELIEF_NAMES)):
        out[len(MPC_ANSWER) + i] = learned[learning.BELIEFS_OFFSET + i]
    if math.isfinite(speed):
        learning.believe(informed.learner, learned, mpc.parameters, informed.estimator, informed.estimates[slot])
        mpc.memory[slot].speed = math.nan  # the model is formed anew
        if mpc.feed.turning.size > 0:
            path.write_turning(mpc.parameters, mpc.feed.turning)
    return out[len(MPC_ANSWER) + learning.BELIEF_COLUMNS.used_caution]


@inlined
def _keep_model(slot, mpc):
    """A and B at the speed of the slot, for the estimator."""
    informed, model = mpc.informed, mpc.model
    informed.a[slot, :, :], informed.b[slot, :] = model.a, model.b


@inlined
def _estimate(slot, speed, mpc, functions):
    """State and disturbance at a speed (m/s) by the estimator."""
    informed = mpc.informed
    mpc.answer[slot, MPC_ANSWER.dead_reckoning] = call_estimate(
        functions.estimate, speed, mpc.measured, mpc.memory[slot].command, informed.a[slot], informed.b[slot],
        informed.estimator, informed.estimates[slot], informed.x, informed.d,
    )  # fmt: skip


@exported(void(int64, float64, MPC_PLACE, Functions))
def _estimate_alone(slot, speed, mpc, functions):
    """Let the estimator have the samples of a step without a QP."""
    prediction.discretise(speed, mpc, functions)
    _keep_model(slot, mpc)
    _estimate(slot, speed, mpc, functions)
    mpc.memory[slot].speed = math.nan  # the QP's matrices are of another


@inlined
def _next_increment(slot, mpc):
    """Write x(k+1) - x(k) of the state and disturbance at hand; y (m)."""
    informed, command, output = mpc.informed, mpc.memory[slot].command, 0.0
    a, b, x, d = informed.a[slot], informed.b[slot], informed.x, informed.d
    for i in range(x.size):
        output = x[i]
        total = b[i] * command + d[i] - output
        for j in range(x.size):
            total += a[i, j] * x[j]
        mpc.ws.change[i] = total
    return output  # the last state


@inlined
def _widen_first_move(slot, mpc):
    """Let the first move bring the command ahead of the wheels, as far as the actuator follows without its rate limit.

    A first-order lag turns the wheels at (command - angle)/lag, so |command - angle| <= rate lag is what it can do.
    """
    settings, informed, command = mpc.settings, mpc.informed, mpc.memory[slot].command
    ahead, first = settings.ahead, sample_at(mpc.ws.bounds, 0)
    if settings.learns > 0:
        ahead = learning.ahead_of(ahead, informed.learner, informed.learned[slot])
    for i in range(mpc.states.size):
        if mpc.states[i] == MEASUREMENT.wheel_angle:
            first.move = max(settings.move_max, informed.x[i] + ahead - command)
            first.move_back = max(-settings.move_min, command - informed.x[i] + ahead)


@inlined
def _assumed_friction(slot, mpc):
    """Return the friction that the tyres may be assumed to have at least; 0 where they are linear.

    It comes from the measurement, else from the learner (its mean less a standard deviation), else from the filter.
    """
    friction = path.turning_of(mpc.feed.turning, 0).friction
    if friction > 0.0 and mpc.measured[MEASUREMENT.friction] > 0.0:
        return mpc.measured[MEASUREMENT.friction]
    if friction > 0.0 and mpc.settings.learns > 0:
        beliefs = learning.memory_of(mpc.informed.learned[slot], 0).beliefs
        return beliefs.belief_friction * exp(-beliefs.belief_friction_sigma)
    return friction


@exported(float64(float64, float64))
def rear_slope(acceleration, friction):
    """Return the slope of the rear tyres in the prediction, over that at no slip, at a lateral acceleration (m/s^2)."""
    used = min(abs(acceleration) / (friction * GRAVITY), 1.0) if friction > 0.0 else 0.0
    return max(brush_slope(floor(used * SHARE_STEPS) / SHARE_STEPS), LEAST_REAR_SLOPE)


@inlined
def _slope_ahead(slot, mpc):
    """Return the slope of the rear tyres' curve on the road ahead, over their slope at no slip.

    It is that of a brush tyre at the lateral acceleration which the road behind the dead time asks for on average. On a
    straight it is 1.
    """
    settings, bend, memory = mpc.settings, mpc.bend, mpc.memory[slot]
    if settings.feeds_forward == 0:
        return 1.0
    count = min(max(whole(BEND_WINDOW / settings.period + 0.5), 1), bend.size - 2)
    turn = bend[count + 1] - bend[count] - bend[1] + bend[0]  # the sum of the second differences
    slope = rear_slope(turn / (count * settings.period * settings.period), _assumed_friction(slot, mpc))
    if settings.learns > 0:
        beliefs = learning.memory_of(mpc.informed.learned[slot], 0).beliefs
        least = LEAST_REAR_SLOPE * sqrt(beliefs.used_balance) / beliefs.used_stiffness
        slope = min(max(slope, least), 1.0)
    if memory.started == 0:
        return slope
    change = MAX_SLOPE_RATE * settings.period
    return clip(slope, memory.rear_slope - change, memory.rear_slope + change)


@inlined
def _form_model(slot, speed, slope, mpc, functions):
    """Form the matrices of the QP with a slope of the rear tyres; the estimator keeps their slope at no slip."""
    if slope == 1.0:
        prediction.form_model(slot, speed, True, mpc, functions)
        _keep_model(slot, mpc)
    else:
        prediction.discretise(speed, mpc, functions)
        _keep_model(slot, mpc)
        car = path.parameters_of(mpc.parameters, 0)
        stiffness = car.stiffness_rear
        car.stiffness_rear = slope * stiffness
        prediction.form_model(slot, speed, True, mpc, functions)
        car.stiffness_rear = stiffness
    mpc.memory[slot].rear_slope = slope


@inlined
def form_informed(slot, speed, reference, tuning, mpc, functions):
    """The QP of eq. (17); see `mpc_step.form_qp`."""
    settings, memory = mpc.settings, mpc.memory[slot]
    mpc.answer[slot, MPC_ANSWER.dead_reckoning] = 0.0
    speed = _leave_out_absurd(speed, mpc.measured)
    caution = _learn(slot, speed, mpc) if settings.learns > 0 else 1.0
    status, n, m = prediction.take_tuning(slot, tuning, caution, mpc)
    speed = max(speed, settings.speed_floor)
    if status != qp.SOLVED:
        _estimate_alone(slot, speed, mpc, functions)
        return status, n, m
    slope = _slope_ahead(slot, mpc)
    if not prediction.is_formed(slot, speed, mpc) or memory.rear_slope != slope:
        _form_model(slot, speed, slope, mpc, functions)
    _estimate(slot, memory.speed, mpc, functions)
    prediction.compare(slot, _next_increment(slot, mpc), reference, mpc)
    prediction.limit_moves(slot, mpc)
    if settings.ahead > 0.0:
        _widen_first_move(slot, mpc)
    prediction.complete(slot, speed, n, mpc)
    return memory.factor_status, n, m
