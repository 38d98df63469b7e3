"""Simulated planners: what they send and when, and drives of a tracker behind them."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.tracker.signals import TRACKER_SAMPLE
from adaptrack.drive.planner import PlannedController, SimulatedPlanner, arrival_times, make_planner
from adaptrack.road import Arc, Line, Stop, plan_speed
from adaptrack.road.road import Road
from adaptrack.road.speed import constant_speed

CAR = at.load_vehicle("midsize-sedan")
BEND = Road.from_segments([Line(length=100.0), Arc(length=200.0, curvature=0.01)])
STOPPING = at.RoadDrive(BEND, plan_speed(BEND, CAR, top_speed=12.0, end=0.0, stops=[Stop(120.0, 3.0)]))
CIRCLE = Road.from_segments([Arc(length=200.0, curvature=2.0 * math.pi / 200.0)], closed=True)
LAPS = at.RoadDrive(CIRCLE, plan_speed(CIRCLE, CAR, stops=[Stop(50.0, 2.0)]), laps=3)


def sample_on(drive, time, offset=0.0, turn=0.0, drift=0.0):
    """A sample of a car that is where the plan is at a time (s), aside (m), turned (rad), with a drift (rad)."""
    s, speed = map(float, drive.plan.motion(time))
    line, sample = drive.road.at(s), np.full(len(TRACKER_SAMPLE), math.nan)
    x, y = line.x - offset * np.sin(line.heading), line.y + offset * np.cos(line.heading)
    sample[:8] = time, time, x, y, line.heading + turn, speed, 0.0, math.tan(drift) * speed
    return sample


def columns(trajectory):
    """t, x, y, yaw and speed of the points of a trajectory."""
    return trajectory.points[:, :5].T


@pytest.mark.parametrize("drive", [STOPPING, LAPS], ids=["open", "laps"])
def test_a_plan_arrives_when_its_motion_is_there(drive):
    times = np.linspace(0.0, drive.duration, 400)
    s, speed = drive.plan.motion(times)
    moving = speed > 0.1
    np.testing.assert_allclose(arrival_times(drive.plan, s)[moving], times[moving], rtol=0, atol=1e-6)


@pytest.mark.parametrize("drive", [STOPPING, LAPS], ids=["open", "laps"])
def test_trajectories_on_the_line_are_places_times_and_speeds_of_the_plan_and_stand_at_its_stops(drive):
    run, longest_pause = SimulatedPlanner().begin(drive), 0.0
    for time in np.arange(0.0, drive.duration, 0.1):
        for trajectory, fallback in run.step(sample_on(drive, time)):
            t, x, y, yaw, speed = columns(trajectory)
            s, planned = drive.plan.motion(trajectory.stamp + t)
            line, is_known = drive.road.at(s), (trajectory.stamp + t >= 0.0) & (trajectory.stamp + t <= drive.duration)
            np.testing.assert_allclose(np.hypot(x - line.x, y - line.y)[is_known], 0.0, rtol=0, atol=1e-3)
            np.testing.assert_allclose(speed[is_known], planned[is_known], rtol=0, atol=1e-2)
            np.testing.assert_allclose(np.cos(yaw - line.heading), 1.0, rtol=0, atol=1e-6)
            assert (np.diff(t) >= 0.0).all()
            assert t[-1] == pytest.approx(
                4.0 if drive is LAPS else min(4.0, drive.duration - trajectory.stamp), abs=1e-6
            )
            assert fallback is None
            longest_pause = max(longest_pause, np.diff(t)[np.hypot(np.diff(x), np.diff(y)) == 0.0].max(initial=0.0))
    assert longest_pause == pytest.approx(drive.plan.stops[0].seconds)


@pytest.mark.parametrize("drift", [0.0, 0.03])
def test_trajectories_from_the_pose_begin_there_in_the_direction_of_motion_and_return_to_the_line(drift):
    drive = at.RoadDrive(BEND, constant_speed(BEND, 10.0))
    run = SimulatedPlanner(start="pose", spacing=0.01).begin(drive)
    ((trajectory, _),) = run.step(sample_on(drive, 0.0, offset=0.4, turn=-0.05, drift=drift))
    t, x, y, yaw, _ = columns(trajectory)
    assert (t[0], x[0], y[0]) == pytest.approx((0.0, 0.0, 0.4))
    assert yaw[0] == pytest.approx(drift - 0.05, abs=1e-4)
    np.testing.assert_allclose(yaw[1:-1], np.arctan2(np.gradient(y), np.gradient(x))[1:-1], rtol=0, atol=1e-4)
    np.testing.assert_allclose(y[x > 30.0], 0.0, rtol=0, atol=1e-12)  # 3 s at 10 m/s
    np.testing.assert_allclose(x, 10.0 * t, rtol=0, atol=1e-9)


def test_without_a_lateral_velocity_trajectories_from_the_pose_begin_parallel_to_the_line():
    run = SimulatedPlanner(start="pose").begin(STOPPING)
    ((trajectory, _),) = run.step(sample_on(STOPPING, 0.0, offset=0.4, turn=-0.05, drift=math.nan))
    assert trajectory.points[0, 2:4] == pytest.approx([0.4, 0.0])


def test_a_planner_that_starts_from_the_pose_leaves_a_stop_after_its_time():
    run, short = SimulatedPlanner(start="pose").begin(STOPPING), 0.05
    arrival = float(arrival_times(STOPPING.plan, np.array([120.0]))[0])
    begins = {}
    for time in np.arange(0.0, arrival + 5.0, 0.1):
        sample = sample_on(STOPPING, min(time, arrival))
        sample[: TRACKER_SAMPLE.x], sample[TRACKER_SAMPLE.x] = time, sample[TRACKER_SAMPLE.x] - short
        ((trajectory, _),) = run.step(sample)
        t, x, y, *_ = columns(trajectory)
        begins[round(time - arrival, 1)] = t[np.hypot(x - x[0], y - y[0]) < 2.0 * short].max()
    assert begins[1.0] == pytest.approx(2.0, abs=0.3)  # still to wait
    assert begins[4.0] == pytest.approx(0.0, abs=0.3)  # however long the car hesitates


def test_trajectories_arrive_after_delay_and_jitter_and_the_first_at_once():
    run, arrivals = SimulatedPlanner(delay=0.3, jitter=0.05).begin(STOPPING), []
    for time in np.arange(0.0, 5.0, 0.01):
        arrivals += [(time, trajectory.stamp) for trajectory, _ in run.step(sample_on(STOPPING, time))]
    times, stamps = np.array(arrivals).T
    np.testing.assert_allclose(stamps, 0.1 * np.arange(stamps.size), rtol=0, atol=1e-9)
    delays = times - stamps
    assert delays[0] == 0.0
    assert 0.25 <= delays[1:].min() < 0.27
    assert 0.33 < delays[1:].max() < 0.361  # at the next call


def test_noise_of_points_has_its_standard_deviation_and_is_new_each_time():
    run, exact = SimulatedPlanner(noise=0.05).begin(STOPPING), SimulatedPlanner().begin(STOPPING)
    samples = [sample_on(STOPPING, time) for time in np.arange(0.0, 5.0, 0.1)]
    noise = [
        (noisy.points - true.points)[:, 1:3]
        for sample in samples for (noisy, _), (true, _) in zip(run.step(sample), exact.step(sample), strict=True)
    ]  # fmt: skip
    assert np.std(np.concatenate(noise)) == pytest.approx(0.05, rel=0.05)
    assert abs(np.corrcoef(noise[3][:20].ravel(), noise[4][:20].ravel())[0, 1]) < 0.6


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("period", "'period' must be NAME=VALUE, with a name of period, delay"),
        ("frequency=10", "'frequency' must be NAME=VALUE"),
        ("delay=soon", r"^planner 'delay=soon': delay = 'soon': must be a finite number >= 0\.$"),
        ("delay=-1", r"^planner 'delay=-1': delay = -1.0 s: must be a finite number >= 0\.$"),
        ("start=here", r"^planner 'start=here': start = 'here': must be one of 'line', 'pose'\.$"),
        ("seed=1.5", r"^planner 'seed=1.5': seed = 1.5: must be a whole number >= 0\.$"),
        ("seed=four", r"^planner 'seed=four': seed = 'four': must be a whole number >= 0\.$"),
        ("period=", "'period' must be NAME=VALUE"),
        ("period=nan", "period = nan s: must be a finite number >= 0.001 and <= 1000"),
        ("spacing=0", "spacing = 0 m: must be a finite number >= 0.01 and <= 1000"),
        ("horizon=1e6", "horizon = 1000000.0 s: must be a finite number >= 0.01 and <= 100"),
    ],
)
def test_settings_that_no_planner_has_are_refused_by_name(text, message):
    with pytest.raises(at.InvalidInput, match=message):
        make_planner(text)


def test_a_planner_is_made_of_its_settings():
    planner = make_planner("period=0.2,delay=0.3,start=pose,seed=4")
    assert planner == SimulatedPlanner(period=0.2, delay=0.3, start="pose", seed=4)
    assert make_planner(" period = 1, seed=4, ") == SimulatedPlanner(period=1.0, seed=4)
    assert make_planner("") == SimulatedPlanner()


def planned(planner, profile="road"):
    """A controller behind a planner."""
    return PlannedController(at.MPC(CAR, profile=profile), at.SpeedControl(CAR), planner)


def test_a_scenario_without_a_road_has_no_planner():
    scenario = at.Scenario(name="straight", duration=8.0, reference=0.0, speed=15.0, friction=0.9)
    with pytest.raises(at.InvalidInput, match="'straight' has no road"):
        at.simulate(at.DualTrack(CAR), planned(SimulatedPlanner()), scenario, profile="road")


def test_noise_that_makes_a_trajectory_impossible_is_refused_with_the_time_and_a_remedy():
    drive = at.RoadDrive(BEND, constant_speed(BEND, 10.0))
    message = r"^planner: its trajectory at 0 s is impossible \(entry 1: the place jumps .*\): choose less noise"
    with pytest.raises(at.InvalidInput, match=message):
        at.simulate(at.DualTrack(CAR), planned(SimulatedPlanner(noise=20.0)), drive, profile="road")


@pytest.mark.compiled
def test_a_tracker_behind_a_planner_keeps_to_its_line_and_times_and_repeats_its_drive_to_the_bit():
    drive = at.RoadDrive(BEND, plan_speed(BEND, CAR, top_speed=12.0))
    controller = planned(SimulatedPlanner(delay=0.1))
    runs = [at.simulate(at.DualTrack(CAR), controller, drive, profile="road", seed=5) for _ in range(2)]
    run = runs[0]
    assert run.failed is None
    assert np.abs(run.road["offset"]).max() < 0.15
    late = run.t - arrival_times(drive.plan, run.road["station"])
    assert np.abs(late[run.t > 5.0]).max() < 0.3
    np.testing.assert_allclose(run.diagnostics["late"][run.t > 5.0], late[run.t > 5.0], rtol=0, atol=0.15)
    np.testing.assert_array_equal(run.command, runs[1].command)
    np.testing.assert_array_equal(run.diagnostics["requested_force"], runs[1].diagnostics["requested_force"])
    assert "delay=0.1" in run.meta["control"]["planner"]


@pytest.mark.compiled
def test_a_start_from_the_pose_hides_an_offset_that_a_start_on_the_line_does_not():
    road = Road.from_segments([Line(length=300.0)])
    drive = at.RoadDrive(road, constant_speed(road, 10.0), start_offset=0.5)
    offsets = []
    for start in ("line", "pose"):
        run = at.simulate(at.DualTrack(CAR), planned(SimulatedPlanner(start=start)), drive, profile="road")
        offsets.append(float(np.interp(1.0, run.t, run.road["offset"])))
    assert offsets[0] < 0.1 < 0.2 < offsets[1]
