"""Comparisons: same roads, noise and effort for all; ranks only where intervals part; interrupted ones continue."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

import adaptrack as at
from adaptrack.base.errors import AdaptrackError, InvalidInput, MissingExtra, UnknownName
from adaptrack.base.statistics import ratio
from adaptrack.cars.plant import DualTrack
from adaptrack.comparison import config
from adaptrack.comparison import run as study
from adaptrack.comparison.run import run_cell, run_comparison
from adaptrack.comparison.table import Comparison, standing_rows
from adaptrack.control.controllers import MPC, About, list_controllers, registry
from adaptrack.drive.failure import DISTANCE
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import load_profile

TINY: dict[str, Any] = {
    "name": "tiny", "contenders": ["informed", "pure-pursuit"], "cars": ["paper"], "profiles": ["road"],
    "training": ["country:101"], "roads": ["country:1"], "length": 200.0, "training_length": 150.0, "seeds": [0, 1],
    "budget": 10, "entry_speeds": False,
}  # fmt: skip


def tiny(**changes: Any) -> config.ComparisonConfig:
    return config.ComparisonConfig(**{**TINY, **changes})


# -- statistics -------------------------------------------------------------------------------------------------------
def columns(logs: dict[str, np.ndarray], failed: dict[str, np.ndarray] | None = None) -> dict[str, np.ndarray]:
    """Rows of contenders whose RMS errors are exp(logs[name]) (cars, roads), each with its default."""
    rows: dict[str, list[Any]] = {name: [] for name in ("contender", "tuning", "car", "road", "seed", "cost", "failed")}
    for name, table in logs.items():
        for (car, road), value in np.ndenumerate(table):
            lost = bool(failed is not None and name in failed and failed[name][car, road])
            values = (name, "default", f"car {car}", f"road {road:02d}", 0.0, math.exp(2.0 * value), float(lost))
            for key, entry in zip(rows, values, strict=True):
                rows[key].append(entry)
    result = {name: np.array(values) for name, values in rows.items()}
    result["rms_error"] = np.sqrt(result["cost"])
    return result | {
        name: result["rms_error"] for name in ("p95_error", "max_corner", "steering_rate", "acceleration", "jerk")
    }


def table(logs: dict[str, np.ndarray], failed: dict[str, np.ndarray] | None = None) -> Comparison:
    return Comparison.from_columns(columns(logs, failed))


def test_a_ratio_that_is_the_same_everywhere_has_an_interval_of_no_width():
    logs = np.random.default_rng(0).normal(size=(4, 6))
    result = table({"a": logs, "b": logs + math.log(2.0)}).ratio("b, default", "a, default", "rms_error")
    assert np.allclose([result.mean, result.low, result.high], 2.0)


def test_the_interval_of_a_ratio_holds_the_truth_about_as_often_as_it_says():
    rng, hits = np.random.default_rng(1), 0
    for _ in range(60):
        cars, roads = rng.normal(0.0, 0.3, (8, 1)), rng.normal(0.0, 0.3, (1, 12))
        result = ratio(np.exp(cars + roads + rng.normal(0.0, 0.3, (8, 12))), np.ones((8, 12)))
        hits += result.low < 1.0 < result.high
    assert hits >= 51  # 85 % of 60; drawing the 96 pairs as if they were independent gives half of that


def test_only_contenders_whose_intervals_part_have_different_ranks():
    rng = np.random.default_rng(3)
    base = rng.normal(size=(5, 8))
    logs = {
        "a": base, "like a": base + rng.normal(0.0, 0.2, base.shape), "worse": base + 1.0, "worst": base + 2.0,
    }  # fmt: skip
    ranks = table(logs).ranks()
    assert [ranks[f"{name}, default"] for name in logs] == [1, 1, 3, 4]


def test_a_failed_run_counts_as_far_off_as_a_run_fails_at():
    failed = np.zeros((2, 3), bool)
    failed[1, 2] = True
    comparison = table({"a": np.zeros((2, 3))}, {"a": failed})
    assert comparison.table("a, default", "rms_error")[1, 2] == DISTANCE
    assert standing_rows(comparison)[0]["failures"] == 1


def test_contenders_are_compared_on_the_cars_and_roads_that_both_drove():
    logs = np.log([[1.0, 2.0], [3.0, 4.0]])
    rows = columns({"a": logs, "b": logs + math.log(3.0)})
    is_selected = ~((rows["contender"] == "b") & (rows["car"] == "car 1"))
    comparison = Comparison.from_columns({name: values[is_selected] for name, values in rows.items()})
    assert np.isclose(comparison.ratio("b, default", "a, default", "rms_error").mean, 3.0)
    assert {row["label"]: row["runs"] for row in standing_rows(comparison)} == {"a, default": 4, "b, default": 2}
    is_selected = (rows["contender"] == "a") == (rows["car"] == "car 0")
    comparison = Comparison.from_columns({name: values[is_selected] for name, values in rows.items()})
    with pytest.raises(InvalidInput, match="no measured run in common"):
        comparison.ratio("b, default", "a, default")


# -- what is asked for ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("changes", "words"), [
    ({"budget": 5}, "give at least 10"),
    ({"training": ["country:1"]}, "is a test road as well"),
    ({"training_seeds": [1]}, "is a noise seed of the test drives as well"),
    ({"contenders": ["informd"]}, "informed"),
    ({"contender": ["informed"]}, "contender"),
    ({"cars": []}, "cars"),
    ({"contenders": ["nowhere.toml"]}, "cannot be read"),
])  # fmt: skip
def test_a_comparison_that_cannot_be_fair_is_refused_with_the_key(changes: dict[str, Any], words: str, tmp_path: Path):
    from adaptrack.base.files import write_toml

    write_toml(tmp_path / "mine.toml", {**TINY, **changes})
    with pytest.raises(AdaptrackError, match=words):
        config.load_comparison(tmp_path / "mine.toml")


def test_the_shipped_comparisons_can_be_loaded_and_name_what_is_there():
    assert {"quick", "standard", "full"} <= set(config.list_comparisons())
    for name in config.list_comparisons():
        task = config.load_comparison(name)
        assert set(task.contenders) <= set(list_controllers())
        for profile in task.profiles:
            load_profile(profile)
    with pytest.raises(UnknownName, match="standard"):
        config.load_comparison("standart")


def test_a_road_can_be_driven_faster():
    car = at.load_vehicle("paper")
    drive, fast = (config.load_drive(name, car, 600.0, 10.0) for name in ("lap:1", "lap:1@6"))
    assert isinstance(drive, RoadDrive)
    assert isinstance(fast, RoadDrive)
    assert fast.duration < 0.9 * drive.duration
    assert fast.name == "lap:1@6"


def test_a_car_is_loaded_with_its_plant(tmp_path: Path):
    assert config.load_setting("paper/single-track", "road").plant.name == "single-track"
    assert config.load_setting("paper", "road").plant.name == "dual-track"
    (tmp_path / "cars").mkdir()
    mine = tmp_path / "cars" / "mine.toml"
    at.load_vehicle("van").to_toml(mine)
    assert config.load_setting(str(mine), "road").car.mass == at.load_vehicle("van").mass
    assert config.load_setting(f"{mine}/single-track", "road").plant.name == "single-track"
    with pytest.raises(InvalidInput, match=r"must be a name or a \.toml file"):
        config.load_setting("paper/single-track/again", "road")
    with pytest.raises(InvalidInput, match="whole number"):
        config.load_drive("country:x", at.load_vehicle("paper"), 300.0, 10.0)


# -- contenders -------------------------------------------------------------------------------------------------------
def test_the_contender_from_the_data_sheet_is_told_mass_and_wheelbase_alone():
    """Another car of the same mass and wheelbase, and another true actuator, give the same controller."""
    car, profile = at.load_vehicle("midsize-sedan"), load_profile("road")
    other = car.replace(
        stiffness_front=0.5 * car.stiffness_front, yaw_inertia=1.4 * car.yaw_inertia, lf=car.lf - 0.1, lr=car.lr + 0.1
    )
    slower = profile.replace(steering=profile.steering.replace(lag=0.3, dead_time=0.1))
    settings = (
        config.ControllerSetting(car, DualTrack(car), profile),
        config.ControllerSetting(other, DualTrack(other), slower),
    )
    comparison = [setting.controller("informed-from-sheet") for setting in settings]
    assert all(isinstance(controller, MPC) for controller in comparison)
    assert comparison[0].belief == comparison[1].belief  # type: ignore[attr-defined]
    assert comparison[0].model == comparison[1].model  # type: ignore[attr-defined]
    assert comparison[0].tuning == comparison[1].tuning  # type: ignore[attr-defined]


def test_a_scheduler_is_left_out_on_a_car_that_it_was_not_made_for():
    result = run_cell(tiny(cars=["van"], contenders=["nn"]), config.Cell("nn", "van", "road"))
    assert not result["rows"]
    assert "was made for the car 'paper'" in result["left_out"]


def test_a_contender_that_needs_a_missing_package_is_left_out_with_the_remedy(monkeypatch: pytest.MonkeyPatch):
    def nonlinear(vehicle: at.Vehicle) -> at.Controller:
        raise MissingExtra("The controller 'nonlinear' needs CasADi: python -m pip install casadi")

    monkeypatch.setattr(registry._registry, "factories", registry._registry.factories | {"nonlinear": nonlinear})
    monkeypatch.setattr(registry, "_descriptions", registry._descriptions | {"nonlinear": About("of a plug-in")})
    result = run_cell(tiny(contenders=["nonlinear"]), config.Cell("nonlinear", "paper", "road"))
    assert not result["rows"]
    assert "pip install casadi" in result["left_out"]


# -- driven -----------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_all_contenders_drive_the_same_roads_with_the_same_noise_and_the_same_effort(tmp_path: Path):
    comparison = run_comparison(tiny(), tmp_path)
    rows = comparison.columns
    runs = {
        contender: sorted(zip(is_selected["road"].tolist(), is_selected["seed"].tolist(), strict=True))
        for contender in dict.fromkeys(zip(rows["contender"].tolist(), rows["tuning"].tolist(), strict=True))
        for at in [(rows["contender"] == contender[0]) & (rows["tuning"] == contender[1])]
        for is_selected in [{name: values[at] for name, values in rows.items()}]
    }
    assert len(runs) == 4  # both, with default and tuned
    assert len({tuple(cell) for cell in runs.values()}) == 1
    assert {cell["loops"] for cell in comparison.cells.values()} == {10}
    assert np.isfinite(rows["rms_error"]).all()
    assert pq.read_table(tmp_path / study.RUNS_FILE).num_rows == 2 * 2 * 2


@pytest.mark.compiled
def test_an_interrupted_comparison_goes_on_and_another_question_drives_anew(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    task, cells = tiny(budget=0), []

    def counted(task: config.ComparisonConfig, cell: config.Cell) -> dict[str, Any]:
        cells.append(cell)
        if len(cells) == 2:
            raise KeyboardInterrupt
        return run_cell(task, cell)

    monkeypatch.setattr(study, "run_cell", counted)
    with pytest.raises(KeyboardInterrupt):
        run_comparison(task, tmp_path)
    first = run_comparison(task, tmp_path)
    assert [cell.contender for cell in cells] == ["informed", "pure-pursuit", "pure-pursuit"]
    again = run_comparison(task, tmp_path)
    assert len(cells) == 3
    assert json.dumps(again.cells[cells[0]], sort_keys=True) == json.dumps(first.cells[cells[0]], sort_keys=True)
    run_comparison(tiny(budget=0, seeds=[0, 2]), tmp_path)
    assert len(cells) == 5
