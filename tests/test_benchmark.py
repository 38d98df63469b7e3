"""What the benchmark times is what it says."""

import numpy as np
import pytest
from tools import bench

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
