"""Functions of one's own: the same car however they are called, and what goes wrong in them is heard of."""

import ctypes.util
import math
import pickle

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core import library
from adaptrack.core.kernel import INTERPRETED, INTERRUPTS, float64, vector, void
from adaptrack.core.member import member
from adaptrack.core.plants.user import compile_plant
from adaptrack.core.roads.road import RoadAheadRecord
from programs import run_program
from small_cars import PARAMETERS, linear_car

pytestmark = pytest.mark.skipif(INTERPRETED, reason="interpreted kernels call functions of one's own as they are")

CAR = at.load_vehicle("midsize-sedan")
C_PLANT = """
#include <math.h>
#include <stdint.h>
void right_hand_side(const double *x, int64_t nx, const double *u, int64_t nu, const double *environment, int64_t ne,
                     const double *p, int64_t np, double *dx, int64_t ndx) {
    double v = x[3] > 1.0 ? x[3] : 1.0;
    double front = 2.0 * p[4] * environment[0] * (u[0] - (x[4] + p[2] * x[5]) / v);
    double rear = -2.0 * p[5] * environment[2] * (x[4] - p[3] * x[5]) / v;
    dx[0] = x[3] * cos(x[2]) - x[4] * sin(x[2]);
    dx[1] = x[3] * sin(x[2]) + x[4] * cos(x[2]);
    dx[2] = x[5];
    dx[3] = u[1] / p[0] + x[4] * x[5];
    dx[4] = (front + rear + p[6] * environment[5]) / p[0] - x[3] * x[5];
    dx[5] = (p[2] * front - p[3] * rear) / p[1];
}
"""


def law(situation, reference, road, tuning, parameters, memory, answer):
    """Offset and heading, with a memory; the road is looked at."""
    memory[0] = 0.9 * memory[0] + 0.1 * (situation[3] - reference[0])
    command = -0.05 * (situation[3] - reference[0]) - 0.4 * situation[1] - 0.01 * memory[0] + 0.0 * road.station
    least, most = situation[5] + parameters[1], situation[5] + parameters[2]
    answer[0] = min(max(command, least), most)


def path_of(plant, controller=None):
    controller = controller or at.MPC(CAR, profile="road")
    run = at.simulate(plant, controller, at.load_scenario("lane-change"), profile="road")
    assert run.failed is None
    return run.Y


def is_same(path, other):
    """Whether two drives are the same: to the bit."""
    return np.array_equal(path, other)


@pytest.fixture
def no_compiler(monkeypatch):
    monkeypatch.setattr(library, "can_compile", lambda: False)
    compile_plant.cache_clear()
    yield
    compile_plant.cache_clear()


@pytest.fixture(scope="module")
def compiled():
    """Where the compiled plant goes."""
    if not library.can_compile():
        pytest.skip("needs a compiler")
    return path_of(at.UserPlant(linear_car, PARAMETERS, mass=1575.0))


def test_a_plant_that_is_called_back_drives_as_the_compiled_one(compiled, no_compiler):
    assert is_same(path_of(at.UserPlant(linear_car, PARAMETERS, mass=1575.0)), compiled)


def test_a_law_that_is_called_back_steers_as_the_compiled_one(compiled, monkeypatch):
    plant = at.UserPlant(linear_car, PARAMETERS, mass=1575.0)
    ours = path_of(plant, at.UserController(law, memory_size=1))
    monkeypatch.setattr(library, "can_compile", lambda: False)
    function = member(law, void(vector, vector, RoadAheadRecord, vector, vector, vector, vector))
    assert function.calls_python
    theirs = at.UserController(law, memory_size=1)
    theirs._compiled = function
    assert is_same(path_of(plant, theirs), ours)


def test_many_runs_ask_for_a_compiler_by_its_command(no_compiler):
    plant = at.UserPlant(linear_car, PARAMETERS, mass=1575.0)
    with pytest.raises(at.MissingExtra, match=r"linear_car: .*pip install 'adaptrack\[compile\]'"):
        at.rollout_batch(plant, at.MPC(CAR, profile="road"), at.load_scenario("lane-change"))


def test_what_is_raised_in_a_function_that_is_called_back_is_said_once_and_nothing_of_it_counts(no_compiler, caplog):
    def fails(a, out):
        out[0] = 1.0
        raise ZeroDivisionError("in the middle")

    function, out = member(fails, float64(vector, vector)), np.zeros(2)
    assert math.isnan(function(np.zeros(1), out))
    assert math.isnan(function(np.zeros(1), out))
    assert np.isnan(out).all()
    assert [entry.message for entry in caplog.records] == ["adaptrack: fails raised ZeroDivisionError('in the middle')"]


def interrupted(*arguments):
    """A user function in which Ctrl-C arrives."""
    raise KeyboardInterrupt


def call_alone(function):
    member(function, void(vector, vector))(np.zeros(1), np.zeros(1))


def drive_a_plant(function):
    path_of(at.UserPlant(lambda *arguments: function(*arguments), PARAMETERS, mass=1575.0))


def track_a_path(function):
    law = at.UserController(lambda *arguments: function(*arguments))
    at.Tracker(law, at.generate_road("lap")).step(0.0, 0.0, 0.0, 0.0, 10.0)


@pytest.mark.parametrize("call", [call_alone, drive_a_plant, track_a_path])
def test_ctrl_c_in_a_function_that_is_called_back_is_raised_when_its_kernel_returns(no_compiler, call):
    for _ in range(3):
        with pytest.raises(KeyboardInterrupt) as raised:
            call(interrupted)
        assert raised.traceback[-1].name == "interrupted"  # the traceback leads to it
    call_alone(lambda a, out: None)  # nothing is left of it
    assert not INTERRUPTS


def test_a_plant_in_c_drives_as_ours_alone_and_in_a_batch(tmp_path, compiled):
    (tmp_path / "plant.c").write_text(C_PLANT)
    run_program("gcc", "-O2", "-shared", "-fPIC", "-lm", "plant.c", "-o", "plant.so", cwd=tmp_path)
    function = at.CFunction(str(tmp_path / "plant.so"), "right_hand_side")
    plant = at.UserPlant(pickle.loads(pickle.dumps(function)), PARAMETERS, mass=1575.0)
    assert path_of(plant) == pytest.approx(compiled, rel=1e-9, abs=1e-12)
    runs = at.rollout_batch(plant, at.MPC(CAR, profile="road"), [at.load_scenario("lane-change")], profile="road")
    assert not runs.failed[0]


def test_a_function_that_is_not_in_its_library_is_refused_where_it_is_named():
    with pytest.raises(OSError, match="no_such_library"):
        at.CFunction("no_such_library.so", "f")
    with pytest.raises(AttributeError, match="no_such"):
        at.CFunction(ctypes.util.find_library("m") or "libm.so.6", "no_such")
