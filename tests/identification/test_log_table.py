"""Times and units of a log: as recorders write them, and as they cannot be."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pyarrow
import pyarrow.parquet
import pytest
from typer.testing import CliRunner

from adaptrack.base.errors import InvalidInput
from adaptrack.cli.app import app
from adaptrack.identification.reading import Reading, read_columns
from identification.logs import write_csv

PERIOD, ROWS = 0.05, 600
TIME = PERIOD * np.arange(ROWS)
NANOSECONDS = 1_700_000_000_000_000_000 + 50_000_000 * np.arange(ROWS)
DATES = [datetime(2024, 5, 1, 10) + timedelta(seconds=float(t)) for t in TIME]
SIGNALS = {"command": 0.01 * np.sin(TIME), "speed": 15.0 + 0.5 * np.sin(TIME), "yaw_rate": 0.05 * np.sin(TIME)}


@pytest.mark.parametrize(("name", "times"), [
    ("timestamp_ns", NANOSECONDS),
    ("time_us", NANOSECONDS // 1000),
    ("timestamp", [date.isoformat() for date in DATES]),
    ("time", [date.isoformat() + "Z" for date in DATES]),
    ("time", [date.isoformat(sep=" ", timespec="milliseconds") + "+02:00" for date in DATES]),
    ("time", [date.strftime("%H:%M:%S.%f") for date in DATES]),
])  # fmt: skip
def test_times_are_read_as_recorders_write_them(tmp_path, name, times):
    read = read_columns(write_csv(tmp_path / "log.csv", {name: times} | SIGNALS), Reading())
    assert np.allclose(read.values["time"], TIME, rtol=0.0, atol=1e-9)


def test_instants_and_durations_are_times_and_a_clock_shares_their_origin(tmp_path):
    columns = (
        pyarrow.array(DATES, pyarrow.timestamp("us", "UTC")),
        pyarrow.array(DATES, pyarrow.timestamp("ns")),
        pyarrow.array([timedelta(seconds=float(t)) for t in TIME], pyarrow.duration("ms")),
    )
    for times in columns:
        pyarrow.parquet.write_table(pyarrow.table({"time_ns": times} | SIGNALS), tmp_path / "log.parquet")
        assert np.allclose(read_columns(tmp_path / "log.parquet", Reading()).values["time"], TIME, rtol=0.0, atol=1e-9)
    dates = np.array([date.astimezone(UTC).replace(tzinfo=None) for date in DATES], dtype="datetime64[us]")
    assert np.allclose(read_columns({"time": dates} | SIGNALS, Reading()).values["time"], TIME, atol=1e-9)
    log = {"time_ns": NANOSECONDS, "imu_ns": NANOSECONDS + 10_000_000} | SIGNALS
    read = read_columns(log, Reading(clocks={"yaw_rate": "imu_ns"}))
    assert np.allclose(read.values["yaw_rate"][2:], 0.05 * np.sin(TIME[2:] - 0.01), atol=1e-4)


def test_a_row_of_units_below_the_names_is_understood(tmp_path):
    degrees = {"Time": TIME, "Steering Angle": np.degrees(SIGNALS["command"]), "Speed": 3.6 * SIGNALS["speed"],
               "Yaw Rate": np.degrees(SIGNALS["yaw_rate"])}  # fmt: skip
    read = read_columns(write_csv(tmp_path / "log.csv", degrees, "s,deg,km/h,deg/s"), Reading()).values
    for signal, column in (("wheel", "command"), ("speed", "speed"), ("yaw_rate", "yaw_rate")):
        assert np.allclose(read[signal], SIGNALS[column])


@pytest.mark.parametrize("name", ["yaw_rate_degs", "yaw_rate_deg_s", "yawRateDps", "yaw_rate [deg/sec]", "r_deg_per_s"])
def test_degrees_per_second_are_known_by_their_names(name):
    log = {"time": TIME, name: np.degrees(SIGNALS["yaw_rate"]), "yaw_degs": np.degrees(SIGNALS["yaw_rate"])}
    read = read_columns(log, Reading()).values
    assert np.allclose(read["yaw_rate"], SIGNALS["yaw_rate"])
    assert np.allclose(read["yaw"], SIGNALS["yaw_rate"])


@pytest.mark.parametrize(("columns", "units", "words"), [
    ({}, "s,rad,kn,rad/s", r"speed is the column 'speed' in 'kn': say --units speed=m/s"),
    ({"time": [date.strftime("%d.%m.%Y %H:%M:%S") for date in DATES]}, "",
     r"column 'time'.*first cell: '01\.05\.2024 10:00:00'.*ISO 8601"),
    ({"speed": ["fast"] * ROWS}, "", r"column 'speed'.*first cell: 'fast'.*--columns speed=NAME"),
])  # fmt: skip
def test_a_column_that_cannot_be_read_is_refused_with_a_remedy(tmp_path, columns, units, words):
    path = write_csv(tmp_path / "log.csv", {"time": TIME} | SIGNALS | columns, units)
    with pytest.raises(InvalidInput, match=words):
        read_columns(path, Reading())


def test_text_in_a_column_that_may_be_missing_leaves_it_out(tmp_path):
    path = write_csv(tmp_path / "log.csv", {"time": TIME} | SIGNALS | {"heading": ["N"] * ROWS})
    assert any("yaw is left out" in note for note in read_columns(path, Reading()).notes)


@pytest.mark.parametrize(
    "words", ["identify {} --mass 1500 --wheelbase 2.7", "shadow {} --vehicle midsize-sedan", "check-loop {}"]
)
@pytest.mark.parametrize(
    ("name", "sentence"),
    [("time_ms", "0.03 s of log, 50 microseconds between samples: is the time in s?"), ("time", "--units time=ms")],
)
def test_times_that_are_off_by_a_thousand_are_refused(tmp_path, words, name, sentence):
    times = TIME if name == "time_ms" else 1000.0 * TIME
    path = write_csv(tmp_path / "log.csv", {name: times} | SIGNALS)
    result = CliRunner().invoke(app, words.format(path).split())
    assert isinstance(result.exception, InvalidInput)
    assert sentence in str(result.exception)
