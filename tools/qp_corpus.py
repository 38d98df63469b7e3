"""A corpus of quadratic programmes of the controllers, by class and seed, that any solver can be run on.

Recorded ones come from closed loops of both controllers: all profiles, several cars, drives, winds and tunings. The
others are made from recorded ones and keep their structure. The first move (rad) of a solution is ``M[0] @ x``.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.cars.plant import DualTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import MPC, Controller, Learning, Limits, Moves, MPCCommand, Tuning, published_mpc
from adaptrack.control.qp import QP, QPStatus
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.simulate import simulate
from adaptrack.scenario import load_scenario

Array = NDArray[np.float64]
Rng = np.random.Generator

CARS = ("paper", "midsize-sedan", "van", "compact-ev")
PROFILES = ("paper", "road", "production")
CHUNK = 500
"""Problems that a seed and a number give: chunks may be made in any order."""
SHARE = 0.4
"""Of the steps of a drive, so many are recorded: neighbours are alike."""


class Problem(NamedTuple):
    """One of the corpus."""

    kind: str
    """`CLASSES`, or "published" and "informed" for those of closed loops"""
    qp: QP
    feasible: bool | None
    """by how it was made; None: a reference has to say"""
    applied: float
    """rad, first move of the plan that the controller made of it in its loop; NaN where it was in none"""


class _Recorder(Controller):
    """An MPC that keeps the problems that it has solved, and its first moves."""

    def __init__(self, mpc: MPC, rng: Rng) -> None:
        self.mpc, self.rng, self.met = mpc, rng, list[tuple[QP, float]]()
        self.name, self.period = mpc.name, mpc.period
        self.reset, self.describe = mpc.reset, mpc.describe

    def step(self, state: Any, speed: float, reference: Any, variables: Any = None, road: Any = None) -> MPCCommand:
        """As `MPC.step`."""
        told = self.mpc.step(state, speed, reference, variables, road)
        if self.rng.random() < SHARE and told.status is QPStatus.SOLVED and speed > 1.0:
            qp, x = self.mpc.solved_problem()
            self.met.append((qp, float(qp.M[0] @ x)))
        return told


def _controller(rng: Rng, car: Any, profile: str, informed: bool) -> MPC:
    """A random controller."""
    limits = Limits(output=(-1.0, 12.0)) if rng.random() < 0.2 else None
    Np = int(rng.integers(1, 56))
    Nc = int(rng.integers(1, min(Np, 18) + 1))
    if informed:
        tuning = None if rng.random() < 0.5 else Tuning(Np, Nc, rng.uniform(0.1, 10.0), 10.0 ** rng.uniform(-1.0, 3.0))
        learning = Learning() if rng.random() < 0.3 else None
        return MPC(car, tuning, profile=profile, learning=learning)
    weight = 10.0 ** rng.uniform(0.0, 4.0) if profile != "paper" and rng.random() < 0.8 else rng.uniform(0.001, 0.1)
    moves = Moves.laguerre(rng.uniform(0.5, 0.95), int(rng.integers(2, 11))) if rng.random() < 0.2 else Moves.pulses()
    return published_mpc(
        car, Tuning(Np, Nc, rng.uniform(0.1, 10.0), weight), period=0.1 if profile == "paper" else 0.05,
        preview=profile != "paper", moves=moves, limits=limits or Limits(),
    )  # fmt: skip


def _drive(rng: Rng) -> Iterator[Problem]:
    """What one closed loop meets."""
    car, profile = load_vehicle(CARS[rng.integers(len(CARS))]), PROFILES[rng.integers(len(PROFILES))]
    informed = bool(profile != "paper" and rng.random() < 0.6)
    if profile == "production":
        informed = True  # the published controller needs the lateral velocity
    mpc = _controller(rng, car, profile, informed)
    test = ("lane-change", "step")[rng.integers(2)]
    wind: dict[str, Any] = {"gust" if test == "lane-change" else "wind": rng.uniform(-30.0, 30.0)}
    drive = load_scenario(
        test, amplitude=rng.uniform(-14.0, 14.0), speed=rng.uniform(3.0, 27.0), friction=rng.uniform(0.5, 0.9),
        duration=6.0, **wind,
    )  # fmt: skip
    recorder = _Recorder(mpc, rng)
    end = FailureLimits(distance=50.0, sideslip=math.inf)
    simulate(DualTrack(car), recorder, drive, profile=profile, seed=int(rng.integers(1 << 30)), failure=end)
    for qp, applied in recorder.met:
        yield Problem("informed" if informed else "published", qp, True, applied)


# -- made of recorded ones --------------------------------------------------------------------------------------------
def limited(qp: QP, rng: Rng) -> Problem:
    """The minimiser without rows is far outside: K a hundred to a million times as large."""
    return Problem("limited", QP(qp.E, qp.K * 10.0 ** rng.uniform(2.0, 6.0), qp.M, qp.gamma), True, math.nan)


def nearly_infeasible(qp: QP, rng: Rng) -> Problem:
    """A last angle so far outside its limit that one move just suffices: the first rows leave 1e-9 to 1e-2 rad."""
    return _beyond("nearly infeasible", qp, 10.0 ** rng.uniform(-9.0, -2.0))


def infeasible(qp: QP, rng: Rng) -> Problem:
    """The same where a move misses by 1e-6 to 1 rad."""
    return _beyond("infeasible", qp, -(10.0 ** rng.uniform(-6.0, 0.0)))


def _beyond(kind: str, qp: QP, room: float) -> Problem:
    """Let the first move have so much room (rad) between its limit and that of the angle, the later ones no less.

    Rows 0 and 3 are opposite, M_0 x <= gamma_0 and -M_0 x <= gamma_3: no x satisfies both where the room is negative.
    """
    gamma, rows = np.array(qp.gamma), _limit_rows(qp)
    gamma[3] = room - gamma[0]
    gamma[3:rows:4] = np.maximum(gamma[3:rows:4], gamma[3])
    gamma[2:rows:4] = np.maximum(gamma[2:rows:4], gamma[0])
    gamma[3] = room - gamma[0]
    return Problem(kind, QP(qp.E, qp.K, qp.M, gamma), None if room >= 0.0 else False, math.nan)


def _limit_rows(qp: QP) -> int:
    """How many rows limit moves and angles, four a sample; soft ones on y, with -1 in the last column, follow."""
    soft = np.flatnonzero((qp.M[:, -1] == -1.0) & (np.abs(qp.M).sum(axis=1) != 1.0)) if qp.m else np.zeros(0)
    return int(soft[0]) // 4 * 4 if soft.size and soft[0] >= 4 else qp.m


def ill_conditioned(qp: QP, rng: Rng) -> Problem:
    """Moves that cost nothing next to nothing: all but 1e-8 to 1e-3 of the least eigenvalue of E is taken away."""
    values, vectors = np.linalg.eigh(qp.E)
    least = max(values[0] * 10.0 ** rng.uniform(-8.0, -3.0), values[-1] * 1e-12)
    E = (vectors * (values - values[0] + least)) @ vectors.T
    return Problem("ill-conditioned", QP((E + E.T) / 2.0, qp.K, qp.M, qp.gamma), True, math.nan)


def degenerate(qp: QP, rng: Rng) -> Problem:
    """Limits on moves and angles that meet in one corner, and rows twice."""
    twice = rng.permutation(qp.m)[: qp.m // 4]
    gamma = np.array(qp.gamma)
    near = np.abs(gamma) < 10.0
    gamma[near] = np.round(gamma[near] * 16.0) / 16.0
    gamma = np.maximum(gamma, 0.0)
    return Problem(
        "degenerate", QP(qp.E, qp.K, np.vstack([qp.M, qp.M[twice]]), np.append(gamma, gamma[twice])), True, math.nan
    )


CLASSES: dict[str, Callable[[QP, Rng], Problem]] = {
    "limited": limited, "nearly infeasible": nearly_infeasible, "infeasible": infeasible,
    "ill-conditioned": ill_conditioned, "degenerate": degenerate,
}  # fmt: skip
"""What is made of recorded problems."""


def chunk(number: int, seed: int = 1) -> list[Problem]:
    """`CHUNK` problems: three quarters recorded, the rest made of them, an even share of each class."""
    rng = np.random.default_rng([seed, number])
    found: list[Problem] = []
    while len(found) < CHUNK:
        for problem in _drive(rng):
            found.append(problem)
            if rng.random() < 1.0 / 3.0:
                make = list(CLASSES.values())[rng.integers(len(CLASSES))]
                found.append(make(problem.qp, rng))
    return found[:CHUNK]
