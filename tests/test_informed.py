"""The controller that knows its car: path model, Kalman filter, dead time, and the MPC on top of them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.linalg import expm

from adaptrack.batch import rollout_batch
from adaptrack.controllers import MPC, Limits, Tuning
from adaptrack.controllers.informed import Uncertainty, informed_mpc, informed_tuning
from adaptrack.errors import InvalidInput
from adaptrack.estimation import Deadbeat, check_estimator, get_estimator
from adaptrack.kalman import Drifts, KalmanFilter, ReadableFilter, SensorNoise
from adaptrack.models import MEASURED, PathModel, check_model, get_model
from adaptrack.plant import DualTrack
from adaptrack.profile import list_profiles, load_profile
from adaptrack.scenario import list_scenarios, load_scenario, random_drive
from adaptrack.simulate import rollout, simulate
from adaptrack.vehicle import SteeringActuator, Vehicle, list_vehicles, load_tyre, load_vehicle

CAR = load_vehicle("paper")
PERIOD = 0.05
every_lag = pytest.mark.parametrize("lag", [0.0, 0.15])
every_dead_time = pytest.mark.parametrize("dead_time", [0.0, 0.05, 0.08, 0.12])


def run_kernel(estimator, model, speeds, samples, commands):
    """(x, d) of every instant, by the compiled function."""
    a, b, _ = model.discrete(15.0)
    a, b = np.ascontiguousarray(a), b[:, 0].copy()
    numbers, memory = estimator.parameters(model), np.zeros(estimator.memory_size(model))
    x, d, found = np.zeros(model.n), np.zeros(model.n), []
    for speed, measured, command in zip(speeds, samples, commands, strict=True):
        estimator.function(float(speed), measured, float(command), a, b, numbers, memory, x, d)
        found.append(np.concatenate([x, d]))
    return np.array(found)


# -- the model --------------------------------------------------------------------------------------------------------
@every_lag
@pytest.mark.parametrize("speed", [0.05, 1.0, 3.0, 12.0, 40.0])
def test_the_path_model_is_the_exact_zero_order_hold_of_its_equations(lag, speed):
    model = PathModel(CAR, PERIOD, lag)
    a_c, inputs = model.continuous(speed)
    n = model.n
    block = np.zeros((n + 4, n + 4))
    block[:n, :n], block[:n, n:] = a_c, inputs
    exact = expm(block * PERIOD)
    a, b, e = np.empty((n, n)), np.empty(n), np.empty(n)
    model.function(speed, PERIOD, model.parameters(), a, b, e)
    np.testing.assert_allclose(a, exact[:n, :n], rtol=0, atol=1e-13)
    np.testing.assert_allclose(b, exact[:n, n], rtol=0, atol=1e-13)
    np.testing.assert_allclose(e, exact[:n, n + 3], rtol=0, atol=1e-13)


@every_lag
def test_the_path_model_keeps_the_contract_of_models(lag):
    check_model(PathModel(CAR, PERIOD, lag))
    assert get_model("path", CAR, PERIOD) == PathModel(CAR, PERIOD)


def test_without_lag_the_path_model_is_the_papers_model():
    a, b, _ = PathModel(CAR, 0.1).discrete(17.0)
    a_paper, b_paper, _ = get_model("single-track", CAR, 0.1).discrete(17.0)
    np.testing.assert_allclose(a, a_paper, rtol=0, atol=1e-13)
    np.testing.assert_allclose(b, b_paper, rtol=0, atol=1e-13)


def test_towards_standstill_the_path_model_is_a_kinematic_bicycle():
    a, b, _ = PathModel(CAR, 0.1).discrete(0.1)
    x, angle = np.zeros(4), 0.2
    for _ in range(5):
        x = a @ x + b[:, 0] * angle
    assert x[2] == pytest.approx(0.1 * angle / (CAR.lf + CAR.lr), rel=1e-3)
    assert x[0] == pytest.approx(CAR.lr * x[2], rel=1e-2)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.inf, math.nan])
def test_a_speed_at_which_the_path_model_is_singular_is_refused(speed):
    for equations in (PathModel(CAR, PERIOD).continuous, PathModel(CAR, PERIOD).discrete):
        with pytest.raises(InvalidInput, match="positive and finite"):
            equations(speed)


@pytest.mark.parametrize("numbers", [{"lag": -0.1}, {"dead_time": math.inf}, {"lag": math.nan}, {"period": 0.0}])
def test_an_impossible_lag_dead_time_or_period_is_refused_by_name(numbers):
    with pytest.raises(InvalidInput, match=next(iter(numbers))):
        PathModel(CAR, **{"period": PERIOD, **numbers})


# -- the filter -------------------------------------------------------------------------------------------------------
@every_lag
@every_dead_time
def test_the_compiled_filter_is_the_readable_one(lag, dead_time, rng):
    model, estimator = PathModel(CAR, PERIOD, lag, dead_time), KalmanFilter(SensorNoise(wheel_angle=0.002))
    count = 150
    speeds = 15.0 + 3.0 * np.sin(0.1 * np.arange(count))
    samples = rng.normal(size=(count, 5)) * [0.1, 0.01, 0.02, 0.1, 0.01]
    samples[rng.random(samples.shape) < 0.2] = np.nan
    commands = 0.02 * np.sin(0.3 * np.arange(count))
    readable = ReadableFilter(estimator, model)
    expected = [np.concatenate(readable.step(*each)) for each in zip(speeds, samples, commands, strict=True)]
    np.testing.assert_allclose(run_kernel(estimator, model, speeds, samples, commands), expected, rtol=0, atol=1e-10)


@every_lag
@every_dead_time
def test_the_filter_knows_where_the_car_will_be_when_its_next_command_begins_to_act(lag, dead_time):
    """A car that obeys the model, measured exactly, with its commands in a queue as long as the dead time."""
    model = PathModel(CAR, PERIOD, lag, dead_time)
    readable = ReadableFilter(KalmanFilter(), model)
    fine = 0.01
    steps, late = round(PERIOD / fine), round(dead_time / fine)
    f, b = readable.matrices(15.0, fine)
    given = 0.03 * np.sin(0.25 * np.arange(80))
    acting = np.concatenate([np.zeros(late), np.repeat(given, steps)])
    states = [np.zeros(model.n)]
    for command in acting:
        states.append(f[: model.n, : model.n] @ states[-1] + b[: model.n] * command)
    samples = np.full((80, 5), np.nan)
    for k in range(80):
        for i, name in enumerate(model.states):
            samples[k, MEASURED.index(name)] = states[steps * k][i]
    before = np.concatenate([[0.0], given[:-1]])
    found = run_kernel(KalmanFilter(SensorNoise(wheel_angle=0.001)), model, np.full(80, 15.0), samples, before)
    expected = np.array([states[steps * k + late] for k in range(80)])
    np.testing.assert_allclose(found[:, : model.n], expected, rtol=0, atol=1e-9)


@every_lag
def test_on_its_own_model_innovations_and_errors_of_the_filter_are_as_large_as_it_says(lag, rng):
    """NIS and NEES (Bar-Shalom, Li and Kirubarajan 2001, section 5.4) average inside their 95 % bounds."""
    model, drifts = PathModel(CAR, PERIOD, lag), Drifts(yaw=0.01, y=0.05)
    nis, nees = [], []
    for _ in range(40):
        own = KalmanFilter(drifts=drifts, bound=math.inf)
        readable = ReadableFilter(own, model)
        f, b = readable.matrices(18.0, PERIOD)
        n, z = model.n, np.zeros(model.n + 2)
        z[n:] = rng.normal(size=2) * own.spread
        noise = np.sqrt(own.variances())
        command = 0.0
        for k in range(60):
            measured = np.full(5, np.nan)
            for i, name in enumerate(model.states):
                place = MEASURED.index(name)
                measured[place] = z[i] + (rng.normal() * noise[place] if math.isfinite(noise[place]) else math.nan)
            if k == 0:
                readable.step(18.0, measured, 0.0)
            else:
                readable.sent = [command, *readable.sent[:-1]]
                readable.predict(18.0)
                for i, value, variance in readable.sensors(measured):
                    if k >= 20:
                        nis.append((value - readable.z[i]) ** 2 / (readable.P[i, i] + variance))
                    readable.correct(i, value, variance)
                if k >= 20:
                    error = readable.z - z
                    nees.append(error @ np.linalg.solve(readable.P, error) / len(z))
            command = 0.02 * math.sin(0.3 * k)
            z = f @ z + b * command + rng.multivariate_normal(np.zeros(len(z)), readable.Q)
    assert abs(np.mean(nis) - 1.0) < 1.96 * math.sqrt(2.0 / len(nis))
    # errors of neighbouring instants go together: the bound is that of one instant in ten
    assert abs(np.mean(nees) - 1.0) < 1.96 * math.sqrt(2.0 / (model.n + 2) / (len(nees) / 10))


def test_an_outlier_moves_the_estimate_by_no_more_than_its_bound(rng):
    model = PathModel(CAR, PERIOD, 0.15)
    samples = np.tile([0.0, 0.0, 0.0, 0.0, np.nan], (41, 1))
    wild = samples.copy()
    wild[-1, 3] = 50.0
    at = (np.full(41, 15.0), np.zeros(41))
    calm = run_kernel(KalmanFilter(), model, at[0], samples, at[1])[-1]
    thrown = run_kernel(KalmanFilter(), model, at[0], wild, at[1])[-1]
    assert 0.0 < abs(thrown[4] - calm[4]) < 5.0 * KalmanFilter().noise.y


def test_without_samples_the_filter_goes_on_by_the_model():
    model = PathModel(CAR, PERIOD, 0.15, 0.05)
    samples = np.full((60, 5), np.nan)
    samples[:20] = [0.0, 0.0, 0.0, 0.0, np.nan]
    commands = np.where(np.arange(60) >= 20, 0.01, 0.0)
    found = run_kernel(KalmanFilter(), model, np.full(60, 15.0), samples, commands)
    a, b, _ = model.discrete(15.0)
    x = found[19, :5]
    for k in range(20, 60):
        x = a @ x + b[:, 0] * commands[k]
        np.testing.assert_allclose(found[k, :5], x, rtol=0, atol=1e-9)


def test_the_filter_keeps_the_contract_of_estimators():
    check_estimator(KalmanFilter(SensorNoise(wheel_angle=0.001)), PathModel(CAR, PERIOD, 0.15))
    check_estimator(KalmanFilter(), PathModel(CAR, PERIOD))
    assert get_estimator("kalman") == KalmanFilter()


def test_filters_and_models_that_do_not_fit_each_other_are_refused():
    with pytest.raises(InvalidInput, match="path model"):
        MPC(CAR, estimator="kalman")
    with pytest.raises(InvalidInput, match="dead time"):
        Deadbeat().check_fits(PathModel(CAR, PERIOD, dead_time=0.05))
    with pytest.raises(InvalidInput, match="wheel_angle"):
        MPC(CAR, period=PERIOD, model=PathModel(CAR, PERIOD, 0.1))


@pytest.mark.parametrize(
    "make",
    [
        lambda: SensorNoise(vy=-1.0),
        lambda: SensorNoise(y=math.inf),
        lambda: SensorNoise(yaw=math.nan),
        lambda: Drifts(side=-0.1),
        lambda: Drifts(turn=math.inf),
        lambda: KalmanFilter(bound=0.0),
        lambda: KalmanFilter(spread=(0.1, math.nan)),
    ],
)
def test_impossible_numbers_of_a_filter_are_refused(make):
    with pytest.raises(InvalidInput):
        make()


# -- the controller ---------------------------------------------------------------------------------------------------
@every_dead_time
def test_the_qp_predicts_what_the_model_does_from_the_estimate(dead_time, rng):
    """K of eq. (17) for the free response by recursion, its reference from behind the dead time."""
    model, estimator = PathModel(CAR, PERIOD, 0.15, dead_time), KalmanFilter()
    mpc = MPC(CAR, Tuning(12, 4, 2.0, 3.0), period=PERIOD, preview=True, model=model, estimator=estimator)
    readable, reference = ReadableFilter(estimator, model), rng.normal(size=40)
    for _ in range(6):
        state, speed = rng.normal(size=4) * [0.1, 0.01, 0.02, 0.1], rng.uniform(8.0, 20.0)
        command = mpc.angle
        qp = mpc.problem(state, speed, reference)
        mpc.step(state, speed, reference)
        x, d = readable.step(speed, [*state, np.nan], command)
        a, b, c = model.discrete(speed)
        error, ahead = np.empty(12), x
        for j in range(12):
            ahead = a @ ahead + b[:, 0] * command + d
            wanted = np.interp(j + 1 + dead_time / PERIOD, np.arange(40), reference)
            error[j] = wanted - (c @ ahead).item()
        _, phi = model.prediction(speed, 12, 4)
        np.testing.assert_allclose(qp.K, -2.0 * 2.0 * phi.T @ error, rtol=1e-9, atol=1e-9)


def test_the_tuning_weighs_the_same_steering_rate_at_any_period():
    here, there = informed_tuning("road"), informed_tuning("road", 0.025)
    assert pytest.approx(there.R * 0.025**2, rel=1e-5) == here.R * 0.05**2
    assert there.Np == 2 * here.Np


@pytest.mark.compiled
def test_a_constant_side_wind_leaves_no_offset():
    calm = load_profile("road").replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)
    run = simulate(
        DualTrack(CAR, "magic-formula"), informed_mpc(CAR, calm), load_scenario("step", amplitude=0.0, wind=15.0),
        profile=calm,
    )  # fmt: skip
    error = run.error
    assert abs(error).max() > 0.01
    assert abs(error[-40:].mean()) < 1e-3


@pytest.mark.compiled
def test_one_constant_drives_either_car_in_noise_lag_and_delay():
    """Near the limit of grip the paper's car, on its slow tyres, is lost in about one random drive of 150."""
    drives = [random_drive(4_000_000 + number) for number in range(16)]
    for name, most, failures in (("paper", 0.0012, 1), ("midsize-sedan", 0.0008, 0)):
        car = load_vehicle(name)
        plant, mpc = DualTrack(car, "magic-formula") if name == "paper" else DualTrack(car), informed_mpc(car, "road")
        runs = rollout_batch(
            plant, mpc, drives, np.tile(mpc.tuning.as_array(), (16, 1)), which=np.arange(16), profile="road",
            seeds=np.arange(16),
        )  # fmt: skip
        cost = runs.mse + load_profile("road").move_weight * runs.mean_squared_move
        ended = np.array([failed is None for failed in runs.failed])
        assert (~ended).sum() <= failures
        assert np.exp(np.log(cost[ended]).mean()) < most


def test_a_controller_told_of_another_steering_believes_it():
    mpc = informed_mpc(CAR, "road", steering=SteeringActuator(lag=0.3, rate=0.4), dead_time=0.12)
    assert (mpc.model.lag, mpc.model.dead_time) == (0.3, 0.12)
    assert mpc.limits.move == pytest.approx((-0.02, 0.02))
    with pytest.raises(InvalidInput, match="SteeringActuator"):
        informed_mpc(CAR, "road", steering=0.3)


# -- what it asks of the car ------------------------------------------------------------------------------------------
def test_of_a_large_error_the_qp_sees_as_much_as_the_limit():
    """R_s of the QP is the reference moved to the limit, its shape kept."""
    road = 0.3 * np.sin(0.2 * np.arange(80))
    for lead in (0.0, 0.05, 0.12):
        mpc = informed_mpc(CAR, "road", dead_time=lead)
        now = float(np.interp(lead / PERIOD, np.arange(80), road))
        far, near = (mpc.problem(np.zeros(4), 15.0, road - now + offset) for offset in (2.0, 0.25))
        np.testing.assert_allclose(far.K, near.K, rtol=1e-9)
        inside = mpc.problem(np.zeros(4), 15.0, road - now + 0.1)
        assert abs(inside.K - near.K).max() > 1e-3 * abs(near.K).max()


def test_without_preview_a_moving_reference_may_be_further_away_and_a_jump_may_not():
    def second(step):
        mpc = informed_mpc(CAR, "paper")
        mpc.step(np.zeros(4), 15.0, [0.0])
        return mpc.problem(np.zeros(4), 15.0, [step]).K

    unlimited = informed_mpc(CAR, "paper", limits=Limits())
    unlimited.step(np.zeros(4), 15.0, [0.0])
    np.testing.assert_allclose(second(0.5), unlimited.problem(np.zeros(4), 15.0, [0.5]).K, rtol=1e-9)
    np.testing.assert_allclose(second(2.0), second(4.0), rtol=1e-9)  # more than 7.5 m/s


def test_the_first_move_may_lead_the_wheels_as_far_as_the_actuator_follows(rng):
    """|command - wheels| <= rate (lag + period), or the moves that the rate allows."""
    mpc = informed_mpc(CAR, "road")
    readable = ReadableFilter(mpc.estimator, mpc.model)
    for _ in range(12):
        state, command = rng.normal(size=4) * [0.05, 0.01, 0.02, 0.1], mpc.angle
        qp = mpc.problem(state, 15.0, np.zeros(60))
        mpc.step(state, 15.0, np.zeros(60))
        wheels = readable.step(15.0, [*state, np.nan], command)[0][3]
        reach = 0.5 * (0.15 + PERIOD)
        assert qp.gamma[0] == pytest.approx(max(0.025, wheels + reach - command), abs=1e-9)
        assert qp.gamma[1] == pytest.approx(max(0.025, command - wheels + reach), abs=1e-9)
        assert qp.gamma[4:6] == pytest.approx([0.025, 0.025])
        assert abs(mpc.angle - command) <= max(qp.gamma[:2]) + 1e-12


@pytest.mark.parametrize("limits", [{"error": 0.0}, {"error": math.nan}, {"ahead": -0.1}, {"ahead": math.inf}])
def test_impossible_limits_are_refused(limits):
    with pytest.raises(InvalidInput, match=next(iter(limits))):
        Limits(**limits)


def six_numbers() -> Vehicle:
    """The car of docs/vehicles.md, not matched to the tyres it drives on."""
    return Vehicle(
        name="six", mass=1500.0, yaw_inertia=2500.0, lf=1.1, lr=1.6, stiffness_front=55000.0, stiffness_rear=60000.0
    )


CARS = {"six": six_numbers(), **{name: load_vehicle(name) for name in list_vehicles()}}
every_car = pytest.mark.parametrize("name", CARS)
every_profile = pytest.mark.parametrize("profile", list_profiles())


@every_car
@every_profile
@pytest.mark.compiled
def test_no_step_of_the_reference_throws_a_car_off_the_road(name, profile):
    grid = [(0.4, speed) for speed in (5.0, 10.0, 15.0, 20.0)] + [(0.9, speed) for speed in (5.0, 15.0, 25.0, 30.0)]
    steps = [
        load_scenario("step", amplitude=amplitude, speed=speed, friction=friction, duration=12.0)
        for friction, speed in grid
        for amplitude in (0.5, 2.0, 4.5)
    ]
    runs = rollout_batch(DualTrack(CARS[name]), informed_mpc(CARS[name], profile), steps, profile=profile)
    assert [each.source for each, failed in zip(steps, runs.failed, strict=True) if failed is not None] == []


@every_car
@every_profile
@pytest.mark.slow
@pytest.mark.compiled
def test_every_scenario_is_driven_by_every_car_with_nothing_but_defaults(name, profile):
    plant = DualTrack(CARS[name])
    runs = {each: rollout(plant, informed_mpc(CARS[name], profile), load_scenario(each), profile=profile)
            for each in list_scenarios()}  # fmt: skip
    assert {each: run.failed for each, run in runs.items() if run.failed} == {}


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("name", [name for name in CARS if name != "paper"])
def test_the_same_constant_and_filter_drive_any_car(name):
    """100 drives each, none failed, J <= 0.0005 m^2, the stiffness known."""
    car = CARS[name].matched_to(load_tyre(CARS[name].tyre))
    drives, profile = [random_drive(31_000_000 + number) for number in range(100)], load_profile("road")
    runs = rollout_batch(DualTrack(car), informed_mpc(car, "road"), drives, profile="road", seeds=np.arange(100))
    assert all(failed is None for failed in runs.failed)
    assert np.exp(np.log(runs.cost(profile.move_weight)).mean()) <= 0.0005


# -- wrong beliefs ----------------------------------------------------------------------------------------------------
def test_without_uncertainty_nothing_changes_and_with_it_the_controller_is_late_and_cautious():
    sure, plain = informed_mpc(CAR, "road", uncertainty=Uncertainty()), informed_mpc(CAR, "road")
    assert (sure.tuning, sure.model, sure.estimator, sure.limits) == (
        plain.tuning, plain.model, plain.estimator, plain.limits
    )  # fmt: skip
    unsure = informed_mpc(CAR, "road", uncertainty=Uncertainty(lag=0.1, dead_time=0.05, stiffness=1.6, mass=0.3))
    # the 0.95 quantile of a uniform distribution of half width h lies 0.9 h above its middle
    assert (unsure.model.lag, unsure.model.dead_time) == pytest.approx((0.15 + 0.09, 0.05 + 0.045))
    assert unsure.tuning.R > 16.0 * plain.tuning.R
    assert unsure.estimator.drifts.wheel_angle > plain.estimator.drifts.wheel_angle
    given = informed_mpc(CAR, "road", uncertainty=Uncertainty(lag=0.1), tuning=Tuning(20, 5, 1.0, 7.0))
    assert given.tuning.R == 7.0


def test_caution_grows_with_every_uncertainty():
    for name, values in {"lag": (0.0, 0.02, 0.08), "dead_time": (0.0, 0.02, 0.08), "stiffness": (1.0, 1.2, 2.0),
                         "mass": (0.0, 0.1, 0.4)}.items():  # fmt: skip
        cautions = [Uncertainty(**{name: value}).caution for value in values]
        assert cautions[0] == 1.0
        assert sorted(set(cautions)) == cautions


@pytest.mark.parametrize(
    "wrong", [{"lag": -0.1}, {"dead_time": math.nan}, {"stiffness": 0.6}, {"mass": 1.0}, {"lag": True}]
)
def test_an_impossible_uncertainty_is_refused(wrong):
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        Uncertainty(**wrong)
    with pytest.raises(InvalidInput, match="Uncertainty"):
        informed_mpc(CAR, "road", uncertainty=0.1)


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("name", ["paper", "midsize-sedan"])
@pytest.mark.parametrize(
    ("told", "wrong"),
    [(Uncertainty(lag=0.1), {"lag": value}) for value in (-0.1, 0.0, 0.1)]
    + [(Uncertainty(dead_time=0.05), {"dead_time": value}) for value in (-0.05, 0.0, 0.05)]
    + [(Uncertainty(stiffness=1.6), {"stiffness": value}) for value in (0.625, 1.6)]
    + [(Uncertainty(mass=0.3), {"mass": value}) for value in (0.7, 1.3)],
)
def test_a_belief_that_is_as_wrong_as_was_told_loses_no_drive(name, told, wrong):
    """The true value lies at an end, or in the middle, of what the controller was told; J <= 0.0025 m^2."""
    car, stiffer, heavier = load_vehicle(name), wrong.get("stiffness", 1.0), wrong.get("mass", 1.0)
    believed = car.replace(
        mass=car.mass / heavier, yaw_inertia=car.yaw_inertia / heavier,
        stiffness_front=car.stiffness_front / stiffer, stiffness_rear=car.stiffness_rear / stiffer,
    )  # fmt: skip
    profile = load_profile("road")
    mpc = informed_mpc(
        believed, "road", steering=profile.steering.replace(lag=0.15 - wrong.get("lag", 0.0)),
        dead_time=0.05 - wrong.get("dead_time", 0.0), uncertainty=told,
    )  # fmt: skip
    drives = [random_drive(41_000_000 + number) for number in range(24)]
    runs = rollout_batch(DualTrack(car), mpc, drives, profile="road", seeds=np.arange(24))
    assert all(failed is None for failed in runs.failed)
    assert np.exp(np.log(runs.cost(profile.move_weight)).mean()) <= 0.0025
