"""The section on what knowing the car brings, beside adapting the tuning; its sentences follow the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

from matplotlib.axes import Axes

from adaptrack.results import style
from adaptrack.results.page import Cell, Drawing, Head, Picture, Section, Table
from adaptrack.results.words import listed, number, title_of

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
SHORT = {
    "nn": "the paper's NN",
    "anfis": "the paper's ANFIS",
    "road-constant": "the published MPC with the constant tuned in this profile",
    "road-nn": "the published MPC with the guarded NN learned in this profile",
    "standard-as-written": "the published constant as written",
    "standard-as-released": "the published constant as released",
}
SECTION = "What knowing the car brings"


def knowing_section(rows: Sequence[Row]) -> Section:
    """Words, table, picture."""
    words = (
        "All other controllers on this page predict with wheels that are where the command is, and take what they "
        "measure as it is. The informed one is the same quadratic programme with one constant tuning: its model has "
        "the lag and the dead time of the steering, and a Kalman filter gives it state and disturbances. Dual track, "
        "Magic Formula tyre; profile paper: ideal car, 0.1 s, no preview; profile road: steering lag, rate "
        "limit, sensor noise and delay, 0.05 s, preview."
    )
    return Section(SECTION, [words, *(outcome(rows, name) for name in _profiles(rows)), _table(rows), _picture(rows)])


def outcome(rows: Sequence[Row], profile: str) -> str:
    """How the informed constant compares with the best of the others in a profile, and who failed."""
    parts = []
    own = [row for row in rows if row["profile"] == profile]
    for test, found in _by(own, "scenario").items():
        named = {row["controller"]: row for row in found}
        informed, kept = named["informed"], [row for row in found if not row["failed"] and row["controller"] in SHORT]
        if informed["failed"]:
            parts.append(f"on the {_test(test)} it fails in {informed['failed']} of {informed['runs']} runs")
        elif not kept:
            parts.append(f"on the {_test(test)} it alone stays on the road")
        else:
            best = min(kept, key=lambda row: row["mse"])
            parts.append(
                f"on the {_test(test)} its mean square error is {number(informed['mse'])} m², that of the best other, "
                f"{SHORT[best['controller']]}, {number(best['mse'])} m²"
            )
    lost = [SHORT[name] for name in SHORT if any(row["failed"] for row in own if row["controller"] == name)]
    who = f" Runs fail with {listed(lost)}." if lost else ""
    return f"Profile {profile}, the informed constant: {'; '.join(parts)}.{who}"


def in_a_sentence(rows: Sequence[Row]) -> str:
    """For the top of the page: the informed constant's error beside that of the better of the paper's adaptations."""
    parts = []
    for profile, driven in _by(rows, "profile").items():
        ratios, alone, lost = [], [], []
        for test, found in _by(driven, "scenario").items():
            named = {row["controller"]: row for row in found}
            kept = [row["mse"] for name, row in named.items() if name in ("nn", "anfis") and not row["failed"]]
            if named["informed"]["failed"]:
                lost.append(f"the {_test(test)}")
            elif not kept:
                alone.append(f"the {_test(test)}")
            else:
                ratio = number(float(f"{named['informed']['mse'] / min(kept):.2g}"), 2)
                ratios.append(f"{ratio} ({_test(test)})")
        words = []
        if ratios:
            words.append(f"its mean square error is {listed(ratios)} times that of the better adaptation of the paper")
        if alone:
            words.append(f"it keeps the car on {listed(alone)}, where both adaptations of the paper fail")
        if lost:
            words.append(f"it fails on {listed(lost)}")
        parts.append(f"in profile {profile} {', '.join(words)}")
    return f"One constant tuning that knows its car: {'; '.join(parts)}."


def _table(rows: Sequence[Row]) -> Table:
    heads = [Head("Controller", is_text=True)]
    for test in _by(rows, "scenario"):
        heads += [Head(title_of(test), "MSE, m²"), Head("Steering", "RMS, rad/s")]
    body: list[Sequence[Cell | str] | str] = []
    for profile, driven in _by(rows, "profile").items():
        body.append(f"Profile {profile}")
        columns = _by(driven, "scenario").values()
        for name in [name for name in NAMES if any(row["controller"] == name for row in driven)]:
            cells: list[Cell | str] = [NAMES[name]]
            for found in columns:
                cells += [_cell(found, name, key) for key in ("mse", "rms_rate")]
            body.append(cells)
    note = (
        "Steering: rate of the command. In road, means over ten noise seeds of the runs that did not fail. Bold: the "
        "smallest error of its column and profile without a failed run."
    )
    return Table("Known car beside adapted tuning", heads, body, note)


def _cell(found: Sequence[Row], name: str, key: str) -> Cell:
    (row,) = (row for row in found if row["controller"] == name)
    if row["failed"]:
        count = f", {row['failed']} of {row['runs']}" if row["runs"] > 1 else ""
        return Cell(f"failed{count}" if key == "mse" else number(row[key]), warn=key == "mse")
    best = min(each["mse"] for each in found if not each["failed"])
    return Cell(number(row[key]), strong=key == "mse" and row[key] == best)


def _picture(rows: Sequence[Row]) -> Picture:
    names = [name for name in NAMES if any(row["controller"] == name for row in rows)]
    strokes = style.strokes(["informed", *(name for name in names if name != "informed")])
    panels = []
    for test, found in _by(rows, "scenario").items():
        said = "; ".join(
            f"{NAMES[row['controller']]}, {row['profile']}: {'failed' if row['failed'] else number(row['mse'])}"
            for row in found
        )
        draw = partial(_draw, rows=found, strokes=strokes, title=title_of(test))
        panels.append(Drawing(style.panel_figure(draw), f"Mean square error, {title_of(test)}. {said}."))
    caption = "Mean square error in both profiles; a cross at the top: failed; an open circle: dashed in the key."
    return Picture(caption, panels, [(NAMES[name], strokes[name]) for name in names])


def _draw(axes: Axes, rows: Sequence[Row], strokes: Mapping[str, style.Stroke], title: str) -> None:
    profiles = _profiles(rows)
    top = 3.0 * max(row["mse"] for row in rows if row["mse"] is not None)
    for i, (name, stroke) in enumerate(strokes.items()):
        own = {row["profile"]: row for row in rows if row["controller"] == name}
        places = [profiles.index(each) + 0.03 * (i - len(strokes) / 2) for each in own]
        values = [top if row["failed"] else row["mse"] for row in own.values()]
        axes.plot(places, values, color=stroke.colour, linestyle=stroke.dash, linewidth=1.0)
        filled = stroke.colour if stroke.dash == "-" else "none"
        for place, value, row in zip(places, values, own.values(), strict=True):
            mark, size = ("x", 6) if row["failed"] else ("o", 4)
            axes.plot(place, value, mark, color=stroke.colour, markersize=size, markerfacecolor=filled)
    axes.set_title(title)
    axes.set_ylabel("MSE (m²)")
    style.logarithmic(axes, "y")
    axes.set_xticks(range(len(profiles)), [f"profile {name}" for name in profiles])
    axes.set_xlim(-0.4, len(profiles) - 0.6)


def _profiles(rows: Sequence[Row]) -> list[str]:
    return list(dict.fromkeys(row["profile"] for row in rows))


def _by(rows: Sequence[Row], *keys: str) -> dict[Any, list[Row]]:
    found: dict[Any, list[Row]] = {}
    for row in rows:
        place = tuple(row[key] for key in keys)
        found.setdefault(place if len(keys) > 1 else place[0], []).append(row)
    return found


def _test(name: str) -> str:
    return title_of(name).lower()
