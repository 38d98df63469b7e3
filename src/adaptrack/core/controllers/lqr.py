"""LQR about the steady turn of the path: state feedback on the lateral errors, curvature feed-forward."""

from __future__ import annotations

import math

from ..kernel import Field, exported, inlined, record, unpacker, viewer
from ..maths.bits import whole
from ..maths.exact import clip
from ..maths.exponential import log
from ..maths.trigonometric import cos
from . import contract

LQR_TUNING = ("q_e", "q_heading", "r", "preview_time")
PARAMETERS = (
    *contract.COMMON_PARAMETERS,
    "wheelbase",  # m
    "lr",  # m, centre of gravity to rear axle
    "understeer",  # rad s^2/m, understeer gradient K: delta = L kappa + K a_y in a steady turn
    "rear_slip",  # rad s^2/m, slip angle of the rear tyres per lateral acceleration: m lf/(2 C_r L)
    # the grid of gains behind these: over log v, log q_e/r and log q_heading/r, the state last
    "log_speed",  # first node
    "log_speed_step",
    Field("speeds", "", 0, "number of nodes"),
    "log_e",  # of log(q_e/r), m^-2 rad^2
    "log_heading",  # of log(q_heading/r)
    "log_weight_step",  # of both
    Field("weights", "", 0, "number of nodes of each"),
)
LQR_STATES = 4
"""Lateral error (m) and its rate, heading error (rad) and its rate."""
LQR_DIAGNOSTICS = (
    "held",  # 1: the last command is held
    "offset",  # m, from the path to the car, positive when the car is on the left
    "heading_error",  # rad, the car's heading less the path's
    "curvature",  # 1/m, of the path that the feed-forward sees
    "feed_forward",  # rad, steering of the steady turn with this curvature
)
answer_of = viewer(record("Answer", ("command", *LQR_DIAGNOSTICS)))
MEMORY = 1
"""The heading of the path, for when the car stands."""

Tuning = record("Tuning", LQR_TUNING)
Parameters = record("Parameters", PARAMETERS)
read_tuning, read_parameters = unpacker(Tuning), unpacker(Parameters)


@inlined
def node_below(value, first, step, nodes):
    """The node of an even grid below a value, and the value's share of the way to the next; within the grid."""
    place = clip((value - first) / step, 0.0, nodes - 1.0)
    i = min(whole(place), whole(nodes) - 2)
    return i, place - i


@inlined
def cell_of(v, t, p):
    """The cell of the grid at a speed v (m/s) and the present weights: along each axis its node and the share."""
    tiny = 1e-300
    r = max(t.r, tiny)
    i, a = node_below(log(v), p.log_speed, p.log_speed_step, p.speeds)
    j, b = node_below(log(max(t.q_e / r, tiny)), p.log_e, p.log_weight_step, p.weights)
    k, c = node_below(log(max(t.q_heading / r, tiny)), p.log_heading, p.log_weight_step, p.weights)
    return i, a, j, b, k, c


@inlined
def corner_of(corner, cell, p):
    """Node of the grid at one of the eight corners of a cell, and its share in the interpolation."""
    i, a, j, b, k, c = cell
    di, dj, dk = corner // 4, corner // 2 % 2, corner % 2
    share = (a if di > 0 else 1.0 - a) * (b if dj > 0 else 1.0 - b) * (c if dk > 0 else 1.0 - c)
    return ((i + di) * whole(p.weights) + j + dj) * whole(p.weights) + k + dk, share


@inlined
def gain_of(state, cell, p, grid):
    """The feedback gain on one state, interpolated in a cell of the grid."""
    gain = 0.0
    for corner in range(8):
        node, share = corner_of(corner, cell, p)
        gain += share * grid[node * LQR_STATES + state]
    return gain


@exported(contract.LAW_SIGNATURE)
def lqr(situation, reference, road, tuning, parameters, memory, answer):
    """delta = delta_ss - K (x - x_ss): feedback about the steady turn with the curvature of the path.

    x = [e, v_y + v psi_e, psi_e, r - v kappa]; x_ss = [0, 0, (rear_slip v^2 - lr) kappa, 0];
    delta_ss = (L + understeer v^2) kappa, with the curvature that the path has `preview_time` ahead.
    """
    s, t, p = contract.read_situation(situation), read_tuning(tuning), read_parameters(parameters)
    angle = offset = heading_error = curvature = feed_forward = math.nan
    if contract.all_finite(situation) and contract.all_finite(tuning):
        v = max(s.speed, contract.MIN_LAW_SPEED)
        path = contract.path_ahead(reference, road, 0.0, s.speed, p.period, memory)
        ahead = contract.path_at(reference, road, t.preview_time, v, p.period)
        curvature = ahead.curvature if s.speed >= contract.MIN_LAW_SPEED else 0.0
        feed_forward = (p.wheelbase + p.understeer * v * v) * curvature
        offset = (s.y - path.y) * cos(path.heading)
        heading_error = contract.wrapped(s.yaw - path.heading)
        steady = (p.rear_slip * v * v - p.lr) * path.curvature
        cell, grid = cell_of(v, t, p), parameters[len(PARAMETERS) :]
        angle = (
            feed_forward
            - gain_of(0, cell, p, grid) * offset
            - gain_of(1, cell, p, grid) * (s.vy + v * heading_error)
            - gain_of(2, cell, p, grid) * (heading_error - steady)
            - gain_of(3, cell, p, grid) * (s.yaw_rate - v * path.curvature)
        )
    out = answer_of(answer, 0)
    out.command, out.held = contract.limited(angle, s, p)
    out.offset, out.heading_error, out.curvature = offset, heading_error, curvature
    out.feed_forward = feed_forward
