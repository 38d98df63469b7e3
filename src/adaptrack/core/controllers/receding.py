"""The receding horizon: solve the QP, take the first move of its plan, or what stands in for it, and answer."""

from __future__ import annotations

import math

from ..kernel import Place, exported, float64, inlined, int64, several, vector, void
from ..maths import vectors
from ..maths.bits import whole
from ..maths.exact import clip
from ..qp import problem as qp
from ..qp.active_set import active_set
from ..qp.hildreth import hildreth
from ..qp.residual import kkt_residual
from ..roads.road import Roads, line_of, points_ahead
from . import mpc as batch
from .constraints import SAMPLE_ROWS, sample_at
from .feed_forward import expect_move
from .mpc import MPC_ANSWER, MPC_PLACE

LIMIT_TOLERANCE = 1e-9
"""rad, how near to a limit counts as at it."""


@inlined
def _qp_in(slot, n, m, mpc):
    """The problem, the solution and the scratch of a slot in the workspace."""
    ws = mpc.ws
    rows = ws.rows[slot if batch.has_output_limits(mpc.settings) else 0]
    problem = qp.Problem(n, m, ws.hessian[slot], ws.gradient, rows, ws.bounds)
    return (
        problem,
        qp.SolutionRecord(ws.solution, ws.multipliers),
        qp.Scratch(ws.qp_work[slot], ws.qp_rows, ws.qp_index[slot]),
    )


@exported(several(int64, int64)(int64, int64, int64, MPC_PLACE))
def _solve_qp(slot, n, m, mpc):
    """Solve the QP in the workspace with the solver of the settings: (status, iterations)."""
    settings, memory = mpc.settings, mpc.memory[slot]
    problem, solution, scratch = _qp_in(slot, n, m, mpc)
    factor = qp.factor_of(mpc.ws.factor[slot], memory.condition)
    status, iterations = qp.CAPPED, 0
    if settings.solver != batch.EXACT_ONLY:
        memory.active = 0
        status, iterations = hildreth(
            problem, factor, solution, scratch, settings.max_sweeps, settings.tolerance, False
        )
    if settings.solver == batch.EXACT_ONLY or (settings.solver == batch.HILDRETH_THEN_EXACT and status == qp.CAPPED):
        # The rows that were active a period ago are a good guess, and while E stays so does their factor.
        most = settings.max_changes if settings.max_changes > 0 else qp.CHANGES * (n + m)
        status, further, active = active_set(
            problem, factor, solution, scratch, memory.active, memory.has_factor > 0, most
        )
        memory.active, memory.has_factor = active, 1
        iterations += further
    return status, iterations


@inlined
def _move_of(settings, sample, solution, moves):
    """The move at a sample of a plan: its pulse, or the sum of the Laguerre functions there."""
    if settings.laguerre == 0:
        return solution[sample]
    move = 0.0
    for i in range(settings.terms):
        move += moves[i, sample] * solution[i]
    return move


@inlined
def _planned_move(slot, mpc):
    """The move that the last plan has for this period, zero behind its end."""
    memory = mpc.memory[slot]
    memory.age += 1
    if memory.age >= _planned(slot, mpc):
        return 0.0
    return _move_of(mpc.settings, memory.age, mpc.plan[slot], mpc.ws.moves)


@inlined
def _planned(slot, mpc):
    """How many moves the last plan has."""
    memory = mpc.memory[slot]
    return whole(memory.Np) if mpc.settings.laguerre > 0 and memory.planned > 0 else memory.planned


@exported(void(int64, MPC_PLACE, vector))
def predict_outputs(slot, mpc, y):
    """Write the outputs (Np,) m that the last step has predicted with its plan: 1, 2, ... periods after the dead time.

    To be called before another slot makes a step.
    """
    horizon, ws = y.size, mpc.ws
    for j in range(horizon):
        y[j] = ws.reference[j] - ws.error[j]
    for i in range(min(_planned(slot, mpc), horizon)):
        expect_move(i, -_move_of(mpc.settings, i, mpc.plan[slot], ws.moves), horizon, ws.step[slot], y)


@exported(several(int64, float64)(int64, float64, vector, int64, Place(Roads), MPC_PLACE, vector))
def predict_path(slot, station, speeds, road, roads, mpc, points):
    """Write x and y (m), in turn, of where the last step predicts the car: 1, 2, ..., Np periods after the dead time.

    It returns the number of points, and the time (s) from the step to the first one. The number is 0 before the first
    step, and if the last step found no solution. Nothing is written if the points do not fit. station: m, of the car's
    foot at the step; speeds: m/s, expected at the instants from then on; road: which of `roads`, -1: the x axis. To be
    called before another slot makes a step.
    """
    settings, memory, delay = mpc.settings, mpc.memory[slot], batch.delay_of(slot, mpc)
    first = settings.period + delay * settings.period
    if memory.started == 0 or mpc.answer[slot, MPC_ANSWER.held] > 0.5 or not memory.speed > 0.0:
        return 0, first
    count = whole(memory.Np)
    if 2 * count <= points.size:
        offsets = points[count : 2 * count]
        predict_outputs(slot, mpc, offsets)
        if settings.curved > 0:  # they count from the tangent at the foot
            for j in range(count):
                offsets[j] -= mpc.bend[j + 1]
        points_ahead(station, speeds, memory.speed, delay, settings.period, line_of(road, roads), offsets, points)
    return count, first


@inlined
def plan_moves(slot, mpc, moves):
    """Write the moves (rad) of the last plan with those that the road asks for, see `predict_outputs`."""
    for i in range(moves.size):
        of_road = mpc.feed.moves[i] if mpc.settings.feeds_forward > 0 else 0.0
        moves[i] = _move_of(mpc.settings, i, mpc.plan[slot], mpc.ws.moves) + of_road


@inlined
def _residual(slot, n, m, mpc):
    """Largest KKT residual of the solution in the workspace."""
    problem, solution, scratch = _qp_in(slot, n, m, mpc)
    stationarity, primal, dual, complementarity = kkt_residual(problem, solution, scratch)
    return max(max(stationarity, primal), max(dual, complementarity))


@inlined
def _limits_reached(slot, move, angle, m, mpc):
    """Sum of AT_MOVE, AT_ANGLE, AT_OUTPUT for the limits at which a solved step is; move: beyond that of the road."""
    settings, first = mpc.settings, sample_at(mpc.ws.bounds, 0)
    at_limit = 0
    if move <= -first.move_back + LIMIT_TOLERANCE or move >= first.move - LIMIT_TOLERANCE:
        at_limit |= batch.AT_MOVE
    if angle <= settings.angle_min + LIMIT_TOLERANCE or angle >= settings.angle_max - LIMIT_TOLERANCE:
        at_limit |= batch.AT_ANGLE
    if batch.has_output_limits(settings):
        for j in range(SAMPLE_ROWS * whole(mpc.answer[slot, MPC_ANSWER.Nc]), m):
            if mpc.ws.multipliers[j] > 0.0:
                return at_limit | batch.AT_OUTPUT
    return at_limit


@inlined
def _remember(slot, angle, mpc):
    """Store the signals that the next step needs."""
    memory = mpc.memory[slot]
    memory.command = angle
    for i in range(mpc.states.size):
        value = mpc.measured[mpc.states[i]]
        if math.isfinite(value):
            mpc.previous[slot, i] = value
    memory.started = 1


@exported(void(int64, int64, int64, int64, int64, MPC_PLACE))
def apply_move(slot, status, iterations, n, m, mpc):
    """Take the first move of the solution in the workspace, or what stands in for it; write the answer of the step.

    n, m: sizes of the QP. A move is taken when its QP is solved, or capped under HILDRETH_APPLIED; a capped one is
    clipped to its limits. Where nothing solves, the next move of the last plan is taken, none when the data are not
    finite, and the answer says `held`.
    """
    settings, memory, out, ws = mpc.settings, mpc.memory[slot], mpc.answer[slot], mpc.ws
    usable = status == qp.SOLVED or (status == qp.CAPPED and settings.solver == batch.HILDRETH_APPLIED)
    move = _move_of(settings, 0, ws.solution, ws.moves) if usable else 0.0
    usable = usable and math.isfinite(move)
    if usable:
        for b in range(0, vectors.padded(n), vectors.VECTOR_WIDTH):
            vectors.store(mpc.plan, slot, b, vectors.load(ws.solution, b))
        memory.planned, memory.age = n - (1 if batch.has_output_limits(settings) else 0), 0  # the slack is no move
    else:
        planned = _planned_move(slot, mpc)
        move = 0.0 if status == qp.NON_FINITE else planned
    out[MPC_ANSWER.qp_residual] = _residual(slot, n, m, mpc) if usable and settings.residuals > 0 else math.nan
    of_road = mpc.feed.moves[0] if settings.feeds_forward > 0 and status != qp.NON_FINITE else 0.0
    if usable:
        first = sample_at(ws.bounds, 0)
        move = clip(move, -first.move_back, first.move)
        total = move + of_road
    else:
        total = clip(move + of_road, settings.move_min, settings.move_max)
    angle = clip(memory.command + total, settings.angle_min, settings.angle_max)
    out[MPC_ANSWER.command], out[MPC_ANSWER.command_change] = angle, angle - memory.command
    out[MPC_ANSWER.qp_status], out[MPC_ANSWER.qp_iterations] = status, iterations
    out[MPC_ANSWER.held] = 0.0 if usable else 1.0
    out[MPC_ANSWER.at_limit] = _limits_reached(slot, move, angle, m, mpc) if usable else 0.0
    _remember(slot, angle, mpc)


@inlined
def move_on(slot, status, n, m, mpc):
    """Solve the QP in the workspace, if it is one, and take its first move."""
    iterations = 0
    if status == qp.SOLVED:
        status, iterations = _solve_qp(slot, n, m, mpc)
    apply_move(slot, status, iterations, n, m, mpc)


@inlined
def stand(slot, mpc):
    """Leave the wheels of a standing car at rest."""
    memory, out = mpc.memory[slot], mpc.answer[slot]
    angle = clip(memory.command, mpc.settings.angle_min, mpc.settings.angle_max)
    out[MPC_ANSWER.command], out[MPC_ANSWER.command_change], out[MPC_ANSWER.held] = angle, angle - memory.command, 0.0
    out[MPC_ANSWER.qp_status], out[MPC_ANSWER.qp_iterations], out[MPC_ANSWER.qp_residual] = qp.SOLVED, 0, 0.0
    out[MPC_ANSWER.at_limit] = 0.0
    _remember(slot, angle, mpc)
