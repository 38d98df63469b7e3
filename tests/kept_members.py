"""Members that the tests bring themselves (plants, laws, models, estimators) are compiled once, not in every run.

A member is kept beside the kernels, under what its machine code depends on: its own bytecode and constants, those of
whatever it calls, its signature, and all kernels. What cannot be told apart so is compiled anew.
"""

from __future__ import annotations

import hashlib
import shutil
import types
from pathlib import Path
from typing import Any

import numba
import numpy as np
from numba.core import config
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

from adaptrack.kernels import abi

_PLAIN = (int, float, bool, str, bytes, type(None), np.dtype, numba.types.Type)


class _CannotKeep(Exception):
    """Something whose value says nothing that is the same in another process."""


def keep_members() -> None:
    """From now on what `abi.njit` compiles, and would not keep, is kept; before any other kernel file is imported."""
    if abi.INTERPRETED:
        return
    room = Path(abi.__file__).parent
    kernels = hashlib.sha256(numba.__version__.encode())
    for source in sorted(room.rglob("*.py")):
        kernels.update(source.read_bytes())
    place = abi.cache_base() / "members-of-tests"
    now = place / kernels.hexdigest()[:16]
    for old in place.glob("*"):
        if old != now:
            shutil.rmtree(old, ignore_errors=True)
    compiled = abi._compiled

    def keeping(function: Any, signature: Any, options: dict[str, Any]) -> Any:
        made = compiled(function, signature, options)
        if signature and not options["cache"] and not options.get("no_cpython_wrapper"):
            try:
                folder = now / hashlib.sha256(repr((_told_apart(function), signature)).encode()).hexdigest()[:24]
                made._cache = _Kept(function, str(folder))
            except (_CannotKeep, RuntimeError, OSError):  # RuntimeError: a function that stands in no file
                pass
        return made

    abi._compiled = keeping


class _Kept(FunctionCache):
    """numba's own cache of a function in a folder for it alone."""

    def __init__(self, function: Any, folder: str) -> None:
        users, config.CACHE_DIR = config.CACHE_DIR, folder
        try:
            super().__init__(function)
        finally:
            config.CACHE_DIR = users
        self.enable()

    def _index_key(self, sig: Any, codegen: Any) -> Any:
        return sig, codegen.magic_tuple()


def _told_apart(value: Any) -> Any:
    """A text or tuple that is the same in every process exactly where a function compiles to the same."""
    if isinstance(value, Dispatcher):
        return "compiled", _told_apart(value.py_func), sorted(map(str, value.targetoptions.items()))
    if str(getattr(value, "__module__", "")).startswith("adaptrack.kernels") and not getattr(value, "__closure__", ()):
        return value.__module__, getattr(value, "__qualname__", str(value))
    if isinstance(value, types.FunctionType):
        code = value.__code__
        used = {name: value.__globals__[name] for name in _names(code) if name in value.__globals__}
        cells = [cell.cell_contents for cell in value.__closure__ or ()]
        return (
            _code(code),
            [(name, _told_apart(each)) for name, each in sorted(used.items())],
            _told_apart(tuple(cells)),
        )
    if isinstance(value, types.ModuleType | types.BuiltinFunctionType | type | np.ufunc):
        return getattr(value, "__qualname__", value.__name__)
    if isinstance(value, tuple):
        return type(value).__name__, [_told_apart(each) for each in value]
    if isinstance(value, _PLAIN):
        return repr(value)
    raise _CannotKeep(repr(value))


def _code(code: types.CodeType) -> Any:
    return code.co_code, [_code(each) if isinstance(each, types.CodeType) else repr(each) for each in code.co_consts]


def _names(code: types.CodeType) -> set[str]:
    return set(code.co_names).union(*(_names(each) for each in code.co_consts if isinstance(each, types.CodeType)))
