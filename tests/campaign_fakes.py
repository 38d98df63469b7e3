"""A stand-in for the closed loop, cheap and deterministic, and campaigns small enough for tests."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

import numpy as np

from adaptrack.paper.campaign_config import CampaignConfig, Setup


@dataclass(frozen=True)
class Found:
    tuning: np.ndarray
    cost: float
    trace: np.ndarray
    evaluations: int
    control_steps: int


class Fake:
    """A bowl around a best tuning that depends on the operating point; symmetric to left and right, as a car is."""

    def __init__(self, setup: Setup) -> None:
        self.config = setup.config
        self.pause = float(os.environ.get("FAKE_PAUSE", "0"))

    def versions(self):
        return {"fake": os.environ.get("FAKE_VERSION", "1")}

    def best(self, point):
        speed, y_ref, friction, wind = point
        ratio = 1e-3 * (1.0 + 0.05 * speed + 0.01 * y_ref * wind / 30.0 + friction)
        return np.array([5.0 + round(speed), 3.0 + round(4.0 * friction), 2.0, 2.0 * ratio])

    def landscape(self, point, library):
        if self.pause:
            time.sleep(self.pause)
        Np, Nc, Q, R = np.asarray(library).T
        best = self.best(point)
        scale = 0.01 * (1.0 + point[1] ** 2)
        away = (Np - best[0]) ** 2 / 400 + (Nc - best[1]) ** 2 / 40 + np.log(R / Q * best[2] / best[3]) ** 2
        return np.where(Np < 2, np.inf, scale * (1.0 + away))

    def tune(self, point, seed, stream):
        swarm = self.config.swarm
        near = np.random.default_rng([seed, stream]).normal(size=2)
        best = self.best(point)
        found = best * [1.0, 1.0, 1.0, np.exp(0.1 * near[0])]
        cost = float(self.landscape(point, found[None])[0])
        trace = cost * (1.0 + np.exp(-np.arange(swarm.generations)))
        trace[-1] = cost
        return Found(found, cost, trace, swarm.evaluations, 160 * swarm.evaluations)


class Broken(Fake):
    """Answers one operating point with nonsense."""

    def tune(self, point, seed, stream):
        if stream == 5:
            return Found(np.array([3.0, 9.0, 1.0, 1.0]), 1.0, np.ones(4), 1, 1)
        return super().tune(point, seed, stream)


class Failing(Fake):
    """Fails on one operating point, as code does."""

    def tune(self, point, seed, stream):
        if stream == 5:
            raise ZeroDivisionError("a bug in the objective")
        return super().tune(point, seed, stream)


def small(**changes) -> CampaignConfig:
    """48 operating points, 36 of which are computed, in 6 chunks."""
    return CampaignConfig(
        **{
            "name": "small",
            "profile": "paper",
            "scenario": "step",
            "chunk": 6,
            "seed": 3,
            "operating_points": {
                "kind": "grid",
                "speed": (5.0, 10.0, 20.0),
                "y_ref": (-4.0, 2.0, 4.0, 6.0),
                "friction": (0.5, 0.9),
                "wind": (-5.0, 5.0),
            },
            "swarm": {"particles": 5, "generations": 4},
            "library": {"size": 8, "seed": 1},
            **changes,
        }
    )
