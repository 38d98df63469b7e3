"""The first line of a comparison's command: true, chosen by the numbers, and never more sure than its interval."""

from __future__ import annotations

import numpy as np
import pytest

from adaptrack.comparison.table import Comparison, Role
from adaptrack.results import comparison_answers as answers


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
