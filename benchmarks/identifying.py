"""How well `identify` gets to know random cars, and whether its intervals are true.

    python benchmarks/identifying.py [--logs 100] [--seed 2000] [--lateral-velocity] [--rows FILE] [--json]

Each car is one of `random_car`: its own mass, stiffness, lag, dead time, steering bias and sensor noise. It is driven
for 120 s along a random drive (wind, gusts, changing friction) by the MPC that is told the truth, in the profile `road`
with its own steering. The log holds time, command, speed and the yaw rate with noise and an offset, drawn within that
of the profile `production`. `identify` is told mass and geometry and believes the stiffness of the shipped car; of the
steering it knows nothing. A drive that fails is replaced. Of the corrections of `identification.calibration` those of
offset and understeer gradient were found on seeds 1300 to 1359. --rows keeps what is done, a row a log: the same
command goes on where it stopped.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from pathlib import Path
from typing import Any

import numpy as np

import adaptrack as at
from adaptrack.base.errors import InvalidInput
from adaptrack.identification import RandomCar, random_car
from adaptrack.identification.from_log import fitted, prepare, reported
from adaptrack.identification.quantities import degrees_per_g
from adaptrack.scenario import random_drive

DRIVES, DURATION, TRIES = 31_000_000, 120.0, 20
NEAR_DELAY, NEAR_SHARE, NEAR_GRADIENT = 0.03, 0.15, 0.2
"""s; share of the understeer gradient or deg/g, whichever is larger."""


def gyro_offset(car: RandomCar) -> float:
    """rad/s, of the log of a random car."""
    most = at.load_profile("production").bias_yaw_rate
    return float(np.random.default_rng((car.seed, 2)).uniform(-most, most))


def made_log(car: RandomCar, lateral_velocity: bool) -> dict[str, Any]:
    """What the sensors of a random car give on its drive."""
    for attempt in range(TRIES):
        drive = random_drive(DRIVES + 1000 * attempt + car.seed, DURATION)
        mpc = at.MPC(car.vehicle, profile=car.profile)
        run = at.rollout(at.DualTrack(car.vehicle, car.tyre), mpc, drive, profile=car.profile, seed=car.seed)
        if not run.failed:
            break
    noise = np.random.default_rng((car.seed, 1))
    log = {
        "time": run.t, "command": run.command, "speed": run.vx,
        "yaw_rate": run.yaw_rate + car.profile.noise_yaw_rate * noise.standard_normal(len(run)) + gyro_offset(car),
    }  # fmt: skip
    if lateral_velocity:
        log["vy"] = run.vy + car.profile.noise_vy * noise.standard_normal(len(run))
    return log


def truth_of(car: RandomCar) -> dict[str, float]:
    """The true values, by the names of the estimates."""
    steering = car.profile.steering
    return {
        "delay": car.delay, "lag": steering.lag, "dead_time": car.profile.dead_time,
        "understeer_gradient": car.vehicle.understeer_gradient, "front": 2.0 * car.vehicle.stiffness_front,
        "rear": 2.0 * car.vehicle.stiffness_rear, "offset": steering.bias,
        "gyro_offset": gyro_offset(car), "noise_yaw_rate": car.profile.noise_yaw_rate,
    }  # fmt: skip


def told(car: RandomCar) -> at.Vehicle:
    """What `identify` is told: mass and geometry, the stiffness of the shipped car, I_z = m l_f l_r."""
    shipped, true = at.load_vehicle(car.base), car.vehicle
    return shipped.replace(mass=true.mass, yaw_inertia=true.mass * true.lf * true.lr, steering=None)


def judge(seed: int, lateral_velocity: bool) -> dict[str, Any]:
    """Errors in standard errors, and in their units, of one log."""
    car = random_car(seed)
    log = made_log(car, lateral_velocity)
    begun = time.perf_counter()
    try:
        likelihood = prepare(log, told(car))
    except InvalidInput as error:
        return {"seed": seed, "base": car.base, "refused": str(error)}
    estimates = reported(likelihood, *fitted(likelihood))
    taken = time.perf_counter() - begun
    truth, row = truth_of(car), {"seed": seed, "base": car.base, "time": taken}
    for name, true in truth.items():
        each = estimates[name]
        row[name] = {
            "true": true, "value": each.value, "low": each.low, "high": each.high,
            "inside": bool(each.low <= true <= each.high),
        }  # fmt: skip
    return row


def summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Shares over all logs that are not refused."""
    refused = [row["seed"] for row in rows if "refused" in row]
    rows = [row for row in rows if "refused" not in row]
    delay = [abs(row["delay"]["value"] - row["delay"]["true"]) for row in rows]
    gradients = [row["understeer_gradient"] for row in rows]
    near = [
        abs(g["value"] - g["true"]) <= max(NEAR_SHARE * abs(g["true"]), math.radians(NEAR_GRADIENT) / 9.80665)
        for g in gradients
    ]
    names = [name for name in rows[0] if isinstance(rows[0][name], dict)]
    return {
        "logs": len(rows), "refused": refused, "delay_within": float(np.mean(np.array(delay) <= NEAR_DELAY)),
        "gradient_within": float(np.mean(near)), "median_time": float(np.median([row["time"] for row in rows])),
        "coverage": {name: float(np.mean([row[name]["inside"] for row in rows])) for name in names},
        "median_error": {
            name: float(np.median([abs(row[name]["value"] - row[name]["true"]) for row in rows])) for name in names
        },
    }  # fmt: skip


def kept_rows(path: Path | None) -> list[dict[str, Any]]:
    """The rows that a file holds; none where there is no file."""
    if path is None or not path.exists():
        return []
    return [json.loads(line) for line in path.read_text().splitlines()]


def main() -> None:
    """Print a row a log, then the shares."""
    ask = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    ask.add_argument("--logs", type=int, default=100)
    ask.add_argument("--seed", type=int, default=2000, help="of the first car; the next has the next one")
    ask.add_argument(
        "--lateral-velocity", action="store_true", help="the log holds it too, as the profile's sensor has it"
    )
    ask.add_argument("--rows", type=Path, help="file of JSON lines that rows are kept in")
    ask.add_argument("--json", action="store_true")
    given = ask.parse_args()
    wanted = range(given.seed, given.seed + given.logs)
    rows = [row for row in kept_rows(given.rows) if row["seed"] in wanted]
    for seed in sorted(set(wanted) - {row["seed"] for row in rows}):
        rows.append(judge(seed, given.lateral_velocity))
        if given.rows is not None:
            with given.rows.open("a") as file:
                file.write(json.dumps(rows[-1]) + "\n")
        if not given.json and "refused" not in rows[-1]:
            d, g = rows[-1]["delay"], rows[-1]["understeer_gradient"]
            print(
                f"{seed:4d} {rows[-1]['base']:14s} delay {d['value']:.3f} s ({d['true']:.3f})  "
                f"K {degrees_per_g(g['value']):6.2f} deg/g ({degrees_per_g(g['true']):6.2f})  {rows[-1]['time']:.1f} s",
                flush=True,
            )
    found = summary(rows)
    if given.json:
        print(json.dumps({"summary": found, "rows": rows}))
        return
    print(f"{found['logs']} logs; refused: {found['refused'] or 'none'}")
    print(f"delay within {NEAR_DELAY:g} s: {found['delay_within']:.2f}; understeer gradient within bounds: "
          f"{found['gradient_within']:.2f}; {found['median_time']:.1f} s a log")  # fmt: skip
    for name, share in found["coverage"].items():
        print(
            f"{name:20s} 90 % interval holds the truth in {share:.3f}; median error {found['median_error'][name]:.4g}"
        )


if __name__ == "__main__":
    main()
