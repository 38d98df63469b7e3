"""What a kernel's primitives are for the compiler: `kernel.fma`, and those of `maths`, under their names."""

from __future__ import annotations

import math
import operator
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core import errors as _numba_errors
from numba.core.typing.templates import AbstractTemplate, infer_global
from numba.extending import intrinsic, lower_builtin, models, register_model

from ..maths.bits import ABOVE_ONE, LARGEST_USUAL, LEAST_USUAL
from ..maths.vectors import VECTOR_WIDTH
from .numba_types import array


@intrinsic
def fma(typingctx, a, b, c):
    """``a*b + c`` with a single rounding (IEEE 754-2008, section 5.4.1)."""

    def codegen(context, builder, signature, args):
        return builder.fma(*args)

    return types.float64(types.float64, types.float64, types.float64), codegen


def _instruction(name: str) -> Any:
    """An operation of LLVM's on one float, never a call of C's function of that name."""

    @intrinsic
    def operation(typingctx, x):
        def codegen(context, builder, signature, args):
            return builder.call(builder.module.declare_intrinsic(f"llvm.{name}", [ir.DoubleType()]), args)

        return types.float64(types.float64), codegen

    return operation


sqrt = _instruction("sqrt")
floor = _instruction("floor")
ceil = _instruction("ceil")


@intrinsic
def bits_of(typingctx, x):
    """The bits of a float."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.IntType(64))

    return types.int64(types.float64), codegen


@intrinsic
def float_of(typingctx, bits):
    """The float of these 64 bits."""

    def codegen(context, builder, signature, args):
        return builder.bitcast(args[0], ir.DoubleType())

    return types.float64(types.int64), codegen


@intrinsic
def shaped(typingctx, values, *sizes):
    """A contiguous vector as an array of more dimensions."""
    sizes = sizes[0] if len(sizes) == 1 and isinstance(sizes[0], types.BaseTuple) else sizes
    array_type = types.Array(values.dtype, len(sizes), "C")
    signature = array_type(values, types.StarArgTuple.from_types([types.int64] * len(sizes)))

    def codegen(context, builder, signature, args):
        data = context.make_array(signature.args[0])(context, builder, args[0]).data
        return array(context, builder, array_type, data, cgutils.unpack_tuple(builder, args[1], len(sizes)))

    return signature, codegen


def view(record: Any) -> Any:
    """An operation: the record of numbers that lies in a vector from a place on."""

    @intrinsic
    def operation(typingctx, vector, place):
        def codegen(context, builder, signature, args):
            data = context.make_array(signature.args[0])(context, builder, args[0]).data
            return builder.bitcast(builder.gep(data, [args[1]]), context.get_value_type(record))

        return record(vector, types.int64), codegen

    return operation


def local(shape: tuple[int, ...]) -> Any:
    """An operation: an array of zeros on the stack. It is written in pieces: a larger one would be a call of C's."""
    array_type, count = types.Array(types.float64, len(shape), "C"), math.prod(shape)

    @intrinsic
    def operation(typingctx):
        def codegen(context, builder, signature, args):
            place = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), count))
            place.align = 64
            first = builder.bitcast(place, ir.DoubleType().as_pointer())
            at = 0
            while at < count:
                piece = _VECTOR if at + VECTOR_WIDTH <= count else ir.DoubleType()
                where = builder.gep(first, [ir.Constant(ir.IntType(64), at)])
                builder.store(ir.Constant(piece, None), builder.bitcast(where, piece.as_pointer()), align=8)
                at += VECTOR_WIDTH if piece is _VECTOR else 1
            return array(context, builder, array_type, first, [ir.Constant(ir.IntType(64), size) for size in shape])

        return array_type(), codegen

    return operation


_VECTOR = ir.VectorType(ir.DoubleType(), VECTOR_WIDTH)
_I32 = ir.IntType(32)


class Vector(types.Type):  # type: ignore[misc]
    """Numba's name for eight float64 values in one register."""

    def __init__(self) -> None:
        super().__init__(name="Vector8")


vector8 = Vector()


@register_model(Vector)
class _VectorModel(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, _VECTOR)


def _pointer(context: Any, builder: Any, array_type: Any, array: Any, indices: Any) -> Any:
    struct = context.make_array(array_type)(context, builder, array)
    where = cgutils.get_item_pointer(context, builder, array_type, struct, indices, wraparound=False)
    return builder.bitcast(where, _VECTOR.as_pointer())


def _check(array: Any, indices: Any) -> None:
    if not isinstance(array, types.Array) or array.ndim != len(indices) or array.layout != "C":
        raise _numba_errors.TypingError("one index per dimension of a C-contiguous float64 array")


@intrinsic
def load(typingctx, array, *index):
    """``array[..., i, j:j+8]``."""
    index = index[0] if len(index) == 1 and isinstance(index[0], types.BaseTuple) else index
    _check(array, index)
    signature = vector8(array, types.StarArgTuple.from_types(index))

    def codegen(context, builder, signature, args):
        indices = cgutils.unpack_tuple(builder, args[1], len(index))
        return builder.load(_pointer(context, builder, signature.args[0], args[0], indices), align=8)

    return signature, codegen


@intrinsic
def store(typingctx, array, *index_and_value):
    """``array[..., i, j:j+8] = value``."""
    arguments = index_and_value
    arguments = arguments[0] if len(arguments) == 1 and isinstance(arguments[0], types.BaseTuple) else arguments
    _check(array, arguments[:-1])
    signature = types.void(array, types.StarArgTuple.from_types(arguments))

    def codegen(context, builder, signature, args):
        *indices, value = cgutils.unpack_tuple(builder, args[1], len(arguments))
        builder.store(value, _pointer(context, builder, signature.args[0], args[0], indices), align=8)
        return context.get_dummy_value()

    return signature, codegen


def _splat(builder: Any, value: Any) -> Any:
    vector = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), value, _I32(0))
    mask = ir.Constant(ir.VectorType(_I32, VECTOR_WIDTH), [0] * VECTOR_WIDTH)
    return builder.shuffle_vector(vector, ir.Constant(_VECTOR, ir.Undefined), mask)


@intrinsic
def spread(typingctx, array, *index):
    """The number ``array[..., i, j]`` in every entry (indices are not negative)."""
    index = index[0] if len(index) == 1 and isinstance(index[0], types.BaseTuple) else index
    _check(array, index)
    signature = vector8(array, types.StarArgTuple.from_types(index))

    def codegen(context, builder, signature, args):
        struct = context.make_array(signature.args[0])(context, builder, args[0])
        indices = cgutils.unpack_tuple(builder, args[1], len(index))
        where = cgutils.get_item_pointer(context, builder, signature.args[0], struct, indices, wraparound=False)
        return _splat(builder, builder.load(where))

    return signature, codegen


@intrinsic
def splat(typingctx, value):
    """Fill a vector with one number."""

    def codegen(context, builder, signature, args):
        return _splat(builder, args[0])

    return vector8(types.float64), codegen


@intrinsic
def zeros(typingctx):
    """Zero in every entry."""

    def codegen(context, builder, signature, args):
        return ir.Constant(_VECTOR, [0.0] * VECTOR_WIDTH)

    return vector8(), codegen


def _binary(name: str) -> Any:
    @intrinsic
    def operation(typingctx, a, b):
        def codegen(context, builder, signature, args):
            return getattr(builder, name)(args[0], args[1])

        return vector8(vector8, vector8), codegen

    return operation


add = _binary("fadd")
sub = _binary("fsub")
mul = _binary("fmul")
div = _binary("fdiv")


def _operator(operator_function: Any, name: str) -> None:
    """Let an operator of Python's take eight numbers at once."""

    @infer_global(operator_function)
    class _Typed(AbstractTemplate):  # type: ignore[misc]
        def generic(self, args: Any, kws: Any) -> Any:
            return vector8(vector8, vector8) if args == (vector8, vector8) else None

    @lower_builtin(operator_function, Vector, Vector)
    def _lowered(context, builder, signature, args):
        return getattr(builder, name)(*args)


_operator(operator.add, "fadd")
_operator(operator.sub, "fsub")
_operator(operator.mul, "fmul")


def _filled(like: Any, value: Any) -> Any:
    """A constant of this LLVM type, in every entry if it has several."""
    return ir.Constant(like, [value] * VECTOR_WIDTH if isinstance(like, ir.VectorType) else value)


def _integers(builder: Any, value: Any) -> Any:
    several = isinstance(value.type, ir.VectorType)
    return builder.bitcast(value, ir.VectorType(ir.IntType(64), VECTOR_WIDTH) if several else ir.IntType(64))


def _absolute(builder: Any, value: Any) -> Any:
    word = _integers(builder, value)
    return builder.bitcast(builder.and_(word, _filled(word.type, 2**63 - 1)), value.type)


@intrinsic
def upper_half(typingctx, x):
    """x rounded to 26 bits."""

    def codegen(context, builder, signature, args):
        word = _integers(builder, args[0])
        rounded = builder.add(word, _filled(word.type, 2**26))
        return builder.bitcast(builder.and_(rounded, _filled(word.type, -(2**27))), args[0].type)

    return x(x), codegen


@intrinsic
def to_odd(typingctx, x, remainder):
    """x + rest rounded to odd, where x is the sum rounded and `rest` what that dropped."""

    def codegen(context, builder, signature, args):
        number, dropped = (_integers(builder, argument) for argument in args)
        unit = _filled(number.type, 1)
        step = builder.or_(builder.ashr(builder.xor(number, dropped), _filled(number.type, 63)), unit)
        even = builder.sub(builder.and_(number, unit), unit)  # all bits set
        inexact = builder.sext(builder.fcmp_ordered("!=", args[1], _filled(args[1].type, 0.0)), number.type)
        moved = builder.add(number, builder.and_(step, builder.and_(even, inexact)))
        return builder.bitcast(moved, args[0].type)

    return x(x, x), codegen


@intrinsic
def usual_sum(typingctx, a, b, c, y, beyond):
    """Whether `soft_fma` may take its short way."""

    def codegen(context, builder, signature, args):
        a, b, c, y, beyond = args
        zero = _filled(a.type, 0.0)
        total = builder.fadd(builder.fadd(_absolute(builder, a), _absolute(builder, b)), _absolute(builder, c))
        small = builder.fcmp_ordered("<", total, _filled(a.type, LARGEST_USUAL))
        nothing = builder.or_(builder.fcmp_ordered("==", a, zero), builder.fcmp_ordered("==", b, zero))
        product = _absolute(builder, builder.fmul(a, b))
        large = builder.fcmp_ordered(">=", product, _filled(a.type, LEAST_USUAL))
        is_usual = builder.and_(small, builder.or_(large, nothing))
        further = builder.fadd(y, builder.fmul(beyond, _filled(a.type, ABOVE_ONE)))
        is_usual = builder.and_(is_usual, builder.fcmp_ordered("==", further, y))
        if not isinstance(a.type, ir.VectorType):
            return is_usual
        extended = builder.sext(is_usual, ir.VectorType(ir.IntType(64), VECTOR_WIDTH))
        name = f"llvm.vector.reduce.and.v{VECTOR_WIDTH}i64"
        declared = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.IntType(64), [extended.type]), name
        )
        return builder.icmp_signed("!=", builder.call(declared, [extended]), ir.Constant(ir.IntType(64), 0))

    return types.boolean(a, b, c, y, beyond), codegen


@intrinsic
def fma8(typingctx, a, b, c):
    """``a*b + c`` with one rounding, entry by entry."""

    def codegen(context, builder, signature, args):
        function = ir.FunctionType(_VECTOR, [_VECTOR] * 3)
        declared = cgutils.get_or_insert_function(builder.module, function, f"llvm.fma.v{VECTOR_WIDTH}f64")
        return builder.call(declared, args)

    return vector8(vector8, vector8, vector8), codegen


@intrinsic
def larger(typingctx, a, b):
    """``a if a > b else b``, entry by entry: a NaN in ``a`` is passed over."""

    def codegen(context, builder, signature, args):
        return builder.select(builder.fcmp_ordered(">", args[0], args[1]), args[0], args[1])

    return vector8(vector8, vector8), codegen


@intrinsic
def lesser(typingctx, a, b):
    """``a if a < b else b``, entry by entry: a NaN in ``a`` is passed over."""

    def codegen(context, builder, signature, args):
        return builder.select(builder.fcmp_ordered("<", args[0], args[1]), args[0], args[1])

    return vector8(vector8, vector8), codegen


@intrinsic
def where_positive(typingctx, a, b, c):
    """``b if a > 0 else c``, entry by entry."""

    def codegen(context, builder, signature, args):
        zero = ir.Constant(_VECTOR, [0.0] * VECTOR_WIDTH)
        return builder.select(builder.fcmp_ordered(">", args[0], zero), args[1], args[2])

    return vector8(vector8, vector8, vector8), codegen


@intrinsic
def column(typingctx, array, count, first, j):
    """``array[first:first+8, j]``, with zero for the rows from ``count`` on; needs ``first < count``."""
    _check(array, (first, j))
    signature = vector8(array, types.int64, types.int64, types.int64)

    def codegen(context, builder, signature, args):
        array_type = signature.args[0]
        struct = context.make_array(array_type)(context, builder, args[0])
        last = builder.sub(args[1], ir.Constant(ir.IntType(64), 1))
        value = ir.Constant(_VECTOR, ir.Undefined)
        for i in range(VECTOR_WIDTH):
            row = builder.add(args[2], ir.Constant(ir.IntType(64), i))
            row = builder.select(builder.icmp_signed("<", row, last), row, last)
            where = cgutils.get_item_pointer(context, builder, array_type, struct, [row, args[3]], wraparound=False)
            value = builder.insert_element(value, builder.load(where), _I32(i))
        mask = _mask(builder, "<", builder.sub(args[1], args[2]))
        return builder.select(mask, value, ir.Constant(_VECTOR, [0.0] * VECTOR_WIDTH))

    return signature, codegen


@intrinsic
def totals(typingctx, rows):
    """The eight sums of the entries of eight values, as one value: neighbours first, then pairs, then fours."""

    def codegen(context, builder, signature, args):
        def merge(x, y, low, high):
            kind = ir.VectorType(_I32, VECTOR_WIDTH)
            return builder.fadd(
                builder.shuffle_vector(x, y, ir.Constant(kind, low)),
                builder.shuffle_vector(x, y, ir.Constant(kind, high)),
            )

        rows = cgutils.unpack_tuple(builder, args[0], VECTOR_WIDTH)
        # pairs[i] holds, for rows 2i and 2i+1, the sums of entries (01, 23, 45, 67), alternating between the rows
        low, high = [0, 8, 2, 10, 4, 12, 6, 14], [1, 9, 3, 11, 5, 13, 7, 15]
        pairs = [merge(rows[i], rows[i + 1], low, high) for i in (0, 2, 4, 6)]
        low, high = [0, 1, 8, 9, 4, 5, 12, 13], [2, 3, 10, 11, 6, 7, 14, 15]
        fours = [merge(pairs[i], pairs[i + 1], low, high) for i in (0, 2)]
        low, high = [0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]
        return merge(fours[0], fours[1], low, high)

    return vector8(types.UniTuple(vector8, VECTOR_WIDTH)), codegen


def _fold(builder: Any, value: Any, combine: Any) -> Any:
    """Halve three times: entries (0+4, 1+5, 2+6, 3+7), then (0+2, 1+3), then (0+1)."""
    width = VECTOR_WIDTH
    while width > 1:
        width //= 2
        low = ir.Constant(ir.VectorType(_I32, width), list(range(width)))
        high = ir.Constant(ir.VectorType(_I32, width), list(range(width, 2 * width)))
        undefined = ir.Constant(value.type, ir.Undefined)
        value = combine(builder.shuffle_vector(value, undefined, low), builder.shuffle_vector(value, undefined, high))
    return builder.extract_element(value, _I32(0))


@intrinsic
def total(typingctx, a):
    """The sum of the entries, always in the same order."""

    def codegen(context, builder, signature, args):
        return _fold(builder, args[0], builder.fadd)

    return types.float64(vector8), codegen


@intrinsic
def largest(typingctx, a):
    """The largest entry."""

    def codegen(context, builder, signature, args):
        def combine(x, y):
            return builder.select(builder.fcmp_ordered(">", x, y), x, y)

        return _fold(builder, args[0], combine)

    return types.float64(vector8), codegen


@intrinsic
def smallest(typingctx, a):
    """The smallest entry."""

    def codegen(context, builder, signature, args):
        def combine(x, y):
            return builder.select(builder.fcmp_ordered("<", x, y), x, y)

        return _fold(builder, args[0], combine)

    return types.float64(vector8), codegen


@intrinsic
def all_below_infinity(typingctx, a):
    """Whether no entry is NaN or +inf."""

    def codegen(context, builder, signature, args):
        infinity = ir.Constant(_VECTOR, [float("inf")] * VECTOR_WIDTH)
        bits = builder.bitcast(builder.fcmp_ordered("<", args[0], infinity), ir.IntType(VECTOR_WIDTH))
        return builder.icmp_unsigned("==", bits, ir.Constant(ir.IntType(VECTOR_WIDTH), 2**VECTOR_WIDTH - 1))

    return types.boolean(vector8), codegen


def _mask(builder: Any, compare: str, count: Any) -> Any:
    vector_type = ir.VectorType(ir.IntType(64), VECTOR_WIDTH)
    undefined = ir.Constant(vector_type, ir.Undefined)
    mask = ir.Constant(ir.VectorType(_I32, VECTOR_WIDTH), [0] * VECTOR_WIDTH)
    counts = builder.shuffle_vector(builder.insert_element(undefined, count, _I32(0)), undefined, mask)
    return builder.icmp_signed(compare, ir.Constant(vector_type, list(range(VECTOR_WIDTH))), counts)


@intrinsic
def with_entry(typingctx, a, i, value):
    """``a`` with ``value`` as entry ``i``; ``a`` itself when there is no such entry."""

    def codegen(context, builder, signature, args):
        return builder.select(_mask(builder, "==", args[1]), _splat(builder, args[2]), args[0])

    return vector8(vector8, types.int64, types.float64), codegen


@intrinsic
def keep_first(typingctx, a, count):
    """The first ``count`` entries of ``a`` (any integer), zero in the others."""

    def codegen(context, builder, signature, args):
        return builder.select(_mask(builder, "<", args[1]), args[0], ir.Constant(_VECTOR, [0.0] * VECTOR_WIDTH))

    return vector8(vector8, types.int64), codegen


@intrinsic
def keep_last(typingctx, a, start):
    """The entries of ``a`` from ``start`` on (any integer), zero before."""

    def codegen(context, builder, signature, args):
        return builder.select(_mask(builder, ">=", args[1]), args[0], ir.Constant(_VECTOR, [0.0] * VECTOR_WIDTH))

    return vector8(vector8, types.int64), codegen


@intrinsic
def first_equal(typingctx, a, value):
    """The first entry that equals ``value``; `VECTOR_WIDTH` when none does."""

    def codegen(context, builder, signature, args):
        bits = builder.bitcast(builder.fcmp_ordered("==", args[0], _splat(builder, args[1])), ir.IntType(VECTOR_WIDTH))
        word = builder.or_(builder.zext(bits, ir.IntType(64)), ir.Constant(ir.IntType(64), 1 << VECTOR_WIDTH))
        return builder.cttz(word, ir.Constant(ir.IntType(1), 1))

    return types.int64(vector8, types.float64), codegen
