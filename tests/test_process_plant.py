"""A simulator in another process drives as one here does, and whatever it does, it is ended and said what it did."""

import contextlib
import gc
import os
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.errors import ContractError, InvalidInput
from adaptrack.cars.plant import SteppedPlant
from adaptrack.peers import process_plant
from adaptrack.peers.process_plant import ProcessPlant
from foreign_loop import example

SIMULATOR = example("simulator_in_another_process")
SERVE = [sys.executable, SIMULATOR.__file__, "--serve"]
MOTION = np.array([1.0, -2.0, 0.1, 12.0, 0.3, -0.2])
AROUND = np.array([0.9, 0.9, 0.9, 0.9, 0.0, 0.0, 0.0])

HELLO = "print('{\"adaptrack_plant\": 1}', flush=True); "
ANSWER = "import sys, json; motion = None\nfor line in sys.stdin:\n motion = json.loads(line).get('motion', motion)\n "


@pytest.fixture(autouse=True)
def _soon(monkeypatch):
    monkeypatch.setattr(process_plant, "_GRACE", 0.2)


class Here(SteppedPlant):
    """The example's simulator in this process."""

    mass = SIMULATOR.MASS

    def reset(self, motion):
        self.motion = motion.tolist()

    def step(self, dt, steering, acceleration, environment):
        asked = {"do": "step", "dt": dt, "steering": steering, "acceleration": acceleration}
        self.motion = SIMULATOR.answer(self.motion, asked | {"environment": environment.tolist()})
        return self.motion


def speaking(program, **options):
    """A plant whose process runs a Python program."""
    return ProcessPlant([sys.executable, "-c", program], **options)


def is_running(number):
    try:
        os.kill(number, 0)
    except ProcessLookupError:
        return False
    return True


# -- driving ----------------------------------------------------------------------------------------------------------
def test_it_drives_to_the_bit_as_the_same_simulator_here():
    scenario = at.load_scenario("lane-change", duration=4.0, speed=12.0)
    mpc = at.MPC(at.load_vehicle("paper"), profile="road")
    here = at.simulate(Here(), mpc, scenario, profile="road", seed=3)
    with ProcessPlant(SERVE) as plant:
        there = at.simulate(plant, mpc, scenario, profile="road", seed=3)
        again = at.simulate(plant, mpc, scenario, profile="road", seed=3)
    assert (plant.name, plant.mass) == ("bicycle over a pipe", SIMULATOR.MASS)
    for name in ("X", "Y", "psi", "vy", "command"):
        np.testing.assert_array_equal(getattr(there, name), getattr(here, name))
        np.testing.assert_array_equal(getattr(again, name), getattr(here, name))


def test_the_example_passes_the_checker_and_drives(capsys):
    assert SIMULATOR.main(seconds=6.0) < 0.1
    assert "bicycle over a pipe: RMS 0.0" in capsys.readouterr().out


def test_it_drives_along_a_road():
    road = at.generate_road("country", length=150.0, seed=3)
    with ProcessPlant(SERVE) as plant:
        run = at.simulate(plant, at.MPC(at.load_vehicle("paper"), profile="road"), at.RoadDrive(road, 10.0),
                          profile="road")  # fmt: skip
    assert run.failed is None
    assert np.abs(run.road["offset"]).max() < 0.5


def test_a_state_that_is_not_finite_ends_the_run_and_not_the_process():
    program = (
        f"{HELLO}{ANSWER}print(json.dumps({{'motion': motion if 'reset' in line else [float('nan')] * 6}}), flush=True)"
    )
    with speaking(program) as plant:
        run = at.simulate(plant, at.MPC(at.load_vehicle("paper"), profile="road"),
                          at.load_scenario("lane-change", duration=2.0), profile="road")  # fmt: skip
        assert run.failed == "not-finite"
        plant.reset(MOTION)


def test_compiled_runs_refuse_it_with_the_remedy():
    with ProcessPlant(SERVE) as plant, pytest.raises(InvalidInput, match=r"use simulate\(\.\.\.\)"):
        at.rollout_batch(plant, at.MPC(at.load_vehicle("paper"), profile="road"), [at.load_scenario("sine")],
                         profile="road")  # fmt: skip


# -- what goes wrong --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("program", "said"),
    [
        ("print('loading', flush=True)", r"greeting is no JSON object but b'loading'; .*standard error"),
        ("print('[1]', flush=True)", "greeting is no JSON object"),
        ("print('{\"hello\": 1}', flush=True)", "the first line must be a greeting"),
        ("print('{\"adaptrack_plant\": 2}', flush=True)", "the first line must be a greeting"),
        ("print('{\"adaptrack_plant\": true}', flush=True)", "the first line must be a greeting"),
        ("print('[' * 100_000, flush=True)", "greeting is no JSON object"),
        ('print(\'{"adaptrack_plant": 1, "mass": 1%s}\' % ("0" * 400), flush=True)', "mass = inf of its greeting"),
        ('print(\'{"adaptrack_plant": 1, "mass": -3}\', flush=True)', r"mass = -3\.0 of its greeting"),
        (
            "import sys; print('no licence', file=sys.stderr); sys.exit(3)",
            r"(?s)exit status 3 before its greeting.*no lic",
        ),
        ("import time; time.sleep(30)", "its greeting did not come within 0.3 s: .*start_timeout="),
        ("print('x' * 2_000_000, flush=True); import time; time.sleep(30)", "its greeting is longer than"),
    ],
)
def test_a_process_that_greets_otherwise_is_refused(program, said):
    with pytest.raises(ContractError, match=said):
        speaking(program, start_timeout=0.3 if "sleep" in program and "print" not in program else 60.0)


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ("print('{\"motion\": [1, 2]}', flush=True)", r"reset must be answered with .*six numbers"),
        ('print(\'{"motion": [1, 2, 3, 4, 5, "six"]}\', flush=True)', "six numbers"),
        ("print('{\"motion\": [0, 0, 0, 0, 0, 0]}', flush=True)", "reset answered with the motion"),
        ("print('{\"motion\": [1%s, 0, 0, 0, 0, 0]}' % ('0' * 400), flush=True)", r"with the motion \[inf, 0.0"),
        ("print('{\"motion\": [true, 0, 0, 0, 0, 0]}', flush=True)", "six numbers"),
        ("print('{\"motion\": ' + '[' * 100_000, flush=True)", "no JSON object"),
        ('print(\'{"error": "no such map"}\', flush=True)', "instead of the answer to reset it reports: no such map"),
        ("print('not json', flush=True)", "the answer to reset is no JSON object"),
        ("raise SystemExit(5)", "ended with exit status 5 before the answer to reset"),
        ("import time; time.sleep(30)", "the answer to reset did not come within 0.5 s: .*timeout="),
    ],
)
def test_an_answer_that_is_none_is_refused_and_ends_the_process(answer, said):
    plant = speaking(f"{HELLO}{ANSWER}{answer}", timeout=0.5 if "sleep" in answer else 60.0)
    with pytest.raises(ContractError, match=said):
        plant.reset(MOTION)
    assert not is_running(plant._process.pid)
    with pytest.raises(ContractError, match="has been ended: make a new ProcessPlant"):
        plant.step(0.02, 0.0, 0.0, AROUND)


def test_a_process_that_dies_between_two_steps_is_said_to_have():
    plant = ProcessPlant(SERVE)
    plant.reset(MOTION)
    plant._process.kill()
    plant._process.wait()
    with pytest.raises(ContractError, match="the process ended with exit status -9 before"):
        plant.step(0.02, 0.0, 0.0, AROUND)


def test_an_answer_that_is_there_before_it_was_asked_for_is_not_believed():
    with speaking(
        f"{HELLO}{ANSWER}sys.stdout.write(2 * (json.dumps({{'motion': motion}}) + '\\n')); sys.stdout.flush()"
    ) as plant:
        plant.reset(MOTION)
        with pytest.raises(ContractError, match=r"before step it said b'.*unasked; every line is answered with one"):
            plant.step(0.02, 0.0, 0.0, AROUND)


def test_an_answer_to_a_line_that_was_not_read_yet_is_not_believed():
    answer = f"time.sleep(0.05); print(json.dumps({{'motion': {MOTION.tolist()}}}), flush=True)"
    with (
        speaking(f"import time, json; {HELLO}{answer}; time.sleep(5)") as plant,
        pytest.raises(ContractError, match=r"reset it said .*unasked; every line is answered with one"),
    ):
        plant.reset(MOTION)


def test_an_answer_too_many_that_comes_last_is_found_at_the_end():
    program = (
        f"{HELLO}{ANSWER}print(json.dumps({{'motion': motion}}), flush=True)\nprint(json.dumps({{'motion': motion}}))"
    )
    plant = speaking(program)
    plant.reset(MOTION)
    with pytest.raises(ContractError, match="unasked; every line is answered with one: what was driven may be wrong"):
        plant.close()
    assert not is_running(plant._process.pid)
    plant.close()


def test_a_process_that_stops_reading_is_too_late():
    with speaking(f"import time; {HELLO}time.sleep(5)", timeout=0.1) as plant:
        pipe = plant._process.stdin.fileno()
        blocks = os.get_blocking(pipe)
        os.set_blocking(pipe, False)
        with contextlib.suppress(BlockingIOError):
            while True:
                os.write(pipe, b" " * 1024)
        os.set_blocking(pipe, blocks)
        with pytest.raises(ContractError, match=r"did not read reset within 0\.1 s"):
            plant.reset(MOTION)


def test_ctrl_c_between_a_line_and_its_answer_ends_the_process(press_ctrl_c):
    with speaking(f"import time; {HELLO}time.sleep(60)") as plant:
        press_ctrl_c(after=0.05)
        with pytest.raises(KeyboardInterrupt):
            plant.reset(MOTION)
        with pytest.raises(ContractError, match="has been ended"):
            plant.reset(MOTION)


@pytest.mark.parametrize("longest", [1e-9, 1e-300, 5e-324])
def test_steps_without_end_are_refused_before_the_first(longest):
    greeting = f'print(\'{{"adaptrack_plant": 1, "longest_step": {longest}}}\', flush=True); '
    with speaking(
        f"{greeting}import sys, json; print(json.dumps({{'motion': json.loads(input())['motion']}}))"
    ) as plant:
        with pytest.raises(InvalidInput, match=r"steps in a control period of 0\.05 s = .*: at most 10,000 steps"):
            at.check_plant(plant, period=0.05)
        with pytest.raises(InvalidInput, match="at most 10,000 steps"):
            at.simulate(
                plant, at.MPC(at.load_vehicle("paper"), profile="road"), at.load_scenario("sine"), profile="road"
            )


def test_what_goes_to_standard_error_is_read_and_only_its_end_kept():
    flood = "import os; os.write(2, b'x' * 1_000_000 + b'the last word'); "
    with speaking(f"{flood}{HELLO}{ANSWER}{flood}print('no answer', flush=True)") as plant:
        assert os.readlink(f"/proc/{plant._process.pid}/fd/2").startswith("pipe:")  # no file that grows
        with pytest.raises(ContractError) as refused:
            plant.reset(MOTION)
    assert str(refused.value).endswith("xxx" + "the last word")
    assert len(str(refused.value)) < 2500


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"command": "simulator --road"}, "must be a list of texts"),
        ({"command": []}, "must be a list of texts"),
        ({"command": ["/no/such/simulator"]}, "cannot be started: .*No such file"),
        ({"command": SERVE, "timeout": 0.0}, r"timeout = 0\.0 s"),
        ({"command": SERVE, "start_timeout": "long"}, "start_timeout = 'long'"),
    ],
)
def test_a_command_that_cannot_be_is_refused(options, said):
    with pytest.raises(InvalidInput, match=said):
        ProcessPlant(**options)


# -- it is always ended -----------------------------------------------------------------------------------------------
STUBBORN = f"import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); {HELLO}time.sleep(60)"


@pytest.mark.parametrize("program", [f"{HELLO}{ANSWER}pass", STUBBORN], ids=["obedient", "stubborn"])
@pytest.mark.parametrize("end", ["close", "with", "forgotten"])
def test_the_process_is_ended(program, end):
    plant = speaking(program)
    number = plant._process.pid
    assert is_running(number)
    if end == "close":
        plant.close()
        plant.close()
    elif end == "with":
        with plant:
            pass
    else:
        del plant
        gc.collect()
    assert not is_running(number)


def test_what_the_process_started_is_ended_with_it():
    program = "import subprocess, sys, time; child = subprocess.Popen(['sleep', '60']); "
    plant = speaking(
        program + 'print(\'{"adaptrack_plant": 1, "name": "%d"}\' % child.pid, flush=True); time.sleep(60)'
    )
    child = int(plant.name)
    assert is_running(child)
    plant.close()
    assert ends(child)


def ends(number):
    """Whether a process ends soon; nobody may be there to wait for an orphan."""
    end = time.monotonic() + 1.0
    while is_running(number) and _state(number) != "Z":
        if time.monotonic() > end:
            os.kill(number, signal.SIGKILL)
            return False
        time.sleep(0.005)
    return True


def test_what_an_ended_process_leaves_behind_is_ended():
    quiet = "stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL"
    plant = speaking(
        f"import subprocess; child = subprocess.Popen(['sleep', '60'], {quiet}); "
        'print(\'{"adaptrack_plant": 1, "name": "%d"}\' % child.pid, flush=True)'
    )
    child = int(plant.name)
    with pytest.raises(ContractError, match="ended with exit status 0 before"):
        plant.reset(MOTION)
    assert ends(child)


def _state(number):
    """Of a process, as Linux tells it: R, S, Z, ..."""
    return Path(f"/proc/{number}/stat").read_text().rsplit(")", 1)[1].split()[0]


def test_the_end_of_the_interpreter_ends_it(run_python):
    program = (
        "from adaptrack.peers.process_plant import ProcessPlant\n"
        f"plant = ProcessPlant({SERVE!r})\nprint(plant._process.pid)\nraise SystemExit(0)"
    )
    number = int(run_python("-c", program))
    assert not is_running(number)
