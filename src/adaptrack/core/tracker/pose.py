"""Pose of the car: carried by its motion, and against its path; and what a tracker holds of it.

A pose is any record with x, y (m) and yaw (rad): the memory of a tracker, a sample.
"""

from __future__ import annotations

import math

from ..controllers.contract import wrapped
from ..estimators.learning import KNOWN_DELAY_SIGMA
from ..kernel import fields_of, inlined, packer, record
from ..maths.exact import clip
from ..maths.trigonometric import cos, sin
from ..roads.road import CLOSED, LENGTH, foot_near, line_of, nearest, point_at
from .records import ACROSS_PENALTY, REQUEST
from .signals import HELD, MAX_POSITION, NO_BELIEF, TRACKED

_write_answer = packer(record("Answer", fields_of(TRACKED)[: TRACKED.suspect]))


@inlined
def carried(pose, time, speed, yaw_rate):
    """x, y (m) and yaw (rad) of a pose after a time (s) on an arc."""
    middle, way = pose.yaw + 0.5 * time * yaw_rate, time * speed
    return pose.x + way * cos(middle), pose.y + way * sin(middle), pose.yaw + time * yaw_rate


@inlined
def has_position(m):
    """Whether the sample at hand has a position and its time."""
    return math.isfinite(m.sample.t + (m.sample.x + m.sample.y + m.sample.yaw))


@inlined
def forward(m):
    """m/s, the speed of a car that does not drive backwards."""
    return max(m.speed, 0.0)


@inlined
def time_of(m, period):
    """s, of the present instant."""
    return m.began + m.instant * period


# -- the path ---------------------------------------------------------------------------------------------------------
@inlined
def line(tracker):
    """The centre line of the path."""
    return line_of(0 if has_path(tracker) else -1, tracker.path)


@inlined
def has_path(tracker):
    """Whether there is a path."""
    return len(tracker.path.pieces) > 0


@inlined
def path_errors(tracker, x, y, yaw, near):
    """Offset (m) and heading error (rad) of a pose, by its foot about an arc length (m); NaN without a foot."""
    _, offset, heading, _ = foot_near(x, y, near, line(tracker))
    return offset, wrapped(yaw - heading) if offset == offset else math.nan


@inlined
def hint(m, near):
    """Keep the arc length (m) about which the car is to be found; none where it is none of a path."""
    m.near = near if abs(near) < MAX_POSITION else math.nan


@inlined
def find_on_path(tracker, m):
    """The foot from which the car begins to follow its path, the nearest one in its direction."""
    centreline = line(tracker)
    m.station = nearest(m.x, m.y, m.yaw, ACROSS_PENALTY, m.near, centreline)
    _, _, m.heading, _ = point_at(m.station, centreline)
    m.offset, m.heading_error = path_errors(tracker, m.x, m.y, m.yaw, m.station)
    m.near = math.nan


@inlined
def is_beyond(tracker, station):
    """Whether an arc length is beyond the end of an open path."""
    numbers = tracker.path.numbers
    return numbers[0, CLOSED] < 0.5 and station > numbers[0, LENGTH]


# -- what is held -----------------------------------------------------------------------------------------------------
@inlined
def hold(tracker, m, angle):
    """Let an angle (rad) be the command before, as far as the controller's limits go."""
    settings = tracker.settings[0]
    m.command = clip(angle, settings.angle_min, settings.angle_max)


@inlined
def begin_anew(tracker, m, angle):
    """Forget the past, from an angle (rad) that the wheels have."""
    tracker.request[REQUEST.restart], tracker.request[REQUEST.change] = 1.0, 0.0
    hold(tracker, m, angle)
    m.started, m.last, m.between = 0, -math.inf, tracker.settings[0].period
    m.instant, m.due, m.first, m.predicted = 0, 0, 0, 0
    m.status, m.jumps, m.newest = HELD, 0, -math.inf
    m.speed, m.yaw_rate = math.nan, 0.0
    m.x = m.y = m.yaw = math.nan
    m.placed_x = m.placed_y = m.placed_yaw = math.nan
    m.placed_t = -math.inf
    m.station = m.heading = m.turned = m.aside = 0.0
    m.belief_state, m.belief_at_bound = NO_BELIEF, NO_BELIEF
    m.offset = m.heading_error = math.nan


@inlined
def restart(tracker, m):
    """Forget the past but the command and the speed."""
    speed = m.speed
    begin_anew(tracker, m, m.command)
    m.speed = speed


@inlined
def _first_top_speed(tracker, m):
    """Top speed (m/s) of a car that is not learned yet; it ends for good once the delay of its steering is learned."""
    first = tracker.settings[0].first_top_speed
    if m.started > 0 and m.delay_sigma < KNOWN_DELAY_SIGMA:
        m.ended_top_speed = first  # constants of a different learner bring a different speed
    return math.inf if m.ended_top_speed == first else first


@inlined
def write_tracked(tracker, m):
    """Write the answer of a call, see TRACKED; a call that was left out repeats the one before."""
    tracked = tracker.tracked
    _write_answer(tracked, 0, m)
    if m.rejection > 0:
        tracked[TRACKED.status] = m.rejection
    if m.offset != m.offset:
        tracked[TRACKED.station] = math.nan
    tracked[TRACKED.first_top_speed] = _first_top_speed(tracker, m)
