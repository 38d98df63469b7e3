"""Table and picture of the controllers that know their car and of those that adapt their tuning."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from adaptrack.base.result import Axis, Column, Dots, Mark, Panel, Picture, Polyline, ResultTable, Stroke, strokes
from adaptrack.results.words import number, title_of

Row = Mapping[str, Any]

NAMES = {
    "standard-as-written": "Published constant, as written",
    "standard-as-released": "Published constant, as released",
    "nn": "NN of the paper",
    "anfis": "ANFIS of the paper",
    "road-constant": "Published MPC, constant tuned here",
    "road-nn": "Published MPC, guarded NN learned here",
    "informed": "Informed constant",
}


def knowing_table(rows: Sequence[Row]) -> ResultTable:
    """A row for each controller and profile, two columns for each test."""
    tests, columns = list(_by(rows, "scenario")), [Column("name", "Controller")]
    for test in tests:
        columns += [Column(f"mse {test}", title_of(test), "MSE, m²", 3),
                    Column(f"rms_rate {test}", "Steering", "RMS, rad/s", 3)]  # fmt: skip
    shown: list[dict[str, Any]] = []
    best, failed = set(), set()
    for profile, driven in _by(rows, "profile").items():
        runs = {(row["controller"], row["scenario"]): row for row in driven}
        for name in [name for name in NAMES if any(row["controller"] == name for row in driven)]:
            shown.append({"name": NAMES[name], "profile": f"Profile {profile}"})
            for test in tests:
                row, place = runs[name, test], (len(shown) - 1, f"mse {test}")
                rivals = [each["mse"] for each in driven if each["scenario"] == test and not each["failed"]]
                count = f", {row['failed']} of {row['runs']}" if row["runs"] > 1 else ""
                shown[-1] |= {f"mse {test}": f"failed{count}" if row["failed"] else row["mse"]}
                shown[-1] |= {f"rms_rate {test}": row["rms_rate"]}
                if row["failed"]:
                    failed.add(place)
                elif row["mse"] == min(rivals):
                    best.add(place)
    note = (
        "Steering: rate of the command. In road, means over ten noise seeds of the runs that did not fail. Bold: the "
        "smallest error of its column and profile without a failed run."
    )
    title = "Known car beside adapted tuning"
    return ResultTable("knowing", title, columns, shown, note, "profile", frozenset(best), frozenset(failed))


def knowing_picture(rows: Sequence[Row]) -> Picture:
    """The mean square error of each controller in both profiles, a panel a test."""
    names = [name for name in NAMES if any(row["controller"] == name for row in rows)]
    own = strokes(["informed", *(name for name in names if name != "informed")])
    panels = []
    for test, found in _by(rows, "scenario").items():
        said = "; ".join(
            f"{NAMES[row['controller']]}, {row['profile']}: {'failed' if row['failed'] else number(row['mse'])}"
            for row in found
        )
        across = Axis(names=[f"profile {name}" for name in profiles(found)])
        description = f"Mean square error, {title_of(test)}. {said}."
        panels.append(Panel(title_of(test), across, Axis("MSE (m²)", log=True), _marks(found, own), description))
    caption = "Mean square error in both profiles; a cross at the top: failed; an open circle: dashed in the key."
    return Picture("knowing", caption, panels, [(NAMES[name], own[name]) for name in names])


def _marks(rows: Sequence[Row], own: Mapping[str, Stroke]) -> list[Mark]:
    marks: list[Mark] = []
    top = 3.0 * max(row["mse"] for row in rows if row["mse"] is not None)
    for i, (name, stroke) in enumerate(own.items()):
        driven = {row["profile"]: row for row in rows if row["controller"] == name}
        places = [profiles(rows).index(each) + 0.03 * (i - len(own) / 2) for each in driven]
        values = [top if row["failed"] else row["mse"] for row in driven.values()]
        marks.append(Polyline(places, values, stroke, 1.0))
        for place, value, row in zip(places, values, driven.values(), strict=True):
            kind = "cross" if row["failed"] else "dot" if stroke.dash == "solid" else "ring"
            marks.append(Dots([place], [value], stroke.colour, kind, 6.0 if row["failed"] else 4.0))  # type: ignore[arg-type]
    return marks


def profiles(rows: Sequence[Row]) -> list[str]:
    """In the order in which they occur."""
    return list(dict.fromkeys(row["profile"] for row in rows))


def _by(rows: Sequence[Row], *keys: str) -> dict[Any, list[Row]]:
    found: dict[Any, list[Row]] = {}
    for row in rows:
        place = tuple(row[key] for key in keys)
        found.setdefault(place if len(keys) > 1 else place[0], []).append(row)
    return found
