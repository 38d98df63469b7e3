"""Drives one after the other, in processes that a hanging call cannot hold up, and the report."""

from __future__ import annotations

import math
import os
import pickle
import signal
import sys
import tempfile
import time
from collections import Counter, defaultdict
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from tools.fuzz.inputs import Rng
from tools.fuzz.speed.claims import JUDGED, Figures, Finding, Judge
from tools.fuzz.speed.drives import PERIOD, SHARES, Drive, draw_drive
from tools.fuzz.speed.faults import Sample, Spoiler
from tools.fuzz.speed.shorten import simplest
from tools.fuzz.speed.ways import BothWays, CWay, Libraries, TrackerWay
from tools.fuzz.speed.world import SUBSTEP, World

TIME_LIMIT = 60.0
"""s of processor time for a drive, which needs less than 1 s."""
DRIVES_EACH = 50
"""Of a process."""
LOST = 9.0, 1.2
"""m, rad: a car so far from its path has lost it, and the drive ends."""
DRIVER_MARGIN = 0.5
"""m/s, by which a driver is faster than the plan at most."""
POSITION_AGE = 0.5
"""s, of a position that counts."""
ARRIVED = 15.0
"""s at the end of a path, after which a drive ends."""


class Outcome(NamedTuple):
    """Result of a drive."""

    number: int
    kind: str
    fault: str
    findings: list[Finding]
    figures: Figures
    is_lost: bool = False
    differences: int = 0
    sensors: str = "prompt"


Row = Callable[[World, Sample, Any, str], None]


class Run:
    """A drive through one of the ways."""

    def __init__(self, drive: Drive, way: Any, show: Row | None = None) -> None:
        self.drive, self.way, self.show = drive, way, show
        self.world = World(drive)
        self.judge = Judge(drive, self.world)
        self._events = list(drive.events)
        self._route, self._driven_until, self._silent_until = 0, -math.inf, -math.inf
        self._spoilers: dict[int, Spoiler] = {}
        self._rng: Rng = np.random.default_rng([drive.seed, drive.number, 2])
        self._arrived = self._wish = 0.0

    def finish(self) -> Outcome:
        """Drive to the end."""
        drive, world, judge = self.drive, self.world, self.judge
        is_lost, jitter = False, drive.sensors.jitter
        try:
            for _ in range(drive.steps):
                self._take_events()
                self._call()
                due = world.elapsed + PERIOD + jitter * float(self._rng.uniform(-1.0, 1.0))
                if world.elapsed < self._silent_until:
                    world.advance(self._silent_until)
                    judge.excuse()
                else:
                    world.advance(max(round(due / SUBSTEP), round(world.elapsed / SUBSTEP) + 1) * SUBSTEP)
                is_lost = abs(world.offset) > LOST[0] or abs(world.heading_error) > LOST[1]
                if is_lost or self._has_arrived():
                    break
        except InvalidInput as error:
            judge.find("error", str(error))
        return Outcome(
            drive.number, drive.kind, drive.fault, judge.findings, judge.figures, is_lost,
            getattr(self.way, "differences", 0),
            drive.sensors.kind,
        )  # fmt: skip

    def _has_arrived(self) -> bool:
        is_there = not self.world.closed and self.world.station > self.world.length - 1.5 and self.world.speed == 0.0
        self._arrived = self._arrived + PERIOD if is_there else 0.0
        return self._arrived > ARRIVED and not self._events

    def _take_events(self) -> None:
        world, judge = self.world, self.judge
        while self._events and self._events[0].time <= world.elapsed:
            event = self._events.pop(0)
            if event.name == "engage":
                self.way.engage(0.0)
            elif event.name == "follow":
                number = self._route if event.number < 0.0 else int(event.number)
                begins = world.length - self.drive.routes[number].road.length if number == 2 else -1e9
                if world.station > begins + 5.0:
                    self._route = number
                    self.way.follow(number)
                    judge.follow(number)
            elif event.name == "release":
                if self.way.release():
                    judge.released()
            elif event.name == "driver":
                self._driven_until, self._wish = world.elapsed + event.duration, event.number
            else:
                self._silent_until = world.elapsed + event.duration
        is_driven = world.elapsed < self._driven_until
        world.driver_target = min(self._wish, judge.top() + DRIVER_MARGIN) if is_driven else math.nan

    def _call(self) -> None:
        world, judge = self.world, self.judge
        is_driven = not math.isnan(world.driver_target)
        sample, faults = world.sample(is_driven), []
        for k, episode in enumerate(self.drive.episodes):
            if episode.start <= world.elapsed < episode.end:
                seed = [self.drive.seed, self.drive.number, 3, k]
                if k not in self._spoilers:
                    self._spoilers[k] = Spoiler(episode.size, np.random.default_rng(seed), dict(sample))
                episode.fault.effect(sample, self._spoilers[k])
                faults.append(episode.name)
        if faults:
            judge.sensor_fails()
        answer = self.way.step(sample)
        world.request(answer.force, answer.hold, answer.command)
        age = sample["now"] - sample["t"]
        has_position = all(map(math.isfinite, (sample["x"], sample["y"], sample["yaw"]))) and age < POSITION_AGE
        judge.step(answer, is_driven, has_position)
        if self.show is not None:
            self.show(world, sample, answer, ", ".join(faults) or ("driver" if is_driven else ""))


# -- many drives ------------------------------------------------------------------------------------------------------
def make_way(drive: Drive, name: str, libraries: Libraries) -> Any:
    """The way by its name: `c`, `tracker` or `both`."""
    if name == "tracker":
        return TrackerWay(drive)
    return {"c": CWay, "both": BothWays}[name](drive, libraries.library(drive))


def run_drive(seed: int, number: int, way: str, libraries: Libraries, show: Row | None = None) -> Outcome:
    """Run a drive."""
    drive = draw_drive(seed, number)
    try:
        return Run(drive, make_way(drive, way, libraries), show).finish()
    except InvalidInput as error:
        return Outcome(number, drive.kind, drive.fault, [Finding("error", 0.0, str(error))], Figures())


def outcomes(seed: int, way: str, steps: int, folder: Path) -> Iterator[Outcome]:
    """Run drives until they have so many steps. A drive that crashes or hangs ends its process alone."""
    libraries, number, done = Libraries(folder), 0, 0
    if way != "tracker":  # before the processes that use them
        _make_libraries(seed, libraries)
    while done < steps:
        for outcome in _run_in_child(seed, number, way, libraries):
            yield outcome
            number, done = outcome.number + 1, done + outcome.figures.steps
            if done >= steps:
                return


def _make_libraries(seed: int, libraries: Libraries) -> None:
    """Make the libraries that the first drives need."""
    for number in range(DRIVES_EACH):
        libraries.library(draw_drive(seed, number))


def _run_in_child(seed: int, first: int, way: str, libraries: Libraries) -> Iterator[Outcome]:
    """Run some drives in a process of their own, up to the first one that ends it."""
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        with suppress(BrokenPipeError), os.fdopen(writer, "wb") as pipe:  # the reader has enough
            for number in range(first, first + DRIVES_EACH):
                signal.setitimer(signal.ITIMER_VIRTUAL, TIME_LIMIT)  # its signal ends a process
                pickle.dump(run_drive(seed, number, way, libraries), pipe)
                pipe.flush()
        os._exit(0)
    os.close(writer)
    number = first
    with os.fdopen(reader, "rb") as pipe:
        while number < first + DRIVES_EACH:
            try:
                outcome = pickle.load(pipe)
            except EOFError:
                break
            yield outcome
            number += 1
    _, status = os.waitpid(child, 0)
    if number < first + DRIVES_EACH:
        drive = draw_drive(seed, number)
        hung = os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGVTALRM
        text = "a call does not return" if hung else f"the process ended with status {status}"
        yield Outcome(number, drive.kind, drive.fault, [Finding("no answer", 0.0, text)], Figures(steps=drive.steps))


# -- the report -------------------------------------------------------------------------------------------------------
def again(seed: int, number: int, way: str) -> str:
    """The command that repeats a drive."""
    return f"python -m tools.fuzz speed --seed {seed} --drive {number} --way {way} --trace"


def lines_of(outcome: Outcome, seed: int, way: str) -> list[str]:
    """A line for each finding."""
    where = f"seed {seed} drive {outcome.number} [{outcome.kind}: {outcome.fault}]"
    return [
        f"{finding.claim.upper()} at {finding.time:.1f} s: {finding.text}; {where}; {again(seed, outcome.number, way)}"
        for finding in outcome.findings
    ]


def report(results: list[Outcome]) -> str:
    """Tables of what was found, by list and fault, and the figures of calm."""
    lines, groups = [], defaultdict(list)
    for outcome in results:
        groups[outcome.kind, outcome.fault if outcome.kind != "double" else "two faults"].append(outcome)
    claims = sorted({finding.claim for outcome in results for finding in outcome.findings})
    order = {kind: k for k, kind in enumerate(SHARES)}
    for (kind, fault), members in sorted(groups.items(), key=lambda item: (order[item[0][0]], item[0][1])):
        counts = Counter(finding.claim for outcome in members for finding in outcome.findings)
        worst = max(outcome.figures.worst_excess for outcome in members)
        longest = max(outcome.figures.excess_time for outcome in members)
        told = ", ".join(f"{counts[claim]} {claim}" for claim in claims if counts[claim]) or "-"
        steps = sum(outcome.figures.steps for outcome in members)
        lost = sum(outcome.is_lost for outcome in members)
        lines.append(
            f"{kind:8} {fault:32} {len(members):5} drives {steps:9,} steps {lost:4} lost, above the plan by at most "
            f"{worst:5.1f} m/s, longest {longest:5.1f} s beyond 1 m/s: {told}"
        )
    healthy = [outcome for outcome in results if outcome.kind == "healthy"]
    lines += _calm("healthy", healthy)
    for sensors in ("prompt", "late", "slow"):
        lines += _calm(f"healthy, {sensors} sensors", [outcome for outcome in healthy if outcome.sensors == sensors])
    for kind in SHARES:
        members = [outcome for outcome in results if outcome.kind == kind]
        counts = Counter(finding.claim for outcome in members for finding in outcome.findings)
        told = ", ".join(f"{counts[claim]} {claim}" for claim in claims if counts[claim]) or "no finding"
        lines.append(f"{kind}: {told} in {len(members)} drives")
    return "\n".join(lines)


def _calm(title: str, outcomes: list[Outcome]) -> list[str]:
    """How calm some drives are."""
    if not outcomes:
        return []
    healthy = [outcome.figures for outcome in outcomes]
    sums = {name: sum(getattr(figures, name) for figures in healthy) for name in Figures._fields[:-1]}
    errors = np.array([error for figures in healthy for error in figures.stop_errors] or [math.nan])
    speeds = [math.sqrt(f.speed_square / f.speed_steps) for f in healthy if f.speed_steps > 100]
    return [
        f"{title}: {sums['busy_seconds']:.0f} of {sums['seconds']:.0f} s "
        f"({sums['busy_seconds'] / max(sums['seconds'], 1):.3%}) with more than one change of throttle and brake, "
        f"{60.0 * sums['changes'] / max(sums['seconds'], 1):.2f} changes a minute",
        f"{title}: jerk of the request {math.sqrt(sums['jerk_square'] / max(sums['jerk_steps'], 1)):.3f} m/s^3 RMS; "
        f"speed less plan {math.sqrt(sums['speed_square'] / max(sums['speed_steps'], 1)):.3f} m/s RMS over all, "
        f"median {np.median(speeds) if speeds else math.nan:.3f} m/s of {len(speeds)} drives",
        f"{title}: {errors.size} stops, beyond them median {np.median(errors):+.3f} m, 90 % of the sizes "
        f"{np.quantile(np.abs(errors), 0.9):.3f} m, 99 % {np.quantile(np.abs(errors), 0.99):.3f} m, least "
        f"{errors.min():+.2f} m, largest {errors.max():+.2f} m",
    ]


def soak(steps: int, seed: int, way: str, show_each: int) -> int:
    """Run drives and print findings and report; 1 where a claim does not hold."""
    results: list[Outcome] = []
    shown: Counter[tuple[str, str]] = Counter()
    begun = told_at = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        for outcome in outcomes(seed, way, steps, Path(folder)):
            results.append(outcome)
            for line, finding in zip(lines_of(outcome, seed, way), outcome.findings, strict=True):
                shown[finding.claim, outcome.fault] += 1
                if shown[finding.claim, outcome.fault] <= show_each:
                    print(line, flush=True)
            if time.monotonic() - told_at > 20.0:
                told_at = time.monotonic()
                done = sum(other.figures.steps for other in results)
                print(f"{done:,} steps, {done / (told_at - begun):,.0f} a second", file=sys.stderr, flush=True)
    print(report(results))
    steps_done = sum(outcome.figures.steps for outcome in results)
    differences = sum(outcome.differences for outcome in results)
    found = sum(len(outcome.findings) for outcome in results)
    gripless = sum(outcome.figures.gripless_steps > 0 for outcome in results if outcome.kind in JUDGED)
    print(f"{gripless} drives of the lists healthy and visible were at the limit of grip sideways, see `claims`")
    if way == "both":
        print(f"{differences} of {steps_done:,} calls differ between the C library and Tracker")
    print(f"{steps_done:,} steps, {len(results)} drives, {found} findings")
    return int(found > 0 or differences > 0)


def trace(seed: int, number: int, way: str) -> int:
    """Run one drive, print its parts and its rows; 1 where a claim does not hold."""
    drive = draw_drive(seed, number)
    print(describe(drive))
    last: list[Any] = [None, -math.inf]

    def show(world: World, sample: Sample, answer: Any, remark: str) -> None:
        words = answer.words, remark
        if words == last[0] and world.elapsed < last[1] + 1.0:
            return
        last[:] = words, world.elapsed
        print(
            f"t {world.elapsed:6.2f} s {world.station:8.2f} (said {answer.station:8.2f}) d {world.offset:+.2f} "
            f"v {world.speed:+7.2f} (measured {sample['speed']:+.3g}) a {answer.acceleration:+.2f} "
            f"force {answer.force:7.0f} hold {answer.hold:6.0f} target {answer.target_speed:5.2f} "
            f"{answer.words}{' | ' + remark if remark else ''}"
        )

    with tempfile.TemporaryDirectory() as folder:
        outcome = run_drive(seed, number, way, Libraries(Path(folder)), show)
    print("\n".join(lines_of(outcome, seed, way)) or "all claims hold", outcome.figures, sep="\n")
    return int(bool(outcome.findings))


def shorten(seed: int, number: int, way: str) -> int:
    """Print the simplest drives that break the claims that a drive breaks."""
    drive = draw_drive(seed, number)
    with tempfile.TemporaryDirectory() as folder:
        libraries = Libraries(Path(folder))

        def found(candidate: Drive) -> dict[str, Finding]:
            findings = Run(candidate, make_way(candidate, way, libraries)).finish().findings
            return {finding.claim: finding for finding in findings}

        claims = found(drive)
        for claim in claims:
            last: list[Finding] = []

            def breaks(candidate: Drive, claim: str = claim, last: list[Finding] = last) -> float | None:
                finding = found(candidate).get(claim)
                last[:] = last if finding is None else [finding]
                return None if finding is None else finding.time

            plain, done = simplest(drive, breaks)
            print(f"{claim.upper()} at {last[0].time:.1f} s: {last[0].text}\n{describe(plain)}\nit needs none of: "
                  f"{'; '.join(done)}\n", flush=True)  # fmt: skip
    return int(bool(claims))


def describe(drive: Drive) -> str:
    """The parts of a drive."""
    plan, road = drive.routes[0].plan, drive.routes[0].road
    slope = ", ".join(f"{value:+.3f}" for value in drive.grade[1])
    return "\n".join([
        f"{drive.kind}: {drive.fault}; {drive.variant}; {drive.car.name}, {drive.true_car}",
        f"{drive.sensors}; clock {drive.clock:g} s",
        f"path {road.length:.1f} m{', a lap' if road.closed else ''}; start {drive.start}; {drive.comfort!r}",
        f"plan to {plan.speed.max():.1f} m/s, at its end {plan.speed[-1]:.1f}; "
        f"stops {[(round(stop.s, 2), stop.seconds) for stop in plan.stops]}",
        f"grade {slope}; of the map {', '.join(f'{value:+.3f}' for value in road.grade.value)}",
        f"events {[tuple(event) for event in drive.events]}",
        f"faults {[(round(e.start, 2), round(e.end, 2), e.name, e.size) for e in drive.episodes]}",
    ])  # fmt: skip
