"""Pipelines: named stages, each with the identity of its result, its file and its maker.

A result whose file is there and has the identity of the stage is read, not made again; so a study that was interrupted
goes on with the first stage that is missing, and one whose method or software changed makes everything again.
"""

from __future__ import annotations

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

from adaptrack import __version__
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.files import write_atomically
from adaptrack.control.scheduling import Schedule, load_scheduler
from adaptrack.core.library import kernels_hash

Progress = Callable[[str, int, int], None]
"""Called with what is being done, and how many steps of how many are."""

FORMAT = "adaptrack-stage"


class Keeper(ABC):
    """How the result of a stage is kept."""

    @abstractmethod
    def load(self, identity: str) -> Any | None:
        """The result, or None when there is none of this identity.

        Raises
        ------
        StorageError
            When there is a file that cannot be read.
        """

    @abstractmethod
    def save(self, result: Any, identity: str) -> None:
        """Keep a result; raises StorageError when that fails."""


@dataclass(frozen=True, eq=False)
class Stage:
    """One step of a study."""

    name: str
    identity: str
    """SHA-256 of all that the result depends on, see `identity_of`"""
    make: Callable[[Mapping[str, Any]], Any]
    """from the results of the stages before"""
    keeper: Keeper | None = None
    """None: the result is made in every session"""


def run(stages: Sequence[Stage], progress: Progress | None = None) -> dict[str, Any]:
    """The result of every stage, by name.

    What was made is read back from its file, so that a study that was interrupted ends like one that was not.
    """
    made: dict[str, Any] = {}
    for stage in stages:
        result = None if stage.keeper is None else stage.keeper.load(stage.identity)
        if result is None:
            if progress is not None:
                progress(stage.name, 0, 1)
            result = stage.make(made)
            if stage.keeper is not None:
                stage.keeper.save(result, stage.identity)
                result = stage.keeper.load(stage.identity)
        made[stage.name] = result
    return made


def software() -> dict[str, str]:
    """Versions of everything that has a say in the numbers; the kernels by the hash of what they compile."""
    return {
        "adaptrack": __version__,
        "kernels": kernel_hash(),
        **{name: version(name) for name in ("numpy", "scikit-learn")},
    }


def kernel_hash() -> str:
    """The hash of the kernels that drive runs."""
    return kernels_hash()


def identity_of(stage: str, settings: Any) -> str:
    """SHA-256 of a stage's name, its settings (plain JSON) and the software."""
    text = json.dumps([stage, settings, software()], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


# -- keepers ----------------------------------------------------------------------------------------------------------
@dataclass(frozen=True, eq=False)
class SchedulerFile(Keeper):
    """A schedule as a file of its own, with its identity and what it was made with in its provenance."""

    path: Path
    record: Mapping[str, Any]
    """what it was made with: plain JSON"""
    made_for: Mapping[str, Any] = field(default_factory=dict)
    """see `Schedule.made_for`"""

    def load(self, identity: str) -> Schedule | None:
        if not self.path.exists():
            return None
        schedule = load_scheduler(self.path)
        return schedule if schedule.provenance.get("stage") == identity else None

    def save(self, result: Schedule, identity: str) -> None:
        _make_folder(self.path.parent)
        provenance = {**result.provenance, "stage": identity, **self.record}
        replace(result, provenance=provenance, made_for=self.made_for).save(self.path)


@dataclass(frozen=True, eq=False)
class JSONFile(Keeper):
    """A result as plain JSON."""

    path: Path
    encode: Callable[[Any], Any] = lambda result: result
    decode: Callable[[Any], Any] = lambda content: content

    def load(self, identity: str) -> Any | None:
        if not self.path.exists():
            return None
        try:
            file = json.loads(self.path.read_text(encoding="utf-8"))
            if file["format"] != FORMAT:
                raise ValueError(f"its format is not {FORMAT!r}")
            return self.decode(file["result"]) if file["identity"] == identity else None
        except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise StorageError(f"{self.path}: not a stage's file, or damaged: {error}. Remove it to go on.") from None

    def save(self, result: Any, identity: str) -> None:
        _make_folder(self.path.parent)
        try:
            file = {"format": FORMAT, "identity": identity, "result": self.encode(result)}
            text = json.dumps(file, allow_nan=False)
        except (TypeError, ValueError) as error:
            raise InvalidInput(f"{self.path}: the result is no plain JSON: {error}.") from None
        write_atomically(self.path, (text + "\n").encode())


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(f"{path}: cannot be made: {error.strerror or error}.") from error
