"""What the benchmark times is what it says."""

import json
import math
import sys

import numpy as np
import pytest
from tools import bench

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
