"""Results of a study as JSON files, each with the identity of what it was computed from."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

from adaptrack import __version__
from adaptrack.base.errors import InvalidInput, StorageError
from adaptrack.base.files import write_atomically
from adaptrack.core.library import kernels_hash

FORMAT = "adaptrack-stage"


def identity_of(stage: str, settings: Any) -> str:
    """SHA-256 of a stage's name, its settings (plain JSON) and the software."""
    libraries = {name: version(name) for name in ("numpy", "scikit-learn")}
    software = {"adaptrack": __version__, "kernels": kernels_hash(), **libraries}
    return hashlib.sha256(json.dumps([stage, settings, software], sort_keys=True).encode()).hexdigest()


@dataclass(frozen=True, eq=False)
class JSONFile:
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
