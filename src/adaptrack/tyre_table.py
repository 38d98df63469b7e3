"""Tables of axle force over slip: a CSV file becomes a tyre.

Columns, in any order: ``slip_rad`` or ``slip_deg``; ``force_front_N`` and ``force_rear_N`` of the whole axle, where a
positive slip pushes to the positive side, left; and, where several loads were driven, ``load_front_N`` and
``load_rear_N`` of the axle. A force may be left empty where an axle was not measured.
"""

from __future__ import annotations

import csv
import io
import math
import os
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.errors import ConfigError, InvalidInput, did_you_mean
from adaptrack.files import printable, read_bytes
from adaptrack.tyre_fit import Samples, TyreFit, fit_saturation, judged
from adaptrack.vehicle import Tyre

Array = NDArray[np.float64]

FORCES, LOADS, SLIPS = ("force_front_N", "force_rear_N"), ("load_front_N", "load_rear_N"), ("slip_rad", "slip_deg")
LEAST_ROWS = 5
SMALL = 0.35
"""Share of the largest force up to which the stiffness is taken from the slope."""
SATURATED = 0.8
"""Largest force over stiffness times slip from which on a table says nothing of where its tyre saturates."""
ASSUMED_FRICTION = 1.0
APART = 1.1
"""Ratio of loads from which on they count as several."""


class _Axle(NamedTuple):
    slip: Array
    force: Array
    """N, of one tyre"""
    load: Array
    """N, of one tyre"""


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
    several = any(axle.load.max() > APART * axle.load.min() for axle in axles)
    nominal = float(np.mean([np.median(axle.load) for axle in axles]))
    notes, start, offsets = _stiffness(axles, nominal, name or Path(path).stem, several)
    samples = Samples(
        np.concatenate([axle.slip - offset for axle, offset in zip(axles, offsets, strict=True)]),
        np.concatenate([axle.load for axle in axles]),
        np.concatenate([axle.force for axle in axles]),
        np.concatenate([np.full(axle.slip.size, i == 1) for i, axle in enumerate(axles)]),
    )
    linear = np.where(samples.rear, start.stiffness_rear, start.stiffness_front) * np.abs(samples.slip)
    if not (np.abs(samples.force) < SATURATED * linear).any():
        notes.append("The forces hardly saturate: shape 1.35 and a friction of 1 are assumed.")
        return judged(start, samples, ASSUMED_FRICTION, tuple(notes))
    peak = float((np.abs(samples.force) / samples.load).max())
    tyre, friction = fit_saturation(start, samples, peak, loads_differ=several, stiffness=True)
    return judged(tyre, samples, friction, tuple(notes))


def _columns(where: str) -> dict[str, Array]:
    """The columns by name, an empty cell NaN."""
    shown = printable(where)
    try:
        text = read_bytes(where).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise ConfigError(f"{shown}: is no text (UTF-8).") from None
    rows = [(number, row) for number, row in enumerate(csv.reader(io.StringIO(text)), 1) if any(map(str.strip, row))]
    rows = [(number, row) for number, row in rows if not row[0].lstrip().startswith("#")]
    if not rows:
        raise ConfigError(f"{shown}: is empty.")
    names = [cell.strip() for cell in rows[0][1]]
    known = (*SLIPS, *FORCES, *LOADS)
    for each in names:
        if each not in known:
            raise ConfigError(f"{shown}: column {printable(each)!r}: unknown. {did_you_mean(each, known)}")
    if len(set(names)) < len(names):
        raise ConfigError(f"{shown}: a column stands there twice.")
    if sum(slip in names for slip in SLIPS) != 1 or not set(FORCES) <= set(names):
        raise ConfigError(f"{shown}: needs slip_rad or slip_deg, and {' and '.join(FORCES)}.")
    if (LOADS[0] in names) != (LOADS[1] in names):
        raise ConfigError(f"{shown}: needs {' and '.join(LOADS)}, or neither.")
    values = np.full((len(rows) - 1, len(names)), np.nan)
    for i, (number, row) in enumerate(rows[1:]):
        if len(row) != len(names):
            raise ConfigError(f"{shown}, line {number}: {len(row)} cells, the head has {len(names)}.")
        for j, cell in enumerate(row):
            if cell.strip() or names[j] not in FORCES:
                values[i, j] = _number(shown, number, names[j], cell)
    columns = dict(zip(names, values.T, strict=True))
    slip = np.radians(columns.pop("slip_deg")) if "slip_deg" in columns else columns.pop("slip_rad")
    if slip.size and np.abs(slip).max() > 1.0:
        raise ConfigError(
            f"{shown}: slip of up to {np.abs(slip).max():.3g} rad: no tyre is measured there; in degrees it is column "
            "slip_deg."
        )
    return columns | {"slip": slip}


def _number(shown: str, line: int, column: str, cell: str) -> float:
    try:
        value = float(cell)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise ConfigError(f"{shown}, line {line}: {column} = {printable(cell)[:40]!r}: must be a finite number.")
    return value


def _axle(where: str, columns: dict[str, Array], i: int, loads: tuple[float, float] | None) -> _Axle:
    """What is known of an axle, for one of its tyres."""
    shown, force = printable(where), columns[FORCES[i]]
    there = np.isfinite(force)
    slip, force = columns["slip"][there], 0.5 * force[there]
    if LOADS[i] in columns:
        load = 0.5 * columns[LOADS[i]][there]
    elif loads is None:
        raise InvalidInput(
            f"{shown}: has no loads: add {LOADS[0]} and {LOADS[1]}, or give the static wheel loads (of a car file)."
        )
    else:
        load = np.full(slip.size, float(loads[i]))
    if slip.size < LEAST_ROWS or np.ptp(slip) < 0.01:
        raise ConfigError(
            f"{shown}: {FORCES[i]}: {slip.size} rows over {np.ptp(slip) if slip.size else 0.0:.3g} rad; needs at "
            f"least {LEAST_ROWS} over 0.01 rad."
        )
    if not (load > 0.0).all():
        raise ConfigError(f"{shown}: {LOADS[i]}: every load must be positive.")
    if np.sum((slip - slip.mean()) * (force - force.mean())) <= 0.0:
        raise ConfigError(
            f"{shown}: {FORCES[i]} falls with slip: here a wheel that is turned left of its velocity has a positive slip "
            "and is pushed to the left, positive (ISO 8855 axes); change the sign of one of the columns."
        )
    if np.abs(force / load).max() > 3.0:
        raise ConfigError(f"{shown}: {FORCES[i]} is up to {np.abs(force / load).max():.3g} times the load: wrong unit?")
    return _Axle(slip, force, load)


def _stiffness(axles: list[_Axle], nominal: float, name: str, several: bool) -> tuple[list[str], Tyre, list[float]]:
    """A tyre with the slopes of the axles at small forces, and the slip at which each has no force (rad)."""
    from scipy.optimize import least_squares

    notes: list[str] = []
    small = []
    for axle in axles:
        near = np.abs(axle.force / axle.load) <= SMALL * np.abs(axle.force / axle.load).max()
        small.append(_Axle(*(each[near] for each in axle)) if near.sum() >= 3 else axle)

    def slope(x: Array, load: Array) -> Array:
        q = load / nominal
        return np.asarray((1.0 + x[4] ** -2) * q / (1.0 + (q / x[4]) ** 2)) if several else np.ones_like(q)

    def residual(x: Array) -> Array:
        parts = [
            (1e5 * x[i] * slope(x, axle.load) * (axle.slip - x[2 + i]) - axle.force) / axle.load
            for i, axle in enumerate(small)
        ]
        return np.concatenate(parts)

    scale = [np.polyfit(axle.slip, axle.force, 1)[0] / 1e5 for axle in small]
    start = [*(max(each, 1e-9) for each in scale), 0.0, 0.0, 2.0]
    found = least_squares(
        residual, start, bounds=([1e-10, 1e-10, -0.1, -0.1, 0.3], [99.0, 99.0, 0.1, 0.1, 50.0]),
        x_scale=[start[0], start[1], 0.01, 0.01, 1.0],
    )  # fmt: skip
    front, rear, *offsets, ratio = found.x
    if not several:
        notes.append("One load for each axle: the stiffness does not depend on the load.")
    for which, offset in zip(("front", "rear"), offsets, strict=True):
        if abs(offset) > 5e-4:
            notes.append(f"The {which} axle has no force at a slip of {offset:.4f} rad: that offset is taken out.")
    tyre = Tyre(
        name=name, description="fitted to a table of axle forces", kind="magic-formula",
        stiffness_front=float(f"{1e5 * front:.5g}"), stiffness_rear=float(f"{1e5 * rear:.5g}"), nominal_load=nominal,
        stiffness_load="digressive" if several else "constant",
        digressive_load_ratio=float(f"{ratio:.5g}") if several else None,
    )  # fmt: skip
    notes.append("No relaxation length in a table of steady forces: they build up at once.")
    return notes, tyre, list(offsets)
