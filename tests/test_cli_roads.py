"""`tune` and `evaluate` on roads: what is found goes back into `drive`, the comparison is one of the same runs."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.cli.app import app
from adaptrack.control.controllers.learned import LearnedCar
from adaptrack.drive.metrics import compute_metrics
from adaptrack.drive.simulate import rollout
from adaptrack.road import Comfort, load_road, plan_speed
from adaptrack.scenario import RoadDrive
from adaptrack.tuning.constant_file import ConstantTuning, load_tuning

pytestmark = pytest.mark.compiled
ROADS = ("mountain", "town", "--length", "200", "--vehicle", "midsize-sedan")


def run(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def answer(*arguments):
    done = run(*arguments, "--json")
    assert done.exit_code == 0, (done.output, done.exception)
    return json.loads(done.stdout)


@pytest.fixture(scope="module")
def tuned(tmp_path_factory):
    """What `tune` said, and its file."""
    file = tmp_path_factory.mktemp("tuned") / "own.toml"
    search = ("--controller", "lqr", "--runs", 160, "--noise-seeds", 2)
    return answer("tune", *ROADS, *search, "--lateral-acceleration", 4, "--out", file), file


def test_a_search_spends_the_runs_that_it_is_given_and_finds_no_worse_than_the_default(tuned):
    said, file = tuned
    assert said["runs"] == 160  # 40 tunings, 2 roads, 2 noise seeds
    assert said["cost"] <= said["default_cost"]
    assert said["better"] == (said["entries"] != said["default"])
    assert [row["contender"] for row in said["rows"]] == ["default", "tuned"]
    kept = load_tuning(file)
    assert kept.tuning == said["entries"]
    assert (kept.controller, kept.vehicle, kept.profile) == ("lqr", "midsize-sedan", "road")


def test_what_the_table_says_of_the_tuned_controller_is_what_its_drives_say(tuned):
    said, file = tuned
    kept, car = load_tuning(file), load_vehicle("midsize-sedan")
    from adaptrack.scenario.profile import load_profile

    law = kept.make(car, load_profile("road"), kept.period, preview=True)
    costs, squares, count = [], 0.0, 0
    for name in ("mountain", "town"):
        road = load_road(name, length=200.0)
        trip = RoadDrive(road, plan_speed(road, car, Comfort(lateral=4.0)))
        for seed in range(3):
            found = rollout(DualTrack(car), law, trip, profile="road", seed=seed)
            costs.append(compute_metrics(found).cost)
            squares, count = squares + float(np.sum(found.error**2)), count + len(found)
    (row,) = [row for row in said["rows"] if row["contender"] == "tuned"]
    assert row["cost_mean"] == pytest.approx(np.mean(costs), rel=1e-9)
    assert row["rms_error"] == pytest.approx(np.sqrt(squares / count), rel=1e-9)
    assert not set(kept.noise_seeds) & {0, 1, 2}


def test_a_drive_takes_the_tuning_back_and_says_where_it_was_found_for_another_car(tuned):
    said, file = tuned
    (row,) = answer("drive", "town", "--length", 200, "--vehicle", "midsize-sedan", "--tuning", file)["rows"]
    assert row["controller"] == "lqr, own"
    assert row["r"] == said["entries"]["r"]
    assert row["q_heading"] == said["entries"]["q_heading"]
    assert row["step_us_p50"] <= row["step_us_p999"] <= row["step_us_max"]
    assert row["prediction_error_one"] is None  # the law has no prediction model
    done = run("drive", "town", "--length", 200, "--tuning", file, "--controller", "informed", "--json")
    assert "found for the car 'midsize-sedan', not 'paper'" in done.stderr
    informed = json.loads(done.stdout)["rows"][0]
    assert 0.0 < informed["prediction_error_half"] < informed["prediction_error_one"] < 0.5


def test_an_evaluation_drives_all_on_the_same_roads_and_leaves_out_what_does_not_fit(tuned, tmp_path):
    _, file = tuned
    said = answer("evaluate", *ROADS, "--tuning", file, "--noise-seeds", 2, "--out", tmp_path)
    rows = {row["contender"]: row for row in said["rows"]}
    assert list(rows) == ["informed", "published", "lqr", "pure-pursuit", "stanley", "lqr, own"]
    assert said["reference"] == "informed"
    assert said["seeds"] == [7, 8]
    for row in rows.values():
        assert row["runs"] == 4
        assert row["failures"] == len(row["failed"])
        assert row["regret_low"] <= row["regret_geomean"] <= row["regret_high"]
        assert row["regret_geomean"] == pytest.approx(row["cost_geomean"] / rows["informed"]["cost_geomean"])
    assert "lqr, own" in (tmp_path / "index.html").read_text()
    short = ("town", "--length", 200, "--profile", "production", "--noise-seeds", 1)
    said = answer("evaluate", *short, "--vehicle", "midsize-sedan")
    assert "published" in said["left_out"]
    assert "published" not in [row["contender"] for row in said["rows"]]
    asked = run("evaluate", *short, "--contender", "published")
    assert "does not measure vy" in str(asked.exception)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["tune"], "adaptrack paper campaign NAME"),
        (["tune", "--config", "paper-grid"], "adaptrack paper campaign paper-grid --out DIR"),
        (["evaluate"], "adaptrack evaluate-schedules"),
        (["tune", "town", "--length", "200", "--controller", "nn"], "that of these can be sought: as-released"),
        (["tune", "town", "--length", "200", "--runs", "19"], "give at least 20"),
        (["evaluate", "town", "--length", "200", "--contender", "standrd"], "Did you mean 'standard'"),
        (["adapt", "town", "--out", "x"], "adaptrack tune town --out tuning.toml"),
    ],
)
def test_what_has_no_meaning_is_refused_with_what_to_type(arguments, words):
    done = run(*arguments)
    assert isinstance(done.exception, InvalidInput), done.output
    assert words in str(done.exception)


def test_what_was_learned_on_another_car_is_refused_with_the_key_to_change(tmp_path):
    sigmas = dict.fromkeys(("lag_sigma", "dead_time_sigma", "delay_sigma", "stiffness_sigma"), 0.05)
    LearnedCar(car="van", lag=0.1, dead_time=0.0, stiffness=1.0, **sigmas).to_toml(tmp_path / "learned.toml")
    refusal = run("drive", "town", "--vehicle", "midsize-sedan", "--learned", tmp_path / "learned.toml")
    assert "set car = '' (in its file" in str(refusal.exception)


def test_a_tuning_is_refused_for_another_car_and_for_the_noise_that_it_was_found_with(tuned):
    _, file = tuned
    assert "'midsize-sedan', not 'paper'" in str(run("evaluate", "town", "--length", 200, "--tuning", file).exception)
    same = ("evaluate", *ROADS, "--tuning", file, "--seed", 1001)
    assert "choose another --seed" in str(run(*same).exception)


def test_a_tuning_file_makes_the_controller_that_it_names(tmp_path):
    from adaptrack.scenario.profile import load_profile

    car, world = load_vehicle("van"), load_profile("road")
    tuning = {"Np": 25.0, "Nc": 7.0, "Q": 1.0, "R": 12.0}
    kept = ConstantTuning(controller="informed", vehicle="van", profile="road", period=0.05, tuning=tuning)
    kept.to_toml(tmp_path / "t.toml")
    assert load_tuning(tmp_path / "t.toml") == kept
    mpc = kept.make(car, world, world.period, preview=True)
    assert mpc.tuning.as_array().tolist() == [25.0, 7.0, 1.0, 12.0]
    with pytest.raises(InvalidInput, match="must be q_e, q_heading, r, preview_time"):
        kept.replace(controller="lqr", tuning={"q_e": 1.0}).make(car, world, world.period, preview=True)
    (tmp_path / "bad.toml").write_text('controller = "bang-bang"\nvehicle = "van"\nprofile = "road"\nperiod = 0.05\n'
                                       "[tuning]\nx = 1.0\n")  # fmt: skip
    with pytest.raises(ConfigError, match="bang-bang"):
        load_tuning(tmp_path / "bad.toml")
