"""What the network and the neuro-fuzzy regressor have in common as estimators."""

import numpy as np
import pytest
from sklearn.base import clone
from sklearn.utils.estimator_checks import check_estimator

from adaptrack.base.errors import InvalidInput
from adaptrack.paper import ANFIS, MLP

QUICK = {"epochs": 60, "batch_size": 20}


def data(n=150, inputs=2, seed=0):
    x = np.random.default_rng(seed).uniform(-3.0, 3.0, (n, inputs))
    return x, 20.0 + 5.0 * np.sin(x[:, 0]) + x[:, 1] * np.tanh(x[:, -1])


@pytest.mark.parametrize("estimator", [
    ANFIS(epochs=3),
    ANFIS("grid", n_mfs=1, membership="bell", epochs=3),
    pytest.param(MLP(epochs=600), marks=pytest.mark.slow),
    pytest.param(MLP(epochs=80, batch_size=20), marks=pytest.mark.slow),
    MLP(solver="lbfgs", epochs=60),
    MLP(epochs=12, batch_size=20, solver="adam", learning_rate=0.03, early_stopping=True),
])  # fmt: skip
def test_it_is_a_scikit_learn_estimator(estimator):
    batches = "batches and held-out rows are drawn from the rows, whatever their weights"
    is_drawn = isinstance(estimator, MLP) and estimator.batch_size is not None
    failures = {"check_sample_weight_equivalence_on_dense_data": batches} if is_drawn else {}
    check_estimator(estimator, on_skip=None, expected_failed_checks=failures)


@pytest.mark.parametrize("estimator", [
    ANFIS(epochs=8), ANFIS("grid", epochs=8), ANFIS(prune=0.02, epochs=8),
    MLP((6,), epochs=40, random_state=1),
])  # fmt: skip
def test_a_weight_says_how_often_a_row_counts(estimator, rng):
    x, often = rng.uniform(size=(80, 2)), rng.integers(0, 4, 80)
    y = np.sin(4.0 * x[:, 0]) + 0.1 * rng.normal(size=80)
    repeated = clone(estimator).fit(x.repeat(often, axis=0), y.repeat(often))
    weighted = clone(estimator).fit(x, y, sample_weight=often)
    assert weighted.predict(x) == pytest.approx(repeated.predict(x), rel=1e-6, abs=1e-6)
    assert weighted.history_["train_rmse"] == pytest.approx(repeated.history_["train_rmse"], rel=1e-6)
    for weights, words in ((np.zeros(80), "all are zero"), (-np.ones(80), "weight is negative")):
        with pytest.raises(InvalidInput, match=words):
            clone(estimator).fit(x, y, sample_weight=weights)


@pytest.mark.parametrize("estimator", [ANFIS(epochs=5), ANFIS("grid", epochs=5), MLP(**QUICK, random_state=0)])
def test_the_unit_of_the_inputs_and_of_the_target_does_not_matter(estimator):
    (x, y), scale, shift = data(), np.array([1e3, 1e-2]), np.array([50.0, -3.0])
    first = clone(estimator).fit(x, y).predict(x)
    other = clone(estimator).fit(x * scale + shift, 40.0 * y - 9.0).predict(x * scale + shift)
    np.testing.assert_allclose((other + 9.0) / 40.0, first, rtol=0, atol=1e-5)


@pytest.mark.parametrize("estimator", [
    ANFIS(epochs=5, early_stopping=True),
    *(MLP(**QUICK, solver=solver, early_stopping=True) for solver in ("momentum", "adam", "lbfgs")),
])  # fmt: skip
def test_the_same_seed_gives_the_same_bits(estimator):
    fits = (clone(estimator).set_params(random_state=seed).fit(*data()) for seed in (3, 3, 4))
    first, again, other = (fit.predict(data()[0]) for fit in fits)
    np.testing.assert_array_equal(first, again)
    assert (first != other).any()


@pytest.mark.parametrize(("kind", "options", "name"), [
    *((ANFIS, options, list(options)[-1]) for options in (
        {"partition": "tree"}, {"membership": "triangle"}, {"epochs": -1}, {"epochs": 1.5},
        {"step": 0.0}, {"ridge": 0.0}, {"prune": 1.0},
        {"influence": 0.0}, {"reject": 0.9}, {"partition": "grid", "n_mfs": (2, 2, 2)},
        {"partition": "grid", "n_mfs": 0}, {"early_stopping": True, "validation_fraction": 0.999},
    )),
    (ANFIS, {"partition": "grid", "n_mfs": 300}, "300 x 300"),
    *((MLP, options, rf"MLP: {list(options)[-1]}(\[.\])? = ") for options in (
        {"hidden": ()}, {"hidden": (16, 0)}, {"hidden": (8.5,)}, {"hidden": 16}, {"solver": "sgd"},
        {"learning_rate": 0.0}, {"learning_rate": "fast"}, {"batch_size": 0}, {"epochs": 0}, {"epochs": 1.5},
        {"validation_fraction": 1.0}, {"patience": 0}, {"early_stopping": True, "validation_fraction": 0.999},
    )),
])  # fmt: skip
def test_a_parameter_that_is_not_allowed_is_named(kind, options, name):
    with pytest.raises(InvalidInput, match=name):
        kind(**options).fit(*data(30))
