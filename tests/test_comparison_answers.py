"""The first line of a comparison's command: true, chosen by the numbers, and never more sure than its interval."""

from __future__ import annotations

import numpy as np
import pytest

from adaptrack.base.statistics import Ratio
from adaptrack.comparison.table import Comparison, Role
from adaptrack.results import comparison_answers as answers

OF_TUNING = [
    (Ratio(0.94, 0.92, 0.96), True, ["6.0 % less than its default", "0.920 to 0.960"], ["not sure", "keep"]),
    (Ratio(0.94, 0.88, 1.01), True, ["6.0 % less", "not sure"], []),
    (Ratio(1.2, 1.1, 1.3), True, ["20 % more", "keep the default"], ["not sure"]),
    (Ratio(1.0, 1.0, 1.0), False, ["nothing better than the default of lqr"], ["%"]),
]


@pytest.mark.parametrize(("ratio", "better", "said", "unsaid"), OF_TUNING)
def test_a_tuning_is_called_better_only_where_its_interval_says_so(ratio, better, said, unsaid):
    answer = answers.of_tuning("lqr", ratio, better)
    assert all(words in answer for words in said)
    assert not any(words in answer for words in unsaid)


def drives(schedule: float, spread: float, runs: int = 400) -> Comparison:
    """A constant, a schedule and the same without its guard, which cost so many times the constant, give or take."""
    rng = np.random.default_rng(3)
    base = rng.uniform(1e-3, 1e-2, runs)
    costs = {"best constant": base, "nn": base * schedule * rng.lognormal(0.0, spread, runs)}
    costs["nn unguarded"] = 0.9 * costs["nn"]
    roles = {name: Role("informed", adapts=name != "best constant", kind=name) for name in costs}
    driven = {name: {"cost": each, "failed": np.zeros(runs)} for name, each in costs.items()}
    return Comparison.of_runs(driven, "best constant", roles=roles)


@pytest.mark.parametrize(
    ("schedule", "spread", "words"),
    [
        (0.8, 0.05, ": worth it."),
        (0.99, 0.01, ": not worth it."),
        (1.0, 0.3, "level, not worth it"),
        (1.3, 0.1, "more"),
    ],
)
def test_a_schedule_is_worth_it_when_it_saves_enough_for_sure(schedule, spread, words):
    made = drives(schedule, spread)
    assert answers.best_schedule(made) == "nn", "the one without its guard is not deployed"
    assert words in answers.of_schedules(made, "drive")


def test_schedules_of_another_controller_are_no_answer_to_whether_a_schedule_pays():
    made = drives(1.1, 0.01)
    roles = {**made.roles, "nn": Role("scheduled MPC (pulse)", kind="nn")}
    other = Comparison.of_runs(
        {name: {"cost": made.costs[name], "failed": np.zeros(400)} for name in made.contenders}, "best constant",
        roles=roles,
    )  # fmt: skip
    assert answers.best_schedule(other) is None


def table(errors: dict[tuple[str, str], float], costs: dict[tuple[str, str], float]) -> Comparison:
    """Two contenders on 3 cars and 4 roads whose errors and costs are everywhere alike."""
    rows = [(*who, f"car {i}", f"road {j}") for who in errors for i in range(3) for j in range(4)]
    columns = dict(zip(("contender", "tuning", "car", "road"), np.array(rows).T, strict=True))
    columns |= {"seed": np.zeros(len(rows)), "failed": np.zeros(len(rows))}
    columns["cost"] = np.array([costs[row[:2]] for row in rows])
    error = np.array([errors[row[:2]] for row in rows])
    names = ("rms_error", "p95_error", "max_corner", "steering_rate", "acceleration", "jerk")
    return Comparison.of_columns(columns | dict.fromkeys(names, error))


def test_a_default_that_beats_its_tuning_is_said_with_the_reason():
    who = ("lqr", "default"), ("lqr", "tuned")
    errors = dict(zip(who, (0.01, 0.012), strict=True))
    for cost, reason in ((0.9, "sought for J, which is 10 % less"), (1.1, "too few roads or closed loops")):
        (said,) = answers.worse_tuned(table(errors, dict(zip(who, (1.0, cost), strict=True))))
        assert "lqr, tuned, has 1.20 times the error of its default" in said
        assert reason in said
    assert answers.worse_tuned(table(dict.fromkeys(who, 0.01), dict.fromkeys(who, 1.0))) == []


def test_the_answer_on_cars_names_who_is_first_and_the_best_behind():
    who = ("informed", "default"), ("lqr", "default")
    answer = answers.on_cars("road", table(dict(zip(who, (0.01, 0.02), strict=True)), dict.fromkeys(who, 1.0)))
    assert "informed, default is first in the RMS error (1 cm)" in answer
    assert "best behind: lqr, default, 2.00 times the error of informed, default" in answer
    assert answer.endswith("No run failed.")
