"""Does a tracker say which of its inputs is wrong, in time, and nothing where all are right? Does it tell of sliding?

    python benchmarks/wrong_inputs.py wrong --drives 100 [--faults yaw_degrees,...]
    python benchmarks/wrong_inputs.py lies --drives 120
    python benchmarks/wrong_inputs.py honest --drives 300
    python benchmarks/wrong_inputs.py honest --drives 600 --noisy
    python benchmarks/wrong_inputs.py sliding --drives 100

A car that is not ours (single track, tyres that saturate, gusts, a steering with lag, dead time, rate and bias) drives
roads of all kinds through `Tracker` at 20 Hz, with the noise of `road` or of `production`, late and lost samples. The
controller has a data sheet and learns, or is given the car. Judged seeds begin at `JUDGED`; everything in
`adaptrack.core.input_check` was chosen on those from `TUNING` on (``--tuning``).

wrong: one input is wrong from the first call; at which distance from the path it was reported. lies: the pose drifts or
jumps from an instant on; how many drives are lost without a report. honest: 120 s each, a third at 2 to 10 m/s, a
quarter with a stop; every report is a false one; noisy: the positions have a noise of 0.03 to 0.3 m, white or with a
time constant of 1 to 20 s, of which the filter is told the truth, half or twice. sliding: friction fails under an axle
in a bend; the time from 10 degrees of sideslip to the status.
"""

from __future__ import annotations

import argparse
import logging
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

import adaptrack as at
from adaptrack.identification.random_cars import random_car
from adaptrack.road import Comfort
from adaptrack.road.road_ahead import foot_near

JUDGED, TUNING = 77_000_000, 78_000_000
"""First seeds."""
DT, PERIOD = 0.01, 0.05
"""s, of the car and of the loop."""
WRONG, HONEST, STANDS = 40.0, 120.0, 15.0
"""s, length of a drive, and of a stop: braking, standing, some of both."""
CARS = ("paper", "midsize-sedan", "compact-ev", "small-car", "sports-car", "van")
KINDS = ("country", "mountain", "town", "lap")
NAN = math.nan


@dataclass(frozen=True)
class PositionNoise:
    """Noise of the positions (m), its time constant (s; 0: white), and what the filter is told over the truth."""

    position: float
    time: float
    told_share: float

    @classmethod
    def drawn(cls, seed: int) -> PositionNoise:
        """A noise for a drive; noises, kinds and shares take turns."""
        rng = np.random.default_rng((seed, 1))
        time = float(rng.choice([1.0, 5.0, 20.0])) if seed // 3 % 2 else 0.0
        return cls(float(np.exp(rng.uniform(np.log(0.03), np.log(0.3)))), time, (1.0, 0.5, 2.0)[seed // 6 % 3])


@dataclass
class Body:
    """A single track with an axle's force mu F_z sin(1.35 atan(C alpha/(1.35 mu F_z)))."""

    mass: float
    inertia: float
    lf: float
    lr: float
    front: float  # N/rad, of an axle
    rear: float
    lag: float
    dead_time: float
    rate: float
    limit: float
    bias: float
    friction: float
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0
    speed: float = 10.0
    vy: float = 0.0
    yaw_rate: float = 0.0
    angle: float = 0.0
    pull: float = 0.0  # m/s^2, lateral acceleration
    rear_share: float = 1.0  # of the rear axle's friction that is left
    sent: list[float] = field(default_factory=list)

    def step(self, command: float, gust: tuple[float, float]) -> None:
        """Go on by DT under a side force and moment over the mass (m/s^2, m^2/s^2)."""
        self.sent.append(command)
        acting = self.sent.pop(0) if len(self.sent) > round(self.dead_time / DT) else self.angle
        wanted = max(min(acting, self.limit), -self.limit) - self.angle
        most = self.rate * DT
        self.angle += max(min(wanted * min(DT / self.lag, 1.0), most), -most)
        v, length, g = self.speed, self.lf + self.lr, 9.81
        wheels = self.angle + self.bias
        if v > 2.0:
            front = self._force(self.front, self.lr, 1.0, wheels - math.atan2(self.vy + self.lf * self.yaw_rate, v))
            rear = self._force(self.rear, self.lf, self.rear_share, -math.atan2(self.vy - self.lr * self.yaw_rate, v))
            self.pull = (front * math.cos(wheels) + rear) * g / length + gust[0]
            turning = (self.lf * front - self.lr * rear) * g / length * self.mass + gust[1] * self.mass
            self.vy += (self.pull - v * self.yaw_rate) * DT
            self.yaw_rate += turning / self.inertia * DT
        else:
            self.yaw_rate = v * math.tan(wheels) / length
            self.vy, self.pull = self.lr * self.yaw_rate, v * self.yaw_rate
        self.x += (v * math.cos(self.yaw) - self.vy * math.sin(self.yaw)) * DT
        self.y += (v * math.sin(self.yaw) + self.vy * math.cos(self.yaw)) * DT
        self.yaw += self.yaw_rate * DT

    def _force(self, stiffness: float, arm: float, share: float, slip: float) -> float:
        """Of an axle, over its part of the car's weight: so that its load times it, over the weight, is the force."""
        friction = self.friction * share
        load = self.mass * 9.81 * arm / (self.lf + self.lr)
        return friction * arm * math.sin(1.35 * math.atan(stiffness * slip / (1.35 * friction * load)))


@dataclass(frozen=True)
class Sample:
    """What the sensors say of an instant."""

    t: float
    x: float
    y: float
    yaw: float
    speed: float
    yaw_rate: float
    vy: float
    pull: float
    wheel: float


def _with(**changes: Callable[[Sample], float]) -> Callable[[Sample], Sample]:
    return lambda s: Sample(**{**s.__dict__, **{name: change(s) for name, change in changes.items()}})


DEGREES = 180.0 / math.pi


@dataclass(frozen=True)
class Lie:
    """A pose that goes wrong: from an instant (s) on it drifts by so much a second, or has jumped."""

    begins: float
    yaw_rate: float = 0.0  # rad/s
    y_rate: float = 0.0  # m/s
    jump: tuple[float, float] = (0.0, 0.0)  # m, of x and y

    @staticmethod
    def drawn(name: str, rng: np.random.Generator) -> Lie:
        begins, side = float(rng.uniform(5.0, 20.0)), float(rng.choice([-1.0, 1.0]))
        if name == "yaw drifts":
            return Lie(begins, yaw_rate=side * math.radians(float(rng.uniform(1.0, 10.0))))
        if name == "y drifts":
            return Lie(begins, y_rate=side * float(rng.uniform(0.5, 2.0)))
        size, angle = float(rng.uniform(1.5, 10.0)), float(rng.uniform(0.0, math.tau))
        return Lie(begins, jump=(size * math.cos(angle), size * math.sin(angle)))

    def told(self, s: Sample) -> Sample:
        since = s.t - self.begins
        if since < 0.0:
            return s
        return _with(
            x=lambda s: s.x + self.jump[0],
            y=lambda s: s.y + self.jump[1] + self.y_rate * since,
            yaw=lambda s: math.remainder(s.yaw + self.yaw_rate * since, math.tau),
        )(s)


@dataclass(frozen=True)
class Fault:
    """A wrong input: what is made of the samples, and of the command."""

    sample: Callable[[Sample], Sample] = lambda s: s
    command: float = 1.0
    ahead: float = 0.0  # of the wheelbase: the place whose position is taken, from the centre of mass
    clock: float = 1.0  # factor on all times
    late: tuple[str, ...] = ()  # what comes from a clock 0.2 s off
    named: tuple[str, ...] = ()  # words one of which must be in the sentence
    slow: bool = False  # driven at 2 to 10 m/s
    lie: str = ""  # what of the pose drifts or jumps from an instant on


_mirrored = _with(
    yaw=lambda s: -s.yaw, yaw_rate=lambda s: -s.yaw_rate, vy=lambda s: -s.vy, pull=lambda s: -s.pull,
    wheel=lambda s: -s.wheel,
)  # fmt: skip
FAULTS = {
    "steering sign": Fault(command=-1.0, named=("steering",)),
    "NED with its path": Fault(_with(wheel=lambda s: -s.wheel), -1.0, named=("steering",)),
    "y mirrored with its path": Fault(_mirrored, -1.0, named=("mirrored",)),
    "yaw rate's sign": Fault(_with(yaw_rate=lambda s: -s.yaw_rate), named=("yaw_rate",)),
    "lateral signs": Fault(_with(vy=lambda s: -s.vy, pull=lambda s: -s.pull), named=("lateral",)),
    "yaw in degrees": Fault(_with(yaw=lambda s: s.yaw * DEGREES), named=("yaw is in degrees",)),
    "yaw from north": Fault(_with(yaw=lambda s: 0.5 * math.pi - s.yaw), named=("north",)),
    "speed in km/h": Fault(_with(speed=lambda s: 3.6 * s.speed), named=("km/h",)),
    "time in ms": Fault(clock=1e3, named=("milliseconds",)),
    "yaw rate in deg/s": Fault(_with(yaw_rate=lambda s: DEGREES * s.yaw_rate), named=("yaw rate is in degrees",)),
    "command taken as degrees": Fault(command=1.0 / DEGREES, named=("command",)),
    "command sent in degrees": Fault(command=DEGREES, named=("command",)),
    "rear axle": Fault(ahead=-1.0, named=("rear axle",)),
    "front axle": Fault(ahead=1.0, named=("front axle",)),
    "gyro's clock": Fault(late=("yaw_rate",), named=("late",)),
    "pose's clock": Fault(late=("x", "y", "yaw"), named=("late",)),
    "speed's clock": Fault(late=("speed",), named=("late",)),
    **{
        f"command times {factor:.3g}": Fault(command=factor, named=("command",), slow=True)
        for factor in (DEGREES, 16.0, 4.0, 0.25, 1.0 / 16.0, 1.0 / DEGREES)
    },
    **{name: Fault(lie=name, named=("pose", "x, y", "yaw")) for name in ("yaw drifts", "y drifts", "pose jumps")},
}
KEEPS = frozenset({"rear axle", "front axle", "gyro's clock", "pose's clock", "speed's clock", "lateral signs",
                   "yaw rate's sign"})  # fmt: skip
"""Faults with which the car may stay on its path."""


@dataclass
class Driven:
    """What a drive leaves."""

    rows: list[tuple[float, ...]]  # arguments of the tracker, its command, then distance and sideslip
    said: list[tuple[float, float, str]]  # t, distance, sentence
    statuses: list[tuple[float, str]]
    about: str = ""
    begins: float = 0.0  # s, of a lie

    @property
    def farthest(self) -> float:
        return max(abs(row[-2]) for row in self.rows)


def draw(
    seed: int, noise: PositionNoise | None = None
) -> tuple[np.random.Generator, Body, at.Vehicle, at.Profile, at.MPC, str]:
    """A car, its controller and its world."""
    rng = np.random.default_rng(seed)
    profile = at.load_profile(("road", "production")[seed % 2])
    friction = float(rng.uniform(0.4, 1.0))
    if rng.random() < 0.5:
        vehicle, steering, source = at.load_vehicle(str(rng.choice(CARS))), profile.steering, "shipped"
    else:
        drawn = random_car(int(rng.integers(1_000_000)), profile=profile)
        vehicle, steering, source = drawn.vehicle, drawn.profile.steering, "random"
    body = Body(
        vehicle.mass, vehicle.yaw_inertia, vehicle.lf, vehicle.lr,
        2.0 * vehicle.stiffness_front, 2.0 * vehicle.stiffness_rear, max(steering.lag, 0.02),
        steering.dead_time + 0.01, steering.rate, steering.limit, float(rng.uniform(-0.02, 0.02)), friction,
    )  # fmt: skip
    told_profile = profile
    if noise is not None:
        profile = profile.replace(noise_y=noise.position)
        told_profile = profile.replace(noise_y=noise.position * noise.told_share)
    sensors = replace(at.KalmanFilter.from_profile(told_profile), oldest=0.35)
    if rng.random() < 0.7:
        sheet = at.vehicle_from_data_sheet("sheet", min(max(vehicle.mass, 600.0), 3500.0), vehicle.wheelbase)
        mpc = at.MPC(sheet, profile=profile, estimator=sensors, belief="unknown", learning=at.Learning())
        source += ", learning from a sheet"
    else:
        known = at.Steering(lag=steering.lag, dead_time=steering.dead_time)
        mpc = at.MPC(vehicle, profile=profile, estimator=sensors, belief=known)
    return rng, body, vehicle, profile, mpc, source


def drive(seed: int, fault: Fault | None = None, seconds: float = HONEST, slide: bool = False, noisy: bool = False,
) -> Driven:  # fmt: skip
    """One drive; with a fault it ends 3.5 m from the path."""
    noise = PositionNoise.drawn(seed) if noisy else None
    rng, body, vehicle, profile, mpc, source = draw(seed, noise)
    kind = str(rng.choice(KINDS))
    length = 1500.0 if seconds <= WRONG else 4000.0
    road = at.generate_road(kind, int(rng.integers(1_000_000)), length=1500.0 if kind == "lap" else length)
    lateral = float(rng.uniform(1.5, 3.5)) * min(1.0, body.friction / 0.8)
    everyday = fault is None and not slide
    slow = fault.slow if fault is not None else everyday and seed % 3 == 0
    top = float(rng.uniform(2.0, 10.0)) if slow else 30.0
    stops = float(rng.uniform(10.0, 60.0)) if everyday and seed % 4 == 1 else math.inf
    plan = at.plan_speed(road, vehicle, Comfort(lateral=lateral, accelerate=1.5, brake=2.0), top_speed=top)
    tracker = at.Tracker(mpc, road, plan=plan if rng.random() < 0.5 else None)
    s = float(rng.uniform(5.0, 200.0))
    place = road.at(s)
    body.speed = float(plan.at(s))
    body.x, body.y, body.yaw = float(place.x), float(place.y), float(place.heading)
    body.yaw_rate = body.speed * float(place.curvature)
    body.angle = math.atan(float(place.curvature) * vehicle.wheelbase) - body.bias
    about = f"{source} {vehicle.name}, {kind}, mu {body.friction:.2f}, {profile.name}{f', {noise}' if noise else ''}"
    driven = Driven([], [], [], about)
    sensors = _Sensors(rng, profile, body, fault or Fault(), noise)
    driven.begins = sensors.lie.begins if sensors.lie else 0.0
    engaged = body.angle if rng.random() < 0.5 else None
    late = profile.name == "road" and rng.random() < 0.3
    lost = int(rng.choice([0, 0, 7]))
    slides = float(rng.uniform(4.0, 25.0)) if slide else math.inf
    command, due, near, gust, turned, told = body.angle, 0.0, s, 0.0, 0.0, set()
    size, time, lever = float(rng.uniform(0.0, 0.5)), float(rng.uniform(1.0, 5.0)), float(rng.uniform(-0.5, 0.5))
    wander = size * math.sqrt(2.0 * DT / time)
    for k in range(round(seconds / DT)):
        t = k * DT
        if t >= due - 1e-9:
            foot = foot_near(road, body.x, body.y, near)
            near = float(foot.s)
            sideslip = math.atan2(body.vy, body.speed)
            if abs(foot.offset) > (10.0 if fault is None else 3.5):
                break
            if (not road.closed and near > road.length - 20.0) or math.isnan(foot.offset):
                break
            _set_speed(body, 0.0 if stops <= t < stops + STANDS else float(plan.at(near)))
            if slide:
                slipping = t >= slides and abs(body.yaw_rate * body.speed) > 1.0
                turned = turned or (t if slipping else 0.0)
                body.rear_share = 0.15 if turned and t < turned + 2.0 else 1.0
                if turned and (t > turned + 4.0 or abs(foot.offset) > 8.0):
                    break
            due += PERIOD * (rng.uniform(0.6, 1.4) if late else 1.0)
            given = sensors.arriving(t, late)
            if lost and k % (lost * 5) == 0 and k:
                given = None
            if given is not None:
                clock = fault.clock if fault else 1.0
                first = not driven.rows and engaged is not None
                row = (clock * given.t, clock * t, given.x, given.y, given.yaw, given.speed, given.yaw_rate, given.vy,
                       given.pull, engaged if first else given.wheel)  # fmt: skip
                out = step(tracker, row)
                command = out.command
                driven.rows.append((*row, command, float(foot.offset), sideslip))
                driven.statuses.append((t, str(out.status)))
                for words in getattr(out, "suspect", ()):
                    if words not in told:
                        told.add(words)
                        driven.said.append((t, abs(float(foot.offset)), words))
        gust += -gust * DT / time + wander * rng.normal()
        body.step((fault.command if fault else 1.0) * command, (gust, lever * gust))
    return driven


def step(tracker: at.Tracker, row: tuple[float, ...]) -> at.control.tracker.Tracked:
    """A call with a row of a drive."""
    t, now, x, y, yaw, speed, yaw_rate, vy, pull, wheel = row
    return tracker.step(t, x, y, yaw, speed, yaw_rate, lateral_velocity=vy, lateral_acceleration=pull,
                        wheel_angle=wheel, now=now)  # fmt: skip


def _set_speed(body: Body, speed: float) -> None:
    """Approach a speed (m/s) by at most 3 m/s^2."""
    body.speed += max(min(speed - body.speed, 3.0 * PERIOD), -3.0 * PERIOD)


class _Sensors:
    """Samples with the noise, the offsets and the lateness of a profile."""

    def __init__(
        self, rng: np.random.Generator, profile: at.Profile, body: Body, fault: Fault, noise: PositionNoise | None
    ) -> None:
        self.rng, self.profile, self.body, self.fault = rng, profile, body, fault
        self.memory = math.exp(-PERIOD / noise.time) if noise and noise.time else 0.0  # of the noise of the position
        self.position_noise = rng.normal(size=2) if noise else np.zeros(2)
        self.gyro = float(rng.uniform(-1.0, 1.0)) * max(profile.bias_yaw_rate, 0.002)
        self.wheel = float(rng.uniform(-1.0, 1.0)) * profile.bias_wheel_angle
        self.mounting = float(rng.uniform(-0.01, 0.01))  # rad, of the yaw
        self.kept: list[Sample] = []
        self.gap, self.next_gap = -1.0, float(rng.exponential(10.0))
        self.lie = Lie.drawn(fault.lie, rng) if fault.lie else None

    def _sense(self, t: float) -> Sample:
        p, rng, b = self.profile, self.rng, self.body
        noise = rng.normal(size=8)
        noise[:2] = self.memory * self.position_noise + math.sqrt(1.0 - self.memory**2) * noise[:2]
        self.position_noise = noise[:2].copy()
        ahead = self.fault.ahead * (b.lf if self.fault.ahead > 0 else b.lr)
        speed_noise = p.noise_speed if math.isfinite(p.noise_speed) and p.noise_speed else 0.003
        return Sample(
            t, b.x + ahead * math.cos(b.yaw) + p.noise_y * noise[0],
            b.y + ahead * math.sin(b.yaw) + p.noise_y * noise[1],
            math.remainder(b.yaw + self.mounting + p.noise_yaw * noise[2], math.tau),
            b.speed * (1.0 + speed_noise * noise[3]), b.yaw_rate + self.gyro + p.noise_yaw_rate * noise[4],
            b.vy + p.noise_vy * noise[5] if math.isfinite(p.noise_vy) else NAN,
            b.pull + p.noise_lateral_acceleration * noise[6] if p.name == "production" else NAN,
            b.angle + self.wheel + p.noise_wheel_angle * noise[7] if p.name == "production" else NAN,
        )  # fmt: skip

    def arriving(self, t: float, late: bool) -> Sample | None:
        """The newest sample that is there."""
        self.kept.append(self._sense(t))
        age = self.profile.pose_age + self.profile.pose_age_spread * self.rng.uniform(-1.0, 1.0)
        age = self.rng.uniform(0.05, 0.15) if late else age if self.profile.pose_age > 0.0 else 0.0
        there = [each for each in self.kept if each.t <= t - age + 1e-9]
        del self.kept[:-20]
        if not there:
            return None
        given = there[-1] if self.lie is None else self.lie.told(there[-1])
        if self.fault.late:
            older = [each for each in self.kept if each.t <= given.t - 0.2 + 1e-9] or self.kept[:1]
            given = Sample(**{**given.__dict__, **{name: getattr(older[-1], name) for name in self.fault.late}})
        if self.profile.dropout_most > 0.0 and t > self.next_gap:
            self.gap = t + self.rng.uniform(self.profile.dropout_least, self.profile.dropout_most)
            self.next_gap = self.gap + self.rng.exponential(self.profile.dropout_pause)
        if t < self.gap:
            given = Sample(**{**given.__dict__, "x": NAN, "y": NAN, "yaw": NAN})
        return self.fault.sample(given)


# -- the three campaigns ----------------------------------------------------------------------------------------------
def wrong(seeds: range, faults: list[str]) -> None:
    """Print when each fault was said."""
    print("| wrong input | said | before 1 m, or never 1 m off | before 1 m or within 3 s | before 3 m | named rightly "
          "| median (90 %), s |")  # fmt: skip
    for name in faults:
        fault, rows = FAULTS[name], [drive(seed, FAULTS[name], WRONG) for seed in seeds]
        said = [each.said[0] if each.said else None for each in rows]
        count = len(rows)
        soon = sum(s[1] < 1.0 or s[0] < 3.0 if s else each.farthest < 1.0 for s, each in zip(said, rows, strict=True))
        early = sum((s[1] < 1.0) if s else each.farthest < 1.0 for s, each in zip(said, rows, strict=True))
        in_time = sum((s[1] < 3.0) if s else each.farthest < 3.0 for s, each in zip(said, rows, strict=True))
        right = sum(any(word in s[2] for word in fault.named) for s in said if s)
        times = [s[0] for s in said if s] or [NAN]
        print(
            f"| {name} | {len(times) if any(said) else 0} of {count} | {early} | {soon} | {in_time} | {right} | "
            f"{np.median(times):.2f} ({np.quantile(times, 0.9):.2f}) |", flush=True,
        )  # fmt: skip


def lies(seeds: range) -> None:
    """Print how many poses that drift or jump took the car 1.5 m from its path, and how many of them without a word."""
    print("| the pose | lost | lost silently | median (90 %), s after it began |")
    for name in ("yaw drifts", "y drifts", "pose jumps"):
        lost = silent = 0
        times = []
        for seed in seeds:
            result = drive(seed, FAULTS[name], WRONG)
            told = min([t for t, *_ in result.said] + [t for t, status in result.statuses if status == "sliding"],
                       default=math.inf)  # fmt: skip
            far = [t for (t, _), row in zip(result.statuses, result.rows, strict=True) if abs(row[-2]) > 1.5]
            if far and far[0] < result.begins:
                continue  # without the lie
            times.append(told - result.begins)
            lost += bool(far)
            silent += bool(far) and told > far[0]
        median, most = np.median(times), np.quantile(times, 0.9)
        print(f"| {name} | {lost} of {len(times)} | {silent} | {median:.2f} ({most:.2f}) |", flush=True)


def honest(seeds: range, noisy: bool) -> None:
    """Print every word that was said, and how many drives had one."""
    words: Counter[str] = Counter()
    falsely = sliding = lost = 0
    for count, seed in enumerate(seeds, 1):
        each = drive(seed, noisy=noisy)
        falsely += bool(each.said)
        lost += each.farthest > 3.0
        slipped = max(abs(row[-1]) for row in each.rows)
        if any(status == "sliding" for _, status in each.statuses) and slipped < math.radians(7.0):
            sliding += 1
        for t, _, sentence in each.said:
            words[sentence.split(":")[0]] += 1
            print(f"  seed {seed} ({each.about}), {t:.1f} s, off {each.farthest:.1f} m: {sentence}", flush=True)
        if count % 100 == 0 or count == len(seeds):
            print(f"{count} drives: {falsely} with a word, {sliding} with sliding below 7 deg, {lost} off by 3 m",
                  flush=True)  # fmt: skip
    print(dict(words))


def sliding(seeds: range) -> None:
    """Print the time from 10 degrees of sideslip until it is said."""
    times: dict[bool, list[float]] = {True: [], False: []}
    for seed in seeds:
        each = drive(seed, None, WRONG, slide=True)
        slipping = [i for i, row in enumerate(each.rows) if abs(row[-1]) > math.radians(10.0)]
        if not slipping:
            continue
        began = each.statuses[slipping[0]][0]
        if each.statuses[-1][0] < began + 0.5:
            continue
        told = [t for t, status in each.statuses if status == "sliding"]
        times[math.isfinite(each.rows[0][7])].append(told[0] - began if told else math.inf)
    for known, most in ((True, 0.5), (False, 1.0)):
        found = np.array(times[known])
        print(f"v_y {'known' if known else 'not known'}: {np.sum(found <= most)} of {found.size} within {most} s; "
              f"median {np.median(found):.2f}, 95 % {np.quantile(found, 0.95):.2f} s", flush=True)  # fmt: skip


def main() -> None:
    """Run a campaign."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("campaign", choices=("wrong", "lies", "honest", "sliding"))
    parser.add_argument("--drives", type=int, default=10)
    parser.add_argument("--faults", default=",".join(FAULTS))
    parser.add_argument("--noisy", action="store_true", help="honest: positions with much noise")
    parser.add_argument("--tuning", action="store_true", help="seeds on which the checks were chosen")
    parser.add_argument("--first", type=int, default=0, help="of the seeds")
    given = parser.parse_args()
    logging.getLogger("adaptrack").setLevel(logging.CRITICAL)
    start = (TUNING if given.tuning else JUDGED) + given.first
    seeds = range(start, start + given.drives)
    if given.campaign == "wrong":
        wrong(seeds, [name for name in given.faults.split(",") if name])
    else:
        campaigns = {"lies": lies, "honest": lambda seeds: honest(seeds, given.noisy), "sliding": sliding}
        campaigns[given.campaign](seeds)


if __name__ == "__main__":
    main()
