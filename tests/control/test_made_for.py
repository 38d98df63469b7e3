"""Nothing that ships for one car drives another without a word."""

from dataclasses import replace

import pytest

import adaptrack as at
from adaptrack.control.controllers.compatibility import car_of
from adaptrack.control.scheduling import made_for
from adaptrack.drive.batch import Batch
from adaptrack.tuning.constant import ConstantTuning
from adaptrack.tuning.runs import RunSet

SCHEDULERS = {name: at.load_scheduler(name) for name in at.list_schedulers()}
CARS = {name: at.load_vehicle(name) for name in at.list_vehicles()}
PAIRS = [("road-nn", "paper"), ("road-nn", "van"), ("road-look-up", "midsize-sedan")]
SHORT = at.load_scenario("lane-change", speed=5.0, amplitude=0.2, duration=1.0)


def controller(schedule, car, scheduler=None):
    """The MPC that a schedule was made for, of a car."""
    world = at.load_profile(schedule.made_for["profile"])
    sizes = {"longest_horizon": max(60, schedule.largest[0]), "most_moves": max(20, schedule.largest[1])}
    return at.published_mpc(car, scheduler=scheduler, period=world.period, preview=world.preview, **sizes)


def test_every_shipped_scheduler_says_for_which_car_and_profile_it_was_made():
    assert all(schedule.made_for["car"] in CARS and schedule.made_for["profile"] for schedule in SCHEDULERS.values())


@pytest.mark.parametrize(("name", "car"), PAIRS)
def test_a_shipped_scheduler_meets_another_car_with_a_word_and_its_own_without(name, car, caplog):
    """The controller is built; the schedule comes to a run set; the plant is of another car than the controller."""
    schedule, own_car = SCHEDULERS[name], CARS[SCHEDULERS[name].made_for["car"]]
    profile, other = schedule.made_for["profile"], car != own_car.name
    mpc = controller(schedule, CARS[car], schedule)
    words = f"was made for the car '{own_car.name}', not '{car}'"
    assert (words in caplog.text) == other
    assert bool(mpc.mismatches(schedule, profile)) == other
    caplog.clear()
    RunSet(at.DualTrack(CARS[car]), controller(schedule, CARS[car]), [SHORT], profile)._warn_of(schedule)
    assert (words in caplog.text) == other
    caplog.clear()
    Batch(at.DualTrack(CARS[car]), controller(schedule, own_car, schedule), [SHORT], profile)
    assert (words in caplog.text) == other


@pytest.mark.compiled
def test_simulate_tells_it_too_when_only_the_plant_is_another_car(caplog):
    schedule = SCHEDULERS["road-best-constant"]
    mpc = controller(schedule, CARS["paper"], schedule)
    assert "made for" not in caplog.text
    at.simulate(at.DualTrack(CARS["van"]), mpc, SHORT, profile="road")
    assert "was made for the car 'paper', not 'van'" in caplog.text


def test_a_car_with_the_name_of_a_shipped_one_and_other_numbers_is_another_car(caplog):
    heavy = CARS["paper"].replace(mass=1800.0)
    schedule = SCHEDULERS["road-nn"]
    controller(schedule, heavy, schedule)
    assert "was made for the car 'paper', not 'paper with other numbers'" in caplog.text
    assert car_of(at.DualTrack(heavy)) == "paper with other numbers"
    assert car_of(at.DualTrack(CARS["paper"].replace(description="another word"))) == "paper"
    assert car_of(object()) is None


# -- the certificate where a schedule or a constant meets another car -------------------------------------------------
@pytest.fixture(autouse=True)
def few_points(monkeypatch):
    """Few points of the certificate."""
    monkeypatch.setattr("adaptrack.cli.controllers.CERTIFIED_LEVELS", (2, 2))


def drive_shortly(car, scheduler):
    """A lane change of a second."""
    short = ["-o", "speed=8", "-o", "amplitude=0.2", "-o", "duration=1.0", "--profile", "road"]
    return ["drive", "lane-change", *short, "--vehicle", car, "--scheduler", scheduler]


@pytest.mark.compiled
def test_simulate_refuses_a_scheduler_that_is_unstable_on_another_car_unless_that_is_allowed(run_command):
    meeting = "scheduler 'road-best-constant', made for the car 'paper', on 'midsize-sedan': certificate over"
    code, _, err = run_command(*drive_shortly("midsize-sedan", "road-best-constant"))
    assert code == 2
    assert meeting in err
    assert "Failed: the closed loop is unstable at" in err
    assert "To drive it anyway, use --allow-failed." in err
    code, _, err = run_command(*drive_shortly("midsize-sedan", "road-best-constant"), "--allow-failed")
    assert code == 0
    assert f"Warning, {meeting}" in err


@pytest.mark.compiled
def test_a_stable_meeting_is_driven_with_the_verdict_and_ones_own_car_is_not_looked_at(
    run_command, monkeypatch, tmp_path
):
    mpc, file = at.MPC(at.load_vehicle("paper"), profile="road"), tmp_path / "cautious.json"
    replace(at.Constant(mpc.tuning, name="cautious"), made_for=made_for(mpc, "road")).save(file)
    code, _, err = run_command(*drive_shortly("van", file))
    assert code == 0
    assert "Warning, scheduler 'cautious', made for the car 'paper', on 'van'" in err
    assert "Passed: the closed loop is stable at all" in err
    monkeypatch.setattr(
        "adaptrack.analysis.certify.certify", lambda *arguments, **settings: pytest.fail("it was looked at")
    )
    code, out, err = run_command(*drive_shortly("paper", file))
    assert code == 0
    assert "certificate" not in out + err


@pytest.mark.compiled
def test_drive_refuses_a_constant_that_is_unstable_on_another_car(run_command, tmp_path):
    tuning = {"Np": 5, "Nc": 1, "Q": 1.0, "R": 1e-4}
    wild = ConstantTuning(controller="informed", vehicle="paper", profile="road", period=0.05, tuning=tuning)
    wild.to_toml(tmp_path / "wild.toml")
    code, _, err = run_command("drive", "country", "--vehicle", "van", "--tuning", tmp_path / "wild.toml")
    assert code == 2
    assert "wild.toml, found for the car 'paper', on 'van': certificate over the domain of 'van': Failed" in err
