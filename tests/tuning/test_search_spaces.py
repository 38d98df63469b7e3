"""Where the constant of a controller is sought: around its own tuning, and nowhere that makes no controller."""

from __future__ import annotations

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.controllers.laws import WEIGHT_FACTORS
from adaptrack.tuning.constant import swarm_within
from adaptrack.tuning.pso import Swarm, at_bounds, search_space

CAR = at.load_vehicle("midsize-sedan")
LAWS = [law(CAR, preview=True) for law in (at.LQR, at.KinematicMPC, at.PreviewLQR, at.PurePursuit, at.Stanley)]


@pytest.mark.parametrize("profile", ["paper", "road", "production"])
def test_the_informed_controllers_own_constant_lies_in_its_space_at_any_period(profile):
    for period, preview in ((0.1, False), (0.05, True), (0.01, False)):
        mpc = at.MPC(CAR, profile=at.load_profile(profile), period=period, preview=preview)
        assert search_space(mpc).contains(mpc.packed_tuning())


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.name)
def test_a_laws_own_tuning_lies_in_its_space_and_every_tuning_there_makes_one(law):
    space = search_space(law)
    assert space.names == law.tuning_names
    assert space.contains(law.packed_tuning())
    for row in Swarm(space, seed=3).ask()[:6]:
        entries = dict(zip(space.names, row.tolist(), strict=True))
        np.testing.assert_array_equal(
            law.with_tuning(entries).parameters(), type(law)(CAR, preview=True, **entries).parameters()
        )


def test_the_lqrs_space_ends_where_its_table_of_gains_ends():
    law, names = LAWS[0], list(LAWS[0].tuning_names)
    space = search_space(law)
    for name in ("q_e", "q_heading"):
        ends = np.array([space.low[names.index(name)], space.high[names.index(name)]]) / law.tuning[name]
        np.testing.assert_allclose(ends, WEIGHT_FACTORS[[0, -1]])
    assert space.low[names.index("r")] == space.high[names.index("r")] == law.tuning["r"]


def test_an_entry_at_an_end_of_its_range_is_named_and_a_fixed_one_is_not():
    law = LAWS[0]
    space, row = search_space(law), law.packed_tuning()
    assert at_bounds(space, row) == []  # r is fixed
    row[list(space.names).index("q_heading")] = 1e4 * (1.0 + 1e-13)
    assert at_bounds(space, row) == ["q_heading"]


@pytest.mark.parametrize("law", [*LAWS, at.MPC(CAR, profile="road")], ids=lambda law: law.name)
def test_a_controller_with_another_tuning_is_one_of_its_own_and_refuses_what_it_does_not_have(law):
    first, before = law.tuning_names[0], law.packed_tuning().copy()
    changed = law.with_tuning({first: 20.0})
    assert changed.packed_tuning().tolist() == [20.0, *before[1:]]
    np.testing.assert_array_equal(law.packed_tuning(), before)
    with pytest.raises(at.InvalidInput, match=f"its entries are {first}"):
        law.with_tuning({"bias": 1.0})
    with pytest.raises(at.InvalidInput):
        law.with_tuning({name: -1.0 for name in law.tuning_names})


def test_horizons_longer_than_an_mpc_was_made_for_make_a_larger_one():
    changed = at.MPC(CAR, profile="road").with_tuning({"Np": 80.0, "Nc": 24.0})
    assert (changed.tuning.Np, changed.tuning.Nc) == (80, 24)
    assert changed.longest_horizon == 80
    assert np.isfinite(changed.step([0.0] * 4, 15.0, [0.1]).angle)


def test_a_swarm_spends_no_more_runs_than_it_is_given():
    for runs in (80, 160, 1000, 2400, 2401):
        swarm = swarm_within(runs, 8)
        assert 10 <= swarm.evaluations <= runs / 8
    assert swarm_within(2400, 8).evaluations == 300
    with pytest.raises(at.InvalidInput, match="at least 80"):
        swarm_within(79, 8)


def test_a_controller_without_a_search_space_is_refused_with_the_attribute_to_set():
    class Unbounded(at.Controller):
        tuning_names, tuning = ("gain",), {"gain": 1.0}

        def step(self, *values, **options):
            return 0.0

    words = r"set `tuning_bounds` on its class, \(low, high\) for each name in `tuning`.*space=SearchSpace"
    with pytest.raises(at.InvalidInput, match=words):
        search_space(Unbounded())
    Unbounded.tuning_bounds = {"gain": (0.1, 10.0)}
    assert search_space(Unbounded()).high == (10.0,)
