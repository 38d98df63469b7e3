"""Whether `identify` names what is wrong with a log, and whether it lets honest logs pass.

    python benchmarks/faulty_logs.py [--logs 100] [--seed 8000] [--ratio] [--json]

The logs are those of `identifying.py`, other seeds. Into each one fault at a time is put: a wrong sign, degrees, km/h,
milliseconds, a clock that is off; what is asked is whether the refusal names the fault. `--ratio` fits each log with
steering angles 30 % too large and too small: of those in which the log tells ln(ratio) within 0.08, how many are told
that the ratio is wrong; how many honest ones are not consistent, and why. Judged on seeds from 8000; the thresholds of
`identification.conventions`, `ratio` and `consistency` were looked at on seeds 7000 to 7099.
"""

from __future__ import annotations

import argparse
import json
import math
from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np
from identifying import made_log, told

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.identification import RandomCar, random_car
from adaptrack.identification.from_log import fitted, prepare
from adaptrack.identification.ratio import TELLS, gain_of

DEGREE, OFF, CLOCK = 180.0 / math.pi, 1.3, 0.2
"""Factor of a wrong ratio; s, of a clock that is off."""


def _late(log: Mapping[str, Any], name: str, late: float) -> dict[str, Any]:
    return dict(log) | {name: np.interp(log["time"] - late, log["time"], log[name])}


def faults(log: dict[str, Any], delay: float) -> dict[str, tuple[dict[str, Any], tuple[str, ...]]]:
    """The log with one fault each, and words of which one must stand in the refusal."""
    yaw = log | {"yaw": np.cumsum(np.gradient(log["time"]) * log["true_yaw_rate"])}
    yaw["yaw"] = yaw["yaw"] + 0.002 * np.random.default_rng(1).standard_normal(yaw["yaw"].size)
    lag = delay + 0.3
    return {
        "command flipped": (log | {"command": -log["command"]}, ("opposite signs",)),
        "yaw rate flipped": (log | {"yaw_rate": -log["yaw_rate"]}, ("opposite signs",)),
        "command in degrees": (log | {"command": DEGREE * log["command"]}, ("command=deg", "in degrees")),
        "yaw rate in degrees": (log | {"yaw_rate": DEGREE * log["yaw_rate"]}, ("yaw_rate=deg/s", "in degrees")),
        "angles in degrees": (
            log | {"command": DEGREE * log["command"], "yaw_rate": DEGREE * log["yaw_rate"]}, ("--units deg",),
        ),
        "speed in km/h": (log | {"speed": 3.6 * log["speed"]}, ("speed=km/h",)),
        "time in ms": (log | {"time": 1e3 * log["time"]}, ("time=ms",)),
        "gyro's clock off, with yaw": (_late(yaw, "yaw_rate", CLOCK), ("--late yaw_rate",)),
        "steering's clock off, yaw leads": (_late(log, "command", lag), ("runs ahead",)),
    }  # fmt: skip


def named(log: dict[str, Any], car: RandomCar, words: tuple[str, ...]) -> bool:
    """Whether the refusal of a log names its fault."""
    try:
        prepare({name: each for name, each in log.items() if name != "true_yaw_rate"}, told(car))
    except InvalidInput as error:
        return any(word in str(error) for word in words)
    return False


def log_of(seed: int) -> tuple[RandomCar, dict[str, Any]]:
    """A car and its honest log."""
    car = random_car(seed)
    log = made_log(car, False)
    kept = log["yaw_rate"]
    return car, log | {"true_yaw_rate": kept}


def ratio_of(seed: int) -> dict[str, Any]:
    """What is said of a log that is honest, and of one whose angles are off."""
    car, log = log_of(seed)
    log.pop("true_yaw_rate")
    honest = at.identify(log, told(car))
    likelihood = prepare(log, told(car))
    row: dict[str, Any] = {
        "seed": seed, "spread": gain_of(likelihood, fitted(likelihood)[0]).spread, "reasons": list(honest.reasons),
        "untold": any("cannot tell the ratio" in each for each in honest.findings),
    }  # fmt: skip
    for name, factor in (("large", OFF), ("small", 1.0 / OFF)):
        off = at.identify(log | {"command": factor * log["command"]}, told(car))
        row[name] = any("ratio is wrong" in each for each in off.reasons)
        row[f"{name} reasons"] = list(off.reasons)
        row[f"{name} untold"] = any("cannot tell the ratio" in each for each in off.findings)
    return row


def main() -> None:
    """Print shares."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--logs", type=int, default=100)
    ask.add_argument("--seed", type=int, default=8000)
    ask.add_argument("--ratio", action="store_true")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    seeds = range(given.seed, given.seed + given.logs)
    if given.ratio:
        rows = [ratio_of(seed) for seed in seeds]
        told_of = [row for row in rows if row["spread"] < TELLS]
        found: dict[str, Any] = {
            "logs": len(rows), "tell the ratio": len(told_of),
            "too large, named": float(np.mean([row["large"] for row in told_of])),
            "too small, named": float(np.mean([row["small"] for row in told_of])),
            "honest, not consistent": float(np.mean([bool(row["reasons"]) for row in rows])),
            "reasons": [(row["seed"], *row["reasons"]) for row in rows if row["reasons"]], "rows": rows,
        }  # fmt: skip
    else:
        hit: Counter[str] = Counter()
        missed: dict[str, list[int]] = {}
        for seed in seeds:
            car, log = log_of(seed)
            for name, (wrong, words) in faults(log, car.delay).items():
                right = named(wrong, car, words)
                hit[name] += right
                if not right:
                    missed.setdefault(name, []).append(seed)
            try:
                prepare({k: v for k, v in log.items() if k != "true_yaw_rate"}, told(car))
                hit["honest passes"] += 1
            except InvalidInput as error:
                missed.setdefault(f"honest passes: {error}", []).append(seed)
        found = {name: count / len(seeds) for name, count in hit.items()} | {"missed": missed}
    if given.json:
        print(json.dumps(found))
        return
    for name, value in found.items():
        if name != "rows":
            print(f"{name}: {value}")


if __name__ == "__main__":
    main()
