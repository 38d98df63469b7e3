"""Constant numbers of controllers, from a car, a belief and a tuning, by kernels in memory of the caller's."""

import math
import random
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_are

import adaptrack as at
from adaptrack.core import library
from adaptrack.core.estimators import learning
from adaptrack.core.kernel import row_of
from adaptrack.core.maths.decimal import to_digits, to_places
from adaptrack.core.models.car import SingleTrackCar
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.synthesis import belief, car, filter, laws, mpc, tuning
from adaptrack.core.synthesis.learner import learner_memory
from by_kernels import CASES, make_order
from programs import run_program

SEDAN = at.load_vehicle("midsize-sedan")
UNTOUCHED = -1234.5


# -- numbers as they are printed --------------------------------------------------------------------------------------
def test_numbers_are_rounded_as_they_are_printed():
    """Python's own are rounded correctly, ties to even."""
    rng = random.Random(1)
    for i in range(3000):
        x = rng.choice((1.0, -1.0)) * 10.0 ** rng.uniform(-12.0, 9.0)
        x = round(x, rng.randint(0, 6)) if i % 3 else rng.randint(0, 10**8) / 2 ** rng.randint(0, 12)
        digits, places = rng.randint(1, 9), rng.randint(0, 6)
        assert to_places(x, places) == round(x, places), (x, places)
        if abs(x) > 1e-15:
            assert to_digits(x, digits) == float(f"{x:.{digits}g}"), (x, digits)
    ties = {(0.5, 0): 0.0, (1.5, 0): 2.0, (2.5, 0): 2.0, (-0.125, 2): -0.12, (1250.0, -2): 1200.0, (1350.0, -2): 1400.0}
    assert all(to_places(*tie) == even for tie, even in ties.items())
    for x in (0.0, math.inf, -math.inf, math.nan, 2.0**60, 1e-300):  # without digits to round
        np.testing.assert_array_equal([to_places(x, 300), to_digits(x, 4)], [x, x])


# -- a car from its mass and wheelbase --------------------------------------------------------------------------------
def complete_car(mass=1500.0, wheelbase=2.7, load=0.0, truck=0, **values):
    """Status, car and how well it is known."""
    row, within = row_of(car.CarRow, mass=mass, **values), row_of(car.KnownWithinRow)
    return car.complete_car(wheelbase, load, truck, row, within), row, within


@pytest.mark.parametrize(("mass", "wheelbase", "truck"), [(700.0, 1.9, 0), (1500.0, 2.7, 0), (3000.0, 4.4, 1)])
def test_an_estimated_car_keeps_the_ratios_of_measured_ones(mass, wheelbase, truck):
    """Dynamic index, cornering coefficients, balance of loads: as published, to the digits that are printed."""
    status, row, within = complete_car(mass, wheelbase, truck=truck)
    assert status == car.OK
    assert row.lf + row.lr == pytest.approx(wheelbase, abs=1e-5)
    assert row.yaw_inertia / (mass * row.lf * row.lr) == pytest.approx(1.0 if truck else 1.09, rel=2e-3)
    front, rear = mass * GRAVITY * row.lr / wheelbase, mass * GRAVITY * row.lf / wheelbase
    assert (2 * row.stiffness_front / front, 2 * row.stiffness_rear / rear) == pytest.approx((13.8, 21.9), rel=1e-3)
    assert within.stiffness_front == within.stiffness_rear == 1.62
    names = *SingleTrackCar._fields, *car.ESTIMATED_NUMBERS, "side_force_slope", "yaw_moment_slope"
    assert not any(math.isnan(row[name]) for name in names)


def test_what_is_given_of_a_car_stays_and_has_no_spread():
    values = {"lf": 1.1, "stiffness_rear": 7e4, "cg_height": 0.5}
    _, row, within = complete_car(**values)
    assert {name: row[name] for name in values} == values
    assert row.lr == 1.6
    assert all(math.isnan(within[name]) for name in values)
    assert not math.isnan(within.stiffness_front)


@pytest.mark.parametrize(("mass", "stiffness"), [(1500.0, 25e3), (1500.0, 60e3), (2800.0, 110e3)])
def test_the_relaxation_delay_is_the_phase_that_relaxing_tyres_add_to_the_yaw_rate(mass, stiffness):
    """Single track with forces C alpha/(1 + s sigma/v); neutral, with I_z = m l_f l_r."""
    lf, lr, speed, frequency = 1.2, 1.5, car.RELAXATION_SPEED, car.RELAXATION_FREQUENCY
    front, rear = 2.0 * stiffness * lr / (lf + lr), 2.0 * stiffness * lf / (lf + lr)  # N/rad of a tyre
    row = row_of(car.CarRow, mass=mass, lf=lf, lr=lr, stiffness_front=front, stiffness_rear=rear)
    relaxation_time = stiffness / car.TYRE_LATERAL_STIFFNESS / speed

    def phase(time):
        force = 1.0 / (1.0 + 1j * frequency * time)
        c, turning, inertia = 2.0 * (front + rear) * force, 2.0 * (lf**2 * front + lr**2 * rear) * force, mass * lf * lr
        response = np.linalg.solve(
            [[1j * frequency + c / (mass * speed), speed], [0.0, 1j * frequency + turning / (inertia * speed)]],
            [2.0 * front * force / mass, 2.0 * lf * front * force / inertia],
        )
        return float(np.angle(response[1]))

    added = (phase(0.0) - phase(relaxation_time)) / frequency
    assert car.relaxation_delay(row) == pytest.approx(added, rel=0.15, abs=0.0005)  # of first order, rounded to 1 ms


def test_a_car_that_cannot_be_is_a_status_and_nothing_is_written():
    for values, status in [
        ({"mass": 599.0}, car.MASS_OUTSIDE), ({"mass": math.nan}, car.MASS_OUTSIDE),
        ({"wheelbase": 9.0}, car.WHEELBASE_OUTSIDE), ({"load": 2000.0}, car.TOO_MUCH_LOAD),
        ({"lf": 1.0, "lr": 1.0}, car.AXLES_DISAGREE), ({"lf": 3.0}, car.AXLES_DISAGREE),
    ]:  # fmt: skip
        code, row, within = complete_car(**values)
        assert code == status, values
        assert {name for name in car.CarRow._fields if not math.isnan(row[name])} <= {"mass", "lf", "lr"}
        assert within.is_given == 0


# -- belief -----------------------------------------------------------------------------------------------------------
def test_each_number_of_the_steering_is_from_the_first_that_says_it():
    arguments, file_steering, actuator = (
        row_of(car.SteeringRow, lag=0.1), row_of(car.SteeringRow, lag=0.2, dead_time=0.07),
        row_of(car.SteeringRow, lag=0.3, dead_time=0.3, rate=math.inf),
    )  # fmt: skip
    result = belief.BeliefRow.new(1)[0]
    belief.believe_steering(arguments, file_steering, actuator, 0.05, result)
    assert result.steering.tolist() == (0.1, 0.07, math.inf, belief.ANGLE)
    assert result.source.tolist() == (belief.GIVEN, belief.CAR_FILE, belief.PROFILE, belief.SLOW_ASSUMED)
    assert result.computation == 0.05


@pytest.mark.parametrize("computation", [0.0, 0.05, 0.1])
@pytest.mark.parametrize("steering", [{}, {"lag": 0.1}, {"lag": 0.5}, {"dead_time": 0.1}, {"dead_time": 0.5}], ids=str)
def test_an_unknown_delay_is_with_the_computation_time_as_long_as_published_ones(steering, computation):
    result = belief.BeliefRow.new(1)[0]
    belief.believe_steering(
        row_of(car.SteeringRow, **steering), row_of(car.SteeringRow), row_of(car.SteeringRow), computation, result
    )
    longest = max(0.4 - min(computation, 0.05) - 1e-9, sum(steering.values()))
    assert longest <= result.steering.lag + result.steering.dead_time <= longest + 0.05
    assert result.steering.lag > 0.0


def test_caution_doubles_r_at_the_tolerated_delay_and_grows_with_everything():
    def caution(lag=0.0, dead_time=0.0, stiffness=1.0, mass=0.0):
        unsure = row_of(belief.UncertaintyRow, lag=lag, dead_time=dead_time, stiffness=stiffness, mass=mass)
        return belief.caution_of(unsure)

    assert caution() == 1.0
    assert caution(lag=0.018) == caution(dead_time=0.018) == pytest.approx(2.0)
    assert caution(lag=0.018 * math.sqrt(0.5), dead_time=0.018 * math.sqrt(0.5)) == pytest.approx(2.0)
    assert caution(stiffness=1.6, mass=0.25) == pytest.approx(1.6 * 1.25)
    assert caution(lag=1.0) == 16.0


# -- tuning -----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("preview", [0, 1])
def test_horizons_and_weight_are_times_and_so_do_not_know_the_control_period(preview):
    results = {}
    for period in (0.025, 0.05, 0.1):
        world = row_of(tuning.ControllerWorld, period=period, preview=preview, move_weight=0.0, noise_vy=0.1)
        out = np.zeros(4)
        tuning.tune_informed(world, 1.0, 1000, 200, out)
        Np, Nc, Q, R = out
        results[period] = (Np * period, Nc * period, Q, R * period**2)
    assert results[0.025] == pytest.approx(results[0.05], rel=1e-5)
    assert results[0.1] == pytest.approx(results[0.05], rel=1e-5)


def test_horizons_stay_within_their_bounds():
    out = np.zeros(4)
    for period, expected in ((1e-4, (60, 20)), (10.0, (2, 1))):
        tuning.tune_informed(row_of(tuning.ControllerWorld, period=period, noise_vy=0.1), 1.0, 60, 20, out)
        assert tuple(out[:2]) == expected


# -- filter -----------------------------------------------------------------------------------------------------------
def test_a_dead_time_is_whole_periods_and_a_share():
    for time, period in ((0.0, 0.05), (0.15, 0.05), (0.17, 0.05), (0.3, 0.1), (1.0, 0.03)):
        periods, share = filter.split_periods(time, period)
        assert isinstance(periods, int)
        assert 0.0 <= share < 1.0
        assert (periods + share) * period == pytest.approx(time, abs=1e-9)


def test_sensors_that_are_off_or_too_good_are_left_out():
    def noise(**sensors):
        result = row_of(filter.Noise)
        filter.sensor_noise(
            row_of(tuning.ControllerWorld, **{"bias_wheel_angle": 0.0, "bias_yaw_rate": 0.0, **sensors}), result
        )
        return result

    assert noise(noise_wheel_angle=0.01).wheel_angle == 0.01
    assert noise(noise_wheel_angle=0.01, bias_wheel_angle=0.02).wheel_angle == math.inf
    assert noise(noise_wheel_angle=0.0).wheel_angle == math.inf
    uniform = np.random.default_rng(1).uniform(-0.02, 0.02, 100_000)
    assert noise(bias_yaw_rate=0.02).yaw_rate_offset == pytest.approx(uniform.std(), rel=0.01)


# -- learner ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("counts", [(1, 1), (2, 4), (3, 2)], ids=str)
def test_a_learner_begins_with_the_mixture_of_its_hypotheses(counts):
    """Mean and variance of what is believed are those of the filters', and the delay's that of the sum."""
    learner = at.MPC(SEDAN, learning=at.Learning(lags=counts[0], dead_times=counts[1])).learner
    memory, n = learner.fresh(), counts[0] * counts[1]
    hypotheses = [learning.hypothesis(i, learner.commands, memory) for i in range(n)]
    pairs = np.array(
        [
            [hypothesis.x[learning.STEERING_LAG], hypothesis.x[learning.DEAD_TIME] - learner.computation]
            for hypothesis in hypotheses
        ]
    )
    grains = np.array(
        [hypothesis.covariance[learning.STEERING_LAG, learning.STEERING_LAG] for hypothesis in hypotheses]
    )
    believed = learning.memory_of(memory, 0).beliefs
    assert (believed.belief_lag, believed.belief_dead_time) == pytest.approx(tuple(pairs.mean(axis=0)))
    assert believed.belief_lag_sigma**2 == pytest.approx(pairs[:, 0].var() + grains.mean())
    assert believed.belief_delay_sigma**2 == pytest.approx(
        pairs.sum(axis=1).var() + grains.mean() + hypotheses[0].covariance[learning.DEAD_TIME, learning.DEAD_TIME]
    )
    (least, most), (soon, late) = learner.ranges
    assert ((pairs >= (least, soon)) & (pairs <= (most, late))).all()
    assert believed.used_lag >= believed.belief_lag
    assert believed.used_dead_time >= believed.belief_dead_time


def test_what_comes_and_goes_keeps_its_spread():
    """The variance of a first-order Gauss-Markov process stays what it is: drift/(1 - left^2)."""
    learner = at.MPC(SEDAN, learning=at.Learning(), period=0.02).learner
    p = learning.parameters_of(learner.parameters(), 0)
    assert math.sqrt(p.drift_bank / (1.0 - p.bank_left**2)) == pytest.approx(p.method.bank, rel=1e-3)
    friction_sigma = math.sqrt(p.drift_friction / (1.0 - p.friction_left**2))
    assert friction_sigma == pytest.approx(p.method.friction_sigma, rel=1e-3)


# -- laws -------------------------------------------------------------------------------------------------------------
def test_the_front_tyres_slip_by_their_share_of_the_weight():
    front, _ = SEDAN.static_loads  # N, of a wheel
    slip = at.Stanley(SEDAN).parameters()[6]
    assert slip == pytest.approx(front / GRAVITY / SEDAN.stiffness_front, rel=1e-12)


def test_the_sampled_error_model_is_the_matrix_exponential():
    for speed in (1.0, 7.0, 60.0):
        a, b, block = np.zeros((4, 4)), np.zeros(4), np.zeros((5, 5))
        laws.lqr_error_model(SEDAN.numbers, speed, a, b)
        block[:4, :4], block[:4, 4] = a, b
        expected = expm(block * 0.05)
        laws.sampled_error_model(SEDAN.numbers, 0.05, speed, a, b)
        np.testing.assert_allclose(np.column_stack([a, b]), expected[:4], rtol=1e-12, atol=1e-14)


def solve_riccati(A, B, Q):
    """P by the kernel, in memory that is longer than it needs."""
    n = len(B)
    P, work = np.full((n, n), np.nan), np.full(6 * n * n + 3, UNTOUCHED)
    doublings = laws.riccati(A, B, Q, P, work)
    assert (work[6 * n * n :] == UNTOUCHED).all()
    return doublings, P


@pytest.mark.parametrize("n", range(1, 8))
def test_a_riccati_equation_is_solved_as_by_scipy(n):
    """Random systems, most of them unstable: residual of the equation, symmetry, SciPy's solution, a stable loop."""
    rng = np.random.default_rng(n)
    for _ in range(10):
        A, B, root = rng.normal(size=(n, n)), rng.normal(size=n), rng.normal(size=(n, n))
        Q = root @ root.T
        doublings, P = solve_riccati(A, B, Q)
        assert 0 < doublings < 20
        scale = np.abs(P).max()
        gain = (B @ P @ A) / (1.0 + B @ P @ B)
        residual = A.T @ P @ A - np.outer(A.T @ P @ B, gain) + Q - P
        assert np.abs(residual).max() < 1e-9 * scale * max(1.0, np.abs(A).max() ** 2)
        np.testing.assert_allclose(P, P.T, rtol=0, atol=1e-10 * scale)
        np.testing.assert_allclose(P, solve_discrete_are(A, B[:, None], Q, np.eye(1)), rtol=0, atol=1e-7 * scale)
        assert max(abs(np.linalg.eigvals(A - np.outer(B, gain)))) < 1.0
        solution = np.zeros(n)
        laws.lqr_feedback(A, B, P, solution)
        np.testing.assert_allclose(solution, gain, rtol=1e-12, atol=1e-14)


def test_a_system_that_cannot_be_steered_is_a_status():
    assert solve_riccati(np.array([[2.0]]), np.array([0.0]), np.eye(1))[0] == 0
    assert solve_riccati(np.array([[math.nan]]), np.array([1.0]), np.eye(1))[0] == 0


def test_the_gains_of_the_lqr_are_those_of_scipy():
    vehicle = at.load_vehicle("van")
    lqr = at.LQR(vehicle, q_e=2.0, q_heading=50.0, r=800.0, period=0.05)
    grid = lqr.parameters()[len(laws.lqr.PARAMETERS) :].reshape(
        laws.GAIN_SPEED_COUNT, laws.GAIN_WEIGHTS, laws.GAIN_WEIGHTS, 4
    )
    factors = 10.0 ** np.linspace(-2.0, 2.0, laws.GAIN_WEIGHTS)
    for i, j, k in ((0, 4, 4), (10, 4, 4), (20, 4, 4), (10, 0, 8), (5, 8, 0)):
        a, b = np.zeros((4, 4)), np.zeros(4)
        laws.sampled_error_model(vehicle.numbers, 0.05, np.geomspace(1.0, 60.0, laws.GAIN_SPEED_COUNT)[i], a, b)
        Q = np.diag([2.0 / 800.0 * factors[j], 0.0, 50.0 / 800.0 * factors[k], 0.0])
        P = solve_discrete_are(a, b[:, None], Q, np.eye(1))
        np.testing.assert_allclose(grid[i, j, k], (b @ P @ a) / (1.0 + b @ P @ b), rtol=2e-6, atol=1e-9)


# -- all of an MPC at once --------------------------------------------------------------------------------------------
def words_of(row):
    """The numbers of a row of numbers."""
    return np.array([row]).view(np.float64)


@pytest.mark.parametrize("case", CASES)
def test_the_numbers_of_an_mpc_are_all_there_without_python(case):
    """Those of the controller that Python makes."""
    vehicle = at.load_vehicle("van")
    order, numbers = make_order(vehicle, CASES[case])
    assert mpc.informed_numbers(order, numbers) == mpc.OK
    fresh = np.full(numbers.learned, UNTOUCHED)
    learning_numbers = words_of(numbers.learner.parameters) if numbers.learned else np.zeros(0)
    if numbers.learned:
        learner_memory(numbers.learner, numbers.filter, fresh)
    controller = at.MPC(vehicle, **CASES[case])
    batch = controller.batch(1, controller.settings(), curved=True)
    for field, first, other in (
        ("tuning", numbers.tuning, controller.tuning.as_array()), ("model", words_of(numbers.model), batch.parameters),
        ("states", numbers.states[: numbers.state_count].astype(np.int64), batch.states),
        ("turning", words_of(numbers.turning), batch.feed.turning),
        ("estimator", words_of(numbers.estimator), batch.informed.estimator),
        ("learner", learning_numbers, batch.informed.learner), ("fresh", fresh, batch.informed.fresh),
    ):  # fmt: skip
        assert first.tobytes() == np.ascontiguousarray(other).tobytes(), field
    assert batch.informed.estimates.size == numbers.remembered
    for field in ("period", "move_min", "move_max", "angle_min", "angle_max", "ahead", "error_max", "preview", "delay",
                  "informed", "learns"):  # fmt: skip
        assert numbers.settings[field] == getattr(batch.settings, field), field


WRONG = [
    ("car", "mass", math.nan, mpc.CAR_WRONG), ("car", "lf", -1.0, mpc.CAR_WRONG),
    ("car", "stiffness_rear", math.inf, mpc.CAR_WRONG), ("car", "side_force_slope", math.nan, mpc.CAR_WRONG),
    ("world", "period", 0.0, mpc.LOOP_WRONG), ("world", "noise_y", math.inf, mpc.LOOP_WRONG),
    ("world", "computation", math.nan, mpc.LOOP_WRONG), ("world", "oldest", math.inf, mpc.LOOP_WRONG),
    ("caller", "lag", -0.1, mpc.STEERING_WRONG), ("file", "rate", 0.0, mpc.STEERING_WRONG),
    ("actuator", "limit", math.inf, mpc.STEERING_WRONG),
    ("caller", "dead_time", math.inf, mpc.STEERING_WRONG),
    ("unsure", "stiffness", math.nan, mpc.UNCERTAINTY_WRONG), ("method", "lags", 1e9, mpc.METHOD_WRONG),
]  # fmt: skip


def test_an_order_that_makes_no_controller_is_a_status_and_nothing_is_written():
    for section, name, value, status in WRONG:
        order, numbers = make_order(SEDAN, CASES["unsure"])
        before = numbers.tobytes()
        order[section][name] = value
        assert mpc.informed_numbers(order, numbers) == status, (section, name)
        assert mpc.ORDER_FAULTS[status]
        assert numbers.tobytes() == before


def test_the_papers_mpc_has_the_numbers_of_its_table():
    vehicle, rows = at.load_vehicle("paper"), mpc.MPCNumbers.new(1)
    numbers = rows[0]
    assert mpc.published_numbers(vehicle.numbers, 0.1, numbers) == mpc.OK
    batch = at.published_mpc(vehicle).batch(1, at.published_mpc(vehicle).settings())
    assert numbers.tuning.tolist() == [35, 8, 10.0, 0.01]
    assert words_of(numbers.model)[:6].tobytes() == batch.parameters.tobytes()
    assert numbers.states[: numbers.state_count].tolist() == batch.states.tolist()
    settings = numbers.settings
    assert (settings.move_max, settings.angle_max) == pytest.approx((math.radians(15.0), math.radians(30.0)))
    assert (settings.period, settings.delay, settings.informed, settings.error_max) == (0.1, 0.0, 0, math.inf)
    before = rows.tobytes()
    assert mpc.published_numbers(row_of(car.CarRow), 0.1, numbers) == mpc.CAR_WRONG
    assert mpc.published_numbers(vehicle.numbers, math.nan, numbers) == mpc.LOOP_WRONG
    assert rows.tobytes() == before


# -- without Python ---------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_a_program_in_c_makes_the_same_controller(tmp_path):
    """From mass and wheelbase alone, by the header's names; it is compiled against the library as it is."""
    loaded = library.loaded()
    if not isinstance(loaded, library.Library) or loaded.edited:
        pytest.skip("needs the library of these sources")
    program = Path(__file__).parents[1] / "processors" / "make.c"
    files = f"-I{library.BUILT_FOLDER}", str(program), str(loaded.path), "-o", str(tmp_path / "make")
    run_program("gcc", "-std=c99", "-Wall", "-Wextra", "-Werror", *files, "-lm")
    run_program(str(tmp_path / "make"), tmp_path / "answers")
    answers = np.fromfile(tmp_path / "answers")

    controller = at.MPC(at.vehicle_from_data_sheet("mine", 1500.0, 2.7))
    batch = controller.batch(1, controller.settings(), curved=True)
    informed = batch.informed
    expected = [controller.tuning.as_array(), batch.parameters, batch.feed.turning, informed.estimator,
                informed.learner, informed.fresh]  # fmt: skip
    assert answers.tobytes() == np.concatenate(expected).tobytes()
