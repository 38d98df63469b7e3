"""The prediction has the slope of the rear tyres where they work; filter, feed-forward and straights do not change."""

from __future__ import annotations

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack import MPC, DualTrack, Learning, RoadDrive, SpeedControl, generate_road, load_vehicle, plan_speed
from adaptrack.cars.vehicle import pack_plant
from adaptrack.control.estimation import NOTHING_MEASURED
from adaptrack.control.speed_control import SpeedController
from adaptrack.core.controllers import informed
from adaptrack.core.estimators import learning
from adaptrack.core.estimators.learning import memory_of
from adaptrack.core.models import path
from adaptrack.core.models.car import unpack
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.physics.tyre import BRUSH_SHAPE, brush_slope, curve, force_and_slope, reach_at
from adaptrack.core.speed import friction as friction_kernel
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


# -- the slopes of different curves -----------------------------------------------------------------------------------
SHARES = np.linspace(0.0, 0.8, 81)
"""Used shares of the grip."""


def local_slope(used: float, shape: float) -> float:
    """Exact slope of a curve over that at no slip, at a used share of its largest force."""
    reach = 3.0 * (1.0 - (1.0 - used) ** (1 / 3)) if shape == BRUSH_SHAPE else reach_at(used, shape)
    force, slope = force_and_slope(reach, curve(1.0, 1.0, 1.0, shape))
    assert force == pytest.approx(used, abs=1e-12)
    return slope


def slope_of_learner(used: float) -> float:
    """Slope of the learner's curve, x/sqrt(1 + x^2)."""
    axle = learning._axle(used / math.sqrt(1.0 - used * used), 1.0, 1.0)
    assert axle.force == pytest.approx(used, abs=1e-12)
    return axle.by_slip


@pytest.mark.parametrize("name", at.list_vehicles())
def test_learner_friction_and_prediction_have_the_same_slope_at_no_slip(name):
    car = load_vehicle(name)
    mpc, stiffness, balance = MPC(car, profile="road", learning=Learning()), 1.3, 0.9
    records, learned = mpc._mpc.informed, mpc._mpc.informed.learned[0]
    p, beliefs = learning.parameters_of(records.learner, 0), memory_of(learned, 0).beliefs
    candidate = learning.hypothesis(0, p.commands, learned)
    candidate.x[:] = 0.0
    candidate.x[learning.STIFFNESS_SCALE], candidate.x[learning.BALANCE] = math.log(stiffness), 0.5 * math.log(balance)
    beliefs.used_stiffness, beliefs.used_balance = beliefs.belief_stiffness, beliefs.belief_balance = stiffness, balance
    learning.believe(records.learner, learned, mpc._mpc.parameters, records.estimator, records.estimates[0])
    predicted = path.parameters_of(mpc._mpc.parameters, 0)

    axles = learning._axles(candidate, SPEED, 0.0, p)
    knowledge = friction_kernel._knowledge(learned, None)
    c = unpack(pack_plant(car, at.load_tyre(car.tyre), at.SteeringActuator(lag=0.1, rate=1.0, limit=0.5)))
    hypothesis = friction_kernel.FRICTION_HYPOTHESIS.new(1)[0]
    hypothesis.grip, hypothesis.tyre_shape = 0.8, BRUSH_SHAPE
    loads = (c.mass * GRAVITY * lever / car.wheelbase for lever in (car.lr, car.lf))
    sides = (predicted.stiffness_front, c.stiffness_front, 0.5), (predicted.stiffness_rear, c.stiffness_rear, -0.5)
    for axle, load, (expected, in_file, power) in zip(axles, loads, sides, strict=True):
        assert axle.by_slip * p.mass == pytest.approx(2.0 * expected, rel=1e-12)
        factor = knowledge.stiffness * knowledge.balance**power
        slope = friction_kernel._axle(0.0, load, 0.0, factor * in_file, hypothesis, c)[1]
        assert slope == pytest.approx(2.0 * expected, rel=3e-4)


def test_the_prediction_is_as_soft_as_a_brush_at_every_64th_of_the_grip_and_stiffer_by_at_most_5_percent_between():
    ratios = np.array([informed.rear_slope(used * GRAVITY, 1.0) / local_slope(used, BRUSH_SHAPE) for used in SHARES])
    assert (ratios >= 1.0 - 1e-9).all()
    assert (ratios[SHARES <= 0.5] < 1.02).all()
    assert (ratios < 1.05).all()
    for used in np.arange(52) / 64.0:
        exact = local_slope(used, BRUSH_SHAPE)
        assert informed.rear_slope((used + 1e-9) * GRAVITY, 1.0) == pytest.approx(exact, rel=1e-9)


@pytest.mark.parametrize(("shape", "least", "most"), [
    (BRUSH_SHAPE, 1.0, 1.0), (1.2, 0.875, 1.112), (1.35, 0.849, 1.0), (1.6, 0.800, 1.0), (1.9, 0.731, 1.0),
])  # fmt: skip
def test_up_to_four_fifths_of_the_grip_other_curves_differ_from_a_brush_by_what_the_documentation_says(
    shape, least, most
):
    ratios = [brush_slope(used) / local_slope(used, shape) for used in SHARES]
    assert min(ratios) == pytest.approx(least, abs=1e-3)
    assert max(ratios) == pytest.approx(most, abs=1e-3)


def test_the_learners_own_curve_is_softer_than_a_brush_from_55_percent_of_the_grip_on():
    ratios = np.array([brush_slope(used) / slope_of_learner(used) for used in SHARES])
    assert ratios.min() == pytest.approx(0.908, abs=1e-3)
    assert ratios.max() == pytest.approx(1.583, abs=1e-3)
    assert (np.diff(ratios >= 1.0)[1:].nonzero()[0] + 1 == [54]).all()


def learn_on_curve(law, share: float, seconds: float = 60.0) -> np.ndarray:
    """Learned stiffness over the true one, and its sigma, of a car that weaves at a share of the grip.

    law: lateral force over friction times load, of stiffness times slip over it.
    """
    world = at.load_profile("road")
    mpc = MPC(CAR, profile=world, learning=Learning())
    parameters, memory = mpc.learner.parameters(), mpc.learner.fresh()
    beliefs, random = memory_of(memory, 0).beliefs, np.random.default_rng(1)
    wheels, vy, r, count, sent = 0.0, 0.0, 0.0, 25, [0.0, 0.0]
    step, grip, weight = world.period / count, 0.9 * GRAVITY, 0.9 * CAR.mass * GRAVITY / CAR.wheelbase
    learned = []
    for k in range(round(seconds / world.period)):
        demand = share * grip / SPEED * min(max(2.0 * math.sin(2.0 * math.pi * k / 160.0), -1.0), 1.0)
        measured = NOTHING_MEASURED.copy()
        measured[MEASUREMENT.yaw_rate] = r + 0.003 * random.standard_normal()
        measured[MEASUREMENT.vy] = vy + 0.05 * random.standard_normal()
        measured[MEASUREMENT.motion_age] = 0.0
        learning.learn(SPEED, measured, sent[0], 0, parameters, memory)
        sent = [0.2 * (demand - r) + demand * CAR.wheelbase / SPEED, sent[0]]
        for _ in range(count):
            wheels += step / world.steering.lag * (sent[1] - wheels)
            slips = wheels - (vy + CAR.lf * r) / SPEED, -(vy - CAR.lr * r) / SPEED
            loads = weight * CAR.lr, weight * CAR.lf
            stiffness = 2.0 * CAR.stiffness_front, 2.0 * CAR.stiffness_rear
            front, rear = (load * law(c * slip / load) for load, c, slip in zip(loads, stiffness, slips, strict=True))
            vy += step * ((front + rear) / CAR.mass - SPEED * r)
            r += step * (CAR.lf * front - CAR.lr * rear) / CAR.yaw_inertia
        learned.append((beliefs.belief_stiffness, beliefs.belief_stiffness_sigma))
    return np.array(learned[round(30.0 / world.period) :])


@pytest.mark.compiled
@pytest.mark.parametrize("share", [0.4, 0.6, 0.8])
@pytest.mark.parametrize(("law", "least"), [
    (lambda x: x / math.sqrt(1.0 + x * x), 0.94), (math.tanh, 0.94),
    (lambda x: math.sin(1.9 * math.atan(x / 1.9)), 0.94),
    (lambda x: math.copysign(1.0 - max(1.0 - abs(x) / 3.0, 0.0) ** 3, x), 0.88),
], ids=["learner", "tanh", "magic formula 1.9", "brush"])  # fmt: skip
def test_a_learner_finds_the_slope_at_no_slip_of_tyres_with_another_curve(law, least, share):
    stiffness, sigma = learn_on_curve(law, share).T
    assert (stiffness > least).all()
    assert (stiffness < 1.06).all()
    assert (np.abs(np.log(stiffness)) < 1.5 * sigma).all()  # and says how sure it is


def test_guard_and_governor_know_of_the_tyres_their_friction_alone():
    road = generate_road("lap", seed=5)
    settings = [
        SpeedController(SpeedControl(car, friction=0.8), road, plan_speed(road, CAR), 0.05).record.settings
        for car in (CAR, CAR.replace(tyre="magic-formula", stiffness_front=3e4, stiffness_rear=9e4))
    ]
    differs = {
        name for name, *values in zip(settings[0]._fields, *settings, strict=True) if len(set(map(str, values))) > 1
    }
    assert differs == {"friction", "friction_high", "straight_ratio"}  # largest steady acceleration of the plan's tyre


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
