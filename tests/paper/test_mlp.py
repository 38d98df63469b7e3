"""The network regressor: its forward pass, and what gradient descent does."""

import math
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

from adaptrack.base.errors import InvalidInput
from adaptrack.paper import MLP
from adaptrack.paper.regressor import held_out

QUICK = {"epochs": 60, "batch_size": 20}


def data(n=300, inputs=4, seed=0):
    x = np.random.default_rng(seed).uniform(-3.0, 3.0, (n, inputs))
    return x, 20.0 + 5.0 * np.sin(x[:, 0]) + x[:, 1] * np.tanh(x[:, -1])


def noisy(n=120):
    x, y = data(n)
    return x, y + np.random.default_rng(6).normal(0.0, 3.0, n)


def rmse(y, predicted):
    return np.sqrt(((predicted - y) ** 2).mean())


# -- the network ------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("relu", [True, False])
def test_the_forward_pass_is_the_papers_equations(relu):
    x, y = data(40)
    network = MLP(relu=relu, **QUICK, random_state=0).fit(x, y).network_
    network = replace(network, biases=(*network.biases[:-1], network.biases[-1] - 0.2))  # so that the ReLU bites
    assert [w.shape for w in network.weights] == [(4, 16), (16, 8), (8, 1)]
    expected = []
    for row in x:
        signal = [(row[i] - network.low[i]) / (network.high[i] - network.low[i]) for i in range(4)]
        for layer in range(3):
            w, b = network.weights[layer], network.biases[layer]
            sums = [sum(w[i, j] * signal[i] for i in range(len(signal))) + b[j] for j in range(len(b))]
            signal = [1.0 / (1.0 + math.exp(-s)) for s in sums] if layer < 2 else sums
        o = max(0.0, signal[0]) if relu else signal[0]
        expected.append(network.out_low + (network.out_high - network.out_low) * o)
    np.testing.assert_allclose(network.predict(x), expected, rtol=1e-12)
    assert (min(expected) == y.min()) == relu
    assert max(expected) > y.min()
    assert network.n_parameters == 4 * 16 + 16 + 16 * 8 + 8 + 8 + 1


def test_the_estimator_predicts_what_its_network_does():
    x, y = data()
    estimator = MLP(**QUICK, random_state=0).fit(x, y)
    np.testing.assert_array_equal(estimator.predict(x), estimator.network_.predict(x))
    assert estimator.predict(x).min() >= y.min(), "the ReLU stands at the least target"
    assert np.isfinite(estimator.predict(1e6 * x)).all()


def test_dead_outputs_are_counted():
    x = np.random.default_rng(0).uniform(-1.0, 1.0, (400, 1))
    y = np.maximum(0.0, x[:, 0])  # a linear output undershoots where the target is 0
    estimator = MLP((2,), epochs=100, random_state=0).fit(x, y)
    below = replace(estimator.network_, relu=False).predict(x) < 0.0
    assert 0.0 < below.mean() < 1.0
    assert estimator.dead_share_ == below.mean()
    assert (estimator.predict(x)[below] == 0.0).all()
    assert MLP((2,), epochs=100, random_state=0, relu=False).fit(x, y).dead_share_ == 0.0


# -- learning ---------------------------------------------------------------------------------------------------------
def test_the_papers_recipe_is_the_default():
    expected = {"hidden": (16, 8), "solver": "momentum", "epochs": 1000, "relu": True, "early_stopping": False}
    assert expected.items() <= MLP().get_params().items()
    learner = MLP()._learner(500, None)
    assert (learner.solver, learner.momentum, learner.nesterovs_momentum, learner.alpha) == ("sgd", 0.9, False, 0.0)
    assert (learner.activation, learner.loss) == ("logistic", "squared_error")


@pytest.mark.parametrize("solver", ["momentum", "adam", "lbfgs"])
def test_a_smooth_function_is_learned(solver):
    x, y = data(1500)
    epochs = 100 if solver == "adam" else 200
    estimator = MLP(solver=solver, epochs=epochs, batch_size=50, random_state=0).fit(x[:1000], y[:1000])
    assert estimator.score(x[1000:], y[1000:]) > 0.95


def test_a_constant_target_is_learned_exactly():
    x, _ = data(50)
    x[:, 1] = 4.0  # and an input that never changes does no harm
    estimator = MLP(**QUICK, random_state=0).fit(x, np.full(50, 7.0))
    assert (estimator.predict(x) == 7.0).all()
    assert estimator.dead_share_ == 0.0


def test_the_callers_threads_do_not_change_the_bits(rng):
    x, weights = rng.normal(size=(3000, 4)), []
    for threads in (1, 2):
        with threadpool_limits(threads):
            estimator = MLP(epochs=3, batch_size=3000, random_state=0).fit(x, x.sum(axis=1))
        weights.append([matrix.tobytes() for matrix in estimator.network_.weights])
    assert weights[0] == weights[1]


def test_early_stopping_keeps_the_epoch_that_is_best_on_the_hold_out():
    x, y = noisy()
    estimator = MLP(epochs=400, batch_size=20, early_stopping=True, patience=20, random_state=0).fit(x, y)
    errors = estimator.history_["validation_rmse"]
    assert estimator.best_epoch_ == errors.argmin() + 1
    assert estimator.n_iter_ == len(errors) == len(estimator.history_["train_rmse"]) == estimator.best_epoch_ + 20 < 400
    _, rows = held_out("MLP", len(y), estimator.validation_fraction, np.random.RandomState(0))
    assert len(rows) == 24
    assert rmse(y[rows], estimator.predict(x[rows])) == pytest.approx(errors.min(), rel=1e-12)


def test_training_that_diverges_says_so():
    with pytest.raises(InvalidInput, match=r"diverged after .* lower learning_rate"):
        MLP(learning_rate=1e9, epochs=500, random_state=0).fit(*data(50))
