"""The C header of the library: names, order and units as the kernels' own files say them."""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import Any

from ..kernel import Exported
from .c_types import (
    PREFIX,
    ArrayOf,
    RecordOf,
    add_with_parts,
    argument_type,
    declare_field,
    record_struct,
    short_module,
)
from .scopes import comment, comment_after, remarks
from .translate import prototype

HEADER_BEGINNING = """\
/* adaptrack: the kernels as C functions. Written by adaptrack.core.build from their sources.

   Units are SI, angles in rad; axes and signs are those of ISO 8855 (x forward, y left, angles positive to the left).
   An array is the place of its first number and a size for each dimension; the last index runs fastest.
   A record is a pointer to its struct, of 8-byte words; it must stay where it is, unchanged, while a function runs.
   A function that answers several numbers writes them behind its last argument. None allocates or fails. */
#ifndef ADAPTRACK_H
#define ADAPTRACK_H
#include <stdint.h>

typedef union { double number; int64_t whole; } adaptrack_word;
/* an address in a word of 8 bytes, on processors with shorter ones too */
#define ADAPTRACK_AT(type, name) union { type *name; int64_t name##_word; }

#ifdef __cplusplus
extern "C" {
#endif
"""
HEADER_END = """
#ifdef __cplusplus
}
#endif
#endif
"""


def header(kernels: Iterable[Exported]) -> str:
    """The text of the header for these kernels."""
    ordered = sorted(kernels, key=lambda kernel: (kernel.function.__module__, kernel.name))
    kinds: dict[Any, None] = {}
    for kernel in ordered:
        for kind in kernel.signature.types:
            add_with_parts(argument_type(kind), kinds)
    records = [kind for kind in kinds if isinstance(kind, RecordOf)]
    modules = {kernel.function.__module__ for kernel in ordered} | {record.kind.__module__ for record in records}
    places = [text for module in sorted(modules) for text in _enumerations(module)]
    structs = [record_struct(record, _declare_field) for record in records]
    return "\n".join([HEADER_BEGINNING, *places, *map(_with_prefix, structs), *map(_prototype, ordered), HEADER_END])


def _enumerations(module: str) -> Iterator[str]:
    """The columns that a file names, as places in rows."""
    for name, (remark, fields) in remarks(module).items():
        places = getattr(import_module(module), name)
        if type(places).__name__ == "Columns":
            fields = fields | {field: setting.remark for field, setting in places.field_settings.items()}
            prefix = f"{PREFIX}{short_module(module)}_{name}_".upper()
            lines = [f"    {prefix}{field.upper()} = {i},{comment_after(fields.get(field, ''))}\n"
                     for i, field in enumerate(places._fields)]  # fmt: skip
            yield f"{comment(remark)}enum {{\n{''.join(lines)}}};\n"


def _declare_field(record: RecordOf, name: str) -> str:
    kind = record.fields[name]
    if isinstance(kind, ArrayOf) and not record.is_embedded(name):
        return f"ADAPTRACK_AT({kind.of.c}, {name}); int64_t {name}_size[{kind.ndim}]"
    return declare_field(record, name)


def _prototype(kernel: Exported) -> str:
    summary = (inspect.getdoc(kernel.function) or "").split("\n\n")[0]
    lines = textwrap.wrap(f"{_with_prefix(prototype(kernel))};", 116, break_long_words=False)
    return comment(summary) + "\n    ".join(lines) + "\n"


def _with_prefix(text: str) -> str:
    """A text whose structs have the prefix of the names that other programs use."""
    return re.sub(r"\bstruct (?=\w)", f"struct {PREFIX}", text)
