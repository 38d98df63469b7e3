"""What opens the page on closed-loop runs: how well they followed, how sure that is, and the error in a picture."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial

import numpy as np
from matplotlib.axes import Axes

from adaptrack.drive.metrics import published_mse
from adaptrack.results import style
from adaptrack.results.dots import Dot, dots_drawing, notes
from adaptrack.results.figures import Line, as_lines
from adaptrack.results.page import Panel, Picture, Terms, Verdict
from adaptrack.results.tables import Settings, Shown
from adaptrack.results.words import counted, describe, number, title_of

_CONTROL = style.Stroke(style.SERIES[0])
_NOTHING = "nothing: adaptrack compare holds it against other controllers"
NAMED = 3
"""Scenarios, each in its settings, whose best run the verdict names."""


def runs_verdict(scenarios: Mapping[str, Settings]) -> Verdict:
    """The verdict on the runs, by scenario and setting."""
    shown = [run for settings in scenarios.values() for runs in settings.values() for run in runs]
    return _alone(next(iter(scenarios)), shown[0]) if len(shown) == 1 else _several(scenarios, shown)


def _alone(scenario: str, run: Shown) -> Verdict:
    metrics, trajectory = run.metrics, run.trajectory
    if metrics.failed:
        text = f"Failed at {metrics.failed_at:.1f} s: the vehicle {metrics.failed_because}."
    else:
        who = run.label[:1].upper() + run.label[1:]
        text = f"{who} follows the {title_of(scenario).lower()} within {number(metrics.rms_error)} m RMS."
    entries = [
        ("RMS error", f"{number(metrics.rms_error)} m, mean square {number(metrics.mse)} m²"),
        ("Largest |error|", f"{number(metrics.max_abs_error)} m"),
        ("Steering rate", f"{number(metrics.steering_rate_rms)} rad/s RMS ({_degrees(metrics.steering_rate_rms)} °/s)"),
        ("Driven", _driven(run)),
        ("Against", _against(run)),
        ("How sure", _how_sure(run)),
    ]
    lines = as_lines({run.label: trajectory}, {run.label: _CONTROL})
    panel = Panel(
        "Tracking error", partial(_draw_error, lines[0], metrics.rms_error),
        f"Over time; RMS {number(metrics.rms_error)} m, largest {number(metrics.max_abs_error)} m.",
    )  # fmt: skip
    picture = Picture("Tracking error over time; the band is ± its RMS.", [panel.drawing()])
    return Verdict(text, Terms(entries), picture, metrics.failed)


def _draw_error(line: Line, rms: float, axes: Axes) -> None:
    run = line.run
    if np.isfinite(rms):
        axes.axhspan(-rms, rms, color=line.stroke.colour, alpha=0.15, linewidth=0.0)
    axes.axhline(0.0, color=style.MUTED, linewidth=0.7)
    axes.plot(run.t, run.error, color=line.stroke.colour)
    axes.set_xlabel("Time (s)")
    axes.set_ylabel("Tracking error (m)")


def _several(scenarios: Mapping[str, Settings], shown: list[Shown]) -> Verdict:
    groups, one = [], len({run.label for run in shown}) == 1
    for scenario, settings in scenarios.items():
        for words, runs in settings.items():
            named = [title_of(scenario)] * (len(scenarios) > 1) + [words] * bool(words)
            groups.append([_dot(run, ", ".join([run.label] * (not (one and named)) + named)) for run in runs])
    dots = [dot for group in groups for dot in group]
    failed = sum(run.metrics.failed for run in shown)
    text = _smallest(groups)
    if 0 < failed < len(shown):
        text += f" {number(failed)} of {number(len(shown))} runs failed."
    against = ["each other"] * any(len(group) > 1 for group in groups)
    rings = any(np.isfinite(dot.other) for dot in dots)
    against += ["the paper's error (ring)"] if rings else []
    entries = [
        ("Runs", f"{number(len(shown))}, {counted(len(scenarios), 'scenario')}"),
        ("Failed", number(failed)),
        ("Against", "; ".join(against) or _NOTHING),
        ("How sure", _how_sure(shown[0]).replace("one run", "one run each")),
    ]
    drawing = dots_drawing(dots, "Mean square error (m²)", "Mean square tracking error")
    caption = f"Mean square tracking error.{' Ring: the paper.' if rings else ''}{notes(dots)}"
    return Verdict(text, Terms(entries), Picture(caption, [drawing]), failed > 0)


def _smallest(groups: Sequence[Sequence[Dot]]) -> str:
    """Who has the smallest error of those that drove the same: errors of different scenarios are not compared."""
    kept = [[dot for dot in group if not dot.failed] for group in groups]
    best = [min(group, key=lambda dot: dot.value) for group in kept if group]
    if not best:
        return "Every run failed."
    rivals = any(len(group) > 1 for group in groups)
    told = [f"{dot.name}, {number(dot.value)} m²" for dot in best[:NAMED]]
    told += [f"{number(len(best) - NAMED)} more in the picture"] if len(best) > NAMED else []
    return f"{'Smallest mean' if rivals else 'Mean'} square error: {'; '.join(told)}."


def _dot(run: Shown, name: str) -> Dot:
    published = published_mse(run.trajectory)
    other = float("nan") if published is None else published
    return Dot(name, run.metrics.mse, failed=run.metrics.failed, other=other)


def _driven(run: Shown) -> str:
    meta = run.trajectory.meta
    known = [(name, describe(meta[key])) for key, name in (("vehicle", "car"), ("profile", "profile")) if meta.get(key)]
    return ", ".join(f"{name} {value}" for name, value in known) or "not recorded"


def _against(run: Shown) -> str:
    published = published_mse(run.trajectory)
    if published is None:
        return _NOTHING
    return f"the paper's mean square error, {published:g} m²: {number(run.metrics.mse / published)} times"


def _how_sure(run: Shown) -> str:
    meta = run.trajectory.meta
    if meta.get("profile") == "paper":
        return "one run without noise: it repeats to the bit"
    seed = meta.get("seed")
    return "one run" + ("" if seed is None else f" with noise seed {seed}") + "; other seeds give other numbers"


def _degrees(angle: float) -> str:
    return number(float(np.degrees(angle)))
