"""The contract of a function in a schedule, and the kinds that are known."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput, did_you_mean

Array = NDArray[np.float64]


class Packed(NamedTuple):
    """A function as the kernels read it, see `core.scheduling.functions`."""

    kind: int
    integers: Sequence[int]
    numbers: Sequence[float]
    scratch: int
    """reals that its evaluation needs"""


class Function(ABC):
    """One entry of a tuning as a function of the schedule's inputs.

    A kind of one's own packs itself as one of the kernels' kinds (most are a table or a rule of a fuzzy system), and
    joins by `register_function`, so that files of schedules can hold it.
    """

    kind: ClassVar[str]
    """its name in files"""

    @property
    @abstractmethod
    def n_inputs(self) -> int | None:
        """The number D of inputs; None when any will do."""

    @abstractmethod
    def predict(self, x: Array) -> Array:
        """(n,) values at the inputs x (n, D), by NumPy: the reference for the kernels."""

    @abstractmethod
    def pack(self) -> Packed:
        """The function as the kernels read it."""

    @abstractmethod
    def shifted(self, by: float) -> Self:
        """Return a copy of the function with `by` added everywhere."""

    @abstractmethod
    def blended(self, share: float, value: float) -> Self:
        """The function that lies a share of the way from this one to `value` everywhere."""

    @abstractmethod
    def save(self) -> dict[str, Any]:
        """Return the content of the function's file (text, numbers, lists), which `load` reads back to the bit."""

    @classmethod
    @abstractmethod
    def load(cls, saved: Mapping[str, Any]) -> Self:
        """The function that was saved; raises `KeyError`, `TypeError` or `ValueError` when `saved` holds none."""


class Pool:
    """Packed functions, one behind the other."""

    def __init__(self) -> None:
        self.integers: list[int] = []
        self.numbers: list[float] = []
        self.scratch = 0

    def add(self, function: Function, row: Any) -> int:
        """Pack a function, write to `row` where it begins; returns its kind."""
        packed = function.pack()
        row.integers, row.numbers = len(self.integers), len(self.numbers)
        self.integers += packed.integers
        self.numbers += packed.numbers
        self.scratch = max(self.scratch, packed.scratch)
        return packed.kind


_KINDS: dict[str, type[Function]] = {}


def register_function(kind: type[Function]) -> type[Function]:
    """Make a kind of function known to the files of schedules; returns it, so that it may stand above a class.

    Raises
    ------
    InvalidInput
        When another kind has its name.
    """
    if _KINDS.setdefault(kind.kind, kind) is not kind:
        raise InvalidInput(f"register_function: another kind of function is named {kind.kind!r}: choose another name.")
    return kind


def save_function(function: Function) -> dict[str, Any]:
    """A function with the name of its kind."""
    return {"kind": function.kind, **function.save()}


def load_function(saved: Mapping[str, Any]) -> Function:
    """The function that `save_function` saved.

    Raises
    ------
    InvalidInput
        When its kind is unknown, or it makes no function.
    """
    kind = saved["kind"]
    if not isinstance(kind, str) or kind not in _KINDS:
        raise InvalidInput(f"unknown kind of function {kind!r}. {did_you_mean(str(kind), _KINDS)}")
    return _KINDS[kind].load(saved)


def read_array(values: Any, kind: Any = np.float64) -> NDArray[Any]:
    """Numbers of a file as an array; text, or fractions where whole numbers are needed, raise `TypeError`."""
    array = np.asarray(values)
    return array.astype(kind, casting="safe" if array.size else "unsafe")
