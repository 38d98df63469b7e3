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


def refusal(call: Any, *given: Any) -> str:
    """The sentence by which something is refused."""
    with pytest.raises(InvalidInput) as refused:
        call(*given)
    return str(refused.value)


def test_what_is_no_array_of_numbers_is_refused_in_a_short_sentence() -> None:
    plant, friction = at.SingleTrack(CAR), at.FrictionWindEstimator(CAR, period=0.05)
    still, around = plant.initial_state([0.0, 0.0, 0.0, 10.0, 0.0, 0.0]), [0.9] * 4 + [0.0] * 2
    calls = {
        "reals": lambda each: reals("numbers", each),
        "through": road_through,
        "from_points": fit_road,
        "at": ROAD.at,
        "project": lambda each: ROAD.project(each, 0.0),
        "ahead": lambda each: at.RoadAhead(ROAD, 0.0, each),
        "yaw_of": at.yaw_of,
        "initial_state": plant.initial_state,
        "derivative": lambda each: plant.derivative(still, each, around),
        "friction": lambda each: friction.step(each, 10.0, 0.0),
        "scenario": lambda each: at.Scenario.from_arrays([0.0, 1.0], each, 10.0, 0.9),
        "log": lambda each: at.identify({"time": each}, CAR),
    }
    for name, call in calls.items():
        for given in (None, *NO_NUMBERS):
            said = refusal(call, given)
            assert len(said) < 200, name
            assert "\n" not in said, name


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
    assert refusal(lambda: at.compute_metrics(run, failure=CAR)).endswith(": must be a Failure or None.")
    assert refusal(at.check_road, CAR, ROAD).endswith(": must be a Road.")
    assert refusal(at.Tracker, ROAD, at.MPC(CAR)).endswith(": must be a Controller; such as MPC(car).")
    assert refusal(at.DualTrack, ROAD).endswith(": must be a Vehicle; load_vehicle(name) gives one.")
    assert refusal(at.load_road, ROAD).endswith(": must be text or a path.")
    assert refusal(lambda: at.tune(CAR, plant=ROAD)).endswith("must be a Plant or a SteppedPlant or text or None.")
    assert refusal(at.register_plant, "mine", 3).endswith("must be a function or text.")


def test_what_is_no_number_or_too_large_for_one_is_refused_in_a_short_sentence() -> None:
    tracker = at.Tracker(at.PurePursuit(CAR, period=0.05), ROAD)
    calls = {
        "real": lambda each: real("here", "x", each),
        "station": lambda each: at.RoadAhead(ROAD, each, [1.0]),
        "width": lambda each: ROAD.replace(width_left=each),
        "tracker": lambda each: tracker.step(0.0, each, 0.0, 0.0, 10.0),
        "driver": at.Driver,
        "amplitude": lambda each: at.load_scenario("step", amplitude=each),
        "constant": lambda each: at.load_scenario("step").replace(reference=each),
        "tuning": lambda each: at.Tuning(10, 2, each, 1.0),
        "mass": lambda each: at.identify({}, mass=each, wheelbase=2.7),
    }
    for name, call in calls.items():
        for no_number in (*NO_NUMBERS, *TOO_LARGE):
            assert len(refusal(call, no_number)) < 400, name
    for given in (None, *NO_NUMBERS, -(10**5000), 1.5):
        refusal(whole_number, "here", "n", given)


def test_numbers_too_large_for_one_are_refused_where_they_must_be_finite() -> None:
    for given in TOO_LARGE:
        assert "finite" in refusal(at.yaw_of, [given] * 4)
        assert "finite" in refusal(at.RoadAhead, ROAD, 0.0, [given])
        assert "finite" in refusal(road_through, [[given, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])


@pytest.mark.parametrize("make", [at.LQR, at.PurePursuit, at.MPC, at.published_mpc])
def test_what_is_no_road_ahead_is_refused_and_moves_no_command(make: Any) -> None:
    controller = make(CAR, period=0.05)
    for given in ("text", ROAD, 3.0, {}, [ROAD], object()):
        assert "RoadAhead" in refusal(lambda each: controller.step([0.0] * 4, 10.0, [1.0], road=each), given)
    assert controller.angle == 0.0


def test_numbers_of_every_kind_are_read_and_what_is_masked_is_not_a_number() -> None:
    given = [1, 2.5, np.float32(0.5), np.int8(-3), decimal.Decimal("0.25"), fractions.Fraction(3, 4), 10**400, -(2**70)]
    assert_array_equal(reals("x", given), [1.0, 2.5, 0.5, -3.0, 0.25, 0.75, math.inf, -(2.0**70)])
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
