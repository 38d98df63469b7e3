"""Logs of real cars that are not ours: what `identify` says of them. Positions are never printed.

    python benchmarks/real_logs.py LOG.toml [...] [--json]

A LOG.toml says where logs of one car lie and how they are to be read; the logs belong to others and are not shipped:

    name = "..."; source = "..."; licence = "..."; logs = ["a.csv", "b.csv"]   # beside the file, CSV
    mass = 1791.6; wheelbase = 2.65        # kg, m: a data sheet
    known = {lf = 1.33}                    # what somebody else says of the car, printed beside
    [[reading]]                            # one run each
    label = "..."; ratio = "fit"           # or a number
    columns = {yaw_rate = "omega(rad/s)"}; leave_out = ["vy(m/s)"]   # columns of the file
    units = {yaw_rate = "deg/s"}; flip = ["yaw_rate"]

Each log alone, then all of a car together where `identify` takes several.
"""

from __future__ import annotations

import argparse
import json
import math
import time
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.identification.reading import Reading, read_columns

SHOWN = ("delay", "lag", "dead_time", "front", "rear", "lf", "ratio", "relaxation",
         "understeer_gradient", "lateness", "bank")  # fmt: skip
"""Estimates that are printed, where there are such."""
POSITIONS = ("x", "y")


def table(path: Path, how: Mapping[str, Any]) -> dict[str, np.ndarray]:
    """The columns of a CSV file by name, without those that a reading leaves out."""
    with path.open(encoding="utf-8") as file:
        header = file.readline().strip().split(",")
        values = np.loadtxt(file, delimiter=",", ndmin=2)
    return {name: values[:, i] for i, name in enumerate(header) if name not in how.get("leave_out", ())}


def reading_of(how: Mapping[str, Any]) -> Reading:
    """How a log is to be read."""
    return Reading(
        columns=how.get("columns", {}), units=how.get("units", {}), flip=tuple(how.get("flip", ())),
        steering_ratio=how.get("ratio"),
    )  # fmt: skip


def described(columns: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Length, rate, and the range of each signal; not of positions."""
    t = columns["time"][np.isfinite(columns["time"])]
    moving = columns["speed"] > 1.0
    found = {"samples": int(t.size), "seconds": float(t[-1] - t[0]), "rate": float(1.0 / np.median(np.diff(t)))}
    found["signals"] = {
        name: [float(each) for each in np.nanpercentile(values[moving], (1, 99))]
        for name, values in columns.items()
        if name not in ("time", *POSITIONS)
    }
    return found


def identified(
    logs: Sequence[Mapping[str, np.ndarray]], entry: Mapping[str, Any], how: Mapping[str, Any]
) -> dict[str, Any]:
    """What `identify` says, or why it refuses."""
    begun = time.perf_counter()
    given: Any = logs[0] if len(logs) == 1 else list(logs)
    try:
        found = at.identify(given, mass=entry["mass"], wheelbase=entry["wheelbase"], reading=reading_of(how))
    except (InvalidInput, TypeError) as error:  # of a version that takes one log only, too
        return {"refused": str(error), "took": time.perf_counter() - begun}
    estimates = {
        name: {"value": each.value, "low": each.low, "high": each.high, "before": list(each.before),
               "spread_left": each.spread_left}
        for name, each in found.estimates.items()
        if name in SHOWN
    }  # fmt: skip
    return {
        "estimates": estimates, "one_step": found.validation.one_step, "simulated": found.validation.simulated,
        "findings": list(found.findings), "consistent": getattr(found, "consistent", None),
        "reasons": list(getattr(found, "reasons", ())), "took": time.perf_counter() - begun,
    }  # fmt: skip


def steady_gradient(log: Mapping[str, np.ndarray], wheelbase: float) -> float:
    """deg/g, by least squares from means over a second: wheel angle less L r/v over v r, where v r is .5 to 5 m/s^2.

    J. Y. Wong, Theory of Ground Vehicles, section 5.2. NaN where no road wheel's angle is logged. Of `identify` it is
    independent; bank and a wrong ratio are in it.
    """
    steered = log.get("wheel", log.get("command"))
    if steered is None:
        return math.nan
    count = max(round(1.0 / float(np.median(np.diff(log["time"])))), 1)
    kept = steered.size // count * count
    angle, v, r = (each[:kept].reshape(-1, count).mean(1) for each in (steered, log["speed"], log["yaw_rate"]))
    used = (v > 10.0) & (np.abs(v * r) > 0.5) & (np.abs(v * r) < 5.0)
    if used.sum() < 10:
        return math.nan
    slope = np.polyfit((v * r)[used], (angle - wheelbase * r / v)[used], 1)[0]
    return gradient(float(slope))


def gradient(value: float) -> float:
    """deg/g of rad s^2/m."""
    return math.degrees(value) * 9.80665


def show(run: Mapping[str, Any], known: Mapping[str, float]) -> None:
    """Print what came out of a run."""
    if "refused" in run:
        print(f"    refused: {run['refused']}")
        return
    for name, each in run["estimates"].items():
        numbers = [each["value"], each["low"], each["high"], *each["before"]]
        if name == "understeer_gradient":
            name, numbers = "understeer gradient, deg/g", [gradient(number) for number in numbers]
        value, low, high, *before = (f"{number:.4g}" for number in numbers)
        others = f"  (elsewhere {known[name]:g})" if name in known else ""
        print(f"    {name:27s} {value:>8s} [{low}, {high}]  before {before[0]} to {before[1]}, "
              f"left {each['spread_left']:.2f}{others}")  # fmt: skip
    print(f"    explained one step ahead {run['one_step']:.1%}, simulated {run['simulated']:.1%}; {run['took']:.0f} s")
    if run["consistent"] is not None:
        print("    consistent" if run["consistent"] else "    NOT CONSISTENT: " + "; ".join(run["reasons"]))
    for sentence in run["findings"]:
        print(f"    - {sentence}")


def main() -> None:
    """Print what each reading of each log gives."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("files", nargs="+", type=Path)
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    answers = []
    for path in given.files:
        entry = tomllib.loads(path.read_text(encoding="utf-8"))
        if not given.json:
            print(f"{entry['name']}\n  {entry['licence']}; {entry['source']}")
        for how in entry.get("reading", [{}]):
            sources = [path.parent / name for name in entry["logs"]]
            logs = [table(source, how) for source in sources]
            parts = [[log] for log in logs] + ([logs] if len(logs) > 1 else [])
            for number, part in enumerate(parts):
                label = sources[number].name if number < len(logs) else "all together"
                row = {"car": entry["name"], "reading": how.get("label", ""), "log": label}
                row["columns"], row["steady_gradient"] = None, math.nan
                if len(part) == 1:
                    columns = read_columns(part[0], reading_of(how)).values
                    row["columns"] = described(columns)
                    if how.get("ratio") != "fit":
                        row["steady_gradient"] = steady_gradient(columns, entry["wheelbase"])
                row["identify"] = identified(part, entry, how)
                answers.append(row)
                if given.json:
                    continue
                print(f"  {label}, {row['reading']}")
                if row["columns"]:
                    ranges = ", ".join(f"{k} {a:.3g} to {b:.3g}" for k, (a, b) in row["columns"]["signals"].items())
                    print("    {samples} samples, {seconds:.0f} s, {rate:.0f} Hz: ".format(**row["columns"]) + ranges)
                if math.isfinite(row["steady_gradient"]):
                    print(f"    steady turns alone: understeer gradient {row['steady_gradient']:.2f} deg/g")
                show(row["identify"], entry.get("known", {}))
    if given.json:
        print(json.dumps(answers))


if __name__ == "__main__":
    main()
