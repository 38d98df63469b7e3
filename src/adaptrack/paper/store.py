"""Files of a campaign: Parquet tables that prove their own content, and the folder that holds them.

Every file appears whole or not at all. Nothing in it depends on the time of day, on how many workers there were, or on
how often the work was interrupted.
"""

from __future__ import annotations

import contextlib
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import ConfigError, StorageError
from adaptrack.base.files import (
    Damaged,
    ParquetColumn,
    decode_parquet,
    encode_parquet,
    read_bytes,
    read_json,
    write_atomically,
    write_json,
)
from adaptrack.paper import operating_points

Columns = dict[str, NDArray[Any]]

FORMAT_VERSION = 1
"""Raised whenever a column or an entry is added, dropped, renamed or changes its unit."""

DATA_SET = "adaptrack data set"
CHUNK = "adaptrack campaign chunk"
"""What a Parquet file says that it is."""


class TunedColumn(NamedTuple):
    """One column of a table of tuned operating points."""

    name: str
    unit: str
    dtype: str
    meaning: str
    wide: bool = False
    """a list of numbers in each row, equally long in all"""


COLUMNS = (
    TunedColumn(
        "stream", "-", "int64", "number of the operating point; its random numbers depend on seed and stream only"
    ),
    *(TunedColumn(each.name, each.unit, "float64", each.meaning) for each in operating_points.COLUMNS),
    TunedColumn("Np", "-", "int64", "prediction horizon of the best tuning found, control periods"),
    TunedColumn("Nc", "-", "int64", "control horizon of the best tuning found, control periods"),
    TunedColumn("Q", "1/m^2", "float64", "weight of the tracking error of the best tuning found"),
    TunedColumn("R", "1/rad^2", "float64", "weight of the moves of the best tuning found"),
    TunedColumn("r_over_q", "m^2/rad^2", "float64", "R/Q, the only part of the two that changes the control law"),
    TunedColumn("cost", "m^2", "float64", "cost of the best tuning found; inf when the run failed with every one"),
    TunedColumn("standard_cost", "m^2", "float64", "cost of the paper's tuning, 35/8/10/0.01"),
    TunedColumn("evaluations", "-", "int64", "tunings that the swarm evaluated"),
    TunedColumn("control_steps", "-", "int64", "control periods that the swarm simulated"),
    TunedColumn("seed", "-", "int64", "of the swarm"),
    TunedColumn("mirrored_from", "-", "int64", "stream of the left-right twin that was computed instead; -1: none"),
    TunedColumn("trace", "m^2", "float32", "lowest cost up to and including each generation", wide=True),
    TunedColumn("landscape", "m^2", "float32", "cost of each tuning of the common library", wide=True),
)
"""The columns of chunks and of data sets, in the order of their files."""


# -- one file ---------------------------------------------------------------------------------------------------------
def encode(kind: str, columns: Columns, about: Mapping[str, Any]) -> bytes:
    """A Parquet file of the columns in `COLUMNS`, see `files.encode_parquet`."""
    stored = [
        ParquetColumn(each.name, each.unit, np.ascontiguousarray(columns[each.name], dtype=each.dtype), each.meaning)
        for each in COLUMNS
    ]
    return encode_parquet(kind, FORMAT_VERSION, stored, about)


def decode(content: bytes, where: str | os.PathLike[str], kind: str) -> tuple[Columns, dict[str, Any]]:
    """The columns of a file that `encode` made, and what it says of itself; `where` opens every message.

    Raises
    ------
    StorageError
        When it is something else, or of another format version.
    Damaged
        When it is torn or was edited.
    """
    remedy = "run its campaign again, or use the release that wrote it"
    columns, about = decode_parquet(content, where, kind, FORMAT_VERSION, remedy, [each.name for each in COLUMNS])
    for each in COLUMNS:
        values = columns[each.name]
        if values.dtype != np.dtype(each.dtype) or values.ndim != 1 + each.wide:
            raise Damaged(f"{os.fspath(where)}: damaged: column {each.name!r} holds {values.dtype}, not {each.dtype}.")
    if not isinstance(about, dict):
        raise Damaged(f"{os.fspath(where)}: damaged: what it says of itself is no table.")
    return columns, about


# -- the folder -------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class Folder:
    """The folder of one campaign, held by one process at a time.

    campaign.json: what the campaign is. chunks/: one file per finished chunk. dataset.parquet: the result, after
    which the chunks are gone. log.jsonl: who computed what and how long it took; it is the only file with times.
    """

    path: Path
    identity: str
    size: int
    """operating points per chunk"""
    chunks: int
    """how many there are in all"""
    computed: int
    """operating points in all chunks"""

    @property
    def dataset(self) -> Path:
        """The file that a finished campaign leaves."""
        return self.path / "dataset.parquet"

    @property
    def _parts(self) -> Path:
        return self.path / "chunks"

    def chunk(self, number: int) -> Path:
        """The file of one chunk."""
        return self._parts / f"{number:05d}.parquet"

    @classmethod
    @contextlib.contextmanager
    def opened(cls, path: str | os.PathLike[str], manifest: Mapping[str, Any], resume: bool) -> Iterator[Self]:
        """Take possession of a folder: a new or an empty one, or (`resume`) one of the same campaign.

        manifest: identity, versions, settings, chunk (operating points per chunk), chunks. A campaign under way keeps
        its own chunk size.

        Raises
        ------
        StorageError
            When the folder cannot be written to, holds something else, another campaign, or this one by other
            software, when another process works in it, or when it would have to be resumed.
        """
        path = Path(path)
        try:
            path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise StorageError(f"{path}: cannot be made a folder: {error.strerror or error}.") from error
        with _lock(path):
            known = path / "campaign.json"
            if known.exists():
                there = _read_manifest(known)
                _compare(path, manifest, there)
            else:
                others = sorted(each.name for each in path.iterdir() if not each.name.startswith("."))
                if others:
                    names = ", ".join([*others[:3], "..."] if len(others) > 3 else others)
                    raise StorageError(
                        f"{path}: holds other files ({names}) and no campaign: choose a new or an empty folder."
                    )
                there = dict(manifest)
                write_json(known, there)
                resume = True
            folder = cls(path, there["identity"], there["chunk"], there["chunks"], there["computed"])
            if not resume:
                raise StorageError(
                    f"{path}: holds this campaign already ({folder.state()}): continue it with --resume "
                    "(resume=True), or choose another folder."
                )
            try:
                folder._parts.mkdir(exist_ok=True)
                for torn in [*path.glob(".*.tmp"), *folder._parts.glob(".*.tmp")]:  # of a process that was killed
                    torn.unlink()
            except OSError as error:
                raise StorageError(f"{path}: cannot be written to: {error.strerror or error}.") from error
            yield folder

    def state(self) -> str:
        """How far the campaign is, in words."""
        if self.dataset.exists():
            return "finished"
        return f"{len(list(self._parts.glob('[0-9]*.parquet')))} of {self.chunks} chunks"

    def has_dataset(self) -> bool:
        """Whether the result is there, whole; a damaged one is not.

        Raises
        ------
        StorageError
            When it is another campaign's.
        """
        return self._verified(self.dataset, DATA_SET) is not None

    def read_chunk(self, number: int) -> Columns | None:
        """A finished chunk; None when it is missing or damaged and must be computed.

        Raises
        ------
        StorageError
            When the file belongs to another campaign, or to another chunk of this one.
        """
        found = self._verified(self.chunk(number), CHUNK)
        if found is None:
            return None
        columns, about = found
        if about.get("chunk") != number:
            raise StorageError(f"{self.chunk(number)}: is chunk {about.get('chunk')} under another name: remove it.")
        rows = min(self.size, self.computed - number * self.size)
        if len(columns["stream"]) != rows:  # its size was changed in campaign.json
            self.note(damaged=f"{self.chunk(number)}: {len(columns['stream'])} operating points, not {rows}.")
            return None
        return columns

    def _verified(self, file: Path, kind: str) -> tuple[Columns, dict[str, Any]] | None:
        """What a file of this folder holds; None when it is missing or is no such file, and must be made again."""
        if not file.exists():
            return None
        content = read_bytes(file)
        try:
            columns, about = decode(content, file, kind)
        except StorageError as reason:  # torn, or something else under our name: a flipped bit may make it so
            self.note(damaged=str(reason))
            return None
        if about.get("identity") != self.identity:
            raise StorageError(
                f"{file}: belongs to another campaign ({about.get('name', 'unknown')!r}, other settings): remove it."
            )
        return columns, about

    def write_chunk(self, number: int, columns: Columns, about: Mapping[str, Any]) -> None:
        """Keep a finished chunk.

        Raises
        ------
        StorageError
            When the file cannot be written; nothing half-written is left.
        """
        content = encode(CHUNK, columns, {**about, "identity": self.identity, "chunk": number})
        write_atomically(self.chunk(number), content, through_links=False)

    def write_dataset(self, columns: Columns, about: Mapping[str, Any]) -> None:
        """Keep the result, then drop the chunks.

        Raises
        ------
        StorageError
            When the file cannot be written; the chunks are then still there.
        """
        content = encode(DATA_SET, columns, {**about, "identity": self.identity})
        write_atomically(self.dataset, content, through_links=False)
        self.drop_chunks()

    def drop_chunks(self) -> None:
        """Remove the chunks, which the result has made superfluous."""
        with contextlib.suppress(OSError):  # no harm in what remains: the next `resume` tries again
            for file in self._parts.glob("[0-9]*.parquet"):
                file.unlink()
            self._parts.rmdir()

    def note(self, **entry: Any) -> None:
        """Append a line to log.jsonl; a full disk does not matter here."""
        with contextlib.suppress(OSError), open(self.path / "log.jsonl", "a", encoding="utf-8") as log:
            log.write(json.dumps(entry) + "\n")


def unfinished(path: Path) -> str:
    """What a folder without a result holds, in a sentence."""
    try:
        manifest = _read_manifest(path / "campaign.json")
    except StorageError:
        return "a folder, but not of a campaign: there is no dataset.parquet in it."
    folder = Folder(path, manifest["identity"], manifest["chunk"], manifest["chunks"], manifest["computed"])
    return f"its campaign is not finished ({folder.state()}): go on with `adaptrack campaign ... --resume`."


_MANIFEST = {
    "format_version": int, "identity": str, "computed": int, "chunks": int, "chunk": int, "versions": dict,
    "settings": dict,
}  # fmt: skip


def _read_manifest(path: Path) -> dict[str, Any]:
    """What campaign.json says; `StorageError` unless every entry is there and can be what it says."""
    try:
        manifest = read_json(path)
    except ConfigError as error:
        raise StorageError(f"{path}: not a campaign's, or damaged: {_ANOTHER}. {error}") from error
    if not isinstance(manifest, dict):
        raise StorageError(f"{path}: not a campaign's, or damaged: it holds no table: {_ANOTHER}.")
    for key, kind in _MANIFEST.items():
        value = manifest.get(key)
        if not isinstance(value, kind) or isinstance(value, bool) or (isinstance(value, int) and value < 1):
            found = "is missing" if key not in manifest else f"is {_short(value)}"
            raise StorageError(f"{path}: not a campaign's, or damaged: {key!r} {found}: {_ANOTHER}.")
    if manifest["chunks"] != -(-manifest["computed"] // manifest["chunk"]):
        raise StorageError(f"{path}: not a campaign's, or damaged: its chunks do not add up: {_ANOTHER}.")
    return manifest


_ANOTHER = "choose another folder, or empty this one"


def _compare(path: Path, ours: Mapping[str, Any], theirs: Mapping[str, Any]) -> None:
    """Refuse a folder whose data would not be ours, and say why."""
    if theirs["format_version"] != ours["format_version"]:
        raise StorageError(
            f"{path}: begun in format version {theirs['format_version']}, this adaptrack writes version "
            f"{ours['format_version']}: choose another folder, or use the release that began it."
        )
    software = _differences(ours["versions"], theirs["versions"])
    if software:
        raise StorageError(
            f"{path}: begun by other software, whose numbers may differ in their last digits ({'; '.join(software)}): "
            "choose another folder, or go on with that software."
        )
    if theirs["identity"] != ours["identity"] or theirs["computed"] != ours["computed"]:
        what = _differences(ours["settings"], theirs["settings"]) or ["its operating points or its library differ"]
        more = f"; and {len(what) - 5} more" if len(what) > 5 else ""
        raise StorageError(f"{path}: belongs to another campaign ({'; '.join(what[:5])}{more}): choose another folder.")


def _differences(ours: Any, theirs: Any, key: str = "") -> list[str]:
    """The keys at which two trees of settings differ, each with both values."""
    if isinstance(ours, Mapping) and isinstance(theirs, Mapping):
        return [
            sentence
            for name in sorted({*ours, *theirs})
            for sentence in _differences(ours.get(name), theirs.get(name), f"{key}.{name}" if key else name)
        ]
    return [] if ours == theirs else [f"{key} = {_short(theirs)} there, {_short(ours)} here"]


def _short(value: Any) -> str:
    text = json.dumps(value)
    return text if len(text) <= 60 else text[:57] + "..."


@contextlib.contextmanager
def _lock(path: Path) -> Iterator[None]:
    """Hold a folder for this process; the system lets go of it when the process dies, however it dies."""
    try:
        import fcntl
    except ImportError:  # no such locks on this system
        yield
        return
    try:
        handle = open(path / ".lock", "a")  # noqa: SIM115 (it stays open)
    except OSError as error:
        raise StorageError(f"{path}: cannot be written to: {error.strerror or error}.") from error
    with handle:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise StorageError(f"{path}: another process is at work in it: wait for it, or stop it.") from None
        except OSError:  # a file system without locks
            pass
        yield
