"""The page on an evaluation of schedules: headline, tables with the best value, pictures."""

from __future__ import annotations

import html
import re
from dataclasses import replace

import numpy as np
import pytest

from adaptrack.comparison.table import Comparison, ContenderRole
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Guarded, Learned, StabilityMap, Table
from adaptrack.results import evaluation, write_result
from adaptrack.results.evaluation import evaluation_result, regret_maps, surfaces_picture, view_rows
from adaptrack.results.style import describe_panel, panel_figure
from adaptrack.results.words import number
from pictures import pictures

POINTS = {"best constant": 2.5, "look-up": 1.2, "nn": 1.1, "anfis": 1.15, "optimum": 1.0}
DRIVES = {"best constant": 1.0, "look-up": 0.9, "nn": 0.5, "anfis": 0.55}


def compared(factors, runs=40, reference="optimum", failed=None):
    """Contenders that cost about so many times the reference; failed: number of runs of each."""
    rng = np.random.default_rng(1)
    base = rng.uniform(1e-3, 1e-2, runs)
    driven = {}
    for name, factor in factors.items():
        cost = base * factor * (1.0 if name == reference else rng.lognormal(0.0, 0.05, runs))
        shares = np.where(np.arange(runs) < (failed or {}).get(name, 0), 0.25, 0.0)
        driven[name] = {"cost": np.where(shares > 0.0, 6.25, cost), "failed": shares}
    where = rng.uniform((3.0, -7.0, 0.4, -20.0), (27.0, 7.0, 1.0, 20.0), (runs, 4))
    roles = {
        name: ContenderRole(adapts=name not in ("best constant", "optimum"), hindsight=name == "optimum")
        for name in factors
    }
    return Comparison.from_runs(driven, reference, overall={"nn": {"fallback": 0.125}}, where=where, roles=roles)


def schedule(tilt=(20.0, 5.0)):
    """Np rises by a tilt along speed and reference change; Nc and R are constant."""
    domain = np.array([[3.0, 27.0], [0.0, 4.0]])
    corners = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1)
    Np = Table(tuple(domain), 15.0 + corners @ np.array(tilt))
    return Learned({"Np": Np, "Nc": 4.0, "log10_ratio": 3.5}, ("speed", "change"), domain, name="nn")


VIEWS = {
    "operating points": {"exact": compared(POINTS, failed={"best constant": 3}), "noisy": compared(POINTS)},
    "drives": {"exact": compared(DRIVES, reference="best constant")},
    "tests": {"triple-lane-change": compared({"best constant": 1.0, "nn": 0.5}, 1, "best constant")},
}


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch, pictures(drawn=True):
        patch.setattr(evaluation, "SURFACE_NODES", (9, 7))
        result = evaluation_result(VIEWS, {"nn": schedule(), "anfis": schedule((10.0, 0.0))})
        result = replace(result, command="evaluate <now>")
        return write_result(tmp_path_factory.mktemp("evaluation") / "out", result)


def words_of(path):
    text = re.sub(r"<(style|svg).*?</\1>", " ", path.read_text(), flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


def test_the_headline_is_the_cost_of_the_best_schedule_over_that_of_the_constant_on_drives(report):
    ratio = VIEWS["drives"]["exact"].ratio("nn", "best constant")
    interval = f"{number(ratio.low)} to {number(ratio.high)}"
    headline = (
        f"NN-MPC: {number(ratio.mean)} times the cost of the best constant on 40 drives (95 % interval {interval})."
    )
    assert evaluation_result(VIEWS, {}).answer == headline
    assert headline in words_of(report)
    alone = evaluation_result({"drives": {"exact": compared({"best constant": 1.0}, reference="best constant")}}, {})
    assert alone.answer.startswith("Best constant: 1.00 times")


def test_the_table_marks_the_best_without_hindsight_and_the_failed_runs(report):
    text = report.read_text()
    table = re.search(r"<caption>Operating points: 40 operating points.*?</table>", text, re.DOTALL).group()
    groups = table.split('<tr class="group">')
    assert [re.search(r"<span>(.*?)</span>", group).group(1) for group in groups[1:]] == ["Exact", "Noisy"]
    rows = {
        name: re.findall(r'<td(?: class="(\w+)")?>(.*?)</td>', cells)
        for name, cells in re.findall(r'<th scope="row">(.*?)</th>(.*?)</tr>', groups[1], re.DOTALL)
    }
    assert rows["NN-MPC"][0][0] == rows["NN-MPC"][1][0] == "strong"
    assert rows["NN-MPC"][-1] == ("", "12.5")
    assert ("warn", "3") in rows["Best constant"]
    assert not any(kind for kind, _ in rows["Optimum per operating point"])


def test_the_record_has_a_row_for_each_contender_in_each_view():
    rows = view_rows(VIEWS)
    assert len(rows) == 2 * len(POINTS) + len(DRIVES) + 2
    noisy = {row["contender"]: row for row in rows if row.get("perception") == "noisy"}
    over = VIEWS["operating points"]["noisy"].ratio("nn", "best constant")
    assert noisy["nn"]["constant_geomean"] == over.mean
    assert noisy["optimum"]["regret_worst"] == 1.0
    assert {row["scenario"] for row in rows if row["view"] == "tests"} == {"triple-lane-change"}


def test_the_page_has_its_pictures_with_numbers_in_words_and_its_command(report):
    labels = re.findall(r'<svg role="img" aria-label="([^"]+)"', report.read_text())
    assert len(labels) == 1 + 3 * 2
    assert all(re.search(r"\d", label) for label in labels)
    assert not any("nan" in label or "$" in label for label in labels)
    assert {path.name for path in report.parent.iterdir()} == {"index.html", "surfaces.png"}
    assert "evaluate <now>" in words_of(report)


def test_maps_are_drawn_where_their_cells_hold_operating_points():
    many = compared(POINTS, runs=96)
    assert len(regret_maps(many).panels) == 4 * 2
    names = [picture.name for picture in evaluation_result({"operating points": {"exact": many}}, {}).pictures]
    assert names == ["verdict", "maps"]
    (cells,) = panel_figure(regret_maps(many).panels[0]).axes[0].collections
    assert cells.get_array().shape == (4, 4)


def test_surfaces_show_the_learned_tuning_without_the_guard():
    axes = tuple(np.array([0.0, 1.0]) for _ in range(5))
    nowhere_stable = StabilityMap(Table(axes, np.full((2,) * 5, 2.0)))
    guarded = Guarded(schedule(), Tuning(Np=50, Nc=2, Q=1.0, R=100.0), stability=nowhere_stable)
    assert guarded.batch([[15.0, 0.0, 0.7, 0.0]])[0, 0] == 50.0
    result = evaluation_result({"drives": VIEWS["drives"]}, {"nn": guarded})
    surfaces = next(picture for picture in result.pictures if picture.name == "surfaces")
    Np, Nc, ratio = map(describe_panel, surfaces.panels)
    assert Np.endswith("over speed and reference change ahead: 15 to 40.")
    assert Nc.endswith("ahead: 4.")
    assert ratio.endswith("ahead: 3.5.")
    assert len(surfaces_picture({"nn": schedule(), "anfis": schedule()}).panels) == 6
