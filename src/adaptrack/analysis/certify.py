"""Certificates: stability and margins of the linear closed loop with all tunings of a scheduler.

The operating domain is a set of ranges of speed, friction and further scheduling variables. At each point of a grid in
this domain, the closed loop with the scheduler's tuning is linearised

- about straight driving, which determines the verdict;
- about a hard turn (`stability.hard_turn`), which is reported only;
- optionally about straight driving with a car that differs from the controller's model (`Mismatch`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial, reduce
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.linearisation import (
    LinearPlant,
    Mismatch,
    SampleAges,
    Turn,
    laws,
    linear_estimator,
    linear_plants,
)
from adaptrack.analysis.stability import Margins, hard_turn, margins
from adaptrack.base.checked import real
from adaptrack.base.errors import ContractError, InvalidInput
from adaptrack.base.limits import MAX_SPEED, check_limit
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.base.result import strict
from adaptrack.cars.plant import Plant
from adaptrack.control.controllers import ENTRIES, MPC, Scheduler, Tuning, read_tuning
from adaptrack.control.scheduling import VARIABLES, Constant, Schedule, SchedulingVariables
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.scenario.profile import Profile, load_profile

OPERATING = {name: (variable.low, variable.high) for name, variable in VARIABLES.items()}
"""Range of each scheduling variable. A scheduler is certified where these ranges and its own domain overlap."""
Driving = Literal["straight", "turn"]
DRIVING_CASES: tuple[Driving, ...] = ("straight", "turn")
"""Steady motions about which the loop is linearised, in the order of tables and maps."""
SUMMARISED = (
    "scheduler", "plant", "tyre", "profile", "model", "estimator", "belief", "sample_ages", "verdict", "passed",
)  # fmt: skip
"""Entries of `Certificate.summary` that are attributes of the certificate."""
_MAX_COMBINATIONS = 64  # of the inputs other than speed and friction, at each speed and friction


@dataclass(frozen=True, eq=False)
class Sweep:
    """Tunings and margins of the loops at all n points of a domain."""

    tunings: Array
    """Np, Nc, Q and R as the MPC uses them, (n, 4)."""
    straight: Margins
    """Margins in straight driving, which determine the verdict."""
    turn: Margins
    """Margins in the hard turn."""

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """Whether the loop is unstable in straight driving, (n,)."""
        return np.asarray(self.straight.radius >= 1.0)

    @property
    def unstable_in_turn(self) -> NDArray[np.bool_]:
        """Whether the loop is unstable in the hard turn, (n,); this does not change the verdict."""
        return np.asarray(self.turn.radius >= 1.0)


@dataclass(frozen=True, eq=False)
class Certificate:
    """Stability and margins of a scheduler's loop at n points of the operating domain.

    The guard of a scheduler is a safety layer that replaces tunings with small stability margins.
    """

    scheduler: str
    plant: str
    tyre: str
    profile: str
    model: str
    """Name of the prediction model."""
    estimator: str
    speeds: Array
    """Speeds of the grid (m/s), shape (v,)."""
    frictions: Array
    """Friction coefficients of the grid."""
    points: Array
    """Operating points, (n, entries of `SchedulingVariables`)."""
    bare: Sweep
    """Sweep of the scheduler without its guard."""
    guarded: Sweep | None
    """Sweep of the scheduler with its guard, in the state at the start of a run; None without a guard."""
    mismatched: Mapping[str, Margins] = field(default_factory=dict)
    """Margins of `counted` in straight driving if the car differs from the controller's model, by `Mismatch.name`."""
    period: float = math.nan
    """Control period (s)."""
    belief: str = ""
    """Steering parameters that the controller assumes, and their source; empty with a user's model or estimator."""
    sample_ages: str = ""
    """Ages of the samples that were analysed, in words; empty for prompt samples."""

    @property
    def counted(self) -> Sweep:
        """The sweep of the scheduler that is certified, including its guard if it has one."""
        return self.bare if self.guarded is None else self.guarded

    @property
    def passed(self) -> bool:
        """Whether all loops of `counted` are stable in straight driving."""
        return not self.counted.unstable.any()

    @property
    def verdict(self) -> str:
        """The verdict in words, with the number of points that are unstable in the hard turn."""
        n, n_unstable = len(self.points), int(self.counted.unstable.sum())
        turn = int(self.counted.unstable_in_turn.sum())
        straight = f"stable at all {n:,}" if self.passed else f"unstable at {n_unstable:,} of {n:,}"
        return (
            f"{'Passed' if self.passed else 'Failed'}: the closed loop is {straight} points of the operating domain "
            f"driving straight, and unstable at {turn:,} of them in a hard turn, which does not change the verdict "
            f"({self.plant}, {self.tyre} tyres, {self.profile} profile; model {self.model}, estimator "
            f"{self.estimator}).{self._mismatches_in_words()}{' ' * bool(self.sample_ages)}{self.sample_ages}"
        )

    def _mismatches_in_words(self) -> str:
        """Return the mismatches that make the loop unstable as a sentence; empty without mismatches."""
        if not self.mismatched:
            return ""
        counts = {name: int((mismatch.radius >= 1.0).sum()) for name, mismatch in self.mismatched.items()}
        unstable = ", ".join(f"{name}: {count:,}" for name, count in counts.items() if count)
        return f" Unstable with {unstable}." if unstable else f" Of {len(counts)} mismatches none makes it unstable."

    @property
    def fallback(self) -> NDArray[np.bool_]:
        """Whether the guard changes the scheduler's tuning, (n,)."""
        return np.any(self.counted.tunings != self.bare.tunings, axis=1)

    def cells(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return values at all points (n,) in the shape (speeds, frictions, combinations of the other inputs)."""
        return values.reshape(len(self.speeds), len(self.frictions), -1)

    def worst_points(
        self, count: int = 5, sweep: Sweep | None = None, driving: Driving = "straight"
    ) -> list[dict[str, Any]]:
        """Return the `count` points with the smallest modulus margin, worst first: variables, tuning and margins.

        sweep: one of this certificate, None for `counted`; driving: straight driving or the hard turn.
        """
        sweep = sweep or self.counted
        driving_margins: Margins = getattr(sweep, driving)
        order = np.argsort(driving_margins.modulus_margin, kind="stable")[:count]
        return [self._point(sweep, driving, int(i)) for i in order]

    def rows(self) -> list[dict[str, Any]]:
        """Return the worst point at each speed and friction, for JSON.

        There is one row for straight driving and one for the turn, each with and without guard. `unstable` is the
        number of unstable points at this speed and friction. Infinite values are None.
        """
        sweeps = [(False, self.bare)] if self.guarded is None else [(True, self.guarded), (False, self.bare)]
        rows = []
        for guard, sweep in sweeps:
            for driving in DRIVING_CASES:
                driving_margins: Margins = getattr(sweep, driving)
                least = self.cells(driving_margins.modulus_margin)
                unstable = self.cells(driving_margins.radius >= 1.0).sum(axis=2)
                worst = np.arange(unstable.size) * least.shape[2] + least.argmin(axis=2).ravel()
                rows += [
                    {"guard": guard, "unstable": count, **self._point(sweep, driving, i)}
                    for i, count in zip(worst.tolist(), unstable.ravel().tolist(), strict=True)
                ]
        return rows

    def summary(self) -> dict[str, Any]:
        """Return the verdict, and the worst margins and points in straight driving and in the turn, for JSON."""
        return {
            **{name: getattr(self, name) for name in SUMMARISED},
            "points": len(self.points),
            "unstable": int(self.counted.unstable.sum()),
            "unstable_without_guard": int(self.bare.unstable.sum()),
            "unstable_in_turn": int(self.counted.unstable_in_turn.sum()),
            "fallback_share": float(self.fallback.mean()),
            **{
                driving: {
                    **strict(getattr(self.counted, driving).extremes),
                    "worst": self.worst_points(1, driving=driving)[0],
                }
                for driving in DRIVING_CASES
            },
            "mismatched": self.mismatched_rows(),
        }

    def mismatched_rows(self) -> list[dict[str, Any]]:
        """Return the worst point and the number of unstable points with each mismatch, for JSON."""
        return [
            {
                "mismatch": name,
                "unstable": int((margins.radius >= 1.0).sum()),
                **self._point(self.counted, "straight", int(np.argmin(margins.modulus_margin)), margins),
            }
            for name, margins in self.mismatched.items()
        ]

    def _point(self, sweep: Sweep, driving: Driving, i: int, point_margins: Margins | None = None) -> dict[str, Any]:
        point_margins = getattr(sweep, driving) if point_margins is None else point_margins
        return {
            **dict(zip(SchedulingVariables._fields, self.points[i].tolist(), strict=True)),
            **dict(zip(ENTRIES, sweep.tunings[i].tolist(), strict=True)),
            "driving": driving,
            **strict({field.name: float(getattr(point_margins, field.name)[i]) for field in fields(Margins)}),
        }


@reports_progress("certify")
def certify(
    scheduler: Scheduler | Tuning, plant: Plant, mpc: MPC, profile: str | Profile = "road", *,
    domain: Mapping[str, tuple[float, float]] | None = None, levels: tuple[int, int] = (28, 5),
    turn: Turn = hard_turn, mismatches: Sequence[Mismatch] = (),
    progress: ProgressCall | None = None,
) -> Certificate:  # fmt: skip
    """Compute stability and margins of the closed loop with a scheduler's tunings over the operating domain.

    Parameters
    ----------
    scheduler
        A `Schedule` with or without guard, a function of `SchedulingVariables`, or a tuning.
    plant, profile
        The true car, its true steering, dead time and sensors. Ages of samples that change are analysed as
        constants, the mean and the largest age.
    mpc
        Controller with its prediction model, estimator, period, moves and longest horizons. Its own tuning and
        scheduler are ignored. A controller that learns is analysed in its initial state.
    domain
        Lowest and highest value of scheduling variables, by name. By default each has the overlap of `OPERATING` and
        the schedule's own domain. Speed and friction are varied, and further inputs only if the schedule uses them; for
        a function all inputs are varied.
    levels
        Numbers of speeds and frictions. Every other input gets 2 to 5 values, with at most 64 combinations unless 2
        values each already give more.
    turn
        Function that returns the lateral acceleration (m/s^2) of the hard turn for a speed (m/s) and a friction.
    mismatches
        Differences between the true car and `plant` and `profile`, analysed one at a time, such as
        `linearisation.usual_mismatches`.
    progress
        Function called with (stage, steps done, steps in all).

    Raises
    ------
    ContractError
        When the scheduler fails at a point or returns an invalid tuning.
    InvalidInput
        For an invalid range, a turn that the plant cannot drive, or a mismatch that the plant does not support.
    """
    if isinstance(scheduler, Tuning):
        scheduler = Constant(scheduler)
    profile = load_profile(profile)
    axes = _axes(scheduler, mpc, domain or {}, levels)
    grid = np.meshgrid(*axes.values(), indexing="ij")
    columns = dict(zip(axes, (values.ravel() for values in grid), strict=True))
    points = np.column_stack([columns.get(name, np.zeros(grid[0].size)) for name in SchedulingVariables._fields])
    guarded = scheduler if isinstance(scheduler, Schedule) and scheduler.guard is not None else None
    bare = replace(guarded, guard=None) if guarded is not None else scheduler
    tunings = [_as_used(_tunings(variant, points), mpc) for variant in (bare, guarded) if variant is not None]
    plants = {
        SampleAges.of(world): linear_plants(plant, mpc.period, world, turn, mismatches)
        for world in profile.with_constant_ages
    }
    sweep_margins = _sweep(points, tunings, mpc, plants, progress or (lambda stage, steps_done, steps: None))
    sweeps = [Sweep(used, *used_margins[:2]) for used, used_margins in zip(tunings, sweep_margins, strict=True)]
    return Certificate(
        str(getattr(scheduler, "name", getattr(scheduler, "__name__", type(scheduler).__name__))),
        plant.name, plant.tyre_name, profile.name, mpc.model.name, mpc.estimator.name,
        axes["speed"], axes["friction"], points,
        sweeps[0], sweeps[1] if guarded is not None else None,
        dict(zip([mismatch.name for mismatch in mismatches], sweep_margins[-1][2:], strict=True)),
        mpc.period, mpc.belief_at_first, _ages_in_words(profile),
    )  # fmt: skip


def _ages_in_words(profile: Profile) -> str:
    """Return the ages of the samples in a profile as a sentence, and what is analysed of changing ages."""
    groups = (("pose", profile.pose_age, profile.pose_age_spread),
              ("motion", profile.motion_age, profile.motion_age_spread))  # fmt: skip
    ages = " and ".join(f"the {name} is {age:.3g} s old" for name, age, _ in groups if age > 0.0)
    spreads = " and ".join(f"{spread:.3g} s ({name})" for name, _, spread in groups if spread > 0.0)
    changing = f"; ages that change by up to {spreads} were analysed as constants, the mean and the largest age"
    return f"On arrival {ages}{changing if spreads else ''}." if ages else ""


def _axes(
    scheduler: Scheduler, mpc: MPC, domain: Mapping[str, tuple[float, float]], levels: tuple[int, int]
) -> dict[str, Array]:
    """Return the values of each scheduling variable that is varied, speed and friction first."""
    unknown = set(domain) - set(SchedulingVariables._fields)
    if unknown:
        raise InvalidInput(f"certify: domain: {unknown.pop()!r} is no entry of SchedulingVariables.")
    scheduler_domain = (
        dict(zip(scheduler.inputs, scheduler.domain.tolist(), strict=True)) if isinstance(scheduler, Schedule) else {}
    )
    read = scheduler_domain if isinstance(scheduler, Schedule) else OPERATING
    other_names = [name for name in SchedulingVariables._fields if name in read and name not in ("speed", "friction")]
    count = max(2, min(5, int(portable.power(_MAX_COMBINATIONS, 1.0 / max(len(other_names), 1)) + 1e-9)))
    axes = {}
    for name, number in zip(("speed", "friction", *other_names), (*levels, *[count] * len(other_names)), strict=True):
        low, high = _range(name, domain, scheduler_domain)
        if name == "speed":
            low = max(low, mpc.speed_floor)
        if not -math.inf < low <= high < math.inf or number < 1:
            raise InvalidInput(f"certify: {name}: {number} levels from {low:g} to {high:g}: need finite low <= high.")
        axes[name] = np.linspace(low, high, number if high > low else 1)
    check_limit("certify: speed", axes["speed"][-1], MAX_SPEED)
    if not axes["friction"][0] > 0.0:
        raise InvalidInput(f"certify: friction = {axes['friction'][0]:g}: must be positive.")
    return axes


def _range(
    name: str, domain: Mapping[str, tuple[float, float]], scheduler_domain: Mapping[str, list[float]]
) -> tuple[float, float]:
    """Return the range of an input from `domain`, otherwise the overlap of `OPERATING` and the scheduler's domain.

    Without an overlap the range is that of the scheduler.
    """
    if name in domain:
        low, high = (real("certify", f"domain: {name}", bound) for bound in domain[name])
        return low, high
    low, high = OPERATING[name]
    if name in scheduler_domain:
        overlap = max(low, scheduler_domain[name][0]), min(high, scheduler_domain[name][1])
        low, high = overlap if overlap[0] <= overlap[1] else scheduler_domain[name]
    return low, high


def _tunings(scheduler: Scheduler, points: Array) -> Array:
    """Return the tuning (n, 4) of the scheduler at each point, in its state at the start of a run."""
    if isinstance(scheduler, Schedule):
        raw_tunings = scheduler.batch(points)
    else:
        rows = []
        for row in points.tolist():
            try:
                rows.append(read_tuning(scheduler(SchedulingVariables(*row))))
            except Exception as error:
                raise ContractError(f"scheduler: failed for {SchedulingVariables(*row)}: {error}") from error
        raw_tunings = np.array(rows)
    invalid = ~(np.isfinite(raw_tunings).all(axis=1) & (raw_tunings[:, 2] >= 0.0) & (raw_tunings[:, 3] > 0.0))
    if invalid.any():
        i = int(np.argmax(invalid))
        raise ContractError(
            f"scheduler: gave {tuple(raw_tunings[i].tolist())} for {SchedulingVariables(*points[i].tolist())}: "
            "must be finite, with Q >= 0 and R > 0."
        )
    return raw_tunings


def _as_used(tunings: Array, mpc: MPC) -> Array:
    """Return tunings with horizons rounded and limited as in the MPC."""
    used = tunings.copy()
    used[:, 0] = np.clip(np.floor(tunings[:, 0] + 0.5), 1.0, mpc.longest_horizon)
    used[:, 1] = np.clip(np.floor(tunings[:, 1] + 0.5), 1.0, np.minimum(used[:, 0], mpc.most_moves))
    return used


def _sweep(
    points: Array, tunings: list[Array], mpc: MPC, plants: Mapping[SampleAges, Sequence[LinearPlant]],
    progress: ProgressCall,
) -> list[list[Margins]]:  # fmt: skip
    """Return the margins of each set of tunings with each plant, the worst over the ages of the samples.

    Repeated speeds, frictions and tunings are reused.
    """
    n, names = len(points), [field.name for field in fields(Margins)]
    results = np.empty((len(tunings), len(next(iter(plants.values()))), len(names), n))
    coordinates = points[:, [SchedulingVariables._fields.index(name) for name in ("speed", "friction")]]
    cells, cell_index = np.unique(coordinates, axis=0, return_inverse=True)
    at_speed = lru_cache(maxsize=len(plants))(partial(linear_estimator, mpc))  # cells are sorted by speed
    for cell, (speed, friction) in enumerate(cells.tolist()):
        progress("certify", cell, len(cells))
        rows = np.flatnonzero(cell_index.ravel() == cell)
        unique, unique_index = np.unique(
            np.concatenate([point_tunings[rows] for point_tunings in tunings]), axis=0, return_inverse=True
        )
        aged_laws = [laws(mpc, speed, unique, at_speed(speed, ages)) for ages in plants]
        for i, aged_plants in enumerate(zip(*plants.values(), strict=True)):
            aged_margins = [
                margins(plant(speed, friction), law, mpc.period)
                for plant, law in zip(aged_plants, aged_laws, strict=True)
            ]
            cell_margins = reduce(Margins.worst, aged_margins)
            values = np.array([getattr(cell_margins, name) for name in names])[:, unique_index.ravel()]
            results[:, i, :, rows] = values.reshape(len(names), len(tunings), len(rows)).transpose(2, 1, 0)
    progress("certify", len(cells), len(cells))
    return [[Margins(*values) for values in columns] for columns in results]
