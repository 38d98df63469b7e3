"""A data set survives its file bit for bit, keeps twins together, and is summarised and drawn."""

import dataclasses
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from adaptrack.base import files
from adaptrack.base.errors import InvalidInput, StorageError, UnknownName
from adaptrack.paper import data_set as module
from adaptrack.paper.campaign_config import CampaignPlan, load_campaign
from adaptrack.paper.data_set import SUMMARY_TARGETS, DataSet, describe, flatness, list_datasets, load_dataset
from adaptrack.paper.operating_points import Grid, fold, mirrored, sobol
from adaptrack.results import dataset as pictures
from adaptrack.results.dataset import dataset_result
from adaptrack.results.page import write_result
from adaptrack.results.style import panel_figure

BOX = {"speed": (3.0, 30.0), "y_ref": (-15.0, 15.0), "friction": (0.3, 1.0), "wind": (-30.0, 30.0)}
ARRAYS = [field.name for field in dataclasses.fields(DataSet) if field.name != "provenance"]


def wild(n=60, size=7, start=1, **changes):
    """Every array with numbers of its own, infinity among the costs."""
    rng = np.random.default_rng(start)
    costs, landscape = rng.exponential(size=n), rng.exponential(size=(n, size)).astype(np.float32)
    costs[-1] = landscape[-2:] = np.inf
    weights = 10.0 ** rng.uniform((-1, -3), (1, -1), (n, 2))
    tunings = np.column_stack([rng.integers(20, 50, n), rng.integers(1, 18, n), weights])
    arrays = {
        "operating_points": sobol(n, BOX, start), "tunings": tunings, "costs": costs, "standard_costs": 2.0 * costs,
        "traces": rng.exponential(size=(n, 4)).astype(np.float32), "landscape": landscape,
        "library": rng.uniform(1, 9, (size, 4)), "evaluations": np.full(n, 20),
        "control_steps": rng.integers(1, 9999, n), "stream": np.arange(n), "mirrored_from": np.full(n, -1),
        "seed": np.full(n, 3), "provenance": {"name": "wild", "settings": {"profile": "road", "µ": None}},
    }  # fmt: skip
    return DataSet(**(arrays | changes))


def same(a, b):
    for name in ARRAYS:
        first, second = getattr(a, name), getattr(b, name)
        assert first.dtype == second.dtype, name
        assert first.tobytes() == second.tobytes(), name
    assert a.provenance == b.provenance


# -- the file ---------------------------------------------------------------------------------------------------------
def test_a_file_gives_back_every_bit_and_all_provenance(tmp_path):
    wild().save(tmp_path / "wild.parquet")
    same(DataSet.load(tmp_path / "wild.parquet"), wild())


def test_loading_a_data_set_loads_neither_compiler_nor_learner(run_python):
    code = "import sys, adaptrack.paper as paper; paper.load_dataset('paper-grid'); print(*sys.modules)"
    assert not {"numba", "sklearn", "matplotlib", "pandas"} & set(run_python(code=code).split())


def test_the_shipped_data_sets_load_and_name_their_command():
    for name in list_datasets():
        data = load_dataset(name)
        assert data.name == name
        assert data.command == f"adaptrack paper campaign {name} --out {name}"
        plan = CampaignPlan.of(load_campaign(name))
        assert data.provenance["settings"] == plan.settings
        np.testing.assert_array_equal(data.operating_points, plan.operating_points)
        np.testing.assert_allclose(data.library, plan.library, rtol=1e-15)  # what was sampled then
        assert data.landscape.shape == (len(data), len(data.library))


def test_a_damaged_or_edited_file_is_refused_with_its_name(tmp_path):
    file = tmp_path / "wild.parquet"
    wild().save(file)
    content, table = file.read_bytes(), pq.read_table(file)
    changed = bytearray(content)
    changed[3000] ^= 16
    for harm in (b"", b"not parquet", content[:-20], content[: len(content) // 2], bytes(changed)):
        file.write_bytes(harm)
        with pytest.raises(StorageError, match=r"wild\.parquet: .*damaged"):
            load_dataset(file)
    metadata = table.schema.metadata
    forged = json.dumps({**json.loads(metadata[b"about"]), "name": "better"}, sort_keys=True)
    pq.write_table(table.replace_schema_metadata({**metadata, b"about": forged.encode()}), file)
    with pytest.raises(StorageError, match="the checksum of its content does not fit"):
        load_dataset(file)
    pq.write_table(table.drop_columns(["cost"]), file)
    with pytest.raises(StorageError, match="there is no column 'cost'"):
        load_dataset(file)


def test_other_versions_tables_and_folders_are_refused_with_the_remedy(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "DATA_SET_VERSION", 2)
    wild().save(tmp_path / "wild.parquet")
    monkeypatch.undo()
    pq.write_table(pa.table({"x": [1.0]}), tmp_path / "x.parquet")
    for path, words in (
        (tmp_path / "wild.parquet", "format version 2, this adaptrack reads version 1: run its campaign again"),
        (tmp_path / "x.parquet", "holds no data set, but a table of another program"),
        (tmp_path / "missing.parquet", "cannot be read: No such file"),
        (tmp_path, r"holds no dataset\.parquet; if its campaign is not finished, run"),
    ):
        with pytest.raises(StorageError, match=words):
            load_dataset(path)


def test_an_unknown_name_is_answered_with_the_nearest(monkeypatch, tmp_path):
    (tmp_path / "datasets").mkdir()
    wild().save(tmp_path / "datasets" / "paper-grid.parquet")
    monkeypatch.setattr(files, "SHIPPED", tmp_path)
    assert list_datasets() == ["paper-grid"]
    assert load_dataset("paper-grid").name == "wild"
    with pytest.raises(UnknownName, match=r"no dataset is named 'paper_grid'\. Did you mean 'paper-grid'"):
        load_dataset("paper_grid")
    for nonsense in ("x" * 10_000, "[red]", "a\0b"):
        with pytest.raises(UnknownName, match="no dataset is named"):
            load_dataset(nonsense)


# -- the record -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", sorted(set(ARRAYS) - {"operating_points"}))
def test_an_array_of_the_wrong_length_is_refused_by_name(name):
    with pytest.raises(InvalidInput, match=f"`{name if name != 'library' else 'landscape'}` must have the shape"):
        wild(**{name: getattr(wild(), name)[:5]})


def test_arrays_cannot_be_written_to():
    data = wild()
    for name in ARRAYS:
        with pytest.raises(ValueError, match="read-only"):
            getattr(data, name)[0] = 0


def test_the_best_known_cost_is_the_swarms_or_the_librarys():
    data = wild()
    np.testing.assert_array_equal(
        data.best_costs, [min(data.costs[i], data.landscape[i].min()) for i in range(len(data))]
    )
    assert np.isinf(data.best_costs[-1])
    np.testing.assert_allclose(data.ratios, data.tunings[:, 3] / data.tunings[:, 2])


def test_rows_are_chosen_by_number_or_by_truth():
    data = wild()
    np.testing.assert_array_equal(data.rows([5, 2]).stream, [5, 2])
    np.testing.assert_array_equal(data.rows(data.stream < 4).costs, data.costs[:4])
    np.testing.assert_array_equal(data.rows([5]).library, data.library)


# -- hold-out ---------------------------------------------------------------------------------------------------------
def test_a_split_is_the_same_every_time_another_for_another_seed_and_loses_nothing():
    data = wild(200)
    learn, holdout = data.split(0.25, seed=1)
    assert (len(learn), len(holdout)) == (150, 50)
    assert sorted([*learn.stream, *holdout.stream]) == list(range(200))
    np.testing.assert_array_equal(holdout.stream, data.split(0.25, seed=1)[1].stream)
    assert set(holdout.stream) != set(data.split(0.25, seed=2)[1].stream)


@pytest.mark.parametrize("seed", range(3))
def test_twins_are_always_on_the_same_side_of_a_split(seed):
    # Also when the campaign computed both of them.
    rows = Grid(speed=[5.0, 10.0, 15.0], y_ref=[-4.0, 1.0, 4.0], friction=[0.5, 0.9], wind=[-6.0, 0.0, 6.0]).rows()
    data = wild(len(rows), operating_points=rows)
    learn, holdout = data.split(0.3, seed)
    both = {tuple(row) for row in learn.operating_points} & {tuple(row) for row in mirrored(holdout.operating_points)}
    assert not both
    assert len(holdout) + len(learn) == len(rows)
    assert len(fold(holdout.operating_points).representatives) == round(0.3 * len(fold(rows).representatives))


@pytest.mark.parametrize("fraction", [0.0, 1.0, -0.1, 0.001, float("nan")])
def test_a_split_with_an_empty_part_is_refused(fraction):
    with pytest.raises(InvalidInput, match="fraction"):
        wild().split(fraction)


# -- what is in it ----------------------------------------------------------------------------------------------------
def test_flatness_is_the_share_of_the_library_near_the_best():
    costs = np.array([1.0, 2.0, 1.0])
    landscape = np.array([[1.0, 1.04, 1.1, 3.0], [1.0, 1.04, 1.1, np.inf], [1.21, 1.3, 1.4, 1.5]])
    data = wild(3, 4, costs=costs, standard_costs=costs, landscape=landscape, mirrored_from=[-1, -1, -1])
    assert flatness(data, 0.05) == pytest.approx([0.5, 0.5, 0.0])  # of the third, the swarm knows better
    assert flatness(data, 0.2) == pytest.approx([0.75, 0.75, 0.0])
    twins = dataclasses.replace(data, mirrored_from=[-1, 0, -1])
    assert len(flatness(twins, 0.05)) == 2  # twins count once
    lost = dataclasses.replace(data, costs=[np.inf, 2.0, 1.0], landscape=np.full((3, 4), np.inf))
    assert flatness(lost, 0.05) == pytest.approx([0.0, 0.0])  # a condition that fails with every tuning is not flat


def test_a_summary_is_plain_json():
    data = load_dataset("paper-grid")
    summary = describe(data)
    assert json.loads(json.dumps(summary, allow_nan=False)) == summary
    assert (summary["operating_points"], summary["computed"], summary["library"]) == (6435, 5005, 160)
    assert [summary[key] for key in ("profile", "scenario", "vehicle", "tyre")] == [
        "paper", "step", "paper", "magic-formula",
    ]  # fmt: skip
    assert summary["ranges"][1] == {"quantity": "y_ref", "unit": "m", "lowest": -14.0, "highest": 14.0, "levels": 9}
    assert [row["target"] for row in summary["optimum"]] == list(SUMMARY_TARGETS)
    assert summary["optimum"][0]["lowest"] == data.tunings[data.computed, 0].min()
    assert [row["within"] for row in summary["flatness"]] == [0.05, 0.2]
    assert summary["costs"]["standard_over_best_geomean"] > 1.0


def test_optima_at_the_bounds_of_the_search_are_counted():
    search = {"Np": [1, 55], "Nc": [1, 18], "Q": [0.1, 10.0], "R": [0.001, 0.1]}
    tunings = [[55.0, 3.0, 10.0, 0.001], [30.0, 1.0, 1.0, 0.01], [1.0, 1.0, 0.1, 0.1], [20.0, 9.0, 10.0, 0.1]]
    data = wild(4, tunings=tunings, costs=[1.0] * 4, provenance={"settings": {"search": search}})
    shares = {row["target"]: row["at_a_bound"] for row in describe(data)["optimum"]}
    assert shares == {"Np": 0.5, "Nc": 0.5, "log Q": 0.75, "log R": 0.75, "log R/Q": 0.5}


def test_a_description_survives_operating_points_where_every_tuning_fails():
    n = 60
    data = wild(n, costs=np.full(n, np.inf), standard_costs=np.full(n, np.inf), landscape=np.full((n, 7), np.inf))
    summary = describe(data)
    assert json.dumps(summary, allow_nan=False)
    assert (summary["costs"]["failed_by_all"], summary["costs"]["library_failed"]) == (60, 1.0)


# -- pages ------------------------------------------------------------------------------------------------------------
def test_a_cell_of_a_map_is_the_median_of_its_operating_points():
    points = Grid(speed=(5.0, 10.0, 15.0), y_ref=(-4.0, 4.0, 8.0), friction=(0.5, 0.9), wind=(-10.0, 0.0, 10.0)).rows()
    data = wild(len(points), operating_points=points)
    (cells,) = panel_figure(pictures.optimum_maps(data)[3]).axes[0].collections
    members = (points[:, 0] == 10.0) & (points[:, 2] == 0.9)
    assert cells.get_array().shape == (2, 3)
    assert cells.get_array()[1][1] == np.median(data.tunings[members, 0])


def test_a_gain_is_the_median_ratio_of_the_costs_in_each_bin():
    points = Grid(speed=(5.0, 10.0), y_ref=(4.0,), friction=(0.5, 0.9), wind=(0.0,)).rows()
    data = wild(4, operating_points=points, costs=np.ones(4), standard_costs=[2.0, 4.0, 80.0, 80.0])
    line = panel_figure(pictures.gain_panel(data)).axes[0].lines[1]
    assert (list(line.get_xdata()), list(line.get_ydata())) == ([5.0, 10.0], [3.0, 80.0])


@pytest.mark.parametrize("lost", [False, True])
def test_a_page_is_written_also_where_every_run_failed(tmp_path, lost):
    failures = {"costs": np.full(60, np.inf), "landscape": np.full((60, 7), np.inf)}
    data = wild(provenance={"name": "made <b>"}, **(failures if lost else {}))
    result = dataset_result(data)
    for table in result.tables:
        names = [column.name for column in table.columns]
        assert len(set(names)) == len(names)
        assert all(set(names) <= row.keys() for row in table.rows)
    text = write_result(tmp_path, result).read_text()
    assert "made &lt;b&gt;" in text
    assert ("<svg role" in text) is not lost
