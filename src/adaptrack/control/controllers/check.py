"""The checker that admits a controller: ours and anybody's, compiled or in Python."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.registry import Contract
from adaptrack.control.controllers.base import Controller, command_of, step_call
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.road import Arc, Line, Road
from adaptrack.road.road_ahead import RoadAhead

CHECK_SPEEDS = (1.0, 5.0, 15.0, 30.0)
"""m/s, at which a controller is called."""
CHECK_STEPS = 5
"""Steps of each drive that is put to it."""
COMMAND_TOLERANCE = 1e-9
"""rad, within which commands are the same, and limits kept."""
BAD = (math.nan, math.inf, -math.inf, 1e300, -1e300)
"""What a broken sensor may say."""

_BEND = Road.from_segments([Line(length=50.0), Arc(length=90.0, curvature=1 / 60)])
Question = tuple[Array, float, Array]
"""State (4,), speed (m/s), reference (n,), as `Controller.step` takes them."""
Variables = Callable[[Array, float, Array], Any]


def check_controller(controller: Controller, symmetric: bool = True, variables: Variables | None = None) -> None:
    """Test that a controller keeps the contract on which the drivers rely.

    It has a name, a positive period, `reset`, `step` and `describe` (plain data for JSON). In sane situations, from
    1 to 30 m/s, and in a bend if it sees the road, it answers finite commands, within its `limits` if it names some,
    with the move from the last command; the same after each `reset`; and mirrored ones for the mirrored situation,
    unless `symmetric` is False. It takes read-only arrays and writes to none of its arguments. NaN, infinities and huge
    numbers in a state, a speed or a reference end in no exception but `InvalidInput`, and in a finite command within
    the limits.

    variables: makes the fourth argument of `step` from the others, for controllers with a scheduler.

    Raises
    ------
    ContractError
        Naming the clause that is broken and the evidence.
    """
    _check_face(controller)
    ask = _Asking(controller, variables)
    for drive in _drives():
        first = ask.drive(drive)
        ask.expect_equal(first, ask.drive(drive), "after `reset` it must answer as before")
        if symmetric:
            mirrored = ask.drive([(-state, speed, -reference) for state, speed, reference in drive])
            ask.expect_equal(
                [-angle for angle in first], mirrored, "the mirrored situation must give the mirrored command"
            )
    if controller.sees_road:
        ask.drive_bend()
    for question in _broken():
        ask.survives(question)
    controller.reset()


def _check_face(controller: Any) -> None:
    """Name, period, methods and description."""
    name, period = getattr(controller, "name", None), getattr(controller, "period", None)
    has_name = isinstance(name, str) and name
    Contract(type(controller).__name__).require(has_name, "it must have a name", f"found {name!r}")
    contract = Contract(f"Controller {name!r}")
    is_positive = isinstance(period, float) and 0.0 < period < math.inf
    contract.require(is_positive, "`period` must be a positive float in seconds", f"found {period!r}")
    for method in ("reset", "step", "describe"):
        is_method = callable(getattr(controller, method, None))
        contract.require(is_method, f"it must have a method `{method}`", "found none")
    try:
        json.dumps(dict(controller.describe()))
    except Exception as error:
        raise contract.breach("`describe()` must give a dict of plain data, which JSON can hold", error) from error


AHEAD_REACH = 4.0
"""Multiple of `Limits.ahead` by which a first move may exceed the limit on moves: from behind the wheels to ahead of
them, with a lag that was learned to be up to twice the assumed one."""


class _Asking:
    """Puts questions to a controller and tests the clauses that hold for every answer."""

    def __init__(self, controller: Controller, variables: Variables | None) -> None:
        self.controller, self.variables = controller, variables
        limits = controller.limits
        low, high = (-math.pi, math.pi) if limits is None else limits.move
        reach = 0.0 if limits is None else AHEAD_REACH * limits.ahead
        self.move = (low - reach, high + reach)
        self.angle = (-math.pi / 2, math.pi / 2) if limits is None else limits.angle
        self.last = 0.0
        self.contract = Contract(f"Controller {controller.name!r}")

    def drive(self, questions: list[Question]) -> list[float]:
        """The commands (rad) of a drive from the start."""
        self.controller.reset()
        self.last = 0.0
        return [self.step(question) for question in questions]

    def drive_bend(self) -> None:
        """A drive through a bend, beside its centre line."""
        self.controller.reset()
        self.last = 0.0
        for station in np.arange(40.0, 60.0):
            ahead = RoadAhead(_BEND, float(station), np.full(80, 15.0))
            self.step((np.array([0.0, 0.01, 0.0, 0.1]), 15.0, np.zeros(1)), road=ahead)

    def step(self, question: Question, **road: RoadAhead) -> float:
        """The command (rad) of one step, tested; `InvalidInput` passes."""
        state, speed, reference = question
        arrays = state.copy(), reference.copy()
        for array in arrays:
            array.flags.writeable = False
        variables = None if self.variables is None else self.variables(state, speed, reference)
        question_text = (
            f"state {np.round(state, 6).tolist()}, speed {speed:g} m/s, reference {reference[:3].tolist()}..."
        )
        try:
            answer = step_call(self.controller)(self.controller.step, arrays[0], speed, arrays[1], variables, **road)
            angle, move, *_ = command_of(answer, self.last)
        except InvalidInput:
            raise
        except Exception as error:
            clause = "a step, also with read-only arrays, must raise nothing but InvalidInput"
            raise self.contract.breach(clause, f"{type(error).__name__} ({error}) at {question_text}") from error
        pairs = zip(arrays, (state, reference), strict=True)
        unchanged = all(np.array_equal(*pair, equal_nan=True) for pair in pairs)
        self.contract.require(unchanged, "it must not write to its arguments", f"it did at {question_text}")
        is_finite = math.isfinite(angle) and math.isfinite(move)
        evidence = f"angle {angle!r} rad, move {move!r} rad at {question_text}"
        self.contract.require(is_finite, "a command must be finite", evidence)
        is_change = abs(move - (angle - self.last)) <= COMMAND_TOLERANCE
        evidence = f"{move!r} instead of {angle - self.last!r} rad at {question_text}"
        self.contract.require(is_change, "`move` must be the change of `angle`", evidence)
        for name, value, (low, high) in (("angle", angle, self.angle), ("move", move, self.move)):
            is_within = low - COMMAND_TOLERANCE <= value <= high + COMMAND_TOLERANCE
            evidence = f"{value!r} rad, limits {(low, high)} at {question_text}"
            self.contract.require(is_within, f"a command must keep the limits on the {name}", evidence)
        self.last = angle
        return angle

    def expect_equal(self, commands: list[float], expected: list[float], clause: str) -> None:
        difference = float(np.abs(np.subtract(commands, expected)).max())
        self.contract.require(difference <= COMMAND_TOLERANCE, clause, f"{commands} against {expected} rad")

    def survives(self, question: Question) -> None:
        """A sane step, a broken one, a sane one again."""
        sane = (np.zeros(4), 15.0, np.full(50, 0.5))
        self.drive([sane])
        try:
            self.step(question)
        except InvalidInput:
            return
        try:
            self.step(sane)
        except InvalidInput as error:
            raise self.contract.breach("after a broken measurement a sane one must be answered", error) from error


def _drives() -> Iterator[list[Question]]:
    """Sane situations: each a few steps of a drive at one speed, on a straight and through a change of lane."""
    random = np.random.default_rng(0)
    ahead = np.arange(80.0)
    for speed in CHECK_SPEEDS:
        for offset, height in ((0.0, 0.0), (0.3, 0.0), (0.0, 3.5), (-1.0, 3.5)):
            path = height * 0.5 * (1.0 - portable.cos(np.pi * np.clip((ahead - 5.0) / 40.0, 0.0, 1.0)))
            state = random.normal((0.0, 0.0, 0.0, offset), (0.1, 0.02, 0.02, 0.1), (CHECK_STEPS, 4))
            yield [(state[k], speed, path[k:]) for k in range(CHECK_STEPS)]


def _broken() -> Iterator[Question]:
    """One number after the other that no sensor should give."""
    for number in BAD:
        for place in range(4):
            state = np.zeros(4)
            state[place] = number
            yield state, 15.0, np.zeros(50)
        yield np.zeros(4), number, np.zeros(50)
        for place in (0, 1, 49):
            reference = np.zeros(50)
            reference[place] = number
            yield np.zeros(4), 15.0, reference
    yield np.zeros(4), 0.0, np.zeros(50)
    yield np.zeros(4), -3.0, np.zeros(50)
    yield np.zeros(4), 15.0, np.zeros(1)
