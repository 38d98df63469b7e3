"""What must hold in a drive, and the figures of its calmness.

    finite          all requests are finite
    limits          force between the brake limit and the traction limit, hold from 0 to the brake limit, acceleration
                    no more than these and gravity give
    error           no call is refused
    above plan      the car is not faster than the plan + 1 m/s; of the list cross for at most 2 s, then it slows down
    stop passed     no stop that was ahead and reachable is left behind before its time was over
    rolls back      the car does not roll back by more than 0.1 m (slopes to 12 %), 0.5 m (to 25 %), 1 m with a fault
                    of a sensor or a speed without sign
    leaves its hold the car does not move by more than 0.5 m while the state is `stopped`
    pushed on       the car does not gain 0.7 m/s while it is asked to brake or to hold
    stands for ever no standing for 20 s without a stop, a driver, a fault now or 3 s before
    stands by a fault  no standing for 20 s by a fault that is reported where no sensor contradicts another one
    starts blind    a car at rest does not drive off without a position
    false fault     no fault of brakes or drive is reported; both work

A plan counts within 1.5 m of the true place, 4 m once a sensor has failed. After a start, a driver, a new plan and a
gap of calls the car may be faster, but slows down with half of the braking of comfort at least. So it may where
the steering weaves, while the lateral acceleration leaves too little of the least assumed grip for the braking of
comfort: grip comes before stops and speeds. How many drives that excuses is counted.
"""

from __future__ import annotations

import math
from collections import Counter
from typing import NamedTuple

import numpy as np
import scipy

from adaptrack.control.speed_control import SpeedState
from adaptrack.core.physics.forces import GRAVITY
from tools.fuzz.speed.drives import PERIOD, Drive
from tools.fuzz.speed.ways import LIMITS, STATES, Answer
from tools.fuzz.speed.world import SPACING, World

OFF, WAITING = STATES.index(SpeedState.OFF), STATES.index(SpeedState.STOPPED)
EXCESS = 1.0
"""m/s, above the plan."""
CROSS_TIME = 2.0
"""s, for which a car with a fault of the list cross may be too fast."""
HANDOVER_TIME = 1.0
"""s, for which a car that was handed over may keep its acceleration."""
STANDS = 0.05
"""m/s."""
STAYING_DISTANCE = 40.0
"""m, beyond a stop without end on a lap, within which a car stays where it stands."""
BLIND_TIME = 0.6
"""s without a position, after which a car at rest must stay."""
BRAKE_TIME = 0.7
"""s, from a request to brake until the car slows down; it may gain 0.5 m/s meanwhile."""
STOP_WINDOW = (1.5, 3.0)
"""m, before and behind a stop, in which a car stands at it."""
FAULT_WINDOW = (4.0, 6.0)
"""The same once a sensor has failed."""
IDLE_TIME = 20.0
"""s, for which a car stands without a reason before it counts."""
RECOVERY_TIME = 3.0
"""s, after a fault of a sensor."""
LARGEST_TARGET = 100.0
"""m/s."""
DEAD_BAND = 0.02
"""Of the weight: forces within it are neither throttle nor brake."""
SETTLED = 10.0
"""s, after which the error of the speed counts."""
JUDGED = {"healthy", "visible"}
"""Lists in which a stop passed, a standing car or a false fault is a finding."""


class Finding(NamedTuple):
    """A claim that does not hold, when (s), and how."""

    claim: str
    time: float
    text: str


class Figures(NamedTuple):
    """Of one drive."""

    steps: int = 0
    seconds: int = 0
    """whole seconds that were driven without a driver"""
    busy_seconds: int = 0
    """of these: with more than one change between throttle and brake"""
    changes: int = 0
    jerk_square: float = 0.0
    """sum over the steps with a jerk, m^2/s^6"""
    jerk_steps: int = 0
    speed_square: float = 0.0
    speed_steps: int = 0
    worst_excess: float = 0.0
    """m/s, above the plan, of that only what is not excused"""
    excess_time: float = 0.0
    """s, the longest time faster than the plan + 1 m/s"""
    gripless_steps: int = 0
    """steps in which the lateral acceleration leaves too little grip for the braking of comfort"""
    stop_errors: tuple[float, ...] = ()
    """m, beyond the stops"""


class Judge:
    """Watches a drive."""

    def __init__(self, drive: Drive, world: World) -> None:
        self.drive, self.world = drive, world
        self.findings: list[Finding] = []
        self._claims: Counter[str] = Counter()
        self.is_faulty = bool(drive.episodes)
        self._fault_until = -math.inf
        self._steps = 0
        self._follow_state: dict[int, tuple[float, bool]] = {}
        self._stood: dict[int, float] = {}
        self._served: dict[int, bool] = {}
        self._excused: set[int] = set()
        self._measured: set[int] = set()
        self._route = -1
        self.shift = 0.0
        self._excess_speed, self._excused_since = 0.0, 0.0
        self._spell, self._spell_top = 0.0, 0.0
        self._peak, self._idle, self._rest = -math.inf, 0.0, math.nan
        self._braked, self._braked_speed = 0.0, 0.0
        self._sign, self._second, self._second_changes, self._driven = 0, 0, 0, 0
        self._before: float = math.nan
        self.sums = dict.fromkeys(Figures._fields[1:-1], 0.0)
        self.stop_errors: list[float] = []
        self.follow(0)
        self.excuse()

    # -- what changes -------------------------------------------------------------------------------------------------
    def follow(self, number: int) -> None:
        """Take note of another route."""
        route = self.drive.routes[number]
        shift = float(self.drive.routes[0].road.length - route.road.length) if number == 2 else 0.0
        old = self._places() if self._route >= 0 else []
        is_repeated = number == self._route
        self._route, self.shift, self._plan = number, shift, route.plan
        grid = np.arange(0.0, float(route.road.length) + SPACING, SPACING)
        speeds = route.plan.at(np.minimum(grid, float(route.road.length)))
        near, wide = (round(2 * (FAULT_WINDOW[0] if wide else STOP_WINDOW[0]) / SPACING) + 1 for wide in (0, 1))
        mode = "wrap" if route.road.closed else "nearest"
        self._tops = [scipy.ndimage.maximum_filter1d(speeds, size, mode=mode).tolist() for size in (near, wide)]
        self._speeds = speeds.tolist()
        stops = [(stop.s + shift, stop.seconds) for stop in route.plan.stops]
        ends = not route.road.closed and (not stops or stops[-1][0] < self.world.length - 1e-9)
        self._stops = [*stops, (shift + float(route.road.length), math.inf)] if ends else stops
        if is_repeated:
            return
        kept = {place: (self._stood.get(k, 0.0), self._served.get(k, False)) for k, place in old}
        self._stood, self._served = {}, {}
        self._measured.clear()
        for k, place in self._places():
            match = [state for other, state in kept.items() if abs(other - place) < 0.5]
            if match:
                self._stood[k], self._served[k] = match[0]
            elif place < self.world.station + 0.5:
                self._excused.add(k)
        self.excuse()

    def _places(self) -> list[tuple[int, float]]:
        """Numbers and places (m) of the stops about the car, of three laps."""
        count, length = len(self._stops), self.world.length
        if not self.world.closed:
            return [(k, place) for k, (place, _) in enumerate(self._stops)]
        lap = math.floor(self.world.station / length)
        return [
            (count * (lap + turn) + k, place + (lap + turn) * length)
            for turn in (-1, 0, 1)
            for k, (place, _) in enumerate(self._stops)
        ]

    def excuse(self) -> None:
        """Take the car as it is: too fast, and too near to some stops."""
        world = self.world
        self._excess_speed = world.speed + HANDOVER_TIME * max(world.acceleration, 0.0)
        self._excused_since = world.elapsed
        way = world.speed**2 / (1.4 * self.drive.comfort.brake) + world.speed + 2.0
        for k, place in self._places():
            if place - world.station < way and (world.speed > STANDS or place < world.station):
                self._excused.add(k)
        self._peak, self._spell, self._braked, self._rest = world.station, 0.0, 0.0, math.nan
        self._idle, self._backs = 0.0, world.speed < -STANDS

    def _excuse_lack_of_grip(self) -> None:
        """Excuse a car whose lateral acceleration leaves too little assumed grip for the braking of comfort."""
        world, grip = self.world, float(np.min(self.drive.variant.friction)) * GRAVITY
        if math.hypot(world.speed * world.yaw_rate, self.drive.comfort.brake) > grip:
            self.sums["gripless_steps"] += 1
            self.excuse()

    def drives_by_hand(self) -> None:
        """A driver drives: stops on the way are the driver's."""
        for k, place in self._places():
            if abs(place - self.world.station) < STOP_WINDOW[1]:
                self._served[k] = True
        self._rests_blind = False
        self.excuse()

    def sensor_fails(self) -> None:
        """A fault of a sensor is at work."""
        self._fault_until = self.world.elapsed

    def released(self) -> None:
        """The stops at the car are released."""
        for k, place in self._places():
            if abs(place - self.world.station) < FAULT_WINDOW[1]:
                self._served[k] = True

    # -- each step ----------------------------------------------------------------------------------------------------
    def top(self) -> float:
        """Planned speed (m/s) about the car."""
        place = self.world.station - self.shift
        length = self.world.length - self.shift
        tops = self._tops[1 if self._fault_until > -math.inf else 0]
        if self.world.closed:
            return tops[int((place % length) / SPACING)]
        return tops[min(max(int(place / SPACING), 0), len(tops) - 1)]

    def find(self, claim: str, text: str) -> None:
        """Note that a claim does not hold; of each claim the first time."""
        self._claims[claim] += 1
        if self._claims[claim] == 1:
            self.findings.append(Finding(claim, self.world.elapsed, text))

    def step(self, answer: Answer, is_driven: bool, has_position: bool) -> None:
        """Judge the answer of a call and the car of now."""
        self._steps += 1
        self._has_position = has_position
        self._between, self._last = self.world.elapsed - self._last, self.world.elapsed
        self._judge_requests(answer)
        if is_driven:
            self.drives_by_hand()
            self._sign, self._before, self._driven = 0, math.nan, 0
            return
        self._excuse_lack_of_grip()
        self._judge_speed(answer)
        self._judge_stops(answer)
        self._judge_rest(answer)
        self._note_calm(answer)

    def _judge_requests(self, answer: Answer) -> None:
        car = self.drive.car
        numbers = {"command": answer.command, "acceleration": answer.acceleration, "force": answer.force,
                   "hold": answer.hold, "target_speed": answer.target_speed, "grip_used": answer.grip_used}  # fmt: skip
        lost = [f"{name} = {value}" for name, value in numbers.items() if not math.isfinite(value)]
        if lost:
            self.find("finite", ", ".join(lost))
            return
        largest = 1.25 * max(car.traction_limit, car.brake_limit) / car.mass + GRAVITY
        if not -car.brake_limit - 1e-6 <= answer.force <= car.traction_limit + 1e-6:
            self.find("limits", f"force {answer.force:.6g} N of -{car.brake_limit:g} to {car.traction_limit:g} N")
        elif not 0.0 <= answer.hold <= car.brake_limit + 1e-6:
            self.find("limits", f"hold {answer.hold:.6g} N of 0 to {car.brake_limit:g} N")
        elif abs(answer.acceleration) > largest:
            self.find("limits", f"acceleration {answer.acceleration:.4g} m/s^2 of {largest:.3g}")
        elif not 0.0 <= answer.target_speed <= LARGEST_TARGET and LIMITS[answer.limited_by].name != "DRIVER":
            self.find("limits", f"target speed {answer.target_speed:.4g} m/s")

    def _judge_speed(self, answer: Answer) -> None:
        world, comfort = self.world, self.drive.comfort
        braked = 0.5 * comfort.brake * max(world.elapsed - self._excused_since - HANDOVER_TIME, 0.0)
        excess = world.speed - max(self.top(), self._excess_speed - braked)
        self.sums["worst_excess"] = max(self.sums["worst_excess"], excess)
        if excess <= EXCESS:
            self._spell = 0.0
            return
        self._spell += PERIOD
        self.sums["excess_time"] = max(self.sums["excess_time"], self._spell)
        text = f"{world.speed:.1f} m/s in a plan of {self.top():.1f} m/s for {self._spell:.1f} s ({answer.words})"
        if self.drive.kind in JUDGED:
            self.find("above plan", text)
        if self.drive.kind == "cross":
            late = self._spell - CROSS_TIME
            if late <= 0.0:
                self._spell_top = world.speed
            elif world.speed > self._spell_top + 0.5 - 0.5 * comfort.brake * max(late - BRAKE_TIME, 0.0):
                self.find("above plan", text)

    def _judge_stops(self, answer: Answer) -> None:
        world = self.world
        low, high = FAULT_WINDOW if self._fault_until > -math.inf else STOP_WINDOW
        stands, has_place = abs(world.speed) < STANDS, False
        nearest, best, self._stays = -1, math.inf, False
        for k, place in self._places():
            beyond = world.station - place
            is_near = self.world.closed <= (beyond < STAYING_DISTANCE)  # beyond the end of a path wherever it is
            self._stays |= beyond > -low and is_near and self._stops[k % len(self._stops)][1] == math.inf
            if beyond < -6.0 - low:
                self._served.pop(k, None)
                self._stood.pop(k, None)
                continue
            if beyond > high:
                if not self._served.get(k, False):
                    self._served[k] = True
                    if k not in self._excused and (world.closed or beyond < high + 20.0):
                        self._find_passed(k, place, answer)
                self._excused.discard(k)
                continue
            if -low <= beyond and not self._served.get(k, False) and abs(beyond) < best:
                nearest, best = k, abs(beyond)
        if nearest >= 0 and (stands or abs(world.speed) < 0.15):
            place, seconds = self._stops[nearest % len(self._stops)]
            place += (nearest // len(self._stops)) * world.length if world.closed else 0.0
            stood = self._stood.get(nearest, 0.0)
            if answer.state == WAITING and nearest not in self._measured and nearest not in self._excused:
                self._measured.add(nearest)
                self.stop_errors.append(world.station - place)
            self._stood[nearest] = stood + (self._between if stands else 1e-9)
            has_place = self._stood[nearest] < seconds + 1.0
            self._served[nearest] = self._stood[nearest] >= seconds + 1.0
            if seconds - 0.3 <= self._stood[nearest] < seconds + 1.0 and not stands:
                self._served[nearest] = True
        self._at_stop = has_place or self._stays or (nearest >= 0 and not stands)

    def _find_passed(self, k: int, place: float, answer: Answer) -> None:
        stood, seconds = self._stood.get(k, 0.0), self._stops[k % len(self._stops)][1]
        if stood > 0.0 and stood >= seconds - 0.3:
            return
        is_judged = self.drive.kind in JUDGED or self.world.elapsed - self._fault_until > 10.0
        if is_judged and self.drive.kind != "hidden":
            end = "the end" if seconds == math.inf and not self.world.closed else f"the stop at {place:.1f} m"
            text = f"{end} left behind at {self.world.speed:.1f} m/s, stood {stood:.1f} of {seconds:g} s"
            self.find("stop passed", f"{text} ({answer.words})")

    def _judge_rest(self, answer: Answer) -> None:
        world, drive = self.world, self.drive
        speed, stands = world.speed, abs(world.speed) < STANDS
        self._backs = self._backs and speed < -STANDS
        self._peak = world.station if self._backs else max(self._peak, world.station)
        back = self._peak - world.station
        steep = abs(world.grade(world.station)) > 0.12
        bound = 1.0 if self.is_faulty or not drive.sensors.is_signed else 0.5 if steep else 0.1
        if back > bound + 0.05:
            self.find("rolls back", f"{back:.2f} m on {world.grade(world.station):+.1%} ({answer.words})")
        if answer.state != WAITING:
            self._rest = math.nan
        elif math.isnan(self._rest):
            self._rest = world.station
        elif abs(world.station - self._rest) > 0.5:
            self.find("leaves its hold", f"{world.station - self._rest:+.2f} m ({answer.words})")
        self._judge_blind_start(answer)
        is_braking = answer.force <= 0.0 and answer.acceleration <= 0.0 and answer.hold - answer.force > 0.0
        self._braked = self._braked + PERIOD if is_braking else 0.0
        if self._braked < 1.5:
            self._braked_speed = abs(speed)
        elif abs(speed) > self._braked_speed + 0.7:
            self.find("pushed on", f"from {self._braked_speed:.1f} to {speed:.1f} m/s ({answer.words})")
        is_healthy = world.elapsed - self._fault_until > RECOVERY_TIME
        fault = LIMITS[answer.limited_by].name in ("BRAKE_FAULT", "DRIVE_FAULT")
        if fault and (drive.kind == "healthy" or self._fault_until == -math.inf):
            self.find("false fault", f"{answer.words} on {world.grade(world.station):+.1%}")
        fault |= LIMITS[answer.limited_by].name == "FAULT"
        if not stands or not is_healthy or self._at_stop or (fault and drive.kind not in JUDGED):
            self._idle = 0.0
            return
        self._idle += PERIOD
        if self._idle > IDLE_TIME and drive.kind != "hidden":
            claim = "stands by a fault" if fault else "stands for ever"
            self.find(claim, f"at {world.station:.1f} m of {world.length:.1f} on "
                      f"{world.grade(world.station):+.1%}, force {answer.force:.0f} N, hold {answer.hold:.0f} N "
                      f"({answer.words})")  # fmt: skip

    def _judge_blind_start(self, answer: Answer) -> None:
        if self._has_position:
            self._blind, self._rests_blind = 0.0, False
            return
        self._blind += self._between
        self._rests_blind |= self._blind > BLIND_TIME and abs(self.world.speed) < STANDS
        if self._rests_blind and self.world.speed > 0.5:
            self.find("starts blind", f"{self.world.speed:.1f} m/s, {self._blind:.1f} s without a position "
                      f"({answer.words})")  # fmt: skip

    def _note_calm(self, answer: Answer) -> None:
        if self.is_faulty:
            return
        sums, world = self.sums, self.world
        share = answer.force / (self.drive.car.mass * GRAVITY)
        sign = 1 if share > DEAD_BAND else -1 if share < -DEAD_BAND else 0
        if sign != 0:
            if sign == -self._sign:
                self._second_changes += 1
                sums["changes"] += 1
            self._sign = sign
        self._driven += 1
        if self._driven % round(1.0 / PERIOD) == 0:
            sums["seconds"] += 1
            sums["busy_seconds"] += self._second_changes > 1
            self._second_changes = 0
        is_driving = world.speed > 0.5 and answer.state not in (OFF, WAITING)
        if is_driving and self._before == self._before:
            sums["jerk_square"] += ((answer.acceleration - self._before) / PERIOD) ** 2
            sums["jerk_steps"] += 1
        self._before = answer.acceleration if is_driving else math.nan
        place = world.station - self.shift
        length = world.length - self.shift
        if (
            world.elapsed > SETTLED
            and world.elapsed - self._excused_since > SETTLED
            and world.closed | (place < length)
        ):
            planned = self._speeds[int((place % length if world.closed else max(place, 0.0)) / SPACING)]
            if planned > 1.0 and world.speed > 0.5:
                sums["speed_square"] += (world.speed - planned) ** 2
                sums["speed_steps"] += 1

    @property
    def figures(self) -> Figures:
        """Figures of the drive so far."""
        return Figures(self._steps, **self.sums, stop_errors=tuple(self.stop_errors))  # type: ignore[arg-type]

    _at_stop = _stays = _backs = _rests_blind = False
    _has_position, _blind = True, 0.0
    _between = _last = 0.0
    """s, from the call before to this one, and the time of this one"""
