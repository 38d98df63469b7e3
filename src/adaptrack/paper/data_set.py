"""Data sets of tuned operating points: the record, its Parquet file, the shipped ones, and the summary of one."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, ClassVar, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base import files
from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.presentation import figure_of, html_of
from adaptrack.base.result import strict
from adaptrack.cars.vehicle import find_data, list_data
from adaptrack.control.controllers.tuning import ENTRIES, HORIZONS
from adaptrack.core.controllers.mpc import MPC_TUNING_FIELDS
from adaptrack.core.maths import portable
from adaptrack.paper.operating_points import POINT_COORDINATES, POINT_NAMES, check_operating_points, fold

Array = NDArray[Any]

DATA_SET_FORMAT = "adaptrack data set"
DATA_SET_VERSION = 1
"""Raised whenever a column or an entry is added, dropped, renamed or changes its unit."""

_COLUMN = {"costs": "cost", "standard_costs": "standard_cost", "traces": "trace"}
"""Names of columns that differ from those of the arrays."""
_WHOLE = ("evaluations", "control_steps", "stream", "mirrored_from", "seed")


class TunedColumn(NamedTuple):
    """A column of the file of a data set."""

    name: str
    unit: str
    dtype: str
    meaning: str
    ndim: int = 1
    """2: a list of numbers in each row, equally long in all"""


DATA_SET_COLUMNS = (
    TunedColumn(
        "stream", "-", "int64", "number of the operating point; its random numbers depend on seed and stream only"
    ),
    *(TunedColumn(column.name, column.unit or "-", "float64", column.meaning) for column in POINT_COORDINATES),
    *(
        TunedColumn(field.name, "-", "int64", f"{field.meaning} of the best tuning found, {field.unit}")
        if field.name in HORIZONS
        else TunedColumn(field.name, field.unit, "float64", f"{field.meaning} of the best tuning found")
        for field in MPC_TUNING_FIELDS
    ),
    TunedColumn("r_over_q", "m^2/rad^2", "float64", "R/Q, the only part of the two that changes the control law"),
    TunedColumn("cost", "m^2", "float64", "cost of the best tuning found; inf when the run failed with every one"),
    TunedColumn("standard_cost", "m^2", "float64", "cost of the paper's tuning, 35/8/10/0.01"),
    TunedColumn("evaluations", "-", "int64", "tunings that the swarm evaluated"),
    TunedColumn("control_steps", "-", "int64", "control periods that the swarm simulated"),
    TunedColumn("seed", "-", "int64", "of the swarm"),
    TunedColumn("mirrored_from", "-", "int64", "stream of the left-right twin that was computed instead; -1: none"),
    TunedColumn("trace", "m^2", "float32", "lowest cost up to and including each generation", 2),
    TunedColumn("landscape", "m^2", "float32", "cost of each tuning of the common library", 2),
)
"""The columns of a data set, in the order of its file."""


@dataclass(frozen=True, eq=False)
class DataSet:
    """n tuned operating points: the best tuning that a swarm found at each, and what a library of T tunings costs.

    Costs are J = mean e^2 + w mean (change of command)^2 in m^2, over one run of the profile and scenario that the
    provenance names; inf where the run failed. Arrays are read-only, float64 unless said otherwise.

    Raises
    ------
    InvalidInput
        When arrays do not fit together or an operating point makes no sense.
    """

    ROW_FIELDS: ClassVar[tuple[str, ...]] = (
        "operating_points", "tunings", "costs", "standard_costs", "traces", "landscape", *_WHOLE,
    )  # fmt: skip
    """The arrays with one row per operating point."""

    operating_points: Array
    """(n, 4) speed (m/s), y_ref (m), friction, wind (m/s)"""
    tunings: Array
    """(n, 4) Np, Nc (control periods), Q (1/m^2), R (1/rad^2) of the best tuning found"""
    costs: Array
    """(n,) its cost"""
    standard_costs: Array
    """(n,) cost of the paper's tuning, 35/8/10/0.01"""
    traces: Array
    """(n, generations) float32, lowest cost up to and including each generation of the swarm"""
    landscape: Array
    """(n, T) float32, cost of each tuning of the library"""
    library: Array
    """(T, 4) Np, Nc, Q, R"""
    evaluations: Array
    """(n,) int64, tunings that the swarm evaluated"""
    control_steps: Array
    """(n,) int64, control periods that it simulated"""
    stream: Array
    """(n,) int64, number of the operating point in its campaign"""
    mirrored_from: Array
    """(n,) int64, number of the left-right twin that was computed instead, or -1"""
    seed: Array
    """(n,) int64, of the swarm"""
    provenance: dict[str, Any] = field(default_factory=dict)
    """name, settings, identity (their SHA-256), versions of the software"""

    def __post_init__(self) -> None:
        rows = check_operating_points(self.operating_points)
        n, library = len(rows), np.asarray(self.library, dtype=np.float64)
        if library.ndim != 2 or library.shape[1] != 4:
            raise InvalidInput(f"data set: `library` must have the shape (T, 4), it has {library.shape}.")
        object.__setattr__(self, "library", _read_only(library))
        shapes: dict[str, tuple[int | None, ...]] = {
            **dict.fromkeys(self.ROW_FIELDS, (n,)), "operating_points": (n, 4), "tunings": (n, 4), "traces": (n, None),
            "landscape": (n, len(library)),
        }  # fmt: skip
        dtypes = dict.fromkeys(_WHOLE, "int64") | dict.fromkeys(("traces", "landscape"), "float32")
        for name, shape in shapes.items():
            values = rows if name == "operating_points" else getattr(self, name)
            array = np.ascontiguousarray(values, dtype=dtypes.get(name, "float64"))
            if len(shape) != array.ndim or any(a not in (b, None) for a, b in zip(shape, array.shape, strict=True)):
                raise InvalidInput(f"data set: `{name}` must have the shape {shape}, it has {array.shape}.")
            object.__setattr__(self, name, _read_only(array))

    def __len__(self) -> int:
        """The number n of operating points."""
        return len(self.operating_points)

    def __repr__(self) -> str:
        return f"<DataSet {self.name!r}: {len(self)} operating points, library of {len(self.library)} tunings>"

    def plot(self) -> Any:
        """How often each tuning is the best, and what tuning is worth over the speed, as a matplotlib figure."""
        return figure_of(self)

    def _repr_html_(self) -> str:
        """The data set in a notebook."""
        return html_of(self)

    @property
    def name(self) -> str:
        """Name of its campaign."""
        return str(self.provenance.get("name", "unnamed"))

    @property
    def command(self) -> str:
        """The command that makes it again (with the campaign's own file, unless that ships with the package)."""
        name = files.safe_name(self.name)
        ships = (files.SHIPPED / "campaigns" / f"{name}.toml").exists()
        return shlex.join(["adaptrack", "paper", "campaign", name if ships else f"{name}.toml", "--out", name])

    @property
    def ratios(self) -> Array:
        """(n,) R/Q of the best tuning found, m^2/rad^2: the only part of the two that changes the control law."""
        return self.tunings[:, 3] / self.tunings[:, 2]

    @property
    def best_costs(self) -> Array:
        """(n,) the lowest cost known at each operating point: the swarm's or a tuning's of the library."""
        return np.minimum(self.costs, self.landscape.min(axis=1, initial=np.inf).astype(np.float64))

    @property
    def computed(self) -> NDArray[np.bool_]:
        """(n,) whether a swarm searched this very operating point, rather than its left-right twin."""
        return self.mirrored_from < 0

    @property
    def comparable(self) -> NDArray[np.bool_]:
        """(n,) whether standard tuning and swarm's best have costs whose ratio is finite and positive."""
        standard, best = self.standard_costs, self.costs
        return np.isfinite(standard) & (standard > 0.0) & np.isfinite(best) & (best > 0.0)

    def rows(self, selection: ArrayLike) -> Self:
        """The selected rows; selection: row numbers, or a truth value for each row."""
        chosen = np.arange(len(self))[np.asarray(selection)]
        return replace(self, **{name: getattr(self, name)[chosen] for name in self.ROW_FIELDS})

    def split(self, fraction: float = 0.2, seed: int = 0) -> tuple[Self, Self]:
        """(to learn from, held out): a random share is held out, left-right twins always on the same side.

        The same data set, fraction and seed give the same parts.

        Raises
        ------
        InvalidInput
            When one part would be empty.
        """
        family = fold(self.operating_points).family
        families = int(family.max()) + 1
        out = round(fraction * families) if 0.0 < fraction < 1.0 else 0
        if not 0 < out < families:
            raise InvalidInput(
                f"fraction = {fraction!r}: holds {out} of {families} independent operating points out; need at "
                "least one, and one left to learn from."
            )
        held_out = np.isin(family, np.random.default_rng(seed).permutation(families)[:out])
        return self.rows(~held_out), self.rows(held_out)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as one Parquet file, which appears whole or not at all.

        Raises
        ------
        StorageError
            When that fails; an older file at `path` is then untouched.
        """
        values = dict(zip(POINT_NAMES, self.operating_points.T, strict=True))
        values |= dict(zip(ENTRIES, self.tunings.T, strict=True)) | {"r_over_q": self.ratios}
        values |= {_COLUMN.get(name, name): getattr(self, name) for name in self.ROW_FIELDS[2:]}
        columns = [
            files.ParquetColumn(name, unit, np.ascontiguousarray(values[name], dtype=dtype), meaning)
            for name, unit, dtype, meaning, _ in DATA_SET_COLUMNS
        ]
        metadata = {**self.provenance, "library": self.library.tolist()}
        files.write_atomically(path, files.encode_parquet(DATA_SET_FORMAT, DATA_SET_VERSION, columns, metadata))

    @classmethod
    @checked
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `save` or a campaign wrote, bit for bit.

        Raises
        ------
        StorageError
            When the file is missing, damaged, no data set, or of another format version; the message says which.
        """
        remedy = "run its campaign again, or use the release that wrote it"
        names = [column.name for column in DATA_SET_COLUMNS]
        columns, metadata = files.decode_parquet(
            files.read_bytes(path, 8 * files.MAX_NUMBERS), path, DATA_SET_FORMAT, DATA_SET_VERSION, remedy, names
        )
        try:
            for name, _, dtype, _, ndim in DATA_SET_COLUMNS:
                if columns[name].dtype != np.dtype(dtype) or columns[name].ndim != ndim:
                    raise ValueError(f"column {name!r} holds {columns[name].dtype}, not {dtype}")
            return cls(
                operating_points=np.column_stack([columns[name] for name in POINT_NAMES]),
                tunings=np.column_stack([columns[name] for name in ENTRIES]),
                library=np.array(metadata.pop("library"), dtype=np.float64),
                provenance=metadata,
                **{name: columns[_COLUMN.get(name, name)] for name in cls.ROW_FIELDS[2:]},
            )
        except (AttributeError, KeyError, ValueError, TypeError, OverflowError) as error:
            raise files.Damaged(f"{os.fspath(path)}: damaged, or edited by another program: {error}.") from error


def _read_only(array: Array) -> Array:
    view = array.view()
    view.flags.writeable = False
    return view


def list_datasets() -> list[str]:
    """The names of the data sets that ship with the package."""
    return list_data("datasets", ".parquet")


@checked
def load_dataset(name_or_path: str | os.PathLike[str]) -> DataSet:
    """A data set by name, from its file, or from the folder of a finished campaign.

    Raises
    ------
    UnknownName
        When none has this name.
    StorageError
        When the file cannot be read, is damaged, no data set or of another format version, or when the folder holds no
        finished campaign.
    """
    if not os.path.exists(name_or_path) or name_or_path in list_datasets():
        return DataSet.load(find_data("datasets", name_or_path, ".parquet"))
    path = Path(name_or_path)
    if path.is_dir():
        path = path / "dataset.parquet"
        if not path.exists():
            raise StorageError(
                f"{path.parent}: holds no {path.name}; if its campaign is not finished, run the campaign again."
            )
    return DataSet.load(path)


# -- summary ----------------------------------------------------------------------------------------------------------
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
                "unit": column.unit or "-",
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
            {"within": within, "mean": strict(share.mean() if share.size else np.nan), **_quantiles(share)}
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
        "standard_over_best_geomean": strict(portable.exp(portable.log(gain).mean()) if gain.size else np.nan),
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
