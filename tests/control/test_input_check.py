"""What a loop says of its own inputs: sign, unit, frame, clock, sliding; and what it leaves behind as a record."""

import json
import logging
import math
import random
from dataclasses import replace

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cli import main
from adaptrack.control.input_check import InputCheck
from adaptrack.control.recording import Recorder
from adaptrack.core.estimators.learning import BELIEF_NAMES
from adaptrack.core.input_check.hypotheses import ABOUT, COMPARISON_TABLE, MISTAKE_TABLE, MISTAKES
from adaptrack.core.tracker.signals import TrackerSample
from adaptrack.identification.loop_check import check_loop
from adaptrack.identification.reading import read_columns
from adaptrack.road import Arc, Clothoid, Line
from foreign_loop import drive, on_road
from tracker_calls import called_back

CAR = at.load_vehicle("paper")
EASING = Clothoid(length=20.0, start_curvature=0.0, end_curvature=1 / 60)
BEND = at.Road.from_segments(
    [Line(length=25.0), EASING, Arc(length=60.0, curvature=1 / 60), Clothoid(length=20.0, start_curvature=1 / 60,
     end_curvature=0.0), Line(length=30.0), Clothoid(length=20.0, start_curvature=0.0, end_curvature=-1 / 60),
     Arc(length=60.0, curvature=-1 / 60), Line(length=100.0)], name="bends",
)  # fmt: skip
DEGREES = 180.0 / math.pi


def tracker(**more):
    return at.Tracker(at.MPC(CAR, profile="road", belief=at.Steering(lag=0.15, dead_time=0.0, rate=0.5)), BEND, **more)


class Wrong:
    """A tracker whose loop gives it wrong inputs."""

    def __init__(self, own, change=lambda s: s, command=1.0, clock=1.0):
        self.own, self.change, self.factor, self.clock = own, change, command, clock

    def step(self, *sample, now, wheel_angle):
        t, *rest = self.change(sample)
        told = self.own.step(self.clock * t, *rest, now=self.clock * now, wheel_angle=wheel_angle)
        return told._replace(command=told.command * self.factor)


def replaced(place, made):
    return lambda sample: (*sample[:place], made(sample[place]), *sample[place + 1 :])


FAULTS = {
    "steering sign": ({"command": -1.0}, "command: the car turns to the other side"),
    "command taken as degrees": ({"command": 1.0 / DEGREES}, "command: the car hardly turns"),
    "command to a steering wheel": ({"command": 1.0 / 16.0}, "command: the car hardly turns"),
    "yaw in degrees": ({"change": replaced(3, lambda yaw: yaw * DEGREES)}, "yaw is in degrees"),
    "yaw from north": ({"change": replaced(3, lambda yaw: 0.5 * math.pi - yaw)}, "clockwise from north"),
    "yaw of a mirrored frame": ({"change": replaced(3, lambda yaw: -yaw)}, "y is mirrored"),
    "speed in km/h": ({"change": replaced(4, lambda v: 3.6 * v)}, "the speed is in km/h"),
    "yaw rate in deg/s": ({"change": replaced(5, lambda r: r * DEGREES)}, "the yaw rate is in degrees"),
    "yaw rate's sign": ({"change": replaced(5, lambda r: -r)}, "yaw_rate: over half a second"),
    "time in ms": ({"clock": 1e3}, "the time is in milliseconds"),
}


@pytest.mark.parametrize(("fault", "words"), FAULTS.values(), ids=FAULTS)
def test_a_wrong_input_is_named_before_the_car_is_a_metre_off_or_within_3_s(fault, words, caplog):
    own = tracker()
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        driven = drive(Wrong(own, **fault), BEND, 5.0, car=on_road(BEND, s=2.0, speed=10.0), wheel_angle=0.0)
    said = [k for k, (_, told) in enumerate(driven.calls) if told.suspect]
    assert said
    assert words in driven.calls[said[0]][1].suspect[0]
    time = driven.calls[said[0]][0]
    assert time < 3.0 or abs(driven.offset[int(time / 0.02)]) < 1.0
    assert [words in record.message for record in caplog.records].count(True) == 1


@pytest.mark.parametrize("seed", [1, 2])
def test_honest_inputs_are_not_doubted(seed):
    """Late, jittered, lost, repeated and wrapped, with an offset of the yaw and noise of the speed."""
    mpc = at.MPC(CAR, profile="road", belief="unknown", learning=at.Learning())
    honest = Wrong(at.Tracker(mpc, BEND), replaced(3, lambda yaw: yaw + 0.01))
    driven = drive(
        honest, BEND, 15.0, car=on_road(BEND, s=2.0), jitter=(0.03, 0.07), missing=7, late=0.1, reorder=0.05, repeat=5,
        wrapped=True, noise=(0.03, 0.03, 0.003, 0.15, 0.01), seed=seed,
    )  # fmt: skip
    assert {told.suspect for _, told in driven.calls} == {()}
    assert at.Status.SLIDING not in driven.statuses


class DelayedCommands:
    """A tracker whose commands reach the car some calls later."""

    def __init__(self, tracker, calls):
        self.tracker, self.commands = tracker, [0.0] * calls

    def step(self, *sample, **times):
        answer = self.tracker.step(*sample, **times)
        self.commands.append(answer.command)
        return answer._replace(command=self.commands.pop(0))


@pytest.mark.parametrize(
    ("calls", "learning", "is_reported"), [(0, None, False), (3, None, True), (3, at.Learning(), False)]
)
def test_a_specified_delay_that_driving_contradicts_is_reported_once_and_a_learned_one_never(
    calls, learning, is_reported, caplog
):
    belief = at.Steering(lag=0.15, dead_time=0.0, rate=0.5)
    mpc = at.MPC(CAR, profile="road", belief=belief, computation=0.05, learning=learning)
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        run = drive(DelayedCommands(at.Tracker(mpc, BEND), calls), BEND, 20.0, car=on_road(BEND, s=2.0, speed=10.0))
    records = [record.message for record in caplog.records if "the specified steering delay" in record.message]
    assert len(records) == is_reported
    assert all(
        "of 0.20 s is too short; learn the delay, MPC(..., learning=Learning())" in message for message in records
    )
    assert len(run.calls[-1][1].suspect) == is_reported


def test_a_wrong_steering_sign_ends_the_steering_and_engaging_begins_anew():
    own = tracker()
    driven = drive(Wrong(own, command=-1.0), BEND, 4.0, car=on_road(BEND, s=20.0), wheel_angle=0.0)
    held = [told for _, told in driven.calls if told.status is at.Status.HELD]
    assert len(held) > 10
    assert held[-1].command == 0.0
    assert np.abs(np.diff([told.command for told in held])).max() < 0.5 * 0.05 + 1e-9
    own.engage()
    again = own.step(0.0, 25.0, 0.0, 0.0, 15.0, 0.0)
    assert (again.status, again.suspect) == (at.Status.OK, ())


def log_of_a_drive(path):
    with tracker(record=path) as own:
        drive(own, BEND, 15.0, car=on_road(BEND, s=2.0), wheel_angle=0.0, noise=(0.01, 0.01, 0.001, 0.0, 0.002))
    return read_columns(path, at.Reading())


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("record") / "loop.parquet"
    return path, log_of_a_drive(path)


def with_columns(columns, **changed):
    return replace(columns, values={**columns.values, **changed})


def test_a_record_is_a_log_whose_inputs_agree(recorded):
    _, columns = recorded
    assert {"time", "command", "speed", "yaw_rate", "vy", "acceleration", "wheel", "x", "y", "yaw"} <= set(
        columns.values
    )
    assert np.all(np.diff(columns.values["time"]) > 0.0)
    assert columns.values["time"].size == 300
    found = check_loop(columns, CAR)
    assert found.contradictions == ()
    assert sum(row.seconds > 5.0 for row in found.comparisons if "whole log" not in row.compared) == 5


@pytest.mark.parametrize("late", [0.2, -0.2])
def test_clocks_that_are_apart_are_told_where_a_third_signal_shows_it(recorded, late):
    _, columns = recorded
    time, rate = columns.values["time"], columns.values["yaw_rate"]
    said = check_loop(with_columns(columns, yaw_rate=np.interp(time - late, time, rate)), CAR).contradictions
    assert len(said) == 1
    assert "yaw and yaw_rate: their clocks differ by some 0.2 s" in said[0]


@pytest.mark.parametrize(("ahead", "axle"), [(-CAR.lr, "rear axle"), (CAR.lf, "front axle")])
def test_positions_of_an_axle_are_told_from_those_of_the_centre_of_mass(ahead, axle):
    """A log of slow bends, where the slip of the tyres is small beside the distance of the axle."""
    columns = slow_bends()
    x, y, yaw = (columns.values[name] for name in ("x", "y", "yaw"))
    moved = with_columns(columns, x=x + ahead * np.cos(yaw), y=y + ahead * np.sin(yaw))
    assert check_loop(columns, CAR).contradictions == ()
    assert [axle in sentence for sentence in check_loop(moved, CAR).contradictions] == [True]


def slow_bends():
    car, rows, noise = on_road(BEND, speed=6.0), [], random.Random(1)
    for k in range(1200):
        command = 0.12 * math.sin(0.05 * k * 0.5) if k % 300 > 100 else 0.0
        pose = (car.x + noise.gauss(0.0, 0.02), car.y + noise.gauss(0.0, 0.02), car.yaw + noise.gauss(0.0, 0.002))
        rows.append((0.05 * k, command, car.speed, car.yaw_rate + noise.gauss(0.0, 0.005), *pose))
        for _ in range(10):
            car.step(command, 0.005)
    names = ("time", "command", "speed", "yaw_rate", "x", "y", "yaw")
    return read_columns(dict(zip(names, np.array(rows).T, strict=True)), at.Reading())


# -- poses that drift -------------------------------------------------------------------------------------------------
STILL = (0.0, 0.0, 0.0)
DRIFTS = {
    "none": (STILL, STILL, ""),
    "x": ((0.8, 0.0, 0.0), STILL, "x, y: within seconds they moved"),
    "y": ((0.0, -0.6, 0.0), STILL, "x, y: within seconds they moved"),
    "yaw": ((0.0, 0.0, 0.04), STILL, "yaw: within seconds it changed"),
    "jump": (STILL, (0.0, 2.0, 0.0), "x, y: within seconds they moved"),
}


@pytest.mark.parametrize(("rates", "jump", "words"), DRIFTS.values(), ids=DRIFTS)
def test_a_pose_that_drifts_or_jumps_is_reported_before_it_is_1_5_m_wrong(rates, jump, words):
    """From 10 s on, in bends of up to 2 m/s^2, with noise of the sensors and errors of yaw rate and speed."""
    check, noise, pose, said = InputCheck(CAR, 0.05), random.Random(4), np.zeros(3), []
    for k in range(500):
        t, speed = 0.05 * k, 12.0
        rate = 0.16 * math.sin(0.4 * t)
        wrong = max(t - 10.0, 0.0) * np.array(rates) + (t >= 10.0) * np.array(jump)
        measured = pose + wrong + [noise.gauss(0.0, sigma) for sigma in (0.03, 0.03, 0.003)]
        speed_and_rate = 1.01 * speed + noise.gauss(0.0, 0.05), rate + noise.gauss(0.002, 0.003)
        new = check.add(t, t, tuple(measured), *speed_and_rate, noise.gauss(0.0, 0.03))
        said += [(sentence, float(np.hypot(*wrong[:2]))) for sentence in new]
        pose += 0.05 * np.array([speed * math.cos(pose[2]), speed * math.sin(pose[2]), rate])
    assert [sentence.startswith(words) for sentence, _ in said[:1]] == [True] * (words != "")
    assert all(wrong < 1.5 + 2.0 * (jump is not STILL) for _, wrong in said[:1])


@pytest.mark.parametrize("told_share", [0.5, 1.0, 2.0])
@pytest.mark.parametrize(("noise", "time"), [(0.03, 0.0), (0.1, 0.0), (0.3, 0.0), (0.1, 5.0), (0.3, 5.0)])
def test_noise_of_the_position_is_no_drift_for_a_check_that_is_told_of_it(noise, time, told_share):
    """White, or with a time constant (s); a drift of 2 m/s is one all the same."""
    for drift in (0.0, 2.0):
        check = InputCheck(CAR, 0.05, position_noise=told_share * noise)
        rng, pose, error = np.random.default_rng(8), np.zeros(3), np.zeros(2)
        memory = math.exp(-0.05 / time) if time else 0.0
        for k in range(1200):
            t, speed, rate = 0.05 * k, 12.0, 0.16 * math.sin(0.02 * k)
            error = memory * error + math.sqrt(1.0 - memory**2) * noise * rng.standard_normal(2)
            wrong = np.array([0.0, drift * max(t - 50.0, 0.0)])
            measured = (*(pose[:2] + error + wrong), pose[2] + rng.normal(0.0, 0.003))
            check.add(
                t, t, measured, speed + rng.normal(0.0, 0.05), rate + rng.normal(0.002, 0.003), rng.normal(0.0, 0.03)
            )
            pose += 0.05 * np.array([speed * math.cos(pose[2]), speed * math.sin(pose[2]), rate])
        assert any("they moved" in sentence for sentence in check.suspect) == (drift > 0.0)


# -- longitudinal acceleration ----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("signal", "words"), [
    (lambda change, gravity: 1.05 * change + 0.15, ""),
    (lambda change, gravity: -change, "the sign of the longitudinal acceleration is inverted"),
    (lambda change, gravity: change / 9.81, "the longitudinal acceleration is in g"),
    (lambda change, gravity: change + gravity, "contains gravity"),
], ids=["honest", "sign", "g", "gravity"])  # fmt: skip
def test_a_wrong_longitudinal_acceleration_is_named_within_30_s(signal, words):
    """Speeds with 1 % of noise, accelerations of up to 1.5 m/s^2, slopes of up to 8 % that change every 100 m."""
    check, noise, sentences = InputCheck(), random.Random(5), []
    for k in range(600):
        t = 0.05 * k
        speed = 14.0 + 3.0 * math.sin(0.5 * t)
        change, gravity = 1.5 * math.cos(0.5 * t), 0.8 * math.sin(0.44 * t + 1.0)
        forward = signal(change, gravity) + noise.gauss(0.0, 0.1)
        sentences += check.add(t, t, (math.nan,) * 3, speed * (1.0 + noise.gauss(0.0, 0.01)), forward=forward)
    assert [words in sentence for sentence in sentences] == [True] * (words != "")


# -- sliding ----------------------------------------------------------------------------------------------------------
def slides(speed, known, sideslip, seconds=6.0):
    """When the check says sliding: a car whose sideslip goes up at 3 s and down at 5 s, within a tenth of a second."""
    check, x, y, yaw, told, noise = InputCheck(CAR, 0.05), 0.0, 0.0, 0.0, [], random.Random(2)
    for k in range(round(seconds / 0.05)):
        t = 0.05 * k
        beta = sideslip * float(np.clip(min((t - 3.0) / 0.1, (5.0 - t) / 0.1 + 1.0), 0.0, 1.0))
        measured = speed * math.tan(beta) if known else math.nan
        where = x + noise.gauss(0.0, 0.03), y + noise.gauss(0.0, 0.03), yaw + noise.gauss(0.0, 0.003)
        check.add(t, t, where, speed, 0.12, measured)
        told.append(check.sliding)
        x += 0.05 * speed * math.cos(yaw + beta) / math.cos(beta)
        y += 0.05 * speed * math.sin(yaw + beta) / math.cos(beta)
        yaw += 0.05 * 0.12
    assert not known or check.suspect == ()  # without a lateral velocity a small sideslip looks like a drift
    return 0.05 * np.flatnonzero(told)


@pytest.mark.parametrize(("known", "most", "sideslip"), [(True, 0.5, 0.7), (False, 1.0, 0.25), (False, 1.0, -0.25)])
def test_sliding_is_told_in_time_and_is_over_when_it_is(known, most, sideslip):
    times = slides(15.0, known, sideslip)
    assert 3.0 < times[0] < 3.0 + most
    assert np.diff(times).max() < 0.06  # without a pause
    assert 5.2 < times[-1] < 5.9


def test_neither_a_small_sideslip_nor_a_slow_car_slides():
    assert slides(15.0, True, 0.1).size == slides(15.0, False, 0.1).size == 0
    assert slides(2.5, True, 0.3).size == 0


def test_a_tracker_says_that_the_car_slides():
    own = at.Tracker(at.Stanley(CAR, period=0.05), at.Road.from_segments([Line(length=400.0)]))
    for k in range(80):
        slip = 3.0 if k >= 60 else 0.0
        told = own.step(0.05 * k, 0.75 * k, 0.05 * slip * max(k - 60, 0), 0.0, 15.0, 0.0, lateral_velocity=slip)
        assert told.status is (at.Status.SLIDING if k >= 68 else at.Status.OK) or 60 <= k < 68


# -- the belief -------------------------------------------------------------------------------------------------------
def test_a_doubtful_belief_is_told_at_every_step_and_warned_of_once(monkeypatch, caplog):
    own = at.Tracker(called_back(at.MPC(CAR, profile="road", belief="unknown", learning=at.Learning())), BEND)
    monkeypatch.setattr(
        own.controller, "step", lambda *given, step=own.controller.step, **more: step(*given, **more)._replace(
            learned=tuple(2.0 * (name == "belief_state") for name in BELIEF_NAMES)
        )
    )  # fmt: skip
    with caplog.at_level(logging.WARNING, logger="adaptrack"):
        told = [own.step(0.05 * k, 0.75 * k, 0.0, 0.0, 15.0, 0.0).belief for k in range(4)]
    assert told == [at.BeliefState.AT_BOUND] * 4
    assert [record.message.count("at the end of its range") for record in caplog.records] == [1]


# -- the record -------------------------------------------------------------------------------------------------------
def sampled(t, now):
    """A sample with a speed alone."""
    return TrackerSample(
        **dict.fromkeys(TrackerSample._fields, math.nan) | dict(t=t, now=now, motion_time=t, speed=10.0)
    )


def test_a_killed_loop_leaves_what_it_had_and_the_next_one_puts_it_aside(tmp_path):
    path = tmp_path / "loop.parquet"
    killed = Recorder(path)
    for k in range(200):
        killed.add(sampled(0.05 * k, 0.05 * k), 0.01, 0.0)
    assert not path.exists()
    killed._stream.close()
    Recorder(path).close()
    left = read_columns(tmp_path / "loop-1.csv", at.Reading())
    assert left.values["time"][-1] > 9.95 - 2.1
    assert path.exists()
    assert not (tmp_path / "loop.parquet.csv").exists()


def test_late_samples_stand_at_their_own_time_beside_the_command_that_was_in_force(tmp_path):
    recorder = Recorder(tmp_path / "loop.csv")
    for k in range(60):
        age = 0.15 if k % 3 == 0 else 0.05
        recorder.add(sampled(0.05 * k - age, 0.05 * k), 0.001 * k, 0.0)
    recorder.close()
    recorder.close()
    log = read_columns(tmp_path / "loop.csv", at.Reading())
    time, command = log.values["time"] - 0.15, log.values["command"]  # a log begins at 0
    assert np.all(np.diff(time) > 0.0)
    known = time >= 0.0
    np.testing.assert_allclose(command[known], 0.001 * np.floor(time[known] / 0.05 + 1e-9), atol=1e-9)


def test_a_record_of_another_kind_or_place_is_refused(tmp_path):
    with pytest.raises(at.InvalidInput, match=r"must end in \.parquet or \.csv"):
        tracker(record=tmp_path / "loop.txt")
    (tmp_path / "file").write_text("")
    with pytest.raises(at.StorageError, match="cannot be written"):
        tracker(record=tmp_path / "file" / "loop.csv")


# -- the command ------------------------------------------------------------------------------------------------------
def run(monkeypatch, capsys, *arguments):
    monkeypatch.setattr("sys.argv", ["adaptrack", *map(str, arguments)])
    code = main()
    out, err = capsys.readouterr()
    return code, out, err


def test_check_loop_answers_first_and_by_its_exit_code(monkeypatch, capsys, recorded):
    path, _ = recorded
    code, out, _ = run(monkeypatch, capsys, "check-loop", path, "--vehicle", "paper")
    assert code == 0
    assert out.startswith("No contradictions in 6 of 10 comparisons")
    code, out, _ = run(monkeypatch, capsys, "check-loop", path, "--flip", "yaw_rate", "--json")
    assert code == 3
    assert "yaw_rate: " in json.loads(out)["contradictions"][0], out


@pytest.mark.parametrize(("columns", "words"), [
    ("t,steer", "no column for speed"),
    ("t,vx", "no signals could be compared: no column for yaw_rate"),
])  # fmt: skip
def test_check_loop_says_why_it_could_not_compare(monkeypatch, capsys, tmp_path, columns, words):
    rows = [f"{0.1 * k},10" for k in range(50)]
    (tmp_path / "log.csv").write_text("\n".join([columns, *rows]))
    code, _, err = run(monkeypatch, capsys, "check-loop", tmp_path / "log.csv")
    assert (code, words in err) == (2, True), err


UNITS = {
    "right": ({}, ""), "km/h": ({"speed": 3.6}, "km/h"), "deg/s": ({"yaw_rate": DEGREES}, "--units"),
    "command in degrees": ({"command": DEGREES}, "command=deg"), "sign": ({"command": -1.0}, "opposite signs"),
    "command at the steering wheel": ({"command": 16.0}, "steering wheel"),
}  # fmt: skip


def test_wrong_units_are_found_in_a_log_without_positions():
    for speed in (8.0, 25.0):
        log = weaving(speed)
        for name, (factors, words) in UNITS.items():
            columns = read_columns({n: values * factors.get(n, 1.0) for n, values in log.items()}, at.Reading())
            check = check_loop(columns)
            assert check.compared > 0
            assert [words in sentence for sentence in check.contradictions[:1]] == [True] * (words != ""), name


def weaving(speed):
    """A log of a car that weaves by up to 2 m/s^2."""
    car, rows, noise = on_road(BEND, speed=speed), [], np.random.default_rng(1)
    for k in range(1200):
        t = 0.05 * k
        car.speed = speed * (1.0 + 0.2 * math.sin(0.07 * t))
        command = (1.5 * CAR.wheelbase / speed**2 + 0.003) * (math.sin(0.5 * t) + 0.5 * math.sin(0.9 * t))
        rows.append((t, command, car.speed, car.yaw_rate + noise.normal(0.0, 0.002)))
        for _ in range(10):
            car.step(command, 0.005)
    return dict(zip(("time", "command", "speed", "yaw_rate"), np.array(rows).T, strict=True))


def test_a_steering_rate_in_degrees_is_refused_with_what_it_would_be():
    with pytest.raises(
        at.InvalidInput, match=r"rate = 30: no road wheels turn at 30 rad/s.*degrees per second give 0\.52"
    ):
        at.Steering(rate=30)


# -- the kernel -------------------------------------------------------------------------------------------------------
@pytest.mark.kernels
def test_a_check_whose_numbers_are_copied_goes_on_as_the_one_they_are_from():
    own, other, noise = InputCheck(CAR, 0.05), InputCheck(CAR, 0.05), random.Random(3)
    rows = [(0.05 * k, 0.05 * k, (0.75 * k, noise.gauss(0.0, 0.03), 0.0), 3.6 * 15.0, 0.0) for k in range(30)]
    for row in rows[:8]:
        own.add(*row)
    other.check.memory[:] = own.check.memory
    assert [own.add(*row) for row in rows[8:]] == [other.add(*row) for row in rows[8:]]
    assert "km/h" in own.suspect[0]


def test_each_mistake_has_a_sentence_and_one_subject_and_each_hypothesis_a_mistake_or_none():
    assert sum(ABOUT) == 2 ** len(MISTAKES) - 1
    for mistake in MISTAKE_TABLE:
        for for_log in (False, True):
            assert mistake.says(mistake.evidence, for_log).format(1.0, 2.0, 3.0, steered="command").endswith(".")
    labels = {label - 1 for comparison in COMPARISON_TABLE for label, *_ in comparison.hypotheses}
    assert labels <= set(range(-1, len(MISTAKES)))


def test_a_mistake_that_windows_and_the_whole_log_show_is_reported_once_with_its_option(recorded):
    _, columns = recorded
    values = columns.values
    result = check_loop(with_columns(columns, speed=3.6 * values["speed"]), CAR)
    assert [sentence for sentence in result.contradictions if "km/h" in sentence] == [result.contradictions[0]]
    assert "the speed is in km/h; --units speed=km/h." in result.contradictions[0]
    assert sum(row.verdict == "contradictory" for row in result.comparisons) >= 2
