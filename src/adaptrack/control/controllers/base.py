"""What a controller is, and the compiled ones: one law of `core.controllers.contract` with its numbers."""

from __future__ import annotations

import copy
import inspect
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from itertools import product
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from adaptrack.base.checked import Positive, checked, real
from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import PluginCall
from adaptrack.control.controllers.inputs import change_of_path, number, road_ahead, vector, wheel_angle
from adaptrack.control.controllers.limits import Limits, LimitsArgument
from adaptrack.core.controllers.law import law_controller, step_law
from adaptrack.core.controllers.part import COMMON_ANSWER, controller_part
from adaptrack.core.estimators.learning import BELIEF_NAMES
from adaptrack.core.kernel import Resident, row_of
from adaptrack.core.maths.portable import Array
from adaptrack.core.member import CallBack
from adaptrack.core.synthesis import laws
from adaptrack.road.road_ahead import RoadAhead, stacked

_NO_SPEEDS = np.zeros(0)


class Command(NamedTuple):
    """Result of one step of a compiled controller."""

    angle: float
    """rad, steering angle to apply, u(k)"""
    move: float
    """rad, u(k) - u(k-1)"""
    held: bool
    """the law had no answer to its input: the previous angle is held"""
    tuning: tuple[float, ...]
    """as used, in the order of `tuning_names`"""
    diagnostics: Mapping[str, float]
    """Diagnostics of the control law by name; NaN where one does not apply."""


STEP_CALL = PluginCall("step()", "the steering angle (rad, finite), or an answer with an `angle`")


def step_call(controller: Controller) -> PluginCall:
    """Return the call of `Controller.step`, which may be that of a plug-in."""
    return STEP_CALL._replace(function_name=f"controller {controller.name!r}: step()")


def command_of(answer: Any, before: float, call: PluginCall = STEP_CALL) -> Command:
    """An answer of `Controller.step` as a command; one that is the steering angle (rad) alone has no more to say.

    before: the last command (rad); call: of the controller, see `step_call`. Raises ContractError when the answer is
    neither an angle nor has one.
    """
    value = getattr(answer, "angle", answer)
    if isinstance(answer, Command) and type(value) is float:
        return answer
    try:
        if isinstance(value, str | bytes | bool | np.bool_):  # which float() would accept
            raise TypeError
        angle = float(value)
    except (TypeError, ValueError):
        raise call.refusal(answer) from None
    return Command(
        angle, float(getattr(answer, "move", angle - before)), bool(getattr(answer, "held", False)),
        getattr(answer, "tuning", ()), getattr(answer, "diagnostics", {}),
    )  # fmt: skip


class TuningBounds(NamedTuple):
    """Within which a tuning entry is sought."""

    low: float
    high: float
    relative: bool = False
    """low and high are factors on the controller's own value; else they are values"""


class Policy(NamedTuple):
    """A way to drive a set of runs: a controller, with its own tuning and scheduler or with others in their place."""

    controller: Any = None
    """the `Controller`; None: the MPC of the runs"""
    tunings: Any = None
    """a tuning (entries,), or one for each run (runs, entries), in the order of `tuning_names`; None: its own"""
    scheduler: Any = None
    """a schedule in place of the constant tuning"""

    def as_policy(self) -> Policy:
        """Return the policy itself."""
        return self

    @property
    def adapts(self) -> bool:
        """Whether the tuning changes between or during runs."""
        if self.scheduler is not None:
            return not self.scheduler.is_constant
        if self.tunings is not None:
            return np.ndim(self.tunings) == 2 and len(self.tunings) > 1
        return self.controller is not None and self.controller.scheduler is not None


TWO_DECADES = TuningBounds(0.01, 100.0, relative=True)
"""Two decades to either side of the controller's own value."""
FIXED_TUNING = TuningBounds(1.0, 1.0, relative=True)


class Controller(ABC):
    """Base class of controllers, compiled or in Python. To write one, derive from it and define `step`.

    Everything else has a default here, for one that has no memory and nothing to say of itself. `name`, `period` and
    the others may be set on the class or on the object. `check_controller` tells whether one keeps the contract.
    """

    if TYPE_CHECKING:  # as properties, which a derived class may have as attributes, too

        @property
        def name(self) -> str:
            """How tables call it; by default the name of its class."""

        @property
        def period(self) -> float:
            """Control period (s)."""
    else:
        name, period = "controller", 0.1

    tuning: Any = MappingProxyType({})
    """Numbers by name that may be tuned; of an MPC its `Tuning`."""
    tuning_names: tuple[str, ...] = ()
    """Their names; by default those of the class's `tuning_bounds`."""
    tuning_bounds: Mapping[str, TuningBounds | tuple[float, float]] = MappingProxyType({})
    """Where each of them is sought, (low, high) or `TuningBounds`; empty: nothing is."""
    diagnostic_names: tuple[str, ...] = ()
    """Names of the diagnostics that accompany the command."""
    vehicle: Any = None
    """The car that it was made for, if it says so."""
    limits: Any = None
    """`Limits` on angle and move; None: none are known."""
    sees_road: bool = True
    """Whether `step` has the argument `road`; without it a controller steers along roads by offset and heading."""
    sees_all_sensors: bool = False
    """Whether `step` is given all that is measured (`core.models.contract.MEASUREMENT`), not four numbers only."""
    replaces_vy: bool = True
    """Whether a lateral velocity that is not measured is passed on as NaN; other controllers are given 0."""
    requests_forces: bool = False
    """Whether its answers have `longitudinal`, a `SpeedCommand`: it then moves the simulated car as well."""
    scheduler: Any = None
    """Scheduler that changes the tuning while driving; None without one."""
    model: Any = None
    """Its prediction model, if it has one."""
    belief: Any = None
    """Steering model that the controller assumes; None if it has none."""
    learner: Any = None
    """Estimator of the car's parameters; None if the controller does not learn."""
    needs_whole_state: bool = False
    """Whether the whole state of the model must be measured, for lack of an estimator."""
    is_published: bool = False
    """Whether model and estimator are the paper's."""
    has_horizons: bool = False
    """Whether moves are planned over the horizons Np and Nc of a tuning."""
    is_exportable: bool = False
    """Whether exports contain its functions (`CONTROLLERS` in `core/build/units.py`)."""
    runs_in_kernel: bool = False
    """Whether loops that are compiled can call it, see `part`."""
    own_part: Any = None
    """The controller itself as a part of compiled loops, its memory shared; None where it is Python."""
    takes_late: int = -1
    """Control periods by which its Kalman filter takes late samples; -1 without such a filter."""
    position_noise: float = 0.0
    """Standard deviation (m) of the position that its filter assumes; 0 without one."""
    learner_memory: Any = np.zeros(0)
    """Memory of its learner, as the kernels have it; empty where nothing is learned."""
    user: Any = None
    """Token of the tracker or simulation that began a drive with the controller last."""
    learns: str = ""
    """Text on whether the controller learns, why, and within which range."""

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        if cls.name == Controller.name:
            cls.name = cls.__name__  # type: ignore[method-assign, assignment]
        arguments = inspect.signature(cls.step).parameters.values()
        cls.sees_road = any(argument.name == "road" or argument.kind is argument.VAR_KEYWORD for argument in arguments)
        if cls.tuning_bounds and not cls.tuning_names:
            cls.tuning_names = tuple(cls.tuning_bounds)

    @property
    def belief_at_first(self) -> str:
        """The belief about the steering before the first step, for tables; empty where there is none."""
        belief = "" if self.belief is None else str(self.belief)
        return f"{belief}; {self.learns}" if belief and self.learner is not None else belief

    @property
    def scheduler_counts(self) -> dict[str, int]:
        """How often its scheduler was limited, stepped in for, ...: steps by what was counted."""
        return {}

    def begin(self, drive: Any) -> None:  # noqa: B027 (there may be nothing to begin)
        """Begin a simulated drive, a scenario or a `RoadDrive`; after `reset`. It may raise `InvalidInput`."""

    def reset(self) -> None:  # noqa: B027 (there may be nothing to forget)
        """Forget the past: the next step is the first, from steering angle 0."""

    def restart(self) -> None:
        """Reset the controller but keep what it has learned of its car."""
        self.reset()

    @abstractmethod
    def step(
        self, state: ArrayLike, speed: float, reference: ArrayLike, variables: Any = None, road: RoadAhead | None = None
    ) -> Any:
        """One control step, see `CompiledController.step`; the steering angle (rad), or an answer that has it.

        An answer has `angle` (rad), and may have `move`, `held`, `tuning` and `diagnostics`, as `Command` has.
        """

    def applied(self, angle: float) -> None:  # noqa: B027
        """Say which angle (rad) was sent to the steering in place of the last command: the next step goes on from it.

        Raises
        ------
        InvalidInput
            When no road wheel can have it.
        """

    def change_path(self, heading: float, offset: float) -> None:
        """Say that another path lies under the car, by how much (rad, m) heading and offset have grown against it."""
        change_of_path(heading, offset)

    def predicted_path(self, ahead: RoadAhead) -> Array:
        """(Np, 2) m: where the last step, on that road ahead of the car, predicts it behind its dead time.

        (0, 2) for a controller that predicts nothing, before the first step, and where the last step found no solution.
        """
        return np.zeros((0, 2))

    def as_policy(self) -> Policy:
        """Return the policy that drives runs with this controller in place of their MPC."""
        return Policy(self)

    def describe(self) -> dict[str, Any]:
        """The configuration, for provenance: plain data."""
        return {}

    def part(self, slots: int, room: Room | None = None, *, curved: bool = True, has_vy: bool = True) -> Any:
        """Fresh controllers for `slots` slots of a compiled loop (`core.controllers.part.ControllerPart`).

        room: by default as much as the controller has; curved: whether roads may bend; has_vy: whether the lateral
        velocity is measured.

        Raises
        ------
        InvalidInput
            When the controller, or a part of it, is Python.
        """
        raise InvalidInput(f"controller {self.name!r} is not compiled.")

    @property
    def answer_columns(self) -> tuple[tuple[str, str], ...]:
        """Group and name of each column that a compiled loop traces behind `core.controllers.part.COMMON_ANSWER`."""
        return (*product(["diagnostics"], self.diagnostic_names), *product(["tuning"], self.tuning_names))

    def checked_tunings(self, tunings: ArrayLike) -> Array:
        """Return tunings as an array (runs, entries) after a check of their shape and values.

        Raises
        ------
        InvalidInput
            When the shape is wrong, a value is not finite, or a weight of an MPC is not allowed.
        """
        names = self.tuning_names
        rows = np.array(tunings, dtype=np.float64, ndmin=2)
        if rows.ndim != 2 or rows.shape[1] != len(names) or not np.isfinite(rows).all():
            raise InvalidInput(
                f"tunings: need finite (runs, {len(names)}) of {', '.join(names)}; got shape {rows.shape}."
            )
        return rows

    def part_with_learned(self, room: Room) -> Any:
        """`part` of one slot, with what the controller has learned so far."""
        return self.part(1, room)

    def user_functions(self) -> list[Any]:
        """The compiled functions of a user that it calls, as the kernels have them."""
        return []

    def warn_of(self, scheduler: Any, profile: str | None = None, plant: Any = None) -> None:  # noqa: B027
        """Log what a scheduler was made for and does not find here, each once per controller."""

    def nearest_tuning(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """The tuning by name that it can have and that is nearest to another one."""
        return dict(tuning)

    def room_for(self, tunings: Array, scheduler: Any = None) -> Room:
        """The memory that batches with these tunings (n, entries), or with a scheduler, need."""
        return Room(residuals=False)

    def packed_tuning(self) -> Array:
        """(entries,) the tuning in the order of `tuning_names`."""
        return np.array([self.tuning[name] for name in self.tuning_names], dtype=float)

    def check_tuning(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """The tuning as finite numbers by name.

        Raises
        ------
        InvalidInput
            When it makes no such controller.
        """
        entries = {name: real(type(self).__name__, name, tuning[name]) for name in self.tuning_names}
        for name, value in entries.items():
            if not math.isfinite(value):
                raise InvalidInput(f"{type(self).__name__}: {name} = {value!r}: must be finite.")
        return entries

    def with_tuning(self, tuning: Mapping[str, float]) -> Self:
        """A controller of its own, at its start, with these tuning entries (by name) in place of its own.

        Entries that are not given stay.

        Raises
        ------
        InvalidInput
            For an entry that it does not have, or numbers that make no such controller.
        """
        controller = copy.deepcopy(self)
        controller.tuning = self.check_tuning(self._entries(tuning))
        controller.reset()
        return controller

    def _entries(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """All tuning entries, some of them changed."""
        if unknown := [name for name in tuning if name not in self.tuning_names]:
            names = ", ".join(self.tuning_names) or "none"
            raise InvalidInput(f"tuning of {self.name!r}: {', '.join(unknown)}: its entries are {names}.")
        return {**dict(zip(self.tuning_names, self.packed_tuning().tolist(), strict=True)), **tuning}


class Room(NamedTuple):
    """Horizons for which a controller has memory; one without horizons needs none."""

    longest: float = math.inf
    """largest Np"""
    most: float = math.inf
    """largest Nc"""
    residuals: bool = True
    """whether each step computes its KKT residual"""


class CompiledController(Controller):
    """A controller whose law is compiled, see `core.controllers.contract`: `simulate` and batches call the same.

    tuning: named numbers that a search or a scheduler may change; period: control period (s); limits: on angle and
    move; preview: whether the law sees the reference ahead or its present value only.

    A controller drives one vehicle and remembers its past: for several at once, in threads or not, take a copy each.

    Raises
    ------
    InvalidInput
        When the tuning is not finite numbers >= 0.
    """

    period: float
    limits: Limits
    memory_size: int
    """Numbers that the law remembers from step to step."""
    runs_in_kernel, replaces_vy = True, False
    positive: ClassVar[tuple[str, ...]] = ()
    """Entries of the tuning that must not be zero either."""
    law_name: ClassVar[str] = ""
    """Name of the law of a vehicle in `describe`; empty: it is not listed."""

    @checked
    def __init__(
        self,
        tuning: Mapping[str, float],
        *,
        period: Annotated[Positive, "s"] = 0.1,
        limits: LimitsArgument | None = None,
        preview: bool = False,
    ) -> None:
        self.tuning = self.check_tuning(tuning)
        self.period, self.limits = period, Limits() if limits is None else limits
        self.preview = bool(preview)
        self.reset()

    @property
    @abstractmethod
    def function(self) -> Any:
        """The compiled law."""

    @abstractmethod
    def own_parameters(self) -> Sequence[float] | Array:
        """Return the law's parameters that follow `core.controllers.contract.COMMON_PARAMETERS`."""

    def user_functions(self) -> list[Any]:
        return [self.function]

    def parameters(self) -> Array:
        """The law's constant numbers."""
        return np.array([self.period, *self.limits.move, *self.limits.angle, *self.own_parameters()], dtype=float)

    def _made_by(self, kernel: Any, size: int, *arguments: Any) -> Array:
        """Return the parameters that a kernel of `core.synthesis.laws` computes; size: of all parameters."""
        (low, high), (least, most) = self.limits.move, self.limits.angle
        common = row_of(laws.Common, period=self.period, move_min=low, move_max=high, angle_min=least, angle_max=most)
        parameters = np.zeros(size)
        kernel(self.vehicle.numbers, common, *arguments, parameters)
        return parameters[len(laws.Common._fields) :]

    def check_tuning(self, tuning: Mapping[str, float]) -> dict[str, float]:
        """The tuning as finite numbers by name, none of them negative; see `Controller.check_tuning`."""
        entries = super().check_tuning(tuning)
        for name, value in entries.items():
            is_positive = name in self.positive
            if value < 0.0 or (is_positive and value == 0.0):
                must = "positive" if is_positive else "not negative"
                raise InvalidInput(f"{type(self).__name__}: {name} = {value!r}: must be finite and {must}.")
        return entries

    def part(self, slots: int, room: Room | None = None, *, curved: bool = True, has_vy: bool = True) -> Any:
        return law_controller(slots, self, has_vy)

    def reset(self) -> None:
        self._part, self._angle = self.part(1), 0.0
        self._resident = Resident(self._part)

    @property
    def own_part(self) -> Any:
        """The controller itself as a part of compiled loops (`core.controllers.part`), its memory shared."""
        return self._part

    @property
    def angle(self) -> float:
        """The last command (rad)."""
        return self._angle

    def applied(self, angle: float) -> None:
        self._angle = wheel_angle("applied: angle", angle)

    def step(
        self, state: ArrayLike, speed: float, reference: ArrayLike, variables: Any = None, road: RoadAhead | None = None
    ) -> Command:
        """One control step.

        state: measured x_c = [v_y (m/s), yaw (rad), yaw rate (rad/s), y (m)]; speed: v_x (m/s); reference: y_ref (m)
        now and, for preview, at the instants that follow (beyond its end it goes straight on); variables: what a
        scheduler would look at, not used; road: a curved one from the car's foot on, against which yaw, y and y_ref
        then count.

        What is not finite gives no exception but a command that holds the previous angle: a controller in a running
        vehicle must answer.

        Raises
        ------
        InvalidInput
            When an argument is not made of numbers or has a wrong shape.
        """
        measured, speed, ahead = vector("state", state, 4), number("speed", speed), vector("reference", reference)
        curved = road_ahead(road)
        place, line, speeds = (0.0, -1, _NO_SPEEDS) if curved is None else (curved.station, 0, curved.speeds)
        roads = stacked(None if curved is None else curved.road)
        step_law(0, speed, self._angle, place, line, measured, ahead, speeds, roads, self._resident)
        self._angle, move, is_held, *values = self._part.answer[0].tolist()
        diagnostics = dict(zip(self.diagnostic_names, values, strict=True))
        return Command(self._angle, move, is_held > 0.5, tuple(self.tuning.values()), diagnostics)

    def __repr__(self) -> str:
        car = getattr(getattr(self, "vehicle", None), "name", "a car")
        numbers = ", ".join(f"{name} {value:.4g}" for name, value in self.tuning.items())
        return f"<{self.name} of {car}: {numbers}, every {self.period:g} s>"

    def describe(self) -> dict[str, Any]:
        """The controller's configuration, for provenance."""
        return {
            "tuning": dict(self.tuning),
            "period": self.period,
            "limits": {"move": list(self.limits.move), "angle": list(self.limits.angle)},
            "preview": self.preview,
            **({"law": self.law_name, "vehicle": self.vehicle.name} if self.law_name else {}),
        }

    def __copy__(self) -> Self:
        """A controller of its own: memories are never shared."""
        return copy.deepcopy(self)


# -- controllers in Python as parts of compiled loops ------------------------------------------------------------------
def python_part(controller: Controller | None, step: CallBack | None, request: CallBack | None = None) -> Any:
    """A controller in Python as a part of compiled loops (`core.controllers.part.ControllerPart`), for one slot.

    Its answer says what it has learned, if it learns. controller, step: None if the caller of the loop is the
    controller.
    """
    learns = controller is not None and controller.learner is not None
    part = controller_part(
        controller, 1, {"answer": len(COMMON_ANSWER) + (len(BELIEF_NAMES) if learns else 0)},
        request=request, step=step, beliefs=len(COMMON_ANSWER) if learns else 0,
    )  # fmt: skip
    if controller is None:
        return part
    informed = part.mpc.informed._replace(learned=controller.learner_memory[None])
    return part._replace(mpc=part.mpc._replace(informed=informed))


class CalledController:
    """A controller in Python, as a compiled loop calls it."""

    def __init__(self, controller: Controller) -> None:
        self.controller, self.call = controller, step_call(controller)
        self._answered = math.nan  # rad, its last command; NaN before its first

    def restart(self) -> None:
        """Let the controller begin anew; what it has learned stays."""
        self.controller.restart()
        self._answered = math.nan

    def step(self, before: float, measured: Array, speed: float, reference: Array, *variables: Any, **road: Any) -> Any:
        """One step of the controller, which is told the command in force (rad) where that is not its own."""
        controller: Any = self.controller
        if before != self._answered:
            controller.applied(before)
        state = measured if controller.sees_all_sensors else measured[:4]  # wheel angle and accelerometer
        return self.call(controller.step, state, speed, reference, *variables, **road)

    def write(self, answered: Any, before: float, row: Array) -> Command:
        """Write what the controller answered to the row of its part, and return it as a command."""
        command = command_of(answered, before, self.call)
        row[: len(COMMON_ANSWER)] = command.angle, command.angle - before, command.held
        if self.controller.learner is not None:
            row[len(COMMON_ANSWER) :] = getattr(answered, "learned", math.nan)
        self._answered = command.angle
        return command
