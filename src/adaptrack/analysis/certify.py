"""Is the closed loop stable with every tuning that a scheduler can ask for, and with which stability margins?

At each point of a grid over the operating domain the linear closed loop with the scheduler's tuning is analysed about
driving straight, which decides, and about a turn as hard as driving gets (`stability.hard_turn`), which is reported;
and, on request, driving straight with a car that differs from the one that the controller believes in (`Mismatch`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import lru_cache, partial
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from adaptrack.analysis.linearisation import LinearPlant, Mismatch, Turn, laws, linear_estimator, linear_plants
from adaptrack.analysis.stability import Margins, hard_turn, margins
from adaptrack.base.checked import real
from adaptrack.base.errors import ContractError, InvalidInput
from adaptrack.base.limits import MAX_SPEED, check_limit
from adaptrack.base.progress import ProgressCall, reports_progress
from adaptrack.cars.plant import Plant
from adaptrack.control.controllers import ENTRIES, MPC, Scheduler, Tuning, read_tuning
from adaptrack.control.scheduling import VARIABLES, Constant, Schedule, SchedulingVariables
from adaptrack.scenario.profile import Profile, load_profile

Array = NDArray[np.float64]

OPERATING = {name: (variable.low, variable.high) for name, variable in VARIABLES.items()}
"""The operating domain, by scheduling variable; a scheduler is certified where this and its own domain overlap."""
Driving = Literal["straight", "turn"]
DRIVING_CASES: tuple[Driving, ...] = ("straight", "turn")
"""Ways of driving about which the loop is linearised, in the order of tables and maps."""
_CELL = 64  # combinations, at most, of the inputs beside speed and friction, for each pair of those


@dataclass(frozen=True, eq=False)
class Sweep:
    """The loops with the tunings at all n points of a domain."""

    tunings: Array
    """(n, 4) Np, Nc, Q, R as the MPC uses them"""
    straight: Margins
    """driving straight, which the verdict is about"""
    turn: Margins
    """in a hard turn"""

    @property
    def unstable(self) -> NDArray[np.bool_]:
        """(n,) whether the loop is unstable, driving straight."""
        return np.asarray(self.straight.radius >= 1.0)

    @property
    def unstable_in_turn(self) -> NDArray[np.bool_]:
        """(n,) whether it is unstable in the hard turn: no verdict, but a warning."""
        return np.asarray(self.turn.radius >= 1.0)


@dataclass(frozen=True, eq=False)
class Certificate:
    """Stability and margins of a scheduler's loop at n operating points of speed, friction and further inputs."""

    scheduler: str
    plant: str
    tyre: str
    profile: str
    model: str
    """of the prediction"""
    estimator: str
    speeds: Array
    """Speeds of the grid (m/s), shape (v,)."""
    frictions: Array
    points: Array
    """(n, entries of `SchedulingVariables`)"""
    bare: Sweep
    """of the scheduler without its guard"""
    guarded: Sweep | None
    """of the scheduler with its guard, as at the first step of a run; None when it has none"""
    mismatched: Mapping[str, Margins] = field(default_factory=dict)
    """of what drives, driving straight, when the car differs from what the controller believes, by `Mismatch.name`"""
    period: float = math.nan
    """s, of the controller"""
    belief: str = ""
    """Steering model of the controller and its source; empty where a model or an estimator was passed."""

    @property
    def counted(self) -> Sweep:
        """The sweep of the scheduler that is certified, including its guard if it has one."""
        return self.bare if self.guarded is None else self.guarded

    @property
    def passed(self) -> bool:
        """Whether every loop that can drive is stable, driving straight."""
        return not self.counted.unstable.any()

    @property
    def verdict(self) -> str:
        """The verdict in one sentence, the count of the hard turn included."""
        n, n_unstable = len(self.points), int(self.counted.unstable.sum())
        turn = int(self.counted.unstable_in_turn.sum())
        straight = f"stable at all {n:,}" if self.passed else f"unstable at {n_unstable:,} of {n:,}"
        return (
            f"{'Passed' if self.passed else 'Failed'}: the closed loop is {straight} points of the operating domain "
            f"driving straight, and unstable at {turn:,} of them in a hard turn, which does not decide "
            f"({self.plant}, {self.tyre} tyres, {self.profile} profile; model {self.model}, estimator "
            f"{self.estimator}).{self._mismatches_in_words()}"
        )

    def _mismatches_in_words(self) -> str:
        """Return the mismatches that make the loop unstable as a sentence; empty without mismatches."""
        if not self.mismatched:
            return ""
        unstable_counts = {
            name: int((mismatch_margins.radius >= 1.0).sum()) for name, mismatch_margins in self.mismatched.items()
        }
        counts_text = ", ".join(f"{name}: {count:,}" for name, count in unstable_counts.items() if count)
        return (
            f" Of {len(unstable_counts)} mismatches none makes it unstable."
            if not counts_text
            else f" Unstable with {counts_text}."
        )

    @property
    def fallback(self) -> NDArray[np.bool_]:
        """(n,) whether the guard changes the scheduler's tuning."""
        return np.any(self.counted.tunings != self.bare.tunings, axis=1)

    def cells(self, values: NDArray[Any]) -> NDArray[Any]:
        """One of the arrays (n,) as (speeds, frictions, values of the other inputs)."""
        return values.reshape(len(self.speeds), len(self.frictions), -1)

    def worst_points(
        self, count: int = 5, sweep: Sweep | None = None, driving: Driving = "straight"
    ) -> list[dict[str, Any]]:
        """The points with the smallest modulus margin, the worst first: variables, tuning and margins."""
        sweep = sweep or self.counted
        driving_margins: Margins = getattr(sweep, driving)
        order = np.argsort(driving_margins.modulus_margin, kind="stable")[:count]
        return [self._point(sweep, driving, int(i)) for i in order]

    def rows(self) -> list[dict[str, Any]]:
        """The worst point for each speed and friction, straight and in a turn, with the guard and without; for JSON.

        `unstable`: how many points of that speed and friction are. What is infinite is None.
        """
        sweeps = [(False, self.bare)] if self.guarded is None else [(True, self.guarded), (False, self.bare)]
        return [
            {"guard": guard, "unstable": unstable, **self._point(sweep, driving, i)}
            for guard, sweep in sweeps
            for driving in DRIVING_CASES
            for i, unstable in self._worst_of_cells(getattr(sweep, driving))
        ]

    def _worst_of_cells(self, driving_margins: Margins) -> list[tuple[int, int]]:
        """The point with the smallest modulus margin of each speed and friction, and the number of unstable points."""
        least, unstable = (
            self.cells(driving_margins.modulus_margin),
            self.cells(driving_margins.radius >= 1.0).sum(axis=2),
        )
        first = np.arange(unstable.size) * least.shape[2]
        return list(zip((first + least.argmin(axis=2).ravel()).tolist(), unstable.ravel().tolist(), strict=True))

    def summary(self) -> dict[str, Any]:
        """The verdict, and for each way of driving the worst of each margin and the worst point; ready for JSON."""
        return {
            "scheduler": self.scheduler,
            "plant": self.plant,
            "tyre": self.tyre,
            "profile": self.profile,
            "model": self.model,
            "estimator": self.estimator,
            "belief": self.belief,
            "verdict": self.verdict,
            "passed": self.passed,
            "points": len(self.points),
            "unstable": int(self.counted.unstable.sum()),
            "unstable_without_guard": int(self.bare.unstable.sum()),
            "unstable_in_turn": int(self.counted.unstable_in_turn.sum()),
            "fallback_share": float(self.fallback.mean()),
            **{
                driving: {
                    **_finite(extremes(getattr(self.counted, driving))),
                    "worst": self.worst_points(1, driving=driving)[0],
                }
                for driving in DRIVING_CASES
            },
            "mismatched": self.mismatched_rows(),
        }

    def mismatched_rows(self) -> list[dict[str, Any]]:
        """For each mismatch the point with the smallest modulus margin, and how many are unstable; for JSON."""
        rows = []
        for name, mismatch_margins in self.mismatched.items():
            unstable, i = int((mismatch_margins.radius >= 1.0).sum()), int(np.argmin(mismatch_margins.modulus_margin))
            rows.append(
                {"mismatch": name, "unstable": unstable, **self._point(self.counted, "straight", i, mismatch_margins)}
            )
        return rows

    def _point(self, sweep: Sweep, driving: Driving, i: int, point_margins: Margins | None = None) -> dict[str, Any]:
        point_margins = getattr(sweep, driving) if point_margins is None else point_margins
        return {
            **dict(zip(SchedulingVariables._fields, self.points[i].tolist(), strict=True)),
            **dict(zip(ENTRIES, sweep.tunings[i].tolist(), strict=True)),
            "driving": driving,
            **_finite({field.name: float(getattr(point_margins, field.name)[i]) for field in fields(Margins)}),
        }


def extremes(loop_margins: Margins) -> dict[str, float]:
    """The worst of each margin over all loops."""
    return {
        "radius": float(loop_margins.radius.max()),
        "gain_up": float(loop_margins.gain_up.min()),
        "gain_down": float(loop_margins.gain_down.max()),
        "delay": float(loop_margins.delay.min()),
        "modulus_margin": float(loop_margins.modulus_margin.min()),
    }


def _finite(values: Mapping[str, float]) -> dict[str, float | None]:
    """Numbers for JSON: what is infinite is None."""
    return {name: value if math.isfinite(value) else None for name, value in values.items()}


@reports_progress("certify")
def certify(
    scheduler: Scheduler | Tuning, plant: Plant, mpc: MPC, profile: str | Profile = "road", *,
    domain: Mapping[str, tuple[float, float]] | None = None, levels: tuple[int, int] = (28, 5),
    turn: Turn = hard_turn, mismatches: Sequence[Mismatch] = (),
    progress: ProgressCall | None = None,
) -> Certificate:  # fmt: skip
    """Stability and margins of the closed loop with the scheduler's tunings over its whole operating domain.

    Parameters
    ----------
    scheduler
        A `Schedule`, guarded or not, any function of a `SchedulingVariables`, or one tuning.
    plant, profile
        The true car, and the true steering, dead time and sensors around it.
    mpc
        What the controller believes: prediction model, estimator, period, moves, longest horizons; its own tuning and
        scheduler play no part. One that learns is certified as it begins.
    domain
        Lowest and highest value by scheduling variable; by default where `OPERATING` and the schedule's own domain
        overlap. Beside speed and friction, only what a schedule looks at is varied; of a plain function, everything.
    levels
        Values of speed and of friction. Other inputs get 2 to 5 each, together at most 64 combinations or 2 each.
    turn
        Lateral acceleration (m/s^2) of the turn at a speed (m/s) on a friction.
    mismatches
        How the true car may differ from `plant` and `profile` as well, each by itself; see
        `linearisation.usual_mismatches`.

    Raises
    ------
    ContractError
        When the scheduler fails at a point or gives what is no tuning.
    InvalidInput
        When a range makes no sense, the plant cannot drive such a turn, or has nothing of what a mismatch changes.
    """
    if isinstance(scheduler, Tuning):
        scheduler = Constant(scheduler)
    world = load_profile(profile)
    axes = _axes(scheduler, mpc, domain or {}, levels)
    grid = np.meshgrid(*axes.values(), indexing="ij")
    columns = dict(zip(axes, (values.ravel() for values in grid), strict=True))
    points = np.column_stack([columns.get(name, np.zeros(grid[0].size)) for name in SchedulingVariables._fields])
    guarded = scheduler if isinstance(scheduler, Schedule) and scheduler.guard is not None else None
    bare = replace(guarded, guard=None) if guarded is not None else scheduler
    tunings = [_as_used(_tunings(variant, points), mpc) for variant in (bare, guarded) if variant is not None]
    plants = linear_plants(plant, mpc.period, world, turn, mismatches)
    sweep_margins = _sweep(points, tunings, mpc, plants, progress or (lambda stage, finished, of: None))
    sweeps = [Sweep(used, *used_margins[:2]) for used, used_margins in zip(tunings, sweep_margins, strict=True)]
    return Certificate(
        str(getattr(scheduler, "name", getattr(scheduler, "__name__", type(scheduler).__name__))),
        plant.name, plant.tyre_name, world.name, mpc.model.name, mpc.estimator.name,
        axes["speed"], axes["friction"], points,
        sweeps[0], sweeps[1] if guarded is not None else None,
        dict(zip([mismatch.name for mismatch in mismatches], sweep_margins[-1][2:], strict=True)),
        mpc.period, mpc.belief_at_first,
    )  # fmt: skip


def _axes(
    scheduler: Scheduler, mpc: MPC, domain: Mapping[str, tuple[float, float]], levels: tuple[int, int]
) -> dict[str, Array]:
    """The levels of each scheduling variable that is varied: speed and friction first."""
    unknown = set(domain) - set(SchedulingVariables._fields)
    if unknown:
        raise InvalidInput(f"certify: domain: {unknown.pop()!r} is no entry of SchedulingVariables.")
    scheduler_domain = (
        dict(zip(scheduler.inputs, scheduler.domain.tolist(), strict=True)) if isinstance(scheduler, Schedule) else {}
    )
    read = scheduler_domain if isinstance(scheduler, Schedule) else OPERATING
    other_names = [name for name in SchedulingVariables._fields if name in read and name not in ("speed", "friction")]
    count = max(2, min(5, int(_CELL ** (1.0 / max(len(other_names), 1)) + 1e-9)))
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
    """Return the range of an input: from `domain`, else where driving and schedule overlap, else the schedule's."""
    if name in domain:
        low, high = (real("certify", f"domain: {name}", bound) for bound in domain[name])
        return low, high
    low, high = OPERATING[name]
    if name in scheduler_domain:
        overlap = max(low, scheduler_domain[name][0]), min(high, scheduler_domain[name][1])
        low, high = overlap if overlap[0] <= overlap[1] else scheduler_domain[name]
    return low, high


def _tunings(scheduler: Scheduler, points: Array) -> Array:
    """(n, 4) what the scheduler gives at each point, each as at a first step."""
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
    """With horizons rounded and clamped as the MPC does it."""
    used = tunings.copy()
    used[:, 0] = np.clip(np.floor(tunings[:, 0] + 0.5), 1.0, mpc.longest_horizon)
    used[:, 1] = np.clip(np.floor(tunings[:, 1] + 0.5), 1.0, np.minimum(used[:, 0], mpc.most_moves))
    return used


def _sweep(
    points: Array, tunings: list[Array], mpc: MPC, plants: Sequence[LinearPlant], progress: ProgressCall
) -> list[list[Margins]]:
    """The margins of each set of tunings around each plant; a cell and a tuning that recur are analysed once."""
    n, names = len(points), [field.name for field in fields(Margins)]
    results = np.empty((len(tunings), len(plants), len(names), n))
    places = points[:, [SchedulingVariables._fields.index(name) for name in ("speed", "friction")]]
    cells, where = np.unique(places, axis=0, return_inverse=True)
    at_speed = lru_cache(maxsize=1)(partial(linear_estimator, mpc))  # cells are sorted by speed
    for cell, (speed, friction) in enumerate(cells.tolist()):
        progress("certify", cell, len(cells))
        rows = np.flatnonzero(where.ravel() == cell)
        unique, place = np.unique(
            np.concatenate([point_tunings[rows] for point_tunings in tunings]), axis=0, return_inverse=True
        )
        law = laws(mpc, speed, unique, at_speed(speed))
        for i, plant in enumerate(plants):
            cell_margins = margins(plant(speed, friction), law, mpc.period)
            values = np.array([getattr(cell_margins, name) for name in names])[:, place.ravel()]
            results[:, i, :, rows] = values.reshape(len(names), len(tunings), len(rows)).transpose(2, 1, 0)
    progress("certify", len(cells), len(cells))
    return [[Margins(*values) for values in columns] for columns in results]
