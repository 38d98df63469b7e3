"""A command's first line is its answer, in the numbers of its result; its last is a command that runs."""

from __future__ import annotations

import json
import math
import re
import shlex
import sys
from functools import partial

import pytest
from tests.project.test_snippets import parse

from adaptrack.analysis.certify import certify
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.cli.car import car_answer
from adaptrack.cli.next_step import repeat_command
from adaptrack.results import words

pytestmark = pytest.mark.compiled


@pytest.fixture
def lines(run_command):
    """What a command prints, line by line; of `--json` the object."""

    def run(*arguments):
        out = run_command(*arguments)[1]
        return json.loads(out) if "--json" in arguments else out.splitlines()

    return run


def step(line):
    """The command of a last line, which must be one of this program."""
    assert line.startswith("Next: ")
    name, *words = shlex.split(line.split(": ", 2)[2])
    assert name == "adaptrack"
    parse(words)
    return words


DRIVE = ("drive", "town", "--length", "300", "--vehicle", "midsize-sedan")


def test_a_drive_begins_with_how_near_it_stayed_and_ends_with_its_page(lines, tmp_path):
    (row,) = lines(*DRIVE, "--json")["rows"]
    first, *_, last = lines(*DRIVE)
    rms = words.length(row["rms_error"])
    along = f"{row['speed_error']:.2g} m/s RMS speed error; {row['time_lost']:.2g} s late."
    assert first == f"{rms} RMS error, largest {words.length(row['max_abs_error'])}. {along}"
    assert step(last) == [*DRIVE, "--out", "drive"]
    *_, last = lines(*DRIVE, "--out", tmp_path)
    assert step(last)[:4] == ["tune", "midsize-sedan", "--road", "town"]


def test_the_best_of_several_controllers_is_named_first(lines):
    command = (*DRIVE, "--controller", "pure-pursuit", "--controller", "informed")
    rows = {row["controller"]: row for row in lines(*command, "--json")["rows"]}
    assert rows["informed"]["mse"] < rows["pure-pursuit"]["mse"]
    first = lines(*command)[0]
    assert first.startswith(f"informed: {words.length(rows['informed']['rms_error'])} RMS error, largest ")
    assert first.endswith("0 of 2 runs failed.")


def test_a_failed_drive_begins_with_its_failure_and_ends_with_what_to_look_at(lines):
    first, *_, last = lines(*DRIVE, "--speed", "40", "--controller", "stanley")
    assert first.startswith("FAILED town-0, stanley: at ")
    assert step(last)[:3] == ["road", "check", "town"]


def test_what_a_drive_has_learned_is_printed_with_its_intervals(lines):
    out = "\n".join(lines(*DRIVE, "--learn"))
    row = re.search(r"lag and dead time together +([\d.e-]+) +([\d.e-]+) +([\d.e-]+) +s", out)
    value, low, high = map(float, row.groups())
    assert low < value < high


@pytest.mark.parametrize(("command", "answer", "then"), [
    (["drive", "sine", "-o", "duration=1.0"], r"[\d.]+ [mc]m RMS error, largest ", ["drive"]),
    (["drive", "sine", "step", "-o", "duration=1.0"], r"Largest error [\d.]+ [mc]?m. 0 of 2 ", ["drive"]),
    (["road", "check", "mountain"], r"The road can be driven: 2.17 km, tightest radius 10.4 m, ", ["drive"]),
    (["road", "check", "town", "--speed", "20"], r"The road cannot be driven at 11 places ", ["road", "check"]),
    (["car", "midsize-sedan"], r"midsize-sedan: 1093.3 kg, wheelbase 2.58 m, understeers by ", ["drive"]),
    (["car", "--mass", "1500", "--wheelbase", "2.7"], r"new-car: .*; 21 of its numbers are estimated", ["car"]),
    (["list", "scenarios"], "9 scenarios", ["drive"]),
    (["paper", "campaign", "paper-grid"], r"paper-grid: 6.435 operating points; ", ["paper", "train"]),
])  # fmt: skip
def test_every_command_begins_with_its_answer_and_ends_with_a_command_that_parses(lines, command, answer, then):
    first, *_, last = lines(*command)
    assert re.match(answer, first)
    assert step(last)[: len(then)] == then


def test_thin_margins_are_called_thin_though_the_loop_is_stable(lines, monkeypatch):
    monkeypatch.setattr("adaptrack.analysis.certify.certify", partial(certify, levels=(2, 2)))
    first, *_, last = lines("certify", "--vehicle", "midsize-sedan", "--speed", "25", "30", "--friction", "0.9", "1.0")
    assert re.match(r"Stable, but with thin margins: \d+ ms of delay, where a control period is 50 ms", first)
    assert "--mismatch" in step(last)


def test_a_length_is_said_in_the_unit_in_which_one_says_it():
    values = (0.0004, 0.016, 0.9, 1.25, 76.0, 2510.0, math.nan)
    texts = ["0.4 mm", "1.6 cm", "90 cm", "1.25 m", "76 m", "2.51 km", "unknown"]
    assert list(map(words.length, values)) == texts


def test_a_car_that_oversteers_says_from_which_speed_it_is_unstable():
    car = load_vehicle("midsize-sedan")
    car = car.replace(stiffness_rear=0.5 * car.stiffness_rear)
    assert f"unstable from {car.critical_speed:.3g} m/s on" in car_answer(car)


def test_a_command_line_is_repeated_with_more_words_or_another_value(monkeypatch):
    command = ["adaptrack", "drive", "my road.csv", "--speed"]
    monkeypatch.setattr(sys, "argv", [*command, "40.0"])
    assert repeat_command(["--learn"]) == [*command, "40.0", "--learn"]
    assert repeat_command(["--speed", "28.0"]) == [*command, "28.0"]
    assert repeat_command(["--speed", "28.0", "--learn"]) == [*command, "28.0", "--learn"]
    assert repeat_command(["--lateral-acceleration", "2"]) == [*command, "40.0", "--lateral-acceleration", "2"]
    monkeypatch.setattr(sys, "argv", [*command, "40.0", "--learn", "--out", "a"])
    assert repeat_command(["~--learn", "--out", "b"]) == [*command, "40.0", "--out", "b"]
