"""The paper's figures 6 to 10: each function takes runs, one per label, and returns a figure.

A figure is a list of panels, and a panel is one function that draws on axes. So the same panel stands in the full
figure (PNG, for print) and alone on the page, where panels flow into one or two columns.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullLocator
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.drive.failure import find_failure
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import style
from adaptrack.results.words import lettered, plain, span

Array = NDArray[Any]
Runs = Mapping[str, Trajectory]
"""Label -> run, in the order of the legend."""

_WHEELS = ("front left", "front right", "rear left", "rear right")
CREEPING = 3.0
"""m/s, the lowest speed of the paper's operating domain; below it a panel may cut what goes on."""

SAME_SPEED = 0.05
"""m/s, the difference below which two runs count as driven at the same speed."""

_DOTTED, _DASHED = (0, (1.2, 1.6)), (0, (4, 2))


@dataclass(frozen=True)
class Line:
    """One run, ready to be drawn: cut where it failed."""

    label: str
    run: Trajectory
    stroke: style.Stroke
    failed: bool
    end: float
    """s, when the scenario ends, whether or not the run got there."""


Draw = Callable[[Axes, Sequence[Line]], None]


@dataclass(frozen=True)
class Panel:
    """One set of axes: what it shows, and the range that its alternative text gives."""

    title: str
    ylabel: str
    draw: Draw
    value: Callable[[Trajectory], Array] = field(repr=False)

    def show(self, axes: Axes, lines: Sequence[Line], title: str = "") -> None:
        """Draw the panel, with axes labelled in full."""
        axes.set_title(title or self.title)
        axes.set_ylabel(self.ylabel)
        axes.set_xlabel("Time (s)")
        self.draw(axes, lines)
        axes.set_xlim(min(line.run.t[0] for line in lines), max(line.end for line in lines))

    def describe(self, lines: Sequence[Line]) -> str:
        """The alternative text: the quantity and, for each run, its range."""
        ranges = "; ".join(f"{line.label}: {span(self.value(line.run))}" for line in lines)
        return f"{self.title}, {plain(self.ylabel)}, over time. {ranges}."


def speed_figure(scenarios: Mapping[str, Runs], strokes: Mapping[str, style.Stroke] | None = None) -> Figure:
    """Fig. 6: the speed profile of each scenario (dashed), and the speeds that were driven."""
    strokes = strokes or style.strokes(label for runs in scenarios.values() for label in runs)
    lines = {name: as_lines(runs, strokes) for name, runs in scenarios.items()}
    with style.styled():
        columns = min(len(lines), 2)
        figure, axes = style.grid_figure(math.ceil(len(lines) / columns), columns, 2.3)
        for i, (name, group) in enumerate(lines.items()):
            SPEED.show(axes[i], group, title=style.data_text(lettered(i, name) if len(lines) > 1 else name))
        for spare in axes[len(lines) :]:
            spare.remove()
        style.legend_above(figure, speed_key(list(lines.values())))
    return figure


def speed_key(groups: Sequence[Sequence[Line]]) -> list[tuple[str, style.Stroke]]:
    """The legend of speed panels: what is driven alike by all has one entry."""
    key = {"Profile": style.REFERENCE}
    for lines in groups:
        driven = _distinct(lines, lambda run: run.vx, SAME_SPEED)
        key |= {line.label: line.stroke for line in lines} if len(driven) > 1 else {"Driven": style.BACKGROUND}
    return list(key.items())


def conditions_figure(runs: Runs, strokes: Mapping[str, style.Stroke] | None = None) -> Figure:
    """Figs. 7 and 9: gust, friction, horizons Nc and Np, weights Q and R, over time, as far as the runs have them."""
    return _panels(condition_panels(runs), runs, strokes)


def tracking_figure(runs: Runs, strokes: Mapping[str, style.Stroke] | None = None) -> Figure:
    """Figs. 8 and 10: lateral position, tracking error, angle of the front wheels, yaw rate, over time.

    Along a road Y says nothing: the speed then takes its place.
    """
    straight = not any(run.road for run in runs.values())
    return _panels(TRACKING if straight else (*TRACKING[1:], SPEED), runs, strokes, reference="Reference")


def as_lines(runs: Runs, strokes: Mapping[str, style.Stroke] | None = None) -> list[Line]:
    """The runs with their strokes, those that failed cut at the instant of the failure.

    Raises
    ------
    InvalidInput
        When there is no run, or one without a stroke.
    """
    if not runs:
        raise InvalidInput("figure: at least one run is needed.")
    strokes = strokes or style.strokes(runs)
    missing = [label for label in runs if label not in strokes]
    if missing:
        raise InvalidInput(f"figure: no stroke for {', '.join(map(repr, missing))}.")
    lines = []
    for label, run in runs.items():
        failed = find_failure(run)
        seen = run if failed is None else run.between(run.t[0], _last_drawn(run, failed.step) + 0.5 * run.period)
        end = float(run.t[-1]) + run.period
        lines.append(Line(label, seen, strokes[label], failed is not None, end))
    return lines


def _last_drawn(run: Trajectory, failed: int) -> float:
    """s, the last instant with a position, up to the one at which the run failed."""
    known = np.flatnonzero(np.isfinite(run.Y[: failed + 1]))
    return float(run.t[known[-1] if known.size else 0])


def _panels(
    panels: Sequence[Panel], runs: Runs, strokes: Mapping[str, style.Stroke] | None, reference: str = ""
) -> Figure:
    lines = as_lines(runs, strokes)
    with style.styled():
        figure, axes = style.grid_figure(-(-len(panels) // 2), 2, 2.25)
        for i, (panel, ax) in enumerate(zip(panels, axes, strict=False)):
            panel.show(ax, lines, title=lettered(i, panel.title))
            ax.set_xlabel("Time (s)" if i >= len(panels) - 2 else "")
        for spare in axes[len(panels) :]:
            spare.remove()
        figure.align_ylabels(axes)
        key = [(reference, style.REFERENCE)] if reference else []
        style.legend_above(figure, [*key, *((line.label, line.stroke) for line in lines)])
    return figure


def _draw_speed(axes: Axes, lines: Sequence[Line]) -> None:
    driven = _distinct(lines, lambda run: run.vx, SAME_SPEED)
    if len(driven) == 1:
        axes.plot(driven[0][0].run.t, driven[0][1], color=style.BACKGROUND.colour, linewidth=2.6)
    else:
        _plot_stacked(axes, lines, lambda run: run.vx, tolerance=SAME_SPEED)
    _plot_reference(axes, lines, lambda run: run.v_ref)
    if all(np.nanmin(line.run.vx, initial=0.0) >= 0.0 for line in lines):
        axes.set_ylim(bottom=0.0)
    _mark_failures(axes, lines, lambda run: run.vx)


def _draw_position(axes: Axes, lines: Sequence[Line]) -> None:
    for line in lines:
        _plot(axes, line, line.run.Y)
    _plot_reference(axes, lines, lambda run: run.y_ref)
    _frame(axes, lines, lambda run: run.Y)
    _mark_failures(axes, lines, lambda run: run.Y)


def _draw_signal(value: Callable[[Trajectory], Array], axes: Axes, lines: Sequence[Line], steps: bool = False) -> None:
    """One curve per run around a zero line."""
    axes.axhline(0.0, color=style.MUTED, linewidth=0.7)
    for line in lines:
        _plot(axes, line, value(line.run), drawstyle="steps-post" if steps else "default")
    _frame(axes, lines, value)
    _mark_failures(axes, lines, value)


def _draw_steering(axes: Axes, lines: Sequence[Line]) -> None:
    """The angle of the wheels, of one run with the command behind it; degrees at the right."""
    if len(lines) == 1:
        run = lines[0].run
        axes.plot(run.t, run.command, color=style.BACKGROUND.colour, linewidth=0.8, drawstyle="steps-post")
    _draw_signal(lambda run: run.steering, axes, lines)
    held = [line for line in lines if line.run.held.any()]
    for line in held:
        t, angle = line.run.t[line.run.held], line.run.steering[line.run.held]
        axes.plot(t, angle, "s", color=line.stroke.colour, markersize=3, fillstyle="none")
    if held:
        _note(axes, "□ held")
    style.degrees_at_the_right(axes)


def _draw_gust(axes: Axes, lines: Sequence[Line]) -> None:
    axes.axhline(0.0, color=style.MUTED, linewidth=0.7)
    _plot_shared(axes, lines, lambda run: run.wind[:, 1])
    if any(line.run.wind[:, 0].any() for line in lines):
        _plot_shared(axes, lines, lambda run: run.wind[:, 0], dash=_DASHED)
        style.line_key(axes, [("lateral", "-"), ("longitudinal", _DASHED)])


def _draw_friction(axes: Axes, lines: Sequence[Line]) -> None:
    wheels = _distinct_wheels(lines)
    dashes = ("-", _DASHED, _DOTTED, (0, (5, 1.5, 1, 1.5)))
    for dash, (wheel, _) in zip(dashes, wheels, strict=False):
        _plot_shared(axes, lines, lambda run, wheel=wheel: run.friction[:, wheel], dash=dash)  # type: ignore[misc]
    if len(wheels) > 1:
        style.line_key(axes, [(name, dash) for dash, (_, name) in zip(dashes, wheels, strict=False)])
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, 0.45), max(high, 1.0))


def _draw_horizons(axes: Axes, lines: Sequence[Line]) -> None:
    _plot_stacked(axes, lines, tuned("Np"), drawstyle="steps-post", linestyle="-")
    _plot_stacked(axes, lines, tuned("Nc"), drawstyle="steps-post", linestyle=_DOTTED)
    axes.set_ylim(bottom=0.0)
    axes.set_ylim(top=1.08 * max(float(line.run.tuning["Np"].max()) for line in lines if "Np" in line.run.tuning))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=style.ROUND))
    style.line_key(axes, [("$N_p$", "-"), ("$N_c$", _DOTTED)])


def _draw_weights(axes: Axes, lines: Sequence[Line]) -> None:
    axes.set_yscale("log")
    _plot_stacked(axes, lines, tuned("Q"), drawstyle="steps-post", linestyle="-")
    _plot_stacked(axes, lines, tuned("R"), drawstyle="steps-post", linestyle=_DOTTED)
    positive = np.concatenate([w[w > 0] for line in lines for w in (tuned("Q")(line.run), tuned("R")(line.run))])
    if positive.size:
        axes.set_ylim(10 ** np.floor(np.log10(positive.min()) - 0.1), 10 ** np.ceil(np.log10(positive.max()) + 0.1))
    axes.yaxis.set_minor_locator(NullLocator())
    style.line_key(axes, [("$Q$", "-"), ("$R$", _DOTTED)])


def tuned(*names: str) -> Callable[[Trajectory], Array]:
    """What gives the tuning entry of a run, (n,), or several, (names, n); NaN for what its controller does not have."""

    def values(run: Trajectory) -> Array:
        found = [run.tuning.get(name, np.full(len(run), np.nan)) for name in names]
        return found[0] if len(found) == 1 else np.stack(found)

    return values


def condition_panels(runs: Runs) -> list[Panel]:
    """Gust, friction and what the controllers were tuned to: an MPC's horizons and weights, else an entry a panel."""
    entries = {name: run for run in runs.values() for name in run.tuning}
    mpc = [CONDITIONS[2]] * ({"Np", "Nc"} <= set(entries)) + [CONDITIONS[3]] * ({"Q", "R"} <= set(entries))
    others = [name for name in entries if name not in ("Np", "Nc", "Q", "R")]
    return [*CONDITIONS[:2], *mpc, *(_tuning_panel(name, entries[name].units[f"tuning.{name}"]) for name in others)]


def _tuning_panel(name: str, unit: str) -> Panel:
    def draw(axes: Axes, lines: Sequence[Line]) -> None:
        _plot_stacked(axes, lines, tuned(name), drawstyle="steps-post", linestyle="-")

    return Panel(style.data_text(name), style.data_text(f"{name} ({unit.replace('-', '–')})"), draw, tuned(name))


SPEED = Panel("Speed", "Speed (m/s)", _draw_speed, lambda run: run.vx)

CONDITIONS = (
    Panel("Lateral gust", "Wind speed (m/s)", _draw_gust, lambda run: run.wind[:, 1]),
    Panel("Road friction", "Friction coefficient (–)", _draw_friction, lambda run: run.friction),
    Panel("Horizons", "Control periods (–)", _draw_horizons, tuned("Nc", "Np")),
    Panel("Weights", "$Q$ (1/m²), $R$ (1/rad²)", _draw_weights, tuned("Q", "R")),
)

TRACKING = (
    Panel("Trajectory tracking", "Lateral position (m)", _draw_position, lambda run: run.Y),
    Panel(
        "Tracking error",
        r"$Y - y_\mathrm{ref}$ (m)",
        partial(_draw_signal, lambda run: run.error),
        lambda run: run.error,
    ),
    Panel("Steering", "Wheel angle (rad)", _draw_steering, lambda run: run.steering),
    Panel("Yaw rate", "Yaw rate (rad/s)", partial(_draw_signal, lambda run: run.yaw_rate), lambda run: run.yaw_rate),
)


def _plot(axes: Axes, line: Line, values: Array, **how: Any) -> None:
    """One curve of a run in its stroke."""
    axes.plot(line.run.t, values, color=line.stroke.colour, **({"linestyle": line.stroke.dash} | how))


def _plot_stacked(
    axes: Axes, lines: Sequence[Line], value: Callable[[Trajectory], Array], *, tolerance: float = 1e-9, **how: Any
) -> None:
    """Curves that may coincide: each is wider by as many as cover it, so that it shows beside them."""
    curves = [value(line.run) for line in lines]
    for i, (line, values) in enumerate(zip(lines, curves, strict=True)):
        covers = sum(_coincide(values, other, tolerance) for other in curves[i + 1 :])
        _plot(axes, line, values, linewidth=1.3 + min(0.9 * covers, 2.7), **how)


def _coincide(a: Array, b: Array, tolerance: float) -> bool:
    """Whether two curves lie on each other for a twentieth of the time that both last."""
    n = min(a.size, b.size)
    return bool(np.mean(np.abs(a[:n] - b[:n]) <= tolerance) > 0.05) if n else False


def _mark_failures(axes: Axes, lines: Sequence[Line], value: Callable[[Trajectory], Array]) -> None:
    """A cross where a failed run ends, at the edge of the frame when it left that too."""
    for line in (line for line in lines if line.failed):
        values = value(line.run)
        finite = np.flatnonzero(np.isfinite(values))
        if finite.size:
            where = float(np.clip(values[finite[-1]], *axes.get_ylim()))
            cross: dict[str, Any] = {
                "color": line.stroke.colour,
                "markersize": 6,
                "markeredgewidth": 1.8,
                "clip_on": False,
            }
            axes.plot(line.run.t[finite[-1]], where, "x", scaley=False, **cross)


def _plot_shared(axes: Axes, lines: Sequence[Line], value: Callable[[Trajectory], Array], dash: Any = "-") -> None:
    """A signal of the scenario: once in ink when all runs share it, else each in its own colour."""
    distinct = _distinct(lines, value)
    for line, values in distinct:
        colour = style.NEUTRAL.colour if len(distinct) == 1 else line.stroke.colour
        axes.plot(line.run.t, values, color=colour, linestyle=dash)


def _plot_reference(axes: Axes, lines: Sequence[Line], value: Callable[[Trajectory], Array]) -> None:
    for line, values in _distinct(lines, value):
        axes.plot(line.run.t, values, color=style.REFERENCE.colour, linestyle=style.REFERENCE.dash, linewidth=1.0)


def _distinct(
    lines: Sequence[Line], value: Callable[[Trajectory], Array], tolerance: float = 1e-9
) -> list[tuple[Line, Array]]:
    """The runs whose signal differs; of those that agree as far as both go, the longest."""
    found: list[tuple[Line, Array]] = []
    for line in sorted(lines, key=lambda line: -len(line.run)):
        values = value(line.run)
        if not any(
            np.array_equal(kept.run.t[: values.size], line.run.t)
            and np.allclose(known[: values.size], values, rtol=0.0, atol=tolerance, equal_nan=True)
            for kept, known in found
        ):
            found.append((line, values))
    return found


def _distinct_wheels(lines: Sequence[Line]) -> list[tuple[int, str]]:
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


def _frame(axes: Axes, lines: Sequence[Line], value: Callable[[Trajectory], Array]) -> None:
    """Limits that show what matters: the runs that did not fail, and them at driving speed.

    A start from standstill may need wild steering for a second or two. Where that would flatten all the rest, it
    leaves the frame, and a line above the panel says how far it goes.
    """
    kept = [line.run for line in lines if not line.failed] or [line.run for line in lines]
    everything = _extent(np.concatenate([value(run) for run in kept]))
    driving = _extent(np.concatenate([value(run)[run.vx >= CREEPING] for run in kept]))
    if everything is None:
        return
    low, high = everything
    if driving is not None and 3.0 * (driving[1] - driving[0]) < high - low:
        _note(axes, f"start: {span(np.array(everything), 2)}")
        low, high = driving
    elif not any(line.failed for line in lines):
        return
    margin = 0.2 * max(high - low, 1e-6)
    axes.set_ylim(low - margin, high + margin)


def _note(axes: Axes, text: str) -> None:
    """Small words at the right above the panel, behind those that are there."""
    text = ",  ".join(filter(None, (axes.get_title("right"), text)))
    axes.set_title(text, loc="right", fontsize=7.5, fontweight="normal", color=style.MUTED)


def _extent(values: Array) -> tuple[float, float] | None:
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else None
