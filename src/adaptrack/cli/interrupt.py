"""The note that Ctrl-C prints: the results that a command has already written."""

from __future__ import annotations

_note = ""


def note_progress(text: str) -> None:
    """Set the note that Ctrl-C prints: the results that are already written, and how to continue."""
    global _note
    _note = text


def progress_note() -> str:
    """Return the note that Ctrl-C prints."""
    return _note
