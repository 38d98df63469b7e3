"""The simplest drive that still breaks a claim: parts of a drive are left out or made ordinary, one by one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from tools.fuzz.speed.drives import PERIOD, Drive, Route, Variant

REST = 2.0
"""s, that a drive goes on after the claim is broken."""
PLAIN_SENSORS = {"age": 0.0, "jitter": 0.0, "period": 0.0, "noise": 0.01, "is_signed": True, "has_grade": False,
                 "has_acceleration": False}  # fmt: skip
PLAIN_CAR = {"drive_gain": 1.0, "drive_lag": 0.1, "drive_dead_time": 0.0, "brake_gain": 1.0, "brake_lag": 0.1,
             "brake_dead_time": 0.0}  # fmt: skip


def _level(drive: Drive) -> Drive:
    routes = [Route(route.points, route.road.replace(grade=0.0), route.plan) for route in drive.routes]
    return _changed(drive, routes=routes, grade=(drive.grade[0], np.zeros(len(drive.grade[1]))))


def _changed(drive: Drive, **parts: object) -> Drive:
    """A copy with other parts, whose speed control is made anew."""
    return replace(drive, **parts)  # type: ignore[arg-type]


def simpler_drives(drive: Drive) -> Iterator[tuple[str, Drive]]:
    """Each drive that is simpler by one part, and the part."""
    for name in dict.fromkeys(event.name for event in drive.events):
        yield f"without {name}", _changed(drive, events=[event for event in drive.events if event.name != name])
    for k, event in enumerate(drive.events):
        yield (
            f"without {event.name} at {event.time:.1f} s",
            _changed(drive, events=[*drive.events[:k], *drive.events[k + 1 :]]),
        )
    for k, episode in enumerate(drive.episodes):
        rest = [*drive.episodes[:k], *drive.episodes[k + 1 :]]
        yield f"without {episode.name} at {episode.start:.1f} s", _changed(drive, episodes=rest)
        if episode.end - episode.start > 1.0:
            short = episode._replace(end=episode.start + 0.5 * min(episode.end - episode.start, 20.0))
            yield f"{episode.name} for half as long", _changed(drive, episodes=sorted([*rest, short]))
    for name, value in PLAIN_SENSORS.items():
        if getattr(drive.sensors, name) != value:
            yield f"{name} {value}", _changed(drive, sensors=drive.sensors._replace(**{name: value}))
    plain = drive.true_car._replace(**PLAIN_CAR, mass=drive.car.mass)
    if drive.true_car != plain:
        yield "ordinary car", _changed(drive, true_car=plain)
        for name in plain._fields:
            if getattr(plain, name) != getattr(drive.true_car, name):
                yield (
                    f"ordinary {name}",
                    _changed(drive, true_car=drive.true_car._replace(**{name: getattr(plain, name)})),
                )
    if np.any(drive.grade[1]) or np.any(drive.routes[0].road.grade.value):
        yield "level", _level(drive)
        along = drive.routes[0].road.grade
        yield "a true map", _changed(drive, grade=(along.s, along.value))
    if drive.clock:
        yield "a clock from 0 s", _changed(drive, clock=0.0)
    simple = Variant("pure-pursuit", drive.variant.knows_delays, 0.9)
    for variant in (simple, simple._replace(knows_delays=True)):
        if drive.variant != variant:
            yield f"{variant}", _changed(drive, variant=variant)


def simplest(drive: Drive, breaks: Callable[[Drive], float | None]) -> tuple[Drive, list[str]]:
    """The simplest drive that breaks a claim, and what it does without; breaks: when (s) a drive breaks it, or None."""
    at, done, is_simpler = breaks(drive), [], True
    assert at is not None, "the drive breaks no claim"
    tried: set[str] = set()
    while is_simpler:
        drive, is_simpler = _changed(drive, steps=min(drive.steps, round((at + REST) / PERIOD))), False
        for name, candidate in simpler_drives(drive):
            if name in tried:
                continue
            time = breaks(candidate)
            if time is None:
                tried.add(name)
                continue
            drive, at, is_simpler = candidate, time, True
            done.append(name)
            break
    return drive, done
