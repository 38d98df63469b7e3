"""`adaptrack drive`: a newcomer's points to a page, failures that are loud, JSON rows."""

from __future__ import annotations

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from adaptrack.cli.app import app
from adaptrack.drive.trajectory import Trajectory
from adaptrack.road import generate_road

pytestmark = pytest.mark.compiled


@pytest.fixture(scope="module")
def points(tmp_path_factory):
    """A recorded road: every 3 m, with 5 cm of noise."""
    road, rng = generate_road("country", 3, 300.0), np.random.default_rng(0)
    places = road.at(np.arange(0.0, 300.0, 3.0))
    rows = np.stack([places.x, places.y], axis=-1) + 0.05 * rng.normal(size=(100, 2))
    path = tmp_path_factory.mktemp("road") / "recorded.csv"
    np.savetxt(path, rows, delimiter=",", header="x,y", comments="", fmt="%.3f")
    return path


def run(*arguments):
    return CliRunner().invoke(app, ["drive", *map(str, arguments)])


def test_recorded_points_become_a_page_with_a_replay(points, tmp_path):
    done = run(points, "--vehicle", "midsize-sedan", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    page = (tmp_path / "index.html").read_text()
    assert "adaptrackReplay" in page
    kept = Trajectory.load(tmp_path / "recorded-informed.parquet")
    assert np.abs(kept.error).max() < 0.3


def test_json_rows_have_the_keys_of_simulate_and_those_of_a_path(points):
    done = run(points, "--json", "--controller", "informed", "--controller", "stanley", "--speed", "12")
    assert done.exit_code == 0, done.output
    rows = json.loads(done.stdout)["rows"]
    assert [row["controller"] for row in rows] == ["informed", "stanley"]
    keys = {"scenario", "controller", "plant", "vehicle", "profile", "seed", "mse", "failed", "failed_at", "rms_error",
            "max_abs_error", "max_corner_error", "in_lane"}  # fmt: skip
    for row in rows:
        assert keys <= row.keys()
        assert row["failed"] is None
        assert row["rms_error"] == pytest.approx(row["mse"] ** 0.5)


def test_a_car_off_the_road_is_loud(points):
    done = run(points, "--speed", "60", "--json")
    assert done.exit_code == 3
    (row,) = json.loads(done.stdout)["rows"]
    assert row["failed"]
    assert row["failed_at"] > 0.0
    assert run(points, "--speed", "60", "--allow-failed").exit_code == 0


def test_laps_of_an_open_road_are_refused(points):
    from adaptrack.base.errors import InvalidInput

    done = run(points, "--laps", "2")
    assert isinstance(done.exception, InvalidInput)
    assert "--closed" in str(done.exception)


def test_a_road_given_to_simulate_is_told_the_command(points):
    done = CliRunner().invoke(app, ["drive", str(points)])
    assert "adaptrack drive" in str(done.exception)
