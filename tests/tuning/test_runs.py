"""Sets of runs: what a policy costs on them, what is known in them, and who may drive them."""

from __future__ import annotations

import math
import os

import numpy as np
import pytest

from adaptrack import Controller
from adaptrack.base.errors import InvalidInput
from adaptrack.cars.plant import DualTrack, SingleTrack
from adaptrack.control.controllers import Tuning
from adaptrack.control.estimation import FrictionWindEstimator, Perception
from adaptrack.control.scheduling import Guarded, Learned, SchedulingVariables, Table
from adaptrack.core.controllers.mpc import MPC_ANSWER
from adaptrack.core.plants.contract import PLANT_STATE
from adaptrack.core.simulation import world as loop
from adaptrack.drive.batch import Batch
from adaptrack.drive.failure import FailureLimits
from adaptrack.drive.simulate import rollout, simulate
from adaptrack.scenario import load_scenario, random_drive
from adaptrack.scenario.profile import load_profile
from adaptrack.tuning.runs import operating_point_runs, random_drive_runs
from small_runs import CAR, HASTY, START, controller, lane_changes, run_set

DISTANCE = FailureLimits().distance
FAILED_COST = DISTANCE**2


def by_friction():
    """A schedule whose tuning gives away what it knows: R = 1000 + 10000 mu, Np = 30 + v_w / 2."""
    plane = Table((np.array([0.0, 2.0]), np.array([-40.0, 40.0])), np.array([[1e3, 1e3], [21e3, 21e3]]))
    wind = Table((np.array([0.0, 2.0]), np.array([-40.0, 40.0])), np.array([[10.0, 50.0], [10.0, 50.0]]))
    domain = [[0.0, 2.0], [-40.0, 40.0]]
    return Learned({"Np": wind, "Nc": 5.0, "Q": 1.0, "R": plane}, ("friction", "wind"), domain)


# -- costs ------------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("plant", [SingleTrack, DualTrack])
def test_the_cost_of_a_run_is_that_of_its_trajectory_and_a_segment_has_its_part(plant):
    scenarios = lane_changes(3)
    runs = run_set(scenarios, plant, segment=13)
    costs, segments = runs.drive(START, [4, 9]), runs.segments(START, 9, np.arange(3))
    assert costs.shape == (3, 2)
    assert segments.shape == (3, math.ceil(80 / 13))
    for i, scenario in enumerate(scenarios):
        for j, seed in enumerate((4, 9)):
            run = rollout(plant(CAR), controller(), scenario, profile="road", seed=seed)
            at_each = run.error**2 + load_profile("road").move_weight * run.command_change**2
            assert costs[i, j] == pytest.approx(at_each.mean(), rel=1e-12)
        parts = [at_each[first : first + 13].sum() for first in range(0, 80, 13)]
        np.testing.assert_allclose(segments[i], parts, rtol=1e-10)


@pytest.mark.compiled
def test_the_segments_of_a_run_add_up_to_its_cost():
    for segment in (1, 7, 80, 200):
        runs = run_set(segment=segment)
        parts = runs.segments(START, 5, np.arange(len(runs)))
        np.testing.assert_allclose(parts.sum(axis=1) / runs.periods, runs.drive(START, [5])[:, 0], rtol=1e-12)


@pytest.mark.compiled
def test_a_failed_run_is_infinite_in_the_segment_where_it_fails_and_unknown_after():
    scenario = load_scenario("lane-change", speed=10.0, friction=0.6, amplitude=1.0, duration=8.0)
    runs = run_set([scenario], segment=10)
    assert runs.drive(HASTY, [2])[0, 0] == math.inf
    run = rollout(SingleTrack(CAR), controller(HASTY), scenario, profile="road", seed=2)
    first = int(np.argmax(np.abs(run.error) > DISTANCE))  # at the end of the period before
    assert first > 20
    (parts,) = runs.segments(HASTY, 2, np.arange(1))
    where = (first - 1) // 10
    assert np.isfinite(parts[:where]).all()
    assert parts[where] == math.inf
    assert np.isnan(parts[where + 1 :]).all()
    at_each = run.error**2 + load_profile("road").move_weight * run.command_change**2
    np.testing.assert_allclose(parts[:where], at_each[: 10 * where].reshape(-1, 10).sum(axis=1), rtol=1e-9)


@pytest.mark.compiled
def test_a_run_that_spins_has_failed_though_it_stays_on_the_road():
    options = {"speed": 15.0, "friction": 0.3, "amplitude": 4.0, "gust": 0.0, "change_time": 1.0, "duration": 6.0}
    swerve, nervous = load_scenario("lane-change", **options).replace(start_heading=0.2), Tuning(30, 10, 1.0, 1000.0)
    paths = [rollout(SingleTrack(CAR), controller(nervous), swerve, profile="road", seed=seed) for seed in range(16)]
    sideways, errors = (
        np.array(values) for values in ([np.abs(p.vy / p.vx) for p in paths], [np.abs(p.error) for p in paths])
    )
    for periods, spinning in ((90, False), (100, True)):
        spun = (sideways[:, : periods + 1] > math.tan(FailureLimits().sideslip)).any(axis=1)
        left = (errors[:, : periods + 1] > DISTANCE).any(axis=1)
        assert (spun & ~left).any() == spinning
        shortened = run_set([swerve.with_duration(periods * load_profile("road").period)])
        failed = np.isinf(shortened.drive(nervous, range(16))[0])
        np.testing.assert_array_equal(failed, spun | left)


@pytest.mark.compiled
def test_a_failed_run_counts_as_costing_what_leaving_the_road_does():
    hasty = load_scenario("lane-change", speed=10.0, friction=0.6, amplitude=1.0, duration=8.0)
    runs = run_set([hasty, *lane_changes(1, 8.0)])
    costs = runs.drive(np.stack([HASTY.as_array(), START.as_array()]), [2, 3])
    assert np.isinf(costs[0, 0])
    assert np.isfinite(costs[1]).all()
    expected = np.where(np.isfinite(costs), costs, FAILED_COST).mean(axis=1)
    np.testing.assert_array_equal(runs.costs(np.stack([HASTY.as_array(), START.as_array()]), [2, 3]), expected)
    assert runs.failed_cost == FAILED_COST == DISTANCE**2


@pytest.mark.compiled
def test_costs_do_not_depend_on_how_runs_are_batched(monkeypatch, rng):
    scenarios = lane_changes(20, 2.0)
    runs, policy = run_set(scenarios, segment=9), by_friction()
    together = runs.drive(policy, [1, 2])
    np.testing.assert_array_equal(
        together, np.concatenate([run_set([scenario]).drive(policy, [1, 2]) for scenario in scenarios])
    )
    order = rng.permutation(20)
    np.testing.assert_array_equal(together[order], runs.drive(policy, [1, 2], order))
    some = np.array([17, 3, 3])
    np.testing.assert_array_equal(together[some], runs.drive(policy, [1, 2], some))
    parts = runs.segments(policy, 2, np.arange(20))
    np.testing.assert_array_equal(parts[order], runs.segments(policy, 2, order))
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    np.testing.assert_array_equal(together, runs.drive(policy, [1, 2]))


@pytest.mark.compiled
def test_the_scheduling_variables_of_a_run_set_are_what_the_scheduler_sees():
    scenario = random_drive(11, 6.0)
    records = []

    def watch(variables):
        records.append(variables)
        return START

    simulate(SingleTrack(CAR), controller(scheduler=watch), scenario, profile="road")
    runs = run_set([scenario])
    assert runs.variables.shape == (1, 120, len(SchedulingVariables._fields))
    estimate = [name for name in SchedulingVariables._fields if name != "offset"]
    for name in estimate:
        column = SchedulingVariables._fields.index(name)
        np.testing.assert_allclose(
            runs.variables[0, :, column], [getattr(record, name) for record in records], rtol=1e-9, atol=1e-9
        )
    assert (runs.variables[..., SchedulingVariables._fields.index("offset")] == 0.0).all()


@pytest.mark.compiled
def test_the_counts_of_a_run_set_are_those_of_its_schedule():
    runs = run_set(lane_changes(3, 2.0))
    schedule = Learned({"Np": 30.0, "Nc": 5.0, "Q": 1.0, "R": 4000.0}, ("speed",), [[8.0, 8.001]])
    counts = runs.counts(schedule, 1)
    assert (counts["steps"] == 40.0).all()
    assert (counts["clipped"] == 40.0).all()
    guarded = runs.counts(Guarded(schedule, START), 1)
    assert (guarded["fallback"] == 40.0).all()


# -- what is known of friction and wind --------------------------------------------------------------------------------
FRICTION, WIND = np.linspace(0.3, 0.9, 40), np.linspace(-20.0, 30.0, 40)


def test_a_delay_tells_what_was_true_before_and_at_first_what_was_true_at_the_start():
    for delay, periods in ((0.0, 0), (0.05, 1), (1.0, 20), (5.0, 39)):
        for estimate, truth in zip(
            Perception(delay=delay).perceive(FRICTION, WIND, 0.05, 0), (FRICTION, WIND), strict=True
        ):
            np.testing.assert_array_equal(estimate, np.concatenate((np.full(periods, truth[0]), truth[: 40 - periods])))


def test_what_is_withheld_is_nominal_whatever_else_is_wrong():
    perception = Perception(noise=0.5, bias=0.5, delay=1.0, withheld=True, nominal_friction=0.7)
    friction, wind = perception.perceive(FRICTION, WIND, 0.05, 0)
    assert (friction == 0.7).all()
    assert (wind == 0.0).all()


def test_noise_is_relative_white_and_independent_for_friction_and_wind():
    friction, wind = np.full(20_000, 0.6), np.full(20_000, -12.0)
    errors = [
        estimate / truth - 1.0
        for estimate, truth in zip(
            Perception(noise=0.1).perceive(friction, wind, 0.05, 4), (friction, wind), strict=True
        )
    ]
    for error in errors:
        assert error.mean() == pytest.approx(0.0, abs=0.003)
        assert error.std() == pytest.approx(0.1, rel=0.03)
        assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.03
    assert abs(np.corrcoef(*errors)[0, 1]) < 0.03


def test_a_perception_refuses_what_cannot_be():
    for name, value in {"noise": -0.1, "delay": -1.0, "bias": math.nan, "nominal_friction": -0.5}.items():
        with pytest.raises(InvalidInput, match=name):
            Perception(**{name: value})


def tunings_of(batch, schedule, seed=0):
    """(periods, 4) tunings that a schedule gave in the first run of a batch; its states and answers."""
    trace = batch.run(
        np.zeros(1, int), START.as_array()[None], np.array([seed]), 1, traced=True, scheduler=schedule
    ).trace
    return trace.answer[0, :, MPC_ANSWER.Np : MPC_ANSWER.R + 1], trace.state[0], trace.answer[0]


@pytest.mark.compiled
@pytest.mark.parametrize(
    "perception", [None, Perception(noise=0.1), Perception(bias=0.2, delay=0.5), Perception(withheld=True)], ids=str
)
def test_a_batch_tells_its_scheduler_what_its_perception_says_and_the_car_feels_the_truth(perception):
    scenario = random_drive(3, 4.0)
    batch = Batch(SingleTrack(CAR), controller(), [scenario], "road", perception=perception)
    signals = scenario.sample(load_profile("road").period)
    estimate = truth = signals.friction.mean(axis=1), signals.wind[:, 1]
    if perception is not None:
        estimate = perception.perceive(*truth, load_profile("road").period, 0)
        np.testing.assert_array_equal(
            run_set([scenario], perception=perception).variables[0, :, 2:4].T, np.stack(estimate)[:, :-1]
        )
    tunings, _, _ = tunings_of(batch, by_friction())
    np.testing.assert_allclose(tunings[:, 3], 1e3 + 1e4 * np.clip(estimate[0][:-1], 0.0, 2.0), rtol=1e-12)
    np.testing.assert_allclose(tunings[:, 0], 30.0 + estimate[1][:-1] / 2.0, rtol=0, atol=0.5 + 1e-9)
    plain = Batch(SingleTrack(CAR), controller(), [scenario], "road")
    felt = slice(loop.SIGNAL.known_friction)
    np.testing.assert_array_equal(batch.samples[:, felt], plain.samples[:, felt])


@pytest.mark.compiled
@pytest.mark.parametrize("plant", [SingleTrack, DualTrack])
def test_an_estimator_tells_the_scheduler_of_a_batch_the_same_as_from_python(plant):
    """And so the whole run is the same."""
    scenario, estimator = random_drive(6, 8.0), FrictionWindEstimator.of(plant(CAR))
    schedule, estimates = by_friction(), []

    def watched(variables):
        estimates.append((variables.friction, variables.wind))
        return schedule(variables)

    slow = simulate(
        plant(CAR), controller(scheduler=watched), scenario, profile="road", seed=5,
        perception=FrictionWindEstimator.of(plant(CAR)),
    )  # fmt: skip
    batch = Batch(plant(CAR), controller(), [scenario], "road", perception=estimator)
    tunings, states, answers = tunings_of(batch, schedule, seed=5)
    estimates = np.array(estimates)
    np.testing.assert_allclose(tunings[:, 3], 1e3 + 1e4 * estimates[:, 0], rtol=1e-9)
    np.testing.assert_allclose(tunings[:, 0], 30.0 + estimates[:, 1] / 2.0, rtol=0, atol=0.5 + 1e-9)
    for name in ("x", "y", "yaw", "vx", "vy", "yaw_rate"):
        recorded = getattr(slow, {"x": "X", "y": "Y", "yaw": "psi"}.get(name, name))
        np.testing.assert_allclose(states[:, getattr(PLANT_STATE, name)], recorded, rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(answers[:, MPC_ANSWER.command], slow.command, rtol=0, atol=1e-9)
    assert np.ptp(estimates, axis=0).min() > 0.05
    true = scenario.sample(load_profile("road").period).friction.mean(axis=1)
    assert np.abs(estimates[:, 0] - true[:-1]).max() > 0.05, "it is not the truth that the schedule knows"


# -- who may drive ----------------------------------------------------------------------------------------------------
class Proportional(Controller):
    """A controller in plain Python: steers against the error, at most 0.1 rad."""

    name, period = "proportional", load_profile("road").period

    def __init__(self, gain=0.02):
        self.gain, self.mpc = gain, controller()

    def reset(self):
        self.mpc.reset()

    def step(self, state, speed, reference, variables=None):
        angle = float(np.clip(self.gain * (reference[0] - state[3]), -0.1, 0.1))
        return self.mpc.step(state, speed, reference)._replace(angle=angle)

    def describe(self):
        return {"gain": self.gain}


def test_a_controller_in_python_is_driven_run_by_run():
    scenarios = [scenario.with_duration(1.0) for scenario in lane_changes(2)]
    costs = run_set(scenarios).drive(Proportional(), [3, 4])
    assert costs.shape == (2, 2)
    for i, scenario in enumerate(scenarios):
        run = simulate(SingleTrack(CAR), Proportional(), scenario, profile="road", seed=4)
        expected = (run.error**2).mean() + load_profile("road").move_weight * (run.command_change**2).mean()
        assert costs[i, 1] == pytest.approx(expected, rel=1e-12)
    assert (costs != run_set(scenarios).drive(Proportional(0.1), [3, 4])).any()


@pytest.mark.compiled
def test_an_mpc_costs_the_same_compiled_and_in_python_and_may_be_another_than_that_of_the_runs():
    runs, other = run_set(lane_changes(2)), controller(Tuning(40, 6, 1.0, 9000.0))
    np.testing.assert_array_equal(runs.drive(other, [1]), runs.drive(other.tuning, [1]))
    in_python = controller(other.tuning, scheduler=lambda variables: other.tuning)
    np.testing.assert_allclose(runs.drive(in_python, [1]), runs.drive(other, [1]), rtol=1e-9)


class Curious(Proportional):
    """Writes down the friction and the wind that it knows."""

    def __init__(self):
        super().__init__()
        self.known = []

    def step(self, state, speed, reference, variables=None):
        self.known.append((variables.friction, variables.wind))
        return super().step(state, speed, reference)


def test_a_controller_in_python_knows_what_the_perception_says_in_every_run_as_compiled_ones_do():
    runs = run_set(
        [scenario.with_duration(0.5) for scenario in lane_changes(3)], perception=Perception(noise=0.1, seed=4)
    )
    watching = Curious()
    runs.drive(watching, [1])
    np.testing.assert_array_equal(np.reshape(watching.known, (3, 10, 2)), runs.variables[..., 2:4])


# -- makers -----------------------------------------------------------------------------------------------------------
def test_operating_points_are_lane_changes_in_a_gust_and_drives_have_segments_of_two_seconds():
    points = operating_point_runs(SingleTrack(CAR), controller(), [[10.0, 2.0, 0.8, -0.0], [20.0, -2.0, 0.9, 5.0]])
    assert (len(points), points.periods, points.segment, points.stride) == (2, 160, 160, 8)
    drives = random_drive_runs(SingleTrack(CAR), controller(), range(7, 10), 6.0)
    assert (len(drives), drives.periods, drives.segment, drives.before) == (3, 120, 40, 40)
    assert drives.scenarios[1].name == random_drive(8, 6.0).name


@pytest.mark.parametrize("points", [[], [[1.0, 2.0, 3.0]], [10.0, 2.0, 0.8, 0.0]])
def test_rows_that_are_no_operating_points_are_refused(points):
    with pytest.raises(InvalidInput, match="operating points"):
        operating_point_runs(SingleTrack(CAR), controller(), points)
