"""The speed to drive at along a plan, with its stops, for a loop that regulates the speed itself.

A plan is a speed at each arc length, and 0 at a stop alone. So a loop that looks ahead misses the stop, and a car that
stands exactly there never leaves. A `SpeedTarget` remembers which stop is next, and since when the car stands.
"""

from __future__ import annotations

import math

from adaptrack.core.tracker.records import STANDSTILL_SPEED
from adaptrack.road import SpeedPlan, Stop

AT_STOP = 0.25
"""m, of a standing car from a stop that counts as reached; and how far ahead of a stop a car looks that leaves it."""
OVERSHOT = 3.0
"""m, of a car that is stopping already from the stop of another plan that counts as the same stop."""
RELOCATION = 20.0
"""m, beyond the last and the next stop, from which on the car has been moved rather than driven."""


class SpeedTarget:
    """Target speed along a plan: 0 from a stop on until the car has stood there for the time of the stop."""

    def __init__(self, plan: SpeedPlan) -> None:
        self._stopping, self._since = False, math.nan  # s, since when the car has been standing at the next stop
        self.follow(plan)

    def follow(self, plan: SpeedPlan) -> None:
        """Go over to another plan; a car that is stopping for a stop of both goes on stopping."""
        self._plan, self._left, self._next = plan, math.nan, Stop(math.nan)

    def at(self, time: float, station: float, speed: float, period: float) -> float:
        """m/s, planned one period (s) ahead of the car's arc length (m), at its speed (m/s); NaN: no place to go by."""
        if not math.isfinite(station):
            return math.nan
        if not self._left - RELOCATION < station < self._next.s + RELOCATION:
            self._begin(station)
        place = station + max(speed, 0.0) * period
        stands = speed < STANDSTILL_SPEED and station >= self._next.s - AT_STOP
        if stands or place >= self._next.s:
            self._stopping = True
            if stands and not self._since <= time:
                self._since = time
            if not time - self._since >= self._next.seconds:
                return 0.0
            self._stopping, self._since, self._left = False, math.nan, self._next.s
            self._next = self._stop_beyond(self._left + 1e-6)
        launch = self._left + min(AT_STOP, 0.5 * (self._next.s - self._left))
        return float(self._plan.at(max(place, launch)))

    def _begin(self, station: float) -> None:
        """Look for the next stop of a car that has not been driven along this plan."""
        self._left, self._next = station, self._stop_beyond(station - (OVERSHOT if self._stopping else 0.0))
        if self._next.s > station + OVERSHOT:
            self._stopping, self._since = False, math.nan

    def _stop_beyond(self, place: float) -> Stop:
        """The first stop beyond an arc length (m) over all laps; infinitely far without one."""
        lap = float(self._plan.s[-1])
        stops = [
            stop._replace(s=stop.s + (math.floor((place - stop.s) / lap) + 1) * lap) if self._plan.closed else stop
            for stop in self._plan.stops
        ]
        return min((stop for stop in stops if stop.s > place), default=Stop(math.inf))
