"""Figure and notebook form of each type (`base.presentation`)."""

from __future__ import annotations

from functools import singledispatch
from typing import Any

from matplotlib.figure import Figure

from adaptrack.cars.vehicle import Vehicle
from adaptrack.comparison.table import Comparison
from adaptrack.control.scheduling import Schedule
from adaptrack.drive.metrics import Metrics
from adaptrack.drive.trajectory import Trajectory
from adaptrack.paper.data_set import DataSet
from adaptrack.results.comparison_pictures import comparison_figure
from adaptrack.results.dataset import dataset_figure, dataset_html
from adaptrack.results.notebook import (
    comparison_html,
    metrics_html,
    run_figure,
    run_html,
    schedule_figure,
    schedule_html,
    vehicle_figure,
    vehicle_html,
)


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


for _kind, _figure, _html in (
    (Vehicle, vehicle_figure, vehicle_html),
    (Trajectory, run_figure, run_html),
    (Schedule, schedule_figure, schedule_html),
    (DataSet, dataset_figure, dataset_html),
):
    figure_of.register(_kind, _figure)
    html_of.register(_kind, _html)
figure_of.register(Comparison, comparison_figure)
html_of.register(Metrics, metrics_html)


@html_of.register(Comparison)
def _(comparison: Comparison) -> str:
    return comparison_html(repr(comparison)[1:-1], comparison.rows(), figure_of(comparison))
