"""The file of a scheduler: its content as JSON, with a format, a version and a checksum."""

from __future__ import annotations

import hashlib
import json
import os
from pathlib import Path
from typing import Any

from adaptrack.base.errors import StorageError
from adaptrack.base.files import write_atomically

SCHEDULER_FORMAT, VERSION = "adaptrack-scheduler", 2


def write_document(path: str | os.PathLike[str], content: dict[str, Any]) -> None:
    """Write a content, all of it or nothing.

    Raises
    ------
    TypeError, ValueError
        When it holds what JSON cannot.
    StorageError
        When the file cannot be written; an older one at `path` is then untouched.
    """
    text = json.dumps(content, allow_nan=False, separators=(",", ":"))
    file = {
        "format": SCHEDULER_FORMAT,
        "version": VERSION,
        "sha256": hashlib.sha256(text.encode()).hexdigest(),
        "content": content,
    }
    write_atomically(path, (json.dumps(file, separators=(",", ":")) + "\n").encode())


def read_document(path: Path) -> Any:
    """The content of a scheduler's file, its checksum compared.

    Raises
    ------
    StorageError
        When the file cannot be read, is damaged, is no scheduler, or has a version that this program cannot read.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # not UTF-8, or a path that cannot be
        raise StorageError(f"{path}: cannot be read: {error}.") from None
    try:
        file = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise StorageError(f"{path}: not a scheduler file, or damaged: {error}. Train or copy it again.") from None
    if not isinstance(file, dict) or file.get("format") != SCHEDULER_FORMAT:
        raise StorageError(f"{path}: not a scheduler file: its format is not {SCHEDULER_FORMAT!r}.")
    if file.get("version") != VERSION:
        raise StorageError(
            f"{path}: version {file.get('version')!r} of the scheduler format; this program reads {VERSION}. "
            "Train it again, or use the version of adaptrack that wrote it."
        )
    content = file.get("content")
    try:
        digest = hashlib.sha256(json.dumps(content, separators=(",", ":")).encode()).hexdigest()
    except RecursionError:
        raise StorageError(f"{path}: not a scheduler file: its content is nested too deeply.") from None
    if digest != file.get("sha256"):
        raise StorageError(f"{path}: damaged: its content does not match its checksum. Train or copy it again.")
    return content
