"""How the code reads, in numbers: `python benchmarks/code_figures.py CHECKOUT... [--json | --table]`.

Lines by room: code; docstrings (every text that stands as a statement); templates, TOML files and scripts that the
package carries. Blank lines and lines of comment alone are in the total only. Modules of earlier versions count for the
room that they became a part of. Lines of the tests, the tools and the benchmarks stand beside them.

Arguments per function (without self and cls; neither the public names, those of `__all__` in `adaptrack` and its
packages, nor the command line), lengths of functions (docstrings and nested functions included) and of files, imports
between modules (fan-out), imports against the order of the rooms, and repeated code: lines in runs of at least five
that occur more than once, compared after the removal of comments, docstrings, imports and formatting; lines that a
process imports to call a kernel; places in vectors that are counted by hand, by file of the kernels; modules that hold
a registry (make a `Registry`, or have a function `register_...`). From the syntax tree alone: nothing is imported.
`--table` prints the figures of several checkouts side by side, in Markdown.
"""

from __future__ import annotations

import argparse
import ast
import json
from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

PACKAGE = "adaptrack"
ROOMS = (
    "base", "core", "cars", "road", "scenario", "control", "drive", "analysis", "identification", "tuning",
    "comparison", "paper", "export", "gym", "results", "cli",
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
    **dict.fromkeys(("signal_statistics", "prediction"), "drive"),
    **dict.fromkeys(("linearisation", "stability", "certify", "feasibility"), "analysis"),
    "runs": "tuning", "evaluate": "comparison", "manoeuvres": "comparison",
    **dict.fromkeys(("dataset", "learning", "adaptation", "adapt", "studies"), "paper"),
    **dict.fromkeys(("process_plant", "commonroad_plants"), "peers"), "report": "results", "__main__": "cli",
    **dict.fromkeys(("benchmark", "fuzz", "qp_corpus"), "tools"),
}  # fmt: skip
"""Rooms and modules of earlier versions by the room that they became a part of; tools left the package."""
CARRIED = (".toml", ".j2", ".html", ".css", ".js", ".csv")
"""Endings of the files beside Python that people write and the package carries."""
BESIDE = ("tests", "tools", "benchmarks", "examples", "experiments")
"""Folders of Python beside the package."""
KERNELS = (f"{PACKAGE}.core.", f"{PACKAGE}.kernels.", f"{PACKAGE}.peers.kernels.")
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
    code: int
    """lines that are neither blank nor comment nor docstring"""
    docstrings: int


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
        "lines by room": lines_by_room(package, modules),
        "lines of the repository": _beside(package),
        "rooms": len({_room(name) for name, module in modules.items() if name.count(".") == 1 and module.is_package}),
        "modules that hold a registry": sorted(_registries(modules)),
        "loose modules": sorted(name for name in modules if name.count(".") == 1 and not modules[name].is_package),
        "import circles between files": [" ".join(sorted(each)) for each in _circles(imports)],
        "imports inside functions": sum(_imports_inside(module.tree) for module in modules.values()),
        "public names": len(_public(modules[PACKAGE].tree)),
        "class names used twice": _names_used_twice(modules),
        "lines imported to call a kernel": sum(modules[name].lines for name in CALLING if name in modules),
        "counted places in vectors": [f"{name}: {n}" for name, n in _counted_places(modules)],
    }


def lines_by_room(package: Path, modules: Mapping[str, Module]) -> dict[str, dict[str, int]]:
    """Lines of code, of docstrings, of templates, TOML and scripts, and all of the Python, by room."""
    found: dict[str, dict[str, int]] = defaultdict(
        lambda: dict.fromkeys(("code", "docstrings", "carried", "python"), 0)
    )
    for name, module in modules.items():
        room = found[_present_room(name)]
        room["code"] += module.code
        room["docstrings"] += module.docstrings
        room["python"] += module.lines
    for file in package.rglob("*"):
        if file.suffix in CARRIED and "built" not in file.parts:
            inside = file.relative_to(package).parts
            room = found[FORMERLY.get(inside[0], inside[0])]
            room["carried"] += len(file.read_text().splitlines())
    order = {name: i for i, name in enumerate(ROOMS)}
    return dict(sorted(found.items(), key=lambda each: order.get(each[0], len(order))))


def _beside(package: Path) -> dict[str, int]:
    """Lines of Python beside the package, by folder; of no folder where the package lies alone."""
    root = package.parents[1]
    folders = [root / name for name in BESIDE if (root / "src").is_dir() and (root / name).is_dir()]
    return {each.name: sum(len(file.read_text().splitlines()) for file in each.rglob("*.py")) for each in folders}


def _registries(modules: Mapping[str, Module]) -> Iterator[str]:
    """Modules that make a `Registry` at their top, or have a public function `register_...`."""
    for name, module in modules.items():
        made = (getattr(node, "value", None) for node in module.tree.body)
        registers = any(
            isinstance(node, ast.FunctionDef) and node.name.startswith("register_") for node in module.tree.body
        )
        if registers or any(isinstance(call, ast.Call) and _called(call) == "Registry" for call in made):
            yield name


def _called(call: ast.Call) -> str:
    function = call.func.value if isinstance(call.func, ast.Subscript) else call.func
    return function.id if isinstance(function, ast.Name) else getattr(function, "attr", "")


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
    tree, lines = ast.parse(text), text.splitlines()
    texts = {
        number
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
        for number in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    code = sum(
        bool(line.strip()) and not line.lstrip().startswith("#")
        for number, line in enumerate(lines, 1)
        if number not in texts
    )
    return Module(tree, len(lines), file.name == "__init__.py", code, len(texts))


def _room(module: str) -> str:
    parts = module.split(".")
    return parts[1] if len(parts) > 1 else ""


def _present_room(module: str) -> str:
    """The room that a module, also one of an earlier version, is a part of; the package's own file by its name."""
    room = _room(module)
    return FORMERLY.get(room, room) or PACKAGE


def _rank(module: str) -> int:
    room = _present_room(module)
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
        if name == "lines by room":
            print(f"{'lines by room':36} code, docstrings, templates + TOML + scripts, all Python")
            for room, lines in value.items():
                print(f"    {room:32} {', '.join(f'{n:,}' for n in lines.values())}")
        elif isinstance(value, dict):
            shown = (
                f"{key} {entry:.3g}" if isinstance(entry, float) else f"{key} {entry}" for key, entry in value.items()
            )
            print(f"{name:36}", ", ".join(shown))
        elif isinstance(value, int) and (" " in name or name == "rooms"):
            print(f"{name:36} {value}")
        elif isinstance(value, list):
            print("\n    ".join([f"{name:36} {len(value)}", *value]))


def table(columns: Mapping[str, dict[str, Any]]) -> str:
    """Figures of several checkouts, a column each, in Markdown."""
    rows: list[tuple[str, list[str]]] = []

    def add(what: str, value: Callable[[dict[str, Any]], Any]) -> None:
        shown = [value(found) for found in columns.values()]
        rows.append((what, [f"{each:,}" if isinstance(each, int) else str(each) for each in shown]))

    def room(found: dict[str, Any], name: str) -> str:
        lines = found["lines by room"].get(name)
        return " + ".join(f"{lines[key]:,}" for key in ("code", "docstrings", "carried")) if lines else "-"

    def total(found: dict[str, Any]) -> str:
        keys = ("code", "docstrings", "carried")
        return " + ".join(f"{sum(lines[key] for lines in found['lines by room'].values()):,}" for key in keys)

    def largest(key: str) -> Callable[[dict[str, Any]], str]:
        return lambda found: f"{found[key]['max']} (`{found[key]['where'].removeprefix(PACKAGE + '.')}`)"

    add("files, functions, lines", lambda found: "{modules:,}, {functions:,}, {lines:,}".format(**found))
    add("lines: code + docstrings + templates, TOML, scripts", total)
    for name in dict.fromkeys(name for found in columns.values() for name in found["lines by room"]):
        add(f"&emsp;`{name}`", lambda found, name=name: room(found, name))
    for folder in BESIDE[:3]:
        add(f"lines of {folder}", lambda found, folder=folder: found["lines of the repository"].get(folder, "-"))
    add("packages at the top, loose modules", lambda found: f"{found['rooms']}, {len(found['loose modules'])}")
    add("import circles between files; files in the largest", lambda found: _of_circles(found))
    for key in ("imports against the order of rooms", "class names used twice", "modules that hold a registry"):
        add(key, lambda found, key=key: len(found[key]))
    for key in ("imports inside functions", "public names"):
        add(key, lambda found, key=key: found[key])
    add("function length, p90", lambda found: found["function lines"]["p90"])
    add("function length, largest", largest("function lines"))
    add("arguments per function, p99", lambda found: found["arguments"]["p99"])
    add("arguments per function, largest", largest("arguments"))
    add("functions with more than 8 arguments", lambda found: len(found["more than 8 arguments"]))
    add("file length, p90", lambda found: found["file lines"]["p90"])
    add("file length, largest", largest("file lines"))
    add("import fan-out, p90", lambda found: found["import fan-out"]["p90"])
    add("repeated lines", lambda found: "{lines:,} ({share:.2%})".format(**found["repeated lines"]))
    head = ["| |" + "".join(f" {name} |" for name in columns), "|---" * (len(columns) + 1) + "|"]
    return "\n".join([*head, *(f"| {what} | {' | '.join(values)} |" for what, values in rows)])


def _of_circles(found: dict[str, Any]) -> str:
    circles = found["import circles between files"]
    return f"{len(circles)}; {max((len(each.split()) for each in circles), default=0)}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("source", type=Path, nargs="+", help="a checkout, or the folder of its package")
    parser.add_argument("--json", action="store_true", dest="as_json", help="print JSON")
    parser.add_argument("--table", action="store_true", help="print a table in Markdown, a column for each checkout")
    chosen = parser.parse_args()
    figures = {}
    for source in chosen.source:
        inner = source / "src" / PACKAGE
        figures[source.absolute().name] = measure(inner if inner.is_dir() else source)
    if chosen.table:
        print(table(figures))
    elif chosen.as_json:
        print(json.dumps(figures if len(figures) > 1 else next(iter(figures.values())), indent=1))
    else:
        for name, found in figures.items():
            print(*([f"== {name}"] if len(figures) > 1 else []), sep="\n", end="\n" if len(figures) > 1 else "")
            _print(found)


if __name__ == "__main__":
    main()
