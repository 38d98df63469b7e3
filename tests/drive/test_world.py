"""The world around a controller: dead time, sensors with ages, gaps and offsets, a steering bias, a banked road."""

import math

import numpy as np
import pytest

import adaptrack as at
from small_controllers import Scripted

pytestmark = pytest.mark.compiled  # whole drives
CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR, "magic-formula")
SILENT = at.load_profile("road").replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0, delay=0)
STRAIGHT = at.Scenario(name="straight", duration=8.0, reference=0.0, speed=15.0, friction=0.9)


def drive(profile, command=0.0, scenario=STRAIGHT, seed=3):
    """The trajectory, and what the controller was told (n, 5): x_c and the speed."""
    controller = Scripted(lambda t: command)
    run = at.simulate(
        PLANT, controller, scenario, profile=profile, seed=seed, failure=at.FailureLimits(distance=1000.0)
    )
    return run, np.array(controller.samples)


@pytest.mark.parametrize("delay", [0, 1])
@pytest.mark.parametrize("dead_time", [0.0, 0.03, 0.05, 0.085, 0.21])
def test_a_command_acts_after_its_dead_time_whole_periods_or_not(delay, dead_time):
    lag, command = 0.15, 0.02
    steering = at.SteeringActuator(lag=lag, dead_time=dead_time)
    run, _ = drive(SILENT.replace(steering=steering, delay=delay), command)
    since = np.maximum(run.t - dead_time - 0.05 * delay, 0.0)
    np.testing.assert_allclose(run.steering, command * (1.0 - np.exp(-since / lag)), rtol=0, atol=1e-6)


def test_the_wheels_turn_by_the_bias_beyond_the_command():
    run, _ = drive(SILENT.replace(steering=at.SteeringActuator(lag=0.1, bias=0.01)), 0.02)
    assert run.steering[-1] == pytest.approx(0.03, abs=1e-9)


def test_late_samples_are_those_of_the_time_at_which_they_were_taken():
    run, samples = drive(SILENT.replace(pose_age=0.12, motion_age=0.05), 0.01)
    for column, name, age in ((0, "vy", 0.05), (1, "psi", 0.12), (2, "yaw_rate", 0.05), (3, "Y", 0.12)):
        then = np.interp(np.maximum(run.t - age, 0.0), run.t, getattr(run, name))
        np.testing.assert_allclose(samples[:, column], then, rtol=0, atol=1e-12)


def test_the_age_of_a_pose_varies_within_its_spread():
    run, samples = drive(SILENT.replace(pose_age=0.1, pose_age_spread=0.04), 0.01)
    age = run.t - np.interp(samples[:, 3], run.Y, run.t)
    settled = run.t > 2.0  # where the car moves sideways at a brisk pace
    assert 0.06 - 1e-6 <= age[settled].min() < 0.07
    assert 0.13 < age[settled].max() <= 0.14 + 1e-6


def test_a_gyro_keeps_its_offset_over_a_run_and_gets_another_in_the_next():
    offsets = []
    for seed in range(40):
        run, samples = drive(SILENT.replace(bias_yaw_rate=0.003), seed=seed)
        error = samples[:, 2] - run.yaw_rate
        assert np.ptp(error) < 1e-15
        offsets.append(error[0])
    assert np.abs(offsets).max() <= 0.003
    assert np.std(offsets) == pytest.approx(0.003 / math.sqrt(3.0), rel=0.3)


def test_a_sensor_that_is_not_there_gives_nothing():
    _, samples = drive(SILENT.replace(noise_vy=math.inf))
    assert np.isnan(samples[:, 0]).all()
    assert np.isfinite(samples[:, 1:]).all()


def test_an_mpc_that_estimates_nothing_is_refused_where_its_state_is_not_measured():
    with pytest.raises(at.InvalidInput, match=r"production.* does not measure vy"):
        at.simulate(PLANT, at.published_mpc(CAR, period=0.05), STRAIGHT, profile="production")


def test_a_pose_drops_out_as_often_and_as_long_as_the_profile_says():
    profile = SILENT.replace(dropout_pause=2.0, dropout_least=0.2, dropout_most=0.5)
    _, samples = drive(profile, scenario=STRAIGHT.with_duration(400.0))
    missing = np.isnan(samples[:, 3])
    np.testing.assert_array_equal(missing, np.isnan(samples[:, 1]))
    edges = np.flatnonzero(np.diff(missing.astype(int), prepend=0, append=0)).reshape(-1, 2)
    lengths = 0.05 * (edges[:, 1] - edges[:, 0])
    assert lengths.min() >= 0.2 - 1e-9
    assert np.median(lengths) == pytest.approx(0.35, abs=0.08)
    assert len(lengths) == pytest.approx(400.0 / 2.35, rel=0.25)


def test_a_share_of_the_samples_is_missing():
    _, samples = drive(SILENT.replace(missing=0.3), scenario=STRAIGHT.with_duration(100.0))
    for column in range(4):
        assert np.isnan(samples[:, column]).mean() == pytest.approx(0.3, abs=0.04)


def test_the_measured_speed_is_off_by_its_share():
    run, samples = drive(SILENT.replace(noise_speed=0.01), scenario=STRAIGHT.with_duration(60.0))
    assert np.std(samples[:, 4] / run.vx - 1.0) == pytest.approx(0.01, rel=0.1)


@pytest.mark.parametrize("speed", [10.0, 20.0, 27.0])
@pytest.mark.parametrize(("bias", "bank"), [(0.01, 0.0), (0.0, 0.05), (0.01, 0.05)])
def test_a_steering_bias_and_a_banked_road_leave_no_offset(speed, bias, bank):
    profile = SILENT.replace(delay=1, steering=SILENT.steering.replace(bias=bias))
    scenario = STRAIGHT.replace(speed=speed, bank=bank, duration=60.0)
    run = at.rollout(PLANT, at.MPC(CAR, profile=profile), scenario, profile=profile)
    assert np.abs(run.Y[-400:]).mean() < 1e-3


def test_a_banked_road_is_mirrored_and_written_with_the_scenario(tmp_path):
    banked = STRAIGHT.replace(bank=0.05)
    assert banked.mirrored().sample(0.1).bank[0] == -0.05
    banked.to_toml(tmp_path / "banked.toml")
    assert at.load_scenario(tmp_path / "banked.toml").sample(0.1).bank[0] == 0.05
    assert "bank" not in STRAIGHT.to_dict()
