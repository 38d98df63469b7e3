"""What draws a drive in the browser, replayed and while it is driven: it shows and tells the numbers it is given."""

from pathlib import Path

import numpy as np
import pytest
from tests.results.test_replay import ask_page

from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.results.drive import write_drive_page
from made_drives import bend, made_drive, made_run, recorded

pytestmark = pytest.mark.needs("chromium")


def predicted_of(drive, ahead=1.0, points=8):
    """Paths that foretell where the car will be, up to so many seconds ahead."""
    paths = PredictedPaths(points=points)
    paths._time = list(drive.run.t[::5][:-4])
    later = np.add.outer(np.array(paths._time), np.linspace(ahead / points, ahead, points))
    paths._points = list(np.stack([np.interp(later, drive.run.t, v) for v in (drive.run.X, drive.run.Y)], axis=-1))
    return paths


@pytest.fixture(scope="module")
def runs():
    road = bend()
    first = made_drive(road, controller="informed", amplitude=0.5)
    return [
        made_run(road, controller="informed", amplitude=0.5, predicted=predicted_of(first)),
        made_run(road, controller="stanley", amplitude=1.0, v_ref=np.full(len(first.run), 11.0)),
    ]


@pytest.fixture(scope="module")
def drives(runs):
    return [recorded(run) for run in runs]


@pytest.fixture(scope="module")
def answers(tmp_path_factory, runs):
    page = write_drive_page(tmp_path_factory.mktemp("viewer") / "out", runs, png=False)
    return ask_page(page, (Path(__file__).parents[1] / "viewer" / "replay.js").read_text())


def test_a_thinned_line_keeps_its_extremes(answers):
    for line in answers["thinned"]:
        assert [line["low"], line["high"]] == line["all"][1:]
        assert line["drawn"] <= line["all"][0]
        assert line["grows"]


def test_one_cursor_goes_through_all_plots_and_the_road(answers, drives):
    cursor, drive = answers["cursor"], drives[0]
    assert cursor["t"] == 4.0
    assert cursor["shown"] == pytest.approx(9.13, abs=0.02)
    assert cursor["now"] == pytest.approx([cursor["shown"]] * 3, abs=0.006)
    assert cursor["place"]["x"] == pytest.approx(np.interp(cursor["shown"], drive.run.t, drive.run.X), abs=5e-3)
    assert cursor["words"] == f"{cursor['shown']:.2f} s"
    numbers = [[float(text.replace("−", "-").split()[0].rstrip("°")) for text in plot] for plot in cursor["texts"]]
    at = cursor["shown"]
    assert numbers[0] == pytest.approx([np.interp(at, drive.run.t, drive.offset) for drive in drives], abs=2e-3)
    assert numbers[1][:2] == pytest.approx([np.degrees(np.interp(at, drive.run.t, drive.run.steering))] * 2, abs=0.02)
    assert numbers[2] == pytest.approx([10.0] * 3, abs=0.02)
    assert answers["left"]["shown"] == 4.0
    assert answers["left"]["x"] == pytest.approx(np.interp(4.0, drive.run.t, drive.run.X), abs=5e-3)
    assert answers["onRoad"] == pytest.approx(6.0, abs=0.11)


def test_what_is_shown_is_told_in_words(answers, drives):
    road, error = answers["said"]
    e = float(np.interp(5.0, drives[0].run.t, drives[0].offset))
    assert f"Informed is {abs(e):.2f} m to the {'left' if e > 0 else 'right'} of its line" in road
    assert "at 10.0 m/s" in road
    low, high = (pick(drives[0].offset) for pick in (np.min, np.max))
    assert f"Error at 5.00 s: Informed {e:.3f} m".replace("-", "−") in error
    assert f"Informed: from −{-low:.3f} m at " in error
    assert f"to {high:.3f} m" in error
    assert road in answers["aloud"]
    assert error in answers["aloud"]


def test_the_predicted_path_lies_where_it_was_predicted(answers, drives):
    paths = drives[0].predicted
    k = int(np.argmin(np.abs(paths.time - 5.0)))
    path = np.column_stack([answers["predicted"][name] for name in "xy"])
    assert path == pytest.approx(paths.points[k], abs=0.02)
    assert answers["none"] is None
    assert answers["late"] is None
