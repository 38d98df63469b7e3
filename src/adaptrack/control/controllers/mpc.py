"""The incremental linear MPC of the paper's section II-B: a tuning, limits, a way to parametrise moves, a QP solver.

Its numbers (Np, Nc, Q, R) may change at every step, nothing is rebuilt or allocated for it.
"""

from __future__ import annotations

import copy
import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from functools import cached_property
from itertools import product
from math import isfinite
from typing import Annotated, Any, Literal, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Count, Finite, Hint, Positive, checked, within
from adaptrack.base.errors import InvalidInput
from adaptrack.base.limits import CONTROL_HORIZON, PREDICTION_HORIZON
from adaptrack.base.registry import PluginCall
from adaptrack.cars.vehicle import Vehicle, VehicleArgument
from adaptrack.control.controllers.base import Controller, Room
from adaptrack.control.controllers.belief import MOST_COMPUTATION, GivenSteering, Uncertainty
from adaptrack.control.controllers.compatibility import INCREMENTAL, car_of, mismatches
from adaptrack.control.controllers.informed import AUTO, MPCParts, informed_parts
from adaptrack.control.controllers.inputs import KernelInput, change_of_path, number, road_ahead, vector, wheel_angle
from adaptrack.control.controllers.learned_car import BeliefState, LearnedCar, Learning, bounded_quantity
from adaptrack.control.controllers.limits import Limits, LimitsArgument, Moves
from adaptrack.control.controllers.tuning import ENTRIES, Tuning, read_tuning
from adaptrack.control.estimation import NOTHING_MEASURED, Deadbeat, Estimator, get_estimator
from adaptrack.control.kalman import KalmanFilter
from adaptrack.control.models import PredictionModel, SingleTrackModel
from adaptrack.control.qp import QP, ActiveSet, Hildreth, QPSolver, QPStatus, Solution, get_qp_solver
from adaptrack.core.controllers import mpc as kernel
from adaptrack.core.controllers.mpc_step import MPCStep, form_qp, mpc_controller, step
from adaptrack.core.controllers.receding import apply_move, predict_outputs, predict_path
from adaptrack.core.estimators.learning import BELIEF_COLUMNS, BELIEF_NAMES, memory_of
from adaptrack.core.kernel import Resident, direct
from adaptrack.core.maths.portable import Array
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.scheduling.functions import VARIABLE_NAMES
from adaptrack.core.scheduling.guard import COUNTS
from adaptrack.core.scheduling.schedule import schedule
from adaptrack.road.road_ahead import RoadAhead, stacked
from adaptrack.scenario.profile import Profile, load_profile

_STATUSES = {float(status): status for status in QPStatus}
_AT_LIMIT = {float(sum_of): sum_of for sum_of in range(8)}
"""`MPCCommand.status` and `MPCCommand.at_limit` by what a kernel answers"""
_ANSWER = 12
"""Numbers of `core.controllers.mpc.MPC_ANSWER`; what is learned follows."""
_HILDRETH = {
    "exact": kernel.HILDRETH_THEN_EXACT, "apply": kernel.HILDRETH_APPLIED, "hold": kernel.HILDRETH_OR_HOLD
}  # fmt: skip
"""What a kernel does with Hildreth's answers, by `QPSolver.on_uncertified`."""
_DIAGNOSTICS = ("qp_status", "qp_iterations", "qp_residual", "at_limit", "dead_reckoning")
_STATE_SIZES = tuple(range(4, len(MEASUREMENT) + 1))
"""the first four of `core.models.contract.MEASUREMENT`, or more of them"""
_NOT_CARRIED = (
    "_lock", "_measured", "_answer", "_learned", "_state", "_reference", "_now", "_resident", "_resident_plan", "_step",
    "_own_part", "functions",
)  # fmt: skip
"""Of a controller, by a copy of it: see `MPC._load`."""
_METHOD = "'auto' serves as well, and Learning() gives one"
SPEED_KEPT = 6.0
"""s, for which the last speed counts while it is missing; then a step holds."""
_log = logging.getLogger("adaptrack")


_new = tuple.__new__  # of a named tuple; its own `_make` takes twice as long


@runtime_checkable
class Scheduler(Protocol):
    """Chooses the tuning for scheduling variables. Horizons may be real numbers: they are rounded and clamped."""

    def __call__(self, variables: Any) -> Any:
        """A `Tuning`, or the four numbers Np, Nc, Q, R, for `scheduling.SchedulingVariables`."""


@runtime_checkable
class CompiledScheduler(Scheduler, Protocol):
    """A scheduler that compiled runs can ask, see `core.scheduling.schedule`."""

    def plan(self, slots: int) -> Any:
        """The packed scheduler with a fresh memory for `slots` runs."""

    @property
    def largest(self) -> tuple[int, int]:
        """The longest Np and Nc that it can ask for."""


class MPCCommand(NamedTuple):
    """Result of one step of the MPC."""

    angle: float
    """rad, steering angle to apply, u(k)"""
    move: float
    """rad, u(k) - u(k-1)"""
    held: bool
    """no usable solution: the next move of the last plan is taken, none when the data are not finite"""
    tuning: tuple[float, ...]
    """Np, Nc, Q, R as used: rounded and clamped"""
    status: QPStatus
    """of the QP"""
    iterations: int
    """of the QP solver"""
    residual: float
    """largest KKT residual of the solution, see `qp.kkt_residuals`; NaN when there is none"""
    at_limit: int
    """sum of 1 (move), 2 (angle), 4 (output)"""
    dead_reckoning: float = 0.0
    """s, for which no position has been taken in: the command rests on the estimate; 0 where the state is measured"""
    learned: tuple[float, ...] = ()
    """Learned quantities, in the order of `core.estimators.learning.BELIEF_NAMES`."""

    @property
    def diagnostics(self) -> tuple[float, ...]:
        """In the order of `MPC.diagnostic_names`."""
        figures = float(self.status), float(self.iterations), self.residual, float(self.at_limit), self.dead_reckoning
        return (*figures, *self.learned)

    @property
    def belief_state(self) -> BeliefState | None:
        """How far what is learned can be trusted; None where nothing is."""
        return BeliefState(int(self.learned[BELIEF_COLUMNS.belief_state])) if self.learned else None

    @property
    def belief_at_bound(self) -> str | None:
        """The quantity whose belief is at the end of its range, as `QUANTITIES_BOUNDED` names it; None: none."""
        return bounded_quantity(self.learned[BELIEF_COLUMNS.belief_at_bound]) if self.learned else None


def _given_parts(
    vehicle: Vehicle, model: PredictionModel | None, estimator: Estimator | None, period: float | None
) -> MPCParts:
    """A model or an estimator of the caller's, the rest as in the paper."""
    prediction_model = SingleTrackModel(vehicle, 0.1 if period is None else period) if model is None else model
    if period not in (None, prediction_model.period):
        raise InvalidInput(
            f"MPC: period = {period!r} s, but the model's is {prediction_model.period!r} s: give both alike."
        )
    return MPCParts(Tuning(), prediction_model, Deadbeat() if estimator is None else estimator, Limits(), preview=False)


def _whole_horizon(longest: float) -> float:
    """A horizon for which there shall be memory, rounded; any that is finite for an infinite one."""
    return max(1.0, math.floor(longest + 0.5)) if longest < math.inf else 1e9


class MPC(Controller):
    """Linear MPC with re-discretisation at every step, eqs. (8)-(17).

    Its default model is a `PathModel` with the lag and the dead time of the steering, its default estimator a
    `KalmanFilter` for the sensors of a profile. `published_mpc` is the paper's.

    vehicle: mass, inertia, axle distances and stiffness of the model, and the steering of the car file; tuning: the
    constant one, or the one before the scheduler's first; default: `informed_tuning`; profile: name, file or `Profile`
    of period, preview and sensors (default: "road"); a controller that does not learn takes unknown steering
    parameters from a named profile; belief: a `Steering` that precedes the car file, or "unknown": ignore car file and
    profile; the controller's `belief` lists its steering parameters and their sources; computation: time from a
    control instant until its command is sent, in addition to the dead time; default: that of the named profile, or 0.

    learning: "auto" learns the car while it drives where lag or dead time of the steering is unknown, a `Learning`
    always, None never: unknown values are then slow published ones, with R raised. uncertainty: how far the belief may
    be wrong. A controller that does not learn assumes a longer delay for it and raises R; default: ``[known_within]``
    of the car file. One that learns stays within it; default: `UNKNOWN_CAR`, or the car file's where that is wider.

    period: control period; limits: by default the assumed rate times the period (the paper's table for an unknown
    delay) and the assumed angle; preview: whether R_s holds the reference ahead or its present value; solver:
    "active-set" (exact), "hildreth" (the paper's), or a `QPSolver`, whose `on_uncertified` treats answers that are not
    certified; speed_floor: lowest speed of the model; longest_horizon, most_moves: largest Np and Nc of a scheduler.

    model, estimator: a `PredictionModel`, and an `Estimator` or its registered name. A `KalmanFilter` alone replaces
    the default one. Any other excludes profile and belief: the other part, the tuning, the limits and a period of
    0.1 s are then the paper's (single track, "deadbeat", table) unless specified.

    A controller drives one vehicle. A copy (`copy`, `deepcopy`, pickle) is a controller of its own, in the same state.
    Used by two threads at once it refuses the second.

    Raises
    ------
    InvalidInput
        For arguments that make no controller: the message says which.
    """

    period: float
    tuning_names = ENTRIES
    sees_all_sensors = has_horizons = is_exportable = True

    @checked
    def __init__(
        self,
        vehicle: VehicleArgument,
        tuning: Annotated[Tuning, Hint("Tuning(Np, Nc, Q, R)")] | None = None,
        *,
        profile: str | Profile | None = None,
        belief: GivenSteering = None,
        computation: Annotated[Finite, within(0.0, MOST_COMPUTATION), "s"] | None = None,
        uncertainty: Annotated[Uncertainty, Hint("Uncertainty(lag=..., dead_time=...)")] | None = None,
        learning: Annotated[Learning | Literal["auto"], Hint(_METHOD)] | None = AUTO,
        period: Annotated[Positive, "s"] | None = None,
        limits: LimitsArgument | None = None,
        moves: Moves | None = None,
        preview: bool | None = None,
        solver: str | QPSolver = "active-set",
        scheduler: Scheduler | None = None,
        model: PredictionModel | None = None,
        estimator: str | Estimator | None = None,
        speed_floor: Annotated[Positive, "m/s"] = 1.0,
        longest_horizon: Annotated[Count, PREDICTION_HORIZON] | None = None,
        most_moves: Annotated[Count, CONTROL_HORIZON] | None = None,
    ) -> None:
        filtering = get_estimator(estimator) if isinstance(estimator, str) else estimator
        if model is None and isinstance(filtering, KalmanFilter | None):
            parts = informed_parts(
                vehicle, profile, (belief, uncertainty, learning), period, filtering, preview, computation
            )
        else:
            stated = not (profile is None and belief is None and uncertainty is None and learning in (None, AUTO))
            if stated or computation:  # the other models count no computation, so 0 agrees with them
                raise InvalidInput(
                    "MPC: profile, belief, computation, uncertainty and learning choose model and estimator: specify "
                    "either those or model and estimator."
                )
            parts = _given_parts(vehicle, model, filtering, period)
        self.tuning = parts.tuning if tuning is None else tuning
        self.model, self.estimator, self.belief = parts.model, parts.estimator, parts.belief
        self.learner, self.learns, self.late_signals = parts.learner, parts.learns, parts.late_signals
        self.vehicle, self.period = getattr(self.model, "vehicle", None), self.model.period
        self.estimator.check_fits(self.model)
        self.needs_whole_state, self.takes_late = self.estimator.function is None, self.estimator.late(self.model)
        self.position_noise = self.estimator.noise.y if isinstance(self.estimator, KalmanFilter) else 0.0
        self.is_published = isinstance(self.model, SingleTrackModel) and isinstance(self.estimator, Deadbeat)
        self.diagnostic_names = _DIAGNOSTICS if self.learner is None else (*_DIAGNOSTICS, *BELIEF_NAMES)
        self.limits = limits or parts.limits
        self.preview = parts.preview if preview is None else bool(preview)
        self.moves = moves or Moves()
        self.solver = get_qp_solver(solver) if isinstance(solver, str) else solver
        self.runs_in_kernel = isinstance(self.solver, ActiveSet | Hildreth)
        if scheduler is not None and not callable(scheduler):
            raise InvalidInput(f"MPC: scheduler = {scheduler!r}: must be callable, variables -> (Np, Nc, Q, R).")
        entries = tuple(getattr(scheduler, "entries", ENTRIES))
        if entries != ENTRIES:
            raise InvalidInput(f"MPC: the scheduler gives {', '.join(entries)}; an MPC needs {', '.join(ENTRIES)}.")
        self.scheduler = scheduler
        self._said: set[str] = set()
        self.warn_of(scheduler, None if profile is None else load_profile(profile).name)
        self.speed_floor = speed_floor
        self._set_sizes(longest_horizon, most_moves)
        self.reset()

    def _set_sizes(self, longest_horizon: int | None, most_moves: int | None) -> None:
        self.longest_horizon = max(60, self.tuning.Np) if longest_horizon is None else longest_horizon
        self.most_moves = max(20, self.tuning.Nc) if most_moves is None else most_moves
        if self.tuning.Np > self.longest_horizon or self.tuning.Nc > self.most_moves:
            raise InvalidInput(
                f"Np = {self.tuning.Np}, Nc = {self.tuning.Nc} exceed longest_horizon = {self.longest_horizon} or "
                f"most_moves = {self.most_moves}: raise those."
            )
        longest = self.model.dead_time if self.learner is None else self.learner.longest
        delay_steps = math.ceil(longest / self.period)
        self._furthest = self.longest_horizon + 1 + (delay_steps + 1 if delay_steps else 0)
        if self.moves.kind == "laguerre" and self.most_moves > self.longest_horizon:
            raise InvalidInput("most_moves must not exceed longest_horizon.")

    @property
    def first_caution(self) -> float:
        """Factor on R at the first step: what is not learned yet; 1 of a controller that does not learn."""
        return 1.0 if self.learner is None else float(memory_of(self.learner.fresh(), 0).beliefs.used_caution)

    def learned(self) -> LearnedCar:
        """Learned car parameters.

        Raises
        ------
        InvalidInput
            When the controller does not learn.
        """
        if self.learner is None:
            raise InvalidInput(
                f"learned: this MPC {self.learns or 'does not learn'}: MPC(car, learning=Learning()) does."
            )
        return self.learner.learned(self._mpc.informed.learned[0])

    @property
    def belief_in_words(self) -> str:
        """How far what is learned can be trusted after the last step, in words; empty where nothing is."""
        if self.learner is None:
            return ""
        beliefs = memory_of(self._mpc.informed.learned[0], 0).beliefs
        words = BeliefState(int(beliefs.belief_state)).words(bounded_quantity(float(beliefs.belief_at_bound)))
        return f"{words} (the steering delay has changed)" if beliefs.belief_change > 0.0 else words

    @property
    def name(self) -> str:
        """How tables call the controller."""
        moves = f"laguerre {self.moves.pole:g}" if self.moves.kind == "laguerre" else "pulse"
        scheduled = "scheduled" if self.scheduler else ""
        if self.is_published:
            return f"{scheduled or 'standard'} MPC ({moves})"
        if self.belief is not None:
            return f"{scheduled} informed MPC ({moves})".strip()
        return f"{scheduled} MPC ({self.model.name}, {self.estimator.name}, {moves})".strip()

    def __repr__(self) -> str:
        car, tuning = getattr(self.model, "vehicle", None), self.tuning
        numbers = f"{tuning.Np}/{tuning.Nc}/{tuning.Q:g}/{tuning.R:g}"
        late = f"; late signals: {self.late_signals}" if self.late_signals else ""
        belief = f"; {self.learns}{late}; steering: {self.belief}" if self.belief is not None else ""
        return f"<{self.name} of {getattr(car, 'name', 'a car')}: {numbers}, every {self.period:g} s{belief}>"

    def settings(self, longest: float = math.inf, most: float = math.inf, residuals: bool = True) -> Any:
        """Everything but model and tuning as the kernels expect it (`core.controllers.mpc.MPCSettings`).

        longest, most: horizons for which a smaller workspace is enough; residuals: whether each step computes its KKT
        residual.
        """
        solver, sweeps, tolerance = kernel.EXACT_ONLY, 1, 0.0
        if isinstance(self.solver, Hildreth):
            solver = _HILDRETH[self.solver.on_uncertified]
            sweeps, tolerance = self.solver.max_sweeps, self.solver.tolerance
        elif self.solver.on_uncertified == "apply":
            solver = kernel.HILDRETH_APPLIED  # of a back-end in Python: what is not certified steers as well
        limits = self.limits
        return kernel.settings(
            period=self.period, preview=self.preview, speed_floor=self.speed_floor,
            delay=self.model.dead_time / self.period, informed=self.estimator.function is not None,
            move_min=limits.move[0], move_max=limits.move[1], angle_min=limits.angle[0], angle_max=limits.angle[1],
            ahead=limits.ahead, output_min=limits.output[0], output_max=limits.output[1],
            output_weight=limits.output_weight, error_max=limits.error,
            laguerre=self.moves.kind == "laguerre", pole=self.moves.pole, terms=self.moves.terms,
            solver=solver, max_sweeps=sweeps, max_changes=getattr(self.solver, "max_iterations", None) or 0,
            tolerance=tolerance, residuals=residuals,
            longest_horizon=min(self.longest_horizon, _whole_horizon(longest)),
            most_moves=min(self.most_moves, _whole_horizon(most)),
        )  # fmt: skip

    def user_functions(self) -> list[Any]:
        return [self.model.function, self.estimator.function]

    def nearest_tuning(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """See `Controller.nearest_tuning`: horizons are whole, and as long as there is memory."""
        longest = min(max(round(tuning["Np"]), 1), self.longest_horizon)
        most = min(max(round(tuning["Nc"]), 1), longest, self.most_moves)
        return {**tuning, "Np": longest, "Nc": most}

    @property
    def learner_memory(self) -> Array:
        """Memory of its learner, as the kernels have it; empty where nothing is learned."""
        return np.asarray(self._mpc.informed.learned[0])

    def part(self, slots: int, room: Room | None = None, *, curved: bool = True, has_vy: bool = True) -> Any:
        return self.part_of(self.batch(slots, self.settings(*(room or Room())), curved))

    def room_for(self, tunings: Array, scheduler: CompiledScheduler | None = None) -> Room:
        longest, most = tunings[:, 0].max(initial=1), tunings[:, 1].max(initial=1)
        if scheduler is not None:
            longest, most = max(longest, scheduler.largest[0]), max(most, scheduler.largest[1])
        return Room(float(longest), float(most), residuals=False)

    @property
    def answer_columns(self) -> tuple[tuple[str, str], ...]:
        """See `Controller.answer_columns`; its answer begins with the tuning."""
        return (*product(["tuning"], self.tuning_names), *product(["diagnostics"], self.diagnostic_names))

    def checked_tunings(self, tunings: ArrayLike) -> Array:
        rows = super().checked_tunings(tunings)
        if (rows[:, 2] < 0.0).any() or (rows[:, 3] <= 0.0).any():
            raise InvalidInput("tunings: every Q must be >= 0 and every R > 0.")
        return rows

    def part_with_learned(self, room: Room) -> Any:
        """See `Controller.part_with_learned`; the road ahead is seen further where a longer lag may be learned."""
        longer = 0
        if self.learner is not None and room.longest < math.inf:
            longer = math.ceil((self.learner.limits.lag[1] - self.learner.ranges.lag[0]) / self.period)
        mpc = self.batch(1, self.settings(room.longest + longer, room.most, room.residuals), curved=True)
        if self.learner is not None:
            learned = self.learner.restart_memory(self.learner_memory)
            mpc.informed.fresh[:] = learned
            mpc.informed.learned[0] = learned
        return self.part_of(mpc)

    def part_of(self, mpc: Any) -> Any:
        """A part of compiled loops around the record of a batch.

        Raises
        ------
        InvalidInput
            When the QP solver is Python.
        """
        if not self.runs_in_kernel:
            raise InvalidInput(f"QP solver {self.solver.name!r} of {self.name!r} is not compiled: use 'active-set'.")
        return mpc_controller(self, mpc)

    def batch(self, slots: int, settings: Any, curved: bool = False) -> Any:
        """Fresh compiled controllers for `slots` runs, on curved roads or not (`core.controllers.mpc.Mpc`)."""
        model, estimator = self.model, self.estimator
        return kernel.batch(
            slots, settings, (model.parameters(), model.measured_places(), self._turning()),
            (estimator.parameters(model), estimator.memory_size(model)), curved,
            None if self.learner is None else (self.learner.parameters(), self.learner.fresh()),
        )  # fmt: skip

    def _turning(self) -> Array:
        """Rows that compute the moves on a curved road, `core.models.path.Turning`; or (0,)."""
        parameters = self.model.turning()
        return np.concatenate([parameters, self.estimator.tyres]) if parameters.size else parameters

    def reset(self) -> None:
        self._mpc = self.batch(1, self.settings())
        self._requested = self.tuning.as_array()
        self._plan = self.scheduler.plan(1) if isinstance(self.scheduler, CompiledScheduler) else None
        self._variables = np.zeros(len(VARIABLE_NAMES))
        self._speed, self._without_speed = math.nan, 0
        self._raised = 0
        self._load()

    def packed_tuning(self) -> Array:
        """(4,) Np, Nc, Q, R."""
        return self.tuning.as_array()

    def with_tuning(self, tuning: Mapping[str, float]) -> Self:
        """See `Controller.with_tuning`; the horizons are rounded, and a scheduler has nothing to say any more."""
        entries = self._entries(tuning)
        constant = Tuning.of(entries[name] for name in ENTRIES)
        controller = copy.copy(self)
        controller.scheduler, controller.tuning = None, constant
        controller._set_sizes(max(self.longest_horizon, constant.Np), max(self.most_moves, constant.Nc))
        controller.reset()
        return controller

    def restart(self) -> None:
        """Forget the past, but not what has been learned of the car: for another drive of it."""
        before = self._mpc.informed.learned
        self.reset()
        if self.learner is not None:
            self._mpc.informed.learned[:] = self.learner.restart_memory(before[0])

    def _load(self) -> None:
        """Restore the parts that a copy lacks: the lock, addresses, compiled functions."""
        self._lock = threading.Lock()
        self._measured, answer = self._mpc.measured, self._mpc.answer[0]
        self._answer, self._learned = answer[:_ANSWER], answer[_ANSWER:]
        self._state = KernelInput("state", self._measured, _STATE_SIZES)
        self._known = 0  # of the state, in the last step
        self._reference = KernelInput("reference", np.zeros(self._furthest))
        self._now: Any = np.zeros(2).data  # `core.controllers.mpc_step.STEP_INPUT`
        self._curved = bool(self._mpc.settings.curved)
        self._resident = Resident(self._mpc)
        self._resident_plan = None if self._plan is None else Resident(self._plan)
        self._step: Callable[[], None] | None = None
        self._own_part: Any = None

    def __getstate__(self) -> dict[str, Any]:
        state = self.__dict__.copy()
        for name in _NOT_CARRIED:
            state.pop(name, None)
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._load()

    def __copy__(self) -> Self:
        """A controller of its own: memories are never shared."""
        return copy.deepcopy(self)

    def mismatches(self, scheduler: Any, profile: str | None = None, plant: Any = None) -> list[str]:
        """Differences between the scheduler's scope and this controller, see `compatibility.mismatches`.

        profile: its name; plant: what is driven, whose car may be another than the controller's.
        """
        made_for = getattr(scheduler, "made_for", None)
        return mismatches(made_for, self.kind_of_model, car_of(self.model), profile, car_of(plant))

    def warn_of(self, scheduler: Any, profile: str | None = None, plant: Any = None) -> None:
        """Log what a scheduler was made for and does not find here, each once per controller."""
        for mismatch in self.mismatches(scheduler, profile, plant):
            sentence = f"scheduler {getattr(scheduler, 'name', '')!r} {mismatch}"
            if sentence not in self._said:
                self._said.add(sentence)
                _log.warning("adaptrack: %s.", sentence)

    @property
    def kind_of_model(self) -> str:
        """Name of the model and estimator in a scheduler's file."""
        return INCREMENTAL if self.is_published else f"{self.model.name}, {self.estimator.name}"

    @property
    def scheduler_counts(self) -> dict[str, int]:
        """Counters of the scheduler since the last reset, by name, see `core.scheduling.guard.COUNTS`.

        ``raised``: steps at which a scheduler in Python raised an error or answered what is no tuning; the tuning
        before was kept.
        """
        if self._plan is None:
            return {"raised": self._raised} if self.scheduler is not None else {}
        return {name: int(self._plan.memory[0][name]) for name in COUNTS}

    @property
    def left_out(self) -> str | None:
        """The sensor that the estimator leaves out at present because it disagrees with all others; None: none."""
        return self.estimator.left_out(self._mpc.informed.estimates[0])

    @property
    def angle(self) -> float:
        """The last command (rad)."""
        return float(self._mpc.memory[0].command)

    def applied(self, angle: float) -> None:
        self._mpc.memory["command"][0] = wheel_angle("applied: angle", angle)

    def change_path(self, heading: float, offset: float) -> None:
        """Say that another path lies under the car, by how much (rad, m) heading and offset have grown against it.

        What the estimator has learned of the car stays; one that cannot move it begins anew.

        Raises
        ------
        InvalidInput
            When a number is not finite, or so large that `restart` is due.
        """
        turned, shifted = change_of_path(heading, offset)
        mpc = self._mpc
        for i, name in enumerate(self.model.states):
            mpc.previous[0, i] += {"yaw": turned, "y": shifted}.get(name, 0.0)
        if mpc.memory["started"][0]:
            self.estimator.change_path(self.model, mpc.informed.estimates[0], turned, shifted)

    @property
    def _delay(self) -> float:
        """Periods from an instant until its command begins to act, as believed at present."""
        if self.learner is None:
            return self.model.dead_time / self.period
        return self.learner.delay(self._mpc.informed.learned[0])

    def predicted_output(self) -> tuple[Array, Array]:
        """Times (Np,) s from now and y (Np,) m that the last step predicts for them, with its plan of moves.

        On a curved road y counts from the tangent at the car's foot.
        """
        y = np.zeros(int(self._mpc.memory[0].Np))
        predict_outputs(0, self._resident, y)
        return np.asarray((np.arange(y.size) + 1.0) * self.period + self._delay * self.period), y

    def predicted_path(self, ahead: RoadAhead) -> Array:
        points, roads = np.zeros(2 * self.longest_horizon), stacked(ahead.road)
        count, _ = predict_path(0, ahead.station, ahead.speeds, 0, roads, self._resident, points)
        return points[: 2 * count].reshape(-1, 2)

    def step(
        self,
        state: ArrayLike,
        speed: float,
        reference: ArrayLike,
        variables: Sequence[float] | None = None,
        road: RoadAhead | None = None,
    ) -> MPCCommand:
        """One control step.

        state: what is measured, x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]; for a model or an estimator
        that uses them also the wheel angle (rad), the lateral acceleration (m/s^2), the age of yaw and y (s) and that
        of all others, by how much (rad) the path has turned at the car's foot since the last step, and the friction
        that may be assumed at least (0: unknown); speed: v_x (m/s); reference: y_ref (m) now and, for preview, at the
        instants that follow (the last value is repeated as needed); variables: what the scheduler looks at
        (`SchedulingVariables`), needed when there is one; road: a curved one from the car's foot on, against which yaw,
        y and y_ref then count.

        While the speed is missing (not finite, or masked) the last one counts, for 6 s (`SPEED_KEPT`). A state,
        reference or speed that is not known gives no exception but a command that holds the previous angle, its status
        saying why: a controller in a running vehicle must answer. So does a scheduler that raises an
        error or answers what is no tuning: the tuning before is kept, the step counted, and a warning logged once.

        Raises
        ------
        InvalidInput
            When an argument is not made of numbers or has a wrong shape, when the scheduler has nothing to look at, or
            when another thread is in a step of this controller.
        """
        if not self._lock.acquire(False):
            raise InvalidInput("this MPC is in a step of another thread: each vehicle needs a controller of its own.")
        try:
            self._take(state, speed, reference, variables, road)
            (self._step or self._compiled_step())()
            return self._command()
        finally:
            self._lock.release()

    def _compiled_step(self) -> Callable[[], None]:
        """The step behind the arguments, compiled on first use."""
        if self.runs_in_kernel:
            record = MPCStep(self._mpc, self.functions, np.asarray(self._now), self._reference.values, self._requested)
            self._step = direct(step, record)
        else:
            self._step = self._step_through
        return self._step

    def problem(
        self,
        state: ArrayLike,
        speed: float,
        reference: ArrayLike,
        variables: Sequence[float] | None = None,
        road: RoadAhead | None = None,
    ) -> QP:
        """The QP that `step` would solve with these arguments; the controller stays as it is.

        A scheduler in Python stays as it is, too, if it can be copied; one that cannot is called as it is.
        """
        twin = self._twin()
        twin._take(state, speed, reference, variables, road)
        _, n, m = twin._form()
        return twin._qp(n, m)

    def solved_problem(self) -> tuple[QP, Array]:
        """The QP of the last step, which was solved at a speed above standstill, and its solution x (n,)."""
        memory, ws = self._mpc.memory[0], self._mpc.ws
        limited = any(map(math.isfinite, self.limits.output))
        n = int(memory.planned) + limited
        qp = self._qp(n, 4 * int(memory.Nc) + (2 * int(memory.Np) if limited else 0))
        return qp, ws.solution[:n].copy()

    def _twin(self) -> Self:
        """A controller in the same state, to form a QP with; what that does not change is shared."""
        state = self.__getstate__()
        state |= copy.deepcopy({name: state[name] for name in ("_mpc", "_requested", "_plan", "_variables")})
        if self._plan is None:
            with suppress(Exception):  # it may hold a lock, a file, a connection
                state["scheduler"] = copy.deepcopy(self.scheduler)
        twin = object.__new__(type(self))
        twin.__setstate__(state)
        return twin

    def _take(
        self,
        state: ArrayLike,
        speed: float,
        reference: ArrayLike,
        variables: Sequence[float] | None,
        road: RoadAhead | None,
    ) -> None:
        """Take in what a step is given; the reference and the speed as the kernels want them."""
        n_states, inputs = self._state.take(state), self._now
        inputs[1] = self._reference.take(reference)
        if type(speed) is not float:
            speed = number("speed", speed)
        if isfinite(speed):
            self._speed, self._without_speed = speed, 0
        else:  # the last speed counts for some time
            self._without_speed += 1
            speed = self._speed if self._without_speed * self.period <= SPEED_KEPT else math.nan
        inputs[0] = speed
        if n_states != self._known:
            self._measured[n_states:] = NOTHING_MEASURED[n_states:]
            self._known = n_states
        if road is not None or self._curved:
            self._look_along(road_ahead(road), speed)
        if self.scheduler is not None:
            self._schedule(variables)

    def _look_along(self, road: RoadAhead | None, speed: float) -> None:
        """Take in the road ahead."""
        self._see_curves()
        bend = self._mpc.bend
        bend[:] = 0.0
        if road is not None and math.isfinite(speed):
            bend[:] = road.bend(bend.size, max(speed, self.speed_floor), self._delay, self.period)

    def _see_curves(self) -> None:
        """Make room for the road ahead."""
        if not self._curved:
            self._mpc, self._curved = kernel.on_curved_roads(self._mpc), True
            self._resident, self._step = Resident(self._mpc), None

    @property
    def own_part(self) -> Any:
        """The controller itself as a part of compiled loops, its memory shared; None where its QP solver is Python."""
        if self._own_part is None and self.runs_in_kernel:
            self._see_curves()
            self._own_part = self.part_of(self._mpc)._replace(tuning=self._requested[None])
        return self._own_part

    def _schedule(self, variables: Sequence[float] | None) -> None:
        """Let the scheduler choose the tuning."""
        if variables is None:
            raise InvalidInput("this MPC has a scheduler: step(..., variables=SchedulingVariables(...)) is needed.")
        if self._resident_plan is None:
            self._ask(variables)
            return
        numbers, values = self._variable_numbers(variables), self._variables
        if numbers.size < values.size:
            values[numbers.size :] = 0.0
        values[: numbers.size] = numbers
        schedule(0, values, self._resident_plan, self._requested)

    def _variable_numbers(self, variables: Sequence[float]) -> Array:
        """The variables as numbers; the last three may be left out."""
        count = self._variables.size
        try:
            return vector("variables", variables, (count - 3, count - 2, count - 1, count))
        except InvalidInput as error:
            raise InvalidInput(
                f"variables: need {count} numbers, {', '.join(VARIABLE_NAMES)}; the last three may be left out."
            ) from error

    def _ask(self, variables: Sequence[float]) -> None:
        """Ask a scheduler in Python; what is no tuning leaves the one before."""
        scheduler: Any = self.scheduler
        name = getattr(scheduler, "name", None) or getattr(scheduler, "__name__", type(scheduler).__name__)
        call = PluginCall(f"scheduler {name!r}", "a Tuning or four finite numbers (Np, Nc, Q, R)")
        try:
            answer = call(scheduler, variables)
            try:
                self._requested[:] = read_tuning(answer)
            except InvalidInput:
                raise call.refusal(answer) from None
        except Exception as error:
            self._raised += 1
            if self._raised == 1:
                _log.warning(
                    "adaptrack: the scheduler failed, its last tuning is kept: %s: %s", type(error).__name__, error
                )

    @cached_property
    def functions(self) -> Any:
        """Functions that the kernels call for this controller (`core.controllers.mpc.Functions`)."""
        return kernel.functions(discretise=self.model.function, estimate=self.estimator.function)

    def _form(self) -> tuple[int, int, int]:
        speed, count = self._now.tolist()
        ahead = self._reference.values[: int(count)]
        sizes: tuple[int, int, int] = form_qp(0, speed, ahead, self._requested, self._resident, self.functions)
        return sizes

    def _qp(self, n: int, m: int) -> QP:
        ws = self._mpc.ws
        return QP(
            E=ws.hessian[0, :n, :n].copy(),
            K=ws.gradient[:n].copy(),
            M=ws.rows[0, :n, :m].T.copy(),
            gamma=ws.bounds[:m].copy(),
        )

    def _step_through(self) -> None:
        """A step whose QP goes to a back-end in Python; the rest is the kernels' work all the same."""
        ws = self._mpc.ws
        status, n, m = self._form()
        iterations = 0
        if not (np.isfinite(ws.gradient[:n]).all() and np.isfinite(ws.hessian[0, :n, :n]).all()):
            status = QPStatus.NON_FINITE
        if status == QPStatus.SOLVED:
            call = PluginCall(f"QP solver {self.solver.name!r}: solve()", "a Solution")
            solution = call(self.solver.solve, self._qp(n, m))
            if not isinstance(solution, Solution):
                raise call.refusal(solution)
            status, iterations = solution.status, solution.iterations
            ws.solution[:n] = solution.x
            ws.multipliers[:m] = solution.lam
        apply_move(0, int(status), iterations, n, m, self._resident)

    def _command(self) -> MPCCommand:
        angle, move, is_held, Np, Nc, Q, R, status, iterations, residual, at_limit, reckoned = self._answer.tolist()
        learned = () if self.learner is None else tuple(self._learned.tolist())
        fields = (
            angle, move, is_held > 0.5, (Np, Nc, Q, R), _STATUSES[status], int(iterations), residual,
            _AT_LIMIT[at_limit], reckoned, learned,
        )  # fmt: skip
        return _new(MPCCommand, fields)

    def describe(self) -> dict[str, Any]:
        """The controller's configuration, for provenance."""
        return {
            "tuning": asdict(self.tuning),
            "period": self.period,
            "limits": {
                "move": list(self.limits.move),
                "angle": list(self.limits.angle),
                "output": [repr(value) for value in self.limits.output],
                **({"ahead": self.limits.ahead} if self.limits.ahead > 0.0 else {}),
                **({"error": self.limits.error} if self.limits.error < math.inf else {}),
            },
            "moves": {"kind": self.moves.kind, "pole": self.moves.pole, "terms": self.moves.terms}
            if self.moves.kind == "laguerre"
            else {"kind": "pulse"},
            "preview": self.preview,
            "solver": self.solver.name,
            "model": self.model.name,
            "estimator": self.estimator.name,
            "belief": None if self.belief is None else str(self.belief),
            "learning": self.learns or None,
            "speed_floor": self.speed_floor,
            "scheduler": None
            if self.scheduler is None
            else getattr(self.scheduler, "name", type(self.scheduler).__name__),
        }
