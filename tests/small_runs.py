"""Short runs on the road with the paper's car, for what drives sets of runs."""

from __future__ import annotations

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
