"""Figures and the page: the only room that imports matplotlib.

* `figures` draws the paper's figures 6 to 10 from trajectories; `style` says how every picture looks.
* `maps` draws heat maps over the speed and one more quantity.
* `page` writes any list of sections as one self-contained HTML page with its PNG files.
* `runs` reports on closed-loop runs: `write_report`; `dataset` on tuned operating points: `write_dataset_report`.
* `drive` reports on drives along a road, with a replay: `write_drive_page`, from `record.DriveRecord`; `drive_figures`
  draws the road from above with the driven line, and signals along it; `notebook` shows one run.

The public names are loaded when they are first used: a page loads what it shows, not what other pages do.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_PUBLIC = {
    "dataset": ("write_dataset_report",),
    "drive": ("write_drive_page",),
    "drive_figures": ("above_figure", "along_figure"),
    "figures": ("conditions_figure", "speed_figure", "tracking_figure"),
    "page": ("Section", "write_page"),
    "record": ("DriveRecord", "Measure", "Shape"),
    "runs": ("Run", "write_report"),
}
"""Module -> the names that this package exposes from it; the imports below repeat it for type checkers."""

if TYPE_CHECKING:
    from adaptrack.results.dataset import write_dataset_report
    from adaptrack.results.drive import write_drive_page
    from adaptrack.results.drive_figures import above_figure, along_figure
    from adaptrack.results.figures import conditions_figure, speed_figure, tracking_figure
    from adaptrack.results.page import Section, write_page
    from adaptrack.results.record import DriveRecord, Measure, Shape
    from adaptrack.results.runs import Run, write_report

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


def __getattr__(name: str) -> Any:
    for module, names in _PUBLIC.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
