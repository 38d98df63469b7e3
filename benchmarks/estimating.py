"""What the filter bears: steering bias and bank, missing, late and stuck samples, and how honest its variances are.

    python benchmarks/estimating.py [offsets] [grip] [samples] [nis] [--runs 100] [--json]

Without words all four. Paper's car, default constant and filter, fresh noise; J as in what_pays.py.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any

import numpy as np
from what_pays import costs

import adaptrack as at
from adaptrack.kalman import SENSORS, Drifts, KalmanFilter, ReadableFilter
from adaptrack.models import PathModel
from adaptrack.profile import load_profile
from adaptrack.scenario import Scenario, random_drive
from adaptrack.simulate import rollout

CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR, "magic-formula")
ROAD, PRODUCTION = load_profile("road"), load_profile("production")
BIAS, BANK = 0.01, math.asin(0.5 / 9.80665)


def with_bias(profile: Any, bias: float) -> Any:
    """The profile with a steering bias (rad)."""
    return profile.replace(steering=profile.steering.replace(bias=bias))


def offsets(runs: int) -> list[dict[str, Any]]:
    """Mean e over the last 60 s of a straight, with a steering bias and a banked road."""
    found = []
    for speed in (10.0, 20.0, 27.0):
        for bias, bank in ((BIAS, 0.0), (0.0, BANK), (BIAS, BANK)):
            straight = Scenario(name="straight", duration=90.0, reference=0.0, speed=speed, friction=0.9, bank=bank)
            profile = with_bias(ROAD, bias)
            mpc = at.MPC(CAR, profile=ROAD)
            mean = [
                rollout(PLANT, mpc, straight, profile=profile, seed=60_000 + i).Y[-1200:].mean() for i in range(runs)
            ]
            silent = profile.replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)
            quiet = rollout(PLANT, mpc, straight, profile=silent).Y[-1200:].mean()
            found.append(
                {
                    "speed": speed, "bias": bias, "bank": bank, "mean_mm": 1e3 * float(np.abs(mean).mean()),
                    "worst_mm": 1e3 * float(np.abs(mean).max()), "without_noise_mm": 1e3 * abs(float(quiet)),
                }
            )  # fmt: skip
    return found


def weaving(acceleration: float, friction: float, speed: float) -> Any:
    """A sine whose lateral acceleration has that peak (m/s^2), with the bias and bank of `offsets`."""
    omega = 2.0 * math.pi / 6.0
    t = np.arange(0.0, 40.0, 0.05)
    grown = np.clip(t / 8.0, 0.0, 1.0)
    y = grown * acceleration / omega**2 * np.sin(omega * t)
    return Scenario.from_arrays(t, y, speed, friction, name="weaving").replace(bank=BANK)


def grip(runs: int) -> list[dict[str, Any]]:
    """Failed runs near the limit of grip, with disturbance states and without."""
    found = []
    still = Drifts(side=0.0, turn=0.0, wind=0.0)
    for acceleration, friction in ((7.0, 0.9), (0.85 * 0.5 * 9.80665, 0.5)):
        rng = np.random.default_rng(17)
        tests = [weaving(acceleration, friction, float(speed)) for speed in rng.uniform(10.0, 27.0, runs)]
        failed = {}
        for name, drifts, spread in (("with", Drifts(), (0.3, 0.3)), ("without", still, (0.0, 0.0))):
            own = KalmanFilter(KalmanFilter.of_profile(ROAD).noise, drifts, spread=spread)
            mpc = at.MPC(CAR, profile=ROAD, estimator=own)
            _, failed[name] = costs(PLANT, mpc, mpc.tuning, tests, with_bias(ROAD, BIAS), 70_000)
        found.append(
            {
                "acceleration": acceleration, "friction": friction, "runs": runs, "failed": int(failed["with"].sum()),
                "failed_without_disturbances": int(failed["without"].sum()),
                "failed_where_that_survives": int((failed["with"] & ~failed["without"]).sum()),
            }
        )  # fmt: skip
    return found


def samples(runs: int) -> list[dict[str, Any]]:
    """Random drives with samples that are missing or late."""
    tests = [random_drive(9_000_000 + i) for i in range(runs)]
    cases = {
        "road": ROAD,
        "30 % missing": ROAD.replace(missing=0.3),
        "all .1 s late": ROAD.replace(pose_age=0.1, motion_age=0.1),
        "production": PRODUCTION,
        "production, 30 % missing": PRODUCTION.replace(missing=0.3),
        "production, gaps of .5 s": PRODUCTION.replace(dropout_least=0.5, dropout_most=0.5),
        "production, gaps of 1 s": PRODUCTION.replace(dropout_least=1.0, dropout_most=1.0),
        "production, gaps of 2 s": PRODUCTION.replace(dropout_least=2.0, dropout_most=2.0),
        "production, exact speed": PRODUCTION.replace(noise_speed=0.0),
        "production, prompt pose": PRODUCTION.replace(pose_age=0.0, pose_age_spread=0.0),
        "production, no gaps": PRODUCTION.replace(dropout_pause=0.0),
        "production, no gyro offset": PRODUCTION.replace(bias_yaw_rate=0.0),
        "production, no accelerometer": PRODUCTION.replace(noise_lateral_acceleration=math.inf),
        "production, no dead time of the actuator": PRODUCTION.replace(
            steering=PRODUCTION.steering.replace(dead_time=0.0)
        ),
    }  # fmt: skip
    found = []
    for name, profile in cases.items():
        mpc = at.MPC(CAR, profile=profile)
        cost, failed = costs(PLANT, mpc, mpc.tuning, tests, profile, 80_000)
        found.append(
            {
                "world": name, "J": float(np.exp(np.log(cost).mean())), "p99": float(np.percentile(cost, 99)),
                "failed": int(failed.sum()),
            }
        )  # fmt: skip
    return found


def nis(runs: int) -> list[dict[str, Any]]:
    """Share of the single-step NIS of each sensor inside their 95 % interval, on the nonlinear plant."""
    inside: dict[str, list[bool]] = {}
    for i in range(min(runs, 20)):
        scenario = random_drive(9_100_000 + i)
        run = rollout(PLANT, at.MPC(CAR, profile=ROAD), scenario, profile=ROAD, seed=90_000 + i)
        rng = np.random.default_rng(i)
        readable = ReadableFilter(
            KalmanFilter.of_profile(ROAD), PathModel(CAR, ROAD.period, ROAD.steering.lag, ROAD.dead_time)
        )
        truth = np.column_stack([run.vy, run.psi, run.yaw_rate, run.Y])
        seen = truth + rng.normal(size=truth.shape) * ROAD.noise
        command = np.concatenate([[0.0], run.command[:-1]])
        for k in range(len(run.t) if run.failed is None else int(run.failed_at / ROAD.period)):
            measured = np.concatenate([seen[k], [math.nan, math.nan, 0.0, 0.0]])
            if k == 0:
                readable.step(run.vx[k], measured, 0.0)
                continue
            readable.sent = [command[k], *readable.sent[:-1]]
            readable.steps += 1
            readable.predict(run.vx[k])
            for name, value, variance in zip(SENSORS[:4], seen[k], readable.own.variances()[:4], strict=True):
                h, _ = readable.reading(name, 0, 0.0, run.vx[k])
                found = (value - h @ readable.z) ** 2 / (h @ readable.P @ h + variance)
                if k > 40:
                    inside.setdefault(name, []).append(found < 3.8415)
                readable.correct(h, value, variance)
    return [{"sensor": name, "inside_95": float(np.mean(each)), "steps": len(each)} for name, each in inside.items()]


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=[], choices=[[], "offsets", "grip", "samples", "nis"])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    parts = {"offsets": offsets, "grip": grip, "samples": samples, "nis": nis}
    found = {name: parts[name](asked.runs) for name in asked.what or parts}
    if asked.json:
        print(json.dumps(found))
        return
    for name, rows in found.items():
        print(name)
        for row in rows:
            print("  " + "  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                                   for key, value in row.items()))  # fmt: skip


if __name__ == "__main__":
    main()
