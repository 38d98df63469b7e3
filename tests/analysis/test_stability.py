"""The linear closed loop: its eigenvalues foretell what simulations show."""

import math
from itertools import product

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator
from scipy.optimize import brentq

import adaptrack as at
from adaptrack.analysis.linearisation import (
    EstimatorAt,
    LinearControllers,
    Mismatch,
    SampleAges,
    Sampled,
    laws,
    linear_estimator,
    linearised,
    sampled,
    sensed,
    steady_turn,
)
from adaptrack.analysis.stability import hard_turn, loop_map, loops, margins, modulus_margin
from adaptrack.core.maths.portable import spectral_radius
from adaptrack.scenario import Wind
from adaptrack.tuning.runs import RunSet
from linear_loops import loop_radius

pytestmark = pytest.mark.compiled
CAR = at.load_vehicle("paper")
PAPER, ROAD = at.load_profile("paper"), at.load_profile("road")
QUIET = ROAD.replace(noise_vy=0.0, noise_yaw=0.0, noise_yaw_rate=0.0, noise_y=0.0)
PLANT, ROAD_MPC = at.DualTrack(CAR, "magic-formula"), at.published_mpc(CAR, period=0.05)
INFORMED = at.MPC(CAR, profile="road")


def straight_and_turn(speed, friction):
    """The sampled car on a straight road and in a hard turn."""
    turns = (0.0, hard_turn(speed, friction))
    return [sampled(PLANT, 0.05, speed, friction=friction, profile="road", lateral_acceleration=a) for a in turns]


def some_tunings(seed, n):
    rng = np.random.default_rng(seed)
    Np = rng.integers(10, 61, n)
    return np.column_stack(
        [Np, np.minimum(rng.integers(1, 21, n), Np), rng.uniform(0.5, 2.0, n), 10 ** rng.uniform(2, 5.5, n)]
    )


@pytest.mark.parametrize(("tuning", "ages"), [
    *((tuning, {}) for tuning in ((35, 5, 1.0, 1e4), (28, 8, 1.0, 2800.0), (40, 2, 1.0, 2000.0))),
    ((12, 2, 1.0, 3e3), {}),
    ((35, 5, 1.0, 1e4), {"pose_age": 0.07, "motion_age": 0.03}),
    ((35, 5, 1.0, 1e4), {"pose_age": 0.1}),
])  # fmt: skip
@pytest.mark.parametrize("speed", [12.0, 24.0])
def test_in_the_simulator_a_tiny_offset_goes_the_way_of_the_matrix(tuning, ages, speed):
    """Whether it dies or grows: so it does at the rate of the spectral radius."""
    offset = 1e-7
    scenario = at.Scenario(
        name="offset", duration=20.0, reference=0.0, speed=speed, friction=0.75, wind=Wind(y=0.0), start_y=offset
    )
    mpc = at.published_mpc(CAR, at.Tuning(*tuning), period=0.05)
    run = at.rollout(
        PLANT, mpc, scenario, profile=QUIET.replace(**ages), failure=at.FailureLimits(math.inf, math.inf)
    ).Y
    law = laws(mpc, speed, tuning)
    body, prompt = (sampled(PLANT, 0.05, speed, friction=0.75, profile=p) for p in (ROAD.replace(**ages), ROAD))
    matrix, size = loops(body, law)[0], len(prompt.b)
    z = np.zeros(len(matrix))
    z[:size] = offset * prompt.c[3]
    for _ in range(2):  # it was there before
        z[size:-1] = (body.a @ z[:-1])[size:]
    z[-1] = -law.k[0, 3] / law.k[0, 4] * offset  # the sum of y that makes the last command zero
    foretold = [z := z if i == 0 else matrix @ z for i in range(len(run))] @ np.append(
        prompt.c[3], np.zeros(len(z) - size)
    )
    small = np.maximum.accumulate(np.abs(foretold)) < 1e-3  # tyres are linear
    np.testing.assert_allclose(run[small], foretold[small], atol=2e-4 * np.abs(foretold[small]).max())
    # its last 8 s obey a linear recurrence, whose slowest mode is the rate
    tail = run[small][-160:]
    rows = np.lib.stride_tricks.sliding_window_view(tail, 5)
    coefficients = np.linalg.lstsq(rows[:, :4], rows[:, 4])[0]
    rate = np.abs(np.roots([1.0, *-coefficients[::-1]])).max()
    assert rate == pytest.approx(spectral_radius(matrix), abs=1e-3)


@pytest.mark.parametrize("speed", [8.0, 24.0])
def test_samples_that_are_all_late_act_as_dead_time_of_the_commands(speed):
    """The controller without an estimator knows of neither, and in a loop it does not matter where the delay is."""
    tuning, late = at.Tuning(35, 5, 1.0, 1e4).as_array(), ROAD.replace(pose_age=0.1, motion_age=0.1)
    law = laws(ROAD_MPC, speed, tuning)
    by_samples = margins(sampled(PLANT, 0.05, speed, profile=late), law, 0.05)
    by_commands = margins(sampled(PLANT, 0.05, speed, profile="road", delay=0.1), law, 0.05)
    for name in ("radius", "gain_up", "gain_down", "delay", "modulus_margin"):
        np.testing.assert_allclose(getattr(by_samples, name), getattr(by_commands, name), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("ages", [(0.0, 0.0), (0.1, 0.0), (0.12, 0.0), (0.1, 0.1), (0.12, 0.12)])
def test_the_linear_estimator_is_the_filter_with_samples_of_these_ages(ages, rng):
    """Over a second of small random measurements and commands, after the filter has settled."""
    filtering = EstimatorAt(at.MPC(CAR, profile="production"), 15.0, SampleAges(*ages))
    linear, memory = filtering.straight, np.zeros(filtering._memory)
    for k in range(4000):
        filtering._step(np.array([*[(-1) ** k * 1e-30] * 6, *ages, 0.0]), 0.0, memory)
    s = np.zeros(len(linear.a))
    for _ in range(20):
        m = np.array([*1e-5 * rng.normal(size=6), *ages])
        m[0] = 0.0  # not measured
        result = filtering._answer(0.0, np.concatenate([memory, m, [s[-1]]]))
        xi = linear.c @ s + linear.d @ np.array([*m[:6], 0.0, 0.0])
        np.testing.assert_allclose(result[filtering._memory :], xi, atol=1e-9)
        u = 1e-5 * rng.normal()
        s = linear.a @ s + linear.e @ np.array([*m[:6], 0.0, 0.0]) + linear.f * u
        memory = result[: filtering._memory]


# -- the steady turn --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "plant", [PLANT, at.SingleTrack(CAR, "magic-formula"), at.DualTrack(at.load_vehicle("midsize-sedan"))]
)
def test_in_a_steady_turn_nothing_changes_but_place_and_heading(plant):
    for speed, friction in product((3.0, 12.0, 30.0), (0.3, 1.0)):
        acceleration = hard_turn(speed, friction)
        *_, x, steering = steady_turn(plant, speed, acceleration, friction)
        slope = plant.derivative(x, [steering, 0.0], [friction] * 4 + [0.0, 0.0])
        still = [i for i, name in enumerate(plant.state_names) if name not in ("X", "Y", "psi", "vx", "felt_ax")]
        np.testing.assert_allclose(slope[still], 0.0, atol=1e-6)
        assert slope[2] * speed == pytest.approx(acceleration)
        assert slope[1] == pytest.approx(0.0, abs=1e-9)  # the velocity points along X
        assert steering > 0.0
        *_, mirrored, opposite = steady_turn(plant, speed, -acceleration, friction)
        assert opposite == pytest.approx(-steering)
        assert mirrored[5] == pytest.approx(-x[5])


def test_in_a_turn_tyres_are_softer_and_an_aggressive_loop_becomes_unstable():
    aggressive, sound = at.Tuning(28, 8, 1.0, 2800.0), at.Tuning(38, 4, 1.0, 8000.0)
    for tuning, unstable in ((aggressive, True), (sound, False)):
        assert loop_radius(PLANT, ROAD_MPC, 24.0, tuning=tuning, profile="road") < 1.0
        turn = hard_turn(24.0, 0.6)
        radius = loop_radius(
            PLANT, ROAD_MPC, 24.0, tuning=tuning, friction=0.6, profile="road", lateral_acceleration=turn
        )
        assert (radius > 1.0) is unstable
    for wheel, share in (("front_left", 0.8), ("rear_right", 0.8)):
        slopes = []
        for turn in (0.0, hard_turn(24.0, 0.6)):
            names, a, _ = linearised(PLANT, 24.0, 0.6, turn)
            slopes.append(abs(a[names.index("yaw_rate"), names.index(f"slip_{wheel}")]))
        assert slopes[1] < share * slopes[0]


def test_the_relaxation_of_its_tyres_makes_the_vans_loop_unstable_unless_the_model_contains_it():
    van, profile = at.load_vehicle("van"), at.load_profile("production").without_sample_ages
    plant, mpc = at.DualTrack(van), at.MPC(van, profile=profile)
    relaxation = mpc.model.dead_time - profile.dead_time
    unaware = at.MPC(
        van, profile=profile, belief=at.Steering(lag=0.2, dead_time=profile.steering.dead_time - relaxation)
    )
    assert unaware.model.dead_time == pytest.approx(profile.dead_time)
    rigid = at.DualTrack(van, plant.tyre.replace(relaxation_length=0.0))
    stable = {
        (tyres, model): loop_radius(car, controller, 27.0, profile=profile) < 1.0
        for tyres, car in (("relaxing", plant), ("rigid", rigid))
        for model, controller in (("aware", mpc), ("unaware", unaware))
    }
    assert [loop for loop, is_stable in stable.items() if not is_stable] == [("relaxing", "unaware")]
    assert at.MPC(van, profile="road").model.dead_time == ROAD.dead_time  # the lateral velocity is measured


def wandering(x, u, environment, p, dx):
    """A car whose own state runs away, unseen."""
    vy, r, vx = x[4], x[5], x[3]
    dx[0], dx[1], dx[2], dx[3] = (
        vx * math.cos(x[2]) - vy * math.sin(x[2]), vx * math.sin(x[2]) + vy * math.cos(x[2]), r, 0.0,
    )  # fmt: skip
    front, rear = p[0] * (u[0] - (vy + 1.2 * r) / vx), p[1] * (-(vy - 1.6 * r) / vx)
    dx[4], dx[5] = (front + rear) / p[2] - vx * r, (1.2 * front - 1.6 * rear) / 2875.0
    dx[6] = x[6] + vy


def test_a_mode_that_never_reaches_what_is_measured_does_not_count():
    plant = at.UserPlant(wandering, {"cf": 38000.0, "cr": 66000.0, "mass": 1575.0}, mass=1575.0, own_states=("unseen",))
    names, _, _ = linearised(plant, 15.0)
    assert "unseen" not in names
    assert "X" not in names
    assert loop_radius(plant, at.published_mpc(CAR, at.Tuning(35, 8, 1.0, 100.0)), 15.0) < 1.0


class Stepped(at.SteppedPlant):
    def reset(self, motion):
        self.motion = motion

    def step(self, dt, steering, acceleration, environment):
        return self.motion


def test_what_has_no_linear_loop_is_refused():
    with pytest.raises(at.InvalidInput, match="stepped"):
        sampled(Stepped(), 0.05, 15.0)
    with pytest.raises(at.InvalidInput, match=r"2 periods before it is given"):
        sampled(PLANT, 0.05, 15.0, profile="paper", delay=-0.1)
    with pytest.raises(
        at.InvalidInput, match=r"samples are 0.1 s old, and the controller's filter takes in none older"
    ):
        loop_radius(PLANT, INFORMED, 15.0, profile="production")
    feels = at.MPC(
        CAR,
        period=0.05,
        model=at.PathModel(CAR, 0.05, 0.1),
        estimator=at.KalmanFilter(at.SensorNoise(wheel_angle=0.01)),
    )
    with pytest.raises(at.InvalidInput, match="reads wheel_angle"):
        loop_radius(PLANT, feels, 15.0, profile="paper")


# -- margins ----------------------------------------------------------------------------------------------------------
def lagging(pole, gain):
    """A body y(k+1) = pole y(k) + u(k) and the law u = w, w growing by -gain y: L = gain / ((z - pole)(z - 1))."""
    y = np.zeros((len(sensed()), 1))
    y[3] = 1.0
    law = LinearControllers(linear_estimator(at.published_mpc(CAR), 10.0), np.array([[0, 0, 0, -gain, gain]]))
    return Sampled(np.array([[pole]]), np.ones(1), y), law


@pytest.mark.parametrize(("pole", "gain"), [(0.0, 0.4), (0.5, 0.1), (0.9, 0.02), (-0.3, 0.7)])
def test_margins_are_those_of_an_analytic_loop(pole, gain):
    """z^2 - (1 + pole) z + pole + g gain has its roots inside the unit circle for 0 < g < (1 - pole)/gain."""
    result = margins(*lagging(pole, gain), 0.1)
    assert result.gain_up[0] == pytest.approx((1.0 - pole) / gain, rel=1e-3)
    assert result.gain_down[0] == 0.0

    def size(angle):
        z = np.exp(1j * angle)
        return abs(gain / ((z - pole) * (z - 1.0))) - 1.0

    angle = brentq(size, 1e-3, np.pi)
    phase = np.pi - (angle + np.pi) / 2.0 - np.angle(np.exp(1j * angle) - pole)
    assert result.delay[0] == pytest.approx(0.1 * phase / angle, rel=1e-3)
    roots = np.roots([1.0, -(1.0 + pole), pole + gain])
    assert result.radius[0] == pytest.approx(np.abs(roots).max())
    z = np.exp(1j * np.linspace(1e-3, np.pi, 200_000))
    distance = np.abs(1.0 + gain / ((z - pole) * (z - 1.0))).min()
    assert result.modulus_margin[0] == pytest.approx(min(distance, 1.0), abs=1e-4)


@pytest.mark.parametrize("mpc", [ROAD_MPC, INFORMED], ids=["published", "informed"])
@pytest.mark.parametrize("turning", [False, True])
def test_at_its_margins_the_cars_loop_is_at_the_verge(turning, mpc):
    tunings = some_tunings(3, 60)
    if mpc is INFORMED:
        tunings[:, 3] *= 1e-2
    for speed in (6.0, 16.0, 26.0):
        options = {
            "friction": 0.7, "profile": "road", "lateral_acceleration": hard_turn(speed, 0.7) if turning else 0.0,
        }  # fmt: skip
        k = laws(mpc, speed, tunings)
        body = sampled(PLANT, 0.05, speed, **options)
        result = margins(body, k, 0.05)
        stable = np.flatnonzero(result.radius < 0.995)[:8]
        assert len(stable) >= 4
        for i in stable:
            law = LinearControllers(k.estimator, k.k[i : i + 1])
            for factor in (result.gain_up[i], result.gain_down[i]):
                assert spectral_radius(loops(body._replace(b=factor * body.b), law))[0] == pytest.approx(1.0, abs=2e-4)
            for share, stays in ((0.9, True), (1.1, False)):
                late = sampled(PLANT, 0.05, speed, **options, delay=share * result.delay[i])
                assert (spectral_radius(loops(late, law))[0] < 1.0) is np.bool_(stays)
            for factor in np.linspace(result.gain_down[i], result.gain_up[i], 9)[1:-1]:
                assert spectral_radius(loops(body._replace(b=factor * body.b), law))[0] < 1.0


@pytest.mark.parametrize("profile", [PAPER, ROAD])
def test_a_fractional_delay_is_what_commands_do_that_change_within_the_period(profile):
    """Against the same plant sampled ten times as often, each command held for ten samples, three samples late."""
    period, x = 0.1, np.random.default_rng(5).normal(size=12)
    late = sampled(PLANT, period, 15.0, profile=profile.replace(delay=0), delay=0.3 * period)
    fine = sampled(PLANT, period / 10, 15.0, profile=profile.replace(delay=0))
    n = len(fine.b)
    z, state, before = np.append(x[:n], 0.3), x[:n], 0.3
    for command in (1.0, -0.5, 0.2):
        z = late.a @ z + late.b * command
        for sample in range(10):
            state = fine.a @ state + fine.b * (before if sample < 3 else command)
        before = command
    np.testing.assert_allclose(z[:n], state, rtol=1e-8, atol=1e-8)


# -- the controller that knows its car --------------------------------------------------------------------------------
ROAD_SENSORS, WITHOUT_VY = at.SensorNoise(), at.SensorNoise(vy=math.inf, yaw_rate=0.002, wheel_angle=0.002)


def sensed_row(measured):
    """What a controller is given: the states that are measured, and nothing of other sensors."""
    return np.append(measured, np.zeros(len(sensed()) - len(measured)))


def informed_mpc(lag=0.15, dead_time=0.05, noise=ROAD_SENSORS, moves=None):
    model = at.PathModel(CAR, 0.05, lag, dead_time)
    return at.MPC(
        CAR, at.Tuning(25, 6, 1.0, 4.0), period=0.05, model=model, estimator=at.KalmanFilter(noise, settling=math.inf),
        moves=moves,
    )  # fmt: skip


def as_measured(speed, measured, command, a, b, parameters, memory, x, d):
    for i in range(4):
        x[i], d[i] = measured[i], 0.0


def smoothed(speed, measured, command, a, b, parameters, memory, x, d):
    for i in range(4):
        memory[i] += parameters[0] * (measured[i] - memory[i])
        x[i], d[i] = memory[i], 0.0


def with_estimator(of):
    return at.MPC(CAR, at.Tuning(25, 6, 1.0, 4000.0), period=0.05, estimator=of)


@pytest.mark.parametrize("mpc", [
    ROAD_MPC, informed_mpc(), informed_mpc(0.2, 0.13, WITHOUT_VY), informed_mpc(moves=at.Moves.laguerre(0.8, 4)),
    with_estimator(at.UserEstimator(as_measured)),
    with_estimator(at.UserEstimator(smoothed, parameters={"share": 0.3}, memory_size=4)),
])  # fmt: skip
def test_the_law_gives_the_commands_of_the_controller(mpc):
    """Its own steps, settled, for small measurements; the QP far from its limits."""
    speed, rng = 15.0, np.random.default_rng(9)
    law = laws(mpc, speed, mpc.tuning.as_array())
    estimator, gain = law.estimator, law.k[0]
    mpc.reset()
    for k in range(1500):
        mpc.step(np.full(5, 1e-30 * (-1.0) ** k), speed, [0.0])  # what always reads the same may count as stuck
    s = np.zeros(len(estimator.a))
    for _ in range(80):
        m = 1e-6 * rng.normal(size=5)
        command = estimator.h @ s - gain @ (estimator.c @ s + estimator.d @ sensed_row(m))
        assert mpc.step(m, speed, [0.0]).angle == pytest.approx(command, rel=1e-6, abs=1e-13)
        s = estimator.a @ s + estimator.e @ sensed_row(m) + estimator.f * command


@pytest.mark.parametrize("name", ["published", "informed"])
@pytest.mark.parametrize("by", [Mismatch(), Mismatch(lag=0.06, dead_time=-0.05, stiffness=0.7, mass=1.2)])
def test_no_loop_that_is_certified_stable_grows_in_the_simulator(name, by):
    rng, n, quarter = np.random.default_rng(10), 48, 400
    mpc = {"published": ROAD_MPC, "informed": INFORMED}[name]
    world = QUIET.replace(delay=1.0 + round(by.dead_time / 0.05))
    car, tunings = by.true_car(PLANT, world), some_tunings(11, n)
    tunings[:, 3] = tunings[:, 2] * 10 ** rng.uniform(*{"published": (2.0, 6.0), "informed": (-4.0, 4.0)}[name], n)
    speeds, frictions = rng.uniform(3.0, 30.0, n), rng.uniform(0.3, 1.0, n)
    radius, runs = np.empty(n), []
    for i, (v, mu) in enumerate(zip(speeds.tolist(), frictions.tolist(), strict=True)):
        body = by.sampled(PLANT, 0.05, v, friction=mu, profile=QUIET)
        radius[i] = spectral_radius(loops(body, laws(mpc, v, tunings[i])))[0]
        quiet = {"reference": 0.0, "wind": Wind(y=0.0), "start_y": 1e-6}
        runs.append(at.Scenario(name="small", duration=0.2 * quarter, speed=v, friction=mu, **quiet))
    cost = RunSet(car, mpc, runs, world, segment=quarter).segments(tunings, 0, np.arange(n))[:, :4]
    size = np.sqrt(np.where(np.isfinite(cost), cost, np.inf) / quarter)
    grew = (size[:, 3] > 1e-4) | ((size[:, 3] > size[:, 2]) & (size[:, 3] > 1e-15))
    assert (radius < 1.0).sum() > 10
    assert (radius > 1.005).sum() > 3
    assert not (grew & (radius < 0.999)).any()
    assert grew[radius > 1.005].all()


# -- another car ------------------------------------------------------------------------------------------------------
def test_a_mismatch_is_the_plant_with_those_numbers():
    heavy = CAR.replace(mass=1.3 * CAR.mass, yaw_inertia=1.3 * CAR.yaw_inertia)
    soft = at.load_tyre("magic-formula").replace(stiffness_front=19000.0 / 1.6, stiffness_rear=33000.0 / 1.6)
    slow = ROAD.replace(steering=ROAD.steering.replace(lag=0.25))
    for by, (plant, world, late) in {
        Mismatch(): (PLANT, ROAD, 0.0),
        Mismatch(mass=1.3): (at.DualTrack(heavy, "magic-formula"), ROAD, 0.0),
        Mismatch(stiffness=1.0 / 1.6): (at.DualTrack(CAR, soft), ROAD, 0.0),
        Mismatch(lag=0.1): (PLANT, slow, 0.0),
        Mismatch(dead_time=0.07): (PLANT, ROAD, 0.07),
        Mismatch(dead_time=-0.05): (PLANT, ROAD.replace(delay=0.0), 0.0),
        Mismatch(dead_time=0.02): (PLANT, ROAD.replace(steering=ROAD.steering.replace(dead_time=0.02)), 0.0),
    }.items():
        model = by.sampled(PLANT, 0.05, 18.0, friction=0.6, profile=ROAD)
        expected = sampled(plant, 0.05, 18.0, friction=0.6, profile=world, delay=late)
        for first, other in zip(model, expected, strict=True):
            np.testing.assert_allclose(first, other, rtol=1e-9, atol=1e-12)


def test_a_mismatch_that_means_nothing_is_refused():
    with pytest.raises(at.InvalidInput, match="finite"):
        Mismatch(lag=math.nan)
    with pytest.raises(at.InvalidInput, match=r"mass = 0.0: must be a finite number > 0"):
        Mismatch(mass=0.0)
    mine = at.UserPlant(wandering, {"cf": 38000.0, "cr": 66000.0, "mass": 1575.0}, mass=1575.0, own_states=("unseen",))
    with pytest.raises(at.InvalidInput, match="second plant"):
        Mismatch(mass=1.3).sampled(mine, 0.05, 18.0)
    assert Mismatch(lag=0.1).sampled(mine, 0.05, 18.0).b.shape == (5,)


# -- maps -------------------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def road_map():
    return loop_map(PLANT, ROAD_MPC, "road", speed=(10.0, 20.0))


@pytest.fixture(scope="module")
def inside():
    """Random points of the map's domain, and how near to instability the loop is there."""
    rng, rows = np.random.default_rng(6), []
    for _ in range(40):
        speed, friction = rng.uniform(10.0, 20.0), rng.uniform(0.3, 1.0)
        tunings = some_tunings(rng, 25)
        k = laws(ROAD_MPC, speed, tunings)
        near = 1.0 - np.minimum(*(modulus_margin(body, k) for body in straight_and_turn(speed, friction)))
        ratio = np.log10(tunings[:, 3] / tunings[:, 2])
        rows += [(speed, friction, *row) for row in zip(tunings[:, 0], tunings[:, 1], ratio, near, strict=True)]
    return np.array(rows)


def test_at_its_nodes_the_map_is_the_worse_of_straight_and_turn(road_map):
    axes, values = road_map
    rng = np.random.default_rng(7)
    for _ in range(20):
        node = tuple(rng.integers(len(axis)) for axis in axes)
        speed, friction, Np, Nc, ratio = (float(axis[i]) for axis, i in zip(axes, node, strict=True))
        k = laws(ROAD_MPC, speed, [Np, min(Np, Nc), 1.0, 10.0**ratio])
        near = 1.0 - min(modulus_margin(body, k)[0] for body in straight_and_turn(speed, friction))
        assert near <= values[node] + 1e-12
        assert values[node] - near <= 1.01e-3


def test_no_loop_is_nearer_to_instability_than_the_worst_corner_of_its_cell(road_map, inside):
    axes, values = road_map
    cell = [
        np.clip(np.searchsorted(axis, inside[:, d], side="right") - 1, 0, len(axis) - 2) for d, axis in enumerate(axes)
    ]
    corners = [values[tuple(i + up for i, up in zip(cell, ups, strict=True))] for ups in product((0, 1), repeat=5)]
    assert (inside[:, 5] - np.max(corners, axis=0)).max() <= 0.01


def test_what_the_interpolated_map_lets_pass_is_stable_and_little_else_is_stopped(road_map, inside):
    axes, values = road_map
    between = RegularGridInterpolator(axes, values)(inside[:, :5])
    passed = between <= 0.92
    assert passed.sum() > 100
    assert (inside[passed, 5] > 0.97).mean() < 0.01
    assert (~passed & (inside[:, 5] <= 0.92)).sum() < 0.05 * passed.sum()


REPLICA = {  # an independent replica of the authors' released system: (general trajectory, triple lane change)
    "laguerre 0.95": (at.Moves.laguerre(0.95), 0.618, 0.038),
    "laguerre 0.75": (at.Moves.laguerre(0.75), 0.129, 0.0040),
    "pulse": (at.Moves.pulses(), 0.123, 0.0030),
}


@pytest.mark.parametrize("name", REPLICA)
def test_the_released_configuration_reproduces_the_replica(name):
    moves, general, lane_change = REPLICA[name]
    plant, mpc = at.SingleTrack(CAR, "constant-stiffness"), at.published_mpc(CAR, moves=moves)
    for scenario, expected in (("general-trajectory", general), ("triple-lane-change", lane_change)):
        assert at.compute_metrics(at.rollout(plant, mpc, at.load_scenario(scenario))).mse == pytest.approx(
            expected, rel=0.05
        )
