"""Renderings of a `Result` (base/result.py): console, JSON, notebook, page; the only room that imports matplotlib.

* `console` prints the answer, the brief tables, the notes and the next step; `json` writes the record.
* `page` writes the page of a result by the template of its kind (`templates/`).
* `draw` makes figures from pictures, which are plain data; `style` says how every picture looks.
* `identify`, `shadow`, `road`, `certificate`, `drive`, `reproduce`, `dataset`, `comparison`, `road_comparison` and
  `side_by_side` make results of what the rooms below found; `run_pictures`, `road_pictures` and `learned_picture` show
  runs, `drive_tables` their measures; `answers`, `comparison_answers` and `comparison_words` sentences.
* `notebook` is what objects show of themselves there, `shown` which form belongs to which type.

The public names are loaded when they are first used: a page loads what it shows, not what other pages do.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

_PUBLIC = {
    "dataset": ("write_dataset_report",),
    "drive": ("Run", "write_drive_page"),
    "page": ("write_result",),
    "record": ("DrawnCar",),
}
"""Module -> the names that this package exposes from it; the imports below repeat it for type checkers."""

if TYPE_CHECKING:
    from adaptrack.results.dataset import write_dataset_report
    from adaptrack.results.drive import Run, write_drive_page
    from adaptrack.results.page import write_result
    from adaptrack.results.record import DrawnCar

__all__ = ["DrawnCar", "Run", "write_dataset_report", "write_drive_page", "write_result"]


def __getattr__(name: str) -> Any:
    for module, names in _PUBLIC.items():
        if name in names:
            return getattr(importlib.import_module(f"{__name__}.{module}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
