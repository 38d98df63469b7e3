"""Signals of runs, over time as in the paper's figures 6 to 10 or along a road, and learned quantities."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import Panel, Picture
from adaptrack.control.controllers.tuning import ENTRIES
from adaptrack.control.speed_control import SpeedLimit
from adaptrack.core.estimators.learning import LEARNED, LOGARITHMIC
from adaptrack.core.kernel import fields_of
from adaptrack.core.maths import portable
from adaptrack.drive.failure import find_failure
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results import marks
from adaptrack.results.words import capital, data_text, plain, span

Array = NDArray[Any]
Runs = Mapping[str, Trajectory]
"""Label -> run, in the order of the legend."""
Strokes = Mapping[str, marks.Stroke]
RunSignal = Callable[[Trajectory], Array]
"""A function that returns a signal of a run."""

_WHEELS = {
    (0, 1, 2, 3): "all wheels", (0, 2): "left", (1, 3): "right", (0, 1): "front", (2, 3): "rear",
    (0,): "front left", (1,): "front right", (2,): "rear left", (3,): "rear right",
}  # fmt: skip
"""Names of groups of wheels with equal friction."""
CREEPING = 3.0
"""m/s, lowest speed of the paper's operating domain; a panel may cut off slower driving"""

CURVE_POINTS = 2400
"""Instants of a curve: more are thinned to the smallest and the largest of each of half as many parts."""


@dataclass(frozen=True)
class DrawnRun:
    """A run for a picture, cut at its failure."""

    label: str
    run: Trajectory
    stroke: marks.Stroke
    failed: bool
    end: float
    """s, end of the scenario, also for a run that failed before"""

    @property
    def x(self) -> Array:
        """(n,) the horizontal axis: station (m) on a road, else time (s)."""
        return self.run.road["station"] if self.run.road else self.run.t


Lines = Sequence[DrawnRun]


def prepare_runs(runs: Runs, strokes: Strokes | None = None) -> list[DrawnRun]:
    """The runs with their strokes, those that failed cut at the last position up to the failure."""
    strokes, lines = strokes or marks.strokes(runs), []
    for label, run in runs.items():
        failed, drawn = find_failure(run), run
        if failed is not None:
            finite = np.flatnonzero(np.isfinite(run.Y[: failed.step + 1]))
            last = float(run.t[finite[-1] if finite.size else 0])
            drawn = run.between(run.t[0], last + 0.5 * run.period)
        lines.append(DrawnRun(label, drawn, strokes[label], failed is not None, float(run.t[-1]) + run.period))
    return lines


# -- signals ----------------------------------------------------------------------------------------------------------
def _columns(group: Literal["diagnostics", "tuning"], *names: str) -> RunSignal:
    """A function that returns recorded columns of a run, (n,) or (names, n); NaN where its controller has none."""

    def values(run: Trajectory) -> Array:
        recorded: Mapping[str, Array] = getattr(run, group)
        columns = [np.asarray(recorded.get(name, np.full(len(run), np.nan)), dtype=float) for name in names]
        return columns[0] if len(columns) == 1 else np.stack(columns)

    return values


_SPEED: RunSignal = attrgetter("vx")
_GOVERNED = _columns("diagnostics", "governed_speed")
_ASSUMED_FRICTION = _columns("diagnostics", "friction_low", "friction_high")
_LIMIT = _columns("diagnostics", "limited_by")


# -- panels -----------------------------------------------------------------------------------------------------------
def _panel(title: str, label: str, lines: Lines, value: RunSignal, draw: Callable[[marks.Axes], None]) -> Panel:
    """A panel over time or station; value: the quantity whose ranges stand in the alternative text."""
    along = any(line.run.road for line in lines)

    def draw_over(axes: marks.Axes) -> None:
        axes.set(xlabel="Station s (m)" if along else "Time (s)", xlim=_x_limits(lines, along), ylabel=label)
        draw(axes)

    ranges = "; ".join(f"{line.label}: {span(value(line.run))}" for line in lines)
    return Panel(title, draw_over, f"{plain(label)}, over {'the station' if along else 'time'}. {ranges}.")


def _x_limits(lines: Lines, along: bool) -> tuple[float, float]:
    low = float(min(np.nanmin(line.x, initial=np.inf) for line in lines))
    if not along:
        return low, max(line.end for line in lines)
    high = max(low + 1.0, float(max(np.nanmax(line.x, initial=-np.inf) for line in lines)))
    return low, high + 0.04 * (high - low)  # room for the whole last number


def _signal(
    title: str, label: str, lines: Lines, value: RunSignal, reference: RunSignal | None = None, remark: str = ""
) -> Panel:
    """One curve per run with the reference or else a zero line."""
    limits, start = _frame(lines, value)

    def draw(axes: marks.Axes) -> None:
        if reference is None:
            axes.axhline(0.0, linewidth=0.7, **marks.BACKGROUND_STROKE)
        for line in lines:
            _draw_curve(axes, line, value(line.run))
        if reference is not None:
            _draw_shared(axes, lines, reference, marks.REFERENCE_STROKE)
        if limits:
            axes.set_ylim(limits)
        _draw_crosses(axes, lines, value)
        remarks = ",  ".join(filter(None, (start, remark)))
        axes.set_title(remarks, loc="right", fontsize=7.5, fontweight="normal", color=marks.MUTED)

    return _panel(title, label, lines, value, draw)


def error_panel(lines: Lines) -> Panel:
    """The error from the reference or path."""
    return _signal("Tracking error", "Tracking error e (m)", lines, attrgetter("error"))


def speed_panel(lines: Lines, title: str = "Speed", governed: bool = False) -> Panel:
    """The speed reference (dashed), the driven speeds, and those of the governor (dotted) if they are requested."""

    def draw(axes: marks.Axes) -> None:
        for line in lines:
            _draw_curve(axes, line, line.run.vx)
        _draw_shared(axes, lines, lambda run: run.road.get("planned_speed", run.v_ref), marks.REFERENCE_STROKE)
        if all(np.nanmin(line.run.vx, initial=0.0) >= 0.0 for line in lines):
            axes.set_ylim(bottom=0.0)
        _draw_crosses(axes, lines, _SPEED)
        for line in lines if governed else ():
            _draw_curve(axes, line, _GOVERNED(line.run), linestyle=marks.DOTTED)

    return _panel(title, "Speed (m/s)", lines, _SPEED, draw)


def _assumed_friction(lines: Lines) -> Panel:
    def draw(axes: marks.Axes) -> None:
        _draw_shared(axes, lines, lambda run: run.friction.mean(axis=1))
        for line in lines:
            interval = _ASSUMED_FRICTION(line.run)
            axes.fill_between(line.x, *interval, color=line.stroke["color"], **marks.BAND)
            for end in interval:
                _draw_curve(axes, line, end)
        marks.include_y(axes, 0.0, 1.0)

    title = "Friction: assumed interval, true (black)"
    return _panel(title, "Friction (–)", lines, _ASSUMED_FRICTION, draw)


def _limits_band(lines: Lines) -> Panel:
    """A row for each cause that limits the speed, with a bar where it does."""
    limits = list(SpeedLimit)
    limiting = np.unique(np.concatenate([_LIMIT(line.run) for line in lines]))
    rows = limiting[np.isfinite(limiting)].astype(int).tolist()

    def draw(axes: marks.Axes) -> None:
        height = 0.8 / len(lines)
        for k, line in enumerate(lines):
            code = _LIMIT(line.run)
            cuts = np.flatnonzero(np.diff(code, prepend=np.nan, append=np.nan) != 0.0)
            for first, last in itertools.pairwise(cuts.tolist()):
                start, end = float(line.x[first]), float(line.x[min(last, len(line.run) - 1)])
                if np.isfinite(code[first]):
                    bottom = rows.index(int(code[first])) - 0.4 + k * height
                    axes.broken_barh([(start, max(end - start, 0.0))], (bottom, height), color=line.stroke["color"])
        marks.name_rows(axes, [limits[row] for row in rows])

    shares = "; ".join(
        f"{line.label}: {limits[row]} {100.0 * float(np.mean(_LIMIT(line.run) == row)):.0f} %"
        for line in lines
        for row in rows
    )
    panel = _panel("Speed limited by", "", lines, _LIMIT, draw)
    return replace(panel, description=f"What limits the speed, share of the time. {shares}.")


def _steering(lines: Lines) -> Panel:
    """The angle of the wheels, for a single run with its command; squares mark held angles, degrees at the right."""
    holding = [line for line in lines if line.run.held.any()]
    remark = "□ held" if holding else ""
    signal = _signal("Steering", "Wheel angle (rad)", lines, attrgetter("steering"), remark=remark)

    def draw(axes: marks.Axes) -> None:
        if len(lines) == 1:
            command = {**marks.BACKGROUND_STROKE, "linewidth": 0.8, "drawstyle": "steps-post"}
            _draw_curve(axes, lines[0], lines[0].run.command, **command)
        for line in holding:
            is_held, look = line.run.held, {"color": line.stroke["color"], "fillstyle": "none"}
            axes.plot(line.x[is_held], line.run.steering[is_held], "s", markersize=3.0, zorder=5, **look)
        signal.draw(axes)
        marks.add_degrees(axes)

    return replace(signal, draw=draw)


def _gust(lines: Lines) -> Panel:
    def draw(axes: marks.Axes) -> None:
        axes.axhline(0.0, linewidth=0.7, **marks.BACKGROUND_STROKE)
        _draw_shared(axes, lines, lambda run: run.wind[:, 1])
        if any(line.run.wind[:, 0].any() for line in lines):
            _draw_shared(axes, lines, lambda run: run.wind[:, 0], marks.REFERENCE_STROKE)
            marks.add_line_key(axes, [("lateral", "-"), ("longitudinal", marks.DASHED)])

    return _panel("Lateral gust", "Wind speed (m/s)", lines, lambda run: run.wind[:, 1], draw)


def _friction(lines: Lines) -> Panel:
    dashes = ("-", marks.DASHED, marks.DOTTED, marks.DASH_DOT)
    wheels = _distinct_wheels(lines)

    def draw(axes: marks.Axes) -> None:
        for (wheel, _), dash in zip(wheels, dashes, strict=False):
            stroke = {"color": marks.INK, "linestyle": dash}
            _draw_shared(axes, lines, lambda run, wheel=wheel: run.friction[:, wheel], stroke)  # type: ignore[misc]
        marks.include_y(axes, 0.45, 1.0)
        if len(wheels) > 1:
            marks.add_line_key(axes, [(name, dash) for (_, name), dash in zip(wheels, dashes, strict=False)])

    return _panel("Road friction", "Friction coefficient (–)", lines, attrgetter("friction"), draw)


def _draw_pair(axes: marks.Axes, lines: Lines, solid: str, dotted: str) -> None:
    """Draw two tuning entries of an MPC, with their key."""
    _draw_tuning(axes, lines, solid)
    _draw_tuning(axes, lines, dotted, marks.DOTTED)
    symbols = {"Np": "$N_p$", "Nc": "$N_c$", "Q": "$Q$", "R": "$R$"}
    marks.add_line_key(axes, [(symbols[solid], "-"), (symbols[dotted], marks.DOTTED)])


def _horizons(lines: Lines) -> Panel:
    top = 1.08 * max(float(line.run.tuning["Np"].max()) for line in lines if "Np" in line.run.tuning)

    def draw(axes: marks.Axes) -> None:
        from matplotlib.ticker import MaxNLocator

        _draw_pair(axes, lines, "Np", "Nc")
        axes.set_ylim(0.0, top)
        axes.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6, steps=marks.TICK_STEPS))

    return _panel("Horizons", "Control periods (–)", lines, _columns("tuning", "Nc", "Np"), draw)


def _weights(lines: Lines) -> Panel:
    values = _columns("tuning", "Q", "R")
    weights = np.concatenate([values(line.run).ravel() for line in lines])
    positive = weights[weights > 0.0]
    limits = None
    if positive.size:
        low, high = np.floor(portable.log10(positive.min()) - 0.1), np.ceil(portable.log10(positive.max()) + 0.1)
        limits = portable.power(10.0, float(low)), portable.power(10.0, float(high))

    def draw(axes: marks.Axes) -> None:
        _draw_pair(axes, lines, "Q", "R")
        marks.set_log_scale(axes, "y", limits)

    return _panel("Weights", "$Q$ (1/m²), $R$ (1/rad²)", lines, values, draw)


# -- curves -----------------------------------------------------------------------------------------------------------
def _draw_curve(axes: marks.Axes, line: DrawnRun, values: Array, **look: Any) -> None:
    """Draw a signal of a run over its horizontal axis; look: what differs from the stroke of the run."""
    keep = thin_curve(values)
    axes.plot(line.x[keep], values[keep], **{**line.stroke, **look})


def thin_curve(values: Array, most: int = CURVE_POINTS) -> NDArray[np.int64]:
    """The indices of a curve to draw: all, or the smallest and the largest of each of `most`/2 parts, and the ends."""
    if values.size <= most:
        return np.arange(values.size)
    edges = np.linspace(0, values.size, most // 2 + 1).astype(int)
    parts = itertools.pairwise(edges)
    extremes = [a + int(pick(values[a:b])) for a, b in parts for pick in (np.argmin, np.argmax)]
    return np.unique([0, *extremes, values.size - 1])


def turning_part(time: Array, yaw_rate: Array, seconds: float) -> slice:
    """The part of a log of a given length (s) with the most turning."""
    total = np.concatenate([[0.0], np.cumsum(portable.square(np.nan_to_num(yaw_rate)))])
    ends = np.searchsorted(time, time + seconds, side="right")
    first = int(np.argmax(total[ends] - total[np.arange(time.size)]))
    return slice(first, int(ends[first]))


def _draw_shared(axes: marks.Axes, lines: Lines, value: RunSignal, stroke: marks.Stroke = marks.SHARED_STROKE) -> None:
    """Draw a signal of the scenario, which all runs share, from the longest run."""
    longest = max(lines, key=lambda line: len(line.run))
    _draw_curve(axes, longest, value(longest.run), **stroke, linewidth=1.0)


def _draw_tuning(axes: marks.Axes, lines: Lines, name: str, linestyle: Any = "-") -> None:
    """Draw a tuning entry of all runs that have it, as steps."""
    for line in lines:
        if name in line.run.tuning:
            _draw_curve(axes, line, line.run.tuning[name], linestyle=linestyle, drawstyle="steps-post")


def _draw_crosses(axes: marks.Axes, lines: Lines, value: RunSignal) -> None:
    """Draw a cross where a failed run ends, at the edge of the frame if it left the frame."""
    for line in lines:
        values = value(line.run)
        finite = np.flatnonzero(np.isfinite(values))
        if line.failed and finite.size:
            last = finite[-1]
            x, y = np.clip(line.x[last], *axes.get_xlim()), np.clip(values[last], *axes.get_ylim())
            look: dict[str, Any] = {"color": line.stroke["color"], "markersize": 6.0, "markeredgewidth": 1.8}
            axes.plot([x], [y], "x", scalex=False, scaley=False, clip_on=False, **look)


def _distinct_wheels(lines: Lines) -> list[tuple[int, str]]:
    """The first wheel of each group with equal friction, with the name of the group."""
    groups: dict[bytes, tuple[int, ...]] = {}
    for wheel, mu in enumerate(np.concatenate([line.run.friction for line in lines]).T):
        groups[mu.tobytes()] = (*groups.get(mu.tobytes(), ()), wheel)
    if set(groups.values()) <= set(_WHEELS):
        return [(group[0], _WHEELS[group]) for group in groups.values()]
    return [(wheel, _WHEELS[wheel,]) for wheel in range(4)]


def _frame(lines: Lines, value: RunSignal) -> tuple[tuple[float, float] | None, str]:
    """The limits of an axis by the runs that did not fail, at driving speed; a remark on the range before that.

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
        return None, ""
    remark, (low, high) = "", everything
    if driving is not None and 3.0 * (driving[1] - driving[0]) < high - low:
        remark = f"start: {span(np.array(everything), 2)}"
        low, high = driving
    elif not any(line.failed for line in lines):
        return None, ""
    margin = 0.2 * max(high - low, 1e-6)
    return (low - margin, high + margin), remark


def _extent(values: Array) -> tuple[float, float] | None:
    finite = values[np.isfinite(values)]
    return (float(finite.min()), float(finite.max())) if finite.size else None


# -- pictures ---------------------------------------------------------------------------------------------------------
def _key(lines: Iterable[DrawnRun]) -> list[tuple[str, marks.Stroke]]:
    return [(line.label, line.stroke) for line in lines]


def speed_picture(scenarios: Mapping[str, Runs], strokes: Strokes | None = None) -> Picture:
    """Fig. 6: the speed profile of each scenario (dashed), and the speeds that were driven."""
    strokes = strokes or marks.strokes(label for runs in scenarios.values() for label in runs)
    lines = {name: prepare_runs(runs, strokes) for name, runs in scenarios.items()}
    panels = [speed_panel(group, data_text(name)) for name, group in lines.items()]
    key = {"Profile": marks.REFERENCE_STROKE} | dict(_key(line for group in lines.values() for line in group))
    return Picture("speed", "", panels, list(key.items()), "speed.png", row_height=2.3)


def tracking_picture(runs: Runs, strokes: Strokes | None = None, name: str = "tracking") -> Picture:
    """Figs. 8 and 10: lateral position, error, angle of the front wheels, yaw rate over time.

    Along a road: error, angle, speed and lateral acceleration over the station.
    """
    lines = prepare_runs(runs, strokes)
    error, steering = error_panel(lines), _steering(lines)
    key = [("Reference", marks.REFERENCE_STROKE), *_key(lines)]
    if any(run.road for run in runs.values()):
        acceleration = attrgetter("lateral_acceleration")
        acceleration_panel = _signal("Lateral acceleration", "Lateral acc. (m/s²)", lines, acceleration)
        panels = [error, steering, speed_panel(lines), acceleration_panel]
        return Picture(name, "", panels, key, f"{name}.png", columns=1, row_height=1.7)
    position = _signal("Trajectory tracking", "Lateral position (m)", lines, attrgetter("Y"), attrgetter("y_ref"))
    yaw_rate = _signal("Yaw rate", "Yaw rate (rad/s)", lines, attrgetter("yaw_rate"))
    return Picture(name, "", [position, error, steering, yaw_rate], key, f"{name}.png")


def speed_control_picture(runs: Runs, strokes: Strokes | None = None, name: str = "speed-control") -> Picture:
    """Governed speed, longitudinal acceleration, used grip, assumed friction, and what limits the speed."""
    lines = prepare_runs(runs, strokes)
    acceleration, grip = (_columns("diagnostics", name) for name in ("longitudinal_acceleration", "grip_used"))
    panels = [
        speed_panel(lines, "Speed, governed (dotted), planned (dashed)", governed=True),
        _signal("Longitudinal acceleration", "Long. acc. (m/s²)", lines, acceleration),
        _signal("Used share of the assumed grip", "Used grip (–)", lines, grip),
        _assumed_friction(lines),
        _limits_band(lines),
    ]
    key = [("Reference", marks.REFERENCE_STROKE), *_key(lines)]
    return Picture(name, "", panels, key, f"{name}.png", columns=1, row_height=1.7)


def conditions_picture(runs: Runs, strokes: Strokes | None = None, name: str = "conditions") -> Picture:
    """Figs. 7 and 9: gust, friction and adapted tuning: horizons and weights of an MPC, a panel for any other entry."""
    lines = prepare_runs(runs, strokes)
    adapted = {
        name: line.run for line in lines for name, values in line.run.tuning.items() if np.unique(values).size > 1
    }
    panels = [_gust(lines), _friction(lines)]
    panels += [_horizons(lines)] if {"Np", "Nc"} & set(adapted) else []
    panels += [_weights(lines)] if {"Q", "R"} & set(adapted) else []
    for entry, run in adapted.items():
        if entry not in ENTRIES:
            label = data_text(f"{entry} ({run.units[f'tuning.{entry}'].replace('-', '–')})")
            draw = partial(_draw_tuning, lines=lines, name=entry)
            panels.append(_panel(data_text(entry), label, lines, _columns("tuning", entry), draw))
    return Picture(name, "", panels, _key(lines), f"{name}.png")


# -- learned quantities -----------------------------------------------------------------------------------------------
_LABELS = {"friction": "μ (–)", "bank": "Acceleration (m/s²)"} | dict.fromkeys(LOGARITHMIC[:2], "Factor (–)")


LABELS = {
    field.name: (capital(field.meaning), _LABELS.get(field.name, f"{capital(field.name)} ({unit})"), unit)
    for field in fields_of(LEARNED)
    for unit in [field.unit.replace("^2", "²")]
}
"""Learned quantities by name: title, label and unit."""
DRAWN = ("delay", *(name for name in LABELS if name not in ("delay", "dead_time", "balance")))


class Learnt(NamedTuple):
    """Course of a learned quantity over a drive, arrays (n,)."""

    mean: Array
    low: Array
    """Mean minus one standard deviation."""
    high: Array
    """Mean plus one standard deviation."""
    truth: Array | None = None
    """True value; None outside simulation."""


def learned_quantities(run: Trajectory) -> dict[str, Learnt]:
    """The learned quantities of a run by name; empty for a controller that does not learn."""
    truth = {name: np.full(len(run), value) for name, value in run.meta.get("truth", {}).items()}
    if truth:
        truth["friction"] = run.friction.mean(axis=1)
    learned = {}
    for key, mean in run.diagnostics.items():
        name, sigma = key.removeprefix("belief_"), run.diagnostics.get(f"{key}_sigma")
        if name == key or sigma is None:
            continue
        low, high = (mean * portable.exp(end) if name in LOGARITHMIC else mean + end for end in (-sigma, sigma))
        learned[name] = Learnt(mean, low, high, truth.get(name))
    return learned


def learned_picture(runs: Runs, strokes: Strokes | None = None, name: str = "learned") -> Picture:
    """Draw the learned quantities over time with their standard deviation and, in simulation, their true values.

    Raises InvalidInput when no controller learns.
    """
    learners = [(line, learned) for line in prepare_runs(runs, strokes) if (learned := learned_quantities(line.run))]
    if not learners:
        raise InvalidInput("a picture of learned quantities needs a controller that learns: MPC(car, learning=...).")
    panels = []
    for quantity in DRAWN:
        title, label, unit = LABELS[quantity]
        curves = [(line, learned[quantity]) for line, learned in learners]
        ends = [f"{line.label}: {learnt.mean[-1]:.3g} {unit} at the end" for line, learnt in curves]
        panels.append(Panel(title, partial(_draw_learned, curves=curves, label=label), "; ".join(ends)))
    key = [*_key(line for line, _ in learners), ("True value", marks.REFERENCE_STROKE)]
    return Picture(name, "", panels, key, f"{name}.png", row_height=1.9)


def _draw_learned(axes: marks.Axes, curves: Sequence[tuple[DrawnRun, Learnt]], label: str) -> None:
    for line, learnt in curves:
        keep = thin_curve(learnt.mean)
        time = line.run.t[keep]
        axes.fill_between(time, learnt.low[keep], learnt.high[keep], color=line.stroke["color"], **marks.BAND)
        axes.plot(time, learnt.mean[keep], **line.stroke)
        if learnt.truth is not None:
            axes.plot(line.run.t, learnt.truth, **marks.REFERENCE_STROKE, linewidth=1.0)
    axes.set(xlabel="Time (s)", ylabel=label)
