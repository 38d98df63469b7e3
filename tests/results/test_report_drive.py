"""The page on a drive along a road: its pictures, the data of its replay, and where the car was."""

import base64
import dataclasses
import json
import re

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import list_vehicles, load_vehicle
from adaptrack.results import record
from adaptrack.results.drive import drive_result, write_drive_page
from adaptrack.results.record import (
    DrawnCar,
    DriveRecord,
    above_picture,
    offset_scale,
    outline_stations,
    pack_column,
    replay_data,
    sample_indices,
)  # fmt: skip
from adaptrack.results.run_pictures import thin_curve, tracking_picture
from adaptrack.results.style import print_figure
from adaptrack.road import Line, Road, generate_road
from made_drives import PERIOD, bend, made_drive, made_run
from pictures import pictures

FAILED = {"failed": "off-road", "failed_at": 4.0}


def unpacked(column):
    """What the page's script makes of a packed column."""
    steps = np.frombuffer(base64.b64decode(column["bytes"]), f"<i{column['size']}")
    return (column["first"] + np.cumsum(steps, dtype=np.int64)) * column["unit"]


def test_a_page_holds_verdict_measures_pictures_replay_and_command_and_needs_nothing_else(tmp_path):
    road = bend()
    runs = [made_run(road), made_run(road, controller="stanley", seconds=4.05, amplitude=0.6, **FAILED)]
    with pictures(drawn=True):
        text = write_drive_page(tmp_path, runs, command="adaptrack drive bend.csv --out <here>").read_text()
    parts = ['class="verdict replayed"', 'id="replay-view"', "<caption>Tracking", "Lateral acceleration. "]
    parts.append("&lt;here&gt;")
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["above.png", "bend-tracking.png", "index.html"]
    assert "1 of 2 runs failed" in text
    assert "Failed: Bend, Stanley, at 4.0 s, at s = 40.00 m; the vehicle left the road (more than 5 m" in text
    assert not re.search(r"https?://|@import|url\((?!#)|<link[^>]+stylesheet|<script[^>]+src", text)
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))


def test_names_from_files_cannot_break_the_page(tmp_path):
    nasty = '</script><script>alert("1")</script>'
    road = dataclasses.replace(bend(), name=nasty)
    text = write_drive_page(tmp_path, [made_run(road, controller=nasty)]).read_text()
    assert text.count("<script") == text.count("</script>") == 2
    (data,) = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', text, flags=re.DOTALL)
    assert json.loads(data)["road"]["name"] == nasty


def test_the_replay_holds_what_was_driven_to_half_of_its_units():
    drive = made_drive(generate_road("mountain", seed=1, length=1500.0))
    (car,) = replay_data({"informed": drive})["cars"]
    for name, (read, unit) in record.REPLAYED_SIGNALS.items():
        assert np.abs(unpacked(car["columns"][name]) - read(drive.run)).max() <= 0.5 * unit + 1e-9
    assert car["outline"]["front"] + car["outline"]["rear"] == pytest.approx(drive.shape.outline.length)


def test_a_wrapped_yaw_is_replayed_without_a_turn():
    drive = made_drive()
    wrapped = np.remainder(drive.run.psi + 2.0 + np.pi, 2.0 * np.pi) - np.pi
    turning = dataclasses.replace(drive, run=dataclasses.replace(drive.run, psi=wrapped))
    (car,) = replay_data({"informed": turning})["cars"]
    assert np.abs(np.diff(unpacked(car["columns"]["yaw"]))).max() < 0.1


@pytest.mark.parametrize(("jump", "size"), [(0.1, 1), (30.0, 2), (1e6, 4)])
def test_a_column_takes_the_fewest_bytes_that_hold_its_steps(jump, size):
    values = np.array([5e6, 5e6 + jump, 5e6])
    column = pack_column(values, 1e-3)
    assert column["size"] == size
    assert unpacked(column) == pytest.approx(values, abs=1e-6)


def test_a_jump_beyond_all_bytes_is_refused():
    with pytest.raises(InvalidInput, match="jumps by 1e\\+07"):
        pack_column(np.array([0.0, 1e7]), 1e-3)


def test_a_thinned_curve_keeps_its_peaks(rng):
    values = rng.normal(size=50_000)
    values[31_234] = 40.0
    keep = thin_curve(values)
    assert (values[keep].min(), values[keep].max()) == (values.min(), 40.0)
    assert (keep[0], keep[-1]) == (0, values.size - 1)


def test_drawn_edges_lie_within_a_centimetre_of_the_road():
    road = generate_road("town", seed=2, length=1000.0)
    s = outline_stations(road, 0.0, road.length)
    middle = 0.5 * (s[:-1] + s[1:])
    x, y = (np.interp(middle, s, values) for values in road.at(s)[:2])
    true = road.at(middle)
    assert np.hypot(x - true.x, y - true.y).max() < 0.0125
    assert s.size < road.length


def test_edges_are_drawn_where_the_width_changes():
    road = bend(width_left=([0.0, 30.0, 31.0], [1.75, 1.75, 4.0]))
    assert {30.0, 31.0} <= set(outline_stations(road, 0.0, road.length).tolist())


def test_the_picture_from_above_is_to_scale_and_coloured_by_the_offset():
    road = bend()
    figure = print_figure(above_picture({"a": made_drive(road), "b": made_drive(road, amplitude=1.0)}))
    figure.draw_without_rendering()  # settles the layout
    small, large = figure.axes[:2]
    assert [axes.get_title("left") for axes in (small, large)] == ["(a) a", "(b) b"]
    (strokes,) = (collection for collection in large.collections if collection.get_array() is not None)
    assert strokes.get_array().max() == pytest.approx(1.0, rel=0.01)
    for axes in (small, large):
        box = axes.get_window_extent()
        width, height = np.diff(axes.get_xlim())[0], np.diff(axes.get_ylim())[0]
        assert box.width / width == pytest.approx(box.height / height, rel=1e-6)


@pytest.mark.parametrize("name", list_vehicles())
def test_axles_lie_inside_the_drawn_body(name):
    shape = DrawnCar.of(load_vehicle(name))
    assert shape.lf < shape.outline.front
    assert shape.lr < shape.outline.rear
    assert max(shape.track_front, shape.track_rear) < shape.outline.width


def test_along_a_road_the_signals_are_drawn_over_the_station():
    run = made_run(v_ref=np.full(len(made_drive().run), 11.0))
    figure = print_figure(tracking_picture({"a": run.trajectory}))
    titles = [axes.get_title("left")[4:] for axes in figure.axes]
    assert titles == ["Tracking error", "Steering", "Speed", "Lateral acceleration"]
    assert figure.axes[-1].get_xlabel() == "Station s (m)"
    assert {float(line.get_ydata()[0]) for line in figure.axes[2].get_lines()} >= {10.0, 11.0}


def test_the_end_of_a_failed_drive_does_not_flatten_the_rest():
    run = made_run(seconds=10.0, failed="spun", failed_at=9.95).trajectory
    offset = run.road["offset"].copy()
    offset[-3:] = [2.0, 4.0, 8.0]
    leaving = dataclasses.replace(run, road={**run.road, "offset": offset})
    assert print_figure(tracking_picture({"a": leaving})).axes[0].get_ylim()[1] < 1.5
    failed = DriveRecord.from_trajectory(leaving, bend())
    assert offset_scale([failed]) == pytest.approx(0.3)


@pytest.mark.parametrize("amplitude", [0.004, 0.07, 0.33, 1.0])
def test_the_colours_reach_just_beyond_the_largest_error_of_the_drives_that_did_not_fail(amplitude):
    drive, failed = made_drive(amplitude=amplitude), made_drive(amplitude=3.0, failed="spun", failed_at=5.0)
    top = offset_scale([drive, failed])
    assert drive.max_offset <= top <= max(0.05, 1.5 * drive.max_offset)


def test_a_long_drive_is_thinned_and_replayed_at_20_hz():
    road = Road.from_segments([Line(length=2000.0)])
    run = made_drive(road).run
    drive = dataclasses.replace(made_drive(road), run=dataclasses.replace(run, t=0.2 * run.t, period=0.2 * PERIOD))
    assert sample_indices(drive).size == pytest.approx(len(run) / 5, abs=2)
    assert len(json.dumps(replay_data({"informed": drive}))) < 20_000
    assert thin_curve(drive.offset, 100).size <= 102


def test_drives_on_different_roads_are_refused():
    with pytest.raises(InvalidInput, match="all of them the same Road object"):
        drive_result([made_run(), made_run()])
