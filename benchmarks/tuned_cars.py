"""What a car of any kind costs and gets: `tune`, or with --adapt the whole chain `adaptrack adapt CAR --quick`.

    python benchmarks/tuned_cars.py [--vehicle van sports-car ...] [--plant NAME] [--profile road production]
                                    [--adapt FOLDER] [--json]

Time by the clock, and CPU seconds: half of them is the time on two free cores of what runs in parallel. `tune`: J as in
docs/driving.md, geometric mean over 48 random drives in each car's domain that the search did not see. `adapt`: a
process of its own for each car, from its start to its end, and whether it passed (exit code 0, not 3) and wrote its
page.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import adaptrack as at
from adaptrack.cars.vehicle import list_vehicles


def tuned(name: str, plant: str | None, profile: str) -> tuple[dict[str, Any], str]:
    """A row, and how it is printed."""
    before = time.process_time()
    found = at.tune(name, profile, plant=plant).summary()
    found["cpu_seconds"] = time.process_time() - before
    tuning, gain = found["tuning"], found["gain"]
    return found, (
        f"Np {tuning['Np']:.0f}, Nc {tuning['Nc']:.0f}, R/Q {tuning['R'] / tuning['Q']:.3g}  "
        f"J {found['cost']['default']:.5f} -> x{gain['mean']:.3f} [{gain['low']:.3f}, {gain['high']:.3f}]  "
        f"failed {found['failed']['sought']} of {found['drives']}"
    )


def adapted(name: str, plant: str | None, profile: str, folder: Path) -> tuple[dict[str, Any], str]:
    """Likewise, of the command."""
    out = folder / "-".join([name, plant or "usual", profile])
    command = [sys.executable, "-m", "adaptrack", "adapt", name, "--quick", "--profile", profile, "--out", str(out)]
    command += [] if plant is None else ["--plant", plant]
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    code = subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode
    seconds, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    page = (out / "index.html").exists()
    found = {"seconds": seconds, "cpu_seconds": cpu, "exit_code": code, "page": page, "passed": code == 0 and page}
    return found, f"exit code {code}, {'page' if page else 'no page'}"


def main() -> None:
    """Print a row for each car and profile."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--vehicle", nargs="+", default=list(list_vehicles()))
    ask.add_argument("--plant", default=None)
    ask.add_argument("--profile", nargs="+", default=["road", "production"])
    ask.add_argument("--adapt", type=Path, default=None, metavar="FOLDER")
    ask.add_argument("--json", action="store_true")
    asked, rows = ask.parse_args(), []
    if asked.adapt is None:  # compile
        at.tune("paper", effort=at.TuningEffort(drives=1, hard_drives=1, seconds=5.0, judged=4))
    for profile in asked.profile:
        for name in asked.vehicle:
            if asked.adapt is None:
                found, words = tuned(name, asked.plant, profile)
            else:
                found, words = adapted(name, asked.plant, profile, asked.adapt)
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
