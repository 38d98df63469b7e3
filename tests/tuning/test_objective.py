"""The cost of a tuning, and whole swarms on it: compiled, and equal to what the slow ways give."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.pso import SearchSpace, SwarmSettings, minimise

pytestmark = pytest.mark.compiled
CAR = at.load_vehicle("paper")
HERE = (12.0, 2.0, 0.8, 10.0)


def objective(**changes):
    options = {"duration": 2.0, **changes}
    road = options.get("profile") == "road"
    mpc = at.published_mpc(CAR, period=0.05 if road else 0.1, preview=road)
    return Objective(at.DualTrack(CAR, "magic-formula"), mpc, **options)


@pytest.mark.parametrize(
    "changes",
    [{}, {"profile": "road", "test": "lane-change", "noise_seeds": (3, 4), "duration": 4.0}, {"move_weight": 2.0}],
    ids=["paper", "road", "weighed"],
)
def test_the_cost_is_that_of_simulated_runs(changes):
    """Mean over the noise seeds of mean e^2 + weight * mean (change of command)^2."""
    target = objective(**changes)
    tunings = [(30, 5, 1.0, 300.0), (20, 3, 1.0, 2000.0)]
    costs = target.costs(HERE, tunings)
    for tuning, cost in zip(tunings, costs, strict=True):
        Np, Nc, Q, R = tuning
        runs = [
            at.simulate(
                target.plant,
                at.published_mpc(CAR, at.Tuning(Np, Nc, Q, R), period=target.mpc.period, preview=target.mpc.preview),
                target.scenario(HERE),
                profile=target.profile,
                seed=seed,
            )
            for seed in target.noise_seeds
        ]
        expected = np.mean([np.mean(r.error**2) + target.weight * np.mean(r.command_change**2) for r in runs])
        assert cost == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("particles", [5, 20, 33, 70])
def test_the_compiled_swarm_is_the_ask_and_tell_swarm_on_the_same_costs(particles):
    """Also when there are more particles than slots, and although hopeless runs are stopped early."""
    target, space = objective(), SearchSpace.tuning()
    settings = SwarmSettings(particles=particles, generations=4)
    compiled = target.tune(HERE, settings, seed=5, stream=7)
    slow = minimise(lambda x: target.costs(HERE, x), space, settings, seed=5, stream=7)
    np.testing.assert_array_equal(compiled.tuning, slow.x)
    np.testing.assert_array_equal(compiled.trace, slow.trace)
    assert compiled.cost == slow.cost
    assert compiled.evaluations == slow.evaluations == 4 * particles
    assert compiled.control_steps < 20 * compiled.evaluations  # some runs were stopped


def test_the_cost_of_a_tuning_does_not_depend_on_its_company():
    target, rng = objective(), np.random.default_rng(0)
    tunings = np.column_stack([rng.integers(20, 56, 50), rng.integers(1, 19, 50), np.ones(50), rng.uniform(1, 900, 50)])
    together = target.costs(HERE, tunings)
    np.testing.assert_array_equal(together, [target.costs(HERE, tuning)[0] for tuning in tunings])
    order = rng.permutation(50)
    np.testing.assert_array_equal(together[order], target.costs(HERE, tunings[order]))


def test_by_decades_the_swarm_reaches_weights_that_a_linear_search_hardly_draws():
    box = {"names": ("Np", "Nc", "Q", "R"), "low": (5.0, 1.0, 1.0, 1e-3), "high": (55.0, 18.0, 1.0, 1e6)}
    space = SearchSpace(**box, integers=("Np", "Nc"), ordered=("Nc", "Np"), decades=("R",))
    result = objective(profile="road", test="lane-change", duration=4.0).tune(HERE, seed=1, space=space)
    assert 10.0 < result.tuning[3] < 1e5
    assert result.cost == pytest.approx(result.trace[-1])


def test_a_run_that_fails_costs_infinity_by_the_rule_in_use():
    step = (12.0, 2.0, 0.8, 0.0)
    tuning = [(30, 5, 1.0, 300.0)]
    assert np.isfinite(objective().costs(step, tuning)).all()
    assert np.isinf(objective(failure=at.FailureLimits(sideslip=1e-3)).costs(step, tuning)).all()
    assert np.isinf(objective(failure=at.FailureLimits(distance=1e-6)).costs(step, tuning)).all()


@pytest.mark.parametrize("changes", [{"test": "slalom"}, {"noise_seeds": ()}, {"profile": "rode"}], ids=str)
def test_a_wrong_option_is_refused(changes):
    with pytest.raises(at.InvalidInput):
        objective(**changes)
