"""Random configurations and inputs, good and bad: numbers and text alone, so that a file can hold them.

Bad inputs come in bursts among good ones: NaN, infinities, the largest and the smallest numbers, absurd speeds, ages
and times, stuck sensors, malformed arguments, schedulers that answer what is no tuning.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rng = np.random.Generator
Case = dict[str, Any]

HOSTILE = (
    math.nan, math.inf, -math.inf, 1.7e308, -1.7e308, 1e300, -1e300, 1e160, -1e100, 1e30, -1e18, 1e9, -1e6, 3e4,
    5e-324, -1e-310, -0.0,
)  # fmt: skip
MALFORMED: tuple[Any, ...] = ([], [1.0, 2.0], [[1.0, 2.0], [3.0, 4.0]], "text", None, True, ["a", "b", "c", "d"])
LIES: tuple[Any, ...] = (
    [math.nan] * 4, [1e300, 1e300, 1e300, 1e300], [20, 30, 1.0, 1.0], [0, 0, 0.0, 0.0], [-5, -5, -1.0, -1.0],
    [10, 2, 1.0, math.inf], [10, 2, math.inf, 1.0], [30, 5, 1e300, 1e-300], [30, 5, 1e-300, 1e300],
    [30.49, 5.5, 1.0, 1.0],
    [1.0, 2.0], [], "text", None, "raise", [True, False, 1.0, 1.0],
)  # fmt: skip
"""What a scheduler may answer; "raise": it raises an error."""
SENSORS = (0.3, 0.05, 0.1, 1.0, 0.05, 1.0)
"""Spread of good samples of v_y, yaw, yaw rate, y, wheel angle, lateral acceleration."""
CARS = ("paper", "midsize-sedan", "van", "model-car", "compact-ev")
BURST = 25
"""The mean length of a burst."""


def choose(rng: Rng, values: Sequence[Any]) -> Any:
    """One of them."""
    return values[int(rng.integers(len(values)))]


def bursts(rng: Rng, steps: int, share: float) -> NDArray[np.bool_]:
    """(steps,) where inputs are bad: about so large a share, in bursts."""
    bad = np.zeros(steps, dtype=bool)
    k = int(rng.geometric(1.0 / 40.0))
    while k < steps and share > 0.0:
        length = int(rng.geometric(1.0 / choose(rng, (1.5, BURST, 4 * BURST))))
        bad[k : k + length] = True
        k += length + int(rng.geometric(min(1.0, share / ((1.0 - share) * length + 1.0))))
    return bad


def spoil(rng: Rng, rows: Array, bad: NDArray[np.bool_], share: float) -> None:
    """Make a share of the entries of bad rows hostile."""
    hit = (rng.random(rows.shape) < share) & (bad if rows.ndim == 1 else bad[:, None])
    rows[hit] = np.asarray(HOSTILE)[rng.integers(len(HOSTILE), size=int(hit.sum()))]


# -- model predictive controllers -------------------------------------------------------------------------------------
def mpc_case(rng: Rng) -> Case:
    """A configuration of an MPC: published, informed or learning."""
    kind = choose(rng, ("published", "published", "informed", "learning"))
    case: Case = {"target": "mpc", "kind": kind, "car": choose(rng, CARS), "solver": "active-set", "policy": "exact"}
    case["lies"] = bool(rng.random() < 0.2)
    case["frozen"] = bool(rng.random() < 0.2)
    if kind == "published" or rng.random() < 0.3:
        longest = int(rng.integers(1, 61))
        most = min(longest, 20)
        case["tuning"] = [longest, int(rng.integers(1, most + 1)), 10 ** rng.uniform(-2, 2), 10 ** rng.uniform(-4, 5)]
    if kind != "published":
        case["profile"] = choose(rng, ("road", "production"))
        return case
    case["period"] = choose(rng, (0.05, 0.1))
    case["preview"] = bool(rng.random() < 0.5)
    angle, move = rng.uniform(0.05, 0.6), rng.uniform(0.005, 0.3)
    case["limits"] = {"move": [-move, move], "angle": [-angle, angle]}
    if rng.random() < 0.1:
        case["limits"] = {"move": [-move, 0.0], "angle": [0.0, angle]}  # one way only
    if rng.random() < 0.2:
        case["limits"]["output"] = [-rng.uniform(0.0, 3.0), rng.uniform(0.0, 3.0)]
    if rng.random() < 0.3:
        case["moves"] = ["laguerre", rng.uniform(0.0, 0.95), int(rng.integers(1, 9))]
    if rng.random() < 0.3:
        case["solver"], case["policy"] = "hildreth", choose(rng, ("exact", "hold"))
    return case


def measured(rng: Rng, steps: int) -> Array:
    """(steps, 10) good samples, as `MPC.step` takes them; a tenth of the drives wide, another with a sensor stuck."""
    states = np.zeros((steps, 10))
    kind = rng.random()
    states[:, :6] = rng.normal(size=(steps, 6)) * SENSORS
    if kind < 0.1:
        states[:, :6] *= 10.0 ** rng.uniform(0.0, 4.0)
    elif kind < 0.2:
        states[:, choose(rng, (0, 2, 4, 5))] = rng.normal()  # a position that is stuck is rightly not believed
    states[:, 6:8] = rng.uniform(0.0, 0.1, size=(steps, 2)) * (rng.random() < 0.5)
    states[:, 8] = rng.normal(size=steps) * 0.005
    states[:, 9] = rng.uniform(0.1, 1.2) * (rng.random() < 0.5)  # the friction, where it is known
    return states


def paces(rng: Rng, steps: int) -> Array:
    """(steps,) m/s, good speeds."""
    pace = rng.uniform(0.0, 35.0)
    return np.full(steps, pace) if rng.random() < 0.3 else np.abs(pace + rng.normal(size=steps))


def references(rng: Rng, steps: int) -> Array:
    """(steps, .) m, good references."""
    return rng.normal(size=(steps, int(rng.integers(1, 80))))


def mpc_inputs(case: Case, rng: Rng, steps: int) -> list[Case]:
    """What an MPC is given at each step, and whether it is good."""
    bad = bursts(rng, steps, choose(rng, (0.0, 0.1, 0.4)))
    share = choose(rng, (0.03, 0.2, 0.8))
    states, speeds, ahead = measured(rng, steps), paces(rng, steps), references(rng, steps)
    for rows in (states, ahead, speeds):
        spoil(rng, rows, bad, share)
    states = states[:, : int(choose(rng, (4, 4, 6, 8, 9, 10)))]
    given: list[Case] = [
        {"state": state, "speed": speed, "reference": reference, "good": good}
        for state, speed, reference, good in zip(states, speeds.tolist(), ahead, (~bad).tolist(), strict=True)
    ]
    for k in np.flatnonzero(bad & (rng.random(steps) < 0.2)).tolist():
        given[k][choose(rng, ("state", "reference"))] = choose(rng, MALFORMED)
    for k in np.flatnonzero(bad & (rng.random(steps) < 0.1)).tolist():
        number = float(choose(rng, (*HOSTILE, 0.0, 0.1, -0.5, 2.0)))
        given[k]["before"] = choose(rng, (["applied", number], ["change_path", number, number], ["restart"]))
    if case["lies"]:
        for k in range(steps):
            given[k]["answer"] = choose(rng, LIES) if bad[k] else [20, 5, 1.0, 10.0]
    return given


# -- laws -------------------------------------------------------------------------------------------------------------
def law_case(rng: Rng) -> Case:
    """A configuration of a steering law."""
    angle, move = rng.uniform(0.05, 0.6), rng.uniform(0.005, 0.3)
    return {
        "target": "law", "kind": choose(rng, ("LQR", "Stanley", "PurePursuit")), "car": choose(rng, CARS),
        "preview": bool(rng.random() < 0.5), "limits": {"move": [-move, move], "angle": [-angle, angle]},
        "lies": False, "frozen": bool(rng.random() < 0.2),
    }  # fmt: skip


def law_inputs(case: Case, rng: Rng, steps: int) -> list[Case]:
    """What a law is given: an MPC's inputs, their states cut to four numbers."""
    given = mpc_inputs(case, rng, steps)
    for each in given:
        if isinstance(each["state"], np.ndarray):
            each["state"] = each["state"][:4]
        if each.get("before", ["applied"])[0] == "restart":
            del each["before"]
    return given


# -- trackers ---------------------------------------------------------------------------------------------------------
PATHS = ("circle", "line", "loop", "country")
KEYS = ("t", "x", "y", "yaw", "speed", "yaw_rate", "lateral_velocity", "lateral_acceleration", "wheel_angle", "now")
_SPREAD = (0.005, 0.05, 0.05, 0.01, 0.1, 0.01, 0.1, 0.2, 0.01, 0.0)


def tracker_case(rng: Rng) -> Case:
    """A configuration of a tracker."""
    kind = choose(rng, ("informed", "informed", "learning", "published", "LQR", "Stanley", "PurePursuit"))
    return {
        "target": "tracker", "kind": kind, "car": "paper", "profile": choose(rng, ("road", "production")),
        "path": choose(rng, PATHS), "plan": bool(rng.random() < 0.3), "lies": False,
    }  # fmt: skip


def tracker_inputs(case: Case, rng: Rng, steps: int) -> list[Case]:
    """Calls of a car on a circle of 60 m, at times that stray: each a dictionary of the arguments of `Tracker.step`."""
    bad = bursts(rng, steps, choose(rng, (0.0, 0.1, 0.4)))
    share = choose(rng, (0.03, 0.15, 0.6))
    least, most = choose(rng, ((0.05, 0.05), (0.02, 0.09), (0.01, 0.01)))
    time = np.cumsum(rng.uniform(least, most, size=steps))
    speed = rng.uniform(0.0, 25.0)
    turned = speed * time / 60.0
    rate = np.full(steps, speed / 60.0)
    nothing = np.full(steps, math.nan)
    true = (time, 60.0 * np.sin(turned), 60.0 * (1.0 - np.cos(turned)), turned, np.full(steps, speed), rate, nothing,
            nothing, nothing, nothing)  # fmt: skip
    rows = np.stack(true, axis=-1) + rng.normal(size=(steps, len(KEYS))) * _SPREAD
    if rng.random() < 0.5:
        rows[:, 9] = time + rng.uniform(0.0, 0.2)  # late
    if rng.random() < 0.5:
        rows[:, 6:9] = rng.normal(size=(steps, 3)) * 0.05
    if rng.random() < 0.3:
        rows[:, 3] = np.remainder(rows[:, 3] + math.pi, 2.0 * math.pi) - math.pi
    spoil(rng, rows, bad, share)
    jumps = bad & (rng.random(steps) < 0.1)
    rows[jumps, 0] += rng.choice([-1e9, -5.0, -1.0, 0.0, 1.0, 5.0, 1e9, 1e15], size=int(jumps.sum()))
    given = [_call(row, good) for row, good in zip(rows.tolist(), (~bad).tolist(), strict=True)]
    for k in np.flatnonzero(bad & (rng.random(steps) < 0.1)).tolist():
        number = float(choose(rng, (*HOSTILE, 0.0, 0.3, -0.3)))
        given[k]["before"] = choose(rng, (["engage", number], ["follow", choose(rng, PATHS)]))
    return given


def _call(row: list[float], good: bool) -> Case:
    call: Case = dict(zip(KEYS, row, strict=True))
    if math.isnan(call["now"]):
        call["now"] = None
    if math.isnan(call["wheel_angle"]):
        call["wheel_angle"] = None
    return {"call": call, "good": good}


# -- estimators -------------------------------------------------------------------------------------------------------
def friction_case(rng: Rng) -> Case:
    """A configuration of the friction and wind estimator."""
    return {
        "target": "friction", "car": choose(rng, CARS), "period": choose(rng, (0.05, 0.1)),
        "delay": bool(rng.random() < 0.5), "lies": False,
    }  # fmt: skip


def friction_inputs(case: Case, rng: Rng, steps: int) -> list[Case]:
    """What the estimator is given at each step."""
    bad = bursts(rng, steps, choose(rng, (0.0, 0.1, 0.4)))
    rows = rng.normal(size=(steps, 7)) * (0.3, 0.05, 0.1, 1.0, 0.3, 0.05, 1.0)
    rows[:, 4] += rng.uniform(0.0, 35.0)
    spoil(rng, rows, bad, choose(rng, (0.03, 0.2, 0.8)))
    return [{"row": row, "good": good} for row, good in zip(rows.tolist(), (~bad).tolist(), strict=True)]
