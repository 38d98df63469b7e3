"""Compiles plain Python functions of other packages together with the functions of that package that they call."""

from __future__ import annotations

from types import FunctionType, ModuleType
from typing import Any

from ..library import compiler
from ..member import compiles


def compiled_foreign(function: Any, package: str) -> Any:
    """A kernel of `function`, as it stands in its package.

    What it calls of `package`, by a name of its module or as an attribute of a module, is compiled with it. The
    package's own functions and modules are not changed.
    """
    return _rebuilt(function, package, {}) if compiles() else function


def _rebuilt(function: Any, package: str, rebuilt: dict[Any, Any]) -> Any:
    if function not in rebuilt:
        names = dict(function.__globals__)
        for name in function.__code__.co_names:
            if name in names:
                names[name] = _with_kernels(names[name], package, rebuilt)
        copy = FunctionType(
            function.__code__, names, function.__name__, function.__defaults__, function.__closure__
        )  # fmt: skip
        rebuilt[function] = compiler().plain(copy)
    return rebuilt[function]


def _with_kernels(value: Any, package: str, rebuilt: dict[Any, Any]) -> Any:
    """A function of the package as a kernel, a module of it with kernels for its functions; all else as it is."""
    if isinstance(value, FunctionType) and value.__module__.split(".")[0] == package:
        return _rebuilt(value, package, rebuilt)
    if isinstance(value, ModuleType) and value.__name__.split(".")[0] == package:
        copy = ModuleType(value.__name__)
        for name, member in vars(value).items():
            if not name.startswith("__"):
                setattr(copy, name, _with_kernels(member, package, rebuilt) if callable(member) else member)
        return copy
    return value
