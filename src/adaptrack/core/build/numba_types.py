"""Numba's types for ours, and how a record that lies in memory is read and written by compiled code."""

from __future__ import annotations

from functools import cache
from itertools import accumulate
from typing import Any

import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, lower_cast, lower_getattr_generic, models, register_model

from ..kernel import Array, Place, Row, Scalar

WORD = ir.IntType(64)


@cache
def numba_type(kind: Any) -> Any:
    """Numba's type for one of ours; a record is handed over whole."""
    if isinstance(kind, Scalar):
        return getattr(types, kind.name)
    if isinstance(kind, Array):
        entry = numba_type(kind.of) if isinstance(kind.of, Scalar) else numba.from_dtype(kind.of.dtype)
        return types.Array(entry, kind.ndim, "C")
    if isinstance(kind, Row):
        return numba.from_dtype(kind.of.dtype)
    if isinstance(kind, Place):
        return Stored(numba_type(kind.of))
    kinds = [numba_type(field_kind) for field_kind in kind.kinds.values()]
    if len(set(kinds)) == 1:
        return types.NamedUniTuple(kinds[0], len(kinds), kind)
    return types.NamedTuple(kinds, kind)


@lower_cast(types.NestedArray, types.Array)
def _array_of_record(context, builder, kind, shape, value):
    """An array that is a field of a row is handed over as any other."""
    return value


class Stored(types.Type):  # type: ignore[misc]
    """A record in memory (`kernel.Resident`): ``record.field`` loads the field, a record within it is stored, too.

    Given to a kernel that takes the record itself, it is loaded whole.
    """

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        super().__init__(f"Stored({kind.instance_class.__module__}.{kind.instance_class.__qualname__})")

    def can_convert_to(self, typingctx: Any, other: Any) -> Any:
        return Conversion.safe if other == self.kind else None


def _is_record(kind: Any) -> bool:
    """Whether a field is a record whose fields are loaded one by one; a few whole numbers are loaded at once."""
    return isinstance(kind, types.BaseNamedTuple) and any(field_type != types.int64 for field_type in kind.types)


def _words(kind: Any) -> int:
    """Words of a value in memory: an array is its place and its sizes."""
    if isinstance(kind, types.BaseTuple):
        return sum(_words(field_type) for field_type in kind.types)
    return 1 + kind.ndim if isinstance(kind, types.Array) else 1


def _begins(kind: Any) -> list[int]:
    """The word at which each entry of a tuple begins."""
    return [0, *accumulate(map(_words, kind.types))][:-1]


@register_model(Stored)
class _StoredModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.IntType(8).as_pointer())


@infer_getattr
class _StoredFields(AttributeTemplate):  # type: ignore[misc]
    key = Stored

    def generic_resolve(self, kind: Any, name: str) -> Any:
        if name not in kind.kind.fields:
            return None
        field = kind.kind.types[kind.kind.fields.index(name)]
        return Stored(field) if _is_record(field) else field


@lower_getattr_generic(Stored)
def _load_field(context, builder, kind, place, name):
    i = kind.kind.fields.index(name)
    field, place = kind.kind.types[i], _word(builder, place, _begins(kind.kind)[i])
    return place if _is_record(field) else load(context, builder, field, place)


@lower_cast(Stored, types.BaseTuple)
def _load_record(context, builder, kind, target, place):
    return load(context, builder, target, place)


def _word(builder, place, word):
    return builder.gep(place, [ir.Constant(WORD, 8 * word)])


def load(context, builder, kind, place):
    """A value of a stored record. It does not change while a kernel runs, and is marked so for the optimiser."""

    def word(i, word_type):
        loaded = builder.load(builder.bitcast(_word(builder, place, i), word_type.as_pointer()))
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    if isinstance(kind, types.BaseTuple):
        parts = [
            load(context, builder, field_type, _word(builder, place, begin))
            for field_type, begin in zip(kind.types, _begins(kind), strict=True)
        ]
        return context.make_tuple(builder, kind, parts)
    if not isinstance(kind, types.Array):
        return word(0, context.get_value_type(kind))
    data = context.get_data_type(kind.dtype).as_pointer()
    return array(context, builder, kind, word(0, data), [word(1 + i, WORD) for i in range(kind.ndim)])


def store(context, builder, kind, value, place):
    """Write a value where `load` reads it."""

    def word(i, word_type):
        builder.store(word_type, builder.bitcast(_word(builder, place, i), word_type.type.as_pointer()))

    if isinstance(kind, types.BaseTuple):
        for i, (field_type, begin) in enumerate(zip(kind.types, _begins(kind), strict=True)):
            store(context, builder, field_type, builder.extract_value(value, i), _word(builder, place, begin))
    elif isinstance(kind, types.Array):
        view = context.make_array(kind)(context, builder, value)
        word(0, view.data)
        for i in range(kind.ndim):
            word(1 + i, builder.extract_value(view.shape, i))
    else:
        word(0, value)


def words_on_stack(context, builder, kind, value):
    """A value in memory of the caller's, as a pointer."""
    place = cgutils.alloca_once(builder, ir.ArrayType(WORD, _words(kind)))
    place = builder.bitcast(place, ir.IntType(8).as_pointer())
    store(context, builder, kind, value, place)
    return place


def array(context, builder, kind, data, sizes):
    """Numba's structure of a C-contiguous array, from its place and its sizes."""
    view = context.make_array(kind)(context, builder)
    bytes_of_one = ir.Constant(WORD, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    strides = [bytes_of_one]
    for size in sizes[:0:-1]:
        strides.insert(0, builder.mul(strides[0], size))
    count = sizes[0]
    for size in sizes[1:]:
        count = builder.mul(count, size)
    view.data, view.itemsize, view.nitems = data, bytes_of_one, count
    view.shape, view.strides = cgutils.pack_array(builder, sizes), cgutils.pack_array(builder, strides)
    return view._getvalue()


# -- C ----------------------------------------------------------------------------------------------------------------
def c_types(kind: Any) -> list[Any]:
    """Return the C types of an argument."""
    if isinstance(kind, Scalar):
        return [ir.DoubleType() if kind.name == "float64" else WORD]
    pointer = ir.IntType(8).as_pointer()
    return [pointer, *[WORD] * kind.ndim] if isinstance(kind, Array) else [pointer]


def from_c(context, builder, kind: Any, numba_kind, words):
    """Numba's value of type `wanted` from what C is given."""
    if isinstance(kind, Scalar):
        return builder.icmp_signed("!=", words[0], ir.Constant(WORD, 0)) if kind.name == "boolean" else words[0]
    if isinstance(kind, Array):
        data = context.get_data_type(numba_kind.dtype).as_pointer()
        return array(context, builder, numba_kind, builder.bitcast(words[0], data), words[1:])
    if isinstance(kind, Row):
        return builder.bitcast(words[0], context.get_value_type(numba_kind))
    return words[0] if isinstance(numba_kind, Stored) else load(context, builder, numba_kind, words[0])


def to_c(context, builder, kind: Any, numba_kind, value):
    """Convert numba's value of type `numba_kind` to C words: the inverse of `from_c`."""
    if isinstance(kind, Scalar):
        return [builder.zext(value, WORD) if kind.name == "boolean" else value]
    pointer = ir.IntType(8).as_pointer()
    if isinstance(kind, Array):
        view = context.make_array(numba_kind)(context, builder, value)
        sizes = [builder.extract_value(view.shape, i) for i in range(kind.ndim)]
        return [builder.bitcast(view.data, pointer), *sizes]
    if isinstance(kind, Row):
        return [builder.bitcast(value, pointer)]
    return [value] if isinstance(numba_kind, Stored) else [words_on_stack(context, builder, numba_kind, value)]
