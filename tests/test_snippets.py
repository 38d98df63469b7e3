"""Every command and every Python snippet of the README and the pages runs, or, where that takes long, fits the program.

A page is run from top to bottom in a folder of its own: its TOML blocks that begin with a file's name become that file,
its Python blocks share one namespace, its console lines that begin with `$` are commands.
"""

import ast
import re
import shlex
import sys
from pathlib import Path

import pytest

from adaptrack import cli

PROJECT = Path(__file__).resolve().parent.parent
DOCS = PROJECT / "docs"
PAGES = [PROJECT / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("gallery/*.md"))]

LONG_COMMANDS = {
    "adapt": "39 minutes",
    "compare": "1 minute to hours",
    "certify": "5 s, and more with several inputs",
    "dataset describe paper-grid": "15 s",
    "dataset describe road-sobol": "15 s",
    "dataset describe campaigns": "needs a campaign that is done",
    "car my-car.toml --tir": "needs a tyre file",
    "drive country --vehicle my-car.toml": "needs a car that is identified or tuned",
    "drive mountain --road-seed 2 --vehicle midsize-sedan --tuning": "needs a tuning that is found",
    "drive road.csv --vehicle my-car.toml --controller informed": "needs a tuning that is found",
    "evaluate": "1 to 10 minutes",
    "identify": "needs a log",
    "reproduce": "2 minutes",
    "train": "30 s",
    "tune": "1 to 20 minutes",
}
"""Commands that are parsed only, by how they begin, with the time that they take on two cores."""

LONG_SNIPPETS = {
    ("adaptation.md", "made = improve("): "1 minute",
    ("adaptation.md", "compare("): "10 s, and needs the one before",
    ("campaign.md", "run_campaign("): "5 minutes",
    ("campaign.md", "data.landscape"): "20 s",
    ("certify.md", "loop_map("): "10 s",
    ("identify.md", "at.identify("): "10 s, and needs a log",
    ("mlp.md", 'train(load_dataset("paper-grid")'): "20 s",
    ("plants.md", "commonroad_plant("): "needs the extra `plants`",
    ("plants.md", "ProcessPlant("): "is run as an example",
    ("reproduce.md", "train(data"): "10 s",
    ("schedulers.md", "train(data"): "20 s",
}
"""Python blocks of which only the imports are run, by page and something that they hold."""

EXIT_CODES = {"manoeuvre sine-with-dwell": 1}
"""Of commands whose result is not a success, by how they begin: the plants have no stability control."""

NEEDED = {"gymnasium.md": ("gymnasium", "needs Gymnasium: pip install 'adaptrack[gym]'")}
"""Pages that are skipped without a package of an extra."""

OTHERS = ("dask", "python -m pip", "python -m tools.fuzz", ".ci/run")
"""Commands of other programs: not run."""


OUTPUT_SHOWN = ("tutorial.md",)
"""Pages that show below a command what it prints: every line of it is among what is printed, up to digits."""


def blocks(page):
    """(language, text) of each fenced block of a page, in order."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)


def commands(text):
    """The command lines of a console block, comments removed."""
    joined = re.sub(r"\\\n\s*", " ", text)
    return [shlex.split(line[1:], comments=True) for line in joined.splitlines() if line.startswith("$")]


ALL_COMMANDS = [
    (page.name, command)
    for page in PAGES
    for language, text in blocks(page)
    if language == "console"
    for command in commands(text)
]


def arguments_of(command):
    """What follows `adaptrack`, or None for another program."""
    return command[1:] if command[0] in ("adaptrack", ".venv/bin/adaptrack") else None


def is_long(arguments):
    return any(f"{' '.join(arguments)} ".startswith(f"{beginning} ") or " ".join(arguments).startswith(beginning + "/")
               for beginning in LONG_COMMANDS)  # fmt: skip


# -- commands ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("page", "command"), ALL_COMMANDS, ids=lambda value: " ".join(value) if isinstance(value, list) else value
)
def test_every_command_fits_the_program(page, command):
    arguments = arguments_of(command)
    if arguments is not None:
        parse(arguments)
    elif command[0] == "make":
        assert re.search(rf"^{command[1]}:", (PROJECT / "Makefile").read_text(), re.MULTILINE)
    elif command[0] == ".venv/bin/python":
        module = command[1] == "-m"
        script = PROJECT / (command[2].replace(".", "/") + ".py" if module else command[1])
        source = (script / "__main__.py" if script.is_dir() else script).read_text()
        assert all(f'"{option}"' in source for option in command[2:] if option.startswith("--"))
    else:
        assert " ".join(command).startswith(OTHERS)


def parse(arguments):
    """Parse a command line as the program does, without running it; wrong options and values raise."""
    import typer

    from adaptrack.cli.app import app

    group, context = typer.main.get_command(app), None
    while arguments and not arguments[0].startswith("-"):
        name, *arguments = arguments
        assert name in group.commands, f"no command {name!r}"
        group = group.commands[name]
        if not hasattr(group, "commands"):
            break
    if arguments != ["--help"]:
        context = group.make_context(group.name, list(arguments))
    return context


@pytest.mark.parametrize("page", PAGES[1:], ids=lambda page: page.name)
def test_no_command_of_this_program_stands_where_it_is_not_tested(page):
    hidden = [
        text for language, text in blocks(page) if language != "console" and re.search(r"^\$ .*adaptrack", text, re.M)
    ]
    assert not hidden


def test_a_wrong_option_or_value_would_be_found():
    for wrong in (
        ["simulate", "sine", "--colour"],
        ["simulate", "sine", "--seed", "sea"],
        ["drive"],
        ["tune", "--runs", "few"],
    ):
        with pytest.raises(Exception):  # noqa: B017, PT011 - of whatever kind the parser raises
            parse(wrong)


# -- pages ------------------------------------------------------------------------------------------------------------
@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_runs_from_top_to_bottom(page, tmp_path, monkeypatch, capsys):
    if page.name in NEEDED:
        module, reason = NEEDED[page.name]
        pytest.importorskip(module, reason=reason)
    monkeypatch.chdir(tmp_path)
    given_files(page, tmp_path)
    namespace = {"__name__": "snippet"}
    printed = ""
    for language, text in blocks(page):
        if language == "toml" and (name := re.match(r"# ([\w-]+\.toml)", text)):
            Path(name[1]).write_text(text)
        elif language == "python":
            run_snippet(page.name, text, namespace)
        elif language == "console":
            printed = "".join(run_command(arguments_of(command), monkeypatch, capsys) for command in commands(text))
        elif language == "text" and page.name in OUTPUT_SHOWN and printed:
            assert shape(text) - {"..."} <= shape(printed)


def shape(output):
    """The lines of an output with its numbers blotted out: their last digits are the machine's."""
    return {re.sub(r"\s*[\d.,]*\d", " #", line).strip() for line in output.splitlines()}


def given_files(page, folder):
    """Schedulers that a long command of the page would have saved, under the names that the page uses."""
    from adaptrack.control.scheduling import load_scheduler

    for name in ("nn.json", "anfis.json", "mine.json"):
        if name in page.read_text():
            load_scheduler("road-nn").save(folder / name)


def run_snippet(page, text, namespace):
    tree = ast.parse(text)
    if any(page == name and part in text for name, part in LONG_SNIPPETS):
        tree.body = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
    exec(compile(tree, page, "exec"), namespace)


def run_command(arguments, monkeypatch, capsys):
    """What a command prints; nothing of one that is not run."""
    if arguments is None or is_long(arguments):
        return ""
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["adaptrack", *arguments])
    code = cli.main()
    expected = next((code for beginning, code in EXIT_CODES.items() if " ".join(arguments).startswith(beginning)), 0)
    told = capsys.readouterr()
    assert code == expected, told.err
    return told.out


def test_what_is_left_out_is_on_a_page():
    run = [" ".join(arguments) for _, command in ALL_COMMANDS if (arguments := arguments_of(command)) is not None]
    assert not [beginning for beginning in LONG_COMMANDS if not any(line.startswith(beginning) for line in run)]
    for name, part in LONG_SNIPPETS:
        page = next(page for page in PAGES if page.name == name)
        assert any(language == "python" and part in text for language, text in blocks(page)), (name, part)
