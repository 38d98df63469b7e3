"""The result of drives along a road: what came of them, the road from above, signals along it, and their replay."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from adaptrack.base.result import Column, Result, ResultTable, Row, where
from adaptrack.results.answers import length, of_drives
from adaptrack.results.drive_figures import Drives, above_picture, along_picture, labelled, learned_picture
from adaptrack.results.record import DriveRecord
from adaptrack.results.tables import outcomes_table
from adaptrack.results.words import describe, few, legible, number

NEAR_END = 10.0
"""m, before its end at which an open road counts as driven to the end, and 1 % of its length."""

ERRORS = (
    Column("rms_offset", "RMS |e|", "m", 3, "root of the mean squared offset from the centre line"),
    Column("p95_offset", "p95 |e|", "m", 3, "95th percentile of the offset"),
    Column("max_offset", "Largest |e|", "m", 3),
)
BELIEF = (
    Column("label", "Controller"),
    Column("belief_learning", "Learning", "%", "percent"),
    Column("belief_settled", "Settled", "%", "percent"),
    Column("belief_at_bound", "At a bound", "%", "percent"),
    Column("belief_contradictory", "Contradictory", "%", "percent"),
    Column("belief_state", "In the end"),
)
CONSOLE = (
    Column("controller", "controller"),
    Column("rms_error", "RMS e", "m", 3),
    Column("max_abs_error", "max |e|", "m", 3),
    Column("max_corner_error", "corner |e|", "m", 3),
    Column("in_lane", "in lane", "%", "percent"),
    Column("max_acceleration", "max a_y", "m/s²", 3),
    Column("driven_length", "driven", "m", "whole"),
    Column("result", "result"),
)


def drive_result(
    drives: Sequence[DriveRecord], rows: Sequence[Row] = (), *, title: str = "", command: str = "", created: str = ""
) -> Result:
    """Drives on one road as a result.

    Parameters
    ----------
    drives
        One drive, or one of each controller; controllers of one name are numbered.
    rows
        The measures of each drive, by name.
    title
        The road and the controllers when left out.
    command
        The command line that repeats the drives.
    created
        When they were made.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road (the same `Road` object).
    """
    shown = labelled(drives)
    road, failed = drives[0].road, sum(bool(drive.failed) for drive in drives)
    headline = f"{number(failed)} of {number(len(drives))} drives failed"
    answer = outcome(drives[0]) if len(drives) == 1 else of_drives(_errors(shown), length(road.length))
    learned = any(drive.learned for drive in drives)
    return Result(
        kind="drive",
        title=title or f"{legible(road.name)}: {few(shown, 'controller')}",
        answer=answer,
        record={"rows": list(rows)},
        tables=[*_tables(shown), *([] if not rows else [console_table(road.name, rows)])],
        pictures=[above_picture(shown), along_picture(shown), *([learned_picture(shown)] if learned else [])],
        failed=failed > 0,
        headline="Failed" if failed == len(drives) else headline if failed else "",
        values={
            "drives": list(drives), "names": list(shown), "road": road, "first": drives[0],
            "cars": _shared(drive.car for drive in drives), "profiles": _shared(drive.profile for drive in drives),
            "speed": np.concatenate([drive.speed for drive in drives]), "outline": drives[0].shape.outline,
            "seconds": float(drives[0].time[-1] - drives[0].time[0]),
        },
        command=command,
        created=created,
    )  # fmt: skip


def write_drive_page(
    out_dir: str | os.PathLike[str],
    drives: Sequence[DriveRecord],
    *,
    title: str = "",
    command: str = "",
    created: str = "",
    png: bool = True,
) -> Path:
    """Write the page on drives on one road, with its replay, and its PNG files into `out_dir`; return the page's path.

    Parameters are those of `drive_result`; png: whether to write the PNG files.

    Raises
    ------
    InvalidInput
        As `drive_result`.
    StorageError
        When the files cannot be written, see `page.write_result`.
    """
    from adaptrack.results.page import write_result
    from adaptrack.results.replay import replay

    result = drive_result(drives, title=title, command=command, created=created)
    return write_result(out_dir, result, png=png, embedded={"replay": replay(labelled(drives))})


def _errors(drives: Drives) -> list[dict[str, Any]]:
    """A row a drive, as `of_drives` takes it."""
    return [
        {"controller": label, "mse": drive.rms_offset**2, "max_abs_error": drive.max_offset, "failed": drive.failed}
        for label, drive in drives.items()
    ]


def console_table(title: str, rows: Sequence[Row]) -> ResultTable:
    """What the console shows of each drive; rows: the measures of each."""
    return outcomes_table(title, CONSOLE, rows)


def outcome(drive: DriveRecord) -> str:
    """What came of a drive: how far it went, or why, when and where it failed."""
    s, seconds = float(drive.station[-1]), float(drive.time[-1] - drive.time[0])
    if drive.failed:
        place = f"at {drive.failed_at:.1f} s, at s = {number(drive.failed_station, 4)} m"
        return f"Failed {place}: the vehicle {drive.failed}."
    length, far = drive.road.length, f"{number(s - float(drive.station[0]), 4)} m in {number(seconds)} s"
    if drive.road.closed:
        return f"Driven without failure: {far}, {number((s - float(drive.station[0])) / length)} laps."
    if s < length - NEAR_END - 0.01 * length:
        return f"Not failed, ended early: {far}; the road is {number(length, 4)} m long."
    return f"Driven to the end: {far}."


def _shared(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(describe(name) for name in names))


def _tables(drives: Drives) -> list[ResultTable]:
    """A row a drive with what came of it, and a row a measure with a column a drive."""
    errors = [column.name for column in ERRORS]
    rows: list[dict[str, Any]] = [
        {"label": label, "failed": bool(drive.failed), "outcome": outcome(drive)}
        | {name: getattr(drive, name) for name in errors}
        for label, drive in drives.items()
    ]
    kept = [row for row in rows if not row["failed"]]
    best = [where(rows, [name], _smallest(name, kept)) for name in errors]
    outcomes = ResultTable(
        "outcomes", "Offset from the centre line",
        (Column("label", "Controller"), *ERRORS, Column("outcome", "Outcome")), rows,
        "Bold: the smallest among the drives that did not fail." if kept else "", best=frozenset().union(*best),
        alert=where(rows, ["outcome"], lambda row: row["failed"]),
    )  # fmt: skip
    measured: dict[tuple[str, str], dict[str, Any]] = {}
    for i, drive in enumerate(drives.values()):
        for name, value, unit in drive.metrics:
            empty = {"measure": name, "unit": unit} | {str(k): None for k in range(len(drives))}
            measured.setdefault((name, unit), empty)[str(i)] = value
    columns = [Column(str(i), label, show=3) for i, label in enumerate(drives)]
    title = f"Of {'each' if len(drives) > 1 else 'the'} drive"
    heads = (Column("measure", "Measure"), Column("unit", "Unit"))
    tables = [outcomes, ResultTable("measures", title, (*heads, *columns), list(measured.values()))]
    states: list[dict[str, Any]] = [{"label": key, **drive.belief} for key, drive in drives.items() if drive.belief]
    if states:
        tables.append(ResultTable("belief", "State of the belief, share of the time", BELIEF, states))
    return tables


def _smallest(name: str, kept: Sequence[Row]) -> Any:
    return lambda row: not row["failed"] and row[name] == min(each[name] for each in kept)
