"""The counter of walks finds the files, the steps back and the names on a way that is known."""

import importlib.util
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).resolve().parent.parent / "benchmarks"
PROGRAM = {
    "road/read.py": "def read(path):\n    return Lines([path])\n\nclass Lines:\n    def __init__(self, rows):\n"
    "        self.rows = rows\n",
    "drive/go.py": "def go(lines, speed, helper):\n    return helper(lines), unrelated(speed)\n\n"
    "def unrelated(other):\n    return other\n",
    "results/show.py": "def show(shown):\n    return [shown.rows]\n",
}
"""A program whose room `drive` calls back into `results`."""


@pytest.fixture
def walks(monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    spec = importlib.util.spec_from_file_location("walks", BENCHMARKS / "walks.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_files_steps_back_and_names_are_those_of_the_way(walks, tmp_path):
    functions = {}
    for name, text in PROGRAM.items():
        file = tmp_path / name
        file.parent.mkdir()
        file.write_text(text)
        exec(compile(text, file, "exec"), functions)

    path = tmp_path / "a.csv"
    counting = walks.Walk(tmp_path, path)
    before = sys.getprofile()
    sys.setprofile(counting)
    functions["go"](functions["read"](path), 3.0, functions["show"])
    sys.setprofile(before)

    found = counting.counts()
    assert found["files"] == ["drive.go", "results.show", "road.read"]
    assert found["steps back"] == ["drive.go -> results.show"]
    assert found["names"] == ["lines", "path", "rows", "shown"]
