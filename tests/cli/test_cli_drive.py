"""`adaptrack drive`: scenarios and roads to rows and pages, failures that are loud, files that are told apart."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest

from adaptrack import load_scenario, load_vehicle
from adaptrack.base.errors import InvalidInput, UnknownName
from adaptrack.cli.places import is_road
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Constant
from adaptrack.drive.failure import Reason
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import generate_road

pytestmark = pytest.mark.compiled

ROW_KEYS = {
    "scenario", "controller", "plant", "tyre", "profile", "preview", "seed", "mse", "rms_error", "max_abs_error",
    "max_corner_error", "in_lane", "qp_capped", "qp_failed", "step_us_p50", "vehicle", "failed", "failed_at",
    "failed_because", "driven_length", "road_length",
}  # fmt: skip
FAILING = ["step", "-o", "friction=0.1", "-o", "speed=30", "-o", "wind=60", "-o", "duration=8"]


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    """A recorded road: every 3 m, with 5 cm of noise."""
    road, rng = generate_road("country", 3, 300.0), np.random.default_rng(0)
    places = road.at(np.arange(0.0, 300.0, 3.0))
    rows = np.stack([places.x, places.y], axis=-1) + 0.05 * rng.normal(size=(100, 2))
    path = tmp_path_factory.mktemp("road") / "recorded.csv"
    np.savetxt(path, rows, delimiter=",", header="x,y", comments="", fmt="%.3f")
    return path


@pytest.mark.drawn
def test_scenarios_have_rows_a_page_trajectories_and_where_asked_pictures(answer_of, tmp_path):
    words = ["step", "sine", "--controller", "as-written", "--controller", "lqr", "-o", "duration=2.0"]
    rows = answer_of("drive", *words, "--out", tmp_path / "a" / "b", "--png")["rows"]
    pairs = [("step", "as-written"), ("step", "lqr"), ("sine", "as-written"), ("sine", "lqr")]
    assert [(row["scenario"], row["controller"]) for row in rows] == pairs
    assert all(row.keys() >= ROW_KEYS and row["failed"] is None and row["road_length"] is None for row in rows)
    assert {row["profile"] for row in rows} == {"paper"}
    assert rows[0]["rms_error"] == pytest.approx(rows[0]["mse"] ** 0.5)
    names = {path.name for path in (tmp_path / "a" / "b").iterdir()}
    assert names >= {"index.html", "speed.png", "sine-tracking.png", "step-as-written.parquet", "sine-lqr.parquet"}


def test_recorded_points_are_driven_in_profile_road_to_a_page_with_a_replay(answer_of, points, tmp_path):
    result = answer_of("drive", points, "--vehicle", "midsize-sedan", "--out", tmp_path)
    (row,) = result["rows"]
    assert (row["profile"], row["preview"], row["failed"]) == ("road", True, None)
    assert row["driven_length"] == pytest.approx(row["road_length"], abs=5.0)
    assert sum(result["limits"]["shares"].values()) == pytest.approx(1.0)
    assert "adaptrackReplay" in (tmp_path / "index.html").read_text()
    assert np.abs(Trajectory.load(tmp_path / "recorded-informed.parquet").error).max() < 0.3


def test_a_scenarios_profile_decides_period_and_preview_unless_options_do(answer_of):
    for words, period, preview in (
        ([], 0.1, False),
        (["--profile", "road"], 0.05, True),
        (["--profile", "road", "--no-preview", "--period", "0.1"], 0.1, False),
    ):
        (row,) = answer_of("drive", "sine", "-o", "duration=1.0", *words)["rows"]
        assert (row["period"], row["preview"]) == (period, preview)


def test_failed_runs_are_loud_with_time_reason_and_code_3_unless_allowed(run_command):
    code, out, err = run_command("drive", *FAILING, "--controller", "informed", "--controller", "standard", "--json")
    rows = json.loads(out)["rows"]
    assert code == 3
    assert rows[0]["failed"] in list(Reason)
    assert rows[0]["mse"] is None
    sentence = f"FAILED step, informed: at {rows[0]['failed_at']:.2f} s the vehicle {rows[0]['failed_because']}."
    assert sentence in err
    assert err.count("FAILED ") == sum(row["failed"] is not None for row in rows)
    code, out, _ = run_command("drive", *FAILING, "--allow-failed")
    assert code == 0
    assert sentence in out
    assert "\x1b" not in out
    assert "matched_to" not in out, "the tyre is the model's"


def test_the_page_of_a_failed_run_begins_with_it(run_command, tmp_path):
    words = ["general-trajectory", "--profile", "road", "-o", "duration=15", "--controller", "standard"]
    code, out, _ = run_command("drive", *words, "--out", tmp_path, "--json")
    (row,) = json.loads(out)["rows"]
    assert (code, row["failed"]) == (3, "off-road")
    heading = f"Failed at {row['failed_at']:.1f} s: the vehicle left the road"
    page = (tmp_path / "index.html").read_text()
    assert re.search(rf"<title>{heading}[^<]* · General trajectory: standard</title>", page)
    assert re.search(rf"<h1><strong class=\"failed\">{heading}", page)


def test_a_failed_car_whose_model_and_tyre_disagree_is_shown_the_remedy(run_command, tmp_path):
    numbers = {"mass": 1500.0, "yaw_inertia": 2500.0, "lf": 1.1, "lr": 1.6, "stiffness_front": 15000.0,
               "stiffness_rear": 60000.0}  # fmt: skip
    (tmp_path / "soft.toml").write_text("".join(f"{name} = {value}\n" for name, value in numbers.items()))
    words = ["double-lane-change", "-o", "speed=27", "--profile", "road", "--vehicle", tmp_path / "soft.toml"]
    code, out, _ = run_command("drive", *words)
    assert code == 3
    assert re.search(r"is 15000 N/rad.* is 79\d+ and 59\d+ N/rad.*stiffness_front.*matched_to", " ".join(out.split()))


def test_the_steering_model_is_printed_with_its_sources_and_kept_in_the_rows(output_of, answer_of):
    words = ["sine", "-o", "duration=1.0", "--profile", "road"]
    out = output_of("drive", *words, "--vehicle", "midsize-sedan")
    assert "lag 0.15 s, dead time 0 s, computation 0.05 s (profile road)" in out
    assert "rate 0.4 rad/s, limit 1.066 rad (car file midsize-sedan)" in out
    assert "The simulated steering differs" in out
    rows = answer_of("drive", *words, "--controller", "informed", "--controller", "standard")["rows"]
    beliefs = [row["belief"] for row in rows]
    assert "profile road" in beliefs[0]
    assert beliefs[1] is None


def test_files_of_scenario_car_and_scheduler_are_driven_under_their_names(answer_of, tmp_path):
    load_scenario("sine", duration=1.0).to_toml(tmp_path / "mine.toml")
    load_vehicle("midsize-sedan").to_toml(tmp_path / "car.toml")
    Constant(Tuning(30, 5, 1.0, 4000.0), name="nn").save(tmp_path / "fast.json")
    files = (tmp_path / "mine.toml", "--vehicle", tmp_path / "car.toml", "--scheduler", tmp_path / "fast.json")
    rows = answer_of("drive", *files, "--controller", "standard", "--controller", "as-written")["rows"]
    assert [(row["vehicle"], row["controller"]) for row in rows] == [("car", "fast"), ("car", "fast-as-written")]


SCENARIO, ROAD = "duration = 1.0\nreference = 0.0\nspeed = 10.0\n", "points = [[0.0, 0.0], [50.0, 0.0]]\n"
BOTH = r"as a scenario, and .* as a road: remove one"


@pytest.mark.parametrize(("file", "text", "reading"), [
    ("a.toml", SCENARIO, False),
    ("a.toml", ROAD, True),
    ("a.toml", 'name = "empty"\n', True),
    ("a.toml", SCENARIO + ROAD, BOTH),
    ("a.csv", "t,y_ref,speed,friction,wind_y\n0,0,10,0.9,0\n", False),
    ("a.csv", "x,y\n0,0\n", True),
    ("a.csv", "t,x,y\n0,0,0\n", True),
    ("a.csv", "0.0,0.0\n1.0,0.0\n", True),
    ("a.csv", "t,y_ref,x,y\n0,0,0,0\n", BOTH),
])  # fmt: skip
def test_a_file_with_a_scenarios_keys_or_columns_is_a_scenario_otherwise_a_road_and_never_both(
    tmp_path, file, text, reading
):
    (tmp_path / file).write_text(text)
    if reading is not BOTH:
        assert is_road(str(tmp_path / file)) == reading
        return
    with pytest.raises(InvalidInput, match=BOTH):
        is_road(str(tmp_path / file))


def test_a_name_of_a_scenario_and_of_a_road_is_refused(monkeypatch):
    monkeypatch.setattr("adaptrack.list_scenarios", lambda: {"town": ""})
    with pytest.raises(InvalidInput, match="is the name of both a scenario and a road"):
        is_road("town")
    with pytest.raises(UnknownName, match="no scenario or road is named 'twon'"):
        is_road("twon")


def test_a_drive_behind_a_planner_says_how_it_keeps_to_road_and_plan(output_of, answer_of, tmp_path):
    words = [
        "country",
        "--road-seed",
        1,
        "--length",
        300,
        "--vehicle",
        "midsize-sedan",
        "--start",
        0,
        "--stop",
        "100:1",
    ]
    words += ["--planner", "delay=0.1,jitter=0.05"]
    assert re.search(
        r"RMS error, .* RMS speed error; 1 stop, largest error", output_of("drive", *words, "--out", tmp_path)
    )
    (row,) = answer_of("drive", *words)["rows"]
    assert row["failed"] is None
    assert row["rms_error"] < 0.05
    assert abs(row["time_lost"]) < 1.0
    run = Trajectory.load(tmp_path / "country-1-informed.parquet")
    assert run.diagnostics["late"].shape == run.t.shape


# -- speed ------------------------------------------------------------------------------------------------------------
def test_a_drive_with_speed_control_says_its_speed_error_stops_and_delay_and_shows_what_limits_it(
    output_of, answer_of, tmp_path
):
    words = ["country", "--road-seed", 1, "--length", 300, "--vehicle", "midsize-sedan", "--speed-control"]
    words += ["--assumed-friction", "0.6:1", "--start", 0, "--stop", "100:1", "--stop", "300:2"]
    out = output_of("drive", *words, "--out", tmp_path)
    assert re.search(r"RMS error, .* m/s RMS speed error; 2 stops, largest error .* cm; .* s late\.", out)
    text = (tmp_path / "index.html").read_text()
    panels = ("Longitudinal acceleration", "Used share of the assumed grip", "Speed limited by", "assumed interval")
    assert all(panel in text for panel in panels)
    assert [text.count(f"Stop at {place}&nbsp;m") for place in (100, 300)] == [1, 1]
    (row,) = answer_of("drive", *words)["rows"]
    assert [stop["place"] for stop in row["stops"]] == pytest.approx([100.0, 300.0], abs=0.5)
    assert max(abs(stop["error"]) for stop in row["stops"]) == pytest.approx(row["stop_error"])
    assert row["stop_error"] < 0.5 < row["time_lost"]
    run = Trajectory.load(tmp_path / "country-1-informed.parquet")
    assert run.vx[0] == 0.0
    assert "limited_by" in run.diagnostics
