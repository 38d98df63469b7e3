"""Copies and pickles of what drives: taken under way, also into a new process, they continue to the same bits."""

import copy
import math
import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at

pytestmark = pytest.mark.compiled

CAR = at.load_vehicle("van")
ROAD = at.generate_road("country", seed=3, length=150.0)
DRIVE = at.RoadDrive(ROAD, at.plan_speed(ROAD, CAR))
COPIES = {"deepcopy": copy.deepcopy, "pickle": lambda driver: pickle.loads(pickle.dumps(driver))}
every_copy = pytest.mark.parametrize("make_copy", COPIES.values(), ids=COPIES)


class Proportional(at.Controller):
    """A controller in Python with a memory."""

    period = 0.05
    last = 0.0

    def step(self, state, speed, reference, variables=None, road=None):
        self.last = 0.9 * self.last - 0.02 * (state[3] - reference[0])
        return self.last


class Rolling(at.SteppedPlant):
    """A simulator that turns as its wheels say."""

    vehicle = CAR

    def reset(self, motion):
        self.motion = motion

    def step(self, dt, steering, acceleration, environment):
        slope = np.zeros(6)
        right_hand_side(self.motion, [steering], environment, [CAR.wheelbase], slope)
        self.motion = self.motion + dt * slope
        return self.motion


def right_hand_side(x, u, environment, p, dx):
    """A car that turns as its wheels say."""
    dx[:] = 0.0
    dx[0], dx[1], dx[2] = x[3] * math.cos(x[2]), x[3] * math.sin(x[2]), x[5]
    dx[5] = 5.0 * (x[3] * u[0] / p[0] - x[5])


CONTROLLERS = {
    "informed": lambda: at.MPC(CAR, profile="road"),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "stanley": lambda: at.Stanley(CAR, period=0.05),
    "in Python": Proportional,
}
PLANTS = {
    "dual track": lambda: at.DualTrack(CAR),
    "in Python": lambda: at.UserPlant(right_hand_side, {"length": CAR.wheelbase}, mass=CAR.mass, vehicle=CAR),
    "stepped": Rolling,
}


def track_road(tracker, first, steps=40):
    """What a tracker says of samples whose yaw rate has the wrong sign, from a sample on."""
    answers = []
    for k in range(first, first + steps):
        place = ROAD.at(0.7 * k)
        x, y, yaw = float(place.x), float(place.y) + 0.1 * np.sin(k), float(place.heading)
        answers.append(tracker.step(0.05 * k, x, y, yaw, 14.0, -14.0 * float(place.curvature) - 0.1))
    return answers


def take_actions(env, steps=12):
    """What an environment says of actions drawn at random, the same for all of its copies."""
    random = np.random.default_rng(1)
    answers = []
    for _ in range(steps):
        low, high = env.action_space.low, env.action_space.high
        observation, reward, terminated, truncated, info = env.step(0.05 * random.uniform(low, high))
        answers.append((observation.tolist(), np.asarray(reward).tolist(), str(terminated), str(truncated), str(info)))
    return answers


def environment(kind, **options):
    """An environment under way."""
    pytest.importorskip("gymnasium", reason="needs Gymnasium: pip install 'adaptrack[gym]'")
    import adaptrack.gym as gym

    env = getattr(gym, kind)(road="country:3", length=150.0, **options)
    env.reset(seed=1)
    take_actions(env)
    return env


@every_copy
@pytest.mark.parametrize("controller", CONTROLLERS.values(), ids=CONTROLLERS)
def test_a_tracker_copied_under_way_goes_on_to_the_same_bits(make_copy, controller):
    tracker = at.Tracker(controller(), ROAD)
    track_road(tracker, 0)
    other = make_copy(tracker)
    assert repr(track_road(other, 40)) == repr(track_road(tracker, 40))
    assert other.controller is not tracker.controller
    assert other._check.suspect


MANY = [{"num_envs": 34, "threads": 2}, {"num_envs": 2, "random_cars": True}]
ENVIRONMENTS = [("Env", {"car": plant()}) for plant in PLANTS.values()] + [("VectorEnv", options) for options in MANY]


@every_copy
@pytest.mark.parametrize(("form", "options"), ENVIRONMENTS, ids=[*PLANTS, "many", "random cars"])
@pytest.mark.parametrize("kind", ["PathTracking", "MPCTuning"])
def test_an_environment_copied_under_way_goes_on_to_the_same_bits(make_copy, kind, form, options):
    env = environment(kind + form, **options)
    other = make_copy(env)
    assert take_actions(other, 30) == take_actions(env, 30)  # beyond the end of episodes of many cars


def test_pickles_loaded_in_a_new_process_go_on_to_the_same_bits(tmp_path):
    tracker, env = at.Tracker(at.MPC(CAR, learning=at.Learning()), ROAD), environment("MPCTuningVectorEnv", num_envs=2)
    track_road(tracker, 0)
    (tmp_path / "under-way").write_bytes(pickle.dumps((tracker, env)))
    code = (
        "import pickle, test_copies\n"
        "tracker, env = pickle.load(open('under-way', 'rb'))\n"
        "print(repr(test_copies.track_road(tracker, 40)), test_copies.take_actions(env))"
    )
    home = {"PYTHONPATH": os.pathsep.join(map(str, (Path(at.__file__).parents[1], Path(__file__).parent)))}
    new = subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=home, capture_output=True, text=True)
    assert new.stdout == f"{track_road(tracker, 40)!r} {take_actions(env)}\n", new.stderr


def test_a_copy_of_a_tracker_does_not_write_its_record(tmp_path):
    with at.Tracker(Proportional(), ROAD, record=tmp_path / "log.csv") as tracker:
        track_road(copy.deepcopy(tracker), 0)
        track_road(tracker, 0, 3)
    assert len((tmp_path / "log.csv").read_text().splitlines()) == 1 + 3


@every_copy
def test_an_estimator_of_friction_and_wind_copied_under_way_goes_on_to_the_same_bits(make_copy):
    estimator = at.FrictionWindEstimator(CAR)
    estimator.step([0.1, 0.0, 0.2, 0.0], 15.0, 0.02)
    other = make_copy(estimator)
    assert other.step([0.2, 0.0, 0.2, 0.0], 15.0, 0.02) == estimator.step([0.2, 0.0, 0.2, 0.0], 15.0, 0.02)
