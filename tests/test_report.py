"""The page is complete, needs nothing but itself, and appears whole or not at all; figures show what was run."""

import dataclasses
import html.parser
import json
import os
import re

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text

from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.result import (
    Axis,
    Callout,
    Column,
    Dots,
    HeatMap,
    Panel,
    Picture,
    Polyline,
    Result,
    ResultTable,
    Scale,
    strokes,
)
from adaptrack.drive.metrics import compute_metrics
from adaptrack.drive.trajectory import Origin, Trajectory, provenance
from adaptrack.results import (
    Run,
    conditions_figure,
    draw,
    figures,
    page,
    runs,
    speed_figure,
    style,
    tracking_figure,
    words,
    write_report,
    write_result,
)
from adaptrack.results.dots import Dot, notes
from adaptrack.results.evaluation import shared_scale
from adaptrack.results.maps import edges_around
from pictures import pictures


def drive(controller="standard", scenario="triple-lane-change", *, scale=1.0, n=280, adapt=False, **meta):
    """A made-up run: a sine around a ramp, `scale` metres off."""
    t = 0.1 * np.arange(n)
    wave = np.sin(0.9 * t)
    horizon = np.round(30 + 15 * wave).astype(int) if adapt else np.full(n, 35)
    record = provenance(
        Origin(
            scenario=scenario,
            plant="dual-track",
            tyre="constant-stiffness",
            vehicle="paper",
            profile="paper",
            seed=7,
            preview=False,
            controller=controller,
            tuning={"Np": 35, "Nc": 8, "Q": 10.0, "R": 0.01},
        ),
        "2026-01-02T03:04:05+00:00",
    )
    return Trajectory(
        t=t,
        X=15 * t,
        Y=0.2 * t + 0.2 * scale * wave,
        psi=0.02 * wave,
        vx=15 + wave,
        vy=0.1 * wave,
        yaw_rate=0.05 * scale * wave,
        steering=0.03 * wave,
        command=0.03 * scale * wave,
        command_change=0.003 * wave,
        y_ref=0.2 * t,
        v_ref=15 + wave,
        friction=np.full((n, 4), 0.7),
        wind=np.stack([0 * t, 20 * wave], axis=1),
        lateral_acceleration=wave,
        held=np.zeros(n, bool),
        step_time=np.full(n, 1e-5),
        period=0.1,
        tuning={
            "Np": horizon,
            "Nc": np.full(n, 8),
            "Q": np.full(n, 10.0),
            "R": np.full(n, 0.01) * (1 + adapt * np.abs(wave)),
        },
        diagnostics={
            "qp_status": np.zeros(n, int),
            "qp_iterations": np.full(n, 3),
            "qp_residual": np.full(n, 1e-12),
            "at_limit": np.zeros(n, int),
        },
        units={"tuning.Q": "1/m^2", "tuning.R": "1/rad^2"},
        meta=record | meta,
    )


def lost(run, at=100):
    """The same run, thrown off its reference from step `at`, NaN thirty steps later."""
    Y = run.Y.copy()
    Y[at:] += np.exp(0.2 * np.arange(len(run) - at)) - 1
    Y[at + 30 :] = np.nan
    return dataclasses.replace(run, Y=Y)


class Outline(html.parser.HTMLParser):
    """What a page holds: tags with their attributes, and its visible text."""

    def __init__(self, text):
        super().__init__()
        self.tags, self.open, self.words = [], [], []
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))
        if tag not in {"meta", "link", "br", "path", "use", "rect", "line", "image", "clippath"}:
            self.open.append(tag)

    def handle_startendtag(self, tag, attributes):
        self.tags.append((tag, dict(attributes)))

    def handle_endtag(self, tag):
        if tag in self.open:
            assert self.open.pop() == tag

    def handle_data(self, data):
        if not {"style", "svg"} & set(self.open):
            self.words.append(data)

    @property
    def text(self):
        return " ".join(" ".join(self.words).split())

    def all(self, tag):
        return [attributes for name, attributes in self.tags if name == tag]


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """A report on both tests of the paper, three controllers each, one of them lost on one test."""
    folder = tmp_path_factory.mktemp("report") / "out"
    standard = drive()
    shown = [
        standard,
        drive("nn", scale=0.4, adapt=True),
        lost(drive("anfis", scale=0.5, adapt=True)),
        drive(scenario="general-trajectory", n=2000),
        drive("nn", "general-trajectory", scale=0.3, adapt=True, n=2000),
    ]
    with pictures(drawn=True):
        path = write_report(folder, shown, title="Both tests", command="adaptrack simulate --out <here>")
    return folder, path.read_text(), standard


def test_the_page_needs_nothing_but_itself(report):
    folder, text, _ = report
    outline = Outline(text)
    assert not outline.all("script")
    assert not outline.all("img")
    assert "@import" not in text
    for tag, attributes in outline.tags:
        for name in ("src", "href", "xlink:href"):
            target = attributes.get(name) or ""
            if target and not target.startswith(("#", "data:")):
                assert tag == "a"
                assert (folder / target).is_file(), target
    assert not re.search(r"https?://|url\((?!#)", text)


def test_the_page_opens_with_verdict_and_picture(report):
    _, text, _ = report
    first = text[text.index("</h1>") : text.index("<nav")]
    best = "Smallest mean square error: NN-MPC, Triple lane change, 0.00319 m²; NN-MPC, General trajectory, 0.00179 m²."
    assert best in first, "errors of different scenarios are not compared"
    assert first.index('class="verdict"') < first.index("<svg role") < first.index('class="introduction"')
    assert "each other; the paper&#39;s error (ring)" in first


def test_a_single_run_is_told_with_its_error_what_it_is_held_against_and_how_sure_that_is(tmp_path, monkeypatch):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    told = Outline(write_report(tmp_path, [drive(seed=3, profile="road")]).read_text()).text
    assert "Standard MPC follows the triple lane change within 0.1" in told
    assert "Against nothing" in told
    assert "one run with noise seed 3; other seeds give other numbers" in told


@pytest.mark.drawn
def test_text_in_pictures_is_text_and_keeps_its_words():
    figure = style.panel_figure(lambda axes: axes.set_title('#0072b2 id="a" Größe'))
    assert '#0072b2 id="a" Größe</text>' in style.inline_svg(figure, "p1", "A title").replace("&quot;", '"')


@pytest.mark.drawn
def test_whole_numbers_have_ticks_at_whole_numbers():
    for high in (7, 10, 12, 23, 30, 99):
        figure = style.panel_figure(lambda axes, high=high: axes.plot([0, high], [0, high]))
        style.inline_svg(figure, "p1", "A line")
        step = np.diff(figure.axes[0].get_yticks())[0]
        assert round(step / 10.0 ** np.floor(np.log10(step) + 1e-9), 6) in (1.0, 2.0, 5.0)


def test_steering_has_degrees_beside_radians_and_shows_the_wheels():
    run = drive(scale=0.5)
    steering = tracking_figure({"x": run}).axes[2]
    drawn = [line.get_ydata() for line in steering.lines if len(line.get_ydata()) == len(run)]
    assert any(np.array_equal(values, run.steering) for values in drawn)
    (degrees,) = steering.child_axes
    steering.figure.draw_without_rendering()  # the canvas of these figures draws nothing by itself
    assert degrees.get_ylim() == pytest.approx(np.degrees(steering.get_ylim()))


def test_every_tag_is_closed_and_every_id_is_unique(report):
    _, text, _ = report
    outline = Outline(text)
    assert outline.open == []
    ids = [attributes["id"] for _, attributes in outline.tags if "id" in attributes]
    assert len(ids) == len(set(ids))
    links = [a["href"][1:] for _, a in outline.tags if (a.get("href") or "").startswith("#")]
    assert set(links) <= set(ids)
    clips = re.findall(r"url\(#([^)]+)\)", text)
    assert set(clips) <= set(ids)


def test_every_picture_is_described_in_words(report):
    _, text, _ = report
    pictures = [svg for svg in Outline(text).all("svg") if "aria-hidden" not in svg]
    assert len(pictures) == 1 + 2 + 2 * 8  # the verdict's, speed of both scenarios, eight panels for each
    assert all(svg["role"] == "img" and len(svg["aria-label"]) > 30 for svg in pictures)
    error, _ = (svg["aria-label"] for svg in pictures if "Tracking error. Y" in svg["aria-label"])
    assert error.startswith(
        "Tracking error. Y - y_ref (m), over time. Standard MPC: −0.2 to 0.2; NN-MPC: −0.08 to 0.08"
    )


def test_the_folder_holds_the_page_and_its_pngs_only(report):
    folder, _, _ = report
    names = sorted(os.listdir(folder))
    assert names == [
        "general-trajectory-conditions.png",
        "general-trajectory-tracking.png",
        "index.html",
        "speed.png",
        "triple-lane-change-conditions.png",
        "triple-lane-change-tracking.png",
    ]
    assert all((folder / name).read_bytes().startswith(b"\x89PNG") for name in names if name.endswith(".png"))


def test_the_papers_numbers_stand_beside_ours(report):
    _, text, standard = report
    shown = Outline(text).text
    for value in ("0.0318", "0.0051", "0.5896", "0.132"):
        assert value in shown
    assert words.number(compute_metrics(standard).mse) in shown


def test_a_lost_run_is_said_to_be_lost_and_never_best(report):
    _, text, _ = report
    shown = Outline(text).text
    why = r"the vehicle left the road \(more than 5 m from the reference\)\."
    assert re.search(rf"Failed: ANFIS-MPC, at 10\.\d s; {why}", shown)
    assert "Best tracking: NN-MPC" in shown
    assert "∞" in shown


def test_the_heading_says_first_that_runs_failed(report, tmp_path, monkeypatch):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    _, text, _ = report
    assert "<title>1 of 5 runs failed · Both tests</title>" in text
    shown = Outline(text).text
    assert shown.index("1 of 5 runs failed") < shown.index("adaptrack ")
    assert "Failed: Triple lane change, ANFIS-MPC, at 10." in shown[: shown.index("At a glance")]

    words = [part.strip() for part in Outline(write_report(tmp_path / "one", [lost(drive())]).read_text()).words]
    title, heading, subject, *_ = filter(None, words)
    assert re.fullmatch(r"Failed at 1\d\.\d s: the vehicle left the road \(more than 5 m from the reference\)", heading)
    assert (title, subject) == (f"{heading} · Triple lane change, Standard MPC", "Triple lane change, Standard MPC")


def test_a_page_without_a_failed_run_does_not_speak_of_one_in_its_heading(tmp_path, monkeypatch):
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)
    text = write_report(tmp_path, [drive()]).read_text()
    assert "<h1>Triple lane change: Standard MPC</h1>" in text


def test_the_provenance_is_complete(report):
    _, text, _ = report
    shown = Outline(text).text
    for entry in ("Profile paper", "Plant dual-track", "Tyre constant-stiffness", "Preview no", "Seed 7", "kernels"):
        assert entry in shown
    assert "adaptrack simulate --out <here>" in shown  # escaped in the source, whole for the reader
    assert "<here>" not in text


@pytest.mark.drawn
def test_the_same_runs_give_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        write_report(tmp_path / name, [drive()])
    for name in os.listdir(tmp_path / "a"):
        assert (tmp_path / "a" / name).read_bytes() == (tmp_path / "b" / name).read_bytes(), name


def test_text_from_a_scenario_file_cannot_break_the_page(tmp_path):
    nasty = '<script>alert("1")</script> & "quotes"'
    text = write_report(tmp_path, [drive(nasty, scenario=nasty)]).read_text()
    outline = Outline(text)
    assert not outline.all("script")
    assert nasty in outline.text


def test_runs_of_one_controller_are_told_apart_by_what_differs():
    pulses = drive(moves={"kind": "pulse"})
    laguerre = drive(control={"moves": {"kind": "laguerre", "pole": 0.95}})
    (shown,) = runs.grouped([Run(pulses), Run(laguerre)])["triple-lane-change"].values()
    assert [run.label for run in shown] == ["Standard MPC, pulse moves", "Standard MPC, laguerre (pole 0.95) moves"]
    (same,) = runs.grouped([Run(pulses), Run(pulses)])["triple-lane-change"].values()
    assert [run.label for run in same] == ["Standard MPC, no. 1", "Standard MPC, no. 2"]


def test_preview_and_profile_get_figures_of_their_own():
    settings = runs.grouped([Run(drive()), Run(drive(preview=True)), Run(drive("nn", preview=True))])
    assert {name: len(own) for name, own in settings["triple-lane-change"].items()} == {
        "without preview": 1,
        "with preview": 2,
    }


def test_windows_of_one_scenario_are_not_mixed():
    assert set(runs.grouped([Run(drive()), Run(drive(n=460))])) == {
        "triple-lane-change (28 s)",
        "triple-lane-change (46 s)",
    }


def test_runs_without_provenance_are_reported_as_such(tmp_path):
    bare = dataclasses.replace(drive(), meta={})
    text = write_report(tmp_path, [bare]).read_text()
    assert "Unnamed scenario" in text


def test_a_report_without_runs_is_refused(tmp_path):
    with pytest.raises(InvalidInput, match="at least one run"):
        write_report(tmp_path / "out", [])
    assert not (tmp_path / "out").exists()


def said(answer, *pictures):
    """A result of a kind that has no page of its own."""
    return Result(kind="any", title="Any", answer=answer, record={}, pictures=pictures)


def line(file):
    """A picture of a line."""
    marks = [Polyline([0.0, 1.0], [0.0, 1.0])]
    return Picture(file, "A line.", [Panel("Line", Axis("x"), Axis("y"), marks, "From 0 to 1.")], file=file)


def test_a_failed_report_leaves_the_old_one_and_nothing_else(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_result(out, said("first"))
    before = {name: (out / name).read_bytes() for name in os.listdir(out)}

    def full(self, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(page.Path, "write_bytes", full)
    with pytest.raises(StorageError, match="No space left"):
        write_result(out, said("second"))
    with pytest.raises(StorageError, match="No space left"):
        write_result(tmp_path / "fresh", said("second"))
    monkeypatch.undo()
    assert {name: (out / name).read_bytes() for name in os.listdir(out)} == before
    assert os.listdir(tmp_path) == ["out"]


def test_an_unusable_folder_is_refused_with_its_name(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        write_result(tmp_path / "file", said("first"))
    (tmp_path / "out" / "index.html").mkdir(parents=True)
    with pytest.raises(StorageError, match="a folder has that name"):
        write_result(tmp_path / "out", said("first"))
    assert os.listdir(tmp_path / "out") == ["index.html"]


def test_two_pictures_cannot_share_a_file(tmp_path):
    with pytest.raises(InvalidInput, match="used twice"):
        write_result(tmp_path / "out", said("a", line("a.png"), line("a.png")))
    with pytest.raises(InvalidInput, match="not a name"):
        write_result(tmp_path / "out", said("a", line("../a.png")))
    assert not (tmp_path / "out").exists()


def test_a_page_without_png_files_shows_the_same_pictures_and_draws_nothing_for_print(tmp_path, monkeypatch):
    both = write_result(tmp_path / "both", said("a", line("a.png"))).read_text()
    monkeypatch.setattr(draw, "print_figure", lambda picture: pytest.fail("drawn for print"))
    alone = write_result(tmp_path / "alone", said("a", line("a.png")), png=False).read_text()
    assert os.listdir(tmp_path / "alone") == ["index.html"]
    assert sorted(os.listdir(tmp_path / "both")) == ["a.png", "index.html"]
    assert both.replace(' <a href="a.png">PNG for print</a>', "") == alone


def test_a_result_of_any_kind_becomes_a_page_of_everything_it_holds(tmp_path):
    columns = (Column("name", "Name"), Column("value", "Value", "m"))
    table = ResultTable("one", "Results", columns, [{"name": "a", "value": 1, "part": "Group"}], "Note.", "part")
    result = dataclasses.replace(said("words", line("")), tables=[table], notes=["Beside."], command="make run")
    outline = Outline(write_result(tmp_path, result).read_text())
    for text in ("Any", "words", "Results", "Group", "Note.", "A line.", "Beside.", "make run"):
        assert text in outline.text


def legend_texts(figure):
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def test_figures_have_the_papers_panels_with_units():
    fleet = {"Standard MPC": drive(), "NN-MPC": drive("nn", adapt=True)}
    four = conditions_figure(fleet)
    assert [axes.get_title("left") for axes in four.axes] == [
        "(a) Lateral gust",
        "(b) Road friction",
        "(c) Horizons",
        "(d) Weights",
    ]
    assert four.axes[3].get_yscale() == "log"
    tracking = tracking_figure(fleet)
    assert [axes.get_title("left")[4:] for axes in tracking.axes] == [
        "Trajectory tracking",
        "Tracking error",
        "Steering",
        "Yaw rate",
    ]
    assert legend_texts(tracking) == ["Reference", "Standard MPC", "NN-MPC"]
    for axes in four.axes + tracking.axes:
        assert re.search(r"\(.+\)$", axes.get_ylabel()), axes.get_ylabel()


def test_a_speed_that_all_drive_is_drawn_once():
    both = {"triple-lane-change": {"a": drive(), "b": drive()}}
    assert legend_texts(speed_figure(both)) == ["Profile", "Driven"]
    slower = drive()
    slower = dataclasses.replace(slower, vx=slower.vx - 1.0)
    assert legend_texts(speed_figure({"step": {"a": drive(), "b": slower}})) == ["Profile", "a", "b"]


@pytest.mark.drawn
def test_legends_cover_no_curve():
    figure = tracking_figure({f"controller {i}": drive(scale=1 + 0.1 * i) for i in range(8)})
    style.png(figure)  # settles the layout
    legend = figure.legends[0].get_window_extent()
    assert all(not legend.overlaps(axes.get_window_extent()) for axes in figure.axes)


@pytest.mark.drawn
@pytest.mark.parametrize("height", [1e-7, 1.0, 3e8])
def test_a_title_stays_clear_of_the_factor_above_its_axis(height):
    def draw(axes):
        axes.plot([0.0, height])
        axes.set_title("A title that is long enough to lie above the y axis")

    figure = style.panel_figure(draw)
    figure.dpi = 72  # that of an SVG, in which the places below are counted
    style.inline_svg(figure, "p1", "a line")
    (axes,) = figure.axes
    title, factor = axes.get_title("left"), axes.yaxis.get_offset_text()
    assert bool(factor.get_text()) == (height != 1.0)
    (drawn,) = figure.findobj(lambda each: isinstance(each, Text) and each.get_text() == title)
    assert not (factor.get_text() and drawn.get_window_extent().overlaps(factor.get_window_extent()))


def test_a_lost_run_ends_where_it_was_lost_and_does_not_set_the_scale():
    good, bad = drive(), lost(drive("nn"))
    figure = tracking_figure({"good": good, "bad": bad})
    error = figure.axes[1]
    assert error.get_ylim()[1] < 1.0  # the lost run reaches 5 m and more
    ends = [line.get_xdata()[-1] for line in error.get_lines() if line.get_color() == style.SERIES[1]]
    assert all(10.0 < end < 12.0 for end in ends)


@pytest.mark.drawn
def test_runs_that_hold_only_nan_can_be_drawn():
    broken = drive()
    empty = np.full(len(broken), np.nan)
    broken = dataclasses.replace(
        broken, Y=empty, vx=empty, yaw_rate=empty, command=empty, tuning={**broken.tuning, "Q": empty}
    )
    for figure in (
        tracking_figure({"x": broken}),
        conditions_figure({"x": broken}),
        speed_figure({"s": {"x": broken}}),
    ):
        style.png(figure)


def test_start_up_from_standstill_does_not_flatten_the_rest():
    run = drive()
    speed, command = run.vx.copy(), run.command.copy()
    speed[:5], command[:5] = 0.5, 0.5
    figure = tracking_figure({"x": dataclasses.replace(run, vx=speed, steering=command)})
    steering = figure.axes[2]
    assert steering.get_ylim()[1] < 0.1
    assert steering.get_title("right") == "start: −0.03 to 0.5"


def test_the_page_says_for_how_long_a_controller_had_no_position_and_only_then(tmp_path):
    run = drive()
    blind = {**run.diagnostics, "dead_reckoning": np.where((run.t > 5.0) & (run.t < 6.05), run.t - 5.0, 0.0)}
    for each, told in ((dataclasses.replace(run, diagnostics=blind), True), (run, False)):
        text = Outline(write_report(tmp_path / str(told), [each]).read_text()).text
        assert ("steered on its estimate" in text) == told
        assert ("No position steps" in text) == told
        assert not told or "In 10 control periods there was no new position, for 1.00 s at the longest" in text


def test_steps_in_which_a_safe_angle_was_held_are_marked():
    run = drive()
    held = (run.t > 5.0) & (run.t < 6.0)
    steering = tracking_figure({"x": dataclasses.replace(run, held=held)}).axes[2]
    (squares,) = (line for line in steering.get_lines() if line.get_marker() == "s")
    assert squares.get_xdata().tolist() == run.t[held].tolist()
    assert steering.get_title("right") == "□ held"


@pytest.mark.parametrize(
    ("wheels", "key"),
    [
        ([0.7, 0.7, 0.7, 0.7], []),
        ([0.8, 0.3, 0.8, 0.3], ["left", "right"]),
        ([0.8, 0.8, 0.3, 0.3], ["front", "rear"]),
        ([0.8, 0.7, 0.6, 0.5], ["front left", "front right", "rear left", "rear right"]),
    ],
)
def test_friction_is_drawn_for_the_wheels_that_differ(wheels, key):
    run = dataclasses.replace(drive(), friction=np.tile(wheels, (280, 1)))
    legend = conditions_figure({"x": run}).axes[1].get_legend()
    assert ([text.get_text() for text in legend.get_texts()] if legend else []) == key


def test_a_figure_needs_a_run_and_a_stroke_for_it():
    with pytest.raises(InvalidInput, match="at least one run"):
        tracking_figure({})
    with pytest.raises(InvalidInput, match="no stroke for 'x'"):
        tracking_figure({"x": drive()}, strokes(["y"]))


@pytest.mark.drawn
def test_figures_leave_the_users_matplotlib_alone():
    before = dict(mpl.rcParams)
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "pink"}):
        mine = style.png(tracking_figure({"x": drive()}))
    assert mine == style.png(tracking_figure({"x": drive()}))
    assert dict(mpl.rcParams) == before


def test_eighteen_controllers_have_eighteen_strokes():
    drawn = strokes(f"c{i}" for i in range(18))
    assert len({(s.colour, str(s.dash)) for s in drawn.values()}) == 18


# Linear-light simulation of dichromacy: Viénot, Brettel and Mollon (1999), in linear sRGB.
DICHROMACY = {
    "protan": [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]],
    "deutan": [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]],
    "normal": np.eye(3).tolist(),
}


def lab(colour, matrix):
    """CIE L*a*b* (D65) of an sRGB colour seen through `matrix`."""
    rgb = np.array(mpl.colors.to_rgb(colour))
    linear = np.clip(np.array(matrix) @ np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4), 0, 1)
    xyz = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]) @ linear
    f = np.cbrt(xyz / [0.9505, 1.0, 1.089])
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


@pytest.mark.parametrize("vision", DICHROMACY)
def test_neighbouring_colours_differ_for_colour_blind_readers(vision):
    seen = [lab(colour, DICHROMACY[vision]) for colour in style.SERIES]
    gaps = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[:i]]
    assert min(gaps) > 12.0  # a just noticeable difference is about 2.3


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0318, "0.0318"),
        (0.00003, "3.00·10⁻⁵"),
        (0.9996, "1.00"),
        (1234.5, "1\u202f234"),
        (12, "12"),
        (-0.25, "−0.250"),
        (0.0, "0"),
        (2.5e7, "2.50·10⁷"),
        (float("nan"), "–"),
        (float("inf"), "∞"),
        (None, "–"),
    ],
)
def test_numbers_are_written_for_readers(value, text):
    assert words.number(value) == text


@pytest.mark.parametrize(
    ("low", "high", "ticks"),
    [
        (0.95, 1.2, [0.95, 1.0, 1.05, 1.1, 1.15, 1.2]),
        (0.9, 3.2, [1.0, 1.5, 2.0, 3.0]),
        (1.0, 100.0, [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]),
        (0.5, 1e4, [1.0, 10.0, 100.0, 1000.0, 1e4]),
    ],
)
def test_a_logarithmic_axis_has_round_numbers_however_short_it_is(low, high, ticks):
    assert style.log_ticks(low, high)() == pytest.approx(ticks)
    axes = Figure().subplots()
    style.logarithmic(axes, "y", (low, high))
    assert axes.get_ylim() == (low, high)
    assert [label.get_text() for label in axes.get_yticklabels()] == [f"{tick:g}" for tick in ticks]


def test_a_logarithmic_axis_without_limits_has_those_of_its_curves():
    axes = Figure().subplots()
    axes.margins(0.0)
    axes.plot([1.0, 2.0], [0.2, 40.0])
    style.logarithmic(axes, "y")
    assert axes.get_ylim() == pytest.approx((0.2, 40.0))


def test_a_printed_figure_has_all_panels_and_writes_what_neighbours_share_once():
    titles = {"One": "Share (%)", "Two": "Share (%)", "Three": "Cost (m²)"}
    panels = [Panel(title, Axis(), Axis(label), [], "") for title, label in titles.items()]
    figure = draw.print_figure(Picture("any", "", panels, columns=2))
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["(a) One", "(b) Two", "(c) Three"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["Share (%)", "", "Cost (m²)"]
    (alone,) = draw.print_figure(Picture("any", "", panels[:1])).axes
    assert alone.get_title(loc="left") == "One"


def test_the_words_of_a_panel_hold_no_marks_of_mathematics():
    panel = Panel(r"$\log_{10} R/Q$", Axis(), Axis(), [], r"Over $|y_\mathrm{ref}|$: 3 to 4.")
    assert draw.described(panel) == "log10 R/Q. Over |y_ref|: 3 to 4."


def test_cells_of_a_heat_map_lie_around_their_levels():
    assert edges_around(np.array([2.0, 4.0, 10.0])) == pytest.approx([1.0, 3.0, 7.0, 13.0])
    assert edges_around(np.array([0.7])) == pytest.approx([0.63, 0.77])
    assert edges_around(np.array([0.0])) == pytest.approx([-0.5, 0.5])


def test_the_colours_of_several_maps_span_all_their_numbers():
    scale = shared_scale([np.array([[1.0, np.nan]]), np.array([[7.0]])], whole=True)
    assert (scale.low, scale.high) == (1.0, 7.0)
    alike = shared_scale([np.array([[3.0]])], whole=False)
    assert (alike.low, alike.high) == (2.5, 3.5)


@pytest.mark.parametrize("image", [False, True])
def test_a_heat_map_shows_its_numbers_where_they_belong(image):
    heat = HeatMap([0.0, 10.0, 20.0], [0.3, 1.0], [[1.0, 2.0]], Scale(1.0, 2.0), image=image)
    axes = draw.panel_figure(Panel("Map", Axis("Speed (m/s)"), Axis("Friction (–)"), [heat], "1 to 2.")).axes[0]
    (drawn,) = axes.images if image else axes.collections
    assert np.ravel(drawn.get_array()).tolist() == [1.0, 2.0]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 20.0), (0.3, 1.0))
    assert (drawn.norm.vmin, drawn.norm.vmax) == (1.0, 2.0)


def test_words_apart_from_their_point_are_joined_to_it():
    said = Callout(1.0, 2.0, "here", (1.5, 2.5), at_left=True)
    axes = draw.panel_figure(Panel("", Axis(high=3.0), Axis(high=3.0), [Dots([1.0], [2.0]), said], "")).axes[0]
    (words,) = axes.texts
    assert (words.get_text(), words.xy, words.xyann) == ("here", (1.0, 2.0), (1.5, 2.5))
    assert words.arrow_patch is not None


def test_many_names_along_an_axis_stand_upright():
    for count, turned in ((2, 0.0), (5, 90.0)):
        names = [f"road {i}" for i in range(count)]
        axes = draw.panel_figure(Panel("", Axis(names=names), Axis(), [Dots([0.0], [1.0])], "")).axes[0]
        assert {label.get_rotation() for label in axes.get_xticklabels()} == {turned}


def test_an_interval_has_as_many_digits_as_tell_its_ends_apart():
    ratio = Column("ratio", "Ratio", show=3)
    assert words.entry((0.5, 2.0), ratio) == "0.500 to 2.00"
    assert words.entry((1.0012, 1.0039), ratio) == "1.001 to 1.004"


def test_settings_are_described_in_words():
    assert words.describe({"name": "step", "y_ref": 2.0}) == "step (y_ref 2)"
    assert words.describe({"name": "paper"} | dict.fromkeys("abcdefgh", 1.0)) == "paper"
    assert words.describe(None) == "not recorded"
    assert words.title_of("triple-lane-change") == "Triple lane change"
    assert words.percent(0.0001) == "< 0.1"
    assert words.span(np.array([-0.0, 0.0])) == "0"
    assert words.clock("2026-01-02T03:04:05+00:00") == "2026-01-02 03:04 UTC"


def test_the_full_record_can_be_read_back_from_the_page(report):
    _, text, standard = report
    (record,) = re.findall(r"<pre[^>]*><code>(\{.*?)</code>", text, flags=re.DOTALL)
    records = json.loads(html.unescape(record))
    assert records["1. Standard MPC, triple-lane-change"] == standard.meta


def test_alternative_texts_give_the_range_of_every_run():
    lines = figures.as_lines({"a": drive(), "b": drive(scale=2.0)})
    described = draw.described(figures.tracking_panels(lines)[1])
    assert described.startswith("Tracking error")
    assert re.search(r"a: −0\.2 to 0\.2; b: −0\.4 to 0\.4", described)


def test_a_caption_explains_the_marks_that_are_drawn_and_no_others():
    dots = [Dot("a", 1.0), Dot("b", 1.1), Dot("c", 1.2)]
    assert notes(dots) == ""
    assert notes([*dots, Dot("d", 1.3, failed=True)]) == " Cross: failed runs."
    assert notes([*dots, Dot("d", 99.0, failed=True)]) == " Arrow: beyond the axis."
    assert notes([Dot(str(i), 1.0) for i in range(20)]) == " The first 14 of 20; the table has all."
