"""Last line of a command's output: the suggested next command with its reason."""

from __future__ import annotations

import dataclasses
import re
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from adaptrack.cli import show
from adaptrack.cli.options import command_line, option_names

if TYPE_CHECKING:
    from adaptrack.base.result import Result


def next_line(why: str, line: str) -> str:
    """Format the next command with its reason."""
    return f"Next, {why}: {line}"


def say_next(why: str, line: str) -> None:
    """Print the next command with its reason."""
    show.say(next_line(why, line))


def add_command(result: Result, next_step: tuple[str, str] | None = None) -> Result:
    """Return a result with the current command line and the next command, from its reason and its command line."""
    return dataclasses.replace(result, command=command_line(), next_step=next_line(*next_step) if next_step else "")


def choose_step(*proposals: tuple[object, str, str]) -> tuple[str, str]:
    """Return reason and command of the first proposal whose condition, its first element, is true."""
    return next((why, line) for condition, why, line in proposals if condition)


def command(*words: object) -> str:
    """Return a command line of adaptrack; None words are left out."""
    return shlex.join(["adaptrack", *(str(word) for word in words if word is not None)])


def repeat_command_with(*words: object) -> str:
    """Return the current command line with additional words."""
    return command(*sys.argv[1:], *words)


def replace_option(name: str, value: object, without: Sequence[str] = ()) -> str:
    """Return the current command line with a new value of an option, and without some flags."""
    words = [word for word in sys.argv[1:] if word not in without]
    if name in words[:-1]:
        words[words.index(name) + 1] = str(value)
        return command(*words)
    return command(*words, name, value)


def option_words(group: Any, *names: str) -> list[str]:
    """Return the options of a group that differ from their defaults, as words of a command line.

    names: fields of these options; all if there are none.
    """
    words = list[str]()
    for field in dataclasses.fields(group):
        value = getattr(group, field.name)
        if dataclasses.is_dataclass(value):
            words += option_words(value, *names)
        elif (
            value not in (None, field.default)
            and option_names(field.name, field)
            and (not names or field.name in names)
        ):
            on, _, off = option_names(field.name, field)[0].partition("/")
            if isinstance(value, bool):
                words.append(on if value else off)
            elif isinstance(value, list):
                words += [word for entry in value for word in (on, str(entry))]
            else:
                words += [on, *map(str, value if isinstance(value, tuple) else (value,))]
    return words


def drive_words(road: str, length: float | None = None) -> list[str]:
    """Return a road of `compare` and `tune`, such as ``country:3@6``, as arguments of `drive`.

    length: m, of generated roads, if it is not the default.
    """
    name, _, lateral = road.rpartition("@") if re.search(r"@[\d.]+$", road) else (road, "", "")
    kind, _, seed = name.partition(":") if re.search(r":\d+$", name) else (name, "", "")
    if kind == "random-drive":
        return ["country"]
    from adaptrack.road import ROAD_KINDS

    options = {"--road-seed": seed, "--lateral-acceleration": lateral, "--length": length if kind in ROAD_KINDS else ""}
    return [kind, *(str(word) for name, value in options.items() if value for word in (name, value))]
