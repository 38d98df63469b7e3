"""CommonRoad's cars drive as their own functions say; skipped without commonroad-vehicle-models."""

import dataclasses
import math
import sys

import numpy as np
import pytest

import adaptrack as at
import commonroad_cars
import commonroad_kernel as kernel
from adaptrack.analysis.stability import linear_twin
from adaptrack.cars.plant import twin_of
from commonroad_cars import CARS, MODELS, commonroad_parameters, commonroad_plant, commonroad_vehicle

pytestmark = pytest.mark.slow
DRIFT, BODY = MODELS
STILL = [0.0, 0.0, 0.0]  # wind, bank


@pytest.fixture(scope="module", autouse=True)
def _installed():
    pytest.importorskip(
        "vehiclemodels", reason="needs commonroad-vehicle-models: pip install commonroad-vehicle-models"
    )


@pytest.fixture(scope="module")
def drift():
    return commonroad_plant(DRIFT, 2)


@pytest.fixture(scope="module")
def body():
    return commonroad_plant(BODY, 2)


@pytest.fixture(scope="module", params=MODELS)
def plant(request):
    return request.getfixturevalue({DRIFT: "drift", BODY: "body"}[request.param])


def their_parameters(number=2):
    from vehiclemodels.vehicle_parameters import setup_vehicle_parameters

    return setup_vehicle_parameters(number)


def somewhere(plant, rng, speed):
    """A state of a car that slides, rolls and slips, faster than the wheels are spun up in full."""
    x = plant.initial_state([1.0, -2.0, 0.4, speed, rng.normal(0.0, 0.3), rng.normal(0.0, 0.2)])
    spread = {"wheel": 0.3, "roll": 0.02, "pitch": 0.01, "z": 0.002, "vz": 0.01, "vy": 0.05, "joint": 0.002}
    for i, name in enumerate(plant.state_names[6:], 6):
        x[i] += spread[name.split("_")[0]] * rng.normal()
    return x


# -- the equations ----------------------------------------------------------------------------------------------------
def of_their_drift_model(x, steering, acceleration, car):
    from vehiclemodels.vehicle_dynamics_std import vehicle_dynamics_std

    speed, beta = math.hypot(x[3], x[4]), math.atan2(x[4], x[3])
    f = vehicle_dynamics_std([x[0], x[1], steering, speed, x[2], x[5], beta, x[6], x[7]], [0.0, acceleration], car)
    along, across = f[3], speed * f[6]
    c, s = math.cos(beta), math.sin(beta)
    return [f[0], f[1], f[4], c * along - s * across, s * along + c * across, *f[5:6], *f[7:]]


def of_their_body_model(x, steering, acceleration, car):
    from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb

    z = [0.0] * 29
    z[2] = steering
    for place, value in zip(kernel.MB_PLACES, x.tolist(), strict=True):
        z[place] = value
    f = vehicle_dynamics_mb(z, [0.0, acceleration], car)
    return [f[place] for place in kernel.MB_PLACES]


def test_without_air_the_derivative_is_that_of_their_own_function(plant):
    car, rng = their_parameters(), np.random.default_rng(3)
    airless = commonroad_vehicle(2).replace(frontal_area=0.0)
    plant = commonroad_plant(plant.name.removeprefix("commonroad-"), 2, airless)
    reference = of_their_drift_model if "drift" in plant.name else of_their_body_model
    around = [car.tire.p_dy1] * 4 + STILL
    for speed in (9.0, 15.0, 30.0):
        x = somewhere(plant, rng, speed)
        expected = reference(x, 0.03, 0.7, car)
        np.testing.assert_allclose(plant.derivative(x, [0.03, 0.7 * car.m], around), expected, rtol=1e-10, atol=1e-10)
        expected[3] = 0.7  # prescribed, and told
        np.testing.assert_allclose(plant.derivative(x, [0.03, 0.0, 0.7], around), expected, rtol=1e-10, atol=1e-10)


def test_wind_and_bank_push_the_whole_car(plant):
    car = commonroad_vehicle(2)
    x = plant.initial_state([0.0, 0.0, 0.0, 20.0, 0.0, 0.0])
    calm = plant.derivative(x, [0.0, 0.0, 0.0], [0.9] * 4 + STILL)
    windy = plant.derivative(x, [0.0, 0.0, 0.0], [0.9] * 4 + [0.0, 4.0, 0.0])
    angle = math.atan2(4.0, 20.0)
    pressure = 0.5 * car.air_density * car.frontal_area * (20.0**2 + 4.0**2)
    pushed = commonroad_parameters(2)["m_s"] if "body" in plant.name else car.mass
    assert windy[4] - calm[4] == pytest.approx(pressure * car.side_force_slope * angle / pushed)
    moment = pressure * car.wheelbase * car.yaw_moment_slope * angle
    assert windy[5] - calm[5] == pytest.approx(moment / car.yaw_inertia)
    banked = plant.derivative(x, [0.0, 0.0, 0.0], [0.9] * 4 + [0.0, 0.0, 0.5]) - calm
    pulled = [i for i, name in enumerate(plant.state_names) if name.startswith("vy")]
    assert banked[pulled] == pytest.approx(0.5)
    assert np.delete(banked, pulled) == pytest.approx(0.0)


@pytest.mark.parametrize("friction", [0.3, 0.9])
def test_friction_bounds_the_force_and_leaves_the_stiffness(drift, friction):
    car = commonroad_vehicle(2)
    x, around = drift.initial_state([0.0, 0.0, 0.0, 15.0, 0.0, 0.0]), [friction] * 4 + STILL
    force = np.array([drift.derivative(x, [a, 0.0, 0.0], around)[4] for a in np.linspace(-0.3, 0.3, 301)]) * car.mass
    front = car.mass * 9.81 * car.lr / car.wheelbase
    assert np.abs(force).max() == pytest.approx(friction * front, rel=0.03)
    slope = (force[151] - force[149]) / 0.004
    assert slope == pytest.approx(2.0 * car.stiffness_front, rel=0.02)


# -- driving ----------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("number", CARS)
@pytest.mark.parametrize("speed", [4.0, 12.0, 27.0])
def test_a_car_starts_rolling_in_equilibrium(plant, number, speed):
    plant_of_number = commonroad_plant(plant.name.removeprefix("commonroad-"), number)
    x = plant_of_number.initial_state([5.0, 1.0, 0.3, speed, 0.0, 0.0])
    slope = plant_of_number.derivative(x, [0.0, 0.0, 0.0], [0.9] * 4 + STILL)
    radius = commonroad_parameters(number)["R_w"]
    upright = [
        i for i, name in enumerate(plant_of_number.state_names[6:], 6) if not name.startswith(("roll", "vy", "joint"))
    ]
    assert np.abs(slope[upright]).max() < 1e-6
    rolling = [i for i, name in enumerate(plant_of_number.state_names) if name.startswith("wheel")]
    assert x[rolling] * radius == pytest.approx(speed, rel=2e-3)


def advance(plant, x, u, seconds):
    """Under inputs held, by the plant's own steps."""
    n = plant.substeps(seconds, 20.0)
    h = seconds / n
    around = np.array([0.9] * 4 + STILL)
    for _ in range(n):
        k1 = plant.derivative(x, u, around)
        k2 = plant.derivative(x + 0.5 * h * k1, u, around)
        k3 = plant.derivative(x + 0.5 * h * k2, u, around)
        k4 = plant.derivative(x + h * k3, u, around)
        x = x + h / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
    return x


def test_under_a_prescribed_acceleration_wheels_roll_along_and_the_body_pitches(body):
    start = body.initial_state([0.0, 0.0, 0.0, 20.0, 0.0, 0.0])
    pitch = body.state_names.index("pitch")
    wheels = [i for i, name in enumerate(body.state_names) if name.startswith("wheel")]
    rates = []
    for acceleration in (-3.0, 3.0):
        x = advance(body, start, [0.0, 0.0, acceleration], 1.5)
        assert x[3] == pytest.approx(20.0 + 1.5 * acceleration)
        assert x[wheels] * commonroad_parameters(2)["R_w"] == pytest.approx(x[3], rel=0.04)
        rates.append(x[pitch] - start[pitch])
    braking, driving = rates
    assert braking * driving < 0.0
    assert abs(braking) > 0.005  # rad
    assert braking == pytest.approx(-driving, rel=0.2)


@pytest.mark.parametrize("number", CARS)
def test_the_data_sheet_has_the_yaw_gain_of_the_drift_model(number):
    plant, car = commonroad_plant(DRIFT, number), commonroad_vehicle(number)
    straight = plant.initial_state([0.0, 0.0, 0.0, 15.0, 0.0, 0.0])
    left, right = (advance(plant, straight, [angle, 0.0, 0.0], 3.0)[5] for angle in (0.005, -0.005))
    assert (left - right) / 0.01 == pytest.approx(car.steady_state_yaw_gain(15.0), rel=0.02)


def test_the_models_pass_the_checker_which_names_the_option_for_their_lopsided_tyres(plant):
    at.check_plant(plant, symmetric=False, period=0.05)
    with pytest.raises(at.ContractError, match=r"go straight.*symmetric=False"):
        at.check_plant(plant, period=0.05)


@pytest.mark.parametrize("profile", ["road", "production"])
def test_the_default_controller_drives_it_from_its_data_sheet(plant, profile):
    drives = [at.random_drive(31_000_000 + i, duration=20.0) for i in range(4)]
    mpc = at.MPC(commonroad_vehicle(2), profile=profile)
    runs = at.rollout_batch(plant, mpc, drives, profile=profile, seeds=np.arange(4))
    assert not any(runs.failed)
    assert runs.mse.max() < 0.01  # m^2
    run = at.simulate(plant, mpc, drives[0], profile=profile, seed=0)
    assert np.mean(run.error**2) == pytest.approx(runs.mse[0], rel=1e-12)


# -- parameters -------------------------------------------------------------------------------------------------------
def test_parameters_come_by_number_as_tables_as_their_dataclass_or_as_toml(tmp_path):
    import tomli_w

    by_number = commonroad_parameters(2)
    assert by_number["tire"]["p_ky1"] == their_parameters().tire.p_ky1
    assert commonroad_parameters(their_parameters()) == commonroad_parameters(by_number) == by_number
    file = tmp_path / "my-car.toml"
    file.write_text(tomli_w.dumps(by_number | {"m": 1200.0}))
    assert commonroad_parameters(file) == by_number | {"m": 1200.0}
    car = commonroad_vehicle(file)
    assert (car.name, car.mass) == ("my-car", 1200.0)
    assert commonroad_plant(DRIFT, file).mass == 1200.0


def changed(**changes):
    return commonroad_parameters(commonroad_parameters(2) | changes)


def of_body(car, *tyre):
    return at.get_plant("commonroad-multi-body", car, *tyre)


NUMBERS = r"1 \(Ford Escort\), 2 \(BMW 320i\), 3 \(VW Vanagon\)"


@pytest.mark.parametrize(("call", "error", "words"), [
    (lambda: changed(m=None), at.ConfigError, "m is missing"),
    (lambda: changed(I_z="heavy"), at.ConfigError, "I_z = 'heavy' is no number"),
    (lambda: changed(tire=commonroad_parameters(2)["tire"] | {"p_ky1": math.nan}), at.ConfigError,
     r"tire\.p_ky1 = nan is not finite.*"),
    (lambda: changed(steering={}), at.ConfigError, r"steering\.min is missing, steering\.max is missing"),
    (lambda: commonroad_parameters(2.5), at.InvalidInput, "number"),
    (lambda: commonroad_vehicle(0), at.UnknownName, NUMBERS),
    (lambda: commonroad_vehicle(4), at.UnknownName, NUMBERS),
    (lambda: commonroad_vehicle(7), at.UnknownName, NUMBERS),
    (lambda: commonroad_vehicle(True), at.UnknownName, NUMBERS),
    (lambda: commonroad_plant("multibody", 2), at.UnknownName, "multi-body"),
    (lambda: of_body(at.load_vehicle("paper")), at.InvalidInput,
     r"'paper' is none of CommonRoad's: take commonroad_vehicle"),
    (lambda: of_body(commonroad_vehicle(1).replace(mass=900.0)), at.InvalidInput,
     r"mass = 900\.0.*give the controller"),
    (lambda: of_body(commonroad_vehicle(1), "passenger-car"), at.InvalidInput, "leave the tyre out"),
])  # fmt: skip
def test_what_is_none_of_commonroads_is_refused_in_words(call, error, words):
    with pytest.raises(error, match=words):
        call()


# -- by name ----------------------------------------------------------------------------------------------------------
def test_get_plant_drives_the_car_of_the_data_sheet_in_its_air(tmp_path):
    car = commonroad_vehicle(3)
    car.to_toml(tmp_path / "commonroad-3.toml")
    car = at.load_vehicle(tmp_path / "commonroad-3.toml").replace(frontal_area=4.0)
    plant = at.get_plant("commonroad-single-track-drift", car)
    assert plant.mass == car.mass
    assert plant.parameters["air.frontal_area"] == 4.0
    assert {"commonroad-multi-body", "commonroad-single-track-drift"} <= set(at.list_plants())


def test_without_their_package_or_a_compiler_the_remedy_is_named(monkeypatch):
    monkeypatch.setattr(commonroad_cars, "compiles", lambda: False)
    with pytest.raises(at.MissingExtra, match=r"pip install 'adaptrack\[compile\]'"):
        commonroad_plant(DRIFT, 1)
    monkeypatch.setitem(sys.modules, "vehiclemodels.vehicle_parameters", None)
    commonroad_cars._shipped.cache_clear()
    with pytest.raises(at.MissingExtra, match="pip install commonroad-vehicle-models"):
        commonroad_vehicle(1)


def test_another_steering_actuator_changes_nothing_else(plant):
    other = plant.with_steering(at.SteeringActuator(lag=0.1))
    assert dataclasses.replace(other, steering=None) == dataclasses.replace(plant, steering=None)
    assert (other.packed()[3:] == plant.packed()[3:]).all()


# -- where they have no linear model ----------------------------------------------------------------------------------
def test_the_drift_model_is_linearised_and_the_multi_body_model_whose_tyres_jump_with_camber_is_refused(drift, body):
    from adaptrack.analysis.linearisation import linearised, steady_turn

    car = commonroad_vehicle(2)
    angle = steady_turn(drift, 15.0, 2.0).steering
    assert angle == pytest.approx(2.0 / 15.0 / car.steady_state_yaw_gain(15.0), rel=0.01)
    names, a, _ = linearised(drift, 15.0)
    assert {"vy", "yaw_rate"} <= set(names)
    assert np.linalg.eigvals(a).real.max() < 1e-6
    with pytest.raises(at.InvalidInput, match=r"derivatives jump with .*single-track"):
        linearised(body, 15.0)


def test_what_is_sought_for_a_car_is_driven_on_the_drift_model_and_not_on_the_multi_body_model(drift, body):
    car = commonroad_vehicle(2)
    assert linear_twin(drift, car, car.domain) is drift
    assert linear_twin(body, car, car.domain) == twin_of(car)  # its derivatives jump
