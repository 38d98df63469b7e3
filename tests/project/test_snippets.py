"""Every command and every Python snippet of the README and the pages runs, or, where that takes long, fits the program.

A page is run from top to bottom in a folder of its own: its TOML and Python blocks that begin with a file's name become
that file, its other Python blocks share one namespace, its console lines that begin with `$` are commands. Numbers that
a page says are printed are printed, within 5 %: in the comment behind a `print`, in a block of text below a command
(`OUTPUT_SHOWN`), in a table below the line `<!-- printed -->`. What scatters more is given as a range, `0.2 to 0.4`.
"""

import ast
import re
import shlex
import sys
from pathlib import Path

import pytest

from adaptrack import cli
from adaptrack.cars import plant
from adaptrack.control.controllers import registry as controllers

PROJECT = Path(__file__).resolve().parents[2]
DOCS = PROJECT / "docs"
PAGES = [PROJECT / "README.md", *sorted(DOCS.glob("*.md")), *sorted(DOCS.glob("gallery/*.md"))]

LONG_COMMANDS = {
    "compare": "1 minute to hours", "certify": "5 s, and more with several inputs", "check-loop": "needs a log",
    "car my-car.toml --tir": "needs a tyre file",
    "drive country --vehicle my-car.toml": "needs a car that is identified or tuned",
    "drive mountain --road-seed 2 --vehicle midsize-sedan --tuning": "needs a tuning that is found",
    "drive road.csv --vehicle my-car.toml --controller informed": "needs a tuning that is found",
    "identify": "needs a log", "paper adapt": "39 minutes", "paper campaign": "5 minutes",
    "paper evaluate": "10 minutes", "paper reproduce": "2 minutes", "paper train": "30 s", "shadow": "needs a log",
    "tune": "1 to 20 minutes",
}  # fmt: skip
"""Commands that are parsed only, by how they begin, with the time that they take on two cores."""

LONG_SNIPPETS = {
    ("schedulers.md", "run_campaign("): "5 minutes", ("certify.md", "loop_map("): "10 s",
    ("identify.md", 'at.identify("drive.csv"'): "10 s, and needs a log",
    ("extending.md", "commonroad_plant("): "needs commonroad-vehicle-models", ("schedulers.md", "train(data"): "20 s",
    ("identify.md", "at.shadow("): "needs logs",
}  # fmt: skip
"""Python blocks of which only the imports are run, by page and something that they hold."""

NEEDED = {
    "gymnasium.md": ("gymnasium", "needs Gymnasium: pip install 'adaptrack[gym]'"),
    "fmu.md": ("fmpy", "needs FMPy: pip install fmpy"),
}
"""Pages that are skipped without a package of an extra."""

OTHERS = ("dask", "python -m pip", "python -m tools.fuzz", ".ci/run", "source .venv/bin/activate")
"""Commands of other programs: not run."""


OUTPUT_SHOWN = ("tutorial.md", "command-line.md", "speed.md")
"""Pages that show below a command what it prints: every line of it is among what is printed."""

FILE = re.compile(r"# ([\w-]+\.(?:toml|py))(?=:|$)", re.MULTILINE)
"""The first line of a block that becomes a file."""
NEAR = 0.05
"""How far a number on a page may be from the printed one, relative; half of its last digit is always allowed."""
PRINTED = "<!-- printed -->"
"""Above a table whose numbers are printed by the command before it, in lines that begin as its rows do."""
NUMBER = r"(?<![\w^.])[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?(?![\w^]|\.\d)"


def blocks(page):
    """(language, text) of each fenced block of a page, in order; of a table below `PRINTED`, ("printed", its rows)."""
    matches = re.findall(
        rf"^```(\w+)\n(.*?)^```$|^{PRINTED}\n\n((?:\|[^\n]*\n)+)", page.read_text(), re.MULTILINE | re.DOTALL
    )
    return [("printed", table) if table else (language, text) for language, text, table in matches]


# -- numbers ----------------------------------------------------------------------------------------------------------
def ranges(text):
    """(low, high) of each number of a page: around it, or, of `0.2 to 0.4`, from one to the other."""
    result = []
    for first, other in re.findall(rf"({NUMBER})(?: to ({NUMBER}))?", text):
        low, high = (float(end.replace(",", "")) for end in (first, other or first))
        digits = len(first.partition("e")[0].partition(".")[2])
        slack = 0.0 if other else max(NEAR * abs(low), 0.5 * 10.0**-digits if "e" not in first else 0.0)
        result.append((low - slack, high + slack))
    return result


def numbers(text):
    """The numbers of what is printed."""
    return [float(number.replace(",", "")) for number in re.findall(NUMBER, text)]


def agree(comment, printed):
    """Whether the numbers of a page are the first of those printed, one by one."""
    expected, values = ranges(comment), numbers(printed)
    return len(values) >= len(expected) and all(
        low <= value <= high for (low, high), value in zip(expected, values, strict=False)
    )


def said_behind(source):
    """What a comment behind a `print` says is printed, by line: what comes before a semicolon."""
    comments = {}
    for number, line in enumerate(source.splitlines(), 1):
        _, mark, comment = line.partition("  # ")
        if mark and re.match(r"\s*(print\(.*\)|\))$", line[: line.index("  # ")]):
            comments[number] = comment.split(";")[0]
    return {line: text for line, text in comments.items() if ranges(text)}


def check_printed(source, printed):
    """Compare the comments behind each `print` with what it printed: {last line of the call: text}."""
    for line, comment in said_behind(source).items():
        assert agree(comment, printed.get(line, "")), f"{comment!r} is said, {printed.get(line)!r} is printed"


def check_table(table, printed):
    """Compare the rows of a table with the lines whose first or second word is theirs."""
    rows = [[part.strip(" `") for part in row.strip().strip("|").split("|")] for row in table.splitlines()[2:]]
    assert rows
    for name, *cells in rows:
        lines = [line.split() for line in printed.splitlines() if name in line.split()[:2]]
        printed_cells = [" ".join(line[line.index(name) + 1 :]) for line in lines]
        assert any(agree(" ".join(cells), row) for row in printed_cells), (name, cells, printed_cells)


def check_text(text, printed):
    """Compare lines that a page shows with those printed, `...` standing for any."""
    for line in text.splitlines():
        if line.strip() not in ("", "..."):
            similar = [candidate for candidate in printed.splitlines() if shape(candidate) == shape(line)]
            pattern = line.replace(" to ", " ")  # a range that is printed is two numbers
            assert any(agree(pattern, candidate) for candidate in similar), (
                f"{line!r} is shown; printed like it: {similar}"
            )


def test_numbers_of_a_page_are_compared_within_5_percent_or_half_a_digit_or_a_range():
    for comment, printed in (
        ("0.0134 m, 2,064", "0.0137 2,064 ok 7"),
        ("MSE 0.0010", "mse 0.001049"),
        ("0.2 to 0.4", "0.39"),
    ):
        assert agree(comment, printed)
    for comment, printed in (("0.0009", "0.00101"), ("0.2 to 0.4", "0.41"), ("1, 2", "1"), ("16 %", "8.5 %")):
        assert not agree(comment, printed), (comment, printed)
    source = "x = 2.0\nprint(x)  # 2 m; twice 1\nprint(\n    x\n)  # 2.5\n"
    assert said_behind(source) == {2: "2 m", 5: "2.5"}
    check_printed(source, {2: "2.0", 5: "2.5"})
    with pytest.raises(AssertionError, match="is said"):
        check_printed(source, {2: "2.0", 5: "2.0"})
    table = "| | RMS |\n|---|---|\n| `lqr` | 0.08 |\n| `stanley` | 0.1 |\n"
    check_table(table, "lqr  0.0815 0.3\nstanley 0.0977 0.3\n")
    with pytest.raises(AssertionError):
        check_table(table, "lqr  0.0815 0.3\nstanley 0.2 0.1\n")


# -- what is on a page ------------------------------------------------------------------------------------------------


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
    return command[1:] if command[0] == "adaptrack" else None


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
    elif command[0] == "python" and command[1:3] != ["-m", "pip"]:
        module = command[1] == "-m"
        script = PROJECT / (command[2].replace(".", "/") + ".py" if module else command[1])
        if module and command[2] == "adaptrack.core.build":
            script = PROJECT / "src/adaptrack/core/build/library.py"
        source = (script / "__main__.py" if script.is_dir() else script).read_text()
        assert all(f'"{option}"' in source for option in command[2:] if option.startswith("--"))
    else:
        assert " ".join(command).startswith(OTHERS)


def test_commands_stand_as_in_the_activated_environment():
    assert [page for page, command in ALL_COMMANDS if command[0].startswith(".venv/")] == []


@pytest.mark.parametrize(
    "line", ["drive sine --colour", "drive sine --seed sea", "drive", "tune paper --out x --runs few"]
)
def test_a_wrong_option_or_value_would_be_found(line):
    with pytest.raises(Exception):  # noqa: B017, PT011 - of whatever kind the parser raises
        parse(line.split())


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


# -- pages ------------------------------------------------------------------------------------------------------------
@pytest.fixture
def folder(tmp_path, monkeypatch):
    """An empty folder at hand; its modules, and what they register, are forgotten afterwards."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    for registry in (controllers._registry, plant._registry):
        monkeypatch.setattr(registry, "factories", dict(registry.factories))
    monkeypatch.setattr(controllers, "_descriptions", dict(controllers._descriptions))
    yield tmp_path
    for file in tmp_path.glob("*.py"):
        sys.modules.pop(file.stem, None)


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_page_runs_from_top_to_bottom(page, folder, monkeypatch, capsys):
    if page.name in NEEDED:
        module, reason = NEEDED[page.name]
        pytest.importorskip(module, reason=reason)
    given_files(page, folder)
    namespace = {"__name__": "snippet"}
    printed = ""
    for language, text in blocks(page):
        if name := FILE.match(text):
            Path(name[1]).write_text(text)
        elif language == "python":
            run_snippet(page.name, text, namespace)
        elif language == "console":
            printed = "".join(run_command(arguments_of(command), monkeypatch, capsys) for command in commands(text))
        elif language == "text" and page.name in OUTPUT_SHOWN and printed:
            check_text(text, printed)
        elif language == "printed" and printed:
            check_table(text, printed)


def shape(line):
    """A line of an output without its numbers."""
    return re.sub(r"\s*[\d.,]*\d", " #", line).strip()


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
    ends = {line: call.end_lineno for call in ast.walk(tree) if isinstance(call, ast.Call)
            for line in range(call.lineno, call.end_lineno + 1) if getattr(call.func, "id", "") == "print"}  # fmt: skip
    printed = {}

    def remember(*values, **options):
        line = sys._getframe(1).f_lineno
        end = ends.get(line, line)
        printed[end] = " ".join([*([printed[end]] if end in printed else []), *map(str, values)])

    namespace["print"] = remember
    exec(compile(tree, page, "exec"), namespace)
    if printed:
        check_printed(text, printed)


def run_command(arguments, monkeypatch, capsys):
    """What a command prints; nothing of one that is not run."""
    if arguments is None or is_long(arguments):
        return ""
    capsys.readouterr()
    monkeypatch.setattr(sys, "argv", ["adaptrack", *arguments])
    code = cli.main()
    output = capsys.readouterr()
    assert code == 0, output.err
    return output.out


@pytest.mark.compiled
@pytest.mark.parametrize(("page", "compared"), [
    ("extending.md", 'contenders = ["pure-pursuit"]\ncars = ["paper/bicycle"]\n'),
    ("gallery/controller.md", 'contenders = ["proportional"]\ncars = ["paper"]\n'),
])  # fmt: skip
def test_a_part_of_ones_own_from_a_page_is_simulated_driven_along_a_road_and_compared(
    page, compared, folder, monkeypatch, capsys
):
    page_blocks = blocks(DOCS / page)
    (module,) = (text for language, text in page_blocks if language == "python" and FILE.match(text))
    (folder / FILE.match(module)[1]).write_text(module)
    lines = [line for language, text in page_blocks if language == "console" for line in commands(text)]
    lines = [line for line in lines if "--plugin" in line]
    assert [line[1] for line in lines] == ["drive", "drive", "compare"]
    for line in lines[:2]:
        assert run_command(arguments_of(line), monkeypatch, capsys)
    (folder / "small.toml").write_text(
        f'{compared}profiles = ["road"]\ntraining = ["country:2"]\nroads = ["country:1"]\nlength = 120.0\n'
        "training_length = 110.0\nseeds = [0]\nbudget = 0\nentry_speeds = false\n"
    )
    plugin = lines[2][lines[2].index("--plugin") + 1]
    arguments = ["compare", "--config", "small.toml", "--plugin", plugin, "--out", "compared"]
    monkeypatch.setattr(sys, "argv", ["adaptrack", *arguments])
    assert cli.main() == 0
    assert "; 0 of 1 runs failed." in capsys.readouterr().out


def test_what_is_left_out_is_on_a_page():
    run = [" ".join(arguments) for _, command in ALL_COMMANDS if (arguments := arguments_of(command)) is not None]
    assert not [beginning for beginning in LONG_COMMANDS if not any(line.startswith(beginning) for line in run)]
    for name, part in LONG_SNIPPETS:
        page = next(page for page in PAGES if page.name == name)
        assert any(language == "python" and part in text for language, text in blocks(page)), (name, part)
