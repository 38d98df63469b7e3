"""Code of plug-ins that returns nonsense or ends the program: one sentence names it and what it must return."""

from __future__ import annotations

import math
import sys
from types import SimpleNamespace

import pytest

import adaptrack as at
from adaptrack.base.registry import Registry
from adaptrack.cars.plant import _registry
from adaptrack.control.controllers import registry as controllers
from adaptrack.drive import drivers
from adaptrack.drive.world import warn_once

CAR = at.load_vehicle("midsize-sedan")
ROAD = at.generate_road("country", seed=1, length=300.0)
DRIVE = at.RoadDrive(ROAD, at.plan_speed(ROAD, CAR))
EXIT = object()
NONSENSE = [None, "left", EXIT]


def _answer(value):
    return sys.exit(3) if value is EXIT else value


class Mine(at.Controller):
    def __init__(self, answer=0.0):
        self.answer = answer

    def step(self, state, speed, reference, variables=None):
        return _answer(self.answer)


class Stepped(at.SteppedPlant):
    name, tyre_name, longest_step = "mine", "none", 0.01
    powertrain = {"mass": 1500.0, "engine_power": 1e5, "traction_limit": 5e3, "brake_limit": 1e4}  # noqa: RUF012

    def __init__(self, answer):
        self.answer = answer

    def reset(self, motion):
        pass

    def step(self, dt, steering, acceleration, environment):
        return _answer(self.answer)


def _simulate(controller=None, plant=None, driver=None):
    return at.simulate(plant or at.DualTrack(CAR), controller or Mine(), DRIVE, profile="road", driver=driver)


def _driver(begin, step=None):
    follower = SimpleNamespace(step=lambda *_: _answer(step)) if begin == "follower" else begin
    return SimpleNamespace(begin=lambda path, plan, period: _answer(follower))


@pytest.fixture(autouse=True)
def _as_before(monkeypatch):
    for registry in (_registry, controllers._registry, drivers._registry):
        monkeypatch.setattr(registry, "factories", dict(registry.factories))
    monkeypatch.setattr(controllers, "_descriptions", dict(controllers._descriptions))
    warn_once.cache_clear()


@pytest.mark.parametrize("answer", [math.inf, math.nan])
def test_an_angle_that_is_not_finite_ends_the_run_with_a_sentence_that_names_the_controller(answer, caplog):
    assert _simulate(Mine(answer)).failed == "not-finite"
    assert f"controller 'Mine': step() returned {answer}: it must return the steering angle" in caplog.text


def test_a_motion_that_is_not_finite_ends_the_run_with_a_sentence_that_names_the_plant(caplog):
    assert _simulate(plant=Stepped([math.inf] * 6)).failed == "not-finite"
    assert "plant 'mine': step() returned [inf" in caplog.text


REQUESTS = [SimpleNamespace(acceleration=0.0, force=force, hold=hold)
            for force, hold in ((math.inf, 0.0), ("1", 0.0), (0.0, None), (0.0, -1.0), (0.0, math.inf))]  # fmt: skip
NO_ANGLE = [*NONSENSE, "0.1", True, [0.1, 0.2]]
NO_REQUEST = [*NONSENSE, math.inf, *REQUESTS, SimpleNamespace(force=0.0, hold=0.0)]


def _track(controller):
    return at.Tracker(controller, ROAD).step(0.0, 0.0, 0.0, 0.0, 10.0)


def _make(register, make, answer):
    """What a registry makes of a factory that returns an answer."""
    register("bad", lambda *_: _answer(answer))
    return make("bad", CAR)


REFUSALS = [
    (lambda answer: _simulate(Mine(answer)), NO_ANGLE,
     r"controller 'Mine': step\(\) .* it must return the steering angle"),
    (lambda answer: _track(Mine(answer)), NO_ANGLE,
     r"controller 'Mine': step\(\) .* it must return the steering angle"),
    (lambda answer: _simulate(plant=Stepped(answer)), [*NONSENSE, [1.0] * 5, [1.0] * 5 + ["a"]],
     r"plant 'mine': step\(\) .* it must return six finite numbers"),
    (lambda answer: _simulate(driver=_driver("follower", answer)), NO_REQUEST,
     r"driver SimpleNamespace: step\(\) .* it must return a SpeedCommand"),
    (lambda answer: _simulate(driver=_driver(answer)), NONSENSE,
     r"`begin` of the driver SimpleNamespace .* it must return an object with"),
    (lambda answer: _make(at.register_plant, at.get_plant, answer), NONSENSE,
     r"plant 'bad': its factory .* it must return a Plant or SteppedPlant"),
    (lambda answer: _make(at.register_controller, at.get_controller, answer), NONSENSE,
     r"controller 'bad': its factory .* must return a Controller"),
    (lambda answer: _make(drivers.register_driver, drivers.make_driver, answer), NONSENSE,
     r"driver 'bad': its factory .* must return a Driver or SpeedControl"),
]  # fmt: skip
"""Calls, answers of the code that they call, and the sentence."""


@pytest.mark.parametrize(("call", "answer", "words"), [
    (call, answer, words) for call, answers, words in REFUSALS for answer in answers
])  # fmt: skip
def test_an_answer_that_is_none_is_named_with_what_must_be_returned(call, answer, words):
    with pytest.raises(at.ContractError, match=words):
        call(answer)


@pytest.mark.parametrize("driver", ["speed-control", 1.0, object()])
def test_what_cannot_drive_is_refused_as_driver(driver):
    with pytest.raises(at.InvalidInput, match=r"driver = .*: must be a Driver, a SpeedControl"):
        _simulate(driver=driver)


@pytest.mark.parametrize("answer", NONSENSE)
def test_a_scheduler_that_returns_no_tuning_is_named_and_the_tuning_before_stays(answer, caplog):
    def mine(variables):
        return _answer(answer)

    run = at.simulate(at.DualTrack(CAR), at.MPC(CAR, scheduler=mine), at.load_scenario("double-lane-change"))
    assert run.meta["scheduler_counts"]["raised"] == len(run.t)
    assert "scheduler 'mine'" in caplog.text
    assert "it must return a Tuning or four finite numbers (Np, Nc, Q, R)" in caplog.text


def test_every_registry_checks_what_its_factories_make():
    from adaptrack.control import estimation, models

    for owner in (_registry, controllers._registry, drivers._registry, estimation._registry, models._registry):
        assert isinstance(owner, Registry)
        assert owner.member_type is not object
