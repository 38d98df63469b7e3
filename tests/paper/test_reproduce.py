"""The paper's experiment: its runs, the parts of the gain, and the order of the page."""

import html
import json
import math
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import adaptrack as at
from adaptrack.base.result import Column
from adaptrack.drive.metrics import PAPER_MSE
from adaptrack.paper import reproduce as paper
from adaptrack.paper.reproduce import best_of_library, grid_lookup, reproduce
from adaptrack.paper.training import train, trained_schedule
from adaptrack.results import reproduce as page
from adaptrack.results import style
from adaptrack.results.page import write_result
from pictures import pictures
from small_data import LIBRARY, SEARCH, small

pytestmark = pytest.mark.compiled

CONFIGURATIONS = ("released", "same-moves")
TESTS = tuple(PAPER_MSE)


@pytest.fixture(scope="module")
def study():
    return reproduce(small(), quick=True)


@pytest.fixture(scope="module")
def trained():
    return {
        (model, targets): train(small(), model, targets, epochs=3)
        for model, targets in (("nn", "paper"), ("anfis", "paper"), ("nn", "ratio"))
    }


def words_of(path):
    text = re.sub(r"<(style|svg).*?</\1>", " ", path.read_text(), flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


# -- what a data set gives --------------------------------------------------------------------------------------------
def test_the_best_constant_has_the_lowest_geometric_mean_of_the_cost():
    data = small()
    result = best_of_library(data)
    assert result.tuning.as_array() == pytest.approx(LIBRARY[1])
    assert result.cost == pytest.approx(1.1 * np.exp(np.log(data.costs).mean()))
    assert result.standard_cost / result.swarm_cost == pytest.approx(4.0)
    assert (result.runs, result.swarm_runs) == (72 * 4, 72 * 300)


def test_a_constant_that_fails_comes_after_one_that_does_not():
    landscape = small().landscape.copy()
    landscape[5, 1] = np.inf
    result = best_of_library(small(landscape=landscape))
    assert result.tuning.as_array() == pytest.approx(LIBRARY[2])
    assert result.failed == 0
    landscape[6, :] = np.inf
    assert best_of_library(small(landscape=landscape)).failed == 1
    assert math.isfinite(best_of_library(small(landscape=landscape)).cost)


def test_the_look_up_table_holds_the_tuning_of_every_operating_point():
    data = small()
    table = grid_lookup(data)
    assert table.batch(data.operating_points) == pytest.approx(data.tunings)
    at.check_scheduler(table)


def test_a_look_up_table_needs_a_full_grid():
    data = small()
    with pytest.raises(at.InvalidInput, match="do not fill a grid"):
        grid_lookup(data.rows(np.arange(len(data)) != 7))
    twice = np.arange(len(data))
    twice[7] = 8
    with pytest.raises(at.InvalidInput, match="do not fill a grid"):
        grid_lookup(data.rows(twice))


@pytest.mark.parametrize("key", [("nn", "paper"), ("anfis", "paper"), ("nn", "ratio")])
def test_a_learned_schedule_is_admitted_and_stays_within_the_bounds_of_the_search(trained, key):
    schedule = trained_schedule(trained[key], small())
    at.check_scheduler(schedule)
    wild = small().operating_points * [3.0, 9.0, 1.0, 5.0]
    tunings = schedule.batch(wild)
    low, high = np.array([SEARCH[name] for name in ("Np", "Nc", "Q", "R")], dtype=float).T
    if key[1] == "ratio":  # R is then R/Q
        low[2:], high[2:] = (1.0, SEARCH["R"][0] / SEARCH["Q"][1]), (1.0, SEARCH["R"][1] / SEARCH["Q"][0])
    assert (tunings >= low).all()
    assert (tunings <= high).all()


def test_a_data_set_that_does_not_tell_its_search_is_refused(trained):
    with pytest.raises(at.InvalidInput, match="bounds of its search"):
        trained_schedule(trained["nn", "paper"], small(provenance={"name": "mute"}))


# -- the experiment ---------------------------------------------------------------------------------------------------
def test_every_controller_drives_every_test_with_and_without_preview_in_both_configurations(study):
    ran = [(row["configuration"], row["scenario"], row["controller"], row["preview"]) for row in study.rows]
    assert len(ran) == len(set(ran)) == 2 * 2 * 6 * 2
    assert {row[2] for row in ran} == {
        "standard-as-released", "standard-as-written", "best-constant", "lookup", "nn", "anfis",
    }  # fmt: skip
    for row in study.rows:
        if row["configuration"] == "same-moves":
            assert (row["moves"] == "pulse") == (row["controller"] != "standard-as-released")


def test_the_papers_errors_stand_beside_the_runs_that_they_compare_with(study):
    for configuration, standard in zip(CONFIGURATIONS, ("standard-as-released", "standard-as-written"), strict=True):
        for test in TESTS:
            paper_errors = {
                row["controller"]: row["paper_mse"]
                for row in study.rows
                if row["configuration"] == configuration and row["scenario"] == test and row["paper_mse"] is not None
            }
            published = PAPER_MSE[test].mse
            assert paper_errors == {standard: published["standard"], "nn": published["nn"], "anfis": published["anfis"]}
    for row in study.rows:
        assert not (row["preview"] and row["paper_mse"])
        if row["ratio"] is not None:
            assert row["ratio"] == pytest.approx(row["mse"] / row["paper_mse"])


def test_the_standard_mpc_does_not_depend_on_what_was_learned(study):
    """The figures of docs/reproduce.md."""
    expected = {
        ("released", "standard-as-released"): (0.0371, 0.6197),
        ("same-moves", "standard-as-written"): (0.0029, 0.1223),
    }
    for (configuration, controller), figures in expected.items():
        result = [
            row["mse"]
            for row in study.rows
            if (row["configuration"], row["controller"], row["preview"]) == (configuration, controller, False)
        ]
        assert result == pytest.approx(figures, rel=0.02)


def test_all_that_was_measured_is_strict_json(study):
    result = json.loads(json.dumps(study.as_json(), allow_nan=False))
    keys = "rows", "ablation", "shares", "knowing", "learning", "domain", "constant", "seconds", "quick"
    assert result.keys() >= set(keys)
    assert len(result["learning"]) == 8
    assert result["constant"]["tuning"] == {"Np": 50, "Nc": 3, "Q": 0.5, "R": 0.05}


def test_clipped_steps_are_those_that_the_scheduler_counts(study):
    controller = paper.PaperController("lookup", paper.ADAPTIVE_MOVES, schedule=grid_lookup(small()))
    plant = paper.SingleTrack(paper.load_vehicle("paper"), "constant-stiffness")
    for test in TESTS:
        counted = at.rollout_batch(plant, controller.mpc(preview=False), paper.load_scenario(test)).scheduler
        (row,) = [
            row
            for row in study.rows
            if row["configuration"] == "released" and row["scenario"] == test
            and row["controller"] == "lookup" and not row["preview"]
        ]  # fmt: skip
        assert row["clipped_share"] == pytest.approx(counted["clipped"][0] / counted["steps"][0])


def test_no_constant_of_the_library_beats_the_best_in_hindsight(study):
    for row in study.ablation:
        (best,) = [
            other
            for other in study.ablation
            if other["scenario"] == row["scenario"] and other["moves"] == row["moves"]
            and other["controller"] == "best-in-hindsight"
        ]  # fmt: skip
        if row["controller"] in ("best-constant", "table-constant"):  # the table's tuning is in this library
            assert best["mse"] <= row["mse"] * (1 + 1e-9)
        assert 0 <= row["constants_better"] <= len(LIBRARY)


def test_the_ablation_has_every_moves_with_every_tuning(study):
    ran = {(row["scenario"], row["moves"], row["controller"]) for row in study.ablation}
    assert len(ran) == len(study.ablation) == 2 * 3 * 5
    assert {row["controller"] for row in study.ablation if row["adapts"]} == {"nn", "anfis"}


def test_a_schedule_that_says_the_tables_constant_makes_adaptation_nothing():
    table = at.Constant(paper.PAPER_TABLE)
    plant = paper.SingleTrack(paper.load_vehicle("paper"), "constant-stiffness")
    scenarios = [paper.load_scenario("sine", duration=3.0)]
    rows = paper.ablation(plant, scenarios, paper.PAPER_TABLE, {"nn": table, "anfis": table}, LIBRARY)
    for row in paper.shares(rows):
        assert row["adaptation"] == pytest.approx(1.0)
        assert row["pole_share"] == pytest.approx(1.0)


# -- the informed controller --------------------------------------------------------------------------------------
def test_both_profiles_are_driven_by_the_published_the_adapted_and_the_informed_controller(study):
    for profile in ("paper", "road"):
        for test in TESTS:
            drove = [row["controller"] for row in study.knowing if (row["profile"], row["scenario"]) == (profile, test)]
            assert len(drove) == len(set(drove))
            assert {"standard-as-written", "standard-as-released", "nn", "anfis", "informed"} <= set(drove)


def test_on_the_ideal_car_there_is_nothing_to_know_and_on_the_road_it_keeps_the_car(study):
    result = {(row["profile"], row["scenario"], row["controller"]): row for row in study.knowing}
    for test in TESTS:
        ideal, published = (result["paper", test, name]["mse"] for name in ("informed", "standard-as-written"))
        assert ideal == pytest.approx(published, rel=0.05)
        assert result["road", test, "standard-as-written"]["failed"] == result["road", test, "informed"]["runs"]
        assert result["road", test, "informed"]["failed"] == 0


# -- the gain, taken apart --------------------------------------------------------------------------------------------
def corners(standard, pole_only, adapted_only, both):
    moves = ("laguerre 0.95", "laguerre 0.75")
    result = {"table-constant": (standard, pole_only), "nn": (adapted_only, both), "anfis": (adapted_only, both)}
    return [
        {"scenario": "test", "moves": name_of_moves, "controller": name, "mse": mse}
        for name, pair in result.items()
        for name_of_moves, mse in zip(moves, pair, strict=True)
    ]


@given(st.lists(st.floats(1e-6, 1e3), min_size=4, max_size=4))
def test_the_parts_of_the_gain_add_up(errors):
    for row in paper.shares(corners(*errors)):
        assert row["gain"] == pytest.approx(errors[0] / errors[3])
        assert row["pole"] * row["adaptation"] == pytest.approx(row["gain"])
        if row["pole_share"] is not None and abs(math.log(row["gain"])) > 1e-6:
            assert row["pole_share"] + row["adaptation_share"] == pytest.approx(1.0)


def test_independent_parts_are_found_exactly_and_a_run_without_an_error_has_no_shares():
    for row in paper.shares(corners(8.0, 2.0, 4.0, 1.0)):
        assert (row["pole"], row["adaptation"]) == pytest.approx((4.0, 2.0))
        assert row["pole_share"] == pytest.approx(2.0 / 3.0)
    for row in paper.shares(corners(8.0, 2.0, None, 1.0)):
        assert all(row[key] is None for key in ("gain", "pole", "adaptation", "pole_share", "adaptation_share"))


# -- the page ---------------------------------------------------------------------------------------------------------
def test_bold_is_the_smallest_error_of_its_group_that_did_not_fail_and_never_hindsight():
    def run(controller, mse, failed=0):
        return {"controller": controller, "mse": mse, "failed": failed, "runs": 10}

    rows = [
        {"name": "a", "test": "one", "x": run("nn", 0.1, failed=3)},
        {"name": "b", "test": "one", "x": run("anfis", 0.3)},
        {"name": "c", "test": "one", "x": run("best-in-hindsight", 0.2)},
        {"name": "d", "test": "two", "x": run("nn", 5.0)},
    ]
    table = page.errors_table("t", "T", [Column("name", "Name"), Column("x", "x")], rows, group="test")
    assert [row["x"] for row in table.rows] == ["failed, 3 of 10", 0.3, 0.2, 5.0]
    assert table.best == {(1, "x"), (3, "x")}
    assert table.alert == {(0, "x")}


@pytest.fixture(scope="module")
def result(study):
    return replace(page.reproduction_result(study), command="adaptrack paper reproduce --quick")


def test_the_headline_counts_the_errors_near_the_papers(study, result):
    ratios = [row["ratio"] for row in study.rows if row["configuration"] == "released" and row["ratio"] is not None]
    near = sum(abs(ratio - 1.0) <= 0.25 for ratio in ratios)
    assert result.answer == f"{near} of the paper's 6 mean square errors come out within 25 %."
    for row in result.table("shares").rows:
        assert row["pole_percent"] + row["adaptation_percent"] == pytest.approx(100.0, abs=1.0)
    assert [row["paper_mse"] for row in result.table("published").rows] == [
        0.0318, 0.0051, 0.0062, 0.5896, 0.132, 0.1349,
    ]  # fmt: skip


def test_the_page_begins_with_the_papers_errors_and_figures_then_shows_the_parts_of_the_gain(result, tmp_path):
    with pytest.MonkeyPatch.context() as patch, pictures(drawn=True):
        patch.setattr(style, "PNG_DPI", 20)
        path = write_result(tmp_path, result)
    words = words_of(path)
    figures = (f"Figure {number} of the paper" for number in range(6, 11))
    parts = "As released: the standard MPC", "The plant as released"
    order = ["Mean square tracking errors", "0.0318", "0.5896", *figures, *parts]
    places = [words.index(part) for part in order]
    assert places == sorted(places)
    assert "This was a quick run" in words
    assert not re.search(r"\b(None|nan|inf|True|False)\b", words.split("The full record")[0])
    assert {file.name for file in tmp_path.glob("*.png")} == {f"figure-{number}.png" for number in range(6, 11)}
