"""The ROS 2 package: messages become the right numbers, and late and lost ones do not lose the car."""

import math
import re
import shutil
import sys
from functools import partial
from types import SimpleNamespace as Record

import numpy as np
import pytest

import adaptrack as at
import ros_messages
from programs import run_program
from ros_messages import (
    PACKAGE,
    drive_stamped,
    fake_ros,
    imu,
    odometry,
    package_module,
    path,
    pose_stamped,
    trajectory,
    transform_stamped,
    twist_stamped,
)

messages, follower, stand_in = map(package_module, ("messages", "follower", "stand_in"))
Parameters = follower.Parameters
_X = np.arange(0.0, 400.0)
ROAD = at.road_through(np.stack([_X, 8.0 * np.sin(_X / 25.0)], axis=-1))
"""Bends to both sides, of 78 m radius at their tightest."""
STRAIGHT = np.stack([np.arange(100.0), np.zeros(100)], axis=-1)
CAR = at.load_vehicle("midsize-sedan")
CPP = PACKAGE.parent / "adaptrack_ros_cpp"


@pytest.fixture(scope="session")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("controller")


@pytest.fixture(params=["python", pytest.param("c++", marks=pytest.mark.compiled)])
def Follower(request):
    """What decides in the Python node, and in the C++ node."""
    if request.param == "python":
        return follower.Follower
    module, library = request.getfixturevalue("cpp")
    return partial(module.CppFollower, library)


@pytest.fixture(scope="session")
def cpp(folder):
    """How the C++ class is called, and its library."""
    import ros_cpp

    return ros_cpp, ros_cpp.shim(folder)


def test_what_decides_needs_no_ros():
    assert not {"rclpy", "nav_msgs"} & sys.modules.keys()


# -- messages ---------------------------------------------------------------------------------------------------------


def test_an_odometry_is_a_sample():
    sample = messages.sample_of(odometry(2.5, x=10.0, y=-4.0, yaw=-2.5, speed=12.0, rate=-0.2), 0.0)
    assert sample == pytest.approx((2.5, 10.0, -4.0, -2.5, 12.0, -0.2))


@pytest.mark.parametrize("w", [0.0, math.nan])
def test_an_odometry_that_was_never_filled_in_is_refused(w):
    message = odometry()
    message.pose.pose.orientation.w = w
    with pytest.raises(at.InvalidInput):
        messages.sample_of(message, 0.0)


def test_speeds_of_a_path_are_those_of_its_stamps():
    """Accelerating at 2 m/s^2 from 5 m/s."""
    t = np.arange(0.0, 4.0, 0.25)
    points = np.stack([5.0 * t + t**2, 0.0 * t], axis=-1)
    speeds = messages.speeds_of(path(points, 100.0 + t))
    assert speeds[1:-1] == pytest.approx(5.0 + 2.0 * t[1:-1], abs=1e-6)
    assert messages.speeds_of(path(points)) is None


# -- the stand-in of the car ------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_the_stand_in_turns_as_its_car_does():
    """The yaw rate of the steady turn at 10 m/s, to a few percent; the odometry is that of the rear axle."""
    car, sent = stand_in.StandInCar(), drive_stamped()
    car.place(0.0, 0.0, 0.0, 10.0)
    messages.fill_drive(sent, 0.01, 10.0, 1.5)
    car.obey(sent.drive)
    car.advance(4.0)
    message = odometry()
    car.fill_odometry(message)
    twist = message.twist.twist
    assert twist.angular.z == pytest.approx(0.01 * CAR.steady_state_yaw_gain(10.0), rel=0.05)
    assert twist.linear.y == pytest.approx(car.state[4] - CAR.lr * car.state[5])


# -- the loop ---------------------------------------------------------------------------------------------------------
class Loop:
    """The stand-in behind the follower: messages are delivered as `late` (s) and `lost` (of a tick) say."""

    def __init__(self, Follower, road=ROAD, start=10.0, speed=8.0, **parameters):
        self.road, self.s = road, start
        self.follower = Follower(Parameters(top_speed=8.0, **parameters))
        self.car = stand_in.StandInCar()
        place = road.at(start)
        self.car.place(float(place.x), float(place.y), float(place.heading), speed)
        self.waiting, self.offset, self.commands, self.now = [], [], [], 0.0
        self.follower.path(path(stand_in.window(road, start)))

    def drive(self, seconds, late=lambda k: 0.0, lost=lambda k: False, has_motion=False):
        ticks = round(seconds / 0.05)
        for k in range(ticks):
            message = odometry(self.now)
            self.car.fill_odometry(message)
            if has_motion:
                twist = message.twist.twist
                self.follower.motion(twist_stamped(self.now, twist.linear.x, twist.angular.z))
                message.twist.twist = Record(linear=Record(x=99.0), angular=Record(z=9.0))  # is not read
            if not lost(k):
                self.waiting.append((self.now + late(k), message))
            for arriving in [message for message in self.waiting if message[0] <= self.now + 1e-9]:
                self.waiting.remove(arriving)
                self.follower.pose(arriving[1])
            if k % 10 == 9:
                self.follower.path(path(stand_in.window(self.road, self.s)))
            command, sent = self.follower.tick(self.now), drive_stamped()
            messages.fill_drive(sent, command.angle, command.speed, command.acceleration)
            self.car.obey(sent.drive)
            self.car.advance(0.05)
            self.now += 0.05
            self.commands.append(command)
            foot = self.road.project(*self.car.state[:2], near=self.s)
            self.s = float(foot.s)
            self.offset.append(float(foot.offset))
        return self

    @property
    def furthest(self):
        return np.abs(self.offset).max()


@pytest.mark.compiled
def test_the_car_follows_bends_within_five_centimetres(Follower):
    loop = Loop(Follower).drive(20.0)
    assert loop.furthest < 0.05
    assert not any(command.stopping for command in loop.commands)
    assert loop.s > 150.0


@pytest.mark.compiled
@pytest.mark.parametrize("channel", [
    {"late": lambda k: 0.15},
    {"late": lambda k: 0.15, "has_motion": True},
    {"late": lambda k: 0.2 if k % 2 else 0.1},
    {"lost": lambda k: k % 4 == 3},
    {"lost": lambda k: 100 <= k < 104},
], ids=["0.15 s late", "prompt motion", "overtaking", "every fourth lost", "0.2 s lost"])  # fmt: skip
def test_late_and_lost_messages_do_not_lose_the_car(Follower, channel):
    loop = Loop(Follower).drive(10.0, **channel)
    assert loop.furthest < 0.05
    assert not any(command.stopping for command in loop.commands[4:])


@pytest.mark.compiled
def test_a_path_that_moves_to_the_next_lane_is_taken_over(Follower):
    points = ROAD.at(_X)
    next_lane = np.stack([points.x - 1.5 * np.sin(points.heading), points.y + 1.5 * np.cos(points.heading)], axis=-1)
    loop = Loop(Follower).drive(4.0)
    loop.road = at.road_through(next_lane)
    loop.drive(0.5)
    loop.offset.clear()
    loop.drive(10.0)
    assert np.abs(loop.offset[-40:]).max() < 0.1
    assert max(loop.offset) < 0.3  # from 1.5 m to the right of it, it is not overshot by more


@pytest.mark.compiled
def test_a_silence_brings_the_car_to_a_stand_beside_its_path(Follower):
    """0.3 s after the last odometry: speed 0 at 3 m/s^2, steered on by the estimate; good messages start it again."""
    loop = Loop(Follower).drive(5.0).drive(5.0, lost=lambda k: True)
    silent = loop.commands[100:]
    stopping = [bool(command.stopping) for command in silent]
    assert stopping.index(True) == 6  # the last odometry is then 0.35 s old
    assert all(stopping[6:])
    assert {(command.speed, command.acceleration) for command in silent[6:]} == {(0.0, 3.0)}
    assert "s old" in silent[-1].stopping
    assert loop.car.state[3] < 0.05
    assert loop.furthest < 0.15
    loop.drive(3.0)
    assert not loop.commands[-1].stopping
    assert loop.car.state[3] > 1.0


@pytest.mark.compiled
def test_the_car_stands_at_the_end_of_its_path(Follower):
    loop = Loop(Follower, start=ROAD.length - 40.0).drive(14.0)
    assert loop.car.state[3] < 0.3
    assert ROAD.length - 4.0 < loop.s < ROAD.length + 1.0


# -- what is sent when something is wrong -----------------------------------------------------------------------------


@pytest.fixture
def driving(Follower):
    """A follower that has made a step on a straight."""
    node = Follower()
    node.path(path(STRAIGHT))
    node.pose(odometry(0.0, x=20.0, speed=5.0))
    assert not node.tick(0.0).stopping
    return node


def test_the_speed_is_the_planned_one_and_the_offset_of_the_centre_of_mass(driving):
    driving.pose(odometry(0.05, x=20.25, y=0.5, speed=5.0))
    command = driving.tick(0.05)
    assert command[1:4] == (10.0, 1.5, "")
    level, text, values = driving.diagnosis(0.05)
    assert (level, text, values["status"]) == (follower.OK, "following", "ok")
    assert float(values["offset (m)"]) == pytest.approx(0.5, abs=0.1)
    assert float(values["station (m)"]) == pytest.approx(20.25 + CAR.lr, abs=0.1)


def test_an_empty_path_stops_the_car_and_the_next_one_starts_it(driving):
    driving.path(path([]))
    driving.pose(odometry(0.05, x=20.25, speed=5.0))
    assert driving.tick(0.05).stopping == "the path is empty"
    driving.path(path(STRAIGHT))
    driving.pose(odometry(0.1, x=20.5, speed=5.0))
    assert not driving.tick(0.1).stopping


def test_a_path_that_cannot_be_driven_is_refused_and_the_old_one_followed(driving):
    driving.path(path([(0.0, 0.0)] * 8))
    driving.pose(odometry(0.05, x=20.25, speed=5.0))
    assert not driving.tick(0.05).stopping
    level, text, _ = driving.diagnosis(0.05)
    assert level == follower.WARN
    assert "path left out" in text


POSE = Parameters(pose_message="geometry_msgs/PoseStamped", motion_message="geometry_msgs/TwistStamped")


def test_a_pose_and_a_motion_command_what_their_odometry_does_to_the_bit(Follower):
    """With motions that are lost, prompt or late, of poses that are late."""
    nodes, rng = (
        [Follower(POSE), Follower(Parameters(motion_message="geometry_msgs/TwistStamped"))],
        np.random.default_rng(5),
    )
    for node in nodes:
        node.path(path(STRAIGHT))
    for k in range(40):
        time, lost, late = 0.05 * k, rng.random() < 0.2, 0.05 * int(rng.integers(3))
        motion = twist_stamped(time - 0.01 * int(rng.integers(4)), 5.0 + 0.1 * rng.normal(), 0.002 * rng.normal())
        place = (20.0 + 5.0 * (time - late), 0.01 * rng.normal(), 0.002 * rng.normal())
        for node, message in zip(nodes, (pose_stamped, odometry), strict=True):
            if not lost:
                node.motion(motion)
            node.pose(message(time - late, *place))
        ours, theirs = (node.tick(time) for node in nodes)
        assert ours[:3] == theirs[:3]
        assert not ours.stopping
    assert nodes[0].diagnosis(time)[2] == nodes[1].diagnosis(time)[2]


def test_a_transform_is_the_pose_that_it_gives():
    there = (2.5, 10.0, -4.0, -2.5)
    samples = [messages.sample_of(make(*there), -1.2) for make in (pose_stamped, transform_stamped, odometry)]
    assert samples[0][:4] == samples[1][:4] == samples[2][:4]
    assert all(math.isnan(number) for sample in samples[:2] for number in sample[4:])


def test_a_topic_that_sends_nothing_stops_the_car_in_a_sentence(Follower):
    node = Follower(POSE)
    assert node.tick(0.0).stopping == "no path yet on topic path"
    node.path(path(STRAIGHT))
    assert node.tick(0.05).stopping == "no pose yet on topic pose"
    node.pose(pose_stamped(0.1, 20.0))
    assert node.tick(0.1).stopping == "no speed yet on topic motion"
    node.motion(twist_stamped(0.15, 5.0))
    node.pose(pose_stamped(0.15, 20.25))
    assert not node.tick(0.15).stopping
    node.pose(pose_stamped(0.55, 22.25))
    assert node.tick(0.55).stopping == "the newest speed is 0.4 s old"
    other = Follower(Parameters(motion_message="sensor_msgs/Imu"))
    other.path(path(STRAIGHT))
    other.pose(odometry(0.0, x=20.0, speed=5.0))
    assert not other.tick(0.0).stopping
    assert "no motion yet on topic motion" in other.diagnosis(0.0)[1]


def test_a_motion_in_a_frame_that_is_not_the_cars_is_left_out(Follower):
    node, message = Follower(POSE), twist_stamped(0.0, 5.0)
    message.header.frame_id = "map"
    node.motion(message)
    assert "motion left out: it is of frame 'map', and base_frame is 'base_link'" in node.diagnosis(0.0)[1]


def test_an_odometry_of_another_frame_is_left_out(driving):
    message = odometry(0.05, x=20.25, speed=5.0)
    message.child_frame_id = "imu"
    driving.pose(message)
    assert "base_frame" in driving.diagnosis(0.05)[1]
    assert driving.tick(0.4).stopping == "the newest odometry is 0.4 s old"


@pytest.mark.parametrize(("ahead", "says"), [(5.0, "ahead of this clock"), (-5.0, "s old")])
def test_two_clocks_stop_the_car(driving, ahead, says):
    for k in range(1, 20):
        driving.pose(odometry(0.05 * k + ahead, x=20.0 + 0.25 * k, speed=5.0))
    assert says in driving.tick(0.95).stopping


@pytest.mark.parametrize(
    ("y", "speed", "says"), [(5.0, 5.0, "too far"), (0.0, -1.0, "backwards")], ids=["off the path", "reverse"]
)
def test_a_status_that_is_not_good_stops_the_car(Follower, y, speed, says):
    node = Follower()
    node.path(path(STRAIGHT))
    node.pose(odometry(0.0, x=20.0, y=y, speed=speed))
    assert says in node.tick(0.0).stopping


def test_speeds_of_the_path_are_driven(Follower):
    node = Follower(Parameters(path_message="autoware_planning_msgs/Trajectory"))
    node.path(trajectory(STRAIGHT, np.full(100, 3.0)))
    node.pose(odometry(0.0, x=20.0, speed=3.0))
    assert node.tick(0.0).speed == pytest.approx(3.0)
    node.path(trajectory(STRAIGHT, np.full(100, -3.0)))
    assert "backwards" in node.diagnosis(0.0)[1]


@pytest.fixture(params=["trajectory", "stamped path"])
def planned(request):
    """A message by whose times a car drives at 6 m/s along the x axis from a place on."""

    def make(x, time):
        t = 0.1 * np.arange(60)
        points = np.stack([x + 6.0 * t, np.zeros(60)], axis=-1)
        if request.param == "stamped path":
            return path(points, time + t, t=time)
        return trajectory(points, np.full(60, 6.0), times=t, yaws=np.zeros(60), t=time)

    return make


@pytest.fixture
def timed(Follower, request, tmp_path_factory):
    """A follower of trajectories."""
    parameters = Parameters(follow="trajectory")
    if Follower is follower.Follower:
        return Follower(parameters)
    module, _ = request.getfixturevalue("cpp")
    return module.CppFollower(module.shim(tmp_path_factory.getbasetemp() / "timed", follow="trajectory"), parameters)


def test_a_late_car_catches_up_with_the_times_and_stops_when_the_planner_falls_silent(timed, planned):
    speed, x = 6.0, -2.0 - CAR.lr  # of the rear axle, 2 m behind its time
    assert timed.tick(0.0).stopping == follower.NO_PATH
    for k in range(1, 120):
        time = 0.05 * k
        if k % 2 and k < 80:
            timed.path(planned(6.0 * time, time), time)
        timed.pose(odometry(time, x=x + 6.0 * 0.05 + CAR.lr, speed=speed))
        command = timed.tick(time)
        if k == 10:
            assert command.speed == pytest.approx(6.7, abs=0.1)  # 0.4/s times the way beyond 0.2 m
        if k == 79:
            level, text, values = timed.diagnosis(time)
            assert (level, text, values["driven by"]) == (follower.OK, "following", "planner")
            assert float(values["late (s)"]) < 0.15
        assert k == 89 or bool(command.stopping) == (k > 89)  # 0.5 s after the last one
        speed += min(max(command.speed - speed, -0.15), 0.075)
        x += 0.05 * speed
    assert command.stopping == follower.NO_PLANNER
    assert timed.diagnosis(time)[2]["driven by"] == "stop"


def test_a_trajectory_of_a_future_stamp_or_with_falling_times_is_left_out_with_its_reason(timed):
    points = np.stack([np.arange(0.0, 40.0), np.zeros(40)], axis=-1)
    times = 0.2 * np.arange(40)
    timed.path(trajectory(points, np.full(40, 5.0), times=times, t=1.0), 1.0)
    timed.pose(odometry(1.0, x=0.0, speed=5.0))
    assert not timed.tick(1.0).stopping
    timed.path(trajectory(points, np.full(40, 5.0), times=times, t=9.0), 1.1)
    assert "path left out: it is early" in timed.diagnosis(1.1)[1]
    timed.path(trajectory(points, np.full(40, 5.0), times=times[::-1], t=1.2), 1.2)
    assert "path left out:" in timed.diagnosis(1.2)[1]
    timed.path(trajectory(points[6:], np.full(34, 5.0), times=times[:34], t=1.2), 1.2)
    assert timed.diagnosis(1.2)[:2] == (follower.OK, "following")


RATE = 1.5
"""m/s^2, by which a fallback brakes"""


def to_rest(time, x=None, speed=6.0, frame="map", rate=RATE):
    """A message that leads to rest along the x axis: from a place (m) of the rear axle and a speed (m/s) on."""
    t = np.minimum(0.1 * np.arange(60), speed / rate)
    x = 6.0 * time if x is None else x
    points = np.stack([x + speed * t - 0.5 * rate * t**2, np.zeros(60)], axis=-1)
    speeds = (speed - rate * t).astype(np.float32)  # as in the message
    return trajectory(points, speeds, frame, 0.1 * np.arange(60), np.zeros(60), t=time)


class Planned:
    """A car at 6 m/s on the x axis behind a follower: a trajectory arrives every 0.1 s, until `silent` (s)."""

    def __init__(self, node, silent=math.inf):
        self.node, self.silent, self.speed, self.x, self.k = node, silent, 6.0, 0.0, 0

    @property
    def time(self):
        return 0.05 * self.k

    def step(self, fallback=None):
        """Let a period pass; `fallback` arrives before its trajectory."""
        self.k += 1
        self.x += 0.05 * self.speed
        if fallback is not None:
            self.node.fallback(fallback, self.time)
        if self.k % 2 and self.time < self.silent:
            t = 0.1 * np.arange(60)
            points = np.stack([6.0 * (self.time + t), np.zeros(60)], axis=-1)
            message = trajectory(points, np.full(60, 6.0), times=t, yaws=np.zeros(60), t=self.time)
            self.node.path(message, self.time)
        self.node.pose(odometry(self.time, x=self.x, speed=self.speed))
        command = self.node.tick(self.time)
        self.speed += min(max(command.speed - self.speed, -0.15), 0.075)
        return command

    def diagnosis(self):
        return self.node.diagnosis(self.time)


def test_a_car_whose_planner_falls_silent_comes_to_rest_where_the_newest_fallback_ends(timed):
    loop = Planned(timed, silent=1.9)
    while loop.time < 1.85:
        command = loop.step(to_rest(loop.time + 0.05) if loop.k % 2 == 0 else None)
    assert loop.diagnosis()[:2] == (follower.OK, "following")
    assert {"verdict": "taken", "driven by": "planner"}.items() <= loop.diagnosis()[2].items()
    begin = loop.time  # of the fallback
    while loop.time < 12.0:
        command = loop.step()
        if loop.time > begin + 0.7:
            level, text, values = loop.diagnosis()
            assert (level, text, values["driven by"]) == (follower.WARN, follower.ON_FALLBACK, "fallback")
            assert not command.stopping
    assert float(values["age of the fallback (s)"]) == pytest.approx(loop.time - begin, abs=0.06)
    assert loop.speed < 0.05
    assert loop.x == pytest.approx(6.0 * begin + 6.0**2 / (2.0 * RATE), abs=0.3)


def test_a_fallback_between_trajectories_is_handed_over_with_the_next_and_once(timed):
    loop = Planned(timed)
    while loop.time < 1.0:
        loop.step()
    assert loop.diagnosis()[2]["age of the fallback (s)"] == ""
    for arrival in (1.05, 1.1):  # with a trajectory, and between two
        loop.step(to_rest(arrival))
        assert float(loop.diagnosis()[2]["age of the fallback (s)"]) == pytest.approx(arrival - 1.05, abs=1e-3)
    loop.step()
    assert loop.diagnosis()[2]["age of the fallback (s)"] == "0.000"
    while loop.time < 2.0:
        loop.step()
    assert float(loop.diagnosis()[2]["age of the fallback (s)"]) == pytest.approx(loop.time - 1.15, abs=1e-3)
    assert loop.diagnosis()[:2] == (follower.OK, "following")


@pytest.mark.parametrize(("flawed", "says"), [
    (lambda time: to_rest(time - 1.1), "it is stale"),
    (lambda time: to_rest(time, frame="odom"), "it is in frame 'odom', the trajectory in 'map'"),
    (lambda time: to_rest(time, rate=0.1), None),  # it ends at 5.4 m/s
    (lambda time: trajectory([], []), None),
], ids=["old stamp", "frame", "no rest", "no points"])  # fmt: skip
def test_a_fallback_that_cannot_be_used_is_left_out_while_its_trajectory_and_the_fallback_before_are_taken(
    timed, flawed, says
):
    loop = Planned(timed, silent=2.3)
    for arrival in np.arange(0.05, 2.0, 0.05):
        loop.step(to_rest(arrival) if arrival < 1.5 else None)
    loop.step()
    last = loop.k + 1
    command = loop.step(flawed(0.05 * last))
    assert not command.stopping
    level, text, values = loop.diagnosis()
    assert level == follower.WARN
    assert text.startswith("fallback left out: ")
    assert says is None or text == f"fallback left out: {says}"
    assert (values["verdict"], values["driven by"]) == ("taken", "planner")
    while loop.time < 3.2:
        loop.step()
    assert loop.diagnosis()[2]["driven by"] == "fallback"
    assert follower.ON_FALLBACK in loop.diagnosis()[1]


def test_the_next_good_fallback_ends_the_warning_of_one_that_was_left_out(timed):
    loop = Planned(timed)
    for k in range(1, 30):
        loop.step(to_rest(0.05 * k, frame="odom" if k < 20 else "map"))
    assert loop.diagnosis()[:2] == (follower.OK, "following")


def test_a_stale_fallback_of_a_planner_without_stamps_is_left_out_by_its_time_of_arrival(timed):
    loop, message = Planned(timed, silent=0.1), to_rest(0.0)
    loop.step()
    loop.step(message)
    assert message.header.stamp == ros_messages.stamp(0.0)
    while loop.time < 1.5:
        loop.step()
    loop.silent = math.inf
    loop.step()
    assert "fallback left out: it is stale" in loop.diagnosis()[1]


@pytest.mark.compiled
def test_both_nodes_come_to_rest_by_a_fallback_to_the_bit(cpp, tmp_path_factory):
    """Of fallbacks that arrive at random times, some in a different frame, some stale, some without a rest."""
    parameters, rng = Parameters(follow="trajectory"), np.random.default_rng(7)
    library = cpp[0].shim(tmp_path_factory.getbasetemp() / "timed", follow="trajectory")
    loops = [Planned(follower.Follower(parameters), 4.0), Planned(cpp[0].CppFollower(library, parameters), 4.0)]
    texts = set()
    for k in range(1, 200):
        chance, is_stale, frame = rng.random(), rng.random() < 0.2, "odom" if rng.random() < 0.2 else "map"
        sent = to_rest(0.05 * k - 1.2 * is_stale, 0.3 * k, frame=frame, rate=0.1 if chance < 0.1 else RATE)
        ours, theirs = (loop.step(sent if chance < 0.4 and k > 30 else None) for loop in loops)
        assert ours.stopping == theirs.stopping
        assert np.array_equal([*ours[:3], *ours[4:]], [*theirs[:3], *theirs[4:]], equal_nan=True)
        (level, text, values), (cpp_level, cpp_text, cpp_values) = (loop.diagnosis() for loop in loops)
        assert (level, values) == (cpp_level, cpp_values)
        assert text == cpp_text or "at rest" in text  # the C++ node names the error of the library
        texts.add(text)
    assert loops[0].x == loops[1].x
    assert values["driven by"] == "fallback"
    assert loops[0].speed < 0.05
    assert len(texts) >= 5


@pytest.mark.compiled
def test_both_nodes_follow_a_trajectory_alike(cpp, tmp_path):
    """On a bend, replanned each 0.1 s, late by 2 m; yaws by two libraries' arctangents differ in the last bit."""
    parameters = Parameters(follow="trajectory", speed_control=True)
    library = cpp[0].shim(tmp_path, speed_control=True, follow="trajectory")
    nodes, t = [follower.Follower(parameters), cpp[0].CppFollower(library, parameters)], 0.1 * np.arange(50)
    for k in range(100):
        time, commands = 0.05 * k, []
        x = 5.0 * time + 5.0 * t
        points, yaws = np.stack([x, 8.0 * np.sin(x / 25.0)], axis=-1), np.arctan(0.32 * np.cos(x / 25.0))
        speeds = np.hypot(5.0, np.gradient(points[:, 1], 0.1)).astype(np.float32)  # as in the message
        car = 5.0 * time - 2.0
        for node in nodes:
            if k % 2 == 0 and k < 60:
                node.path(trajectory(points, speeds, times=t, yaws=yaws, t=time), time)
            node.pose(odometry(time, car, 8.0 * np.sin(car / 25.0), np.arctan(0.32 * np.cos(car / 25.0)), 5.3, 0.0))
            commands.append(node.tick(time))
        ours, theirs = commands
        assert ours.stopping == theirs.stopping
        assert ours[:3] == pytest.approx(theirs[:3], abs=1e-9)
    assert ours.stopping == follower.NO_PLANNER


def drive_obediently(node, message, seconds=14.0, lag=0.3):
    """Places (m) and angles (rad) of a car that obeys from 20 m on; the path is published every half second."""
    x, speed, rows = 20.0, 5.0, []
    for k in range(round(seconds / 0.05)):
        if k % 10 == 0:
            node.path(message)
        node.pose(odometry(0.05 * k, x=x, speed=speed))
        command = node.tick(0.05 * k)
        speed = max(speed + (command.speed - speed) * 0.05 / lag, 0.0)
        x += 0.05 * speed
        rows.append((x, command.angle))
    return np.array(rows).T


def test_a_car_waits_at_a_stop_point_a_millimetre_beside_its_path(Follower):
    """The planner's point of speed 0 is left out of the path, its speed is not; nor does the path turn there."""
    points = np.insert(STRAIGHT, 41, [39.9999, 1e-3], axis=0)
    speeds = np.minimum(np.sqrt(6.0 * np.abs(points[:, 0] - points[41, 0])), 5.0)
    parameters = Parameters(path_message="autoware_planning_msgs/Trajectory")
    x, angle = drive_obediently(Follower(parameters), trajectory(points, speeds))
    assert x[-1] + CAR.lr == pytest.approx(40.0, abs=0.5)
    assert x[-1] == x[-20]
    assert np.abs(angle).max() < 1e-3


def test_engaging_begins_at_the_angle_of_the_wheels(driving):
    driving.engage(False)
    assert driving.tick(0.05) is None
    driving.engage(True, wheel_angle=0.4)
    driving.pose(odometry(0.1, x=20.5, speed=5.0))
    ahead = follower.Follower().controller().limits.ahead
    assert driving.tick(0.1).angle == pytest.approx(0.4, abs=1.01 * ahead)


@pytest.mark.parametrize("values", [
    {"top_speed": 0.0}, {"path_message": "nav_msgs/Paths"}, {"vehicle": "tricycle"}, {"drive_message": "Twist"},
])  # fmt: skip
def test_parameters_that_are_not_possible_are_refused(values):
    with pytest.raises(at.InvalidInput):
        follower.Follower(Parameters(**values))


@pytest.mark.parametrize(("pose", "motion", "says"), [
    ("tf", "", "'tf' has no speed: give motion_message = geometry_msgs/TwistStamped or nav_msgs/Odometry"),
    ("geometry_msgs/PoseStamped", "sensor_msgs/Imu", "has no speed"),
    ("geometry_msgs/Pose", "", "must be one of nav_msgs/Odometry, geometry_msgs/PoseStamped, tf"),
    ("nav_msgs/Odometry", "Twist", "motion_message = 'Twist': must be one of empty, geometry_msgs/TwistStamped"),
])  # fmt: skip
def test_sources_of_pose_and_motion_that_are_not_possible_are_refused(Follower, pose, motion, says):
    values = vars(Parameters()) | {"pose_message": pose, "motion_message": motion}
    make = Parameters if Follower is follower.Follower else Record  # the C++ class checks them by itself
    with pytest.raises(at.InvalidInput, match=re.escape(says)):
        Follower(make(**values))


# -- the C++ node -----------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["trajectory", "stamped path", "twist", "imu", "speed control"])
def test_both_nodes_send_the_same_commands_to_the_bit(cpp, kind, tmp_path):
    """Samples late, lost and overtaking each other, a path that moves, a silence, an engagement."""
    parameters = Parameters(speed_control=kind == "speed control")
    library = cpp[0].shim(tmp_path, speed_control=True) if parameters.speed_control else cpp[1]
    nodes = [follower.Follower(parameters), cpp[0].CppFollower(library, parameters)]
    t, points = 0.2 * np.arange(200.0), np.stack([_X[:200], 8.0 * np.sin(_X[:200] / 25.0)], axis=-1)
    paths = [points, points + np.array([0.0, 0.4])]
    rng, sent = np.random.default_rng(1), ([], [])
    for k in range(160):
        time = 0.05 * k
        x = 10.0 + 5.0 * time + rng.normal(0.0, 0.02)
        y, yaw = 8.0 * np.sin(x / 25.0) + rng.normal(0.0, 0.02), np.arctan(0.32 * np.cos(x / 25.0))
        message = odometry(time - 0.05 * int(rng.integers(3)), x, y, yaw, 5.0 + rng.normal(0.0, 0.05), 0.0)
        motion_time, rate = time - 0.01 * int(rng.integers(3)), rng.normal(0.0, 0.02)
        motion = twist_stamped(motion_time, 5.05, rate) if kind == "twist" else imu(motion_time, rate)
        lost, moved = 60 <= k < 75 or rng.random() < 0.2, paths[int(k >= 100)]
        for node, commands in zip(nodes, sent, strict=True):
            if k % 20 == 0:
                node.path(path(moved, 9.0 + t) if kind == "stamped path" else trajectory(moved, 4.0 + _X[:200] / 64))
            if kind in ("twist", "imu") and k % 7:
                node.motion(motion)
            if not lost:
                node.pose(message)
            if k in (120, 124):
                node.engage(k == 124, 0.02)
            commands.append(node.tick(time))
        if commands[-1] is not None:
            ours, theirs = poses_of(nodes[0]), nodes[1].predicted_path()
            assert len(ours) == len(theirs) == (0 if commands[-1].stopping else 30)
            assert ours == pytest.approx(theirs, rel=1e-12, abs=1e-12)
    stopped = [command is None or bool(command.stopping) for command in sent[0]]
    assert 10 < sum(stopped) < 40
    for ours, theirs in zip(*sent, strict=True):
        assert (ours is None) == (theirs is None)
        if ours is not None:
            assert ours[:3] == theirs[:3]
            assert bool(ours.stopping) == bool(theirs.stopping)
            assert np.array_equal(ours[4:], theirs[4:], equal_nan=True)


def poses_of(node):
    """(n, 5) of the poses of the predicted path behind a stamp of 0.9 s: ns, x, y, and z, w of the quaternion."""
    message = path([])
    messages.fill_path(message, ros_messages.stamp(0.9), "map", node.predicted_path(), pose_stamped)
    assert {place.header.frame_id for place in message.poses} <= {message.header.frame_id} == {"map"}
    rows = [
        (1e9 * place.header.stamp.sec + place.header.stamp.nanosec, place.pose.position.x, place.pose.position.y,
         place.pose.orientation.z, place.pose.orientation.w) for place in message.poses
    ]  # fmt: skip
    return np.array(rows).reshape(-1, 5)


def test_the_predicted_path_begins_behind_the_dead_time_and_points_along_the_way():
    """Across a straight at 5 m/s: the times of the poses are those at which a car of this speed is there."""
    node, turned = follower.Follower(), 0.7
    way = STRAIGHT @ np.array([[math.cos(turned), math.sin(turned)], [-math.sin(turned), math.cos(turned)]])
    node.path(path(way))
    x, y = 20.0 * math.cos(turned), 20.0 * math.sin(turned)
    assert len(node.predicted_path()) == 0
    node.pose(odometry(0.0, x, y, turned, speed=5.0))
    node.tick(0.0)
    rows = poses_of(node)
    delays = 1e-9 * rows[:, 0] - 0.9
    distances = np.hypot(rows[:, 1] - x - CAR.lr * math.cos(turned), rows[:, 2] - y - CAR.lr * math.sin(turned))
    assert delays == pytest.approx(delays[0] + 0.05 * np.arange(30), abs=1e-6)
    assert delays[0] >= 0.05 + node.parameters.command_delay
    assert np.diff(distances) == pytest.approx(0.25, abs=0.03)
    assert distances[0] == pytest.approx(5.0 * delays[0], abs=0.05)
    assert 2.0 * np.arctan2(rows[:, 3], rows[:, 4]) == pytest.approx(turned, abs=1e-3)


def test_poses_of_a_car_that_is_expected_to_stand_keep_the_direction_of_the_path():
    node = follower.Follower(Parameters(path_message="autoware_planning_msgs/Trajectory"))
    node.path(trajectory(STRAIGHT[:, ::-1], np.sqrt(6.0 * np.maximum(41.0 - STRAIGHT[:, 0], 0.0))))
    node.pose(odometry(0.0, 0.1, 39.0 - CAR.lr, 0.5 * math.pi, speed=math.sqrt(12.0)))
    node.tick(0.0)
    rows = poses_of(node)
    assert np.hypot(*np.diff(rows[:, 1:3], axis=0).T).min() < follower.SHORT_STEP
    assert 2.0 * np.arctan2(rows[:, 3], rows[:, 4]) == pytest.approx(0.5 * math.pi, abs=0.2)


@pytest.mark.compiled
@pytest.mark.parametrize("request_", [-1.25, math.nan])
def test_both_nodes_write_the_same_control_of_autoware(cpp, request_):
    """Stamps that carry over the second; an acceleration is defined where one is requested."""
    command = follower.Command(0.123, 4.5, 1.5, "", -0.2, request_)
    at_ns, message = ros_messages.stamp(1000.97), ros_messages.control()
    messages.fill_control(message, at_ns, 0.05, command)
    lateral, longitudinal = message.lateral, message.longitudinal
    times = [
        1_000_000_000 * time.sec + time.nanosec
        for part in (message, lateral, longitudinal)
        for time in (part.stamp, part.control_time)
    ]
    assert times == [1000_970_000_000, 1001_020_000_000] * 3
    numbers = [
        lateral.steering_tire_angle, lateral.steering_tire_rotation_rate,
        lateral.is_defined_steering_tire_rotation_rate, longitudinal.velocity, longitudinal.acceleration,
        longitudinal.is_defined_acceleration,
    ]  # fmt: skip
    is_defined = math.isfinite(request_)
    assert numbers == [0.123, -0.2, True, 4.5, request_ if is_defined else 0.0, is_defined]
    assert cpp[0].CppFollower(cpp[1]).control(command, at_ns) == (times, np.float32(numbers).tolist())


@pytest.mark.compiled
def test_constants_of_a_file_are_taken_and_damaged_ones_refused(cpp, folder):
    module, library = cpp
    constants = (folder / "constants.bin").read_bytes()
    node = module.CppFollower(library, constants=constants)
    node.path(path(STRAIGHT))
    node.pose(odometry(0.0, x=20.0, speed=5.0))
    assert not node.tick(0.0).stopping
    for damaged in (constants[:-1], constants[:40] + bytes([constants[40] ^ 1]) + constants[41:], b"?" * 64):
        with pytest.raises(at.InvalidInput, match="constants: adaptrack error"):
            module.CppFollower(library, constants=damaged)
    with pytest.raises(at.InvalidInput, match="base_ahead"):
        module.CppFollower(library, Parameters(base_ahead=math.nan))


@pytest.mark.compiled
def test_a_bend_is_planned_within_three_metres_per_second_squared(cpp):
    """The C++ node's own plan: a half circle of 12 m radius behind a straight, and a stand at its end."""
    angle = np.linspace(0.0, np.pi, 38)
    bend = np.stack([40.0 + 12.0 * np.sin(angle), 12.0 - 12.0 * np.cos(angle)], axis=-1)
    node = cpp[0].CppFollower(cpp[1])
    node.path(path(np.concatenate([STRAIGHT[:40], bend])))
    speeds = []
    for k, s in enumerate(np.arange(0.0, 40.0, 0.25)):
        node.pose(odometry(0.05 * k, x=s + CAR.lr, speed=5.0))
        speeds.append(node.tick(0.05 * k).speed)
    assert max(speeds) <= 10.0
    assert speeds[-1] == pytest.approx(math.sqrt(3.0 * 12.0), rel=0.05)
    assert np.diff(np.square(speeds)).min() > -2.0 * 1.5 * 0.3


@pytest.mark.compiled
def test_whatever_comes_the_cpp_node_sends_finite_angles_that_the_wheels_can_have(cpp):
    """Numbers that are none, far away, clocks that jump, paths of one point, of points twice, that fold back."""
    rng, node = np.random.default_rng(3), cpp[0].CppFollower(cpp[1])
    strange = [math.nan, math.inf, -1e300, 1e9, 0.0, -50.0]
    most, angles, going = follower.Follower().controller().limits.angle[1], [], 0
    for k in range(3000):
        time, values = 0.05 * k, {"x": 0.2 * k % 80.0, "y": rng.normal(0.0, 0.1), "speed": 4.0, "rate": 0.0}
        if rng.random() < 0.2:
            values[rng.choice(list(values))] = rng.choice(strange)
        stamp = time + (rng.choice([-9.0, -0.1, 3.0, 1e6]) if rng.random() < 0.1 else 0.0)
        message = odometry(stamp, **values)
        if rng.random() < 0.05:
            message.pose.pose.orientation.w = rng.choice(strange)
        if rng.random() < 0.9:
            node.pose(message)
        if rng.random() < 0.2:
            points = STRAIGHT[: rng.integers(101)] + rng.normal(0.0, 0.02, 2)
            if len(points) and rng.random() < 0.4:
                points[rng.integers(len(points))] = rng.choice(strange, 2)
            node.path(path(points, rng.integers(0, 9, len(points)) if rng.random() < 0.1 else None))
        if rng.random() < 0.02:
            node.engage(True, rng.choice([*strange, 0.1]))
        command = node.tick(time + (rng.choice([-5.0, 9.0]) if rng.random() < 0.02 else 0.0))
        angles.append(command.angle)
        going += not command.stopping
        node.diagnosis(time)
    assert np.isfinite(angles).all()
    assert np.abs(angles).max() <= most
    assert going > 300


@pytest.mark.slow
@pytest.mark.compiled
def test_the_cpp_package_is_configured_and_built_by_cmake(cpp, folder, tmp_path):
    """With stand-ins of ament and of the packages that it finds."""
    includes = ";".join(option.removeprefix("-I") for option in cpp[0].includes(folder)[2:])
    target = "add_library(rclcpp::rclcpp INTERFACE IMPORTED)\n"
    target += f"target_include_directories(rclcpp::rclcpp INTERFACE {includes})"
    for name in (
        "ament_cmake", "rclcpp", "ackermann_msgs", "diagnostic_msgs", "geometry_msgs", "nav_msgs", "sensor_msgs",
        "std_msgs", "tf2_ros",
    ):  # fmt: skip
        content = {"ament_cmake": "macro(ament_package)\nendmacro()", "rclcpp": target}.get(
            name, f"set({name}_TARGETS)"
        )
        (tmp_path / f"{name}Config.cmake").write_text(content + "\n")
    shutil.copytree(CPP, tmp_path / "package")
    shutil.copytree(
        folder, tmp_path / "package" / "controller", ignore=shutil.ignore_patterns("*.so", "*.o.d", "node*")
    )
    places = "-S", str(tmp_path / "package"), "-B", str(tmp_path / "build"), f"-DCMAKE_PREFIX_PATH={tmp_path}"
    run_program("cmake", *places)
    run_program("cmake", "--build", str(tmp_path / "build"))
    assert (tmp_path / "build" / "follower").exists()


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("options", [
    (),
    ("path_message", "autoware_planning_msgs/Trajectory"),
    ("pose_message", "tf", "motion_message", "geometry_msgs/TwistStamped"),
    ("pose_message", "geometry_msgs/PoseStamped", "motion_message", "geometry_msgs/TwistStamped",
     "drive_message", "autoware_control_msgs/Control"),
    ("path_message", "autoware_planning_msgs/Trajectory", "follow", "trajectory"),
])  # fmt: skip
def test_the_cpp_node_drives_a_car_on_stand_ins_of_rclcpp(cpp, folder, options, tmp_path):
    node = cpp[0].node(tmp_path, "trajectory") if "follow" in options else cpp[0].node(folder)
    report = dict(line.split("=", 1) for line in run_program(str(node), *options).splitlines() if "=" in line)
    assert int(report["commands"]) == pytest.approx(80, abs=2)
    assert (report["frame"], report["level"], report["message"]) == ("base_link", "0", "following")
    assert float(report["speed"]) > (3.5 if "path_message" in options else 4.5)
    assert abs(float(report["offset"])) < 0.1  # from 0.3 m
    assert int(report["stamp"]) in (1003, 1004)
    assert report["disengaged"] == "0"
    assert "follow" not in options or (report["fallback_level"], report["warning"]) == ("1", follower.ON_FALLBACK)
    assert float(report.get("at_rest", 0.0)) < 0.05
    assert (report["predicted"], report["path_frame"]) == ("30", "map")
    assert 0.05 < float(report["after"]) < 0.5
    assert 0.0 < float(report["first"]) < 3.0 + CAR.lr


# -- the package ------------------------------------------------------------------------------------------------------


@pytest.mark.compiled
def test_the_two_nodes_drive_each_other(monkeypatch):
    """On stand-ins of rclpy: what is published fits what is subscribed to, and the car leaves its place."""
    network = fake_ros(monkeypatch)
    modules = [package_module(name) for name in ("follower_node", "stand_in_node")]
    _, car = modules[0].FollowerNode(), modules[1].StandInNode()
    network.run(4.0)
    sent, status = network.sent["drive"][-1], network.sent["/diagnostics"][-1].status[0]
    assert sent.drive.speed > 0.0
    assert sent.header.stamp.sec == 1004 or sent.header.stamp.nanosec > 9e8
    assert (status.level, status.message) == (b"\x00", "following")
    assert car._car.state[3] > 2.0
    expected = network.sent["predicted_path"][-1]
    assert len(network.sent["predicted_path"]) == len(network.sent["drive"])
    assert (len(expected.poses), expected.header.frame_id) == (30, "map")
    assert expected.poses[0].pose.position.x > car._car.state[0]
    network.publish("engage", Record(data=False))
    before = len(network.sent["drive"])
    network.run(0.3)
    assert len(network.sent["drive"]) == before


@pytest.mark.compiled
def test_the_node_drives_by_tf_and_a_motion_and_sends_controls_of_autoware(monkeypatch):
    network = fake_ros(monkeypatch)
    network.parameters = {
        "pose_message": "tf", "motion_message": "geometry_msgs/TwistStamped", "speed_control": True,
        "drive_message": "autoware_control_msgs/Control",
    }  # fmt: skip
    module = package_module("follower_node")
    node = module.FollowerNode()
    network.publish("path", path(STRAIGHT))
    network.run(0.6)
    assert "no transform from base_link to map" in network.sent["/diagnostics"][-1].status[0].message
    assert network.sent["drive"][-1].longitudinal.acceleration == -Parameters().stop_deceleration
    for _ in range(6):
        network.transform = transform_stamped(network.now, x=20.0 + 5.0 * network.now - 5000.0)
        network.publish("motion", twist_stamped(network.now, 5.0))
        network.run(0.05)
    sent = network.sent["drive"][-1]
    assert messages.seconds(sent.stamp) == pytest.approx(network.now, abs=0.06)
    assert messages.seconds(sent.control_time) == pytest.approx(messages.seconds(sent.stamp) + node._follower.period)
    assert sent.longitudinal.velocity > 5.0
    assert sent.longitudinal.acceleration > 0.5  # towards 10 m/s
    monkeypatch.setitem(sys.modules, "autoware_control_msgs.msg", None)
    with pytest.raises(at.InvalidInput, match="package autoware_control_msgs is not installed: run sudo apt install"):
        module.FollowerNode()


@pytest.mark.compiled
def test_the_node_hands_fallbacks_over_and_warns_of_those_that_it_leaves_out(monkeypatch):
    network = fake_ros(monkeypatch)
    network.parameters = {"follow": "trajectory"}
    package_module("follower_node").FollowerNode()
    t = 0.1 * np.arange(50)
    braking = np.minimum(t, 6.0 / RATE)
    ways = {"no rest": 6.0 * t, "rest": 6.0 * braking - 0.5 * RATE * braking**2}
    for k in range(60):
        x = 6.0 * (network.now - 1000.0)
        if k % 2 == 0 and k < 30:
            for topic, way in (("fallback", ways["no rest" if k == 20 else "rest"]), ("path", ways["no rest"])):
                network.publish(topic, path(np.stack([x + way, 0.0 * t], axis=-1), network.now + t, t=network.now))
        network.publish("odom", odometry(network.now, x=x, speed=6.0))
        network.run(0.05)
    assert "fallback left out: it must end at rest, with a speed of 0 at its last point." in network.warnings
    assert network.warnings[-1] == follower.ON_FALLBACK
    status = network.sent["/diagnostics"][-1].status[0]
    assert (status.level, status.message) == (b"\x01", follower.ON_FALLBACK)


def test_nothing_moves_before_there_is_a_path_and_an_odometry(Follower):
    node = Follower()
    assert node.tick(0.0).stopping == "no path yet on topic path"
    node.path(path(STRAIGHT))
    command = node.tick(0.05)
    assert (command.speed, command.stopping) == (0.0, "no odometry yet on topic odom")
    assert node.diagnosis(0.05)[0] == follower.ERROR


def test_a_path_in_another_frame_stops_the_car(driving):
    driving.path(path(STRAIGHT + 1.0, frame="odom"))
    driving.pose(odometry(0.05, x=20.25, speed=5.0))
    assert driving.tick(0.05).stopping == "the path is in frame 'odom', the odometry in 'map'"


def test_an_export_by_a_file_that_cannot_be_used_ends_in_a_sentence(monkeypatch, tmp_path):
    pytest.importorskip("yaml")
    file, text = tmp_path / "follower.yaml", (PACKAGE / "config" / "follower.yaml").read_text()
    file.write_text(text.replace("follow: path", "follow: paths"))
    for words, says in (
        ([file, tmp_path], "export_controller: follow = 'paths': must be one of path, trajectory."),
        ([tmp_path / "none.yaml", tmp_path], "export_controller: .*No such file"),
        ([file, tmp_path, "aarch64"], "usage: python3 -m adaptrack_ros.export_controller follower.yaml FOLDER"),
    ):
        monkeypatch.setattr(sys, "argv", ["export_controller", *map(str, words)])
        with pytest.raises(SystemExit, match=says):
            package_module("export_controller").main()


def test_the_cpp_node_has_parameters_of_the_file_with_their_defaults():
    yaml = pytest.importorskip("yaml")
    defaults = yaml.safe_load((PACKAGE / "config" / "follower.yaml").read_text())["adaptrack_follower"][
        "ros__parameters"
    ]
    node = (CPP / "src" / "follower_node.cpp").read_text()
    header = (CPP / "include" / "adaptrack_ros_cpp" / "follower.hpp").read_text()
    header = header[header.index("struct Parameters") : header.index("struct Sample")]
    declared = set(re.findall(r'declare_parameter\("(\w+)"', node))
    assert declared - defaults.keys() == {"constants"}
    assert defaults.keys() - declared == {
        "vehicle",
        "profile",
        "command_delay",
        "oldest_sample",
        "speed_control",
    }  # of export
    for name, value in re.findall(r"^    [\w:]+ (\w+) = (.+?);", header, re.MULTILINE):
        assert yaml.safe_load(value) == defaults[name], name
