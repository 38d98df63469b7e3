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
from .c_types import PREFIX, add_with_parts, argument_type, declare_c, definition, returned_type
from .scopes import comment
from .translate import FunctionType, Instance, Program, c_parameter, c_result, prototype
from .values import NamedNumber, NumberTable, literal

HEAD_FILE = Path(__file__).with_name("head.h")
RECORDS_FILE = "records.h"
SOFT_KERNELS = ("soft_fma", "soft_fma8", "soft_floor", "soft_ceil", "soft_sqrt")
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
        self._types: list[str] = []
        self._functions: list[str] = []
        for instance in kernels:
            self._declare(instance.kernel)  # type: ignore[arg-type]
        for instance in kernels:
            self._add(instance)

    def file(self, name: str) -> CFile:
        """The file of this name."""
        parts = [f'#include "{HEAD_FILE.name}"', f'#include "{RECORDS_FILE}"', "", *self._declarations, ""]
        parts += [*self._numbers, "", *self._types, "", *self._functions]
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
            elif isinstance(item, Exported):
                self._names[item] = PREFIX + item.name
                self._declare(item)
            elif isinstance(item, FunctionType):
                self._add_type(item)
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

    def _add_type(self, item: FunctionType) -> None:
        """The type of functions that are called by their addresses."""
        kinds = [argument_type(kind) for kind in item.signature.types]
        for kind in kinds:
            add_with_parts(kind, self.kinds)
        words = [word for kind in kinds for word in c_parameter(kind, "")[0]]
        parameters = [re.sub(r"\w*$", "", word).strip() for word in words]
        pointer = declare_c(c_result(returned_type(item.signature)), f"(*{self._name(item, item.name)})")
        self._types.append(_wrapped(f"typedef {pointer}({', '.join(parameters)});"))


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
