"""The improved particle swarm: the paper's equations, what holds for every position, and that runs can be repeated."""

import itertools
import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from adaptrack.base.errors import InvalidInput
from adaptrack.base.files import build, read_toml
from adaptrack.core.kernel import Place, exported, int64, matrix, vector, void
from adaptrack.core.maths import random
from adaptrack.core.maths.random import counted_normal, counted_uniform
from adaptrack.core.tuning import swarm
from adaptrack.tuning.pso import SearchSpace, Swarm, SwarmSettings, minimise

pytestmark = pytest.mark.kernels

TUNING = SearchSpace.tuning()
NP, NC, Q, R = range(4)


def box(dims, low=-5.0, high=5.0, **options):
    return SearchSpace(names=tuple(f"x{d}" for d in range(dims)), low=(low,) * dims, high=(high,) * dims, **options)


def sphere(x):
    return (x**2).sum(axis=1)


def hilly(x):
    """A cost of tunings with many hills, so that a swarm keeps moving."""
    unit = (x - np.array(TUNING.low)) / (np.array(TUNING.high) - np.array(TUNING.low))
    return ((unit - 0.4) ** 2).sum(axis=1) - 0.1 * np.cos(25.0 * unit).sum(axis=1)


def state_of(swarm_):
    """Copies of all that determines the rest of a search."""
    arrays = {name: array.copy() for name, array in swarm_._swarm._asdict().items()}
    return {**arrays, "trace": swarm_._trace.copy(), "generation": np.array(swarm_.generation)}


def generations(swarm_, function):
    """Each generation's positions with the state that its costs led to."""
    while not swarm_.is_done:
        x = swarm_.ask()
        swarm_.tell(function(x))
        yield x, state_of(swarm_)


def same(a, b):
    return a.keys() == b.keys() and all(np.array_equal(a[key], b[key], equal_nan=True) for key in a)


@st.composite
def spaces(draw):
    """Any box, with whole, fixed and ordered dimensions."""
    dims = draw(st.integers(1, 5))
    names = [f"x{d}" for d in range(dims)]
    integer = [draw(st.booleans()) for _ in names]
    low, high = [], []
    for is_whole in integer:
        bound = st.integers(-30, 30).map(float) if is_whole else st.floats(-1e6, 1e6)
        a, b = sorted((draw(bound), draw(bound)))
        low.append(a)
        high.append(b)
    pairs = [(i, j) for i, j in itertools.permutations(range(dims), 2) if integer[i] == integer[j] and low[i] <= low[j]]
    ordered = draw(st.sampled_from([None, *pairs]))
    return SearchSpace(
        names=tuple(names), low=tuple(low), high=tuple(high),
        integers=tuple(name for name, is_whole in zip(names, integer, strict=True) if is_whole),
        ordered=None if ordered is None else (names[ordered[0]], names[ordered[1]]),
        spread=draw(st.floats(1, 4)) if ordered is not None and low[ordered[0]] >= 0 else 1.0,
    )  # fmt: skip


# -- counted random numbers -------------------------------------------------------------------------------------------
def test_outputs_are_those_of_splitmix64():
    # the published sequence of the generator started at 1234567
    outputs = [6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431, 16408922859458223821]
    assert [int(random.output(1234567, n)) for n in range(1, 6)] == outputs


def test_compiled_draws_are_those_of_plain_integers(rng):
    for counters in rng.integers(-(2**62), 2**62, (200, 5)).tolist():
        state = 2
        for counter in counters:
            state = random._output_in_python(state, counter)
        assert counted_uniform(*counters) == random._unit_in_python(state)


def test_uniform_draws_are_uniform_in_every_counter():
    for counter in range(5):
        counters = [[n if c == counter else 7 for c in range(5)] for n in range(4000)]
        draws = np.array([counted_uniform(*counter_values) for counter_values in counters])
        assert ((draws >= 0) & (draws < 1)).all()
        assert stats.kstest(draws, "uniform").pvalue > 1e-3
        assert abs(np.corrcoef(draws[1:], draws[:-1])[0, 1]) < 4 / math.sqrt(len(draws))


def test_normal_draws_are_normal_and_apart_from_the_uniform_ones():
    draws = np.array([counted_normal(3, instant, channel) for instant in range(1000) for channel in range(4)])
    assert stats.kstest(draws, "norm").pvalue > 1e-3
    assert np.abs(np.corrcoef(draws.reshape(1000, 4).T) - np.eye(4)).max() < 4 / math.sqrt(1000)


# -- the paper's equations --------------------------------------------------------------------------------------------
@given(
    st.integers(0, 200), st.integers(1, 200), st.floats(0.5, 1), st.floats(0, 0.5), st.floats(0, 50), st.floats(1, 5)
)
def test_inertia_is_eq_19(g, G, w_max, w_min, lambda1, lambda2):
    by_hand = w_min + np.exp(w_max) * np.exp(-lambda1 * (w_max + w_min) * g / G) / lambda2
    assert swarm.inertia(g, G, w_max, w_min, lambda1, lambda2) == pytest.approx(by_hand, rel=1e-12)


def test_accelerations_follow_the_schedule_of_eq_20_over_the_papers_fifteen_generations():
    alpha = [0.05] * 4 + [0.02] * 2 + [-0.035] * 6 + [-0.0015] * 3
    steps = np.array(SwarmSettings().steps)
    c1, c2 = 2.0, 2.0
    for g in range(15):
        following = swarm.accelerations(g, 15, c1, c2, steps)
        assert following == pytest.approx((c1 + alpha[g], c2 - alpha[g]))
        c1, c2 = following
    assert c1 - 2.0 == pytest.approx(0.0255)  # nearly back where it began


def test_where_the_ranges_of_eq_20_share_an_end_the_first_wins():
    numbers = [swarm.accelerations(g, 100, 0.0, 0.0, np.array([1.0, 2.0, 3.0, 4.0]))[0] for g in range(101)]
    assert numbers == 21 * [1] + 15 * [2] + 40 * [3] + 25 * [4]


def test_a_move_is_eq_18_with_counted_draws():
    space, settings = box(3, -1.0, 3.0), SwarmSettings(particles=5, generations=6, velocity_clamp=0.2)
    run = Swarm(space, settings, seed=11, stream=4)
    schedule = settings.schedule()
    for g in range(5):
        x, v = run.ask(), state_of(run)["v"]
        run.tell(sphere(x))
        state = state_of(run)
        w, c1, c2 = schedule[g]
        assert state["progress"][swarm.PROGRESS.w] == w
        r = np.array(
            [[[counted_uniform(11, 4, g + 1, i, 2 * d + k) for k in (0, 1)] for d in range(3)] for i in range(5)]
        )
        pull = c1 * r[..., 0] * (state["best"] - x) + c2 * r[..., 1] * (state["leader"] - x)
        velocity = np.clip(w * v + pull, -0.8, 0.8)
        assert state["v"] == pytest.approx(velocity, rel=1e-12, abs=1e-12)
        assert run.ask() == pytest.approx(np.clip(x + velocity, -1, 3), rel=1e-12, abs=1e-12)


def test_the_classic_swarm_has_constant_coefficients():
    schedule = SwarmSettings.classic(generations=9).schedule()
    assert np.array_equal(schedule, np.broadcast_to([0.7298, 1.49618, 1.49618], (8, 3)))
    run = Swarm(box(2), SwarmSettings.classic(w=0.6, c1=1.7, c2=1.3))
    for _, state in itertools.islice(generations(run, sphere), 14):
        assert list(state["progress"][1:]) == [0.6, 1.7, 1.3]


# -- what holds for every position ------------------------------------------------------------------------------------
@given(spaces(), st.sampled_from(["improved", "classic"]), st.floats(0.01, 1), st.integers(0, 2**63 - 1))
def test_every_position_is_in_the_space_and_no_velocity_exceeds_its_clamp(space, kind, clamp, seed):
    settings = SwarmSettings(particles=6, generations=8, kind=kind, velocity_clamp=clamp)
    fastest = clamp * (np.array(space.high) - np.array(space.low))
    target = np.array(space.high) + 1.0  # out of reach: everything is pressed against the bounds
    for x, state in generations(Swarm(space, settings, seed=seed), lambda x: sphere(x - target)):
        assert space.contains(x).all()
        assert space.contains(state["x"]).all()
        assert space.contains(state["leader"])
        assert (np.abs(state["v"]) <= fastest).all()


def test_tunings_have_whole_horizons_and_nc_never_exceeds_np():
    met = False
    for seed in range(5):
        # a cost that wants a long Nc and a short Np
        for x, _ in generations(Swarm(TUNING, seed=seed), lambda x: x[:, NP] - 2.0 * x[:, NC]):
            assert (x[:, :2] == np.round(x[:, :2])).all()
            assert (x[:, NC] >= 1).all()
            assert (x[:, NC] <= x[:, NP]).all()
            assert TUNING.contains(x).all()
            met = met or (x[:, NC] == x[:, NP]).any()
    assert met


def test_the_first_draw_is_uniform_and_every_whole_number_is_as_likely():
    space = SearchSpace(names=("a", "b"), low=(-2.0, 3.0), high=(3.0, 4.0), integers=("a",))
    first = Swarm(space, SwarmSettings(particles=6000), seed=5).ask()
    numbers, counts = np.unique(first[:, 0], return_counts=True)
    assert numbers.tolist() == [-2, -1, 0, 1, 2, 3]
    assert stats.chisquare(counts).pvalue > 1e-3
    assert stats.kstest(first[:, 1] - 3.0, "uniform").pvalue > 1e-3


@pytest.mark.parametrize("spread", [1.0, 1.3, 2.5, 40.0])
def test_the_first_draw_of_a_whole_ordered_pair_is_whole_and_spread_as_far_as_the_bounds_allow(spread):
    space = SearchSpace(
        names=("a", "b"), low=(1.0, 2.0), high=(30.0, 20.0), integers=("a", "b"), ordered=("a", "b"), spread=spread
    )
    first = Swarm(space, SwarmSettings(particles=500), seed=3).ask()
    assert space.contains(first).all()
    assert (first[:, 1] >= np.minimum(spread * first[:, 0], 20)).all()


def test_a_position_is_clamped_then_rounded_to_the_nearest_then_nc_lowered_to_np():
    settings, space = SwarmSettings().packed(TUNING), TUNING.packed()
    for position, repaired in (
        ([20.49, 3.5, 1.0, 0.05], [20, 4, 1.0, 0.05]),
        ([60.0, -2.0, 11.0, 0.0], [55, 1, 10.0, 0.001]),
        ([4.6, 9.0, 1.0, 0.05], [5, 5, 1.0, 0.05]),
        ([-3.0, 30.0, 1.0, 0.05], [1, 1, 1.0, 0.05]),
    ):
        x = np.array(position)
        swarm.repair(settings, space, x)
        assert x.tolist() == repaired


def test_a_fixed_dimension_stays_and_leaves_the_others_their_path():
    free, fixed = box(2), SearchSpace(names=("a", "b", "c"), low=(-5.0, -5.0, 7.0), high=(5.0, 5.0, 7.0))
    path = [x for x, _ in generations(Swarm(free, seed=3), sphere)]
    wider = [x for x, _ in generations(Swarm(fixed, seed=3), lambda x: sphere(x[:, :2]))]
    assert np.array_equal(np.array(wider)[..., :2], path)
    assert (np.array(wider)[..., 2] == 7.0).all()


def test_bests_never_get_worse_and_are_the_costs_of_their_positions():
    before = np.full(20, np.inf)
    for _, state in generations(Swarm(TUNING, seed=8), hilly):
        assert (state["best_costs"] <= before).all()
        assert np.array_equal(hilly(state["best"]), state["best_costs"])
        before = state["best_costs"]
        assert state["progress"][swarm.PROGRESS.leader_cost] == before.min()
        assert np.array_equal(hilly(state["leader"][None]), [before.min()])


def test_of_equal_costs_the_first_particle_leads_and_only_better_ones_replace_it():
    run = Swarm(box(2), SwarmSettings(particles=4, generations=3))
    first = run.ask()
    run.tell([3.0, 1.0, 1.0, 2.0])
    assert np.array_equal(run.best.x, first[1])
    run.tell([1.0, 1.0, 1.0, 1.0])
    assert np.array_equal(run.best.x, first[1])
    third = run.ask()
    run.tell([1.0, 1.0, 1.0, 0.5])
    assert np.array_equal(run.best.x, third[3])
    assert run.best.cost == 0.5


@pytest.mark.parametrize("settings", [SwarmSettings(), SwarmSettings.classic(generations=60)], ids=["paper", "classic"])
def test_the_swarm_converges_on_the_sphere(settings):
    results = [minimise(sphere, box(4), settings, seed=seed) for seed in range(20)]
    starts = np.array([run.trace[0] for run in results])
    ends = np.array([run.cost for run in results])
    assert (ends < starts).all()
    assert np.median(ends / starts) < 1e-3
    assert all(run.evaluations == settings.evaluations for run in results)


# -- runs that can be repeated ----------------------------------------------------------------------------------------
def test_ask_and_tell_find_what_minimise_finds():
    run = Swarm(TUNING, seed=6, stream=2)
    while not run.is_done:
        assert np.array_equal(run.ask(), run.ask())
        run.tell(hilly(run.ask()))
    result = minimise(hilly, TUNING, seed=6, stream=2)
    assert np.array_equal(run.best.x, result.x)
    assert np.array_equal(run.trace, result.trace)
    assert run.best.cost == result.cost == result.trace[-1] == hilly(result.x[None])[0]
    assert result.evaluations == 300


@exported(void(int64, int64, int64, vector, matrix, Place(swarm.Particles), vector), name="swarm_of_a_test")
def _sphere_swarm(generations, seed, stream, settings, space, arrays, costs):
    swarm.begin(seed, stream, settings, space, arrays)
    for g in range(generations):
        for i in range(costs.size):
            costs[i] = 0.0
            for value in arrays.x[i]:
                costs[i] += value * value
        swarm.learn(costs, arrays)
        if g < generations - 1:
            swarm.move(g, seed, stream, settings, space, arrays)


def test_a_swarm_inside_compiled_code_is_the_same_to_the_last_bit():
    space, settings = box(3), SwarmSettings(particles=7, generations=9)
    arrays = swarm.particles(7, 3)
    _sphere_swarm(9, 5, 1, settings.packed(space), space.packed(), arrays, np.zeros(7))

    def added_in_order(x):
        return (x[:, 0] ** 2 + x[:, 1] ** 2) + x[:, 2] ** 2

    results = minimise(added_in_order, space, settings, seed=5, stream=1)
    assert np.array_equal(arrays.leader, results.x)
    assert arrays.progress[swarm.PROGRESS.leader_cost] == results.cost


@pytest.mark.parametrize("kind", ["improved", "classic"])
def test_a_run_put_aside_at_any_generation_goes_on_bit_identically(kind):
    settings = SwarmSettings(particles=6, generations=7, kind=kind)
    states = [state for _, state in generations(Swarm(TUNING, settings, seed=2**63 - 1, stream=12), hilly)]
    for count in range(8):
        run = Swarm(TUNING, settings, seed=2**63 - 1, stream=12)
        for _ in range(count):
            run.tell(hilly(run.ask()))
        resumed = pickle.loads(pickle.dumps(run))
        assert same(state_of(resumed), state_of(run))
        states_after = [state for _, state in generations(resumed, hilly)]
        assert all(same(a, b) for a, b in zip(states_after, states[count:], strict=True))
        assert np.array_equal(resumed.best.x, states[-1]["leader"])


# -- costs that are no numbers ----------------------------------------------------------------------------------------
def test_costs_of_nan_count_as_infinite():
    def lost(value):
        return lambda x: np.where(x[:, NP] < 25, value, hilly(x))

    with_nan = [state for _, state in generations(Swarm(TUNING, seed=1), lost(np.nan))]
    with_inf = [state for _, state in generations(Swarm(TUNING, seed=1), lost(np.inf))]
    assert all(same(a, b) for a, b in zip(with_nan, with_inf, strict=True))
    assert math.isfinite(minimise(lost(np.nan), TUNING, seed=1).cost)


def test_a_swarm_that_never_sees_a_finite_cost_survives_and_says_so():
    result = minimise(lambda x: np.full(len(x), np.nan), TUNING)
    assert result.cost == math.inf
    assert (result.trace == math.inf).all()
    assert TUNING.contains(result.x)


# -- what is refused --------------------------------------------------------------------------------------------------
def decades(low=1.0, integers=()):
    return SearchSpace(names=("a",), low=(low,), high=(10.0,), decades=("a",), integers=integers)


@pytest.mark.parametrize(("make", "changes", "words"), [
    (SwarmSettings, {"particles": 0}, "particles = 0: must be a whole number >= 1"),
    (SwarmSettings, {"generations": 1.5}, "generations = 1.5"),
    (SwarmSettings, {"kind": "modern"}, "must be one of 'improved', 'classic'"),
    (SwarmSettings, {"lambda2": 0.0}, "lambda2 = 0.0"),
    (SwarmSettings, {"lambda1": math.nan}, "lambda1 = nan"),
    (SwarmSettings, {"w_min": 1.2}, "w_min = 1.2 > w_max = 0.99"),
    (SwarmSettings, {"c1": -1.0}, "c1 = -1.0"),
    (SwarmSettings, {"steps": (0.0, 0.0)}, "steps"),
    (SwarmSettings, {"velocity_clamp": 0.0}, "velocity_clamp = 0.0"),
    (SwarmSettings, {"velocity_clamp": 1.5}, "velocity_clamp = 1.5"),
    (SwarmSettings, {"particels": 20}, "Did you mean 'particles'"),
    (TUNING.replace, {"low": (1.0, 1.0, 0.1)}, "low has 3 values for 4 names"),
    (TUNING.replace, {"high": (55.0, 18.0, 0.05, 0.1)}, "Q: low = 0.1 > high = 0.05: the space is empty"),
    (TUNING.replace, {"names": ("Np", "Np", "Q", "R")}, "each dimension needs a name of its own"),
    (TUNING.replace, {"high": (55.5, 18.0, 10.0, 0.1)}, "Np: low = 1 and high = 55.5 must be whole"),
    (TUNING.replace, {"high": (55.0, 18.0, math.inf, 0.1)}, "high"),
    (TUNING.replace, {"low": (1.0, 5.0, 0.1, 0.001)}, "Nc <= Np cannot hold where Np < 5: raise the lower bound"),
    (TUNING.replace, {"low": (-3.0, -3.0, 0.1, 0.001)}, "not negative"),
    (TUNING.replace, {"low": (1.0, 1.0, -1e308, 0.001), "high": (55.0, 18.0, 1e308, 0.1)}, "not a finite number"),
    (TUNING.replace, {"ordered": ("Nc", "Q")}, "both of whole or both of real"),
    (TUNING.replace, {"ordered": ("Nc", "Nc")}, "give two dimensions"),
    (TUNING.replace, {"ordered": ("Nc", "N")}, "'N' is not one of the names"),
    (TUNING.replace, {"ordered": None}, "spread = 2"),
    (TUNING.replace, {"integers": ("nc",)}, "'nc' is not one of the names"),
    (TUNING.replace, {"spread": 0.5}, "spread = 0.5"),
    (decades, {"low": 0.0}, "decades"),
    (decades, {"integers": ("a",)}, "decades"),
])  # fmt: skip
def test_bad_settings_and_spaces_are_refused_with_the_reason(make, changes, words):
    with pytest.raises(InvalidInput) as refusal:
        make(**changes)
    assert words in str(refusal.value)


@pytest.mark.parametrize("seed", [-1, 2**63, 1.0, True, None])
def test_seeds_that_are_no_counters_are_refused(seed):
    with pytest.raises(InvalidInput, match="seed = "):
        Swarm(TUNING, seed=seed)
    with pytest.raises(InvalidInput, match="stream = "):
        Swarm(TUNING, stream=seed)


@pytest.mark.parametrize("costs", [1.0, [1.0] * 19, np.ones((20, 1)), ["a"] * 20, [[1.0], [1.0, 2.0]]])
def test_costs_that_are_not_one_number_per_particle_are_refused_and_change_nothing(costs):
    run = Swarm(TUNING)
    with pytest.raises(InvalidInput, match="costs"):
        run.tell(costs)
    assert same(state_of(run), state_of(Swarm(TUNING)))


# -- files ------------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "record", [SwarmSettings(), SwarmSettings.classic(), TUNING, box(2)], ids=lambda r: type(r).__name__
)
def test_settings_and_spaces_survive_a_file(record, tmp_path):
    path = tmp_path / "record.toml"
    record.to_toml(path)
    assert build(type(record), read_toml(path), path) == record


def test_a_dimension_searched_by_decades_is_uniform_in_its_logarithm():
    space = SearchSpace(names=("a", "b"), low=(1e-3, -1.0), high=(1e3, 1.0), decades=("a",))
    draws = Swarm(space, SwarmSettings(particles=4000), seed=3).ask()
    assert space.contains(draws).all()
    shares = np.histogram(np.log10(draws[:, 0]), bins=6, range=(-3, 3))[0] / 4000
    assert np.abs(shares - 1 / 6).max() < 0.03


def test_searching_by_decades_finds_a_minimum_that_lies_decades_away():
    space = SearchSpace(names=("a",), low=(1e-6,), high=(1e6,), decades=("a",))
    results = minimise(lambda x: (np.log10(x[:, 0]) - 4.0) ** 2, space, SwarmSettings(generations=60), seed=1)
    assert results.x[0] == pytest.approx(1e4, rel=0.05)
