"""The record of tuned operating points, its file, and the data sets that ship with the package."""

from __future__ import annotations

import os
import shlex
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from adaptrack.base.checked import checked
from adaptrack.base.errors import InvalidInput, StorageError, UnknownName, did_you_mean
from adaptrack.base.files import SHIPPED, Damaged, read_bytes, safe_name, write_atomically
from adaptrack.base.shown import figure_of, html_of
from adaptrack.paper.operating_points import NAMES, check_operating_points, fold
from adaptrack.paper.store import COLUMNS, DATA_SET, Columns, decode, encode, unfinished

Array = NDArray[Any]

_DATA = SHIPPED / "datasets"
_TUNING = ("Np", "Nc", "Q", "R")
_MORE = ("evaluations", "control_steps", "stream", "mirrored_from", "seed")


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
        whole, wide = dict.fromkeys(_MORE, "int64"), {"traces": None, "landscape": len(library)}
        for each in fields(self):
            if each.name == "provenance":
                continue
            value = rows if each.name == "operating_points" else getattr(self, each.name)
            kind = "float32" if each.name in wide else whole.get(each.name, "float64")
            array = np.ascontiguousarray(value, dtype=kind).view()
            shape: tuple[int | None, ...] = (n,)
            if each.name == "library":
                shape = library.shape
            elif each.name in ("operating_points", "tunings"):
                shape = (n, 4)
            elif each.name in wide:
                shape = (n, wide[each.name])
            if len(shape) != array.ndim or any(a not in (b, None) for a, b in zip(shape, array.shape, strict=True)):
                raise InvalidInput(f"data set: `{each.name}` must have the shape {shape}, it has {array.shape}.")
            array.flags.writeable = False
            object.__setattr__(self, each.name, array)

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
        """What its campaign was called."""
        return str(self.provenance.get("name", "unnamed"))

    @property
    def command(self) -> str:
        """The command that makes it again (with the campaign's own file, unless that ships with the package)."""
        name = safe_name(self.name)
        ships = name in {path.stem for path in _DATA.with_name("campaigns").glob("*.toml")}
        return shlex.join(["adaptrack", "tune", "--config", name if ships else f"{name}.toml", "--out", name])

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

    def rows(self, which: ArrayLike) -> Self:
        """A part of it: row numbers, or a truth value for each row."""
        chosen = np.arange(len(self))[np.asarray(which)]
        names = [each.name for each in fields(self) if each.name not in ("library", "provenance")]
        return replace(self, **{name: getattr(self, name)[chosen] for name in names})

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
        held = np.isin(family, np.random.default_rng(seed).permutation(families)[:out])
        return self.rows(~held), self.rows(held)

    def columns(self) -> Columns:
        """The arrays by the names that they have in a file."""
        columns = dict(zip(NAMES, self.operating_points.T, strict=True)) | dict(
            zip(_TUNING, self.tunings.T, strict=True)
        )
        columns |= {name: getattr(self, name) for name in _MORE}
        columns |= {"r_over_q": self.ratios, "cost": self.costs, "standard_cost": self.standard_costs}
        columns |= {"trace": self.traces, "landscape": self.landscape}
        return {column.name: columns[column.name] for column in COLUMNS}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write it as one Parquet file, which appears whole or not at all.

        Raises
        ------
        StorageError
            When that fails; an older file at `path` is then untouched.
        """
        about = {**self.provenance, "library": self.library.tolist()}
        write_atomically(path, encode(DATA_SET, self.columns(), about))

    @classmethod
    @checked
    def load(cls, path: str | os.PathLike[str]) -> Self:
        """Read what `save` or a campaign wrote, bit for bit.

        Raises
        ------
        StorageError
            When the file is missing, damaged, no data set, or of another format version; the message says which.
        """
        columns, about = decode(read_bytes(path), path, DATA_SET)
        try:
            library = np.array(about.pop("library"), dtype=np.float64)
            return cls(
                operating_points=np.column_stack([columns[name] for name in NAMES]),
                tunings=np.column_stack([columns[name] for name in _TUNING]),
                costs=columns["cost"],
                standard_costs=columns["standard_cost"],
                traces=columns["trace"],
                landscape=columns["landscape"],
                library=library,
                provenance=about,
                **{name: columns[name] for name in _MORE},
            )
        except (KeyError, ValueError, TypeError, OverflowError) as error:
            raise Damaged(f"{os.fspath(path)}: damaged, or edited by another program: {error}.") from error


def list_datasets() -> list[str]:
    """The names of the data sets that ship with the package."""
    return sorted(path.stem for path in _DATA.glob("*.parquet"))


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
    path = Path(name_or_path)
    if isinstance(name_or_path, str) and name_or_path in list_datasets():
        return DataSet.load(_DATA / f"{name_or_path}.parquet")
    if os.path.isdir(path):
        if not (path / "dataset.parquet").exists():
            raise StorageError(f"{path}: {unfinished(path)}")
        return DataSet.load(path / "dataset.parquet")
    if not (isinstance(name_or_path, os.PathLike) or path.suffix or path.name != str(name_or_path)):
        raise UnknownName(
            f"no data set is named {name_or_path!r}. {did_you_mean(str(name_or_path), list_datasets())} "
            "A file of your own is given by its path."
        )
    return DataSet.load(path)
