"""Results of `tune`: constant tuning of a car, and tuning of a controller on selected roads."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from adaptrack.base.result import Column, Result, ResultTable, strict
from adaptrack.comparison.table import standing_rows
from adaptrack.comparison.tune_on_roads import TunedOnRoads
from adaptrack.results.compare import console_table
from adaptrack.tuning.car import TunedCar

CAR_COLUMNS = (
    Column("tuning", "tuning"),
    Column("Np", "Np", "periods", "whole"),
    Column("Nc", "Nc", "periods", "whole"),
    Column("ratio", "R/Q", "m²/rad²", 4),
    Column("cost", "cost J", "m²", 3),
    Column("failed", "failed\ndrives"),
)
ACCEPTANCE_NOTE = "The search replaces the default only if it is better with 95 % confidence and fails no more often."
STAND_IN_NOTE = "The plant has no linear model: the certificate uses the car model of the controller."


def tuned_car_result(tuned: TunedCar, files: Mapping[str, str]) -> Result:
    """Return the result for the constant tuning of a car; files: paths of car file and tuning file."""
    record = tuned.summary()
    rows = [
        {
            "tuning": f"{name}{' (chosen)' if tuned.tuning == tuning else ''}", "Np": tuning.Np, "Nc": tuning.Nc,
            "ratio": tuning.R / tuning.Q, "cost": record["cost"][name], "failed": record["failed"][name],
        }
        for name, tuning in (("default", tuned.default), ("candidate", tuned.candidate))
    ]  # fmt: skip
    notes = [f"Certificate: {tuned.certificate.verdict}"]
    notes += [] if tuned.feasibility.passed else [tuned.feasibility.verdict]
    notes += [] if tuned.certificate.plant == tuned.plant else [STAND_IN_NOTE]
    notes += [f"Steering model of the controller: {tuned.controller.belief_at_first}."]
    return Result(
        kind="tuned-car",
        title=f"Tuning of {tuned.controller.model.vehicle.name}",
        answer=tuned.headline,
        record={**record, **files},
        tables=[
            ResultTable("tunings", f"{record['drives']} test drives", CAR_COLUMNS, rows, ACCEPTANCE_NOTE, brief=True)
        ],
        notes=[*notes, *(f"{name.replace('_', ' ')}: {path}" for name, path in files.items())],
        failed=not tuned.passed,
    )


def tuned_roads_result(tuned: TunedOnRoads, file: str) -> Result:
    """Return the result for the tuning of a controller on selected roads, tested with different noise."""
    search, judgement, name = tuned.search, tuned.judgement, tuned.file.controller
    over, rows = judgement.ratio("tuned", "default"), standing_rows(judgement)
    entries = [{"entry": key, "default": search.default[key], "tuned": value} for key, value in search.tuning.items()]
    columns = (Column("entry", "entry"), Column("default", "default", "", 4), Column("tuned", "tuned", "", 4))
    at_bounds = f"At a limit of the search: {', '.join(search.at_bounds)}." if search.at_bounds else ""
    notes = [f"Steering model of the controller: {tuned.file.belief}."] if tuned.file.belief else []
    record: dict[str, Any] = {
        "tuning": file, "controller": name, "entries": search.tuning, "default": search.default,
        "better": search.better, "at_bounds": search.at_bounds, "cost": search.cost,
        "default_cost": search.default_cost, "belief": tuned.file.belief, "runs": tuned.loops,
        "seconds": tuned.seconds, "gain": over._asdict(), "rows": strict(rows),
    }  # fmt: skip
    return Result(
        kind="tuned-roads",
        title=f"Tuning of {name}",
        answer=f"The best tuning found for {name} costs {over.mean:.3g} times the default tuning (95 % interval "
        f"{over.low:.3g} to {over.high:.3g}), with new sensor noise.",
        record=record,
        tables=[
            console_table(tuned.file.profile, rows, judgement),
            ResultTable("entries", "Tuning", columns, entries, at_bounds, brief=True),
        ],
        notes=[*notes, f"tuning file: {file}"],
    )
