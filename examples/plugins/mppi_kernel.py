"""MPPI: information-theoretic model predictive path integral control on the single track with its tyre's curve.

G. Williams, P. Drews, B. Goldfain, J. M. Rehg, E. A. Theodorou, *Information-Theoretic Model Predictive Control: Theory
and Applications to Autonomous Driving*, IEEE Transactions on Robotics 34 (2018), algorithm 2 with alpha = 0: samples
V = U + eps around a plan U are driven by the model, and U moves to their mean with the weights

    w ~ exp(-(S + lambda sum U' Sigma^-1 eps)/lambda),

S being what a sample costs. What is sampled is the change of the command in each period, so that commands stay smooth
without a filter (T. Kim, G. Park, K. Kwak, J. Bae, W. Lee, *Smooth Model Predictive Path Integral Control Without
Smoothing*, IEEE Robotics and Automation Letters 7, 2022). Samples come in pairs +-eps, whose mean is exactly U: so the
mirrored situation has the mirrored command.

The model in the frame of the car's foot on the path, at constant speed v:

    dx/dt = v cos psi - v_y sin psi,   dy/dt = v sin psi + v_y cos psi,   dpsi/dt = r
    dv_y/dt = (F_f + F_r)/m - v r,     dr/dt = (l_f F_f - l_r F_r)/I_z,   ddelta/dt = (u - delta)/tau, within the rate
    F = D sin(C atan(b - E (b - atan b))),   b = B alpha        (Pacejka, Tire and Vehicle Dynamics, 3rd ed., eq. 4.E19)

For v_y and r a period is one linearly implicit step (Hairer & Wanner, Solving Ordinary Differential Equations II,
section IV.7) with the Jacobian of the linear tyre: of second order on it, and stable at low speed.
"""

from __future__ import annotations

import math

from adaptrack.core.public import (
    COMMON_PARAMETERS,
    MIN_LAW_SPEED,
    all_finite,
    clip,
    cos,
    exp,
    fast_arctangent,
    fast_arctangent_of_ratio,
    fast_cosine,
    fast_sine,
    inlined,
    limited,
    log,
    path_at,
    random_bits,
    random_unit,
    read_situation,
    record,
    sin,
    size_of,
    sqrt,
    unpacker,
    viewer,
    whole,
)

TUNING = ("temperature", "spread", "q_e", "q_course", "r")
"""lambda (m^2 s); standard deviation of the sampled steering rate (rad/s); weights of the squared offset (1), of the
squared angle between velocity and path (m^2/rad^2) and of the squared steering rate (m^2 s^2/rad^2)."""
PARAMETERS = (
    *COMMON_PARAMETERS,
    "pairs",  # of samples, a multiple of `LANES`
    "stages",  # control periods of the horizon
    "rounds",  # of sampling in a step
    "seed",  # of the samples
    "whole", "share",  # periods of dead time: whole ones, and the share of one more
    "lag",  # s, of the steering; 0: none
    "rate", "limit",  # rad/s, rad, of the steering
    "mass", "yaw_inertia",  # kg, kg m^2
    "lf", "lr",  # m, centre of gravity to the axles
    "stiffness_front", "stiffness_rear",  # N/rad of an axle
    "peak_front", "peak_rear",  # N, D of an axle
    "shape", "curvature",  # C and E of the tyres
    "measures_vy",  # 1: the lateral velocity is measured, 0: it is taken from the model
    "pose_age",  # s, of yaw and y
)  # fmt: skip
DIAGNOSTICS = (
    "held",  # 1: the last command is held
    "effective",  # effective number of samples, 1/sum of the squared weights
    "best",  # m^2 s, cost of the best sample
)
answer_of = viewer(record("Answer", ("command", *DIAGNOSTICS)))
LANES = 32
"""Pairs that are driven together: a constant, so that the loop over them becomes vector instructions."""

Tuning = record("Tuning", TUNING)
Parameters = record("Parameters", PARAMETERS)
read_tuning, read_parameters = unpacker(Tuning), unpacker(Parameters)

Memory = record("Memory", ("steps", "wheels", "vy", "yaw_rate"))
"""What the memory begins with: steps so far; angle of the wheels by the model (rad); v_y (m/s) and yaw rate (rad/s) of
the last step. Commands sent (rad) behind it, the latest first."""
memory_of = viewer(Memory)
_SENT = size_of(Memory)
_X, _Y, _YAW, _VY, _R, _WHEELS, _COMMAND, _COST = range(8)
"""Rows of `LANES` numbers: the state of the samples that are driven, their command and their cost so far."""
_PATH_X, _PATH_Y, _COS, _SIN, _COURSE_COS, _COURSE_SIN = range(6)
"""What is known of the path at each stage: the point and the heading at its end, the heading in its middle."""
_FOR_SAMPLES = 3
"""A family of draws of its own, see `core.maths.random`."""

_PLACES = ("plan", "path", "cost", "rows", "noise", "end")
Places = record("Places", _PLACES, integers=_PLACES)
State = record("State", ("x", "y", "yaw", "vy", "r", "wheels"))
Step = record("Step", ("time", "speed", "follow", "middle", "most", "side", "side_turn", "turn_side", "turn"))
"""Of one step of the model: its length (s); v (m/s); what the wheels do of their way to the command, the mean of that
over the step, and the most (rad); the matrix h (I - h J/2)^-1 of v_y and r by rows."""


@inlined
def places(whole, stages, pairs):
    """Where each part of the memory begins."""
    plan = _SENT + whole + 2
    path = plan + stages
    cost = path + 6 * stages
    rows = cost + 2 * pairs
    noise = rows + 8 * LANES
    return Places(plan, path, cost, rows, noise, noise + stages * pairs)


@inlined
def memory_size(whole, stages, pairs):
    """Numbers that the law remembers."""
    return places(whole, stages, pairs).end


# -- the model --------------------------------------------------------------------------------------------------------
@inlined
def step_of(time, v, p):
    """What a step of the model over a time (s) at v (m/s) needs."""
    tau = max(p.lag, 1e-9)
    follow = 1.0 - exp(-time / tau)
    middle = (1.0 - tau / time * follow) / follow
    moment = p.lf * p.stiffness_front - p.lr * p.stiffness_rear
    turning = p.lf * p.lf * p.stiffness_front + p.lr * p.lr * p.stiffness_rear
    half = 0.5 * time
    a = 1.0 + half * (p.stiffness_front + p.stiffness_rear) / (p.mass * v)
    b = half * (moment / (p.mass * v) + v)
    c = half * moment / (p.yaw_inertia * v)
    d = 1.0 + half * turning / (p.yaw_inertia * v)
    scale = time / (a * d - b * c)
    most = p.rate * time if p.lag > 0.0 else math.inf
    return Step(time, v, follow, middle, most, scale * d, -scale * b, -scale * c, scale * a)


@inlined
def force(slip, stiffness, peak, p, curved):
    """Lateral force (N) of an axle at a slip angle (rad)."""
    b = stiffness / (p.shape * peak) * slip
    if curved:
        b -= p.curvature * (b - fast_arctangent(b))
    return peak * fast_sine(p.shape * fast_arctangent(b))


@inlined
def moved(s, u, m, p, curved):
    """The state after one step `m` under a command u (rad)."""
    change = clip((clip(u, -p.limit, p.limit) - s.wheels) * m.follow, -m.most, m.most)
    delta = s.wheels + m.middle * change
    front = force(
        delta - fast_arctangent_of_ratio(s.vy + p.lf * s.r, m.speed), p.stiffness_front, p.peak_front, p, curved
    )  # fmt: skip
    rear = force(-fast_arctangent_of_ratio(s.vy - p.lr * s.r, m.speed), p.stiffness_rear, p.peak_rear, p, curved)
    side = (front + rear) / p.mass - m.speed * s.r
    turn = (p.lf * front - p.lr * rear) / p.yaw_inertia
    vy = s.vy + m.side * side + m.side_turn * turn
    r = s.r + m.turn_side * side + m.turn * turn
    yaw = s.yaw + 0.5 * m.time * (s.r + r)
    between, drift = 0.5 * (s.yaw + yaw), 0.5 * (s.vy + vy)
    cos, sin = fast_cosine(between), fast_sine(between)
    return State(
        s.x + m.time * (m.speed * cos - drift * sin), s.y + m.time * (m.speed * sin + drift * cos), yaw, vy, r,
        s.wheels + change,
    )  # fmt: skip


@inlined
def _take_command(command, p, memory):
    """Keep the last command among those on their way."""
    sent, waiting, own = _SENT, whole(p.whole), memory_of(memory, 0)
    if own.steps < 0.5:
        own.wheels = command
        for j in range(waiting + 2):
            memory[sent + j] = command
    for j in range(waiting + 1, 0, -1):
        memory[sent + j] = memory[sent + j - 1]
    memory[sent] = command
    own.steps += 1.0


@inlined
def _over_the_last_period(v, p, memory):
    """Drive the model over the last period by the commands that acted in it; turn the wheels, v_y (m/s)."""
    own = memory_of(memory, 0)
    state = State(0.0, 0.0, 0.0, own.vy, own.yaw_rate, own.wheels)
    oldest = _SENT + whole(p.whole) + 1
    if p.share > 0.0:
        state = moved(state, memory[oldest], step_of(p.share * p.period, v, p), p, True)
    state = moved(state, memory[oldest - 1], step_of((1.0 - p.share) * p.period, v, p), p, True)
    own.wheels = state.wheels
    return state.vy


@inlined
def _now(s, v, curvature, p, memory):
    """The present state: what is not measured from the model, the pose carried on by its age; curvature: 1/m."""
    by_model, own = _over_the_last_period(v, p, memory), memory_of(memory, 0)
    vy = s.vy if p.measures_vy > 0.5 else by_model
    own.vy = vy if math.isfinite(vy) else 0.0
    own.yaw_rate = s.yaw_rate
    turned = p.pose_age * (s.yaw_rate - v * curvature)
    y = s.y + p.pose_age * (v * (s.yaw + 0.5 * turned) + vy)
    return State(0.0, y, s.yaw + turned, vy, s.yaw_rate, own.wheels)


@inlined
def _when_it_acts(state, v, p, memory):
    """The state at the time when the new command begins to act: the commands on their way are known."""
    waiting = whole(p.whole)
    if p.share > 0.0:
        state = moved(state, memory[_SENT + waiting], step_of(p.share * p.period, v, p), p, True)
    step = step_of(p.period, v, p)
    for j in range(waiting - 1, -1, -1):
        state = moved(state, memory[_SENT + j], step, p, True)
    return state


# -- the samples ------------------------------------------------------------------------------------------------------
@inlined
def _look_ahead(reference, road, v, p, at, memory):
    """Write what is known of the path at each stage."""
    stages = whole(p.stages)
    begun = (p.whole + p.share) * p.period
    before = path_at(reference, road, begun, v, p.period).heading
    for i in range(stages):
        path = path_at(reference, road, begun + (i + 1) * p.period, v, p.period)
        middle = 0.5 * (before + path.heading)
        before = path.heading
        row = at.path + 6 * i
        memory[row + _PATH_X], memory[row + _PATH_Y] = path.x, path.y
        memory[row + _COS], memory[row + _SIN] = cos(path.heading), sin(path.heading)
        memory[row + _COURSE_COS], memory[row + _COURSE_SIN] = cos(middle), sin(middle)


@inlined
def _draw(turn, p, at, memory):
    """Standard normal numbers for all stages and pairs, two from two uniforms (Box and Muller 1958)."""
    count = whole(p.stages) * whole(p.pairs)
    state = random_bits(random_bits(_FOR_SAMPLES, whole(p.seed)), whole(memory_of(memory, 0).steps) * 64 + turn)
    for k in range(0, count, 2):
        u = random_unit(random_bits(state, k + 1)) + 2.0**-53
        angle = 2.0 * math.pi * random_unit(random_bits(state, k + 2))
        radius = sqrt(-2.0 * log(u))
        memory[at.noise + k] = radius * cos(angle)
        memory[at.noise + k + 1] = radius * sin(angle)


@inlined
def _drive(sign, drawn, stage, t, p, m, block, curved):
    """Drive `LANES` samples over a stage; drawn: their numbers for it; stage: see `_stage`."""
    px, py, cos, sin, course_cos, course_sin, plan = stage
    spread = sign * t.spread * p.period
    inverse_distance, weight = 1.0 / (m.speed * m.time), t.r / (p.period * p.period)
    information = sign * plan * (t.temperature / (t.spread * p.period) if t.spread > 0.0 else 0.0)
    for k in range(LANES):
        state = State(
            block[_X * LANES + k], block[_Y * LANES + k], block[_YAW * LANES + k], block[_VY * LANES + k],
            block[_R * LANES + k], block[_WHEELS * LANES + k],
        )  # fmt: skip
        before = block[_COMMAND * LANES + k]
        command = before + clip(plan + spread * drawn[k], p.move_min, p.move_max)
        command = clip(command, p.angle_min, p.angle_max)
        new = moved(state, command, m, p, curved)
        offset = (new.y - py) * cos - (new.x - px) * sin
        course = ((new.y - state.y) * course_cos - (new.x - state.x) * course_sin) * inverse_distance
        move = command - before
        cost = t.q_e * offset * offset + t.q_course * course * course + weight * move * move
        block[_COST * LANES + k] += p.period * cost + information * drawn[k]
        block[_COMMAND * LANES + k] = command
        block[_X * LANES + k], block[_Y * LANES + k], block[_YAW * LANES + k] = new.x, new.y, new.yaw
        block[_VY * LANES + k], block[_R * LANES + k], block[_WHEELS * LANES + k] = new.vy, new.r, new.wheels


@inlined
def _stage(i, at, memory):
    """What is known of the path at a stage, and the planned move."""
    row = at.path + 6 * i
    return (
        memory[row + _PATH_X], memory[row + _PATH_Y], memory[row + _COS], memory[row + _SIN],
        memory[row + _COURSE_COS], memory[row + _COURSE_SIN], memory[at.plan + i],
    )  # fmt: skip


@inlined
def _cost_all(start, command, m, t, p, at, memory):
    """Write what every sample costs: those with +eps first, then those with -eps."""
    pairs, curved = whole(p.pairs), p.curvature != 0.0
    block = memory[at.rows : at.rows + 8 * LANES]  # a view of known length: the compiler sees that rows do not overlap
    for half in range(2):
        sign = 1.0 if half == 0 else -1.0
        for first in range(0, pairs, LANES):
            for k in range(LANES):
                block[_X * LANES + k], block[_Y * LANES + k], block[_YAW * LANES + k] = start.x, start.y, start.yaw
                block[_VY * LANES + k], block[_R * LANES + k] = start.vy, start.r
                block[_WHEELS * LANES + k], block[_COMMAND * LANES + k] = start.wheels, command
                block[_COST * LANES + k] = 0.0
            for i in range(whole(p.stages)):
                noise = at.noise + i * pairs + first
                drawn = memory[noise : noise + LANES]
                if curved:
                    _drive(sign, drawn, _stage(i, at, memory), t, p, m, block, True)
                else:
                    _drive(sign, drawn, _stage(i, at, memory), t, p, m, block, False)
            for k in range(LANES):
                memory[at.cost + half * pairs + first + k] = block[_COST * LANES + k]


@inlined
def _improve(t, p, at, memory):
    """Move the plan to the weighted mean of the samples; the effective number of samples, and the lowest cost.

    The plan stays as it is where a cost is not finite.
    """
    stages, pairs = whole(p.stages), whole(p.pairs)
    best = math.inf
    for k in range(2 * pairs):
        best = min(best, memory[at.cost + k])
    total = squares = 0.0
    for k in range(pairs):
        near = exp((best - memory[at.cost + k]) / max(t.temperature, 1e-300))
        far = exp((best - memory[at.cost + pairs + k]) / max(t.temperature, 1e-300))
        total += near + far
        squares += near * near + far * far
        memory[at.cost + k] = near - far
    if not (math.isfinite(total) and math.isfinite(best)):
        return math.nan, math.nan
    scale = t.spread * p.period / total
    for i in range(stages):
        shift, row = 0.0, at.noise + i * pairs
        for k in range(pairs):
            shift += memory[at.cost + k] * memory[row + k]
        memory[at.plan + i] = clip(memory[at.plan + i] + scale * shift, p.move_min, p.move_max)
    return total * total / squares, best


def mppi(situation, reference, road, tuning, parameters, memory, answer):
    """u = u(k-1) + U_0: the plan of the last step, a period on, moved to the weighted mean of samples around it."""
    s, t, p = read_situation(situation), read_tuning(tuning), read_parameters(parameters)
    at = places(whole(p.whole), whole(p.stages), whole(p.pairs))
    command = s.command if math.isfinite(s.command) else 0.0
    _take_command(command, p, memory)
    last = at.plan + whole(p.stages) - 1
    for i in range(at.plan, last):
        memory[i] = memory[i + 1]
    memory[last] = 0.0
    wanted = effective = best = math.nan
    if all_finite(situation) and all_finite(tuning):
        v = max(s.speed, MIN_LAW_SPEED)
        curvature = path_at(reference, road, 0.0, v, p.period).curvature if p.pose_age > 0.0 else 0.0
        start = _when_it_acts(_now(s, v, curvature, p, memory), v, p, memory)
        _look_ahead(reference, road, v, p, at, memory)
        for turn in range(whole(p.rounds)):
            _draw(turn, p, at, memory)
            _cost_all(start, command, step_of(p.period, v, p), t, p, at, memory)
            effective, best = _improve(t, p, at, memory)
        if math.isfinite(best):
            wanted = command + memory[at.plan]
    out = answer_of(answer, 0)
    out.command, out.held = limited(wanted, s, p)
    out.effective, out.best = effective, best
