"""Random drives: what they promise holds at every instant of many of them, so a fair controller can drive them all."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import adaptrack as at
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.scenario import LaneChange, Step
from adaptrack.scenario.random_drives import MAX_BRAKING, MAX_LONGITUDINAL_SHARE, MAX_TRACTION

STEP = 0.01
T = np.arange(0.0, 60.0 + STEP / 2, STEP)
NARROW: dict[str, Any] = dict(speed=(10.0, 14.0), friction=(0.5, 0.6), wind=8.0, demand=(0.05, 0.1), heading=0.1)
WIDE: dict[str, Any] = dict(speed=(4.0, 27.0), friction=(0.3, 1.0), wind=30.0, demand=(0.1, 0.35), heading=0.25)


@pytest.fixture(scope="module")
def drives() -> list[at.Scenario]:
    return [at.random_drive(seed) for seed in range(50)]


@pytest.fixture(scope="module", params=["wide", "narrow"])
def promised(request: pytest.FixtureRequest, drives: list[at.Scenario]) -> tuple[dict[str, Any], list[at.Scenario]]:
    """Ranges, and drives within them; the wide ones are the defaults."""
    if request.param == "wide":
        return WIDE, drives
    return NARROW, [at.random_drive(seed, **NARROW) for seed in range(20)]


def rate(function: Any, h: float = 1e-4) -> np.ndarray:
    """The derivative of a function of time, per second, by differences."""
    return (function(T + h) - function(T - h)) / (2.0 * h)


def acceleration(drive: at.Scenario, h: float = 1e-3) -> np.ndarray:
    """d²y_ref/dt², m/s^2."""
    return (drive.reference_at(T + h) - 2.0 * drive.reference_at(T) + drive.reference_at(T - h)) / h**2


def available(drive: at.Scenario, around: float = 0.4) -> np.ndarray:
    """The acceleration that the lowest friction within `around` (s) of each instant allows, m/s^2."""
    friction = drive.friction_at(T).min(axis=1)
    cells = round(around / STEP)
    padded = np.pad(friction, cells, mode="edge")
    return GRAVITY * np.lib.stride_tricks.sliding_window_view(padded, 2 * cells + 1).min(axis=1)


# ---- which drive


def test_a_seed_is_a_drive_and_another_seed_another():
    assert at.random_drive(7) == at.random_drive(7)
    assert at.random_drive(np.int64(7)) == at.random_drive(7)  # type: ignore[arg-type]
    assert len({at.random_drive(seed).reference for seed in range(20)}) == 20


def test_a_seed_is_the_same_drive_on_every_machine():
    """Numbers that this program gave elsewhere: they change only if every published result on drives does."""
    drive = at.random_drive(7)
    curve, *_, change = drive.reference.terms  # type: ignore[attr-defined]
    assert curve == LaneChange(amplitude=6.61, start=2.95, duration=9.01)
    assert change == LaneChange(amplitude=-3.45, start=48.79, duration=6.3)
    assert drive.speed.points[:2] == ((0.0, 21.71), (1.56, 21.71))  # type: ignore[attr-defined]
    assert drive.friction[0].terms[1] == Step(after=-0.47, time=11.31)  # type: ignore[attr-defined]
    assert drive.wind.y.terms[0].value == -5.91  # type: ignore[union-attr, attr-defined]


def test_a_drive_says_how_to_make_it_again():
    for options in ({}, NARROW, {"duration": 20.0, "speed": [5, 10]}, {"speed": (15.0, 15.0)}):
        drive = at.random_drive(3, **options)
        assert eval(drive.source, {"random_drive": at.random_drive}) == drive


def test_other_wind_leaves_the_road_and_the_driving_alone():
    calm, stormy = at.random_drive(5, wind=0.0), at.random_drive(5)
    assert_array_equal(calm.wind_at(T), 0.0)
    assert stormy.replace(wind=0.0, source="") == calm.replace(wind=0.0, source="")


def test_drives_of_one_duration_have_equally_many_samples():
    for duration in (0.1, 1.0, 7.3, 60.0):
        assert {at.random_drive(seed, duration).sample(0.05).n for seed in range(5)} == {round(duration / 0.05)}


def test_drives_have_a_name_and_a_seed_as_its_option():
    assert at.load_scenario("random-drive") == at.random_drive(0)
    assert at.load_scenario("random-drive", seed=12, duration=20.0) == at.random_drive(12, 20.0)
    assert at.load_scenario("random-drive", seed=12, friction=0.7) == at.random_drive(12).replace(friction=0.7)
    assert at.list_scenarios()["random-drive"] == at.random_drive(0).description


# ---- what they ask for


def test_speed_stays_in_its_range_and_changes_as_a_car_can(promised):
    ranges, drives = promised
    for drive in drives:
        speed, along = drive.speed_at(T), rate(drive.speed_at)
        assert ranges["speed"][0] - 1e-9 <= speed.min()
        assert speed.max() <= ranges["speed"][1] + 1e-9
        assert along.min() >= -MAX_BRAKING - 1e-6
        assert along.max() <= MAX_TRACTION + 1e-6
        assert (np.abs(along) <= MAX_LONGITUDINAL_SHARE * available(drive) + 1e-6).all()
        assert np.abs(np.diff(along)).max() < 8.0 * STEP  # smoothly: no jump of the acceleration


def test_friction_and_wind_stay_in_their_ranges(promised):
    ranges, drives = promised
    for drive in drives:
        friction = drive.friction_at(T)
        assert ranges["friction"][0] - 1e-9 <= friction.min()
        assert friction.max() <= ranges["friction"][1] + 1e-9
    strongest = [np.abs(drive.wind_at(T)[:, 1]).max() for drive in drives]
    assert 0.9 * ranges["wind"] < max(strongest) <= ranges["wind"] + 1e-9
    assert_array_equal([drive.wind_at(T)[:, 0] for drive in drives], 0.0)


def test_the_heading_of_the_reference_is_bounded(promised):
    ranges, drives = promised
    for drive in drives:
        heading = np.arcsin(rate(drive.reference_at) / drive.speed_at(T))
        assert np.abs(heading).max() <= ranges["heading"] * (1.0 + 1e-6)


def test_lateral_acceleration_never_exceeds_its_share_of_the_friction(promised):
    ranges, drives = promised
    shares = np.array([np.abs(acceleration(drive)) / available(drive) for drive in drives])
    assert shares.max() <= ranges["demand"][1] + 1e-6
    assert np.median(shares.max(axis=1)) > 0.6 * ranges["demand"][1]  # and most drives ask for a good part of it


def test_the_reference_is_twice_continuously_differentiable(drives):
    for drive in drives:
        assert np.abs(np.diff(acceleration(drive))).max() < 25.0 * STEP  # the jerk is below 25 m/s^3


def test_drives_begin_straight_and_on_the_reference(drives):
    begin = T[T <= 1.0]
    for drive in drives:
        assert drive.initial_y == 0.0
        assert_array_equal(drive.reference_at(begin), 0.0)


# ---- how mixed they are


def test_a_minute_holds_some_of_everything(drives):
    terms = [drive.reference.terms for drive in drives]  # type: ignore[attr-defined]
    assert all(isinstance(term, LaneChange) for drive_terms in terms for term in drive_terms)
    assert 6 <= np.mean([len(drive_terms) for drive_terms in terms]) <= 12  # curves and lane changes
    assert 4 <= np.mean([len(drive.friction[0].terms) - 1 for drive in drives]) <= 7
    assert 4 <= np.mean([len(drive.wind.y.terms) - 1 for drive in drives]) <= 8  # type: ignore[union-attr, attr-defined]
    assert np.mean([np.ptp(drive.speed_at(T)) for drive in drives]) > 12.0
    for values in (
        [term.amplitude for drive_terms in terms for term in drive_terms],
        [drive.wind_at(5.0)[1] for drive in drives],
    ):
        assert 0.35 < np.mean(np.array(values) > 0.0) < 0.65  # left as often as right


def test_a_quarter_of_the_drives_is_dry():
    lowest = np.array([at.random_drive(seed).friction_at(T[::10]).min() for seed in range(400)])
    assert 0.19 < np.mean(lowest >= 0.79) < 0.31
    assert np.mean(lowest < 0.5) > 0.5


IMPOSSIBLE = {
    "seed": (-1, 1.5), "duration": (0.0, 1e9), "speed": (15.0, (20.0, 10.0), (10.0, math.inf)),
    "friction": ((0.0, 1.0), (0.5, 5.0)), "wind": (-1.0,), "demand": ((0.1, 1.5), (0.1, 0.2, 0.3)), "heading": (1.0,),
}  # fmt: skip


@pytest.mark.parametrize(("option", "values"), IMPOSSIBLE.items(), ids=IMPOSSIBLE)
def test_impossible_drives_are_refused(option, values):
    for value in values:
        with pytest.raises(at.InvalidInput, match=option):
            at.random_drive(**({"seed": 0} | {option: value}))
        if option == "seed":
            with pytest.raises(at.InvalidInput, match="seed"):
                at.load_scenario("random-drive", seed=value)


# ---- and they can be driven


@pytest.mark.compiled
def test_one_good_tuning_keeps_to_most_drives():
    car = at.load_vehicle("paper")
    drives = [at.random_drive(seed, 20.0) for seed in range(30)]
    tunings = np.tile(at.Tuning(30, 10, 1.0, 3000.0).as_array(), (len(drives), 1))
    mpc = at.published_mpc(car, period=0.05, preview=True)
    result = at.rollout_batch(
        at.DualTrack(car), mpc, drives, tunings, scenario_indices=np.arange(len(drives)), profile="road",
        failure=at.FailureLimits(distance=5.0),
    )  # fmt: skip
    assert sum(reason is not None for reason in result.failed) <= 5
    assert np.median(result.max_abs_error) < 0.5
