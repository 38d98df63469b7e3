"""From models trained on a data set to a schedule, held within the bounds of the search behind the data set."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers.made_for import INCREMENTAL
from adaptrack.control.scheduling import ENTRIES, Learned, Schedule
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.training import Trained


def search_bounds(dataset: DataSet) -> dict[str, tuple[float, float]]:
    """(low, high) of each slot in the search behind a data set.

    Raises
    ------
    InvalidInput
        When the provenance does not hold them.
    """
    search = dataset.provenance.get("settings", {}).get("search", {})
    if not set(ENTRIES) <= set(search):
        raise InvalidInput(f"data set {dataset.name!r}: its provenance does not tell the bounds of its search.")
    return {slot: (float(search[slot][0]), float(search[slot][1])) for slot in ENTRIES}


def purpose_of(dataset: DataSet) -> dict[str, Any]:
    """The car, profile and controller of a data set as `Schedule.made_for`, where its provenance holds them."""
    settings = dataset.provenance.get("settings", {})
    names = {"car": settings.get("vehicle"), "profile": settings.get("profile"), "tyre": settings.get("tyre")}
    known = {key: value["name"] if isinstance(value, Mapping) else value for key, value in names.items() if value}
    controller = settings.get("controller", "as-written")  # old data sets of the paper's controller do not name it
    model = INCREMENTAL if controller == "as-written" else controller
    return {**known, "controller": {"kind": "MPC", "model": model}} if settings else {}


def trained_schedule(
    trained: Trained, dataset: DataSet, clamps: Mapping[str, tuple[float, float]] | None = None
) -> Schedule:
    """The functions learned from a data set as a schedule, held within its search's bounds, or within `clamps`.

    A clamp that is infinite leaves the search's bound; log10 R/Q is held within what the bounds of both allow.
    """
    bounds = search_bounds(dataset)
    for slot, (low, high) in (clamps or {}).items():
        bounds[slot] = (
            low if math.isfinite(low) else bounds[slot][0],
            high if math.isfinite(high) else bounds[slot][1],
        )
    functions: dict[str, Any] = dict(trained.functions)
    if "log10_ratio" in functions:
        (q_low, q_high), (r_low, r_high) = bounds.pop("Q"), bounds["R"]
        bounds["R"] = (r_low / q_high, r_high / q_low)
    return Learned(functions, trained.inputs, trained.domain, bounds, trained.model, trained.provenance)
