"""The scale of a logged steering angle, delays of 0, angles that wrap, and signals on a faster raster."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import adaptrack as at
from adaptrack.identification import Reading
from adaptrack.identification.consistency import implausible_estimates
from adaptrack.identification.log import find_samples
from adaptrack.identification.reading import read_columns
from adaptrack.results.identify import identification_result
from identification.logs import CAR, driven

pytestmark = pytest.mark.kernels

SCALE = 0.88
TRUTH = {
    "understeer_gradient": CAR.understeer_gradient, "front": 2.0 * CAR.stiffness_front,
    "rear": 2.0 * CAR.stiffness_rear, "angle_scale": SCALE,
}  # fmt: skip


def scaled(signals: tuple[str, ...], speed: float | None = None, duration: float = 30.0) -> dict[str, np.ndarray]:
    """A log whose steering angles are `SCALE` times those of the road wheels."""
    drive = driven(duration, speed=speed, noise=0.001)
    angles = {name: SCALE * drive[name] for name in signals}
    return {name: drive[name] for name in ("time", "speed", "yaw_rate")} | angles


@cache
def identified(signals: tuple[str, ...]) -> at.Identification:
    return at.identify(scaled(signals), CAR)


# -- the scale of the steering angle ----------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("signals", [("wheel",), ("command",), ("command", "wheel")])
def test_the_scale_of_a_steering_angle_is_estimated_with_the_axles(signals):
    answer = identified(signals)
    assert answer.consistent, answer.reasons
    for name, true in TRUTH.items():
        assert abs(answer[name].value - true) < 3.0 * answer[name].standard_error, name
    assert answer["angle_scale"].high < 0.95
    (finding,) = [sentence for sentence in answer.findings if "--steering-ratio 0.8" in sentence]
    assert "understeer_gradient" in finding


@pytest.mark.compiled
def test_a_log_read_with_its_scale_as_ratio_has_a_scale_of_1_and_the_car_file_has_the_ratio():
    answer = at.identify(scaled(("wheel",)), CAR, reading=Reading(steering_ratio=1.1 * SCALE))
    scale = answer["angle_scale"]
    assert abs(scale.value - 1.0 / 1.1) < 3.0 * scale.standard_error
    assert answer.car.steering is not None
    assert answer.car.steering.ratio == pytest.approx(1.1 * SCALE * scale.value)
    assert identified(("wheel",)).car.steering is None


@pytest.mark.compiled
def test_bends_at_one_speed_leave_the_scale_its_prior_and_widen_understeer_and_two_speeds_tell_both():
    slow, fast = (scaled(("wheel",), speed, 21.0) for speed in (8.0, 16.0))
    one_speed = at.identify(fast, CAR)
    assert one_speed["angle_scale"].value == pytest.approx(1.0)
    assert one_speed["angle_scale"].spread_left == pytest.approx(1.0, abs=0.02)
    assert any("drive bends at two speeds" in sentence for sentence in one_speed.findings)
    two_speeds = at.identify({name: np.append(slow[name], fast[name] + 60.0 * (name == "time")) for name in fast}, CAR)
    assert two_speeds["angle_scale"].low < SCALE < two_speeds["angle_scale"].high < 0.95
    for answer in (one_speed, two_speeds):
        assert answer["understeer_gradient"].low < CAR.understeer_gradient < answer["understeer_gradient"].high
    assert two_speeds["understeer_gradient"].standard_error < 0.5 * one_speed["understeer_gradient"].standard_error


# -- delays of 0, intervals beyond the prior --------------------------------------------------------------------------
def simulated(lag: float, dead_time: float) -> dict[str, np.ndarray]:
    """35 s of a single-track vehicle without relaxing tyres, in steps of 5 ms."""
    mass, inertia, lf, lr, front, rear, step = 1500.0, 2500.0, 1.1, 1.6, 110e3, 130e3, 0.005
    rng, rows, queue = np.random.default_rng(4), [], [0.0] * (round(dead_time / step) + 1)
    vy = r = wheel = 0.0
    for k in range(700):
        t = 0.05 * k
        command = 0.02 * math.sin(0.9 * t) + 0.012 * math.sin(2.3 * t + 1) + 0.01 * math.sin(0.31 * t)
        speed = 14.0 + 3.0 * math.sin(0.1 * t)
        rows.append((t, command, speed, r + rng.normal(0.0, 0.002)))
        for _ in range(10):
            queue = [*queue[1:], command]
            wheel += step * (queue[0] - wheel) / max(lag, step)
            slip_front, slip_rear = wheel - (vy + lf * r) / speed, -(vy - lr * r) / speed
            vy += step * ((front * slip_front + rear * slip_rear) / mass - speed * r)
            r += step * (lf * front * slip_front - lr * rear * slip_rear) / inertia
    return dict(zip(("time", "command", "speed", "yaw_rate"), np.array(rows).T, strict=True))


@pytest.mark.compiled
@pytest.mark.parametrize(("lag", "dead_time"), [(0.15, 0.0), (0.0, 0.1), (0.0, 0.0)])
def test_a_car_without_lag_or_dead_time_is_consistent(lag, dead_time):
    answer = at.identify(simulated(lag, dead_time), mass=1500.0, wheelbase=2.7)
    assert answer.consistent, answer.reasons
    for name, true in {"lag": lag, "dead_time": dead_time, "delay": lag + dead_time}.items():
        assert answer[name].before[0] == 0.0
        assert answer[name].low <= true + 0.005, name
        assert true <= answer[name].high, name


@pytest.mark.compiled
def test_an_interval_that_reaches_far_beyond_the_prior_is_refused():
    estimates = dict(identified(("wheel",)).estimates)
    assert not implausible_estimates(estimates, CAR)
    for reach in (3.4, 3.6):
        wide_prior = estimates | {"rear": replace(estimates["rear"], low=80e3, high=1115e3, reach=reach)}
        reasons = implausible_estimates(wide_prior, CAR)
        assert bool(reasons) == (reach > 3.5)
    assert "the interval of rear, 8e+04 to 1.12e+06 N/rad, reaches 3.6" in reasons[0]


@pytest.mark.compiled
def test_every_interval_of_a_single_log_is_shown():
    answer = identified(("wheel",))
    open_axle = replace(answer["rear"], spread_left=1.4)
    logs = (answer, replace(answer, estimates={**answer.estimates, "rear": open_axle}))
    tables = {table.name: table for table in identification_result(replace(answer, alone=logs)).tables}
    (row,) = [row for row in tables["logs"].rows if row["quantity"] == "rear"]
    assert row["log_1"] == row["log_2"] == (open_axle.low, open_axle.high)


# -- angles that wrap, signals on a faster raster ---------------------------------------------------------------------
@pytest.mark.parametrize(
    ("name", "turn", "low"),
    [("steering_wheel_angle_deg", 360.0, 0.0), ("steering_wheel_angle", math.tau, -math.pi), ("swa", 360.0, 0.0)],
)
def test_a_steering_wheel_that_wraps_is_unwrapped(name, turn, low):
    time = 0.05 * np.arange(1000)
    angle = turn * (0.7 * np.sin(0.5 * time + 0.5) - 0.02)
    wrapped = np.mod(angle - low, turn) + low
    columns = read_columns({"time": time, "speed": 10.0 + 0.0 * time, name: wrapped}, Reading(steering_ratio=1.0))
    factor = math.pi / 180.0 if name.endswith("deg") else 1.0
    assert np.allclose(columns.values["wheel"], factor * angle, atol=1e-9)
    assert any("jumps by a turn" in note for note in columns.notes)


@pytest.mark.parametrize("rounding", [0.0, 1e-4])
@pytest.mark.parametrize(("rate", "every"), [(20.0, 5), (30.0, 3), (50.0, 2)])
def test_a_signal_that_a_faster_raster_holds_or_interpolates_is_thinned_to_its_samples(rate, every, rounding):
    rng, raster, time = np.random.default_rng(0), 0.01 * np.arange(6000), np.arange(0.0, 62.0, 1.0 / rate)
    values = np.sin(time) + 0.004 * rng.standard_normal(time.size)
    values = np.round(values / rounding) * rounding if rounding else values
    held_fit = values[np.searchsorted(time, raster + 1e-9, side="right") - 1]
    sampled, words = find_samples(raster, held_fit)
    assert words == f"changes only every {every} rows"
    assert abs(sampled.sum() - 60.0 * rate) < 0.02 * 60.0 * rate
    sampled, words = find_samples(raster, np.interp(raster, time, values))
    assert words == f"is interpolated between every {every} rows"
    assert abs(sampled.sum() - 60.0 * rate) < 0.02 * 60.0 * rate
    assert find_samples(time, values)[1] == ""


@pytest.mark.parametrize("step", [0.0, 1e-4, 0.01, 0.1])
def test_a_signal_that_is_sampled_in_every_row_is_kept(step):
    rng, time = np.random.default_rng(1), 0.01 * np.arange(6000)
    for noise in (0.0, 0.003):
        values = np.sin(0.3 * time) + noise * rng.standard_normal(time.size)
        values = np.round(values / step) * step if step else values
        sampled, words = find_samples(time, values)
        assert words == ""
        assert sampled.all()


@pytest.mark.compiled
def test_a_log_on_a_faster_raster_is_read_as_the_log_that_was_recorded():
    drive = scaled(("command",))
    raster = 0.01 * np.arange(5 * drive["time"].size)
    log = {name: np.repeat(values, 5) for name, values in drive.items()} | {"time": raster}
    read = read_columns(log, Reading())
    assert any(note.startswith("yaw_rate changes only every 5 rows") for note in read.notes)
    for name, values in drive.items():
        assert np.allclose(read.values[name], values), name
