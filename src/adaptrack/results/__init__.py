"""Renderings of a `Result` (base/result.py): console, JSON, notebook, page; the only room that imports matplotlib.

* `console` prints the answer, the brief tables, the notes and the next step; `json` writes the record.
* `page` writes the page of a result by the template of its kind (`templates/`).
* `draw` makes figures from pictures, which are plain data; `style` says how every picture looks.
* `identify`, `shadow`, `road`, `certificate`, `drive`, `runs`, `reproduce`, `dataset`, `comparison`,
  `compare`, `lane_change` and `tuning` make results of what the rooms below found; `figures` the figures 6 to 10 of the
  paper, `drive_figures` a road from above and signals along it; `answers`, `comparison_answers` and
  `comparison_words` sentences.
* `notebook` is what objects show of themselves there, `shown` which form belongs to which type.

The public names are loaded when they are first used: a page loads what it shows, not what other pages do.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_PUBLIC = {
    "drive": ("write_drive_page",),
    "drive_figures": ("above_figure", "along_figure"),
    "figures": ("conditions_figure", "speed_figure", "tracking_figure"),
    "page": ("write_result",),
    "record": ("DriveRecord", "Measure", "DrawnCar"),
    "runs": ("Run", "write_report"),
}
"""Module -> the names that this package exposes from it; the imports below repeat it for type checkers."""

if TYPE_CHECKING:
    from adaptrack.results.drive import write_drive_page
    from adaptrack.results.drive_figures import above_figure, along_figure
    from adaptrack.results.figures import conditions_figure, speed_figure, tracking_figure
    from adaptrack.results.page import write_result
    from adaptrack.results.record import DrawnCar, DriveRecord, Measure
    from adaptrack.results.runs import Run, write_report

__all__ = [
    "DrawnCar",
    "DriveRecord",
    "Measure",
    "Run",
    "above_figure",
    "along_figure",
    "conditions_figure",
    "speed_figure",
    "tracking_figure",
    "write_drive_page",
    "write_report",
    "write_result",
]


def __getattr__(name: str) -> Any:
    for module, names in _PUBLIC.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
