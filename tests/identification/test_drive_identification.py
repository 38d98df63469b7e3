"""Drive, brakes and resistance from logs whose truth is known."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from typer.testing import CliRunner

from adaptrack import MPC, DualTrack, RoadDrive, SpeedControl, Vehicle, load_vehicle, simulate
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.vehicle import BrakeActuator, DriveActuator
from adaptrack.cli.app import app
from adaptrack.core.identification import drive as kernel
from adaptrack.identification import DriveIdentification, identify_drive
from adaptrack.identification.hypotheses import Evidence, compare
from adaptrack.road import Comfort, Line, Road, Stop, plan_speed
from identification.logs import write_csv
from pedal_cars import BRAKE_DEAD_TIME, BRAKE_LAG, DRIVE_DEAD_TIME, DRIVE_LAG, PedalCar

pytestmark = pytest.mark.kernels

CAR = load_vehicle("midsize-sedan")
PERIOD, STEP = 0.05, 0.001
DRIVE, BRAKES = DriveActuator(lag=0.3, dead_time=0.18, gain=0.9), BrakeActuator(lag=0.12, dead_time=0.26, gain=1.05)
DRAG, ROLLING = 4e-4, 0.12
TRUTH = {
    "drive_lag": 0.3, "drive_dead_time": 0.18, "drive_gain": 0.9, "brake_lag": 0.12, "brake_dead_time": 0.26,
    "brake_gain": 1.05, "drag": DRAG, "rolling": ROLLING,
}  # fmt: skip


@cache
def _integrated(seed: int) -> tuple[np.ndarray, ...]:
    """Time, request (m/s^2) and speed of a car of point mass behind drive and brakes, by Euler steps of 1 ms."""
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(1800)
    levels = np.repeat(rng.uniform(-2.0, 2.2, 180), 10)
    request, speed = np.empty(1800), np.empty(1800)
    v, responses = 12.0, [0.0, 0.0]
    for k in range(1800):
        request[k], speed[k] = levels[k] + 0.15 * (14.0 - v), v
        for i in range(round(PERIOD / STEP)):
            for j, (actuator, sign) in enumerate(((DRIVE, 1.0), (BRAKES, -1.0))):
                late = int((k * PERIOD + i * STEP - actuator.dead_time) / PERIOD + 1e-9)
                target = actuator.gain * max(sign * request[max(late, 0)], 0.0)
                responses[j] += STEP / actuator.lag * (target - responses[j])
            v += STEP * (responses[0] - responses[1] - ROLLING - DRAG * v * v)
    return time, request, speed


def _log(command: str = "force_command", noise: float = 0.02, seed: int = 0) -> dict[str, np.ndarray]:
    time, request, speed = _integrated(seed)
    scale = CAR.mass if command == "force_command" else 1.0
    measured = speed + noise * np.random.default_rng(seed).standard_normal(speed.size)
    return {"time": time, "speed": measured, command: scale * request}


@cache
def _identified() -> DriveIdentification:
    return identify_drive(_log(), CAR)


def test_with_the_true_quantities_the_innovations_are_those_of_the_integration_step():
    time, request, speed = _integrated(0)
    rows = np.stack([time, request, speed, np.eye(1, time.size)[0]])
    values = TRUTH | {"push_spread": 0.1, "push_time": 5.0, "jolt": 0.01, "noise_speed": 0.01}
    answer = np.empty((3, time.size))
    kernel.speed_innovations(np.array([values[name] for name in kernel.DriveQuantities._fields]), rows, answer)
    assert np.nanmax(np.abs(answer[0, 40:])) < 5.0 * STEP


@pytest.mark.compiled
def test_lag_dead_time_gain_and_resistance_come_back_within_their_intervals():
    for name, value in TRUTH.items():
        estimate = _identified().estimates[name]
        assert estimate.low <= value <= estimate.high, name
        assert estimate.spread_left < 0.7, name


@pytest.mark.compiled
def test_a_force_and_the_same_acceleration_give_the_same_drive_and_brakes():
    accelerated = identify_drive(_log("acceleration_command"), CAR)
    for name in ("drive_lag", "drive_dead_time", "drive_gain", "brake_lag", "brake_gain"):
        estimate = _identified().estimates[name]
        assert accelerated.estimates[name].value == pytest.approx(
            estimate.value, abs=0.3 * (estimate.high - estimate.low)
        )
    assert accelerated.car.drag_coefficient == CAR.drag_coefficient  # may be compensated behind the command


@pytest.mark.compiled
def test_a_simulated_drive_with_a_speed_control_gives_its_actuators_back():
    road = Road.from_segments([Line(length=900.0)], name="straight")
    road = road.replace(grade=([0.0, 300.0, 350.0, 900.0], [0.0, 0.0, 0.03, -0.02]))
    plan = plan_speed(road, CAR, Comfort(accelerate=1.5), stops=[Stop(280.0, 1.0), Stop(600.0, 1.0)], top_speed=16.0)
    car = CAR.replace(drive=DRIVE, brakes=BRAKES)
    run = simulate(
        DualTrack(car), MPC(CAR, profile="road"), RoadDrive(road, plan), profile="road", driver=SpeedControl(CAR)
    )
    log = {"time": run.t, "speed": run.vx, "force_command": run.diagnostics["requested_force"]}
    estimates = identify_drive(log, CAR).estimates
    for name in ("drive_lag", "drive_dead_time", "drive_gain", "brake_gain"):
        assert estimates[name].low <= TRUTH[name] <= estimates[name].high, name


@pytest.mark.compiled
def test_two_logs_of_one_car_narrow_the_intervals():
    both = identify_drive([_log(), _log(seed=1)], CAR)
    for name in ("drive_lag", "brake_gain"):
        single, joint = _identified().estimates[name], both.estimates[name]
        assert joint.high - joint.low < single.high - single.low
        assert joint.low <= TRUTH[name] <= joint.high


def _car_of_the_command(tmp_path, columns: dict[str, np.ndarray]) -> tuple[Vehicle, str]:
    """The car that `identify --longitudinal` writes for a log, and what it prints."""
    log, car = write_csv(tmp_path / "log.csv", columns), tmp_path / "my-car.toml"
    command = ["identify", str(log), "--car", "midsize-sedan", "--longitudinal", "--out", str(car)]
    result = CliRunner().invoke(app, command)
    assert result.exit_code == 0, result.output
    return load_vehicle(car), result.output


@pytest.mark.compiled
def test_a_car_file_of_the_command_drives_a_speed_control_with_known_delays(tmp_path):
    vehicle, output = _car_of_the_command(tmp_path, _log())
    assert "Gain and mass are one number" in " ".join(output.split())
    assert vehicle.drive.lag == pytest.approx(_identified().estimates["drive_lag"].value, rel=1e-3)
    settings = SpeedControl(vehicle).settings(PERIOD, Comfort())
    assert settings.brake_dead_time == vehicle.brakes.dead_time


@pytest.mark.compiled
def test_what_the_log_cannot_tell_keeps_its_value_and_is_reported():
    log = _log()
    log["force_command"] = np.maximum(log["force_command"], 0.0)
    identification = identify_drive(log, CAR.replace(brakes=BRAKES))
    assert "brake_gain" not in identification.estimates
    assert identification.car.brakes == BRAKES
    assert any("braking in the log" in finding for finding in identification.findings)


_TIME, _REQUEST, _SPEED = _integrated(0)
_CHANGE = np.gradient(_SPEED, _TIME)
_GRAVITY = 9.81 * 0.03 * np.sin(2.0 * np.pi * _TIME / 30.0)
_PEDAL = np.where(_REQUEST > 0.0, _REQUEST / 5.0, _REQUEST / 9.0)


@pytest.mark.parametrize(("changes", "message"), [
    ({"force_command": None}, "no column for force_command"),
    ({"speed": np.full(1800, 1.5)}, "s above 2 m/s: at least 20 s"),
    ({"force_command": np.full(1800, 100.0)}, "drive with changing force, and brake"),
    ({"force_command": None, "throttle": 100.0 * _PEDAL, "brake": 0.0 * _PEDAL}, "--units throttle=%"),
    ({"force_command": None, "throttle": np.abs(_PEDAL), "brake": 0.0 * _PEDAL}, "hardly any braking"),
])  # fmt: skip
def test_a_log_that_tells_nothing_is_refused_with_the_remedy(changes, message):
    log = {name: values for name, values in (_log() | changes).items() if values is not None}
    with pytest.raises(InvalidInput, match=message):
        identify_drive(log, CAR)


@pytest.mark.parametrize(("signal", "values", "message"), [
    ("acceleration_command", _REQUEST, ""),
    ("acceleration_command", -_REQUEST, "--flip acceleration_command"),
    ("acceleration_command", _REQUEST / 9.81, "in g"),
    ("acceleration_command", 100.0 * _PEDAL, "per cent"),
    ("acceleration_command", _PEDAL, "a pedal of 0 to 1"),
    ("force_command", CAR.mass * _REQUEST, ""),
    ("force_command", 1e-3 * CAR.mass * _REQUEST, "in kN"),
    ("longitudinal_acceleration", _CHANGE, ""),
    ("longitudinal_acceleration", -_CHANGE, "--flip longitudinal_acceleration"),
    ("longitudinal_acceleration", _CHANGE / 9.81, "in g"),
])  # fmt: skip
def test_a_longitudinal_signal_contradicts_the_speed_only_where_its_sign_or_unit_is_wrong(signal, values, message):
    contradictions = [
        agreement.contradiction
        for agreement in compare(Evidence({"time": _TIME, "speed": _SPEED, signal: values}, mass=CAR.mass), "speed")
        if agreement.clear
    ]
    assert len(contradictions) == 1
    assert message in contradictions[0]
    assert bool(message) == bool(contradictions[0])


def test_gravity_in_a_measured_acceleration_is_possible_and_no_contradiction():
    values = {"time": _TIME, "speed": _SPEED, "longitudinal_acceleration": _CHANGE + _GRAVITY}
    *_, agreement = compare(Evidence(values, mass=CAR.mass), "speed")
    assert not agreement.contradiction
    assert "possibly it contains gravity" in agreement.possibility


def test_a_command_in_the_wrong_unit_is_found_by_the_command_and_refused_by_the_fit(tmp_path):
    file = write_csv(tmp_path / "loop.csv", {"time": _TIME, "speed": _SPEED, "accel_cmd": 100.0 * _PEDAL})
    result = CliRunner().invoke(app, ["check-loop", str(file)])
    assert result.exit_code == 3, result.output
    assert "per cent" in " ".join(result.output.split())
    with pytest.raises(InvalidInput, match="per cent"):
        identify_drive(file, CAR)


@cache
def _pedal_log() -> dict[str, np.ndarray]:
    """Random steps of throttle and brake, 120 s, by a car whose pedals are not proportional to the force."""
    rng, car, speed, rows = np.random.default_rng(3), PedalCar(CAR, 0.01), 0.0, []
    throttle = brake = 0.0
    for k in range(2400):
        if k % 30 == 0:
            position = max(rng.uniform(-0.3, 1.0), 0.0) ** 1.5
            throttle, brake = (0.0, position) if rng.random() < 0.07 * speed else (position, 0.0)
        rows.append((PERIOD * k, throttle, brake, speed + 0.02 * rng.standard_normal()))
        for _ in range(5):
            speed += 0.01 * car.acceleration(throttle, brake, speed)
    return dict(zip(("time", "throttle", "brake", "speed"), np.array(rows).T, strict=True))


@pytest.mark.compiled
def test_a_log_of_pedals_gives_the_pedal_map_lags_and_dead_times(tmp_path):
    columns = {name if name in ("time", "speed") else f"{name} [%]": values for name, values in _pedal_log().items()}
    columns |= {name: 100.0 * values for name, values in columns.items() if "%" in name}
    (identified, _), car = _car_of_the_command(tmp_path, columns), PedalCar(CAR, 0.01)
    delays = [getattr(part, name) for part in (identified.drive, identified.brakes) for name in ("lag", "dead_time")]
    assert delays == pytest.approx([DRIVE_LAG, DRIVE_DEAD_TIME, BRAKE_LAG, BRAKE_DEAD_TIME], abs=0.03)
    for speed in (1.5, 5.0, 9.0):
        errors = [
            identified.pedals.force_at(x, 0.0, speed) / CAR.mass - car.driving(x, speed) - car.coasting(speed)
            for x in (0.0, 0.15, 0.5, 0.9)
        ]
        assert np.abs(errors).max() < 0.05 * 4.2
    brakes = [identified.pedals.force_at(0.0, x, 5.0) - identified.pedals.force_at(0.0, 0.0, 5.0) for x in (0.2, 0.6)]
    assert np.divide(brakes, -CAR.mass) == pytest.approx(car.braking([0.2, 0.6]), abs=0.05 * 7.5)
    assert SpeedControl(identified).settings(PERIOD, Comfort()).brake_limit == identified.pedals.brake_force[-1]
