"""The last line that a command prints: what to do next, with the command that does it."""

from __future__ import annotations

import shlex
import sys

from adaptrack.cli import show


def next_line(why: str, line: str) -> str:
    """Format the next command with its reason."""
    return f"Next, {why}: {line}"


def say_next(why: str, line: str) -> None:
    """Say what to do next."""
    show.say(next_line(why, line))


def command(*words: object) -> str:
    """A command line of adaptrack; words that are None are left out."""
    return shlex.join(["adaptrack", *(str(word) for word in words if word is not None)])


def repeat_command_with(*words: object) -> str:
    """The command line at hand with more words."""
    return command(*sys.argv[1:], *words)


def replace_option(name: str, value: object) -> str:
    """The command line at hand with this value of an option, in place of the one that it has."""
    words = sys.argv[1:]
    if name in words[:-1]:
        words[words.index(name) + 1] = str(value)
        return command(*words)
    return repeat_command_with(name, value)
