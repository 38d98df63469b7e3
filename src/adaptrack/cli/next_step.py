"""Last line of a command's output: the suggested next command with its reason."""

from __future__ import annotations

import shlex
import sys

from adaptrack.cli import show


def next_line(why: str, line: str) -> str:
    """Format the next command with its reason."""
    return f"Next, {why}: {line}"


def say_next(why: str, line: str) -> None:
    """Print the next command with its reason."""
    show.say(next_line(why, line))


def command(*words: object) -> str:
    """Return a command line of adaptrack; None words are left out."""
    return shlex.join(["adaptrack", *(str(word) for word in words if word is not None)])


def repeat_command_with(*words: object) -> str:
    """Return the current command line with additional words."""
    return command(*sys.argv[1:], *words)


def replace_option(name: str, value: object) -> str:
    """Return the current command line with a new value of an option."""
    words = sys.argv[1:]
    if name in words[:-1]:
        words[words.index(name) + 1] = str(value)
        return command(*words)
    return repeat_command_with(name, value)
