"""Drives of the speed control through faults of its sensors: what is requested is possible whatever comes in."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tools.fuzz.inputs import choose
from tools.fuzz.speed import soak
from tools.fuzz.speed.claims import Judge
from tools.fuzz.speed.drives import Episode, draw_drive, draw_episodes
from tools.fuzz.speed.faults import CROSS, HIDDEN, LISTS, VISIBLE
from tools.fuzz.speed.ways import Answer, Libraries, TrackerWay, link_optimised
from tools.fuzz.speed.world import World

from adaptrack.core.kernel import INTERPRETED
from exported import link_export

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="thousands of control steps")]
ROOT = Path(__file__).parents[2]
ALWAYS = ("finite", "limits", "error", "no answer")
"""Claims that hold whatever fails."""
STEPS = 600


@pytest.fixture(scope="module", params=[link_export, pytest.param(link_optimised, marks=pytest.mark.slow)])
def libraries(request, tmp_path_factory):
    return Libraries(tmp_path_factory.mktemp("libraries"), request.param)


def drive_with(fault, steps=STEPS):
    """A drive that one fault spoils from 5 s on."""
    drive = draw_drive(1, 1)
    drive.kind, drive.steps, drive.events = "visible", steps, []
    drive.episodes = [Episode(5.0, 1e3, fault, VISIBLE[fault], choose(np.random.default_rng(1), VISIBLE[fault].sizes))]
    return drive


def broken_always(outcome):
    """Findings of claims that hold whatever fails."""
    return [finding for finding in outcome.findings if finding.claim in ALWAYS]


@pytest.mark.parametrize("fault", ["absurd stamps", "absurd motion stamp", "absurd numbers", "clock jumps"])
def test_requests_are_finite_and_within_the_limits_of_the_car_whatever_comes_in(fault):
    drive = drive_with(fault)
    outcome = soak.Run(drive, TrackerWay(drive)).finish()
    assert outcome.figures.steps == STEPS or outcome.is_lost
    assert broken_always(outcome) == []


def test_the_c_library_and_the_tracker_request_the_same_in_a_drive_with_a_fault_to_the_bit(libraries):
    drive = drive_with("absurd stamps")
    outcome = soak.Run(drive, soak.make_way(drive, "both", libraries)).finish()
    assert outcome.figures.steps == STEPS or outcome.is_lost
    assert (outcome.differences, broken_always(outcome)) == (0, [])


def test_no_call_with_a_far_time_runs_through_many_times_the_lines_of_an_ordinary_one():
    """A minute without a position on a lap once made a call count its stops for ever."""
    environment = {**os.environ, "ADAPTRACK_KERNELS": "interpreted", "PYTHONPATH": f"{ROOT / 'src'}:{ROOT}"}
    program = "from tools.fuzz.speed.bound import unbounded_calls\nprint(unbounded_calls((1.7e18,), (True,)))\n"
    process = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", program], env=environment, cwd=ROOT, capture_output=True, text=True
    )
    assert process.stdout == "[]\n", process.stdout + process.stderr


def test_a_drive_follows_from_its_seed_and_number():
    first, second = draw_drive(4, 2), draw_drive(4, 2)
    assert (first.true_car, first.sensors, first.events, first.episodes) == (
        second.true_car, second.sensors, second.events, second.episodes,
    )  # fmt: skip
    assert (first.routes[0].points == second.routes[0].points).all()


def test_every_fault_of_the_three_lists_is_drawn():
    rng, names = np.random.default_rng(1), set()
    for kind in LISTS:
        for _ in range(200):
            names |= {episode.name for episode in draw_episodes(rng, kind, 60.0)}
    assert names == {*VISIBLE, *CROSS, *HIDDEN}


STILL = Answer(0.0, 0.0, 0.0, 0.0, 1e3, 0.0, 0.0, 0, 1, 0)
"""Requests of a car that is driving, and holds."""


def judge_drive(change):
    """Claims that a car breaks which is moved by hand along its path, 60 s without a call that matters; when (s)."""
    drive = next(drive for drive in map(draw_drive, [1] * 99, range(99)) if drive.kind == "healthy"
                 and not drive.routes[0].road.closed and drive.start[1] == 0.0 and not drive.events)  # fmt: skip
    world = World(drive)
    judge = Judge(drive, world)
    for k in range(1200):
        world.elapsed, answer = 0.05 * (k + 1), STILL
        answer = change(world, k) or answer
        judge.step(answer, False, True)
    return {finding.claim: finding.time for finding in judge.findings}


@pytest.mark.parametrize(("claim", "change"), [
    ("above plan", lambda world, k: setattr(world, "speed", 60.0)),
    ("stands for ever", lambda world, k: setattr(world, "speed", 0.0)),
    ("rolls back", lambda world, k: setattr(world, "station", 40.0 - 0.01 * k)),
    ("stop passed", lambda world, k: setattr(world, "station", 5.0 + k)),
    ("finite", lambda world, k: STILL._replace(force=np.nan)),
    ("limits", lambda world, k: STILL._replace(hold=-1.0)),
])  # fmt: skip
def test_what_breaks_a_claim_is_found(claim, change):
    assert claim in judge_drive(change)


def test_a_car_that_needs_its_grip_sideways_may_be_faster_until_it_has_grip_again():
    def change(world, k):
        world.speed, world.yaw_rate = 30.0, 0.5 if k < 200 else 0.0  # rad/s: 15 m/s^2 for 10 s

    assert judge_drive(change)["above plan"] > 11.0
    assert judge_drive(lambda world, k: setattr(world, "speed", 30.0))["above plan"] < 2.0
