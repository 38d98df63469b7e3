"""Cars from mass and wheelbase; what is known of a car, and within what."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.synthesis.belief import widen_drifts
from adaptrack.core.synthesis.car import AXLE_COEFFICIENTS
from adaptrack.drive.failure import find_failure
from adaptrack.tuning.runs import random_drive_runs

REAL = [name for name in at.list_vehicles() if name not in ("paper", "model-car")]
"""Full-size cars; the paper's has tyres as no real car."""


# -- estimates --------------------------------------------------------------------------------------------------------
def test_the_shipped_cars_lie_within_what_their_mass_and_wheelbase_tell():
    """None of these cars was used for the estimates; inertia and height are 90 % intervals, hence some slack."""
    for name in REAL:
        car = at.load_vehicle(name)
        guess = at.vehicle_from_data_sheet("x", car.mass, car.wheelbase, body_style="truck" if name == "van" else "car")
        tolerances = guess.known_within
        for key, slack in (("stiffness_front", 1.0), ("stiffness_rear", 1.0), ("yaw_inertia", 1.06)):
            ratio = getattr(car, key) / getattr(guess, key)
            assert max(ratio, 1.0 / ratio) <= slack * getattr(tolerances, key), (name, key)
        assert abs(car.lf - guess.lf) <= tolerances.lf
        assert abs(car.cg_height - guess.cg_height) <= tolerances.cg_height
        low, high = guess.understeer_range
        assert low <= car.understeer_gradient <= high


def test_what_a_data_sheet_says_is_kept_and_the_rest_is_marked_also_in_a_file(tmp_path):
    car = at.vehicle_from_data_sheet("mine", 1400, 2.6, lf=1.0, stiffness_front=6e4, track_front=1.6)
    assert (car.mass, car.lf, car.lr, car.stiffness_front, car.track_front) == (1400, 1.0, 1.6, 6e4, 1.6)
    assert not {"mass", "lf", "lr", "stiffness_front", "track_front"} & set(car.estimated)
    assert {"yaw_inertia", "stiffness_rear", "cg_height", "track_rear", "engine_power"} <= set(car.estimated)
    assert car.known_within.lf is car.known_within.stiffness_front is None
    assert car.known_within.stiffness_rear > 1.5
    car.to_toml(tmp_path / "mine.toml")
    assert at.load_vehicle(tmp_path / "mine.toml") == car
    assert at.vehicle_from_data_sheet("mine", 1400, 2.6, lr=1.6) == at.vehicle_from_data_sheet(
        "mine", 1400, 2.6, lf=1.0
    )


def test_a_load_makes_the_tyres_stiffer_and_leaves_the_inertia():
    empty, laden = (at.vehicle_from_data_sheet("x", 1500, 2.7, load=load) for load in (0.0, 150.0))
    assert laden.mass == 1650
    assert laden.yaw_inertia == empty.yaw_inertia
    assert laden.stiffness_front == pytest.approx(1.1 * empty.stiffness_front, rel=1e-3)
    weight = laden.mass * GRAVITY * laden.lr / laden.wheelbase
    assert 2 * laden.stiffness_front == pytest.approx(AXLE_COEFFICIENTS[0] * weight, rel=1e-3)


@pytest.mark.slow
@pytest.mark.compiled
@pytest.mark.parametrize("profile", ["road", "production"])
@pytest.mark.parametrize("name", REAL)
def test_mass_and_wheelbase_are_enough_to_drive_a_car(name, profile):
    """16 drives of the car itself by a controller that knows nothing else of it: at most one failed."""
    car = at.load_vehicle(name)
    mpc = at.MPC(at.vehicle_from_data_sheet(name, car.mass, car.wheelbase), profile=profile)
    runs = random_drive_runs(at.DualTrack(car), mpc, range(52_000_000, 52_000_016), profile=profile)
    assert np.isinf(runs.drive(mpc, [3])[:, 0]).sum() <= 1


# -- known within -----------------------------------------------------------------------------------------------------
def car(**changes) -> at.Vehicle:
    return at.load_vehicle("midsize-sedan").replace(**changes)


def test_the_controller_takes_its_uncertainty_from_the_cars_file_unless_told():
    known_within = at.KnownWithin(stiffness_front=1.3, stiffness_rear=1.5, mass=1.1, yaw_inertia=1.2, steering_lag=0.05)
    steering = at.Steering(lag=0.2)
    of_file = at.MPC(car(known_within=known_within, steering=steering), profile="road")
    mpc = at.MPC(car(steering=steering), profile="road", uncertainty=at.Uncertainty(lag=0.05, stiffness=1.5, mass=0.2))
    assert of_file.tuning == mpc.tuning
    assert of_file.model.lag == mpc.model.lag == pytest.approx(0.2 + 0.9 * 0.05)
    assert of_file.estimator == mpc.estimator
    plain = at.MPC(car(steering=steering), profile="road")
    assert of_file.tuning.R > plain.tuning.R
    sure = at.MPC(car(known_within=known_within, steering=steering), profile="road", uncertainty=at.Uncertainty())
    assert (sure.tuning, sure.model.lag, sure.estimator) == (plain.tuning, plain.model.lag, plain.estimator)


def test_how_well_a_lag_is_known_concerns_the_lag_of_the_same_file_only():
    """A lag that the profile says is as sure as the profile."""
    mpc = at.MPC(car(known_within=at.KnownWithin(steering_lag=0.1)), profile="road")
    assert mpc.model.lag == at.load_profile("road").steering.lag


def test_a_car_without_the_section_drives_as_before():
    mpc, plain = (at.MPC(car(known_within=tolerances), profile="production") for tolerances in (None, at.KnownWithin()))
    assert (mpc.tuning, mpc.estimator, mpc.limits, mpc.belief) == (
        plain.tuning, plain.estimator, plain.limits, plain.belief,
    )  # fmt: skip


def test_uncertain_stiffness_slows_the_disturbances_where_the_lateral_velocity_is_not_measured():
    drifts = at.MPC(car(), profile="road").estimator.drifts

    def widened(stiffness, measures_vy):
        row = drifts.row
        widen_drifts(at.Uncertainty(stiffness=stiffness).row, measures_vy, row)
        return row

    for factor, share in ((1.6, 1.0), (2.5, 1.0), (1.6**0.5, 0.5)):
        assert widened(factor, 0).side == pytest.approx(drifts.side / 3.0**share)
        assert widened(factor, 0).sliding == pytest.approx(drifts.sliding * 5.0**share)
    assert widened(1.0, 0) == widened(1.6, 1) == drifts.row


def test_a_factor_and_a_margin_are_written_as_such():
    known_within = at.KnownWithin(mass=1.25, lf=0.05, drive_front=0.1)
    clauses = [known_within.clause(key) for key in ("mass", "lf", "drive_front", "lr")]
    assert clauses == ["x/÷ 1.25", "± 0.05 m", "± 0.1", ""]
    assert at.KnownWithin.is_factor("stiffness_rear")
    assert not at.KnownWithin.is_factor("cg_height")


# -- domain -----------------------------------------------------------------------------------------------------------
def test_drives_are_drawn_in_the_domain_of_the_car():
    model, drive = at.load_vehicle("model-car"), at.random_drive(3, **at.load_vehicle("model-car").domain.drive_options)
    assert at.load_scenario("random-drive", seed=3, domain=model.domain) == drive
    runs = random_drive_runs(at.DualTrack(model), at.MPC(model, profile="road"), [3])
    assert runs.scenarios == [drive]
    signals, domain = drive.sample(0.05), model.domain
    assert domain.speed[0] <= signals.speed.min() <= signals.speed.max() <= domain.speed[1]
    assert domain.friction[0] <= signals.friction.min()
    assert np.abs(signals.wind).max() <= domain.wind
    for name in ("paper", *REAL):  # full-size cars have the drives of every such car
        assert at.random_drive(11, **at.load_vehicle(name).domain.drive_options) == at.random_drive(11)


@pytest.mark.compiled
def test_a_run_has_failed_where_the_cars_own_domain_says(tmp_path):
    """In every driver, in the metrics, and in a file that was read back."""
    model = at.load_vehicle("model-car")
    off = at.load_scenario("step", amplitude=0.2, speed=3.0, duration=3.0)
    mpc, plant = (
        at.MPC(model, profile="road"),
        at.DualTrack(model.replace(domain=model.domain.replace(failure_distance=0.1))),
    )
    runs = [at.simulate(plant, mpc, off, profile="road"), at.rollout(plant, mpc, off, profile="road")]
    run = at.rollout(at.DualTrack(model), mpc, off, profile="road")
    assert run.failed is None
    assert run.meta["failure_distance"] == 0.5
    near = plant.vehicle.domain.failure_distance
    assert at.FailureLimits.of(plant) == at.FailureLimits(distance=near)
    scenario = at.load_scenario("step", amplitude=0.05, speed=3.0, duration=3.0, start_y=0.0)
    assert [run.failed for run in runs] == [None, None] or all(run.failed == "off-road" for run in runs)
    moved = dataclasses.replace(run, Y=run.y_ref + np.linspace(0.0, 0.6, len(run)))
    assert find_failure(moved).reason == "off-road"
    assert at.compute_metrics(moved).failed
    assert find_failure(moved, at.FailureLimits()) is None
    batch = at.rollout_batch(plant, mpc, [off, scenario], profile="road")
    assert (batch.failed[0] is None) == (runs[1].failed is None)
