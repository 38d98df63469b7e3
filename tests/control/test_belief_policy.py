"""Where the steering parameters come from, who learns where nobody says them, and how far a learned belief is right."""

import dataclasses
import logging
import math
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack.analysis.certify import certify
from adaptrack.cli.controllers import ControllerSettings, make_controller, make_learning
from adaptrack.cli.export import ExportedController
from adaptrack.cli.options import CarAndPlant
from adaptrack.control.controllers.belief import ASSUMED_SOURCE, TO_LEARN_SOURCE
from adaptrack.core.estimators.learning import BELIEF_COLUMNS
from adaptrack.drive.world import World, warn_once
from adaptrack.results.certificate import certificate_result
from adaptrack.results.drive import Run, drive_result

CAR = at.load_vehicle("paper")
SHEET = at.vehicle_from_data_sheet("sheet", 1500.0, 2.7)
KNOWN = CAR.replace(steering=at.Steering(lag=0.1, dead_time=0.05))
LEARNING = at.Learning()
compiled = pytest.mark.compiled


# -- who says the steering --------------------------------------------------------------------------------------------
def test_who_learns_is_told_nothing_of_the_steering_by_the_profile():
    profile = "production"
    default, unknown = (at.MPC(CAR, profile=profile, learning=LEARNING, belief=belief) for belief in (None, "unknown"))
    np.testing.assert_array_equal(default.learner.parameters(), unknown.learner.parameters())
    assert default.limits == unknown.limits
    assert {default.belief.lag.source, default.belief.dead_time.source} == {TO_LEARN_SOURCE}
    assert default.belief.computation.source == f"profile {profile}"
    registered = at.get_controller("informed-learning", CAR, profile=profile)
    np.testing.assert_array_equal(registered.learner.parameters(), unknown.learner.parameters())


# -- who learns -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "options", [{}, {"belief": "unknown", "profile": "road"}, {"belief": at.Steering(lag=0.2)}, {"tuning": at.Tuning()}]
)
def test_where_nobody_says_lag_or_dead_time_the_mpc_learns_and_says_so(options):
    mpc = at.MPC(CAR, **options)
    assert mpc.learner is not None
    assert "; learns, unknown " in repr(mpc)
    (short, long), (soon, late) = mpc.learner.ranges
    assert f"lag {short:.3g} to {long:.3g} s, dead time {soon:.3g} to {late:.3g} s" in repr(mpc)
    assert mpc.describe()["learning"] == mpc.learns
    assert isinstance(mpc.step([0.0] * 4, 15.0, np.zeros(40)).belief_state, at.BeliefState)


def test_nothing_is_learned_where_lag_and_dead_time_are_said_or_learning_is_none():
    for car, options in (
        (KNOWN, {}),
        (CAR, {"belief": at.Steering(lag=0.1, dead_time=0.0)}),
        (CAR, {"profile": "road"}),
    ):
        mpc = at.MPC(car, **options)
        assert mpc.learner is None
        assert "does not learn, known lag and dead time" in repr(mpc)
    mpc = at.MPC(CAR, learning=None)
    assert "; does not learn, as given; " in repr(mpc)
    assert mpc.step([0.0] * 4, 15.0, np.zeros(40)).belief_state is None
    with pytest.raises(at.InvalidInput, match="does not learn, as given"):
        mpc.learned()
    assert at.MPC(CAR, estimator="deadbeat").learner is None


def test_what_nobody_says_is_never_taken_for_certain():
    mpc = at.MPC(CAR, uncertainty=at.Uncertainty(stiffness=1.3))
    assert mpc.learner.ranges.lag == at.MPC(CAR).learner.ranges.lag
    assert mpc.learner.ranges.dead_time == pytest.approx((0.0, at.MPC(CAR).learner.ranges.dead_time[1]), abs=0.051)
    assert math.exp(mpc.learner.stiffness) == pytest.approx(1.3)


def test_in_a_loop_of_ones_own_the_computation_is_learned_with_the_dead_time():
    bare, with_profile = at.MPC(CAR, learning=LEARNING), at.MPC(CAR, profile="road", learning=LEARNING)
    assert (bare.belief.computation.value, with_profile.belief.computation.value) == (0.0, with_profile.period)
    assert bare.learner.ranges.dead_time[0] == 0.0
    assert bare.learner.ranges.dead_time[1] >= with_profile.learner.ranges.dead_time[1]


# -- the guide's table ------------------------------------------------------------------------------------------------
def driving_controller(**drive):
    """The informed controller of `drive` with these options."""
    world = at.load_profile("road")
    learning = make_learning(drive.get("learn", False), drive.get("learned"))
    return make_controller("informed", ControllerSettings(CAR, world, world.period, True, learning=learning))[1]


def exported_controller(car, computation=0.0):
    """The controller of `export c` with a computation time (s)."""
    exported = ExportedController(car=CarAndPlant())
    return exported.make(car, at.load_profile(exported.profile), computation)


STEERING = at.Steering(lag=0.2, dead_time=0.1)
FROM_FILE, FROM_PROFILE, GIVEN, LEARNED = (
    ("car file paper",) * 2, ("profile road",) * 2, ("given",) * 2, (TO_LEARN_SOURCE,) * 2,
)  # fmt: skip
PART, NAMED = CAR.replace(steering=at.Steering(lag=0.1)), {"profile": "road"}
ROWS = [
    ("`MPC(car)`, car file with lag", lambda: at.MPC(KNOWN), FROM_FILE, 0.0, False),
    ("`MPC(car)`, car file without", lambda: at.MPC(PART), ("car file paper", TO_LEARN_SOURCE), 0.0, True),
    ("`MPC(car, belief=at.Steering(lag=0.2, dead_time", lambda: at.MPC(KNOWN, belief=STEERING), GIVEN, 0.0, False),
    ("`MPC(car, belief=at.Steering(lag=0.2))`", lambda: at.MPC(KNOWN, belief=at.Steering(lag=0.2)),
     ("given", "car file paper"), 0.0, False),
    ('`MPC(car, belief="unknown")`', lambda: at.MPC(KNOWN, belief="unknown"), LEARNED, 0.0, True),
    ("`MPC(car, learning=None)`", lambda: at.MPC(CAR, learning=None), (ASSUMED_SOURCE,) * 2, 0.0, False),
    ("`MPC(car, computation=0.02)`", lambda: at.MPC(KNOWN, computation=0.02), FROM_FILE, 0.02, False),
    ('`MPC(car, profile="road")`', lambda: at.MPC(CAR, **NAMED), FROM_PROFILE, 0.05, False),
    ('`MPC(car, profile="road", comp', lambda: at.MPC(CAR, **NAMED, computation=0.0), FROM_PROFILE, 0.0, False),
    ('`MPC(car, profile="road", learn', lambda: at.MPC(KNOWN, **NAMED, learning=LEARNING), FROM_FILE, 0.05, True),
    ("`drive`", driving_controller, FROM_PROFILE, 0.05, False),
    ("`drive --learn`", lambda: driving_controller(learn=True), LEARNED, 0.05, True),
    ("`export c`", lambda: exported_controller(KNOWN), FROM_FILE, 0.0, False),
]  # fmt: skip
"""Start of a row, its controller, sources of lag and dead time, computation time (s), and whether it learns."""


@pytest.mark.parametrize(
    ("make", "sources", "computation", "learns"), [row[1:] for row in ROWS], ids=[r[0] for r in ROWS]
)
def test_the_steering_parameters_come_from_where_the_guide_says(make, sources, computation, learns):
    mpc = make()
    assert (mpc.belief.lag.source, mpc.belief.dead_time.source) == sources
    assert mpc.belief.computation.value == computation
    assert (mpc.learner is not None) == learns


def test_every_row_of_the_guide_is_tested():
    guide = Path(__file__).parents[2].joinpath("docs/guide.md").read_text()
    section = guide.split("## Where the steering parameters come from\n")[1].split("\n## ")[0]
    rows = [line.removeprefix("| ") for line in section.splitlines() if line.startswith("| `")]
    assert [line for line, row in zip(rows, ROWS, strict=True) if not line.startswith(row[0])] == []


# -- computation time -------------------------------------------------------------------------------------------------
def test_a_computation_time_adds_to_the_dead_time_wherever_it_is_stated():
    for stated in (0.0, 0.03):
        delays = [
            at.MPC(CAR, belief=STEERING, computation=stated).model.dead_time,
            at.KinematicMPC(CAR, belief=STEERING, computation=stated).belief.delay,
            at.PreviewLQR(CAR, belief=STEERING, computation=stated).belief.delay,
        ]
        assert delays == pytest.approx([0.1 + stated] * 3)
    assert at.KinematicMPC(KNOWN).belief.delay == at.PreviewLQR(KNOWN).belief.delay == 0.05
    assert exported_controller(KNOWN, computation=0.02).model.dead_time == pytest.approx(0.07)


def test_a_controller_that_learns_counts_a_stated_computation_time_before_the_dead_time():
    plain, stated = at.MPC(CAR, learning=LEARNING), at.MPC(CAR, learning=LEARNING, computation=0.05)
    assert (
        stated.learner.parameters().tobytes()
        == at.MPC(CAR, profile="road", learning=LEARNING).learner.parameters().tobytes()
    )
    assert stated.model.dead_time == pytest.approx(plain.model.dead_time + 0.05)


@pytest.mark.parametrize(("make", "computation"), [
    (at.MPC, -0.01), (at.KinematicMPC, math.nan), (at.PreviewLQR, 2.0), (at.published_mpc, 0.05),
])  # fmt: skip
def test_an_impossible_computation_time_is_refused(make, computation):
    with pytest.raises(at.InvalidInput, match="computation"):
        make(CAR, computation=computation)


@compiled
def test_the_true_steering_drives_no_worse_than_an_unknown_one():
    car, road = at.load_vehicle("midsize-sedan"), at.generate_road("mountain", seed=2, length=600.0)
    drive, world = at.RoadDrive(road, at.plan_speed(road, car)), at.load_profile("road").replace(delay=0.0)
    true = at.Steering(lag=world.steering.lag, dead_time=0.0, rate=world.steering.rate)

    def mean_square(mpc):
        tunings = np.tile(mpc.tuning.as_array(), (3, 1))
        runs = at.rollout_batch(
            at.DualTrack(car), mpc, [drive], tunings, scenario_indices=[0] * 3, profile=world, seeds=np.arange(3)
        )
        return runs.mse.mean()

    assert mean_square(at.MPC(car, belief=true)) <= mean_square(at.MPC(car))


@pytest.mark.parametrize(("mpc", "profile", "differs"), [
    (at.MPC(KNOWN), "road", "0 s (default), but profile 'road' simulates 0.05 s"),
    (at.MPC(KNOWN, computation=0.05), "paper", "0.05 s (given), but profile 'paper' simulates 0 s"),
    (at.KinematicMPC(KNOWN), "road", "0 s (default), but profile 'road' simulates 0.05 s"),
    (at.MPC(CAR), "road", None),
    (at.MPC(KNOWN, profile="road"), "road", None),
    (at.MPC(KNOWN.replace(steering=at.Steering(lag=0.1, dead_time=0.1))), "road", None),
], ids=["too short", "too long", "another controller", "learning", "equal", "as dead time"])  # fmt: skip
def test_a_simulation_says_where_controller_and_profile_differ(mpc, profile, differs, caplog):
    warn_once.cache_clear()
    plant = at.DualTrack(CAR, steering=at.SteeringActuator(lag=0.1, dead_time=0.05))
    with caplog.at_level(logging.WARNING, "adaptrack"):
        World.of(plant, mpc, profile, None, None, None)
    assert ("computation time of " + (differs or "") in caplog.text) == (differs is not None)


@compiled
def test_a_steering_that_follows_at_once_is_learned_without_losing_the_car():
    vehicle = at.load_vehicle("paper").replace(steering=None)
    plant, world = at.DualTrack(vehicle, steering=at.SteeringActuator()), at.load_profile("road").replace(delay=0.0)
    mpc, drives = at.MPC(vehicle), [at.random_drive(5_600_000 + i, 20.0) for i in range(6)]
    tunings = np.tile(mpc.tuning.as_array(), (6, 1))
    runs = at.rollout_batch(
        plant, mpc, drives, tunings, scenario_indices=np.arange(6), profile=world, seeds=np.arange(6)
    )
    assert not any(runs.failed)
    assert runs.mse.max() < 0.01


def test_what_the_sheet_leaves_open_is_open_to_who_learns():
    sheet = SHEET.replace(known_within=at.KnownWithin(mass=1.6, stiffness_front=2.5, stiffness_rear=3.0))
    assert math.exp(at.MPC(sheet).learner.stiffness) == pytest.approx(3.0 * 1.6)
    assert math.exp(at.MPC(SHEET).learner.stiffness) >= 1.62 * 1.15


# -- that learns by default, everywhere -------------------------------------------------------------------------------
@compiled
def test_a_certificate_of_who_learns_is_of_how_it_begins_and_names_the_belief():
    mpc = at.MPC(SHEET, profile="road", learning=LEARNING)
    answer = mpc.step([0.0] * 4, 15.0, np.zeros(40))
    assert answer.learned[BELIEF_COLUMNS.used_caution] == mpc.first_caution > 1.0
    begins = mpc.estimator.parameters(mpc.model)
    np.testing.assert_allclose(mpc._mpc.informed.estimator, begins, rtol=1e-12)
    certificate = certify(mpc.tuning, at.DualTrack(SHEET), mpc, "road", levels=(3, 1))
    assert certificate.belief == f"{mpc.belief}; {mpc.learns}"
    result = certificate_result(certificate)
    assert result.notes == [f"Steering model of the controller: {certificate.belief}."]
    assert result.record["belief"] == certificate.belief
    heavier = at.Tuning(mpc.tuning.Np, mpc.tuning.Nc, 1.0, mpc.first_caution * mpc.tuning.R)
    frozen = at.MPC(SHEET, model=mpc.model, estimator=mpc.estimator)
    expected = certify(heavier, at.DualTrack(SHEET), frozen, "road", levels=(3, 1))
    np.testing.assert_allclose(certificate.bare.straight.radius, expected.bare.straight.radius, rtol=1e-9)


# -- how far it is right ----------------------------------------------------------------------------------------------
@compiled
def test_measures_and_the_page_say_for_how_long_a_belief_was_in_each_state():
    road = at.generate_road("country", 3, 300.0)
    run = at.rollout(
        at.DualTrack(SHEET), at.MPC(SHEET), at.RoadDrive(road, at.plan_speed(road, SHEET)), profile="road", seed=1
    )
    states, at_bound = np.full(len(run), float(at.BeliefState.SETTLED)), np.zeros(len(run))
    states[: len(run) // 2] = at.BeliefState.LEARNING
    states[-1], at_bound[-1] = at.BeliefState.AT_BOUND, 1.0
    diagnostics = {**run.diagnostics, "belief_state": states, "belief_at_bound": at_bound}
    run = dataclasses.replace(run, diagnostics=diagnostics)
    measures = at.compute_metrics(run)
    assert measures.belief_learning == pytest.approx(0.5, abs=0.01)
    assert measures.belief_settled == pytest.approx(0.5, abs=0.01)
    assert measures.belief_at_bound == 1.0 / len(run)
    assert measures.belief_contradictory == 0.0
    assert measures.belief_state == "at a bound (lag)"
    table = drive_result([Run(run, road=road, car=SHEET)]).table(f"{road.name} belief")
    assert table.rows[0]["belief_state"] == "at a bound (lag)"
    plain = at.compute_metrics(at.rollout(at.DualTrack(CAR), at.MPC(KNOWN), at.random_drive(3, 1.0), profile="road"))
    assert plain.belief_state == ""
    assert math.isnan(plain.belief_settled)
