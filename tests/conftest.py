"""What all tests share: quiet thread pools, reproducible randomness, fresh interpreters."""

from __future__ import annotations

import gc
import os

gc.set_threshold(100_000)  # new objects between two searches for unreachable ones; Python's own 700 cost a tenth

# The tests run in parallel processes: one thread each in BLAS and OpenMP. Read once, when NumPy is imported.
for _variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_variable, "1")
os.environ["MPLBACKEND"] = "Agg"

import functools
import json
import signal
import subprocess
import sys
import threading
import zlib
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
import typer.main
from hypothesis import HealthCheck, settings

from adaptrack import cli
from pictures import pictures
from programs import find_program

settings.register_profile(
    "adaptrack",
    deadline=None,  # the first call of a kernel may compile it
    derandomize=True,
    max_examples=50,
    suppress_health_check=[HealthCheck.too_slow],
)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "adaptrack"))

typer.main.get_command = functools.cache(typer.main.get_command)  # put together once, not for every command line


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """Pictures are drawn in tests marked `drawn` alone."""
    with pictures(drawn=item.get_closest_marker("drawn") is not None):
        return (yield)


def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test whose mark `needs` names a program that does not work."""
    for mark in item.iter_markers("needs"):
        find_program(mark.args[0])


def pytest_collection_finish() -> None:
    """What was imported until now lives on: the garbage collector need not go through it again and again."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """A random generator seeded by file and name of the test: the same numbers in every run, order and folder."""
    file, _, name = request.node.nodeid.partition("::")
    return np.random.default_rng(zlib.crc32(f"tests/{Path(file).name}::{name}".encode()))


@pytest.fixture(scope="session")
def project() -> Path:
    """The root of the source tree."""
    return Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def run_python() -> Callable[..., str]:
    """Run code (or interpreter arguments) in a fresh interpreter; its standard output, or its errors in the failure."""

    def run(*arguments: str, code: str | None = None, cwd: Path | None = None, timeout: float = 600.0) -> str:
        command = [sys.executable, *(("-c", code) if code is not None else ()), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=timeout, check=False)
        assert done.returncode == 0, f"{command} ended with {done.returncode}:\n{done.stderr}"
        return done.stdout

    return run


@pytest.fixture
def run_command(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> Callable[..., tuple[int, str, str]]:
    """Run a command of adaptrack in 80 columns: exit code, standard output, standard error."""

    def run(*arguments: object) -> tuple[int, str, str]:
        monkeypatch.setenv("COLUMNS", "80")
        monkeypatch.setattr(sys, "argv", ["adaptrack", *map(str, arguments)])
        code = cli.main()
        return (code, *capsys.readouterr())

    return run


@pytest.fixture
def output_of(run_command: Callable[..., tuple[int, str, str]]) -> Callable[..., str]:
    """Run a command that must succeed: its standard output."""

    def run(*arguments: object) -> str:
        code, out, err = run_command(*arguments)
        assert code == 0, err
        return out

    return run


@pytest.fixture
def answer_of(output_of: Callable[..., str]) -> Callable[..., dict]:
    """Run a command that must succeed, with --json: its answer."""
    return lambda *arguments: json.loads(output_of(*arguments, "--json"))


@pytest.fixture
def press_ctrl_c() -> Iterator[Callable[[float], None]]:
    """Press Ctrl-C after some seconds; heard also where a shell's background jobs ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    timers: list[threading.Timer] = []

    def press(after: float) -> None:
        timers.append(threading.Timer(after, os.kill, (os.getpid(), signal.SIGINT)))
        timers[-1].start()

    yield press
    for timer in timers:
        timer.cancel()
        timer.join()
    signal.signal(signal.SIGINT, before)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """SLOW_PART=N in the environment: of the slow tests only the fifth N modulo 5, by a stable hash of their names."""
    part = os.environ.get("SLOW_PART")
    if part is None:
        return
    others = [i for i in items if i.get_closest_marker("slow") and (zlib.crc32(i.nodeid.encode()) - int(part)) % 5]
    config.hook.pytest_deselected(items=others)
    items[:] = [item for item in items if item not in others]
