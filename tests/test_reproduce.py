"""The paper's experiment: what is run, how the gain is taken apart, and that the page says what the numbers say."""

import dataclasses
import html
import json
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from adaptrack.base.errors import InvalidInput
from adaptrack.control.scheduling import Constant, check_scheduler
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.metrics import PUBLISHED
from adaptrack.learning.adaptation.recipes import trained_schedule
from adaptrack.learning.training import train
from adaptrack.results import knowing, style
from adaptrack.results import reproduce as page
from adaptrack.studies import reproduce as paper
from adaptrack.studies.reproduce import best_of_library, grid_lookup, reproduce
from pictures import pictures
from small_data import LIBRARY, SEARCH, small

pytestmark = pytest.mark.compiled

CONFIGURATIONS = ("released", "same-moves")
TESTS = tuple(PUBLISHED)


@pytest.fixture(scope="module")
def made():
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
    found = best_of_library(data)
    assert found.tuning.as_array() == pytest.approx(LIBRARY[1])
    assert found.cost == pytest.approx(1.1 * np.exp(np.log(data.costs).mean()))
    assert found.standard_cost / found.swarm_cost == pytest.approx(4.0)
    assert (found.runs, found.swarm_runs) == (72 * 4, 72 * 300)


def test_a_constant_that_fails_comes_after_one_that_does_not():
    landscape = small().landscape.copy()
    landscape[5, 1] = np.inf
    found = best_of_library(small(landscape=landscape))
    assert found.tuning.as_array() == pytest.approx(LIBRARY[2])
    assert found.failed == 0
    landscape[6, :] = np.inf
    assert best_of_library(small(landscape=landscape)).failed == 1
    assert math.isfinite(best_of_library(small(landscape=landscape)).cost)


def test_the_look_up_table_holds_the_tuning_of_every_operating_point():
    data = small()
    table = grid_lookup(data)
    assert table.batch(data.operating_points) == pytest.approx(data.tunings)
    check_scheduler(table)


def test_a_look_up_table_needs_a_full_grid():
    data = small()
    with pytest.raises(InvalidInput, match="do not fill a grid"):
        grid_lookup(data.rows(np.arange(len(data)) != 7))
    twice = np.arange(len(data))
    twice[7] = 8
    with pytest.raises(InvalidInput, match="do not fill a grid"):
        grid_lookup(data.rows(twice))


@pytest.mark.parametrize("which", [("nn", "paper"), ("anfis", "paper"), ("nn", "ratio")])
def test_a_learned_schedule_is_admitted_and_stays_within_the_bounds_of_the_search(trained, which):
    schedule = trained_schedule(trained[which], small())
    check_scheduler(schedule)
    wild = small().operating_points * [3.0, 9.0, 1.0, 5.0]
    tunings = schedule.batch(wild)
    low, high = np.array([SEARCH[name] for name in ("Np", "Nc", "Q", "R")], dtype=float).T
    if which[1] == "ratio":  # R is then R/Q
        low[2:], high[2:] = (1.0, SEARCH["R"][0] / SEARCH["Q"][1]), (1.0, SEARCH["R"][1] / SEARCH["Q"][0])
    assert (tunings >= low).all()
    assert (tunings <= high).all()


def test_clamps_replace_the_bounds_where_they_are_finite(trained):
    data, fitted = small(), trained["nn", "paper"]
    entries = trained_schedule(fitted, data, {"Np": (9, math.inf), "Q": (0.75, 20.0)}).tuning
    bounds = {name: (entry.low, entry.high) for name, entry in entries.items()}
    assert bounds == {"Np": (9.0, 55.0), "Nc": (1.0, 18.0), "Q": (0.75, 20.0), "R": (0.001, 0.1)}


def test_a_data_set_that_does_not_tell_its_search_is_refused(trained):
    with pytest.raises(InvalidInput, match="bounds of its search"):
        trained_schedule(trained["nn", "paper"], small(provenance={"name": "mute"}))


def test_quality_tells_the_size_of_every_function(trained):
    for (model, _), fitted in trained.items():
        for row in fitted.quality:
            assert row["parameters"] > 0
            assert (row["rules"] is None) == (model == "nn")
            assert (row["dead_share"] is None) == (model == "anfis")


# -- the experiment ---------------------------------------------------------------------------------------------------
def test_every_controller_drives_every_test_with_and_without_preview_in_both_configurations(made):
    ran = [(row["configuration"], row["scenario"], row["controller"], row["preview"]) for row in made.rows]
    assert len(ran) == len(set(ran)) == 2 * 2 * 6 * 2
    assert {row[2] for row in ran} == {
        "standard-as-released", "standard-as-written", "best-constant", "lookup", "nn", "anfis",
    }  # fmt: skip


def test_the_papers_errors_stand_beside_the_runs_that_they_compare_with(made):
    for configuration, standard in zip(CONFIGURATIONS, ("standard-as-released", "standard-as-written"), strict=True):
        for test in TESTS:
            beside = {
                row["controller"]: row["paper_mse"]
                for row in made.rows
                if row["configuration"] == configuration and row["scenario"] == test and row["paper_mse"] is not None
            }
            published = PUBLISHED[test].mse
            assert beside == {standard: published["standard"], "nn": published["nn"], "anfis": published["anfis"]}
    for row in made.rows:
        assert not (row["preview"] and row["paper_mse"])
        if row["ratio"] is not None:
            assert row["ratio"] == pytest.approx(row["mse"] / row["paper_mse"])


def test_the_standard_mpc_does_not_depend_on_what_was_learned(made):
    """The figures of docs/results.md."""
    expected = {
        ("released", "standard-as-released"): (0.0371, 0.6197),
        ("same-moves", "standard-as-written"): (0.0029, 0.1223),
    }
    for (configuration, controller), figures in expected.items():
        found = [
            row["mse"]
            for row in made.rows
            if (row["configuration"], row["controller"], row["preview"]) == (configuration, controller, False)
        ]
        assert found == pytest.approx(figures, rel=0.02)


def test_with_the_same_moves_all_but_the_controller_as_released_have_pulses(made):
    for row in made.rows:
        if row["configuration"] == "same-moves":
            assert (row["moves"] == "pulse") == (row["controller"] != "standard-as-released")


def test_all_that_was_measured_is_strict_json(made):
    found = json.loads(json.dumps(made.as_json(), allow_nan=False))
    assert found.keys() >= {
        "rows",
        "ablation",
        "shares",
        "knowing",
        "learning",
        "domain",
        "constant",
        "seconds",
        "quick",
    }
    assert len(found["learning"]) == 8
    assert found["constant"]["tuning"] == {"Np": 50, "Nc": 3, "Q": 0.5, "R": 0.05}


def test_clipped_steps_are_those_that_the_scheduler_counts(made):
    controller = paper.PaperController("lookup", paper.FAST, schedule=grid_lookup(small()))
    plant = paper.SingleTrack(paper.load_vehicle("paper"), "constant-stiffness")
    for test in TESTS:
        counted = rollout_batch(plant, controller.mpc(preview=False), paper.load_scenario(test)).scheduler
        (row,) = [
            row
            for row in made.rows
            if row["configuration"] == "released" and row["scenario"] == test
            and row["controller"] == "lookup" and not row["preview"]
        ]  # fmt: skip
        assert row["clipped_share"] == pytest.approx(counted["clipped"][0] / counted["steps"][0])


def test_no_constant_of_the_library_beats_the_best_in_hindsight(made):
    for row in made.ablation:
        (best,) = [
            other
            for other in made.ablation
            if other["scenario"] == row["scenario"] and other["moves"] == row["moves"]
            and other["controller"] == "best-in-hindsight"
        ]  # fmt: skip
        if row["controller"] in ("best-constant", "table-constant"):  # the table's tuning is in this library
            assert best["mse"] <= row["mse"] * (1 + 1e-9)
        assert 0 <= row["constants_better"] <= len(LIBRARY)


def test_the_ablation_has_every_moves_with_every_tuning(made):
    ran = {(row["scenario"], row["moves"], row["controller"]) for row in made.ablation}
    assert len(ran) == len(made.ablation) == 2 * 3 * 5
    assert {row["controller"] for row in made.ablation if row["adapts"]} == {"nn", "anfis"}


def test_swapping_all_three_numbers_spans_table_and_constant(made):
    assert {row["changed"] for row in made.swaps} == {"Np", "Nc", "R/Q"}
    assert all(row["mse"] > 0.0 for row in made.swaps)


def test_a_schedule_that_says_the_tables_constant_makes_adaptation_nothing():
    table = Constant(paper.TABLE)
    rows = paper.ablation(
        paper.SingleTrack(paper.load_vehicle("paper"), "constant-stiffness"),
        [paper.load_scenario("sine", duration=3.0)],
        paper.TABLE,
        {"nn": table, "anfis": table},
        LIBRARY,
    )
    for row in paper.shares(rows):
        assert row["adaptation"] == pytest.approx(1.0)
        assert row["pole_share"] == pytest.approx(1.0)


def test_an_experiment_that_was_stopped_goes_on_with_the_first_stage_that_is_missing(made, tmp_path, monkeypatch):
    def equal(one, other):
        timed = {"seconds", "training_seconds", "learning"}
        one, other = one.as_json(), other.as_json()
        assert {key: one[key] for key in one.keys() - timed} == {key: other[key] for key in other.keys() - timed}

    first = reproduce(small(), quick=True, folder=tmp_path)
    equal(first, made)
    kept = {path.name for path in (tmp_path / "stages").iterdir()}
    assert kept == {
        "training-nn.json", "training-anfis.json", "driving-both-configurations.json", "taking-the-gain-apart.json",
        "swapping-numbers.json", "knowing-the-car.json",
    }  # fmt: skip
    (tmp_path / "stages" / "swapping-numbers.json").unlink()
    for name in ("train", "measure", "ablation"):
        monkeypatch.setattr(paper, name, lambda *given, name=name, **more: pytest.fail(f"{name} was called"))
    heard = []
    again = reproduce(small(), quick=True, folder=tmp_path, progress=lambda *at: heard.append(at))
    equal(again, first)
    assert again.learning == first.learning, "the times of the training, too"
    assert heard == [("swapping numbers", 0, 7), ("timing steps", 1, 7)]


# -- what knowing the car brings --------------------------------------------------------------------------------------
def test_both_profiles_are_driven_by_the_published_the_adapted_and_the_informed_controller(made):
    for profile in ("paper", "road"):
        for test in TESTS:
            drove = [row["controller"] for row in made.knowing if (row["profile"], row["scenario"]) == (profile, test)]
            assert len(drove) == len(set(drove))
            assert {"standard-as-written", "standard-as-released", "nn", "anfis", "informed"} <= set(drove)


def test_on_the_ideal_car_there_is_nothing_to_know_and_on_the_road_it_keeps_the_car(made):
    found = {(row["profile"], row["scenario"], row["controller"]): row for row in made.knowing}
    for test in TESTS:
        ideal, published = (found["paper", test, name]["mse"] for name in ("informed", "standard-as-written"))
        assert ideal == pytest.approx(published, rel=0.05)
        assert found["road", test, "standard-as-written"]["failed"] == found["road", test, "informed"]["runs"]
        assert found["road", test, "informed"]["failed"] == 0


def known(**errors):
    """Rows of one profile and test; None: every run failed."""
    return [
        {
            "profile": "road", "scenario": TESTS[0], "controller": name.replace("_", "-"), "runs": 10, "mse": mse,
            "failed": 10 if mse is None else 0, "rms_rate": None if mse is None else 0.1,
        }
        for name, mse in errors.items()
    ]  # fmt: skip


def test_the_table_on_knowing_shows_failed_runs_and_never_prefers_one():
    rows = known(standard_as_written=None, nn=0.5, informed=0.4)
    rows[1]["failed"] = 3
    table = knowing.knowing_table(rows)
    assert {row["profile"] for row in table.rows} == {"Profile road"}
    (column,) = (column.name for column in table.columns if column.name.startswith("mse"))
    shown = {row["name"]: row[column] for row in table.rows}
    assert shown[knowing.NAMES["nn"]] == "failed, 3 of 10"
    assert [table.rows[i]["name"] for i, _ in sorted(table.best)] == [knowing.NAMES["informed"]]
    assert [table.rows[i]["name"] for i, _ in sorted(table.alert)] == [
        name for name, value in shown.items() if isinstance(value, str)
    ]


# -- the gain, taken apart --------------------------------------------------------------------------------------------
def corners(standard, pole_only, adapted_only, both):
    moves = ("laguerre 0.95", "laguerre 0.75")
    found = {"table-constant": (standard, pole_only), "nn": (adapted_only, both), "anfis": (adapted_only, both)}
    return [
        {"scenario": "test", "moves": each, "controller": name, "mse": mse}
        for name, pair in found.items()
        for each, mse in zip(moves, pair, strict=True)
    ]


@given(st.lists(st.floats(1e-6, 1e3), min_size=4, max_size=4))
def test_the_parts_of_the_gain_add_up(errors):
    for row in paper.shares(corners(*errors)):
        assert row["gain"] == pytest.approx(errors[0] / errors[3])
        assert row["pole"] * row["adaptation"] == pytest.approx(row["gain"])
        if row["pole_share"] is not None and abs(math.log(row["gain"])) > 1e-6:
            assert row["pole_share"] + row["adaptation_share"] == pytest.approx(1.0)


def test_independent_parts_are_found_exactly():
    for row in paper.shares(corners(8.0, 2.0, 4.0, 1.0)):
        assert (row["pole"], row["adaptation"]) == pytest.approx((4.0, 2.0))
        assert row["pole_share"] == pytest.approx(2.0 / 3.0)


def test_a_run_without_an_error_has_no_shares():
    for row in paper.shares(corners(8.0, 2.0, None, 1.0)):
        assert all(row[key] is None for key in ("gain", "pole", "adaptation", "pole_share", "adaptation_share"))


# -- the page ---------------------------------------------------------------------------------------------------------
def rigged(made, **errors):
    """The same outcome, but for the mean square errors of some controllers, by name."""

    def changed(row):
        mse = errors.get(row["controller"].replace("-", "_"))
        return row if mse is None or row["preview"] else {**row, "mse": mse, "failed": False}

    return dataclasses.replace(made, rows=[changed(row) for row in made.rows])


def test_the_page_says_that_the_learned_controllers_lose_when_they_lose(made):
    lead = " ".join(page.in_short(rigged(made, nn=9.0, anfis=9.0, standard_as_written=1.0)))
    assert "neither NN-MPC nor ANFIS-MPC tracks better than the standard MPC as written on either test" in lead
    assert "9.00 and 9.00 against 1.00 m²" in lead


def test_the_page_says_that_they_win_when_they_win(made):
    lead = " ".join(page.in_short(rigged(made, nn=0.5, anfis=0.6, standard_as_written=1.0)))
    assert "both NN-MPC and ANFIS-MPC track better than the standard MPC as written on both tests" in lead


def test_the_page_tells_one_winner_from_one_loser(made):
    rows = rigged(made, nn=0.5, anfis=2.0, best_constant=1.0).rows
    said = page.against(rows, "same-moves", "best-constant")
    assert said.startswith(
        "NN-MPC tracks better than the best constant of the data on both tests, ANFIS-MPC on neither"
    )


def test_a_failed_run_never_wins(made):
    rows = [
        {**row, "mse": 1e-9, "failed": True} if row["controller"] == "nn" and not row["preview"] else row
        for row in rigged(made, anfis=2.0, best_constant=1.0).rows
    ]
    assert page.against(rows, "released", "best-constant").startswith("neither")
    assert "NN-MPC" not in page.winners(rows, "released").split("; with preview")[0]


def test_a_lost_run_is_told_with_its_cause():
    row = {"configuration": "released", "scenario": TESTS[0], "controller": "lookup", "preview": False, "failed": True,
           "failed_at": 3.04, "failed_because": "spun"}  # fmt: skip
    assert page.failures([row, {**row, "failed": False}], "released") == [
        "Failed: the look-up table on the triple lane change without preview, at 3.0 s; the vehicle spun."
    ]


def test_errors_far_from_the_papers_are_named():
    row = {"configuration": "released", "scenario": TESTS[0], "controller": "nn", "paper_mse": 1.0, "ratio": 1.2}
    assert page.agreement([row] * 2, "released") == (
        "As released: all 2 mean square errors of the paper come out within 25 %."
    )
    far = {**row, "controller": "anfis", "ratio": 3.0}
    assert page.agreement([row, far], "released") == (
        "As released: 1 of the 2 mean square errors of the paper come out within 25 %; not ANFIS-MPC, triple lane "
        "change: 3.00 times the paper's."
    )


@pytest.mark.parametrize(
    ("errors", "words"),
    [
        ((8.0, 1.0, 8.0, 1.0), "100 % of their gain, by its logarithm; adaptation makes no difference"),
        ((8.0, 1.0, 9.0, 1.1), "(so more than all); adaptation takes some of it back in every case"),
        ((8.0, 2.0, 4.0, 1.0), "67 % of their gain, by its logarithm; adaptation is 33 %"),
        ((1.0, 1.0, 2.0, 2.0), "no gain over the standard MPC to explain"),
    ],
)
def test_pole_and_adaptation_get_what_the_numbers_give_them(errors, words):
    assert words in page.pole_or_adaptation(paper.shares(corners(*errors)))


@pytest.fixture(scope="module")
def report(made, tmp_path_factory):
    with pytest.MonkeyPatch.context() as patch, pictures(drawn=True):
        patch.setattr(style, "PNG_DPI", 20)
        return page.write_reproduction(tmp_path_factory.mktemp("page"), made, command="adaptrack reproduce --quick")


def test_the_page_has_figures_6_to_10_and_every_table(report):
    words = words_of(report)
    for number in ("6", "7", "8", "9", "10"):
        assert f"paper's figure {number}." in words
    for part in ("0.0318", "0.5896", "Where the gain comes from", "What was learned", "Do they hold here?"):
        assert part in words
    assert {path.suffix for path in report.parent.iterdir()} == {".html", ".png"}


def test_the_comparison_with_the_paper_comes_before_the_figures(report):
    titles = [html.unescape(title) for title in re.findall(r"<h2>(.*?)</h2>", report.read_text())]
    assert titles[:4] == ["All controllers", "The paper's statements", "What knowing the car brings", "At a glance"]
    assert titles.index("General trajectory") < titles.index("Where the gain comes from")


def test_the_page_shows_no_raw_value(report):
    words = words_of(report).rpartition("How it was made")[0]
    assert not re.search(r"\b(None|nan|inf|True|False)\b", words)


def test_a_quick_run_says_so(made, report):
    assert "This was a quick run" in words_of(report)
    assert not any("quick" in part for part in page.in_short(dataclasses.replace(made, quick=False)))
