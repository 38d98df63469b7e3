"""The contract of a compiled controller, and what our own laws share: limits and the geometry of y_ref(t).

A law is one function, called once per control period:

    law(situation, reference, road, tuning, parameters, memory, answer) -> None

all but `road` float64, one-dimensional and C-contiguous:

    situation   (6,) measurements and the last command, see `SITUATION`
    reference   (n,), n >= 1: y_ref (m) now and at the control instants that follow, one period apart; without preview
                its present value alone, once or repeated
    road        the centre line, the arc length of the car's foot on it and the planned speeds
                (`core.roads.road.RoadAheadRecord`); without pieces and speeds where the road is straight
    tuning      the law's named tuning entries: they may change at every step
    parameters  constant numbers, which begin with `COMMON_PARAMETERS`
    memory      the law's own state, zeros before the first step
    answer      [steering command (rad), then the law's named diagnostics]

A law writes to memory and answer only. It keeps its command within the limits on angle and move, and answers a finite
command on finite input; on input that is not finite it holds the last command and says so in a diagnostic. Axes and
signs are those of ISO 8855: y, yaw and steering are positive to the left. On a curved road y and yaw count from the
path, and y_ref is an offset from it.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

from ..kernel import Caller, Field, inlined, packer, record, unpacker, vector, viewer, void
from ..maths.bits import whole
from ..maths.exact import clip, fmod, sqrt, square
from ..maths.trigonometric import atan2, cos, sin
from ..member import member
from ..models.contract import PERIOD_FIELD
from ..roads.road import RoadAheadRecord, point_at

SITUATION = (
    "vy",  # m/s, measured lateral velocity
    "yaw",  # rad, measured
    "yaw_rate",  # rad/s, measured
    "y",  # m, measured lateral position
    "speed",  # m/s, v_x
    "command",  # rad, the last command
)
ANGLE_LIMITS = (
    Field("angle_min", "rad", -math.inf, "smallest command; -inf: any", "[-inf, 0]"),
    Field("angle_max", "rad", math.inf, "largest command; inf: any", "[0, inf]"),
)
MOVE_LIMITS = (
    Field("move_min", "rad per period", -math.inf, "smallest change of the command", "[-inf, 0]"),
    Field("move_max", "rad per period", math.inf, "largest change of the command", "[0, inf]"),
)
COMMON_PARAMETERS = (PERIOD_FIELD, *MOVE_LIMITS, *ANGLE_LIMITS)
"""What the parameters of every law begin with."""

LAW_SIGNATURE = void(vector, vector, RoadAheadRecord, vector, vector, vector, vector)
"""``law(situation, reference, road, tuning, parameters, memory, answer)``."""
call_law = Caller(LAW_SIGNATURE)

MIN_LAW_SPEED = 1.0
"""m/s: below it the heading of y_ref(t) is ill-defined, and laws work as at this speed."""
STANDSTILL_SPEED = 0.1
"""m/s: a slower car stands"""
MOST_LATERAL = 9.81
"""m/s^2: the curvature of a kink in the reference counts as one that is driven with this lateral acceleration."""
MAX_REFERENCE_PERIODS = 1e6
"""periods, how far ahead a reference is read at most"""

Situation = record("Situation", SITUATION)
read_situation, write_situation = unpacker(Situation), packer(Situation)
Direction = record("Direction", ("heading",))
"""What the memory of a law begins with whose path is straight while the car stands: the last heading of it (rad)."""
direction_of = viewer(Direction)
Path = record("Path", ("x", "y", "heading", "curvature"))


@lru_cache(maxsize=64)
def compile_law(function: Any) -> Any:
    """A user's law as a member of `LAW_SIGNATURE`."""
    return member(function, LAW_SIGNATURE)


@inlined
def all_finite(values):
    """Whether every entry is finite."""
    finite = True
    for value in values:
        finite = finite and math.isfinite(value)
    return finite


@inlined
def limited(angle, s, p):
    """The command (rad) nearest to the wanted one within the limits on move and angle, and 1.0 where it is held.

    s: the situation; p: any record with the fields of `COMMON_PARAMETERS`. A wanted command that is not finite holds
    the last one; a last one that is not finite counts as 0. A standing car's wheels stay at rest.
    """
    last = s.command
    start = last if math.isfinite(last) else 0.0
    invalid = not math.isfinite(angle)
    move = 0.0 if invalid or abs(s.speed) < STANDSTILL_SPEED else clip(angle - start, p.move_min, p.move_max)
    return clip(start + move, p.angle_min, p.angle_max), 1.0 if invalid else 0.0


@inlined
def wrapped(angle):
    """The angle (rad) less whole turns, in [-pi, pi]; NaN unless it is finite."""
    if not math.isfinite(angle):
        return math.nan
    remainder = fmod(abs(angle), 2.0 * math.pi)
    if remainder > math.pi:
        remainder -= 2.0 * math.pi
    return remainder if angle >= 0.0 else -remainder


@inlined
def reference_at(reference, i):
    """y_ref (m) at the i-th instant; beyond its end it goes straight on."""
    last = reference.size - 1
    if i <= last:
        return reference[i]
    slope = reference[last] - reference[last - 1] if last > 0 else 0.0
    return reference[last] + (i - last) * slope


@inlined
def path_at(reference, road, time, speed, period):
    """The path at a speed (m/s), `time` (s) ahead: x, y (m), heading (rad), curvature (1/m).

    x and y count from the foot of the car along and across the road. The path is what y_ref(t) draws beside the road:
    heading = atan2(dy/dt, v), curvature = (d^2y/dt^2)/v^2/(1 + (dy/dt/v)^2)^(3/2), both of the parabola through three
    successive samples and added to those of the road there; v is `MIN_LAW_SPEED` at least.
    """
    v = max(speed, MIN_LAW_SPEED)
    steps = clip(time / period, 0.0, MAX_REFERENCE_PERIODS)
    i = whole(steps)
    s = steps - i
    current, following = reference_at(reference, i), reference_at(reference, i + 1)
    later = reference_at(reference, i + 2)
    bend = later - 2.0 * following + current
    slope = following - current - 0.5 * bend
    y = current + s * (slope + 0.5 * s * bend)
    rate = (slope + s * bend) / period
    steepness = rate / v
    longer = 1.0 + steepness * steepness
    curvature = bend / square(period * v) / (longer * sqrt(longer))
    tightest = MOST_LATERAL / (v * v)
    x, heading, curvature = v * time, atan2(rate, v), clip(curvature, -tightest, tightest)
    if road.line.start.size == 0:
        return Path(x, y, heading, curvature)
    return _shift_to_curve(road, x, Path(x, y, heading, curvature))


@inlined
def _shift_to_curve(road, distance, path):
    """A path beside a straight road, at a distance (m) along it, laid beside the curved one."""
    x, y, heading, curvature = point_at(road.station + distance, road.line)
    x0, y0, heading0, _ = point_at(road.station, road.line)
    c, s, turned = cos(heading0), sin(heading0), heading - heading0
    ahead, aside = (x - x0) * c + (y - y0) * s, (y - y0) * c - (x - x0) * s
    return Path(
        ahead - path.y * sin(turned), aside + path.y * cos(turned), path.heading + turned,
        path.curvature + curvature / max(1.0 - curvature * path.y, 0.1),
    )  # fmt: skip


@inlined
def planned_speed(road, time, speed, period):
    """The speed (m/s, `MIN_LAW_SPEED` at least) planned for `time` (s) ahead, shifted so that it is `speed` now.

    Where no plan is known, as on a straight road, the present speed.
    """
    last = road.speeds.size - 1
    if last < 0:
        return max(speed, MIN_LAW_SPEED)
    i = min(whole(clip(time / period, 0.0, MAX_REFERENCE_PERIODS)), last)
    return max(road.speeds[i] - road.speeds[0] + speed, MIN_LAW_SPEED)


@inlined
def left_of(path, x, y):
    """How far (m) the path lies to the left of a point; beside a straight road only y counts."""
    return (path.y - y) * cos(path.heading) - (path.x - x) * sin(path.heading)


@inlined
def path_ahead(reference, road, time, speed, period, memory):
    """`path_at`; below `MIN_LAW_SPEED` a straight line in the last known `Direction`, with which the memory begins."""
    path = path_at(reference, road, time, speed, period)
    if road.line.start.size > 0:
        return path
    direction = direction_of(memory, 0)
    if speed < MIN_LAW_SPEED:
        return Path(path.x, path.y, direction.heading, 0.0)
    if math.isfinite(path.heading):
        direction.heading = path.heading
    return path
