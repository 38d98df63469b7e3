"""The grade of a road: from heights, columns, elevations and files, with its sign and its bounds."""

import math

import numpy as np
import pytest

from adaptrack.base.errors import ConfigError, InvalidInput
from adaptrack.road import Arc, Line, Road, fit_road, generate_road, load_road, plan_speed
from adaptrack.scenario import RoadDrive, Scenario

WAVE, HEIGHT = 400.0, 5.0
PLAN_VIEW = """<planView><geometry s="0" x="0" y="0" hdg="0" length="100"><line/></geometry>
<geometry s="100" x="100" y="0" hdg="0" length="100"><arc curvature="0.01"/></geometry></planView>"""
LANES = """<lanes><laneSection s="0"><left><lane id="1" type="driving"><width sOffset="0" a="4" b="0" c="0" d="0"/>
</lane></left><center><lane id="0"/></center><right><lane id="-1" type="driving">
<width sOffset="0" a="4" b="0" c="0" d="0"/></lane></right></laneSection></lanes>"""


def hill(s):
    return HEIGHT * np.sin(2.0 * np.pi * s / WAVE)


def slope(s):
    return 2.0 * np.pi / WAVE * HEIGHT * np.cos(2.0 * np.pi * s / WAVE)


def hill_record(spacing, noise=0.0, step=0.0):
    """x, y, z (m) of a straight road over hills; heights with noise or rounded to a step (m)."""
    x = np.arange(0.0, 1200.0 + 0.5 * spacing, spacing)
    z = 300.0 + hill(x) + noise * np.random.default_rng(1).standard_normal(x.size)
    return np.stack([x, np.zeros_like(x), np.round(z / step) * step if step else z], axis=-1)


def write_csv(path, header, rows):
    np.savetxt(path, rows, delimiter=",", header=header, comments="")
    return path


# -- points -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("record", "error", "deviation"), [
    (hill_record(2.0), 1e-5, 0.0),
    (hill_record(10.0), 1e-4, 0.0),
    (hill_record(2.0, noise=0.1), 0.003, 0.1),
    (hill_record(1.0, step=0.1), 0.002, 0.1 / math.sqrt(12.0)),
    (hill_record(1.0, step=1.0), 0.006, 1.0 / math.sqrt(12.0)),
])  # fmt: skip
def test_the_heights_of_a_hill_give_its_slope_whatever_their_noise_and_rounding(tmp_path, record, error, deviation):
    road = load_road(write_csv(tmp_path / "hill.csv", "x,y,z", record))
    s = np.linspace(50.0, 1150.0, 400)  # ends of noisy records are less certain
    assert np.sqrt(np.mean((road.along("grade", s) - slope(s)) ** 2)) < error
    (note,) = (note for note in road.notes if "% from heights" in note)
    assert float(note.split("deviation ")[1].split(" m")[0]) == pytest.approx(deviation, rel=0.15, abs=5e-4)
    assert not any("left out" in note for note in road.notes)


def test_a_road_and_its_reverse_have_opposite_grades(tmp_path):
    bend = generate_road("country", seed=2, length=600.0)
    s = np.arange(0.0, bend.length, 3.0)
    points, z = np.stack(bend.at(s)[:2], axis=-1), hill(s)
    there, back = fit_road(points, height=z), fit_road(points[::-1].copy(), height=z[::-1].copy())
    s = np.linspace(20.0, there.length - 20.0, 100)
    np.testing.assert_allclose(back.along("grade", there.length - s), -there.along("grade", s), atol=2e-5)
    np.testing.assert_allclose(there.along("grade", s), slope(s), atol=1e-3)


def test_over_the_seam_of_a_lap_the_grade_is_continuous_and_a_lap_ends_at_its_height():
    angle = np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False)
    points, z = 100.0 * np.stack([np.cos(angle), np.sin(angle)], axis=-1), 6.0 * np.sin(angle + 0.4)
    road = fit_road(points, height=z, closed=True)
    s = np.linspace(0.0, road.length, 2001)
    grade = road.along("grade", s)
    np.testing.assert_allclose(grade, 0.06 * np.cos(s / 100.0 + 0.4), atol=1e-4)
    assert grade[0] == pytest.approx(grade[-1], abs=1e-9)
    assert abs(np.trapezoid(grade, s)) < 1e-6


def test_level_heights_are_a_grade_of_zero_and_a_column_of_grades_counts_before_heights(tmp_path):
    rows = hill_record(5.0)
    rows[:, 2] = 123.4
    assert not load_road(write_csv(tmp_path / "level.csv", "x,y,z", rows)).along("grade", rows[:, 0]).any()
    rows = np.column_stack([hill_record(5.0), np.full(len(rows), -0.02)])
    road = load_road(write_csv(tmp_path / "both.csv", "x,y,z,grade", rows))
    assert set(road.grade.value) == {-0.02}
    assert "columns left out: z" in road.notes


@pytest.mark.parametrize(("header", "value", "message"), [
    ("x,y,grade_percent", 5.0, "line 1: column 'grade_percent': a grade must be dz/ds; divide per cent by 100"),
    ("x,y,grade (%)", 5.0, "line 1: column 'grade .%.': a grade must be dz/ds"),
    ("x,y,slope_deg", 5.0, "column 'slope_deg': a grade must be dz/ds"),
    ("x,y,grade", 5.0, "grade = 5.0 at s = .* m: must be dz/ds, at most 0.4 .* divide a grade in per cent by 100"),
    ("x,y,z [ft]", 0.0, "column 'z .ft.': must be in m; convert it"),
])  # fmt: skip
def test_grades_in_per_cent_or_degrees_are_refused_with_the_remedy(tmp_path, header, value, message):
    rows = hill_record(5.0)
    rows[:, 2] = value
    with pytest.raises(ConfigError, match=message):
        load_road(write_csv(tmp_path / "hill.csv", header, rows))


def test_heights_that_no_road_has_are_refused_with_their_place():
    x = np.linspace(0.0, 300.0, 151)
    points = np.stack([x, 0.0 * x], axis=-1)
    with pytest.raises(InvalidInput, match=r"change by 1\.\d+ m per metre at s = 1\d\d.* is z in m"):
        fit_road(points, height=np.maximum(x - 150.0, 0.0))
    with pytest.raises(InvalidInput, match=r"height has shape \(2,\): give \(151,\)"):
        fit_road(points, height=[0.0, 1.0])
    with pytest.raises(InvalidInput, match="must be dz/ds"):
        Road.from_segments([Line(length=10.0)], grade=-0.5)


# -- OpenDRIVE --------------------------------------------------------------------------------------------------------
def test_the_grade_of_an_opendrive_road_is_the_derivative_of_its_elevation(tmp_path):
    profile = '<elevationProfile><elevation s="20" a="7" b="0.01" c="4e-4" d="-2e-6"/>'
    profile += '<elevation s="120" a="10" b="0.03" c="-5e-4" d="1e-6"/></elevationProfile>'
    path = tmp_path / "a.xodr"
    path.write_text(f'<OpenDRIVE><road name="r" id="7" length="200">{PLAN_VIEW}{profile}{LANES}</road></OpenDRIVE>')
    s = np.array([5.0, 19.9, 20.1, 61.7, 97.0, 119.9, 120.1, 150.3, 199.0])
    ds, late = s - np.where(s < 120.0, 20.0, 120.0), s >= 120.0
    exact = np.where(late, 0.03 - 1e-3 * ds + 3e-6 * ds**2, 0.01 + 8e-4 * ds - 6e-6 * ds**2) * (s >= 20.0)
    road = load_road(path)
    np.testing.assert_allclose(road.along("grade", s), exact, atol=1e-5)
    assert not any("elevation" in note for note in road.notes)
    # a lane inside the bend climbs the same height on a shorter way
    lane = load_road(path, lane=-1)
    outside = 1.0 + 2.0 * 0.01  # its length over that of the reference line, on the arc
    there = np.where(s > 100.0, 100.0 + outside * (s - 100.0), s)
    np.testing.assert_allclose(lane.along("grade", there), exact / np.where(s > 100.0, outside, 1.0), atol=1e-4)


# -- drives -----------------------------------------------------------------------------------------------------------
def test_a_drive_samples_the_grade_where_it_is_lap_after_lap():
    lap = Road.from_segments(
        [Arc(length=100.0 * math.pi, curvature=0.02)], closed=True, grade=([0.0, 100.0, 200.0], [0.0, 0.06, -0.06])
    )
    signals = RoadDrive(lap, plan_speed(lap), laps=2).sample(0.1)
    np.testing.assert_array_equal(signals.grade, lap.along("grade", signals.station))
    assert signals.station[-1] > 1.9 * lap.length
    assert signals.grade.max() > 0.05


def test_a_scenario_has_a_grade_over_time_and_is_silent_about_none(tmp_path):
    level = Scenario(name="straight", duration=4.0, reference=0.0, speed=10.0, friction=0.9)
    assert "grade" not in level.to_dict()
    assert not level.sample().grade.any()
    climb = level.replace(grade={"shape": "knots", "points": [[0.0, 0.0], [2.0, 0.08]]})
    climb.to_toml(tmp_path / "climb.toml")
    again = Scenario.from_toml(tmp_path / "climb.toml")
    np.testing.assert_allclose(again.sample(1.0).grade, [0.0, 0.04, 0.08, 0.08, 0.08])
    assert again.mirrored().grade == again.grade
    with pytest.raises(InvalidInput, match=r"grade is 5\.0 at t = 0 s: must be dz/ds within"):
        level.replace(grade=5.0)
