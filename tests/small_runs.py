"""Short runs on the road with the paper's car, for what drives sets of runs."""

from __future__ import annotations

import math

import numpy as np

from adaptrack.cars.plant import SingleTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import Tuning, published_mpc
from adaptrack.scenario import load_scenario
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import RunSet

CAR = load_vehicle("paper")
START = Tuning(29, 5, 1.0, 4000.0)
HASTY = Tuning(30, 10, 1.0, 10.0)
"""Steers on every bit of noise: fails."""


def controller(tuning=START, **options):
    return published_mpc(CAR, tuning, period=load_profile("road").period, preview=True, **options)


def lane_changes(n=5, duration=4.0):
    rng = np.random.default_rng(3)
    return [
        load_scenario("lane-change", speed=v, amplitude=y, friction=mu, gust=w, duration=duration)
        for v, y, mu, w in rng.uniform((8.0, -4.0, 0.4, -20.0), (28.0, 4.0, 1.0, 20.0), (n, 4))
    ]


def run_set(scenarios=None, plant=SingleTrack, **options):
    return RunSet(plant(CAR), controller(), scenarios or lane_changes(), **options)


class Rated(RunSet):
    """Runs whose cost is a function of the tuning and of the number of the run; nothing is driven."""

    def __init__(self, cost, runs=6):
        self.cost, self.runs, self.seeds = cost, runs, set()

    def __len__(self):
        return self.runs

    def drive(self, policy, seeds, indices=None):
        self.seeds |= set(seeds)
        indices = np.arange(self.runs) if indices is None else indices
        tuning = policy.as_array() if isinstance(policy, Tuning) else np.asarray(policy, dtype=float)
        rows = np.broadcast_to(tuning, (len(indices), 4))
        return np.stack(
            [np.array([self.cost(row, run) for row, run in zip(rows, indices, strict=True)])] * len(seeds), axis=1
        )


def bowl(ratio=3.5):
    """A cost that is lowest, 1, at Np = 35, Nc = 8 and this log10 R/Q, and the same in all runs."""

    def cost(row, run):
        offsets = (row[0] - 35.0) / 10.0, (row[1] - 8.0) / 5.0, math.log10(row[3] / row[2]) - ratio
        return math.exp(sum(offset**2 for offset in offsets))

    return cost
