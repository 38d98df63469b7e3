"""From a car to a checked constant tuning."""

from __future__ import annotations

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.tuning.car import FIRST_SEARCH_DRIVE, FIRST_UNSEEN_DRIVE, TuningEffort
from adaptrack.tuning.pso import SwarmSettings

VAN = at.load_vehicle("van")
VAN = VAN.replace(domain=VAN.domain.replace(speed=(8.0, 16.0)))
SWARM = SwarmSettings(particles=6, generations=3)
SMALL = TuningEffort(drives=3, hard_drives=2, seconds=10.0, swarm=SWARM, unseen_drives=6, levels=(4, 2))


@pytest.fixture(scope="module")
def tuned():
    return at.tune(VAN, "production", effort=SMALL, seed=3)


@pytest.mark.compiled
def test_what_is_kept_is_ready_to_drive_and_passes_its_certificate(tuned):
    assert tuned.controller.tuning == tuned.tuning
    assert tuned.passed
    assert tuned.failed == 0
    assert tuned.domain == VAN.domain
    plant = at.DualTrack(VAN)
    run = at.simulate(plant, tuned.controller, at.load_scenario("lane-change"), profile="production")
    assert run.failed is None


@pytest.mark.compiled
def test_the_default_is_kept_unless_it_is_beaten_for_sure(tuned):
    better = tuned.gain.high < 1.0
    assert (tuned.tuning == tuned.candidate) == (better or tuned.candidate == tuned.default)
    assert tuned.default == at.MPC(VAN, profile="production").tuning
    ratios = np.log(tuned.costs["candidate"] / tuned.costs["default"])
    assert tuned.gain.mean == pytest.approx(math.exp(ratios.mean()))


@pytest.mark.compiled
def test_a_seed_gives_the_same_tuning_again(tuned):
    again = at.tune(VAN, "production", effort=SMALL, seed=3)
    assert again.tuning == tuned.tuning
    assert (again.costs["candidate"] == tuned.costs["candidate"]).all()
    assert {"verdict", "tuning", "gain", "failed", "cost", "passed"} <= set(tuned.summary())


def _believed_too_fast(lag, dead_time):
    """A saloon that says its steering follows at once, in a world in which it does not."""
    car = at.load_vehicle("midsize-sedan").replace(steering=at.Steering(lag=0.02, dead_time=0.0))
    world = at.load_profile("road")
    return car, world.replace(steering=world.steering.replace(lag=lag, dead_time=dead_time))


@pytest.mark.compiled
def test_speeds_that_nothing_holds_are_named_and_left_out():
    result = at.tune(*_believed_too_fast(0.3, 0.1), effort=SMALL, speed=(3.0, 24.0))
    assert result.domain.speed[0] == 3.0
    assert result.domain.speed[1] < 20.0
    assert not result.feasibility.passed


@pytest.mark.compiled
def test_where_the_default_fails_a_constant_that_holds_the_loop_is_tried():
    result = at.tune(*_believed_too_fast(0.25, 0.05), effort=SMALL, speed=(3.0, 25.0))
    assert np.isinf(result.costs["default"]).sum() > result.failed
    assert result.failed == 0


def test_a_domain_that_nothing_holds_is_refused():
    with pytest.raises(at.InvalidInput, match="no tuning holds the loop"):
        at.tune(*_believed_too_fast(0.6, 0.2), effort=SMALL, speed=(10.0, 20.0))


@pytest.mark.parametrize(("call", "error", "words"), [
    (lambda: TuningEffort(unseen_drives=1), at.InvalidInput, "unseen_drives"),
    (lambda: at.tune("paper", speed=(20.0, 5.0)), ValueError, "lowest"),
    (lambda: at.tune("paper", seed=-1), at.InvalidInput, "seed"),
    (lambda: at.tune("paper", plant="hovercraft"), at.UnknownName, "hovercraft"),
    (lambda: at.tune("papre"), at.UnknownName, "no vehicle is named"),
])  # fmt: skip
def test_nonsense_is_refused(call, error, words):
    with pytest.raises(error, match=words):
        call()


def test_a_search_drives_what_no_judgement_does():
    for seed in range(3):
        candidate = range(FIRST_SEARCH_DRIVE + 1000 * seed, FIRST_SEARCH_DRIVE + 1000 * (seed + 1))
        assert candidate.stop <= FIRST_UNSEEN_DRIVE
