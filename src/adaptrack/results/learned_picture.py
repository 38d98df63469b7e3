"""The quantities that controllers have learned while driving, over time."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import REFERENCE, Axis, Mark, Panel, Picture, Polyline, Ribbon, Stroke
from adaptrack.drive.trajectory import Trajectory
from adaptrack.results.run_pictures import Array, DrawnRun, Runs, as_lines, thinned

LEARNED = {
    "delay": ("Lag and dead time", "Delay (s)", "s"), "lag": ("Steering lag", "Lag (s)", "s"),
    "stiffness": ("Stiffness over mass, of the model's", "Factor (–)", ""),
    "bias": ("Steering bias", "Bias (rad)", "rad"), "bank": ("Pull of the bank", "Pull (m/s²)", "m/s²"),
    "friction": ("Friction", "μ (–)", ""),
}  # fmt: skip
"""Learned quantities that are drawn: title, label and unit."""

LOGARITHMIC = ("stiffness", "balance", "friction")
"""Learned quantities whose standard deviation is that of the logarithm."""


class Learnt(NamedTuple):
    """A quantity that a controller has learned while driving, (n,) each."""

    mean: Array
    low: Array
    """one standard deviation below"""
    high: Array
    truth: Array | None = None
    """in simulation"""


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
            low, high = mean * np.exp(-sigma), mean * np.exp(sigma)
        else:
            low, high = mean - sigma, mean + sigma
        learned[name] = Learnt(mean, low, high, truth.get(name))
    return learned


def learned_picture(runs: Runs, line_styles: Mapping[str, Stroke] | None = None, name: str = "learned") -> Picture:
    """The learned quantities over time, with one standard deviation to either side and, in simulation, the truth.

    Raises
    ------
    InvalidInput
        When no controller has learned.
    """
    lines = as_lines(runs, line_styles)
    learned = {line.label: learned_quantities(line.run) for line in lines}
    learners = [line for line in lines if learned[line.label]]
    if not learners:
        raise InvalidInput("a picture of learned quantities needs a controller that learns: MPC(car, learning=...).")
    panels = [
        Panel(
            title, Axis("Time (s)"), Axis(label),
            [mark for line in learners for mark in _learned_marks(line, learned[line.label][quantity])],
            "; ".join(f"{line.label}: {learned[line.label][quantity].mean[-1]:.3g} {unit} in the end"
                      for line in learners),
        )
        for quantity, (title, label, unit) in LEARNED.items()
    ]  # fmt: skip
    caption = "Learned while driving. Band: one standard deviation to either side; dashed: the simulated truth."
    key = [*((line.label, line.stroke) for line in learners), ("Truth", REFERENCE)]
    return Picture(name, caption, panels, key, f"{name}.png", row_height=1.9)


def _learned_marks(line: DrawnRun, learnt: Learnt) -> list[Mark]:
    keep = thinned(learnt.mean)
    time = line.run.t[keep]
    marks: list[Mark] = [
        Ribbon(time, learnt.low[keep], learnt.high[keep], line.stroke.colour),
        Polyline(time, learnt.mean[keep], line.stroke),
    ]
    if learnt.truth is not None:
        marks.append(Polyline(line.run.t, learnt.truth, REFERENCE, 1.0))
    return marks
