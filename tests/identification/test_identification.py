"""What `identify` finds in logs whose truth is known."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from typer.testing import CliRunner

import adaptrack as at
from adaptrack.cli.app import app
from adaptrack.identification import CarRanges, random_car
from adaptrack.identification.estimates import CORRECTIONS, corrected, estimates_of
from adaptrack.identification.hypotheses import guessed_ratio
from adaptrack.identification.likelihood import Likelihood
from adaptrack.identification.log import log_of
from adaptrack.identification.log_identification import fit_log
from adaptrack.identification.quantities import INDEX, QUANTITIES, Prior, beliefs_of, values_of
from adaptrack.identification.reading import read_columns
from identification.logs import (
    BIAS,
    CAR,
    DEAD_TIME,
    LAG,
    PERIOD,
    RELAXATION,
    base,
    check_signals,
    driven,
    integrated,
    likelihood_of,
)

pytestmark = pytest.mark.kernels

LEVER = 2.0


@pytest.fixture(scope="module")
def log() -> dict[str, np.ndarray]:
    return base()


@pytest.fixture(scope="module")
def answer() -> at.Identification:
    believed = CAR.replace(stiffness_front=1.5 * CAR.stiffness_front, stiffness_rear=0.8 * CAR.stiffness_rear)
    return at.identify(base(45.0), believed)


@pytest.mark.parametrize(("speed", "swing", "accuracy"), [(None, 1.0, 5e-4), (5.0, 5.0, 5e-3)])
def test_the_filter_run_blind_is_the_single_track_vehicle_in_tight_bends_too(speed, swing, accuracy):
    drive = dict(integrated(25.0, 0, 0.0, speed, swing))
    cleaned = log_of(dict(drive), CAR.wheelbase)
    exact = {
        "delay": LAG + DEAD_TIME, "lag_share": LAG / (LAG + DEAD_TIME), "offset": BIAS,
        "front": 2.0 * CAR.stiffness_front, "rear": 2.0 * CAR.stiffness_rear, "relaxation": RELAXATION,
        "friction": 1e3, "rate": 1e3,
    }  # fmt: skip
    beliefs = beliefs_of(CAR) | {name: Prior(value, 0.0) for name, value in exact.items()}
    blind = Likelihood(cleaned, CAR, beliefs, cleaned.begins.astype(np.float64))
    errors, _ = blind.innovations(np.zeros(len(QUANTITIES)))
    settled = cleaned.time > 3.0
    assert np.abs(errors[0][settled]).max() < accuracy * np.abs(drive["yaw_rate"]).max()
    assert np.abs(errors[4][settled]).max() < 1e-4  # the wheels


def test_wheels_move_as_lag_and_rate_limit_let_them():
    from adaptrack.core.identification.steering import _move_wheels

    angle, target, lag, rate, span = -0.02, 0.2, 0.15, 0.5, 0.4

    def slope(t: float, x: np.ndarray) -> list[float]:
        return [float(np.clip((target - x[0]) / lag, -rate, rate)), x[0], t * x[0]]

    end = solve_ivp(slope, (0.0, span), [angle, 0.0, 0.0], max_step=1e-3, rtol=1e-9, atol=1e-12).y[:, -1]
    moved = getattr(_move_wheels, "py_func", _move_wheels)(angle, target, lag, rate, span)
    assert np.allclose(moved, end, atol=1e-7)


def test_errors_are_corrected_but_never_beyond_what_was_believed():
    factor, floor, *_ = CORRECTIONS["dead_time"]
    assert corrected("dead_time", 0.01, 0.1, True, 0.7) == pytest.approx(math.hypot(factor * 0.01, floor / 0.1))
    factor, floor, share, *_ = CORRECTIONS["understeer_gradient"]
    width = math.hypot(factor * 1e-4, floor, share * 0.004)
    assert corrected("understeer_gradient", 1e-4, -0.004, False, 0.7) == pytest.approx(width)
    assert corrected("delay", 0.69, 0.3, True, 0.7) == 0.7
    assert corrected("lf", 0.05, 1.2, True, 0.1) == 0.05
    assert corrected("front", 0.05, 1e5, True, 0.7, wheels=0.3) > 2.0 * corrected("front", 0.05, 1e5, True, 0.7)


@pytest.mark.compiled
def test_the_covariance_is_that_of_the_reported_errors(answer):
    real = ("understeer_gradient", "offset", "gyro_offset", "push_mean")
    for variance, estimate in zip(np.diag(answer.covariance), answer.estimates.values(), strict=True):
        if estimate.standard_error > 0.0:
            expected = estimate.standard_error / (1.0 if estimate.name in real else estimate.value)
            assert math.sqrt(variance) == pytest.approx(expected, rel=1e-6), estimate.name


@pytest.mark.compiled
def test_delay_and_its_split_are_found_in_a_log_of_an_independent_simulation(answer):
    assert answer["delay"].value == pytest.approx(LAG + DEAD_TIME, abs=0.01)
    assert abs(answer["lag"].value - LAG) < 3.0 * answer["lag"].standard_error + 0.002
    assert abs(answer["dead_time"].value - DEAD_TIME) < 3.0 * answer["dead_time"].standard_error + 0.002


@pytest.mark.compiled
def test_tyres_and_offset_lie_within_three_standard_errors(answer):
    truth = {
        "front": 2.0 * CAR.stiffness_front, "rear": 2.0 * CAR.stiffness_rear, "offset": BIAS, "noise_yaw_rate": 0.003,
        "understeer_gradient": CAR.understeer_gradient,
    }  # fmt: skip
    for name, value in truth.items():
        assert abs(answer[name].value - value) < 3.0 * answer[name].standard_error, name
    assert answer["understeer_gradient"].value == pytest.approx(CAR.understeer_gradient, rel=0.15)


@pytest.mark.compiled
def test_held_out_stretches_are_predicted(answer):
    assert answer.validation.simulated > 0.95
    assert answer.validation.one_step > 0.95
    assert max(map(abs, answer.validation.autocorrelation)) < 0.15


@pytest.mark.compiled
def test_the_file_of_the_car_holds_what_was_found(answer, tmp_path):
    answer.to_toml(tmp_path / "mine.toml")
    car = at.load_vehicle(tmp_path / "mine.toml")
    assert car.name == "mine"
    assert car.steering is not None
    assert car.steering.lag == pytest.approx(answer["lag"].value)
    assert car.steering.dead_time == pytest.approx(answer["dead_time"].value)
    assert 2.0 * car.stiffness_front == pytest.approx(answer["front"].value)
    assert "90 % intervals" in (tmp_path / "mine.toml").read_text()
    assert car.known_within is not None
    front = answer["front"]
    ends = front.value / car.known_within.stiffness_front, front.value * car.known_within.stiffness_front
    assert ends[0] <= front.low * 1.001
    assert ends[1] >= front.high * 0.999
    assert car.known_within.steering_lag >= 0.999 * (answer["lag"].high - answer["lag"].value)
    assert at.MPC(car, profile="road").tuning.R > at.MPC(car.replace(known_within=None), profile="road").tuning.R


def steady_yaw_rate(plant: at.DualTrack, angle: float, speed: float) -> float:
    """The yaw rate (rad/s) after 8 s with the wheels at an angle (rad) and the speed (m/s) held."""

    def slopes(t: float, x: np.ndarray) -> np.ndarray:
        slope = np.array(plant.derivative(x, [angle, 0.0], [0.9] * 4 + [0.0] * 3))
        slope[3] = 0.0
        return slope

    start = plant.initial_state([0.0, 0.0, 0.0, speed, 0.0, 0.0])
    return float(solve_ivp(slopes, (0.0, 8.0), start, rtol=1e-6, atol=1e-8).y[5, -1])


@pytest.mark.compiled
def test_the_written_car_turns_on_the_plant_as_its_model_says(answer, tmp_path):
    answer.to_toml(tmp_path / "mine.toml")
    car = at.load_vehicle(tmp_path / "mine.toml")
    assert car.stiffness_factors(at.load_tyre(car.tyre)) == pytest.approx((1.0, 1.0), rel=1e-6)
    for speed in (10.0, 20.0):
        angle = 0.2 / (speed * car.steady_state_yaw_gain(speed))  # 0.2 m/s^2
        gain = steady_yaw_rate(at.DualTrack(car), angle, speed) / angle
        assert gain == pytest.approx(car.steady_state_yaw_gain(speed), rel=0.02)


@pytest.mark.compiled
def test_a_log_becomes_a_car_that_drives(tmp_path):
    car = at.load_vehicle("midsize-sedan")
    run = at.rollout(at.DualTrack(car), at.MPC(car, profile="road"), at.random_drive(5, 30.0), profile="road")
    run.save(tmp_path / "log.parquet")
    mine = tmp_path / "mine.toml"
    options = ["--mass", f"{car.mass}", "--wheelbase", f"{car.wheelbase}", "--out", str(mine)]
    result = CliRunner().invoke(app, ["identify", str(tmp_path / "log.parquet"), *options])
    assert result.exit_code == 0, result.output
    loaded = at.load_vehicle(mine)
    assert loaded.steady_state_yaw_gain(15.0) == pytest.approx(car.steady_state_yaw_gain(15.0), rel=0.05)
    points = tmp_path / "road.csv"
    places = at.generate_road("country", 3, 300.0).at(np.arange(0.0, 300.0, 3.0))
    np.savetxt(points, np.stack([places.x, places.y], axis=-1), delimiter=",", header="x,y", comments="")
    result = CliRunner().invoke(app, ["drive", str(points), "--vehicle", str(mine), "--json"])
    assert result.exit_code == 0, result.output
    (row,) = json.loads(result.stdout)["rows"]
    assert row["failed"] is None
    assert row["max_abs_error"] < 0.5


@pytest.mark.compiled
@pytest.mark.parametrize("turning", [("yaw_rate",), ("yaw_rate", "wheel")])
def test_the_steering_ratio_is_found_from_yaw_rate_or_road_wheels(turning):
    drive, ratio = driven(40.0), 15.2
    log = {name: drive[name] for name in ("time", "speed", *turning)}
    log["steering_wheel_angle"] = ratio * (drive["wheel"] - BIAS)
    likelihood = likelihood_of(log, CAR)
    estimate = estimates_of(fit_log(likelihood))[0]["ratio"]
    assert abs(estimate.value - ratio) < 3.0 * estimate.standard_error
    assert estimate.value == pytest.approx(ratio, rel=0.01 if "wheel" in turning else 0.05)


@pytest.mark.compiled
def test_a_steering_ratio_that_a_log_at_one_speed_does_not_tell_is_said_to_be_open():
    drive = driven(25.0, speed=20.0)
    log = {name: drive[name] for name in ("time", "speed", "yaw_rate")} | {"swa": 15.2 * drive["wheel"]}
    answer = at.identify(log, CAR)
    assert answer["ratio"].low < 15.2 < answer["ratio"].high
    assert any("ratio" in sentence for sentence in answer.findings)


def test_an_angle_of_the_steering_wheel_is_told_from_the_names_or_asked_for(log):
    plain = {name: log[name] for name in ("time", "speed", "yaw_rate")}
    at_wheel = plain | {"SWA_deg": 15.2 * np.degrees(log["command"])}
    read = read_columns(at_wheel, at.Reading())
    assert (read.commanded, read.ratio_unknown) == (False, True)
    assert guessed_ratio(log_of(read.values, CAR.wheelbase, (), False), CAR.wheelbase) == pytest.approx(15.2, rel=0.2)
    columns = read_columns(at_wheel, at.Reading(steering_ratio=15.2))
    assert not columns.ratio_unknown
    assert np.allclose(columns.values["wheel"], log["command"])
    assert read_columns(log, at.Reading(steering_ratio="fit")).ratio_unknown
    degrees = read_columns(plain | {"swa": 15.2 * np.degrees(log["command"])}, at.Reading())
    with pytest.raises(at.InvalidInput, match="--units steering_wheel=deg"):
        guessed_ratio(log_of(degrees.values, CAR.wheelbase, (), False), CAR.wheelbase)


@pytest.mark.compiled
def test_the_page_shows_measured_and_simulated(answer, tmp_path):
    from adaptrack.results.identify import write_identification_page

    text = write_identification_page(answer, tmp_path / "page.html", "adaptrack identify").read_text()
    for words in ("explains", "simulation", "Initial interval", "Speed and steering", "Autocorrelation"):
        assert words in text


@pytest.mark.compiled
def test_a_measured_wheel_angle_sharpens_the_split_of_the_delay(answer):
    wheel = driven(60.0)["wheel"]
    likelihood = likelihood_of(
        base() | {"wheel": wheel + 0.001 * np.random.default_rng(5).standard_normal(wheel.size)}, CAR
    )
    estimates = estimates_of(fit_log(likelihood))[0]
    assert estimates["lag"].standard_error < 0.7 * answer["lag"].standard_error
    assert abs(estimates["lag"].value - LAG) < 0.01


@cache
def gusty(seed: int) -> dict[str, np.ndarray]:
    """70 s behind a driver, in Ornstein-Uhlenbeck gusts that act far ahead; the delay is 0.13 s."""
    rng, step, steps, speed, reach = np.random.default_rng(seed), 0.005, 14000, 20.0, 24.0
    white, time = rng.standard_normal(steps), 0.005 * np.arange(steps)
    bends = sum(
        a * np.sin(math.tau * f * time + p) for a, f, p in ((0.004, 0.07, 0), (0.003, 0.31, 1), (0.002, 0.53, 0))
    )
    front, rear = 2.0 * CAR.stiffness_front, 2.0 * CAR.stiffness_rear
    vy = r = delta = aside = heading = gust = command = 0.0
    out = np.empty((steps, 2))
    for k in range(steps):
        if k % 10 == 0:
            ahead = bends[min(k + 26, steps - 1)] - 2.0 * (aside + reach * heading) / reach**2
            command = (CAR.wheelbase + CAR.understeer_gradient * speed**2) * ahead
        out[k] = command, r
        gust += step * -gust + 0.15 * math.sqrt(2.0 * step) * white[k]
        forces = front * (delta - (vy + CAR.lf * r) / speed), rear * (CAR.lr * r - vy) / speed
        aside, heading = aside + step * (vy + speed * heading), heading + step * (r - speed * bends[k])
        delta += step * (out[max(k - 10, 0), 0] - delta) / 0.08
        vy += step * ((forces[0] + forces[1]) / CAR.mass - speed * r + gust * CAR.yaw_inertia / (CAR.mass * LEVER))
        r += step * ((CAR.lf * forces[0] - CAR.lr * forces[1]) / CAR.yaw_inertia + gust)
    rows = np.arange(200, steps, 10)
    yaw_rate = out[rows, 1] + 0.001 * rng.standard_normal(rows.size)
    return {"time": time[rows], "command": out[rows, 0], "speed": np.full(rows.size, speed), "yaw_rate": yaw_rate}


@pytest.mark.compiled
def test_the_delay_lies_in_its_interval_in_gusts_that_are_not_smooth():
    likelihood = likelihood_of(gusty(4), at.load_vehicle("compact-ev").replace(steering=None))
    delay = estimates_of(fit_log(likelihood))[0]["delay"]
    assert delay.low < 0.13 < delay.high
    assert delay.value == pytest.approx(0.13, abs=0.015)


@pytest.mark.compiled
def test_a_late_gyro_is_found_against_a_wheel_angle_and_does_not_soften_the_tyres():
    drive = driven(30.0)
    late = np.interp(drive["time"] - 0.2, drive["time"], drive["yaw_rate"])
    likelihood = likelihood_of({k: drive[k] for k in ("time", "wheel", "speed")} | {"yaw_rate": late}, CAR)
    estimates = estimates_of(fit_log(likelihood))[0]
    assert estimates["lateness"].value == pytest.approx(0.2, abs=0.02)
    assert estimates["lateness"].low < 0.2 < estimates["lateness"].high
    assert estimates["front"].low < 2.0 * CAR.stiffness_front < estimates["front"].high


@pytest.mark.compiled
def test_a_sensor_of_lateral_velocity_before_the_centre_of_gravity_is_found():
    drive = driven(40.0)
    noise = 0.02 * np.random.default_rng(4).standard_normal(drive["time"].size)
    likelihood = likelihood_of(base(40.0) | {"vy": drive["vy"] + 1.2 * drive["yaw_rate"] + noise}, CAR)
    estimates = estimates_of(fit_log(likelihood))[0]
    assert estimates["vy_ahead"].value == pytest.approx(1.2, abs=0.15)
    assert estimates["rear"].low < 2.0 * CAR.stiffness_rear < estimates["rear"].high


@pytest.mark.compiled
def test_at_even_speed_offset_and_gyro_are_said_to_be_inseparable():
    answer = at.identify(base(25.0, speed=15.0), CAR)
    assert any("known in sum only" in sentence for sentence in answer.findings)


@pytest.mark.compiled
def test_without_a_command_the_delay_is_said_to_be_unseen():
    drive = driven(25.0)
    answer = at.identify({k: drive[k] for k in ("time", "wheel", "speed", "yaw_rate")}, CAR)
    assert "delay" not in answer.estimates
    assert any("no steering command" in sentence for sentence in answer.findings)
    assert answer.car.steering is None
    assert answer["understeer_gradient"].value == pytest.approx(CAR.understeer_gradient, rel=0.2)


def test_a_right_log_passes_its_conventions(log):
    check_signals(log_of(dict(log), CAR.wheelbase))


@pytest.mark.parametrize(("signal", "change", "words"), [
    ("command", lambda x: -x, "--flip command"),
    ("yaw_rate", lambda x: -x, "--flip"),
    ("command", np.degrees, "--units command=deg"),
    ("command", lambda x: 16.0 * x, "--steering-ratio 1"),
    ("command", lambda x: 16.0 * np.degrees(x), "--units command=deg --steering-ratio"),
    ("yaw_rate", np.degrees, "--units"),
    ("speed", lambda x: 3.6 * x, "--units speed=km/h"),
    ("acceleration", lambda x: -x, "--flip acceleration"),
    ("acceleration", lambda x: x / 9.80665, "--units acceleration=g"),
    ("time", lambda x: 1000.0 * x, "--units time=ms"),
    ("time", lambda x: x[::-1].copy(), "time goes back"),
    ("speed", np.zeros_like, "never drives"),
    ("command", np.zeros_like, "hardly any steering"),
    ("yaw_rate", lambda x: np.full_like(x, np.nan), "never holds a number"),
    ("yaw_rate", np.zeros_like, "holds 0 while the car is steered, 60 s in all: the gyro"),
    ("yaw_rate", lambda x: np.full_like(x, 0.1), r"holds 0\.1 while the car is steered, 60 s in all: the gyro"),
    ("speed", lambda x: 1e3 * x, r"100 % of speed are outliers .*--columns speed=NAME.*--units"),
    ("yaw_rate", lambda x: np.where(np.arange(1200) % 10 == 0, 9.0, x), "10 % of yaw_rate are outliers"),
])  # fmt: skip
def test_a_wrong_signal_is_refused_with_the_option_that_mends_it(signal, change, words):
    with pytest.raises(at.InvalidInput, match=words):
        check_signals(log_of(base() | {signal: change(driven(60.0)[signal])}, CAR.wheelbase))


@pytest.mark.parametrize(("call", "words"), [
    (lambda: log_of({name: values[:200] for name, values in base().items()}, CAR.wheelbase), "at least 20 s"),
    (lambda: log_of({k: v for k, v in base().items() if k != "speed"}, CAR.wheelbase), "--columns speed=NAME"),
    (lambda: read_columns(base(), at.Reading({"time": "Zeit"})), "no column"),
    (lambda: at.Reading({"tempo": "V"}), "no signal"),
    (lambda: at.Reading(units={"speed": "knots"}), "must be m/s or km/h or mph"),
    (lambda: at.Reading(steering_ratio=0.0), "or fit"),
    (lambda: CarRanges(mass=(-1.0, 2.0)), r"mass.0. = -1.0: must be a finite number > 0"),
    (lambda: at.identify({"time": np.zeros(3)}), "--mass"),
    (lambda: at.identify({"time": np.zeros(3)}, CAR, mass=1000.0), "either a car"),
])  # fmt: skip
def test_what_tells_nothing_is_refused(call, words):
    with pytest.raises(at.InvalidInput, match=words):
        call()


ROW = 400
"""A row of the log, at 20 s, in a bend."""


@pytest.mark.parametrize(("signal", "rows", "value"), [
    ("yaw_rate", [ROW], math.inf),
    ("yaw_rate", [ROW], 1e300),
    ("yaw_rate", [ROW], 1e4),
    ("yaw_rate", [1, ROW, ROW + 1, 1198], -1.0),
    ("yaw_rate", [ROW], 0.4),
    ("yaw_rate", range(ROW, ROW + 20), 5.0),
    ("speed", range(7, 1200, 100), 1e9),
    ("speed", range(7, 1200, 100), 0.0),
    ("command", [ROW], 1e300),
    ("command", [ROW, ROW + 1], 2.0),
    ("acceleration", [ROW], 40.0),
    ("wheel", [ROW], -0.5),
    ("yaw", [ROW], 2.0),
])  # fmt: skip
def test_outliers_are_counted_and_left_out_and_all_else_is_kept(signal, rows, value):
    drive = driven(60.0)
    drive["yaw"] = np.remainder(np.cumsum(PERIOD * drive["yaw_rate"]) + math.pi, math.tau) - math.pi
    honest, rows = log_of(dict(drive), CAR.wheelbase), list(rows)
    drive[signal] = drive[signal].copy()
    drive[signal][rows] = value
    cleaned = log_of(drive, CAR.wheelbase)
    (note,) = cleaned.notes
    assert note.startswith(f"{signal}: {len(rows)} sample")
    assert f"{drive['time'][rows[0]]:.4g} s" in note
    other_rows = np.setdiff1d(np.arange(1200), rows)
    for name in ("command", "speed", "yaw_rate", "acceleration", "wheel", "yaw"):
        is_, was = getattr(cleaned, name), getattr(honest, name)
        assert np.allclose(is_[other_rows], was[other_rows], atol=1e-9), name
    left = getattr(cleaned, signal)[rows]
    filled = {"speed": 0.1, "command": 0.02}.get(signal)  # m/s, rad: from the samples around
    assert np.isnan(left).all() if filled is None else np.allclose(left, getattr(honest, signal)[rows], atol=filled)


def test_honest_logs_lose_no_sample(log):
    drive, rng = driven(60.0), np.random.default_rng(3)
    step = {"yaw_rate": 0.02, "speed": 0.3, "wheel": 0.01, "acceleration": 0.2, "command": 0.01}
    quantised = drive | {name: np.round(drive[name] / size) * size for name, size in step.items()}
    noisy = {name: x + step.get(name, 0.0) * rng.standard_normal(x.size) for name, x in drive.items()}
    gaps = {name: values[np.arange(1200) % 300 < 240] for name, values in drive.items()}
    gusts = 0.2 * np.exp(-(((drive["time"] % 15.0) - 7.0) ** 2) / 0.02)
    gusty = drive | {"yaw_rate": drive["yaw_rate"] + gusts}
    half = {name: values[::2] for name, values in drive.items()}
    held_log = drive | {"yaw_rate": np.repeat(drive["yaw_rate"][::4], 4)}  # of a gyro at 5 Hz
    for honest in (drive, quantised, noisy, gaps, gusty, half, held_log):
        cleaned = log_of(dict(honest), CAR.wheelbase)
        assert not any("outlier" in note or "stuck" in note for note in cleaned.notes)
        assert np.isfinite(cleaned.yaw_rate).all()


def test_a_gyro_that_is_stuck_for_a_while_is_left_out(log):
    partly = log["yaw_rate"].copy()
    partly[300:500] = partly[300]
    cleaned = log_of(log | {"yaw_rate": partly}, CAR.wheelbase)
    assert np.array_equal(np.isnan(cleaned.yaw_rate), (np.arange(1200) >= 300) & (np.arange(1200) < 500))
    assert any("10 s in all: left out, the gyro was stuck" in note for note in cleaned.notes)
    check_signals(cleaned)


def test_a_yaw_rate_that_rests_where_the_car_goes_straight_is_no_stuck_gyro(log):
    straight = (log["time"] > 20.0) & (log["time"] < 35.0)
    command = np.where(straight, 0.001 * np.sin(log["time"]), log["command"])
    rests = np.where(straight, 0.0, np.round(log["yaw_rate"], 2))
    cleaned = log_of(log | {"command": command, "yaw_rate": rests}, CAR.wheelbase)
    assert np.isfinite(cleaned.yaw_rate).all()


def test_a_yaw_rate_that_is_measured_in_some_rows_only_fits_its_steering(log):
    now_and_then = np.where(np.arange(1200) % 5 == 0, log["yaw_rate"], math.nan)
    check_signals(log_of(log | {"yaw_rate": now_and_then}, CAR.wheelbase))


@pytest.mark.compiled
def test_what_a_log_tells_is_an_error_where_it_is_not_finite(log):
    cleaned = log_of({name: values[:450] for name, values in log.items()}, CAR.wheelbase)
    for value in (math.inf, 1e300):
        absurd = np.where(np.arange(cleaned.samples) == 100, value, cleaned.yaw_rate)
        beliefs = beliefs_of(CAR) | {"noise_yaw_rate": Prior(0.003, 1.5)}
        with pytest.raises(at.InvalidInput, match="not finite"):
            Likelihood(replace(cleaned, yaw_rate=absurd), CAR, beliefs).fit(np.zeros(len(QUANTITIES)))


def test_repeated_rows_are_dropped_and_gaps_begin_a_segment(log):
    rows = np.concatenate([np.arange(500), [499, 499], np.arange(600, 1200)])
    cleaned = log_of({name: values[rows] for name, values in log.items()}, CAR.wheelbase)
    assert cleaned.segments == 2
    assert cleaned.samples == 1100
    assert any("repeat" in note for note in cleaned.notes)


def test_columns_are_guessed_with_their_units_and_the_guess_is_said(log, tmp_path):
    path = tmp_path / "log.csv"
    table = np.column_stack([1000 * log["time"], log["command"], 3.6 * log["speed"], np.degrees(log["yaw_rate"])])
    lines = [";".join(f"{v:.6f}".replace(".", ",") for v in row) for row in table]
    path.write_text("# a comment\ntime_ms;SteeringCmd;Speed [km/h];GyroZ_dps\n" + "\n".join(lines))
    read = read_columns(path, at.Reading())
    for name in ("command", "speed", "yaw_rate"):
        assert np.allclose(read.values[name], log[name], atol=1e-5), name
    assert np.allclose(read.values["time"], log["time"], atol=1e-5)
    assert any("GyroZ_dps" in note for note in read.notes)


def test_columns_units_signs_and_ratio_are_read_as_told(log, tmp_path):
    import pyarrow
    import pyarrow.parquet

    path = tmp_path / "log.parquet"
    columns = {
        "T": log["time"], "Lenkrad": -15.0 * np.degrees(log["command"]), "V": log["speed"],
        "Gier": np.degrees(log["yaw_rate"]),
    }  # fmt: skip
    pyarrow.parquet.write_table(pyarrow.table(columns), path)
    reading = at.Reading(
        {"time": "T", "command": "Lenkrad", "speed": "V", "yaw_rate": "Gier"}, {"": "deg"}, ("command",), 15.0
    )
    read = read_columns(path, reading)
    assert np.allclose(read.values["command"], log["command"])
    assert np.allclose(read.values["yaw_rate"], log["yaw_rate"])


@pytest.mark.compiled
def test_an_own_trajectory_is_read_with_the_computation_of_its_profile(tmp_path):
    car = at.load_vehicle("paper")
    run = at.rollout(at.SingleTrack(car), at.MPC(car, profile="road"), at.random_drive(3, 30.0), profile="road")
    run.save(tmp_path / "run.parquet")
    read = read_columns(tmp_path / "run.parquet", at.Reading())
    assert np.array_equal(read.values["command"], run.command)
    assert read.computation == pytest.approx(0.05)


def test_medians_and_spreads_are_what_a_point_at_the_origin_and_one_spread_off_mean():
    median, spread = np.full(len(QUANTITIES), 0.4), np.full(len(QUANTITIES), 0.5)
    assert np.allclose(values_of(np.zeros(len(QUANTITIES)), median, spread), 0.4)
    there = values_of(np.ones(len(QUANTITIES)), median, spread)
    assert there[INDEX["delay"]] == pytest.approx(0.4 * math.exp(0.5))
    assert there[INDEX["offset"]] == pytest.approx(0.9)
    below = values_of(np.full(len(QUANTITIES), -1.0), median, spread)
    assert below[INDEX["delay"]] == pytest.approx(0.4 * 0.5)
    assert below[INDEX["front"]] == pytest.approx(0.4 * math.exp(-0.5))
    assert 0.0 < values_of(np.full(len(QUANTITIES), -3.0), median, spread)[INDEX["delay"]] < 1e-3
    share = there[INDEX["lag_share"]]
    assert math.log(share / (1.0 - share)) == pytest.approx(math.log(0.4 / 0.6) + 0.5)


def test_a_seed_gives_one_random_car_within_its_ranges():
    for seed in range(12):
        car = random_car(seed)
        assert car == random_car(seed)
        base = at.load_vehicle(car.base)
        assert 0.6 <= car.vehicle.mass / base.mass <= 1.6
        assert 0.05 <= car.profile.steering.lag <= 0.35
        assert 0.0 <= car.profile.steering.dead_time <= 0.25
        assert abs(car.profile.steering.bias) <= 0.02
        factors = car.vehicle.stiffness_factors(car.tyre)
        assert factors == pytest.approx((1.0, 1.0))
        assert car.vehicle.yaw_inertia / car.vehicle.mass == pytest.approx(base.yaw_inertia / base.mass)


def test_steering_that_is_known_is_believed_before_the_log():
    car: at.Vehicle = CAR.replace(steering=at.Steering(lag=0.2, dead_time=0.1))
    beliefs = beliefs_of(car)
    assert beliefs["delay"].median == pytest.approx(0.3)
    assert beliefs["lag_share"].median == pytest.approx(2.0 / 3.0)
