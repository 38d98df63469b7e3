"""Each rendering of a result shows what the result holds."""

import json
import re

import numpy as np
from matplotlib.figure import Figure

from adaptrack.base.result import Column, Panel, Picture, Result, ResultTable, select_entries, to_json
from adaptrack.results import style
from adaptrack.results.console import print_result
from adaptrack.results.marks import include_y, strokes
from adaptrack.results.page import render_result
from pictures import pictures

ROWS = [
    {"who": "informed", "test": "step", "rms": 0.0161, "share": 0.5, "range": (1.0, 2.0)},
    {"who": "stanley <b>", "test": "step", "rms": None, "share": 0.0001, "range": None},
]
COLUMNS = (
    Column("who", "Controller"), Column("rms", "RMS error", "m", 3, "root of the mean squared error"),
    Column("share", "Limits", "%", "percent"), Column("range", "From to", "s", 2),
)  # fmt: skip


def panel():
    def draw_line(axes):
        axes.plot([0.0, 1.0], [0.0, 1.0])
        axes.set(xlabel="x (m)", ylabel="y (m)")

    return Panel("A panel", draw_line, "A line from 0 to 1.")


def result(**fields):
    table = ResultTable(
        "runs", "All runs", COLUMNS, ROWS, group="test", best=select_entries(ROWS, ["rms"], lambda row: row["rms"]),
        brief=True,
    )  # fmt: skip
    picture = Picture("line", "A line.", [panel()])
    return Result(
        kind="a kind without a template", title="A title", answer="1.6 cm RMS.", tables=[table], pictures=[picture],
        record={"rms": np.float64(0.5), "array": np.arange(2), "none": float("nan"), "rows": [{"inside": (1, 2)}]},
        notes=["Mind the gap."], next_step="Next: adaptrack drive.", **fields,
    )  # fmt: skip


def test_the_console_begins_with_the_answer_and_ends_with_what_to_do_next(capsys):
    print_result(result())
    first, *lines, last = capsys.readouterr().out.splitlines()
    assert (first, last) == ("1.6 cm RMS.", "Next: adaptrack drive.")
    assert "Note: Mind the gap." in lines
    assert any(re.search(r"informed +0.0161 +50 +1 to 2", line) for line in lines)
    assert any(re.search(r"stanley <b> +- +0 +-", line) for line in lines)


def test_json_is_strict_and_holds_the_record_alone():
    assert json.loads(to_json(result())) == {"rms": 0.5, "array": [0, 1], "none": None, "rows": [{"inside": [1, 2]}]}


def test_a_kind_without_a_template_has_a_page_with_everything_it_holds():
    with pictures(drawn=False):
        text = render_result(result(command="adaptrack <here>"))
    for part in ("1.6 cm RMS.", "All runs", "0.0161", "stanley &lt;b&gt;", "Mind the gap.", "A line.", "&lt;here&gt;"):
        assert part in text
    assert '<td class="strong">0.0161</td>' in text
    assert text.count('class="group"') == 1
    assert "&lt; 0.1" in text


def test_a_page_with_a_headline_says_it_before_the_title():
    with pictures(drawn=False):
        text = render_result(result(headline="Failed"))
    assert "<title>Failed · A title</title>" in text


def test_neighbours_in_print_write_what_they_share_once():
    figure = style.print_figure(Picture("p", "c", [panel(), panel(), panel()], columns=2))
    assert [axes.get_title("left") for axes in figure.axes] == ["(a) A panel", "(b) A panel", "(c) A panel"]
    assert [axes.get_ylabel() for axes in figure.axes] == ["y (m)", "", "y (m)"]
    assert [axes.get_xlabel() for axes in figure.axes] == ["", "x (m)", "x (m)"]


def test_an_axis_reaches_what_it_includes():
    axes = Figure().subplots()
    axes.plot([0.0, 1.0], [0.0, 2.0])
    bottom, top = include_y(axes, -3.0, 1.0)
    assert (bottom, axes.get_ylim()) == (-3.0, (-3.0, top))
    assert top >= 2.0


def test_strokes_stay_distinct_for_eighteen_labels():
    assert len({tuple(stroke.values()) for stroke in strokes(f"c{i}" for i in range(18)).values()}) == 18
