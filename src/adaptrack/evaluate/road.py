"""The runs on which the ladder is climbed: conditions, random drives, the paper's two tests; and its rungs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from adaptrack.closed_loop import LOST_BEYOND, SPIN_BEYOND, Course
from adaptrack.controllers import MPC, Tuning
from adaptrack.dataset import DataSet
from adaptrack.errors import InvalidInput
from adaptrack.estimation import FrictionWindEstimator, Perception
from adaptrack.metrics import PUBLISHED
from adaptrack.plant import DualTrack, Plant, SingleTrack
from adaptrack.profile import load_profile
from adaptrack.scenario import load_scenario, random_drive
from adaptrack.scheduling import Lookup, Schedule
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.operating_points import NAMES, check_operating_points
from adaptrack.vehicle import Vehicle

Array = NDArray[np.float64]

START = Tuning(Np=29, Nc=5, Q=1.0, R=4000.0)
"""Keeps the road profile's car on most roads: where learning starts."""
HARD = {"speed": (17.0, 29.0), "demand": (0.2, 0.35)}
"""Fast drives near the limit, on which cars are lost."""
FIRST_TRAINING_DRIVE, FIRST_HELD_OUT_DRIVE, FIRST_EVALUATION_DRIVE = 1_000_000, 2_000_000, 3_000_000
"""Seeds of random drives: a training, a held-out and an evaluation drive are never the same."""

PERCEPTIONS: dict[str, Perception] = {
    "noisy": Perception(noise=0.1),
    "lagged": Perception(delay=1.0),
    "biased high": Perception(bias=0.2),
    "biased low": Perception(bias=-0.2),
    "withheld": Perception(withheld=True),
}
"""What the scheduler may be told of friction and wind, beside the truth and an estimate."""

Told = Perception | FrictionWindEstimator | None


def told(name: str, plant: SingleTrack | DualTrack, profile: str = "road") -> Told:
    """How friction and wind are known, by name: exact, estimated, or one of `PERCEPTIONS`.

    Raises
    ------
    InvalidInput
        For another name.
    """
    if name == "exact":
        return None
    if name == "estimated":
        return FrictionWindEstimator.of(plant, profile)
    if name not in PERCEPTIONS:
        raise InvalidInput(f"told = {name!r}: must be exact, estimated, {', '.join(PERCEPTIONS)}.")
    return PERCEPTIONS[name]


def controller(vehicle: Vehicle, profile: str = "road") -> MPC:
    """The MPC that every rung tunes: pulses, preview and period of the profile."""
    world = load_profile(profile)
    return MPC(vehicle, START, period=world.period, preview=world.preview)


def condition_course(
    plant: Plant, mpc: MPC, conditions: ArrayLike, profile: str = "road", known: Told = None
) -> Course:
    """One smooth lane change in a gust for each condition (n, 4)."""
    rows = check_operating_points(conditions)
    runs = [load_scenario("lane-change", speed=v, amplitude=y, friction=mu, gust=w) for v, y, mu, w in rows.tolist()]
    return Course(plant, mpc, runs, profile, stride=8, told=known)


def drive_course(
    plant: Plant, mpc: MPC, first: int, count: int, duration: float = 60.0, profile: str = "road", known: Told = None,
    options: Mapping[str, Any] | None = None,
) -> Course:  # fmt: skip
    """`count` random drives, numbered from `first` on; cost is attributed to stretches of 2 s and what is 2 s older."""
    runs = [random_drive(first + i, duration, **(options or {})) for i in range(count)]
    stretch = round(2.0 / mpc.period)
    return Course(plant, mpc, runs, profile, stretch=stretch, lead=stretch, told=known)


def paper_test(plant: Plant, mpc: MPC, name: str, profile: str = "road", known: Told = None) -> Course:
    """One of the paper's two tests.

    Raises
    ------
    InvalidInput
        When it is neither.
    """
    if name not in PUBLISHED:
        raise InvalidInput(f"test = {name!r}: must be one of {', '.join(PUBLISHED)}.")
    return Course(plant, mpc, [load_scenario(name)], profile, told=known)


def objective(plant: Plant, mpc: MPC, noise_seeds: Sequence[int], profile: str = "road") -> Objective:
    """The cost of a tuning on a condition; a run is lost when it is on a `Course`."""
    return Objective(
        plant, mpc, "lane-change", profile, tuple(noise_seeds), lost_beyond=LOST_BEYOND, spin_beyond=SPIN_BEYOND
    )


def sample_size(text: str) -> int:
    """The N of `sobol:N`.

    Raises
    ------
    InvalidInput
        When the text is not of that form.
    """
    kind, _, count = text.partition(":")
    if kind != "sobol" or not count.isdecimal() or int(count) < 1:
        raise InvalidInput(f"conditions = {text!r}: write sobol:N, for instance sobol:2000.")
    return int(count)


def neighbour_lookup(dataset: DataSet, nodes: Mapping[str, ArrayLike], neighbours: int = 12) -> Schedule:
    """A table of tunings: at each node that of the library with the lowest mean log cost over the nearest conditions.

    Averaging over neighbours takes out what is noise in each condition's argmin, and whatever the table does not look
    at. nodes: along some or all of speed, y_ref, friction and wind; distances are measured in ranges of the data.
    """
    axes = {name: np.asarray(values, dtype=float) for name, values in nodes.items()}
    seen = dataset.operating_points[:, [NAMES.index(name) for name in axes]]
    reach = np.ptp(seen, axis=0)
    grid = np.stack(np.meshgrid(*axes.values(), indexing="ij"), axis=-1)
    _, near = cKDTree(seen / reach).query(
        grid.reshape(-1, len(axes)) / reach, k=np.arange(1, min(neighbours, len(seen)) + 1)
    )
    costs = dataset.landscape.astype(np.float64)
    worst = np.nanmax(np.where(np.isfinite(costs), costs, np.nan))
    logs = np.log(np.where(np.isfinite(costs), costs, worst))
    best = dataset.library[np.argmin(logs[near].mean(axis=1), axis=1)]
    return Lookup(axes, best.reshape(*grid.shape[:-1], 4), name="look-up")
