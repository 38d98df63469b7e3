"""What can be held at all: infeasible speeds and frictions are named, and the largest domain is found."""

import json
from itertools import product

import numpy as np
import pytest

from adaptrack import MPC, DualTrack, InvalidInput, load_vehicle, published_mpc
from adaptrack.analysis.certify import certify
from adaptrack.analysis.feasibility import feasibility, largest_box
from adaptrack.analysis.linearisation import Mismatch, laws, linear_plants, sampled
from adaptrack.analysis.stability import hard_turn, modulus_margin
from adaptrack.scenario.profile import load_profile

pytestmark = pytest.mark.compiled
SEDAN = load_vehicle("midsize-sedan")
PLANT, PUBLISHED, INFORMED = DualTrack(SEDAN), published_mpc(SEDAN, period=0.05), MPC(SEDAN, profile="road")
FEW = ((20.0, 60.0), (1.0, 4.0), (2.0, 4.0, 5.0))
"""Np, Nc, log10 R/Q of a quick search."""


def every_box(ok):
    """All boxes in which one layer is true throughout, by how many entries they have."""
    rows, columns, layers = ok.shape
    for top, bottom in product(range(rows), range(rows)):
        for left, right in product(range(columns), range(columns)):
            for layer in range(layers):
                part = ok[top : bottom + 1, left : right + 1, layer]
                if part.size and part.all():
                    yield part.size


@pytest.mark.parametrize("seed", range(12))
def test_the_largest_box_is_that_of_looking_at_all(seed):
    rng = np.random.default_rng(seed)
    ok = rng.uniform(size=(6, 4, 3)) < rng.uniform(0.2, 0.95)
    box = largest_box(ok)
    if box is None:
        assert not ok.any()
        return
    assert ok[box].all(axis=(0, 1)).any()
    assert ok[box][:, :, 0].size == max(every_box(ok))


@pytest.fixture(scope="module")
def demanding():
    """The published controller on the sedan, with a margin that it cannot have at high speed."""
    return feasibility(PLANT, PUBLISHED, "road", margin=0.3, nodes=FEW)


def test_margins_are_the_worse_of_straight_and_turn_of_each_tuning(demanding):
    rng = np.random.default_rng(1)
    for _ in range(6):
        i, j, n = (int(rng.integers(size)) for size in demanding.margins.shape)
        v, mu = float(demanding.speeds[i]), float(demanding.frictions[j])
        law = laws(PUBLISHED, v, demanding.tunings[n])
        straight, turn = (
            modulus_margin(sampled(PLANT, 0.05, v, friction=mu, profile="road", lateral_acceleration=a), law)[0]
            for a in (0.0, hard_turn(v, mu))
        )
        assert demanding.margins[i, j, n] == pytest.approx(min(straight, turn), abs=0.01)


def test_what_no_tuning_holds_is_named_and_the_rest_is_held(demanding):
    is_held = demanding.is_feasible
    assert not demanding.passed
    assert len(demanding.infeasible) == (~is_held).sum() > 0
    assert demanding.infeasible[-1][0] == 30.0
    np.testing.assert_array_equal(is_held, (demanding.margins >= 0.3).any(axis=2))
    words = demanding.verdict
    assert words.startswith(
        f"Infeasible: no tuning holds the loop with a modulus margin of 0.3 at {(~is_held).sum()} of "
    )
    assert "to 30 m/s on friction 0.3" in words
    assert f"The largest domain that can be held is {demanding.domain}." in words
    (slow, fast), (low, high) = demanding.domain
    inside = (demanding.speeds >= slow) & (demanding.speeds <= fast)
    across = (demanding.frictions >= low) & (demanding.frictions <= high)
    assert is_held[np.ix_(inside, across)].all()
    assert fast < 30.0


def test_the_largest_domain_of_one_constant_is_certified_with_that_constant(demanding):
    tuning, domain = demanding.constant
    again = certify(tuning, PLANT, PUBLISHED, "road", domain=domain._asdict(), levels=(6, 2))
    worst = again.counted.straight.worst(again.counted.turn)
    assert again.passed
    assert worst.modulus_margin.min() >= 0.28  # between the nodes of the search
    assert domain.speed[1] <= demanding.domain.speed[1]


def test_the_published_controller_has_no_constant_for_the_whole_road_domain_of_the_sedan_and_the_informed_one_has():
    """0 of 910 constants passed in an adaptation for the sedan; a schedule could hold it."""
    published, informed = (feasibility(PLANT, mpc, "road", turn=None) for mpc in (PUBLISHED, INFORMED))
    assert published.passed
    assert published.constant[1] != published.requested
    assert "holds no more than 3.75 to 30 m/s" in published.verdict
    assert informed.passed
    assert informed.constant[1] == informed.requested
    assert informed.verdict.endswith("holds all of it.")


def test_a_car_that_no_tuning_can_hold_has_no_domain():
    slow = load_profile("road")
    slow = slow.replace(steering=slow.steering.replace(lag=3.0))
    result = feasibility(PLANT, PUBLISHED, slow, speed=(25.0, 28.0), friction=(0.5, 0.5), nodes=FEW)
    assert result.domain is None
    assert result.constant is None
    assert result.verdict.startswith(
        "Infeasible: no tuning holds the loop with a modulus margin of 0.1 at any point of"
    )
    json.dumps(result.summary(), allow_nan=False)


def test_mismatches_count_as_further_cars():
    late = Mismatch(lag=0.1)
    options = {"speed": (20.0, 22.0), "friction": (0.6, 0.6), "nodes": ((30.0,), (10.0,), (0.5,)), "turn": None}
    alone, both = (
        feasibility(PLANT, INFORMED, "road", mismatches=mismatches, **options) for mismatches in ((), (late,))
    )
    law = laws(INFORMED, 22.0, alone.tunings)
    by = [modulus_margin(plant(22.0, 0.6), law)[0] for plant in linear_plants(PLANT, 0.05, "road", None, [late])]
    assert alone.margins[-1, 0, 0] == pytest.approx(by[0], abs=0.01)
    assert both.margins[-1, 0, 0] == pytest.approx(min(by), abs=0.01)


@pytest.mark.parametrize(("options", "words"), [
    ({"speed": (9.0, 5.0)}, "speed = .9.0, 5.0.: must be .* low <= high"),
    ({"friction": (0.0, 1.0)}, "friction.0. = 0.0: must be a finite number > 0"),
    ({"speed": (5.0, 1e300)}, "at most 100 m/s"),
    ({"margin": 1.0}, "margin = 1"),
    ({"nodes": ((70.0,), (5.0,), (3.0,))}, "no tuning"),
    ({"nodes": ((5.0,), (8.0,), (3.0,))}, "no tuning"),
])  # fmt: skip
def test_what_makes_no_sense_is_refused(options, words):
    with pytest.raises(InvalidInput, match=words):
        feasibility(PLANT, PUBLISHED, "road", **options)
