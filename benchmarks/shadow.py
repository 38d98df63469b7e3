"""Shadow mode on honest logs: how often the belief is doubted, and who predicts the yaw rate best.

    python benchmarks/shadow.py [--logs 40] [--profile road]

Each log is that of a random car as in benchmarks/identifying.py (seeds from `FIRST`), in `road` with lateral velocity.
What is believed before is what `identify` is told there: mass and geometry, the stiffness of the shipped car.
"""

from __future__ import annotations

import argparse
import logging
from collections import Counter

import numpy as np
from identifying import made_log, random_car, told

import adaptrack as at

FIRST = 47_000
"""Written down before the first run."""


def main() -> None:
    """Go through the logs and print what came of them."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--logs", type=int, default=40)
    parser.add_argument("--profile", default="road")
    given = parser.parse_args()
    logging.disable()
    verdicts, doubts, best, spoiling = (Counter() for _ in range(4))
    ratios, late = {who: [] for who in ("held", "first", "steady")}, []
    for seed in range(FIRST, FIRST + given.logs):
        car = random_car(seed, profile=given.profile)
        log = made_log(car, lateral_velocity=given.profile == "road")
        found = at.shadow(log, told(car), profile=given.profile, computation=car.profile.period)
        one, yaw_rate = found.logs[0], found.logs[0].of("yaw_rate", 1.0)
        verdicts[one.verdict] += 1
        doubts.update((*one.doubts, *one.bounds))
        spoiling[", ".join(found.spoiling) or "nothing"] += 1
        best[min(yaw_rate, key=lambda who: yaw_rate[who].rms.value)] += 1
        for who, each in ratios.items():
            each.append(yaw_rate[who].ours.mean)
        steering = car.profile.steering
        late.append(abs(one.learned.lag + one.learned.dead_time - steering.lag - steering.dead_time))
    print(f"{given.profile}, {given.logs} logs: {dict(verdicts)}; predicts best 1 s ahead: {dict(best)}")
    for who, each in ratios.items():
        print(f"  learned over {who}: geometric mean {np.exp(np.mean(np.log(each))):.2f}, worst {max(each):.2f}")
    print(f"  delay: median error {np.median(late):.3f} s, 95 % {np.percentile(late, 95):.3f} s")
    print(f"  doubts and bounds: {dict(doubts)}; spoiling: {dict(spoiling)}")


if __name__ == "__main__":
    main()
