"""Picture of the quantities that controllers learn while driving, over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import REFERENCE_STROKE, Panel, Picture, Stroke
from adaptrack.core.estimators.learning import LEARNED, LOGARITHMIC
from adaptrack.core.kernel import Field, fields_of
from adaptrack.core.maths import portable
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.marks import draw_ribbon
from adaptrack.results.run_pictures import Array, DrawnRun, Runs, prepare_runs, thin_curve
from adaptrack.results.words import capital

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_LABELS = {"friction": "μ (–)", "bank": "Acceleration (m/s²)"} | dict.fromkeys(LOGARITHMIC[:2], "Factor (–)")


def _label(quantity: Field) -> tuple[str, str, str]:
    """Title, label and unit of a learned quantity."""
    unit = quantity.unit.replace("^2", "²")
    return capital(quantity.meaning), _LABELS.get(quantity.name, f"{capital(quantity.name)} ({unit})"), unit


LABELS = {quantity.name: _label(quantity) for quantity in fields_of(LEARNED)}
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
    for quantity in DRAWN:
        title, label, unit = LABELS[quantity]
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
