"""One step of the MPC: form the QP, solve it, take the first move. Eqs. (8) to (17).

Every slot of a batch is a controller of its own, with its own memory and tuning. A model and an estimator come as
compiled functions (`models.contract`, `estimators.contract`); nothing here knows how many states they have.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..estimators import kalman, learning
from ..estimators.contract import ABSURD, BY_FUNCTION, FASTEST, call_estimate
from ..kernel import (
    Place,
    address_of,
    boolean,
    columns,
    cube,
    exported,
    float64,
    four_dimensions,
    inlined,
    int64,
    int_matrix,
    int_vector,
    matrix,
    record,
    rows,
    several,
    vector,
    void,
)
from ..maths import vectors
from ..maths.bits import whole
from ..maths.exact import clip, floor
from ..models import path
from ..models.contract import MEASURED, call_discretise
from ..qp import problem as qp
from ..qp.active_set import active_set
from ..qp.factor import factorise
from ..qp.hildreth import hildreth
from ..qp.residual import kkt_residual
from .condensing import (
    Discrete,
    condensed_gradient,
    condensed_hessian,
    laguerre_moves,
    laguerre_response,
    pulse_gradient,
    pulse_hessian,
    responses,
    tracking_error,
)
from .contract import STANDING
from .feed_forward import bend_size, road_moves, tell_moves

# -- settings, fixed over a run ---------------------------------------------------------------------------------------
SETTINGS = record(
    "Settings",
    (
        "period",  # s
        "move_min", "move_max",  # rad per period, eq. (13)
        "angle_min", "angle_max",  # rad, eq. (14)
        "ahead",  # rad, by which the command may be ahead of the wheels in spite of eq. (13); 0: not
        "output_min", "output_max",  # m, eq. (15), soft; -inf and inf: none
        "output_weight",  # 1/m^2, weight of the squared violation of eq. (15)
        "error_max",  # m, of a larger error the QP is asked to correct so much; inf: all of it
        "laguerre",  # 1: moves by Laguerre functions, 0: by pulses
        "pole",  # of the Laguerre functions
        "terms",  # number of Laguerre functions
        "preview",  # 1: the reference ahead is known, 0: held at its present value
        "lead",  # periods, dead time of the model: the predicted outputs are so much later
        "speed_floor",  # m/s, the prediction model is never formed below this speed
        "estimator",  # DEADBEAT or BY_FUNCTION
        "solver",  # ACTIVE_SET, ...
        "max_sweeps",  # of Hildreth's procedure
        "max_changes",  # of the active set, 0: `qp.CHANGES` per variable and row
        "tolerance",  # of Hildreth's procedure, on the squared change of the multipliers in a sweep
        "residuals",  # 1: compute the KKT residual of every solution
        "longest_horizon", "most_moves",  # Np and Nc are clamped to what the workspace was made for
    ),
    whole=(
        "laguerre", "terms", "preview", "estimator", "solver", "max_sweeps", "max_changes", "residuals",
        "longest_horizon", "most_moves",
    ),
)  # fmt: skip

ACTIVE_SET, HILDRETH_THEN_EXACT, HILDRETH_APPLIED, HILDRETH_OR_HOLD = 0, 1, 2, 3
"""Solvers: the exact one; Hildreth finished by the exact one when not converged; Hildreth's last iterate whatever it
is, as the authors released it; Hildreth, its answer not used when not converged."""

# -- what is remembered from step to step, and what a step answers; a row per slot ------------------------------------
MEMORY = record(
    "Memory",
    (
        "started",  # 1 after the first step
        "command",  # rad, the last one
        "speed", "Np", "Nc", "Q", "R",  # what the workspace holds for this slot; NaN: nothing
        "factor_status", "condition",  # of the Hessian
        "active", "kept",  # active rows of the last solution, and whether their factor still belongs to E
        "planned", "age",  # entries of the last plan (0: none), and periods since it was made
        "reference",  # m, y_ref of the last step
    ),
    whole=("started", "factor_status", "active", "kept", "planned", "age"),
)  # fmt: skip

TUNING = columns("Np", "Nc", "Q", "R")
"""The MPC's named tuning entries."""
ANSWER = columns(
    "command", "command_change", "held", "Np", "Nc", "Q", "R", "qp_status", "qp_iterations", "qp_residual", "at_limit",
    "dead_reckoning",
)  # fmt: skip
"""What a step answers: command (rad), its change (rad), 1 when no solution could be used, the tuning as used, and the
diagnostics: status, iterations and largest KKT residual (NaN unless asked for) of the QP, sum of AT_MOVE, ..., and the
time (s) for which the estimator has had no position; 0 where the state is taken as measured."""
AT_MOVE, AT_ANGLE, AT_OUTPUT = 1, 2, 4
NEAR = 1e-9
"""rad, how near to a limit counts as at it."""
RESPONSE, STEEPEST = 1.0, 0.5
"""s, by which a car without preview follows a moving reference late; rad, a steeper reference has jumped."""

_FIELDS = (
    ("free", cube),  # (slots, n, Np) F
    ("step", matrix),  # (slots, Np) response to a unit move
    ("moves", matrix),  # (terms, Np) Laguerre functions, shared by all slots
    ("phi", cube),  # (slots, terms, Np) Phi L, transposed
    ("hessian", cube),  # (slots, n, n) E
    ("factor", four_dimensions),  # (slots, 2, n, n) of E
    ("rows", cube),  # (slots or 1, n, m) M, transposed
    ("bounds", vector),  # (m,) gamma
    ("reference", vector),  # (Np,) R_s
    ("error", vector),  # (Np,) R_s - F x~
    ("change", vector),  # (n,) x(k) - x(k-1), or x(k+1) - x(k) when an estimator gives the state
    ("a", cube),  # (slots, n, n) A and
    ("b", matrix),  # (slots, n) B at the speed of the slot, for an estimator
    ("gradient", vector),  # (n,) K
    ("solution", vector),  # (n,)
    ("multipliers", vector),  # (m,)
    ("qp_work", four_dimensions),  # (slots, ...) kept from one step to the next
    ("qp_rows", matrix),
    ("qp_index", int_matrix),  # (slots, ...) likewise
)
Workspace = record("Workspace", _FIELDS)
"""Every array that a step needs, made once for the longest horizons. Row lengths are padded to multiples of the vector
width, as the QP routines ask."""

_PARTS = (
    ("settings", rows(SETTINGS)),  # (1,)
    ("model", Discrete),  # scratch: the model at the present speed
    ("parameters", vector),  # of the model
    ("states", int_vector),  # (n,) which measured quantities the model's states are
    ("estimate", matrix),  # (2, n) state and disturbance; (0, n) for the deadbeat estimator
    ("estimator", vector),  # parameters of the estimator
    ("estimates", matrix),  # (slots, .) memory of the estimator
    ("learner", vector),  # parameters of the learner; empty: nothing is learned
    ("fresh", vector),  # its memory before the first step
    ("learned", matrix),  # (slots, .) its memory
    ("memory", rows(MEMORY)),  # (slots,)
    ("previous", matrix),  # (slots, n) measured state of the last step
    ("plan", matrix),  # (slots, n) last solution
    ("answer", matrix),  # (slots, ANSWER), then what is learned (`learning.BELIEFS`)
    ("measured", vector),  # (MEASURED,)
    ("bend", vector),  # (> Np,) m, the road ahead, see `road.bend_ahead`; empty: a straight one
    ("turning", vector),  # (7,) `feed_forward.TURNING` of the car; empty: the moves know nothing of the road
    ("feed", matrix),  # (3, > Np) rad, the moves that the road ahead asks for, see `feed_forward`; empty: none
    ("ws", Workspace),
)
Mpc = record("Mpc", _PARTS)
"""A batch of MPCs that share all but tuning and memory."""
MPC = Place(Mpc)

Functions = record("Functions", ("discretise", "estimate"), whole=("discretise", "estimate"))
"""Addresses of what the model and the estimator give, see their contracts; 0: none."""


def functions(**compiled: Any) -> Any:
    """`Functions`, from compiled ones by name; without any, those of a batch that no MPC drives."""
    return Functions(*[address_of(compiled.get(name)) for name in Functions._fields])


def workspace(slots: int, states: int, settings: Any) -> Any:
    """A workspace for up to `slots` slots under `SETTINGS`, for a model with `states` states."""
    own = settings[0]
    horizon = int(own.longest_horizon)
    moves = min(int(own.most_moves), horizon)
    limited = own.output_min > -math.inf or own.output_max < math.inf
    terms = int(own.terms) if own.laguerre else moves
    columns_of_e = terms + (1 if limited else 0)
    count = 4 * moves + (2 * horizon if limited else 0)
    np_, n, m = vectors.padded(horizon), vectors.padded(columns_of_e), vectors.padded(count)
    sizes = qp.workspace_sizes(columns_of_e, count, hildreth=own.solver != ACTIVE_SET)
    ws = Workspace(
        free=np.zeros((slots, states, np_)),
        step=np.zeros((slots, np_)),
        moves=np.zeros((columns_of_e, np_)),
        phi=np.zeros((slots if own.laguerre else 1, columns_of_e, np_)),
        hessian=qp.aligned((slots, columns_of_e, n)),
        factor=qp.aligned((slots, *sizes["factor"])),
        rows=qp.aligned((slots if limited else 1, columns_of_e, m)),
        bounds=qp.aligned((m,)),
        reference=np.zeros(np_),
        error=np.zeros(np_ + n + vectors.WIDTH),
        change=np.zeros(states),
        a=np.zeros((slots if own.estimator == BY_FUNCTION else 0, states, states)),
        b=np.zeros((slots if own.estimator == BY_FUNCTION else 0, states)),
        gradient=qp.aligned((n,)),
        solution=qp.aligned((n,)),
        multipliers=qp.aligned((m,)),
        qp_work=qp.aligned((slots, *sizes["work"])),
        qp_rows=qp.aligned(sizes["rows"]),
        qp_index=np.zeros((slots, *sizes["index"]), dtype=np.int64),
    )
    if own.laguerre:
        laguerre_moves(horizon, int(own.terms), own.pole, ws.moves)
    for each in ws.rows:
        limit_rows(moves, terms, bool(own.laguerre), ws.moves, each)
    return ws


def batch(
    slots: int, settings: Any, model: tuple[Any, Any, Any, Any], estimator: tuple[Any, int], curved: bool = False,
    learner: tuple[Any, Any] | None = None,
) -> Any:  # fmt: skip
    """Fresh MPCs for `slots` slots; curved: whether they drive curved roads.

    model: parameters (p,), places of its states in `MEASURED` (n,), output row (n,), `feed_forward.TURNING` (7,) or
    nothing; estimator: parameters (q,) and length of the memory; learner: parameters and first memory, None: nothing is
    learned.
    """
    parameters, states, output, turning = model
    own, length = estimator
    learns, fresh = (np.zeros(0), np.zeros(0)) if learner is None else learner
    n = len(states)
    ws = workspace(slots, n, settings)
    discrete = Discrete(np.zeros((n, n)), np.zeros(n), np.array(output, float), np.zeros(n), np.zeros((3, n)))
    made = Mpc(
        settings=settings,
        model=discrete,
        parameters=np.array(parameters, float),
        states=np.array(states, np.int64),
        estimate=np.zeros((2 if settings[0].estimator == BY_FUNCTION else 0, n)),
        estimator=np.array(own, float),
        estimates=np.zeros((slots, length)),
        learner=np.array(learns, float),
        fresh=np.array(fresh, float),
        learned=np.tile(np.array(fresh, float), (slots, 1)),
        memory=memory(slots),
        previous=np.zeros((slots, n)),
        plan=np.zeros((slots, len(ws.solution))),
        answer=np.zeros((slots, len(ANSWER) + (0 if learner is None else len(learning.BELIEFS)))),
        measured=np.zeros(len(MEASURED)),
        bend=np.zeros(0),
        turning=np.array(turning, float),
        feed=np.zeros((3, 0)),
        ws=ws,
    )
    return on_curved_roads(made) if curved else made


def on_curved_roads(mpc: Any) -> Any:
    """The same MPCs with room for the road ahead."""
    horizon, period = int(mpc.settings[0].longest_horizon), float(mpc.settings[0].period)
    return mpc._replace(
        bend=np.zeros(bend_size(horizon, period, mpc.turning)),
        feed=np.zeros((3, horizon + 1 if mpc.turning.size else 0)),
    )


def memory(slots: int) -> Any:
    """What MPCs remember before their first step, (slots,)."""
    return MEMORY.new(slots, speed=math.nan)


@inlined
def _begin_learning(slot, mpc):
    """Back to what is known before the first step."""
    for i in range(mpc.fresh.size):
        mpc.learned[slot, i] = mpc.fresh[i]


@inlined
def forget(slot, mpc):
    """Back to before the first step; the model and factor that the workspace holds stay valid."""
    own = mpc.memory[slot]
    own.started, own.command, own.active, own.kept, own.planned, own.age = 0, 0.0, 0, 0, 0, 0
    own.reference = 0.0
    mpc.previous[slot, :] = 0.0
    mpc.estimates[slot, :] = 0.0
    _begin_learning(slot, mpc)


@inlined
def lead_of(slot, mpc):
    """Periods of dead time in the model of a slot."""
    if mpc.learner.size > 0:
        return learning.lead_of(mpc.learner, mpc.learned[slot])
    return mpc.settings[0].lead


@inlined
def _learn(slot, speed, mpc, functions):
    """Learn from what is measured, and let model and estimator of the slot believe it."""
    out, known = mpc.answer[slot], mpc.learned[slot]
    left_out = whole(mpc.estimates[slot, kalman.LEFT_OUT])
    learning.learn(speed, mpc.measured, mpc.memory[slot].command, left_out, mpc.learner, known)
    for i in range(out.size - len(ANSWER)):
        if not math.isfinite(known[learning.ANSWER + i]):
            _begin_learning(slot, mpc)
    for i in range(out.size - len(ANSWER)):
        out[len(ANSWER) + i] = known[learning.ANSWER + i]
    if math.isfinite(speed):
        learning.believe(mpc.learner, known, mpc.parameters, mpc.estimator, mpc.estimates[slot])
        mpc.memory[slot].speed = math.nan  # the model is formed anew
        if mpc.turning.size > 0:
            path.write_turning(mpc.parameters, mpc.turning)


@inlined
def _has_output_limits(settings):
    return settings.output_min > -math.inf or settings.output_max < math.inf


# -- the QP -----------------------------------------------------------------------------------------------------------
@exported(void(int64, int64, boolean, matrix, matrix))
def limit_rows(samples, columns_of_e, laguerre, moves, rows):
    """Write M of eq. (16) for eqs. (13), (14), transposed: rows (columns, >= 4 samples).

    Four rows a sample: the move, its negative, the angle (the sum of moves), its negative. In this order the rows
    of a shorter control horizon are the leading block of a longer one's, so they are written once.
    """
    for c in range(columns_of_e):
        angle = 0.0
        for i in range(samples):
            move = moves[c, i] if laguerre else (1.0 if c == i else 0.0)
            angle += move
            rows[c, 4 * i] = move
            rows[c, 4 * i + 1] = -move
            rows[c, 4 * i + 2] = angle
            rows[c, 4 * i + 3] = -angle


@exported(void(int64, int64, int64, boolean, vector, matrix, matrix))
def output_rows(first, horizon, columns_of_e, laguerre, step, phi, rows):
    """Add to M of eq. (16) the soft eq. (15): y_j - s <= y_max, -y_j - s <= -y_min, s the column after the moves."""
    for j in range(horizon):
        for c in range(columns_of_e):
            effect = phi[c, j] if laguerre else (step[j - c] if j >= c else 0.0)
            rows[c, first + 2 * j] = effect
            rows[c, first + 2 * j + 1] = -effect
        rows[columns_of_e, first + 2 * j] = -1.0
        rows[columns_of_e, first + 2 * j + 1] = -1.0


@inlined
def _horizon(value, most):
    """A horizon: the nearest integer, between 1 and `most`; 1 when it is not a number."""
    return whole(clip(floor(value + 0.5), 1.0, most)) if math.isfinite(value) else 1


@inlined
def _take_tuning(slot, tuning, mpc):
    """Write the tuning as used to the answer, its horizons rounded and clamped; returns whether it makes a QP."""
    settings, out = mpc.settings[0], mpc.answer[slot]
    horizon = _horizon(tuning[TUNING.Np], float(settings.longest_horizon))
    out[ANSWER.Np] = horizon
    out[ANSWER.Nc] = _horizon(tuning[TUNING.Nc], min(float(horizon), float(settings.most_moves)))
    q, r = tuning[TUNING.Q], tuning[TUNING.R]
    if mpc.learner.size > 0:
        r *= out[len(ANSWER) + learning.BELIEF.used_caution]
    out[ANSWER.Q], out[ANSWER.R] = q, r
    known = math.isfinite(tuning[TUNING.Np]) and math.isfinite(tuning[TUNING.Nc])
    if not (known and math.isfinite(q) and math.isfinite(r)):
        return qp.NON_FINITE
    return qp.SOLVED if q >= 0.0 and r > 0.0 else qp.NOT_CONVEX


@inlined
def _discretise(speed, mpc, functions):
    """Write the model at a speed to the workspace."""
    model = mpc.model
    call_discretise(functions.discretise, speed, mpc.settings[0].period, mpc.parameters, model.a, model.b, model.e)


@inlined
def _keep_for_estimator(slot, mpc):
    """A and B at the speed of the slot."""
    for i in range(mpc.model.b.size):
        mpc.ws.b[slot, i] = mpc.model.b[i]
        for j in range(mpc.model.b.size):
            mpc.ws.a[slot, i, j] = mpc.model.a[i, j]


@inlined
def _clear_padding(rows, size, values):
    """Zero what a larger problem, perhaps one that was not finite, has left in the padding of so many rows."""
    b = size // vectors.WIDTH * vectors.WIDTH
    if b < size:
        for i in range(rows):
            vectors.store(values, i, b, vectors.keep_first(vectors.load(values, i, b), size - b))


@exported(void(int64, float64, MPC, Functions))
def _form_model(slot, speed, mpc, functions):
    """What depends on speed and tuning alone: F, Phi, E and its factor, and the rows of eq. (15) in M."""
    settings, own, out, ws = mpc.settings[0], mpc.memory[slot], mpc.answer[slot], mpc.ws
    np_, nc, q, r = whole(out[ANSWER.Np]), whole(out[ANSWER.Nc]), out[ANSWER.Q], out[ANSWER.R]
    laguerre, limited = settings.laguerre > 0, _has_output_limits(settings)
    moves = settings.terms if laguerre else nc
    step, phi = ws.step[slot], ws.phi[slot if laguerre else 0]
    hessian, rows = ws.hessian[slot], ws.rows[slot if limited else 0]
    _discretise(speed, mpc, functions)
    by_function = settings.estimator == BY_FUNCTION
    responses(np_, by_function, mpc.model, ws.free[slot], step)
    if by_function:
        _keep_for_estimator(slot, mpc)
    if laguerre:
        laguerre_response(np_, moves, step, ws.moves, phi)
        condensed_hessian(np_, moves, phi, q, r, hessian)
    else:
        pulse_hessian(np_, moves, step, q, r, hessian)
    if limited:
        for i in range(moves):
            hessian[i, moves] = 0.0
            hessian[moves, i] = 0.0
        hessian[moves, moves] = 2.0 * settings.output_weight
        limit_rows(nc, moves, laguerre, ws.moves, rows)
        for i in range(4 * nc):
            rows[moves, i] = 0.0
        output_rows(4 * nc, np_, moves, laguerre, step, phi, rows)
        _clear_padding(moves + 1, 4 * nc + 2 * np_, rows)
    n = moves + (1 if limited else 0)
    _clear_padding(n, n, hessian)
    own.factor_status, own.condition = factorise(n, hessian, ws.factor[slot])
    own.kept = 0
    own.speed, own.Np, own.Nc, own.Q, own.R = speed, np_, nc, q, r


@inlined
def _is_formed(slot, speed, mpc):
    """Whether the workspace holds this very speed and tuning, to the last bit."""
    own, out = mpc.memory[slot], mpc.answer[slot]
    same_horizons = out[ANSWER.Np] == own.Np and out[ANSWER.Nc] == own.Nc
    return own.speed == speed and same_horizons and out[ANSWER.Q] == own.Q and out[ANSWER.R] == own.R


@inlined
def _look_ahead(slot, horizon, reference, mpc):
    """R_s: the reference from the next instant on with preview (its last value repeated), else its present value;
    on a curved road with the offset of the road from its tangent.

    With a dead time the first output is that of a period after it; between instants the reference is interpolated.
    """
    ws, last, lead = mpc.ws, reference.size - 1, lead_of(slot, mpc)
    if mpc.settings[0].preview > 0 and lead > 0.0:
        first = whole(lead)
        share = lead - first
        for j in range(horizon):
            here, following = reference[min(first + j + 1, last)], reference[min(first + j + 2, last)]
            ws.reference[j] = here + share * (following - here)
    elif mpc.settings[0].preview > 0:
        for j in range(horizon):
            ws.reference[j] = reference[min(j + 1, last)]
    else:
        for b in range(0, horizon, vectors.WIDTH):
            vectors.store(ws.reference, b, vectors.spread(reference, 0))
    if mpc.bend.size > 0:
        for j in range(horizon):
            ws.reference[j] += mpc.bend[j + 1]


@inlined
def _limit_error(slot, horizon, output, reference, mpc):
    """Shift R_s towards the car, so that the error that it is asked to correct is no larger than the limit.

    output: predicted or measured y (m) at the end of the dead time. A car that does not know the reference ahead
    follows it `RESPONSE` late, and the limit is larger by that; a jump is no motion of the reference.
    """
    settings, own, ws = mpc.settings[0], mpc.memory[slot], mpc.ws
    limit, wanted = settings.error_max, reference[0]
    if not limit < math.inf:
        return
    if settings.preview > 0:
        lead = lead_of(slot, mpc)
        last, first = reference.size - 1, whole(lead)
        here, following = reference[min(first, last)], reference[min(first + 1, last)]
        wanted = here + (lead - first) * (following - here)
    elif own.started > 0:
        pace = abs(wanted - own.reference) / settings.period
        limit += RESPONSE * pace if pace <= STEEPEST * own.speed else 0.0
    own.reference = reference[0]
    if mpc.bend.size > 0:
        wanted += mpc.bend[0]
    gap = wanted - output
    beyond = gap - clip(gap, -limit, limit)
    if beyond != 0.0:
        for j in range(horizon):
            ws.reference[j] -= beyond


@inlined
def _turn_previous(slot, mpc):
    """Count the state of the last step from the tangent of the path at the present foot."""
    turned, previous = mpc.measured[MEASURED.turned], mpc.previous[slot]
    for i in range(mpc.states.size):
        if mpc.states[i] == MEASURED.yaw:
            previous[i] -= turned
        elif mpc.states[i] == MEASURED.y:
            previous[i] += 0.5 * mpc.memory[slot].speed * mpc.settings[0].period * turned


@inlined
def _estimate(slot, speed, mpc, functions):
    """State and disturbance at a speed (m/s) by the estimator."""
    a, b, own = mpc.ws.a[slot], mpc.ws.b[slot], mpc.estimates[slot]
    command, x, d = mpc.memory[slot].command, mpc.estimate[0], mpc.estimate[1]
    mpc.answer[slot, ANSWER.dead_reckoning] = call_estimate(
        functions.estimate, speed, mpc.measured, command, a, b, mpc.estimator, own, x, d
    )


@exported(void(int64, float64, MPC, Functions))
def _estimate_alone(slot, speed, mpc, functions):
    """Let the estimator see the samples of a step without a QP."""
    _discretise(speed, mpc, functions)
    _keep_for_estimator(slot, mpc)
    _estimate(slot, speed, mpc, functions)
    mpc.memory[slot].speed = math.nan  # the QP's matrices are of another


@inlined
def _free_response(slot, horizon, reference, mpc, functions):
    """R_s - Y without moves: from the last increments as measured, or from the next ones of x(k+1) = A x + B u + d."""
    settings, own, ws = mpc.settings[0], mpc.memory[slot], mpc.ws
    if settings.estimator == BY_FUNCTION:
        _estimate(slot, own.speed, mpc, functions)
        x, d, a, b = mpc.estimate[0], mpc.estimate[1], ws.a[slot], ws.b[slot]
        for i in range(x.size):
            total = b[i] * own.command + d[i] - x[i]
            for j in range(x.size):
                total += a[i, j] * x[j]
            ws.change[i] = total
        _limit_error(slot, horizon, x[x.size - 1], reference, mpc)
        tracking_error(horizon, ws.free[slot], ws.change, x[x.size - 1], ws.reference, ws.error)
        return
    if mpc.bend.size > 0:
        _turn_previous(slot, mpc)
    for i in range(mpc.states.size):
        now = mpc.measured[mpc.states[i]]
        ws.change[i] = now - mpc.previous[slot, i] if own.started > 0 else 0.0 * now
    output = mpc.measured[mpc.states[mpc.states.size - 1]]
    _limit_error(slot, horizon, output, reference, mpc)
    tracking_error(horizon, ws.free[slot], ws.change, output, ws.reference, ws.error)


@inlined
def _widen_first_move(slot, command, mpc):
    """Let the first move bring the command ahead of the wheels, as far as the actuator follows without its rate limit.

    A first-order lag turns the wheels at (command - angle)/lag, so |command - angle| <= rate lag is what it can do.
    """
    settings, ws = mpc.settings[0], mpc.ws
    ahead = settings.ahead
    if mpc.learner.size > 0:
        ahead = learning.ahead_of(ahead, mpc.learner, mpc.learned[slot])
    for i in range(mpc.states.size):
        if mpc.states[i] == MEASURED.wheel_angle:
            wheels = mpc.estimate[0, i]
            ws.bounds[0] = max(settings.move_max, wheels + ahead - command)
            ws.bounds[1] = max(-settings.move_min, command - wheels + ahead)


@inlined
def _clear_end(size, values):
    """`_clear_padding` of a vector."""
    b = size // vectors.WIDTH * vectors.WIDTH
    if b < size:
        vectors.store(values, b, vectors.keep_first(vectors.load(values, b), size - b))


@inlined
def _bound(slot, nc, horizon, mpc):
    """gamma of eq. (16)."""
    settings, ws, angle = mpc.settings[0], mpc.ws, mpc.memory[slot].command
    for i in range(2):
        ws.bounds[4 * i] = settings.move_max
        ws.bounds[4 * i + 1] = -settings.move_min
        ws.bounds[4 * i + 2] = settings.angle_max - angle
        ws.bounds[4 * i + 3] = angle - settings.angle_min
    for b in range(vectors.WIDTH, 4 * nc, vectors.WIDTH):
        vectors.store(ws.bounds, b, vectors.load(ws.bounds, 0))
    if settings.ahead > 0.0 and mpc.estimate.shape[0] > 0:
        _widen_first_move(slot, angle, mpc)
    if mpc.feed.size > 0:
        total = 0.0
        for i in range(nc):
            move = mpc.feed[1, i]
            total += move
            ws.bounds[4 * i] -= move
            ws.bounds[4 * i + 1] += move
            ws.bounds[4 * i + 2] -= total
            ws.bounds[4 * i + 3] += total
    if _has_output_limits(settings):
        for j in range(horizon):
            response = ws.reference[j] - ws.error[j]  # F x~
            ws.bounds[4 * nc + 2 * j] = settings.output_max - response
            ws.bounds[4 * nc + 2 * j + 1] = response - settings.output_min
        _clear_end(4 * nc + 2 * horizon, ws.bounds)


@inlined
def _leave_out_absurd(speed, mpc):
    """Let samples that no car gives be missing; the speed, NaN where it is one of them."""
    for sensor in range(kalman.SENSORS):
        if not abs(mpc.measured[sensor]) < ABSURD:
            mpc.measured[sensor] = math.nan
    if not abs(mpc.measured[MEASURED.turned]) < math.pi:
        mpc.measured[MEASURED.turned] = 0.0
    return speed if abs(speed) < FASTEST else math.nan


@exported(several(int64, int64, int64)(int64, float64, vector, vector, MPC, Functions))
def _form_qp(slot, speed, reference, tuning, mpc, functions):
    """See `form_qp`."""
    settings, out, ws = mpc.settings[0], mpc.answer[slot], mpc.ws
    out[ANSWER.dead_reckoning] = 0.0
    if settings.estimator == BY_FUNCTION:
        speed = _leave_out_absurd(speed, mpc)
    if mpc.learner.size > 0:
        _learn(slot, speed, mpc, functions)
    status = _take_tuning(slot, tuning, mpc)
    np_, nc = whole(out[ANSWER.Np]), whole(out[ANSWER.Nc])
    laguerre, limited = settings.laguerre > 0, _has_output_limits(settings)
    moves = settings.terms if laguerre else nc
    n = moves + (1 if limited else 0)
    m = 4 * nc + (2 * np_ if limited else 0)
    speed = max(speed, settings.speed_floor)
    if status != qp.SOLVED:
        if settings.estimator == BY_FUNCTION:
            _estimate_alone(slot, speed, mpc, functions)
        return status, n, m
    if not _is_formed(slot, speed, mpc):
        _form_model(slot, speed, mpc, functions)
    _look_ahead(slot, np_, reference, mpc)
    _free_response(slot, np_, reference, mpc, functions)
    if mpc.feed.size > 0:
        road_moves(np_, speed, settings, mpc.turning, mpc.bend, mpc.feed)
        tell_moves(np_, ws.step[slot], mpc.feed, ws.error)
    if laguerre:
        condensed_gradient(np_, moves, ws.phi[slot], out[ANSWER.Q], ws.error, ws.gradient)
    else:
        pulse_gradient(np_, moves, ws.step[slot], out[ANSWER.Q], ws.error, ws.gradient)
    if limited:
        ws.gradient[moves] = 0.0
        _clear_end(n, ws.gradient)
    _bound(slot, nc, np_, mpc)
    return mpc.memory[slot].factor_status, n, m


@inlined
def _qp_in(slot, n, m, mpc):
    """The problem, the solution and the scratch of a slot in the workspace."""
    ws = mpc.ws
    rows = ws.rows[slot if _has_output_limits(mpc.settings[0]) else 0]
    problem = qp.Problem(n, m, ws.hessian[slot], ws.gradient, rows, ws.bounds)
    return (
        problem,
        qp.Solution(ws.solution, ws.multipliers),
        qp.Scratch(ws.qp_work[slot], ws.qp_rows, ws.qp_index[slot]),
    )


@exported(several(int64, int64)(int64, int64, int64, MPC, Functions))
def _solve_qp(slot, n, m, mpc, functions):
    """Solve the QP in the workspace with the solver of the settings: (status, iterations)."""
    settings, own = mpc.settings[0], mpc.memory[slot]
    problem, solution, scratch = _qp_in(slot, n, m, mpc)
    factor = qp.Factor(mpc.ws.factor[slot, 0], mpc.ws.factor[slot, 1], own.condition)
    status, iterations = qp.CAPPED, 0
    if settings.solver != ACTIVE_SET:
        own.active = 0
        status, iterations = hildreth(
            problem, factor, solution, scratch, settings.max_sweeps, settings.tolerance, False
        )
    if settings.solver == ACTIVE_SET or (settings.solver == HILDRETH_THEN_EXACT and status == qp.CAPPED):
        # The rows that were active a period ago are a good guess, and while E stays so does their factor.
        most = settings.max_changes if settings.max_changes > 0 else qp.CHANGES * (n + m)
        status, more, active = active_set(problem, factor, solution, scratch, own.active, own.kept > 0, most)
        own.active, own.kept = active, 1
        iterations += more
    return status, iterations


# -- the move ---------------------------------------------------------------------------------------------------------
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
    settings, own = mpc.settings[0], mpc.memory[slot]
    own.age += 1
    last = whole(own.Np) if settings.laguerre > 0 else own.planned
    if own.planned == 0 or own.age >= last:
        return 0.0
    return _move_of(settings, own.age, mpc.plan[slot], mpc.ws.moves)


@inlined
def _residual(slot, n, m, mpc):
    """Largest KKT residual of the solution in the workspace."""
    problem, solution, scratch = _qp_in(slot, n, m, mpc)
    stationarity, primal, dual, complementarity = kkt_residual(problem, solution, scratch)
    return max(max(stationarity, primal), max(dual, complementarity))


@inlined
def _limits_reached(slot, move, angle, m, mpc):
    """Sum of AT_MOVE, AT_ANGLE, AT_OUTPUT for the limits at which a solved step is; move: beyond that of the road."""
    settings, bounds = mpc.settings[0], mpc.ws.bounds
    at_limit = 0
    if move <= -bounds[1] + NEAR or move >= bounds[0] - NEAR:
        at_limit |= AT_MOVE
    if angle <= settings.angle_min + NEAR or angle >= settings.angle_max - NEAR:
        at_limit |= AT_ANGLE
    if _has_output_limits(settings):
        for j in range(4 * whole(mpc.answer[slot, ANSWER.Nc]), m):
            if mpc.ws.multipliers[j] > 0.0:
                return at_limit | AT_OUTPUT
    return at_limit


@inlined
def _remember(slot, angle, mpc):
    """What the next step needs of this one."""
    own = mpc.memory[slot]
    own.command = angle
    for i in range(mpc.states.size):
        now = mpc.measured[mpc.states[i]]
        if math.isfinite(now):
            mpc.previous[slot, i] = now
    own.started = 1


@exported(void(int64, int64, int64, int64, int64, MPC))
def _apply_move(slot, status, iterations, n, m, mpc):
    """See `apply_move`."""
    settings, own, out, ws = mpc.settings[0], mpc.memory[slot], mpc.answer[slot], mpc.ws
    usable = status == qp.SOLVED or (status == qp.CAPPED and settings.solver == HILDRETH_APPLIED)
    move = _move_of(settings, 0, ws.solution, ws.moves) if usable else 0.0
    usable = usable and math.isfinite(move)
    if usable:
        for b in range(0, vectors.padded(n), vectors.WIDTH):
            vectors.store(mpc.plan, slot, b, vectors.load(ws.solution, b))
        own.planned, own.age = n - (1 if _has_output_limits(settings) else 0), 0  # the slack is no move
    else:
        planned = _planned_move(slot, mpc)
        move = 0.0 if status == qp.NON_FINITE else planned
    out[ANSWER.qp_residual] = _residual(slot, n, m, mpc) if usable and settings.residuals > 0 else math.nan
    fed = mpc.feed[1, 0] if mpc.feed.size > 0 and status != qp.NON_FINITE else 0.0
    if usable:
        move = clip(move, -ws.bounds[1], ws.bounds[0])
        total = move + fed
    else:
        total = clip(move + fed, settings.move_min, settings.move_max)
    angle = clip(own.command + total, settings.angle_min, settings.angle_max)
    out[ANSWER.command], out[ANSWER.command_change] = angle, angle - own.command
    out[ANSWER.qp_status], out[ANSWER.qp_iterations] = status, iterations
    out[ANSWER.held] = 0.0 if usable else 1.0
    out[ANSWER.at_limit] = _limits_reached(slot, move, angle, m, mpc) if usable else 0.0
    _remember(slot, angle, mpc)


@inlined
def _stand(slot, mpc):
    """Leave the wheels of a standing car at rest."""
    own, out = mpc.memory[slot], mpc.answer[slot]
    angle = clip(own.command, mpc.settings[0].angle_min, mpc.settings[0].angle_max)
    out[ANSWER.command], out[ANSWER.command_change], out[ANSWER.held] = angle, angle - own.command, 0.0
    out[ANSWER.qp_status], out[ANSWER.qp_iterations], out[ANSWER.qp_residual] = qp.SOLVED, 0, 0.0
    out[ANSWER.at_limit] = 0.0
    _remember(slot, angle, mpc)


@inlined
def step_with(slot, speed, reference, tuning, mpc, functions):
    """One step of a slot: form the QP, solve it, take the first move. Arguments as for `form_qp`.

    functions: see `Functions`.
    """
    status, n, m = _form_qp(slot, speed, reference, tuning, mpc, functions)
    iterations = 0
    if status == qp.SOLVED and abs(speed) < STANDING and mpc.settings[0].estimator == BY_FUNCTION:
        _stand(slot, mpc)
        return
    if status == qp.SOLVED:
        status, iterations = _solve_qp(slot, n, m, mpc, functions)
    _apply_move(slot, status, iterations, n, m, mpc)
