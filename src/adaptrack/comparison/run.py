"""Runs of a comparison on cars, roads and profiles; finished cells are stored in a folder."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base.errors import StorageError
from adaptrack.base.files import ParquetColumn, encode_parquet, read_json, safe_name, write_atomically, write_json
from adaptrack.base.progress import ProgressCall
from adaptrack.cars.plant import fingerprint
from adaptrack.comparison.cells import columns, run_cell
from adaptrack.comparison.config import Cell, ComparisonConfig, is_tuning_file, load_setting
from adaptrack.comparison.table import Comparison, label_of
from adaptrack.core.library import kernels_hash
from adaptrack.drive.speed_measures import SPEED_MEASURES
from adaptrack.tuning.constant import load_tuning

REFERENCES = ("informed, tuned", "informed, default")
"""Labels of preferred reference contenders. A comparison without them uses its first contender."""
COMPARISON_FORMAT, COMPARISON_VERSION, RUNS_FILE = "adaptrack comparison", 1, "runs.parquet"
MEASURE_UNITS = {
    "cost": "m^2", "failed": "-", "failed_at": "s", "rms_error": "m", "p95_error": "m", "max_error": "m",
    "max_corner": "m", "steering_rate": "rad/s", "acceleration": "m/s^2", "jerk": "m/s^3", "duration": "s", "seed": "-",
    **SPEED_MEASURES,
}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Compared:
    """Result of a comparison: all its runs."""

    task: ComparisonConfig
    cells: dict[Cell, dict[str, Any]]
    """Result of `run_cell` for each cell."""

    @cached_property
    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns of all runs, see `cells.columns`."""
        return columns(list(self.cells.values()))

    @cached_property
    def profile_comparisons(self) -> dict[str, Comparison]:
        """The comparison of the runs in each profile, by `Cell.condition`."""
        columns = self.columns
        return {
            profile: Comparison.from_columns(
                {name: values[columns["profile"] == profile] for name, values in columns.items()}, REFERENCES
            )
            for profile in dict.fromkeys(columns["profile"].tolist())
        }

    @property
    def failed_runs(self) -> list[dict[str, Any]]:
        """The rows of the failed runs: contender, car, profile, road, noise seed, reason and time of failure (s)."""
        return [
            {
                "label": label_of(row["contender"], row["tuning"]),
                **{key: row[key] for key in ("car", "profile", "road", "seed", "reason", "failed_at")},
            }
            for cell in self.cells.values()
            for row in cell["rows"]
            if row["failed"]
        ]

    @property
    def left_out(self) -> dict[Cell, str]:
        """The cells that were not driven, with the reason."""
        return {cell: result["left_out"] for cell, result in self.cells.items() if result["left_out"]}

    def entry_speeds(self, profile: str) -> dict[str, dict[str, float]]:
        """Return the highest clean entry speed into ISO 3888-2 (m/s) by contender and car, 0 if none is clean."""
        speeds: dict[str, dict[str, float]] = {}
        for cell, result in self.cells.items():
            if cell.profile == profile:
                for label, speed in result["entry_speed"].items():
                    if speed is not None:
                        speeds.setdefault(label, {})[cell.car] = speed
        return speeds

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write all runs as rows of a Parquet file.

        Raises
        ------
        StorageError
            When the file cannot be written.
        """
        columns = [ParquetColumn(name, MEASURE_UNITS.get(name, "-"), values) for name, values in self.columns.items()]
        metadata = {"task": self.task.model_dump(mode="json"), "adaptrack": __version__}
        write_atomically(path, encode_parquet(COMPARISON_FORMAT, COMPARISON_VERSION, columns, metadata))


def run_comparison(
    task: ComparisonConfig, out: str | os.PathLike[str] | None = None, *, progress: ProgressCall | None = None
) -> Compared:
    """Drive all cells of a comparison.

    Parameters
    ----------
    task
        Configuration of the comparison.
    out
        Folder for the results. Cells that it already contains for equal settings are read instead of driven.
    progress
        Function called with (cell, cells done, cells in all).

    Raises
    ------
    AdaptrackError
        When a car, a profile, a road or the folder cannot be used.
    """
    results = {}
    for number, cell in enumerate(task.cells):
        if progress is not None:
            progress(cell.label, number, len(task.cells))
        file = None if out is None else _CellFile.of(task, Path(out), cell)
        stored = None if file is None else file.load()
        results[cell] = run_cell(task, cell) if stored is None else stored
        if file is not None and stored is None:
            file.save(results[cell])
    compared = Compared(task, results)
    if out is not None:
        compared.save(Path(out) / RUNS_FILE)
    return compared


@dataclass(frozen=True)
class _CellFile:
    """JSON file with the result of a cell and the hash of everything that the result depends on."""

    path: Path
    identity: str

    @classmethod
    def of(cls, task: ComparisonConfig, folder: Path, cell: Cell) -> _CellFile:
        software = {"adaptrack": __version__, "kernels": kernels_hash(), "numpy": np.__version__}
        text = json.dumps([_cell_settings(task, cell), software], sort_keys=True)
        path = folder / "cells" / f"{safe_name(cell.label)}.json"
        return cls(path, hashlib.sha256(text.encode()).hexdigest())

    def load(self) -> dict[str, Any] | None:
        """Return the stored result, or None if there is no file or its hash differs."""
        if not self.path.exists():
            return None
        content = read_json(self.path)
        if not isinstance(content, Mapping) or set(content) != {"identity", "result"}:
            raise StorageError(f"{self.path}: not the file of a cell. Remove it to continue.")
        return content["result"] if content["identity"] == self.identity else None

    def save(self, result: dict[str, Any]) -> None:
        try:
            self.path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"{self.path.parent}: cannot be made: {error.strerror or error}.") from error
        write_json(self.path, {"identity": self.identity, "result": result})


def _cell_settings(task: ComparisonConfig, cell: Cell) -> dict[str, Any]:
    """Return everything that the result of a cell depends on, except the software."""
    settings = task.model_dump(mode="json", exclude={"name", "contenders", "drivers", "cars", "profiles", "frictions"})
    setting = load_setting(cell.car, cell.profile)
    settings |= cell.entries | {
        "about_car": setting.car.model_dump(mode="json"), "about_profile": setting.profile.model_dump(mode="json"),
        "plant": fingerprint(setting.plant),
    }  # fmt: skip
    if is_tuning_file(cell.contender):
        settings["tuning_file"] = load_tuning(cell.contender).model_dump(mode="json")
    return settings
