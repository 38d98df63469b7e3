"""Roads from files: points recorded with noise, and OpenDRIVE; what is stated of a fit is true."""

import math
import re

import numpy as np
import pytest

import adaptrack as at
from adaptrack.road import Along, Arc, Clothoid, Cubic, Line, smooth_road
from adaptrack.road.speed import speed_limit_plan
from references.road import figure_of_eight, nearest_by_search


def recorded(road, spacing, noise=0.0, seed=0):
    """Points of a road, (n, 2), with independent errors."""
    s = np.arange(0.0, road.length, spacing)
    points = np.stack(road.at(s)[:2], axis=-1)
    return points + noise * np.random.default_rng(seed).standard_normal(points.shape)


def csv(path, rows, header=""):
    path.write_text(header + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return path


# -- fits -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("kind", "spacing", "noise"), [("country", 20.0, 0.3), ("mountain", 8.0, 0.1), ("lap", 12.0, 0.2)]
)
def test_the_stated_deviation_of_a_noisy_record_is_the_true_one(kind, spacing, noise):
    true = at.generate_road(kind, seed=4, length=1000.0)
    points = recorded(true, spacing, noise)
    road = at.fit_road(points, max_deviation=2.0)
    distances = [nearest_by_search(road, *point)[1] for point in points]
    assert road.deviation == pytest.approx(max(distances), abs=1e-5)
    assert road.deviation < 2.0
    assert f"point {int(np.argmax(distances))}" in road.notes[-1]
    assert road.closed is true.closed
    # The noise is taken for noise: the road is nearer to the truth than the record is.
    error = road.project(*true.at(np.linspace(0.05, 0.95, 100) * true.length)[:2]).offset
    assert np.sqrt(np.mean(error**2)) < noise
    assert road.curvature_jumps() == []
    assert at.fit_road(points, max_deviation=2.0 * noise).deviation <= 2.0 * noise  # a bound is kept


def test_a_smoothed_road_has_no_jumps_and_stays_within_its_deviation():
    sharp = at.Road.from_segments(
        [Line(length=80.0), Arc(length=60.0, curvature=0.02), Line(length=80.0)], width_left=2.5
    )
    smooth = smooth_road(sharp, max_deviation=0.1)
    assert len(sharp.curvature_jumps()) == 2
    assert smooth.curvature_jumps() == []
    assert smooth.deviation <= 0.1
    foot = sharp.project(*smooth.at(np.linspace(0.0, smooth.length, 300))[:2])
    assert np.abs(foot.offset).max() <= 0.11
    steepest = np.abs(np.diff(smooth.at(np.arange(0.0, smooth.length, 0.5)).curvature)).max() / 0.5
    assert steepest < 0.01
    assert float(smooth.along("width_left", 100.0)) == 2.5


@pytest.mark.parametrize("seed", [0, 2, 3])
@pytest.mark.parametrize("length", [600.0, 1500.0])
def test_a_road_with_hairpins_is_smoothed_within_its_deviation(seed, length):
    road = at.generate_road("mountain", seed=seed, length=length)
    smooth = smooth_road(road, max_deviation=0.1)
    points = road.at(np.linspace(0.0, road.length, 1000))
    assert np.abs(smooth.project(points.x, points.y).offset).max() <= 0.11
    assert smooth.length == pytest.approx(road.length, rel=2e-3)
    tightest = np.abs(smooth.at(np.linspace(0.0, smooth.length, 3000)).curvature).max()
    assert tightest < 1.2 * np.abs(points.curvature).max()


def test_a_record_is_cut_at_its_start_but_crossing_it_does_not_close_a_road():
    lap = at.generate_road("lap", seed=1, length=700.0)
    road = at.fit_road(np.stack(lap.at(np.arange(0.0, 1.4 * lap.length, 4.0))[:2], axis=-1))
    assert road.closed
    assert road.length == pytest.approx(lap.length, rel=2e-3)
    assert any("beyond its start" in note for note in road.notes)
    eight = at.Road.from_segments(figure_of_eight(Arc, Line), closed=True)
    s = np.arange(3.0 * math.pi * 15.0 + 30.0, eight.length, 3.0)  # from the crossing on, once through it
    assert not at.fit_road(np.stack(eight.at(s)[:2], axis=-1)).closed


def test_noisy_dense_points_and_standing_still_do_not_bend_the_road():
    rng = np.random.default_rng(0)
    x = np.concatenate([np.linspace(0.0, 100.0, 400), np.full(100, 100.0), np.linspace(100.0, 200.0, 400)])
    points = np.stack([x, np.zeros_like(x)], axis=-1) + 0.3 * rng.standard_normal((x.size, 2))
    road = at.fit_road(points, max_deviation=2.0)
    assert road.length == pytest.approx(200.0, abs=4.0)
    assert np.abs(road.at(np.linspace(5.0, road.length - 5.0, 100)).curvature).max() < 0.01


WINDING = np.stack([np.arange(0.0, 5000.0, 3.0), 30.0 * np.sin(np.arange(0.0, 5000.0, 3.0) / 60.0)], axis=-1)


def test_points_in_centimetres_or_kilometres_are_asked_about_and_those_in_degrees_are_refused(caplog):
    with caplog.at_level("WARNING", logger="adaptrack"):
        in_cm = at.fit_road(100.0 * WINDING[:300])
    assert "are x and y in metres, or in centimetres?" in caplog.text
    assert "centimetres" in in_cm.notes[0]
    findings = at.check_road(at.fit_road(WINDING / 1000.0), at.load_vehicle("paper"))
    assert any("in metres, or in kilometres?" in finding.text and not finding.drivable for finding in findings)
    in_metres = at.fit_road(WINDING[:300])
    assert not any("metres" in note for note in in_metres.notes)
    assert not at.check_road(in_metres, at.load_vehicle("paper"))
    degrees = np.array([11.5, 48.1]) + WINDING[:300] / 1e5
    with pytest.raises(
        at.InvalidInput, match=r"latitude and longitude. Convert them to x .east. and y .north. in metres"
    ):
        at.fit_road(degrees)


def test_a_road_prints_its_name_its_length_and_what_is_to_be_said_of_it():
    assert repr(at.generate_road("lap", 0)).startswith("<Road 'lap-0': a lap of ")
    fitted = repr(at.fit_road(WINDING[:300]))
    assert re.fullmatch(r"<Road 'points': open, 9\d\d.* m; 300 points; largest deviation .*>", fitted)


# -- CSV --------------------------------------------------------------------------------------------------------------
POINTS = [
    (round(20.0 * math.cos(a), 4), round(20.0 * math.sin(a), 4), 2.0 + 0.1 * a, 3.0) for a in np.arange(0, 6.2, 0.1)
]


@pytest.mark.parametrize("header", [
    "",
    "# a track\n# x_m,y_m,w_tr_right_m,w_tr_left_m\n",
    "x,y,width_right,width_left\n",
    "\ufeffx_m, y_m, w_tr_right_m, w_tr_left_m\n\n",
], ids=["none", "comment", "line", "byte order mark"])  # fmt: skip
def test_a_track_is_read_with_or_without_a_header(tmp_path, header):
    road = at.load_road(csv(tmp_path / "track.csv", POINTS, header))
    assert road.name == "track"
    assert road.closed
    assert road.length == pytest.approx(40.0 * math.pi, rel=1e-3)
    assert float(road.along("width_left", 10.0)) == pytest.approx(3.0)
    foot = road.project(20.0 * math.cos(2.0), 20.0 * math.sin(2.0))
    assert float(road.along("width_right", foot.s)) == pytest.approx(2.2, abs=0.01)


def test_other_separators_and_columns_are_read_and_said(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(
        "t;x [m];y [m];mu\n"
        + "".join(f"{k};{k}.0;{0.01 * k * k};0.5\n{k};{k}.0;{0.01 * k * k};0.5\n" for k in range(40))
    )
    road = at.load_road(path)
    assert float(road.along("friction", 5.0)) == 0.5
    assert any("columns left out: t" in note for note in road.notes)
    assert any("40 repeated points" in note for note in road.notes)
    assert "in line" in road.notes[0]


def raceline(speeds, title="vx_mps"):
    """The text of a race line of 100 m along x with a point every 10 m."""
    rows = [f"{10.0 * k}; {10.0 * k}; 0.0; {speed}\n" for k, speed in enumerate(speeds)]
    return f"# 3f2a\n# s_m; x_m; y_m; {title}\n" + "".join(rows)


def test_the_speed_of_a_race_line_becomes_the_limit_and_the_plan(tmp_path):
    speeds = [8.0, 10.0, 14.0, 14.0, 20.0, 30.0, 30.0, 20.0, 10.0, 10.0, 5.0]
    path = tmp_path / "line.csv"
    path.write_text(raceline(speeds, "Vx [m/s]"))
    road = at.load_road(path, speed_column="vx")
    s = np.arange(0.0, 101.0, 10.0)
    np.testing.assert_allclose(road.along("speed_limit", s), speeds, atol=1e-6)
    plan = speed_limit_plan(road)
    np.testing.assert_allclose(plan.at(s), speeds, rtol=1e-6)
    assert any("columns left out: s_m" in note for note in road.notes)
    assert at.load_road(path).speed_limit is None
    with pytest.raises(at.InvalidInput, match="has no speed limit"):
        speed_limit_plan(at.load_road(path))


@pytest.mark.parametrize(("name", "option", "error", "words"), [
    ("country", {"closed": True}, at.InvalidInput, "country: closed is an option of .csv, .txt, .xml roads"),
    ("a.csv", {"seed": 1}, at.InvalidInput, "a.csv: seed is an option of generated roads"),
    ("a.toml", {"lane": -1}, at.InvalidInput, "lane is an option of .xodr roads"),
    ("a.xodr", {"width_lft": 2.0}, at.InvalidInput, "unknown option width_lft. Did you mean 'width_left'"),
    ("none.csv", {}, at.StorageError, "cannot be read"),
    ("contry", {}, at.UnknownName, "country"),
])  # fmt: skip
def test_other_names_and_options_of_other_kinds_of_roads_are_refused(name, option, error, words):
    with pytest.raises(error, match=words):
        at.load_road(name, **option)


# -- OpenDRIVE --------------------------------------------------------------------------------------------------------
SHAPES = (
    (Line(length=100.0), "<line/>"),
    (Clothoid(length=40.0, start_curvature=0.0, end_curvature=0.02), '<spiral curvStart="0.0" curvEnd="0.02"/>'),
    (Arc(length=50.0, curvature=0.02), '<arc curvature="0.02"/>'),
)


def xodr_road(origin=(0.0, 0.0)):
    return at.Road.from_segments([segment for segment, _ in SHAPES], start=(*origin, 0.3))


def xodr_text(lanes="", before="", after="", **place):
    """The text of a file of one road: line, spiral, arc."""
    road = xodr_road(**place)
    s, text = 0.0, ""
    for segment, shape in SHAPES:
        p = road.at(s)
        text += f'<geometry s="{s!r}" x="{float(p.x)!r}" y="{float(p.y)!r}" hdg="{float(p.heading)!r}" '
        text += f'length="{segment.length!r}">{shape}</geometry>'
        s += segment.length
    road = f'<road name="r" id="7" length="{s}">{before}<planView>{text}</planView>{after}{lanes}</road>'
    return f"<OpenDRIVE>{road}</OpenDRIVE>"


def xodr(path, lanes="", *, origin=(0.0, 0.0), **parts):
    """The file of `xodr_text`, and its road."""
    path.write_text(xodr_text(lanes, origin=origin, **parts))
    return path, xodr_road(origin)


LANES = """<lanes><laneOffset s="0" a="0" b="0" c="0" d="0"/><laneOffset s="20" a="0" b="0" c="0.0075" d="-0.00025"/>
<laneOffset s="40" a="1" b="0" c="0" d="0"/><laneSection s="0">
<left><lane id="1" type="driving"><width sOffset="0" a="3" b="0" c="0" d="0"/></lane></left>
<center><lane id="0"/></center>
<right><lane id="-1" type="driving"><width sOffset="0" a="3.5" b="0" c="0" d="0"/></lane>
<lane id="-2" type="driving"><width sOffset="0" a="3.2" b="0.001" c="0" d="0"/></lane></right></laneSection></lanes>"""


def test_the_lane_offset_and_the_middle_of_a_lane_lie_beside_the_reference_line(tmp_path):
    path, road = xodr(tmp_path / "a.xodr", LANES)
    s = np.array([5.0, 33.0, 70.0, 120.0, 170.0])
    ds = s[1] - 20.0
    offset = np.array([0.0, 0.0075 * ds**2 - 0.00025 * ds**3, 1.0, 1.0, 1.0])
    centre, lane = at.load_road(path), at.load_road(path, lane=-2)
    for line, distance in ((centre, offset), (lane, offset - 3.5 - 0.5 * (3.2 + 0.001 * s))):
        p = road.at(s)
        foot = line.project(p.x - distance * np.sin(p.heading), p.y + distance * np.cos(p.heading))
        assert np.abs(foot.offset).max() < 1e-3
    arc = centre.project(*road.at(165.0)[:2])
    assert float(arc.curvature) == pytest.approx(0.02 / (1.0 - 0.02), rel=0.01)
    assert float(centre.along("width_left", 60.0)) == pytest.approx(3.0)
    assert float(centre.along("width_right", 0.0)) == pytest.approx(6.7)
    assert float(lane.along("width_left", 0.0)) == pytest.approx(1.6)


def test_the_plan_view_is_read_exactly_bank_and_speed_limits_with_their_signs_and_units(tmp_path):
    bank = '<lateralProfile><superelevation s="0" a="0.05" b="0" c="0" d="0"/></lateralProfile>'
    speed = '<type s="0" type="rural"><speed max="90" unit="km/h"/></type>'
    speed += '<type s="100" type="town"><speed max="30" unit="mph"/></type>'
    path, line = xodr(tmp_path / "a.xodr", before=speed, after=bank, origin=(4.5e5, 5.4e6))
    road, s = at.load_road(path), np.linspace(0.0, 190.0, 500)
    assert road.name == "r"
    np.testing.assert_allclose(road.at(s), line.at(s), rtol=0, atol=5e-9)
    assert float(road.along("bank", 50.0)) == -0.05  # falls to the right: pushes to the right
    assert road.along("speed_limit", [50.0, 150.0]).tolist() == pytest.approx([25.0, 13.4112])


@pytest.mark.parametrize("span", ["normalized", "arcLength"])
def test_parametric_cubics_and_poly3_are_the_same_curve_where_they_say_the_same(tmp_path, span):
    b, c = 0.1, 0.004
    scale = 1.0 if span == "arcLength" else 30.0
    u = f'aU="0" bU="{scale}" cU="0" dU="0"'
    cubic = f'<paramPoly3 pRange="{span}" {u} aV="0" bV="{b * scale}" cV="{c * scale**2}" dV="0"/>'
    length = 30.4 if span == "normalized" else 30.0
    roads = []
    for k, shape in enumerate((cubic, f'<poly3 a="0" b="{b}" c="{c}" d="0"/>')):
        (tmp_path / f"{k}.xodr").write_text(one_element(shape, length))
        roads.append(at.load_road(tmp_path / f"{k}.xodr"))
    s = np.linspace(0.0, 29.9, 60)
    np.testing.assert_allclose(roads[0].at(s), roads[1].at(s), rtol=0, atol=1e-9)
    p = roads[0].at(s)
    np.testing.assert_allclose(p.y, b * p.x + c * p.x**2, atol=1e-9)
    assert "the file says" in roads[0].notes[0]
    assert roads[1].length == pytest.approx(length, abs=1e-9)


def one_element(shape, length=100):
    """The text of a file of one element."""
    place = f'<geometry s="0" x="0" y="0" hdg="0" length="{length}">'
    shape = shape.format(zero='aV="0" bV="0" cV="0" dV="0"')
    return f'<OpenDRIVE><road id="1" length="9"><planView>{place}{shape}</geometry></planView></road></OpenDRIVE>'


def test_a_side_of_the_line_without_driving_lanes_is_noted(tmp_path):
    path, _ = xodr(tmp_path / "a.xodr", LANES.replace('<lane id="1" type="driving">', '<lane id="1" type="sidewalk">'))
    line = at.load_road(path)
    (note,) = (note for note in line.notes if "no driving lane" in note)
    assert "to the left of the line" in note
    assert "-2, -1, 1 (sidewalk)" in note
    assert float(line.along("width_left", 50.0)) == 0.01
    both, _ = xodr(tmp_path / "both.xodr", LANES)
    assert not any(
        "no driving lane" in note for road in (at.load_road(both), at.load_road(path, lane=-1)) for note in road.notes
    )


def test_a_road_has_at_most_two_thousand_kilometres():
    bent = {"x": (0.0, 3e5, 0.0, 0.0), "y": (0.0, 0.0, 0.0, 3e5)}
    assert at.Road.from_segments([Cubic(**bent)]).length < 1e6
    with pytest.raises(at.InvalidInput, match=r"length = 3e\+06: at most 2,000,000 m"):
        at.Road.from_segments([Line(length=1e6)] * 3)


# -- what OpenDRIVE says of lanes and the surface ----------------------------------------------------------------------
LINES = '<geometry s="0" x="0" y="0" hdg="0" length="200"><line/></geometry>'


def lane_text(number, content="", width=3.5, **attributes):
    words = " ".join(f'{key}="{value}"' for key, value in ({"type": "driving"} | attributes).items())
    return f'<lane id="{number}" {words}>{content}<width sOffset="0" a="{width}" b="0" c="0" d="0"/></lane>'


def section(s, *lanes, **attributes):
    """A lane section; lanes to the left first."""
    words = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    left, right = ("".join(text for text in lanes if ('id="-' in text) is side) for side in (False, True))
    groups = f"{left and f'<left>{left}</left>'}<center><lane id='0'/></center>{right and f'<right>{right}</right>'}"
    return f'<laneSection s="{s}" {words}>{groups}</laneSection>'


def straight_text(*sections, view=LINES, before="", head="", **attributes):
    """The text of a file of one road, by default a straight line of 200 m with a lane on each side."""
    words = " ".join(f'{key}="{value}"' for key, value in attributes.items())
    lanes = "".join(sections) or section(0, lane_text(1), lane_text(-1))
    return (
        f'<OpenDRIVE>{head}<road id="1" length="200" {words}>{before}<planView>{view}</planView><lanes>{lanes}</lanes>'
        "</road></OpenDRIVE>"
    )


def straight_road(path, *sections, **parts):
    """The file of `straight_text`."""
    path.write_text(straight_text(*sections, **parts))
    return path


EMPTY = '<geometry s="100" x="100" y="0" hdg="0" length="0"><line/></geometry>'


def profile(text):
    return f"<lateralProfile>{text}</lateralProfile>"


def test_a_lane_has_its_own_speed_limit_and_without_one_that_of_the_road(tmp_path):
    lane_limits = '<speed sOffset="0" max="30" unit="km/h"/><speed sOffset="50" max="20" unit="mph"/>'
    path = straight_road(
        tmp_path / "a.xodr",
        section(0, lane_text(-1, lane_limits), lane_text(-2)),
        section(100, lane_text(-1), lane_text(-2, '<speed sOffset="50" max="40"/>')),
        before='<type s="0" type="rural"><speed max="90" unit="km/h"/></type>',
    )
    places = [10.0, 60.0, 110.0, 160.0]
    for lane, limits in ((-1, [30 / 3.6, 8.9408, 25.0, 25.0]), (-2, [25.0, 25.0, 25.0, 40.0])):
        assert at.load_road(path, lane=lane).along("speed_limit", places) == pytest.approx(limits)
    assert at.load_road(path).along("speed_limit", places) == pytest.approx([30 / 3.6, 8.9408, 25.0, 25.0])


@pytest.mark.parametrize(
    ("rule", "direction", "lanes"),
    [("RHT", "standard", {-1}), ("LHT", "standard", {1}), ("RHT", "reversed", {1}), ("LHT", "reversed", {-1}),
     ("LHT", "both", {-1, 1})],
)  # fmt: skip
def test_only_lanes_that_are_driven_along_the_road_are_read(tmp_path, rule, direction, lanes):
    both = section(0, *(lane_text(number, direction=direction) for number in (1, -1)))
    path = straight_road(tmp_path / "a.xodr", both, rule=rule)
    for number in (-1, 1):
        if number in lanes:
            road = at.load_road(path, lane=number)
            assert float(road.at(100.0).y) == pytest.approx(1.75 * number)
            assert float(road.at(100.0).heading) == 0.0
        else:
            with pytest.raises(at.ConfigError, match=f"rule='{rule}', direction='{direction}'.*: {min(lanes)}[.]"):
                at.load_road(path, lane=number)


@pytest.mark.parametrize(
    ("before", "attributes", "bank"),
    [
        (profile('<crossfall s="0" side="both" a="0.05" b="0" c="0" d="0"/>'), {}, {1: 0.05, None: 0.0, -1: -0.05}),
        (profile('<crossfall s="0" a="0" b="5e-4" c="0" d="0"/>'), {"level": "true"}, {1: 0.0, -1: 0.0}),
        (profile('<shape s="0" t="-9" a="0" b="0.08" c="0" d="0"/>'), {}, {1: -np.arctan(0.08), -1: -np.arctan(0.08)}),
        (
            profile(
                '<superelevation s="0" a="0.02" b="0" c="0" d="0"/><shape s="0" t="-5" a="0" b="0" c="0" d="0"/>'
                '<shape s="250" t="-5" a="0.5" b="0.1" c="0" d="0"/>'
            ),
            {},
            {-1: -0.02 - np.arctan(0.1 * 100 / 250)},
        ),
        (
            profile(
                '<shape s="0" t="0" a="0" b="0" c="0.01" d="0"/><shape s="0" t="-9" a="0.27" b="-0.03" c="0" d="0"/>'
            ),
            {},
            {1: -np.arctan(0.035), -1: np.arctan(0.03)},
        ),
    ],
)  # fmt: skip
def test_the_bank_of_a_lane_follows_from_superelevation_crossfall_and_shape(tmp_path, before, attributes, bank):
    both = section(0, *(lane_text(number, direction="both", **attributes) for number in (1, -1)))
    path = straight_road(tmp_path / "a.xodr", both, before=before)
    for number, angle in bank.items():
        road = at.load_road(path) if number is None else at.load_road(path, lane=number)
        assert float(road.along("bank", 100.0)) == pytest.approx(angle, abs=1e-9)


def test_all_elements_and_attributes_that_are_not_read_are_named(tmp_path):
    content = '<link><userData/></link><roadMark sOffset="0"/><material sOffset="0" friction="0.3"/>'
    path = straight_road(
        tmp_path / "a.xodr",
        section(0, lane_text(-1, content, advisory="inner")),
        before="<objects><object/></objects><link/>",
        head='<header revMajor="1"><geoReference/></header><road id="2"><signals/></road><junction/>',
    )
    unread = "header/geoReference, junction, road/objects, road/link, lane@advisory, roadMark, material, userData"
    (note,) = (note for note in at.load_road(path, road=1).notes if note.startswith("not read: "))
    for name in unread.split(", "):
        assert name in note
    assert "signals" not in note  # of the other road
    assert at.load_road(straight_road(tmp_path / "b.xodr"), lane=-1).notes == ()


def gap_view(*gaps):
    """Straight elements of 50 m, each with a gap along the line and to the left before it (m)."""
    x, y, text = 0.0, 0.0, ""
    for k, (ahead, aside) in enumerate(gaps):
        x, y = x + ahead, y + aside
        text += f'<geometry s="{50 * k}" x="{x!r}" y="{y!r}" hdg="0" length="50"><line/></geometry>'
        x += 50.0
    return text


@pytest.mark.parametrize("lane", [None, -1])
def test_gaps_of_up_to_ten_centimetres_are_closed_and_noted(tmp_path, lane):
    path = straight_road(tmp_path / "a.xodr", view=gap_view((0, 0), (0.02, 0.03), (0, 0), (0.09, 0.0)))
    road = at.load_road(path, **{} if lane is None else {"lane": lane})
    assert road.length == pytest.approx(200.0)
    assert float(road.at(200.0).x) == pytest.approx(200.0)
    assert "closed: 2, the largest 0.0900 m at s = 150.00 m; the line moves by up to 0.114 m" in road.notes[0]
    road.to_toml(tmp_path / "road.toml")
    np.testing.assert_allclose(at.load_road(tmp_path / "road.toml").at(170.0), road.at(170.0), atol=1e-9)


def test_a_lap_with_gaps_stays_a_lap(tmp_path):
    view, radius = "", 50.0
    for k in range(8):
        angle = k * np.pi / 4.0
        x, y = radius * np.sin(angle) + 0.02 * (k > 3), radius * (1.0 - np.cos(angle))
        length = radius * np.pi / 4.0
        view += f'<geometry s="{k * length}" x="{x}" y="{y}" hdg="{angle}" length="{length}">'
        view += '<arc curvature="0.02"/></geometry>'
    road = at.load_road(straight_road(tmp_path / "a.xodr", view=view))
    assert road.closed
    assert "closed: 2, the largest 0.0200 m" in road.notes[0]
    road.to_toml(tmp_path / "road.toml")
    assert at.load_road(tmp_path / "road.toml").closed


def test_elements_of_length_zero_and_elements_beyond_the_end_are_left_out_and_noted(tmp_path):
    limits = ((0, 90), (200, 50), (225, 30))
    types = "".join(f'<type s="{s}" type="town"><speed max="{limit}" unit="km/h"/></type>' for s, limit in limits)
    lanes = section(0, lane_text(-1)), section(210, lane_text(-1, width=9.0))
    road = at.load_road(straight_road(tmp_path / "a.xodr", *lanes, view=LINES + EMPTY, before=types), lane=-1)
    assert road.length == pytest.approx(200.0)
    assert road.along("speed_limit", [0.0, 200.0]).tolist() == [25.0, 25.0]
    assert float(road.along("width_left", 200.0)) == 1.75
    assert "length 0 are left out, at s = 100.00 m" in road.notes[0]
    for place in ("type at s = 200.00 m", "type at s = 225.00 m", "laneSection at s = 210.00 m"):
        assert place in road.notes[1]


def test_a_section_of_a_single_side_leaves_the_other_side_as_it_is(tmp_path):
    path = straight_road(
        tmp_path / "a.xodr", section(0, lane_text(1), singleSide="true"),
        section(0, lane_text(-1), singleSide="true"), section(80, lane_text(1), lane_text(2), singleSide="true"),
    )  # fmt: skip
    road = at.load_road(path, lane=-1)
    assert float(road.at(150.0).y) == -1.75
    assert at.load_road(path).along("width_left", [50.0, 150.0]).tolist() == [3.5, 7.0]
    assert at.load_road(path).along("width_right", [50.0, 150.0]).tolist() == [3.5, 3.5]


@pytest.mark.parametrize("linked", ["successor", "predecessor", "both"])
def test_a_lane_is_followed_where_its_link_renumbers_it_and_other_types_are_noted(tmp_path, linked):
    ahead = '<link><successor id="-2"/></link>' if linked != "predecessor" else ""
    back = '<link><predecessor id="-1"/></link>' if linked != "successor" else ""
    turn = '<laneOffset s="0" a="0" b="0" c="0" d="0"/><laneOffset s="100" a="3" b="0" c="0" d="0"/>'
    sections = section(0, lane_text(-1, ahead)), section(100, lane_text(-1, width=3.0), lane_text(-2, back))
    road = at.load_road(straight_road(tmp_path / "a.xodr", turn, *sections), lane=-1)
    assert road.at([50.0, 150.0]).y == pytest.approx([-1.75, -1.75])
    assert road.notes == ("lane -1 is lane -2 from s = 100.00 m on",)
    path = straight_road(tmp_path / "a.xodr", section(0, lane_text(-1, type="sidewalk")))
    assert at.load_road(path, lane=-1).notes == ("lane -1 is of type sidewalk",)


# -- TOML -------------------------------------------------------------------------------------------------------------
def road_of_origin(kind, tmp_path):
    if kind == "elements":
        segments = [Line(length=50.0), Clothoid(length=30.0, start_curvature=0.0, end_curvature=0.02)]
        along = {"friction": Along(s=(0.0, 60.0), value=(0.9, 0.3), kind="steps"), "bank": 0.02, "width_left": 2.5}
        along["grade"] = ([0.0, 40.0, 70.0], [0.0, 0.08, -0.03])
        return at.Road.from_segments(
            segments, start=(4.5e5, 5.4e6, 1.0), speed_limit=([0.0, 9.0], [20.0, 9.0]), **along
        )
    if kind == "cubics":
        cubic = Cubic(x=(0.0, 40.0, 5.0, -8.0), y=(0.0, 0.0, 25.0, -12.0))
        return at.Road.from_segments([Line(length=9.0), cubic, cubic])
    if kind == "points":
        return at.fit_road(recorded(at.generate_road("lap", seed=1, length=700.0), 9.0, noise=0.1), max_deviation=1.0)
    if kind == "lane":
        return at.load_road(xodr(tmp_path / "a.xodr", LANES)[0], lane=-1)
    if kind == "opendrive":
        return at.load_road(xodr(tmp_path / "a.xodr", origin=(4.5e5, 5.4e6))[0])
    return at.generate_road(kind, seed=3, length=700.0)


@pytest.mark.parametrize("kind", ["elements", "cubics", "points", "lane", "opendrive", "lap"])
def test_a_road_of_any_origin_is_read_back_as_it_was_written(tmp_path, kind):
    road = road_of_origin(kind, tmp_path)
    road.to_toml(tmp_path / "road.toml")
    again = at.load_road(tmp_path / "road.toml")
    s = np.linspace(-5.0, road.length + 5.0, 3001)
    digits = 1e-9 + 4e-16 * np.abs(road.at(0.0).y)
    np.testing.assert_allclose(again.at(s), road.at(s), rtol=0, atol=digits)
    for name in ("width_left", "width_right", "speed_limit", "friction", "bank", "grade"):
        np.testing.assert_array_equal(again.along(name, s), road.along(name, s))
    for name in ("name", "closed", "notes", "deviation"):
        assert getattr(again, name) == getattr(road, name)


def test_a_road_file_by_hand_may_give_points(tmp_path):
    path = tmp_path / "corner.toml"
    path.write_text("closed = false\npoints = [[0, 0], [10, 0], [20, 0.5], [30, 2.0], [40, 4.5]]\nspeed_limit = 9\n")
    road = at.load_road(path, friction=0.4)
    assert road.name == "corner"
    assert road.deviation < 0.5
    assert float(road.along("speed_limit", 3.0)) == 9.0
    assert float(road.along("friction", 3.0)) == 0.4


# -- lanes that open or close, and files that contradict themselves ---------------------------------------------------
def tapered(number, start, width, slope):
    """A lane that opens or closes smoothly over 40 m."""
    cubic = f'c="{3.0 * slope / 40.0**2!r}" d="{-2.0 * slope / 40.0**3!r}"'
    widths = f'<width sOffset="{start}" a="{width}" b="0" {cubic}/>'
    widths += f'<width sOffset="{start + 40}" a="{width + slope}" b="0" c="0" d="0"/>'
    if start:
        widths = f'<width sOffset="0" a="{width}" b="0" c="0" d="0"/>{widths}'
    return f'<lane id="{number}" type="driving">{widths}</lane>'


OPENS, CLOSES = tapered(-2, 0, 0.0, 3.5), tapered(-2, 60, 3.5, -3.5)


@pytest.mark.parametrize(("sections", "extent"), [
    ([section(0, lane_text(-1), OPENS)], (20.0, 200.0)),
    ([section(0, lane_text(-1), lane_text(-2)), section(100, lane_text(-1), CLOSES)], (0.0, 180.0)),
    ([section(0, lane_text(-1), OPENS), section(100, lane_text(-1), CLOSES)], (20.0, 180.0)),
    ([section(0, lane_text(-1)), section(50, lane_text(-1), lane_text(-2))], (50.0, 200.0)),
    ([section(0, lane_text(-1), lane_text(-2)), section(150, lane_text(-1))], (0.0, 150.0)),
], ids=["opens", "closes", "both", "begins", "ends"])  # fmt: skip
def test_a_lane_that_opens_or_closes_is_read_where_it_is_wide_enough(tmp_path, sections, extent):
    road = at.load_road(straight_road(tmp_path / "a.xodr", *sections), lane=-2)
    start, end = road.at(0.0), road.at(road.length)
    assert (float(start.x), float(end.x)) == pytest.approx(
        extent, abs=1.01 if 20.0 in extent or 180.0 in extent else 1e-5
    )
    assert f"lane -2 is read from s = {abs(start.x):.2f} to {end.x:.2f} m, where it is wide enough" in road.notes
    inside = np.linspace(0.0, road.length, 50)
    assert road.along("width_left", inside).min() >= 0.5 * 1.75 - 1e-6
    middle = road.project(100.0, -5.25)
    assert abs(float(middle.offset)) < 1e-6


def test_a_narrow_lane_that_keeps_its_width_is_read_all_along(tmp_path):
    road = at.load_road(
        straight_road(tmp_path / "a.xodr", section(0, lane_text(-1, width=1.2, type="biking"))), lane=-1
    )
    assert road.length == pytest.approx(200.0, abs=1e-9)
    assert not any("wide enough" in note for note in road.notes)


JUMP = (
    '<laneOffset s="0" a="0" b="0" c="0" d="0"/><laneOffset s="80" a="3.5" b="0" c="0" d="0"/>',
    section(0, lane_text(1), lane_text(-1)), section(80, lane_text(-1), lane_text(-2)),
)  # fmt: skip
"""Lanes beside a line that jumps by their width."""


def test_a_lane_beside_a_lane_offset_that_jumps_is_read(tmp_path):
    path = straight_road(tmp_path / "a.xodr", *JUMP)
    linked = path.read_text().replace(
        lane_text(-1), lane_text(-1, '<link><predecessor id="-1"/><successor id="-2"/></link>'), 1
    )
    path.write_text(linked)
    road = at.load_road(path, lane=-1)
    assert road.length == pytest.approx(200.0, abs=1e-6)
    assert np.abs(road.at(np.linspace(0.0, 200.0, 21)).y + 1.75).max() < 1e-6


@pytest.mark.parametrize("s", ["1e-9", "1e-17", "0.0004", "-1e-12"])
def test_a_first_section_beside_0_begins_at_0(tmp_path, s):
    path = straight_road(tmp_path / "a.xodr", section(s, lane_text(1), lane_text(-1)))
    for lane in (None, -1):
        road = at.load_road(path, lane=lane)
        assert road.length == pytest.approx(200.0, abs=1e-9)
        assert float(road.along("width_right", 0.0)) == pytest.approx(3.5 if lane is None else 1.75)


def test_a_stated_length_that_is_not_that_of_the_geometry_is_noted(tmp_path):
    short = '<geometry s="0" x="0" y="0" hdg="0" length="7.5"><line/></geometry>'
    road = at.load_road(straight_road(tmp_path / "a.xodr", view=short))
    assert road.length == 7.5
    assert "its geometry is 7.5 m long, the file says 200" in road.notes
    assert not any("the file says" in note for note in at.load_road(straight_road(tmp_path / "b.xodr")).notes)


def test_a_step_of_the_height_is_noted_and_no_grade(tmp_path):
    def road_of(second):
        heights = f'<elevation s="0" a="1" b="0.02" c="0" d="0"/><elevation s="50" a="{second}" b="0" c="0" d="0"/>'
        profile = f"<elevationProfile>{heights}</elevationProfile>"
        return at.load_road(straight_road(tmp_path / "a.xodr", before=profile))

    assert "the height steps by 3 m at s = 50.00 m: left out" in road_of(5.0).notes
    assert float(road_of(5.0).grade.value[0]) == pytest.approx(0.02)
    assert max(road_of(5.0).grade.value) == pytest.approx(0.02)
    assert not any("height" in note for note in road_of(2.0).notes)


@pytest.mark.parametrize("most", ["0", "-10", "0.0"])
def test_a_speed_limit_that_is_not_above_0_is_left_out_with_a_note(tmp_path, most):
    kind = f'<type s="0" type="rural"><speed max="{most}" unit="km/h"/></type>'
    lane = lane_text(-1, f'<speed sOffset="0" max="{most}"/>')
    for road in (
        at.load_road(straight_road(tmp_path / "a.xodr", before=kind)),
        at.load_road(straight_road(tmp_path / "b.xodr", section(0, lane)), lane=-1),
    ):
        assert road.speed_limit is None
        assert any(f"left out, not above 0: speed max='{most}'" in note for note in road.notes)


# -- what is refused --------------------------------------------------------------------------------------------------
LINE = "elements = [{kind = 'line', length = 50.0}]\n"
PIECE = f"""[[pieces]]
half = {{half}}
x = 0.0
y = 0.0
heading = 0.0
along = {[0.0, 25.0] + 10 * [0.0]}
across = {12 * [0.0]}
turned = [0.0, {{turned}}, {", ".join(10 * ["0.0"])}]
"""
SPEEDS = [8.0] * 4
KINK = '<width sOffset="0" a="0" b="0.0875" c="0" d="0"/><width sOffset="40" a="3.5" b="0" c="0" d="0"/>'


NO_ROADS = {
    "bad.csv": [
        ("x,y\n1,2\n", "1 lines of numbers"),
        ("x,y\n1,2\n3,4\n5,abc\n7,8\n9,9\n", "line 4: 'abc'"),
        ("x,y\n1,2\n3,4\n5,6,7\n7,8\n9,9\n", "line 4: 3 columns"),
        ("1,2,3\n" * 5, "3 columns without a header"),
        ("lat,lon\n" + "1,2\n" * 5, "convert them to x"),
        ("xx,y\n" + "1,2\n" * 5, "'x'"),
        ("x,y\n" + "1,2\n" * 5, "n >= 4"),
        ("x,y,width_left [cm]\n" + "1,2,3\n" * 5, r"line 1: column 'width_left \[cm\]': must be in m; convert"),
        ("x,y\n1,2\n3,4\n5,1e308\n7,8\n9,9\n", "line 4 has a coordinate of 1e[+]308 m"),
        (raceline([*SPEEDS, "nan"]), "line 7: 'nan' is not a finite number", {"speed_column": "vx_mps"}),
        (raceline([*SPEEDS, "-3"]), "line 7: vx_mps = -3: must be > 0 and at most 100 m/s",
         {"speed_column": "vx_mps"}),
        (raceline([*SPEEDS, "180"]), "line 7: vx_mps = 180: .* at most 100 m/s", {"speed_column": "vx_mps"}),
        (raceline(SPEEDS, "v_kmh"), "line 2: column 'v_kmh': must be in m/s; convert", {"speed_column": "v_kmh"}),
        (raceline(SPEEDS, "v [rad/s]"), "must be in m/s; convert", {"speed_column": "v"}),
        (raceline(SPEEDS), "line 2: no single column is 'vx_mp': Did you mean 'vx_mps'", {"speed_column": "vx_mp"}),
        (raceline(SPEEDS, "x_m"), "there are two of them", {"speed_column": "x_m"}),
    ],
    "bad.xodr": [
        ("<OpenDRIVE>", "not XML"),
        ("<osm/>", "<osm>"),
        ("<OpenDRIVE/>", "no <road>"),
        ('<OpenDRIVE><road id="a" length="abc"/><road id="b" length="9"/></OpenDRIVE>', r"'b' \(9 m\), 'a'"),
        ('<?xml version="1.0" encoding="foo-8"?><OpenDRIVE/>', "not XML: unknown encoding: foo-8"),
        ('<OpenDRIVE><road id="a"/></OpenDRIVE>', "planView"),
        (one_element('<paramPoly3 pRange="normalized" aU="0" bU="1e7" cU="0" dU="0" {zero}/>'), "1e[+]07 m apart"),
        (one_element('<paramPoly3 pRange="arcLength" aU="0" bU="1" cU="0" dU="-5" {zero}/>'), "5e[+]06 m apart"),
        (one_element('<poly3 a="0" b="0" c="0" d="1e300"/>'), "m apart in all"),
        (one_element('<arc curvature="10"/>', 2000), r"arc, 2000 m long: its turn = 20000: at most 10,000 rad"),
        (one_element('<spiral curvStart="-10" curvEnd="10"/>', 2000), "its turn = 20000"),
        (one_element('<arc curvature="x"/>'), "arc curvature='x'"),
        (one_element("<curl/>"), "<curl>; known: line"),
        (xodr_text(LANES), "there is no lane -3; there are -2, -1", {"lane": -3}),
        (xodr_text(LANES), "run with the road", {"lane": 1}),
        (xodr_text(LANES), "no road has the id 'c'", {"road": "c"}),
        (xodr_text(LANES).replace('hdg="0.3"', 'hdg="0.4"', 1), "10 m apart at s = 100"),
        (xodr_text().replace('x="0.0"', 'x="1e300"', 1), r"a coordinate of 1e\+300 m: at most 1e\+08 m"),
        (straight_text(view=gap_view((0, 0), (0.0, 0.11))), r"0.11 m apart at s = 50.00 m"),
        (straight_text(view=EMPTY), "longer than 0"),
        (straight_text(rule="lht"), "road rule='lht'>: must be one of RHT, LHT"),
        (straight_text(*JUMP), r"at s = 80.00 m <laneOffset> jumps by 3.5 m: choose a lane: -2, -1, 1"),
        (straight_text(section(0, lane_text(-1), lane_text(-2, width=0.0))),
         "lane -2 has no <width> above 0; there are -2, -1", {"lane": -2}),
        (straight_text(section(0, lane_text(-1), f'<lane id="-2">{KINK}</lane>')),
         r"0.0437 rad of kink .* middle of lane -2: see its <width>", {"lane": -2}),
        *((straight_text(section(0, lane_text(1, type="sidewalk"), lane_text(-1), lane_text(-2))),
           rf"there is no lane {lane}; there are -2, -1, 1 \(sidewalk\)\.", {"lane": lane}) for lane in (5, -7, 0)),
    ],
    "bad.toml": [
        ('name = "x"', "neither elements nor points"),
        ("points = [[0, 0]]\n" + LINE, "elements and points: give"),
        ("[[elements]]\nkind = 'line'\nlength = -3.0", r"elements\[0\].length = -3.0"),
        ("[[elements]]\nkind = 'lne'\nlength = 3.0", "Did you mean 'line'"),
        ("frction = 1.0\n" + LINE, "Did you mean 'friction'"),
        ("friction = 'wet'\n" + LINE, "friction = 'wet': must be a number, or a table"),
        ("friction = {s = [0.0, 0.0], value = [1.0, 1.0]}\n" + LINE, "must increase"),
        ("closed = true\n" + LINE, "50 m apart at the end and the start"),
        ("max_deviation = 1.0\n" + LINE, "max_deviation is for points"),
        (LINE + "speed_limit = 1" + "0" * 400, "speed_limit = 1000.*: must be a valid number"),
        ("points = [[0.0, 0.0], [1.0, nan], [2.0, 0.0], [3.0, 0.0]]", r"points\[1\]\[1\] = nan"),
        (PIECE.format(half="1e20", turned=0.0), r"pieces\[0\].half = 1e[+]20: must be .* <= 1e[+]06"),
        (PIECE.format(half="25.0", turned="1e308"), r"pieces\[0\].turned\[1\] = 1e[+]308"),
        ("points = [", "not valid TOML"),
    ],
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "text", "words", "options"),
    [(name, text, words, dict(*options)) for name, rows in NO_ROADS.items() for text, words, *options in rows],
)
@pytest.mark.filterwarnings("error")
def test_a_file_that_is_no_road_is_refused_with_its_place(tmp_path, name, text, words, options):
    (tmp_path / name).write_text(text)
    with pytest.raises(at.ConfigError, match=words):
        at.load_road(tmp_path / name, **options)
