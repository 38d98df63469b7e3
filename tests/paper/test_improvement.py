"""The landscape of the closed loop's cost, and schedules that improve on it."""

from __future__ import annotations

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import adaptrack as at
from adaptrack.base.statistics import geometric_mean
from adaptrack.control.scheduling import Number
from adaptrack.paper import improvement
from adaptrack.paper.improvement import (
    LEARNED_OUTPUTS,
    MAX_SEGMENT_COST,
    MIN_CURVATURE,
    OUTPUT_SHIFT,
    REVISITED,
    TUNING_BOUNDS,
    Learnable,
    Rescue,
    explore_landscape,
    improve,
    preferred_moves,
)
from adaptrack.paper.surfaces import FuzzySurface, NetworkSurface
from adaptrack.tuning.runs import RunSet
from small_models import Level
from small_runs import START, lane_changes, run_set

FAILED_COST = RunSet.failure.distance**2


def three_costs(cost):
    """Costs without a shift, and with each output shifted up and down, of segments that cost cost(shifts) (n,)."""
    base = cost(np.zeros(3))
    up, down = (np.stack([cost(sign * by) for by in np.diag(OUTPUT_SHIFT)], axis=1) for sign in (1.0, -1.0))
    return base, up, down


# -- moves ------------------------------------------------------------------------------------------------------------
def test_the_minimum_of_a_parabola_is_found_exactly(rng):
    best = rng.uniform(-2.0, 2.0, (50, 3)) * OUTPUT_SHIFT
    bend = MIN_CURVATURE * rng.uniform(2.0, 50.0, (50, 3))  # the second derivative
    moves, weights = preferred_moves(
        *three_costs(lambda by: 0.4 + 0.5 * (bend * (by - best) ** 2).sum(axis=1)), np.ones(50)
    )
    np.testing.assert_allclose(moves, best, rtol=0, atol=1e-11)
    np.testing.assert_allclose(weights, bend, rtol=1e-9)


def test_the_minimum_of_a_sum_of_parabolas_is_the_weighted_mean_of_their_minima(rng):
    """Why the weight is the curvature: what no input can tell apart shares one move, and it is Newton's."""
    best = rng.uniform(-1.0, 1.0, (30, 3)) * OUTPUT_SHIFT
    bend = MIN_CURVATURE * rng.uniform(2.0, 50.0, (30, 3))
    moves, weights = preferred_moves(*three_costs(lambda by: 0.5 * (bend * (by - best) ** 2).sum(axis=1)), np.ones(30))
    for i in range(3):
        together = Level(0.0).fit(np.zeros((30, 1)), moves[:, i], weights[:, i]).value
        assert (bend[:, i] * (together - best[:, i])).sum() == pytest.approx(0.0, abs=1e-11)


COSTS = st.floats(-1e3, 1e3) | st.sampled_from([0.0, np.nan, np.inf, -np.inf, 1e-300, 1e300])


@given(costs=st.lists(COSTS, min_size=7, max_size=7), share=st.floats(0.0, 1.0))
def test_whatever_the_costs_a_move_is_at_most_two_shifts_long(costs, share):
    base, up, down = np.array(costs[:1]), np.array([costs[1:4]]), np.array([costs[4:]])
    moves, weights = preferred_moves(base, up, down, np.array([share]))
    assert (np.abs(moves) <= 2.0 * OUTPUT_SHIFT * (1.0 + 1e-12)).all()
    assert (weights >= 0.0).all()
    assert np.isfinite(weights).all()


def test_on_a_concave_landscape_the_move_goes_downhill_two_shifts_and_no_further():
    moves, weights = preferred_moves(
        *three_costs(lambda by: np.array([5.0 - (by / OUTPUT_SHIFT + 0.5) @ (by / OUTPUT_SHIFT + 0.5)])), np.ones(1)
    )
    np.testing.assert_allclose(moves, [2.0 * OUTPUT_SHIFT])
    np.testing.assert_allclose(weights, [1.0 / (2.0 * OUTPUT_SHIFT**2)])


def test_an_unknown_cost_weighs_nothing_for_its_own_output_only():
    for unknown, indices in itertools.product((np.nan, np.inf), ("base", "up", "down")):
        costs = three_costs(lambda by: np.full(2, 1.0 + (by / OUTPUT_SHIFT) @ (by / OUTPUT_SHIFT)))
        costs = {name: values.copy() for name, values in zip(("base", "up", "down"), costs, strict=True)}
        costs[indices][(0,) if indices == "base" else (0, 1)] = unknown
        moves, weights = preferred_moves(**costs, share=np.ones(2))
        assert np.isfinite(moves).all()
        assert (weights[0] == 0.0).tolist() == ([True] * 3 if indices == "base" else [False, True, False])
        assert (weights[1] > 0.0).all()


# -- the landscape ----------------------------------------------------------------------------------------------------
class Bowl(RunSet):
    """Segments whose cost is a parabola around a tuning that their speed and friction prefer; nothing is driven."""

    def __init__(self, best, runs=48, segments=3, noise=0.3, seed=0, scale=None):
        rng = np.random.default_rng(seed)
        self.best, self.noise, self.scale_of = best, noise, np.ones(runs) if scale is None else scale
        self.segment, self.before, self.stride = 10, 0, 5
        self.variables = np.zeros((runs, 10 * segments, len(at.SchedulingVariables._fields)))
        for column, (low, high) in ((0, (5.0, 30.0)), (2, (0.3, 1.0))):
            self.variables[..., column] = np.repeat(rng.uniform(low, high, (runs, segments)), 10, axis=1)
        self.asked = []

    def __len__(self):
        return len(self.variables)

    def segments(self, policy, seed, indices):
        self.asked.append(seed)
        rows = self.variables[indices, :: self.segment]
        Np, Nc, Q, R = np.moveaxis(policy.batch(rows.reshape(-1, rows.shape[-1])).reshape(*rows.shape[:2], 4), -1, 0)
        offsets = (np.stack([Np, Nc, np.log10(R / Q)], axis=-1) - self.best(rows)) / OUTPUT_SHIFT
        luck = np.exp(self.noise * np.random.default_rng(seed).normal(size=(len(self), rows.shape[1])))[indices]
        return self.scale_of[indices, None] * luck * (0.3 + (offsets**2).sum(axis=-1))

    def drive(self, policy, seeds, indices=None):
        indices = np.arange(len(self)) if indices is None else indices
        return np.stack([self.segments(policy, seed, indices).mean(axis=1) for seed in seeds], axis=1)


def same_everywhere(rows):
    return np.broadcast_to([34.0, 8.0, 3.1], (*rows.shape[:-1], 3))


def along_speed_and_friction(rows):
    """Np from 22 to 42 with speed, Nc from 5 to 12 with friction, log10 R/Q from 2.5 to 4.5 against both, curved."""
    speed, friction = (rows[..., 0] - 5.0) / 25.0, (rows[..., 2] - 0.3) / 0.7
    return np.stack([22.0 + 20.0 * speed**2, 5.0 + 7.0 * friction, 4.5 - speed - friction * speed], axis=-1)


INPUTS, DOMAIN = ("speed", "friction"), np.array([[5.0, 30.0], [0.3, 1.0]])
BEGIN = dict(zip(LEARNED_OUTPUTS, ((29.0, 10.0), (6.0, 5.0), (3.6, 0.5)), strict=True))


def beginning(kind):
    rows = np.random.default_rng(0).uniform(*DOMAIN.T, (300, 2))
    make = {
        "constant": lambda value, _: Level(value),
        "network": lambda value, span: NetworkSurface.start(DOMAIN, value, span, seed=1),
        "fuzzy": lambda value, _: FuzzySurface.start(rows, value, rules=8, seed=1),
    }[kind]
    return Learnable({slot: make(*values) for slot, values in BEGIN.items()}, INPUTS, DOMAIN)


def constant_schedule(by):
    """START, shifted."""
    values = (float(START.Np), float(START.Nc), math.log10(START.R))
    pairs = enumerate(zip(LEARNED_OUTPUTS, values, strict=True))
    functions = {slot: Number(value).shifted(by[i]) for i, (slot, value) in pairs}
    return at.Learned(functions, INPUTS, DOMAIN, TUNING_BOUNDS)


def test_the_landscape_says_for_every_segment_where_its_inputs_want_to_go():
    bowl = Bowl(along_speed_and_friction, noise=0.0)
    indices = np.array([3, 7, 8])
    rows, moves, weights = explore_landscape(bowl, constant_schedule, 1, indices)
    assert rows.shape == (3 * 3 * 2, len(at.SchedulingVariables._fields))
    assert moves.shape == weights.shape == (3 * 3 * 2, 3)
    expected = along_speed_and_friction(rows) - [START.Np, START.Nc, math.log10(START.R)]
    exact = np.array([True, False, True])  # Nc is rounded, its shift is not whole
    near = (np.abs(expected) <= 2.0 * OUTPUT_SHIFT) & exact
    assert near.sum() > 5
    np.testing.assert_allclose(moves[near], expected[near], rtol=0, atol=1e-9)
    assert (np.sign(moves) == np.sign(expected))[:, exact].all()
    per_segment = weights.reshape(3, 3, 2, 3)  # segments, runs, looks
    np.testing.assert_array_equal(per_segment[:, :, 0], per_segment[:, :, 1])


def test_every_run_counts_alike_however_much_it_costs():
    scale = 10.0 ** np.random.default_rng(5).uniform(-3.0, 3.0, 48)
    plain, scaled = (
        explore_landscape(Bowl(along_speed_and_friction, scale=p), constant_schedule, 1, np.arange(48))
        for p in (None, scale)
    )
    for first, other in zip(plain, scaled, strict=True):
        np.testing.assert_allclose(first, other, rtol=1e-9)


def test_a_segment_is_put_down_to_what_was_seen_in_it_and_shortly_before():
    bowl = Bowl(same_everywhere, runs=2, segments=3)
    bowl.variables[..., 1] = np.arange(30)  # the instant
    bowl.before = 10
    rows, _, weights = explore_landscape(bowl, constant_schedule, 1, np.array([1]))
    assert rows[:, 1].tolist() == [0, 5, *(0, 5, 10, 15), *(10, 15, 20, 25)]
    bowl.before = 0
    alone = explore_landscape(bowl, constant_schedule, 1, np.array([1]))[2]
    for columns, alone_columns in (((0, 2), (0, 2)), ((2, 6), (2, 4)), ((6, 10), (4, 6))):
        np.testing.assert_allclose(weights[slice(*columns)].sum(axis=0), alone[slice(*alone_columns)].sum(axis=0))


class Failing(Bowl):
    """Every run fails in its second segment when Np is above 30."""

    def segments(self, policy, seed, indices):
        cost = super().segments(policy, seed, indices)
        if policy(at.SchedulingVariables(20.0, 0.0, 0.8, 0.0))[0] > 30.0:
            cost[:, 1], cost[:, 2:] = np.inf, np.nan
        return cost


def test_where_a_shift_makes_a_run_fail_the_output_moves_away_and_what_follows_says_nothing():
    failing = Failing(lambda rows: same_everywhere(rows) * [0, 1, 1] + [29, 0, 0])
    _, moves, weights = explore_landscape(failing, constant_schedule, 1, np.arange(48))
    segment = np.repeat(np.arange(3), 48 * 2)
    assert (moves[segment == 0][:, 0] == 0.0).all()
    np.testing.assert_allclose(moves[segment == 1][:, 0], -0.5 * OUTPUT_SHIFT[0], rtol=0.02)
    assert (weights[segment == 2][:, 0] == 0.0).all()
    assert (weights[segment == 2][:, 2] > 0.0).all(), "the other outputs' shifts fail nowhere"
    worst = MAX_SEGMENT_COST / OUTPUT_SHIFT[0] ** 2  # as if it had cost that much, and nothing without the shift
    assert weights[:, 0].max() <= worst / 2 / 48  # two looks in each segment of 48 runs


class Narrow(Bowl):
    """All the same, but failed in the third segment unless R/Q is at least that of `edge`, (runs,) in decades."""

    def __init__(self, edge):
        super().__init__(same_everywhere, runs=len(edge), segments=5)
        self.edge, self.periods = np.asarray(edge), 50

    def segments(self, policy, seed, indices):
        cost = np.ones((len(indices), 5))
        *_, Q, R = policy(at.SchedulingVariables(20.0, 0.0, 0.8, 0.0))
        failed = math.log10(R / Q) < self.edge[indices] - 1e-9
        cost[failed, 2], cost[failed, 3:] = np.inf, np.nan
        return cost


def towards(goal, start=3.6):
    """From START's R/Q (in decades) and horizons to another R/Q."""
    way = np.array([0.0, 0.0, goal - start])

    def schedule(share):
        return constant_schedule(share * way + np.array([0.0, 0.0, start - math.log10(START.R)]))

    return Rescue(schedule, lambda rows: np.tile(way, (len(rows), 1)))


def test_what_saves_a_failed_run_is_learned_where_it_failed_and_before():
    # towards 5.6 by a quarter (4.1), a half (4.6), all the way; the last run cannot be saved, the first does not fail
    runs, start = Narrow([3.0, 4.0, 4.5, 5.0, 6.0]), 3.6
    base = towards(5.6).schedule
    _, moves, weights = explore_landscape(runs, constant_schedule, 1, np.arange(5), towards(5.6))
    plain_moves, plain_weights = explore_landscape(runs, constant_schedule, 1, np.arange(5))[1:]
    assert base(0.0)(at.SchedulingVariables(20.0, 0.0, 0.8, 0.0))[3] == pytest.approx(10**start)
    moves, plain_moves, weights, plain_weights = (
        array.reshape(5, 5, 2, 3) for array in (moves, plain_moves, weights, plain_weights)
    )  # segment, run, look, output
    for run, share in ((1, 0.25), (2, 0.5), (3, 1.0)):
        np.testing.assert_allclose(moves[:3, run, :, 2], share * 2.0)
        assert (moves[:3, run, :, :2] == 0.0).all()
        assert (weights[:3, run] > plain_weights[:3, run]).all()
        np.testing.assert_array_equal(moves[3:, run], plain_moves[3:, run])
    for run in (0, 4):
        np.testing.assert_array_equal(moves[:, run], plain_moves[:, run])
        np.testing.assert_array_equal(weights[:, run], plain_weights[:, run])
    # as much as a parabola weighs that costs what a failed segment does, that far from where it failed
    np.testing.assert_allclose(weights[2, 2, :, 2].sum() * 5, 2.0 * MAX_SEGMENT_COST / 1.0**2)


@pytest.mark.compiled
@pytest.mark.parametrize("safe", [None, at.Tuning(34, 8, 1.0, 10**4.6)])
def test_beyond_a_cliff_only_what_saves_the_runs_shows_the_way(safe):
    # Three shifts away from where every run fails: no shift says anything of the failure.
    runs = Narrow(np.full(24, 4.2))
    improved = improve(beginning("constant"), [(runs, 24)], [runs], rounds=12, safe=safe)
    failed = ~np.isfinite(runs.drive(improved.schedule, [5]))
    assert failed.all() if safe is None else not failed.any()


# -- improving --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("kind", ["constant", "network", "fuzzy"])
def test_improving_finds_the_known_optimum(kind):
    best = same_everywhere if kind == "constant" else along_speed_and_friction
    improved = improve(beginning(kind), [(Bowl(best), 32)], [Bowl(best, seed=1)], rounds=25)
    rows = Bowl(best, seed=2).variables.reshape(-1, len(at.SchedulingVariables._fields))
    Np, Nc, Q, R = improved.schedule.batch(rows).T
    off = np.abs(np.column_stack([Np, Nc, np.log10(R / Q)]) - best(rows))
    assert (np.sqrt((off**2).mean(axis=0)) < [0.5, 0.5, 0.03]).all()  # rounding alone leaves 0.29 of a horizon
    assert improved.history[-1]["score"] < improved.history[0]["score"]


class Judge:
    """Scores that were written down beforehand; remembers what it was asked about."""

    failed_cost = FAILED_COST

    def __init__(self, *scores):
        self.scores, self.asked, self.seeds = list(scores), [], []

    def costs(self, policy, seeds):
        self.asked.append(policy)
        self.seeds += seeds
        return np.array(self.scores[len(self.asked) - 1], dtype=float)


@pytest.mark.compiled
def test_the_best_round_is_kept_with_its_surfaces(monkeypatch):
    monkeypatch.setattr(improvement, "CHECK_INTERVAL", 3)
    first = Judge([20, 20], [3, 3], [1, 4], [2, 8], [FAILED_COST, 2])
    second = Judge([20], [5], [2], [1], [FAILED_COST])
    improved = improve(beginning("constant"), [(Bowl(same_everywhere), 8)], [first, second], rounds=11)
    assert [row["round"] for row in improved.history] == [0, 3, 6, 9, 11]
    logs = [
        np.log(20), (np.log(9) / 2 + np.log(5)) / 2, (np.log(4) / 2 + np.log(2)) / 2, np.log(16) / 4,
        np.log(50 * 25 * 25) / 4,
    ]  # fmt: skip
    np.testing.assert_allclose([row["score"] for row in improved.history], logs)
    assert [row["failed"] for row in improved.history] == [0.0, 0.0, 0.0, 0.0, 2.0]
    assert improved.schedule is first.asked[int(np.argmin(logs))]
    for slot, surface in improved.surfaces.items():
        assert improved.schedule.tuning["R" if slot == "log10_ratio" else slot].function == Number(surface.value)


@pytest.mark.compiled
def test_learned_tunings_stay_within_their_bounds_and_the_wish_to_leave_them_does_not_grow():
    beyond = Bowl(lambda rows: np.broadcast_to([90.0, -5.0, 9.0], (*rows.shape[:-1], 3)))
    improved = improve(beginning("constant"), [(beyond, 8)], [beyond], rounds=30)
    assert improved.schedule(at.SchedulingVariables(10.0, 0.0, 0.5, 0.0)) == pytest.approx((60.0, 1.0, 1.0, 1e6))
    assert [improved.surfaces[slot].value for slot in LEARNED_OUTPUTS] == pytest.approx([60.0, 1.0, 6.0])


class Watched(Level):
    """A level that remembers the inputs that it was fitted at."""

    fitted: list = []  # noqa: RUF012

    def fit(self, x, target, weight, effort=1.0):
        self.fitted.append(x)
        return Watched(super().fit(x, target, weight, effort).value)


@pytest.mark.compiled
def test_it_learns_at_the_inputs_that_a_scheduler_would_see():
    """In their order, and clipped to the domain."""
    domain, bowl = np.array([[0.5, 0.8], [10.0, 20.0]]), Bowl(same_everywhere)
    start = Learnable({slot: Watched(30.0) for slot in LEARNED_OUTPUTS}, ("friction", "speed"), domain)
    Watched.fitted = []
    improve(start, [(bowl, 48)], [bowl], rounds=1)
    inputs = bowl.variables[:, ::5].reshape(-1, len(at.SchedulingVariables._fields))[:, [2, 0]]
    for fitted in Watched.fitted:
        np.testing.assert_array_equal(np.unique(fitted, axis=0), np.unique(np.clip(inputs, *domain.T), axis=0))


class Fatal(Bowl):
    """Run 5 always fails."""

    def segments(self, policy, seed, indices):
        cost = super().segments(policy, seed, indices)
        cost[indices == 5, 1], cost[indices == 5, 2:] = np.inf, np.nan
        self.driven.append(indices.tolist())
        return cost


@pytest.mark.compiled
def test_a_run_that_ever_failed_is_driven_in_every_round():
    fatal = Fatal(same_everywhere)
    fatal.driven = []
    count = REVISITED
    improve(beginning("constant"), [(fatal, count)], [Judge([1.0], [1.0])], rounds=4)
    few = [indices for indices in fatal.driven if len(indices) == count]
    assert all(5 in indices for indices in few)
    assert len(set.union(*map(set, few))) > count, "the others are drawn anew"


@pytest.mark.compiled
def test_learning_depends_on_its_seed_alone():
    first, again, other = (
        improve(beginning("fuzzy"), [(Bowl(same_everywhere), 16)], [Bowl(same_everywhere)], rounds=3, seed=n)
        for n in (1, 1, 2)
    )
    rows = Bowl(same_everywhere).variables[:, 0]
    np.testing.assert_array_equal(first.schedule.batch(rows), again.schedule.batch(rows))
    assert first.history == again.history
    assert first.history != other.history


@pytest.mark.compiled
@pytest.mark.parametrize("seed", [0, 7])
def test_noise_is_new_in_every_round_and_never_that_of_the_scores(seed):
    bowl, judge = Bowl(same_everywhere), Judge(*[[1.0]] * 10)
    improve(beginning("constant"), [(bowl, 4)], [judge], rounds=10, seed=seed)
    rounds = [noise for noise, _ in itertools.groupby(bowl.asked)]
    assert len(rounds) == len(set(rounds)) == 10, "one for each, under which all shifts are compared"
    assert len(judge.seeds) == 3, "the start and two checks"
    assert not set(rounds) & set(judge.seeds)


@pytest.mark.parametrize(("changes", "words"), [
    ({"inputs": ("speed", "offset")}, "offset"),
    ({"inputs": ("speed", "grip")}, "'grip'.*friction"),
    ({"surfaces": {"Np": Level(30.0)}}, "Np, Nc, log10_ratio"),
])  # fmt: skip
def test_a_missing_surface_and_an_input_unknown_before_driving_are_refused(changes, words):
    with pytest.raises(at.InvalidInput, match=words):
        improve(replace(beginning("constant"), **changes), [], [])


@pytest.mark.compiled
def test_on_real_runs_learning_lowers_the_cost_of_runs_that_it_never_saw(monkeypatch):
    monkeypatch.setattr(improvement, "CHECK_INTERVAL", 2)
    slow = {slot: Level(value) for slot, value in zip(LEARNED_OUTPUTS, (45.0, 3.0, 4.6), strict=True)}
    train, held_out = run_set(lane_changes(24, 4.0)[:16]), run_set(lane_changes(24, 4.0)[16:])
    improved = improve(Learnable(slow, INPUTS, DOMAIN), [(train, 16)], [held_out], rounds=8)
    before = held_out.costs(at.Tuning(45, 3, 1.0, 10.0**4.6), [12345])
    assert geometric_mean(held_out.costs(improved.schedule, [12345])) < 0.7 * geometric_mean(before)
