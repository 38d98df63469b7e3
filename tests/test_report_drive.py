"""The page on drives says what came of them; its pictures, data and records hold what was driven."""

import base64
import dataclasses
import json
import re

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import list_vehicles, load_vehicle
from adaptrack.results import drive_figures, style
from adaptrack.results.drive import outcome, write_drive_page
from adaptrack.results.drive_figures import above_figure, along_figure, labelled, outline_stations, scale_of, thinned
from adaptrack.results.record import DrawnCar, DriveRecord, Measure
from adaptrack.results.replay import UNITS, packed, replay_data, sampled
from adaptrack.road import Line, Road, generate_road
from made_drives import PERIOD, SPEED, bend, made_drive
from pictures import pictures

FAILED = {"failed": "left the road (more than 5 m from the reference)", "failed_at": 4.0}


def unpacked(column):
    """What the page's script makes of a packed column."""
    steps = np.frombuffer(base64.b64decode(column["bytes"]), f"<i{column['size']}")
    return (column["first"] + np.cumsum(steps, dtype=np.int64)) * column["unit"]


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    folder = tmp_path_factory.mktemp("drive")
    road = bend()
    drives = [
        made_drive(road, controller="informed", metrics=[Measure("Jerk RMS", 0.5, "m/s³")]),
        made_drive(road, controller="stanley", seconds=4.05, amplitude=0.6, **FAILED),
    ]
    with pictures(drawn=True):
        path = write_drive_page(folder, drives, command="adaptrack drive bend.csv --out <here>")
    return folder, path.read_text(encoding="utf-8")


def test_a_page_holds_verdict_pictures_replay_measures_and_command_in_this_order(page):
    folder, text = page
    parts = ['class="verdict"', "Offset from the centre line", ">Along the road</h2>", 'id="replay-view"', "Jerk RMS"]
    places = [text.index(part) for part in [*parts, "adaptrack drive bend.csv --out &lt;here&gt;"]]
    assert places == sorted(places)
    assert sorted(path.name for path in folder.iterdir()) == ["above.png", "along.png", "index.html"]


def test_the_page_of_a_drive_needs_nothing_but_itself(page):
    _, text = page
    assert not re.search(r"https?://|@import|url\((?!#)|<link[^>]+stylesheet|<script[^>]+src", text)
    ids = re.findall(r'\bid="([^"]+)"', text)
    assert len(ids) == len(set(ids))


def test_a_failed_drive_is_told_with_reason_time_and_station(page):
    _, text = page
    assert "1 of 2 drives failed" in text
    assert "Failed at 4.0 s, at s = 40.00 m: the vehicle left the road (more than 5 m from the reference)." in text
    drive = made_drive(seconds=4.05, **FAILED)
    assert drive.failed_station == pytest.approx(40.0)


def test_the_outcome_says_how_far_a_drive_went():
    assert outcome(made_drive()).startswith("Driven to the end: 182.5 m in 18.2 s")
    assert outcome(made_drive(seconds=5.0)) == "Not failed, ended early: 49.50 m in 4.95 s; the road is 182.8 m long."
    lap = generate_road("lap", seed=0, length=1500.0)
    two = made_drive(lap, seconds=2.0 * lap.length / SPEED)
    assert outcome(two).endswith("2.00 laps.")


def test_names_from_files_cannot_break_the_page(tmp_path):
    nasty = '</script><script>alert("1")</script>'
    road = dataclasses.replace(bend(), name=nasty)
    text = write_drive_page(tmp_path, [made_drive(road, controller=nasty, car=nasty)]).read_text()
    assert text.count("<script") == text.count("</script>") == 2
    (data,) = re.findall(r'<script type="application/json"[^>]*>(.*?)</script>', text, flags=re.DOTALL)
    assert json.loads(data)["road"]["name"] == nasty


def test_the_replay_holds_what_was_driven_to_half_of_its_units():
    drive = made_drive(generate_road("mountain", seed=1, length=1500.0))
    assert set(UNITS) - set(replay_data(labelled([drive]))["cars"][0]["columns"]) == {"planned_speed"}  # none is known
    drive = dataclasses.replace(drive, planned_speed=drive.speed + 0.5)
    (car,) = replay_data(labelled([drive]))["cars"]
    for name, unit in UNITS.items():
        assert np.abs(unpacked(car["columns"][name]) - getattr(drive, name)).max() <= 0.5 * unit + 1e-9
    assert car["outline"]["front"] + car["outline"]["rear"] == pytest.approx(drive.shape.outline.length)


def test_a_wrapped_yaw_is_replayed_without_a_turn():
    drive = made_drive()
    turning = dataclasses.replace(drive, yaw=np.remainder(drive.yaw + 2.0 + np.pi, 2.0 * np.pi) - np.pi)
    (car,) = replay_data(labelled([turning]))["cars"]
    assert np.abs(np.diff(unpacked(car["columns"]["yaw"]))).max() < 0.1


@pytest.mark.parametrize(("jump", "size"), [(0.1, 1), (30.0, 2), (1e6, 4)])
def test_a_column_takes_the_fewest_bytes_that_hold_its_steps(jump, size):
    values = np.array([5e6, 5e6 + jump, 5e6])
    column = packed(values, 1e-3)
    assert column["size"] == size
    assert unpacked(column) == pytest.approx(values, abs=1e-6)


def test_a_jump_beyond_all_bytes_is_refused():
    with pytest.raises(InvalidInput, match="jumps by 1e\\+07"):
        packed(np.array([0.0, 1e7]), 1e-3)


def test_the_replay_of_an_hour_at_100_hz_holds_20_hz_in_less_than_two_megabytes():
    n = 360_000
    s = 0.2 * np.arange(n)
    road = Road.from_segments([Line(length=s[-1] + 10.0)])
    wave = 0.1 * np.sin(0.01 * s)
    zero = np.zeros(n)
    drive = DriveRecord(
        road=road, shape=DrawnCar.of(load_vehicle("paper")), time=0.01 * np.arange(n), station=s, x=s, y=wave,
        yaw=0.001 * np.cos(0.01 * s), speed=20.0 + wave, offset=wave, heading_error=zero, steering=0.01 * wave,
        command=zero, lateral_acceleration=zero,
    )  # fmt: skip
    assert sampled(drive).size == n // 5 + 1
    assert len(json.dumps(replay_data(labelled([drive])))) < 2_000_000
    assert thinned(drive.offset).size <= drive_figures.MOST + 2


def test_a_thinned_curve_keeps_its_peaks(rng):
    values = rng.normal(size=50_000)
    values[31_234] = 40.0
    keep = thinned(values)
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


@pytest.mark.drawn
def test_the_picture_from_above_is_to_scale_and_coloured_by_the_offset():
    road = bend()
    figure = above_figure([made_drive(road, controller="a"), made_drive(road, controller="b", amplitude=1.0)])
    style.png(figure)  # settles the layout
    small, large = figure.axes[:2]
    assert [axes.get_title("left") for axes in (small, large)] == ["(a) A", "(b) B"]
    (strokes,) = (each for each in large.collections if each.get_array() is not None)
    assert strokes.get_array().max() == pytest.approx(1.0, rel=0.01)
    for axes in (small, large):
        box = axes.get_window_extent()
        width, height = np.diff(axes.get_xlim())[0], np.diff(axes.get_ylim())[0]
        assert box.width / width == pytest.approx(box.height / height, rel=1e-6)


def test_the_figure_along_the_road_has_offset_steering_and_speed():
    figure = along_figure([made_drive(planned_speed=np.full(made_drive().time.size, 11.0))])
    assert [axes.get_title("left")[4:] for axes in figure.axes] == ["Offset", "Steering", "Speed"]
    speeds = {float(line.get_ydata()[0]) for line in figure.axes[2].get_lines()}
    assert {10.0, 11.0} <= speeds


def test_how_a_drive_left_the_road_does_not_flatten_the_rest():
    drive = made_drive(seconds=10.0, failed="spun", failed_at=9.95)
    offset = drive.offset.copy()
    offset[-3:] = [2.0, 4.0, 8.0]
    figure = along_figure([dataclasses.replace(drive, offset=offset)])
    assert figure.axes[0].get_ylim()[1] < 1.5
    assert scale_of([drive]) == 0.5


def test_drives_on_different_roads_are_refused():
    with pytest.raises(InvalidInput, match="one road"):
        labelled([made_drive(), made_drive()])
    with pytest.raises(InvalidInput, match="at least one"):
        labelled([])


def test_controllers_of_one_name_are_numbered():
    road = bend()
    drives = [made_drive(road, controller=name) for name in ("stanley", "informed", "stanley")]
    assert list(labelled(drives)) == ["Stanley no. 1", "Informed", "Stanley no. 2"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"offset": lambda n: np.full(n, np.nan)}, "`offset` holds a value that is not finite"),
        ({"yaw": lambda n: np.zeros(3)}, "`yaw` must have the shape"),
        ({"time": np.zeros}, "`time` must grow"),
        ({"failed": lambda n: "spun"}, "go together"),
    ],
)
def test_a_record_that_cannot_be_is_refused(change, message):
    n = len(made_drive())
    with pytest.raises(InvalidInput, match=message):
        made_drive(**{name: make(n) for name, make in change.items()})


def test_the_errors_of_a_record_are_those_of_its_offsets():
    drive = made_drive(seconds=2.0 * np.pi, amplitude=0.3)  # one period of the sine
    assert drive.rms_offset == pytest.approx(0.3 / np.sqrt(2.0), rel=0.01)
    assert drive.max_offset == pytest.approx(0.3, rel=1e-3)
    assert drive.p95_offset == pytest.approx(0.3 * np.sin(0.95 * np.pi / 2.0), rel=0.01)


@pytest.mark.parametrize("name", list_vehicles())
def test_axles_lie_inside_the_drawn_body(name):
    shape = DrawnCar.of(load_vehicle(name))
    assert shape.lf < shape.outline.front
    assert shape.lr < shape.outline.rear
    assert max(shape.track_front, shape.track_rear) < shape.outline.width


def test_an_impossible_shape_is_refused():
    with pytest.raises(InvalidInput, match="track_front"):
        dataclasses.replace(DrawnCar.of(load_vehicle("paper")), track_front=0.0)


def test_made_drives_are_where_the_road_says():
    drive = made_drive()
    feet = drive.road.project(drive.x, drive.y)
    assert feet.s == pytest.approx(drive.station, abs=1e-6)
    assert feet.offset == pytest.approx(drive.offset, abs=1e-9)
    assert np.diff(drive.time) == pytest.approx(PERIOD)
