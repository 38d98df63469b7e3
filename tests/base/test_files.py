"""Files and names: what cannot be used is one clear error with its place, and no name leaves its folder."""

import os
import re

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from adaptrack.base import files
from adaptrack.base.errors import ConfigError, InvalidInput, StorageError
from adaptrack.base.files import is_text, printable, read_json, read_toml, safe_name, safe_names, write_atomically
from adaptrack.identification.reading import Reading, read_columns
from adaptrack.scenario import load_scenario

NASTY = [
    "../x", "/../../../x", "..", ".", "", " ", ".hidden", "-rf", "con", "NUL.txt", "aux.a-b", "a/b", "a\\b", "a:b",
    "x\0", "\ud800", "\u202eabc", "\x1b[31m", "[/red]", r"$\frac{$", "x" * 10_000, "é" * 300, "名前", "a\nb", "name ",
    "trailing.",
]  # fmt: skip


# -- names ------------------------------------------------------------------------------------------------------------
@given(st.text() | st.sampled_from(NASTY) | st.text(alphabet="./\\-con lpt1~$\0"))
@example("aux")
@example("x" * 81)
def test_a_name_becomes_a_plain_file_name(name):
    safe = safe_name(name)
    assert 1 <= len(safe) <= 90
    assert set(safe) <= set("ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789._-")
    assert safe[0] not in ".-"
    assert safe[-1] != "."
    assert safe.split(".")[0].lower() not in {"con", "prn", "aux", "nul", "com1", "lpt1"}
    assert os.path.basename(safe) == safe
    assert safe_name(safe) == safe


@given(st.lists(st.sampled_from([*NASTY, "a", "A", "a-2"]), max_size=8))
def test_harmless_names_stay_as_they_are_and_no_two_files_of_one_list_are_the_same(names):
    for name in ("triple-lane-change", "road-nn", "a_b.c", "x" * 80):
        assert safe_name(name) == name
    assert len({safe_name(name) for name in NASTY}) == len(NASTY)
    numbered = safe_names(names)
    assert len({name.lower() for name in numbered}) == len(numbered) == len(names)


@given(st.text())
@example("\ud800")
def test_what_is_printed_holds_no_controls_and_survives_utf8(text):
    printed = printable(text)
    assert not any(ord(c) < 32 or c in "\x7f\u200f\u202e\u2028" for c in printed)
    printed.encode()
    assert "\n" not in text or "\n" in printable(text, keep="\n")
    for text in ("12\u202f000 m²", "Überholspur", "名前", "ψ − π"):
        assert printable(text) == text
    assert printable("\x1b[31m\u202e") == r"\x1b[31m\u202e"


# -- TOML and JSON ----------------------------------------------------------------------------------------------------
DEEP = 5_000
BAD_TOML = [
    ("mass = 1\nx = " + "[" * DEEP, r"line 2: more than 64 levels of nested tables"),
    ("x = " + "{ a = " * DEEP + "1" + " }" * DEEP, "line 1: more than 64 levels"),
    (".".join(["a"] * DEEP) + " = 1", "a.*: more than 64 levels of nested tables"),
    ("# " + "[" * 80 + "\nmass = 1 2", r"line 2, column \d+: not valid TOML"),
    ("mass = 1\n\nx = " + "7" * 5_000, "line 3: a number with too many digits"),
    ('name = "a\\u0000b"', r"name = 'a\\x00b': contains a NUL or an unpaired surrogate"),
]
BAD_JSON = [
    ('{"mass": 1,\n"x": ' + "[" * DEEP, "line 2: more than 64 levels of nested tables"),
    ('{"box": [1, {"name": "\\ud800"}]}', r"box\[1\]\.name = '\\ud800': contains a NUL or an unpaired surrogate"),
    ('{"mass": 1,\n"x" 2}', r"line 2, column 5: not valid JSON: Expecting ':' delimiter"),
    ("[" * 80 + "]" * 80, "more than 64 levels of nested tables"),
    ('{"a": "' + "]" * 5_000 + '",\n"x": ' + "[" * DEEP, "line 2: more than 64 levels of nested tables"),
    ('{"mass": 1,\n"x": "' + "[" * 80 + '" 2}', r"line 2, column 89: not valid JSON: Expecting ',' delimiter"),
]


CASES = [("bad.toml", read_toml, *case) for case in BAD_TOML] + [("bad.json", read_json, *case) for case in BAD_JSON]


@pytest.mark.parametrize(("name", "read", "text", "complaint"), CASES, ids=range(len(CASES)))
def test_a_file_that_cannot_be_used_is_one_error_with_its_place(tmp_path, name, read, text, complaint):
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=rf"{name[:3]}\{name[3:]}.*{complaint}") as caught:
        read(tmp_path / name)
    assert len(str(caught.value)) < 600


def test_json_comes_back_as_it_was(tmp_path):
    data, path = {"µ": [1, 2.5, None, True], "nested": {"name": "[/red]"}}, tmp_path / ("x" * 250 + ".json")
    files.write_json(path, data)
    assert read_json(path) == data


@given(st.text(st.characters() | st.sampled_from("\0\ud800")))
def test_text_is_what_utf8_and_c_strings_hold(text):
    assert is_text(text) == ("\0" not in text and text == text.encode("utf-8", "ignore").decode())


def test_names_that_are_no_text_and_places_that_cannot_be_used_are_refused(tmp_path):
    for name in ("a\0b", "\ud800"):
        with pytest.raises(InvalidInput, match="name"):
            load_scenario("step").replace(name=name)
    (tmp_path / "file").write_text("")
    for path in ("a\0b", tmp_path / "absent" / "car.toml", tmp_path / "file" / "car.toml", tmp_path):
        for call in (read_toml, read_json, lambda path: write_atomically(path, b"")):
            with pytest.raises(StorageError, match=rf"{re.escape(printable(str(path)))}: cannot be"):
                call(path)
    assert os.listdir(tmp_path) == ["file"]


def test_a_link_is_written_through_or_replaced_as_asked(tmp_path):
    (tmp_path / "mine.txt").write_text("years of work")
    (tmp_path / "link").symlink_to(tmp_path / "mine.txt")
    write_atomically(tmp_path / "link", b"more", through_links=True)
    assert (tmp_path / "link").is_symlink()
    write_atomically(tmp_path / "link", b"new", through_links=False)
    assert (tmp_path / "mine.txt").read_text() == "more"
    assert not (tmp_path / "link").is_symlink()


@pytest.mark.parametrize(("function", "error", "words"), [
    ("replace", OSError(28, "No space left on device"), "car.toml: cannot be written: No space left on device"),
    ("fsync", KeyboardInterrupt("Ctrl-C"), "Ctrl-C"),
])  # fmt: skip
def test_a_write_that_fails_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch, function, error, words):
    path = tmp_path / "car.toml"
    path.write_text("old")

    def fail(*_):
        raise error

    monkeypatch.setattr(os, function, fail)
    with pytest.raises((StorageError, KeyboardInterrupt), match=words):
        write_atomically(path, b"new")
    assert [file.read_text() for file in tmp_path.iterdir()] == ["old"]


# -- Parquet ----------------------------------------------------------------------------------------------------------
READERS = {
    "log": lambda file: read_columns(file, Reading()),
    "data set": lambda file: files.decode_parquet(file.read_bytes(), file, "adaptrack data set", 1, "make it again"),
}


@pytest.mark.parametrize("kind", READERS)
def test_a_table_of_too_many_numbers_is_refused_before_it_is_read(kind, tmp_path, monkeypatch):
    """A constant column of 800 million rows is 4 MB in a file and 6 GB in memory."""
    file = tmp_path / "bomb.parquet"
    pyarrow.parquet.write_table(pyarrow.table(dict.fromkeys(("time", "x", "y"), np.zeros(1000))), file)
    monkeypatch.setattr(files, "MAX_NUMBERS", 2999)
    monkeypatch.setattr(pyarrow.parquet.ParquetFile, "read", lambda *_, **__: pytest.fail("it was read"))
    with pytest.raises(StorageError, match=r"bomb\.parquet: holds 3,000 numbers, more than 2,999; leave out"):
        READERS[kind](file)


def test_a_log_with_two_columns_of_one_name_is_read(tmp_path):
    columns = [pyarrow.array([0.0, 0.1]), pyarrow.array([1.0, 1.0]), pyarrow.array([2.0, 2.0])]
    table = pyarrow.Table.from_arrays(columns, names=["time", "a", "a"])
    pyarrow.parquet.write_table(table, tmp_path / "twice.parquet")
    assert list(READERS["log"](tmp_path / "twice.parquet").values["time"]) == [0.0, 0.1]


def test_a_log_is_read_without_threads_that_outlive_an_error(tmp_path, monkeypatch):
    """One that read on while Python exited aborted half of the commands on a log with a line of 20 MB."""
    threads = []

    def read_csv(source, read_options, **options):
        threads.append(read_options.use_threads)
        assert isinstance(source, pyarrow.BufferReader)  # a Python file needs the interpreter that exits
        return pyarrow.table({"time": [0.0, 1.0]})

    monkeypatch.setattr("pyarrow.csv.read_csv", read_csv)
    (tmp_path / "log.csv").write_text("time\n0\n1\n")
    READERS["log"](tmp_path / "log.csv")
    assert threads == [False]
