"""Objects as figures, and in a notebook: their numbers in HTML, and a picture (see `base.presentation`)."""

from __future__ import annotations

import base64
from collections.abc import Mapping
from dataclasses import replace
from functools import partial, singledispatch
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from adaptrack.base.errors import InvalidInput
from adaptrack.base.result import Panel, Picture
from adaptrack.cars.vehicle import Vehicle
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import Schedule
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

Array = NDArray[np.float64]


@singledispatch
def figure_of(value: Any, *arguments: Any) -> Figure:
    """The object as a figure.

    Raises
    ------
    TypeError
        When nothing draws its type.
    """
    raise TypeError(f"{type(value).__name__} has no figure.")


@singledispatch
def html_of(value: Any) -> str:
    """The object in a notebook.

    Raises
    ------
    TypeError
        When no form is known for its type.
    """
    raise TypeError(f"{type(value).__name__} has no form for notebooks.")


# -- runs -------------------------------------------------------------------------------------------------------------
@figure_of.register
def run_figure(run: Trajectory, road: Road | None = None) -> Figure:
    """Signals over time; with a road: from above, and error, steering and speed along it.

    Raises
    ------
    InvalidInput
        When fewer than two instants lie beside the road.
    """
    name = words.controller_name(run.name_of("controller"))
    if road is None:
        return print_figure(tracking_picture({name: run}))
    above = above_picture({name: DriveRecord.from_trajectory(run, road)})
    along = tracking_picture({name: on_road(run, road)})
    panels = [replace(above.panels[0], height=3.2), *along.panels[:3]]
    return print_figure(Picture("run", "", panels, columns=1, row_height=1.35))


@html_of.register
def run_html(run: Trajectory) -> str:
    """Name, measures and picture of a run, with nothing from outside."""
    title = f"{words.title_of(run.name_of('scenario'))}, {words.controller_name(run.name_of('controller'))}"
    duration = {
        "Duration": f"{words.number(run.duration)} s, {words.number(len(run))} control periods of {run.period:g} s"
    }
    return html(title, duration | _measures(compute_metrics(run)), run_figure(run), f"{title}: signals over time")


@html_of.register
def metrics_html(metrics: Metrics) -> str:
    """The main measures of a run, and all measures behind a fold."""
    every = {name.replace("_", " "): written(value) for name, value in metrics.as_row().items()}
    title = f"Measures of {words.number(metrics.steps)} control periods"
    return html(title, _measures(metrics)) + f"<details><summary>All measures</summary>{html('', every)}</details>"


# -- cars and schedules -----------------------------------------------------------------------------------------------
@html_of.register
def vehicle_html(car: Vehicle) -> str:
    """A car's numbers with their units, and the car from above."""
    fields = type(car).model_fields
    values = {name: getattr(car, name) for name in fields}
    rows = {
        name.replace("_", " "): f"{words.number(float(value), 4)} {(fields[name].description or '').partition(',')[0]}"
        for name, value in values.items() if isinstance(value, float | int) and not isinstance(value, bool)
    }  # fmt: skip
    return html(f"{car.name}: {car.description}", rows, vehicle_figure(car), f"{car.name} from above")


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
    marks.draw_dots(axes, [0.0], [0.0], marks.SERIES[1], size=6.0)
    marks.write_beside(axes, 0.0, 0.0, "centre of mass", (6.0, 5.0))
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
    label, unit = words.INPUT_LABELS[first]
    level_strokes = marks.strokes(
        f"{words.INPUT_LABELS[name][0]} {words.number(float(level))}" for name in second for level in levels
    )
    tunings = []
    for level in levels:
        points[:, 1 : 1 + len(second)] = level
        tunings.append(tune_at(schedule, points))

    def draw(axes: Axes, k: int, log: bool) -> None:
        for tuning, stroke in zip(tunings, list(level_strokes.values()) or [marks.make_stroke()], strict=True):
            axes.plot(x, tuning[:, k], **stroke)
        axes.set_xlabel(f"{label} ({unit})")
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


@html_of.register
def schedule_html(schedule: Schedule) -> str:
    """Inputs with their domain, entries with their bounds, and the tuning in pictures."""
    rows = {}
    for name, (low, high) in zip(schedule.inputs, schedule.domain, strict=True):
        label, unit = words.INPUT_LABELS[name]
        rows[f"Input {label.lower()}"] = f"{words.number(float(low))} to {words.number(float(high))} {unit}"
    for name, entry in schedule.tuning.items():
        bounds = f"{words.number(float(entry.low))} to {words.number(float(entry.high))}"
        rows[f"Entry {name}"] = f"{bounds}, by {type(entry.function).__name__}"
    rows["Guard"] = "none" if schedule.guard is None else "yes"
    return html(schedule.name, rows, schedule_figure(schedule), f"The tuning of {schedule.name}")


# -- data sets --------------------------------------------------------------------------------------------------------
@figure_of.register
def dataset_figure(dataset: DataSet) -> Figure:
    """Histograms of the best tunings, and the cost of the standard tuning over the best, by speed.

    Raises
    ------
    InvalidInput
        When the run failed with every tuning.
    """
    rows = comparable_rows(dataset)
    if rows is None:
        raise InvalidInput(f"data set {dataset.name!r}: every run failed, so there is nothing to draw.")
    panels = [*(histogram(target) for target in targets(rows)), gain_panel(rows)]
    return print_figure(Picture("dataset", "", panels, row_height=2.1))


@html_of.register
def dataset_html(dataset: DataSet) -> str:
    """A data set in a notebook."""
    searched = dataset.rows(dataset.computed)
    rows = {
        "Operating points": f"{words.number(len(dataset))}, of which {words.number(len(searched))} searched by swarms",
        "Library": f"{words.number(len(dataset.library))} tunings",
        **dict(zip(("Speed", "Lateral reference", "Friction", "Side wind"), map(words.span, dataset.operating_points.T),
                   strict=True)),
        "Failed with every tuning": words.number(int(np.isinf(searched.best_costs).sum())),
    }  # fmt: skip
    figure = None if comparable_rows(dataset) is None else dataset_figure(dataset)
    return html(f"Data set {dataset.name}", rows, figure, "The best tunings, and the gain over the standard tuning")


# -- comparisons ------------------------------------------------------------------------------------------------------
@figure_of.register
def comparison_figure(comparison: Comparison) -> Figure:
    """Each contender's cost over the reference's, with its 95 % interval."""
    picture = ratios_picture(comparison, str)
    return panel_figure(picture.panels[0], picture.size)


@html_of.register
def comparison_html(comparison: Comparison) -> str:
    """Contenders, the cheapest first: cost over the reference's with its interval, and failed runs."""
    title, rows = repr(comparison)[1:-1], {}
    for row in sorted(comparison.rows(), key=lambda row: row["regret_geomean"]):
        low, mean, high = (words.number(row[f"regret_{name}"]) for name in ("low", "geomean", "high"))
        rows[row["contender"]] = f"{mean} ({low} to {high}); failed in {words.number(row['failures'])}"
    return html(title, rows, comparison_figure(comparison), title)


# -- HTML -------------------------------------------------------------------------------------------------------------
def html(title: str, rows: Mapping[str, str], figure: Figure | None = None, description: str = "") -> str:
    """A title, names with their values, and a picture, with nothing from outside."""
    picture = "" if figure is None else base64.b64encode(style.png(figure)).decode()
    template = make_environment().get_template("notebook.html.j2")
    return template.render(title=title, rows=rows, picture=picture, description=description)


def _measures(metrics: Metrics) -> dict[str, str]:
    """The main measures of a run."""
    rows = {
        "RMS error": f"{words.number(metrics.rms_error)} m",
        "Largest |error|": f"{words.number(metrics.max_abs_error)} m",
        "Steering rate RMS": f"{words.number(metrics.steering_rate_rms)} rad/s",
        "Cost J": f"{words.number(metrics.cost)} m²",
    }
    if metrics.failed:
        rows["Failed"] = f"at {metrics.failed_at:.1f} s: the vehicle {metrics.failed_because}"
    return rows


def written(value: Any) -> str:
    """Write a number as readers do; other values unchanged."""
    is_number = isinstance(value, float | int) and not isinstance(value, bool)
    return words.number(value) if is_number or value is None else str(value)
