"""The incremental linear MPC of the paper's section II-B: a tuning, limits, a way to parametrise moves, a QP solver.

Its numbers (Np, Nc, Q, R) may change at every step, nothing is rebuilt or allocated for it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.errors import InvalidInput, real, whole
from adaptrack.limits import CONTROL_HORIZON, LAGUERRE_TERMS, PREDICTION_HORIZON, check_limit
from adaptrack.prediction import PredictionModel
from adaptrack.qp import QP, QPSolver, QPStatus, get_qp_solver
from adaptrack.qp.active_set import ActiveSet
from adaptrack.qp.hildreth import Hildreth
from adaptrack.vehicle import Vehicle

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tuning:
    """Horizons and weights of the MPC; the defaults are the paper's table.

    Raises
    ------
    InvalidInput
        Unless 1 <= Nc <= Np are integers, Q >= 0 and R > 0 are finite.
    """

    Np: int = 35
    """prediction horizon (control periods)"""
    Nc: int = 8
    """control horizon (control periods)"""
    Q: float = 10.0
    """1/m^2, weight of the tracking error"""
    R: float = 0.01
    """1/rad^2, weight of the moves; only R/Q changes the control law"""

    def __post_init__(self) -> None:
        for name in ("Np", "Nc"):
            object.__setattr__(self, name, whole("Tuning", name, getattr(self, name)))
        for name in ("Q", "R"):
            object.__setattr__(self, name, real("Tuning", name, getattr(self, name)))
        check_limit("Tuning: Np", self.Np, PREDICTION_HORIZON)
        check_limit("Tuning: Nc", self.Nc, CONTROL_HORIZON)
        if self.Nc > self.Np:
            raise InvalidInput(f"Tuning: Nc = {self.Nc} > Np = {self.Np}: the control horizon must not be longer.")
        if not 0.0 <= self.Q < math.inf:
            raise InvalidInput(f"Tuning: Q = {self.Q!r}: must be finite and not negative.")
        if not 0.0 < self.R < math.inf:
            raise InvalidInput(f"Tuning: R = {self.R!r}: must be finite and positive (the QP is not convex else).")

    def as_array(self) -> Array:
        """[Np, Nc, Q, R] as floats."""
        return np.array([self.Np, self.Nc, self.Q, self.R], dtype=float)


@dataclass(frozen=True)
class Limits:
    """Bounds (low, high) of eqs. (13)-(15); the defaults are the paper's table.

    Raises
    ------
    InvalidInput
        When a pair is not low <= high, a move or an angle of 0 is not allowed, or the price is not positive: limits
        that contain 0 always leave a feasible move.
    """

    move: tuple[float, float] = (-math.pi / 12, math.pi / 12)
    """rad per control period, eq. (13)"""
    angle: tuple[float, float] = (-math.pi / 6, math.pi / 6)
    """rad, eq. (14)"""
    output: tuple[float, float] = (-math.inf, math.inf)
    """m, eq. (15); soft: one slack variable, its square priced, so that the QP stays feasible"""
    output_price: float = 1e4
    """1/m^2, price of the squared violation of `output`"""

    def __post_init__(self) -> None:
        for name, unit in (("move", "rad"), ("angle", "rad"), ("output", "m")):
            pair = getattr(self, name)
            if not isinstance(pair, Sequence) or isinstance(pair, str) or len(pair) != 2:
                raise InvalidInput(f"Limits: {name} = {pair!r}: must be a pair (low, high) in {unit}.")
            low, high = (real("Limits", name, value) for value in pair)
            if not low <= high:
                raise InvalidInput(f"Limits: {name} = ({low!r}, {high!r}) {unit}: need low <= high, none of them NaN.")
            if name != "output" and not (low <= 0.0 <= high and math.isfinite(low) and math.isfinite(high)):
                raise InvalidInput(
                    f"Limits: {name} = ({low!r}, {high!r}) {unit}: must be finite and contain 0, "
                    "or some step has no feasible move."
                )
        if not 0.0 < real("Limits", "output_price", self.output_price) < math.inf:
            raise InvalidInput(f"Limits: output_price = {self.output_price!r}: must be finite and positive.")


@dataclass(frozen=True)
class Moves:
    """How the sequence of moves is parametrised: dU = L eta.

    "pulse": L = identity, eq. (10): Nc free moves, then none. "laguerre": L = the first `terms` discrete Laguerre
    functions with `pole`, over the whole prediction horizon, as in the authors' published controller; R then weighs
    the coefficients eta and Nc is the number of samples on which the limits are imposed.

    Raises
    ------
    InvalidInput
        For an unknown kind, a pole outside [0, 1), or no terms.
    """

    kind: str = "pulse"
    pole: float = 0.95
    terms: int = 10

    def __post_init__(self) -> None:
        if self.kind not in ("pulse", "laguerre"):
            raise InvalidInput(f"Moves: kind = {self.kind!r}: must be 'pulse' or 'laguerre'.")
        if not 0.0 <= real("Moves", "pole", self.pole) < 1.0:
            raise InvalidInput(f"Moves: pole = {self.pole!r}: must be in [0, 1).")
        check_limit("Moves: terms", whole("Moves", "terms", self.terms), LAGUERRE_TERMS)

    @classmethod
    def pulses(cls) -> Self:
        """Free moves, eq. (10)."""
        return cls("pulse")

    @classmethod
    def laguerre(cls, pole: float = 0.95, terms: int = 10) -> Self:
        """Laguerre functions."""
        return cls("laguerre", pole, terms)


class Condition(NamedTuple):
    """What a scheduler may look at at one control instant: the paper's four inputs, and the demand of the road ahead.

    `demand` computes `change` and `acceleration` from a planned reference.
    """

    speed: float
    """m/s, v_x"""
    y_ref: float
    """m, lateral reference now"""
    friction: float
    """mean of the four wheels"""
    wind: float
    """m/s, v_w: velocity of the air along +Y"""
    change: float = 0.0
    """m, largest |y_ref(t + s) - y_ref(t)| over the next `LOOK_AHEAD` seconds s"""
    acceleration: float = 0.0
    """m/s^2, largest |second derivative of y_ref| over the same stretch"""
    offset: float = 0.0
    """m, y_ref - y"""


LOOK_AHEAD = 3.0
"""s, how far ahead the demand of the road is looked for."""


def demand(reference: ArrayLike, period: float, instants: int = 1) -> tuple[Array, Array]:
    """`Condition.change` (m) and `Condition.acceleration` (m/s^2), each (instants,), at the first control instants.

    reference: y_ref (m) at the instants, one `period` (s) apart; beyond its end it goes straight on.
    """
    y = np.asarray(reference, dtype=float)
    ahead = max(2, round(LOOK_AHEAD / period))
    y = y[: instants + ahead]
    slope = y[-1] - y[-2] if len(y) > 1 else 0.0
    y = np.concatenate([y, y[-1] + slope * np.arange(1, instants + ahead - len(y) + 1)])
    windows = np.lib.stride_tricks.sliding_window_view(y, ahead + 1)
    change = np.abs(windows[:, 1:] - windows[:, :1]).max(axis=1)
    bend = np.abs(np.diff(y, 2)) / period**2
    acceleration = np.lib.stride_tricks.sliding_window_view(bend, ahead - 1).max(axis=1)
    return change[:instants], acceleration[:instants]


@runtime_checkable
class Scheduler(Protocol):
    """Chooses the tuning for a condition. The horizons it gives may be real numbers: they are rounded and clamped."""

    def __call__(self, condition: Condition) -> Tuning | tuple[float, float, float, float]:
        """(Np, Nc, Q, R) for `condition`."""


@runtime_checkable
class CompiledScheduler(Scheduler, Protocol):
    """A scheduler that compiled runs can ask, see `kernels.inference`."""

    def plan(self, lanes: int) -> Any:
        """The packed scheduler with a fresh memory for `lanes` runs."""

    @property
    def largest(self) -> tuple[int, int]:
        """The longest Np and Nc that it can ask for."""


class Command(NamedTuple):
    """What one step of the MPC gives."""

    angle: float
    """rad, steering angle to apply, u(k)"""
    move: float
    """rad, u(k) - u(k-1)"""
    status: QPStatus
    """of the QP"""
    iterations: int
    """of the QP solver"""
    residual: float
    """largest KKT residual of the solution, see `qp.kkt_residuals`; NaN when there is none"""
    at_limit: int
    """sum of 1 (move), 2 (angle), 4 (output)"""
    held: bool
    """no usable solution: the previous angle is held"""
    tuning: tuple[float, float, float, float]
    """Np, Nc, Q, R as used: rounded and clamped"""


class Controller(Protocol):
    """What `simulate` drives with; `MPC` is one."""

    @property
    def name(self) -> str:
        """How tables call it."""

    @property
    def period(self) -> float:
        """Control period (s)."""

    def reset(self) -> None:
        """Forget the past."""

    def step(self, state: ArrayLike, speed: float, reference: ArrayLike, condition: Condition | None = None) -> Command:
        """One control step, see `MPC.step`."""

    def describe(self) -> dict[str, Any]:
        """The configuration, for provenance."""


class MPC:
    """Linear MPC with re-discretisation at every step, eqs. (8)-(17).

    vehicle: parameters of the prediction model; tuning: constant one, or the one before the scheduler speaks;
    period: control period (s); preview: whether R_s holds the reference ahead or its present value; solver:
    "active-set" (exact), "hildreth" (the paper's; when not converged, what `Hildreth.on_uncertified` says), the name
    of another registered QP solver, or a `QPSolver`; speed_floor: m/s, the model is never formed below it (A_c is
    singular at standstill); longest_horizon, most_moves: largest Np and Nc that a scheduler may ask for.

    Raises
    ------
    InvalidInput
        For arguments that make no controller: the message says which.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        tuning: Tuning | None = None,
        *,
        period: float = 0.1,
        limits: Limits | None = None,
        moves: Moves | None = None,
        preview: bool = False,
        solver: str | QPSolver = "active-set",
        scheduler: Scheduler | None = None,
        speed_floor: float = 1.0,
        longest_horizon: int | None = None,
        most_moves: int | None = None,
    ) -> None:
        self.tuning = Tuning() if tuning is None else tuning
        if not isinstance(self.tuning, Tuning):
            raise InvalidInput(f"MPC: tuning = {tuning!r}: must be a Tuning(Np, Nc, Q, R).")
        self.model = PredictionModel(vehicle, period)
        self.limits = limits or Limits()
        self.moves = moves or Moves()
        self.preview = bool(preview)
        self.solver = get_qp_solver(solver) if isinstance(solver, str) else solver
        if not isinstance(self.solver, QPSolver):
            raise InvalidInput(f"MPC: solver = {solver!r}: must be the name of a QP solver or a QPSolver.")
        if scheduler is not None and not callable(scheduler):
            raise InvalidInput(f"MPC: scheduler = {scheduler!r}: must be callable, condition -> (Np, Nc, Q, R).")
        self.scheduler = scheduler
        if not 0.0 < real("MPC", "speed_floor", speed_floor) < math.inf:
            raise InvalidInput(f"speed_floor = {speed_floor!r} m/s: must be positive and finite.")
        self.speed_floor = float(speed_floor)
        longest_horizon = max(60, self.tuning.Np) if longest_horizon is None else longest_horizon
        most_moves = max(20, self.tuning.Nc) if most_moves is None else most_moves
        self.longest_horizon = whole("MPC", "longest_horizon", longest_horizon)
        self.most_moves = whole("MPC", "most_moves", most_moves)
        check_limit("MPC: longest_horizon", self.longest_horizon, PREDICTION_HORIZON)
        check_limit("MPC: most_moves", self.most_moves, CONTROL_HORIZON)
        if self.tuning.Np > self.longest_horizon or self.tuning.Nc > self.most_moves:
            raise InvalidInput(
                f"Np = {self.tuning.Np}, Nc = {self.tuning.Nc} exceed longest_horizon = {self.longest_horizon} or "
                f"most_moves = {self.most_moves}: raise those."
            )
        if self.moves.kind == "laguerre" and self.most_moves > self.longest_horizon:
            raise InvalidInput("most_moves must not exceed longest_horizon.")
        self.reset()

    @property
    def period(self) -> float:
        """Control period (s)."""
        return self.model.period

    @property
    def name(self) -> str:
        """How tables call the controller."""
        moves = f"laguerre {self.moves.pole:g}" if self.moves.kind == "laguerre" else "pulse"
        return f"{'scheduled' if self.scheduler else 'standard'} MPC ({moves})"

    def settings(self) -> Array:
        """Everything but model and tuning as the kernels expect it (`kernels.loop.MPC_SETTINGS`)."""
        from adaptrack.kernels import loop

        solver, sweeps, tolerance = loop.ACTIVE_SET, 1, 0.0
        if isinstance(self.solver, Hildreth):
            solver = {
                "exact": loop.HILDRETH_THEN_EXACT,
                "apply": loop.HILDRETH_APPLIED,
                "hold": loop.HILDRETH_OR_HOLD,
            }[self.solver.on_uncertified]
            sweeps, tolerance = self.solver.max_sweeps, self.solver.tolerance
        values = {
            "period": self.period,
            "move_min": self.limits.move[0],
            "move_max": self.limits.move[1],
            "angle_min": self.limits.angle[0],
            "angle_max": self.limits.angle[1],
            "output_min": self.limits.output[0],
            "output_max": self.limits.output[1],
            "output_price": self.limits.output_price,
            "laguerre": self.moves.kind == "laguerre",
            "pole": self.moves.pole,
            "terms": self.moves.terms,
            "preview": self.preview,
            "speed_floor": self.speed_floor,
            "solver": solver,
            "max_sweeps": sweeps,
            "tolerance": tolerance,
            "residuals": True,
            "longest_horizon": self.longest_horizon,
            "most_moves": self.most_moves,
        }
        return np.array([values[name] for name in loop.MPC_SETTINGS], dtype=float)

    @property
    def in_kernel(self) -> bool:
        """Whether the kernels solve the QP, rather than a back-end called from Python."""
        return isinstance(self.solver, ActiveSet | Hildreth)

    def reset(self) -> None:
        """Forget the past: the next step is the first, from steering angle 0."""
        from adaptrack.kernels import inference, loop

        self._loop, self._inference = loop, inference
        self._settings = self.settings()
        self._packed = self.model.packed()
        self._workspace = loop.workspace(1, self._settings)
        self._memory = loop.memory(1)
        self._record = np.zeros((1, len(loop.RECORD)))
        self._asked = self.tuning.as_array()
        self._plan = self.scheduler.plan(1) if isinstance(self.scheduler, CompiledScheduler) else None
        self._look = np.zeros(len(Condition._fields))

    @property
    def scheduler_counts(self) -> dict[str, int]:
        """What a compiled scheduler has counted since the last reset, by name; see `kernels.inference.COUNTS`."""
        if self._plan is None:
            return {}
        return {name: int(self._plan.state[0, i]) for i, name in enumerate(self._inference.COUNTS)}

    @property
    def angle(self) -> float:
        """The last command (rad)."""
        return float(self._memory[0, self._loop.ANGLE])

    def step(self, state: ArrayLike, speed: float, reference: ArrayLike, condition: Condition | None = None) -> Command:
        """One control step.

        state: measured x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]; speed: v_x (m/s); reference: y_ref (m)
        now and, for preview, at the instants that follow (the last value is repeated as needed); condition: what the
        scheduler is given, needed when there is one.

        A state or reference that is not finite gives no exception but a command that holds the previous angle, its
        status saying why: a controller in a running vehicle must answer.

        Raises
        ------
        InvalidInput
            When an argument has a wrong shape, or the scheduler has no condition to look at.
        """
        measured = _row(state, 4, "state")
        ahead = _ahead(reference)
        if self.scheduler is not None:
            if condition is None:
                raise InvalidInput("this MPC has a scheduler: step(..., condition=Condition(...)) is needed.")
            if self._plan is None:
                self._asked[:] = astuple(self.scheduler(condition))
            else:
                self._look[: len(condition)] = condition
                self._inference.schedule(0, self._look, self._plan, self._asked)
        self._workspace.measured[:] = measured
        if self.in_kernel:
            self._loop.mpc_step(
                0, float(speed), ahead, self._asked, self._packed, self._settings, self._memory, self._record,
                self._workspace,
            )  # fmt: skip
        else:
            self._step_through(float(speed), ahead)
        return self._command()

    def problem(self, state: ArrayLike, speed: float, reference: ArrayLike) -> QP:
        """The QP that the next `step` would solve with these arguments; the controller stays as it is."""
        self._workspace.measured[:] = _row(state, 4, "state")
        ahead = _ahead(reference)
        _, n, m = self._form(float(speed), ahead)
        return self._qp(n, m)

    def _form(self, speed: float, ahead: Array) -> tuple[int, int, int]:
        return self._loop.form_qp(
            0, speed, ahead, self._asked, self._packed, self._settings, self._memory, self._record, self._workspace
        )

    def _qp(self, n: int, m: int) -> QP:
        ws = self._workspace
        return QP(
            E=ws.hessian[0, :n, :n].copy(),
            K=ws.gradient[:n].copy(),
            M=ws.rows[0, :n, :m].T.copy(),
            gamma=ws.bounds[:m].copy(),
        )

    def _step_through(self, speed: float, ahead: Array) -> None:
        """A step whose QP goes to a back-end in Python; the rest is the kernels' work all the same."""
        ws = self._workspace
        status, n, m = self._form(speed, ahead)
        iterations = 0
        if not (np.isfinite(ws.gradient[:n]).all() and np.isfinite(ws.hessian[0, :n, :n]).all()):
            status = QPStatus.NON_FINITE
        if status == QPStatus.SOLVED:
            solution = self.solver.solve(self._qp(n, m))
            status, iterations = solution.status, solution.iterations
            ws.solution[:n] = solution.x
            ws.multipliers[:m] = solution.lam
        self._loop.apply_move(0, int(status), iterations, n, m, self._settings, self._memory, self._record, ws)

    def _command(self) -> Command:
        angle, move, status, iterations, residual, at_limit, held, Np, Nc, Q, R = self._record[0].tolist()
        return Command(
            angle, move, QPStatus(int(status)), int(iterations), residual, int(at_limit), held > 0.5, (Np, Nc, Q, R)
        )

    def describe(self) -> dict[str, Any]:
        """The controller's configuration, for provenance."""
        return {
            "tuning": {"Np": self.tuning.Np, "Nc": self.tuning.Nc, "Q": self.tuning.Q, "R": self.tuning.R},
            "period": self.period,
            "limits": {
                "move": list(self.limits.move),
                "angle": list(self.limits.angle),
                "output": [repr(value) for value in self.limits.output],
            },
            "moves": {"kind": self.moves.kind, "pole": self.moves.pole, "terms": self.moves.terms}
            if self.moves.kind == "laguerre"
            else {"kind": "pulse"},
            "preview": self.preview,
            "solver": self.solver.name,
            "speed_floor": self.speed_floor,
            "scheduler": None
            if self.scheduler is None
            else getattr(self.scheduler, "name", type(self.scheduler).__name__),
        }


def astuple(tuning: Tuning | tuple[float, float, float, float]) -> tuple[float, float, float, float]:
    """(Np, Nc, Q, R) of what a scheduler returned."""
    if isinstance(tuning, Tuning):
        return float(tuning.Np), float(tuning.Nc), tuning.Q, tuning.R
    try:
        Np, Nc, Q, R = tuning
    except (TypeError, ValueError):
        raise InvalidInput(f"scheduler: returned {tuning!r}: must be a Tuning or four numbers Np, Nc, Q, R.") from None
    return (
        real("scheduler", "Np", Np),
        real("scheduler", "Nc", Nc),
        real("scheduler", "Q", Q),
        real("scheduler", "R", R),
    )


def _ahead(reference: ArrayLike) -> Array:
    try:
        ahead = np.ascontiguousarray(reference, dtype=np.float64).reshape(-1)
    except (TypeError, ValueError):
        raise InvalidInput(f"reference = {reference!r}: must be numbers (m).") from None
    if ahead.size == 0:
        raise InvalidInput("reference: empty; give at least its present value.")
    return ahead


def _row(values: ArrayLike, size: int, name: str) -> Array:
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InvalidInput(f"{name} = {values!r}: must be {size} numbers.") from None
    if array.shape != (size,):
        raise InvalidInput(f"{name}: shape {array.shape}, expected ({size},).")
    return array
