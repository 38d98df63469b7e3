"""What a command has finished and kept so far: what a user reads after Ctrl-C."""

from __future__ import annotations

_kept = ""


def kept(text: str) -> None:
    """From now on Ctrl-C answers with this: what is finished and kept, and how to go on."""
    global _kept
    _kept = text


def what_is_kept() -> str:
    """The sentence for Ctrl-C."""
    return _kept
