"""It grows: a model of another size, a controller, an estimator and plants of one's own drive without a line in src."""

import importlib
import inspect
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from adaptrack.base.errors import ContractError, InvalidInput
from adaptrack.cars import plant as plant_module
from adaptrack.cars.plant import SingleTrack, SteppedPlant, UserPlant, check_plant
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC, Tuning, UserController, check_controller, published_mpc
from adaptrack.control.estimation import Deadbeat, UserEstimator, check_estimator
from adaptrack.control.models import SingleTrackModel, UserModel, check_model
from adaptrack.control.scheduling import Constant
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.simulate import rollout, simulate
from adaptrack.scenario import load_scenario
from adaptrack.tuning.runs import operating_point_runs

CAR = load_vehicle("paper")
PLANT = SingleTrack(CAR)
LANE_CHANGE = load_scenario("lane-change", amplitude=2.0, speed=10.0, friction=0.9, duration=4.0)


def kinematic(speed, period, p, a, b, e):
    """Two states, yaw and y, of a bicycle without slip: yaw' = v u/L, y' = v yaw."""
    rate = speed / p[0]
    a[0, 0], a[0, 1], a[1, 0], a[1, 1] = 1.0, 0.0, speed * period, 1.0
    b[0], b[1] = rate * period, 0.5 * speed * rate * period**2
    e[0], e[1] = 0.0, 0.0


def deadbeat(speed, measured, command, a, b, parameters, memory, x, d):
    """The paper's estimator written out: d = x - A x_before - B u, with the last good measurement for a missing one."""
    n = x.size
    places = (0, 1, 2, 3) if n == 4 else (1, 3, 0, 0)
    for i in range(n):
        value = measured[places[i]]
        x[i] = value if math.isfinite(value) else memory[i]
    for i in range(n):
        expected = b[i] * command
        for j in range(n):
            expected += a[i, j] * memory[j]
        d[i] = x[i] - expected if memory[n] > 0.5 else x[i] - b[i] * command
        if memory[n] < 0.5:
            for j in range(n):
                d[i] -= a[i, j] * x[j]
    for i in range(n):
        memory[i] = x[i]
    memory[n] = 1.0


def proportional(situation, reference, road, tuning, parameters, memory, answer):
    """Steer by the offset and the yaw angle; count the steps in the memory."""
    angle = tuning[0] * (reference[0] - situation[3]) - tuning[1] * situation[1]
    last = situation[5]
    memory[0] += 1.0
    least, most = max(parameters[3], last + parameters[1]), min(parameters[4], last + parameters[2])
    answer[0] = min(max(angle, least), most) if math.isfinite(angle) else last
    answer[1] = memory[0]


def same(run, other):
    """Whether two trajectories hold the same numbers."""
    columns = run.columns()
    return all(
        np.array_equal(columns[name], values, equal_nan=True)
        for name, values in other.columns().items()
        if name != "step_time"
    )


# -- a prediction model of another size -------------------------------------------------------------------------------
MODEL = UserModel(kinematic, ("yaw", "y"), parameters={"wheelbase": CAR.wheelbase}, period=0.05, label="kinematic")


def test_a_model_of_two_states_is_admitted_and_drives_alike_from_python_and_compiled():
    check_model(MODEL)
    mpc = MPC(CAR, Tuning(30, 4, 1.0, 10.0), period=0.05, model=MODEL, preview=True)
    run = simulate(PLANT, mpc, LANE_CHANGE)
    assert same(run, rollout(PLANT, mpc, LANE_CHANGE))
    assert run.failed is None
    assert np.abs(run.error).max() < 0.5
    batch = rollout_batch(PLANT, mpc, LANE_CHANGE, [[30, 4, 1.0, 10.0], [20, 3, 1.0, 50.0]])
    assert batch.mse[0] == pytest.approx(np.mean(run.error**2), rel=1e-12)


def test_a_model_that_leaves_an_entry_unwritten_is_refused():
    def lazy(speed, period, p, a, b, e):
        a[0, 0] = 1.0

    with pytest.raises(ContractError, match="must be written"):
        check_model(UserModel(lazy, ("yaw", "y")))
    with pytest.raises(InvalidInput, match="with y as the last"):
        UserModel(lazy, ("y", "yaw"))


# -- an estimator of one's own ----------------------------------------------------------------------------------------
def test_increments_of_the_measured_state_are_the_deadbeat_estimator():
    model = SingleTrackModel(CAR, 0.05)
    custom = UserEstimator(deadbeat, memory_size=lambda n: n + 1, label="written out")
    check_estimator(custom, model)
    check_estimator(Deadbeat(), model)
    tuning = Tuning(25, 5, 1.0, 2.0)
    theirs = simulate(PLANT, published_mpc(CAR, tuning, period=0.05), LANE_CHANGE)
    ours = simulate(PLANT, MPC(CAR, tuning, period=0.05, estimator=custom), LANE_CHANGE)
    assert np.abs(ours.command - theirs.command).max() < 1e-9
    assert same(ours, rollout(PLANT, MPC(CAR, tuning, period=0.05, estimator=custom), LANE_CHANGE))


def test_the_deadbeat_estimator_refuses_a_model_with_a_state_that_is_not_measured():
    def with_wheels(speed, period, p, a, b, e):
        a[:], b[:], e[:] = 0.0, 0.0, 0.0

    with pytest.raises(InvalidInput, match="whole state"):
        MPC(CAR, model=UserModel(with_wheels, ("wheel_angle", "yaw", "y")))


# -- a compiled controller of one's own -------------------------------------------------------------------------------
def test_a_compiled_controller_drives_alike_from_python_and_compiled_with_named_diagnostics():
    custom = UserController(
        proportional, tuning={"offset_gain": 0.05, "yaw_gain": 1.0}, memory_size=1, diagnostics=("steps",),
        period=0.05, label="proportional",
    )  # fmt: skip
    check_controller(custom)
    run = simulate(PLANT, custom, LANE_CHANGE)
    assert same(run, rollout(PLANT, custom, LANE_CHANGE))
    assert run.diagnostics["steps"].tolist() == list(range(1, len(run) + 1))
    assert set(run.tuning) == {"offset_gain", "yaw_gain"}
    batch = rollout_batch(PLANT, custom, LANE_CHANGE, [[0.05, 1.0], [0.02, 0.5]])
    assert batch.mse[0] == pytest.approx(np.mean(run.error**2), rel=1e-12)
    assert batch.mse[1] != batch.mse[0]


def test_a_law_that_answers_no_number_holds_the_last_command_alike_from_python_and_compiled():
    def fails_at_times(situation, reference, road, tuning, parameters, memory, answer):
        memory[0] += 1.0
        answer[0] = math.nan if memory[0] % 3.0 == 0.0 else 0.001 * memory[0]

    custom = UserController(fails_at_times, memory_size=1, period=0.05, label="moody")
    run = simulate(PLANT, custom, LANE_CHANGE)
    assert same(run, rollout(PLANT, custom, LANE_CHANGE))
    assert run.held.tolist() == [(k + 1) % 3 == 0 for k in range(len(run))]
    assert (np.diff(run.command)[1::3] == 0.0).all()
    assert run.failed is None


# -- plants of one's own ----------------------------------------------------------------------------------------------
class Bicycle(SteppedPlant):
    """A kinematic bicycle in plain Python, as an outside simulator would be."""

    def reset(self, motion):
        self.motion = np.array(motion)

    def step(self, dt, steering, acceleration, environment):
        x, y, yaw, v, _, _ = self.motion
        rate = v * math.tan(steering) / 2.8
        middle = yaw + 0.5 * dt * rate
        place = x + dt * v * math.cos(middle), y + dt * v * math.sin(middle), yaw + dt * rate
        self.motion = np.array([*place, v + dt * acceleration, 0.0, rate])
        return self.motion


def test_a_stepped_plant_is_admitted_and_driven():
    plant = Bicycle()
    check_plant(plant)
    mpc = published_mpc(CAR, Tuning(30, 5, 1.0, 300.0), period=0.05, preview=True)
    run = simulate(plant, mpc, LANE_CHANGE, profile="road")
    assert run.failed is None
    assert np.abs(run.error).max() < 0.5
    assert np.allclose(run.vx, 10.0)
    with pytest.raises(InvalidInput, match="must be a Plant; simulate"):
        rollout(plant, mpc, LANE_CHANGE)
    late = run.command[:-2] - run.steering[1:-1]
    assert np.abs(late).max() > 1e-4, "it steers behind the profile's actuator, with lag and delay"
    assert np.abs(np.diff(run.steering)).max() <= 0.5 * 0.05 + 1e-9  # rad/s


@pytest.mark.parametrize("plant", [SingleTrack(CAR), Bicycle()], ids=["compiled", "stepped"])
def test_a_tuning_drives_as_it_stands_though_the_mpc_of_the_runs_has_a_scheduler(plant):
    tuning, points = Tuning(30, 5, 1.0, 300.0), [[10.0, 1.0, 0.9, 0.0], [15.0, -1.0, 0.9, 0.0]]
    plain = published_mpc(CAR, tuning, period=0.05)
    scheduled = published_mpc(CAR, tuning, period=0.05, scheduler=Constant(Tuning(20, 3, 1.0, 3000.0)))
    sets = (operating_point_runs(plant, mpc, points, "road") for mpc in (plain, scheduled))
    np.testing.assert_array_equal(*(runs.drive(tuning, [3]) for runs in sets))


@pytest.fixture
def plugged(run_command, monkeypatch, tmp_path):
    """Run a command with the module `bicycles` in the folder at hand, which registers the bicycle."""
    head = "import math\nimport numpy as np\nfrom adaptrack.cars.plant import SteppedPlant, register_plant\n\n"
    last = '\nregister_plant("bicycle", lambda vehicle, tyre: Bicycle())\n'
    (tmp_path / "bicycles.py").write_text(head + inspect.getsource(Bicycle) + last)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    monkeypatch.setattr(plant_module._registry, "factories", dict(plant_module._registry.factories))
    monkeypatch.setattr("adaptrack.results.style.PNG_DPI", 20)

    def run(*arguments):
        monkeypatch.delitem(sys.modules, "bicycles", raising=False)
        return run_command(*arguments)

    yield run
    sys.modules.pop("bicycles", None)


def test_a_plant_without_a_name_a_plug_in_without_a_file_and_a_certificate_of_steps_are_refused(plugged):
    for command, words in (
        ("drive step --plant bicycle", "There is no plant 'bicycle'"),
        ("drive step --plugin tricycles", "--plugin tricycles: no such module"),
        ("drive step --plugin .", "--plugin .: no such module"),
        ("certify road-nn --plugin bicycles --plant bicycle", "has no equations that a certificate can linearise"),
    ):
        code, _, err = plugged(*command.split())
        assert code == 2
        assert words in err


@pytest.mark.parametrize(("source", "fault"), [
    (b"x = 1\n\ndef f(:\n", "line 3: SyntaxError: invalid syntax"),
    (b"import json\njson.loads('[')\n", r"line 2: (json\.decoder\.)?JSONDecodeError"),
    (b"def f():\n    1 / 0\nf()\n", "line 2: ZeroDivisionError: division by zero"),
    (b"import no_such_module_at_all\n", "line 1: ModuleNotFoundError: No module named 'no_such_module_at_all'"),
    (b"e = ValueError('x')\ne.add_note('why')\nraise e\n", "line 3: ValueError: x"),
    (b"raise SystemExit(0)\n", "line 1: SystemExit: 0"),
    (b"a = '\xe9'\n", r"line 1: SyntaxError: \(unicode error\)"),
    (b"a = '\0'\n", "SyntaxError: source code string cannot contain null bytes"),
    (b"import adaptrack as at\nat.register_plant('dual-track', print)\n", "line 2: .*choose another name"),
])  # fmt: skip
def test_a_plugin_that_fails_is_refused_with_its_line(source, fault, plugged, monkeypatch):
    Path("faulty.py").write_bytes(source)
    monkeypatch.delitem(sys.modules, "faulty", raising=False)
    importlib.invalidate_caches()
    code, _, err = plugged("drive", "step", "--plugin", "faulty")
    assert code == 2
    assert re.search(rf"^adaptrack: plugin faulty: .*({fault}).*; correct the module\.$", err)


def rolling(x, u, environment, p, dx):
    """A bicycle with the speeds of two wheels, which follow the vehicle's with a lag."""
    slip_f = u[0] - math.atan2(x[4] + 1.2 * x[5], max(x[3], 1.0))
    slip_r = -math.atan2(x[4] - 1.6 * x[5], max(x[3], 1.0))
    front, rear = 60e3 * slip_f, 80e3 * slip_r
    dx[0] = x[3] * math.cos(x[2]) - x[4] * math.sin(x[2])
    dx[1] = x[3] * math.sin(x[2]) + x[4] * math.cos(x[2])
    dx[2] = x[5]
    brake = 1000.0 * ((x[3] - p[0] * x[6]) + (x[3] - p[0] * x[7]))  # N, what slipping wheels take
    dx[3] = (u[1] - brake) / 1500.0 + x[4] * x[5]
    dx[4] = (front + rear) / 1500.0 - x[3] * x[5]
    dx[5] = (1.2 * front - 1.6 * rear) / 2500.0
    dx[6] = (x[3] / p[0] - x[6]) / 0.05
    dx[7] = (x[3] / p[0] - x[7]) / 0.05


def wheeled(start):
    return UserPlant(rolling, {"radius": 0.3}, 1500.0, own_states=("front_wheel", "rear_wheel"), start=start)


def test_a_compiled_plant_starts_at_its_rolling_equilibrium():
    plant = wheeled(lambda motion: [motion[3] / 0.3, motion[3] / 0.3])
    check_plant(plant)
    assert plant.initial_state([0, 0, 0, 12.0, 0, 0])[6:].tolist() == pytest.approx([40.0, 40.0])
    mpc = published_mpc(CAR, Tuning(30, 5, 1.0, 5.0), period=0.05)
    still = load_scenario("step", amplitude=0.0, speed=12.0, duration=1.0)
    rolling_slope, locked_slope = (
        p.derivative(p.initial_state([0, 0, 0, 12.0, 0, 0]), [0.0, 0.0], [0.9, 0.9, 0.9, 0.9, 0.0, 0.0])[3:]
        for p in (plant, wheeled(None))
    )
    assert np.allclose(rolling_slope, 0.0, atol=1e-12)
    assert not np.allclose(locked_slope, 0.0)
    assert same(simulate(plant, mpc, still), rollout(plant, mpc, still))
    run = simulate(plant, mpc, LANE_CHANGE)
    assert same(run, rollout(plant, mpc, LANE_CHANGE))
    assert run.failed is None
