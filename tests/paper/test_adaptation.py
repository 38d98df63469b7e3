"""Schedules that learn on the closed loop, and their evaluation: separate data, resumable files, the guard, costs."""

import itertools
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import RegularGridInterpolator

import adaptrack as at
from adaptrack.base.statistics import geometric_mean
from adaptrack.control import scheduling
from adaptrack.core.physics.forces import GRAVITY
from adaptrack.drive.metrics import PAPER_MSE
from adaptrack.paper import adaptation, evaluation, improvement
from adaptrack.paper.adaptation import CONTENDER_NAMES, Effort, LearningTask, identity_of, shipped_schedules
from adaptrack.paper.campaign_config import list_campaigns, load_campaign
from adaptrack.paper.data_set import load_dataset
from adaptrack.paper.evaluation import evaluate_on_drives, evaluate_on_operating_points, evaluate_on_tests
from adaptrack.tuning.objective import Objective
from small_chain import CAMPAIGN, EFFORT, learned, short_cuts, task_of, write
from small_runs import Rated, bowl, lane_changes, run_set

EVALUATED = ("best constant", "look-up", "nn", "anfis")


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    return learned(tmp_path_factory.getbasetemp())


@pytest.fixture(scope="module")
def road():
    return LearningTask.of(load_campaign("road-sobol"))


def contents(folder):
    return {path.name: path.read_bytes() for path in (folder / "schedulers").iterdir()}


# -- the task ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("changes", "words"), [
    ({"operating_points": {"kind": "paper-grid"}}, "Sobol sample"),
    ({"scenario": "step"}, "scenario = 'step'"),
    ({"duration": 6.0}, "duration = 6.0"),
    ({"move_weight": 1.0}, "move_weight = 1.0"),
])  # fmt: skip
def test_a_campaign_from_which_schedules_cannot_learn_is_refused(tmp_path, changes, words):
    with pytest.raises(at.InvalidInput, match=f"'pond'.*{words}"):
        task_of(tmp_path, **changes)


def test_a_domain_without_a_safe_constant_is_refused_before_any_run_with_the_largest_that_has_one(
    tmp_path, monkeypatch
):
    box = {"speed": [3.0, 30.0], "y_ref": [-4.0, 4.0], "friction": [0.3, 1.0], "wind": [-15.0, 15.0]}
    changes = {"operating_points": CAMPAIGN["operating_points"] | {"box": box}, "vehicle": "midsize-sedan"}
    campaign = load_campaign(write(tmp_path, **changes))
    monkeypatch.setattr(adaptation, "run_campaign", lambda *arguments, **parameters: pytest.fail("the campaign ran"))
    with short_cuts(), pytest.raises(at.InvalidInput, match="Narrow the box") as error:
        adaptation.adapt(campaign, tmp_path / "out", effort=EFFORT)
    low = float(re.search(r"can hold is (\S+) to 30 m/s", str(error.value))[1])
    assert 3.0 < low < 30.0
    narrow = changes["operating_points"] | {"box": box | {"speed": [low, 30.0]}}
    with short_cuts():
        stability = adaptation.stability_map(task_of(tmp_path, **changes | {"operating_points": narrow}))
    assert len(adaptation.safe_candidates(stability)) > 0


def test_no_operating_point_drive_or_noise_is_in_two_of_learning_holding_out_and_evaluation(road, monkeypatch):
    parts = {}

    def record(part):
        parts[part] = {"points": set(), "drives": set(), "noise": set()}

        def points(plant, mpc, rows, *parameters, **options):
            parts[part]["points"] |= set(map(tuple, np.asarray(rows).tolist()))
            return range(len(rows))

        def drives(plant, mpc, numbers, *parameters, **options):
            parts[part]["drives"] |= set(numbers)
            return numbers

        for module in (adaptation, evaluation):
            monkeypatch.setattr(module, "operating_point_runs", points)
            monkeypatch.setattr(module, "random_drive_runs", drives)
        monkeypatch.setattr(
            evaluation, "compare", lambda runs, contenders, seeds, *parameters: parts[part]["noise"].update(seeds)
        )

    monkeypatch.setattr(evaluation, "find_optimum", lambda *arguments: np.ones((2000, 4)))
    constants = dict.fromkeys(
        ("best constant", "best constant on drives", "fallback"), scheduling.Constant(at.Tuning())
    )
    record("learning")
    road.training()
    record("holding out")
    road.held_out()
    for seed in (0, 7):
        record(f"evaluation {seed}")
        evaluate_on_operating_points(road, constants, 2000, seed)
        evaluate_on_drives(road, constants, 1000, seed)
    campaign = set(map(tuple, road.plan.operating_points.tolist()))
    noise = set(itertools.chain(*(load_campaign(name).settled().noise_seeds for name in list_campaigns())))
    parts["campaign"] = {"points": campaign, "drives": set(), "noise": noise}
    effort = road.effort
    parts["learning"]["noise"] = {adaptation.CONSTANT_NOISE, *range(101_000, 101_000 + effort.rounds)}
    parts["holding out"]["noise"] = {100_900}
    parts["search"] = {"points": set(), "drives": set(), "noise": set(itertools.chain(*evaluation.SEARCH_NOISE))}
    parts["choice"] = {"points": set(), "drives": set(), "noise": set(evaluation.CHOICE_NOISE)}
    assert len(parts["learning"]["drives"]) == effort.drives + effort.hard_drives
    assert len(parts["learning"]["points"]) == effort.operating_points
    for (name, first), (other, second) in itertools.combinations(parts.items(), 2):
        for kind in ("points", "drives", "noise"):
            shared_noise = kind == "noise" and name.startswith("evaluation") and other.startswith("evaluation")
            assert shared_noise or not first[kind] & second[kind], (name, other, kind)


def test_an_evaluation_on_operating_points_that_were_learned_from_is_refused(tmp_path):
    points = CAMPAIGN["operating_points"] | {"seed": 10_007}
    with pytest.raises(at.InvalidInput, match="seed = 7: these operating points were learned from"):
        evaluation.evaluation_points(task_of(tmp_path, operating_points=points), 8, 7)


def test_the_shipped_schedules_were_learned_with_the_constants_of_the_method():
    assert set(shipped_schedules()) == set(CONTENDER_NAMES)
    campaign = load_dataset("road-sobol").provenance["identity"]
    for schedule in shipped_schedules().values():
        settings = schedule.provenance["settings"]
        method, learning = settings["method"], settings["learning"]
        assert schedule.provenance["campaign"] == campaign
        assert settings["seed"] == adaptation.LEARNING_SEED
        assert tuple(learning["inputs"]) == adaptation.LEARNED_INPUTS
        effort = Effort()
        runs, steps, shape = method["runs"], method["improvement"], method["landscape"]
        assert [learning[key] for key in ("rounds", "operating_points", "drives", "hard_drives", "rules")] == [
            *effort[:4], adaptation.FUZZY_RULES
        ]  # fmt: skip
        assert (runs["held_out_points"], runs["held_out_drives"], runs["segment"]) == (*effort[4:6], 2.0)
        assert tuple(runs[f"round_{part}"] for part in ("points", "drives", "hard_drives")) == effort.round_runs
        assert shape["shift"] == improvement.OUTPUT_SHIFT.tolist()
        assert shape["least_curvature"] == improvement.MIN_CURVATURE.tolist()
        assert (shape["least_share"], shape["worst_segment"]) == (improvement.MIN_SHARE, improvement.MAX_SEGMENT_COST)
        assert (steps["damping"], steps["damping_end"]) == (improvement.DAMPING, improvement.FINAL_DAMPING)
        assert (steps["check"], steps["averaged"]) == (improvement.CHECK_INTERVAL, improvement.AVERAGED_ROUNDS)
        assert {key: tuple(steps[key]) for key in improvement.TUNING_BOUNDS} == improvement.TUNING_BOUNDS
        assert method["constants"]["evaluations"] == effort.constant_tunings
        assert {key: method["guard"][key] for key in ("slack", "hold", "offset_limit")} == {
            key: adaptation.GUARD_OPTIONS[key] for key in ("slack", "hold", "offset_limit")
        }


# -- the chain --------------------------------------------------------------------------------------------------------
@pytest.mark.compiled
def test_an_adaptation_writes_one_file_for_each_contender(chain, rng):
    assert set(contents(chain.folder)) == {f"{name.replace(' ', '-')}.json" for name in CONTENDER_NAMES}
    points = rng.uniform((3.0, -7.0, 0.3, -30.0), (30.0, 7.0, 1.0, 30.0), (50, 4))
    schedules = adaptation.read_schedules(chain.folder)
    for name, schedule in schedules.items():
        purpose = scheduling.made_for(chain.task.mpc, "road") | {"plant": "dual-track", "tyre": "magic-formula"}
        assert schedule.made_for == purpose
        np.testing.assert_array_equal(schedule.batch(points), chain.schedules[name].batch(points))
        scheduling.check_scheduler(schedule, 60)
    assert {name for name, schedule in schedules.items() if schedule.guard is not None} == {"nn", "anfis"}
    assert all(
        [entry["round"] for entry in schedules[name].provenance["history"]] == [0, 2] for name in ("nn", "anfis")
    )


@pytest.mark.compiled
def test_a_resumed_adaptation_keeps_finished_schedules_and_makes_the_others_with_the_same_bits(
    chain, tmp_path, monkeypatch
):
    folder = shutil.copytree(chain.folder, tmp_path / "out")
    (folder / "schedulers" / "look-up.json").unlink()
    other = scheduling.Constant(at.Tuning(12, 2, 1.0, 50.0))
    replace(other, provenance={"identity": "of another campaign"}).save(folder / "schedulers" / "fallback.json")
    monkeypatch.setattr(adaptation, "improve", lambda *arguments, **parameters: pytest.fail("it learned again"))
    with short_cuts():
        adaptation.adapt(load_campaign(chain.file), folder, workers=1, effort=EFFORT)
    assert contents(folder) == contents(chain.folder)
    half = (folder / "schedulers" / "nn.json").read_bytes()[:500]
    (folder / "schedulers" / "nn.json").write_bytes(half)
    with pytest.raises(at.StorageError, match=r"nn\.json.*damaged"):
        adaptation.adapt(load_campaign(chain.file), folder, workers=1, effort=EFFORT)


def test_everything_that_decides_a_schedule_changes_its_identity(tmp_path, monkeypatch):
    task, changes = task_of(tmp_path), {"vehicle": "midsize-sedan", "profile": "production", "tyre": "passenger-car"}
    identities = [identity_of(task, "nn"), identity_of(task, "anfis"), identity_of(task_of(tmp_path, seed=3), "nn")]
    identities += [identity_of(task_of(tmp_path, **{key: value}), "nn") for key, value in changes.items()]
    identities.append(identity_of(replace(task, effort=EFFORT._replace(rounds=3)), "nn"))
    software = adaptation.software(task)
    for name in software:
        monkeypatch.setattr(adaptation, "software", lambda task, name=name: software | {name: "other"})
        identities.append(identity_of(task, "nn"))
    assert len(set(identities)) == len(identities)


# -- constants and the look-up table ----------------------------------------------------------------------------------
def test_the_best_constant_is_found_on_a_known_landscape():
    runs = Rated(bowl(ratio=2.0))
    constant = adaptation.best_constant(runs, 1000)
    assert runs.drive(constant, [0])[0, 0] < 1.05
    assert constant[2] == 1.0


@pytest.mark.compiled
def test_the_best_constant_costs_no_more_than_the_first_and_is_within_its_bounds():
    runs = run_set(lane_changes(6, 3.0))
    constant = adaptation.best_constant(runs, 40)
    cost, first = (
        geometric_mean(runs.costs(tuning, [adaptation.CONSTANT_NOISE])) for tuning in (constant, adaptation.START)
    )
    assert cost <= first
    space = adaptation.CONSTANT_SPACE
    position = constant[[0, 1, 3]]
    assert (np.array(space.low) <= position).all()
    assert (position <= np.array(space.high)).all()


def test_a_node_of_the_look_up_table_has_the_tuning_with_the_lowest_mean_log_cost_nearby(chain):
    dataset = load_dataset(chain.folder / "campaign")
    nodes = {"speed": [10.0, 20.0], "friction": [0.6]}
    table = adaptation.neighbour_lookup(dataset, nodes)
    points = dataset.operating_points[:, [0, 2]]
    for speed in nodes["speed"]:
        distance = (((points - [speed, 0.6]) / np.ptp(points, axis=0)) ** 2).sum(axis=1)
        near = np.argsort(distance)[: adaptation.LOOKUP_NEIGHBOURS]
        best = np.argmin(np.log(dataset.landscape[near].astype(float)).mean(axis=0))
        np.testing.assert_allclose(table.batch([[speed, 0.0, 0.6, 0.0]])[0], dataset.library[best])


# -- the guard --------------------------------------------------------------------------------------------------------
def test_the_map_covers_the_box_driving_straight_and_has_less_margin_at_low_speed(tmp_path, monkeypatch):
    options = {}
    axes = tuple(np.array(axis) for axis in ([3.0, 5.9, 6.0, 20.0], [0.3, 1.0], [10.0, 20.0], [1.0, 2.0], [2.0, 5.0]))

    def flat(plant, mpc, profile, **parameters):
        options.update(parameters, profile=profile)
        return axes, np.full([len(axis) for axis in axes], 0.5)

    monkeypatch.setattr(adaptation, "loop_map", flat)
    stability = adaptation.stability_map(task_of(tmp_path))
    assert (options["speed"], options["friction"], options["profile"].name) == ((8.0, 25.0), (0.5, 1.0), "road")
    assert options["turn"] is None
    assert stability.limit == 1.0 - adaptation.GUARD_MARGIN
    slow = 0.5 + adaptation.SLOW_MARGIN
    assert [np.unique(level).tolist() for level in stability.table.values] == [[slow], [slow], [0.5], [0.5]]


def variables_around(rng, count=400):
    """Inside the operating domain, far outside it, and at its corners."""
    low, high = np.array([3.0, -7.0, 0.3, -30.0, 0.0, 0.0, -2.0]), np.array([30.0, 7.0, 1.0, 30.0, 12.0, 3.5, 2.0])
    rows = low + (high - low) * rng.uniform(size=(count, len(low)))
    rows[::3] += rng.normal(size=rows[::3].shape) * (high - low)
    rows[::5] = np.where(rng.uniform(size=rows[::5].shape) < 0.5, low, high)
    rows[:, 6] *= 0.2  # few are off the reference
    return rows


def coordinates(tunings):
    return np.column_stack([tunings[:, :2], np.log10(tunings[:, 3] / tunings[:, 2])])


def check_guard(guarded, rng):
    """A guarded schedule is the bare one inside its limits, otherwise between it and the fallback, and stable."""
    rows, guard = variables_around(rng), guarded.guard
    tunings, bare = guarded.batch(rows), replace(guarded, guard=None).batch(rows)
    safe, stability = guard.fallback.as_array(), guard.stability
    axes = stability.table.axes
    table = RegularGridInterpolator(axes, stability.table.values)

    def peak(tunings, places=rows[:, [0, 2]]):
        positions = np.column_stack([places, coordinates(tunings)])
        return table(np.clip(positions, [axis[0] for axis in axes], [axis[-1] for axis in axes]))

    inputs = rows[:, [scheduling.SchedulingVariables._fields.index(name) for name in guarded.inputs]]
    reach = guard.slack * np.ptp(guarded.domain, axis=1)
    is_far = ((inputs < guarded.domain[:, 0] - reach) | (inputs > guarded.domain[:, 1] + reach)).any(axis=1)
    off_reference = np.abs(rows[:, 6]) > guard.offset_limit * GRAVITY * rows[:, 2]
    fallback, untouched = (tunings == safe).all(axis=1), (tunings == bare).all(axis=1)
    assert fallback[is_far | off_reference].all()
    assert untouched[~is_far & ~off_reference & (peak(bare) < stability.limit - 1e-9)].all()
    assert min(untouched.sum(), fallback.sum(), is_far.sum()) > 20
    assert peak(tunings)[~fallback].max() <= stability.limit + 1e-9
    ends = np.sort(np.stack([coordinates(bare), np.broadcast_to(coordinates(safe[None]), (len(rows), 3))]), axis=0)
    assert ((coordinates(tunings) >= ends[0] - 1e-9) & (coordinates(tunings) <= ends[1] + 1e-9)).all()
    for name, (low, high) in improvement.TUNING_BOUNDS.items():
        values = tunings[:, scheduling.ENTRIES.index(name)]
        assert low <= values.min() <= values.max() <= high
    corners = np.array(list(itertools.product(*axes[:2])))
    assert peak(np.tile(safe, (len(corners), 1)), corners).max() <= 1.0 - adaptation.FALLBACK_MARGIN + 1e-9


@pytest.mark.parametrize("name", ["nn", "anfis"])
def test_a_shipped_schedule_is_the_bare_one_or_gives_way_and_is_never_near_to_instability(rng, name):
    schedules = shipped_schedules()
    check_guard(schedules[name], rng)
    np.testing.assert_array_equal(
        schedules["fallback"].batch([15.0, 0.0, 0.7, 0.0])[0], schedules[name].guard.fallback.as_array()
    )


# -- evaluation -------------------------------------------------------------------------------------------------------
def some_schedules():
    """A schedule for each contender, with its own Np."""
    return {
        name: scheduling.Lookup({"speed": [0.0, 40.0]}, [[20 + i, 5, 1.0, 1e3], [20 + i, 5, 1.0, 1e5]], name=name)
        for i, name in enumerate(CONTENDER_NAMES)
    }


@pytest.mark.compiled
def test_on_operating_points_the_reference_is_the_optimum_and_the_table_knows_the_point(chain, monkeypatch):
    entered = {}
    compare = evaluation.compare

    def note(runs, contenders, *parameters):
        entered.update({contender.name: contender.policy for contender in contenders})
        return compare(runs, contenders, *parameters)

    monkeypatch.setattr(evaluation, "compare", note)
    schedules = chain.schedules | {"mine": scheduling.Constant(at.Tuning(30, 5, 1.0, 4000.0))}
    comparisons = evaluate_on_operating_points(chain.task, schedules, 4, 7, perception=("exact", "noisy"))
    exact, noisy = comparisons["exact"], comparisons["noisy"]
    assert set(exact.contenders) == {*EVALUATED, "mine", "optimum"}
    assert (exact.regret("optimum") == 1.0).all()
    assert exact.where.shape == (4, 4)
    np.testing.assert_array_equal(entered["look-up"], chain.schedules["look-up"].batch(exact.where))
    assert set(noisy.contenders) == {"best constant", "nn", "anfis", "optimum"}
    np.testing.assert_array_equal(noisy.costs["optimum"], exact.costs["optimum"])  # it looks at neither
    assert (noisy.costs["anfis"] != exact.costs["anfis"]).any()
    assert set(exact.adaptive) == {"look-up", "nn", "anfis"}


@pytest.mark.compiled
def test_the_optimum_is_the_best_of_what_was_searched_on_the_noise_of_the_choice(chain):
    points = evaluation.evaluation_points(chain.task, 2, 7)
    constants = np.array([[29, 5, 1.0, 4000.0], [42, 3, 1.0, 1e4]])
    tunings = evaluation.find_optimum(chain.task, chain.task.evaluated_plant, points, 7, constants)
    objective = Objective(
        chain.task.evaluated_plant, chain.task.mpc, "lane-change", "road", evaluation.CHOICE_NOISE,
        failure=adaptation.FAILURE,
    )  # fmt: skip
    for point, tuning in zip(points, tunings, strict=True):
        assert objective.costs(point, [tuning])[0] <= objective.costs(point, constants).min()
    none = np.empty((0, 4))
    plant = chain.task.evaluated_plant
    first, second = (evaluation.find_optimum(chain.task, plant, points, seed, none) for seed in (7, 8))
    assert (first != second).any(), "the seed selects the swarms"


@pytest.mark.compiled
def test_on_drives_and_tests_the_reference_is_the_constant_that_was_tuned_on_drives(chain):
    drives = evaluate_on_drives(chain.task, some_schedules(), 2, 7)["exact"]
    tests = evaluate_on_tests(chain.task, some_schedules())
    assert set(tests) == set(PAPER_MSE)
    assert drives.where[:, 0].tolist() == [3_070_000.0, 3_070_001.0]
    for comparison in (drives, *tests.values()):
        assert set(comparison.contenders) == set(EVALUATED)
        assert (comparison.regret("best constant") == 1.0).all()
    swapped = some_schedules()
    swapped["nn"] = swapped["best constant on drives"]
    comparison = evaluate_on_drives(chain.task, swapped, 2, 7)["exact"]
    np.testing.assert_array_equal(comparison.costs["nn"], drives.costs["best constant"])


def test_a_schedule_that_ships_is_loaded_by_its_contender():
    assert shipped_schedules()["best constant on drives"].name == "road-best-constant-on-drives"
    assert scheduling.load_scheduler("road-nn").guard is not None
