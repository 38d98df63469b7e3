"""A run shows itself: as a figure, as a table of pandas, and in a notebook."""

import re
import sys

import numpy as np
import pytest

import small_data
from adaptrack.base.errors import InvalidInput, MissingExtra
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.comparison.table import Comparison
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Constant, Learned
from adaptrack.drive.metrics import compute_metrics
from adaptrack.results.notebook import run_figure
from adaptrack.results.record import REPLAYED_SIGNALS, DrawnCar, DriveRecord
from adaptrack.results.record import on_road as place_on_road
from adaptrack.road import generate_road
from made_drives import trajectory


def driven(road, /, *, laps=1.0, offset=0.2, **more):
    """A run at 10 m/s, `offset` m to the left of the centre line."""
    t = 0.1 * np.arange(int(laps * road.length))
    place = road.at(10.0 * t)
    columns = {
        "t": t, "X": place.x - offset * np.sin(place.heading), "Y": place.y + offset * np.cos(place.heading),
        "psi": place.heading, "vx": np.full(t.size, 10.0), "v_ref": np.full(t.size, 10.0),
    }  # fmt: skip
    meta = {"scenario": "<lap>", "controller": "informed", "vehicle": {"name": "paper"}, "profile": "road"}
    return trajectory(columns | more, period=0.1, meta=meta)


@pytest.fixture(scope="module")
def lap():
    return generate_road("lap", seed=3, length=1200.0)


def test_a_run_of_two_laps_is_projected_lap_after_lap(lap):
    run = driven(lap, laps=2.0)
    record = DriveRecord.from_trajectory(run, lap, load_vehicle("paper"))
    assert record.run.road["station"] == pytest.approx(10.0 * run.t, abs=1e-6)
    assert record.offset == pytest.approx(np.full(len(run), 0.2), abs=1e-6)
    assert np.abs(place_on_road(run, lap).road["heading_error"]).max() < 1e-6
    assert record.failure is None
    assert record.shape == DrawnCar.of(load_vehicle("paper"))
    assert REPLAYED_SIGNALS["planned_speed"][0](record.run) == pytest.approx(10.0)


def test_a_run_that_ends_in_nan_is_cut_there_and_says_why_it_failed(lap):
    x = driven(lap).X.copy()
    x[40:] = np.nan
    record = DriveRecord.from_trajectory(driven(lap, X=x, failed="off-road", failed_at=3.9), lap)
    assert len(record.run) == 40
    assert record.failure.clause.startswith("left the road")
    assert record.failure.time == pytest.approx(3.9)
    with pytest.raises(InvalidInput, match="at least two instants"):
        DriveRecord.from_trajectory(driven(lap, X=np.full(x.size, np.nan)), lap)


def on_road(lap):
    """A run that knows its place on a road."""
    run = driven(lap)
    place = {"offset": 0.7, "heading_error": 0.1, "curvature": 0.0}
    return driven(lap, road={"station": run.t} | {name: np.full(len(run), value) for name, value in place.items()})


def test_what_a_run_knows_of_its_road_is_taken_from_it(lap):
    record = DriveRecord.from_trajectory(on_road(lap), lap)
    assert (record.run.road["station"][-1], record.offset[0]) == (record.run.t[-1], 0.7)


def test_a_run_along_a_road_is_drawn_without_its_lateral_position(lap):
    figure = on_road(lap).plot()
    assert [axes.get_title("left")[4:] for axes in figure.axes] == [
        "Tracking error", "Steering", "Speed", "Lateral acceleration",
    ]  # fmt: skip


@pytest.mark.drawn
def test_a_run_draws_itself_over_time_and_along_a_road(lap):
    run = driven(lap)
    assert run.plot().axes[0].get_title("left") == "(a) Trajectory tracking"
    titles = [axes.get_title("left")[4:] for axes in run_figure(run, lap).axes]
    assert titles[1:4] == ["Tracking error", "Steering", "Speed"]
    assert run.plot(lap)._repr_png_().startswith(b"\x89PNG")  # what a notebook shows


def test_a_notebook_shows_measures_and_a_picture_with_nothing_from_outside(lap):
    text = driven(lap)._repr_html_()
    assert "&lt;lap&gt;, Informed" in text
    assert "RMS error" in text
    assert "<lap>" not in text
    assert re.findall(r'src="(.{10})', text) == ["data:image"]


def test_to_pandas_without_pandas_says_what_to_install(lap, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtra, match="pip install pandas"):
        driven(lap).to_pandas()


def test_to_pandas_gives_a_row_an_instant_with_units(lap):
    pandas = pytest.importorskip("pandas")
    run = driven(lap)
    frame = run.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame["friction_front_left"].shape == (len(run),)
    assert frame.attrs["units"]["psi"] == "rad"


def contenders():
    """Two contenders, of which one costs half."""
    costs = {"best constant": np.full(9, 2e-3), "mine <b>": np.full(9, 1e-3)}
    return Comparison.from_runs(
        {name: {"cost": each, "failed": np.zeros(9)} for name, each in costs.items()}, "best constant"
    )


def objects():
    """What one looks at in a notebook, and words that are in what it shows."""
    rule = Learned({"Np": 30.0, "Nc": 4.0, "log10_ratio": -2.0}, ("speed", "friction"), [(3.0, 30.0), (0.3, 1.0)])
    return {
        "car": (load_vehicle("midsize-sedan"), ["midsize-sedan", "mass", "kg"]),
        "schedule": (rule, ["Input speed", "3.00 to 30.0 m/s", "Guard", "none"]),
        "constant": (Constant(Tuning(Np=20, Nc=4, Q=1.0, R=1.0)), ["Entry Np"]),
        "data": (small_data.small(), ["Operating points", "searched by swarms"]),
        "comparison": (contenders(), ["mine &lt;b&gt;", "0.500 (0.500 to 0.500); failed in 0"]),
    }


@pytest.mark.parametrize("which", ["car", "schedule", "constant", "data", "comparison"])
def test_what_one_looks_at_shows_numbers_and_a_picture_with_nothing_from_outside(which):
    shown, words = objects()[which]
    text = shown._repr_html_()
    assert all(each in text for each in words)
    assert re.findall(r'src="(.{10})', text) == ["data:image"]
    assert "http" not in text
    assert shown.plot()._repr_png_().startswith(b"\x89PNG")
    assert "object at 0x" not in repr(shown)


def test_measures_show_what_one_looks_at_first_and_all_behind_a_fold(lap):
    text = compute_metrics(driven(lap))._repr_html_()
    assert text.index("RMS error") < text.index("<details>") < text.index("qp solved")
