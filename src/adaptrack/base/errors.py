"""Error classes of the package. Each message says what is wrong, where, and what to do about it."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LONGEST_SHOWN = 80
"""Largest number of characters of a value in a message."""


class AdaptrackError(Exception):
    """Base class of all errors that adaptrack raises on purpose."""


class InvalidInput(AdaptrackError, ValueError):
    """A number, an array or an option that the called function cannot accept."""


class ConfigError(InvalidInput):
    """A configuration file that cannot be used: the message names the file, the key and the remedy."""


class UnknownName(InvalidInput, KeyError):
    """A name that is not registered; the message gives the most similar registered name, or all of them."""

    def __str__(self) -> str:  # KeyError would show the message in quotes
        return str(self.args[0])


class ContractError(AdaptrackError):
    """A plug-in (plant, QP solver, scheduler) that violates the contract of its kind, see `check_plant` and others."""


class MissingExtra(AdaptrackError, ImportError):
    """An optional dependency that is not installed; the message gives the command that installs it."""


class StorageError(AdaptrackError, OSError):
    """A file that cannot be read or written; a failed write leaves no partial file."""


def format_value(value: object) -> str:
    """Return the ``repr`` of any value for a message; a long one is cut in the middle."""
    try:
        text = repr(value)
    except Exception:  # raised by a foreign class, or by Python for an int with thousands of digits
        return f"<{type(value).__name__}>"
    if len(text) <= LONGEST_SHOWN:
        return text
    return f"{text[: LONGEST_SHOWN // 2 - 3]}...{text[-LONGEST_SHOWN // 2 :]}"  # the end of a path is informative


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Return the last sentence of an error message: the most similar known name, or the list of all names."""
    names = sorted(names)
    near = nearest(name, names)
    if near:
        return f"Did you mean {near!r}?"
    return "Known: " + ", ".join(repr(k) for k in names) + "."


def nearest(name: str, names: Iterable[str]) -> str | None:
    """Return the known name that is most similar to `name`, ignoring case, or None if none is similar."""
    names_by_folded_case = {candidate.casefold(): candidate for candidate in names}
    near = difflib.get_close_matches(name.casefold(), names_by_folded_case, n=1, cutoff=0.6)
    return names_by_folded_case[near[0]] if near else None
