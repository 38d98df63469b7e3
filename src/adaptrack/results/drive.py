"""The page on drives along a road: what came of them, the road from above, signals along it, and their replay."""

from __future__ import annotations

import os
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from adaptrack.results.drive_figures import (
    Drives,
    above_figure,
    along_figure,
    along_key,
    along_panels,
    labelled,
    learned_figure,
    learned_key,
    learned_panels,
)
from adaptrack.results.page import (
    Cell,
    Drawing,
    Head,
    Item,
    Picture,
    Section,
    Table,
    Terms,
    Verbatim,
    Verdict,
    write_page,
)
from adaptrack.results.record import DriveRecord
from adaptrack.results.replay import replay
from adaptrack.results.words import clock, describe, few, legible, listed, number, span

NEAR_END = 10.0
"""m, before its end at which an open road counts as driven to the end, and 1 % of its length."""


_ON_PAGE = (5.2, 4.0)
"""inch, width and largest height of the picture on the page."""


def write_drive_page(
    out_dir: str | os.PathLike[str],
    drives: Sequence[DriveRecord],
    *,
    title: str = "",
    command: str = "",
    created: str = "",
    more: Sequence[Section] = (),
    png: bool = True,
) -> Path:
    """Write the page on drives on one road, with its replay, and its PNG files into `out_dir`; return the page's path.

    Parameters
    ----------
    drives
        One drive, or one of each controller; controllers of one name are numbered.
    title
        The road and the controllers when left out.
    command
        The command line that repeats the drives.
    created
        When they were made.
    more
        Sections to put before the command.
    png
        Whether to write the PNG files.

    Raises
    ------
    InvalidInput
        When there is no drive, or they are not on one road (the same `Road` object).
    StorageError
        When the files cannot be written, see `page.write_page`.
    """
    shown = labelled(drives)
    sections = [
        Section("The drive" if len(shown) == 1 else "The drives", [_verdict(shown)]),
        Section("Along the road", [_along(shown)]),
        *([_learned(shown)] if any(drive.learned for drive in drives) else []),
        Section("Replay", [replay(shown)]),
        *([_measures(shown)] if any(drive.metrics for drive in drives) else []),
        *more,
        _made(shown, command),
    ]
    failed = sum(bool(drive.failed) for drive in drives)
    heading = "Failed" if failed == len(drives) else f"{failed} of {len(drives)} drives failed" if failed else ""
    return write_page(
        out_dir,
        sections,
        title=title or f"{_name(shown)}: {few(shown, 'controller')}",
        failed=heading,
        created=clock(created),
        png=png,
    )


def outcome(drive: DriveRecord) -> str:
    """What came of a drive: how far it went, or why, when and where it failed."""
    s, seconds = float(drive.station[-1]), float(drive.time[-1] - drive.time[0])
    if drive.failed:
        where = f"at {drive.failed_at:.1f} s, at s = {number(drive.failed_station, 4)} m"
        return f"Failed {where}: the vehicle {drive.failed}."
    length, far = drive.road.length, f"{number(s - float(drive.station[0]), 4)} m in {number(seconds)} s"
    if drive.road.closed:
        return f"Driven without failure: {far}, {number((s - float(drive.station[0])) / length)} laps."
    if s < length - NEAR_END - 0.01 * length:
        return f"Not failed, ended early: {far}; the road is {number(length, 4)} m long."
    return f"Driven to the end: {far}."


def _name(drives: Drives) -> str:
    return legible(next(iter(drives.values())).road.name)


def _road_in_words(drives: Drives) -> str:
    road = next(iter(drives.values())).road
    return f"{_name(drives)}, {'lap of ' if road.closed else ''}{number(road.length, 4)} m"


def _verdict(drives: Drives) -> Verdict:
    shown = list(drives.values())
    failed = sum(bool(drive.failed) for drive in shown)
    alone = len(shown) == 1
    text = outcome(shown[0])
    if not alone:
        text = f"{failed} of {len(shown)} drives failed." if failed else f"None of {len(shown)} drives failed."
    entries = [
        ("Road", _road_in_words(drives)),
        ("Car", _shared(drive.car for drive in shown)),
        ("Profile", _shared(drive.profile for drive in shown)),
        ("Controller" if alone else "Controllers", listed(list(drives))),
        ("Speed", f"{span(np.concatenate([drive.speed for drive in shown]))} m/s"),
    ]
    if alone:
        entries += [
            ("RMS |e|", f"{number(shown[0].rms_offset)} m"),
            ("p95 |e|", f"{number(shown[0].p95_offset)} m"),
            ("Largest |e|", f"{number(shown[0].max_offset)} m"),
        ]
    entries += [
        ("Against", "the centre line" if alone else "each other, on one road"),
        ("How sure", f"one drive{'' if alone else ' each'}: other noise gives other numbers"),
    ]
    words = [f"{key}: |e| up to {number(drive.max_offset)} m" for key, drive in drives.items()]
    picture = Picture(
        "The road from above, the driven line coloured by the offset |e| of the centre of mass from the centre line."
        + (" A cross marks where a drive failed." if failed else ""),
        [Drawing(above_figure(shown, *_ON_PAGE), f"The road from above with the driven line. {'; '.join(words)}.")],
        file="above.png",
        print_figure=lambda: above_figure(shown),
    )
    return Verdict(text, Terms(entries), picture, failed > 0, None if alone else _outcomes(drives))


def _shared(names: Iterable[str]) -> str:
    return ", ".join(dict.fromkeys(describe(name) for name in names))


def _outcomes(drives: Drives) -> Table:
    """A row a drive: the errors and what came of it; the smallest of those that did not fail are bold."""
    kept = [drive for drive in drives.values() if not drive.failed]
    names = ("rms_offset", "p95_offset", "max_offset")
    best = {name: min((getattr(drive, name) for drive in kept), default=None) for name in names}

    def row(label: str, drive: DriveRecord) -> list[Cell | str]:
        errors = [
            Cell(number(value), strong=not drive.failed and value == best[name])
            for name, value in ((name, getattr(drive, name)) for name in names)
        ]
        return [label, *errors, Cell(outcome(drive), warn=bool(drive.failed))]

    heads = [
        Head("Controller", is_text=True), Head("RMS |e|", "m"), Head("p95 |e|", "m"), Head("Largest |e|", "m"),
        Head("Outcome", is_text=True),
    ]  # fmt: skip
    note = "Bold: the smallest among the drives that did not fail." if kept else ""
    return Table("Offset from the centre line", heads, [row(*each) for each in drives.items()], note)


def _along(drives: Drives) -> Picture:
    alone = len(drives) == 1
    caption = "Offset e (left positive), steering, speed and lateral acceleration over the station."
    caption += " Front wheels in blue, command in grey." if alone else " Steering is the angle of the front wheels."
    caption += " Dotted: where a drive failed." if any(drive.failed for drive in drives.values()) else ""
    panels = [panel.drawing() for panel in along_panels(drives)]
    return Picture(caption, panels, along_key(drives), "along.png", lambda: along_figure(list(drives.values())))


def _learned(drives: Drives) -> Section:
    """What the controllers have learned of their car."""
    caption = "What was learned of the car while driving. Band: one standard deviation to either side"
    known = any(each.truth is not None for drive in drives.values() for each in drive.learned.values())
    caption += "; dashed: the simulated truth." if known else "."
    panels, shown = [panel.drawing() for panel in learned_panels(drives)], list(drives.values())
    picture = Picture(caption, panels, learned_key(drives), "learned.png", lambda: learned_figure(shown))
    return Section("Learned while driving", [picture])


def _measures(drives: Drives) -> Section:
    """A row a measure, a column a drive."""
    rows: dict[tuple[str, str], dict[str, float]] = {}
    for label, drive in drives.items():
        for measure in drive.metrics:
            rows.setdefault((measure.name, measure.unit), {})[label] = measure.value
    heads = [Head("Measure", is_text=True), Head("Unit", is_text=True), *(Head(label) for label in drives)]
    body = [
        [name, unit or "–", *(number(found.get(label)) for label in drives)] for (name, unit), found in rows.items()
    ]
    return Section("Measures", [Table("Of each drive" if len(drives) > 1 else "Of the drive", heads, body)])


def _made(drives: Drives, command: str) -> Section:
    first = next(iter(drives.values()))
    body = first.shape.body
    guesses = [name.replace("_", " ") for name in body.estimated]
    car = f"{number(body.length)} m long, {number(body.width)} m wide"
    car += f"; estimated from wheelbase and track: {listed(guesses)}" if guesses else ""
    samples = f"{number(len(first))} instants in {number(float(first.time[-1] - first.time[0]))} s"
    terms: list[tuple[str, str]] = [("Drawn car", car), ("Recorded", samples)]
    terms += [("Road", note) for note in first.road.notes]
    items: list[Item] = [Verbatim(command)] if command else []
    return Section("How it was made", [*items, Terms(terms)])
