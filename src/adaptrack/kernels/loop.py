"""One control period of the closed loop, and whole runs of it.

`control_period` is what both drivers share: `simulate` calls it once per period from Python, `rollout` in a
compiled loop over many lanes. Each lane is one vehicle with its own controller, tuning and scenario.

    measure -> (noise) -> MPC step -> (computation delay) -> speed control -> integrate over one period
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import types

from . import estimation, inference
from .abi import (
    INLINE,
    INLINED_ROUTINE,
    PLANT_PARAMETERS,
    ROUTINE,
    cube,
    float64,
    int64,
    int_matrix,
    int_vector,
    matrix,
    njit,
    record,
    vector,
)
from .dynamics import CUSTOM, INPUTS, PLANT_FUNCTION, STATES
from .dynamics import derivative as vehicle_derivative
from .integrate import LANE_STEP, LANES, integrate, integrate_custom
from .maths import vectors
from .maths.elementary import clip
from .maths.random import counted_normal
from .prediction import (
    condensed_gradient,
    condensed_hessian,
    discretise,
    laguerre_moves,
    laguerre_response,
    pulse_gradient,
    pulse_hessian,
    responses,
    tracking_error,
)
from .qp import problem as qp
from .qp.active_set import active_set
from .qp.factor import factorise
from .qp.hildreth import hildreth
from .qp.residual import kkt_residual

WALKING = 1.0
"""m/s, sideways below this a vehicle is not said to spin."""
STEERING_LAG, STEERING_LIMIT = PLANT_PARAMETERS.index("steering_lag"), PLANT_PARAMETERS.index("steering_limit")

# -- the MPC's settings, fixed over a run -----------------------------------------------------------------------------
MPC_SETTINGS = (
    "period",  # s
    "move_min",  # rad per period, eq. (13)
    "move_max",
    "angle_min",  # rad, eq. (14)
    "angle_max",
    "output_min",  # m, eq. (15), soft; -inf and inf: none
    "output_max",
    "output_price",  # 1/m^2, price of the squared violation of eq. (15)
    "laguerre",  # 1: moves by Laguerre functions, 0: by pulses
    "pole",  # of the Laguerre functions
    "terms",  # number of Laguerre functions
    "preview",  # 1: the reference ahead is known, 0: held at its present value
    "speed_floor",  # m/s, the prediction model is never formed below this speed
    "solver",  # ACTIVE_SET, ...
    "max_sweeps",  # of Hildreth's procedure
    "tolerance",  # of Hildreth's procedure, on the squared change of the multipliers in a sweep
    "residuals",  # 1: compute the KKT residual of every solution
    "longest_horizon",  # Np and Nc are clamped to what the workspace was made for
    "most_moves",
)
(
    PERIOD, MOVE_MIN, MOVE_MAX, ANGLE_MIN, ANGLE_MAX, OUTPUT_MIN, OUTPUT_MAX, OUTPUT_PRICE, LAGUERRE, POLE, TERMS,
    PREVIEW, SPEED_FLOOR, SOLVER, MAX_SWEEPS, TOLERANCE, RESIDUALS, LONGEST_HORIZON, MOST_MOVES,
) = range(len(MPC_SETTINGS))  # fmt: skip

ACTIVE_SET, HILDRETH_THEN_EXACT, HILDRETH_APPLIED, HILDRETH_OR_HOLD = 0, 1, 2, 3
"""Solvers: the exact one; Hildreth finished by the exact one when not converged; Hildreth's last iterate whatever it
is, as the authors released it; Hildreth, the angle held when not converged."""

# -- the loop's settings, fixed over a run ----------------------------------------------------------------------------
LOOP_SETTINGS = (
    "plant",  # SINGLE_TRACK, DUAL_TRACK or CUSTOM
    "substeps",  # Runge-Kutta steps per period
    "prescribed_speed",  # 1: v_x follows the profile exactly, 0: the driver and the powertrain move the vehicle
    "delay",  # 1: a command takes effect one period after its measurement, 0: at once
    "noise_vy",  # m/s, standard deviation of the measured lateral velocity
    "noise_yaw",  # rad
    "noise_yaw_rate",  # rad/s
    "noise_y",  # m
    "driver_preview",  # s, how far ahead the driver looks at the speed profile
    "driver_integral",  # 1/s^2, gain on the integral of the speed error
    "mass",  # kg, with which the driver turns acceleration into force
    "engine_power",  # W
    "traction_limit",  # N
    "brake_limit",  # N
    "lost_beyond",  # m, a run is lost when |Y - y_ref| exceeds this
    "spin_beyond",  # or |v_y/v_x| this, above walking speed
)
(
    PLANT, SUBSTEPS, PRESCRIBED_SPEED, DELAY, NOISE_VY, NOISE_YAW, NOISE_YAW_RATE, NOISE_Y, DRIVER_PREVIEW,
    DRIVER_INTEGRAL, MASS, ENGINE_POWER, TRACTION_LIMIT, BRAKE_LIMIT, LOST_BEYOND, SPIN_BEYOND,
) = range(len(LOOP_SETTINGS))  # fmt: skip

# -- what a controller remembers, a row per lane ----------------------------------------------------------------------
STARTED, PREVIOUS, ANGLE, INTEGRAL = 0, 1, 5, 6
KEY = 8  # speed, Np, Nc, Q, R of what the workspace holds for this lane; NaN: nothing
FACTOR_STATUS, CONDITION, LOST = 13, 14, 15
ACTIVE, KEPT = 16, 17  # active rows of the last solution, and whether their factor still belongs to E
MEMORY = 18

# -- what a step reports, a row per lane ------------------------------------------------------------------------------
RECORD = (
    "command",  # rad, what the controller computed
    "command_change",  # rad
    "qp_status",
    "qp_iterations",
    "qp_residual",  # largest KKT residual, NaN unless asked for
    "at_limit",  # sum of AT_MOVE, AT_ANGLE, AT_OUTPUT
    "held",  # 1: no certified solution, the previous angle is held
    "Np",
    "Nc",
    "Q",
    "R",
)
COMMAND, CHANGE, STATUS, ITERATIONS, RESIDUAL, AT_LIMIT, HELD, R_NP, R_NC, R_Q, R_R = range(len(RECORD))
AT_MOVE, AT_ANGLE, AT_OUTPUT = 1, 2, 4

# -- a scenario's samples, a row per signal ---------------------------------------------------------------------------
SIGNALS = (
    "y_ref", "speed", "mu_fl", "mu_fr", "mu_rl", "mu_rr", "wind_x", "wind_y",
    "told_friction", "told_wind", "change", "acceleration",
)  # fmt: skip
Y_REF, SPEED, FRICTION, WIND, TOLD = 0, 1, 2, 6, 8
"""From TOLD on: what a scheduler is told of friction, wind and the demand ahead, see `mpc.Condition`."""

FOUR_DIMENSIONS = types.Array(types.float64, 4, "C")
_FIELDS = (
    ("a", matrix),  # (4, 4) A_k
    ("b", vector),  # (4,) B
    ("free", cube),  # (lanes, 4, Np) F
    ("step", matrix),  # (lanes, Np) response to a unit move
    ("moves", matrix),  # (terms, Np) Laguerre functions, shared by all lanes
    ("phi", cube),  # (lanes, terms, Np) Phi L, transposed
    ("hessian", cube),  # (lanes, n, n) E
    ("factor", FOUR_DIMENSIONS),  # (lanes, 2, n, n) of E
    ("rows", cube),  # (lanes or 1, n, m) M, transposed
    ("bounds", vector),  # (m,) gamma
    ("reference", vector),  # (Np,) R_s
    ("error", vector),  # (Np,) R_s - F x~
    ("measured", vector),  # (4,) x_c as measured
    ("condition", vector),  # what a scheduler looks at
    ("change", vector),  # (4,) x_c(k) - x_c(k-1)
    ("gradient", vector),  # (n,) K
    ("solution", vector),  # (n,)
    ("multipliers", vector),  # (m,)
    ("qp_work", FOUR_DIMENSIONS),  # (lanes, ...) kept from one step to the next
    ("qp_rows", matrix),
    ("qp_index", int_matrix),  # (lanes, ...) likewise
)
"""The workspace: every array that a step needs, made once for the longest horizons. Row lengths are padded to
multiples of 8, as the QP routines ask."""
Workspace = record("Workspace", (name for name, _ in _FIELDS))
WORKSPACE = types.NamedTuple([kind for _, kind in _FIELDS], Workspace)


def workspace(lanes: int, settings: Any) -> Any:
    """A workspace for up to `lanes` lanes under MPC_SETTINGS."""
    horizon = int(settings[LONGEST_HORIZON])
    moves = min(int(settings[MOST_MOVES]), horizon)
    laguerre = settings[LAGUERRE] > 0.5
    limited = settings[OUTPUT_MIN] > -math.inf or settings[OUTPUT_MAX] < math.inf
    columns = (int(settings[TERMS]) if laguerre else moves) + (1 if limited else 0)
    count = 4 * moves + (2 * horizon if limited else 0)
    np_, n, m = vectors.padded(horizon), vectors.padded(columns), vectors.padded(count)
    sizes = qp.workspace_sizes(columns, count, hildreth=settings[SOLVER] != ACTIVE_SET)
    ws = Workspace(
        a=np.zeros((4, 4)),
        b=np.zeros(4),
        free=np.zeros((lanes, 4, np_)),
        step=np.zeros((lanes, np_)),
        moves=np.zeros((columns, np_)),
        phi=np.zeros((lanes if laguerre else 1, columns, np_)),
        hessian=qp.aligned((lanes, columns, n)),
        factor=qp.aligned((lanes, *sizes["factor"])),
        rows=qp.aligned((lanes if limited else 1, columns, m)),
        bounds=qp.aligned((m,)),
        reference=np.zeros(np_),
        error=np.zeros(np_ + n + 8),
        measured=np.zeros(4),
        condition=np.zeros(len(inference.CONDITION)),
        change=np.zeros(4),
        gradient=qp.aligned((n,)),
        solution=qp.aligned((n,)),
        multipliers=qp.aligned((m,)),
        qp_work=qp.aligned((lanes, *sizes["work"])),
        qp_rows=qp.aligned(sizes["rows"]),
        qp_index=np.zeros((lanes, *sizes["index"]), dtype=np.int64),
    )
    if laguerre:
        laguerre_moves(horizon, int(settings[TERMS]), settings[POLE], ws.moves)
    for rows in ws.rows:
        limit_rows(moves, columns - (1 if limited else 0), laguerre, ws.moves, rows)
    return ws


def memory(lanes: int) -> Any:
    """What `lanes` controllers remember before their first step: (lanes, MEMORY)."""
    fresh = np.zeros((lanes, MEMORY))
    fresh[:, KEY] = np.nan
    return fresh


@njit(**INLINE)
def _has_output_limits(settings):
    return settings[OUTPUT_MIN] > -math.inf or settings[OUTPUT_MAX] < math.inf


@njit(types.void(int64, int64, types.boolean, matrix, matrix), **ROUTINE)
def limit_rows(samples, columns, laguerre, moves, rows):
    """Write M of eq. (16) for eqs. (13), (14), transposed: rows (columns, >= 4 samples).

    Four rows a sample: the move, its negative, the angle (the sum of moves), its negative. In this order the rows
    of a shorter control horizon are the leading block of a longer one's, so they are written once.
    """
    for c in range(columns):
        angle = 0.0
        for i in range(samples):
            move = moves[c, i] if laguerre else (1.0 if c == i else 0.0)
            angle += move
            rows[c, 4 * i] = move
            rows[c, 4 * i + 1] = -move
            rows[c, 4 * i + 2] = angle
            rows[c, 4 * i + 3] = -angle


@njit(types.void(int64, int64, int64, types.boolean, vector, matrix, matrix), **ROUTINE)
def output_rows(first, horizon, columns, laguerre, step, phi, rows):
    """Add to M of eq. (16) the soft eq. (15): y_j - s <= y_max, -y_j - s <= -y_min, s the column after the moves."""
    for j in range(horizon):
        for c in range(columns):
            effect = phi[c, j] if laguerre else (step[j - c] if j >= c else 0.0)
            rows[c, first + 2 * j] = effect
            rows[c, first + 2 * j + 1] = -effect
        rows[columns, first + 2 * j] = -1.0
        rows[columns, first + 2 * j + 1] = -1.0


@njit(**INLINE)
def _rounded(value, most):
    """A horizon: the nearest integer, between 1 and `most`; 1 when it is not a number."""
    return int(clip(math.floor(value + 0.5), 1.0, most)) if math.isfinite(value) else 1


@njit(types.void(int64, int64, int64, float64, float64, float64, vector, vector, matrix, WORKSPACE), **ROUTINE)
def form_model(lane, np_, nc, q, r, speed, model, settings, memory, ws):
    """What depends on speed and tuning alone: F, Phi, E and its factor, and the rows of eq. (15) in M."""
    own = memory[lane]
    laguerre = settings[LAGUERRE] > 0.5
    limited = _has_output_limits(settings)
    columns = int(settings[TERMS]) if laguerre else nc
    step, free, phi = ws.step[lane], ws.free[lane], ws.phi[lane if laguerre else 0]
    hessian, rows = ws.hessian[lane], ws.rows[lane if limited else 0]
    discretise(speed, settings[PERIOD], model, ws.a, ws.b)
    responses(np_, ws.a, ws.b, free, step)
    if laguerre:
        laguerre_response(np_, columns, step, ws.moves, phi)
        condensed_hessian(np_, columns, phi, q, r, hessian)
    else:
        pulse_hessian(np_, columns, step, q, r, hessian)
    if limited:
        for i in range(columns):
            hessian[i, columns] = 0.0
            hessian[columns, i] = 0.0
        hessian[columns, columns] = 2.0 * settings[OUTPUT_PRICE]
        limit_rows(nc, columns, laguerre, ws.moves, rows)
        for i in range(4 * nc):
            rows[columns, i] = 0.0
        output_rows(4 * nc, np_, columns, laguerre, step, phi, rows)
    own[FACTOR_STATUS], own[CONDITION] = factorise(columns + (1 if limited else 0), hessian, ws.factor[lane])
    own[KEPT] = 0.0
    own[KEY], own[KEY + 1], own[KEY + 2], own[KEY + 3], own[KEY + 4] = speed, np_, nc, q, r


@njit(
    types.UniTuple(int64, 3)(int64, float64, vector, vector, vector, vector, matrix, matrix, WORKSPACE),
    **INLINED_ROUTINE,
)
def form_qp(lane, speed, reference, tuning, model, settings, memory, record, ws):
    """The QP of eq. (17) for lane `lane`; returns its status so far, its variables n and its rows m.

    Takes x_c from ws.measured. reference: y_ref now and at the instants that follow; R_s holds its values from the
    next instant on with preview (the last one repeated as needed), its present value without. tuning: Np, Nc, Q, R
    as asked, the horizons rounded and clamped so that 1 <= Nc <= Np <= longest_horizon; model: see
    `prediction.MODEL_PARAMETERS`; settings: see MPC_SETTINGS. The model, E and its factor are formed again when
    speed or tuning has changed by even one bit, and not otherwise.
    """
    own = memory[lane]
    laguerre = settings[LAGUERRE] > 0.5
    limited = _has_output_limits(settings)
    np_ = _rounded(tuning[0], settings[LONGEST_HORIZON])
    nc = _rounded(tuning[1], min(float(np_), settings[MOST_MOVES]))
    q, r = tuning[2], tuning[3]
    speed = max(speed, settings[SPEED_FLOOR])
    out = record[lane]
    out[R_NP], out[R_NC], out[R_Q], out[R_R] = np_, nc, q, r
    columns = int(settings[TERMS]) if laguerre else nc
    n = columns + (1 if limited else 0)
    m = 4 * nc + (2 * np_ if limited else 0)
    if not (math.isfinite(tuning[0]) and math.isfinite(tuning[1]) and math.isfinite(q) and math.isfinite(r)):
        return qp.NON_FINITE, n, m
    if not (q >= 0.0 and r > 0.0):
        return qp.NOT_CONVEX, n, m
    if not (
        own[KEY] == speed and own[KEY + 1] == np_ and own[KEY + 2] == nc and own[KEY + 3] == q and own[KEY + 4] == r
    ):
        form_model(lane, np_, nc, q, r, speed, model, settings, memory, ws)

    # K, from R_s and x~ = [x_c(k) - x_c(k-1), y]
    if settings[PREVIEW] > 0.5:
        for j in range(np_):
            ws.reference[j] = reference[min(j + 1, reference.size - 1)]
    else:
        for b in range(0, np_, vectors.WIDTH):
            vectors.store(ws.reference, b, vectors.spread(reference, 0))
    for i in range(4):
        ws.change[i] = ws.measured[i] - own[PREVIOUS + i] if own[STARTED] > 0.5 else 0.0 * ws.measured[i]
    tracking_error(np_, ws.free[lane], ws.change, ws.measured[3], ws.reference, ws.error)
    if laguerre:
        condensed_gradient(np_, columns, ws.phi[lane], q, ws.error, ws.gradient)
    else:
        pulse_gradient(np_, columns, ws.step[lane], q, ws.error, ws.gradient)
    if limited:
        ws.gradient[columns] = 0.0

    # gamma of eq. (16)
    angle = own[ANGLE]
    for i in range(2):
        ws.bounds[4 * i] = settings[MOVE_MAX]
        ws.bounds[4 * i + 1] = -settings[MOVE_MIN]
        ws.bounds[4 * i + 2] = settings[ANGLE_MAX] - angle
        ws.bounds[4 * i + 3] = angle - settings[ANGLE_MIN]
    for b in range(8, 4 * nc, vectors.WIDTH):
        vectors.store(ws.bounds, b, vectors.load(ws.bounds, 0))
    if limited:
        for j in range(np_):
            response = ws.reference[j] - ws.error[j]  # F x~
            ws.bounds[4 * nc + 2 * j] = settings[OUTPUT_MAX] - response
            ws.bounds[4 * nc + 2 * j + 1] = response - settings[OUTPUT_MIN]
    return int(own[FACTOR_STATUS]), n, m


@njit(**INLINE)
def _qp_in(lane, n, m, settings, ws):
    """The problem, the solution and the scratch of lane `lane` in the workspace."""
    rows = ws.rows[lane if _has_output_limits(settings) else 0]
    problem = qp.Problem(n, m, ws.hessian[lane], ws.gradient, rows, ws.bounds)
    scratch = qp.Scratch(ws.qp_work[lane], ws.qp_rows, ws.qp_index[lane])
    return problem, qp.Solution(ws.solution, ws.multipliers), scratch


@njit(types.UniTuple(int64, 2)(int64, int64, int64, vector, matrix, WORKSPACE), **INLINED_ROUTINE)
def solve_qp(lane, n, m, settings, memory, ws):
    """Solve the QP in the workspace with the solver of the settings: (status, iterations)."""
    solver = int(settings[SOLVER])
    own = memory[lane]
    problem, solution, scratch = _qp_in(lane, n, m, settings, ws)
    factor = qp.Factor(ws.factor[lane, 0], ws.factor[lane, 1], own[CONDITION])
    status, iterations = qp.CAPPED, 0
    if solver != ACTIVE_SET:
        own[ACTIVE] = 0.0
        status, iterations = hildreth(
            problem, factor, solution, scratch, int(settings[MAX_SWEEPS]), settings[TOLERANCE], False
        )
    if solver == ACTIVE_SET or (solver == HILDRETH_THEN_EXACT and status == qp.CAPPED):
        # The rows that were active a period ago are a good guess, and while E stays so does their factor.
        status, more, active = active_set(
            problem, factor, solution, scratch, int(own[ACTIVE]), own[KEPT] > 0.5, 10 * (n + m)
        )
        own[ACTIVE], own[KEPT] = active, 1.0
        iterations += more
    return status, iterations


@njit(types.void(int64, int64, int64, int64, int64, vector, matrix, matrix, WORKSPACE), **INLINED_ROUTINE)
def apply_move(lane, status, iterations, n, m, settings, memory, record, ws):
    """Take the first move of the solution in the workspace, or hold the angle; write the record of the step.

    A move is taken when its QP is solved, or capped under HILDRETH_APPLIED. It obeys its limits to rounding
    (a capped one is clipped to them); otherwise the angle stays, within its limits, and the record says `held`.
    """
    own = memory[lane]
    out = record[lane]
    limited = _has_output_limits(settings)
    usable = status == qp.SOLVED or (status == qp.CAPPED and int(settings[SOLVER]) == HILDRETH_APPLIED)
    move = 0.0
    if usable:
        if settings[LAGUERRE] > 0.5:
            for i in range(int(settings[TERMS])):
                move += ws.moves[i, 0] * ws.solution[i]
        else:
            move = ws.solution[0]
        usable = math.isfinite(move)
    out[RESIDUAL] = math.nan
    if usable and settings[RESIDUALS] > 0.5:
        problem, solution, scratch = _qp_in(lane, n, m, settings, ws)
        stationarity, primal, dual, complementarity = kkt_residual(problem, solution, scratch)
        out[RESIDUAL] = max(max(stationarity, primal), max(dual, complementarity))
    move = clip(move, settings[MOVE_MIN], settings[MOVE_MAX]) if usable else 0.0
    angle = clip(own[ANGLE] + move, settings[ANGLE_MIN], settings[ANGLE_MAX])

    at_limit = 0
    if usable:
        near = 1e-9
        if move <= settings[MOVE_MIN] + near or move >= settings[MOVE_MAX] - near:
            at_limit |= AT_MOVE
        if angle <= settings[ANGLE_MIN] + near or angle >= settings[ANGLE_MAX] - near:
            at_limit |= AT_ANGLE
        if limited:
            for j in range(4 * int(out[R_NC]), m):
                if ws.multipliers[j] > 0.0:
                    at_limit |= AT_OUTPUT
                    break
    out[COMMAND], out[CHANGE] = angle, angle - own[ANGLE]
    out[STATUS], out[ITERATIONS] = status, iterations
    out[AT_LIMIT], out[HELD] = at_limit, 0.0 if usable else 1.0
    own[ANGLE] = angle
    for i in range(4):
        if math.isfinite(ws.measured[i]):
            own[PREVIOUS + i] = ws.measured[i]
    own[STARTED] = 1.0


@njit(types.void(int64, float64, vector, vector, vector, vector, matrix, matrix, WORKSPACE), **INLINED_ROUTINE)
def mpc_step(lane, speed, reference, tuning, model, settings, memory, record, ws):
    """One step of the MPC: form the QP, solve it, take the first move. Arguments as for `form_qp`."""
    status, n, m = form_qp(lane, speed, reference, tuning, model, settings, memory, record, ws)
    iterations = 0
    if status == qp.SOLVED:
        status, iterations = solve_qp(lane, n, m, settings, memory, ws)
    apply_move(lane, status, iterations, n, m, settings, memory, record, ws)


# -- the closed loop --------------------------------------------------------------------------------------------------
@njit(float64(int64, float64, float64, cube, int64, vector, vector), **ROUTINE)
def drive(k, period, speed, signals, scenario, loop, own):
    """Longitudinal force (N) of the driver: aims at the profile's speed a preview time ahead, with an integral.

    dv = (v_ref(t + T_p) - v_x)/T_p + K_i * integral of (v_ref - v_x); limited by engine power, traction and brakes,
    the integral standing still while a limit holds.
    """
    last = signals.shape[2] - 1
    ahead = loop[DRIVER_PREVIEW] / period
    j = min(k + int(ahead), last)
    part = ahead - math.floor(ahead)
    target = signals[scenario, SPEED, j] + part * (
        signals[scenario, SPEED, min(j + 1, last)] - signals[scenario, SPEED, j]
    )
    lag = signals[scenario, SPEED, k] - speed
    wanted = loop[MASS] * ((target - speed) / loop[DRIVER_PREVIEW] + loop[DRIVER_INTEGRAL] * own[INTEGRAL])
    strongest = min(loop[TRACTION_LIMIT], loop[ENGINE_POWER] / max(speed, 1.0))
    force = clip(wanted, -loop[BRAKE_LIMIT], strongest)
    if force == wanted:
        own[INTEGRAL] += lag * period
    return force


@njit(types.void(int64, int64, vector, vector, int64, vector), **INLINED_ROUTINE)
def sense(k, lane, block, loop, seed, measured):
    """Write x_c = [v_y, yaw, yaw rate, y] of a lane's vehicle as its sensors see it at instant k."""
    measured[0] = block[4 * LANES + lane]
    measured[1] = block[2 * LANES + lane]
    measured[2] = block[5 * LANES + lane]
    measured[3] = block[LANES + lane]
    for c in range(4):
        deviation = loop[NOISE_VY + c]
        if deviation > 0.0:
            measured[c] += deviation * counted_normal(seed, k, c)


@njit(types.void(int64, float64, vector, cube, int64, vector), **INLINED_ROUTINE)
def look(k, speed, measured, signals, scenario, condition):
    """Write what a scheduler may look at at instant k, see `inference.CONDITION`; measured: x_c, speed: v_x."""
    condition[0] = speed
    condition[1] = signals[scenario, Y_REF, k]
    for j in range(4):
        condition[2 + j] = signals[scenario, TOLD + j, k]
    condition[6] = signals[scenario, Y_REF, k] - measured[3]


@njit(types.void(int64, int64, float64, vector, float64, vector, cube, int64, matrix), **INLINED_ROUTINE)
def actuate(k, lane, command, block, period, loop, signals, scenario, memory):
    """Write the inputs of a lane's vehicle for the period after instant k: steering, speed control, friction, wind."""
    vx = block[3 * LANES + lane]
    block[STATES * LANES + lane] = command
    if loop[PRESCRIBED_SPEED] > 0.5:
        following = signals[scenario, SPEED, min(k + 1, signals.shape[2] - 1)]
        block[(STATES + 1) * LANES + lane] = 0.0
        block[(STATES + 2) * LANES + lane] = (following - vx) / period
    else:
        block[(STATES + 1) * LANES + lane] = drive(k, period, vx, signals, scenario, loop, memory[lane])
        block[(STATES + 2) * LANES + lane] = math.nan
    for j in range(6):
        block[(STATES + 3 + j) * LANES + lane] = signals[scenario, FRICTION + j, k]


@njit(types.void(int64, int64, PLANT_FUNCTION, vector, vector, matrix, matrix, vector), **ROUTINE)
def observe(lane, kind, derivative, p, block, states, plant_work, seen):
    """Write (lateral acceleration, front-wheel angle) of a lane's vehicle under its present input to `seen` (2,)."""
    n = states.shape[1]
    if kind == CUSTOM:
        lag, limit = p[p.size - 3], p[p.size - 1]
    else:
        lag, limit = p[STEERING_LAG], p[STEERING_LIMIT]
    angle = block[12 * LANES + lane] if lag > 0.0 else clip(block[STATES * LANES + lane], -limit, limit)
    if kind == CUSTOM:
        x, slope, u = plant_work[0, :n], plant_work[1, :n], plant_work[5, :2]
        for j in range(n):
            x[j] = states[lane, j]
        u[0], u[1] = angle, block[(STATES + 1) * LANES + lane]
        for j in range(6):
            plant_work[6, j] = block[(STATES + 3 + j) * LANES + lane]
        derivative(x, u, plant_work[6, :6], p[: p.size - 3], slope)
    else:
        x, slope, u = plant_work[0], plant_work[1], plant_work[5]
        for j in range(STATES):
            x[j] = block[j * LANES + lane]
        for j in range(INPUTS):
            u[j] = block[(STATES + j) * LANES + lane]
        vehicle_derivative(kind, x, u, p, slope)
    seen[0] = slope[4] + x[3] * x[5]
    seen[1] = angle


@njit(types.void(int64, int64, PLANT_FUNCTION, vector, vector, matrix, matrix, float64, vector), **ROUTINE)
def move_vehicles(lanes, kind, derivative, p, block, states, plant_work, period, loop):
    """Integrate the first `lanes` vehicles of a block over one period."""
    substeps = int(loop[SUBSTEPS])
    if kind == CUSTOM:
        integrate_custom(derivative, p, block, states, lanes, substeps, period / substeps, plant_work)
    else:
        for i in range(lanes, (lanes + LANE_STEP - 1) // LANE_STEP * LANE_STEP):
            for row in range(STATES + INPUTS):
                block[row * LANES + i] = block[row * LANES]
        integrate(kind, p, block, lanes, substeps, period / substeps)


@njit(
    types.void(
        int64, int64, PLANT_FUNCTION, vector, vector, matrix, matrix, vector, vector, vector,
        cube, int_vector, matrix, int_vector, matrix, matrix, WORKSPACE, inference.SCHEDULE, matrix,
    ),
    **ROUTINE,
)  # fmt: skip
def control_period(
    k, lanes, derivative, p, block, states, plant_work, model, settings, loop,
    signals, scenario, tuning, seeds, memory, record, ws, plan, seen,
):  # fmt: skip
    """Everything between the control instants k and k + 1, for the first `lanes` lanes.

    derivative, p: the plant (a built-in one ignores `derivative`); block: see `integrate`; states (LANES, n),
    plant_work (7, max(n, STATES)): scratch; model, settings, loop: packed, see above; signals (S, SIGNALS, n + 1): the
    sampled scenarios, of which lane i drives number scenario[i] with noise seeds[i] and tuning[i] = Np, Nc, Q, R, which
    the scheduler `plan` writes, if it is one; memory (lanes, MEMORY) is read and updated, record (lanes, RECORD)
    written, and so is seen (lanes, 2), see `observe`, unless it is empty.
    """
    kind = int(loop[PLANT])
    for i in range(lanes):
        if memory[i, LOST] > 0.5:
            continue
        waiting = memory[i, ANGLE]
        sense(k, i, block, loop, seeds[i], ws.measured)
        reference = signals[scenario[i], Y_REF, k:]
        if plan.layout[inference.INPUTS] > 0:
            look(k, block[3 * LANES + i], ws.measured, signals, scenario[i], ws.condition)
            if plan.estimating.size > 0:
                estimation.estimate(
                    i, ws.measured, block[3 * LANES + i], waiting, math.nan, plan.believed, plan.estimating,
                    plan.estimates,
                )  # fmt: skip
                ws.condition[2] = plan.estimates[i, estimation.FRICTION_HAT]
                ws.condition[3] = plan.estimates[i, estimation.WIND_HAT]
            inference.schedule(i, ws.condition, plan, tuning[i])
        mpc_step(i, block[3 * LANES + i], reference, tuning[i], model, settings, memory, record, ws)
        command = waiting if loop[DELAY] > 0.5 else memory[i, ANGLE]
        actuate(k, i, command, block, settings[PERIOD], loop, signals, scenario[i], memory)
        if seen.size > 0:
            observe(i, kind, derivative, p, block, states, plant_work, seen[i])
    move_vehicles(lanes, kind, derivative, p, block, states, plant_work, settings[PERIOD], loop)
    last = signals.shape[2] - 1
    for i in range(lanes):
        error = block[LANES + i] - signals[scenario[i], Y_REF, min(k + 1, last)]
        vx, vy = block[3 * LANES + i], block[4 * LANES + i]
        spun = abs(vy) > max(WALKING, loop[SPIN_BEYOND] * abs(vx))
        if spun or not (abs(error) <= loop[LOST_BEYOND] and math.isfinite(block[5 * LANES + i])):
            memory[i, LOST] = 1.0


# -- whole runs -------------------------------------------------------------------------------------------------------
RESULT = (
    "squared_error",  # m^2, sum over the control instants of (Y - y_ref)^2; inf when the run was lost
    "squared_move",  # rad^2, sum of the squared changes of the command
    "largest_error",  # m
    "instants",  # control instants completed
    "lost",  # 1: the vehicle left the road (`lost_beyond`) or its state is no longer finite
    "capped",  # steps whose QP stopped at its cap
    "failed",  # steps without a solution of the QP (infeasible, not finite, not convex)
    "held",  # steps that held the previous angle
    "limited",  # steps at some limit
    "iterations",  # of the QP solver, summed
    "stopped",  # 1: the cost reached its ceiling
)
(
    SQUARED_ERROR, SQUARED_MOVE, LARGEST_ERROR, INSTANTS, RUN_LOST, CAPPED, FAILED, RUN_HELD, LIMITED, RUN_ITERATIONS,
    STOPPED,
) = range(len(RESULT))  # fmt: skip
LATERAL_ACCELERATION, STEERING = STATES + len(RECORD), STATES + len(RECORD) + 1
TRACE = STATES + len(RECORD) + 2
"""Width of a trace: the state at the instant, the record of the step taken there, then the lateral acceleration
(m/s^2) and the angle of the front wheels (rad) under the input that the step gave."""


@njit(types.void(int64, matrix, vector, matrix), **ROUTINE)
def place(lanes, start, block, states):
    """Put vehicles at rest relative to their motion: start (lanes, 6) = X, Y, yaw, v_x, v_y, yaw rate."""
    block[:] = 0.0
    states[:, :] = 0.0
    for i in range(lanes):
        for j in range(6):
            block[j * LANES + i] = start[i, j]
            states[i, j] = start[i, j]


@njit(
    types.void(
        int64, int64, PLANT_FUNCTION, vector, vector, matrix, matrix, vector, vector, vector,
        cube, int_vector, matrix, int_vector, matrix, matrix, WORKSPACE, inference.SCHEDULE,
        matrix, matrix, vector, float64, int64, matrix, matrix, cube,
    ),
    **ROUTINE,
)  # fmt: skip
def rollout(
    periods, lanes, derivative, p, block, states, plant_work, model, settings, loop,
    signals, scenario, tuning, seeds, memory, record, ws, plan, seen, start, ceiling, price,
    stretch, stretches, result, trace,
):  # fmt: skip
    """Whole runs of `lanes` lanes over `periods` control periods; arguments as for `control_period`, and

    start (lanes, 6): see `place`; result (lanes, RESULT) and, unless `seen` is empty, trace (lanes, periods, TRACE)
    are written. A run ends early, as `stopped`, once its cost, the sum over the instants of squared error plus
    `price` times squared move, has reached ceiling (lanes,) and can only grow. The cost of each stretch of `stretch`
    periods is written to stretches (lanes, .), unless that is empty: inf for the one in which a run ends, NaN after.
    """
    place(lanes, start, block, states)
    result[:, :] = 0.0
    stretches[:, :] = 0.0
    traced = seen.size > 0
    for k in range(periods):
        for i in range(lanes):
            if memory[i, LOST] > 0.5:
                continue
            error = block[LANES + i] - signals[scenario[i], Y_REF, k]
            result[i, SQUARED_ERROR] += error * error
            if stretches.size > 0:
                stretches[i, k // stretch] += error * error
            result[i, LARGEST_ERROR] = max(result[i, LARGEST_ERROR], abs(error))
            result[i, INSTANTS] += 1.0
            if traced:
                for j in range(STATES):
                    trace[i, k, j] = block[j * LANES + i]
        control_period(
            k, lanes, derivative, p, block, states, plant_work, model, settings, loop,
            signals, scenario, tuning, seeds, memory, record, ws, plan, seen,
        )  # fmt: skip
        running = 0
        for i in range(lanes):
            if result[i, RUN_LOST] > 0.5 or result[i, STOPPED] > 0.5:
                if traced:
                    trace[i, k, :] = math.nan
                continue
            step = record[i]
            result[i, SQUARED_MOVE] += step[CHANGE] * step[CHANGE]
            if stretches.size > 0:
                stretches[i, k // stretch] += price * step[CHANGE] * step[CHANGE]
            result[i, CAPPED] += 1.0 if step[STATUS] == qp.CAPPED else 0.0
            result[i, FAILED] += 1.0 if step[STATUS] > qp.CAPPED else 0.0
            result[i, RUN_HELD] += step[HELD]
            result[i, LIMITED] += 1.0 if step[AT_LIMIT] > 0.5 else 0.0
            result[i, RUN_ITERATIONS] += step[ITERATIONS]
            if traced:
                for j in range(len(RECORD)):
                    trace[i, k, STATES + j] = step[j]
                trace[i, k, LATERAL_ACCELERATION], trace[i, k, STEERING] = seen[i, 0], seen[i, 1]
            if result[i, SQUARED_ERROR] + price * result[i, SQUARED_MOVE] >= ceiling[i]:
                result[i, STOPPED] = 1.0
                memory[i, LOST] = 1.0
            elif memory[i, LOST] > 0.5:
                result[i, RUN_LOST] = 1.0
                result[i, SQUARED_ERROR] = math.inf
            if memory[i, LOST] > 0.5:
                if stretches.size > 0:
                    stretches[i, k // stretch :] = math.nan
                    stretches[i, k // stretch] = math.inf
                for j in range(STATES):  # a harmless vehicle rides on in the lane
                    block[j * LANES + i] = 0.0
                block[3 * LANES + i] = 10.0
                for j in range(states.shape[1]):
                    states[i, j] = 10.0 if j == 3 else 0.0
            else:
                running += 1
        if running == 0 and not traced:
            break
