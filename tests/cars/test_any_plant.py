"""Any registered plant goes through the chain: stepped ones, foreign ones, those that need a twin."""

import inspect
import logging
import math
import sys
from functools import partial

import numpy as np
import pytest

import adaptrack as at
from adaptrack import cli
from adaptrack.analysis.linearisation import linearised
from adaptrack.analysis.stability import linear_twin
from adaptrack.cars import plant as plant_module
from adaptrack.cars.plant import fingerprint, twin_of
from adaptrack.paper.campaign import run_campaign, tuned_mpc
from adaptrack.paper.campaign_config import CampaignConfig, CampaignPlan
from adaptrack.paper.data_set import load_dataset
from adaptrack.tuning.car import TuningEffort
from adaptrack.tuning.constant import load_tuning
from adaptrack.tuning.objective import Objective
from adaptrack.tuning.pso import SwarmSettings
from adaptrack.tuning.runs import operating_point_runs

CAR = at.load_vehicle("paper")
POINTS = [[10.0, 1.0, 0.9, 5.0], [20.0, -2.0, 0.6, -10.0]]
SMALL = TuningEffort(
    drives=1, hard_drives=1, seconds=3.0, swarm=SwarmSettings(particles=3, generations=2), unseen_drives=4,
    levels=(3, 2),
)  # fmt: skip


class Sliding(at.SteppedPlant):
    """The linear single-track car in plain Python, as an outside simulator would be."""

    longest_step = 0.025

    def __init__(self, vehicle):
        self.car = vehicle

    def reset(self, motion):
        self.motion = np.array(motion, dtype=float)

    def step(self, dt, steering, acceleration, environment):
        car, (x, y, yaw, v, vy, r) = self.car, self.motion.tolist()
        front = 2.0 * car.stiffness_front * (steering - (vy + car.lf * r) / max(v, 1.0))
        rear = 2.0 * car.stiffness_rear * (car.lr * r - vy) / max(v, 1.0)
        vy += dt * ((front + rear) / car.mass - v * r + environment[6])
        r += dt * (car.lf * front - car.lr * rear) / car.yaw_inertia
        c, s = math.cos(yaw), math.sin(yaw)
        self.motion = np.array(
            [x + dt * (v * c - vy * s), y + dt * (v * s + vy * c), yaw + dt * r, v + dt * acceleration, vy, r]
        )
        return self.motion


class Cheap(Sliding):
    """DrivenSetup throughout, not only judged on."""

    costly = False


@pytest.fixture
def registered(monkeypatch, tmp_path):
    """The module `sliding`, which registers both, in a folder where Python looks for modules."""
    head = (
        "import math\nimport numpy as np\nimport adaptrack as at\nfrom adaptrack.cars.plant import register_plant\n\n"
    )
    last = "".join(
        f'\nregister_plant("{plant.__name__.lower()}", lambda vehicle, tyre: {plant.__name__}(vehicle))\n'
        for plant in (Sliding, Cheap)
    )
    (tmp_path / "sliding.py").write_text(head + inspect.getsource(Sliding) + "\n\n" + inspect.getsource(Cheap) + last)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(plant_module._registry, "factories", dict(plant_module._registry.factories))
    yield
    sys.modules.pop("sliding", None)


def campaign(**changes):
    values = {
        "name": "pond", "profile": "road", "scenario": "lane-change", "noise_seeds": [1], "duration": 2.0,
        "operating_points": {"kind": "grid", "speed": [10.0], "y_ref": [1.0], "friction": [0.9], "wind": [0.0, 5.0]},
        "swarm": {"particles": 3, "generations": 2}, "library": {"tunings": [[30, 8, 1.0, 5e3], [25, 5, 1.0, 2e4]]},
    }  # fmt: skip
    return CampaignConfig(**{**values, **changes})


# -- run by run is the same as compiled -------------------------------------------------------------------------------
@pytest.mark.compiled
def test_segments_counted_from_simulated_runs_are_those_of_the_kernel_failed_ones_included():
    mpc = at.MPC(CAR, profile="road")
    runs = operating_point_runs(at.SingleTrack(CAR), mpc, POINTS, "road", segment=30)
    for tuning in (mpc.tuning, at.Tuning(5, 1, 1.0, 1e-4)):
        simulated = np.array([runs._simulated_segments(tuning, i, i, 3) for i in range(2)])
        np.testing.assert_allclose(simulated, runs.segments(tuning, 3, np.arange(2)), rtol=1e-9)
    assert np.isinf(simulated).any()  # one has failed


def test_compiled_runs_refuse_a_stepped_plant_with_the_remedy():
    with pytest.raises(at.InvalidInput, match=r"simulate\(\.\.\.\) drives a SteppedPlant"):
        at.rollout_batch(Sliding(CAR), at.MPC(CAR, profile="road"), [at.load_scenario("sine")], profile="road")


def test_a_stepped_motion_that_is_not_finite_ends_the_run_as_failed():
    class Broken(Sliding):
        def step(self, dt, steering, acceleration, environment):
            return np.full(6, math.nan)

    scenario = at.load_scenario("lane-change", duration=2.0)
    run = at.simulate(Broken(CAR), at.MPC(CAR, profile="road"), scenario, profile="road")
    assert run.failed == "not-finite"


@pytest.mark.compiled
def test_costs_and_swarms_run_by_run_are_those_of_the_kernel(monkeypatch):
    target = Objective(
        at.SingleTrack(CAR), at.MPC(CAR, profile="road"), "lane-change", "road", noise_seeds=(3, 4), duration=2.0
    )
    tunings = np.array([[30.0, 8.0, 1.0, 5.0], [25.0, 5.0, 1.0, 20.0]])
    simulated, _ = target._simulated_trial(POINTS[0], tunings, np.full(2, np.inf))
    np.testing.assert_allclose(simulated, target.costs(POINTS[0], tunings), rtol=1e-9)
    settings = SwarmSettings(particles=4, generations=3)
    compiled = target.tune(POINTS[0], settings, 5, 7)
    monkeypatch.setattr(Objective, "_trial", lambda self, point, *_: partial(self._simulated_trial, point))
    searched = target.tune(POINTS[0], settings, 5, 7)
    np.testing.assert_array_equal(searched.tuning, compiled.tuning)
    assert searched.evaluations == compiled.evaluations
    assert searched.control_steps == 40 * 2 * 12 > compiled.control_steps  # none is stopped early


# -- the twin ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", at.list_vehicles())
def test_a_twin_has_the_steady_yaw_gain_that_the_controller_is_told(name):
    car = at.load_vehicle(name)
    speed = 0.5 * car.domain.speed[1]
    names, a, b = linearised(twin_of(car), speed)
    gain = -np.linalg.lstsq(a, b, rcond=None)[0][names.index("yaw_rate")]
    L, front, rear = car.lf + car.lr, 2.0 * car.stiffness_front, 2.0 * car.stiffness_rear
    understeer = car.mass / L * (car.lr / front - car.lf / rear)
    assert gain == pytest.approx(speed / (L + understeer * speed**2), rel=0.03)  # the air turns it a little


def test_a_plant_with_a_linear_model_stands_for_itself_and_a_stepped_one_has_a_twin():
    plant = at.DualTrack(CAR)
    assert linear_twin(plant, CAR, CAR.domain) is plant
    assert linear_twin(Sliding(CAR), CAR, CAR.domain) == twin_of(CAR)


# -- the chain --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("kind", [Sliding, Cheap])
def test_a_stepped_plant_is_tuned_and_told_how_long_it_takes(kind, caplog):
    with caplog.at_level(logging.WARNING, "adaptrack"):
        result = at.tune(CAR, plant=kind(CAR), effort=SMALL)
    assert "is stepped in Python" in caplog.text
    assert "min." in caplog.text
    assert result.failed == 0
    assert result.passed
    assert result.certificate.plant != result.plant
    assert result.costly == kind.costly


@pytest.mark.compiled
def test_a_campaign_on_a_stepped_plant_costs_what_its_objective_says(registered, tmp_path):
    config = campaign(plant="cheap", plugin=["sliding"])
    data = load_dataset(run_campaign(config, tmp_path / "out", workers=1))
    setup = CampaignPlan.of(config).setup
    target = Objective(
        setup.plant(), tuned_mpc(setup), "lane-change", "road", noise_seeds=(1,), duration=2.0,
        failure=config.failure.rule,
    )  # fmt: skip
    costs = target.costs([10.0, 1.0, 0.9, 5.0], setup.config.library.rows(setup.config.search))
    np.testing.assert_allclose(data.landscape[1], costs, rtol=1e-6)  # kept in single precision


def test_the_identity_of_a_campaign_tells_plants_apart_but_not_modules_that_register_them(registered):
    plain, slid = CampaignPlan.of(campaign()), CampaignPlan.of(campaign(plant="cheap", plugin=["sliding"]))
    assert "plant_fingerprint" not in plain.settings
    assert slid.settings["plant_fingerprint"] == fingerprint(slid.setup.plant())
    assert plain.identity == CampaignPlan.of(campaign(plugin=["sliding"])).identity
    assert plain.identity != slid.identity
    assert fingerprint(Cheap(CAR)) != fingerprint(Sliding(CAR))


def test_a_plant_that_a_worker_cannot_find_is_named_with_the_remedy():
    with pytest.raises(at.UnknownName, match=r"There is no plant 'cheap'.*key plugin"):
        CampaignPlan.of(campaign(plant="cheap"))
    with pytest.raises(at.UnknownName, match=r"plugin 'nowhere': there is no such module.*PYTHONPATH"):
        CampaignPlan.of(campaign(plugin=["nowhere"]))


# -- the command ------------------------------------------------------------------------------------------------------
@pytest.fixture
def tune_paper(monkeypatch, registered, tmp_path):
    """`adaptrack tune paper` with a short search."""
    monkeypatch.setattr("adaptrack.tune", partial(at.tune, effort=SMALL))

    def run(*arguments):
        monkeypatch.setattr(sys, "argv", ["adaptrack", "tune", "paper", "--out", str(tmp_path / "out"), *arguments])
        return cli.main()

    return run


@pytest.mark.compiled
@pytest.mark.parametrize("passed", [True, False])
def test_tune_writes_the_car_and_its_constant_and_its_exit_code_tells_the_outcome(
    tune_paper, monkeypatch, tmp_path, passed
):
    monkeypatch.setattr("adaptrack.tuning.car.TunedCar.passed", property(lambda self: passed))
    assert tune_paper() == (0 if passed else 3)
    car, constant = at.load_vehicle(tmp_path / "out" / "paper.toml"), load_tuning(tmp_path / "out" / "tuning.toml")
    assert (car.name, constant.vehicle, constant.controller) == ("paper", "paper", "informed")


@pytest.mark.compiled
def test_tune_takes_a_registered_plant(tune_paper, capsys):
    assert tune_paper("--plant", "sliding", "--plugin", "sliding") == 0
    assert "has no linear model" in capsys.readouterr().out


@pytest.mark.compiled
def test_runs_of_a_plant_of_ones_own_are_shared_among_threads_and_cost_the_same_to_the_bit():
    def slides(x, u, environment, p, dx):
        dx[0], dx[1], dx[2] = x[3] * math.cos(x[2]), x[3] * math.sin(x[2]), x[5]
        dx[3], dx[4] = 0.0, 0.0
        dx[5] = 5.0 * (x[3] * u[0] / 2.8 - x[5])

    plant = at.UserPlant(slides, {"none": 0.0}, mass=1500.0, steps=4)
    mpc = at.MPC(CAR, profile="road")
    runs = operating_point_runs(plant, mpc, [[10.0, 1.0, 0.9, w] for w in (0.0, 2.0, 4.0, 6.0, 8.0)], "road")
    batch, indices = runs._mpc_batch, np.arange(5)
    assert [len(chunk) for chunk in batch.chunks(indices, 2)] == [3, 2]
    assert [len(chunk) for chunk in batch.chunks(indices)] == [5]
    seeds, tunings = np.zeros(5, np.int64), np.tile(mpc.tuning.as_array(), (5, 1))
    serial, threaded = (batch.run(indices, tunings, seeds, threads).result["squared_error"] for threads in (1, 2))
    np.testing.assert_array_equal(serial, threaded)
