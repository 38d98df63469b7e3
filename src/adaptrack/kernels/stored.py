"""Records that stay in memory: a kernel is given an address, and loads the fields that it uses.

To hand a kernel a nested record of forty arrays takes longer than a step of the controller, and to compile a kernel
that hands them on from part to part takes half as long again.
"""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AttributeTemplate
from numba.extending import infer_getattr, intrinsic, lower_cast, lower_getattr_generic, models, register_model

from .abi import INTERPRETED


class Resident:
    """A record of arrays, whole numbers and such records, for kernels that take its `address`.

    Where its arrays lie is written down once, in the layout of the compiler's own array structure; `reader` makes it a
    record again. Its arrays must not be replaced, and the address is valid as long as this object lives.
    """

    def __init__(self, record: Any) -> None:
        self.record = record
        if INTERPRETED:
            self.address = record
        else:
            self._words = np.array(_layout(record), np.int64)
            self.address = self._words.ctypes.data


def _layout(value: Any) -> list[int]:
    """The words of a record: whole numbers, and what numba's array structure holds of each array
    (numba.core.datamodel.models.ArrayModel).
    """
    if isinstance(value, tuple):
        return [word for each in value for word in _layout(each)]
    if isinstance(value, int):
        return [value]
    memory_and_owner = [0, 0]  # for counting references, which kernels do not
    return [*memory_and_owner, value.size, value.itemsize, value.ctypes.data, *value.shape, *value.strides]


class Stored(types.Type):  # type: ignore[misc]
    """The compiler's type of a `Resident` record in a kernel, which knows its place alone.

    kind: the `types.NamedTuple` of the record, made of arrays, whole numbers and such records. ``record.field`` loads
    the field; a record within it is stored, too. Given to a routine that takes the record itself, it is loaded whole.
    """

    def __init__(self, kind: Any) -> None:
        self.kind = kind
        super().__init__(f"Stored({kind.instance_class.__module__}.{kind.instance_class.__qualname__})")

    def place(self, name: str) -> tuple[Any, int]:
        """The type of a field and the word at which it begins."""
        i = self.kind.fields.index(name)
        return self.kind.types[i], _begins(self.kind)[i]

    def can_convert_to(self, typingctx: Any, other: Any) -> Any:
        return Conversion.safe if other == self.kind else None


def _words(kind: Any) -> int:
    """Words of a type in `_layout`."""
    if isinstance(kind, types.BaseTuple):
        return sum(_words(each) for each in kind.types)
    if isinstance(kind, types.Array):
        return 5 + 2 * kind.ndim
    if kind == types.int64:
        return 1
    raise TypeError(f"{kind}: a stored record is made of arrays, whole numbers and such records.")


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
        field, _ = kind.place(name)
        return Stored(field) if _is_record(field) else field


def _is_record(kind: Any) -> bool:
    """Whether a field is a record whose fields are loaded one by one; a few whole numbers are loaded at once."""
    return isinstance(kind, types.BaseNamedTuple) and any(each != types.int64 for each in kind.types)


@lower_getattr_generic(Stored)
def _load_field(context, builder, kind, place, name):
    field, word = kind.place(name)
    place = _word(builder, place, word)
    return place if _is_record(field) else _load(context, builder, field, place)


@lower_cast(Stored, types.BaseTuple)
def _load_record(context, builder, kind, wanted, place):
    return _load(context, builder, wanted, place)


def _word(builder, place, word):
    return builder.gep(place, [ir.Constant(ir.IntType(64), 8 * word)])


def _load(context, builder, kind, place):
    """A value of a stored record. Nothing changes there while a kernel runs, which the optimiser is told."""

    def load(word, what):
        loaded = builder.load(builder.bitcast(_word(builder, place, word), what.as_pointer()))
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
        return loaded

    if isinstance(kind, types.BaseTuple):
        parts = [
            _load(context, builder, each, _word(builder, place, word))
            for each, word in zip(kind.types, _begins(kind), strict=True)
        ]
        return context.make_tuple(builder, kind, parts)
    if not isinstance(kind, types.Array):
        return load(0, context.get_value_type(kind))
    array, word = context.make_array(kind)(context, builder), ir.IntType(64)
    array.nitems, array.data = load(2, word), load(4, context.get_data_type(kind.dtype).as_pointer())
    array.itemsize = ir.Constant(word, context.get_abi_sizeof(context.get_data_type(kind.dtype)))
    array.shape = cgutils.pack_array(builder, [load(5 + i, word) for i in range(kind.ndim)])
    array.strides = cgutils.pack_array(builder, [load(5 + kind.ndim + i, word) for i in range(kind.ndim)])
    return array._getvalue()


def reader(kind: Any) -> Any:
    """A kernel ``read(address)`` that gives the `Resident` record of a type."""
    if INTERPRETED:
        return lambda address: address

    @intrinsic
    def read(typingctx, address):
        def codegen(context, builder, signature, args):
            return builder.inttoptr(args[0], ir.IntType(8).as_pointer())

        return Stored(kind)(types.int64), codegen

    return read
