"""How the code reads, in numbers: `python benchmarks/code_figures.py CHECKOUT [--json]`.

Arguments per function (without self and cls; neither the public names, those of `__all__` in `adaptrack` and its
packages, nor the command line), lengths of functions (docstrings and nested functions included) and of files, imports
between modules (fan-out), imports against the order of the rooms, and repeated code: lines in runs of at least five
that occur more than once, compared after the removal of comments, docstrings, imports and formatting; lines that a
process imports to call a kernel; places in vectors that are counted by hand, by file of the kernels. From the syntax
tree alone: nothing is imported.
"""

from __future__ import annotations

import argparse
import ast
import json
from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = "adaptrack"
ROOMS = (
    "base", "core", "cars", "road", "scenario", "control", "drive", "analysis", "identification", "tuning", "learning",
    "comparison", "studies", "results", "peers", "gym", "cli",
)  # fmt: skip
"""The rooms in the order of the data flow: a module imports from its own room and from those before it."""
FORMERLY = {
    **dict.fromkeys(("errors", "registry", "limits", "files", "toml_files", "arguments", "progress"), "base"),
    "kernels": "core",
    **dict.fromkeys(("vehicle", "tyre_file", "tyre_table", "tyre_fit", "known_within", "outline", "domain"), "cars"),
    **dict.fromkeys(("data_sheet", "plant"), "cars"),
    "profile": "scenario",
    **dict.fromkeys(("models", "estimation", "kalman", "qp", "controllers", "mpc"), "control"),
    **dict.fromkeys(("scheduling", "schedule", "tracker"), "control"),
    **dict.fromkeys(("world", "closed_loop", "simulate", "batch", "trajectory", "failure", "metrics"), "drive"),
    **dict.fromkeys(("path_metrics", "prediction"), "drive"),
    **dict.fromkeys(("linearisation", "stability", "certify", "feasibility"), "analysis"),
    **dict.fromkeys(("runs", "dataset"), "tuning"),
    "adaptation": "learning", "evaluate": "comparison", "manoeuvres": "comparison", "adapt": "studies",
    **dict.fromkeys(("process_plant", "commonroad_plants"), "peers"), "report": "results",
}  # fmt: skip
"""Rooms and modules of earlier versions by the room that they became a part of."""
KERNELS = (f"{PACKAGE}.core.", f"{PACKAGE}.kernels.")
CALLING = tuple(f"{PACKAGE}.{name}" for name in ("core.kernel", "core.library", "kernels.abi", "kernels.stored"))
"""What a process imports to call a kernel."""
COMMAND_LINE = ("cli", "benchmark", "__main__")
REPEATED = 5
"""Lines that make a repetition."""


class Module(NamedTuple):
    """A module of the package."""

    tree: ast.Module
    lines: int
    is_package: bool


def measure(package: Path) -> dict[str, Any]:
    """All figures of the package whose folder this is."""
    modules = {_name(package, file): _read(file) for file in sorted(package.rglob("*.py"))}
    functions = [(name, function) for name, module in modules.items() for function in _functions(module.tree)]
    public = set().union(*(_public(module.tree) for module in modules.values() if module.is_package))
    internal = [
        (f"{name}.{function.name}", _arguments(function))
        for name, function in functions
        if _room(name) not in COMMAND_LINE and not _is_public(function, public)
    ]
    lengths = [(f"{name}.{each.name}", (each.end_lineno or 0) - each.lineno + 1) for name, each in functions]
    imports = {name: _imports(name, modules) for name in modules if name != PACKAGE}
    repeated, lines = _repeated(modules)
    return {
        "modules": len(modules),
        "functions": len(functions),
        "lines": sum(module.lines for module in modules.values()),
        "arguments": _spread(internal, 0.99),
        "more than 8 arguments": [f"{name}: {n}" for name, n in sorted(internal, key=lambda each: -each[1]) if n > 8],
        "function lines": _spread(lengths, 0.9),
        "file lines": _spread([(name, module.lines) for name, module in modules.items()], 0.9),
        "import fan-out": _spread([(name, len(names)) for name, names in imports.items()], 0.9),
        "imports against the order of rooms": [
            f"{name} -> {other}"
            for name, names in imports.items()
            for other in sorted(names)
            if _rank(other) > _rank(name)
        ],
        "repeated lines": {"lines": repeated, "share": repeated / lines},
        "lines by room": [f"{name}: {n:,}" for name, n in _lines_by_room(modules)],
        "loose modules": sorted(name for name in modules if name.count(".") == 1 and not modules[name].is_package),
        "import circles between files": [" ".join(sorted(each)) for each in _circles(imports)],
        "imports inside functions": sum(_imports_inside(module.tree) for module in modules.values()),
        "public names": len(_public(modules[PACKAGE].tree)),
        "class names used twice": _names_used_twice(modules),
        "lines imported to call a kernel": sum(modules[name].lines for name in CALLING if name in modules),
        "counted places in vectors": [f"{name}: {n}" for name, n in _counted_places(modules)],
    }


def _lines_by_room(modules: Mapping[str, Module]) -> list[tuple[str, int]]:
    """The largest first."""
    found: dict[str, int] = defaultdict(int)
    for name, module in modules.items():
        found[_room(name) or PACKAGE] += module.lines
    return sorted(found.items(), key=lambda each: -each[1])


def _circles(imports: Mapping[str, set[str]]) -> list[set[str]]:
    """Files that import each other, directly or not: the strongly connected parts of more than one file."""
    reached: dict[str, set[str]] = {}
    for name in imports:
        seen: set[str] = set()
        waiting = [name]
        while waiting:
            for each in imports.get(waiting.pop(), set()) - seen:
                seen.add(each)
                waiting.append(each)
        reached[name] = seen
    circles: list[set[str]] = []
    for name in imports:
        circle = {each for each in reached[name] if name in reached.get(each, set())} | {name}
        if len(circle) > 1 and circle not in circles:
            circles.append(circle)
    return sorted(circles, key=len, reverse=True)


def _imports_inside(tree: ast.AST) -> int:
    """Imports of the package itself inside functions."""
    inside = {
        id(node)
        for function in _functions(tree)
        for node in ast.walk(function)
        if isinstance(node, ast.ImportFrom) and (node.level or (node.module or "").startswith(PACKAGE))
    }
    return len(inside)


def _names_used_twice(modules: Mapping[str, Module]) -> list[str]:
    """Names of public classes that stand for several."""
    places: dict[str, list[str]] = defaultdict(list)
    for name, module in modules.items():
        for node in module.tree.body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(name)
    return [f"{name}: {', '.join(each)}" for name, each in sorted(places.items()) if len(each) > 1]


def _counted_places(modules: Mapping[str, Module]) -> list[tuple[str, int]]:
    """By file of the kernels, how often a vector is read at a literal or at a place that is computed from one."""
    found = []
    for name, module in modules.items():
        kernels = name.startswith(KERNELS) and ".build" not in name
        read = [each for each in ast.walk(module.tree) if kernels and isinstance(each, ast.Subscript)]
        places = [
            each.slice for each in read if not (isinstance(each.value, ast.Attribute) and each.value.attr == "shape")
        ]
        literal = sum(isinstance(each, ast.Constant) and isinstance(each.value, int) for each in places)
        computed = sum(
            isinstance(each, ast.BinOp) and any(isinstance(part, ast.Constant) for part in ast.walk(each))
            for each in places
        )
        if literal + computed:
            found.append((name, literal + computed))
    return sorted(found, key=lambda each: -each[1])


def _name(package: Path, file: Path) -> str:
    parts = (PACKAGE, *file.relative_to(package).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _read(file: Path) -> Module:
    text = file.read_text()
    return Module(ast.parse(text), len(text.splitlines()), file.name == "__init__.py")


def _room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def _rank(module: str) -> int:
    room = _room(module)
    room = FORMERLY.get(room, room)
    return ROOMS.index(room) if room in ROOMS else len(ROOMS)


def _functions(tree: ast.AST) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree):
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
                child.owner = node.name if isinstance(node, ast.ClassDef) else ""  # type: ignore[union-attr]
                yield child


def _public(tree: ast.Module) -> set[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return set(ast.literal_eval(node.value))
    return set()


def _is_public(function: Any, public: set[str]) -> bool:
    """A public function, or what makes an object of a public class."""
    if function.owner:
        return function.owner in public and function.name == "__init__"
    return function.name in public


def _arguments(function: ast.FunctionDef | ast.AsyncFunctionDef) -> int:
    given = function.args
    names = [each.arg for each in (*given.posonlyargs, *given.args, *given.kwonlyargs)]
    extra = (given.vararg is not None) + (given.kwarg is not None)
    return len(names) + extra - (names[:1] in (["self"], ["cls"]))


def _imports(name: str, modules: Mapping[str, Module]) -> set[str]:
    """The modules of the package that a module imports anywhere, itself and the package's own file left out."""
    found = set()
    for node in ast.walk(modules[name].tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            above = name.split(".")[: len(name.split(".")) + modules[name].is_package - node.level]
            base = ".".join([*(above if node.level else []), *([node.module] if node.module else [])])
            found |= {f"{base}.{alias.name}" if f"{base}.{alias.name}" in modules else base for alias in node.names}
    return {each for each in found if each in modules and each not in (name, PACKAGE)}


def _repeated(modules: Mapping[str, Module]) -> tuple[int, int]:
    """Lines within repetitions, and all lines of code."""
    places: dict[tuple[str, ...], list[tuple[str, int]]] = defaultdict(list)
    total = 0
    for name, module in modules.items():
        lines = _plain(module.tree)
        total += len(lines)
        for i in range(len(lines) - REPEATED + 1):
            places[tuple(lines[i : i + REPEATED])].append((name, i))
    covered = {
        (module, i + j)
        for where in places.values()
        if len(where) > 1
        for module, i in where
        for j in range(REPEATED)
    }  # fmt: skip
    return len(covered), total


def _plain(tree: ast.Module) -> list[str]:
    """The code of a module without docstrings, imports and formatting, line by line."""
    copy = ast.parse(ast.unparse(tree))
    for node in ast.walk(copy):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            kept = [each for each in body if not _is_silent(each)]
            node.body = kept or [ast.Pass()]  # type: ignore[attr-defined]
    return [line.strip() for line in ast.unparse(copy).splitlines() if line.strip()]


def _is_silent(node: ast.AST) -> bool:
    return isinstance(node, ast.Import | ast.ImportFrom) or (
        isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    )


def _spread(values: Sequence[tuple[str, int]], share: float) -> dict[str, Any]:
    """Median, a quantile (the smallest value that so large a share does not exceed) and the largest with its name."""
    numbers = sorted(value for _, value in values)
    name, largest = max(values, key=lambda each: each[1])
    at = min(len(numbers) - 1, max(0, -(-int(share * 1000) * len(numbers) // 1000) - 1))
    return {"p50": numbers[len(numbers) // 2], f"p{100 * share:g}": numbers[at], "max": largest, "where": name}


def _print(found: dict[str, Any]) -> None:
    print(f"{found['modules']} modules, {found['functions']} functions, {found['lines']:,} lines")
    for name, value in found.items():
        if isinstance(value, dict):
            shown = (
                f"{key} {entry:.3g}" if isinstance(entry, float) else f"{key} {entry}" for key, entry in value.items()
            )
            print(f"{name:36}", ", ".join(shown))
        elif isinstance(value, int) and " " in name:
            print(f"{name:36} {value}")
        elif isinstance(value, list):
            print("\n    ".join([f"{name:36} {len(value)}", *value]))


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("source", type=Path, help="a checkout, or the folder of its package")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print JSON")
    chosen = parser.parse_args()
    inner = chosen.source / "src" / PACKAGE
    found = measure(inner if inner.is_dir() else chosen.source)
    print(json.dumps(found, indent=1)) if chosen.as_json else _print(found)


if __name__ == "__main__":
    main()
