"""Whatever stands where numbers are asked for, it is refused with one short sentence, or it is a number."""

from __future__ import annotations

import decimal
import enum
import fractions
import inspect
import math
import sys
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import adaptrack as at
from adaptrack.base import checked as checks
from adaptrack.base.checked import real, reals, whole_number
from adaptrack.base.errors import InvalidInput, format_value
from adaptrack.road import Line, Road, fit_road, road_through

CAR = at.load_vehicle("compact-ev")
ROAD = Road.from_segments([Line(length=50.0)])
NO_NUMBERS: tuple[Any, ...] = (
    "abcd", b"ab", object(), {"a": 1}, 1j, [1j] * 4, ["a"] * 4, [object()] * 4, [None] * 4, [[1.0, 2.0], [3.0]],
    [["a", "b"]] * 10,
)  # fmt: skip
"""Neither one number nor a row or table of them."""
TOO_LARGE: tuple[Any, ...] = (10**400, -(10**400), 10**5000, fractions.Fraction(10**400, 3))


def refusal(call: Any, *arguments: Any) -> str:
    """The sentence by which something is refused."""
    with pytest.raises(InvalidInput) as refused:
        call(*arguments)
    return str(refused.value)


def test_what_is_no_array_of_numbers_is_refused_in_a_short_sentence() -> None:
    plant, friction = at.SingleTrack(CAR), at.FrictionWindEstimator(CAR, period=0.05)
    still, around = plant.initial_state([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), [0.9] * 4 + [0.0] * 2
    calls = {
        "reals": lambda value: reals("numbers", value),
        "through": road_through,
        "from_points": fit_road,
        "at": ROAD.at,
        "project": lambda value: ROAD.project(value, 0.0),
        "ahead": lambda value: at.RoadAhead(ROAD, 0.0, value),
        "yaw_of": at.yaw_of,
        "initial_state": plant.initial_state,
        "derivative": lambda value: plant.derivative(still, value, around),
        "friction": lambda value: friction.step(value, 10.0, 0.0),
        "scenario": lambda value: at.Scenario.from_arrays([0.0, 1.0], value, 10.0, 0.9),
        "log": lambda value: at.identify({"time": value}, CAR),
    }
    for name, call in calls.items():
        for value in (None, *NO_NUMBERS):
            sentence = refusal(call, value)
            assert len(sentence) < 200, name
            assert "\n" not in sentence, name


CALLS = {name: getattr(at, name) for name in at.__all__ if callable(getattr(at, name))}
RESULTS = {"Identification", "Metrics", "PathMetrics", "RandomCar", "Shadow", "Solution", "TunedCar"}
"""Records that only this package makes."""
BY_HAND = {"CFunction", "Contender", "Road", "RoadAhead", "Schedule", "check_controller"}
"""Calls that check their arguments themselves, or of which the core knows no errors of ours."""


def named_classes(call: Any) -> dict[str, Any]:
    """The arguments of a call whose annotations name classes, texts, paths or functions."""
    target = inspect.unwrap(call.__init__ if isinstance(call, type) else call)
    space = vars(sys.modules[call.__module__])
    annotations = inspect.get_annotations(target, locals=checks._Names([space]), eval_str=True)
    annotations.pop("return", None)
    return {name: kind for name, kind in annotations.items() if checks._with_classes(kind) is not kind}


@pytest.mark.parametrize("name", sorted(set(CALLS) - RESULTS - BY_HAND))
def test_an_object_of_a_wrong_kind_is_refused_by_every_public_call(name: str) -> None:
    call = CALLS[name]
    if isinstance(call, type) and (call.__init__ is object.__init__ or issubclass(call, Exception | enum.Enum)):
        return
    for argument in named_classes(call):
        with pytest.raises(at.AdaptrackError) as refused:
            call(**{argument: object()})
        assert argument in str(refused.value)


def test_swapped_arguments_are_named_with_what_they_must_be() -> None:
    run = at.simulate(at.SingleTrack(CAR), at.PurePursuit(CAR), at.load_scenario("step", duration=1.0))
    assert "plan_speed: road = Vehicle(" in refusal(at.plan_speed, CAR, ROAD)
    assert refusal(at.plan_speed, CAR, ROAD).endswith(": must be a Road.")
    assert refusal(at.compute_metrics, ROAD).endswith("50 m>: must be a Trajectory.")
    assert refusal(lambda: at.compute_metrics(run, failure=CAR)).endswith(": must be a FailureLimits or None.")
    assert refusal(at.check_road, CAR, ROAD).endswith(": must be a Road.")
    assert refusal(at.Tracker, ROAD, at.MPC(CAR)).endswith(": must be a Controller; such as MPC(car).")
    assert refusal(at.DualTrack, ROAD).endswith(": must be a Vehicle; load_vehicle(name) gives one.")
    assert refusal(at.load_road, ROAD).endswith(": must be text or a path.")
    assert refusal(lambda: at.tune(CAR, plant=ROAD)).endswith("must be a Plant or a SteppedPlant or text or None.")
    assert refusal(at.register_plant, "mine", 3).endswith("must be a function or text.")


def test_what_is_no_number_or_too_large_for_one_is_refused_in_a_short_sentence() -> None:
    tracker = at.Tracker(at.PurePursuit(CAR, period=0.05), ROAD)
    calls = {
        "real": lambda value: real("here", "x", value),
        "station": lambda value: at.RoadAhead(ROAD, value, [1.0]),
        "width": lambda value: ROAD.replace(width_left=value),
        "tracker": lambda value: tracker.step(0.0, value, 0.0, 0.0, 10.0),
        "driver": at.Driver,
        "amplitude": lambda value: at.load_scenario("step", amplitude=value),
        "constant": lambda value: at.load_scenario("step").replace(reference=value),
        "tuning": lambda value: at.Tuning(10, 2, value, 1.0),
        "mass": lambda value: at.identify({}, mass=value, wheelbase=2.7),
    }
    for name, call in calls.items():
        for no_number in (*NO_NUMBERS, *TOO_LARGE):
            assert len(refusal(call, no_number)) < 400, name
    for value in (None, *NO_NUMBERS, -(10**5000), 1.5):
        refusal(whole_number, "here", "n", value)


def test_numbers_too_large_for_one_are_refused_where_they_must_be_finite() -> None:
    for value in TOO_LARGE:
        assert "finite" in refusal(at.yaw_of, [value] * 4)
        assert "finite" in refusal(at.RoadAhead, ROAD, 0.0, [value])
        assert "finite" in refusal(road_through, [[value, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])


@pytest.mark.parametrize("make", [at.LQR, at.PurePursuit, at.MPC, at.published_mpc])
def test_what_is_no_road_ahead_is_refused_and_moves_no_command(make: Any) -> None:
    controller = make(CAR, period=0.05)
    for value in ("text", ROAD, 3.0, {}, [ROAD], object()):
        assert "RoadAhead" in refusal(lambda road: controller.step([0.0] * 4, 10.0, [1.0], road=road), value)
    assert controller.angle == 0.0


def test_numbers_of_every_kind_are_read_and_what_is_masked_is_not_a_number() -> None:
    numbers = [
        1,
        2.5,
        np.float32(0.5),
        np.int8(-3),
        decimal.Decimal("0.25"),
        fractions.Fraction(3, 4),
        10**400,
        -(2**70),
    ]
    assert_array_equal(reals("x", numbers), [1.0, 2.5, 0.5, -3.0, 0.25, 0.75, math.inf, -(2.0**70)])
    assert_array_equal(reals("x", np.ma.masked_array([1.0, 2.0], [False, True])), [1.0, math.nan])
    assert reals("x", 3).shape == ()
    row = np.arange(3.0)
    assert reals("x", row) is row


def test_a_value_in_a_message_is_short_whatever_it_is() -> None:
    class Broken:
        def __repr__(self) -> str:
            raise RuntimeError

    assert format_value("a") == "'a'"
    assert format_value(10**5000) == "<int>"
    assert format_value(Broken()) == "<Broken>"
    assert len(format_value(list(range(1000)))) <= 80
