"""What `tune` finds for the shipped cars: time, cost against the controller's own constant, failures, certificate.

    python benchmarks/tuned_cars.py [--vehicle van ...] [--profile road production] [--json]

J as in docs/driving.md, geometric mean over 48 random drives in each car's domain that the search did not see.
"""

from __future__ import annotations

import argparse
import json
import time

import adaptrack as at
from adaptrack.vehicle import list_vehicles


def main() -> None:
    """Print a row for each car and profile."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--vehicle", nargs="+", default=list(list_vehicles()))
    ask.add_argument("--profile", nargs="+", default=["road", "production"])
    ask.add_argument("--json", action="store_true")
    asked, rows = ask.parse_args(), []
    at.tune(at.load_vehicle("paper"), effort=at.TuningEffort(drives=1, hard_drives=1, seconds=5.0, judged=4))  # compile
    for profile in asked.profile:
        for name in asked.vehicle:
            before = time.process_time()
            found = at.tune(at.load_vehicle(name), profile).summary()
            found |= {"vehicle": name, "cpu_seconds": time.process_time() - before}
            rows.append(found)
            if not asked.json:
                tuning, gain = found["tuning"], found["gain"]
                print(
                    f"{profile:10s} {name:14s} {found['seconds']:5.1f} s ({found['cpu_seconds']:.1f} CPU s)  "
                    f"Np {tuning['Np']:.0f}, Nc {tuning['Nc']:.0f}, R/Q {tuning['R'] / tuning['Q']:.3g}  "
                    f"J {found['cost']['default']:.5f} -> x{gain['mean']:.3f} [{gain['low']:.3f}, {gain['high']:.3f}]  "
                    f"failed {found['failed']['sought']} of {found['drives']}  "
                    f"{'passed' if found['passed'] else 'NOT PASSED'}",
                    flush=True,
                )
    if asked.json:
        print(json.dumps({"rows": rows}))


if __name__ == "__main__":
    main()
