"""What both MPCs predict and weigh alike: the tuning as used, the model at a speed, E and its factor, R_s, K and gamma.

An MPC writes `ws.change`, x(k) - x(k-1) or x(k+1) - x(k), and with it R_s - F x~; the rest of the QP is made here.
"""

from __future__ import annotations

import math

from ..kernel import boolean, exported, float64, inlined, int64, void
from ..maths import vectors
from ..maths.bits import whole
from ..maths.exact import clip, floor
from ..models.contract import call_discretise
from ..qp import problem as qp
from ..qp.factor import factorise
from . import condensing, constraints
from .feed_forward import expect_moves, road_moves
from .mpc import MPC_ANSWER, MPC_PLACE, MPC_TUNING, Functions, delay_of, has_output_limits

RESPONSE, MAX_REFERENCE_HEADING = 1.0, 0.5
"""s, by which a car without preview follows a moving reference late; rad, a steeper reference has jumped."""


# -- the tuning, the model and E --------------------------------------------------------------------------------------
@inlined
def _horizon(value, most):
    """A horizon: the nearest integer, between 1 and `most`; 1 when it is not a number."""
    return whole(clip(floor(value + 0.5), 1.0, most)) if math.isfinite(value) else 1


@inlined
def take_tuning(slot, tuning, caution, mpc):
    """Write the tuning as used to the answer, its horizons rounded and clamped, R times so much.

    Returns whether it makes a QP, its variables and its rows.
    """
    settings, out = mpc.settings, mpc.answer[slot]
    horizon = _horizon(tuning[MPC_TUNING.Np], float(settings.longest_horizon))
    moves = _horizon(tuning[MPC_TUNING.Nc], min(float(horizon), float(settings.most_moves)))
    q, r = tuning[MPC_TUNING.Q], tuning[MPC_TUNING.R] * caution
    out[MPC_ANSWER.Np], out[MPC_ANSWER.Nc], out[MPC_ANSWER.Q], out[MPC_ANSWER.R] = horizon, moves, q, r
    n, m = settings.terms if settings.laguerre > 0 else moves, constraints.SAMPLE_ROWS * moves
    if has_output_limits(settings):
        n, m = n + 1, m + constraints.OUTPUT_ROWS * horizon
    is_finite = math.isfinite(tuning[MPC_TUNING.Np]) and math.isfinite(tuning[MPC_TUNING.Nc])
    if not (is_finite and math.isfinite(q) and math.isfinite(r)):
        return qp.NON_FINITE, n, m
    return qp.SOLVED if q >= 0.0 and r > 0.0 else qp.NOT_CONVEX, n, m


@inlined
def discretise(speed, mpc, functions):
    """Write the model at a speed to the workspace."""
    model = mpc.model
    call_discretise(functions.discretise, speed, mpc.settings.period, mpc.parameters, model.a, model.b, model.e)


@inlined
def is_formed(slot, speed, mpc):
    """Whether the workspace holds this very speed and tuning, to the last bit."""
    memory, out = mpc.memory[slot], mpc.answer[slot]
    same_horizons = out[MPC_ANSWER.Np] == memory.Np and out[MPC_ANSWER.Nc] == memory.Nc
    return memory.speed == speed and same_horizons and out[MPC_ANSWER.Q] == memory.Q and out[MPC_ANSWER.R] == memory.R


@exported(void(int64, float64, boolean, MPC_PLACE, Functions))
def form_model(slot, speed, of_next, mpc, functions):
    """Form the matrices that depend on speed and tuning alone: F, Phi, E and its factor, and the rows of eq. (15) in M.

    of_next: F is that of the next increment, see `condensing.responses`.
    """
    settings, memory, out, ws = mpc.settings, mpc.memory[slot], mpc.answer[slot], mpc.ws
    np_, nc, q, r = whole(out[MPC_ANSWER.Np]), whole(out[MPC_ANSWER.Nc]), out[MPC_ANSWER.Q], out[MPC_ANSWER.R]
    laguerre, limited = settings.laguerre > 0, has_output_limits(settings)
    moves = settings.terms if laguerre else nc
    step, phi = ws.step[slot], ws.phi[slot if laguerre else 0]
    hessian, rows = ws.hessian[slot], ws.rows[slot if limited else 0]
    discretise(speed, mpc, functions)
    condensing.responses(np_, of_next, mpc.model, ws.free[slot], step)
    if laguerre:
        condensing.laguerre_response(np_, moves, step, ws.moves, phi)
        condensing.condensed_hessian(np_, moves, phi, q, r, hessian)
    else:
        condensing.pulse_hessian(np_, moves, step, q, r, hessian)
    if limited:
        for i in range(moves):
            hessian[i, moves] = 0.0
            hessian[moves, i] = 0.0
        hessian[moves, moves] = 2.0 * settings.output_weight
        constraints.limit_rows(nc, moves, laguerre, ws.moves, rows)
        for i in range(constraints.SAMPLE_ROWS * nc):
            rows[moves, i] = 0.0
        constraints.output_rows(constraints.SAMPLE_ROWS * nc, np_, moves, laguerre, step, phi, rows)
        constraints.clear_ends(moves + 1, constraints.SAMPLE_ROWS * nc + constraints.OUTPUT_ROWS * np_, rows)
    n = moves + (1 if limited else 0)
    constraints.clear_ends(n, n, hessian)
    memory.factor_status, memory.condition = factorise(n, hessian, ws.factor[slot])
    memory.has_factor = 0
    memory.speed, memory.Np, memory.Nc, memory.Q, memory.R = speed, np_, nc, q, r


# -- R_s - F x~ -------------------------------------------------------------------------------------------------------
@inlined
def _look_ahead(slot, horizon, reference, mpc):
    """R_s: the reference from the next instant on with preview (its last value repeated), else its present value;
    on a curved road with the offset of the road from its tangent.

    With a dead time the first output is that of a period after it; between instants the reference is interpolated.
    """
    ws, last, delay = mpc.ws, reference.size - 1, delay_of(slot, mpc)
    if mpc.settings.preview > 0 and delay > 0.0:
        first = whole(delay)
        share = delay - first
        for j in range(horizon):
            current, following = reference[min(first + j + 1, last)], reference[min(first + j + 2, last)]
            ws.reference[j] = current + share * (following - current)
    elif mpc.settings.preview > 0:
        for j in range(horizon):
            ws.reference[j] = reference[min(j + 1, last)]
    else:
        for b in range(0, horizon, vectors.VECTOR_WIDTH):
            vectors.store(ws.reference, b, vectors.spread(reference, 0))
    if mpc.settings.curved > 0:
        for j in range(horizon):
            ws.reference[j] += mpc.bend[j + 1]


@inlined
def _limit_error(slot, horizon, output, reference, mpc):
    """Shift R_s towards the car, so that the error that it is to correct is no larger than the limit.

    output: predicted or measured y (m) at the end of the dead time. A car that does not know the reference ahead
    follows it `RESPONSE` late, and the limit is larger by that; a jump is no motion of the reference.
    """
    settings, memory, ws = mpc.settings, mpc.memory[slot], mpc.ws
    limit, target = settings.error_max, reference[0]
    if not limit < math.inf:
        return
    if settings.preview > 0:
        delay = delay_of(slot, mpc)
        last, first = reference.size - 1, whole(delay)
        current, following = reference[min(first, last)], reference[min(first + 1, last)]
        target = current + (delay - first) * (following - current)
    elif memory.started > 0:
        speed = abs(target - memory.reference) / settings.period
        limit += RESPONSE * speed if speed <= MAX_REFERENCE_HEADING * memory.speed else 0.0
    memory.reference = reference[0]
    if settings.curved > 0:
        target += mpc.bend[0]
    gap = target - output
    beyond = gap - clip(gap, -limit, limit)
    if beyond != 0.0:
        for j in range(horizon):
            ws.reference[j] -= beyond


@inlined
def compare(slot, output, reference, mpc):
    """Write R_s - F x~, what the reference asks beyond the free response, from `ws.change` and an output (m)."""
    ws, np_ = mpc.ws, whole(mpc.answer[slot, MPC_ANSWER.Np])
    _look_ahead(slot, np_, reference, mpc)
    _limit_error(slot, np_, output, reference, mpc)
    condensing.tracking_error(np_, ws.free[slot], ws.change, output, ws.reference, ws.error)


# -- K and gamma ------------------------------------------------------------------------------------------------------
@inlined
def limit_moves(slot, mpc):
    """Write the limits on the moves to gamma."""
    samples = whole(mpc.answer[slot, MPC_ANSWER.Nc])
    constraints.bound_moves(samples, mpc.memory[slot].command, mpc.settings, mpc.ws.bounds)


@inlined
def complete(slot, speed, n, mpc):
    """Write K, and to gamma, which holds the limits on moves, what road and outputs leave of them; n: variables."""
    settings, out, ws, feed = mpc.settings, mpc.answer[slot], mpc.ws, mpc.feed
    np_, nc, q = whole(out[MPC_ANSWER.Np]), whole(out[MPC_ANSWER.Nc]), out[MPC_ANSWER.Q]
    if settings.feeds_forward > 0:
        road_moves(np_, speed, settings, mpc.bend, feed)
        expect_moves(np_, ws.step[slot], feed.expected, ws.error)
        constraints.leave_to_free_moves(nc, feed.moves, ws.bounds)
    limited = has_output_limits(settings)
    moves = n - (1 if limited else 0)
    if settings.laguerre > 0:
        condensing.condensed_gradient(np_, moves, ws.phi[slot], q, ws.error, ws.gradient)
    else:
        condensing.pulse_gradient(np_, moves, ws.step[slot], q, ws.error, ws.gradient)
    if limited:
        ws.gradient[moves] = 0.0
        constraints.clear_end(n, ws.gradient)
        constraints.bound_outputs(constraints.SAMPLE_ROWS * nc, np_, settings, ws.reference, ws.error, ws.bounds)
