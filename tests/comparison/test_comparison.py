"""Comparisons: their statistics, reference, best constant and contenders, and the seeds that they keep apart."""

import json
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.result import strict
from adaptrack.base.statistics import BOOTSTRAP_RESAMPLES
from adaptrack.comparison.compare import Contender, compare
from adaptrack.comparison.table import Comparison, ContenderRole
from adaptrack.core.scheduling import guard
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.runs import RunSet, operating_point_runs
from small_runs import CAR, HASTY, START, Rated, bowl, controller, lane_changes, run_set

FAILED_COST = RunSet.failure.distance**2


def compared(failures=None, **regrets):
    costs = {"optimum": np.full(len(next(iter(regrets.values()))), 0.02)}
    costs |= {name: 0.02 * np.array(values, dtype=float) for name, values in regrets.items()}
    failures = failures or {name: np.zeros(len(values)) for name, values in costs.items()}
    return Comparison.from_runs({name: {"cost": costs[name], "failed": failures[name]} for name in costs}, "optimum")


# -- the table --------------------------------------------------------------------------------------------------------
def test_known_regrets_give_their_geometric_mean_and_percentiles():
    reference, row = compared(nn=2.0 ** np.arange(11.0)[::-1]).rows()
    assert [reference["contender"], row["contender"]] == ["optimum", "nn"]
    expected = {"geomean": 5.0, "p50": 5.0, "p90": 9.0, "p99": 9.9, "worst": 10.0}
    for name, power in expected.items():
        assert reference[f"regret_{name}"] == 1.0
        assert row[f"regret_{name}"] == pytest.approx(2.0**power, rel=1e-12)
    assert row["cost_geomean"] == pytest.approx(0.02 * 2.0**5)
    assert row["runs"] == 11


def test_regret_is_taken_run_by_run():
    """Not as the ratio of two means: where one is better and where the other counts."""
    costs = {"a": np.array([1.0, 4.0]), "b": np.array([4.0, 1.0])}
    runs = {name: {"cost": values, "failed": np.zeros(2)} for name, values in costs.items()}
    _, row = Comparison.from_runs(runs, "a").rows()
    assert row["regret_geomean"] == pytest.approx(1.0)
    assert row["regret_worst"] == pytest.approx(4.0)


def test_all_ratios_share_their_resamples_so_that_the_other_way_round_is_the_reciprocal(rng):
    comparison = compared(nn=rng.uniform(1.0, 3.0, 50), anfis=rng.uniform(1.0, 3.0, 50))
    ratio, other = comparison.ratio("nn", "anfis"), comparison.ratio("anfis", "nn")
    assert (1.0 / other.mean, 1.0 / other.high, 1.0 / other.low) == pytest.approx(ratio, rel=1e-3)
    assert compared(nn=comparison.costs["nn"]).rows()[1] == compared(nn=comparison.costs["nn"]).rows()[1]
    assert BOOTSTRAP_RESAMPLES >= 1000


def test_a_run_that_fails_with_any_of_its_seeds_is_one_failure():
    failures = {"optimum": np.zeros(4), "nn": np.array([0.0, 0.125, 1.0, 0.0])}
    assert [row["failures"] for row in compared(failures, nn=[1.0, 2.0, 3.0, 4.0]).rows()] == [0, 2]


def test_the_rows_are_strict_json_with_none_for_what_is_no_number():
    rows = strict([*compared(nn=[1.0, 2.0]).rows(), {"contender": "x", "regret_worst": math.inf, "clipped": math.nan}])
    read = json.loads(json.dumps(rows, allow_nan=False))
    assert read[2] == {"contender": "x", "regret_worst": None, "clipped": None}
    assert {"contender", "regret_geomean", "regret_p90", "regret_worst", "failures"} <= set(read[1])


# -- comparing --------------------------------------------------------------------------------------------------------
def entered(**policies):
    return [Contender(name, policy) for name, policy in policies.items()]


def test_costs_and_failures_of_a_comparison_are_those_of_the_runs():
    rated = Rated(lambda row, run: math.inf if run < 2 and row[0] > 29 else row[0] * (1.0 + run))
    comparison = compare(rated, entered(a=START, b=HASTY), [5, 6], "a")
    np.testing.assert_allclose(comparison.costs["a"], 29.0 * (1.0 + np.arange(6)))
    np.testing.assert_allclose(comparison.costs["b"], [FAILED_COST, FAILED_COST, *(30.0 * (1.0 + np.arange(2, 6)))])
    assert comparison.failures["b"].tolist() == [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
    assert comparison.regret("a").tolist() == [1.0] * 6
    assert rated.seeds == {5, 6}
    assert not any(comparison.overall.values())


@pytest.mark.compiled
def test_a_comparison_over_real_runs_counts_what_fails_and_what_the_schedules_did():
    runs = run_set(lane_changes(8, 6.0))
    narrow = at.Learned({"Np": 29.0, "Nc": 5.0, "Q": 1.0, "R": 4000.0}, ("speed",), [[10.0, 18.0]])
    field = {"constant": START, "hasty": HASTY, "schedule": at.Constant(START), "narrow": narrow}
    field["guarded"] = at.Guarded(narrow, START)
    heard = []
    comparison = compare(runs, entered(**field), [3, 4], "constant", progress=lambda *report: heard.append(report))
    np.testing.assert_array_equal(comparison.costs["constant"], runs.costs(START, [3, 4]))
    for name in ("schedule", "narrow", "guarded"):
        np.testing.assert_array_equal(comparison.costs[name], comparison.costs["constant"])
    rows = {row["contender"]: row for row in comparison.rows()}
    failed = np.isinf(runs.drive(HASTY, [3, 4]))
    assert 0 < failed.any(axis=1).sum() == rows["hasty"]["failures"]
    np.testing.assert_array_equal(comparison.failures["hasty"], failed.mean(axis=1))
    assert rows["constant"]["regret_low"] == rows["constant"]["regret_high"] == 1.0
    outside = ((runs.variables[..., 0] < 10.0) | (runs.variables[..., 0] > 18.0)).mean()
    assert 0.2 < outside < 0.9
    assert rows["narrow"]["clipped"] == rows["guarded"]["clipped"] == pytest.approx(outside)
    assert rows["schedule"]["clipped"] == 0.0
    assert rows["guarded"]["fallback"] > 0.0
    assert set(comparison.overall["guarded"]) == set(guard.COUNTS) - {"steps"}
    assert heard == [(name, k, 5) for k, name in enumerate(field)]


@pytest.mark.compiled
def test_the_search_for_the_optimum_and_the_comparison_mean_the_same_cost(rng):
    points = rng.uniform((8.0, -4.0, 0.5, -20.0), (26.0, 4.0, 1.0, 20.0), (3, 4))
    searched = Objective(at.SingleTrack(CAR), controller(), "lane-change", "road", (3, 4), failure=RunSet.failure)
    runs = operating_point_runs(at.SingleTrack(CAR), controller(), points)
    for tuning in (START.as_array(), np.array([40.0, 9.0, 1.0, 2e4])):
        costs = [searched.costs(point, tuning)[0] for point in points]
        np.testing.assert_allclose(runs.costs(tuning, [3, 4]), costs, rtol=1e-12)


# -- one interval for tables and sentences ----------------------------------------------------------------------------
def test_the_interval_of_a_ratio_to_the_reference_is_that_of_the_row(rng):
    comparison = compared(nn=rng.uniform(1.0, 3.0, 50), anfis=rng.uniform(1.0, 3.0, 50))
    for row in comparison.rows():
        over = comparison.ratio(row["contender"], "optimum")
        assert (over.mean, over.low, over.high) == tuple(row[f"regret_{key}"] for key in ("geomean", "low", "high"))
    assert comparison.ratio("nn", "anfis").mean == pytest.approx(comparison.mean_ratio("nn", "anfis"))
    assert comparison.ratio("nn", "nn") == (1.0, 1.0, 1.0)


def test_a_verdict_is_level_while_the_interval_holds_one(rng):
    comparison = compared(nn=np.exp(0.5 * rng.normal(size=200)), cheap=np.full(200, 0.9), dear=np.full(200, 1.1))
    verdicts = [comparison.ratio(name, "optimum").verdict for name in ("nn", "cheap", "dear")]
    assert verdicts == ["level", "cheaper", "dearer"]


# -- contenders -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("call", "words"), [
    (lambda: compare(Rated(bowl()), entered(a=START, b=HASTY), [1], "optimum"), r"'optimum'.*a, b"),
    (lambda: compare(Rated(bowl()), [Contender("a", START), Contender("a", HASTY)], [1], "a"), "two have the same"),
    (lambda: at.register_controller("lqr", at.LQR), "register_controller"),
    (lambda: at.register_controller("", at.LQR), "register_controller"),
    (lambda: at.register_controller("mine", START), "register_controller"),
    (lambda: at.register_controller(3, None), "register_controller"),
    (lambda: Contender("mine", "nn"), "'mine'"),
    (lambda: Contender("mine", [1.0, 2.0]), "'mine'"),
    (lambda: Contender("mine", [[1.0, 2.0, 3.0, math.nan]]), "'mine'"),
    (lambda: Contender("mine", None), "'mine'"),
])  # fmt: skip
def test_what_makes_no_contender_and_no_comparison_is_refused(call, words):
    with pytest.raises(at.InvalidInput, match=words):
        call()


def test_who_adapts_is_told_from_the_policy():
    speed = at.Learned({"Np": 29.0, "Nc": 5.0, "Q": 1.0, "R": 4000.0}, ("speed",), [[10.0, 18.0]])
    assert not Contender("a", START).adapts
    assert not Contender("a", speed).adapts, "the same numbers everywhere"
    assert not Contender("a", controller()).adapts
    assert Contender("a", controller(scheduler=lambda variables: START)).adapts
    assert Contender("a", [[29, 5, 1, 4e3], [30, 5, 1, 4e3]]).adapts
    assert not Contender("a", [[29, 5, 1, 4e3], [30, 5, 1, 4e3]], hindsight=True).adapts
    assert not Contender("a", [29, 5, 1, 4e3]).adapts
    assert ContenderRole().adapts


# -- other controllers ------------------------------------------------------------------------------------------------
def proportional(situation, reference, road, tuning, parameters, memory, answer):
    """Steers by the offset and the yaw angle."""
    angle = tuning[0] * (reference[0] - situation[3]) - tuning[1] * situation[1]
    answer[0] = min(max(angle, parameters[3]), parameters[4])


def owned(runs):
    tuning = {"offset_gain": 0.02, "yaw_gain": 0.5}
    return at.UserController(proportional, tuning=tuning, period=runs.mpc.period, label="proportional")


NAMES = ("lqr", "pure-pursuit", "stanley")


@pytest.mark.compiled
def test_registered_controllers_and_a_compiled_one_of_ones_own_cost_what_simulate_says():
    runs = run_set(lane_changes(2, 3.0))
    laws = {name: at.get_controller(name, CAR, profile="road", optional={"period": runs.mpc.period}) for name in NAMES}
    entered = [Contender("standard", at.Tuning()), *(Contender(name, law) for name, law in laws.items())]
    entered.append(Contender("mine", owned(runs)))
    comparison = compare(runs, entered, [3, 4], "standard")
    for name, policy in ((contender.name, contender.policy) for contender in entered[1:]):
        costs = [
            [
                at.compute_metrics(at.simulate(runs.plant, policy, scenario, profile="road", seed=seed)).cost
                for seed in (3, 4)
            ]
            for scenario in runs.scenarios
        ]
        np.testing.assert_allclose(comparison.costs[name], np.mean(costs, axis=1), rtol=1e-9, err_msg=name)
    rows = {row["contender"]: row["controller"] for row in comparison.rows()}
    assert rows["mine"] == "proportional"
    assert len(set(rows.values())) == 5
