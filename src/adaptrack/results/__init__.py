"""Renderings of a `Result` (base/result.py): console, JSON, notebook, page; the only room that imports matplotlib.

* `console` prints the answer, the brief tables, the notes and the next step; `json` writes the record.
* `page` writes the page of a result by the template of its kind (`templates/`).
* `draw` lays out the figures of a picture, `marks` draws curves, maps and scales on axes, `style` sets fonts and
  colours and writes PNG and SVG.
* `drive`, `compare`, `evaluation`, `lane_change`, `tuning`, `identify`, `shadow`, `check_loop`, `road`, `certificate`,
  `dataset` and `reproduce` make results from objects of the other rooms. `run_pictures`, `road_pictures` and
  `learned_picture` show runs, `drive_tables` their measures; `answers` holds sentences, `words` formats numbers.
* `notebook` shows objects in a notebook, `shown` registers which form belongs to which type.

The public names are loaded when they are first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
