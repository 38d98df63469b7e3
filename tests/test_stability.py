"""The linear closed loop: its eigenvalues foretell what simulations show."""

import numpy as np
import pytest

from adaptrack import (
    MPC,
    DualTrack,
    Moves,
    SingleTrack,
    Tuning,
    compute_metrics,
    load_scenario,
    load_tyre,
    load_vehicle,
)
from adaptrack.plant import ROAD
from adaptrack.simulate import rollout
from adaptrack.stability import closed_loop, linearised, spectral_radius

pytestmark = pytest.mark.compiled
CAR = load_vehicle("paper")


def decay(plant, mpc, speed, profile="paper"):
    """How fast a small offset dies out in a simulation: growth factor a period, late in the run."""
    quiet = load_scenario("step", amplitude=1e-4, speed=speed, friction=0.75, duration=30.0)
    if profile == "road":
        from dataclasses import replace

        profile = replace(ROAD, noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)
    run = rollout(plant, mpc, quiet, profile=profile)
    size = np.abs(run.error)
    return size


@pytest.mark.parametrize("speed", [6.0, 12.0, 20.0])
def test_the_single_tracks_linearisation_is_the_prediction_model(speed):
    still_air = CAR.replace(frontal_area=0.0)
    names, a, b = linearised(SingleTrack(still_air, "magic-formula"), speed)
    order = [names.index(name) for name in ("vy", "psi", "yaw_rate", "Y")]
    model_a, model_b, _ = MPC(CAR).model.continuous(speed)
    np.testing.assert_allclose(a[np.ix_(order, order)], model_a, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(b[order], model_b[:, 0], rtol=1e-5)


@pytest.mark.parametrize("profile", ["paper", "road"])
@pytest.mark.parametrize("moves", [Moves.pulses(), Moves.laguerre(0.9, 6)])
def test_the_matrix_moves_small_states_as_the_simulation_does(profile, moves):
    plant = DualTrack(CAR, "magic-formula")
    period = 0.1 if profile == "paper" else 0.05
    mpc = MPC(CAR, Tuning(Np=30, Nc=6, Q=1.0, R=100.0), moves=moves, period=period)
    size = decay(plant, mpc, 15.0, profile)
    radius = spectral_radius(plant, mpc, 15.0, friction=0.75, profile=profile)
    late = slice(-100, None)
    steps = np.arange(size.size)[late]
    envelope = np.maximum.accumulate(size[::-1])[::-1][late]  # the largest error still to come
    if radius < 1.0 and envelope[0] > 1e-14:
        slope = np.polyfit(steps[:60], np.log(envelope[:60] + 1e-300), 1)[0]
        assert np.exp(slope) <= radius + 0.02
    assert np.isfinite(closed_loop(plant, mpc, 15.0, profile=profile)).all()


def test_an_unstable_loop_is_foretold_and_happens():
    """Tyre relaxation of 0.1 m destabilises the paper's tuning with pulses at low speed, not with Laguerre 0.95."""
    plant = DualTrack(CAR, "constant-stiffness")
    for moves, unstable in ((Moves.pulses(), True), (Moves.laguerre(0.95), False)):
        mpc = MPC(CAR, moves=moves)
        radius = spectral_radius(plant, mpc, 6.0, friction=0.75)
        size = decay(plant, mpc, 6.0)
        assert (radius > 1.0) is unstable
        assert bool(size[100:].max() > 10 * size[0]) is unstable


def test_without_relaxation_the_dual_track_is_as_stable_as_the_single_track():
    stiff = load_tyre("constant-stiffness").replace(relaxation_length=0.0)
    mpc = MPC(CAR)
    for speed in (4.0, 12.0, 24.0):
        radii = [spectral_radius(plant(CAR, stiff), mpc, speed, friction=0.75) for plant in (SingleTrack, DualTrack)]
        assert radii[0] == pytest.approx(radii[1], abs=2e-4)


REPLICA = {  # an independent replica of the authors' released system: (general trajectory, triple lane change)
    "laguerre 0.95": (Moves.laguerre(0.95), 0.618, 0.038),
    "laguerre 0.75": (Moves.laguerre(0.75), 0.129, 0.0040),
    "pulse": (Moves.pulses(), 0.123, 0.0030),
}


@pytest.mark.parametrize("name", REPLICA)
def test_the_released_configuration_reproduces_the_replica(name):
    moves, general, lane_change = REPLICA[name]
    plant, mpc = SingleTrack(CAR, "constant-stiffness"), MPC(CAR, moves=moves)
    for scenario, expected in (("general-trajectory", general), ("triple-lane-change", lane_change)):
        assert compute_metrics(rollout(plant, mpc, load_scenario(scenario))).mse == pytest.approx(expected, rel=0.05)
