"""The schedulers' kernels: the numbers of the models they were packed from, and nothing worse than that to steer by."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

import adaptrack as at
from adaptrack.control.scheduling import ENTRIES, VARIABLES, Network, StabilityMap, Sugeno, Table
from adaptrack.control.scheduling.functions import ANY
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.core.scheduling import functions, guard
from adaptrack.core.scheduling import schedule as kernel
from small_models import line, random_network, random_sugeno, random_table, stability_map

pytestmark = pytest.mark.kernels

FALLBACK = at.Tuning(25, 6, 1.0, 100.0)


def by_kernel(function, x):
    """(n,) a function at x (n, D) by its kernel, its part lying somewhere in larger arrays."""
    packed = function.pack()
    integers = np.array([7] * 3 + list(packed.integers), np.int64)
    numbers = np.array([math.nan] * 5 + list(packed.numbers))
    work = np.full(packed.scratch, math.nan)
    rows = np.ascontiguousarray(x)
    return np.array([functions.evaluate(packed.kind, row, integers[3:], numbers[5:], work) for row in rows])


def close(ours, reference):
    np.testing.assert_allclose(ours, reference, rtol=1e-10, atol=1e-10)


# -- the functions ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("relu", [True, False])
def test_a_network_is_that_of_its_numpy_reference(relu, rng):
    for _ in range(40):
        inputs = int(rng.integers(1, 8))
        net = random_network(rng, inputs, relu)
        x = net.low + (net.high - net.low) * rng.uniform(-0.5, 1.5, (10, inputs))
        close(by_kernel(net, x), net.predict(x))


@pytest.mark.filterwarnings("ignore:overflow encountered in exp:RuntimeWarning")  # said by NumPy's reference
def test_a_neuron_far_in_its_saturation_is_zero_or_one():
    net = Network(
        np.zeros(1), np.ones(1), (np.array([[1e5, -1e5]]), np.array([[2.0], [3.0]])), (np.zeros(2), np.zeros(1)), 0.0,
        1.0,
    )  # fmt: skip
    x = np.array([[1.0], [-1.0]])
    assert by_kernel(net, x).tolist() == net.predict(x).tolist() == [2.0, 3.0]


@pytest.mark.parametrize("kind", ["gaussian", "bell", "mixed"])
def test_a_fuzzy_system_is_that_of_its_numpy_reference(kind, rng):
    for _ in range(40):
        inputs = int(rng.integers(1, 8))
        system = random_sugeno(rng, inputs, kind)
        x = rng.normal(size=(10, inputs)) * rng.choice([0.3, 1.0, 5.0])
        close(by_kernel(system, x), system.predict(x))


@pytest.mark.parametrize("kind", ["gaussian", "bell"])
def test_far_from_every_rule_a_fuzzy_system_still_answers_as_its_reference(kind, rng):
    system = random_sugeno(rng, 3, kind)
    x = rng.normal(size=(20, 3)) * 10.0 ** rng.uniform(1, 4, (20, 1))
    assert (system.strengths(x).max(axis=1) > 0.0).all()
    np.testing.assert_allclose(by_kernel(system, x), system.predict(x), rtol=1e-9)


def test_at_the_centre_of_a_bell_membership_is_one():
    bells = Sugeno(
        np.array([0, 0]), np.array([True, True]), np.array([[1.0, 2.0, 0.0], [1.0, 2.0, 1.0]]), np.array([[0], [1]]),
        np.array([[0.0, 10.0], [0.0, 20.0]]), np.ones(2),
    )  # fmt: skip
    assert by_kernel(bells, np.array([[0.0]]))[0] == pytest.approx((10.0 + 0.5 * 20.0) / 1.5, rel=1e-14)


def test_a_rule_that_asks_nothing_always_holds():
    rules = np.array([[ANY, ANY]])
    plane = Sugeno(
        np.zeros(0, int), np.zeros(0, bool), np.zeros((0, 3)), rules, np.array([[2.0, 3.0, 5.0]]), np.ones(1)
    )
    assert by_kernel(plane, np.array([[10.0, 100.0]]))[0] == 325.0


def scipys(table, x):
    """SciPy's interpolation, held beyond the last node; an axis of one node is left out."""
    longer = [d for d, axis in enumerate(table.axes) if len(axis) > 1]
    if not longer:
        return np.full(len(x), table.values.item())
    axes = [table.axes[d] for d in longer]
    x = np.column_stack([np.clip(x[:, d], axis[0], axis[-1]) for d, axis in zip(longer, axes, strict=True)])
    method = {"nearest": "nearest", "multilinear": "linear"}[table.method]
    return RegularGridInterpolator(axes, table.values.squeeze(), method)(x)


@pytest.mark.parametrize("method", ["nearest", "multilinear"])
def test_a_table_is_that_of_scipy(method, rng):
    for _ in range(40):
        inputs = int(rng.integers(1, 6))
        table = random_table(rng, inputs, method)
        x = np.column_stack([rng.uniform(axis[0] - 1.0, axis[-1] + 1.0, 10) for axis in table.axes])
        close(by_kernel(table, x), scipys(table, x))


# -- from the variables to a tuning -----------------------------------------------------------------------------------
class Drive:
    """A schedule at work: asks it step after step."""

    def __init__(self, schedule, tuning=(35, 8, 10.0, 0.01), slots=1):
        self.plan, self.tuning = schedule.plan(slots), np.array([tuning] * slots, dtype=float)

    def __call__(self, slot=0, **variables):
        values = {"speed": 10.0, "y_ref": 0.0, "friction": 0.8, "wind": 0.0, **variables}
        row = np.array(at.SchedulingVariables(**values), dtype=float)
        kernel.schedule(slot, row, self.plan, self.tuning[slot])
        return self.tuning[slot].tolist()

    def counts(self, slot=0):
        return dict(zip(guard.COUNTS, kernel.counted(self.plan.memory)[slot].tolist(), strict=True))


def speedy(**functions):
    """A schedule by speed within 0..20 m/s: Np = 20 + speed, and the rest constant unless told."""
    entries = {"Np": line(0.0, 20.0, 20.0, 40.0), "Nc": 5.0, "Q": 1.0, "R": 100.0} | functions
    return at.Learned(entries, ("speed",), [[0.0, 20.0]])


@pytest.mark.parametrize("place", range(len(VARIABLES)))
def test_every_variable_can_be_the_input(place):
    name = list(VARIABLES)[place]
    schedule = at.Learned({"Np": line(0.0, 20.0, 20.0, 40.0), "Nc": 5.0, "Q": 1.0, "R": 1.0}, (name,), [[0.0, 20.0]])
    row = np.zeros(len(VARIABLES))
    row[place] = 7.0
    assert schedule(at.SchedulingVariables(*row)) == (27.0, 5.0, 1.0, 1.0)


def test_inputs_outside_the_domain_are_clipped_and_counted():
    drive = Drive(speedy())
    assert [drive(speed=speed)[0] for speed in (20.0, 25.0, 10.0, -3.0, 0.0)] == [40.0, 40.0, 30.0, 20.0, 20.0]
    assert drive.counts() == dict.fromkeys(guard.COUNTS, 0) | {"steps": 5, "clipped": 2}


@pytest.mark.parametrize("nothing", [math.nan, math.inf, -math.inf])
def test_an_input_that_is_no_number_keeps_the_last_tuning_and_is_counted(nothing):
    drive = Drive(speedy())
    before = drive(speed=12.0)
    assert drive(speed=nothing) == before
    drive.tuning[:] = 1.0  # it is kept by the scheduler, whatever the caller did with it
    assert drive(speed=nothing) == before
    assert drive(speed=15.0)[0] == 35.0
    assert drive.counts()["broken"] == 2


def test_an_entry_by_its_logarithm_is_ten_to_the_power_of_its_function():
    schedule = at.Learned({"Np": 30.0, "Nc": 5.0, "log10_ratio": line(0.0, 20.0, -1.0, 3.0)}, ("speed",), [[0.0, 20.0]])
    drive = Drive(schedule)
    for speed, ratio in ((0.0, 0.1), (5.0, 1.0), (10.0, 10.0), (20.0, 1000.0)):
        assert drive(speed=speed)[2:] == [1.0, pytest.approx(ratio, rel=1e-14)]


def test_horizons_are_rounded_halves_upwards_and_weights_are_not():
    drive = Drive(speedy(Nc=line(0.0, 20.0, 2.0, 12.0), Q=line(0.0, 20.0, 1.0, 3.0)))
    assert drive(speed=0.4)[:3] == [20.0, 2.0, pytest.approx(1.04)]
    assert drive(speed=0.5)[:2] == [21.0, 2.0]
    assert drive(speed=1.0)[:2] == [21.0, 3.0]


def test_values_are_held_within_the_bounds_of_their_entry():
    bounds = {"Np": (10, 25), "Nc": (2, 4), "Q": (0.5, 2.0), "R": (1.0, 10.0)}
    wild = {name: line(0.0, 20.0, -1e3, 1e3) for name in ENTRIES}
    drive = Drive(at.Learned(wild, ("speed",), [[0.0, 20.0]], bounds))
    assert drive(speed=0.0) == [10.0, 2.0, 0.5, 1.0]
    assert drive(speed=20.0) == [25.0, 4.0, 2.0, 10.0]


def test_every_run_has_a_memory_of_its_own():
    drive = Drive(speedy(), slots=3)
    for run, speed in ((0, 5.0), (1, 10.0), (2, 30.0)):
        drive(run, speed=speed)
    assert [drive(run, speed=math.nan)[0] for run in range(3)] == [25.0, 30.0, 40.0]
    assert [drive.counts(run)["clipped"] for run in range(3)] == [0, 0, 1]
    assert [drive.counts(run)["broken"] for run in range(3)] == [1, 1, 1]


# -- the guard --------------------------------------------------------------------------------------------------------
def test_a_guard_limits_how_fast_the_tuning_changes():
    functions = {"Nc": line(0.0, 20.0, 2.0, 12.0), "R": line(0.0, 20.0, 10.0, 1e4)}
    drive = Drive(at.Guarded(speedy(**functions), FALLBACK, rates=(5, 2, 0.5)))
    assert drive(speed=0.0) == [20.0, 2.0, 1.0, 10.0]  # the first one is free
    steps = [drive(speed=20.0) for _ in range(8)]
    assert [step[0] for step in steps] == [25, 30, 35, 40, 40, 40, 40, 40]
    assert [step[1] for step in steps] == [4, 6, 8, 10, 12, 12, 12, 12]
    assert np.log10([step[3] for step in steps]) == pytest.approx([1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.0, 4.0])
    back = [drive(speed=0.0) for _ in range(2)]
    assert [step[:2] for step in back] == [[35.0, 10.0], [30.0, 8.0]]
    assert drive.counts()["rate_limited"] == 5 + 2
    assert drive.counts()["fallback"] == 0


def test_it_is_the_ratio_of_the_weights_that_a_guard_limits():
    weights = {"Q": line(0.0, 20.0, 1.0, 100.0), "R": line(0.0, 20.0, 5.0, 500.0)}
    drive = Drive(at.Guarded(speedy(Np=30.0, **weights), FALLBACK, rates=(5, 2, 0.01)))
    drive(speed=0.0)
    assert drive(speed=20.0) == [30.0, 5.0, 100.0, pytest.approx(500.0)]  # R/Q is the same
    assert drive.counts()["rate_limited"] == 0


def test_far_outside_the_domain_the_fallback_is_used_for_some_steps():
    drive = Drive(at.Guarded(speedy(), FALLBACK, slack=0.25, hold=4, rates=(100, 100, 10.0)))
    assert drive(speed=24.9)[0] == 40.0  # a quarter of 20 m/s beyond the edge is still trusted, clipped
    assert drive(speed=25.1) == FALLBACK.as_array().tolist()
    assert [drive(speed=10.0)[3] for _ in range(5)] == [100.0] * 5
    assert drive.counts() == {
        "steps": 7, "clipped": 2, "broken": 0, "rate_limited": 0, "outside": 1, "off_reference": 0, "unstable": 0,
        "fallback": 4,
    }  # fmt: skip


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_an_offset_that_the_grip_cannot_take_back_in_time_calls_for_the_fallback(side):
    drive = Drive(at.Guarded(speedy(), FALLBACK, offset_limit=0.06, hold=2, rates=(100, 100, 10.0)))
    limit = 0.06 * 0.5 * GRAVITY  # m, on a friction of 0.5
    used = [
        drive(speed=10.0, friction=0.5, offset=side * share * limit)[0] == FALLBACK.Np
        for share in (0.0, 0.99, 1.01, 0.5, 0.5)
    ]
    assert used == [False, False, True, True, False]  # for two steps
    assert drive(speed=10.0, friction=0.6, offset=side * 1.1 * limit)[0] != FALLBACK.Np  # more grip, more leeway
    assert drive(speed=10.0, friction=0.5, offset=math.nan)[0] == FALLBACK.Np
    assert drive.counts()["off_reference"] == 2


def test_a_guard_interpolates_the_stability_map():
    slow_only = stability_map(lambda speed, *_: 1.35 if speed > 15.0 else 0.9)  # 0.99 at 12 m/s
    drive = Drive(at.Guarded(speedy(), FALLBACK, stability=slow_only, hold=1, rates=(100, 100, 10.0)))
    assert drive(speed=11.9)[0] == 32.0
    assert drive(speed=12.1)[0] == FALLBACK.Np  # no tuning is far enough there: all the way
    assert drive.counts()["unstable"] == 1
    assert drive.counts()["fallback"] == 1


def test_a_tuning_too_near_instability_gives_way_only_as_far_as_it_must():
    long_ones = stability_map(lambda speed, friction, Np, *_: 1.5 if Np > 30 else 0.9)  # 0.99 at Np = 34.5
    drive = Drive(at.Guarded(speedy(Np=60.0), at.Tuning(20, 5, 1.0, 0.1), stability=long_ones, rates=(100, 100, 10.0)))
    assert drive(speed=10.0)[0] == 28.0  # 60, 52, 44, 36, 28: four of the five stages to 20
    assert drive.counts()["unstable"] == 1
    assert drive.counts()["fallback"] == 0


@pytest.mark.parametrize(("value", "condition", "functions"), [
    (lambda speed, *_: speed >= 20, {"speed": 19.0}, {}),
    (lambda speed, friction, *_: friction < 0.5, {"friction": 0.4}, {}),
    (lambda speed, friction, Np, *_: Np >= 60, {}, {"Np": 59.0}),
    (lambda speed, friction, Np, Nc, ratio: Nc >= 20, {}, {"Nc": 19.0}),
    (lambda speed, friction, Np, Nc, ratio: ratio >= 3, {}, {"R": 1e3}),
    (lambda speed, friction, Np, Nc, ratio: ratio >= 3, {}, {"Q": 1e-2, "R": 10.0}),
], ids=["speed", "friction", "Np", "Nc", "R", "ratio"])  # fmt: skip
def test_every_axis_of_the_stability_map_is_looked_at(value, condition, functions):
    where = stability_map(lambda *node: 1.3 if value(*node) else 0.5)
    plain = {"Np": 20.0, "Nc": 5.0, "Q": 1.0, "R": 0.1, **functions}
    drive = Drive(at.Guarded(speedy(**plain), FALLBACK, stability=where))
    drive(**condition)
    assert drive.counts()["unstable"] == 1
    calm = Drive(at.Guarded(speedy(**plain), FALLBACK, stability=stability_map(lambda *_: 0.5)))
    assert calm(**condition) == [plain[entry] for entry in ENTRIES]


def test_a_limited_tuning_that_would_be_unstable_on_its_way_gives_way_too():
    axes = ([0.0, 20.0], [0.3, 0.9], [10.0, 14.0, 20.0, 40.0, 46.0, 60.0], [1.0, 20.0], [-3.0, 3.0])
    radius = np.full([len(axis) for axis in axes], 0.5)
    radius[:, :, 2:4] = 2.0  # Np from 20 to 40
    between = StabilityMap(Table(axes, radius))
    schedule = at.Guarded(
        speedy(Np=line(0.0, 20.0, 12.0, 55.0)), at.Tuning(11, 5, 1.0, 100.0), stability=between, rates=(5, 2, 1.0)
    )
    drive = Drive(schedule)
    assert drive(speed=0.0)[0] == 12.0
    assert 11.0 <= drive(speed=20.0)[0] <= 15.0  # 55 is sound, but 17, as far as it may go, is not
    assert drive.counts()["unstable"] == 1


CONDITIONS = st.lists(
    st.tuples(*[st.floats(-50, 50) | st.sampled_from([math.nan, math.inf, -math.inf, 1e300])] * 4),
    min_size=1,
    max_size=30,
)


@given(conditions=CONDITIONS, seed=st.integers(0, 2**32 - 1), guarded=st.booleans())
def test_whatever_comes_in_what_goes_out_can_be_used(conditions, seed, guarded):
    rng = np.random.default_rng(seed)
    kinds = [random_network(rng, 4), random_sugeno(rng, 4), random_table(rng, 4, "nearest"), 5.0]
    functions = {entry: kinds[i] for entry, i in zip(ENTRIES, rng.integers(0, 4, 4), strict=True)}
    bounds = {"Np": (1, 60), "Nc": (1, 20), "Q": (0.1, 10.0), "R": (0.01, 100.0)}
    schedule = at.Learned(functions, ("speed", "y_ref", "friction", "wind"), [[-10.0, 10.0]] * 4, bounds)
    if guarded:
        schedule = at.Guarded(schedule, FALLBACK, stability=stability_map(lambda *_: rng.uniform(0.9, 1.0)))
    drive = Drive(schedule)
    before = None
    for values in conditions:
        Np, Nc, Q, R = drive(**dict(zip(schedule.inputs, values, strict=True)))
        assert 1 <= Nc <= Np <= 60
        assert Np == int(Np)
        assert Nc == int(Nc)
        assert 0.1 <= Q <= 10.0
        assert 0.0 < R < math.inf
        fallback = (Np, Nc, Q, R) == (FALLBACK.Np, FALLBACK.Nc, FALLBACK.Q, FALLBACK.R)
        if guarded and before is not None and not fallback:
            assert abs(Np - before[0]) <= 5
            assert abs(math.log10(R / Q) - before[1]) <= 0.3 + 1e-9
        if np.isfinite(values).all():
            before = Np, math.log10(R / Q)
    counts = drive.counts()
    assert counts["steps"] == len(conditions)
    assert counts["broken"] == sum(not np.isfinite(values).all() for values in conditions)
