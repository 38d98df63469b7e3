"""The environments drive what `simulate` drives, one car as 64, and keep Gymnasium's contract."""

import math
from types import SimpleNamespace as Answer

import numpy as np
import pytest

import adaptrack as at

gymnasium = pytest.importorskip("gymnasium", reason="needs Gymnasium: pip install 'adaptrack[gym]'")

from gymnasium.utils.env_checker import check_env  # noqa: E402

import adaptrack.gym  # noqa: E402
from adaptrack.gym import (  # noqa: E402
    MPCTuningEnv,
    MPCTuningVectorEnv,
    PathTrackingEnv,
    PathTrackingVectorEnv,
)
from adaptrack.gym.mpc_tuning import make_mpc  # noqa: E402
from episodes import STEP, same_as_alone  # noqa: E402
from foreign_loop import example  # noqa: E402

SHORT = {"road": "country:3", "length": 100.0}
TUNING = (25.0, 6.0, 1.5)  # Np, Nc, log10 R/Q


class Law(at.Controller):
    """A linear law on measured offset and heading error; a sample that is missing keeps its last value."""

    name, period = "linear", 0.05

    def __init__(self, period):
        self.period = period
        self.reset()

    def reset(self):
        self.y = self.yaw = 0.0

    def command(self, y, yaw):
        self.y, self.yaw = (new if math.isfinite(new) else old for new, old in ((y, self.y), (yaw, self.yaw)))
        return float(np.clip(-0.02 * self.y - 0.3 * self.yaw, -0.5, 0.5))

    def step(self, state, speed, reference, variables=None, road=None):
        return Answer(angle=self.command(state[3] - reference[0], state[1]), move=0.0)

    def describe(self):
        return {}


def drive(env, act, **reset):
    """The observations, rewards and last info of an episode, the first info, and its last flags."""
    observation, first = env.reset(**reset)
    rewards, all_seen, over = [], [observation], False
    while not over:
        observation, reward, terminated, truncated, info = env.step(act(observation))
        rewards.append(reward)
        all_seen.append(observation)
        over = terminated or truncated
    return np.array(all_seen), np.array(rewards), first, info, (terminated, truncated)


# -- the same run as simulate -----------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("profile", ["paper", "road", "production"])
def test_a_law_that_steers_the_environment_has_the_run_of_simulate_to_the_bit(profile):
    env = PathTrackingEnv(car="van", profile=profile, **SHORT)
    law = Law(at.load_profile(profile).period)
    observations, rewards, first, info, flags = drive(env, lambda row: [law.command(row[0], row[1])], seed=5)
    law.reset()
    car = at.load_vehicle("van")
    run = at.simulate(
        at.get_plant("dual-track", car), law, env.task.drive(0, car), profile=profile, driver=at.Driver(),
        seed=first["noise_seed"],
    )  # fmt: skip
    assert np.array_equal(observations[1:, 5], run.command[np.isfinite(run.command)])
    assert info["failed"] == (run.failed or "")
    assert flags == (bool(run.failed), not run.failed)
    cost = at.compute_metrics(run, move_weight=at.load_profile(profile).move_weight).cost
    assert info["J"] == pytest.approx(cost, rel=1e-12)
    assert run.failed or rewards.sum() == pytest.approx(-cost * len(run), rel=1e-12)


@pytest.mark.compiled
def test_a_constant_choice_has_the_run_of_simulate_with_that_tuning_to_the_bit():
    env = MPCTuningEnv(car="van", every=7, **SHORT)
    action = env.tunings.action(*TUNING)
    _, rewards, first, info, _ = drive(env, lambda row: action, seed=6)
    car, entries = at.load_vehicle("van"), env.tunings.entries(action)
    assert entries == pytest.approx([25, 6, 1.0, 10.0**1.5], rel=1e-12)
    mpc = make_mpc("informed", car, at.load_profile("road"), lambda variables: entries)
    run = at.simulate(
        at.get_plant("dual-track", car), mpc, env.task.drive(0, car), profile="road", driver=at.Driver(),
        seed=first["noise_seed"],
    )  # fmt: skip
    cost = at.compute_metrics(run, move_weight=at.load_profile("road").move_weight).cost
    assert info["J"] == pytest.approx(cost, rel=1e-12)
    assert len(rewards) == math.ceil(len(run) / 7)


# -- many cars --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("options", [{}, {"random_cars": True}, {"profile": "production"}], ids=str)
def test_a_steered_car_has_the_same_run_alone_and_among_others_to_the_bit(options):
    task = {"road": STEP, **options}
    law = Law(0.05)
    same_as_alone(
        PathTrackingVectorEnv(3, **task), lambda: PathTrackingEnv(**task), lambda row: [law.command(row[0], row[1])]
    )


@pytest.mark.compiled
@pytest.mark.parametrize("controller", ["informed", "informed-learning", "as-written"])
def test_a_tuned_car_has_the_same_run_alone_and_among_others_to_the_bit(controller):
    task = {"road": [STEP, STEP.replace(name="shorter", duration=2.9)], "controller": controller}
    same_as_alone(MPCTuningVectorEnv(2, **task), lambda: MPCTuningEnv(**task), lambda row: [-0.3, -0.5, 0.1 * row[6]])


@pytest.mark.compiled
def test_threads_and_blocks_change_nothing():
    actions = np.random.default_rng(3).uniform(-0.05, 0.05, (60, 40, 1))
    runs = []
    for threads in (1, 2):
        envs = PathTrackingVectorEnv(40, threads=threads, road=STEP)
        envs.reset(seed=1)
        runs.append(np.array([np.column_stack([*envs.step(row)[:2]]) for row in actions]))
        envs.close()
    assert np.array_equal(*runs)


# -- Gymnasium's contract ---------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("name", ["adaptrack/PathTracking-v0", "adaptrack/MPCTuning-v0"])
@pytest.mark.parametrize("options", [{}, {"random_cars": True, "profile": "production"}], ids=str)
def test_gymnasium_finds_nothing_to_say(name, options):
    check_env(gymnasium.make(name, road=STEP, **options).unwrapped, skip_render_check=True)


@pytest.mark.compiled
def test_a_seed_is_a_run_and_other_episodes_have_other_noise():
    env = PathTrackingEnv(road=STEP)
    first, again, other = (drive(env, lambda row: [0.01], seed=seed) for seed in (1, 1, 2))
    assert np.array_equal(first[0], again[0])
    assert not np.array_equal(first[0], other[0])
    following = drive(env, lambda row: [0.01])
    assert following[2]["noise_seed"] not in (first[2]["noise_seed"], other[2]["noise_seed"])
    chosen = drive(env, lambda row: [0.01], options={"noise_seed": first[2]["noise_seed"]})
    assert np.array_equal(first[0], chosen[0])


@pytest.mark.compiled
def test_random_cars_differ_and_a_car_can_be_chosen():
    env = PathTrackingEnv(road=STEP, random_cars=True)
    _, first = env.reset(seed=1)
    _, second = env.reset()
    assert first["car"] != second["car"]
    assert env.reset(options={"car_seed": first["car_seed"]})[1]["car"] == first["car"]


# -- failure ----------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_a_car_that_leaves_the_road_has_failed_and_pays_for_the_rest_of_it():
    env = PathTrackingEnv(**SHORT)
    _, rewards, _, info, flags = drive(env, lambda row: [0.5], seed=1)
    assert flags == (True, False)
    assert info == {"failed": info["failed"], "J": math.inf}
    assert info["failed"] in ("off-road", "spun")
    left = env._loop.signals.n - len(rewards)
    assert rewards[-1] == pytest.approx(-25.0 * left, abs=25.0)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step([0.0])


class Breaking(at.SteppedPlant):
    """Goes straight on for 20 steps, then nowhere."""

    vehicle = at.load_vehicle("paper")

    def reset(self, motion):
        self.motion, self.steps = motion, 0

    def step(self, dt, steering, acceleration, environment):
        self.steps += 1
        self.motion[0] += dt * self.motion[3] if self.steps < 20 else math.nan
        return self.motion


@pytest.mark.compiled
def test_a_simulator_in_python_is_driven_and_what_is_seen_of_its_breakdown_is_finite():
    env = PathTrackingEnv(car=Breaking(), road="country:3")
    observations, _, _, info, flags = drive(env, lambda row: [0.0], seed=1)
    assert (info["failed"], *flags) == ("not-finite", True, False)
    assert all(env.observation_space.contains(row) for row in observations)


@pytest.mark.compiled
def test_a_simulator_in_python_is_not_driven_among_many():
    with pytest.raises(at.InvalidInput, match="compiled"):
        PathTrackingVectorEnv(2, car=Breaking(), road=STEP).reset()


@pytest.mark.compiled
def test_what_is_seen_of_a_bend_is_its_curvature():
    road = at.generate_road("country", seed=3, length=200.0)
    env = PathTrackingEnv(road=at.RoadDrive(road, 10.0), distances=(0.0, 30.0))
    observations, *_ = drive(env, lambda row: [0.0], seed=1)
    assert env.names[-2:] == ("curvature_0m", "curvature_30m")
    assert observations[0, -2:] == pytest.approx(road.at(np.array([0.0, 30.0])).curvature, abs=1e-9)


# -- what is refused --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("options", "message"), [
    ({"road": []}, "road = "),
    ({"road": 3}, "road = 3"),
    ({"car": 3}, "car = 3"),
    ({"car": at.UserPlant(lambda x, u, environment, p, dx: None, {}, 1500.0)}, r"UserPlant\(..., vehicle="),
    ({"car": at.load_vehicle("van"), "random_cars": True}, "random_cars: car = "),
    ({"failure_cost": -1.0}, "failure_cost"),
    ({"failure_cost": "high"}, "Task: failure_cost = 'high'"),
    ({"distances": (-1.0,)}, "distances"),
])  # fmt: skip
def test_what_makes_no_environment_is_refused(options, message):
    with pytest.raises(at.InvalidInput, match=message):
        PathTrackingEnv(**{"road": STEP, **options})


@pytest.mark.compiled
def test_what_is_no_action_is_refused():
    single, several = PathTrackingEnv(road=STEP), PathTrackingVectorEnv(2, road=STEP)
    for env in (single, several):
        env.reset()
        for action in ([math.nan], [0.0, 0.0], 0.0, "left", ["left"], None, object(), [object()], [1j], [10**400]):
            with pytest.raises(at.InvalidInput, match="action"):
                env.step(action)


@pytest.mark.parametrize("options", [{"seed": 3}, {"noise_seed": -1}, {"car_seed": 1}, {"road": 1}])
def test_what_is_no_option_is_refused(options):
    with pytest.raises(at.InvalidInput, match="reset"):
        PathTrackingEnv(road=STEP).reset(options=options)


def test_stepping_before_reset_is_refused():
    for env in (PathTrackingEnv(road=STEP), PathTrackingVectorEnv(2, road=STEP)):
        with pytest.raises(gymnasium.error.ResetNeeded):
            env.step(np.zeros(env.action_space.shape))


@pytest.mark.compiled
def test_a_few_generations_of_the_example_steer_better_than_nobody(capsys):
    pytest.importorskip("cma", reason="needs cma: pip install 'adaptrack[bench]'")
    learning = example("gym_learn_to_steer")
    nobody = np.exp(np.log(learning.costs(learning.JUDGED, np.zeros(len(learning.SCALE)), seed=7)).mean())
    assert learning.main(generations=3) < 0.1 * nobody
    assert [line.split("J =")[0].strip() for line in capsys.readouterr().out.splitlines()[-2:]] == [
        "pure-pursuit",
        "informed",
    ]
