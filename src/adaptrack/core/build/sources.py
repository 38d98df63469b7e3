"""Which files a kernel depends on: its own, and those that these import."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from .. import library

_IMPORT = re.compile(r"^[ \t]*from[ \t]+(\.+)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)


def _imported(source: Path) -> Iterator[Path]:
    """The files of the room that a file of it imports itself (by relative names)."""
    for dots, module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        folder = source.parents[len(dots) - 1].joinpath(*module.split(".")) if module else source.parents[len(dots) - 1]
        if folder.with_suffix(".py").is_file():
            yield folder.with_suffix(".py")
            continue
        for name in re.findall(r"\w+", re.sub(r"#.*|\bas\s+\w+", "", names)):
            if (folder / f"{name}.py").is_file():
                yield folder / f"{name}.py"


@cache
def sources_of(source: Path) -> list[str]:
    """A file of the room and every one that it depends on, by their places in the room."""
    found: set[Path] = set()
    waiting = [source]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found.add(here)
            waiting += _imported(here)
    return sorted(each.relative_to(library.ROOM).as_posix() for each in found)
