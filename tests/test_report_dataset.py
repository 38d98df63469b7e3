"""The page on a data set says what is in it, draws every part of it, and works for any set."""

import dataclasses
import html
import json
import re

import numpy as np
import pytest

from adaptrack.learning.boosting import explained_shares
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.data_set_summary import describe
from adaptrack.paper.operating_points import grid, sobol
from adaptrack.results import dataset as page
from adaptrack.results import style
from adaptrack.results.dataset import write_dataset_report
from pictures import pictures

BOX = {"speed": (3.0, 30.0), "y_ref": (-15.0, 15.0), "friction": (0.3, 1.0), "wind": (-30.0, 30.0)}
LEVELS = {"speed": (5.0, 10.0, 15.0), "y_ref": (-4.0, 4.0, 8.0), "friction": (0.5, 0.9), "wind": (-10.0, 0.0, 10.0)}
PNGS = {"optimum.png", "targets.png", "cost.png", "convergence.png", "flatness.png"}


def made(conditions, size=6, generations=5, **changes):
    """A data set with an optimum that speed decides (Np) or that is noise (the rest)."""
    rng, n = np.random.default_rng(3), len(conditions)
    cost = rng.uniform(1.0, 2.0, n)
    arrays = {
        "operating_points": conditions,
        "tunings": np.column_stack(
            [
                10 + np.round(conditions[:, 0]),
                rng.integers(1, 9, n),
                10.0 ** rng.uniform(-1, 1, n),
                10.0 ** rng.uniform(-3, -1, n),
            ]
        ),
        "costs": cost,
        "standard_costs": 4.0 * cost,
        "traces": cost[:, np.newaxis] * np.linspace(3.0, 1.0, generations),
        "landscape": cost[:, np.newaxis] * np.linspace(1.0, 3.0, size),
        "library": rng.uniform(1, 9, (size, 4)),
        "evaluations": np.full(n, 20),
        "control_steps": np.full(n, 3600),
        "stream": np.arange(n),
        "mirrored_from": np.full(n, -1),
        "seed": np.full(n, 3),
        "provenance": {
            "name": "made <b>",
            "identity": "0123abcd",
            "versions": {"adaptrack": "9.8.7"},
            "settings": {"profile": "road", "scenario": "lane-change", "vehicle": "paper", "duration": 8.0},
        },
    }
    return DataSet(**(arrays | changes))


def words_of(path):
    text = re.sub(r"<(style|svg).*?</\1>", " ", path.read_text(), flags=re.DOTALL)
    return " ".join(re.sub(r"<[^>]+>", " ", text).split())


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """PNGs of few dots: these tests look at what is drawn, not at how finely."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "PNG_DPI", 20)
        yield


@pytest.fixture(scope="module")
def data():
    return made(sobol(60, BOX, 1))


@pytest.fixture(scope="module")
def told(data):
    return describe(data, explained_shares(data))


@pytest.fixture(scope="module")
def report(data, told, tmp_path_factory):
    with pictures(drawn=True):
        return write_dataset_report(tmp_path_factory.mktemp("report") / "out", data, summary=told)


def test_the_folder_holds_the_page_and_a_png_of_every_picture(report):
    assert {path.name for path in report.parent.iterdir()} == {"index.html"} | PNGS
    for name in PNGS:
        assert (report.parent / name).read_bytes().startswith(b"\x89PNG")


def test_the_page_says_what_the_set_is_and_how_to_make_it_again(report, data):
    words = words_of(report)
    for part in ("60 operating points", "lane-change", "road", "8 s a run", "0123abcd", "9.8.7", "adaptrack tune"):
        assert part in words
    assert "4.00 times" in words
    assert "made &lt;b&gt;" in words, "a name cannot break the page"


def test_the_page_opens_with_what_tuning_is_worth_and_its_interval(report):
    text = words_of(report)
    assert "The standard tuning costs 4.00 times the best that swarms found" in text[: text.index("What it is")]
    assert "How sure 4.00 to 4.00: 95 % bootstrap interval" in text


def test_every_picture_is_described_in_words(report):
    text = report.read_text()
    labels = re.findall(r'<svg role="img" aria-label="([^"]+)"', text)
    assert len(labels) == 1 + 6 + 5 + 2 + 1 + 1
    assert all(re.search(r"\d", label) for label in labels)
    assert not any("nan" in label or "$" in label or "\\" in label for label in labels)


def test_a_target_that_conditions_decide_is_told_from_noise(told):
    assert page.explained(told) == {
        "largely explained": ["Np"], "hardly explained, if at all": ["Nc", "Q", "R", "R/Q"]
    }  # fmt: skip


def test_a_cell_of_a_map_is_the_median_of_its_conditions():
    data = made(grid(**LEVELS))
    target = page._targets(data)[1]
    own = page._binned(data, data.operating_points[:, 2], target)
    assert own.values.shape == (2, 3)
    here = (data.operating_points[:, 0] == 10.0) & (data.operating_points[:, 2] == 0.9)
    assert own.values[1, 1] == np.median(data.tunings[here, 1])


def test_levels_have_bins_of_their_own_and_samples_equal_widths():
    np.testing.assert_allclose(page._edges(np.array([2.0, 2.0, 4.0, 10.0])), [1.0, 3.0, 7.0, 13.0])
    np.testing.assert_allclose(page._edges(np.array([5.0, 5.0])), [4.5, 5.5])
    np.testing.assert_allclose(page._edges(np.array([0.0])), [-0.5, 0.5])
    edges = page._edges(np.linspace(0.0, 1.0, 999))
    np.testing.assert_allclose(np.diff(edges), 1.0 / page._CELLS)
    assert len(page._edges(np.linspace(0.0, 1.0, 50))) - 1 == page._LEAST_CELLS
    assert page._bins(np.array([0.0, 1.0]), edges).tolist() == [0, page._CELLS - 1]


def test_cells_without_conditions_stay_empty():
    own = made(sobol(4, BOX, 1))
    medians = page._binned(own, own.operating_points[:, 2], page._targets(own)[0]).values
    assert np.isfinite(medians).sum() <= 4


def test_left_right_twins_are_counted_once(tmp_path):
    conditions = grid(**(LEVELS | {"y_ref": (-4.0, 4.0)}))
    twin = np.where(conditions[:, 1] > 0, 0, -1)
    data = made(conditions, mirrored_from=twin)
    words = words_of(write_dataset_report(tmp_path, data, summary=describe(data)))
    assert "searched 18 of them" in words
    assert "other 18 are left-right twins" in words


def with_losses(data):
    costs, standard, landscape = data.costs.copy(), data.standard_costs.copy(), data.landscape.copy()
    traces = data.traces.copy()
    costs[:2] = standard[:3] = landscape[:1] = traces[:2] = np.inf
    traces[:, 0] = np.inf
    landscape[:, -1] = np.inf
    return dataclasses.replace(data, costs=costs, standard_costs=standard, landscape=landscape, traces=traces)


@pytest.mark.drawn
def test_lost_cars_are_said_and_not_averaged(tmp_path):
    data = with_losses(made(sobol(20, BOX, 2)))
    path = write_dataset_report(tmp_path, data)
    words = html.unescape(words_of(path))
    assert "the standard tuning in 3, the swarm's best in 2 and every tuning in 1 of 20 operating points" in words
    assert "infinitely far above its last cost, after generation 3" in words
    cost = page.dataset_result(data).picture("cost")
    assert not any(re.search("nan|∞", panel.description) for panel in cost.panels)


def test_a_set_in_which_every_tuning_lost_the_car_has_a_page(tmp_path):
    data = made(sobol(5, BOX, 2))
    names = ("costs", "standard_costs", "landscape", "traces")
    lost = {name: np.full_like(getattr(data, name), np.inf) for name in names}
    folder = write_dataset_report(tmp_path, dataclasses.replace(data, **lost)).parent
    assert not list(folder.glob("*.png"))


def test_one_condition_without_library_or_trace_has_a_page(tmp_path):
    data = made(sobol(1, BOX, 2), size=0, generations=0, provenance={})
    path = write_dataset_report(tmp_path, data)
    assert {each.name for each in tmp_path.glob("*.png")} == {"optimum.png", "targets.png", "cost.png"}
    assert "no library was evaluated" in words_of(path)
    assert "too few to tell" in words_of(path)


def test_a_curve_of_costs_ends_at_the_share_that_kept_the_car():
    (curve,) = page.cumulative({page._SWARM: np.array([0.0, 3.0, np.inf, 1.0])}).marks
    assert list(curve.x) == [1.0, 3.0]
    assert list(curve.y) == [50.0, 75.0]


def test_the_full_record_can_be_read_back_from_the_page(report, data):
    record = re.findall(r"<pre[^>]*>(?:<code>)?(\{.*?\})\s*(?:</code>)?</pre>", report.read_text(), flags=re.DOTALL)[-1]
    assert json.loads(html.unescape(record)) == data.provenance
