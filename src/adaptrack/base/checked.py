"""Argument checks from annotations: a signature states which numbers, names and objects a call accepts.

    @checked
    def plan_speed(road: Road, *, spacing: Annotated[Finite, within(0.01, 100.0), "m"] = 1.0) -> SpeedPlan: ...

The decorator `checked` validates the arguments of a function, or the fields of a dataclass when an object is built. It
validates each argument whose annotation contains a type of this module, a constraint of pydantic (`pydantic.Field`) or
a `Literal`. The body receives plain floats, ints and tuples. Every real number is accepted as a number: NumPy scalars,
fractions, integers. Booleans, text, NaN and integers too large for a float are rejected. A rejected value raises
`InvalidInput`. The message names the call, the argument, its value and unit, the accepted values and a remedy if there
is one:

    plan_speed: spacing = -1 m: must be a finite number >= 0.01 and <= 100.

An annotation may also consist of classes of this package, text, paths and functions (`Road`, `Vehicle | str | None`).
The argument must then be an instance of one of these classes:

    plan_speed: road = <Vehicle van>: must be a Road.

Docstrings do not repeat these errors under "Raises". After the type, `Annotated` may contain:

- a string: the unit;
- a `Hint`: the end of the error message;
- a `RequestLimit` of `adaptrack.base.limits`: an upper bound with its reason.

Function bodies check conditions on several arguments. Code that runs in every control period calls `real`,
`whole_number` and `reals` instead of using the decorator.
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
from pydantic import AfterValidator, BeforeValidator, Field, TypeAdapter, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import PydanticCustomError, core_schema

from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.base.limits import RequestLimit
from adaptrack.core.maths.portable import Array

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
"""A real number or infinity; NaN is rejected."""
Finite = Annotated[float, Field(allow_inf_nan=False), _REAL]
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False), _REAL]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False), _REAL]
Share = Annotated[float, Field(ge=0.0, le=1.0, allow_inf_nan=False), _REAL]
Bound = Annotated[float, Field(gt=0.0, allow_inf_nan=True), _REAL]
"""A positive number; infinity stands for "unbounded"."""
Whole = Annotated[int, _WHOLE]
Count = Annotated[int, Field(ge=1), _WHOLE]
Natural = Annotated[int, Field(ge=0), _WHOLE]
"""A whole number that is at least 0, such as a seed."""


def _rising(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError("must be (low, high) with low <= high.")
    return pair


RISING = AfterValidator(_rising)
"""Constraint on a pair of numbers: the first is at most the second."""


class Hint(NamedTuple):
    """End of the error message of an annotated argument: a remedy, or the meaning of a special value."""

    text: str
    """Clause without a full stop."""


def within(low: float, high: float) -> Any:
    """Return the constraint that a number lies between `low` and `high`, both included."""
    return Field(ge=low, le=high)


def checked(target: CheckedTarget) -> CheckedTarget:
    """Decorate a function, a method or a dataclass so that each call checks its arguments by their annotations.

    The module's docstring lists what is checked. Annotations are read at the first call. They may use names that are
    imported for type checkers only.
    """
    if isinstance(target, type):
        namespaces = [vars(sys.modules[parent.__module__]) for parent in target.__mro__]
        target.__init__ = _checked(target.__init__, namespaces)  # type: ignore[misc]
        return target
    return typing.cast(CheckedTarget, _checked(target, [inspect.unwrap(target).__globals__]))


def check_parameters(instance: object) -> None:
    """Check each attribute of an object against the annotation of the argument of `__init__` with the same name.

    scikit-learn requires that an estimator stores its arguments unchecked; `fit` calls this function.
    """
    kind: Any = type(instance)
    for name, argument in _arguments_of(kind).items():
        argument.check(getattr(instance, name), kind.__init__, (instance,))


@functools.cache
def _arguments_of(kind: Any) -> dict[str, _Argument]:
    return _arguments(kind.__init__, [vars(sys.modules[parent.__module__]) for parent in kind.__mro__])[1]


def _checked(function: Callable[..., Any], namespaces: Sequence[Mapping[str, Any]]) -> Callable[..., Any]:
    arguments = functools.cache(lambda: _arguments(function, namespaces))

    @functools.wraps(function)
    def call(*args: Any, **kwargs: Any) -> Any:
        by_position, by_name = arguments()
        values = list(args)
        for position, argument in by_position:
            if position < len(args):
                values[position] = argument.check(args[position], function, args)
        for name, value in kwargs.items():
            if name in by_name:
                kwargs[name] = by_name[name].check(value, function, args)
        return function(*values, **kwargs)

    return call


class _Argument(NamedTuple):
    """An argument that is checked."""

    name: str
    annotation: Any
    validate: Callable[[Any], Any]
    """Returns the converted value; raises pydantic's `ValidationError`."""

    def check(self, value: Any, function: Callable[..., Any], args: tuple[Any, ...]) -> Any:
        """Return the validated value of this argument of a call of `function`, or raise InvalidInput, which names it.

        args: all positional arguments of the call, including `self` of a method.
        """
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
        if details["type"] == "value_error":  # the full sentence of a validator, such as `RequestLimit`
            return f"{name} = {format_value(value)}{unit}: {details['ctx']['error']}"
        must = _classes_in_words(annotation) or _container(field) or allowed(field)
        must = must or details["msg"].removeprefix("Input should be ")
        none = " or None" if type(None) in _parts(annotation) else ""
        hint = next((f"; {note.text}" for note in metadata if isinstance(note, Hint)), "")
        return f"{name} = {format_value(value)}{unit}: must be {must}{none}{hint}."


# -- checks without annotations: for calls in every control period, for rows and tables -------------------------------
def real(where: str, name: str, value: object, measured: bool = False) -> float:
    """Return a real number as a float; measured: whether NaN stands for a missing one, which the message says.

    Raises InvalidInput, beginning with `where` and `name`, for a value that is no number, such as a Boolean or text, or
    that is too large for a float.
    """
    if isinstance(value, bool) or not isinstance(value, numbers.Real):
        remark = " (NaN if it was not measured)" if measured else ""
        raise InvalidInput(f"{where}: {name} = {format_value(value)}: must be a number{remark}.")
    try:
        return float(value)
    except OverflowError:
        raise InvalidInput(f"{where}: {name} = {format_value(value)}: must be finite, it is too large.") from None


def whole_number(where: str, name: str, value: object, least: int = 1) -> int:
    """Return a whole number >= `least` as an int; else raise InvalidInput, beginning with `where` and `name`."""
    if isinstance(value, bool) or not isinstance(value, numbers.Integral) or value < least:
        raise InvalidInput(f"{where}: {name} = {format_value(value)}: must be a whole number, at least {least}.")
    return int(value)


def reals(name: str, values: Any) -> Array:
    """Return numbers as a float64 array of the same shape.

    A masked entry becomes NaN. A number too large for float64 becomes infinity. A float64 array is returned without a
    copy. Raises InvalidInput for values that are no real numbers, such as Booleans or text, and for rows of different
    lengths.
    """
    if type(values) is np.ndarray and values.dtype is FLOAT:
        return values
    try:
        array = np.asarray(values)
        if array.dtype == object:  # whole numbers beyond 64 bits, decimals, fractions
            array = np.array([_entry(value) for value in array.ravel()]).reshape(array.shape)
    except Exception:  # a foreign object may raise any exception when it is converted to numbers
        array = np.empty(0, dtype=str)
    if array.dtype is FLOAT and isinstance(values, tuple | list | float):
        return array
    if array.dtype.kind not in "iuf":
        raise InvalidInput(f"{name} = {format_value(values)}: must be real numbers.")
    with np.errstate(over="ignore"):  # the given type may hold larger numbers than float64
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
    """Namespace in which an annotation is evaluated. A name that only type checkers import stands for any object."""

    def __init__(self, namespaces: Sequence[Mapping[str, Any]]) -> None:
        self._defined = ChainMap(*map(dict, namespaces), globals(), vars(builtins))

    def __missing__(self, name: str) -> Any:
        return self._defined.get(name, _ForTypeCheckers)


class _ForTypeCheckers:
    """Placeholder of a type that is imported for type checkers only."""

    def __class_getitem__(cls, item: Any) -> type[_ForTypeCheckers]:
        return cls


def _arguments(
    function: Callable[..., Any], namespaces: Sequence[Mapping[str, Any]]
) -> tuple[list[tuple[int, _Argument]], dict[str, _Argument]]:
    """Return the checked arguments of a function: (position, argument) of the positional ones, and all by name."""
    annotations = inspect.get_annotations(inspect.unwrap(function), locals=_Names(namespaces), eval_str=True)
    annotations.pop("return", None)
    fields = {
        name: _Argument(name, annotation, _validator(checks))
        for name, annotation in annotations.items()
        if _is_checked(checks := _with_classes(annotation)) or typing.get_origin(_without_none(annotation)) is Literal
    }
    parameters = inspect.signature(function).parameters.values()
    kinds = (inspect.Parameter.POSITIONAL_ONLY, inspect.Parameter.POSITIONAL_OR_KEYWORD)
    positional = [parameter.name for parameter in parameters if parameter.kind in kinds]
    return [(position, fields[name]) for position, name in enumerate(positional) if name in fields], fields


@functools.cache
def _validator(annotation: Any) -> Callable[[Any], Any]:
    return TypeAdapter(annotation).validator.validate_python


class _Class(NamedTuple):
    """Constraint that a value is an instance of a class; the value is passed on unchanged."""

    kind: type

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        return core_schema.is_instance_schema(self.kind)


def _with_classes(annotation: Any) -> Any:
    """Return the annotation with an instance check for every class in it.

    The annotation is returned unchanged in two cases: `_is_checked_class` holds for no part, or some part
    cannot be checked.
    """
    parts = _parts(annotation)
    checks = [_class_check(part) for part in parts]
    return reduce(or_, checks) if any(map(_is_checked_class, parts)) and None not in checks else annotation


def _parts(annotation: Any) -> list[Any]:
    """Return the members of a union, or the annotation itself, without units and hints."""
    origin, inner = typing.get_origin(annotation), typing.get_args(annotation)
    if origin in _UNIONS:
        return [part for member in inner for part in _parts(member)]
    return _parts(inner[0]) if origin is Annotated and not _is_constrained(annotation) else [annotation]


def _is_checked_class(part: Any) -> bool:
    """Whether a part of an annotation is a class of the package, text, a path or a function."""
    kind = typing.get_origin(part) or part
    return kind in (str, os.PathLike, Callable) or getattr(kind, "__module__", "").partition(".")[0] == _PACKAGE


def _class_check(part: Any) -> Any:
    """Return a part of an annotation with its check, or None if it cannot be checked (a protocol, for example)."""
    if part is type(None) or _is_checked(part) or typing.get_origin(part) is Literal:
        return part
    kind = typing.get_origin(part) or part
    kind = {float: numbers.Real, int: numbers.Integral}.get(kind, kind)
    unchecked = kind in (Any, _ForTypeCheckers) or not isinstance(kind, type) or getattr(kind, "_is_protocol", False)
    return None if unchecked else Annotated[Any, _Class(kind)]


def _is_checked(annotation: Any) -> bool:
    """Whether an annotation, or any part inside it, constrains a value."""
    return _is_constrained(annotation) or any(_is_checked(part) for part in typing.get_args(annotation))


def _is_constrained(annotation: Any) -> bool:
    """Whether the outermost `Annotated` of an annotation constrains a value."""
    marks = (FieldInfo, BeforeValidator, _Class, RequestLimit)
    return any(isinstance(mark, marks) for mark in _metadata(annotation))


def _metadata(annotation: Any) -> tuple[Any, ...]:
    return typing.get_args(annotation)[1:] if typing.get_origin(annotation) is Annotated else ()


def _without_none(annotation: Any) -> Any:
    """Return `X` for an annotation `X | None`, and any other annotation unchanged."""
    if typing.get_origin(annotation) in _UNIONS:
        members = [member for member in typing.get_args(annotation) if member is not type(None)]
        return members[0] if len(members) == 1 else annotation
    return annotation


def _element(annotation: Any, part: int | str) -> Any:
    """Return the annotation of an element of a tuple, a sequence or a mapping, or None for other annotations."""
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
    """Return the classes that `_with_classes` checks as a phrase, empty if it checks none."""
    parts = [part for part in _parts(annotation) if part is not type(None)]
    if not any(map(_is_checked_class, parts)):
        return ""
    words = {str: "text", os.PathLike: "a path", Callable: "a function"}
    return " or ".join(words.get(typing.get_origin(part) or part) or _noun(part) for part in parts)


def _noun(part: Any) -> str:
    field = FieldInfo.from_annotation(part)
    name = getattr(part, "__name__", "")
    return _container(field) or allowed(field) or f"{'an' if name[:1] in 'AEIOU' else 'a'} {name}"


def _container(field: FieldInfo) -> str:
    """Return the phrase for a tuple, a sequence or a mapping, empty for other types."""
    kind, inner = typing.get_origin(field.annotation), typing.get_args(field.annotation)
    if kind is tuple and inner[-1] is not ...:
        return "a pair" if len(inner) == 2 else f"{len(inner)} values"
    if isinstance(kind, type) and issubclass(kind, Sequence):
        least = next((constraint.min_length for constraint in field.metadata if hasattr(constraint, "min_length")), 0)
        return f"a sequence of {least} or more" if least else "a sequence"
    return "a mapping of names" if isinstance(kind, type) and issubclass(kind, Mapping) else ""


def allowed(field: FieldInfo) -> str:
    """Return the accepted values of a field or an argument as a phrase, empty if they are too complex for one."""
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
