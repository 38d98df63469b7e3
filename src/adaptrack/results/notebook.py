"""Objects as figures, and in a notebook: their numbers in HTML, and a picture (see `base.presentation`)."""

from __future__ import annotations

import base64
from dataclasses import replace
from functools import partial, singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import Panel, Picture
from adaptrack.cars.vehicle import Vehicle
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import VARIABLES, Schedule
from adaptrack.drive.metrics import Metrics, compute_metrics
from adaptrack.drive.trajectory import Trajectory
from adaptrack.paper.data_set import DataSet
from adaptrack.results import marks, style, words
from adaptrack.results.compare import ratios_picture
from adaptrack.results.dataset import comparable_rows, gain_panel, histogram, targets
from adaptrack.results.evaluation import tune_at
from adaptrack.results.page import make_environment
from adaptrack.results.record import DrawnCar, DriveRecord, above_picture, on_road
from adaptrack.results.run_pictures import tracking_picture
from adaptrack.results.style import panel_figure, print_figure
from adaptrack.road import Road


@singledispatch
def figure_of(value: Any, *arguments: Any) -> Figure:
    """The object as a figure; TypeError when nothing draws its type."""
    raise TypeError(f"{type(value).__name__} has no figure.")


_FORMS = {
    Trajectory: "run", Metrics: "metrics", Vehicle: "car", Schedule: "schedule", DataSet: "data set",
    Comparison: "comparison",
}  # fmt: skip
"""What the template `notebook.html.j2` calls each type."""


def html_of(value: Any) -> str:
    """The object in a notebook: its numbers and its figure, with nothing from outside.

    Raises TypeError when no form is known for its type.
    """
    form = next((form for kind, form in _FORMS.items() if isinstance(value, kind)), None)
    if form is None:
        raise TypeError(f"{type(value).__name__} has no form for notebooks.")
    is_empty = form == "metrics" or (isinstance(value, DataSet) and comparable_rows(value) is None)
    picture = "" if is_empty else base64.b64encode(style.png(figure_of(value))).decode()
    metrics = compute_metrics(value) if isinstance(value, Trajectory) else value
    template = make_environment().get_template("notebook.html.j2")
    return template.render(form=form, value=value, metrics=metrics, picture=picture, inputs=VARIABLES)


# -- runs -------------------------------------------------------------------------------------------------------------
@figure_of.register
def run_figure(run: Trajectory, road: Road | None = None) -> Figure:
    """Signals over time; with a road: from above, and error, steering and speed along it.

    Raises InvalidInput when fewer than two instants lie beside the road.
    """
    name = words.controller_name(run.name_of("controller"))
    if road is None:
        return print_figure(tracking_picture({name: run}))
    above = above_picture({name: DriveRecord.from_trajectory(run, road)})
    along = tracking_picture({name: on_road(run, road)})
    panels = [replace(above.panels[0], height=3.2), *along.panels[:3]]
    return print_figure(Picture("run", "", panels, columns=1, row_height=1.35))


# -- cars and schedules -----------------------------------------------------------------------------------------------
@figure_of.register
def vehicle_figure(car: Vehicle) -> Figure:
    """The car from above to scale: body, wheels, centre of mass, axles."""
    title = words.data_text(f"{car.name}, {words.number(car.mass)} kg")
    return panel_figure(Panel(title, partial(_draw_vehicle, car=car), f"{car.name} from above."), (5.2, 2.6))


def _draw_vehicle(axes: Axes, car: Vehicle) -> None:
    outline, shape = car.outline.corners[[0, 1, 3, 2]], DrawnCar.of(car)
    axes.fill(*outline.T, edgecolor=marks.MUTED, facecolor=marks.PALE, linewidth=1.0, zorder=1)
    for x, track in ((shape.lf, shape.track_front), (-shape.lr, shape.track_rear)):
        sides = (-track / 2, track / 2)
        axes.plot([x, x], sides, **marks.BACKGROUND_STROKE, linewidth=1.0)
        for y in sides:
            axes.plot([x - 0.32, x + 0.32], [y, y], **marks.SHARED_STROKE, linewidth=5.0)
    axes.plot(0.0, 0.0, "o", color=marks.SERIES[1], markersize=6.0, zorder=5)
    axes.annotate("centre of mass", (0.0, 0.0), (6.0, 5.0), textcoords="offset points", fontsize=8.0)
    axes.set(xlabel="x (m), forward", ylabel="y (m), left")
    axes.margins(0.06)
    axes.set_aspect("equal", adjustable="datalim")


@figure_of.register
def schedule_figure(schedule: Schedule) -> Figure:
    """Each tuning entry over the first input, for three values of the second; the others in the middle of theirs."""
    low, high = schedule.domain.T
    first, second = schedule.inputs[0], schedule.inputs[1:2]
    levels = np.linspace(low[1], high[1], 3) if second else np.zeros(1)
    points = np.tile((low + high) / 2.0, (200, 1))
    points[:, 0] = x = np.linspace(low[0], high[0], 200)
    label = VARIABLES[first].label
    level_strokes = marks.strokes(
        f"{VARIABLES[name].label} {words.number(float(level))}" for name in second for level in levels
    )
    tunings = []
    for level in levels:
        points[:, 1 : 1 + len(second)] = level
        tunings.append(tune_at(schedule, points))

    def draw(axes: Axes, k: int, log: bool) -> None:
        for tuning, stroke in zip(tunings, list(level_strokes.values()) or [{"color": marks.SERIES[0]}], strict=True):
            axes.plot(x, tuning[:, k], **stroke)
        axes.set_xlabel(f"{label} ({VARIABLES[first].unit})")
        if log:
            marks.set_log_scale(axes, "y")

    panels = [
        Panel(
            words.data_text(name), partial(draw, k=k, log=schedule.tuning[name].log10 or name in ("Q", "R")),
            f"{name} over the {label.lower()}.",
        )
        for k, name in enumerate(schedule.entries)
    ]  # fmt: skip
    return print_figure(Picture("schedule", "", panels, list(level_strokes.items()), row_height=2.1))


# -- data sets --------------------------------------------------------------------------------------------------------
@figure_of.register
def dataset_figure(dataset: DataSet) -> Figure:
    """Histograms of the best tunings, and the cost of the standard tuning over the best, by speed.

    Raises InvalidInput when the run failed with every tuning.
    """
    rows = comparable_rows(dataset)
    if rows is None:
        raise InvalidInput(f"data set {dataset.name!r}: every run failed, so there is nothing to draw.")
    panels = [*(histogram(target) for target in targets(rows)), gain_panel(rows)]
    return print_figure(Picture("dataset", "", panels, row_height=2.1))


# -- comparisons ------------------------------------------------------------------------------------------------------
@figure_of.register
def comparison_figure(comparison: Comparison) -> Figure:
    """Each contender's cost over the reference's, with its 95 % interval."""
    picture = ratios_picture(comparison, str)
    return panel_figure(picture.panels[0], picture.size)
