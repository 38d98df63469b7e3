"""Surfaces that take a step of a weighted regression."""

from dataclasses import replace

import numpy as np
import pytest

from adaptrack.control.scheduling import Number
from adaptrack.paper import surfaces as module
from adaptrack.paper.surfaces import FuzzySurface, NetworkSurface
from small_models import Level, random_network

DOMAIN = np.array([[3.0, 30.0], [0.3, 1.0]])


def examples(n=400, seed=0):
    """Inputs, a smooth target and uneven weights."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(*DOMAIN.T, (n, 2))
    return x, 20.0 + 0.5 * x[:, 0] + 6.0 * np.sin(4.0 * x[:, 1]), rng.uniform(0.1, 3.0, n)


def weighted_error(surface, x, target, weight):
    return float(np.average((surface.predict(x) - target) ** 2, weights=weight))


def every_surface(x):
    return {
        "level": Level(25.0),
        "network": NetworkSurface.start(DOMAIN, 25.0, 10.0, seed=3),
        "fuzzy": FuzzySurface.start(x, 25.0, rules=6, seed=3),
    }


# -- surfaces ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["level", "network", "fuzzy"])
def test_a_surface_begins_with_one_value_everywhere_and_is_what_it_runs_as(kind, rng):
    x, target, weight = examples()
    start = every_surface(x)[kind]
    np.testing.assert_allclose(start.predict(x), 25.0, rtol=1e-13)
    learned = start.fit(x, target, weight)
    np.testing.assert_array_equal(learned.predict(x), learned.function().predict(x))
    np.testing.assert_allclose(start.predict(x), 25.0, rtol=1e-13, err_msg="the one it began with is left alone")


@pytest.mark.parametrize("kind", ["level", "network", "fuzzy"])
def test_a_fit_lowers_the_weighted_error_and_more_effort_lowers_it_more(kind):
    x, target, weight = examples()
    start = every_surface(x)[kind]
    fits = start.fit(x, target, weight), start.fit(x, target, weight, effort=0.2), start
    most, lazy, before = (weighted_error(surface, x, target, weight) for surface in fits)
    assert most <= lazy < before
    assert kind == "level" or most < lazy


@pytest.mark.parametrize("kind", ["level", "network", "fuzzy"])
def test_only_the_ratio_of_the_weights_matters_and_a_row_of_none_does_not(kind):
    x, target, weight = examples()
    start, none = every_surface(x)[kind], np.arange(len(x)) % 3 == 0
    scaled = start.fit(x, target, 1e-4 * weight)
    np.testing.assert_allclose(scaled.predict(x), start.fit(x, target, weight).predict(x), rtol=1e-9)
    ignored = start.fit(x, np.where(none, 1e3, target), np.where(none, 0.0, weight))
    shorter = start.fit(x[~none], target[~none], weight[~none])
    np.testing.assert_allclose(ignored.predict(x), shorter.predict(x), rtol=1e-9)


def test_a_level_fits_the_weighted_mean():
    level = Level(3.0).fit(np.zeros((3, 1)), np.array([1.0, 2.0, 10.0]), np.array([1.0, 1.0, 2.0]))
    assert level.value == pytest.approx(23.0 / 4.0)
    assert level.function() == Number(level.value)


def test_a_networks_gradient_is_that_of_finite_differences(rng):
    network = random_network(rng, 3, relu=False)
    network = replace(network, weights=tuple(0.5 * array for array in network.weights))
    z, y, share = rng.uniform(size=(30, 3)), rng.normal(size=30), rng.dirichlet(np.ones(30))
    network = replace(network, low=np.zeros(3), high=np.ones(3), out_low=0.0, out_high=1.0)
    parameters = [array.copy() for pair in zip(network.weights, network.biases, strict=True) for array in pair]

    def error():
        changed = replace(network, weights=tuple(parameters[::2]), biases=tuple(parameters[1::2]))
        return 0.5 * (share * (changed.predict(z) - y) ** 2).sum()

    gradients = module._gradients(parameters, z, y, share)
    for parameter, gradient in zip(parameters, gradients, strict=True):
        assert gradient.shape == parameter.shape
        for place in np.ndindex(parameter.shape):
            value, errors = parameter[place], []
            for step in (1e-5, -1e-5):
                parameter[place] = value + step
                errors.append(error())
            parameter[place] = value
            assert gradient[place] == pytest.approx((errors[0] - errors[1]) / 2e-5, rel=1e-5, abs=1e-9)


def test_a_network_learns_what_its_inputs_say():
    x, target, weight = examples()
    surface = NetworkSurface.start(DOMAIN, 25.0, 10.0, seed=1)
    for _ in range(20):
        surface = surface.fit(x, target, weight)
    assert weighted_error(surface, x, target, weight) < 0.01 * np.average((target - np.average(target)) ** 2)


def test_a_fuzzy_fit_is_the_weighted_ridge_solution():
    """Of the change of the consequents, measured in half ranges: sum share (a c - error)^2 + hold |c|^2."""
    x, target, weight = examples()
    start = replace(FuzzySurface.start(x, 25.0, rules=6, seed=3), hold=0.05)
    for effort in (1.0, 0.3):
        learned = start.fit(x, target, weight, effort)
        extended = np.column_stack((x / start.scale, np.ones(len(x))))
        a = np.einsum("nr,nd->nrd", start.system.strengths(x), extended).reshape(len(x), -1)
        root = np.sqrt(weight / weight.sum())
        hold = 0.05 / effort * ((root[:, None] * a) ** 2).sum() / a.shape[1]
        stacked = np.vstack((root[:, None] * a, np.sqrt(hold) * np.eye(a.shape[1])))
        expected = np.linalg.lstsq(stacked, np.concatenate((root * (target - 25.0), np.zeros(a.shape[1]))), rcond=None)[
            0
        ]
        change = learned.system.consequents - start.system.consequents
        np.testing.assert_allclose(change * [*start.scale, 1.0], expected.reshape(change.shape), rtol=1e-6, atol=1e-8)
        assert learned.system.premises is start.system.premises


def test_rules_lie_where_the_inputs_do_and_none_is_idle():
    x, _, _ = examples()
    for rules in (1, 2, 8):
        system = FuzzySurface.start(x, 25.0, rules, seed=0).system
        assert system.n_rules == rules
        centres = system.premises[:, 2].reshape(rules, 2)
        assert ((centres >= x.min(axis=0)) & (centres <= x.max(axis=0))).all()
        assert system.mass(x).min() > 0.2 / rules


@pytest.mark.parametrize("kind", ["level", "network", "fuzzy"])
def test_an_average_has_the_mean_of_the_parameters_and_of_one_alone_it_is_itself(kind):
    x, target, weight = examples()
    first = every_surface(x)[kind]
    fits = [first, first.fit(x, target, weight), first.fit(x, -target, weight)]
    mean = fits[0].average(fits[1:])
    if kind != "network":  # those are linear in their parameters
        np.testing.assert_allclose(mean.predict(x), np.mean([fit.predict(x) for fit in fits], axis=0), atol=1e-12)
    else:
        for layers in zip(*([*fit.network.weights, *fit.network.biases] for fit in (mean, *fits)), strict=True):
            np.testing.assert_allclose(layers[0], np.mean(layers[1:], axis=0))
    np.testing.assert_array_equal(first.average([]).predict(x), first.predict(x))
