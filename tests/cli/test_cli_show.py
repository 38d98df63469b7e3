"""Tables, numbers and progress of the command line."""

from __future__ import annotations

import json
import logging
import os
import pty
import subprocess
import sys
import time

import pytest

from adaptrack.base import progress
from adaptrack.base.progress import TrackedWork
from adaptrack.cli import paper, show
from adaptrack.cli.show import Column
from adaptrack.results import certificate, compare, drive
from adaptrack.results.console import written

NAMES = {
    "scenario": "triple-lane-change", "controller": "as-released", "scheduler": "best constant of conditions",
    "driving": "straight", "slot": "log10_ratio", "interval": "1.02-1.05", "moves": "laguerre 0.95", "result": "failed",
    "Np": 38.0, "Nc": 10.0,
}  # fmt: skip
FLAGS = {"guard", "preview"}


def typical(columns):
    """A row as it comes, no number of it short."""
    return {c.name: NAMES.get(c.name, False if c.name in FLAGS else 1.2345e-05 if "mse" in c.name else 0.9876543)
            for c in columns}  # fmt: skip


@pytest.mark.parametrize(
    "columns",
    [drive.DRIVE_COLUMNS, paper.QUALITY_COLUMNS, compare.RANKING_COLUMNS, certificate.CERTIFICATE_COLUMNS],
)
def test_tables_name_their_units_and_fit_80_columns(monkeypatch, capsys, columns):
    monkeypatch.setenv("COLUMNS", "80")
    row = typical(columns)
    show.table("A title", columns, [row, row])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    body = [line for line in lines if line.strip()]
    assert len(body) == 6  # title, two lines of titles and units, a rule, two rows: nothing is folded
    assert all(f"({column.unit})" in body[2] for column in columns if column.unit)
    for name in {row[column.name] for column in columns if isinstance(row[column.name], str)}:
        assert name in body[-1]


def test_columns_that_do_not_fit_stand_below_beside_the_names_and_no_number_is_cut(monkeypatch, capsys):
    monkeypatch.setenv("COLUMNS", "80")
    columns = [Column("name", "name"), *(Column(f"value{i}", f"value {i}", "m²/rad²") for i in range(14))]
    rows = [
        {"name": f"production-paper-recipe-{i}"} | {f"value{k}": 1000.0 + 20 * i + k for k in range(14)}
        for i in range(2)
    ]
    show.table("A title", columns, rows)
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80
    assert all(f"value {k}" in out and f"{1000 + k}" in out and f"{1020 + k}" in out for k in range(14))
    assert out.count("production-paper-recipe-1") == out.count("name") > 1
    assert out.startswith("A title\n")


@pytest.mark.parametrize("name", ["[/red]", "[bold]x", ":car:", r"$\frac{$", "a\x1b[31mb", "nul\0", "\udc80", "naïve"])
def test_names_are_data_in_every_table(capsys, name):
    show.table(name, [Column("name", "name")], [{"name": name}])
    show.say(name)
    show.say_failed(name)
    out = capsys.readouterr().out
    assert out.count(show.printable(name)) == 4
    assert "\x1b" not in out
    assert "\0" not in out


@pytest.mark.parametrize(("environment", "red"), [
    ({"FORCE_COLOR": "1", "TERM": "xterm-256color"}, True),
    ({"FORCE_COLOR": "1", "TERM": "xterm-256color", "NO_COLOR": "1"}, False),
    ({"FORCE_COLOR": "1", "TERM": "dumb"}, False),
    ({"TERM": "xterm-256color"}, False),  # no terminal
])  # fmt: skip
def test_failed_is_red_only_where_colour_is_on(monkeypatch, capsys, environment, red):
    for name in ("FORCE_COLOR", "NO_COLOR", "TTY_COMPATIBLE", "COLORTERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in environment.items():
        monkeypatch.setenv(name, value)
    show.say_failed("step, standard: at 1.20 s the vehicle spun.")
    word = "\x1b[1;31mFAILED\x1b[0m" if red else "FAILED"
    assert capsys.readouterr().out == f"{word} step, standard: at 1.20 s the vehicle spun.\n"


def test_numbers_and_nothing_are_written_short():
    assert [written(v, Column("a", "a")) for v in (None, 0.123456, 12, True, "x")] == ["-", "0.1235", "12", "True", "x"]
    assert [written(v, Column("a", "a", "%", "percent")) for v in (None, 0.5)] == ["-", "50"]
    assert [written(v, Column("a", "a", "", "whole")) for v in (None, 12345.6)] == ["-", "12,346"]


def test_json_is_strict(capsys):
    show.say_json({"a": 1.5})
    assert json.loads(capsys.readouterr().out) == {"a": 1.5}
    with pytest.raises(ValueError, match="JSON"):
        show.say_json({"a": float("nan")})


# -- progress ---------------------------------------------------------------------------------------------------------
def test_without_a_terminal_progress_is_a_line_now_and_then_with_the_time_left(monkeypatch, capsys):
    monkeypatch.setattr("adaptrack.base.progress.FIRST_PAUSE", 0.05)
    monkeypatch.setattr("adaptrack.base.progress.NEXT_PAUSE", 0.05)
    with show.progress("work") as advance:
        time.sleep(0.12)
        advance("half", 1, 2)
        time.sleep(0.12)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert lines[0] == "adaptrack: work: 0 s so far"
    assert lines[-1].startswith("adaptrack: work, half: 50 %, about")
    assert 2 <= len(lines) <= 6


def test_what_is_done_in_two_seconds_says_nothing_and_the_logger_is_left_alone(capsys):
    with show.progress("work") as advance:
        advance("work", 1, 1)
    assert capsys.readouterr() == ("", "")
    assert not logging.getLogger("adaptrack").handlers


def test_several_pieces_of_work_count_as_one():
    state = TrackedWork("drive", total=4)
    state.update("first", 5, 10)
    assert state.share == 0.125
    state.update("first", 10, 10)
    state.update("second", 0, 10)
    assert state.share == 0.25


def test_a_stage_has_its_own_time_left(monkeypatch):
    clock = [0.0]
    monkeypatch.setattr(progress.time, "monotonic", lambda: clock[0])
    state = TrackedWork("one", total=1)
    clock[0] = 100.0
    state.update("two", 0, 4)
    clock[0] = 110.0
    state.update("two", 1, 4)
    assert state.time_left() == pytest.approx(30.0)
    clock[0] = 115.0
    assert state.time_left() == pytest.approx(25.0)  # it counts down between two reports
    clock[0] = 120.0
    state.update("two, under another name", 2, 4)
    assert state.time_left() == pytest.approx(20.0)
    clock[0] = 141.0
    assert state.time_left() is None  # longer than expected: nobody knows


@pytest.mark.parametrize(("seconds", "text"), [(0.2, "1 s"), (89.0, "89 s"), (600.0, "10 min"), (9000.0, "2.5 h")])
def test_a_time_is_said_in_its_unit(seconds, text):
    assert progress.duration(seconds) == text


ON_A_TERMINAL = """
import logging, time
from adaptrack.cli import show
with show.progress("work [/red]") as advance:
    time.sleep(1.0)
    advance("work [/red]", 1, 2)
    time.sleep(0.3)
    logging.getLogger("adaptrack").warning("adaptrack: compiling kernels")
    time.sleep(0.3)
print("done")
"""


def test_a_log_record_does_not_tear_the_bar_of_a_terminal():
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", ON_A_TERMINAL], stderr=theirs, stdout=subprocess.PIPE, text=True,
        env=os.environ | {"TERM": "xterm", "COLUMNS": "80"},
    )  # fmt: skip
    os.close(theirs)
    output = b""
    try:
        while chunk := os.read(ours, 4096):
            output += chunk
    except OSError:  # the terminal is closed when its last user ends
        pass
    out, _ = process.communicate(timeout=60)
    os.close(ours)
    text = output.decode()
    assert (process.returncode, out) == (0, "done\n")
    assert "work [/red]" in text
    assert "left" in text
    lines = [line.rpartition("\x1b[2K")[2] for line in text.replace("\r", "\n").splitlines()]
    assert "adaptrack: compiling kernels" in lines
