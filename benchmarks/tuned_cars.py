"""Cost before and after `tune` for cars of any kind, and the time that it takes.

    python benchmarks/tuned_cars.py [--vehicle van sports-car ...] [--plant NAME] [--profile road production] [--json]

Time by the clock, and CPU seconds: half of them is the time on two free cores of what runs in parallel. J as in
docs/driving.md, geometric mean over 48 random drives in each car's domain that the search did not see.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import Any

import adaptrack as at
from adaptrack.cars.vehicle import list_vehicles
from adaptrack.tuning.car import TuningEffort


def tuned(name: str, plant: str | None, profile: str) -> tuple[dict[str, Any], str]:
    """A row, and how it is printed."""
    before = time.process_time()
    found = at.tune(name, profile, plant=plant).summary()
    found["cpu_seconds"] = time.process_time() - before
    tuning, gain = found["tuning"], found["gain"]
    return found, (
        f"Np {tuning['Np']:.0f}, Nc {tuning['Nc']:.0f}, R/Q {tuning['R'] / tuning['Q']:.3g}  "
        f"J {found['cost']['default']:.5f} -> x{gain['mean']:.3f} [{gain['low']:.3f}, {gain['high']:.3f}]  "
        f"failed {found['failed']['candidate']} of {found['drives']}"
    )


def main() -> None:
    """Print a row for each car and profile."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--vehicle", nargs="+", default=list(list_vehicles()))
    ask.add_argument("--plant", default=None)
    ask.add_argument("--profile", nargs="+", default=["road", "production"])
    ask.add_argument("--json", action="store_true")
    asked, rows = ask.parse_args(), []
    at.tune("paper", effort=TuningEffort(drives=1, hard_drives=1, seconds=5.0, unseen_drives=4))  # compile
    for profile in asked.profile:
        for name in asked.vehicle:
            found, words = tuned(name, asked.plant, profile)
            rows.append({"vehicle": name, "plant": asked.plant, "profile": profile, **found})
            if not asked.json:
                print(
                    f"{profile:10s} {name:14s} {found['seconds']:5.1f} s ({found['cpu_seconds']:.1f} CPU s)  {words}  "
                    f"{'passed' if found['passed'] else 'NOT PASSED'}",
                    flush=True,
                )
    if asked.json:
        print(json.dumps({"rows": rows}))


if __name__ == "__main__":
    main()
