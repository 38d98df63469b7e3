"""`tune` and `compare` on roads: a tuning goes back into `drive` and `compare`, judged on the same runs."""

from __future__ import annotations

import json
from functools import partial

import numpy as np
import pytest
from typer.testing import CliRunner

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.cli.app import app
from adaptrack.drive.simulate import rollout
from adaptrack.drive.world import ROAD_DRIVER
from adaptrack.road import load_road, plan_speed
from adaptrack.scenario import RoadDrive
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.constant import ConstantTuning, load_tuning

pytestmark = pytest.mark.compiled
ROADS = ("mountain", "town")


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def answer(*arguments):
    process = run(*arguments, "--json")
    assert process.exit_code == 0, (process.output, process.exception)
    return json.loads(process.stdout)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """The JSON of `tune`, and its file."""
    folder = tmp_path_factory.mktemp("tuned")
    roads = [word for road in ROADS for word in ("--road", road)]
    search = ("--length", 200, "--controller", "lqr", "--runs", 160)
    return answer("tune", "midsize-sedan", *roads, *search, "--out", folder), folder / "tuning.toml"


def test_a_search_spends_the_runs_that_it_is_given_and_finds_no_worse_than_the_default(tuned):
    result, file = tuned
    assert result["runs"] == 160  # 40 tunings, 2 roads, 2 noise seeds
    assert result["cost"] <= result["default_cost"]
    assert result["better"] == (result["entries"] != result["default"])
    assert {row["label"] for row in result["rows"]} == {"default", "tuned"}
    tuning = load_tuning(file)
    assert tuning.tuning == result["entries"]
    assert (tuning.controller, tuning.vehicle, tuning.profile) == ("lqr", "midsize-sedan", "road")


def test_the_table_of_the_tuned_controller_is_that_of_its_drives(tuned):
    result, file = tuned
    car, profile = load_vehicle("midsize-sedan"), load_profile("road")
    controller = load_tuning(file).make(car, profile, profile.period, preview=True)
    errors = []
    for name in ROADS:
        road = load_road(name, length=200.0)
        drive = RoadDrive(road, plan_speed(road, car))
        run_with = partial(rollout, DualTrack(car), controller, drive, profile="road", driver=ROAD_DRIVER)
        runs = [run_with(seed=seed) for seed in range(3)]
        errors += [np.mean(run.error**2) for run in runs]
    (row,) = [row for row in result["rows"] if row["label"] == "tuned"]
    assert row["rms_error"] == pytest.approx(np.sqrt(np.mean(errors)), rel=1e-9)
    assert row["runs"] == 6
    assert not set(load_tuning(file).noise_seeds) & {0, 1, 2}


def test_a_drive_takes_the_tuning_back_and_warns_of_another_car(tuned):
    result, file = tuned
    (row,) = answer("drive", "town", "--length", 200, "--vehicle", "midsize-sedan", "--tuning", file)["rows"]
    assert row["controller"] == "lqr, tuning"
    assert row["r"] == result["entries"]["r"]
    process = run("drive", "town", "--length", 200, "--tuning", file, "--controller", "informed", "--json")
    assert "found for the car 'midsize-sedan', not 'paper'" in process.stderr
    informed = json.loads(process.stdout)["rows"][0]
    assert 0.0 < informed["prediction_error_half"] < informed["prediction_error_one"] < 0.5


def test_compare_drives_all_on_the_same_roads_and_leaves_out_what_does_not_fit(tuned, tmp_path):
    _, file = tuned
    options = ("--length", 200, "--vehicle", "midsize-sedan", "--tuning", file, "--seeds", 2)
    result = answer("compare", *ROADS, *options, "--out", tmp_path)
    rows = {row["label"]: row for row in result["profiles"]["road"]}
    defaults = {f"{name}, default" for name in ("informed", "published", "lqr", "pure-pursuit", "stanley")}
    assert set(rows) == {*defaults, f"lqr, {file}"}
    assert not result["left_out"]
    for row in rows.values():
        assert row["runs"] == 4
        assert row["cost_low"] <= row["cost_ratio"] <= row["cost_high"]
    assert rows["informed, default"]["cost_ratio"] == 1.0
    assert f"lqr, {file}" in (tmp_path / "index.html").read_text()
    result = answer("compare", "town", *options, "--profile", "production")
    reasons = {cell["contender"]: cell["why"] for cell in result["left_out"]}
    assert "does not measure vy" in reasons["published"]
    assert "was found for the profile 'road', not 'production'" in reasons[str(file)]


def test_a_tuning_file_makes_the_controller_that_it_names(tmp_path):
    car, profile = load_vehicle("van"), load_profile("road")
    entries = {"Np": 25.0, "Nc": 7.0, "Q": 1.0, "R": 12.0}
    tuning = ConstantTuning(controller="informed", vehicle="van", profile="road", period=0.05, tuning=entries)
    tuning.to_toml(tmp_path / "t.toml")
    assert load_tuning(tmp_path / "t.toml") == tuning
    mpc = tuning.make(car, profile, profile.period, preview=True)
    assert mpc.tuning.as_array().tolist() == [25.0, 7.0, 1.0, 12.0]
    with pytest.raises(InvalidInput, match="must be q_e, q_heading, r, preview_time"):
        tuning.replace(controller="lqr", tuning={"q_e": 1.0}).make(car, profile, profile.period, preview=True)
    (tmp_path / "bad.toml").write_text('controller = "bang-bang"\nvehicle = "van"\nprofile = "road"\nperiod = 0.05\n'
                                       "[tuning]\nx = 1.0\n")  # fmt: skip
    with pytest.raises(ConfigError, match="bang-bang"):
        load_tuning(tmp_path / "bad.toml")
