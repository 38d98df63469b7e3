"""An adaptation small enough for a test: campaign and schedules in seconds."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from adaptrack.base.files import write_toml
from adaptrack.control.scheduling import Schedule
from adaptrack.paper import adaptation
from adaptrack.paper.adaptation import Effort, LearningTask
from adaptrack.paper.campaign_config import load_campaign

BOX = {"speed": [8.0, 25.0], "y_ref": [-4.0, 4.0], "friction": [0.5, 1.0], "wind": [-15.0, 15.0]}
CAMPAIGN: dict[str, Any] = {
    "profile": "road", "scenario": "lane-change", "noise_seeds": [1], "seed": 2,
    "operating_points": {"kind": "sobol", "n": 24, "seed": 2, "box": BOX},
    "search": {"Np": [10, 40], "Nc": [1, 10], "Q": [1.0, 1.0], "R": [100.0, 1e5], "decades": True},
    "swarm": {"particles": 4, "generations": 2},
    "library": {"tunings": [[25, 5, 1, 1000], [30, 5, 1, 4000], [30, 8, 1, 10000], [35, 5, 1, 20000]]},
}  # fmt: skip
EFFORT = Effort(2, 16, 8, 8, 8, 2, (8, 4, 4), 20)
NODES = ((10, 26, 42, 60), (1, 5, 20), np.linspace(1.0, 6.0, 6))
"""Np, Nc, log10 R/Q of the guard's map."""


def write(folder: Path, **changes: Any) -> Path:
    """The file of a campaign called pond."""
    folder.mkdir(parents=True, exist_ok=True)
    write_toml(folder / "pond.toml", CAMPAIGN | changes)
    return folder / "pond.toml"


def task_of(folder: Path, **changes: Any) -> LearningTask:
    """The learning task of a small campaign with some of its keys changed."""
    return LearningTask.of(load_campaign(write(folder, **changes)), EFFORT)


@contextmanager
def short_cuts() -> Iterator[pytest.MonkeyPatch]:
    """A coarse map for the guard, few runs for constants and clusters."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(adaptation, "loop_map", partial(adaptation.loop_map, nodes=NODES))
        patch.setattr(adaptation, "CLUSTERED_INPUTS", 400)
        yield patch


class Chain(NamedTuple):
    """A finished adaptation."""

    task: LearningTask
    file: Path
    """of its campaign"""
    folder: Path
    schedules: dict[str, Schedule]


@lru_cache(maxsize=1)
def learned(base: Path) -> Chain:
    """The adaptation of `CAMPAIGN`, run once for all processes of a test run; its folder must not be changed.

    base: pytest's folder of this process. A second process waits for the first one, and reads its files.
    """
    place = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "chain"
    place.mkdir(exist_ok=True)
    with open(place / "lock", "w") as lock, short_cuts():
        fcntl.flock(lock, fcntl.LOCK_EX)
        file = write(place)
        schedules = adaptation.adapt(load_campaign(file), place / "out", workers=1, effort=EFFORT)
        return Chain(task_of(place), file, place / "out", schedules)
