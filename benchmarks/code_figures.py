"""Size of the code, in numbers: `python benchmarks/code_figures.py [CHECKOUT ...] [--table | --write PAGE]`.

Lines of Python by room of the package, of its JavaScript, templates and C, of the tests, and of the programs beside
them; lengths of functions (docstrings and nested functions included) and of files, arguments per function (without self
and cls), public names, share of public classes and functions with a docstring, and repeated code: lines in runs of at
least five that occur more than once, compared without comments, docstrings, imports and formatting. All of it from the
syntax trees: nothing is imported. `--table` prints several checkouts side by side in Markdown, `--write` puts that
table between the two marks of a page, with the names "before" and "after" for two checkouts.
"""

from __future__ import annotations

import argparse
import ast
import json
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = "adaptrack"
ROOT = Path(__file__).resolve().parents[1]
PYTHON = ("*.py",)
OTHER = ("*.js", "*.j2", "*.css", "*.html", "*.c", "*.h", "*.hpp")
PROGRAMS = ("benchmarks", "tools", "experiments", "examples")
REPEATED = 5
"""Lines that make a repetition."""
MARKS = ("<!-- code figures -->\n", "<!-- end of code figures -->\n")
"""around the table in a page"""

CEILINGS: Mapping[str, int] = {
    "base": 2090,
    "core": 27920,
    "cars": 2140,
    "road": 5000,
    "scenario": 1850,
    "control": 7540,
    "drive": 3190,
    "analysis": 1880,
    "identification": 4970,
    "tuning": 1600,
    "comparison": 2000,
    "paper": 4090,
    "export": 3220,
    "gym": 1280,
    "results": 4630,
    "cli": 3290,
    "adaptrack": 40,
    "JavaScript, templates, C": 10400,
    "tests": 45990,
    "benchmarks, tools, experiments, examples": 17350,
}
"""Most lines of each room, of JavaScript, templates and C, of the tests and of `PROGRAMS`.

`tests/project/test_ceilings.py` holds them; raising one is a decision with a reason in docs/design.md."""
SOURCE_LINES = 76_660
"""Most lines of all rooms together: one room may grow only by what another one loses."""


class Module(NamedTuple):
    """A file of the package."""

    name: str
    """its path in the package"""
    tree: ast.Module
    lines: int

    @property
    def room(self) -> str:
        """The folder at the top; the package's own files by its name."""
        folder, _, rest = self.name.partition("/")
        return folder if rest else PACKAGE


def count_lines(root: Path) -> dict[str, int]:
    """Lines by room and folder, as `CEILINGS` has them."""
    package = root / "src" / PACKAGE
    rooms = [folder.name for folder in package.iterdir() if any(folder.glob("*.py"))]
    counts = {room: _lines(package / room, PYTHON) for room in sorted(rooms, key=_order(root).__getitem__)}
    counts[PACKAGE] = sum(len(file.read_text().splitlines()) for file in package.glob("*.py"))
    counts["JavaScript, templates, C"] = _lines(package, OTHER)
    counts["tests"] = _lines(root / "tests", (*PYTHON, "*.js"))
    counts[", ".join(PROGRAMS)] = sum(_lines(root / folder, PYTHON) for folder in PROGRAMS)
    return counts


def _lines(folder: Path, patterns: Iterable[str]) -> int:
    files = (file for pattern in patterns for file in folder.rglob(pattern) if "built" not in file.parts)
    return sum(len(file.read_text().splitlines()) for file in files)


def _order(root: Path) -> Mapping[str, int]:
    """Places of the rooms in the order that import-linter holds; a room that it does not name is the last."""
    contracts = tomllib.loads((root / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    layers = next(contract["layers"] for contract in contracts if contract["type"] == "layers")
    rooms = [room.strip() for layer in reversed(layers) for room in layer.split("|")]
    return defaultdict(lambda: len(rooms), {room: place for place, room in enumerate(rooms)})


def measure(root: Path) -> dict[str, Any]:
    """All figures of a checkout."""
    package = root / "src" / PACKAGE
    modules = []
    for file in sorted(package.rglob("*.py")):
        text = file.read_text()
        modules.append(Module(file.relative_to(package).as_posix(), ast.parse(text), len(text.splitlines())))
    functions = [(module, function) for module in modules for function in _functions(module.tree)]
    lengths = [(f"{module.name}:{f.name}", (f.end_lineno or 0) - f.lineno + 1) for module, f in functions]
    arguments = [(f"{module.name}:{f.name}", _arguments(f)) for module, f in functions if module.room != "cli"]
    repeated, plain = _repeated(modules)
    return {
        "lines": count_lines(root),
        "lines of Python in src": sum(module.lines for module in modules),
        "files": len(modules),
        "functions": len(functions),
        "function length: median, p90, max": _spread(lengths, 0.9),
        "file length: median, p90, max": _spread([(module.name, module.lines) for module in modules], 0.9),
        "arguments without the command line: median, p99, max": _spread(arguments, 0.99),
        "public docstrings": f"{_documented(modules):.1%}",
        "repeated lines": f"{repeated / plain:.2%}",
        "public names": len(_public_names(package)),
    }


def _functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def _arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    arguments = function.args
    names = [argument.arg for argument in (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs)]
    extra = (arguments.vararg is not None) + (arguments.kwarg is not None)
    return len(names) + extra - (names[:1] in (["self"], ["cls"]))


def _documented(modules: Sequence[Module]) -> float:
    """Share of public classes and functions, methods included, that have a docstring."""
    public = [
        node
        for module in modules
        for node in ast.walk(module.tree)
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) and not node.name.startswith("_")
    ]
    return sum(ast.get_docstring(node) is not None for node in public) / len(public)


def _public_names(package: Path) -> set[str]:
    """Names that the package exports: the imports of its stub, or `__all__`."""
    stub = package / "__init__.pyi"
    if stub.exists():
        imports = (node for node in ast.walk(ast.parse(stub.read_text())) if isinstance(node, ast.ImportFrom))
        return {alias.asname or alias.name for node in imports for alias in node.names}
    for node in ast.parse((package / "__init__.py").read_text()).body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return set(ast.literal_eval(node.value))
    return set()


def _repeated(modules: Sequence[Module]) -> tuple[int, int]:
    """Lines within repetitions, and all lines of code."""
    places: dict[tuple[str, ...], list[tuple[str, int]]] = defaultdict(list)
    total = 0
    for module in modules:
        lines = _plain(module.tree)
        total += len(lines)
        for i in range(len(lines) - REPEATED + 1):
            places[tuple(lines[i : i + REPEATED])].append((module.name, i))
    repetitions = [run for run in places.values() if len(run) > 1]
    covered = {(name, i + j) for run in repetitions for name, i in run for j in range(REPEATED)}
    return len(covered), total


def _plain(tree: ast.Module) -> list[str]:
    """The code of a module without docstrings, imports and formatting, line by line."""
    copy = ast.parse(ast.unparse(tree))
    for node in ast.walk(copy):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [child for child in body if not _is_silent(child)] or [ast.Pass()]  # type: ignore[attr-defined]
    return [line.strip() for line in ast.unparse(copy).splitlines() if line.strip()]


def _is_silent(node: ast.AST) -> bool:
    return isinstance(node, ast.Import | ast.ImportFrom) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    )


def _spread(values: Sequence[tuple[str, int]], share: float) -> str:
    """Median, a quantile, and the largest with its name."""
    numbers = sorted(value for _, value in values)
    name, largest = max(values, key=lambda value: value[1])
    return f"{numbers[len(numbers) // 2]}, {numbers[int(share * (len(numbers) - 1))]}, {largest} (`{name}`)"


def table(columns: Mapping[str, Mapping[str, Any]]) -> str:
    """Figures of several checkouts in Markdown, a column each."""
    rows: dict[str, list[str]] = {}
    for place in dict.fromkeys(place for figures in columns.values() for place in figures["lines"]):
        rows[f"lines of `{place}`"] = [f"{figures['lines'].get(place, 0):,}" for figures in columns.values()]
    for name in next(iter(columns.values())):
        if name != "lines":
            rows[name] = [f"{f[name]:,}" if isinstance(f[name], int) else f[name] for f in columns.values()]
    head = ["| |" + "".join(f" {name} |" for name in columns), "|---" * (len(columns) + 1) + "|"]
    return "\n".join([*head, *(f"| {name} | {' | '.join(values)} |" for name, values in rows.items())]) + "\n"


def write(page: Path, text: str) -> None:
    """Put a text between the marks of a page."""
    before, _, rest = page.read_text().partition(MARKS[0])
    _, mark, after = rest.partition(MARKS[1])
    if not mark:
        raise SystemExit(f"{page} has no marks: put the lines {MARKS[0].strip()} and {MARKS[1].strip()} into it.")
    page.write_text(before + MARKS[0] + text + MARKS[1] + after)


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("checkouts", type=Path, nargs="*", default=[ROOT], metavar="CHECKOUT", help="default: this one")
    parser.add_argument("--table", action="store_true", help="print a table in Markdown instead of JSON")
    parser.add_argument("--write", type=Path, metavar="PAGE", help="put the table into this page")
    options = parser.parse_args()
    names = ["before", "after"] if len(options.checkouts) == 2 else [c.resolve().name for c in options.checkouts]
    columns = {name: measure(checkout) for name, checkout in zip(names, options.checkouts, strict=True)}
    if options.write:
        write(options.write, table(columns))
    else:
        print(table(columns) if options.table else json.dumps(columns, indent=1))


if __name__ == "__main__":
    main()
