"""What the page says is true: each lesson with the setup that it sets, the Python lines, the links."""

import json

import numpy as np
import pytest

import page_drives
from adaptrack.core.kernel import INTERPRETED
from adaptrack.export import page_setup
from adaptrack.export.page_file import PAGE_SOURCES
from programs import run_program

pytestmark = [pytest.mark.compiled, pytest.mark.skipif(INTERPRETED, reason="whole drives"), pytest.mark.needs("node")]
ROADS = {name: {"generated": page_setup.GENERATED.get(name)} for name in page_setup.PAGE_ROADS}
FILES = ("setup.js", "touch.js", "lessons.js", "links.js", "code.js")


def evaluate(expression, argument=None):
    """The value of an expression among the page's scripts; argument: what `asked` is in it."""
    script = "\n".join((PAGE_SOURCES / name).read_text() for name in FILES)
    program = f"""
    const asked = {json.dumps(argument)}, page = {{setup: null, data: {{roads: {json.dumps(ROADS)}}}}};
    {script.replace('"use strict";', "")}
    process.stdout.write(JSON.stringify({expression}));"""
    return json.loads(run_program("node", "-", input=program, timeout=60))


@pytest.fixture(scope="module")
def lessons():
    return {lesson["id"]: lesson for lesson in evaluate("ALL_LESSONS.map((each) => ({...each, setup: each.setup()}))")}


@pytest.fixture(autouse=True)
def half_a_minute(monkeypatch):
    monkeypatch.setattr(page_drives, "CLOSED_ROAD_DURATION", 60.0)  # laps of a closed road


def drive(lesson, truth=None, **controllers):
    """The RMS error (m), the largest one and the RMS move (rad) of each car, and why it ended, with other settings."""
    setup = json.loads(json.dumps(lesson["setup"]))
    setup["truth"] |= truth or {}
    for name, options in controllers.items():
        setup["controllers"][int(name[-1])] |= options
    results = []
    for run in page_drives.simulate_setup(setup):
        error, command = run.error[np.isfinite(run.error)], run.command[np.isfinite(run.command)]
        rms = float(np.sqrt(np.mean(error**2)))
        results.append((rms, float(abs(error).max()), float(np.sqrt(np.mean(np.diff(command) ** 2))), run.failed))
    return results


def test_a_blind_controller_swings_as_the_lag_grows_and_one_that_is_told_does_not(lessons):
    lesson = lessons["lag"]
    (informed, *_), (blind, *_) = drive(lesson)
    assert max(informed, blind) < 0.02
    swings = [drive(lesson, {"lag": lag}, c0={"belief": {"lag": lag, "dead_time": 0}}) for lag in (0.15, 0.4)]
    assert 0.15 < swings[0][1][0] < swings[1][1][0]
    assert swings[1][1][0] > 0.5
    assert all(informed[1] < 0.06 for informed, _ in swings)


def test_a_horizon_shorter_than_the_steering_loses_the_car_and_a_longer_one_gains_little(lessons):
    runs = {Np: drive(lessons["horizon"], c0={"tuning": {"Np": Np, "Nc": min(Np, 10), "Q": 1, "R": 4}})[0]
            for Np in (5, 8, 10, 30, 60)}  # fmt: skip
    assert runs[5][3] == "off-road"
    assert runs[8][1] < 0.08
    assert runs[30][0] > 0.8 * runs[10][0]
    assert runs[60][0] > 0.95 * runs[30][0]


def test_weight_on_moves_is_paid_with_error(lessons):
    (little, _, lively, _), (heavy, _, calm, _) = drive(lessons["weights"])
    assert calm == pytest.approx(lively / 6.0, rel=0.2)
    assert heavy > little
    (_, (strays, _, lazy, _)) = drive(lessons["weights"], c1={"tuning": {"Np": 30, "Nc": 10, "Q": 1, "R": 1e6}})
    assert lazy < lively / 12.0
    assert strays > 0.2


def test_adaptation_gains_on_the_general_trajectory_and_knowing_the_car_more(lessons):
    constant, network = drive(lessons["adaptation"])
    assert (round(1000 * constant[0]), round(1000 * network[0])) == (51, 34)
    informed = drive(lessons["adaptation"], c1={"kind": "informed"})[1]
    assert round(1000 * informed[0]) == 18


def test_an_unknown_car_is_learned_and_a_wrong_belief_leaves_the_road(lessons):
    learns, believes = page_drives.simulate_setup(lessons["learning"]["setup"])
    assert abs(learns.error).max() < 0.08
    late = {name: learns.diagnostics[name][400] for name in ("belief_lag", "belief_dead_time")}
    early = {name: learns.diagnostics[name][0] for name in late}
    truth = {"belief_lag": 0.3, "belief_dead_time": 0.1}
    for name, true in truth.items():
        sigma = learns.diagnostics[f"{name}_sigma"]
        assert abs(late[name] - true) < 2.0 * sigma[400] < 2.0 * 0.5 * sigma[0], (early, late)
    assert believes.failed == "off-road"
    assert 20.0 < believes.failed_at < 35.0


def test_below_the_grip_that_the_bends_need_no_steering_helps(lessons):
    (easy,) = drive(lessons["grip"])
    assert easy[1] < 0.06
    (lost,) = drive(lessons["grip"], {"friction": 0.3})
    assert lost[3] in ("off-road", "spun")


def test_a_speed_control_that_assumes_too_much_friction_loses_the_car_and_one_that_assumes_little_does_not(lessons):
    true, little = drive(lessons["slippery"])
    assert max(true[1], little[1]) < 0.06
    bold, careful = drive(lessons["slippery"], {"friction": 0.5})
    assert bold[3] in ("off-road", "spun")
    assert (careful[1] < 0.1, careful[3]) == (True, None)


def test_link_and_python_lines_hold_the_speed_control_and_the_true_car():
    settings = {"truth": {"slope": 0.04, "mass": 1.2, "brake_lag": 0.3}}
    expression = """(() => {
      const setup = page.setup = makeSetup({...asked, road: {name: "mountain"}});
      setup.controllers = withSpeedControl(setup.controllers, 0.6);
      return [setup, setupOf(addressOf(setup).hash).setup, pythonOf(setup)];
    })()"""
    setup, linked, lines = evaluate(expression, settings)
    assert linked == setup
    for part in ("driver=at.SpeedControl(car, friction=0.6)", "grade=0.04", "mass=car.mass * 1.2", "lag=0.3"):
        assert part in lines


def test_the_papers_controller_needs_the_papers_steering(lessons):
    (ideal,) = drive(lessons["triple-lane-change"])
    assert ideal[0] ** 2 == pytest.approx(0.00291, rel=0.01)  # as docs/reproduce.md has it
    real = json.loads(json.dumps(lessons["triple-lane-change"]))
    real["setup"]["profile"] = "road"
    assert drive(real)[0][3] == "off-road"
    both = json.loads(json.dumps(lessons["general-trajectory"]))
    both["setup"]["controllers"].append({"kind": "informed"})
    (paper, *_), (informed, *_) = drive(both)
    assert paper == pytest.approx(0.35, abs=0.01) == informed
