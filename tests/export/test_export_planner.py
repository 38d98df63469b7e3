"""An exported tracker follows a planner as it does in Python, to the bit: replans, silence, clocks, refusals."""

import copy
import ctypes
import math
import re
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
import exported
from adaptrack.control.following import DRIVERS, VERDICTS, WHO_DRIVES, DrivenBy, Verdict
from adaptrack.core.kernel import INTERPRETED, fields_of
from adaptrack.core.planned.records import POINT
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.core.tracker.signals import TRACKED
from adaptrack.export.c_library import MEMBER_NAMES, export_c
from exported import CPath, CTracker, Exported, Sample
from planner_drive import (
    CAR,
    CONTROLS,
    FOLLOWING,
    PATH,
    PATH_POINTS,
    PERIOD,
    SPEED,
    braking,
    cut,
    differs,
    drive,
    python_row,
)

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="what is exported is compiled")]
BAD_TRAJECTORY, BAD_FALLBACK = 15, 16


class CTrajectory(ctypes.Structure):
    """A trajectory as C takes it: rows of `POINT`."""

    _fields_ = (("points", ctypes.c_void_p), ("count", ctypes.c_size_t), ("stamp", ctypes.c_double),
                ("now", ctypes.c_double), ("is_urgent", ctypes.c_int))  # fmt: skip

    def __init__(self, rows, stamp=0.0, time=math.nan, urgent=False):
        self.rows = np.ascontiguousarray(rows, float)
        super().__init__(self.rows.ctypes.data, len(rows), stamp, time, int(urgent))


def answer_of(has_speed):
    """The structure of an answer: whole numbers behind the others, as in the header."""
    tracked = [(MEMBER_NAMES.get(field.name, field.name), field) for field in fields_of(TRACKED)]
    first, later = tracked[: TRACKED.first_top_speed], tracked[TRACKED.first_top_speed :]
    first.sort(key=lambda row: isinstance(row[1].default, int))
    rows = [*first, *later, *((field.name, field) for field in fields_of(SPEED_REQUEST) if has_speed)]
    kinds = {"suspect": ctypes.c_uint64}
    fields = [
        (name, kinds.get(name, ctypes.c_int if isinstance(field.default, int) else ctypes.c_double))
        for name, field in rows
    ]
    target = [] if has_speed else [("target_speed", ctypes.c_double)]
    return type("Answer", (ctypes.Structure,), {"_fields_": (*fields, *target)})


class CPlannerTracker(CTracker):
    """A tracker in C with memory for trajectories, which nothing else may write to."""

    def __init__(self, library):
        super().__init__(library)
        config = (library.folder / "include" / "adaptrack_config.h").read_text()
        self.planner_size = int(re.search(r"ADAPTRACK_PLANNER_SIZE (\d+)", config)[1])
        self.memory = np.full(self.planner_size // 8 + 2 * self.MARGIN, 0xA5A5A5A5A5A5A5A5, np.uint64)
        self.has_speed = "ADAPTRACK_SPEED_CONTROL" in config
        self.Answer = answer_of(self.has_speed)

    def give_memory(self, size=None):
        place = ctypes.c_void_p(self.memory[self.MARGIN :].ctypes.data)
        return self.c.adaptrack_planner(self.place, place, ctypes.c_size_t(size or self.planner_size))

    def follow_trajectory(self, trajectory, fallback=None):
        """Error, verdict and the number of the impossible point."""
        verdict, flaw = ctypes.c_int(-1), ctypes.c_size_t(99)
        spare = None if fallback is None else ctypes.byref(fallback)
        error = self.c.adaptrack_follow_trajectory(
            self.place, ctypes.byref(trajectory), spare, ctypes.byref(verdict), ctypes.byref(flaw)
        )
        return error, verdict.value, flaw.value

    def step(self, *sample):
        answer = self.Answer(math.nan)
        row = Sample(*sample, *[math.nan] * (len(Sample._fields_) - len(sample)))
        assert self.c.adaptrack_step(self.place, ctypes.byref(row), ctypes.byref(answer)) == exported.OK
        return answer

    @property
    def untouched(self):
        margins = self.memory[: self.MARGIN], self.memory[-self.MARGIN :]
        return super().untouched and all((margin == 0xA5A5A5A5A5A5A5A5).all() for margin in margins)


@pytest.fixture(scope="module", params=CONTROLS)
def library(request, tmp_path_factory):
    folder, controller = tmp_path_factory.mktemp(request.param), at.MPC(CAR, profile="road")
    export_c(controller, folder, road="country", speed=CONTROLS[request.param], following=FOLLOWING)
    exported_library = Exported(folder, controller)
    exported_library.control = CONTROLS[request.param]
    return exported_library


def start_tracker(library):
    tracker = CPlannerTracker(library)
    assert (tracker.error, tracker.give_memory()) == (exported.OK, exported.OK)
    return tracker


def python_tracker(library):
    return at.Tracker(copy.deepcopy(library.controller), speed=library.control, following=FOLLOWING)


def as_c(trajectory, time=math.nan):
    return CTrajectory(trajectory.points, trajectory.stamp, time, trajectory.urgent)


def drive_by_c(library, calls):
    """Differences from Python, verdicts and drivers of `drive`."""
    tracker = start_tracker(library)

    def call(time, trajectory, fallback, pose, speed, turn):
        verdict = None
        if trajectory is not None:
            error, verdict, _ = tracker.follow_trajectory(
                as_c(trajectory, time), None if fallback is None else as_c(fallback)
            )
            assert error == exported.OK
        return tracker.step(time, time, *pose, speed, turn), verdict

    outcome = drive(call, python_tracker(library), calls)
    assert tracker.untouched
    return outcome


def test_a_replanned_drive_is_that_of_python_to_the_bit(library, caplog):
    differences, verdicts, drivers = drive_by_c(library, 520)
    assert differences == []
    assert set(verdicts) == set(Verdict) - {Verdict.UNFIT}
    assert set(drivers) == set(DrivenBy) - {DrivenBy.NOBODY}


def test_a_path_in_between_ends_the_trajectory_and_its_clock(library):
    if library.control is not None:
        pytest.skip("its path needs a plan")
    tracker, twin = start_tracker(library), python_tracker(library)
    path = CPath(library.c, PATH_POINTS)
    assert path.error == exported.OK

    def compare(first, count):
        for k in range(first, first + count):
            place = PATH.at(SPEED * PERIOD * k)
            sample = (PERIOD * k, float(place.x), float(place.y) + 0.1, float(place.heading), SPEED, 0.0)
            row = python_row(twin.step(*sample))
            assert differs(tracker.step(sample[0], sample[0], *sample[1:]), row) == []
        return DRIVERS[int(row["driven_by"])]

    def send(k):
        trajectory = cut(SPEED * PERIOD * k, PERIOD * k, stamp=1000.0 + PERIOD * k)
        verdict = twin.follow(trajectory, now=PERIOD * k)
        assert tracker.follow_trajectory(as_c(trajectory, PERIOD * k))[:2] == (exported.OK, VERDICTS.index(verdict))
        return verdict

    assert [send(0), send(1), send(2)] == [Verdict.EARLY, Verdict.EARLY, Verdict.TAKEN]
    assert compare(3, 5) is DrivenBy.PLANNER
    twin.follow(at.road_through(PATH_POINTS))
    assert tracker.follow(path) == exported.OK
    assert compare(8, 20) is DrivenBy.NOBODY
    assert [send(28), send(29), send(30)] == [Verdict.EARLY, Verdict.EARLY, Verdict.TAKEN]
    assert compare(31, 5) is DrivenBy.PLANNER


# -- errors, states and the header ------------------------------------------------------------------------------------
def with_entry(trajectory, row, column, value):
    rows = trajectory.points.copy()
    rows[row, column] = value
    return CTrajectory(rows, trajectory.stamp)


def test_an_impossible_trajectory_is_refused_by_its_point_and_the_car_goes_on_as_before(library):
    tracker, twin, first = start_tracker(library), start_tracker(library), cut(0.0, 0.0)
    for follower in (tracker, twin):
        assert follower.follow_trajectory(as_c(first, 0.0))[:2] == (exported.OK, 0)
    refused = [
        (with_entry(cut(1.0, 0.1), 7, POINT.t, 0.0), (BAD_TRAJECTORY, 7)),
        (with_entry(cut(1.0, 0.1), 5, POINT.x, math.inf), (BAD_TRAJECTORY, 5)),
        (with_entry(cut(1.0, 0.1), 9, POINT.y, 80.0), (BAD_TRAJECTORY, 9)),
        (CTrajectory(np.zeros((257, len(POINT)))), (exported.TOO_SMALL, 99)),
    ]
    for impossible, expected in refused:
        impossible.now = 0.1
        error, _, flaw = tracker.follow_trajectory(impossible)
        assert (error, flaw) == expected
    fallbacks = [
        (as_c(cut(1.0, 0.1)), (BAD_FALLBACK, 39)), (CTrajectory(np.zeros((0, len(POINT)))), (BAD_FALLBACK, 0)),
        (with_entry(cut(1.0, 0.1, speeds=braking(SPEED)), 4, POINT.t, math.nan), (BAD_FALLBACK, 4)),
    ]  # fmt: skip
    for impossible, expected in fallbacks:
        error, _, flaw = tracker.follow_trajectory(as_c(cut(1.0, 0.1), 0.1), impossible)
        assert (error, flaw) == expected
    for k in range(40):
        sample = PERIOD * k, PERIOD * k, SPEED * PERIOD * k, 0.1, 0.0, SPEED, 0.0
        assert bytes(tracker.step(*sample)) == bytes(twin.step(*sample))
    assert tracker.untouched


def test_a_planner_needs_its_memory_and_a_time(library):
    tracker = CPlannerTracker(library)
    trajectory = as_c(cut(0.0, 0.0))
    assert tracker.follow_trajectory(trajectory)[0] == exported.OUT_OF_ORDER
    assert tracker.give_memory(tracker.planner_size // 2) == exported.TOO_SMALL
    assert tracker.give_memory() == exported.OK
    assert tracker.follow_trajectory(trajectory)[0] == exported.OUT_OF_ORDER  # neither `time` nor a call
    trajectory.now = 0.0
    assert tracker.follow_trajectory(trajectory)[:2] == (exported.OK, 0)
    assert tracker.give_memory() == exported.OUT_OF_ORDER
    tracker.step(0.0, 0.0, 0.0, 0.0, 0.0, SPEED, 0.0)
    tracker.memory[tracker.MARGIN] = 0
    row = Sample(0.05, *[math.nan] * (len(Sample._fields_) - 1))
    answer = tracker.Answer()
    assert library.c.adaptrack_step(tracker.place, ctypes.byref(row), ctypes.byref(answer)) == exported.BAD_PATH


def test_a_restored_tracker_on_the_same_trajectory_goes_on_as_the_saved_one(library):
    first, other = start_tracker(library), start_tracker(library)

    def call(tracker, k):
        if k % 4 == 0 and k >= 100:
            assert tracker.follow_trajectory(as_c(cut(0.5 * k, PERIOD * k), PERIOD * k))[0] == exported.OK
        place = PATH.at(0.5 * k)
        pose = float(place.x), float(place.y) + 0.1, float(place.heading)
        return bytes(tracker.step(PERIOD * k, PERIOD * k, *pose, SPEED, 0.0))

    long = cut(0.0, 0.0, speeds=np.full(120, SPEED))
    assert first.follow_trajectory(as_c(long, 0.0))[0] == exported.OK
    for k in range(8):
        call(first, k)
    state = first.save()
    assert other.restore(state) == exported.OTHER_PATH
    assert other.follow_trajectory(as_c(cut(0.0, 0.0), 0.0))[0] == exported.OK
    assert other.restore(state) == exported.OTHER_PATH
    assert other.init(other.constants) == other.give_memory() == exported.OK
    assert other.follow_trajectory(as_c(long, 0.0))[0] == exported.OK
    assert other.restore(state) == exported.OK
    assert [call(first, k) for k in range(8, 10)] == [call(other, k) for k in range(8, 10)]
    assert [call(first, k) for k in range(100, 140)] == [call(other, k) for k in range(100, 140)]


def test_header_and_docs_have_the_table_of_who_drives_and_the_library_passes_its_own_check(library):
    header = (library.folder / "include" / "adaptrack.h").read_text().splitlines()
    page = (Path(__file__).parents[2] / "docs" / "planner.md").read_text().splitlines()
    for row in WHO_DRIVES:
        assert any(line.split() == " ".join(row).split() for line in header)
        assert f"| {' | '.join(row)} |" in page
    assert " steps, 0 differ" in library.make("check", "build/times")


def test_cpp_follows_a_trajectory(library, tmp_path):
    text = (
        '#include "adaptrack.hpp"\n'
        "static adaptrack::Tracker tracker;\nstatic adaptrack::Planner planner;\n"
        "int main() {\n    adaptrack::Point points[40];\n"
        "    for (int i = 0; i < 40; i++) { points[i].t = 0.1 * i; points[i].x = 1.0 * i; points[i].y = 0.0; }\n"
        "    adaptrack::Trajectory trajectory{points, 40, 0.0, 0.0, 0};\n"
        "    adaptrack::Verdict verdict; adaptrack::Sample sample; adaptrack::Answer answer{};\n"
        "    sample.t = 0.0; sample.x = 0.0; sample.y = 0.2; sample.yaw = 0.0; sample.speed = 10.0;\n"
        "    if (tracker.ready() || tracker.give(planner)) return 1;\n"
        "    if (tracker.follow(trajectory, verdict) || verdict != ADAPTRACK_VERDICT_TAKEN) return 2;\n"
        "    if (tracker.step(sample, answer)) return 3;\n"
        "    return answer.driven_by == ADAPTRACK_DRIVEN_BY_PLANNER && answer.command < 0.0 ? 0 : 4;\n}\n"
    )
    exported.run_cpp(library, text, tmp_path)
