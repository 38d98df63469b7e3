"""Tables of points as spreadsheets, recorders and ROS write them."""

import math

import numpy as np
import pytest

from adaptrack.base.errors import ConfigError
from adaptrack.road import load_road
from adaptrack.road.points import read_points
from adaptrack.road.speed import speed_limit_plan

S = np.arange(0.0, 61.0)
X, Y = S, 20.0 * (1.0 - np.cos(S / 40.0))


def table(path, header, *columns, mark=","):
    path.write_text(
        header + "".join(mark.join(f"{value:.6f}" for value in row) + "\n" for row in zip(*columns, strict=True))
    )
    return path


@pytest.mark.parametrize(("above", "mark"), [
    ("sep=;\nx;y\n", ";"),
    ('"sep=;"\nx;y\n', ";"),
    ("SEP=,\nx,y\n", ","),
    ("% x, y\n", ","),
    ("% a waypoint file\n% x_m y_m\n", " "),
    ("// x,y\n", ","),
    ("%time,wp_x,wp_y\n", ","),
    ("%time,field.pose.pose.position.x,field.pose.pose.position.y\n", ","),
    ("easting,northing\n", ","),
    ("Easting (m);Northing (m)\n", ";"),
    ("utm_x\tutm_y\n", "\t"),
    ("x|y\n", "|"),
    ("", ";"),
])  # fmt: skip
def test_names_and_marks_above_the_numbers_are_read(tmp_path, above, mark):
    columns = (0.1 * S, X, Y) if "time" in above else (X, Y)
    read = read_points(table(tmp_path / "a.csv", above, *columns, mark=mark))
    np.testing.assert_allclose(read.points, np.stack([X, Y], axis=-1), atol=1e-6)
    assert read.lines[0] == above.count("\n") + 1


def test_remarks_between_and_below_the_numbers_are_left_out(tmp_path):
    path = table(tmp_path / "a.csv", "x,y\n", X, Y)
    path.write_text(path.read_text().replace("30.000000,", "// a pause\n%\n30.000000,", 1) + "# end\n")
    assert len(read_points(path).points) == S.size


def test_four_columns_without_names_are_widths_only_where_they_can_be(tmp_path):
    widths = read_points(table(tmp_path / "track.csv", "", X, Y, 3.0 + 0.0 * S, 4.0 + 0.0 * S))
    assert any("read as x, y, width to the right, width to the left" in note for note in widths.notes)
    for name, third, fourth in (("height", 84.0, 8.0), ("zero", 0.0, 8.0), ("below", -1.0, 8.0), ("speed", 3.0, 35.0)):
        with pytest.raises(ConfigError, match="the last two of four columns without a header are no widths"):
            read_points(table(tmp_path / f"{name}.csv", "", X, Y, third + 0.0 * S, fourth + 0.0 * S))


@pytest.mark.parametrize("name", ["width_right", "width_left"])
def test_widths_below_zero_all_along_are_distances_and_those_of_both_signs_are_refused(tmp_path, name):
    road = load_road(table(tmp_path / "a.csv", f"x,y,{name}\n", X, Y, -5.0 + 0.0 * S))
    np.testing.assert_allclose(road.along(name, [0.0, 30.0]), 5.0)
    assert f"{name} is below 0 all along: read as distances" in road.notes
    with pytest.raises(ConfigError, match=f"{name} = -"):
        load_road(table(tmp_path / "b.csv", f"x,y,{name}\n", X, Y, 5.0 * np.cos(S / 10.0)))


def test_a_recorded_drive_begins_and_ends_at_a_standstill(tmp_path):
    standing = np.zeros(4)
    x, y = (np.concatenate([np.full(4, values[0]), values, np.full(4, values[-1])]) for values in (X, Y))
    speed = np.concatenate([standing, np.sqrt(3.0 * np.minimum(S, S[-1] - S)), standing])
    road = load_road(table(tmp_path / "a.csv", "x,y,speed\n", x, y, speed), speed_column="speed")
    assert road.length == pytest.approx(np.hypot(np.diff(X), np.diff(Y)).sum(), rel=1e-3)
    assert any("speed 0 at the start or the end" in note for note in road.notes)
    plan = speed_limit_plan(road)
    inside = np.arange(5.0, 55.0)
    np.testing.assert_allclose(
        plan.at(inside), np.interp(inside, road.speed_limit.s, road.speed_limit.value), rtol=2e-3
    )
    # From and to rest at 1.5 m/s^2 the way takes 2 sqrt(L/1.5) s.
    assert plan.duration == pytest.approx(2.0 * math.sqrt(60.0 / 1.5), rel=0.15)


@pytest.mark.parametrize("place", [1, 30])
def test_a_speed_of_zero_within_the_road_is_refused_at_its_line(tmp_path, place):
    speed = np.where(place == S, 0.0, 8.0)
    with pytest.raises(ConfigError, match=f"line {place + 2}: speed = 0: must be > 0"):
        load_road(table(tmp_path / "a.csv", "x,y,speed\n", X, Y, speed), speed_column="speed")


def test_a_recording_that_stands_all_along_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="line 2: speed = 0"):
        load_road(table(tmp_path / "a.csv", "x,y,speed\n", X, Y, 0.0 * S), speed_column="speed")


def test_a_column_of_speeds_is_named_with_its_option(tmp_path):
    path = table(tmp_path / "line.csv", "# s_m; x_m; y_m; vx_mps\n", S, X, Y, 8.0 + 0.0 * S, mark=";")
    assert "to drive at the speeds of a column: --speed-column vx_mps" in load_road(path).notes
    assert not any("--speed-column" in note for note in load_road(path, speed_column="vx_mps").notes)
    in_kmh = table(tmp_path / "kmh.csv", "x,y,speed_kmh\n", X, Y, 30.0 + 0.0 * S)
    assert load_road(in_kmh).notes[-1] == "columns left out: speed_kmh"


@pytest.mark.parametrize("scale", [100.0, 1000.0])
def test_a_road_in_millimetres_or_centimetres_is_refused(tmp_path, scale):
    x = np.arange(0.0, 1000.0, 2.0)
    y = 40.0 * np.sin(x / 80.0)
    with pytest.raises(ConfigError, match="in millimetres or centimetres; convert them to metres"):
        load_road(table(tmp_path / "a.csv", "x,y\n", scale * x, scale * y))
    assert load_road(table(tmp_path / "b.csv", "x,y\n", x, y)).length < 2000.0


def test_a_long_road_with_points_far_apart_is_none_in_millimetres(tmp_path):
    s = np.arange(0.0, 6e4, 60.0)
    assert load_road(table(tmp_path / "a.csv", "x,y\n", s, 800.0 * np.sin(s / 2000.0))).length > 6e4
