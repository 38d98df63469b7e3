"""Plants keep their contract, and the checker says which clause a broken one breaks."""

import math

import numpy as np
import pytest

import adaptrack as at
from adaptrack.cars.plant import MOTION_STATES
from adaptrack.core.plants.contract import PLANT_INPUT, PLANT_STATES, SLOTS, place, vehicle_batch
from small_cars import PARAMETERS, linear_car

pytestmark = pytest.mark.kernels

CAR = at.load_vehicle("paper")


# -- one's own plant --------------------------------------------------------------------------------------------------


def user_plant(right_hand_side=linear_car, **fields):
    return at.UserPlant(right_hand_side, dict(PARAMETERS), mass=1575.0, **fields)


OWN_TYRES = {
    "paper": "magic-formula", "midsize-sedan": "passenger-car", "model-car": "model-car", "compact-ev": "compact-ev",
    "small-car": "small-car", "sports-car": "sports-car", "van": "van",
}  # fmt: skip
PAIRS = [(at.DualTrack, *pair) for pair in OWN_TYRES.items()]
PAIRS += [(at.SingleTrack, car, OWN_TYRES[car]) for car in ("paper", "model-car", "van")]
PAIRS += [(plant, "paper", "constant-stiffness") for plant in (at.SingleTrack, at.DualTrack)]
"""Every car and every tyre, each of them at least once."""


@pytest.mark.parametrize(("plant", "car", "tyre"), PAIRS)
@pytest.mark.compiled  # the checker rides for seconds
def test_our_own_plants_pass_the_checker(plant, car, tyre):
    assert {car for _, car, _ in PAIRS} == set(at.list_vehicles())
    assert {tyre for *_, tyre in PAIRS} == set(at.list_tyres())
    vehicle = at.load_vehicle(car)
    low, high = vehicle.domain.speed
    at.check_plant(plant(vehicle, tyre), speeds=(1.25 * low, 0.5 * (low + high), high))


@pytest.mark.compiled
def test_a_users_plant_passes_the_checker():
    at.check_plant(user_plant())


def pulls_left(x, u, environment, p, dx):
    linear_car(x, u, environment, p, dx)
    dx[5] += 0.01


@pytest.mark.compiled
def test_a_lopsided_plant_passes_when_it_says_so():
    at.check_plant(user_plant(pulls_left), symmetric=False)


def test_a_users_plant_has_its_own_states_and_parameters():
    plant = user_plant(own_states=("roll", "roll_rate"), label="rolling car", tyres="linear", steps=7)
    assert plant.state_names == (*MOTION_STATES, "roll", "roll_rate")
    assert (plant.name, plant.tyre_name) == ("rolling car", "linear")
    assert plant.substeps(0.1, 50.0) == 7
    packed = plant.with_steering(at.SteeringActuator(lag=0.2, rate=0.4, limit=0.5)).packed()
    assert packed.tolist() == [0.2, 0.4, 0.5, 0.0, *PARAMETERS.values()]
    assert plant.powertrain == {"mass": 1575.0, "engine_power": 1e5, "traction_limit": 8000.0, "brake_limit": 15000.0}


def test_nested_parameters_are_read_by_their_names():
    def on_tables(x, u, environment, p, dx):
        dx[:] = 0.0
        dx[3] = p.body.mass + p.tyres.front.stiffness
        dx[4] = p.tyres.rear.stiffness

    tables = {"body": {"mass": 2.0}, "tyres": {"front": {"stiffness": 3.0}, "rear": {"stiffness": 5.0}}}
    plant = at.UserPlant(on_tables, tables, mass=1.0)
    assert plant.derivative(np.zeros(6), [0.0, 0.0], np.zeros(7)).tolist() == [0.0, 0.0, 0.0, 5.0, 5.0, 0.0]
    assert plant.packed()[4:].tolist() == [2.0, 3.0, 5.0]


@pytest.mark.parametrize("steering", [at.SteeringActuator.ideal(), at.SteeringActuator(lag=0.1)])
def test_a_users_plant_is_told_the_prescribed_acceleration(steering):
    def remembers(x, u, environment, p, dx):
        dx[:] = 0.0
        dx[0] = x[3]
        dx[3] = 99.0
        dx[6] = u[2] if u[2] == u[2] else -1.0
        dx[7] = u[1]

    plant = at.UserPlant(remembers, {}, 1.0, own_states=("told", "pushed"), steering=steering)
    slope = plant.derivative(np.zeros(8), [0.0, 0.0, 1.5], np.zeros(7))
    assert (slope[3], slope[6]) == (1.5, 1.5)
    unaware = plant.derivative(np.zeros(8), [0.0, 40.0], np.zeros(7))
    assert (unaware[3], unaware[6], unaware[7]) == (99.0, -1.0, 40.0)

    vehicles = vehicle_batch(plant.compiled, plant.packed(), plant.initial_state([0, 0, 0, 10.0, 0, 0])[None])
    place(1, vehicles.start, vehicles.block, vehicles.states)
    for acceleration, force, expected in ((2.0, 0.0, (10.4, 0.4, 0.0)), (math.nan, 7.0, (30.2, 0.2, 1.4))):
        vehicles.block[(PLANT_STATES + PLANT_INPUT.acceleration) * SLOTS] = acceleration
        vehicles.block[(PLANT_STATES + PLANT_INPUT.force) * SLOTS] = force
        plant.compiled.advance(
            vehicles.member, vehicles.parameters, vehicles.block, vehicles.states, vehicles.work, 1, 4, 0.05
        )
        assert vehicles.states[0, [3, 6, 7]] == pytest.approx(expected)


def test_the_longest_step_makes_more_steps_of_a_longer_period():
    plant = user_plant(steps=3, longest_step=2e-3)
    assert [plant.substeps(period, 20.0) for period in (0.001, 0.05, 0.1)] == [3, 25, 50]


# -- each clause of the contract --------------------------------------------------------------------------------------
@at.Plant.register
class Altered:
    """A good plant with some of its members replaced; slope(good derivative, x, u, environment, calls) alters one."""

    def __init__(self, slope=None, **members):
        self.good, self.slope, self.calls = at.SingleTrack(CAR), slope, 0
        vars(self).update(members)

    def __getattr__(self, name):  # what is not replaced
        return getattr(self.good, name)

    def derivative(self, x, u, environment):
        self.calls += 1
        slope = self.good.derivative(x, u, environment)
        return slope if self.slope is None else self.slope(slope, x, u, environment, self.calls)


def set_entry(place, value):
    def slope(slope, x, u, environment, calls):
        slope[place] = value(slope, x, u)
        return slope

    return slope


def write_to_each_argument(slope, x, u, environment, calls):
    (x, u, environment)[calls % 3][1] += 1e-9
    return slope


def drifting(slope, x, u, environment, calls):
    return slope + 1e-12 * calls


def only_forced(slope, x, u, environment, calls):
    return np.where(np.isfinite(u[2]), math.nan, slope)


def writes_to_parameters(x, u, environment, p, dx):
    linear_car(x, u, environment, p, dx)
    p[0] *= 1.001


def forgets_a_state(x, u, environment, p, dx):
    dx[0], dx[1], dx[2], dx[3], dx[5] = x[3], 0.0, 0.0, 0.0, 0.0


BROKEN = [
    ("its states must begin with", Altered(state_names=("Y", "X", *MOTION_STATES[2:]))),
    (r"packed\(\) must give one row of finite parameters", Altered(packed=lambda: np.full(34, np.nan))),
    ("every derivative must be written and finite.*yaw_rate", Altered(set_entry(5, lambda slope, x, u: math.nan))),
    (r"must be written and finite.*under a prescribed acceleration, u\[2\]", Altered(only_forced)),
    (r"written and finite.*'vy'", user_plant(forgets_a_state)),
    ("x, u, environment and p must not be written to", Altered(write_to_each_argument)),
    ("must not be written to", user_plant(writes_to_parameters)),
    ("the same arguments must give the same derivative", Altered(drifting)),
    (r"position and yaw must obey kinematics, eq\. \(5\)", Altered(set_entry(1, lambda slope, x, u: -slope[1]))),
    ("at zero steering the vehicle must go straight", Altered(set_entry(4, lambda slope, x, u: slope[4] + 0.01))),
    pytest.param("must go straight", user_plant(pulls_left), marks=pytest.mark.compiled),
    (r"to the left \(positive\) must begin a turn to the left", Altered(set_entry(5, lambda slope, x, u: -slope[5]))),
    ("the mirrored steering must give the mirrored motion",
     Altered(set_entry(5, lambda slope, x, u: slope[5] * (1.0 if u[0] >= 0.0 else 1.5)))),
    ("its steps must be small enough to integrate it", Altered(substeps=lambda period, top_speed: 1)),
]  # fmt: skip


@pytest.mark.compiled
def test_a_function_beyond_the_subset_is_refused_with_the_reason():
    def nonsense(x, u, environment, p, dx):
        dx[0] = "fast"

    with pytest.raises(at.ContractError, match=r"cannot compile.*float64 arrays"):
        user_plant(nonsense)


@pytest.mark.parametrize(("clause", "plant"), BROKEN)
def test_the_checker_refuses_a_plant_that_breaks(clause, plant):
    with pytest.raises(at.ContractError, match=clause):
        at.check_plant(plant, speeds=(2.0, 10.0))


def test_the_checker_integrates_in_the_period_that_will_be_used():
    plant = user_plant(steps=1)
    at.check_plant(plant, speeds=(5.0,), period=0.01)
    with pytest.raises(at.ContractError, match=r"1 steps in a control period of 0\.2 s.*longest_step="):
        at.check_plant(plant, speeds=(5.0,), period=0.2)
    at.check_plant(user_plant(steps=1, longest_step=0.01), speeds=(5.0,), period=0.2)


# -- where a plant starts ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("plant", [at.SingleTrack(CAR), at.DualTrack(CAR)], ids=lambda plant: plant.name)
def test_what_the_start_does_not_say_is_zero(plant):
    motion = [1.0, -2.0, 0.1, 12.0, 0.3, -0.2]
    start = plant.initial_state(motion)
    assert start.tolist() == motion + [0.0] * (len(plant.state_names) - 6)


def test_a_users_plant_says_its_own_equilibrium():
    linear_car_compiled = user_plant().compiled.right_hand_side

    def with_wheel(x, u, environment, p, dx):
        linear_car_compiled(x, u, environment, p, dx)
        dx[6] = (x[3] / 0.3 - x[6]) / 0.05

    plant = user_plant(with_wheel, own_states=("wheel",), start=lambda motion: [motion[3] / 0.3])
    assert plant.initial_state([0, 0, 0, 12.0, 0, 0]).tolist() == [0, 0, 0, 12.0, 0, 0, pytest.approx(40.0)]


# -- stepped plants ---------------------------------------------------------------------------------------------------
class Bicycle(at.SteppedPlant):
    """A kinematic bicycle; `fault` names the clause that it breaks."""

    def __init__(self, fault=""):
        self.fault = fault
        self.drift = 0.0

    def reset(self, motion):
        self.motion = np.array(motion)
        if self.fault != "after reset":
            self.drift = 0.0

    def step(self, dt, steering, acceleration, environment):
        x, y, yaw, v, _, _ = self.motion
        rate = v * math.tan(-steering if self.fault == "to the left" else steering) / 2.8
        if self.fault == "mirrored":
            rate *= 1.0 + 10.0 * max(steering, 0.0)
        self.drift += 1e-3
        rate += 1e-4 * (self.fault == "go straight") + 1e-3 * self.drift * (self.fault == "after reset")
        middle = yaw + 0.5 * dt * rate
        pace = 0.0 if self.fault == "follow the speed" else v
        self.motion = np.array(
            [x + dt * pace * math.cos(middle), y + dt * v * math.sin(middle), yaw + dt * rate, v, 0.0, rate]
        )
        if self.fault == "write to its arguments":
            environment[0] = 0.0
        return self.motion[:5] if self.fault == "six finite numbers" else self.motion


def test_a_stepped_plant_passes_the_checker_and_may_be_registered(monkeypatch):
    from adaptrack.cars import plant as module

    at.check_plant(Bicycle())
    monkeypatch.setattr(module._registry, "factories", dict(module._registry.factories))
    at.register_plant("bicycle", lambda car, tyre: Bicycle())
    assert "bicycle" in at.list_plants()
    assert isinstance(at.get_plant("bicycle", CAR), Bicycle)


def test_a_stepped_plant_is_checked_with_the_steps_of_the_loop():
    class Noting(Bicycle):
        longest_step = 0.02

        def step(self, dt, *arguments):
            steps.add(round(dt, 9))
            return super().step(dt, *arguments)

    steps = set()
    at.check_plant(Noting(), speeds=(10.0,), period=0.05)
    assert steps == {round(0.05 / 3, 9)}


@pytest.mark.parametrize("fault", [
    "six finite numbers", "write to its arguments", "go straight", "follow the speed", "to the left", "mirrored",
    "after reset",
])  # fmt: skip
def test_the_checker_refuses_a_stepped_plant_that_breaks(fault):
    with pytest.raises(at.ContractError, match=fault):
        at.check_plant(Bicycle(fault), symmetric=fault != "after reset")
