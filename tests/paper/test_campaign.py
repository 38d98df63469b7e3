"""A campaign depends on its configuration only: killed, continued or shared out, it ends in the same bytes."""

import dataclasses
import hashlib
import importlib.util
import json
import os
import sys
from pathlib import Path

import numpy as np
import pytest

import adaptrack as at
from adaptrack.paper import campaign as module
from adaptrack.paper.campaign import run_campaign, tuned_mpc
from adaptrack.paper.campaign_config import (
    STANDARD_ROW,
    CampaignPlan,
    TuningLibrary,
    list_campaigns,
    load_campaign,
    spread_tunings,
)
from adaptrack.paper.data_set import DataSet, load_dataset
from adaptrack.paper.operating_points import fold
from adaptrack.tuning.pso import SearchBounds
from small_data import small_campaign


def digest(path: Path) -> str:
    return hashlib.sha256(Path(path).read_bytes()).hexdigest()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of the small campaign, computed without interruption."""
    return run_campaign(small_campaign(), tmp_path_factory.mktemp("whole"), workers=1).parent


@pytest.fixture(scope="module")
def checksum(folder):
    return digest(folder / "dataset.parquet")


@pytest.fixture
def toml(tmp_path):
    """Write a campaign file; `changes` replace, add or (None) remove top-level lines."""
    lines = {
        "profile": '"paper"',
        "scenario": '"step"',
        "operating_points": '{ kind = "grid", speed = [10.0], y_ref = [2.0], friction = [0.9], wind = [0.0] }',
    }

    def write(**changes):
        text = "".join(f"{key} = {value}\n" for key, value in {**lines, **changes}.items() if value is not None)
        path = tmp_path / "my-campaign.toml"
        path.write_text(text)
        return path

    return write


# -- the configuration ------------------------------------------------------------------------------------------------
def test_the_shipped_campaigns_are_those_of_the_paper_and_of_the_road():
    assert set(list_campaigns()) == {"paper-grid", "road-sobol"}
    assert all(list_campaigns().values())
    paper, road = (CampaignPlan.of(load_campaign(name)) for name in ("paper-grid", "road-sobol"))
    assert len(paper.operating_points) == 6435
    assert (paper.config.swarm.particles, paper.config.swarm.generations, paper.config.duration) == (20, 15, 18.0)
    assert (paper.config.profile, paper.config.scenario, paper.config.move_weight) == ("paper", "step", 0.0)
    assert len(paper.fold.representatives) == 5005
    assert len(road.operating_points) == len(road.fold.representatives) == 6400
    assert road.operating_points.min(axis=0) == pytest.approx([3, -7, 0.3, -30], abs=0.02)
    assert road.operating_points.max(axis=0) == pytest.approx([30, 7, 1.0, 30], abs=0.02)
    assert (road.config.profile, road.config.scenario, road.config.move_weight) == ("road", "lane-change", 3.0)
    assert len(road.config.noise_seeds) > 1


def test_a_campaign_tunes_the_papers_controller_in_the_loop_of_its_profile(toml):
    published = tuned_mpc(CampaignPlan.of(load_campaign(toml(profile='"road"'))).setup)
    assert (published.is_published, published.preview, published.period) == (True, True, 0.05)


def test_the_cars_steering_does_not_count_and_a_profile_counts_by_its_content(toml, tmp_path):
    cars, profiles, world = set(), set(), at.load_profile("road")
    for lag in (0.1, 0.2):
        at.load_vehicle("paper").replace(steering=at.Steering(lag=lag)).to_toml(tmp_path / "mine.toml")
        cars.add(CampaignPlan.of(load_campaign(toml(vehicle='"mine.toml"'))).identity)
        world.replace(name="lab", steering=world.steering.replace(lag=lag)).to_toml(tmp_path / "lab.toml")
        profiles.add(CampaignPlan.of(load_campaign(toml(profile='"lab.toml"'))).identity)
    assert (len(cars), len(profiles)) == (1, 2)


def test_a_file_needs_little_and_takes_its_name_from_itself(toml):
    config = load_campaign(toml())
    assert config.name == "my-campaign"
    settled = config.settled()
    assert (settled.duration, settled.move_weight, settled.noise_seeds, settled.mirror) == (18.0, 0.0, (0,), True)
    road = config.replace(profile="road", scenario="lane-change").settled()
    assert (road.duration, road.move_weight, road.noise_seeds, road.mirror) == (8.0, 3.0, (0, 1, 2, 3), False)


@pytest.mark.parametrize(("changes", "message"), [
    ({"sede": "3"}, r"sede: unknown key\. Did you mean 'seed'\?"),
    ({"swarm": "{ particels = 3 }"}, r"swarm\.particels: unknown key\. Did you mean 'particles'\?"),
    ({"profile": None}, "profile: missing"),
    ({"profile": '"papers"'}, "no profile is named 'papers'. Did you mean 'paper'"),
    ({"scenario": '"slalom"'}, "scenario = 'slalom': must be one of 'step', 'lane-change'"),
    ({"duration": "-1.0"}, "duration = -1.0: must be a finite number > 0"),
    ({"seed": "-1"}, "seed = -1: must be a whole number >= 0"),
    ({"noise_seeds": "[]"}, "give one seed at least"),
    ({"noise_seeds": "[1, 2]"}, "profile 'paper' has no noise"),
    ({"noise_seeds": "[1, 1]", "profile": '"road"'}, "noise_seeds: one is given twice"),
    ({"name": '"a/b"'}, "name = 'a/b'"),
    ({"operating_points": '{ kind = "grids" }'}, "operating_points.kind = 'grids': unknown. Did you mean 'grid'?"),
    ({"operating_points": '{ kind = "grid", speed = [1000.0], y_ref = [2.0], friction = [0.9], wind = [0.0] }'},
     r"speed = 1000 in row 0: must be in \[1, 100\] m/s"),
    (
        {
            "operating_points": '{ kind = "sobol", n = 4, box = '
            "{ speed = [30.0, 3.0], y_ref = [-1.0, 1.0], friction = [0.5, 0.9], wind = [0.0, 1.0] } }"
        },
        r"speed = \[30, 3\] is empty",
    ),
    ({"search": "{ Nc = [10, 18], Np = [5, 55] }"}, "Nc from 10 and Np from 5: the lower bounds violate Nc <= Np"),
    ({"search": "{ Np = [20, 10] }"}, r"Np = \[20, 10\] is empty"),
    ({"search": "{ Q = [0.0, 10.0] }"}, r"Q = \[0, 10\]: must be > 0"),
    ({"search": "{ Np = [1, 1000] }"}, "must not exceed 500"),
    ({"library": "{ size = 0 }"}, "library.size = 0: must be a whole number >= 1"),
    ({"library": "{ tunings = [[5.0, 8.0, 1.0, 0.1]] }"}, r"need whole numbers 1 <= Nc <= Np"),
    ({"library": "{ size = 3, tunings = [[9.0, 8.0, 1.0, 0.1]] }"}, "size and seed have no use"),
    ({"sede": "1", "chunk": "0", "profile": '"x"'}, r"(?s)my-campaign\.toml: 3 problems:.*profile.*chunk.*sede"),
    ({"vehicle": '"papre"'}, "no vehicle is named 'papre'. Did you mean 'paper'?"),
    ({"tyre": '"no-such.toml"'}, "no-such.toml: cannot be read"),
])  # fmt: skip
def test_a_bad_configuration_is_one_clear_error_before_any_work_starts(toml, tmp_path, changes, message):
    with pytest.raises(at.AdaptrackError, match=message):
        run_campaign(load_campaign(toml(**changes)), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_files_of_car_and_tyre_are_looked_for_beside_the_campaign(toml, tmp_path):
    at.load_vehicle("paper").replace(name="heavy", mass=2000.0).to_toml(tmp_path / "heavy.toml")
    at.load_tyre("passenger-car").replace(name="mine").to_toml(tmp_path / "mine.toml")
    plan = CampaignPlan.of(load_campaign(toml(vehicle='"heavy.toml"', tyre='"mine.toml"')))
    assert plan.settings["vehicle"]["mass"] == 2000.0
    assert plan.settings["tyre"]["name"] == "mine"
    assert str(tmp_path) not in json.dumps(plan.settings)  # the identity is the same in another folder


def test_the_identity_changes_with_everything_that_the_data_depend_on_and_with_nothing_else(toml, tmp_path):
    car = at.load_vehicle("paper").replace(name="heavy")
    car.to_toml(tmp_path / "heavy.toml")
    base = CampaignPlan.of(load_campaign(toml(vehicle='"heavy.toml"'))).identity
    for changes in ({"chunk": "7"}, {"description": '"words"'}, {"duration": "18.0"}, {"mirror": "true"}):
        assert CampaignPlan.of(load_campaign(toml(vehicle='"heavy.toml"', **changes))).identity == base, changes
    for other in (
        {"seed": "1"},
        {"duration": "17.0"},
        {"move_weight": "0.5"},
        {"profile": '"road"'},
        {"scenario": '"lane-change"'},
        {"plant": '"single-track"'},
        {"swarm": "{ particles = 21 }"},
        {"search": "{ Np = [1, 54] }"},
        {"library": "{ seed = 1 }"},
        {"tyre": '"passenger-car"'},
        {"noise_seeds": "[1]"},
        {"mirror": "false"},
    ):
        assert CampaignPlan.of(load_campaign(toml(vehicle='"heavy.toml"', **other))).identity != base, other
    car.replace(mass=car.mass + 1.0).to_toml(tmp_path / "heavy.toml")  # the same name, another car
    assert CampaignPlan.of(load_campaign(toml(vehicle='"heavy.toml"'))).identity != base


def test_the_identity_is_that_of_the_settings_whatever_the_last_digit_of_a_sampled_number_is(toml):
    plan = CampaignPlan.of(load_campaign(toml()))
    other = dataclasses.replace(plan, library=np.nextafter(plan.library, np.inf))
    assert other.identity == plan.identity


# -- the library ------------------------------------------------------------------------------------------------------
def test_the_library_begins_with_the_papers_tuning_and_stays_within_the_search():
    search = SearchBounds(Np=(4, 40), Nc=(2, 12), Q=(0.5, 5.0), R=(0.01, 0.2))
    library = spread_tunings(200, search, 1)
    assert library.shape == (200, 4)
    assert tuple(library[0]) == STANDARD_ROW == (35.0, 8.0, 10.0, 0.01)
    Np, Nc, Q, R = library[1:].T
    assert search.space().contains(library[1:]).all()
    assert set(Np) == set(range(4, 41))
    assert set(Nc) == set(range(2, 13))
    assert len(np.unique(library, axis=0)) == 200
    # The ratio covers all that the bounds allow, evenly in its logarithm.
    low, high = np.log(0.01 / 5.0), np.log(0.2 / 0.5)
    shares = np.histogram(np.log(R / Q), 8, (low, high))[0]
    assert shares.sum() == 199
    assert (np.abs(shares - 199 / 8) <= 2).all()


def test_an_explicit_library_is_taken_as_it_is():
    rows = [[10.0, 4.0, 1.0, 0.01], [20.0, 4.0, 1.0, 0.01]]
    np.testing.assert_array_equal(TuningLibrary(tunings=rows).rows(SearchBounds()), rows)


@pytest.mark.parametrize("standard_first", [True, False])
def test_the_standard_cost_is_that_of_the_papers_tuning_wherever_it_stands(tmp_path, folder, standard_first):
    rows = [[10.0, 4.0, 1.0, 0.01], [20.0, 4.0, 1.0, 0.01]]
    library = TuningLibrary(tunings=[list(STANDARD_ROW), *rows] if standard_first else rows)
    data = load_dataset(run_campaign(small_campaign(library=library), tmp_path, workers=1))
    np.testing.assert_array_equal(data.standard_costs, load_dataset(folder).standard_costs)
    assert data.landscape.shape == (12, len(library.tunings))


# -- the data ---------------------------------------------------------------------------------------------------------
def test_twins_are_computed_once_and_name_the_point_that_was_computed(folder):
    data = load_dataset(folder)
    plan = CampaignPlan.of(small_campaign())
    np.testing.assert_array_equal(data.operating_points, plan.operating_points)
    assert data.computed.sum() == len(plan.fold.representatives) == 8
    for copy in np.flatnonzero(~data.computed):
        origin = data.mirrored_from[copy]
        np.testing.assert_array_equal(data.operating_points[copy], data.operating_points[origin] * [1, -1, 1, -1])
        assert data.costs[copy] == data.costs[origin]
    assert set(data.provenance["versions"]) == {"adaptrack", "kernels", "numpy"}
    assert (data.costs <= data.traces[:, 0] * (1 + 1e-6)).all()
    np.testing.assert_allclose(data.landscape[:, 0], data.standard_costs, rtol=1e-6)


def test_the_ideal_car_costs_the_same_at_an_operating_point_and_at_its_mirror_image(tmp_path):
    # What `mirror` relies on, to rounding: the swarm of the twin is not run, its landscape would be this one.
    data = load_dataset(run_campaign(small_campaign(mirror=False, library={"size": 40}), tmp_path, workers=1))
    twins = fold(data.operating_points)
    np.testing.assert_allclose(
        data.landscape, data.landscape[twins.representatives[twins.family]], rtol=1e-5, equal_nan=False
    )


def test_sensor_noise_is_not_symmetric_so_nothing_is_mirrored_there():
    plan = CampaignPlan.of(small_campaign(profile="road", scenario="lane-change"))
    assert len(plan.fold.representatives) == len(plan.operating_points)


@pytest.mark.parametrize(("workers", "chunk"), [(2, 2), (1, 5)])
def test_any_number_of_processes_and_any_size_of_part_gives_the_same_bytes(tmp_path, checksum, workers, chunk):
    assert digest(run_campaign(small_campaign(chunk=chunk), tmp_path, workers=workers)) == checksum


def test_progress_counts_the_operating_points_to_compute(tmp_path, folder):
    reports = []
    copy_parts(folder, tmp_path, [0])
    run_campaign(small_campaign(), tmp_path, workers=1, progress=lambda *report: reports.append(report))
    assert reports == [("campaign", steps, 6) for steps in range(1, 7)]


# -- parts ------------------------------------------------------------------------------------------------------------
def copy_parts(folder: Path, target: Path, numbers) -> None:
    (target / "parts").mkdir(parents=True, exist_ok=True)
    for number in numbers:
        name = f"parts/{number:05d}.parquet"
        (target / name).write_bytes((folder / name).read_bytes())


def test_parts_that_are_there_are_not_computed_again(tmp_path, folder, checksum, monkeypatch):
    copy_parts(folder, tmp_path, range(4))
    monkeypatch.setattr(module, "tune_point", None)
    assert digest(run_campaign(small_campaign(), tmp_path)) == checksum


def test_an_interrupted_campaign_keeps_its_parts_and_continues_to_the_same_bytes(tmp_path, checksum):
    def interrupt(stage, steps, total):
        if steps == 5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_campaign(small_campaign(), tmp_path, workers=1, progress=interrupt)
    assert [file.name for file in sorted((tmp_path / "parts").iterdir())] == ["00000.parquet", "00001.parquet"]
    assert digest(run_campaign(small_campaign(), tmp_path, workers=1)) == checksum


KILLED = """
import os, random, signal, sys, time
from pathlib import Path
sys.path.insert(0, sys.argv[2])
from adaptrack.paper.campaign import run_campaign
from small_data import small_campaign

out, rng, killed = Path(sys.argv[1]), random.Random(1), 0
while True:
    child = os.fork()
    if not child:
        run_campaign(small_campaign(chunk=1), out, workers=1)
        os._exit(0)
    if killed < 8:
        time.sleep(rng.uniform(0.05, 0.3))
        os.kill(child, signal.SIGKILL)
    status = os.waitpid(child, 0)[1]
    killed += os.WIFSIGNALED(status)
    if os.WIFEXITED(status):
        break
assert os.waitstatus_to_exitcode(status) == 0
print(killed)
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_killed_at_random_times_it_ends_in_the_same_bytes(run_python, project, tmp_path, checksum):
    assert int(run_python(str(tmp_path), str(project / "tests"), code=KILLED)) >= 1
    assert digest(tmp_path / "dataset.parquet") == checksum


def test_of_two_writers_the_last_wins_with_equal_bits(tmp_path, folder, checksum):
    """Another process writes every part between our check and our rename."""

    def other_writer(stage, steps, total):
        copy_parts(folder, tmp_path, range(4))

    assert digest(run_campaign(small_campaign(), tmp_path, workers=1, progress=other_writer)) == checksum
    for number in range(4):
        name = f"parts/{number:05d}.parquet"
        assert (tmp_path / name).read_bytes() == (folder / name).read_bytes()


def edit_versions(file: Path) -> None:
    part = DataSet.load(file)
    versions = {**part.provenance["versions"], "kernels": "another"}
    dataclasses.replace(part, provenance={**part.provenance, "versions": versions}).save(file)


@pytest.mark.parametrize(("changes", "edit", "words"), [
    ({"seed": 4}, None, r"00000\.parquet: was computed with other settings \(seed = 3 there, 4 here\): choose"),
    ({"chunk": 3}, None, "holds other operating points; was `chunk` changed"),
    ({}, edit_versions, "was computed with other software .*another there"),
    ({}, lambda file: file.write_bytes(file.read_bytes()[:-20]), r"00000\.parquet: .*damaged.*Remove this part"),
])  # fmt: skip
def test_a_part_that_does_not_belong_here_is_refused_before_any_work(
    tmp_path, folder, monkeypatch, changes, edit, words
):
    copy_parts(folder, tmp_path, [0])
    if edit is not None:
        edit(tmp_path / "parts" / "00000.parquet")
    monkeypatch.setattr(module, "tune_point", None)
    with pytest.raises(at.StorageError, match=words):
        run_campaign(small_campaign(**changes), tmp_path, workers=1)


def test_a_part_that_cannot_be_written_is_a_storage_error_and_leaves_nothing_torn(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "replace", lambda *paths: (_ for _ in ()).throw(OSError(28, "No space left on device")))
    with pytest.raises(at.StorageError, match=r"00000\.parquet: cannot be written: No space left"):
        run_campaign(small_campaign(), tmp_path, workers=1)
    assert not list((tmp_path / "parts").iterdir())


def test_a_folder_that_cannot_be_created_is_refused(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(at.StorageError, match="cannot be created"):
        run_campaign(small_campaign(), tmp_path / "file" / "out")


# -- workers ----------------------------------------------------------------------------------------------------------
def test_a_worker_with_other_software_is_refused():
    setup, software = CampaignPlan.of(small_campaign()).setup, (("adaptrack", "0.0.1"),)
    with pytest.raises(at.AdaptrackError, match="a worker runs other software"):
        module.tune_point(setup, software, 0, np.array([10.0, 2.0, 0.8, 0.0]))


@pytest.mark.parametrize(("options", "error", "words"), [
    ({"workers": 0}, at.InvalidInput, "workers"),
    ({"workers": 1, "cluster": "tcp://127.0.0.1:1"}, at.InvalidInput, "give one of them"),
    ({"cluster": "tcp://127.0.0.1:1"}, at.MissingExtra, r"python -m pip install 'adaptrack\[cluster\]'"),
])  # fmt: skip
def test_impossible_workers_are_refused_and_a_missing_dask_is_answered_with_the_command(
    tmp_path, monkeypatch, options, error, words
):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(error, match=words):
        run_campaign(small_campaign(), tmp_path, **options)


needs_dask = pytest.mark.skipif(importlib.util.find_spec("distributed") is None, reason="needs the extra [cluster]")

ON_DASK = """
import sys
sys.path.insert(0, sys.argv[1])
from distributed import LocalCluster
from adaptrack.paper.campaign import run_campaign
from small_data import small_campaign

if __name__ == "__main__":
    local = {"threads_per_worker": 1, "host": "127.0.0.1", "dashboard_address": None, "silence_logs": 50}
    with LocalCluster(n_workers=2, **local) as cluster:
        run_campaign(small_campaign(), "out", cluster=cluster.scheduler_address)
    with LocalCluster(n_workers=0, **local) as cluster:
        try:
            run_campaign(small_campaign(), "nothing", cluster=cluster.scheduler_address)
        except Exception as error:
            print(error)
"""


@needs_dask
@pytest.mark.slow
def test_a_dask_cluster_gives_the_same_bytes_and_one_without_workers_is_refused(
    run_python, project, tmp_path, checksum
):
    script = tmp_path / "on_dask.py"  # a file: the workers import it, too
    script.write_text(ON_DASK)
    printed = run_python(str(script), str(project / "tests"), cwd=tmp_path)
    assert digest(tmp_path / "out" / "dataset.parquet") == checksum
    assert "the scheduler has no workers; start one: dask worker tcp://127.0.0.1:" in printed


@needs_dask
@pytest.mark.parametrize(("address", "words"), [
    ("tcp://127.0.0.1:9", "no Dask scheduler answers there"),
    ("localhost", "not an address; give one like tcp://127.0.0.1:8786"),
    ("tcp://127.0.0.1:99999", "not an address"),
])  # fmt: skip
@pytest.mark.filterwarnings("ignore")
def test_an_address_without_a_scheduler_is_refused(tmp_path, address, words):
    with pytest.raises(at.InvalidInput, match=words):
        run_campaign(small_campaign(), tmp_path, cluster=address)
