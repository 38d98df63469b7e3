"""Benchmarks run and print their figures."""

import json
import math
import shlex
import subprocess
import sys

import numpy as np
import pytest
from tools import bench

import adaptrack as at
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import Tuning, published_mpc


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("name", "figure"),
    [("step", "ratio_to_python_daqp"), ("rollout", "ratio_to_python_daqp"), ("tracker", "informed, python_p50_us"),
     ("controllers", "published, paper, compiled_p50_us")],
)  # fmt: skip
def test_a_benchmark_prints_its_figures(name, figure, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bench", name, "--count", "1", "--json"])
    bench.main()
    assert 0.0 < json.loads(capsys.readouterr().out)[figure] < math.inf


def test_the_numpy_baseline_finds_the_moves_of_the_compiled_controller():
    car = load_vehicle("paper")
    plain, mpc = bench.PlainController(car, Tuning()), published_mpc(car)
    for state in ([0.0, 0.0, 0.0, 0.0], [0.05, 0.01, 0.02, 0.3], [0.02, 0.03, -0.01, 0.9]):
        commands = [controller.step(np.array(state), 20.0, np.array([3.0])) for controller in (plain, mpc)]
        assert commands[0].angle == pytest.approx(commands[1].angle, abs=1e-7)


QUICK = (
    "against_release.py . --only arrays/road-geometry --folder {folder}",
    "circuits.py --made 1 --no-holds --car midsize-sedan --profile road --lateral 4 --seed 5",
    "code_figures.py --table",
    "estimating.py --runs 1",
    "foreign_loop.py --seeds 1",
    "holding.py --drives 3",
    "late_samples.py late --drives 1",
    "learned_belief.py --train 28 --test 4",
    "learning.py --cars 1",
    "population.py --cars 10",
    "roads_driven.py gate --length 300 --car paper",
    "tuned_cars.py --vehicle van --profile road",
    "unknown_cars.py --cars 2 --profile road",
    "wrong_inputs.py honest --drives 1",
)
"""Benchmarks with the arguments of their quick form."""


def run_benchmark(command, project):
    script, *arguments = shlex.split(command)
    command = [sys.executable, f"benchmarks/{script}", *arguments]
    return subprocess.run(command, cwd=project, capture_output=True, text=True, check=False)


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize("command", QUICK, ids=lambda command: command.split(".py")[0])
def test_the_quick_form_of_a_benchmark_prints_its_table(command, project, tmp_path):
    process = run_benchmark(command.format(folder=tmp_path), project)
    assert process.returncode == 0, process.stderr
    assert process.stdout.strip()


@pytest.mark.compiled
@pytest.mark.slow
@pytest.mark.parametrize("option", ["", "--speed-control --seeds 1"])
def test_a_car_in_an_engine_that_is_not_ours_is_driven(option, project):
    pytest.importorskip("mujoco", reason="needs mujoco: see benchmarks/foreign_engines.py")
    process = run_benchmark(f"foreign_engines.py --engine mujoco --only learning --seconds 3 {option}", project)
    assert process.returncode == 0, process.stderr


@pytest.mark.compiled
@pytest.mark.slow
def test_the_log_of_a_car_is_identified_from_its_description(project, tmp_path):
    run = at.rollout(at.DualTrack(load_vehicle("paper")), at.MPC(load_vehicle("paper"), profile="road"),
                     at.random_drive(3, 60.0), profile="road")  # fmt: skip
    columns = {"time": run.t, "command": run.command, "speed": run.vx, "yaw_rate": run.yaw_rate}
    rows = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header=",".join(columns), comments="")
    (tmp_path / "log.toml").write_text(
        'name = "a car"\nsource = "simulated"\nlicence = "MIT"\nlogs = ["log.csv"]\nmass = 1575\nwheelbase = 2.8\n'
    )
    process = run_benchmark(f"real_logs.py {tmp_path / 'log.toml'} --json", project)
    (row,) = json.loads(process.stdout)
    assert "estimates" in row["identify"]
