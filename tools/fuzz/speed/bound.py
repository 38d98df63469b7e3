"""How many lines of the kernels a call runs through, whatever its times: a bound that no clock decides on.

The kernels are interpreted, and every line that they run is counted. A call that needs `LARGEST_RATIO` times as many
lines as an ordinary one counts as a call without a bound, and is ended there. An ordinary call is one control instant;
after a gap of 2 s there are forty.

    ADAPTRACK_KERNELS=interpreted python -m tools.fuzz.speed.bound
"""

from __future__ import annotations

import copy
import functools
import itertools
import math
import sys
from types import FrameType
from typing import Any

from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import PurePursuit
from adaptrack.control.speed_control import SpeedControl
from adaptrack.control.tracker import Tracker
from adaptrack.core.kernel import INTERPRETED
from adaptrack.road import Arc, Line, Road, SpeedPlan, Stop, plan_speed

CAR = load_vehicle("midsize-sedan")
LARGEST_RATIO = 50
TIMES = (1.7e18, -1.7e18, 1e300, -1e300, 1e10, 3600.0, -3600.0, 1.7e9, math.inf, 0.0)
"""s, of a call among calls from 0 s on."""
FIELDS = ("clock", "t", "now", "motion_time")
"""What is far: both stamps, or one of them."""
RADIUS, SPEED = 12.0, 5.0
"""m, m/s: of a lap, and on it."""
PERIOD, CALLS = 0.05, 12
"""s, and how many calls come before the one with a far time."""


class UnboundedCall(Exception):
    """A call that runs through too many lines."""


@functools.cache
def make_plan(closed: bool) -> tuple[Road, SpeedPlan]:
    """A lap or an open path with two stops, and the plan of its speed."""
    lap = Arc(length=2.0 * math.pi * RADIUS, curvature=1.0 / RADIUS)
    road = Road.from_segments([lap if closed else Line(length=195.0)], closed=closed)
    return road, plan_speed(road, CAR, stops=[Stop(40.0, 1.0), Stop(60.0, 1.0)], top_speed=SPEED)


def make_tracker(closed: bool, driver: bool) -> Tracker:
    """A tracker on a lap or an open path, after `CALLS` calls."""
    road, plan = make_plan(closed)
    tracker = Tracker(PurePursuit(CAR, period=PERIOD), road, plan=plan, speed=SpeedControl(CAR))
    for k in range(CALLS):
        step(tracker, k, driver)
    return tracker


def step(tracker: Tracker, number: int, driver: bool, is_lost: bool = False, **times: float) -> None:
    """Make a call of a car that drives along the path."""
    foot = tracker.path.at(SPEED * PERIOD * number)
    pose = (math.nan,) * 3 if is_lost else (float(foot.x), float(foot.y), float(foot.heading))
    stamps: Any = {"t": PERIOD * number, **times}
    tracker.step(stamps.pop("t"), *pose, SPEED, 0.0, driver=driver, **stamps)


def count_lines(call: Any, most: float = math.inf) -> int:
    """Lines of Python that a call runs through; `UnboundedCall` beyond the most."""
    count = 0

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal count
        count += event == "line"
        if count > most:
            raise UnboundedCall
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    finally:
        sys.settrace(before)
    return count


def unbounded_calls(times: tuple[float, ...] = TIMES, laps: tuple[bool, ...] = (True, False)) -> list[str]:
    """Calls with one far time that run through too many lines, in words; needs interpreted kernels."""
    assert INTERPRETED
    found = []
    for closed, driver in itertools.product(laps, (True, False)):
        tracker = make_tracker(closed, driver)
        usual = count_lines(functools.partial(step, copy.deepcopy(tracker), CALLS, driver))
        for field, time, is_lost in itertools.product(FIELDS, times, (True, False)):
            if field in ("clock", "now") and not math.isfinite(time):
                continue
            twin, stamps = copy.deepcopy(tracker), {"t" if field == "clock" else field: time}
            if field == "t":
                stamps["now"] = PERIOD * CALLS
            try:
                for k, far in ((CALLS, stamps), (CALLS + 1, {})):
                    count_lines(functools.partial(step, twin, k, driver, is_lost, **far), LARGEST_RATIO * usual)
            except UnboundedCall:
                way = "a lap" if closed else "an open path"
                found.append(f"{field} = {time:g} s on {way}, driver {driver}, position lost {is_lost}")
    return found


if __name__ == "__main__":
    calls = unbounded_calls()
    print("\n".join(calls) or "all calls are bounded")
    sys.exit(int(bool(calls)))
