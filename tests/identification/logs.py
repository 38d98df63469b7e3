"""Logs of the single-track vehicle whose truth is known, and how tests write them."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy.integrate import odeint

import adaptrack as at
from adaptrack.identification.hypotheses import Evidence, refuse_contradictions
from adaptrack.identification.likelihood import Likelihood
from adaptrack.identification.log import Log
from adaptrack.identification.log_identification import prepare
from adaptrack.identification.quantities import beliefs_of
from adaptrack.identification.reading import Reading, read_columns

PERIOD, LAG, DEAD_TIME, BIAS, RELAXATION = 0.05, 0.18, 0.13, 0.006, 0.3
CAR = at.load_vehicle("compact-ev").replace(steering=None, side_force_slope=0.0, yaw_moment_slope=0.0)


def likelihood_of(log: dict[str, Any], car: at.Vehicle) -> Likelihood:
    """The likelihood of a log and a car, as `identify` makes it."""
    return prepare(read_columns(log, Reading()), car, beliefs_of(car))


def driven(
    duration: float, seed: int = 0, *, noise: float = 0.003, speed: float | None = None
) -> dict[str, np.ndarray]:
    """A log that a test may change, see `integrated`."""
    return dict(integrated(duration, seed, noise, speed))


@cache
def integrated(
    duration: float, seed: int, noise: float, speed: float | None, swing: float = 1.0
) -> dict[str, np.ndarray]:
    """A log of the single-track vehicle on linear tyres behind lag and dead time, integrated by SciPy: the truth.

    swing: factor on the steering angles.
    """
    rng = np.random.default_rng(seed)
    time = PERIOD * np.arange(round(duration / PERIOD))
    waves = rng.uniform(0.05, 1.2, 8), rng.uniform(0.0, math.tau, 8)
    command = swing * 0.012 * np.sin(math.tau * np.outer(time, waves[0]) + waves[1]).sum(axis=1) / math.sqrt(8) * 2
    pace = np.full(time.size, speed) if speed else 15.0 + 7.0 * np.sin(0.2 * time)
    front, rear = 2.0 * CAR.stiffness_front, 2.0 * CAR.stiffness_rear

    def slope(t: float, x: np.ndarray) -> list[float]:
        vy, r, af, ar, delta = x
        v = float(np.interp(t, time, pace))
        late = min(max(math.floor((t - DEAD_TIME) / PERIOD + 1e-9), 0), time.size - 1)
        return [
            (front * af + rear * ar) / CAR.mass - v * r, (CAR.lf * front * af - CAR.lr * rear * ar) / CAR.yaw_inertia,
            v * (delta - math.atan2(vy + CAR.lf * r, v) - af) / RELAXATION,
            -v * (math.atan2(vy - CAR.lr * r, v) + ar) / RELAXATION, (command[late] + BIAS - delta) / LAG,
        ]  # fmt: skip

    start = [0.0, 0.0, 0.0, 0.0, command[0] + BIAS]
    x = odeint(slope, start, time, tfirst=True, hmax=0.01, rtol=1e-7, atol=1e-9).T
    force = (front * x[2] + rear * x[3]) / CAR.mass
    return {
        "time": time, "command": command, "speed": pace, "yaw_rate": x[1] + noise * rng.standard_normal(time.size),
        "wheel": x[4], "acceleration": force, "vy": x[0],
    }  # fmt: skip


def base(duration: float = 60.0, seed: int = 0, **options: Any) -> dict[str, np.ndarray]:
    """Time, command, speed and yaw rate of a log, see `driven`."""
    drive = driven(duration, seed, **options)
    return {name: drive[name] for name in ("time", "command", "speed", "yaw_rate")}


def held(command: np.ndarray, rows: int) -> np.ndarray:
    """A command some rows later."""
    return command[np.maximum(np.arange(command.size) - rows, 0)]


def check_signals(log: Log) -> None:
    """Raise an error where the signs or units of the signals contradict each other."""
    refuse_contradictions(Evidence(wheelbase=CAR.wheelbase, cleaned=log), "signals")


def write_csv(path: Path, columns: dict[str, Any], units: str = "") -> Path:
    """A file of columns, with a row of units below the names where there are units."""
    rows = [",".join(map(str, row)) for row in zip(*columns.values(), strict=True)]
    path.write_text("\n".join([",".join(columns), *([units] if units else []), *rows]) + "\n")
    return path
