"""The ceiling of what can be learned is a strong learner's, shown no row that it predicts."""

import numpy as np
import pytest

from adaptrack.base.errors import InvalidInput
from adaptrack.learning import boosting
from adaptrack.learning.boosting import cross_validate, explained, explained_shares
from adaptrack.paper.data_set_summary import TARGETS
from adaptrack.paper.operating_points import sobol
from test_dataset import BOX, wild


def test_what_the_conditions_decide_is_explained_and_what_chance_decides_is_not(rng):
    n = 1500
    rows = sobol(n, BOX, 4)
    speed, y_ref, _, wind = rows.T
    tunings = np.column_stack(
        [
            np.round(5 + speed),  # all in the speed
            rng.integers(1, 5, n),  # chance
            np.exp(np.sin(y_ref * wind / 60) + rng.normal(size=n) * np.sqrt(0.5)),  # symmetric, and half of it chance
            np.full(n, 0.01),  # constant
        ]
    )
    data = wild(n, operating_points=rows, tunings=tunings)
    r2 = {target: explained(data, target).r2 for target in TARGETS}
    signal = np.var(np.sin(y_ref * wind / 60))
    assert r2["Np"] > 0.99
    assert 0.0 <= r2["Nc"] < 0.02
    assert r2["log R"] == 0.0
    assert r2["log Q"] == pytest.approx(signal / (signal + 0.5), abs=0.12)
    assert r2["log R/Q"] == pytest.approx(r2["log Q"], abs=0.01)  # R is constant


@pytest.mark.slow
def test_the_learner_is_as_strong_as_a_random_forest(rng):
    sklearn = pytest.importorskip("sklearn.ensemble")
    from sklearn.model_selection import KFold, cross_val_predict

    x = sobol(1500, BOX, 2)
    speed, y_ref, friction, wind = x.T
    forest = sklearn.RandomForestRegressor(50, min_samples_leaf=5, random_state=0)
    for target in (
        np.sin(speed / 5) + friction * y_ref / 10 + 0.1 * rng.normal(size=1500),
        (speed > 12) + (y_ref > 5) * (friction < 0.6) + 0.3 * np.sign(wind) + 0.5 * rng.normal(size=1500),
    ):
        guess = cross_val_predict(forest, x, target, cv=KFold(5, shuffle=True, random_state=0))
        theirs = 1.0 - np.sum((target - guess) ** 2) / np.sum((target - target.mean()) ** 2)
        assert cross_validate(x, target).r2 > theirs - 0.01


def test_nothing_is_learnt_from_the_rows_that_are_predicted(rng):
    # Each row has its own noise; a learner that saw it would explain it.
    x = rng.random((400, 4))
    noise = rng.normal(size=400)
    result = cross_validate(x, noise)
    assert result.r2 < 0.02
    doubled = cross_validate(np.vstack([x, x]), np.concatenate([noise, noise]))  # what twins in two folds would do
    assert doubled.r2 > 0.3


def test_too_few_rows_and_unknown_targets_are_refused():
    with pytest.raises(InvalidInput, match="49 usable operating points are too few"):
        explained(wild(50), "Np")  # one of them lost the car
    with pytest.raises(InvalidInput, match=r"target = 'Q': must be one of 'Np', 'Nc', 'log Q'"):
        explained(wild(100), "Q")


def test_the_shares_are_those_of_every_target_and_none_of_too_few_rows(monkeypatch):
    monkeypatch.setattr(boosting, "TREES", 10)
    data = wild(100)
    assert explained_shares(data) == {target: explained(data, target).r2 for target in TARGETS}
    assert explained_shares(wild(50)) == {}
