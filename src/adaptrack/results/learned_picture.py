"""Picture of the quantities that controllers learn while driving, over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import REFERENCE_STROKE, Panel, Picture, Stroke
from adaptrack.core import portable
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.marks import draw_ribbon
from adaptrack.results.run_pictures import Array, DrawnRun, Runs, prepare_runs, thin_curve

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEARNED_QUANTITIES = {
    "delay": ("Lag and dead time", "Delay (s)", "s"), "lag": ("Steering lag", "Lag (s)", "s"),
    "stiffness": ("Stiffness/mass, relative to the model", "Factor (–)", ""),
    "bias": ("Steering bias", "Bias (rad)", "rad"), "bank": ("Bank acceleration", "Acceleration (m/s²)", "m/s²"),
    "friction": ("Friction", "μ (–)", ""),
}  # fmt: skip
"""Learned quantities that are drawn: title, label and unit."""

LOGARITHMIC = ("stiffness", "balance", "friction")
"""Learned quantities whose standard deviation refers to their logarithm."""


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
        if name in LOGARITHMIC:
            low, high = mean * portable.exp(-sigma), mean * portable.exp(sigma)
        else:
            low, high = mean - sigma, mean + sigma
        learned[name] = Learnt(mean, low, high, truth.get(name))
    return learned


def learned_picture(runs: Runs, line_styles: Mapping[str, Stroke] | None = None, name: str = "learned") -> Picture:
    """Draw the learned quantities over time with their standard deviation and, in simulation, their true values.

    Raises
    ------
    InvalidInput
        When no controller learns.
    """
    lines = prepare_runs(runs, line_styles)
    learned = {line.label: learned_quantities(line.run) for line in lines}
    learners = [line for line in lines if learned[line.label]]
    if not learners:
        raise InvalidInput("a picture of learned quantities needs a controller that learns: MPC(car, learning=...).")
    panels = []
    for quantity, (title, label, unit) in LEARNED_QUANTITIES.items():
        curves = [(line, learned[line.label][quantity]) for line in learners]
        ends = [f"{line.label}: {learnt.mean[-1]:.3g} {unit} at the end" for line, learnt in curves]
        panels.append(Panel(title, partial(_draw_learned, curves=curves, label=label), "; ".join(ends)))
    caption = "Quantities learned while driving. Band: ± one standard deviation. Dashed: true value in the simulation."
    key = [*((line.label, line.stroke) for line in learners), ("True value", REFERENCE_STROKE)]
    return Picture(name, caption, panels, key, f"{name}.png", row_height=1.9)


def _draw_learned(axes: Axes, curves: Sequence[tuple[DrawnRun, Learnt]], label: str) -> None:
    for line, learnt in curves:
        keep = thin_curve(learnt.mean)
        time = line.run.t[keep]
        draw_ribbon(axes, time, learnt.low[keep], learnt.high[keep], line.stroke.colour)
        axes.plot(time, learnt.mean[keep], **line.stroke.look)
        if learnt.truth is not None:
            axes.plot(line.run.t, learnt.truth, **REFERENCE_STROKE.look, linewidth=1.0)
    axes.set(xlabel="Time (s)", ylabel=label)
