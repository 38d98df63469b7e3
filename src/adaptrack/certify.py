"""Is the closed loop stable with every tuning that a scheduler can ask for, and with how much margin?

Over a grid of the operating domain the scheduler is asked for its tuning, and the linear closed loop with that tuning
is looked at driving straight and in a turn as hard as driving gets (`stability.hard_turn`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from adaptrack.controllers.mpc import MPC, Scheduler
from adaptrack.errors import ContractError, InvalidInput, real
from adaptrack.plant import Plant
from adaptrack.profile import Profile, load_profile
from adaptrack.scheduling import ENTRIES, VARIABLES, Schedule, SchedulingVariables, read_tuning
from adaptrack.stability import Margins, hard_turn, laws, margins, sampled

Array = NDArray[np.float64]
Progress = Callable[[str, int, int], None]

OPERATING = {name: (variable.low, variable.high) for name, variable in VARIABLES.items()}
"""The operating domain, by scheduling variable; a scheduler is looked at where this and its own domain overlap."""
_CELL = 64  # values of the inputs beside speed and friction, at most, for each pair of those


@dataclass(frozen=True, eq=False)
class Sweep:
    """The loops with the tunings at all n points of a domain."""

    tunings: Array
    """(n, 4) Np, Nc, Q, R as the MPC uses them"""
    straight: Margins
    turn: Margins
    """in a hard turn"""

    @property
    def worst(self) -> Margins:
        """The worse of straight and turn at each point."""
        return self.straight.worst(self.turn)

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
    """What `certify` found, at n points: all values of the other inputs for each pair of speed and friction in turn."""

    scheduler: str
    plant: str
    tyre: str
    profile: str
    speeds: Array
    """m/s"""
    frictions: Array
    conditions: Array
    """(n, SchedulingVariables)"""
    bare: Sweep
    """of the scheduler without its guard"""
    guarded: Sweep | None
    """of the scheduler with its guard, as at the first step of a run; None when it has none"""

    @property
    def counted(self) -> Sweep:
        """What drives: with the guard where there is one."""
        return self.bare if self.guarded is None else self.guarded

    @property
    def passed(self) -> bool:
        """Whether every loop that can drive is stable, driving straight."""
        return not self.counted.unstable.any()

    @property
    def fallback(self) -> NDArray[np.bool_]:
        """(n,) whether the guard changes the scheduler's tuning."""
        return np.any(self.counted.tunings != self.bare.tunings, axis=1)

    def cells(self, values: NDArray[Any]) -> NDArray[Any]:
        """One of the arrays (n,) as (speeds, frictions, values of the other inputs)."""
        return values.reshape(len(self.speeds), len(self.frictions), -1)

    def worst_points(self, count: int = 5, sweep: Sweep | None = None) -> list[dict[str, Any]]:
        """The points nearest to instability, the worst first: condition, tuning, margins, and where it is worst."""
        sweep = sweep or self.counted
        order = np.argsort(-sweep.worst.nearness, kind="stable")[:count]
        return [self._point(sweep, int(i)) for i in order]

    def rows(self) -> list[dict[str, Any]]:
        """The worst point for each speed and friction, with the guard and without; ready for JSON (infinite: None)."""
        rows = []
        for guard, sweep in ((False, self.bare), (True, self.guarded)):
            if sweep is None:
                continue
            worst = self.cells(sweep.worst.nearness)
            count = self.cells(sweep.unstable).sum(axis=2)
            width = worst.shape[2]
            for cell, place in enumerate(worst.argmax(axis=2).ravel().tolist()):
                unstable = int(count.ravel()[cell])
                rows.append({"guard": guard, "unstable": unstable, **self._point(sweep, cell * width + place)})
        return rows

    def summary(self) -> dict[str, Any]:
        """The verdict, the worst of each measure over all points, and the worst point; ready for JSON."""
        worst = self.counted.worst
        extremes = {
            "radius": worst.radius.max(),
            "gain_up": worst.gain_up.min(),
            "gain_down": worst.gain_down.max(),
            "delay": worst.delay.min(),
            "nearness": worst.nearness.max(),
        }
        return {
            "scheduler": self.scheduler,
            "plant": self.plant,
            "tyre": self.tyre,
            "profile": self.profile,
            "passed": self.passed,
            "points": len(self.conditions),
            "unstable": int(self.counted.unstable.sum()),
            "unstable_without_guard": int(self.bare.unstable.sum()),
            "unstable_in_turn": int(self.counted.unstable_in_turn.sum()),
            "fallback_share": float(self.fallback.mean()),
            **_finite(extremes),
            "worst": self.worst_points(1)[0],
        }

    def _point(self, sweep: Sweep, i: int) -> dict[str, Any]:
        driving: Literal["straight", "turn"] = "straight"
        if sweep.turn.nearness[i] > sweep.straight.nearness[i]:
            driving = "turn"
        found: Margins = getattr(sweep, driving)
        return {
            **dict(zip(SchedulingVariables._fields, self.conditions[i].tolist(), strict=True)),
            **dict(zip(ENTRIES, sweep.tunings[i].tolist(), strict=True)),
            "driving": driving,
            **_finite({each.name: getattr(found, each.name)[i] for each in fields(Margins)}),
        }


def _finite(values: Mapping[str, Any]) -> dict[str, float | None]:
    """Numbers for JSON: what is infinite is None."""
    return {name: float(value) if math.isfinite(value) else None for name, value in values.items()}


def certify(
    scheduler: Scheduler, plant: Plant, mpc: MPC, profile: str | Profile = "road", *,
    domain: Mapping[str, tuple[float, float]] | None = None, levels: tuple[int, int] = (28, 5),
    turn: Callable[[float, float], float] = hard_turn, progress: Progress | None = None,
) -> Certificate:  # fmt: skip
    """Look at the closed loop with the scheduler's tunings over its whole operating domain.

    Parameters
    ----------
    scheduler
        A `Schedule`, guarded or not, or any function of `SchedulingVariables`.
    mpc
        Vehicle of the prediction model, period, moves, longest horizons; its own tuning and scheduler play no part.
    domain
        Lowest and highest value by scheduling variable; by default where `OPERATING` and the schedule's own domain
        overlap. Beside speed and friction, only what a schedule looks at is varied; of a plain function, everything.
    levels
        Values of speed and of friction. Other inputs get 2 to 5 each, together at most 64 combinations or 2 each.
    turn
        Lateral acceleration (m/s^2) of the turn at a speed (m/s) on a friction.

    Raises
    ------
    ContractError
        When the scheduler fails for a condition or gives what is no tuning.
    InvalidInput
        When a range makes no sense, or the plant cannot drive such a turn.
    """
    world = load_profile(profile)
    axes = _axes(scheduler, mpc, domain or {}, levels)
    grid = np.meshgrid(*axes.values(), indexing="ij")
    columns = dict(zip(axes, (values.ravel() for values in grid), strict=True))
    conditions = np.column_stack([columns.get(name, np.zeros(grid[0].size)) for name in SchedulingVariables._fields])
    guarded = scheduler if isinstance(scheduler, Schedule) and scheduler.guard is not None else None
    bare = replace(guarded, guard=None) if guarded is not None else scheduler
    asked = [_as_used(_tunings(each, conditions), mpc) for each in (bare, guarded) if each is not None]
    found = _sweep(conditions, asked, plant, mpc, world, turn, progress or (lambda what, done, of: None))
    return Certificate(
        str(getattr(scheduler, "name", getattr(scheduler, "__name__", type(scheduler).__name__))),
        plant.name, plant.tyre_name, world.name, axes["speed"], axes["friction"], conditions,
        found[0], found[1] if guarded is not None else None,
    )  # fmt: skip


def _axes(
    scheduler: Scheduler, mpc: MPC, domain: Mapping[str, tuple[float, float]], levels: tuple[int, int]
) -> dict[str, Array]:
    """The levels of each entry of the condition that is varied: speed and friction first."""
    unknown = set(domain) - set(SchedulingVariables._fields)
    if unknown:
        raise InvalidInput(f"certify: domain: {unknown.pop()!r} is no scheduling variable.")
    own = dict(zip(scheduler.inputs, scheduler.domain.tolist(), strict=True)) if isinstance(scheduler, Schedule) else {}
    seen = own if isinstance(scheduler, Schedule) else OPERATING
    others = [name for name in SchedulingVariables._fields if name in seen and name not in ("speed", "friction")]
    count = max(2, min(5, int(_CELL ** (1.0 / max(len(others), 1)) + 1e-9)))
    axes = {}
    for name, number in zip(("speed", "friction", *others), (*levels, *[count] * len(others)), strict=True):
        low, high = OPERATING[name]
        if name in domain:
            low, high = (real("certify", f"domain: {name}", bound) for bound in domain[name])
        elif name in own:
            overlap = max(low, own[name][0]), min(high, own[name][1])
            low, high = overlap if overlap[0] <= overlap[1] else own[name]
        if name == "speed":
            low = max(low, mpc.speed_floor)
        if not -math.inf < low <= high < math.inf or number < 1:
            raise InvalidInput(f"certify: {name}: {number} levels from {low:g} to {high:g}: need finite low <= high.")
        axes[name] = np.linspace(low, high, number if high > low else 1)
    if not axes["friction"][0] > 0.0:
        raise InvalidInput(f"certify: friction = {axes['friction'][0]:g}: must be positive.")
    return axes


def _tunings(scheduler: Scheduler, conditions: Array) -> Array:
    """(n, 4) what the scheduler gives for each condition, each as at a first step."""
    if isinstance(scheduler, Schedule):
        given = scheduler.batch(conditions)
    else:
        rows = []
        for row in conditions.tolist():
            try:
                rows.append(read_tuning(scheduler(SchedulingVariables(*row))))
            except Exception as error:
                raise ContractError(f"scheduler: failed for {SchedulingVariables(*row)}: {error}") from error
        given = np.array(rows)
    bad = ~(np.isfinite(given).all(axis=1) & (given[:, 2] >= 0.0) & (given[:, 3] > 0.0))
    if bad.any():
        i = int(np.argmax(bad))
        raise ContractError(
            f"scheduler: gave {tuple(given[i].tolist())} for {SchedulingVariables(*conditions[i].tolist())}: "
            "must be finite, with Q >= 0 and R > 0."
        )
    return given


def _as_used(tunings: Array, mpc: MPC) -> Array:
    """With horizons rounded and clamped as the MPC does it."""
    used = tunings.copy()
    used[:, 0] = np.clip(np.floor(tunings[:, 0] + 0.5), 1.0, mpc.longest_horizon)
    used[:, 1] = np.clip(np.floor(tunings[:, 1] + 0.5), 1.0, np.minimum(used[:, 0], mpc.most_moves))
    return used


def _sweep(
    conditions: Array, asked: list[Array], plant: Plant, mpc: MPC, profile: Profile,
    turn: Callable[[float, float], float], progress: Progress,
) -> list[Sweep]:  # fmt: skip
    """The margins of each set of tunings; a plant and a tuning that recur are looked at once."""
    n, names = len(conditions), [each.name for each in fields(Margins)]
    results = np.empty((len(asked), 2, len(names), n))
    places = conditions[:, [SchedulingVariables._fields.index("speed"), SchedulingVariables._fields.index("friction")]]
    cells, where = np.unique(places, axis=0, return_inverse=True)
    for cell, (speed, friction) in enumerate(cells.tolist()):
        progress("certify", cell, len(cells))
        here = np.flatnonzero(where.ravel() == cell)
        unique, place = np.unique(np.concatenate([tunings[here] for tunings in asked]), axis=0, return_inverse=True)
        k = laws(mpc, speed, unique)
        for i, acceleration in enumerate((0.0, turn(speed, friction))):
            body = sampled(
                plant, mpc.period, speed, friction=friction, profile=profile, lateral_acceleration=acceleration
            )
            found = margins(body, k, mpc.period)
            values = np.array([getattr(found, name) for name in names])[:, place.ravel()]
            results[:, i, :, here] = values.reshape(len(names), len(asked), len(here)).transpose(2, 1, 0)
    progress("certify", len(cells), len(cells))
    return [
        Sweep(tunings, *(Margins(*result) for result in both)) for tunings, both in zip(asked, results, strict=True)
    ]
