"""Types of the values in kernels, and their structs in C.

A number is a double, an int64_t, a bool or a uint64_t; eight numbers at once are an `eight`. An array is a struct of
the place of its first number and its sizes. A record is a struct with the fields of the record; a record that stays
where it is (`kernel.Place`, `kernel.Row`) is a pointer to it. Each struct has the layout that Python gives to records
(`kernel.Resident`, `kernel.record`): words of 8 bytes.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from importlib import import_module
from typing import Any

from .. import kernel
from .scopes import comment, comment_after, remarks

PREFIX = "adaptrack_"
"""Of the names that other programs call."""


@dataclass(frozen=True)
class CNumber:
    """A number, or no value at all."""

    c: str


DOUBLE, INT64, BOOL, BITS = CNumber("double"), CNumber("int64_t"), CNumber("bool"), CNumber("uint64_t")
EIGHT = CNumber("eight")
"""Eight real numbers, see `maths.vectors`."""
NOTHING = CNumber("void")
NUMBER_KINDS = (BOOL, INT64, DOUBLE)
"""In the order in which one is converted to the next."""


@dataclass(frozen=True)
class ArrayOf:
    """A C-contiguous array; is_strided: a column of a matrix, whose numbers lie a row apart."""

    of: Any
    ndim: int
    is_strided: bool = False

    @cached_property
    def name(self) -> str:
        """The name of the struct, and the beginning of the names of its functions."""
        if self.is_strided:
            return "column"
        if isinstance(self.of, RecordOf):
            return f"rows_of_{self.of.name}"
        name = {1: "vector", 2: "matrix", 3: "cube"}.get(self.ndim, f"array{self.ndim}")
        return name if self.of == DOUBLE else f"whole_{name}"

    @property
    def c(self) -> str:
        """The type in C."""
        return f"struct {self.name}"

    @property
    def row(self) -> ArrayOf:
        """The type of what an index of the first dimension leaves."""
        return ArrayOf(self.of, self.ndim - 1)


@dataclass(frozen=True)
class RecordOf:
    """A record as a value."""

    kind: Any

    @cached_property
    def name(self) -> str:
        """The name of the struct: the file and the record."""
        return f"{short_module(self.kind.__module__)}_{self.kind.__name__}"

    @property
    def c(self) -> str:
        """The type in C."""
        return f"struct {self.name}"

    @cached_property
    def fields(self) -> dict[str, Any]:
        """The types of its fields."""
        return {name: field_type(kind) for name, kind in self.kind.kinds.items()}

    def is_embedded(self, name: str) -> bool:
        """Whether a field holds its numbers itself, ``(type, count)``."""
        return type(self.kind.kinds[name]) is tuple


@dataclass(frozen=True)
class PlaceOf:
    """A record that stays where it is: a pointer."""

    record: RecordOf

    @property
    def c(self) -> str:
        """The type in C."""
        return f"{self.record.c} *"


@dataclass(frozen=True)
class TupleOf:
    """Several values."""

    of: tuple[Any, ...]

    @cached_property
    def name(self) -> str:
        """The name of the struct."""
        return "_".join(["tuple", *map(plain_name, self.of)])

    @property
    def c(self) -> str:
        """The type in C."""
        return f"struct {self.name}"


def plain_name(kind: Any) -> str:
    """A type as a part of a name."""
    if isinstance(kind, PlaceOf):
        return f"at_{kind.record.name}"
    return str(kind.c) if isinstance(kind, CNumber) else str(kind.name)


def short_module(module: str) -> str:
    """The name of a file of kernels as a part of names in C."""
    return module.removeprefix("adaptrack.core.").removeprefix("adaptrack.").replace(".", "_")


# -- from the types of signatures and records -------------------------------------------------------------------------
_SCALARS = {"float64": DOUBLE, "int64": INT64, "boolean": BOOL, "void": NOTHING}


def field_type(kind: Any) -> Any:
    """The type of a field of a record as it is read; ``(type, count)``: an array."""
    if isinstance(kind, kernel.Scalar):
        return _SCALARS[kind.name]
    if isinstance(kind, kernel.Array):
        return ArrayOf(field_type(kind.of), kind.ndim)
    if type(kind) is tuple:
        return ArrayOf(field_type(kind[0]), len(kind) - 1)
    return RecordOf(kind)


def argument_type(kind: Any) -> Any:
    """The type of an argument of a signature; a record is a value, unless it is a `Place` or a `Row`."""
    return PlaceOf(RecordOf(kind.of)) if isinstance(kind, kernel.Place) else field_type(kind)


def returned_type(signature: kernel.Signature) -> Any:
    """The type of what a kernel returns."""
    kinds = tuple(map(field_type, signature.returns))
    return kinds[0] if len(kinds) == 1 else TupleOf(kinds)


# -- structs ----------------------------------------------------------------------------------------------------------
def parts_of(kind: Any) -> Iterator[Any]:
    """The types that the struct of a type needs to be defined before it."""
    if isinstance(kind, ArrayOf):
        yield kind.of
        if kind.ndim > 1:
            yield kind.row
    elif isinstance(kind, RecordOf):
        for name, field in kind.fields.items():
            yield field.of if kind.is_embedded(name) else field
    elif isinstance(kind, PlaceOf):
        yield kind.record
    elif isinstance(kind, TupleOf):
        yield from kind.of


def add_with_parts(kind: Any, kinds: dict[Any, None]) -> None:
    """Add a type to those whose structs are needed, behind those within it."""
    if kind in kinds or kind is None:
        return
    for part in parts_of(kind):
        add_with_parts(part, kinds)
    kinds[kind] = None


def definition(kind: Any) -> str:
    """The struct of a type, and the functions of an array; empty for a number."""
    if isinstance(kind, ArrayOf):
        return "" if kind.is_strided else _array(kind)
    if isinstance(kind, RecordOf):
        return record_struct(kind)
    if isinstance(kind, TupleOf):
        fields = "".join(f"    {declare_c(field, f'v{i}')};\n" for i, field in enumerate(kind.of))
        return f"{kind.c} {{\n{fields}}};\n"
    return ""


def declare_c(kind: Any, name: str) -> str:
    """A declaration without its semicolon."""
    return f"{kind.c}{name}" if kind.c.endswith("*") else f"{kind.c} {name}"


def declare_field(record: RecordOf, name: str) -> str:
    """The declaration of a field of a record."""
    kind = record.fields[name]
    if record.is_embedded(name):
        return f"{kind.of.c} {c_identifier(name)}[{math.prod(record.kind.kinds[name][1:])}]"
    return declare_c(kind, c_identifier(name))


def _variable_of(kind: Any) -> str:
    """The name that a record has in its file."""
    variables = vars(import_module(kind.__module__)).items()
    return next((name for name, value in variables if value is kind), str(kind.__name__))


def field_remarks(kind: Any) -> dict[str, str]:
    """The remarks of a record's file on its fields."""
    _, comments = remarks(kind.__module__).get(_variable_of(kind), ("", {}))
    return comments | {name: setting.remark for name, setting in kind.field_settings.items()}


def record_struct(record: RecordOf, declare: Callable[[RecordOf, str], str] = declare_field) -> str:
    """The struct of a record with the remarks of its file; declare: declares a field."""
    remark, _ = remarks(record.kind.__module__).get(_variable_of(record.kind), ("", {}))
    comments = field_remarks(record.kind)
    lines = [f"    {declare(record, name)};{comment_after(comments.get(name, ''))}\n" for name in record.fields]
    return f"{comment(remark)}{record.c} {{\n{''.join(lines)}}};\n"


def _array(kind: ArrayOf) -> str:
    """The struct of an array; the functions that make one, take rows from it, and take a slice of the first dimension.

    A slice begins and ends within the array, whatever its bounds are; a negative bound counts from the end.
    """
    c, name, data, ndim = kind.c, kind.name, declare_c(kind.of, "*data"), kind.ndim
    sizes = ", ".join(f"int64_t size_{i}" for i in range(ndim))
    assigned = " ".join(f"x.size[{i}] = size_{i};" for i in range(ndim))
    stride = "".join(f" * x.size[{i}]" for i in range(1, ndim))
    inner_sizes = "".join(f", x.size[{i}]" for i in range(1, ndim))
    text = f"""{c} {{
    {data};
    ADAPTRACK_POINTER_PADDING
    int64_t size[{ndim}];
}};
INLINED {c} {name}_of({data}, {sizes}) {{
    {c} x;
    x.data = data;
    {assigned}
    return x;
}}
INLINED {c} {name}_slice({c} x, int64_t begin, int64_t end) {{
    const int64_t first = slice_bound(begin, x.size[0]), last = slice_bound(end, x.size[0]);
    return {name}_of(x.data + first{stride}, last > first ? last - first : 0{inner_sizes});
}}
"""
    if ndim > 1:
        text += f"""INLINED {kind.row.c} {name}_row({c} x, int64_t i) {{
    return {kind.row.name}_of(x.data + i{stride}{inner_sizes});
}}
"""
    if kind == ArrayOf(DOUBLE, 2):
        text += f"""INLINED struct column {name}_column({c} x, int64_t j) {{
    struct column y;
    y.data = x.data + j;
    y.size[0] = x.size[0];
    y.stride = x.size[1];
    return y;
}}
"""
    return text


_RESERVED = frozenset(
    re.findall(
        r"\w+",
        """
        auto bool break case char const continue default do double else enum extern false float for goto if inline int
        long register restrict return short signed sizeof static struct switch true typedef union unsigned void volatile
        while eight four two above below
        """,
    )
)
"""Words of C, and types and functions of the head."""


def c_identifier(name: str) -> str:
    """A name of Python's as one of C's."""
    return f"{name}_" if name in _RESERVED else name
