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

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
