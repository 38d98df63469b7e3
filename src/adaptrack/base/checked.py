"""Arguments checked by their annotations: which numbers, names and objects a call takes stands in its signature.

    @checked
    def plan_speed(road: Road, *, spacing: Annotated[Finite, within(0.01, 100.0), "m"] = 1.0) -> SpeedPlan: ...

A checked function, or a checked dataclass when one is built, validates every argument whose annotation holds a type of
this module or a constraint of pydantic's (`pydantic.Field`), or is a `Literal`. The body gets plain floats, ints and
tuples. Any real number serves as a number (NumPy's, fractions, whole ones); truth values, text, NaN and what no float
holds do not. What is not allowed raises `InvalidInput`, which names the call, the argument, its value and unit, what
is allowed and, where there is one, the remedy:

    plan_speed: spacing = -1 m: must be a finite number >= 0.01 and <= 100.

An annotation that names a class of this package, text, a path or a function (`Road`, `Vehicle | str | None`) needs no
mark: the argument must be an object of one of its classes.

    plan_speed: road = <Vehicle van>: must be a Road.

A docstring has no "Raises" section for that. Beside the type stand in an annotation: text, the unit; a `Hint`; a
`RequestLimit` of `adaptrack.base.limits`. What several arguments must fulfil together is checked in the body, and so is
whatever runs once a control period, by `real`, `whole_number` and `reals`.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import math
import numbers
import os
import sys
import types
import typing
from collections import ChainMap
from collections.abc import Callable, Mapping, Sequence
from functools import reduce
from operator import or_
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError, core_schema

from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.base.limits import RequestLimit

Array = NDArray[np.float64]
FLOAT = np.dtype(np.float64)
CheckedTarget = TypeVar("CheckedTarget", bound=Callable[..., Any])


def _as_float(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise PydanticCustomError("number", "Input should be a number")
    try:
        return float(value)
    except OverflowError:
        raise PydanticCustomError("number", "Input should be finite, it is too large") from None


def _as_int(value: Any) -> int:
    if isinstance(value, bool) or not isinstance(value, numbers.Integral):
        raise PydanticCustomError("number", "Input should be a whole number")
    return int(value)


_PACKAGE = __name__.partition(".")[0]
_UNIONS = (typing.Union, types.UnionType)
_REAL, _WHOLE = BeforeValidator(_as_float), BeforeValidator(_as_int)

Number = Annotated[float, Field(ge=-math.inf, allow_inf_nan=True), _REAL]
"""Any but NaN."""
Finite = Annotated[float, Field(allow_inf_nan=False), _REAL]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False), _REAL]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False), _REAL]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False), _REAL]
Bound = Annotated[float, Field(gt=0.0, allow_inf_nan=True), _REAL]
"""Positive; infinity is no bound."""
Whole = Annotated[int, _WHOLE]
Count = Annotated[int, Field(ge=1), _WHOLE]
Natural = Annotated[int, Field(ge=0), _WHOLE]
"""A whole number from 0, such as a seed."""


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("must be (low, high) with low <= high.")
    return pair


RISING = AfterValidator(_rising)
"""Beside a pair of numbers: the first is not above the second."""


class Hint(NamedTuple):
    """In an annotation: how the message ends, with a remedy or with what a special value means."""

    text: str


def within(low: float, high: float) -> Any:
    """In an annotation: a number from low to high."""
    return Field(ge=low, le=high)


def checked(target: CheckedTarget) -> CheckedTarget:
    """Check the arguments of a function, a method or a dataclass by their annotations, as this module says.

    The annotations are read at the first call; names that only type checkers import may stand in them.
    """
    if isinstance(target, type):
        vars_of = [vars(sys.modules[parent.__module__]) for parent in target.__mro__]
        target.__init__ = _checked(target.__init__, vars_of)  # type: ignore[misc]
        return target
    return typing.cast(CheckedTarget, _checked(target, [inspect.unwrap(target).__globals__]))


def check_parameters(instance: object) -> None:
    """Check the attributes of an object that keeps its parameters as given, by the annotations of its `__init__`.

    So scikit-learn wants it of an estimator: whatever it was built with or set to is refused when it is fitted.
    """
    kind: Any = type(instance)
    for name, argument in _arguments_of(kind).items():
        argument.value(getattr(instance, name), kind.__init__, (instance,))


@functools.cache
def _arguments_of(kind: Any) -> dict[str, _Argument]:
    return _arguments(kind.__init__, [vars(sys.modules[parent.__module__]) for parent in kind.__mro__])[1]


def _checked(function: Callable[..., Any], namespaces: Sequence[Mapping[str, Any]]) -> Callable[..., Any]:
    arguments = functools.cache(lambda: _arguments(function, namespaces))

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        by_place, by_name = arguments()
        values = list(args)
        for place, argument in by_place:
            if place < len(args):
                values[place] = argument.value(args[place], function, args)
        for name, value in kwargs.items():
            if name in by_name:
                kwargs[name] = by_name[name].value(value, function, args)
        return function(*values, **kwargs)

    return call


class _Argument(NamedTuple):
    """An argument that is checked."""

    name: str
    annotation: Any
    validate: Callable[[Any], Any]

    def value(self, value: Any, function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Bind and check the arguments of a call; args: all positional arguments, including a method's self."""
        try:
            return self.validate(value)
        except ValidationError as error:
            names = function.__qualname__.rpartition("<locals>.")[2]
            where = type(args[0]).__name__ if names.endswith(".__init__") else names
            raise InvalidInput(f"{where}: {self._problem(value, error)}") from None

    def _problem(self, value: Any, error: ValidationError) -> str:
        """Return the error text of an argument, from its name to the remedy."""
        details = error.errors(include_url=False)[0]
        name, annotation = self.name, self.annotation
        for part in details["loc"][: -1 if details["type"] == "missing" else None]:
            inner = _element(annotation, part)
            if inner is not None:
                name, annotation = f"{name}[{part!r}]", inner
                inside = isinstance(value, Sequence | Mapping)
                value = typing.cast(Any, value)[part] if inside else details["input"]
        field = FieldInfo.from_annotation(_without_none(annotation))
        metadata = [*field.metadata, *_metadata(_without_none(self.annotation))]
        unit = next((f" {note}" for note in metadata if isinstance(note, str) and _is_number(value)), "")
        if details["type"] == "value_error":  # a Limit's own sentence, or that of `Reals`
            return f"{name} = {format_value(value)}{unit}: {details['ctx']['error']}"
        must = _classes_in_words(annotation) or _container(field) or allowed(field)
        must = must or details["msg"].removeprefix("Input should be ")
        none = " or None" if type(None) in _parts(annotation) else ""
        hint = next((f"; {note.text}" for note in metadata if isinstance(note, Hint)), "")
        return f"{name} = {format_value(value)}{unit}: must be {must}{none}{hint}."


# -- by hand: what runs once a control period, rows and tables ---------------------------------------------------------
def real(where: str, name: str, value: object) -> float:
    """`value` as a float; `InvalidInput` unless it is a number that one holds (truth values and text are none)."""
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        raise InvalidInput(f"{where}: {name} = {format_value(value)}: must be a number.")
    try:
        return float(value)
    except OverflowError:
        raise InvalidInput(f"{where}: {name} = {format_value(value)}: must be finite, it is too large.") from None


def whole_number(where: str, name: str, value: object, least: int = 1) -> int:
    """`value` as an int; `InvalidInput` unless it is a whole number, at least `least`."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise InvalidInput(f"{where}: {name} = {format_value(value)}: must be a whole number, at least {least}.")
    return int(value)


def reals(name: str, values: Any) -> Array:
    """`values` as float64, in their shape: masked entries become NaN, a number beyond the largest one infinity.

    An array of float64 is given back as it is, not copied.

    Raises
    ------
    InvalidInput
        When they are no real numbers (truth values and text are none), or rows are not of one length.
    """
    if type(values) is np.ndarray and values.dtype is FLOAT:
        return values
    try:
        array = np.asarray(values)
        if array.dtype == object:  # whole numbers beyond 64 bits, decimals, fractions
            array = np.array([_entry(value) for value in array.ravel()]).reshape(array.shape)
    except Exception:  # whatever an object of others raises when it is converted to numbers
        array = np.empty(0, dtype=str)
    if array.dtype is FLOAT and isinstance(values, tuple | list | float):
        return array
    if array.dtype.kind not in "iuf":
        raise InvalidInput(f"{name} = {format_value(values)}: must be real numbers.")
    with np.errstate(over="ignore"):  # wider than float64
        row = array.astype(np.float64)
    if isinstance(values, np.ma.MaskedArray):
        row[np.ma.getmaskarray(values)] = np.nan
    return row


def _entry(value: Any) -> float:
    if isinstance(value, bool | str | bytes) or value is None:
        raise TypeError
    try:
        return float(value)
    except OverflowError:
        return np.inf if value > 0 else -np.inf


# -- annotations ------------------------------------------------------------------------------------------------------
class _Names(dict[str, Any]):
    """The names in an annotation; one that is imported for type checkers alone stands for any object."""

    def __init__(self, namespaces: Sequence[Mapping[str, Any]]) -> None:
        self._known = ChainMap(*map(dict, namespaces), globals(), vars(builtins))

    def __missing__(self, name: str) -> Any:
        return self._known.get(name, _ForTypeCheckers)


class _ForTypeCheckers:
    """A type that is not there when the program runs."""

    def __class_getitem__(cls, item: Any) -> type[_ForTypeCheckers]:
        return cls


def _arguments(
    function: Callable[..., Any], namespaces: Sequence[Mapping[str, Any]]
) -> tuple[list[tuple[int, _Argument]], dict[str, _Argument]]:
    """The arguments that are checked, those that may be given by position with their places, and all by name."""
    annotations = inspect.get_annotations(inspect.unwrap(function), locals=_Names(namespaces), eval_str=True)
    annotations.pop("return", None)
    fields = {
        name: _Argument(name, annotation, _validator(checks))
        for name, annotation in annotations.items()
        if _is_checked(checks := _with_classes(annotation)) or typing.get_origin(_without_none(annotation)) is Literal
    }
    every = inspect.signature(function).parameters.values()
    positional = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    listed = [parameter.name for parameter in every if parameter.kind in positional]
    return [(place, fields[name]) for place, name in enumerate(listed) if name in fields], fields


@functools.cache
def _validator(annotation: Any) -> Callable[[Any], Any]:
    return TypeAdapter(annotation).validator.validate_python


class _Class(NamedTuple):
    """In an annotation: an object of a class, which the body gets as it is."""

    kind: type

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.is_instance_schema(self.kind)


def _with_classes(annotation: Any) -> Any:
    """The annotation with a check of every class in it; unchanged where it names none or cannot be checked whole."""
    parts = _parts(annotation)
    checks = [_class_check(part) for part in parts]
    return reduce(or_, checks) if any(map(_names_class, parts)) and None not in checks else annotation


def _parts(annotation: Any) -> list[Any]:
    """The members of a union, each without a unit and a hint."""
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in _UNIONS:
        return [part for member in inner for part in _parts(member)]
    return _parts(inner[0]) if origin is Annotated and not _is_constrained(annotation) else [annotation]


def _names_class(part: Any) -> bool:
    """Whether a part of an annotation is a class of the package, text, a path or a function."""
    kind = typing.get_origin(part) or part
    return kind in (str, os.PathLike, Callable) or getattr(kind, "__module__", "").partition(".")[0] == _PACKAGE


def _class_check(part: Any) -> Any:
    """The check of a part of an annotation; None where there is none, as for protocols."""
    if part is type(None) or _is_checked(part) or typing.get_origin(part) is Literal:
        return part
    kind = typing.get_origin(part) or part
    kind = {float: numbers.Real, int: numbers.Integral}.get(kind, kind)
    unknown = kind in (Any, _ForTypeCheckers) or not isinstance(kind, type) or getattr(kind, "_is_protocol", False)
    return None if unknown else Annotated[Any, _Class(kind)]


def _is_checked(annotation: Any) -> bool:
    """Whether something in an annotation constrains a value."""
    return _is_constrained(annotation) or any(_is_checked(part) for part in typing.get_args(annotation))


def _is_constrained(annotation: Any) -> bool:
    """Whether an annotation itself constrains a value."""
    marks = (FieldInfo, BeforeValidator, _Class, RequestLimit)
    return any(isinstance(mark, marks) for mark in _metadata(annotation))


def _metadata(annotation: Any) -> tuple[Any, ...]:
    return typing.get_args(annotation)[1:] if typing.get_origin(annotation) is Annotated else ()


def _without_none(annotation: Any) -> Any:
    """The annotation of what is given, where it is given: `X` of `X | None`."""
    if typing.get_origin(annotation) in _UNIONS:
        members = [member for member in typing.get_args(annotation) if member is not type(None)]
        return members[0] if len(members) == 1 else annotation
    return annotation


def _element(annotation: Any, part: int | str) -> Any:
    """The annotation of an element of a tuple, a sequence or a mapping; None of something else."""
    annotation = _without_none(annotation)
    if typing.get_origin(annotation) is Annotated:
        annotation = typing.get_args(annotation)[0]
    kind, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if kind is tuple and isinstance(part, int) and inner[-1] is not ...:
        return inner[part]
    if isinstance(kind, type) and issubclass(kind, Sequence):
        return inner[0]
    return inner[1] if isinstance(kind, type) and issubclass(kind, Mapping) else None


def _classes_in_words(annotation: Any) -> str:
    """The classes that `_with_classes` checks; empty where it checks none."""
    parts = [part for part in _parts(annotation) if part is not type(None)]
    if not any(map(_names_class, parts)):
        return ""
    words = {str: "text", os.PathLike: "a path", Callable: "a function"}
    return " or ".join(words.get(typing.get_origin(part) or part) or _noun(part) for part in parts)


def _noun(part: Any) -> str:
    field = FieldInfo.from_annotation(part)
    name = getattr(part, "__name__", "")
    return _container(field) or allowed(field) or f"{'an' if name[:1] in 'AEIOU' else 'a'} {name}"


def _container(field: FieldInfo) -> str:
    """A tuple, a sequence or a mapping in words; empty for anything else."""
    kind, inner = typing.get_origin(field.annotation), typing.get_args(field.annotation)
    if kind is tuple and inner[-1] is not ...:
        return "a pair" if len(inner) == 2 else f"{len(inner)} values"
    if isinstance(kind, type) and issubclass(kind, Sequence):
        least = next((constraint.min_length for constraint in field.metadata if hasattr(constraint, "min_length")), 0)
        return f"a sequence of {least} or more" if least else "a sequence"
    return "a mapping of names" if isinstance(kind, type) and issubclass(kind, Mapping) else ""


def allowed(field: FieldInfo) -> str:
    """Return the accepted values of a field or an argument in words; empty when they are too complex for a phrase."""
    annotation: Any = _without_none(field.annotation)
    if typing.get_origin(annotation) is Literal:
        return "one of " + ", ".join(repr(word) for word in typing.get_args(annotation))
    infinite = any(getattr(constraint, "allow_inf_nan", False) for constraint in field.metadata)
    noun = {
        float: "a number" if infinite else "a finite number",
        int: "a whole number",
        str: "text",
        bool: "true or false",
    }
    if annotation not in noun:
        return ""
    signs = (("gt", ">"), ("ge", ">="), ("lt", "<"), ("le", "<="))
    bounds = [
        f"{sign} {getattr(constraint, name):.6g}"
        for name, sign in signs
        for constraint in field.metadata
        if getattr(constraint, name, None) is not None and abs(getattr(constraint, name)) < math.inf
    ]
    return " ".join([noun[annotation], " and ".join(bounds)]).strip()


def _is_number(value: Any) -> bool:
    return isinstance(value, numbers.Real) and not isinstance(value, bool)
