"""Sources of functions: their syntax trees, their comments, and where their variables are declared in C."""

from __future__ import annotations

import ast
import inspect
import io
import linecache
import textwrap
import tokenize
from collections import Counter
from collections.abc import Iterable, Iterator
from functools import cache
from importlib import import_module
from typing import Any


class FunctionSource:
    """The syntax tree of a function and the comments of its lines.

    stores: how often the function assigns a name; declares: statements that declare a variable in C, with its name.
    """

    def __init__(self, function: Any) -> None:
        text = getattr(function, "source_text", None)
        code = function.__code__
        self.file = code.co_filename if text is None else function.__module__
        linecache.checkcache(code.co_filename)
        functions, comments = _parsed(text or "".join(linecache.getlines(code.co_filename)))
        self.node = functions[1 if text is not None else code.co_firstlineno]
        within = range(self.node.body[0].lineno, (self.node.end_lineno or 0) + 1)
        self.comments = {
            line: f"/* {text.replace('*/', '* /').replace('/*', '/ *')} */"
            for line, text in comments.items()
            if line in within
        }
        self.stores = Counter(
            node.id for node in ast.walk(self.node) if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)
        )
        self.declares: set[tuple[int, str]] = set()
        parameters = {argument.arg for argument in self.node.args.args}
        for name in self.stores.keys() - parameters:
            self.declares |= {(id(place), name) for place in _declarations(name, self.node.body) or ()}


@cache
def _parsed(text: str) -> tuple[dict[int, ast.FunctionDef], dict[int, str]]:
    """Functions by their first lines, comments by line; a lambda is a function that returns its expression."""
    functions: dict[int, ast.FunctionDef] = {}
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Lambda):
            body: list[ast.stmt] = [ast.copy_location(ast.Return(node.body), node.body)]
            function = ast.FunctionDef("lambda", node.args, body, [])
            functions.setdefault(node.lineno, ast.copy_location(function, node))
        elif isinstance(node, ast.FunctionDef):
            functions[min([node.lineno, *(decorator.lineno for decorator in node.decorator_list)])] = node
    return functions, _comments(text)


def _comments(text: str) -> dict[int, str]:
    """Comments by line."""
    return {
        token.start[0]: token.string.lstrip("# ")
        for token in tokenize.generate_tokens(io.StringIO(text).readline)
        if token.type == tokenize.COMMENT and not token.string.startswith(("# fmt", "# noqa", "# type"))
    }


@cache
def source_of(function: Any) -> FunctionSource:
    """The source of a function of kernels."""
    return FunctionSource(function)


@cache
def names_in(node: ast.AST) -> frozenset[str]:
    """Names that occur in a node."""
    return frozenset(child.id for child in ast.walk(node) if isinstance(child, ast.Name))


def inner_blocks(statement: ast.stmt) -> list[list[ast.stmt]]:
    """The blocks of a statement that has some."""
    return [block for block in (getattr(statement, "body", []), getattr(statement, "orelse", [])) if block]


def _targets(statement: ast.stmt) -> set[str]:
    """Names that a statement assigns whatever happens."""
    if not isinstance(statement, ast.Assign):
        return set()
    elements = [element for target in statement.targets
                for element in (target.elts if isinstance(target, ast.Tuple) else [target])]  # fmt: skip
    return {element.id for element in elements if isinstance(element, ast.Name)}


def _is_loop_variable(name: str, statement: ast.stmt) -> bool:
    """Whether a name is the target of a loop, and nothing outside its body needs it."""
    return (
        isinstance(statement, ast.For) and name in names_in(statement.target) and name not in names_in(statement.iter)
    )


def _declarations(name: str, block: list[ast.stmt]) -> list[ast.stmt] | None:
    """Statements that may declare a variable, each for the rest of its block; None: the function must.

    A statement may if it assigns the variable before anything in its block reads it.
    """
    places: list[ast.stmt] = []
    for statement in block:
        if name not in names_in(statement):
            continue
        if name in _targets(statement):
            return None if _reads(name, statement) else [*places, statement]
        if _is_loop_variable(name, statement):
            places.append(statement)
            continue
        heads = [child for child in ast.iter_child_nodes(statement) if not isinstance(child, ast.stmt)]
        if any(name in names_in(head) for head in heads):
            return None
        for inner in inner_blocks(statement):
            inner_places = _declarations(name, inner)
            if inner_places is None:
                return None
            places += inner_places
    return places


def _reads(name: str, statement: ast.stmt) -> bool:
    return any(node.id == name and isinstance(node.ctx, ast.Load)
               for node in ast.walk(statement) if isinstance(node, ast.Name))  # fmt: skip


def leaves_loop(statement: ast.stmt) -> bool:
    """Whether a statement holds a break or a continue of the loop that it is in."""
    if isinstance(statement, ast.For | ast.While):
        return False
    return isinstance(statement, ast.Break | ast.Continue) or any(
        leaves_loop(inner) for block in inner_blocks(statement) for inner in block
    )


def is_full_slice(node: ast.expr) -> bool:
    """Whether a slice is ``:``."""
    return isinstance(node, ast.Slice) and node.lower is None and node.upper is None and node.step is None


def is_stored(name: str, block: Iterable[ast.AST]) -> bool:
    """Whether statements assign a name."""
    return any(node.id == name and isinstance(node.ctx, ast.Store)
               for statement in block for node in ast.walk(statement) if isinstance(node, ast.Name))  # fmt: skip


@cache
def as_load(target: ast.expr) -> ast.expr:
    """The target of an assignment as an expression."""
    return ast.parse(ast.unparse(target), mode="eval").body


# -- remarks ----------------------------------------------------------------------------------------------------------
@cache
def remarks(module: str) -> dict[str, tuple[str, dict[str, str]]]:
    """Return the remarks of a file on each ``NAME = record(...)`` and ``NAME = columns(...)`` and on its fields."""
    source = inspect.getsource(import_module(module))
    comments = _comments(source)
    statements = ast.parse(source).body
    assigned = {
        node.targets[0].id: node.value
        for node in statements
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    remarks_by_name = {}
    for node, after in zip(statements, [*statements[1:], None], strict=True):
        value = node.value if isinstance(node, ast.Assign) else None
        if isinstance(value, ast.Call) and isinstance(value.func, ast.Name) and value.func.id in ("record", "columns"):
            fields = _fields(list(_texts(value, assigned)), comments)
            remark = after.value if isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant) else None
            (target,) = node.targets  # type: ignore[attr-defined]
            remarks_by_name[target.id] = (inspect.cleandoc(str(remark.value)) if remark else "", fields)
    return remarks_by_name


def _fields(texts: list[Any], comments: dict[int, str]) -> dict[str, str]:
    """Return the comment of each field; a line's units are shared out among as many fields."""
    remarks_by_field = {}
    for text in texts:
        line = [constant.value for constant in texts if constant.lineno == text.lineno]
        remark = comments.get(text.lineno, "")
        units, colon, meaning = remark.partition(":")
        field_units = units.split(", ")
        if len(line) > 1 and len(field_units) == len(line):
            remark = field_units[line.index(text.value)] + colon + meaning
        remarks_by_field[text.value] = remark
    return remarks_by_field


def _texts(node: ast.AST, assigned: dict[str, Any]) -> Iterator[Any]:
    """The strings of an expression, and of those that it names."""
    for child in ast.walk(node):
        if isinstance(child, ast.Constant) and isinstance(child.value, str):
            yield child
        elif isinstance(child, ast.Name) and isinstance(assigned.get(child.id), ast.Tuple | ast.List):
            yield from _texts(assigned[child.id], {})


def comment(text: str, indent: str = "") -> str:
    """A text as a comment of C."""
    lines = textwrap.wrap(" ".join(text.replace("*/", "* /").split()), 110)
    return f"{indent}/* " + f"\n{indent}   ".join(lines) + " */\n" if lines else ""


def comment_after(text: str) -> str:
    """A text as a comment behind a declaration."""
    return f" /* {text.replace('*/', '* /')} */" if text else ""
