"""The page on the ladder says what its numbers say, whoever wins, and works with whatever rungs there are."""

import dataclasses
import html
import re

import numpy as np
import pytest

from adaptrack.closed_loop import LOST_COST
from adaptrack.evaluate.ladder import Ladder
from adaptrack.mpc import Tuning
from adaptrack.report import ladder as page
from adaptrack.report import style
from adaptrack.report.ladder import best, importance, knowledge, losses, on_tests, ratio, standing, write_ladder
from adaptrack.report.words import number
from adaptrack.schedule import Constant, Guarded, Learned, StabilityMap, Table

CONDITIONS = {"standard": 9.0, "best constant": 2.5, "speed only": 1.6, "look-up": 1.2, "nn": 1.1, "anfis": 1.15}
REGRETS = CONDITIONS | {"optimum": 1.0}
DRIVES = {"best constant": 1.0, "speed only": 0.8, "nn": 0.5, "anfis": 0.55, "per-drive constant": 0.4}
DOMAIN = {"speed": (3.0, 27.0), "change": (0.0, 4.0), "friction": (0.4, 1.0)}


def climbed(factors, runs=40, reference="optimum", lost=None, spread=0.05, seed=1):
    """A ladder whose rungs cost so many times the reference, give or take; lost: how many runs of a rung."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(1e-3, 1e-2, runs)
    costs = {r: base * f * (1.0 if r == reference else rng.lognormal(0.0, spread, runs)) for r, f in factors.items()}
    failures = {rung: np.zeros(runs) for rung in factors}
    for rung, count in (lost or {}).items():
        costs[rung][:count], failures[rung][:count] = LOST_COST / 4.0, 0.25
    where = rng.uniform((3.0, -7.0, 0.4, -20.0), (27.0, 7.0, 1.0, 20.0), (runs, 4))
    counts = {rung: {"clipped": 0.125, "rate_limited": 0.0, "fallback": 1e-4} for rung in factors if rung == "nn"}
    return Ladder(costs, failures, counts, reference, where)


def scheduler(inputs=("speed", "change", "friction"), tilt=(20.0, 5.0, 0.0)):
    """Np that depends on each input as much as its tilt over the domain; Nc and R on none."""
    axes = tuple(np.array(DOMAIN[name]) for name in inputs)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * len(inputs), indexing="ij"), axis=-1)
    Np = Table(axes, 15.0 + corners @ np.array(tilt[: len(inputs)]))
    return Learned({"Np": Np, "Nc": 4.0, "log10_ratio": 3.5}, inputs, [DOMAIN[name] for name in inputs])


HISTORY = [{"round": r, "score": -5.0 - 0.01 * r, "lost": float(r < 10)} for r in (5, 10, 15)]
EVERYTHING = {
    "conditions": climbed(REGRETS, lost={"standard": 3}),
    "drives": climbed(DRIVES, reference="best constant"),
    "perceptions": {
        name: climbed({"optimum": 1.0, "best constant": 2.5, "nn": factor}, seed=4)
        for name, factor in (("exact", 1.1), ("estimated", 1.2), ("biased low", 3.0))
    },
    "drive_perceptions": {
        name: climbed(DRIVES | {"nn": factor}, reference="best constant", lost={"nn": lost}, seed=5)
        for name, factor, lost in (("exact", 0.5, 0), ("noisy", 0.55, 2), ("withheld", 0.9, 3))
    },
    "tests": {"triple-lane-change": climbed({"best constant": 1.0, "nn": 0.5}, 1, "best constant")},
    "schedules": {"nn": scheduler(), "anfis": scheduler(tilt=(10.0, 0.0, 8.0)), "look-up": scheduler()},
    "histories": {"nn": HISTORY, "anfis": []},
    "command": "adaptrack evaluate --seed 7 <now>",
    "notes": ["One car only."],
}
NOTHING = {"conditions": None, "drives": None} | {key: {} for key in ("perceptions", "tests", "schedules", "histories")}


def told(ladder):
    return {row["scheduler"]: row for row in ladder.rows()}


def words_of(path):
    text = re.sub(r"<(style|svg).*?</\1>", " ", path.read_text(), flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


def cells_of(path, caption, rung):
    """The cells of a rung's row in a table, as (text, class)."""
    table = re.search(rf"<caption>{caption}</caption>.*?</table>", path.read_text(), re.DOTALL).group()
    row = re.search(rf'<th scope="row">{rung}</th>(.*?)</tr>', table, re.DOTALL).group(1)
    return [(text, kind) for kind, text in re.findall(r'<td(?: class="(\w+)")?>(.*?)</td>', row)]


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """PNGs of few dots and surfaces of few nodes: these tests look at what is drawn, not at how finely."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "PNG_DPI", 20)
        patch.setattr(page, "_NODES", (9, 7))
        yield


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    return write_ladder(tmp_path_factory.mktemp("ladder") / "out", **EVERYTHING)


# -- judgements -------------------------------------------------------------------------------------------------------
def test_the_cheapest_rung_is_best_but_for_those_with_hindsight():
    assert best(climbed(REGRETS)) == ["nn"]
    assert best(climbed(DRIVES, reference="best constant")) == ["nn"]


def test_rungs_that_the_runs_cannot_tell_apart_are_level():
    alike = climbed({"nn": 1.1, "anfis": 1.1, "optimum": 1.0}, spread=0.2)
    assert ratio(alike, "nn", "anfis").verdict == "level"
    said = standing(alike, told(alike), "condition")
    assert re.search("(NN|ANFIS)-MPC is best, level with (ANFIS|NN)-MPC.", said)


def test_the_words_say_that_nn_loses_when_it_loses():
    ladder = climbed(REGRETS | {"nn": 4.0})
    said = standing(ladder, told(ladder), "condition")
    assert "ANFIS-MPC is best." in said
    mean, over = (ratio(ladder, "nn", other).mean for other in ("optimum", "best constant"))
    assert f"NN-MPC costs {number(mean)} times the optimum of each condition, {number(over)} times the best" in said
    said = page.against_constant(ladder, told(ladder), "condition")
    assert re.fullmatch(r"Not every adaptive .*on these conditions: NN-MPC costs more \(1\.\d\d times, .*\)\.", said)


def test_the_words_say_that_every_adaptive_rung_wins_only_when_it_does():
    ladder = climbed(REGRETS)
    said = page.against_constant(ladder, {}, "drive")
    assert said == "Every adaptive controller beats the best constant on these drives."
    level = climbed(REGRETS | {"anfis": 2.5}, spread=0.2)
    assert "ANFIS-MPC is level with it (" in page.against_constant(level, {}, "condition")


def test_the_best_constant_is_called_best_when_it_is():
    ladder = climbed(DRIVES | {"nn": 1.3, "anfis": 1.4, "speed only": 1.2}, reference="best constant")
    said = standing(ladder, told(ladder), "drive")
    assert "the best constant is best." in said
    assert f"ANFIS-MPC costs {number(ratio(ladder, 'anfis', 'best constant').mean)} times the best constant" in said


def test_the_numbers_in_words_are_those_of_the_rows():
    ladder = climbed(REGRETS)
    rows = told(ladder)
    said = standing(ladder, rows, "condition")
    assert f"it costs {number(rows['nn']['regret_geomean'])} times the optimum of each condition" in said
    low, high = (number(rows["nn"][f"regret_{end}"]) for end in ("low", "high"))
    assert f"(95 % interval {low} to {high})" in said
    assert f"{number(rows['nn']['regret_p90'])} times the optimum or more" in said
    assert f"at worst {number(rows['nn']['regret_worst'])} times" in said


def test_a_ratio_has_the_interval_of_a_normal_mean():
    ladder = climbed({"nn": 0.5, "best constant": 1.0}, 400, "best constant", spread=0.2)
    found = ratio(ladder, "nn", "best constant")
    row = told(ladder)["nn"]
    assert found.mean == pytest.approx(row["regret_geomean"])
    bootstrap = row["regret_low"], row["regret_high"]
    assert (found.low, found.high) == pytest.approx(bootstrap, rel=3e-3)


def test_lost_runs_are_counted_and_named():
    ladder = climbed(REGRETS, lost={"standard": 3, "nn": 1})
    said = losses(ladder, told(ladder), "condition")
    assert said == "The car was lost by the standard MPC in 3 and NN-MPC in 1 of 40 conditions; by no other."
    ladder = climbed(REGRETS)
    assert losses(ladder, told(ladder), "drive") == "No controller lost the car in any of 40 drives."


def test_imperfect_knowledge_is_told_by_its_costs():
    said = knowledge(EVERYTHING["perceptions"], "condition")
    assert said.startswith("By how friction and wind are known on these conditions, NN-MPC costs")
    assert re.search(
        r"NN-MPC costs 1\.1\d* \(exact\), 1\.\d+ \(estimated\) and [23]\.\d+ \(biased low, the worst\) times",
        said,
    )
    assert re.search(r"not always beaten: NN-MPC, biased low, costs more \(1\.\d+ times", said)
    assert "ANFIS" not in said
    harmless = {name: EVERYTHING["perceptions"][name] for name in ("exact", "estimated")}
    assert knowledge(harmless, "condition").endswith("However they are known, the best constant costs more.")
    assert knowledge({"exact": harmless["exact"]}, "condition") == ""
    names, factors = ("exact", "withheld"), {"best constant": 1.0, "nn": 0.5}
    lossy = {name: climbed(factors, reference="best constant", lost={"nn": k}) for k, name in enumerate(names)}
    assert knowledge(lossy, "drive").endswith("The car was lost by NN-MPC in 1 (withheld) of the drives.")


def test_the_papers_tests_say_who_does_not_beat_the_constant_and_what_hindsight_reaches():
    factors = {"best constant": 1.0, "nn": 0.5, "anfis": 1.5, "per-drive constant": 0.4}
    said = on_tests({"general-trajectory": climbed(factors, 1, "best constant", spread=0.0)})
    assert said == (
        "On the paper's general trajectory NN-MPC costs 0.500 times and ANFIS-MPC costs 1.50 times the best constant; "
        "the best tuning in hindsight costs 0.400 times; ANFIS-MPC does not beat it."
    )
    assert on_tests({"general-trajectory": climbed({"nn": 0.5, "speed only": 1.0}, 1, "speed only")}) == ""


def test_learning_that_was_still_falling_is_said_to_be():
    last = page._course("nn", [(5, 2.0), (10, 1.0)], [{"lost": 1.0}, {"lost": 0.0}])
    assert last == "With NN-MPC the held-out runs cost 2.00 m² after round 5 and 1.00 m² after round 10, the last, so more rounds may help."  # fmt: skip  # noqa: E501
    done = page._course("nn", [(5, 2.0), (10, 1.0), (15, 1.5)], [{"lost": 1.0}, {"lost": 2.0}, {"lost": 0.0}])
    assert done.endswith("1.00 m² after round 10, which was kept; it loses 2 of them.")


# -- numbers ----------------------------------------------------------------------------------------------------------
def test_the_input_that_moves_the_tuning_most_has_the_largest_share():
    shares = importance(scheduler(tilt=(20.0, 5.0, 0.0)))
    assert shares["friction"] == 0.0
    # of Np alone, a third of the three numbers: variances of an additive function are as its tilts squared
    assert 3.0 * shares["speed"] == pytest.approx(400.0 / 425.0, abs=0.1)
    assert 3.0 * shares["change"] == pytest.approx(25.0 / 425.0, abs=0.03)


def test_a_cell_of_a_map_is_the_geometric_mean_of_its_conditions():
    x, y = np.array([0.0, 0.1, 1.0, 0.9]), np.array([0.0, 0.2, 1.0, 0.1])
    found = page._mean_regret(np.array([2.0, 8.0, 3.0, 5.0]), x, y)
    assert found.values == pytest.approx(np.array([[4.0, 5.0], [np.nan, 3.0]]), nan_ok=True)


# -- the page ---------------------------------------------------------------------------------------------------------
def test_the_folder_holds_the_page_and_a_png_of_every_picture(report):
    pngs = {"regret-map.png", "spread.png", "surfaces.png", "learning.png"}
    assert {path.name for path in report.parent.iterdir()} == {"index.html"} | pngs
    assert all((report.parent / name).read_bytes().startswith(b"\x89PNG") for name in pngs)


def test_every_picture_is_described_in_words_with_numbers(report):
    labels = re.findall(r'<svg role="img" aria-label="([^"]+)"', report.read_text())
    assert len(labels) == 5 * 2 + 2 + 3 * 2 + 2
    assert all(re.search(r"\d", label) for label in labels)
    assert not any("nan" in label or "$" in label for label in labels)


def test_the_tables_hold_the_rows_and_mark_the_best_and_the_lost(report):
    row = told(EVERYTHING["conditions"])["nn"]
    cells = cells_of(report, "Regret on single conditions", "NN-MPC")
    assert cells[0] == (number(row["regret_geomean"]), "strong")
    assert [text for text, _ in cells[2:6]] == [number(row[f"regret_{key}"]) for key in ("p50", "p90", "p99", "worst")]
    assert cells_of(report, "Regret on single conditions", "Standard MPC")[-1] == ("3", "warn")
    assert not any(kind for _, kind in cells_of(report, "Regret on single conditions", "Optimum of each condition"))
    drives = EVERYTHING["drives"]
    cells = cells_of(report, "Cost of long drives", "ANFIS-MPC")
    assert cells[0][0] == number(told(drives)["anfis"]["cost_geomean"])
    assert cells[1][0] == number(ratio(drives, "anfis", "best constant").mean)
    assert cells[5][0] == number(ratio(drives, "anfis", "speed only").mean)
    assert not any(kind for _, kind in cells_of(report, "Cost of long drives", "Best constant of each drive"))


def test_the_page_holds_knowledge_tests_guard_limits_and_the_command(report):
    words = words_of(report)
    for part in ("Biased low", "Triple lane change", "12.5", "< 0.1", "One car only.", "--seed 7 <now>"):
        assert part in words
    assert "With NN-MPC the held-out runs cost" in words


def table_of(path, caption):
    """The rows of a table under the words that head them: rung -> first cell -> the others."""
    table = re.search(rf"<caption>{caption}</caption>.*?</table>", path.read_text(), re.DOTALL).group()
    found, rung = {}, ""
    for row in re.findall(r"<tr.*?</tr>", table, re.DOTALL)[1:]:
        name, *cells = [
            re.sub(r"<[^>]+>", "", each).strip() for each in re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL)
        ]
        if cells:
            found[rung][name] = cells
        else:
            rung = name
            found[rung] = {}
    return found


def test_drives_that_are_told_otherwise_stand_beside_the_best_constant(report):
    told_otherwise = EVERYTHING["drive_perceptions"]
    rows = table_of(report, "Imperfect knowledge of friction and wind: drives")
    assert list(rows) == ["NN-MPC", "ANFIS-MPC"], "who looks at neither is not told"
    assert list(rows["NN-MPC"]) == ["Exact", "Noisy", "Withheld"]
    for name, ladder in told_otherwise.items():
        over_constant, p90, worst, over_exact, lost = rows["NN-MPC"][name.capitalize()]
        row = told(ladder)["nn"]
        assert [over_constant, p90, worst] == [number(row[f"regret_{key}"]) for key in ("geomean", "p90", "worst")]
        both = ladder.costs["nn"], told_otherwise["exact"].costs["nn"]
        assert over_exact == number(float(np.exp(np.log(both[0] / both[1]).mean())))
        assert lost == str(row["failures"])
    assert [rows["NN-MPC"][name][-1] for name in rows["NN-MPC"]] == ["0", "2", "3"]
    first, last = (rows["NN-MPC"][name][0] for name in ("Exact", "Withheld"))
    assert f"on these drives, NN-MPC costs {first} (exact) and {last} (withheld) times the best" in words_of(report)


def test_conditions_keep_a_table_of_their_own_beside_that_of_the_drives(report):
    rows = table_of(report, "Imperfect knowledge of friction and wind: conditions")
    ladder = EVERYTHING["perceptions"]["biased low"]
    assert list(rows) == ["NN-MPC"]
    assert rows["NN-MPC"]["Biased low"][0] == number(told(ladder)["nn"]["regret_geomean"])
    assert rows["NN-MPC"]["Biased low"][3] == number(ratio(ladder, "nn", "best constant").mean)


def test_without_conditions_what_is_told_otherwise_are_the_drives(tmp_path):
    told_otherwise = {"drives": EVERYTHING["drives"], "perceptions": EVERYTHING["drive_perceptions"]}
    words = words_of(write_ladder(tmp_path, **NOTHING | told_otherwise, command="again"))
    assert "Imperfect knowledge of friction and wind: drives" in words
    assert "wind: conditions" not in words


def test_surfaces_show_what_was_learned_without_the_guard():
    axes = [np.array([0.0, 1.0])] * 5
    nowhere_stable = StabilityMap(Table(tuple(axes), np.full((2,) * 5, 2.0)))
    behind = Guarded(scheduler(), Tuning(Np=50, Nc=2, Q=1.0, R=100.0), stability=nowhere_stable)
    assert behind.batch([[15.0, 0.0, 0.7, 0.0]])[0, 0] == 50.0
    (section,) = page._learned({"nn": behind})
    Np, Nc, ratio_ = (panel.description for panel in section.items[0].panels)
    assert Np == "NN-MPC: N_p (periods). Over speed and reference change ahead: 15 to 40."
    assert Nc.endswith("ahead: 4.")
    assert ratio_ == "NN-MPC: log10 R/Q (R/Q in m²/rad²). Over speed and reference change ahead: 3.5."


@pytest.mark.parametrize("missing", [*REGRETS, "everything but one"])
def test_the_words_and_tables_do_without_any_rung(missing, monkeypatch):
    monkeypatch.setattr(page, "MAPPED", ())
    kept = {"nn": 1.1} if missing.startswith("every") else {r: f for r, f in REGRETS.items() if r != missing}
    ladder = climbed(kept, reference=next(reversed(kept)))
    rows = told(ladder)
    assert standing(ladder, rows, "condition").startswith("On 40 conditions that nobody trained on, ")
    section = page._on_conditions(page._Told(ladder, rows, "condition"))
    table = next(item for item in section.items if isinstance(item, page.Table))
    assert [row[0] for row in table.rows] == [page._label(rung) for rung in kept]
    page._on_drives(page._Told(ladder, rows, "drive"))


def test_a_page_of_one_rung_and_a_page_of_nothing_are_pages(tmp_path):
    alone = climbed({"mine": 1.0}, 3, "mine")
    schedules = {"nn": Constant(Tuning(Np=20, Nc=4, Q=1.0, R=1.0)), "anfis": scheduler(("speed",))}
    words = words_of(write_ladder(tmp_path, **NOTHING | {"drives": alone, "schedules": schedules}, command="again"))
    assert "On 3 drives that nobody trained on, mine is best." in words
    assert "What was learned" not in words
    assert "Nothing was driven" in words_of(write_ladder(tmp_path, **NOTHING, command="again"))


def test_a_rung_of_ones_own_is_compared_like_the_others():
    ladder = climbed({"best constant": 1.0, "mine": 0.7}, 20, "best constant")
    said = standing(ladder, told(ladder), "drive")
    assert f"mine is best. In the geometric mean it costs {number(ladder.rows()[1]['regret_geomean'])}" in said
    assert page.adaptive(ladder) == ["mine"]


def test_colours_and_dashes_tell_all_rungs_apart():
    strokes = page._strokes([*page._RUNGS, "mine"])
    assert len(set(map(dataclasses.astuple, strokes.values()))) == len(strokes)
    assert strokes["paper recipe nn"].colour == strokes["nn"].colour
    assert page._strokes(["anfis"])["anfis"] == strokes["anfis"]
