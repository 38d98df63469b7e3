"""Which inputs of a loop contradict each other: sign, unit, frame, clock; and whether the car slides.

What a loop measures is redundant: positions move along the yaw by the speed, the yaw changes by the yaw rate, the car
turns as its steering asks. Each such relation is a linear regression on windows of half a second; of its parameters
some are honest (1, a little beside it), some are known mistakes (-1, 57.3, 1/3.6, 0.2 s). A mistake is named when it
explains what was measured better than every honest value, by `EVIDENCE` in twice the logarithm of the likelihood ratio
(A. Wald, *Sequential Analysis*, 1947), with overlapping windows counted once and the noise at least as large as what
the mistake itself leaves unexplained. Old windows are forgotten over `MEMORY`.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.vehicle import Vehicle

Array = NDArray[np.float64]

TICK, WINDOW, HISTORY = 0.095, 4, 14
"""s, between two looks at the samples; looks that a window spans, and that are kept."""
LONGEST = 1.2
"""s, of a window; after a gap the comparison goes on behind it."""
MEMORY = 12.0
"""s, after which a window counts 1/e."""
EVIDENCE, SOON, SURE, AGAIN = 12.0, 9.0, 5.0, 2
"""-, see above; of mistakes that nothing honest looks like; where other measurements point there too; looks in a row at
which it must be there."""
SLOW, GENTLE, ROUGH, STEEP = 3.0, 2.5, 5.0, 6.0
"""m/s: slower, nothing is compared; m/s^2, lateral: of what says which point of the car is measured, of what says that
frames differ, and beyond which no car need turn as it is steered."""
DELAYS, LAG = np.arange(0.0, 0.61, 0.1), 0.15
"""s, that are tried between a command and the turning of the car, behind a lag."""
POSITION, YAW = 0.045, 0.005
"""m, rad, noise of a difference of two samples."""
ASKEW, TURNED = 0.1, 0.3
"""rad: beside what sideslip explains, positions that move further beside the yaw are of another frame; that the yaw
must have changed before both are known to agree."""
SLIDING, NOT_SLIDING, SLIDES = math.radians(8.5), math.radians(5.0), math.radians(4.5)
"""Sideslip from which the car slides, below which it no longer does, and of it what a rolling turn does not explain."""
RELEASE = 0.5
"""s, for which the sideslip must be small before the sliding is over."""
DEGREE = math.pi / 180.0
ALL = slice(None)


class _Hypothesis(NamedTuple):
    label: str
    """empty: honest"""
    parameters: tuple[float, ...]


class Finding(NamedTuple):
    """What a comparison of inputs found."""

    compared: str
    seconds: float
    """of driving that could be compared"""
    label: str
    """the mistake that explains best what was measured; empty: an honest value does, or too little was measured"""


class _Comparison:
    """A regression y = sum b_i x_i + intercept under given hypotheses of b."""

    def __init__(self, compared: str, hypotheses: Iterable[_Hypothesis], overlap: int, intercept: float = 0.0,
                 evidence: float = EVIDENCE) -> None:  # fmt: skip
        """intercept: its standard deviation, in the unit of y."""
        given = list(hypotheses)
        self.compared, self.labels = compared, [each.label for each in given]
        self.overlap, self.intercept, self.evidence = overlap, intercept, evidence
        self.rows = np.array([(*each.parameters, -1.0) for each in given])
        self.honest = np.array([not label for label in self.labels])
        size = self.rows.shape[1] + 1
        self.gram, self.full = np.zeros((size, size)), np.ones(size)
        self.seconds, self.count, self.repeated, self.usual, self.label = 0.0, 0.0, 0, 0, ""
        self.sooner: frozenset[str] = frozenset()
        """mistakes for which `SOON` is enough"""

    def add(self, x: Sequence[float] | Array, y: float, noise: float, time: float, sure: bool = False) -> str:
        """Take in a window; the mistake that is now certain, or nothing.

        time: s, since the last window; sure: whether what else is measured makes a mistake likely.
        """
        self.full[:-2], self.full[-2] = x, y
        each, left = self.full / noise, math.exp(-time / MEMORY)
        self.gram *= left
        self.gram += each[:, None] * each
        self.seconds, self.count = self.seconds + time, self.count * left + 1.0
        least = SURE if sure else SOON if self.sooner else self.evidence
        if self.misfits([self.usual])[0] < least * self.overlap:  # no mistake can be better by so much
            self.repeated = 0
            return self.label
        misfits = self.misfits()
        self.usual = int(np.argmin(np.where(self.honest, misfits, np.inf)))
        best = int(np.argmin(np.where(self.honest, np.inf, misfits)))
        better = (misfits[self.usual] - misfits[best]) / (self.overlap * max(1.0, misfits[best] / self.count))
        enough = least if sure or self.labels[best] in self.sooner else self.evidence
        self.repeated = self.repeated + 1 if better > enough else 0
        if self.repeated >= (1 if sure else AGAIN):
            self.label = self.labels[best]
        return self.label

    def misfits(self, which: slice | list[int] = ALL) -> Array:
        """Of hypotheses, squares over the noise's."""
        gram, rows = self.gram[:-1, :-1], self.rows[which]
        if self.intercept > 0.0:
            sums = self.gram[:-1, -1]
            gram = gram - sums[:, None] * sums / (self.gram[-1, -1] + 1.0 / self.intercept**2)
        return np.asarray(((rows @ gram) * rows).sum(axis=1))


class _Delayed(_Comparison):
    """One with a bank of delays, y = b_i x_i + c_i h_i + intercept, with a free c_i for what was before the beginning.

    x are what was requested by each delay, with the first command as it was before the beginning, then the same with
    its negative, for negative b; h the share of what was before the beginning.
    """

    UNKNOWN = 0.15
    """Standard deviation of c, in the unit of y."""

    def __init__(self, compared: str, factors: dict[str, tuple[float, ...]], *more: float) -> None:
        n = DELAYS.size
        given = [(label, factor, i) for label, some in factors.items() for factor in some for i in range(n)]
        self.factor = np.array([factor for _, factor, _ in given])
        self.place = np.array([i if factor >= 0.0 else n + i for _, factor, i in given])
        self.free = np.array([2 * n + i for _, _, i in given])
        super().__init__(compared, [_Hypothesis(label, (0.0,) * 3 * n) for label, _, _ in given], 2, *more)

    def misfits(self, which: slice | list[int] = ALL) -> Array:
        gram, factor, place, free = self.gram, self.factor[which], self.place[which], self.free[which]
        own = factor**2 * gram[place, place] - 2.0 * factor * gram[place, -2] + gram[-2, -2]
        p, q = factor * gram[place, free] - gram[-2, free], factor * gram[place, -1] - gram[-2, -1]
        a, c = gram[free, free] + 1.0 / self.UNKNOWN**2, gram[-1, -1] + 1.0 / self.intercept**2
        b = gram[free, -1]
        return np.asarray(own - (c * p * p - 2.0 * b * p * q + a * q * q) / (a * c - b * b))


class _Tick(NamedTuple):
    """The car at a look, and means and changes since the look before."""

    t: float
    time: float
    x: float
    y: float
    yaw: float
    speed: float
    turned: float
    """rad, of the yaw"""
    way: float
    """m, by the speed"""
    yaw_rate: float
    vy: float
    pull: float
    wheel: float


@dataclass
class _Sums:
    """Integrals since the last look."""

    time: float = 0.0
    values: list[float] = field(default_factory=lambda: [0.0] * 5)

    def add(self, before: Sequence[float], now: Sequence[float], time: float) -> None:
        self.time += time
        for i, (a, b) in enumerate(zip(before, now, strict=True)):
            self.values[i] += 0.5 * (a + b) * time


def _grid(label: str, *values: Iterable[float]) -> list[_Hypothesis]:
    return [_Hypothesis(label, each) for each in itertools.product(*values)]


NEAR_ONE = (0.85, 0.95, 1.0, 1.05, 1.15)
GAINS = (0.25, 0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.2, 3.2)
"""Of turning over what the believed car's steering asks for, that need not surprise."""


FRAMES: dict[str, Callable[[float], float]] = {
    "yaw is in degrees; give it in radians.": lambda yaw: yaw * DEGREE,
    "y is mirrored against yaw (a left-handed frame, such as NED?); give x, y, yaw and yaw_rate in axes with y and "
    "angles positive to the left.": lambda yaw: -yaw,
    "yaw is counted clockwise from north (y); give it anticlockwise from x: pi/2 - yaw.":
        lambda yaw: 0.5 * math.pi - yaw,
    "yaw is counted clockwise from north, in degrees; give pi/2 - yaw pi/180.":
        lambda yaw: 0.5 * math.pi - yaw * DEGREE,
    "yaw is a quarter of a turn too large; count it from x.": lambda yaw: yaw - 0.5 * math.pi,
    "yaw is a quarter of a turn too small; count it from x.": lambda yaw: yaw + 0.5 * math.pi,
    "yaw is half a turn off; give the direction of the car's front.": lambda yaw: yaw + math.pi,
}  # fmt: skip
"""Mistakes of the yaw, and the direction of motion that they would mean."""
SIGN = "its sign is wrong; give it positive to the left."
_AGAINST: dict[str, tuple[float, ...]] = {"sign": (-0.4, -0.7, -1.0, -1.5, -2.5)}
KNOWN_CAR: dict[str, tuple[float, ...]] = {
    "": GAINS,
    "the car hardly turns, as if it were taken in degrees or not at all; give the actuator radians at the road wheels.":
        (0.0, DEGREE, 0.05),
    "the car turns many times as much, as if it were sent in degrees, or at the steering wheel; give the actuator "
    "radians at the road wheels.": (8.0, 15.0, 30.0, 57.3),
} | _AGAINST  # fmt: skip
UNKNOWN_CAR = {"": (0.02, 0.05, 0.1, *GAINS, 6.0, 12.0, 24.0, 50.0)} | _AGAINST
WHEELS: dict[str, tuple[float, ...]] = {
    "": NEAR_ONE,
    "the steering takes the command with the other sign, or wheel_angle has it; both are positive to the left.": (
        -1.0,
    ),
    "it is in degrees; give rad.": (57.3,),
    "it is the angle of the steering wheel; give that of the road wheels.": (11.0, 14.0, 17.0, 20.0),
}
"""Gains of turning, or of wheels, over the command: honest, and mistakes."""


class InputCheck:
    """Compares the inputs of a loop with each other as they come.

    vehicle: the car as believed; without one only signs and units are compared that need no car. period: s, of the
    loop, for the unit of its time; NaN: not known.
    """

    def __init__(self, vehicle: Vehicle | None = None, period: float = math.nan) -> None:
        self.vehicle, self.period = vehicle, period
        self.suspect: tuple[str, ...] = ()
        self.against_steering = False
        """whether the car turns against its commands"""
        self.sliding, self.sideslip = False, 0.0
        """whether the car slides; its sideslip (rad), NaN where it is not known"""
        self._relations = _relations(vehicle)
        self._labels: set[str] = set()
        self._ticks: deque[_Tick] = deque(maxlen=HISTORY)
        self._requested: deque[tuple[float, float, float]] = deque(maxlen=40)  # time, integrals of turning and command
        self._sums = _Sums()
        self._last: tuple[float, ...] = ()
        self._began = self._command = self._lagged = 0.0
        self._first = 0.0, 0.0
        self._t = self._now = self._tick = -math.inf
        self._pose: tuple[float, ...] = ()
        self._askew = self._steps = self._degrees = 0
        self._calm, self._slips, self._jumped = 0.0, 0, False
        self._mounting, self._straight = 0.0, 0
        self._origin, self._confirmed = math.nan, False
        self._agreed, self._range = 0, [math.inf, -math.inf]
        self._courses: deque[tuple[float, float]] = deque(maxlen=10)

    @property
    def findings(self) -> tuple[Finding, ...]:
        """What each comparison found."""
        return tuple(Finding(each.compared, each.seconds, each.label) for each in self._relations.values())

    def add(
        self, t: float, now: float, pose: tuple[float, float, float], speed: float, yaw_rate: float = math.nan,
        vy: float = math.nan, pull: float = math.nan, wheel: float = math.nan, command: float = math.nan,
    ) -> tuple[str, ...]:  # fmt: skip
        """Take in a call, arguments as in `Tracker.step`; sentences that are new.

        command: rad, in force from now on.
        """
        before = len(self.suspect)
        if now < self._now - LONGEST:  # the clock was set back
            self._t = -math.inf
        self._check_clock(now, pose, speed)
        if math.isfinite(speed):
            self._advance(now, speed, command if math.isfinite(command) else 0.0)
        moved = pose != self._pose or speed < SLOW
        if t > self._t and math.isfinite(t + speed) and moved and "time" not in self._labels:
            self._sample(t, pose, (speed, yaw_rate, vy, pull, wheel))
        self._now, self._pose = now, pose
        return self.suspect[before:]

    def _say(self, label: str, sentence: str) -> None:
        if label not in self._labels:
            self._labels.add(label)
            self.suspect += (sentence,)

    # -- time ---------------------------------------------------------------------------------------------------------
    def _check_clock(self, now: float, pose: tuple[float, float, float], speed: float) -> None:
        """Steps between calls that are 1000 times too long for the way that the car has made."""
        step = now - self._now
        if len(self._pose) and math.isfinite(step) and step > 2.0 and abs(speed) > 1.0:
            way = math.hypot(pose[0] - self._pose[0], pose[1] - self._pose[1])
            wrong = step > 40.0 * self.period if math.isfinite(self.period) else step > 4.0
            self._steps = self._steps + 1 if wrong and way < 0.02 * abs(speed) * step else 0
            if self._steps >= AGAIN:
                unit = "milliseconds" if step < 2e4 else "microseconds" if step < 2e7 else "nanoseconds"
                self._say(
                    "time", f"t: calls are {step:.3g} s apart by it, and the car moves {way:.2g} m at {speed:.3g} m/s: "
                    f"the time is in {unit}; give it in seconds."
                )  # fmt: skip
        elif step > 0.0:
            self._steps = 0
        if abs(speed) > 100.0:
            self._say("speed", f"speed: {speed:.3g} is no speed of a car in m/s: km/h? Give it in m/s.")

    def _advance(self, now: float, speed: float, command: float) -> None:
        """Go on with what the commands ask for."""
        step = now - self._now
        if not 0.0 < step < LONGEST or not self._requested:
            self._requested.clear()
            self._requested.append((now, 0.0, 0.0))
            self._began, self._command, self._lagged = now, command, 0.0
            self._first = command * self._gain(speed), command
            return
        _, turning, angle = self._requested[-1]
        before = self._lagged
        self._lagged += (self._command - before) * -math.expm1(-step / LAG)
        middle, most = 0.5 * (before + self._lagged), STEEP / max(speed, SLOW)
        rate = min(max(middle * self._gain(speed), -most), most)
        self._requested.append((now, turning + step * rate, angle + step * middle))
        self._command = command

    def _gain(self, speed: float) -> float:
        """Yaw rate of a steady turn over the wheels' angle (1/s): Rajamani, 2nd ed., section 3.3."""
        car = self.vehicle
        if car is None:
            return speed / 2.8
        length = car.wheelbase
        gradient = 0.5 * car.mass / length * (car.lr / car.stiffness_front - car.lf / car.stiffness_rear)
        return speed / max(length + gradient * speed * speed, 0.5 * length)

    # -- samples ------------------------------------------------------------------------------------------------------
    def _sample(self, t: float, pose: tuple[float, float, float], values: tuple[float, ...]) -> None:
        step, self._t = t - self._t, t
        if not step < LONGEST:
            self._ticks.clear()
            self._sums, self._last, self._tick = _Sums(), values, t
            self._ticks.append(_Tick(t, 0.0, *pose, values[0], *(math.nan,) * 6))
            return
        self._sums.add(self._last, values, step)
        self._last = values
        if t < self._tick + TICK:
            return
        last, sums = self._ticks[-1], self._sums
        means = [each / sums.time for each in sums.values]
        turned = math.remainder(pose[2] - last.yaw, math.tau) if math.isfinite(pose[2] + last.yaw) else math.nan
        jump = math.hypot(pose[0] - last.x, pose[1] - last.y) > 2.5 * abs(sums.values[0]) + 0.5
        if jump and not self._jumped:  # one that stays is a matter of units
            self._ticks.clear()
        self._jumped = jump
        self._ticks.append(_Tick(t, sums.time, *pose, means[0], turned, sums.values[0], *means[1:]))
        self._sums, self._tick = _Sums(), t
        if len(self._ticks) > 3:
            self._look()

    def _look(self) -> None:
        """Compare what there is."""
        window = list(self._ticks)[-min(WINDOW, len(self._ticks) - 1) :]
        first, last = self._ticks[-len(window) - 1], window[-1]
        time = last.t - first.t
        if time > LONGEST or last.speed < SLOW:
            self.sliding = self.sliding and last.speed >= SLOW
            return
        turned = sum(each.turned for each in window)
        rates = sum(each.yaw_rate * each.time for each in window)
        way = sum(each.way for each in window)
        east, north = last.x - first.x, last.y - first.y
        far = math.hypot(east, north)
        course = math.atan2(north, east)
        yaw = first.yaw + self._mean_turn(window)
        aside = math.remainder(course - yaw, math.tau) if math.isfinite(course + yaw) else math.nan
        posed = math.isfinite(aside) and far > 1.0
        if posed:
            if abs(aside) < 0.3 or not self._agreed:
                self._compare_way(far, way, first, last)
            self._compare_course(aside, course, yaw, far, (rates if math.isfinite(rates) else turned) / time)
        if math.isfinite(turned + rates) and not (posed and self._askew):
            self._compare_turn(turned, rates, window, time)
        if posed:
            self._compare_sideways(aside, far / time, time, window)
        self._compare_pull(window)
        self._compare_steering(turned, rates, aside, window)
        self._judge_sliding()

    @staticmethod
    def _mean_turn(window: Sequence[_Tick]) -> float:
        """Of the yaw over a window, less that at its beginning."""
        total = mean = 0.0
        for each in window:
            mean += total + 0.5 * each.turned
            total += each.turned
        return mean / len(window)

    def _compare_way(self, far: float, way: float, first: _Tick, last: _Tick) -> None:
        label = self._relations["way"].add((way, last.speed - first.speed), far, POSITION, last.time)
        if label == "late":
            self._say("speed late", "speed and positions are of clocks that are some 0.2 s apart, one of them is late: "
                      "give each the time at which it was taken.")  # fmt: skip
        elif label:
            measured = far / max(way, 1e-9)
            self._say("speed", f"speed: the positions move {measured:.2f} times as fast: {label}")

    def _compare_course(self, aside: float, course: float, yaw: float, far: float, rate: float) -> None:
        """The direction in which positions move against the yaw."""
        last = self._ticks[-1]
        rolling = (self.vehicle.lr if self.vehicle else 1.5) * rate / last.speed
        self._origin = yaw if math.isnan(self._origin) else self._origin
        turned, gone = math.remainder(yaw - self._origin, math.tau), math.remainder(course - self._origin, math.tau)
        self._courses.append((course, yaw))
        if max(abs(turned), abs(gone)) < 1.5 and abs(rate * last.speed) < GENTLE:
            noise = 0.008 + 0.045 / far + 0.3 * abs(rolling)
            if self._relations["course"].add((turned,), gone, noise, last.time):
                self._explain_course()
        self._range = [min(self._range[0], yaw), max(self._range[1], yaw)]
        if abs(aside) < 0.2:
            self._agreed += 1
            self._confirmed |= abs(turned) > TURNED
        turned = self._range[1] - self._range[0] > TURNED
        beside = max(aside - max(rolling, 0.0), min(rolling, 0.0) - aside)
        known = self._agreed > (20 if turned else 60)
        usual = abs(rate * last.speed) < ROUGH or self._agreed == 0
        askew = beside > ASKEW + 0.5 * abs(rolling) + 0.18 / far and usual and not known
        self._askew = self._askew + 1 if askew else 0
        if self._askew >= AGAIN:
            self._explain_course()

    def _explain_course(self) -> None:
        """Say what of yaw and positions is wrong, by what makes both agree."""
        misses = {
            words: max(abs(math.remainder(course - made(yaw), math.tau)) for course, yaw in self._courses)
            for words, made in FRAMES.items()
        }
        words = min(misses, key=lambda each: misses[each])
        if misses[words] > 0.25:
            words = "their frames differ; yaw must be counted from x towards y, in radians."
        aside = math.degrees(math.remainder(self._courses[-1][0] - self._courses[-1][1], math.tau))
        self._say("course", f"yaw and x, y: the positions move {aside:.0f} degrees beside the yaw: {words}")

    def _compare_turn(self, turned: float, rates: float, window: Sequence[_Tick], time: float) -> None:
        """The change of yaw against the yaw rate."""
        change = window[-1].yaw_rate - window[0].yaw_rate
        last = window[-1]
        label = self._relations["turn"].add((rates, change), turned, YAW + 0.003 * time, last.time)
        rolled, before = last.yaw_rate * last.time, self._ticks[-2]
        in_degrees = DEGREE * math.remainder(last.yaw - before.yaw, 360.0)
        gross = abs(last.turned - rolled) > 0.1 and abs(in_degrees - rolled) < 0.03
        self._degrees = self._degrees + 1 if gross else 0
        if self._degrees > AGAIN:
            label = "degrees"
        if label == "degrees" and self._confirmed:
            label = "yaw_rate is taken for degrees per second; it is in rad/s."
        if label == "late":
            self._say("yaw late", "yaw and yaw_rate are of clocks that are some 0.2 s apart, one of them is late: give "
                      "each the time at which it was taken.")  # fmt: skip
        elif label == "degrees":
            self._say("course", "yaw: it changes 57 times as much as yaw_rate says: yaw is in degrees; give it in "
                      "radians.")  # fmt: skip
        elif label == SIGN and self._course_turns() * turned < 0.0:
            self._explain_course()
        elif label:
            self._say("yaw_rate", f"yaw_rate: over half a second yaw changes by {turned:.2g} rad where it says "
                      f"{rates:.2g}: {label}")  # fmt: skip

    def _course_turns(self) -> float:
        """rad, by how much the direction of motion has changed lately."""
        return math.remainder(self._courses[-1][0] - self._courses[0][0], math.tau) if self._courses else 0.0

    def _compare_sideways(self, aside: float, speed: float, time: float, window: Sequence[_Tick]) -> None:
        """Which point of the car the positions are of, by how they move sideways where the car turns."""
        rate = sum(each.yaw_rate * each.time for each in window) / time
        if not math.isfinite(rate):
            rate = sum(each.turned for each in window) / time
        if abs(rate) < 0.02 and abs(aside) < 0.1:
            self._straight += 1
            self._mounting += (aside - self._mounting) / min(self._straight, 100)
        if self.vehicle is None or self._straight < 10 or self._labels & {"speed", "course", "yaw_rate"}:
            return
        if not abs(rate * speed) < GENTLE or self.sliding:
            return
        sideways = speed * math.sin(aside - self._mounting)
        noise = math.hypot(POSITION / time, 0.004 * speed)
        vy = sum(each.vy * each.time for each in window) / time
        if math.isfinite(vy):
            label = self._relations["lateral"].add((vy, rate), sideways, noise, window[-1].time)
        else:
            label = self._relations["point"].add((rate, -rate * speed**2), sideways, noise, window[-1].time)
        if label == "sign":
            self._say(
                "lateral", "lateral_velocity: the positions move to the other side: give it positive to the left."
            )
        elif label:
            self._say("point", f"x, y: they move sideways in bends as the {label} does: give those of the centre of "
                      f"mass, {self._arm(label)}.")  # fmt: skip

    def _arm(self, label: str) -> str:
        car = self.vehicle
        assert car is not None
        return f"{car.lr:.2f} m ahead of it" if label == "rear axle" else f"{car.lf:.2f} m behind it"

    def _compare_pull(self, window: Sequence[_Tick]) -> None:
        """Lateral acceleration against speed times yaw rate."""
        last = window[-1]
        calm = abs(last.speed * last.yaw_rate) < ROUGH and not self.sliding  # a car that spins turns without it
        if math.isfinite(last.pull) and calm and "yaw_rate" not in self._labels:
            label = self._relations["pull"].add((last.speed * last.yaw_rate,), last.pull, 0.4, last.time)
            if label:
                self._say("pull", f"lateral_acceleration: it is {last.pull:.2g} m/s^2 where speed times yaw_rate is "
                          f"{last.speed * last.yaw_rate:.2g}: {label}")  # fmt: skip

    def _compare_steering(self, turned: float, rates: float, aside: float, window: Sequence[_Tick]) -> None:
        """The turning of the car, and its wheels, against the commands of some time ago."""
        last, before = window[-1], window[-3]
        span = last.t - before.t
        if self._labels & {"course", "yaw_rate", "time", "speed"} or len(self._requested) < 3 or self.sliding:
            return
        both = np.concatenate([last.t - DELAYS, before.t - DELAYS])
        times, turning, angles = np.array(self._requested).T
        old = np.exp(-np.maximum(last.t - 0.5 * span - DELAYS - self._began, 0.0) / LAG)
        if math.isfinite(last.wheel):
            wheel = (window[-1].wheel * window[-1].time + window[-2].wheel * window[-2].time) / span
            requested = _requested(both, times, angles, old * self._first[1], old, span)
            label = self._relations["wheel"].add(requested, wheel, 0.015, last.time)
            if label:
                self._say("wheel", f"wheel_angle: it is {wheel:.2g} rad at a command of {self._command:.2g}: {label}")
        rate = sum(each.yaw_rate * each.time for each in window[-2:]) / span
        if not math.isfinite(rate):
            rate = sum(each.turned for each in window[-2:]) / span
        apart, most = abs(turned - rates), max(abs(turned), abs(rates))
        agree = not apart > 0.015 + 0.3 * most
        if not math.isfinite(rate) or not agree or abs(aside) > 0.14:
            return
        requested = _requested(both, times, turning, old * self._first[0], old, span)
        against = bool((requested[: DELAYS.size] * rate < 0.0).all())  # all that was requested
        sure = against and abs(rate) > 0.05 and not apart > 0.4 * most
        label = self._relations["steering"].add(requested, rate, 0.01 + 0.08 * abs(rate), last.time, sure)
        if label == "sign":
            self.against_steering = True
            self._say("steering", "command: the car turns to the other side: the steering takes it with the other "
                      "sign, or x, y, yaw, yaw_rate and the path are of a left-handed frame (such as NED). Commands "
                      "and angles are positive to the left.")  # fmt: skip
        elif label:
            self._say("steering", f"command: {label}")

    # -- sliding ------------------------------------------------------------------------------------------------------
    def _judge_sliding(self) -> None:
        """Whether the car slides, by its lateral velocity, or by how its positions move beside its yaw."""
        last, before = self._ticks[-1], self._ticks[-3]
        unsure = 0.0
        if math.isfinite(last.vy):
            self.sideslip = math.atan2(last.vy, last.speed)
        else:
            east, north = last.x - before.x, last.y - before.y
            middle = last.yaw - 0.5 * (last.turned + self._ticks[-2].turned)
            way = math.hypot(east, north)
            known = way > 1.0 and self._agreed > 10 and "course" not in self._labels
            unsure = 1.5 * POSITION / max(way, 1e-3)
            course = math.remainder(math.atan2(north, east) - middle, math.tau)
            self.sideslip = course - self._mounting if known and math.isfinite(course) else math.nan
        rate = last.yaw_rate if math.isfinite(last.yaw_rate) else last.turned / max(last.time, TICK)
        rolling = (self.vehicle.lr if self.vehicle else 1.5) * rate / last.speed
        slip = abs(self.sideslip) - unsure
        if slip > SLIDING and abs(self.sideslip - rolling) - unsure > SLIDES:
            self._slips, self._calm = self._slips + 1, 0.0
            self.sliding |= self._slips >= (1 if math.isfinite(last.vy) else 3)  # a position that jumps is in two
            return
        self._slips = 0
        if self.sliding:
            self._calm = self._calm + last.time if not slip > NOT_SLIDING else 0.0
            self.sliding = self._calm < RELEASE


def _relations(car: Vehicle | None) -> dict[str, _Comparison]:
    """The comparisons, with what is honest and what is a known mistake in each."""
    clocks = [*_grid("", NEAR_ONE, (-0.06, -0.03, 0.0, 0.03, 0.06)),
              *_grid("late", (0.95, 1.0, 1.05), (-0.25, -0.2, -0.15, 0.15, 0.2, 0.25))]  # fmt: skip
    way = [
        *clocks,
        *_grid("it is in km/h; give m/s.", (1 / 3.6,), (0.0,)),
        *_grid("it is in miles per hour; give m/s.", (0.447,), (0.0,)),
        *_grid("check its unit; give m/s, along the car.", (0.1, 0.6, 1.6, 2.2, 3.6, 10.0), (0.0,)),
    ]
    turn = [
        *clocks,
        *_grid(SIGN, (-1.0,), (0.0,)),
        *_grid("degrees", (40.0, 57.3), (0.0,)),
        *_grid("yaw_rate is in degrees per second; give rad/s.", (DEGREE,), (0.0,)),
        *_grid("check its unit; give rad/s.", (0.1, 0.5, 2.0, 5.0, 10.0), (0.0,)),
    ]
    course = [*_grid("", (0.7, 0.85, 1.0, 1.2)), *_grid("mirrored", (-1.0,)), *_grid("degrees", (DEGREE,))]
    pull = [
        *_grid("", (0.5, 0.7, 1.0, 1.4, 1.8)),
        *_grid(SIGN, (-1.0,)),
        *_grid("it is in g; give m/s^2.", (1 / 9.81,)),
    ]
    found = {
        "way": _Comparison("positions and speed", way, WINDOW),
        "course": _Comparison("positions and yaw", course, WINDOW, 0.02),
        "turn": _Comparison("yaw and yaw rate", turn, WINDOW),
        "pull": _Comparison("lateral acceleration, speed and yaw rate", pull, 2, 0.5, 5.0 * EVIDENCE),
        "wheel": _Delayed("command and wheel angle", WHEELS, 0.03, 5.0 * EVIDENCE),
        "steering": _Delayed("command and turning", KNOWN_CAR if car else UNKNOWN_CAR, 0.06, 1.3 * EVIDENCE),
    }
    found["steering"].sooner = frozenset(KNOWN_CAR) - {"sign"}
    if car is not None:
        slip = 0.5 * car.mass * car.lf / (car.stiffness_rear * car.wheelbase)
        slips = [factor * slip for factor in (0.3, 0.6, 1.0, 1.6, 2.5)]
        near = [factor * car.lr for factor in (0.75, 1.0, 1.25)]
        point = [
            *_grid("", near, slips),
            *_grid("rear axle", (0.0,), slips),
            *_grid("front axle", (car.wheelbase,), slips),
        ]
        found["point"] = _Comparison("positions and yaw rate", point, WINDOW)
        offsets = (-0.3 * car.lr, 0.0, 0.3 * car.lr)
        lateral = [*_grid("", (0.8, 1.0, 1.2), offsets), *_grid("sign", (-1.0,), (0.0,)),
                   *_grid("rear axle", (1.0,), (-car.lr,)), *_grid("front axle", (1.0,), (car.lf,))]  # fmt: skip
        found["lateral"] = _Comparison("positions and lateral velocity", lateral, WINDOW)
    return found


def _requested(at: Array, times: Array, integral: Array, before: Array, free: Array, span: float) -> Array:
    """What `_Delayed` compares with: means of an integral, with what was before the beginning or its negative."""
    ends, starts = np.interp(at, times, integral).reshape(2, -1)
    mean = (ends - starts) / span
    return np.concatenate([mean + before, mean - before, free])
