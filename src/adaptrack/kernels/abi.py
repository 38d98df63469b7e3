"""What every kernel agrees on: compiler options, exact multiply-add, where compiled code is cached.

Rules of the room
-----------------
* Kernels take and return floats and C-contiguous arrays; they never allocate in a loop and never raise.
* Arithmetic is strict IEEE double precision: no re-association and no implicit contraction. Where a fused
  multiply-add is wanted it is written, `fma(a, b, c)`. So a run gives the same bits alone or in a batch.
* `ROUTINE` functions are compiled once for a fixed signature and cached on disk; `INLINE` functions are small
  formulas that the optimiser must see through, because the loops that call them are vectorised over slots.
"""

from __future__ import annotations

import gc
import hashlib
import io
import logging
import os
import re
import sys
import time
import warnings
from collections import namedtuple
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numba
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core import config as _numba_config
from numba.core.caching import IndexDataCacheFile
from numba.core.compiler_lock import global_compiler_lock
from numba.core.errors import NumbaExperimentalFeatureWarning
from numba.core.event import Listener, register
from numba.core.registry import CPUDispatcher
from numba.extending import intrinsic

INTERPRETED = bool(_numba_config.DISABLE_JIT)
"""Whether the compiler is switched off (NUMBA_DISABLE_JIT): every kernel is then plain Python."""

INLINE: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "forceinline": True,
    "_nrt": False,
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}
"""Options of the small formulas that are always inlined. Without numba's run-time (`_nrt`) nothing can be allocated,
and no array is counted in and out of a call. Python must not call them: they have no entry for it."""

PART: dict[str, Any] = {"nogil": True, "error_model": "numpy", "inline": "always"}
"""Options of a part of a longer algorithm: it is put in the place of its call before anything is compiled. A function
that is compiled by itself is optimised with all that it calls, so deep calls of large functions would cost minutes."""

ROUTINE: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "cache": True,
    "_nrt": False,
    "no_cfunc_wrapper": True,
}
"""Options of the routines that are compiled once and loaded from the cache. Kernels call each other, or an address (see
`caller`): none needs a C entry."""

SUBROUTINE: dict[str, Any] = {**ROUTINE, "forceinline": True, "no_cpython_wrapper": True}
"""Options of a long part that is compiled by itself, once for all that call it."""

SHARED_PART: dict[str, Any] = {**ROUTINE, "inline": "always"}
"""A part of a longer algorithm that Python calls as well."""

float64 = types.float64
int64 = types.int64
vector = types.Array(types.float64, 1, "C")
matrix = types.Array(types.float64, 2, "C")
cube = types.Array(types.float64, 3, "C")
int_vector = types.Array(types.int64, 1, "C")
int_matrix = types.Array(types.int64, 2, "C")


def _fma_in_python(a: float, b: float, c: float) -> float:
    """``a*b + c``, rounded twice: what `fma` does when the compiler is switched off."""
    return a * b + c


if INTERPRETED:
    fma = _fma_in_python
else:

    @intrinsic
    def fma(typingctx, a, b, c):
        """``a*b + c`` with a single rounding (IEEE 754-2008, section 5.4.1)."""
        signature = types.float64(types.float64, types.float64, types.float64)

        def codegen(context, builder, signature, args):
            a, b, c = (
                value if isinstance(value.type, ir.DoubleType) else builder.sitofp(value, ir.DoubleType())
                for value in args
            )
            return builder.fma(a, b, c)

        return signature, codegen


def record(name: str, fields: Iterable[str]) -> Any:
    """A named tuple class: how a kernel receives many values under their names.

    It belongs to the module that asks for it: the compiler's cache finds a class again by module and name.
    """
    return namedtuple(name, list(fields), module=sys._getframe(1).f_globals["__name__"])


def entry(function: Any) -> Any:
    """A compiled function of one signature without the compiler's look at its arguments, which takes 2 microseconds.

    They must be of exactly the types of the signature.
    """
    if INTERPRETED:
        return function
    function.ready()
    (compiled,) = function.overloads.values()
    return compiled.entry_point


def caller(signature: Any) -> Any:
    """A kernel ``call(address, *arguments)`` that calls the compiled function at an address, see `address_of`.

    So functions cross in records and cost a call nothing; one of numba's function types costs 100 microseconds.
    """
    if INTERPRETED:
        return lambda function, *arguments: function(*arguments)

    def typed(typingctx, address, *arguments):
        def codegen(context, builder, signature, args):
            convention, kinds = context.call_conv, signature.args[1:]
            prototype = convention.get_function_type(signature.return_type, kinds)
            function = builder.inttoptr(args[0], prototype.as_pointer())
            status, answer = convention.call_function(builder, function, signature.return_type, kinds, args[1:])
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return context.get_dummy_value() if signature.return_type == types.void else answer

        return signature.return_type(types.int64, *signature.args), codegen

    names = ", ".join(["typingctx", "address"] + [f"a{i}" for i in range(len(signature.args))])
    scope: dict[str, Any] = {"typed": typed}
    exec(f"def call({names}):\n    return typed({names})", scope)  # an intrinsic takes no *arguments
    return intrinsic(scope["call"])


@cache
def address_of(function: Any, signature: Any) -> Any:
    """Where a compiled function of a signature begins, for the life of the process; 0 where there is none (None)."""
    if INTERPRETED:
        return function
    if function is None:
        return 0
    compiled = function.get_compile_result(signature)
    return compiled.library.get_pointer_to_function(compiled.fndesc.llvm_func_name)


def structure(fields: Iterable[tuple[Any, ...]]) -> Any:
    """A structured data type: rows of an array of it are read as `array[i].name`, compiled or not."""
    return np.dtype((np.record, np.dtype(list(fields), align=True)))


def row(kind: Any) -> Any:
    """The compiler's type of one row of a `structure`."""
    return numba.from_dtype(kind)


def rows(kind: Any) -> Any:
    """The compiler's type of an array of a `structure`."""
    return types.Array(row(kind), 1, "C")


def columns(*names: str) -> Any:
    """The places 0, 1, ... of columns (or rows) under their names: ``C = columns("x", "y")``, then ``row[C.y]``."""
    return namedtuple("Columns", names)(*range(len(names)))


def unpacker(kind: Any) -> Any:
    """A kernel that gives the entries of a vector the names of a `record`, in the order of its fields."""
    if INTERPRETED:
        return lambda p: kind(*p[: len(kind._fields)])

    @intrinsic
    def unpack(typingctx, p):
        made = types.NamedUniTuple(types.float64, len(kind._fields), kind)

        def codegen(context, builder, signature, args):
            first = context.make_array(p)(context, builder, args[0]).data
            entries = [
                builder.load(builder.gep(first, [ir.Constant(ir.IntType(64), i)])) for i in range(len(kind._fields))
            ]
            return context.make_tuple(builder, made, entries)

        return made(vector), codegen

    return unpack


class Structure:
    """Rows of numbers under names, one row per slot of a batch (or a single one): an array of NumPy records.

    In a kernel ``rows[i].name`` reads and writes; `type` stands in signatures. Fields are float64, or int64 where the
    name is in `whole`.
    """

    def __init__(self, fields: Iterable[str], whole: Iterable[str] = ()) -> None:
        self.fields, integers = tuple(fields), set(whole)
        self.dtype = structure([(name, "i8" if name in integers else "f8") for name in self.fields])
        self.type = rows(self.dtype)

    def new(self, count: int = 1, **values: Any) -> Any:
        """An array (count,), zero but for the fields given; every row alike.

        Raises KeyError for a name that is no field.
        """
        rows = np.zeros(count, self.dtype)
        for name, value in values.items():
            rows[name] = value
        return rows


_ROOM = Path(__file__).parent
_IMPORT = re.compile(r"^[ \t]*from[ \t]+(\.+)([\w.]*)[ \t]+import[ \t]+(\([^)]*\)|[^\n]*)", re.MULTILINE)


def _imported(source: Path) -> Iterator[Path]:
    """The kernel files that a kernel file imports itself (the room imports nothing of ours by absolute names)."""
    for dots, module, names in _IMPORT.findall(source.read_text(encoding="utf-8")):
        folder = source.parents[len(dots) - 1].joinpath(*module.split(".")) if module else source.parents[len(dots) - 1]
        if folder.with_suffix(".py").is_file():
            yield folder.with_suffix(".py")
            continue
        for name in re.findall(r"\w+", re.sub(r"#.*|\bas\s+\w+", "", names)):
            if (folder / f"{name}.py").is_file():
                yield folder / f"{name}.py"


@cache
def import_closure(source: Path) -> tuple[Path, ...]:
    """A kernel file and every kernel file that it depends on, sorted."""
    found: set[Path] = set()
    waiting = [source.resolve()]
    while waiting:
        here = waiting.pop()
        if here not in found:
            found.add(here)
            waiting += [each.resolve() for each in _imported(here)]
    return tuple(sorted(found))


@cache
def source_hash(source: Path) -> str:
    """What the numbers of a kernel file depend on: its import closure and numba's version, as 16 hexadecimal digits."""
    digest = hashlib.sha256(numba.__version__.encode())
    for each in import_closure(source):
        digest.update(each.relative_to(_ROOM.resolve()).as_posix().encode())
        digest.update(each.read_bytes())
    return digest.hexdigest()[:16]


def cache_base() -> Path:
    """The folder of all compiled kernels: ``adaptrack`` in $NUMBA_CACHE_DIR, else $XDG_CACHE_HOME, else ~/.cache."""
    base = os.environ.get("NUMBA_CACHE_DIR") or os.environ.get("XDG_CACHE_HOME") or "~/.cache"
    return Path(base).expanduser() / "adaptrack"


@cache
def cache_directory(source: Path) -> Path | None:
    """Where the compiled functions of a kernel file are kept; None where nothing can be kept.

    The folder is named by `source_hash`. Numba re-compiles a function when *its own* file changes, not when a file that
    it inlines changes: a folder for each state of the import closure keeps yesterday's physics out of today's run.
    """
    folder = cache_base() / f"{source.stem}-{source_hash(source)}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        writable = os.access(folder, os.W_OK)
    except OSError:
        writable = False
    if not writable and not (folder.exists() and any(folder.rglob("*.nbi"))):
        _say_once(
            f"{cache_base()} cannot be written to, so every process compiles its kernels anew: about a minute. "
            "Set NUMBA_CACHE_DIR to a folder that can."
        )
        return None
    return folder


@cache
def _say_once(text: str) -> None:
    """A log record of level WARNING: without any configuration Python shows it on standard error, everywhere."""
    logging.getLogger("adaptrack").warning("adaptrack: %s", text)


class _ProvenFile(IndexDataCacheFile):  # type: ignore[misc]
    """Index and machine code of a kernel in the cache: files that end in the SHA-256 of the rest.

    Unpickling stops before it. Without it a torn file ends in any error, and a changed bit is other machine code. What
    is damaged counts as missing: the kernel is compiled and written again.
    """

    @contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[io.BytesIO]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as stream:
            stream.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def _load_index(self) -> Any:
        return super()._load_index() if _is_whole(self._index_path) else {}

    def _load_data(self, name: str) -> Any:
        return super()._load_data(name) if _is_whole(self._data_path(name)) else None

    def save(self, key: Any, data: Any) -> None:
        try:
            super().save(key, data)
        except OSError as error:
            remedy = f"Make room there, or delete {cache_base()}."
            _say_once(f"{self._cache_path}: takes no kernel: {error.strerror}. {remedy}")


def _is_whole(path: str) -> bool:
    """Whether a file of the cache is there and as it was written; damage is said."""
    try:
        content = Path(path).read_bytes()
    except FileNotFoundError:
        return False
    except OSError:
        content = b""
    size = hashlib.sha256().digest_size
    whole = hashlib.sha256(content[:-size]).digest() == content[-size:]
    if not whole:
        _say_once(f"{path}: damaged; its kernel is compiled anew. If this is said again, delete {cache_base()}.")
    return whole


@contextmanager
def _no_collection() -> Iterator[None]:
    """Without the garbage collector, which would go through the compiler's millions of live objects again and again:
    a sixth of the time.
    """
    collecting = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if collecting:
            gc.enable()


class _Kernel(CPUDispatcher):  # type: ignore[misc]
    """A kernel of given signatures, compiled (or loaded from the cache) when it is first needed.

    Needed: called from Python, called by a kernel that is being compiled, or asked for its address. So a process
    compiles what it uses and no more.
    """

    declared: tuple[Any, ...] = ()
    kept = False
    """whether its machine code is kept on disk"""

    def ready(self) -> None:
        """Compile for the declared signatures, unless that has been done."""
        if not (self._can_compile and self.declared):
            return
        with global_compiler_lock, _no_collection(), warnings.catch_warnings():
            # Functions as arguments work; numba calls them experimental each time.
            warnings.simplefilter("ignore", NumbaExperimentalFeatureWarning)
            if self._can_compile:
                for signature in self.declared:
                    self.compile(signature)
                self.disable_compile()

    def get_call_template(self, args: Any, kws: Any) -> Any:
        self.ready()
        return super().get_call_template(args, kws)

    def get_compile_result(self, sig: Any) -> Any:
        self.ready()
        return super().get_compile_result(sig)

    def _compile_for_args(self, *args: Any, **kws: Any) -> Any:
        if not self.declared:
            return super()._compile_for_args(*args, **kws)
        self.ready()
        return self  # the caller in C calls it with the arguments

    def _reduce_states(self) -> Any:
        self.ready()
        return super()._reduce_states()


class _Inlined(_Kernel):
    """A kernel without an entry for Python: a call of it from there would end the process."""

    def get_call_template(self, args: Any, kws: Any) -> Any:
        # Constants are seen after inlining: the function is compiled once for all of them.
        return super().get_call_template(tuple(types.unliteral(each) for each in args), kws)

    def __call__(self, *arguments: Any, **named: Any) -> Any:
        raise TypeError(f"{self.py_func.__name__}: is inlined into kernels and cannot be called from Python.")


class _Telling(Listener):  # type: ignore[misc]
    """Says that kernels are being compiled, once a process, and for how long it has been done."""

    def __init__(self) -> None:
        self.depth, self.seconds, self._begun = 0, 0.0, 0.0

    def on_start(self, event: Any) -> None:
        self.depth += 1
        if self.depth > 1:
            return
        self._begun = time.monotonic()
        dispatcher = event.data["dispatcher"]
        if isinstance(dispatcher, _Kernel) and dispatcher.kept:
            _say_once("compiling kernels, once for this version and use; up to a minute.")

    def on_end(self, event: Any) -> None:
        self.depth -= 1
        if self.depth == 0:
            self.seconds += time.monotonic() - self._begun


compiling = _Telling()
"""What this process has compiled: `seconds` of wall time so far."""
if not INTERPRETED:
    register("numba:compile", compiling)


def _compiled(function: Any, signature: Any, options: dict[str, Any]) -> Any:
    made = numba.njit(**options)(function)
    if not INTERPRETED:
        made.__class__ = _Inlined if options.get("no_cpython_wrapper") else _Kernel
        made.declared, made.kept = signature, options["cache"]
        if made.kept:
            made._cache._cache_file.__class__ = _ProvenFile
    return made


def njit(*signature: Any, **options: Any) -> Callable[[Any], Any]:
    """`numba.njit`, its cache in the `cache_directory` of the file that holds the function.

    A function with a signature is compiled when it is first needed; one that is not to be kept (a user's) at once, so
    that what is wrong with it is said where it is given.
    """

    def decorate(function: Any) -> Any:
        lazy = options.get("cache", False)
        folder = cache_directory(Path(function.__code__.co_filename)) if lazy and not INTERPRETED else None
        users, _numba_config.CACHE_DIR = _numba_config.CACHE_DIR, str(folder or "")
        try:
            made = _compiled(function, signature, {**options, "cache": folder is not None})
        finally:
            _numba_config.CACHE_DIR = users
        if not (lazy or INTERPRETED):
            made.ready()
        return made

    return decorate
