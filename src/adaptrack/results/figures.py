"""The paper's figures 6 to 10: panels over time from runs, one per label, as plain data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

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

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Array = NDArray[Any]
Runs = Mapping[str, Trajectory]
"""Label -> run, in the order of the legend."""
Value = Callable[[Trajectory], Array]
Key = list[tuple[str, Stroke]]

_WHEELS = ("front left", "front right", "rear left", "rear right")
CREEPING = 3.0
"""m/s, the lowest speed of the paper's operating domain; below it a panel may cut what goes on."""

SAME_SPEED = 0.05
"""m/s, the difference below which two runs count as driven at the same speed."""


@dataclass(frozen=True)
class DrawnRun:
    """One run, ready to be drawn: cut where it failed."""

    label: str
    run: Trajectory
    stroke: Stroke
    failed: bool
    end: float
    """s, when the scenario ends, whether or not the run got there."""


Lines = Sequence[DrawnRun]


def as_lines(runs: Runs, own: Mapping[str, Stroke] | None = None) -> list[DrawnRun]:
    """The runs with their strokes, those that failed cut at the instant of the failure.

    Raises
    ------
    InvalidInput
        When there is no run, or one without a stroke.
    """
    if not runs:
        raise InvalidInput("figure: at least one run is needed.")
    own = own or strokes(runs)
    missing = [label for label in runs if label not in own]
    if missing:
        raise InvalidInput(f"figure: no stroke for {', '.join(map(repr, missing))}.")
    lines = []
    for label, run in runs.items():
        failed = find_failure(run)
        drawn = run if failed is None else run.between(run.t[0], _last_drawn(run, failed.step) + 0.5 * run.period)
        lines.append(DrawnRun(label, drawn, own[label], failed is not None, float(run.t[-1]) + run.period))
    return lines


def _last_drawn(run: Trajectory, failed: int) -> float:
    """s, the last instant with a position, up to the one at which the run failed."""
    known = np.flatnonzero(np.isfinite(run.Y[: failed + 1]))
    return float(run.t[known[-1] if known.size else 0])


# -- panels -----------------------------------------------------------------------------------------------------------
def _panel(
    title: str, up: Axis, lines: Lines, value: Value, marks: Sequence[Mark], remark: str = "",
    key: Sequence[tuple[str, Stroke]] = (),
) -> Panel:  # fmt: skip
    """A panel over time; value: the quantity whose range its alternative text gives."""
    time = Axis("Time (s)", float(min(line.run.t[0] for line in lines)), max(line.end for line in lines))
    ranges = "; ".join(f"{line.label}: {span(value(line.run))}" for line in lines)
    return Panel(title, time, up, marks, f"{plain(up.label)}, over time. {ranges}.", remark, key)


def speed_panel(lines: Lines, title: str = "Speed") -> Panel:
    """The speed profile (dashed), and the speeds that were driven."""

    def speed(run: Trajectory) -> Array:
        return run.vx

    driven = _distinct(lines, speed, SAME_SPEED)
    if len(driven) == 1:
        marks: list[Mark] = [Polyline(driven[0][0].run.t, driven[0][1], BACKGROUND, 2.6)]
    else:
        marks = _stacked(lines, speed, tolerance=SAME_SPEED)
    forward = all(np.nanmin(line.run.vx, initial=0.0) >= 0.0 for line in lines)
    marks += [*_reference(lines, lambda run: run.v_ref), *_crosses(lines, speed)]
    return _panel(title, Axis("Speed (m/s)", low=0.0 if forward else None), lines, speed, marks)


def tracking_panels(lines: Lines) -> list[Panel]:
    """Lateral position, tracking error, angle of the front wheels, yaw rate."""
    low, high, start = _frame(lines, lambda run: run.Y)
    position = [
        *(Polyline(line.run.t, line.run.Y, line.stroke) for line in lines),
        *_reference(lines, lambda run: run.y_ref),
        *_crosses(lines, lambda run: run.Y),
    ]
    return [
        _panel("Trajectory tracking", Axis("Lateral position (m)", low, high), lines, lambda run: run.Y, position,
               start),
        _signal("Tracking error", r"$Y - y_\mathrm{ref}$ (m)", lines, lambda run: run.error),
        _steering(lines),
        _signal("Yaw rate", "Yaw rate (rad/s)", lines, lambda run: run.yaw_rate),
    ]  # fmt: skip


def _signal(
    title: str, label: str, lines: Lines, value: Value, before: Sequence[Mark] = (), after: Sequence[Mark] = (),
    remark: str = "", degrees: bool = False,
) -> Panel:  # fmt: skip
    """One curve per run around a zero line."""
    low, high, start = _frame(lines, value)
    curves = [Polyline(line.run.t, value(line.run), line.stroke) for line in lines]
    marks = [*before, Guide("y", [0.0], width=0.7), *curves, *after, *_crosses(lines, value)]
    remark = ",  ".join(filter(None, (start, remark)))
    return _panel(title, Axis(label, low, high, degrees=degrees), lines, value, marks, remark)


def _steering(lines: Lines) -> Panel:
    """The angle of the wheels, of one run with the command behind it; degrees at the right."""
    command: list[Mark] = []
    if len(lines) == 1:
        run = lines[0].run
        command = [Polyline(run.t, run.command, BACKGROUND, 0.8, steps="post")]
    held: list[Mark] = [
        Dots(line.run.t[line.run.held], line.run.steering[line.run.held], line.stroke.colour, "square", 3.0)
        for line in lines if line.run.held.any()
    ]  # fmt: skip
    remark = "□ held" if held else ""
    return _signal("Steering", "Wheel angle (rad)", lines, lambda run: run.steering, command, held, remark, True)


def condition_panels(lines: Lines) -> list[Panel]:
    """Gust, friction and what the controllers were tuned to: an MPC's horizons and weights, else an entry a panel."""
    entries = {name: line.run for line in lines for name in line.run.tuning}
    panels = [_gust(lines), _friction(lines)]
    panels += [_horizons(lines)] if {"Np", "Nc"} <= set(entries) else []
    panels += [_weights(lines)] if {"Q", "R"} <= set(entries) else []
    for name, run in entries.items():
        if name not in ("Np", "Nc", "Q", "R"):
            label = data_text(f"{name} ({run.units[f'tuning.{name}'].replace('-', '–')})")
            marks = _stacked(lines, tuned(name), steps=True)
            panels.append(_panel(data_text(name), Axis(label), lines, tuned(name), marks))
    return panels


def _gust(lines: Lines) -> Panel:
    marks: list[Mark] = [Guide("y", [0.0], width=0.7), *_shared(lines, lambda run: run.wind[:, 1])]
    key: Key = []
    if any(line.run.wind[:, 0].any() for line in lines):
        marks += _shared(lines, lambda run: run.wind[:, 0], "dashed")
        key = [("lateral", NEUTRAL), ("longitudinal", Stroke("ink", "dashed"))]
    return _panel("Lateral gust", Axis("Wind speed (m/s)"), lines, lambda run: run.wind[:, 1], marks, key=key)


def _friction(lines: Lines) -> Panel:
    wheels = _distinct_wheels(lines)
    dashes: tuple[Dash, ...] = ("solid", "dashed", "dotted", "dash-dot")
    marks: list[Mark] = []
    for dash, (wheel, _) in zip(dashes, wheels, strict=False):
        marks += _shared(lines, lambda run, wheel=wheel: run.friction[:, wheel], dash)  # type: ignore[misc]
    key = [(name, Stroke("ink", dash)) for dash, (_, name) in zip(dashes, wheels, strict=False)]
    up = Axis("Friction coefficient (–)", include=(0.45, 1.0))
    return _panel("Road friction", up, lines, lambda run: run.friction, marks, key=key if len(wheels) > 1 else ())


def _horizons(lines: Lines) -> Panel:
    top = 1.08 * max(float(line.run.tuning["Np"].max()) for line in lines if "Np" in line.run.tuning)
    marks = [*_stacked(lines, tuned("Np"), steps=True, dash="solid"),
             *_stacked(lines, tuned("Nc"), steps=True, dash="dotted")]  # fmt: skip
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
    marks = [*_stacked(lines, tuned("Q"), steps=True, dash="solid"),
             *_stacked(lines, tuned("R"), steps=True, dash="dotted")]  # fmt: skip
    key = [("$Q$", NEUTRAL), ("$R$", Stroke("ink", "dotted"))]
    up = Axis("$Q$ (1/m²), $R$ (1/rad²)", low, high, log=True)
    return _panel("Weights", up, lines, tuned("Q", "R"), marks, key=key)


def tuned(*names: str) -> Value:
    """What gives the tuning entry of a run, (n,), or several, (names, n); NaN for what its controller does not have."""

    def values(run: Trajectory) -> Array:
        found = [run.tuning.get(name, np.full(len(run), np.nan)) for name in names]
        return found[0] if len(found) == 1 else np.stack(found)

    return values


# -- curves -----------------------------------------------------------------------------------------------------------
def _stacked(
    lines: Lines, value: Value, *, tolerance: float = 1e-9, steps: bool = False, dash: Dash | None = None
) -> list[Mark]:
    """Curves that may coincide: each is wider by as many as cover it, so that it shows beside them."""
    curves = [value(line.run) for line in lines]
    marks: list[Mark] = []
    for i, (line, values) in enumerate(zip(lines, curves, strict=True)):
        covers = sum(_coincide(values, other, tolerance) for other in curves[i + 1 :])
        stroke = line.stroke if dash is None and not steps else Stroke(line.stroke.colour, dash or "solid")
        marks.append(Polyline(line.run.t, values, stroke, 1.3 + min(0.9 * covers, 2.7), "post" if steps else ""))
    return marks


def _coincide(a: Array, b: Array, tolerance: float) -> bool:
    """Whether two curves lie on each other for a twentieth of the time that both last."""
    n = min(a.size, b.size)
    return bool(np.mean(np.abs(a[:n] - b[:n]) <= tolerance) > 0.05) if n else False


def _crosses(lines: Lines, value: Value) -> list[Mark]:
    """A cross where a failed run ends, at the edge of the frame when it left that too."""
    marks: list[Mark] = []
    for line in (line for line in lines if line.failed):
        values = value(line.run)
        finite = np.flatnonzero(np.isfinite(values))
        if finite.size:
            last = finite[-1]
            marks.append(Dots([line.run.t[last]], [values[last]], line.stroke.colour, "cross", 6.0, at_edge=True))
    return marks


def _shared(lines: Lines, value: Value, dash: Dash = "solid") -> list[Mark]:
    """A signal of the scenario: once in ink when all runs share it, else each in its own colour."""
    distinct = _distinct(lines, value)
    return [
        Polyline(line.run.t, values, Stroke("ink" if len(distinct) == 1 else line.stroke.colour, dash))
        for line, values in distinct
    ]


def _reference(lines: Lines, value: Value) -> list[Mark]:
    return [Polyline(line.run.t, values, REFERENCE, 1.0) for line, values in _distinct(lines, value)]


def _distinct(lines: Lines, value: Value, tolerance: float = 1e-9) -> list[tuple[DrawnRun, Array]]:
    """The runs whose signal differs; of those that agree as far as both go, the longest."""
    found: list[tuple[DrawnRun, Array]] = []
    for line in sorted(lines, key=lambda line: -len(line.run)):
        values = value(line.run)
        if not any(
            np.array_equal(kept.run.t[: values.size], line.run.t)
            and np.allclose(known[: values.size], values, rtol=0.0, atol=tolerance, equal_nan=True)
            for kept, known in found
        ):
            found.append((line, values))
    return found


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
    """Limits that show what matters, and a remark: the runs that did not fail, and them at driving speed.

    A start from standstill may need wild steering for a second or two. Where that would flatten all the rest, it
    leaves the frame, and a line above the panel says how far it goes.
    """
    kept = [line.run for line in lines if not line.failed] or [line.run for line in lines]
    everything = _extent(np.concatenate([value(run) for run in kept]))
    driving = _extent(np.concatenate([value(run)[run.vx >= CREEPING] for run in kept]))
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


# -- pictures and figures ---------------------------------------------------------------------------------------------
def speed_key(groups: Sequence[Lines]) -> Key:
    """The legend of speed panels: what is driven alike by all has one entry."""
    key = {"Profile": REFERENCE}
    for lines in groups:
        driven = _distinct(lines, lambda run: run.vx, SAME_SPEED)
        key |= {line.label: line.stroke for line in lines} if len(driven) > 1 else {"Driven": BACKGROUND}
    return list(key.items())


def speed_picture(scenarios: Mapping[str, Runs], own: Mapping[str, Stroke] | None = None, caption: str = "") -> Picture:
    """Fig. 6: the speed profile of each scenario (dashed), and the speeds that were driven."""
    own = own or strokes(label for runs in scenarios.values() for label in runs)
    lines = {name: as_lines(runs, own) for name, runs in scenarios.items()}
    panels = [speed_panel(group, data_text(name)) for name, group in lines.items()]
    return Picture("speed", caption, panels, speed_key(list(lines.values())), "speed.png", row_height=2.3)


def tracking_picture(runs: Runs, own: Mapping[str, Stroke] | None = None, name: str = "tracking") -> Picture:
    """Figs. 8 and 10: lateral position, tracking error, angle of the front wheels, yaw rate, over time.

    Along a road Y says nothing: the speed then takes its place in print.
    """
    lines = as_lines(runs, own)
    panels = tracking_panels(lines)
    on_road = any(run.road for run in runs.values())
    printed = [*panels[1:], speed_panel(lines)] if on_road else panels
    key = [("Reference", REFERENCE), *((line.label, line.stroke) for line in lines)]
    return Picture(name, "", panels, key, f"{name}.png", print_panels=printed)


def conditions_picture(runs: Runs, own: Mapping[str, Stroke] | None = None, name: str = "conditions") -> Picture:
    """Figs. 7 and 9: gust, friction, horizons Nc and Np, weights Q and R, over time, as far as the runs have them."""
    lines = as_lines(runs, own)
    key = [(line.label, line.stroke) for line in lines]
    return Picture(name, "", condition_panels(lines), key, f"{name}.png")


def speed_figure(scenarios: Mapping[str, Runs], own: Mapping[str, Stroke] | None = None) -> Figure:
    """`speed_picture`, drawn."""
    return _drawn(speed_picture(scenarios, own))


def tracking_figure(runs: Runs, own: Mapping[str, Stroke] | None = None) -> Figure:
    """`tracking_picture`, drawn."""
    return _drawn(tracking_picture(runs, own))


def conditions_figure(runs: Runs, own: Mapping[str, Stroke] | None = None) -> Figure:
    """`conditions_picture`, drawn."""
    return _drawn(conditions_picture(runs, own))


def _drawn(picture: Picture) -> Figure:
    from adaptrack.results.draw import print_figure

    return print_figure(picture)
