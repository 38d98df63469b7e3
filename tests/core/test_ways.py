"""The library, kernels compiled at run time and kernels in plain Python give the same bits."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from adaptrack.core import library

WORK = Path(__file__).parents[1] / "ways.py"


def answers(way, file, *size):
    command = [sys.executable, str(WORK), str(file), *map(str, size)]
    process = subprocess.run(command, env=os.environ | {"ADAPTRACK_KERNELS": way}, capture_output=True, text=True)
    assert process.returncode == 0, process.stderr
    with np.load(file) as arrays:
        return dict(arrays)


def same_bits(first, other):
    """Names of arrays that differ; any NaN is like any other."""
    assert first.keys() == other.keys()
    assert len(first) > 50
    nan = np.float64(np.nan)
    comparable = {
        name: [np.where(arrays[name] != arrays[name], nan, arrays[name]) for arrays in (first, other)] for name in first
    }
    return [name for name, (a, b) in comparable.items() if a.shape != b.shape or a.tobytes() != b.tobytes()]


@pytest.fixture
def in_library(tmp_path):
    """What the library answers."""
    if not isinstance(library.loaded(), library.Library) or library.loaded().edited:
        pytest.skip("needs the library of these sources")

    def answered(*size):
        return answers("library", tmp_path / "library.npz", *size)

    return answered


@pytest.mark.compiled
@pytest.mark.parametrize("size", [(4, 1, 0.2), pytest.param((200, 2, 5.0), marks=pytest.mark.slow)], ids=str)
def test_the_interpreter_gives_the_bits_of_the_library(in_library, tmp_path, size):
    assert same_bits(in_library(*size), answers("interpreted", tmp_path / "interpreted.npz", *size)) == []


@pytest.mark.slow
@pytest.mark.compiled
def test_kernels_that_are_compiled_now_give_the_bits_of_the_library(in_library, tmp_path):
    size = (20_000, 20, 30.0)
    assert same_bits(in_library(*size), answers("jit", tmp_path / "jit.npz", *size)) == []
