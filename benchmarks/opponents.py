"""Opponents on generated roads, with their own tuning and tuned, beside the informed controller.

    python benchmarks/opponents.py [--profile road] [--vehicle midsize-sedan] [--runs 200] [NAME ...]

One search of so many closed-loop runs for each on four roads of seed 0, judged on eight roads of seeds 1 and 2 with
two noise seeds that no search saw, at up to 4 m/s^2 sideways.
"""

from __future__ import annotations

import argparse
import time

import adaptrack as at
from adaptrack.comparison.compare import compare
from adaptrack.comparison.contenders import Contender
from adaptrack.comparison.views import road_rows
from adaptrack.road import Comfort
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.constant import seek_constant, swarm_within
from adaptrack.tuning.runs import road_runs

LENGTHS = {"motorway": 2000.0, "country": 900.0, "town": 900.0, "mountain": 900.0}
USUAL = ("preview-lqr", "kinematic-mpc", "lqr", "informed")


def main() -> None:
    """Tune, judge, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME")
    parser.add_argument("--profile", default="road")
    parser.add_argument("--vehicle", default="midsize-sedan")
    parser.add_argument("--runs", type=int, default=200)
    options = parser.parse_args()
    car, world = at.load_vehicle(options.vehicle), load_profile(options.profile)
    plant, mpc = at.DualTrack(car), at.MPC(car, profile=world, preview=True)

    def runs(*seeds):
        roads = [at.generate_road(kind, seed=s, length=length) for s in seeds for kind, length in LENGTHS.items()]
        return road_runs(plant, mpc, roads, Comfort(lateral=4.0), options.profile)

    training, chosen = runs(0), []
    for name in options.names or USUAL:
        own = at.get_controller(name, car, profile=world, offered={"period": world.period, "preview": True})
        begun = time.time()
        found = seek_constant(training, own, swarm_within(options.runs, len(training)), noise_seeds=[1000])
        entries = ", ".join(f"{entry} {value:.3g}" for entry, value in found.tuning.items())
        print(f"{name}: {entries} ({time.time() - begun:.0f} s)", flush=True)
        chosen += [Contender(f"{name}, default", own), Contender(f"{name}, tuned", own.with_tuning(found.tuning))]
    for row in road_rows(compare(runs(1, 2), chosen, range(2), chosen[0].name, outline=car.outline)):
        print(
            f"{row['contender']:24} J {row['cost_geomean']:.5f} m^2, RMS {row['rms_error']:.4f} m, "
            f"p95 {row['p95_error']:.4f} m, largest {row['max_abs_error']:.3f} m, "
            f"failed {row['failures']} of {row['runs']}"
        )


if __name__ == "__main__":
    main()
