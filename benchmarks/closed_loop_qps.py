"""Quadratic programmes met in closed loops: both profiles, pulses and Laguerre moves, random tunings and situations."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from adaptrack.controllers import MPC, Limits, Moves, MPCCommand, Tuning, published_mpc
from adaptrack.failure import Failure
from adaptrack.plant import DualTrack
from adaptrack.qp import QP
from adaptrack.scenario import load_scenario
from adaptrack.simulate import simulate
from adaptrack.vehicle import load_vehicle

SHARE = 0.5
"""Of the steps of a drive, this many are recorded: neighbours are alike."""


class Recorder:
    """An MPC that keeps a copy of the problems it meets."""

    def __init__(self, mpc: MPC, rng: np.random.Generator) -> None:
        self.mpc, self.rng, self.met = mpc, rng, list[QP]()
        self.name, self.period = mpc.name, mpc.period
        self.reset, self.describe = mpc.reset, mpc.describe

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None) -> MPCCommand:
        """As `MPC.step`."""
        if self.rng.random() < SHARE and np.isfinite(state).all():
            self.met.append(self.mpc.problem(state, speed, reference))
        return self.mpc.step(state, speed, reference, variables)


def recorded_qps(count: int, seed: int) -> Iterator[QP]:
    """`count` problems from as many drives as that takes; the same for the same seed."""
    rng = np.random.default_rng([seed, 1])
    car = load_vehicle("paper")
    given = 0
    while given < count:
        road = rng.random() < 0.5
        Np = int(rng.integers(1, 56))
        r = 10.0 ** rng.uniform(0.0, 4.0) if road and rng.random() < 0.8 else rng.uniform(0.001, 0.1)
        tuning = Tuning(Np, int(rng.integers(1, min(Np, 18) + 1)), rng.uniform(0.1, 10.0), r)
        laguerre = rng.random() < 0.2
        mpc = published_mpc(
            car,
            tuning,
            period=0.05 if road else 0.1,
            preview=road,
            moves=Moves.laguerre(rng.uniform(0.5, 0.95), int(rng.integers(2, 11))) if laguerre else Moves.pulses(),
            limits=Limits(output=(-1.0, 12.0)) if rng.random() < 0.2 else Limits(),
        )
        speed, wind = rng.uniform(3.0, 27.0), rng.uniform(-30.0, 30.0)
        test = "lane-change" if rng.random() < 0.5 else "step"
        blow = {"gust": wind} if test == "lane-change" else {"wind": wind}
        amplitude = rng.uniform(-14.0, 14.0)
        drive = load_scenario(
            test, amplitude=amplitude, speed=speed, friction=rng.uniform(0.5, 0.9), duration=6.0, **blow
        )
        recorder = Recorder(mpc, rng)
        profile = "road" if road else "paper"
        end = Failure(distance=50.0, sideslip=math.inf)
        simulate(DualTrack(car), recorder, drive, profile=profile, seed=int(rng.integers(1 << 30)), failure=end)
        yield from recorder.met[: count - given]
        given += len(recorder.met)
