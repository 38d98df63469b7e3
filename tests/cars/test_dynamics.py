"""The equations of motion: order, limits and symmetries that hold whatever the numbers are, and a second opinion."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.plants.contract import PLANT_STATES, SLOTS, vehicle_batch
from references import vehicle as reference

pytestmark = pytest.mark.kernels


PAPER, SEDAN = at.load_vehicle("paper"), at.load_vehicle("midsize-sedan")
VACUUM = {"frontal_area": 0.0}  # even still air pushes a car that drifts
IDEAL = at.Tyre(  # eq. (2): constant stiffness of the paper's table, no load, no relaxation, no limit
    name="ideal", kind="linear", stiffness_front=19000.0, stiffness_rear=33000.0, nominal_load=5000.0
)
CURVED = at.load_tyre("passenger-car").replace(curvature=-0.8, relaxation_length=0.0)
TYRES = ("magic-formula", "constant-stiffness", "passenger-car", CURVED, IDEAL)
PLANTS = [plant(car, tyre) for plant in (at.SingleTrack, at.DualTrack) for car in (PAPER, SEDAN) for tyre in TYRES]


def label(plant):
    tyre = plant.tyre
    suffix = " curved" if tyre.curvature else ""
    return f"{plant.name} {plant.vehicle.name} {tyre.name}{suffix}"


every_plant = pytest.mark.parametrize("plant", PLANTS, ids=label)


def inputs(command=0.0, force=0.0, acceleration=0.0, friction=0.9, wind=(0.0, 0.0), bank=0.0):
    """A row of PLANT_INPUT on a level road; acceleration NaN lets the force act, which brakes if it is negative."""
    brake = max(-force, 0.0)
    return np.array([command, force, acceleration, *np.broadcast_to(friction, 4), *wind, bank, 0.0, brake], dtype=float)


def moving(speed, **states):
    """A vehicle that goes straight ahead, or as `states` say by their place."""
    x = np.zeros(PLANT_STATES)
    x[3] = speed
    for place, value in states.items():
        x[int(place.removeprefix("x"))] = value
    return x


def slope(plant, x, u):
    """dx/dt (STATES,) as the kernel computes it."""
    dx = np.full(PLANT_STATES, np.nan)
    plant.compiled.right_hand_side(x, u, plant.packed(), dx)
    return dx


def ride(plant, x, u, duration, h=0.005):
    """The state (STATES,) after `duration` (s) of constant input, by RK4 with steps of h (s)."""
    batch = vehicle_batch(plant.compiled, plant.packed(), x[None, :6])
    rows = batch.block.reshape(-1, SLOTS)
    rows[:PLANT_STATES] = x[:, None]
    rows[PLANT_STATES:] = u[:, None]
    steps = round(duration / h)
    plant.compiled.advance(
        batch.member, batch.parameters, batch.block, batch.states, batch.work, 1, steps, duration / steps
    )
    return rows[:PLANT_STATES, 0].copy()


def mirrored(x):
    """The state seen in a mirror: left is right."""
    return (x * [1, -1, -1, 1, -1, -1, -1, -1, -1, -1, 1, -1, -1])[[0, 1, 2, 3, 4, 5, 7, 6, 9, 8, 10, 11, 12]]


def mirrored_inputs(u):
    return (u * [-1, 1, 1, 1, 1, 1, 1, 1, -1, -1, 1, 1])[[0, 1, 2, 4, 3, 6, 5, 7, 8, 9, 10, 11]]


def wild_state(rng, plant):
    x = np.zeros(PLANT_STATES)
    x[:6] = rng.uniform([-100, -50, -4, 0, -4, -1.5], [100, 50, 4, 45, 4, 1.5])
    if isinstance(plant, at.DualTrack):
        x[6:10] = rng.uniform(-0.4, 0.4, 4)
        x[10:12] = rng.uniform(-14, 14, 2)  # far enough to lift wheels
    return x


def wild_inputs(rng, is_driven):
    return inputs(
        rng.uniform(-0.6, 0.6), rng.uniform(-16000, 9000) if is_driven else 0.0,
        np.nan if is_driven else rng.uniform(-6, 4), friction=rng.uniform(0.05, 1.2, 4), wind=rng.uniform(-40, 40, 2),
        bank=rng.uniform(-2, 2),
    )  # fmt: skip


# -- a second opinion -------------------------------------------------------------------------------------------------
@every_plant
@pytest.mark.parametrize("is_driven", [True, False], ids=["driven", "prescribed"])
def test_the_compiled_derivative_agrees_with_an_independent_one(plant, is_driven, rng):
    written = reference.single_track if isinstance(plant, at.SingleTrack) else reference.dual_track
    count = len(plant.state_names)
    for _ in range(120):
        x, u = wild_state(rng, plant), wild_inputs(rng, is_driven)
        expected = written(plant.vehicle, plant.tyre, x[:count], u[:2], u[3:10], None if is_driven else u[2])
        computed = slope(plant, x, u)
        np.testing.assert_allclose(computed[:count], expected, rtol=1e-10, atol=1e-10)
        assert (computed[count:] == 0.0).all()


@every_plant
def test_a_banked_road_pushes_the_car_aside_and_an_accelerometer_does_not_feel_it(plant, rng):
    x, push = moving(15.0, x4=0.3, x5=0.2), 0.7
    level, banked = slope(plant, x, inputs(0.02)), slope(plant, x, inputs(0.02, bank=push))
    assert banked[4] - level[4] == pytest.approx(push, rel=1e-12)
    np.testing.assert_array_equal(np.delete(banked, 4), np.delete(level, 4))
    felt = []
    for bank in (0.0, push):
        batch, reading = vehicle_batch(plant.compiled, plant.packed(), x[None, :6]), np.zeros(2)
        rows = batch.block.reshape(-1, SLOTS)
        rows[:, 0] = [*x, *inputs(0.02, bank=bank)]
        plant.compiled.observe(batch.member, batch.parameters, batch.block, batch.states, batch.work, 0, reading)
        felt.append(reading[0])
    assert felt[0] == pytest.approx(felt[1], abs=1e-12)


# -- what remains of a vehicle without tyres --------------------------------------------------------------------------
@every_plant
def test_without_any_force_momentum_is_kept(plant):
    car = plant.vehicle.replace(frontal_area=0.0, rolling_resistance=0.0)
    plant = type(plant)(car, plant.tyre)
    x = moving(15.0, x2=0.3, x4=2.0, x5=0.7)
    u = inputs(command=0.3, acceleration=np.nan, friction=0.0, wind=(10.0, -5.0))
    later = ride(plant, x, u, 1.0, h=0.01)
    east, north = reference.rotation(0.3) @ [15.0, 2.0]
    # on ice without friction the Magic Formula keeps B finite, a force of at most a micronewton remains
    assert later[:3] == pytest.approx([east, north, 0.3 + 0.7], abs=1e-6)
    assert later[5] == pytest.approx(0.7, abs=1e-9)
    assert later[3:5] == pytest.approx(reference.rotation(1.0).T @ [east, north], abs=1e-6)


# -- symmetry ---------------------------------------------------------------------------------------------------------
@every_plant
@pytest.mark.parametrize("is_driven", [True, False], ids=["driven", "prescribed"])
def test_the_mirrored_vehicle_moves_as_in_a_mirror(plant, is_driven, rng):
    for _ in range(30):
        x, u = wild_state(rng, plant), wild_inputs(rng, is_driven)
        there, original = slope(plant, mirrored(x), mirrored_inputs(u)), slope(plant, x, u)
        np.testing.assert_allclose(there, mirrored(original), rtol=1e-12, atol=1e-10)


@every_plant
@pytest.mark.parametrize("acceleration", [0.0, 2.0, np.nan], ids=["steady", "faster", "driven"])
def test_without_wind_and_steering_the_car_stays_exactly_straight(plant, acceleration):
    later = ride(plant, moving(10.0), inputs(force=2500.0, acceleration=acceleration), 1.0, h=0.0125)
    assert (later[[1, 2, 4, 5, 6, 7, 8, 9, 11]] == 0.0).all()
    assert later[0] > 9.0


# -- single and dual track --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("tyre", [IDEAL, CURVED, at.load_tyre("magic-formula").replace(relaxation_length=0.0)])
def test_without_height_and_width_two_tracks_are_one(tyre, rng):
    car = PAPER.replace(cg_height=0.0, track_front=1e-9, track_rear=1e-9)
    single, double = at.SingleTrack(car, tyre), at.DualTrack(car, tyre)
    for _ in range(50):
        x, u = wild_state(rng, single), wild_inputs(rng, is_driven=False)
        u[0] = 0.0  # the single track of eq. (1) does not turn the front force by the steering angle
        u[3:7] = u[3]
        np.testing.assert_allclose(slope(double, x, u)[:6], slope(single, x, u)[:6], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("speed", [5.0, 15.0, 30.0])
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
@pytest.mark.parametrize("car", [PAPER, SEDAN.replace(stiffness_front=40000.0)], ids=["paper", "sedan"])
def test_a_steady_turn_has_the_yaw_gain_of_the_understeer_formula(plant, car, speed):
    car = car.replace(**VACUUM)
    tyre = IDEAL.replace(stiffness_front=car.stiffness_front, stiffness_rear=car.stiffness_rear)
    steering = 1e-4
    turn = ride(plant(car, tyre), moving(speed), inputs(command=steering, friction=1.0), 6.0, h=0.02)
    assert turn[5] / steering == pytest.approx(car.steady_state_yaw_gain(speed), rel=1e-4)


# -- loads ------------------------------------------------------------------------------------------------------------
def felt_load(car, wheel, ax=0.0, ay=0.0):
    """Vertical load (N) of a wheel, weighed by its lateral force: the released tyre's is proportional to it."""
    plant = at.DualTrack(car, "constant-stiffness")
    x = moving(10.0, x10=ax, x11=ay)
    x[6 + wheel] = 0.01
    stiffness = (19000.0, 19000.0, 33000.0, 33000.0)[wheel]
    return slope(plant, x, inputs(friction=1.0))[4] * car.mass / (stiffness * 0.01) * 5000.0


@pytest.mark.parametrize("car", [PAPER, SEDAN], ids=["paper", "sedan"])
def test_braking_shifts_load_to_the_front_and_turning_left_to_the_right(car):
    still = [felt_load(car, wheel) for wheel in range(4)]
    front, rear = car.static_loads
    assert still == pytest.approx([front, front, rear, rear], rel=1e-12)
    pitch = car.mass * 5.0 * car.cg_height / car.wheelbase / 2
    assert [felt_load(car, wheel, ax=-5.0) for wheel in range(4)] == pytest.approx(
        [front + pitch, front + pitch, rear - pitch, rear - pitch], rel=1e-12
    )
    turning = [felt_load(car, wheel, ay=4.0) for wheel in range(4)]
    assert (np.sign(np.subtract(turning, still)) == [-1, 1, -1, 1]).all()
    roll = (turning[1] - turning[0]) / 2 * car.track_front + (turning[3] - turning[2]) / 2 * car.track_rear
    assert roll == pytest.approx(car.mass * 4.0 * car.cg_height, rel=1e-12)


# -- friction ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("friction", [0.3, 0.9])
@pytest.mark.parametrize(
    "plant",
    [at.SingleTrack(PAPER), at.DualTrack(PAPER), at.DualTrack(PAPER, CURVED.replace(friction_load_sensitivity=0.0))],
    ids=label,
)
def test_friction_limits_the_lateral_acceleration_to_mu_g(plant, friction):
    plant = type(plant)(plant.vehicle.replace(**VACUUM), plant.tyre)
    x, reached = moving(20.0), []
    for command in np.linspace(0.0, 0.5, 40):
        u = inputs(command=command, friction=friction)
        x = ride(plant, x, u, 0.1, h=0.0125)
        reached.append(slope(plant, x, u)[4] + x[3] * x[5])
    assert 0.8 * friction * GRAVITY < max(reached) <= friction * GRAVITY * (1 + 1e-9)


def test_braking_on_split_friction_turns_towards_the_grip():
    grip_left = inputs(force=-8000.0, acceleration=np.nan, friction=(0.9, 0.2, 0.9, 0.2))
    later = ride(at.DualTrack(PAPER), moving(20.0), grip_left, 0.5)
    assert later[2] > 0.01
    there = ride(at.DualTrack(PAPER), moving(20.0), mirrored_inputs(grip_left), 0.5)
    np.testing.assert_allclose(there, mirrored(later), rtol=1e-10, atol=1e-12)


def test_the_wheels_brake_no_harder_than_friction_allows():
    plant, car = at.DualTrack(PAPER), PAPER
    for friction in (0.2, 0.6):
        later = ride(plant, moving(25.0), inputs(force=-15000.0, acceleration=np.nan, friction=friction), 0.5)
        u = inputs(force=-15000.0, acceleration=np.nan, friction=friction)
        tyres = slope(plant, later, u)[3] * car.mass + reference.rolling(car, later[3])
        tyres -= reference.air_load(car, 0.0, later[3:5], np.zeros(2))[0][0]
        assert -friction * car.mass * GRAVITY * (1 + 1e-9) <= tyres < -0.95 * friction * car.mass * GRAVITY


# -- wind -------------------------------------------------------------------------------------------------------------
def air(speed, wind, yaw=0.0, vy=0.0, car=PAPER):
    """Side force (N) and yaw moment (N m) of the wind: what it adds to a car without tyre forces."""
    x = moving(speed, x2=yaw, x4=vy)
    dx = slope(at.SingleTrack(car, IDEAL), x, inputs(friction=0.0, wind=wind))
    return car.mass * dx[4], car.yaw_inertia * dx[5]


def test_a_side_wind_pushes_downwind_by_the_published_figures():
    side, moment = air(20.0, (0.0, 30.0))
    assert side == pytest.approx(1500.0, rel=0.02)
    assert moment == pytest.approx(1400.0, rel=0.02)


def test_beyond_its_limit_the_wind_angle_counts_no_more():
    def coefficient(angle):
        wind = 20.0 * math.tan(angle)
        pressure = 0.5 * PAPER.air_density * PAPER.frontal_area * (400.0 + wind**2)
        side, moment = air(20.0, (0.0, wind))
        return side / pressure, moment / pressure / PAPER.wheelbase

    assert coefficient(0.1) == pytest.approx((0.3, 0.1), rel=1e-12)
    assert coefficient(0.299) == pytest.approx((0.897, 0.299), rel=1e-12)
    for angle in (0.301, 0.6, 1.2):
        assert coefficient(angle) == pytest.approx((0.9, 0.3), rel=1e-12)


def test_a_wind_into_the_face_slows_and_pushes_to_no_side():
    side, moment = air(20.0, (-10.0, 0.0))
    assert (side, moment) == (0.0, 0.0)
    faces = [
        slope(at.SingleTrack(PAPER), moving(20.0), inputs(acceleration=np.nan, wind=(wind, 0.0)))[3]
        for wind in (-10.0, 0.0, 10.0)
    ]
    assert faces[0] < faces[1] < faces[2] < 0.0


# -- the relaxation length --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("speed", [5.0, 20.0])
@pytest.mark.parametrize("name", ["magic-formula", "passenger-car"])
def test_the_lateral_force_builds_up_over_the_relaxation_length(name, speed):
    plant = at.DualTrack(PAPER, name)
    slippery = inputs(command=1e-4, friction=1e-9)  # without force the car keeps its course meanwhile
    dry = inputs(command=1e-4)
    final = slope(plant, moving(speed, x6=1e-4, x7=1e-4), dry)[4]
    for lengths in (0.5, 1.0, 3.0):
        time = lengths * plant.tyre.relaxation_length / speed
        x = ride(plant, moving(speed), slippery, time, h=time / 50)
        assert slope(plant, x, dry)[4] / final == pytest.approx(1 - math.exp(-lengths), rel=1e-3)


# -- the steering actuator --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
def test_the_steering_lags_by_its_time_constant(plant):
    car = plant(PAPER, steering=at.SteeringActuator(lag=0.15))
    for time in (0.075, 0.15, 0.6):
        angle = ride(car, moving(10.0), inputs(command=0.1), time, h=0.0075)[12]
        assert angle == pytest.approx(0.1 * (1 - math.exp(-time / 0.15)), rel=1e-6)


@pytest.mark.parametrize("plant", [at.SingleTrack, at.DualTrack])
def test_the_steering_turns_no_faster_than_its_rate_and_no_further_than_its_limit(plant):
    car = plant(PAPER, steering=at.SteeringActuator(lag=0.15, rate=0.5, limit=0.3))
    assert ride(car, moving(5.0), inputs(command=1.0), 0.2)[12] == pytest.approx(0.1, rel=1e-9)
    assert ride(car, moving(5.0), inputs(command=-1.0), 0.2)[12] == pytest.approx(-0.1, rel=1e-9)
    assert ride(car, moving(5.0), inputs(command=1.0), 3.0, h=0.01)[12] == pytest.approx(0.3, rel=1e-6)
    expected = reference.steering_speed(car.steering, 0.28, 0.31)
    assert slope(car, moving(5.0, x12=0.28), inputs(command=0.31))[12] == pytest.approx(expected, rel=1e-12)


def test_only_the_wind_relative_to_the_car_counts(rng):
    for yaw, speed, vy, east, north in rng.uniform([-3, 3, -2, -20, -20], [3, 40, 2, 20, 20], (50, 5)):
        relative_wind = reference.rotation(yaw).T @ [east, north]
        turned = air(speed, (east, north), yaw, vy)
        assert turned == pytest.approx(air(speed, tuple(relative_wind), 0.0, vy), rel=1e-9, abs=1e-9)
    still = air(15.0, tuple(reference.rotation(0.4) @ [15.0, 0.0]), yaw=0.4)
    assert still == pytest.approx((0.0, 0.0), abs=1e-9)  # the air moves with the car
