"""What the two MPCs share: settings, memory, answer and workspace of a batch of them. Eqs. (8) to (17).

    published   the paper's: predicts from increments of the measured state
    informed    predicts from the state and the disturbance that an estimator gives

Every slot of a batch is a controller of its own, with its own memory and tuning. A model and an estimator come as
compiled functions (`models.contract`, `estimators.extended_kalman`); nothing here knows how many states they have.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..estimators import kalman, learning
from ..kernel import (
    Field,
    Place,
    Row,
    address_of,
    columns,
    cube,
    defaults,
    exported,
    four_dimensions,
    inlined,
    int64,
    int_matrix,
    int_vector,
    matrix,
    record,
    rows,
    vector,
    void,
)
from ..layout import allocate, sizer
from ..maths import vectors
from ..models.contract import MEASUREMENT, PERIOD_FIELD
from ..models.path import turning_of
from ..qp import problem as qp
from .condensing import Discrete, laguerre_moves
from .constraints import OUTPUT_ROWS, SAMPLE_ROWS, limit_rows
from .contract import ANGLE_LIMITS, MOVE_LIMITS
from .feed_forward import FeedForward, bend_size

MPC_TUNING_FIELDS = (
    Field("Np", "control periods", 35, "prediction horizon", "[1, inf)"),
    Field("Nc", "control periods", 8, "control horizon", "[1, inf)"),
    Field("Q", "1/m^2", 10.0, "weight of the tracking error", "[0, inf)"),
    Field("R", "1/rad^2", 0.01, "weight of the moves", "(0, inf)", "a positive weight keeps the QP convex"),
)
MPCTuning = record("MPCTuning", MPC_TUNING_FIELDS)
PAPER_TUNING = defaults(MPCTuning)
"""The tuning of the paper's table."""


# -- settings, fixed over a run ---------------------------------------------------------------------------------------
MPCSettings = record(
    "MPCSettings",
    (
        PERIOD_FIELD,
        *MOVE_LIMITS,  # eq. (13)
        *ANGLE_LIMITS,  # eq. (14)
        "ahead",  # rad, by which the command may be ahead of the wheels in spite of eq. (13); 0: not
        "output_min", "output_max",  # m, eq. (15), soft; -inf and inf: none
        "output_weight",  # 1/m^2, weight of the squared violation of eq. (15)
        "error_max",  # m, the most of an error that the QP corrects; inf: all of it
        "laguerre",  # 1: moves by Laguerre functions, 0: by pulses
        Field("pole", "", 0.0, "pole of the Laguerre functions", "[0, 1)"),
        "terms",  # number of Laguerre functions
        "preview",  # 1: the reference ahead is known, 0: held at its present value
        Field("delay", "periods", 0.0, "dead time of the model: the predicted outputs are so much later", "[0, 1000]"),
        Field("speed_floor", "m/s", 1.0, "the prediction model is never formed below this speed", "[0.01, 100]"),
        "informed",  # 1: an estimator gives state and disturbance, 0: increments of the measured state
        "curved",  # 1: the road ahead may bend
        "feeds_forward",  # 1: the free moves are counted from those that the road ahead asks for
        "learns",  # 1: what the car does not say of itself is learned
        "solver",  # ACTIVE_SET, ...
        "max_sweeps",  # of Hildreth's procedure
        "max_changes",  # of the active set, 0: `qp.CHANGES` per variable and row
        "tolerance",  # of Hildreth's procedure, on the squared change of the multipliers in a sweep
        "residuals",  # 1: compute the KKT residual of every solution
        "longest_horizon", "most_moves",  # Np and Nc are clamped to what the workspace was made for
    ),
    integers=(
        "laguerre", "terms", "preview", "informed", "curved", "feeds_forward", "learns", "solver", "max_sweeps",
        "max_changes", "residuals", "longest_horizon", "most_moves",
    ),
)  # fmt: skip

EXACT_ONLY, HILDRETH_THEN_EXACT, HILDRETH_APPLIED, HILDRETH_OR_HOLD = 0, 1, 2, 3
"""Solvers: the exact one; Hildreth finished by the exact one when not converged; Hildreth's last iterate whatever it
is, as the authors released it; Hildreth, its answer not used when not converged."""

# -- what is remembered from step to step, and what a step answers; a row per slot ------------------------------------
MEMORY = record(
    "Memory",
    (
        "started",  # 1 after the first step
        "command",  # rad, the last one
        "speed", *MPCTuning._fields,  # what the workspace holds for this slot; NaN: nothing
        "rear_slope",  # of the rear tyres in its prediction, over their slope at no slip
        "factor_status", "condition",  # of the Hessian
        "active", "has_factor",  # active rows of the last solution, and whether their factor still belongs to E
        "planned", "age",  # entries of the last plan (0: none), and periods since it was made
        "reference",  # m, y_ref of the last step
    ),
    integers=("started", "factor_status", "active", "has_factor", "planned", "age"),
)  # fmt: skip

MPC_TUNING = columns(*MPCTuning._fields)
"""The MPC's named tuning entries."""
MPC_ANSWER = columns(
    "command", "command_change", "held", *MPCTuning._fields, "qp_status", "qp_iterations", "qp_residual", "at_limit",
    "dead_reckoning",
)  # fmt: skip
"""What a step answers: command (rad), its change (rad), 1 when no solution could be used, the tuning as used, and the
diagnostics: status, iterations and largest KKT residual (NaN unless requested) of the QP, sum of AT_MOVE, ..., and the
time (s) for which the estimator has had no position; 0 where the state is taken as measured."""
AT_MOVE, AT_ANGLE, AT_OUTPUT = 1, 2, 4

# -- arrays -----------------------------------------------------------------------------------------------------------
MPCWorkspace = record("MPCWorkspace", (
    ("free", cube, "slots", "states", "horizon"),  # F
    ("step", matrix, "slots", "horizon"),  # response to a unit move
    ("moves", matrix, "variables", "horizon"),  # Laguerre functions, shared by all slots
    ("phi", cube, "phi_slots", "variables", "horizon"),  # Phi L, transposed
    ("hessian", cube, "slots", "variables", "padded_variables"),  # E
    ("factor", four_dimensions, "slots", len(qp.INVERSE), "variables", "padded_variables"),  # of E
    ("rows", cube, "row_slots", "variables", "padded_rows"),  # M, transposed
    ("bounds", vector, "padded_rows"),  # gamma
    ("reference", vector, "horizon"),  # R_s
    ("error", vector, "errors"),  # R_s - F x~
    ("change", vector, "states"),  # x(k) - x(k-1), or x(k+1) - x(k) when an estimator gives the state
    ("gradient", vector, "padded_variables"),  # K
    ("solution", vector, "padded_variables"),
    ("multipliers", vector, "padded_rows"),
    ("qp_work", four_dimensions, "slots", len(qp.PLANE), "qp_work", "padded_variables"),  # kept between steps
    ("qp_rows", matrix, "qp_rows", "padded_rows"),
    ("qp_index", int_matrix, "slots", "qp_index"),  # kept between steps
))  # fmt: skip
"""Every array that a step needs, made once for the longest horizons. Row lengths are padded to multiples of the vector
width, as the QP routines ask."""

Estimating = record("Estimating", (
    ("x", vector, "estimated"),  # state and
    ("d", vector, "estimated"),  # disturbance
    ("a", cube, "estimated_slots", "states", "states"),  # A and
    ("b", matrix, "estimated_slots", "states"),  # B at the speed of the slot
    ("estimator", vector, "estimator"),  # parameters of the estimator
    ("estimates", matrix, "slots", "estimates"),  # its memory
    ("learner", vector, "learner"),  # parameters of the learner
    ("fresh", vector, "learned"),  # its memory before the first step
    ("learned", matrix, "slots", "learned"),  # its memory
))  # fmt: skip
"""What only the informed MPC has; without entries for the published one."""

Mpc = record("Mpc", (
    ("settings", MPCSettings),
    ("model", Discrete),  # scratch: the model at the present speed
    ("parameters", vector, "parameters"),  # of the model
    ("states", int_vector, "states"),  # which measured quantities the model's states are
    ("memory", rows(MEMORY), "slots"),
    ("previous", matrix, "slots", "states"),  # measured state of the last step
    ("plan", matrix, "slots", "padded_variables"),  # last solution
    ("answer", matrix, "slots", "answers"),  # `MPC_ANSWER`, then what is learned (`learning.BELIEF_NAMES`)
    ("measured", vector, len(MEASUREMENT)),
    ("bend", vector, "bend"),  # (> Np,) m, the road ahead, see `road.bend_ahead`
    ("feed", FeedForward),  # the moves that the road ahead asks for
    ("informed", Estimating),
    ("ws", MPCWorkspace),
))  # fmt: skip
"""A batch of MPCs that share all but tuning and memory."""
MPC_PLACE = Place(Mpc)

Functions = record("Functions", ("discretise", "estimate"), integers=("discretise", "estimate"))
"""Addresses of what the model and the estimator give, see their contracts; 0: none."""


def functions(**compiled: Any) -> Any:
    """`Functions`, from compiled ones by name; without any, those of a batch that no MPC drives."""
    return Functions(*[address_of(compiled.get(name)) for name in Functions._fields])


def settings(**values: Any) -> Any:
    """`MPCSettings`, zero but for the fields given."""
    return MPCSettings(**{**dict.fromkeys(MPCSettings._fields, 0), **values})


_CHOSEN = (
    "slots",
    "states", "parameters",  # of the model, and its numbers
    "turning",  # numbers of `TurnIn`, 0: none
    "lag",  # s, in `TurnIn`
    "estimator", "estimates",  # numbers of the estimator, and those that it remembers
    "learner", "learned",  # likewise; 0: nothing is learned
    "curved",  # 1: the road ahead may bend
)  # fmt: skip
_DERIVED = (
    "answers",  # columns of an answer
    "bend", "road_moves",  # instants ahead of which the road is known, and of which moves follow from it
    "estimated", "estimated_slots",  # states and slots of the model of an estimator; 0: none
    "horizon",  # the longest Np, padded
    "variables", "padded_variables", "padded_rows",  # of the QP
    "phi_slots", "row_slots",  # slots that have their own Phi and M
    "errors",  # of a step, with room for what is read ahead
    "qp_work", "qp_rows", "qp_index",  # of the workspace of the QP, see `problem.workspace_sizes`
)  # fmt: skip
MPCSizes = record("MPCSizes", (*_CHOSEN, *_DERIVED), integers={*_CHOSEN, *_DERIVED} - {"lag"})
"""The sizes of an `Mpc`: first those that are chosen, then those that follow from them and from its settings."""
_write_sizes = sizer(Mpc, MPCSizes)


@inlined
def complete_sizes(settings, sizes):
    """Write the sizes that follow from `MPCSettings` and the chosen ones; and of the settings what sizes say."""
    settings.learns = 1 if sizes.learner > 0 else 0
    settings.curved = sizes.curved
    settings.feeds_forward = 1 if sizes.curved > 0 and sizes.turning > 0 else 0
    horizon, moves = settings.longest_horizon, most_moves(settings)
    limited, laguerre = has_output_limits(settings), settings.laguerre > 0
    variables = (settings.terms if laguerre else moves) + (1 if limited else 0)
    count = SAMPLE_ROWS * moves + (OUTPUT_ROWS * horizon if limited else 0)
    _, work, qp_rows, index = qp.workspace_sizes(variables, count, settings.solver != EXACT_ONLY)
    sizes.answers = len(MPC_ANSWER) + (len(learning.BELIEF_NAMES) if sizes.learner > 0 else 0)
    sizes.bend = bend_size(horizon, settings.period, sizes.turning, sizes.lag) if sizes.curved > 0 else 0
    sizes.road_moves = horizon + 1 if settings.feeds_forward > 0 else 0
    sizes.estimated = sizes.states if settings.informed > 0 else 0
    sizes.estimated_slots = sizes.slots if settings.informed > 0 else 0
    sizes.horizon, sizes.variables = vectors.padded(horizon), variables
    sizes.padded_variables, sizes.padded_rows = vectors.padded(variables), vectors.padded(count)
    sizes.phi_slots = sizes.slots if laguerre else 1
    sizes.row_slots = sizes.slots if limited else 1
    sizes.errors = sizes.horizon + sizes.padded_variables + vectors.VECTOR_WIDTH
    sizes.qp_work, sizes.qp_rows, sizes.qp_index = work[1], qp_rows[0], index


@exported(int64(Row(MPCSettings), Row(MPCSizes), int_matrix), name="mpc_sizes")
def write_sizes(settings, sizes, table):
    """Write the sizes of the arrays of an `Mpc` and how many there are, see `layout`; complete sizes and settings.

    The settings lie at the beginning of an `Mpc`: these may be those.
    """
    complete_sizes(settings, sizes)
    return _write_sizes(sizes, table)


@exported(void(MPC_PLACE), name="mpc_prepare")
def prepare(mpc):
    """Everything in the zeroed memory of an `Mpc` that is not given, before the first step.

    Given are the settings, `parameters`, `states`, the estimator's and the learner's numbers, `fresh` and `turning`.
    """
    settings, ws = mpc.settings, mpc.ws
    laguerre, moves, last = settings.laguerre > 0, most_moves(settings), mpc.states.size - 1
    for i in range(mpc.states.size):
        mpc.model.c[i] = 1.0 if i == last else 0.0  # the last state is the output
    if laguerre:
        laguerre_moves(settings.longest_horizon, settings.terms, settings.pole, ws.moves)
    for i in range(len(ws.rows)):
        limit_rows(moves, settings.terms if laguerre else moves, laguerre, ws.moves, ws.rows[i])
    for slot in range(mpc.memory.size):
        mpc.memory[slot].speed = math.nan
        forget(slot, 0.0, mpc)


def batch(
    slots: int, settings: Any, model: tuple[Any, Any, Any], estimator: tuple[Any, int], curved: bool = False,
    learner: tuple[Any, Any] | None = None,
) -> Any:  # fmt: skip
    """Fresh MPCs for `slots` slots under `MPCSettings`; curved: whether they drive curved roads.

    model: parameters (p,), places of its states in `MEASUREMENT` (n,), `models.path.Turning` (7,) or nothing;
    estimator: parameters (q,) and length of the memory; learner: parameters and first memory, None: nothing is learned.
    """
    (parameters, states, turning), (numbers, estimates) = model, estimator
    learns, fresh = (np.zeros(0), np.zeros(0)) if learner is None else learner
    mpc_record = _room(
        settings, slots=slots, states=len(states), parameters=len(parameters), turning=len(turning),
        lag=_lag_of(turning), estimator=len(numbers), estimates=estimates, learner=len(learns), learned=len(fresh),
        curved=curved,
    )  # fmt: skip
    informed = mpc_record.informed
    for room_for, source in (
        (mpc_record.parameters, parameters), (mpc_record.states, states), (mpc_record.feed.turning, turning),
        (informed.estimator, numbers), (informed.learner, learns), (informed.fresh, fresh),
    ):  # fmt: skip
        room_for[:] = source
    prepare(mpc_record)
    return mpc_record


def _room(settings: Any, **chosen: Any) -> Any:
    """Zeroed memory of MPCs under settings, those completed; chosen: `MPCSizes` that are not 0."""
    (settled,), (sizes,) = MPCSettings.new(1, **settings._asdict()), MPCSizes.new(1, **chosen)
    complete_sizes(settled, sizes)
    return allocate(Mpc, sizes, settings=MPCSettings(*settled.tolist()))


def _lag_of(turning: Any) -> float:
    return float(turning_of(turning, 0).lag) if len(turning) else 0.0


def on_curved_roads(mpc: Any) -> Any:
    """Return MPCs with additional room for the road ahead."""
    turning = mpc.feed.turning
    curved = _room(
        mpc.settings, turning=len(turning), lag=_lag_of(turning), learner=mpc.settings.learns, curved=1
    )  # fmt: skip
    return mpc._replace(settings=curved.settings, bend=curved.bend, feed=curved.feed._replace(turning=turning))


@inlined
def most_moves(settings):
    """The largest Nc."""
    return min(settings.most_moves, settings.longest_horizon)


@inlined
def has_output_limits(settings):
    """Whether eq. (15) bounds the output."""
    return settings.output_min > -math.inf or settings.output_max < math.inf


@inlined
def begin_learning(slot, informed):
    """Back to what is known before the first step."""
    informed.learned[slot, :] = informed.fresh


@inlined
def forget(slot, command, mpc):
    """Back to before the first step, at a command (rad); the model and factor that the workspace holds stay valid."""
    restart(slot, mpc)
    begin_learning(slot, mpc.informed)
    mpc.memory[slot].command = command


@inlined
def restart(slot, mpc):
    """Reset a slot but keep what it has learned of the car."""
    memory = mpc.memory[slot]
    memory.started, memory.command, memory.active, memory.has_factor, memory.planned, memory.age = 0, 0.0, 0, 0, 0, 0
    memory.reference = 0.0
    mpc.previous[slot, :] = 0.0
    mpc.informed.estimates[slot, :] = 0.0
    if mpc.settings.learns > 0:
        learning.begin_again(mpc.informed.learned[slot])


@inlined
def change_path(slot, turned, shifted, late, mpc):
    """Let heading (rad) and offset (m) of the past grow by so much: another path lies under the car.

    late: of the Kalman filter; another estimator, -1, begins anew.
    """
    for i in range(mpc.states.size):
        if mpc.states[i] == MEASUREMENT.yaw:
            mpc.previous[slot, i] += turned
        elif mpc.states[i] == MEASUREMENT.y:
            mpc.previous[slot, i] += shifted
    if mpc.memory[slot].started == 0:
        return
    if late < 0:
        mpc.informed.estimates[slot, :] = 0.0
    else:
        kalman.move_path(mpc.informed.estimates[slot], late, turned, shifted)


@inlined
def delay_of(slot, mpc):
    """Periods from an instant until its command begins to act, in the model of a slot."""
    if mpc.settings.learns > 0:
        return learning.delay_of(mpc.informed.learner, mpc.informed.learned[slot])
    return mpc.settings.delay
