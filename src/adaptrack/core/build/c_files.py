"""Files in C: a file for each room of kernels, and a header with all records.

A file holds the kernels of a room and the functions that are a part of them, in the order in which they need one
another. It declares what it calls of other files. Its names depend on nothing but its own text, so that an object can
be kept by the hash of what it is made of.
"""

from __future__ import annotations

import inspect
import re
import textwrap
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..kernel import Exported
from .c_types import (
    BOOL,
    NOTHING,
    PREFIX,
    ArrayOf,
    TupleOf,
    add_with_parts,
    argument_type,
    declare_c,
    definition,
    returned_type,
)
from .scopes import comment
from .translate import (
    Adapter,
    Instance,
    Program,
    answer,
    c_function,
    c_parameter,
    c_result,
    parameter_names,
    prototype,
)
from .values import NamedNumber, NumberTable, literal

HEAD_FILE = Path(__file__).with_name("head.h")
RECORDS_FILE = "records.h"
SOFTWARE = ("soft_fma", "soft_fma8", "soft_floor", "soft_ceil", "soft_sqrt")
"""Kernels that the head calls where a processor lacks an instruction."""
_WIDTH = 118


def room_of(kernel: Exported) -> str:
    """The name of the file of a kernel: its folder."""
    *folders, _ = kernel.function.__module__.removeprefix("adaptrack.core").strip(".").split(".")
    return "_".join(folders) or "core"


def c_files(
    kernels: Mapping[str, Exported], checks_indices: bool = False, program: Program | None = None
) -> dict[str, CFile]:
    """Files of kernels by name, and of those that they call; program: translates them."""
    program = program or Program(checks_indices)
    program.kernels.update(kernels)
    translated: dict[str, Instance] = {}
    while len(translated) < len(program.kernels):
        for name in sorted(program.kernels.keys() - translated.keys()):
            translated[name] = program.kernel(program.kernels[name])
    rooms: dict[str, list[Instance]] = {}
    for name in sorted(translated, key=lambda name: _position(translated[name])):
        rooms.setdefault(room_of(program.kernels[name]), []).append(translated[name])
    return {room: _Writer(instances, program.checks_indices).file(room) for room, instances in sorted(rooms.items())}


def _position(instance: Instance) -> tuple[str, int, str]:
    return instance.function.__module__, instance.function.__code__.co_firstlineno, instance.name


@dataclass(frozen=True)
class CFile:
    """A file in C; kinds: types whose structs it needs."""

    name: str
    text: str
    kinds: Iterable[Any] = ()


class _Writer:
    """Writes a file in C: kernels, and each function behind all that it needs."""

    def __init__(self, kernels: list[Instance], counts_calls: bool) -> None:
        self.counts_calls = counts_calls
        self.kinds: dict[Any, None] = {}
        self._names: dict[Any, str] = {instance: instance.name for instance in kernels}
        self._taken = set(self._names.values())
        self._declarations: dict[str, None] = {}
        self._numbers: list[str] = []
        self._adapters: list[str] = []
        self._functions: list[str] = []
        for instance in kernels:
            self._declare(instance.kernel)  # type: ignore[arg-type]
        for instance in kernels:
            self._add(instance)

    def file(self, name: str) -> CFile:
        """The file of this name."""
        parts = [f'#include "{HEAD_FILE.name}"', f'#include "{RECORDS_FILE}"', "", *self._declarations, ""]
        parts += [*self._numbers, "", *self._adapters, *self._functions]
        return CFile(name, "\n".join(parts).rstrip() + "\n", tuple(self.kinds))

    def _name(self, item: Any, name: str) -> str:
        """A name that nothing else in the file has."""
        count, unique = 1, name
        while unique in self._taken:
            count += 1
            unique = f"{name}_{count}"
        self._taken.add(unique)
        self._names[item] = unique
        return unique

    def _add(self, instance: Instance) -> None:
        """Write a function behind all that it needs."""
        for item in instance.needs:
            if item in self._names:
                continue
            if isinstance(item, Instance):
                self._add(item)
            elif isinstance(item, Adapter):
                self._add_adapter(item)
            elif isinstance(item, NamedNumber):
                name = self._name(item, item.name)
                self._numbers.append(f"static const {declare_c(item.kind, name)} = {item.text};")
            elif isinstance(item, NumberTable):
                name = self._name(item, "table")
                values = ", ".join(literal(value).text for value in item.values)
                self._numbers.append(_wrapped(f"static const {declare_c(item.of, name)}[] = {{{values}}};"))
        for kind in instance.kinds:
            add_with_parts(kind, self.kinds)
        if instance not in self._names:
            self._name(instance, instance.name)
        names = [self._names[item] for item in instance.needs]

        def filled(text: str) -> str:
            text = text.replace("@name@", self._names[instance])
            return re.sub(r"@(\d+)@", lambda match: names[int(match[1])], text)

        remark = comment(inspect.getdoc(instance.function) or "")
        begin = "INLINED" if instance.kernel is None else "EXPORTED"
        lines = [_wrapped(line) for line in filled(instance.body).splitlines()]
        if instance.kernel is not None and self.counts_calls:
            self._numbers.append(f"EXPORTED int64_t calls_of_{instance.kernel.name};")
            lines.insert(0, f"    calls_of_{instance.kernel.name}++;")
        self._functions.append("\n".join([f"{remark}{_wrapped(f'{begin} {filled(instance.head)}')} {{", *lines, "}\n"]))

    def _declare(self, kernel: Exported) -> None:
        self._declarations[_wrapped(f"EXPORTED {prototype(kernel)};")] = None
        for kind in kernel.signature.types:
            add_with_parts(argument_type(kind), self.kinds)

    def _add_adapter(self, adapter: Adapter) -> None:
        """A function with arrays and several results as structs, around one with words; none where none is needed."""
        returned = returned_type(adapter.signature)
        kinds = [argument_type(kind) for kind in adapter.signature.types]
        if adapter.kernel is not None:
            self._declare(adapter.kernel)
            function, names, parameters = PREFIX + adapter.name, parameter_names(adapter.kernel), []
            if (
                not isinstance(returned, TupleOf)
                and returned != BOOL
                and not any(isinstance(kind, ArrayOf) for kind in kinds)
            ):
                self._names[adapter] = function
                return
            name = self._name(adapter, f"call_{adapter.name}")
        else:
            words = [word for kind in kinds for word in c_parameter(kind, "")[0]]
            types = ", ".join(re.sub(r"\w*$", "", word).strip() for word in words)
            function = f"(({declare_c(c_result(returned), '(*)')}({types}))(intptr_t)function)"
            names, parameters = [f"a{i}" for i in range(len(kinds))], ["int64_t function"]
            name = self._name(adapter, adapter.name)
        for kind in (returned, *kinds):
            add_with_parts(kind, self.kinds)
        arguments = []
        for kind, argument in zip(kinds, names, strict=True):
            parameters.append(declare_c(kind, argument))
            if isinstance(kind, ArrayOf):
                arguments += [f"{argument}.data", *(f"{argument}.size[{i}]" for i in range(kind.ndim))]
            else:
                arguments.append(argument)
        if isinstance(returned, TupleOf):
            numbers = ", ".join(answer(i, kind) for i, kind in enumerate(returned.of))
            lines = [
                f"    adaptrack_word answers[{len(returned.of)}];",
                f"    {function}({', '.join([*arguments, 'answers'])});",
                f"    return ({returned.c}){{{numbers}}};",
            ]
        else:
            call = f"{function}({', '.join(arguments)}){' != 0' if returned == BOOL else ''}"
            lines = [f"    {'' if returned == NOTHING else 'return '}{call};"]
        head = f"INLINED {c_function(returned, name, parameters)}"
        self._adapters.append("\n".join([f"{_wrapped(head)} {{", *map(_wrapped, lines), "}\n"]))


def records(files: Iterable[CFile]) -> str:
    """The header with the structs that files need."""
    kinds = dict.fromkeys(kind for file in files for kind in file.kinds)
    texts = [definition(kind) for kind in kinds]
    begin = f'#ifndef ADAPTRACK_RECORDS_H\n#define ADAPTRACK_RECORDS_H\n#include "{HEAD_FILE.name}"\n'
    return "\n".join([begin, *(text for text in texts if text), "#endif\n"])


def texts(files: Mapping[str, CFile]) -> dict[str, str]:
    """The files in C by their names, with the header of their records and the head."""
    sources = {f"{name}.c": file.text for name, file in files.items()}
    return {HEAD_FILE.name: HEAD_FILE.read_text(encoding="utf-8"), RECORDS_FILE: records(files.values()), **sources}


def _wrapped(text: str) -> str:
    """A line of C, broken at spaces where it is too long."""
    if len(text) <= _WIDTH:
        return text
    indent = text[: len(text) - len(text.lstrip())]
    return "\n".join(textwrap.wrap(text, _WIDTH, subsequent_indent=indent + "    ", break_long_words=False,
                                   break_on_hyphens=False))  # fmt: skip
