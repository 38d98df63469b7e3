"""What the benchmark times is what it says."""

import json
import math
import sys

import numpy as np
import pytest
from tools import bench

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import Tuning, published_mpc
from adaptrack.control.scheduling import check_scheduler


@pytest.mark.parametrize("make", [bench._networks, bench._fuzzy_systems], ids=["nn", "anfis"])
def test_the_schedules_that_are_timed_ask_for_tunings_all_over_the_search_space(make, rng):
    schedule = make(rng)
    check_scheduler(schedule)
    low, high = np.array([bench.SPEEDS, bench.AMPLITUDES, bench.FRICTIONS, bench.WINDS]).T
    asked = schedule.batch(rng.uniform(low, high, (500, 4)))
    for values, (least, most) in zip(asked.T, bench.SEARCH.values(), strict=True):
        assert np.quantile(values, 0.9) - np.quantile(values, 0.1) > 0.25 * (most - least)


@pytest.mark.compiled
def test_every_controller_is_timed():
    found = bench.bench_step(20)
    for name in ("step", "nn", "anfis", "python_daqp"):
        assert 0.0 < found[f"{name}_us_p50"] <= found[f"{name}_us_p99"] <= found[f"{name}_us_max"]
    assert found["nn_kernel_us"] < found["nn_us_p50"]
    assert found["anfis_kernel_us"] < found["anfis_us_p50"]
    assert found["rules"] == 50


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["rollout", "campaign"])
def test_a_benchmark_of_one_operating_point_prints_its_rates(name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", ["bench", name, "--points", "1", "--json"])
    bench.main()
    figures = json.loads(capsys.readouterr().out)
    for rate in ("control_steps_per_s", "runs_per_s", "python_daqp_steps_per_s", "ratio_to_python_daqp"):
        assert 0.0 < figures[rate] < math.inf


def test_the_numpy_baseline_finds_the_moves_of_the_compiled_controller():
    car = load_vehicle("paper")
    plain, mpc = bench.PlainController(car, Tuning()), published_mpc(car)
    for state in ([0.0, 0.0, 0.0, 0.0], [0.05, 0.01, 0.02, 0.3], [0.02, 0.03, -0.01, 0.9]):
        commands = [controller.step(np.array(state), 20.0, np.array([3.0])) for controller in (plain, mpc)]
        assert commands[0].angle == pytest.approx(commands[1].angle, abs=1e-7)
