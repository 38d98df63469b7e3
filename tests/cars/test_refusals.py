"""What cars, tyres and plants refuse, and in which words."""

import math

import numpy as np
import pytest

import adaptrack as at
from small_cars import PARAMETERS, linear_car

CAR = at.load_vehicle("midsize-sedan")
OVERSTEERING = CAR.replace(stiffness_front=60e3, stiffness_rear=30e3)


def tyre(**changes):
    numbers = {"kind": "linear", "stiffness_front": 8e4, "stiffness_rear": 9e4, "nominal_load": 4e3}
    return at.Tyre(**({"name": "test"} | numbers | changes))


def data_sheet(**changes):
    return at.vehicle_from_data_sheet("x", **({"mass": 1500, "wheelbase": 2.7} | changes))


def user_plant(right_hand_side=linear_car, parameters=PARAMETERS, mass=1575.0, **fields):
    return at.UserPlant(right_hand_side, parameters, mass, **fields)


class Standing(at.SteppedPlant):
    """A plant with this longest step, which must be refused before it is stepped."""

    def __init__(self, longest_step):
        self.longest_step = longest_step

    def reset(self, motion):
        pytest.fail("it is reset")

    step = reset


def with_wheel(x, u, environment, p, dx):
    dx[:] = 0.0


WITH_WHEEL = user_plant(with_wheel, own_states=("wheel",), start=lambda motion: [1.0, 2.0])
SIX, TWO, SEVEN = np.zeros(6), np.zeros(2), np.zeros(7)
PLANTS = at.SingleTrack(CAR), user_plant()
REFUSALS = [
    # a car
    (lambda: CAR.replace(mass=-1), r"mass = -1: must be a finite number > 0 .*kg"),
    (lambda: CAR.replace(mas=1), r"mas: unknown key. Did you mean 'mass'\?"),
    (lambda: CAR.replace(mass=1.5), r"yaw_inertia/\(mass lf lr\) = .*Give the mass in kg"),
    (lambda: CAR.replace(yaw_inertia=2.5), "do not belong together"),
    (lambda: CAR.replace(stiffness_front=1.0e3), "stiffness_front = 1000 N/rad is .* N/deg times 57.3"),
    (lambda: CAR.replace(stiffness_rear=60.0), "stiffness_rear = 60 N/rad .* kN/rad times 1000"),
    (lambda: CAR.replace(brake_front=-0.01), "brake_front = -0.01: must be a finite number >= 0 and <= 1 "),
    (lambda: CAR.replace(brake_front=1.01), "brake_front = 1.01: must be a finite number >= 0 and <= 1 "),
    (lambda: OVERSTEERING.steady_state_yaw_gain(-1.0), "steady_state_yaw_gain: vx = "),
    (lambda: OVERSTEERING.steady_state_yaw_gain(math.nan), "steady_state_yaw_gain: vx = "),
    (lambda: OVERSTEERING.steady_state_yaw_gain(math.inf), "steady_state_yaw_gain: vx = "),
    (lambda: OVERSTEERING.steady_state_yaw_gain(1000.0), "steady_state_yaw_gain: vx = "),
    (lambda: at.load_vehicle("midsize-sedn"), "no vehicle is named 'midsize-sedn'. Did you mean 'midsize-sedan'"),
    (lambda: at.load_vehicle(3), "= 3: must be text or a path"),
    # a data sheet
    (lambda: data_sheet(mass=3.7), "mass = 3.7 kg: must be .* >= 600 and <= 3500; .* give all six numbers"),
    (lambda: data_sheet(wheelbase=27), "wheelbase = 27 m"),
    (lambda: data_sheet(body_style="cars"), "body_style = 'cars': unknown. Did you mean 'car'"),
    (lambda: data_sheet(lf=1.0, lr=1.0), "do not make the wheelbase"),
    (lambda: data_sheet(stiffness_frnt=1e4), "Did you mean 'stiffness_front'"),
    # a tyre, a steering actuator
    (lambda: tyre(relaxation_length=-0.1), "relaxation_length = -0.1: must be a finite number >= 0"),
    (lambda: tyre(stiffness_load="digressive"), "a digressive stiffness needs the load ratio"),
    (lambda: tyre(stiffness_load="linear", digressive_load_ratio=2.0), "= 2.0: only stiffness_load = 'digress"),
    (lambda: at.load_tyre("passanger-car"), "Did you mean 'passenger-car'"),
    (lambda: at.SteeringActuator(rate=0.5), "rate = 0.5: a rate limit acts on the lag: give lag > 0"),
    (lambda: at.SteeringActuator(lag=0.1, rate=0), "rate = 0"),
    (lambda: at.SteeringActuator(lag=-0.1), "lag = -0.1"),
    (lambda: at.SteeringActuator(limit=2.0), "limit = 2.0"),
    # a plant
    (lambda: at.SingleTrack(CAR, steps=0), r"steps = .*must be a whole number >= 1"),
    (lambda: at.SingleTrack(CAR, steps=-3), r"steps = .*must be a whole number >= 1"),
    (lambda: at.SingleTrack(CAR, steps=2.5), r"steps = .*must be a whole number >= 1"),
    (lambda: user_plant(parameters={"tyres": {"rear": {"stiffness": math.nan}}}), r"tyres\.rear\.stiffness = nan"),
    (lambda: user_plant(parameters={"body": {"mass": "heavy"}}), "mass = 'heavy'"),
    (lambda: user_plant(mass=-1.0), "mass"),
    (lambda: user_plant(mass=math.nan), "mass"),
    (lambda: user_plant(engine_power=-5.0), "engine_power"),
    (lambda: user_plant(longest_step=0.0), "longest_step"),
    (lambda: WITH_WHEEL.initial_state(SIX), "start: shape"),
    *((lambda plant=plant: plant.derivative(np.zeros(5), TWO, SEVEN), "x:") for plant in PLANTS),
    *((lambda plant=plant: plant.derivative(SIX, np.zeros(4), SEVEN), "u:") for plant in PLANTS),
    *((lambda plant=plant: plant.derivative(SIX, TWO, np.ones(4)), "environment:") for plant in PLANTS),
    *((lambda plant=plant: plant.initial_state(np.zeros(5)), "motion: shape") for plant in PLANTS),
    (lambda: at.check_plant(user_plant(steps=1), period=0), "period = 0 s"),
    *((lambda step=step: at.check_plant(Standing(step), period=0.05), r"Plant 'Standing': longest_step = ")
      for step in (0.0, -0.02, math.nan, "0.02", True, 1e-9)),
]  # fmt: skip


@pytest.mark.parametrize(("call", "words"), REFUSALS)
def test_it_is_refused_in_words(call, words):
    with pytest.raises((at.InvalidInput, at.UnknownName), match=words):
        call()
