"""What the sensors of a profile give: position along the road, speed and ages, against the true motion."""

import math

import numpy as np
import pytest
from scipy import stats

import adaptrack as at
from adaptrack.core.maths.random import counted_normal, counted_uniform
from adaptrack.core.models.contract import MEASUREMENT
from adaptrack.core.plants.contract import PLANT_STATE, state_at
from adaptrack.core.simulation.world import PAST_SIGNAL
from adaptrack.drive.closed_loop import ClosedLoop
from adaptrack.drive.world import World
from adaptrack.road import Arc, Line
from adaptrack.scenario.shapes import Knots

pytestmark = pytest.mark.kernels
PLANT, PERIOD = at.SingleTrack(at.load_vehicle("paper")), 0.05
PRODUCTION, BUS = at.load_profile("production"), at.load_profile("production-bus")
SILENT = at.load_profile("road").replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)
RAMP = at.Scenario(name="ramp", duration=4.0, reference=0.0, speed=Knots(points=((0.0, 1.0), (4.0, 9.0))), friction=0.9)
CRUISE = RAMP.replace(name="cruise", speed=10.0)
CURVATURE = 0.02
LONG = at.RoadDrive(at.Road.from_segments([Line(length=1000.0)]), 10.0)
CIRCLE = at.RoadDrive(
    at.Road.from_segments([Arc(length=2.0 * math.pi / CURVATURE, curvature=CURVATURE)], closed=True), 10.0, laps=3
)


class Readings:
    """Arrays of a drive by name: `MEASUREMENT`, the memory of the loop and the true yaw, yaw rate and speed."""

    def __init__(self, profile, drive=CRUISE, instants=80, seed=3):
        world = World.of(
            PLANT, at.Stanley(PLANT.vehicle, period=PERIOD), profile, None, None, at.FailureLimits(distance=1e3)
        )
        self.loop, rows = ClosedLoop(world, drive, seed), {}
        memory, block = self.loop.run.memory.drives, self.loop.run.vehicles.block
        steering = 0.0
        for k in range(instants):
            if k:
                assert self.loop.send(float(steering))
            sample = self.loop.sensed
            row = {f"measured_{name}": sample.measured[i] for i, name in enumerate(MEASUREMENT._fields)}
            row |= {name: memory[name][0] for name in memory.dtype.names}
            row |= {
                f"true_{name}": block[state_at(getattr(PLANT_STATE, name), 0)]
                for name in ("x", "yaw", "yaw_rate", "vx")
            }
            for name, value in row.items():
                rows.setdefault(name, []).append(value)
            bend = CURVATURE if drive is CIRCLE else 0.003 * math.sin(0.3 * k)
            steering = 2.8 * bend - 0.05 * memory["offset"][0] - 0.5 * memory["heading_error"][0]
        self.t = PERIOD * np.arange(instants)
        for name, values in rows.items():
            setattr(self, name, np.array(values))

    def before(self, name, age):
        """A true signal (n,) as it was an age (s) ago, a number or (n,)."""
        return np.interp(self.t - age, self.t, getattr(self, name))


def test_a_late_speed_lags_a_ramp_by_its_age_times_the_acceleration():
    for age in (0.05, 0.13):
        run = Readings(SILENT.replace(speed_age=age), RAMP)
        settled = run.t > age
        np.testing.assert_allclose((run.true_vx - run.speed)[settled], 2.0 * age, rtol=0, atol=1e-9)
        np.testing.assert_allclose(run.speed_age, np.minimum(run.t, age), rtol=0, atol=1e-12)
        assert not run.measured_motion_age.any()


def test_measured_speeds_are_the_nearest_multiples_of_the_resolution():
    run = Readings(SILENT.replace(speed_resolution=0.25), RAMP)
    assert not np.mod(run.speed, 0.25).any()
    assert np.abs(run.speed - run.true_vx).max() <= 0.125 + 1e-12
    assert len(set(run.speed)) > 20


def test_speeds_below_the_dead_zone_read_zero_and_others_as_they_are():
    run = Readings(SILENT.replace(speed_dead_zone=3.0), RAMP)
    np.testing.assert_array_equal(run.speed, np.where(run.true_vx < 3.0, 0.0, run.true_vx))
    coarse = Readings(SILENT.replace(speed_dead_zone=3.1, speed_resolution=0.5, noise_speed_floor=0.2), RAMP)
    assert coarse.speed[coarse.speed > 0.0].min() == 3.5
    assert (coarse.speed == 0.0).sum() > 10


def test_speed_noise_is_a_share_of_the_speed_and_an_independent_floor():
    run = Readings(SILENT.replace(noise_speed=0.02, noise_speed_floor=0.15), LONG, 1500)
    assert np.std(run.speed - run.true_vx) == pytest.approx(math.hypot(0.02 * 10.0, 0.15), rel=0.06)


def test_ages_are_uniform_within_their_spread_and_equal_in_one_message():
    run = Readings(BUS, LONG, 1500)
    age = run.measured_motion_age[3:]
    assert age.min() >= 0.08 - 1e-12
    assert age.max() <= 0.12 + 1e-12
    assert stats.kstest((age - 0.08) / 0.04, "uniform").pvalue > 0.01
    assert abs(np.corrcoef(age[1:], age[:-1])[0, 1]) < 0.1
    np.testing.assert_array_equal(run.measured_pose_age, run.measured_motion_age)
    np.testing.assert_array_equal(run.measured_pose_age, run.speed_age)


def test_a_motion_sample_is_that_of_its_age():
    run = Readings(SILENT.replace(motion_age=0.1, motion_age_spread=0.1))
    np.testing.assert_allclose(
        run.measured_yaw_rate, run.before("true_yaw_rate", run.measured_motion_age), rtol=0, atol=1e-12
    )
    assert not run.measured_pose_age.any()


def test_the_error_of_the_station_has_the_standard_deviation_of_its_noise():
    run = Readings(SILENT.replace(noise_station=0.2, station_age=0.1, pose_age=0.1, pose_age_spread=0.02), LONG, 1500)
    error = run.station_estimate - run.station
    assert np.std(error) == pytest.approx(0.2, rel=0.06)
    assert abs(error.mean()) < 0.02
    np.testing.assert_array_equal(run.loop.road_ahead(10.0).station, run.station_estimate[-1])


def test_a_late_station_is_carried_forward_by_its_age_with_the_measured_speed():
    """With an acceleration a, x(t - T) + T v(t) lies a T^2/2 ahead of x(t)."""
    prompt = Readings(SILENT.replace(station_age=0.1), RAMP)
    settled = prompt.t > 0.1
    ahead = (prompt.station_estimate - prompt.true_x)[settled]
    np.testing.assert_allclose(ahead, 2.0 * 0.1**2 / 2.0, rtol=0, atol=1e-4)
    late = Readings(SILENT.replace(station_age=0.1, speed_age=0.1), RAMP)
    behind = (late.true_x - late.station_estimate)[settled]
    np.testing.assert_allclose(behind, 2.0 * 0.1**2 / 2.0, rtol=0, atol=1e-4)


def test_without_a_pose_the_estimated_station_moves_on_with_the_measured_speed():
    gaps = {"dropout_pause": 1.0, "dropout_least": 0.5, "dropout_most": 0.5}
    run = Readings(SILENT.replace(noise_station=0.3, speed_resolution=3.0, **gaps), LONG, 200)
    blind = np.isnan(run.measured_y)
    assert blind.sum() > 20
    step = np.diff(run.station_estimate)
    np.testing.assert_allclose(step[blind[1:]], 9.0 * PERIOD, rtol=0, atol=1e-9)
    assert np.std(step[~blind[1:]]) > 0.2


def test_in_a_bend_the_heading_error_counts_from_the_road_at_the_measured_position():
    """A yaw angle without noise is the road's heading at the measured position and the measured error."""
    run = Readings(SILENT.replace(noise_station=0.5, pose_age=0.1, station_age=0.1), CIRCLE, 200)
    yaw = float(CIRCLE.road.at(0.0).heading) + CURVATURE * run.pose_station + run.measured_yaw
    settled = run.t > 0.1
    turns = (yaw - run.before("true_yaw", 0.1))[settled] / (2.0 * math.pi)
    np.testing.assert_allclose(turns, np.round(turns), rtol=0, atol=1e-6)
    np.testing.assert_allclose(
        np.cumsum(run.measured_turned), CURVATURE * (run.station_estimate - run.station_estimate[0]), rtol=0, atol=1e-6
    )
    noise = run.measured_yaw - run.before("heading_error", 0.1)
    assert np.std(noise[settled]) == pytest.approx(CURVATURE * 0.5, rel=0.15)


def test_noise_of_station_and_speed_leaves_the_draws_of_all_other_sensors():
    quiet = Readings(PRODUCTION)
    loud = Readings(PRODUCTION.replace(noise_station=0.3, noise_speed_floor=0.1))
    for name in MEASUREMENT._fields:
        np.testing.assert_array_equal(getattr(quiet, f"measured_{name}"), getattr(loud, f"measured_{name}"))
    assert np.abs(quiet.speed - loud.speed).max() > 0.1


def test_production_has_the_true_station_and_the_same_random_numbers_as_before_to_the_bit():
    """Its readings are composed here from counted random numbers and the true motion."""
    run, seed = Readings(PRODUCTION, CIRCLE), 3
    np.testing.assert_array_equal(run.station_estimate, run.station)
    np.testing.assert_array_equal(run.measured_turned, run.turned)
    assert not run.measured_motion_age.any()
    assert not run.speed_age.any()
    for k in range(4, len(run.t)):
        noise = [counted_normal(seed, k, channel) for channel in range(len(PAST_SIGNAL))]
        assert run.speed[k] == run.true_vx[k] + run.true_vx[k] * (0.0 + 0.01 * noise[6])
        age = 0.1 + 0.02 * (2.0 * counted_uniform(seed, 0, k, 0, 0) - 1.0)
        assert run.measured_pose_age[k] == age
        instants = math.floor(age / PERIOD)
        later, earlier = (run.offset[k - instants - i] for i in (0, 1))
        if np.isfinite(run.measured_y[k]):
            assert run.measured_y[k] == later + (age / PERIOD - instants) * (earlier - later) + 0.03 * noise[3]
    offset = 0.003 * (2.0 * counted_uniform(seed, 4, MEASUREMENT.yaw_rate, 0, 0) - 1.0)
    expected = [r + 0.002 * counted_normal(seed, k, 2) + offset for k, r in enumerate(run.true_yaw_rate)]
    np.testing.assert_array_equal(run.measured_yaw_rate, expected)
