"""What the filter bears: steering bias and bank, missing, late and stuck samples.

    python benchmarks/estimating.py [offsets] [grip] [samples] [stuck] [--runs 100] [--json]

Without words all four. Paper's car, default constant and filter, fresh noise. J = mean e^2 + w mean (change of
command)^2 with the profile's w; a failed drive counts 25 m^2.
"""

from __future__ import annotations

import argparse
import json
import math
from typing import Any, NamedTuple

import numpy as np

import adaptrack as at
from adaptrack.control.kalman import SENSORS, Drifts, KalmanFilter
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.simulate import rollout
from adaptrack.scenario import Scenario, random_drive
from adaptrack.scenario.profile import load_profile

CAR = at.load_vehicle("paper")
PLANT = at.DualTrack(CAR, "magic-formula")
ROAD, PRODUCTION = load_profile("road"), load_profile("production")
STUCK_AT = {"vy": 0.5, "yaw_rate": 0.1, "wheel_angle": 0.05, "lateral_acceleration": 2.0}
"""m/s, rad/s, rad, m/s^2: what a sensor reads that is stuck."""
SENSORS_AT = {name: place for place, name in enumerate(SENSORS)}
FAILED = 25.0
"""m^2, the cost of a failed drive"""
BIAS, BANK = 0.01, math.asin(0.5 / 9.80665)


def costs(plant: Any, mpc: Any, tuning: at.Tuning, runs: list[Any], profile: Any, seed: int) -> Any:
    """J of each run (runs,), and which runs failed."""
    count = len(runs)
    batch = rollout_batch(
        plant, mpc, runs, np.tile(tuning.as_array(), (count, 1)), scenario_indices=np.arange(count), profile=profile,
        seeds=seed + np.arange(count),
    )  # fmt: skip
    failed = np.array([reason is not None for reason in batch.failed])
    return np.where(failed, FAILED, batch.mse + profile.move_weight * batch.mean_squared_move), failed


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
            own = KalmanFilter(KalmanFilter.from_profile(ROAD).noise, drifts, spread=spread)
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


class Fault(NamedTuple):
    """What fails of the sensors, and how."""

    sensors: tuple[str, ...]
    reading: float = math.nan
    """what they read; NaN: their last value; inf: nothing"""
    noise: float = 0.0
    """standard deviation that they keep"""
    begin: float = 20.0
    """s"""
    length: float = math.inf
    """s"""


class Faulty(at.MPC):
    """The MPC behind sensors of which some fail."""

    def __init__(self, car: Any, profile: Any, fault: Fault, seed: int) -> None:
        self.fault, self.rng = fault, np.random.default_rng(seed)
        super().__init__(car, profile=profile)

    def reset(self) -> None:
        """Forget the past."""
        self.k, self.read, self.doubted = 0, {}, []
        super().reset()

    def step(self, state: Any, *others: Any) -> Any:
        """With the samples that the faulty sensors give instead."""
        seen, fault, since = np.array(state), self.fault, self.k * self.period - self.fault.begin
        self.k += 1
        for place in map(SENSORS_AT.get, fault.sensors if 0.0 <= since < fault.length else ()):
            if math.isfinite(seen[place]):
                self.read.setdefault(place, seen[place] if math.isnan(fault.reading) else fault.reading)
            value = self.read.get(place, math.nan)
            noise = fault.noise * self.rng.normal() if fault.noise else 0.0
            seen[place] = value + noise if math.isfinite(value) else math.nan
        answer = super().step(seen, *others)
        self.doubted.append(self.left_out)
        return answer

    def seconds_unnoticed(self, run: Any) -> float:
        """From when a sensor stuck behind noise is first off by five times that, to its being left out; NaN: never."""
        name = self.fault.sensors[0]
        truth = getattr(run, {"wheel_angle": "steering"}.get(name, name))[: len(self.doubted)]
        wrong = np.abs(self.read.get(SENSORS_AT[name], math.nan) - truth) > 5.0 * self.fault.noise
        wrong &= run.t[: len(wrong)] >= self.fault.begin
        out = np.array([each == name for each in self.doubted]) & (run.t[: len(wrong)] >= self.fault.begin)
        if not wrong.any():
            return math.nan
        return max(0.0, (int(np.argmax(out)) - int(np.argmax(wrong))) * self.period) if out.any() else math.inf


def stuck(runs: int) -> list[dict[str, Any]]:
    """Random drives with a sensor that is stuck, to the bit or behind its noise, and with a pose stuck or absent."""
    tests = [random_drive(9_200_000 + i) for i in range(runs)]
    wheels = PRODUCTION.replace(name="production, wheel angle without offset", bias_wheel_angle=0.0)
    worlds = (
        (ROAD, ("vy", "yaw_rate")), (PRODUCTION, ("yaw_rate", "lateral_acceleration")), (wheels, ("wheel_angle",)),
    )  # fmt: skip
    rows = []
    for world, sensor in ((world, sensor) for world, sensors in worlds for sensor in sensors):
        noise = getattr(world, f"noise_{sensor}")
        for fault in (
            Fault((sensor,), STUCK_AT[sensor], begin=0.0), Fault((sensor,)),
            Fault((sensor,), STUCK_AT[sensor], noise), Fault((sensor,), noise=noise),
        ):  # fmt: skip
            rows.append(faulty(tests, world, fault))
    for world in (ROAD, PRODUCTION):
        for reading in (math.inf, math.nan):
            rows += [
                faulty(tests, world, Fault(("yaw", "y"), reading, length=length)) for length in (0.5, 1.0, 2.0, 5.0)
            ]
    return rows


def faulty(tests: list[Any], profile: Any, fault: Fault) -> dict[str, Any]:
    """Cost and failures of drives with a fault; how long a stuck sensor was taken in, and there was no position."""
    found, unnoticed, blind, held = [], [], [], 0
    for i, test in enumerate(tests):
        mpc = Faulty(CAR, profile, fault, i)
        run = at.simulate(PLANT, mpc, test, profile=profile, seed=85_000 + i)
        measures = at.compute_metrics(run)
        found.append(FAILED if measures.failed else measures.cost)
        unnoticed.append(mpc.seconds_unnoticed(run) if fault.noise else 0.0)
        blind.append(measures.dead_reckoning_max)
        held += measures.held > 0
    noticed = np.array(unnoticed)[~np.isnan(unnoticed)]
    return {
        "world": profile.name, **fault._asdict(),
        "J": float(np.exp(np.log(found).mean())), "failed": int(np.sum(np.array(found) >= FAILED)),
        "unnoticed_p50_s": float(np.median(noticed)) if len(noticed) else math.nan,
        "unnoticed_within_1_s": float(np.mean(noticed <= 1.0)) if len(noticed) else math.nan,
        "off_in_runs": len(noticed), "without_position_s": float(np.max(blind)), "held_in_runs": held,
    }  # fmt: skip


def main() -> None:
    """Print what was asked for."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="*", default=[], choices=[[], "offsets", "grip", "samples", "stuck"])
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    parts = {"offsets": offsets, "grip": grip, "samples": samples, "stuck": stuck}
    found = {name: parts[name](options.runs) for name in options.what or parts}
    if options.json:
        print(json.dumps(found))
        return
    for name, rows in found.items():
        print(name)
        for row in rows:
            print("  " + "  ".join(f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"
                                   for key, value in row.items()))  # fmt: skip


if __name__ == "__main__":
    main()
