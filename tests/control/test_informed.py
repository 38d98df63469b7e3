"""The controller that knows its car: path model, Kalman filter, dead time, and the MPC on top of them."""

from __future__ import annotations

import dataclasses
import math

import numpy as np
import pytest
from scipy.linalg import expm

import adaptrack as at
from adaptrack.control.controllers import informed_tuning
from adaptrack.control.controllers.belief import ASSUMED_SOURCE
from adaptrack.control.kalman import SENSORS
from adaptrack.control.models import MEASURED_STATES
from adaptrack.core.estimators.kalman import memory_of
from adaptrack.drive.world import World
from references import dense_mpc as dense
from textbook_filter import TextbookFilter

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("paper")
PERIOD = 0.05
every_lag = pytest.mark.parametrize("lag", [0.0, 0.15])
every_dead_time = pytest.mark.parametrize("dead_time", [0.0, 0.08])


def run_kernel(estimator, model, speeds, samples, commands):
    """(x, d) of every instant, by the compiled function; samples: as many of what is measured as there are."""
    a, b, _ = model.discrete(15.0)
    a, b = np.ascontiguousarray(a), b[:, 0].copy()
    numbers, memory = estimator.parameters(model), np.zeros(estimator.memory_size(model))
    x, d, results = np.zeros(model.n), np.zeros(model.n), []
    for speed, sample, command in zip(speeds, samples, commands, strict=True):
        measured = np.array([math.nan] * len(SENSORS) + [0.0, 0.0, 0.0])
        measured[: len(sample)] = sample
        estimator.function(float(speed), measured, float(command), a, b, numbers, memory, x, d)
        results.append(np.concatenate([x, d]))
    return np.array(results)


# -- the model --------------------------------------------------------------------------------------------------------
@every_lag
@pytest.mark.parametrize("speed", [0.05, 3.0, 40.0])
def test_the_path_model_is_the_exact_zero_order_hold_of_its_equations(lag, speed):
    model = at.PathModel(CAR, PERIOD, lag)
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


def test_towards_standstill_the_path_model_is_a_kinematic_bicycle():
    a, b, _ = at.PathModel(CAR, 0.1).discrete(0.1)
    x, angle = np.zeros(4), 0.2
    for _ in range(5):
        x = a @ x + b[:, 0] * angle
    assert x[2] == pytest.approx(0.1 * angle / (CAR.lf + CAR.lr), rel=1e-3)
    assert x[0] == pytest.approx(CAR.lr * x[2], rel=1e-2)


# -- the filter -------------------------------------------------------------------------------------------------------
@every_lag
@every_dead_time
@pytest.mark.parametrize("oldest", [0.0, 0.12])
def test_the_compiled_filter_is_the_textbook_one(lag, dead_time, oldest, rng):
    noise = at.SensorNoise(wheel_angle=0.002, lateral_acceleration=0.1, yaw_rate_offset=0.002)
    drifts = at.Drifts(sliding=0.3, sliding_time=0.2, grip=3.0, least_spare=0.2)
    estimator = at.KalmanFilter(noise if oldest else at.SensorNoise(), drifts, oldest=oldest)
    model, count = at.PathModel(CAR, PERIOD, lag, dead_time), 150
    speeds = 15.0 + 3.0 * np.sin(0.1 * np.arange(count))
    samples = rng.normal(size=(count, 9)) * [0.1, 0.01, 0.02, 0.1, 0.01, 0.5, 0.0, 0.0, 0.0]
    samples[rng.random(samples.shape) < 0.2] = np.nan
    samples[0] = 0.0  # everything is known at first
    samples[40:44] = samples[40]  # repeated
    samples[:, 6:8] = rng.uniform(0.0, 1.2 * oldest, (count, 2))
    samples[:, 8] = 0.1 * rng.normal(size=count)  # the path turns
    commands = 0.02 * np.sin(0.3 * np.arange(count))
    textbook = TextbookFilter(estimator, model)
    expected = [np.concatenate(textbook.step(*step)) for step in zip(speeds, samples, commands, strict=True)]
    np.testing.assert_allclose(run_kernel(estimator, model, speeds, samples, commands), expected, rtol=0, atol=1e-10)


@pytest.mark.compiled
@pytest.mark.parametrize(
    ("sensor", "reading", "oldest"),
    [("vy", 0.6, 0.0), ("yaw_rate", 0.2, 0.1), ("wheel_angle", 0.05, 0.0), ("lateral_acceleration", 3.0, 0.1)],
)
def test_a_sensor_stuck_behind_its_noise_is_left_out_within_a_second_until_it_agrees_again(
    sensor, reading, oldest, rng
):
    """A car that weaves on its own model; both forms of the filter."""
    noise = at.SensorNoise(yaw_rate=0.002, wheel_angle=0.002, lateral_acceleration=0.1)
    model, kalman = at.PathModel(CAR, PERIOD, 0.15), at.KalmanFilter(noise, oldest=oldest)
    count, speed, first, last, place = 800, 20.0, 100, 200, SENSORS.index(sensor)
    a, b, _ = model.discrete(speed)
    slope, _ = model.continuous(speed)
    commands = 0.02 * np.sin(0.12 * np.arange(count))
    x, samples = np.zeros(model.n), np.zeros((count, 8))
    for k in range(count):
        samples[k, :6] = *x[:3], x[4], x[3], slope[0] @ x + speed * x[2]
        x = a @ x + b[:, 0] * commands[k]
    samples[:, :6] += rng.normal(size=(count, 6)) * np.sqrt(kalman.variances())
    spread = math.sqrt(kalman.variances()[place])
    samples[first:last, place] = reading + spread * rng.normal(size=last - first)
    textbook, expected, out = TextbookFilter(kalman, model), [], []
    for k in range(count):
        expected.append(np.concatenate(textbook.step(speed, samples[k], commands[k - 1] if k else 0.0)))
        out.append(textbook.left_out)
    assert not any(out[:first])
    assert out[first + 20 : last] == [sensor] * (last - first - 20)
    assert not any(out[-20:])
    sent = np.concatenate([[0.0], commands[:-1]])
    np.testing.assert_allclose(
        run_kernel(kalman, model, np.full(count, speed), samples, sent), expected, rtol=0, atol=1e-9
    )


@every_lag
def test_a_push_is_no_larger_than_what_the_tyres_can_still_answer(lag, rng):
    """A car that is dragged sideways harder than any tyre can pull; both forms of the filter."""
    grip = 4.0
    model, kalman = at.PathModel(CAR, PERIOD, lag), at.KalmanFilter(drifts=at.Drifts(grip=grip), bound=math.inf)
    count, speed = 60, 15.0
    t = PERIOD * np.arange(count)
    samples = np.column_stack([20.0 * t, 0.0 * t, 0.0 * t, 10.0 * t**2]) + 1e-3 * rng.normal(size=(count, 4))
    drive = np.full(count, speed), samples, np.zeros(count)
    textbook = TextbookFilter(kalman, model)
    expected = []
    for step in zip(*drive, strict=True):
        expected.append(np.concatenate(textbook.step(*step)))
        assert abs(textbook.z[model.n]) <= grip + 1e-12
    np.testing.assert_allclose(run_kernel(kalman, model, *drive), expected, rtol=1e-10, atol=1e-9)
    assert abs(textbook.z[model.n]) == pytest.approx(textbook.spare)


@every_lag
@every_dead_time
def test_the_filter_knows_where_the_car_will_be_when_its_next_command_begins_to_act(lag, dead_time):
    """A car that obeys the model, measured exactly, with its commands in a queue as long as the dead time."""
    model = at.PathModel(CAR, PERIOD, lag, dead_time)
    textbook = TextbookFilter(at.KalmanFilter(), model)
    fine = 0.01
    steps, late = round(PERIOD / fine), round(dead_time / fine)
    f, b = textbook.matrices(15.0, fine)
    moves = 0.03 * np.sin(0.25 * np.arange(80))
    acting = np.concatenate([np.zeros(late), np.repeat(moves, steps)])
    states = [np.zeros(model.n)]
    for command in acting:
        states.append(f[: model.n, : model.n] @ states[-1] + b[: model.n] * command)
    samples = np.full((80, 5), np.nan)
    for k in range(80):
        for i, name in enumerate(model.states):
            samples[k, MEASURED_STATES.index(name)] = states[steps * k][i]
    before = np.concatenate([[0.0], moves[:-1]])
    estimates = run_kernel(
        at.KalmanFilter(at.SensorNoise(wheel_angle=0.001)), model, np.full(80, 15.0), samples, before
    )
    expected = np.array([states[steps * k + late] for k in range(80)])
    np.testing.assert_allclose(estimates[:, : model.n], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(("lag", "oldest"), [(0.0, 0.1), (0.15, 0.0)])
def test_the_covariance_stays_symmetric_to_the_bit_however_long_the_drive(lag, oldest, rng):
    """What is not symmetric in P no measurement takes away: F, with its integrals, would let it grow without end."""
    noise = at.SensorNoise(wheel_angle=0.002, lateral_acceleration=0.1, yaw_rate_offset=0.002)
    model, kalman = at.PathModel(CAR, PERIOD, lag, 0.08), at.KalmanFilter(noise, oldest=oldest)
    memory, x, d, measured = np.zeros(kalman.memory_size(model)), np.zeros(model.n), np.zeros(model.n), np.zeros(9)
    a, b, _ = model.discrete(15.0)
    for _ in range(200):
        measured[:6] = 0.01 * rng.normal(size=6)
        numbers = kalman.parameters(model)
        kalman.function(15.0, measured, 0.01, np.ascontiguousarray(a), b[:, 0].copy(), numbers, memory, x, d)
    P = memory_of(memory, 0).P
    np.testing.assert_array_equal(P, P.T)
    assert np.linalg.eigvalsh(P)[0] >= -1e-18


@every_lag
def test_on_its_own_model_innovations_and_errors_of_the_filter_are_as_large_as_it_says(lag, rng):
    """NIS and NEES (Bar-Shalom, Li and Kirubarajan 2001, section 5.4) average inside their 95 % bounds."""
    model, drifts = at.PathModel(CAR, PERIOD, lag), at.Drifts(yaw=0.01, y=0.05, sliding=0.0)
    nis, nees = [], []
    for _ in range(20):
        kalman = at.KalmanFilter(drifts=drifts, bound=math.inf)
        textbook = TextbookFilter(kalman, model)
        f, b = textbook.matrices(18.0, PERIOD)
        n, z = model.n, np.zeros(model.n + 2)
        z[n:] = rng.normal(size=2) * kalman.spread
        noise = np.sqrt(kalman.variances())
        command = 0.0
        for k in range(60):
            measured = np.full(5, np.nan)
            for i, name in enumerate(model.states):
                place = MEASURED_STATES.index(name)
                measured[place] = z[i] + (rng.normal() * noise[place] if math.isfinite(noise[place]) else math.nan)
            if k == 0:
                textbook.step(18.0, measured, 0.0)
            else:
                textbook.sent = [command, *textbook.sent[:-1]]
                textbook.predict(18.0)
                for name, value, variance in zip(SENSORS, measured, kalman.variances(), strict=False):
                    if not math.isfinite(value):
                        continue
                    h, _ = textbook.reading(name, 0, 0.0, 18.0)
                    if k >= 20:
                        nis.append((value - h @ textbook.z) ** 2 / (h @ textbook.P @ h + variance))
                    textbook.correct(h, value, variance)
                if k >= 20:
                    error = textbook.z - z
                    nees.append(error @ np.linalg.solve(textbook.P, error) / len(z))
            command = 0.02 * math.sin(0.3 * k)
            z = f @ z + b * command + rng.multivariate_normal(np.zeros(len(z)), textbook.Q)
    assert abs(np.mean(nis) - 1.0) < 1.96 * math.sqrt(2.0 / len(nis))
    # errors of neighbouring instants go together: the bound is that of one instant in ten
    assert abs(np.mean(nees) - 1.0) < 1.96 * math.sqrt(2.0 / (model.n + 2) / (len(nees) / 10))


def test_samples_of_a_known_age_tell_what_they_told_when_they_were_taken(rng):
    """All of them two periods late: the estimate is that of two periods ago, carried on by the commands since."""
    model = at.PathModel(CAR, PERIOD, 0.15)
    count, late, speed = 60, 2, 15.0
    samples = rng.normal(size=(count, 5)) * [0.05, 0.005, 0.01, 0.05, 0.0]
    commands = 0.02 * np.sin(0.2 * np.arange(count))
    prompt, delayed = TextbookFilter(at.KalmanFilter(), model), at.KalmanFilter(oldest=late * PERIOD)
    arriving = np.full((count, 8), late * PERIOD)
    arriving[:, :6] = np.nan
    arriving[0, :4] = samples[0, :4]  # where both begin
    arriving[late + 1 :, :4] = samples[1 : count - late, :4]
    estimates = run_kernel(delayed, model, np.full(count, speed), arriving, commands)
    f, b = prompt.matrices(speed, PERIOD)
    samples[:, 4] = np.nan
    for k in range(count - late):
        prompt.step(speed, samples[k], commands[k])
        z = prompt.z
        for command in commands[k + 1 : k + late + 1]:
            z = f @ z + b * command
        if k > 0:
            np.testing.assert_allclose(estimates[k + late, : model.n], z[: model.n], rtol=0, atol=1e-9)


def test_without_a_position_the_mpc_says_how_long_it_steers_on_its_estimate_and_then_holds(rng):
    kalman = dataclasses.replace(at.KalmanFilter.from_profile(at.load_profile("road")), patience=0.5)
    mpc, steps = at.MPC(CAR, profile="road", estimator=kalman), []
    for k in range(60):
        state = rng.normal(size=4) * [0.05, 0.003, 0.01, 0.03]
        if 20 <= k < 40:
            state[3] = math.nan
        steps.append(mpc.step(state, 15.0, np.zeros(40)))
    is_dead_reckoning = np.array([step.dead_reckoning for step in steps])
    np.testing.assert_allclose(is_dead_reckoning[:20], 0.0)
    np.testing.assert_allclose(is_dead_reckoning[20:40], PERIOD * np.arange(1, 21))
    np.testing.assert_allclose(is_dead_reckoning[40:], 0.0)
    assert [step.held for step in steps] == [False] * 30 + [True] * 10 + [False] * 20
    assert steps[35].diagnostics[mpc.diagnostic_names.index("dead_reckoning")] == is_dead_reckoning[35]


@pytest.mark.parametrize(("profile", "oldest", "text"), [
    ("road", None, ""),
    ("production", None, "position, yaw 0.1 s (used at their time)"),
    (
        "production-bus",
        None,
        "position, yaw 0.1 s (used at their time); yaw rate, lateral acceleration 0.1 s (used at their time, "
        "lateral acceleration with 3 times its noise)",
    ),
    ("production", 0.0, "position, yaw 0.1 s (not used, the filter takes in none older than 0 s)"),
])  # fmt: skip
def test_a_controller_says_which_signals_are_late_and_how_it_uses_them(profile, oldest, text):
    sensors = at.KalmanFilter.from_profile(at.load_profile(profile))
    mpc = at.MPC(
        CAR, profile=profile, estimator=sensors if oldest is None else dataclasses.replace(sensors, oldest=oldest)
    )
    assert mpc.late_signals == text
    assert (f"late signals: {text}; steering" in repr(mpc)) is bool(text)


@pytest.mark.compiled
def test_gaps_of_the_pose_are_in_the_trajectory_and_counted():
    profile = at.load_profile("production").replace(dropout_pause=2.0, dropout_least=0.3, dropout_most=0.3)
    drive, mpc = at.random_drive(3).replace(duration=20.0), at.MPC(CAR, profile=profile)
    run, slow = (
        drive_function(at.DualTrack(CAR), mpc, drive, profile=profile, seed=1)
        for drive_function in (at.rollout, at.simulate)
    )
    is_dead_reckoning = run.diagnostics["dead_reckoning"]
    np.testing.assert_array_equal(is_dead_reckoning, slow.diagnostics["dead_reckoning"])
    assert run.units["diagnostics.dead_reckoning"] == "s"
    metrics = at.compute_metrics(run)
    assert metrics.dead_reckoning == np.count_nonzero(is_dead_reckoning) > 0
    assert metrics.dead_reckoning_max == is_dead_reckoning.max() >= 0.3 - 1e-9


def test_model_and_filter_keep_their_contracts():
    for lag in (0.0, 0.15):
        at.check_model(at.PathModel(CAR, PERIOD, lag))
    assert at.get_model("path", CAR, PERIOD) == at.PathModel(CAR, PERIOD)
    at.check_estimator(at.KalmanFilter(at.SensorNoise(wheel_angle=0.001)), at.PathModel(CAR, PERIOD, 0.15))
    at.check_estimator(at.KalmanFilter(), at.PathModel(CAR, PERIOD))
    assert at.get_estimator("kalman") == at.KalmanFilter()


@pytest.mark.parametrize(
    ("make", "argument", "words"),
    [
        (lambda: at.SensorNoise(yaw=math.nan), "yaw", "inf: no such sensor"),
        (lambda: at.SensorNoise(y=math.inf), "y", "without a measured lateral position"),
        (lambda: at.Drifts(side=-0.1), "side = -0.1 m/s", ">= 0"),
        (lambda: at.Drifts(sliding_time=0.0), "sliding_time", "> 0"),
        (lambda: at.KalmanFilter(bound=0.0), "bound", "inf: no bound"),
        (lambda: at.KalmanFilter(trust=20.0), "trust", "distrust must be no less"),
        (lambda: at.KalmanFilter(window=(0.5, 0.0)), r"window\[1\]", "> 0"),
        (lambda: at.KalmanFilter(shape_factor=2.0), "shape_factor", "> 1 and < 2"),
        (lambda: at.Uncertainty(stiffness=0.6), "stiffness", ">= 1 and <= 4"),
        (lambda: at.Uncertainty(lag=True), "lag", "number"),
        (lambda: at.MPC(CAR, uncertainty=0.1), "uncertainty", "Uncertainty"),
        (lambda: at.MPC(CAR, belief=0.3), "belief", "must be a Steering or one of 'unknown' or None"),
        (lambda: at.MPC(CAR, belief="nothing"), "belief", "'unknown'"),
        (lambda: at.Limits(error=0.0), "error", "inf: no limit"),
        (lambda: at.Limits(ahead=-0.1), "ahead", ">= 0"),
        (lambda: informed_tuning("road", 1e-300), "period", "positive and finite"),
        (lambda: at.PathModel(CAR, PERIOD, lag=-0.1), "lag", ">= 0"),
        (lambda: at.PathModel(CAR, PERIOD, dead_time=math.inf), "dead_time", "finite"),
        (lambda: at.PathModel(CAR, PERIOD).discrete(0.0), "speed", "positive and finite"),
        (lambda: at.MPC(CAR, model=at.SingleTrackModel(CAR), estimator="kalman"), "estimator 'kalman'", "path model"),
        (lambda: at.Deadbeat().check_fits(at.PathModel(CAR, PERIOD, dead_time=0.05)), "deadbeat", "dead time"),
        (lambda: at.MPC(CAR, period=PERIOD, model=at.PathModel(CAR, PERIOD, 0.1)), "deadbeat", "wheel_angle"),
    ],
)  # fmt: skip
def test_what_models_filters_and_controllers_refuse(make, argument, words):
    with pytest.raises(at.InvalidInput, match=f"{argument}.*{words}"):
        make()


# -- the controller ---------------------------------------------------------------------------------------------------
@every_dead_time
def test_the_qp_predicts_what_the_model_does_from_the_estimate(dead_time, rng):
    """K of eq. (17) for the free response by recursion, its reference from behind the dead time."""
    model, estimator = at.PathModel(CAR, PERIOD, 0.15, dead_time), at.KalmanFilter()
    mpc = at.MPC(CAR, at.Tuning(12, 4, 2.0, 3.0), period=PERIOD, preview=True, model=model, estimator=estimator)
    textbook, reference = TextbookFilter(estimator, model), rng.normal(size=40)
    for _ in range(6):
        state, speed = rng.normal(size=4) * [0.1, 0.01, 0.02, 0.1], rng.uniform(8.0, 20.0)
        command = mpc.angle
        qp = mpc.problem(state, speed, reference)
        mpc.step(state, speed, reference)
        x, d = textbook.step(speed, [*state, np.nan], command)
        a, b, c = model.discrete(speed)
        error, ahead = np.empty(12), x
        for j in range(12):
            ahead = a @ ahead + b[:, 0] * command + d
            expected = np.interp(j + 1 + dead_time / PERIOD, np.arange(40), reference)
            error[j] = expected - (c @ ahead).item()
        _, phi = dense.prediction(model, speed, 12, 4)
        np.testing.assert_allclose(qp.K, -2.0 * 2.0 * phi.T @ error, rtol=1e-9, atol=1e-9)


@pytest.mark.compiled
def test_one_constant_drives_either_car_in_noise_lag_and_delay():
    """Near the limit of grip the paper's car, on its slow tyres, is lost in about one random drive of 150."""
    drives = [at.random_drive(4_000_000 + number) for number in range(16)]
    for name, most, failures in (("paper", 0.0012, 1), ("midsize-sedan", 0.0008, 0)):
        car = at.load_vehicle(name)
        plant, mpc = (
            at.DualTrack(car, "magic-formula") if name == "paper" else at.DualTrack(car),
            at.MPC(car, profile="road"),
        )
        runs = at.rollout_batch(
            plant, mpc, drives, np.tile(mpc.tuning.as_array(), (16, 1)), scenario_indices=np.arange(16), profile="road",
            seeds=np.arange(16),
        )  # fmt: skip
        cost = runs.mse + at.load_profile("road").move_weight * runs.mean_squared_move
        ended = np.array([failed is None for failed in runs.failed])
        assert (~ended).sum() <= failures
        assert np.exp(np.log(cost[ended]).mean()) < most


# -- the default ------------------------------------------------------------------------------------------------------
KNOWN = CAR.replace(steering=at.Steering(lag=0.2, dead_time=0.07, rate=0.8, limit=0.6))


def test_by_default_the_mpc_models_the_steering_of_its_car_file_and_filters():
    mpc = at.MPC(KNOWN)
    assert isinstance(mpc.estimator, at.KalmanFilter)
    assert mpc.model == at.PathModel(KNOWN, mpc.period, 0.2, 0.07)
    fastest = 0.8 * mpc.period
    assert mpc.limits == at.Limits(
        move=(-fastest, fastest), angle=(-0.6, 0.6), ahead=0.8 * (0.2 + mpc.period), error=0.25
    )
    assert mpc.tuning == informed_tuning("road")
    assert mpc.belief.assumed == ()
    tuned = at.MPC(KNOWN, at.Tuning(20, 4, 1.0, 7.0))
    assert tuned.tuning == at.Tuning(20, 4, 1.0, 7.0)
    assert (tuned.model, tuned.estimator) == (mpc.model, mpc.estimator)


def test_of_a_steering_that_nobody_knows_the_slow_end_is_believed_cautiously_and_said():
    mpc = at.MPC(CAR, learning=None)
    assert mpc.belief.lag.value + mpc.belief.dead_time.value >= 0.35
    assert set(mpc.belief.assumed) == {"lag", "dead_time", "rate", "limit"}
    assert mpc.tuning.R > informed_tuning("road").R
    assert mpc.limits.move == at.Limits().move  # too slow a model behind bounded moves loses the car
    assert ASSUMED_SOURCE in repr(mpc)
    assert ASSUMED_SOURCE in mpc.describe()["belief"]


def test_of_an_unknown_steering_neither_file_nor_profile_is_believed_but_the_sensors_are():
    profile = at.load_profile("production")
    mpc = at.MPC(KNOWN, profile=profile, belief="unknown")
    assert set(mpc.belief.assumed) == {"lag", "dead_time", "rate", "limit"}
    assert mpc.belief.computation.value == profile.delay * profile.period
    assert mpc.estimator.noise == at.MPC(KNOWN, profile=profile).estimator.noise


@pytest.mark.compiled
@pytest.mark.parametrize("lag", [0.05, 0.4])
def test_without_any_knowledge_of_the_steering_either_car_is_kept(lag):
    drives = [at.random_drive(5_000_000 + number) for number in range(8)]
    for name in ("paper", "midsize-sedan"):
        car = at.load_vehicle(name).replace(steering=None)
        plant = at.DualTrack(car, steering=at.SteeringActuator(lag=lag, rate=0.5))
        mpc = at.MPC(car, learning=None)
        runs = at.rollout_batch(
            plant, mpc, drives, np.tile(mpc.tuning.as_array(), (8, 1)), scenario_indices=np.arange(8), profile="road",
            seeds=np.arange(8),
        )  # fmt: skip
        assert not any(runs.failed)
        assert runs.mse.max() < 0.05


def test_a_model_or_an_estimator_of_ones_own_leaves_the_rest_to_the_paper():
    model = at.PathModel(CAR, PERIOD, 0.15)
    mpc = at.MPC(CAR, model=model, estimator=at.KalmanFilter())
    assert (mpc.period, mpc.tuning, mpc.limits, mpc.preview) == (PERIOD, at.Tuning(), at.Limits(), False)
    assert isinstance(at.MPC(CAR, model=at.PathModel(CAR, PERIOD)).estimator, at.Deadbeat)
    assert at.MPC(CAR, estimator="deadbeat").model == at.SingleTrackModel(CAR, 0.1)
    kalman = at.KalmanFilter(at.SensorNoise(y=0.1), at.Drifts(side=0.2))
    mpc = at.MPC(KNOWN, profile="road", estimator=kalman)
    assert (mpc.estimator, mpc.model) == (kalman, at.MPC(KNOWN, profile="road").model)
    for options in ({"profile": "road"}, {"belief": at.Steering(lag=0.1)}):
        with pytest.raises(at.InvalidInput, match="profile, belief, computation, uncertainty"):
            at.MPC(CAR, model=model, estimator=at.KalmanFilter(), **options)


def test_the_published_controller_is_asked_for_by_name():
    for mpc in (at.published_mpc(CAR), at.get_controller("as-written", CAR)):
        assert (mpc.model, mpc.tuning, mpc.period, mpc.preview) == (
            at.SingleTrackModel(CAR, 0.1),
            at.Tuning(),
            0.1,
            False,
        )
        assert isinstance(mpc.estimator, at.Deadbeat)
        assert mpc.moves == at.Moves.pulses()
        assert mpc.name == "standard MPC (pulse)"
        assert mpc.step([0.0, 0.0, 0.0, math.nan], 15.0, [1.0]).dead_reckoning == 0.0  # it takes its state as measured
        assert mpc.left_out is None
    assert at.get_controller("as-released", CAR, period=0.05).moves == at.Moves.laguerre(0.95)
    assert "standard" not in at.MPC(CAR).name


def test_a_scheduler_made_for_another_car_or_profile_is_told_once_with_the_remedy(caplog):
    schedule = dataclasses.replace(at.load_scheduler("road-fallback"), made_for={"car": "van", "profile": "road"})
    mpc = at.MPC(CAR, profile="production", scheduler=schedule)
    assert "made for the car 'van', not 'paper'" in caplog.text
    assert "made for the profile 'road', not 'production'" in caplog.text
    assert caplog.text.count("adaptrack paper adapt") == 2
    World.of(at.DualTrack(CAR), mpc, "production", None, None, None)
    assert len(caplog.records) == 2
    World.of(at.DualTrack(CAR), mpc, "paper", None, None, None)
    assert "not 'paper'" in caplog.records[2].getMessage()
    assert caplog.text.count("was made for") == 3


# -- what it asks of the car ------------------------------------------------------------------------------------------
def test_of_a_large_error_the_qp_sees_as_much_as_the_limit():
    """R_s of the QP is the reference moved to the limit, its shape kept."""
    road = 0.3 * np.sin(0.2 * np.arange(80))
    for lead in (0.0, 0.05, 0.12):
        mpc = at.MPC(CAR, profile=at.load_profile("road").replace(delay=0), belief=at.Steering(dead_time=lead))
        position = float(np.interp(lead / PERIOD, np.arange(80), road))
        beyond, near = (mpc.problem(np.zeros(4), 15.0, road - position + offset) for offset in (2.0, 0.25))
        np.testing.assert_allclose(beyond.K, near.K, rtol=1e-9)
        inside = mpc.problem(np.zeros(4), 15.0, road - position + 0.1)
        assert abs(inside.K - near.K).max() > 1e-3 * abs(near.K).max()


def test_without_preview_a_moving_reference_may_be_further_away_and_a_jump_may_not():
    def second(step):
        mpc = at.MPC(CAR, profile="paper")
        mpc.step(np.zeros(4), 15.0, [0.0])
        return mpc.problem(np.zeros(4), 15.0, [step]).K

    unlimited = at.MPC(CAR, profile="paper", limits=at.Limits())
    unlimited.step(np.zeros(4), 15.0, [0.0])
    np.testing.assert_allclose(second(0.5), unlimited.problem(np.zeros(4), 15.0, [0.5]).K, rtol=1e-9)
    np.testing.assert_allclose(second(2.0), second(4.0), rtol=1e-9)  # more than 7.5 m/s


def test_the_first_move_may_lead_the_wheels_as_far_as_the_actuator_follows(rng):
    """|command - wheels| <= rate (lag + period), or the moves that the rate allows."""
    mpc = at.MPC(CAR, profile="road")
    textbook = TextbookFilter(mpc.estimator, mpc.model)
    for _ in range(12):
        state, command = rng.normal(size=4) * [0.05, 0.01, 0.02, 0.1], mpc.angle
        qp = mpc.problem(state, 15.0, np.zeros(60))
        mpc.step(state, 15.0, np.zeros(60))
        wheels = textbook.step(15.0, [*state, np.nan], command)[0][3]
        reach = 0.5 * (0.15 + PERIOD)
        assert qp.gamma[0] == pytest.approx(max(0.025, wheels + reach - command), abs=1e-9)
        assert qp.gamma[1] == pytest.approx(max(0.025, command - wheels + reach), abs=1e-9)
        assert qp.gamma[4:6] == pytest.approx([0.025, 0.025])
        assert abs(mpc.angle - command) <= max(qp.gamma[:2]) + 1e-12


SIX_NUMBERS = at.Vehicle(
    name="six", mass=1500.0, yaw_inertia=2500.0, lf=1.1, lr=1.6, stiffness_front=55000.0, stiffness_rear=60000.0
)
"""The car of docs/vehicles.md, not matched to the tyres it drives on."""
FULL_SIZE = [name for name in at.list_vehicles() if name != "model-car"]
CARS = {"six": SIX_NUMBERS, **{name: at.load_vehicle(name) for name in FULL_SIZE}}
LOST = {("small-car", "paper"), ("six", "production-bus")}
"""The light weight of moves in the ideal world without preview lets the small car's soft tyres swing. With all samples
0.1 s late the car on other tyres than its model has leaves the road in one of 24 steps (20 m/s, friction 0.4)."""
IDEAL = [(name, profile) for name in CARS for profile in at.list_profiles() if (name, profile) not in LOST]


@pytest.mark.parametrize(("name", "profile"), IDEAL)
@pytest.mark.compiled
def test_no_step_of_the_reference_throws_a_car_off_the_road(name, profile):
    slippery = (5.0, 10.0, 15.0, 20.0) if at.load_profile(profile).preview else (5.0, 10.0, 15.0)
    grid = [(0.4, speed) for speed in slippery] + [(0.9, speed) for speed in (5.0, 15.0, 25.0, 30.0)]
    steps = [
        at.load_scenario("step", amplitude=amplitude, speed=speed, friction=friction, duration=12.0)
        for friction, speed in grid
        for amplitude in (0.5, 2.0, 4.5)
    ]
    runs = at.rollout_batch(at.DualTrack(CARS[name]), at.MPC(CARS[name], profile=profile), steps, profile=profile)
    assert [step.source for step, failed in zip(steps, runs.failed, strict=True) if failed is not None] == []


# -- wrong beliefs ----------------------------------------------------------------------------------------------------
def test_without_uncertainty_nothing_changes_and_with_it_the_controller_is_late_and_cautious():
    sure, plain = at.MPC(CAR, profile="road", uncertainty=at.Uncertainty()), at.MPC(CAR, profile="road")
    assert (sure.tuning, sure.model, sure.estimator, sure.limits) == (
        plain.tuning, plain.model, plain.estimator, plain.limits
    )  # fmt: skip
    unsure = at.MPC(CAR, profile="road", uncertainty=at.Uncertainty(lag=0.1, dead_time=0.05, stiffness=1.6, mass=0.3))
    # the 0.95 quantile of a uniform distribution of half width h lies 0.9 h above its middle
    assert (unsure.model.lag, unsure.model.dead_time) == pytest.approx((0.15 + 0.09, 0.05 + 0.045))
    assert unsure.tuning.R > 16.0 * plain.tuning.R
    assert unsure.estimator.drifts.wheel_angle > plain.estimator.drifts.wheel_angle
    mpc = at.MPC(CAR, at.Tuning(20, 5, 1.0, 7.0), profile="road", uncertainty=at.Uncertainty(lag=0.1))
    assert mpc.tuning.R == 7.0


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("name", ["paper"])
@pytest.mark.parametrize(
    ("uncertainty", "error"),
    [(at.Uncertainty(lag=0.1), {"lag": value}) for value in (-0.1, 0.0, 0.1)]
    + [(at.Uncertainty(dead_time=0.05), {"dead_time": value}) for value in (-0.05, 0.0, 0.05)]
    + [(at.Uncertainty(stiffness=1.6), {"stiffness": value}) for value in (0.625, 1.6)]
    + [(at.Uncertainty(mass=0.3), {"mass": value}) for value in (0.7, 1.3)],
)
def test_a_belief_that_is_as_wrong_as_was_told_loses_no_drive(name, uncertainty, error):
    """The true value lies at an end, or in the middle, of what the controller was told; J <= 0.0025 m^2."""
    car, stiffer, heavier = at.load_vehicle(name), error.get("stiffness", 1.0), error.get("mass", 1.0)
    believed = car.replace(
        mass=car.mass / heavier, yaw_inertia=car.yaw_inertia / heavier,
        stiffness_front=car.stiffness_front / stiffer, stiffness_rear=car.stiffness_rear / stiffer,
    )  # fmt: skip
    profile = at.load_profile("road")
    late = 0.05 - error.get("dead_time", 0.0)  # in all, the computation included
    steering = profile.steering.replace(lag=0.15 - error.get("lag", 0.0), dead_time=late)
    mpc = at.MPC(believed, profile=profile.replace(delay=0, steering=steering), uncertainty=uncertainty)
    drives = [at.random_drive(41_000_000 + number) for number in range(24)]
    runs = at.rollout_batch(at.DualTrack(car), mpc, drives, profile="road", seeds=np.arange(24))
    assert all(failed is None for failed in runs.failed)
    assert np.exp(np.log(runs.cost(profile.move_weight)).mean()) <= 0.0025
