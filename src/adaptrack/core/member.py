"""Users' functions that kernels call: in Python, compiled where a compiler is there, else called back; or in C."""

from __future__ import annotations

import ctypes
import logging
import math
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from . import library
from .kernel import CALLED_BACK, INTERPRETED, INTERRUPTS, Array, Exported, Scalar, Signature, float64, void


@dataclass(frozen=True)
class CFunction:
    """A function of a shared library, written in C, C++ or Rust: a plant, a law, a model or an estimator.

    It takes what the contract says: a float64 is a double, an integer int64_t, an array a pointer and a size for each
    dimension. It returns double or nothing. Found again by file and name, it crosses to other processes.

    Raises OSError for a file that cannot be loaded, AttributeError for a name that is not in it.
    """

    file: str
    name: str

    def __post_init__(self) -> None:
        self.address  # noqa: B018  (what is wrong with it is said where it is named)

    @property
    def address(self) -> int:
        function = getattr(ctypes.CDLL(self.file), self.name)
        return int(ctypes.cast(function, ctypes.c_void_p).value or 0)

    @property
    def __name__(self) -> str:
        return self.name


MemberFunction = Callable[..., None] | CFunction
"""What may be a member: a function of Python's or of a shared library."""


def compiles() -> bool:
    """Whether functions in Python are compiled: a compiler is there, and kernels are not interpreted."""
    return not INTERPRETED and library.can_compile()


class UserFunction(Exported):
    """A user's function that kernels call.

    One that raises leaves NaN in the array that it had to write last, and answers NaN.
    """

    def __init__(self, function: Any, signature: Signature, viewed: Any = None) -> None:
        super().__init__(function, getattr(function, "__name__", "function"), signature)
        self.viewed = viewed

    @property
    def calls_python(self) -> bool:
        """Whether each call goes back to Python: one car can wait for that, a batch cannot."""
        if isinstance(self.function, CFunction):
            return False
        return not (compiles() and library.compiler().has_source(self.function))

    @cached_property
    def address(self) -> int:
        if isinstance(self.function, CFunction):
            return self.function.address
        if self.calls_python:
            self._callback = self.signature.prototype(_called_back(self))
            return int(ctypes.cast(self._callback, ctypes.c_void_p).value or 0)
        return int(library.compiler().compiled_now(self))

    def __reduce__(self) -> Any:
        return member, (self.function, self.signature, self.viewed)

    def __deepcopy__(self, memo: Any) -> UserFunction:
        return self  # it never changes, and takes long to compile


class CallBack:
    """A function of Python's as a member of a signature that returns nothing; it is given the words of its arguments.

    What it raises cannot pass through the kernels: `raise_error` raises it once they have returned, and until then it
    is not called again.
    """

    def __init__(self, function: Callable[..., None], signature: Signature) -> None:
        self.function = function
        self._error: BaseException | None = None
        self._callback: Any = None if INTERPRETED else signature.prototype(self)

    @property
    def address(self) -> int:
        return int(ctypes.cast(self._callback, ctypes.c_void_p).value or 0)

    def __call__(self, *arguments: Any) -> None:
        if self._error is None:
            try:
                self.function(*arguments)
            except BaseException as error:
                self._error = error

    def raise_error(self) -> None:
        """Raise what the function has raised since the last call of this method."""
        if self._error is not None:
            error, self._error = self._error, None
            raise error


def member(function: Any, signature: Signature, viewed: Any = None) -> Any:
    """A user's function (Python's or a `CFunction`) as a member of a signature.

    viewed: the structured type as which it takes its last array but one, a record; None: all as arrays.
    """
    function = getattr(function, "function", function)
    if INTERPRETED:
        if isinstance(function, CFunction):
            raise TypeError("interpreted kernels cannot call C: unset ADAPTRACK_KERNELS.")
        return function if viewed is None else on_a_record(function, viewed)
    new_member = UserFunction(function, signature, viewed)
    new_member.address  # noqa: B018  (what is wrong with it is said where it is given)
    return new_member


def on_a_record(function: Any, viewed: Any) -> Any:
    """A function of arrays around one that takes its last array but one as a record."""
    return lambda *arguments: function(*arguments[:-2], arguments[-2].view(viewed)[0], arguments[-1])


def _called_back(member: UserFunction) -> Any:
    """Return the function that C calls in place of a Python function; exceptions cannot pass through the kernels."""
    function = member.function if member.viewed is None else on_a_record(member.function, member.viewed)
    kinds = member.signature.types
    last = max(i for i, kind in enumerate(kinds) if isinstance(kind, Array))
    nothing = member.signature.returns == (void,)
    warned = False

    def call(*words: Any) -> Any:
        nonlocal warned
        arguments: list[Any] = []
        try:
            arguments += _values(kinds, iter(words))
            with np.errstate(all="ignore"):  # compiled, a division by zero is infinite and says nothing
                CALLED_BACK.now = True
                answer = function(*arguments)
            return None if nothing else float(answer or 0.0)
        except KeyboardInterrupt as interrupt:  # raised again when the kernel has returned
            INTERRUPTS[threading.get_ident()] = interrupt
        except Exception as error:
            if not warned:
                logging.getLogger("adaptrack").warning("adaptrack: %s raised %r", member.name, error)
            warned = True
        finally:
            CALLED_BACK.now = False
        if len(arguments) > last:
            arguments[last][...] = math.nan
        return None if nothing else math.nan

    return call


def _values(kinds: Any, words: Iterator[Any]) -> Iterator[Any]:
    """The values of types that stand for these words: the inverse of `given`."""
    for kind in kinds:
        if isinstance(kind, Scalar):
            yield next(words)
        elif isinstance(kind, Array):
            yield _array(kind, words)
        else:
            yield _record(kind.of, _words_at(next(words)))


def _array(kind: Array, words: Iterator[Any]) -> Any:
    place, *sizes = (next(words) for _ in range(1 + kind.ndim))
    count = math.prod(sizes)
    if not count:
        return np.zeros(sizes, kind.dtype)
    memory = (ctypes.c_byte * (count * kind.dtype.itemsize)).from_address(place)
    return np.frombuffer(memory, kind.dtype).reshape(sizes)


def _words_at(place: int) -> Iterator[int]:
    while True:
        yield ctypes.c_int64.from_address(place).value
        place += 8


def _record(kind: Any, words: Iterator[int]) -> Any:
    """The record that lies in these words, see `kernel.Resident`."""
    values = []
    for field in kind.kinds.values():
        if hasattr(field, "kinds"):
            values.append(_record(field, words))
        elif isinstance(field, Array):
            values.append(_array(field, words))
        else:
            word = next(words)
            values.append(float(np.int64(word).view(np.float64)) if field == float64 else word)
    return kind(*values)
