"""What a controller holds bounds the plan, which names its limits and begins at a speed that the power holds."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.analysis import holdable
from adaptrack.analysis.holdable import holdable_speed, min_transient_margin, top_speed
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.road import Arc, Clothoid, Comfort, Line
from adaptrack.road.holdable_speed import HoldableSpeed, load_holdable
from adaptrack.road.speed import Limit, cornering_limit, steering_limit
from adaptrack.tuning.constant import ConstantTuning, load_tuning

CAR = at.load_vehicle("midsize-sedan")
TABLE = HoldableSpeed(
    vehicle="a car", profile="road", longest=10.0, speeds=(10.0, 30.0, 50.0), sideways=(0.0, 0.5, 1.0),
    frictions=(0.5, 1.0), cornering=(4.5, 9.0),
    braking=tuple(((0.4, 0.3, 0.1), (0.3, 0.2, 0.0), (0.2, 0.0, -0.2)) for _ in range(2)),
)  # fmt: skip


@pytest.fixture(scope="module")
def coarse():
    """Tables of few nodes, each made in well below a second."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(holdable, "TABLE_SPEED_RATIO", 1.9)
        patch.setattr(holdable, "TABLE_FRICTIONS", (0.5, 1.0))
        patch.setattr(holdable, "LATERAL_SHARES", (0.0, 0.5))
        holdable._cached_speeds.cache_clear()
        yield lambda mpc, profile: holdable_speed(CAR, mpc, profile)
    holdable._cached_speeds.cache_clear()


# -- the table --------------------------------------------------------------------------------------------------------
def test_between_its_nodes_a_table_is_linear_and_beyond_them_constant():
    assert float(TABLE.deceleration(20.0, 0.0, 1.0)) == pytest.approx(0.35 * GRAVITY)
    assert float(TABLE.deceleration(30.0, -6.75, 1.0)) == pytest.approx(0.1 * GRAVITY)  # to either side
    assert float(TABLE.deceleration(5.0, 0.0, 2.0)) == pytest.approx(0.4 * 2.0 * GRAVITY)
    assert float(TABLE.deceleration(90.0, 9.0, 1.0)) == pytest.approx(-0.2 * GRAVITY)


def test_a_bend_is_held_up_to_the_speed_at_which_not_even_coasting_is():
    fastest = float(TABLE.speed(0.003, 0.0, 1.0)[0])
    assert 30.0 < fastest < 50.0
    assert float(TABLE.deceleration(fastest, 0.003 * fastest**2, 1.0)) == pytest.approx(0.0, abs=0.02)
    assert TABLE.speed(0.0)[0] == math.inf  # held at all speeds of the table
    assert (np.diff(TABLE.speed(np.linspace(0.003, 0.02, 9), 0.0, 1.0)) <= 0.0).all()
    assert (np.diff(TABLE.speed(0.004, 0.0, np.linspace(0.5, 1.0, 6))) > 0.0).all()
    assert TABLE.speed(0.004, 0.1)[0] > TABLE.speed(0.004)[0]  # banked inwards


def test_a_tight_bend_below_the_speeds_of_the_table_counts_with_the_lateral_acceleration_that_it_has():
    w, deceleration = TABLE.along([1.0 / 12.0], [0.0], [1.0])
    assert np.interp(6.0**2, w, deceleration[0]) == pytest.approx(float(TABLE.deceleration(10.0, 3.0, 1.0)), abs=0.02)


def test_a_table_is_the_same_after_its_file_and_one_with_a_hole_is_refused(tmp_path):
    TABLE.to_toml(tmp_path / "held.toml")
    assert load_holdable(tmp_path / "held.toml") == TABLE
    with pytest.raises(at.InvalidInput, match=r"2 x 3 x 3 values"):
        TABLE.replace(braking=TABLE.braking[:1])
    with pytest.raises(at.InvalidInput, match="must rise"):
        TABLE.replace(speeds=(30.0, 10.0, 50.0))


def test_the_saloon_holds_less_braking_the_faster_it_is_and_more_with_friction(coarse):
    table = coarse(at.MPC(CAR, profile="production"), "production")
    speeds = np.array(table.speeds)
    straight = table.deceleration(speeds, 0.0, 1.0)
    assert straight[0] > 3.0 > straight[-1]  # the comfort's braking is held at 10 m/s and not at 60
    assert (np.diff(straight) <= 1e-9).all()
    assert (table.deceleration(speeds, 0.0, 0.5) < straight + 1e-9).all()
    assert table is coarse(at.MPC(CAR, profile="production"), "production")  # made once


def test_a_learning_controller_holds_what_it_would_at_the_slow_end_of_its_prior(coarse):
    informed = coarse(at.MPC(CAR, profile="road"), "road")
    learning = at.MPC(CAR, profile="road", learning=at.Learning())
    slow = coarse(learning, "road")
    lag, dead_time = (high for _, high in learning.learner.ranges)
    assert f"lag {lag:.3g} s" in slow.steering
    assert dead_time > 0.1
    speeds = np.array([20.0, 40.0, 55.0])
    assert (slow.deceleration(speeds, 0.0, 0.9) <= informed.deceleration(speeds, 0.0, 0.9) + 1e-9).all()


def test_an_instability_is_borne_while_deviations_grow_by_no_more_than_the_room_that_is_left():
    assert min_transient_margin(1.0, 3.0, 0.05) == min_transient_margin(0.5, 3.0, 0.05) == 0.0
    radius = 1.0 - min_transient_margin(9.0, 3.0, 0.05) / 10.0
    assert radius ** (3.0 / 0.05) == pytest.approx(9.0, rel=1e-9)
    assert min_transient_margin(9.0, 6.0, 0.05) > min_transient_margin(9.0, 3.0, 0.05)  # it lasts longer


def test_a_bend_leaves_the_reserve_of_what_the_car_corners_with():
    table = TABLE.replace(reserve=1.5)
    assert float(table.deceleration(20.0, 7.5, 1.0)) == pytest.approx(0.0, abs=1e-9)
    assert float(table.deceleration(20.0, 7.0, 1.0)) > 0.0 > float(table.deceleration(20.0, 7.6, 1.0))


def test_a_tuning_keeps_what_it_holds(coarse, tmp_path):
    tuning = ConstantTuning(
        controller="informed", vehicle=CAR.name, profile="road", period=0.05,
        tuning={"Np": 20.0, "Nc": 5.0, "Q": 1.0, "R": 10.0},
    ).with_holdable_speed(CAR, at.load_profile("road"))  # fmt: skip
    tuning.to_toml(tmp_path / "own.toml")
    assert load_tuning(tmp_path / "own.toml").holds == tuning.holds
    assert tuning.holds is not None
    entries = dict.fromkeys(at.Stanley(CAR).tuning_names, 1.0)
    stanley = ConstantTuning(controller="stanley", vehicle=CAR.name, profile="road", period=0.05, tuning=entries)
    assert stanley.with_holdable_speed(CAR, at.load_profile("road")).holds is None


# -- cornering --------------------------------------------------------------------------------------------------------
BENDS = np.linspace(0.0, 0.15, 20)


@pytest.mark.parametrize("name", at.list_vehicles())
def test_less_friction_and_tighter_bends_leave_less_and_a_plan_asks_for_no_more(name):
    car, road = at.load_vehicle(name), at.generate_road("mountain", 2, 1500.0)
    dry, wet = cornering_limit(car, BENDS, 0.9), cornering_limit(car, BENDS, 0.5)
    assert np.all(np.diff(dry) <= 0.05)  # the grid of accelerations
    assert np.all(wet < dry)
    assert dry[0] < 1.05 * 0.9 * 9.81  # a lightly loaded tyre has a little more
    tightest = math.tan(min(steering_limit(car), 1.5)) / car.wheelbase
    assert cornering_limit(car, [1.01 * tightest], [0.9])[0] == 0.0
    assert cornering_limit(car, [0.5 * tightest], [0.9])[0] > 1.0
    plan = at.plan_speed(road, car, Comfort(lateral=20.0))
    bend = np.abs(road.at(plan.s).curvature)
    assert np.all(plan.speed**2 * bend <= 0.9 * cornering_limit(car, bend, np.full(bend.shape, 0.9)) + 0.05)


@pytest.mark.compiled
@pytest.mark.parametrize(
    "name", [name for name in at.list_vehicles() if name != "model-car"]
)  # 20 m/s is not its world
def test_below_the_limit_the_plant_holds_a_circle_and_above_it_does_not(name):
    car, radius = at.load_vehicle(name), 50.0
    limit = cornering_limit(car, [1 / radius], [0.9])[0]
    circle = at.Road.from_segments(
        [Line(length=30.0), Clothoid(length=60.0, start_curvature=0.0, end_curvature=1 / radius),
         Arc(length=350.0, curvature=1 / radius)], name="circle", friction=0.9,
    )  # fmt: skip
    speeds = [math.sqrt(share * limit * radius) for share in (0.9, 1.15)]
    below, lost = (
        at.rollout(at.DualTrack(car), at.MPC(car, profile="road"), at.RoadDrive(circle, speed), profile="road")
        for speed in speeds
    )
    assert below.failed is None
    assert np.abs(below.error).max() < 0.25
    assert lost.failed is not None or np.abs(lost.error).max() > 0.5


# -- plans ------------------------------------------------------------------------------------------------------------
def test_a_plan_is_no_faster_and_brakes_no_harder_than_the_table_says():
    road = at.generate_road("mountain", seed=3, length=1500.0)
    comfort = Comfort(lateral=7.0, brake=6.0, lateral_jerk=math.inf)
    plan = at.plan_speed(road, CAR, comfort, top_speed=60.0, holds=TABLE)
    middle = 0.5 * (plan.s[1:] + plan.s[:-1])
    v = np.sqrt(0.5 * (plan.speed[1:] ** 2 + plan.speed[:-1] ** 2))
    allowed = TABLE.deceleration(v, v**2 * road.at(middle).curvature, 0.9)
    assert (np.maximum(-plan.acceleration, 0.0) <= np.maximum(allowed, 0.0) + 0.15).all()
    assert (plan.at(middle) <= TABLE.speed(road.at(middle).curvature) * 1.01).all()
    assert plan.duration > at.plan_speed(road, CAR, comfort, top_speed=60.0).duration


def test_the_saloon_that_brakes_from_speed_leaves_the_road_without_the_table_and_stays_with_it(coarse):
    road = at.Road.from_segments(
        [Line(length=500.0), Clothoid(length=40.0, start_curvature=0.0, end_curvature=0.025),
         Arc(length=40.0, curvature=0.025)]
    )  # fmt: skip
    mpc, offsets = at.MPC(CAR, profile="production"), []
    for holds in (None, coarse(mpc, "production")):
        plan = at.plan_speed(road, CAR, Comfort(lateral=4.0), top_speed=100.0, holds=holds)
        run = at.rollout(at.DualTrack(CAR), mpc, at.RoadDrive(road, plan), profile="production", seed=3)
        offsets.append(float(np.nanmax(np.abs(run.error))))
    assert offsets[0] > 4.0
    assert offsets[1] < 1.0


def test_an_open_road_begins_at_a_speed_that_the_power_holds():
    road = at.Road.from_segments([Line(length=3000.0)], friction=1.2)
    plan = at.plan_speed(road, CAR, top_speed=100.0)
    assert plan.speed[0] == pytest.approx(top_speed(CAR), abs=0.5)
    assert plan.speed[0] == pytest.approx(plan.speed[-1], rel=1e-6)
    assert at.plan_speed(road, CAR, top_speed=100.0, start=80.0).speed[0] == pytest.approx(80.0)  # asked for
    assert {stretch.limit for stretch in plan.stretches} == {Limit.POWER}


def circle(radius, **along):
    return at.Road.from_segments([Arc(length=2.0 * math.pi * radius, curvature=1.0 / radius)], closed=True, **along)


@pytest.mark.parametrize(
    ("road", "options", "limit"),
    [
        (circle(50.0), {"comfort": Comfort(lateral=3.0)}, Limit.LATERAL),
        (circle(50.0, friction=0.3), {"comfort": Comfort(lateral=5.0)}, Limit.GRIP),
        (circle(900.0, speed_limit=20.0), {}, Limit.SPEED_LIMIT),
        (circle(900.0), {}, Limit.DOMAIN),
        (circle(900.0), {"top_speed": 30.0}, Limit.TOP_SPEED),
        (circle(400.0), {"comfort": Comfort(lateral=7.0), "top_speed": 60.0, "holds": TABLE}, Limit.MARGINS),
        (at.Road.from_segments([Clothoid(length=60.0, start_curvature=-0.02, end_curvature=0.02)]),
         {"comfort": Comfort(lateral=50.0, grip_share=1.0, lateral_jerk=4.0)}, Limit.CURVATURE_RATE),
        (at.Road.from_segments([Line(length=150.0)]), {"start": 1.0}, Limit.ACCELERATE),
        (at.Road.from_segments([Line(length=80.0)]), {"end": 0.0, "top_speed": 60.0}, Limit.BRAKE),
    ],
)  # fmt: skip
def test_a_plan_names_what_bounds_it(road, options, limit):
    plan = at.plan_speed(road, CAR, options.pop("comfort", Comfort()), **options)
    assert next(iter(plan.shares)) == limit
    assert plan.shares[limit] > 0.5
