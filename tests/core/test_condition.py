"""The kernel that makes places with times and speeds of planned trajectories: exact cases, symmetries, rests."""

import math

import numpy as np
import pytest

from adaptrack.core.planned import condition as kernel
from adaptrack.core.planned.records import NODE, POINT

pytestmark = pytest.mark.kernels

PLACES = slice(NODE.x, NODE.y + 1)
REAR = -1.4
"""m, from the centre of mass to the rear axle."""


def table(t, x, y, **columns):
    """Rows of `POINT`."""
    rows = np.full((len(t), len(POINT)), np.nan)
    for name, values in {"t": t, "x": x, "y": y, **columns}.items():
        rows[:, getattr(POINT, name)] = values
    return rows


def make_nodes(points, arm=0.0, begins=0.0):
    """Status, entry and nodes, with the row behind them if the car stands."""
    nodes = np.full((2 * len(points) + 2, len(NODE)), np.nan)
    status, entry, count = kernel.condition(points, arm, begins, nodes)
    return status, entry, nodes[: 2 if count == 1 else count]


def nodes_of(*points, arm=0.0, begins=0.0, status=kernel.OK, **columns):
    stated, _, nodes = make_nodes(table(*points, **columns), arm, begins)
    assert stated == status
    return nodes


def on_circle(radius, speed=3.0, duration=4.0, period=0.1):
    """t, x, y, and the yaw of a car whose tracked point moves along it; from the origin to the left."""
    t = np.arange(0.0, duration, period)
    yaw = speed / radius * t
    return (t, radius * np.sin(yaw), radius - radius * np.cos(yaw)), yaw


def along_line(speed, period, noise=0.0, duration=12.0):
    """t, x, y on a straight line at speeds of the time, integrated finely; with noise of the places."""
    times = np.arange(0.0, duration + 1e-9, period / 100.0)
    speeds = np.array([speed(time) for time in times])
    way = np.append(0.0, np.cumsum(0.5 * (speeds[1:] + speeds[:-1]) * period / 100.0))[::100]
    errors = noise * np.random.default_rng(5).standard_normal((2, way.size))
    return times[::100], way + errors[0], errors[1]


def arrival_times(nodes):
    """s, of a car at the speeds of the nodes, the square straight between them."""
    way = np.hypot(*np.diff(nodes[:, PLACES], axis=0).T)
    times = 2.0 * way / (nodes[1:, NODE.speed] + nodes[:-1, NODE.speed])
    return nodes[0, NODE.leave] + np.append(0.0, np.cumsum(times))


# -- speeds and times -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("start", "acceleration"), [(0.0, 2.0), (10.0, 0.0), (12.0, -2.0), (9.0, -1.8)])
@pytest.mark.parametrize("period", [0.05, 0.1, 0.7])
def test_a_constant_acceleration_gives_its_speeds_and_times_to_rounding(start, acceleration, period):
    t = np.append(np.arange(0.0, 4.5, period) + 0.01 * np.sin(np.arange(0.0, 4.5, period)), 5.0)
    nodes = nodes_of(t, start * t + 0.5 * acceleration * t * t, 0.0 * t, begins=100.0)
    times = nodes[:, NODE.arrive] - 100.0
    assert np.abs(nodes[:, NODE.speed] - (start + acceleration * times)).max() < 1e-10
    assert np.abs(arrival_times(nodes) - nodes[:, NODE.arrive]).max() < 1e-8
    is_at_rest = start + 5.0 * acceleration < 0.01
    assert nodes[-1, NODE.leave] == (math.inf if is_at_rest else 105.0)


def test_places_keep_their_times_to_the_bit_and_all_move_with_the_beginning():
    points, yaw = on_circle(20.0)
    for begins in (0.0, 1.7e9):
        nodes = nodes_of(*points, yaw=yaw, arm=REAR, begins=begins)
        assert nodes[:, NODE.arrive].tolist() == (begins + points[0]).tolist()
        assert nodes[:-1, NODE.leave].tolist() == nodes[:-1, NODE.arrive].tolist()


def test_speeds_of_times_are_of_second_order():
    """Half the period: a quarter of the error, of the speeds and of the times at which a car with them arrives."""
    errors = []
    for period in (0.8, 0.4):
        t = np.arange(0.0, 8.01, period)
        nodes = nodes_of(t, 6.0 * t + 2.0 * np.sin(t), 0.0 * t)
        late = np.abs(arrival_times(nodes) - nodes[:, NODE.arrive])[1:-1].max()
        errors.append([np.abs(nodes[:, NODE.speed] - (6.0 + 2.0 * np.cos(nodes[:, NODE.arrive])))[1:-1].max(), late])
    assert np.divide(*errors) == pytest.approx(4.0, rel=0.35)
    assert errors[1][1] < 0.03


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_speeds_do_not_oscillate_with_the_noise_of_places(noise):
    nodes = nodes_of(*along_line(lambda t: 8.0, 0.1, noise))
    assert np.abs(nodes[:, NODE.speed] - 8.0).max() <= 15.0 * noise + 1e-9


def test_a_speed_is_at_most_twice_the_mean_speed_to_either_side():
    """So that the way of a slow step, at the speeds of its ends, takes half of its time at least."""
    nodes = nodes_of(np.arange(7.0), [0.0, 6.0, 12.0, 12.3, 12.6, 18.0, 24.0], np.zeros(7))
    assert nodes[2:5, NODE.speed] == pytest.approx([0.6, 0.3, 0.6])


def test_given_speeds_are_taken_and_unknown_ones_follow_from_the_times():
    t = np.arange(0.0, 5.0, 0.1)
    speed = 10.0 + 0.3 * np.sin(20.0 * t)
    speed[7] = np.nan
    nodes = nodes_of(t, 10.0 * t, 0.0 * t, speed=speed)
    assert nodes[7, NODE.speed] == pytest.approx(10.0)
    assert np.delete(nodes[:, NODE.speed], 7) == pytest.approx(np.delete(speed, 7))


def test_columns_of_zeros_count_as_not_given():
    points, _ = on_circle(15.0)
    empty = np.zeros(len(points[0]))
    unknown = nodes_of(*points, arm=REAR)
    zeros = nodes_of(*points, arm=REAR, yaw=empty, speed=empty, acceleration=empty, curvature=empty)
    assert zeros.tobytes() == unknown.tobytes()


# -- symmetries and the tracked point ---------------------------------------------------------------------------------
@pytest.mark.parametrize("has_yaw", [False, True])
def test_a_mirrored_or_rotated_trajectory_gives_mirrored_or_rotated_nodes(has_yaw):
    t = np.arange(0.0, 6.0, 0.1)
    x, y = 4.0 * t + np.sin(t), 2.0 * np.sin(0.7 * t)
    yaw = np.arctan2(1.4 * np.cos(0.7 * t), 4.0 + np.cos(t))
    nodes = nodes_of(t, x, y, arm=REAR, **({"yaw": yaw} if has_yaw else {}))
    mirrored = nodes_of(t, x, -y, arm=REAR, **({"yaw": -yaw} if has_yaw else {}))
    assert (mirrored * [1.0, -1.0, 1.0, 1.0, 1.0]).tolist() == nodes.tolist()
    cosine, sine = math.cos(2.0), math.sin(2.0)
    rotation = np.array([[cosine, sine], [-sine, cosine]])
    rotated = nodes_of(t, *(rotation.T @ [x, y]), arm=REAR, **({"yaw": yaw + 2.0} if has_yaw else {}))
    assert rotated[:, PLACES] == pytest.approx(nodes[:, PLACES] @ rotation, abs=1e-9)
    assert rotated[:, NODE.arrive :] == pytest.approx(nodes[:, NODE.arrive :], rel=1e-9)


@pytest.mark.parametrize("columns", [(), ("yaw",), ("yaw", "speed"), ("yaw", "speed", "curvature"), ("speed",)])
def test_a_rear_axle_on_a_circle_puts_the_centre_of_mass_on_the_wider_one(columns):
    """sqrt(R^2 + l_r^2): l_r^2 / 2 R wider, 16 cm at 6 m; and faster by as much."""
    points, yaw = on_circle(6.0)
    columns_of = {"yaw": yaw, "speed": 3.0, "curvature": 1.0 / 6.0}
    nodes = nodes_of(*points, arm=REAR, **{name: columns_of[name] for name in columns})
    outer_radius = math.hypot(6.0, REAR)
    assert np.hypot(nodes[:, NODE.x], nodes[:, NODE.y] - 6.0) == pytest.approx(outer_radius, rel=1e-12)
    assert outer_radius - 6.0 == pytest.approx(REAR**2 / 12.0, rel=0.02)
    assert nodes[:, NODE.speed] == pytest.approx(3.0 * outer_radius / 6.0, rel=1e-5)


@pytest.mark.parametrize("has_speed", [False, True])
def test_a_front_axle_on_a_circle_puts_the_centre_of_mass_on_the_narrower_one(has_speed):
    """Of a car with a wheelbase of 2.7 m; its speed is that along the car."""
    rear, front = 6.0, math.hypot(6.0, 2.7)
    points, direction = on_circle(front)
    speed = 3.0 * rear / front
    columns_of = {"yaw": direction - math.atan2(2.7, rear)} | ({"speed": speed} if has_speed else {})
    nodes = nodes_of(*points, arm=2.7 + REAR, **columns_of)
    narrow = math.hypot(rear, REAR)
    assert np.hypot(nodes[:, NODE.x], nodes[:, NODE.y] - front) == pytest.approx(narrow, rel=1e-9)
    assert nodes[:, NODE.speed] == pytest.approx(speed * narrow / rear, rel=1e-3)


# -- places and rests -------------------------------------------------------------------------------------------------
def stop(t):
    """m/s: braked with 1 m/s^2, at rest from 5 to 8 s, and off again."""
    return max(5.0 - t, 0.0) if t < 8.0 else min(t - 8.0, 4.0)


@pytest.mark.parametrize("period", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_stop_is_one_place_with_a_time_at_rest(period, noise):
    nodes = nodes_of(*along_line(stop, period, noise))
    (row,) = np.flatnonzero(nodes[:, NODE.leave] > nodes[:, NODE.arrive])
    place, _, arrive, leave, speed = nodes[row]
    assert (place, speed) == (pytest.approx(12.5, abs=2.5 * noise + 1e-9), 0.0)
    assert (arrive, leave) == (pytest.approx(5.0, abs=30.0 * noise + 1e-9), pytest.approx(8.0, abs=30.0 * noise + 1e-9))
    steps = np.hypot(*np.diff(nodes[:, PLACES], axis=0).T)
    assert steps.min() > kernel.MERGING_DISTANCE


@pytest.mark.parametrize("period", [0.02, 0.1, 0.5])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_hesitation_is_no_stop(period, noise):
    """Down to 0.3 m/s, where points lie as near to each other as at a stop."""
    nodes = nodes_of(*along_line(lambda t: 0.3 + abs(t - 6.0), period, noise))
    assert (nodes[:, NODE.leave] == nodes[:, NODE.arrive]).all()
    assert nodes[:, NODE.speed].min() > 0.25


def test_creeping_is_driven_and_standing_is_a_rest():
    t = np.arange(0.0, 8.0, 0.02)
    creeping, standing = nodes_of(t, 0.1 * t, 0.0 * t), nodes_of(t, 0.02 * np.sin(t), 0.0 * t)
    assert creeping[:, NODE.speed] == pytest.approx(0.1, rel=1e-6)
    assert creeping[-1, [NODE.x, NODE.arrive]].tolist() == [0.1 * t[-1], t[-1]]
    assert standing[0, NODE.arrive :].tolist() == [0.0, math.inf, 0.0]


@pytest.mark.parametrize("gap", [0.0, 0.01, 0.03, -0.04])
def test_a_rest_may_be_stated_by_two_points(gap):
    """As of a planner whose points are sparse, or lie apart by its noise."""
    nodes = nodes_of([0.0, 1.0, 2.0, 4.8, 5.8], [0.0, 5.0, 10.0, 10.0 + gap, 15.0], [0.0] * 5)
    (row,) = np.flatnonzero(nodes[:, NODE.leave] > nodes[:, NODE.arrive])
    assert nodes[row, NODE.arrive :].tolist() == [2.0, 4.8, 0.0]


def test_noise_of_1_cm_hardly_makes_rests_of_creeping():
    """At 0.15 m/s in at most 5 of 100 drives."""
    t, count = np.arange(0.0, 8.0, 0.1), 0
    for seed in range(100):
        errors = 0.01 * np.random.default_rng(seed).standard_normal((2, t.size))
        nodes = nodes_of(t, 0.15 * t + errors[0], errors[1])[:-1]
        count += (nodes[:, NODE.leave] > nodes[:, NODE.arrive]).any()
    assert count <= 5


def test_from_rest_to_rest_there_is_a_faster_node_between():
    nodes = nodes_of([0.0, 1.0, 3.0, 4.0, 8.0], [0.0, 0.0, 4.0, 4.0, 4.0], [0.0] * 5)
    assert nodes.tolist() == [[0.0, 0.0, 0.0, 1.0, 0.0], [2.0, 0.0, 2.0, 2.0, 4.0], [4.0, 0.0, 3.0, math.inf, 0.0]]


@pytest.mark.parametrize("count", [1, 5])
@pytest.mark.parametrize("yaw", [0.5, np.nan])
def test_a_single_place_is_a_stand_with_the_heading_of_the_yaw(count, yaw):
    nodes = nodes_of(0.1 * np.arange(count), [1.0] * count, [2.0] * count, yaw=yaw, begins=7.0)
    assert nodes[0].tolist() == [1.0, 2.0, 7.0, math.inf, 0.0]
    assert nodes[1, PLACES] == pytest.approx([1.0 + math.cos(yaw), 2.0 + math.sin(yaw)], nan_ok=True)


def test_no_points_are_no_nodes():
    assert nodes_of([], [], []).shape == (0, len(NODE))


def test_an_end_in_motion_stays_one():
    t = np.arange(0.0, 3.01, 0.1)
    assert nodes_of(t, 8.0 * t - t * t, 0.0 * t)[-1, NODE.leave :] == pytest.approx([3.0, 2.0])


# -- backwards --------------------------------------------------------------------------------------------------------
CUSP = np.arange(0.0, 6.01, 0.1)
BACK = (CUSP, 9.0 - (CUSP - 3.0) ** 2, 0.0 * CUSP)
"""Forwards to 9 m at 3 s, then back."""


@pytest.mark.parametrize("columns", [{}, {"yaw": 1e-9}, {"speed": 2.0 * (3.0 - CUSP)}])
def test_a_trajectory_ends_with_a_stop_where_the_car_is_to_drive_backwards(columns):
    status, entry, nodes = make_nodes(table(*BACK, **columns))
    assert status == kernel.REVERSE_AHEAD
    assert nodes[-1, NODE.x] == pytest.approx(9.0, abs=kernel.MERGING_DISTANCE)
    assert nodes[-1, NODE.leave :].tolist() == [math.inf, 0.0]
    assert nodes[-1, NODE.arrive] == CUSP[entry]
    forwards = nodes_of(*table(*BACK, **columns)[: entry + 1, :3].T)
    assert nodes[:-2] == pytest.approx(forwards[:-2], abs=1e-9)


@pytest.mark.parametrize("columns", [{"yaw": 1e-9}, {"speed": -3.0}])
def test_a_trajectory_that_begins_backwards_is_a_stand(columns):
    t = np.arange(0.0, 3.0, 0.1)
    status, entry, nodes = make_nodes(table(t, -3.0 * t, 0.0 * t, **columns))
    assert (status, entry) == (kernel.REVERSE_AHEAD, 0)
    assert nodes[0].tolist() == [0.0, 0.0, 0.0, math.inf, 0.0]


def test_a_car_that_trembles_between_two_places_gets_finite_nodes():
    t = np.arange(0.0, 3.0, 0.1)
    nodes = nodes_of(t, 0.0625 * (np.arange(30) % 2), 0.0 * t, speed=0.1, arm=REAR)
    assert np.isfinite(nodes[:, [NODE.x, NODE.y, NODE.arrive, NODE.speed]]).all()


def test_a_hairpin_is_no_cusp():
    points, yaw = on_circle(5.0, duration=6.0)
    assert yaw[-1] > math.pi
    assert len(nodes_of(*points)) == len(yaw)
    sparse, _ = on_circle(5.0, speed=5.0, duration=9.0, period=1.7)  # 97 degrees from step to step
    assert len(nodes_of(*sparse)) == len(sparse[0])


# -- refusals ---------------------------------------------------------------------------------------------------------
T = np.arange(0.0, 3.0, 0.1)
STRAIGHT = (T, 5.0 * T, 0.0 * T)


@pytest.mark.parametrize(("points", "columns", "status", "entry"), [
    ((T, np.where(np.arange(30) == 4, np.nan, 5.0 * T), 0.0 * T), {}, kernel.BAD_NUMBER, 4),
    ((T, 5.0 * T, np.where(np.arange(30) == 6, 2e8, 0.0)), {}, kernel.BAD_NUMBER, 6),
    ((np.where(np.arange(30) == 5, np.inf, T), 5.0 * T, 0.0 * T), {}, kernel.BAD_NUMBER, 5),
    ((np.where(np.arange(30) == 9, 0.75, T), 5.0 * T, 0.0 * T), {}, kernel.FALLING_TIME, 9),
    ((T, 5.0 * T + (T > 1.45), 0.0 * T), {}, kernel.PLACE_JUMP, 15),
    (([0.0, 1.0, 1.0], [0.0, 2.0, 4.0], [0.0] * 3), {}, kernel.PLACE_JUMP, 2),
    ((T, 150.0 * T, 0.0 * T), {}, kernel.PLACE_JUMP, 1),
    (([0.0, 0.0], [0.0, 1.0], [0.0, 0.0]), {}, kernel.PLACE_JUMP, 1),
    (STRAIGHT, {"yaw": math.radians(15.5)}, kernel.WRONG_YAW, 0),
    (STRAIGHT, {"yaw": math.radians(-90.0)}, kernel.WRONG_YAW, 0),
    (STRAIGHT, {"yaw": np.where(T > 1.0, 0.5, 0.01)}, kernel.WRONG_YAW, 10),
    (STRAIGHT, {"speed": 18.0}, kernel.WRONG_SPEED, 0),
    (STRAIGHT, {"speed": np.where(T > 1.05, 3.0, 5.0)}, kernel.WRONG_SPEED, 10),
])  # fmt: skip
def test_a_trajectory_that_cannot_be_is_refused_with_its_entry(points, columns, status, entry):
    stated, place, nodes = make_nodes(table(*points, **columns))
    assert (stated, len(nodes)) == (status, 0)
    assert abs(place - entry) <= (1 if "yaw" in columns else 0)


@pytest.mark.parametrize("columns", [{"yaw": math.radians(14.5)}, {"speed": 6.0}, {"speed": 4.0}, {"speed": np.inf}])
def test_what_differs_by_less_is_accepted(columns):
    assert len(nodes_of(*STRAIGHT, **columns)) == len(T)


def test_too_few_rows_for_nodes_are_a_status():
    assert kernel.condition(table(*STRAIGHT), 0.0, 0.0, np.empty((61, 5)))[0] == kernel.TOO_FEW_NODES


@pytest.mark.parametrize("columns", [(), ("yaw",), ("yaw", "speed")])
def test_noise_of_5_cm_is_never_refused(columns):
    """Points each 1 m, from 5 to 25 m/s, in bends; and speeds stay near the true ones."""
    random = np.random.default_rng(2026)
    for _ in range(20):
        speed, radius = random.uniform(5.0, 25.0), random.uniform(20.0, 300.0)
        (t, x, y), yaw = on_circle(radius, speed, 60.0 / speed, 1.0 / speed)
        x, y = x + 0.05 * random.standard_normal(t.size), y + 0.05 * random.standard_normal(t.size)
        columns_of = {"yaw": yaw, "speed": speed}
        nodes = nodes_of(t, x, y, arm=REAR, **{name: columns_of[name] for name in columns})
        assert np.abs(nodes[:, NODE.speed] / speed - 1.0).max() < 0.2


@pytest.mark.compiled
def test_noise_of_10_cm_is_no_jump_and_no_wrong_yaw():
    """A thousand trajectories of a hundred points each 1 m, at 25 m/s in a bend."""
    random, ((t, x, y), yaw) = np.random.default_rng(2027), on_circle(100.0, 25.0, 4.0, 0.04)
    for _ in range(1000):
        noise_x, noise_y = 0.1 * random.standard_normal((2, t.size))
        assert len(nodes_of(t, x + noise_x, y + noise_y, yaw=yaw, speed=25.0)) > 50


def test_noise_of_two_points_at_almost_the_same_time_is_no_jump():
    t = np.append(np.arange(0.0, 4.0, 0.1), 3.9 + 1e-6)
    nodes = nodes_of(t, np.append(10.0 * t[:-1], 39.09), np.zeros(t.size))
    assert (nodes[:, NODE.speed] < 12.0).all()
