"""Figures and the page: the only room that imports matplotlib.

* `figures` draws the paper's figures 6 to 10 from trajectories; `style` says how every picture looks.
* `maps` draws heat maps over the speed and one more quantity.
* `page` writes any list of sections as one self-contained HTML page with its PNG files.
* `runs` reports on closed-loop runs: `write_report`; `dataset` on tuned operating points: `write_dataset_report`.
* `drive` reports on drives along a road, with a replay: `write_drive_page`, from `record.DriveRecord`; `drive_figures`
  draws the road from above with the driven line, and signals along it; `notebook` shows one run.
"""

from adaptrack.report.dataset import write_dataset_report
from adaptrack.report.drive import write_drive_page
from adaptrack.report.drive_figures import above_figure, along_figure
from adaptrack.report.figures import conditions_figure, speed_figure, tracking_figure
from adaptrack.report.page import Section, write_page
from adaptrack.report.record import DriveRecord, Measure, Shape
from adaptrack.report.runs import Run, write_report

__all__ = [
    "DriveRecord",
    "Measure",
    "Run",
    "Section",
    "Shape",
    "above_figure",
    "along_figure",
    "conditions_figure",
    "speed_figure",
    "tracking_figure",
    "write_dataset_report",
    "write_drive_page",
    "write_page",
    "write_report",
]
