"""Signals of runs: over time as in the paper's figures 6 to 10, along a road over the station."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import (
    BACKGROUND,
    NEUTRAL,
    REFERENCE,
    Axis,
    Dash,
    Dots,
    Guide,
    Mark,
    Panel,
    Picture,
    Polyline,
    Stroke,
    strokes,
)
from adaptrack.drive.failure import find_failure
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.words import data_text, plain, span

Array = NDArray[Any]
Runs = Mapping[str, Trajectory]
"""Label -> run, in the order of the legend."""
Value = Callable[[Trajectory], Array]
Key = list[tuple[str, Stroke]]

_WHEELS = ("front left", "front right", "rear left", "rear right")
CREEPING = 3.0
"""m/s, the lowest speed of the paper's operating domain; a panel may cut what happens below it."""

CURVE_POINTS = 2400
"""Instants of a curve: more are thinned to the smallest and the largest of each of half as many parts."""


@dataclass(frozen=True)
class DrawnRun:
    """One run, ready to be drawn: cut where it failed."""

    label: str
    run: Trajectory
    stroke: Stroke
    failed: bool
    end: float
    """s, when the scenario ends, whether or not the run got there."""

    @property
    def x(self) -> Array:
        """(n,) the horizontal axis: station (m) on a road, else time (s)."""
        return self.run.road["station"] if self.run.road else self.run.t


Lines = Sequence[DrawnRun]


def as_lines(runs: Runs, line_styles: Mapping[str, Stroke] | None = None) -> list[DrawnRun]:
    """The runs with their strokes, those that failed cut at the instant of the failure.

    Raises
    ------
    InvalidInput
        When there is no run, or one without a stroke.
    """
    if not runs:
        raise InvalidInput("figure: at least one run is needed.")
    line_styles = line_styles or strokes(runs)
    missing = [label for label in runs if label not in line_styles]
    if missing:
        raise InvalidInput(f"figure: no stroke for {', '.join(map(repr, missing))}.")
    lines = []
    for label, run in runs.items():
        failed = find_failure(run)
        drawn = run if failed is None else run.between(run.t[0], _last_drawn(run, failed.step) + 0.5 * run.period)
        lines.append(DrawnRun(label, drawn, line_styles[label], failed is not None, float(run.t[-1]) + run.period))
    return lines


def _last_drawn(run: Trajectory, failed: int) -> float:
    """s, the last instant with a position, up to the one at which the run failed."""
    finite = np.flatnonzero(np.isfinite(run.Y[: failed + 1]))
    return float(run.t[finite[-1] if finite.size else 0])


# -- panels -----------------------------------------------------------------------------------------------------------
def _panel(
    title: str, up: Axis, lines: Lines, value: Value, marks: Sequence[Mark], remark: str = "",
    key: Sequence[tuple[str, Stroke]] = (),
) -> Panel:  # fmt: skip
    """A panel over time or station; value: the quantity whose range its alternative text has."""
    along = any(line.run.road for line in lines)
    ranges = "; ".join(f"{line.label}: {span(value(line.run))}" for line in lines)
    description = f"{plain(up.label)}, over {'the station' if along else 'time'}. {ranges}."
    return Panel(title, _station(lines) if along else _time(lines), up, marks, description, remark, key)


def _time(lines: Lines) -> Axis:
    return Axis("Time (s)", float(min(line.run.t[0] for line in lines)), max(line.end for line in lines))


def _station(lines: Lines) -> Axis:
    low = float(min(np.nanmin(line.x, initial=np.inf) for line in lines))
    high = max(low + 1.0, float(max(np.nanmax(line.x, initial=-np.inf) for line in lines)))
    return Axis("Station s (m)", low, high + 0.04 * (high - low))  # room for the whole last number


def speed_panel(lines: Lines, title: str = "Speed") -> Panel:
    """The speed reference (dashed), and the speeds that were driven."""

    def speed(run: Trajectory) -> Array:
        return run.vx

    forward = all(np.nanmin(line.run.vx, initial=0.0) >= 0.0 for line in lines)
    marks = [*(_curve(line, line.run.vx) for line in lines), _shared(lines, lambda run: run.v_ref, REFERENCE)]
    return _panel(
        title, Axis("Speed (m/s)", low=0.0 if forward else None), lines, speed, [*marks, *_crosses(lines, speed)]
    )


def tracking_panels(lines: Lines) -> list[Panel]:
    """Lateral position, error, angle of the front wheels, yaw rate; on a road speed and acceleration in their place."""
    if any(line.run.road for line in lines):
        acceleration = _signal(
            "Lateral acceleration", "Lateral acc. (m/s²)", lines, lambda run: run.lateral_acceleration
        )
        return [error_panel(lines), _steering(lines), speed_panel(lines), acceleration]
    low, high, start = _frame(lines, lambda run: run.Y)
    position = [
        *(_curve(line, line.run.Y) for line in lines),
        _shared(lines, lambda run: run.y_ref, REFERENCE),
        *_crosses(lines, lambda run: run.Y),
    ]
    return [
        _panel("Trajectory tracking", Axis("Lateral position (m)", low, high), lines, lambda run: run.Y, position,
               start),
        error_panel(lines),
        _steering(lines),
        _signal("Yaw rate", "Yaw rate (rad/s)", lines, lambda run: run.yaw_rate),
    ]  # fmt: skip


def error_panel(lines: Lines) -> Panel:
    """The error from the reference or path."""
    return _signal("Tracking error", "Tracking error e (m)", lines, lambda run: run.error)


def _signal(
    title: str, label: str, lines: Lines, value: Value, before: Sequence[Mark] = (), after: Sequence[Mark] = (),
    remark: str = "", degrees: bool = False,
) -> Panel:  # fmt: skip
    """One curve per run around a zero line."""
    low, high, start = _frame(lines, value)
    curves = [_curve(line, value(line.run)) for line in lines]
    marks = [*before, Guide("y", [0.0], width=0.7), *curves, *after, *_crosses(lines, value)]
    remark = ",  ".join(filter(None, (start, remark)))
    return _panel(title, Axis(label, low, high, degrees=degrees), lines, value, marks, remark)


def _steering(lines: Lines) -> Panel:
    """The angle of the wheels, of one run with the command behind it; degrees at the right."""
    command: list[Mark] = []
    if len(lines) == 1:
        command = [_curve(lines[0], lines[0].run.command, BACKGROUND, 0.8, steps=True)]
    held: list[Mark] = [
        Dots(line.x[line.run.held], line.run.steering[line.run.held], line.stroke.colour, "square", 3.0)
        for line in lines if line.run.held.any()
    ]  # fmt: skip
    remark = "□ held" if held else ""
    return _signal("Steering", "Wheel angle (rad)", lines, lambda run: run.steering, command, held, remark, True)


def condition_panels(lines: Lines) -> list[Panel]:
    """Gust, friction and adapted tuning: horizons and weights of an MPC, a panel for any other entry."""
    adapted = {
        name: line.run for line in lines for name, values in line.run.tuning.items() if np.unique(values).size > 1
    }
    panels = [_gust(lines), _friction(lines)]
    panels += [_horizons(lines)] if {"Np", "Nc"} & set(adapted) else []
    panels += [_weights(lines)] if {"Q", "R"} & set(adapted) else []
    for name, run in adapted.items():
        if name not in ("Np", "Nc", "Q", "R"):
            label = data_text(f"{name} ({run.units[f'tuning.{name}'].replace('-', '–')})")
            marks = _tuned_curves(lines, name)
            panels.append(_panel(data_text(name), Axis(label), lines, tuned(name), marks))
    return panels


def _gust(lines: Lines) -> Panel:
    longitudinal = Stroke("ink", "dashed")
    marks: list[Mark] = [Guide("y", [0.0], width=0.7), _shared(lines, lambda run: run.wind[:, 1])]
    key: Key = []
    if any(line.run.wind[:, 0].any() for line in lines):
        marks.append(_shared(lines, lambda run: run.wind[:, 0], longitudinal))
        key = [("lateral", NEUTRAL), ("longitudinal", longitudinal)]
    return _panel("Lateral gust", Axis("Wind speed (m/s)"), lines, lambda run: run.wind[:, 1], marks, key=key)


def _friction(lines: Lines) -> Panel:
    wheels = _distinct_wheels(lines)
    dashes: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dash-dot")
    marks: list[Mark] = []
    for dash, (wheel, _) in zip(dashes, wheels, strict=False):
        marks.append(_shared(lines, lambda run, wheel=wheel: run.friction[:, wheel], Stroke("ink", dash)))  # type: ignore[misc]
    key = [(name, Stroke("ink", dash)) for dash, (_, name) in zip(dashes, wheels, strict=False)]
    up = Axis("Friction coefficient (–)", include=(0.45, 1.0))
    return _panel("Road friction", up, lines, lambda run: run.friction, marks, key=key if len(wheels) > 1 else ())


def _horizons(lines: Lines) -> Panel:
    top = 1.08 * max(float(line.run.tuning["Np"].max()) for line in lines if "Np" in line.run.tuning)
    marks = [*_tuned_curves(lines, "Np"), *_tuned_curves(lines, "Nc", "dotted")]
    key = [("$N_p$", NEUTRAL), ("$N_c$", Stroke("ink", "dotted"))]
    up = Axis("Control periods (–)", 0.0, top, whole=True)
    return _panel("Horizons", up, lines, tuned("Nc", "Np"), marks, key=key)


def _weights(lines: Lines) -> Panel:
    weights = np.concatenate([tuned("Q", "R")(line.run).ravel() for line in lines])
    positive = weights[weights > 0.0]
    low, high = None, None
    if positive.size:
        low = float(10.0 ** np.floor(np.log10(positive.min()) - 0.1))
        high = float(10.0 ** np.ceil(np.log10(positive.max()) + 0.1))
    marks = [*_tuned_curves(lines, "Q"), *_tuned_curves(lines, "R", "dotted")]
    key = [("$Q$", NEUTRAL), ("$R$", Stroke("ink", "dotted"))]
    up = Axis("$Q$ (1/m²), $R$ (1/rad²)", low, high, log=True)
    return _panel("Weights", up, lines, tuned("Q", "R"), marks, key=key)


def tuned(*names: str) -> Value:
    """A function that returns tuning entries of a run, (n,) or (names, n); NaN where its controller has none."""

    def values(run: Trajectory) -> Array:
        entries = [run.tuning.get(name, np.full(len(run), np.nan)) for name in names]
        return entries[0] if len(entries) == 1 else np.stack(entries)

    return values


# -- curves -----------------------------------------------------------------------------------------------------------
def _curve(
    line: DrawnRun, values: Array, stroke: Stroke | None = None, width: float = 1.3, steps: bool = False
) -> Polyline:
    """A signal of a run over its horizontal axis."""
    keep = thinned(values)
    return Polyline(line.x[keep], values[keep], stroke or line.stroke, width, "post" if steps else "")


def thinned(values: Array, most: int = CURVE_POINTS) -> NDArray[np.int64]:
    """The indices of a curve to draw: all, or the smallest and the largest of each of `most`/2 parts, and the ends."""
    if values.size <= most:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, most // 2 + 1).astype(int)
    parts = itertools.pairwise(edges)
    extremes = [a + int(pick(values[a:b])) for a, b in parts for pick in (np.argmin, np.argmax)]
    return np.unique([0, *extremes, values.size - 1])


def _tuned_curves(lines: Lines, name: str, dash: Dash = "solid") -> list[Mark]:
    """A tuning entry of all runs that have it, as steps."""
    return [
        _curve(line, line.run.tuning[name], Stroke(line.stroke.colour, dash), steps=True)
        for line in lines if name in line.run.tuning
    ]  # fmt: skip


def _crosses(lines: Lines, value: Value) -> list[Mark]:
    """A cross where a failed run ends, at the edge of the frame when it left that too."""
    marks: list[Mark] = []
    for line in (line for line in lines if line.failed):
        values = value(line.run)
        finite = np.flatnonzero(np.isfinite(values))
        if finite.size:
            last = finite[-1]
            marks.append(Dots([line.x[last]], [values[last]], line.stroke.colour, "cross", 6.0, at_edge=True))
    return marks


def _shared(lines: Lines, value: Value, stroke: Stroke = NEUTRAL) -> Mark:
    """A signal of the scenario, which all runs share, from the longest run."""
    longest = max(lines, key=lambda line: len(line.run))
    return _curve(longest, value(longest.run), stroke, 1.0)


def _distinct_wheels(lines: Lines) -> list[tuple[int, str]]:
    """The wheels (index, name) whose friction has to be drawn: one, the two sides, the two axles, or all four."""
    mu = np.concatenate([line.run.friction for line in lines])
    sides = np.array_equal(mu[:, 0], mu[:, 2]) and np.array_equal(mu[:, 1], mu[:, 3])
    axles = np.array_equal(mu[:, 0], mu[:, 1]) and np.array_equal(mu[:, 2], mu[:, 3])
    if sides and axles:
        return [(0, "all wheels")]
    if sides:
        return [(0, "left"), (1, "right")]
    if axles:
        return [(0, "front"), (2, "rear")]
    return list(enumerate(_WHEELS))


def _frame(lines: Lines, value: Value) -> tuple[float | None, float | None, str]:
    """The ends of an axis by the runs that did not fail, at driving speed; a remark on the range before that.

    A start from standstill may need wild steering for a second or two. Where that would flatten all the rest, it
    leaves the frame, and a line above the panel says how far it goes. A run that failed does not set the frame; where
    all failed, the range of their first 95 % does.
    """
    framed = [line.run for line in lines if not line.failed]
    if not framed:
        framed = [line.run.between(end=line.run.t[0] + 0.95 * line.run.duration) for line in lines]
    everything = _extent(np.concatenate([value(run) for run in framed]))
    driving = _extent(np.concatenate([value(run)[run.vx >= CREEPING] for run in framed]))
    if everything is None:
        return None, None, ""
    remark, (low, high) = "", everything
    if driving is not None and 3.0 * (driving[1] - driving[0]) < high - low:
        remark = f"start: {span(np.array(everything), 2)}"
        low, high = driving
    elif not any(line.failed for line in lines):
        return None, None, ""
    margin = 0.2 * max(high - low, 1e-6)
    return low - margin, high + margin, remark


def _extent(values: Array) -> tuple[float, float] | None:
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else None


# -- pictures ---------------------------------------------------------------------------------------------------------
def speed_picture(
    scenarios: Mapping[str, Runs], line_styles: Mapping[str, Stroke] | None = None, caption: str = ""
) -> Picture:
    """Fig. 6: the speed profile of each scenario (dashed), and the speeds that were driven."""
    line_styles = line_styles or strokes(label for runs in scenarios.values() for label in runs)
    lines = {name: as_lines(runs, line_styles) for name, runs in scenarios.items()}
    panels = [speed_panel(group, data_text(name)) for name, group in lines.items()]
    key = {"Profile": REFERENCE} | {line.label: line.stroke for group in lines.values() for line in group}
    return Picture("speed", caption, panels, list(key.items()), "speed.png", row_height=2.3)


def tracking_picture(
    runs: Runs, line_styles: Mapping[str, Stroke] | None = None, name: str = "tracking", caption: str = ""
) -> Picture:
    """Figs. 8 and 10: `tracking_panels`, over time, or over the station along a road."""
    lines = as_lines(runs, line_styles)
    key = [("Reference", REFERENCE), *((line.label, line.stroke) for line in lines)]
    columns = 1 if any(run.road for run in runs.values()) else 2
    return Picture(
        name, caption, tracking_panels(lines), key, f"{name}.png", columns, row_height=1.7 if columns == 1 else 2.25
    )


def conditions_picture(
    runs: Runs, line_styles: Mapping[str, Stroke] | None = None, name: str = "conditions", caption: str = ""
) -> Picture:
    """Figs. 7 and 9: gust, friction, horizons Nc and Np, weights Q and R, as far as the runs have them."""
    lines = as_lines(runs, line_styles)
    key = [(line.label, line.stroke) for line in lines]
    return Picture(name, caption, condition_panels(lines), key, f"{name}.png")
