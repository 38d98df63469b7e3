"""The chain: what a configuration may say, what every stage leaves, where it goes on, and what is never mixed up."""

from __future__ import annotations

import itertools
import shutil
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from adaptrack.closed_loop import BOUNDS
from adaptrack.errors import ConfigError, InvalidInput, StorageError, UnknownName
from adaptrack.evaluate.ladder import CHOICE_SEEDS, EVALUATION_SEEDS, SEARCH_SEEDS
from adaptrack.metrics import PUBLISHED
from adaptrack.mpc import Tuning
from adaptrack.scheduling import ENTRIES, Constant, Lookup, SchedulingVariables, check_scheduler, load_scheduler
from adaptrack.tuning.config import load_campaign
from adaptrack.vehicle import GRAVITY
from small_chain import RUNGS, adapting, learned, short_cuts, write

WORK = ("run_campaign", "best_constant", "improve", "neighbour_lookup", "train", "loop_map")
"""Everything in the chain that takes long."""


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    return learned(tmp_path_factory.getbasetemp() / "chain")


@pytest.fixture
def copy(chain, tmp_path):
    """A folder like the chain's own, to be changed."""
    return shutil.copytree(chain.folder, tmp_path / "copy")


@pytest.fixture
def quick():
    with short_cuts() as patch:
        yield patch


def shop_of(folder, pond=None, **changes):
    return adapting.Workshop.of(adapting.load_adaptation(write(folder, pond, **changes)))


def forbid(patch, *names):
    """Whoever does this work fails."""
    for name in names:
        patch.setattr(adapting, name, lambda *given, name=name, **more: pytest.fail(f"{name} was called"))


def file_of(folder, rung):
    return folder / "schedulers" / f"tiny-{rung.replace(' ', '-')}.json"


def contents(folder):
    return {path.name: path.read_bytes() for path in (folder / "schedulers").iterdir()}


def conditions_around(rng, count=400):
    """Inside the operating domain, far outside it, and at its corners."""
    low, high = np.array([3.0, -7.0, 0.3, -30.0, 0.0, 0.0, -2.0]), np.array([30.0, 7.0, 1.0, 30.0, 12.0, 3.5, 2.0])
    rows = low + (high - low) * rng.uniform(size=(count, len(low)))
    rows[::3] += rng.normal(size=rows[::3].shape) * (high - low)
    rows[::5] = np.where(rng.uniform(size=rows[::5].shape) < 0.5, low, high)
    return rows


def near(known, rows):
    """What a stability map says at rows of speed, friction, Np, Nc, log10 R/Q."""
    axes = known.table.axes
    inside = np.clip(rows, [axis[0] for axis in axes], [axis[-1] for axis in axes])
    return RegularGridInterpolator(axes, known.table.values)(inside)


# -- the configuration ------------------------------------------------------------------------------------------------
def test_the_configuration_that_ships_is_the_road_one():
    config = adapting.load_adaptation("road")
    campaign = load_campaign(config.campaign)
    assert (config.name, campaign.name, campaign.profile) == ("road", "road-sobol", "road")
    assert set(campaign.conditions.box.model_dump()) >= {"speed", "friction"}
    assert adapting.list_adaptations()["road"] == config.description != ""
    assert adapting.Workshop.of(config).box["speed"] == campaign.conditions.box.speed


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"campain": "road-sobol"}, ["campain", "Did you mean 'campaign'"]),
        ({"campaign": None}, ["campaign: missing"]),
        ({"campaign": 3}, ["campaign = 3", "must be text"]),
        ({"name": "a/b"}, ["name", "a/b"]),
        ({"seed": -1}, ["seed = -1"]),
        ({"seed": "1"}, ["seed = '1'"]),
        ({"learning": {"round": 3}}, ["learning.round", "Did you mean 'rounds'"]),
        ({"learning": {"rounds": 0}}, ["learning.rounds = 0"]),
        ({"learning": {"conditions": 15}}, ["learning.conditions = 15"]),
        ({"learning": {"rules": 1}}, ["learning.rules = 1"]),
        ({"learning": {"inputs": []}}, ["learning.inputs"]),
        ({"learning": {"inputs": ["speed", "fricton"]}}, ["'fricton'", "Did you mean 'friction'"]),
        ({"learning": {"inputs": ["speed", "velocity"]}}, ["'velocity'", "'acceleration', 'change'"]),
        ({"learning": {"inputs": ["speed", "offset"]}}, ["'offset' cannot be one"]),
        ({"learning": {"inputs": ["speed", "wind"]}}, ["domain", "'wind'", "missing"]),
        ({"learning": {"domain": {"speed": [3.0, 30.0], "friction": [1.0, 1.0]}}}, ["friction = [1, 1]", "low < high"]),
        ({"learning": {"domain": {"speed": [30.0, 3.0], "friction": [0.3, 1.0]}}}, ["speed = [30, 3]", "low < high"]),
        ({"learning": {"domain": {"speed": [3.0], "friction": [0.3, 1.0]}}}, ["learning.domain.speed"]),
        ({"evaluation": {"drive": 8}}, ["evaluation.drive", "Did you mean 'drives'"]),
        ({"evaluation": {"conditions": 0}}, ["evaluation.conditions = 0"]),
    ],
)
def test_a_mistake_in_a_configuration_gives_one_error_that_names_file_key_and_remedy(tmp_path, changes, words):
    with pytest.raises(ConfigError) as error:
        adapting.load_adaptation(write(tmp_path, **changes))
    for word in ("tiny.toml", *words):
        assert word in str(error.value)


@pytest.mark.parametrize(
    ("inputs", "domain"),
    [
        (["speed", "speed"], {"speed": [3.0, 30.0]}),
        (["friction"], {"friction": [0.3, 1.0]}),  # "speed only" needs one of speed
        (["speed"], {"speed": [3.0, 30.0], "fricton": [0.3, 1.0]}),
    ],
)
def test_inputs_that_cannot_be_learned_from_are_refused_at_the_door(tmp_path, inputs, domain):
    path = write(tmp_path, learning={"inputs": inputs, "domain": domain})
    with pytest.raises(ConfigError):
        adapting.load_adaptation(path)


def test_a_name_that_nothing_has_and_a_file_that_is_not_there_are_told_apart(tmp_path):
    with pytest.raises(UnknownName, match=r"'raod'.*Did you mean 'road'\?"):
        adapting.load_adaptation("raod")
    with pytest.raises(StorageError, match=r"raod\.toml"):
        adapting.load_adaptation(tmp_path / "raod.toml")
    (tmp_path / "broken.toml").write_text("name = \n")
    with pytest.raises(ConfigError, match=r"broken\.toml, line 1"):
        adapting.load_adaptation(tmp_path / "broken.toml")


def test_a_campaign_that_is_no_sobol_sample_is_refused(tmp_path):
    config = adapting.load_adaptation(write(tmp_path, campaign="paper-grid"))
    with pytest.raises(InvalidInput, match=r"'paper-grid'.*Sobol"):
        adapting.Workshop.of(config)


@pytest.mark.parametrize(
    ("campaign", "error", "words"),
    [("road-sobl", UnknownName, "Did you mean 'road-sobol'"), ("puddle.toml", StorageError, r"puddle\.toml")],
)
def test_a_campaign_that_is_not_there_is_told(tmp_path, campaign, error, words):
    path = write(tmp_path)
    path.write_text(path.read_text().replace("pond.toml", campaign))
    with pytest.raises(error, match=words):
        adapting.Workshop.of(adapting.load_adaptation(path))


def test_the_file_of_a_campaign_is_looked_for_beside_that_of_the_adaptation(tmp_path, monkeypatch):
    path = write(tmp_path / "mine")
    write(tmp_path / "elsewhere", {"seed": 99})
    monkeypatch.chdir(tmp_path / "elsewhere")
    for given in (path, str(path), "../mine/tiny.toml"):
        shop = adapting.Workshop.of(adapting.load_adaptation(given))
        assert (shop.config.name, shop.campaign.name, shop.campaign.seed) == ("tiny", "pond", 2)


# -- what a stage depends on ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("pond", "changes"),
    [
        ({}, {"seed": 1}),
        ({}, {"learning": {"inputs": ["friction", "speed"]}}),
        ({}, {"learning": {"domain": {"speed": [3.0, 29.0], "friction": [0.3, 1.0]}}}),
        ({}, {"learning": {"rounds": 3}}),
        ({}, {"learning": {"conditions": 17}}),
        ({}, {"learning": {"drives": 9}}),
        ({}, {"learning": {"hard_drives": 9}}),
        ({}, {"learning": {"rules": 5}}),
        ({"seed": 3}, {}),
        ({"vehicle": "midsize-sedan"}, {}),
        ({"plant": "single-track"}, {}),
        ({"tyre": "passenger-car"}, {}),
        ({"profile": "paper", "noise_seeds": [0]}, {}),
        ({"noise_seeds": [1, 2]}, {}),
        ({"swarm": {"particles": 5, "generations": 2}}, {}),
        ({"library": {"size": 4}}, {}),
    ],
)
def test_what_decides_a_stage_changes_its_identity(tmp_path, pond, changes):
    before, after = shop_of(tmp_path), shop_of(tmp_path, pond, **changes)
    for rung in ("nn", "fallback"):
        assert before.identity(rung) != after.identity(rung)


def test_how_it_is_judged_changes_no_identity_and_every_stage_has_its_own(tmp_path):
    before = shop_of(tmp_path)
    after = shop_of(tmp_path, evaluation={"conditions": 100, "drives": 50, "seed": 8})
    assert {rung: before.identity(rung) for rung in RUNGS} == {rung: after.identity(rung) for rung in RUNGS}
    assert len({before.identity(rung) for rung in RUNGS}) == len(RUNGS)


@pytest.mark.parametrize("what", ["path", "description"])
def test_the_place_of_the_files_and_what_is_said_of_them_change_no_identity(tmp_path, monkeypatch, what):
    before = shop_of(tmp_path)
    monkeypatch.chdir(tmp_path)
    given = {"path": "tiny.toml", "description": write(tmp_path, description="another sentence")}[what]
    if what == "path":
        write(tmp_path)
    assert adapting.Workshop.of(adapting.load_adaptation(given)).identity("nn") == before.identity("nn")


def recorded(shop, monkeypatch, evaluation_seed):
    """Conditions (as a set of rows) and numbers of drives that are trained on, held out and evaluated on."""
    found = SimpleNamespace(rows=set(), drives=set(), noise=set())

    def lane_changes(plant, mpc, rows, *more):
        found.rows |= set(map(tuple, np.asarray(rows).tolist()))

    def drives(plant, mpc, first, count, *more, **options):
        found.drives |= set(range(first, first + count))

    def climbed(course, rungs, seeds, *more):
        found.noise |= set(seeds)

    for name, double in (("condition_course", lane_changes), ("drive_course", drives), ("climb", climbed)):
        monkeypatch.setattr(adapting, name, double)
    monkeypatch.setattr(adapting, "optimum", lambda *given, **more: None)
    monkeypatch.setattr(adapting, "per_run_best", lambda *given: None)
    parts = {}
    constants = {rung: Constant(Tuning()) for rung in ("best constant", "best constant on drives")}
    for part, use in (
        ("training", shop.courses),
        ("held out", shop.held_out),
        ("evaluation", lambda: adapting.condition_ladder(shop, constants, 2000, evaluation_seed)),
        ("evaluation drives", lambda: adapting.drive_ladder(shop, constants, 1000, evaluation_seed)),
    ):
        use()
        parts[part], found = found, SimpleNamespace(rows=set(), drives=set(), noise=set())
    parts["campaign"] = SimpleNamespace(
        rows=set(map(tuple, shop.plan.conditions.tolist())), drives=set(), noise=set(shop.plan.config.noise_seeds)
    )
    return parts


@pytest.mark.parametrize(("seed", "evaluation_seed"), [(0, 7), (1, 7), (1, 0), (100, 7), (99, 199), (12, 100)])
def test_no_condition_or_drive_is_in_two_of_training_holding_out_and_evaluation(monkeypatch, seed, evaluation_seed):
    shop = adapting.Workshop.of(adapting.load_adaptation("road").replace(seed=seed))
    parts, asked = recorded(shop, monkeypatch, evaluation_seed), shop.config.learning
    assert {part: (len(each.rows), len(each.drives)) for part, each in parts.items()} == {
        "training": (asked.conditions, asked.drives + asked.hard_drives),
        "held out": (adapting.HELD_OUT_CONDITIONS, adapting.HELD_OUT_DRIVES),
        "evaluation": (2000, 0), "evaluation drives": (0, 1000), "campaign": (6400, 0),
    }  # fmt: skip
    for (_, one), (_, other) in itertools.combinations(parts.items(), 2):
        assert not one.rows & other.rows
        assert not one.drives & other.drives


@pytest.mark.parametrize(("seed", "evaluation_seed"), [(9907, 7), (9800, 0)])
def test_an_evaluation_on_what_was_learned_from_is_refused_before_any_work(tmp_path, seed, evaluation_seed):
    config = adapting.load_adaptation("road").replace(seed=seed)
    config = config.replace(evaluation=config.evaluation.replace(seed=evaluation_seed))
    with pytest.raises(InvalidInput, match=f"seed = {evaluation_seed}: these conditions were learned from"):
        adapting.adapt(config, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("changes", [{"scenario": "step"}, {"duration": 6.0}, {"move_price": 1.0}])
def test_a_campaign_of_other_runs_than_the_schedulers_are_judged_by_is_refused(tmp_path, changes):
    (name,) = changes
    with pytest.raises(InvalidInput, match=f"{name} = .*must be"):
        shop_of(tmp_path, changes)


def test_the_evaluation_has_noise_that_nothing_was_tuned_or_chosen_on(monkeypatch):
    parts = recorded(adapting.Workshop.of(adapting.load_adaptation("road")), monkeypatch, 7)
    judged = parts["evaluation"].noise | parts["evaluation drives"].noise
    assert judged == set(EVALUATION_SEEDS)
    assert not judged & (parts["campaign"].noise | set(SEARCH_SEEDS) | set(CHOICE_SEEDS))


# -- the chain --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_a_chain_leaves_one_file_for_every_rung(chain):
    assert set(chain.schedules) == RUNGS
    assert set(contents(chain.folder)) == {file_of(chain.folder, rung).name for rung in RUNGS}
    conditions = np.random.default_rng(5).uniform((3.0, -7.0, 0.3, -30.0), (30.0, 7.0, 1.0, 30.0), (50, 4))
    for rung in RUNGS:
        schedule = load_scheduler(file_of(chain.folder, rung))
        assert schedule.name == rung
        assert schedule.provenance["stage"] == chain.shop.identity(rung)
        np.testing.assert_array_equal(schedule.batch(conditions), chain.schedules[rung].batch(conditions))
        check_scheduler(schedule, 60)


@pytest.mark.compiled
def test_the_rungs_look_at_what_their_names_say(chain):
    inputs, looks = chain.shop.config.learning.inputs, ("speed", "y_ref", "friction", "wind")
    assert {rung: each.inputs for rung, each in chain.schedules.items() if len(np.unique(each.domain)) > 1} == {
        "speed only": ("speed",), "speed look-up": ("speed",), "look-up": looks,
        "nn unguarded": inputs, "nn": inputs, "anfis unguarded": inputs, "anfis": inputs,
        "paper recipe nn": looks, "paper recipe anfis": looks,
        "best constant": ("speed",), "best constant on drives": ("speed",), "fallback": ("speed",),
    }  # fmt: skip
    assert {rung for rung, each in chain.schedules.items() if each.guard is not None} == {"nn", "anfis"}
    assert set(chain.histories) == {"speed only", "nn unguarded", "nn", "anfis unguarded", "anfis"}
    assert all([each["round"] for each in history] == [0, 2] for history in chain.histories.values())


@pytest.mark.compiled
@pytest.mark.parametrize("evaluation", [{}, {"conditions": 100, "drives": 9, "seed": 3}])
def test_a_second_run_computes_nothing_and_gives_the_same_schedules_however_it_is_judged(
    chain, monkeypatch, evaluation
):
    forbid(monkeypatch, *WORK)
    before = contents(chain.folder)
    config = chain.shop.config.replace(evaluation=chain.shop.config.evaluation.replace(**evaluation))
    schedules, histories = adapting.learn(adapting.Workshop.of(config), chain.folder)
    assert contents(chain.folder) == before
    assert list(schedules) == list(chain.schedules)
    assert histories == chain.histories
    rows = conditions_around(np.random.default_rng(2), 30)
    for rung, schedule in schedules.items():
        np.testing.assert_array_equal(schedule.batch(rows), chain.schedules[rung].batch(rows))


@pytest.mark.compiled
def test_a_chain_that_was_stopped_goes_on_with_the_first_rung_that_is_missing(chain, copy, quick):
    finished = ("best constant", "best constant on drives", "fallback", "speed look-up")
    for rung in RUNGS - set(finished):
        file_of(copy, rung).unlink()
    forbid(quick, "run_campaign", "best_constant", "loop_map")
    improve, asked = adapting.improve, []

    def stopped(*given, name, **more):
        asked.append(name)
        if name == "nn" and asked.count("nn") == 1:
            raise KeyboardInterrupt
        return improve(*given, name=name, **more)

    quick.setattr(adapting, "improve", stopped)
    with pytest.raises(KeyboardInterrupt):
        adapting.learn(chain.shop, copy)
    assert set(contents(copy)) == {file_of(copy, rung).name for rung in (*finished, "look-up", "speed only")}
    quick.setattr(adapting, "stability_map", lambda shop: chain.schedules["nn"].guard.stability)
    forbid(quick, "neighbour_lookup")
    adapting.learn(chain.shop, copy)
    assert asked == ["speed only", "nn", "nn", "anfis"]
    assert contents(copy) == contents(chain.folder)  # to the byte, as if it had never been stopped


@pytest.mark.compiled
def test_a_file_of_another_configuration_is_made_again(chain, copy, monkeypatch):
    other = shop_of(copy.parent, seed=5)
    odd = Constant(Tuning(12, 2, 1.0, 50.0))
    object.__setattr__(odd, "provenance", {"stage": other.identity("speed look-up")})
    odd.save(file_of(copy, "speed look-up"))
    forbid(monkeypatch, *(set(WORK) - {"neighbour_lookup"}))
    adapting.learn(chain.shop, copy)
    assert contents(copy) == contents(chain.folder)


@pytest.mark.compiled
def test_a_damaged_file_and_the_campaign_of_another_configuration_are_told_not_written_over(chain, copy, quick):
    with pytest.raises(StorageError, match="belongs to another campaign"):
        adapting.learn(shop_of(copy.parent, {"seed": 3}), copy)
    whole = file_of(copy, "nn").read_bytes()
    file_of(copy, "nn").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StorageError, match=r"tiny-nn\.json.*damaged"):
        adapting.learn(chain.shop, copy)


# -- the guard --------------------------------------------------------------------------------------------------------
def test_the_map_covers_the_box_driving_straight_and_counts_slow_loops_as_nearer(tmp_path, monkeypatch):
    asked = {}
    axes = tuple(np.array(axis) for axis in ([3.0, 5.9, 6.0, 20.0], [0.3, 1.0], [10.0, 20.0], [1.0, 2.0], [2.0, 5.0]))

    def flat(plant, mpc, profile, **told):
        asked.update(told, profile=profile)
        return axes, np.full([len(axis) for axis in axes], 0.5)

    monkeypatch.setattr(adapting, "loop_map", flat)
    shop = shop_of(tmp_path)
    known = adapting.stability_map(shop)
    assert (asked["speed"], asked["friction"], asked["profile"]) == ((8.0, 25.0), (0.5, 1.0), "road")
    assert asked["turn"](20.0, 0.5) == 0.0
    assert known.limit == adapting.NEARNESS < 1.0
    more = 0.5 + adapting.SLOW_MARGIN
    assert [np.unique(each).tolist() for each in known.table.values] == [[more], [more], [0.5], [0.5]]


def check_guard(rung, bare, rng):
    """`rung` is `bare` where that may be trusted, gives way to the fallback where not, and keeps from instability."""
    rows = conditions_around(rng)
    rows[:, 6] *= 0.2  # few have strayed
    given, free, known = rung.batch(rows), bare.batch(rows), rung.guard.stability
    safe = rung.guard.fallback.as_array()

    def coordinates(tunings):
        return np.column_stack([tunings[:, :2], np.log10(tunings[:, 3] / tunings[:, 2])])

    def nearness(tunings, at=rows[:, [0, 2]]):
        return near(known, np.column_stack([at, coordinates(tunings)]))

    columns = [SchedulingVariables._fields.index(name) for name in rung.inputs]
    reach = rung.guard.slack * np.ptp(rung.domain, axis=1)
    seen = rows[:, columns]
    far = ((seen < rung.domain[:, 0] - reach) | (seen > rung.domain[:, 1] + reach)).any(axis=1)
    limit = rung.guard.offset_limit
    off_reference = np.zeros_like(far) if limit is None else np.abs(rows[:, 6]) > limit * GRAVITY * rows[:, 2]
    held, untouched = (given == safe).all(axis=1), (given == free).all(axis=1)
    assert held[far | off_reference].all()
    assert untouched[~far & ~off_reference & (nearness(free) < known.limit - 1e-9)].all()
    assert min(untouched.sum(), held.sum(), far.sum()) > 20
    assert nearness(given)[~held].max() <= known.limit + 1e-9
    ends = np.sort(np.stack([coordinates(free), np.broadcast_to(coordinates(safe[None]), (len(rows), 3))]), axis=0)
    between = (coordinates(given) >= ends[0] - 1e-9) & (coordinates(given) <= ends[1] + 1e-9)
    assert between.all()
    for name, (low, high) in BOUNDS.items():
        values = given[:, ENTRIES.index(name)]
        assert low <= values.min() <= values.max() <= high
    assert (given[:, 1] <= given[:, 0]).all()
    assert (given[:, 2] == 1.0).all()
    assert adapting.FALLBACK_NEARNESS < known.limit < 1.0
    corners = np.array(list(itertools.product(*known.table.axes[:2])))
    assert nearness(np.tile(safe, (len(corners), 1)), corners).max() <= adapting.FALLBACK_NEARNESS + 1e-9


@pytest.mark.compiled
@pytest.mark.parametrize("rung", ["nn", "anfis"])
def test_a_guarded_rung_is_the_bare_one_or_gives_way_and_is_never_near_to_instability(chain, rng, rung):
    check_guard(chain.schedules[rung], chain.schedules[f"{rung} unguarded"], rng)


@pytest.mark.parametrize("rung", ["nn", "anfis"])
def test_so_are_those_that_ship(rng, rung):
    schedules = adapting.shipped("road")
    check_guard(schedules[rung], schedules[f"{rung} unguarded"], rng)


def test_the_schedulers_that_ship_were_made_by_the_configuration_that_ships():
    schedules, shop = adapting.shipped("road"), adapting.Workshop.of(adapting.load_adaptation("road"))
    assert set(schedules) == RUNGS
    fallback = schedules["fallback"].batch([15.0, 0.0, 0.7, 0.0])[0]
    for rung in ("nn", "anfis"):
        np.testing.assert_array_equal(fallback, schedules[rung].guard.fallback.as_array())
    for rung, schedule in schedules.items():
        assert schedule.provenance["stage"] == shop.identity(rung), rung
        check_scheduler(schedule, 40, seed=3)


# -- the ladder -------------------------------------------------------------------------------------------------------
def some_schedules():
    """A schedule for every rung, each with an Np of its own."""
    table = {rung: 20 + i for i, rung in enumerate(sorted(RUNGS))}
    return {
        rung: Lookup({"speed": [0.0, 40.0]}, [[Np, 5, 1.0, 1e3], [Np, 5, 1.0, 1e5]], name=rung)
        for rung, Np in table.items()
    }


def test_on_conditions_what_was_learned_from_conditions_is_asked_once_for_each():
    schedules, rows = some_schedules(), np.array([[10.0, 1.0, 0.5, 0.0], [30.0, 1.0, 0.9, 5.0]])
    rungs = adapting.rungs_for(schedules, rows)
    assert set(rungs) == {"standard", *RUNGS} - {"fallback", "best constant on drives"}
    assert rungs["standard"] == Tuning()
    once = {rung for rung, policy in rungs.items() if isinstance(policy, np.ndarray)}
    assert once == {"look-up", "paper recipe nn", "paper recipe anfis"}
    for rung in once:
        np.testing.assert_array_equal(rungs[rung], [schedules[rung](row) for row in rows])
    assert all(rungs[rung] is schedules[rung] for rung in set(rungs) - once - {"standard"})


def test_on_drives_all_are_asked_at_every_step_and_the_best_constant_is_that_of_drives():
    schedules = some_schedules()
    rungs = adapting.rungs_for(schedules)
    assert rungs["best constant"] is schedules["best constant on drives"]
    assert rungs["best constant of conditions"] is schedules["best constant"]
    others = RUNGS - {"fallback", "best constant", "best constant on drives"}
    assert set(rungs) == {"standard", "best constant", "best constant of conditions", *others}
    assert all(rungs[rung] is schedules[rung] for rung in others)


def test_without_schedules_there_is_the_standard_one():
    assert adapting.rungs_for({}) == adapting.rungs_for({}, np.zeros((1, 4))) == {"standard": Tuning()}


def finite_rows(ladder):
    rows = ladder.rows()
    assert [row["scheduler"] for row in rows] == list(ladder.costs)
    assert all(np.isfinite([value for value in row.values() if not isinstance(value, str)]).all() for row in rows)
    return {row["scheduler"]: row for row in rows}


@pytest.mark.compiled
def test_a_ladder_on_conditions_measures_every_rung_against_the_optimum(chain):
    ladders = adapting.condition_ladder(chain.shop, chain.schedules, 4, 7, knowledge=("exact", "noisy"))
    rows = finite_rows(ladders["exact"])
    assert set(rows) == {"standard", "optimum", *RUNGS} - {"fallback", "best constant on drives"}
    assert rows["optimum"]["regret_geomean"] == rows["optimum"]["regret_worst"] == 1.0
    assert all(row["runs"] == 4 for row in rows.values())
    assert ladders["exact"].where.shape == (4, 4)
    assert set(ladders["noisy"].costs) == {*adapting.TOLD_RUNGS, "optimum"}
    for rung in ("best constant", "optimum"):  # they ask nobody
        np.testing.assert_array_equal(ladders["noisy"].costs[rung], ladders["exact"].costs[rung])
    assert (ladders["noisy"].costs["anfis"] != ladders["exact"].costs["anfis"]).any()


@pytest.mark.compiled
def test_on_drives_no_constant_is_better_than_that_of_hindsight(chain):
    ladders = adapting.drive_ladder(chain.shop, chain.schedules, 2, 7, knowledge=("exact", "withheld"))
    rows, ladder = finite_rows(ladders["exact"]), ladders["exact"]
    assert set(rows) == {"standard", "per-drive constant", *adapting.rungs_for(chain.schedules)}
    assert rows["best constant"]["regret_worst"] == 1.0
    assert (ladder.regret("per-drive constant") <= 1.0).all()
    assert ladder.where[:, 0].tolist() == [3_070_000.0, 3_070_001.0]
    assert set(ladders["withheld"].costs) == set(adapting.TOLD_RUNGS)
    np.testing.assert_array_equal(ladders["withheld"].costs["best constant"], ladder.costs["best constant"])


@pytest.mark.compiled
def test_the_papers_tests_are_driven_by_every_rung(chain):
    ladders = adapting.test_ladders(chain.shop, chain.schedules)
    assert set(ladders) == set(PUBLISHED)
    for ladder in ladders.values():
        rows = finite_rows(ladder)
        assert set(rows) == set(adapting.rungs_for(chain.schedules))
        assert rows["best constant"]["regret_worst"] == 1.0
