"""An adaptation small enough to run in a test: the whole chain in seconds, from its own campaign to its schedulers."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from adaptrack.base.files import write_toml
from adaptrack.control.scheduling import Schedule
from adaptrack.learning.adaptation.config import load_adaptation
from adaptrack.learning.adaptation.splits import SetUp
from adaptrack.studies import adapt as study

CAMPAIGN: dict[str, Any] = {
    "profile": "road",
    "scenario": "lane-change",
    "noise_seeds": [1],
    "seed": 2,
    "operating_points": {
        "kind": "sobol",
        "n": 24,
        "seed": 2,
        "box": {"speed": [8.0, 25.0], "y_ref": [-4.0, 4.0], "friction": [0.5, 1.0], "wind": [-15.0, 15.0]},
    },
    "search": {"Np": [10, 40], "Nc": [1, 10], "Q": [1.0, 1.0], "R": [100.0, 1e5], "decades": True},
    "swarm": {"particles": 4, "generations": 2},
    "library": {"tunings": [[25, 5, 1, 1000], [30, 5, 1, 4000], [30, 8, 1, 10000], [35, 5, 1, 20000]]},
}
ADAPTATION: dict[str, Any] = {
    "campaign": "pond.toml",
    "learning": {
        "inputs": ["speed", "friction"],
        "rounds": 2,
        "operating_points": 16,
        "drives": 8,
        "hard_drives": 8,
        "rules": 4,
        "domain": {"speed": [3.0, 30.0], "friction": [0.3, 1.0]},
    },
    "method": {  # few runs held out, short searches for constants, short training of the paper's recipe
        "runs": {"held_out_points": 8, "held_out_drives": 2},
        "constants": {"evaluations": 20},
        "recipe": {"nn_epochs": 20, "anfis_epochs": 2},
    },
    "evaluation": {"operating_points": 8, "drives": 8, "known_as": ["exact"]},
}


def write(folder: Path, pond: dict[str, Any] | None = None, **changes: Any) -> Path:
    """The file of an adaptation called tiny, its campaign beside it as pond; changes of a table are merged."""
    folder.mkdir(parents=True, exist_ok=True)
    write_toml(folder / "pond.toml", CAMPAIGN | (pond or {}))
    values = dict(ADAPTATION)
    for key, value in changes.items():
        values[key] = values[key] | value if isinstance(value, dict) and key in values else value
    write_toml(folder / "tiny.toml", {key: value for key, value in values.items() if value is not None})
    return folder / "tiny.toml"


@contextmanager
def short_cuts() -> Iterator[pytest.MonkeyPatch]:
    """No ceiling to the paper's recipe."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("adaptrack.paper.training.ceiling", lambda x, y, held, *more: np.full(len(held), y.mean()))
        yield patch


class Chain(NamedTuple):
    """A chain that has run."""

    setup: SetUp
    folder: Path
    schedules: dict[str, Schedule]


@lru_cache(maxsize=1)
def learned(base: Path) -> Chain:
    """The chain of `write`, run once for all processes of a test run; nobody may change its folder.

    base: pytest's folder of this process. Whoever comes second waits, and goes on with what the first has kept.
    """
    place = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "chain"
    place.mkdir(exist_ok=True)
    with open(place / "lock", "w") as lock, short_cuts():
        fcntl.flock(lock, fcntl.LOCK_EX)
        config = place / "tiny.toml"
        setup = SetUp.of(load_adaptation(config if config.exists() else write(place)))
        return Chain(setup, place / "out", study.learn(setup, place / "out"))
