"""Driving along curved roads: the road ahead, the loop in path coordinates, every controller."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.control.controllers.base import Policy
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.predicted_paths import PredictedPaths
from adaptrack.drive.world import World
from adaptrack.road import Along, Arc, Clothoid, Comfort, Line, Pose, Stop
from adaptrack.tuning.constant import tune_constant
from adaptrack.tuning.pso import SwarmSettings
from adaptrack.tuning.runs import RunSet

CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR)
BEND = Arc(length=15.0 * math.pi, curvature=1 / 15)
HAIRPIN = at.Road.from_segments([Line(length=40.0), BEND, Line(length=40.0)], name="hairpin")
CIRCLE = at.Road.from_segments([Arc(length=100.0 * math.pi, curvature=0.02)], closed=True, name="circle")
WINDING = at.generate_road("country", seed=4, length=600.0)
LAWS = {
    "kinematic-mpc": at.KinematicMPC, "lqr": at.LQR, "preview-lqr": at.PreviewLQR, "pure-pursuit": at.PurePursuit,
    "stanley": at.Stanley,
}  # fmt: skip


def planned(road):
    return at.RoadDrive(road, at.plan_speed(road, CAR))


# -- the road ahead ---------------------------------------------------------------------------------------------------
def test_an_arc_lies_beside_its_tangent_as_a_parabola():
    """With dY/dt = v theta and theta = v kappa t, Y = kappa (v t)^2/2."""
    for lead in (0.0, 0.4, 3.3):
        bent = at.RoadAhead(CIRCLE, 311.0, [12.0]).bend(30, 12.0, lead, 0.05)  # across the seam of the lap
        t = (lead + np.arange(30)) * 0.05
        np.testing.assert_allclose(bent, 0.5 * 0.02 * (12.0 * t) ** 2, rtol=1e-9, atol=1e-12)


def test_a_clothoid_lies_beside_its_tangent_as_a_cubic():
    road = at.Road.from_segments([Clothoid(length=200.0, start_curvature=0.0, end_curvature=0.02)], name="clothoid")
    path = at.RoadAhead(road, 0.0, [10.0]).bend(100, 10.0, 0.0, 0.05)
    s = 0.5 * np.arange(100)
    np.testing.assert_allclose(path, 1e-4 * s**3 / 6.0, rtol=0, atol=2e-4)  # the table of headings is 0.5 m fine


@pytest.mark.parametrize(("make", "words"), [
    (lambda: at.RoadAhead(HAIRPIN, math.nan, [10.0]), "station"),
    (lambda: at.RoadAhead(HAIRPIN, 0.0, []), "speeds"),
    (lambda: at.RoadDrive("lap", 10.0), "must be a Road"),
    (lambda: at.RoadDrive(HAIRPIN, 5.0, laps=2), "is open"),
    (lambda: at.RoadDrive(HAIRPIN, at.plan_speed(WINDING)), "different road"),
    (lambda: at.RoadDrive(HAIRPIN, 5.0, start_heading=2.0), "right angle"),
])  # fmt: skip
def test_drives_that_make_no_sense_are_refused(make, words):
    with pytest.raises(at.InvalidInput, match=words):
        make()


# -- a drive ----------------------------------------------------------------------------------------------------------
def test_a_drive_follows_its_plan_and_stands_at_its_stops():
    plan = at.plan_speed(WINDING, CAR, Comfort(lateral=3.0), start=0.0, end=0.0, stops=[Stop(200.0, 4.0)])
    signals = at.RoadDrive(WINDING, plan).sample(0.05)
    assert np.all(np.diff(signals.station) >= 0.0)
    np.testing.assert_allclose(  # the station is the integral of the speed, to the order of the trapezoid
        np.diff(signals.station), 0.025 * (signals.speed[1:] + signals.speed[:-1]), atol=1e-2
    )
    assert np.sum(np.abs(signals.station - 200.0) < 1e-9) * 0.05 == pytest.approx(4.0, abs=0.11)
    assert signals.station[-1] == pytest.approx(WINDING.length, abs=0.05)


@pytest.mark.compiled
def test_a_straight_road_is_the_scenario_without_a_road():
    mpc = at.MPC(CAR, profile="road")
    test = at.load_scenario("lane-change", speed=20.0, amplitude=2.0, friction=0.9, gust=0.0)
    straight = at.Road.from_segments([Line(length=300.0)], name="straight", friction=0.9)
    plain = at.rollout(PLANT, mpc, test, profile="road", seed=3)
    bent = at.rollout(PLANT, mpc, at.RoadDrive(straight, 20.0, reference=test.reference), profile="road", seed=3)
    assert np.abs(plain.error).max() > 0.02
    np.testing.assert_allclose(bent.error[: len(plain)], plain.error, rtol=0, atol=1e-9)


@pytest.mark.compiled
def wheel_angle_measured_at_the_start(drive):
    """rad, without steering lag and with one."""
    angles = []
    for lag in (0.0, 0.1):
        profile = at.load_profile("paper").replace(steering=at.SteeringActuator(lag=lag))
        loop = ClosedLoop(World.of(PLANT, at.MPC(CAR, profile=profile), profile, None, None, None), drive, 0)
        angles.append(float(loop.sensed.measured[MEASUREMENT.wheel_angle]))
    assert angles[0] == angles[1]
    return angles[0]


@pytest.mark.parametrize("bank", [0.0, math.asin(144.0 * 0.02 / GRAVITY)])
@pytest.mark.parametrize("drive", [at.simulate, at.rollout])
def test_a_drive_that_begins_in_a_bend_begins_in_its_steady_turn(drive, bank):
    """delta = L k + K a, beta = l_r k - W a, r = v k, with the acceleration a that the bank leaves to the tyres."""
    road, speed = CIRCLE.replace(bank=bank), 12.0
    run = drive(PLANT, at.MPC(CAR, profile="paper", preview=True), at.RoadDrive(road, speed), profile="paper")
    felt = 0.02 * speed * speed - GRAVITY * math.sin(bank)
    rear_slip = CAR.mass * CAR.lf / (2.0 * CAR.stiffness_rear * CAR.wheelbase)
    wheels = CAR.wheelbase * 0.02 + CAR.understeer_gradient * felt
    if not bank:  # the controller does not know a bank
        assert run.command[0] == pytest.approx(wheels, rel=0.01)
    assert wheel_angle_measured_at_the_start(at.RoadDrive(road, speed)) == pytest.approx(wheels, rel=1e-3)
    assert run.vy[0] / run.vx[0] == pytest.approx(CAR.lr * 0.02 - rear_slip * felt, rel=0.02, abs=2e-4)
    assert run.road["heading_error"][0] == pytest.approx(-math.atan2(run.vy[0], run.vx[0]), abs=1e-9)
    assert run.yaw_rate[0] == pytest.approx(0.02 * speed, rel=1e-9)


@pytest.mark.parametrize("profile", ["road", "production"])
@pytest.mark.parametrize("car", ["compact-ev", "van"])
def test_the_start_in_a_bend_is_not_the_largest_error_of_a_drive(car, profile):
    road, vehicle = at.Road.from_segments([Arc(length=180.0, curvature=1 / 30)], name="bend"), at.load_vehicle(car)
    drive = at.RoadDrive(road, 9.5)
    run = at.rollout(at.DualTrack(vehicle), at.MPC(vehicle, profile=profile), drive, profile=profile)
    error, first = np.abs(run.road["offset"]), round(3.0 / run.period)
    assert error[:first].max() < error[first:].max() < 0.05


def test_offset_and_heading_error_are_those_of_the_projection():
    run = at.rollout(PLANT, at.MPC(CAR, profile="road"), at.RoadDrive(WINDING, 15.0), profile="road")
    feet = WINDING.project(run.X, run.Y, near=run.road["station"])
    np.testing.assert_allclose(run.road["offset"], feet.offset, rtol=0, atol=1e-9)
    np.testing.assert_allclose(run.road["heading_error"], run.psi - feet.heading, rtol=0, atol=1e-9)


@pytest.mark.compiled
def test_a_road_that_is_moved_and_mirrored_is_driven_in_the_mirror():
    segments = [Line(length=40.0), BEND.replace(curvature=-1 / 15), Line(length=40.0)]
    moved = at.Road.from_segments(segments, name="moved", start=Pose(x=300.0, y=-200.0, heading=2.0))
    left, right = (
        at.rollout(PLANT, at.MPC(CAR, profile="paper"), at.RoadDrive(road, 6.0)) for road in (HAIRPIN, moved)
    )
    np.testing.assert_allclose(left.road["offset"], -right.road["offset"], rtol=0, atol=1e-7)


@pytest.mark.compiled
@pytest.mark.parametrize("profile", ["paper", "production"])
def test_the_informed_controller_stays_within_a_decimetre_in_a_hairpin(profile):
    run = at.rollout(
        PLANT, at.MPC(CAR, profile=profile, period=0.05), at.RoadDrive(HAIRPIN, 6.0), profile=profile, seed=1
    )
    assert run.failed is None
    assert np.abs(run.error).max() < 0.1
    assert run.road["station"][-1] == pytest.approx(HAIRPIN.length, abs=1.0)


@pytest.mark.compiled
@pytest.mark.parametrize("law", LAWS)
def test_each_law_drives_a_circle_as_geometry_says(law):
    """On a gentle circle with an ideal actuator the feed-forward of each keeps it near; after laps there is no jump."""
    controller = LAWS[law](CAR, period=0.05, preview=True)
    run = at.rollout(PLANT, controller, at.RoadDrive(CIRCLE, 6.0, laps=3), profile="paper")
    assert run.failed is None
    later = run.t > 20.0
    assert np.ptp(run.error[later]) < 0.02  # a steady turn, across two seams
    assert np.abs(run.error[later]).max() < 0.35


@pytest.mark.compiled
@pytest.mark.parametrize("law", ["mpc", "stanley"])
def test_the_wheels_of_a_standing_car_rest(law):
    plan = at.plan_speed(WINDING, CAR, Comfort(lateral=3.0), start=0.0, end=0.0, stops=[Stop(200.0, 4.0)])
    controller = at.MPC(CAR, profile="road") if law == "mpc" else LAWS[law](CAR, period=0.05, preview=True)
    run = at.rollout(PLANT, controller, at.RoadDrive(WINDING, plan), profile="road", seed=2)
    assert run.failed is None
    standing = (run.vx[1:] < 0.09) & (run.vx[:-1] < 0.09)
    assert standing.sum() > 60
    assert np.abs(np.diff(run.command)[standing]).max() == 0.0
    assert run.road["station"][-1] == pytest.approx(WINDING.length, abs=2.0)


@pytest.mark.compiled
def test_friction_lies_at_its_place_whatever_the_time():
    """A car that starts late meets a slippery patch where it lies."""
    friction = Along.through([0.0, 100.0], [0.9, 0.2], "steps")
    patch = at.Road.from_segments([Line(length=200.0)], name="patch", friction=friction)
    run = at.rollout(PLANT, at.MPC(CAR, profile="road"), at.RoadDrive(patch, 15.0), profile="road")
    signals = at.RoadDrive(patch, 15.0).sample(0.05)
    assert signals.friction[signals.station < 99.0].min() == pytest.approx(0.9)
    assert signals.friction[signals.station > 101.0].max() == pytest.approx(0.2)
    assert run.failed is None


# -- sets of drives ---------------------------------------------------------------------------------------------------
def drives_of_two_lengths():
    return [
        at.RoadDrive(HAIRPIN, 6.0),
        at.RoadDrive(WINDING, at.plan_speed(WINDING, CAR)),
        at.load_scenario("lane-change"),
    ]


@pytest.mark.parametrize("law", ["informed", "lqr"])
def test_a_drive_among_longer_and_straight_ones_is_what_it_is_alone(law):
    controller = at.MPC(CAR, profile="road") if law == "informed" else LAWS[law](CAR, period=0.05, preview=True)
    straight = at.Road.from_segments([Line(length=HAIRPIN.length)], name="straight")
    several = [*drives_of_two_lengths()[: 2 if law == "informed" else 3], at.RoadDrive(straight, 6.0)]
    among = at.rollout_batch(PLANT, controller, several, profile="road", seeds=7)
    for k, drive in enumerate(several):
        alone = at.rollout_batch(PLANT, controller, drive, profile="road", seeds=7)
        for name in ("mse", "mean_squared_move", "max_abs_error", "steps"):
            assert getattr(among, name)[k] == getattr(alone, name)[0]
        assert among.failed[k] is None
        run = at.rollout(PLANT, controller, drive, profile="road", seed=7)
        assert among.mse[k] == pytest.approx(np.mean(run.error**2), rel=1e-12)


def test_a_run_set_costs_drives_of_different_length_by_their_own_instants():
    mpc = at.MPC(CAR, profile="road")
    runs = RunSet(PLANT, mpc, [planned(WINDING), planned(HAIRPIN)], "road")
    assert runs.lengths[0] != runs.lengths[1]
    costs = runs.costs(mpc.tuning, [3])
    for k, scenario in enumerate(runs.scenarios):
        run = at.simulate(PLANT, mpc, scenario, profile="road", seed=3)
        exact = (run.error**2).mean() + runs.weight * (run.command_change**2).mean()
        assert costs[k] == pytest.approx(exact, rel=1e-9)
    with pytest.raises(at.InvalidInput, match="equal length"):
        runs.segments(mpc.tuning, 3, np.arange(2))


@pytest.mark.compiled
def test_one_tuning_for_several_roads_is_at_least_as_good_as_its_swarm_saw():
    mpc = at.MPC(CAR, profile="road")
    runs = RunSet(PLANT, mpc, [planned(HAIRPIN), planned(WINDING)], "road")
    best = tune_constant(runs, SwarmSettings(particles=8, generations=3), seed=1)
    assert runs.costs(np.tile(best.x, (2, 1)), [0]).mean() == pytest.approx(best.cost, rel=1e-9)
    assert best.cost == best.trace.min()
    assert best.evaluations == 24
    with pytest.raises(at.InvalidInput, match="noise_seeds: give at least one"):
        tune_constant(runs, noise_seeds=())


def test_a_law_retuned_in_a_batch_costs_what_it_costs_with_that_tuning():
    law = at.PurePursuit(CAR, period=0.05, preview=True)
    runs = RunSet(PLANT, at.MPC(CAR, profile="road"), drives_of_two_lengths()[:2], "road")
    costs = runs.drive(Policy(law, [[0.6, 4.0], [0.4, 3.0]]), [2])[:, 0]
    retuned = at.PurePursuit(CAR, lookahead_time=0.4, lookahead_min=3.0, period=0.05, preview=True)
    assert costs[0] == runs.drive(law, [2])[0, 0]
    assert costs[1] == runs.drive(retuned, [2])[1, 0] != runs.drive(law, [2])[1, 0]


def test_predicted_paths_are_kept_as_the_car_then_drives():
    drive, paths = at.RoadDrive(HAIRPIN, 6.0), PredictedPaths(every=0.3, points=5)
    run = at.simulate(PLANT, at.MPC(CAR, profile="paper"), drive, predicted=paths)
    assert np.diff(paths.time) == pytest.approx(0.3)
    assert paths.points.shape == (len(paths), 5, 2)
    for time, path in list(zip(paths.time, paths.points, strict=True))[:-8]:
        foretold = np.hypot(*np.diff(path, axis=0).T).sum()
        assert foretold > 1.0
        place = np.array([np.interp(time, run.t, values) for values in (run.X, run.Y)])
        passed = np.column_stack([run.X, run.Y])[run.t > time]
        for point in path[:3]:
            assert np.hypot(*(passed - point).T).min() < 0.25
            assert np.hypot(*(point - place)) > 0.2
