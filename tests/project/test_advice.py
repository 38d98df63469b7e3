"""Messages of the package name only functions, options, commands, files and extras that exist."""

import ast
import importlib
import inspect
import re
import tomllib
from pathlib import Path

import pytest
import typer
from tests.project.test_docs import PROJECT, described

import adaptrack
from adaptrack.cli.app import app

SOURCE = Path(adaptrack.__file__).parent
PUBLIC = {name: getattr(importlib.import_module(module), name) for module, name in described()}
MEMBERS = {member for subject in PUBLIC.values() if inspect.isclass(subject) for member in dir(subject)}
NOTATION = {"cond", "d", "f", "y_ref", "var", "UINT64_C", "sizeof", "adaptrack_connect", "adaptrack_renew"}
"""Functions of mathematics, CSS and C, and those of an export."""
PROGRAM = typer.main.get_command(app)


def texts_of(tree):
    """(text, line, whether it is a docstring) of sentences and options; {} stands for a value that is filled in."""
    nodes = list(ast.walk(tree))
    inner = {id(part) for node in nodes if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    docstrings = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            text = "".join(part.value if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inner:
            text = node.value
        else:
            continue
        if " " in text or text.startswith("--"):
            yield text, node.lineno, id(node) in docstrings


def sentences():
    """(text, place, whether it is a docstring) of the package; the texts of core/ are sources of other programs."""
    for path in sorted(SOURCE.rglob("*.py")):
        place = path.relative_to(SOURCE)
        if place.parts[0] != "core":
            for text, line, docstring in texts_of(ast.parse(path.read_text())):
                yield text, f"{place}:{line}", docstring


def flaws_of(text, docstring=False):
    """The names in a sentence behind which there is nothing; a docstring may call functions that are not public."""
    calls = () if docstring else wrong_calls(text)
    return [*calls, *wrong_members(text), *wrong_commands(text), *wrong_files(text)]


def wrong_members(text):
    for owner, member in re.findall(r"\b([A-Z]\w+)\.([a-z_]\w*)", text):
        if owner in PUBLIC and member not in members_of(PUBLIC[owner]):
            yield f"{owner}.{member}"


def members_of(kind):
    fields = {name for base in kind.__mro__ for name in getattr(base, "__annotations__", {})}
    return fields.union(dir(kind), vars(kind).get("model_fields", ()))


def wrong_calls(text):
    for name, arguments in re.findall(r"(?<![\w.])([A-Za-z_][\w.]*)\((?!s\))([^()]*)", text):
        last = name.rpartition(".")[2]
        subject = PUBLIC.get(last)
        if subject is not None:
            names = inspect.signature(subject).parameters
            yield from (f"{name}({word}=)" for word in re.findall(r"\b(\w+)=", arguments) if word not in names)
        elif last not in MEMBERS | NOTATION:
            yield f"{name}()"


def options_of(command):
    """The options of a command, and of all that it groups."""
    options = {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}
    return options.union(*map(options_of, getattr(command, "commands", {}).values()))


OPTIONS = options_of(PROGRAM) | {"--help", "--ink", "--grid"}
"""Of the program and of `python -m adaptrack.core.build`; and variables of CSS."""


def wrong_commands(text):
    yield from (
        option for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*[a-z](?![\w{-])", text) if option not in OPTIONS
    )
    lines = re.findall(r"(?:`|: )adaptrack ([a-z][^`;:]*)", text)
    lines += [line for line in re.findall(r"`([a-z]+ [a-z -]+)`", text) if line.split()[0] in PROGRAM.commands]
    for line in lines:
        command, words = PROGRAM, line.split()
        while words and hasattr(command, "commands"):
            command, name = command.commands.get(words[0]), words.pop(0)
            if command is None:
                yield f"adaptrack {name}"
                break
        else:
            options = [word for word in words if word.startswith("--")]
            yield from (f"adaptrack ... {option}" for option in options if option not in options_of(command))


EXTRAS = tomllib.loads((PROJECT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
TARGETS = re.findall(r"^([a-z-]+):", (PROJECT / "Makefile").read_text(), re.MULTILINE)


def wrong_files(text):
    yield from (file for file in re.findall(r"\bdocs/[\w./-]+\w", text) if not (PROJECT / file).exists())
    yield from (extra for extra in re.findall(r"adaptrack\[(\w+)\]", text) if extra not in EXTRAS)
    yield from (target for target in re.findall(r"`make ([a-z-]+)`", text) if target not in TARGETS)


def test_every_name_in_a_sentence_of_the_package_exists():
    flaws = [(place, flaw) for text, place, docstring in sentences() for flaw in flaws_of(text, docstring)]
    assert not flaws, "\n".join(map(str, flaws))


@pytest.mark.parametrize(
    "text",
    [
        "jumps; Road.smoothed rounds it", "give smoothed(road)", "take MPC(car, prophile='road')", "add --lern",
        "run: adaptrack tun country", "see `paper campain`", "go on with `adaptrack drive --budget 3`",
        "see docs/lane.md", "pip install 'adaptrack[rods]'", "the state of `make targetts`",
    ],
)  # fmt: skip
def test_advice_that_does_not_exist_is_noticed(text):
    assert len(flaws_of(text)) == 1
