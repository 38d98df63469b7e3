"""What knowing the car brings on the paper's tests, beside what adapting the tuning brings.

The paper's controllers and the MPC that knows its car drive both tests, on the car that the paper describes: ideal
(profile `paper`), and with steering lag, rate limit, sensor noise and delay (`road`). Each runs at the period and with
the preview of the profile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, Moves, published_mpc
from adaptrack.control.scheduling import Schedule, load_scheduler
from adaptrack.drive.batch import rollout_batch
from adaptrack.scenario import load_scenario
from adaptrack.scenario.profile import Profile, load_profile

Row = dict[str, Any]

PROFILES = ("paper", "road")
SEEDS = range(10)
"""Of the sensor noise, in a profile that has any."""
LEARNED_THERE = {"road-constant": "road-best-constant-on-drives", "road-nn": "road-nn"}
"""Controllers of the paper's kind that ship with the package and learned in `road`: name -> scheduler."""


def controllers(car: Vehicle, profile: Profile, schedules: Mapping[str, Schedule], moves: Moves) -> dict[str, MPC]:
    """Who drives in a profile, by name.

    schedules: what the paper's models learned, as released; moves: how they move.
    """
    timing: dict[str, Any] = {"period": profile.period, "preview": profile.preview}

    def scheduled(schedule: Schedule, **more: Any) -> MPC:
        return published_mpc(car, scheduler=schedule, most_moves=max(20, schedule.largest[1]), **timing, **more)

    found = {
        "standard-as-written": published_mpc(car, **timing),
        "standard-as-released": published_mpc(car, moves=Moves.laguerre(0.95), **timing),
        **{name: scheduled(schedule, moves=moves) for name, schedule in schedules.items()},
    }
    if profile.name == "road":
        found |= {name: scheduled(load_scheduler(shipped)) for name, shipped in LEARNED_THERE.items()}
    return found | {"informed": MPC(car, profile=profile)}


def knowing_controllers() -> list[str]:
    """The controllers that know their car, in words: what their results depend on beside software and seeds."""
    return [repr(MPC(load_vehicle("paper"), profile=name)) for name in PROFILES]


def compare_knowing(tests: tuple[str, ...], schedules: Mapping[str, Schedule], moves: Moves) -> list[Row]:
    """A row for each profile, test and controller.

    profile, scenario, controller, period (s), preview; runs (one, or one for each noise seed), failed (of them), mse
    (m^2, mean over those that did not fail, None without any) and rms_rate (rad/s, of the command, likewise).
    """
    car = load_vehicle("paper")
    return list(_driven(DualTrack(car, "magic-formula"), car, tests, schedules, moves))


def _driven(
    plant: DualTrack, car: Vehicle, tests: tuple[str, ...], schedules: Mapping[str, Schedule], moves: Moves
) -> Iterator[Row]:
    for profile in map(load_profile, PROFILES):
        seeds = np.array(SEEDS if any(profile.noise) else SEEDS[:1])
        for test in tests:
            for name, mpc in controllers(car, profile, schedules, moves).items():
                found = rollout_batch(
                    plant, mpc, load_scenario(test), which=np.zeros(len(seeds), int), profile=profile, seeds=seeds
                )
                kept = np.array([reason is None for reason in found.failed])
                yield {
                    "profile": profile.name,
                    "scenario": test,
                    "controller": name,
                    "period": mpc.period,
                    "preview": mpc.preview,
                    "runs": len(seeds),
                    "failed": int((~kept).sum()),
                    "mse": float(found.mse[kept].mean()) if kept.any() else None,
                    "rms_rate": math.sqrt(found.mean_squared_move[kept].mean()) / mpc.period if kept.any() else None,
                }
