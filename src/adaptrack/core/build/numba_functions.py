"""Numba's functions for our kernels: what they are called as, and the C function around each exported one."""

from __future__ import annotations

import inspect
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

from ..kernel import EXPORTED, SYMBOL
from ..member import UserFunction
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
_kernels: dict[Any, Any] = {}
"""The exported kernel of a library of numba's that defines one."""
_lowering_kernels = False
"""Whether numba is lowering kernels for `module_of`, which links them itself."""
_environments: dict[str, Any] = {}
"""What functions that raise exceptions of Python's look up, by the name of the variable that is to hold it."""


class _Part(codegen.JITCodeLibrary):  # type: ignore[misc]
    """The compiled form of one function, kept apart so that Numba does not link it into each of its callers."""

    def finalize(self) -> None:
        self.__class__, self._finalized = _Part, True

    def _get_module_for_linking(self) -> Any:
        module = _with_callees(_linked([self]))
        for function in module.functions:
            if not function.is_declaration:
                function.linkage = "linkonce_odr"
        return module


def _linked(parts: Iterable[Any]) -> Any:
    """Return one module of numba's libraries and of the inlined kernels that they call."""
    module = llvm.parse_assembly("")
    waiting, linked = list(parts), set()
    while waiting:
        part = waiting.pop()
        if part not in linked:
            linked.add(part)
            waiting += part._linking_libraries
            module.link_in(_parsed(part._final_module, _kernels.get(part)))
    return module


def _parsed(module: Any, kernel: Any) -> Any:
    """Parse a module; an exported kernel of the package that it defines or calls gets its symbol."""
    parsed = llvm.parse_assembly(str(module))
    if kernel is not None and not isinstance(kernel, UserFunction):
        parsed.get_function(compiled(kernel).fndesc.mangled_name).name = SYMBOL + kernel.name
    return parsed


def _with_callees(module: Any) -> Any:
    """Add to a module the exported kernels that it calls, and of those that these call."""
    while called := [EXPORTED[name] for name in _declared_kernels(module) if name in EXPORTED]:
        callees = _linked(compiled(kernel).library for kernel in called)
        _make_internal(callees, SYMBOL)  # they may hold the same inlined kernels as the module
        module.link_in(callees)
    return module


def _make_internal(module: Any, *beginnings: str) -> None:
    """Make the functions of a module internal, except those whose names have one of these beginnings."""
    for function in module.functions:
        if not (function.is_declaration or function.name.startswith(beginnings)):
            function.linkage = "internal"


def _declared_kernels(module: Any) -> list[str]:
    declared = [function.name for function in module.functions if function.is_declaration]
    return [name.removeprefix(SYMBOL) for name in declared if name.startswith(SYMBOL)]


@contextmanager
def _front_end() -> Iterator[None]:
    """Let numba type and lower functions, and nothing more: `module_of` links them."""
    with (
        global_compiler_lock,
        mock.patch.object(codegen.CPUCodeLibrary, "finalize", _Part.finalize),
        # nothing is optimised for this machine: the sizes of numba's structures are other ones on another
        mock.patch.object(codegen.CPUCodeLibrary, "_optimize_functions"),
        mock.patch(f"{__name__}._lowering_kernels", True),
        mock.patch.object(codegen.JITCPUCodegen, "set_env", lambda self, name, env: _environments.update({name: env})),
    ):
        yield


def module_of(kernels: Iterable[Any]) -> Any:
    """Return one LLVM module of exported kernels with their C functions ``adaptrack_NAME``, not yet optimised.

    It holds the inlined kernels that they call. Other exported kernels are declared as ``kernel.NAME``: the module that
    has one defines it under this name. All other functions are internal.
    """
    kernels = list(kernels)
    c_functions = llvm.parse_assembly("")  # joined among themselves first: to link takes what the target holds
    with _front_end():
        for kernel in kernels:
            c_functions.link_in(_parsed(c_module(kernel, f"adaptrack_{kernel.name}"), kernel))
        module = _linked(compiled(kernel).library for kernel in kernels)
    module.link_in(c_functions)
    _make_internal(module, SYMBOL, "adaptrack_")
    return module


class _Inlined(CPUDispatcher):  # type: ignore[misc]
    def get_call_template(self, args: Any, kws: Any) -> Any:
        # Constants take effect after inlining: the function is compiled once for all of them.
        return super().get_call_template(tuple(types.unliteral(argument) for argument in args), kws)


def type_of(callee: Any) -> Any:
    """Numba's type of what kernels may call."""
    if callee.kind == "exported":
        return types.Dispatcher(_dispatcher(callee)) if isinstance(callee, UserFunction) else _type_of_exported(callee)
    if callee.kind == "primitive":
        return _function_type(getattr(operations, callee.function.__name__))
    if callee.kind == "caller":
        return _caller_type(callee.of)
    if callee.kind == "view":
        return _function_type(operations.view(numba.from_dtype(callee.of.dtype)))
    if callee.kind == "local":
        return _function_type(operations.local(callee.of))
    dispatcher = numba.njit(**_OPTIONS, forceinline=True)(
        callee.function
    )  # compiled for the types with which it is called
    dispatcher.__class__ = _Inlined
    _alive.append(dispatcher)
    return types.Dispatcher(dispatcher)


def _function_type(dispatcher: Any) -> Any:
    cpu_target.typing_context.refresh()  # it may be younger than the last look at what there is
    return cpu_target.typing_context.resolve_value_type(dispatcher)


def plain(function: Any) -> Any:
    """A function of somebody else's that members call."""
    return numba.njit(nogil=True, error_model="numpy")(function)


@cache
def _dispatcher(kernel: Any) -> Any:
    """An exported kernel, compiled for its signature and no other; a member for what it takes, whatever it returns."""
    signature = numba_signature(kernel.signature)
    with _front_end():
        if isinstance(kernel, UserFunction):
            dispatcher = plain(_viewing(kernel))
            dispatcher.compile(signature.args)
        else:
            dispatcher = numba.njit(**_OPTIONS)(kernel.function)
            dispatcher.compile(signature)
    dispatcher.disable_compile()
    (result,) = dispatcher.overloads.values()
    _kernels[result.library] = kernel
    return dispatcher


def _viewing(kernel: Any) -> Any:
    """A member's function as it is called: with its last array but one as a record, where it wants one."""
    if kernel.viewed is None:
        return kernel.function
    names = [f"a{i}" for i in range(len(kernel.signature.arguments))]
    parameters = ", ".join([*names[:-2], f"{names[-2]}.view(kind)[0]", names[-1]])
    scope: dict[str, Any] = {"own": plain(kernel.function), "kind": kernel.viewed}
    exec(f"def call({', '.join(names)}):\n    own({parameters})", scope)
    return scope["call"]


def numba_signature(signature: Any) -> Any:
    """A signature in numba's types."""
    kinds = [numba_type(kind) for kind in signature.returns]
    if len(kinds) == 1:
        returned = kinds[0]
    else:
        returned = types.UniTuple(kinds[0], len(kinds)) if len(set(kinds)) == 1 else types.Tuple(kinds)
    return returned(*(numba_type(kind) for kind in signature.arguments))


def _c_function_type(signature: Any) -> Any:
    parameter_types = [c_type for kind in signature.types for c_type in c_types(kind)]
    if len(signature.returns) > 1:
        return ir.FunctionType(ir.VoidType(), [*parameter_types, WORD.as_pointer()])
    (returned,) = signature.returns
    return ir.FunctionType(ir.VoidType() if returned.name == "void" else c_types(returned)[0], parameter_types)


def _codegen() -> Any:
    return cpu_target.target_context.codegen()


def compiled(kernel: Any) -> Any:
    """Numba's compilation result of an exported kernel."""
    (result,) = _dispatcher(kernel).overloads.values()
    return result


def c_module(kernel: Any, name: str) -> Any:
    """A module of one C function around a compiled kernel. Kernels raise nothing: their status is not looked at."""
    result, signature = compiled(kernel), kernel.signature
    context, numba_types = result.target_context, numba_signature(signature)
    module = _codegen().create_library(name).create_ir_module(name)
    function = ir.Function(module, _c_function_type(signature), name)
    builder = ir.IRBuilder(function.append_basic_block())
    pending, values = list(function.args), []
    for kind, numba_kind in zip(signature.types, numba_types.args, strict=True):
        words, pending = pending[: len(c_types(kind))], pending[len(c_types(kind)) :]
        values.append(from_c(context, builder, kind, numba_kind, words))
    inner = context.declare_function(module, result.fndesc)
    return_type = result.signature.return_type  # a member's is what its function returns
    status, returned = context.call_conv.call_function(builder, inner, return_type, numba_types.args, values)
    if isinstance(kernel, UserFunction):
        returned = _answer(context, builder, numba_types, return_type, status, returned, values)
    if len(signature.returns) > 1:
        for i in range(len(signature.returns)):
            value = builder.extract_value(returned, i)
            builder.store(builder.bitcast(value, WORD), builder.gep(pending[0], [ir.Constant(WORD, i)]))
        builder.ret_void()
    elif numba_types.return_type == types.void:
        builder.ret_void()
    else:
        builder.ret(builder.zext(returned, WORD) if numba_types.return_type == types.boolean else returned)
    return module


def _answer(context, builder, signature, return_type, status, returned, values):
    """Emit the result of a member: its number, 0 for none; after an error NaN, also in its output array."""
    place = next(i for i in reversed(range(len(values))) if isinstance(signature.args[i], types.Array))
    last = context.make_array(signature.args[place])(context, builder, values[place])
    not_a_number = ir.Constant(ir.DoubleType(), float("nan"))
    with builder.if_then(status.is_error, likely=False), cgutils.for_range(builder, last.nitems) as loop:
        builder.store(not_a_number, builder.gep(last.data, [loop.index]))
    if signature.return_type == types.void:
        return None
    answer = ir.Constant(ir.DoubleType(), 0.0)
    if return_type != types.none:
        answer = context.cast(builder, returned, return_type, signature.return_type)
    return builder.select(status.is_error, not_a_number, answer)


def compiled_now(kernel: Any) -> int:
    """Compile an exported kernel, and those that it calls, in this process; return the address of its C function."""
    name = f"adaptrack_{kernel.name}"
    module = _with_callees(module_of([kernel]))
    _make_internal(module, name)
    with global_compiler_lock:
        library = _codegen().create_library(f"{name}_{len(_alive)}")
        library.add_llvm_module(module)
        library.finalize()
        defined = {variable.name for variable in library._final_module.global_variables}
        for environment in defined & _environments.keys():
            _codegen().set_env(environment, _environments[environment])
        _alive.append(library)
        return int(library.get_pointer_to_function(name))


def _type_of_exported(kernel: Any) -> Any:
    """Return numba's type of a call of an exported kernel by its symbol: it need not be compiled for that."""
    signature = numba_signature(kernel.signature)

    def typed(typingctx, *arguments):
        def codegen(context, builder, typed_as, values):
            convention = context.call_conv
            kind = convention.get_function_type(signature.return_type, signature.args)
            function = cgutils.get_or_insert_function(builder.module, kind, SYMBOL + kernel.name)
            status, result = convention.call_function(builder, function, signature.return_type, signature.args, values)
            if not _lowering_kernels:  # a user's function, which numba links by itself
                context.active_code_library.add_linking_library(compiled(kernel).library)
            with cgutils.if_unlikely(builder, status.is_error):
                convention.return_status_propagate(builder, status)
            return result

        return signature, codegen

    return _function_type(_intrinsic(typed, list(inspect.signature(kernel.function).parameters)))


def _intrinsic(typed: Any, names: list[str]) -> Any:
    """Make an intrinsic of a function ``typed(typing_context, *arguments)``: numba's take no ``*arguments``."""
    scope: dict[str, Any] = {"typed": typed}
    arguments = ", ".join(["typingctx", *names])
    exec(f"def call({arguments}):\n    return typed({arguments})", scope)
    return intrinsic(scope["call"])


def _caller_type(signature: Any) -> Any:
    """Numba's type of a call of a C function by its address."""
    caller_signature = numba_signature(signature)

    def typed(typingctx, address, *arguments):
        def codegen(context, builder, typed_as, args):
            arguments = []
            for kind, numba_kind, value in zip(signature.types, caller_signature.args, args[1:], strict=True):
                arguments += to_c(context, builder, kind, numba_kind, value)
            kind = _c_function_type(signature)
            if len(signature.returns) > 1:
                raise NotImplementedError("a member returns one number or none")
            returned = builder.call(builder.inttoptr(args[0], kind.as_pointer()), arguments)
            return context.get_dummy_value() if caller_signature.return_type == types.void else returned

        return caller_signature.return_type(types.int64, *caller_signature.args), codegen

    return _function_type(_intrinsic(typed, ["address", *(f"a{i}" for i in range(len(caller_signature.args)))]))
