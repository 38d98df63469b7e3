"""Kernels are compiled when they are first needed; `adaptrack warm-up` does it beforehand."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest

from adaptrack import cli
from adaptrack.cli.warm_up import NEEDED, PARTS

pytestmark = pytest.mark.compiled

USED = """
import adaptrack as at
from adaptrack.kernels.controllers import mpc_step
from adaptrack.kernels.estimators import kalman, learning
from adaptrack.kernels.qp import hildreth

before = [each.overloads for each in (mpc_step.step, kalman.kalman, learning.learn, hildreth.hildreth)]
assert not any(before), "importing compiled"
mpc = at.MPC(at.load_vehicle("paper"))
mpc.step([0.0, 0.0, 0.0, 0.0, 0.0, 0.0], 15.0, [1.0])
print([len(each) for each in before])
"""


def run(monkeypatch, capsys, *arguments):
    """(exit code, standard output, standard error) of one command."""
    monkeypatch.setattr(sys, "argv", ["adaptrack", *arguments])
    code = cli.main()
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.slow
def test_a_step_makes_ready_what_it_uses_and_not_what_it_imports(run_python):
    # The step, the filter; not the learning filters, not the other QP method.
    assert run_python(code=USED).split("\n")[-2] == "[1, 1, 0, 0]"


@pytest.mark.slow
def test_a_kernel_with_a_signature_refuses_other_arguments_when_it_is_called_first(run_python):
    code = (
        "from adaptrack.kernels.maths.random import counted_normal\n"
        "try: counted_normal('a', 1, 2)\n"
        "except TypeError as error: print(error)\n"
        "print(counted_normal(1, 2, 3) == counted_normal(1, 2, 3))"
    )
    said = run_python(code=code)
    assert "No matching definition" in said
    assert said.split("\n")[-2] == "True"


def test_warm_up_names_its_parts_their_times_and_the_folder(monkeypatch, capsys):
    code, out, _ = run(monkeypatch, capsys, "warm-up", "--for", "simulate, simulate", "--json")
    told = json.loads(out)
    assert code == 0
    assert [row["part"] for row in told["rows"]] == ["run"]
    assert all(row["seconds"] > 0.0 for row in told["rows"])
    assert os.path.isdir(told["folder"])


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--for", "simulat"], ["--for simulat", "simulate"]),
        (["--for", " , "], ["names no command"]),
        (["--all", "--for", "drive"], ["--all", "leave --for out"]),
    ],
)
def test_warm_up_refuses_what_it_does_not_know(monkeypatch, capsys, arguments, words):
    code, _, err = run(monkeypatch, capsys, "warm-up", *arguments)
    assert code == 2
    assert all(word in err for word in words)


def test_what_commands_need_are_parts():
    assert {part for needed in NEEDED.values() for part in needed} < PARTS.keys()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("simulate", ["simulate", "lane-change", "--profile", "road"]),
        ("drive", ["drive", "country", "--length", "500"]),
    ],
)
def test_after_a_warm_up_the_command_compiles_nothing(tmp_path, name, command):
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}

    def fresh(*arguments):
        return subprocess.run(
            [sys.executable, *arguments], env=environment, check=True, capture_output=True, text=True
        ).stdout

    fresh("-m", "adaptrack", "warm-up", "--for", name)
    code = (
        f"import sys; sys.argv = ['adaptrack', *{command!r}]\n"
        "from adaptrack import cli\n"
        "assert cli.main() == 0\n"
        "from adaptrack.kernels.abi import compiling\n"
        "print('compiled', compiling.seconds)"
    )
    assert fresh("-c", code).split("\n")[-2] == "compiled 0.0"
