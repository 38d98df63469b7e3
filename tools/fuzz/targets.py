"""What is driven with hostile inputs, and what must hold at every step.

A target is made from a case and answers each input with None, or with a sentence that says which claim does not hold.
An error that is not `InvalidInput`, or `InvalidInput` for well-formed input, fails as well (`search`).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, Protocol

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import LQR, MPC, Learning, Limits, Moves, PurePursuit, Stanley, Tuning, published_mpc
from adaptrack.control.controllers.inputs import MOST_CHANGE, MOST_WHEEL_ANGLE
from adaptrack.control.controllers.mpc import SPEED_KEPT
from adaptrack.control.estimation import FrictionWindEstimator
from adaptrack.control.qp import QPStatus, get_qp_solver, kkt_residuals
from adaptrack.control.scheduling import SchedulingVariables
from adaptrack.control.tracker import Status, Tracked, Tracker
from adaptrack.core.tracker.records import LONGEST_GAP, STANDSTILL_SPEED
from adaptrack.road import Arc, Line, Road, SpeedPlan, generate_road, plan_speed
from tools.fuzz import inputs
from tools.fuzz.inputs import Array, Case, Rng

TINY = 1e-12
"""rad, rounding of a limit."""
CERTIFIED = 1e-6
"""The largest scaled residual of what steers."""
CHECKED_EACH = 50
"""Solved steps between two whose residuals are computed anew, in NumPy."""
SETTLED = 100
"""Good inputs in a row after which nothing of bad ones is left: 5 s at 20 Hz."""
STATE_SIZES = tuple(range(4, 11))


class Target(Protocol):
    """Something that is driven."""

    def step(self, given: Case) -> str | None:
        """Take one input; what does not hold."""


@cache
def _car(name: str) -> Vehicle:
    return load_vehicle(name)


def _limits(case: Case) -> Limits:
    pairs: Case = {name: tuple(pair) for name, pair in case["limits"].items()}
    return Limits(**pairs)


def _refused(action: Callable[[], Any], allowed: bool) -> str | None:
    """Do it; it must be refused exactly where it is not allowed."""
    try:
        action()
    except InvalidInput as error:
        return f"refused what is allowed: {error}" if allowed else None
    return None if allowed else "took what must be refused"


def _is_allowed(name: str, numbers: list[float]) -> bool:
    """Whether `applied` or `change_path` takes these."""
    most = {"applied": MOST_WHEEL_ANGLE, "change_path": math.nextafter(MOST_CHANGE, 0.0)}[name]
    return all(abs(number) <= most for number in numbers)


def _is_row(value: Any, sizes: tuple[int, ...] = ()) -> bool:
    """Whether it is what a step takes: a row of so many numbers, or any numbers where their count is free."""
    if not isinstance(value, np.ndarray):
        return False
    return value.ndim == 1 and value.size in sizes if sizes else value.size > 0


def _finite(numbers: Array) -> bool:
    return bool(np.isfinite(numbers).all())


class _Answers:
    """A scheduler that answers what the input says."""

    def __init__(self) -> None:
        self.answer: Any = None

    def __call__(self, variables: Any) -> Any:
        if self.answer == "raise":
            raise RuntimeError("a scheduler that fails")
        return self.answer


# -- controllers ------------------------------------------------------------------------------------------------------
def make_mpc(case: Case, scheduler: Any = None) -> MPC:
    """The MPC of a case."""
    tuning = Tuning(*case["tuning"]) if "tuning" in case else None
    car = _car(case["car"])
    if case["kind"] == "published":
        solver = "active-set" if case.get("solver", "active-set") == "active-set" else get_qp_solver(
            "hildreth", on_uncertified=case["policy"]
        )  # fmt: skip
        moves = Moves(*case["moves"]) if "moves" in case else None
        limits = _limits(case) if "limits" in case else None
        return published_mpc(
            car, tuning, period=case.get("period", 0.05), preview=case.get("preview", True), limits=limits, moves=moves,
            solver=solver, scheduler=scheduler,
        )  # fmt: skip
    learning = Learning() if case["kind"] == "learning" else None
    return MPC(car, tuning, profile=case["profile"], learning=learning, scheduler=scheduler)


class Steering:
    """The claims about commands that all controllers share: finite, within the limits on angle and move."""

    def __init__(self, controller: Any) -> None:
        self.controller = controller
        self.least, self.most = controller.limits.angle
        self.down, self.up = controller.limits.move

    def wrong(self, before: float, angle: float) -> str | None:
        """What does not hold of a command after another one (rad)."""
        if not math.isfinite(angle):
            return f"the command is {angle}"
        if not self.least - TINY <= angle <= self.most + TINY:
            return f"the command {angle!r} is outside [{self.least!r}, {self.most!r}] rad"
        start = min(max(before, self.least), self.most)
        low, high = start + self.down, start + self.up
        ahead = self.ahead()
        if ahead is not None:
            low, high = min(low, ahead[0]), max(high, ahead[1])
        if not low - 1e-9 <= angle <= high + 1e-9:
            return f"the command goes from {before!r} to {angle!r} rad: the limit on moves is {self.up!r}"
        return None

    def ahead(self) -> tuple[float, float] | None:
        """Between which angles (rad) the command may be ahead of the wheels in one move."""
        mpc = self.controller
        if not isinstance(mpc, MPC) or not mpc.limits.ahead > 0.0 or "wheel_angle" not in mpc.model.states:
            return None
        wheels = float(mpc._mpc.informed.x[mpc.model.states.index("wheel_angle")])
        allowed = mpc.limits.ahead
        if mpc.learner is not None:
            allowed *= max(1.0, (mpc.learner.limits.lag[1] + mpc.period) / (mpc.belief.lag.value + mpc.period))
        return (wheels - allowed, wheels + allowed) if math.isfinite(wheels) else None


class MPCTarget:
    """An MPC called as from anybody's loop."""

    def __init__(self, case: Case) -> None:
        self.case = case
        self.scheduler = _Answers() if case["lies"] else None
        self.mpc = make_mpc(case, self.scheduler)
        self.steering = Steering(self.mpc)
        self.published = case["kind"] == "published"
        self.good_for, self.solved = 0, 0
        self.speed, self.without_speed = math.nan, 0.0

    def step(self, given: Case) -> str | None:
        """Take one input; what does not hold."""
        mpc = self.mpc
        state, reference = _rows(given, self.case)
        if "before" in given:
            wrong = self._before(given["before"])
            if wrong:
                return wrong
        variables = None
        if self.scheduler is not None:
            self.scheduler.answer, variables = given["answer"], SchedulingVariables(10.0, 0.0, 0.6, 0.0)
        before = mpc.angle
        well_formed = _is_row(state, STATE_SIZES) and _is_row(reference)
        self.good_for = self.good_for + 1 if given["good"] else 0
        if not well_formed:
            wrong = _refused(lambda: mpc.step(state, given["speed"], reference, variables), False)
            return wrong or ("a refused step moved the command" if mpc.angle != before else None)
        told = mpc.step(state, given["speed"], reference, variables)
        speed = self._known_speed(given["speed"])
        wrong = self.steering.wrong(before, told.angle) or self._status(told, state, speed, reference)
        if wrong is None and told.status is QPStatus.SOLVED:
            self.solved += 1
            if self.solved % CHECKED_EACH == 0 and abs(speed) >= STANDSTILL_SPEED:
                wrong = self._certificate()
        return wrong

    def _known_speed(self, speed: float) -> float:
        """The speed (m/s), for so long the last one where it is missing."""
        if math.isfinite(speed):
            self.speed, self.without_speed = speed, 0.0
        else:
            self.without_speed += self.mpc.period
        return self.speed if self.without_speed < SPEED_KEPT + 0.5 * self.mpc.period else math.nan

    def _before(self, action: list[Any]) -> str | None:
        name, *numbers = action
        if name == "restart":
            self.mpc.restart()
            self.good_for, self.speed = 0, math.nan
            return None
        return _refused(lambda: getattr(self.mpc, name)(*numbers), _is_allowed(name, numbers))

    def _status(self, told: Any, state: Array, speed: float, reference: Array) -> str | None:
        """Whether the status says what was."""
        status = told.status
        if told.held != (status is not QPStatus.SOLVED):
            return f"held = {told.held} with status {status.name}"
        if status is QPStatus.NON_FINITE and told.move != 0.0 and self._within(told.angle - told.move):
            return f"NON_FINITE, and the command moved by {told.move!r} rad"
        if status is QPStatus.SOLVED and not (told.residual <= CERTIFIED or abs(speed) < STANDSTILL_SPEED):
            return f"SOLVED with a residual of {told.residual!r}"
        missing = self._missing(state, speed, reference)
        if missing and status is QPStatus.SOLVED:
            return f"SOLVED although {missing} is not finite"
        if told.learned and not _finite(np.array(told.learned)):
            return "what is learned is not finite"
        if self.good_for >= SETTLED and self.case.get("policy") != "hold" and self.case.get("solver") != "hildreth":
            return self._settled(told)
        return None

    def _within(self, angle: float) -> bool:
        return self.steering.least <= angle <= self.steering.most

    def _missing(self, state: Array, speed: float, reference: Array) -> str | None:
        """What is not finite and cannot be done without."""
        if not math.isfinite(speed):
            return "the speed"
        if self.published and not _finite(state[:4]):
            return "the state"
        if not self.published and abs(speed) < STANDSTILL_SPEED:
            return None
        if not np.isfinite(reference).any():
            return "the reference"
        if self.published and not self.mpc.preview and not math.isfinite(reference.flat[0]):
            return "the reference now"
        return None

    def _settled(self, told: Any) -> str | None:
        """After so many good inputs there is an answer, whatever came before."""
        if told.status is not QPStatus.SOLVED:
            return f"status {told.status.name} after {self.good_for} good inputs"
        return None

    def _certificate(self) -> str | None:
        """The residuals of the solution, by the readable formulas."""
        qp, x = self.mpc.solved_problem()
        worst = kkt_residuals(qp, x, self.mpc._mpc.ws.multipliers[: qp.m]).worst
        return None if worst <= CERTIFIED else f"SOLVED with residuals of {worst:.1e}"


def _rows(given: Case, case: Case) -> tuple[Any, Any]:
    """State and reference as arrays where they are rows of numbers."""
    rows = []
    for name in ("state", "reference"):
        value = given[name]
        if isinstance(value, list) and value and not isinstance(value[0], str):
            value = np.array(value, dtype=np.float64)
        if isinstance(value, np.ndarray) and case["frozen"]:
            value.flags.writeable = False
        rows.append(value)
    return rows[0], rows[1]


class LawTarget:
    """A steering law called as from anybody's loop."""

    def __init__(self, case: Case) -> None:
        self.case = case
        law = {"LQR": LQR, "Stanley": Stanley, "PurePursuit": PurePursuit}[case["kind"]]
        self.law = law(_car(case["car"]), period=0.05, limits=_limits(case), preview=case["preview"])
        self.steering = Steering(self.law)
        self.good_for = 0

    def step(self, given: Case) -> str | None:
        """Take one input; what does not hold."""
        law = self.law
        state, reference = _rows(given, self.case)
        if "before" in given:
            name, *numbers = given["before"]
            wrong = _refused(lambda: getattr(law, name)(*numbers), _is_allowed(name, numbers))
            if wrong:
                return wrong
        before = law.angle
        if not (_is_row(state, (4,)) and _is_row(reference)):
            return _refused(lambda: law.step(state, given["speed"], reference), False)
        told = law.step(state, given["speed"], reference)
        self.good_for = self.good_for + 1 if given["good"] else 0
        known = _finite(state) and math.isfinite(given["speed"])
        if told.held and known and self.good_for >= SETTLED:
            return f"held after {self.good_for} good inputs"
        if not told.held and not known:
            return "not held although what is measured is not finite"
        return self.steering.wrong(before, told.angle)


# -- trackers ---------------------------------------------------------------------------------------------------------
@cache
def path(name: str) -> Road:
    """A path by the name that cases give it."""
    circle = Arc(length=120.0 * math.pi, curvature=1 / 60)
    if name == "country":
        return generate_road("country", seed=1, length=600.0)
    roads: dict[str, tuple[list[Any], bool]] = {
        "circle": ([circle], True),
        "line": ([Line(length=60.0)], False),
        "loop": ([Line(length=100.0), Arc(length=45.0 * math.pi, curvature=1 / 30), Line(length=100.0)], False),
    }
    segments, closed = roads[name]
    return Road.from_segments(segments, closed=closed, name=name)


@cache
def _plan(name: str, car: str) -> SpeedPlan:
    return plan_speed(path(name), _car(car))


class TrackerTarget:
    """A tracker in a loop that is not ours."""

    def __init__(self, case: Case) -> None:
        self.case = case
        kind, car = case["kind"], _car(case["car"])
        laws: dict[str, Any] = {"LQR": LQR, "Stanley": Stanley, "PurePursuit": PurePursuit}
        controller = laws[kind](car, period=0.05) if kind in laws else make_mpc(case)
        plan = _plan(case["path"], case["car"]) if case["plan"] else None
        self.tracker = Tracker(controller, path(case["path"]), plan=plan)
        self.steering = Steering(controller)
        self.told: Tracked | None = None
        self.good_for = 0

    def step(self, given: Case) -> str | None:
        """Take one input; what does not hold."""
        tracker, call = self.tracker, given["call"]
        if "before" in given:
            name, value = given["before"]
            action: Callable[[], Any] = lambda: tracker.engage(value)  # noqa: E731
            if name == "follow":
                action = lambda: tracker.follow(path(value))  # noqa: E731
            wrong = _refused(action, name == "follow" or math.isfinite(value))
            if wrong:
                return wrong
        at = call["t"] if call["now"] is None else call["now"]
        memory = tracker._kernel.memory[0]
        before, started, last = tracker.controller.angle, bool(memory.started), float(memory.last)
        self.good_for = self.good_for + 1 if given["good"] else 0
        if not math.isfinite(at):
            return _refused(lambda: tracker.step(**call), False)
        told = tracker.step(**call)
        repeated = started and last - LONGEST_GAP <= at <= last
        return self._wrong(told, call, before, repeated, started)

    def _wrong(self, told: Tracked, call: Case, before: float, repeated: bool, started: bool) -> str | None:
        if not math.isfinite(told.command):
            return f"the command is {told.command}"
        if (told.status is Status.REPEATED) != repeated:
            return f"status {told.status.value} where the call is {'' if repeated else 'not '}a repeated one"
        handed = call["wheel_angle"] is not None and math.isfinite(call["wheel_angle"])
        if not handed and started and told.command != before and not repeated:
            wrong = self.steering.wrong(before, told.command)
            if wrong:
                return wrong
        if told.status is Status.REVERSE and not self.tracker._kernel.memory[0].speed < -STANDSTILL_SPEED:
            return "reverse, and the car drives forwards"
        if told.status in (Status.OK, Status.ESTIMATED, Status.END) and not all(map(math.isfinite, told[2:5])):
            return f"status {told.status.value} with {told}"  # far off the path there is no foot
        if told.status is Status.HELD and self.good_for >= SETTLED and not told.suspect:
            return f"held after {self.good_for} good calls"
        return None


# -- estimators -------------------------------------------------------------------------------------------------------
class FrictionTarget:
    """The estimator of friction and wind."""

    def __init__(self, case: Case) -> None:
        self.estimator = FrictionWindEstimator(_car(case["car"]), period=case["period"], delay=case["delay"])

    def step(self, given: Case) -> str | None:
        """Take one input; what does not hold."""
        *state, speed, command, acceleration = given["row"]
        found = self.estimator.step(np.array(state), speed, command, acceleration)
        prior = self.estimator._prior
        low, high = prior.friction_range
        if not all(
            map(math.isfinite, (found.friction, found.wind, found.friction_std, found.wind_std, found.stiffness))
        ):
            return f"not finite: {found}"
        if not (low - TINY <= found.friction <= high + TINY and abs(found.wind) <= prior.most_wind + TINY):
            return f"out of its range: {found}"
        return None


TARGETS: dict[str, tuple[Callable[[Rng], Case], Callable[[Case, Rng, int], list[Case]], Callable[[Case], Target]]] = {
    "mpc": (inputs.mpc_case, inputs.mpc_inputs, MPCTarget),
    "law": (inputs.law_case, inputs.law_inputs, LawTarget),
    "tracker": (inputs.tracker_case, inputs.tracker_inputs, TrackerTarget),
    "friction": (inputs.friction_case, inputs.friction_inputs, FrictionTarget),
}
"""By name: how a case is drawn, how its inputs are, and what is driven."""
