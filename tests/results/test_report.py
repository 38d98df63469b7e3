"""Pages are complete, need nothing but themselves, and appear whole or not at all; figures show what was run."""

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
from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable
from adaptrack.drive.metrics import compute_metrics
from adaptrack.drive.trajectory import provenance
from adaptrack.results import style, words, write_drive_page, write_result
from adaptrack.results.drive import Run, drive_result, group_runs
from adaptrack.results.evaluation import shared_scale
from adaptrack.results.marks import SERIES, ColourScale, Dot, caption_notes, log_ticks, set_log_scale, speed_map
from adaptrack.results.run_pictures import conditions_picture, speed_picture, tracking_picture
from made_drives import trajectory
from pictures import pictures


def drive(controller="standard", scenario="triple-lane-change", *, scale=1.0, n=280, adapt=False, **meta):
    """A made-up run: a sine around a ramp, `scale` metres off."""
    t = 0.1 * np.arange(n)
    wave = np.sin(0.9 * t)
    horizon = np.round(30 + 15 * wave).astype(int) if adapt else np.full(n, 35)
    record = provenance(
        "2026-01-02T03:04:05+00:00", scenario=scenario, plant="dual-track", tyre="constant-stiffness",
        vehicle="paper", profile="paper", seed=7, preview=False, controller=controller,
        tuning={"Np": 35, "Nc": 8, "Q": 10.0, "R": 0.01},
    )  # fmt: skip
    columns = {
        "t": t, "X": 15 * t, "Y": 0.2 * t + 0.2 * scale * wave, "psi": 0.02 * wave, "vx": 15 + wave, "vy": 0.1 * wave,
        "yaw_rate": 0.05 * scale * wave, "steering": 0.03 * wave, "command": 0.03 * scale * wave,
        "command_change": 0.003 * wave, "y_ref": 0.2 * t, "v_ref": 15 + wave, "friction": np.full((n, 4), 0.7),
        "wind": np.stack([0 * t, 20 * wave], axis=1), "lateral_acceleration": wave, "step_time": np.full(n, 1e-5),
    }  # fmt: skip
    tuning = {"Np": horizon, "Nc": np.full(n, 8), "Q": np.full(n, 10.0), "R": 0.01 * (1 + adapt * np.abs(wave))}
    diagnostics = {"qp_status": np.zeros(n, int), "qp_iterations": np.full(n, 3), "qp_residual": np.full(n, 1e-12),
                   "at_limit": np.zeros(n, int)}  # fmt: skip
    return trajectory(
        columns, period=0.1, tuning=tuning, diagnostics=diagnostics, meta=record | meta,
        units={"tuning.Q": "1/m^2", "tuning.R": "1/rad^2"},
    )  # fmt: skip


def lost(run, at=100):
    """The same run, thrown off its reference from step `at`, NaN thirty steps later."""
    Y = run.Y.copy()
    Y[at:] += np.exp(0.2 * np.arange(len(run) - at)) - 1
    Y[at + 30 :] = np.nan
    return dataclasses.replace(run, Y=Y)


def figure_of(picture, *runs):
    """A picture of runs, drawn for print."""
    return style.print_figure(picture(*runs))


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
    runs = [
        standard, drive("nn", scale=0.4, adapt=True), lost(drive("anfis", scale=0.5, adapt=True)),
        drive(scenario="general-trajectory", n=2000),
        drive("nn", "general-trajectory", scale=0.3, adapt=True, n=2000),
    ]  # fmt: skip
    with pictures(drawn=True):
        path = write_drive_page(folder, runs, title="Both tests", command="adaptrack drive --out <here>")
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


def test_steering_has_degrees_beside_radians_and_shows_the_wheels():
    run = drive(scale=0.5)
    steering = figure_of(tracking_picture, {"x": run}).axes[2]
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


def test_the_page_of_several_runs_has_headline_failures_pictures_and_provenance(report):
    folder, text, standard = report
    visible_text = Outline(text).text
    assert "<title>1 of 5 runs failed · Both tests</title>" in text
    first = text[text.index("</h1>") : text.index("<nav")]
    assert first.index('class="verdict"') < first.index("<svg role") < first.index('class="introduction"')
    assert re.search(r"Failed: Triple lane change, ANFIS-MPC, at 10\.\d s; the vehicle left the road", visible_text)
    assert "Largest error" in first
    names = [f"{test}-{kind}.png" for test in ("general-trajectory", "triple-lane-change")
             for kind in ("conditions", "tracking")]  # fmt: skip
    assert sorted(os.listdir(folder)) == sorted([*names, "index.html", "speed.png"])
    described = [svg for svg in Outline(text).all("svg") if "aria-hidden" not in svg]
    assert all(svg["role"] == "img" and len(svg["aria-label"]) > 30 for svg in described)
    for value in ("0.0318", "0.0051", "0.5896", "0.132", words.number(compute_metrics(standard).mse)):
        assert value in visible_text
    for entry in ("Profile paper", "Plant dual-track, constant-stiffness", '"seed": 7', "kernels"):
        assert entry in visible_text
    assert "adaptrack drive --out <here>" in visible_text  # escaped in the source, whole for the reader
    assert "<here>" not in text


def test_the_headline_is_the_smallest_error_and_never_that_of_a_failed_run():
    runs = [drive(), drive("nn", scale=0.4), lost(drive("anfis", scale=0.1))]
    result = drive_result(runs)
    assert re.fullmatch(r"NN-MPC: [\d.]+ [mc]m RMS error, largest [\d.]+ [mc]m\. 1 of 3 runs failed\.", result.answer)
    table = result.table("triple-lane-change tracking")
    assert {table.rows[row]["label"] for row, _ in table.best} == {"NN-MPC"}
    assert {table.rows[row]["label"] for row, _ in table.alert} == {"ANFIS-MPC"}
    assert drive_result([drive()]).headline == ""
    assert drive_result([lost(drive())]).headline.startswith("Failed at 1")
    assert drive_result([dataclasses.replace(drive(), meta={})]).title.startswith("Unnamed scenario")
    with pytest.raises(InvalidInput, match="at least one run"):
        drive_result([])


def test_runs_are_grouped_by_scenario_under_distinct_labels():
    groups = group_runs([Run(run) for run in (drive(), drive("nn"), drive(seed=3), drive(scenario="step"))])
    assert {name: [run.label for run in runs] for name, runs in groups.items()} == {
        "triple-lane-change": ["Standard MPC no. 1", "NN-MPC", "Standard MPC no. 2"],
        "step": ["Standard MPC"],
    }


def said(answer, *pictures):
    """A result of a kind that has no page of its own."""
    return Result(kind="any", title="Any", answer=answer, record={}, pictures=pictures)


def line(file):
    """A picture of a line."""
    panel = Panel("Line", lambda axes: axes.plot([0.0, 1.0], [0.0, 1.0]), "From 0 to 1.")
    return Picture(file, "A line.", [panel], file=file)


def test_a_failed_report_leaves_the_old_one_and_nothing_else(tmp_path, monkeypatch):
    out = tmp_path / "out"
    write_result(out, said("first"))
    before = {name: (out / name).read_bytes() for name in os.listdir(out)}

    def full(descriptor):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("adaptrack.base.files.os.fsync", full)
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
    with pytest.raises(StorageError, match="it is a folder"):
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
    monkeypatch.setattr(style, "print_figure", lambda picture: pytest.fail("drawn for print"))
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
    four = figure_of(conditions_picture, fleet)
    titles = ["(a) Lateral gust", "(b) Road friction", "(c) Horizons", "(d) Weights"]
    assert [axes.get_title("left") for axes in four.axes] == titles
    assert four.axes[3].get_yscale() == "log"
    tracking = figure_of(tracking_picture, fleet)
    titles = ["Trajectory tracking", "Tracking error", "Steering", "Yaw rate"]
    assert [axes.get_title("left")[4:] for axes in tracking.axes] == titles
    assert legend_texts(tracking) == ["Reference", "Standard MPC", "NN-MPC"]
    for axes in four.axes + tracking.axes:
        assert re.search(r"\(.+\)$", axes.get_ylabel()), axes.get_ylabel()


def test_legends_cover_no_curve():
    figure = figure_of(tracking_picture, {f"controller {i}": drive(scale=1 + 0.1 * i) for i in range(8)})
    figure.draw_without_rendering()  # settles the layout
    legend = figure.legends[0].get_window_extent()
    assert all(not legend.overlaps(axes.get_window_extent()) for axes in figure.axes)


@pytest.mark.drawn
@pytest.mark.parametrize("height", [1e-7, 1.0, 3e8])
def test_a_title_stays_clear_of_the_factor_above_its_axis(height):
    title = "A title that is long enough to lie above the y axis"
    figure = style.panel_figure(Panel(title, lambda axes: axes.plot([0.0, height]), ""))
    figure.dpi = 72  # that of an SVG, in which the places below are counted
    style.inline_svg(figure, "p1", "a line")
    (axes,) = figure.axes
    factor = axes.yaxis.get_offset_text()
    assert bool(factor.get_text()) == (height != 1.0)
    (drawn,) = figure.findobj(lambda artist: isinstance(artist, Text) and artist.get_text() == title)
    assert not (factor.get_text() and drawn.get_window_extent().overlaps(factor.get_window_extent()))


def test_a_lost_run_ends_where_it_was_lost_and_does_not_set_the_scale():
    run, lost_run = drive(), lost(drive("nn"))
    figure = figure_of(tracking_picture, {"good": run, "bad": lost_run})
    error = figure.axes[1]
    assert error.get_ylim()[1] < 1.0  # the lost run reaches 5 m and more
    ends = [line.get_xdata()[-1] for line in error.get_lines() if line.get_color() == SERIES[1]]
    assert all(10.0 < end < 12.0 for end in ends)


@pytest.mark.drawn
def test_runs_that_hold_only_nan_can_be_drawn():
    run = drive()
    empty = np.full(len(run), np.nan)
    columns = dict.fromkeys(("Y", "vx", "yaw_rate", "command"), empty)
    run = {"x": dataclasses.replace(run, **columns, tuning={**run.tuning, "Q": empty})}
    for picture, runs in ((tracking_picture, run), (conditions_picture, run), (speed_picture, {"s": run})):
        style.png(figure_of(picture, runs))


def test_start_up_from_standstill_does_not_flatten_the_rest():
    run = drive()
    speed, command = run.vx.copy(), run.command.copy()
    speed[:5], command[:5] = 0.5, 0.5
    figure = figure_of(tracking_picture, {"x": dataclasses.replace(run, vx=speed, steering=command)})
    steering = figure.axes[2]
    assert steering.get_ylim()[1] < 0.1
    assert steering.get_title("right") == "start: −0.03 to 0.5"


def test_steps_in_which_a_safe_angle_was_held_are_marked():
    run = drive()
    is_held = (run.t > 5.0) & (run.t < 6.0)
    steering = figure_of(tracking_picture, {"x": dataclasses.replace(run, held=is_held)}).axes[2]
    (squares,) = (line for line in steering.get_lines() if line.get_marker() == "s")
    assert squares.get_xdata().tolist() == run.t[is_held].tolist()
    assert steering.get_title("right") == "□ held"


@pytest.mark.parametrize(("wheels", "key"), [
    ([0.7, 0.7, 0.7, 0.7], []),
    ([0.8, 0.3, 0.8, 0.3], ["left", "right"]),
    ([0.8, 0.8, 0.3, 0.3], ["front", "rear"]),
    ([0.8, 0.7, 0.6, 0.5], ["front left", "front right", "rear left", "rear right"]),
])  # fmt: skip
def test_friction_is_drawn_for_the_wheels_that_differ(wheels, key):
    run = dataclasses.replace(drive(), friction=np.tile(wheels, (280, 1)))
    legend = figure_of(conditions_picture, {"x": run}).axes[1].get_legend()
    assert ([text.get_text() for text in legend.get_texts()] if legend else []) == key


@pytest.mark.drawn
def test_figures_leave_the_users_matplotlib_alone():
    before = dict(mpl.rcParams)
    with mpl.rc_context({"lines.linewidth": 9.0, "axes.facecolor": "pink"}):
        mine = style.png(figure_of(tracking_picture, {"x": drive()}))
    assert mine == style.png(figure_of(tracking_picture, {"x": drive()}))
    assert dict(mpl.rcParams) == before


@pytest.mark.parametrize(("value", "text"), [
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
])  # fmt: skip
def test_numbers_are_written_for_readers(value, text):
    assert words.number(value) == text


@pytest.mark.parametrize(("low", "high", "ticks"), [
    (0.95, 1.2, [0.95, 1.0, 1.05, 1.1, 1.15, 1.2]),
    (0.9, 3.2, [1.0, 1.5, 2.0, 3.0]),
    (1.0, 100.0, [1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0]),
    (0.5, 1e4, [1.0, 10.0, 100.0, 1000.0, 1e4]),
])  # fmt: skip
def test_a_logarithmic_axis_has_round_numbers_however_short_it_is(low, high, ticks):
    assert log_ticks(low, high)() == pytest.approx(ticks)
    axes = Figure().subplots()
    set_log_scale(axes, "y", (low, high))
    assert axes.get_ylim() == (low, high)
    assert [label.get_text() for label in axes.get_yticklabels()] == [f"{tick:g}" for tick in ticks]


def test_a_printed_figure_has_all_panels_and_writes_what_neighbours_share_once():
    titles = {"One": "Share (%)", "Two": "Share (%)", "Three": "Cost (m²)"}
    panels = [Panel(title, lambda axes, label=label: axes.set_ylabel(label), "") for title, label in titles.items()]
    figure = style.print_figure(Picture("any", "", panels, columns=2))
    assert [axes.get_title(loc="left") for axes in figure.axes] == ["(a) One", "(b) Two", "(c) Three"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["Share (%)", "", "Cost (m²)"]
    (alone,) = style.print_figure(Picture("any", "", panels[:1])).axes
    assert alone.get_title(loc="left") == "One"


def test_the_words_of_a_panel_hold_no_marks_of_mathematics():
    panel = Panel(r"$\log_{10} R/Q$", print, r"Over $|y_\mathrm{ref}|$: 3 to 4.")
    assert style.describe_panel(panel) == "log10 R/Q. Over |y_ref|: 3 to 4."


def test_the_colours_of_several_maps_span_all_their_numbers():
    scale = shared_scale([np.array([[1.0, np.nan]]), np.array([[7.0]])], integer=True)
    assert (scale.low, scale.high) == (1.0, 7.0)
    equal_scale = shared_scale([np.array([[3.0]])], integer=False)
    assert (equal_scale.low, equal_scale.high) == (2.5, 3.5)


@pytest.mark.parametrize("image", [False, True])
def test_a_heat_map_shows_its_numbers_where_they_belong(image):
    axes = Figure(layout="constrained").subplots()
    speed_map("", ([0.0, 10.0, 20.0], [0.3, 1.0]), [[1.0, 2.0]], ColourScale(1.0, 2.0), "", "", image=image).draw(axes)
    (drawn,) = axes.images if image else axes.collections
    assert np.ravel(drawn.get_array()).tolist() == [1.0, 2.0]
    assert (axes.get_xlim(), axes.get_ylim()) == ((0.0, 20.0), (0.3, 1.0))
    assert (drawn.norm.vmin, drawn.norm.vmax) == (1.0, 2.0)


def test_an_interval_has_as_many_digits_as_tell_its_ends_apart():
    ratio = Column("ratio", "Ratio", show=3)
    assert words.entry((0.5, 2.0), ratio) == "0.500 to 2.00"
    assert words.entry((1.0012, 1.0039), ratio) == "1.001 to 1.004"


def test_the_full_record_can_be_read_back_from_the_page(report):
    _, text, standard = report
    (record,) = re.findall(r"<pre[^>]*><code>(\{.*?)</code>", text, flags=re.DOTALL)
    records = json.loads(html.unescape(record))
    assert records["1. Standard MPC, triple-lane-change"] == standard.meta


def test_a_caption_explains_the_marks_that_are_drawn_and_no_others():
    dots = [Dot("a", 1.0), Dot("b", 1.1), Dot("c", 1.2)]
    assert caption_notes(dots) == ""
    assert caption_notes([*dots, Dot("d", 1.3, failed=True)]) == " Cross: failed runs."
    assert caption_notes([*dots, Dot("d", 99.0, failed=True)]) == " Arrow: beyond the axis."
    assert caption_notes([Dot(str(i), 1.0) for i in range(20)]) == " The first 14 of 20; the table has all."
