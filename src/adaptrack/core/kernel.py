"""What kernels are made of: types of their arguments, records, and the two decorators.

Rules of the room
-----------------
* Kernels take and return numbers, C-contiguous arrays and records of these; they allocate nothing and raise nothing.
* Arithmetic is strict IEEE double precision: no re-association and no implicit contraction. Where a fused
  multiply-add is wanted it is written, `fma(a, b, c)`. So a run gives the same bits alone or in a batch.
* An `inlined` function is a part of those that call it. An `exported` one has a name and a signature: the library has
  it as a C function (see `library`), and Python calls it there.
"""

from __future__ import annotations

import ctypes
import importlib
import math
import struct
import sys
import threading
from collections import namedtuple
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from functools import cached_property, partial, update_wrapper
from typing import Any, NamedTuple, cast

import numpy as np

from . import library

OK = 0
"""Status with which a kernel reports success; each kernel numbers its failures from 1."""
INTERPRETED = library.WAY == "interpreted"
"""Whether kernels run as plain Python."""


# -- types ------------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class Scalar:
    """float64 (double in C), int64 or boolean (int64_t), void. Called, it makes a signature: ``float64(vector)``."""

    name: str

    @property
    def ctypes(self) -> Any:
        return (ctypes.c_double if self.name == "float64" else ctypes.c_int64,)

    def convert(self, value: Any) -> tuple[Any, ...]:
        return (float(value) if self.name == "float64" else int(value),)

    def __call__(self, *arguments: Any) -> Signature:
        return Signature((self,), arguments)


_NOTHING: Any = ctypes.c_byte * 0


@dataclass(frozen=True)
class Array:
    """A C-contiguous array of numbers or of rows (a record of numbers): in C a pointer, then a size a dimension."""

    of: Any
    ndim: int

    @property
    def ctypes(self) -> Any:
        return (ctypes.c_void_p, *[ctypes.c_int64] * self.ndim)

    @cached_property
    def dtype(self) -> Any:
        return np.dtype(self.of.name) if isinstance(self.of, Scalar) else self.of.dtype

    def convert(self, value: Any) -> tuple[Any, ...]:
        if not (isinstance(value, np.ndarray) and value.ndim == self.ndim and value.dtype == self.dtype):
            raise TypeError(f"{value!r}: need an array of {self.ndim} dimensions, {self.dtype}.")
        try:
            return (ctypes.addressof(_NOTHING.from_buffer(value)), *value.shape)  # a third of the time of the other
        except TypeError:  # one that may not be written to, or
            if not value.flags.c_contiguous:
                raise TypeError("need an array whose rows lie one behind the other (C-contiguous).") from None
            return (value.ctypes.data, *value.shape)


@dataclass(frozen=True)
class Place:
    """A record that stays where it is: a kernel loads the fields that it uses. In C a pointer to its words."""

    of: Any
    ctypes = (ctypes.c_void_p,)

    def convert(self, value: Any) -> tuple[Any, ...]:
        return (value if isinstance(value, Resident) else Resident(value),)


class Row(Place):
    """One row of an array of a record of numbers: a kernel may write to it."""

    def convert(self, value: Any) -> tuple[Any, ...]:
        return (value.__array_interface__["data"][0],)  # a row by itself has no `ctypes`


@dataclass(frozen=True)
class Signature:
    """Types of what a kernel returns (several: the C function writes them behind its last argument) and takes."""

    returns: tuple[Scalar, ...]
    arguments: tuple[Any, ...]

    @cached_property
    def types(self) -> tuple[Any, ...]:
        """Types of the arguments; a record is passed whole, in C by a pointer."""
        return tuple(Place(kind) if hasattr(kind, "kinds") else kind for kind in self.arguments)

    @property
    def prototype(self) -> Any:
        """The type of the C function."""  # not kept: it cannot be pickled, and ctypes has each only once
        parameters = [kind for ctype in self.types for kind in ctype.ctypes]
        if len(self.returns) > 1:
            return ctypes.CFUNCTYPE(None, *parameters, ctypes.c_void_p)
        return ctypes.CFUNCTYPE(None if self.returns == (void,) else self.returns[0].ctypes[0], *parameters)


def several(*kinds: Scalar) -> Callable[..., Signature]:
    """For signatures of functions that return several numbers: ``several(int64, float64)(vector)``."""
    return lambda *arguments: Signature(kinds, arguments)


float64, int64, boolean, void = map(Scalar, ("float64", "int64", "boolean", "void"))
vector, matrix, cube, four_dimensions = (Array(float64, ndim) for ndim in (1, 2, 3, 4))
int_vector, int_matrix = (Array(int64, ndim) for ndim in (1, 2))


# -- records ----------------------------------------------------------------------------------------------------------
class Field(NamedTuple):
    """A field of a record, defined once: Python's settings (`control.settings`) and the C header follow from it."""

    name: str
    unit: str
    """empty for a pure number"""
    default: float | tuple[float, ...]
    """NaN: unknown, None in Python; a tuple: an array of so many numbers; an int, a bool: a whole number, a truth in
    Python"""
    meaning: str
    bounds: str = ""
    """the interval of the values that users may set, such as "[0, inf)"; empty: a constant that they do not set"""
    hint: str = ""
    """how the message ends that refuses a value"""

    @property
    def remark(self) -> str:
        """Unit, bounds and meaning."""
        return ", ".join(text for text in (self.unit, self.bounds, self.meaning) if text)

    @property
    def ends(self) -> tuple[float, float]:
        """The lower and the upper bound; infinite without bounds."""
        low, high = self.bounds[1:-1].split(",") if self.bounds else ("-inf", "inf")
        return float(low), float(high)

    @property
    def limits(self) -> dict[str, float]:
        """The finite bounds as pydantic names them: gt or ge, lt or le."""
        names = "ge" if self.bounds[0] == "[" else "gt", "le" if self.bounds[-1] == "]" else "lt"
        return {name: end for name, end in zip(names, self.ends, strict=True) if math.isfinite(end)}

    @property
    def is_truth(self) -> bool:
        """Whether the field is True or False in Python."""
        return isinstance(self.default, bool)

    @property
    def kind(self) -> Any:
        """The type of the field."""
        return (float64, len(self.default)) if isinstance(self.default, tuple) else float64


def record(name: str, fields: Collection[str | Field | tuple[Any, ...]], integers: Iterable[str] = ()) -> Any:
    """A record: a named tuple class whose `kinds` are the types of its fields.

    A field is a name alone, of a number (float64; int64 if the name is in `integers`), a `Field`, or a name with its
    type: a number, an array, another record, or (type, count) for so many in a row. Behind the type of an array stands
    its shape, a number or the name of a size for each dimension (see `layout`). A record of numbers alone can be a row
    of an array: it has a `dtype` and `new`, and `rows` is the type of an array of it.
    """
    settings = {field.name: field for field in fields if isinstance(field, Field)}
    kinds = dict(_named_kind(field, integers) for field in fields)
    # It belongs to the module that asks for it: pickled, it is found again by module and name.
    module = sys._getframe(1).f_globals["__name__"]
    record_type = cast(Any, namedtuple)(name, kinds, module=module)
    record_type.kinds, record_type.field_settings = kinds, settings
    record_type.shapes = {field[0]: field[2:] for field in fields if not isinstance(field, str | Field)}
    record_type.new = cast(Any, classmethod)(_new)
    record_type.dtype = _dtype(kinds)
    return record_type


def _named_kind(field: Any, integers: Iterable[str]) -> tuple[str, Any]:
    if isinstance(field, Field):
        return field.name, int64 if field.name in integers else field.kind
    return (field, int64 if field in integers else float64) if isinstance(field, str) else field[:2]


def defaults(kind: Any) -> Any:
    """A record of settings at their defaults, records within it included."""
    settings = kind.field_settings
    return kind(*(settings[name].default if name in settings else defaults(of) for name, of in kind.kinds.items()))


def rows(kind: Any) -> Array:
    """The type of an array of rows of a record of numbers."""
    return Array(kind, 1)


def _dtype(kinds: dict[str, Any]) -> Any:
    """The NumPy type of a row; None for a record that holds arrays."""
    entries: list[Any] = []
    for name, kind in kinds.items():
        kind, *count = kind if type(kind) is tuple else (kind,)
        inner = kind.name if isinstance(kind, Scalar) else getattr(kind, "dtype", None)
        if inner is None or isinstance(kind, Array):
            return None
        entries.append((name, inner, *([tuple(count)] if count else [])))
    return np.dtype((np.record, np.dtype(entries, align=True)))


def _new(kind: Any, count: int = 1, **values: Any) -> Any:
    """An array (count,) of rows, zero but for the fields given; every row alike.

    Raises ValueError for a name that is no field.
    """
    entries = np.zeros(count, kind.dtype)
    for name, value in values.items():
        entries[name] = value
    return entries


def row_of(kind: Any, source: Any = None, **values: Any) -> Any:
    """A row of a record of numbers: each field the attribute of that name, NaN where it is missing or None."""
    row = kind.new(1)[0]
    for name in kind.dtype.names:
        value = values[name] if name in values else getattr(source, name, None)
        row[name] = (math.nan if kind.kinds[name].name == "float64" else 0) if value is None else value
    return row


def columns(*fields: str | Field) -> Any:
    """The places 0, 1, ... of columns (or rows) under their names: ``C = columns("x", "y")``, then ``row[C.y]``.

    A column is a name or a `Field`; ``C.field_settings`` holds the fields by name.
    """
    settings = {field.name: field for field in fields if isinstance(field, Field)}
    kind = cast(Any, namedtuple)("Columns", [field if isinstance(field, str) else field.name for field in fields])
    kind.field_settings = settings
    return kind(*range(len(fields)))


def fields_of(table: Any) -> tuple[Field, ...]:
    """The `Field`s of a record or of columns, in order."""
    return tuple(table.field_settings.values())


def size_of(kind: Any) -> int:
    """How many numbers (8 bytes each) a record of numbers takes."""
    return int(kind.dtype.itemsize) // 8


def viewer(kind: Any) -> Any:
    """A kernel ``view(vector, place)``: the record of numbers that lies in a vector from a place on.

    Its fields are read and written there by name, its rows of numbers are arrays; the vector must be long enough.

    Raises ValueError for a field that is called like an attribute of NumPy's records: in Python it would be hidden.
    """
    if hidden := [name for name in kind._fields if hasattr(np.record, name)]:
        raise ValueError(f"{kind.__name__}: NumPy's records have {', '.join(hidden)} of their own: choose other names.")
    return _make_known("view", lambda vector, place: vector[place : place + size_of(kind)].view(kind.dtype)[0], kind)


def unpacker(kind: Any, stride: int = 1) -> Any:
    """An inlined function ``unpack(p, first=0)``: the record whose entries lie in a vector from a place on, so many
    apart.
    """
    entries = ", ".join(f"p[{at}]" for at in _entries(kind, stride))
    return written(f"unpack_{kind.__name__}", "p, first=0", [f"return kind({entries})"], kind)


def packer(kind: Any, stride: int = 1) -> Any:
    """An inlined function ``pack(p, first, value)``: writes a record where `unpacker`'s reads it."""
    lines = [f"p[{at}] = value.{name}" for name, at in zip(kind._fields, _entries(kind, stride), strict=True)]
    return written(f"pack_{kind.__name__}", "p, first, value", lines, kind)


def copier(kind: Any) -> Any:
    """An inlined function ``copy(source, target)``: copies the numbers of a row to a different row."""
    lines = [f"target.{name} = source.{name}" for name in kind._fields]
    return written(f"copy_{kind.__name__}", "source, target", lines, kind)


def bounds_checker(fields: Iterable[Field], optional: bool = False) -> Any:
    """An inlined function ``is_within(row)``: whether the numbers of a row lie within the bounds of fields.

    optional: NaN, an unknown number, counts as within.
    """
    opposites = {">": "<=", ">=": "<", "<": ">=", "<=": ">"}
    signs = dict(zip(("gt", "ge", "lt", "le"), opposites, strict=True))
    tests = []
    for field in fields:
        limits = field.limits | ({"lt": math.inf} if field.bounds.endswith("inf)") else {})
        tests += [(f"row.{field.name}", signs[name], f"{end!r}") for name, end in limits.items()]
    if optional:
        test = f"not ({' or '.join(f'{number} {opposites[sign]} {end}' for number, sign, end in tests)})"
    else:
        test = " and ".join(map(" ".join, tests))
    return written("is_within", "row", [f"return {test}"])


def default_setter(kind: Any) -> Any:
    """An inlined function ``set_defaults(target)``: writes the defaults of a record of settings to a row."""
    lines = [f"target.{place} = {value!r}" for place, value in _default_entries(kind)]
    return written(f"set_defaults_of_{kind.__name__}", "target", lines, kind)


def _default_entries(kind: Any) -> Iterable[tuple[str, float]]:
    """The place of each number of a record of settings, and its default."""
    for name, of in kind.kinds.items():
        default = kind.field_settings[name].default if name in kind.field_settings else None
        if default is None:
            yield from ((f"{name}.{place}", value) for place, value in _default_entries(of))
        elif isinstance(default, tuple):
            yield from ((f"{name}[{i}]", float(value)) for i, value in enumerate(default))
        else:
            yield name, float(default)


def stepper(kind: Any) -> Any:
    """An inlined function ``step(x, h, slope)``: the record x + h slope."""
    entries = ", ".join(f"fma(h, slope.{name}, x.{name})" for name in kind._fields)
    return written(f"step_{kind.__name__}", "x, h, slope", [f"return kind({entries})"], kind)


def _entries(kind: Any, stride: int) -> list[str]:
    return [f"{stride * i} + first" for i in range(len(kind._fields))]


def written(name: str, arguments: str, lines: Iterable[str], kind: Any = None, **scope: Any) -> Any:
    """An inlined function that is written as text; it may use names of a scope, and a record by the name ``kind``."""
    text = "\n    ".join([f"def {name}({arguments}):", *lines])
    scope |= {
        "__name__": getattr(kind, "__module__", __name__),
        "kind": kind,
        "fma": fma,
        "inf": math.inf,
        "nan": math.nan,
    }
    exec(text, scope)
    scope[name].source_text = text  # `build.translate` reads it
    return inlined(scope[name])


def local(*shape: int) -> Any:
    """A kernel ``zeros()``: an array of zeros of a fixed shape, there until the kernel that calls it returns.

    ``square = local(3, 3)`` in the file, ``z = square()`` in a kernel. It lies on the stack, if not in registers.
    """
    return _make_known("local", lambda: np.zeros(shape), shape)


class Resident:
    """A record for kernels that take it: where its fields lie is written down once, a word for a number, and for an
    array its place and its sizes. Its arrays must not be replaced. A copy holds a copy of the record, where that lies.
    """

    def __new__(cls, record: Any) -> Any:
        return record if INTERPRETED else super().__new__(cls)

    def __init__(self, record: Any) -> None:
        self.record = record
        self.words = np.array(list(_words(record)), np.int64)
        self._as_parameter_ = ctypes.c_void_p(self.words.ctypes.data)

    def __reduce__(self) -> Any:
        return Resident, (self.record,)


def _words(record: Any) -> Iterable[int]:
    for kind, value in zip(record.kinds.values(), record, strict=True):
        if isinstance(value, tuple):
            yield from _words(value)
        elif kind is float64:
            yield from struct.unpack("q", struct.pack("d", value))
        else:
            yield from kind.convert(value)


# -- functions --------------------------------------------------------------------------------------------------------
class Known:
    """A function that kernels may call.

    kind: what it is to the compiler, see `build.translate`; of: the type or shape that goes with it;
    interpreted: what stands for it in Python.
    """

    def __init__(self, kind: str, function: Any, of: Any = None, interpreted: Any = None) -> None:
        self.kind, self.function, self.of, self._python = kind, function, of, interpreted or function
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        return self._python(*arguments)


class Exported(Known):
    """A kernel with a name and a signature: a C function, of the library or compiled now."""

    def __init__(self, function: Any, name: str, signature: Signature) -> None:
        super().__init__("exported", function)
        self.name, self.signature = name, signature

    @cached_property
    def address(self) -> int:
        """Where it begins, for the life of the process."""
        address = library.find(self.name)
        if address is None:
            address = int(library.compiler().compiled_now(self))
        return address

    @cached_property
    def call(self) -> Any:
        """The C function itself, for callers that have the addresses of their arrays."""
        return self.signature.prototype(self.address)

    def __call__(self, *arguments: Any) -> Any:
        words = [
            word for kind, value in zip(self.signature.types, arguments, strict=True) for word in kind.convert(value)
        ]
        returns = self.signature.returns
        if len(returns) == 1:
            answer = _call(self.call, *words)
            return bool(answer) if returns[0] == boolean else answer
        layout = "".join("d" if kind == float64 else "q" for kind in returns)
        answers = ctypes.create_string_buffer(struct.calcsize(layout))
        _call(self.call, *words, ctypes.addressof(answers))
        return struct.unpack(layout, answers.raw)

    def __reduce__(self) -> Any:
        return _import_kernel, (self.function.__module__, self.name)


EXPORTED: dict[str, Exported] = {}
"""Every exported kernel of the modules that are imported, by its name."""


def _import_kernel(module: str, name: str) -> Exported:
    importlib.import_module(module)
    return EXPORTED[name]


class Address(int):
    """The address of a kernel as a number; copied to a different process, the address that this kernel has there."""

    function: Exported

    def __new__(cls, function: Exported) -> Address:
        address = super().__new__(cls, function.address)
        address.function = function
        return address

    def __reduce__(self) -> Any:
        return Address, (self.function,)


def inlined(function: Any, interpreted: Any = None) -> Any:
    """A part of the kernels that call it; interpreted: what stands for it in Python."""
    return _make_known("inlined", function, interpreted=interpreted)


def primitive(function: Any) -> Any:
    """An operation that the compiler knows by the function's name; in Python the function that stands here."""
    return _make_known("primitive", function)


def exported(signature: Signature, name: str | None = None) -> Callable[[Any], Any]:
    """A kernel of a signature, under its own name unless another is given."""

    def decorate(function: Any) -> Any:
        if INTERPRETED:
            return function
        kernel = Exported(function, name or function.__name__, signature)
        if EXPORTED.setdefault(kernel.name, kernel) is not kernel:
            raise ValueError(f"{kernel.name}: two kernels have this name.")
        return kernel

    return decorate


def Caller(signature: Signature) -> Any:
    """A kernel ``call(function, *arguments)`` of a function of a signature: in compiled code an address (`address_of`),
    in Python itself. So members cross in records, ours and users' alike.
    """
    return _make_known("caller", lambda function, *arguments: function(*arguments), signature)


def _make_known(kind: str, function: Any, of: Any = None, interpreted: Any = None) -> Any:
    return (interpreted or function) if INTERPRETED else Known(kind, function, of, interpreted)


def address_of(function: Any) -> Any:
    """Return the address of an exported kernel, 0 for None; in plain Python the kernel itself."""
    if function is None:
        return 0
    return function if INTERPRETED else Address(function)


def direct(kernel: Any, record: Any) -> Any:
    """A kernel that takes a record alone, with one that stays, as a function without arguments."""
    if INTERPRETED:
        return partial(kernel, record)
    resident = Resident(record)
    place = (ctypes.c_int64 * resident.words.size).from_address(resident.words.ctypes.data)
    # a pointer that is one already: ctypes has nothing to convert, which takes longer than some kernels
    run = partial(_call, ctypes.CFUNCTYPE(None)(kernel.address), ctypes.byref(place))
    run.resident = resident  # type: ignore[attr-defined]
    return run


CALLED_BACK = threading.local()
"""Its attribute ``now``: whether this thread is in a user's function that a kernel has called back."""
INTERRUPTS: dict[int, KeyboardInterrupt] = {}
"""Ctrl-C in users' functions that kernels have called back, by thread: it cannot pass through a kernel."""


def _call(function: Any, *words: Any) -> Any:
    """Call a compiled kernel, then raise the Ctrl-C that a user's function has received meanwhile."""
    answer = function(*words)
    if INTERRUPTS and (interrupt := INTERRUPTS.pop(threading.get_ident(), None)):
        raise interrupt
    return answer


@primitive
def fma(a: float, b: float, c: float) -> float:
    """``a*b + c`` with a single rounding (IEEE 754-2008, section 5.4.1).

    In plain Python it is rounded twice, but in a user's function that is called back, whose bits are the compiled ones.
    """
    if getattr(CALLED_BACK, "now", False):
        return float(_import_kernel("adaptrack.core.maths.exact", "soft_fma").call(a, b, c))
    return a * b + c


@primitive
def shaped(values: Any, *sizes: int) -> Any:
    """A contiguous vector as an array of more dimensions; it must hold as many numbers."""
    return values.reshape(sizes)
