"""From models that were trained on a data set to a schedule."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adaptrack.base.errors import InvalidInput
from adaptrack.control.controllers.compatibility import INCREMENTAL
from adaptrack.control.scheduling import ENTRIES, Learned, Schedule
from adaptrack.paper.data_set import DataSet
from adaptrack.paper.training import Trained


def trained_schedule(trained: Trained, dataset: DataSet) -> Schedule:
    """The functions learned from a data set as a schedule, within the bounds of the data set's search."""
    bounds = search_bounds(dataset)
    functions: dict[str, Any] = dict(trained.functions)
    if "log10_ratio" in functions:
        (q_low, q_high), (r_low, r_high) = bounds.pop("Q"), bounds["R"]
        bounds["R"] = (r_low / q_high, r_high / q_low)
    return Learned(functions, trained.inputs, trained.domain, bounds, trained.model, trained.provenance)


def search_bounds(dataset: DataSet) -> dict[str, tuple[float, float]]:
    """(low, high) of each entry of the tuning in the search behind a data set.

    Raises
    ------
    InvalidInput
        When the provenance does not contain the bounds.
    """
    search = dataset.provenance.get("settings", {}).get("search", {})
    if not set(ENTRIES) <= set(search):
        raise InvalidInput(f"data set {dataset.name!r}: its provenance does not contain the bounds of its search.")
    return {entry: (float(search[entry][0]), float(search[entry][1])) for entry in ENTRIES}


def purpose_of(dataset: DataSet) -> dict[str, Any]:
    """The car, profile and controller whose tunings a data set contains, for `Schedule.made_for`."""
    settings = dataset.provenance.get("settings", {})
    names = {"car": settings.get("vehicle"), "profile": settings.get("profile"), "tyre": settings.get("tyre")}
    purpose = {key: entry["name"] if isinstance(entry, Mapping) else entry for key, entry in names.items() if entry}
    controller = settings.get("controller", "as-written")  # data sets of earlier releases do not name the controller
    model = INCREMENTAL if controller == "as-written" else controller
    return {**purpose, "controller": {"kind": "MPC", "model": model}} if settings else {}
