"""Runs that tell costs, what a scheduler is told in them, and schedulers that improve on both."""

from __future__ import annotations

import itertools
import math
import os

import numpy as np
import pytest

from adaptrack.closed_loop import (
    BOUNDS,
    LOST_BEYOND,
    LOST_COST,
    REVISITED,
    SPIN_BEYOND,
    WORST_STRETCH,
    Course,
    Rescue,
    geometric_mean,
    improve,
)
from adaptrack.errors import InvalidInput
from adaptrack.estimation import Estimating, FrictionWindEstimator, Perception
from adaptrack.evaluate.ladder import CHOICE_SEEDS, EVALUATION_SEEDS, SEARCH_SEEDS
from adaptrack.kernels import loop
from adaptrack.kernels.dynamics import STATES
from adaptrack.learning.landscape import OUTPUTS, SHIFT, FuzzySurface, Level, NetworkSurface
from adaptrack.mpc import MPC, Tuning
from adaptrack.plant import ROAD, DualTrack, SingleTrack
from adaptrack.scenario import load_scenario, random_drive
from adaptrack.scheduling import Constant, Guarded, Learned, SchedulingVariables, Table
from adaptrack.simulate import Batch, rollout, simulate
from adaptrack.vehicle import load_vehicle

CAR = load_vehicle("paper")
START = Tuning(29, 5, 1.0, 4000.0)
HASTY = Tuning(30, 10, 1.0, 10.0)
"""Steers on every bit of noise: loses the car."""


def controller(tuning=START, **options):
    return MPC(CAR, tuning, period=ROAD.period, preview=True, **options)


def lane_changes(n=5, duration=4.0):
    rng = np.random.default_rng(3)
    return [
        load_scenario("lane-change", speed=v, amplitude=y, friction=mu, gust=w, duration=duration)
        for v, y, mu, w in rng.uniform((8.0, -4.0, 0.4, -20.0), (28.0, 4.0, 1.0, 20.0), (n, 4))
    ]


def course(scenarios=None, plant=SingleTrack, **options):
    return Course(plant(CAR), controller(), scenarios or lane_changes(), **options)


def by_friction():
    """A schedule whose tuning gives away what it was told: R = 1000 + 10000 mu, Np = 30 + v_w / 2."""
    plane = Table((np.array([0.0, 2.0]), np.array([-40.0, 40.0])), np.array([[1e3, 1e3], [21e3, 21e3]]))
    wind = Table((np.array([0.0, 2.0]), np.array([-40.0, 40.0])), np.array([[10.0, 50.0], [10.0, 50.0]]))
    domain = [[0.0, 2.0], [-40.0, 40.0]]
    return Learned({"Np": wind, "Nc": 5.0, "Q": 1.0, "R": plane}, ("friction", "wind"), domain)


# -- costs ------------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("plant", [SingleTrack, DualTrack])
def test_the_cost_of_a_run_is_that_of_its_trajectory_and_a_stretch_has_its_part(plant):
    scenarios = lane_changes(3)
    runs = course(scenarios, plant, stretch=13)
    costs, stretches = runs.drive(START, [4, 9]), runs.stretches(START, 9, np.arange(3))
    assert costs.shape == (3, 2)
    assert stretches.shape == (3, math.ceil(80 / 13))
    for i, scenario in enumerate(scenarios):
        for j, seed in enumerate((4, 9)):
            run = rollout(plant(CAR), controller(), scenario, profile="road", seed=seed)
            at_each = run.error**2 + ROAD.move_price * run.command_change**2
            assert costs[i, j] == pytest.approx(at_each.mean(), rel=1e-12)
        parts = [at_each[first : first + 13].sum() for first in range(0, 80, 13)]
        np.testing.assert_allclose(stretches[i], parts, rtol=1e-10)


@pytest.mark.compiled
@pytest.mark.parametrize("stretch", [1, 7, 80, 200])
def test_the_stretches_of_a_run_add_up_to_its_cost(stretch):
    runs = course(stretch=stretch)
    parts = runs.stretches(START, 5, np.arange(len(runs)))
    np.testing.assert_allclose(parts.sum(axis=1) / runs.periods, runs.drive(START, [5])[:, 0], rtol=1e-12)


@pytest.mark.compiled
def test_a_lost_run_is_infinite_in_the_stretch_where_it_is_lost_and_unknown_after():
    scenario = load_scenario("lane-change", speed=10.0, friction=0.6, amplitude=1.0, duration=8.0)
    runs = course([scenario], stretch=10)
    assert runs.drive(HASTY, [2])[0, 0] == math.inf
    run = rollout(SingleTrack(CAR), controller(HASTY), scenario, profile="road", seed=2)
    first = int(np.argmax(np.abs(run.error) > LOST_BEYOND))  # at the end of the period before
    assert first > 20
    (parts,) = runs.stretches(HASTY, 2, np.arange(1))
    where = (first - 1) // 10
    assert np.isfinite(parts[:where]).all()
    assert parts[where] == math.inf
    assert np.isnan(parts[where + 1 :]).all()
    at_each = run.error**2 + ROAD.move_price * run.command_change**2
    np.testing.assert_allclose(parts[:where], at_each[: 10 * where].reshape(-1, 10).sum(axis=1), rtol=1e-9)


@pytest.mark.compiled
def test_a_run_that_spins_is_lost_though_it_stays_on_the_road():
    options = {"speed": 15.0, "friction": 0.3, "amplitude": 4.0, "gust": 0.0, "change_time": 1.0, "duration": 6.0}
    swerve, nervous = load_scenario("lane-change", **options).replace(start_heading=0.2), Tuning(30, 10, 1.0, 1000.0)
    paths = [rollout(SingleTrack(CAR), controller(nervous), swerve, profile="road", seed=seed) for seed in range(16)]
    sideways, away = (
        np.array(each) for each in ([np.abs(p.vy / p.vx) for p in paths], [np.abs(p.error) for p in paths])
    )
    for periods, spinning in ((90, False), (100, True)):
        spun = (sideways[:, : periods + 1] > SPIN_BEYOND).any(axis=1)
        left = (away[:, : periods + 1] > LOST_BEYOND).any(axis=1)
        assert (spun & ~left).any() == spinning
        lost = np.isinf(course([swerve.with_duration(periods * ROAD.period)]).drive(nervous, range(16))[0])
        np.testing.assert_array_equal(lost, spun | left)


@pytest.mark.compiled
def test_a_lost_run_counts_as_costing_what_leaving_the_road_does():
    scenarios = [
        load_scenario("lane-change", speed=10.0, friction=0.6, amplitude=1.0, duration=8.0),
        *lane_changes(1, 8.0),
    ]
    runs = course(scenarios)
    found = runs.drive(np.stack([HASTY.as_array(), START.as_array()]), [2, 3])
    assert np.isinf(found[0, 0])
    assert np.isfinite(found[1]).all()
    expected = np.where(np.isfinite(found), found, LOST_COST).mean(axis=1)
    np.testing.assert_array_equal(runs.costs(np.stack([HASTY.as_array(), START.as_array()]), [2, 3]), expected)
    assert LOST_COST == LOST_BEYOND**2


@pytest.mark.compiled
def test_costs_do_not_depend_on_how_runs_are_batched(monkeypatch, rng):
    scenarios = lane_changes(20, 2.0)
    runs, policy = course(scenarios, stretch=9), by_friction()
    together = runs.drive(policy, [1, 2])
    np.testing.assert_array_equal(
        together, np.concatenate([course([each]).drive(policy, [1, 2]) for each in scenarios])
    )
    order = rng.permutation(20)
    np.testing.assert_array_equal(together[order], runs.drive(policy, [1, 2], order))
    some = np.array([17, 3, 3])
    np.testing.assert_array_equal(together[some], runs.drive(policy, [1, 2], some))
    parts = runs.stretches(policy, 2, np.arange(20))
    np.testing.assert_array_equal(parts[order], runs.stretches(policy, 2, order))
    monkeypatch.setattr(os, "cpu_count", lambda: 5)
    np.testing.assert_array_equal(together, runs.drive(policy, [1, 2]))


@pytest.mark.compiled
def test_a_tuning_costs_the_same_however_it_is_given_and_leaves_nothing_behind():
    runs = course()
    schedule = Constant(START)
    expected = runs.drive(START, [3])
    for policy in (schedule, START.as_array(), [29, 5, 1.0, 4000.0], np.tile(START.as_array(), (len(runs), 1)), START):
        np.testing.assert_array_equal(runs.drive(policy, [3]), expected)


@pytest.mark.compiled
def test_a_courses_runs_are_what_the_scheduler_sees():
    scenario = random_drive(11, 6.0)
    seen = []

    def watch(condition):
        seen.append(condition)
        return START

    simulate(SingleTrack(CAR), controller(scheduler=watch), scenario, profile="road")
    runs = course([scenario])
    assert runs.seen.shape == (1, 120, len(SchedulingVariables._fields))
    known = [name for name in SchedulingVariables._fields if name != "offset"]
    for name in known:
        column = SchedulingVariables._fields.index(name)
        np.testing.assert_allclose(
            runs.seen[0, :, column], [getattr(each, name) for each in seen], rtol=1e-9, atol=1e-9
        )
    assert (runs.seen[..., SchedulingVariables._fields.index("offset")] == 0.0).all()


@pytest.mark.compiled
def test_a_courses_counts_are_those_of_its_schedule():
    runs = course(lane_changes(3, 2.0))
    schedule = Learned({"Np": 30.0, "Nc": 5.0, "Q": 1.0, "R": 4000.0}, ("speed",), [[8.0, 8.001]])
    counts = runs.counts(schedule, 1)
    assert (counts[:, :2] == 40.0).all()  # every step, each of them clipped
    guarded = runs.counts(Guarded(schedule, START), 1)
    assert (guarded[:, -1] == 40.0).all()  # each on the fallback


# -- what a scheduler is told -----------------------------------------------------------------------------------------
FRICTION, WIND = np.linspace(0.3, 0.9, 40), np.linspace(-20.0, 30.0, 40)


def test_a_perception_without_errors_tells_the_truth():
    for told, truth in zip(Perception().told(FRICTION, WIND, 0.05, 0), (FRICTION, WIND), strict=True):
        np.testing.assert_array_equal(told, truth)


@pytest.mark.parametrize("bias", [0.2, -0.2])
def test_a_bias_tells_that_much_more_of_both(bias):
    for told, truth in zip(Perception(bias=bias).told(FRICTION, WIND, 0.05, 0), (FRICTION, WIND), strict=True):
        np.testing.assert_allclose(told, (1.0 + bias) * truth, rtol=1e-14)


@pytest.mark.parametrize(("delay", "periods"), [(0.0, 0), (0.05, 1), (1.0, 20), (5.0, 39)])
def test_a_delay_tells_what_was_true_before_and_at_first_what_was_true_at_the_start(delay, periods):
    for told, truth in zip(Perception(delay=delay).told(FRICTION, WIND, 0.05, 0), (FRICTION, WIND), strict=True):
        np.testing.assert_array_equal(told, np.concatenate((np.full(periods, truth[0]), truth[: 40 - periods])))


def test_what_is_withheld_is_nominal_whatever_else_is_wrong():
    perception = Perception(noise=0.5, bias=0.5, delay=1.0, withheld=True, nominal_friction=0.7)
    friction, wind = perception.told(FRICTION, WIND, 0.05, 0)
    assert (friction == 0.7).all()
    assert (wind == 0.0).all()


def test_noise_is_relative_white_and_independent_for_friction_and_wind():
    friction, wind = np.full(20_000, 0.6), np.full(20_000, -12.0)
    errors = [
        told / truth - 1.0
        for told, truth in zip(Perception(noise=0.1).told(friction, wind, 0.05, 4), (friction, wind), strict=True)
    ]
    for error in errors:
        assert error.mean() == pytest.approx(0.0, abs=0.003)
        assert error.std() == pytest.approx(0.1, rel=0.03)
        assert abs(np.corrcoef(error[1:], error[:-1])[0, 1]) < 0.03
    assert abs(np.corrcoef(*errors)[0, 1]) < 0.03


def test_what_is_told_depends_on_its_seed_alone():
    one, again, other = (Perception(noise=0.1).told(FRICTION, WIND, 0.05, seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert (one[0] != other[0]).all()
    assert (one[1] != other[1]).all()


def test_friction_that_is_told_is_always_positive():
    friction, _ = Perception(noise=3.0).told(np.full(500, 0.5), np.zeros(500), 0.05, 0)
    assert friction.min() == 0.01


@pytest.mark.parametrize(
    "wrong",
    [{"noise": -0.1}, {"delay": -1.0}, {"bias": math.nan}, {"nominal_friction": -0.5}, {"noise": math.inf}],
    ids=str,
)
def test_a_perception_refuses_what_cannot_be(wrong):
    with pytest.raises(InvalidInput, match=next(iter(wrong))):
        Perception(**wrong)


def tunings_of(batch, schedule, seed=0):
    """(periods, 4) tunings that a schedule gave in the first run of a batch, and its whole trace."""
    batch.scheduler = schedule
    _, trace, _, _ = batch.run(np.zeros(1, int), START.as_array()[None], np.array([seed]), 1, traced=True)
    return trace[0, :, STATES + loop.R_NP : STATES + loop.R_R + 1], trace[0]


@pytest.mark.compiled
@pytest.mark.parametrize(
    "perception", [None, Perception(noise=0.1), Perception(bias=0.2, delay=0.5), Perception(withheld=True)], ids=str
)
def test_a_batch_tells_its_scheduler_what_its_perception_says_and_the_car_feels_the_truth(perception):
    scenario = random_drive(3, 4.0)
    batch = Batch(SingleTrack(CAR), controller(), [scenario], "road", told=perception)
    signals = scenario.sample(ROAD.period)
    told = truth = signals.friction.mean(axis=1), signals.wind[:, 1]
    if perception is not None:
        told = perception.told(*truth, ROAD.period, 0)
        np.testing.assert_array_equal(course([scenario], told=perception).seen[0, :, 2:4].T, np.stack(told)[:, :-1])
    given, _ = tunings_of(batch, by_friction())
    np.testing.assert_allclose(given[:, 3], 1e3 + 1e4 * np.clip(told[0][:-1], 0.0, 2.0), rtol=1e-12)
    np.testing.assert_allclose(given[:, 0], 30.0 + told[1][:-1] / 2.0, rtol=0, atol=0.5 + 1e-9)
    plain = Batch(SingleTrack(CAR), controller(), [scenario], "road")
    np.testing.assert_array_equal(batch.samples[:, : loop.TOLD], plain.samples[:, : loop.TOLD])


def test_equal_roads_are_not_told_with_equal_errors():
    told = course([random_drive(3, 2.0)] * 2, told=Perception(noise=0.1)).seen[..., 2:4]
    assert (told[0] != told[1]).all()


@pytest.mark.compiled
@pytest.mark.parametrize("plant", [SingleTrack, DualTrack])
def test_an_estimator_tells_the_scheduler_of_a_batch_the_same_as_from_python(plant):
    """And so the whole run is the same."""
    scenario, estimator = random_drive(6, 8.0), FrictionWindEstimator.of(plant(CAR))
    estimating = Estimating(controller(scheduler=by_friction()), FrictionWindEstimator.of(plant(CAR)))
    slow = simulate(plant(CAR), estimating, scenario, profile="road", seed=5)
    batch = Batch(plant(CAR), controller(), [scenario], "road", told=estimator)
    given, trace = tunings_of(batch, by_friction(), seed=5)
    estimates = np.array([(each.friction, each.wind) for each in estimating.estimates])
    np.testing.assert_allclose(given[:, 3], 1e3 + 1e4 * estimates[:, 0], rtol=1e-9)
    np.testing.assert_allclose(given[:, 0], 30.0 + estimates[:, 1] / 2.0, rtol=0, atol=0.5 + 1e-9)
    for column, name in enumerate(("X", "Y", "psi", "vx", "vy", "yaw_rate")):
        np.testing.assert_allclose(trace[:, column], getattr(slow, name), rtol=1e-9, atol=1e-9, err_msg=name)
    np.testing.assert_allclose(trace[:, STATES + loop.COMMAND], slow.command, rtol=0, atol=1e-9)
    assert np.ptp(estimates, axis=0).min() > 0.05
    true = scenario.sample(ROAD.period).friction.mean(axis=1)
    assert np.abs(estimates[:, 0] - true[:-1]).max() > 0.05, "it is not the truth that was told"


@pytest.mark.compiled
def test_the_runs_of_a_batch_have_estimators_of_their_own():
    scenarios = [random_drive(seed, 3.0) for seed in range(6, 10)]
    told = FrictionWindEstimator.of(SingleTrack(CAR))
    together = course(scenarios, told=told).drive(by_friction(), [1])
    alone = [course([each], told=told).drive(by_friction(), [1])[0] for each in scenarios]
    np.testing.assert_array_equal(together, alone)
    assert (together != course(scenarios).drive(by_friction(), [1])).all()


# -- the landscape ----------------------------------------------------------------------------------------------------
class Bowl(Course):
    """Stretches whose cost is a parabola around a tuning that their condition prefers; nothing is driven."""

    def __init__(self, best, runs=48, stretches=3, noise=0.3, seed=0, price=None):
        rng = np.random.default_rng(seed)
        self.best, self.noise, self.price_of = best, noise, np.ones(runs) if price is None else price
        self.stretch, self.lead, self.stride = 10, 0, 5
        self.seen = np.zeros((runs, 10 * stretches, len(SchedulingVariables._fields)))
        for column, (low, high) in ((0, (5.0, 30.0)), (2, (0.3, 1.0))):
            self.seen[..., column] = np.repeat(rng.uniform(low, high, (runs, stretches)), 10, axis=1)
        self.asked = []

    def __len__(self):
        return len(self.seen)

    def stretches(self, policy, seed, which):
        self.asked.append(seed)
        rows = self.seen[which, :: self.stretch]
        Np, Nc, Q, R = np.moveaxis(policy.batch(rows.reshape(-1, rows.shape[-1])).reshape(*rows.shape[:2], 4), -1, 0)
        away = (np.stack([Np, Nc, np.log10(R / Q)], axis=-1) - self.best(rows)) / SHIFT
        luck = np.exp(self.noise * np.random.default_rng(seed).normal(size=(len(self), rows.shape[1])))[which]
        return self.price_of[which, None] * luck * (0.3 + (away**2).sum(axis=-1))

    def drive(self, policy, seeds, which=None):
        which = np.arange(len(self)) if which is None else which
        return np.stack([self.stretches(policy, seed, which).mean(axis=1) for seed in seeds], axis=1)


def same_everywhere(rows):
    return np.broadcast_to([34.0, 8.0, 3.1], (*rows.shape[:-1], 3))


def along_speed_and_friction(rows):
    """Np from 22 to 42 with speed, Nc from 5 to 12 with friction, log10 R/Q from 2.5 to 4.5 against both, curved."""
    speed, friction = (rows[..., 0] - 5.0) / 25.0, (rows[..., 2] - 0.3) / 0.7
    return np.stack([22.0 + 20.0 * speed**2, 5.0 + 7.0 * friction, 4.5 - speed - friction * speed], axis=-1)


INPUTS, DOMAIN = ("speed", "friction"), np.array([[5.0, 30.0], [0.3, 1.0]])
BEGIN = dict(zip(OUTPUTS, ((29.0, 10.0), (6.0, 5.0), (3.6, 0.5)), strict=True))


def beginning(kind):
    rows = np.random.default_rng(0).uniform(*DOMAIN.T, (300, 2))
    return {
        slot: {
            "constant": lambda value, _: Level(value),
            "network": lambda value, span: NetworkSurface.start(DOMAIN, value, span, seed=1),
            "fuzzy": lambda value, _: FuzzySurface.start(rows, value, rules=8, seed=1),
        }[kind](value, span)
        for slot, (value, span) in BEGIN.items()
    }


def constant_schedule(by):
    """START, shifted."""
    values = (float(START.Np), float(START.Nc), math.log10(START.R))
    functions = {slot: value + by[i] for i, (slot, value) in enumerate(zip(OUTPUTS, values, strict=True))}
    return Learned(functions, INPUTS, DOMAIN, BOUNDS)


def test_the_landscape_says_for_every_stretch_where_its_inputs_want_to_go():
    bowl = Bowl(along_speed_and_friction, noise=0.0)
    which = np.array([3, 7, 8])
    rows, moves, weights = bowl.landscape(constant_schedule, 1, which)
    assert rows.shape == (3 * 3 * 2, len(SchedulingVariables._fields))
    assert moves.shape == weights.shape == (3 * 3 * 2, 3)
    wanted = along_speed_and_friction(rows) - [START.Np, START.Nc, math.log10(START.R)]
    exact = np.array([True, False, True])  # Nc is rounded, its shift is not whole
    near = (np.abs(wanted) <= 2.0 * SHIFT) & exact
    assert near.sum() > 5
    np.testing.assert_allclose(moves[near], wanted[near], rtol=0, atol=1e-9)
    assert (np.sign(moves) == np.sign(wanted))[:, exact].all()
    per_stretch = weights.reshape(3, 3, 2, 3)  # stretches, runs, looks
    np.testing.assert_array_equal(per_stretch[:, :, 0], per_stretch[:, :, 1])


def test_every_run_counts_alike_however_much_it_costs():
    price = 10.0 ** np.random.default_rng(5).uniform(-3.0, 3.0, 48)
    plain, scaled = (
        Bowl(along_speed_and_friction, price=p).landscape(constant_schedule, 1, np.arange(48)) for p in (None, price)
    )
    for one, other in zip(plain, scaled, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9)


def test_a_stretch_is_put_down_to_what_was_seen_in_it_and_shortly_before():
    bowl = Bowl(same_everywhere, runs=2, stretches=3)
    bowl.seen[..., 1] = np.arange(30)  # the instant
    bowl.lead = 10
    rows, _, weights = bowl.landscape(constant_schedule, 1, np.array([1]))
    assert rows[:, 1].tolist() == [0, 5, *(0, 5, 10, 15), *(10, 15, 20, 25)]
    bowl.lead = 0
    alone = bowl.landscape(constant_schedule, 1, np.array([1]))[2]
    for columns, others in (((0, 2), (0, 2)), ((2, 6), (2, 4)), ((6, 10), (4, 6))):
        np.testing.assert_allclose(weights[slice(*columns)].sum(axis=0), alone[slice(*others)].sum(axis=0))


class Lossy(Bowl):
    """Every run is lost in its second stretch when Np is above 30."""

    def stretches(self, policy, seed, which):
        cost = super().stretches(policy, seed, which)
        if policy(SchedulingVariables(20.0, 0.0, 0.8, 0.0))[0] > 30.0:
            cost[:, 1], cost[:, 2:] = np.inf, np.nan
        return cost


def test_where_a_shift_loses_the_car_the_output_moves_away_and_what_follows_says_nothing():
    lossy = Lossy(lambda rows: same_everywhere(rows) * [0, 1, 1] + [29, 0, 0])
    _, moves, weights = lossy.landscape(constant_schedule, 1, np.arange(48))
    stretch = np.repeat(np.arange(3), 48 * 2)
    assert (moves[stretch == 0][:, 0] == 0.0).all()
    np.testing.assert_allclose(moves[stretch == 1][:, 0], -0.5 * SHIFT[0], rtol=0.02)
    assert (weights[stretch == 2][:, 0] == 0.0).all()
    assert (weights[stretch == 2][:, 2] > 0.0).all(), "the other outputs' shifts lose nothing"
    worst = WORST_STRETCH / SHIFT[0] ** 2  # as if it had cost that much, and nothing without the shift
    assert weights[:, 0].max() <= worst / 2 / 48  # two looks in each stretch of 48 runs


class Narrow(Bowl):
    """All the same, but lost in the third stretch unless R/Q is at least that of `edge`, (runs,) in decades."""

    def __init__(self, edge):
        super().__init__(same_everywhere, runs=len(edge), stretches=5)
        self.edge, self.periods = np.asarray(edge), 50

    def stretches(self, policy, seed, which):
        cost = np.ones((len(which), 5))
        *_, Q, R = policy(SchedulingVariables(20.0, 0.0, 0.8, 0.0))
        lost = math.log10(R / Q) < self.edge[which] - 1e-9
        cost[lost, 2], cost[lost, 3:] = np.inf, np.nan
        return cost


def towards(goal, start=3.6):
    """From START's R/Q (in decades) and horizons to another R/Q."""
    way = np.array([0.0, 0.0, goal - start])

    def schedule(share):
        return constant_schedule(share * way + np.array([0.0, 0.0, start - math.log10(START.R)]))

    return Rescue(schedule, lambda rows: np.tile(way, (len(rows), 1)))


def test_what_saves_a_lost_run_is_learned_where_it_was_lost_and_before():
    # towards 5.6 by a quarter (4.1), a half (4.6), all the way; the last run cannot be saved, the first is not lost
    runs, start = Narrow([3.0, 4.0, 4.5, 5.0, 6.0]), 3.6
    base = towards(5.6).schedule
    _, moves, weights = runs.landscape(lambda by: constant_schedule(by), 1, np.arange(5), towards(5.6))
    plain_moves, plain_weights = runs.landscape(lambda by: constant_schedule(by), 1, np.arange(5))[1:]
    assert base(0.0)(SchedulingVariables(20.0, 0.0, 0.8, 0.0))[3] == pytest.approx(10**start)
    moves, plain_moves, weights, plain_weights = (
        each.reshape(5, 5, 2, 3) for each in (moves, plain_moves, weights, plain_weights)
    )  # stretch, run, look, output
    for run, share in ((1, 0.25), (2, 0.5), (3, 1.0)):
        np.testing.assert_allclose(moves[:3, run, :, 2], share * 2.0)
        assert (moves[:3, run, :, :2] == 0.0).all()
        assert (weights[:3, run] > plain_weights[:3, run]).all()
        np.testing.assert_array_equal(moves[3:, run], plain_moves[3:, run])
    for run in (0, 4):
        np.testing.assert_array_equal(moves[:, run], plain_moves[:, run])
        np.testing.assert_array_equal(weights[:, run], plain_weights[:, run])
    # as much as a parabola weighs that costs what a lost stretch does, that far from where it was lost
    np.testing.assert_allclose(weights[2, 2, :, 2].sum() * 5, 2.0 * WORST_STRETCH / 1.0**2)


@pytest.mark.compiled
@pytest.mark.parametrize("safe", [None, Tuning(34, 8, 1.0, 10**4.6)])
def test_beyond_a_cliff_only_what_saves_the_runs_shows_the_way(safe):
    # Three shifts away from where every run is lost: no shift says anything of the loss.
    runs = Narrow(np.full(24, 4.2))
    made = improve(beginning("constant"), INPUTS, DOMAIN, [(runs, 24)], [runs], rounds=12, safe=safe)
    lost = ~np.isfinite(runs.drive(made.schedule, [5]))
    assert lost.all() if safe is None else not lost.any()


# -- improving --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["constant", "network", "fuzzy"])
def test_improving_finds_the_known_optimum(kind):
    best = same_everywhere if kind == "constant" else along_speed_and_friction
    made = improve(beginning(kind), INPUTS, DOMAIN, [(Bowl(best), 32)], [Bowl(best, seed=1)], rounds=40)
    rows = Bowl(best, seed=2).seen.reshape(-1, len(SchedulingVariables._fields))
    Np, Nc, Q, R = made.schedule.batch(rows).T
    off = np.abs(np.column_stack([Np, Nc, np.log10(R / Q)]) - best(rows))
    assert (np.sqrt((off**2).mean(axis=0)) < [0.5, 0.5, 0.03]).all()  # rounding alone leaves 0.29 of a horizon
    assert made.history[-1]["score"] < made.history[0]["score"]


@pytest.mark.compiled
def test_what_no_input_tells_apart_gets_the_compromise():
    """One tuning for all speeds and frictions: away from it, each output's cost rises on either side."""
    bowl = Bowl(along_speed_and_friction, noise=0.0)
    made = improve(beginning("constant"), INPUTS, DOMAIN, [(bowl, 48)], [bowl], rounds=30)

    def cost(by):
        functions = {slot: made.surfaces[slot].value + shift for slot, shift in zip(OUTPUTS, by, strict=True)}
        return bowl.costs(Learned(functions, INPUTS, DOMAIN, BOUNDS), [0]).mean()

    for by in 2.0 * np.diag(SHIFT):
        assert cost(np.zeros(3)) < min(cost(by), cost(-by))


class Judge:
    """Scores that were written down beforehand; remembers what it was asked about."""

    def __init__(self, *scores):
        self.scores, self.asked, self.seeds = list(scores), [], []

    def costs(self, policy, seeds):
        self.asked.append(policy)
        self.seeds += seeds
        return np.array(self.scores[len(self.asked) - 1], dtype=float)


@pytest.mark.compiled
def test_the_best_round_is_kept_with_its_surfaces():
    start = ([20, 20], [20])
    first, second = (
        Judge(start[0], [3, 3], [1, 4], [2, 8], [LOST_COST, 2]),
        Judge(start[1], [5], [2], [1], [LOST_COST]),
    )
    made = improve(
        beginning("constant"), INPUTS, DOMAIN, [(Bowl(same_everywhere), 8)], [first, second], rounds=11, check=3
    )
    assert [row["round"] for row in made.history] == [0, 3, 6, 9, 11]
    logs = [
        np.log(20), (np.log(9) / 2 + np.log(5)) / 2, (np.log(4) / 2 + np.log(2)) / 2, np.log(16) / 4,
        np.log(50 * 25 * 25) / 4,
    ]  # fmt: skip
    np.testing.assert_allclose([row["score"] for row in made.history], logs)
    assert [row["lost"] for row in made.history] == [0.0, 0.0, 0.0, 0.0, 2.0]
    assert made.schedule is first.asked[int(np.argmin(logs))]
    for slot, surface in made.surfaces.items():
        assert made.schedule.tuning["R" if slot == "log10_ratio" else slot].function == surface.function()


@pytest.mark.compiled
def test_learned_tunings_stay_within_their_bounds_and_the_wish_to_leave_them_does_not_grow():
    def beyond(rows):
        return np.broadcast_to([90.0, -5.0, 9.0], (*rows.shape[:-1], 3))

    made = improve(beginning("constant"), INPUTS, DOMAIN, [(Bowl(beyond), 8)], [Bowl(beyond)], rounds=30)
    assert made.schedule(SchedulingVariables(10.0, 0.0, 0.5, 0.0)) == pytest.approx((60.0, 1.0, 1.0, 1e6))
    assert [made.surfaces[slot].value for slot in OUTPUTS] == pytest.approx([60.0, 1.0, 6.0])


class Watched(Level):
    """A level that remembers the inputs that it was fitted at."""

    fitted: list = []  # noqa: RUF012

    def fit(self, x, target, weight, effort=1.0):
        self.fitted.append(x)
        return Watched(super().fit(x, target, weight, effort).value)


@pytest.mark.compiled
def test_it_learns_at_the_inputs_that_a_scheduler_would_see():
    """In their order, and clipped to the domain."""
    inputs, domain, bowl = ("friction", "speed"), np.array([[0.5, 0.8], [10.0, 20.0]]), Bowl(same_everywhere)
    Watched.fitted = []
    improve({slot: Watched(30.0) for slot in OUTPUTS}, inputs, domain, [(bowl, 48)], [bowl], rounds=1)
    seen = bowl.seen[:, ::5].reshape(-1, len(SchedulingVariables._fields))[:, [2, 0]]
    for fitted in Watched.fitted:
        np.testing.assert_array_equal(np.unique(fitted, axis=0), np.unique(np.clip(seen, *domain.T), axis=0))


class Fatal(Bowl):
    """Run 5 is always lost."""

    def stretches(self, policy, seed, which):
        cost = super().stretches(policy, seed, which)
        cost[which == 5, 1], cost[which == 5, 2:] = np.inf, np.nan
        self.driven.append(which.tolist())
        return cost


@pytest.mark.compiled
def test_a_run_that_was_ever_lost_is_driven_in_every_round():
    fatal = Fatal(same_everywhere)
    fatal.driven = []
    improve(beginning("constant"), INPUTS, DOMAIN, [(fatal, REVISITED)], [Judge([1.0], [1.0])], rounds=4)
    few = [which for which in fatal.driven if len(which) == REVISITED]
    assert all(5 in which for which in few)
    assert len(set.union(*map(set, few))) > REVISITED, "the others are drawn anew"


@pytest.mark.compiled
def test_learning_depends_on_its_seed_alone():
    one, again, other = (
        improve(
            beginning("fuzzy"), INPUTS, DOMAIN, [(Bowl(same_everywhere), 16)], [Bowl(same_everywhere)], rounds=3, seed=n
        )
        for n in (1, 1, 2)
    )
    rows = Bowl(same_everywhere).seen[:, 0]
    np.testing.assert_array_equal(one.schedule.batch(rows), again.schedule.batch(rows))
    assert one.history == again.history
    assert one.history != other.history


@pytest.mark.compiled
@pytest.mark.parametrize("seed", [0, 1, 7])
def test_noise_is_new_in_every_round_and_never_that_of_a_search_or_an_evaluation(seed):
    bowl, judge = Bowl(same_everywhere), Judge(*[[1.0]] * 10)
    improve(beginning("constant"), INPUTS, DOMAIN, [(bowl, 4)], [judge], rounds=10, seed=seed, check=5)
    rounds = [noise for noise, _ in itertools.groupby(bowl.asked)]
    assert len(rounds) == len(set(rounds)) == 10, "one for each, under which all shifts are compared"
    assert len(judge.seeds) == 3, "the start and two checks"
    assert not set(rounds) & set(judge.seeds)
    assert not {*rounds, *judge.seeds} & {*EVALUATION_SEEDS, *SEARCH_SEEDS, *CHOICE_SEEDS}


def test_progress_is_told_before_every_round():
    heard = []
    improve(
        beginning("constant"), INPUTS, DOMAIN, [(Bowl(same_everywhere, runs=4), 2)], [Judge([1.0], [1.0])], rounds=2,
        progress=lambda *at: heard.append(at),
    )  # fmt: skip
    assert heard == [(0, 2), (1, 2)]


def test_a_missing_surface_and_an_input_that_depends_on_the_driving_are_refused():
    given = beginning("constant")
    with pytest.raises(InvalidInput, match="offset"):
        improve(given, ("speed", "offset"), DOMAIN, [], [])
    del given["Nc"]
    with pytest.raises(InvalidInput, match="Np, Nc, log10_ratio"):
        improve(given, INPUTS, DOMAIN, [], [])


@pytest.mark.compiled
def test_on_real_runs_learning_lowers_the_cost_of_runs_that_it_never_saw():
    slow = {slot: Level(value) for slot, value in zip(OUTPUTS, (45.0, 3.0, 4.6), strict=True)}
    train, held_out = course(lane_changes(24, 4.0)[:16]), course(lane_changes(24, 4.0)[16:])
    made = improve(slow, INPUTS, DOMAIN, [(train, 16)], [held_out], rounds=8, check=2)
    before = held_out.costs(Tuning(45, 3, 1.0, 10.0**4.6), [12345])
    assert geometric_mean(held_out.costs(made.schedule, [12345])) < 0.7 * geometric_mean(before)


def test_the_geometric_mean_is_that_of_logarithms():
    assert geometric_mean([1.0, 10.0, 100.0]) == pytest.approx(10.0)
