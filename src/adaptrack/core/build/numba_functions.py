"""Numba's functions for our kernels: what they are called as, and the C function around each exported one."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from typing import Any
from unittest import mock

import llvmlite.binding as llvm
import numba
from llvmlite import ir
from numba import types
from numba.core import cgutils, codegen
from numba.core.compiler_lock import global_compiler_lock
from numba.core.registry import CPUDispatcher, cpu_target
from numba.extending import intrinsic

from ..member import Member
from . import operations
from .numba_types import WORD, c_types, from_c, numba_type, to_c

_OPTIONS: dict[str, Any] = {
    "nogil": True,
    "error_model": "numpy",
    "_nrt": False,  # nothing can be allocated, and no array is counted in and out of a call
    "no_cpython_wrapper": True,
    "no_cfunc_wrapper": True,
}


_alive: list[Any] = []
"""Numba's types hold their functions weakly, and machine code goes with the library that holds it."""
_environments: dict[str, Any] = {}
"""What functions that raise exceptions of Python's look up, by the name of the variable that is to hold it."""


class _Part(codegen.JITCodeLibrary):  # type: ignore[misc]
    """What one function has become. Numba links and optimises what it calls into it, and so into each that calls it:
    here that is done once, where a C function is made.
    """

    def finalize(self) -> None:
        self.__class__, self._finalized = _Part, True

    def _get_module_for_linking(self) -> Any:
        whole = _whole([self])
        for function in whole.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        return whole


def _whole(parts: Iterable[Any]) -> Any:
    """One module of parts and of all that they call."""
    waiting, linked_in = list(parts), set()
    whole = llvm.parse_assembly("")
    while waiting:
        part = waiting.pop()
        if part not in linked_in:
            linked_in.add(part)
            waiting += part._linking_libraries
            whole.link_in(llvm.parse_assembly(str(part._final_module)))
    return whole


@contextmanager
def _front_end() -> Iterator[None]:
    """Numba types and lowers functions, and nothing more: `linked` puts them together."""
    with (
        global_compiler_lock,
        mock.patch.object(codegen.CPUCodeLibrary, "finalize", _Part.finalize),
        # nothing is optimised for this machine: the sizes of numba's structures are other ones on another
        mock.patch.object(codegen.CPUCodeLibrary, "_optimize_functions"),
        mock.patch.object(codegen.JITCPUCodegen, "set_env", lambda self, name, env: _environments.update({name: env})),
    ):
        yield


def linked(kernels: Iterable[Any]) -> Any:
    """One module of exported kernels and all that they call, not yet optimised: C functions ``adaptrack_NAME``."""
    with _front_end():
        texts = [str(c_module(each, f"adaptrack_{each.name}")) for each in kernels]
        whole = _whole(compiled(each).library for each in kernels)
    for each in texts:
        whole.link_in(llvm.parse_assembly(each))
    return whole


class _Inlined(CPUDispatcher):  # type: ignore[misc]
    def get_call_template(self, args: Any, kws: Any) -> Any:
        # Constants take effect after inlining: the function is compiled once for all of them.
        return super().get_call_template(tuple(types.unliteral(each) for each in args), kws)


def type_of(known: Any) -> Any:
    """Numba's type of what kernels may call."""
    if known.kind == "exported":
        return types.Dispatcher(_dispatcher(known))
    if known.kind == "primitive":
        return _function_type(getattr(operations, known.function.__name__))
    if known.kind == "caller":
        return _of_caller(known.of)
    if known.kind == "view":
        return _function_type(operations.view(numba.from_dtype(known.of.dtype)))
    if known.kind == "local":
        return _function_type(operations.local(known.of))
    made = numba.njit(**_OPTIONS, forceinline=True)(known.function)  # compiled for the types with which it is called
    made.__class__ = _Inlined
    _alive.append(made)
    return types.Dispatcher(made)


def _function_type(made: Any) -> Any:
    cpu_target.typing_context.refresh()  # it may be younger than the last look at what there is
    return cpu_target.typing_context.resolve_value_type(made)


def plain(function: Any) -> Any:
    """A function of somebody else's that members call."""
    return numba.njit(nogil=True, error_model="numpy")(function)


@cache
def _dispatcher(kernel: Any) -> Any:
    """An exported kernel, compiled for its signature and no other; a member for what it takes, whatever it returns."""
    wanted = numba_signature(kernel.signature)
    with _front_end():
        if isinstance(kernel, Member):
            made = plain(_viewing(kernel))
            made.compile(wanted.args)
        else:
            made = numba.njit(**_OPTIONS)(kernel.function)
            made.compile(wanted)
    made.disable_compile()
    return made


def _viewing(kernel: Any) -> Any:
    """A member's function as it is called: with its last array but one as a record, where it wants one."""
    if kernel.viewed is None:
        return kernel.function
    names = [f"a{i}" for i in range(len(kernel.signature.arguments))]
    taken = ", ".join([*names[:-2], f"{names[-2]}.view(kind)[0]", names[-1]])
    scope: dict[str, Any] = {"own": plain(kernel.function), "kind": kernel.viewed}
    exec(f"def call({', '.join(names)}):\n    own({taken})", scope)
    return scope["call"]


def numba_signature(signature: Any) -> Any:
    """A signature in numba's types."""
    kinds = [numba_type(each) for each in signature.returns]
    if len(kinds) == 1:
        returned = kinds[0]
    else:
        returned = types.UniTuple(kinds[0], len(kinds)) if len(set(kinds)) == 1 else types.Tuple(kinds)
    return returned(*(numba_type(each) for each in signature.arguments))


def _c_function_type(signature: Any) -> Any:
    taken = [each for kind in signature.types for each in c_types(kind)]
    if len(signature.returns) > 1:
        return ir.FunctionType(ir.VoidType(), [*taken, WORD.as_pointer()])
    (returned,) = signature.returns
    return ir.FunctionType(ir.VoidType() if returned.name == "void" else c_types(returned)[0], taken)


def _codegen() -> Any:
    return cpu_target.target_context.codegen()


def compiled(kernel: Any) -> Any:
    """What numba has made of an exported kernel."""
    (result,) = _dispatcher(kernel).overloads.values()
    return result


def c_module(kernel: Any, name: str) -> Any:
    """A module of one C function around a compiled kernel. Kernels raise nothing: their status is not looked at."""
    result, signature = compiled(kernel), kernel.signature
    context, wanted = result.target_context, numba_signature(signature)
    module = _codegen().create_library(name).create_ir_module(name)
    function = ir.Function(module, _c_function_type(signature), name)
    builder = ir.IRBuilder(function.append_basic_block())
    given, values = list(function.args), []
    for kind, each in zip(signature.types, wanted.args, strict=True):
        taken, given = given[: len(c_types(kind))], given[len(c_types(kind)) :]
        values.append(from_c(context, builder, kind, each, taken))
    inner = context.declare_function(module, result.fndesc)
    own = result.signature.return_type  # a member's is what its function returns
    status, found = context.call_conv.call_function(builder, inner, own, wanted.args, values)
    if isinstance(kernel, Member):
        found = _answer(context, builder, wanted, own, status, found, values)
    if len(signature.returns) > 1:
        for i in range(len(signature.returns)):
            value = builder.extract_value(found, i)
            builder.store(builder.bitcast(value, WORD), builder.gep(given[0], [ir.Constant(WORD, i)]))
        builder.ret_void()
    elif wanted.return_type == types.void:
        builder.ret_void()
    else:
        builder.ret(builder.zext(found, WORD) if wanted.return_type == types.boolean else found)
    return module


def _answer(context, builder, wanted, own, status, found, values):
    """What a member answers: its number, or 0 for none; after an error NaN, in the array it was to write last too."""
    place = next(i for i in reversed(range(len(values))) if isinstance(wanted.args[i], types.Array))
    last = context.make_array(wanted.args[place])(context, builder, values[place])
    not_a_number = ir.Constant(ir.DoubleType(), float("nan"))
    with builder.if_then(status.is_error, likely=False), cgutils.for_range(builder, last.nitems) as loop:
        builder.store(not_a_number, builder.gep(last.data, [loop.index]))
    if wanted.return_type == types.void:
        return None
    answer = ir.Constant(ir.DoubleType(), 0.0)
    if own != types.none:
        answer = context.cast(builder, found, own, wanted.return_type)
    return builder.select(status.is_error, not_a_number, answer)


def compiled_now(kernel: Any) -> int:
    """The address of the C function of an exported kernel, compiled in this process."""
    name = f"adaptrack_{kernel.name}"
    whole = linked([kernel])
    for each in whole.functions:
        if not each.is_declaration and each.name != name:
            each.linkage = "internal"
    with global_compiler_lock:
        library = _codegen().create_library(f"{name}_{len(_alive)}")
        library.add_llvm_module(whole)
        library.finalize()
        held = {each.name for each in library._final_module.global_variables}
        for environment in held & _environments.keys():
            _codegen().set_env(environment, _environments[environment])
        _alive.append(library)
        return int(library.get_pointer_to_function(name))


def _of_caller(signature: Any) -> Any:
    """Numba's type of a call of a C function by its address."""
    wanted = numba_signature(signature)

    def typed(typingctx, address, *arguments):
        def codegen(context, builder, typed_as, args):
            given = []
            for kind, each, value in zip(signature.types, wanted.args, args[1:], strict=True):
                given += to_c(context, builder, kind, each, value)
            kind = _c_function_type(signature)
            if len(signature.returns) > 1:
                raise NotImplementedError("a member returns one number or none")
            found = builder.call(builder.inttoptr(args[0], kind.as_pointer()), given)
            return context.get_dummy_value() if wanted.return_type == types.void else found

        return wanted.return_type(types.int64, *wanted.args), codegen

    names = ", ".join(["typingctx", "address"] + [f"a{i}" for i in range(len(wanted.args))])
    scope: dict[str, Any] = {"typed": typed}
    exec(f"def call({names}):\n    return typed({names})", scope)  # an intrinsic takes no *arguments
    return _function_type(intrinsic(scope["call"]))
