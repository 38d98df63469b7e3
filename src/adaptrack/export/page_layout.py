"""What the engine of the page must know of the kernels: how their records lie in memory, and what they take.

    layouts     of each record its 8-byte words: {"words": count, "fields": {name: [first word, kind, more]}}
    calls       of each kernel its arguments and what it returns, a letter or a digit each
    image       a record with all that it holds, as numbers of JSON and arrays of base64

Kind of a field: "f" a float64, "i" an int64, "F" and "I" an array of these (more: its dimensions; its words are the
place and the sizes), "R" an array of rows (more: the record), "W" so many float64 in a row (more: their count),
"r" a record (more: which), "S" so many records in a row (more: [which, count]).
"""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable
from typing import Any

import numpy as np

from adaptrack.core.kernel import EXPORTED, Array, Scalar, float64, int64

CORE_PACKAGE = "adaptrack.core."
_LETTERS = {"float64": "f", "int64": "i", "boolean": "i", "void": ""}


def name_of(kind: Any) -> str:
    """A record by its file and its name: "loop.LoopSettings"."""
    return f"{kind.__module__.removeprefix(CORE_PACKAGE)}.{kind.__name__}"


def layouts(kinds: Iterable[Any]) -> dict[str, Any]:
    """The layouts of records and of all that lie in them, by `name_of`."""
    records: dict[str, Any] = {}
    for kind in kinds:
        _add(kind, records)
    return records


def _add(kind: Any, records: dict[str, Any]) -> int:
    """Words of a record, whose layout is then known."""
    name = name_of(kind)
    if name in records:
        return int(records[name]["words"])
    place, fields = 0, {}
    for field, field_kind in kind.kinds.items():
        letter, nested, words = _field(field_kind, records)
        fields[field] = [place, letter] if nested is None else [place, letter, nested]
        place += words
    records[name] = {"words": place, "fields": fields}
    return place


def _field(kind: Any, records: dict[str, Any]) -> tuple[str, Any, int]:
    """Letter, further say and words of a field."""
    if isinstance(kind, tuple):
        of, *shape = kind
        count = math.prod(shape)
        if isinstance(of, Scalar):
            return "W", count, count
        return "S", [name_of(of), count], count * _add(of, records)
    if isinstance(kind, Scalar):
        return _LETTERS[kind.name], None, 1
    if isinstance(kind, Array):
        if isinstance(kind.of, Scalar):
            return _LETTERS[kind.of.name].upper(), kind.ndim, 1 + kind.ndim
        _add(kind.of, records)
        return "R", name_of(kind.of), 2
    return "r", name_of(kind), _add(kind, records)


def calls(names: Iterable[str]) -> dict[str, list[str]]:
    """Return the argument and result types of each kernel: "f", "i" numbers, "r" a record, "1" to "4" arrays."""
    return {name: _call(EXPORTED[name].signature) for name in names}


def _call(signature: Any) -> list[str]:
    letters = "".join(
        _LETTERS[kind.name] if isinstance(kind, Scalar) else str(kind.ndim) if isinstance(kind, Array) else "r"
        for kind in signature.types
    )
    return [letters, "".join(_LETTERS[kind.name] for kind in signature.returns)]


# -- values -----------------------------------------------------------------------------------------------------------
def packed(values: Any) -> dict[str, Any]:
    """An array for JSON: its bytes in base64, and its shape; of whole numbers as such."""
    array = np.ascontiguousarray(values)
    is_integer = array.dtype.kind in "iub"
    content = array.astype(np.int64 if is_integer else np.float64, copy=False)
    return {"i8" if is_integer else "f8": base64.b64encode(content.tobytes()).decode(), "shape": list(array.shape)}


def image(record: Any) -> dict[str, Any]:
    """A record with all that it holds; what is zero throughout is given by its shape alone."""
    functions = {kernel.address: name for name, kernel in EXPORTED.items() if "address" in vars(kernel)}
    return {field: _value(kind, getattr(record, field), functions) for field, kind in record.kinds.items()}


def _value(kind: Any, value: Any, functions: dict[int, str]) -> Any:
    if hasattr(kind, "kinds"):
        return {field: _value(inner, getattr(value, field), functions) for field, inner in kind.kinds.items()}
    if isinstance(kind, Array):
        if not value.tobytes().strip(b"\0"):
            return {"shape": list(value.shape)}
        if isinstance(kind.of, Scalar):
            return packed(value)
        return {"words": base64.b64encode(np.ascontiguousarray(value).tobytes()).decode(), "shape": list(value.shape)}
    if kind == int64 and value in functions:
        return {"function": functions[value]}
    return packed(np.array([value], np.float64)) if kind == float64 else int(value)
