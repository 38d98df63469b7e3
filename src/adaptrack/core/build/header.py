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

from ..kernel import Array, Exported, Number, Place, Row

PREFIX = "adaptrack_"
BEGINNING = """\
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
END = """
#ifdef __cplusplus
}
#endif
#endif
"""


def header(kernels: Iterable[Exported]) -> str:
    """The text of the header for these kernels."""
    ordered = sorted(kernels, key=lambda each: (each.function.__module__, each.name))
    records: dict[Any, str] = {}
    for kernel in ordered:
        for kind in kernel.signature.types:
            _collect(kind, records)
    files = {each.function.__module__ for each in ordered} | {each.__module__ for each in records}
    modules = dict.fromkeys(sorted(files))
    places = [text for module in modules for text in _enumerations(module)]
    return "\n".join([BEGINNING, *places, *records.values(), *map(_prototype, ordered), END])


# -- what the sources say ---------------------------------------------------------------------------------------------
@cache
def remarks(module: str) -> dict[str, tuple[str, dict[str, str]]]:
    """Of each ``NAME = record(...)`` and ``NAME = columns(...)`` of a file: what is said of it and of its fields."""
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
    found = {}
    for node, after in zip(statements, [*statements[1:], None], strict=True):
        made = node.value if isinstance(node, ast.Assign) else None
        if isinstance(made, ast.Call) and isinstance(made.func, ast.Name) and made.func.id in ("record", "columns"):
            fields = _fields(list(_texts(made, assigned)), comments)
            said = after.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else None
            (target,) = node.targets  # type: ignore[attr-defined]
            found[target.id] = (inspect.cleandoc(str(said.value)) if said else "", fields)
    return found


def _fields(texts: list[Any], comments: dict[int, str]) -> dict[str, str]:
    """What the comment of its line says of each field; as many units as fields of a line are shared out."""
    found = {}
    for text in texts:
        line = [each.value for each in texts if each.lineno == text.lineno]
        comment = comments.get(text.lineno, "")
        units, colon, rest = comment.partition(":")
        own = units.split(", ")
        if len(line) > 1 and len(own) == len(line):
            comment = own[line.index(text.value)] + colon + rest
        found[text.value] = comment
    return found


def _texts(node: ast.AST, assigned: dict[str, Any]) -> Iterator[Any]:
    """The strings of an expression, and of those that it names."""
    for each in ast.walk(node):
        if isinstance(each, ast.Constant) and isinstance(each.value, str):
            yield each
        elif isinstance(each, ast.Name) and isinstance(assigned.get(each.id), ast.Tuple | ast.List):
            yield from _texts(assigned[each.id], {})


def _comment(text: str, indent: str = "") -> str:
    lines = textwrap.wrap(" ".join(text.replace("*/", "* /").split()), 110)
    return f"{indent}/* " + f"\n{indent}   ".join(lines) + " */\n" if lines else ""


# -- what is written --------------------------------------------------------------------------------------------------
def _enumerations(module: str) -> Iterator[str]:
    """The columns that a file names, as places in rows."""
    for name, (said, fields) in remarks(module).items():
        places = getattr(import_module(module), name)
        if type(places).__name__ == "Columns":
            prefix = f"{_c_name(module, name)}_".upper()
            lines = [
                f"    {prefix}{each.upper()} = {i},{_after(fields, each)}\n" for i, each in enumerate(places._fields)
            ]
            yield f"{_comment(said)}enum {{\n{''.join(lines)}}};\n"


def _after(fields: dict[str, str], name: str) -> str:
    return f" /* {fields[name]} */" if fields.get(name) else ""


def _c_name(module: str, name: str) -> str:
    return PREFIX + module.removeprefix("adaptrack.").removeprefix("core.").replace(".", "_") + f"_{name}"


def _struct(kind: Any) -> str:
    return f"struct {_c_name(kind.__module__, kind.__name__)}"


def _collect(kind: Any, records: dict[Any, str]) -> None:
    """Write the structs that a type needs, those within it first."""
    kind = kind.of if isinstance(kind, Array | Row | Place) else kind[0] if type(kind) is tuple else kind
    if isinstance(kind, Number) or kind in records:
        return
    for each in kind.kinds.values():
        _collect(each, records)
    module = import_module(kind.__module__)
    name = next((name for name, value in vars(module).items() if value is kind), kind.__name__)
    said, fields = remarks(kind.__module__).get(name, ("", {}))
    fields = fields | {name: setting.remark for name, setting in kind.field_settings.items()}
    lines = [f"    {_field(name, each)}{_after(fields, name)}\n" for name, each in kind.kinds.items()]
    records[kind] = f"{_comment(said)}{_struct(kind)} {{\n{''.join(lines)}}};\n"


def _type(kind: Any) -> str:
    if isinstance(kind, Number):
        return "double" if kind.name == "float64" else "int64_t"
    return _struct(kind)


def _field(name: str, kind: Any) -> str:
    if isinstance(kind, Array):
        return f"ADAPTRACK_AT({_type(kind.of)}, {name}); int64_t {name}_size[{kind.ndim}];"
    if type(kind) is tuple:
        return f"{_type(kind[0])} {name}[{kind[1]}];"
    return f"{_type(kind)} {name};"


def _prototype(kernel: Exported) -> str:
    given = []
    for name, kind in zip(inspect.signature(kernel.function).parameters, kernel.signature.types, strict=True):
        if isinstance(kind, Number):
            given.append(f"{_type(kind)} {name}")
        elif isinstance(kind, Array):
            given += [f"{_type(kind.of)} *{name}", *(f"int64_t {name}_{i}" for i in range(kind.ndim))]
        else:
            given.append(f"{_struct(kind.of)} *{name}")
    returns = kernel.signature.returns
    if len(returns) > 1:
        given.append(f"adaptrack_word answers[{len(returns)}]")
    returned = "void" if len(returns) > 1 or returns[0].name == "void" else _type(returns[0])
    said = (inspect.getdoc(kernel.function) or "").split("\n\n")[0]
    written = f"{returned} {PREFIX}{kernel.name}({', '.join(given) or 'void'});"
    return _comment(said) + "\n    ".join(textwrap.wrap(written, 116, break_long_words=False)) + "\n"
