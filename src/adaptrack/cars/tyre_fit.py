"""Tyres that are fitted to lateral forces: the fit, its deviation, and CSV tables of axle force over slip.

Columns of a table, in any order: ``slip_rad`` or ``slip_deg``; ``force_front_N`` and ``force_rear_N`` of the whole
axle, where a positive slip pushes to the positive side, left; and, where several loads were driven, ``load_front_N``
and ``load_rear_N`` of the axle. A force may be left empty where an axle was not measured.
"""

from __future__ import annotations

import csv
import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.base.files import finite_number, printable, read_bytes, table_lines
from adaptrack.cars.vehicle import Tyre
from adaptrack.core.kernel import row_of
from adaptrack.core.maths import portable
from adaptrack.core.maths.portable import Array
from adaptrack.core.models.car import PLANT_PARAMETERS, CarRow
from adaptrack.core.synthesis import plant as kernel

SHAPE_BOUNDS, CURVATURE_BOUNDS, FRICTION_BOUNDS = (1.0, 1.99), (-20.0, 0.99), (0.05, 3.0)
"""Bounds of what is fitted."""


class TyreSamples(NamedTuple):
    """Lateral forces of one tyre; arrays (n,)."""

    slip: Array
    """rad, positive to the left"""
    load: Array
    """Vertical load (N)."""
    force: Array
    """N, positive to the left"""
    rear: NDArray[np.bool_]
    """whether it is a rear tyre"""


@dataclass(frozen=True)
class TyreFit:
    """A tyre of the plant that stands for another, and how well."""

    tyre: Tyre
    friction: float
    """-, peak of what was fitted over its nominal load; the plant's is the road's: drive it on roads with this one"""
    deviation: float
    """-, largest deviation of the force over the peak force at the same load"""
    where: tuple[float, float]
    """rad, N: slip and load of that deviation"""
    slips: tuple[float, float]
    """rad, range of what was fitted"""
    loads: tuple[float, float]
    """N, of a tyre, likewise"""
    notes: tuple[str, ...] = ()
    """Sentences on data that were dropped or assumed."""

    def __str__(self) -> str:
        return (
            f"force off by at most {100.0 * self.deviation:.1f} % of its peak (at {self.where[0]:.3f} rad, "
            f"{self.where[1]:.0f} N), over {self.slips[0]:.3g} to {self.slips[1]:.3g} rad and {self.loads[0]:.0f} to "
            f"{self.loads[1]:.0f} N; peak friction {self.friction:.3g} at the nominal load, which is the road's"
        )


def lateral_force(tyre: Tyre, slip: ArrayLike, load: ArrayLike, friction: float, rear: ArrayLike = False) -> Array:
    """Lateral force (N) of one tyre of the plant: slip (rad), vertical load (N), rear or front tyre."""
    wheels = np.stack(np.broadcast_arrays(slip, load, rear), axis=-1).astype(np.float64)
    parameters, forces = np.zeros(len(PLANT_PARAMETERS)), np.empty(wheels.shape[:-1])
    kernel.plant_parameters(row_of(CarRow), tyre.numbers, row_of(kernel.Actuator), parameters)
    kernel.tyre_forces(parameters, friction, wheels.reshape(-1, 3), forces.reshape(-1))
    return forces


FREE = ("load sensitivity", "load ratio", "stiffness", "offsets")
"""What may be fitted beside shape, curvature and friction: how the friction falls with load; the load ratio of a
digressive stiffness; the stiffness of both axles, within a factor of four; slips at which an axle has no force."""


class _Fitted(NamedTuple):
    """The numbers of a fit in their order, each with its bounds, its scale and what frees it."""

    low: float
    high: float
    scale: float
    freed_by: str


_NUMBERS = (
    _Fitted(*SHAPE_BOUNDS, 0.3, ""), _Fitted(*CURVATURE_BOUNDS, 1.0, ""), _Fitted(*FRICTION_BOUNDS, 0.3, ""),
    _Fitted(0.0, 1.0, 0.1, FREE[0]), _Fitted(0.3, 50.0, 1.0, FREE[1]),
    _Fitted(0.25, 4.0, 0.1, FREE[2]), _Fitted(0.25, 4.0, 0.1, FREE[2]),
    _Fitted(-0.1, 0.1, 0.005, FREE[3]), _Fitted(-0.1, 0.1, 0.005, FREE[3]),
)  # fmt: skip


def fit_law(
    tyre: Tyre, samples: TyreSamples, friction: float, free: Collection[str] = ()
) -> tuple[Tyre, float, tuple[float, float]]:
    """The tyre, its friction and the offsets of the slip (rad) that are nearest to samples.

    Least squares of force over load, from `tyre` and `friction` on; free: of `FREE`, what is fitted beside shape,
    curvature and friction. Raises InvalidInput when nothing fits.
    """
    from scipy.optimize import least_squares

    low, high, scale = (np.array(column) for column in list(zip(*_NUMBERS, strict=True))[:3])
    moves = np.array([not number.freed_by or number.freed_by in free for number in _NUMBERS])
    start = np.array([1.35, 0.0, friction, tyre.friction_load_sensitivity, tyre.digressive_load_ratio or 2.0,
                      1.0, 1.0, 0.0, 0.0])  # fmt: skip
    if "load sensitivity" in free:
        start[3] = 0.1

    def residual(x: Array, law_parameters: Array) -> Array:
        law_parameters[moves] = x
        candidate, mu = _changed(tyre, law_parameters)
        slip = samples.slip - np.where(samples.rear, law_parameters[8], law_parameters[7])
        return (lateral_force(candidate, slip, samples.load, mu, samples.rear) - samples.force) / samples.load

    best = None
    for shape, curvature in ((1.35, -2.0), (1.35, 0.0), (1.6, 0.5), (1.2, -0.5)):
        parameters = start.copy()
        parameters[:2] = shape, curvature
        parameters = np.clip(parameters, low + 1e-6, high - 1e-6)
        bounds, fixed = (low[moves], high[moves]), (parameters.copy(),)
        solution = least_squares(residual, parameters[moves], bounds=bounds, x_scale=scale[moves], args=fixed)
        if np.isfinite(solution.cost) and (best is None or solution.cost < best[0]):
            parameters[moves] = solution.x
            best = solution.cost, parameters
    if best is None:
        raise InvalidInput("the tyre law fits no such forces: they hold values beyond any tyre's.")
    fitted, mu = _changed(tyre, best[1])
    return tyre.replace(**{name: _short(getattr(fitted, name)) for name in _changes(tyre)}), _short(mu), (
        float(best[1][7]), float(best[1][8]),
    )  # fmt: skip


def _changes(tyre: Tyre) -> list[str]:
    """The keys that a fit changes."""
    changed_names = ["shape", "curvature", "friction_load_sensitivity", "stiffness_front", "stiffness_rear"]
    return changed_names if tyre.digressive_load_ratio is None else [*changed_names, "digressive_load_ratio"]


def _changed(tyre: Tyre, x: Array) -> tuple[Tyre, float]:
    """A tyre with the numbers of a fit, and its friction; bounded, hence not validated at every step."""
    values = {
        "shape": float(x[0]), "curvature": float(x[1]), "friction_load_sensitivity": float(x[3]),
        "digressive_load_ratio": float(x[4]), "stiffness_front": tyre.stiffness_front * float(x[5]),
        "stiffness_rear": tyre.stiffness_rear * float(x[6]),
    }  # fmt: skip
    return tyre.model_copy(update={name: values[name] for name in _changes(tyre)}), float(x[2])


def assess_fit(tyre: Tyre, samples: TyreSamples, friction: float, notes: tuple[str, ...] = ()) -> TyreFit:
    """How far a tyre is from samples."""
    off = np.abs(lateral_force(tyre, samples.slip, samples.load, friction, samples.rear) - samples.force)
    q = samples.load / tyre.nominal_load
    peak = friction * samples.load * np.maximum(1.0 - tyre.friction_load_sensitivity * (q - 1.0), 0.1)
    share = off / peak
    worst = int(share.argmax())
    return TyreFit(
        tyre, friction, float(share[worst]), (float(samples.slip[worst]), float(samples.load[worst])),
        (float(samples.slip.min()), float(samples.slip.max())), (float(samples.load.min()), float(samples.load.max())),
        notes,
    )  # fmt: skip


def _short(value: float) -> float:
    return float(f"{value:.5g}")


# -- tables of axle forces --------------------------------------------------------------------------------------------
FORCES, LOADS, SLIPS = ("force_front_N", "force_rear_N"), ("load_front_N", "load_rear_N"), ("slip_rad", "slip_deg")
MIN_TABLE_ROWS = 5
SMALL = 0.5
"""Share of the largest force over load up to which the stiffness is first taken from the slope."""
LEAST_OFFSET = 5e-4
"""rad, a smaller one is not worth a word."""
SATURATION_RATIO = 0.8
"""Largest force over stiffness times slip from which on a table says nothing of where its tyre saturates."""
ASSUMED_FRICTION = 1.0
LOAD_LEVEL_RATIO = 1.1
"""Ratio of loads from which on they count as several."""


@checked
def tyre_from_table(
    path: str | os.PathLike[str], loads: tuple[float, float] | None = None, name: str | None = None
) -> TyreFit:
    """The tyre that is nearest to a table of axle forces, and how near.

    loads: N, static load of a front and a rear wheel, needed where the table has no loads; name: of the tyre, by
    default that of the file. With one load for each axle the stiffness does not depend on the load (the table of an
    axle holds its load transfer); with several the digressive law is fitted. A table that does not reach saturation
    leaves shape and friction as they are assumed for passenger-car tyres, and `TyreFit.notes` says so.

    Raises
    ------
    StorageError
        When the file cannot be read.
    ConfigError
        When it is no such table; the message names column or line.
    InvalidInput
        When there are no loads.
    """
    where = os.fspath(path)
    columns = _columns(where)
    axles = [_axle(where, columns, i, loads) for i in (0, 1)]
    samples = TyreSamples(*map(np.concatenate, zip(*axles, strict=True)))
    several = any(axle.load.max() > LOAD_LEVEL_RATIO * axle.load.min() for axle in axles)
    start, notes = _begin(axles, name or Path(path).stem, several), []
    if not several:
        notes.append("One load for each axle: the stiffness does not depend on the load.")
    peak, free = float((np.abs(samples.force) / samples.load).max()), ["stiffness", "offsets"]
    free += ["load ratio"] if several else []
    free += ["load sensitivity"] if samples.load.max() > LOAD_LEVEL_RATIO * samples.load.min() else []
    tyre, friction, offsets = fit_law(start, samples, peak, free)
    for axle_name, offset in zip(("front", "rear"), offsets, strict=True):
        if abs(offset) > LEAST_OFFSET:
            notes.append(f"The {axle_name} axle has no force at a slip of {offset:.4f} rad: that offset is taken out.")
    samples = samples._replace(slip=samples.slip - np.where(samples.rear, offsets[1], offsets[0]))
    if not _saturates(tyre, samples):
        notes.append("The forces hardly saturate: shape and friction, 1.35 and 1, are assumed.")
        tyre, friction = tyre.replace(shape=1.35, curvature=0.0, friction_load_sensitivity=0.0), ASSUMED_FRICTION
    notes.append("No relaxation length in a table of steady forces: they build up at once.")
    return assess_fit(tyre, samples, friction, tuple(notes))


def _columns(where: str) -> dict[str, Array]:
    """The columns by name, an empty cell NaN."""
    source = printable(where)
    lines, _ = table_lines(source, read_bytes(where), "strict")
    rows = [(number, row) for number, line in lines for row in csv.reader([line]) if any(map(str.strip, row))]
    if not rows:
        raise ConfigError(f"{source}: is empty.")
    names = [cell.strip() for cell in rows[0][1]]
    known_names = (*SLIPS, *FORCES, *LOADS)
    for name in names:
        if name not in known_names:
            raise ConfigError(f"{source}: column {printable(name)!r}: unknown. {did_you_mean(name, known_names)}")
    if len(set(names)) < len(names):
        raise ConfigError(f"{source}: a column stands there twice.")
    if sum(slip in names for slip in SLIPS) != 1 or not set(FORCES) <= set(names):
        raise ConfigError(f"{source}: needs slip_rad or slip_deg, and {' and '.join(FORCES)}.")
    if (LOADS[0] in names) != (LOADS[1] in names):
        raise ConfigError(f"{source}: needs {' and '.join(LOADS)}, or neither.")
    values = np.full((len(rows) - 1, len(names)), np.nan)
    for i, (number, row) in enumerate(rows[1:]):
        if len(row) != len(names):
            raise ConfigError(f"{source}, line {number}: {len(row)} cells, the head has {len(names)}.")
        for j, cell in enumerate(row):
            if cell.strip() or names[j] not in FORCES:
                values[i, j] = _number(source, number, names[j], cell)
    columns = dict(zip(names, values.T, strict=True))
    slip = np.radians(columns.pop("slip_deg")) if "slip_deg" in columns else columns.pop("slip_rad")
    if slip.size and np.abs(slip).max() > 1.0:
        raise ConfigError(
            f"{source}: slip of up to {np.abs(slip).max():.3g} rad: no tyre is measured there; in degrees it is column "
            "slip_deg."
        )
    return columns | {"slip": slip}


def _number(source: str, line: int, column: str, cell: str) -> float:
    value = finite_number(cell)
    if value is None:
        raise ConfigError(f"{source}, line {line}: {column} = {printable(cell)[:40]!r}: must be a finite number.")
    return value


def _axle(where: str, columns: dict[str, Array], i: int, loads: tuple[float, float] | None) -> TyreSamples:
    """Return the measured data of the front axle (i = 0) or the rear axle (1), for one of its tyres."""
    source, force = printable(where), columns[FORCES[i]]
    there = np.isfinite(force)
    slip, force = columns["slip"][there], 0.5 * force[there]
    if LOADS[i] in columns:
        load = 0.5 * columns[LOADS[i]][there]
    elif loads is None:
        raise InvalidInput(
            f"{source}: has no loads: add {LOADS[0]} and {LOADS[1]}, or give the static wheel loads (of a car file)."
        )
    else:
        load = np.full(slip.size, float(loads[i]))
    if slip.size < MIN_TABLE_ROWS or np.ptp(slip) < 0.01:
        raise ConfigError(
            f"{source}: {FORCES[i]}: {slip.size} rows over {np.ptp(slip) if slip.size else 0.0:.3g} rad; needs at "
            f"least {MIN_TABLE_ROWS} over 0.01 rad."
        )
    if not (load > 0.0).all():
        raise ConfigError(f"{source}: {LOADS[i]}: every load must be positive.")
    if np.sum((slip - slip.mean()) * (force - force.mean())) <= 0.0:
        raise ConfigError(
            f"{source}: {FORCES[i]} falls with slip: here a wheel that is turned left of its velocity has a positive "
            "slip and is pushed to the left, positive (ISO 8855 axes); change the sign of one of the columns."
        )
    if np.abs(force / load).max() > 3.0:
        raise ConfigError(
            f"{source}: {FORCES[i]} is up to {np.abs(force / load).max():.3g} times the load: wrong unit?"
        )
    return TyreSamples(slip, load, force, np.full(slip.size, i == 1))


def _saturates(tyre: Tyre, samples: TyreSamples) -> bool:
    """Whether the forces at large slips tell where the tyre ends."""
    slip, endless = np.abs(samples.slip), tyre.model_copy(update={"kind": "linear"})
    linear = lateral_force(endless, slip, samples.load, 1.0, samples.rear)
    return bool((np.abs(samples.force) < SATURATION_RATIO * linear)[slip > 0.5 * slip.max()].any())


def _begin(axles: list[TyreSamples], name: str, several: bool) -> Tyre:
    """A tyre with the slopes of the axles at small forces, where the fit begins."""
    slopes = []
    for axle in axles:
        near = np.abs(axle.force / axle.load) <= SMALL * np.abs(axle.force / axle.load).max()
        x, y = (axle.slip[near], axle.force[near]) if near.sum() >= 3 else (axle.slip, axle.force)
        slopes.append(max(float(portable.least_squares(np.stack([x, np.ones_like(x)], axis=1), y)[0]), 1e-3))
    return Tyre(
        name=name, description="fitted to a table of axle forces", kind="magic-formula", stiffness_front=slopes[0],
        stiffness_rear=slopes[1], nominal_load=float(f"{np.mean([np.median(axle.load) for axle in axles]):.5g}"),
        stiffness_load="digressive" if several else "constant", digressive_load_ratio=2.0 if several else None,
    )  # fmt: skip
