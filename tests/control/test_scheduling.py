"""Schedulers: every number reaches its own entry, every file is whole or refused, every driver is told the same."""

import dataclasses
import itertools
import json
import math
import re

import numpy as np
import pytest
from tests.drive.test_simulate import same

from adaptrack.base.errors import ContractError, InvalidInput, StorageError
from adaptrack.cars.plant import DualTrack, SingleTrack
from adaptrack.cars.vehicle import load_vehicle
from adaptrack.control.controllers import CompiledScheduler, Scheduler, Tuning, published_mpc
from adaptrack.control.scheduling import (
    ENTRIES,
    Constant,
    Entry,
    Guarded,
    Learned,
    Lookup,
    Network,
    Number,
    Schedule,
    SchedulingVariables,
    StabilityMap,
    Sugeno,
    Table,
    check_scheduler,
    list_schedulers,
    load_scheduler,
    made_for,
)
from adaptrack.control.scheduling.functions import ANY
from adaptrack.core.scheduling import guard
from adaptrack.drive.batch import rollout_batch
from adaptrack.drive.simulate import rollout, simulate
from adaptrack.scenario import Scenario, load_scenario
from small_models import line, random_network, random_sugeno, stability_map

# The counted noise multiplies integers that wrap around, of which the interpreter warns; compiled code is silent.
pytestmark = pytest.mark.filterwarnings("ignore:overflow encountered in scalar:RuntimeWarning")

CAR = load_vehicle("paper")
PAPER_INPUTS = ("speed", "y_ref", "friction", "wind")
PAPER_DOMAIN = np.array([[3.0, 27.0], [-15.0, 15.0], [0.5, 0.9], [-30.0, 30.0]])
BOUNDS = {"Np": (21, 60), "Nc": (1, 20), "Q": (0.1, 10.0), "R": (1.0, 1e4)}
FALLBACK = Tuning(30, 6, 1.0, 3000.0)
HERE = SchedulingVariables(speed=14.0, y_ref=2.0, friction=0.7, wind=-4.0)


def stretched(function, low, high):
    """A network or a fuzzy system over the paper's domain, its output from `low` to `high`."""
    span = PAPER_DOMAIN[:, 1] - PAPER_DOMAIN[:, 0]
    if isinstance(function, Network):
        function = dataclasses.replace(function, low=PAPER_DOMAIN[:, 0], high=PAPER_DOMAIN[:, 1], relu=False)
        inside = PAPER_DOMAIN[:, 0] + span * np.random.default_rng(0).uniform(size=(500, 4))
        least, most = (
            edge(dataclasses.replace(function, out_low=0.0, out_high=1.0).predict(inside)) for edge in (min, max)
        )
        biases = (*function.biases[:-1], function.biases[-1] - least)
        return dataclasses.replace(
            function, biases=biases, relu=True, out_low=low, out_high=low + (high - low) / (most - least)
        )
    premises = function.premises.copy()
    premises[:, 0] *= span[function.owner]
    premises[:, 2] = PAPER_DOMAIN[function.owner, 0] + span[function.owner] * premises[:, 2]
    consequents = function.consequents / np.append(span, 1.0) * 0.02 * (high - low)
    consequents[:, -1] += 0.5 * (low + high)
    return dataclasses.replace(function, premises=premises, consequents=consequents)


def learned(kind, rng):
    """Four networks or four fuzzy systems of the paper's inputs."""
    make = {"network": random_network, "sugeno": random_sugeno}[kind]
    functions = {entry: stretched(make(rng, 4), *BOUNDS[entry]) for entry in ENTRIES}
    return Learned(functions, PAPER_INPUTS, PAPER_DOMAIN, BOUNDS, name=kind, provenance={"seed": 1, "of": ["π", None]})


def lookup(method, rng, axes=None):
    axes = axes or {"speed": [5.0, 12.0, 25.0], "friction": [0.5, 0.8], "change": [0.0, 2.0, 5.0, 9.0]}
    shape = tuple(map(len, axes.values()))
    horizons = [rng.integers(21, 60, shape), rng.integers(1, 20, shape)]
    weights = [rng.uniform(0.5, 2.0, shape), 10 ** rng.uniform(1.0, 4.0, shape)]
    return Lookup(axes, np.stack(horizons + weights, axis=-1), method)


def guarded(rng):
    radius = stability_map(lambda speed, friction, Np, Nc, ratio: 1.0 if speed > 15 and ratio < 0 else 0.9)
    return Guarded(learned("network", rng), FALLBACK, stability=radius, hold=7, offset_limit=0.1)


def flat(rng):
    """Fuzzy systems without a premise, and a number."""
    plane = Sugeno(
        np.zeros(0, np.intp), np.zeros(0, bool), np.zeros((0, 3)), np.array([[ANY]]), np.array([[0.5, 9.0]]), np.ones(1)
    )
    return Learned({"Np": plane, "Nc": plane, "log10_ratio": 2.0}, ("speed",), [[0.0, 30.0]])


KINDS = {
    "constant": lambda rng: Constant(Tuning(31, 7, 2.5, 0.1)), "nearest": lambda rng: lookup("nearest", rng),
    "multilinear": lambda rng: lookup("multilinear", rng), "network": lambda rng: learned("network", rng),
    "sugeno": lambda rng: learned("sugeno", rng), "guarded": guarded, "flat": flat,
}  # fmt: skip
every_kind = pytest.mark.parametrize("kind", KINDS)


def variables(rng, count=50):
    """Scheduling variables inside the domain and around it."""
    low = np.array([0.0, -20.0, 0.3, -40.0, 0.0, 0.0, -3.0])
    high = np.array([35.0, 20.0, 1.0, 40.0, 12.0, 6.0, 3.0])
    return rng.uniform(low, high, (count, 7))


# -- entries ----------------------------------------------------------------------------------------------------------
def shift(function):
    """The same function, a little higher."""
    if isinstance(function, Network):
        biases = (*function.biases[:-1], function.biases[-1] + 0.2)
        return dataclasses.replace(function, biases=biases, relu=False)
    if isinstance(function, Sugeno):
        return dataclasses.replace(function, consequents=function.consequents * 1.2)
    return dataclasses.replace(function, values=function.values + 0.3)


@pytest.mark.parametrize("entry", ENTRIES)
@pytest.mark.parametrize("kind", ["network", "sugeno", "multilinear"])
def test_a_function_moves_the_number_of_its_own_entry_and_no_other(kind, entry, rng):
    schedule = KINDS[kind](rng)
    tuning = dict(schedule.tuning)
    tuning[entry] = dataclasses.replace(tuning[entry], function=shift(tuning[entry].function))
    rows = variables(rng, 200)
    moved = schedule.batch(rows) != dataclasses.replace(schedule, tuning=tuning).batch(rows)
    assert moved.any(axis=0).tolist() == [name == entry for name in ENTRIES]


@every_kind
def test_every_kind_keeps_the_contract(kind, rng):
    schedule = KINDS[kind](rng)
    assert isinstance(schedule, Scheduler)
    assert isinstance(schedule, CompiledScheduler)
    check_scheduler(schedule)


@every_kind
def test_one_row_is_answered_as_in_a_batch(kind, rng):
    schedule, rows = KINDS[kind](rng), variables(rng)
    assert np.array_equal(schedule.batch(rows), [schedule(SchedulingVariables(*row)) for row in rows])
    assert np.array_equal(schedule.batch(rows[:, :4]), schedule.batch(np.where(np.arange(7) < 4, rows, 0.0)))


@pytest.mark.parametrize(("first", "second"), list(itertools.combinations(ENTRIES, 2)))
@pytest.mark.parametrize("kind", ["network", "multilinear"])
def test_the_checker_finds_every_crossed_pair_of_wires(kind, first, second, rng):
    class Crossed(Schedule):
        """Says one thing and packs another."""

        def plan(self, slots):
            tuning, wires = self.tuning, dict(self.tuning)
            for entry, other in ((first, second), (second, first)):
                wires[entry] = dataclasses.replace(tuning[entry], function=tuning[other].function)
            return Schedule(self.inputs, self.domain, wires).plan(slots)

    honest = KINDS[kind](rng)
    with pytest.raises(ContractError, match="its own function gives"):
        check_scheduler(Crossed(honest.inputs, honest.domain, honest.tuning))


def test_the_checker_finds_a_scheduler_that_tells_python_and_kernels_different_things(rng):
    class Forked(Schedule):
        """Swaps the weights when called."""

        def __call__(self, condition):
            Np, Nc, Q, R = super().__call__(condition)
            return Np, Nc, R, Q

    honest = lookup("multilinear", rng)
    with pytest.raises(ContractError, match="compiled"):
        check_scheduler(Forked(honest.inputs, honest.domain, honest.tuning))


# -- kinds ------------------------------------------------------------------------------------------------------------
def test_a_constant_gives_its_tuning_everywhere(rng):
    schedule = Constant(Tuning(31, 7, 2.5, 0.1))
    assert np.array_equal(schedule.batch(variables(rng)), np.tile([31, 7, 2.5, 0.1], (50, 1)))
    assert schedule.largest == (31, 7)


@pytest.mark.parametrize("method", ["nearest", "multilinear"])
def test_a_look_up_gives_at_its_nodes_what_was_put_there(method, rng):
    axes = {"speed": [5.0, 12.0, 25.0], "wind": [-10.0, 3.0]}
    tunings = np.stack([
        rng.integers(21, 60, (3, 2)), rng.integers(1, 20, (3, 2)), rng.uniform(0, 9, (3, 2)), rng.uniform(0, 9, (3, 2))
    ], axis=-1)  # fmt: skip
    schedule = Lookup(axes, tunings, method)
    for (i, speed), (j, wind) in itertools.product(enumerate(axes["speed"]), enumerate(axes["wind"])):
        answer = schedule(SchedulingVariables(speed, 0.0, 0.8, wind))
        assert answer[:2] == tuple(tunings[i, j, :2])
        assert answer[2:] == pytest.approx(tunings[i, j, 2:], rel=0.0 if method == "nearest" else 1e-14)


def test_between_nodes_a_look_up_takes_the_mean_of_horizons_and_of_the_logarithms_of_weights():
    schedule = Lookup({"friction": [0.4, 0.8]}, [[20, 4, 1.0, 10.0], [30, 8, 4.0, 1000.0]])
    assert schedule(SchedulingVariables(10.0, 0.0, 0.6, 0.0)) == (25.0, 6.0, pytest.approx(2.0), pytest.approx(100.0))
    assert schedule(SchedulingVariables(10.0, 0.0, 0.2, 0.0))[:2] == (20.0, 4.0)
    assert schedule(SchedulingVariables(10.0, 0.0, 0.9, 0.0))[:2] == (30.0, 8.0)


GOOD = {"Np": 30.0, "Nc": 5.0, "Q": 1.0, "R": 1.0}


def make_schedule(inputs=("speed",), domain=((0.0, 30.0),), bounds=None, **functions):
    return Learned({**GOOD, **functions}, inputs, domain, bounds)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: make_schedule(("sped",)), "'sped'. Did you mean 'speed'"),
        (lambda: make_schedule(()), "one or more different"),
        (lambda: make_schedule(domain=[[0.0, math.nan]]), "domain"),
        (lambda: make_schedule(domain=[[0.0, 1.0]] * 2), "domain"),
        (lambda: Learned({"Np": 3.0, "Nc": 1.0, "Q": 1.0}, ("speed",), [[0, 1]]), "there must be Np, Nc, Q, R"),
        (lambda: make_schedule(r=1.0), "unknown entry 'r'"),
        (lambda: make_schedule(bounds={"NP": (1, 2)}), "unknown entry 'NP'"),
        (lambda: make_schedule(log10_ratio=1.0), "either R or log10_ratio"),
        (lambda: Learned({"Np": 3.0, "Nc": 1.0, "Q": 2.0, "log10_ratio": 0.0}, ("speed",), [[0, 1]]), "Q must be 1"),
        (lambda: make_schedule(Q=math.nan), "Q = nan: must be finite"),
        (lambda: make_schedule(R=None), "must be a number"),
        (lambda: make_schedule(("speed", "wind"), [[0, 1]] * 2, Np=line(0.0, 1.0, 2.0, 3.0)), "has 1 inputs"),
        (lambda: make_schedule(Np=random_network(np.random.default_rng(0), 3)), "has 3 inputs, the schedule 1"),
        (lambda: make_schedule(bounds={"Np": (0, 20)}), "bounds of Np"),
        (lambda: make_schedule(bounds={"Nc": (4, 3)}), "bounds of Nc"),
        (lambda: make_schedule(bounds={"R": (0.0, 1.0)}), "bounds of R"),
        (lambda: make_schedule(bounds={"Q": (math.nan, 1.0)}), "bounds of Q"),
        (lambda: make_schedule(bounds={"Np": (1, 2000)}), "up to 2000 steps"),
        (lambda: dataclasses.replace(make_schedule(), name=None), "name must be text"),
        (lambda: make_schedule().batch(np.zeros((2, 8))), "need a row for each"),
        (lambda: Lookup({"speed": [1, 2]}, np.ones((2, 3))), r"shape \(2, 4\)"),
        (lambda: Lookup({"speed": [2, 1]}, np.ones((2, 4))), "ascend"),
        (lambda: Lookup({"speed": [1, 2]}, np.zeros((2, 4))), "positive"),
        (lambda: Lookup({"speed": [1, 2]}, np.full((2, 4), math.nan)), "finite"),
        (lambda: Lookup({"sped": [1, 2]}, np.ones((2, 4))), "'sped'. Did you mean 'speed'"),
        (lambda: Lookup({"speed": [1, 2]}, np.ones((2, 4)), "cubic"), "one of 'nearest', 'multilinear'"),
        (lambda: Table(([1.0, 2.0],), np.array([1.0, math.nan])), "finite values"),
        (lambda: Table((), np.float64(1.0)), "finite values"),
        (lambda: Guarded(lambda condition: FALLBACK, FALLBACK), "must be a Schedule"),
        (lambda: Guarded(make_schedule(), (30, 5, 1.0, 1.0)), "must be a Tuning"),
        (lambda: Guarded(make_schedule(), FALLBACK, rates=(5, 2)), "must be 3 values"),
        (lambda: Guarded(make_schedule(), FALLBACK, rates=(5, 2, -0.3)), "must be a finite number > 0"),
        (lambda: Guarded(make_schedule(), FALLBACK, rates=(0.4, 2, 0.3)), "whole numbers"),  # Np would never move
        (lambda: Guarded(make_schedule(), FALLBACK, slack=math.nan), "slack"),
        (lambda: Guarded(make_schedule(), FALLBACK, offset_limit=0.0), "offset_limit"),
        (lambda: Guarded(make_schedule(), FALLBACK, hold=0), "hold"),
        (lambda: StabilityMap(line(0.0, 1.0, 0.9, 0.9)), "table over speed, friction"),
        (lambda: dataclasses.replace(stability_map(lambda *_: 0.5), limit=math.nan), "limit"),
        (lambda: Guarded(pursuit(), FALLBACK), "only the MPC's entries can be guarded"),
        (lambda: dataclasses.replace(pursuit(), entries=ENTRIES), "there must be Np, Nc, Q, R"),
        (lambda: dataclasses.replace(pursuit(), entries=()), "1 to 8 different names"),
        (lambda: dataclasses.replace(pursuit(), entries=("lookahead", "lookahead")), "1 to 8 different names"),
        (lambda: dataclasses.replace(pursuit(), entries=tuple("abcdefghi")), "1 to 8 different names"),
        (lambda: dataclasses.replace(pursuit(), made_for="the paper's car"), "made_for mappings"),
    ],
)  # fmt: skip
def test_what_makes_no_schedule_is_refused_with_a_reason(build, message):
    with pytest.raises(InvalidInput, match=message):
        build()


# -- other controllers ------------------------------------------------------------------------------------------------
def pursuit(**options):
    """A schedule for a controller that has one entry, a look-ahead distance."""
    entry = Entry(line(0.0, 30.0, 2.5, 20.0), 3.0, 15.0)
    return Schedule(("speed",), [[0.0, 30.0]], {"lookahead": entry}, entries=("lookahead",), **options)


def test_a_schedule_tunes_a_controller_with_other_entries(tmp_path):
    schedule = pursuit()
    check_scheduler(schedule)
    assert not schedule.tunes_mpc
    rows = np.zeros((3, 7))
    rows[:, 0] = 0.0, 12.3, 30.0
    assert schedule.batch(rows).tolist() == [[3.0], [pytest.approx(2.5 + 17.5 * 12.3 / 30.0)], [15.0]]  # not rounded
    schedule.save(tmp_path / "one.json")
    again = load_scheduler(tmp_path / "one.json")
    assert again.entries == ("lookahead",)
    assert np.array_equal(again.batch(rows), schedule.batch(rows))


def test_entries_of_another_controller_keep_their_order_and_may_be_negative(rng):
    names = ("gain", "R", "Np")
    tuning = {name: Entry(-1.5 - i, -10.0, 10.0) for i, name in enumerate(names)}
    schedule = Schedule(("wind",), [[-5.0, 5.0]], dict(reversed(tuning.items())), entries=names)
    assert schedule(HERE) == (-1.5, -2.5, -3.5)
    assert schedule.largest == (0, 0)


# -- what a schedule is asked -----------------------------------------------------------------------------------------
def test_a_short_row_of_variables_is_filled_with_zeros_never_with_what_was_asked_before():
    schedule = Learned({"Np": line(0.0, 10.0, 20.0, 40.0), "Nc": 5, "Q": 1.0, "R": 1.0}, ("change",), [[0.0, 10.0]])
    assert schedule(HERE._replace(change=10.0))[0] == 40.0
    assert schedule([14.0, 2.0, 0.7, -4.0])[0] == 20.0
    for missing in ([], [14.0], [14.0, 2.0, 0.7]):
        with pytest.raises(InvalidInput, match="need 7 numbers"):
            schedule(missing)
        with pytest.raises(InvalidInput, match="need a row for each"):
            schedule.batch([missing])
    with pytest.raises(InvalidInput, match="must be real numbers"):
        schedule.batch([["fast", 0.0, 0.8, 0.0]])


# -- what a schedule was made for -------------------------------------------------------------------------------------
def test_a_file_names_what_the_schedule_was_made_for(tmp_path):
    expected = made_for(published_mpc(CAR, period=0.05, preview=True), "road")
    assert expected["car"] == "paper"
    assert expected["profile"] == "road"
    assert expected["controller"] == {
        "kind": "MPC", "model": "incremental", "moves": {"kind": "pulse"}, "period": 0.05, "preview": True,
    }  # fmt: skip
    assert re.fullmatch("[0-9a-f]{16}", expected["kernels"])
    dataclasses.replace(Constant(Tuning()), made_for=expected).save(tmp_path / "one.json")
    assert load_scheduler(tmp_path / "one.json").made_for == expected


# -- the contract -----------------------------------------------------------------------------------------------------
def test_a_plain_function_that_keeps_the_contract_is_admitted():
    check_scheduler(lambda condition: (20 + min(max(condition.speed, 0.0), 30.0), 5, 1.0, 10.0))
    check_scheduler(lambda condition: Tuning(30, 5, 1.0, 10.0))


class Moody:
    """Never says the same twice."""

    def __init__(self):
        self.asked = 0

    def __call__(self, condition):
        self.asked += 1
        return 30, 5, 1.0, float(self.asked)


def fails(condition):
    raise ZeroDivisionError("no friction")


@pytest.mark.parametrize(("scheduler", "message"), [
    (Tuning(), "must be callable"),
    (lambda condition: (30, 5, 1.0), "numbers Np, Nc, Q, R"),
    (lambda condition: (30, 5, math.nan, 1.0), "must be finite"),
    (lambda condition: (5, 6, 1.0, 1.0), "need 1 <= Nc <= Np"),
    (lambda condition: (30, 0, 1.0, 1.0), "need 1 <= Nc <= Np"),
    (lambda condition: (30, 5, -1.0, 1.0), "Q >= 0"),
    (lambda condition: (30, 5, 1.0, 0.0), "R > 0"),
    (Moody(), "the same for the same variables"),
    (fails, "no friction"),
    (lambda condition: (30, 5, 1.0, 27.5 - condition.speed), "R > 0"),  # sound in the domain, but not beyond
    (lambda condition: (30, 5, 1.0, math.sqrt(condition.friction)), "failed for"),
])  # fmt: skip
def test_what_breaks_the_contract_is_refused_with_the_evidence(scheduler, message):
    with pytest.raises(ContractError, match=message):
        check_scheduler(scheduler)


# -- files ------------------------------------------------------------------------------------------------------------


@every_kind
def test_a_schedule_reads_back_to_the_last_bit(kind, rng, tmp_path):
    schedule, rows = KINDS[kind](rng), variables(rng, 200)
    schedule.save(tmp_path / "one.json")
    again = load_scheduler(tmp_path / "one.json")
    assert np.array_equal(again.batch(rows), schedule.batch(rows))
    for ours, theirs in zip(again.plan(1), schedule.plan(1), strict=True):
        assert ours.tobytes() == theirs.tobytes()
    for field in ("inputs", "provenance", "made_for", "entries"):
        assert getattr(again, field) == getattr(schedule, field)
    (tmp_path / "copy").mkdir()
    again.save(tmp_path / "copy" / "one.json")
    assert (tmp_path / "one.json").read_bytes() == (tmp_path / "copy" / "one.json").read_bytes()


@every_kind
def test_a_flipped_bit_is_found_wherever_it_lies(kind, rng, tmp_path):
    path = tmp_path / "one.json"
    KINDS[kind](rng).save(path)
    sound = path.read_bytes()
    content = json.loads(sound)["content"]
    places = {0, len(sound) - 2, *rng.integers(0, len(sound) - 1, 150).tolist()}
    harmless = 0
    for place in places:
        damaged = bytearray(sound)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            load_scheduler(path)
        except StorageError:
            continue
        harmless += 1  # it hit what means nothing, like the e of 1e-05
        assert json.loads(bytes(damaged))["content"] == content
    assert harmless < 0.05 * len(places)


@pytest.mark.parametrize(("text", "message"), [
    ("", "not a scheduler file, or damaged"),
    ("Np = 35", "not a scheduler file, or damaged"),
    ("[" * 100_000, "not a scheduler file, or damaged"),
    ("9" * 5000, "not a scheduler file, or damaged"),
    ("[]", "its format is not"),
    ("35", "its format is not"),
    ('{"type": "FeatureCollection", "features": []}', "its format is not"),
    ('{"format": "adaptrack-scheduler"}', "version None"),
    ('{"format": "adaptrack-scheduler", "version": 1}', "version 1 of the scheduler format; this program reads 2"),
    ('{"format": "adaptrack-scheduler", "version": 2}', "checksum"),
    ('{"format": "adaptrack-scheduler", "version": 2, "sha256": 3, "content": {}}', "checksum"),
], ids=range(11))  # fmt: skip
def test_a_file_that_is_no_scheduler_is_refused_with_a_reason(text, message, tmp_path):
    (tmp_path / "one.json").write_text(text)
    with pytest.raises(StorageError, match=message):
        load_scheduler(tmp_path / "one.json")


def test_every_scheduler_that_ships_keeps_the_contract():
    for name in list_schedulers():
        check_scheduler(load_scheduler(name))


# -- driving ----------------------------------------------------------------------------------------------------------
LANE_CHANGE = load_scenario("lane-change", duration=1.5, start=0.2, change_time=2.0, gust_start=0.3, gust_duration=1.0)
LONG = load_scenario("lane-change", duration=6.0, speed=15.0, amplitude=2.0)


def sober(kind, rng):
    """A schedule that keeps the car on a road."""
    schedule = KINDS[kind](rng)
    bounds = {"Np": (20.0, 45.0), "Nc": (2.0, 10.0), "Q": (0.8, 1.2), "R": (1e3, 1e4)}
    tunings = {}
    for name, entry in schedule.tuning.items():
        low, high = bounds[name]
        function = 0.5 * (low + high) if isinstance(entry.function, Number) else entry.function
        tunings[name] = dataclasses.replace(entry, function=function, low=low, high=high)
    return dataclasses.replace(schedule, tuning=tunings)


def make_mpc(kind, rng, **options):
    """An MPC that preview and a schedule steer through the road profile."""
    return published_mpc(CAR, FALLBACK, period=0.05, preview=True, scheduler=sober(kind, rng), **options)


@pytest.mark.compiled
@every_kind
def test_alone_and_in_a_batch_a_scheduler_drives_to_the_same_bits_and_counts(kind, rng):
    mpc, plant = make_mpc(kind, rng), DualTrack(CAR, "magic-formula")
    ours = simulate(plant, mpc, LONG, profile="road", seed=5)
    counts = mpc.scheduler_counts
    assert same(ours, rollout(plant, mpc, LONG, profile="road", seed=5))
    batch = rollout_batch(plant, mpc, LONG, scenario_indices=[0] * 20, seeds=[5] * 20, profile="road", threads=2)
    error = ours.Y - ours.y_ref
    assert not any(batch.failed)
    assert set(batch.max_abs_error) == {np.abs(error).max()}
    assert batch.mse == pytest.approx(np.mean(error**2), rel=1e-12)
    assert len(set(batch.mse)) == 1
    assert {name: set(values) for name, values in batch.scheduler.items()} == {
        name: {count} for name, count in counts.items()
    }


def test_the_counts_are_those_of_the_run_since_the_last_reset(rng):
    mpc = make_mpc("guarded", rng)
    assert mpc.scheduler_counts == dict.fromkeys(guard.COUNTS, 0)
    simulate(SingleTrack(CAR), mpc, LANE_CHANGE, profile="road")
    first = mpc.scheduler_counts
    assert first["steps"] == 30
    simulate(SingleTrack(CAR), mpc, LANE_CHANGE, profile="road")
    assert mpc.scheduler_counts == first
    mpc.step(np.zeros(4), 15.0, [0.0], HERE._replace(wind=99.0))
    assert mpc.scheduler_counts["steps"] == 31
    assert mpc.scheduler_counts["outside"] == first["outside"] + 1
    mpc.reset()
    assert not any(mpc.scheduler_counts.values())
    assert published_mpc(CAR).scheduler_counts == {}
    assert published_mpc(CAR, scheduler=lambda variables: FALLBACK).scheduler_counts == {"raised": 0}


def test_an_mpc_refuses_a_schedule_for_another_controller():
    with pytest.raises(InvalidInput, match="gives lookahead; an MPC needs Np, Nc, Q, R"):
        published_mpc(CAR, scheduler=pursuit())


# -- horizons change without a bump -----------------------------------------------------------------------------------


@pytest.mark.compiled
def test_on_a_straight_road_in_steady_wind_a_change_of_horizons_moves_nothing():
    """The angle that holds the car against the wind is kept, whatever the horizons that found it."""
    road = Scenario(name="road", duration=40.0, reference=0.0, speed=20.0, friction=0.9, wind=12.0)
    horizons = itertools.cycle([(20, 3), (45, 12), (30, 1), (60, 18)])
    steps = itertools.count()

    def switching(variables):
        return (30, 6, 1.0, 50.0) if next(steps) < 300 else (*next(horizons), 1.0, 50.0)

    run = simulate(DualTrack(CAR), published_mpc(CAR, scheduler=switching), road)
    assert set(run.tuning["Np"][300:]) == {20, 45, 30, 60}
    assert abs(run.command[299]) > 1e-3
    assert np.abs(run.command_change[300:]).max() < 1e-9
    assert np.abs(run.command[300:] - run.command[299]).max() < 1e-8
