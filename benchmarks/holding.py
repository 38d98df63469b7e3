"""Whether the speed control starts, stops and holds on slopes, with late brakes, limited friction and lost positions.

    python benchmarks/holding.py [--drives 500] [--seed 1] [--task start] [--only 17]

Each drive draws one of three cars, a mass of 0.8 to 1.3 and brakes of 0.85 to 1.1 times those in its file, delays of
drive (lag to 0.45 s, dead time to 0.25 s) and brakes (0.25 s, 0.2 s), a friction of 0.6 to 1, and a slope of -25 to
25 % that the map contains, lacks, or has wrong. Half of the drives measure the speed without its sign, half have noise
of 0.02 m and 0.02 m/s. The speed control knows the car's file alone; half of the drives assume the true friction,
half 0.9. Before a start a driver holds the car and takes the foot off the brake within 0.5 s.

    start   drive off on the slope
    slow    drive off by a plan that rises with 0.1 to 0.5 m/s^2
    stand   stop and stand for 20 s or more    } in half of these drives the position is lost before, while or after
    go      stop for 3 s and drive off         } the car stands, for good or for 5 to 10 s
    climb   lose the position while driving
    near    stop 0.2 to 1 m ahead of the standing car; half of the drives on the level, half on up to 12 %

"rolled" is the longest way against the request: backwards, or in any direction while the car is to stand. The target is
0.1 m up to a slope of 12 % and 0.5 m up to 25 % with a position and a signed speed, otherwise 1 m. --only N prints one
drive, period by period.
"""

from __future__ import annotations

import argparse
import logging
import math
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.speed.speed_control import slope_of
from adaptrack.road import Comfort, Line, Road, SpeedPlan, Stop, plan_speed

CARS = ("midsize-sedan", "compact-ev", "van")
TASKS = ("start", "slow", "stand", "go", "climb", "near")
PERIOD, SUBSTEPS = 0.05, 10
ROAD_LENGTH, STOP_PLACE, RAMP = 160.0, 60.0, 20.0
"""m"""
APPROACH_SPEED, TOP_SPEED = 6.0, 8.0
"""m/s"""
DRIVER_TIME, FOOT_TIME = 1.0, 0.5
"""s, for which a driver holds the car before a start, and in which the foot leaves the brake."""
ROLLING_SPEED, STATE_TIME, STANDING_TIME = 0.2, 0.5, 2.0
"""m/s, s, s: a state is false if it contradicts a car that rolls so fast, or stands, for so long."""
LEVEL, MODERATE, STEEP = 0.02, 0.12, 0.25
"""-, slopes up to which a class reaches."""


class Straight(at.Controller):
    """Steer straight ahead as long as a position is known."""

    name, period = "straight", PERIOD

    def reset(self) -> None:
        """Do nothing."""

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None) -> float:
        """Return 0 rad, NaN without a position."""
        return 0.0 * float(state[0])

    def describe(self) -> dict[str, Any]:
        """Return the period."""
        return {"period": self.period}


class Case(NamedTuple):
    """Conditions of a drive."""

    task: str
    car: str
    mass: float
    """over that in the file, as is the effect of the brakes:"""
    brakes: float
    drive_lag: float
    drive_dead_time: float
    brake_lag: float
    brake_dead_time: float
    """s"""
    friction: float
    assumed_friction: float
    grade: float
    map_grade: float
    onset: float
    """m, where the slope begins, over `RAMP`; -inf: everywhere the same"""
    is_signed: bool
    noise: float
    """m and m/s"""
    loss: str
    """when the position is lost: "", "before", "while", "after" the car stands, or "climb" """
    loss_delay: float
    """s from this event (m before the stop) to the loss"""
    loss_time: float
    """s without a position"""
    accelerate: float
    """m/s^2, of the plan"""
    is_slow_by_plan: bool
    """whether the plan alone is slow, or the comfort as well"""
    distance: float
    """m, from the standing car to a near stop"""

    @property
    def map_kind(self) -> str:
        """Return what the map knows of the slope."""
        if self.map_grade == self.grade:
            return "right"
        return "level" if self.map_grade == 0.0 else "wrong"

    @property
    def has_all(self) -> bool:
        """Return whether position and sign of the speed are always known."""
        return self.is_signed and not self.loss


def draw(rng: np.random.Generator, task: str | None) -> Case:
    """Draw the conditions of a drive."""
    task = task or str(rng.choice(TASKS, p=(0.22, 0.16, 0.18, 0.16, 0.12, 0.16)))
    knowledge, friction = rng.integers(3), rng.uniform(0.6, 1.0)
    grade, wrong_grade = rng.uniform(-STEEP, STEEP, 2)
    if task == "near":
        grade *= rng.choice((0.0, MODERATE / STEEP))
    is_lost = task in ("stand", "go") and rng.random() < 0.5
    loss = str(rng.choice(("before", "while", "after")[: 3 if task == "go" else 2])) if is_lost else ""
    delays = {"before": rng.uniform(0.0, 15.0), "after": rng.uniform(1.0, 3.0)}
    return Case(
        task, str(rng.choice(CARS)), rng.uniform(0.8, 1.3), rng.uniform(0.85, 1.1),
        rng.uniform(0.1, 0.45), rng.uniform(0.05, 0.25), rng.uniform(0.06, 0.25), rng.uniform(0.05, 0.2),
        friction, friction if rng.random() < 0.5 else 0.9, grade, (grade, 0.0, wrong_grade)[knowledge],
        STOP_PLACE - rng.uniform(30.0, 50.0) if task in ("stand", "go") and rng.random() < 0.5 else -math.inf,
        bool(rng.random() < 0.5), float(rng.choice((0.0, 0.02))),
        "climb" if task == "climb" else loss, delays.get(loss, rng.uniform(1.0, 4.0)),
        math.inf if rng.random() < 0.5 else rng.uniform(5.0, 10.0),
        rng.uniform(0.1, 0.5) if task == "slow" else rng.uniform(1.0, 2.0), bool(rng.random() < 0.5),
        rng.uniform(0.2, 1.0),
    )  # fmt: skip


class Plant:
    """A car on a straight road: mass, late drive, late brakes that only oppose the motion, limited friction."""

    def __init__(self, case: Case, speed: float) -> None:
        car = at.load_vehicle(case.car)
        self.case, self.car, self.mass = case, car, car.mass * case.mass
        self.s, self.v, self.foot = 0.0, speed, 0.0
        self._forces, self._step = [0.0, 0.0], PERIOD / SUBSTEPS
        dead_times = (case.drive_dead_time, case.brake_dead_time)
        self._queues = [[0.0] * round(dead_time / self._step) for dead_time in dead_times]
        self._shares = [1.0 - math.exp(-self._step / lag) for lag in (case.drive_lag, case.brake_lag)]
        front = car.lr / (car.lf + car.lr)
        self.driven_share = car.drive_front * front + (1.0 - car.drive_front) * (1.0 - front)
        self._drag = 0.5 * car.air_density * car.frontal_area * car.drag_coefficient

    def grade(self) -> float:
        """Return dz/ds under the car."""
        return self.case.grade * min(max((self.s - self.case.onset) / RAMP, 0.0), 1.0)

    @property
    def can_start(self) -> bool:
        """Whether the drive carries the steepest ascent, with a tenth in reserve."""
        slope, car = math.atan(self.case.grade), self.car
        weight = self.mass * GRAVITY * math.cos(slope)
        reach = min(car.traction_limit, self.case.friction * self.driven_share * weight)
        return reach > 1.1 * weight * (math.tan(slope) + car.rolling_resistance)

    def move(self, force: float, hold: float) -> None:
        """Move for one period under a requested drive or brake force and a hold (N)."""
        requests = (max(force, 0.0), self.case.brakes * (max(-force, 0.0) + max(hold, 0.0)))
        for _ in range(SUBSTEPS):
            for i in range(2):
                self._queues[i].append(requests[i])
                self._forces[i] += self._shares[i] * (self._queues[i].pop(0) - self._forces[i])
            grade = self.grade()
            load = self.mass * GRAVITY / math.sqrt(1.0 + grade * grade)
            driving = min(self._forces[0], self.case.friction * self.driven_share * load)
            push = driving - load * grade - self._drag * self.v * abs(self.v)
            resistance = min(self._forces[1] + self.foot, self.case.friction * load)
            resistance += self.car.rolling_resistance * load
            if self.v == 0.0 and abs(push) <= resistance:
                continue
            direction = math.copysign(1.0, self.v if self.v != 0.0 else push)
            speed = self.v + self._step * (push - direction * resistance) / self.mass
            speed = 0.0 if speed * self.v < 0.0 else speed
            self.s += 0.5 * self._step * (self.v + speed)
            self.v = speed


def road_and_plan(case: Case) -> tuple[Road, SpeedPlan]:
    """Return the road with the grade of the map, and its plan."""
    road = Road.from_segments([Line(length=ROAD_LENGTH)], name="straight").replace(grade=case.map_grade)
    car, comfort = at.load_vehicle(case.car), Comfort(accelerate=case.accelerate, brake=2.0)
    options: dict[str, Any] = {"top_speed": TOP_SPEED, "start": 0.0, "end": 0.0}
    if case.task in ("stand", "go", "climb"):
        options["start"] = APPROACH_SPEED
        options["stops"] = [Stop(STOP_PLACE, {"stand": 40.0, "go": 3.0}[case.task])] if case.task != "climb" else []
    if case.task == "near":
        options |= {"start": None, "stops": [Stop(case.distance, 60.0)]}
    plan = plan_speed(road, car, comfort, **options)
    return road, replace(plan, comfort=Comfort()) if case.task == "slow" and case.is_slow_by_plan else plan


@dataclass
class Result:
    """Figures of a drive."""

    case: Case
    rolled: float = 0.0
    """m, against the request"""
    stop_error: float = math.nan
    """m, of the first standstill at the stop"""
    is_startable: bool = True
    has_to_start: bool = False
    has_started: bool = False
    excess: float = -math.inf
    """m/s, speed beyond the plan"""
    jerk: float = math.nan
    """m/s^3, largest in the 2 s after a start"""
    start_time: float = math.nan
    """s, from the end of the driver's hold or of the stop to the motion"""
    contradictions: Counter[str] = field(default_factory=Counter)
    """periods in which a state or a request contradicts the motion, by kind"""
    faults: set[str] = field(default_factory=set)

    @property
    def has_false_state(self) -> bool:
        """Return whether a state contradicted the motion."""
        return any(count and kind.startswith("state") for kind, count in self.contradictions.items())

    @property
    def target(self) -> float:
        """Return the largest way (m) against the request that is allowed."""
        if not self.case.has_all:
            return 1.0
        return 0.1 if abs(self.case.grade) <= MODERATE else 0.5


class Drive:
    """A drive under way: what is lost when, and what the car is to do."""

    def __init__(self, case: Case, rng: np.random.Generator) -> None:
        road, self.plan = road_and_plan(case)
        self.case, self.rng = case, rng
        self.is_from_rest = case.task in ("start", "slow", "near")
        self.plant = Plant(case, 0.0 if self.is_from_rest else APPROACH_SPEED)
        control = at.SpeedControl(self.plant.car, friction=case.assumed_friction)
        self.tracker = at.Tracker(Straight(), road, plan=self.plan, speed=control)
        self.result = Result(case, is_startable=self.plant.can_start)
        self.stop = {"near": case.distance, "stand": STOP_PLACE, "go": STOP_PLACE}.get(case.task, math.inf)
        self.seconds = {"stand": 40.0, "go": 3.0, "near": 60.0}.get(case.task, 0.0)
        self.duration = {"start": 14.0, "slow": 24.0, "stand": 40.0, "go": 36.0, "climb": 24.0, "near": 14.0}[case.task]
        self.time, self.stood_at, self.left_at, self.lost_at = 0.0, math.inf, math.inf, math.inf
        self._highest, self._anchor = -math.inf, math.nan
        self._rolling = self._standing = 0.0
        self._speeds: list[float] = []

    def _note_loss(self) -> None:
        """Note when the position is lost."""
        case, plant = self.case, self.plant
        if self.lost_at < math.inf:
            return
        is_event = {
            "": False, "before": plant.s > self.stop - case.loss_delay, "climb": self.time >= case.loss_delay,
            "while": self.time >= self.stood_at + case.loss_delay, "after": self.time >= self.left_at + case.loss_delay,
        }[case.loss]  # fmt: skip
        self.lost_at = self.time if is_event else math.inf

    @property
    def is_lost(self) -> bool:
        """Whether the position is missing now."""
        return self.lost_at <= self.time < self.lost_at + self.case.loss_time

    def step(self) -> Any:
        """Drive one control period; return what the tracker requests."""
        case, plant = self.case, self.plant
        self._note_loss()
        has_driver = self.is_from_rest and self.time < DRIVER_TIME
        fade = (self.time - DRIVER_TIME) / FOOT_TIME if self.is_from_rest else 1.0
        plant.foot = plant.mass * GRAVITY * min(max(1.0 - fade, 0.0), 1.0) * 0.5
        noise = case.noise * self.rng.standard_normal(2)
        speed = plant.v + noise[1]
        x = math.nan if self.is_lost else plant.s + noise[0]
        away = math.nan if self.is_lost else 0.0
        out = self.tracker.step(
            self.time, x, away, away, speed if case.is_signed else abs(speed), 0.0, driver=has_driver
        ).longitudinal
        if not has_driver:
            self._observe(out)
        self._speeds.append(plant.v)
        plant.move(0.0 if has_driver else out.force, 0.0 if has_driver else out.hold)
        self.time += PERIOD
        return out

    def _observe(self, out: Any) -> None:
        """Compare the motion with what is to happen."""
        plant, result = self.plant, self.result
        if out.limited_by in ("brake fault", "drive fault"):
            result.faults.add(str(out.limited_by))
        is_at_stop = abs(plant.s - self.stop) < 1.0 and self.time <= self.left_at
        if plant.v == 0.0 and is_at_stop and self.stood_at == math.inf:
            self.stood_at, result.stop_error = self.time, plant.s - self.stop
        if self.time > self.stood_at + self.seconds and abs(plant.v) > ROLLING_SPEED and not self.is_lost:
            self.left_at = min(self.left_at, self.time)
        is_held = self.stood_at < self.time < self.stood_at + self.seconds - 0.2 and self.case.task != "near"
        if (is_held or self.is_lost) and (plant.v == 0.0 or math.isfinite(self._anchor)):
            self._anchor = plant.s if math.isnan(self._anchor) else self._anchor
            result.rolled = max(result.rolled, abs(plant.s - self._anchor))
        else:
            self._anchor = math.nan
        self._highest = max(self._highest, plant.s)
        result.rolled = max(result.rolled, self._highest - plant.s)
        around = np.clip(plant.s + 0.5 * plant.v * np.array([-1.0, 0.0, 1.0]), 0.0, ROAD_LENGTH)
        result.excess = max(result.excess, plant.v - float(self.plan.at(around).max()))
        self._judge(out, is_at_stop)

    def _judge(self, out: Any, is_at_stop: bool) -> None:
        """Count states and requests that contradict the motion."""
        plant, counts = self.plant, self.result.contradictions
        self._rolling = self._rolling + PERIOD if abs(plant.v) > ROLLING_SPEED else 0.0
        self._standing = self._standing + PERIOD if plant.v == 0.0 else 0.0
        is_rolling, is_resting = self._rolling > STATE_TIME, self._standing > STANDING_TIME and out.force <= 0.0
        steep_hold = min(plant.car.brake_limit, plant.car.mass * slope_of(STEEP))
        counts["state: stopped, rolls"] += is_rolling and out.state == "stopped"
        counts["state: driving, rolls back"] += is_rolling and plant.v < 0.0 and out.state == "driving"
        counts["state: driving, rests"] += is_resting and out.state == "driving"
        is_waiting = is_resting and is_at_stop and not self.is_lost
        counts["state: not stopped, rests at the stop"] += is_waiting and out.state != "stopped"
        counts["request: rests with less than holds 25 %"] += is_resting and out.hold - out.force < steep_hold - 1.0
        counts["request: negative hold or no number"] += not (out.hold >= 0.0 and math.isfinite(out.force))
        is_back = is_rolling and plant.v < 0.0 and self.case.is_signed
        counts["request: force < 0, rolls back"] += is_back and out.force < 0.0

    def run(self, is_printed: bool = False) -> Result:
        """Drive to the end; return the figures."""
        while self.time < self.duration and -200.0 < self.plant.s < ROAD_LENGTH - 5.0:
            out = self.step()
            if is_printed and round(self.time / PERIOD) % 4 == 0:
                print(f"{self.time:6.2f} s {self.plant.s:8.3f} m {self.plant.v:+7.3f} m/s  "
                      f"force {out.force:.0f} N, hold {out.hold:.0f} N  {out.state}, {out.limited_by}"
                      f"{', position lost' if self.is_lost else ''}")  # fmt: skip
        self._conclude()
        return self.result

    def _conclude(self) -> None:
        """Judge starts, near stops and the jerk after a start."""
        case, plant, result = self.case, self.plant, self.result
        is_gone = case.loss and math.isinf(case.loss_time)
        result.has_to_start = case.task in ("start", "slow") or (case.task == "go" and not is_gone)
        begin = DRIVER_TIME + FOOT_TIME if self.is_from_rest else self.stood_at + self.seconds
        result.has_started = plant.s > (2.0 if case.task != "go" else STOP_PLACE + 2.0)
        if case.task == "near":
            result.has_to_start, result.has_started = True, plant.s > 0.5 * case.distance
            result.stop_error = plant.s - case.distance
        if case.task == "near" or not (result.has_to_start and result.has_started) or math.isinf(begin) or case.loss:
            return
        speeds = np.array(self._speeds)
        first = round(begin / PERIOD)
        moves = np.flatnonzero(speeds[first:] > 0.0)
        mean = (speeds[4:] - speeds[:-4]) / (4 * PERIOD)  # m/s^2, over 0.2 s
        jerk = np.abs(mean[4:] - mean[:-4]) / (4 * PERIOD)
        result.start_time = float(moves[0] * PERIOD)
        moved = first + int(moves[0])
        result.jerk = float(jerk[max(moved - 8, 0) : moved + 40].max(initial=0.0))


def quantiles(values: Iterable[float]) -> str:
    """Return median, 95 % quantile and largest value in words."""
    finite = [value for value in values if math.isfinite(value)]
    if not finite:
        return "none"
    return f"median {np.median(finite):.3f}, 95 % {np.quantile(finite, 0.95):.3f}, largest {max(finite):.3f}"


def print_rolled(results: list[Result]) -> None:
    """Print how far the cars rolled against the request, by class."""
    print("rolled against the request (m)                n   beyond target   worst")
    for is_clean, title in ((True, "position, signed speed"), (False, "lost position or unsigned speed")):
        for low, high in ((0.0, LEVEL), (LEVEL, MODERATE), (MODERATE, STEEP)):
            chosen = [
                result for result in results
                if result.case.has_all == is_clean and low <= abs(result.case.grade) <= high
            ]  # fmt: skip
            beyond = [result for result in chosen if result.rolled > result.target]
            name = f"{title}, to {100 * high:.0f} %"
            worst = max((result.rolled for result in chosen), default=math.nan)
            print(f"  {name:42s} {len(chosen):4d}   {len(beyond):6d} {worst:14.2f}")


def print_tasks(results: list[Result]) -> None:
    """Print counts of drives by task."""
    print("task      n  beyond target  worst (m)  startable  not started  false state  fault  plan + 1 m/s")
    for task in TASKS:
        chosen = [result for result in results if result.case.task == task]
        startable = [result for result in chosen if result.has_to_start and result.is_startable]
        counts = (
            sum(result.rolled > result.target for result in chosen),
            max((result.rolled for result in chosen), default=math.nan), len(startable),
            sum(not result.has_started for result in startable), sum(result.has_false_state for result in chosen),
            sum(bool(result.faults) for result in chosen), sum(result.excess > 1.0 for result in chosen),
        )  # fmt: skip
        print("{:6s} {:4d} {:12d} {:12.2f} {:10d} {:10d} {:12d} {:8d} {:10d}".format(task, len(chosen), *counts))


def print_stops(title: str, errors: list[float]) -> None:
    """Print where the cars stood first, against the place of the stop (m)."""
    stood = np.array([error for error in errors if math.isfinite(error)])
    print(f"{title}: {len(errors)}, of which {len(errors) - stood.size} stood nowhere within 1 m; "
          f"beyond: {np.sum(stood > 0.1)} by more than 0.1 m, worst {stood.max(initial=0.0):.2f} m; "
          f"short: {np.sum(stood < -0.1)} by more than 0.1 m, {np.sum(stood < -0.25)} by more than 0.25 m, "
          f"worst {-stood.min(initial=0.0):.2f} m")  # fmt: skip


def print_figures(results: list[Result]) -> None:
    """Print all figures."""
    print_rolled(results)
    maps = Counter(result.case.map_kind for result in results)
    beyond = Counter(result.case.map_kind for result in results if result.rolled > result.target)
    print("beyond the target, by the map:", ", ".join(f"{kind} {beyond[kind]} of {maps[kind]}" for kind in maps))
    print_tasks(results)
    near = [result for result in results if result.case.task == "near"]
    print_stops("near stops on the level", [r.stop_error for r in near if r.case.grade == 0.0])
    print_stops("near stops to 12 %", [r.stop_error for r in near if r.case.grade != 0.0])
    stops = [result for result in results if result.case.task in ("stand", "go") and not result.case.loss]
    for is_steep, title in ((False, "to 12 %"), (True, "to 25 %")):
        errors = [result.stop_error for result in stops if (abs(result.case.grade) > MODERATE) == is_steep]
        print_stops(f"stops with a position, {title}", errors)
    print(f"jerk at the start (m/s^3): {quantiles(result.jerk for result in results)}")
    print(f"time to the start (s): {quantiles(result.start_time for result in results)}")
    kinds = Counter(kind for result in results for kind, count in result.contradictions.items() if count)
    for kind, count in sorted(kinds.items()):
        print(f"drives with {kind}: {count}")
    print("drives with a fault reported:", dict(Counter(fault for r in results for fault in r.faults)) or "none")


def main() -> None:
    """Drive and print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drives", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--task", choices=TASKS)
    parser.add_argument("--only", type=int, help="the number of one drive, printed period by period")
    parser.add_argument("--worst", type=int, default=0, help="print so many drives that rolled farthest, by number")
    arguments = parser.parse_args()
    logging.getLogger("adaptrack").setLevel(logging.ERROR)
    results = []
    for number in range(arguments.drives) if arguments.only is None else [arguments.only]:
        rng = np.random.default_rng([arguments.seed, number])
        case = draw(rng, arguments.task)
        if arguments.only is not None:
            print(case)
        results.append(Drive(case, rng).run(arguments.only is not None))
        if (number + 1) % 50 == 0:
            print(f"{number + 1} of {arguments.drives} drives", file=sys.stderr, flush=True)
    print(f"{len(results)} drives, seed {arguments.seed}")
    print_figures(results)
    order = sorted(range(len(results)), key=lambda number: -results[number].rolled)
    for number in order[: arguments.worst]:
        result = results[number]
        print(f"drive {number}: rolled {result.rolled:.2f} m, {result.case.task} {result.case.loss} "
              f"{result.case.car} grade {result.case.grade:+.2f} map {result.case.map_grade:+.2f} "
              f"signed {result.case.is_signed}")  # fmt: skip


if __name__ == "__main__":
    main()
