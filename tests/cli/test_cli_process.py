"""The command line as a process: Ctrl-C, pipes that close, disks that are full."""

from __future__ import annotations

import importlib
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
import typer

import adaptrack as at
from adaptrack import cli
from adaptrack.drive.trajectory import Trajectory


def adaptrack(*arguments, prepend=None, **options):
    """A process that runs the command line; prepend: a folder whose modules come first."""
    environment = os.environ | ({"PYTHONPATH": os.pathsep.join([str(prepend), *sys.path])} if prepend else {})
    return subprocess.Popen(
        [sys.executable, "-m", "adaptrack", *arguments], stderr=subprocess.PIPE, text=True, env=environment, **options
    )


# -- Ctrl-C -----------------------------------------------------------------------------------------------------------
PRESS = "import os, signal, time\nos.kill(os.getpid(), signal.SIGINT)\n"
GUARDED = (
    "import os, signal, time\ntry:\n    os.kill(os.getpid(), signal.SIGINT)\n    time.sleep(30)\nexcept BaseException:"
)


@pytest.mark.parametrize(("module", "code"), [
    ("typer", f"{PRESS}time.sleep(30)"),
    ("numpy", f"{PRESS}time.sleep(30)"),
    ("numpy", f"{GUARDED}\n    raise ImportError"),
    ("numpy", f"{GUARDED}\n    pass\ntime.sleep(30)"),
], ids=["of-typer", "of-numpy", "turned-into-another-error", "swallowed-by-a-callback"])  # fmt: skip
def test_ctrl_c_during_an_import_is_one_sentence_and_exit_code_130(tmp_path, module, code):
    (tmp_path / f"{module}.py").write_text(code)
    begun = time.monotonic()
    process = adaptrack("drive", "step", prepend=tmp_path, stdout=subprocess.PIPE)
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert out == ""
    assert err == "adaptrack: interrupted. Nothing was written.\n"
    assert time.monotonic() - begun < 25.0


def press_ctrl_c(*arguments, **options):
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(5.0)
    pytest.fail("Ctrl-C was not heard")


@pytest.mark.parametrize(("command", "stopped_in", "words"), [
    ("drive step", "adaptrack.load_scenario", "Nothing was written"),
    ("paper reproduce --out {out}", "adaptrack.paper.data_set.load_dataset", "Nothing was written"),
    ("paper adapt --out {out}", "adaptrack.paper.adaptation.adapt", "{out}: run the command again to continue"),
    (
        "paper campaign paper-grid --out {out}",
        "adaptrack.paper.campaign.run_campaign",
        "{out}: run the command again to continue",
    ),
])  # fmt: skip
def test_every_command_answers_ctrl_c_with_what_is_kept(run_command, monkeypatch, tmp_path, command, stopped_in, words):
    module, _, name = stopped_in.rpartition(".")
    monkeypatch.setattr(importlib.import_module(module), name, press_ctrl_c)
    before = signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGALRM)
    code, out, err = run_command(*command.format(out=tmp_path).split())
    assert (code, out) == (130, "")
    assert "Traceback" not in err
    assert err.splitlines()[-1].startswith("adaptrack: interrupted. ")
    assert words.format(out=tmp_path) in err
    assert (signal.getsignal(signal.SIGINT), signal.getsignal(signal.SIGALRM)) == before
    run_command("--version")
    assert cli._progress_note == "Nothing was written.", "the next command forgets the note"


def test_ctrl_c_between_runs_tells_which_trajectories_are_there(run_command, monkeypatch, tmp_path):
    saved, drive = [], at.simulate
    monkeypatch.setattr(Trajectory, "save", lambda self, path: saved.append(path))
    monkeypatch.setattr(at, "simulate", lambda *args, **options: press_ctrl_c() if saved else drive(*args, **options))
    code, _, err = run_command("drive", "step", "sine", "-o", "duration=0.3", "--out", tmp_path)
    assert code == 130
    assert f"1 of 2 runs were finished; their trajectories are in {tmp_path}" in err


def test_a_thread_may_call_the_command_line(monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["adaptrack", "--version"])
    codes = []
    thread = threading.Thread(target=lambda: codes.append(cli.main()))
    thread.start()
    thread.join()
    assert codes == [0]


def test_ctrl_c_that_a_finalizer_swallows_is_heard_a_moment_later(run_command, monkeypatch):
    class Resource:
        def __del__(self):
            os.kill(os.getpid(), signal.SIGINT)

    def release(*arguments, **options):
        Resource()
        time.sleep(5.0)
        pytest.fail("Ctrl-C was not heard")

    hook = sys.unraisablehook
    monkeypatch.setattr(cli, "REPEAT", 0.05)
    monkeypatch.setattr(at, "list_scenarios", release)
    assert run_command("list", "scenarios") == (130, "", "adaptrack: interrupted. Nothing was written.\n")
    assert sys.unraisablehook is hook


def test_an_end_of_file_within_a_command_is_no_ctrl_c(run_command, monkeypatch):
    def torn():
        raise EOFError("Ran out of input")

    monkeypatch.setattr(at, "list_scenarios", torn)
    with pytest.raises(typer.Abort) as fault:  # a fault, with its traceback
        run_command("list", "scenarios")
    assert isinstance(fault.value.__cause__, EOFError)


def test_no_command_asks_matplotlib_for_a_window_system(run_command, monkeypatch):
    backends = []
    monkeypatch.setenv("MPLBACKEND", "nonsense")  # the import of matplotlib would refuse it
    monkeypatch.setattr(at, "list_scenarios", lambda: backends.append(os.environ.get("MPLBACKEND")) or {})
    assert run_command("list", "scenarios")[0] == 0
    assert backends == [None]


# -- standard output --------------------------------------------------------------------------------------------------
COMMANDS = [["--help"], ["list", "profiles"], ["list", "profiles", "--json"]]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_full_disk_is_one_sentence_and_exit_code_2(command):
    with open("/dev/full", "w") as full:
        process = adaptrack(*command, stdout=full)
        _, err = process.communicate(timeout=60)
    assert process.returncode == 2
    assert err == "adaptrack: standard output cannot be written: No space left on device.\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_a_reader_that_has_gone_ends_the_command_quietly_with_exit_code_141(command):
    reader, writer = os.pipe()
    os.close(reader)
    process = adaptrack(*command, stdout=writer)
    os.close(writer)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 141
    assert err == ""


def test_a_closed_standard_output_is_one_sentence_and_exit_code_2():
    command = f"exec {sys.executable} -m adaptrack list profiles >&-"
    process = subprocess.run(["sh", "-c", command], stderr=subprocess.PIPE, text=True, timeout=60, check=False)
    assert process.returncode == 2
    assert process.stderr.startswith("adaptrack: standard output is closed")
    assert len(process.stderr.splitlines()) == 1


def test_text_that_the_terminal_cannot_show_is_escaped():
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    process = subprocess.run(
        [sys.executable, "-m", "adaptrack", "list"], capture_output=True, env=environment, timeout=60, check=False
    )
    assert (process.returncode, process.stderr) == (0, b"")
