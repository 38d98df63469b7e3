"""An adaptation: what its configuration may say, what its stages depend on and leave, and what is never mixed up."""

from __future__ import annotations

import itertools
import re
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

from adaptrack.base.errors import ConfigError, InvalidInput, StorageError, UnknownName
from adaptrack.base.files import Record
from adaptrack.cars.vehicle import GRAVITY
from adaptrack.comparison import evaluate
from adaptrack.comparison.contenders import CONSTANTS, Contender, contenders_of
from adaptrack.comparison.evaluate import on_drives, on_operating_points, on_tests
from adaptrack.control.controllers import Tuning
from adaptrack.control.scheduling import (
    ENTRIES,
    Constant,
    Lookup,
    SchedulingVariables,
    check_scheduler,
    load_scheduler,
    made_for,
)
from adaptrack.drive.metrics import PUBLISHED
from adaptrack.learning.adaptation import recipes, splits
from adaptrack.learning.adaptation.config import list_adaptations, load_adaptation
from adaptrack.learning.adaptation.method import Method
from adaptrack.learning.adaptation.splits import SetUp
from adaptrack.paper.campaign_config import _plant, load_campaign
from adaptrack.paper.data_set import load_dataset
from adaptrack.studies import adapt as study
from adaptrack.studies import pipeline
from adaptrack.studies.adapt import CONTENDERS, histories, shipped, stage_identity
from small_chain import CAMPAIGN, learned, short_cuts, write

WORK = {
    "run_campaign": study, "best_constant": recipes, "improve": recipes, "neighbour_lookup": recipes, "train": recipes,
    "loop_map": recipes,
}  # fmt: skip
"""Everything in an adaptation that takes long, and where it is called from."""
BOUNDS, START = Method().improvement.bounds, Method().constants.tuning


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    return learned(tmp_path_factory.getbasetemp())


@pytest.fixture
def copy(chain, tmp_path):
    """A folder like the chain's own, to be changed."""
    return shutil.copytree(chain.folder, tmp_path / "copy")


@pytest.fixture
def quick():
    with short_cuts() as patch:
        yield patch


def setup_of(folder, pond=None, **changes):
    return SetUp.of(load_adaptation(write(folder, pond, **changes)))


def forbid(patch, *names):
    """Whoever does this work fails."""
    for name in names:
        patch.setattr(WORK[name], name, lambda *given, name=name, **more: pytest.fail(f"{name} was called"))


def file_of(folder, name):
    return folder / "schedulers" / f"tiny-{name.replace(' ', '-')}.json"


def contents(folder):
    return {path.name: path.read_bytes() for path in (folder / "schedulers").iterdir()}


def variables_around(rng, count=400):
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
    config = load_adaptation("road")
    campaign = load_campaign(config.campaign)
    assert (config.name, campaign.name, campaign.profile) == ("road", "road-sobol", "road")
    assert set(campaign.operating_points.box.model_dump()) >= {"speed", "friction"}
    assert list_adaptations()["road"] == config.description != ""
    assert SetUp.of(config).box["speed"] == campaign.operating_points.box.speed


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
        ({"learning": {"operating_points": 15}}, ["learning.operating_points = 15"]),
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
        ({"evaluation": {"operating_points": 0}}, ["evaluation.operating_points = 0"]),
    ],
)
def test_a_mistake_in_a_configuration_gives_one_error_that_names_file_key_and_remedy(tmp_path, changes, words):
    with pytest.raises(ConfigError) as error:
        load_adaptation(write(tmp_path, **changes))
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
        load_adaptation(path)


def test_a_name_that_nothing_has_and_a_file_that_is_not_there_are_told_apart(tmp_path):
    with pytest.raises(UnknownName, match=r"'raod'.*Did you mean 'road'\?"):
        load_adaptation("raod")
    with pytest.raises(StorageError, match=r"raod\.toml"):
        load_adaptation(tmp_path / "raod.toml")
    (tmp_path / "broken.toml").write_text("name = \n")
    with pytest.raises(ConfigError, match=r"broken\.toml, line 1"):
        load_adaptation(tmp_path / "broken.toml")


def test_a_campaign_that_is_no_sobol_sample_is_refused(tmp_path):
    config = load_adaptation(write(tmp_path, campaign="paper-grid"))
    with pytest.raises(InvalidInput, match=r"'paper-grid'.*Sobol"):
        SetUp.of(config)


def test_a_domain_that_no_constant_can_hold_is_refused_before_any_run_with_the_largest_one_that_can(tmp_path, quick):
    forbid(quick, "run_campaign", "best_constant")
    box = {"speed": [3.0, 30.0], "y_ref": [-4.0, 4.0], "friction": [0.3, 1.0], "wind": [-15.0, 15.0]}
    asked = {"operating_points": CAMPAIGN["operating_points"] | {"box": box}, "vehicle": "midsize-sedan"}
    config = load_adaptation(write(tmp_path, asked))
    with pytest.raises(InvalidInput, match=r"domain of 3 to 30 m/s .* that one can hold is (.*) to 30 m/s on") as told:
        study.learn(SetUp.of(config), tmp_path / "out")
    low = float(re.search(r"can hold is (\S+) to", str(told.value))[1])
    assert 3.0 < low < 10.0
    assert not (tmp_path / "out" / "campaign").exists()
    narrow = asked | {"operating_points": asked["operating_points"] | {"box": box | {"speed": [low, 30.0]}}}
    setup = SetUp.of(load_adaptation(write(tmp_path / "narrow", narrow)))
    assert len(recipes.safe_candidates(recipes.stability_map(setup), setup.method.constants)) > 0


@pytest.mark.parametrize(
    ("campaign", "error", "words"),
    [("road-sobl", UnknownName, "Did you mean 'road-sobol'"), ("puddle.toml", StorageError, r"puddle\.toml")],
)
def test_a_campaign_that_is_not_there_is_told(tmp_path, campaign, error, words):
    path = write(tmp_path)
    path.write_text(path.read_text().replace("pond.toml", campaign))
    with pytest.raises(error, match=words):
        SetUp.of(load_adaptation(path))


def test_the_file_of_a_campaign_is_looked_for_beside_that_of_the_adaptation(tmp_path, monkeypatch):
    path = write(tmp_path / "mine")
    write(tmp_path / "elsewhere", {"seed": 99})
    monkeypatch.chdir(tmp_path / "elsewhere")
    for given in (path, str(path), "../mine/tiny.toml"):
        setup = SetUp.of(load_adaptation(given))
        assert (setup.config.name, setup.campaign.name, setup.campaign.seed) == ("tiny", "pond", 2)


# -- what a stage depends on ------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("pond", "changes"),
    [
        ({}, {"seed": 1}),
        ({}, {"learning": {"inputs": ["friction", "speed"]}}),
        ({}, {"learning": {"domain": {"speed": [3.0, 29.0], "friction": [0.3, 1.0]}}}),
        ({}, {"learning": {"rounds": 3}}),
        ({}, {"learning": {"operating_points": 17}}),
        ({}, {"learning": {"drives": 9}}),
        ({}, {"learning": {"hard_drives": 9}}),
        ({}, {"learning": {"rules": 5}}),
        ({"seed": 3}, {}),
        ({"vehicle": "midsize-sedan"}, {}),
        ({"plant": "single-track"}, {}),
        ({"tyre": "passenger-car"}, {}),
        ({"profile": "paper", "noise_seeds": [0]}, {}),
        ({"profile": "production"}, {}),
        ({}, {"profile": "production"}),
        ({"noise_seeds": [1, 2]}, {}),
        ({"swarm": {"particles": 5, "generations": 2}}, {}),
        ({"library": {"size": 4}}, {}),
    ],
)
def test_what_decides_a_stage_changes_its_identity(tmp_path, pond, changes):
    before, after = setup_of(tmp_path), setup_of(tmp_path, pond, **changes)
    for name in ("nn", "fallback"):
        assert stage_identity(before, name) != stage_identity(after, name)


def test_how_it_is_judged_changes_no_identity_and_every_stage_has_its_own(tmp_path):
    before = setup_of(tmp_path)
    after = setup_of(tmp_path, evaluation={"operating_points": 100, "drives": 50, "seed": 8, "noises": 3})
    identities = {name: stage_identity(before, name) for name in CONTENDERS}
    assert identities == {name: stage_identity(after, name) for name in CONTENDERS}
    assert len(set(identities.values())) == len(CONTENDERS)


def changed(value):
    """Another value of the same kind, near enough to be allowed."""
    if isinstance(value, dict):
        key = next(iter(value))
        return value | {key: changed(value[key])}
    if isinstance(value, tuple):
        return (changed(value[0]), *value[1:])
    return value + 1 if isinstance(value, int) else 0.99 * value


def every_change(record):
    """(path, record with that one number changed) for each number of a record and of those in it."""
    for name, value in record:
        if isinstance(value, Record):
            yield from ((f"{name}.{path}", record.replace(**{name: other})) for path, other in every_change(value))
        else:
            yield name, record.replace(**{name: changed(value)})


def test_every_number_of_the_method_decides_every_stage(tmp_path):
    """So a resumed adaptation reuses no scheduler of another method."""
    setup = setup_of(tmp_path)
    seen = {stage_identity(setup, "nn")}
    changes = dict(every_change(setup.method))
    assert len(changes) > 70
    for path, method in changes.items():
        identity = stage_identity(replace(setup, config=setup.config.replace(method=method)), "nn")
        assert identity not in seen, path
        seen.add(identity)


def test_an_equal_configuration_gives_equal_identities(tmp_path):
    one, again = setup_of(tmp_path / "a"), setup_of(tmp_path / "b")
    assert stage_identity(one, "nn") == stage_identity(again, "nn")
    spelled_out = write(tmp_path / "c", method=Method().model_dump())
    assert stage_identity(SetUp.of(load_adaptation(spelled_out)), "nn") != stage_identity(one, "nn")  # short chain
    assert load_adaptation(spelled_out).method == Method()


@pytest.mark.parametrize("what", ["adaptrack", "kernels", "numpy", "scikit-learn"])
def test_other_software_decides_every_stage(tmp_path, monkeypatch, what):
    setup, versions = setup_of(tmp_path), pipeline.software()
    before = stage_identity(setup, "nn")
    monkeypatch.setattr(pipeline, "software", lambda: versions | {what: "another"})
    assert stage_identity(setup, "nn") != before


@pytest.mark.parametrize("what", ["path", "description"])
def test_the_place_of_the_files_and_what_is_said_of_them_change_no_identity(tmp_path, monkeypatch, what):
    before = setup_of(tmp_path)
    monkeypatch.chdir(tmp_path)
    given = {"path": "tiny.toml", "description": write(tmp_path, description="another sentence")}[what]
    if what == "path":
        write(tmp_path)
    assert stage_identity(SetUp.of(load_adaptation(given)), "nn") == stage_identity(before, "nn")


def recorded(setup, monkeypatch, evaluation_seed):
    """Operating points (as a set of rows) and numbers of drives that are trained on, held out and evaluated on."""
    found = SimpleNamespace(rows=set(), drives=set(), noise=set())

    def points(plant, mpc, rows, *more, **options):
        found.rows |= set(map(tuple, np.asarray(rows).tolist()))

    def drives(plant, mpc, numbers, *more, **options):
        found.drives |= set(numbers)

    def compared(runs, contenders, seeds, *more):
        found.noise |= set(seeds)

    for module in (splits, evaluate):
        monkeypatch.setattr(module, "operating_point_runs", points)
        monkeypatch.setattr(module, "random_drive_runs", drives)
    monkeypatch.setattr(evaluate, "compare", compared)
    monkeypatch.setattr(evaluate, "optimum", lambda *given, **more: START)
    monkeypatch.setattr(evaluate, "per_run_best", lambda *given: START)
    parts = {}
    constants = {name: Constant(Tuning()) for name in ("best constant", "best constant on drives")}
    for part, use in (
        ("training", lambda: splits.training_runs(setup)),
        ("held out", lambda: splits.held_out_runs(setup)),
        ("evaluation", lambda: on_operating_points(setup, constants, 2000, evaluation_seed)),
        ("evaluation drives", lambda: on_drives(setup, constants, 1000, evaluation_seed)),
    ):
        use()
        parts[part], found = found, SimpleNamespace(rows=set(), drives=set(), noise=set())
    parts["campaign"] = SimpleNamespace(
        rows=set(map(tuple, setup.plan.operating_points.tolist())),
        drives=set(),
        noise=set(setup.plan.config.noise_seeds),
    )
    return parts


@pytest.mark.parametrize(("seed", "evaluation_seed"), [(0, 7), (1, 7), (1, 0), (100, 7), (99, 199), (12, 100)])
def test_no_operating_point_or_drive_is_in_two_of_training_holding_out_and_evaluation(
    monkeypatch, seed, evaluation_seed
):
    setup = SetUp.of(load_adaptation("road").replace(seed=seed))
    parts, asked = recorded(setup, monkeypatch, evaluation_seed), setup.config.learning
    assert {part: (len(each.rows), len(each.drives)) for part, each in parts.items()} == {
        "training": (asked.operating_points, asked.drives + asked.hard_drives),
        "held out": (512, 512),
        "evaluation": (2000, 0), "evaluation drives": (0, 1000), "campaign": (6400, 0),
    }  # fmt: skip
    for (_, one), (_, other) in itertools.combinations(parts.items(), 2):
        assert not one.rows & other.rows
        assert not one.drives & other.drives


@pytest.mark.parametrize(("seed", "evaluation_seed"), [(9907, 7), (9800, 0)])
def test_an_evaluation_on_what_was_learned_from_is_refused_before_any_work(tmp_path, seed, evaluation_seed):
    config = load_adaptation("road").replace(seed=seed)
    config = config.replace(evaluation=config.evaluation.replace(seed=evaluation_seed))
    with pytest.raises(InvalidInput, match=f"seed = {evaluation_seed}: these operating points were learned from"):
        study.adapt(config, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    "seeds", [{"training_drives": 1_999_999}, {"held_out_drives": 1_000_000}, {"hard_drives": 3_070_000}], ids=str
)
def test_drives_that_would_be_in_two_parts_are_refused(tmp_path, seeds):
    with pytest.raises(InvalidInput, match="share random drives"):
        setup_of(tmp_path, method={"seeds": seeds})


@pytest.mark.parametrize("changes", [{"scenario": "step"}, {"duration": 6.0}, {"move_weight": 1.0}])
def test_a_campaign_of_other_runs_than_the_schedulers_are_judged_by_is_refused(tmp_path, changes):
    (name,) = changes
    with pytest.raises(InvalidInput, match=f"{name} = .*must be"):
        setup_of(tmp_path, changes)


def test_the_evaluation_has_noise_that_nothing_was_tuned_or_chosen_on(monkeypatch):
    parts = recorded(SetUp.of(load_adaptation("road")), monkeypatch, 7)
    judged = parts["evaluation"].noise | parts["evaluation drives"].noise
    asked = load_adaptation("road").evaluation
    assert judged == set(asked.noise_seeds)
    assert not judged & (parts["campaign"].noise | set(itertools.chain(*asked.search_seeds)) | set(asked.choice_seeds))


# -- the chain --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_an_adaptation_leaves_one_file_for_every_contender(chain):
    assert set(chain.schedules) == set(CONTENDERS)
    assert set(contents(chain.folder)) == {file_of(chain.folder, name).name for name in CONTENDERS}
    points = np.random.default_rng(5).uniform((3.0, -7.0, 0.3, -30.0), (30.0, 7.0, 1.0, 30.0), (50, 4))
    for name in set(CONTENDERS):
        schedule = load_scheduler(file_of(chain.folder, name))
        assert schedule.name == file_of(chain.folder, name).stem
        assert schedule.made_for == made_for(chain.setup.mpc, "road") | {"plant": "dual-track", "tyre": "magic-formula"}
        assert schedule.provenance["stage"] == stage_identity(chain.setup, name)
        np.testing.assert_array_equal(schedule.batch(points), chain.schedules[name].batch(points))
        check_scheduler(schedule, 60)


@pytest.mark.compiled
def test_the_contenders_look_at_what_their_names_say(chain):
    inputs, looks = chain.setup.config.learning.inputs, ("speed", "y_ref", "friction", "wind")
    assert {name: each.inputs for name, each in chain.schedules.items() if len(np.unique(each.domain)) > 1} == {
        "speed only": ("speed",), "speed look-up": ("speed",), "look-up": looks,
        "nn unguarded": inputs, "nn": inputs, "anfis unguarded": inputs, "anfis": inputs,
        "paper recipe nn": looks, "paper recipe anfis": looks,
        "best constant": ("speed",), "best constant on drives": ("speed",), "fallback": ("speed",),
    }  # fmt: skip
    assert {name for name, each in chain.schedules.items() if each.guard is not None} == {"nn", "anfis"}
    noted = histories(chain.schedules)
    assert set(noted) == {"speed only", "nn unguarded", "nn", "anfis unguarded", "anfis"}
    assert all([each["round"] for each in history] == [0, 2] for history in noted.values())


@pytest.mark.compiled
@pytest.mark.parametrize("evaluation", [{}, {"operating_points": 100, "drives": 9, "seed": 3}])
def test_a_second_run_computes_nothing_and_gives_the_same_schedules_however_it_is_judged(
    chain, monkeypatch, evaluation
):
    forbid(monkeypatch, *WORK)
    before = contents(chain.folder)
    config = chain.setup.config.replace(evaluation=chain.setup.config.evaluation.replace(**evaluation))
    schedules = study.learn(SetUp.of(config), chain.folder)
    assert contents(chain.folder) == before
    assert list(schedules) == list(chain.schedules)
    assert histories(schedules) == histories(chain.schedules)
    rows = variables_around(np.random.default_rng(2), 30)
    for name, schedule in schedules.items():
        np.testing.assert_array_equal(schedule.batch(rows), chain.schedules[name].batch(rows))


@pytest.mark.compiled
def test_an_adaptation_that_was_stopped_goes_on_with_the_first_stage_that_is_missing(chain, copy, quick):
    finished = ("best constant", "best constant on drives", "fallback", "speed look-up")
    for name in set(CONTENDERS) - set(finished):
        file_of(copy, name).unlink()
    forbid(quick, "run_campaign", "best_constant", "loop_map")
    improve, asked = recipes.improve, []

    def stopped(start, *given, **more):
        asked.append(start.name)
        if start.name == "nn" and asked.count("nn") == 1:
            raise KeyboardInterrupt
        return improve(start, *given, **more)

    quick.setattr(recipes, "improve", stopped)
    with pytest.raises(KeyboardInterrupt):
        study.learn(chain.setup, copy)
    assert set(contents(copy)) == {file_of(copy, name).name for name in (*finished, "look-up", "speed only")}
    quick.setattr(recipes, "stability_map", lambda setup: chain.schedules["nn"].guard.stability)
    forbid(quick, "neighbour_lookup")
    study.learn(chain.setup, copy)
    assert asked == ["speed only", "nn", "nn", "anfis"]
    assert contents(copy) == contents(chain.folder)  # to the byte, as if it had never been stopped


@pytest.mark.compiled
def test_a_file_of_another_configuration_is_made_again(chain, copy, monkeypatch):
    other = setup_of(copy.parent, seed=5)
    odd = Constant(Tuning(12, 2, 1.0, 50.0))
    object.__setattr__(odd, "provenance", {"stage": stage_identity(other, "speed look-up")})
    odd.save(file_of(copy, "speed look-up"))
    forbid(monkeypatch, *(WORK.keys() - {"neighbour_lookup"}))
    study.learn(chain.setup, copy)
    assert contents(copy) == contents(chain.folder)


@pytest.mark.compiled
def test_what_a_schedule_was_made_for_does_not_depend_on_what_else_the_process_has_done(chain, copy):
    _plant.cache_clear()  # the plant of the set-up is no longer the one at hand
    file_of(copy, "speed look-up").unlink()
    study.learn(chain.setup, copy)
    assert contents(copy) == contents(chain.folder)


@pytest.mark.compiled
def test_a_damaged_file_and_the_campaign_of_another_configuration_are_told_not_written_over(chain, copy, quick):
    with pytest.raises(StorageError, match="belongs to another campaign"):
        study.learn(setup_of(copy.parent, {"seed": 3}), copy)
    whole = file_of(copy, "nn").read_bytes()
    file_of(copy, "nn").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(StorageError, match=r"tiny-nn\.json.*damaged"):
        study.learn(chain.setup, copy)


# -- the guard --------------------------------------------------------------------------------------------------------
def test_the_map_covers_the_box_driving_straight_and_counts_slow_loops_as_nearer(tmp_path, monkeypatch):
    asked = {}
    axes = tuple(np.array(axis) for axis in ([3.0, 5.9, 6.0, 20.0], [0.3, 1.0], [10.0, 20.0], [1.0, 2.0], [2.0, 5.0]))

    def flat(plant, mpc, profile, **options):
        asked.update(options, profile=profile)
        return axes, np.full([len(axis) for axis in axes], 0.5)

    monkeypatch.setattr(recipes, "loop_map", flat)
    setup = setup_of(tmp_path)
    known = recipes.stability_map(setup)
    assert (asked["speed"], asked["friction"], asked["profile"].name) == ((8.0, 25.0), (0.5, 1.0), "road")
    assert asked["turn"] is None
    assert known.limit == 0.95 == 1.0 - setup.method.guard.margin
    more = 0.5 + setup.method.guard.slow_margin
    assert [np.unique(each).tolist() for each in known.table.values] == [[more], [more], [0.5], [0.5]]


def check_guard(guarded, bare, rng):
    """`guarded` is `bare` where that may be trusted, gives way to the fallback where not, and keeps stable."""
    rows = variables_around(rng)
    rows[:, 6] *= 0.2  # few are off the reference
    given, free, known = guarded.batch(rows), bare.batch(rows), guarded.guard.stability
    safe = guarded.guard.fallback.as_array()

    def coordinates(tunings):
        return np.column_stack([tunings[:, :2], np.log10(tunings[:, 3] / tunings[:, 2])])

    def peak(tunings, at=rows[:, [0, 2]]):
        return near(known, np.column_stack([at, coordinates(tunings)]))

    columns = [SchedulingVariables._fields.index(name) for name in guarded.inputs]
    reach = guarded.guard.slack * np.ptp(guarded.domain, axis=1)
    seen = rows[:, columns]
    far = ((seen < guarded.domain[:, 0] - reach) | (seen > guarded.domain[:, 1] + reach)).any(axis=1)
    limit = guarded.guard.offset_limit
    off_reference = np.zeros_like(far) if limit is None else np.abs(rows[:, 6]) > limit * GRAVITY * rows[:, 2]
    held, untouched = (given == safe).all(axis=1), (given == free).all(axis=1)
    assert held[far | off_reference].all()
    assert untouched[~far & ~off_reference & (peak(free) < known.limit - 1e-9)].all()
    assert min(untouched.sum(), held.sum(), far.sum()) > 20
    assert peak(given)[~held].max() <= known.limit + 1e-9
    ends = np.sort(np.stack([coordinates(free), np.broadcast_to(coordinates(safe[None]), (len(rows), 3))]), axis=0)
    between = (coordinates(given) >= ends[0] - 1e-9) & (coordinates(given) <= ends[1] + 1e-9)
    assert between.all()
    for name, (low, high) in BOUNDS.items():
        values = given[:, ENTRIES.index(name)]
        assert low <= values.min() <= values.max() <= high
    assert (given[:, 1] <= given[:, 0]).all()
    assert (given[:, 2] == 1.0).all()
    assert 1.0 - Method().constants.fallback_margin < known.limit < 1.0
    corners = np.array(list(itertools.product(*known.table.axes[:2])))
    assert peak(np.tile(safe, (len(corners), 1)), corners).max() <= 1.0 - Method().constants.fallback_margin + 1e-9


@pytest.mark.compiled
@pytest.mark.parametrize("name", ["nn", "anfis"])
def test_a_guarded_contender_is_the_bare_one_or_gives_way_and_is_never_near_to_instability(chain, rng, name):
    check_guard(chain.schedules[name], chain.schedules[f"{name} unguarded"], rng)


@pytest.mark.parametrize("name", ["nn", "anfis"])
def test_so_are_those_that_ship(rng, name):
    schedules = shipped("road")
    check_guard(schedules[name], schedules[f"{name} unguarded"], rng)


def test_the_schedulers_that_ship_name_the_settings_of_the_configuration_that_ships():
    """Adaptrack 0.1.0 made them: their stage is of its software, their settings are those of today's configuration."""
    schedules, config = shipped("road"), load_adaptation("road")
    assert set(schedules) == set(CONTENDERS)
    assert config.method == Method()
    for name in ("nn", "anfis"):
        fallback = schedules[name].guard.fallback.as_array()
        np.testing.assert_array_equal(schedules["fallback"].batch([15.0, 0.0, 0.7, 0.0])[0], fallback)
    for schedule in schedules.values():
        made = schedule.provenance
        assert made["settings"] == config.settings
        assert made["campaign"] == load_dataset("road-sobol").provenance["identity"]
        assert made["software"] == {"adaptrack": "0.1.0"}
        assert len(made["stage"]) == 64
        check_scheduler(schedule, 40, seed=3)


@pytest.mark.compiled
def test_a_scheduler_names_the_settings_and_the_software_that_made_it(chain):
    for schedule in chain.schedules.values():
        assert schedule.provenance["settings"] == chain.setup.config.settings
        assert schedule.provenance["software"] == pipeline.software()


# -- comparisons -------------------------------------------------------------------------------------------------------
def some_schedules():
    """A schedule for every name, each with an Np of its own."""
    table = {name: 20 + i for i, name in enumerate(sorted(set(CONTENDERS)))}
    return {
        name: Lookup({"speed": [0.0, 40.0]}, [[Np, 5, 1.0, 1e3], [Np, 5, 1.0, 1e5]], name=f"file of {name}")
        for name, Np in table.items()
    }


def test_on_operating_points_what_was_learned_from_such_is_asked_once_for_each():
    schedules, rows = some_schedules(), np.array([[10.0, 1.0, 0.5, 0.0], [30.0, 1.0, 0.9, 5.0]])
    made = contenders_of(schedules, rows)
    called = {"standard", "best constant", *(f"file of {name}" for name in CONTENDERS)}
    assert set(made) == called - {f"file of {name}" for name in CONSTANTS}
    found = {each.kind: each.policy for each in made.values()}
    assert set(found) == {"standard", *CONTENDERS} - {"fallback", "best constant on drives"}
    assert found["standard"] == Tuning()
    once = {name for name, policy in found.items() if isinstance(policy, np.ndarray)}
    assert once == {"look-up", "paper recipe nn", "paper recipe anfis"}
    for name in once:
        np.testing.assert_array_equal(found[name], [schedules[name](row) for row in rows])
    assert all(found[name] is schedules[name] for name in set(found) - once - {"standard"})


def test_on_drives_all_are_asked_at_every_step_and_the_best_constant_is_that_of_drives():
    schedules = some_schedules()
    found = {each.kind: each.policy for each in contenders_of(schedules).values()}
    assert found["best constant"] is schedules["best constant on drives"]
    assert found["best constant of operating points"] is schedules["best constant"]
    others = set(CONTENDERS) - {"fallback", "best constant", "best constant on drives"}
    assert set(found) == {"standard", "best constant", "best constant of operating points", *others}
    assert all(found[name] is schedules[name] for name in others)


def test_without_schedules_there_is_the_standard_one_and_ones_own():
    for points in (None, np.zeros((1, 4))):
        found = contenders_of({}, points, [Contender("mine", START)])
        assert {name: each.policy for name, each in found.items()} == {"standard": Tuning(), "mine": START}


def finite_rows(comparison):
    rows = comparison.rows()
    assert [row["contender"] for row in rows] == list(comparison.costs)
    assert all(np.isfinite([value for value in row.values() if not isinstance(value, str)]).all() for row in rows)
    return {row["contender"]: row for row in rows}


@pytest.mark.compiled
def test_on_operating_points_every_contender_is_measured_against_the_optimum(chain):
    mine = Contender("mine", START)
    found = on_operating_points(chain.setup, chain.schedules, 4, 7, known_as=("exact", "noisy"), more=[mine])
    rows = finite_rows(found["exact"])
    kinds = {"standard", "optimum", "", *CONTENDERS} - {"fallback", "best constant on drives"}
    assert {row["kind"] for row in rows.values()} == kinds
    assert {"mine", "tiny-nn", "best constant"} <= set(rows)
    assert rows["optimum"]["regret_geomean"] == rows["optimum"]["regret_worst"] == 1.0
    assert all(row["runs"] == 4 for row in rows.values())
    assert found["exact"].where.shape == (4, 4)
    assert set(found["noisy"].costs) == {"best constant", "tiny-nn", "tiny-anfis", "optimum"}
    for name in ("best constant", "optimum"):  # they ask nobody
        np.testing.assert_array_equal(found["noisy"].costs[name], found["exact"].costs[name])
    assert (found["noisy"].costs["tiny-anfis"] != found["exact"].costs["tiny-anfis"]).any()
    assert not {"standard", "optimum", "best constant", "mine"} & set(found["exact"].adaptive)
    assert {"tiny-nn", "tiny-anfis", "tiny-look-up", "tiny-speed-only"} <= set(found["exact"].adaptive)


@pytest.mark.compiled
def test_on_drives_no_constant_is_better_than_that_of_hindsight(chain):
    found = on_drives(chain.setup, chain.schedules, 2, 7, known_as=("exact", "withheld"))
    rows, exact = finite_rows(found["exact"]), found["exact"]
    assert set(rows) == {"per-drive constant", *contenders_of(chain.schedules)}
    assert rows["best constant"]["regret_worst"] == 1.0
    assert (exact.regret("per-drive constant") <= 1.0).all()
    assert exact.where[:, 0].tolist() == [3_070_000.0, 3_070_001.0]
    assert {found["withheld"].role(name).kind for name in found["withheld"].costs} == set(evaluate.PERCEIVING)
    np.testing.assert_array_equal(found["withheld"].costs["best constant"], exact.costs["best constant"])


@pytest.mark.compiled
def test_the_papers_tests_are_driven_by_every_contender(chain):
    found = on_tests(chain.setup, chain.schedules)
    assert set(found) == set(PUBLISHED)
    for comparison in found.values():
        rows = finite_rows(comparison)
        assert set(rows) == set(contenders_of(chain.schedules))
        assert rows["best constant"]["regret_worst"] == 1.0
