"""What is in a data set: its ranges, its optimum, what they cost, and how flat it is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.paper.data_set import DataSet
from adaptrack.paper.operating_points import COLUMNS

Array = NDArray[np.float64]

TARGETS = ("Np", "Nc", "log Q", "log R", "log R/Q")
"""What is learnt from a data set, of the best tuning found at each operating point."""

SETTINGS = ("profile", "scenario", "duration", "plant", "move_weight", "noise_seeds")
"""What a description repeats of the campaign."""
LEARNER = "gradient-boosted trees (scikit-learn), 5-fold cross-validation"
"""What R^2 is of, see `learning.boosting`."""


def targets(dataset: DataSet) -> dict[str, Array]:
    """(n,) of each of `TARGETS`; logarithms are natural."""
    Np, Nc, Q, R = dataset.tunings.T
    return dict(zip(TARGETS, (Np, Nc, np.log(Q), np.log(R), np.log(R / Q)), strict=True))


def flatness(dataset: DataSet, within: float) -> Array:
    """(m,) share of the library whose cost is at most (1 + within) times the lowest known, at each operating point.

    Operating points count that a swarm searched and where some tuning kept the car.
    """
    best = dataset.best_costs
    rows = dataset.computed & np.isfinite(best)
    return (dataset.landscape[rows] <= ((1.0 + within) * best[rows])[:, np.newaxis]).mean(axis=1)


def describe(dataset: DataSet, r2: Mapping[str, float] | None = None) -> dict[str, Any]:
    """What is in a data set, as plain JSON: tables are lists of rows.

    r2: how much of each target the operating points explain, see `learning.boosting.explained_shares`; unknown when
    left out. Statistics are over the operating points that a swarm searched; their left-right twins would count twice.
    """
    rows = dataset.rows(dataset.computed)
    settings = dataset.provenance.get("settings", {})
    kept = np.isfinite(rows.costs) & np.isfinite(rows.standard_costs) & (rows.standard_costs > 0.0) & (rows.costs > 0.0)
    gain = rows.standard_costs[kept] / rows.costs[kept]
    known = np.isfinite(rows.best_costs) & (rows.best_costs > 0.0)
    behind = rows.costs[known] / rows.best_costs[known] - 1.0
    bounds = _bounds(settings.get("search"))
    return {
        "name": dataset.name,
        "operating_points": len(dataset),
        "computed": len(rows),
        "library": len(dataset.library),
        **{key: settings.get(key) for key in SETTINGS},
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
            for column, values in zip(COLUMNS, dataset.operating_points.T, strict=True)
        ],
        "optimum": [
            {
                "target": name,
                **_spread(values),
                "at_a_bound": _at_bounds(values, bounds.get(name)),
                "r2": (r2 or {}).get(name),
            }
            for name, values in targets(rows).items()
        ],
        "learner": LEARNER,
        "flatness": [
            {"within": within, "mean": _finite(share.mean() if share.size else np.nan), **_spread(share)}
            for within in (0.05, 0.2)
            for share in (flatness(dataset, within),)
        ],
        "costs": {
            "standard_over_best_geomean": _finite(np.exp(np.log(gain).mean()) if gain.size else np.nan),
            "swarm_behind_the_best_known_p50": _quantile(behind, 0.5),
            "swarm_behind_the_best_known_p90": _quantile(behind, 0.9),
            "failed_by_the_standard": int(np.isinf(rows.standard_costs).sum()),
            "failed_by_the_swarm": int(np.isinf(rows.costs).sum()),
            "failed_by_all": int(np.isinf(rows.best_costs).sum()),
            "library_failed": float(np.isinf(rows.landscape).mean()) if rows.landscape.size else 0.0,
        },
    }


def _name(entry: Any) -> Any:
    return entry.get("name") if isinstance(entry, dict) else entry


def _spread(values: Array) -> dict[str, float | None]:
    return {
        key: _quantile(values, level)
        for key, level in (("lowest", 0.0), ("p10", 0.1), ("p50", 0.5), ("p90", 0.9), ("highest", 1.0))
    }


def _quantile(values: Array, level: float) -> float | None:
    finite = values[np.isfinite(values)]
    return float(np.quantile(finite, level)) if finite.size else None


def _bounds(search: dict[str, Any] | None) -> dict[str, tuple[float, float]]:
    """The lowest and the highest value of each target that the swarm may find."""
    if search is None:
        return {}
    (q_low, q_high), (r_low, r_high) = np.log(search["Q"]), np.log(search["R"])
    pairs = (search["Np"], search["Nc"], (q_low, q_high), (r_low, r_high), (r_low - q_high, r_high - q_low))
    return {name: (float(low), float(high)) for name, (low, high) in zip(TARGETS, pairs, strict=True)}


def _at_bounds(values: Array, bounds: tuple[float, float] | None) -> float | None:
    """Share of the values that lie at a bound of the search."""
    if bounds is None:
        return None
    return float(((values <= bounds[0] + 1e-9) | (values >= bounds[1] - 1e-9)).mean())


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
