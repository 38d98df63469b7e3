"""Names and docstrings are read once: the counts of vague ones may only fall."""

from __future__ import annotations

import ast
import re
from collections import defaultdict
from collections.abc import Iterator

VAGUE = set(
    """each found own given made known said kept what whole wanted how here away apart usual done taken held others
    another which about now more less rest far driven looked judged shown named told asked seen tried one two good bad
    wrong same so many much thing things who whose wide alike beside meant left_out""".split()  # noqa: SIM905
)
BEGINNINGS = {"of", "in", "by", "among", "beside", "beyond", "behind", "around", "so", "how", "what", "which", "who"}
ALONE = VAGUE | {"is", "as", "to", "from", "with", "has", "at", "on", "by", "of", "in", "not", "again", "instead"}
TELEGRAM = re.compile(r"(The same\b|What\b|Whether it\b|Of [a-z]|Likewise|likewise|the same\b|what\b)")
PRESCRIBED = {"PARAMETERS", "MEMORY", "Memory", "Parameters", "Tuning", "Row", "NAME", "Array"}
"""Names that a contract prescribes in each module."""
CEILINGS = {"names": 102, "functions": 6, "docstrings": 1, "shared": 14}
"""Today's counts. Lower them when they fall."""


def count_names(nodes: list[ast.AST]) -> Iterator[str]:
    """Variables and arguments called by a participle, pronoun or adverb alone."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.FunctionDef) and not re.fullmatch(r"__\w+__", node.name):
            yield from (a.arg for a in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs))


def count_functions(nodes: list[ast.AST]) -> Iterator[str]:
    """Functions whose name begins with a preposition or is a vague word alone."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef) and not re.fullmatch(r"__\w+__", node.name):
            parts = node.name.strip("_").split("_")
            method = bool(node.args.args) and node.args.args[0].arg in ("self", "cls", "kind")
            public = method and parts[0] in ("at", "along", "between", "of", "within")
            if (parts[0] in BEGINNINGS and len(parts) > 1) or (len(parts) == 1 and parts[0] in ALONE and not public):
                yield node.name


def count_docstrings(nodes: list[ast.AST]) -> Iterator[str]:
    """Docstrings whose first line does not say what the thing is."""
    for node in nodes:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            line = (ast.get_docstring(node) or "").split("\n\n")[0]
            if line and (TELEGRAM.match(line) or len(line.split()) < 2):
                yield line


def public_names(tree: ast.Module) -> set[str]:
    """Upper-case constants, records and classes of a module."""
    names: set[str] = set()
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        names |= {n.id for target in targets for n in ast.walk(target) if isinstance(n, ast.Name)}
        names |= {node.name} if isinstance(node, ast.ClassDef) else set()
    return {name for name in names if name[0].isupper() and name not in PRESCRIBED}


def test_vague_names_and_docstrings_become_fewer(project):
    counts, homes = dict.fromkeys(CEILINGS, 0), defaultdict(set)
    for folder in ("src", "tests"):
        for path in (project / folder).rglob("*.py"):
            tree = ast.parse(path.read_text())
            nodes = list(ast.walk(tree))
            counts["names"] += sum(name.strip("_") in VAGUE for name in count_names(nodes))
            if folder == "src":
                counts["functions"] += len(list(count_functions(nodes)))
                counts["docstrings"] += len(list(count_docstrings(nodes)))
                for name in public_names(tree):
                    homes[name].add(path)
    counts["shared"] = sum(len(paths) > 1 for paths in homes.values())
    assert all(counts[kind] <= ceiling for kind, ceiling in CEILINGS.items()), counts
