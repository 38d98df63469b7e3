"""The examples: the simulator drives, and what turns messages of ROS and transforms of CARLA into numbers is right."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace as Record

import pytest

import adaptrack as at
from foreign_loop import example

ROS, CARLA = example("ros2_node"), example("carla_follow")


def test_the_plain_simulator_drives(capsys):
    assert example("plain_simulator").main(seconds=12.0) < 0.03
    assert "RMS 0.0" in capsys.readouterr().out


def test_no_example_needs_what_it_is_for():
    assert not {"rclpy", "carla"} & sys.modules.keys()


# -- ROS 2 ------------------------------------------------------------------------------------------------------------
def odometry(yaw=0.0, x=0.0, y=0.0):
    return Record(
        header=Record(stamp=Record(sec=1_700_000_000, nanosec=250_000_000)),
        pose=Record(
            pose=Record(
                position=Record(x=x, y=y, z=3.0),
                orientation=Record(x=0.0, y=0.0, z=math.sin(0.5 * yaw), w=math.cos(0.5 * yaw)),
            )
        ),
        twist=Record(
            twist=Record(linear=Record(x=12.0, y=0.1, z=0.0), angular=Record(x=0.0, y=0.0, z=-0.2)),
        ),
    )


def test_a_stamp_is_seconds():
    assert ROS.stamp(odometry().header) == pytest.approx(1_700_000_000.25, abs=1e-6)


def test_an_odometry_is_a_sample():
    t, *rest = ROS.sample(odometry(yaw=-2.5, x=10.0, y=-4.0))
    assert t == ROS.stamp(odometry().header)
    assert rest == pytest.approx([10.0, -4.0, -2.5, 12.0, -0.2])


def test_an_odometry_of_the_rear_axle_is_one_of_the_centre_of_mass():
    assert ROS.BASE_LINK < 0.0
    _, x, y, *_ = ROS.sample(odometry(yaw=math.pi / 2, x=10.0, y=-4.0), -1.5)
    assert (x, y) == pytest.approx((10.0, -2.5))


def test_a_path_is_its_points():
    poses = [Record(pose=odometry(x=float(x), y=1.0).pose.pose) for x in range(5)]
    assert ROS.points(Record(poses=poses)) == [(float(x), 1.0) for x in range(5)]


# -- CARLA ------------------------------------------------------------------------------------------------------------
def transform(x, y, yaw):
    return Record(location=Record(x=x, y=y, z=0.0), rotation=Record(yaw=yaw, pitch=0.0, roll=0.0))


def test_what_is_to_the_right_in_carla_is_negative_here():
    """Heading 90 degrees clockwise, driving along +y of CARLA, turning clockwise."""
    given = CARLA.sample(2.0, transform(5.0, 7.0, 90.0), Record(x=0.0, y=8.0, z=0.0), Record(x=0.0, y=0.0, z=10.0))
    assert given == pytest.approx((2.0, 5.0, -7.0, -math.pi / 2, 8.0, -math.radians(10.0)))


def test_backwards_is_a_negative_speed():
    given = CARLA.sample(0.0, transform(0.0, 0.0, 180.0), Record(x=3.0, y=0.0, z=0.0), Record(x=0.0, y=0.0, z=0.0))
    assert given[4] == pytest.approx(-3.0)


@pytest.mark.parametrize(("angle", "steer"), [(math.radians(35.0), -0.5), (-math.radians(7.0), 0.1), (2.0, -1.0)])
def test_a_wheel_to_the_left_is_a_negative_steer(angle, steer):
    assert CARLA.steer(angle, 70.0) == pytest.approx(steer)


class Waypoint:
    """On a lane that bends to the right, radius 50 m."""

    def __init__(self, s):
        self.s = s
        self.transform = transform(50.0 * math.sin(s / 50.0), 50.0 * (1.0 - math.cos(s / 50.0)), math.degrees(s / 50.0))

    def next(self, way):
        return [Waypoint(self.s + way)]


def test_a_lane_that_bends_to_the_right_has_a_negative_curvature():
    road = CARLA.lane_ahead(Record(get_waypoint=lambda location: Waypoint(0.0)), None, length=60.0)
    assert road.length == pytest.approx(58.0, rel=1e-4)
    assert float(road.at(30.0).curvature) == pytest.approx(-0.02, rel=1e-3)


def test_a_car_of_carla_is_steered_to_its_lane():
    """To the left of the lane in CARLA is a smaller y: the wheels turn right, a positive steer."""
    road = at.Road.through([CARLA.position(Record(x=float(x), y=0.0)) for x in range(100)])
    tracker = at.Tracker(at.MPC(at.load_vehicle("midsize-sedan")), road)
    still = Record(x=0.0, y=0.0, z=0.0)
    told = tracker.step(*CARLA.sample(0.0, transform(20.0, -0.5, 0.0), Record(x=10.0, y=0.0, z=0.0), still))
    assert told.offset == pytest.approx(0.5)
    assert CARLA.steer(told.command, 70.0) > 0.0
