"""Linear time-varying MPC on the kinematic single track with steering lag and dead time, as Autoware's.

The error of the rear axle against the curve on which it runs when the centre of mass keeps to the path: offset e (m),
heading theta (rad), and the wheel angle delta (rad). With a stage's speed v and curvature kappa, linearised about the
wheel angle delta_r = atan(L kappa) of the kinematic turn (Autoware, "Model predictive control algorithm", eq. 12 ff.):

    de/dt     = v theta
    dtheta/dt = c delta + w,     c = v/(L cos^2 delta_r),   w = v (tan delta_r - delta_r/cos^2 delta_r)/L - v kappa
    ddelta/dt = (u - delta)/tau

Stages are `step` (s) long, held input, and discretised exactly. With x_0 the state at the end of the dead time,

    J = sum_i  q_e e_i+1^2 + (q_theta + q_theta,v v_i^2) theta_i+1^2 + (r + r_v v_i^2) (u_i - delta_r,i)^2
             + r_jerk v_i^2 ((u_i+1 - u_i)/step)^2 + r_rate (du_i)^2 + r_acc (d^2 u_i)^2

where du and d^2u are first and second differences over time, the first of them over the control period, and the last
stage has terminal weights in place of q_e and q_theta. The inputs are bounded, and so are their changes.

The states are eliminated. With S_i = Q_i + A_i' S_i+1 A_i, the weight of x_i in the cost to come, entry (j, k >= j) of
the condensed Hessian is X' S_k+1 B_k, X the state that input j has led to at k + 1: work in the square of the number
of stages (G. Frison, J. B. Jorgensen, A fast condensing method for solution of linear-quadratic control problems, CDC
2013).
"""

from __future__ import annotations

import math

import numpy as np

from ..kernel import cube, exported, inlined, int_vector, matrix, record, shaped, size_of, unpacker, vector, viewer
from ..maths.bits import whole
from ..maths.exact import clip, sqrt, square
from ..maths.exponential import exp
from ..maths.trigonometric import atan, cos, sin, tan
from ..maths.vectors import padded
from ..qp import problem as qp
from ..qp.active_set import active_set
from ..qp.factor import factorise
from . import contract, predicted_path

KINEMATIC_WEIGHTS = (
    "lateral_error",  # 1/m^2, q_e
    "heading_error",  # 1/rad^2, q_theta
    "heading_error_v2",  # s^2/(m^2 rad^2), q_theta,v
    "steering",  # 1/rad^2, r
    "steering_v2",  # s^2/(m^2 rad^2), r_v
    "lateral_jerk",  # s^4/(m^2 rad^2), r_jerk
    "steering_rate",  # s^2/rad^2, r_rate
    "steering_acceleration",  # s^4/rad^2, r_acc
    "terminal_lateral_error",  # 1/m^2
    "terminal_heading_error",  # 1/rad^2
)
KINEMATIC_TUNING = (*KINEMATIC_WEIGHTS, "cutoff")
"""The weights, and the cut-off frequency (Hz) of the Butterworth filter on the command; 0: none."""
PARAMETERS = (
    *contract.COMMON_PARAMETERS,
    "wheelbase",  # m
    "lr",  # m, centre of gravity to rear axle
    "lag",  # s, of the steering
    "dead_time",  # s, from an instant until its command begins to act
    "pose_age",  # s, how old yaw and y are
    "stages",
    "step",  # s, of a stage
    # the rows of the limits, transposed, behind these
)
KINEMATIC_DIAGNOSTICS = (
    "held",  # 1: the last command is held
    "offset",  # m, from the path to the car, positive when the car is on the left
    "heading_error",  # rad, the car's heading less the path's, both at the rear axle
    "feed_forward",  # rad, steering of the kinematic turn with the curvature of the first stage
    "qp_status",  # see `core.qp.problem`
    "qp_iterations",
)
answer_of = viewer(record("Answer", ("command", *KINEMATIC_DIAGNOSTICS)))
DISTANT = 1e-9
"""rad: a last command that differs by more from what was answered is another one's."""
LimitRows = record("LimitRows", ("angle", "angle_back", "move", "move_back"))
"""The rows of the limits on a stage's input and on its change, or their bounds."""
rows_at = viewer(LimitRows)
LIMIT_ROWS = len(LimitRows._fields)

Tuning = record("Tuning", KINEMATIC_TUNING)
Parameters = record("Parameters", PARAMETERS)
read_tuning, read_parameters = unpacker(Tuning), unpacker(Parameters)

Memory = record(
    "Memory",
    (
        "heading",  # rad, of the path, for when the car stands
        "before", "earlier",  # rad, the inputs that the last two problems were solved by
        "answered", "past",  # rad, the last answer and the command before it
        "active",  # rows of the last solution
    ),
)  # fmt: skip
"""What is remembered; `predicted_path` behind it, then the workspace."""
memory_of = viewer(Memory)
KINEMATIC_MEMORY = size_of(Memory)

STAGE = (
    "p", "q", "r", "a", "b_e", "b_theta", "b_delta", "w_e", "w_theta", "q_e", "q_theta", "speed", "reference", "g_e",
    "g_theta", "g_delta", "x_e", "x_theta",
)  # fmt: skip
"""Of each stage: A = [1 p q; 0 1 r; 0 0 a], B, w; weights of e and theta at its end; v; delta_r; S B; the free response
at its end."""
SCALAR_P, SCALAR_Q, SCALAR_R, A, B_E, B_THETA, B_DELTA, W_E, W_THETA, Q_E, Q_THETA, STAGE_SPEED, STAGE_REFERENCE = (
    range(13)
)
G_E, G_THETA, G_DELTA, X_E, X_THETA = range(13, 18)

KinematicWorkspace = record("KinematicWorkspace", (
    ("stage", matrix), ("hessian", matrix), ("gradient", vector), ("factor", cube), ("bounds", vector),
    ("solution", vector), ("multipliers", vector), ("work", cube), ("rows", matrix), ("index", int_vector),
))  # fmt: skip


def _sizes(stages: int) -> list[int]:
    """Numbers in each array of the workspace."""
    n, m = padded(stages), padded(LIMIT_ROWS * stages)
    high = max(n, len(qp.VECTOR))
    solving = [len(qp.INVERSE) * stages * n, m, n, m, len(qp.PLANE) * high * n, qp.ROW_VECTORS * m, LIMIT_ROWS * stages]
    return [len(STAGE) * n, stages * n, n, *solving]


def memory_size(stages: int, behind: float) -> int:
    """How many numbers a controller remembers; behind: periods from the measured pose to the end of the dead time."""
    return KINEMATIC_MEMORY + predicted_path.size(behind) + sum(_sizes(stages))


def limit_rows(stages: int) -> np.ndarray:
    """(stages, padded 4 stages) rows of u_i, -u_i, u_i - u_i-1 and its negative for every stage, transposed."""
    value, change = np.eye(stages), np.eye(stages) - np.eye(stages, k=1)
    rows = np.zeros((stages, padded(LIMIT_ROWS * stages)))
    for k, part in enumerate((value, -value, change, -change)):
        rows[:, k : LIMIT_ROWS * stages : LIMIT_ROWS] = part
    return rows


@inlined
def _part(size, end, memory):
    """So many numbers before a place in the memory, and where they begin."""
    return memory[end - size : end], end - size


@inlined
def _workspace(n, memory):
    """The arrays of the workspace, at the end of the memory."""
    width, m = padded(n), padded(LIMIT_ROWS * n)
    high = max(width, len(qp.VECTOR))
    index, end = _part(LIMIT_ROWS * n, memory.size, memory)
    rows, end = _part(qp.ROW_VECTORS * m, end, memory)
    work, end = _part(len(qp.PLANE) * high * width, end, memory)
    multipliers, end = _part(m, end, memory)
    solution, end = _part(width, end, memory)
    bounds, end = _part(m, end, memory)
    factor, end = _part(len(qp.INVERSE) * n * width, end, memory)
    gradient, end = _part(width, end, memory)
    hessian, end = _part(n * width, end, memory)
    stage, end = _part(len(STAGE) * width, end, memory)
    return KinematicWorkspace(
        shaped(stage, len(STAGE), width), shaped(hessian, n, width), gradient,
        shaped(factor, len(qp.INVERSE), n, width), bounds, solution, multipliers,
        shaped(work, len(qp.PLANE), high, width), shaped(rows, qp.ROW_VECTORS, m), index.view(np.int64),
    )  # fmt: skip


# -- the model --------------------------------------------------------------------------------------------------------
@inlined
def discretise_held(speed, curvature, time, p):
    """The model over a time (s) with the input held: (p, q, r, a), (b_e, b_theta, b_delta), (w_e, w_theta), delta_r."""
    reference = clip(atan(p.wheelbase * curvature), p.angle_min, p.angle_max)
    slope = 1.0 / square(cos(reference))
    c = speed / p.wheelbase * slope
    w = speed / p.wheelbase * (tan(reference) - reference * slope) - speed * curvature
    a = exp(-time / p.lag) if p.lag > 0.0 else 0.0
    once = p.lag * (1.0 - a)  # integral of exp(-t/tau), and that of its integral
    twice = p.lag * (time - once)
    half = 0.5 * time * time
    return (
        (speed * time, speed * c * twice, c * once, a),
        (speed * c * (half - twice), c * (time - once), 1.0 - a),
        (speed * w * half, w * time),
        reference,
    )


@inlined
def _roll(e, theta, reference, road, s, p, sent):
    """The state at the end of the dead time from that at the measurement; and how far (m) the rear axle is then."""
    behind = (p.pose_age + p.dead_time) / p.period
    delta, time = predicted_path.wheels_of(sent, 0).angle, -p.pose_age
    distance = -p.lr - p.pose_age * max(s.speed, contract.MIN_LAW_SPEED)
    for piece in range(predicted_path.count_pieces(behind), 0, -1):
        h = predicted_path.share_of(piece, behind) * p.period
        v = contract.planned_speed(road, time, s.speed, p.period)
        curvature = predicted_path.curvature_at(distance + 0.5 * v * h, reference, road, s, p)
        (pe, qe, r, a), (be, bt, bd), (we, wt), _ = discretise_held(v, curvature, h, p)
        u = predicted_path.sent(piece, sent)
        e = e + pe * theta + qe * delta + be * u + we
        theta = theta + r * delta + bt * u + wt
        delta = a * delta + bd * u
        time += h
        distance += v * h
    return e, theta, delta, distance


# -- the quadratic programme ------------------------------------------------------------------------------------------
@inlined
def _write_stages(distance, reference, road, s, t, p, stage):
    """Write the model, the weights and delta_r of every stage."""
    n = whole(p.stages)
    for i in range(n):
        v = contract.planned_speed(road, p.dead_time + i * p.step, s.speed, p.period)
        curvature = predicted_path.curvature_at(distance, reference, road, s, p)
        distance += v * p.step
        free, driven_response, pushed, steady = discretise_held(v, curvature, p.step, p)
        stage[SCALAR_P, i], stage[SCALAR_Q, i], stage[SCALAR_R, i], stage[A, i] = free
        stage[B_E, i], stage[B_THETA, i], stage[B_DELTA, i] = driven_response
        stage[W_E, i], stage[W_THETA, i] = pushed
        last = i == n - 1
        stage[Q_E, i] = t.terminal_lateral_error if last else t.lateral_error
        stage[Q_THETA, i] = (t.terminal_heading_error if last else t.heading_error) + t.heading_error_v2 * v * v
        stage[STAGE_SPEED, i], stage[STAGE_REFERENCE, i] = v, steady


@inlined
def _write_tracking(e, theta, delta, n, stage, hessian, gradient):
    """Write what the errors' weights give of Hessian and gradient, from the state at the end of the dead time."""
    for i in range(n):
        e, theta, delta = (
            e + stage[SCALAR_P, i] * theta + stage[SCALAR_Q, i] * delta + stage[W_E, i],
            theta + stage[SCALAR_R, i] * delta + stage[W_THETA, i],
            stage[A, i] * delta,
        )
        stage[X_E, i], stage[X_THETA, i] = e, theta
    ee = et = ed = tt = td = dd = 0.0  # S
    le = lt = ld = 0.0  # the cost to come, derived by the state
    for i in range(n - 1, -1, -1):
        if i < n - 1:
            p, q, r, a = stage[SCALAR_P, i + 1], stage[SCALAR_Q, i + 1], stage[SCALAR_R, i + 1], stage[A, i + 1]
            dd = q * (q * ee + r * et + a * ed) + r * (q * et + r * tt + a * td) + a * (q * ed + r * td + a * dd)
            td = p * (q * ee + r * et + a * ed) + q * et + r * tt + a * td
            ed = q * ee + r * et + a * ed
            tt = p * p * ee + 2.0 * p * et + tt
            et = p * ee + et
            le, lt, ld = le, p * le + lt, q * le + r * lt + a * ld
        ee, tt = ee + stage[Q_E, i], tt + stage[Q_THETA, i]
        le, lt = le + stage[Q_E, i] * stage[X_E, i], lt + stage[Q_THETA, i] * stage[X_THETA, i]
        be, bt, bd = stage[B_E, i], stage[B_THETA, i], stage[B_DELTA, i]
        stage[G_E, i] = ee * be + et * bt + ed * bd
        stage[G_THETA, i] = et * be + tt * bt + td * bd
        stage[G_DELTA, i] = ed * be + td * bt + dd * bd
        gradient[i] = le * be + lt * bt + ld * bd
    for j in range(n):
        e, theta, delta = stage[B_E, j], stage[B_THETA, j], stage[B_DELTA, j]
        for k in range(j, n):
            if k > j:
                e, theta, delta = (
                    e + stage[SCALAR_P, k] * theta + stage[SCALAR_Q, k] * delta,
                    theta + stage[SCALAR_R, k] * delta, stage[A, k] * delta,
                )  # fmt: skip
            hessian[j, k] = e * stage[G_E, k] + theta * stage[G_THETA, k] + delta * stage[G_DELTA, k]
            hessian[k, j] = hessian[j, k]


@inlined
def _add_difference(i, weight, c, hessian):
    """Add weight (c_0 u_i + c_1 u_i+1 + c_2 u_i+2)^2, as far as there are such inputs, without constant terms."""
    for j in range(3):
        for k in range(3):
            if c[j] != 0.0 and c[k] != 0.0:
                hessian[i + j, i + k] += weight * c[j] * c[k]


@inlined
def _add_steering(n, t, p, before, earlier, stage, hessian, gradient):
    """Add what the weights of the inputs and of their changes give; before, earlier: the last two inputs (rad)."""
    h, period = p.step, p.period
    for i in range(n):
        v = stage[STAGE_SPEED, i]
        weight = t.steering + t.steering_v2 * v * v
        hessian[i, i] += weight
        gradient[i] -= weight * stage[STAGE_REFERENCE, i]
        if i < n - 1:
            _add_difference(i, (t.lateral_jerk * v * v + t.steering_rate) / (h * h), (1.0, -1.0, 0.0), hessian)
        if 0 < i < n - 1:
            _add_difference(i - 1, t.steering_acceleration / square(square(h)), (1.0, -2.0, 1.0), hessian)
    rate, bend = t.steering_rate / square(period), t.steering_acceleration / square(square(period))
    _add_difference(0, rate + bend, (1.0, 0.0, 0.0), hessian)
    gradient[0] -= rate * before + bend * (2.0 * before - earlier)
    if n > 1:  # ((u_1 - u_0)/h - (u_0 - before)/period)/h
        outer, near, past = 1.0 / (h * h), -(1.0 / h + 1.0 / period) / h, 1.0 / (h * period)
        _add_difference(0, t.steering_acceleration, (near, outer, 0.0), hessian)
        gradient[0] += t.steering_acceleration * near * past * before
        gradient[1] += t.steering_acceleration * outer * past * before


@inlined
def _bound(n, before, p, bounds):
    """Write the bounds of the rows of `limit_rows`; the first change is that of a control period."""
    for i in range(n):
        share = 1.0 if i == 0 else p.step / p.period
        from_here = before if i == 0 else 0.0
        row = rows_at(bounds, LIMIT_ROWS * i)
        row.angle, row.angle_back = p.angle_max, -p.angle_min
        row.move, row.move_back = p.move_max * share + from_here, -p.move_min * share - from_here


@inlined
def _solve(n, rows, memory, ws):
    """Solve the problem in the workspace: (status, iterations). The rows that were active last are the guess."""
    m = LIMIT_ROWS * n
    status, condition = factorise(n, ws.hessian, ws.factor)
    if status != qp.SOLVED:
        return status, 0
    high = padded(m)
    problem = qp.Problem(n, m, ws.hessian, ws.gradient, shaped(rows[: n * high], n, high), ws.bounds)
    status, iterations, active = active_set(
        problem, qp.factor_of(ws.factor, condition), qp.SolutionRecord(ws.solution, ws.multipliers),
        qp.Scratch(ws.work, ws.rows, ws.index), whole(memory_of(memory, 0).active), False, 10 * (n + m),
    )  # fmt: skip
    memory_of(memory, 0).active = active
    return status, iterations


# -- the command ------------------------------------------------------------------------------------------------------
@inlined
def filtered(angle, before, earlier, last, past, share):
    """A second-order Butterworth filter by the bilinear transform; share: cut-off frequency over that of the steps.

    wanted, before, earlier: input now and in the last two steps; last, past: output in the last two. No filter where
    the share is 0 or 1/2 and more.
    """
    if not 0.0 < share < 0.5:
        return angle
    c = tan(math.pi * share)
    root = sqrt(2.0) * c
    gain = c * c * (angle + 2.0 * before + earlier)
    return (gain - 2.0 * (c * c - 1.0) * last - (1.0 - root + c * c) * past) / (1.0 + root + c * c)


@inlined
def _sent(p, memory):
    """Return the part of the memory that `predicted_path` uses."""
    return predicted_path.part_of(KINEMATIC_MEMORY, (p.pose_age + p.dead_time) / p.period, memory)


@inlined
def _take_last(command, p, memory):
    """Remember the last command (rad); where it is not what was answered, the inputs go on from it."""
    sent, state = _sent(p, memory), memory_of(memory, 0)
    if predicted_path.wheels_of(sent, 0).started == 0.0 or abs(command - state.answered) > DISTANT:
        state.before = state.earlier = state.past = clip(command, p.angle_min, p.angle_max)
    predicted_path.take_command(command, (p.pose_age + p.dead_time) / p.period, p.period, p.lag, sent)


@inlined
def _form(s, reference, road, t, p, memory):
    """Form the problem; offset, heading error and the workspace."""
    path = contract.path_ahead(reference, road, 0.0, s.speed, p.period, memory)
    place = -p.pose_age * max(s.speed, contract.MIN_LAW_SPEED) - 0.5 * p.lr
    turned = p.lr * predicted_path.curvature_at(place, reference, road, s, p)
    offset, theta = (s.y - path.y) * cos(path.heading), contract.wrapped(s.yaw - path.heading + turned)
    rear = offset - p.lr * sin(theta)
    sent, state = _sent(p, memory), memory_of(memory, 0)
    e, rolled, delta, distance = _roll(rear, theta, reference, road, s, p, sent)
    n, ws = whole(p.stages), _workspace(whole(p.stages), memory)
    _write_stages(distance, reference, road, s, t, p, ws.stage)
    _write_tracking(e, rolled, delta, n, ws.stage, ws.hessian, ws.gradient)
    _add_steering(n, t, p, state.before, state.earlier, ws.stage, ws.hessian, ws.gradient)
    _bound(n, state.before, p, ws.bounds)
    return offset, theta, ws


@inlined
def _filter(angle, cutoff, p, memory):
    """The command (rad) for an input (rad), which is remembered."""
    sent, state = _sent(p, memory), memory_of(memory, 0)
    last = predicted_path.sent(1, sent)
    output = filtered(angle, state.before, state.earlier, last, state.past, cutoff * p.period)
    state.earlier, state.before, state.past = state.before, angle, last
    return output


@exported(contract.LAW_SIGNATURE)
def kinematic_mpc(situation, reference, road, tuning, parameters, memory, answer):
    """The first of the optimal inputs, filtered; see the head of this file."""
    s, t, p = contract.read_situation(situation), read_tuning(tuning), read_parameters(parameters)
    angle = offset = heading_error = feed_forward = math.nan
    status, iterations = qp.NON_FINITE, 0
    if math.isfinite(s.command):
        _take_last(s.command, p, memory)
    if contract.all_finite(situation) and contract.all_finite(tuning):
        offset, heading_error, ws = _form(s, reference, road, t, p, memory)
        feed_forward = ws.stage[STAGE_REFERENCE, 0]
        status, iterations = _solve(whole(p.stages), parameters[len(PARAMETERS) :], memory, ws)
        if status == qp.SOLVED:
            angle = _filter(ws.solution[0], t.cutoff, p, memory)
    out = answer_of(answer, 0)
    out.command, out.held = contract.limited(angle, s, p)
    state = memory_of(memory, 0)
    state.answered = out.command
    if out.held > 0.0 or abs(s.speed) < contract.STANDSTILL_SPEED:
        state.before = state.earlier = state.past = out.command
    out.offset, out.heading_error, out.feed_forward = offset, heading_error, feed_forward
    out.qp_status, out.qp_iterations = status, iterations
