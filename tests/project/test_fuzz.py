"""Hostile inputs: what must hold at every step of controllers, tracker and estimators, and files that replay."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tools.fuzz import TARGETS, Failed, load, replay, save, search, shortened
from tools.fuzz.batch import search_compiled
from tools.fuzz.inputs import HOSTILE

import adaptrack as at
from adaptrack.control.qp import QPStatus
from adaptrack.road import Line

CAR = at.load_vehicle("paper")
GOOD = [0.01, 0.002, 0.003, 0.1]
REFERENCE = np.zeros(1)
numbers = st.one_of(st.sampled_from(HOSTILE), st.floats())
compiled = pytest.mark.compiled


@pytest.mark.parametrize("name", TARGETS)
@compiled
def test_hostile_inputs_break_no_claim(name):
    outcome = search(3000, seed=1, targets=[name])
    assert outcome.steps[name] == 3000
    assert [failed.claim for failed in outcome.failed] == []


@compiled
def test_hostile_inputs_break_no_claim_inside_the_kernels():
    outcome = search_compiled(100_000, seed=1)
    assert [failed.claim for failed in outcome.failed] == []


@settings(max_examples=30)
@given(row=st.lists(numbers, min_size=9, max_size=9), speed=numbers, ahead=st.lists(numbers, min_size=1, max_size=8))
@pytest.mark.parametrize("kind", ["published", "informed", "learning"])
@compiled
def test_no_sample_however_hostile_raises_or_stays(kind, row, speed, ahead):
    """A good second later the controller solves again."""
    case = {"target": "mpc", "kind": kind, "car": "paper", "profile": "road", "lies": False, "frozen": False,
            "preview": False}  # fmt: skip
    bad_step = {"state": row, "speed": speed, "reference": ahead, "good": False}
    good_step = {"state": GOOD, "speed": 15.0, "reference": [0.0], "good": False}
    wiggling = [{**good_step, "state": [0.01, 0.002, 0.003, 0.1 + 0.001 * (k % 2)]} for k in range(100)]
    assert (
        replay(case, [good_step, bad_step, *wiggling, bad_step, *({**step, "good": True} for step in wiggling)]) is None
    )


@compiled
def test_what_fails_is_cut_short_saved_and_replayed(tmp_path, monkeypatch):
    """A claim that is broken on purpose: no command above 1 degree."""
    from tools.fuzz import targets

    monkeypatch.setattr(
        targets.Steering, "wrong", lambda self, before, angle: "too large" if abs(angle) > math.radians(1.0) else None
    )
    case = {"target": "mpc", "kind": "published", "car": "paper", "lies": False, "frozen": True}
    rows = [{"state": np.array([0.0, 0.0, 0.0, y]), "speed": 15.0, "reference": REFERENCE, "good": True}
            for y in (0.0, 0.0, 0.0, 2.0, 0.0)]  # fmt: skip
    where, claim = replay(case, rows)
    assert (where, claim) == (3, "too large")
    brief = shortened(Failed(case, rows[: where + 1], claim))
    assert len(brief.inputs) == 1
    file = tmp_path / "case.json"
    save(brief, file)
    again = load(file)
    assert replay(again.case, again.inputs) == (0, "too large")
    monkeypatch.undo()
    assert replay(again.case, again.inputs) is None


# -- what the search has found, each by itself ------------------------------------------------------------------------
@compiled
def test_a_problem_that_was_not_finite_leaves_nothing_to_a_smaller_one():
    """Its NaN stayed in the padding of E, where the next smaller problem met it for ever."""
    answer = [30, 18, 1.0, 10.0]
    mpc = at.published_mpc(CAR, at.Tuning(30, 18, 1.0, 10.0), period=0.05, scheduler=lambda variables: answer)
    variables = (10.0, 0.0, 0.6, 0.0)
    assert mpc.step(GOOD, math.nan, REFERENCE, variables).status is QPStatus.NON_FINITE
    answer[:2] = [20, 5]
    assert mpc.step(GOOD, 15.0, REFERENCE, variables).status is QPStatus.SOLVED


@compiled
def test_a_filter_sees_the_samples_of_a_step_whose_tuning_is_none():
    tunings = [[20, 5, 1.0, -1.0], [20, 5, 1.0, 10.0]]
    states = []
    for first in tunings:
        answers = iter([tunings[1], first, tunings[1]])
        mpc = at.MPC(CAR, profile="road", scheduler=lambda variables, tunings_in_turn=answers: next(tunings_in_turn))
        for k in range(3):
            mpc.applied(0.0)
            mpc.step([0.0, 0.0, 0.01 * k, 0.1 * k], 15.0, REFERENCE, (15.0, 0.0, 0.6, 0.0))
        states.append(mpc._mpc.informed.x.copy())
    assert np.isfinite(states).all()
    np.testing.assert_allclose(states[0], states[1], rtol=0, atol=1e-12)


@compiled
def test_a_sample_of_an_absurd_age_is_left_out():
    mpc = at.MPC(CAR, profile="road", learning=at.Learning())
    for age in (0.0, 1e300, math.inf, -1e300, 0.0):
        step = mpc.step([*GOOD, math.nan, math.nan, 0.0, age, 0.0], 15.0, REFERENCE)
        assert step.status is QPStatus.SOLVED
        assert np.isfinite(step.learned).all()


@pytest.mark.parametrize("angle", [2.0, -1e300, math.nan])
def test_no_wheel_has_such_an_angle(angle):
    with pytest.raises(at.InvalidInput, match="applied: angle"):
        at.published_mpc(CAR).applied(angle)


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("moves", range(1, 21))
def test_after_a_step_at_every_limit_a_sample_that_is_not_finite_is_not_solved(moves, value):
    mpc = at.published_mpc(CAR, at.Tuning(35, moves, 10.0, 0.01))
    for entry in range(5):
        mpc.reset()
        assert mpc.step([0.0, 0.0, 0.0, 0.0], 20.0, [50.0]).status is QPStatus.SOLVED
        state, reference = [0.0, 0.0, 0.0, 0.0], [50.0]
        (state if entry < 4 else reference)[entry % 4] = value
        command = mpc.step(state, 20.0, reference)
        assert command.status is not QPStatus.SOLVED
        assert command.held


STRAIGHT = at.Road.from_segments([Line(length=300.0)])


def call_on_line(tracker, t, x=0.0, **values):
    """A call of a car on the line."""
    return tracker.step(t, **{"x": x, "y": 0.1, "yaw": 0.0, "speed": 10.0, "yaw_rate": 0.0, **values})


@pytest.mark.parametrize(
    "absurd",
    [{"x": 1e300}, {"y": -1e20}, {"yaw": 1e300}, {"speed": 1e300}, {"yaw_rate": 1e300}, {"lateral_velocity": 1e300},
     {"now": 1e18}],
    ids=lambda case: next(iter(case)),
)  # fmt: skip
@compiled
def test_what_no_car_can_have_counts_as_not_measured(absurd):
    tracker = at.Tracker(at.MPC(CAR, profile="road"), STRAIGHT)
    for first in (absurd, {}):  # as the first call, and among others
        tracker.engage()
        calls = [{"x": 0.5 * k, **(absurd if k == 5 else first if k == 0 else {})} for k in range(9)]
        steps = [call_on_line(tracker, 0.05 * k, **values) for k, values in enumerate(calls)]
        assert all(math.isfinite(step.command) for step in steps)
        if "now" not in absurd:
            assert steps[-1].status is at.Status.OK


def test_a_path_too_far_away_to_compare_begins_the_tracker_anew():
    tracker = at.Tracker(at.published_mpc(CAR, period=0.05), STRAIGHT)
    before = call_on_line(tracker, 0.0)
    tracker.follow(at.Road.from_segments([Line(length=100.0)], start=(1e6, 1e6, 0.0)))
    step = call_on_line(tracker, 0.05, 0.5)
    assert step.status in (at.Status.OFF_PATH, at.Status.HELD)  # there is no foot of the car to steer by
    assert abs(step.command - before.command) <= tracker.controller.limits.move[1] + 1e-12
