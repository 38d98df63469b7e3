"""The informed MPC on the paper's tests: what a model of the steering and an estimator gain beside adapted tuning.

The paper's controllers and the MPC with a model of its steering drive both tests on the car that the paper describes:
ideal (profile `paper`), and with steering lag, rate limit, sensor noise and delay (`road`). Each controller runs at the
period and with the preview of the profile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import Vehicle, load_vehicle
from adaptrack.control.controllers import MPC, Moves, Tuning, published_mpc
from adaptrack.control.scheduling import Schedule, load_scheduler
from adaptrack.drive.batch import rollout_batch
from adaptrack.scenario import load_scenario
from adaptrack.scenario.profile import Profile, load_profile

Row = dict[str, Any]

PROFILES = ("paper", "road")
REPRODUCE_SEEDS = range(10)
"""Noise seeds, in a profile with sensor noise."""
ROAD_CONSTANT = Tuning(28, 6, 1.0, 3476.378659166587)
"""The best constant tuning of the paper's MPC on random drives in profile `road`."""
ROAD_SCHEDULE = "road-nn"
"""The shipped schedule of the paper's MPC that was learned in profile `road`."""


def controllers(car: Vehicle, profile: Profile, schedules: Mapping[str, Schedule], moves: Moves) -> dict[str, MPC]:
    """The controllers of a profile, by name.

    schedules: the schedules of the paper's models, as released; moves: their moves.
    """
    timing: dict[str, Any] = {"period": profile.period, "preview": profile.preview}

    def scheduled(schedule: Schedule, **options: Any) -> MPC:
        return published_mpc(car, scheduler=schedule, most_moves=max(20, schedule.largest[1]), **timing, **options)

    by_name = {
        "standard-as-written": published_mpc(car, **timing),
        "standard-as-released": published_mpc(car, moves=Moves.laguerre(0.95), **timing),
        **{name: scheduled(schedule, moves=moves) for name, schedule in schedules.items()},
    }
    if profile.name == "road":
        by_name["road-constant"] = published_mpc(car, ROAD_CONSTANT, **timing)
        by_name["road-nn"] = scheduled(load_scheduler(ROAD_SCHEDULE))
    return by_name | {"informed": MPC(car, profile=profile)}


def drive_informed(tests: tuple[str, ...], schedules: Mapping[str, Schedule], moves: Moves) -> list[Row]:
    """A row for each profile, test and controller.

    profile, scenario, controller, period (s), preview; runs (one, or one for each noise seed), failed (number of runs),
    mse (m^2, mean over the runs that did not fail, None if all failed) and rms_rate (rad/s, of the command, likewise).
    """
    return list(_rows(tests, schedules, moves))


def _rows(tests: tuple[str, ...], schedules: Mapping[str, Schedule], moves: Moves) -> Iterator[Row]:
    car = load_vehicle("paper")
    plant = DualTrack(car, "magic-formula")
    for profile in map(load_profile, PROFILES):
        seeds = np.array(REPRODUCE_SEEDS if any(profile.noise) else REPRODUCE_SEEDS[:1])
        for test in tests:
            for name, mpc in controllers(car, profile, schedules, moves).items():
                runs = rollout_batch(
                    plant,
                    mpc,
                    load_scenario(test),
                    scenario_indices=np.zeros(len(seeds), int),
                    profile=profile,
                    seeds=seeds,
                )
                ended = np.array([reason is None for reason in runs.failed])
                yield {
                    "profile": profile.name,
                    "scenario": test,
                    "controller": name,
                    "period": mpc.period,
                    "preview": mpc.preview,
                    "runs": len(seeds),
                    "failed": int((~ended).sum()),
                    "mse": float(runs.mse[ended].mean()) if ended.any() else None,
                    "rms_rate": math.sqrt(runs.mean_squared_move[ended].mean()) / mpc.period if ended.any() else None,
                }
