"""Trajectories of planners: the same from arrays, files and messages, and refused in one sentence with the remedy."""

import dataclasses
import math
from types import SimpleNamespace

import numpy as np
import pytest

import adaptrack as at
from adaptrack.base.errors import ConfigError, InvalidInput
from ros_messages import pose

T = np.arange(0.0, 4.0, 0.1)
X, Y = 30.0 * np.sin(T / 10.0), 30.0 - 30.0 * np.cos(T / 10.0)
YAW, SPEED, ACCELERATION = T / 10.0, np.full(T.size, 3.0), np.full(T.size, 0.01)
"""On a circle of 30 m, to the left from the origin, at 3 m/s."""
STATED = {"yaw": YAW, "speed": SPEED, "acceleration": ACCELERATION}
STAMP = 1_700_000_000_250_000_000
"""ns"""


def make(**columns):
    return at.PlannedTrajectory(**({"t": T, "x": X, "y": Y} | columns))


# -- what it holds ----------------------------------------------------------------------------------------------------
def test_a_trajectory_holds_its_columns_and_answers_place_and_speed_at_times():
    trajectory = make(**STATED)
    assert trajectory.points.shape == (40, 7)
    assert trajectory.points[:, :6].T.tolist() == [column.tolist() for column in (T, X, Y, *STATED.values())]
    assert np.isnan(trajectory.points[:, 6]).all()
    assert trajectory.duration == pytest.approx(3.9)
    state = trajectory.at([-1.0, 2.0, 2.05, 9.0])
    assert np.hypot(state.x, state.y - 30.0) == pytest.approx(30.0, abs=1e-3)
    assert np.arctan2(state.x, 30.0 - state.y) == pytest.approx([0.0, 0.2, 0.205, 0.39], abs=1e-4)
    assert state.speed.tolist() == [3.0] * 4
    assert trajectory.at(2.0).x == pytest.approx(X[20])
    assert repr(trajectory) == "<PlannedTrajectory: 40 points, 3.9 s, 11.7 m, 3 to 3 m/s>"


def test_a_trajectory_is_a_copy_that_cannot_be_replaced():
    t = T.copy()
    trajectory = make(t=t)
    t[:] = 0.0
    assert trajectory.t.tolist() == T.tolist()
    with pytest.raises(dataclasses.FrozenInstanceError):
        trajectory.t = t


def test_no_points_are_silence_and_one_place_is_a_stand():
    silence, stand = at.PlannedTrajectory([], [], []), at.PlannedTrajectory([0.0, 0.5], [1.0, 1.0], [2.0, 2.0])
    assert (len(silence.points), silence.duration, repr(silence)) == (0, 0.0, "<PlannedTrajectory: no points>")
    assert np.isnan(silence.at([0.0, 1.0]).x).all()
    assert np.array(stand.at([0.0, 99.0])).tolist() == [[1.0, 1.0], [2.0, 2.0], [0.0, 0.0]]
    assert len(stand.nodes) == 1


def test_a_trajectory_that_goes_on_backwards_says_so():
    trajectory = at.PlannedTrajectory(T, 4.0 - (T - 2.0) ** 2, 0.0 * T)
    assert trajectory.reverse_ahead
    assert repr(trajectory).endswith("4 to 0 m/s, reverse ahead>")
    assert trajectory.at([1.0, 3.9]).x == pytest.approx([3.0, 4.0], abs=0.05)
    assert not make().reverse_ahead


# -- the same from everywhere -----------------------------------------------------------------------------------------
def stamp_of(nanoseconds):
    return SimpleNamespace(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def header_of(nanoseconds):
    return SimpleNamespace(stamp=stamp_of(nanoseconds), frame_id="map")


def pose_of(k, has_yaw=True):
    message = pose(X[k], Y[k], YAW[k])
    if not has_yaw:
        message.orientation = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    return message


def after_start(k):
    """ns"""
    return round(1e9 * T[k])


def autoware_message(stamp=STAMP):
    """`autoware_planning_msgs/Trajectory`"""
    points = [
        SimpleNamespace(
            time_from_start=stamp_of(after_start(k)), pose=pose_of(k), longitudinal_velocity_mps=3.0,
            lateral_velocity_mps=0.0, acceleration_mps2=0.01, heading_rate_rps=0.0, front_wheel_angle_rad=0.5,
            rear_wheel_angle_rad=0.0,
        )
        for k in range(T.size)
    ]  # fmt: skip
    return SimpleNamespace(header=header_of(stamp), points=points)


def navigation_message(stamp=STAMP, generated=STAMP):
    """`nav_msgs/Trajectory`: a header with the absolute time of each point."""
    twists = {
        name: SimpleNamespace(linear=SimpleNamespace(x=x, y=0.0, z=0.0))
        for name, x in (("velocity", 3.0), ("acceleration", 0.01))
    }
    points = [
        SimpleNamespace(header=header_of(stamp + after_start(k)), pose=pose_of(k), **twists) for k in range(T.size)
    ]
    return SimpleNamespace(header=header_of(generated), points=points)


def path_message(stamp=STAMP, step=1, has_yaw=True):
    """`nav_msgs/Path`"""
    poses = [
        SimpleNamespace(header=header_of(stamp + step * after_start(k)), pose=pose_of(k, has_yaw))
        for k in range(T.size)
    ]
    return SimpleNamespace(header=header_of(stamp), poses=poses)


@pytest.mark.parametrize(("message", "stated"), [
    (autoware_message(), STATED), (navigation_message(), STATED), (path_message(), {"yaw": YAW}),
    (path_message(has_yaw=False), {}),
])  # fmt: skip
def test_a_message_is_the_trajectory_of_its_arrays(message, stated):
    trajectory, arrays = at.PlannedTrajectory.from_message(message, urgent=True), make(**stated)
    np.testing.assert_allclose(trajectory.points, arrays.points, rtol=1e-12, atol=1e-12)
    assert (trajectory.stamp, trajectory.urgent) == (1e-9 * STAMP, True)


def test_times_of_points_count_from_the_first_one_if_the_message_has_no_stamp():
    trajectory = at.PlannedTrajectory.from_message(navigation_message(generated=0))
    assert (trajectory.stamp, trajectory.t[0]) == (1e-9 * STAMP, 0.0)
    assert at.PlannedTrajectory.from_message(autoware_message(stamp=0)).stamp == 0.0


def test_a_message_without_points_is_silence():
    message = SimpleNamespace(header=header_of(STAMP), points=[])
    assert len(at.PlannedTrajectory.from_message(message).points) == 0


@pytest.mark.parametrize("wrap", [list, lambda states: SimpleNamespace(state_list=states)])
def test_states_of_commonroad_are_the_trajectory_of_their_arrays(wrap):
    names = {"orientation": YAW, "velocity": SPEED, "acceleration": ACCELERATION}
    states = [
        SimpleNamespace(time_step=k, position=np.array([X[k], Y[k]]), **{name: row[k] for name, row in names.items()})
        for k in range(T.size)
    ]
    del states[7].acceleration
    states[8].velocity = None
    trajectory = at.PlannedTrajectory.from_states(wrap(states), 0.1, stamp=5.0)
    expected = make(**STATED).points
    expected[7, 5] = expected[8, 4] = np.nan
    np.testing.assert_allclose(trajectory.points, expected, rtol=1e-12)
    assert trajectory.stamp == 5.0


@pytest.mark.parametrize(("titles", "separator", "mark"), [
    ("t,x,y,yaw,speed,acceleration,curvature", ",", "."),
    ("Time [s];pos_x [m];pos_y (m);Yaw [rad];v [m/s];ax_mps2;kappa [1/m]", ";", ","),
    ("# exported by a planner\n# time_from_start x_m y_m psi_rad vx_mps a kappa_radpm", " ", "."),
])  # fmt: skip
def test_a_file_is_the_trajectory_of_its_columns(tmp_path, titles, separator, mark):
    curvature = np.full(T.size, 1.0 / 30.0)
    rows = np.stack([T, X, Y, *STATED.values(), curvature], axis=-1)
    lines = [separator.join(f"{value!r}" for value in row).replace(".", mark) for row in rows.tolist()]
    file = tmp_path / "plan.csv"
    file.write_text("\n".join([titles, *lines]))
    trajectory = at.PlannedTrajectory.from_csv(file, stamp=3.0)
    assert trajectory.points.tolist() == rows.tolist()
    assert trajectory.stamp == 3.0


def test_an_empty_cell_of_a_file_is_unknown_and_other_columns_are_left_out(tmp_path):
    file = tmp_path / "plan.csv"
    file.write_text("t,x,y,speed,remark\n" + "".join(f"{t},{3 * t},0,{'' if t == 1 else 3},go\n" for t in range(4)))
    assert at.PlannedTrajectory.from_csv(file).points[:, 4].tolist() == pytest.approx([3, np.nan, 3, 3], nan_ok=True)


# -- refusals ---------------------------------------------------------------------------------------------------------
def from_text(folder, text):
    file = folder / "plan.csv"
    file.write_text(text)
    return at.PlannedTrajectory.from_csv(file)


def changed(values, k, value):
    copy = values.copy()
    copy[k] = value
    return copy


@pytest.mark.parametrize(("columns", "words"), [
    ({"y": None}, ["y = None", "must be real numbers"]),
    ({"speed": "fast"}, ["speed = 'fast'", "must be real numbers"]),
    ({"yaw": [0.0]}, ["yaw has shape (1,), t (40,)", "one length"]),
    ({"t": [T]}, ["t has shape (1, 40)"]),
    ({"stamp": math.nan}, ["stamp = nan s", "finite"]),
    ({"x": changed(X, 3, math.inf)}, ["entry 3", "x = inf m", "finite"]),
    ({"t": changed(T, 5, 0.1)}, ["entry 5", "t = 0.1 s", "times that never fall"]),
    ({"x": X + 9.0 * (T > 1.95)}, ["entry 20", "jumps", "at t = 2 s", "correct"]),
    ({"yaw": YAW + 0.4}, ["entry 0", "yaw = 0.4 rad", "15 degrees", "or None"]),
    ({"speed": 3.6 * SPEED}, ["entry 0", "speeds contradict", "m/s, or None"]),
])  # fmt: skip
def test_what_is_no_trajectory_is_refused_with_the_entry_and_the_remedy(columns, words):
    with pytest.raises(InvalidInput) as refused:
        make(**columns)
    sentence = str(refused.value)
    assert sentence.startswith("PlannedTrajectory: ")
    assert [word for word in words if word not in sentence] == []
    assert "\n" not in sentence


@pytest.mark.parametrize(("message", "words"), [
    (SimpleNamespace(data=3.0), "neither points nor poses"),
    (path_message(step=0), "all points have the same time"),
    (navigation_message(stamp=0, generated=STAMP), "finite"),
])  # fmt: skip
def test_a_message_without_times_or_places_is_refused(message, words):
    if words == "finite":
        message.points[4].pose.position.x = math.nan
    with pytest.raises(InvalidInput, match=words):
        at.PlannedTrajectory.from_message(message)


@pytest.mark.parametrize(("text", "words"), [
    ("", ["one column 't' (s)"]),
    ("x,y\n0,0\n", ["one column 't' (s)", "Known: 'x', 'y'"]),
    ("t,time,x,y\n0,0,0,0\n", ["one column 't' (s): there are two"]),
    ("t,x,y,yaw [deg]\n0,0,0,0\n", ["'yaw [deg]': must be in rad"]),
    ("t,x,y\n0,0,0\n1,3,here\n", ["line 3: y = 'here': must be a finite number"]),
    ("t,x,y\n0,0,0\n1,3\n", ["line 3: y = ''"]),
    ("t,x,y,v\n0,0,0,3\n1,3,0,fast\n", ["line 3: speed = 'fast'"]),
    ("t,x,y\n1,0,0\n0,3,0\n", ["plan.csv: PlannedTrajectory: entry 1", "never fall"]),
])  # fmt: skip
def test_a_file_that_is_no_trajectory_is_refused_with_line_and_remedy(tmp_path, text, words):
    with pytest.raises(ConfigError) as refused:
        from_text(tmp_path, text)
    assert [word for word in words if word not in str(refused.value)] == []


def test_a_file_that_is_missing_is_a_storage_error(tmp_path):
    with pytest.raises(at.StorageError):
        at.PlannedTrajectory.from_csv(tmp_path / "none.csv")
