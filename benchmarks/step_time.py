"""How long a step of the MPC takes: compiled, and from Python.

    python benchmarks/step_time.py [--drives 20] [--vehicle paper] [--json]

What the controller was given on random drives is given to it again. CPU time of the thread, in microseconds, less what
an empty measurement takes; of each step the least of five repeats of the drive, so that other work on the machine does
not count. The compiled step is called from Python as well.
"""

from __future__ import annotations

import argparse
import gc
import json
import time
from collections.abc import Callable
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.scenario import random_drive

FIRST, REPEATS = 9_300_000, 5


class Recording(at.MPC):
    """Keeps what it is given."""

    def reset(self) -> None:
        """Forget the past."""
        self.given: list[tuple[Any, float, Any]] = []
        super().reset()

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None) -> Any:
        """As the MPC."""
        self.given.append((np.array(state), speed, np.array(reference[:64])))
        return super().step(state, speed, reference, variables)


def controllers(car: Any) -> dict[str, tuple[str, Callable[[type], Any]]]:
    """Name -> the profile that it drives in, and how to make one of a class."""
    return {
        "informed, road": ("road", lambda kind: kind(car, profile="road")),
        "informed, production": ("production", lambda kind: kind(car, profile="production")),
        "published, paper": ("paper", lambda kind: published(kind, car)),
    }


def published(kind: type, car: Any) -> Any:
    """The paper's MPC."""
    paper = at.published_mpc(car)
    return kind(car, model=paper.model, estimator=paper.estimator)


def times_of(step: Callable[..., Any], given: list[Any], write: Callable[..., None] | None = None) -> Any:
    """CPU microseconds of each call (calls,); write: takes its arguments before the clock starts."""
    found, clock = np.empty(len(given)), time.thread_time_ns
    empty = np.median([clock() - clock() for _ in range(2000)])
    gc.collect()
    gc.disable()
    for i, (state, speed, reference) in enumerate(given):
        call: tuple[Any, ...] = (state, speed, reference)
        if write is not None:
            write(*call, None, None)
            call = ()
        begun = clock()
        step(*call)
        found[i] = clock() - begun
    gc.enable()
    return (found + empty) / 1e3


def measure(name: str, car: Any, drives: int) -> dict[str, Any]:
    """The percentiles of one controller."""
    profile, make = controllers(car)[name]
    python, compiled = [], []
    for number in range(drives):
        recorder = make(Recording)
        at.simulate(at.DualTrack(car), recorder, random_drive(FIRST + number), profile=profile, seed=number)
        given, again = recorder.given, [make(at.MPC) for _ in range(2 * REPEATS)]
        python.append(np.min([times_of(mpc.step, given) for mpc in again[:REPEATS]], axis=0))
        compiled.append(np.min([times_of(mpc._compiled_step(), given, mpc._take) for mpc in again[REPEATS:]], axis=0))
    row: dict[str, Any] = {"controller": name, "steps": int(sum(map(len, python)))}
    for where, found in (("python", np.concatenate(python)), ("compiled", np.concatenate(compiled))):
        for label, share in (("p50", 50.0), ("p99", 99.0), ("p99.9", 99.9)):
            row[f"{where}_{label}_us"] = round(float(np.percentile(found, share)), 2)
    return row


def main() -> None:
    """Print a row for each controller."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--drives", type=int, default=20)
    parser.add_argument("--vehicle", default="paper")
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    car = at.load_vehicle(options.vehicle)
    rows = [measure(name, car, options.drives) for name in controllers(car)]
    if options.json:
        print(json.dumps({"rows": rows}))
        return
    for row in rows:
        print("  ".join(f"{key} {value}" for key, value in row.items()))


if __name__ == "__main__":
    main()
