"""One run in a notebook: its picture, and its measures in HTML."""

from __future__ import annotations

import base64

from markupsafe import escape
from matplotlib.figure import Figure

from adaptrack.metrics import compute_metrics
from adaptrack.report import style
from adaptrack.report.drive_figures import along_panels, draw_above, labelled
from adaptrack.report.figures import tracking_figure
from adaptrack.report.record import DriveRecord
from adaptrack.report.words import controller_name, legible, number, title_of
from adaptrack.road import Road
from adaptrack.trajectory import Trajectory


def run_figure(run: Trajectory, road: Road | None = None) -> Figure:
    """Signals over time; with a road: from above, and offset, steering and speed along it.

    Raises
    ------
    InvalidInput
        When fewer than two instants lie beside the road.
    """
    if road is None:
        return tracking_figure({controller_name(run.name_of("controller")): run})
    drive = DriveRecord.from_trajectory(run, road)
    with style.styled():
        figure = style.ShownFigure(figsize=(style.PAGE_WIDTH, 8.4))
        above, *along = figure.subplots(4, 1, height_ratios=[3.2, 1.0, 1.0, 1.0])
        draw_above([drive], [above])
        for panel, axes in zip(along_panels(labelled([drive])), along, strict=False):
            panel.show(axes)
        for axes in along[:-1]:
            axes.set_xlabel("")
    return figure


def run_html(run: Trajectory) -> str:
    """Name, measures and picture of a run, with nothing from outside."""
    metrics = compute_metrics(run)
    rows = {
        "Duration": f"{number(run.duration)} s, {number(len(run))} control periods of {run.period:g} s",
        "RMS error": f"{number(metrics.rms_error)} m",
        "Largest |error|": f"{number(metrics.max_abs_error)} m",
        "Steering rate RMS": f"{number(metrics.steering_rate_rms)} rad/s",
    }
    if metrics.failed:
        rows["Failed"] = f"at {metrics.failed_at:.1f} s: the vehicle {metrics.failed_because}"
    title = f"{title_of(run.name_of('scenario'))}, {controller_name(run.name_of('controller'))}"
    left = 'style="text-align: left"'
    table = "".join(
        f"<tr><th {left}>{escape(name)}</th><td {left}>{escape(text)}</td></tr>" for name, text in rows.items()
    )
    picture = base64.b64encode(style.png(run_figure(run))).decode()
    return (
        f"<div><p><strong>{escape(legible(title))}</strong></p><table>{table}</table>"
        f'<img style="max-width: 100%; width: 45rem" alt="{escape(title)}: signals over time" '
        f'src="data:image/png;base64,{picture}"></div>'
    )
