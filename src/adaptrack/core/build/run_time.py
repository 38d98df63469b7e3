"""Functions that are compiled at run time, by way of C: users' functions, and kernels that the library lacks.

A library of one function is kept by the hash of all that it is made of, in `folder`. Users' functions call more than
kernels do: plain functions of Python, which become a part of them, and `math`, whose functions are those that Python's
own `math` calls. So a function gives the same bits compiled and called back.
"""

from __future__ import annotations

import ast
import ctypes
import hashlib
import math
import operator
import os
import re
import sys
import tempfile
import time
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path
from types import FunctionType
from typing import Any, cast

import numpy as np

from .. import library
from ..kernel import Exported, Known, Row, inlined, record, viewer, void, written
from ..maths import exact
from ..member import UserFunction
from .c_files import SOFT_KERNELS, CFile, c_files
from .c_types import DOUBLE, INT64, NOTHING, PREFIX, ArrayOf, argument_type
from .compile import LACKING, OPTIONS, compile_objects, link, object_name
from .scopes import source_of
from .translate import FUNCTIONS, KernelError, Program, Translation, call_real
from .values import Operand, StaticValue, Value

UNUSED_DAYS = 30
"""days after which a library is deleted that no process has loaded"""
_ONE = ("sin", "cos", "tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "asinh", "acosh", "atanh", "exp", "exp2",
        "expm1", "log", "log2", "log10", "log1p", "cbrt")  # fmt: skip
_TWO = ("atan2", "pow", "fmod")
_MATH = (*_ONE, *_TWO)
"""Functions of C's library that Python's `math` calls. A function in C calls them by their addresses."""


def _remainder(a: float, b: float) -> float:
    """``a % b`` of real numbers."""
    remainder = math.fmod(a, b)
    if remainder == 0.0:
        return math.copysign(0.0, b)
    return remainder + b if (remainder < 0.0) != (b < 0.0) else remainder


def _quotient(a: float, b: float) -> float:
    """``a // b`` of real numbers."""
    if b == 0.0:
        return a / b
    quotient = (a - _remainder(a, b)) / b
    if quotient == 0.0:
        return math.copysign(0.0, a / b)
    whole = np.floor(quotient)
    return whole + 1.0 if quotient - whole > 0.5 else whole


def _degrees(x: float) -> float:
    return x * 57.29577951308232


def _radians(x: float) -> float:
    return x * 0.017453292519943295


def _written(function: Any, translation: Translation, results: list[Operand]) -> Operand:
    """A call of a function that is written here."""
    reals: list[Operand] = [translation.convert(value, DOUBLE) for value in translation.values(results)]
    return translation.call_inlined(Known("inlined", function), reals, cast(Any, None))


_NUMPY = {np.abs: abs, np.isnan: math.isnan, np.isfinite: math.isfinite, np.isinf: math.isinf,
          np.copysign: math.copysign, np.float64: float}  # fmt: skip
_RULES: dict[Any, Any] = {
    **FUNCTIONS,
    **{function: FUNCTIONS[same] for function, same in _NUMPY.items()},
    **{getattr(math, name): partial(call_real, f"python_{name}", DOUBLE) for name in _MATH if hasattr(math, name)},
    pow: partial(call_real, "python_pow", DOUBLE),
    math.sqrt: partial(call_real, "sqrt1", DOUBLE), np.sqrt: partial(call_real, "sqrt1", DOUBLE),
    math.fabs: partial(call_real, "abs1", DOUBLE),
    np.floor: partial(call_real, "floor1", DOUBLE), np.ceil: partial(call_real, "ceil1", DOUBLE),
    operator.mod: partial(_written, _remainder), operator.floordiv: partial(_written, _quotient),
    math.degrees: partial(_written, _degrees), math.radians: partial(_written, _radians),
}  # fmt: skip
_FOLDED = {float, int, abs, min, max, len, range, tuple, round, pow, sum, bool}
"""Functions of Python whose result depends on their arguments alone."""


@dataclass(frozen=True)
class ListOf:
    """A list of real numbers: a value in C."""

    name = "list"
    c = "struct list"


LIST = ListOf()
LIST_ROOM = 64
"""numbers that a list holds at most"""
_LIST_IN_C = f"""struct list {{ double numbers[{LIST_ROOM}]; long long size; }};
static inline __attribute__((always_inline, unused)) void list_append(struct list *x, double number) {{
    if (x->size < {LIST_ROOM}) x->numbers[x->size++] = number;
}}
"""


def _length(translation: Translation, results: list[Operand]) -> Operand:
    """The number of elements, also of a list."""
    (result,) = results
    if isinstance(result, Value) and result.kind == LIST:
        return Value(f"{result.text}.size", INT64)
    length: Operand = FUNCTIONS[len](translation, results)
    return length


def _zeros(translation: Translation, results: list[Operand]) -> Operand:
    """An array of a known shape on the stack."""
    if not (len(results) == 1 and isinstance(results[0], StaticValue)):
        raise translation.error("np.zeros and np.empty take a shape that is known, and no type.")
    shape = results[0].value
    room = Known("local", _zeros, shape if isinstance(shape, tuple) else (shape,))
    return translation.call_local(room, [], cast(Any, None))


class UserTranslation(Translation):
    """One pass over a user's function, which has lists and arrays that kernels have not."""

    def evaluate_List(self, node: ast.List) -> Operand:
        """A list of real numbers."""
        numbers = [self.convert(value, DOUBLE).text for value in self.values(self.arguments(node.elts))]
        if len(numbers) > LIST_ROOM:
            raise self.error(f"a list has at most {LIST_ROOM} numbers: use an array.", node)
        return Value(f"(struct list){{{{{', '.join(numbers) or '0.0'}}}, {len(numbers)}}}", LIST)

    def evaluate_Subscript(self, node: ast.Subscript) -> Operand:
        if isinstance(node.value, ast.Name):
            owner = self.expression(node.value)
            if isinstance(owner, Value) and owner.kind == LIST:
                return Value(f"{owner.text}.numbers[{self.value(self.expression(node.slice)).text}]", DOUBLE)
        return super().evaluate_Subscript(node)

    def write_Expr(self, node: ast.Expr) -> None:
        call = node.value
        if isinstance(call, ast.Call) and isinstance(call.func, ast.Attribute) and call.func.attr == "append":
            owner = self.value(self.expression(call.func.value))
            (number,) = (self.convert(self.value(result), DOUBLE) for result in self.arguments(call.args))
            if owner.kind != LIST:
                raise self.error("append is of a list of numbers.", node)
            self.emit(f"list_append(&{owner.text}, {number.text});")
            return
        super().write_Expr(node)

    def write_Return(self, node: ast.Return) -> None:
        super().write_Return(node)
        if isinstance(self.instance.returned, ArrayOf) and self.storage:
            raise self.error("an array of a function ends with it: write to one of the caller's arrays.", node)

    def _array_view(self, array: Value, node: ast.Call) -> Value:
        """``vector.view(layout)``: rows of a record in a vector, of which the first is taken."""
        (argument,) = self.arguments(node.args)
        layout = argument.value if isinstance(argument, StaticValue) else None
        if not (isinstance(layout, np.dtype) and layout.names):
            return super()._array_view(array, node)
        row = argument_type(Row(_record_of(layout, "Parameters"))).record
        return self.make_array(ArrayOf(row, 1), f"({row.c} *){self.hold(array).data}", [1])


class UserProgram(Program):
    """All functions that a user's function needs."""

    translation_class = UserTranslation
    functions = _RULES | {len: _length, np.zeros: _zeros, np.empty: _zeros}

    def folds(self, function: Any) -> bool:
        module = str(getattr(function, "__module__", ""))
        return function in _FOLDED or module == "math" or module.startswith("adaptrack.core")

    def inlines(self, function: Any) -> bool:
        return isinstance(function, FunctionType)

    def refusal(self, function: Any, name: str) -> str:
        short = name.rsplit(".", 1)[-1].replace("arc", "a")
        if short in _MATH:
            return f"{name} is not in the subset: use math.{short}."
        if short in ("hypot", "floor", "ceil", "clip"):
            return f"{name} is not in the subset: use {short} of adaptrack.core.public."
        if short == "array":
            return f"{name} is not in the subset: use np.zeros of a known shape."
        return f"{name} is not in the subset: see 'Functions in Python' in docs/extending.md."


def has_source(function: Any) -> bool:
    """Whether the source of a function can be read."""
    try:
        source_of(function)
    except (AttributeError, LookupError, SyntaxError, TypeError):
        return False
    return True


def compiled_now(kernel: Exported) -> int:
    """Compile an exported kernel or a user's function, and the kernels that it calls; the address of its C function.

    Raises KernelError where it is outside the subset.
    """
    name, program = kernel.name, Program()
    if isinstance(kernel, UserFunction):
        program = UserProgram()
        kernel = _called_as_kernel(kernel, program)
    kernels = {kernel.name: kernel}
    if _processor().endswith(LACKING):
        kernels |= {name: getattr(exact, name) for name in SOFT_KERNELS}
    files = c_files(kernels, program=program)
    called: set[str] = set()
    for room, file in files.items():
        names = sorted(set(re.findall(r"\bpython_(\w+)\(", file.text)) & {*_MATH})
        files[room] = replace(file, text=_declarations(names) + _LIST_IN_C * ("struct list" in file.text) + file.text)
        called |= {*names}
    functions = ctypes.CDLL(str(_library(name, files)))
    for name in called:
        ctypes.c_void_p.in_dll(functions, f"python_{name}").value = _address(_c_library(), name)
    return _address(functions, PREFIX + kernel.name)


def _address(functions: ctypes.CDLL, name: str) -> int:
    return int(ctypes.cast(getattr(functions, name), ctypes.c_void_p).value or 0)


def _called_as_kernel(member: UserFunction, program: Program) -> Exported:
    """A kernel that calls a user's function: with its last array but one as a record, where it wants one."""
    signature, function = member.signature, inlined(member.function)
    kinds = [argument_type(kind) for kind in signature.types]
    names = [f"a{i}" for i in range(len(kinds))]
    arguments, view = list(names), None
    if member.viewed is not None:
        kind = _record_of(member.viewed, "Parameters")
        view, kinds[-2], arguments[-2] = viewer(kind), argument_type(Row(kind)), f"view({names[-2]}, 0)"
    source = source_of(member.function)
    parameters = source.node.args
    if len(parameters.args) != len(names) or parameters.vararg or parameters.kwarg or parameters.kwonlyargs:
        raise KernelError(
            f"{source.file}:{source.node.lineno}: {member.name}: has the arguments ({ast.unparse(parameters)}): "
            f"it is called with {len(names)} by their places."
        )
    call = f"function({', '.join(arguments)})"
    if signature.returns == (void,):
        lines = [call]
    elif program.instance(member.function, kinds).returned == NOTHING:
        lines = [call, "return 0.0"]
    else:
        lines = [f"return {call}"]
    kernel = written("call", ", ".join(names), lines, function=function, view=view).function
    return Exported(kernel, f"user_{re.sub(r'[^0-9a-zA-Z_]', '_', member.name)}", signature)


@cache
def _record_of(layout: Any, name: str) -> Any:
    """The record of a structured data type."""
    fields: list[Any] = []
    for field in layout.names:
        of = layout[field]
        fields.append((field, _record_of(of, f"{name}_{field}")) if of.names else field)
    return record(name, fields)


def _declarations(names: list[str]) -> str:
    """Variables with the addresses of `_MATH`, which `compiled_now` writes."""
    return "".join(
        f'__attribute__((weak, visibility("default"))) double (*python_{name})(double{", double" * (name in _TWO)});\n'
        for name in names
    )


@cache
def _c_library() -> ctypes.CDLL:
    """The library of C in which Python's `math` finds its functions."""
    try:
        return ctypes.CDLL({"linux": "libm.so.6", "win32": "ucrtbase"}.get(sys.platform))
    except OSError:  # of another system
        return ctypes.CDLL(None)


def _processor() -> str:
    """The processor for which functions are compiled."""
    name = os.environ.get("ADAPTRACK_PROCESSOR") or library.processor()
    return re.sub("-(checked|sanitized)$", "", name)


def _library(name: str, files: dict[str, CFile]) -> Path:
    """The library of these files, compiled where it is not there."""
    processor = _processor()
    names = [object_name(file, processor, OPTIONS) for file in files.values()]
    digest = hashlib.sha256(" ".join(names).encode()).hexdigest()[:16]
    path = folder() / f"{re.sub(r'[^0-9a-zA-Z_]', '_', name)}-{digest}.{processor}.so"
    try:
        os.utime(path)
        return path
    except OSError:
        pass
    with tempfile.TemporaryDirectory(dir=folder()) as workshop:
        objects, _ = compile_objects(files, processor, Path(workshop))
        link(objects, processor, Path(workshop) / path.name)
        os.replace(Path(workshop) / path.name, path)
    for other in folder().glob("*.so"):
        with suppress(OSError):
            if time.time() - other.stat().st_mtime > UNUSED_DAYS * 86400.0:
                other.unlink()
    return path


def cache_path() -> Path:
    """The user's folder for what is compiled, in ``XDG_CACHE_HOME`` or ``LOCALAPPDATA`` if they are set."""
    home = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or Path.home() / ".cache"
    return Path(home) / "adaptrack"


@cache
def folder() -> Path:
    """The folder in which libraries are kept: the user's cache, or one for this process where that is read-only."""
    place = cache_path()
    try:
        place.mkdir(parents=True, exist_ok=True, mode=0o700)
        with tempfile.TemporaryFile(dir=place):
            return place
    except OSError:
        return Path(tempfile.mkdtemp(prefix="adaptrack-"))
