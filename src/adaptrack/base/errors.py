"""One tree of errors. Each message says what is wrong, where, and what to do about it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LONGEST_SHOWN = 80
"""Characters of a value in a message."""


class AdaptrackError(Exception):
    """Everything that adaptrack raises on purpose."""


class InvalidInput(AdaptrackError, ValueError):
    """A number, an array or an option that the called function cannot accept."""


class ConfigError(InvalidInput):
    """A configuration file that cannot be used: the message names the file, the key and the remedy."""


class UnknownName(InvalidInput, KeyError):
    """A name that no registry knows; the message lists the known ones and the nearest."""

    def __str__(self) -> str:  # KeyError would show the message in quotes
        return str(self.args[0])


class ContractError(AdaptrackError):
    """A plug-in (plant, QP solver, scheduler) that breaks the contract its checker tests."""


class MissingExtra(AdaptrackError, ImportError):
    """An optional dependency that is not installed; the message gives the command that installs it."""


class StorageError(AdaptrackError, OSError):
    """A file that cannot be read or written; nothing half-written is left behind."""


def format_value(value: object) -> str:
    """A value in a message: its ``repr``, of a long one the beginning and the end, whatever the value is."""
    try:
        text = repr(value)
    except Exception:  # of an object of others; Python refuses whole numbers of thousands of digits
        return f"<{type(value).__name__}>"
    if len(text) <= LONGEST_SHOWN:
        return text
    return f"{text[: LONGEST_SHOWN // 2 - 3]}...{text[-LONGEST_SHOWN // 2 :]}"  # a path ends with what matters


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """A sentence that names the nearest known name, or lists them all: the end of an error message."""
    names = sorted(names)
    near = nearest(name, names)
    if near:
        return f"Did you mean {near!r}?"
    return "Known: " + ", ".join(repr(k) for k in names) + "."


def nearest(name: str, names: Iterable[str]) -> str | None:
    """The known name that is most like `name`, whatever its capitals; None where none is like it."""
    by_letters = {candidate.casefold(): candidate for candidate in names}
    near = difflib.get_close_matches(name.casefold(), by_letters, n=1, cutoff=0.6)
    return by_letters[near[0]] if near else None
