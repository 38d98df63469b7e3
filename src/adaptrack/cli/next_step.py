"""Last line of a command's output: the suggested next command, from the table `NEXT_STEPS`."""

from __future__ import annotations

import dataclasses
import re
import shlex
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from adaptrack.cli import show
from adaptrack.cli.options import command_line

if TYPE_CHECKING:
    from adaptrack.base.result import Result


NEXT_STEPS: dict[str, Sequence[tuple[str, str, str]]] = {
    "car": [
        ("is_unsaved", "keep the car", "again --out my-car.toml"),
        ("is_estimated", "learn the estimated values while driving", "adaptrack drive country --vehicle {car} --learn"),
        ("", "drive it", "adaptrack drive country --vehicle {car}"),
    ],
    "certify": [
        ("is_unstable", "find the speeds and frictions with a stable tuning", "adaptrack certify --feasible {loop}"),
        ("has_one_car", "certify cars that differ from their model", "again --mismatch"),
        ("has_no_page", "see the margins on a page", "again --out certificate"),
        ("", "drive it", "adaptrack drive general-trajectory {car} --profile {profile} {schedule} {controller}"),
    ],
    "check-loop": [("vehicle", "identify the car", "adaptrack identify {log} --car {vehicle} {columns}")],
    "compare": [
        ("has_drivers", "drive with the speed control", "adaptrack drive {drive} --profile {profile} --speed-control"),
        ("is_tuned", "tune it for a road",
         "adaptrack tune {tune} --controller {best} --profile {profile} {plugins} --out tuned"),
        ("", "drive it", "adaptrack drive {drive} --controller {best} --profile {profile}"),
    ],
    "compare --lane-change": [("", "drive a road", "adaptrack drive country --vehicle {car}")],
    "drive": [
        ("is_blocked", "see the places that cannot be driven",
         "adaptrack road check {road} --vehicle {vehicle} {route}"),
        ("is_off_lane", "drive more slowly to stay in the lane", "again {slower}"),
        ("has_no_page", "see the drive on a page", "again --out drive"),
        ("is_scenario", "drive a road", "adaptrack drive country {car}"),
        ("scheduler", "certify the scheduler", "adaptrack certify {scheduler} {car} {profile}"),
        ("has_tuning", "test the tuning with different noise",
         "adaptrack compare {test_road} --vehicle {vehicle}/{plant} --tuning {tuning} {loop}"),
        ("is_tunable", "tune the {best} controller for this road",
         "adaptrack tune {vehicle} --road {test_road} --plant {plant} --controller {best} {loop} --out tuned"),
        ("", "drive with a different seed of the noise", "again --seed {seed}"),
    ],
    "export c": [("", "verify that it matches Python", "make -C {folder} check")],
    "export page": [("", "open the page in a browser to drive", "{page}")],
    "identify": [
        ("has_hidden_contradictions", "see the contradictions on a page", "again --page identified.html"),
        ("is_implausible", "find signals that contradict each other", "adaptrack check-loop {log} {car} {columns}"),
        ("is_refused", "write the car anyway", "again --out {file} --anyway"),
        ("is_unsaved", "keep the car", "again --out {file}"),
        ("", "drive it", "adaptrack drive country --vehicle {file}"),
    ],
    "identify --longitudinal": [
        ("is_unsaved", "keep the car", "again --out my-car.toml"),
        ("", "drive it", "adaptrack drive country --vehicle {file} --speed-control"),
    ],
    "list": [("name", "use one", "adaptrack {command} {name} {plugins}")],
    "paper adapt": [("", "evaluate the schedules on new runs",
                     "adaptrack paper evaluate {folder} --campaign {campaign} {profile}")],
    "paper campaign": [("", "train a schedule on this data set",
                        "adaptrack paper train --data {data} --model nn --out nn.json")],
    "paper evaluate": [("has_no_drives", "evaluate the schedules on long drives", "again --drives 200")],
    "paper reproduce": [
        ("quick", "train as long as the paper", "again ~--quick --out {out}-whole"),
        ("", "drive a road", "adaptrack drive country --out drive"),
    ],
    "paper train": [("", "certify the schedule", "adaptrack certify {schedule} {purpose}")],
    "road check": [
        ("is_drivable", "drive it", "adaptrack drive {road}"),
        ("is_too_fast", "check it at lower speed", "again {slower}"),
        ("", "see the places that cannot be driven", "adaptrack road plot {road}"),
    ],
    "road plot": [("", "drive it", "adaptrack drive {road}")],
    "shadow": [
        ("is_spoiled", "leave out the contradictory signals", "again --without {without}"),
        ("has_no_page", "see the estimates over time", "again --out shadow"),
        ("is_plausible", "keep the car", "adaptrack identify {identify} --out my-car.toml"),
        ("", "identify the car from the log", "adaptrack identify {identify}"),
    ],
    "tune": [("", "drive with the tuning", "adaptrack drive {drive} --tuning {tuning}")],
}  # fmt: skip
"""Suggestions after each command: condition, phrase, command line. The first one applies whose condition is true.

A condition is the name of a fact; an empty one is always true. A phrase is a verb with its object. In a command line,
``{name}`` stands for the words of a fact, and ``again`` for the current command line, to which options are added or in
which they get a new value; ``~FLAG`` leaves out a flag.
"""


def next_line(after: str, **facts: Any) -> str:
    """Return the line that suggests the next command; empty if no suggestion applies.

    after: command in `NEXT_STEPS`; facts: conditions, and words of command lines: a word, several, or None for none.
    """
    for condition, phrase, line in NEXT_STEPS[after]:
        if not condition or facts[condition]:
            words = [word for part in line.split() for word in _fill_in(part, facts)]
            if words[0] == "again":
                words = repeat_command(words[1:])
            return f"Next: {phrase.format(**facts)}: {shlex.join(words)}"
    return ""


def _fill_in(part: str, facts: dict[str, Any]) -> list[str]:
    """Return a part of a command line with facts in place of their names, as words."""
    name = re.fullmatch(r"\{(\w+)\}", part)
    value = part.format(**facts) if name is None else facts[name[1]]
    return [] if value is None else list(map(str, value)) if isinstance(value, list | tuple) else [str(value)]


def repeat_command(words: Sequence[str]) -> list[str]:
    """Return the words of the current command line with these options; ``~FLAG`` leaves out a flag."""
    line = ["adaptrack", *sys.argv[1:]]
    for word, value in zip(words, [*words[1:], "--"], strict=True):
        if word.startswith("~"):
            line = [entry for entry in line if entry != word[1:]]
        elif not word.startswith("--"):
            continue  # the value of the option before it
        elif value.startswith(("--", "~")):
            line.append(word)
        elif word in line[:-1]:
            line[line.index(word) + 1] = value
        else:
            line += [word, value]
    return line


def say_next(after: str, **facts: Any) -> None:
    """Print the line that suggests the next command, if there is one; arguments as for `next_line`."""
    if line := next_line(after, **facts):
        show.say(line)


def add_command(result: Result, after: str, **facts: Any) -> Result:
    """Return a result with the current command line and the suggested next command, see `next_line`."""
    return dataclasses.replace(result, command=command_line(), next_step=next_line(after, **facts))


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
