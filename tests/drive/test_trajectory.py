"""A trajectory is checked at the door, says its errors with a sign, and survives its file bit for bit."""

import json
import os
from datetime import UTC, datetime

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given
from hypothesis import strategies as st

import adaptrack as at
from adaptrack import __version__
from adaptrack.drive.trajectory import TRAJECTORY_COLUMNS, provenance
from made_drives import blank_columns


def record(n=8, period=0.1, **changes):
    """A car that stands on its reference; `changes` replace arrays."""
    arrays = blank_columns(n) | {"t": period * np.arange(n), "vx": np.full(n, 10.0), "friction": np.ones((n, 4))}
    return at.Trajectory(**(arrays | {"period": period} | named(n) | changes))


def named(n):
    """What an MPC adds: its tuning and its diagnostics, all zero."""
    integers, real = np.zeros(n, np.int64), np.zeros(n)
    return {
        "tuning": {"Np": integers, "Nc": integers, "Q": real, "R": real},
        "diagnostics": {"qp_status": integers, "qp_iterations": integers, "qp_residual": real, "at_limit": integers},
        "units": {"tuning.Q": "1/m^2", "tuning.R": "1/rad^2"},
    }


def wild(n=50, seed=1):
    """Every column with numbers of its own, NaN and infinity among them."""
    rng = np.random.default_rng(seed)
    arrays = {}
    for column in TRAJECTORY_COLUMNS:
        shape = (n, len(column.parts)) if column.parts else (n,)
        top = 20 if column.dtype.kind == "f" else 15
        arrays[column.name] = (rng.normal(size=shape) * 10.0 ** rng.integers(-20, top, shape)).astype(column.dtype)
    arrays["t"] = 0.05 * np.arange(n) + 3.0
    residual = rng.normal(size=n)
    residual[3] = np.nan
    arrays["Y"][-1] = np.inf
    arrays["vy"][-1] = -0.0
    return at.Trajectory(
        **arrays, period=0.05, tuning={"Np": rng.integers(1, 60, n), "gain": rng.normal(size=n)},
        diagnostics={"qp_residual": residual, "saturated": rng.normal(size=n) > 0}, units={"tuning.gain": "1/s"},
        failed="off-road", failed_at=5.1, meta={"scenario": "step", "limits": (1, 2.5), "µ": None},
    )  # fmt: skip


def test_a_file_gives_back_every_bit_and_all_provenance(tmp_path):
    before = wild()
    before.save(tmp_path / "run.parquet")
    after = at.Trajectory.load(tmp_path / "run.parquet")
    same(before, after)


def same(before, after):
    assert list(before.columns()) == list(after.columns())
    for name, a in before.columns().items():
        b = after.columns()[name]
        assert a.dtype == b.dtype
        assert a.tobytes() == b.tobytes(), name
    for name in ("period", "units", "failed", "meta"):
        assert getattr(after, name) == getattr(before, name), name
    np.testing.assert_equal(after.failed_at, before.failed_at)


def test_any_parquet_reader_finds_units_and_versions(tmp_path):
    record().save(tmp_path / "run.parquet")
    schema = pq.read_schema(tmp_path / "run.parquet")
    assert schema.field("yaw_rate").metadata[b"unit"] == b"rad/s"
    assert schema.field("friction_rear_left").metadata[b"unit"] == b"-"
    assert schema.field("tuning.Q").metadata[b"unit"] == b"1/m^2"
    metadata = json.loads(schema.metadata[b"about"])
    assert metadata["adaptrack"] == __version__
    assert metadata["period"] == 0.1


def test_error_is_positive_to_the_left_of_the_reference():
    assert record(Y=np.full(8, 1.5), y_ref=np.full(8, 1.0)).error == pytest.approx(0.5)


def test_heading_error_is_zero_along_a_straight_reference_and_positive_to_its_left():
    t = 0.1 * np.arange(8)
    along = record(y_ref=2.0 * t, psi=np.full(8, np.arctan2(2.0, 10.0)))
    assert along.heading_error == pytest.approx(0.0, abs=1e-12)
    assert record(y_ref=2.0 * t, psi=np.full(8, 0.3)).heading_error == pytest.approx(0.3 - np.arctan2(2.0, 10.0))


def test_a_standing_or_backing_car_has_no_reversed_path():
    for speed in (0.0, -1e-12, -0.5):
        assert record(vx=np.full(8, speed)).heading_error == pytest.approx(0.0)


@given(turns=st.integers(-3, 3), angle=st.floats(-3.1, 3.1))
def test_whole_turns_do_not_change_the_heading_error(turns, angle):
    heading = record(psi=np.full(8, angle + 2.0 * np.pi * turns))
    assert heading.heading_error == pytest.approx(angle, abs=1e-9)


def test_between_keeps_times_and_cuts_every_array():
    run = wild(n=50)
    part = run.between(3.5, 4.5)
    assert (part.t[0], len(part)) == (pytest.approx(3.5), 20)
    assert all(len(getattr(part, column.name)) == 20 for column in TRAJECTORY_COLUMNS)
    assert {len(values) for values in part.columns().values()} == {20}
    assert part.meta == run.meta
    assert part.failed is None  # it failed later
    assert run.between(3.5).failed == "off-road"


def test_an_empty_window_is_refused():
    with pytest.raises(at.InvalidInput, match=r"no control period begins in \[5, 6\) s.*\[0, 0.8\) s"):
        record().between(5.0, 6.0)


def test_arrays_cannot_be_changed_in_place_and_the_callers_stay_writable():
    mine = np.zeros(8)
    run = record(Y=mine)
    with pytest.raises(ValueError, match="read-only"):
        run.Y[0] = 1.0
    mine[0] = 1.0


@pytest.mark.parametrize(("changes", "complaint"), [
    ({"Y": np.zeros(7)}, r"`Y` must have the shape \(8,\).*\(7,\)"),
    ({"friction": np.zeros(8)}, r"`friction` must have the shape \(8, 4\)"),
    ({"wind": np.zeros((8, 4))}, r"`wind` must have the shape \(8, 2\)"),
    ({"held": np.full(8, 3.5)}, "`held` must hold bool values"),
    ({"held": np.full(8, np.nan)}, "`held` must hold bool values"),
    ({"tuning": {"Np": np.zeros(7)}, "units": {}}, r"`tuning\['Np'\]` must have the shape \(8,\)"),
    ({"tuning": {"Np": ["35"] * 8}, "units": {}}, r"`tuning\['Np'\]` must hold numbers"),
    ({"tuning": {"../x": np.zeros(8)}, "units": {}}, r"'\.\./x' must be a name"),
    ({"units": {"tuning.gain": "-"}}, "`units` names 'tuning.gain'"),
    ({"failed": "spun"}, "`failed` and `failed_at` go together"),
    ({"meta": {"scenario": "a\0b"}}, r"`meta`: scenario = 'a\\x00b': contains a NUL"),
    ({"meta": {"plant": {"name": "\ud800"}}}, r"`meta`: plant.name = '\\ud800'"),
    ({"vx": np.array(["10"] * 8)}, "`vx` must hold float64 values"),
    ({"t": np.zeros(8)}, "one period"),
    ({"t": 0.2 * np.arange(8)}, "one period"),
    ({"t": np.full(8, np.nan)}, "one period"),
    ({"t": np.zeros(0)}, "at least one control instant"),
    ({"meta": {"plant": object()}}, r"`meta\['plant'\]` cannot be written as JSON"),
])  # fmt: skip
def test_what_does_not_fit_is_refused_with_the_name_of_the_array(changes, complaint):
    with pytest.raises(at.InvalidInput, match=complaint):
        record(**changes)


def test_what_is_no_file_of_a_trajectory_is_refused(tmp_path):
    (tmp_path / "text.parquet").write_text("t,Y\n0,1\n")
    (tmp_path / "empty.parquet").write_bytes(b"")
    pq.write_table(pa.table({"t": [0.0, 1.0]}), tmp_path / "foreign.parquet")
    for name, complaint in (
        ("none.parquet", "No such file"),
        ("", "Is a directory"),
        ("text.parquet", "not a Parquet file"),
        ("empty.parquet", "not a Parquet file"),
        ("foreign.parquet", "holds no trajectory, but a table of another program"),
    ):
        with pytest.raises(at.StorageError, match=complaint):
            at.Trajectory.load(tmp_path / name)


def test_an_edited_file_and_one_of_another_version_are_refused_with_the_reason(tmp_path):
    path = tmp_path / "run.parquet"
    record().save(path)
    stored = pq.read_table(path)
    text = stored.schema.metadata[b"about"].decode()
    holes = stored.set_column(2, "Y", pa.array([None] + [0.0] * 7)).replace_schema_metadata(stored.schema.metadata)
    other_period, other_seed = (
        text.replace('"period": 0.1', '"period": 0.2'),
        text.replace('"meta": {', '"meta": {"seed": 1'),
    )
    versions = r"9\.9\.9 in format version 7, this adaptrack reads version 2: run the simulation"
    for table, entries, complaint in (
        (stored.drop_columns(["psi"]), {}, "no column 'psi'"),
        (holes, {}, "1 missing values in column 'Y'"),
        (stored, {"about": "{"}, "damaged, or edited"),
        (stored, {"about": other_period}, "the checksum of its content does not fit"),
        (stored, {"about": other_seed}, "the checksum of its content does not fit"),
        (stored, {"format_version": "7", "adaptrack": "9.9.9"}, versions),
    ):
        metadata = dict(table.schema.metadata) | {key.encode(): value.encode() for key, value in entries.items()}
        pq.write_table(table.replace_schema_metadata(metadata), path)
        with pytest.raises(at.StorageError, match=complaint):
            at.Trajectory.load(path)


@pytest.mark.parametrize("stride", [31, pytest.param(1, marks=pytest.mark.slow)])
def test_a_flipped_bit_anywhere_gives_the_same_content_or_a_storage_error(tmp_path, stride):
    path = tmp_path / "run.parquet"
    before = record(n=1, tuning={}, diagnostics={"qp_status": np.zeros(1, int)}, units={}, meta={"scenario": "step"})
    before.save(path)
    content = path.read_bytes()
    for place in range(0, len(content), stride):
        changed = bytearray(content)
        changed[place] ^= 1 << place % 8
        path.write_bytes(changed)
        try:
            after = at.Trajectory.load(path)
        except at.StorageError:
            continue
        same(before, after)


def test_a_failed_save_leaves_the_old_file_and_nothing_else(tmp_path, monkeypatch):
    path = tmp_path / "run.parquet"
    record().save(path)
    before = path.read_bytes()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    with pytest.raises(at.StorageError, match="No space left"):
        wild().save(path)
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["run.parquet"]


def test_provenance_names_the_software_and_takes_the_callers_clock():
    meta = provenance(
        datetime(2026, 1, 2, 3, 4, tzinfo=UTC), scenario={"name": "step", "duration": 18.0}, plant="dual-track",
        tyre="magic-formula", controller="standard", tuning={"Np": 35, "Nc": 8, "Q": 10.0, "R": 0.01}, moves="pulses",
    )  # fmt: skip
    run = record(meta=meta)
    assert run.meta["created"] == "2026-01-02T03:04:00+00:00"
    assert run.meta["versions"]["adaptrack"] == __version__
    assert {"python", "numpy", "kernels"} < set(run.meta["versions"])
    names = [run.name_of(entry) for entry in ("scenario", "plant", "moves", "unknown")]
    assert names == ["step", "dual-track", "pulses", ""]
    assert "step, standard" in repr(run)


def test_a_window_of_280_periods_is_not_lost_to_rounding():
    long = record(n=460)
    assert len(long.between(0.0, 28.0)) == 280
