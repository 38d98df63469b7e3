"""Optimal preview control: state feedback about the steady turn, and gains on the curvature that lies ahead.

The path model x = [v_y, psi, r, delta, y] (`core.models.path`, without delta where there is no lag) moves over a period
as x_k+1 = A x_k + B u_k + E w_k, w = curvature times speed (rad/s). The steady turn under w is X w with the steering
U w. In the deviations x~_k = x_k - X w_k and u~_k = u_k - U w_k

    x~_k+1 = A x~_k + B u~_k - X (w_k+1 - w_k)

so that only changes of w disturb, and a bend that goes on costs nothing. The sum of q_e y^2 + q_heading psi~^2 + r u~^2
is least (M. Tomizuka, Optimum linear preview control with application to vehicle suspension, J. Dyn. Syst. Meas.
Control 98, 1976; for steering R. S. Sharp, V. Valtetsiotis, Optimal preview car steering control, Vehicle System
Dynamics Suppl. 35, 2001) with

    u~ = -K x~ + sum_j g_j (w_j+1 - w_j),   K = (r + B'PB)^-1 B'PA,   g_j = (r + B'PB)^-1 B' (A - B K)'^j P X

P from the Riccati equation of A, B. The state is the one at the end of the dead time, after the commands on their way;
w_0 is that of the period which begins there.
"""

from __future__ import annotations

import math

from ..kernel import exported, inlined, record, shaped, size_of, unpacker, viewer
from ..maths.bits import whole
from ..maths.trigonometric import cos
from ..models import path as model
from ..models.contract import MEASUREMENT
from . import contract, predicted_path
from .lqr import cell_of, corner_of

PREVIEW_TUNING = ("q_e", "q_heading", "r")
PARAMETERS = (
    *contract.COMMON_PARAMETERS,
    "wheelbase",  # m
    "lr",  # m, centre of gravity to rear axle
    "understeer",  # rad s^2/m, understeer gradient
    "rear_slip",  # rad s^2/m, slip angle of the rear tyres per lateral acceleration
    "lag",  # s, of the steering
    "dead_time",  # s, from an instant until its command begins to act
    "pose_age",  # s, how old yaw and y are
    "previewed",  # number of gains on changes of w
    # the grid of gains, as that of the LQR: over log v, log q_e/r and log q_heading/r
    "log_speed", "log_speed_step", "speeds", "log_e", "log_heading", "log_weight_step", "weights",
    # the parameters of the path model behind these, then the grid, the gains last: on the states, then on changes of w
)  # fmt: skip
PREVIEW_DIAGNOSTICS = (
    "held",  # 1: the last command is held
    "offset",  # m, from the path to the car, positive when the car is on the left
    "heading_error",  # rad, the car's heading less the path's
    "curvature",  # 1/m, of the path at the end of the dead time
    "feed_forward",  # rad, steering of the steady turn with this curvature
)
answer_of = viewer(record("Answer", ("command", *PREVIEW_DIAGNOSTICS)))
OF_THE_MODEL = len(model.Parameters._fields)
PREVIEW_MEMORY = size_of(contract.Direction)
"""Numbers that the memory begins with; `predicted_path` behind them, then scratch."""
PreviewState = record(
    "PreviewState", [name for name in MEASUREMENT._fields[: MEASUREMENT.lateral_acceleration] if name != "y"]
)
"""What a state begins with, without the wheel angle where there is no lag; y is its last number."""
state_of = viewer(PreviewState)

Tuning = record("Tuning", PREVIEW_TUNING)
Parameters = record("Parameters", PARAMETERS)
read_tuning, read_parameters = unpacker(Tuning), unpacker(Parameters)


def memory_size(states: int, previewed: int, behind: float) -> int:
    """How many numbers a controller remembers; behind: periods of dead time."""
    return PREVIEW_MEMORY + predicted_path.size(behind) + states * (states + 3) + states + previewed


@inlined
def states_of(p):
    """Number of states."""
    return 5 if p.lag > 0.0 else 4


@inlined
def _sent(p, memory):
    """Return the part of the memory that `predicted_path` uses."""
    return predicted_path.part_of(PREVIEW_MEMORY, p.dead_time / p.period, memory)


@inlined
def _begin(offset, heading_error, reference, road, s, p, x):
    """Write the state now: the measured pose, moved on by its age with the present motion."""
    v, n = max(s.speed, contract.MIN_LAW_SPEED), x.size
    w = v * predicted_path.curvature_at(-0.5 * p.pose_age * v, reference, road, s, p)
    turned, state = p.pose_age * (s.yaw_rate - w), state_of(x, 0)
    state.vy, state.yaw, state.yaw_rate = s.vy, heading_error + turned, s.yaw_rate
    x[n - 1] = offset + p.pose_age * (s.vy + v * (heading_error + 0.5 * turned))


@inlined
def _roll(reference, road, s, parameters, memory, x):
    """Let the commands on their way act on x (n,); how far (m) the car is then. Scratch: the end of the memory."""
    p, n = read_parameters(parameters), x.size
    v, behind, sent = max(s.speed, contract.MIN_LAW_SPEED), p.dead_time / p.period, _sent(p, memory)
    scratch = shaped(memory[memory.size - n * (n + 3) :], n + 3, n)
    a, b, e, following = scratch[:n], scratch[n], scratch[n + 1], scratch[n + 2]
    model_row = parameters[len(PARAMETERS) : len(PARAMETERS) + OF_THE_MODEL]
    distance, time, formed = 0.0, 0.0, 0.0
    for piece in range(predicted_path.count_pieces(behind), 0, -1):
        h = predicted_path.share_of(piece, behind) * p.period
        if h != formed:
            model.discretise(v, h, model_row, a, b, e)
            formed = h
        planned = contract.planned_speed(road, time, s.speed, p.period)
        w = v * predicted_path.curvature_at(distance + 0.5 * planned * h, reference, road, s, p)
        u = predicted_path.sent(piece, sent)
        for i in range(n):
            following[i] = b[i] * u + e[i] * w
            for j in range(n):
                following[i] += a[i, j] * x[j]
        x[:] = following
        time += h
        distance += planned * h
    return distance


@inlined
def _write_deviations(distance, reference, road, s, p, z):
    """Turn the state into x~ and write the changes of w behind it; z: (states + previewed,). The first w, and U."""
    n, v, time = states_of(p), max(s.speed, contract.MIN_LAW_SPEED), p.dead_time
    planned = contract.planned_speed(road, time, s.speed, p.period)
    first = first_deviation = v * predicted_path.curvature_at(
        distance + 0.5 * planned * p.period, reference, road, s, p
    )
    heading, steering = p.rear_slip * v - p.lr / v, p.wheelbase / v + p.understeer * v
    state = state_of(z, 0)
    state.vy += v * heading * first
    state.yaw -= heading * first
    state.yaw_rate -= first
    if n == 5:
        state.wheel_angle -= steering * first
    for j in range(whole(p.previewed)):
        distance += planned * p.period
        time += p.period
        planned = contract.planned_speed(road, time, s.speed, p.period)
        later = v * predicted_path.curvature_at(distance + 0.5 * planned * p.period, reference, road, s, p)
        z[n + j], first_deviation = later - first_deviation, later
    return first, steering


@inlined
def apply_gains(v, t, p, z, grid):
    """The product of gains and z at a speed v (m/s) and the present weights, interpolated in the grid."""
    cell, angle = cell_of(v, t, p), 0.0
    for corner in range(8):
        node, share = corner_of(corner, cell, p)
        product = 0.0
        for g in range(z.size):
            product += grid[node * z.size + g] * z[g]
        angle += share * product
    return angle


@exported(contract.LAW_SIGNATURE)
def preview_lqr(situation, reference, road, tuning, parameters, memory, answer):
    """u = U w_0 - K x~ + sum_j g_j (w_j+1 - w_j); see the head of this file."""
    s, t, p = contract.read_situation(situation), read_tuning(tuning), read_parameters(parameters)
    angle = offset = heading_error = curvature = feed_forward = math.nan
    sent = _sent(p, memory)
    if math.isfinite(s.command):
        predicted_path.take_command(s.command, p.dead_time / p.period, p.period, p.lag, sent)
    if contract.all_finite(situation) and contract.all_finite(tuning):
        n, v = states_of(p), max(s.speed, contract.MIN_LAW_SPEED)
        last = memory.size - n * (n + 3)
        z = memory[last - n - whole(p.previewed) : last]
        path = contract.path_ahead(reference, road, 0.0, s.speed, p.period, memory)
        offset, heading_error = (s.y - path.y) * cos(path.heading), contract.wrapped(s.yaw - path.heading)
        x = z[:n]
        _begin(offset, heading_error, reference, road, s, p, x)
        if n == 5:
            state_of(x, 0).wheel_angle = predicted_path.wheels_of(sent, 0).angle
        distance = _roll(reference, road, s, parameters, memory, x)
        w, steering = _write_deviations(distance, reference, road, s, p, z)
        curvature, feed_forward = w / v, steering * w
        grid = parameters[len(PARAMETERS) + OF_THE_MODEL :]
        angle = feed_forward + apply_gains(v, t, p, z, grid)
    out = answer_of(answer, 0)
    out.command, out.held = contract.limited(angle, s, p)
    out.offset, out.heading_error, out.curvature = offset, heading_error, curvature
    out.feed_forward = feed_forward
