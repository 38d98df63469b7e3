"""An exported speed control requests what it does in Python, to the bit, and refuses plans that are none."""

import copy
import ctypes
import math
import os
import struct

import numpy as np
import pytest

import adaptrack as at
import exported
from adaptrack.control.speed_control import SPEED_ACTIONS, SpeedControl, SpeedLimit, SpeedState
from adaptrack.control.tracker import Status, Tracker
from adaptrack.core.kernel import INTERPRETED, fields_of
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.export.c_library import export_c
from adaptrack.road import Comfort, Stop, plan_speed, road_through
from exported import Answer, CPath, CTracker, Exported, Sample

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="what is exported is compiled")]
CAR = at.load_vehicle("midsize-sedan")
ALONG = np.arange(0.0, 300.0, 5.0)
POINTS = np.stack([ALONG, 32.0 * (1.0 - np.cos(ALONG / 45.0))], axis=-1)
BAD_PLAN = 14
SPEED, GRADE, BANK, STOP = range(1, 5)
CONTROLS = {
    "informed": SpeedControl(CAR, (0.2, 0.9)), "learning": SpeedControl(CAR, (0.2, 1.0)),
    "pure-pursuit": SpeedControl(CAR, (0.5, 0.9)), "certain": SpeedControl(CAR, 0.5),
}  # fmt: skip
FRICTION = ("friction_low", "friction_high", "friction_age")
PERIOD = 0.05
DRIVES = max(1, int(os.environ.get("ADAPTRACK_TEST_STEPS", "1000")) // 1000)
PATH = road_through(POINTS).replace(grade=((0.0, 60.0, 120.0, 200.0), (0.0, 0.06, -0.08, 0.02)), bank=((0.0,), (0.03,)))
PLAN = plan_speed(PATH, CAR, Comfort(lateral=2.0), stops=[Stop(110.0, 1.0), Stop(180.0, 0.5)], top_speed=14.0)


class Along(ctypes.Structure):
    _fields_ = (("s", ctypes.c_void_p), ("value", ctypes.c_void_p), ("count", ctypes.c_size_t))


class Speeds(ctypes.Structure):
    _fields_ = (("s", ctypes.c_void_p), ("speed", ctypes.c_void_p), ("count", ctypes.c_size_t), ("grade", Along),
                ("bank", Along), ("stops", ctypes.c_void_p), ("seconds", ctypes.c_void_p),
                ("stop_count", ctypes.c_size_t), ("stays_at_end", ctypes.c_int))  # fmt: skip


class Flaw(ctypes.Structure):
    _fields_ = (("array", ctypes.c_int), ("index", ctypes.c_size_t))


class SpeedAnswer(ctypes.Structure):
    _fields_ = (*Answer._fields_, *((field.name, ctypes.c_int if isinstance(field.default, int) else ctypes.c_double)
                                    for field in fields_of(SPEED_REQUEST)))  # fmt: skip


class CPlan:
    """A plan in memory of this process; `changes` replaces columns of the arrays."""

    def __init__(self, c, path, surplus=0, **changes):
        stops, grade, bank = np.array(PLAN.stops), PATH.grade, PATH.bank
        columns = {"s": PLAN.s, "speed": PLAN.speed, "grade_s": grade.s, "grade": grade.value, "bank_s": bank.s,
                   "bank": bank.value, "stops": stops[:, 0], "seconds": stops[:, 1]} | changes  # fmt: skip
        self.columns = {name: np.ascontiguousarray(column, float) for name, column in columns.items()}
        at, size = ({name: getattr(column, k) for name, column in self.columns.items()} for k in ("ctypes", "size"))
        at = {name: place.data for name, place in at.items()}
        grade, bank = (Along(at[f"{name}_s"], at[name], size[name]) for name in ("grade", "bank"))
        speeds = Speeds(at["s"], at["speed"], size["s"], grade, bank, at["stops"], at["seconds"], size["stops"], 1)
        c.adaptrack_speed_plan_size.restype = ctypes.c_size_t
        self.size = c.adaptrack_speed_plan_size(path.place, ctypes.byref(speeds)) + surplus
        self.raw, self.flaw = np.full(self.size // 8 + 8, 7.0), Flaw(-1, 0)
        self.place = ctypes.c_void_p(self.raw.ctypes.data)
        self.error = c.adaptrack_speed_plan(path.place, ctypes.byref(speeds), self.place, ctypes.c_size_t(self.size),
                                            ctypes.byref(self.flaw))  # fmt: skip


class CSpeedTracker(CTracker):
    """A tracker with speed control."""

    def follow(self, path, plan=None, near=math.nan):
        self._path = path, plan
        return self.c.adaptrack_follow_plan(self.place, path.place, ctypes.c_double(near), plan.place)

    def step(self, sample, driver=math.nan, grade=math.nan):
        answer = SpeedAnswer(math.nan, status=-1)
        row = Sample(*sample, *[math.nan] * (14 - len(sample)), driver, grade)
        error = self.c.adaptrack_step(self.place, ctypes.byref(row), ctypes.byref(answer))
        assert error == exported.OK
        return answer


@pytest.fixture(scope="module", params=CONTROLS)
def library(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp(request.param)
    controller = {
        "informed": lambda: at.MPC(CAR, profile="road"),
        "learning": lambda: at.MPC(CAR, belief="unknown", learning=at.Learning()),
        "pure-pursuit": lambda: at.PurePursuit(CAR),
        "certain": lambda: at.MPC(CAR, profile="road"),
    }[request.param]()
    export_c(controller, folder, road=PATH, plan=PLAN, speed=CONTROLS[request.param])
    exported_library = Exported(folder, controller, "-O0" if request.param == "pure-pursuit" else "-Og")
    exported_library.control = CONTROLS[request.param]
    return exported_library


def start_tracker(library):
    tracker, path = CSpeedTracker(library), CPath(library.c, POINTS)
    plan = CPlan(library.c, path)
    assert (tracker.error, path.error, plan.error, plan.flaw.array) == (exported.OK, exported.OK, exported.OK, 0)
    assert (plan.raw[plan.size // 8 :] == 7.0).all()
    assert tracker.follow(path, plan) == exported.OK
    return tracker


def drive(tracker, twin, calls, seed=1, slippery=math.inf):
    """Drive a car by the commands of C; the number of answers that differ from Python's, states, stops, limits, and
    the intervals of friction.

    slippery: m, along the path, from where on the road has a third of its friction for 40 m.
    """
    rng, x, y, yaw, v, station = np.random.default_rng(seed), 0.0, 0.0, 0.0, 5.0, 0.0
    differences, states, stands, limits, intervals, turn = 0, set(), [], set(), set(), 0.0
    for k in range(calls):
        is_lost = 30 < k % 100 < 33 or rng.random() < 0.05 or 700 < k < 730
        pose = (math.nan,) * 3 if is_lost else (x, y, yaw)
        speed = math.nan if rng.random() < 0.05 else v + 0.02 * rng.normal()
        driver, late = 400 <= k < 430, rng.random() < 0.05
        sample = [PERIOD * k, PERIOD * k + (0.04 if late else 0.0), *pose, speed, turn]
        grade = float(PATH.along("grade", station)) + 0.02 * rng.normal() if k % 200 < 120 else math.nan
        answer = tracker.step(sample, float(driver), grade)
        row = [answer.command, float(answer.status), answer.offset, answer.heading_error, answer.station]
        row += [float(getattr(answer, name)) for name in SPEED_REQUEST._fields]
        differences += any(
            struct.pack("d", a) != struct.pack("d", b) and (a == a or b == b)
            for a, b in zip(row, twin(sample, driver, grade), strict=True)
        )
        station = answer.station if math.isfinite(answer.station) else station
        states.add(list(SpeedState)[answer.speed_state])
        limits.add(list(SpeedLimit)[answer.limited_by])
        intervals.add(tuple(getattr(answer, name) for name in FRICTION))
        if answer.speed_state == list(SpeedState).index(SpeedState.STOPPED):
            stands.append(station)
        grip = GRAVITY * (0.3 if slippery < station < slippery + 40.0 else 0.9)
        push = min(max(answer.force / CAR.mass, -grip), grip) - GRAVITY * float(PATH.along("grade", station))
        v = max(v + PERIOD * (push - answer.hold / CAR.mass), 0.0)
        turn = v * math.tan(answer.command) / CAR.wheelbase
        x, y, yaw = x + PERIOD * v * math.cos(yaw), y + PERIOD * v * math.sin(yaw), yaw + PERIOD * turn
    return differences, states, stands, limits, intervals


def python_twin(library):
    tracker = Tracker(copy.deepcopy(library.controller), PATH, plan=PLAN, speed=library.control)

    def call(sample, driver, grade):
        t, call_time, *motion = sample
        answer = tracker.step(t, *motion, now=call_time, driver=driver, grade=grade)
        command = answer.longitudinal
        friction = (getattr(command, name) for name in FRICTION)
        return [answer.command, float(list(Status).index(answer.status)), answer.offset, answer.heading_error,
                answer.station, *command[:5], float(list(SpeedState).index(command.state)),
                float(list(SpeedLimit).index(command.limited_by)), *friction]  # fmt: skip

    return call


def test_the_requests_are_those_of_python_on_a_drive_with_stops_slopes_a_driver_and_lost_samples(library, caplog):
    for seed in range(DRIVES - 1, -1, -1):  # the last one: on a dry road
        tracker = start_tracker(library)
        slippery = 20.0 * seed if seed > 0 else math.inf
        results = drive(tracker, python_twin(library), 1000, seed + 1, slippery)
        differences, states, stands, limits, intervals = results
        assert differences == 0
        assert tracker.untouched
        is_certain = library.control is CONTROLS["certain"] or library.controller.belief is None
        assert len(intervals) == 1 if is_certain else len(intervals) > 50
    assert {SpeedState.DRIVING, SpeedState.STOPPING, SpeedState.STOPPED} <= states
    assert {SpeedLimit.DRIVER, SpeedLimit.STOP} <= limits
    assert min(abs(s - 110.0) for s in stands) < 1.5  # a twentieth of its samples is lost, and a friction of 0.2 brakes


def test_a_restored_speed_control_goes_on_as_the_saved_one(library):
    first, other = start_tracker(library), start_tracker(library)

    def call(tracker, k):
        foot = PATH.at(0.4 * k)
        return bytes(
            tracker.step([PERIOD * k, PERIOD * k, float(foot.x), float(foot.y), float(foot.heading), 8.0, 0.0])
        )

    for k in range(100):
        call(first, k)
    assert other.restore(first.save()) == exported.OK
    assert [call(first, k) for k in range(100, 160)] == [call(other, k) for k in range(100, 160)]
    assert first.load(first.constants) == exported.OK
    assert [call(first, k) for k in range(160, 220)] == [call(other, k) for k in range(160, 220)]


def changed(column, index, value):
    values = np.array(column, float)
    values[index] = value
    return values


@pytest.mark.parametrize(("array", "index", "changes"), [
    (SPEED, 5, {"speed": changed(PLAN.speed, 5, math.nan)}),
    (SPEED, 5, {"speed": changed(PLAN.speed, 5, -1.0)}),
    (SPEED, 5, {"speed": changed(PLAN.speed, 5, 0.0)}),
    (SPEED, 7, {"s": changed(PLAN.s, 7, 0.0)}),
    (SPEED, 1, {"s": [0.0, 50.0], "speed": [5.0, 5.0]}),
    (GRADE, 2, {"grade": changed(PATH.grade.value, 2, 0.41)}),
    (GRADE, 1, {"grade_s": changed(PATH.grade.s, 1, 0.0)}),
    (BANK, 0, {"bank": [math.inf]}),
    (STOP, 1, {"stops": [110.0, 110.0]}),
    (STOP, 1, {"stops": [110.0, 1e6]}),
    (STOP, 0, {"seconds": [math.nan, 1.0]}),
])  # fmt: skip
def test_what_makes_no_plan_is_refused_by_its_array_and_index(array, index, changes, library):
    plan = CPlan(library.c, CPath(library.c, POINTS), **changes)
    assert (plan.error, plan.flaw.array, plan.flaw.index) == (BAD_PLAN, array, index)


def test_a_plan_of_a_different_path_or_faster_than_the_export_allows_is_refused(library):
    tracker, path, other = CSpeedTracker(library), CPath(library.c, POINTS), CPath(library.c, POINTS + 1.0)
    assert tracker.follow(path, CPlan(library.c, other)) == BAD_PLAN
    assert tracker.follow(path, CPlan(library.c, path, speed=np.full(PLAN.s.size, 60.0))) == BAD_PLAN
    assert CPlan(library.c, path, surplus=-8).error == exported.TOO_SMALL
    assert tracker.follow(path, CPlan(library.c, path)) == exported.OK


def test_the_recorded_drive_of_the_folder_does_not_differ(library):
    assert " steps, 0 differ" in library.make("check", "build/times")


def test_cpp_drives_with_a_plan(library, tmp_path):
    text = (
        '#include "adaptrack.hpp"\n'
        "static adaptrack::Tracker tracker;\nstatic adaptrack::Path<20000> path;\nstatic adaptrack::Plan<4000> plan;\n"
        "int main() {\n    double points[40];\n    const double s[] = {0.0, 95.0}, speed[] = {5.0, 5.0};\n"
        "    for (int i = 0; i < 20; i++) { points[2 * i] = 5.0 * i; points[2 * i + 1] = 0.0; }\n"
        "    adaptrack::Speeds speeds{}; speeds.s = s; speeds.speed = speed; speeds.count = 2;\n"
        "    adaptrack::Sample sample; adaptrack::Answer answer{};\n"
        "    sample.t = 0.0; sample.x = 1.0; sample.y = 0.2; sample.yaw = 0.0; sample.speed = 10.0;\n"
        "    if (tracker.ready() || path.through(points, 20) || plan.along(path, speeds))\n"
        "        return 1;\n    if (tracker.follow(path, plan))\n"
        "        return 1;\n    if (tracker.step(sample, answer)) return 2;\n"
        "    return answer.force < 0.0 && answer.limited_by != ADAPTRACK_LIMIT_FAULT ? 0 : 3;\n}\n"
    )
    exported.run_cpp(library, text, tmp_path)


def test_the_header_holds_the_action_of_each_status(library):
    header = (library.folder / "include" / "adaptrack.h").read_text()
    for status, actions in SPEED_ACTIONS.items():
        assert any(line.split() == " ".join([status, *actions]).split() for line in header.splitlines())
