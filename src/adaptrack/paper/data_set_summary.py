"""Summary of a data set: ranges, optimum, costs, and how flat the optimum is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.core.maths import portable
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.operating_points import POINT_COORDINATES

Array = NDArray[np.float64]

SUMMARY_TARGETS = ("Np", "Nc", "log Q", "log R", "log R/Q")
"""Parts of the best tuning; logarithms are natural."""
NEAR_BEST = (0.05, 0.2)
"""Tunings whose cost is at most this share above the best count as near it."""
SUMMARY_SETTINGS = ("profile", "scenario", "duration", "plant", "move_weight", "noise_seeds")
"""Settings of the campaign that the summary repeats."""


def best_tunings(dataset: DataSet) -> dict[str, Array]:
    """(n,) of each of `SUMMARY_TARGETS`."""
    Np, Nc, Q, R = dataset.tunings.T
    return dict(zip(SUMMARY_TARGETS, (Np, Nc, portable.log(Q), portable.log(R), portable.log(R / Q)), strict=True))


def flatness(dataset: DataSet, within: float) -> Array:
    """(m,) share of the library whose cost is at most (1 + within) times the lowest known, at each operating point.

    Only operating points that a swarm searched and where some tuning did not fail.
    """
    best = dataset.best_costs
    rows = dataset.computed & np.isfinite(best)
    return (dataset.landscape[rows] <= ((1.0 + within) * best[rows])[:, np.newaxis]).mean(axis=1)


def describe(dataset: DataSet) -> dict[str, Any]:
    """The summary of a data set as plain JSON: tables are lists of rows.

    Statistics are over the operating points that a swarm searched; left-right twins would count twice.
    """
    rows = dataset.rows(dataset.computed)
    settings = dataset.provenance.get("settings", {})
    bounds = _search_bounds(settings.get("search"))
    return {
        "name": dataset.name,
        "operating_points": len(dataset),
        "computed": len(rows),
        "library": len(dataset.library),
        **{key: settings.get(key) for key in SUMMARY_SETTINGS},
        "vehicle": _name(settings.get("vehicle")),
        "tyre": _name(settings.get("tyre")),
        "evaluations": int(rows.evaluations.sum()),
        "control_steps": int(rows.control_steps.sum()),
        "versions": dataset.provenance.get("versions", {}),
        "identity": dataset.provenance.get("identity"),
        "command": dataset.command,
        "ranges": [
            {
                "quantity": column.name,
                "unit": column.unit,
                "lowest": float(values.min()),
                "highest": float(values.max()),
                "levels": int(np.unique(values).size),
            }
            for column, values in zip(POINT_COORDINATES, dataset.operating_points.T, strict=True)
        ],
        "optimum": [
            {"target": name, **_quantiles(values), "at_a_bound": _share_at_bounds(values, bounds.get(name))}
            for name, values in best_tunings(rows).items()
        ],
        "flatness": [
            {"within": within, "mean": _finite(share.mean() if share.size else np.nan), **_quantiles(share)}
            for within in NEAR_BEST
            for share in (flatness(dataset, within),)
        ],
        "costs": _costs(rows),
    }


def _costs(rows: DataSet) -> dict[str, float | int | None]:
    """Compare the costs of the standard tuning, the swarm's best and the library; count failures."""
    comparable = rows.comparable
    gain = rows.standard_costs[comparable] / rows.costs[comparable]
    positive = np.isfinite(rows.best_costs) & (rows.best_costs > 0.0)
    excess = rows.costs[positive] / rows.best_costs[positive] - 1.0
    return {
        "standard_over_best_geomean": _finite(portable.exp(portable.log(gain).mean()) if gain.size else np.nan),
        "swarm_behind_the_best_known_p50": _quantile(excess, 0.5),
        "swarm_behind_the_best_known_p90": _quantile(excess, 0.9),
        "failed_by_the_standard": int(np.isinf(rows.standard_costs).sum()),
        "failed_by_the_swarm": int(np.isinf(rows.costs).sum()),
        "failed_by_all": int(np.isinf(rows.best_costs).sum()),
        "library_failed": float(np.isinf(rows.landscape).mean()) if rows.landscape.size else 0.0,
    }


def _name(entry: Any) -> Any:
    return entry.get("name") if isinstance(entry, dict) else entry


def _quantiles(values: Array) -> dict[str, float | None]:
    levels = {"lowest": 0.0, "p10": 0.1, "p50": 0.5, "p90": 0.9, "highest": 1.0}
    return {name: _quantile(values, level) for name, level in levels.items()}


def _quantile(values: Array, level: float) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, level)) if finite.size else None


def _search_bounds(search: Mapping[str, Any] | None) -> dict[str, tuple[float, float]]:
    """The lowest and the highest value of each target in the search."""
    if search is None:
        return {}
    (q_low, q_high), (r_low, r_high) = portable.log(search["Q"]), portable.log(search["R"])
    pairs = (search["Np"], search["Nc"], (q_low, q_high), (r_low, r_high), (r_low - q_high, r_high - q_low))
    return {name: (float(low), float(high)) for name, (low, high) in zip(SUMMARY_TARGETS, pairs, strict=True)}


def _share_at_bounds(values: Array, bounds: tuple[float, float] | None) -> float | None:
    if bounds is None:
        return None
    return float(((values <= bounds[0] + 1e-9) | (values >= bounds[1] - 1e-9)).mean())


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
