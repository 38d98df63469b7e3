"""Renderings of a `Result` (base/result.py): console, JSON, notebook, page; the only room that imports matplotlib.

* `console` prints the answer, the brief tables, the notes and the next step; `page` writes the page of a result by the
  template of its kind (`templates/`).
* `style` lays out the figures of a picture and writes PNG and SVG; `marks` has colours, maps, keys and dots.
* `drive`, `compare`, `evaluation`, `lane_change`, `tuning`, `identify`, `shadow`, `road`, `certificate`, `dataset` and
  `reproduce` make results from objects of the other rooms. `run_pictures` shows runs, `record` the road from above and
  the replay of a drive; `words` formats numbers and names.
* `notebook` has the figure and the notebook form of each type.

The public names are loaded when they are first used.
"""

from __future__ import annotations

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
