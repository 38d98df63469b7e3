"""Many vehicles at once: a slot's numbers are its own, to the last bit, whoever rides beside it."""

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.physics.tyre import CURVED_MAGIC_FORMULA, LINEAR_TYRE, MAGIC_FORMULA
from adaptrack.core.plants import contract
from adaptrack.core.plants.user import compile_plant
from references import vehicle as reference

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("paper")
LAWS = {
    LINEAR_TYRE: at.load_tyre("constant-stiffness"),
    MAGIC_FORMULA: at.load_tyre("magic-formula"),
    CURVED_MAGIC_FORMULA: at.load_tyre("passenger-car").replace(curvature=-1.0),
}
ROAD = at.load_profile("road").steering

every_plant = pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
every_law = pytest.mark.parametrize("law", LAWS, ids=("linear", "magic-formula", "curved"))


def crowd(rng, plant):
    """SLOTS different vehicles: rows of state and input (STATES + INPUTS, SLOTS), half of them driven by a force."""
    rows = np.zeros((contract.PLANT_STATES + contract.PLANT_INPUTS, contract.SLOTS))
    rows[:6] = rng.uniform([[-50], [-9], [-3], [0], [-2], [-1]], [[50], [9], [3], [40], [2], [1]], (6, contract.SLOTS))
    if isinstance(plant, at.DualTrack):
        rows[6:10] = rng.uniform(-0.2, 0.2, (4, contract.SLOTS))
        rows[10:12] = rng.uniform(-5, 5, (2, contract.SLOTS))
    rows[12:14] = rng.uniform(-0.3, 0.3, (2, contract.SLOTS))
    rows[14] = rng.uniform(-9000, 6000, contract.SLOTS)
    rows[15] = np.where(np.arange(contract.SLOTS) % 2, np.nan, rng.uniform(-3, 3, contract.SLOTS))
    rows[16:20] = rng.uniform(0.2, 1.1, (4, contract.SLOTS))
    rows[20:22] = rng.uniform(-30, 30, (2, contract.SLOTS))
    rows[22] = rng.uniform(-2, 2, contract.SLOTS)
    rows[contract.PLANT_STATES + contract.PLANT_INPUT.brake] = np.maximum(-rows[14], 0.0)
    return rows


def advance(plant, rows, members, substeps=12, h=0.008):
    """The vehicles `members` (columns of `rows`) after some steps, in a block of their own."""
    batch = contract.vehicle_batch(plant.compiled, plant.packed(), np.zeros((contract.SLOTS, 6)))
    slots = batch.block.reshape(contract.PLANT_STATES + contract.PLANT_INPUTS, contract.SLOTS)
    slots[:] = rows[:, members[:1]]  # whoever fills up the last group of slots
    slots[:, : len(members)] = rows[:, members]
    plant.compiled.advance(
        batch.member, batch.parameters, batch.block, batch.states, batch.work, len(members), substeps, h
    )
    return slots[:, : len(members)]


@every_plant
@every_law
@pytest.mark.parametrize("size", [1, 7, 20, contract.SLOTS])
def test_a_slot_is_the_same_to_the_last_bit_alone_and_in_any_company(plant, law, size, rng):
    car = plant(CAR, LAWS[law], ROAD)
    rows = crowd(rng, car)
    members = rng.permutation(contract.SLOTS)[:size]
    together = advance(car, rows, members)
    assert np.isfinite(together[: contract.PLANT_STATES]).all()
    for slot in rng.permutation(size)[:4]:
        alone = advance(car, rows, members[slot : slot + 1])[:, 0]
        assert np.array_equal(alone, together[:, slot], equal_nan=True)
    other_order = advance(car, rows, members[::-1])[:, ::-1]
    assert np.array_equal(other_order, together, equal_nan=True)


@every_plant
def test_inputs_are_held_and_slots_that_nobody_asked_for_stay(plant, rng):
    car = plant(CAR, steering=ROAD)
    rows = crowd(rng, car)
    batch = contract.vehicle_batch(car.compiled, car.packed(), np.zeros((contract.SLOTS, 6)))
    batch.block[:] = rows.ravel()
    car.compiled.advance(batch.member, batch.parameters, batch.block, batch.states, batch.work, contract.GROUP, 3, 0.01)
    after = batch.block.reshape(rows.shape)
    assert np.array_equal(after[contract.PLANT_STATES :], rows[contract.PLANT_STATES :], equal_nan=True)
    assert np.array_equal(after[:, contract.GROUP :], rows[:, contract.GROUP :], equal_nan=True)


@every_plant
@every_law
def test_a_step_is_the_classical_runge_kutta_step(plant, law, rng):
    car = plant(CAR, LAWS[law])
    written = reference.dual_track if plant is at.DualTrack else reference.single_track
    count, h = len(car.state_names), 0.005
    rows = crowd(rng, car)
    after = advance(car, rows, np.arange(6), substeps=1, h=h)
    for slot in range(6):
        x, u, environment = rows[:count, slot], rows[13:15, slot], rows[16:23, slot]
        acceleration = None if np.isnan(rows[15, slot]) else rows[15, slot]

        def f(x, u=u, environment=environment, acceleration=acceleration):
            return written(CAR, car.tyre, x, u, environment, acceleration)

        k1 = f(x)
        k2 = f(x + h / 2 * k1)
        k3 = f(x + h / 2 * k2)
        k4 = f(x + h * k3)
        np.testing.assert_allclose(after[:count, slot], x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), rtol=1e-11, atol=1e-11)


# -- a user's plant ---------------------------------------------------------------------------------------------------


def custom_ride(function, parameters, steering, start, inputs, substeps, h, count=6):
    """A block's first slot (STATES + INPUTS,) and the plant's own states after a ride of a user's plant."""
    packed = np.array([steering.lag, steering.rate, steering.limit, 0.0, *parameters])  # 0: does not take the grade
    batch = contract.vehicle_batch(compile_plant(function), packed, np.zeros((contract.SLOTS, count)))
    rows = batch.block.reshape(-1, contract.SLOTS)
    rows[:6], rows[contract.PLANT_STATES :] = start[:6, None], inputs[:, None]
    batch.states[:, :6] = start[:6]
    compile_plant(function).advance(batch.member, packed, batch.block, batch.states, batch.work, 3, substeps, h)
    return rows[:, 0].copy(), batch.states


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
    inputs = np.array([command, 0.0, np.nan, 1.0, 1.0, 1.0, 1.0, 0.0, wind, 0.0, 0.0, 0.0])
    _, states = custom_ride(
        pendulum_beside_the_car, (omega,), at.SteeringActuator.ideal(), start, inputs, 200, 0.005, 8
    )
    equilibrium = (command + wind) / omega**2
    assert states[0, 6] == pytest.approx(equilibrium * (1 - np.cos(omega * 1.0)), rel=1e-7)
    assert states[0, 0] == pytest.approx(10.0, rel=1e-12)
    assert np.array_equal(states[0], states[2])  # the third of three slots
    assert (states[3:, 6:] == 0.0).all()  # nobody asked for the fourth


@every_plant
@pytest.mark.parametrize("steering", [at.SteeringActuator.ideal(), ROAD], ids=["ideal", "road"])
def test_what_is_observed_is_the_slope_and_the_angle_of_the_wheels(plant, steering, rng):
    car = plant(CAR, steering=steering)
    batch = contract.vehicle_batch(car.compiled, car.packed(), np.zeros((contract.SLOTS, 6)))
    rows = batch.block.reshape(contract.PLANT_STATES + contract.PLANT_INPUTS, contract.SLOTS)
    rows[:] = crowd(rng, car)
    for slot in (0, 5, contract.SLOTS - 1):
        angle, slope = np.full(2, np.nan), np.full(contract.PLANT_STATES, np.nan)
        car.compiled.observe(batch.member, batch.parameters, batch.block, batch.states, batch.work, slot, angle)
        x, u = rows[: contract.PLANT_STATES, slot].copy(), rows[contract.PLANT_STATES :, slot].copy()
        car.compiled.right_hand_side(x, u, car.packed(), slope)
        assert (
            angle[0]
            == slope[contract.PLANT_STATE.vy]
            + x[contract.PLANT_STATE.vx] * x[contract.PLANT_STATE.yaw_rate]
            - u[contract.PLANT_INPUT.bank]
        )
        assert angle[1] == (
            x[contract.PLANT_STATE.steering]
            if steering is ROAD
            else np.clip(u[contract.PLANT_INPUT.command], -np.pi / 2, np.pi / 2)
        )
