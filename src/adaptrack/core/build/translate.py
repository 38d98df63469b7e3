"""Kernels to C: one rule for each kind of node, types by inference.

A function is translated once for each combination of the types of its arguments (`Instance`). Types follow from the
signature of an exported kernel and from the fields of records; a variable has the type of what is assigned to it. What
is known when the kernel is translated (modules, functions, tuples, numbers of the file) is a `StaticValue`.

The subset is described in docs/kernels.md. A kernel beyond it raises `KernelError` with file, line and remedy.
"""

from __future__ import annotations

import ast
import builtins
import inspect
import math
import operator
import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from ..kernel import Exported, Known, Signature, size_of
from ..maths.vectors import VECTOR_WIDTH
from .c_types import (
    BITS,
    BOOL,
    DOUBLE,
    EIGHT,
    INT64,
    NOTHING,
    NUMBER_KINDS,
    PREFIX,
    ArrayOf,
    CNumber,
    PlaceOf,
    RecordOf,
    TupleOf,
    argument_type,
    c_identifier,
    declare_c,
    returned_type,
)
from .scopes import as_load, is_full_slice, is_stored, leaves_loop, names_in, source_of
from .values import (
    Binding,
    NamedNumber,
    NumberTable,
    Operand,
    StaticValue,
    Value,
    cast_to,
    describe,
    formula,
    is_fixed,
    is_number,
    is_row_of_numbers,
    join_kinds,
    literal,
    loaded,
    place_of,
    static_part,
)


class KernelError(RuntimeError):
    """A kernel is outside the subset; the message states file, line and remedy."""


# -- functions --------------------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class FunctionType:
    """The type of the functions that a `Caller` calls by their addresses."""

    name: str
    signature: Signature


@dataclass
class CVariable:
    """A variable in C; key: what its type is remembered by from one pass to the next."""

    key: Any
    c: str
    block: Any


class Instance:
    """A function for certain types of its arguments, as text of C.

    In the text stand `@N@` for the names of `needs` (functions, their types, constants), which a file gives.
    """

    def __init__(self, function: Any, arguments: Iterable[Any], kernel: Exported | None = None) -> None:
        self.function, self.arguments, self.kernel = function, list(arguments), kernel
        self.source = source_of(function)
        self.returned: Any = None
        self.writes = False
        self.needs: dict[Any, int] = {}
        self.kinds: dict[Any, None] = {}
        self.head, self.body = "", ""

    @property
    def name(self) -> str:
        """The name, unless a file has two of it."""
        if self.kernel is not None:
            return PREFIX + self.kernel.name
        module, name = self.function.__module__ or "function", self.function.__qualname__
        name = re.sub(r"\W", "_", name.replace(".<locals>", "")).strip("_")
        return f"{module.rsplit('.', 1)[-1]}_{name}"

    def need(self, item: Any) -> str:
        """The token that stands for the name of something."""
        return f"@{self.needs.setdefault(item, len(self.needs))}@"

    def lookup(self, name: str) -> StaticValue:
        """The value that a name of the file stands for."""
        closure = dict(zip(self.function.__code__.co_freevars, self.function.__closure__ or (), strict=True))
        if name in closure:
            value = closure[name].cell_contents
        else:
            scope = self.function.__globals__
            value = scope[name] if name in scope else getattr(builtins, name)
        return StaticValue(value, name if is_number(value) else "")


class Translation:
    """One pass over a function; `Program.translate` repeats it until the types no longer change."""

    def __init__(self, program: Program, instance: Instance, kinds: dict[Any, Any]) -> None:
        self.program, self.instance, self.source = program, instance, instance.source
        self.kinds = kinds
        """types of variables by their keys"""
        self.changed = False
        self.lines: list[str] = []
        self.depth = 1
        self.statement: Any = self.source.node
        self.block: Any = self.source.node.body
        self.variables: dict[str, CVariable] = {}
        self.constants: dict[str, StaticValue] = {}
        self.hoisted: dict[str, Any] = {}
        self.storage: list[str] = []
        self.c_names: dict[Any, str] = {}
        self.is_conditional = False
        self.temporaries = 0
        self.comments = sorted(self.source.comments)

    # -- errors and text ----------------------------------------------------------------------------------------------
    def error(self, text: str, node: ast.AST | None = None) -> KernelError:
        """An error at a node, or at the present statement."""
        line = getattr(node, "lineno", getattr(self.statement, "lineno", 0))
        return KernelError(f"{self.source.file}:{line}: {self.source.node.name}: {text}")

    def emit(self, text: str) -> None:
        """Write a line of C."""
        self.lines.append("    " * self.depth + text)

    @contextmanager
    def nested(self, block: Any) -> Iterator[list[str]]:
        """Collect the lines of an inner block."""
        outer = self.block, self.lines
        self.block, self.lines = block, []
        self.depth += 1
        yield self.lines
        self.depth -= 1
        self.block, self.lines = outer

    def inner_lines(self, block: list[ast.stmt]) -> list[str]:
        """The lines of an inner block."""
        with self.nested(block) as lines:
            self.statements(block)
        return lines

    def write_round(self, head: str, node: ast.For, element: Operand | None) -> None:
        """The body of a loop behind its head; an element is assigned to the target first."""
        self.emit(f"{head}{{")
        with self.nested(node.body) as lines:
            self.statement = node
            if element is not None:
                self.assign(node.target, element)
            self.statements(node.body)
        self.lines += lines
        self.emit("}")

    @contextmanager
    def conditional(self) -> Iterator[None]:
        """An operand that may not be evaluated: nothing can be computed before it."""
        outer, self.is_conditional = self.is_conditional, True
        yield
        self.is_conditional = outer

    # -- variables ----------------------------------------------------------------------------------------------------
    def new_variable(self, name: str, kind: Any, key: Any, block: Any) -> CVariable:
        """A variable of a scope; its type is what the passes so far have found."""
        current = self.variables.get(name)
        if key not in self.c_names:
            c, count = c_identifier(name), 1
            if current is not None and current.block is block and current.key != key:  # the name with a new type
                while c in self.c_names.values() or self._is_taken(c):
                    count += 1
                    c = f"{c_identifier(name)}_{count}"
            self.c_names[key] = c
        variable = CVariable(key, self.c_names[key], block)
        self.variables[name] = variable
        self.constants.pop(name, None)
        self.widen(variable, kind)
        return variable

    def _is_taken(self, c: str) -> bool:
        return c in names_in(self.source.node) or any(c == argument.arg for argument in self.source.node.args.args)

    def name_number(self, number: Value, name: str) -> Value:
        """A number of the file under its name."""
        c = name.replace(".", "_").strip("_")
        if re.fullmatch(r"(t|k|zeros)\d+", c) or (c != name and self._is_taken(c)):
            c += "_"  # the function has a variable of this name
        return replace(number, text=self.instance.need(NamedNumber(c, number.kind, number.text)), level=Binding.ATOM)

    def widen(self, variable: CVariable, kind: Any) -> Any:
        """The type of a variable that also holds a value of this type."""
        previous = self.kinds.get(variable.key)
        both = join_kinds(previous, kind)
        if both is None:
            raise self.error(
                f"{variable.c} is {describe(previous)} and {describe(kind)}: give the second its own name."
            )
        if previous is not None and both != previous:
            self.changed = True
        self.kinds[variable.key] = both
        return both

    def temporary(self, value: Value) -> Value:
        """A value that is computed now."""
        name = self._fresh("t")
        self.compute(value, f"{self.declare(value.kind, name, is_constant=True)} = ")
        return Value(name, value.kind)

    def compute(self, value: Value, before: str = "") -> None:
        """Compute a part of the present statement before it."""
        if self.is_conditional:
            raise self.error(
                "an operand that may not be evaluated has to be computed beforehand: assign it to a variable first."
            )
        self.emit(f"{before}{value.text};")

    def declare(self, kind: Any, name: str, is_constant: bool = False) -> str:
        """A declaration; its struct is needed."""
        self.instance.kinds[kind] = None
        text = declare_c(kind, name)
        return f"const {text}" if is_constant and isinstance(kind, CNumber) else text

    def hold(self, value: Value) -> Value:
        """A value whose text may stand twice."""
        if value.embedded[0] or (re.fullmatch(r"&?[\w.>\[\]@-]+", value.text) and not value.writes):
            return value
        return self.temporary(value)

    # -- constants as values ------------------------------------------------------------------------------------------
    def value(self, result: Operand) -> Value:
        """A result as an expression."""
        if isinstance(result, Value):
            return result
        constant = result.value
        if is_number(constant):
            number = literal(constant)
            if result.name and number.kind in (DOUBLE, INT64) and math.isfinite(constant):
                return self.name_number(number, result.name)
            return number
        if isinstance(constant, tuple) and constant:
            if hasattr(constant, "_fields") and hasattr(constant, "kinds"):
                return self.make_record(type(constant), self.parts(result))
            return self.make_tuple(self.parts(result))
        if isinstance(constant, np.ndarray):
            kind = ArrayOf(INT64 if constant.dtype.kind in "bi" else DOUBLE, constant.ndim)
            token = self.instance.need(NumberTable(kind.of, tuple(constant.ravel().tolist())))
            array = self.make_array(kind, f"({kind.of.c} *){token}", constant.shape)
            return replace(array, embedded=(token, constant.shape))
        raise self.error(f"{constant!r} is not a number, a tuple or an array: kernels cannot compute with it.")

    def values(self, results: Iterable[Operand]) -> list[Value]:
        """Operands as expressions; those whose order matters, which C leaves open, are computed one after the other."""
        values = [self.value(result) for result in results]
        last = max((i for i, value in enumerate(values) if value.writes), default=-1)
        if all(is_fixed(value) for i, value in enumerate(values) if i != last):
            return values
        return [self.temporary(value) if i <= last and not is_fixed(value) else value
                for i, value in enumerate(values)]  # fmt: skip

    def apply(self, name: str, operands: Iterable[Value | str], kind: Any, writes: bool = False) -> Value:
        """A call of a function in C."""
        self.instance.kinds[kind] = None
        values = [Value(operand, kind) if isinstance(operand, str) else operand for operand in operands]
        text = f"{name}({', '.join(value.text for value in values)})"
        return Value(text, kind, writes=writes or any(value.writes for value in values))

    def make_array(self, kind: ArrayOf, data: str, sizes: Iterable[Any]) -> Value:
        """An array of numbers that lie somewhere."""
        return self.apply(f"{kind.name}_of", [data, *map(str, sizes)], kind)

    def make_tuple(self, parts: Iterable[Operand]) -> Value:
        """Several values as one."""
        values = self.values(parts)
        kind = TupleOf(tuple(value.kind for value in values))
        self.instance.kinds[kind] = None
        return formula(f"({kind.c}){{{', '.join(value.text for value in values)}}}", kind, Binding.ATOM, *values)

    def make_record(self, kind: Any, fields: Iterable[Operand]) -> Value:
        """A record; its fields have the types that it states."""
        record, values = RecordOf(kind), self.values(fields)
        self.instance.kinds[record] = None
        texts = []
        for (name, stated), value in zip(record.fields.items(), values, strict=True):
            if record.is_embedded(name):
                raise self.error(f"{kind.__name__} holds numbers in itself: write to a row of it.")
            if join_kinds(value.kind, stated) != stated:
                types = f"{describe(stated)}, not {describe(value.kind)}"
                raise self.error(f"{kind.__name__}.{name} is {types}: state its type in the record.")
            texts.append(f".{c_identifier(name)} = {self.convert(value, stated).text}")
        return formula(f"({record.c}){{{', '.join(texts)}}}", record, Binding.ATOM, *values)

    def convert(self, value: Value, kind: Any) -> Value:
        """A value as one of a type."""
        if value.kind == kind:
            return value
        if value.kind in NUMBER_KINDS and kind in NUMBER_KINDS:
            if kind == BOOL:
                return formula(f"{value.at(Binding.ORDER)} != 0", BOOL, Binding.EQUAL, value)
            if re.fullmatch(r"-?\d+", value.text) and kind == DOUBLE:
                return replace(value, text=f"{value.text}.0", kind=DOUBLE)
            if value.kind == BOOL and kind == INT64:
                return replace(value, kind=INT64)
            return cast_to(kind, value)
        if isinstance(value.kind, PlaceOf) and value.kind.record == kind:
            return loaded(value)
        if isinstance(kind, PlaceOf) and value.kind == kind.record:
            if not (value.text.startswith("(struct") or re.fullmatch(r"\w+", value.text)):
                value = self.temporary(value)
            return formula(f"&{value.text}", kind, Binding.UNARY, value)
        if isinstance(value.kind, TupleOf) and isinstance(kind, TupleOf):
            value = self.hold(value)
            parts = [self.convert(Value(f"{value.text}.v{i}", part), target)
                     for i, (part, target) in enumerate(zip(value.kind.of, kind.of, strict=True))]  # fmt: skip
            return self.make_tuple(parts)
        raise self.error(f"{describe(value.kind)} is not {describe(kind)}: convert it, or change the signature.")

    # -- statements ---------------------------------------------------------------------------------------------------
    def statements(self, block: Iterable[ast.stmt]) -> None:
        """Translate statements, with the comments before and beside them."""
        for node in block:
            self.statement = node
            self._comments_before(node.lineno)
            rule = getattr(self, f"write_{type(node).__name__}", None)
            if rule is None:
                raise self.error(f"a kernel has no {type(node).__name__}: see docs/kernels.md.", node)
            try:
                rule(node)
            except (AttributeError, LookupError, TypeError, ValueError, ArithmeticError) as error:
                raise self.error(f"{error}: see docs/kernels.md.", node) from error

    def _comments_before(self, line: int) -> None:
        while self.comments and self.comments[0] <= line:
            self.emit(self.source.comments[self.comments.pop(0)])

    def write_Pass(self, node: ast.Pass) -> None:
        """Write nothing."""

    def write_Expr(self, node: ast.Expr) -> None:
        """A call whose result is not needed; a docstring."""
        if isinstance(node.value, ast.Constant):
            return
        value = self.value(self.expression(node.value))
        self.emit(f"{value.text};" if value.kind == NOTHING else f"(void){value.at(Binding.UNARY)};")

    def write_Return(self, node: ast.Return) -> None:
        """The result of the function; an exported kernel writes several numbers behind its last argument."""
        instance = self.instance
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            instance.returned = instance.returned or NOTHING
            self.emit("return;")
            return
        if instance.kernel is not None and isinstance(instance.returned, TupleOf):
            several = node.value.elts if isinstance(node.value, ast.Tuple) else [ast.Starred(node.value)]
            self._write_answers(self.values(self.arguments(several)), instance.returned.of)
            return
        value = self.value(self.expression(node.value))
        if value.kind == NOTHING:
            raise self.error("returns the result of a function that returns nothing: call it, then return.")
        both = instance.returned if instance.kernel is not None else join_kinds(instance.returned, value.kind)
        if both is None:
            raise self.error(f"returns {describe(instance.returned)} and {describe(value.kind)}: return one type.")
        if instance.returned is not None and both != instance.returned:
            self.changed = True
        instance.returned = both
        self.emit(f"return {self.convert(value, both).text};")

    def _write_answers(self, values: list[Value], kinds: Sequence[Any]) -> None:
        if len(values) != len(kinds):
            raise self.error(f"returns {len(values)} numbers: the signature states {len(kinds)}.")
        for i, (value, kind) in enumerate(zip(values, kinds, strict=True)):
            self.emit(f"{word_text('answers', i, kind)} = {self.convert(value, kind).text};")
        self.emit("return;")

    def write_If(self, node: ast.If) -> None:
        """Both branches of a condition."""
        test = self.condition(node.test)
        self.emit(f"if ({test.text}) {{")
        self.lines += self.inner_lines(node.body)
        last_branch = self.inner_lines(node.orelse)
        is_chain = len(node.orelse) == 1 and isinstance(node.orelse[0], ast.If)
        if is_chain and last_branch[0].lstrip().startswith("if ("):  # nothing is computed before it
            self.emit(f"}} else {last_branch[0].lstrip()}")
            self.lines += [line.removeprefix("    ") for line in last_branch[1:]]
            return
        if last_branch:
            self.emit("} else {")
            self.lines += last_branch
        self.emit("}")

    def write_While(self, node: ast.While) -> None:
        """A loop; the condition is computed in it where it takes statements."""
        if node.orelse:
            raise self.error("a kernel has no else of a loop: use a variable.", node)
        with self.nested(node.body) as computed:
            test = self.condition(node.test)
        self.emit("for (;;) {" if computed else f"while ({test.text}) {{")
        self.lines += computed
        if computed:
            self.emit(f"    if (!{test.at(Binding.UNARY)}) break;")
        self.lines += self.inner_lines(node.body)
        self.emit("}")

    def write_Raise(self, node: ast.Raise) -> None:
        """An exception cannot pass through kernels."""
        raise self.error("a kernel raises nothing: write math.nan to its last array and return.", node)

    def write_Break(self, node: ast.Break) -> None:
        """The end of a loop."""
        self.emit("break;")

    def write_Continue(self, node: ast.Continue) -> None:
        """The next round of a loop."""
        self.emit("continue;")

    def write_For(self, node: ast.For) -> None:
        """A loop over a range, or over the elements of a tuple or an array."""
        if node.orelse:
            raise self.error("a kernel has no else of a loop: use a variable.", node)
        is_range = isinstance(node.iter, ast.Call) and getattr(node.iter.func, "id", "") == "range"
        if is_range and isinstance(node.target, ast.Name):
            self._loop_over_range(node, node.target.id, node.iter.args)  # type: ignore[attr-defined]
            return
        elements = self.expression(node.iter)
        if isinstance(elements, Value) and isinstance(elements.kind, ArrayOf) and elements.kind.ndim == 1:
            elements = self.hold(elements)
            counter = self._fresh("k")
            head = f"for (int64_t {counter} = 0; {counter} < {elements.size(0)}; {counter}++) "
            self.write_round(head, node, self.element(elements, [Value(counter, INT64)]))
            return
        if any(leaves_loop(statement) for statement in node.body):
            raise self.error("a loop over a tuple has no break or continue: it is written out.", node)
        comments = self.comments
        for part in self.parts(elements):
            self.comments = list(comments)
            self.write_round("", node, part)

    def _fresh(self, name: str) -> str:
        """A name that the function does not have."""
        while True:
            self.temporaries += 1
            if not self._is_taken(f"{name}{self.temporaries}"):
                return f"{name}{self.temporaries}"

    def _loop_over_range(self, node: ast.For, name: str, arguments: Sequence[ast.expr]) -> None:
        operands = [self.expression(argument) for argument in arguments]
        bounds = [self.convert(self.value(operand), INT64) for operand in operands]
        first, end = (literal(0), bounds[0]) if len(bounds) == 1 else bounds[:2]
        step, is_up = "1", True
        if len(bounds) > 2:
            if not isinstance(operands[2], StaticValue) or operands[2].value == 0:
                raise self.error("a range needs a constant step, not 0: count by 1 and multiply.", node)
            step, is_up = bounds[2].text, operands[2].value > 0
        end_names = names_in(arguments[0 if len(arguments) == 1 else 1])
        if not is_fixed(end) or any(is_stored(name, [node]) for name in end_names):
            end = self.temporary(end)
        sign = "<" if is_up else ">"
        change = {"1": "++", "-1": "--"}.get(step, f" += {step}")
        is_counter = (id(node), name) in self.source.declares and not is_stored(name, node.body)
        if is_counter:
            counter = self.new_variable(name, INT64, (id(node), name), node.body).c
        else:
            counter = self._fresh("k")
        head = f"for (int64_t {counter} = {first.text}; {counter} {sign} {end.at(Binding.SUM)}; {counter}{change}) "
        self.write_round(head, node, None if is_counter else Value(counter, INT64))

    def write_Assign(self, node: ast.Assign) -> None:
        """Assignments; the right side is computed first."""
        targets = node.targets
        several = node.value.elts if isinstance(node.value, ast.Tuple) else []
        has_star = any(isinstance(part, ast.Starred) for part in several)
        if isinstance(targets[0], ast.Tuple) and several and not has_star:
            self._assign_in_parallel(targets[0].elts, several)
            return
        result = self.expression(node.value)
        if len(targets) > 1 and isinstance(result, Value):
            result = self.temporary(result) if not is_fixed(result) else result
        for target in targets:
            self.assign(target, result)

    def _assign_in_parallel(self, targets: list[ast.expr], expressions: list[ast.expr]) -> None:
        """Several values to as many targets: all are computed first, unless none reads what another changes."""
        changed = {target.id for target in targets if isinstance(target, ast.Name)}
        if len(changed) == len(targets) and not any(changed & names_in(expression) for expression in expressions):
            for target, expression in zip(targets, expressions, strict=True):
                self.assign(target, self.expression(expression))
            return
        results = []
        for expression in expressions:
            result = self.expression(expression)
            if isinstance(result, Value) and (changed & names_in(expression) or not is_fixed(result)):
                result = self.temporary(result)
            results.append(result)
        for target, result in zip(targets, results, strict=True):
            self.assign(target, result)

    def write_AugAssign(self, node: ast.AugAssign) -> None:
        """``x += y`` is ``x = x + y``."""
        load = ast.copy_location(as_load(node.target), node)
        self.assign(node.target, self.binary(type(node.op), self.expression(load), self.expression(node.value)))

    def assign(self, target: ast.expr, result: Operand) -> None:
        """Give a value to a name, an element, a field, or to several of them."""
        if isinstance(target, ast.Name):
            self._assign_to_name(target.id, result)
        elif isinstance(target, ast.Tuple):
            if isinstance(result, Value) and isinstance(result.kind, ArrayOf):
                parts = self._elements(result, len(target.elts))
            else:
                parts = self.parts(result)
            if len(parts) != len(target.elts):
                raise self.error(f"{len(target.elts)} names for {len(parts)} values: name each of them.", target)
            for inner, part in zip(target.elts, parts, strict=True):
                if not (isinstance(inner, ast.Name) and inner.id == "_" and isinstance(part, Value)):
                    self.assign(inner, part)
        elif isinstance(target, ast.Subscript) and self._has_slice(target):
            self._fill(self.value(self.expression(target)), self.value(result))
        else:
            place = self.value(self.expression(target))
            if place.kind not in (*NUMBER_KINDS, EIGHT, BITS):
                raise self.error(f"{describe(place.kind)} cannot be replaced: write its fields one by one.", target)
            if not ("[" in place.text or "->" in place.text):
                raise self.error("a record that is a value does not change: make a new one.", target)
            self.instance.writes = True
            value = self.convert(self.value(result), place.kind)
            self.emit(f"{place.text} = {value.text};")

    def _elements(self, vector: Value, count: int) -> list[Operand]:
        """The elements of a vector that must have so many: NaN where it has not."""
        if vector.kind != ArrayOf(DOUBLE, 1):
            raise self.error(f"{describe(vector.kind)} has no parts: take its elements by their places.")
        vector = self.hold(vector)
        return [
            Value(f"{vector.size(0)} == {count} ? {vector.data}[{i}] : NOT_A_NUMBER", DOUBLE, Binding.CHOICE)
            for i in range(count)
        ]

    @staticmethod
    def _has_slice(node: ast.Subscript) -> bool:
        parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        return any(isinstance(part, ast.Slice) for part in parts)

    def _fill(self, array: Value, value: Value) -> None:
        """Write a number, or the elements of an array, to a whole array."""
        array, value = self.hold(array), self.hold(value)
        counter, kind = self._fresh("k"), array.kind
        count = " * ".join(array.size(i) for i in range(kind.ndim))
        stride = f" * {array.text}.stride" if kind.is_strided else ""
        source = self.convert(value, kind.of).text if value.kind in NUMBER_KINDS else f"{value.data}[{counter}]"
        self.instance.writes = True
        self.emit(f"for (int64_t {counter} = 0; {counter} < {count}; {counter}++) {{")
        self.emit(f"    {array.data}[{counter}{stride}] = {source};")
        self.emit("}")

    def _assign_to_name(self, name: str, result: Operand) -> None:
        """Give a value to a variable; declare it where this is its first statement, or where its type changes."""
        if isinstance(result, StaticValue) and result.is_known:
            once = self.source.stores[name] == 1
            if not is_number(result.value) and (once or not is_row_of_numbers(result.value)):
                self.constants[name] = result
                return
        value = self.value(result)
        if value.kind == NOTHING:
            raise self.error(f"{name} is assigned the result of a function that returns nothing: call it alone.")
        variable, key = self.variables.get(name), (id(self.statement), name)
        declares = key in self.source.declares
        if not declares and variable is not None and name not in self.constants and variable.block is self.block:
            declares = value.kind != self.kinds[variable.key]
        if declares:
            variable = self.new_variable(name, value.kind, key, self.block)
        elif variable is None:
            variable = self.new_variable(name, value.kind, ("function", name), self.source.node.body)
        kind = self.widen(variable, value.kind)
        self.constants.pop(name, None)
        if variable.key[0] == "function":
            self.hoisted[variable.c] = kind
        text, right_side = variable.c, self.convert(value, kind).text
        if declares:
            text = self.declare(kind, text)
        if right_side != text:
            self.emit(f"{text} = {right_side};")

    # -- expressions --------------------------------------------------------------------------------------------------
    def expression(self, node: ast.expr) -> Operand:
        """Translate an expression."""
        rule = getattr(self, f"evaluate_{type(node).__name__}", None)
        if rule is None:
            raise self.error(f"a kernel has no {type(node).__name__}: see docs/kernels.md.", node)
        result: Operand = rule(node)
        return result

    def evaluate_Constant(self, node: ast.Constant) -> Operand:
        """A number that is written out."""
        return StaticValue(node.value)

    def evaluate_Name(self, node: ast.Name) -> Operand:
        """A variable, or a name of the file."""
        if node.id in self.constants:
            return self.constants[node.id]
        if node.id in self.variables:
            variable = self.variables[node.id]
            return Value(variable.c, self.kinds[variable.key])
        if node.id in self.source.stores:
            raise self.error(f"{node.id} is read before it is assigned: assign it first.", node)
        return self.instance.lookup(node.id)

    def evaluate_Tuple(self, node: ast.Tuple) -> Operand:
        """Several values."""
        results = self.arguments(node.elts)
        if all(isinstance(result, StaticValue) for result in results):
            return StaticValue(tuple(result.value for result in results))  # type: ignore[union-attr]
        return self.make_tuple(results)

    def arguments(self, nodes: Iterable[ast.expr]) -> list[Operand]:
        """Results of expressions, of which ``*several`` are some."""
        results: list[Operand] = []
        for node in nodes:
            if isinstance(node, ast.Starred):
                results += self.parts(self.expression(node.value))
            else:
                results.append(self.expression(node))
        return results

    def parts(self, result: Operand) -> list[Operand]:
        """The elements of a tuple, the fields of a record, the sizes of an array."""
        if isinstance(result, StaticValue):
            return [static_part(part) for part in result.value]
        kind = result.kind
        if isinstance(kind, TupleOf):
            result = self.hold(result)
            return [Value(f"{result.text}.v{i}", part) for i, part in enumerate(kind.of)]
        if isinstance(kind, RecordOf | PlaceOf):
            result = self.hold(result)
            record = kind.record if isinstance(kind, PlaceOf) else kind
            return [self.field(result, name) for name in record.kind._fields]
        raise self.error(f"{describe(kind)} has no parts: only tuples and records do.")

    def evaluate_UnaryOp(self, node: ast.UnaryOp) -> Operand:
        """A sign or a negation."""
        if isinstance(node.op, ast.Not):
            test = self.condition(node.operand)
            return formula(f"!{test.at(Binding.UNARY)}", BOOL, Binding.UNARY, test)
        result = self.expression(node.operand)
        if isinstance(result, StaticValue):
            return StaticValue(_OPERATORS[type(node.op)](result.value))
        if not isinstance(node.op, ast.USub) or result.kind not in (INT64, DOUBLE):
            raise self.error(f"no such sign of {describe(result.kind)}.", node)
        text = f"({result.text})" if result.text.startswith("-") else result.at(Binding.UNARY)
        return formula(f"-{text}", result.kind, Binding.UNARY, result)

    def evaluate_BinOp(self, node: ast.BinOp) -> Operand:
        """The result of an operator of arithmetic."""
        return self.binary(type(node.op), self.expression(node.left), self.expression(node.right))

    def binary(self, operation: type[ast.operator], left: Operand, right: Operand) -> Operand:
        """The result of an operator."""
        if isinstance(left, StaticValue) and isinstance(right, StaticValue):
            return StaticValue(_OPERATORS[operation](left.value, right.value))
        a, b = self.values([left, right])
        if isinstance(a.kind, TupleOf) and isinstance(b.kind, TupleOf) and operation is ast.Add:
            return self.make_tuple([*self.parts(a), *self.parts(b)])
        if EIGHT in (a.kind, b.kind):
            if a.kind != b.kind or operation not in (ast.Add, ast.Sub, ast.Mult):
                raise self.error("eight numbers are added, subtracted and multiplied with eight others: use `splat`.")
            return self.apply({ast.Add: "add8", ast.Sub: "sub8", ast.Mult: "mul8"}[operation], (a, b), EIGHT)
        if operation is ast.Pow:
            rule = self.program.functions.get(pow)
            return rule(self, [a, b]) if rule else self._power(a, right)
        is_shift_by_any = (
            operation in (ast.LShift, ast.RShift) and not isinstance(right, StaticValue) and b.kind != BITS
        )
        if is_shift_by_any and self.instance.function.__name__ not in ("left", "right"):
            raise self.error("a shift by more than 63 bits is not defined: use `maths.bits.left` or `right`.")
        if BITS in (a.kind, b.kind):
            a, b = (value if value.kind == BITS else cast_to(BITS, value) for value in (a, b))
            return self._binary_of(operation, a, b, BITS)
        kind = join_kinds(a.kind, b.kind)
        if kind not in NUMBER_KINDS:
            raise self.error(f"no arithmetic of {describe(a.kind)} and {describe(b.kind)}: they are no numbers.")
        if operation is ast.Div:
            a, b, kind = self.convert(a, DOUBLE), self.convert(b, DOUBLE), DOUBLE
        if operation in (ast.FloorDiv, ast.Mod):
            rule = self.program.functions.get(_OPERATORS[operation])
            if kind == DOUBLE and rule:
                return rule(self, [a, b])
            if kind == DOUBLE:
                raise self.error("// and % are of whole numbers: write floor(a / b), or `maths.exact.modulo`.")
            return self.apply("floor_divided" if operation is ast.FloorDiv else "remainder_of", (a, b), INT64)
        if operation in (ast.BitAnd, ast.BitOr, ast.BitXor, ast.LShift, ast.RShift):
            if kind == DOUBLE:
                raise self.error("bits are those of whole numbers: use `bits_of`.")
            if operation is ast.LShift:
                return self.apply("shifted_left", (a, b), INT64)
            return self._binary_of(operation, a, b, kind if operation is not ast.RShift else INT64)
        kind = INT64 if kind == BOOL else kind
        return self._binary_of(operation, self.convert(a, kind), self.convert(b, kind), kind)

    @staticmethod
    def _binary_of(operation: type[ast.operator], a: Value, b: Value, kind: Any) -> Value:
        sign, level = _SIGNS[operation]
        if level in (Binding.BIT, Binding.SHIFTED):  # compilers ask for parentheses
            return formula(f"{a.at(Binding.UNARY)} {sign} {b.at(Binding.UNARY)}", kind, level, a, b)
        return formula(f"{a.at(level)} {sign} {b.at(level - 1)}", kind, level, a, b)

    def _power(self, base: Value, exponent: Operand) -> Value:
        if not (isinstance(exponent, StaticValue) and exponent.value == 2):
            raise self.error("a power of unknown numbers is a square at most: use `maths.exponential.power`.")
        base = self.hold(base)
        return Value(f"{base.text} * {base.text}", base.kind, Binding.PRODUCT)

    def evaluate_Compare(self, node: ast.Compare) -> Operand:
        """Comparisons, in a chain too."""
        results = [self.expression(item) for item in (node.left, *node.comparators)]
        tests = []
        for i, op in enumerate(node.ops):
            if isinstance(op, ast.In | ast.NotIn):
                tests.append(self._is_in(results[i], results[i + 1], isinstance(op, ast.NotIn)))
                continue
            if 0 < i + 1 < len(results) - 1 and isinstance(results[i + 1], Value):
                results[i + 1] = self.hold(results[i + 1])  # type: ignore[arg-type]
            a, b = self.values(results[i : i + 2])
            if join_kinds(a.kind, b.kind) not in NUMBER_KINDS and a.kind != BITS:
                raise self.error(f"no comparison of {describe(a.kind)} and {describe(b.kind)}.", node)
            level = Binding.EQUAL if isinstance(op, ast.Eq | ast.NotEq) else Binding.ORDER
            if DOUBLE in (a.kind, b.kind):
                a, b = self.convert(a, DOUBLE), self.convert(b, DOUBLE)
            text = f"{a.at(Binding.SUM)} {_SYMBOLS[type(op)]} {b.at(Binding.SUM)}"
            tests.append(formula(text, BOOL, level, a, b))
        if len(tests) == 1:
            return tests[0]
        return formula(" && ".join(test.text for test in tests), BOOL, Binding.AND, *tests)

    def _is_in(self, item: Operand, among: Operand, is_negated: bool) -> Value:
        if not isinstance(among, StaticValue):
            raise self.error("`in` is of a tuple that is known: write comparisons.")
        value = self.hold(self.value(item))
        joint, sign = (" && ", "!=") if is_negated else (" || ", "==")
        text = joint.join(f"{value.text} {sign} {literal(element).text}" for element in among.value)
        return Value(text, BOOL, Binding.AND if is_negated else Binding.OR)

    def evaluate_BoolOp(self, node: ast.BoolOp) -> Operand:
        """``and``, ``or``: what is behind the first may not be evaluated."""
        tests = [self.condition(node.values[0])]
        with self.conditional():
            tests += [self.condition(operand) for operand in node.values[1:]]
        level, joint = (Binding.AND, " && ") if isinstance(node.op, ast.And) else (Binding.OR, " || ")
        text = joint.join(test.at(Binding.EQUAL) for test in tests)
        return formula(text, BOOL, level, *tests)

    def condition(self, node: ast.expr) -> Value:
        """An expression as a condition."""
        value = self.value(self.expression(node))
        if value.kind not in NUMBER_KINDS:
            raise self.error(f"{describe(value.kind)} is no condition: compare it with something.", node)
        return self.convert(value, BOOL)

    def evaluate_IfExp(self, node: ast.IfExp) -> Operand:
        """One of two values."""
        test = self.condition(node.test)
        with self.conditional():
            a, b = self.value(self.expression(node.body)), self.value(self.expression(node.orelse))
            kind = join_kinds(a.kind, b.kind)
            if kind is None:
                raise self.error(f"{describe(a.kind)} or {describe(b.kind)}: both must have one type.", node)
            a, b = self.convert(a, kind), self.convert(b, kind)
        text = " : ".join(value.at(Binding.OR) for value in (a, b))
        return formula(f"{test.at(Binding.OR)} ? {text}", kind, Binding.CHOICE, test, a, b)

    def evaluate_Attribute(self, node: ast.Attribute) -> Operand:
        """A field of a record, a size of an array, a name of a module."""
        owner = self.expression(node.value)
        if isinstance(owner, StaticValue):
            value = getattr(owner.value, node.attr)
            return StaticValue(value, ast.unparse(node) if is_number(value) else "")
        kind = owner.kind
        if isinstance(kind, ArrayOf):
            owner = self.hold(owner)
            if node.attr == "size":
                sizes = [owner.size(i) for i in range(kind.ndim)]
                return Value(" * ".join(sizes), INT64, Binding.PRODUCT if len(sizes) > 1 else Binding.ATOM)
            if node.attr == "shape":
                return StaticValue(tuple(Value(owner.size(i), INT64) for i in range(kind.ndim)))
        record = kind.record if isinstance(kind, PlaceOf) else kind
        if not isinstance(record, RecordOf) or node.attr not in record.kind._fields:
            raise self.error(f"{describe(kind)} has no {node.attr}: name one of its fields.", node)
        return self.field(owner, node.attr)

    def field(self, owner: Value, name: str) -> Value:
        """A field of a record; a record within one that stays where it is stays there, too."""
        is_place = isinstance(owner.kind, PlaceOf)
        record = owner.kind.record if is_place else owner.kind
        kind = record.fields[name]
        if is_place and not owner.text.startswith("&"):
            text = f"{owner.at(Binding.ATOM)}->{c_identifier(name)}"
        else:
            text = f"{(loaded(owner) if is_place else owner).at(Binding.ATOM)}.{c_identifier(name)}"
        if record.is_embedded(name):
            if not is_place:
                raise self.error(f"{name} holds numbers in a record that is a value: pass the record by its place.")
            sizes = record.kind.kinds[name][1:]
            return replace(self.make_array(kind, text, sizes), embedded=(text, sizes))
        if is_place and isinstance(kind, RecordOf):
            return place_of(text, kind)
        return Value(text, kind)

    def evaluate_Subscript(self, node: ast.Subscript) -> Operand:
        """An element, a row, a slice."""
        owner = self.expression(node.value)
        indices = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
        if isinstance(owner, StaticValue):
            results = [self.expression(index) for index in indices]
            if all(isinstance(result, StaticValue) for result in results):
                at = tuple(result.value for result in results)  # type: ignore[union-attr]
                return static_part(owner.value[at if len(at) > 1 else at[0]])
            if is_row_of_numbers(owner.value):
                owner = StaticValue(np.array(owner.value))
            owner = self.value(owner)
        kind = owner.kind
        if isinstance(kind, TupleOf | RecordOf | PlaceOf):
            return self._part(owner, self.expression(indices[0]), node)
        if not isinstance(kind, ArrayOf):
            raise self.error(f"{describe(kind)} has no elements.", node)
        return self._indexed(owner, indices, node)

    def _part(self, owner: Value, index: Operand, node: ast.AST) -> Operand:
        """A part of a tuple or a record of numbers by its place."""
        if isinstance(index, StaticValue) or not isinstance(owner.kind, TupleOf | RecordOf):
            return self.parts(owner)[index.value]  # type: ignore[union-attr]
        kinds = set(owner.kind.of if isinstance(owner.kind, TupleOf) else owner.kind.fields.values())
        if len(kinds) != 1 or not kinds <= {DOUBLE, INT64}:
            raise self.error("the place in a tuple of different types must be known: write branches.", node)
        (kind,) = kinds
        owner = self.hold(owner) if re.fullmatch(r"\w+", owner.text) else self.temporary(owner)
        return Value(f"((const {kind.c} *)&{owner.text})[{self.value(index).text}]", kind)

    def _indexed(self, array: Value, indices: list[ast.expr], node: ast.AST) -> Value:
        """Rows first, then a slice of the first dimension that is left; or a column."""
        kind = array.kind
        if len(indices) > kind.ndim:
            raise self.error(f"{len(indices)} indices of {kind.ndim} dimensions.", node)
        slices = [isinstance(index, ast.Slice) for index in indices]
        if slices == [True, False] and kind == ArrayOf(DOUBLE, 2) and is_full_slice(indices[0]):
            index = self.value(self.expression(indices[1]))
            return self.apply("matrix_column", [array, self._at(index, array, 1)], ArrayOf(DOUBLE, 1, True))
        count = slices.index(True) if True in slices else len(indices)
        if any(not is_full_slice(index) for index in indices[count + 1 :]):
            raise self.error("a slice comes last: take rows first.", node)
        scalars = [self.value(self.expression(index)) for index in indices[:count]]
        if count == kind.ndim:
            return self.element(array, scalars)
        for scalar in scalars:
            array = self.apply(f"{array.kind.name}_row", [array, self._at(scalar, array, 0)], array.kind.row)
        if count < len(indices) and not is_full_slice(indices[count]):
            array = self._sliced(array, indices[count])  # type: ignore[arg-type]
        return array

    def _sliced(self, array: Value, bounds: ast.Slice) -> Value:
        if bounds.step is not None:
            raise self.error("a slice has no step: write a loop.")
        lower = "0" if bounds.lower is None else self.value(self.expression(bounds.lower))
        upper = "INT64_MAX" if bounds.upper is None else self.value(self.expression(bounds.upper))
        return self.apply(f"{array.kind.name}_slice", [array, lower, upper], array.kind)

    def _at(self, index: Value, array: Value, dimension: int) -> Value:
        """An index; a negative number that is written out counts from the end."""
        if index.kind not in (INT64, BOOL):
            raise self.error(f"an index is a whole number, not {describe(index.kind)}: use `maths.bits.whole`.")
        size = array.size(dimension)
        if re.fullmatch(r"-\d+", index.text):
            index = Value(f"{size} - {index.text[1:]}", INT64, Binding.SUM)
        if self.program.checks_indices:
            return Value(f"checked_index({index.text}, {size})", INT64)
        return index

    def element(self, array: Value, indices: list[Value]) -> Value:
        """One element: a number, or a row of an array of records."""
        array = self.hold(array)
        kind, place = array.kind, self._at(indices[0], array, 0)
        for dimension, index in enumerate(indices[1:], 1):
            index, size = self._at(index, array, dimension), array.size(dimension)
            before = Value(f"{place.at(Binding.PRODUCT)} * {size}", INT64, Binding.PRODUCT)
            if place.text == "0":
                place = index
            elif index.text == "0":
                place = before
            else:
                place = Value(f"{before.text} + {index.at(Binding.SUM)}", INT64, Binding.SUM)
        text = f"{place.at(Binding.PRODUCT)} * {array.text}.stride" if kind.is_strided else place.text
        text = f"{array.data}[{text}]"
        if isinstance(kind.of, RecordOf):
            return place_of(text, kind.of)
        return Value(text, kind.of)

    # -- calls --------------------------------------------------------------------------------------------------------
    def evaluate_Call(self, node: ast.Call) -> Operand:
        """A call of a kernel, a record, or one of the functions of Python that kernels have."""
        if isinstance(node.func, ast.Attribute) and node.func.attr == "view":
            owner = self.expression(node.func.value)
            if isinstance(owner, Value):
                return self._array_view(owner, node)
        called = self.expression(node.func)
        if not isinstance(called, StaticValue):
            raise self.error("a function that is called must be known: use a `Caller` for an address.", node)
        function = called.value
        results = self.arguments(node.args)
        keywords = {keyword.arg: self.expression(keyword.value) for keyword in node.keywords}
        if hasattr(function, "kinds"):
            fields = dict(zip(function._fields, results, strict=False)) | keywords
            return self.make_record(function, [fields[name] for name in function._fields])
        if keywords:
            raise self.error("only records take arguments by name.", node)
        if isinstance(function, Known):
            result: Operand = getattr(self, f"call_{function.kind}")(function, results, node)
            return result
        if self.program.folds(function) and all(isinstance(result, StaticValue) for result in results):
            return StaticValue(function(*(result.value for result in results)))  # type: ignore[union-attr]
        if function in self.program.functions:
            computed: Operand = self.program.functions[function](self, results)
            return computed
        if self.program.inlines(function):
            return self.call_inlined(Known("inlined", function), results, node)
        raise self.error(self.program.refusal(function, ast.unparse(node.func)), node)

    def _array_view(self, array: Value, node: ast.Call) -> Value:
        """``vector.view(np.int64)``: the same words as whole numbers."""
        array = self.hold(array)
        (argument,) = self.arguments(node.args)
        if not (isinstance(argument, StaticValue) and argument.value is np.int64 and array.kind == ArrayOf(DOUBLE, 1)):
            raise self.error("only a vector is viewed, as np.int64.", node)
        return self.make_array(ArrayOf(INT64, 1), f"(int64_t *){array.data}", [array.size(0)])

    def call_inlined(self, function: Known, results: list[Operand], node: ast.Call) -> Operand:
        """A function that is a part of this one; numbers are passed, all else that is known is built in."""
        parameters = source_of(function.function).node.args
        missing = len(parameters.args) - len(results)
        if missing:
            results = results + [StaticValue(ast.literal_eval(value)) for value in parameters.defaults[-missing:]]
        arguments = [
            result
            if isinstance(result, StaticValue) and result.is_known and not is_number(result.value)
            else self.value(result)
            for result in results
        ]
        called = self.program.instance(function.function, [
            argument.kind if isinstance(argument, Value) else argument for argument in arguments
        ])  # fmt: skip
        values = self.values(argument for argument in arguments if isinstance(argument, Value))
        self.instance.writes |= called.writes
        return self.apply(self.instance.need(called), values, called.returned, called.writes)

    def call_exported(self, function: Exported, results: list[Operand], node: ast.Call) -> Operand:
        """A kernel of the library: its C function."""
        self.program.kernels.setdefault(function.name, function)
        writes = self.program.kernel(function).writes
        return self._call_function(self.instance.need(function), function.signature, self.values(results), writes)

    def call_caller(self, function: Known, results: list[Operand], node: ast.Call) -> Operand:
        """A call of an address."""
        address, *values = self.values(results)
        name = ast.unparse(node.func).rsplit(".", 1)[-1].strip("_").removeprefix("call_")
        kind = self.instance.need(FunctionType(f"{name}_function", function.of))
        return self._call_function(f"(({kind})(intptr_t){address.at(Binding.UNARY)})", function.of, values, True)

    def _call_function(self, name: str, signature: Signature, values: list[Value], writes: bool) -> Value:
        """A call of a C function: an array is its place and its sizes, several results are written to words."""
        arguments: list[Value | str] = []
        for value, kind in zip(values, map(argument_type, signature.types), strict=True):
            value = self.convert(value, kind)
            if isinstance(kind, ArrayOf):
                value = self.hold(value)
                arguments += [value.data, *map(value.size, range(kind.ndim))]
            else:
                arguments.append(value)
        self.instance.writes |= writes
        returned = returned_type(signature)
        if not isinstance(returned, TupleOf):
            return self.convert(self.apply(name, arguments, c_result(returned), writes), returned)
        words = self._fresh("words")
        self.storage.append(f"adaptrack_word {words}[{len(returned.of)}];")
        self.compute(self.apply(name, [*arguments, words], NOTHING, writes))
        return self.make_tuple(Value(word_text(words, i, kind), kind) for i, kind in enumerate(returned.of))

    def call_view(self, function: Known, results: list[Operand], node: ast.Call) -> Operand:
        """The record that lies in a vector from a place on."""
        vector, place = (self.value(result) for result in results)
        vector = self.hold(vector)
        record = RecordOf(function.of)
        self.instance.kinds[record] = None
        at = place.at(Binding.SUM)
        if self.program.checks_indices:
            at = f"checked_span({place.text}, {size_of(function.of)}, {vector.size(0)})"
        text = vector.data + ("" if at == "0" else f" + {at}")
        text = f"({text})" if " " in text else text
        return Value(f"({record.c} *){text}", PlaceOf(record), Binding.UNARY)

    def call_local(self, function: Known, results: list[Operand], node: ast.Call) -> Operand:
        """An array of zeros on the stack."""
        kind, count = ArrayOf(DOUBLE, len(function.of)), math.prod(function.of)
        name = self._fresh("zeros")
        self.storage.append(f"double {name}[{count}];")
        return self.make_array(kind, f"filled_with_zeros({name}, {count})", function.of)

    def call_primitive(self, function: Known, results: list[Operand], node: ast.Call) -> Operand:
        """An operation of the head: on one number, or on eight."""
        name, values = function.function.__name__, self.values(results)
        rule = getattr(self, f"compute_{name}", None)
        if rule is not None:
            result: Operand = rule(values)
            return result
        if name not in PRIMITIVES:
            raise self.error(f"the compiler does not know the primitive {name}.", node)
        is_of_eight = any(value.kind == EIGHT for value in values)
        returned = PRIMITIVES[name] or (EIGHT if is_of_eight else DOUBLE)
        if returned == DOUBLE and not is_of_eight and name != "float_of":
            values = [self.convert(value, DOUBLE) for value in values]
        width = 8 if is_of_eight or returned == EIGHT else 1
        return self.apply(f"{name.removesuffix('8')}{width}", values, returned)

    def compute_shaped(self, values: list[Value]) -> Value:
        """The numbers of a vector as an array of more dimensions."""
        vector = self.hold(values[0])
        return self.make_array(ArrayOf(vector.kind.of, len(values) - 1), vector.data, [v.text for v in values[1:]])

    def compute_load(self, values: list[Value]) -> Value:
        """Eight numbers of an array from a place on."""
        return self.apply("load8", [f"&{self._span(values, VECTOR_WIDTH)}"], EIGHT)

    def compute_store(self, values: list[Value]) -> Value:
        """Eight numbers to an array from a place on."""
        self.instance.writes = True
        return self.apply("store8", [f"&{self._span(values[:-1], VECTOR_WIDTH)}", values[-1]], NOTHING, True)

    def compute_spread(self, values: list[Value]) -> Value:
        """One number of an array in all eight entries."""
        return self.apply("splat8", [self._span(values, 1)], EIGHT)

    def _span(self, values: list[Value], count: int) -> str:
        """The first of so many numbers of an array, behind which the values are its indices."""
        array, indices = self.hold(values[0]), values[1:]
        if not isinstance(array.kind, ArrayOf) or array.kind.ndim != len(indices):
            raise self.error("load, store and spread take an index for each dimension of an array.")
        if self.program.checks_indices and count > 1:
            checked = f"checked_span({indices[-1].text}, {count}, {array.size(len(indices) - 1)})"
            indices[-1] = Value(checked, INT64)
        return self.element(array, indices).text

    def compute_column(self, values: list[Value]) -> Value:
        """Eight numbers of a column of a matrix."""
        matrix = self.hold(values[0])
        return self.apply("column8", [matrix.data, matrix.size(1), *values[1:]], EIGHT)

    def compute_totals(self, values: list[Value]) -> Value:
        """Eight sums of eight numbers."""
        rows = self.hold(values[0])
        return self.apply("totals8", [f"{rows.text}.v{i}" for i in range(VECTOR_WIDTH)], EIGHT)


# -- functions of Python's --------------------------------------------------------------------------------------------
def _extreme(name: str, translation: Translation, results: list[Operand]) -> Value:
    """min or max of two or more numbers, one after the other."""
    values = translation.values(results)
    best = values[0]
    for value in values[1:]:
        kind = join_kinds(best.kind, value.kind)
        best, value = translation.convert(best, kind), translation.convert(value, kind)
        best = translation.apply(f"{name}_{'real' if kind == DOUBLE else 'whole'}", (best, value), kind)
    return best


def _absolute(translation: Translation, results: list[Operand]) -> Value:
    (value,) = translation.values(results)
    return translation.apply("abs1" if value.kind == DOUBLE else "abs_whole", [value], value.kind)


def call_real(name: str, kind: Any, translation: Translation, results: list[Operand]) -> Value:
    """A function of real numbers."""
    values = [translation.convert(value, DOUBLE) for value in translation.values(results)]
    return translation.apply(name, values, kind)


def _to_real(translation: Translation, results: list[Operand]) -> Value:
    (value,) = translation.values(results)
    return value if value.kind == DOUBLE else cast_to(DOUBLE, value)


def _to_whole(translation: Translation, results: list[Operand]) -> Value:
    (value,) = translation.values(results)
    if value.kind == DOUBLE and translation.instance.function.__name__ != "whole":
        raise translation.error("int() of a number that may not fit is not defined: use `maths.bits.whole`.")
    return cast_to(INT64, value)


def _to_bits(translation: Translation, results: list[Operand]) -> Value:
    (result,) = results
    if isinstance(result, StaticValue):
        return Value(f"UINT64_C({int(result.value)})", BITS)
    return cast_to(BITS, result)


def _length(translation: Translation, results: list[Operand]) -> Operand:
    (result,) = results
    assert isinstance(result, Value)
    if isinstance(result.kind, ArrayOf):
        return Value(translation.hold(result).size(0), INT64)
    return StaticValue(len(translation.parts(result)))


FUNCTIONS: dict[Any, Any] = {
    min: partial(_extreme, "min"),
    max: partial(_extreme, "max"),
    abs: _absolute,
    float: _to_real,
    int: _to_whole,
    len: _length,
    np.uint64: _to_bits,
    math.copysign: partial(call_real, "copysign1", DOUBLE),
    math.isnan: partial(call_real, "isnan1", BOOL),
    math.isfinite: partial(call_real, "isfinite1", BOOL),
    math.isinf: partial(call_real, "isinf1", BOOL),
}
"""What kernels may call of Python's functions."""

PRIMITIVES: dict[str, Any] = {
    **dict.fromkeys(("fma", "sqrt", "floor", "ceil", "float_of", "total", "largest", "smallest"), DOUBLE),
    **dict.fromkeys(("zeros", "splat", "add", "sub", "mul", "div", "fma8", "lesser", "larger", "where_positive",
                     "with_entry", "keep_first", "keep_last"), EIGHT),
    **dict.fromkeys(("bits_of", "first_equal"), INT64),
    **dict.fromkeys(("usual_sum", "all_below_infinity"), BOOL),
    **dict.fromkeys(("upper_half", "to_odd")),
}  # fmt: skip
"""What the functions of the head return that have the name of a primitive, and 1 or 8; None: what they are given."""

_OPERATORS: dict[Any, Any] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Mult: operator.mul, ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv, ast.Mod: operator.mod, ast.Pow: operator.pow, ast.LShift: operator.lshift,
    ast.RShift: operator.rshift, ast.BitAnd: operator.and_, ast.BitOr: operator.or_, ast.BitXor: operator.xor,
    ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Invert: operator.inv,
}  # fmt: skip
_SIGNS: dict[Any, tuple[str, Binding]] = {
    ast.Add: ("+", Binding.SUM), ast.Sub: ("-", Binding.SUM), ast.Mult: ("*", Binding.PRODUCT),
    ast.Div: ("/", Binding.PRODUCT), ast.BitAnd: ("&", Binding.BIT), ast.BitOr: ("|", Binding.BIT),
    ast.BitXor: ("^", Binding.BIT), ast.RShift: (">>", Binding.SHIFTED), ast.LShift: ("<<", Binding.SHIFTED),
}  # fmt: skip
_SYMBOLS = {ast.Lt: "<", ast.LtE: "<=", ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!="}


# -- programs ---------------------------------------------------------------------------------------------------------
class Program:
    """All functions that some kernels need.

    checks_indices: every index is checked, and the process ends at one that is beyond its array.
    """

    translation_class = Translation
    functions = FUNCTIONS
    """Functions that may be called in addition to kernels, and the rule of each."""

    def __init__(self, checks_indices: bool = False) -> None:
        self.checks_indices = checks_indices
        self.instances: dict[Any, Instance] = {}
        self.kernels: dict[str, Exported] = {}
        self._kept: list[Any] = []

    def folds(self, function: Any) -> bool:
        """Whether a call with known arguments is computed when the kernel is translated."""
        return function is not np.uint64

    def inlines(self, function: Any) -> bool:
        """Whether a function that is no kernel is translated as a part of its caller."""
        return False

    def refusal(self, function: Any, name: str) -> str:
        """The message for a call of a function that is no kernel."""
        return f"{name} is no kernel: mark it as `inlined` or `exported`."

    def _key(self, argument: Any) -> Any:
        """A key that tells arguments apart: a type, or the identity of a known value."""
        if not isinstance(argument, StaticValue):
            return argument
        value = argument.value
        if isinstance(value, tuple):
            return (type(value), *(self._key(StaticValue(part)) for part in value))
        if is_number(value):
            return type(value), repr(value)
        self._kept.append(value)
        return id(value)

    def instance(self, function: Any, arguments: Sequence[Any]) -> Instance:
        """A function for types of its arguments, translated."""
        key = (function, *map(self._key, arguments))
        if key not in self.instances:
            instance = Instance(function, arguments)
            self.translate(instance)
            self.instances[key] = instance
        return self.instances[key]

    def kernel(self, kernel: Exported) -> Instance:
        """An exported kernel, translated."""
        key = ("exported", kernel.name)
        if key not in self.instances:
            instance = Instance(kernel.function, map(argument_type, kernel.signature.arguments), kernel)
            instance.returned = returned_type(kernel.signature)
            self.translate(instance)
            self.instances[key] = instance
        return self.instances[key]

    def translate(self, instance: Instance) -> None:
        """Translate a function: until no variable changes its type."""
        kinds: dict[Any, Any] = {}
        while True:
            instance.needs, instance.kinds = {}, {}
            translation = self.translation_class(self, instance, kinds)
            body = self._pass(translation)
            if not translation.changed:
                break
        if instance.returned is None:
            instance.returned = NOTHING
        instance.kinds[instance.returned] = None
        instance.head, instance.body = body

    def _pass(self, translation: Translation) -> tuple[str, str]:
        """One pass; the head of the C function and its body."""
        instance, node = translation.instance, translation.source.node
        parameters: list[tuple[Any, CVariable]] = []
        for argument, kind in zip(node.args.args, instance.arguments, strict=True):
            name = argument.arg
            if isinstance(kind, StaticValue):
                translation.constants[name] = kind
            else:
                parameters.append((kind, translation.new_variable(name, kind, ("parameter", name), node.body)))
        translation.statements(node.body)
        words, opening = [], []
        for kind, variable in parameters:
            final, c = translation.kinds[variable.key], variable.c
            if instance.kernel is not None:
                parameter_words, value = c_parameter(kind, c)
            elif final == kind:
                parameter_words, value = [declare_c(kind, c)], ""
            else:
                value = translation.convert(Value(f"{c}_argument", kind), final).text
                parameter_words = [declare_c(kind, f"{c}_argument")]
            words += parameter_words
            if value:
                opening.append(f"{declare_c(final, c)} = {value};")
        opening += [f"{declare_c(kind, c)} = {initial(kind)};" for c, kind in translation.hoisted.items()]
        opening += translation.storage
        instance.kinds.update(dict.fromkeys([*(kind for kind, _ in parameters), *translation.hoisted.values()]))
        if instance.kernel is not None:
            head = prototype(instance.kernel)
        else:
            head = c_function(instance.returned or NOTHING, "@name@", words)
        return head, "\n".join(["    " + line for line in opening] + translation.lines)


def initial(kind: Any) -> str:
    """The value of a variable that its function declares before it is assigned."""
    if kind == EIGHT:
        return "zeros8()"
    if isinstance(kind, PlaceOf):
        return "0"
    return {BOOL: "false", DOUBLE: "0.0", INT64: "0", BITS: "0"}.get(kind, "{0}")


def c_parameter(kind: Any, name: str) -> tuple[list[str], str]:
    """Declarations of the parameters of an argument of a C function, and what makes the value of them."""
    if isinstance(kind, ArrayOf):
        sizes = [f"{name}_{i}" for i in range(kind.ndim)]
        words = [declare_c(kind.of, f"*{name}_data"), *(f"int64_t {size}" for size in sizes)]
        return words, f"{kind.name}_of({', '.join([f'{name}_data', *sizes])})"
    if kind == BOOL:
        return [f"int64_t {name}_word"], f"{name}_word != 0"
    if isinstance(kind, RecordOf):
        return [declare_c(PlaceOf(kind), f"{name}_place")], f"*{name}_place"
    return [declare_c(kind, name)], ""


def c_function(returned: Any, name: str, words: list[str]) -> str:
    """The head of a function in C."""
    return f"{declare_c(returned, name)}({', '.join(words) or 'void'})"


def c_result(kind: Any) -> Any:
    """The result of the C function of an exported kernel: several numbers are written behind its last argument."""
    return NOTHING if isinstance(kind, TupleOf) else INT64 if kind == BOOL else kind


def word_text(words: str, i: int, kind: Any) -> str:
    """One of several numbers that a kernel returns."""
    return f"{words}[{i}].{'number' if kind == DOUBLE else 'whole'}"


def parameter_names(kernel: Exported) -> list[str]:
    """Names of the arguments of a kernel in C."""
    return [c_identifier(name) for name in inspect.signature(kernel.function).parameters]


def prototype(kernel: Exported) -> str:
    """The head of the C function of a kernel."""
    returned, words = returned_type(kernel.signature), []
    for name, kind in zip(parameter_names(kernel), kernel.signature.arguments, strict=True):
        words += c_parameter(argument_type(kind), name)[0]
    if isinstance(returned, TupleOf):
        words.append(f"adaptrack_word answers[{len(returned.of)}]")
    return c_function(c_result(returned), PREFIX + kernel.name, words)
