"""Shadow mode: what a log of a driver says of the belief; nothing is steered."""

import json
from dataclasses import replace

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from typer.testing import CliRunner

import adaptrack as at
from adaptrack.base.statistics import block_rms
from adaptrack.cli.app import app
from adaptrack.core.estimators.learning import BELIEF_NAMES, memory_of
from adaptrack.identification.reading import read_columns
from adaptrack.identification.shadow import ReadLog, Shadow
from adaptrack.results.console import print_result
from adaptrack.results.shadow import shadow_result

CAR = at.load_vehicle("midsize-sedan")
SOFT = CAR.replace(stiffness_front=0.6 * CAR.stiffness_front, stiffness_rear=0.6 * CAR.stiffness_rear)


def learning_mpc(car=CAR, profile="road"):
    return at.MPC(car, profile=profile, belief="unknown", learning=at.Learning())


def driven(mpc, seed=5, profile="road", scenario=None):
    """A drive of a controller: what it was given and asked for, by columns, and what it believed at every step.

    The first command is 0, the angle that the wheels have.
    """
    rows, step = [], mpc.step

    def recorded(measured, speed, *arguments, **options):
        answer = step(measured, speed, *arguments, **options)
        if not rows:
            mpc.applied(0.0)
            answer = answer._replace(angle=0.0)
        rows.append([speed, *measured[:6], answer.angle, *answer.learned])
        return answer

    mpc.step = recorded
    run = at.simulate(
        at.DualTrack(CAR), mpc, scenario or at.random_drive(40, duration=32.0), profile=profile, seed=seed
    )
    speed, vy, _, yaw_rate, _, _, _, command, *beliefs = np.array(rows).T
    log = {"time": run.t, "speed": speed, "yaw_rate": yaw_rate, "vy": vy, "command": command}
    return log, dict(zip(BELIEF_NAMES, beliefs, strict=False)), run


@pytest.fixture(scope="module")
def drive():
    return driven(learning_mpc())


@pytest.fixture(scope="module")
def watched(drive):
    return at.shadow(drive[0], CAR, computation=0.05).logs[0]


@pytest.fixture(scope="module")
def saved(drive, tmp_path_factory):
    """The file of a trajectory, which holds positions, and what came of it."""
    file = tmp_path_factory.mktemp("shadow") / "run.parquet"
    drive[2].save(file)
    return file, at.shadow(file, CAR).logs[0]


def test_the_belief_is_that_of_the_controller_that_drove_to_the_bit(drive, watched):
    for name, believed in drive[1].items():
        assert np.array_equal(watched.beliefs[name], believed), name


def test_learning_predicts_better_than_the_first_belief_and_the_steady_turn(watched):
    for ahead in (0.5, 1.0):
        predictions = watched.of("yaw_rate", ahead)
        assert predictions["first"].ours.high < 1.0
        assert predictions["steady"].ours.high < 1.0
        assert predictions["held"].ours.high < 1.0
    assert watched.verdict == "believable"
    assert not watched.warnings
    assert abs(watched.learned.lag + watched.learned.dead_time - 0.15) < 0.03


def test_what_the_model_is_right_about_is_predicted_exactly():
    """A linear car with the belief of its own steering, in a world without noise."""
    model = at.PathModel(CAR, 0.1, 0.15, 0.0)
    n, x = 600, np.zeros(5)
    time = 0.1 * np.arange(n)
    command = 0.01 * np.sin(0.7 * time) + 0.006 * np.sin(1.9 * time)
    a, b, _ = model.discrete(15.0)
    states = []
    for u in command:
        states.append(x)
        x = a @ x + b[:, 0] * u
    vy, _, yaw_rate, *_ = np.array(states).T
    log = {"time": time, "speed": np.full(n, 15.0), "yaw_rate": yaw_rate, "vy": vy, "command": command}
    sure = at.Uncertainty(lag=0.0, dead_time=0.0, stiffness=1.0, mass=0.0)
    exact = at.Learning(balance=1.0, bias=0.0)
    steering = at.Steering(lag=0.15, dead_time=0.0)
    shadow_log = at.shadow(log, CAR, profile="paper", belief=steering, uncertainty=sure, learning=exact).logs[0]
    errors = {predictor: prediction.rms.value for predictor, prediction in shadow_log.of("yaw_rate", 1.0).items()}
    assert errors["first"] < 0.01 * errors["steady"]
    assert errors["first"] < 2e-4
    assert errors["learned"] < 0.2 * errors["steady"]


def test_a_car_that_is_believed_wrongly_is_learned(drive):
    log = at.shadow(drive[0], SOFT, computation=0.05).logs[0]
    assert log.of("yaw_rate", 1.0)["first"].ours.high < 0.8
    assert 1.25 < log.learned.stiffness < 2.1


def test_a_wrong_sign_is_said_and_nothing_is_believed(drive):
    log = drive[0] | {"command": -drive[0]["command"]}
    shadow_run = at.shadow(log, CAR)
    assert not shadow_run.believable
    assert "opposite signs" in shadow_run.logs[0].doubts[0]
    assert "opposite signs" in shadow_result(shadow_run).answer


def test_a_belief_at_its_bound_is_warned_of(drive):
    narrow = at.Uncertainty(lag=0.02, dead_time=0.0, stiffness=1.2)
    log = at.shadow(drive[0], CAR, belief=at.Steering(lag=0.4, dead_time=0.1), uncertainty=narrow).logs[0]
    assert any("at the end of its range" in bound for bound in log.bounds)
    assert log.verdict != "believable"
    assert any("at the end" in warning.what and warning.seconds > 5.0 for warning in log.warnings)


def test_a_lateral_velocity_of_another_point_is_found(drive):
    """That of the front bumper."""
    log = drive[0] | {"vy": drive[0]["vy"] + (CAR.lf + 1.5) * drive[0]["yaw_rate"]}
    assert at.shadow(log, CAR, computation=0.05).spoiling == ("vy",)


def test_with_a_path_offset_and_command_are_compared_and_nothing_is_steered(saved, drive):
    log, run = saved[1], drive[2]
    assert log.of("y", 1.0)["steady"].ours.high < 1.0
    finite = np.isfinite(log.proposed)
    assert finite.mean() > 0.9
    assert np.sqrt(np.mean((log.proposed - log.command)[finite] ** 2)) < 0.02
    assert np.array_equal(log.command, run.command)  # the driver's, whatever was proposed


def test_another_path_changes_what_is_proposed_and_not_what_is_learned(saved):
    parallel = at.road_through(np.column_stack([np.linspace(-50.0, 3000.0, 60), np.full(60, 2.0)]))
    log = at.shadow(saved[0], CAR, path=parallel).logs[0]
    for name in BELIEF_NAMES:
        assert np.array_equal(log.beliefs[name], saved[1].beliefs[name])
    assert np.mean((log.proposed - saved[1].proposed)[:20]) > 0.01  # the path lies to the left


def test_a_record_of_a_loop_is_a_log(drive, watched, tmp_path):
    """With the columns of a tracker's record; what was not measured is NaN."""
    log, _, run = drive
    nothing = np.full(len(run), np.nan)
    table = log | {"acceleration": nothing, "wheel": nothing, "x": run.X, "y": run.Y, "yaw": run.psi}
    pyarrow.parquet.write_table(pyarrow.table(table), tmp_path / "loop.parquet")
    shadow_log = at.shadow(tmp_path / "loop.parquet", CAR, computation=0.05).logs[0]
    for name in BELIEF_NAMES:
        assert np.array_equal(shadow_log.beliefs[name], watched.beliefs[name])
    assert np.isfinite(shadow_log.proposed).mean() > 0.9


def test_a_dead_time_that_rounds_below_nothing_is_nothing():
    learner = learning_mpc().learner
    memory = learner.fresh()
    memory_of(memory, 0).beliefs.belief_dead_time = -7e-18
    assert learner.learned(memory).dead_time == 0.0


def test_the_belief_is_carried_from_log_to_log(drive):
    once, again = at.shadow([drive[0], drive[0]], CAR, computation=0.05).logs
    assert again.beliefs["belief_delay_sigma"][20] < 0.5 * once.beliefs["belief_delay_sigma"][20]
    assert again.before == once.before


def test_samples_between_instants_lie_on_the_line_between_neighbours(drive):
    log = drive[0] | {"time": drive[0]["time"] + 0.02}
    read = ReadLog.of(read_columns(log, at.Reading()), CAR)
    samples = next(iter(read.segments(0.05, None)))
    assert np.array_equal(samples.command, log["command"])
    fine = next(iter(read.segments(0.025, None)))
    assert fine.measured[1, 2] == pytest.approx(0.5 * (log["yaw_rate"][0] + log["yaw_rate"][1]))
    assert fine.command[1] == log["command"][0]


def test_a_log_without_commands_and_one_with_gaps_are_gone_through(drive):
    keep = np.ones(len(drive[0]["time"]), bool)
    keep[300:340] = False
    log = {name: values[keep] for name, values in drive[0].items()}
    log["wheel"] = log.pop("command")
    shadow_log = at.shadow(log, CAR).logs[0]
    assert np.isfinite(shadow_log.beliefs["belief_delay"]).all()
    assert any("segments" in note for note in shadow_log.notes)


def test_intervals_hold_the_error_and_are_wider_for_errors_that_follow_each_other():
    rng = np.random.default_rng(8)
    errors = np.repeat(rng.standard_normal(40), 25)
    block = np.arange(1000) // 25
    squared = np.stack([errors**2, 4.0 * errors**2])
    (rms, ratio_to_itself), (_, ratio) = block_rms(squared, block)
    assert rms.low < 1.0 < rms.high
    assert ratio_to_itself == (1.0, 1.0, 1.0)
    assert ratio == pytest.approx((0.5, 0.5, 0.5))
    alone, _ = block_rms(squared, np.arange(1000))[0]
    assert rms.high - rms.low > 3.0 * (alone.high - alone.low)


def test_the_answer_comes_first_and_fits_80_columns(watched, capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    print_result(replace(shadow_result(Shadow(CAR, 0.05, (watched,))), next_step="Next, ..."))
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("Learned delay 0.1")
    assert lines[1] == "Best prediction of the yaw rate 1 s ahead: learned model."
    assert lines[-1] == "Next, ..."
    assert max(map(len, lines[:20])) <= 80


def test_the_command_writes_a_page_and_json(saved, tmp_path):
    arguments = ["shadow", str(saved[0]), "--vehicle", "midsize-sedan", "--without", "x,y,yaw", "--json"]
    result = CliRunner().invoke(app, [*arguments, "--out", str(tmp_path / "page")])
    assert result.exit_code == 0
    assert json.loads(result.stdout)["logs"][0]["verdict"] == "believable"
    assert "Learning from logs of a driver" in (tmp_path / "page" / "index.html").read_text()


def test_a_signal_that_cannot_be_left_out_is_refused(drive):
    with pytest.raises(at.InvalidInput, match="must be of acceleration"):
        at.shadow(drive[0], CAR, without=["speed"])
    with pytest.raises(at.InvalidInput, match="one at least"):
        at.shadow([], CAR)
