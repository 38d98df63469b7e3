"""The first line of a comparison's command: true, chosen by the numbers, and never more sure than its interval."""

from __future__ import annotations

import numpy as np
import pytest

from adaptrack.comparison.statistics import Ratio
from adaptrack.comparison.table import Comparison
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
