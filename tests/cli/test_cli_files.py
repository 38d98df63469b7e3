"""Files that a command reads and writes: what is no plain file, what another program wrote, what is too large."""

from __future__ import annotations

import os
import re
import shlex
import stat
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from adaptrack.base import files, limits
from adaptrack.base.errors import AdaptrackError, InvalidInput, StorageError
from adaptrack.cli.app import app
from adaptrack.control.recording import Recorder
from adaptrack.road import generate_road

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
IDENTIFY = ("--mass", "1500", "--wheelbase", "2.7")


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def refusal(*arguments):
    process = run(*arguments)
    assert isinstance(process.exception, AdaptrackError), (process.output, process.exception)
    return str(process.exception)


# -- written ----------------------------------------------------------------------------------------------------------
@needs_pipes
@pytest.mark.parametrize("arguments", [
    ("road", "plot", "town", "--length", "200", "--out", "{}/road.png"),
    ("export", "page", "--out", "{}/page.html"),
    ("car", "midsize-sedan", "--out", "{}/car.toml"),
    ("identify", "log.csv", *IDENTIFY, "--out", "{}/car.toml"),
    ("drive", "town", "--length", "100", "--out", "{}"),
    ("certify", "road-nn", "--out", "{}"),
    ("paper", "reproduce", "--quick", "--out", "{}"),
], ids=lambda words: " ".join(words[:2]))  # fmt: skip
def test_a_pipe_is_refused_before_the_work_and_left_as_it_is(tmp_path, arguments):
    names = {Path(arguments[-1]).name if arguments[-1] != "{}" else "index.html"}
    for name in names:
        os.mkfifo(tmp_path / name)
    assert "cannot be written: it is no plain file" in refusal(*(word.format(tmp_path) for word in arguments))
    assert all(stat.S_ISFIFO(os.stat(tmp_path / name).st_mode) for name in names)


@needs_pipes
@pytest.mark.parametrize("name", ["log.csv", "log.parquet.csv"])
def test_a_recorder_does_not_wait_for_a_reader_of_a_pipe(tmp_path, name):
    os.mkfifo(tmp_path / name)
    (tmp_path / "link.csv").symlink_to(tmp_path / name)
    for path in ("log.csv" if name == "log.csv" else "log.parquet", "link.csv"):
        with pytest.raises(StorageError, match="it is no plain file"):
            Recorder(tmp_path / path)


@pytest.mark.parametrize("arguments", [
    ("drive", "town", "--length", "100", "--out", "{}"),
    ("compare", "town", "--length", "100", "--out", "{}"),
    ("certify", "road-nn", "--out", "{}"),
    ("paper", "reproduce", "--quick", "--out", "{}"),
    ("export", "page", "--out", "{}/index.html"),
], ids=lambda words: " ".join(words[:2]))  # fmt: skip
def test_the_page_of_another_program_is_never_replaced(tmp_path, arguments):
    page = tmp_path / "index.html"
    page.write_text("<title>Photos of 2019</title> made with adaptrack in mind")
    before = page.read_bytes()
    words = refusal(*(word.format(tmp_path) for word in arguments))
    assert "another program wrote this page; choose another folder, or remove it" in words
    assert page.read_bytes() == before
    assert os.listdir(tmp_path) == ["index.html"]


@pytest.mark.compiled
def test_a_page_of_this_program_is_replaced(tmp_path):
    for seed in (1, 2):
        process = run("drive", "town", "--length", "100", "--road-seed", seed, "--out", tmp_path)
        assert process.exit_code == 0, process.output
        assert "town-" in (tmp_path / "index.html").read_text()


# -- read -------------------------------------------------------------------------------------------------------------
READERS = {
    "road": ("road", "check", "{}.csv"), "road file": ("road", "check", "{}.toml"),
    "OpenDRIVE": ("road", "check", "{}.xodr"), "drive": ("drive", "{}.csv"), "log": ("identify", "{}.csv", *IDENTIFY),
    "Parquet": ("identify", "{}.parquet", *IDENTIFY),
    "loop": ("check-loop", "{}.csv", "--vehicle", "midsize-sedan"),
    "car": ("drive", "town", "--vehicle", "{}.toml"),
}  # fmt: skip


@needs_pipes
@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", ["pipe", "endless"])
def test_a_pipe_and_an_endless_file_are_refused_before_anything_is_read(tmp_path, reader, kind):
    for ending in ("csv", "toml", "xodr", "parquet"):
        if kind == "pipe":
            os.mkfifo(tmp_path / f"a.{ending}")
        else:
            (tmp_path / f"a.{ending}").symlink_to("/dev/zero")
    words = refusal(*(word.format(tmp_path / "a") for word in READERS[reader]))
    assert "cannot be read: it is no plain file" in words


@pytest.mark.parametrize("reader", ["road", "drive", "log", "loop"])
def test_a_table_of_too_many_rows_is_refused_before_its_cells_are_split(tmp_path, reader, monkeypatch):
    monkeypatch.setattr(files, "TABLE_ROWS", limits.RequestLimit(1000, "rows", "cut it"))
    monkeypatch.setattr(np, "empty", lambda *_, **__: pytest.fail("a table was made"))
    (tmp_path / "a.csv").write_text("time,x,y\n" + "1,2,3\n" * 1001)
    words = refusal(*(word.format(tmp_path / "a") for word in READERS[reader]))
    assert "at most 1,000 rows" in words


def test_a_file_of_a_similar_name_is_named(tmp_path):
    (tmp_path / "road.csv").write_text("x,y\n0,0\n")
    for command in (("road", "check"), ("drive",), ("identify", *IDENTIFY)):
        assert f"Did you mean '{tmp_path / 'road.csv'}'?" in refusal(*command, tmp_path / "raod.csv")
    assert "Did you mean" not in refusal("road", "check", tmp_path / "quite-different.xodr")


# -- the command that is named next -----------------------------------------------------------------------------------
def points_file(folder):
    s = np.arange(0.0, 121.0, 2.0)
    at = generate_road("town", seed=1, length=200.0).at(s)
    rows = np.column_stack([at.x, at.y, np.full(s.size, 7.0)])
    np.savetxt(folder / "my points.csv", rows, header="x,y,v", delimiter=",", comments="", fmt="%.3f")
    return folder / "my points.csv"


def lanes_file(folder):
    lane = '<lane id="{}" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>'
    road = f"""<road id="7" length="100"><planView><geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>
</planView><lanes><laneSection s="0"><right>{lane.format(-1)}{lane.format(-2)}</right></laneSection></lanes></road>"""
    (folder / "a.xodr").write_text(f"<OpenDRIVE>{road}{road.replace('7', '8', 1)}</OpenDRIVE>")
    return folder / "a.xodr"


NEXT = {
    "columns": (points_file, ["--speed-column", "v", "--vehicle", "van"]),
    "points": (points_file, ["--max-deviation", "0.3", "--open", "--lateral-acceleration", "1.5"]),
    "lane": (lanes_file, ["--road", "8", "--lane", "-2", "--speed", "5"]),
    "generated": (lambda _: "town", ["--road-seed", "3", "--length", "150", "--assumed-friction", "0.6:0.8"]),
    "margins": (lambda _: "town", ["--length", "150", "--no-margins", "--vehicle", "midsize-sedan"]),
    "too fast": (points_file, ["--speed", "40", "--open"]),
    "too fast in bends": (points_file, ["--lateral-acceleration", "8.6", "--open"]),
}


def plain(word):
    """The number that a word is, or the word."""
    return float(word) if files.is_number(word) else word


@pytest.mark.compiled
@pytest.mark.parametrize("name", NEXT)
def test_the_command_that_road_check_names_keeps_the_options_and_runs(tmp_path, monkeypatch, name):
    make, settings = NEXT[name]
    words = ["road", "check", str(make(tmp_path)), *settings]
    monkeypatch.setattr("sys.argv", ["adaptrack", *words])
    line = re.search(r"^Next: .*?: (adaptrack .*)$", run(*words).output, re.MULTILINE)[1]
    proposed = shlex.split(line)[1:]
    options = [word for word in settings if name[:8] != "too fast" or word not in ("40", "8.6")]
    assert {plain(word) for word in options} <= {plain(word) for word in proposed}
    assert words[2] in proposed
    monkeypatch.setattr("sys.argv", ["adaptrack", *proposed])
    process = run(*proposed)
    assert not isinstance(process.exception, InvalidInput), process.exception
    assert process.exit_code in (0, 1), process.output
