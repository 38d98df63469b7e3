"""Many vehicles at once: a lane's numbers are its own, to the last bit, whoever rides beside it."""

import numpy as np
import pytest
from adaptrack.kernels.dynamics import CUSTOM, DUAL_TRACK, INPUTS, STATES, compile_plant
from adaptrack.kernels.integrate import BLOCK, LANE_STEP, LANES, integrate, integrate_custom
from adaptrack.kernels.tyre import CURVED_MAGIC_FORMULA, LINEAR, MAGIC_FORMULA

from adaptrack.plant import DualTrack, SingleTrack, UserPlant
from adaptrack.profile import load_profile
from adaptrack.vehicle import SteeringActuator, load_tyre, load_vehicle
from references import vehicle as reference

CAR = load_vehicle("paper")
LAWS = {
    LINEAR: load_tyre("constant-stiffness"),
    MAGIC_FORMULA: load_tyre("magic-formula"),
    CURVED_MAGIC_FORMULA: load_tyre("passenger-car").replace(curvature=-1.0),
}
ROAD = load_profile("road").steering

every_plant = pytest.mark.parametrize("plant", [SingleTrack, DualTrack])
every_law = pytest.mark.parametrize("law", LAWS, ids=("linear", "magic-formula", "curved"))


def crowd(rng, kind):
    """LANES different vehicles: rows of state and input (STATES + INPUTS, LANES), half of them driven by a force."""
    rows = np.zeros((STATES + INPUTS, LANES))
    rows[:6] = rng.uniform([[-50], [-9], [-3], [0], [-2], [-1]], [[50], [9], [3], [40], [2], [1]], (6, LANES))
    if kind == DUAL_TRACK:
        rows[6:10] = rng.uniform(-0.2, 0.2, (4, LANES))
        rows[10:12] = rng.uniform(-5, 5, (2, LANES))
    rows[12:14] = rng.uniform(-0.3, 0.3, (2, LANES))
    rows[14] = rng.uniform(-9000, 6000, LANES)
    rows[15] = np.where(np.arange(LANES) % 2, np.nan, rng.uniform(-3, 3, LANES))
    rows[16:20] = rng.uniform(0.2, 1.1, (4, LANES))
    rows[20:22] = rng.uniform(-30, 30, (2, LANES))
    return rows


def advanced(plant, rows, members, substeps=12, h=0.008):
    """The vehicles `members` (columns of `rows`) after some steps, in a block of their own."""
    block = np.zeros(BLOCK)
    lanes = block.reshape(STATES + INPUTS, LANES)
    lanes[:] = rows[:, members[:1]]  # whoever fills up the last group of lanes
    lanes[:, : len(members)] = rows[:, members]
    integrate(plant.kind, plant.packed(), block, len(members), substeps, h)
    return lanes[:, : len(members)]


@every_plant
@every_law
@pytest.mark.parametrize("size", [1, 7, 20, LANES])
def test_a_lane_is_the_same_to_the_last_bit_alone_and_in_any_company(plant, law, size, rng):
    car = plant(CAR, LAWS[law], ROAD)
    rows = crowd(rng, car.kind)
    members = rng.permutation(LANES)[:size]
    together = advanced(car, rows, members)
    assert np.isfinite(together[:STATES]).all()
    for lane in rng.permutation(size)[:4]:
        alone = advanced(car, rows, members[lane : lane + 1])[:, 0]
        assert np.array_equal(alone, together[:, lane], equal_nan=True)
    other_order = advanced(car, rows, members[::-1])[:, ::-1]
    assert np.array_equal(other_order, together, equal_nan=True)


@every_plant
def test_two_short_rides_are_one_long_one(plant, rng):
    car = plant(CAR, steering=ROAD)
    rows, members = crowd(rng, car.kind), np.arange(5)
    twice = rows.copy()
    twice[:, :5] = advanced(car, rows, members, 5)
    assert np.array_equal(advanced(car, twice, members, 7), advanced(car, rows, members, 12), equal_nan=True)


@every_plant
def test_inputs_are_held_and_lanes_that_nobody_asked_for_stay(plant, rng):
    car = plant(CAR, steering=ROAD)
    rows = crowd(rng, car.kind)
    block = rows.ravel().copy()
    integrate(car.kind, car.packed(), block, LANE_STEP, 3, 0.01)
    after = block.reshape(rows.shape)
    assert np.array_equal(after[STATES:], rows[STATES:], equal_nan=True)
    assert np.array_equal(after[:, LANE_STEP:], rows[:, LANE_STEP:], equal_nan=True)


@every_plant
@every_law
def test_a_step_is_the_classical_runge_kutta_step(plant, law, rng):
    car = plant(CAR, LAWS[law])
    written = reference.dual_track if car.kind == DUAL_TRACK else reference.single_track
    own, h = len(car.state_names), 0.005
    rows = crowd(rng, car.kind)
    after = advanced(car, rows, np.arange(6), substeps=1, h=h)
    for lane in range(6):
        x, u, environment = rows[:own, lane], rows[13:15, lane], rows[16:, lane]
        acceleration = None if np.isnan(rows[15, lane]) else rows[15, lane]

        def f(x, u=u, environment=environment, acceleration=acceleration):
            return written(CAR, car.tyre, x, u, environment, acceleration)

        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        np.testing.assert_allclose(after[:own, lane], x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), rtol=1e-11, atol=1e-11)


# -- a user's plant ---------------------------------------------------------------------------------------------------
def copy_of_the_single_track(x, u, environment, p, dx):
    """Eq. (6) with wind left out: m, I_z, l_f, l_r, C_f, C_r."""
    speed = max(x[3], 1.0)
    slip_f = u[0] - np.arctan((x[4] + p[2] * x[5]) / speed)
    slip_r = -np.arctan((x[4] - p[3] * x[5]) / speed)
    front, rear = 2.0 * p[4] * slip_f, 2.0 * p[5] * slip_r
    dx[0] = x[3] * np.cos(x[2]) - x[4] * np.sin(x[2])
    dx[1] = x[3] * np.sin(x[2]) + x[4] * np.cos(x[2])
    dx[2] = x[5]
    dx[3] = u[1] / p[0] + x[4] * x[5]
    dx[4] = (front + rear) / p[0] - x[3] * x[5]
    dx[5] = (p[2] * front - p[3] * rear) / p[1]


def custom_ride(function, parameters, steering, start, inputs, substeps, h, own=6):
    """A block's first lane (STATES + INPUTS,) and the plant's own states after a ride of a user's plant."""
    block, states = np.zeros(BLOCK), np.zeros((LANES, own))
    rows = block.reshape(-1, LANES)
    rows[:6], rows[STATES:] = start[:6, None], inputs[:, None]
    states[:, :6] = start[:6]
    packed = np.array([*parameters, steering.lag, steering.rate, steering.limit])
    integrate_custom(compile_plant(function), packed, block, states, 3, substeps, h, np.zeros((7, max(own, 6))))
    return rows[:, 0].copy(), states


@pytest.mark.parametrize("steering", [SteeringActuator.ideal(), ROAD], ids=["ideal", "road"])
@pytest.mark.parametrize("acceleration", [np.nan, 0.8], ids=["driven", "prescribed"])
def test_a_users_plant_is_integrated_as_the_built_in_ones_are(steering, acceleration):
    tyre = LAWS[LINEAR].replace(stiffness_load="constant", relaxation_length=0.0)
    car = SingleTrack(CAR.replace(frontal_area=0.0, rolling_resistance=0.0), tyre, steering)
    start = np.array([1.0, 2.0, 0.2, 12.0, 0.3, -0.1])
    inputs = np.array([0.4, 800.0, acceleration, 1.0, 1.0, 1.0, 1.0, 0.0, 0.0])
    parameters = (CAR.mass, CAR.yaw_inertia, CAR.lf, CAR.lr, 19000.0, 33000.0)
    own, states = custom_ride(copy_of_the_single_track, parameters, steering, start, inputs, 40, 0.01)
    rows = np.zeros((STATES + INPUTS, LANES))
    rows[:6], rows[STATES:] = start[:, None], inputs[:, None]
    built_in = advanced(car, rows, np.arange(1), 40, 0.01)[:, 0]
    np.testing.assert_allclose(own[:6], built_in[:6], rtol=1e-11, atol=1e-11)
    np.testing.assert_allclose(states[0], built_in[:6], rtol=1e-11, atol=1e-11)
    if steering is ROAD:
        assert own[12] == pytest.approx(built_in[12], rel=1e-12)


def pendulum_beside_the_car(x, u, environment, p, dx):
    """A car that goes straight, and an oscillator of its own in two more states."""
    for i in range(6):
        dx[i] = 0.0
    dx[0] = x[3]
    dx[6] = x[7]
    dx[7] = -p[0] * p[0] * x[6] + u[0] + environment[5]


def test_a_users_own_states_are_integrated_and_see_steering_and_environment():
    omega, command, wind = 3.0, 0.2, 1.5
    start = np.array([0.0, 0.0, 0.0, 10.0, 0.0, 0.0])
    inputs = np.array([command, 0.0, np.nan, 1.0, 1.0, 1.0, 1.0, 0.0, wind])
    _, states = custom_ride(pendulum_beside_the_car, (omega,), SteeringActuator.ideal(), start, inputs, 200, 0.005, 8)
    rest = (command + wind) / omega**2
    assert states[0, 6] == pytest.approx(rest * (1 - np.cos(omega * 1.0)), rel=1e-7)
    assert states[0, 0] == pytest.approx(10.0, rel=1e-12)
    assert np.array_equal(states[0], states[2])  # the third of three lanes
    assert (states[3:, 6:] == 0.0).all()  # nobody asked for the fourth


def test_a_users_plant_is_of_its_own_kind():
    plant = UserPlant(pendulum_beside_the_car, {"omega": 1.0}, mass=1000.0, own_states=("angle", "rate"))
    assert plant.kind == CUSTOM
    assert plant.packed().tolist() == [1.0, 0.0, np.inf, np.pi / 2]
