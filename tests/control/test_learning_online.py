"""Learning while driving: the filters' mathematics, what they find, when they are still, and how it is handed over.

Its starts: bounded moves, and the speed below which a drive should begin.
"""

import copy
import logging
import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm

import adaptrack as at
from adaptrack import MPC, Learning, Tracker, load_vehicle
from adaptrack.control.estimation import NOTHING_MEASURED
from adaptrack.core.controllers.part import COMMON_ANSWER
from adaptrack.core.estimators import learning as kernel
from adaptrack.core.estimators.learning import BELIEF_COLUMNS
from adaptrack.core.synthesis.belief import LEAST_STEERING_RATE
from adaptrack.core.synthesis.learner import MAX_BIAS_PULL
from adaptrack.core.synthesis.learner import PUBLISHED_MEDIAN as MIDDLE_OF_NOBODY
from adaptrack.results.run_pictures import learned_picture, learned_quantities
from adaptrack.results.style import print_figure
from adaptrack.road import Line, Road
from tracker_calls import called_back

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("midsize-sedan")
PERIOD, SPEED = 0.05, 15.0
MIDDLE = at.Steering(lag=0.2, dead_time=0.125)
UNSURE = at.Uncertainty(lag=0.15, dead_time=0.125, stiffness=2.2, mass=0.5)
HALF = CAR.replace(stiffness_front=CAR.stiffness_front / 1.6, stiffness_rear=CAR.stiffness_rear / 1.6)
both_profiles = pytest.mark.parametrize("profile", ["road", "production"])
compiled = pytest.mark.compiled


def learner(profile="road", car=HALF, **learning):
    """A controller that believes the middle of what it is told."""
    return at.MPC(car, profile=profile, belief=MIDDLE, uncertainty=UNSURE, learning=at.Learning(**learning))


def world(profile="road", lag=0.12, dead_time=0.2, bias=-0.012):
    settings = at.load_profile(profile)
    return settings.replace(steering=settings.steering.replace(lag=lag, dead_time=dead_time, bias=bias))


def numbers(mpc):
    return kernel.parameters_of(mpc.learner.parameters(), 0)


def first_hypothesis(mpc):
    """As it is before the first step."""
    return kernel.hypothesis(0, mpc.learner.commands, mpc.learner.fresh())


def belief(mpc, name):
    return float(kernel.memory_of(mpc._mpc.informed.learned[0], 0).beliefs[name])


# -- the mathematics --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("command", [0.02, 0.2])
def test_wheels_follow_a_lag_behind_a_rate_limit_and_the_slope_is_the_derivative_over_the_lag(command):
    mpc = learner()
    lag, rate, time = 0.12, 0.5, 0.3

    def turn(lag):
        hypothesis = first_hypothesis(mpc)
        hypothesis.x[kernel.STEERING_LAG] = lag
        kernel._steer(hypothesis, time, rate, command)
        return hypothesis

    def rates(t, x):
        return [np.clip((command - x[0]) / lag, -rate, rate), x[0]]

    exact = solve_ivp(rates, (0.0, time), [0.0, 0.0], rtol=1e-10, atol=1e-12, max_step=1e-3).y[:, -1]
    angles = turn(lag)
    assert angles.wheels == pytest.approx(exact[0], abs=1e-6)
    assert angles.swept == pytest.approx(exact[1], abs=1e-6)
    if command < rate * lag:
        slope = (turn(lag + 1e-6).wheels - turn(lag - 1e-6).wheels) / 2e-6
        assert angles.by_lag == pytest.approx(slope, abs=1e-6)


@pytest.mark.parametrize("speed", [4.0, 30.0])
def test_in_gentle_driving_the_prediction_is_that_of_the_path_model(speed):
    mpc = learner()
    hypothesis, angle = first_hypothesis(mpc), 1e-4
    hypothesis.x[[kernel.LATERAL_VELOCITY, kernel.YAW_RATE, kernel.WIND_FORCE]] = 2e-3, 1e-3, 0.0
    hypothesis.swept = angle * PERIOD
    a, inputs = at.PathModel(HALF, PERIOD).continuous(speed)
    block = np.zeros((3, 3))
    block[:2, :2], block[:2, 2] = a[np.ix_([0, 2], [0, 2])], inputs[[0, 2], 0]
    exact = (expm(block * PERIOD) @ [2e-3, 1e-3, angle])[:2]
    kernel._predict_state(hypothesis, speed, 0.0, PERIOD, numbers(mpc), np.zeros((2, 16)))
    np.testing.assert_allclose(hypothesis.x[[kernel.LATERAL_VELOCITY, kernel.YAW_RATE]], exact, rtol=3e-4, atol=1e-9)


def test_rows_of_the_prediction_are_its_derivatives():
    mpc = learner()
    p, step = numbers(mpc), kernel._predict_state

    def after(state, change):
        hypothesis, rows = first_hypothesis(mpc), np.zeros((2, 16))
        hypothesis.x[: kernel.STEERING_LAG] = 0.01, 0.005, 0.02, 0.0003, 0.01, 0.2, 0.05, -0.1
        hypothesis.x[state] += change
        hypothesis.swept = 0.002 * PERIOD
        step(hypothesis, SPEED, 0.0, PERIOD, p, rows)
        return hypothesis.x[[kernel.LATERAL_VELOCITY, kernel.YAW_RATE]], rows

    _, rows = after(kernel.LATERAL_VELOCITY, 0.0)
    for state in range(kernel.STEERING_LAG):
        slopes = (after(state, 1e-5)[0] - after(state, -1e-5)[0]) / 2e-5
        # phi_1 is held while it is differentiated
        assert np.linalg.norm(rows[:, state] - slopes) < 0.1 * np.linalg.norm(slopes) + 1e-5, state


# -- what is found ----------------------------------------------------------------------------------------------------
@compiled
@both_profiles
def test_a_controller_told_wrongly_finds_delay_stiffness_bias_and_noise(profile):
    mpc = learner(profile)
    world_of_profile = world(profile)
    noisy = world_of_profile.replace(noise_yaw_rate=2.0 * world_of_profile.noise_yaw_rate)
    run = at.rollout(at.DualTrack(CAR), mpc, at.random_drive(11, 60.0), profile=noisy, seed=1)
    assert run.failed is None
    last = {name: run.diagnostics[name][-1] for name in kernel.BELIEF_NAMES}
    assert last["belief_delay"] == pytest.approx(0.32, abs=0.03)
    assert last["belief_stiffness"] == pytest.approx(1.6, rel=0.15)
    assert last["belief_bias"] == pytest.approx(-0.012, abs=0.004)
    assert last["belief_noise"] == pytest.approx(2.0, rel=0.2)
    assert at.BeliefState(int(last["belief_state"])) is at.BeliefState.SETTLED
    for name in ("delay", "stiffness", "bias"):
        assert last[f"belief_{name}_sigma"] < 0.5 * run.diagnostics[f"belief_{name}_sigma"][0]
    truth = run.meta["truth"]
    assert truth["delay"] == pytest.approx(0.32)
    assert truth["stiffness"] == pytest.approx(1.6, rel=0.01)


@compiled
def test_learning_costs_a_car_that_is_known_little_and_saves_one_that_is_not():
    def cost(mpc, profile):
        run = at.rollout(at.DualTrack(CAR), mpc, at.random_drive(11, 60.0), profile=profile, seed=1)
        return 25.0 if run.failed else np.mean(run.error**2) + 3.0 * np.mean(run.command_change**2)

    plain, other = at.load_profile("road"), world()
    informed = at.MPC(CAR, profile="road")
    steering = at.Steering(lag=plain.steering.lag, dead_time=plain.steering.dead_time)
    learning = at.MPC(CAR, profile="road", belief=steering, uncertainty=UNSURE, learning=at.Learning())
    assert cost(learning, plain) < 1.3 * cost(informed, plain)
    unsure = at.MPC(HALF, profile="road", belief=MIDDLE, uncertainty=UNSURE)
    assert cost(learner(), other) < 0.5 * cost(unsure, other)


@compiled
def test_a_curved_road_teaches_as_well_and_its_page_shows_it():
    road = at.generate_road("country", 3, 800.0)
    trip = at.RoadDrive(road, at.plan_speed(road, CAR))
    mpc = learner()
    run = at.rollout(at.DualTrack(CAR), mpc, trip, profile=world(), seed=1)
    assert run.failed is None
    assert run.diagnostics["belief_delay"][-1] == pytest.approx(0.32, abs=0.05)
    assert learned_quantities(run)["delay"].truth[0] == pytest.approx(0.32)
    figure = print_figure(learned_picture({"informed": run}))
    titles = [axes.get_title(loc="left").split(") ")[1] for axes in figure.axes]
    assert titles[:2] == ["Lag and dead time together", "Lag of the steering"]
    with pytest.raises(at.InvalidInput, match="needs a controller that learns"):
        learned_picture(
            {"informed": at.rollout(at.DualTrack(CAR), at.MPC(CAR, profile="road"), trip, profile=world(), seed=1)}
        )


@compiled
def test_what_is_believed_stays_within_what_was_told_even_when_the_truth_does_not():
    mpc = at.MPC(HALF, profile="road", belief=at.Steering(lag=0.2, dead_time=0.1), learning=at.Learning(),
              uncertainty=at.Uncertainty(lag=0.02, dead_time=0.02, stiffness=1.1))  # fmt: skip
    run = at.rollout(at.DualTrack(CAR), mpc, at.random_drive(11, 20.0), profile=world(lag=0.25, dead_time=0.15), seed=1)
    diagnostics = run.diagnostics
    assert 0.18 - 1e-9 <= diagnostics["used_lag"].min() <= diagnostics["used_lag"].max() <= 0.22 + 1e-9
    assert 0.08 - 1e-9 <= diagnostics["used_dead_time"].min() <= diagnostics["used_dead_time"].max() <= 0.12 + 1e-9
    assert np.abs(np.log(diagnostics["used_stiffness"])).max() <= math.log(1.1) + 1e-9
    assert diagnostics["belief_state"][-1] in (at.BeliefState.AT_BOUND, at.BeliefState.CONTRADICTORY)
    bound = kernel.QUANTITIES_BOUNDED[int(diagnostics["belief_at_bound"][-1]) - 1]
    assert diagnostics[f"belief_{bound}_sigma"][-1] >= diagnostics[f"belief_{bound}_sigma"][0]
    assert diagnostics["used_caution"][-1] > 2.0
    unbounded = at.rollout(at.DualTrack(CAR), at.MPC(CAR, profile="road", belief="unknown", learning=at.Learning()),
                   at.random_drive(11, 20.0), profile=world(lag=0.5, dead_time=0.1, bias=0.0), seed=1)  # fmt: skip
    assert unbounded.diagnostics["belief_lag"][-1] > 0.4 > MIDDLE_OF_NOBODY[0]


# -- when it doubts ---------------------------------------------------------------------------------------------------
def test_a_contradiction_is_reported_step_by_step_and_leaves_the_delay():
    mpc = learner()
    drive_steps(mpc, 40)
    memory = kernel.memory_of(mpc._mpc.informed.learned[0], 0)
    for i in range(4):
        hypothesis = kernel.hypothesis(i, mpc.learner.commands, mpc._mpc.informed.learned[0])
        hypothesis.covariance[kernel.STIFFNESS_SCALE] = hypothesis.covariance[:, kernel.STIFFNESS_SCALE] = 0.0
        hypothesis.covariance[kernel.STIFFNESS_SCALE, kernel.STIFFNESS_SCALE] = 1e-4
    memory.disagreement = 20.0
    delay = belief(mpc, "belief_delay_sigma")
    sigmas, cautions = [], []
    for seed in range(20):
        drive_steps(mpc, 1, seed + 1)
        sigmas.append(belief(mpc, "belief_stiffness_sigma"))
        cautions.append(belief(mpc, "used_caution"))
    assert belief(mpc, "belief_state") == at.BeliefState.CONTRADICTORY
    assert belief(mpc, "belief_delay_sigma") < 1.1 * delay
    assert np.abs(np.diff(sigmas)).max() < 0.1 * learner().learner.stiffness_spread
    assert np.diff(cautions).max() < 1.0


@pytest.mark.parametrize(("gain", "time"), [(1e9, 30.0), (10.0, 3.0 / (10.0 * 1e-2)), (1.0, 300.0), (0.0, math.inf)])
def test_a_variance_returns_no_faster_than_driving_reduces_it(gain, time):
    mpc, hypothesis = learner(), first_hypothesis(learner())
    hypothesis.covariance[kernel.STIFFNESS_SCALE, kernel.STIFFNESS_SCALE] = 1e-2
    hypothesis.gain[kernel.STIFFNESS_SCALE] = gain
    kernel._grow(kernel.STIFFNESS_SCALE, 0.5, hypothesis, numbers(mpc))
    growth = hypothesis.covariance[kernel.STIFFNESS_SCALE, kernel.STIFFNESS_SCALE] - 1e-2
    assert growth == pytest.approx(PERIOD / time * (0.25 - 1e-2))


# -- when it is still -------------------------------------------------------------------------------------------------
def drive_steps(mpc, steps=60, seed=0, speed=SPEED):
    """Steps behind noisy samples of a car that wanders."""
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        state = NOTHING_MEASURED.copy()
        state[:4] = rng.normal(size=4) * [0.05, 0.003, 0.02, 0.03]
        mpc.step(state, speed, np.zeros(40))


def learned_of(mpc):
    return [belief(mpc, name) for name in ("belief_delay", "belief_stiffness", "belief_bias")]


@pytest.mark.parametrize(
    ("profile", "speed", "learns"), [("production", 5.0, False), ("production", 9.0, True), ("road", 5.0, True)]
)
def test_relaxing_tyres_teach_no_stiffness_at_low_speed_without_a_lateral_velocity(profile, speed, learns):
    mpc = learner(profile)
    names = [f"belief_{name}{part}" for name in ("stiffness", "balance", "friction") for part in ("", "_sigma")]
    drive_steps(mpc, 1, speed=speed)
    before = [belief(mpc, name) for name in names]
    drive_steps(mpc, 20, seed=1, speed=speed)
    assert (np.abs(np.subtract([belief(mpc, name) for name in names], before)).max() > 0.02) == learns


@pytest.mark.compiled
@pytest.mark.parametrize("sample", [math.nan, 0.05])
def test_missing_and_repeated_samples_teach_nothing(sample):
    mpc = learner()
    drive_steps(mpc)
    before = learned_of(mpc)
    state = NOTHING_MEASURED.copy()
    state[[0, 2]] = sample
    state[[1, 3]] = 0.01
    mpc.step(state, SPEED, np.zeros(40))  # a first one is new
    learned = learned_of(mpc)
    for _ in range(20):
        mpc.step(state, SPEED, np.zeros(40))
    np.testing.assert_allclose(learned_of(mpc), learned, rtol=0.02, atol=1e-4)
    assert np.isfinite(before).all()
    before = learned_of(mpc)
    for _ in range(40):  # a standing car
        mpc.step([*(0.01 * np.random.default_rng(1).normal(size=4))], 0.0, np.zeros(40))
    assert learned_of(mpc) == before


def test_what_is_not_finite_brings_back_what_is_known_beforehand():
    mpc = learner()
    drive_steps(mpc)
    kernel.hypothesis(0, mpc.learner.commands, mpc._mpc.informed.learned[0]).x[0] = math.nan
    answer = mpc.step([0.01, 0.0, 0.01, 0.02], SPEED, np.zeros(40))
    assert math.isfinite(answer.angle)
    np.testing.assert_array_equal(mpc._mpc.informed.learned[0], mpc.learner.fresh())
    drive_steps(mpc)
    assert np.isfinite(learned_of(mpc)).all()


LEARNED_VAN = at.LearnedCar(car="van", lag=0.2, lag_sigma=0.01, dead_time=0.1, dead_time_sigma=0.01, delay_sigma=0.01,
                         stiffness=1.0, stiffness_sigma=0.1)  # fmt: skip


@pytest.mark.parametrize(("make", "words"), [
    (lambda: at.Learning(lags=0), "lags = 0: must be a whole number >= 1 and <= 12"),
    (lambda: at.Learning(bias=-1.0), "bias = -1.0 rad: must be a finite number >= 0 or None"),
    (lambda: at.Learning(start=3), "start = 3: must be a LearnedCar"),
    (lambda: learner(start=LEARNED_VAN), "'van'"),
    (lambda: at.MPC(CAR, profile="road").learned(), "does not learn"),
    (lambda: at.MPC(CAR, model=at.SingleTrackModel(CAR), learning=at.Learning()), "specify either those or model and"),
    (lambda: at.MPC(CAR, learning=True), "must be a Learning or one of 'auto' or None; 'auto' serves as well"),
])  # fmt: skip
def test_what_learning_refuses(make, words):
    with pytest.raises(at.InvalidInput, match=words):
        make()
    learner(start=LEARNED_VAN.replace(car=""))


def test_an_experiment_replaces_constants_of_the_method():
    class Faster(at.Learning):
        defaults = at.Learning.defaults._replace(max_bias_rate=0.4)

    faster, default = (at.MPC(CAR, learning=learning(lags=3)) for learning in (Faster, at.Learning))
    assert numbers(faster).max_bias_step == pytest.approx(4.0 * numbers(default).max_bias_step)
    assert numbers(faster).hypotheses == numbers(default).hypotheses == 6


@compiled
def test_a_file_hands_what_was_learned_to_the_next_drive(tmp_path):
    first = learner()
    at.simulate(at.DualTrack(CAR), first, at.random_drive(11, 20.0), profile=world(), seed=1)
    learned = first.learned()
    assert learned.seconds == pytest.approx(20.0)
    learned.to_toml(tmp_path / "car.toml")
    read = at.load_learned_car(tmp_path / "car.toml")
    assert read == learned
    (tmp_path / "bad.toml").write_text("lag = -1.0\n")
    with pytest.raises(at.ConfigError, match="lag"):
        at.load_learned_car(tmp_path / "bad.toml")
    following = learner(start=read)
    assert belief(following, "belief_delay") == pytest.approx(learned.lag + learned.dead_time, abs=1e-9)
    assert belief(following, "belief_delay_sigma") < 0.5 * belief(learner(), "belief_delay_sigma")
    assert belief(following, "used_bias") == pytest.approx(learned.bias)
    drive = at.random_drive(12, 20.0)
    costs = [np.mean(at.rollout(at.DualTrack(CAR), mpc, drive, profile=world(), seed=2).error ** 2)
             for mpc in (following, learner())]  # fmt: skip
    assert costs[0] < costs[1]


def test_a_reset_forgets_and_a_restart_keeps_what_was_learned():
    mpc = learner()
    drive_steps(mpc)
    learned = learned_of(mpc)
    copied = copy.deepcopy(mpc)
    at.Tracker(mpc, at.generate_road("country", 3, 300.0)).engage()
    assert learned_of(mpc) == learned
    mpc.restart()
    assert learned_of(mpc) == learned
    assert mpc.angle == 0.0
    drive_steps(mpc, 3)
    mpc.reset()
    assert learned_of(mpc) == learned_of(learner())
    assert learned_of(copied) == learned


@compiled
def test_a_change_of_belief_does_not_bump_the_command():
    straight = at.Scenario(name="straight", duration=20.0, reference=0.0, speed=SPEED, friction=0.9)
    run = at.rollout(at.DualTrack(CAR), learner(), straight, profile=world(bias=0.0), seed=1)
    later = run.command_change[40:]
    settled = np.sqrt(np.mean(later[-200:] ** 2))
    assert np.abs(later).max() < 8.0 * settled


# -- the first top speed ----------------------------------------------------------------------------------------------
STRAIGHT = Road.from_segments([Line(length=300.0)])


def test_at_the_first_top_speed_the_largest_bias_pulls_the_steady_car_by_the_limit() -> None:
    mpc = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    assert mpc.learner is not None
    car, speed = mpc.learner.car, mpc.learner.first_top_speed
    front, rear = 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    length = car.lf + car.lr
    # moment balance of a steady turn: each axle carries its share of m v r
    understeer = car.mass / length * (car.lr / front - car.lf / rear)
    assert 0.035 * speed**2 / (length + understeer * speed**2) == pytest.approx(MAX_BIAS_PULL, rel=1e-9)
    assert f"drive below {speed:.3g} m/s first" in mpc.learns


def test_a_narrower_bias_lets_a_drive_begin_faster() -> None:
    car = load_vehicle("midsize-sedan")
    learners = [MPC(car, belief="unknown", learning=Learning(bias=bias)).learner for bias in (0.035, 0.02, 0.01)]
    speeds = [learner.first_top_speed for learner in learners if learner is not None]
    assert len(speeds) == 3
    assert speeds[0] < speeds[1] < speeds[2]


def test_a_car_that_understeers_enough_may_begin_at_any_speed() -> None:
    mpc = MPC(load_vehicle("paper"), belief="unknown", learning=Learning())
    assert mpc.learner is not None
    assert mpc.learner.first_top_speed == math.inf
    assert "drive below" not in mpc.learns


def test_commands_of_a_learner_turn_no_faster_than_the_slowest_published_steering() -> None:
    learning = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    assert learning.limits.move[1] == pytest.approx(LEAST_STEERING_RATE * learning.period)
    fixed = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=None)
    assert fixed.limits.move[1] == pytest.approx(math.pi / 12)


def drive(tracker: Tracker, speed: float, calls: int = 3) -> list[float]:
    """Top speeds (m/s) that a tracker gives a car on a straight."""
    return [tracker.step(0.05 * k, 0.05 * k * speed, 0.0, 0.0, speed, 0.0).first_top_speed for k in range(calls)]


@pytest.mark.parametrize(("beyond", "warnings"), [(-1.0, 0), (1.0, 1)])
def test_a_tracker_gives_the_first_top_speed_and_warns_once_above_it(
    beyond: float, warnings: int, caplog: pytest.LogCaptureFixture
) -> None:
    mpc = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    assert mpc.learner is not None
    top = mpc.learner.first_top_speed
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        assert drive(Tracker(mpc, STRAIGHT), top + beyond) == [top] * 3
    assert sum("before the controller has learned it" in record.message for record in caplog.records) == warnings


class StatedTracker(Tracker):
    """A tracker whose learner states the standard deviation of its delay."""

    delay_sigma = 0.1
    """s"""

    def _control(self, *words) -> None:
        super()._control()
        self._python.answer[0, len(COMMON_ANSWER) + BELIEF_COLUMNS.belief_delay_sigma] = self.delay_sigma


def test_the_first_top_speed_ends_when_the_delay_is_learned_and_does_not_come_back() -> None:
    learning = MPC(load_vehicle("midsize-sedan"), belief="unknown", learning=Learning())
    tracker = StatedTracker(called_back(learning), STRAIGHT)
    assert max(drive(tracker, 30.0)) < math.inf
    tracker.delay_sigma = 0.01
    tracker.engage()
    assert drive(tracker, 30.0) == [math.inf] * 3
    tracker.delay_sigma = 0.1
    tracker.engage()
    assert drive(tracker, 30.0) == [math.inf] * 3


def test_without_learning_there_is_no_first_top_speed() -> None:
    assert drive(Tracker(MPC(load_vehicle("midsize-sedan"), learning=None), STRAIGHT), 30.0) == [math.inf] * 3
