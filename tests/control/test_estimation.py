"""The estimator of friction and wind, on known truth."""

from __future__ import annotations

import math

import numpy as np
import pytest

from adaptrack.base.errors import ContractError, InvalidInput, UnknownName
from adaptrack.cars.plant import DualTrack, SingleTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control import estimation
from adaptrack.control.controllers import MPC, Tuning, published_mpc
from adaptrack.control.estimation import (
    FrictionWindEstimator,
    UserEstimator,
    check_estimator,
    get_estimator,
    list_estimators,
    register_estimator,
)
from adaptrack.control.models import SingleTrackModel
from adaptrack.control.scheduling import SchedulingVariables
from adaptrack.core.estimators import friction_wind as kernel
from adaptrack.core.models.car import unpack
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.simulate import simulate
from adaptrack.scenario import Scenario, load_scenario
from adaptrack.scenario.profile import load_profile
from small_controllers import Scripted

pytestmark = pytest.mark.kernels


CAR = load_vehicle("paper")
PAPER, ROAD = load_profile("paper"), load_profile("road")
PRIOR = kernel.DEFAULT_PRIOR
NOMINAL, PRIOR_STD = PRIOR.nominal_friction, PRIOR.nominal_friction * PRIOR.friction_spread
SILENT_ROAD = ROAD.replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)


NEVER = FailureLimits(distance=math.inf, sideslip=math.inf)


class Recording:
    """Keeps what an estimator knows at each step of a controller."""

    def __init__(self, estimator, controller):
        self.own, self.estimates = estimator, []
        step = controller.step

        def recorded(*arguments, **options):
            self.estimates.append(estimator.estimate)
            return step(*arguments, **options)

        controller.step = recorded


def estimating_with(**constants):
    """The class of estimators with different constants."""
    return type("Trial", (FrictionWindEstimator,), {"_prior": PRIOR._replace(**constants)})


def road(speed=20.0, friction=0.9, wind=0.0, duration=10.0, **options):
    """A drive on which nobody looks at the reference."""
    return Scenario(
        name="road", duration=duration, reference=0.0, speed=speed, friction=friction, wind=wind, start_y=0.0, **options
    )


def drive(scenario, steering, profile=ROAD, plant=None, estimator=None, seed=0):
    """The trajectory under a steering law, and the estimates (n, 5); nobody stops a car that slides."""
    plant = plant or DualTrack(CAR)
    controller = Scripted(steering) if callable(steering) else steering
    estimator = Recording(estimator or FrictionWindEstimator.of(plant, profile), controller)
    trajectory = simulate(
        plant, controller, scenario, profile=profile, seed=seed, perception=estimator.own, failure=NEVER
    )
    return trajectory, np.array(estimator.estimates)


def weave(amplitude, frequency=0.4):
    return lambda t: amplitude * math.sin(2.0 * math.pi * frequency * t)


def straight(t):
    return 0.0


def lane_change(seed):
    """A drive under the MPC, its operating point drawn from the domain of the tuning campaign."""
    rng = np.random.default_rng(seed)
    speed, y, friction, gust = rng.uniform((6.0, -7.0, 0.3, -30.0), (30.0, 7.0, 1.0, 30.0))
    mpc = published_mpc(CAR, Tuning(30, 10, 1, 3000), period=0.05, preview=True)
    scenario = load_scenario("lane-change", amplitude=y, speed=speed, friction=friction, gust=gust)
    return drive(scenario, mpc, seed=seed)


def state(**values):
    """z with these entries."""
    z = np.zeros(8)
    for name, value in values.items():
        z[getattr(kernel, name)] = value
    return z


# -- the model --------------------------------------------------------------------------------------------------------
def test_the_filter_believes_in_the_single_track_plant(rng):
    plant = SingleTrack(CAR, "passenger-car")
    p = FrictionWindEstimator.of(plant)._packed
    for _ in range(20):
        vy, r, yaw, friction, wind = rng.uniform((-2, -0.8, -1, 0.3, -30), (2, 0.8, 1, 1, 30))
        vx = rng.uniform(2.0, 30.0)
        z = state(VY_STATE=vy, YAW_RATE_STATE=r, LOG_FRICTION=math.log(friction), WIND_STATE=wind)
        lateral, yawing, _, _ = kernel.accelerations(0.0, yaw, vx, p, z, np.zeros((2, 8)))
        slope = plant.derivative([0, 0, yaw, vx, vy, r], [0.0, 0.0], [friction] * 4 + [0.0, wind])
        assert lateral == pytest.approx(slope[4] + vx * r, rel=1e-12, abs=1e-12)
        assert yawing == pytest.approx(slope[5], rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("tyre", ["passenger-car", "constant-stiffness"])
def test_its_derivatives_are_those_of_its_accelerations(tyre, rng):
    p = FrictionWindEstimator.of(DualTrack(CAR, tyre))._packed
    for _ in range(20):
        z, slopes, spare = np.zeros(8), np.zeros((2, 8)), np.zeros((2, 8))
        z[: kernel.N] = rng.uniform((-1, -0.5, math.log(0.3), -30, -0.1), (1, 0.5, 0.0, 30, 0.1))
        angle, yaw, vx = rng.uniform((-0.3, -0.5, 5.0), (0.3, 0.5, 30.0))
        kernel.accelerations(angle, yaw, vx, p, z, slopes)
        for j in range(kernel.N):
            step = 1e-5
            ends = []
            for sign in (1.0, -1.0):
                near = z.copy()
                near[j] += sign * step
                ends.append(np.array(kernel.accelerations(angle, yaw, vx, p, near, spare)[:2]))
            expected = (ends[0] - ends[1]) / (2.0 * step)
            assert slopes[:, j] == pytest.approx(expected, rel=2e-3, abs=1e-4), f"column {j}"


def test_the_replica_turns_the_wheels_as_the_actuator_does():
    estimator = FrictionWindEstimator.of(DualTrack(CAR))
    angles = []

    class Watched(Scripted):
        def step(self, *arguments, **options):
            angles.append(estimator._memory[0].angle)
            return super().step(*arguments, **options)

    def jerky(t):
        return 0.3 * math.copysign(1.0, math.sin(5.0 * t))

    trajectory, _ = drive(road(5.0, duration=4.0), Watched(jerky), SILENT_ROAD, estimator=estimator)
    assert np.abs(np.array(angles) - trajectory.steering).max() < 2e-3
    c = unpack(estimator._packed)
    assert kernel.steered(0.0, 0.4, 0.3, c) == pytest.approx(0.15)  # at the rate limit
    assert kernel.steered(0.0, 0.05, 0.3, c) == pytest.approx(0.05 * (1.0 - math.exp(-2.0)))  # below it
    assert kernel.steered(0.0, 2.0, 50.0, c) == pytest.approx(math.pi / 6)


# -- wind -------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("wind", [-12.0, 25.0])
def test_without_noise_a_constant_wind_is_found(wind):
    plant = SingleTrack(CAR)
    estimating = estimating_with(
        nominal_friction=0.9, friction_spread=0.05, wind_time=60.0, stiffness_spread=0.0, tyre_error=0.0
    )
    estimator = estimating.of(plant, PAPER, period=0.05)
    _, estimates = drive(road(20.0, 0.9, wind, 6.0), weave(0.01), PAPER, plant, estimator)
    assert estimates[-40:, 1] == pytest.approx(wind, rel=0.02)


@pytest.mark.compiled
def test_a_gust_is_tracked():
    squares, truth = 0.0, 0.0
    for seed in range(3):
        scenario = load_scenario("lane-change", amplitude=1.0, speed=22.0, friction=0.8, gust=18.0)
        mpc = published_mpc(CAR, Tuning(30, 10, 1, 3000), period=0.05, preview=True)
        trajectory, estimates = drive(scenario, mpc, seed=seed)
        squares += np.mean((estimates[:, 1] - trajectory.wind[:, 1]) ** 2)
        truth += np.mean(trajectory.wind[:, 1] ** 2)
        assert abs(estimates[:, 1].max() - 18.0) < 6.0
    assert math.sqrt(squares / truth) < 0.55


def test_an_accelerometer_makes_wind_and_friction_more_certain():
    estimator = FrictionWindEstimator.of(DualTrack(CAR))
    trajectory, without = drive(road(20.0, 0.7, 3.0, 4.0), weave(0.05), estimator=estimator)
    estimator.reset()
    command = 0.0
    for k in range(len(trajectory.t)):
        state = [trajectory.vy[k], trajectory.psi[k], trajectory.yaw_rate[k], trajectory.Y[k]]
        felt = estimator.step(state, trajectory.vx[k], command, trajectory.lateral_acceleration[k])
        command = trajectory.command[k]
    assert felt.wind_std < 0.7 * without[-1, 3]
    assert felt.friction_std < without[-1, 2]
    assert abs(felt.wind - 3.0) < 3.0 * felt.wind_std


# -- friction ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("friction", [0.3, 0.8])
def test_friction_is_found_where_the_tyres_slide(friction):
    _, estimates = drive(road(20.0, friction, 0.0, 6.0), weave(0.3 * friction))
    settled = estimates[60:]
    assert np.sqrt(np.mean((settled[:, 0] - friction) ** 2)) < 0.12 * friction
    assert settled[:, 2].mean() < 0.12 * friction


@pytest.mark.compiled
@pytest.mark.parametrize(("friction", "speed"), [(0.3, 25.0), (0.95, 5.0)])
def test_friction_is_nominal_and_said_to_be_unknown_where_nothing_excites(friction, speed):
    _, estimates = drive(road(speed, friction, 0.0, 15.0), straight)
    assert np.abs(estimates[:, 0] - NOMINAL).max() < 0.15 * NOMINAL
    assert estimates[:, 2].min() > 0.8 * PRIOR_STD


@pytest.mark.compiled
def test_soft_or_stiff_tyres_are_not_taken_for_the_road():
    plant, factor = DualTrack(CAR), 1.1
    tyre = plant.tyre.replace(
        stiffness_front=plant.tyre.stiffness_front * factor, stiffness_rear=plant.tyre.stiffness_rear * factor
    )
    errors = {}
    for spread in (0.0, 0.05):
        estimator = estimating_with(stiffness_spread=spread)(CAR, tyre, ROAD.steering)
        _, estimates = drive(road(20.0, NOMINAL, 0.0, 12.0), weave(0.06), estimator=estimator)
        errors[spread] = abs(estimates[-100:, 0].mean() - NOMINAL)
    assert errors[0.05] < 0.5 * errors[0.0]
    assert estimates[-1, 4] == pytest.approx(1.0 / factor, rel=0.07)


# -- the filter -------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_errors_are_as_large_as_the_filter_says():
    friction, wind = [], []
    for seed in range(12):
        trajectory, estimates = lane_change(seed)
        friction.append(np.log(estimates[:, 0] / trajectory.friction[:, 0]) * estimates[:, 0] / estimates[:, 2])
        wind.append((estimates[:, 1] - trajectory.wind[:, 1]) / estimates[:, 3])
    friction, wind = np.concatenate(friction), np.concatenate(wind)
    assert 0.5 < np.mean(friction**2) < 1.6  # the mean of a chi-squared variable of one degree of freedom: 1
    assert np.mean(np.abs(friction) > 3.0) < 0.01
    assert 0.2 < np.mean(wind**2) < 1.2  # mostly calm: less than the prior expects
    assert np.mean(np.abs(wind) > 3.0) < 0.01


def test_the_mirrored_drive_gives_the_mirrored_estimate():
    estimator, mirrored = (FrictionWindEstimator.of(DualTrack(CAR)) for _ in range(2))
    trajectory, _ = lane_change(3)
    command = 0.0
    for k in range(len(trajectory.t)):
        state = np.array([trajectory.vy[k], trajectory.psi[k], trajectory.yaw_rate[k], trajectory.Y[k]])
        felt = trajectory.lateral_acceleration[k]
        left = estimator.step(state, trajectory.vx[k], command, felt)
        right = mirrored.step(-state, trajectory.vx[k], -command, -felt)
        assert left.wind == -right.wind
        assert (left.friction, left.friction_std, left.wind_std) == (right.friction, right.friction_std, right.wind_std)
        command = trajectory.command[k]


def test_a_measurement_that_is_no_number_leaves_the_estimate():
    estimator = FrictionWindEstimator.of(DualTrack(CAR))
    for _ in range(20):
        before = estimator.step([0.1, 0.0, 0.02, 0.0], 20.0, 0.01)
    nothing = estimator.step([math.nan] * 4, math.nan, math.nan, math.nan)
    decay = math.exp(-estimator.period / PRIOR.wind_time)
    assert nothing.wind == pytest.approx(decay * before.wind)
    assert nothing.wind_std > before.wind_std
    for gap in range(4):
        state = [0.1, 0.0, 0.02, 0.0]
        state[gap] = math.inf if gap % 2 else math.nan
        assert all(map(math.isfinite, estimator.step(state, 20.0, 0.01)))
    for _ in range(1200):
        nothing = estimator.step([math.nan] * 4, 20.0, 0.0)
    assert nothing[:4] == pytest.approx((NOMINAL, 0.0, PRIOR_STD, PRIOR.wind_spread), rel=0.01, abs=1e-6)


def test_one_outlier_moves_no_more_than_a_trusted_innovation():
    estimator = FrictionWindEstimator.of(DualTrack(CAR))
    for _ in range(100):
        calm = estimator.step([0.0, 0.0, 0.0, 0.0], 20.0, 0.0)
    estimate = estimator.step([50.0, 0.0, -20.0, 0.0], 20.0, 0.0)
    assert abs(estimate.wind) < 2.0 * kernel.TRUSTED * calm.wind_std
    assert abs(estimate.friction - calm.friction) < 0.1


@pytest.mark.parametrize("value", [1e308, 30.0, -math.inf])
def test_it_recovers_from_an_absurd_measurement(value):
    estimator = FrictionWindEstimator.of(DualTrack(CAR))
    for sign in (1.0, -1.0, 1.0):
        absurd = sign * value
        estimator.step([absurd] * 4, absurd, absurd, absurd)
    for _ in range(600):
        estimate = estimator.step([0.0, 0.0, 0.0, 0.0], 20.0, 0.0)
    assert abs(estimate.wind) < 1.0
    assert estimate.friction == pytest.approx(NOMINAL, abs=0.1)
    motion = estimator._memory[0].covariance[:2, :2]
    assert np.isfinite(motion).all()
    assert np.sqrt(np.diag(motion)) == pytest.approx([0.02, 0.003], abs=0.02)


@pytest.mark.compiled
def test_estimates_stay_within_their_bounds():
    estimator = estimating_with(friction_range=(0.5, 0.8), most_wind=5.0).of(DualTrack(CAR))
    for friction in (0.3, 1.0):
        _, estimates = drive(road(22.0, friction, 30.0, 6.0), weave(0.25), estimator=estimator)
        assert estimates[:, 0].min() >= 0.5 - 1e-12
        assert estimates[:, 0].max() <= 0.8 + 1e-12
        assert np.abs(estimates[:, 1]).max() <= 5.0


# -- the door ---------------------------------------------------------------------------------------------------------
def test_the_scheduler_knows_the_estimates():
    calls = []

    def scheduler(variables):
        calls.append(variables)
        return 20.0, 5.0, 1.0, 3000.0

    mpc = published_mpc(CAR, period=0.05, scheduler=scheduler)
    estimator = Recording(FrictionWindEstimator.of(DualTrack(CAR)), mpc)
    trajectory = simulate(
        DualTrack(CAR), mpc, road(20.0, 0.9, 15.0, 1.0), profile="road", perception=estimator.own
    )  # fmt: skip
    assert [(v.friction, v.wind) for v in calls] == [(e.friction, e.wind) for e in estimator.estimates]
    assert [v.speed for v in calls] == trajectory.vx.tolist()
    assert isinstance(calls[0], SchedulingVariables)


@pytest.mark.parametrize(("make", "argument", "words"), [
    (lambda: FrictionWindEstimator(CAR, period=0.0), "period", "> 0"),
    (
        lambda: simulate(
            DualTrack(CAR),
            published_mpc(CAR, period=0.1),
            road(duration=1.0),
            perception=FrictionWindEstimator(CAR),
        ),
        "",
        "give both the same period",
    ),
    (lambda: FrictionWindEstimator(CAR, noise_vy=math.nan), "noise_vy", "finite"),
    (lambda: FrictionWindEstimator(CAR, noise_acceleration="fast"), "noise_acceleration", "number"),
    (lambda: FrictionWindEstimator(CAR).step([0.0] * 3, 10.0, 0.0), "measured", "expected \\(4,\\)"),
    (lambda: FrictionWindEstimator(CAR).step([0.0] * 4, None, 0.0), "speed", "NaN if it was not measured"),
])  # fmt: skip
def test_what_the_estimator_refuses(make, argument, words):
    with pytest.raises(InvalidInput, match=f"{argument}.*{words}"):
        make()


# -- the state of the prediction model --------------------------------------------------------------------------------
def hold_still(speed, measured, command, a, b, parameters, memory, x, d):
    """Whatever is measured: the origin, undisturbed."""
    x[:] = 0.0
    d[:] = 0.0


def test_an_estimator_of_ones_own_may_be_registered_and_found_by_name(monkeypatch):
    monkeypatch.setattr(estimation._registry, "factories", dict(estimation._registry.factories))
    register_estimator("still", lambda: UserEstimator(hold_still, label="still"))
    assert list_estimators() == ["deadbeat", "kalman", "still"]
    assert get_estimator("still").name == "still"
    assert MPC(CAR, estimator="still").describe()["estimator"] == "still"
    for name, factory in (("deadbeat", UserEstimator), ("", UserEstimator), ("mine", 3)):
        with pytest.raises(InvalidInput, match="register_estimator"):
            register_estimator(name, factory)
    with pytest.raises(UnknownName, match="'deadbeat'"):
        MPC(CAR, estimator="deadbead")
    with pytest.raises(InvalidInput, match="estimator"):
        MPC(CAR, estimator=3)


def leaves_gaps(speed, measured, command, a, b, parameters, memory, x, d):
    """A disturbance that nobody writes, and a state that is what is measured, gaps and all."""
    for i in range(x.size):
        x[i] = measured[i]


def scribbles(speed, measured, command, a, b, parameters, memory, x, d):
    """Writes to the model."""
    x[:] = 0.0
    d[:] = 0.0
    a[0, 0] = 0.0


@pytest.mark.parametrize(("estimate", "clause"), [
    (leaves_gaps, "x and d must be written and finite"),
    (scribbles, "must write to memory, x and d only"),
    (hold_still, "must predict the model"),
])  # fmt: skip
def test_the_checker_refuses_an_estimator_that_breaks(estimate, clause):
    with pytest.raises(ContractError, match=clause):
        check_estimator(UserEstimator(estimate), SingleTrackModel(CAR, 0.05))
