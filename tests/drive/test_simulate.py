"""The closed loop: one trajectory however it is computed, and a car that does what its scenario asks."""

import functools
import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars.vehicle import GRAVITY
from adaptrack.control.qp import QPStatus
from adaptrack.core.maths.random import counted_normal
from adaptrack.drive.failure import Reason, find_failure
from adaptrack.scenario import Knots
from references.daqp import Daqp
from small_cars import PARAMETERS, linear_car
from small_controllers import Scripted

# The counted noise multiplies integers that wrap around, of which the interpreter warns; compiled code is silent.
pytestmark = [pytest.mark.kernels, pytest.mark.filterwarnings("ignore:overflow encountered in scalar:RuntimeWarning")]

CAR = at.load_vehicle("paper")
ROAD = at.load_profile("road")
CALM = at.Tuning(25, 6, 1.0, 30.0)
LANE_CHANGE = at.load_scenario("lane-change", duration=6.0, speed=15.0)
SHORT = at.load_scenario("lane-change", duration=1.5, start=0.2, change_time=2.0, gust_start=0.3, gust_duration=1.0)


def same(first, second, names=None):
    """Whether two trajectories agree in every bit, step times aside."""
    first_columns, second_columns = first.columns(), second.columns()
    return first_columns.keys() == second_columns.keys() and all(
        np.array_equal(first_columns[name], second_columns[name], equal_nan=first_columns[name].dtype.kind == "f")
        for name in names or set(first_columns) - {"step_time"}
    )


def controller(profile, car=CAR, **options):
    """An MPC that keeps its course with the sensors and the steering of a profile."""
    if profile == "road":
        return at.published_mpc(car, at.Tuning(30, 6, 1.0, 3000.0), preview=True, period=ROAD.period, **options)
    return at.published_mpc(car, CALM, **options)


def straight_then(**options):
    """A straight road at constant speed; `options` change it."""
    return at.Scenario(
        **({"name": "road", "duration": 4.0, "reference": 0.0, "speed": 15.0, "friction": 0.9} | options)
    )


def ramp(before, after, start, duration):
    """A straight line between two values of a signal."""
    return Knots(points=((start, before), (start + duration, after)))


# -- two drivers, one kernel ------------------------------------------------------------------------------------------
def users_car():
    return at.UserPlant(linear_car, PARAMETERS | {"wind": 0.0}, mass=1575.0, label="linear")


@pytest.mark.compiled
def test_a_users_plant_drives_as_the_built_in_one_with_its_equations():
    air = {"frontal_area": 0.0, "rolling_resistance": 0.0}
    tyre = at.DualTrack(CAR, "constant-stiffness").tyre.replace(stiffness_load="constant", relaxation_length=0.0)
    built_in = at.SingleTrack(CAR.replace(**air), tyre, steps=20)
    scenario = at.load_scenario("lane-change", friction=1.0, amplitude=0.5)
    ours, theirs = (at.rollout(plant, at.published_mpc(CAR, CALM), scenario) for plant in (built_in, users_car()))
    assert np.abs(ours.Y - theirs.Y).max() < 2e-4  # it takes tan(gamma) for gamma
    assert np.abs(ours.yaw_rate - theirs.yaw_rate).max() < 1e-3


# -- batches ----------------------------------------------------------------------------------------------------------
FIELDS = ("mse", "mean_squared_move", "max_abs_error", "failed", "failed_at", "steps", "qp_capped", "qp_failed", "held",
          "limited", "qp_iterations")  # fmt: skip


def equal(first, other):
    """Whether two columns of results are the same, NaN where NaN is."""
    return first.dtype == other.dtype and np.array_equal(first, other, equal_nan=first.dtype.kind == "f")


def random_runs(rng, count):
    tunings = np.column_stack(
        [
            rng.integers(2, 56, count),
            rng.integers(1, 19, count),
            rng.uniform(0.1, 10, count),
            10 ** rng.uniform(-2, 3, count),
        ]
    ).astype(float)
    return tunings, rng.integers(0, 3, count), rng.integers(0, 100, count)


@pytest.fixture(scope="module")
def drives():
    return [
        at.load_scenario("lane-change", duration=4.0, amplitude=size, speed=speed)
        for size, speed in ((3, 25), (-2, 8), (1, 15))
    ]


@pytest.mark.compiled
@pytest.mark.parametrize(
    "plant", [at.SingleTrack(CAR), at.DualTrack(CAR, "passenger-car")], ids=lambda plant: plant.name
)
@pytest.mark.parametrize("profile", ["paper", "road"])
@pytest.mark.parametrize("moves", [at.Moves.pulses(), at.Moves.laguerre(0.8, 6)], ids=["pulse", "laguerre"])
def test_a_run_of_a_batch_depends_neither_on_the_others_nor_on_the_threads(plant, profile, moves, drives, rng):
    tunings, indices, seeds = random_runs(rng, 75)
    mpc = at.published_mpc(CAR, moves=moves)

    def run(chosen, **options):
        return at.rollout_batch(
            plant, mpc, drives, tunings[chosen], scenario_indices=indices[chosen], seeds=seeds[chosen],
            profile=profile, **options,
        )  # fmt: skip

    everything = np.arange(75)
    serial = run(everything, threads=1)
    threaded = run(everything, threads=2)
    shuffled = rng.permutation(75)
    mixed = run(shuffled, threads=2)
    for name in FIELDS:
        values = getattr(serial, name)
        assert equal(values, getattr(threaded, name)), name
        assert equal(values[shuffled], getattr(mixed, name)), name
        for few in (everything[:1], everything[40:47]):
            assert equal(values[few], getattr(run(few), name)), name


@pytest.mark.compiled
def test_a_batch_measures_what_its_trajectories_show(drives, rng):
    tunings, indices, seeds = random_runs(rng, 6)
    plant, mpc = at.DualTrack(CAR), at.published_mpc(CAR, preview=True)
    driven_on = {"profile": "road", "driver": at.Driver(), "failure": at.FailureLimits(1000.0, math.inf)}
    batch = at.rollout_batch(plant, mpc, drives, tunings, scenario_indices=indices, seeds=seeds, **driven_on)
    for i in range(6):
        Np, Nc, Q, R = tunings[i]
        single = at.published_mpc(CAR, at.Tuning(int(Np), int(min(Nc, Np)), Q, R), preview=True)
        run = at.rollout(plant, single, drives[indices[i]], seed=int(seeds[i]), **driven_on)
        error = run.Y - run.y_ref
        assert batch.mse[i] == pytest.approx(np.mean(error**2), rel=1e-12)
        assert batch.max_abs_error[i] == np.abs(error).max()
        assert batch.mean_squared_move[i] == pytest.approx(np.mean(run.command_change**2), rel=1e-12)
        assert batch.steps[i] == len(run.t)
        assert batch.limited[i] == np.count_nonzero(run.diagnostics["at_limit"])
        assert batch.held[i] == np.count_nonzero(run.held)
        assert batch.qp_iterations[i] == run.diagnostics["qp_iterations"].sum()
        assert batch.cost(3.0)[i] == pytest.approx(batch.mse[i] + 3.0 * batch.mean_squared_move[i])


# -- noise ------------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_counted_noise_is_standard_normal_and_without_memory():
    draws = np.array(
        [[counted_normal(seed, k, c) for c in range(4)] for seed in range(20) for k in range(500)]
    ).reshape(20, 500, 4)
    flat = draws.ravel()
    assert abs(flat.mean()) < 4 / math.sqrt(flat.size)
    assert flat.var() == pytest.approx(1.0, abs=4 * math.sqrt(2 / flat.size))
    assert np.mean(np.abs(flat) < 1.0) == pytest.approx(0.6827, abs=0.01)
    assert np.abs(flat).max() < 6.0
    for axis in range(3):  # seeds, instants and channels say nothing about each other
        ahead, behind = (
            np.take(draws, span, axis).ravel() for span in (range(1, draws.shape[axis]), range(draws.shape[axis] - 1))
        )
        assert abs(np.corrcoef(ahead, behind)[0, 1]) < 0.03


@pytest.mark.compiled
def test_noise_depends_on_the_seed_alone():
    plant, mpc = at.SingleTrack(CAR), at.published_mpc(CAR, CALM)
    first, again, other = (at.simulate(plant, mpc, SHORT, profile="road", seed=seed) for seed in (1, 1, 2))
    assert same(first, again)
    assert not np.array_equal(first.command, other.command)
    quiet = [at.simulate(plant, mpc, SHORT, profile="paper", seed=seed) for seed in (1, 2)]
    assert same(*quiet)


@pytest.mark.compiled
def test_the_first_commands_see_only_the_noise_of_their_instant():
    noisy = at.load_profile("paper").replace(name="noisy", noise_y=0.1)
    run = at.simulate(at.SingleTrack(CAR), at.published_mpc(CAR, CALM), straight_then(), profile=noisy, seed=11)
    noise = 0.1 * counted_normal(11, 0, 3)
    assert run.command[0] == at.published_mpc(CAR, CALM).step([0, 0, 0, noise], 15.0, [0.0]).angle
    assert run.Y[0] == 0.0  # the car itself is where it is


# -- symmetry ---------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
@pytest.mark.parametrize("driver", [None, at.Driver()], ids=["prescribed", "driver"])
def test_the_mirrored_scenario_gives_the_mirrored_trajectory(plant, driver):
    scenario = at.load_scenario("double-lane-change", friction=[0.9, 0.6], wind=[2.0, 6.0], start_y=0.3)
    car, mpc = plant(CAR, "passenger-car"), at.published_mpc(CAR, CALM)
    left, there = (at.rollout(car, mpc, road, driver=driver) for road in (scenario, scenario.mirrored()))
    for name in ("X", "vx"):
        np.testing.assert_allclose(getattr(there, name), getattr(left, name), rtol=1e-9)
    for name in ("Y", "psi", "vy", "yaw_rate", "steering", "command", "lateral_acceleration"):
        np.testing.assert_allclose(getattr(there, name), -getattr(left, name), rtol=0, atol=1e-7)
    assert np.abs(left.Y).max() > 1.0


# -- failed runs ------------------------------------------------------------------------------------------------------
def test_a_failed_run_ends_with_not_a_number_and_says_so():
    leaving = straight_then(reference=ramp(0.0, 20.0, start=0.5, duration=1.0), duration=2.0)
    rule = at.FailureLimits(distance=2.0)
    run = at.simulate(at.SingleTrack(CAR), at.published_mpc(CAR, CALM), leaving, failure=rule)
    assert run.failed == Reason.OFF_ROAD
    first = round(run.failed_at / run.period)
    assert 5 < first < 19
    gone = np.isnan(run.Y)
    assert gone[first + 1 :].all()
    assert not gone[: first + 1].any()  # the instant of the failure is on record
    assert np.isnan(run.command[first:]).all()
    assert np.isfinite(run.command[:first]).all()
    assert (run.diagnostics["qp_status"][first:] == QPStatus.NON_FINITE).all()
    assert run.held[first:].all()
    assert not run.held[:first].any()
    assert np.abs(run.error[:first]).max() <= 2.0 < np.abs(run.error[first])
    again = at.rollout(at.SingleTrack(CAR), at.published_mpc(CAR, CALM), leaving, failure=rule)
    assert same(run, again)
    assert (again.failed, again.failed_at) == (run.failed, run.failed_at)


def drifts(x, u, environment, p, dx):
    """Slides to the side ever faster, and stays on its line all the same."""
    for i in range(6):
        dx[i] = 0.0
    dx[0], dx[4] = x[3], 12.0


def breaks(x, u, environment, p, dx):
    """Its yaw rate is no number from 6 m on."""
    for i in range(6):
        dx[i] = 0.0
    dx[0] = x[3]
    dx[5] = math.inf if x[0] > 6.0 else 0.0


@functools.cache  # compiled once
def driven_by(right_hand_side):
    return at.UserPlant(right_hand_side, {}, mass=1000.0)


LEAVING = straight_then(reference=ramp(0.0, 40.0, start=0.5, duration=1.0), duration=3.0)
FAR_AWAY = straight_then(reference=50.0, start_y=0.0, duration=1.0)
FAILURES = {
    "off the road": (lambda: at.SingleTrack(CAR), LEAVING, Reason.OFF_ROAD),
    "never there": (lambda: at.SingleTrack(CAR), FAR_AWAY, Reason.OFF_ROAD),
    "spun": (lambda: driven_by(drifts), straight_then(duration=2.0), Reason.SPUN),
    "not finite": (lambda: driven_by(breaks), straight_then(duration=2.0), Reason.NOT_FINITE),
}
NO_RULE = at.FailureLimits(distance=math.inf, sideslip=math.inf)


@pytest.mark.parametrize("profile", ["paper", "road"])
@pytest.mark.parametrize("kind", FAILURES)
def test_both_drivers_batches_and_the_rule_for_records_agree_on_why_and_when_a_run_failed(kind, profile):
    make, scenario, reason = FAILURES[kind]
    plant, mpc = make(), at.published_mpc(CAR, at.Tuning(15, 3, 1.0, 300.0))
    run, again = (drive(plant, mpc, scenario, profile=profile) for drive in (at.simulate, at.rollout))
    assert same(run, again)
    assert run.failed == again.failed == reason
    assert run.failed_at == again.failed_at
    failure = find_failure(run)
    assert (failure.reason, failure.time) == (reason, pytest.approx(run.failed_at, abs=1e-12))
    batch = at.rollout_batch(plant, mpc, [scenario, scenario], profile=profile)
    assert batch.failed.tolist() == [reason, reason]
    assert batch.failed_at.tolist() == [run.failed_at] * 2
    assert np.isinf(batch.mse).all()
    if kind == "never there":
        assert run.failed_at == 0.0
        assert np.isfinite(run.Y).all()  # nobody knew before the end
    elif reason is not Reason.NOT_FINITE:
        assert (batch.steps == failure.step).all()
        driven_on = at.rollout(plant, mpc, scenario, profile=profile, failure=NO_RULE)
        assert driven_on.failed is None
        assert np.array_equal(driven_on.Y[: failure.step + 1], run.Y[: failure.step + 1])
        afterwards = find_failure(driven_on)
        assert (afterwards.step, afterwards.reason) == (failure.step, reason)


def test_a_compiled_run_tells_tuning_from_diagnostics_of_one_name():
    """Both have `heading_error`: the weight, and the error itself."""
    controller = at.KinematicMPC(CAR)
    assert set(controller.tuning_names) & set(controller.diagnostic_names)
    assert same(*(drive(at.DualTrack(CAR), controller, SHORT) for drive in (at.simulate, at.rollout)))


def test_a_run_that_failed_is_judged_at_each_instant_and_not_after_the_last():
    def times(rule):
        return at.simulate(at.SingleTrack(CAR), at.published_mpc(CAR, CALM), LEAVING, failure=rule).failed_at

    near, late = times(at.FailureLimits(distance=2.0)), times(at.FailureLimits(distance=5.0))
    assert 0.5 < near < late < 2.0
    assert math.isnan(times(at.FailureLimits(distance=50.0)))


def scripted(*angles):
    """A controller that plays angles (rad), the last of them to the end."""
    return Scripted(lambda t: angles[min(round(t / 0.1), len(angles) - 1)], period=0.1)


def test_any_controller_drives_and_its_record_says_what_it_did():
    run = at.simulate(at.SingleTrack(CAR), scripted(0.0, 0.01, 0.02), straight_then(duration=0.5))
    assert run.command.tolist() == [0.0, 0.01, 0.02, 0.02, 0.02]
    assert run.command_change.tolist() == [0.0, 0.01, 0.01, 0.0, 0.0]
    assert not run.held.any()
    assert run.tuning == {}
    assert run.diagnostics == {}
    assert run.meta["controller"] == "scripted"
    assert run.meta["control"] == {"period": 0.1}
    with pytest.raises(at.InvalidInput, match="compiled"):
        at.rollout(at.SingleTrack(CAR), scripted(0.0), straight_then())


@pytest.mark.parametrize("angle", [math.nan, math.inf, -math.inf])
def test_a_command_that_is_not_finite_ends_the_run_when_it_is_given(angle):
    run = at.simulate(at.SingleTrack(CAR), scripted(0.0, 0.01, angle), straight_then(duration=1.0))
    failure = find_failure(run)
    assert (run.failed, failure.reason) == (Reason.NOT_FINITE, Reason.NOT_FINITE)
    assert run.failed_at == pytest.approx(0.2)
    assert (failure.step, failure.time) == (2, pytest.approx(0.2))


# -- what is known of friction and wind -------------------------------------------------------------------------------
@functools.cache
def by_friction_and_wind():
    """R rises where it is slippery and where the wind blows."""
    axes = {"friction": [0.3, 1.0], "wind": [-30.0, 30.0]}
    tunings = np.empty((2, 2, 4))
    tunings[..., 0], tunings[..., 1], tunings[..., 2] = 20.0, 4.0, 1.0
    tunings[..., 3] = [[9000.0, 5000.0], [3000.0, 1000.0]]
    return at.Lookup(axes, tunings)


WINDY = SHORT.replace(friction=(0.9, 0.5), wind=(1.0, -8.0))
KNOWN = {
    "exactly": None, "withheld": at.Perception(withheld=True),
    "with errors": at.Perception(noise=0.1, bias=0.2, delay=0.2),
    "estimated": at.FrictionWindEstimator.of(at.DualTrack(CAR), "road"),
}  # fmt: skip


def known_run(drive, conditions, **options):
    mpc = at.published_mpc(CAR, period=ROAD.period, preview=True, scheduler=by_friction_and_wind())
    return drive(at.DualTrack(CAR), mpc, WINDY, profile="road", perception=KNOWN[conditions], **options)


@pytest.mark.parametrize("conditions", KNOWN)
def test_what_a_scheduler_knows_is_the_same_in_both_drivers_and_in_batches(conditions):
    run = known_run(at.simulate, conditions, seed=3)
    assert same(run, known_run(at.rollout, conditions, seed=3))
    batch = known_run(at.rollout_batch, conditions, seeds=3)
    assert batch.mse[0] == pytest.approx(np.mean(run.error**2), rel=1e-12)
    assert (np.ptp(run.tuning["R"]) > 0.0) == (conditions in ("with errors", "estimated"))


# -- what the profile stands for --------------------------------------------------------------------------------------


def test_a_plants_own_actuator_stands_before_the_profiles():
    lagging = at.SingleTrack(CAR, steering=at.SteeringActuator(lag=0.3))
    run = at.simulate(lagging, at.published_mpc(CAR, CALM), SHORT, profile="paper")
    assert np.abs(run.steering - run.command).max() > 1e-3


# -- speed ------------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("name", ["triple-lane-change", "general-trajectory"])
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
def test_a_prescribed_speed_is_followed_exactly(name, plant):
    run = at.rollout(plant(CAR, "constant-stiffness"), at.published_mpc(CAR), at.load_scenario(name))
    assert np.abs(run.vx - run.v_ref).max() < 1e-9


@pytest.mark.compiled
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
def test_the_driver_follows_a_ramp_of_speed(plant):
    faster = straight_then(speed=ramp(10.0, 20.0, start=3.0, duration=10.0), duration=25.0)
    run = at.rollout(plant(CAR), at.published_mpc(CAR), faster, driver=at.Driver())
    behind = run.v_ref - run.vx
    assert np.abs(behind).max() < 0.4
    assert np.abs(behind[-20:]).max() < 0.02  # drag and rolling resistance are what the integral is for


@pytest.mark.compiled
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
def test_at_top_speed_the_engine_gives_what_drag_and_rolling_take(plant):
    run = at.rollout(plant(CAR), at.published_mpc(CAR), straight_then(speed=75.0, duration=150.0), driver=at.Driver())
    drag = 0.5 * CAR.air_density * CAR.frontal_area * CAR.drag_coefficient
    rolling = CAR.rolling_resistance * CAR.mass * GRAVITY
    top = np.roots([drag, 0.0, rolling, -CAR.engine_power])
    assert run.vx[-1] == pytest.approx(top[np.isreal(top)].real.max(), rel=1e-3)


@pytest.mark.compiled
def test_the_driver_brakes_no_harder_than_brakes_and_accelerates_no_harder_than_traction():
    weak = CAR.replace(brake_limit=3000.0, traction_limit=2000.0, frontal_area=0.0, rolling_resistance=0.0)
    down = straight_then(speed=ramp(25.0, 5.0, start=0.5, duration=0.5), duration=5.0)
    up = straight_then(speed=ramp(5.0, 25.0, start=0.5, duration=0.5), duration=5.0)
    braking, driving = (
        at.rollout(at.DualTrack(weak), at.published_mpc(CAR), road, driver=at.Driver()) for road in (down, up)
    )
    assert np.diff(braking.vx).min() / 0.1 == pytest.approx(-3000.0 / CAR.mass, rel=1e-6)
    assert np.diff(driving.vx).max() / 0.1 == pytest.approx(2000.0 / CAR.mass, rel=1e-6)


@pytest.mark.compiled
def test_the_drivers_integral_does_not_wind_up_behind_a_limit():
    weak = CAR.replace(traction_limit=1000.0)
    road = straight_then(speed=ramp(10.0, 20.0, start=1.0, duration=0.5), duration=60.0)
    run = at.rollout(at.DualTrack(weak), at.published_mpc(CAR), road, driver=at.Driver())
    assert run.vx.max() < 20.3
    assert run.vx[-1] == pytest.approx(20.0, abs=0.02)


@pytest.mark.compiled
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
def test_a_car_that_is_told_to_stop_stands(plant):
    stop = straight_then(speed=ramp(10.0, 0.0, start=1.0, duration=5.0), duration=20.0)
    run = at.rollout(plant(CAR), at.published_mpc(CAR), stop, driver=at.Driver())
    assert run.vx.min() > -0.05
    assert np.abs(run.vx[-20:]).max() < 0.02
    assert np.ptp(run.X[-20:]) < 0.02


@pytest.mark.parametrize(
    ("wheel", "side"), [("front-left", -1), ("rear-left", -1), ("front-right", 1), ("rear-right", 1)]
)
def test_each_wheel_has_the_friction_of_its_own_track(wheel, side):
    braking = straight_then(
        speed=ramp(20.0, 0.0, start=0.0, duration=2.0),
        friction_patches=[{"start": 0.0, "end": 9.0, "friction": 0.05, "wheels": wheel}],
        duration=1.0,
    )
    fixed = at.published_mpc(CAR, limits=at.Limits(move=(0.0, 0.0)))  # a controller that may not steer
    run = at.simulate(at.DualTrack(CAR), fixed, braking, driver=at.Driver())
    assert (run.command == 0.0).all()
    assert side * run.yaw_rate[-1] > 1e-3  # the wheels with grip hold their side back


def test_the_controller_sees_the_cars_speed_and_the_scheduler_its_variables():
    samples = []

    def watch(variables):
        samples.append(variables)
        return CALM

    scenario = SHORT.replace(friction=(0.9, 0.5), wind=(1.0, -4.0))
    run = at.simulate(at.SingleTrack(CAR), at.published_mpc(CAR, scheduler=watch), scenario, driver=at.Driver())
    assert len(samples) == len(run.t)
    for k in (0, 7, 14):
        assert isinstance(samples[k], at.SchedulingVariables)
        assert samples[k].speed == run.vx[k]
        assert samples[k].y_ref == run.y_ref[k]
        assert samples[k].friction == pytest.approx(0.7)
        assert samples[k].wind == -4.0


# -- tracking ---------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
@pytest.mark.parametrize("moves", [at.Moves.pulses(), at.Moves.laguerre(0.75)], ids=["pulse", "laguerre"])
@pytest.mark.parametrize("wind", [0.0, 12.0, -25.0])
def test_a_step_is_reached_without_steady_state_error_in_any_constant_wind(plant, moves, wind):
    step = at.load_scenario("step", amplitude=1.0, wind=wind, duration=30.0)
    run = at.rollout(plant(CAR), at.published_mpc(CAR, CALM, moves=moves), step)
    assert np.abs(run.error[-20:]).max() < 1e-4
    assert np.abs(run.command[-1]) > 1e-3 or wind == 0.0
    assert (run.diagnostics["qp_status"] == QPStatus.SOLVED).all()


def test_the_recorded_acceleration_is_that_of_the_recorded_motion():
    run = at.simulate(at.SingleTrack(CAR), at.published_mpc(CAR, CALM, period=0.005), SHORT.with_duration(0.6))
    change = np.diff(run.vy) / run.period  # over the period that begins with the recorded instant
    assert run.lateral_acceleration[:-1] == pytest.approx(change + (run.vx * run.yaw_rate)[:-1], abs=0.1)
    assert np.abs(run.lateral_acceleration).max() > 2.0


# -- accuracy ---------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("profile", ["paper", "road"])
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
@pytest.mark.parametrize("tyre", ["magic-formula", "constant-stiffness", "passenger-car"])
def test_the_default_steps_leave_less_than_a_millimetre(profile, plant, tyre):
    car = CAR if tyre != "passenger-car" else at.load_vehicle("midsize-sedan")
    mpc, paths = controller(profile, car), []
    for steps in (None, 200):
        run = at.rollout(plant(car, tyre, steps=steps), mpc, LANE_CHANGE, profile=profile, driver=at.Driver())
        paths.append(np.column_stack([run.X, run.Y]))
    assert np.hypot(*(paths[0] - paths[1]).T).max() < 1e-3


# -- records and refusals ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [
    {"tunings": [[35, 8, 10]]},
    {"tunings": [[35, 8, 10, math.nan]]},
    {"tunings": [[[35, 8, 10, 1]]]},
    {"scenario_indices": [1]},
    {"scenario_indices": [-1]},
    {"scenario_indices": [0, 0]},
    {"scenarios": []},
    {"controller": at.published_mpc(CAR, scheduler=lambda variables: CALM)},
    {"controller": at.published_mpc(CAR, solver=Daqp())},
    {"controller": at.published_mpc(CAR, scheduler=at.Constant(CALM))},
    {"controller": None},
    {"failure": 5.0},
    {"perception": at.FrictionWindEstimator(CAR, period=0.05)},
    {"seeds": [1, 2, 3]},
], ids=lambda arguments: next(iter(arguments)))  # fmt: skip
def test_a_batch_refuses_what_does_not_fit(arguments):
    options = {
        "plant": at.SingleTrack(CAR),
        "controller": at.published_mpc(CAR),
        "scenarios": SHORT,
        "tunings": [CALM.as_array()],
    } | arguments
    with pytest.raises(at.InvalidInput):
        at.rollout_batch(**options)


def test_a_run_starts_where_the_scenario_says():
    scenario = straight_then(start_y=0.4, start_heading=0.05, speed=12.0, duration=0.3)
    run = at.simulate(at.SingleTrack(CAR), at.published_mpc(CAR), scenario)
    assert (run.X[0], run.Y[0], run.psi[0], run.vx[0]) == (0.0, 0.4, 0.05, 12.0)
