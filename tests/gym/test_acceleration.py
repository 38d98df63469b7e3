"""An agent that commands the acceleration moves its car by the forces of its drive and brakes."""

import copy
import math
import pickle

import numpy as np
import pytest

import adaptrack as at

gymnasium = pytest.importorskip("gymnasium", reason="needs Gymnasium: pip install 'adaptrack[gym]'")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import adaptrack.gym  # noqa: E402
from adaptrack.gym import MPCTuningEnv, PathTrackingEnv, PathTrackingVectorEnv  # noqa: E402
from adaptrack.road import Line, Stop  # noqa: E402
from episodes import STEP, same_as_alone  # noqa: E402

pytestmark = pytest.mark.compiled
STRAIGHT = at.Road.from_segments([Line(length=600.0)], name="straight")


def straight_env(grade=0.0, speed=10.0, profile="paper"):
    return PathTrackingEnv(road=at.RoadDrive(STRAIGHT.replace(grade=grade), speed), profile=profile, acceleration=True)


def speeds_under(env, accelerations):
    """True speeds (m/s) before each action and after the last one."""
    env.reset(seed=1)
    vx = []
    for acceleration in accelerations:
        vx.append(float(env._loop.run.vehicles.block[3 * 32]))
        env.step([0.0, acceleration])
    return np.array([*vx, float(env._loop.run.vehicles.block[3 * 32])])


@pytest.mark.parametrize("acceleration", [-2.0, 0.0, 1.5])
@pytest.mark.parametrize("grade", [-0.05, 0.0, 0.05])
def test_an_ideal_car_gains_speed_by_acceleration_times_time_on_every_slope(acceleration, grade):
    env = straight_env(grade)
    speeds = speeds_under(env, [acceleration] * 40)
    time = env.task.base_profile.period * np.arange(41)
    assert speeds == pytest.approx(10.0 + acceleration * time, abs=0.01)


def test_behind_dead_time_and_lag_the_speed_is_the_analytic_response_of_the_drive():
    env = straight_env(profile="road")
    drive, period = env.task.base_profile.drive, env.task.base_profile.period
    assert drive.lag > 0.0
    at_rest, pulled = (speeds_under(env, [acceleration] * 30) for acceleration in (0.0, 1.5))
    time = np.maximum(period * np.arange(31) - drive.dead_time, 0.0)
    assert pulled - at_rest == pytest.approx(1.5 * (time - drive.lag * (1.0 - np.exp(-time / drive.lag))), abs=0.01)


@pytest.mark.parametrize("profile", ["paper", "road"])
@pytest.mark.parametrize("grade", [-0.1, 0.1])
def test_a_car_that_was_braked_to_rest_stays_there_and_starts_uphill_without_rolling_back(grade, profile):
    env = straight_env(grade, 5.0, profile)
    period = env.task.base_profile.period
    stopping = round(4.0 / period)
    speeds = speeds_under(env, [-3.0] * stopping + [0.0] * stopping + [0.5] * stopping)
    assert not speeds[stopping : 2 * stopping + 1].any()
    assert speeds.min() > -1e-3
    assert speeds[-1] == pytest.approx(2.0, abs=0.5)


def test_the_cost_has_speed_error_and_change_of_the_acceleration():
    env = straight_env()
    weights = env._speed.speed_weight, env._speed.acceleration_weight
    env.reset(seed=1)
    rewards = [env.step([0.0, 1.0])[1] for _ in range(3)]
    gained = env.task.base_profile.period * np.arange(3)
    assert rewards == pytest.approx(-weights[0] * gained**2 - weights[1] * np.array([1.0, 0.0, 0.0]), abs=1e-5)


def test_planned_speeds_ahead_are_those_of_the_plan_also_beyond_a_stop_that_is_passed():
    car = at.load_vehicle("paper")
    road = STRAIGHT.replace(grade=0.0)
    plan = at.plan_speed(road, car, stops=[Stop(60.0, 2.0)])
    env = PathTrackingEnv(road=at.RoadDrive(road, plan), profile="paper", acceleration=True, distances=(0.0, 30.0))
    observation, _ = env.reset(seed=1)
    run = env._loop.run
    while run.memory.drives["station"][0] < 200.0:
        station = float(run.memory.drives["station"][0])
        assert observation[-2:] == pytest.approx(plan.at(np.array([station, station + 30.0])), abs=0.5)
        observation, *_ = env.step([0.0, 1.0])
    signals = env._loop.signals
    assert signals.station[run.memory.drives["place"][0]] == pytest.approx(200.0, abs=5.0)


@pytest.mark.parametrize(
    "options", [{}, {"random_cars": True, "profile": "production"}, {"road": "country:3", "length": 100.0}], ids=str
)
def test_a_car_has_the_same_run_alone_and_among_others_to_the_bit(options):
    task = {"road": STEP, "acceleration": True, **options}
    same_as_alone(
        PathTrackingVectorEnv(3, **task), lambda: PathTrackingEnv(**task),
        lambda row: [np.clip(-0.02 * row[0] - 0.3 * row[1], -0.5, 0.5), np.clip(row[-5] - row[3] - 0.1, -2.0, 1.0)],
    )  # fmt: skip


def test_gymnasium_only_recommends_to_rescale_accelerations_in_si_units():
    with pytest.warns(UserWarning, match="symmetric and normalized") as warnings:
        check_env(PathTrackingEnv(road=STEP, acceleration=True), skip_render_check=True)
    assert len(warnings) == 1


@pytest.mark.parametrize(
    "make", [lambda: straight_env(profile="road"), lambda: PathTrackingVectorEnv(2, road=STEP, acceleration=True)]
)
def test_copies_and_unpickled_environments_continue_alike(make):
    env = make()
    env.reset(seed=3)
    actions = np.broadcast_to([0.01, 0.7], env.action_space.shape)
    for _ in range(5):
        env.step(actions)
    copies = copy.deepcopy(env), pickle.loads(pickle.dumps(env))
    for _ in range(5):
        expected = env.step(actions)
        for twin in copies:
            assert np.array_equal(twin.step(actions)[0], expected[0])


def test_the_offset_is_positive_to_the_left_of_the_path_in_both_environments():
    scenario = STEP.replace(duration=1.0)
    for env in (PathTrackingEnv(road=scenario), MPCTuningEnv(road=scenario)):
        observation, _ = env.reset(seed=1)
        run = env._loop.run
        expected = run.measured[0, 3] - run.inputs.signals[0, 0, 0]
        assert observation[env.names.index("offset")] == expected


@pytest.mark.parametrize(("options", "message"), [
    ({"driver": at.Driver()}, "leave the driver out"),
    ({"speed_weight": -1.0}, "speed_weight"),
    ({"acceleration_weight": math.inf}, "acceleration_weight"),
])  # fmt: skip
def test_what_makes_no_environment_is_refused(options, message):
    with pytest.raises(at.InvalidInput, match=message):
        PathTrackingEnv(road=STEP, acceleration=True, **options)
