"""The FMU of a controller follows a planner as `Tracker` does, to the bit, in both versions of the interface."""

import copy
import math
import sys
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest

import adaptrack as at
from adaptrack import cli
from adaptrack.control.following import DRIVERS, VERDICTS, DrivenBy, Verdict
from adaptrack.core.planned.records import POINT
from adaptrack.core.speed.speed_control import SPEED_REQUEST
from adaptrack.core.tracker.followed import BAD_FALLBACK, BAD_TRAJECTORY, FLAW
from adaptrack.export.fmu import write_fmu
from adaptrack.export.units import controller_unit
from adaptrack.road.planned_trajectory import PlannedTrajectory
from fmus import Instance, needed
from planner_drive import CAR, CONTROLS, FOLLOWING, PATH, PERIOD, SPEED, braking, cut, differs, drive, python_row

pytestmark = [pytest.mark.compiled, needed]
POINTS = 64
CONTROLLER = at.MPC(CAR, profile="road")
ANSWERS = ("command", "status", "offset", "heading_error", "station", "late", "driven_by")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fmus")


class Follower(Instance):
    """An instance of a controller that follows trajectories."""

    def __init__(self, folder, control="steering", version="3.0", name="one", path=None, plan=None):
        file = folder / f"{control}-{version[0]}-{path is not None}.fmu"
        if not file.exists():
            at.export_fmu(
                copy.deepcopy(CONTROLLER), file, None if path is None else at.RoadDrive(path, plan), version=version,
                driver=CONTROLS[control], following=FOLLOWING, trajectory_points=POINTS,
            )  # fmt: skip
        self.number, self.answers = 0, (*ANSWERS, *(SPEED_REQUEST._fields if control == "speed" else ["target_speed"]))
        super().__init__(file, folder, name)

    def set_points(self, name, rows):
        """Set the points of a trajectory or a fallback; behind them the arrays hold numbers that must not count."""
        table = np.full((POINTS, len(POINT)), 7.0)
        table[: len(rows)] = rows[:POINTS]
        for column, numbers in zip(POINT._fields, table.T.tolist(), strict=True):
            self.set_array(f"{name}_{column}", numbers)
        self.set(**{f"{name}_count": len(rows)})

    def send(self, trajectory, fallback=None, rows=None, fallback_rows=None):
        """Let the inputs be a new trajectory."""
        self.number += 1
        self.set_points("trajectory", trajectory.points if rows is None else rows)
        spare = np.zeros((0, len(POINT))) if fallback is None else fallback.points
        self.set_points("fallback", spare if fallback_rows is None else fallback_rows)
        self.set(trajectory_number=self.number, trajectory_stamp=trajectory.stamp, trajectory_urgent=trajectory.urgent)

    def call(self, time, trajectory, fallback, pose, speed, turn):
        if trajectory is not None:
            self.send(trajectory, fallback)
        self.step(**dict(zip(("x", "y", "yaw"), pose, strict=True)), speed=speed, yaw_rate=turn)
        answer = SimpleNamespace(**dict(zip(self.answers, self.get(*self.answers), strict=True)))
        return answer, self.get("verdict")

    def drive_on(self, count):
        """Answers of some steps along the path at its speed."""
        answers = []
        for _ in range(count):
            time = self.steps * PERIOD
            place = PATH.at(SPEED * time)
            pose = float(place.x), float(place.y) + 0.1, float(place.heading)
            answer, _ = self.call(time, None, None, pose, SPEED, 0.0)
            answers.append([*vars(answer).values(), self.get("verdict")])
        return np.array(answers).tobytes()


def tracker(control, **path):
    return at.Tracker(copy.deepcopy(CONTROLLER), speed=CONTROLS[control], following=FOLLOWING, **path)


# -- drives -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("control", "version"), [("steering", "3.0"), ("speed", "3.0"), ("speed", "2.0")])
def test_a_replanned_drive_is_that_of_python_to_the_bit(control, version, folder, caplog):
    differences, verdicts, drivers = drive(Follower(folder, control, version).call, tracker(control), 520)
    assert differences == []
    assert set(verdicts) == set(Verdict) - {Verdict.UNFIT}
    assert set(drivers) == set(DrivenBy) - {DrivenBy.NOBODY}


@pytest.mark.parametrize("control", CONTROLS)
def test_the_path_of_the_export_counts_until_the_first_trajectory(control, folder):
    plan = at.plan_speed(PATH, CAR, comfort=FOLLOWING.comfort)
    follower, twin = Follower(folder, control, path=PATH, plan=plan), tracker(control, path=PATH, plan=plan)
    drivers = []
    for k in range(60):
        time, place = PERIOD * k, PATH.at(SPEED * PERIOD * k)
        trajectory = cut(SPEED * time, time) if k >= 20 and k % 2 == 0 else None
        pose = float(place.x), float(place.y) + 0.1, float(place.heading)
        answer, verdict = follower.call(time, trajectory, None, pose, SPEED, 0.0)
        if trajectory is not None:
            assert twin.follow(trajectory, now=time) is VERDICTS[verdict]
        expected = twin.step(time, *pose, SPEED, 0.0, now=time)
        row = python_row(expected)
        if expected.driven_by is DrivenBy.NOBODY and control == "steering":
            row["target_speed"] = follower.get("planned_speed_ahead")
        assert differs(answer, row) == []
        drivers.append(DRIVERS[answer.driven_by])
    assert drivers == [DrivenBy.NOBODY] * 20 + [DrivenBy.PLANNER] * 40


def test_both_descriptions_are_valid(folder):
    validation = pytest.importorskip("fmpy.validation", reason="FMPy is not installed")
    for version in ("2.0", "3.0"):
        Follower(folder, "speed", version).free()
        assert validation.validate_fmu(str(folder / f"speed-{version[0]}-False.fmu")) == []


def test_trajectories_are_values_behind_those_of_a_controller_without(folder):
    plain, following = (controller_unit(CONTROLLER, PATH, following=settings) for settings in (None, FOLLOWING))
    assert following.values[: len(plain.values)] == plain.values
    assert {"trajectory_x[1]", "fallback_yaw[100]", "verdict"} <= {value.name for value in following.values}
    description = zipfile.ZipFile(write_fmu(plain, folder / "plain.fmu")).read("modelDescription.xml")
    assert b"trajectory" not in description
    assert b"logStatusWarning" not in description


# -- inputs -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_an_array_is_set_as_a_whole_and_by_no_other_length(version, folder):
    fmpy = pytest.importorskip("fmpy", reason="FMPy is not installed")
    follower = Follower(folder, version=version)
    follower.set_array("fallback_t", [1.0] * POINTS)
    follower.set_array("trajectory_curvature", np.arange(POINTS, dtype=float).tolist())
    assert follower.get_array("trajectory_curvature", POINTS) == list(range(POINTS))
    assert follower.get_array("fallback_t", POINTS) == [1.0] * POINTS
    for length in (1, POINTS - 1, POINTS + 1) if version == "3.0" else ():
        with pytest.raises(fmpy.fmi1.FMICallException):
            follower.set_array("trajectory_curvature", [3.0] * length)
        assert follower.get_array("trajectory_curvature", POINTS) == list(range(POINTS))


def test_a_change_of_number_or_stamp_hands_a_trajectory_over_and_nothing_else_does(folder):
    follower = Follower(folder)
    follower.send(cut(0.0, 0.0))
    follower.set(trajectory_number=0)
    follower.drive_on(1)
    assert follower.get("verdict", "driven_by") == [-1, 0]
    follower.set(trajectory_number=5)
    follower.drive_on(1)
    assert follower.get("verdict", "driven_by") == [VERDICTS.index(Verdict.TAKEN), 1]
    follower.set(trajectory_stamp=0.01)
    follower.drive_on(1)
    assert follower.get("verdict") == VERDICTS.index(Verdict.SAME)
    follower.set_points("trajectory", np.zeros((0, len(POINT))))
    follower.drive_on(1)
    assert follower.get("verdict") == VERDICTS.index(Verdict.SAME)
    follower.set(trajectory_number=4)
    follower.drive_on(1)
    assert follower.get("verdict") == VERDICTS.index(Verdict.SILENT)


@pytest.mark.parametrize("count", [-1, POINTS + 1])
def test_a_count_beyond_the_arrays_is_an_error_that_changes_nothing(count, folder, capfd):
    follower = Follower(folder)
    follower.send(cut(0.0, 0.0))
    follower.drive_on(2)
    before = follower.saved()
    follower.set(trajectory_count=count)
    with pytest.raises(Exception, match="failed"):
        follower.step()
    assert f"is {count}: it must be finite and from 0 to {POINTS}" in "".join(capfd.readouterr())
    follower.set(trajectory_count=40)
    assert follower.saved() == before


# -- refusals and states ----------------------------------------------------------------------------------------------
def rows_with(trajectory, row, column, value):
    rows = trajectory.points.copy()
    rows[row, column] = value
    return rows


ENDLESS = PlannedTrajectory([0.0, 50.0, 100.0], [0.0, 1000.0, 2000.0], [0.0, 0.0, 0.0])
SLOW, RESTING = cut(1.0, 0.1), cut(1.0, 0.1, speeds=braking(SPEED))
REFUSALS = {
    "falling time": ({"rows": rows_with(SLOW, 7, POINT.t, 0.0)}, BAD_TRAJECTORY, FLAW.falling_time, 8),
    "number": ({"rows": rows_with(SLOW, 5, POINT.x, math.inf)}, BAD_TRAJECTORY, FLAW.bad_number, 6),
    "jump": ({"rows": rows_with(SLOW, 9, POINT.y, 80.0)}, BAD_TRAJECTORY, FLAW.place_jump, 10),
    "yaw": ({"rows": rows_with(SLOW, slice(None), POINT.yaw, 1.0)}, BAD_TRAJECTORY, FLAW.wrong_yaw, 1),
    "speed": ({"rows": rows_with(SLOW, slice(None), POINT.speed, 20.0)}, BAD_TRAJECTORY, FLAW.wrong_speed, 1),
    "length": ({"rows": ENDLESS.points}, BAD_TRAJECTORY, FLAW.too_long, 3),
    "moving fallback": ({"fallback": SLOW}, BAD_FALLBACK, FLAW.moves_at_end, 40),
    "fallback": ({"fallback_rows": rows_with(RESTING, 4, POINT.t, math.nan)}, BAD_FALLBACK, FLAW.bad_number, 5),
}


@pytest.mark.parametrize("version", ["2.0", "3.0"])
@pytest.mark.parametrize("case", REFUSALS)
def test_an_impossible_trajectory_is_a_warning_and_the_car_goes_on_as_before(case, version, folder, capfd):
    inputs, verdict, flaw, point = REFUSALS[case]
    follower, twin = (Follower(folder, "speed", version, name) for name in ("one", "twin"))
    for instance in (follower, twin):
        instance.send(cut(0.0, 0.0))
        instance.drive_on(2)
    follower.send(SLOW, **inputs)
    follower.drive_on(1)
    assert follower.get("verdict", "flaw", "flaw_point") == [verdict, flaw, point]
    log = "".join(capfd.readouterr())
    refused = "fallback" if verdict == BAD_FALLBACK else "trajectory"
    assert f"at t = 0.1 s the {refused} is refused, and the car goes on as before: point {point}: " in log
    assert "warning" in log.lower()
    twin.drive_on(1)
    twin.set(trajectory_number=2)  # the one before
    follower.send(cut(0.0, 0.0))
    for instance in (follower, twin):
        instance.drive_on(1)
    assert follower.drive_on(25) == twin.drive_on(25)
    assert follower.get("flaw") == 0


def test_a_trajectory_that_is_faster_than_the_speed_control_is_refused(folder):
    follower, fast = Follower(folder, "speed"), np.linspace(0.0, 4.0, 20)
    follower.send(PlannedTrajectory(fast, 95.0 * fast, 0.0 * fast))
    follower.drive_on(1)
    assert follower.get("verdict", "flaw", "flaw_point", "driven_by") == [BAD_TRAJECTORY, FLAW.too_fast, 20, 0]


@pytest.mark.parametrize("version", ["2.0", "3.0"])
def test_a_state_holds_trajectory_and_fallback_and_goes_on_in_another_instance_to_the_bit(version, folder):
    first, other = (Follower(folder, "speed", version, name) for name in ("one", "other"))
    first.send(cut(0.0, 0.0), fallback=cut(-0.5, 0.0, speeds=braking(SPEED)))
    first.drive_on(6)
    first.send(cut(SPEED * 0.3, 0.3), fallback=cut(SPEED * 0.3 - 0.5, 0.3, speeds=braking(SPEED)))
    first.drive_on(3)
    other.send(cut(0.0, 0.0, aside=0.3))
    other.drive_on(5)
    other.restore(first.saved())
    other.steps, other.number = first.steps, first.number
    assert first.drive_on(30) == other.drive_on(30)
    assert first.get("driven_by") == DRIVERS.index(DrivenBy.FALLBACK)


def test_the_command_writes_a_controller_that_follows(folder, monkeypatch, capsys):
    options = ["--road", "country", "--planner", "--trajectory-points", "20", "--out", str(folder / "command")]
    monkeypatch.setattr(sys, "argv", ["adaptrack", "export", "fmu", *options])
    assert cli.main() == 0
    assert "follows trajectories" in capsys.readouterr().out
    description = zipfile.ZipFile(folder / "command" / "controller.fmu").read("modelDescription.xml")
    assert description.count(b'<Dimension start="20"') == 2 * len(POINT)


def test_a_controller_needs_a_path_unless_it_follows(folder):
    with pytest.raises(at.InvalidInput, match=r"following=Following\(\)"):
        controller_unit(CONTROLLER)
    with pytest.raises(at.InvalidInput, match="trajectory_points = 1: must be"):
        controller_unit(CONTROLLER, following=FOLLOWING, trajectory_points=1)
