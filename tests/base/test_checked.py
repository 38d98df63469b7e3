"""What a signature says of its arguments holds when it is called, and the refusal says what to give instead."""

from __future__ import annotations

import ast
import dataclasses
import fractions
import inspect
import math
import pickle
import typing
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import Field

import adaptrack
from adaptrack.base import checked as checks
from adaptrack.base.checked import Bound, Count, Finite, Hint, Natural, NotNegative, Number, Positive, Share, checked
from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.base.files import Record, build
from adaptrack.base.limits import CONTROL_HORIZON, MAX_SPEED

if TYPE_CHECKING:
    from nowhere import Elsewhere

NO_NUMBERS: tuple[Any, ...] = (math.nan, "1", b"1", True, np.True_, 1j, [1.0], np.ones(1), None, object())


@checked
@dataclass(frozen=True)
class Box:
    """Two sizes."""

    width: Annotated[Positive, "m"]
    most: Annotated[Bound, "m", Hint("inf: no limit")] = math.inf


@checked
def drive(
    road: Elsewhere[int],
    *,
    speed: Annotated[Positive, "m/s", MAX_SPEED] = 1.0,
    moves: Annotated[Count, CONTROL_HORIZON] = 1,
    angle: Annotated[tuple[Finite, Finite], "rad", Hint("give (low, high)")] = (0.0, 1.0),
    weights: Mapping[str, NotNegative] | None = None,
    widths: Sequence[Count] = (1,),
    kind: Literal["pulse", "laguerre"] | None = None,
    unsure: Annotated[adaptrack.Uncertainty, Hint("Uncertainty(lag) gives one")] | None = None,
    pause: Annotated[Positive, "s"] | None = None,
    pole: Annotated[Finite, Field(ge=0.0, lt=1.0)] = 0.5,
) -> dict[str, Any]:
    """All that it got."""
    return locals()


class Car:
    """Something with methods."""

    @checked
    def __init__(self, mass: Annotated[Positive, "kg"]) -> None:
        self.mass = mass

    @checked
    def load(self, mass: Annotated[NotNegative, "kg"], *, seats: Count = 1) -> float:
        """kg, of the loaded car"""
        return self.mass + seats * mass

    @classmethod
    @checked
    def of(cls, mass: Annotated[Positive, "kg"] = 1.0) -> Car:
        """A car."""
        return cls(mass)


class Truck(Car):
    """A kind of it."""


class Body(Record):
    """From a file."""

    mass: Positive = Field(description="kg")
    moves: Annotated[Count, CONTROL_HORIZON] = 1


def refusal(call: Any) -> str:
    """The sentence by which a call is refused."""
    with pytest.raises(InvalidInput) as refused:
        call()
    return str(refused.value)


@pytest.mark.parametrize("kind", [Number, Finite, Positive, NotNegative, Share, Bound, Count, Natural])
def test_no_type_takes_what_is_no_number_or_too_large_for_one(kind):
    def take(value: Any) -> Any:
        return value

    take.__annotations__["value"] = kind
    for no_number in (*NO_NUMBERS, fractions.Fraction(10**400, 3)):
        assert refusal(lambda value=no_number: checked(take)(value)).endswith(".")


def test_numbers_of_every_kind_arrive_as_plain_ones():
    for number in (2, 2.0, np.float32(2.0), np.int8(2), np.float64(2.0), fractions.Fraction(2)):
        got = drive(None, speed=number, angle=[number, number], weights={"q": number}, pause=number)
        for value in (got["speed"], *got["angle"], got["weights"]["q"], got["pause"]):
            assert type(value) is float
            assert value == 2.0
    assert type(drive(None, moves=np.int64(3))["moves"]) is int
    assert drive(None)["angle"] == (0.0, 1.0)
    assert type(Box(np.float32(2)).width) is float


@pytest.mark.parametrize(("arguments", "sentence"), [
    ({"speed": -1}, "drive: speed = -1 m/s: must be a finite number > 0."),
    (
        {"speed": 1e9},
        "drive: speed = 1000000000.0 m/s: at most 100 m/s (360 km/h; at higher speeds tyre dynamics need",
    ),
    ({"moves": 0}, "drive: moves = 0: must be a whole number >= 1."),
    ({"moves": 10**9}, "drive: moves = 1000000000: at most 200 control periods (the time of a QP grows"),
    ({"angle": 3.0}, "drive: angle = 3.0 rad: must be a pair; give (low, high)."),
    ({"angle": (0.0, math.inf)}, "drive: angle[1] = inf rad: must be a finite number; give (low, high)."),
    ({"weights": {"q": -1}}, "drive: weights['q'] = -1: must be a finite number >= 0."),
    ({"weights": 3}, "drive: weights = 3: must be a mapping of names or None."),
    ({"widths": (1, 0)}, "drive: widths[1] = 0: must be a whole number >= 1."),
    ({"widths": 3}, "drive: widths = 3: must be a sequence."),
    ({"kind": "puls"}, "drive: kind = 'puls': must be one of 'pulse', 'laguerre' or None."),
    ({"unsure": 2.0}, "drive: unsure = 2.0: must be an Uncertainty or None; Uncertainty(lag) gives one."),
    ({"pause": 0}, "drive: pause = 0 s: must be a finite number > 0 or None."),
    ({"pole": 1.0}, "drive: pole = 1.0: must be a finite number >= 0 and < 1."),
])  # fmt: skip
def test_a_refusal_names_call_argument_value_unit_and_what_is_allowed(arguments, sentence):
    assert refusal(lambda: drive(None, **arguments)).startswith(sentence)


def test_objects_and_methods_are_checked_by_position_and_by_name_under_their_own_names():
    assert refusal(lambda: Box(-1)) == "Box: width = -1 m: must be a finite number > 0."
    assert refusal(lambda: Box(width=1.0, most=0)) == "Box: most = 0 m: must be a number > 0; inf: no limit."
    assert refusal(lambda: dataclasses.replace(Box(1.0), width=math.nan)).startswith("Box: width = nan m")
    assert refusal(lambda: Truck(0)).startswith("Truck: mass = 0 kg")
    assert refusal(lambda: Car(1.0).load(-1)).startswith("Car.load: mass = -1 kg")
    assert refusal(lambda: Car(1.0).load(mass=1.0, seats=0)).startswith("Car.load: seats = 0")
    assert refusal(lambda: Truck.of(math.inf)).startswith("Car.of: mass = inf kg")
    assert Truck.of(2).load(3, seats=2) == 8.0


def test_a_checked_call_keeps_its_signature_and_its_own_errors():
    assert list(inspect.signature(Box).parameters) == ["width", "most"]
    assert inspect.signature(drive).parameters["moves"].default == 1
    assert drive.__doc__ == "All that it got."
    assert pickle.loads(pickle.dumps(Box(1.0, 2.0))) == Box(1.0, 2.0)
    with pytest.raises(TypeError, match="positional argument"):
        drive(None, 1.0)  # type: ignore[misc]
    with pytest.raises(TypeError, match="unexpected keyword"):
        drive(None, sped=1.0)  # type: ignore[call-arg]


def test_fields_of_files_take_the_same_types_in_the_same_words():
    assert build(Body, {"mass": 3, "moves": 2}, "a.toml").mass == 3.0
    for mass in (-1.0, "a", True, math.nan, math.inf):
        with pytest.raises(ConfigError, match=r"a.toml: mass = .*: must be a finite number > 0 \(kg\)"):
            build(Body, {"mass": mass}, "a.toml")
    with pytest.raises(ConfigError, match=r"moves = 201: at most 200 control periods \(the time"):
        build(Body, {"mass": 1.0, "moves": 201}, "a.toml")
    assert "moves = 0: must be a whole number >= 1" in refusal(lambda: Body(mass=1.0, moves=0))


def names_in(tree: ast.AST | None) -> set[str]:
    """The names that an expression mentions."""
    return {node.id for node in ast.walk(tree) if isinstance(node, ast.Name)} if tree is not None else set()


def unchecked(path: Path) -> list[str]:
    """The calls of a module with an annotation that nobody holds them to."""
    module = ast.parse(path.read_text(encoding="utf-8"))
    types = {
        alias.name
        for statement in module.body
        if isinstance(statement, ast.ImportFrom) and statement.module == "adaptrack.base.checked"
        for alias in statement.names
        if typing.get_origin(getattr(checks, alias.name)) is Annotated
    }
    types |= {
        target.id
        for statement in module.body
        if isinstance(statement, ast.Assign) and names_in(statement.value) & types
        for target in statement.targets
        if isinstance(target, ast.Name)
    }
    result, checks_parameters = [], "check_parameters" in names_in(module)
    for node in ast.walk(module):
        if isinstance(node, ast.FunctionDef) and node.name == "__init__" and checks_parameters:
            continue
        if isinstance(node, ast.FunctionDef):
            parameters = [*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs]
            annotations = [argument.annotation for argument in parameters]
        elif isinstance(node, ast.ClassDef) and not any(
            names_in(base) & {"Record", "RecordSettings", "Regressor"}
            for base in node.bases  # which check them when they are made or trained
        ):
            annotations = [line.annotation for line in node.body if isinstance(line, ast.AnnAssign)]
        else:
            continue
        is_checked = any("checked" in names_in(decorator) for decorator in node.decorator_list)
        if not is_checked and any(names_in(annotation) & types for annotation in annotations):
            result.append(f"{path.name}: {node.name}")
    return result


def test_every_call_whose_annotations_promise_a_check_makes_it(tmp_path):
    modules = sorted(Path(adaptrack.__file__).parent.rglob("*.py"))
    assert not [call for path in modules if path.parent.name != "base" for call in unchecked(path)]
    module = tmp_path / "made.py"
    module.write_text(
        "from adaptrack.base.checked import Positive, checked\nShort = Positive\n"
        "def held(a: int) -> None: ...\ndef broken(a: Short) -> None: ...\n@checked\ndef kept(a: Positive): ...\n"
    )
    assert unchecked(module) == ["made.py: broken"]
