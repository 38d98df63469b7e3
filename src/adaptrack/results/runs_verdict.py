"""What opens the page on closed-loop runs: how well they followed, how sure that is, and the error in a picture."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from adaptrack.base.result import Axis, Guide, Mark, Panel, Picture, Polyline, Stripe, Stroke
from adaptrack.drive.metrics import published_mse
from adaptrack.results.dots import Dot, dots_panel, notes
from adaptrack.results.figures import as_lines
from adaptrack.results.tables import Settings, Shown
from adaptrack.results.words import counted, describe, number, title_of

_CONTROL = Stroke()
_NOTHING = "nothing: adaptrack compare holds it against other controllers"
NAMED = 3
"""Scenarios, each in its settings, whose best run the verdict names."""


class RunsVerdict(NamedTuple):
    """What came of runs in a sentence, how sure that is, and the error."""

    text: str
    terms: list[tuple[str, str]]
    picture: Picture


def runs_verdict(scenarios: Mapping[str, Settings]) -> RunsVerdict:
    """The verdict on the runs, by scenario and setting."""
    shown = [run for settings in scenarios.values() for runs in settings.values() for run in runs]
    return _alone(next(iter(scenarios)), shown[0]) if len(shown) == 1 else _several(scenarios, shown)


def _alone(scenario: str, run: Shown) -> RunsVerdict:
    metrics = run.metrics
    if metrics.failed:
        text = f"Failed at {metrics.failed_at:.1f} s: the vehicle {metrics.failed_because}."
    else:
        name = run.label[:1].upper() + run.label[1:]
        text = f"{name} follows the {title_of(scenario).lower()} within {number(metrics.rms_error)} m RMS."
    rate = f"{number(metrics.steering_rate_rms)} rad/s RMS ({number(math.degrees(metrics.steering_rate_rms))} °/s)"
    terms = [
        ("RMS error", f"{number(metrics.rms_error)} m, mean square {number(metrics.mse)} m²"),
        ("Largest |error|", f"{number(metrics.max_abs_error)} m"),
        ("Steering rate", rate),
        ("Driven", _driven(run)),
        ("Against", _against(run)),
        ("How sure", _how_sure(run)),
    ]
    (line,) = as_lines({run.label: run.trajectory}, {run.label: _CONTROL})
    rms = metrics.rms_error
    marks: list[Mark] = [Stripe("y", -rms, rms, _CONTROL.colour)] if np.isfinite(rms) else []
    marks += [Guide("y", [0.0], width=0.7), Polyline(line.run.t, line.run.error, _CONTROL)]
    panel = Panel(
        "Tracking error", Axis("Time (s)"), Axis("Tracking error (m)"), marks,
        f"Over time; RMS {number(rms)} m, largest {number(metrics.max_abs_error)} m.",
    )  # fmt: skip
    return RunsVerdict(text, terms, Picture("verdict", "Tracking error over time; the band is ± its RMS.", [panel]))


def _several(scenarios: Mapping[str, Settings], shown: list[Shown]) -> RunsVerdict:
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
    rings = any(np.isfinite(dot.other) for dot in dots)
    against = ["each other"] * any(len(group) > 1 for group in groups) + ["the paper's error (ring)"] * rings
    terms = [
        ("Runs", f"{number(len(shown))}, {counted(len(scenarios), 'scenario')}"),
        ("Failed", number(failed)),
        ("Against", "; ".join(against) or _NOTHING),
        ("How sure", _how_sure(shown[0]).replace("one run", "one run each")),
    ]
    panel, size = dots_panel(dots, "Mean square error (m²)", "Mean square tracking error")
    caption = f"Mean square tracking error.{' Ring: the paper.' if rings else ''}{notes(dots)}"
    return RunsVerdict(text, terms, Picture("verdict", caption, [panel], size=size))


def _smallest(groups: Sequence[Sequence[Dot]]) -> str:
    """Who has the smallest error of those that drove the same: errors of different scenarios are not compared."""
    kept = [[dot for dot in group if not dot.failed] for group in groups]
    best = [min(group, key=lambda dot: dot.value) for group in kept if group]
    if not best:
        return "Every run failed."
    rivals = any(len(group) > 1 for group in groups)
    named = [f"{dot.name}, {number(dot.value)} m²" for dot in best[:NAMED]]
    named += [f"{number(len(best) - NAMED)} more in the picture"] if len(best) > NAMED else []
    return f"{'Smallest mean' if rivals else 'Mean'} square error: {'; '.join(named)}."


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
