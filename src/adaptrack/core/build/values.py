"""Expressions in C, with their types, and values that are known when a kernel is translated."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from .c_types import (
    BITS,
    BOOL,
    DOUBLE,
    EIGHT,
    INT64,
    NOTHING,
    NUMBER_KINDS,
    ArrayOf,
    CNumber,
    PlaceOf,
    RecordOf,
    TupleOf,
)


class Binding(IntEnum):
    """How tightly the outermost operator of an expression binds; what binds less than its place needs parentheses."""

    ATOM, UNARY, PRODUCT, SUM, SHIFTED, ORDER, EQUAL, BIT, AND, OR, CHOICE = range(11)


@dataclass(frozen=True)
class Value:
    """An expression in C.

    The text of a `PlaceOf` is an address. writes: its evaluation writes to memory, so that its place in the order of
    evaluation matters; embedded: of an array within a record, its numbers and its sizes.
    """

    text: str
    kind: Any
    level: int = Binding.ATOM
    writes: bool = False
    embedded: tuple[str, tuple[int, ...]] = ("", ())

    def at(self, level: int) -> str:
        """The text where an operand must bind at least as tightly as this."""
        return f"({self.text})" if self.level > level else self.text

    @property
    def data(self) -> str:
        """The place of the first number of an array."""
        return self.embedded[0] or f"{self.text}.data"

    def size(self, dimension: int) -> str:
        """The size of a dimension of an array."""
        return str(self.embedded[1][dimension]) if self.embedded[0] else f"{self.text}.size[{dimension}]"


@dataclass(frozen=True)
class StaticValue:
    """A value that is known when a kernel is translated, or a tuple whose parts are expressions.

    name: of a number, under which the source knows it.
    """

    value: Any
    name: str = ""

    @property
    def is_known(self) -> bool:
        """Whether no part is an expression."""
        return not (isinstance(self.value, tuple) and any(isinstance(part, Value) for part in self.value))


Operand = Value | StaticValue


def static_part(value: Any) -> Operand:
    """A part of a known value; an expression is itself."""
    return value if isinstance(value, Value) else StaticValue(value)


def is_number(value: Any) -> bool:
    """Whether a constant is a number."""
    return isinstance(value, bool | int | float | np.number | np.bool_)


def is_row_of_numbers(value: Any) -> bool:
    """Whether a constant is a tuple of numbers."""
    return isinstance(value, tuple) and len(value) > 0 and all(map(is_number, value))


def literal(value: Any) -> Value:
    """A number in C."""
    if isinstance(value, bool | np.bool_):
        return Value("true" if value else "false", BOOL)
    if isinstance(value, int | np.integer):
        number = int(value)
        if number >= 2**63:
            return Value(f"UINT64_C({number})", BITS)
        if abs(number) < 2**31:
            return Value(str(number), INT64, Binding.UNARY if number < 0 else Binding.ATOM)
        return Value("INT64_MIN" if number == -(2**63) else f"INT64_C({number})", INT64)
    if math.isnan(value):
        return Value("NOT_A_NUMBER", DOUBLE)
    if math.isinf(value):
        return Value("INFINITE" if value > 0 else "-INFINITE", DOUBLE, Binding.ATOM if value > 0 else Binding.UNARY)
    return Value(repr(float(value)), DOUBLE, Binding.UNARY if math.copysign(1.0, value) < 0 else Binding.ATOM)


def join_kinds(a: Any, b: Any) -> Any:
    """The type of what is one or the other; None where there is none.

    A record that stays where it is, or a value, is a value: the place of a value ends with its function.
    """
    if a == b or b is None:
        return a
    if a is None:
        return b
    if a in NUMBER_KINDS and b in NUMBER_KINDS:
        return NUMBER_KINDS[max(NUMBER_KINDS.index(a), NUMBER_KINDS.index(b))]
    a, b = (kind.record if isinstance(kind, PlaceOf) else kind for kind in (a, b))
    if a == b:
        return a
    if isinstance(a, TupleOf) and isinstance(b, TupleOf) and len(a.of) == len(b.of):
        parts = tuple(map(join_kinds, a.of, b.of))
        return None if None in parts else TupleOf(parts)
    return None


@dataclass(frozen=True)
class NamedNumber:
    """A number of a file of kernels, with its name there."""

    name: str
    kind: Any
    text: str


@dataclass(frozen=True)
class NumberTable:
    """Numbers that are known, from which one is taken by its place."""

    of: Any
    values: tuple[float, ...]


def formula(text: str, kind: Any, level: int, *operands: Value) -> Value:
    """An expression of operands; it writes to memory where one of them does."""
    return Value(text, kind, level, any(operand.writes for operand in operands))


def place_of(text: str, record: RecordOf) -> Value:
    """The place of the record that a text names."""
    return Value(f"&{text}", PlaceOf(record), Binding.UNARY)


def loaded(place: Value) -> Value:
    """The record at a place, as a value."""
    record = place.kind.record
    if place.text.startswith("&"):
        return formula(place.text[1:], record, Binding.ATOM, place)
    return formula(f"*{place.at(Binding.UNARY)}", record, Binding.UNARY, place)


def cast_to(kind: CNumber, value: Value) -> Value:
    """A number as one of a type."""
    return formula(f"({kind.c}){value.at(Binding.UNARY)}", kind, Binding.UNARY, value)


def is_fixed(value: Value) -> bool:
    """Whether a value cannot change while others are computed."""
    return not value.writes and re.fullmatch(r"[-&]?[\w.]+|@\d+@", value.text) is not None


def describe(kind: Any) -> str:
    """A type in words."""
    words = {DOUBLE: "a real number", INT64: "a whole number", BOOL: "a truth value", EIGHT: "eight numbers",
             BITS: "bits", NOTHING: "nothing", None: "nothing"}  # fmt: skip
    if isinstance(kind, CNumber) or kind is None:
        return words[kind]
    if isinstance(kind, ArrayOf):
        return f"an array of {kind.ndim} dimensions"
    if isinstance(kind, PlaceOf):
        return f"a record {kind.record.kind.__name__} in its place"
    if isinstance(kind, RecordOf):
        return f"a record {kind.kind.__name__}"
    return f"{len(kind.of)} values"
