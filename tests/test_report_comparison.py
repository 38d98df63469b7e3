"""The page on a comparison says what its numbers say, whoever wins, and works with whatever contenders there are."""

import dataclasses
import html
import re

import numpy as np
import pytest

from adaptrack.base.result import BACKGROUND, SERIES
from adaptrack.base.statistics import binned_geometric_mean
from adaptrack.comparison.table import Comparison, Role
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import Constant, Guarded, Learned, StabilityMap, Table
from adaptrack.control.scheduling.sensitivity import importance
from adaptrack.results import comparison_pictures as drawn
from adaptrack.results import style, write_result
from adaptrack.results.comparison import comparison_result
from adaptrack.results.comparison_words import (
    MAPPED,
    NAMES,
    against_constant,
    failures,
    few_strokes,
    knowledge,
    label_of,
    on_tests,
    progress_of,
    standing,
    strokes_of,
)
from adaptrack.results.draw import described
from adaptrack.results.words import number
from pictures import pictures

POINTS = {"standard": 9.0, "best constant": 2.5, "speed only": 1.6, "look-up": 1.2, "nn": 1.1, "anfis": 1.15}
REGRETS = POINTS | {"optimum": 1.0}
DRIVES = {"best constant": 1.0, "speed only": 0.8, "nn": 0.5, "anfis": 0.55, "per-drive constant": 0.4}
ROLES = {
    **dict.fromkeys(("standard", "best constant"), Role(adapts=False)),
    **dict.fromkeys(("optimum", "per-drive constant"), Role(adapts=False, hindsight=True)),
}
DOMAIN = {"speed": (3.0, 27.0), "change": (0.0, 4.0), "friction": (0.4, 1.0)}


def compared(factors, runs=40, reference="optimum", failed=None, spread=0.05, seed=1):
    """Contenders that cost so many times the reference, give or take; failed: how many runs of each."""
    rng = np.random.default_rng(seed)
    base = rng.uniform(1e-3, 1e-2, runs)
    costs = {r: base * f * (1.0 if r == reference else rng.lognormal(0.0, spread, runs)) for r, f in factors.items()}
    shares = {name: np.zeros(runs) for name in factors}
    for name, count in (failed or {}).items():
        costs[name][:count], shares[name][:count] = 25.0 / 4.0, 0.25
    where = rng.uniform((3.0, -7.0, 0.4, -20.0), (27.0, 7.0, 1.0, 20.0), (runs, 4))
    counts = {name: {"clipped": 0.125, "rate_limited": 0.0, "fallback": 1e-4} for name in factors if name == "nn"}
    roles = {name: dataclasses.replace(ROLES.get(name, Role()), kind=name) for name in factors}
    driven = {name: {"cost": costs[name], "failed": shares[name]} for name in costs}
    return Comparison.of_runs(driven, reference, overall=counts, where=where, roles=roles)


def scheduler(inputs=("speed", "change", "friction"), tilt=(20.0, 5.0, 0.0), name="nn"):
    """Np that depends on each input as much as its tilt over the domain; Nc and R on none."""
    axes = tuple(np.array(DOMAIN[each]) for each in inputs)
    corners = np.stack(np.meshgrid(*[[0.0, 1.0]] * len(inputs), indexing="ij"), axis=-1)
    Np = Table(axes, 15.0 + corners @ np.array(tilt[: len(inputs)]))
    return Learned({"Np": Np, "Nc": 4.0, "log10_ratio": 3.5}, inputs, [DOMAIN[each] for each in inputs], name=name)


HISTORY = [{"round": r, "score": -5.0 - 0.01 * r, "failed": float(r < 10)} for r in (5, 10, 15)]
EXACT_POINTS = compared(REGRETS, failed={"standard": 3})
EXACT_DRIVES = compared(DRIVES, reference="best constant")
EVERYTHING = {
    "operating_points": {
        "exact": EXACT_POINTS,
        **{
            name: compared({"optimum": 1.0, "best constant": 2.5, "nn": factor}, seed=4)
            for name, factor in (("estimated", 1.2), ("biased low", 3.0))
        },
    },
    "drives": {
        "exact": EXACT_DRIVES,
        **{
            name: compared(DRIVES | {"nn": factor}, reference="best constant", failed={"nn": count}, seed=5)
            for name, factor, count in (("noisy", 0.55, 2), ("withheld", 0.9, 3))
        },
    },
    "tests": {"triple-lane-change": compared({"best constant": 1.0, "nn": 0.5}, 1, "best constant")},
    "schedules": {
        "nn": scheduler(),
        "anfis": scheduler(tilt=(10.0, 0.0, 8.0), name="anfis"),
        "look-up": scheduler(name="look-up"),
    },
    "histories": {"nn": HISTORY, "anfis": []},
    "command": "adaptrack evaluate-schedules --seed 7 <now>",
    "notes": ["One car only."],
}
NOTHING = {key: {} for key in ("operating_points", "drives", "tests", "schedules", "histories")}


def rows_of(comparison):
    return {row["contender"]: row for row in comparison.rows()}


def words_of(path):
    text = re.sub(r"<(style|svg).*?</\1>", " ", path.read_text(), flags=re.DOTALL)
    return " ".join(html.unescape(re.sub(r"<[^>]+>", " ", text)).split())


def cells_of(path, caption, name):
    """The cells of a name's row in a table, as (text, class)."""
    table = re.search(rf"<caption>{caption}</caption>.*?</table>", path.read_text(), re.DOTALL).group()
    row = re.search(rf'<th scope="row">{name}</th>(.*?)</tr>', table, re.DOTALL).group(1)
    return [(text, kind) for kind, text in re.findall(r'<td(?: class="(\w+)")?>(.*?)</td>', row)]


@pytest.fixture(scope="module", autouse=True)
def coarse():
    """PNGs of few dots and surfaces of few nodes: these tests look at what is drawn, not at how finely."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(style, "PNG_DPI", 20)
        patch.setattr(drawn, "NODES", (9, 7))
        yield


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    with pictures(drawn=True):
        return write_result(tmp_path_factory.mktemp("comparison") / "out", comparison_result(**EVERYTHING))


# -- judgements -------------------------------------------------------------------------------------------------------
def test_the_cheapest_rung_is_best_but_for_those_with_hindsight():
    assert compared(REGRETS).best == ["nn"]
    assert compared(DRIVES, reference="best constant").best == ["nn"]


def test_rungs_that_the_runs_cannot_tell_apart_are_level():
    alike = compared({"nn": 1.1, "anfis": 1.1, "optimum": 1.0}, spread=0.2)
    assert alike.ratio("nn", "anfis").verdict == "level"
    said = standing(alike, rows_of(alike), "operating point")
    assert re.search("(NN|ANFIS)-MPC is best, level with (ANFIS|NN)-MPC.", said)


def test_the_words_say_that_nn_loses_when_it_loses():
    comparison = compared(REGRETS | {"nn": 4.0})
    said = standing(comparison, rows_of(comparison), "operating point")
    assert "ANFIS-MPC is best." in said
    mean, over = (comparison.ratio("nn", other).mean for other in ("optimum", "best constant"))
    assert (
        f"NN-MPC costs {number(mean)} times the optimum of each operating point, {number(over)} times the best" in said
    )
    said = against_constant(comparison, rows_of(comparison), "operating point")
    assert re.fullmatch(
        r"Not every adaptive .*on these operating points: NN-MPC costs more \(1\.\d\d times, .*\)\.", said
    )


def test_the_words_say_that_every_adaptive_rung_wins_only_when_it_does():
    comparison = compared(REGRETS)
    said = against_constant(comparison, {}, "drive")
    assert said == "Every adaptive controller beats the best constant on these drives."
    level = compared(REGRETS | {"anfis": 2.5}, spread=0.2)
    assert "ANFIS-MPC is level with it (" in against_constant(level, {}, "operating point")


def test_the_best_constant_is_called_best_when_it_is():
    comparison = compared(DRIVES | {"nn": 1.3, "anfis": 1.4, "speed only": 1.2}, reference="best constant")
    said = standing(comparison, rows_of(comparison), "drive")
    assert "the best constant is best." in said
    assert f"ANFIS-MPC costs {number(comparison.ratio('anfis', 'best constant').mean)} times the best constant" in said


def test_the_numbers_in_words_are_those_of_the_rows():
    comparison = compared(REGRETS)
    rows = rows_of(comparison)
    said = standing(comparison, rows, "operating point")
    assert f"it costs {number(rows['nn']['regret_geomean'])} times the optimum of each operating point" in said
    low, high = (number(rows["nn"][f"regret_{end}"]) for end in ("low", "high"))
    assert f"(95 % interval {low} to {high})" in said
    assert f"{number(rows['nn']['regret_p90'])} times the optimum or more" in said
    assert f"at worst {number(rows['nn']['regret_worst'])} times" in said


def test_a_sentence_has_the_interval_of_the_table():
    """And it is nearly that of a normal mean."""
    comparison = compared({"nn": 0.5, "best constant": 1.0}, 400, "best constant", spread=0.2)
    found = comparison.ratio("nn", "best constant")
    row = rows_of(comparison)["nn"]
    assert found == (row["regret_geomean"], row["regret_low"], row["regret_high"])
    logs = np.log(comparison.regret("nn"))
    half = 1.96 * logs.std(ddof=1) / 20.0
    assert np.log([found.low, found.high]) == pytest.approx([logs.mean() - half, logs.mean() + half], rel=1e-2)


def test_failed_runs_are_counted_and_named():
    comparison = compared(REGRETS, failed={"standard": 3, "nn": 1})
    said = failures(comparison, rows_of(comparison), "operating point")
    assert said == "Failed: the standard MPC in 3 and NN-MPC in 1 of 40 operating points; no other."
    comparison = compared(REGRETS)
    assert failures(comparison, rows_of(comparison), "drive") == "No controller failed in any of 40 drives."


def test_imperfect_knowledge_is_told_by_its_costs():
    said = knowledge(EVERYTHING["operating_points"], "operating point")
    assert said.startswith("By how friction and wind are known on these operating points, NN-MPC costs")
    assert re.search(
        rf"NN-MPC costs {number(EXACT_POINTS.mean_ratio('nn', 'optimum'))} \(exact\), "
        r"1\.\d+ \(estimated\) and [23]\.\d+ \(biased low, the worst\) times",
        said,
    )
    assert re.search(r"not always beaten: NN-MPC, biased low, costs more \(1\.\d+ times", said)
    assert "ANFIS" not in said
    harmless = {name: EVERYTHING["operating_points"][name] for name in ("exact", "estimated")}
    assert knowledge(harmless, "operating point").endswith("However they are known, the best constant costs more.")
    assert knowledge({"exact": harmless["exact"]}, "operating point") == ""
    names, factors = ("exact", "withheld"), {"best constant": 1.0, "nn": 0.5}
    lossy = {name: compared(factors, reference="best constant", failed={"nn": k}) for k, name in enumerate(names)}
    assert knowledge(lossy, "drive").endswith("Failed: NN-MPC in 1 (withheld) of the drives.")


def test_the_papers_tests_say_who_does_not_beat_the_constant_and_what_hindsight_reaches():
    factors = {"best constant": 1.0, "nn": 0.5, "anfis": 1.5, "per-drive constant": 0.4}
    said = on_tests({"general-trajectory": compared(factors, 1, "best constant", spread=0.0)})
    assert said == (
        "On the paper's general trajectory NN-MPC costs 0.500 times and ANFIS-MPC costs 1.50 times the best constant; "
        "the best tuning in hindsight costs 0.400 times; ANFIS-MPC does not beat it."
    )
    assert on_tests({"general-trajectory": compared({"nn": 0.5, "speed only": 1.0}, 1, "speed only")}) == ""


def test_learning_that_was_still_falling_is_said_to_be():
    last = progress_of("nn", [(5, 2.0), (10, 1.0)], [{"failed": 1.0}, {"failed": 0.0}])
    assert last == "With NN-MPC the held-out runs cost 2.00 m² after round 5 and 1.00 m² after round 10, the last, so more rounds may help."  # fmt: skip  # noqa: E501
    done = progress_of("nn", [(5, 2.0), (10, 1.0), (15, 1.5)], [{"failed": 1.0}, {"failed": 2.0}, {"failed": 0.0}])
    assert done.endswith("1.00 m² after round 10, which was kept; 2 of them fail.")


# -- numbers ----------------------------------------------------------------------------------------------------------
def test_the_input_that_moves_the_tuning_most_has_the_largest_share():
    shares = importance(scheduler(tilt=(20.0, 5.0, 0.0)))
    assert shares["friction"] == 0.0
    # of Np alone, a third of the three numbers: variances of an additive function are as its tilts squared
    assert 3.0 * shares["speed"] == pytest.approx(400.0 / 425.0, abs=0.1)
    assert 3.0 * shares["change"] == pytest.approx(25.0 / 425.0, abs=0.03)


def test_a_cell_of_a_map_is_the_geometric_mean_of_its_operating_points():
    x, y = np.array([0.0, 0.1, 1.0, 0.9]), np.array([0.0, 0.2, 1.0, 0.1])
    _, _, found = binned_geometric_mean(np.array([2.0, 8.0, 3.0, 5.0]), x, y, 2)
    assert found == pytest.approx(np.array([[4.0, 5.0], [np.nan, 3.0]]), nan_ok=True)


# -- the page ---------------------------------------------------------------------------------------------------------
def test_the_folder_holds_the_page_and_a_png_of_every_picture(report):
    pngs = {"spread.png", "surfaces.png", "learning.png"}
    assert {path.name for path in report.parent.iterdir()} == {"index.html"} | pngs
    assert all((report.parent / name).read_bytes().startswith(b"\x89PNG") for name in pngs)


def test_every_picture_is_described_in_words_with_numbers(report):
    labels = re.findall(r'<svg role="img" aria-label="([^"]+)"', report.read_text())
    assert len(labels) == 1 + 2 + 3 * 2 + 2
    assert all(re.search(r"\d", label) for label in labels)
    assert not any("nan" in label or "$" in label for label in labels)


def test_a_map_is_drawn_where_its_cells_hold_operating_points(report):
    assert "Maps of the regret over the domain need 96 operating points or more." in words_of(report)
    assert len(drawn.regret_maps(compared(REGRETS, runs=96)).panels) == 5 * 2
    assert drawn.mean_regret(np.ones(96), np.arange(96.0), np.arange(96.0))[2].shape == (4, 4)


def test_the_page_opens_with_the_best_its_interval_and_the_reference(report):
    text = report.read_text()
    first = words_of(report)[: words_of(report).index("Operating points") + 400]
    row = rows_of(EXACT_DRIVES)["nn"]
    assert text.index('class="verdict"') < text.index("<svg role") < text.index("<nav")
    assert "On 40 drives NN-MPC costs least" in first
    assert f"({number(row['regret_low'])} to {number(row['regret_high'])})" in first


def test_no_contender_is_praised_for_its_ratio_to_itself():
    made = compared({"best constant": 1.0, "nn": 2.0}, reference="best constant")
    table = comparison_result(**NOTHING | {"drives": {"exact": made}}).table("cost")
    assert [row["label"] for row in table.rows] == ["Best constant", "NN-MPC"]
    assert table.rows[0]["regret_geomean"] == 1.0
    assert not [place for place in table.best if place[1] == "regret_geomean"]


def test_as_many_contenders_are_coloured_as_there_are_colours():
    kinds = {name: name for name in NAMES} | {"mine": ""}
    strokes = few_strokes(kinds, ["mine"])
    coloured = [stroke.colour for stroke in strokes.values() if stroke != BACKGROUND]
    assert sorted(coloured) == sorted(SERIES)
    assert all(strokes[who] != BACKGROUND for who in MAPPED)
    assert strokes["mine"] != BACKGROUND


def test_the_tables_hold_the_rows_and_mark_the_best_and_the_lost(report):
    row = rows_of(EXACT_POINTS)["nn"]
    cells = cells_of(report, "Regret on single operating points", "NN-MPC")
    assert cells[0] == (number(row["regret_geomean"]), "strong")
    assert [text for text, _ in cells[2:6]] == [number(row[f"regret_{key}"]) for key in ("p50", "p90", "p99", "worst")]
    assert cells_of(report, "Regret on single operating points", "Standard MPC")[-1] == ("3", "warn")
    assert not any(
        kind for _, kind in cells_of(report, "Regret on single operating points", "Optimum of each operating point")
    )
    drives = EXACT_DRIVES
    cells = cells_of(report, "Cost of long drives", "ANFIS-MPC")
    assert cells[0][0] == number(rows_of(drives)["anfis"]["cost_geomean"])
    assert cells[1][0] == number(drives.ratio("anfis", "best constant").mean)
    assert cells[5][0] == number(drives.ratio("anfis", "speed only").mean)
    assert not any(kind for _, kind in cells_of(report, "Cost of long drives", "Best constant of each drive"))


def test_the_page_holds_knowledge_tests_guard_limits_and_the_command(report):
    words = words_of(report)
    for part in ("Biased low", "Triple lane change", "12.5", "< 0.1", "One car only.", "--seed 7 <now>"):
        assert part in words
    assert "With NN-MPC the held-out runs cost" in words


def table_of(path, caption):
    """The rows of a table under the words that head them: contender -> first cell -> the others."""
    table = re.search(rf"<caption>{caption}</caption>.*?</table>", path.read_text(), re.DOTALL).group()
    found, contender = {}, ""
    for row in re.findall(r"<tr.*?</tr>", table, re.DOTALL)[1:]:
        name, *cells = [
            re.sub(r"<[^>]+>", "", each).strip() for each in re.findall(r"<t[hd].*?</t[hd]>", row, re.DOTALL)
        ]
        if cells:
            found[contender][name] = cells
        else:
            contender = name
            found[contender] = {}
    return found


def test_drives_that_are_known_otherwise_stand_beside_the_best_constant(report):
    told_otherwise = EVERYTHING["drives"]
    rows = table_of(report, "Imperfect knowledge of friction and wind: drives")
    assert list(rows) == ["NN-MPC", "ANFIS-MPC"], "who looks at neither is not shown"
    assert list(rows["NN-MPC"]) == ["Exact", "Noisy", "Withheld"]
    for name, comparison in told_otherwise.items():
        over_constant, p90, worst, over_exact, failed = rows["NN-MPC"][name.capitalize()]
        row = rows_of(comparison)["nn"]
        assert [over_constant, p90, worst] == [number(row[f"regret_{key}"]) for key in ("geomean", "p90", "worst")]
        both = comparison.costs["nn"], told_otherwise["exact"].costs["nn"]
        assert over_exact == number(float(np.exp(np.log(both[0] / both[1]).mean())))
        assert failed == str(row["failures"])
    assert [rows["NN-MPC"][name][-1] for name in rows["NN-MPC"]] == ["0", "2", "3"]
    first, last = (rows["NN-MPC"][name][0] for name in ("Exact", "Withheld"))
    assert f"on these drives, NN-MPC costs {first} (exact) and {last} (withheld) times the best" in words_of(report)


def test_operating_points_keep_a_table_of_their_own_beside_that_of_the_drives(report):
    rows = table_of(report, "Imperfect knowledge of friction and wind: operating points")
    comparison = EVERYTHING["operating_points"]["biased low"]
    assert list(rows) == ["NN-MPC"]
    assert rows["NN-MPC"]["Biased low"][0] == number(rows_of(comparison)["nn"]["regret_geomean"])
    assert rows["NN-MPC"]["Biased low"][3] == number(comparison.ratio("nn", "best constant").mean)


def test_surfaces_show_what_was_learned_without_the_guard():
    axes = [np.array([0.0, 1.0])] * 5
    nowhere_stable = StabilityMap(Table(tuple(axes), np.full((2,) * 5, 2.0)))
    behind = Guarded(scheduler(), Tuning(Np=50, Nc=2, Q=1.0, R=100.0), stability=nowhere_stable)
    assert behind.batch([[15.0, 0.0, 0.7, 0.0]])[0, 0] == 50.0
    schedules = {"nn": dataclasses.replace(behind, name="nn")}
    result = comparison_result(**NOTHING | {"schedules": schedules})
    Np, Nc, ratio_ = (described(panel) for panel in result.picture("surfaces").panels)
    assert Np == "NN-MPC: N_p (periods). Over speed and reference change ahead: 15 to 40."
    assert Nc.endswith("ahead: 4.")
    assert ratio_ == "NN-MPC: log10 R/Q (R/Q in m²/rad²). Over speed and reference change ahead: 3.5."


@pytest.mark.parametrize("missing", [*REGRETS, "everything but one"])
def test_the_words_and_tables_do_without_any_rung(missing):
    kept = {"nn": 1.1} if missing.startswith("every") else {r: f for r, f in REGRETS.items() if r != missing}
    comparison = compared(kept, reference=next(reversed(kept)))
    said = standing(comparison, rows_of(comparison), "operating point")
    assert said.startswith("On 40 operating points that nobody trained on, ")
    views = {"operating_points": {"exact": comparison}, "drives": {"exact": comparison}}
    result = comparison_result(**NOTHING | views)
    for name in ("regret", "cost"):
        assert [row["label"] for row in result.table(name).rows] == [label_of(who) for who in kept]


def test_a_page_of_one_rung_and_a_page_of_nothing_are_pages(tmp_path):
    alone = compared({"mine": 1.0}, 3, "mine")
    schedules = {"nn": Constant(Tuning(Np=20, Nc=4, Q=1.0, R=1.0)), "anfis": scheduler(("speed",))}
    result = comparison_result(**NOTHING | {"drives": {"exact": alone}, "schedules": schedules})
    words = words_of(write_result(tmp_path, result))
    assert "On 3 drives that nobody trained on, mine is best." in words
    assert "What was learned" not in words
    assert "Nothing was driven" in words_of(write_result(tmp_path, comparison_result(**NOTHING)))


def test_a_rung_of_ones_own_is_compared_like_the_others():
    comparison = compared({"best constant": 1.0, "mine": 0.7}, 20, "best constant")
    said = standing(comparison, rows_of(comparison), "drive")
    assert f"mine is best. In the geometric mean it costs {number(comparison.rows()[1]['regret_geomean'])}" in said
    assert comparison.adaptive == ["mine"]


def test_colours_and_dashes_tell_all_rungs_apart():
    strokes = strokes_of({name: name for name in (*NAMES, "mine")})
    assert len(set(map(dataclasses.astuple, strokes.values()))) == len(strokes)
    assert strokes["paper recipe nn"].colour == strokes["nn"].colour
    assert strokes_of({"anfis": "anfis"})["anfis"] == strokes["anfis"]


def test_schedulers_are_called_by_their_files_names_and_told_apart_by_their_kind():
    """A file road-nn is not taken for one's own nn, nor one's own for ours."""
    costs = {"best constant": np.full(8, 1.0), "road-nn": np.full(8, 0.5), "mine": np.full(8, 0.8)}
    roles = {"best constant": Role(adapts=False, kind="best constant"), "road-nn": Role(kind="nn"), "mine": Role()}
    driven = {name: {"cost": each, "failed": np.zeros(8)} for name, each in costs.items()}
    made = Comparison.of_runs(driven, "best constant", roles=roles)
    said = standing(made, rows_of(made), "drive")
    assert "road-nn is best" in said
    about = comparison_result(**NOTHING | {"drives": {"exact": made}}).values["drives"]
    assert [name for name, _ in about["meanings"]] == [NAMES["best constant"][0], "road-nn"]
    assert {row["contender"]: row["kind"] for row in made.rows()} == {name: role.kind for name, role in roles.items()}
