"""What `identify` does not believe: computed columns, contradictory stretches and logs, a ratio that nothing tells."""

from __future__ import annotations

import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.integrate import odeint
from typer.testing import CliRunner

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.cli.app import app
from adaptrack.identification.consistency import contradictions
from adaptrack.identification.hypotheses import Evidence, drop_computed_columns, refuse_contradictions
from adaptrack.identification.log import SHORTENED, log_of, shorten_log
from adaptrack.identification.reading import Reading, read_columns
from identification.logs import (
    BIAS,
    CAR,
    DEAD_TIME,
    LAG,
    PERIOD,
    base,
    check_signals,
    driven,
    held,
    likelihood_of,
    write_csv,
)

RATIO = 15.0


@cache
def motorway() -> dict[str, Any]:
    """45 s straight on in gusts: a driver who keeps the lane by a steering wheel whose angle is logged."""
    rng, step, speed, look, late = np.random.default_rng(0), 0.01, 31.0, 30.0, 20
    front, rear = 2.0 * CAR.stiffness_front, 2.0 * CAR.stiffness_rear
    count = round(45.0 / step)
    vy = r = yaw = y = gust = 0.0
    wheel, rate = np.zeros(count + late), np.zeros(count)
    for k in range(count):
        gust += -gust * step / 0.8 + math.sqrt(2.0 * step / 0.8) * rng.standard_normal()
        wheel[k + late] = -2.0 * (CAR.wheelbase + CAR.understeer_gradient * speed**2) * (y + look * yaw) / look**2
        force_front = front * (wheel[k] - (vy + CAR.lf * r) / speed)
        force_rear = -rear * (vy - CAR.lr * r) / speed
        rate[k] = r
        y, yaw = y + step * (vy + speed * yaw), yaw + step * r
        vy += step * ((force_front + force_rear + 1000.0 * gust) / CAR.mass - speed * r)
        r += step * (CAR.lf * force_front - CAR.lr * force_rear + 800.0 * gust) / CAR.yaw_inertia
    rows = slice(0, count, 5)
    time = step * np.arange(count)[rows]
    return {
        "time": time, "speed": speed + 0.5 * np.sin(0.1 * time), "steering_wheel_angle": RATIO * wheel[:count][rows],
        "yaw_rate": rate[rows] + 0.001 * rng.standard_normal(time.size),
    }  # fmt: skip


# -- columns that nothing measured ------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "compute", "sentence"), [
    ("acceleration", lambda m: np.round(m["speed"] * m["yaw_rate"], 3), "speed times yaw rate"),
    ("wheel", lambda m: np.round(held(m["command"], 3) / 1.2, 5), "the command, 0.15 s later"),
    ("yaw", lambda m: np.cumsum(PERIOD * m["yaw_rate"]), "one measurement"),
    ("vy", lambda m: 0.0 * m["time"], "0 in every row"),
    ("vy", lambda m: 1.2 * m["yaw_rate"], "the yaw rate times a constant"),
])  # fmt: skip
def test_a_column_that_is_computed_from_others_is_left_out_and_said(name, compute, sentence):
    likelihood = likelihood_of(base() | {name: compute(base())}, CAR)
    assert not likelihood.present[name]
    (note,) = likelihood.log.notes
    assert note.startswith(name)
    assert sentence in note


def test_a_yaw_rate_that_is_the_derivative_of_the_yaw_counts_once():
    drive = base()
    yaw = np.cumsum(PERIOD * drive["yaw_rate"]) + 1e-3 * np.random.default_rng(2).standard_normal(drive["time"].size)
    for rate in (np.gradient(yaw, drive["time"]), np.diff(yaw, prepend=yaw[0]) / PERIOD):
        columns, notes = drop_computed_columns(drive | {"yaw": yaw, "yaw_rate": rate}, CAR.wheelbase)
        assert "yaw" not in columns
        assert "one measurement" in notes[0]


def test_columns_that_sensors_measured_are_kept():
    drive, rng = driven(60.0, noise=0.0), np.random.default_rng(1)
    measured = drive | {"yaw": np.cumsum(PERIOD * drive["yaw_rate"]), "vy": 1.2 * drive["yaw_rate"]}
    for name, noise in (("yaw", 1e-3), ("vy", 0.01), ("yaw_rate", 1e-3)):
        measured[name] = measured[name] + noise * rng.standard_normal(drive["time"].size)
    measured["wheel"] = np.round(measured["wheel"], 4)
    columns, notes = drop_computed_columns(measured, CAR.wheelbase)
    assert not notes
    assert columns.keys() == measured.keys()


def test_a_yaw_rate_that_the_kinematic_model_computed_is_refused():
    drive = base()
    rate = np.round(drive["speed"] * np.tan(drive["command"]) / 2.6, 6)
    with pytest.raises(InvalidInput, match=r"computed, not measured.*--columns yaw_rate=NAME"):
        drop_computed_columns(drive | {"yaw_rate": rate}, CAR.wheelbase)


# -- clocks -----------------------------------------------------------------------------------------------------------
def test_a_column_with_a_clock_of_its_own_is_read_by_its_times():
    t, fast, slow = np.arange(0.0, 60.0, 0.05), np.arange(-0.3, 61.0, 0.01), np.arange(0.02, 60.0, 0.2)
    log = {
        "time": t, "command": np.sin(t), "speed": 10.0 + 0.0 * t, "imu_ms": 1e3 * fast, "yaw_rate": np.sin(fast),
        "t_gps": slow, "vy": np.cos(slow),
    }  # fmt: skip
    reading = Reading(clocks={"yaw_rate": "imu_ms", "vy": "t_gps"}, late={"command": 0.2})
    read = read_columns(log, reading).values
    assert np.allclose(read["yaw_rate"], np.sin(t), atol=1e-4)
    once = np.isfinite(read["vy"])
    assert once.sum() <= slow.size
    assert np.allclose(read["vy"][once], np.cos(t[once]), atol=0.01)
    assert np.allclose(read["command"][:-5], np.sin(t[:-5] + 0.2), atol=1e-9)
    with pytest.raises(InvalidInput, match="a clock of its own"):
        read_columns(log, Reading())
    with pytest.raises(InvalidInput, match="no column 't_odo'"):
        read_columns(log, Reading(clocks={"speed": "t_odo"}))


def test_a_gyro_whose_clock_is_off_is_named_where_the_yaw_shows_it():
    drive = driven(60.0)
    yaw = np.cumsum(PERIOD * drive["yaw_rate"]) + 1e-3 * np.random.default_rng(2).standard_normal(drive["time"].size)
    log = base() | {"yaw": yaw}
    check_signals(log_of(dict(log), CAR.wheelbase))
    late = log | {"yaw_rate": np.interp(drive["time"] - 0.2, drive["time"], drive["yaw_rate"])}
    with pytest.raises(InvalidInput, match=r"--late yaw_rate=0\.(18|2)"):
        check_signals(log_of(late, CAR.wheelbase))


def test_a_yaw_rate_that_runs_ahead_of_the_steering_is_named():
    drive = base()
    late = drive | {"command": np.interp(drive["time"] - LAG - DEAD_TIME - 0.3, drive["time"], drive["command"])}
    with pytest.raises(InvalidInput, match=r"runs ahead of command.*--late command"):
        check_signals(log_of(late, CAR.wheelbase))


def test_a_speed_in_kmh_is_named_where_positions_show_it():
    drive = base()
    yaw = np.cumsum(PERIOD * drive["yaw_rate"])
    x, y = (np.cumsum(PERIOD * drive["speed"] * direction(yaw)) for direction in (np.cos, np.sin))
    values = drive | {"x": x, "y": y}
    refuse_contradictions(Evidence(values), "positions")
    with pytest.raises(InvalidInput, match="--units speed=km/h"):
        refuse_contradictions(Evidence(values | {"speed": 3.6 * drive["speed"]}), "positions")


def test_names_in_a_comment_are_read(tmp_path):
    path, names = tmp_path / "log.csv", ("# time(s)", "delta_cmd(rad)", "vx(m/s)", "omega(rad/s)")
    write_csv(path, dict(zip(names, base().values(), strict=True)))
    assert np.allclose(read_columns(path, Reading()).values["yaw_rate"], base()["yaw_rate"])


# -- what is not told, what contradicts -------------------------------------------------------------------------------
def test_the_delay_of_a_command_alone_is_said_to_end_at_the_logged_yaw_rate():
    answer = at.identify(base(25.0), CAR)
    assert answer.consistent
    assert "to the logged yaw rate" in answer["delay"].meaning
    assert any("cannot tell a late yaw rate" in finding for finding in answer.findings)


def test_a_ratio_from_a_log_without_bends_is_not_accepted(tmp_path):
    answer = at.identify(motorway(), CAR)
    assert not answer.consistent
    assert "ratio" not in answer.estimates
    assert any(reason.startswith("cannot tell the ratio") for reason in answer.reasons)
    with pytest.raises(InvalidInput, match=r"cannot tell the ratio.*anyway"):
        answer.to_toml(tmp_path / "mine.toml")
    answer.to_toml(tmp_path / "mine.toml", anyway=True)
    assert "not consistent: cannot tell the ratio" in (tmp_path / "mine.toml").read_text()


@pytest.mark.parametrize("factor", [1.3, 1.0 / 1.3])
def test_a_steering_ratio_that_is_wrong_by_30_percent_is_said(factor):
    drive = base(30.0)
    answer = at.identify(drive | {"command": factor * drive["command"]}, CAR)
    (sentence,) = [reason for reason in answer.reasons if "ratio is wrong" in reason]
    assert f"turn {1.0 / factor:.2f}" in sentence


def test_stretches_that_contradict_each_other_are_said_with_their_level():
    drive = base(60.0)
    moved = np.where(drive["time"] < 40.0, held(drive["command"], 2), drive["command"])
    answer = at.identify(drive | {"command": moved}, CAR)
    (sentence,) = [reason for reason in answer.reasons if "on delay" in reason]
    assert sentence.startswith("stretches of the log contradict each other on delay")
    assert "chi-square" in sentence


def test_chance_is_no_contradiction():
    names, rng = ("front", "rear", "ratio"), np.random.default_rng(11)
    prior = dict.fromkeys(names, (0.0, 1.0))
    samples = 0.05 * rng.standard_normal((200, 3, 3))
    moments = [[{name: (x, 0.05**2) for name, x in zip(names, row, strict=True)} for row in log] for log in samples]
    assert sum(bool(contradictions("logs", prior, statements)) for statements in moments) <= 4
    shifted = [dict.fromkeys(names, (0.0, 0.05**2)) | {"front": (shift, 0.05**2)} for shift in (0.0, 0.0, 1.0)]
    (reason,) = contradictions("logs", prior, shifted)
    assert "front: 1, 1, 2.7" in reason


@pytest.mark.compiled
def test_logs_of_one_car_tell_more_than_each_of_them():
    answer = at.identify([base(24.0, 1), base(24.0, 2)], CAR)
    assert answer.consistent, answer.reasons
    truth = {"delay": LAG + DEAD_TIME, "front": 2.0 * CAR.stiffness_front, "rear": 2.0 * CAR.stiffness_rear}
    for name, true in truth.items():
        estimate = answer[name]
        assert abs(estimate.value - true) < 3.0 * estimate.standard_error, name
        assert estimate.standard_error < 0.95 * min(alone[name].standard_error for alone in answer.alone)
    assert "offset" not in answer.estimates
    assert all(abs(alone["offset"].value - BIAS) < 0.003 for alone in answer.alone)


@pytest.mark.compiled
def test_logs_that_contradict_each_other_end_the_command_with_3_and_write_nothing(tmp_path):
    other = base(25.0, 2)
    other["command"] = np.append(other["command"][3:], other["command"][-3:])
    logs, mine = (tmp_path / "a.csv", tmp_path / "b.csv"), tmp_path / "mine.toml"
    for path, log in zip(logs, (base(25.0, 1), other), strict=True):
        write_csv(path, log)
    words = ["identify", *map(str, logs), "--out", str(mine)]
    words += ["--mass", f"{CAR.mass}", "--wheelbase", f"{CAR.wheelbase}"]
    result = CliRunner().invoke(app, words)
    assert result.exit_code == 3, result.output
    assert "not consistent: logs contradict each other on delay" in result.output
    assert not mine.exists()
    result = CliRunner().invoke(app, [*words, "--anyway"])
    assert result.exit_code == 0, result.output
    assert at.load_vehicle(mine).name == "mine"


def slowly_steered() -> dict[str, np.ndarray]:
    """40 s at 22 m/s, steered below 0.6 Hz, behind a lag of 0.32 s and a dead time of 0.1 s."""
    rng, time, lag, speed = np.random.default_rng(1), PERIOD * np.arange(800), 0.32, 22.0
    waves = rng.uniform(0.03, 0.6, 8), rng.uniform(0.0, math.tau, 8)
    command = 0.012 * np.sin(math.tau * np.outer(time, waves[0]) + waves[1]).sum(axis=1) / math.sqrt(8)
    front, rear = 2.0 * CAR.stiffness_front, 2.0 * CAR.stiffness_rear

    def slope(t: float, x: np.ndarray) -> list[float]:
        vy, r, delta = x
        forces = front * (delta - (vy + CAR.lf * r) / speed), rear * (CAR.lr * r - vy) / speed
        late = held(command, 2)[min(int(t / PERIOD + 1e-9), time.size - 1)]
        turning = (CAR.lf * forces[0] - CAR.lr * forces[1]) / CAR.yaw_inertia
        return [sum(forces) / CAR.mass - speed * r, turning, (late - delta) / lag]

    yaw_rate = odeint(slope, [0.0, 0.0, command[0]], time, tfirst=True, hmax=0.01)[:, 1]
    noise = 0.003 * rng.standard_normal(time.size)
    return {"time": time, "command": command, "speed": speed + 0.3 * np.sin(0.1 * time), "yaw_rate": yaw_rate + noise}


@pytest.mark.compiled
def test_a_log_that_a_soft_and_a_stiff_car_fit_equally_well_has_intervals_that_hold_both_and_says_so():
    soft = CAR.replace(stiffness_front=0.5 * CAR.stiffness_front, stiffness_rear=0.5 * CAR.stiffness_rear)
    result = at.identify(slowly_steered(), soft)
    assert result["front"].low < 2.0 * CAR.stiffness_front < result["front"].high
    assert result["rear"].low < 2.0 * CAR.stiffness_rear < result["rear"].high
    assert any(sentence.startswith("different cars fit the log equally well") for sentence in result.findings)
    assert "yaw_inertia" not in result.estimates
    assert result.car.yaw_inertia == soft.yaw_inertia


def test_honest_commands_of_a_car_that_slows_a_little_in_bends_fit_its_yaw_rate():
    rng, time = np.random.default_rng(0), PERIOD * np.arange(2000)
    phases, noise = rng.uniform(0.0, math.tau, 6), 0.02 * rng.standard_normal(time.size)
    command = 0.01 * np.sin(np.outer(time, [0.1, 0.2, 0.3, 0.5, 0.7, 1.0]) + phases).sum(axis=1)
    yaw_rate = 25.0 * held(command, 5) / (CAR.wheelbase + CAR.understeer_gradient * 625.0) + noise
    log = {"time": time, "command": command, "speed": 25.0 - 40.0 * np.abs(command), "yaw_rate": yaw_rate}
    check_signals(log_of(log, CAR.wheelbase))


def test_a_long_log_in_means_of_its_samples_keeps_delay_and_turning():
    time = 0.01 * np.arange(48_000)
    command, speed = 0.02 * np.sin(time), 15.0 + 3.0 * np.sin(0.05 * time)
    late = 0.1 * np.sin(time - 0.2)
    log = log_of({"time": time, "command": command, "speed": speed, "yaw_rate": late}, CAR.wheelbase)
    short = shorten_log(log)
    assert short.period == pytest.approx(0.05)
    assert "means of 5" in short.notes[-1]
    middle = slice(10, -10)  # the command that is held for 0.05 s is that of the middle
    assert np.allclose(short.command[middle], 0.02 * np.sin(short.time[middle] + 0.02), atol=1e-5)
    assert np.allclose(short.yaw_rate[middle], 0.1 * np.sin(short.time[middle] - 0.2), atol=1e-4)
    hour = log_of({"time": 0.05 * np.arange(48_000), "command": command, "speed": speed,
                   "yaw_rate": np.where(time < 240.0, 0.1, 1.0) * late}, CAR.wheelbase)  # fmt: skip
    turning = shorten_log(hour)
    assert turning.samples <= SHORTENED
    assert turning.time.min() >= 1200.0 - 30.0
