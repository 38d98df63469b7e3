"""The C header of the library: names, order and units as the kernels' own files say them."""

from __future__ import annotations

import ast
import inspect
import io
import textwrap
import tokenize
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from typing import Any

from ..kernel import Array, Exported, Place, Row, Scalar

PREFIX = "adaptrack_"
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
    records: dict[Any, str] = {}
    for kernel in ordered:
        for kind in kernel.signature.types:
            _collect(kind, records)
    files = {entry.function.__module__ for entry in ordered} | {entry.__module__ for entry in records}
    modules = dict.fromkeys(sorted(files))
    places = [text for module in modules for text in _enumerations(module)]
    return "\n".join([HEADER_BEGINNING, *places, *records.values(), *map(_prototype, ordered), HEADER_END])


# -- what the sources say ---------------------------------------------------------------------------------------------
@cache
def remarks(module: str) -> dict[str, tuple[str, dict[str, str]]]:
    """Return the remarks of a file on each ``NAME = record(...)`` and ``NAME = columns(...)`` and on its fields."""
    source = inspect.getsource(import_module(module))
    comments = {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(source).readline)
        if token.type == tokenize.COMMENT and not token.string.startswith("# fmt")
    }
    statements = ast.parse(source).body
    assigned = {
        node.targets[0].id: node.value
        for node in statements
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    remarks_by_name = {}
    for node, after in zip(statements, [*statements[1:], None], strict=True):
        value = node.value if isinstance(node, ast.Assign) else None
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in ("record", "columns"):
            fields = _fields(list(_texts(value, assigned)), comments)
            remark = after.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else None
            (target,) = node.targets  # type: ignore[attr-defined]
            remarks_by_name[target.id] = (inspect.cleandoc(str(remark.value)) if remark else "", fields)
    return remarks_by_name


def _fields(texts: list[Any], comments: dict[int, str]) -> dict[str, str]:
    """Return the comment of each field; a line's units are shared out among as many fields."""
    remarks_by_field = {}
    for text in texts:
        line = [constant.value for constant in texts if constant.lineno == text.lineno]
        comment = comments.get(text.lineno, "")
        units, colon, meaning = comment.partition(":")
        field_units = units.split(", ")
        if len(line) > 1 and len(field_units) == len(line):
            comment = field_units[line.index(text.value)] + colon + meaning
        remarks_by_field[text.value] = comment
    return remarks_by_field


def _texts(node: ast.AST, assigned: dict[str, Any]) -> Iterator[Any]:
    """The strings of an expression, and of those that it names."""
    for child in ast.walk(node):
        if isinstance(child, ast.Constant) and isinstance(child.value, str):
            yield child
        elif isinstance(child, ast.Name) and isinstance(assigned.get(child.id), ast.Tuple | ast.List):
            yield from _texts(assigned[child.id], {})


def _comment(text: str, indent: str = "") -> str:
    lines = textwrap.wrap(" ".join(text.replace("*/", "* /").split()), 110)
    return f"{indent}/* " + f"\n{indent}   ".join(lines) + " */\n" if lines else ""


# -- what is written --------------------------------------------------------------------------------------------------
def _enumerations(module: str) -> Iterator[str]:
    """The columns that a file names, as places in rows."""
    for name, (remark, fields) in remarks(module).items():
        places = getattr(import_module(module), name)
        if type(places).__name__ == "Columns":
            fields = fields | {field: setting.remark for field, setting in places.field_settings.items()}
            prefix = f"{_c_name(module, name)}_".upper()
            lines = [
                f"    {prefix}{field.upper()} = {i},{_after(fields, field)}\n" for i, field in enumerate(places._fields)
            ]
            yield f"{_comment(remark)}enum {{\n{''.join(lines)}}};\n"


def _after(fields: dict[str, str], name: str) -> str:
    return f" /* {fields[name]} */" if fields.get(name) else ""


def _c_name(module: str, name: str) -> str:
    return PREFIX + module.removeprefix("adaptrack.").removeprefix("core.").replace(".", "_") + f"_{name}"


def _struct(kind: Any) -> str:
    return f"struct {_c_name(kind.__module__, kind.__name__)}"


def _collect(kind: Any, records: dict[Any, str]) -> None:
    """Write the structs that a type needs, those within it first."""
    kind = kind.of if isinstance(kind, Array | Row | Place) else kind[0] if type(kind) is tuple else kind
    if isinstance(kind, Scalar) or kind in records:
        return
    for field_kind in kind.kinds.values():
        _collect(field_kind, records)
    module = import_module(kind.__module__)
    name = next((name for name, value in vars(module).items() if value is kind), kind.__name__)
    remark, fields = remarks(kind.__module__).get(name, ("", {}))
    fields = fields | {name: setting.remark for name, setting in kind.field_settings.items()}
    lines = [f"    {_field(name, field_kind)}{_after(fields, name)}\n" for name, field_kind in kind.kinds.items()]
    records[kind] = f"{_comment(remark)}{_struct(kind)} {{\n{''.join(lines)}}};\n"


def _type(kind: Any) -> str:
    if isinstance(kind, Scalar):
        return "double" if kind.name == "float64" else "int64_t"
    return _struct(kind)


def _field(name: str, kind: Any) -> str:
    if isinstance(kind, Array):
        return f"ADAPTRACK_AT({_type(kind.of)}, {name}); int64_t {name}_size[{kind.ndim}];"
    if type(kind) is tuple:
        return f"{_type(kind[0])} {name}[{kind[1]}];"
    return f"{_type(kind)} {name};"


def _prototype(kernel: Exported) -> str:
    arguments = []
    for name, kind in zip(inspect.signature(kernel.function).parameters, kernel.signature.types, strict=True):
        if isinstance(kind, Scalar):
            arguments.append(f"{_type(kind)} {name}")
        elif isinstance(kind, Array):
            arguments += [f"{_type(kind.of)} *{name}", *(f"int64_t {name}_{i}" for i in range(kind.ndim))]
        else:
            arguments.append(f"{_struct(kind.of)} *{name}")
    returns = kernel.signature.returns
    if len(returns) > 1:
        arguments.append(f"adaptrack_word answers[{len(returns)}]")
    returned = "void" if len(returns) > 1 or returns[0].name == "void" else _type(returns[0])
    summary = (inspect.getdoc(kernel.function) or "").split("\n\n")[0]
    written = f"{returned} {PREFIX}{kernel.name}({', '.join(arguments) or 'void'});"
    return _comment(summary) + "\n    ".join(textwrap.wrap(written, 116, break_long_words=False)) + "\n"
