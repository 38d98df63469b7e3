"""What a tracker costs beside its controller, compiled: a call of `tracker_step` less the MPC's step alone.

    .venv/bin/python benchmarks/tracker_cost.py [--calls 20000]

Calls at 20 Hz along a country road with a planned speed and noise. The controller's step is timed on what the tracker
gives it. Median and 99.9th percentile of the calls (us), and the same of `Tracker.step` in Python.
"""

from __future__ import annotations

import argparse
import math
import time

import numpy as np

import adaptrack as at
from adaptrack.control.tracking import tracking_of
from adaptrack.core.controllers.mpc_step import NOW
from adaptrack.core.controllers.mpc_step import step as mpc_step
from adaptrack.core.kernel import direct
from adaptrack.core.tracker.step import tracker_step, tracker_step_law

CAR = at.load_vehicle("paper")
ROAD = at.generate_road("country", seed=1, length=3000.0)
PLAN = at.plan_speed(ROAD, CAR)
MAKERS = {
    "informed": lambda: at.MPC(CAR, profile="road"),
    "informed, production": lambda: at.MPC(CAR, profile="production"),
    "learning": lambda: at.MPC(CAR, profile="road", learning=at.Learning()),
    "published": lambda: at.published_mpc(CAR, period=0.05),
    "LQR": lambda: at.LQR(CAR, period=0.05),
}


def samples(calls: int) -> np.ndarray:
    """(calls, 10) t, now, x, y, yaw, speed, yaw rate, lateral velocity and acceleration, wheel angle."""
    rng, rows, s = np.random.default_rng(1), np.full((calls, 10), math.nan), 20.0
    for k in range(calls):
        speed = float(PLAN.at(s))
        place = ROAD.at(s)
        rows[k, :8] = 0.05 * k, 0.05 * k, place.x, place.y, place.heading, speed, speed * place.curvature, 0.0
        s += 0.05 * speed
        if s > ROAD.length - 100.0:
            s = 20.0
    rows[:, 2:7] += rng.normal(size=(calls, 5)) * (0.02, 0.02, 0.002, 0.02, 0.005)
    return rows


def timed(call: object, count: int, before: object = None) -> np.ndarray:
    """(count,) us of each call."""
    found, clock = np.empty(count), time.perf_counter_ns
    for k in range(count):
        if before is not None:
            before(k)  # type: ignore[operator]
        start = clock()
        call()  # type: ignore[operator]
        found[k] = 1e-3 * (clock() - start)
    return found[count // 10 :]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--calls", type=int, default=20_000)
    calls = parser.parse_args().calls
    rows = samples(calls)
    print(f"{'us, median and 99.9 %':22}{'step':>14}{'tracker_step':>16}{'more':>8}{'Tracker.step':>18}")
    for name, make in MAKERS.items():
        controller = make()
        tracking = tracking_of(controller, ROAD, PLAN)
        tracker, given = tracking.tracker, []
        is_mpc = isinstance(controller, at.MPC)

        def take(k: int, sample: np.ndarray = tracker.sample) -> None:
            sample[:10] = rows[k]

        whole = timed(direct(tracker_step if is_mpc else tracker_step_law, tracking), calls, take)
        alone = np.zeros(1)
        if is_mpc:
            tracking = tracking_of(controller, ROAD, PLAN)
            mpc, step = tracking.step.mpc, direct(tracker_step, tracking)
            for k in range(min(calls, 2000)):
                tracking.tracker.sample[:10] = rows[k]
                step()
                ahead = tracking.tracker.ahead
                given.append((tracking.tracker.measured.copy(), mpc.bend.copy(), float(ahead[0])))
            tracking.step.now[NOW.count] = 1.0

            def see(k: int, mpc: object = mpc, now: np.ndarray = tracking.step.now, given: list = given) -> None:
                mpc.measured[:], mpc.bend[:], now[NOW.speed] = given[k % len(given)]  # type: ignore[attr-defined]

            alone = timed(direct(mpc_step, tracking.step), calls, see)
        face, k = at.Tracker(make(), ROAD, plan=PLAN), iter(rows.tolist())

        def python(face: at.Tracker = face, k: object = k) -> None:
            t, now, x, y, yaw, speed, rate, *_ = next(k)  # type: ignore[call-overload]
            face.step(t, x, y, yaw, speed, rate, lateral_velocity=0.0, now=now)

        slow = timed(python, min(calls, 5000))
        columns = [f"{np.median(each):.2f} {np.quantile(each, 0.999):.1f}" for each in (alone, whole, slow)]
        more = np.median(whole) - np.median(alone)
        print(f"{name:22}{columns[0]:>14}{columns[1]:>16}{more:>8.2f}{columns[2]:>18}")


if __name__ == "__main__":
    main()
