"""A comparison on cars, roads and profiles: each cell is kept in its folder, so that an interrupted one goes on."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import as_completed
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from adaptrack import __version__
from adaptrack.base.errors import MissingExtra, UnknownName, did_you_mean
from adaptrack.base.files import SHIPPED, ParquetColumn, build, encode_parquet, read_toml, safe_name, write_atomically
from adaptrack.cars.plant import fingerprint
from adaptrack.comparison.cells import columns, run_cell
from adaptrack.comparison.config import Cell, ComparisonConfig, load_setting
from adaptrack.comparison.table import Comparison, label_of
from adaptrack.studies.pipeline import JSONFile, identity_of

Progress = Callable[[str, int, int], None]

PREFERRED = ("informed, tuned", "informed, default")
"""Whom ratios are taken to, where they drove."""
FORMAT, FORMAT_VERSION, TABLE = "adaptrack side-by-side", 1, "runs.parquet"
UNITS = {
    "cost": "m^2", "failed": "-", "failed_at": "s", "rms_error": "m", "p95_error": "m", "max_error": "m",
    "max_corner": "m", "steering_rate": "rad/s", "acceleration": "m/s^2", "jerk": "m/s^3", "duration": "s", "seed": "-",
}  # fmt: skip
_DATA = SHIPPED / "comparisons"


@dataclass(frozen=True, eq=False)
class Compared:
    """What came of a comparison."""

    task: ComparisonConfig
    cells: dict[Cell, dict[str, Any]]
    """see `run_cell`"""
    absent: dict[str, str]
    """cars that were left out, and why"""

    @cached_property
    def columns(self) -> dict[str, NDArray[Any]]:
        """Every run, see `cells.columns`."""
        return columns(list(self.cells.values()))

    @cached_property
    def by_profile(self) -> dict[str, Comparison]:
        """The table of each profile."""
        columns = self.columns
        return {
            profile: Comparison.of_columns(
                {name: values[columns["profile"] == profile] for name, values in columns.items()}, PREFERRED
            )
            for profile in dict.fromkeys(columns["profile"].tolist())
        }

    @property
    def left_out(self) -> dict[Cell, str]:
        """Cells that were not driven, and why."""
        return {cell: each["left_out"] for cell, each in self.cells.items() if each["left_out"]}

    def entry_speeds(self, profile: str) -> dict[str, dict[str, float]]:
        """m/s by contender and car: the highest clean entry speed into ISO 3888-2, 0 where none is clean."""
        found: dict[str, dict[str, float]] = {}
        for cell, each in self.cells.items():
            if cell.profile == profile:
                for tuning, speed in each["entry_speed"].items():
                    if speed is not None:
                        found.setdefault(label_of(cell.contender, tuning), {})[cell.car] = speed
        return found

    def save(self, path: str | os.PathLike[str]) -> None:
        """Every run as a row of a Parquet file.

        Raises
        ------
        StorageError
            When it cannot be written.
        """
        columns = [ParquetColumn(name, UNITS.get(name, "-"), values) for name, values in self.columns.items()]
        about = {"task": self.task.model_dump(mode="json"), "adaptrack": __version__}
        write_atomically(path, encode_parquet(FORMAT, FORMAT_VERSION, columns, about))


def list_comparisons() -> dict[str, str]:
    """The comparisons that ship with the package: name and first remark."""
    return {path.stem: path.read_text(encoding="utf-8").splitlines()[0].lstrip("# ") for path in _DATA.glob("*.toml")}


def load_comparison(name_or_path: str | os.PathLike[str], **changes: Any) -> ComparisonConfig:
    """A comparison that ships with the package, or a TOML file's; keys: the fields of `ComparisonConfig`.

    changes: fields to replace.

    Raises
    ------
    UnknownName
        When none has the name.
    StorageError
        When the file cannot be read.
    ConfigError
        When a key is unknown, missing or not allowed.
    """
    text = os.fspath(name_or_path)
    if text.endswith(".toml"):
        path = Path(text)
    elif text in list_comparisons():
        path = _DATA / f"{text}.toml"
    else:
        raise UnknownName(
            f"no comparison is named {text!r}. {did_you_mean(text, list_comparisons())} A file is given by its .toml "
            "path."
        )
    return build(ComparisonConfig, {"name": path.stem, **read_toml(path), **changes}, path)


def run_comparison(
    task: ComparisonConfig, out: str | os.PathLike[str], *, dask: str | None = None, progress: Progress | None = None
) -> Compared:
    """Drive a comparison in a folder; cells that are there with the same identity are read, not driven again.

    dask: address of a Dask scheduler whose workers drive the cells; progress: called with (what, cells done, cells).

    Raises
    ------
    AdaptrackError
        When a profile, a road or the folder cannot be used; a car that needs an extra which is not installed is left
        out instead, unless there is no other.
    """
    absent = _absent(task)
    cells = [cell for cell in task.cells if cell.car not in absent]
    kept = {cell: _kept(task, Path(out), cell) for cell in cells}
    found = {cell: keeper.load(identity) for cell, (keeper, identity) in kept.items()}
    missing = [cell for cell in cells if found[cell] is None]
    if progress is not None and missing:
        progress(missing[0].label, len(cells) - len(missing), len(cells))
    for i, (cell, made) in enumerate(_driven(task, missing, dask), start=1):
        keeper, identity = kept[cell]
        keeper.save(made, identity)
        found[cell] = keeper.load(identity)
        if progress is not None:
            following = missing[i].label if dask is None and i < len(missing) else cell.label
            progress(following, len(cells) - len(missing) + i, len(cells))
    compared = Compared(task, {cell: found[cell] or {} for cell in cells}, absent)
    compared.save(Path(out) / TABLE)
    return compared


def _absent(task: ComparisonConfig) -> dict[str, str]:
    """Cars that cannot be had here; raises where none is left."""
    found: dict[str, str] = {}
    for car in dict.fromkeys(task.cars):
        try:
            load_setting(car, task.profiles[0])
        except MissingExtra as error:
            found[car] = str(error)
            if len(found) == len(set(task.cars)):
                raise
    return found


def _settings(task: ComparisonConfig, cell: Cell) -> dict[str, Any]:
    """All that a cell's result depends on, beside the software."""
    settings = task.model_dump(mode="json", exclude={"name", "contenders", "cars", "profiles"})
    setting = load_setting(cell.car, cell.profile)
    car, profile = setting.car.model_dump(mode="json"), setting.profile.model_dump(mode="json")
    return {**settings, **asdict(cell), "about_car": car, "about_profile": profile, "plant": fingerprint(setting.plant)}


def _kept(task: ComparisonConfig, folder: Path, cell: Cell) -> tuple[JSONFile, str]:
    """Where the result of a cell is kept, and its identity."""
    file = JSONFile(folder / "cells" / f"{safe_name(cell.label)}.json")
    return file, identity_of("side-by-side", _settings(task, cell))


def _driven(task: ComparisonConfig, cells: Iterable[Cell], dask: str | None) -> Iterator[tuple[Cell, dict[str, Any]]]:
    """Drive cells here, one after the other, or by the workers of a Dask scheduler."""
    if dask is None:
        for cell in cells:
            yield cell, run_cell(task, cell)
        return
    from adaptrack.tuning.campaign import dask_client

    with dask_client(dask) as client:
        pool = client.get_executor(retries=3, pure=False)
        waiting = {pool.submit(run_cell, task, cell): cell for cell in cells}
        for future in as_completed(waiting):
            yield waiting[future], future.result()
