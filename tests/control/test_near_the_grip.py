"""The prediction has the slope of the rear tyres where they work; filter, feed-forward and straights do not change."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adaptrack import MPC, DualTrack, Learning, RoadDrive, SpeedControl, generate_road, load_vehicle, plan_speed
from adaptrack.control.estimation import NOTHING_MEASURED
from adaptrack.core.controllers import informed
from adaptrack.core.estimators.learning import memory_of
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.physics.tyre import brush_slope
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.simulate import rollout, simulate
from adaptrack.road import Arc, Comfort, Line, Road
from adaptrack.road.road_ahead import RoadAhead

pytestmark = pytest.mark.kernels

CAR = load_vehicle("midsize-sedan")
SPEED, RADIUS = 20.0, 60.0


def circle(sign: float = 1.0) -> Road:
    """A straight, then a bend that asks for 6.7 m/s^2 at `SPEED`."""
    return Road.from_segments([Line(length=60.0), Arc(length=300.0, curvature=sign / RADIUS)])


def step(mpc: MPC, road: Road, station: float, friction: float = 0.0) -> float:
    """The command of a car that drives steadily on a road at `SPEED`."""
    curvature = float(road.at(station).curvature)
    state = NOTHING_MEASURED.copy()
    state[: MEASUREMENT.lateral_acceleration] = 0.0
    state[MEASUREMENT.yaw_rate] = SPEED * curvature
    state[MEASUREMENT.turned] = SPEED * curvature * mpc.period
    state[MEASUREMENT.friction] = friction
    return mpc.step(state, SPEED, [0.0], road=RoadAhead(road, station, SPEED)).angle


def slope(mpc: MPC) -> float:
    """What the prediction multiplies the stiffness of the rear tyres by."""
    return float(mpc._mpc.memory[0].rear_slope)


# -- the slope --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("used", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_the_slope_is_the_derivative_of_a_brush_tyre_over_that_at_no_slip(used):
    def force(z: float) -> float:
        return 1.0 - (1.0 - z) ** 3  # over mu F_z; z: slip over that at which all of the tread slides

    z, h = 1.0 - (1.0 - used) ** (1 / 3), 1e-5
    assert brush_slope(used) == pytest.approx((force(z + h) - force(z - h)) / (2 * h) / 3.0, rel=1e-6)


@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_the_slope_falls_with_the_share_of_the_grip_down_to_a_floor(friction):
    slopes = [informed.rear_slope(share * friction * GRAVITY, friction) for share in np.linspace(0.0, 2.0, 200)]
    assert slopes[0] == 1.0
    assert (np.diff(slopes) <= 0.0).all()
    assert min(slopes) == slopes[-1] == informed.LEAST_REAR_SLOPE


def test_a_bend_that_asks_for_less_than_a_sixty_fourth_of_the_grip_is_a_straight():
    assert informed.rear_slope(0.99 / 64 * 0.9 * GRAVITY, 0.9) == 1.0
    assert informed.rear_slope(1.01 / 64 * 0.9 * GRAVITY, 0.9) < 1.0


def test_the_other_direction_has_the_same_slope():
    assert informed.rear_slope(-5.0, 0.9) == informed.rear_slope(5.0, 0.9)


# -- where it is ------------------------------------------------------------------------------------------------------
def test_the_prediction_is_softer_in_a_bend_and_not_on_a_straight():
    mpc = MPC(CAR, profile="road")
    step(mpc, Road.from_segments([Line(length=300.0)]), 10.0)
    assert slope(mpc) == 1.0
    bend = MPC(CAR, profile="road")
    step(bend, circle(), 100.0)
    assert slope(bend) == pytest.approx((1.0 - SPEED**2 / RADIUS / (0.9 * GRAVITY)) ** (2 / 3), abs=0.01)


def test_the_prediction_is_that_of_a_car_with_softer_rear_tyres():
    mpc = MPC(CAR, profile="road")
    step(mpc, circle(), 100.0)
    soft = mpc.model.with_rear_slope(slope(mpc))
    _, response = soft.responses(SPEED, int(mpc.tuning.Np), of_next=True)
    np.testing.assert_allclose(mpc._mpc.ws.step[0, : int(mpc.tuning.Np)], response, rtol=1e-9, atol=1e-12)


def test_filter_and_feed_forward_keep_the_slope_at_no_slip():
    mpc = MPC(CAR, profile="road")
    before = mpc._mpc.parameters.copy()
    step(mpc, circle(), 100.0)
    assert slope(mpc) < 0.6
    a, b, _ = mpc.model.discrete(SPEED)
    np.testing.assert_allclose(mpc._mpc.informed.a[0], a, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(mpc._mpc.informed.b[0], b[:, 0], rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(mpc._mpc.parameters, before)
    turning = mpc.model.turning()
    np.testing.assert_array_equal(mpc._mpc.feed.turning[: turning.size], turning)


def test_less_friction_makes_the_prediction_softer():
    slopes = []
    for friction in (0.7, 0.9, 1.1):
        mpc = MPC(CAR, profile="road")
        step(mpc, circle(), 100.0, friction)
        slopes.append(slope(mpc))
    assert slopes == sorted(slopes)
    assert len(set(slopes)) == len(slopes)


def test_the_slope_changes_by_at_most_one_a_second():
    mpc, road, slopes = MPC(CAR, profile="road"), circle(), []
    for k in range(100):
        step(mpc, road, 20.0 + k * SPEED * mpc.period)
        slopes.append(slope(mpc))
    assert min(slopes) < 0.6
    assert np.abs(np.diff(slopes)).max() <= informed.MAX_SLOPE_RATE * mpc.period + 1e-12


def test_a_friction_that_falls_in_a_bend_moves_the_wheels_by_less_than_a_hundredth_of_a_radian():
    before, after, differences = MPC(CAR, profile="road"), MPC(CAR, profile="road"), []
    for k in range(60):
        friction = 0.9 if k < 20 else 0.8
        differences.append(step(before, circle(), 100.0, 0.9) - step(after, circle(), 100.0, friction))
    assert slope(after) < slope(before)
    assert np.abs(differences).max() < 0.01


def test_the_product_of_learned_and_local_stiffness_has_a_floor():
    mpc = MPC(CAR, profile="road", learning=Learning())
    road = circle()
    for k in range(40):
        beliefs = memory_of(mpc._mpc.informed.learned[0], 0).beliefs
        for name in ("used_stiffness", "belief_stiffness"):
            beliefs[name] = 0.45  # of the file's
        step(mpc, road, 100.0 + k, 0.5)
        assert beliefs.used_stiffness < 0.6
        product = slope(mpc) * beliefs.used_stiffness / math.sqrt(beliefs.used_balance)
        assert product >= informed.LEAST_REAR_SLOPE - 1e-12


# -- whole drives -----------------------------------------------------------------------------------------------------
def lap(seed: int, lateral: float) -> RoadDrive:
    road = generate_road("lap", seed=seed)
    return RoadDrive(road, plan_speed(road, CAR, Comfort(lateral=lateral)))


class SameSlope(MPC):
    """An MPC that is told so much friction that its prediction keeps the slope at no slip."""

    def step(self, state, *inputs, **road):
        return super().step(np.append(state[: MEASUREMENT.friction], 1e9), *inputs, **road)


@pytest.mark.compiled
def test_on_a_straight_nothing_changes():
    road = Road.from_segments([Line(length=200.0), Arc(length=60.0, curvature=1.0 / RADIUS)])
    runs = [
        simulate(DualTrack(CAR), kind(CAR, profile="road"), RoadDrive(road, 15.0), profile="road", seed=2)
        for kind in (MPC, SameSlope)
    ]
    differs = runs[0].steering != runs[1].steering
    first = int(np.argmax(differs))
    assert differs.any()
    assert 150.0 < runs[0].road["station"][first] < 200.0  # the bend comes into the horizon


@pytest.mark.compiled
@pytest.mark.parametrize("seed", [1, 3, 7])
def test_the_lap_on_which_the_loop_swung_off_the_road_is_driven_within_15_centimetres(seed):
    run = simulate(DualTrack(CAR), MPC(CAR, profile="road"), lap(5, 7.0), profile="road",
                   driver=SpeedControl(CAR, friction=0.9), seed=seed)  # fmt: skip
    assert run.failed is None
    assert np.abs(run.error).max() < 0.15


@pytest.mark.compiled
def test_a_batch_near_the_grip_is_its_single_runs():
    drive = lap(5, 7.0)
    batch = rollout_batch(DualTrack(CAR), MPC(CAR, profile="road"), drive, profile="road",
                          scenario_indices=[0, 0], seeds=[1, 2])  # fmt: skip
    for k, seed in enumerate((1, 2)):
        run = rollout(DualTrack(CAR), MPC(CAR, profile="road"), drive, profile="road", seed=seed)
        assert batch.max_abs_error[k] == np.abs(run.error).max()


def test_mirrored_bends_get_mirrored_commands():
    commands = [
        [step(mpc, circle(sign), 40.0 + k * SPEED * mpc.period) for k in range(60)]
        for sign, mpc in ((1.0, MPC(CAR, profile="road")), (-1.0, MPC(CAR, profile="road")))
    ]
    np.testing.assert_allclose(commands[0], np.negative(commands[1]), rtol=0, atol=1e-12)
