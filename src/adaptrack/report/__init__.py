"""Figures and the page: the only room that imports matplotlib.

* `figures` draws the paper's figures 6 to 10 from trajectories; `style` says how every picture looks.
* `maps` draws heat maps over the speed and one more quantity.
* `page` writes any list of sections as one self-contained HTML page with its PNG files.
* `runs` reports on closed-loop runs: `write_report`; `dataset` on tuned operating points: `write_dataset_report`.
"""

from adaptrack.report.dataset import write_dataset_report
from adaptrack.report.figures import conditions_figure, speed_figure, tracking_figure
from adaptrack.report.page import Section, write_page
from adaptrack.report.runs import Run, write_report

__all__ = [
    "Run",
    "Section",
    "conditions_figure",
    "speed_figure",
    "tracking_figure",
    "write_dataset_report",
    "write_page",
    "write_report",
]
