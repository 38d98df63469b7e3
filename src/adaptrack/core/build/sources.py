"""All kernels, and the files that each depends on: its own and the compiler's, and those that these import."""

from __future__ import annotations

import ast
import importlib
import pkgutil
from functools import cache
from pathlib import Path
from typing import Any

from .. import library
from ..kernel import EXPORTED

COMPILER_FILE = Path(__file__).with_name("translate.py")


def kernels_of(package: str = "adaptrack.core") -> dict[str, Any]:
    """Return every exported kernel of a package by its name, after the import of all its modules."""
    for module in pkgutil.walk_packages(importlib.import_module(package).__path__, f"{package}."):
        if not module.name.startswith("adaptrack.core.build"):
            importlib.import_module(module.name)
    return {name: kernel for name, kernel in EXPORTED.items() if kernel.function.__module__.startswith(f"{package}.")}


@cache
def _imports(source: Path) -> set[Path]:
    """Return the files of the package from which a file imports names."""
    files = set()
    for node in ast.walk(ast.parse(source.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom):
            continue
        module = (node.module or "").split(".")
        if node.level == 0 and module.pop(0) != library.PACKAGE_FOLDER.name:
            continue
        home = source.parents[node.level - 1] if node.level else library.PACKAGE_FOLDER
        home = home.joinpath(*module)
        for name in node.names:
            file = home / f"{name.name}.py"
            file = file if file.is_file() else home.with_suffix(".py")
            if file.is_file():
                files.add(file)
    return files


@cache
def sources_of(source: Path) -> list[str]:
    """The files that the kernels of a file depend on, by their places in the package."""
    files, waiting = set(), {source, COMPILER_FILE}
    while waiting:
        module = waiting.pop()
        files.add(module)
        waiting |= _imports(module) - files
    return sorted(path.relative_to(library.PACKAGE_FOLDER).as_posix() for path in files)
